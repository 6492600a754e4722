//! Sans-I/O framing: bytes in, frames out; no socket, no file.
//!
//! A *batch* is one datagram, one WebSocket message or one answer to a backfill:
//!
//! ```text
//! batch  := magic u8 = 0x50 | schema u8 | frame*
//! frame  := kind u16 | instance u16 | length u32 | sequence u64 | time_us u64 | payload
//! ```
//! Little-endian. Frames of unknown kinds are passed on whole, so that an old reader survives a
//! new writer and a recorder loses nothing it does not understand.
//!
//! The command connection carries length-delimited [`CommandFrame`]s: `length u32 | message`,
//! read by [`Delimited`].

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use prost::Message;

use crate::{DecodeError, Kind, SCHEMA, v1::CommandFrame};

/// First byte of every batch.
pub const MAGIC: u8 = 0x50;
/// Bytes before the first frame of a batch.
pub const BATCH_HEADER: usize = 2;
/// Bytes before a frame's payload.
pub const FRAME_HEADER: usize = 24;
/// Largest payload accepted.
pub const MAX_PAYLOAD: usize = 1 << 20;
/// Largest [`CommandFrame`] accepted.
pub const MAX_COMMAND_FRAME: usize = 2 << 20;

/// One message with its envelope, borrowing its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Number of the [`Kind`], kept as it came.
    pub kind: u16,
    /// Sensor instance or estimator number; 0 where the kind has no instances.
    pub instance: u16,
    /// Counts the agent's messages since boot, from 1; 0 for messages made by the ground.
    pub sequence: u64,
    /// Flight time of the message; wall time for messages made by the ground.
    pub time_us: u64,
    /// Protobuf message.
    pub payload: &'a [u8],
}

impl Frame<'_> {
    /// The kind, `None` when this build does not know it.
    pub fn known_kind(&self) -> Option<Kind> {
        Kind::from_wire(self.kind)
    }

    /// Bytes on the wire.
    pub fn encoded_len(&self) -> usize {
        FRAME_HEADER + self.payload.len()
    }

    /// Appends the frame to a batch.
    pub fn encode(&self, batch: &mut Vec<u8>) {
        begin_frame(batch, self.kind, self.instance, self.sequence, self.time_us, self.payload.len());
        batch.extend_from_slice(self.payload);
    }

    /// Decodes the payload as `M`.
    ///
    /// # Errors
    /// [`DecodeError::Malformed`] with the decoder's reason.
    pub fn message<M: Message + Default>(&self) -> Result<M, DecodeError> {
        M::decode(self.payload).map_err(|e| DecodeError::Malformed {
            message: self.known_kind().map_or("message", Kind::message_name),
            reason: e.to_string(),
        })
    }
}

fn begin_frame(out: &mut Vec<u8>, kind: u16, instance: u16, sequence: u64, time_us: u64, length: usize) {
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&instance.to_le_bytes());
    out.extend_from_slice(&(length as u32).to_le_bytes());
    out.extend_from_slice(&sequence.to_le_bytes());
    out.extend_from_slice(&time_us.to_le_bytes());
}

/// Starts an empty batch in `out` (cleared first).
pub fn begin_batch(out: &mut Vec<u8>) {
    out.clear();
    out.push(MAGIC);
    out.push(SCHEMA);
}

/// Appends `message` as one frame. Allocates only when `out` must grow.
pub fn encode_message<M: Message>(
    out: &mut Vec<u8>,
    kind: Kind,
    instance: u16,
    sequence: u64,
    time_us: u64,
    message: &M,
) {
    begin_frame(out, kind.to_wire(), instance, sequence, time_us, message.encoded_len());
    message.encode_raw(out);
}

/// Iterates over the frames of a batch; ends after the first error.
#[derive(Debug, Clone)]
pub struct Frames<'a> {
    rest: &'a [u8],
    failed: Option<DecodeError>,
}

/// The frames of `batch`.
///
/// # Errors
/// [`DecodeError::Magic`], [`DecodeError::Schema`] or [`DecodeError::Truncated`] for its header;
/// errors of single frames come from the iterator.
pub fn decode_batch(batch: &[u8]) -> Result<Frames<'_>, DecodeError> {
    let (&[magic, schema], rest) = batch
        .split_first_chunk::<BATCH_HEADER>()
        .ok_or(DecodeError::Truncated { needed: BATCH_HEADER, available: batch.len() })?;
    if magic != MAGIC {
        return Err(DecodeError::Magic { found: magic, expected: MAGIC });
    }
    if schema != SCHEMA {
        return Err(DecodeError::Schema { found: schema, expected: SCHEMA });
    }
    Ok(Frames { rest, failed: None })
}

