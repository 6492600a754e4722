//! Flies scenarios through the simulator: GIVEN a scenario WHEN it is flown THEN `check` looks at it.

use crate::scenario_file;
use plumbline_agent::command::{Ack, Command};
use plumbline_agent::control::step_response::StepResponse;
use plumbline_agent::estimate::Estimate;
use plumbline_agent::event::Event;
use plumbline_agent::flight::{Flight, FlightConfig, StepReport};
use plumbline_agent::runner::RunnerOptions;
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::sim::script::Script;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::Identification;
use plumbline_agent::vehicle::{Truth, Vehicle};
use plumbline_proto::time::{FlightTime, WallTime};

/// A scenario in the air.
pub struct Flown {
    /// What is flown.
    pub scenario: Scenario,
    /// The simulator under it.
    pub vehicle: SimVehicle,
    /// The agent's part.
    pub flight: Flight,
    /// Every tick so far, or the last ones: see [`Flown::forget`].
    pub rows: Vec<Row>,
    /// Events so far.
    pub events: Vec<Event>,
    /// Answers to commands, with the flight time of each.
    pub acks: Vec<(FlightTime, Ack)>,
    /// Step responses, each as it was measured last.
    pub steps: Vec<StepResponse>,
    /// Heartbeats stop at this flight time, s; never where it is infinite.
    pub link_lost_s: f64,
    /// Nobody measures the battery from this flight time on, s.
    pub voltmeter_lost_s: f64,
    /// The operator's page answers from this flight time on, s …
    pub operator_from_s: f64,
    /// … to this one, s.
    pub operator_lost_s: f64,
    /// Each motor turns as if it had been told this fraction.
    pub motor_factor: [f64; 4],
}

/// One tick of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Flight time, s.
    pub t_s: f64,
    /// The true state, after the motors were told.
    pub truth: Truth,
    /// What the flight did.
    pub report: StepReport,
    /// Of the estimator in the loop.
    pub estimate: Estimate,
}

impl Flown {
    /// The scenario `toml`, with its own configuration.
    pub fn new(toml: &str) -> Self {
        let scenario = Scenario::from_toml(toml).unwrap();
        let config = scenario.flight_config();
        Self::with_config(scenario, config)
    }

    /// A scenario with another configuration of the flight.
    pub fn with_config(scenario: Scenario, config: FlightConfig) -> Self {
        Self {
            vehicle: SimVehicle::new(&scenario).unwrap(),
            flight: Flight::new(config).unwrap(),
            scenario,
            rows: Vec::new(),
            events: Vec::new(),
            acks: Vec::new(),
            steps: Vec::new(),
            link_lost_s: f64::INFINITY,
            voltmeter_lost_s: f64::INFINITY,
            operator_from_s: f64::INFINITY,
            operator_lost_s: f64::INFINITY,
            motor_factor: [1.0; 4],
        }
    }

    /// Flight time of the next tick.
    pub fn now(&self) -> FlightTime {
        self.vehicle.time()
    }

    /// Gives a command between two ticks; its answer is kept.
    pub fn command(&mut self, command: Command) -> Ack {
        let ack = self.flight.apply(&command, self.now());
        for_people(&ack.reason);
        self.acks.push((self.now(), ack));
        ack
    }

    /// One tick: sense, commands of the script, step, actuate.
    pub fn tick(&mut self) {
        let mut frame = self.vehicle.sense().unwrap();
        if frame.time.as_seconds() >= self.voltmeter_lost_s {
            frame.battery_v = None;
        }
        let before = self.rows.last().map(|r| r.report.sensed.time);
        if frame.time.as_seconds() < self.link_lost_s {
            self.flight.heartbeat(frame.time);
        }
        if (self.operator_from_s..self.operator_lost_s).contains(&frame.time.as_seconds()) {
            self.flight.operator_alive(frame.time);
        }
        let script = self.scenario.script.clone();
        script.commands(before, frame.time, |c| {
            let ack = self.flight.apply(c, frame.time);
            for_people(&ack.reason);
            self.acks.push((frame.time, ack));
        });
        let report = self.flight.step(&frame).clone();
        let mut weakened = report.command;
        weakened.throttle.iter_mut().zip(self.motor_factor).for_each(|(throttle, factor)| *throttle *= factor);
        let applied = self.vehicle.actuate(&weakened).unwrap();
        // A vehicle whose motor is weak does not know it.
        let healthy = self.motor_factor == [1.0; 4];
        self.flight.applied(if healthy { applied } else { report.command });
        if let Some(response) = report.step_response {
            match self.steps.iter_mut().find(|s| s.step == response.step && s.start == response.start) {
                Some(known) => *known = response,
                None => self.steps.push(response),
            }
        }
        self.flight.drain_events(|e| {
            for_people(&e.text);
            self.events.push(*e);
        });
        let kind = self.flight.estimator_in_loop();
        let estimate = self.flight.estimates().find(|e| e.0 == kind).unwrap().1.clone();
        let truth = self.vehicle.truth().unwrap();
        self.rows.push(Row { t_s: frame.time.as_seconds(), truth, report, estimate });
    }

