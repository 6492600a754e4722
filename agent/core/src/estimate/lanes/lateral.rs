//! The lanes about hover along one horizontal axis: position, velocity, tilt about the other axis, and both biases, by finite
//! differences of the lane that flies. `linear.rs` has the vertical axis and the limits of the judges.

use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::SLOT_S;
use super::integral::Six;
use super::lane::Lane;
use super::linear::{Hovering, Shaken};
use super::rows::Unaided;
use super::slot::Slot;
use crate::estimate::aiding::{ANGLES, VELOCITY, XYZ};
use crate::estimate::ekf_bias::covariance::ix;
use crate::estimate::{Channel, Residuals};
use crate::model::airframe::Airframe;
use crate::sensor::gnss::GnssSample;
use crate::sensor::mocap_pose::MocapPoseSample;
use crate::sensor::{MAX_HEIGHTS, SensorModel};

/// Position (m), velocity (m/s), tilt (rad), bias of accelerometer (m/s²) and gyroscope (rad/s).
pub const STATES: usize = 5;
/// Innovations that lanes are judged by, at most.
pub const ROWS: usize = 2;
/// After a slot: states, then innovations over their one-sigma.
pub const OUTPUTS: usize = STATES + ROWS;
/// Before it: states, mean specific force (m/s²) and mean rate (rad/s), then position, velocity and tilt as measured.
pub const INPUTS: usize = STATES + 2 + 3;
/// One slot of a lane: outputs from inputs.
pub type Map = SMatrix<f64, OUTPUTS, INPUTS>;

/// Without aid what nothing measures is bounded every third slot.
pub const UNAIDED_SLOTS: usize = 3;

/// What measures the horizontal motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aid {
    /// Nothing.
    None,
    /// Position and velocity.
    Gnss,
    /// Position and tilt.
    Pose,
}

impl Aid {
    /// Its innovations along `axis`.
    pub fn rows(self, axis: usize) -> Option<[Channel; ROWS]> {
        match self {
            Self::None => None,
            Self::Gnss => Some([XYZ[axis], VELOCITY[axis]]),
            Self::Pose => Some([XYZ[axis], ANGLES[1 - axis]]),
        }
    }
}

/// What a lane is asked about.
#[derive(Debug, Clone, Copy)]
pub struct Along<'a> {
    /// 0: x, with pitch; 1: y, with roll.
    pub axis: usize,
    /// What measures.
    pub aid: Aid,
    /// For each slot of a cycle how long before its end the aid measured, s.
    pub ages_s: &'a [Option<f64>],
    /// Horizontal one-sigma that a GNSS receiver tells, m.
    pub gnss_sigma_m: f64,
}

