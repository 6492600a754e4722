//! The attack envelope as rows for people: sets that are alike in one row, the largest of their bounds.

use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::{EstimatorKind, SecureSensor, SecureStatus, SensorKind};
use plumbline_rest::envelope::{Envelope, EnvelopeQuestion, EnvelopeSet, NOISES_MPS2, around, between};

use super::format;

/// Bounds of one attacked sensor over the noise of the accelerometers, for one vehicle with its gains and what is excluded.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// What it is made for.
    pub of: Of,
    /// Noise, m/s², and the largest bound of any one sensor, m; rising noise, and those of either of what is rectified.
    pub rows: [Vec<(f64, f64)>; 2],
}

/// What a [`Table`] is made for: as long as things are so, it is asked for once.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Of {
    /// Sensors excluded, by name.
    pub without: Vec<String>,
    /// What the accelerometers rectify lies between these, m/s².
    pub rectified_mps2: [f64; 2],
}

impl Of {
    /// As things are in `status`, lanes in the loop; `None` where the vehicle is shaken by more than any table is for.
    pub fn now(status: &SecureStatus, in_loop: u16) -> Option<Self> {
        let rectified_mps2 = around(status.accel_rectified_mps2.unwrap_or(0.0))?;
        (in_loop == EstimatorKind::Lanes as u16).then(|| Self { without: excluded(status), rectified_mps2 })
    }

    /// The questions whose answers are the rows of a [`Table`]: those of one of what is rectified after those of the other.
    pub fn questions(&self) -> Vec<EnvelopeQuestion> {
        let of = |noise_mps2: f64, rectified_mps2: f64| EnvelopeQuestion {
            most: Some(1),
            noise_mps2: Some(noise_mps2),
            rectified_mps2: Some(rectified_mps2),
            without: self.without.clone(),
            ..EnvelopeQuestion::default()
        };
        self.rectified_mps2.into_iter().flat_map(|rectified| NOISES_MPS2.map(|noise| of(noise, rectified))).collect()
    }
}

impl Table {
    /// Of the bounds that answer [`Of::questions`], m.
    pub fn new(of: Of, bounds_m: &[f64]) -> Self {
        let (low, high) = bounds_m.split_at(bounds_m.len() / 2);
        Self { rows: [low, high].map(|of| NOISES_MPS2.into_iter().zip(of.iter().copied()).collect()), of }
    }

    /// The bound as things are in `status`, m, where it is of this table.
    pub fn bound_now_m(&self, status: &SecureStatus, in_loop: u16) -> Option<f64> {
        let noise_mps2 = status.accel_noise_mps2.filter(|_| Of::now(status, in_loop).as_ref() == Some(&self.of))?;
        between(&self.rows, noise_mps2, status.accel_rectified_mps2.unwrap_or(0.0))
    }
}

/// Sensors that `status` excludes, by name.
fn excluded(status: &SecureStatus) -> Vec<String> {
    let bounded = |s: &&SecureSensor| s.flagged && matches!(s.sensor(), SensorKind::Height | SensorKind::Imu);
    let name = |s: &SecureSensor| SensorId::new(s.sensor(), s.instance as u8).to_string();
    status.sensors.iter().filter(bounded).map(name).collect()
}

/// The largest bound of one sensor, m; `None` where one has none.
pub fn of_one_m(envelope: &Envelope) -> Option<f64> {
    let alone = envelope.sets.iter().filter(|set| set.sensors.len() == 1);
    alone.map(|set| set.altitude_m).try_fold(0.0, |most: f64, m| m.map(|m| most.max(m)))
}

/// The same of one sensor whose name begins so.
fn of_one_such_m(envelope: &Envelope, begins: &str) -> Option<f64> {
    let sets = envelope.sets.iter().filter(|set| set.sensors.first().is_some_and(|name| name.starts_with(begins)));
    of_one_m(&Envelope { sets: sets.cloned().collect(), ..Envelope::default() })
}

fn cm(m: Option<f64>) -> String {
    // A bound is rounded up.
    m.map_or_else(|| "unbounded".to_owned(), |m| format!("{} cm", format::fixed((1e3 * m).ceil() / 10.0, 1)))
}

/// `one height more: 2.5 cm → 2.0 cm by a height, …`: what a sensor more of a kind (`height`, `imu`, `pose`) buys.
pub fn price(kind: &str, before: &Envelope, after: &Envelope) -> String {
    let of = |begins: &str, name: &str| {
        let (old, new) = (of_one_such_m(before, begins), of_one_such_m(after, begins));
        format!("{} \u{2192} {} by {name}", cm(old), cm(new))
    };
    let more = match kind {
        "imu" => "one IMU more",
        "pose" => "motion capture, if nobody attacks that",
        _ => "one height more",
    };
    format!("{more}: {}, {}", of("height", "one height"), of("imu", "one IMU"))
}

