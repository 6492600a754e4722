//! One flight of a case: who estimates, and how it went.

use plumbline_agent::attack::{Attack, Injector, Schedule};
use std::collections::VecDeque;

use nalgebra::Vector2;
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::estimate::fdir::isolation::Isolation;
use plumbline_agent::flight::{Failsafe, Flight};
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::height::Height;
use plumbline_agent::sensor::imu::{Imu, ImuSample};
use plumbline_agent::sensor::suite::Sheet as _;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::{EstimatorKind, GRAVITY_MPS2, Mode};
use plumbline_agent::vehicle::{Truth, Vehicle as _};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::case::{Attacked, Case};
use crate::draw::median;

/// Judged from here on, s; no attack begins before.
const STEADY_S: f64 = 12.0;
const END_S: f64 = 40.0;
/// Altitudes: from when, s, and how high, m.
const STEPS: [(f64, f64); 3] = [(5.0, 0.9), (18.0, 1.2), (29.0, 0.8)];
/// Further than this from its setpoint, m, a flight is lost whatever else it says.
const ASTRAY_M: f64 = 0.5;
/// A descent faster than this, m/s, is a fall; one that ends higher than this, m, ended in the air (strings begin at 0.3 m).
const FALLS_MPS: f64 = 1.5;
const DOWN_M: f64 = 0.45;
/// Free, and on strings: by turns of the seed.
const RIGS: [&str; 2] = ["[rig.free]\nheight_m = 0.0\n", "[rig.hanging_strings]\nmode = \"flight\"\nheight_m = 0.3\n"];
/// A sample of a unit with a clock of its own is used for the median so long, s.
const FRESH_S: f64 = 0.03;

/// Who estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pilot {
    /// The estimator of this name, as it is shipped: gates, votes, cross-checks.
    Shipped(EstimatorKind),
    /// The shipped EKF, which never hears the attacked sensors while they are attacked.
    Oracle,
    /// The shipped EKF with one IMU and one height, each the median of all.
    Median,
}

impl Pilot {
    pub const EKF: Self = Self::Shipped(EstimatorKind::EkfBias);
    pub const ALL: [Self; 5] = [
        Self::EKF,
        Self::Median,
        Self::Shipped(EstimatorKind::Secure),
        Self::Shipped(EstimatorKind::Lanes),
        Self::Oracle,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Shipped(EstimatorKind::EkfBias) => "shipped EKF",
            Self::Shipped(EstimatorKind::Secure) => "secure",
            Self::Shipped(EstimatorKind::Lanes) => "lanes",
            Self::Shipped(_) => "another",
            Self::Oracle => "oracle",
            Self::Median => "median fusion",
        }
    }

    /// Does it say which sensors it excludes?
    pub fn judges(self) -> bool {
        matches!(self, Self::Shipped(EstimatorKind::Secure | EstimatorKind::Lanes))
    }

    fn estimator(self) -> EstimatorKind {
        if let Self::Shipped(kind) = self { kind } else { EstimatorKind::EkfBias }
    }
}

/// How it went, from the first onset on (or from when it is steady).
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// True altitude less setpoint, m rms and most.
    pub altitude_m: f64,
    pub altitude_most_m: f64,
    /// Between the true and the estimated vertical, rad rms.
    pub tilt_rad: f64,
    /// Why it was lost: a failsafe that ends the flight, or astray.
    pub lost: Option<String>,
    /// From the onset to the exclusion of each attacked sensor that was, s.
    pub delays_s: Vec<f64>,
    pub missed: usize,
    /// Longest exclusion of a healthy sensor, and how many were, s.
    pub false_longest_s: f64,
    pub false_exclusions: usize,
    /// From the first onset until the flight said that it is contradicted, or a failsafe acted, s.
    pub declared_s: Option<f64>,
    /// Outside the bound on the height's error that was announced, as a part of the time there was one.
    pub outside_bound: f64,
}