    /// Flies until `t_s`.
    pub fn until(&mut self, t_s: f64) -> &mut Self {
        while self.rows.last().is_none_or(|r| r.t_s < t_s - 1e-9) {
            self.tick();
        }
        for check in self.flight.checks(self.now()) {
            for_people(&check.reason);
        }
        self
    }

    /// Drops all ticks but the last, in long flights.
    pub fn forget(&mut self) {
        if self.rows.len() > 400 {
            self.rows.drain(..399);
        }
    }

    /// The last tick. There must be one.
    pub fn last(&self) -> &Row {
        self.rows.last().unwrap()
    }

    /// Ticks from the flight time `t_s` on.
    pub fn since(&self, t_s: f64) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(move |r| r.t_s >= t_s)
    }

    /// Answers, events and step responses as text, for messages.
    pub fn log(&self) -> String {
        let mut out = String::new();
        for (t, ack) in &self.acks {
            out += &format!("{:8.3} ack {} {}\n", t.as_seconds(), ack.accepted, ack.reason);
        }
        for e in &self.events {
            out += &format!("{:8.3} {} {}\n", e.time.as_seconds(), e.kind.as_str(), e.text);
        }
        for s in &self.steps {
            out += &format!("{s:?}\n");
        }
        out
    }
}

/// What a vehicle says is read by people: no names of types, no braces.
#[track_caller]
fn for_people(text: &str) {
    let chars = text.chars().zip(text.chars().skip(1));
    let camel = chars
        .clone()
        .zip(chars.skip(1))
        .any(|((a, b), (_, c))| a.is_lowercase() && b.is_uppercase() && c.is_lowercase());
    assert!(!camel && !text.contains(['{', '}']) && !text.contains("::"), "names of the code: {text}");
}

/// GIVEN the scenario WHEN it is flown to its end THEN `expectation` holds; its message names values.
pub fn check(toml: &str, expectation: impl FnOnce(&Flown) -> Result<(), String>) -> Flown {
    let mut flown = Flown::new(toml);
    let end = flown.scenario.duration_s;
    flown.until(end);
    if let Err(broken) = expectation(&flown) {
        panic!("scenario {}: {broken}\n{}", flown.scenario.name, flown.log());
    }
    flown
}

/// When a simulated agent of these tests started.
pub const BOOT: WallTime = WallTime(1_795_262_400_000_000);

/// What an agent that flies `scenario` says of itself.
pub fn identification(scenario: &Scenario) -> Identification {
    Identification {
        agent_id: "iris-1".into(),
        boot_id: 7,
        boot_wall_time: BOOT,
        vehicle: "sim",
        rig: scenario.rig.name().into(),
        scenario: scenario.text.clone(),
        seed: scenario.seed,
        source_file: String::new(),
        sensors: scenario.suite.descriptions(),
        strings: scenario.rig.lines(&scenario.airframe),
        promise: None,
    }
}

/// A flight that is its own operator; `end_s` is flight time, s.
pub fn runner_options(pace: Pace, end_s: Option<f64>, script: Option<Script>) -> RunnerOptions {
    RunnerOptions {
        bounding: None,
        calibrations: None,
        pace,
        end: end_s.map(FlightTime::from_seconds),
        script,
        attacks: None,
        own_operator: true,
        stay: false,
        real_time: false,
    }
}

/// Text of a scenario file of the workspace.
pub fn scenario(name: &str) -> String {
    let path = scenario_file(name);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// `Ok` when `holds`, else the message.
pub fn expect(holds: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message()) }
}