impl Along<'_> {
    fn slot(&self, number: u64, measured: [f64; 3], z_m: f64) -> Slot {
        let mut slot = Slot { number, ..Slot::default() };
        let age_s = self.ages_s.get(number as usize % self.ages_s.len().max(1)).copied().flatten();
        let Some(age_s) = age_s else { return slot };
        let time = FlightTime(slot.end().0.saturating_sub((1e6 * age_s).round() as u64));
        let (mut place, mut speed, mut angle) = (Vector3::z() * z_m, Vector3::zeros(), Vector3::zeros());
        (place[self.axis], speed[self.axis], angle[1 - self.axis]) = (measured[0], measured[1], measured[2]);
        match self.aid {
            Aid::None => {}
            Aid::Gnss => {
                slot.gnss = Some(GnssSample {
                    time,
                    position_enu_m: place,
                    velocity_enu_mps: speed,
                    geodetic: [0.0; 3],
                    horizontal_sigma_m: self.gnss_sigma_m,
                    vertical_sigma_m: self.gnss_sigma_m,
                    satellites: 0,
                });
            }
            Aid::Pose => {
                let world_from_body = UnitQuaternion::from_scaled_axis(angle);
                slot.pose = Some(MocapPoseSample { time, position_enu_m: place, world_from_body });
            }
        }
        slot
    }

    fn unaided(&self, number: u64, z_m: f64) -> Option<Unaided> {
        let due = self.aid == Aid::None && number.is_multiple_of(UNAIDED_SLOTS as u64);
        let anchor = Vector3::z() * z_m;
        let axes = [true, true, false];
        due.then_some(Unaided { since_s: UNAIDED_SLOTS as f64 * SLOT_S, axes, resting: false, standing: false, anchor })
    }

    /// The maps of the slots of one cycle, covariance steady, accelerometers of the measured noise `noise_mps2`, at altitude `z_m`.
    pub fn cycle(&self, model: &SensorModel, airframe: &Airframe, noise_mps2: f64, z_m: f64) -> Vec<Map> {
        let (axis, about) = (self.axis, 1 - self.axis);
        let drag = airframe.linear_drag_nspm / airframe.mass_kg;
        let shaken = Shaken { noise_mps2, rectified_mps2: 0.0 };
        let mut hovering = Hovering::new(model, &[1.0; MAX_HEIGHTS], &shaken, z_m, Some(drag));
        let outputs = |hovering: &Hovering, number: u64, x: &[f64; INPUTS]| {
            let [position, velocity, tilt, accel, gyro, force, rate, measured @ ..] = *x;
            let mut lane = hovering.lane.clone();
            lane.at.position_enu_m[axis] += position;
            lane.at.velocity_enu_mps[axis] += velocity;
            let mut turned = Vector3::zeros();
            turned[about] = tilt;
            lane.at.world_from_body = UnitQuaternion::from_scaled_axis(turned) * lane.at.world_from_body;
            lane.accel_bias[axis] += accel;
            lane.gyro_bias[about] += gyro;
            let mut mean = Six::zeros();
            (mean[axis], mean[3 + about]) = (force, rate);
            let slot = self.slot(number, measured, z_m);
            let residuals = hovering.step(&mut lane, &slot, mean, self.unaided(number, z_m));
            let out = self.told(&lane, &residuals);
            (lane, out, residuals)
        };
        let kept = [ix::POSITION + axis, ix::VELOCITY + axis, ix::ATTITUDE + about];
        let kept = [&kept[..], &[ix::ACCEL_BIAS + axis, ix::GYRO_BIAS + about]].concat();
        let period = if self.aid == Aid::None { UNAIDED_SLOTS } else { self.ages_s.len() };
        hovering.maps(period, &kept, outputs).into_iter().map(|(map, _)| map).collect()
    }

    fn told(&self, lane: &Lane, residuals: &Residuals) -> [f64; OUTPUTS] {
        let (axis, about) = (self.axis, 1 - self.axis);
        let mut out = [0.0; OUTPUTS];
        out[0] = lane.at.position_enu_m[axis];
        out[1] = lane.at.velocity_enu_mps[axis];
        out[2] = lane.at.world_from_body.scaled_axis()[about];
        out[3] = lane.accel_bias[axis];
        out[4] = lane.gyro_bias[about];
        for (place, channel) in out[STATES..].iter_mut().zip(self.aid.rows(axis).into_iter().flatten()) {
            let row = residuals.iter().find(|residual| residual.channel == channel);
            *place = row.map_or(0.0, |row| row.innovation / row.sigma);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilt_accelerates_and_a_pose_pulls() {
        let (model, airframe) = (SensorModel::default(), Airframe::iris());
        let g = model.imus.gravity_mps2;
        // Pitch drives along +x, roll along −y.
        for (axis, sign) in [(0, 1.0), (1, -1.0)] {
            let along = |aid, ages_s: &[Option<f64>]| {
                Along { axis, aid, ages_s, gnss_sigma_m: 1.0 }.cycle(&model, &airframe, 0.05, 1.0)
            };
            let free = along(Aid::None, &[None]);
            assert_eq!(free.len(), UNAIDED_SLOTS);
            let drives = free[1][(1, 2)];
            assert!((drives / (sign * g * SLOT_S) - 1.0).abs() < 0.02, "{axis}: {drives}");
            assert!(free.iter().all(|map| map.rows(STATES, ROWS).amax() == 0.0));
            let posed = along(Aid::Pose, &[Some(0.01), None]);
            let (pulled, missed) = (&posed[0], &posed[1]);
            let gain = pulled[(0, STATES + 2)];
            assert!(gain > 0.01 && gain < 1.0 && pulled[(2, INPUTS - 1)] > 0.01, "{axis}: {pulled:.3}");
            // A step of the estimate and one of what is measured surprise alike, the other way round.
            assert!((pulled[(STATES, 0)] + pulled[(STATES, STATES + 2)]).abs() < 1e-6 * pulled[(STATES, 0)].abs());
            assert_eq!(missed.rows(STATES, ROWS).amax(), 0.0);
            let located = along(Aid::Gnss, &[None, Some(0.02)]);
            assert!(located[1][(STATES + 1, STATES + 3)] > 0.1 && located[1][(1, STATES + 3)] > 0.0);
        }
    }
}
