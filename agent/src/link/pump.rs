//! Telemetry from the flight thread's ring onto the radio.
//!
//! The ring holds codec frames. Small ones are packed into datagrams; those that do not fit into a
//! datagram, and the rare kinds that a person waits for ([`must_arrive`]), take the reliable
//! stream. Bounds and policies:
//!
//! | queue | bound | when full |
//! |---|---|---|
//! | ring, written by the flight thread | set by the runner | newest refused, counted there |
//! | datagrams held back by the rate cap | [`HELD_BYTES`] | oldest dropped, counted |
//! | datagrams inside QUIC | [`DATAGRAM_SEND_BUFFER`] | oldest dropped, counted |
//! | reliable batches | [`RELIABLE_BATCHES`] | newest dropped, counted |
//!
//! What is dropped here stays in the onboard log and is asked for again by the ground.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::time::Instant;

use bytes::Bytes;
use plumbline_proto::Kind;
use plumbline_proto::codec::{BATCH_HEADER, Frame, begin_batch, decode_frames};
use quinn::{Connection, SendDatagramError};
use rtrb::Consumer;
use tokio::sync::mpsc;

use super::LinkState;
use super::rate::Rate;
use super::transport::{DATAGRAM_SEND_BUFFER, MAX_DATAGRAM};

/// Bytes of datagrams that wait for the rate cap.
pub const HELD_BYTES: usize = 16 * 1024;
/// Batches that wait for the reliable stream.
pub const RELIABLE_BATCHES: usize = 256;
/// Largest batch put together for the reliable stream; a single frame may be larger.
const RELIABLE_BATCH_BYTES: usize = 32 * 1024;

/// Kinds that are rare and that somebody waits for: they take the reliable stream.
pub const fn must_arrive(kind: Option<Kind>) -> bool {
    use Kind::{Ack, Attacks, Description, Event, Flight, Gains, StepResponse};
    matches!(kind, Some(Ack | Event | Flight | Description | Gains | Attacks | StepResponse))
}

/// One datagram and how many messages it holds.
#[derive(Debug)]
struct Packed {
    bytes: Bytes,
    messages: u64,
}

/// Moves frames from the ring to a connection; lives through every reconnection.
pub struct Pump {
    ring: Consumer<u8>,
    rate: Rate,
    buffer: Vec<u8>,
    batch: Vec<u8>,
    batch_messages: u64,
    reliable: Vec<u8>,
    reliable_messages: u64,
    held: VecDeque<Packed>,
    held_bytes: usize,
    /// Handed to QUIC and perhaps not sent yet, oldest first: bytes and messages.
    inside: VecDeque<(usize, u64)>,
    inside_bytes: usize,
}

impl Pump {
    /// Takes frames from `ring`, sends at most `bytes_per_second`.
    pub fn new(ring: Consumer<u8>, bytes_per_second: f64) -> Self {
        let burst = (bytes_per_second * 0.02).max(4.0 * MAX_DATAGRAM as f64);
        Self {
            ring,
            rate: Rate::new(bytes_per_second, burst, Instant::now()),
            buffer: Vec::new(),
            batch: Vec::with_capacity(MAX_DATAGRAM),
            batch_messages: 0,
            reliable: Vec::new(),
            reliable_messages: 0,
            held: VecDeque::new(),
            held_bytes: 0,
            inside: VecDeque::new(),
            inside_bytes: 0,
        }
    }

    /// Throws away what the flight thread has written: nobody is connected. The onboard log has it.
    pub fn discard(&mut self) {
        self.take_ring();
        self.buffer.clear();
        self.held.clear();
        self.held_bytes = 0;
        self.inside.clear();
        self.inside_bytes = 0;
    }

