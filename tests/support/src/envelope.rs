//! The attack envelope flown: one flight with an attack beside the same one without it, until somebody is excluded.
//!
//! Free, altitude hold at 1 m, the lanes in the loop, an operator who keeps the vehicle over its place.

pub mod aside;

use plumbline_agent::attack::{Attack, Bounds as Limits, Channel, Kind, Sequence};
use plumbline_agent::command::Command;
use plumbline_agent::control::trajectory::{Shape, Trajectory};
use plumbline_agent::envelope::flying::{Loop, Regime};
use plumbline_agent::envelope::sets::{Asked, Found, Verdict, verdict};
use plumbline_agent::envelope::{Deviation, Model, Signal, columns, program};
use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_agent::flight::Failsafe;
use plumbline_agent::flight::watermark::{Block, Settings};
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::script::Step;
use plumbline_agent::types::EstimatorKind;
use plumbline_experiment::flight::{Setup, fly_watched};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::envelope::{EnvelopeQuestion, PreparedAttack, Swing};
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Onset, s: where slots and heights begin together, long after everything was learned.
const ONSET_S: f64 = 24.0;
/// Of the bounds, s.
pub const HORIZON_S: f64 = 10.0;
/// Flown on behind it, s.
const AFTER_S: f64 = 0.2;
const TICK_RATE_HZ: f64 = 200.0;
/// What the linear loop leaves out is less than this: a flight may reach so much of its bound.
pub const LINEAR: f64 = 1.01;
/// Ticks until the bound's: it is that at the beginning of the last slot.
const LAST: usize = ((HORIZON_S - 0.04) * TICK_RATE_HZ) as usize;

/// A flight from the onset on.
#[derive(Debug, Clone, Default)]
pub struct Flown {
    /// True altitude at each tick, m.
    pub altitude_m: Vec<f64>,
    /// Along x and along y there: pitch or roll, rad, velocity, m/s, and position, m.
    pub aside: Vec<[[f64; 3]; 2]>,
    /// Ticks from the onset to the first exclusion, to heights that contradict each other, or to a failsafe.
    pub seen: Option<usize>,
    /// Who was excluded.
    pub excluded: Vec<SensorId>,
    /// The most that the statistic of each sensor reached, of its limit.
    pub ratios: Vec<(SensorId, f64)>,
    /// What the lanes measured of their accelerometers: the largest of each, …
    pub shaken: Shaken,
    /// … and the mean over time.
    pub usual: Shaken,
    /// What the blocks of the watermark told: seconds since the onset at their end.
    pub carried: Vec<(f64, Block)>,
}

impl Flown {
    /// The most that a statistic of `sensors` reached; infinite where one of them was excluded.
    pub fn score(&self, sensors: &[SensorId]) -> f64 {
        let excluded = sensors.iter().any(|sensor| self.excluded.contains(sensor));
        let of = self.ratios.iter().filter(|(sensor, _)| sensors.contains(sensor)).map(|(_, ratio)| *ratio);
        if excluded { f64::INFINITY } else { of.fold(0.0, f64::max) }
    }

    /// Furthest from `clean` before anything was seen, m.
    pub fn unseen_m(&self, clean: &Self) -> f64 {
        let until = self.seen.unwrap_or(LAST).min(LAST);
        let apart = self.altitude_m.iter().zip(&clean.altitude_m).take(until).map(|(a, b)| (a - b).abs());
        apart.fold(0.0, f64::max)
    }
}

impl Flown {
    /// The same along a horizontal `axis`, of a bound over `horizon_s`: tilt, rad, velocity, m/s, position, m.
    pub fn unseen_aside(&self, clean: &Self, axis: usize, horizon_s: f64) -> [f64; 3] {
        // Until the bound's, which is that at the beginning of the last slot.
        let last = ((horizon_s - 0.04) * TICK_RATE_HZ).round() as usize + 1;
        let until = self.seen.unwrap_or(usize::MAX).min(last);
        std::array::from_fn(|i| {
            let apart = self.aside.iter().zip(&clean.aside).take(until).map(|(a, b)| (a[axis][i] - b[axis][i]).abs());
            apart.fold(0.0, f64::max)
        })
    }
}

/// What is added to some sensors: their samples one after another.
#[derive(Debug, Clone, Default)]
pub struct Worn {
    attacks: Vec<Attack>,
    sequences: Vec<Sequence>,
    /// When each height samples first, s; nothing is changed of those that none is told of.
    phases_s: Vec<Option<f64>>,
}

