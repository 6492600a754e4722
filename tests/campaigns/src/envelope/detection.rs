//! Generators of attacks: how many flights see them, beside what the model expects, with intervals.

use plumbline_agent::attack::{Channel, Kind};
use plumbline_agent::envelope::expected::DRAWN;
use plumbline_agent::envelope::prepare::prepared;
use plumbline_agent::flight::watermark::{LIMIT, Settings};
use plumbline_experiment::draw::parallel;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion};
use plumbline_support::envelope::{Bounds, HORIZON_S, Worn, fly, fly_for};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

use crate::effort::Effort;

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
/// Its detection by the formula: 0.5 A √(25 h)/0.15 with h = 10 s.
const DEFLECTION: f64 = 0.5 * RMS_MPS2 * 15.811_388 / 0.15;
/// Of it, at one in a thousand.
const EXPECTED: f64 = 0.985;

/// Interval of a part \[Wilson 1927\].
fn interval(of: u64, all: u64) -> (f64, f64) {
    let (n, p) = (all.max(1) as f64, of as f64 / all.max(1) as f64);
    let (centre, spread) = (p + Z * Z / (2.0 * n), Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt());
    let scale = 1.0 + Z * Z / n;
    ((centre - spread) / scale, (centre + spread) / scale)
}

fn height(instance: u8) -> SensorId {
    SensorId::new(SensorKind::Height, instance)
}

fn imu(instance: u8) -> SensorId {
    SensorId::new(SensorKind::Imu, instance)
}

