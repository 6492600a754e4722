//! A design as people give it: deviations with units instead of weights, and what the ground answers.
//!
//! A weight is 1/(largest deviation)² (Bryson's rule): the page shows and takes the deviation, in degrees
//! where it is an angle. A weight of zero is a deviation that costs nothing.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::{Value, json};

use super::curves::DEGREES;

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

/// A slider covers this many times its middle, both ways.
const SLIDER_RANGE: f64 = 30.0;

/// One controller that can be chosen, as `GET /api/v1/design/controllers` lists it.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Kind {
    /// Its name on the wire.
    pub controller: String,
    /// Does it come from weights?
    pub weighted: bool,
    /// What it has beyond them.
    pub parameters: Vec<Parameter>,
    /// Bryson's rule for the airframe.
    pub state_weight: Option<Vec<f64>>,
    /// Bryson's rule for the airframe.
    pub input_weight: Option<Vec<f64>>,
}

/// A parameter and what it may be.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Parameter {
    pub name: String,
    pub unit: String,
    pub min: f64,
    pub max: f64,
    pub value: f64,
}

/// The answer of `GET /api/v1/design/controllers`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Kinds {
    pub airframe: String,
    pub controllers: Vec<Kind>,
}

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
    pub fn default_of(kind: &Kind) -> Self {
        Self {
            controller: kind.controller.clone(),
            states: deviations(kind.state_weight.as_deref().unwrap_or_default()),
            inputs: deviations(kind.input_weight.as_deref().unwrap_or_default()),
            parameters: kind.parameters.iter().map(|p| (p.name.clone(), p.value)).collect(),
        }
    }

    /// A design or exported gains, as JSON; what it leaves out keeps the defaults of its kind.
    ///
    /// # Errors
    /// What is wrong with it, with name and value.
    pub fn from_json(design: &Value, kinds: &[Kind]) -> Result<Self, String> {
        let name = design.get("controller").and_then(Value::as_str).unwrap_or("lqr_integral");
        let name = if name == "lqi" { "lqr_integral" } else { name };
        let kind =
            kinds.iter().find(|k| k.controller == name).ok_or_else(|| format!("controller {name:?} is not known"))?;
        let mut draft = Self::default_of(kind);
        let list = |key: &str, length: usize| -> Result<Option<Vec<f64>>, String> {
            let Some(values) = design.get(key).and_then(Value::as_array) else { return Ok(None) };
            let values: Vec<f64> = values.iter().filter_map(Value::as_f64).collect();
            if values.len() != length {
                return Err(format!("{key} has {} numbers, {length} are needed", values.len()));
            }
            Ok(Some(values))
        };
        if kind.weighted {
            if let Some(state) = list("state_weight", STATES.len())? {
                draft.states = deviations(&state);
            }
            if let Some(input) = list("input_weight", INPUTS.len())? {
                draft.inputs = deviations(&input);
            }
        }
        for (name, value) in design.get("parameters").and_then(Value::as_object).into_iter().flatten() {
            let value = value.as_f64().ok_or_else(|| format!("parameter {name} is {value}, a number is needed"))?;
            match draft.parameters.get_mut(name) {
                Some(known) => *known = value,
                None => return Err(format!("{} has no parameter {name:?}", draft.controller)),
            }
        }
        Ok(draft)
    }

    /// As the ground wants it.
    pub fn to_json(&self) -> Value {
        let mut out = json!({ "controller": self.controller, "parameters": self.parameters });
        if !self.states.is_empty() {
            out["state_weight"] = json!(weights(&self.states));
            out["input_weight"] = json!(weights(&self.inputs));
        }
        out
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

/// The answer of `POST /api/v1/design/preview`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Preview {
    pub tick_rate_hz: f64,
    pub accepted: bool,
    pub refusal: Option<String>,
    pub policy: Policy,
    pub position: Examined,
    pub attitude: Examined,
    pub unit_step: Vec<Share>,
    pub change: Option<Change>,
    /// K, rows thrust, torque roll, pitch, yaw; columns as the weights. Absent where the law has none.
    pub k: Option<Vec<Vec<f64>>>,
    /// The one in use, the same way.
    pub k_in_use: Option<Vec<Vec<f64>>>,
    pub steps: Vec<Flown>,
    pub gains: Option<Value>,
}

