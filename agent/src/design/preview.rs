//! What a design would do, before anybody flies it.
//!
//! Asked (JSON; a design of [`super::file`] and around it):
//! ```json
//! { "controller": "lqr_integral", "state_weight": [...], "input_weight": [...], "parameters": {...},
//!   "airframe": "iris", "tick_rate_hz": 200,
//!   "step": { "x_m": 0.5, "y_m": 0.5, "z_m": 0.5, "yaw_rad": 0.5 }, "duration_s": 8 }
//! ```
//! Everything may be left out. Answered:
//! ```json
//! { "controller": "lqr_integral", "airframe": "iris", "tick_rate_hz": 200,
//!   "accepted": true, "refusal": null,
//!   "policy": { "name": "standard", "gain_up_min": 1.8, "gain_down_max": 0.6, "phase_min_rad": 0.35,
//!               "delay_min_s": 0.015, "sensitivity_max": 3.1, "slowest_pole_per_s": -0.02, "change_max": 4,
//!               "unit_step_max": 60 },
//!   "position": LOOP, "attitude": LOOP,
//!   "unit_step": [ { "output": "x", "unit": "m", "share": 1.2 }, ... y, z, yaw ],
//!   "change": { "largest": 0.4, "row": "thrust", "rows": { "thrust": 0.4, "torque x": ... } },
//!   "k": [[16 of thrust], [torque x], [torque y], [torque z]], "k_in_use": the same,
//!   "steps": [ { "output": "z", "unit": "m", "size": 0.5, "t_s": [...], "setpoint": [...], "response": [...],
//!                "largest_command": [...], "rise_time_s": 0.9, "overshoot_percent": 2, "settling_time_s": 1.8,
//!                "saturated_s": 0, "stayed": true }, ... ],
//!   "gains": exported gains as super::file writes them, "certificate" only when accepted,
//!   "parameters": [ { "name": "tilt_p", "unit": "1/s", "min": 0, "max": 50, "value": 7 }, ... ] }
//! ```
//! with LOOP =
//! ```json
//! { "continuous_poles_per_s": [[re, im], ...], "sampled_poles": [[re, im], ...],
//!   "slowest_pole_per_s": -0.4, "peak_sensitivity": 1.4,
//!   "margins": [ { "input": "thrust", "gain_up": 4.1, "gain_down": 0.2, "phase_rad": 0.9, "delay_s": 0.05,
//!                  "crossover_radps": 8.1, "peak_sensitivity": 1.4 }, ... torque x, torque y, torque z ] }
//! ```
//! - `position` is the loop with x and y controlled, `attitude` the one without. Continuous poles are those
//!   the law was designed for (no lag, no delay, as ln(z)/T); sampled poles, margins and sensitivity have the
//!   motors' lag and one tick of delay in them. A margin of `null` is no limit.
//! - `change` is ‖ΔK‖/‖K‖ against the gains in use; `null` where one of the two is not a K, as are `k` and
//!   `k_in_use` where there is none.
//! - `unit_step`: share of the motors' room that an uncut step of 1 m or 1 rad asks for at once; above 1 the
//!   motors saturate.
//! - Steps are flown on the nonlinear vehicle ([`super::response`]), through the profile that flies.
//! - A design that cannot be solved or whose numbers are wrong is an error; one that is refused for its
//!   margins is an answer with `accepted: false` and the sentence in `refusal`.

use plumbline_proto::ids::GainsRevision;
use serde::Deserialize;
use serde_json::{Value, json};

use super::DesignError;
use super::file::{DesignFile, complex, export, field, finite, loops, number};
use super::response::{Flown, fly_step};
use crate::config::TICK_RATE_HZ;
use crate::control::gains::{Certified, Examiner, Findings, Gain, INPUT_NAMES, OUTPUT_NAMES, change};
use crate::control::law::Law;
use crate::control::margins::{Examination, Margins};
use crate::control::policy::MarginPolicy;
use crate::control::setpoint::Limits;
use crate::control::tuning::{Design, KINDS, Proposal, kind_name, parameters, weighted};
use crate::model::airframe::Airframe;
use crate::telemetry::gains_message;

