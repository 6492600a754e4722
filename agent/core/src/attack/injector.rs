//! Applies the active schedule to each frame. Allocates when a schedule is uploaded, never in a tick.

use arrayvec::ArrayVec;
use plumbline_proto::{ids::SensorId, time::FlightTime};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::kinds::Kind;
use super::schedule::{Attack, AttackError, Bounds, MAX_ATTACKS, Schedule, Sequence};
use crate::sensor::sample::Scalars;
use crate::sensor::{MAX_SENSORS, Registered, SensorFrame, Visitor};

/// Samples remembered per sensor: ten seconds at 200 Hz.
const HISTORY: usize = 2048;

/// Where one attack stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Waiting for its onset.
    Accepted,
    /// Altering samples.
    Active,
    /// Over.
    Done,
    /// Ended early, or before its onset.
    Aborted,
}

/// One attack's progress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// The attack.
    pub attack: Attack,
    /// Where it stands.
    pub phase: Phase,
    /// When its schedule was accepted.
    pub accepted: FlightTime,
    /// Its first sample that was really altered or withheld.
    pub active: Option<FlightTime>,
    /// When it ended.
    pub ended: Option<FlightTime>,
    /// Samples altered or withheld so far.
    pub altered_samples: u64,
}

/// Past values of one sensor, oldest first; a ring.
#[derive(Debug, Clone)]
struct History {
    samples: Vec<(FlightTime, Scalars)>,
    next: usize,
}

impl History {
    fn new() -> Self {
        Self { samples: Vec::with_capacity(HISTORY), next: 0 }
    }

    fn push(&mut self, time: FlightTime, values: Scalars) {
        if self.samples.len() < HISTORY {
            self.samples.push((time, values));
        } else if let Some(slot) = self.samples.get_mut(self.next) {
            *slot = (time, values);
        }
        self.next = (self.next + 1) % HISTORY;
    }

    fn iter(&self) -> impl DoubleEndedIterator<Item = &(FlightTime, Scalars)> {
        let start = if self.samples.len() < HISTORY { 0 } else { self.next };
        let (newer, older) = self.samples.split_at(start.min(self.samples.len()));
        older.iter().chain(newer)
    }

    /// Newest value not later than `time`.
    fn at(&self, time: FlightTime) -> Option<Scalars> {
        self.iter().rev().find(|(t, _)| *t <= time).map(|(_, values)| *values)
    }
}

/// What one attack remembers from its onset on.
#[derive(Debug, Clone)]
struct Slot {
    mask: u16,
    onset: FlightTime,
    end: FlightTime,
    rng: Xoshiro256PlusPlus,
    /// Last value before the onset (freeze).
    held: Option<Scalars>,
    /// The window before the onset (replay); room is made at upload.
    window: Vec<(FlightTime, Scalars)>,
    /// What a bias follows.
    sequence: Option<Sequence>,
}

/// The attack injector between sensing and estimation.
#[derive(Debug)]
pub struct Injector {
    bounds: Bounds,
    enabled: bool,
    sensors: Vec<SensorId>,
    independent: Vec<SensorId>,
    schedule_id: u32,
    progress: ArrayVec<Progress, MAX_ATTACKS>,
    slots: ArrayVec<Slot, MAX_ATTACKS>,
    /// One for each place of a frame, in its order.
    histories: Vec<History>,
    changes: u64,
}

impl Injector {
    /// An injector for a vehicle with these `sensors`; it refuses every schedule unless `enabled`.
    pub fn new(bounds: Bounds, enabled: bool, sensors: &[SensorId]) -> Self {
        Self {
            bounds,
            enabled,
            sensors: sensors.to_vec(),
            independent: Vec::new(),
            schedule_id: 0,
            progress: ArrayVec::new(),
            slots: ArrayVec::new(),
            histories: std::iter::repeat_with(History::new).take(MAX_SENSORS).collect(),
            changes: 0,
        }
    }

