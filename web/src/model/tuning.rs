//! A design as people give it: deviations with units instead of weights.
//!
//! A weight is 1/(largest deviation)² (Bryson's rule): the page shows and takes the deviation, in degrees
//! where it is an angle. A weight of zero is a deviation that costs nothing.

use std::collections::BTreeMap;

use plumbline_proto::v1::GainsInUse;
use plumbline_rest::design::{Controller, Design, Gains, Preview};

use super::{curves::DEGREES, live::Log};

/// States and integrals in the order of the weights: name, unit on the page, page units of one wire unit.
pub const STATES: [(&str, &str, f64); 16] = [
    ("east", "m", 1.0),
    ("north", "m", 1.0),
    ("altitude", "m", 1.0),
    ("speed east", "m/s", 1.0),
    ("speed north", "m/s", 1.0),
    ("climb", "m/s", 1.0),
    ("roll", "°", DEGREES),
    ("pitch", "°", DEGREES),
    ("yaw", "°", DEGREES),
    ("roll rate", "°/s", DEGREES),
    ("pitch rate", "°/s", DEGREES),
    ("yaw rate", "°/s", DEGREES),
    ("∫ east", "m s", 1.0),
    ("∫ north", "m s", 1.0),
    ("∫ altitude", "m s", 1.0),
    ("∫ yaw", "° s", DEGREES),
];

/// Inputs in the order of the weights.
pub const INPUTS: [(&str, &str, f64); 4] =
    [("thrust", "N", 1.0), ("torque roll", "N m", 1.0), ("torque pitch", "N m", 1.0), ("torque yaw", "N m", 1.0)];

/// The controller of a design that names none.
const FIRST: &str = "lqr_integral";
/// A slider covers this many times its middle, both ways.
const SLIDER_RANGE: f64 = 30.0;

/// A controller's name for people.
pub fn title(controller: &str) -> String {
    match controller {
        "lqr_integral" => "LQR with integrals".into(),
        "lqr" => "LQR".into(),
        "lqg" => "LQG".into(),
        "hinf" => "H∞".into(),
        "pid" => "cascaded PID".into(),
        other => other.replace('_', " "),
    }
}

/// A design being made.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Draft {
    /// Kind of controller, by its name on the wire.
    pub controller: String,
    /// Largest deviation of each state, wire units; infinite where it costs nothing.
    pub states: Vec<f64>,
    /// Largest use of each input, wire units.
    pub inputs: Vec<f64>,
    /// Parameters by name.
    pub parameters: BTreeMap<String, f64>,
}

fn deviations(weights: &[f64]) -> Vec<f64> {
    weights.iter().map(|w| if *w > 0.0 { w.powf(-0.5) } else { f64::INFINITY }).collect()
}

fn weights(deviations: &[f64]) -> Vec<f64> {
    deviations.iter().map(|d| if d.is_finite() && *d > 0.0 { d.powi(-2) } else { 0.0 }).collect()
}

impl Draft {
    /// The defaults of `kind`: Bryson's rule.
    pub fn default_of(kind: &Controller) -> Self {
        Self {
            controller: kind.controller.clone(),
            states: deviations(kind.state_weight.as_deref().unwrap_or_default()),
            inputs: deviations(kind.input_weight.as_deref().unwrap_or_default()),
            parameters: kind.parameters.iter().map(|p| (p.name.clone(), p.value)).collect(),
        }
    }

