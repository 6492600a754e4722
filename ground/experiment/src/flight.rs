//! One flight: the simulated vehicle, or a recording, and the agent's tick, as fast as possible, without clock or socket.
//!
//! The same [`Setup`] gives the same flight, bit for bit: that is what lets every row of a result be flown again.

use std::collections::VecDeque;
use std::time::Instant;

use nalgebra::{Vector2, Vector3};
use plumbline_agent::attack::{Attack, Sequence};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::flight::{Flight, FlightConfig, FlightError};
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::suite::Suite;
use plumbline_agent::sim::scenario::ScenarioError;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::{GRAVITY_MPS2, Mode, MotorCommand};
use plumbline_agent::vehicle::{RecordedControl, Truth, Vehicle, VehicleError};
use plumbline_proto::time::FlightTime;

use crate::judge::{Judge, Outcome};
use crate::reception::{Flights, Receiver, Reception, injected};
use crate::recordings::{Against, Recorded, UnusableError, by_motion_capture};
use crate::ticks::Ticks;

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
    /// The recording.
    #[error(transparent)]
    Recording(#[from] UnusableError),
    /// The attacks.
    #[error("attacks refused: {0}")]
    Attacks(String),
}

/// Everything that one flight follows from.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The world, the vehicle, what is commanded; its seed is the flight's. Of a recording: what is known of it.
    pub scenario: Scenario,
    /// What is flown instead of the simulator.
    pub recording: Option<Recorded>,
    /// The agent's side.
    pub config: FlightConfig,
    /// What stands before the estimator.
    pub reception: Reception,
    /// What is done to the sensors; onsets count from boot, or from the beginning of the recording.
    pub attacks: Vec<Attack>,
    /// What biases among them follow.
    pub sequences: Vec<Sequence>,
    /// The error counts from here on, s.
    pub judged_from_s: f64,
    /// More is attacked than can be borne: what is asked for is a controlled descent.
    pub comes_down: bool,
}

impl Setup {
    /// A simulated flight in which nothing is attacked; its error counts from `judged_from_s` on, s.
    pub fn simulated(scenario: Scenario, config: FlightConfig, judged_from_s: f64) -> Self {
        Self {
            scenario,
            recording: None,
            config,
            reception: Reception::All,
            attacks: Vec::new(),
            sequences: Vec::new(),
            judged_from_s,
            comes_down: false,
        }
    }
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

/// What a flight does not know of its own tick.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// The true state, where it is known.
    pub truth: Option<Truth>,
    /// What a recorded flight did, and how much of it is flown, 0 to 1.
    pub then: Option<(RecordedControl, f64)>,
    /// What estimates are held against.
    pub against: Against,
    /// True state, or motion capture's, of this tick.
    pub reference: Option<Truth>,
}

/// What is done in a tick: by the flight, or by whoever flew the recording.
#[derive(Debug, Clone, Copy)]
pub struct Deed {
    /// Flight mode.
    pub mode: Mode,
    /// May the motors turn?
    pub armed: bool,
    /// Position asked for, ENU, m; NaN where a recording does not say.
    pub setpoint_enu_m: Vector3<f64>,
    /// Motors, where they are known.
    pub command: Option<MotorCommand>,
}

impl Seen {
    fn of(vehicle: &dyn Vehicle, sensed: &SensorFrame, against: Against) -> Self {
        let truth = vehicle.truth();
        let reference = match against {
            Against::Truth => truth,
            Against::MotionCapture => by_motion_capture(sensed),
            Against::Setpoint => None,
        };
        let then = vehicle.recorded().map(|recorded| (recorded.control(), recorded.progress()));
        Self { truth, then, against, reference }
    }

    /// What is done in this tick.
    pub fn deed(&self, flight: &Flight) -> Deed {
        let report = flight.report();
        let (mode, armed, setpoint) = (report.mode, report.armed, report.setpoint);
        let own = Deed { mode, armed, setpoint_enu_m: setpoint.position_enu_m, command: Some(report.command) };
        self.then.map_or(own, |(then, _)| Deed {
            mode: then.mode,
            armed: then.armed,
            setpoint_enu_m: then.setpoint.position_enu_m,
            command: then.motors_known.then_some(then.command),
        })
    }

