//! What happens in a scripted flight, and when: commands, trajectories, pushes.
//!
//! A script speaks the agent's own [`Command`]s, so a scripted flight takes the same way as one flown from
//! the page. Interactive runs ignore it.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use super::world::Push;
use plumbline_core::command::{Command, SetpointChange};
pub use plumbline_core::control::trajectory::Shape;

/// A trajectory gives a setpoint this often, s: what a ground station would send.
const TRAJECTORY_PERIOD_S: f64 = 0.05;
/// A hand takes this long to bring the vehicle to its angle, s, or half of the push.
const HAND_S: f64 = 0.25;

/// A shape flown for a while; it sets position and altitude twenty times a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trajectory {
    /// When, s.
    pub start_s: f64,
    /// How long, s.
    pub duration_s: f64,
    /// From where, ENU, m.
    pub from_enu_m: Vector3<f64>,
    /// The path.
    pub shape: Shape,
}

impl Trajectory {
    /// The setpoint at `t_s` since boot, while it is flown.
    pub fn setpoint(&self, t_s: f64) -> Option<SetpointChange> {
        let since = t_s - self.start_s;
        (since >= 0.0 && since <= self.duration_s).then(|| {
            let p = self.from_enu_m + self.shape.displacement_m(since);
            SetpointChange { x_m: Some(p.x), y_m: Some(p.y), altitude_m: Some(p.z), ..SetpointChange::default() }
        })
    }
}

/// One command at its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// When, s.
    pub at_s: f64,
    /// What.
    pub command: Command,
}

/// A hand on the vehicle for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PushEvent {
    /// When, s.
    pub at_s: f64,
    /// How long, s.
    pub duration_s: f64,
    /// What it does.
    pub push: Push,
}

impl PushEvent {
    fn covers(&self, t_s: f64) -> bool {
        t_s >= self.at_s && t_s < self.at_s + self.duration_s
    }
}

/// Everything that happens by itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Script {
    /// Commands in the order of their times.
    pub steps: Vec<Step>,
    /// Trajectories.
    pub trajectories: Vec<Trajectory>,
    /// Pushes.
    pub pushes: Vec<PushEvent>,
}

impl Script {
    /// Calls `give` with every command due after `before` (from the start when `None`) and up to `now`.
    /// A trajectory gives one setpoint when a twentieth of a second has begun since `before`.
    pub fn commands(&self, before: Option<FlightTime>, now: FlightTime, mut give: impl FnMut(&Command)) {
        let due = |at_s: f64| {
            let at = FlightTime::from_seconds(at_s);
            at <= now && before.is_none_or(|before| at > before)
        };
        for step in self.steps.iter().filter(|s| due(s.at_s)) {
            give(&step.command);
        }
        let slot = |t: FlightTime| (t.as_seconds() / TRAJECTORY_PERIOD_S + 1e-6).floor();
        if before.is_some_and(|before| slot(before) == slot(now)) {
            return;
        }
        for setpoint in self.trajectories.iter().filter_map(|t| t.setpoint(now.as_seconds())) {
            give(&Command::Setpoint(setpoint));
        }
    }

    /// All pushes that act at `t_s` since boot, summed; of two held angles the later wins. A hand moves
    /// to its angle smoothly (a minimum-jerk path from level).
    pub fn push(&self, t_s: f64) -> Push {
        let mut total = Push::default();
        for event in self.pushes.iter().filter(|event| event.covers(t_s)) {
            total.force_enu_n += event.push.force_enu_n;
            total.torque_flu_nm += event.push.torque_flu_nm;
            if let Some((axis, angle)) = event.push.deflect {
                let s = ((t_s - event.at_s) / HAND_S.min(0.5 * event.duration_s)).clamp(0.0, 1.0);
                let share = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
                total.deflect = Some((axis, share * angle));
            }
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_command_is_given_exactly_once() {
        let script = Script {
            steps: [0.0, 0.5, 0.505, 1.0].map(|at_s| Step { at_s, command: Command::Arm }).to_vec(),
            ..Script::default()
        };
        let mut given = 0;
        let mut before = None;
        for tick in 0..400 {
            let now = FlightTime(tick * 5000);
            script.commands(before, now, |_| given += 1);
            before = Some(now);
        }
        assert_eq!(given, 4);
    }

    #[test]
    fn a_trajectory_gives_twenty_setpoints_a_second() {
        let shape = Shape::Heave { amplitude_m: 0.2, period_s: 2.0 };
        let path = Trajectory { start_s: 1.0, duration_s: 2.0, from_enu_m: Vector3::z(), shape };
        let script = Script { trajectories: vec![path], ..Script::default() };
        let (mut given, mut before) = (0, None);
        for tick in 0..1000 {
            let now = FlightTime(tick * 5000);
            script.commands(before, now, |_| given += 1);
            before = Some(now);
        }
        assert_eq!(given, 41);
    }

    #[test]
    fn a_hand_moves_smoothly_to_its_angle() {
        let push = Push { deflect: Some((Vector3::x(), 0.4)), ..Push::default() };
        let script = Script { pushes: vec![PushEvent { at_s: 1.0, duration_s: 1.0, push }], ..Script::default() };
        let angle = |t| script.push(t).deflect.map(|d| d.1);
        assert_eq!([0.9, 1.0, 1.125, 1.5, 2.5].map(angle), [None, Some(0.0), Some(0.2), Some(0.4), None]);
    }

    #[test]
    fn pushes_add_up_while_they_last() {
        let push = Push { torque_flu_nm: Vector3::x(), ..Push::default() };
        let event = |at_s| PushEvent { at_s, duration_s: 1.0, push };
        let script = Script { pushes: vec![event(1.0), event(1.5)], ..Script::default() };
        let x = |t| script.push(t).torque_flu_nm.x;
        assert_eq!([0.9, 1.0, 1.6, 2.2, 2.5].map(x), [0.0, 1.0, 2.0, 1.0, 0.0]);
    }
}
