//! Attacks along x and y under motion capture, flown: biases that are judged, and what generators prepare.

use plumbline_agent::attack::{Channel, Kind};
use plumbline_agent::envelope::expected::DRAWN;
use plumbline_agent::envelope::prepare::{power, prepared};
use plumbline_experiment::draw::parallel;
use plumbline_experiment::summary;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use plumbline_support::effort::Effort;
use plumbline_support::envelope::{Flown, Worn, fly_for, fly_held};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

use super::usual;

/// The world: the noise of the data sheets, no vibration.
const WORLD: &str = "bench";
/// Flights of each row, of those that are drawn in a world.
const SHARE: u64 = 20;
/// How long an attack lasts, s.
const LASTS_S: f64 = 5.0;
/// Ticks of 5 ms until the last slot.
const LAST: f64 = (LASTS_S - 0.04) / 0.005;
/// Covert motions, m/s²: further than half a metre from its setpoint a flight counts as lost.
const COVERT_MPS2: f64 = 0.03;
/// Parts of what a generator prepares as a stealthy bias that are flown.
const PARTS: [f64; 2] = [1.0, 1.5];

/// Of tilt, velocity, position.
const UNITS: [&str; 3] = ["rad", "m/s", "m"];

/// Attacks, and what of them is flown.
struct Row {
    name: String,
    axis: usize,
    attacks: Vec<PlannedAttack>,
    /// Of their magnitudes.
    parts: &'static [f64],
    /// Told to move it by so much, with this place among tilt (rad), velocity (m/s), position (m).
    told: Option<(f64, usize)>,
}

fn question(axis: &str, noise_mps2: f64, sensors: &[&str]) -> EnvelopeQuestion {
    EnvelopeQuestion {
        axis: Some(axis.to_owned()),
        more: Some("pose".to_owned()),
        noise_mps2: Some(noise_mps2),
        sensors: Some(sensors.iter().map(|name| (*name).to_owned()).collect()),
        horizon_s: Some(LASTS_S),
        ..EnvelopeQuestion::default()
    }
}

fn ask(of: EnvelopeQuestion, generator: &str, deviation: Option<&str>) -> PreparedAttack {
    let asked = AttackQuestion {
        of,
        generator: Some(generator.to_owned()),
        deviation: deviation.map(str::to_owned),
        accel_mps2: (generator == "covert").then_some(COVERT_MPS2),
        ..AttackQuestion::default()
    };
    prepared(&asked, None).unwrap_or_else(|e| panic!("{generator}: {e}"))
}

fn rows(noise_mps2: f64) -> Vec<Row> {
    let bias = |channel: &str| PlannedAttack {
        sensor: "imu".to_owned(),
        instance: 1,
        channel: channel.to_owned(),
        kind: "bias".to_owned(),
        duration_s: LASTS_S,
        magnitude: 1.0,
        ..PlannedAttack::default()
    };
    let mut rows = Vec::new();
    for (axis, name, [force, rate]) in [(0, "x", ["accel_x", "gyro_y"]), (1, "y", ["accel_y", "gyro_x"])] {
        let one = |name: String, attacks, parts, told| Row { name, axis, attacks, parts, told };
        rows.push(one(format!("bias, {force} of 1 of 4 IMUs, m/s²"), vec![bias(force)], &FORCES_MPS2, None));
        rows.push(one(format!("bias, {rate} of 1 of 4 IMUs, rad/s"), vec![bias(rate)], &RATES_RADPS, None));
        for (place, deviation) in ["tilt", "velocity", "position"].into_iter().enumerate() {
            let found = ask(question(name, noise_mps2, &["imu 1"]), "stealthy_bias", Some(deviation));
            let told = [found.tilt_rad, found.velocity_mps, found.position_m][place].map(|far| (far, place));
            let channel = found.attacks.first().map_or("", |attack| &attack.channel);
            let title = format!("stealthy bias along {name} for {deviation}: {channel}, of what is prepared");
            rows.push(one(title, found.attacks, if place == 0 { &PARTS } else { &PARTS[..1] }, told));
            let found = ask(question(name, noise_mps2, &["imu 1"]), "optimal", Some(deviation));
            let told = [found.tilt_rad, found.velocity_mps, found.position_m][place].map(|far| (far, place));
            rows.push(one(format!("optimal along {name} for {deviation}"), found.attacks, &[1.0], told));
        }
        let all = ["imu 1", "imu 2", "imu 3", "imu 4", "mocap pose 1"];
        let found = ask(question(name, noise_mps2, &all), "covert", None);
        let told = found.position_m.map(|far| (far, 2));
        rows.push(one(format!("covert along {name}, all attacked"), found.attacks, &[1.0, -1.0], told));
    }
    rows
}

