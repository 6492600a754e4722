//! What corrects every lane: the sensors that all of them share, and the couplings that add redundancy.
//!
//! | row | innovation | H |
//! |---|---|---|
//! | height l | y − off_l − z(t_s), its reach limited | z: 1, v_z: t_s − t |
//! | pose | position and attitude at t_s | p: I, φ |
//! | GNSS | position and velocity at t_s | p, v: I |
//! | rotor drag | (f − b_a + d Rᵀv)_xy | v: −d Rᵀ, φ: −d Rᵀ[v]ₓ, b_a: I |
//! | magnetometers, median | angle from the levelled field to north | φ_z: 1 |
//! | nothing horizontal | 0 − v, loosely | v: 1 |
//!
//! The field corrects yaw alone. Motors and the steel of a room bend it by a fifth and for as long as a flight lasts: as three
//! components without correlation it tilted lanes by 10°, and what that made of gravity was taken for speed.
//!
//! Drag is heard only while nothing else holds the vehicle (`thrust.rs`): strings that hold it aside would be learned as a bias.
//!
//! No gate rejects: beyond 3 σ the noise counts as larger. A filter that rejects locks itself out under vibration.

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::evidence::Heard;
use super::heights::Heights;
use super::integral::Six;
use super::lane::Lane;
use super::slot::Slot;
use crate::estimate::aiding::idle::{
    POSITION_CORRELATION_S, POSITION_SIGMA_M, STANDING_SIGMA_M, VELOCITY_CORRELATION_S, VELOCITY_SIGMA_MPS, whitening,
};
use crate::estimate::aiding::{ANGLES, VELOCITY, XYZ};
use crate::estimate::ekf_bias::aiding::row;
use crate::estimate::ekf_bias::covariance::{ErrorState, N, augment_barometer, ix};
use crate::estimate::ekf_bias::heading::yaw_row;
use crate::estimate::filter::row::ScalarRow;
use crate::estimate::{Channel, Residuals};
use crate::frames::skew;
use crate::sensor::heading;
use crate::sensor::imu::MagnetometerModel;
use crate::sensor::measure;
use crate::sensor::{Accuracy, MAX_HEIGHTS, SensorModel};
use crate::sensor::{barometer, height, mocap_pose};

/// Beyond so many sigmas noise counts as larger.
pub(super) const KNEE: f64 = 3.0;
/// No height is taken for better, m: what lasers are off by, and the motion within a scan.
const HEIGHT_SIGMA_M: f64 = 0.025;
/// No pose is taken for better, m and rad.
const POSE_SIGMA: (f64, f64) = (0.002, 0.005);
/// Specific force in the plane that drag does not explain, m/s²; and how much of the lane's own noise.
const DRAG_SIGMA_MPS2: f64 = 0.85;
const DRAG_OWN: f64 = 3.0;
/// Of the magnetic field, over its strength.
const FIELD_SIGMA: f64 = 0.15;
/// One-sigma of the velocity of a vehicle at rest, m/s.
const REST_SIGMA_MPS: f64 = 0.05;

/// What nothing measures is bounded by.
#[derive(Debug, Clone, Copy)]
pub struct Unaided {
    /// Since the last pseudo-measurement, s.
    pub since_s: f64,
    /// Which axes no sensor aids.
    pub axes: [bool; 3],
    /// Does the vehicle rest?
    pub resting: bool,
    /// Does it stand on the floor, whose place only a barometer tells?
    pub standing: bool,
    /// Where the position was last known, ENU, m.
    pub anchor: Vector3<f64>,
}

/// What is known in a slot beside its samples.
pub struct Around<'a> {
    /// Of the sensors.
    pub model: &'a SensorModel,
    /// Of the lasers.
    pub heights: &'a Heights,
    /// What each reads beyond its reach from the others, by the mean of all lanes, m: a lane that is off has no say in it.
    pub beyond_m: [f64; MAX_HEIGHTS],
    /// Strength of the magnetic field where the vehicle started, µT, where it is to be used.
    pub field_ut: Option<f64>,
    /// Drag over mass, 1/s, while nothing but drag acts in the rotors' plane.
    pub drag: Option<f64>,
    /// Are the barometers to be used?
    pub barometers: bool,
    /// One-sigma of the rotors' wash on them, m.
    pub wash_sigma_m: f64,
    /// Height over the floor by GNSS, m, where nothing says more.
    pub gnss_height_m: Option<f64>,
    /// Does GNSS tell anything horizontal?
    pub yaw_known: bool,
    /// Due in this slot?
    pub unaided: Option<Unaided>,
}

