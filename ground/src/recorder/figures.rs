//! What a report says of a flight: what each estimator was off by, what attacks did, how an autopilot followed; from every
//! message of it, in two passes: what is told of attacks and arming, then everything that is measured by it.
//!
//! Truth is taken at the time of an estimate, straight between its samples; a setpoint holds until the next one. RMS of errors
//! are over time, each sample with half the time to its neighbours; of deviations, over samples.

use std::collections::BTreeMap;

use plumbline_proto::{Kind, Message as _, v1};
use plumbline_rest::flight::{AttackEffect, EstimatorError, Figures, Followed, OVERVIEW_COLUMNS, Samples};

use super::export::{damaged, open};
use super::reader::FlightReader;
use super::{RecordingError, Snapshot};

/// Samples further apart than this are not connected, s.
const GAP_S: f64 = 1.0;
/// After the end of an attack its damage is still looked for so long, s.
const AFTER_S: f64 = 2.0;
/// Attacks of a flight that are told of; the first ones.
const MAX_ATTACKS: usize = 500;
/// mm of a metre, mrad of a radian.
const MILLI: f64 = 1e3;

/// What is told of a flight.
#[derive(Default)]
struct Told {
    armed: Vec<f64>,
    /// By when their schedule was accepted and their number.
    attacks: BTreeMap<(u64, u32), Attacked>,
    in_loop: u16,
}

impl Told {
    fn take(&mut self, kind: Kind, time_s: f64, payload: &[u8]) {
        match kind {
            Kind::Event if v1::Event::decode(payload).is_ok_and(|event| event.kind == "armed") => {
                self.armed.push(time_s)
            }
            Kind::Status => {
                let told = v1::Status::decode(payload).map_or(0, |status| status.estimator_in_loop as u16);
                self.in_loop = if told == 0 { self.in_loop } else { told };
            }
            Kind::Attacks => {
                let told = v1::AttackState::decode(payload).unwrap_or_default();
                for (progress, attack) in told.attacks.iter().filter_map(|p| Some((p, p.attack.as_ref()?))) {
                    let key = (progress.accepted_time_us, attack.id);
                    if let Some(active_us) = progress.active_time_us
                        && (self.attacks.len() < MAX_ATTACKS || self.attacks.contains_key(&key))
                    {
                        let due_s = progress.accepted_time_us as f64 * 1e-6 + attack.start_s + attack.duration_s;
                        let (start_s, end_s) =
                            (active_us as f64 * 1e-6, progress.ended_time_us.map_or(due_s, |us| us as f64 * 1e-6));
                        self.attacks
                            .insert(key, Attacked::new((attack.sensor, attack.instance), start_s, end_s.max(start_s)));
                    }
                }
            }
            _ => {}
        }
    }

    /// From the first to the last time of arming and disarming; all of it where that is not known.
    fn armed_s(&self) -> [f64; 2] {
        match self.armed.as_slice() {
            [first, .., last] => [*first, *last],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }
}

/// Largest and RMS of samples.
#[derive(Default)]
struct Deviation {
    largest: f64,
    squares: f64,
    count: u32,
}

impl Deviation {
    fn take(&mut self, off: f64) {
        if off.is_finite() {
            self.largest = self.largest.max(off.abs());
            self.squares += off * off;
            self.count += 1;
        }
    }

    fn told(&self) -> Option<[f64; 2]> {
        (self.count > 0).then(|| [self.largest, (self.squares / f64::from(self.count)).sqrt()])
    }
}

/// An attack, and what came of it.
struct Attacked {
    sensor: (i32, u32),
    start_s: f64,
    end_s: f64,
    during: Deviation,
    before: Deviation,
    effect: AttackEffect,
}

impl Attacked {
    fn new(sensor: (i32, u32), start_s: f64, end_s: f64) -> Self {
        Self {
            sensor,
            start_s,
            end_s,
            during: Deviation::default(),
            before: Deviation::default(),
            effect: AttackEffect::default(),
        }
    }

