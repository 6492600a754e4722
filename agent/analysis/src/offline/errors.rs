//! Errors against truth, where a recording carries it: root mean squares, as one JSON line.

use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_core::calibration::applied::FieldReport;
use plumbline_core::estimate::fdir::isolation::FlagReason;
use plumbline_core::estimate::filter::consistency::{Consistency, Mean, Nees};
use plumbline_core::estimate::{Estimator, Health};
use plumbline_core::frames::{from_roll_pitch_yaw, wrap_pi};
use plumbline_core::model::euler_body::{M, X, ix};
use plumbline_core::sensor::measure::Kinematics;
use plumbline_core::vehicle::Truth;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::Channel;

/// Root of a running mean of squares.
#[derive(Debug, Clone, Copy, Default)]
struct Rms(Mean);

impl Rms {
    fn add(&mut self, error: f64) {
        self.0.push(error * error);
    }

    fn value(&self) -> Option<f64> {
        self.0.value().map(f64::sqrt)
    }
}

/// Root mean squares so far: position and velocity by world axis, attitude as total angle, heading, inclination, degrees.
#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    position: [Rms; 3],
    velocity: [Rms; 3],
    attitude_deg: [Rms; 3],
}

fn add_each(of: &mut [Rms; 3], errors: [f64; 3]) {
    of.iter_mut().zip(errors).for_each(|(rms, e)| rms.add(e));
}

/// Root mean square of the vector's length.
fn length(axes: &[Rms; 3]) -> Option<f64> {
    axes.iter().try_fold(0.0, |sum, axis| Some(sum + axis.0.value()?)).map(f64::sqrt)
}

/// Errors of a run. Attitude errors as in BROAD: total angle, rotation about the vertical (heading), and
/// what is left (inclination).
#[derive(Debug, Clone)]
pub struct Score {
    estimator: String,
    input: String,
    ticks: u64,
    initialised_s: Option<f64>,
    errors: Errors,
    accel_bias_mps2: Vector3<f64>,
    gyro_bias_radps: Vector3<f64>,
    finite: bool,
    /// Can the estimator tell where the vehicle is horizontally, and how high, from the sensors it has?
    known: Known,
    consistency: Consistency,
    /// How calibrated magnetometers fared.
    pub(super) fields: Vec<FieldReport>,
    /// What the reader had to say about the recording: cut short, clocks moved.
    pub(super) notes: Vec<String>,
    trace: Vec<ErrorSample>,
    /// What the secure estimator flagged; `None` for the others.
    flagged: Option<Vec<Flagged>>,
}

/// Errors at one time; `None` where there is no truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorSample {
    /// Time, s.
    pub time_s: f64,
    /// Position error, m.
    pub position_m: Option<f64>,
    /// Heading error, degrees.
    pub heading_deg: f64,
    /// Inclination error, degrees.
    pub inclination_deg: f64,
}

/// One flag of the secure estimator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flagged {
    /// The sensor.
    pub sensor: SensorId,
    /// When it was raised, s.
    pub since_s: f64,
    /// When it was last up, s.
    pub until_s: f64,
    /// Why.
    pub reason: FlagReason,
}

/// At most one sample of the trace in this time, s.
const TRACE_PERIOD_S: f64 = 0.1;

/// What the sensors in use say of the place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Known {
    pub horizontal: bool,
    pub vertical: bool,
}

impl Score {
    pub(super) fn new(estimator: &str, input: &Path, known: Known) -> Self {
        Self {
            estimator: estimator.to_owned(),
            input: input.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            ticks: 0,
            initialised_s: None,
            errors: Errors::default(),
            notes: Vec::new(),
            accel_bias_mps2: Vector3::zeros(),
            gyro_bias_radps: Vector3::zeros(),
            finite: true,
            known,
            consistency: Consistency::default(),
            fields: Vec::new(),
            trace: Vec::new(),
            flagged: None,
        }
    }

