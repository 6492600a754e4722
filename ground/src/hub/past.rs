//! The history of a vehicle, thinned to what the charts of a page can show: a few megabytes where the messages
//! themselves are fifty.
//!
//! Every topic that is plotted keeps, of each stretch of time about as wide as a pixel, the messages with the least
//! and the greatest value of the figure it is plotted by, so that no peak of that is lost; of residuals, the worst of
//! each scalar, put together into one message. Events are kept whole; of a
//! schedule of attacks and of a step, which are sent again and again while they go on, the last message. What the
//! newest state repeats (description, gains) and what no chart shows is left out.

use std::collections::BTreeMap;

use plumbline_proto::codec::{self, Frame};
use plumbline_proto::{Kind, v1};

use super::viewer::Shared;

/// Stretches of time kept of one topic: charts are some 700 pixels wide.
const COLUMNS: u64 = 480;
/// Residuals are by far the largest messages.
const RESIDUAL_COLUMNS: u64 = 240;

/// What becomes of a topic's messages.
enum Policy {
    /// Kept.
    Every,
    /// The last of those that follow each other with this number.
    LastOf(u64),
    /// Least and greatest of each stretch, by this figure.
    Extremes(f64),
    /// One message for each stretch, with the worst of each scalar.
    Worst(v1::Residuals),
    /// Left out.
    None,
}

fn policy(kind: Kind, frame: &Frame<'_>) -> Option<Policy> {
    Some(match kind {
        Kind::Event => Policy::Every,
        Kind::Attacks => Policy::LastOf(frame.message::<v1::AttackState>().ok()?.schedule_id.into()),
        Kind::StepResponse => Policy::LastOf(frame.message::<v1::StepResponse>().ok()?.start_time_us),
        Kind::Height => {
            let sample: v1::HeightSample = frame.message().ok()?;
            Policy::Extremes(sample.received_m.unwrap_or(sample.sensed_m))
        }
        Kind::Estimate => Policy::Extremes(frame.message::<v1::Estimate>().ok()?.position_enu_m.map_or(0.0, |p| p.z)),
        Kind::Truth => Policy::Extremes(frame.message::<v1::Truth>().ok()?.position_enu_m.map_or(0.0, |p| p.z)),
        Kind::Control => {
            let setpoint = frame.message::<v1::Control>().ok()?.setpoint;
            Policy::Extremes(setpoint.and_then(|s| s.altitude_m).unwrap_or(0.0))
        }
        Kind::Status => Policy::Extremes(frame.message::<v1::Status>().ok()?.tick_time_p99_us),
        Kind::Secure => {
            let sensors = frame.message::<v1::SecureStatus>().ok()?.sensors;
            Policy::Extremes(sensors.iter().map(|s| s.window_ratio.max(s.drift_ratio)).fold(0.0, f64::max))
        }
        Kind::Residuals => Policy::Worst(frame.message().ok()?),
        _ => Policy::None,
    })
}