    fn deviates(&mut self, time_s: f64, off: f64) {
        if (self.start_s..self.end_s + AFTER_S).contains(&time_s) {
            self.during.take(off);
        } else if (2.0 * self.start_s - self.end_s..self.start_s).contains(&time_s) {
            self.before.take(off);
        }
    }

    /// The time since its onset, where a time is one at which it may be found.
    fn after(&self, sensor: (i32, u32), time_s: f64) -> Option<f64> {
        let found = sensor == self.sensor && (self.start_s..=self.end_s + AFTER_S).contains(&time_s);
        found.then_some(time_s - self.start_s)
    }

    fn rejected(&mut self, sensor: (i32, u32), time_s: f64) {
        self.effect.rejected_after_s = self.effect.rejected_after_s.or(self.after(sensor, time_s));
    }

    fn excluded(&mut self, sensor: (i32, u32), time_s: f64) {
        self.effect.isolated_after_s = self.effect.isolated_after_s.or(self.after(sensor, time_s));
        let told = [sensor.0 as u32, sensor.1];
        if (self.start_s..=self.end_s).contains(&time_s) && !self.effect.excluded.contains(&told) {
            self.effect.excluded.push(told);
        }
    }

    fn told(self, (accepted_time_us, id): (u64, u32)) -> AttackEffect {
        let (deviation_m, rms_before_m) = (self.during.told(), self.before.told().map(|[_, rms]| rms));
        AttackEffect { accepted_time_us, id, deviation_m, rms_before_m, ..self.effect }
    }
}

/// Root of the mean square over time, and the largest.
#[derive(Default)]
struct Rms {
    before: Option<(f64, f64)>,
    weight_s: f64,
    squares: f64,
    largest: f64,
}

impl Rms {
    fn take(&mut self, time_s: f64, off: f64) {
        if !off.is_finite() {
            self.before = None;
            return;
        }
        let mut add = |off: f64, weight_s: f64| {
            self.weight_s += weight_s;
            self.squares += weight_s * off * off;
        };
        match self.before.filter(|(before_s, _)| time_s - before_s <= GAP_S) {
            Some((before_s, before)) => {
                add(before, 0.5 * (time_s - before_s));
                add(off, 0.5 * (time_s - before_s));
            }
            // A sample with no neighbour still counts, next to nothing.
            None => add(off, 1e-9),
        }
        self.largest = self.largest.max(off.abs());
        self.before = Some((time_s, off));
    }

    fn told(&self) -> Option<f64> {
        (self.weight_s > 0.0).then(|| (self.squares / self.weight_s).sqrt())
    }
}

/// A curve, of equal stretches of time the least and the greatest.
struct Envelope {
    width_s: f64,
    samples: u64,
    /// Number of the stretch, least and greatest of it, each with its time.
    last: Option<(u64, [(f64, f64); 2])>,
    told: Samples,
}

impl Envelope {
    fn take(&mut self, time_s: f64, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.samples += 1;
        let number = (time_s.max(0.0) / self.width_s) as u64;
        match &mut self.last {
            Some((known, [least, greatest])) if *known == number => {
                if value < least.1 {
                    *least = (time_s, value);
                }
                if value > greatest.1 {
                    *greatest = (time_s, value);
                }
            }
            _ => {
                self.put();
                self.last = Some((number, [(time_s, value); 2]));
            }
        }
    }

    fn put(&mut self) {
        let Some((_, mut both)) = self.last.take() else { return };
        both.sort_by(|a, b| a.0.total_cmp(&b.0));
        let [first, second] = both;
        for (time_s, value) in std::iter::once(first).chain((second != first).then_some(second)) {
            self.told.time_s.push(time_s);
            self.told.value.push(value);
        }
    }

