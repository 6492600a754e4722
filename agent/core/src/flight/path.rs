//! A path being flown: shapes are followed from tick to tick, lists of altitudes set the target in turn.

#![allow(clippy::result_large_err, reason = "bounded text on the stack: commands do not allocate")]

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use super::{Flight, Phase};
use crate::control::trajectory::{Trajectory, moment};
use crate::event::{EventKind, Severity, Text, text};
use crate::supervisor::monitor::{Outward, climb_stops_m};
use crate::types::{Mode, Setpoint};

/// What is flown, since when, from where.
#[derive(Debug, Clone)]
pub(super) struct Path {
    trajectory: Trajectory,
    start: FlightTime,
    from_enu_m: Vector3<f64>,
    /// Altitudes of a list set so far.
    set: usize,
}

impl Flight {
    /// Begins or ends a path.
    pub(super) fn set_trajectory(&mut self, trajectory: Option<&Trajectory>, now: FlightTime) -> Result<Text, Text> {
        let Some(trajectory) = trajectory else {
            if self.guidance.path.is_none() {
                return Ok(text(format_args!("no path is flown")));
            }
            self.end_path();
            return Ok(text(format_args!("path stopped")));
        };
        let shape = match trajectory {
            Trajectory::Shape { shape, .. } => Some(shape),
            Trajectory::Altitudes { .. } => None,
        };
        let horizontal = shape.is_some_and(|shape| shape.horizontal());
        let fits = self.mode == Mode::Hold || (self.mode == Mode::AltitudeHold && !horizontal);
        if !fits {
            let wanted = if horizontal { "hold" } else { "altitude hold or hold" };
            let mode = super::guard::mode_name(self.mode);
            return Err(text(format_args!("a path needs mode {wanted}, this is {mode}")));
        }
        if shape.is_some() && self.phase != Phase::Flying {
            return Err(text(format_args!("take off first: a shape begins in the air")));
        }
        let from_enu_m = self.guidance.profile.setpoint().position_enu_m;
        trajectory
            .check(&from_enu_m, &self.config.limits, self.config.altitude_max_m())
            .map_err(|e| text(format_args!("{e}")))?;
        self.check_stops(trajectory, horizontal, &from_enu_m)?;
        let mut path = Path { trajectory: trajectory.clone(), start: now, from_enu_m, set: 0 };
        let done = match trajectory {
            Trajectory::Shape { shape, .. } => text(format_args!("path begins: {shape}")),
            Trajectory::Altitudes { altitude_m, hold_s } => {
                // From the ground it takes off by its first: nothing is followed before it flies.
                if let Some(&first) = altitude_m.first() {
                    path.set = 1;
                    self.climb_to(first, now);
                }
                text(format_args!("path begins: {} altitudes, {hold_s} s each", altitude_m.len()))
            }
        };
        self.guidance.path = Some(path);
        self.event(Severity::Info, EventKind::Setpoint, done);
        Ok(done)
    }

    /// Would the monitor of the box let a shape be flown to its end? It judges by where the vehicle could come to rest.
    fn check_stops(&self, trajectory: &Trajectory, horizontal: bool, from_enu_m: &Vector3<f64>) -> Result<(), Text> {
        let margin_m = self.config.failsafe.box_margin_m;
        for at in trajectory.moments(from_enu_m) {
            let (p, v, a) = (at.position_enu_m, at.velocity_enu_mps, at.acceleration_enu_mps2);
            let aside_m = |(axis, side): (usize, f64)| {
                let (distance_m, speed_mps, pull_mps2) = (p[axis] * side, v[axis] * side, a[axis] * side);
                Outward { distance_m, speed_mps, pull_mps2 }.stops_m(0.0)
            };
            let (stops_m, limit_m) = if horizontal {
                let sides = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)];
                (sides.map(aside_m).into_iter().fold(0.0, f64::max), self.config.limits.lateral_max_m)
            } else {
                (p.z + climb_stops_m(v.z, a.z), self.config.altitude_max_m())
            };
            let ends_m = limit_m + margin_m;
            if stops_m > ends_m {
                return Err(text(format_args!(
                    "the path is too fast: on it the vehicle stops at {stops_m:.2} m, the box ends at {ends_m:.2} m"
                )));
            }
        }
        Ok(())
    }

    /// Makes an altitude the target, and measures the step to it from the target before; on the ground, from there.
    pub(super) fn climb_to(&mut self, to_m: f64, now: FlightTime) {
        let altitude_m = self.motion().position_enu_m.z;
        let from_m = if self.phase == Phase::Flying { self.guidance.target.position_enu_m.z } else { altitude_m };
        self.guidance.meter.begin(now, from_m, to_m, altitude_m);
        (self.guidance.target.position_enu_m.z, self.guidance.altitude_asked) = (to_m, true);
    }

    /// Stops a path where its setpoint is.
    pub(super) fn end_path(&mut self) {
        if self.guidance.path.take().is_some() {
            let here = *self.guidance.profile.setpoint();
            (self.guidance.target.position_enu_m, self.guidance.altitude_asked) = (here.position_enu_m, false);
            (self.guidance.target.roll_pitch_yaw_rad.x, self.guidance.target.roll_pitch_yaw_rad.y) = (0.0, 0.0);
            self.event(Severity::Info, EventKind::Setpoint, text(format_args!("path ended")));
        }
    }

    /// The setpoint of this tick.
    pub(super) fn setpoint_now(&mut self, dt_s: f64) -> Setpoint {
        if let Some(setpoint) = self.path_now(dt_s) {
            return *self.guidance.profile.follow(setpoint);
        }
        let (target, limits) = (self.target_now(), self.limits_now());
        *self.guidance.profile.step(&target, &limits, dt_s)
    }

    /// The setpoint of a shape being flown; sets the target of a list of altitudes.
    fn path_now(&mut self, dt_s: f64) -> Option<Setpoint> {
        let now = self.liveness.ticked.unwrap_or_default();
        let path = self.guidance.path.as_mut()?;
        let since_s = now.seconds_since(path.start);
        match &path.trajectory {
            Trajectory::Altitudes { altitude_m, hold_s } => {
                let due = (since_s / hold_s) as usize;
                if due >= altitude_m.len() {
                    self.guidance.path = None;
                    self.event(Severity::Info, EventKind::Setpoint, text(format_args!("path ended")));
                } else if due >= path.set {
                    path.set = due + 1;
                    if let Some(&to) = altitude_m.get(due) {
                        self.climb_to(to, now);
                    }
                }
                None
            }
            Trajectory::Shape { duration_s, .. } if *duration_s > 0.0 && since_s > *duration_s => {
                self.end_path();
                None
            }
            Trajectory::Shape { shape, .. } => {
                let at = moment(shape, &path.from_enu_m, since_s);
                // Yaw and throttle go on with the target; what is accelerated against the drag too.
                let (target, limits) = (self.target_now(), self.limits_now());
                let mut setpoint = *self.guidance.profile.step(&target, &limits, dt_s);
                let airframe = &self.config.airframe;
                let drag = at.velocity_enu_mps * (airframe.linear_drag_nspm / airframe.mass_kg);
                setpoint.position_enu_m = at.position_enu_m;
                setpoint.velocity_enu_mps = at.velocity_enu_mps;
                setpoint.acceleration_enu_mps2 = at.acceleration_enu_mps2 + drag;
                Some(setpoint)
            }
        }
    }
}
