//! One life of the link: connected, talking, lost.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::{self, BackfillRequest, Heartbeat, Hello, command_frame::Body};
use quinn::{ClientConfig, Connection, ConnectionError, Endpoint, SendDatagramError};
use rtrb::Producer;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

use super::backfill::{self, Archive, Beneath, WAITING_REQUESTS};
use super::clock::FlightClock;
use super::inbound::{self, Inbound, Request};
use super::lateness::{Lateness, never_too_late, too_late};
use super::pump::{Pump, RELIABLE_BATCHES};
use super::stall::{self, Signs, Stall};
use super::tls::{self, Purpose};
use super::transport::{self, CloseCode, FrameReader, FrameWriter, StreamError};
use super::{Link, LinkError, LinkState, connect, hello};

/// How often the ring is emptied.
const PUMP_PERIOD: Duration = Duration::from_millis(2);
/// How often the ring is emptied while nobody is connected.
const DISCARD_PERIOD: Duration = Duration::from_millis(20);

/// Why a session ended.
#[derive(Debug)]
pub(super) struct Ended {
    /// For people.
    pub reason: String,
    /// Worth another try at once: both sides had agreed to talk, or the radio failed before they could. Whoever was
    /// refused waits.
    pub again: bool,
}

impl Ended {
    fn early(error: &StreamError) -> Self {
        let again = matches!(error, StreamError::Timeout { .. } | StreamError::Connection(ConnectionError::TimedOut));
        Self { reason: error.to_string(), again }
    }
}

/// The two client configurations.
pub(super) struct Configs {
    telemetry: ClientConfig,
    commands: ClientConfig,
}

impl Configs {
    pub(super) fn new(link: &Link) -> Result<Self, LinkError> {
        let make = |purpose| -> Result<ClientConfig, LinkError> {
            let mut config = ClientConfig::new(Arc::new(tls::client(&link.config.identity, purpose)?));
            config.transport_config(transport::client(purpose, link.config.telemetry_bytes_per_s));
            Ok(config)
        };
        Ok(Self { telemetry: make(Purpose::Telemetry)?, commands: make(Purpose::Commands)? })
    }
}

/// Connects, talks until the link is lost, and says why it ended.
pub(super) async fn run(link: &mut Link, endpoint: &Endpoint, configs: &Configs, ground: SocketAddr) -> Ended {
    let commands = tokio::select! {
        connection = connect::persistently(endpoint, &configs.commands, ground, &link.state) => connection,
        never = discard(&mut link.pump) => match never {},
    };
    let greeted = tokio::select! {
        greeted = greet(&commands, link_hello(link)) => greeted,
        never = discard(&mut link.pump) => match never {},
    };
    let (reader, writer) = match greeted {
        Ok(streams) => streams,
        Err(ended) => return ended,
    };
    let telemetry = tokio::select! {
        connection = connect::persistently(endpoint, &configs.telemetry, ground, &link.state) => connection,
        error = commands.closed() => return Ended::early(&error.into()),
        never = discard(&mut link.pump) => match never {},
    };
    let companion = tokio::select! {
        greeted = greet(&telemetry, link_hello(link)) => greeted,
        never = discard(&mut link.pump) => match never {},
    };
    // The streams stay open as long as the connection is used.
    let _companion = match companion {
        Ok(streams) => streams,
        Err(ended) => {
            CloseCode::Companion.close(&commands, &ended.reason);
            return ended;
        }
    };
    tracing::info!(%ground, "connected");
    link.pump.discard();
    link.state.connections.fetch_add(1, Ordering::Release);
    link.state.connected.store(true, Ordering::Release);
    let reason = talk(link, &commands, &telemetry, reader, writer).await;
    link.state.connected.store(false, Ordering::Release);
    CloseCode::Companion.close(&telemetry, &reason);
    CloseCode::Companion.close(&commands, &reason);
    Ended { reason, again: true }
}

async fn discard(pump: &mut Pump) -> std::convert::Infallible {
    let mut tick = interval(DISCARD_PERIOD);
    loop {
        tick.tick().await;
        pump.discard();
    }
}

fn link_hello(link: &Link) -> Hello {
    Hello {
        schema: link.config.schema,
        id: link.config.agent_id.clone(),
        version: link.config.version.clone(),
        boot_id: link.config.boot_id,
        boot_wall_time_us: link.config.boot_wall_time.0,
    }
}