/// Flies `case` with `seed`; `judged_from_s` is the same for all flights that are compared.
pub fn fly(case: &Case, pilot: Pilot, seed: u64, attacks: &[Attack], judged_from_s: f64) -> Outcome {
    let scenario = scenario(case, seed);
    let mut config = scenario.flight_config();
    config.estimators = vec![pilot.estimator()];
    config.in_loop = pilot.estimator();
    let mut injector = Injector::new(config.attacks.bounds, true, &config.sensors);
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let mut flight = Flight::new(config).unwrap();
    let mut medians = Medians::default();
    let mut judge = Judge::new(attacks, judged_from_s);
    judge.comes_down = matches!(case.attacked, Attacked::Colluding(_));
    let mut operator = Operator::default();
    let mut before = None;
    for tick in 0..(END_S * scenario.tick_rate_hz) as usize {
        let frame = vehicle.sense().unwrap();
        let (now, t) = (frame.time, frame.time.as_seconds());
        flight.heartbeat(now);
        if tick == 0 && !attacks.is_empty() {
            let schedule = Schedule { id: 1, attacks: attacks.iter().copied().collect() };
            // Where somebody stands between the sensors and the vehicle, the attack comes before them.
            if pilot == Pilot::Median {
                injector.upload(&schedule, now).unwrap();
            } else if pilot != Pilot::Oracle {
                let ack = flight.apply(&Command::Attack(schedule), now);
                assert!(ack.accepted, "{}", ack.reason);
            }
        }
        scenario.script.commands(before, now, |command| {
            let _ = flight.apply(command, now);
        });
        before = Some(now);
        if let Some(command) = operator.looks(t, &vehicle.truth().unwrap()) {
            let _ = flight.apply(&command, now);
        }
        let received = match pilot {
            Pilot::Shipped(_) => frame,
            Pilot::Oracle => without(frame, attacks, t),
            Pilot::Median => medians.of(&injector.apply(&frame)),
        };
        let command = flight.step_received(&frame, &received).command;
        let applied = vehicle.actuate(&command).unwrap();
        flight.applied(applied);
        if judge.tick(t, &flight, &vehicle) {
            break;
        }
    }
    judge.verdict()
}

fn scenario(case: &Case, seed: u64) -> Scenario {
    let mut text = format!("name = \"attacks\"\nseed = {seed}\nduration_s = {END_S}\nworld = \"{}\"\n", case.world);
    text += "[[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n";
    for (at_s, altitude_m) in STEPS {
        text += &format!("[[script]]\nat_s = {at_s}\ndo = \"setpoint\"\naltitude_m = {altitude_m}\n");
    }
    text += RIGS[(seed % 2) as usize];
    text += "[suite]\npreset = \"string_rig\"\n";
    let mut scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    scenario.suite.heights = (1..=case.heights).map(|i| Height::laser(i, case.heights)).collect();
    scenario.suite.imus = (1..=case.imus).map(Imu::typical).collect();
    scenario
}

/// `frame` without the samples of those who are attacked at `t`, s.
fn without(mut frame: SensorFrame, attacks: &[Attack], t: f64) -> SensorFrame {
    for attack in attacks.iter().filter(|a| (a.start_s..a.start_s + a.duration_s).contains(&t)) {
        let index = usize::from(attack.sensor.instance) - 1;
        match attack.sensor.kind {
            SensorKind::Imu => frame.imus[index] = None,
            SensorKind::Height => frame.heights[index] = None,
            SensorKind::Barometer => frame.barometers[index] = None,
            other => unreachable!("{other:?} is not attacked here"),
        }
    }
    frame
}

/// One IMU and one height in the place of all: the median of what is fresh, component by component.
#[derive(Default)]
struct Medians {
    last: SensorFrame,
}