/// A lane being corrected, and what is heard of it.
pub struct Correction<'a> {
    /// The lane.
    pub lane: &'a mut Lane,
    /// What it made of the rows.
    pub heard: Heard,
    /// Residuals go here …
    pub residuals: &'a mut Residuals,
    /// … with their sensors' names, or none at all.
    pub named: bool,
}

impl Correction<'_> {
    /// Everything in `slot`; `sigma` is that of the lane's own means.
    pub fn take(&mut self, slot: &Slot, around: &Around, sigma: &Six) {
        self.take_heights(slot, around);
        self.take_pose(slot, around);
        self.take_gnss(slot, around);
        if around.barometers {
            self.take_barometers(slot, around);
        }
        if let Some(drag) = around.drag {
            self.take_drag(drag, sigma);
        }
        if let Some((strength_ut, measured_ut)) = around.field_ut.zip(slot.field_ut) {
            self.take_heading(strength_ut, &measured_ut, &around.model.imus.mag);
        }
        if let Some(unaided) = &around.unaided {
            self.bound(unaided);
        }
    }

    fn row(&mut self, mut row: ScalarRow<N>) {
        row.of = row.of.filter(|_| self.named);
        if let Some((dx, ratio)) = row.correct_robustly(KNEE, &mut self.lane.p, self.residuals) {
            self.heard.hear(ratio);
            self.lane.inject(&dx);
        }
    }

    fn take_heights(&mut self, slot: &Slot, around: &Around) {
        for (i, sample) in slot.heights.iter().enumerate() {
            let Some((time, height_m)) = *sample else { continue };
            let age_s = slot.age_s(time);
            let past = self.lane.past(age_s);
            let off_m = around.heights.off_m(i, past.position_enu_m.z);
            let measured = height::height(&past, height_m - off_m);
            let weight = around.heights.weight(i);
            let sigma = around.model.heights.sigma.max(HEIGHT_SIGMA_M) / weight.max(1e-3).sqrt();
            let of = (SensorId::new(SensorKind::Height, i as u8 + 1), Channel::Height);
            let mut row = row(of, &measured, Accuracy { sigma, ..around.model.heights }, age_s);
            row.innovation -= around.beyond_m[i];
            row.refused = weight == 0.0;
            self.row(row);
        }
    }

    fn take_pose(&mut self, slot: &Slot, around: &Around) {
        let Some(pose) = slot.pose else { return };
        let (model, age_s) = (around.model.mocap_pose, slot.age_s(pose.time));
        let sensor = SensorId::new(SensorKind::MocapPose, 1);
        let noise = Accuracy { sigma: model.position.sigma.max(POSE_SIGMA.0), ..model.position };
        for (axis, channel) in XYZ.into_iter().enumerate() {
            let measured = measure::position(&self.lane.past(age_s), axis, pose.position_enu_m[axis]);
            self.row(row((sensor, channel), &measured, noise, age_s));
        }
        let noise = Accuracy { sigma: model.attitude.sigma.max(POSE_SIGMA.1), ..model.attitude };
        for (i, channel) in ANGLES.into_iter().enumerate() {
            let measured = mocap_pose::attitude(&self.lane.past(age_s), &pose.world_from_body)[i];
            self.row(row((sensor, channel), &measured, noise, 0.0));
        }
    }

    fn take_gnss(&mut self, slot: &Slot, around: &Around) {
        let Some(sample) = slot.gnss else { return };
        let (model, age_s) = (around.model.gnss, slot.age_s(sample.time));
        let sensor = SensorId::new(SensorKind::Gnss, 1);
        let [east, north] = [0, 1].map(|axis| around.yaw_known.then_some(sample.position_enu_m[axis]));
        for (axis, place_m) in [east, north, around.gnss_height_m].into_iter().enumerate() {
            if let Some(place_m) = place_m {
                let measured = measure::position(&self.lane.past(age_s), axis, place_m);
                self.row(row((sensor, XYZ[axis]), &measured, model.position(&sample, axis), age_s));
            }
        }
        for (axis, channel) in VELOCITY.into_iter().enumerate().skip(if around.yaw_known { 0 } else { 2 }) {
            let measured = measure::velocity(&self.lane.past(age_s), axis, sample.velocity_enu_mps[axis]);
            self.row(row((sensor, channel), &measured, model.velocity, age_s));
        }
    }

    fn take_barometers(&mut self, slot: &Slot, around: &Around) {
        let model = &around.model.barometers;
        for (i, sample) in slot.barometers.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let (altitude_m, age_s) = (model.altitude_m(sample), slot.age_s(sample.time));
            let past = self.lane.past(age_s);
            if !altitude_m.is_finite() {
                continue;
            }
            let Some(offset_m) = self.lane.barometer_offset_m[i] else {
                self.lane.barometer_offset_m[i] = Some(altitude_m - past.position_enu_m.z);
                augment_barometer(&mut self.lane.p, ix::BAROMETER + i, model.altitude.sigma.powi(2));
                continue;
            };
            let measured = barometer::altitude(&past, altitude_m, offset_m);
            let of = (SensorId::new(SensorKind::Barometer, i as u8 + 1), Channel::PressureAltitude);
            let noise = Accuracy { sigma: model.altitude.sigma.hypot(around.wash_sigma_m), ..model.altitude };
            let mut row = row(of, &measured, noise, age_s);
            row.h[ix::BAROMETER + i] = 1.0;
            self.row(row);
        }
    }

    /// A row that is no sensor's own.
    fn coupling(&mut self, innovation: f64, h: ErrorState, sigma: f64) {
        self.row(ScalarRow::new(innovation, h, sigma * sigma));
    }

    fn take_drag(&mut self, drag: f64, sigma: &Six) {
        let sigma = DRAG_SIGMA_MPS2.hypot(DRAG_OWN * 0.5 * (sigma[0] + sigma[1]));
        for axis in 0..2 {
            let at = &self.lane.at;
            let body_from_world = at.world_from_body.inverse().to_rotation_matrix().into_inner();
            let innovation = self.lane.force[axis] + drag * (body_from_world * at.velocity_enu_mps)[axis];
            let turned = body_from_world * skew(&at.velocity_enu_mps);
            let mut h = ErrorState::zeros();
            for j in 0..3 {
                h[ix::VELOCITY + j] = -drag * body_from_world[(axis, j)];
                h[ix::ATTITUDE + j] = -drag * turned[(axis, j)];
            }
            h[ix::ACCEL_BIAS + axis] = 1.0;
            let before = self.lane.accel_bias[axis];
            self.coupling(innovation, h, sigma);
            self.lane.force[axis] -= self.lane.accel_bias[axis] - before;
        }
    }

    fn take_heading(&mut self, strength_ut: f64, measured_ut: &Vector3<f64>, model: &MagnetometerModel) {
        let Some(heading) = heading::heading(&self.lane.at, measured_ut, model.declination_rad) else { return };
        if (measured_ut.norm() / strength_ut - 1.0).abs() > model.field_tolerance {
            return;
        }
        let noise = Accuracy { sigma: FIELD_SIGMA * strength_ut / heading.horizontal_ut, gate: f64::INFINITY };
        // The median of all: no sensor's own.
        let of = (SensorId::new(SensorKind::Imu, 1), Channel::Heading);
        self.row(ScalarRow { of: None, ..yaw_row(of, &heading, noise, &self.lane.p) });
    }

    /// What nothing measures; see `ekf_bias/idle.rs`. No lane is judged by it.
    fn bound(&mut self, unaided: &Unaided) {
        let velocity = match unaided.resting {
            true => REST_SIGMA_MPS.powi(2),
            false => VELOCITY_SIGMA_MPS.powi(2) * whitening(VELOCITY_CORRELATION_S, unaided.since_s),
        };
        let position = POSITION_SIGMA_M.powi(2) * whitening(POSITION_CORRELATION_S, unaided.since_s);
        for (axis, unknown) in unaided.axes.into_iter().enumerate() {
            if unknown || unaided.resting {
                self.pseudo(ix::VELOCITY + axis, -self.lane.at.velocity_enu_mps[axis], velocity);
            }
            let away = unaided.anchor[axis] - self.lane.at.position_enu_m[axis];
            if axis == 2 && unaided.standing {
                self.pseudo(ix::POSITION + axis, away, STANDING_SIGMA_M.powi(2));
            } else if unknown {
                self.pseudo(ix::POSITION + axis, away, position);
            }
        }
    }

    fn pseudo(&mut self, i: usize, innovation: f64, variance: f64) {
        if let Some(dx) = ScalarRow::pseudo(i, innovation, variance).correct(&mut self.lane.p, self.residuals) {
            self.lane.inject(&dx);
        }
    }
}