impl Worn {
    /// These attacks, at the onset.
    pub fn these(
        attacks: impl IntoIterator<Item = (SensorId, Channel, Kind, f64)>,
        duration_s: f64,
        seed: u64,
    ) -> Self {
        let one = |(id, (sensor, channel, kind, magnitude))| Attack {
            id,
            sensor,
            channel,
            kind,
            start_s: ONSET_S,
            duration_s,
            magnitude,
            seed,
        };
        Self { attacks: (1..).zip(attacks).map(one).collect(), ..Self::default() }
    }

    /// The same, times `part`.
    pub fn scaled(mut self, part: f64) -> Self {
        self.attacks.iter_mut().for_each(|attack| attack.magnitude *= part);
        self
    }

    /// `attack` of a program of `model`, times `part`, within what the agent allows.
    pub fn new(model: &dyn Model, attack: &Signal, part: f64) -> Self {
        let mut worn = Self::default();
        for ((sensor, first, count), (_, period_s, _)) in columns(model, HORIZON_S).into_iter().zip(model.attacked()) {
            let channel = if sensor.kind == SensorKind::Imu { Channel::AccelAxis(2) } else { Channel::All };
            worn.add(sensor, channel, HORIZON_S, period_s, attack.rows(first, count).iter().map(|value| part * value));
        }
        worn
    }

    /// As a scenario has it.
    fn phases(&self) -> String {
        let known = (1..).zip(&self.phases_s).filter_map(|(instance, phase_s)| Some((instance, phase_s.as_ref()?)));
        let sensor = |(instance, phase_s): (u8, &f64)| {
            format!("[[sensor]]\nkind = \"height\"\ninstance = {instance}\nphase_s = {phase_s:?}\n")
        };
        known.map(sensor).collect()
    }

    /// Adds `values` to a sensor, one every `period_s`, within what the agent allows.
    fn add(
        &mut self,
        sensor: SensorId,
        channel: Channel,
        duration_s: f64,
        period_s: f64,
        values: impl Iterator<Item = f64>,
    ) {
        let bounds = Limits::default();
        let allowed = match channel {
            Channel::AccelAxis(_) => bounds.accel_max_mps2,
            Channel::GyroAxis(_) => bounds.rate_max_radps,
            _ => bounds.length_max_m,
        };
        let added: Vec<f64> = values.map(|value| value.clamp(-allowed, allowed)).collect();
        let magnitude = added.iter().fold(1e-9, |most: f64, value| most.max(value.abs()));
        let id = self.attacks.len() as u32 + 1;
        let (start_s, kind) = (ONSET_S, Kind::Bias);
        self.attacks.push(Attack { id, sensor, channel, kind, start_s, duration_s, magnitude, seed: 1 });
        let values = added.into_iter().map(|value| value / magnitude).collect();
        self.sequences.push(Sequence { attack: id, period_s, values });
    }
}

/// What is added at `time_s` of `length_s`: by `shape` 0 a step, 1 a ramp, 2 a sine, else noise of these `dice`.
fn drawn_value(shape: usize, time_s: f64, length_s: f64, period_s: f64, dice: &mut Xoshiro256PlusPlus) -> f64 {
    match shape {
        0 => 1.0,
        1 => time_s / length_s,
        2 => (std::f64::consts::TAU * time_s / period_s).sin(),
        _ => dice.random_range(-1.0..1.0),
    }
}

impl Worn {
    /// What was prepared, from so long after the usual onset on, s: a sample of the height that its thrust is held between.
    pub fn prepared(attack: &PreparedAttack, late_s: f64) -> Self {
        let mut worn = Self::default();
        for (id, one) in (1..).zip(&attack.attacks) {
            worn.attacks.push(Attack {
                id,
                sensor: format!("{} {}", one.sensor, one.instance).parse().unwrap(),
                channel: channel_of(&one.channel),
                kind: Kind::Bias,
                start_s: ONSET_S + late_s + one.start_s,
                duration_s: one.duration_s,
                magnitude: one.magnitude,
                seed: one.seed,
            });
            let period_s = one.sequence_period_s.unwrap();
            worn.sequences.push(Sequence { attack: id, period_s, values: one.sequence.clone() });
        }
        worn
    }
}

