//! A layout: which charts stand on a page, of which signals, with which curves unfolded, over which window. It is kept as the
//! query of an address, so that a reload, a link and a layout saved under a name are one thing.

use super::{
    curves::{Axis, Group},
    signals,
};

/// What stands below altitude and attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Evidence {
    /// Innovation ratio of every sensor.
    #[default]
    Residuals,
    /// What the secure estimator finds of every sensor.
    Secure,
    /// What each estimator is off by.
    Errors,
    /// Signals, one on each chart.
    Signals,
}

impl Evidence {
    const ALL: [Self; 4] = [Self::Residuals, Self::Secure, Self::Errors, Self::Signals];

    const fn name(self) -> &'static str {
        match self {
            Self::Residuals => "residuals",
            Self::Secure => "secure",
            Self::Errors => "errors",
            Self::Signals => "signals",
        }
    }
}

/// Names and values of a query.
pub type Query = Vec<(String, String)>;

/// See the module documentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// What stands below altitude and attitude.
    pub evidence: Evidence,
    /// Axis whose errors are shown.
    pub axis: Axis,
    /// Signals on charts of their own, and whether each shows its spectrum.
    pub signals: Vec<(String, bool)>,
    /// Groups of curves that legends unfold; none at first, so that a chart begins with four curves at most.
    pub unfolded: Vec<Group>,
    /// Is the velocity shown below the errors, in the place of the attitude?
    pub velocity: bool,
    /// Are the motors and the time of a tick charted?
    pub motors: bool,
    /// The vehicle in space instead of the horizon?
    pub space: bool,
    /// In the middle of the page, over the altitude, instead of the other charts?
    pub wide: bool,
    /// Length of the window of live charts, s; `None` where nothing is said, and of recorded flights.
    pub window_s: Option<f64>,
}

/// Names of its parts in a query.
const EVIDENCE: &str = "show";
const AXIS: &str = "axis";
const SIGNALS: &str = "signals";
const GROUPS: &str = "groups";
const VELOCITY: &str = "velocity";
const MOTORS: &str = "motors";
const SPACE: &str = "space";
const WIDE: &str = "wide";
const WINDOW: &str = "window";
const ALL: [&str; 9] = [EVIDENCE, AXIS, SIGNALS, GROUPS, VELOCITY, MOTORS, SPACE, WIDE, WINDOW];

impl Default for Layout {
    fn default() -> Self {
        Self {
            evidence: Evidence::Residuals,
            axis: Axis::Roll,
            signals: Vec::new(),
            unfolded: Vec::new(),
            velocity: false,
            motors: false,
            space: false,
            wide: false,
            window_s: None,
        }
    }
}

impl Layout {
    /// What it shows below altitude and attitude where nothing is said of that.
    fn usual(&self) -> Evidence {
        if self.signals.is_empty() { Evidence::Residuals } else { Evidence::Signals }
    }

    /// As a query: what is not as it would be without a word.
    pub fn query(&self) -> Query {
        let usual = Self::default();
        let on = |on: bool| on.then(|| "1".to_owned());
        let parts = [
            (
                SIGNALS,
                Some(signals::told(self.signals.iter().map(|(name, on)| (name.as_str(), *on))))
                    .filter(|t| !t.is_empty()),
            ),
            (EVIDENCE, (self.evidence != self.usual()).then(|| self.evidence.name().to_owned())),
            (AXIS, (self.axis != usual.axis).then(|| self.axis.name().to_owned())),
            (GROUPS, (self.unfolded != usual.unfolded).then(|| group_names(&self.unfolded))),
            (VELOCITY, on(self.velocity)),
            (MOTORS, on(self.motors)),
            (SPACE, on(self.space)),
            (WIDE, on(self.wide)),
            (WINDOW, self.window_s.map(|s| format!("{s}"))),
        ];
        parts.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    }

    /// From the values that a query has of a name; `None` where it has nothing of a layout. What cannot be read is as usual.
    pub fn read(all: impl Fn(&str) -> Vec<String>) -> Option<Self> {
        if ALL.iter().all(|name| all(name).is_empty()) {
            return None;
        }
        let one = |name: &str| all(name).into_iter().next();
        let mut layout = Self::default();
        layout.signals = all(SIGNALS).iter().flat_map(|text| signals::read(text)).collect();
        layout.evidence = layout.usual();
        if let Some(named) = one(EVIDENCE).and_then(|n| Evidence::ALL.into_iter().find(|e| e.name() == n)) {
            layout.evidence = named;
        }
        if let Some(named) = one(AXIS).and_then(|n| Axis::ALL.into_iter().find(|a| a.name() == n)) {
            layout.axis = named;
        }
        if let Some(names) = one(GROUPS) {
            layout.unfolded = groups_of(&names);
        }
        layout.velocity = one(VELOCITY).is_some();
        (layout.motors, layout.space) = (one(MOTORS).is_some(), one(SPACE).is_some());
        layout.wide = one(WIDE).is_some();
        layout.window_s = one(WINDOW).and_then(|text| text.parse().ok()).filter(|s: &f64| s.is_finite());
        Some(layout)
    }
}

