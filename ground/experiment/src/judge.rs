//! How a flight went: the true state against setpoint and estimate, and the attacked sensors against those excluded.
//!
//! Judged from the first onset (no earlier than [`STEADY_S`]) to the end, or until the script lands. Of a recording the times
//! count from its beginning, what is judged is its time in the air, and nothing is lost: it was flown by somebody else.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_agent::command::Command;
use plumbline_agent::control::step_response::{StepMeter, StepResponse};
use plumbline_agent::estimate::fdir::isolation::Device;
use plumbline_agent::estimate::{Estimate, Residual};
use plumbline_agent::flight::{Failsafe, Flight};
use plumbline_agent::types::{Mode, MotorCommand};
use plumbline_agent::vehicle::Truth;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::{Channel, SensorKind};

use crate::flight::{Deed, Seen, Setup};
use crate::ticks::Ticks;

/// Nothing is judged before, s: the vehicle takes off and settles.
pub const STEADY_S: f64 = 12.0;
/// Further than this from its setpoint, m, a flight is lost whatever else it says.
const ASTRAY_M: f64 = 0.5;
/// A descent faster than this, m/s, is a fall; one that ends higher than this, m, ended in the air (strings begin at 0.3 m).
const FALLS_MPS: f64 = 1.5;
const DOWN_M: f64 = 0.45;
/// A sensor that counts less than this beside the one of its kind that counts most is as good as excluded, announced or not, …
const NOTHING: f64 = 0.01;
/// … once it has for longer than this, s.
const QUIET_S: f64 = 1.0;
/// How long a signal's innovations count for [`Outcome::nis_most`], s.
pub const ALARM_S: f64 = 0.5;

/// How it went. NaN where there was nothing to measure; a field for each column of a result, hence so many.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// True altitude less setpoint, m rms.
    pub altitude_m: f64,
    /// The same, the most of it, m.
    pub altitude_most_m: f64,
    /// True horizontal place less setpoint, m rms; only where it is held.
    pub lateral_m: f64,
    /// Between the true and the estimated vertical, rad rms.
    pub tilt_rad: f64,
    /// Estimated less true altitude, m rms.
    pub estimate_m: f64,
    /// (Estimated less true altitude)² / σ², mean; 1 where σ is right.
    pub nees: f64,
    /// Innovation² / σ² of the samples accepted, mean; 1 where σ is right.
    pub nis: f64,
    /// Innovation² / σ² of one signal, rejected samples as well: the most of its mean over [`ALARM_S`], faded exponentially.
    pub nis_most: f64,
    /// Sum of what the four throttles changed, 1/s.
    pub effort_per_s: f64,
    /// Time that the vehicle was truly beyond its limits of altitude or place, s.
    pub outside_s: f64,
    /// Why it was lost: a failsafe that ends the flight, or astray.
    pub lost: Option<String>,
    /// From the onset to the exclusion of each sensor or rotor that was attacked or broke and excluded, s.
    pub delays_s: Vec<f64>,
    /// Sensors that were attacked, and rotors that were or broke, never excluded.
    pub missed: usize,
    /// Longest exclusion of a healthy sensor, s.
    pub false_longest_s: f64,
    /// How many there were.
    pub false_exclusions: usize,
    /// Longest that a healthy sensor counted for almost nothing, whether it was announced as excluded or not, s.
    pub quiet_longest_s: f64,
    /// How often that was longer than a second.
    pub quiet_exclusions: usize,
    /// From the first onset until the flight said that it is contradicted, or a failsafe acted, s.
    pub declared_s: Option<f64>,
    /// Outside the bound on the height's error that was announced, as a part of the time there was one.
    pub outside_bound: f64,
    /// 10 % to 90 % of the scripted altitude steps, by the true altitude, mean, s.
    pub rise_s: f64,
    /// Most of any step, in per cent of it.
    pub overshoot_percent: f64,
    /// From a step until inside its band for good, the longest, s; of one that never settled, as long as it was watched.
    pub settling_s: f64,
    /// |Mean of the last second less the target|, the most of any step, m.
    pub steady_m: f64,
    /// How long the agent's ticks took here.
    pub ticks: Ticks,
}

