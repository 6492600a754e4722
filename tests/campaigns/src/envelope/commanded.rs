//! Attacks on rotors and sensors together, flown: covert motions by command, and zero dynamics.

use plumbline_agent::envelope::prepare::prepared;
use plumbline_experiment::draw::{parallel, worst};
use plumbline_experiment::summary::part;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use plumbline_support::effort::Effort;
use plumbline_support::envelope::{Flown, HORIZON_S, Worn, fly};
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

/// Everything that can be attacked.
const ALL: [&str; 8] = ["height 1", "height 2", "height 3", "imu 1", "imu 2", "imu 3", "imu 4", "rotors"];
/// Ticks that count: behind the end everything is seen at once.
const LAST: usize = 1990;
/// Flights of each row, of those that are drawn in a world.
const SHARE: u64 = 20;

/// Further than half a metre from its setpoint a flight counts as lost, whoever brought it there: none is told to go so far.
///
/// An attack of 10 s: generator, largest acceleration, m/s², who is healthy, after so long a sample of it, s, worlds.
type Row = (&'static str, f64, &'static [&'static str], f64, &'static [&'static str]);
const ROWS: [Row; 6] = [
    ("covert", 0.005, &[], 0.0, &["ideal", "bench", "datasheet"]),
    ("covert", 0.02, &[], 0.0, &["ideal", "bench", "datasheet"]),
    ("covert", -0.02, &[], 0.0, &["ideal", "bench", "datasheet"]),
    ("covert", 0.02, &["height 3"], 0.0, &["ideal", "bench"]),
    ("zero_dynamics", 0.5, &["height 3"], 0.065, &["ideal", "bench", "datasheet"]),
    ("zero_dynamics", 2.0, &["height 3"], 0.065, &["ideal", "bench", "datasheet"]),
];

fn asked(generator: &str, accel_mps2: f64, healthy: &[&str]) -> PreparedAttack {
    let sensors = ALL.iter().filter(|name| !healthy.contains(name)).map(|name| (*name).to_owned()).collect();
    let of = EnvelopeQuestion { sensors: Some(sensors), horizon_s: Some(HORIZON_S), ..EnvelopeQuestion::default() };
    let generator = Some(generator.to_owned());
    prepared(&AttackQuestion { of, generator, accel_mps2: Some(accel_mps2), ..AttackQuestion::default() }, None)
        .unwrap_or_else(|e| panic!("{e}"))
}

/// How far the vehicle is from the same flight without the attack: at the end, and at most, m.
fn moved(flight: &Flown, clean: &Flown) -> (f64, f64) {
    let apart = flight.altitude_m.iter().zip(&clean.altitude_m).take(LAST + 1).map(|(a, b)| a - b);
    let apart: Vec<f64> = apart.collect();
    (apart.last().copied().unwrap_or_default(), apart.iter().fold(0.0, |most, m| most.max(m.abs())))
}

/// One flight beside that without the attack.
struct One {
    last_m: f64,
    most_m: f64,
    seen: bool,
    seen_without: bool,
}

fn seen(flight: &Flown) -> bool {
    flight.seen.is_some_and(|tick| tick <= LAST)
}

pub fn of_rotors(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("Rotors and sensors attacked together");
    let flights = effort.flights.div_ceil(SHARE).max(1);
    let mut rows = Vec::new();
    for (generator, accel_mps2, healthy, late_s, worlds) in ROWS {
        let attack = asked(generator, accel_mps2, healthy);
        for world in worlds {
            let flown = parallel(flights as usize, |i| {
                let seed = effort.seed_base + i as u64;
                let clean = fly(world, seed, &Worn::default());
                let flight = fly(world, seed, &Worn::prepared(&attack, late_s));
                let (last_m, most_m) = moved(&flight, &clean);
                One { last_m, most_m, seen: seen(&flight), seen_without: seen(&clean) }
            });
            let count = |of: fn(&One) -> bool| flown.iter().filter(|one| of(one)).count() as u64;
            let (seen, without) = (count(|one| one.seen), count(|one| one.seen_without));
            let last_m = flown.iter().map(|one| one.last_m).sum::<f64>() / flights as f64;
            let most_m = worst(&flown.iter().map(|one| one.most_m).collect::<Vec<_>>());
            let [low, high] = part(seen, flights).interval;
            let name = format!("{generator} {accel_mps2} m/s², healthy: {}", healthy.join(", "));
            let more = json!({
                "world": world, "flights": flights, "asked_m": attack.altitude_m, "last_m": last_m, "most_m": most_m,
                "expected": attack.probability, "low": low, "high": high,
                "seen_without_the_attack": without, "note": attack.note,
            });
            report.value(&format!("commanded/{name}/{world}"), seen as f64 / flights as f64, "of the flights", more);
            rows.push(vec![
                name,
                (*world).to_owned(),
                attack.altitude_m.map_or_else(|| "–".into(), |m| format!("{:.2}", 100.0 * m)),
                format!("{:.2}", 100.0 * last_m),
                format!("{:.2}", 100.0 * most_m),
                format!("{seen} of {flights} ({low:.2} to {high:.2})"),
                attack.probability.map_or_else(|| "–".into(), |p| format!("{p:.2}")),
            ]);
        }
    }
    let headers = ["attack", "world", "asked, cm", "moved at the end, cm", "at most, cm", "seen (95 %)", "expected"];
    report.table("commanded", "Rotors and sensors", &headers, &rows)
}
