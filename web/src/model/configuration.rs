//! What a flight was flown with, as rows of name and value: for a report, and to say what two flights differ in.

use std::collections::BTreeMap;

use plumbline_proto::v1::{Description, EstimatorKind, GainsInUse};
use plumbline_rest::flight::Flight;

use super::{
    curves::DEGREES,
    format::{NONE, fixed},
    live::Live,
    names,
    tuning::{INPUTS, STATES},
};

/// A name and its value.
pub type Row = (String, String);

fn row(name: &str, value: impl Into<String>) -> Row {
    (name.to_owned(), value.into())
}

/// A number with four digits or so, without needless zeros.
fn short(value: f64) -> String {
    let decimals = match value.abs() {
        large if large >= 100.0 => 1,
        middle if middle >= 10.0 => 2,
        small if small >= 1.0 => 3,
        _ => 4,
    };
    let text = fixed(value, decimals);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Vehicle, rig, seed, versions, limits, sensors.
pub fn vehicle(flight: &Flight, live: &Live) -> Vec<Row> {
    let mut rows = vec![
        row("vehicle", format!("{} ({})", flight.vehicle_id, flight.vehicle)),
        row("airframe", &flight.airframe),
        row("rig", flight.rig.replace('_', " ")),
        row("seed", flight.seed.to_string()),
        row("agent version", &flight.agent_version),
        row("estimator in the loop", names::estimator_numbered(live.in_loop())),
    ];
    if let Some(description) = live.description.get() {
        rows.extend(described(description));
    }
    rows
}

fn described(description: &Description) -> Vec<Row> {
    let mut rows = vec![
        row("schema", description.schema.to_string()),
        row("mass", format!("{} kg", short(description.mass_kg))),
        row("control rate", format!("{} Hz", short(description.tick_rate_hz))),
        row("attacks allowed", if description.attacks_enabled { "yes" } else { "no" }),
    ];
    if let Some(l) = &description.limits {
        rows.push(row("altitude limits", format!("{} to {} m", short(l.altitude_min_m), short(l.altitude_max_m))));
        rows.push(row("lateral limit", format!("{} m", short(l.lateral_max_m))));
        rows.push(row("climb, descent", format!("{}, {} m/s", short(l.climb_max_mps), short(l.descent_max_mps))));
        rows.push(row("tilt limit", format!("{}°", short(l.tilt_max_rad * DEGREES))));
    }
    let estimators: Vec<_> = description.estimators().map(EstimatorKind::title).collect();
    rows.push(row("estimators", estimators.join(", ")));
    for s in &description.sensors {
        let sigma = if s.sigma > 0.0 { format!(", σ {} {}", short(s.sigma), s.unit) } else { String::new() };
        rows.push((names::instance(s.kind(), s.instance), format!("{} Hz{sigma}", short(s.rate_hz))));
    }
    rows
}

/// Controller and gains in use at the end.
pub fn gains(live: &Live) -> Vec<Row> {
    live.gains.get().map(in_use).unwrap_or_default()
}

fn in_use(gains: &GainsInUse) -> Vec<Row> {
    let mut rows = vec![
        row("controller", gains.controller.replace('_', " ")),
        row("gains revision", gains.revision.to_string()),
        row("gains hash", gains.sha256.chars().take(12).collect::<String>()),
        row("slowest pole", format!("{} 1/s", fixed(gains.slowest_pole_per_s, 2))),
    ];
    if let Some(weights) = &gains.weights {
        // A weight is 1/(largest deviation)²: Bryson.
        let named = STATES.iter().zip(&weights.state_weight).chain(INPUTS.iter().zip(&weights.input_weight));
        rows.extend(named.map(|((name, unit, factor), weight)| {
            let deviation =
                if *weight > 0.0 { format!("{} {unit}", short(weight.powf(-0.5) * factor)) } else { "free".into() };
            (format!("deviation of {name}"), deviation)
        }));
    }
    rows.extend(gains.parameters.iter().map(|p| (p.name.replace('_', " "), short(p.value))));
    rows.extend(gains.margins.iter().map(|m| {
        let (phase, delay) = (fixed(m.phase_rad * DEGREES, 0), fixed(m.delay_s * 1e3, 0));
        (format!("margins of {}", m.input), format!("phase {phase}°, delay {delay} ms"))
    }));
    rows
}

/// The keys of a scenario with their values: `rig.length_m` and `0.8`.
pub fn scenario(text: &str) -> Vec<Row> {
    let mut section = String::new();
    let mut tables: BTreeMap<String, u32> = BTreeMap::new();
    let mut rows = Vec::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix("[[").and_then(|l| l.split_once("]]")) {
            // One of several tables of that name.
            let count = tables.entry(name.0.to_owned()).or_insert(0);
            *count += 1;
            section = format!("{} {count}.", name.0);
        } else if let Some(name) = line.strip_prefix('[').and_then(|l| l.split_once(']')) {
            section = format!("{}.", name.0);
        } else if let Some((key, value)) = line.split_once('=') {
            rows.push((format!("{section}{}", key.trim()), value.trim().to_owned()));
        }
    }
    rows
}

