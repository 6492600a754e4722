//! One flight: the simulated vehicle and the agent's tick, as fast as possible, without clock, socket or file.
//!
//! The same [`Setup`] gives the same flight, bit for bit: that is what lets every row of a result be flown again.

use std::collections::VecDeque;

use nalgebra::Vector2;
use plumbline_agent::attack::{Attack, Sequence};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::flight::{Flight, FlightConfig, FlightError};
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::sensor::suite::Suite;
use plumbline_agent::sim::scenario::ScenarioError;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::GRAVITY_MPS2;
use plumbline_agent::vehicle::{Truth, Vehicle as _, VehicleError};

use crate::judge::{Judge, Outcome};
use crate::reception::{Flights, Receiver, Reception, schedule};

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
    let mut receiver = Receiver::new(setup)?;
    let mut vehicle = SimVehicle::new(scenario)?;
    let mut flights = Flights::new(setup)?;
    let mut judge = Judge::new(setup);
    let mut operator = Operator::default();
    let mut before = None;
    for tick in 0..(scenario.duration_s * scenario.tick_rate_hz) as usize {
        let frame = vehicle.sense()?;
        let (now, t) = (frame.time, frame.time.as_seconds());
        flights.each(|flight| flight.heartbeat(now));
        if tick == 0 && !attacks.is_empty() && *reception == Reception::All {
            let ack = flights.chosen().apply(&Command::Attack(schedule(setup)), now);
            if !ack.accepted {
                return Err(FlyError::Attacks(ack.reason.to_string()));
            }
        }
        scenario.script.commands(before, now, |command| flights.apply(command, now));
        before = Some(now);
        if let Some(command) = vehicle.truth().and_then(|truth| operator.looks(t, &truth)) {
            flights.apply(&command, now);
        }
        let received = receiver.receives(&frame, flights.chosen());
        let command = flights.step(&frame, &received);
        let applied = vehicle.actuate(&command)?;
        flights.each(|flight| flight.applied(applied));
        let Some(truth) = vehicle.truth() else { break };
        let over = judge.tick(t, flights.chosen(), &truth);
        watch(flights.chosen(), &truth);
        if over {
            break;
        }
    }
    Ok(judge.verdict())
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
