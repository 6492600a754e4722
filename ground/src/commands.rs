//! Commands: numbered, sent, and waited for until the agent's acknowledgement comes back by the
//! DOWN lane.

use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plumbline_proto::v1::{self, command::Body};
use tokio::sync::oneshot;

use crate::agent_link::CommandSender;
use crate::sync::lock;

/// Most commands waiting for acknowledgements, all vehicles together; more are refused. Motor cuts are not among them.
pub const MAX_WAITING: usize = 256;
/// Most of them of one operator, so that one who floods the ground takes nobody else's place: what the vehicle takes in
/// two ticks, so that a cut behind them is late by no more.
pub const MAX_WAITING_EACH: usize = 32;
/// Most motor cuts waiting for acknowledgements: places that nothing else can take.
pub const MAX_CUTS_WAITING: usize = 256;
/// Most of them of one operator. A further one is refused while so many are on their way already.
pub const MAX_CUTS_WAITING_EACH: usize = 32;

/// Why a command has no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// The link is down.
    #[error("the vehicle is not connected")]
    Disconnected,
    /// The agent did not answer in time. It may still have carried the command out.
    #[error("command {command_id} was not answered within {seconds} s; the vehicle may have carried it out")]
    TimedOut {
        /// The command.
        command_id: u64,
        /// How long it was waited for, s.
        seconds: u64,
    },
    /// Too many commands are waiting.
    #[error("{waiting} commands are waiting for answers, limit {limit}")]
    Flooded {
        /// How many.
        waiting: usize,
        /// Of the operator's or of all.
        limit: usize,
    },
}

/// One command, and on whose word.
#[derive(Debug)]
pub struct Asked<'a> {
    /// Who asks.
    pub operator: &'a str,
    /// Flight time of the newest message their page showed, µs, where a page asks.
    pub seen_us: Option<u64>,
    /// What.
    pub body: Body,
}

/// Numbers commands and matches acknowledgements.
#[derive(Debug, Default)]
pub struct Commands {
    last_id: AtomicU64,
    waiting: Mutex<HashMap<(String, u64), Waiter>>,
}

#[derive(Debug)]
struct Waiter {
    operator: String,
    cut: bool,
    answer: oneshot::Sender<v1::Ack>,
}

impl Commands {
    /// Sends what is asked to `vehicle` and waits for its acknowledgement.
    ///
    /// # Errors
    /// [`CommandError`]. A rejection is not an error: it is an [`v1::Ack`].
    pub async fn send(
        &self,
        vehicle: &str,
        to: &CommandSender,
        asked: Asked<'_>,
        timeout: Duration,
    ) -> Result<v1::Ack, CommandError> {
        let Asked { operator, seen_us, body } = asked;
        let command_id = self.last_id.fetch_add(1, Ordering::Relaxed) + 1;
        let key = (vehicle.to_owned(), command_id);
        let answer = {
            let mut waiting = lock(&self.waiting);
            let cut = matches!(body, Body::CutMotors(_));
            room(&waiting, operator, cut)?;
            let (sender, answer) = oneshot::channel();
            waiting.insert(key.clone(), Waiter { operator: operator.to_owned(), cut, answer: sender });
            answer
        };
        // Also when this future is dropped (the client hung up), the entry goes.
        let _entry = Entry { commands: self, key };
        tracing::info!(vehicle, operator, command_id, command = name(&body), "command");
        let command = v1::Command { command_id, operator: operator.to_owned(), seen_us, body: Some(body) };
        let exchange = async {
            to.send(command).await.map_err(|_| CommandError::Disconnected)?;
            answer.await.map_err(|_| CommandError::Disconnected)
        };
        match tokio::time::timeout(timeout, exchange).await {
            Ok(answered) => answered,
            Err(_) if to.is_closed() => Err(CommandError::Disconnected),
            Err(_) => Err(CommandError::TimedOut { command_id, seconds: timeout.as_secs() }),
        }
    }

    /// Commands that wait for acknowledgements, cuts included.
    pub fn waiting(&self) -> usize {
        lock(&self.waiting).len()
    }

    /// Hands an acknowledgement to whoever waits for it.
    pub fn resolve(&self, vehicle: &str, ack: v1::Ack) {
        if let Some(waiter) = lock(&self.waiting).remove(&(vehicle.to_owned(), ack.command_id)) {
            // The waiter may have given up in this moment; the acknowledgement is recorded anyway.
            let _ = waiter.answer.send(ack);
        }
    }
}

/// Is there a place for one more of this operator?
fn room(waiting: &HashMap<(String, u64), Waiter>, operator: &str, cut: bool) -> Result<(), CommandError> {
    let [total, each] = if cut { [MAX_CUTS_WAITING, MAX_CUTS_WAITING_EACH] } else { [MAX_WAITING, MAX_WAITING_EACH] };
    let alike = || waiting.values().filter(|waiter| waiter.cut == cut);
    for (waiting, limit) in [(alike().count(), total), (alike().filter(|w| w.operator == operator).count(), each)] {
        if waiting >= limit {
            return Err(CommandError::Flooded { waiting, limit });
        }
    }
    Ok(())
}

