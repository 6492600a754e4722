//! What a design would do, before anybody flies it.
//!
//! Question and answer are [`plumbline_rest::design::Question`] and [`plumbline_rest::design::Preview`]; whatever a
//! question leaves out is as with the vehicle asked about.
//! - Steps are flown on the nonlinear vehicle ([`super::response`]), through the profile that flies.
//! - A design that cannot be solved or whose numbers are wrong is an error; one that is refused for its
//!   margins is an answer with `accepted: false` and the sentence in `refusal`.

use plumbline_core::control::gains::{Certified, Examiner, Findings, Gain, INPUT_NAMES, OUTPUT_NAMES, change};
use plumbline_core::control::law::Law;
use plumbline_core::control::margins::{Examination, Margins};
use plumbline_core::control::policy::MarginPolicy;
use plumbline_core::control::setpoint::Limits;
use plumbline_core::control::tuning::{Design, KINDS, Parameter, Proposal, kind_name, parameters, weighted};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::types::TICK_RATE_HZ;
use plumbline_proto::ids::GainsRevision;
use plumbline_rest::design as rest;
use serde_json::Value;

use super::DesignError;
use super::file::{complex, export_certified, field, finite, loops, number, proposal};
use super::response::{Flown, fly_step};

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

impl Question {
    /// Reads a question; what it leaves out comes from `around`.
    ///
    /// # Errors
    /// [`DesignError`] naming field and value.
    pub fn from_json(text: &[u8], around: &Around) -> Result<Self, DesignError> {
        let root: Value = serde_json::from_slice(text)?;
        if !root.is_object() {
            return Err(DesignError::NoDesign);
        }
        let rest::Question { design, step, duration_s } = serde_json::from_value(root)?;
        let within = |name: &str, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(value)
            } else {
                Err(field(name, format!("is {value}, it must be {least} to {most}")))
            }
        };
        let airframe = design.airframe.as_deref().unwrap_or(&around.airframe);
        let airframe = Airframe::by_name(airframe).map_err(|e| field("airframe", e.to_string()))?;
        let mut sizes = [0.5; 4];
        let asked = [("x_m", step.x_m), ("y_m", step.y_m), ("z_m", step.z_m), ("yaw_rad", step.yaw_rad)];
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
                design.tick_rate_hz.unwrap_or(around.tick_rate_hz),
                *TICK_RATE_HZ.start(),
                *TICK_RATE_HZ.end(),
            )?,
            policy: around.policy,
            limits: Limits::default(),
            proposal: proposal(&design)?,
            in_use: around.in_use,
            steps: sizes,
            duration_s: within("duration_s", duration_s.unwrap_or(8.0), 0.5, DURATION_MAX_S)?,
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

/// The answer to a question in JSON.
///
/// # Errors
/// As [`Question::from_json`] and [`preview`].
pub fn answer(text: &[u8], around: &Around) -> Result<rest::Preview, DesignError> {
    Ok(preview(&Question::from_json(text, around)?)?.answer())
}

impl Preview {
    /// As it is answered.
    pub fn answer(&self) -> rest::Preview {
        let unit = |i: usize| if i == 3 { "rad" } else { "m" };
        let shares = OUTPUT_NAMES.iter().zip(self.findings.unit_step).enumerate();
        let share = |(i, (output, share)): (usize, (&&str, f64))| rest::Share {
            output: (*output).to_owned(),
            unit: unit(i).to_owned(),
            share: number(share),
        };
        let gains = self.verdict.as_ref().ok();
        rest::Preview {
            controller: kind_name(self.design.kind).to_owned(),
            airframe: self.airframe.clone(),
            tick_rate_hz: self.tick_rate_hz,
            accepted: self.verdict.is_ok(),
            refusal: self.verdict.as_ref().err().cloned(),
            policy: policy(&self.policy),
            position: examined(&self.findings.position),
            attitude: examined(&self.findings.attitude),
            unit_step: shares.map(share).collect(),
            change: self.changes.map(changed),
            k: self.law.gains().map(|[k, _]| rows(k)),
            k_in_use: self.in_use.as_ref().map(rows),
            steps: self.steps.iter().enumerate().map(|(i, step)| flown(step, unit(i))).collect(),
            gains: gains.map(|gains| export_certified(gains, &self.airframe, self.tick_rate_hz)),
            parameters: table(&self.design),
        }
    }
}