/// What the vehicle's loops must forgive.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Policy {
    pub name: String,
    pub gain_up_min: f64,
    pub gain_down_max: f64,
    pub phase_min_rad: f64,
    pub delay_min_s: f64,
    pub sensitivity_max: f64,
    pub slowest_pole_per_s: f64,
    pub change_max: f64,
    pub unit_step_max: f64,
}

/// Poles and margins of one loop.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Examined {
    pub continuous_poles_per_s: Vec<[Option<f64>; 2]>,
    pub sampled_poles: Vec<[Option<f64>; 2]>,
    pub slowest_pole_per_s: Option<f64>,
    pub peak_sensitivity: Option<f64>,
    pub margins: Vec<Margin>,
}

/// Margins of one input; absent where there is no limit.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Margin {
    pub input: String,
    pub gain_up: Option<f64>,
    pub gain_down: Option<f64>,
    pub phase_rad: Option<f64>,
    pub delay_s: Option<f64>,
    pub peak_sensitivity: Option<f64>,
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

impl Preview {
    /// K against the K in use: a row for each state and integral that either uses, a column for each input.
    pub fn gains_table(&self) -> Vec<(&'static str, Vec<Entry>)> {
        let Some(k) = &self.k else { return Vec::new() };
        let of = |k: &[Vec<f64>], input: usize, state: usize| k.get(input).and_then(|row| row.get(state)).copied();
        let entry = |state: usize, input: usize| {
            let new = of(k, input, state).unwrap_or(0.0);
            let old = self.k_in_use.as_ref().and_then(|old| of(old, input, state));
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
}

/// Largest command of a unit step, as a share of what there is.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Share {
    pub output: String,
    pub unit: String,
    pub share: Option<f64>,
}

/// Change of K against the one in use.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Change {
    pub largest: Option<f64>,
    pub row: Option<String>,
    pub rows: BTreeMap<String, Option<f64>>,
}

/// A step flown on the nonlinear model.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Flown {
    pub output: String,
    pub unit: String,
    pub size: f64,
    pub t_s: Vec<Option<f64>>,
    pub setpoint: Vec<Option<f64>>,
    pub response: Vec<Option<f64>>,
    pub rise_time_s: Option<f64>,
    pub overshoot_percent: Option<f64>,
    pub settling_time_s: Option<f64>,
    pub saturated_s: Option<f64>,
    pub stayed: Option<bool>,
}

/// A pole of a sampled loop as a rate, 1/s: ln(z)/T.
pub fn rate_of(z: [f64; 2], tick_rate_hz: f64) -> [f64; 2] {
    [z[0].hypot(z[1]).ln() * tick_rate_hz, z[1].atan2(z[0]) * tick_rate_hz]
}

/// What the ground says of a vehicle's gains.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct GainsBook {
    /// Revision in use.
    pub revision: Option<u32>,
    /// Kind in use.
    pub controller: Option<String>,
    /// Its weights.
    pub state_weight: Option<Vec<f64>>,
    /// Its weights.
    pub input_weight: Option<Vec<f64>>,
    /// Its parameters, by name.
    pub parameters: Option<BTreeMap<String, f64>>,
    /// Every push, the oldest first.
    pub revisions: Vec<Revision>,
}

impl GainsBook {
    /// What is in use, as a design.
    pub fn design(&self) -> Option<Value> {
        self.revision?;
        let controller = match self.controller.as_deref() {
            Some(name) if !name.is_empty() => name,
            _ => "lqr_integral",
        };
        let mut out = json!({ "controller": controller, "parameters": self.parameters.clone().unwrap_or_default() });
        let full = |list: &Option<Vec<f64>>| list.clone().filter(|l| !l.is_empty());
        if let (Some(state), Some(input)) = (full(&self.state_weight), full(&self.input_weight)) {
            out["state_weight"] = json!(state);
            out["input_weight"] = json!(input);
        }
        Some(out)
    }
}

