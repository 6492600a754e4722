//! The controller in the loop, replaced without a bump.
//!
//! The new law takes over what the old one had learned to give; what still differs between the wrench of
//! the last tick and its own dies away with [`BLEND_TIME_CONSTANT_S`].

use super::law::Law;
use super::{Controller, ControllerKind, Loops, Setpoint, Wrench};
use crate::estimate::Estimate;

/// Time constant with which the difference between old and new dies away, s.
pub const BLEND_TIME_CONSTANT_S: f64 = 0.3;

/// The law in use.
#[derive(Debug, Clone)]
pub struct InLoop {
    law: Law,
    /// Asked for at the last tick.
    last: Option<Wrench>,
    replaced: bool,
    blend: Wrench,
}

impl InLoop {
    /// With `law`.
    pub fn new(law: Law) -> Self {
        Self { law, last: None, replaced: false, blend: Wrench::default() }
    }

    /// Which controller flies.
    pub fn kind(&self) -> ControllerKind {
        self.law.kind()
    }

    /// Uses `law` from the next tick on.
    pub fn replace(&mut self, law: &Law) {
        let trim = self.law.trim();
        self.law.clone_from(law);
        self.law.take_over(&trim);
        self.replaced = self.last.is_some();
    }

    /// The wrench for this tick. Never allocates.
    pub fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        let own = self.law.control(estimate, setpoint, loops, dt_s);
        if let (true, Some(last)) = (self.replaced, self.last) {
            self.replaced = false;
            self.blend = Wrench {
                thrust_n: last.thrust_n - own.thrust_n,
                torque_flu_nm: last.torque_flu_nm - own.torque_flu_nm,
            };
        } else {
            let kept = (-dt_s / BLEND_TIME_CONSTANT_S).exp();
            self.blend.thrust_n *= kept;
            self.blend.torque_flu_nm *= kept;
        }
        let wrench = Wrench {
            thrust_n: (own.thrust_n + self.blend.thrust_n).max(0.0),
            torque_flu_nm: own.torque_flu_nm + self.blend.torque_flu_nm,
        };
        self.last = Some(wrench);
        wrench
    }

    /// Told what the mixer could really give, and what else holds the vehicle up above its setpoint.
    pub fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        self.law.applied(asked, given, support_n);
    }

    /// Integrators of x, y, z, yaw, in the law's own units.
    pub fn integrator(&self) -> [f64; 4] {
        self.law.integrator()
    }

    /// Forgets everything learned: the motors do not turn.
    pub fn reset(&mut self) {
        self.law.reset();
        (self.last, self.replaced, self.blend) = (None, false, Wrench::default());
    }
}