/// Says hello and checks the answer.
async fn greet(connection: &Connection, mine: Hello) -> Result<(FrameReader, FrameWriter), Ended> {
    let exchange = async {
        let (send, receive) = connection.open_bi().await?;
        let mut writer = FrameWriter::new(send).priority(1);
        let mut reader = FrameReader::new(receive);
        writer.send(Body::Hello(mine)).await?;
        let theirs = hello::receive(&mut reader).await?;
        Ok::<_, StreamError>((reader, writer, theirs))
    };
    match exchange.await {
        Ok((reader, writer, theirs)) => match hello::check(&theirs) {
            Ok(()) => Ok((reader, writer)),
            Err(error) => {
                let reason = error.to_string();
                CloseCode::Schema.close(connection, &reason);
                Err(Ended { reason, again: false })
            }
        },
        Err(error) => {
            // The ground's own words, when it closed with some.
            let ended = Ended::early(&connection.close_reason().map_or(error, StreamError::Connection));
            CloseCode::Protocol.close(connection, &ended.reason);
            Err(ended)
        }
    }
}

/// Pumps, listens and answers until one of them ends; says why it did.
async fn talk(
    link: &mut Link,
    commands: &Connection,
    telemetry: &Connection,
    reader: FrameReader,
    writer: FrameWriter,
) -> String {
    let (reliable, reliable_batches) = mpsc::channel(RELIABLE_BATCHES);
    let (requests, waiting) = mpsc::channel(WAITING_REQUESTS);
    let identity = link.config.identity.clone();
    let Link { config, pump, inbound, clock, archive, state } = link;
    let state: &LinkState = state;
    let beneath = Beneath { telemetry, state, total: config.telemetry_bytes_per_s, cap: config.backfill_bytes_per_s };
    let listener = Listener { commands, reader, writer, requests, inbound, clock, archive, state };
    let revoked = async {
        match tls::peer_fingerprint(commands) {
            Some(peer) => identity.revoked(peer).await,
            None => std::future::pending().await,
        }
    };

    // An orderly end of any of them means that the peer has left.
    let left = || "the ground has left".to_owned();
    let ended = |outcome: Result<(), StreamError>| outcome.map_or_else(|error| error.to_string(), |()| left());
    tokio::select! {
        error = pumping(pump, telemetry, &reliable, state) => error.to_string(),
        outcome = reliable_sending(commands, reliable_batches) => ended(outcome),
        outcome = listener.listen() => ended(outcome),
        outcome = backfill::answer(commands, waiting, archive.clone(), &beneath) => ended(outcome),
        () = stalled(commands, telemetry, state) => "the commands connection stays silent after a fade".to_owned(),
        () = revoked => "the ground is trusted no more".to_owned(),
        error = commands.closed() => transport::reason(&error),
        error = telemetry.closed() => transport::reason(&error),
    }
}

/// Empties the ring until telemetry cannot be sent any more.
async fn pumping(
    pump: &mut Pump,
    telemetry: &Connection,
    reliable: &mpsc::Sender<Vec<u8>>,
    state: &LinkState,
) -> SendDatagramError {
    let mut tick = interval(PUMP_PERIOD);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        if let Err(error) = pump.send(telemetry, reliable, state, Instant::now()) {
            return error;
        }
    }
}

/// Sends the batches that must arrive.
async fn reliable_sending(commands: &Connection, mut batches: mpsc::Receiver<Vec<u8>>) -> Result<(), StreamError> {
    let mut writer = FrameWriter::new(commands.open_uni().await?);
    while let Some(batch) = batches.recv().await {
        writer.send(Body::Frames(batch)).await?;
    }
    Ok(())
}

/// Completes when the commands connection does not come back after a fade.
async fn stalled(commands: &Connection, telemetry: &Connection, state: &LinkState) {
    let signs = || Signs {
        telemetry_acks: telemetry.stats().frame_rx.acks,
        commands_acks: commands.stats().frame_rx.acks,
        heartbeats: state.heartbeats.load(Ordering::Acquire),
    };
    let mut stall = Stall::new(signs());
    let mut tick = interval(stall::PERIOD);
    // After a pause of the whole program nothing is made up for: what came meanwhile has to be read first.
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        if stall.update(signs()) {
            return;
        }
    }
}

/// What the ground says, and where it goes.
struct Listener<'a> {
    commands: &'a Connection,
    reader: FrameReader,
    writer: FrameWriter,
    requests: mpsc::Sender<BackfillRequest>,
    inbound: &'a mut Producer<Inbound>,
    clock: &'a FlightClock,
    archive: &'a Arc<dyn Archive>,
    state: &'a LinkState,
}