/// One push of gains.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Revision {
    pub revision: u32,
    pub operator: String,
    pub pushed_unix_us: u64,
    pub stage: String,
    pub reason: String,
    pub controller: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds() -> Vec<Kind> {
        let lqr = Kind {
            controller: "lqr_integral".into(),
            weighted: true,
            state_weight: Some(vec![4.0; 16]),
            input_weight: Some(vec![0.25; 4]),
            ..Kind::default()
        };
        let gain = Parameter { name: "tilt_p".into(), value: 6.0, min: 0.0, max: 20.0, unit: "1/s".into() };
        let pid = Kind { controller: "pid".into(), parameters: vec![gain], ..Kind::default() };
        vec![lqr, pid]
    }

    #[test]
    fn deviations_become_weights_and_back() {
        let draft = Draft::default_of(&kinds()[0]);
        assert_eq!((draft.states[0], draft.inputs[0]), (0.5, 2.0));
        let mut design = draft.to_json();
        assert_eq!(design["state_weight"][3], 4.0);
        design["state_weight"][0] = json!(0.0);
        let read = Draft::from_json(&design, &kinds()).unwrap();
        assert!(read.states[0].is_infinite());
        assert_eq!(read.to_json()["state_weight"][0], 0.0);
    }

    #[test]
    fn a_file_is_refused_with_what_is_wrong_in_it() {
        for (design, mentions) in [
            (json!({ "controller": "magic" }), "magic"),
            (json!({ "state_weight": [1.0] }), "1 numbers"),
            (json!({ "controller": "pid", "parameters": { "tilt_q": 1.0 } }), "tilt_q"),
            (json!({ "controller": "pid", "parameters": { "tilt_p": "much" } }), "much"),
        ] {
            let error = Draft::from_json(&design, &kinds()).unwrap_err();
            assert!(error.contains(mentions), "{error}");
        }
        let pid = Draft::from_json(&json!({ "controller": "pid", "parameters": { "tilt_p": 7.5 } }), &kinds()).unwrap();
        assert_eq!(pid.to_json(), json!({ "controller": "pid", "parameters": { "tilt_p": 7.5 } }));
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
        let table = Preview { k: Some(k.clone()), k_in_use: Some(old), ..Preview::default() }.gains_table();
        let names: Vec<&str> = table.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["altitude", "climb", "∫ yaw"], "rows that nobody uses are left out");
        assert_eq!(table[0].1[0], Entry { new: "29.4".into(), in_use: "29.4".into(), changed: false });
        assert_eq!(table[1].1[0], Entry { new: "9.5".into(), in_use: "8".into(), changed: true });
        assert_eq!(table[2].1[3], Entry { new: "0".into(), in_use: "0.25".into(), changed: true });
        let alone = Preview { k: Some(k), ..Preview::default() }.gains_table();
        assert!(alone.iter().all(|(_, entries)| entries.iter().all(|e| e.in_use.is_empty() && !e.changed)));
        assert!(Preview::default().gains_table().is_empty(), "a law without K");
    }

    #[test]
    fn an_answer_is_read_with_its_infinities() {
        let text = r#"{"controller":"lqr","accepted":false,"refusal":"phase 12° below 30°","tick_rate_hz":200,
            "position":{"continuous_poles_per_s":[[-3.0,1.0]],"sampled_poles":[[0.98,0.0]],"slowest_pole_per_s":-0.4,
              "margins":[{"input":"thrust","gain_up":null,"gain_down":0.1,"phase_rad":1.0}]},
            "unit_step":[{"output":"x","unit":"m","share":0.4}],
            "steps":[{"output":"x","unit":"m","size":0.5,"t_s":[0,0.1],"setpoint":[0.5,0.5],"response":[0,null]}]}"#;
        let preview: Preview = serde_json::from_str(text).unwrap();
        assert_eq!(preview.position.margins[0].gain_up, None);
        assert_eq!(preview.steps[0].response, [Some(0.0), None]);
        let rate = rate_of([0.98, 0.0], 200.0);
        assert!((rate[0] + 4.04).abs() < 0.01 && rate[1] == 0.0);
    }
}
