//! Answers "send me these messages again" from the onboard log.
//!
//! Each answer is one stream: the request repeated, then batches, then the ranges the log does not
//! hold (any more). Answers are given one after the other and held beneath live telemetry
//! ([`Headroom`]), which keeps the radio.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use plumbline_proto::codec::{Frame, begin_batch};
use plumbline_proto::v1::{BackfillRequest, command_frame::Body};
use quinn::Connection;
use tokio::sync::mpsc;

use super::LinkState;
use super::headroom::{Headroom, PERIOD, Signs};
use super::rate::Rate;
use super::transport::{FrameWriter, StreamError};

/// Requests that wait; a newer one beyond them is dropped and asked again by the ground.
pub const WAITING_REQUESTS: usize = 64;
/// Bytes of one batch of an answer: a few packets, so that live ones are never far behind.
const BATCH_BYTES: usize = 8 * 1024;
/// Batches read ahead of the radio.
const BATCHES_AHEAD: usize = 4;

/// Where old messages come from. Called off the flight thread; may read files.
pub trait Archive: Send + Sync {
    /// Passes the frames of `request` to `sink` in rising sequence until it breaks.
    ///
    /// # Errors
    /// A text for people when the log cannot be read.
    fn read(
        &self,
        request: &BackfillRequest,
        sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
    ) -> Result<(), String>;

    /// The ground holds the whole of this flight: it may go before others. May write files.
    fn kept(&self, flight_id: &str) {
        let _ = flight_id;
    }
}

/// No log: every range is unavailable.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoArchive;

impl Archive for NoArchive {
    fn read(&self, _: &BackfillRequest, _: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>) -> Result<(), String> {
        Ok(())
    }
}

enum Piece {
    Batch(Vec<u8>, u64),
    Missing(u64, u64),
}

/// How live telemetry fares, beneath which answers are held.
pub(super) struct Beneath<'a> {
    pub(super) telemetry: &'a Connection,
    pub(super) state: &'a LinkState,
    /// What the radio carries in all, bytes a second.
    pub(super) total: f64,
    /// Most for backfill, bytes a second.
    pub(super) cap: f64,
}

impl Beneath<'_> {
    fn signs(&self) -> Signs {
        Signs {
            live_bytes: self.state.sent_bytes.load(Ordering::Relaxed),
            dropped: self.state.dropped.load(Ordering::Relaxed),
            round_trip_s: self.telemetry.rtt().as_secs_f64(),
        }
    }
}

/// Answers requests until the connection ends.
///
/// # Errors
/// [`StreamError`] when the connection breaks.
pub(super) async fn answer(
    connection: &Connection,
    mut requests: mpsc::Receiver<BackfillRequest>,
    archive: Arc<dyn Archive>,
    live: &Beneath<'_>,
) -> Result<(), StreamError> {
    let mut headroom = Headroom::new(live.total, live.cap, live.signs(), Instant::now());
    let mut rate = Rate::new(headroom.rate(), BATCH_BYTES as f64, Instant::now());
    while let Some(request) = requests.recv().await {
        let mut writer = FrameWriter::new(connection.open_uni().await?).priority(-1);
        writer.send(Body::Backfill(request.clone())).await?;
        let (pieces, mut ready) = mpsc::channel(BATCHES_AHEAD);
        let reading = {
            let (archive, request) = (archive.clone(), request.clone());
            tokio::task::spawn_blocking(move || read(&*archive, &request, &pieces))
        };
        while let Some(piece) = ready.recv().await {
            match piece {
                Piece::Batch(batch, messages) => {
                    loop {
                        let now = Instant::now();
                        rate.set(headroom.update(live.signs(), now));
                        if rate.take(batch.len(), now) {
                            break;
                        }
                        // Looks again within a period: the room may have changed.
                        let wait = rate.wait_s(batch.len(), now).clamp(0.001, PERIOD.as_secs_f64());
                        tokio::time::sleep(std::time::Duration::from_secs_f64(wait)).await;
                    }
                    writer.send(Body::Frames(batch)).await?;
                    live.state.backfilled.fetch_add(messages, Ordering::Relaxed);
                }
                Piece::Missing(first_sequence, last_sequence) => {
                    let missing =
                        BackfillRequest { flight_id: request.flight_id.clone(), first_sequence, last_sequence };
                    writer.send(Body::BackfillUnavailable(missing)).await?;
                }
            }
        }
        writer.finish();
        match reading.await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                tracing::warn!(flight = request.flight_id, error, "backfill: the onboard log cannot be read")
            }
            Err(error) => tracing::error!(%error, "backfill: the reader died"),
        }
    }
    Ok(())
}

/// Cuts the archive's answer into batches and names what is missing in between.
fn read(archive: &dyn Archive, request: &BackfillRequest, pieces: &mpsc::Sender<Piece>) -> Result<(), String> {
    let mut batch = Vec::new();
    let mut messages = 0;
    let mut next = request.first_sequence;
    let mut gone = false;
    let outcome = archive.read(request, &mut |frame| {
        if frame.sequence < next || frame.sequence > request.last_sequence {
            return ControlFlow::Continue(());
        }
        if frame.sequence > next {
            gone |= pieces.blocking_send(Piece::Missing(next, frame.sequence - 1)).is_err();
        }
        next = frame.sequence.saturating_add(1);
        if batch.is_empty() {
            begin_batch(&mut batch);
        }
        frame.encode(&mut batch);
        messages += 1;
        if batch.len() >= BATCH_BYTES {
            let full = Piece::Batch(std::mem::take(&mut batch), std::mem::take(&mut messages));
            gone |= pieces.blocking_send(full).is_err();
        }
        if gone { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    if !batch.is_empty() {
        gone |= pieces.blocking_send(Piece::Batch(batch, messages)).is_err();
    }
    // A log that could not be read is no statement about what it holds.
    if outcome.is_ok() && !gone && next <= request.last_sequence {
        let _ = pieces.blocking_send(Piece::Missing(next, request.last_sequence));
    }
    outcome
}
