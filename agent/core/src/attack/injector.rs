//! Applies the active schedule to each frame. Allocates when a schedule is uploaded, never in a tick.

use arrayvec::ArrayVec;
use plumbline_proto::{ids::SensorId, time::FlightTime, v1::SensorKind};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::kinds::Kind;
use super::schedule::{Attack, AttackError, Bounds, MAX_ATTACKS, Schedule, Sequence};
use crate::model::airframe::Airframe;
use crate::sensor::sample::{Scalars, same};
use crate::sensor::{MAX_SENSORS, Registered, SensorFrame, Visitor};
use crate::types::{MotorCommand, ROTORS};

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

    /// Newest value.
    fn last(&self) -> Option<Scalars> {
        self.iter().next_back().map(|(_, values)| *values)
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
    /// How long it is, µs.
    window_us: u64,
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
    /// One for each place of a frame, in its order, then one for each rotor.
    histories: Vec<History>,
    /// Thrust that each rotor was told last, as a part of its full one.
    told: [f64; ROTORS],
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
            histories: std::iter::repeat_with(History::new).take(MAX_SENSORS + ROTORS).collect(),
            told: [0.0; ROTORS],
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
            if !self.sensors.contains(&attack.sensor) && !is_rotor(attack.sensor) {
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
                window_us: 0,
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
        let running = Running { progress, slots, changes, now };
        received.visit(&mut Pass { running, histories: histories.iter_mut() });
        received
    }

    /// What reaches the motors of `airframe` of a command given at `now`. Only what flies is attacked: motors that stand or
    /// idle stay so, whatever is injected.
    pub fn apply_command(
        &mut self,
        airframe: &Airframe,
        command: &MotorCommand,
        flying: bool,
        now: FlightTime,
    ) -> MotorCommand {
        let Self { progress, slots, changes, histories, told, .. } = self;
        let mut running = Running { progress, slots, changes, now };
        let (curve, full) = (airframe.motor_curve, airframe.motor_curve.full_speed_radps());
        let mut reached = *command;
        let rotors = reached.throttle.iter_mut().zip(told).zip(histories.iter_mut().skip(MAX_SENSORS)).zip(1_u8..);
        for (((throttle, told), history), instance) in rotors {
            let mut asked = Scalars::default();
            asked[0] = (curve.speed_radps(*throttle, 1.0) / full).powi(2);
            let id = SensorId::new(SensorKind::Rotor, instance);
            // A command has no stamp of its own.
            let (values, _, dropped) =
                if flying { running.alter(id, now, asked, history) } else { (asked, now, false) };
            let thrust = if dropped { *told } else { values[0].clamp(0.0, 1.0) };
            history.push(now, asked);
            if dropped || values != asked {
                *throttle = curve.command(full * thrust.sqrt(), 1.0);
            }
            *told = thrust;
        }
        reached
    }
}

/// Does it name one of the rotors?
fn is_rotor(target: SensorId) -> bool {
    target.kind == SensorKind::Rotor && (1..=ROTORS).contains(&usize::from(target.instance))
}

/// The attacks at one time.
struct Running<'a> {
    progress: &'a mut ArrayVec<Progress, MAX_ATTACKS>,
    slots: &'a mut ArrayVec<Slot, MAX_ATTACKS>,
    changes: &'a mut u64,
    now: FlightTime,
}

impl Running<'_> {
    /// What they make of the `given` values of `target` and their stamp, and whether those are withheld.
    fn alter(
        &mut self,
        target: SensorId,
        time: FlightTime,
        given: Scalars,
        history: &History,
    ) -> (Scalars, FlightTime, bool) {
        let (mut values, mut stamp, mut dropped) = (given, time, false);
        for (progress, slot) in self.progress.iter_mut().zip(self.slots.iter_mut()) {
            let running = matches!(progress.phase, Phase::Accepted | Phase::Active);
            if !running || progress.attack.sensor != target || self.now < slot.onset {
                continue;
            }
            if progress.phase == Phase::Accepted {
                slot.begin(&progress.attack, history, given);
                progress.phase = Phase::Active;
                *self.changes += 1;
            }
            let before = (values, stamp);
            let drops = slot.alter(&progress.attack, time, &mut values, &mut stamp, history);
            dropped |= drops;
            if drops || before.1 != stamp || !same(&before.0, &values) {
                progress.active.get_or_insert(self.now);
                progress.altered_samples += 1;
            }
        }
        (values, stamp, dropped)
    }
}

/// One pass over a frame.
struct Pass<'a> {
    running: Running<'a>,
    histories: std::slice::IterMut<'a, History>,
}

impl Visitor for Pass<'_> {
    fn place<S: Registered>(&mut self, id: SensorId, place: &mut Option<S>) {
        let Some(history) = self.histories.next() else { return };
        let Some(sensed) = *place else { return };
        let sensed_values = sensed.scalars();
        let (values, stamp, dropped) = self.running.alter(id, sensed.time(), sensed_values, history);
        // The history holds what was sensed: a replay never replays an attack.
        let before = history.last();
        history.push(sensed.time(), sensed.scalars_after(before));
        if dropped {
            *place = None;
        } else if stamp != sensed.time() || !same(&values, &sensed_values) {
            *place = Some(sensed.with_scalars(&values).with_time(stamp));
        }
    }
}

fn micros(seconds: f64) -> u64 {
    (seconds * 1e6).round() as u64
}

impl Slot {
    fn begin(&mut self, attack: &Attack, history: &History, first: Scalars) {
        self.held = Some(history.last().unwrap_or(first));
        if attack.kind == Kind::Replay {
            let from = FlightTime(self.onset.0.saturating_sub(micros(attack.magnitude)));
            // Room for the whole history was made at upload.
            self.window.extend(history.iter().filter(|(t, _)| *t >= from).take(HISTORY).copied());
            // No further back than the history reaches.
            let oldest = history.iter().next().map_or(self.onset, |(t, _)| *t);
            self.window_us = self.onset.0.saturating_sub(oldest.max(from).0);
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
                let start = self.window.first().map_or(self.onset, |(t, _)| *t);
                let at = FlightTime(start.0 + time.0.saturating_sub(self.onset.0) % self.window_us.max(1));
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
mod tests;