/// What is held of the stretch that a topic is in.
struct Stretch<'a> {
    number: u64,
    least: (f64, Frame<'a>),
    greatest: (f64, Frame<'a>),
}

impl<'a> Stretch<'a> {
    fn new(number: u64, figure: f64, frame: Frame<'a>) -> Self {
        Self { number, least: (figure, frame), greatest: (figure, frame) }
    }

    fn take(&mut self, figure: f64, frame: Frame<'a>) {
        if figure > self.greatest.0 {
            self.greatest = (figure, frame);
        }
        if figure < self.least.0 {
            self.least = (figure, frame);
        }
    }

    /// In the order they came.
    fn write(&self, out: &mut Vec<u8>) {
        let (least, greatest) = (self.least.1, self.greatest.1);
        let [first, second] = if least.sequence < greatest.sequence { [least, greatest] } else { [greatest, least] };
        first.encode(out);
        if second.sequence != first.sequence {
            second.encode(out);
        }
    }
}

/// The worst residuals of the stretch that an estimator is in.
struct Worst {
    number: u64,
    instance: u16,
    sequence: u64,
    residuals: v1::Residuals,
}

impl Worst {
    fn new(number: u64, frame: &Frame<'_>, residuals: v1::Residuals) -> Self {
        Self { number, instance: frame.instance, sequence: frame.sequence, residuals }
    }

    fn take(&mut self, frame: &Frame<'_>, more: v1::Residuals) {
        (self.sequence, self.residuals.time_us) = (frame.sequence, more.time_us);
        for new in more.residuals {
            let same =
                |r: &&mut v1::Residual| (r.sensor, r.instance, r.channel) == (new.sensor, new.instance, new.channel);
            match self.residuals.residuals.iter_mut().find(same) {
                Some(held) if held.ratio >= new.ratio => {}
                Some(held) => *held = new,
                None => self.residuals.residuals.push(new),
            }
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        let (time_us, message) = (self.residuals.time_us, &self.residuals);
        codec::encode_message(out, Kind::Residuals, self.instance, self.sequence, time_us, message);
    }
}

/// One batch with what charts show of `batches`, which are of the last `seconds`; each topic in the order of time.
pub fn thin(batches: &[Shared], seconds: u64) -> Vec<u8> {
    let width_us = |columns: u64| (seconds.max(1) * 1_000_000 / columns).max(1);
    let mut out = Vec::new();
    codec::begin_batch(&mut out);
    let mut stretches: BTreeMap<(u16, u16), Stretch<'_>> = BTreeMap::new();
    let mut worst: BTreeMap<u16, Worst> = BTreeMap::new();
    let mut last_of: BTreeMap<u16, (u64, Frame<'_>)> = BTreeMap::new();
    let frames = batches.iter().filter_map(|shared| codec::decode_batch(&shared.batch).ok()).flatten();
    for frame in frames.map_while(Result::ok) {
        let Some(policy) = frame.known_kind().and_then(|kind| policy(kind, &frame)) else { continue };
        match policy {
            Policy::None => {}
            Policy::Every => frame.encode(&mut out),
            Policy::LastOf(number) => match last_of.insert(frame.kind, (number, frame)) {
                Some((before, ended)) if before != number => ended.encode(&mut out),
                _ => {}
            },
            Policy::Extremes(figure) => {
                let number = frame.time_us / width_us(COLUMNS);
                match stretches.get_mut(&(frame.kind, frame.instance)) {
                    Some(stretch) if stretch.number == number => stretch.take(figure, frame),
                    held => {
                        held.iter().for_each(|ended| ended.write(&mut out));
                        stretches.insert((frame.kind, frame.instance), Stretch::new(number, figure, frame));
                    }
                }
            }
            Policy::Worst(residuals) => {
                let number = frame.time_us / width_us(RESIDUAL_COLUMNS);
                match worst.get_mut(&frame.instance) {
                    Some(held) if held.number == number => held.take(&frame, residuals),
                    held => {
                        held.iter().for_each(|ended| ended.write(&mut out));
                        worst.insert(frame.instance, Worst::new(number, &frame, residuals));
                    }
                }
            }
        }
    }
    stretches.values().for_each(|stretch| stretch.write(&mut out));
    worst.values().for_each(|worst| worst.write(&mut out));
    last_of.values().for_each(|(_, frame)| frame.encode(&mut out));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::Message;

    fn shared<M: Message>(kind: Kind, sequence: u64, time_us: u64, message: &M) -> Shared {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        codec::encode_message(&mut batch, kind, 1, sequence, time_us, message);
        Shared { batch: batch.into(), messages: 1 }
    }

    fn frames(batch: &[u8], kind: Kind) -> Vec<Frame<'_>> {
        let all = codec::decode_batch(batch).unwrap().map(Result::unwrap);
        all.filter(|frame| frame.known_kind() == Some(kind)).collect()
    }

    #[test]
    fn two_minutes_are_thinned_and_no_peak_is_lost() {
        let mut batches = Vec::new();
        for n in 0..12_000_u64 {
            let height_m = if n == 7003 { 3.0 } else { 0.5 + 1e-4 * (n % 7) as f64 };
            let sample = v1::HeightSample { time_us: n * 10_000, sensed_m: height_m, ..Default::default() };
            batches.push(shared(Kind::Height, 2 * n + 1, n * 10_000, &sample));
            batches.push(shared(Kind::Imu, 2 * n + 2, n * 10_000, &v1::ImuSample::default()));
        }
        let thinned = thin(&batches, 120);
        let heights = frames(&thinned, Kind::Height);
        assert!((900..=962).contains(&heights.len()), "{} heights", heights.len());
        assert!(heights.is_sorted_by_key(|frame| frame.sequence), "each topic in order");
        assert!(heights.iter().any(|frame| frame.sequence == 2 * 7003 + 1), "the one peak");
        assert_eq!(heights.last().unwrap().time_us / 250_000, 11_999 * 10_000 / 250_000);
        assert!(frames(&thinned, Kind::Imu).is_empty(), "no chart shows them");
    }

    #[test]
    fn the_worst_of_each_scalar_stays() {
        let residual = |instance, ratio| v1::Residual { sensor: 2, instance, ratio, ..Default::default() };
        let tick = |n: u64, ratios: [f64; 2]| {
            let residuals = vec![residual(1, ratios[0]), residual(2, ratios[1])];
            shared(Kind::Residuals, n, n, &v1::Residuals { time_us: n, estimator: 1, residuals })
        };
        let batches = [tick(1, [0.1, 0.9]), tick(2, [0.8, 0.1]), tick(3, [0.2, 0.2])];
        let thinned = thin(&batches, 60);
        let [only] = frames(&thinned, Kind::Residuals)[..] else { panic!("one message") };
        let ratios: Vec<f64> = only.message::<v1::Residuals>().unwrap().residuals.iter().map(|r| r.ratio).collect();
        assert_eq!((only.sequence, ratios), (3, vec![0.8, 0.9]));
    }

    #[test]
    fn what_is_slow_is_kept_whole_and_what_is_repeated_once() {
        let step = |n: u64, start: u64| {
            let step = v1::StepResponse {
                time_us: n,
                start_time_us: start,
                overshoot_percent: n as f64,
                ..Default::default()
            };
            shared(Kind::StepResponse, n, n, &step)
        };
        let event = |n: u64| shared(Kind::Event, n, n, &v1::Event { time_us: n, ..Default::default() });
        let batches = [step(1, 1), step(2, 1), event(3), step(4, 4), event(5), step(6, 4), event(7)];
        let thinned = thin(&batches, 30);
        let sequences = |kind| frames(&thinned, kind).iter().map(|frame| frame.sequence).collect::<Vec<_>>();
        assert_eq!(sequences(Kind::Event), [3, 5, 7]);
        assert_eq!(sequences(Kind::StepResponse), [2, 6]);
        assert_eq!(thin(&[], 30).len(), codec::BATCH_HEADER);
    }
}