    /// Where it is, ENU, m: by truth or motion capture; by the estimator in the loop where a recording has neither.
    pub fn place_enu_m(&self, flight: &Flight) -> Option<Vector3<f64>> {
        let estimated = || flight.estimate_in_loop()?.motion.filter(|motion| motion.altitude_known);
        let place = match self.against {
            Against::Truth | Against::MotionCapture => self.reference.map(|reference| reference.position_enu_m),
            Against::Setpoint => estimated().map(|motion| motion.position_enu_m),
        };
        place.filter(|place| place.z.is_finite())
    }
}

/// The same; `watch` sees every tick of a simulated flight when it is done, with the truth. What it does to the flight
/// (taking its events) changes nothing of it.
///
/// # Errors
/// [`FlyError`]: nothing was flown.
pub fn fly_watched(setup: &Setup, watch: impl FnMut(&mut Flight, &Truth)) -> Result<Outcome, FlyError> {
    fly_on(setup, false, with_truth(watch))
}

/// The same to the scenario's end, also when it is lost: what a source measures so.
///
/// # Errors
/// [`FlyError`]: nothing was flown.
pub fn fly_to_the_end(setup: &Setup, watch: impl FnMut(&mut Flight, &Truth)) -> Result<Outcome, FlyError> {
    fly_on(setup, true, with_truth(watch))
}

/// Watches a simulated flight.
fn with_truth(mut watch: impl FnMut(&mut Flight, &Truth)) -> impl FnMut(&mut Flight, &Seen) {
    move |flight, seen| {
        if let Some(truth) = &seen.truth {
            watch(flight, truth);
        }
    }
}

/// The same, of recordings as well.
///
/// # Errors
/// [`FlyError`]: nothing was flown.
pub fn fly_seen(setup: &Setup, watch: impl FnMut(&mut Flight, &Seen)) -> Result<Outcome, FlyError> {
    fly_on(setup, false, watch)
}

/// Until the judge has seen enough, or `to_the_end`.
fn fly_on(setup: &Setup, to_the_end: bool, mut watch: impl FnMut(&mut Flight, &Seen)) -> Result<Outcome, FlyError> {
    let Setup { scenario, recording, .. } = setup;
    let (mut vehicle, begin): (Box<dyn Vehicle>, _) = match recording {
        None => (Box::new(SimVehicle::new(scenario)?), FlightTime(0)),
        Some(recorded) => {
            let vehicle = recorded.vehicle()?;
            let (begin, _) = vehicle.info().span;
            (Box::new(vehicle), begin)
        }
    };
    let against = recording.as_ref().map_or(Against::Truth, |recorded| recorded.against);
    let mut receiver = Receiver::new(setup, begin)?;
    let mut flights = Flights::new(setup)?;
    let mut judge = Judge::new(setup);
    let mut operator = Operator::default();
    let (mut before, mut took) = (None, Ticks::default());
    // A recording ends by itself; its ticks need not be even.
    let ticks = if recording.is_none() { (scenario.duration_s * scenario.tick_rate_hz) as usize } else { usize::MAX };
    for tick in 0..ticks {
        let frame = match vehicle.sense() {
            Err(VehicleError::Finished(_)) => break,
            sensed => sensed?,
        };
        let now = frame.time;
        let t = now.seconds_since(begin);
        if recording.is_some() && t > scenario.duration_s {
            break;
        }
        flights.each(|flight| flight.heartbeat(now));
        if tick == 0 {
            flights.attack(injected(setup), now)?;
        }
        if recording.is_none() {
            scenario.script.commands(before, now, |command| flights.apply(command, now));
            before = Some(now);
            if let Some(command) = vehicle.truth().and_then(|truth| operator.looks(t, &truth)) {
                flights.apply(&command, now);
            }
        }
        let given = vehicle.recorded().and_then(|recorded| recorded.reception()).unwrap_or(frame);
        let received = receiver.receives(&given, flights.chosen());
        let begun = Instant::now();
        let command = flights.step(&frame, &received);
        took.add(begun.elapsed());
        let applied = vehicle.actuate(&command)?;
        flights.each(|flight| flight.applied(applied));
        let seen = Seen::of(vehicle.as_ref(), &frame, against);
        let over = judge.tick(t, flights.chosen(), &seen);
        watch(flights.chosen(), &seen);
        if over && !to_the_end {
            break;
        }
    }
    Ok(Outcome { ticks: took, ..judge.verdict() })
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
