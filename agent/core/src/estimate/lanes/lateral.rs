//! The lanes about hover along one horizontal axis: position, velocity, tilt about the other axis, and both biases, by finite
//! differences of the lane that flies. `linear.rs` has the vertical axis and the limits of the judges.

use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::SLOT_S;
use super::integral::Six;
use super::lane::Lane;
use super::linear::{Hovering, Shaken, located, posed, together};
use super::rows::Unaided;
use super::slot::Slot;
use crate::estimate::aiding::{ANGLES, VELOCITY, XYZ};
use crate::estimate::ekf_bias::covariance::ix;
use crate::estimate::{Channel, Residuals};
use crate::model::airframe::Airframe;
use crate::sensor::{MAX_HEIGHTS, SensorModel};

/// Position (m), velocity (m/s), tilt (rad), bias of accelerometer (m/s²) and gyroscope (rad/s).
pub const STATES: usize = 5;
/// Innovations that lanes are judged by, at most.
pub const ROWS: usize = 2;
/// After a slot: states, then innovations over their one-sigma.
pub const OUTPUTS: usize = STATES + ROWS;
/// Means over a slot: specific force along the axis (m/s²), rate (rad/s), specific force along the thrust (m/s²).
pub const MEANS: usize = 3;
/// Before it: states, means, then position, velocity and tilt as measured.
pub const INPUTS: usize = STATES + MEANS + 3;
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

/// A swing along the axis in the place of a hover: x = A sin 2πt/T from the begin of the first slot on, at one altitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Swing {
    /// A, m.
    pub amplitude_m: f64,
    /// T, s.
    pub period_s: f64,
}

impl Swing {
    /// Place (m), velocity (m/s) and acceleration (m/s²) at `time_s`.
    pub fn at(self, time_s: f64) -> [f64; 3] {
        let turn = std::f64::consts::TAU / self.period_s;
        let (sin, cos) = (turn * time_s).sin_cos();
        [sin, turn * cos, -turn * turn * sin].map(|part| self.amplitude_m * part)
    }

    /// Tilt about the other axis that flies it against a drag over mass of `drag`, 1/s, rad.
    pub fn tilt_rad(self, time_s: f64, axis: usize, drag: f64, gravity_mps2: f64) -> f64 {
        let [_, velocity, acceleration] = self.at(time_s);
        let tilt = ((acceleration + drag * velocity) / gravity_mps2).atan();
        // Pitch drives along +x, roll along −y.
        if axis == 0 { tilt } else { -tilt }
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
    /// What is flown, where it is no hover.
    pub swing: Option<Swing>,
}

/// The vehicle along the axis at a moment of what is flown.
#[derive(Default, Clone, Copy)]
struct Moment {
    place_m: f64,
    speed_mps: f64,
    tilt_rad: f64,
}

impl Along<'_> {
    fn moment(&self, time_s: f64, drag: f64, gravity_mps2: f64) -> Moment {
        let Some(swing) = self.swing else { return Moment::default() };
        let [place_m, speed_mps, _] = swing.at(time_s);
        Moment { place_m, speed_mps, tilt_rad: swing.tilt_rad(time_s, self.axis, drag, gravity_mps2) }
    }

    /// Slots after which everything repeats.
    fn period(&self) -> usize {
        let aided = if self.aid == Aid::None { UNAIDED_SLOTS } else { self.ages_s.len().max(1) };
        together(&[aided, self.swing.map_or(1, |swing| (swing.period_s / SLOT_S).round() as usize)])
    }