/// A channel by its name in a schedule.
fn channel_of(name: &str) -> Channel {
    match name {
        "all" => Channel::All,
        "accel_x" => Channel::AccelAxis(0),
        "accel_y" => Channel::AccelAxis(1),
        "accel_z" => Channel::AccelAxis(2),
        "gyro_x" => Channel::GyroAxis(0),
        "gyro_y" => Channel::GyroAxis(1),
        other => panic!("no generator attacks {other}"),
    }
}

/// Flies `worn` in `world`: `ideal`, `bench`, `datasheet` or `harsh`.
pub fn fly(world: &str, seed: u64, worn: &Worn) -> Flown {
    fly_for(world, seed, worn, HORIZON_S, None)
}

/// The same for `horizon_s`, with this watermark.
pub fn fly_for(world: &str, seed: u64, worn: &Worn, horizon_s: f64, watermark: Option<Settings>) -> Flown {
    fly_with(world, seed, worn, horizon_s, watermark, false)
}

/// Flies `worn` in `world` under motion capture, its position held.
pub fn fly_held(world: &str, seed: u64, worn: &Worn, horizon_s: f64) -> Flown {
    fly_with(world, seed, worn, horizon_s, None, true)
}

/// Flies `worn` in `world` along a heave, m and s, of which a swing begins with the onset: the agent's own path.
pub fn fly_heaving(world: &str, seed: u64, worn: &Worn, (amplitude_m, period_s): (f64, f64)) -> Flown {
    let path = path(Shape::Heave { amplitude_m, period_s }, period_s, 0.0);
    fly_scripted(world, seed, worn, HORIZON_S, None, ("altitude_hold", "", Some(path)))
}

/// Flies `worn` in `world` under motion capture along a circle, m and s, whose swing along `axis` (0: x, 1: y) begins with the onset: the
/// agent's own path.
pub fn fly_circling(world: &str, seed: u64, worn: &Worn, axis: usize, (radius_m, period_s): (f64, f64)) -> Flown {
    // It begins in the middle of its swing along x, and at the end of that along y.
    let turned = if axis == 0 { 0.0 } else { 0.25 };
    let path = path(Shape::Circle { radius_m, period_s }, period_s, turned * period_s);
    fly_scripted(world, seed, worn, aside::ASIDE_S, None, ("hold", "add = [\"mocap_pose\"]\n", Some(path)))
}

/// `shape`, begun so that `late_s` of a period are flown at the onset.
fn path(shape: Shape, period_s: f64, late_s: f64) -> Step {
    // A path's own time is so far behind once its soft start is over.
    const SOFT_S: f64 = 1.0;
    let turns = ((ONSET_S - 9.0 - SOFT_S - late_s) / period_s).floor();
    let at_s = ONSET_S - SOFT_S - late_s - turns * period_s;
    Step { at_s, command: Command::Trajectory(Some(Trajectory::Shape { shape, duration_s: 0.0 })) }
}

fn fly_with(world: &str, seed: u64, worn: &Worn, horizon_s: f64, watermark: Option<Settings>, held: bool) -> Flown {
    let (mode, add) = if held { ("hold", "add = [\"mocap_pose\"]\n") } else { ("altitude_hold", "") };
    fly_scripted(world, seed, worn, horizon_s, watermark, (mode, add, None))
}