/// Longest step response, s.
const DURATION_MAX_S: f64 = 30.0;
/// Largest step, m or rad.
const STEP_MAX: f64 = 3.0;
/// Smallest step that is flown: the meter measures none below.
const STEP_MIN: f64 = 0.02;

/// What is asked.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// The vehicle.
    pub airframe: Airframe,
    /// Its ticks, Hz.
    pub tick_rate_hz: f64,
    /// What its loop must forgive.
    pub policy: MarginPolicy,
    /// Limits of the profile.
    pub limits: Limits,
    /// The design.
    pub proposal: Proposal,
    /// K in use, to compare with.
    pub in_use: Option<Gain>,
    /// Steps of x, y, z (m) and yaw (rad).
    pub steps: [f64; 4],
    /// How long each is flown, s.
    pub duration_s: f64,
}

/// What is known of the vehicle that the design is for; the question overrides it.
#[derive(Debug, Clone, PartialEq)]
pub struct Around {
    /// Name of its airframe.
    pub airframe: String,
    /// Hz.
    pub tick_rate_hz: f64,
    /// What it is certified against.
    pub policy: MarginPolicy,
    /// K in use.
    pub in_use: Option<Gain>,
}

impl Default for Around {
    fn default() -> Self {
        Self { airframe: "iris".to_owned(), tick_rate_hz: 200.0, policy: MarginPolicy::default(), in_use: None }
    }
}

/// What a design would do.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// The vehicle's name.
    pub airframe: String,
    /// Hz.
    pub tick_rate_hz: f64,
    /// The whole design.
    pub design: Design,
    /// Solved.
    pub law: Law,
    /// Poles, margins, saturation.
    pub findings: Findings,
    /// Certified, or why not.
    pub verdict: Result<Certified, String>,
    /// What it was judged by.
    pub policy: MarginPolicy,
    /// K in use, where that is known.
    pub in_use: Option<Gain>,
    /// Change of each row of K against the one in use.
    pub changes: Option<[f64; 4]>,
    /// The steps flown.
    pub steps: Vec<Flown>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Steps {
    x_m: Option<f64>,
    y_m: Option<f64>,
    z_m: Option<f64>,
    yaw_rad: Option<f64>,
}

impl Question {
    /// Reads a question; what it leaves out comes from `around`.
    ///
    /// # Errors
    /// [`DesignError`] naming field and value.
    pub fn from_json(text: &[u8], around: &Around) -> Result<Self, DesignError> {
        let mut root: Value = serde_json::from_slice(text)?;
        let object = root.as_object_mut().ok_or(DesignError::NoDesign)?;
        let steps: Steps = match object.remove("step") {
            Some(step) => serde_json::from_value(step)?,
            None => Steps::default(),
        };
        let duration_s = object.remove("duration_s").map(serde_json::from_value::<f64>).transpose()?.unwrap_or(8.0);
        let file: DesignFile = serde_json::from_value(root)?;
        let within = |name: &str, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(value)
            } else {
                Err(field(name, format!("is {value}, it must be {least} to {most}")))
            }
        };
        let airframe = file.airframe.as_deref().unwrap_or(&around.airframe);
        let airframe = Airframe::by_name(airframe).map_err(|e| field("airframe", e.to_string()))?;
        let mut sizes = [0.5; 4];
        let asked = [("x_m", steps.x_m), ("y_m", steps.y_m), ("z_m", steps.z_m), ("yaw_rad", steps.yaw_rad)];
        for (size, (name, asked)) in sizes.iter_mut().zip(asked) {
            if let Some(asked) = asked {
                within(&format!("step.{name}"), asked.abs(), STEP_MIN, STEP_MAX)?;
                *size = finite(name, asked)?;
            }
        }
        Ok(Self {
            airframe,
            tick_rate_hz: within(
                "tick_rate_hz",
                file.tick_rate_hz.unwrap_or(around.tick_rate_hz),
                *TICK_RATE_HZ.start(),
                *TICK_RATE_HZ.end(),
            )?,
            policy: around.policy,
            limits: Limits::default(),
            proposal: file.proposal()?,
            in_use: around.in_use,
            steps: sizes,
            duration_s: within("duration_s", duration_s, 0.5, DURATION_MAX_S)?,
        })
    }
}