/// A generator: its name, its size in words, and what it does to which sensors.
type Case = (&'static str, String, Vec<(SensorId, Kind, f64)>);

fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for cm in [2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0] {
        all.push(("bias, 1 of 3 heights", format!("{cm} cm"), vec![(height(2), Kind::Bias, 0.01 * cm)]));
    }
    for cm in [4.0, 8.0] {
        let two = vec![(height(1), Kind::Bias, 0.01 * cm), (height(2), Kind::Bias, 0.01 * cm)];
        all.push(("bias, 2 of 3 heights", format!("{cm} cm"), two));
    }
    for cmps in [0.5, 1.0, 2.0] {
        all.push(("ramp, 1 of 3 heights", format!("{cmps} cm/s"), vec![(height(2), Kind::Ramp, 0.01 * cmps)]));
    }
    for accel in [0.1, 0.3, 0.5, 0.7, 1.0, 2.0] {
        all.push(("bias, 1 of 4 IMUs, z", format!("{accel} m/s²"), vec![(imu(1), Kind::Bias, accel)]));
    }
    for accel in [0.002, 0.005, 0.02] {
        let heights = [1, 2].map(|i| (height(i), Kind::Parabola, -accel));
        let imus = [1, 2, 3, 4].map(|i| (imu(i), Kind::Bias, -accel));
        all.push(("covert, all but height 3", format!("{accel} m/s²"), heights.into_iter().chain(imus).collect()));
    }
    let all_heights = [1, 2, 3].map(|i| (height(i), Kind::Parabola, -0.02));
    let all_imus = [1, 2, 3, 4].map(|i| (imu(i), Kind::Bias, -0.02));
    all.push(("covert, all", "0.02 m/s²".into(), all_heights.into_iter().chain(all_imus).collect()));
    all
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

/// Part of flights expected to see it.
fn expected(question: &AttackQuestion) -> f64 {
    prepared(question, None).ok().and_then(|found| found.probability).unwrap_or(f64::NAN)
}

/// Detection of every generator.
pub fn of_generators(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Generators: seen in flight, and expected");
    let flights = (effort.flights / SHARE).max(10);
    report.paragraph(&format!(
        "{flights} flights of each in {WORLD}, {HORIZON_S} s, seeds from {}: in how many an attacked sensor is excluded, with its 95 % interval;          beside it what the lanes' own judges make of it on the ground, of {DRAWN} drawn noises.",
        effort.seed_base
    ));
    let clean = fly(WORLD, effort.seed_base, &Worn::default());
    let bounds = Bounds::new(clean.noise_mps2);
    let mut rows = Vec::new();
    let mut told = |name: &str, size: &str, sensors: &[SensorId], worn: &(dyn Fn(u64) -> Worn + Sync), model: f64| {
        let seen = parallel(flights as usize, |i| {
            let seed = effort.seed_base + i as u64;
            let flight = fly(WORLD, seed, &worn(seed));
            u64::from(flight.excluded.iter().any(|sensor| sensors.contains(sensor)))
        });
        let seen: u64 = seen.into_iter().sum();
        let (low, high) = interval(seen, flights);
        // The model's part has an interval too.
        let (least, most) = interval((model * DRAWN as f64).round() as u64, DRAWN);
        let holds = least <= high && most >= low;
        let flown = seen as f64 / flights as f64;
        let more = json!({ "flights": flights, "low": low, "high": high, "expected": model, "holds": holds });
        report.value(&format!("detect/{name}/{size}"), flown, "of flights", more);
        rows.push(vec![
            name.to_owned(),
            size.to_owned(),
            format!("{flown:.2}"),
            format!("{low:.2} to {high:.2}"),
            format!("{model:.2}"),
            if holds { "" } else { "differs" }.to_owned(),
        ]);
    };
    for (name, size, what) in cases() {
        let attacks = what.iter().map(|(sensor, kind, magnitude)| planned(*sensor, *kind, *magnitude)).collect();
        let model = expected(&AttackQuestion { attacks, ..AttackQuestion::default() });
        let sensors: Vec<SensorId> = what.iter().map(|(sensor, ..)| *sensor).collect();
        let channel =
            |sensor: SensorId| if sensor.kind == SensorKind::Imu { Channel::AccelAxis(2) } else { Channel::All };
        let worn = |seed| {
            let of = what.iter().map(|(sensor, kind, magnitude)| (*sensor, channel(*sensor), *kind, *magnitude));
            Worn::these(of, HORIZON_S, seed)
        };
        told(name, &size, &sensors, &worn, model);
    }
    for names in ["height 2", "imu 1", "height 1, imu 1"] {
        let Some(set) = bounds.sets.iter().find(|set| set.name() == names) else { continue };
        let sensors = Some(set.sensors.iter().map(ToString::to_string).collect());
        let noise_mps2 = Some(clean.noise_mps2);
        let of = EnvelopeQuestion { sensors, noise_mps2, horizon_s: Some(HORIZON_S), ..EnvelopeQuestion::default() };
        let question = AttackQuestion { of, generator: Some("optimal".into()), ..AttackQuestion::default() };
        told("optimal", names, &set.sensors, &|_| bounds.worst(set, 1.0), expected(&question));
    }
    let headers = ["generator", "size", "seen", "95 %", "expected", ""];
    report.table("detect", "Generators", &headers, &rows)
}

/// Replays against the watermark, and what it costs.
pub fn of_replays(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Watermark against replays");
    let flights = (effort.flights / SHARE).max(10);
    let settings = Settings { rms_mps2: RMS_MPS2, seed: 7 };
    let flown = parallel(flights as usize, |i| {
        let seed = effort.seed_base + i as u64;
        let replay = [(imu(2), Channel::Accel, Kind::Replay, REPLAYED_S)];
        let attacked = fly_for(WORLD, seed, &Worn::these(replay, REPLAY_S, seed), REPLAY_S, Some(settings));
        let [without, with] = [None, Some(settings)].map(|mark| fly_for(WORLD, seed, &Worn::default(), REPLAY_S, mark));
        let apart: f64 = with.altitude_m.iter().zip(&without.altitude_m).map(|(a, b)| (a - b).powi(2)).sum();
        (attacked, (apart / with.altitude_m.len().max(1) as f64).sqrt())
    });
    // Blocks wholly within the replay tell of IMU 2; of the others all but the first, which still learns.
    let (mut seen, mut missed, mut alarms, mut healthy) = (0_u64, 0_u64, 0_u64, 0_u64);
    let mut missing = Vec::new();
    for (flight, _) in &flown {
        for (end_s, block) in flight.carried.iter().skip(1) {
            for (i, t) in block.carried.iter().enumerate() {
                let Some(t) = t else { continue };
                let low = *t < -LIMIT;
                match i {
                    1 if *end_s > 10.0 => {
                        seen += u64::from(low);
                        missed += u64::from(!low);
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
    let (low, high) = interval(seen, blocks);
    let part = seen as f64 / blocks.max(1) as f64;
    let deflection = -missing.iter().sum::<f64>() / missing.len().max(1) as f64;
    let holds = (low..=high).contains(&EXPECTED);
    let more = json!({ "blocks": blocks, "low": low, "high": high, "expected": EXPECTED, "holds": holds, "rms_mps2": RMS_MPS2 });
    report.value("watermark/detected", part, "of blocks of 10 s", more);
    report.value("watermark/deflection", deflection, "σ", json!({ "expected": DEFLECTION }));
    let (least, most) = interval(alarms, healthy);
    let more = json!({ "blocks": healthy, "alarms": alarms, "low": least, "high": most, "expected": 0.001, "holds": least <= 0.001 && most >= 0.001 });
    report.value("watermark/false", alarms as f64 / healthy.max(1) as f64, "of healthy blocks", more);
    let ripple: Vec<f64> = flown.iter().map(|(_, ripple_m)| 1e3 * ripple_m).collect();
    let mean = ripple.iter().sum::<f64>() / ripple.len().max(1) as f64;
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
            format!("{EXPECTED}"),
        ],
        vec!["deflection, σ".into(), format!("{deflection:.2}"), String::new(), format!("{DEFLECTION:.2}")],
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
