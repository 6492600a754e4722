//! Our estimate and a place to hold, for an autopilot whose own controller flies (\[Clinic\] 5.8).
//!
//! | message | what it says | when |
//! |---|---|---|
//! | ODOMETRY | the estimate in the loop: pose in MAV_FRAME_LOCAL_FRD (our NED, as its heading need not be north), velocity and rates in MAV_FRAME_BODY_FRD | 50 Hz while it carries a flight |
//! | SET_POSITION_TARGET_LOCAL_NED | place, velocity, yaw of the setpoint; while it shall stand, [`GROUNDED_M`] below where it is | with it |
//!
//! Stamped by our clock, which TIMESYNC lets the autopilot map to its own. Covariances hold what the estimate says of itself:
//! variances of position, and of velocity and attitude turned into the body's axes; what is not known is NaN.
//!
//! Where the estimate carries no flight both stay out: the autopilot's own estimator then loses external vision, and half a
//! second later it leaves offboard mode for what its failsafe is set to.

use std::io;
use std::sync::{Arc, Mutex};

use mavlink::dialects::common::{
    MavEstimatorType, MavFrame, MavMessage, ODOMETRY_DATA, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use plumbline_core::estimate::{Estimate, Health, Motion};
use plumbline_core::flight::Guide;
use plumbline_core::frames::{Enu, Flu, Frd, Ned, heading_from_yaw, ned_from_frd, roll_pitch_yaw, wrap_pi};
use plumbline_core::types::{MotorCommand, Setpoint};
use plumbline_core::vehicle::{AutopilotState, MotorStop};

use super::{AUTOPILOT, Autopilot};
use crate::motors::Motors;
use crate::reader::Zero;

/// Between two of them, µs, with half a tick of slack.
const PERIOD_US: u64 = 20_000 - 500;
/// Below where it stands, m: no noise of an estimate makes a take-off of that.
pub const GROUNDED_M: f64 = 0.5;
/// An estimate that moves so much farther between two ticks than its velocity says has been reset, m …
const RESET_M: f64 = 0.1;
/// … or turns so much farther than its rates say, rad.
const RESET_RAD: f64 = 0.1;
/// Longest gap between two estimates that are compared, s.
const COMPARED_S: f64 = 0.1;

/// Entries of a symmetric 6 × 6 matrix by rows, upper triangle.
type Triangle = [f32; 21];

/// The flight thread's end.
#[derive(Debug)]
pub struct PoseLine {
    autopilot: Arc<Autopilot>,
    zero: Zero,
    /// Of the flight thread alone.
    sent: Mutex<Sent>,
}

/// What was sent last.
#[derive(Debug, Default)]
struct Sent {
    at_us: u64,
    resets: u8,
    last: Option<Moved>,
}

/// An estimate, as far as the next one follows from it.
#[derive(Debug, Clone, Copy)]
struct Moved {
    time_s: f64,
    motion: Motion,
    attitude: UnitQuaternion<f64>,
    rates: Vector3<f64>,
}

impl Sent {
    /// Counts the estimate's resets.
    fn follow(&mut self, estimate: &Estimate) {
        let now = Moved {
            time_s: estimate.time.as_seconds(),
            motion: estimate.motion_or_rest(),
            attitude: estimate.world_from_body,
            rates: estimate.body_rates_radps,
        };
        let Some(then) = self.last.replace(now) else { return };
        let dt_s = now.time_s - then.time_s;
        let flown_m = then.motion.velocity_enu_mps * dt_s;
        let moved_m = (now.motion.position_enu_m - then.motion.position_enu_m - flown_m).norm();
        let turned = then.attitude * UnitQuaternion::from_scaled_axis(then.rates * dt_s);
        let jumps = moved_m > RESET_M || turned.angle_to(&now.attitude) > RESET_RAD;
        if dt_s > 0.0 && dt_s < COMPARED_S && jumps {
            self.resets = self.resets.wrapping_add(1);
        }
    }
}

impl PoseLine {
    /// To `autopilot`, with flight time from `zero`.
    pub fn new(autopilot: Arc<Autopilot>, zero: Zero) -> Self {
        Self { autopilot, zero, sent: Mutex::default() }
    }
}

impl Motors for PoseLine {
    fn guide(&self, guide: Option<&Guide<'_>>) {
        let (Some(guide), Ok(mut sent)) = (guide, self.sent.lock()) else { return };
        sent.follow(guide.estimate);
        let Some(zero_us) = self.zero.micros(self.autopilot.begun) else { return };
        let flight_us = guide.estimate.time.0;
        if flight_us < sent.at_us + PERIOD_US {
            return;
        }
        sent.at_us = flight_us;
        let time_us = (flight_us as f64 - zero_us).max(0.0) as u64;
        self.autopilot.say(&MavMessage::ODOMETRY(odometry(guide.estimate, time_us, sent.resets)));
        let mut target = position_target(guide, (time_us / 1000) as u32);
        (target.target_system, target.target_component) = (self.autopilot.attachment.system, AUTOPILOT);
        self.autopilot.setpoint(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(target));
    }

    fn send(&self, command: &MotorCommand) -> io::Result<MotorCommand> {
        self.autopilot.wants(command)?;
        Ok(self.autopilot.said().outputs.filter(|_| self.autopilot.obeyed()).unwrap_or_default())
    }

    fn autopilot(&self) -> Option<AutopilotState> {
        Some(self.autopilot.said())
    }
}

impl MotorStop for PoseLine {
    fn stop(&self) {
        self.autopilot.stop();
    }
}

/// `estimate` at `time_us` of our clock.
pub fn odometry(estimate: &Estimate, time_us: u64, resets: u8) -> ODOMETRY_DATA {
    let motion = estimate.motion_or_rest();
    let Ned(place) = Enu(motion.position_enu_m).into();
    let attitude = ned_from_frd(estimate.world_from_body);
    let Ned(velocity) = Enu(motion.velocity_enu_mps).into();
    let velocity = attitude.inverse() * velocity;
    let Frd(rates) = Flu(estimate.body_rates_radps).into();
    // Of the two that mean it, the one that says least turn.
    let q = attitude.quaternion() * if attitude.w < 0.0 { -1.0 } else { 1.0 };
    // Of the world's axes NED.
    let variance = |sigma: Option<Vector3<f64>>| {
        sigma.map(|sigma_enu| {
            Matrix3::from_diagonal(&Vector3::new(sigma_enu.y, sigma_enu.x, sigma_enu.z).map(|s| s * s))
        })
    };
    let in_body = |world: Matrix3<f64>| {
        let body_from_ned = attitude.inverse().to_rotation_matrix();
        body_from_ned.matrix() * world * body_from_ned.matrix().transpose()
    };
    ODOMETRY_DATA {
        time_usec: time_us,
        x: place.x as f32,
        y: place.y as f32,
        z: place.z as f32,
        q: [q.w, q.i, q.j, q.k].map(|value| value as f32),
        vx: velocity.x as f32,
        vy: velocity.y as f32,
        vz: velocity.z as f32,
        rollspeed: rates.x as f32,
        pitchspeed: rates.y as f32,
        yawspeed: rates.z as f32,
        pose_covariance: triangle(
            variance(motion.position_sigma_m),
            variance(estimate.attitude_sigma_rad).map(in_body),
        ),
        velocity_covariance: triangle(variance(motion.velocity_sigma_mps).map(in_body), None),
        frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        reset_counter: resets,
        estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
        quality: if estimate.health == Health::Healthy { 100 } else { 1 },
    }
}

/// Two blocks of three on the diagonal; NaN where nothing is known.
fn triangle(first: Option<Matrix3<f64>>, second: Option<Matrix3<f64>>) -> Triangle {
    let mut all = [f32::NAN; 21];
    let entries = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    for (entry, (row, column)) in all.iter_mut().zip(entries) {
        let block = if column < 3 { first.as_ref() } else { second.as_ref().filter(|_| row >= 3) };
        let value = block.and_then(|block| block.get((row % 3, column % 3)));
        *entry = value.map_or(f32::NAN, |value| *value as f32);
    }
    all
}

/// Where it shall be, `time_ms` on our clock, for no system yet.
pub fn position_target(guide: &Guide<'_>, time_ms: u32) -> SET_POSITION_TARGET_LOCAL_NED_DATA {
    use PositionTargetTypemask as Mask;
    let mut type_mask = Mask::POSITION_TARGET_TYPEMASK_AX_IGNORE
        | Mask::POSITION_TARGET_TYPEMASK_AY_IGNORE
        | Mask::POSITION_TARGET_TYPEMASK_AZ_IGNORE
        | Mask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE;
    let (place, velocity, yaw_rad) = match guide.setpoint {
        Some(Setpoint { position_enu_m, velocity_enu_mps, roll_pitch_yaw_rad, .. }) => {
            (*position_enu_m, *velocity_enu_mps, roll_pitch_yaw_rad.z)
        }
        None => {
            type_mask |= Mask::POSITION_TARGET_TYPEMASK_VX_IGNORE
                | Mask::POSITION_TARGET_TYPEMASK_VY_IGNORE
                | Mask::POSITION_TARGET_TYPEMASK_VZ_IGNORE;
            let here = guide.estimate.motion_or_rest().position_enu_m;
            let yaw_rad = roll_pitch_yaw(&guide.estimate.world_from_body).z;
            (here - GROUNDED_M * Vector3::z(), Vector3::zeros(), yaw_rad)
        }
    };
    let (Ned(place), Ned(velocity)) = (Enu(place).into(), Enu(velocity).into());
    SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: time_ms,
        x: place.x as f32,
        y: place.y as f32,
        z: place.z as f32,
        vx: velocity.x as f32,
        vy: velocity.y as f32,
        vz: velocity.z as f32,
        yaw: wrap_pi(heading_from_yaw(yaw_rad)) as f32,
        type_mask,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::time::FlightTime;

    fn estimate() -> Estimate {
        Estimate {
            motion: Some(Motion {
                position_enu_m: Vector3::new(1.0, 2.0, 3.0),
                velocity_enu_mps: Vector3::new(0.5, 0.0, 0.1),
                position_sigma_m: Some(Vector3::new(0.1, 0.2, 0.3)),
                velocity_sigma_mps: Some(Vector3::new(0.1, 0.2, 0.3)),
                ..Motion::default()
            }),
            // Facing north, leaning to the right.
            world_from_body: UnitQuaternion::from_euler_angles(0.1, 0.0, std::f64::consts::FRAC_PI_2),
            body_rates_radps: Vector3::new(0.1, 0.2, 0.3),
            attitude_sigma_rad: Some(Vector3::new(0.01, 0.02, 0.03)),
            health: Health::Healthy,
            ..Estimate::default()
        }
    }

    #[test]
    fn an_estimate_is_said_in_front_right_down() {
        let said = odometry(&estimate(), 7, 3);
        assert_eq!(([said.x, said.y, said.z], said.time_usec, said.reset_counter), ([2.0, 1.0, -3.0], 7, 3));
        // North is ahead: leaning by 0.1 about x.
        let expected = UnitQuaternion::from_euler_angles(0.1, 0.0, 0.0);
        let q = expected.quaternion();
        for (theirs, ours) in said.q.iter().zip([q.w, q.i, q.j, q.k]) {
            assert!((f64::from(*theirs) - ours).abs() < 1e-6, "{:?}", said.q);
        }
        // East is to the right.
        assert!((said.vy - 0.5 * 0.1_f32.cos() + 0.1 * 0.1_f32.sin()).abs() < 1e-6, "{} {}", said.vy, said.vz);
        assert!((said.vz + 0.5 * 0.1_f32.sin() + 0.1 * 0.1_f32.cos()).abs() < 1e-6, "{}", said.vz);
        assert_eq!([said.rollspeed, said.pitchspeed, said.yawspeed], [0.1, -0.2, -0.3]);
    }

    #[test]
    fn covariances_are_upper_triangles_by_rows_and_nan_where_nothing_is_known() {
        let said = odometry(&estimate(), 0, 0);
        let pose = said.pose_covariance;
        for (index, expected) in [(0, 0.04), (6, 0.01), (11, 0.09), (1, 0.0), (7, 0.0)] {
            assert!((pose[index] - expected).abs() < 1e-6, "{index}: {pose:?}");
        }
        // Roll about the nose, which points north.
        assert!((pose[15] - 4e-4).abs() < 1e-7, "{pose:?}");
        let trace: f32 = [15, 18, 20].iter().map(|i| pose[*i]).sum();
        assert!((trace - 14e-4).abs() < 1e-7, "turned, not altered: {pose:?}");
        assert!([3, 4, 5, 8, 14].iter().all(|i| pose[*i].is_nan()), "{pose:?}");
        let velocity = said.velocity_covariance;
        assert!((velocity[0] - 0.04).abs() < 1e-6 && velocity[15].is_nan(), "{velocity:?}");
        let without = odometry(&Estimate { motion: Some(Motion::default()), ..Estimate::default() }, 0, 0);
        assert!(without.pose_covariance[0].is_nan() && without.velocity_covariance[0].is_nan());
    }

    #[test]
    fn a_jump_of_the_estimate_counts_as_a_reset() {
        let mut sent = Sent::default();
        let mut now = estimate();
        for tick in 0..40_u64 {
            now.time = FlightTime(5000 * tick);
            let jump_m = if tick >= 20 { 0.5 } else { 0.0 };
            let along = 0.5 * 0.005 * tick as f64;
            now.motion.as_mut().unwrap().position_enu_m = Vector3::new(1.0 + along + jump_m, 2.0, 3.0);
            now.motion.as_mut().unwrap().velocity_enu_mps = Vector3::new(0.5, 0.0, 0.0);
            now.body_rates_radps = Vector3::zeros();
            sent.follow(&now);
        }
        assert_eq!(sent.resets, 1);
    }

    #[test]
    fn what_shall_stand_is_asked_to_stay_below_and_what_flies_to_be_at_its_setpoint() {
        let estimate = estimate();
        let stands = position_target(&Guide { estimate: &estimate, setpoint: None }, 0);
        assert!((f64::from(stands.z) - (-3.0 + GROUNDED_M)).abs() < 1e-6 && (stands.x - 2.0).abs() < 1e-6);
        let setpoint = Setpoint { position_enu_m: Vector3::new(0.0, 1.0, 1.5), ..Setpoint::default() };
        let flies = position_target(&Guide { estimate: &estimate, setpoint: Some(&setpoint) }, 0);
        assert_eq!([flies.x, flies.y, flies.z], [1.0, 0.0, -1.5]);
        assert!((flies.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-6, "east: {}", flies.yaw);
        assert!(!flies.type_mask.contains(PositionTargetTypemask::POSITION_TARGET_TYPEMASK_VZ_IGNORE));
    }
}
