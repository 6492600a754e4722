//! Generators of attacks: how many flights see them, beside what the model expects, with intervals.

use plumbline_agent::attack::{Channel, Kind};
use plumbline_agent::envelope::expected::{DRAWN, Expected};
use plumbline_agent::envelope::prepare::{power, prepared};
use plumbline_agent::envelope::theory::block_told;
use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_agent::flight::watermark::{LIMIT, Settings};
use plumbline_experiment::draw::parallel;
use plumbline_experiment::summary;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion};
use plumbline_support::effort::Effort;
use plumbline_support::envelope::{Bounds, HORIZON_S, Worn, asked_with, fly, fly_for};
use plumbline_tests::report::{Plot, Report, ReportError, Series};
use serde_json::json;

use super::usual;
use crate::attacks::area;

/// The world: the noise of the data sheets, no vibration.
const WORLD: &str = "bench";
/// Flights of each attack, of those that are drawn in a world.
const SHARE: u64 = 20;
/// 95 %.
const Z: f64 = 1.96;
/// The watermark, m/s², what is replayed, s, and for how long.
const RMS_MPS2: f64 = 0.1;
const REPLAYED_S: f64 = 8.0;
const REPLAY_S: f64 = 30.0;
/// What t was designed to be at: 0.5 A √(25 h)/0.15 with h = 10 s.
const DEFLECTION: f64 = 0.5 * RMS_MPS2 * 15.811_388 / 0.15;

fn height(instance: u8) -> SensorId {
    SensorId::new(SensorKind::Height, instance)
}

fn imu(instance: u8) -> SensorId {
    SensorId::new(SensorKind::Imu, instance)
}

/// A generator: what it does to which sensors at size one, and the sizes flown.
struct Generator {
    name: &'static str,
    unit: &'static str,
    what: Vec<(SensorId, Kind, f64)>,
    sizes: &'static [f64],
}

fn generators() -> Vec<Generator> {
    let covert = |heights: u8| {
        let heights = (1..=heights).map(|i| (height(i), Kind::Parabola, -1.0));
        heights.chain((1..=4).map(|i| (imu(i), Kind::Bias, -1.0))).collect()
    };
    let of = |name, unit, what, sizes| Generator { name, unit, what, sizes };
    vec![
        of(
            "bias, 1 of 3 heights",
            "cm",
            vec![(height(2), Kind::Bias, 0.01)],
            &[3.0, 4.0, 4.2, 4.4, 4.6, 4.8, 5.0, 6.0],
        ),
        of(
            "bias, 2 of 3 heights",
            "cm",
            vec![(height(1), Kind::Bias, 0.01), (height(2), Kind::Bias, 0.01)],
            &[4.0, 8.0],
        ),
        of("ramp, 1 of 3 heights", "cm/s", vec![(height(2), Kind::Ramp, 0.01)], &[0.5, 0.6, 0.7, 0.8, 1.0]),
        of("bias, 1 of 4 IMUs, z", "m/s²", vec![(imu(1), Kind::Bias, 1.0)], &[0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 1.0]),
        of("covert, all but height 3", "m/s²", covert(2), &[0.002, 0.005, 0.01, 0.02]),
        of("covert, all", "m/s²", covert(3), &[0.02]),
    ]
}

fn planned(sensor: SensorId, kind: Kind, magnitude: f64) -> PlannedAttack {
    let is_imu = sensor.kind == SensorKind::Imu;
    PlannedAttack {
        sensor: if is_imu { "imu" } else { "height" }.to_owned(),
        instance: u32::from(sensor.instance),
        channel: if is_imu { "accel_z" } else { "all" }.to_owned(),
        kind: format!("{kind:?}").to_lowercase(),
        duration_s: HORIZON_S,
        magnitude,
        ..PlannedAttack::default()
    }
}

