//! What a page shows live, thinned as it comes: some 80 kB a second of a vehicle whose telemetry is 500.
//!
//! Of what a tick of the vehicle makes anew (estimates, control, truth) a page is sent the first in each stretch of
//! flight time, at once; of residuals, the worst of each scalar in each; of sensors only the heights, for it shows no
//! others, nor whole scans. Stretches of estimators that are not in the loop are longer. What is rarer comes whole. Where the stream stands
//! still the last comes, too, after [`LAST_AFTER`].

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use plumbline_proto::codec::Frame;
use plumbline_proto::thinning::Worst;
use plumbline_proto::{Kind, v1};

use super::vehicle::MAX_TOPICS;

/// Charts have a pixel every 40 ms and more.
const STRETCH_US: u64 = 25_000;
/// Truth is a curve behind the estimate's.
const TRUTH_US: u64 = 50_000;
/// Bars and numbers of residuals are read, not followed.
const RESIDUALS_US: u64 = 125_000;
/// Estimators that are not in the loop are glanced at.
const OTHERS: u64 = 5;
/// Older than anything that waits while messages come.
const LAST_AFTER: Duration = Duration::from_millis(150);

/// One vehicle's, for all of its viewers.
#[derive(Debug, Default)]
pub(super) struct Thinned {
    /// The estimator in the loop.
    in_loop: u16,
    newest: BTreeMap<(u16, u16), Newest>,
    worst: BTreeMap<u16, (Instant, Option<Worst>)>,
}

#[derive(Debug)]
struct Newest {
    /// That it was sent of last.
    stretch: u64,
    /// Not sent, and since when; empty for none.
    held: Vec<u8>,
    since: Instant,
}

impl Thinned {
    /// The next frame; what is to be sent of it, and of those before, is appended to `out`.
    pub(super) fn take(&mut self, frame: &Frame<'_>, now: Instant, out: &mut Vec<u8>) {
        let times = if frame.instance == self.in_loop { 1 } else { OTHERS };
        match frame.known_kind() {
            Some(Kind::Estimate) => self.newest(frame, STRETCH_US * times, now, out),
            Some(Kind::Control) => self.newest(frame, STRETCH_US, now, out),
            Some(Kind::Truth) => self.newest(frame, TRUTH_US, now, out),
            Some(Kind::Residuals) if self.worst.len() < MAX_TOPICS || self.worst.contains_key(&frame.instance) => {
                let (since, worst) = self.worst.entry(frame.instance).or_insert((now, None));
                *since = now;
                Worst::take(worst, frame.time_us / (RESIDUALS_US * times), frame, out);
            }
            Some(Kind::Scan) => {}
            Some(kind) if kind.is_sensor() && kind != Kind::Height => {}
            kind => {
                if kind == Some(Kind::Status)
                    && let Ok(status) = frame.message::<v1::Status>()
                {
                    self.in_loop = status.estimator_in_loop as u16;
                }
                frame.encode(out);
            }
        }
    }

    fn newest(&mut self, frame: &Frame<'_>, width_us: u64, now: Instant, out: &mut Vec<u8>) {
        let stretch = frame.time_us / width_us;
        let key = (frame.kind, frame.instance);
        if self.newest.len() >= MAX_TOPICS && !self.newest.contains_key(&key) {
            frame.encode(out);
            return;
        }
        let first = || Newest { stretch: stretch.wrapping_add(1), held: Vec::new(), since: now };
        let newest = self.newest.entry(key).or_insert_with(first);
        newest.held.clear();
        newest.since = now;
        if newest.stretch == stretch {
            frame.encode(&mut newest.held);
        } else {
            newest.stretch = stretch;
            frame.encode(out);
        }
    }

