//! The filter behind the decoder: Kalman filter on the clean sensors, with disturbance states beside it.
//!
//! The filter is the error-state EKF of [`EkfBias`], given frames from which every flagged sensor has been
//! taken out. Its input is the specific force, so that what neither thrust nor gravity explains (string
//! tension, ground contact, wind) is in the motion from the first sample on: it is the limit of a filter with
//! thrust as input and disturbance states of unbounded noise, without their lag. The force itself is
//! estimated by three disturbance states from the applied motor commands:
//!
//! d₊ = d + w, m R f = T R ẑ + d + v, in information form: Λ ← (Λ⁻¹ + q)⁻¹ + r⁻¹ per axis.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | f | specific force measured, biases removed | m/s² |
//! | T | thrust of the applied commands, through motor lag and battery | N |
//! | d | disturbance force, ENU | N |
//!
//! An attack is detected with a delay, and by then its effect is in velocity and biases. A sensor that is excluded
//! is therefore excluded from the last moments as well (`rewind.rs`): the filter is what it would be without the delay.
//!
//! Healthy heights differ by a constant each. Their baselines are subtracted, about the mean of all, so that the
//! estimate does not move when one of them is excluded.
//!
//! Nonlinear flight: this filter linearises about its own attitude and holds at any tilt; what ends earlier is
//! the window's model (`pipeline.rs`), and then the last attacked set is kept.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::rewind::Rewind;
use crate::estimate::ekf_bias::EkfBias;
use crate::estimate::fdir::isolation::{Device, Isolation, SensorSet};
use crate::estimate::{Estimate, Estimator};
use crate::model::airframe::Airframe;
use crate::model::motor::Rotors;
use crate::sensor::{MAX_HEIGHTS, SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// Noise of the disturbance, N/√s: strings go taut within a few ticks.
const DISTURBANCE_WALK_N: f64 = 20.0;
/// One-sigma of a specific force beyond the sensor's own: vibration, thrust curve, m/s².
const FORCE_SIGMA_MPS2: f64 = 0.3;

/// A height's noise is assumed larger by this factor while every IMU is used: on clean flights altitude
/// is estimated best with 1.5 to 2 (`reproduce clinic`, the augmented filter's noise), with an IMU less without it.
const HEIGHT_CAUTION: f64 = 1.5;
/// Sigmas that a height can be from the median of all and still move the filter more than one nearer.
const HEIGHT_REACH: f64 = 1.5;

/// The filter and its disturbance states.
pub struct CleanFilter {
    filter: EkfBias,
    rewind: Rewind,
    excluded: SensorSet,
    /// Noise of a height as configured, m.
    height_sigma_m: f64,
    /// What taking the filter back has changed in height and climb, m and m/s.
    moved: (f64, f64),
    airframe: Airframe,
    rotors: Rotors,
    voltage_ratio: f64,
    disturbance_enu_n: Vector3<f64>,
    information: f64,
}

impl CleanFilter {
    /// Nothing known yet.
    pub fn new(model: SensorModel, airframe: &Airframe) -> Self {
        let height_sigma_m = model.heights.sigma;
        let mut filter = EkfBias::new(model).with_height_reach(HEIGHT_REACH);
        filter.assume_height_sigma(HEIGHT_CAUTION * height_sigma_m);
        Self {
            height_sigma_m,
            airframe: airframe.clone(),
            rewind: Rewind::new(&filter),
            filter,
            excluded: SensorSet::default(),
            moved: (0.0, 0.0),
            rotors: Rotors::default(),
            voltage_ratio: 1.0,
            disturbance_enu_n: Vector3::zeros(),
            information: 0.0,
        }
    }

    /// One tick with the sensors that `isolation` does not exclude, and what is learned of each height, m.
    pub fn step(
        &mut self,
        received: &SensorFrame,
        applied: &MotorCommand,
        isolation: &Isolation,
        learned_m: &[f64; MAX_HEIGHTS],
        dt_s: f64,
    ) {
        let mut received = *received;
        for (height, learned_m) in received.heights.iter_mut().zip(learned_m) {
            height.iter_mut().for_each(|sample| sample.height_m -= learned_m);
        }
        let excluded = isolation.excluded();
        let new = excluded.without(self.excluded);
        self.excluded = excluded;
        let missing = |d: &Device| d.sensor.kind == SensorKind::Imu && (!d.present || excluded.contains(d.sensor));
        let caution = if isolation.devices().iter().any(missing) { 1.0 } else { HEIGHT_CAUTION };
        self.filter.assume_height_sigma(caution * self.height_sigma_m);
        self.filter.step(&clean(&received, excluded), applied);
        self.rewind.remember(&self.filter, &received, applied, excluded);
        if !new.is_empty() {
            let imus =
                isolation.devices().iter().filter(|d| d.sensor.kind == SensorKind::Imu && new.contains(d.sensor));
            self.rewind.begin(new, imus.map(|d| d.evidence.drift_s).fold(0.0, f64::max));
        }
        if let Some(replayed) = self.rewind.advance() {
            let vertical = |filter: &EkfBias| {
                let (motion, corrections) = (filter.estimate().motion_or_rest(), filter.vertical_corrections());
                (motion.position_enu_m.z - corrections.0, motion.velocity_enu_mps.z - corrections.1)
            };
            let (before, after) = (vertical(&self.filter), vertical(replayed));
            self.moved.0 += after.0 - before.0;
            self.moved.1 += after.1 - before.1;
            self.filter.clone_from(replayed);
        }
        self.disturb(&received, applied, dt_s);
    }

    /// The filter's estimate.
    pub fn estimate(&self) -> &Estimate {
        self.filter.estimate()
    }

    /// Corrections of height and climb since it began, m and m/s: what lies between its path and the one that
    /// the IMUs alone would have given.
    pub fn vertical_corrections(&self) -> (f64, f64) {
        let (z, climb) = self.filter.vertical_corrections();
        (z + self.moved.0, climb + self.moved.1)
    }

    /// Rewinds so far.
    pub fn rewinds(&self) -> u32 {
        self.rewind.count()
    }

    /// Force that neither thrust nor gravity explains, ENU, N.
    pub fn disturbance_enu_n(&self) -> Vector3<f64> {
        self.disturbance_enu_n
    }

    /// Starts again from `estimate`.
    pub fn reset_to(&mut self, estimate: &Estimate) {
        self.filter.reset_to(estimate);
        self.rewind.start_over(&self.filter);
    }

    fn disturb(&mut self, received: &SensorFrame, applied: &MotorCommand, dt_s: f64) {
        let airframe = &self.airframe;
        if let Some(v) = received.battery_v.filter(|v| v.is_finite() && *v > 0.0) {
            self.voltage_ratio = v / airframe.battery.nominal_v();
        }
        let dt_s = if dt_s.is_finite() { dt_s.clamp(0.0, 0.1) } else { 0.0 };
        self.rotors.step(airframe, &applied.throttle, self.voltage_ratio, dt_s);
        let Some(force_mps2) = self.filter.specific_force_mps2() else { return };
        let attitude: UnitQuaternion<f64> = self.filter.estimate().world_from_body;
        let thrust = Vector3::new(0.0, 0.0, airframe.wrench(self.rotors.speed_radps()).thrust_n);
        let measured = attitude * (force_mps2 * airframe.mass_kg - thrust);
        if !measured.iter().all(|v| v.is_finite()) {
            return;
        }
        let r = (FORCE_SIGMA_MPS2 * airframe.mass_kg).powi(2);
        let q = DISTURBANCE_WALK_N.powi(2) * dt_s;
        let prior = if self.information > 0.0 { 1.0 / (1.0 / self.information + q) } else { 0.0 };
        self.information = prior + 1.0 / r;
        self.disturbance_enu_n += (measured - self.disturbance_enu_n) / (r * self.information);
    }
}

/// `frame` without the sensors that are excluded.
pub(super) fn clean(frame: &SensorFrame, excluded: SensorSet) -> SensorFrame {
    let mut clean = *frame;
    if excluded.is_empty() {
        return clean;
    }
    let out = |kind, index: usize| excluded.contains(SensorId::new(kind, index as u8 + 1));
    // One line for each type: their samples are of different types.
    clean.imus.iter_mut().enumerate().filter(|(i, _)| out(SensorKind::Imu, *i)).for_each(|(_, s)| *s = None);
    clean.heights.iter_mut().enumerate().filter(|(i, _)| out(SensorKind::Height, *i)).for_each(|(_, s)| *s = None);
    let barometers = clean.barometers.iter_mut().enumerate();
    barometers.filter(|(i, _)| out(SensorKind::Barometer, *i)).for_each(|(_, s)| *s = None);
    clean
}