/// A mean that is being made.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    /// NaN of nothing.
    fn value(self) -> f64 {
        self.sum / self.count
    }
}

/// What is averaged, tick by tick.
#[derive(Debug, Clone, Copy, Default)]
struct Means {
    altitude: Mean,
    lateral: Mean,
    tilt: Mean,
    estimate: Mean,
    nees: Mean,
    nis: Mean,
    effort: Mean,
    beyond_bound: Mean,
}

/// The scripted steps of altitude, measured by where the vehicle truly is.
#[derive(Debug, Default)]
struct Steps {
    /// Not begun yet, the next one last: when, s, from where and to where, m.
    due: Vec<(f64, f64, f64)>,
    meter: StepMeter,
    /// As they ended.
    done: Vec<(StepResponse, f64)>,
    last_s: f64,
}

impl Steps {
    /// Those that are judged: from `from_s` on.
    fn of(setup: &Setup, from_s: f64) -> Self {
        let mut at_m = 0.0;
        let asked = setup.scenario.script.steps.iter().filter_map(|step| match &step.command {
            Command::Setpoint(change) => change.altitude_m.map(|to_m| (step.at_s, to_m)),
            _ => None,
        });
        let steps = asked.map(|(at_s, to_m)| (at_s, std::mem::replace(&mut at_m, to_m), to_m));
        let mut due: Vec<_> = steps.filter(|(at_s, ..)| *at_s >= from_s).collect();
        due.reverse();
        Self { due, ..Self::default() }
    }

    fn tick(&mut self, t: f64, altitude_m: f64, profiled_m: f64) {
        let now = FlightTime::from_seconds(t);
        while let Some((_, from_m, to_m)) = self.due.pop_if(|(at_s, ..)| *at_s <= t) {
            self.end();
            self.meter.begin(now, from_m, to_m, altitude_m);
        }
        if self.meter.update(now, altitude_m, profiled_m).is_some() {
            self.last_s = t;
        }
    }

    /// Keeps the one being measured as it stands, and for how long it was watched, s.
    fn end(&mut self) {
        let Some(response) = self.meter.response().copied() else { return };
        self.done.pop_if(|(kept, _)| kept.step == response.step);
        self.done.push((response, self.last_s - response.start.as_seconds()));
    }

    fn tell(mut self, outcome: &mut Outcome) {
        self.end();
        let most = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NAN, f64::max);
        let mut rise = Mean::default();
        self.done.iter().filter_map(|(step, _)| step.rise_time_s).for_each(|rise_s| rise.add(rise_s));
        outcome.rise_s = rise.value();
        outcome.overshoot_percent = most(&mut self.done.iter().map(|(step, _)| step.overshoot_percent));
        let settling = self.done.iter().map(|(step, watched_s)| step.settling_time_s.unwrap_or(*watched_s));
        outcome.settling_s = most(&mut settling.into_iter());
        outcome.steady_m = most(&mut self.done.iter().filter_map(|(step, _)| step.steady_error_m).map(f64::abs));
    }
}

/// Watches one flight; a field for each thing it remembers, hence so many.
pub(crate) struct Judge {
    /// Sensors that are attacked, rotors that are or break, and from when on, s.
    attacked: Vec<(SensorId, f64)>,
    /// Is it a recording? When its place was known last, s.
    recorded: bool,
    placed_s: Option<f64>,
    /// The tick that was watched last, s.
    last_s: f64,
    from_s: f64,
    /// The script lands or disarms here, s.
    until_s: f64,
    /// As commanded; left by itself, the flight is lost.
    mode: Option<Mode>,
    /// Is a controlled descent what is asked for? From where it began, m.
    comes_down: bool,
    down_from_m: Option<f64>,
    /// Largest |x| and |y|, and altitude, m.
    box_m: (f64, f64),
    tick_s: f64,
    outcome: Outcome,
    means: Means,
    command: Option<MotorCommand>,
    /// Sensors excluded now, and since when, s.
    excluded: Vec<(SensorId, f64)>,
    found: Vec<SensorId>,
    quiet: Quiet,
    signals: Vec<Signal>,
    steps: Steps,
}

/// Healthy sensors that count for almost nothing: since when, s, and whether that is longer than [`QUIET_S`].
#[derive(Debug, Default)]
struct Quiet {
    since: Vec<(SensorId, f64, bool)>,
}

