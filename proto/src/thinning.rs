//! Telemetry, thinned to what the charts of a page can show: a few megabytes where the messages themselves are hundreds.
//!
//! Of each stretch of time about as wide as a pixel, every topic that is plotted keeps two messages: the first with the
//! least of every value that a chart shows, and the last with the greatest, so that no peak is lost; a change of mode,
//! of health or of who is excluded begins a stretch of its own. Of residuals, one message with the worst of each scalar.
//! Events are kept whole; of what is sent again and again (a schedule of attacks, a step, gains, a description), the
//! last message of each. What no chart shows is left out.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::RangeInclusive;

use prost::Message;

use crate::codec::{self, Frame};
use crate::{Kind, v1};

/// Stretches of time that may be asked for.
pub const COLUMNS: RangeInclusive<u64> = 1..=10_000;
/// Residuals are by far the largest messages: their stretches are so many times as long.
const RESIDUALS: u64 = 2;

/// A message of which stretches keep the extremes.
trait Plotted: Message + Default + Clone {
    /// What begins a stretch of its own where it changes.
    type State: PartialEq;

    /// That, as it is now.
    fn state(&self) -> Self::State;

    /// What charts show of it.
    fn values(&mut self) -> impl Iterator<Item = &mut f64>;

    /// Takes away what charts do not show.
    fn strip(&mut self) {}
}

fn xyz(vector: &mut Option<v1::Vector3>) -> impl Iterator<Item = &mut f64> {
    vector.iter_mut().flat_map(|v| [&mut v.x, &mut v.y, &mut v.z])
}

fn z(vector: &mut Option<v1::Vector3>) -> Option<&mut f64> {
    vector.as_mut().map(|v| &mut v.z)
}

impl Plotted for v1::Estimate {
    type State = (bool, i32, bool, bool);

    fn state(&self) -> Self::State {
        (self.in_loop, self.health, self.altitude_known, self.horizontal_known)
    }

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        let heights = [&mut self.position_enu_m, &mut self.position_sigma_m].map(z);
        let vectors = [&mut self.velocity_enu_mps, &mut self.roll_pitch_yaw_rad, &mut self.attitude_sigma_rad].map(xyz);
        heights.into_iter().flatten().chain(vectors.into_iter().flatten())
    }

    fn strip(&mut self) {
        (self.world_from_body, self.body_rates_radps, self.velocity_sigma_mps) = (None, None, None);
        (self.accel_bias_mps2, self.gyro_bias_radps, self.step_time_us) = (None, None, 0.0);
    }
}

impl Plotted for v1::Truth {
    type State = ();

    fn state(&self) -> Self::State {}

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        let vectors = [&mut self.velocity_enu_mps, &mut self.roll_pitch_yaw_rad].map(xyz);
        z(&mut self.position_enu_m).into_iter().chain(vectors.into_iter().flatten())
    }

    fn strip(&mut self) {
        let Self { time_us, position_enu_m, velocity_enu_mps, roll_pitch_yaw_rad, .. } = std::mem::take(self);
        *self = Self { time_us, position_enu_m, velocity_enu_mps, roll_pitch_yaw_rad, ..Self::default() };
    }
}

impl Plotted for v1::Control {
    type State = (i32, bool);

    fn state(&self) -> Self::State {
        (self.mode, self.armed)
    }

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        let setpoint = self.setpoint.iter_mut();
        let setpoint =
            setpoint.flat_map(|s| [&mut s.altitude_m, &mut s.roll_rad, &mut s.pitch_rad, &mut s.yaw_rad]).flatten();
        let autopilot = self.autopilot.iter_mut().flat_map(|a| {
            let thrust = a.thrust_asked.iter_mut().chain(&mut a.thrust_target);
            xyz(&mut a.rates_asked_flu_radps).chain(xyz(&mut a.rates_target_flu_radps)).chain(thrust)
        });
        setpoint.chain(&mut self.motor_applied).chain(autopilot)
    }

    fn strip(&mut self) {
        (self.thrust_n, self.torque_flu_nm, self.battery_v) = (0.0, None, None);
        if let Some(autopilot) = &mut self.autopilot {
            autopilot.motor_output.clear();
        }
        (self.motor_command, self.integrator, self.motor_attacked) = Default::default();
    }
}

impl Plotted for v1::HeightSample {
    type State = i32;

    fn state(&self) -> Self::State {
        self.reception
    }

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        std::iter::once(&mut self.sensed_m).chain(self.received_m.as_mut())
    }
}

impl Plotted for v1::Status {
    type State = ([i32; 3], [bool; 2], u32);