    fn told(mut self) -> Samples {
        self.put();
        Samples { samples: self.samples, ..self.told }
    }
}

/// Altitude, roll, pitch and yaw, m and rad; not known: NaN.
type State = [f64; 4];

fn state(position: Option<&v1::Vector3>, angles: Option<&v1::Vector3>) -> State {
    let z = position.map_or(f64::NAN, |p| p.z);
    angles.map_or([z, f64::NAN, f64::NAN, f64::NAN], |a| [z, a.x, a.y, a.z])
}

fn z(state: &State) -> f64 {
    let [z, ..] = state;
    *z
}

/// An angle within ±π.
fn wrapped(rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (rad + PI).rem_euclid(TAU) - PI
}

/// One state less another.
fn less(one: State, other: State) -> State {
    let [z, angles @ ..] = one;
    let [other_z, others @ ..] = other;
    let [mut roll, mut pitch, mut yaw] = angles;
    for (angle, other) in [&mut roll, &mut pitch, &mut yaw].into_iter().zip(others) {
        *angle = wrapped(*angle - other);
    }
    [z - other_z, roll, pitch, yaw]
}

/// What is followed of an estimator.
struct Estimator {
    errors: [Rms; 4],
    curve: Envelope,
}

/// Everything that is measured, message by message.
struct Measured {
    start_s: f64,
    armed_s: [f64; 2],
    in_loop: u16,
    truth_known: bool,
    attacks: BTreeMap<(u64, u32), Attacked>,
    estimators: BTreeMap<u16, Estimator>,
    width_s: f64,
    /// Estimates of times that truth has not reached.
    pending: Vec<(f64, u16, State)>,
    truth: Option<(f64, State)>,
    setpoint: State,
    /// Of the message that came last.
    now_s: f64,
    /// Altitudes whose setpoint may still come with the same time.
    flown: Vec<(f64, f64)>,
    autopilot: [(Rms, Deviation); 4],
    asked: State,
}

impl Measured {
    fn new(start_s: f64, told: Told) -> Self {
        Self {
            start_s,
            armed_s: told.armed_s(),
            in_loop: told.in_loop,
            truth_known: true,
            attacks: told.attacks,
            estimators: BTreeMap::new(),
            width_s: 1.0,
            pending: Vec::new(),
            truth: None,
            setpoint: [f64::NAN; 4],
            now_s: 0.0,
            flown: Vec::new(),
            autopilot: Default::default(),
            asked: [f64::NAN; 4],
        }
    }

    fn take(&mut self, (kind, instance): (Kind, u16), time_s: f64, payload: &[u8]) {
        if time_s > self.now_s {
            self.settle();
            self.now_s = time_s;
        }
        match kind {
            Kind::Estimate => {
                let Ok(estimate) = v1::Estimate::decode(payload) else { return };
                let known = estimate.health() != v1::Health::Initialising;
                let at = state(estimate.position_enu_m.as_ref(), estimate.roll_pitch_yaw_rad.as_ref());
                let at = if known { at } else { [f64::NAN; 4] };
                if !self.truth_known && instance == self.in_loop {
                    self.flown.push((time_s, z(&at)));
                }
                match self.truth {
                    Some((truth_s, truth)) if truth_s == time_s => self.err(time_s, instance, less(at, truth)),
                    _ => self.pending.push((time_s, instance, at)),
                }
            }
            Kind::Truth => {
                let Ok(truth) = v1::Truth::decode(payload) else { return };
                let now = state(truth.position_enu_m.as_ref(), truth.roll_pitch_yaw_rad.as_ref());
                self.flown.push((time_s, z(&now)));
                self.reach(time_s, now);
            }
            Kind::Control => {
                let Ok(control) = v1::Control::decode(payload) else { return };
                if let Some(s) = &control.setpoint {
                    let given = [s.altitude_m, s.roll_rad, s.pitch_rad, s.yaw_rad];
                    for (held, given) in self.setpoint.iter_mut().zip(given) {
                        *held = given.unwrap_or(*held);
                    }
                }
                if let Some(autopilot) = control.autopilot.filter(|_| self.is_armed(time_s)) {
                    self.follow(time_s, &autopilot);
                }
            }
            Kind::Residuals => {
                let residuals = v1::Residuals::decode(payload).unwrap_or_default().residuals;
                for residual in residuals.iter().filter(|residual| residual.ratio > 1.0) {
                    let sensor = (residual.sensor, residual.instance);
                    self.attacks.values_mut().for_each(|attack| attack.rejected(sensor, time_s));
                }
            }
            Kind::Secure => {
                let sensors = v1::SecureStatus::decode(payload).unwrap_or_default().sensors;
                for sensor in sensors.iter().filter(|sensor| sensor.present && sensor.flagged) {
                    let sensor = (sensor.sensor, sensor.instance);
                    self.attacks.values_mut().for_each(|attack| attack.excluded(sensor, time_s));
                }
            }
            _ => {}
        }
    }

