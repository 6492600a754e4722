//! Agent sessions: datagrams in, commands out, gaps asked for.
//!
//! This file holds what the rest of the ground knows of the link: [`LinkEvent`] going up and
//! [`CommandSender`] going down. The link itself is the only producer of the one and the only
//! consumer of the other, so that tests stand in for an agent with two channels and no socket.

pub mod clock;
pub(crate) mod offset;
mod registry;
mod server;
mod session;

pub use server::{AgentLink, AgentLinkConfig, AgentLinkError, run};

use std::time::Instant;

use plumbline_proto::codec::Batch;
use plumbline_proto::v1;
use tokio::sync::mpsc;

/// Most commands waiting for the link. A full queue makes the sender wait: a command is never
/// dropped silently.
pub const COMMAND_QUEUE: usize = 64;
/// Most motor cuts and signs of life waiting for the link, beside the other commands and before them. Signs of life
/// take at most half of the places; a cut waits for one.
pub const URGENT_QUEUE: usize = 16;

/// What the link tells the ground. Within one agent the order is the order of arrival.
#[derive(Debug)]
pub enum LinkEvent {
    /// An agent said hello, or came back. A new `boot_id` starts a new sequence count.
    Connected {
        /// Name of the agent, unique among the agents of this ground.
        agent_id: String,
        /// Changes with every start of the agent.
        boot_id: u64,
        /// Wall time (Unix) at the agent's flight time zero, µs, by the agent's clock.
        boot_wall_time_us: u64,
        /// Version of the agent.
        version: String,
        /// Way down to the agent, valid until its `Disconnected`.
        commands: CommandSender,
    },
    /// Messages of the agent.
    Batch {
        /// Which agent.
        agent_id: String,
        /// As the agent encoded them.
        batch: Batch,
        /// When it was received.
        received: Instant,
        /// An answer to a backfill: belongs into the file, not into the live view.
        backfill: bool,
    },
    /// The agent's onboard log does not hold this range (any more).
    BackfillUnavailable {
        /// Which agent.
        agent_id: String,
        /// The range, as it was asked for.
        request: v1::BackfillRequest,
    },
    /// Measured state of the link, about 4 Hz.
    Stats {
        /// Which agent.
        agent_id: String,
        /// Round trip, ms.
        round_trip_ms: f64,
        /// Ground wall clock minus the agent's wall clock (boot wall time + flight time), µs.
        clock_offset_us: f64,
    },
    /// The link is lost.
    Disconnected {
        /// Which agent.
        agent_id: String,
        /// Why, for people.
        reason: String,
    },
}

/// One thing to send down.
#[derive(Debug, Clone, PartialEq)]
pub enum Outgoing {
    /// A numbered command.
    Command(v1::Command),
    /// "Send me these messages again."
    Backfill(v1::BackfillRequest),
    /// "The operator's page answered this challenge."
    OperatorAlive(u64),
    /// "This flight is whole here."
    FlightKept(String),
}

/// The link to this agent is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the link to the vehicle is closed")]
pub struct LinkClosed;

/// Way down to one agent: cheap to clone, waits while [`COMMAND_QUEUE`] commands are unsent. The motor cut and the
/// operator's sign of life have a queue of their own, which goes first.
#[derive(Debug, Clone)]
pub struct CommandSender {
    queue: mpsc::Sender<Outgoing>,
    urgent: mpsc::Sender<Outgoing>,
}

/// The other end of a [`CommandSender`].
#[derive(Debug)]
pub struct CommandReceiver {
    queue: mpsc::Receiver<Outgoing>,
    urgent: mpsc::Receiver<Outgoing>,
}

impl CommandReceiver {
    /// The next thing to send, what is urgent first; `None` when no sender is left. Cancel-safe.
    pub async fn recv(&mut self) -> Option<Outgoing> {
        // Both ends of a sender close together: either lane stands for both.
        tokio::select! {
            biased;
            Some(urgent) = self.urgent.recv() => Some(urgent),
            next = self.queue.recv() => next,
        }
    }

    /// The next thing that is already here.
    ///
    /// # Errors
    /// There is none.
    pub fn try_recv(&mut self) -> Result<Outgoing, mpsc::error::TryRecvError> {
        self.urgent.try_recv().or_else(|_| self.queue.try_recv())
    }

    /// Takes nothing more.
    pub fn close(&mut self) {
        self.urgent.close();
        self.queue.close();
    }
}

impl CommandSender {
    /// A sender, and the end the link (or a test's agent) reads from.
    pub fn channel() -> (Self, CommandReceiver) {
        let (queue, ordinary_end) = mpsc::channel(COMMAND_QUEUE);
        let (urgent, urgent_end) = mpsc::channel(URGENT_QUEUE);
        (Self { queue, urgent }, CommandReceiver { queue: ordinary_end, urgent: urgent_end })
    }

    /// Hands a command to the link; a motor cut before all others.
    ///
    /// # Errors
    /// [`LinkClosed`] when the agent is gone.
    pub async fn send(&self, command: v1::Command) -> Result<(), LinkClosed> {
        let cut = matches!(command.body, Some(v1::command::Body::CutMotors(_)));
        let lane = if cut { &self.urgent } else { &self.queue };
        lane.send(Outgoing::Command(command)).await.map_err(|_| LinkClosed)
    }

    /// Hands a backfill request to the link.
    ///
    /// # Errors
    /// [`LinkClosed`] when the agent is gone.
    pub async fn backfill(&self, request: v1::BackfillRequest) -> Result<(), LinkClosed> {
        self.queue.send(Outgoing::Backfill(request)).await.map_err(|_| LinkClosed)
    }

    /// Hands a backfill request to the link when there is room; `false` asks to try again later.
    pub fn try_backfill(&self, request: v1::BackfillRequest) -> bool {
        self.queue.try_send(Outgoing::Backfill(request)).is_ok()
    }

    /// Passes on a sign of life when there is room; the next one follows within a tenth of a second.
    pub fn try_operator_alive(&self, challenge: u64) -> bool {
        self.urgent.capacity() > URGENT_QUEUE / 2 && self.urgent.try_send(Outgoing::OperatorAlive(challenge)).is_ok()
    }

    /// Tells the agent that a flight is whole here, when there is room; it is told again after every reconnection.
    pub fn try_flight_kept(&self, flight_id: &str) -> bool {
        self.queue.try_send(Outgoing::FlightKept(flight_id.to_owned())).is_ok()
    }

    /// Is the link gone?
    pub fn is_closed(&self) -> bool {
        self.queue.is_closed()
    }
}

#[cfg(test)]
mod tests;