    /// A design or exported gains; what it leaves out keeps the defaults of its kind.
    ///
    /// # Errors
    /// What is wrong with it, with name and value.
    pub fn of(design: &Design, kinds: &[Controller]) -> Result<Self, String> {
        let name = design.controller.as_deref().unwrap_or(FIRST);
        let name = if name == "lqi" { FIRST } else { name };
        let kind =
            kinds.iter().find(|k| k.controller == name).ok_or_else(|| format!("controller {name:?} is not known"))?;
        let mut draft = Self::default_of(kind);
        let list = |key: &str, values: &Option<Vec<f64>>, length: usize| match values {
            Some(values) if values.len() != length => {
                Err(format!("{key} has {} numbers, {length} are needed", values.len()))
            }
            values => Ok(values.as_deref().map(deviations)),
        };
        if kind.weighted {
            if let Some(states) = list("state_weight", &design.state_weight, STATES.len())? {
                draft.states = states;
            }
            if let Some(inputs) = list("input_weight", &design.input_weight, INPUTS.len())? {
                draft.inputs = inputs;
            }
        }
        for (name, value) in &design.parameters {
            match draft.parameters.get_mut(name) {
                Some(known) => *known = *value,
                None => return Err(format!("{} has no parameter {name:?}", draft.controller)),
            }
        }
        Ok(draft)
    }

    /// As the ground wants it.
    pub fn design(&self) -> Design {
        let weighted = !self.states.is_empty();
        Design {
            controller: Some(self.controller.clone()),
            state_weight: weighted.then(|| weights(&self.states)),
            input_weight: weighted.then(|| weights(&self.inputs)),
            parameters: self.parameters.clone(),
            ..Design::default()
        }
    }
}

/// Place of a slider (0 to 1) for `value`, on a logarithmic scale about `middle`.
pub fn slider_place(value: f64, middle: f64) -> f64 {
    if !value.is_finite() {
        return 1.0;
    }
    (0.5 + (value / middle).ln() / (2.0 * SLIDER_RANGE.ln())).clamp(0.0, 1.0)
}

/// Value at a slider's place, to three digits.
pub fn slider_value(place: f64, middle: f64) -> f64 {
    let value = middle * ((place - 0.5) * 2.0 * SLIDER_RANGE.ln()).exp();
    let digit = 10f64.powi(value.abs().log10().floor() as i32 - 2);
    (value / digit).round() * digit
}

/// A number in as few characters as three digits need.
pub fn short(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    if value != 0.0 && value.abs() < 1e-4 {
        return format!("{value:.2e}");
    }
    let decimals = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 5) as usize };
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// One entry of K in words: what it would be, and what is in use.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// As designed.
    pub new: String,
    /// In use; empty where that is not known.
    pub in_use: String,
    /// Are they different in what is shown?
    pub changed: bool,
}

/// K against the K in use: a row for each state and integral that either uses, a column for each input.
pub fn gains_table(preview: &Preview) -> Vec<(&'static str, Vec<Entry>)> {
    let Some(k) = &preview.k else { return Vec::new() };
    let of = |k: &[Vec<f64>], input: usize, state: usize| k.get(input).and_then(|row| row.get(state)).copied();
    let entry = |state: usize, input: usize| {
        let new = of(k, input, state).unwrap_or(0.0);
        let old = preview.k_in_use.as_ref().and_then(|old| of(old, input, state));
        let shown = |v: f64| if v.abs() < 5e-6 { "0".to_owned() } else { short(v) };
        let (new, in_use) = (shown(new), old.map(shown).unwrap_or_default());
        Entry { changed: !in_use.is_empty() && new != in_use, new, in_use }
    };
    let rows = STATES
        .iter()
        .enumerate()
        .map(|(i, (name, ..))| (*name, (0..INPUTS.len()).map(|input| entry(i, input)).collect::<Vec<_>>()));
    let used = |entries: &[Entry]| entries.iter().any(|e| e.new != "0" || !matches!(e.in_use.as_str(), "" | "0"));
    rows.filter(|(_, entries)| used(entries)).collect()
}

/// A pole of a sampled loop as a rate, 1/s: ln(z)/T.
pub fn rate_of(z: [f64; 2], tick_rate_hz: f64) -> [f64; 2] {
    [z[0].hypot(z[1]).ln() * tick_rate_hz, z[1].atan2(z[0]) * tick_rate_hz]
}