impl Quiet {
    /// `sensor` counts for so much beside the one of its kind that counts most.
    fn take(&mut self, t: f64, sensor: SensorId, counts: f64, outcome: &mut Outcome) {
        let known = self.since.iter().position(|(id, ..)| *id == sensor);
        // What is no number counts for nothing either.
        let nothing = counts.is_nan() || counts < NOTHING;
        match known.and_then(|at| self.since.get_mut(at)) {
            Some((_, since, long)) if nothing => {
                let lasts_s = t - *since;
                outcome.quiet_longest_s = outcome.quiet_longest_s.max(lasts_s);
                if lasts_s > QUIET_S && !*long {
                    (*long, outcome.quiet_exclusions) = (true, outcome.quiet_exclusions + 1);
                }
            }
            None if nothing => self.since.push((sensor, t, false)),
            _ => self.forget(sensor),
        }
    }

    /// It is attacked, or silent.
    fn forget(&mut self, sensor: SensorId) {
        self.since.retain(|(id, ..)| *id != sensor);
    }
}

/// One signal's normalised innovations squared: their faded mean, and when the last one came, s.
#[derive(Debug, Clone, Copy)]
struct Signal {
    sensor: SensorId,
    channel: Channel,
    mean: f64,
    last_s: f64,
}

impl Judge {
    pub(crate) fn new(setup: &Setup) -> Self {
        let from_s = setup.judged_from_s.max(STEADY_S);
        let steps = &setup.scenario.script.steps;
        let mut modes = steps.iter().rev().filter(|step| step.at_s <= from_s).filter_map(|step| match step.command {
            Command::SetMode(mode) => Some(mode),
            _ => None,
        });
        let ends = |command: &Command| matches!(command, Command::Disarm | Command::SetMode(_));
        let given = setup.attacks.iter().map(|attack| (attack.sensor, attack.start_s));
        let attacked = given.chain(setup.recording.iter().flat_map(|recorded| recorded.attacked.iter().copied()));
        // Of a recording nothing breaks again, and a rotor that loses nothing is whole.
        let broken = setup.scenario.broken.iter().filter(|broken| setup.recording.is_none() && broken.left < 1.0);
        let broken = broken.map(|broken| (SensorId::new(SensorKind::Rotor, broken.rotor as u8), broken.at_s));
        let until = steps.iter().find(|step| step.at_s > from_s && ends(&step.command));
        Self {
            attacked: attacked.chain(broken).collect(),
            recorded: setup.recording.is_some(),
            placed_s: None,
            last_s: 0.0,
            from_s,
            until_s: until.map_or(f64::INFINITY, |step| step.at_s),
            mode: modes.next(),
            comes_down: setup.comes_down,
            down_from_m: None,
            box_m: (setup.config.limits.lateral_max_m, setup.config.altitude_max_m()),
            tick_s: setup.scenario.tick_s(),
            outcome: Outcome::default(),
            means: Means::default(),
            command: None,
            excluded: Vec::new(),
            found: Vec::new(),
            quiet: Quiet::default(),
            signals: Vec::new(),
            steps: Steps::of(setup, from_s),
        }
    }