    fn slot(&self, number: u64, measured: [f64; 3], z_m: f64, at: impl Fn(f64) -> Moment) -> Slot {
        let mut slot = Slot { number, ..Slot::default() };
        let age_s = self.ages_s.get(number as usize % self.ages_s.len().max(1)).copied().flatten();
        let Some(age_s) = age_s else { return slot };
        let time = FlightTime(slot.end().0.saturating_sub((1e6 * age_s).round() as u64));
        let at = at((number + 1) as f64 * SLOT_S - age_s);
        let measured = [measured[0] + at.place_m, measured[1] + at.speed_mps, measured[2] + at.tilt_rad];
        let (mut place, mut speed, mut angle) = (Vector3::z() * z_m, Vector3::zeros(), Vector3::zeros());
        (place[self.axis], speed[self.axis], angle[1 - self.axis]) = (measured[0], measured[1], measured[2]);
        match self.aid {
            Aid::None => {}
            Aid::Gnss => slot.gnss = Some(located(time, place, speed, self.gnss_sigma_m)),
            Aid::Pose => slot.pose = Some(posed(time, place, &angle)),
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
        let gravity_mps2 = model.imus.gravity_mps2;
        let at = |time_s: f64| self.moment(time_s, drag, gravity_mps2);
        let outputs = |hovering: &Hovering, number: u64, x: &[f64; INPUTS]| {
            let [position, velocity, tilt, accel, gyro, force, rate, lift, measured @ ..] = *x;
            let begin_s = number as f64 * SLOT_S;
            let (begin, middle, end) = (at(begin_s), at(begin_s + 0.5 * SLOT_S), at(begin_s + SLOT_S));
            let mut lane = hovering.lane.clone();
            // Each slot begins on the path, with its own deviation from it.
            lane.at.position_enu_m[axis] = begin.place_m + position;
            lane.at.velocity_enu_mps[axis] = begin.speed_mps + velocity;
            let mut turned = Vector3::zeros();
            turned[about] = begin.tilt_rad + tilt;
            lane.at.world_from_body = UnitQuaternion::from_scaled_axis(turned);
            (lane.accel_bias, lane.gyro_bias) = (Vector3::zeros(), Vector3::zeros());
            (lane.accel_bias[axis], lane.gyro_bias[about]) = (accel, gyro);
            let mut mean = Six::zeros();
            let cos = middle.tilt_rad.cos();
            mean[axis] = force - drag * middle.speed_mps * cos;
            mean[2] = lift + gravity_mps2 * (1.0 / cos - 1.0);
            mean[3 + about] = rate + (end.tilt_rad - begin.tilt_rad) / SLOT_S;
            let slot = self.slot(number, measured, z_m, at);
            let residuals = hovering.step(&mut lane, &slot, mean, self.unaided(number, z_m));
            let out = self.told(&lane, &residuals);
            (lane, out, residuals)
        };
        let kept = [ix::POSITION + axis, ix::VELOCITY + axis, ix::ATTITUDE + about];
        let kept = [&kept[..], &[ix::ACCEL_BIAS + axis, ix::GYRO_BIAS + about]].concat();
        hovering.maps(self.period(), &kept, outputs).into_iter().map(|(map, _)| map).collect()
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
                Along { axis, aid, ages_s, gnss_sigma_m: 1.0, swing: None }.cycle(&model, &airframe, 0.05, 1.0)
            };
            let free = along(Aid::None, &[None]);
            assert_eq!(free.len(), UNAIDED_SLOTS);
            let drives = free[1][(1, 2)];
            assert!((drives / (sign * g * SLOT_S) - 1.0).abs() < 0.02, "{axis}: {drives}");
            assert!(free.iter().all(|map| map.rows(STATES, ROWS).amax() == 0.0));
            let posed = along(Aid::Pose, &[Some(0.01), None]);
            let (pulled, missed) = (&posed[0], &posed[1]);
            let gain = pulled[(0, STATES + MEANS)];
            assert!(gain > 0.01 && gain < 1.0 && pulled[(2, INPUTS - 1)] > 0.01, "{axis}: {pulled:.3}");
            // A step of the estimate and one of what is measured surprise alike, the other way round.
            assert!((pulled[(STATES, 0)] + pulled[(STATES, STATES + MEANS)]).abs() < 1e-6 * pulled[(STATES, 0)].abs());
            assert_eq!(missed.rows(STATES, ROWS).amax(), 0.0);
            let located = along(Aid::Gnss, &[None, Some(0.02)]);
            assert!(located[1][(STATES + 1, STATES + MEANS + 1)] > 0.1 && located[1][(1, STATES + MEANS + 1)] > 0.0);
        }
    }

    #[test]
    fn along_a_swing_thrust_pushes_as_far_as_it_leans() {
        let (model, airframe) = (SensorModel::default(), Airframe::iris());
        let ages_s = [Some(0.01)];
        let maps = |axis: usize, swing: Option<Swing>| {
            Along { axis, aid: Aid::Pose, ages_s: &ages_s, gnss_sigma_m: 1.0, swing }
                .cycle(&model, &airframe, 0.05, 1.0)
        };
        for axis in [0, 1] {
            let swing = Swing { amplitude_m: 0.5, period_s: 3.2 };
            let (hover, along) = (&maps(axis, None)[0], maps(axis, Some(swing)));
            assert_eq!(along.len(), 80);
            // A quarter of the way: at its furthest, where it is pulled back.
            let lean = (0.5 * (std::f64::consts::TAU / 3.2).powi(2) / model.imus.gravity_mps2).atan().sin();
            let crest = &along[20];
            assert!(
                (crest[(1, STATES + 2)] / (-lean * SLOT_S) - 1.0).abs() < 0.1,
                "{axis}: {}",
                crest[(1, STATES + 2)]
            );
            assert!(hover[(1, STATES + 2)].abs() < 1e-6 && (lean - 0.193).abs() < 1e-3, "{lean}");
            // A tilt drives as at hover: the thrust is larger by what its lean takes.
            assert!((crest[(1, 2)] / hover[(1, 2)] - 1.0).abs() < 0.02, "{axis}: {} {}", crest[(1, 2)], hover[(1, 2)]);
            let slight = maps(axis, Some(Swing { amplitude_m: 1e-9, ..swing }));
            assert!((slight[33] - hover).amax() < 1e-3, "{axis}: {}", (slight[33] - hover).amax());
        }
    }
}
