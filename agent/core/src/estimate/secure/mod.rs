//! Secure state estimation: the state recovered although some sensors are attacked (\[Clinic\] 3).
//!
//! The decoder of Fawzi, Tabuada and Diggavi: over a window of T samples, with Y the outputs of each
//! sensor after the forced response is removed,
//!
//! x̂ = argmin over x of Σᵢ ‖Yᵢ − Φᵢ x‖₂   (ℓ1/ℓ2, \[Clinic\] Eq. 19) or Σᵢ ‖Yᵢ − Φᵢ x‖₁ (ℓ1/ℓ1).
//!
//! | symbol | meaning | shape |
//! |---|---|---|
//! | x | state at the window's anchor | N |
//! | Yᵢ | whitened outputs of sensor i | T |
//! | Φᵢ | whitened observability rows of sensor i | T × N |
//!
//! Before flight: [`suite`] says what the sensors can promise. In flight: `pipeline.rs` is the outline of the estimator
//! `secure`; [`window`] holds the last T slots, `fdir/isolation.rs` isolates the attacked set, `filter.rs` is the
//! Kalman filter on the healthy sensors.
//!
//! [`compress`] makes the problem small without changing it, [`newton`] solves it with a certificate,
//! [`conic`] solves the same programs with Clarabel, as reference and audit.

pub mod compress;
pub mod conic;
mod decode;
mod evidence;
mod filter;
mod inertial;
mod model;
pub mod newton;
mod path;
mod pipeline;
mod rewind;
mod signals;
pub mod suite;
#[cfg(test)]
mod tests;
pub mod window;

use std::fmt;

pub use plumbline_proto::v1::Decoder;

pub use self::decode::AuditCase;
pub use self::model::SLOT_S;
pub use self::pipeline::{
    DEADLINE_US, DecoderStatus, RATE_MAX_RADPS, SLOTS, SLOTS_MAX, SLOTS_MIN, Secure, SecureFallback, TILT_MAX_RAD,
    WindowReport,
};

/// Which norm is taken over one sensor's window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// ℓ1/ℓ2: the 2-norm over time, one term per sensor.
    L2,
    /// ℓ1/ℓ1: the 1-norm over time, one term per sample.
    L1,
}

/// Program of `decoder`, and whether position and orientation are split in it.
pub(super) fn parts(decoder: Decoder) -> (Program, bool) {
    match decoder {
        Decoder::Unspecified | Decoder::L2 => (Program::L2, false),
        Decoder::L1 => (Program::L1, false),
        Decoder::L2Split => (Program::L2, true),
        Decoder::L1Split => (Program::L1, true),
    }
}

/// How a solve ended. Not an error: the iterate is always usable with its certified gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The gap is within tolerance.
    Solved,
    /// The iteration limit came first.
    MaxIterations,
    /// The deadline came first.
    MaxTime,
    /// No further decrease in double precision.
    Stalled,
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Status::Solved => "solved",
            Status::MaxIterations => "max_iterations",
            Status::MaxTime => "max_time",
            Status::Stalled => "stalled",
        })
    }
}

/// A decoded window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoded<const N: usize> {
    /// Minimiser found.
    pub x: nalgebra::SVector<f64, N>,
    /// Objective there.
    pub objective: f64,
    /// Certified: no x has an objective below this (up to rounding).
    pub lower_bound: f64,
    /// Iterations used.
    pub iterations: u32,
    /// How it ended.
    pub status: Status,
}

impl<const N: usize> Decoded<N> {
    /// (objective − lower bound) / objective, 0 for a zero objective. Certifies optimality, not truth.
    pub fn relative_gap(&self) -> f64 {
        if self.objective > 0.0 { (self.objective - self.lower_bound).max(0.0) / self.objective } else { 0.0 }
    }
}

/// Why a suite or a window cannot be decoded.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SecureError {
    /// A matrix or window has the wrong shape.
    #[error("{what} has {found} entries, {expected} are needed")]
    Shape {
        /// Which.
        what: String,
        /// Size found.
        found: usize,
        /// Size needed.
        expected: usize,
    },
    /// A number that is NaN or infinite.
    #[error("sensor {sensor}, sample {sample}: {value} is not finite")]
    NotFinite {
        /// Sensor, from 0.
        sensor: usize,
        /// Sample in the window, from 0.
        sample: usize,
        /// The value.
        value: f64,
    },
    /// The rows of all sensors together do not determine the state.
    #[error("the suite does not observe the state: smallest pivot {pivot:.3e} against {largest:.3e}, state {state}")]
    Unobservable {
        /// Smallest pivot of ΣΦᵢᵀΦᵢ.
        pivot: f64,
        /// Largest diagonal.
        largest: f64,
        /// Index of the state at that pivot.
        state: usize,
    },
    /// The QR factorisation does not reproduce its matrix.
    #[error("sensor {sensor}: QR reproduces its rows to {error:.1e} only")]
    Factorisation {
        /// Sensor, from 0.
        sensor: usize,
        /// Relative error.
        error: f64,
    },
    /// A window with too few slots, or with too many.
    #[error("a window of {slots} slots: {least} to {most} are possible")]
    Slots {
        /// Asked for.
        slots: usize,
        /// Least.
        least: usize,
        /// Most.
        most: usize,
    },
    /// The transition over one slot has no inverse.
    #[error("the model's transition has no inverse: a window cannot be anchored at its end")]
    Transition,
    /// A row without (finite, positive) noise cannot be whitened.
    #[error("row {row}: whitening is singular with a sigma of {sigma}")]
    Whitening {
        /// Row, from 0.
        row: usize,
        /// Its sigma.
        sigma: f64,
    },
    /// The conic solver gave up.
    #[error("Clarabel: {0}")]
    Conic(String),
}