    /// The same, refusing attacks on the `independent` sensors.
    pub fn sparing(self, independent: &[SensorId]) -> Self {
        Self { independent: independent.to_vec(), ..self }
    }

    /// May schedules be uploaded?
    pub fn enabled(&self) -> bool {
        self.enabled
    }

    /// Id of the schedule in force; 0 before the first.
    pub fn schedule_id(&self) -> u32 {
        self.schedule_id
    }

    /// Progress of each attack of the schedule.
    pub fn state(&self) -> &[Progress] {
        &self.progress
    }

    /// Grows with every change of [`Injector::state`] other than its sample counts.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Is any attack altering samples now?
    pub fn any_active(&self) -> bool {
        self.progress.iter().any(|p| p.phase == Phase::Active)
    }

    /// Replaces the schedule; attacks still running end.
    ///
    /// # Errors
    /// [`AttackError`] naming the offending attack and value; the schedule before stays in force.
    pub fn upload(&mut self, schedule: &Schedule, now: FlightTime) -> Result<(), AttackError> {
        if !self.enabled {
            return Err(AttackError::Disabled);
        }
        schedule.sequences.iter().try_for_each(|sequence| Bounds::check_sequence(&schedule.attacks, sequence))?;
        let mut slots = ArrayVec::new();
        let mut progress = ArrayVec::new();
        for (index, attack) in schedule.attacks.iter().enumerate() {
            if schedule.attacks.iter().take(index).any(|other| other.id == attack.id) {
                return Err(AttackError::DuplicateId(attack.id));
            }
            if !self.sensors.contains(&attack.sensor) {
                return Err(AttackError::NoSuchSensor { id: attack.id, sensor: attack.sensor });
            }
            if self.independent.contains(&attack.sensor) {
                return Err(AttackError::Independent { id: attack.id, sensor: attack.sensor });
            }
            let mask = self.bounds.check(attack)?;
            let onset = now + std::time::Duration::from_secs_f64(attack.start_s);
            slots.push(Slot {
                mask,
                onset,
                end: onset + std::time::Duration::from_secs_f64(attack.duration_s),
                rng: Xoshiro256PlusPlus::seed_from_u64(attack.seed),
                held: None,
                window: if attack.kind == Kind::Replay { Vec::with_capacity(HISTORY) } else { Vec::new() },
                sequence: schedule.sequences.iter().find(|sequence| sequence.attack == attack.id).cloned(),
            });
            progress.push(Progress {
                attack: *attack,
                phase: Phase::Accepted,
                accepted: now,
                active: None,
                ended: None,
                altered_samples: 0,
            });
        }
        self.slots = slots;
        self.progress = progress;
        self.schedule_id = schedule.id;
        self.changes += 1;
        Ok(())
    }

    /// Ends every attack that is not over. Returns how many there were.
    pub fn abort(&mut self, now: FlightTime) -> usize {
        let mut aborted = 0;
        for progress in &mut self.progress {
            if matches!(progress.phase, Phase::Accepted | Phase::Active) {
                progress.phase = Phase::Aborted;
                progress.ended = Some(now);
                aborted += 1;
            }
        }
        self.changes += u64::from(aborted > 0);
        aborted
    }

    /// The frame that the estimators receive.
    pub fn apply(&mut self, sensed: &SensorFrame) -> SensorFrame {
        let now = sensed.time;
        for (progress, slot) in self.progress.iter_mut().zip(&self.slots) {
            if matches!(progress.phase, Phase::Accepted | Phase::Active) && now >= slot.end {
                progress.phase = Phase::Done;
                progress.ended = Some(slot.end);
                self.changes += 1;
            }
        }
        let mut received = *sensed;
        let Self { progress, slots, changes, histories, .. } = self;
        received.visit(&mut Pass { progress, slots, changes, histories: histories.iter_mut(), now });
        received
    }
}

