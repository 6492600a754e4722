//! The simulated vehicle: a scenario made true.
//!
//! `sense` moves the world on by one tick under the last command and returns what arrives at its end;
//! the first call returns time zero. Deterministic: the same scenario gives the same bits. After
//! construction nothing is allocated.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod conditions;
pub mod devices;
mod reading;
pub mod rig;
pub mod scenario;
pub mod script;
pub mod site;
mod surrounded;
mod vibration;
pub mod world;

pub use rig::Rig;
pub use scenario::{Scenario, ScenarioError};

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use plumbline_proto::time::FlightTime;

use crate::devices::Sensors;
use crate::world::World;
use plumbline_core::sensor::SensorFrame;
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::{MOTOR_TIMEOUT_S, MotorStop, Service, Simulated, Truth, Vehicle, VehicleError};

/// A quadrotor that flies in memory.
#[derive(Debug, Clone)]
pub struct SimVehicle {
    scenario: Scenario,
    world: World,
    sensors: Sensors,
    throttle: MotorCommand,
    switch: Arc<Switch>,
    /// When the motors were last commanded.
    commanded: FlightTime,
    tick: u64,
    /// Ticks that the next frame passes over.
    passed_over: u64,
    started: bool,
}

/// What stops the simulated motors from another thread.
#[derive(Debug, Default)]
struct Switch(AtomicBool);

impl MotorStop for Switch {
    fn stop(&self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Longest stretch that is passed over at once, s: a computer that slept for a night has no flight to go on with.
const PASS_OVER_MAX_S: f64 = 10.0;

impl SimVehicle {
    /// The vehicle of `scenario`, at time zero with its motors stopped.
    ///
    /// # Errors
    /// When the scenario, changed since it was read, is no longer valid.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        scenario.validate()?;
        let world = World::new(scenario.beginning());
        let sensors = Sensors::new(scenario);
        Ok(Self {
            scenario: scenario.clone(),
            world,
            sensors,
            throttle: MotorCommand::default(),
            switch: Arc::default(),
            commanded: FlightTime(0),
            tick: 0,
            passed_over: 0,
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

    /// One tick of the world. Motors that nobody commands stop by their own time-out.
    fn step_world(&mut self) -> Result<(), VehicleError> {
        let before = self.time();
        if before.seconds_since(self.commanded) >= MOTOR_TIMEOUT_S || self.switch.0.load(Ordering::Acquire) {
            self.throttle = MotorCommand::default();
        }
        self.tick += 1;
        let dt_s = self.time().seconds_since(before);
        let push = self.scenario.script.push(before.as_seconds());
        self.world.break_rotors(&self.scenario.rotors_left(before.as_seconds()));
        self.world.step(&self.throttle.throttle, &push, dt_s);
        if self.world.body().is_finite() {
            return Ok(());
        }
        Err(VehicleError::Invalid {
            what: format!("simulated world of scenario {}", self.scenario.name),
            reason: format!("its state is not finite at {}", self.time()),
        })
    }

    fn time_of(&self, tick: u64) -> FlightTime {
        FlightTime((tick as f64 * 1e6 / self.scenario.tick_rate_hz).round() as u64)
    }
}

impl Vehicle for SimVehicle {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        if self.started {
            for _ in 0..=std::mem::take(&mut self.passed_over) {
                self.step_world()?;
            }
        }
        self.started = true;
        Ok(self.sensors.sense(&self.world, self.time()))
    }

    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        // A command that is not a number stops its motor, as a speed controller without signal does.
        let clipped = command.throttle.map(|t| if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) });
        self.throttle = MotorCommand { throttle: clipped };
        self.commanded = self.time();
        self.switch.0.store(false, Ordering::Release);
        Ok(self.throttle)
    }

    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        Some(self.switch.clone())
    }

    fn pass_over(&mut self, gap_s: f64) -> f64 {
        let gap_s = if gap_s > 0.0 { gap_s.min(PASS_OVER_MAX_S) } else { 0.0 };
        self.passed_over = (gap_s * self.scenario.tick_rate_hz) as u64;
        self.time_of(self.tick + self.passed_over).seconds_since(self.time())
    }

    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        Some(self)
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

impl Simulated for SimVehicle {
    /// Begins the world anew where that is asked.
    fn serve(&mut self, service: Service) {
        if service.reset {
            let battery = *self.world.battery();
            self.world = World::new(self.scenario.beginning());
            self.world.replace_battery(battery);
            self.throttle = MotorCommand::default();
        }
        if service.battery {
            self.world.replace_battery(self.world.full_battery());
        }
    }
}
