//! One flight: the simulated vehicle and the agent's tick, as fast as possible, without clock, socket or file.
//!
//! The same [`Setup`] gives the same flight, bit for bit: that is what lets every row of a result be flown again.

use std::collections::VecDeque;

use nalgebra::Vector2;
use plumbline_agent::attack::{Attack, Injector, Schedule, Sequence};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::flight::{Flight, FlightConfig, FlightError};
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::imu::ImuSample;
use plumbline_agent::sensor::suite::Suite;
use plumbline_agent::sim::scenario::ScenarioError;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::GRAVITY_MPS2;
use plumbline_agent::vehicle::{Truth, Vehicle as _, VehicleError};
use plumbline_proto::v1::SensorKind;

use crate::draw::median;
use crate::judge::{Judge, Outcome};

/// A sample of a unit with a clock of its own is used for the median so long, s.
const FRESH_S: f64 = 0.03;

/// Why a flight could not be flown.
#[derive(Debug, thiserror::Error)]
pub enum FlyError {
    /// The scenario, changed since it was read.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The estimators, the gains or the airframe.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// The simulated vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The attacks.
    #[error("attacks refused: {0}")]
    Attacks(String),
}

/// What stands between the sensors and the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reception {
    /// Nothing: the estimator receives what the attacks leave.
    #[default]
    All,
    /// Somebody who knows: sensors are withheld while they are attacked.
    Oracle,
    /// One IMU and one height in the place of all, each the median of what is received.
    Median,
}

/// Everything that one flight follows from.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The world, the vehicle, what is commanded; its seed is the flight's.
    pub scenario: Scenario,
    /// The agent's side.
    pub config: FlightConfig,
    /// What stands before the estimator.
    pub reception: Reception,
    /// What is done to the sensors; onsets count from boot.
    pub attacks: Vec<Attack>,
    /// What biases among them follow.
    pub sequences: Vec<Sequence>,
    /// The error counts from here on, s.
    pub judged_from_s: f64,
    /// More is attacked than can be borne: what is asked for is a controlled descent.
    pub comes_down: bool,
}

/// The sensors of a scenario, TOML as it stands in a flight.
///
/// # Errors
/// [`ScenarioError`] naming key and value.
pub fn suite_of(scenario: &str) -> Result<Suite, ScenarioError> {
    Scenario::from_toml(scenario).map(|scenario| scenario.suite)
}

/// Flies it to its end, or until it is lost.
///
/// # Errors
/// [`FlyError`]: nothing was flown.
pub fn fly(setup: &Setup) -> Result<Outcome, FlyError> {
    fly_watched(setup, |_, _| {})
}

/// The same; `watch` sees every tick when it is done. What it does to the flight (taking its events) changes nothing of it.
///
/// # Errors
/// [`FlyError`]: nothing was flown.
pub fn fly_watched(setup: &Setup, mut watch: impl FnMut(&mut Flight, &Truth)) -> Result<Outcome, FlyError> {
    let Setup { scenario, attacks, reception, .. } = setup;
    let mut injector = Injector::new(setup.config.attacks.bounds, true, &setup.config.sensors);
    let mut vehicle = SimVehicle::new(scenario)?;
    let mut flight = Flight::new(setup.config.clone())?;
    let mut medians = Medians::default();
    let mut judge = Judge::new(setup);
    let mut operator = Operator::default();
    let mut before = None;
    for tick in 0..(scenario.duration_s * scenario.tick_rate_hz) as usize {
        let frame = vehicle.sense()?;
        let (now, t) = (frame.time, frame.time.as_seconds());
        flight.heartbeat(now);
        if tick == 0 && !attacks.is_empty() {
            let sequences = setup.sequences.clone();
            let schedule = Schedule { id: 1, attacks: attacks.iter().copied().collect(), sequences };
            // Where somebody stands between the sensors and the vehicle, the attack comes before them.
            if *reception == Reception::Median {
                injector.upload(&schedule, now).map_err(|error| FlyError::Attacks(error.to_string()))?;
            } else if *reception == Reception::All {
                let ack = flight.apply(&Command::Attack(schedule), now);
                if !ack.accepted {
                    return Err(FlyError::Attacks(ack.reason.to_string()));
                }
            }
        }
        scenario.script.commands(before, now, |command| {
            let _ = flight.apply(command, now);
        });
        before = Some(now);
        if let Some(command) = vehicle.truth().and_then(|truth| operator.looks(t, &truth)) {
            let _ = flight.apply(&command, now);
        }
        let received = match reception {
            Reception::All => frame,
            Reception::Oracle => without(frame, attacks, t),
            Reception::Median => medians.of(&injector.apply(&frame)),
        };
        let command = flight.step_received(&frame, &received).command;
        let applied = vehicle.actuate(&command)?;
        flight.applied(applied);
        let Some(truth) = vehicle.truth() else { break };
        let over = judge.tick(t, &flight, &truth);
        watch(&mut flight, &truth);
        if over {
            break;
        }
    }
    Ok(judge.verdict())
}

/// `frame` without the samples of those who are attacked at `t`, s.
fn without(mut frame: SensorFrame, attacks: &[Attack], t: f64) -> SensorFrame {
    for attack in attacks.iter().filter(|a| (a.start_s..a.start_s + a.duration_s).contains(&t)) {
        let index = usize::from(attack.sensor.instance).saturating_sub(1);
        match attack.sensor.kind {
            SensorKind::Imu => take(&mut frame.imus, index),
            SensorKind::Height => take(&mut frame.heights, index),
            SensorKind::Barometer => take(&mut frame.barometers, index),
            // The oracle knows the sensors that attacks are drawn for; any other stays.
            _ => {}
        }
    }
    frame
}

fn take<T>(samples: &mut [Option<T>], index: usize) {
    if let Some(sample) = samples.get_mut(index) {
        *sample = None;
    }
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