impl Medians {
    fn of(&mut self, frame: &SensorFrame) -> SensorFrame {
        self.last.imus.iter_mut().zip(&frame.imus).filter(|(_, new)| new.is_some()).for_each(|(old, new)| *old = *new);
        let heights = self.last.heights.iter_mut().zip(&frame.heights);
        heights.filter(|(_, new)| new.is_some()).for_each(|(old, new)| *old = *new);
        let mut out = *frame;
        let fresh: Vec<ImuSample> =
            self.last.imus.iter().flatten().filter(|s| frame.time.seconds_since(s.time) < FRESH_S).copied().collect();
        let anew = out.imus.iter().any(Option::is_some);
        out.imus = Default::default();
        if let Some(newest) = fresh.iter().max_by_key(|s| s.time).filter(|_| anew) {
            let of =
                |value: &dyn Fn(&ImuSample) -> Option<f64>| median(&fresh.iter().filter_map(value).collect::<Vec<_>>());
            let mut sample = *newest;
            for axis in 0..3 {
                sample.gyro_radps[axis] = of(&|s| Some(s.gyro_radps[axis]));
                sample.accel_mps2[axis] = of(&|s| Some(s.accel_mps2[axis]));
                if let Some(mag) = &mut sample.mag_ut {
                    mag[axis] = of(&|s| s.mag_ut.map(|m| m[axis]));
                }
            }
            out.imus[0] = Some(sample);
        }
        let anew = out.heights.iter().flatten().next().copied();
        out.heights = Default::default();
        if let Some(mut newest) = anew {
            // Lasers take turns: each counts until its next scan.
            let fresh =
                self.last.heights.iter().flatten().filter(|s| frame.time.seconds_since(s.time) < 10.0 * FRESH_S);
            newest.height_m = median(&fresh.map(|s| s.height_m).collect::<Vec<_>>());
            out.heights[0] = Some(newest);
        }
        out
    }
}

/// Whoever stands beside it and keeps it over its place by eye, with the stick: altitude hold knows no horizontal position.
#[derive(Default)]
struct Operator {
    /// What was seen: place and speed, m and m/s.
    seen: VecDeque<(Vector2<f64>, Vector2<f64>)>,
    next_s: f64,
}

impl Operator {
    const LOOKS_EVERY_S: f64 = 0.1;
    /// Three looks ago: a person's reaction.
    const LATE: usize = 3;
    const STICK_MAX_RAD: f64 = 0.15;

    fn looks(&mut self, t: f64, truth: &Truth) -> Option<Command> {
        if t < self.next_s {
            return None;
        }
        self.next_s = t + Self::LOOKS_EVERY_S;
        let heading = nalgebra::Rotation2::new(-roll_pitch_yaw(&truth.world_from_body).z);
        self.seen.push_back((heading * truth.position_enu_m.xy(), heading * truth.velocity_enu_mps.xy()));
        let (place_m, speed_mps) = (self.seen.len() > Self::LATE).then(|| self.seen.pop_front()).flatten()?;
        let wanted = (-0.4 * place_m - 0.8 * speed_mps) / GRAVITY_MPS2;
        let stick = |rad: f64| Some(rad.clamp(-Self::STICK_MAX_RAD, Self::STICK_MAX_RAD));
        let (roll_rad, pitch_rad) = (stick(-wanted.y), stick(wanted.x));
        Some(Command::Setpoint(SetpointChange { roll_rad, pitch_rad, ..SetpointChange::default() }))
    }
}

/// Of whichever estimator judges sensors.
fn isolation(flight: &Flight) -> Option<&Isolation> {
    flight.secure().map(|secure| secure.isolation()).or_else(|| flight.lanes().map(|lanes| lanes.isolation()))
}

/// Watches one flight.
struct Judge {
    attacks: Vec<Attack>,
    from_s: f64,
    /// Is a controlled descent what is asked for? From where it began, m.
    comes_down: bool,
    down_from_m: Option<f64>,
    outcome: Outcome,
    squares: [f64; 2],
    count: f64,
    bounded: (f64, f64),
    /// Sensors excluded now, and since when, s.
    excluded: Vec<(SensorId, f64)>,
    found: Vec<SensorId>,
}

