//! A scripted scenario flown in this process, as fast as possible: the agent's own parts, no socket, no clock.

pub mod paternain;

use crate::scenario_file;
use plumbline_agent::command::Command;
use plumbline_agent::control::step_response::StepResponse;
use plumbline_agent::control::tuning::Design;
use plumbline_agent::estimate::Estimate;
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::ControllerKind;
use plumbline_agent::vehicle::{Truth, Vehicle};
use plumbline_proto::time::FlightTime;

/// A simulated flight that advances tick by tick.
pub struct Headless {
    /// What is flown.
    pub scenario: Scenario,
    /// The simulator under it.
    pub vehicle: SimVehicle,
    /// The agent's part.
    pub flight: Flight,
    before: Option<FlightTime>,
}

/// What the caller sees of one tick.
pub struct Tick<'a> {
    /// Of the sensor frame.
    pub time: FlightTime,
    /// What the sensors said.
    pub sensed: SensorFrame,
    /// The true state, after the motors were told.
    pub truth: Truth,
    /// Of the estimator in the loop.
    pub estimate: &'a Estimate,
    /// The step response being measured.
    pub step: Option<StepResponse>,
}

impl Headless {
    /// The scenario of that name in `tests/scenarios`, with the agent's default estimators and controller.
    pub fn start(name: &str) -> Self {
        Self::start_with(name, ControllerKind::LqrIntegral)
    }

    /// The same with another controller, at its defaults.
    pub fn start_with(name: &str, controller: ControllerKind) -> Self {
        Self::start_seeded(name, controller, |own| own)
    }

    /// The same, of the seed that `seed` makes of the scenario's own.
    pub fn start_seeded(name: &str, controller: ControllerKind, seed: impl Fn(u64) -> u64) -> Self {
        let text = std::fs::read_to_string(scenario_file(name)).unwrap();
        let mut scenario = Scenario::from_toml(&text).unwrap();
        scenario.seed = seed(scenario.seed);
        let config = scenario.flight_config();
        let design = Design::new(controller, &scenario.airframe);
        let flight = Flight::new(FlightConfig { design, ..config }).unwrap();
        let vehicle = SimVehicle::new(&scenario).unwrap();
        Self { scenario, vehicle, flight, before: None }
    }

    /// The next sensor frame.
    pub fn sense(&mut self) -> SensorFrame {
        self.vehicle.sense().unwrap()
    }

    /// Everything of a tick after sensing, the scripted commands included.
    pub fn fly(&mut self, sensed: &SensorFrame) -> Option<StepResponse> {
        let now = sensed.time;
        self.flight.heartbeat(now);
        let report = self.flight.step(sensed);
        let (command, step) = (report.command, report.step_response);
        let applied = self.vehicle.actuate(&command).unwrap();
        self.flight.applied(applied);
        let (flight, before) = (&mut self.flight, self.before.replace(now));
        self.scenario.script.commands(before, now, |command: &Command| {
            let ack = flight.apply(command, now);
            assert!(ack.accepted, "{command:?} at {now}: {}", ack.reason);
        });
        step
    }

    /// The true state.
    pub fn truth(&mut self) -> Truth {
        self.vehicle.truth().unwrap()
    }

    /// The whole scenario.
    pub fn run(&mut self, mut each: impl FnMut(Tick<'_>)) {
        let ticks = (self.scenario.duration_s * self.scenario.tick_rate_hz) as usize;
        for _ in 0..ticks {
            let sensed = self.sense();
            let step = self.fly(&sensed);
            let truth = self.vehicle.truth().unwrap();
            let kind = self.flight.estimator_in_loop();
            let (_, estimate) = self.flight.estimates().find(|(known, _)| *known == kind).unwrap();
            each(Tick { time: sensed.time, sensed, truth, estimate, step });
        }
    }
}