/// Solves, examines and flies the design of `question`.
///
/// # Errors
/// When a number is wrong or nothing solves it. A refusal for margins is part of the answer.
pub fn preview(question: &Question) -> Result<Preview, DesignError> {
    let period_s = 1.0 / question.tick_rate_hz;
    let examiner = Examiner::new(&question.airframe, period_s, question.policy)?;
    let design = question.proposal.complete(&question.airframe)?;
    let law = examiner.solve(&design)?;
    let findings = examiner.examine(&law)?;
    let verdict = examiner.certify(&design, GainsRevision(0)).map_err(|e| e.to_string());
    let changes = question.in_use.as_ref().zip(law.gains()).map(|(old, [new, _])| {
        std::array::from_fn(|row| {
            let only = |k: &Gain| Gain::from_fn(|r, c| if r == row { k[(r, c)] } else { 0.0 });
            change(&only(new), &only(old)).1
        })
    });
    let fly = |(output, size): (usize, &f64)| {
        let (limits, duration_s) = (&question.limits, question.duration_s);
        fly_step(&question.airframe, &law, period_s, limits, output, *size, duration_s)
    };
    let steps = question.steps.iter().enumerate().filter_map(fly).collect();
    Ok(Preview {
        airframe: question.airframe.name.clone(),
        tick_rate_hz: question.tick_rate_hz,
        policy: question.policy,
        design,
        findings,
        verdict,
        in_use: question.in_use,
        changes,
        steps,
        law,
    })
}

/// Question and answer as JSON.
///
/// # Errors
/// As [`Question::from_json`] and [`preview`].
pub fn preview_json(text: &[u8], around: &Around) -> Result<Value, DesignError> {
    Ok(preview(&Question::from_json(text, around)?)?.to_json())
}

impl Preview {
    /// As the module says.
    pub fn to_json(&self) -> Value {
        let kind = self.design.kind;
        let table = parameters(kind).iter().zip(&self.design.parameters);
        let unit = |i: usize| if i == 3 { "rad" } else { "m" };
        let shares = OUTPUT_NAMES.iter().zip(self.findings.unit_step).enumerate();
        let p = &self.policy;
        let change = self.changes.map(|rows| {
            let largest = rows.iter().copied().fold(0.0, f64::max);
            let row = rows.iter().position(|v| *v == largest).unwrap_or(0);
            let rows: serde_json::Map<_, _> =
                INPUT_NAMES.iter().zip(rows).map(|(n, v)| ((*n).to_owned(), number(v))).collect();
            json!({ "largest": number(largest), "row": INPUT_NAMES.get(row), "rows": rows })
        });
        json!({
            "controller": kind_name(kind),
            "airframe": self.airframe,
            "tick_rate_hz": self.tick_rate_hz,
            "accepted": self.verdict.is_ok(),
            "refusal": self.verdict.as_ref().err(),
            "policy": {
                "name": p.name,
                "gain_up_min": p.gain_up_min,
                "gain_down_max": p.gain_down_max,
                "phase_min_rad": p.phase_min_rad,
                "delay_min_s": p.delay_min_s,
                "sensitivity_max": p.sensitivity_max,
                "slowest_pole_per_s": p.slowest_pole_per_s,
                "change_max": p.change_max,
                "unit_step_max": p.unit_step_max,
            },
            "position": examined(&self.findings.position),
            "attitude": examined(&self.findings.attitude),
            "unit_step": shares.map(|(i, (output, share))| {
                json!({ "output": output, "unit": unit(i), "share": number(share) })
            }).collect::<Vec<_>>(),
            "change": change,
            "k": self.law.gains().map(|[k, _]| rows(k)),
            "k_in_use": self.in_use.as_ref().map(rows),
            "steps": self.steps.iter().enumerate().map(|(i, step)| flown(step, unit(i))).collect::<Vec<_>>(),
            "gains": self.verdict.as_ref().ok()
                .map(|gains| export(&gains_message(gains), &self.airframe, self.tick_rate_hz)),
            "parameters": table.map(|(p, value)| {
                json!({ "name": p.name, "unit": p.unit, "min": p.min, "max": p.max, "value": value })
            }).collect::<Vec<_>>(),
        })
    }
}