    fn is_armed(&self, time_s: f64) -> bool {
        let [first, last] = self.armed_s;
        (first..=last).contains(&time_s)
    }

    /// Truth has come to here: estimates since its last sample are measured.
    fn reach(&mut self, time_s: f64, now: State) {
        let before = self.truth.replace((time_s, now));
        let pending = std::mem::take(&mut self.pending);
        for (at_s, number, at) in pending {
            let truth = match before {
                _ if at_s == time_s => now,
                Some((before_s, before)) if time_s - before_s <= GAP_S => {
                    let (way, part) = (less(now, before), (at_s - before_s) / (time_s - before_s));
                    let mut truth = before;
                    for (truth, way) in truth.iter_mut().zip(way) {
                        *truth += way * part;
                    }
                    truth
                }
                _ => [f64::NAN; 4],
            };
            self.err(at_s, number, less(at, truth));
        }
    }

    fn err(&mut self, time_s: f64, number: u16, off: State) {
        let (armed, start_s, width_s) = (self.is_armed(time_s), self.start_s, self.width_s);
        let new = || Estimator {
            errors: Default::default(),
            curve: Envelope { width_s, samples: 0, last: None, told: Samples::default() },
        };
        let estimator = self.estimators.entry(number).or_insert_with(new);
        estimator.curve.take(time_s - start_s, z(&off) * MILLI);
        if armed {
            for (rms, off) in estimator.errors.iter_mut().zip(off) {
                rms.take(time_s, off * MILLI);
            }
        }
    }

    /// Everything of this time has come, its setpoint as well.
    fn settle(&mut self) {
        let [setpoint_m, ..] = self.setpoint;
        for (time_s, altitude_m) in std::mem::take(&mut self.flown) {
            self.attacks.values_mut().for_each(|attack| attack.deviates(time_s, altitude_m - setpoint_m));
        }
        if !self.truth_known {
            for (time_s, number, at) in std::mem::take(&mut self.pending) {
                self.err(time_s, number, less(at, self.setpoint));
            }
        }
        // Truth that comes later than that is not connected with its last sample.
        if self.pending.first().is_some_and(|(time_s, ..)| self.now_s - time_s > GAP_S) {
            self.pending.clear();
        }
    }

    fn follow(&mut self, time_s: f64, autopilot: &v1::AutopilotControl) {
        let demand = |rates: &Option<v1::Vector3>, thrust: Option<f64>| {
            let rates = rates.as_ref().map_or([None; 3], |r| [r.x, r.y, r.z].map(Some));
            let [roll, pitch, yaw] = rates;
            [roll, pitch, yaw, thrust]
        };
        let asked = demand(&autopilot.rates_asked_flu_radps, autopilot.thrust_asked);
        let aimed_at = demand(&autopilot.rates_target_flu_radps, autopilot.thrust_target);
        let held = self.asked.iter_mut().zip(&mut self.autopilot);
        for ((held, (rms, off)), (asked, aimed_at)) in held.zip(asked.into_iter().zip(aimed_at)) {
            if let Some(asked) = asked {
                *held = asked;
                rms.take(time_s, asked);
            }
            if let Some(aimed_at) = aimed_at {
                off.take(aimed_at - *held);
            }
        }
    }

