//! A first flight in six steps, each done when the vehicle says so.

use plumbline_proto::v1::{AttackPhase, Mode};

use super::live::Live;

/// How far the setpoint is raised, m, less rounding; and how near the vehicle then is.
const RAISED_M: f64 = 0.095;
const NEAR_M: f64 = 0.05;

/// What is to be done, and how.
pub const STEPS: [(&str, &str); 6] = [
    ("Arm", "Hold Arm in the Mode card for 0.8 s. What refuses it stands there, with its reason."),
    ("Hold the altitude", "Press Altitude hold in the Mode card: the vehicle stays where its setpoint is."),
    ("Raise it", "Press ↑ for 0.1 m more. Rise time and overshoot stand on the curve once it has settled."),
    (
        "Attack a sensor",
        "Press A, choose a height and a bias, add it, schedule it: the sensor parts, the altitude should not.",
    ),
    ("Land", "Press L. On the ground the vehicle disarms by itself."),
    ("Read what happened", "Open the flight under Flights: its curves, its errors in mm, and its report."),
];

/// Numbers of steps that this module treats apart.
const ARM: usize = 0;
const LAND: usize = 4;

/// What of the vehicle and the page the steps go by.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[allow(missing_docs)]
pub struct Seen {
    /// Not known before its first status, as after a reload.
    pub armed: Option<bool>,
    pub holds: bool,
    pub setpoint_m: Option<f64>,
    pub altitude_m: Option<f64>,
    pub attacked: bool,
    /// A recorded flight is open.
    pub reads: bool,
}

impl Seen {
    /// As things are now.
    pub fn of(live: &Live, reads: bool) -> Self {
        let status = live.status.get();
        let active = |a: &plumbline_proto::v1::AttackState| a.attacks.iter().any(|p| p.phase() == AttackPhase::Active);
        Self {
            armed: status.map(|s| s.armed),
            holds: status.is_some_and(|s| matches!(s.mode(), Mode::AltitudeHold | Mode::Hold)),
            setpoint_m: live.setpoint_m(),
            altitude_m: live.estimate().and_then(|t| t.get()).and_then(|e| e.position_enu_m.as_ref()).map(|p| p.z),
            attacked: live.attacks.get().is_some_and(active),
            reads,
        }
    }
}

impl Seen {
    /// What a step counts from, m: the setpoint, or, before there is one, where the vehicle is. The first that is heard may be on its way to
    /// where somebody fast has sent it.
    fn begins_m(&self) -> Option<f64> {
        let known = |m: &f64| m.is_finite();
        self.setpoint_m.filter(known).or(self.altitude_m.filter(known))
    }
}

/// How far somebody has come.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Guide {
    /// The step that is to be done; past the last one when all are.
    pub at: usize,
    /// Setpoint when the present step began, m.
    from_m: Option<f64>,
}

impl Guide {
    /// At step `at`, as a browser kept it.
    pub fn at(at: usize) -> Self {
        Self { at: at.min(STEPS.len()), from_m: None }
    }

    /// Goes on where the present step is done; back to the first where the vehicle disarmed too soon.
    pub fn go_on(&mut self, seen: &Seen) {
        self.from_m = self.from_m.or(seen.begins_m());
        let raised = || {
            let (from_m, setpoint_m, altitude_m) = (self.from_m?, seen.setpoint_m?, seen.altitude_m?);
            Some(setpoint_m - from_m >= RAISED_M && (altitude_m - setpoint_m).abs() <= NEAR_M)
        };
        let done = match self.at {
            ARM => seen.armed == Some(true),
            1 => seen.holds,
            2 => raised().unwrap_or(false),
            3 => seen.attacked,
            LAND => seen.armed == Some(false),
            5 => seen.reads,
            _ => false,
        };
        if done {
            *self = Self { at: self.at + 1, from_m: seen.begins_m() };
        } else if (ARM + 1..LAND).contains(&self.at) && seen.armed == Some(false) {
            *self = Self::at(ARM);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLYING: Seen = Seen {
        armed: Some(true),
        holds: true,
        setpoint_m: Some(0.5),
        altitude_m: Some(0.5),
        attacked: false,
        reads: false,
    };

    const DISARMED: Seen =
        Seen { armed: Some(false), holds: false, setpoint_m: None, altitude_m: None, attacked: false, reads: false };

    #[test]
    fn each_step_is_done_when_the_vehicle_says_so() {
        let mut guide = Guide::default();
        let mut after = |seen: Seen| {
            guide.go_on(&seen);
            guide.at
        };
        assert_eq!(after(DISARMED), 0);
        assert_eq!(after(Seen { armed: Some(true), ..DISARMED }), 1);
        assert_eq!(after(Seen { armed: Some(true), ..DISARMED }), 1);
        assert_eq!(after(FLYING), 2);
        // It waits for the vehicle, not for the setpoint.
        assert_eq!(after(Seen { setpoint_m: Some(0.6), ..FLYING }), 2);
        assert_eq!(after(Seen { setpoint_m: Some(0.6), altitude_m: Some(0.57), ..FLYING }), 3);
        assert_eq!(after(Seen { attacked: true, ..FLYING }), 4);
        assert_eq!(after(FLYING), 4);
        assert_eq!(after(DISARMED), 5);
        assert_eq!(after(Seen { reads: true, ..DISARMED }), 6);
        assert_eq!(after(FLYING), 6);
    }

    #[test]
    fn whoever_raises_it_before_a_setpoint_was_heard_has_raised_it() {
        for unheard in [None, Some(f64::NAN)] {
            let mut guide = Guide::at(1);
            guide.go_on(&Seen { setpoint_m: unheard, altitude_m: Some(0.3), ..FLYING });
            assert_eq!(guide.at, 2);
            guide.go_on(&Seen { setpoint_m: Some(0.48), altitude_m: Some(0.31), ..FLYING });
            guide.go_on(&Seen { setpoint_m: Some(0.5), altitude_m: Some(0.49), ..FLYING });
            assert_eq!(guide.at, 3, "{unheard:?}");
        }
    }

    #[test]
    fn a_vehicle_that_disarms_too_soon_begins_again_and_one_that_was_not_heard_yet_does_not() {
        let mut guide = Guide::at(3);
        // A reload: whatever is shown before its first status.
        guide.go_on(&Seen::default());
        assert_eq!(guide.at, 3);
        guide.go_on(&DISARMED);
        assert_eq!(guide.at, 0);
        assert_eq!(Guide::at(77).at, STEPS.len());
    }
}