    /// One tick; true when the flight is over.
    pub(crate) fn tick(&mut self, t: f64, flight: &Flight, seen: &Seen) -> bool {
        self.last_s = t;
        self.exclusions(t, flight);
        let begun = self.attacked.iter().map(|(_, onset_s)| *onset_s).fold(f64::INFINITY, f64::min);
        let contradicted = flight.judge().is_some_and(|judge| judge.isolation().contradicted());
        // Failsafes of a flight that only watches say nothing.
        let failsafe = !self.recorded && flight.failsafe() != Failsafe::None;
        if t >= begun && (contradicted || failsafe) {
            self.outcome.declared_s.get_or_insert(t - begun);
        }
        if t < self.from_s {
            return false;
        }
        if t >= self.until_s {
            return true;
        }
        let deed = seen.deed(flight);
        if self.recorded {
            // Formats that know no mode are taken whole.
            let flies = deed.mode == Mode::Unspecified || deed.armed && deed.mode != Mode::Land;
            if flies {
                self.judge(t, flight, seen, &deed);
            }
            return false;
        }
        let Some(truth) = &seen.truth else { return true };
        let error_m = truth.position_enu_m.z - deed.setpoint_enu_m.z;
        let ended = !deed.armed || self.mode.is_some_and(|mode| deed.mode != mode);
        if self.comes_down && (self.down_from_m.is_some() || ended && flight.failsafe() != Failsafe::None) {
            return self.descends(truth, deed.armed);
        }
        let steered = matches!(deed.mode, Mode::AltitudeHold | Mode::Hold);
        if ended || (steered && error_m.abs() > ASTRAY_M) {
            let why = if ended { format!("{:?}", flight.failsafe()) } else { format!("{error_m:.2} m astray") };
            self.outcome.altitude_most_m = self.outcome.altitude_most_m.max(error_m.abs());
            self.outcome.lost = Some(why);
            return true;
        }
        self.judge(t, flight, seen, &deed);
        false
    }

    /// One tick in the air.
    fn judge(&mut self, t: f64, flight: &Flight, seen: &Seen, deed: &Deed) {
        let Some(estimate) = flight.estimate_in_loop() else { return };
        if let Some(place) = seen.place_enu_m(flight) {
            self.place(t, place, deed);
            self.steps.tick(t, place.z, deed.setpoint_enu_m.z);
        }
        if let Some(reference) = &seen.reference {
            self.compare(reference, estimate);
            let judge = flight.judge().filter(|judge| judge.kind() == flight.estimator_in_loop());
            let off_m = estimate.kinematics().position_enu_m.z - reference.position_enu_m.z;
            if let Some(bound_m) = judge.and_then(|judge| judge.height_bound_m()).filter(|_| off_m.is_finite()) {
                self.means.beyond_bound.add(f64::from(off_m.abs() > bound_m));
            }
        }
        for residual in estimate.residuals.iter().filter(|residual| residual.accepted && residual.sigma > 0.0) {
            self.means.nis.add((residual.innovation / residual.sigma).powi(2));
        }
        if let Some(command) = deed.command
            && let Some(before) = self.command.replace(command)
        {
            let changes = before.throttle.iter().zip(&command.throttle).map(|(old, new)| (new - old).abs());
            self.means.effort.add(changes.sum::<f64>() / self.tick_s);
        }
        self.alarm(t, &estimate.residuals);
    }

    /// One tick of a descent that a failsafe began; true when it is over.
    fn descends(&mut self, truth: &Truth, armed: bool) -> bool {
        let (z_m, climb_mps) = (truth.position_enu_m.z, truth.velocity_enu_mps.z);
        let from_m = *self.down_from_m.get_or_insert(z_m);
        let why = if z_m > from_m + ASTRAY_M {
            Some("flew away")
        } else if climb_mps < -FALLS_MPS {
            Some("fell")
        } else if !armed && z_m > DOWN_M {
            Some("stopped in the air")
        } else {
            None
        };
        self.outcome.lost = why.or(armed.then_some("not down yet")).map(str::to_owned);
        why.is_some() || !armed
    }

    /// Where it is in one tick, against where it is to be and where it may be.
    fn place(&mut self, t: f64, place: Vector3<f64>, deed: &Deed) {
        let off_m = place - deed.setpoint_enu_m;
        if off_m.z.is_finite() {
            self.means.altitude.add(off_m.z * off_m.z);
            self.outcome.altitude_most_m = self.outcome.altitude_most_m.max(off_m.z.abs());
        }
        let across = off_m.xy().norm_squared();
        if deed.mode == Mode::Hold && across.is_finite() {
            self.means.lateral.add(across);
        }
        // A recording knows it now and then.
        let since_s = t - self.placed_s.replace(t).unwrap_or(t);
        let (lateral_m, altitude_m) = self.box_m;
        if place.x.abs() > lateral_m || place.y.abs() > lateral_m || place.z > altitude_m {
            self.outcome.outside_s += if self.recorded { since_s } else { self.tick_s };
        }
    }

