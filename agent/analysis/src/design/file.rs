//! Designs and gains as JSON, for files, the command line and the ground's API.
//!
//! A design:
//! ```json
//! { "controller": "lqr_integral",
//!   "state_weight": [16 numbers], "input_weight": [4 numbers],
//!   "parameters": { "name": number, ... },
//!   "k": [4 rows of 16], "k_attitude": [4 rows of 16] }
//! ```
//! - `controller`: `lqr_integral` (or `lqi`), `lqr`, `lqg`, `hinf`, `pid`; `lqr_integral` when left out.
//! - `state_weight` (≥ 0) in the order x y z vx vy vz roll pitch yaw p q r, integrals of x y z yaw, and
//!   `input_weight` (> 0) in the order thrust, torque x, torque y, torque z: 1/(largest deviation)². Left out:
//!   Bryson's rule for the airframe.
//! - `parameters`: what the controller has beyond weights, by name; the rest keep their defaults.
//! - `k`, `k_attitude`: gains outright (`lqr`, `lqr_integral`), used where there are no weights.
//!
//! Gains written by [`export`] are a design with what came of it: `format`, `airframe`, `tick_rate_hz`,
//! `units` (of every list), `certificate` (slowest pole, margins, policy, hash). Reading one back takes the design and
//! leaves the rest: the agent solves and examines again.
//!
//! Strict: unknown keys, wrong lengths and numbers that are not finite are errors with name and value.

use plumbline_core::control::gains::{Certified, Gain, INPUT_NAMES, STATE_NAMES};
use plumbline_core::control::lqr_integral::Weights;
use plumbline_core::control::margins::LoopMargins;
use plumbline_core::control::tuning::{KINDS, Proposal, kind_by_name, kind_name, parameters, weighted};
use plumbline_core::linalg::Complex;
use plumbline_core::types::ControllerKind;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1;
use plumbline_rest::design::{Design, Margin};
use serde_json::{Value, json};

use super::DesignError;