/// In a mode, with more of the suite and a last step of the script.
fn fly_scripted(
    world: &str,
    seed: u64,
    worn: &Worn,
    horizon_s: f64,
    watermark: Option<Settings>,
    (mode, add, last): (&str, &str, Option<Step>),
) -> Flown {
    let duration_s = ONSET_S + horizon_s + AFTER_S;
    let text = format!(
        "name = \"envelope\"\nseed = {seed}\nduration_s = {duration_s}\nworld = \"{world}\"\ntick_rate_hz = {TICK_RATE_HZ}\n\
         [[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"{mode}\"\n\
         [[script]]\nat_s = 5\ndo = \"setpoint\"\naltitude_m = 1.0\n[rig.free]\nheight_m = 0.0\n[suite]\npreset = \"string_rig\"\n{add}{}",
        worn.phases()
    );
    let mut scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    scenario.script.steps.extend(last);
    let mut config = scenario.flight_config();
    (config.estimators, config.in_loop) = (vec![EstimatorKind::Lanes], EstimatorKind::Lanes);
    config.watermark = watermark;
    let setup = Setup {
        attacks: worn.attacks.clone(),
        sequences: worn.sequences.clone(),
        ..Setup::simulated(scenario, config, ONSET_S)
    };
    let (mut tick, mut flown) = (0, Flown::default());
    let before = (ONSET_S * TICK_RATE_HZ) as usize;
    let outcome = fly_watched(&setup, |flight, truth| {
        tick += 1;
        if tick <= before {
            return;
        }
        let lanes = flight.lanes().unwrap();
        for device in lanes.isolation().devices() {
            let ratio = device.evidence.window_ratio;
            match flown.ratios.iter_mut().find(|(sensor, _)| *sensor == device.sensor) {
                Some((_, most)) => *most = most.max(ratio),
                None => flown.ratios.push((device.sensor, ratio)),
            }
        }
        for device in lanes.isolation().devices().iter().filter(|device| device.flagged.is_some()) {
            if !flown.excluded.contains(&device.sensor) {
                flown.excluded.push(device.sensor);
            }
            flown.seen.get_or_insert(flown.altitude_m.len());
        }
        // Heights that contradict each other are announced, and none of them is excluded.
        if lanes.isolation().contradicted() || flight.failsafe() != Failsafe::None {
            flown.seen.get_or_insert(flown.altitude_m.len());
        }
        let (now, count) = (lanes.shaken(), (tick - before) as f64);
        flown.shaken = largest([flown.shaken, now]);
        flown.usual.noise_mps2 += (now.noise_mps2 - flown.usual.noise_mps2) / count;
        flown.usual.rectified_mps2 += (now.rectified_mps2 - flown.usual.rectified_mps2) / count;
        if let Some((time, block)) = flight.watermark() {
            let since_s = time.as_seconds() - ONSET_S;
            if flown.carried.last().is_none_or(|(last_s, _)| since_s > *last_s) {
                flown.carried.push((since_s, block));
            }
        }
        flown.altitude_m.push(truth.position_enu_m.z);
        let (tilt_rad, speed_mps, place_m) =
            (roll_pitch_yaw(&truth.world_from_body), truth.velocity_enu_mps, truth.position_enu_m);
        flown.aside.push([[tilt_rad.y, speed_mps.x, place_m.x], [tilt_rad.x, speed_mps.y, place_m.y]]);
    });
    if outcome.unwrap().lost.is_some() {
        flown.seen.get_or_insert(flown.altitude_m.len());
    }
    flown
}

/// The largest of each.
pub fn largest(all: impl IntoIterator<Item = Shaken>) -> Shaken {
    all.into_iter().fold(Shaken::default(), |most, one| Shaken {
        noise_mps2: most.noise_mps2.max(one.noise_mps2),
        rectified_mps2: most.rectified_mps2.max(one.rectified_mps2),
    })
}

/// A set of sensors, how far it can be pushed unseen, m, and what does.
#[derive(Debug, Clone)]
pub struct Set {
    /// With heights that sample when the sequences are made for.
    flying: Loop,
    /// Whether they are to be flown so; else they are flown as the suite has them.
    moved: bool,
    /// Those attacked.
    pub sensors: Vec<SensorId>,
    /// The bound, m.
    pub bound_m: f64,
    /// What the worst attack reaches in the linear loop, m.
    pub reached_m: f64,
    /// The detector that holds the bound.
    pub binding: &'static str,
    /// The maximising sequences: that of the regime that gives the bound first.
    worst: Vec<Signal>,
}

impl Set {
    /// For people.
    pub fn name(&self) -> String {
        self.sensors.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }

    /// No attack, heights that sample as those do that are attacked.
    pub fn none(&self) -> Worn {
        let phases_s = if self.moved { self.flying.phases_s().collect() } else { Vec::new() };
        Worn { phases_s, ..Worn::default() }
    }
}

/// What a question about the default suite is asked with.
pub fn asked_with(Shaken { noise_mps2, rectified_mps2 }: Shaken) -> EnvelopeQuestion {
    let [noise_mps2, rectified_mps2] = [noise_mps2, rectified_mps2].map(Some);
    EnvelopeQuestion { noise_mps2, rectified_mps2, ..EnvelopeQuestion::default() }
}

/// Every set of one or two sensors of the default suite.
pub struct Bounds {
    /// In order.
    pub sets: Vec<Set>,
}

impl Bounds {
    /// Where the lanes measure this of their accelerometers, flown with heights that sample at the moments at which each set does the most.
    pub fn new(shaken: Shaken) -> Self {
        Self::along(shaken, None, None)
    }