/// Frames that follow each other without a batch header (a log's memory, a byte ring).
pub fn decode_frames(bytes: &[u8]) -> Frames<'_> {
    Frames { rest: bytes, failed: None }
}

impl<'a> Iterator for Frames<'a> {
    type Item = Result<Frame<'a>, DecodeError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() || self.failed.is_some() {
            return None;
        }
        match split_frame(self.rest) {
            Ok((frame, rest)) => {
                self.rest = rest;
                Some(Ok(frame))
            }
            Err(error) => {
                self.failed = Some(error.clone());
                Some(Err(error))
            }
        }
    }
}

fn split_frame(bytes: &[u8]) -> Result<(Frame<'_>, &[u8]), DecodeError> {
    let truncated = |needed| DecodeError::Truncated { needed, available: bytes.len() };
    let (header, rest) = bytes.split_first_chunk::<FRAME_HEADER>().ok_or(truncated(FRAME_HEADER))?;
    let [k0, k1, i0, i1, l0, l1, l2, l3, s0, s1, s2, s3, s4, s5, s6, s7, t0, t1, t2, t3, t4, t5, t6, t7] = *header;
    let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
    if length > MAX_PAYLOAD {
        return Err(DecodeError::Oversized { length, limit: MAX_PAYLOAD });
    }
    let (payload, rest) = rest.split_at_checked(length).ok_or(truncated(FRAME_HEADER + length))?;
    let frame = Frame {
        kind: u16::from_le_bytes([k0, k1]),
        instance: u16::from_le_bytes([i0, i1]),
        sequence: u64::from_le_bytes([s0, s1, s2, s3, s4, s5, s6, s7]),
        time_us: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        payload,
    };
    Ok((frame, rest))
}

/// A batch that came from elsewhere, every frame of it checked: parsed once, where it comes in. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Batch {
    bytes: Bytes,
    frames: Arc<[Place]>,
}

/// A frame whose payload is a place in the batch.
#[derive(Debug)]
struct Place {
    kind: u16,
    instance: u16,
    sequence: u64,
    time_us: u64,
    payload: Range<usize>,
}

impl Batch {
    /// Parses a whole batch.
    ///
    /// # Errors
    /// The first [`DecodeError`] of its header or of any frame.
    pub fn parse(bytes: Bytes) -> Result<Self, DecodeError> {
        let mut places = Vec::new();
        let mut start = BATCH_HEADER;
        for frame in decode_batch(&bytes)? {
            let Frame { kind, instance, sequence, time_us, payload } = frame?;
            let first = start + FRAME_HEADER;
            start = first + payload.len();
            places.push(Place { kind, instance, sequence, time_us, payload: first..start });
        }
        Ok(Self { bytes, frames: places.into() })
    }

    /// The frames, in the order they came.
    pub fn frames(&self) -> impl Iterator<Item = Frame<'_>> {
        self.frames.iter().map(|place| Frame {
            kind: place.kind,
            instance: place.instance,
            sequence: place.sequence,
            time_us: place.time_us,
            // Always there: the places are those of these bytes.
            payload: self.bytes.get(place.payload.clone()).unwrap_or_default(),
        })
    }

    /// Bytes on the wire.
    pub fn wire_len(&self) -> usize {
        self.bytes.len()
    }

    /// Bytes in memory, shared by all clones.
    pub fn held_bytes(&self) -> usize {
        self.bytes.len() + std::mem::size_of_val(&*self.frames)
    }
}

/// Appends `frame` with its length in front.
pub fn encode_delimited(out: &mut Vec<u8>, frame: &CommandFrame) {
    out.extend_from_slice(&(frame.encoded_len() as u32).to_le_bytes());
    frame.encode_raw(out);
}

/// Cuts a byte stream into [`CommandFrame`]s.
#[derive(Debug, Default)]
pub struct Delimited {
    buffer: Vec<u8>,
    consumed: usize,
}