/// Every controller there is, with its parameters and weights for `airframe`:
/// ```json
/// { "airframe": "iris", "controllers": [
///   { "controller": "pid", "weighted": false, "parameters": [ { "name", "unit", "min", "max", "value" } ],
///     "state_weight": null, "input_weight": null }, ... ] }
/// ```
///
/// # Errors
/// [`DesignError::Field`] when the airframe is not known.
pub fn controllers_json(airframe: &str) -> Result<Value, DesignError> {
    let airframe = Airframe::by_name(airframe).map_err(|e| field("airframe", e.to_string()))?;
    let one = |kind| {
        let design = Design::new(kind, &airframe);
        let weights = weighted(kind).then_some(design.weights);
        json!({
            "controller": kind_name(kind),
            "weighted": weighted(kind),
            "parameters": parameters(kind).iter().zip(&design.parameters).map(|(p, value)| {
                json!({ "name": p.name, "unit": p.unit, "min": p.min, "max": p.max, "value": value })
            }).collect::<Vec<_>>(),
            "state_weight": weights.map(|w| w.state),
            "input_weight": weights.map(|w| w.input),
        })
    };
    Ok(json!({ "airframe": airframe.name, "controllers": KINDS.map(one) }))
}

/// Rows thrust, torque x y z; columns as the weights.
fn rows(k: &Gain) -> Vec<Vec<f64>> {
    k.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn examined(found: &Examination) -> Value {
    let Margins { loops: inputs, peak_sensitivity, slowest_pole_per_s } = &found.margins;
    json!({
        "continuous_poles_per_s": complex(&found.ideal_poles_per_s),
        "sampled_poles": complex(&found.sampled_poles),
        "slowest_pole_per_s": number(*slowest_pole_per_s),
        "peak_sensitivity": number(*peak_sensitivity),
        "margins": loops(inputs),
    })
}

fn flown(step: &Flown, unit: &str) -> Value {
    let curve = |values: &[f64]| values.iter().map(|v| number((v * 1e6).round() / 1e6)).collect::<Vec<_>>();
    json!({
        "output": step.output,
        "unit": unit,
        "size": step.size,
        "t_s": curve(&step.t_s),
        "setpoint": curve(&step.setpoint),
        "response": curve(&step.response),
        "largest_command": curve(&step.largest_command),
        "rise_time_s": step.measured.rise_time_s,
        "overshoot_percent": number(step.measured.overshoot_percent),
        "settling_time_s": step.measured.settling_time_s,
        "saturated_s": step.saturated_s,
        "stayed": step.stayed,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(text: &str) -> Value {
        preview_json(text.as_bytes(), &Around::default()).unwrap()
    }

    fn refused(text: &str) -> String {
        preview_json(text.as_bytes(), &Around::default()).unwrap_err().to_string()
    }

    #[test]
    fn every_controller_previews_with_its_defaults() {
        for kind in crate::control::tuning::KINDS {
            let out = ask(&format!(r#"{{"controller": "{}"}}"#, kind_name(kind)));
            assert_eq!(out["accepted"], true, "{kind:?}: {}", out["refusal"]);
            for step in out["steps"].as_array().unwrap() {
                let last = step["response"].as_array().unwrap().last().unwrap().as_f64().unwrap();
                let from = if step["output"] == "z" { 1.0 } else { 0.0 };
                let size = step["size"].as_f64().unwrap();
                println!(
                    "{kind:?} {}: rise {} overshoot {} settles {} saturated {}",
                    step["output"],
                    step["rise_time_s"],
                    step["overshoot_percent"],
                    step["settling_time_s"],
                    step["saturated_s"]
                );
                assert!((last - from - size).abs() < 0.06, "{kind:?} {}: at {last}", step["output"]);
                assert_eq!(step["stayed"], true);
            }
            for part in ["position", "attitude"] {
                let poles = out[part]["sampled_poles"].as_array().unwrap();
                assert!(poles.iter().all(|z| z[0].as_f64().unwrap().hypot(z[1].as_f64().unwrap()) < 1.0));
                assert_eq!(out[part]["margins"].as_array().unwrap().len(), 4);
            }
        }
    }

    #[test]
    fn what_would_be_refused_says_so_and_is_shown_all_the_same() {
        let lazy = r#"{"controller": "pid", "parameters": {"tilt_p": 49, "tilt_rate_p": 90}}"#;
        let out = ask(lazy);
        assert_eq!(out["accepted"], false);
        assert!(
            out["refusal"].as_str().unwrap().contains("torque") || out["refusal"].as_str().unwrap().contains("decays")
        );
        assert!(out["position"]["sampled_poles"].as_array().unwrap().len() > 12 && out["gains"].is_null());
    }

    #[test]
    fn gains_in_use_are_compared_and_exports_read_back() {
        let first = ask("{}");
        let k: Vec<f64> = first["gains"]["k"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|r| r.as_array().unwrap())
            .map(|v| v.as_f64().unwrap())
            .collect();
        let around = Around { in_use: Some(Gain::from_row_slice(&k)), ..Around::default() };
        let same = preview_json(first["gains"].to_string().as_bytes(), &around).unwrap();
        assert_eq!(same["change"]["largest"].as_f64().unwrap(), 0.0);
        assert_eq!(same["k"], same["k_in_use"]);
        assert_eq!((same["k"].as_array().unwrap().len(), same["k"][0].as_array().unwrap().len()), (4, 16));
        assert!(ask(r#"{"controller": "pid"}"#)["k"].is_null());
        assert_eq!(same["gains"]["certificate"]["sha256"], first["gains"]["certificate"]["sha256"]);
        assert!(first["change"].is_null());
    }

    #[test]
    fn wrong_numbers_are_named() {
        assert_eq!(
            refused(r#"{"controller": "magic"}"#),
            "controller \"magic\" is not known: lqr_integral, lqr, lqg, hinf, pid"
        );
        assert_eq!(
            refused(r#"{"state_weight": [1], "input_weight": [1,1,1,1]}"#),
            "state_weight has 1 values, 16 are needed"
        );
        assert!(refused(r#"{"tick_rate_hz": 20}"#).contains("tick_rate_hz is 20"));
        assert!(refused(r#"{"step": {"x_m": 9}}"#).contains("step.x_m is 9"));
        assert!(refused(r#"{"step": {"w_m": 9}}"#).contains("w_m"));
        assert!(refused(r#"{"controller": "pid", "parameters": {"tilt_p": null}}"#).contains("null"));
        assert!(refused(r#"{"controller": "pid", "parameters": {"tilt_p": 1e999}}"#).contains("out of range"));
        assert!(refused(r#"{"controller": "pid", "parameters": {"tilt_p": -1}}"#).contains("tilt_p is -1"));
        assert!(refused(r#"{"controller": "pid", "parameters": {"tolt_p": 1}}"#).contains("is no parameter of pid"));
        assert!(refused(r#"{"flavour": 1}"#).contains("flavour"));
        assert!(refused("[]").contains("object"));
    }
}