    /// True and estimated state of one tick.
    fn compare(&mut self, reference: &Truth, estimate: &Estimate) {
        let means = &mut self.means;
        let up = |q: &UnitQuaternion<f64>| q.inverse() * Vector3::z();
        let tilt = up(&reference.world_from_body).angle(&up(&estimate.world_from_body));
        means.tilt.add(tilt * tilt);
        let known = estimate.motion.filter(|motion| motion.altitude_known && reference.position_enu_m.z.is_finite());
        if let Some(motion) = known {
            let off_m = motion.position_enu_m.z - reference.position_enu_m.z;
            means.estimate.add(off_m * off_m);
            if let Some(sigma_m) = motion.position_sigma_m.filter(|sigma_m| sigma_m.z > 0.0) {
                means.nees.add((off_m / sigma_m.z).powi(2));
            }
        }
    }

    /// What a χ² detector on each signal would see, whatever became of the samples.
    fn alarm(&mut self, t: f64, residuals: &[Residual]) {
        // They come in the same order from tick to tick: the next one is looked for after the last.
        let mut from = 0;
        for residual in residuals.iter().filter(|residual| residual.sigma > 0.0) {
            let is = |signal: &Signal| signal.sensor == residual.sensor && signal.channel == residual.channel;
            let (before, after) = self.signals.split_at(from.min(self.signals.len()));
            let known = after.iter().position(is).map(|at| at + before.len()).or_else(|| before.iter().position(is));
            let at = known.unwrap_or(self.signals.len());
            if known.is_none() {
                let Residual { sensor, channel, .. } = *residual;
                self.signals.push(Signal { sensor, channel, mean: 1.0, last_s: t - self.tick_s });
            }
            from = at + 1;
            let Some(signal) = self.signals.get_mut(at) else { continue };
            let weight = 1.0 - (-(t - signal.last_s) / ALARM_S).exp();
            signal.mean += weight * ((residual.innovation / residual.sigma).powi(2) - signal.mean);
            signal.last_s = t;
            self.outcome.nis_most = self.outcome.nis_most.max(signal.mean);
        }
    }

    fn exclusions(&mut self, t: f64, flight: &Flight) {
        // Each with whether it is excluded, and for how much it counts, where it does.
        let judge = flight.judge();
        let devices = judge.iter().flat_map(|judge| {
            let told = |device: &Device| {
                let counts = device.present.then(|| judge.counts(device.sensor));
                (device.sensor, device.flagged.is_some(), counts)
            };
            judge.isolation().devices().iter().map(told)
        });
        let weak = flight.rotors().effectiveness().iter().zip(1_u8..);
        let rotors = weak.map(|(part, instance)| (SensorId::new(SensorKind::Rotor, instance), *part < 1.0, None));
        for (sensor, isolated, counts) in devices.chain(rotors) {
            let of = self.attacked.iter().find(|(id, _)| *id == sensor).map(|(_, onset_s)| *onset_s);
            // What an attack left behind takes a while to be trusted again.
            let attacked = of.is_some_and(|onset_s| t >= onset_s);
            match counts.filter(|_| !attacked) {
                Some(counts) => self.quiet.take(t, sensor, counts, &mut self.outcome),
                None => self.quiet.forget(sensor),
            }
            let known = self.excluded.iter().position(|(id, _)| *id == sensor);
            match (isolated, known) {
                (true, None) => {
                    self.excluded.push((sensor, t));
                    match of {
                        Some(onset_s) if attacked => {
                            if !self.found.contains(&sensor) {
                                self.found.push(sensor);
                                self.outcome.delays_s.push(t - onset_s);
                            }
                        }
                        _ => self.outcome.false_exclusions += 1,
                    }
                }
                (true, Some(known)) if !attacked => {
                    let (_, since) = self.excluded[known];
                    self.outcome.false_longest_s = self.outcome.false_longest_s.max(t - since);
                }
                (false, Some(known)) => {
                    self.excluded.remove(known);
                }
                _ => {}
            }
        }
    }

