//! Kinds of calibrations, how each is done well, and the points of a fit to draw.

use plumbline_rest::calibration::Series;

/// A kind of calibration: name on the wire, title, the data it needs, guidance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Name on the wire.
    pub name: &'static str,
    /// Title on the page.
    pub title: &'static str,
    /// Can a recorded flight be its data?
    pub from_flight: bool,
    /// Can samples be taken by hand, and how; empty where they cannot.
    pub by_hand: &'static str,
    /// What to do, one step after the other.
    pub guidance: &'static [&'static str],
    /// A table of it, to be filled in: with the columns that are read; empty where a flight alone will do.
    pub example: &'static str,
}

/// Samples of an IMU as a table; the reader's own tests read these.
const IMU: &str = include_str!("../../../agent/analysis/tables/imu.csv");
const MOTOR_CURVE: &str = include_str!("../../../agent/analysis/tables/motor-curve.csv");
const THRUST: &str = include_str!("../../../agent/analysis/tables/thrust.csv");
const MASS: &str = include_str!("../../../agent/analysis/tables/mass.csv");

/// Every kind.
pub const KINDS: [Kind; 9] = [
    Kind {
        name: "accelerometer",
        title: "Accelerometer",
        from_flight: true,
        by_hand: "Put the vehicle down, motors off, on each of its sides, then in some poses in between, and hold it still for a second each time.",
        guidance: &[
            "Record (R) while the vehicle rests, motors off.",
            "Put it down in ten poses or more, 15° or more apart: each side, both ends, upside down, and some in between.",
            "Hold each pose still for a second or more. Scale, misalignment and bias come out of gravity alone; seven poses give scale and bias.",
        ],
        example: IMU,
    },
    Kind {
        name: "gyroscope",
        title: "Gyroscope",
        from_flight: true,
        by_hand: "Hold the vehicle still for a second, turn it briskly by 30° or more, hold it still again; six times or more, about every axis.",
        guidance: &[
            "Use the same recording of poses: the turns between two rests are what is compared.",
            "Turn briskly, six times or more, by 30° or more, about every axis, and rest again each time.",
            "Choose a fitted accelerometer first: it says how far each turn went.",
        ],
        example: IMU,
    },
    Kind {
        name: "magnetometer",
        title: "Magnetometer",
        from_flight: true,
        by_hand: "Away from steel and cables, motors off: turn the vehicle slowly about all its axes, until every side has looked everywhere.",
        guidance: &[
            "Record away from steel and cables, motors off.",
            "Turn the vehicle about all its axes until every side has looked up and down, for half a minute.",
            "Hard iron is the centre of the ellipsoid, soft iron its shape: afterwards the points lie on a sphere.",
        ],
        example: IMU,
    },
    Kind {
        name: "thermal",
        title: "Temperature",
        from_flight: true,
        by_hand: "",
        guidance: &[
            "Record at rest from cold until the temperature stands still; ten minutes or more.",
            "Nothing may move: what changes is then the sensors' own drift.",
        ],
        example: IMU,
    },
    Kind {
        name: "motor-curve",
        title: "Motor curve",
        from_flight: false,
        by_hand: "",
        guidance: &[
            "On a stand with a tachometer: command each motor from low to high in ten steps, wait for the speed to settle.",
            "Table with the columns command (0 to 1) and rpm, or speed_radps.",
        ],
        example: MOTOR_CURVE,
    },
    Kind {
        name: "thrust",
        title: "Thrust and torque",
        from_flight: false,
        by_hand: "",
        guidance: &[
            "On a thrust stand: speed, thrust and, where measured, torque, for ten speeds or more.",
            "Table with the columns rpm and thrust_n, and torque_nm; a wind-tunnel table of a propeller works too.",
        ],
        example: THRUST,
    },
    Kind {
        name: "mass",
        title: "Mass and inertia",
        from_flight: false,
        by_hand: "",
        guidance: &[
            "Weigh the vehicle with its battery.",
            "For inertia hang it on two strings and time the swing about each axis, as the example table has them.",
        ],
        example: MASS,
    },
    Kind {
        name: "allan",
        title: "IMU noise (Allan)",
        from_flight: true,
        by_hand: "",
        guidance: &[
            "Record at rest, motors off, on something solid; the longer the better, an hour shows the bias instability.",
            "White noise is the slope −½ at one second, bias instability the flat bottom.",
        ],
        example: IMU,
    },
    Kind {
        name: "delays",
        title: "Delays of heights and motion capture",
        from_flight: true,
        by_hand: "",
        guidance: &[
            "Record a flight of a minute or more with many steps of altitude, as large and quick as the room allows.",
            "Choose an IMU that is shaken little: it says when the vehicle moved, the others when they noticed.",
        ],
        example: "",
    },
];