    fn told(mut self) -> Figures {
        self.settle();
        let estimator = |(estimator, found): (u16, Estimator)| {
            let [altitude, angles @ ..] = found.errors;
            let altitude_mm = altitude.told().map(|rms| [rms, altitude.largest]);
            let attitude_mrad = match angles.map(|angle| angle.told()) {
                [Some(roll), Some(pitch), Some(yaw)] => Some([roll, pitch, yaw]),
                _ => None,
            };
            EstimatorError { estimator, altitude_mm, attitude_mrad, altitude_error_mm: found.curve.told() }
        };
        let autopilot = self.autopilot.map(|(rms, off)| Followed { asked_rms: rms.told(), off: off.told() });
        let flown = autopilot.iter().any(|followed| followed.asked_rms.is_some());
        Figures {
            start_s: self.start_s,
            truth: self.truth_known,
            estimators: self.estimators.into_iter().map(estimator).collect(),
            attacks: self.attacks.into_iter().map(|(key, attack)| attack.told(key)).collect(),
            autopilot: if flown { autopilot.to_vec() } else { Vec::new() },
        }
    }
}

/// Passes the messages that are wanted, by kind and instance, to `each` until `goes_on` is false; with their flight time, s.
fn pass(
    reader: &FlightReader,
    wanted: impl Fn((Kind, u16)) -> bool,
    goes_on: &impl Fn() -> bool,
    mut each: impl FnMut((Kind, u16), f64, &[u8]),
) -> Result<(), RecordingError> {
    let of = |topic: &String| Kind::from_topic(topic).filter(|of| wanted(*of));
    let known: BTreeMap<String, (Kind, u16)> =
        reader.channels().into_keys().filter_map(|topic| of(&topic).map(|known| (topic, known))).collect();
    let topics: Vec<String> = known.keys().cloned().collect();
    let read = reader.for_each(Some(&topics), |message| {
        if let Some(kind) = known.get(&message.channel.topic) {
            each(*kind, message.time_us as f64 * 1e-6, message.payload);
        }
        Ok(goes_on())
    });
    read.map_err(damaged)
}

/// What a report says of a flight; as much as there is until `goes_on` is false.
///
/// # Errors
/// [`RecordingError::Damaged`].
pub(crate) fn figures(flight: Snapshot, goes_on: impl Fn() -> bool) -> Result<Figures, RecordingError> {
    let reader = open(flight)?;
    let mut told = Told::default();
    let tells = |(kind, _)| matches!(kind, Kind::Event | Kind::Status | Kind::Attacks);
    pass(&reader, tells, &goes_on, |(kind, _), time_s, payload| told.take(kind, time_s, payload))?;
    let topics = || reader.channels().into_keys().filter_map(|topic| Kind::from_topic(&topic));
    let first = topics().filter(|(kind, _)| *kind == Kind::Estimate).map(|(_, number)| number).min();
    let length_s = reader.end_us().saturating_sub(reader.start_us()) as f64 * 1e-6;
    let mut measured = Measured {
        // A recording from elsewhere has no status.
        in_loop: if told.in_loop == 0 { first.unwrap_or(0) } else { told.in_loop },
        truth_known: topics().any(|(kind, _)| kind == Kind::Truth),
        width_s: (length_s / OVERVIEW_COLUMNS as f64).max(1e-3),
        ..Measured::new(reader.start_us() as f64 * 1e-6, told)
    };
    // Residuals are half of all bytes: only those of the estimator in the loop, and only where they tell of an attack.
    let (in_loop, attacked) = (measured.in_loop, !measured.attacks.is_empty());
    let measures = |(kind, instance)| match kind {
        Kind::Estimate | Kind::Truth | Kind::Control => true,
        Kind::Residuals => attacked && instance == in_loop,
        Kind::Secure => attacked,
        _ => false,
    };
    pass(&reader, measures, &goes_on, |of, time_s, payload| measured.take(of, time_s, payload))?;
    Ok(measured.told())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn up(z: f64) -> Option<v1::Vector3> {
        Some(v1::Vector3 { z, ..Default::default() })
    }

    /// Ten seconds at 10 Hz: 10 mm high, 100 mm while height 2 is attacked, from 4 s to 6 s; what `told` says of it is known.
    fn flown(also: impl Fn(&mut Measured, u64, f64)) -> Figures {
        let attack = v1::Attack { id: 7, sensor: 2, instance: 2, ..Default::default() };
        let progress = v1::AttackProgress {
            attack: Some(attack),
            active_time_us: Some(4_000_000),
            ended_time_us: Some(6_000_000),
            ..Default::default()
        };
        let mut told = Told::default();
        let state = v1::AttackState { attacks: vec![progress], ..Default::default() };
        told.take(Kind::Attacks, 0.0, &state.encode_to_vec());
        told.take(Kind::Status, 0.0, &v1::Status { estimator_in_loop: 1, ..Default::default() }.encode_to_vec());
        let mut measured = Measured::new(0.0, told);
        for i in 0..=100_u64 {
            let (time_s, attacked) = (i as f64 * 0.1, (40..60).contains(&i));
            let truth = v1::Truth { position_enu_m: up(if attacked { 1.1 } else { 1.01 }), ..Default::default() };
            measured.take((Kind::Truth, 0), time_s, &truth.encode_to_vec());
            // The setpoint of a tick may come after its truth.
            let setpoint = Some(v1::Setpoint { altitude_m: Some(1.0), ..Default::default() });
            measured.take((Kind::Control, 0), time_s, &v1::Control { setpoint, ..Default::default() }.encode_to_vec());
            also(&mut measured, i, time_s);
        }
        measured.told()
    }

    #[test]
    fn an_attack_has_its_delay_its_damage_and_who_was_excluded() {
        let figures = flown(|measured, i, time_s| {
            let sensor = |instance, flagged| v1::SecureSensor {
                sensor: 2,
                instance,
                present: true,
                flagged,
                ..Default::default()
            };
            // Flagged half a second late; a healthy one with it, for a moment.
            let sensors = vec![sensor(1, false), sensor(2, (45..60).contains(&i)), sensor(3, i == 50)];
            measured.take(
                (Kind::Secure, 0),
                time_s,
                &v1::SecureStatus { sensors, ..Default::default() }.encode_to_vec(),
            );
            let residual =
                v1::Residual { sensor: 2, instance: 2, ratio: if i == 42 { 1.5 } else { 0.5 }, ..Default::default() };
            let residuals = v1::Residuals { residuals: vec![residual], ..Default::default() }.encode_to_vec();
            measured.take((Kind::Residuals, 1), time_s, &residuals);
        });
        let [attack] = figures.attacks.as_slice() else { panic!("{figures:?}") };
        assert_eq!((attack.accepted_time_us, attack.id), (0, 7));
        assert!((attack.isolated_after_s.unwrap() - 0.5).abs() < 1e-9);
        assert!((attack.rejected_after_s.unwrap() - 0.2).abs() < 1e-9);
        let [largest, rms] = attack.deviation_m.unwrap();
        // Half of the four seconds from its begin to two seconds after its end.
        assert!((largest - 0.1).abs() < 1e-9 && (rms - (0.5_f64 * (0.01 + 1e-4)).sqrt()).abs() < 1e-9, "{attack:?}");
        assert!((attack.rms_before_m.unwrap() - 0.01).abs() < 1e-9);
        assert_eq!(attack.excluded, [[2, 2], [2, 3]]);
        assert!(figures.autopilot.is_empty(), "the motors were commanded");
    }

    #[test]
    fn an_estimate_is_measured_against_truth_of_its_time_while_armed() {
        let estimate = |z, health: v1::Health| {
            let angles = up(3.0 * std::f64::consts::PI);
            v1::Estimate {
                position_enu_m: up(z),
                roll_pitch_yaw_rad: angles,
                health: health.into(),
                ..Default::default()
            }
        };
        let mut told = Told::default();
        for time_s in [1.0, 3.0] {
            told.take(Kind::Event, time_s, &v1::Event { kind: "armed".into(), ..Default::default() }.encode_to_vec());
        }
        let mut measured = Measured::new(0.0, told);
        for i in 0..=8_u64 {
            // A climb of 1 m/s, told twice a second; the estimate between two samples is 20 mm high, the one before arming 5 m.
            let time_s = i as f64 * 0.5;
            let truth = v1::Truth { position_enu_m: up(time_s), roll_pitch_yaw_rad: up(0.0), ..Default::default() };
            measured.take((Kind::Truth, 0), time_s, &truth.encode_to_vec());
            let off = if i == 0 { 5.0 } else { 0.02 };
            let health = if i == 4 { v1::Health::Initialising } else { v1::Health::Healthy };
            let said = estimate(time_s + 0.25 + off, health).encode_to_vec();
            measured.take((Kind::Estimate, 3), time_s + 0.25, &said);
        }
        let figures = measured.told();
        let [of] = figures.estimators.as_slice() else { panic!("{figures:?}") };
        let [rms, largest] = of.altitude_mm.unwrap();
        assert!((rms - 20.0).abs() < 1e-6 && (largest - 20.0).abs() < 1e-6, "{rms} {largest}");
        let [_, _, yaw] = of.attitude_mrad.unwrap();
        assert!((yaw - 1e3 * std::f64::consts::PI).abs() < 1e-6, "{yaw}");
        // The last one has no truth after it, one was none: the curve has all others, the peak before arming as well.
        assert_eq!(of.altitude_error_mm.samples, 7);
        assert!(of.altitude_error_mm.value.iter().any(|mm| (mm - 5000.0).abs() < 1e-6));
    }

    #[test]
    fn without_truth_the_setpoint_holds() {
        let mut measured = Measured { truth_known: false, ..Measured::new(0.0, Told::default()) };
        for (time_s, altitude_m) in [(0.0, 0.5), (0.5, 0.8)] {
            let said = v1::Estimate { position_enu_m: up(0.52), ..Default::default() }.encode_to_vec();
            measured.take((Kind::Estimate, 1), time_s, &said);
            let setpoint = Some(v1::Setpoint { altitude_m: Some(altitude_m), ..Default::default() });
            measured.take((Kind::Control, 0), time_s, &v1::Control { setpoint, ..Default::default() }.encode_to_vec());
        }
        let figures = measured.told();
        let off: Vec<_> = figures.estimators[0].altitude_error_mm.value.iter().map(|mm| mm.round()).collect();
        assert_eq!((figures.truth, off), (false, vec![20.0, -280.0]));
    }

    #[test]
    fn an_autopilot_is_held_to_what_it_was_asked_for() {
        let rates = |x| Some(v1::Vector3 { x, y: 0.0, z: 0.0 });
        let figures = flown(|measured, i, time_s| {
            // It is told of late, and then 0.1 rad/s short of what was asked.
            let autopilot = v1::AutopilotControl {
                rates_asked_flu_radps: rates(0.5),
                thrust_asked: Some(0.4),
                rates_target_flu_radps: if i < 20 { None } else { rates(0.4) },
                ..Default::default()
            };
            let said = v1::Control { autopilot: Some(autopilot), ..Default::default() }.encode_to_vec();
            measured.take((Kind::Control, 0), time_s, &said);
        });
        let [roll, pitch, _, thrust] = figures.autopilot.as_slice() else { panic!("{figures:?}") };
        let [largest, off] = roll.off.unwrap();
        assert!(
            (roll.asked_rms.unwrap() - 0.5).abs() < 1e-9 && (off - 0.1).abs() < 1e-9 && (largest - 0.1).abs() < 1e-9
        );
        assert_eq!((pitch.off, thrust.off), (Some([0.0; 2]), None));
    }

    #[test]
    fn a_curve_keeps_its_peaks_and_few_samples() {
        let mut curve = Envelope { width_s: 1.0, samples: 0, last: None, told: Samples::default() };
        (0..1000).for_each(|k| curve.take(f64::from(k) * 0.01, if k == 432 { 9.0 } else { 0.1 }));
        let told = curve.told();
        assert!(told.value.contains(&9.0) && told.time_s.len() == 11 && told.samples == 1000, "{told:?}");
        assert!(told.time_s.is_sorted());
    }
}
