//! Gains are solved and examined here, on a thread of its own: milliseconds that no tick may wait for.
//!
//! The flight thread hands a design over and later finds the answer; both queues are bounded and neither
//! side of them waits for the other. A push that finds the queue full is refused. Where a bound of the attack envelope is
//! demanded, it is found here too, after the gains themselves.

#![allow(clippy::result_large_err, reason = "bounded text on the stack: the flight thread does not allocate")]

use std::io;
use std::time::Duration;

use plumbline_proto::ids::{CommandId, GainsRevision};
use rtrb::{Consumer, Producer, PushError, RingBuffer};

use super::bounding::Bounding;
use super::worker::{Going, Worker};
use crate::control::gains::{Certified, Examiner, GainsError};
use crate::control::policy::MarginPolicy;
use crate::control::tuning::Proposal;
use crate::event::Text;
use crate::model::airframe::Airframe;

/// Pushes that may wait; one more is being worked on.
pub const WAITING: usize = 4;
/// How often the worker looks whether an answer fits, should the flight thread not fetch them.
const RETRY: Duration = Duration::from_millis(1);

/// A design to examine.
#[derive(Debug)]
struct Question {
    id: CommandId,
    revision: GainsRevision,
    proposal: Proposal,
}

/// What came of a push.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The command to acknowledge.
    pub id: CommandId,
    /// Number given by the ground.
    pub revision: GainsRevision,
    /// The gains, or why not.
    pub outcome: Result<Certified, GainsError>,
}

/// The attack envelope of gains: its bound, m, `None` where there is none; or why it is not known.
pub type Bounded = (GainsRevision, Result<Option<f64>, Text>);

/// The flight thread's end.
#[derive(Debug)]
pub struct Certifier {
    questions: Producer<Question>,
    answers: Consumer<Answer>,
    bounds: Consumer<Bounded>,
    worker: Worker,
}

impl Certifier {
    /// Starts the thread, for gains of `airframe` at ticks of `period_s` by `policy`; with `bounding`, of those in use and of
    /// every later one.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(
        airframe: &Airframe,
        period_s: f64,
        policy: MarginPolicy,
        bounding: Option<(Bounding, Certified)>,
    ) -> io::Result<Self> {
        let (questions, mut asked) = RingBuffer::<Question>::new(WAITING);
        let (mut answered, answers) = RingBuffer::new(WAITING);
        let (mut bounded, bounds) = RingBuffer::<Bounded>::new(WAITING);
        let airframe = airframe.clone();
        let work = move |going: Going| {
            let examiner = Examiner::new(&airframe, period_s, policy);
            let (bounding, in_use) = bounding.unzip();
            // One that finds the queue full is not missed: later gains have taken its place.
            let mut bound = |gains: &Certified| {
                let of = bounding.as_ref().map(|bounding: &Bounding| bounding.bound_m(&gains.law, || going.on()));
                let _ = of.map(|bound_m| bounded.push((gains.revision, bound_m)));
            };
            in_use.iter().for_each(&mut bound);
            while going.on() {
                let Ok(Question { id, revision, proposal }) = asked.pop() else {
                    going.sleep();
                    continue;
                };
                let outcome = examiner.as_ref().map_err(GainsError::clone).and_then(|examiner| {
                    let design = proposal.complete(&airframe)?;
                    examiner.certify(&design, revision)
                });
                let found = outcome.as_ref().ok().filter(|_| bounding.is_some()).cloned();
                let mut answer = Answer { id, revision, outcome };
                while let Err(PushError::Full(back)) = answered.push(answer) {
                    if !going.on() {
                        return;
                    }
                    answer = back;
                    std::thread::park_timeout(RETRY);
                }
                found.iter().for_each(&mut bound);
            }
        };
        let worker = Worker::start("certifier", work)?;
        Ok(Self { questions, answers, bounds, worker })
    }

    /// Hands a design over; the answer comes later under the same `id`. Does not wait.
    ///
    /// # Errors
    /// Why it is refused: too many are waiting.
    pub fn ask(&mut self, id: CommandId, revision: GainsRevision, proposal: &Proposal) -> Result<(), &'static str> {
        self.questions
            .push(Question { id, revision, proposal: proposal.clone() })
            .map_err(|_| "4 pushes of gains are waiting to be certified: try again")?;
        self.worker.wake();
        Ok(())
    }

    /// The next answer, if one is ready. Does not wait.
    pub fn answer(&mut self) -> Option<Answer> {
        self.answers.pop().ok()
    }

    /// The next bound, if one is ready. Does not wait.
    pub fn bounded(&mut self) -> Option<Bounded> {
        self.bounds.pop().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::lqr_integral::Weights;
    use crate::types::ControllerKind;
    use std::time::Instant;

    fn wait(certifier: &mut Certifier) -> Answer {
        let begun = Instant::now();
        loop {
            if let Some(answer) = certifier.answer() {
                return answer;
            }
            assert!(begun.elapsed() < Duration::from_secs(30), "no answer");
            std::thread::sleep(RETRY);
        }
    }

    #[test]
    fn answers_come_in_order_and_a_full_queue_refuses() {
        let airframe = Airframe::iris();
        let weights = Proposal::new(ControllerKind::LqrIntegral);
        let mut bad = Weights::for_airframe(&airframe);
        bad.state[2] = -1.0;
        let bad = Proposal::from_weights(bad);
        let mut certifier = Certifier::start(&airframe, 0.005, MarginPolicy::default(), None).unwrap();
        certifier.ask(CommandId(7), GainsRevision(1), &weights).unwrap();
        certifier.ask(CommandId(8), GainsRevision(2), &bad).unwrap();
        let first = wait(&mut certifier);
        assert_eq!((first.id, first.outcome.unwrap().revision), (CommandId(7), GainsRevision(1)));
        let second = wait(&mut certifier);
        assert!(second.outcome.unwrap_err().to_string().contains("state weight 2 (z) is -1"));
        // Far more than fit: some are refused, every other one is answered, and stopping does not hang.
        let taken = (0..100).filter(|n| certifier.ask(CommandId(*n), GainsRevision(3), &weights).is_ok()).count();
        assert!((WAITING..100).contains(&taken), "{taken} taken");
        assert!((0..taken).all(|_| wait(&mut certifier).outcome.is_ok()));
        let _ = certifier.ask(CommandId(1), GainsRevision(4), &weights);
    }
}