/// What is in use, as a design; `None` until the vehicle has reported it.
pub fn in_use(gains: &Gains) -> Option<Design> {
    gains.revision?;
    let full = |list: &Option<Vec<f64>>| list.clone().filter(|l| !l.is_empty());
    let weights = full(&gains.state_weight).zip(full(&gains.input_weight));
    let (state_weight, input_weight) = weights.unzip();
    Some(Design {
        controller: gains.controller.clone().filter(|name| !name.is_empty()),
        state_weight,
        input_weight,
        parameters: gains.parameters.clone().unwrap_or_default(),
        ..Design::default()
    })
}

/// Gains that flew, as a design to push again; `None` of a K given outright.
pub fn flown(gains: &GainsInUse) -> Option<Design> {
    if gains.weights.is_none() && gains.parameters.is_empty() {
        return None;
    }
    let (state_weight, input_weight) =
        gains.weights.as_ref().map(|w| (w.state_weight.clone(), w.input_weight.clone())).unzip();
    Some(Design {
        controller: Some(gains.controller.clone()).filter(|name| !name.is_empty()),
        state_weight,
        input_weight,
        parameters: gains.parameters.iter().map(|p| (p.name.clone(), p.value)).collect(),
        ..Design::default()
    })
}

/// The gains that the flight began with.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// Not flying, or the beginning is not known here.
    Unknown,
    /// They are in use.
    InUse,
    /// The ground can push this revision again.
    Revision(u32),
    /// What the agent started with, which no book has.
    Configured(Box<Design>),
}

/// What this flight began with, which is `begin_s` of flight time, against what is in use.
pub fn start(log: &Log, begin_s: f64, in_use: Option<u32>) -> Start {
    match log.gains_at(begin_s).filter(|_| begin_s > 0.0) {
        None => Start::Unknown,
        first if first == in_use => Start::InUse,
        Some(0) => log.gains.get(&0).and_then(flown).map_or(Start::Unknown, |design| Start::Configured(design.into())),
        Some(revision) => Start::Revision(revision),
    }
}