/// Flights of one attack: those that see it and those that exclude anybody, and what the statistics of `sensors` reached.
struct Seen {
    flights: u64,
    those: u64,
    anybody: u64,
    scores: Vec<f64>,
}

fn fly_all(effort: &Effort, flights: u64, sensors: &[SensorId], worn: &(dyn Fn(u64) -> Worn + Sync)) -> Seen {
    let flown = parallel(flights as usize, |i| {
        let seed = effort.seed_base + i as u64;
        let flight = fly(WORLD, seed, &worn(seed));
        (flight.seen.is_some(), flight.score(sensors))
    });
    let scores: Vec<f64> = flown.iter().map(|(_, score)| *score).collect();
    let count = |of: &dyn Fn(&(bool, f64)) -> bool| flown.iter().filter(|one| of(one)).count() as u64;
    Seen { flights, those: count(&|one| one.1.is_infinite()), anybody: count(&|one| one.0), scores }
}

/// A row of the table, flown and expected; does the model hold?
fn tell(
    report: &mut Report,
    name: &str,
    size: &str,
    seen: &Seen,
    model: Option<&Expected>,
    areas: [f64; 2],
) -> Vec<String> {
    let [low, high] = summary::part(seen.those, seen.flights).interval;
    // The model's part has an interval too.
    let part = model.map_or(f64::NAN, Expected::probability);
    let [least, most] = summary::part(model.map_or(0, Expected::seen), DRAWN).interval;
    let holds = model.is_some() && least <= high && most >= low;
    let flown = seen.those as f64 / seen.flights as f64;
    let more = json!({
        "flights": seen.flights, "low": low, "high": high, "expected": part, "anybody": seen.anybody, "holds": holds,
        "area": areas[0], "area_expected": areas[1],
    });
    report.value(&format!("detect/{name}/{size}"), flown, "of flights", more);
    vec![
        name.to_owned(),
        size.to_owned(),
        format!("{flown:.2}"),
        format!("{low:.2} to {high:.2}"),
        format!("{part:.2}"),
        if holds { "" } else { "differs" }.to_owned(),
        format!("{:.2}", seen.anybody as f64 / seen.flights as f64),
        format!("{:.3}", areas[0]),
        format!("{:.3}", areas[1]),
    ]
}