/// Value of `format` in exported gains.
pub const FORMAT: &str = "plumbline gains 1";
/// Units of the states and integrals whose weight is 1/unit².
const STATE_UNITS: [&str; 16] =
    ["m", "m", "m", "m/s", "m/s", "m/s", "rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "m s", "m s", "m s", "rad s"];
/// Units of the inputs.
const INPUT_UNITS: [&str; 4] = ["N", "N m", "N m", "N m"];

/// Reads JSON text.
///
/// # Errors
/// [`DesignError::Syntax`] naming the key or place.
pub fn read(text: &[u8]) -> Result<Design, DesignError> {
    Ok(serde_json::from_slice(text)?)
}

/// The design, form and finiteness checked.
///
/// # Errors
/// [`DesignError::Field`] with name and value.
pub fn proposal(design: &Design) -> Result<Proposal, DesignError> {
    if let Some(format) = design.format.as_deref().filter(|format| *format != FORMAT) {
        return Err(field("format", format!("is {format:?}, expected {FORMAT:?}")));
    }
    let kind = design.controller.as_deref().map_or(Ok(ControllerKind::LqrIntegral), controller)?;
    let mut proposal = Proposal::new(kind);
    if design.state_weight.is_some() || design.input_weight.is_some() {
        let missing = |name: &str| field(name, "is missing beside the other weights".to_owned());
        let state = design.state_weight.as_deref().ok_or_else(|| missing("state_weight"))?;
        let input = design.input_weight.as_deref().ok_or_else(|| missing("input_weight"))?;
        proposal.weights =
            Some(Weights { state: exactly("state_weight", state)?, input: exactly("input_weight", input)? });
    }
    for (name, value) in &design.parameters {
        if !parameters(kind).iter().any(|p| p.name == name) {
            let known: Vec<_> = parameters(kind).iter().map(|p| p.name).collect();
            let text = format!("is no parameter of {}: {}", kind_name(kind), known.join(", "));
            return Err(field(&format!("parameters.{name:.40}"), text));
        }
        proposal.parameter(name, finite(name, *value)?).map_err(|text| field("parameters", text))?;
    }
    if proposal.weights.is_none() {
        proposal.k = match (&design.k, &design.k_attitude) {
            (None, None) => None,
            (Some(k), Some(k_attitude)) => Some([gain("k", k)?, gain("k_attitude", k_attitude)?]),
            (Some(_), None) => return Err(field("k_attitude", "is missing beside k".into())),
            (None, Some(_)) => return Err(field("k", "is missing beside k_attitude".into())),
        };
    }
    Ok(proposal)
}

/// A design as the command that pushes it.
pub fn push_message(proposal: &Proposal, revision: u32) -> v1::PushGains {
    let matrix = |k: &Gain| v1::Matrix { rows: 4, columns: 16, values: k.transpose().as_slice().to_vec() };
    v1::PushGains {
        revision,
        controller: proposal.kind as i32,
        weights: proposal
            .weights
            .map(|w| v1::LqrWeights { state_weight: w.state.to_vec(), input_weight: w.input.to_vec() }),
        parameters: proposal
            .parameters
            .iter()
            .map(|(name, value)| v1::Parameter { name: name.to_string(), value: *value })
            .collect(),
        k: proposal.k.as_ref().map(|k| matrix(&k[0])),
        k_attitude: proposal.k.as_ref().map(|k| matrix(&k[1])),
    }
}

/// The kind called `name`.
///
/// # Errors
/// [`DesignError::Field`] naming those there are.
pub fn controller(name: &str) -> Result<ControllerKind, DesignError> {
    kind_by_name(name).ok_or_else(|| {
        let known = KINDS.map(kind_name).join(", ");
        field("controller", format!("{name:.40?} is not known: {known}"))
    })
}

pub(crate) fn field(name: &str, problem: String) -> DesignError {
    DesignError::Field { name: name.to_owned(), problem }
}

pub(super) fn finite(name: &str, value: f64) -> Result<f64, DesignError> {
    if value.is_finite() { Ok(value) } else { Err(field(name, format!("is {value}, a finite number is needed"))) }
}

fn exactly<const N: usize>(name: &str, values: &[f64]) -> Result<[f64; N], DesignError> {
    let wrong = || field(name, format!("has {} values, {N} are needed", values.len()));
    let array: [f64; N] = values.try_into().map_err(|_| wrong())?;
    array.iter().enumerate().try_for_each(|(i, v)| finite(&format!("{name}[{i}]"), *v).map(|_| ()))?;
    Ok(array)
}

fn gain(name: &str, rows: &[Vec<f64>]) -> Result<Gain, DesignError> {
    if rows.len() != 4 || rows.iter().any(|row| row.len() != 16) {
        let columns = rows.first().map_or(0, Vec::len);
        return Err(field(name, format!("is {} x {columns}, 4 x 16 is needed", rows.len())));
    }
    let flat: Vec<f64> = rows.iter().flatten().copied().collect();
    Ok(Gain::from_row_slice(&exactly::<64>(name, &flat)?))
}

/// Gains examined here, as JSON: as [`export`] writes those that an agent reports.
pub fn export_certified(gains: &Certified, airframe: &str, tick_rate_hz: f64) -> Value {
    let mut message = v1::GainsInUse::default();
    gains.to_wire(FlightTime(0), &mut message);
    export(&message, airframe, tick_rate_hz)
}

/// Gains as an agent reports them, as JSON: a design that can be read back, with units and the certificate.
pub fn export(gains: &v1::GainsInUse, airframe: &str, tick_rate_hz: f64) -> Value {
    let kind = match gains.kind() {
        ControllerKind::Unspecified => ControllerKind::LqrIntegral,
        kind => kind,
    };
    let unit = |name: &str| parameters(kind).iter().find(|p| p.name == name).map_or("", |p| p.unit);
    let by_name = |value: &dyn Fn(&v1::Parameter) -> Value| {
        gains.parameters.iter().map(|p| (p.name.clone(), value(p))).collect::<serde_json::Map<_, _>>()
    };
    let margins: Vec<Margin> = gains
        .margins
        .iter()
        .map(|m| {
            margin(
                &m.input,
                &LoopMargins {
                    gain_up: m.gain_up,
                    gain_down: m.gain_down,
                    phase_rad: m.phase_rad,
                    delay_s: m.delay_s,
                    crossover_radps: m.crossover_radps,
                    peak_sensitivity: m.peak_sensitivity,
                },
            )
        })
        .collect();
    let mut units = json!({ "parameters": by_name(&|p| json!(unit(&p.name))) });
    let mut out = json!({
        "format": FORMAT,
        "controller": kind_name(kind),
        "airframe": airframe,
        "tick_rate_hz": tick_rate_hz,
        "parameters": by_name(&|p| json!(p.value)),
        "certificate": {
            "revision": gains.revision,
            "sha256": gains.sha256,
            "policy": gains.margin_policy,
            "slowest_pole_per_s": number(gains.slowest_pole_per_s),
            "margins": margins,
        },
    });
    if let Some(weights) = gains.weights.as_ref().filter(|w| weighted(kind) && !w.state_weight.is_empty()) {
        out["state_weight"] = json!(weights.state_weight);
        out["input_weight"] = json!(weights.input_weight);
        units["state_weight"] = json!(STATE_UNITS.map(|u| format!("1/({u})^2")));
        units["input_weight"] = json!(INPUT_UNITS.map(|u| format!("1/({u})^2")));
    }
    let matrix = |m: &Option<v1::Matrix>| {
        let m = m.as_ref().filter(|m| m.columns > 0)?;
        Some(m.values.chunks(m.columns as usize).map(<[f64]>::to_vec).collect::<Vec<_>>())
    };
    if let (Some(k), Some(k_attitude)) = (matrix(&gains.k), matrix(&gains.k_attitude)) {
        out["k"] = json!(k);
        out["k_attitude"] = json!(k_attitude);
        units["k"] = json!({
            "rows": INPUT_NAMES.iter().zip(INPUT_UNITS).map(|(n, u)| format!("{n}, {u}")).collect::<Vec<_>>(),
            "columns": STATE_NAMES.iter().zip(STATE_UNITS).map(|(n, u)| format!("{n}, {u}")).collect::<Vec<_>>(),
            "law": "u = -K x; k_attitude while the horizontal position is not controlled",
        });
    }
    out["units"] = units;
    out
}

/// A number; absent where it is infinite: no limit.
pub(super) fn number(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// The margins of each input.
pub(super) fn loops(margins: &[LoopMargins]) -> Vec<Margin> {
    INPUT_NAMES.into_iter().zip(margins).map(|(name, m)| margin(name, m)).collect()
}

fn margin(input: &str, m: &LoopMargins) -> Margin {
    Margin {
        input: input.to_owned(),
        gain_up: number(m.gain_up),
        gain_down: number(m.gain_down),
        phase_rad: number(m.phase_rad),
        delay_s: number(m.delay_s),
        crossover_radps: number(m.crossover_radps),
        peak_sensitivity: number(m.peak_sensitivity),
    }
}

/// Real and imaginary parts.
pub(super) fn complex(values: &[Complex]) -> Vec<[Option<f64>; 2]> {
    values.iter().map(|z| [number(z.re), number(z.im)]).collect()
}