    /// Appends to `out` what nothing newer has come after for a while.
    pub(super) fn last(&mut self, now: Instant, out: &mut Vec<u8>) {
        let over = |since: Instant| now.saturating_duration_since(since) >= LAST_AFTER;
        for newest in self.newest.values_mut().filter(|newest| over(newest.since)) {
            out.append(&mut newest.held);
        }
        for (estimator, (since, worst)) in &mut self.worst {
            if let Some(worst) = worst.take_if(|_| over(*since)) {
                worst.write(*estimator, out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::codec;

    use super::*;

    const TICK_US: u64 = 5_000;

    fn take(thinned: &mut Thinned, kind: Kind, tick: u64, now: Instant, message: &impl prost::Message) -> Vec<u64> {
        let (mut frame, mut out) = (Vec::new(), Vec::new());
        codec::encode_message(&mut frame, kind, 1, tick + 1, tick * TICK_US, message);
        let frame = codec::decode_frames(&frame).next().unwrap().unwrap();
        thinned.take(&frame, now, &mut out);
        sequences(&out)
    }

    fn sequences(frames: &[u8]) -> Vec<u64> {
        codec::decode_frames(frames).map(|frame| frame.unwrap().sequence).collect()
    }

    #[test]
    fn the_first_of_each_stretch_comes_at_once_and_the_last_of_all_in_the_end() {
        let (mut thinned, start) = (Thinned::default(), Instant::now());
        let at = |tick: u64| start + Duration::from_micros(tick * TICK_US);
        let control = v1::Control::default();
        let sent: Vec<u64> =
            (0..9).flat_map(|tick| take(&mut thinned, Kind::Control, tick, at(tick), &control)).collect();
        assert_eq!(sent, [1, 6]);
        let last = |thinned: &mut Thinned, now| {
            let mut out = Vec::new();
            thinned.last(now, &mut out);
            sequences(&out)
        };
        assert!(last(&mut thinned, at(8)).is_empty());
        assert_eq!(last(&mut thinned, at(8) + LAST_AFTER), [9]);
        assert!(last(&mut thinned, at(8) + 2 * LAST_AFTER).is_empty(), "once");
        // A recording that is flown again, one tick at a time.
        assert!(take(&mut thinned, Kind::Control, 9, at(100), &control).is_empty());
        assert_eq!(last(&mut thinned, at(100) + LAST_AFTER), [10]);
    }

    #[test]
    fn estimators_that_are_not_in_the_loop_come_less_often() {
        let (mut thinned, now) = (Thinned::default(), Instant::now());
        let mut sent = |in_loop| {
            let status = v1::Status { estimator_in_loop: in_loop, ..Default::default() };
            take(&mut thinned, Kind::Status, 0, now, &status);
            let estimate = v1::Estimate::default();
            (0..40).flat_map(|tick| take(&mut thinned, Kind::Estimate, tick, now, &estimate)).count()
        };
        assert_eq!((sent(2), sent(1)), (2, 8));
    }

    #[test]
    fn the_worst_residuals_come_and_of_sensors_the_heights_and_what_is_rare_or_unknown_whole() {
        let (mut thinned, now) = (Thinned::default(), Instant::now());
        let residuals = |ratio| v1::Residuals {
            residuals: vec![v1::Residual { sensor: 2, instance: 1, ratio, ..Default::default() }],
            ..Default::default()
        };
        let status = v1::Status { estimator_in_loop: 1, ..Default::default() };
        assert_eq!(take(&mut thinned, Kind::Status, 0, now, &status), [1]);
        let ratios = [0.1, 2.0, 0.3];
        for (tick, ratio) in (0..).zip(ratios) {
            assert!(take(&mut thinned, Kind::Residuals, tick, now, &residuals(ratio)).is_empty());
        }
        let (mut frame, mut out) = (Vec::new(), Vec::new());
        codec::encode_message(&mut frame, Kind::Residuals, 1, 99, RESIDUALS_US, &residuals(0.2));
        thinned.take(&codec::decode_frames(&frame).next().unwrap().unwrap(), now, &mut out);
        let worst: v1::Residuals = codec::decode_frames(&out).next().unwrap().unwrap().message().unwrap();
        assert_eq!(worst.residuals[0].ratio, 2.0);
        out.clear();
        thinned.last(now + LAST_AFTER, &mut out);
        assert_eq!(sequences(&out), [99]);
        for tick in 0..2 {
            assert!(take(&mut thinned, Kind::Imu, tick, now, &v1::ImuSample::default()).is_empty());
            assert!(take(&mut thinned, Kind::Scan, tick, now, &v1::Scan::default()).is_empty());
            assert_eq!(take(&mut thinned, Kind::Height, tick, now, &v1::HeightSample::default()), [tick + 1]);
            assert_eq!(take(&mut thinned, Kind::Status, tick, now, &v1::Status::default()), [tick + 1]);
        }
        let unknown = Frame { kind: 60_000, instance: 0, sequence: 7, time_us: 0, payload: &[] };
        out.clear();
        thinned.take(&unknown, now, &mut out);
        assert_eq!(sequences(&out), [7]);
    }
}