    fn state(&self) -> Self::State {
        ([self.mode, self.failsafe, self.estimator_in_loop], [self.armed, self.cut_latched], self.gains_revision)
    }

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        [&mut self.tick_time_p50_us, &mut self.tick_time_p99_us, &mut self.tick_jitter_p99_us].into_iter()
    }
}

impl Plotted for v1::SecureStatus {
    /// Who is present, and who is excluded.
    type State = Vec<(bool, bool)>;

    fn state(&self) -> Self::State {
        self.sensors.iter().map(|s| (s.present, s.flagged)).collect()
    }

    fn values(&mut self) -> impl Iterator<Item = &mut f64> {
        self.sensors.iter_mut().flat_map(|s| [&mut s.window_ratio, &mut s.drift_ratio])
    }
}

/// Where a message stands among the others of its topic.
#[derive(Clone, Copy)]
struct Place {
    sequence: u64,
    time_us: u64,
}

/// What is held of one topic until it is known what is kept of it.
trait Held {
    /// The next message, in this stretch of time; what is over is written.
    fn take(&mut self, stretch: u64, frame: &Frame<'_>, out: &mut Vec<u8>);

    /// Writes what is held.
    fn write(&self, topic: (Kind, u16), out: &mut Vec<u8>);
}

/// Of a kind; `None` where nothing is ever held of it.
fn held(kind: Kind) -> Option<Box<dyn Held>> {
    Some(match kind {
        Kind::Estimate => Box::new(None::<Extremes<v1::Estimate>>),
        Kind::Truth => Box::new(None::<Extremes<v1::Truth>>),
        Kind::Control => Box::new(None::<Extremes<v1::Control>>),
        Kind::Height => Box::new(None::<Extremes<v1::HeightSample>>),
        Kind::Status => Box::new(None::<Extremes<v1::Status>>),
        Kind::Secure => Box::new(None::<Extremes<v1::SecureStatus>>),
        Kind::Residuals => Box::new(None::<Worst>),
        Kind::Attacks | Kind::StepResponse | Kind::Description | Kind::Gains => Box::new(None::<Last>),
        _ => return None,
    })
}

/// What is held of the stretch that a topic is in.
struct Extremes<M: Plotted> {
    number: u64,
    state: M::State,
    /// How many values its messages have.
    values: usize,
    least: (Place, M),
    greatest: (Place, M),
}

impl<M: Plotted> Held for Option<Extremes<M>> {
    fn take(&mut self, number: u64, frame: &Frame<'_>, out: &mut Vec<u8>) {
        let (Some(kind), Ok(mut message)) = (frame.known_kind(), frame.message::<M>()) else { return };
        message.strip();
        let (state, values) = (message.state(), message.values().count());
        let place = Place { sequence: frame.sequence, time_us: frame.time_us };
        match self {
            Some(held) if held.number == number && held.values == values && held.state == state => {
                for (least, value) in held.least.1.values().zip(message.values()) {
                    *least = least.min(*value);
                }
                for (greatest, value) in held.greatest.1.values().zip(message.values()) {
                    *value = greatest.max(*value);
                }
                held.greatest = (place, message);
            }
            over => {
                over.write((kind, frame.instance), out);
                let (least, greatest) = ((place, message.clone()), (place, message));
                *over = Some(Extremes { number, state, values, least, greatest });
            }
        }
    }

    fn write(&self, (kind, instance): (Kind, u16), out: &mut Vec<u8>) {
        let Some(held) = self else { return };
        let mut put = |(place, message): &(Place, M)| {
            codec::encode_message(out, kind, instance, place.sequence, place.time_us, message);
        };
        put(&held.least);
        if held.greatest.0.sequence != held.least.0.sequence {
            put(&held.greatest);
        }
    }
}

/// The worst residuals of the stretch that an estimator is in.
#[derive(Debug)]
pub struct Worst {
    stretch: u64,
    sequence: u64,
    residuals: v1::Residuals,
}

impl Worst {
    /// The estimator's next residuals, in this stretch of time; those of a stretch that is over are appended to `out`.
    pub fn take(held: &mut Option<Self>, stretch: u64, frame: &Frame<'_>, out: &mut Vec<u8>) {
        let Ok(more) = frame.message::<v1::Residuals>() else { return };
        match held {
            Some(held) if held.stretch == stretch => held.add(frame.sequence, more),
            over => {
                if let Some(over) = over {
                    over.write(frame.instance, out);
                }
                *over = Some(Self { stretch, sequence: frame.sequence, residuals: more });
            }
        }
    }