impl Listener<'_> {
    /// Obeys the ground until it ends the stream.
    async fn listen(mut self) -> Result<(), StreamError> {
        let mut lateness = Lateness::new(Instant::now());
        while let Some(body) = self.reader.next().await? {
            match body {
                Body::Heartbeat(Heartbeat { ground_time_us, .. }) => {
                    lateness.heartbeat(ground_time_us, Instant::now(), self.commands.rtt());
                    self.state.heartbeats.fetch_add(1, Ordering::Release);
                    let agent_time_us = Some(self.clock.now().0);
                    self.writer.send(Body::Heartbeat(Heartbeat { ground_time_us, agent_time_us })).await?;
                }
                Body::Command(command) => self.command(command, &lateness).await,
                Body::Backfill(request) => {
                    if self.requests.try_send(request).is_err() {
                        tracing::warn!(waiting = WAITING_REQUESTS, "too many backfill requests, the newest is dropped");
                    }
                }
                Body::OperatorAlive(alive) => self.state.answered.store(alive.challenge, Ordering::Release),
                Body::FlightKept(kept) => {
                    let archive = self.archive.clone();
                    tokio::task::spawn_blocking(move || archive.kept(&kept.flight_id));
                }
                Body::Hello(_) | Body::Frames(_) | Body::BackfillUnavailable(_) | Body::PairingProof(_) => {
                    let found = "a message that only an agent sends".to_owned();
                    return Err(StreamError::Unexpected { expected: "a command", found });
                }
            }
        }
        Ok(())
    }

    /// Hands a command to the flight thread, or its refusal where it comes too late.
    async fn command(&mut self, command: v1::Command, lateness: &Lateness) {
        let picture_s = command.seen_us.map_or(0.0, |seen_us| self.clock.since_s(FlightTime(seen_us)));
        let late = too_late(lateness.command_s(Instant::now()), picture_s);
        let mut request = in_time(inbound::parse(command), late, self.state);
        // The flight thread empties the queue every tick: wait for it, lose nothing.
        while let Err(rtrb::PushError::Full(back)) = self.inbound.push(request) {
            request = back;
            tokio::time::sleep(PUMP_PERIOD).await;
        }
    }
}

/// Refuses a command for being late, unless it is right at any time.
fn in_time(inbound: Inbound, late: Option<String>, state: &LinkState) -> Inbound {
    let harmless = match &inbound.request {
        Request::Flight(command) => never_too_late(command),
        Request::Refused(_) => true,
        Request::Gains { .. }
        | Request::Recording(_)
        | Request::Replay(_)
        | Request::Simulator(_)
        | Request::Calibration(_) => false,
    };
    match late {
        Some(reason) if !harmless => {
            state.late.fetch_add(1, Ordering::Relaxed);
            Inbound { id: inbound.id, request: Request::Refused(reason) }
        }
        _ => inbound,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Command;
    use plumbline_proto::ids::CommandId;

    #[test]
    fn whom_the_radio_failed_tries_again_at_once_and_whom_the_ground_refused_waits() {
        let closed = ConnectionError::ApplicationClosed(quinn::ApplicationClose {
            error_code: quinn::VarInt::from_u32(CloseCode::Duplicate as u32),
            reason: bytes::Bytes::from_static(b"another agent of this id is connected"),
        });
        for (error, again) in [
            (StreamError::Timeout { expected: "hello", seconds: 2.0 }, true),
            (StreamError::Connection(ConnectionError::TimedOut), true),
            (StreamError::Connection(closed), false),
            (StreamError::Unexpected { expected: "hello", found: "another message".into() }, false),
        ] {
            assert_eq!(Ended::early(&error).again, again, "{error}");
        }
    }

    #[test]
    fn late_commands_are_refused_but_those_that_end_something() {
        let state = LinkState::default();
        let flight = |command| Inbound { id: CommandId(1), request: Request::Flight(command) };
        assert_eq!(in_time(flight(Command::Arm), too_late(0.9, 1.9), &state), flight(Command::Arm));
        for (way_s, picture_s, told) in [
            (3.0, 0.1, "it was 3.0 s on its way"),
            (0.0, 3.0, "it was asked on a picture 3.0 s old"),
            (0.0, f64::INFINITY, "it was asked on a picture from before the agent's start"),
        ] {
            match in_time(flight(Command::Arm), too_late(way_s, picture_s), &state).request {
                Request::Refused(reason) => assert!(reason.starts_with(told), "{reason}"),
                other => panic!("{other:?}"),
            }
            assert_eq!(
                in_time(flight(Command::CutMotors), too_late(way_s, picture_s), &state),
                flight(Command::CutMotors)
            );
        }
        assert_eq!(state.late.load(Ordering::Relaxed), 3);
    }
}
