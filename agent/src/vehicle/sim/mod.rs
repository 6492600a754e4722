//! The simulated vehicle: a scenario made true.
//!
//! `sense` moves the world on by one tick under the last command and returns what arrives at its end;
//! the first call returns time zero. Deterministic: the same scenario gives the same bits. After
//! construction nothing is allocated.

pub mod noise;
mod reading;
pub mod rig;
pub mod scenario;
pub mod script;
pub mod sensors;
pub mod site;
pub mod world;

pub use rig::Rig;
pub use scenario::{Scenario, ScenarioError};

use plumbline_proto::time::FlightTime;

use self::sensors::Sensors;
use self::world::World;
use crate::vehicle::{MotorCommand, SensorFrame, Truth, Vehicle, VehicleError};

/// A quadrotor that flies in memory.
#[derive(Debug, Clone)]
pub struct SimVehicle {
    scenario: Scenario,
    world: World,
    sensors: Sensors,
    throttle: MotorCommand,
    tick: u64,
    started: bool,
}

impl SimVehicle {
    /// The vehicle of `scenario`, at time zero with its motors stopped.
    ///
    /// # Errors
    /// When the scenario, changed since it was read, is no longer valid.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        scenario.validate()?;
        let world = World::new(scenario.beginning());
        let sensors = Sensors::new(&scenario.suite, scenario.site, &scenario.outages, scenario.seed);
        Ok(Self {
            scenario: scenario.clone(),
            world,
            sensors,
            throttle: MotorCommand::default(),
            tick: 0,
            started: false,
        })
    }

    /// The scenario it flies.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The world, for tests.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The sensors, for tests.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// Time of the frame last sensed.
    pub fn time(&self) -> FlightTime {
        self.time_of(self.tick)
    }

    fn time_of(&self, tick: u64) -> FlightTime {
        FlightTime((tick as f64 * 1e6 / self.scenario.tick_rate_hz).round() as u64)
    }
}

impl Vehicle for SimVehicle {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        if self.started {
            let before = self.time();
            self.tick += 1;
            let dt_s = self.time().seconds_since(before);
            let push = self.scenario.script.push(before.as_seconds());
            self.world.step(&self.throttle.throttle, &push, dt_s);
            if !self.world.body().is_finite() {
                return Err(VehicleError::Invalid {
                    what: format!("simulated world of scenario {}", self.scenario.name),
                    reason: format!("its state is not finite at {}", self.time()),
                });
            }
        }
        self.started = true;
        Ok(self.sensors.sense(&self.world, self.time()))
    }

    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        // A command that is not a number stops its motor, as a speed controller without signal does.
        let clipped = command.throttle.map(|t| if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) });
        self.throttle = MotorCommand { throttle: clipped };
        Ok(self.throttle)
    }

    fn truth(&self) -> Option<Truth> {
        let body = self.world.body();
        let load = self.world.load();
        Some(Truth {
            time: self.time(),
            position_enu_m: body.position_enu_m,
            velocity_enu_mps: body.velocity_enu_mps,
            world_from_body: body.attitude(),
            body_rates_radps: body.body_rates_radps,
            specific_force_mps2: self.world.specific_force_flu_mps2(),
            rotor_speed_radps: *self.world.rotor_speed_radps(),
            string_tension_n: load.tension_n,
            ground_force_n: load.ground_n,
        })
    }
}
