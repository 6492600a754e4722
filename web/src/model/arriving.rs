//! How far a recording is while it arrives: frames come in the order of their times, and nobody says how many there are.

use plumbline_proto::codec::{BATCH_HEADER, decode_frames};

/// What of an answer has been looked at.
#[derive(Debug, Default)]
pub struct Arriving {
    /// Bytes whose frames are known.
    read: usize,
    begin_us: Option<u64>,
    newest_us: u64,
}

impl Arriving {
    /// Looks at an answer that has come so far as `bytes`: what it covers of the flight, s.
    pub fn covered_s(&mut self, bytes: &[u8]) -> f64 {
        self.read = self.read.max(BATCH_HEADER);
        let rest = bytes.get(self.read..).unwrap_or_default();
        // The last frame may be here in part.
        for frame in decode_frames(rest).map_while(Result::ok) {
            self.read += frame.encoded_len();
            self.begin_us.get_or_insert(frame.time_us);
            self.newest_us = self.newest_us.max(frame.time_us);
        }
        self.newest_us.saturating_sub(self.begin_us.unwrap_or(self.newest_us)) as f64 * 1e-6
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::{Kind, codec, v1};

    use super::*;

    #[test]
    fn what_has_come_is_counted_once_and_half_a_frame_not_yet() {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        let mut ends = Vec::new();
        for second in 10..14_u64 {
            let truth = v1::Truth { time_us: second * 1_000_000, ..Default::default() };
            codec::encode_message(&mut batch, Kind::Truth, 0, second, second * 1_000_000, &truth);
            ends.push(batch.len());
        }
        let mut arriving = Arriving::default();
        let covered = [1, ends[0], ends[1] + 5, ends[2] - 1, ends[2], ends[3]].map(|n| arriving.covered_s(&batch[..n]));
        assert_eq!(covered, [0.0, 0.0, 1.0, 1.0, 2.0, 3.0]);
        assert_eq!(arriving.read, batch.len());
    }
}
