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
//! Nonlinear flight: this filter linearises about its own attitude and holds at any tilt; what ends earlier is
//! the window's model (`flying.rs`), and then the last attacked set is kept.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::identify::Identifier;
use crate::estimate::ekf_bias::{EkfBias, EkfOptions};
use crate::estimate::{Estimate, Estimator};
use crate::model::airframe::Airframe;
use crate::model::motor;
use crate::vehicle::{MotorCommand, ROTORS, SensorFrame};

/// Noise of the disturbance, N/√s: strings go taut within a few ticks.
const DISTURBANCE_WALK_N: f64 = 20.0;
/// One-sigma of a specific force beyond the sensor's own: vibration, thrust curve, m/s².
const FORCE_SIGMA_MPS2: f64 = 0.3;

/// The filter and its disturbance states.
pub struct Gated {
    filter: EkfBias,
    airframe: Airframe,
    rotor_speed_radps: [f64; ROTORS],
    voltage_ratio: f64,
    disturbance_enu_n: Vector3<f64>,
    information: f64,
    /// IMUs flagged.
    liars: usize,
}

impl Gated {
    /// Nothing known yet.
    pub fn new(options: EkfOptions, airframe: &Airframe) -> Self {
        Self {
            airframe: airframe.clone(),
            filter: EkfBias::new(options),
            rotor_speed_radps: [0.0; ROTORS],
            voltage_ratio: 1.0,
            disturbance_enu_n: Vector3::zeros(),
            information: 0.0,
            liars: 0,
        }
    }

    /// One tick with the sensors that `identifier` has not flagged.
    pub fn step(&mut self, received: &SensorFrame, applied: &MotorCommand, identifier: &Identifier, dt_s: f64) {
        let liars = identifier.margin(SensorKind::Imu).flagged;
        if liars > self.liars {
            self.filter.doubt_accel_bias();
        }
        self.liars = liars;
        let clean = clean(received, identifier);
        self.filter.step(&clean, applied);
        self.disturb(received, applied, dt_s);
    }

    /// The filter's estimate.
    pub fn estimate(&self) -> &Estimate {
        self.filter.estimate()
    }

    /// Corrections of height and climb since it began, m and m/s: what lies between its path and the one that
    /// the IMUs alone would have given.
    pub fn vertical_corrections(&self) -> (f64, f64) {
        self.filter.vertical_corrections()
    }

    /// Force that neither thrust nor gravity explains, ENU, N.
    pub fn disturbance_enu_n(&self) -> Vector3<f64> {
        self.disturbance_enu_n
    }

    /// Starts again from `estimate`.
    pub fn reset_to(&mut self, estimate: &Estimate) {
        self.filter.reset_to(estimate);
    }

    fn disturb(&mut self, received: &SensorFrame, applied: &MotorCommand, dt_s: f64) {
        let airframe = &self.airframe;
        if let Some(v) = received.battery_v.filter(|v| v.is_finite() && *v > 0.0) {
            self.voltage_ratio = v / airframe.battery.nominal_v();
        }
        let dt_s = if dt_s.is_finite() { dt_s.clamp(0.0, 0.1) } else { 0.0 };
        let steady = motor::steady_speed(airframe, &applied.throttle, self.voltage_ratio);
        self.rotor_speed_radps = motor::after(airframe, &self.rotor_speed_radps, &steady, dt_s);
        let Some(force_mps2) = self.filter.specific_force_mps2() else { return };
        let attitude: UnitQuaternion<f64> = self.filter.estimate().world_from_body;
        let thrust = Vector3::new(0.0, 0.0, airframe.wrench(&self.rotor_speed_radps).thrust_n);
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

/// `frame` without the sensors that are withheld.
fn clean(frame: &SensorFrame, identifier: &Identifier) -> SensorFrame {
    let mut clean = *frame;
    let out = |kind, index: usize| identifier.is_withheld(SensorId::new(kind, index as u8 + 1));
    // One line for each type: their samples are of different types.
    clean.imus.iter_mut().enumerate().filter(|(i, _)| out(SensorKind::Imu, *i)).for_each(|(_, s)| *s = None);
    clean.heights.iter_mut().enumerate().filter(|(i, _)| out(SensorKind::Height, *i)).for_each(|(_, s)| *s = None);
    let barometers = clean.barometers.iter_mut().enumerate();
    barometers.filter(|(i, _)| out(SensorKind::Barometer, *i)).for_each(|(_, s)| *s = None);
    clean
}
