//! Raw to SI: calibrations, fitted from recordings and applied inside `sense()`.
//!
//! ```text
//! samples ─► fit of one kind ─► CalibrationFile (JSON) ─► Calibration ─► every SensorFrame
//! ```
//! One file per kind. A fit either returns its parameters with their covariance, or refuses with the reason
//! and the numbers ([`CalibrationError`]): nothing is fitted to data that cannot hold the answer.
//!
//! | kind | module | source |
//! |---|---|---|
//! | accelerometer, gyroscope | [`inertial`] | Skog & Händel 2006; Tedaldi, Pretto & Menegatti 2014 |
//! | magnetometer | [`magnetometer`], watched in flight by [`field_monitor`] | ellipsoid fit |
//! | thermal | [`thermal`] | polynomial of the die temperature |
//! | motor curve | [`motor_curve`] | \[Clinic\] 5.5 |
//! | thrust | [`thrust`] | T = k ω², Q = b ω² |
//! | mass | [`mass`] | scales and a bifilar pendulum |
//! | allan | [`allan`] | IEEE Std 952, overlapping estimator |
//!
//! Whoever turns a vehicle by hand is told by [`guide`] how much of what a fit asks for is there.

pub mod allan;
pub mod applied;
pub mod field_monitor;
pub mod file;
pub mod fit;
pub mod guide;
pub mod inertial;
pub mod magnetometer;
pub mod mass;
pub mod motor_curve;
pub mod rest;
pub mod samples;
pub mod thermal;
pub mod thrust;

pub use applied::Calibration;
pub use file::{CalibrationFile, Kind};

/// Why data are refused, with the numbers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// A value is NaN or infinite.
    #[error("sample {index}: {channel} is {value}, not a finite number")]
    NotFinite {
        /// Which channel.
        channel: &'static str,
        /// Which sample, from 0.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// Too little of something.
    #[error("{found} {what}, at least {needed} are needed")]
    TooFew {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many it takes.
        needed: usize,
    },
    /// Too little of a quantity, with its unit.
    #[error("{what} is {found:.3}{space}{unit}, at least {needed}{space}{unit} needed", space = if unit.is_empty() { "" } else { " " })]
    TooSmall {
        /// Of what.
        what: &'static str,
        /// How much there is.
        found: f64,
        /// How much it takes.
        needed: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// Something moved that should rest.
    #[error("not at rest: {what} varies by {found:.3} {unit}, at most {limit} {unit} at rest")]
    Moving {
        /// What varies.
        what: &'static str,
        /// By how much.
        found: f64,
        /// How much is noise.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// A channel has hit its end.
    #[error("saturated: {channel} stays at {value:.3} for {count} samples")]
    Saturated {
        /// Which channel.
        channel: &'static str,
        /// Its end.
        value: f64,
        /// How many samples.
        count: usize,
    },
    /// The data do not determine a parameter.
    #[error("{parameter} is not determined: one sigma is {sigma:.3}, at most {limit:.3} is useful")]
    Undetermined {
        /// Which parameter.
        parameter: String,
        /// Its one-sigma.
        sigma: f64,
        /// How large it may be.
        limit: f64,
    },
    /// The normal equations cannot be solved.
    #[error("singular: {0}")]
    Singular(&'static str),
    /// The minimum was not found.
    #[error("the fit has not converged after {iterations} iterations, residual {residual:.3e}")]
    NotConverged {
        /// How many.
        iterations: usize,
        /// Root mean square of the residuals then.
        residual: f64,
    },
    /// The model does not describe the data.
    #[error("the model does not fit: residual {found:.4} {unit}, at most {limit:.4} {unit} is acceptable")]
    BadFit {
        /// Residual.
        found: f64,
        /// Largest acceptable.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// A value is out of its range.
    #[error("{what} is {value}, not {expected}")]
    Value {
        /// What.
        what: String,
        /// The value.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// Not a calibration file, or not of the kind expected.
    #[error("calibration file: {0}")]
    File(String),
}
