//! The flying decoder's answer, solved again by Clarabel once a second on a thread of its own.
//!
//! Cases travel in memory that is made once and comes back with the answer: the flight thread copies a window,
//! never waits and never allocates. While no case is free, that second is not audited.

use std::io;

use plumbline_proto::time::FlightTime;
use rtrb::{Consumer, Producer, RingBuffer};

use super::worker::{Going, Worker};
use crate::estimate::secure::conic::Conic;
use crate::estimate::secure::{AuditCase, Secure};
use crate::telemetry::Audit;

/// Cases under way.
const CASES: usize = 2;
/// Time between audits, s.
const PERIOD_S: f64 = 1.0;

/// The flight thread's end.
#[derive(Debug)]
pub struct Auditor {
    cases: Producer<AuditCase>,
    answers: Consumer<(AuditCase, Option<Audit>)>,
    /// Never more than were made: no memory is asked for.
    free: Vec<AuditCase>,
    asked: Option<FlightTime>,
    last: Option<Audit>,
    worker: Worker,
}

impl Auditor {
    /// Starts the thread.
    ///
    /// # Errors
    /// When no thread can be started, or there is no memory for a case.
    pub fn start() -> io::Result<Self> {
        let mut free = Vec::with_capacity(CASES);
        for _ in 0..CASES {
            free.push(AuditCase::with_room().map_err(io::Error::other)?);
        }
        let (cases, mut asked) = RingBuffer::<AuditCase>::new(CASES);
        let (mut answered, answers) = RingBuffer::new(CASES);
        let work = move |going: Going| {
            while going.on() {
                let Ok(case) = asked.pop() else {
                    going.sleep();
                    continue;
                };
                let audit = solve(&case);
                // There is room: no more cases exist than fit.
                let _ = answered.push((case, audit));
            }
        };
        let worker = Worker::start("auditor", work)?;
        Ok(Self { cases, answers, free, asked: None, last: None, worker })
    }

    /// Takes back what is answered and, once a second, hands over the last window. Does not wait.
    pub fn tick(&mut self, now: FlightTime, secure: &Secure) -> Option<Audit> {
        while let Ok((case, audit)) = self.answers.pop() {
            self.free.push(case);
            self.last = audit.or(self.last);
        }
        let due = self.asked.is_none_or(|asked| now < asked || now.seconds_since(asked) >= PERIOD_S);
        if due && let Some(mut case) = self.free.pop() {
            if secure.audit(&mut case) {
                self.asked = Some(now);
                if let Err(rtrb::PushError::Full(case)) = self.cases.push(case) {
                    self.free.push(case);
                } else {
                    self.worker.wake();
                }
            } else {
                self.free.push(case);
            }
        }
        self.last
    }
}

fn solve(case: &AuditCase) -> Option<Audit> {
    let mut conic = Conic::new(&case.problem).inspect_err(|error| tracing::warn!(%error, "audit")).ok()?;
    let decoded =
        conic.decode(&case.problem, &case.samples).inspect_err(|error| tracing::warn!(%error, "audit")).ok()?;
    let difference = (case.objective - decoded.objective).abs() / decoded.objective.abs().max(f64::MIN_POSITIVE);
    Some(Audit { time: case.time, difference })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Flight;
    use crate::sim::{Scenario, SimVehicle};
    use crate::types::EstimatorKind;
    use crate::vehicle::Vehicle;
    use std::time::{Duration, Instant};

    /// Newton stops at a gap of 1e-6, Clarabel is tighter.
    const DIFFERENCE_MAX: f64 = 2e-6;

    #[test]
    fn clarabel_agrees_with_what_flew() {
        let scenario = Scenario::bare();
        let mut vehicle = SimVehicle::new(&scenario).unwrap();
        let mut config = scenario.flight_config();
        config.estimators.push(EstimatorKind::Secure);
        let mut flight = Flight::new(config).unwrap();
        let mut auditor = Auditor::start().unwrap();
        let begun = Instant::now();
        loop {
            let frame = vehicle.sense().unwrap();
            flight.step(&frame);
            if let Some(audit) = auditor.tick(frame.time, flight.secure().unwrap()) {
                assert!(audit.difference < DIFFERENCE_MAX, "{audit:?}");
                break;
            }
            assert!(begun.elapsed() < Duration::from_secs(30), "no audit");
        }
    }
}