const FORCES_MPS2: [f64; 6] = [0.4, 0.45, 0.5, 0.55, 0.6, 1.0];
const RATES_RADPS: [f64; 6] = [0.008, 0.01, 0.012, 0.014, 0.017, 0.03];

fn sensor_of(attack: &PlannedAttack) -> SensorId {
    let kind = if attack.sensor == "imu" { SensorKind::Imu } else { SensorKind::MocapPose };
    SensorId::new(kind, attack.instance as u8)
}

/// Is anything seen before the end? What begins there is seen at once where it takes a position away.
fn seen(flight: &Flown) -> bool {
    flight.seen.is_some_and(|tick| (tick as f64) < LAST)
}

/// What `attacks` are when flown, `part` times as large.
fn worn(attacks: &[PlannedAttack], part: f64, seed: u64) -> Worn {
    if attacks.iter().any(|attack| !attack.sequence.is_empty()) {
        let scaled = |attack: &PlannedAttack| PlannedAttack { magnitude: part * attack.magnitude, ..attack.clone() };
        let attacks = attacks.iter().map(scaled).collect();
        return Worn::prepared(&PreparedAttack { attacks, ..PreparedAttack::default() }, 0.0);
    }
    let one = |attack: &PlannedAttack| {
        let channel = match attack.channel.as_str() {
            "accel_x" => Channel::AccelAxis(0),
            "accel_y" => Channel::AccelAxis(1),
            "gyro_x" => Channel::GyroAxis(0),
            "gyro_y" => Channel::GyroAxis(1),
            "x" => Channel::Axis(0),
            "y" => Channel::Axis(1),
            other => panic!("nothing here attacks {other}"),
        };
        let kind = if attack.kind == "parabola" { Kind::Parabola } else { Kind::Bias };
        (sensor_of(attack), channel, kind, part * attack.magnitude)
    };
    Worn::these(attacks.iter().map(one), LASTS_S, seed)
}