    /// The same bounds, flown with heights that sample when the suite has it.
    pub fn sampled(shaken: Shaken) -> Self {
        Self::made(&asked_with(shaken), false)
    }

    /// The same along a heave, m and s, or of one set only.
    pub fn along(shaken: Shaken, heave: Option<(f64, f64)>, only: Option<&str>) -> Self {
        let swing = heave.map(|(amplitude_m, period_s)| Swing { amplitude_m, period_s });
        let sensors = only.map(|names| names.split(", ").map(str::to_owned).collect());
        Self::asked(&EnvelopeQuestion { swing, sensors, ..asked_with(shaken) })
    }

    /// Those of a question.
    pub fn asked(question: &EnvelopeQuestion) -> Self {
        Self::made(question, true)
    }

    fn made(question: &EnvelopeQuestion, moved: bool) -> Self {
        let asked = Asked::new(question, None).unwrap();
        let of = |flying: &Loop, sensors: &[SensorId]| {
            let Found { verdict, regime, .. } = verdict(flying, sensors, HORIZON_S, Deviation::Place).unwrap();
            let Verdict::Bounded(bound, _) = verdict else { return None };
            let mut worst = vec![bound.attack.clone()];
            if regime != Regime::Full {
                let full = flying.attacked(sensors, Regime::Full).unwrap();
                worst.push(program(&full, HORIZON_S, Deviation::Place).unwrap().solve().unwrap().attack);
            }
            Some((bound, worst))
        };
        let bounded = |sensors: &Vec<SensorId>| {
            let at_worst = asked.flying.at_worst_moments(sensors);
            let (bound, mut worst) = of(&at_worst, sensors)?;
            let flying = if moved { at_worst } else { asked.flying.clone() };
            if !moved {
                (_, worst) = of(&flying, sensors)?;
            }
            let binding = bound.binding.unwrap_or("most that may be added");
            let (sensors, bound_m, reached_m) = (sensors.clone(), bound.upper, bound.reached);
            Some(Set { flying, moved, sensors, bound_m, reached_m, binding, worst })
        };
        Self { sets: asked.sets.iter().filter_map(bounded).collect() }
    }

    /// Of each set the larger bound of both.
    pub fn or(mut self, other: Self) -> Self {
        for (own, other) in self.sets.iter_mut().zip(other.sets) {
            if other.bound_m > own.bound_m {
                *own = other;
            }
        }
        self
    }
}

impl Set {
    fn worn(&self, attack: &Signal, part: f64) -> Worn {
        let worn = Worn::new(&self.flying.attacked(&self.sensors, Regime::Full).unwrap(), attack, part);
        Worn { phases_s: self.none().phases_s, ..worn }
    }

    /// Its maximising sequence, times `part`.
    pub fn worst(&self, part: f64) -> Worn {
        self.worn(&self.worst[0], part)
    }

    /// Each maximising sequence, times each of `parts`, the whole first.
    pub fn all_worst<'a>(&'a self, parts: &'a [f64]) -> impl Iterator<Item = (f64, Worn)> + 'a {
        parts.iter().flat_map(move |part| self.worst.iter().map(move |one| (*part, self.worn(one, *part))))
    }

    /// An attack drawn by `seed`, and what it is: a step, a ramp, a sine or noise in each sensor, or the maximising sequence
    /// smaller or larger.
    pub fn drawn(&self, seed: u64) -> (&'static str, Worn) {
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
        let shape = dice.random_range(0..5);
        if shape == 4 {
            return ("worst", self.worst(dice.random_range(0.5..1.3)));
        }
        let model = self.flying.attacked(&self.sensors, Regime::Full).unwrap();
        let mut values = Vec::new();
        for ((sensor, every_s, _), (_, _, count)) in model.attacked().into_iter().zip(columns(&model, HORIZON_S)) {
            // From what nobody could see to what everybody must.
            let (least, most): (f64, f64) = if sensor.kind == SensorKind::Imu { (0.05, 3.0) } else { (0.005, 0.3) };
            let sign = if dice.random_bool(0.5) { 1.0 } else { -1.0 };
            let size = sign * (dice.random_range(least.ln()..most.ln())).exp();
            let period_s = dice.random_range(0.5..10.0);
            let at = |k| size * drawn_value(shape, k as f64 * every_s, HORIZON_S, period_s, &mut dice);
            values.extend((0..count).map(at));
        }
        (["step", "ramp", "sine", "noise"][shape], self.worn(&Signal::from_vec(values), 1.0))
    }
}