    pub(super) fn add(&mut self, estimator: &dyn Estimator, truth: Option<&Truth>) {
        let e = estimator.estimate();
        let estimated = e.kinematics();
        self.ticks += 1;
        self.finite &= estimated.position_enu_m.iter().chain(e.world_from_body.coords.iter()).all(|x| x.is_finite());
        self.accel_bias_mps2 = e.accel_bias_mps2.unwrap_or_default();
        self.gyro_bias_radps = e.gyro_bias_radps.unwrap_or_default();
        self.consistency.push(&e.residuals);
        self.add_flags(estimator);
        if e.health == Health::Initialising {
            return;
        }
        self.initialised_s.get_or_insert(e.time.as_seconds());
        let Some(truth) = truth else { return };
        let unknown = |known: bool| if known { 0.0 } else { f64::NAN };
        let (h, v) = (unknown(self.known.horizontal), unknown(self.known.vertical));
        let knowable = Vector3::new(h, h, v);
        let state = Kinematics {
            position_enu_m: truth.position_enu_m + knowable,
            velocity_enu_mps: truth.velocity_enu_mps + knowable,
            world_from_body: truth.world_from_body,
        };
        add_each(&mut self.errors.position, (estimated.position_enu_m - state.position_enu_m).into());
        add_each(&mut self.errors.velocity, (estimated.velocity_enu_mps - state.velocity_enu_mps).into());
        let [_, heading_deg, inclination_deg] = self.add_attitude(&e.world_from_body, &truth.world_from_body);
        let position_m = Some((estimated.position_enu_m - state.position_enu_m).norm()).filter(|m| m.is_finite());
        let time_s = e.time.as_seconds();
        if self.trace.last().is_none_or(|last| time_s - last.time_s >= TRACE_PERIOD_S) {
            self.trace.push(ErrorSample { time_s, position_m, heading_deg, inclination_deg });
        }
        if let Some(nees) = estimator.nees(&state) {
            self.consistency.push_nees(nees);
        }
    }

    fn add_flags(&mut self, estimator: &dyn Estimator) {
        let Some(secure) = estimator.secure() else { return };
        let now_s = estimator.estimate().time.as_seconds();
        let all = self.flagged.get_or_insert_default();
        for device in secure.isolation().devices() {
            let Some((since, reason)) = device.flagged else { continue };
            let (sensor, since_s) = (device.sensor, since.as_seconds());
            match all.iter_mut().rev().find(|f| f.sensor == sensor && f.since_s == since_s) {
                Some(known) => known.until_s = now_s,
                None => all.push(Flagged { sensor, since_s, until_s: now_s, reason }),
            }
        }
    }

    pub(super) fn add_twelve_states(&mut self, x: &X, p: &M, truth: &X) {
        self.ticks += 1;
        self.finite &= x.iter().all(|v| v.is_finite());
        let part = |x: &X, i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
        add_each(&mut self.errors.position, (part(x, ix::X) - part(truth, ix::X)).into());
        add_each(&mut self.errors.velocity, (part(x, ix::VX) - part(truth, ix::VX)).into());
        let attitude = |x: &X| from_roll_pitch_yaw(&part(x, ix::ROLL));
        self.add_attitude(&attitude(x), &attitude(truth));
        let mut error = truth - x;
        (ix::ROLL..=ix::YAW).for_each(|i| error[i] = wrap_pi(error[i]));
        if let Some(cholesky) = p.cholesky() {
            self.consistency.push_nees(Nees { value: error.dot(&cholesky.solve(&error)), states: error.len() });
        }
    }

