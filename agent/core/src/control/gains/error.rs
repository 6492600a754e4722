//! Why gains are refused, with the numbers.

use arrayvec::ArrayString;

use crate::control::tuning::MAX_NAME;
use crate::linalg::LinalgError;

/// Why gains are refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GainsError {
    /// A weight is not a usable number.
    #[error("{which} weight {index} ({name}) is {value}: it must be {expected}")]
    Weight {
        /// `state` or `input`.
        which: &'static str,
        /// Position in the list, from 0.
        index: usize,
        /// Which state or input.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// What is accepted.
        expected: &'static str,
    },
    /// A parameter is out of its range.
    #[error("{name} is {value} {unit}: it must be {min} to {max}")]
    Parameter {
        /// Its name.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Least.
        min: f64,
        /// Most.
        max: f64,
    },
    /// No parameter is called so.
    #[error("{controller} has no parameter {name:?}")]
    UnknownParameter {
        /// The controller.
        controller: &'static str,
        /// The name given.
        name: ArrayString<MAX_NAME>,
    },
    /// The controller is not one that flies.
    #[error("controller {controller} cannot fly")]
    NoSuchController {
        /// The controller.
        controller: &'static str,
    },
    /// K was given for a controller that is no state feedback.
    #[error("{controller} is not given by K: lqr and lqr_integral are")]
    NotByK {
        /// The controller.
        controller: &'static str,
    },
    /// An entry of K is not a usable number.
    #[error("K[{row}, {column}] is {value}: it must be within ±1e6")]
    Entry {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The offending value.
        value: f64,
    },
    /// The equations of the design have no usable solution.
    #[error("no gains: {0}")]
    Solve(#[from] LinalgError),
    /// The loop with motors' lag and delay is unstable or too slow.
    #[error(
        "closed loop ({what}, motor lag and one tick of delay included) {}, must decay at {} 1/s or faster",
        rate(.pole_per_s),
        .limit.abs()
    )]
    Unstable {
        /// `position` or `attitude`.
        what: &'static str,
        /// ln of the spectral radius over the tick period, 1/s.
        pole_per_s: f64,
        /// The limit.
        limit: f64,
    },
    /// The loop forgives too little.
    #[error("{margin} of {input} ({what} loop) is {value:.2}{unit}, must be {side} {limit:.2}{unit} (policy {policy})")]
    Margin {
        /// `position` or `attitude`.
        what: &'static str,
        /// The input whose loop it is.
        input: &'static str,
        /// Which margin.
        margin: &'static str,
        /// The figure.
        value: f64,
        /// The limit.
        limit: f64,
        /// `at least` or `at most`.
        side: &'static str,
        /// Unit of both.
        unit: &'static str,
        /// The policy.
        policy: &'static str,
    },
    /// A step of one unit asks for far more than the motors have.
    #[error(
        "a step of 1 {unit} in {output} asks for {share:.0} times the motors' room, at most {limit:.0} (policy {policy})"
    )]
    Saturation {
        /// x, y, z or yaw.
        output: &'static str,
        /// m or rad.
        unit: &'static str,
        /// Share of the room between hover and the nearer limit.
        share: f64,
        /// The limit.
        limit: f64,
        /// The policy.
        policy: &'static str,
    },
    /// Certified for ticks of another length.
    #[error("certified for ticks of {certified_s} s, these are {period_s} s")]
    Period {
        /// What they were sampled for, s.
        certified_s: f64,
        /// Ticks of this flight, s.
        period_s: f64,
    },
    /// Too far from the gains in use to switch in flight.
    #[error("{row} gains change by {change:.1} times those in use, at most {limit} while armed")]
    Jump {
        /// Which row of K.
        row: &'static str,
        /// ‖ΔK‖ / ‖K‖.
        change: f64,
        /// The limit.
        limit: f64,
    },
}

/// What a loop whose slowest pole is there does by itself.
fn rate(pole_per_s: &f64) -> String {
    let does = if *pole_per_s < 0.0 { "decays" } else { "grows" };
    format!("{does} at {:.3} 1/s", pole_per_s.abs())
}