    fn add(&mut self, sequence: u64, more: v1::Residuals) {
        (self.sequence, self.residuals.time_us) = (sequence, more.time_us);
        for new in more.residuals {
            let known = self.residuals.residuals.iter_mut();
            let of = |r: &v1::Residual| (r.sensor, r.instance, r.channel);
            match { known }.find(|r| of(r) == of(&new)) {
                Some(known) if known.ratio >= new.ratio => {}
                Some(known) => *known = new,
                None => self.residuals.residuals.push(new),
            }
        }
    }

    /// Appends them to `out`, as a frame of estimator `instance`.
    pub fn write(&self, instance: u16, out: &mut Vec<u8>) {
        codec::encode_message(out, Kind::Residuals, instance, self.sequence, self.residuals.time_us, &self.residuals);
    }
}

impl Held for Option<Worst> {
    fn take(&mut self, stretch: u64, frame: &Frame<'_>, out: &mut Vec<u8>) {
        Worst::take(self, stretch / RESIDUALS, frame, out);
    }

    fn write(&self, (_, instance): (Kind, u16), out: &mut Vec<u8>) {
        if let Some(held) = self {
            held.write(instance, out);
        }
    }
}

/// The last of the messages that follow each other with one number.
struct Last {
    number: u64,
    place: Place,
    payload: Vec<u8>,
}

impl Held for Option<Last> {
    fn take(&mut self, _: u64, frame: &Frame<'_>, out: &mut Vec<u8>) {
        let Some((kind, number)) = frame.known_kind().and_then(|kind| Some((kind, number(kind, frame)?))) else {
            return;
        };
        if self.as_ref().is_some_and(|held| held.number != number) {
            self.write((kind, frame.instance), out);
        }
        let place = Place { sequence: frame.sequence, time_us: frame.time_us };
        *self = Some(Last { number, place, payload: frame.payload.to_vec() });
    }

    fn write(&self, (kind, instance): (Kind, u16), out: &mut Vec<u8>) {
        let Some(Last { place: Place { sequence, time_us }, payload, .. }) = self else { return };
        Frame { kind: kind.to_wire(), instance, sequence: *sequence, time_us: *time_us, payload }.encode(out);
    }
}

/// Which of the messages that are sent again and again one is of.
fn number(kind: Kind, frame: &Frame<'_>) -> Option<u64> {
    Some(match kind {
        Kind::Attacks => frame.message::<v1::AttackState>().ok()?.schedule_id.into(),
        Kind::StepResponse => frame.message::<v1::StepResponse>().ok()?.start_time_us,
        Kind::Gains => frame.message::<v1::GainsInUse>().ok()?.revision.into(),
        _ => 0,
    })
}

/// Thins messages that come in the order of time.
pub struct Thinner {
    width_us: u64,
    held: BTreeMap<(u16, u16), (Kind, Box<dyn Held>)>,
}

impl Thinner {
    /// For `columns` stretches of `span_us` together, µs.
    pub fn new(span_us: u64, columns: u64) -> Self {
        Self { width_us: (span_us / columns.max(1)).max(1), held: BTreeMap::new() }
    }

    /// The next message; what is kept of those before it is appended to `out`, as frames.
    pub fn take(&mut self, frame: &Frame<'_>, out: &mut Vec<u8>) {
        let Some(kind) = frame.known_kind() else { return };
        if kind == Kind::Event {
            frame.encode(out);
            return;
        }
        let (_, held) = match self.held.entry((frame.kind, frame.instance)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => match held(kind) {
                Some(held) => new.insert((kind, held)),
                None => return,
            },
        };
        held.take(frame.time_us / self.width_us, frame, out);
    }