/// Detection of every generator: power, and the area under the curve of detection against false alarms.
pub fn of_generators(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Generators: seen in flight, and expected");
    let flights = (effort.flights / SHARE).max(10);
    report.paragraph(&format!(
        "{flights} flights of each in {WORLD}, {HORIZON_S} s, seeds from {}, either sign by turns: in how many an attacked sensor is excluded, with \
         its 95 % interval; beside it what the lanes' own judges make of it on the ground, of {DRAWN} drawn noises. Area: under the curve of \
         detection against false alarms, over all limits of the attacked sensors' statistics.",
        effort.seed_base
    ));
    let shaken = usual(&parallel(flights as usize, |i| fly(WORLD, effort.seed_base + i as u64, &Worn::default())));
    report.value(
        "detect/noise",
        shaken.noise_mps2,
        "m/s²",
        json!({ "rectified_mps2": shaken.rectified_mps2, "of": "accelerometers, as the lanes measure it without an attack, median of the flights" }),
    );
    let of = asked_with(shaken);
    let mut rows = Vec::new();
    for Generator { name, unit, what, sizes } in generators() {
        let attacks = what.iter().map(|(sensor, kind, one)| planned(*sensor, *kind, *one)).collect();
        let question = AttackQuestion { of: of.clone(), attacks, ..AttackQuestion::default() };
        // The first is that of no attack: false alarms.
        let model = power(&question, None, &[&[0.0], sizes].concat()).unwrap_or_else(|e| panic!("{name}: {e}"));
        let sensors: Vec<SensorId> = what.iter().map(|(sensor, ..)| *sensor).collect();
        let quiet = fly_all(effort, flights, &sensors, &|_| Worn::default());
        let mut plot = [Vec::new(), Vec::new()];
        for (size, found) in [0.0].iter().chain(sizes).zip(&model) {
            let worn = |seed: u64| {
                let sign = if seed.is_multiple_of(2) { *size } else { -*size };
                let channel =
                    |s: SensorId| if s.kind == SensorKind::Imu { Channel::AccelAxis(2) } else { Channel::All };
                Worn::these(what.iter().map(|(s, kind, one)| (*s, channel(*s), *kind, sign * one)), HORIZON_S, seed)
            };
            let seen = fly_all(effort, flights, &sensors, &worn);
            let none = model.first().and_then(Option::as_ref).zip(found.as_ref());
            let areas = [
                area(&quiet.scores, &seen.scores),
                none.map_or(f64::NAN, |(none, found)| area(&none.scores, &found.scores)),
            ];
            rows.push(tell(report, name, &format!("{size} {unit}"), &seen, found.as_ref(), areas));
            plot[0].push((*size, seen.those as f64 / flights as f64));
            plot[1].push((*size, found.as_ref().map_or(f64::NAN, Expected::probability)));
        }
        let [flown, expected] = plot;
        let plot = Plot::new(&format!("Power: {name}"), unit, "flights in which an attacked one is excluded")
            .with(Series::points("flown", flown))
            .with(Series::line("expected", expected))
            .y_range(0.0, 1.0);
        let file = name.replace([' ', ','], "_");
        report.figure(&format!("power_{file}"), "Power", &plot)?;
    }
    optimal(report, effort, flights, shaken, &mut rows);
    let headers =
        ["generator", "size", "seen", "95 %", "expected", "", "anybody excluded", "area, flown", "area, expected"];
    report.table("detect", "Generators", &headers, &rows)
}

/// The maximising sequences of some sets.
fn optimal(report: &mut Report, effort: &Effort, flights: u64, shaken: Shaken, rows: &mut Vec<Vec<String>>) {
    let bounds = Bounds::sampled(shaken);
    for names in ["height 2", "imu 1", "height 1, imu 1"] {
        let Some(set) = bounds.sets.iter().find(|set| set.name() == names) else { continue };
        let sensors = Some(set.sensors.iter().map(ToString::to_string).collect());
        let horizon_s = Some(HORIZON_S);
        let of = EnvelopeQuestion { sensors, horizon_s, ..asked_with(shaken) };
        let question = AttackQuestion { of, generator: Some("optimal".into()), ..AttackQuestion::default() };
        let attacks = prepared(&question, None).map(|found| found.attacks).unwrap_or_default();
        let question = AttackQuestion { generator: None, attacks, ..question };
        let found = power(&question, None, &[0.0, 1.0]).unwrap_or_default();
        let quiet = fly_all(effort, flights, &set.sensors, &|_| Worn::default());
        let seen = fly_all(effort, flights, &set.sensors, &|_| set.worst(1.0));
        let [Some(none), Some(model)] = &found[..] else { continue };
        let areas = [area(&quiet.scores, &seen.scores), area(&none.scores, &model.scores)];
        rows.push(tell(report, "optimal", names, &seen, Some(model), areas));
    }
}