/// Every controller there is, with its parameters and weights for `airframe`.
///
/// # Errors
/// [`DesignError::Field`] when the airframe is not known.
pub fn controllers(airframe: &str) -> Result<rest::Controllers, DesignError> {
    let airframe = Airframe::by_name(airframe).map_err(|e| field("airframe", e.to_string()))?;
    let one = |kind| {
        let design = Design::new(kind, &airframe);
        let weights = weighted(kind).then_some(design.weights);
        rest::Controller {
            controller: kind_name(kind).to_owned(),
            weighted: weighted(kind),
            parameters: table(&design),
            state_weight: weights.map(|w| w.state.to_vec()),
            input_weight: weights.map(|w| w.input.to_vec()),
        }
    };
    Ok(rest::Controllers { airframe: airframe.name.clone(), controllers: KINDS.into_iter().map(one).collect() })
}

/// The parameters of a design, with what they may be.
fn table(design: &Design) -> Vec<rest::Parameter> {
    let parameter = |(p, value): (&Parameter, &f64)| rest::Parameter {
        name: p.name.to_owned(),
        unit: p.unit.to_owned(),
        min: p.min,
        max: p.max,
        value: *value,
    };
    parameters(design.kind).iter().zip(&design.parameters).map(parameter).collect()
}

fn policy(p: &MarginPolicy) -> rest::Policy {
    rest::Policy {
        name: p.name.to_owned(),
        gain_up_min: p.gain_up_min,
        gain_down_max: p.gain_down_max,
        phase_min_rad: p.phase_min_rad,
        delay_min_s: p.delay_min_s,
        sensitivity_max: p.sensitivity_max,
        slowest_pole_per_s: p.slowest_pole_per_s,
        change_max: p.change_max,
        unit_step_max: p.unit_step_max,
    }
}

fn changed(rows: [f64; 4]) -> rest::Change {
    let largest = rows.iter().copied().fold(0.0, f64::max);
    let row = rows.iter().position(|v| *v == largest).unwrap_or(0);
    rest::Change {
        largest: number(largest),
        row: INPUT_NAMES.get(row).map(|name| (*name).to_owned()),
        rows: INPUT_NAMES.iter().zip(rows).map(|(name, v)| ((*name).to_owned(), number(v))).collect(),
    }
}

/// Rows thrust, torque x y z; columns as the weights.
fn rows(k: &Gain) -> Vec<Vec<f64>> {
    k.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn examined(found: &Examination) -> rest::Examined {
    let Margins { loops: inputs, peak_sensitivity, slowest_pole_per_s } = &found.margins;
    rest::Examined {
        continuous_poles_per_s: complex(&found.ideal_poles_per_s),
        sampled_poles: complex(&found.sampled_poles),
        slowest_pole_per_s: number(*slowest_pole_per_s),
        peak_sensitivity: number(*peak_sensitivity),
        margins: loops(inputs),
    }
}

fn flown(step: &Flown, unit: &str) -> rest::Flown {
    let curve = |values: &[f64]| values.iter().map(|v| number((v * 1e6).round() / 1e6)).collect();
    rest::Flown {
        output: step.output.to_owned(),
        unit: unit.to_owned(),
        size: step.size,
        t_s: curve(&step.t_s),
        setpoint: curve(&step.setpoint),
        response: curve(&step.response),
        largest_command: curve(&step.largest_command),
        rise_time_s: step.measured.rise_time_s,
        overshoot_percent: number(step.measured.overshoot_percent),
        settling_time_s: step.measured.settling_time_s,
        saturated_s: number(step.saturated_s),
        stayed: Some(step.stayed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(text: &str) -> Value {
        serde_json::to_value(answer(text.as_bytes(), &Around::default()).unwrap()).unwrap()
    }

    fn refused(text: &str) -> String {
        answer(text.as_bytes(), &Around::default()).unwrap_err().to_string()
    }

    #[test]
    fn every_controller_previews_with_its_defaults() {
        for kind in plumbline_core::control::tuning::KINDS {
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
            out["refusal"].as_str().unwrap().contains("torque")
                || out["refusal"].as_str().unwrap().contains("grows at")
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
        let same = answer(first["gains"].to_string().as_bytes(), &around).unwrap();
        let same = serde_json::to_value(same).unwrap();
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