/// One pass over a frame.
struct Pass<'a> {
    progress: &'a mut ArrayVec<Progress, MAX_ATTACKS>,
    slots: &'a mut ArrayVec<Slot, MAX_ATTACKS>,
    changes: &'a mut u64,
    histories: std::slice::IterMut<'a, History>,
    now: FlightTime,
}

impl Visitor for Pass<'_> {
    fn place<S: Registered>(&mut self, id: SensorId, place: &mut Option<S>) {
        let Some(history) = self.histories.next() else { return };
        let Some(sensed) = *place else { return };
        let sensed_values = sensed.scalars();
        let (mut values, mut stamp) = (sensed_values, sensed.time());
        let mut dropped = false;
        for (progress, slot) in self.progress.iter_mut().zip(self.slots.iter_mut()) {
            let running = matches!(progress.phase, Phase::Accepted | Phase::Active);
            if !running || progress.attack.sensor != id || self.now < slot.onset {
                continue;
            }
            if progress.phase == Phase::Accepted {
                slot.begin(&progress.attack, history, sensed_values);
                progress.phase = Phase::Active;
                *self.changes += 1;
            }
            let before = (values, stamp);
            let drops = slot.alter(&progress.attack, sensed.time(), &mut values, &mut stamp, history);
            dropped |= drops;
            if drops || before != (values, stamp) {
                progress.active.get_or_insert(self.now);
                progress.altered_samples += 1;
            }
        }
        // The history holds what was sensed: a replay never replays an attack.
        history.push(sensed.time(), sensed_values);
        if dropped {
            *place = None;
        } else if (values, stamp) != (sensed_values, sensed.time()) {
            *place = Some(sensed.with_scalars(&values).with_time(stamp));
        }
    }
}

fn micros(seconds: f64) -> u64 {
    (seconds * 1e6).round() as u64
}

impl Slot {
    fn begin(&mut self, attack: &Attack, history: &History, first: Scalars) {
        self.held = Some(history.iter().next_back().map_or(first, |(_, values)| *values));
        if attack.kind == Kind::Replay {
            let from = FlightTime(self.onset.0.saturating_sub(micros(attack.magnitude)));
            // Room for the whole history was made at upload.
            self.window.extend(history.iter().filter(|(t, _)| *t >= from).take(HISTORY).copied());
        }
    }

