//! One life of the link: connected, talking, lost.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use plumbline_proto::v1::{Heartbeat, Hello, command_frame::Body};
use quinn::{ClientConfig, Connection, Endpoint};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

use super::backfill::{self, Beneath, WAITING_REQUESTS};
use super::inbound::{self, Inbound, Request};
use super::lateness::{COMMAND_MAX_AGE_S, Lateness, never_too_late};
use super::pump::RELIABLE_BATCHES;
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
    /// Did both sides agree to talk?
    pub established: bool,
}

impl Ended {
    fn early(reason: impl ToString) -> Self {
        Self { reason: reason.to_string(), established: false }
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
        Err(reason) => return Ended::early(reason),
    };
    let telemetry = tokio::select! {
        connection = connect::persistently(endpoint, &configs.telemetry, ground, &link.state) => connection,
        error = commands.closed() => return Ended::early(transport::reason(&error)),
        never = discard(&mut link.pump) => match never {},
    };
    let companion = tokio::select! {
        greeted = greet(&telemetry, link_hello(link)) => greeted,
        never = discard(&mut link.pump) => match never {},
    };
    // The streams stay open as long as the connection is used.
    let _companion = match companion {
        Ok(streams) => streams,
        Err(reason) => {
            CloseCode::Companion.close(&commands, &reason);
            return Ended::early(reason);
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
    Ended { reason, established: true }
}

async fn discard(pump: &mut super::pump::Pump) -> std::convert::Infallible {
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
async fn greet(connection: &Connection, mine: Hello) -> Result<(FrameReader, FrameWriter), String> {
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
                Err(reason)
            }
        },
        Err(error) => {
            // The ground's own words, when it closed with some.
            let reason =
                connection.close_reason().map_or_else(|| error.to_string(), |closed| transport::reason(&closed));
            CloseCode::Protocol.close(connection, &reason);
            Err(reason)
        }
    }
}

async fn talk(
    link: &mut Link,
    commands: &Connection,
    telemetry: &Connection,
    mut reader: FrameReader,
    mut writer: FrameWriter,
) -> String {
    let (reliable, mut reliable_batches) = mpsc::channel::<Vec<u8>>(RELIABLE_BATCHES);
    let (requests, waiting) = mpsc::channel(WAITING_REQUESTS);
    let state = link.state.clone();
    let clock = link.clock.clone();
    let archive = link.archive.clone();
    let identity = link.config.identity.clone();
    let beneath = Beneath {
        telemetry,
        state: &state,
        total: link.config.telemetry_bytes_per_s,
        cap: link.config.backfill_bytes_per_s,
    };
    let Link { pump, inbound: queue, .. } = link;

    let pumping = async {
        let mut tick = interval(PUMP_PERIOD);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tick.tick().await;
            if let Err(error) = pump.send(telemetry, &reliable, &state, Instant::now()) {
                return Err::<(), String>(error.to_string());
            }
        }
    };
    let reliable_sending = async {
        let mut writer = FrameWriter::new(commands.open_uni().await?);
        while let Some(batch) = reliable_batches.recv().await {
            writer.send(Body::Frames(batch)).await?;
        }
        Ok::<(), StreamError>(())
    };
    let listening = async {
        let mut lateness = Lateness::new(Instant::now());
        while let Some(body) = reader.next().await? {
            match body {
                Body::Heartbeat(Heartbeat { ground_time_us, .. }) => {
                    lateness.heartbeat(ground_time_us, Instant::now(), commands.rtt());
                    state.heartbeats.fetch_add(1, Ordering::Release);
                    let agent_time_us = Some(clock.now().0);
                    writer.send(Body::Heartbeat(Heartbeat { ground_time_us, agent_time_us })).await?;
                }
                Body::Command(command) => {
                    let mut request = in_time(inbound::parse(command), lateness.command_s(Instant::now()), &state);
                    // The flight thread empties the queue every tick: wait for it, lose nothing.
                    while let Err(rtrb::PushError::Full(back)) = queue.push(request) {
                        request = back;
                        tokio::time::sleep(PUMP_PERIOD).await;
                    }
                }
                Body::Backfill(request) => {
                    if requests.try_send(request).is_err() {
                        tracing::warn!(waiting = WAITING_REQUESTS, "too many backfill requests, the newest is dropped");
                    }
                }
                Body::OperatorAlive(alive) => state.answered.store(alive.challenge, Ordering::Release),
                Body::FlightKept(kept) => {
                    let archive = archive.clone();
                    tokio::task::spawn_blocking(move || archive.kept(&kept.flight_id));
                }
                Body::Hello(_) | Body::Frames(_) | Body::BackfillUnavailable(_) | Body::PairingProof(_) => {
                    let found = "a message that only an agent sends".to_owned();
                    return Err(StreamError::Unexpected { expected: "a command", found });
                }
            }
        }
        Ok::<(), StreamError>(())
    };
    let answering = backfill::answer(commands, waiting, archive.clone(), &beneath);

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
        outcome = pumping => outcome.err().unwrap_or_else(left),
        outcome = reliable_sending => ended(outcome),
        outcome = listening => ended(outcome),
        outcome = answering => ended(outcome),
        () = revoked => "the ground is trusted no more".to_owned(),
        error = commands.closed() => transport::reason(&error),
        error = telemetry.closed() => transport::reason(&error),
    }
}

/// Refuses a command that a fade has held up for `late_s`, unless it is right at any time.
fn in_time(inbound: Inbound, late_s: f64, state: &LinkState) -> Inbound {
    let harmless = match &inbound.request {
        Request::Flight(command) => never_too_late(command),
        Request::Refused(_) => true,
        Request::Gains { .. } | Request::Recording(_) | Request::Replay(_) | Request::Simulator(_) => false,
    };
    if harmless || late_s <= COMMAND_MAX_AGE_S {
        return inbound;
    }
    state.late.fetch_add(1, Ordering::Relaxed);
    let reason =
        format!("it was {late_s:.1} s on its way (limit {COMMAND_MAX_AGE_S} s): the link had failed; send it again");
    Inbound { id: inbound.id, request: Request::Refused(reason) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Command;
    use plumbline_proto::ids::CommandId;

    #[test]
    fn late_commands_are_refused_but_those_that_end_something() {
        let state = LinkState::default();
        let flight = |command| Inbound { id: CommandId(1), request: Request::Flight(command) };
        assert_eq!(in_time(flight(Command::Arm), 0.9, &state), flight(Command::Arm));
        match in_time(flight(Command::Arm), 3.0, &state).request {
            Request::Refused(reason) => assert!(reason.starts_with("it was 3.0 s on its way"), "{reason}"),
            other => panic!("{other:?}"),
        }
        assert_eq!(in_time(flight(Command::CutMotors), 3.0, &state), flight(Command::CutMotors));
        assert_eq!(state.late.load(Ordering::Relaxed), 1);
    }
}