/// Flights of each row: how many exclude a sensor that is attacked, beside what is expected, and how far it goes beside the same flight
/// without the attack.
pub fn of_lateral(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Along x and y, under motion capture");
    let flights = (effort.flights / SHARE).max(10);
    report.paragraph(&format!(
        "{flights} flights of each in {WORLD}, position held under motion capture, {LASTS_S} s, seeds from {}, either sign by turns but for \
         covert motions: in how many an attacked sensor is excluded, with its 95 % interval; beside it what the lanes' own judges make of it on the \
         ground, of {DRAWN} drawn noises.",
        effort.seed_base
    ));
    let clean = parallel(flights as usize, |i| fly_held(WORLD, effort.seed_base + i as u64, &Worn::default(), LASTS_S));
    let noise_mps2 = usual(&clean).noise_mps2;
    let mut table = Vec::new();
    for Row { name, axis, attacks, parts, told } in rows(noise_mps2) {
        let of = question(["x", "y"][axis], noise_mps2, &[]);
        let judged = AttackQuestion { of, attacks: attacks.clone(), ..AttackQuestion::default() };
        let model = power(&judged, None, parts).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut sensors: Vec<SensorId> = attacks.iter().map(sensor_of).collect();
        sensors.dedup();
        for (part, model) in parts.iter().zip(model) {
            let Some(model) = model else { continue };
            let flown = parallel(flights as usize, |i| {
                let seed = effort.seed_base + i as u64;
                let turned = name.starts_with("covert") || seed.is_multiple_of(2);
                let flight = fly_held(WORLD, seed, &worn(&attacks, if turned { *part } else { -part }, seed), LASTS_S);
                let moved = clean.get(i).map_or([f64::NAN; 3], |clean| flight.unseen_aside(clean, axis, LASTS_S));
                (flight.excluded.iter().any(|one| sensors.contains(one)), seen(&flight), moved)
            });
            let excluded = flown.iter().filter(|(excluded, ..)| *excluded).count() as u64;
            let anything = flown.iter().filter(|(_, seen, _)| *seen).count() as u64;
            let [low, high] = summary::part(excluded, flights).interval;
            let [least, most] = summary::part(model.seen(), DRAWN).interval;
            let holds = least <= high && most >= low;
            let place = told.map_or(0, |(_, place)| place);
            let moved = flown.iter().map(|one| one.2[place]).sum::<f64>() / flights as f64;
            let expected = model.aside[place];
            let more = json!({
                "axis": axis, "flights": flights, "low": low, "high": high, "expected": model.probability(), "holds": holds,
                "anything": anything, "unit": UNITS[place], "moved": moved,
                "expected_moved": expected, "told": told.map(|(far, _)| far), "noise_mps2": noise_mps2,
            });
            let share = excluded as f64 / flights as f64;
            report.value(&format!("lateral/{name}/{part}"), share, "of flights", more);
            table.push(vec![
                name.clone(),
                format!("{part} ({:.4})", part * attacks.first().map_or(0.0, |attack| attack.magnitude)),
                format!("{share:.2}"),
                format!("{low:.2} to {high:.2}"),
                format!("{:.2}", model.probability()),
                if holds { "" } else { "differs" }.to_owned(),
                format!("{:.2}", anything as f64 / flights as f64),
                format!("{moved:.4} {}", UNITS[place]),
                format!("{expected:.4}"),
            ]);
        }
    }
    let headers = [
        "attack",
        "part (magnitude)",
        "excluded",
        "95 %",
        "expected",
        "",
        "anything seen",
        "moved unseen, mean of the furthest",
        "in the linear loop",
    ];
    report.table("lateral", "Along x and y", &headers, &table)?;
    unaided(report, effort, flights)
}

/// A covert motion where nothing measures it: all accelerometers alike. The operator of these flights brings the vehicle back, whom the
/// linear loop does not have.
fn unaided(report: &mut Report, effort: &Effort, flights: u64) -> Result<(), ReportError> {
    report.heading("Along x, nothing measures it");
    let of = EnvelopeQuestion { more: None, ..question("x", 0.0, &["imu 1", "imu 2", "imu 3", "imu 4"]) };
    let attack = ask(of, "covert", None);
    let flown = parallel(flights as usize, |i| {
        let seed = effort.seed_base + i as u64;
        let clean = fly_for(WORLD, seed, &Worn::default(), LASTS_S, None);
        let flight = fly_for(WORLD, seed, &worn(&attack.attacks, 1.0, seed), LASTS_S, None);
        (seen(&flight), flight.unseen_aside(&clean, 0, LASTS_S)[2])
    });
    let seen = flown.iter().filter(|(seen, _)| *seen).count() as u64;
    let moved_m = flown.iter().map(|(_, moved_m)| moved_m).sum::<f64>() / flights as f64;
    let [low, high] = summary::part(seen, flights).interval;
    let more = json!({
        "flights": flights, "low": low, "high": high, "expected": attack.probability, "moved_m": moved_m, "told_m": attack.position_m,
    });
    report.value("lateral/covert, nothing measures", seen as f64 / flights as f64, "of flights", more);
    Ok(())
}