    /// What is held at the end.
    pub fn finish(self, out: &mut Vec<u8>) {
        self.held.iter().for_each(|((_, instance), (kind, held))| held.write((*kind, *instance), out));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one<M: Message>(kind: Kind, sequence: u64, time_us: u64, message: &M) -> Vec<u8> {
        let mut frame = Vec::new();
        codec::encode_message(&mut frame, kind, 1, sequence, time_us, message);
        frame
    }

    /// A batch of what is kept of `all`, in stretches of `seconds` / 480.
    fn thin(all: &[Vec<u8>], seconds: u64) -> Vec<u8> {
        let mut out = Vec::new();
        codec::begin_batch(&mut out);
        let mut thinner = Thinner::new(seconds * 1_000_000, 480);
        all.iter().flat_map(|bytes| codec::decode_frames(bytes)).for_each(|f| thinner.take(&f.unwrap(), &mut out));
        thinner.finish(&mut out);
        out
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
            batches.push(one(Kind::Height, 2 * n + 1, n * 10_000, &sample));
            batches.push(one(Kind::Imu, 2 * n + 2, n * 10_000, &v1::ImuSample::default()));
        }
        let thinned = thin(&batches, 120);
        let heights = frames(&thinned, Kind::Height);
        assert!((900..=962).contains(&heights.len()), "{} heights", heights.len());
        assert!(heights.is_sorted_by_key(|frame| frame.sequence), "each topic in order");
        let peak = |frame: &Frame<'_>| frame.message::<v1::HeightSample>().unwrap().sensed_m == 3.0;
        let peaks: Vec<_> = heights.iter().filter(|frame| peak(frame)).map(|frame| frame.time_us / 250_000).collect();
        assert_eq!(peaks, [70_030_000 / 250_000], "the one peak, in its stretch");
        assert_eq!(heights.last().unwrap().time_us / 250_000, 11_999 * 10_000 / 250_000);
        assert!(frames(&thinned, Kind::Imu).is_empty(), "no chart shows them");
    }

    #[test]
    fn the_worst_of_each_scalar_stays() {
        let residual = |instance, ratio| v1::Residual { sensor: 2, instance, ratio, ..Default::default() };
        let tick = |n: u64, ratios: [f64; 2]| {
            let residuals = vec![residual(1, ratios[0]), residual(2, ratios[1])];
            one(Kind::Residuals, n, n, &v1::Residuals { time_us: n, estimator: 1, residuals })
        };
        let batches = [tick(1, [0.1, 0.9]), tick(2, [0.8, 0.1]), tick(3, [0.2, 0.2])];
        let thinned = thin(&batches, 60);
        let kept = frames(&thinned, Kind::Residuals);
        assert_eq!(kept.len(), 1);
        let only = kept[0];
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
            one(Kind::StepResponse, n, n, &step)
        };
        let event = |n: u64| one(Kind::Event, n, n, &v1::Event { time_us: n, ..Default::default() });
        let batches = [step(1, 1), step(2, 1), event(3), step(4, 4), event(5), step(6, 4), event(7)];
        let thinned = thin(&batches, 30);
        let sequences = |kind| frames(&thinned, kind).iter().map(|frame| frame.sequence).collect::<Vec<_>>();
        assert_eq!(sequences(Kind::Event), [3, 5, 7]);
        assert_eq!(sequences(Kind::StepResponse), [2, 6]);
        assert_eq!(thin(&[], 30).len(), codec::BATCH_HEADER);
    }

    #[test]
    fn each_value_has_its_own_extremes() {
        let estimate = |n: u64, altitude_m: f64, roll_rad: f64| {
            let position_enu_m = Some(v1::Vector3 { x: n as f64, y: 0.0, z: altitude_m });
            let roll_pitch_yaw_rad = Some(v1::Vector3 { x: roll_rad, y: 0.0, z: 0.0 });
            let estimate = v1::Estimate { time_us: n, position_enu_m, roll_pitch_yaw_rad, ..Default::default() };
            one(Kind::Estimate, n, n, &estimate)
        };
        let thinned = thin(&[estimate(1, 0.5, 0.1), estimate(2, 0.7, -0.2), estimate(3, 0.6, 0.0)], 60);
        let kept: Vec<v1::Estimate> = frames(&thinned, Kind::Estimate).iter().map(|f| f.message().unwrap()).collect();
        let told = |e: &v1::Estimate| {
            (e.time_us, e.position_enu_m.unwrap().x, e.position_enu_m.unwrap().z, e.roll_pitch_yaw_rad.unwrap().x)
        };
        assert_eq!(kept.iter().map(told).collect::<Vec<_>>(), [(1, 1.0, 0.5, -0.2), (3, 3.0, 0.7, 0.1)]);
    }

    #[test]
    fn a_change_of_mode_keeps_its_time_however_brief_it_was() {
        let status = |n: u64, mode: v1::Mode| {
            one(Kind::Status, n, n, &v1::Status { time_us: n, mode: mode.into(), ..Default::default() })
        };
        let modes = [v1::Mode::AltitudeHold, v1::Mode::AltitudeHold, v1::Mode::Land, v1::Mode::AltitudeHold];
        let all: Vec<_> = (1..).zip(modes).map(|(n, mode)| status(n, mode)).collect();
        let thinned = thin(&all, 60);
        let sequences: Vec<_> = frames(&thinned, Kind::Status).iter().map(|frame| frame.sequence).collect();
        assert_eq!(sequences, [1, 2, 3, 4]);
    }
}
