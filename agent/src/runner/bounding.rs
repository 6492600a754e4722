//! The attack envelope of gains, bounded on the certifier's thread: arming may demand it, see [`EnvelopeDemand`].

#![allow(clippy::result_large_err, reason = "bounded text on the stack: the flight thread does not allocate")]

use crate::attack::Bounds;
use crate::control::law::Law;
use crate::envelope::EnvelopeError;
use crate::envelope::flying::Loop;
use crate::envelope::sets::{USUAL_HORIZON_S, largest_m};
use crate::event::{Text, text};
use crate::flight::{EnvelopeDemand, FlightConfig};
use crate::model::airframe::Airframe;
use crate::sensor::suite::Suite;

/// What the bound depends on beside the gains.
#[derive(Debug, Clone)]
pub struct Bounding {
    suite: Suite,
    airframe: Airframe,
    tick_rate_hz: f64,
    demand: EnvelopeDemand,
    most: (f64, f64),
}

impl Bounding {
    /// Of a vehicle with the sensors of `suite`; `None` where `config` demands no bound. The attacks bounded are those that
    /// this agent's own injector could do at the usual bounds, whether it may or not.
    pub fn new(config: &FlightConfig, suite: &Suite) -> Option<Self> {
        let bounds = Bounds::default();
        config.envelope.map(|demand| Self {
            suite: suite.clone(),
            airframe: config.airframe.clone(),
            tick_rate_hz: config.tick_rate_hz,
            demand,
            most: (bounds.length_max_m, bounds.accel_max_mps2),
        })
    }

    /// Largest bound of any set of as many sensors as the demand names, m; `None` where there is none. Given up once `go_on`
    /// says no.
    pub(super) fn bound_m(&self, law: &Law, go_on: impl Fn() -> bool) -> Result<Option<f64>, Text> {
        let bounded = || -> Result<Option<f64>, EnvelopeError> {
            let EnvelopeDemand { shaken, .. } = self.demand;
            let flying = Loop::new(&self.suite, &self.airframe, law, self.tick_rate_hz, shaken, self.most)?;
            largest_m(&flying, self.demand.sensors, USUAL_HORIZON_S, go_on)
        };
        bounded().map_err(|error| text(format_args!("no bound: {error}")))
    }
}
