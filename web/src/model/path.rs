//! A path as it is written on the page: what the form takes, what it refuses itself, and the vehicle's refusals in plain
//! words.

use plumbline_proto::v1::{Limits, Mode};
use plumbline_rest::command::Trajectory;

use super::format::{fixed, list, parse_number};

/// A shape that the vehicle flies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shape {
    /// A circle to the north of where the setpoint is.
    Circle,
    /// Eastward, swinging north and south.
    Sine,
    /// A square to the north-east.
    Square,
    /// Up and down.
    #[default]
    Heave,
    /// A list of altitudes.
    Altitudes,
}

impl Shape {
    /// As they are offered.
    pub const ALL: [Self; 5] = [Self::Heave, Self::Altitudes, Self::Circle, Self::Sine, Self::Square];

    /// Name in requests.
    pub const fn json(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Sine => "sine",
            Self::Square => "square",
            Self::Heave => "heave",
            Self::Altitudes => "altitudes",
        }
    }

    /// Name on the page.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Circle => "Circle",
            Self::Sine => "Sine",
            Self::Square => "Square",
            Self::Heave => "Heave",
            Self::Altitudes => "Altitude list",
        }
    }

    /// What it does, from where the setpoint is.
    pub const fn help(self) -> &'static str {
        match self {
            Self::Circle => "Counter-clockwise, its centre to the north. Duration 0: until stopped.",
            Self::Sine => "Eastward, swinging north and south.",
            Self::Square => "Counter-clockwise from its south-west corner. Duration 0: until stopped.",
            Self::Heave => "Up and down about the setpoint. Duration 0: until stopped.",
            Self::Altitudes => "One step after the other, each with its figures.",
        }
    }

    /// What its size is called.
    pub const fn size(self) -> &'static str {
        match self {
            Self::Circle => "radius",
            Self::Square => "side",
            _ => "amplitude",
        }
    }

    /// Why it is not flown in this mode; `None` where it is.
    pub fn unfit(self, mode: Mode) -> Option<&'static str> {
        match self {
            Self::Circle | Self::Sine | Self::Square if mode != Mode::Hold => Some("It needs mode Hold."),
            Self::Heave | Self::Altitudes if !matches!(mode, Mode::Hold | Mode::AltitudeHold) => {
                Some("It needs mode Altitude hold or Hold.")
            }
            _ => None,
        }
    }
}

/// The form, as typed.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub struct Form {
    pub shape: Shape,
    pub size: String,
    pub period: String,
    pub speed: String,
    pub duration: String,
    pub altitudes: String,
    pub hold: String,
}

impl Default for Form {
    fn default() -> Self {
        Self {
            shape: Shape::default(),
            size: "0.2".into(),
            period: "8".into(),
            speed: "0.1".into(),
            duration: "30".into(),
            altitudes: "0.5 0.8 1.0 0.8".into(),
            hold: "8".into(),
        }
    }
}

/// Fewest seconds of a turn or at an altitude, as the vehicle has it.
const LEAST_S: f64 = 1.0;
/// Most seconds of a path.
const MOST_S: f64 = 3600.0;
/// Fastest along a sine, m/s.
const FASTEST_MPS: f64 = 2.0;
/// Most altitudes of a list.
const MOST_ALTITUDES: usize = 16;

/// A number of the form within its range.
fn number(name: &str, text: &str, unit: &str, least: f64, most: f64) -> Result<f64, String> {
    let value = parse_number(text).map_err(|e| format!("{name}: {e}"))?;
    if (least..=most).contains(&value) {
        return Ok(value);
    }
    let decimals = if least.fract() == 0.0 && most.fract() == 0.0 { 0 } else { 2 };
    Err(format!("{name}: {value} {unit} is not within {} to {} {unit}", fixed(least, decimals), fixed(most, decimals)))
}

impl Form {
    /// What is asked of the vehicle.
    ///
    /// # Errors
    /// What is wrong, by the name of its field.
    pub fn check(&self, limits: Option<&Limits>) -> Result<Trajectory, String> {
        let shape = self.shape.json().to_owned();
        if self.shape == Shape::Altitudes {
            let altitude_m = self.altitudes(limits)?;
            let hold_s = Some(number("time at each", &self.hold, "s", LEAST_S, MOST_S)?);
            return Ok(Trajectory { shape, altitude_m, hold_s, ..Trajectory::default() });
        }
        let reach = limits.map_or(f64::INFINITY, |l| {
            if self.shape == Shape::Heave { l.altitude_max_m - l.altitude_min_m } else { 2.0 * l.lateral_max_m }
        });
        let sine = self.shape == Shape::Sine;
        Ok(Trajectory {
            shape,
            size_m: Some(number(
                self.shape.size(),
                &self.size,
                "m",
                0.01,
                if reach > 0.01 { reach } else { f64::INFINITY },
            )?),
            period_s: Some(number("period", &self.period, "s", LEAST_S, MOST_S)?),
            speed_mps: if sine { Some(number("speed", &self.speed, "m/s", -FASTEST_MPS, FASTEST_MPS)?) } else { None },
            // A sine that moves on must end.
            duration_s: Some(number("duration", &self.duration, "s", if sine { LEAST_S } else { 0.0 }, MOST_S)?),
            ..Trajectory::default()
        })
    }