    pub(crate) fn verdict(mut self) -> Outcome {
        let (outcome, means) = (&mut self.outcome, &self.means);
        // What was to be attacked after the flight was over never was.
        let begun = self.attacked.iter().filter(|(_, onset_s)| *onset_s <= self.last_s);
        outcome.missed = begun.filter(|(sensor, _)| !self.found.contains(sensor)).count();
        if self.recorded && means.altitude.count == 0.0 {
            outcome.altitude_most_m = f64::NAN;
        }
        if self.recorded && self.placed_s.is_none() {
            outcome.outside_s = f64::NAN;
        }
        outcome.altitude_m = means.altitude.value().sqrt();
        outcome.lateral_m = means.lateral.value().sqrt();
        outcome.tilt_rad = means.tilt.value().sqrt();
        outcome.estimate_m = means.estimate.value().sqrt();
        outcome.nees = means.nees.value();
        outcome.nis = means.nis.value();
        outcome.effort_per_s = means.effort.value();
        outcome.outside_bound = means.beyond_bound.value();
        self.steps.tell(outcome);
        self.outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Plan;

    #[test]
    fn what_broke_before_the_end_is_missed() {
        let missed = |(left, last_s): (f64, f64)| {
            let broken = format!("broken = [{{ rotor = 1, at_s = 20, left = {left:?} }}]");
            let plan = Plan::from_toml(&format!("name = \"a\"\n[scenario]\nduration_s = 30\n{broken}\n")).unwrap();
            Judge { last_s, ..Judge::new(&plan.condition(0).unwrap().setup(1)) }.verdict().missed
        };
        // It loses a fifth, or nothing; the flight was over before.
        assert_eq!([(0.8, 29.0), (1.0, 29.0), (0.8, 19.0)].map(missed), [1, 0, 0]);
    }

    #[test]
    fn what_counts_for_almost_nothing_longer_than_a_second_is_as_good_as_excluded() {
        let told = |part: &dyn Fn(f64) -> f64| {
            let (mut quiet, mut outcome) = (Quiet::default(), Outcome::default());
            for tick in 0..1000 {
                let t = f64::from(tick) * 0.01;
                [1, 2].into_iter().for_each(|i| {
                    let counts = if i == 1 { part(t) } else { 1.0 };
                    quiet.take(t, SensorId::new(SensorKind::Imu, i), counts, &mut outcome);
                });
            }
            (outcome.quiet_exclusions, (10.0 * outcome.quiet_longest_s).round())
        };
        assert_eq!(told(&|_| 1.0), (0, 0.0));
        // A tenth counts; a thousandth does not, nor what is no number.
        assert_eq!(told(&|t| if t > 3.0 { 0.1 } else { 1.0 }), (0, 0.0));
        for nothing in [1e-3, 0.0, f64::NAN] {
            assert_eq!(told(&|t| if (3.0..3.9).contains(&t) { nothing } else { 1.0 }), (0, 9.0));
            assert_eq!(told(&|t| if (3.0..5.0).contains(&t) || t > 7.9 { nothing } else { 1.0 }), (2, 21.0));
        }
    }

    #[test]
    fn steps_are_measured_by_where_the_vehicle_is_and_the_worst_one_is_told() {
        // A lag of 0.4 s, then one that stays 0.1 m short of a step of 0.3 m.
        let mut steps = Steps { due: vec![(20.0, 0.9, 1.2), (5.0, 0.5, 0.9)], ..Steps::default() };
        for tick in 0..6000 {
            let t = f64::from(tick) * 0.005;
            let (start_s, from_m, to_m) = if t < 20.0 { (5.0, 0.5, 0.9) } else { (20.0, 0.9, 1.1) };
            let z_m = to_m + (from_m - to_m) * (-(t - start_s).max(0.0) / 0.4).exp();
            steps.tick(t, z_m, to_m);
        }
        let mut outcome = Outcome::default();
        steps.tell(&mut outcome);
        // The second one passes 90 % never; 0.4 ln 9 = 0.879 s is the first one's.
        assert!((outcome.rise_s - 0.4 * 9.0_f64.ln()).abs() < 0.01, "{outcome:?}");
        assert_eq!(outcome.overshoot_percent, 0.0);
        assert!((outcome.settling_s - 9.995).abs() < 0.01 && (outcome.steady_m - 0.1).abs() < 1e-3, "{outcome:?}");

        let mut none = Outcome::default();
        Steps::default().tell(&mut none);
        assert!(none.rise_s.is_nan() && none.settling_s.is_nan(), "no step, nothing measured");
    }
}
