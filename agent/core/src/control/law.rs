//! The controllers as one value: what a certification makes, a push carries and the loop flies.

use super::gains::Gain;
use super::hinf::Hinf;
use super::lqg::Lqg;
use super::lqr_integral::LqrIntegral;
use super::pid::Pid;
use super::{Controller, ControllerKind, Loops, Setpoint, Trim, Wrench};
use crate::estimate::Estimate;
use crate::model::state_space::StateSpace;

/// A control law with its state.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "copied into the loop between ticks; a box would be freed there")]
pub enum Law {
    /// LQR, with or without integrals.
    StateFeedback(LqrIntegral),
    /// LQR behind a Kalman filter.
    Lqg(Lqg),
    /// Mixed sensitivity.
    Hinf(Hinf),
    /// Cascaded PID.
    Pid(Pid),
}

impl Law {
    fn get(&self) -> &dyn Controller {
        match self {
            Self::StateFeedback(law) => law,
            Self::Lqg(law) => law,
            Self::Hinf(law) => law,
            Self::Pid(law) => law,
        }
    }

    fn get_mut(&mut self) -> &mut dyn Controller {
        match self {
            Self::StateFeedback(law) => law,
            Self::Lqg(law) => law,
            Self::Hinf(law) => law,
            Self::Pid(law) => law,
        }
    }

    /// The law for small errors, to be examined; `horizontal`: with x and y controlled.
    pub fn linear(&self, period_s: f64, horizontal: bool) -> StateSpace {
        match self {
            Self::StateFeedback(law) => law.linear(period_s, horizontal),
            Self::Lqg(law) => law.linear(horizontal),
            Self::Hinf(law) => law.linear(horizontal),
            Self::Pid(law) => law.linear(period_s, horizontal),
        }
    }

    /// K and K without the horizontal loop, where the law is one.
    pub fn gains(&self) -> Option<[&Gain; 2]> {
        match self {
            Self::StateFeedback(law) => Some(law.gains()),
            Self::Lqg(law) => Some(law.gains()),
            Self::Hinf(_) | Self::Pid(_) => None,
        }
    }

    /// Every number it multiplies with, in a fixed order: what the hash of the gains is taken over. For state
    /// feedback K, then K without the horizontal loop, each row-major.
    pub fn each_value(&self, mut take: impl FnMut(f64)) {
        match self {
            Self::StateFeedback(law) => {
                // The columns of the transpose are the rows.
                law.gains().iter().for_each(|k| k.transpose().iter().for_each(|v| take(*v)));
            }
            Self::Lqg(law) => law.each_value(take),
            Self::Hinf(law) => law.each_value(take),
            Self::Pid(law) => law.values().into_iter().for_each(take),
        }
    }
}

impl Controller for Law {
    fn kind(&self) -> ControllerKind {
        self.get().kind()
    }

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        self.get_mut().control(estimate, setpoint, loops, dt_s)
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        self.get_mut().applied(asked, given, support_n);
    }

    fn integrator(&self) -> [f64; 4] {
        self.get().integrator()
    }

    fn reset(&mut self) {
        self.get_mut().reset();
    }

    fn trim(&self) -> Trim {
        self.get().trim()
    }

    fn take_over(&mut self, trim: &Trim) {
        self.get_mut().take_over(trim);
    }
}
