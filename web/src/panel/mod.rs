//! Page controls: one file per card. They read through [`crate::ctx::Ctx`] and send commands; none draws curves.

pub mod alarms;
pub mod arming;
pub mod attacks;
pub mod charts;
pub mod cursors;
pub mod errors;
pub mod estimator;
pub mod events;
pub mod hold;
pub mod horizon;
pub mod lanes;
pub mod legend;
pub mod motors;
pub mod notices;
pub mod paths;
pub mod plot;
pub mod readouts;
pub mod replay;
pub mod residuals;
pub mod secure;
pub mod setpoint;
pub mod simulator;
pub mod sketch;
pub mod steps;
pub mod timebar;
pub mod toolbar;
