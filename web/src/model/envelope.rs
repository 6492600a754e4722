//! The attack envelope as rows for people: sets that are alike in one row, the largest of their bounds.

use plumbline_rest::envelope::{Envelope, EnvelopeSet};

use super::format;

/// One row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// `height 2`, `any two IMUs`.
    pub attacked: String,
    /// `at most 2.5 cm`, `unbounded`.
    pub bound: String,
    /// Is there none?
    pub unbounded: bool,
    /// The detector that holds it, or how fast it drifts.
    pub held: String,
}

/// Heights by name, and how many IMUs: those have one model.
fn class(set: &EnvelopeSet) -> (Vec<&str>, usize) {
    let (imus, heights): (Vec<&str>, Vec<&str>) =
        set.sensors.iter().map(String::as_str).partition(|name| name.starts_with("imu"));
    (heights, imus.len())
}

fn attacked(heights: &[&str], imus: usize, all: bool) -> String {
    let imus = match imus {
        0 => None,
        1 => Some("any IMU".to_owned()),
        2 => Some("any two IMUs".to_owned()),
        n => Some(format!("any {n} IMUs")),
    };
    let heights = (!heights.is_empty()).then(|| if all { "all heights".to_owned() } else { heights.join(" and ") });
    heights.into_iter().chain(imus).collect::<Vec<_>>().join(" and ")
}

/// The rows, in the order of the sets.
pub fn rows(envelope: &Envelope) -> Vec<Row> {
    let mut known: Vec<(Vec<&str>, usize)> = Vec::new();
    let mut rows = Vec::new();
    // Every height is in some set alone.
    let heights = envelope.sets.iter().filter(|set| set.sensors.len() == 1 && class(set).1 == 0).count();
    for set in &envelope.sets {
        let (of, imus) = class(set);
        if known.contains(&(of.clone(), imus)) {
            continue;
        }
        let (bound, unbounded) = match set.altitude_m {
            // A bound is rounded up.
            Some(most_m) => (format!("at most {} cm", format::fixed((1e3 * most_m).ceil() / 10.0, 1)), false),
            None => ("unbounded".to_owned(), true),
        };
        let drift = |mps: f64| format!("drifts {} cm/s", format::fixed(100.0 * mps, 1));
        let held = set.binding.clone().or(set.drift_mps.map(drift)).unwrap_or_default();
        rows.push(Row { attacked: attacked(&of, imus, heights > 1 && of.len() == heights), bound, unbounded, held });
        known.push((of, imus));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(sensors: &[&str], altitude_m: Option<f64>) -> EnvelopeSet {
        let drift_mps = altitude_m.is_none().then_some(0.428);
        let binding = altitude_m.map(|_| "height reach".to_owned());
        let sensors = sensors.iter().map(|name| (*name).to_owned()).collect();
        EnvelopeSet { sensors, altitude_m, binding, drift_mps, ..EnvelopeSet::default() }
    }

    #[test]
    fn imus_are_alike_and_all_heights_are_named_so() {
        let envelope = Envelope {
            sets: vec![
                set(&["height 1"], Some(0.0235)),
                set(&["height 2"], Some(0.025)),
                set(&["imu 1"], Some(0.019)),
                set(&["imu 2"], Some(0.019)),
                set(&["height 1", "imu 1"], Some(0.043)),
                set(&["height 1", "imu 2"], Some(0.043)),
                set(&["imu 1", "imu 2"], Some(0.537)),
                set(&["height 1", "height 2"], None),
            ],
            ..Envelope::default()
        };
        let rows = rows(&envelope);
        let told: Vec<(&str, &str)> = rows.iter().map(|row| (row.attacked.as_str(), row.bound.as_str())).collect();
        assert_eq!(
            told,
            [
                ("height 1", "at most 2.4 cm"),
                ("height 2", "at most 2.5 cm"),
                ("any IMU", "at most 1.9 cm"),
                ("height 1 and any IMU", "at most 4.3 cm"),
                ("any two IMUs", "at most 53.7 cm"),
                ("all heights", "unbounded"),
            ]
        );
        assert!(rows[5].unbounded && rows[5].held == "drifts 42.8 cm/s" && rows[0].held == "height reach");
    }
}