    fn altitudes(&self, limits: Option<&Limits>) -> Result<Vec<f64>, String> {
        let (low, high) = limits
            .filter(|l| l.altitude_max_m > 0.0)
            .map_or((0.0, f64::INFINITY), |l| (l.altitude_min_m, l.altitude_max_m));
        let all = list(&self.altitudes).map(|part| number("altitudes", part, "m", low, high));
        let all = all.collect::<Result<Vec<f64>, String>>()?;
        match all.len() {
            0 => Err("altitudes: at least one is needed".to_owned()),
            n if n > MOST_ALTITUDES => Err(format!("altitudes: {n} are given, {MOST_ALTITUDES} at most")),
            _ => Ok(all),
        }
    }
}

/// Names that the vehicle's refusals have from its wire, and what the form calls them, with their unit.
const PLAIN: [(&str, &str, &str); 8] = [
    ("radius_m", "radius", "m"),
    ("amplitude_m", "amplitude", "m"),
    ("side_m", "side", "m"),
    ("period_s", "period", "s"),
    ("speed_mps", "speed", "m/s"),
    ("duration_s", "duration", "s"),
    ("hold_s", "time at each", "s"),
    ("altitude_m", "altitude", "m"),
];

/// A refusal of the vehicle in the words of the form.
pub fn plain(refusal: &str) -> String {
    for (wire, name, unit) in PLAIN {
        if let Some(rest) = refusal.strip_prefix(wire) {
            let rest = rest.replacen(':', &format!(" {unit}:"), 1);
            return format!("{name}{rest} {unit}");
        }
    }
    for (wire, name) in [("reaches x ", "east or west"), ("reaches y ", "north or south")] {
        if let Some((before, after)) = refusal.split_once(wire) {
            let (value, limit) = after.split_once(',').unwrap_or((after, ""));
            return format!("{before}goes {value} {name} of the middle,{limit}");
        }
    }
    let told = REACHES.iter().find(|(wire, _)| refusal.contains(wire));
    told.map_or_else(|| refusal.to_owned(), |(wire, words)| refusal.replacen(wire, words, 1))
}

/// What a path does beyond a limit, as the vehicle says it and as people do.
const REACHES: [(&str, &str); 5] = [
    ("reaches climb", "climbs at"),
    ("reaches descent", "descends at"),
    ("reaches speed", "flies at"),
    ("reaches acceleration", "accelerates at"),
    ("reaches altitude", "goes up to"),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits { altitude_min_m: 0.0, altitude_max_m: 2.0, lateral_max_m: 2.0, ..Limits::default() }
    }

    #[test]
    fn a_shape_asks_for_its_own_numbers_only() {
        let heave = Form::default().check(Some(&limits())).unwrap();
        assert_eq!(
            (heave.shape.as_str(), heave.size_m, heave.speed_mps, heave.hold_s),
            ("heave", Some(0.2), None, None)
        );
        let sine = Form { shape: Shape::Sine, speed: "\u{2212}0,1".into(), ..Form::default() };
        assert_eq!(sine.check(None).unwrap().speed_mps, Some(-0.1));
        let list = Form { shape: Shape::Altitudes, altitudes: "0.5, 1,2; 0.8\n".into(), ..Form::default() };
        let list = list.check(Some(&limits())).unwrap();
        assert_eq!((list.altitude_m, list.hold_s, list.size_m), (vec![0.5, 1.2, 0.8], Some(8.0), None));
    }

    #[test]
    fn what_is_wrong_is_said_by_its_name() {
        let error = |form: Form| form.check(Some(&limits())).unwrap_err();
        assert_eq!(error(Form { period: "0.2".into(), ..Form::default() }), "period: 0.2 s is not within 1 to 3600 s");
        assert_eq!(error(Form { size: "a".into(), ..Form::default() }), "amplitude: \u{201c}a\u{201d} is not a number");
        assert_eq!(error(Form { size: "5".into(), ..Form::default() }), "amplitude: 5 m is not within 0.01 to 2.00 m");
        let list = |text: &str| error(Form { shape: Shape::Altitudes, altitudes: text.into(), ..Form::default() });
        assert_eq!(list("0.5 3"), "altitudes: 3 m is not within 0 to 2 m");
        assert_eq!(list(" ; "), "altitudes: at least one is needed");
        assert!(list(&"1 ".repeat(17)).contains("17 are given"));
        let endless = Form { shape: Shape::Sine, duration: "0".into(), ..Form::default() };
        assert!(error(endless).starts_with("duration: 0 s"));
        assert!(Form { duration: "0".into(), ..Form::default() }.check(None).is_ok(), "a heave comes back by itself");
    }

    #[test]
    fn refusals_lose_the_names_of_the_wire() {
        assert_eq!(plain("radius_m is 5: it must be 0.01 to 4"), "radius is 5 m: it must be 0.01 to 4 m");
        assert_eq!(
            plain("the path reaches y 2.40 m, limit 2 m"),
            "the path goes 2.40 m north or south of the middle, limit 2 m"
        );
        assert_eq!(
            plain("the path reaches climb 0.64 m/s, limit 0.6 m/s"),
            "the path climbs at 0.64 m/s, limit 0.6 m/s"
        );
        assert_eq!(plain("take off first: a shape begins in the air"), "take off first: a shape begins in the air");
    }

    #[test]
    fn modes() {
        assert!(Shape::Circle.unfit(Mode::AltitudeHold).is_some() && Shape::Circle.unfit(Mode::Hold).is_none());
        assert!(Shape::Heave.unfit(Mode::AltitudeHold).is_none() && Shape::Heave.unfit(Mode::Stabilise).is_some());
    }
}
