//! One connected agent: heartbeats and commands down, telemetry and backfill up.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use bytes::Bytes;
use plumbline_link::identity::Fingerprint;
use plumbline_link::transport::{self, CloseCode, FrameReader, FrameWriter, HEARTBEAT_PERIOD, StreamError};
use plumbline_proto::codec::Batch;
use plumbline_proto::v1::{self, Heartbeat, Hello, command_frame::Body};
use quinn::{Connection, RecvStream};
use tokio::sync::mpsc::error::TrySendError;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

use super::clock::wall_us;
use super::offset::OffsetEstimator;
use super::registry::Claim;
use super::server::Shared;
use super::{CommandReceiver, CommandSender, LinkEvent, Outgoing};

/// How often the state of the link is reported.
const STATS_PERIOD: Duration = Duration::from_millis(250);

/// Serves the commands connection to its end.
pub(super) async fn commands(
    connection: Connection,
    reader: FrameReader,
    writer: FrameWriter,
    hello: Hello,
    claim: Claim,
    fingerprint: Fingerprint,
    shared: &Shared,
) {
    let agent_id = hello.id.clone();
    let (commands, outgoing) = CommandSender::channel();
    tracing::info!(agent = agent_id, peer = %connection.remote_address(), version = hello.version, "agent connected");
    let connected = LinkEvent::Connected {
        agent_id: agent_id.clone(),
        boot_id: hello.boot_id,
        boot_wall_time_us: hello.boot_wall_time_us,
        version: hello.version.clone(),
        commands,
    };
    if shared.events.send(connected).await.is_err() {
        return;
    }
    let ended = tokio::select! {
        error = connection.closed() => transport::reason(&error),
        () = shared.config.identity.revoked(fingerprint) => "the agent is trusted no more".to_owned(),
        outcome = sending(writer, outgoing) => explain(outcome, &connection),
        outcome = listening(reader, &hello, &claim, shared) => explain(outcome, &connection),
        outcome = streams(&connection, &agent_id, shared) => explain(outcome, &connection),
    };
    CloseCode::Protocol.close(&connection, &ended);
    tracing::info!(agent = agent_id, reason = ended, "agent disconnected");
    let _ = shared.events.send(LinkEvent::Disconnected { agent_id, reason: ended }).await;
    // Only now may a successor begin, so that the hub hears of the one before the other.
    drop(claim);
}

/// The reason of a connection's end goes before that of a stream.
fn explain(outcome: Result<(), StreamError>, connection: &Connection) -> String {
    match (connection.close_reason(), outcome) {
        (Some(closed), _) => transport::reason(&closed),
        (None, Err(error)) => error.to_string(),
        (None, Ok(())) => "the agent has left".to_owned(),
    }
}

/// Heartbeats on time, commands in between.
async fn sending(mut writer: FrameWriter, mut outgoing: CommandReceiver) -> Result<(), StreamError> {
    let mut heartbeat = interval(HEARTBEAT_PERIOD);
    heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut open = true;
    loop {
        let body = tokio::select! {
            biased;
            _ = heartbeat.tick() => {
                Body::Heartbeat(Heartbeat { ground_time_us: wall_us(Instant::now()), agent_time_us: None })
            }
            next = outgoing.recv(), if open => match next {
                Some(Outgoing::Command(command)) => Body::Command(command),
                Some(Outgoing::Backfill(request)) => Body::Backfill(request),
                Some(Outgoing::OperatorAlive(challenge)) => Body::OperatorAlive(v1::OperatorAlive { challenge }),
                Some(Outgoing::FlightKept(flight_id)) => Body::FlightKept(v1::FlightKept { flight_id }),
                // The hub keeps no way down; the agent is still heard.
                None => { open = false; continue; }
            },
        };
        writer.send(body).await?;
    }
}