/// Two numbers of a draft that are the same but for the way over a weight.
pub fn same(a: f64, b: f64) -> bool {
    a == b || (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

#[cfg(test)]
mod tests {
    use plumbline_proto::v1;
    use plumbline_rest::design::Parameter;

    use super::*;

    fn kinds() -> Vec<Controller> {
        let lqr = Controller {
            controller: "lqr_integral".into(),
            weighted: true,
            state_weight: Some(vec![4.0; 16]),
            input_weight: Some(vec![0.25; 4]),
            ..Controller::default()
        };
        let gain = Parameter { name: "tilt_p".into(), value: 6.0, min: 0.0, max: 20.0, unit: "1/s".into() };
        let pid = Controller { controller: "pid".into(), parameters: vec![gain], ..Controller::default() };
        vec![lqr, pid]
    }

    #[test]
    fn deviations_become_weights_and_back() {
        let draft = Draft::default_of(&kinds()[0]);
        assert_eq!((draft.states[0], draft.inputs[0]), (0.5, 2.0));
        let mut design = draft.design();
        let state_weight = design.state_weight.as_mut().unwrap();
        assert_eq!(state_weight[3], 4.0);
        state_weight[0] = 0.0;
        let read = Draft::of(&design, &kinds()).unwrap();
        assert!(read.states[0].is_infinite());
        assert_eq!(read.design().state_weight.unwrap()[0], 0.0);
    }

    #[test]
    fn a_design_is_refused_with_what_is_wrong_in_it() {
        let tuned = |name: &str| Design {
            controller: Some("pid".into()),
            parameters: BTreeMap::from([(name.to_owned(), 7.5)]),
            ..Design::default()
        };
        for (design, mentions) in [
            (Design { controller: Some("magic".into()), ..Design::default() }, "magic"),
            (Design { state_weight: Some(vec![1.0]), ..Design::default() }, "1 numbers"),
            (tuned("tilt_q"), "tilt_q"),
        ] {
            let error = Draft::of(&design, &kinds()).unwrap_err();
            assert!(error.contains(mentions), "{error}");
        }
        assert_eq!(Draft::of(&tuned("tilt_p"), &kinds()).unwrap().design(), tuned("tilt_p"));
    }

    #[test]
    fn sliders_are_logarithmic_and_give_back_what_they_show() {
        assert_eq!(slider_value(0.5, 0.2), 0.2);
        for place in [0.1, 0.33, 0.5, 0.9] {
            assert!((slider_place(slider_value(place, 0.2), 0.2) - place).abs() < 2e-3);
        }
        assert_eq!(slider_place(f64::INFINITY, 1.0), 1.0);
        assert_eq!(
            (short(0.2), short(12.345), short(0.0123), short(1500.0), short(6.04e-8)),
            ("0.2".into(), "12.3".into(), "0.0123".into(), "1500".into(), "6.04e-8".into())
        );
    }

    #[test]
    fn gains_stand_beside_those_in_use() {
        let mut k = vec![vec![0.0; 16]; 4];
        (k[0][2], k[0][5]) = (29.41234, 9.5);
        let mut old = k.clone();
        (old[0][5], old[3][15]) = (8.0, 0.25);
        let table = gains_table(&Preview { k: Some(k.clone()), k_in_use: Some(old), ..Preview::default() });
        let names: Vec<&str> = table.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["altitude", "climb", "∫ yaw"], "rows that nobody uses are left out");
        assert_eq!(table[0].1[0], Entry { new: "29.4".into(), in_use: "29.4".into(), changed: false });
        assert_eq!(table[1].1[0], Entry { new: "9.5".into(), in_use: "8".into(), changed: true });
        assert_eq!(table[2].1[3], Entry { new: "0".into(), in_use: "0.25".into(), changed: true });
        let alone = gains_table(&Preview { k: Some(k), ..Preview::default() });
        assert!(alone.iter().all(|(_, entries)| entries.iter().all(|e| e.in_use.is_empty() && !e.changed)));
        assert!(gains_table(&Preview::default()).is_empty(), "a law without K");
    }

    #[test]
    fn a_pole_becomes_a_rate() {
        let rate = rate_of([0.98, 0.0], 200.0);
        assert!((rate[0] + 4.04).abs() < 0.01 && rate[1] == 0.0);
    }

    #[test]
    fn the_gains_a_flight_began_with_are_found_and_pushed_again() {
        let mut log = Log::default();
        let status =
            |at_s: u64, gains| v1::Status { time_us: at_s * 1_000_000, gains_revision: gains, ..Default::default() };
        log.status(&status(1, 0));
        log.status(&status(30, 1));
        log.status(&status(60, 2));
        assert_eq!(start(&log, 0.0, Some(2)), Start::Unknown, "no flight");
        assert_eq!(start(&log, 10.0, Some(2)), Start::Unknown, "nobody here has seen them");
        let weights = v1::LqrWeights { state_weight: vec![4.0; 16], input_weight: vec![0.25; 4] };
        log.gains(GainsInUse { controller: "lqr_integral".into(), weights: Some(weights), ..Default::default() });
        let Start::Configured(design) = start(&log, 10.0, Some(2)) else { panic!("not as configured") };
        assert_eq!(Draft::of(&design, &kinds()).unwrap().states, [0.5; 16]);
        assert_eq!(start(&log, 40.0, Some(2)), Start::Revision(1));
        assert_eq!(start(&log, 70.0, Some(2)), Start::InUse);
        assert_eq!(flown(&GainsInUse::default()), None, "a K given outright");
        assert!(same(0.2, (0.2_f64.powi(-2)).powf(-0.5)) && same(f64::INFINITY, f64::INFINITY) && !same(0.2, 0.201));
    }

    #[test]
    fn what_is_in_use_is_a_design_once_it_was_reported() {
        assert_eq!(in_use(&Gains::default()), None);
        let outright = Gains { revision: Some(0), state_weight: Some(Vec::new()), ..Gains::default() };
        assert_eq!(in_use(&outright), Some(Design::default()));
        let weights = Gains { state_weight: Some(vec![4.0; 16]), input_weight: Some(vec![0.25; 4]), ..outright };
        assert_eq!(Draft::of(&in_use(&weights).unwrap(), &kinds()).unwrap().states, [0.5; 16]);
    }
}