/// Everything that two flights can differ in.
pub fn all(flight: &Flight, live: &Live) -> Vec<Row> {
    let scenario = live.description.get().map(|d| scenario(&d.scenario)).unwrap_or_default();
    let scenario = scenario.into_iter().map(|(name, value)| (format!("scenario: {name}"), value));
    vehicle(flight, live).into_iter().chain(gains(live)).chain(scenario).collect()
}

/// The rows that are not the same everywhere: name, and the value of each; and how many are the same.
pub fn differences(flights: &[Vec<Row>]) -> (Vec<(String, Vec<String>)>, usize) {
    let mut order: Vec<&String> = Vec::new();
    for (name, _) in flights.iter().flatten() {
        if !order.contains(&name) {
            order.push(name);
        }
    }
    let value = |rows: &Vec<Row>, name: &String| rows.iter().find(|(n, _)| n == name).map(|(_, value)| value.clone());
    let mut same = 0;
    let mut out = Vec::new();
    for name in order {
        let values: Vec<Option<String>> = flights.iter().map(|rows| value(rows, name)).collect();
        if values.windows(2).all(|pair| pair[0] == pair[1]) {
            same += 1;
        } else {
            out.push((name.clone(), values.into_iter().map(|v| v.unwrap_or_else(|| NONE.to_owned())).collect()));
        }
    }
    (out, same)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_is_read_by_its_keys() {
        let text = "seed = 7\n# a note\n[rig]\nkind = \"strings\"\n[[steps]]\nto_m = 0.5\n[[steps]]\nto_m = 0.8\n";
        let rows = scenario(text);
        let names: Vec<&str> = rows.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["seed", "rig.kind", "steps 1.to_m", "steps 2.to_m"]);
        assert_eq!(rows[3].1, "0.8");
    }

    #[test]
    fn only_what_differs_is_told() {
        let one = vec![row("seed", "1"), row("rig", "free"), row("mass", "1 kg")];
        let two = vec![row("seed", "2"), row("rig", "free")];
        let (rows, same) = differences(&[one, two]);
        assert_eq!(same, 1);
        assert_eq!(
            rows,
            [
                ("seed".to_owned(), vec!["1".to_owned(), "2".to_owned()]),
                ("mass".to_owned(), vec!["1 kg".to_owned(), NONE.to_owned()])
            ]
        );
    }

    #[test]
    fn weights_are_told_as_deviations() {
        let weights = plumbline_proto::v1::LqrWeights { state_weight: vec![4.0, 0.0], input_weight: vec![0.25] };
        let rows = in_use(&GainsInUse { weights: Some(weights), ..Default::default() });
        assert!(rows.contains(&row("deviation of east", "0.5 m")) && rows.contains(&row("deviation of north", "free")));
        assert!(rows.contains(&row("deviation of thrust", "2 N")));
        assert_eq!((short(2.50), short(-0.00001), short(30.0)), ("2.5".into(), "0".into(), "30".into()));
    }
}