/// Echoes of heartbeats.
async fn listening(mut reader: FrameReader, hello: &Hello, claim: &Claim, shared: &Shared) -> Result<(), StreamError> {
    let mut offset = OffsetEstimator::default();
    let mut reported = Instant::now();
    while let Some(body) = reader.next().await? {
        let Body::Heartbeat(Heartbeat { ground_time_us, agent_time_us: Some(agent_time_us) }) = body else {
            let found = "another message".to_owned();
            return Err(StreamError::Unexpected { expected: "the echo of a heartbeat", found });
        };
        claim.heard();
        let now = Instant::now();
        offset.add(ground_time_us, hello.boot_wall_time_us.saturating_add(agent_time_us), wall_us(now));
        if now.duration_since(reported) >= STATS_PERIOD
            && let Some((round_trip_ms, clock_offset_us)) = offset.estimate()
        {
            reported = now;
            let stats = LinkEvent::Stats { agent_id: hello.id.clone(), round_trip_ms, clock_offset_us };
            // A hub that is busy hears of the next one.
            let _ = shared.events.try_send(stats);
        }
    }
    Ok(())
}

/// Streams opened by the agent: large messages, and answers to backfill requests.
async fn streams(connection: &Connection, agent_id: &str, shared: &Shared) -> Result<(), StreamError> {
    let mut open = JoinSet::new();
    loop {
        tokio::select! {
            stream = connection.accept_uni() => {
                open.spawn(stream_of_batches(stream?, agent_id.to_owned(), shared.clone()));
            }
            Some(ended) = open.join_next(), if !open.is_empty() => match ended {
                Ok(outcome) => outcome?,
                Err(error) => tracing::error!(%error, "the reader of a stream died"),
            },
        }
    }
}

/// An answer to a backfill begins by repeating the request; anything else is live.
async fn stream_of_batches(stream: RecvStream, agent_id: String, shared: Shared) -> Result<(), StreamError> {
    let mut reader = FrameReader::new(stream);
    let mut backfill = false;
    while let Some(body) = reader.next().await? {
        let event = match body {
            Body::Backfill(_) => {
                backfill = true;
                continue;
            }
            Body::Frames(bytes) => {
                let Some(batch) = parse(Bytes::from(bytes), &agent_id, &shared) else { continue };
                LinkEvent::Batch { agent_id: agent_id.clone(), batch, received: Instant::now(), backfill }
            }
            Body::BackfillUnavailable(request) => {
                LinkEvent::BackfillUnavailable { agent_id: agent_id.clone(), request }
            }
            Body::Hello(_)
            | Body::Command(_)
            | Body::Heartbeat(_)
            | Body::OperatorAlive(_)
            | Body::FlightKept(_)
            | Body::PairingProof(_) => {
                let found = "a message of another stream".to_owned();
                return Err(StreamError::Unexpected { expected: "frames", found });
            }
        };
        // Waiting here holds the agent back: the stream is reliable.
        if shared.events.send(event).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// Serves the telemetry connection to its end.
pub(super) async fn telemetry(connection: Connection, agent_id: &str, shared: &Shared) {
    loop {
        match connection.read_datagram().await {
            Ok(bytes) => {
                let received = Instant::now();
                let Some(batch) = parse(bytes, agent_id, shared) else { continue };
                let event = LinkEvent::Batch { agent_id: agent_id.to_owned(), batch, received, backfill: false };
                match shared.events.try_send(event) {
                    Ok(()) => {}
                    // The gap shows in the sequence numbers and is filled from the agent's log.
                    Err(TrySendError::Full(_)) => {
                        shared.dropped.fetch_add(1, Ordering::Relaxed);
                    }
                    Err(TrySendError::Closed(_)) => return,
                }
            }
            Err(error) => {
                tracing::debug!(agent = agent_id, reason = transport::reason(&error), "telemetry ends");
                return;
            }
        }
    }
}

/// The batch; `None` of what is none, which is counted.
fn parse(bytes: Bytes, agent_id: &str, shared: &Shared) -> Option<Batch> {
    let length = bytes.len();
    match Batch::parse(bytes) {
        Ok(batch) => Some(batch),
        Err(error) => {
            let malformed = shared.malformed.fetch_add(1, Ordering::Relaxed) + 1;
            if malformed <= 10 || malformed.is_multiple_of(1000) {
                tracing::warn!(agent = agent_id, %error, malformed, bytes = length, "malformed batch dropped");
            }
            None
        }
    }
}