/// Groups of curves as one text; none is an empty one.
pub fn group_names(groups: &[Group]) -> String {
    groups.iter().map(|group| group.name()).collect::<Vec<_>>().join(",")
}

/// The reverse.
pub fn groups_of(names: &str) -> Vec<Group> {
    Group::ALL.into_iter().filter(|group| names.split(',').any(|name| name == group.name())).collect()
}

/// A layout kept under a name.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Saved {
    /// As its maker calls it.
    pub name: String,
    /// What it is.
    pub query: Query,
}

impl Saved {
    /// The layout; the usual one where there is nothing to be said of it.
    pub fn layout(&self) -> Layout {
        let of = |name: &str| self.query.iter().filter(|(of, _)| of == name).map(|(_, value)| value.clone()).collect();
        Layout::read(of).unwrap_or_default()
    }
}

/// Keeps a layout under a name (without blanks around it), in the place of what had it; sorted by name. False without a name.
pub fn save(all: &mut Vec<Saved>, name: &str, layout: &Layout) -> bool {
    let name = name.trim();
    if name.is_empty() {
        return false;
    }
    all.retain(|saved| saved.name != name);
    all.push(Saved { name: name.to_owned(), query: layout.query() });
    all.sort_by(|a, b| a.name.cmp(&b.name));
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::curves::Curve;

    fn read(query: &Query) -> Option<Layout> {
        Layout::read(|name| query.iter().filter(|(of, _)| of == name).map(|(_, value)| value.clone()).collect())
    }

    #[test]
    fn what_an_address_says_is_what_was_shown() {
        let layouts = [
            Layout {
                evidence: Evidence::Signals,
                signals: vec![
                    ("imu_1.gyro_radps.x".into(), true),
                    ("residuals_1[height 2 height].ratio".into(), false),
                ],
                ..Layout::default()
            },
            Layout {
                evidence: Evidence::Errors,
                axis: Axis::Yaw,
                unfolded: vec![Group::Estimators, Group::Heights],
                velocity: true,
                motors: true,
                space: true,
                wide: true,
                window_s: Some(120.0),
                ..Layout::default()
            },
            Layout {
                signals: vec![("status.tick_time_p99_us".into(), false)],
                unfolded: vec![Group::Truth],
                ..Layout::default()
            },
        ];
        for layout in layouts {
            assert_eq!(read(&layout.query()), Some(layout.clone()), "{:?}", layout.query());
        }
        assert_eq!((Layout::default().query(), read(&Vec::new())), (Vec::new(), None));
        let signals = Layout { evidence: Evidence::Signals, signals: vec![("a.b".into(), false)], ..Layout::default() };
        assert_eq!(signals.query(), [("signals".to_owned(), "a.b".to_owned())]);
    }

    #[test]
    fn nonsense_in_an_address_shows_the_usual() {
        let query = [("show", "nothing"), ("axis", "up"), ("window", "NaN"), ("groups", "sensors")];
        let layout = read(&query.map(|(name, value)| (name.to_owned(), value.to_owned())).to_vec()).unwrap();
        assert_eq!(layout, Layout::default());
    }

    #[test]
    fn a_chart_begins_with_four_curves_at_most() {
        let in_loop = 1;
        let first = |all: Vec<Curve>| {
            let unfolded = Layout::default().unfolded;
            all.into_iter().filter(|curve| curve.group(in_loop).is_none_or(|group| unfolded.contains(&group))).count()
        };
        let estimators = (1..10).map(Curve::Altitude);
        let heights = (1..4).map(Curve::Height).chain([false, true].map(Curve::Reach));
        let alone = [Curve::SetpointAltitude, Curve::TruthAltitude];
        assert_eq!(first(estimators.chain(heights).chain(alone).collect()), 3, "setpoint, estimate, truth");
        let angles = |curve: fn(Axis) -> Curve| Axis::ALL.map(curve);
        let attitude = [angles(|axis| Curve::Attitude(1, axis)), angles(Curve::TruthAttitude)];
        assert_eq!(first(attitude.concat()), 3, "roll, pitch, yaw");
    }

    #[test]
    fn a_name_holds_one_layout() {
        let mut all = Vec::new();
        let errors = Layout { evidence: Evidence::Errors, ..Layout::default() };
        assert!(
            save(&mut all, " mine ", &Layout::default())
                && save(&mut all, "a", &errors)
                && save(&mut all, "mine", &errors)
        );
        assert_eq!(all.iter().map(|saved| saved.name.as_str()).collect::<Vec<_>>(), ["a", "mine"]);
        assert_eq!(all[1].layout(), errors);
        assert!(!save(&mut all, "  ", &errors) && all.len() == 2);
    }
}