/// In one line: `height 1: 2.4 cm; any IMU: 2.0 cm; …`.
pub fn line(envelope: &Envelope) -> String {
    let bound = |row: Row| format!("{}: {}", row.attacked, row.bound);
    rows(envelope).into_iter().map(bound).collect::<Vec<_>>().join("; ")
}

/// One row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// `height 2`, `any two IMUs`.
    pub attacked: String,
    /// At most so far: `2.5 cm`, `unbounded`.
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
        let (bound, unbounded) = (cm(set.altitude_m), set.altitude_m.is_none());
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
    fn a_table_is_read_between_its_rows_and_for_what_it_was_made() {
        let of = Of { without: vec!["height 2".into()], rectified_mps2: [0.3, 0.45] };
        assert_eq!(of.questions().len(), 2 * NOISES_MPS2.len());
        let table = Table { of, rows: [vec![(0.1, 0.02), (0.5, 0.04)], vec![(0.1, 0.03), (0.5, 0.05)]] };
        let at = |noise| between(&table.rows, noise, 0.375);
        assert!(at(0.05) == at(0.1) && at(0.1) < at(0.3) && at(0.3) < at(0.5) && at(0.6).is_none());
        // Half way, and raised.
        assert!(at(0.3).is_some_and(|m| (0.035..0.037).contains(&m)));
        let sensor = |instance, flagged| SecureSensor {
            sensor: SensorKind::Height as i32,
            instance,
            flagged,
            ..Default::default()
        };
        let status = |second| SecureStatus {
            accel_noise_mps2: Some(0.3),
            accel_rectified_mps2: Some(0.4),
            sensors: vec![sensor(1, false), sensor(2, second)],
            ..SecureStatus::default()
        };
        let lanes = EstimatorKind::Lanes as u16;
        assert!(table.bound_now_m(&status(true), lanes).is_some());
        assert_eq!(table.bound_now_m(&status(false), lanes), None, "another set is excluded");
        let calmer = SecureStatus { accel_rectified_mps2: Some(0.2), ..status(true) };
        assert_eq!(table.bound_now_m(&calmer, lanes), None, "it is shaken by less");
        let [low, half, high] = [0.33, 0.375, 0.42].map(|rectified| between(&table.rows, 0.1, rectified).unwrap());
        assert!((half - 0.5 * (low + high)).abs() < 1e-12 && low < high, "{low} {half} {high}");
        let questions = table.of.questions();
        let bounds_m: Vec<f64> = (0..questions.len()).map(|n| n as f64).collect();
        let own = Table::new(table.of.clone(), &bounds_m);
        let asked = |n: usize| (questions[n].noise_mps2.unwrap(), questions[n].rectified_mps2.unwrap());
        let last = NOISES_MPS2.len();
        assert_eq!((own.rows[1][0], asked(last)), ((NOISES_MPS2[0], last as f64), (NOISES_MPS2[0], 0.45)));
        assert_eq!(table.bound_now_m(&status(true), EstimatorKind::EkfBias as u16), None, "the bound is that of lanes");
    }

    #[test]
    fn a_sensor_more_has_its_price_in_both_kinds() {
        let of = |height_m, imu_m| Envelope {
            sets: vec![
                set(&["height 1"], Some(height_m)),
                set(&["imu 1"], Some(imu_m)),
                set(&["height 1", "height 2"], None),
            ],
            ..Envelope::default()
        };
        let (before, after) = (of(0.025, 0.019), of(0.0201, 0.019));
        assert_eq!(
            price("height", &before, &after),
            "one height more: 2.5 cm \u{2192} 2.1 cm by one height, 1.9 cm \u{2192} 1.9 cm by one IMU"
        );
        assert!(price("pose", &before, &after).starts_with("motion capture, if nobody attacks that: 2.5 cm"));
        assert_eq!(
            (of_one_m(&before), line(&before).as_str()),
            (Some(0.025), "height 1: 2.5 cm; any IMU: 1.9 cm; height 1 and height 2: unbounded")
        );
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
                ("height 1", "2.4 cm"),
                ("height 2", "2.5 cm"),
                ("any IMU", "1.9 cm"),
                ("height 1 and any IMU", "4.3 cm"),
                ("any two IMUs", "53.7 cm"),
                ("all heights", "unbounded"),
            ]
        );
        assert!(rows[5].unbounded && rows[5].held == "drifts 42.8 cm/s" && rows[0].held == "height reach");
    }
}
