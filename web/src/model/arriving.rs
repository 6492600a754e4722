//! A recording, read while it arrives: frames come in the order of their times, and nobody says how many there are. Its bytes are let
//! go as they are read: those of an hour would not fit into the memory of a page.

use plumbline_proto::{
    DecodeError,
    codec::{BATCH_HEADER, decode_batch, decode_frames},
};

use super::live::Live;

/// What of a recording has been read.
#[derive(Debug)]
pub struct Arriving {
    flight: Live,
    /// Is the head of the batch behind?
    begun: bool,
    /// Bytes that are no whole frame yet.
    rest: Vec<u8>,
    begin_us: Option<u64>,
    newest_us: u64,
}

impl Default for Arriving {
    fn default() -> Self {
        Self { flight: Live::recorded(), begun: false, rest: Vec::new(), begin_us: None, newest_us: 0 }
    }
}

impl Arriving {
    /// Reads the next piece of the answer: what all of them cover of the flight, s.
    ///
    /// # Errors
    /// When it is no batch of this schema.
    pub fn take(&mut self, piece: &[u8]) -> Result<f64, DecodeError> {
        self.rest.extend_from_slice(piece);
        let (frames, mut read) = match self.begun {
            true => (decode_frames(&self.rest), 0),
            false if self.rest.len() < BATCH_HEADER => return Ok(0.0),
            false => (decode_batch(&self.rest)?, BATCH_HEADER),
        };
        self.begun = true;
        for frame in frames {
            let frame = match frame {
                Ok(frame) => frame,
                // It is here in part.
                Err(DecodeError::Truncated { .. }) => break,
                Err(error) => return Err(error),
            };
            read += frame.encoded_len();
            self.begin_us.get_or_insert(frame.time_us);
            self.newest_us = self.newest_us.max(frame.time_us);
            self.flight.frame(&frame, 0.0);
        }
        self.rest.drain(..read);
        Ok(self.newest_us.saturating_sub(self.begin_us.unwrap_or(self.newest_us)) as f64 * 1e-6)
    }

    /// The flight, when the answer is over.
    ///
    /// # Errors
    /// When it ended within a frame.
    pub fn flight(self) -> Result<Live, DecodeError> {
        let mut left = if self.begun { decode_frames(&self.rest) } else { decode_batch(&self.rest)? };
        match left.next().and_then(Result::err) {
            Some(error) => Err(error),
            None => Ok(self.flight),
        }
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::{Kind, codec, v1};

    use super::*;
    use crate::model::curves::Curve;

    #[test]
    fn what_has_come_is_read_once_and_half_a_frame_not_yet_and_no_byte_is_kept() {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        let mut ends = Vec::new();
        for second in 10..14_u64 {
            let position = v1::Vector3 { z: second as f64, ..Default::default() };
            let truth = v1::Truth { time_us: second * 1_000_000, position_enu_m: Some(position), ..Default::default() };
            codec::encode_message(&mut batch, Kind::Truth, 0, second, second * 1_000_000, &truth);
            ends.push(batch.len());
        }
        let mut arriving = Arriving::default();
        let mut begin = 0;
        let covered = [1, ends[0], ends[1] + 5, ends[2] - 1, ends[2], ends[3]].map(|end| {
            let piece = &batch[std::mem::replace(&mut begin, end)..end];
            arriving.take(piece).unwrap()
        });
        assert_eq!(covered, [0.0, 0.0, 1.0, 1.0, 2.0, 3.0]);
        assert!(arriving.rest.is_empty());
        let flight = arriving.flight().unwrap();
        assert_eq!(flight.curves.len(Curve::TruthAltitude), 4);
        assert_eq!(flight.curves.value_at(Curve::TruthAltitude, 12.5), Some(12.0));
    }

    #[test]
    fn an_answer_that_is_none_and_one_that_breaks_off_are_refused() {
        assert!(Arriving::default().take(b"\x50\x63").unwrap_err().to_string().contains("schema 99"));
        assert!(matches!(Arriving::default().flight(), Err(DecodeError::Truncated { .. })));
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        codec::encode_message(&mut batch, Kind::Truth, 0, 1, 1, &v1::Truth { time_us: 1, ..Default::default() });
        let mut arriving = Arriving::default();
        arriving.take(&batch[..batch.len() - 1]).unwrap();
        assert!(matches!(arriving.flight(), Err(DecodeError::Truncated { .. })));
    }
}