impl Delimited {
    /// Adds bytes as they arrive.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.consumed > 0 {
            self.buffer.drain(..self.consumed);
            self.consumed = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole frame, `None` until more bytes arrive.
    ///
    /// # Errors
    /// [`DecodeError::Oversized`] or [`DecodeError::Malformed`]; the stream cannot be resumed after.
    pub fn next_frame(&mut self) -> Result<Option<CommandFrame>, DecodeError> {
        let pending = self.buffer.get(self.consumed..).unwrap_or_default();
        let Some((length, rest)) = pending.split_first_chunk::<4>() else {
            return Ok(None);
        };
        let length = u32::from_le_bytes(*length) as usize;
        if length > MAX_COMMAND_FRAME {
            return Err(DecodeError::Oversized { length, limit: MAX_COMMAND_FRAME });
        }
        let Some(body) = rest.get(..length) else {
            return Ok(None);
        };
        let frame = CommandFrame::decode(body)
            .map_err(|e| DecodeError::Malformed { message: "plumbline.v1.CommandFrame", reason: e.to_string() })?;
        self.consumed += 4 + length;
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::{self, command_frame::Body};

    fn height(sequence: u64) -> Vec<u8> {
        let mut out = Vec::new();
        let message = v1::HeightSample { time_us: 5, sensed_m: 0.812, ..Default::default() };
        encode_message(&mut out, Kind::Height, 2, sequence, 5, &message);
        out
    }

    #[test]
    fn frames_round_trip_and_unknown_kinds_survive() {
        let mut batch = Vec::new();
        begin_batch(&mut batch);
        batch.extend(height(7));
        let unknown = Frame { kind: 9999, instance: 1, sequence: 8, time_us: 6, payload: b"new" };
        unknown.encode(&mut batch);
        let frames: Vec<_> = decode_batch(&batch).unwrap().map(Result::unwrap).collect();
        assert_eq!(frames.len(), 2);
        assert_eq!(frames[0].known_kind(), Some(Kind::Height));
        assert_eq!(frames[0].message::<v1::HeightSample>().unwrap().sensed_m, 0.812);
        assert_eq!((frames[1], frames[1].known_kind()), (unknown, None));
        let parsed = Batch::parse(Bytes::copy_from_slice(&batch)).unwrap();
        assert_eq!(parsed.frames().collect::<Vec<_>>(), frames);
        assert!(parsed.wire_len() == batch.len() && parsed.held_bytes() > batch.len());
    }

    #[test]
    fn every_truncation_is_an_error_and_keeps_the_frames_before() {
        let mut batch = Vec::new();
        begin_batch(&mut batch);
        batch.extend(height(1));
        let whole = batch.len();
        batch.extend(height(2));
        for cut in whole + 1..batch.len() {
            assert!(Batch::parse(Bytes::copy_from_slice(&batch[..cut])).is_err());
            let results: Vec<_> = decode_batch(&batch[..cut]).unwrap().collect();
            assert_eq!(results.len(), 2);
            assert!(results[0].is_ok());
            assert!(matches!(results[1], Err(DecodeError::Truncated { .. })));
        }
    }

    #[test]
    fn wrong_magic_schema_and_lengths_are_named() {
        assert_eq!(
            decode_batch(b"\x51\x01").unwrap_err().to_string(),
            "not a Plumbline batch: first byte 0x51, expected 0x50"
        );
        assert_eq!(decode_batch(&[MAGIC, 99]).unwrap_err(), DecodeError::Schema { found: 99, expected: SCHEMA });
        let mut batch = vec![MAGIC, SCHEMA];
        begin_frame(&mut batch, 1, 1, 1, 1, MAX_PAYLOAD + 1);
        let error = decode_batch(&batch).unwrap().next().unwrap().unwrap_err();
        assert_eq!(error, DecodeError::Oversized { length: MAX_PAYLOAD + 1, limit: MAX_PAYLOAD });
    }

    #[test]
    fn delimited_frames_come_back_whatever_the_chunks() {
        let frame =
            CommandFrame { body: Some(Body::Heartbeat(v1::Heartbeat { ground_time_us: 42, agent_time_us: None })) };
        let mut bytes = Vec::new();
        encode_delimited(&mut bytes, &frame);
        encode_delimited(&mut bytes, &frame);
        for chunk in 1..bytes.len() {
            let mut decoder = Delimited::default();
            let mut found = 0;
            for piece in bytes.chunks(chunk) {
                decoder.push(piece);
                while let Some(got) = decoder.next_frame().unwrap() {
                    assert_eq!(got, frame);
                    found += 1;
                }
            }
            assert_eq!(found, 2);
        }
    }
}