    /// Alters `values` and `stamp`; true when the whole sample is withheld.
    fn alter(
        &mut self,
        attack: &Attack,
        time: FlightTime,
        values: &mut Scalars,
        stamp: &mut FlightTime,
        history: &History,
    ) -> bool {
        let elapsed = time.seconds_since(self.onset).max(0.0);
        let part = self.sequence.as_ref().map_or(1.0, |sequence| {
            let k = (elapsed / sequence.period_s + 1e-9) as usize;
            sequence.values.get(k).copied().unwrap_or(0.0)
        });
        let magnitude = part * attack.magnitude;
        let source = match attack.kind {
            Kind::Freeze => self.held,
            Kind::Replay => {
                let window_us = micros(magnitude).max(1);
                let start = self.window.first().map_or(self.onset, |(t, _)| *t);
                let at = FlightTime(start.0 + time.0.saturating_sub(self.onset.0) % window_us);
                self.window.iter().rev().find(|(t, _)| *t <= at).map(|(_, v)| *v).or(self.held)
            }
            Kind::Delay => {
                let at = FlightTime(time.0.saturating_sub(micros(magnitude)));
                if at == time { None } else { history.at(at).or(self.held) }
            }
            Kind::Dropout => {
                let draw: f64 = StandardUniform.sample(&mut self.rng);
                return draw < magnitude;
            }
            Kind::TimeShift => {
                let by_us = micros(magnitude.abs());
                let (later, earlier) = (stamp.0.saturating_add(by_us), stamp.0.saturating_sub(by_us));
                *stamp = FlightTime(if magnitude > 0.0 { later } else { earlier });
                return false;
            }
            _ => None,
        };
        for (i, value) in values.iter_mut().enumerate() {
            if self.mask & (1 << i) == 0 {
                continue;
            }
            *value = match attack.kind {
                Kind::Zero => 0.0,
                Kind::Bias => *value + magnitude,
                Kind::Ramp => *value + magnitude * elapsed,
                Kind::Parabola => *value + 0.5 * magnitude * elapsed * elapsed,
                Kind::Scale => *value * magnitude,
                Kind::Noise => {
                    let draw: f64 = StandardNormal.sample(&mut self.rng);
                    *value + magnitude * draw
                }
                Kind::SignFlip => -*value,
                Kind::Freeze | Kind::Replay | Kind::Delay => source.and_then(|s| s.get(i).copied()).unwrap_or(*value),
                Kind::Dropout | Kind::TimeShift => *value,
            };
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attack::Channel;
    use crate::sensor::{HeightSample, ImuSample};
    use plumbline_proto::v1::SensorKind;

    const SENSORS: &[SensorId] = &[
        SensorId::new(SensorKind::Height, 1),
        SensorId::new(SensorKind::Height, 2),
        SensorId::new(SensorKind::Imu, 1),
    ];

    fn attack(kind: Kind, magnitude: f64) -> Attack {
        Attack {
            id: 1,
            sensor: SensorId::new(SensorKind::Height, 2),
            channel: Channel::All,
            kind,
            start_s: 5.0,
            duration_s: 10.0,
            magnitude,
            seed: 7,
        }
    }

    /// Heights are a ramp of 0.1 m/s at 10 Hz: height(t) = 0.1 t. Returns height 2 as received.
    fn fly(injector: &mut Injector, from_s: f64, to_s: f64) -> Vec<(f64, Option<f64>)> {
        let mut out = Vec::new();
        for tick in (from_s * 10.0) as u64..(to_s * 10.0) as u64 {
            let time = FlightTime(tick * 100_000);
            let sample = Some(HeightSample { time, height_m: time.as_seconds() * 0.1 });
            let mut frame = SensorFrame { time, ..Default::default() };
            frame.heights[0] = sample;
            frame.heights[1] = sample;
            let received = injector.apply(&frame);
            assert_eq!(received.heights[0], sample, "height 1 is not attacked");
            out.push((time.as_seconds(), received.heights[1].map(|h| h.height_m)));
        }
        out
    }

    fn run(kind: Kind, magnitude: f64) -> Vec<(f64, Option<f64>)> {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule { id: 3, ..Default::default() };
        schedule.attacks.push(attack(kind, magnitude));
        injector.upload(&schedule, FlightTime(0)).unwrap();
        assert_eq!(injector.state()[0].phase, Phase::Accepted);
        let out = fly(&mut injector, 0.0, 20.0);
        let progress = injector.state()[0];
        assert_eq!(progress.phase, Phase::Done);
        // A ramp is zero at its onset: the first altered sample is the second.
        let first = if matches!(kind, Kind::Ramp | Kind::Parabola) { 5_100_000 } else { 5_000_000 };
        assert_eq!(progress.active, (kind != Kind::Dropout).then_some(FlightTime(first)).or(progress.active));
        assert_eq!(progress.ended, Some(FlightTime(15_000_000)));
        for (t, value) in &out {
            if !(5.0..15.0).contains(t) {
                assert!((value.unwrap() - 0.1 * t).abs() < 1e-12, "altered outside its span at {t}");
            }
        }
        out.into_iter().filter(|(t, _)| (5.0..15.0).contains(t)).collect()
    }

    fn check(kind: Kind, magnitude: f64, expected: impl Fn(f64) -> f64) {
        for (t, value) in run(kind, magnitude) {
            let value = value.unwrap();
            assert!((value - expected(t)).abs() < 1e-9, "{kind:?} at {t} s: {value}, expected {}", expected(t));
        }
    }

    #[test]
    fn deterministic_kinds_do_what_they_say_inside_their_span_only() {
        check(Kind::Zero, 0.0, |_| 0.0);
        check(Kind::Bias, 0.5, |t| 0.1 * t + 0.5);
        check(Kind::Ramp, 0.2, |t| 0.1 * t + 0.2 * (t - 5.0));
        check(Kind::Parabola, 0.2, |t| 0.1 * t + 0.1 * (t - 5.0).powi(2));
        check(Kind::Scale, -2.0, |t| -0.2 * t);
        check(Kind::SignFlip, 0.0, |t| -0.1 * t);
        check(Kind::Freeze, 0.0, |_| 0.49);
        check(Kind::Delay, 1.0, |t| 0.1 * (t - 1.0));
        // The two seconds before onset, again and again.
        check(Kind::Replay, 2.0, |t| 0.1 * (3.0 + (((t - 5.0) * 10.0).round() as u64 % 20) as f64 / 10.0));
    }

    #[test]
    fn noise_and_dropout_have_their_statistics_and_repeat_with_their_seed() {
        let noise = run(Kind::Noise, 0.3);
        let n = noise.len() as f64;
        let variance = noise.iter().map(|(t, v)| (v.unwrap() - 0.1 * t).powi(2)).sum::<f64>() / n;
        assert!((0.2..0.4).contains(&variance.sqrt()), "sigma {}", variance.sqrt());
        assert_eq!(noise, run(Kind::Noise, 0.3));
        let lost = run(Kind::Dropout, 0.5).iter().filter(|(_, v)| v.is_none()).count();
        assert!((30..70).contains(&lost), "{lost} of 100 dropped");
    }

    #[test]
    fn a_bias_follows_its_sequence_within_the_bounds_and_ends_with_its_table() {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let sequence = |attack, period_s, values: &[f64]| Sequence { attack, period_s, values: values.to_vec() };
        let with = |sequence: Sequence| {
            let mut schedule = Schedule { id: 3, ..Default::default() };
            schedule.attacks.push(attack(Kind::Bias, 0.5));
            schedule.sequences.push(sequence);
            schedule
        };
        let id = attack(Kind::Bias, 0.5).id;
        for (bad, expected) in [
            (sequence(id + 1, 0.1, &[1.0]), "there is no such attack"),
            (sequence(id, 0.0, &[1.0]), "sequence period (s) 0 is outside 0.001 to 10"),
            (sequence(id, 0.1, &[1.0, -1.5]), "value of a sequence -1.5 is outside -1 to 1"),
            (sequence(id, 0.1, &[f64::NAN]), "NaN"),
            (sequence(id, 0.1, &[]), "values of a sequence 0"),
        ] {
            let error = injector.upload(&with(bad), FlightTime(0)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        injector.upload(&with(sequence(id, 1.0, &[1.0, -0.5, 0.25])), FlightTime(0)).unwrap();
        for (t, value) in fly(&mut injector, 0.0, 12.0) {
            let added = match t - 5.0 + 1e-6 {
                x if x < 0.0 => 0.0,
                x if x < 1.0 => 0.5,
                x if x < 2.0 => -0.25,
                x if x < 3.0 => 0.125,
                _ => 0.0,
            };
            assert!((value.unwrap() - 0.1 * t - added).abs() < 1e-9, "{t} s: {value:?}, {added}");
        }
        assert_eq!(injector.abort(FlightTime(12_000_000)), 1);
    }

    #[test]
    fn a_time_shift_alters_the_stamp_alone_and_never_below_zero() {
        for (magnitude, expected) in [(0.3, 6_300_000), (-0.3, 5_700_000), (-2.0, 4_000_000)] {
            let mut injector = Injector::new(Bounds::default(), true, SENSORS);
            let mut schedule = Schedule::default();
            schedule.attacks.push(attack(Kind::TimeShift, magnitude));
            injector.upload(&schedule, FlightTime(0)).unwrap();
            let sample = Some(HeightSample { time: FlightTime(6_000_000), height_m: 0.5 });
            let mut frame = SensorFrame { time: FlightTime(6_000_000), ..Default::default() };
            (frame.heights[0], frame.heights[1]) = (sample, sample);
            let received = injector.apply(&frame).heights;
            assert_eq!(received[1], Some(HeightSample { time: FlightTime(expected), height_m: 0.5 }));
            assert_eq!((received[0], injector.state()[0].altered_samples), (sample, 1));
        }
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule::default();
        schedule.attacks.push(attack(Kind::TimeShift, 2.1));
        let refused = injector.upload(&schedule, FlightTime(0)).unwrap_err().to_string();
        assert!(refused.contains("time shift (s) 2.1 is outside -2 to 2"), "{refused}");
    }

    #[test]
    fn abort_ends_everything_at_once() {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule::default();
        schedule.attacks.push(attack(Kind::Bias, 0.5));
        injector.upload(&schedule, FlightTime(0)).unwrap();
        fly(&mut injector, 0.0, 7.0);
        assert!(injector.any_active());
        assert_eq!(injector.abort(FlightTime(7_000_000)), 1);
        for (t, value) in fly(&mut injector, 7.0, 9.0) {
            assert!((value.unwrap() - 0.1 * t).abs() < 1e-12);
        }
        assert_eq!(injector.state()[0].phase, Phase::Aborted);
        assert_eq!(injector.abort(FlightTime(9_000_000)), 0);
    }

    #[test]
    fn schedules_out_of_bounds_are_refused_with_the_value_and_change_nothing() {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut refuse = |change: fn(&mut Attack), expected: &str| {
            let mut bad = attack(Kind::Bias, 0.5);
            change(&mut bad);
            let mut schedule = Schedule::default();
            schedule.attacks.push(bad);
            let error = injector.upload(&schedule, FlightTime(0)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
            assert!(injector.state().is_empty());
        };
        refuse(|a| a.magnitude = f64::NAN, "NaN");
        refuse(|a| a.magnitude = 6.0, "magnitude 6 is outside -5 to 5");
        refuse(|a| a.duration_s = 1e9, "duration (s) 1000000000");
        refuse(|a| a.start_s = -1.0, "start (s) -1");
        refuse(|a| a.sensor = SensorId::new(SensorKind::Height, 9), "no height 9");
        refuse(|a| a.channel = Channel::Gyro, "Gyro of height 2");
        refuse(|a| a.sensor = SensorId::new(SensorKind::Imu, 1), "Bias cannot cover All of imu 1");
        let mut off = Injector::new(Bounds::default(), false, SENSORS);
        assert_eq!(off.upload(&Schedule::default(), FlightTime(0)), Err(AttackError::Disabled));
    }

    #[test]
    fn an_imu_channel_leaves_the_others_alone() {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule::default();
        schedule.attacks.push(Attack {
            sensor: SensorId::new(SensorKind::Imu, 1),
            channel: Channel::GyroAxis(1),
            start_s: 0.0,
            ..attack(Kind::Bias, 0.25)
        });
        injector.upload(&schedule, FlightTime(0)).unwrap();
        let sample = ImuSample {
            time: FlightTime(0),
            gyro_radps: nalgebra::Vector3::new(0.1, 0.2, 0.3),
            accel_mps2: nalgebra::Vector3::new(0.0, 0.0, 9.81),
            mag_ut: None,
            temperature_c: 25.0,
        };
        let mut frame = SensorFrame::default();
        frame.imus[0] = Some(sample);
        let received = injector.apply(&frame).imus[0].unwrap();
        let expected = ImuSample { gyro_radps: nalgebra::Vector3::new(0.1, 0.45, 0.3), ..sample };
        assert_eq!(received, expected);
    }
}