    /// Total, heading and inclination errors, degrees.
    fn add_attitude(&mut self, estimate: &UnitQuaternion<f64>, truth: &UnitQuaternion<f64>) -> [f64; 3] {
        let e = truth * estimate.inverse();
        let total = 2.0 * e.imag().norm().atan2(e.w.abs()).to_degrees();
        let heading = wrap_pi(2.0 * e.k.atan2(e.w)).to_degrees();
        let inclination = 2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k)).to_degrees();
        let errors = [total, heading, inclination];
        add_each(&mut self.errors.attitude_deg, errors);
        errors
    }

    /// What the secure estimator flagged, one after the other; `None` for the others.
    pub fn flagged(&self) -> Option<&[Flagged]> {
        self.flagged.as_deref()
    }

    /// Errors over time, at most ten a second.
    pub fn trace(&self) -> &[ErrorSample] {
        &self.trace
    }

    /// When the estimator was first more than initialising, s.
    pub fn initialised_s(&self) -> Option<f64> {
        self.initialised_s
    }

    /// Total, heading and inclination errors, root mean square, degrees, where attitude has a truth.
    pub fn attitude_deg(&self) -> Option<[f64; 3]> {
        let [total, heading, inclination] = self.errors.attitude_deg;
        Some([total.value()?, heading.value()?, inclination.value()?])
    }

    /// Position error, root mean square, m.
    pub fn position_m(&self) -> Option<f64> {
        length(&self.errors.position)
    }

    /// Velocity error, root mean square, m/s.
    pub fn velocity_mps(&self) -> Option<f64> {
        length(&self.errors.velocity)
    }

    /// Accelerometer bias at the end, m/s².
    pub fn accel_bias_mps2(&self) -> Vector3<f64> {
        self.accel_bias_mps2
    }

    /// Mean NEES and its expectation, where the estimator has a covariance and the recording a truth.
    pub fn nees(&self) -> Option<(f64, usize)> {
        self.consistency.nees()
    }

    /// The score as one JSON line: [`Score::to_value`].
    pub fn to_json(&self) -> String {
        self.to_value().to_string()
    }

    /// The score as JSON. Errors without truth are null.
    pub fn to_value(&self) -> serde_json::Value {
        let nis = |(sensor, channel, mean): (SensorId, Channel, Mean)| {
            let channel = channel.as_str_name().trim_start_matches("CHANNEL_").to_lowercase();
            (format!("{sensor} {channel}"), serde_json::json!(mean.value()))
        };
        let nis: serde_json::Map<_, _> = self.consistency.nis().map(nis).collect();
        let field = |f: &FieldReport| {
            serde_json::json!({
                "imu": f.imu,
                "fits": f.fits,
                "refits": f.refits,
                "withheld": f.withheld,
                "samples": f.samples,
                "hard_iron_since_ut": f.hard_iron_since_ut.as_slice(),
            })
        };
        let flag = |f: &Flagged| {
            let reason = f.reason.as_str_name().trim_start_matches("FLAG_REASON_").to_lowercase();
            serde_json::json!({ "sensor": f.sensor.to_string(), "since_s": f.since_s, "until_s": f.until_s, "reason": reason })
        };
        let [total, heading, inclination] = self.errors.attitude_deg;
        serde_json::json!({
            "estimate": self.input,
            "estimator": self.estimator,
            "notes": self.notes,
            "ticks": self.ticks,
            "finite": self.finite,
            "initialised_s": self.initialised_s,
            "position_rmse_m": length(&self.errors.position),
            "position_rmse_xyz_m": self.errors.position.map(|a| a.value()),
            "velocity_rmse_mps": length(&self.errors.velocity),
            "velocity_rmse_xyz_mps": self.errors.velocity.map(|a| a.value()),
            "total_rmse_deg": total.value(),
            "heading_rmse_deg": heading.value(),
            "inclination_rmse_deg": inclination.value(),
            "nees": self.nees().map(|n| n.0),
            "nees_states": self.nees().map(|n| n.1),
            "nis": nis,
            "accel_bias_mps2": self.accel_bias_mps2.as_slice(),
            "gyro_bias_radps": self.gyro_bias_radps.as_slice(),
            "flagged": self.flagged.as_ref().map(|all| all.iter().map(flag).collect::<Vec<_>>()),
            "magnetometer_calibration": self.fields.iter().map(field).collect::<Vec<_>>(),
        })
    }
}