/// Replays against the watermark, and what it costs.
pub fn of_replays(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Watermark against replays");
    let flights = (effort.flights / SHARE).max(10);
    let flown = parallel(flights as usize, |i| {
        let seed = effort.seed_base + i as u64;
        // Each flight has a watermark of its own: what one has in common with itself 8 s ago is the same in every flight.
        let settings = Settings { rms_mps2: RMS_MPS2, seed };
        let replay = [(imu(2), Channel::Accel, Kind::Replay, REPLAYED_S)];
        let attacked = fly_for(WORLD, seed, &Worn::these(replay, REPLAY_S, seed), REPLAY_S, Some(settings));
        let [without, with] = [None, Some(settings)].map(|mark| fly_for(WORLD, seed, &Worn::default(), REPLAY_S, mark));
        let apart: f64 = with.altitude_m.iter().zip(&without.altitude_m).map(|(a, b)| (a - b).powi(2)).sum();
        (attacked, (apart / with.altitude_m.len().max(1) as f64).sqrt())
    });
    // Blocks wholly within the replay tell of IMU 2; of the others all but the first, which still learns.
    let (mut seen, mut missed, mut alarms, mut healthy) = (0_u64, 0_u64, 0_u64, 0_u64);
    let (mut missing, mut replayed) = (Vec::new(), Vec::new());
    for (flight, _) in &flown {
        for (end_s, block) in flight.carried.iter().skip(1) {
            for (i, t) in block.carried.iter().enumerate() {
                let Some(t) = t else { continue };
                let low = *t < -LIMIT;
                match i {
                    1 if *end_s > 10.0 => {
                        seen += u64::from(low);
                        missed += u64::from(!low);
                        replayed.push(*t);
                        missing.push(block.missing);
                    }
                    1 if *end_s > 0.0 => {}
                    _ => {
                        alarms += u64::from(low);
                        healthy += 1;
                    }
                }
            }
        }
    }
    let blocks = seen + missed;
    let [low, high] = summary::part(seen, blocks).interval;
    let part = seen as f64 / blocks.max(1) as f64;
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
    let (told, deflection) = (-mean(&replayed), -mean(&missing));
    let spread_t = (replayed.iter().map(|t| (t + told).powi(2)).sum::<f64>() / replayed.len().max(2) as f64).sqrt();
    let expected = block_told(RMS_MPS2);
    let holds = (low..=high).contains(&expected);
    let more = json!({ "blocks": blocks, "low": low, "high": high, "expected": expected, "holds": holds, "rms_mps2": RMS_MPS2 });
    report.value("watermark/detected", part, "of blocks of 10 s", more);
    let more = json!({ "spread": spread_t, "by_the_flights_own_sigma": deflection, "expected": DEFLECTION });
    report.value("watermark/deflection", told, "σ", more);
    let [least, most] = summary::part(alarms, healthy).interval;
    let more = json!({ "blocks": healthy, "alarms": alarms, "low": least, "high": most, "expected": 0.001, "holds": least <= 0.001 && most >= 0.001 });
    report.value("watermark/false", alarms as f64 / healthy.max(1) as f64, "of healthy blocks", more);
    let ripple: Vec<f64> = flown.iter().map(|(_, ripple_m)| 1e3 * ripple_m).collect();
    let mean = mean(&ripple);
    let spread = (ripple.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / ripple.len().max(2) as f64).sqrt();
    let half = Z * spread / (ripple.len().max(1) as f64).sqrt();
    report.value(
        "watermark/ripple",
        mean,
        "mm rms",
        json!({ "low": mean - half, "high": mean + half, "expected": 0.2 }),
    );
    let rows = vec![
        vec![
            "replayed blocks told".into(),
            format!("{part:.3}"),
            format!("{low:.3} to {high:.3} of {blocks}"),
            format!("{expected:.3}"),
        ],
        vec![
            "deflection, σ".into(),
            format!("{told:.2}"),
            format!("spread {spread_t:.2}; {deflection:.2} by the flights' own σ"),
            format!("{DEFLECTION:.2}"),
        ],
        vec![
            "healthy blocks told".into(),
            format!("{:.4}", alarms as f64 / healthy.max(1) as f64),
            format!("{least:.4} to {most:.4} of {healthy}"),
            "0.001".into(),
        ],
        vec![
            "ripple, mm rms".into(),
            format!("{mean:.3}"),
            format!("{:.3} to {:.3}", mean - half, mean + half),
            "0.2".into(),
        ],
    ];
    report.table("watermark", "Watermark", &["", "flown", "95 %", "formula"], &rows)
}
