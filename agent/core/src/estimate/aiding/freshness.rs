//! When a quantity was last corrected, and since when its samples have been rejected without a break.
//!
//! What is rejected for longer than a recovery time is no outlier: the filter starts again where the sensor says.

use plumbline_proto::time::FlightTime;

/// What is rejected for this long is the new truth, s.
pub const RECOVERY_S: f64 = 2.0;

/// See the module.
#[derive(Debug, Clone, Copy, Default)]
pub struct Freshness {
    accepted: Option<FlightTime>,
    rejected: Option<FlightTime>,
}

impl Freshness {
    /// A sample was `accepted`, or rejected.
    pub fn note(&mut self, now: FlightTime, accepted: bool) {
        if accepted {
            *self = Self { accepted: Some(now), rejected: None };
        } else {
            self.rejected.get_or_insert(now);
        }
    }

    /// Was a sample ever accepted?
    pub fn ever(&self) -> bool {
        self.accepted.is_some()
    }

    /// Was one accepted in the last `seconds`?
    pub fn within(&self, now: FlightTime, seconds: f64) -> bool {
        self.accepted.is_some_and(|t| now.seconds_since(t) <= seconds)
    }

    /// Was one accepted once, and none in the last `seconds`?
    pub fn lapsed(&self, now: FlightTime, seconds: f64) -> bool {
        self.ever() && !self.within(now, seconds)
    }

    /// For how long samples have been rejected, s; zero when the last one was accepted.
    pub fn rejected_s(&self, now: FlightTime) -> f64 {
        self.rejected.map_or(0.0, |t| now.seconds_since(t))
    }

    /// Was none accepted ever, or have they been rejected for longer than `recovery_s`?
    pub fn lost(&self, now: FlightTime, recovery_s: f64) -> bool {
        !self.ever() || self.rejected_s(now) > recovery_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outlier_is_forgiven_and_a_lasting_rejection_is_lost() {
        let at = |s: f64| FlightTime((s * 1e6) as u64);
        let mut height = Freshness::default();
        assert!(height.lost(at(0.0), 2.0) && !height.lapsed(at(9.0), 3.0));
        height.note(at(1.0), true);
        height.note(at(1.5), false);
        assert!(!height.lost(at(2.0), 2.0) && height.within(at(2.0), 1.0) && height.rejected_s(at(2.0)) == 0.5);
        height.note(at(2.0), false);
        assert!(height.lost(at(3.6), 2.0) && height.lapsed(at(4.1), 3.0), "rejected since 1.5 s");
        height.note(at(4.2), true);
        assert!(!height.lost(at(60.0), 2.0) && height.rejected_s(at(60.0)) == 0.0);
    }
}