    /// Sends what has come since the last call.
    ///
    /// # Errors
    /// [`SendDatagramError`] when the connection is gone or carries no datagrams.
    pub fn send(
        &mut self,
        connection: &Connection,
        reliable: &mpsc::Sender<Vec<u8>>,
        state: &LinkState,
        now: Instant,
    ) -> Result<(), SendDatagramError> {
        self.take_ring();
        let buffer = std::mem::take(&mut self.buffer);
        for frame in decode_frames(&buffer) {
            match frame {
                Ok(frame) => self.pack(&frame, reliable, state),
                Err(error) => {
                    // Only whole frames are written to the ring.
                    tracing::error!(%error, "the telemetry ring holds no frame");
                    break;
                }
            }
        }
        self.buffer = buffer;
        self.buffer.clear();
        self.close_batch(state);
        self.close_reliable(reliable, state);
        while let Some(front) = self.held.front() {
            if !self.rate.take(front.bytes.len(), now) {
                break;
            }
            let Some(packed) = self.held.pop_front() else { break };
            self.held_bytes -= packed.bytes.len();
            self.hand_over(connection, packed, state)?;
        }
        Ok(())
    }

    fn take_ring(&mut self) {
        let slots = self.ring.slots();
        if let Ok(chunk) = self.ring.read_chunk(slots) {
            let (first, second) = chunk.as_slices();
            self.buffer.extend_from_slice(first);
            self.buffer.extend_from_slice(second);
            chunk.commit_all();
        }
    }

    fn pack(&mut self, frame: &Frame<'_>, reliable: &mpsc::Sender<Vec<u8>>, state: &LinkState) {
        let length = frame.encoded_len();
        if must_arrive(frame.known_kind()) || BATCH_HEADER + length > MAX_DATAGRAM {
            if !self.reliable.is_empty() && self.reliable.len() + length > RELIABLE_BATCH_BYTES {
                self.close_reliable(reliable, state);
            }
            if self.reliable.is_empty() {
                begin_batch(&mut self.reliable);
            }
            frame.encode(&mut self.reliable);
            self.reliable_messages += 1;
            return;
        }
        if self.batch.len() + length > MAX_DATAGRAM {
            self.close_batch(state);
        }
        if self.batch.is_empty() {
            begin_batch(&mut self.batch);
        }
        frame.encode(&mut self.batch);
        self.batch_messages += 1;
    }

    fn close_batch(&mut self, state: &LinkState) {
        if self.batch.is_empty() {
            return;
        }
        let packed = Packed { bytes: Bytes::copy_from_slice(&self.batch), messages: self.batch_messages };
        self.batch.clear();
        self.batch_messages = 0;
        self.held_bytes += packed.bytes.len();
        self.held.push_back(packed);
        while self.held_bytes > HELD_BYTES
            && let Some(oldest) = self.held.pop_front()
        {
            self.held_bytes -= oldest.bytes.len();
            state.dropped.fetch_add(oldest.messages, Ordering::Relaxed);
        }
    }

    fn close_reliable(&mut self, reliable: &mpsc::Sender<Vec<u8>>, state: &LinkState) {
        if self.reliable.is_empty() {
            return;
        }
        let batch = std::mem::take(&mut self.reliable);
        if reliable.try_send(batch).is_err() {
            state.dropped.fetch_add(self.reliable_messages, Ordering::Relaxed);
        }
        self.reliable_messages = 0;
    }

    /// Hands one datagram to QUIC, whose buffer drops its oldest to make room: count those.
    fn hand_over(
        &mut self,
        connection: &Connection,
        packed: Packed,
        state: &LinkState,
    ) -> Result<(), SendDatagramError> {
        let waiting = DATAGRAM_SEND_BUFFER.saturating_sub(connection.datagram_send_buffer_space());
        while self.inside_bytes > waiting
            && let Some((sent, _)) = self.inside.pop_front()
        {
            self.inside_bytes -= sent;
        }
        while self.inside_bytes + packed.bytes.len() > DATAGRAM_SEND_BUFFER
            && let Some((dropped, messages)) = self.inside.pop_front()
        {
            self.inside_bytes -= dropped;
            state.dropped.fetch_add(messages, Ordering::Relaxed);
        }
        self.inside.push_back((packed.bytes.len(), packed.messages));
        self.inside_bytes += packed.bytes.len();
        state.sent_bytes.fetch_add(packed.bytes.len() as u64, Ordering::Relaxed);
        state.sent.fetch_add(packed.messages, Ordering::Relaxed);
        connection.send_datagram(packed.bytes)
    }
}
