//! Flies scenarios through the simulator: GIVEN a scenario WHEN it is flown THEN `check` looks at it.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use plumbline_agent::command::{Ack, Command};
use plumbline_agent::control::step_response::StepResponse;
use plumbline_agent::estimate::Estimate;
use plumbline_agent::event::Event;
use plumbline_agent::flight::{Flight, FlightConfig, StepReport};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::Identification;
use plumbline_agent::vehicle::{Truth, Vehicle};
use plumbline_proto::time::{FlightTime, WallTime};

/// A scenario in the air.
pub struct Flown {
    pub scenario: Scenario,
    pub vehicle: SimVehicle,
    pub flight: Flight,
    pub rows: Vec<Row>,
    pub events: Vec<Event>,
    pub acks: Vec<(FlightTime, Ack)>,
    pub steps: Vec<StepResponse>,
    /// Heartbeats stop here.
    pub link_lost_s: f64,
    /// The operator's page answers from here …
    pub operator_from_s: f64,
    /// … to here.
    pub operator_lost_s: f64,
    /// Each motor turns as if it had been told this fraction.
    pub motor_factor: [f64; 4],
}

/// One tick of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub t_s: f64,
    pub truth: Truth,
    pub report: StepReport,
    pub estimate: Estimate,
}

impl Flown {
    pub fn new(toml: &str) -> Self {
        let scenario = Scenario::from_toml(toml).unwrap();
        let config = scenario.flight_config();
        Self::with_config(scenario, config)
    }

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
            operator_from_s: f64::INFINITY,
            operator_lost_s: f64::INFINITY,
            motor_factor: [1.0; 4],
        }
    }

    pub fn now(&self) -> FlightTime {
        self.vehicle.time()
    }

    pub fn command(&mut self, command: Command) -> Ack {
        let ack = self.flight.apply(&command, self.now());
        self.acks.push((self.now(), ack));
        ack
    }

    /// One tick: sense, commands of the script, step, actuate.
    pub fn tick(&mut self) {
        let frame = self.vehicle.sense().unwrap();
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
        self.flight.drain_events(|e| self.events.push(*e));
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
        self
    }

    /// Drops all ticks but the last, in long flights.
    pub fn forget(&mut self) {
        if self.rows.len() > 400 {
            self.rows.drain(..399);
        }
    }

    pub fn last(&self) -> &Row {
        self.rows.last().unwrap()
    }

    pub fn since(&self, t_s: f64) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(move |r| r.t_s >= t_s)
    }

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

/// Who tells of a simulated flight of `scenario`.
pub fn identification(scenario: &Scenario) -> Identification {
    Identification {
        agent_id: "iris-1".into(),
        boot_id: 7,
        boot_wall_time: WallTime(1_795_262_400_000_000),
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

/// A scenario file of the workspace.
pub fn scenario(name: &str) -> String {
    let path = format!("{}/../tests/scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// `Ok` when `holds`, else the message.
pub fn expect(holds: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message()) }
}