struct Entry<'a> {
    commands: &'a Commands,
    key: (String, u64),
}

impl Drop for Entry<'_> {
    fn drop(&mut self) {
        lock(&self.commands.waiting).remove(&self.key);
    }
}

/// Name of a command, for the log.
fn name(body: &Body) -> &'static str {
    match body {
        Body::Arm(_) => "arm",
        Body::Disarm(_) => "disarm",
        Body::CutMotors(_) => "cut",
        Body::ReleaseCut(_) => "release-cut",
        Body::SetMode(_) => "mode",
        Body::Setpoint(_) => "setpoint",
        Body::AttackSchedule(_) => "attacks",
        Body::AbortAttacks(_) => "abort-attacks",
        Body::SelectEstimator(_) => "estimator",
        Body::SelectDecoder(_) => "decoder",
        Body::SetRecording(_) => "recording",
        Body::PushGains(_) => "gains",
        Body::SetReplay(_) => "replay",
        Body::SetTrajectory(_) => "trajectory",
        Body::SetSimulator(_) => "simulator",
        Body::UseCalibration(_) => "use-calibration",
        Body::DropCalibration(_) => "drop-calibration",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent_link::Outgoing;
    use std::pin::Pin;
    use std::task::{Context, Waker};

    fn asked(operator: &str, body: Body) -> Asked<'_> {
        Asked { operator, seen_us: None, body }
    }

    /// Polls once: does it wait?
    fn waits(exchange: &mut Pin<Box<impl Future>>) -> bool {
        exchange.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending()
    }

    #[tokio::test]
    async fn acks_find_their_command_and_only_that() {
        let commands = Commands::default();
        let (sender, mut outgoing) = CommandSender::channel();
        let exchange = commands.send("a", &sender, asked("me", Body::Arm(v1::Arm {})), Duration::from_secs(5));
        let agent = async {
            let Some(Outgoing::Command(command)) = outgoing.recv().await else { panic!("no command") };
            let ack = |id| v1::Ack { command_id: id, stage: v1::AckStage::Accepted as i32, ..Default::default() };
            commands.resolve("b", ack(command.command_id));
            commands.resolve("a", ack(command.command_id + 1));
            assert_eq!(lock(&commands.waiting).len(), 1, "foreign acknowledgements change nothing");
            commands.resolve("a", ack(command.command_id));
        };
        let (ack, ()) = tokio::join!(exchange, agent);
        assert_eq!(ack.unwrap().command_id, 1);
        assert!(lock(&commands.waiting).is_empty());
    }

    #[tokio::test]
    async fn a_flood_of_commands_takes_no_place_of_a_cut_or_of_another_operator() {
        let commands = Commands::default();
        let (sender, mut outgoing) = CommandSender::channel();
        let wait = Duration::from_secs(60);
        let send = |operator, body| commands.send("a", &sender, asked(operator, body), wait);
        // GIVEN one operator with as many commands on their way as it may have
        let mut flood: Vec<_> =
            (0..MAX_WAITING_EACH).map(|_| Box::pin(send("ann", Body::Disarm(v1::Disarm {})))).collect();
        assert!(flood.iter_mut().all(waits));
        let refused = send("ann", Body::Disarm(v1::Disarm {})).await;
        assert_eq!(refused, Err(CommandError::Flooded { waiting: MAX_WAITING_EACH, limit: MAX_WAITING_EACH }));
        // WHEN the same operator cuts and another one commands THEN both are on their way, the cut first
        let (mut other, mut cut) =
            (Box::pin(send("bob", Body::Arm(v1::Arm {}))), Box::pin(send("ann", Body::CutMotors(v1::CutMotors {}))));
        assert!(waits(&mut other) && waits(&mut cut));
        let Some(Outgoing::Command(first)) = outgoing.recv().await else { panic!("no command") };
        assert_eq!(first.body, Some(Body::CutMotors(v1::CutMotors {})));
    }

    #[tokio::test]
    async fn silence_and_a_lost_link_are_told_apart() {
        let commands = Commands::default();
        let (sender, outgoing) = CommandSender::channel();
        let wait = Duration::from_millis(20);
        let silence = commands.send("a", &sender, asked("me", Body::Arm(v1::Arm {})), wait).await;
        assert!(matches!(silence, Err(CommandError::TimedOut { command_id: 1, .. })));
        drop(outgoing);
        let lost = commands.send("a", &sender, asked("me", Body::Arm(v1::Arm {})), wait).await;
        assert_eq!(lost, Err(CommandError::Disconnected));
        assert!(lock(&commands.waiting).is_empty());
    }
}