impl Judge {
    fn new(attacks: &[Attack], from_s: f64) -> Self {
        Self {
            attacks: attacks.to_vec(),
            from_s: from_s.max(STEADY_S),
            comes_down: false,
            down_from_m: None,
            outcome: Outcome::default(),
            squares: [0.0; 2],
            count: 0.0,
            bounded: (0.0, 0.0),
            excluded: Vec::new(),
            found: Vec::new(),
        }
    }

    /// One tick; true when the flight is over.
    fn tick(&mut self, t: f64, flight: &Flight, vehicle: &SimVehicle) -> bool {
        self.exclusions(t, flight);
        let begun = self.attacks.iter().map(|a| a.start_s).fold(f64::INFINITY, f64::min);
        let contradicted = isolation(flight).is_some_and(Isolation::contradicted);
        if t >= begun && (contradicted || flight.failsafe() != Failsafe::None) {
            self.outcome.declared_s.get_or_insert(t - begun);
        }
        if t < self.from_s {
            return false;
        }
        let truth = vehicle.truth().unwrap();
        let report = flight.report();
        let error_m = truth.position_enu_m.z - report.setpoint.position_enu_m.z;
        let ended = !report.armed || report.mode != Mode::AltitudeHold;
        if self.comes_down && (self.down_from_m.is_some() || ended && flight.failsafe() != Failsafe::None) {
            return self.descends(&truth, report.armed);
        }
        if ended || error_m.abs() > ASTRAY_M {
            let why = if ended { format!("{:?}", flight.failsafe()) } else { format!("{error_m:.2} m astray") };
            self.outcome.altitude_most_m = self.outcome.altitude_most_m.max(error_m.abs());
            self.outcome.lost = Some(why);
            return true;
        }
        let Some((_, estimate)) = flight.estimates().next() else { return false };
        let up = |q: &nalgebra::UnitQuaternion<f64>| q.inverse() * nalgebra::Vector3::z();
        let tilt = up(&truth.world_from_body).angle(&up(&estimate.world_from_body));
        self.squares[0] += error_m * error_m;
        self.squares[1] += tilt * tilt;
        self.count += 1.0;
        self.outcome.altitude_most_m = self.outcome.altitude_most_m.max(error_m.abs());
        if let Some(bound_m) = flight.secure().and_then(|secure| secure.height_bound_m()) {
            let off_m = estimate.kinematics().position_enu_m.z - truth.position_enu_m.z;
            self.bounded.0 += 1.0;
            self.bounded.1 += f64::from(off_m.abs() > bound_m);
        }
        false
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

    fn exclusions(&mut self, t: f64, flight: &Flight) {
        let Some(isolation) = isolation(flight) else { return };
        for device in isolation.devices() {
            let sensor = device.sensor;
            let of = self.attacks.iter().find(|a| a.sensor == sensor);
            // What an attack left behind takes a while to be trusted again.
            let attacked = of.is_some_and(|a| t >= a.start_s);
            let known = self.excluded.iter().position(|(id, _)| *id == sensor);
            match (device.flagged.is_some(), known) {
                (true, None) => {
                    self.excluded.push((sensor, t));
                    match of {
                        Some(attack) if attacked => {
                            if !self.found.contains(&sensor) {
                                self.found.push(sensor);
                                self.outcome.delays_s.push(t - attack.start_s);
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

    fn verdict(mut self) -> Outcome {
        self.outcome.missed = self.attacks.len() - self.found.len();
        self.outcome.altitude_m = (self.squares[0] / self.count).sqrt();
        self.outcome.tilt_rad = (self.squares[1] / self.count).sqrt();
        self.outcome.outside_bound = self.bounded.1 / self.bounded.0;
        self.outcome
    }
}