/// Does a calibration of this kind correct the samples of an IMU? Then a vehicle takes it up at once.
pub fn corrects(kind: &str) -> bool {
    matches!(kind, "accelerometer" | "gyroscope" | "magnetometer" | "thermal")
}

/// What is calibrated, for people: its title, and of which IMU (0: of the vehicle itself).
pub fn named(kind: &str, imu: u32) -> String {
    let title = KINDS.iter().find(|known| known.name == kind).map_or(kind, |known| known.title);
    if imu == 0 { title.to_owned() } else { format!("{title} of IMU {imu}") }
}

/// At most this many points of a series are drawn.
const MOST_POINTS: usize = 600;

/// The points to draw: thinned, and as powers of ten where the axes are logarithmic.
pub fn drawn(series: &Series, log: bool) -> Vec<[f64; 2]> {
    let every = series.points.len().div_ceil(MOST_POINTS).max(1);
    let place = |v: Option<f64>| match v {
        Some(v) if log => v.log10(),
        Some(v) => v,
        None => f64::NAN,
    };
    series.points.iter().step_by(every).map(|[x, y]| [place(*x), place(*y)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_thinned_and_its_logarithms_are_drawn() {
        let series = Series { points: vec![[Some(10.0), Some(100.0)], [None, Some(1.0)]], ..Series::default() };
        let points = drawn(&series, true);
        assert_eq!(points[0], [1.0, 2.0]);
        assert!(points[1][0].is_nan());
        let many = Series { points: vec![[Some(1.0), Some(1.0)]; 100_000], ..Series::default() };
        assert!(drawn(&many, false).len() <= MOST_POINTS);
    }

    #[test]
    fn the_guidance_asks_for_what_the_fit_enforces() {
        let fits = include_str!("../../../agent/core/src/calibration/inertial.rs");
        let rests = include_str!("../../../agent/core/src/calibration/rest.rs");
        for (source, enforced, kind, asked) in [
            (fits, "const POSES_FULL: usize = 10;", "accelerometer", "ten poses or more"),
            (fits, "const POSES_APART_RAD: f64 = 0.25;", "accelerometer", "15° or more apart"),
            (fits, "const POSES_SCALE: usize = 7;", "accelerometer", "seven poses give scale and bias"),
            (rests, "const INTERVAL_S: f64 = 1.0;", "accelerometer", "still for a second or more"),
            (fits, "const TURNS_MIN: usize = 6;", "gyroscope", "six times or more"),
            (fits, "const TURN_MIN_RAD: f64 = 0.5;", "gyroscope", "by 30° or more"),
        ] {
            assert!(source.contains(enforced), "{enforced}: another number is enforced now");
            let guidance = KINDS.iter().find(|k| k.name == kind).map(|k| k.guidance.join(" ")).unwrap();
            assert!(guidance.contains(asked), "{kind}: {asked}");
        }
    }

    #[test]
    fn every_kind_says_what_to_do() {
        assert_eq!(KINDS.iter().filter(|k| corrects(k.name)).count(), 4);
        assert_eq!((named("thermal", 2), named("mass", 0)), ("Temperature of IMU 2".into(), "Mass and inertia".into()));
        let tables = || KINDS.iter().filter(|k| !k.example.is_empty());
        assert!(tables().all(|k| k.example.lines().count() > 3 && k.from_flight == k.example.starts_with("t_s,")));
        assert!(KINDS.iter().filter(|k| k.example.is_empty()).all(|k| k.from_flight && k.name == "delays"));
        assert!(KINDS.iter().all(|k| !k.guidance.is_empty() && k.guidance.iter().all(|g| g.ends_with('.'))));
    }
}
