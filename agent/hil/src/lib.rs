//! Stock autopilots in the loop: the simulator behind the protocols by which PX4 and ArduPilot are simulated.
//!
//! ```text
//! world ─► sensors ─► attack ─► PX4 or ArduPilot ─► motors ─► world
//! ```
//! [`PilotedVehicle`] is a [`Vehicle`] whose motors are those that the autopilot asks for: the flight code, its estimators
//! and its attack injector run beside it as beside a recording, and the autopilot is handed what they received. One tick
//! of the world waits for one answer.
//!
//! - [`px4`]: the MAVLink interface for simulators, lockstep over TCP.
//! - [`ardupilot`]: the JSON interface over UDP.
//! - [`quad_x`]: whose motor is which rotor.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod ardupilot;
pub mod px4;
pub mod quad_x;

use std::fmt;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use arrayvec::ArrayVec;
use nalgebra::UnitQuaternion;
use plumbline_core::event::{Severity, Text};
use plumbline_core::frames::{ned_from_frd, tilt_rad};
use plumbline_core::sensor::SensorFrame;
use plumbline_core::types::{Mode, MotorCommand, ROTORS};
use plumbline_core::vehicle::{Piloted, RecordedControl, Service, Simulated as _, Truth, Vehicle, VehicleError};
use plumbline_proto::ids::SensorId;
use plumbline_sim::site::Site;
use plumbline_sim::{Scenario, ScenarioError, SimVehicle};

pub use quad_x::QuadXError;

/// Things to tell that wait for the next tick; the newest is given up where there are more.
const NOTICES: usize = 8;

/// Why an autopilot cannot fly a scenario.
#[derive(Debug, thiserror::Error)]
pub enum HilError {
    /// Nothing can be received there.
    #[error("cannot listen for {autopilot} on {address}: {source}")]
    Port {
        /// Whom.
        autopilot: &'static str,
        /// Where.
        address: SocketAddr,
        /// Cause: in use by another simulator, or not ours.
        source: std::io::Error,
    },
    /// The airframe is not the one that it flies.
    #[error(transparent)]
    Frame(#[from] QuadXError),
    /// The world does not go at its pace.
    #[error("tick_rate_hz = {rate_hz}: {autopilot} is simulated at {least_hz} to {most_hz} Hz")]
    TickRate {
        /// Whom.
        autopilot: &'static str,
        /// The scenario's.
        rate_hz: f64,
        /// Slowest.
        least_hz: f64,
        /// Fastest.
        most_hz: f64,
    },
    /// Its IMU would not have a sample for every step.
    #[error(
        "IMU 1 samples at {imu_hz} Hz, the scenario ticks at {rate_hz} Hz: {autopilot} takes a sample at every tick"
    )]
    ImuRate {
        /// Whom.
        autopilot: &'static str,
        /// Of the suite; 0 without an IMU.
        imu_hz: f64,
        /// The scenario's.
        rate_hz: f64,
    },
    /// The scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// No autopilot came.
    #[error("waiting for {autopilot} on {address}: {source}")]
    Accept {
        /// Whom.
        autopilot: &'static str,
        /// Where.
        address: SocketAddr,
        /// Cause.
        source: std::io::Error,
    },
}

/// How long an autopilot is waited for.
#[derive(Clone)]
pub struct Patience {
    /// Longest wait for one answer in lockstep.
    pub answer: Duration,
    /// Before it keeps step: how long a tick waits for an answer that may not come. Zero where somebody else keeps the pace.
    pub unstepped: Duration,
    /// Was the program asked to end? Then a wait is given up, without an error.
    pub asked_to_end: Arc<dyn Fn() -> bool + Send + Sync>,
}

impl fmt::Debug for Patience {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Patience")
            .field("answer", &self.answer)
            .field("unstepped", &self.unstepped)
            .finish_non_exhaustive()
    }
}

/// How often a wait looks whether the program was asked to end.
const SLICE: Duration = Duration::from_millis(50);

/// What an autopilot is handed of one tick.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Samples as received, attacks included.
    pub received: &'a SensorFrame,
    /// The true state.
    pub truth: &'a Truth,
    /// Where the world's origin lies.
    pub site: &'a Site,
}

/// What it answers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Answer {
    /// Its motors in its own order, 0 to 1.
    pub motors: [f64; ROTORS],
    /// May they turn?
    pub armed: bool,
    /// It was started anew, and takes the vehicle to be where it began.
    pub anew: bool,
}

/// Told by an autopilot's line.
pub type Notices = ArrayVec<(Severity, Text), NOTICES>;

/// The line to one autopilot, in its own protocol.
pub trait Line: Send {
    /// Is there a way for the samples of `sensor` to it?
    fn reaches(&self, sensor: SensorId) -> bool;

    /// Hands over one tick and waits for the answer; `None` where there is none yet, or the program was asked to end.
    ///
    /// # Errors
    /// [`VehicleError::Invalid`] when it is gone or stays silent for too long.
    fn exchange(&mut self, step: &Step<'_>, notices: &mut Notices) -> Result<Option<Answer>, VehicleError>;
}

/// The simulator, flown by a stock autopilot.
pub struct PilotedVehicle {
    simulator: SimVehicle,
    line: Box<dyn Line>,
    /// The rotor of each of the autopilot's motors.
    rotors: [usize; ROTORS],
    received: SensorFrame,
    armed: bool,
    command: MotorCommand,
    anew: bool,
    notices: Notices,
}

impl PilotedVehicle {
    /// `scenario` flown by the autopilot at the other end of `line`.
    ///
    /// # Errors
    /// [`HilError`] when the scenario is not valid, or its airframe is none that the autopilot flies.
    pub fn new(scenario: &Scenario, line: Box<dyn Line>) -> Result<Self, HilError> {
        Ok(Self {
            rotors: quad_x::rotors(&scenario.airframe)?,
            simulator: SimVehicle::new(scenario)?,
            line,
            received: SensorFrame::default(),
            armed: false,
            command: MotorCommand::default(),
            anew: false,
            notices: Notices::new(),
        })
    }
}

impl Vehicle for PilotedVehicle {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        self.simulator.sense()
    }

    fn notice(&mut self) -> Option<(Severity, Text)> {
        self.notices.pop_at(0)
    }

    /// Whatever is asked, the autopilot's motors.
    fn actuate(&mut self, _command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        let truth = self.simulator.truth().unwrap_or_else(|| Truth::unknown(self.simulator.time()));
        let site = self.simulator.scenario().site;
        let step = Step { received: &self.received, truth: &truth, site: &site };
        if let Some(answer) = self.line.exchange(&step, &mut self.notices)? {
            if answer.anew {
                self.simulator.serve(Service { reset: true, battery: true });
                self.anew = true;
            }
            self.armed = answer.armed;
            self.command = MotorCommand::default();
            for (rotor, motor) in self.rotors.iter().zip(answer.motors) {
                if let Some(throttle) = self.command.throttle.get_mut(*rotor) {
                    *throttle = if answer.armed { motor } else { 0.0 };
                }
            }
        }
        self.simulator.actuate(&self.command)
    }

    fn truth(&self) -> Option<Truth> {
        self.simulator.truth()
    }

    fn piloted(&mut self) -> Option<&mut dyn Piloted> {
        Some(self)
    }
}

impl Piloted for PilotedVehicle {
    fn receive(&mut self, received: &SensorFrame) {
        self.received = *received;
    }

    fn reaches(&self, sensor: SensorId) -> bool {
        self.line.reaches(sensor)
    }

    /// Of its modes and setpoints neither protocol says anything.
    fn control(&self) -> RecordedControl {
        RecordedControl {
            mode: if self.armed { Mode::Unspecified } else { Mode::Disarmed },
            armed: self.armed,
            command: self.command,
            motors_known: true,
            ..RecordedControl::unknown()
        }
    }

    fn began_anew(&mut self) -> bool {
        std::mem::take(&mut self.anew)
    }
}

/// Can `autopilot` fly `scenario`: a quad-X in a world that ticks as it expects, with a sample of IMU 1 at every tick?
fn check(scenario: &Scenario, autopilot: &'static str, [least_hz, most_hz]: [f64; 2]) -> Result<(), HilError> {
    quad_x::rotors(&scenario.airframe)?;
    let rate_hz = scenario.tick_rate_hz;
    if !(least_hz..=most_hz).contains(&rate_hz) {
        return Err(HilError::TickRate { autopilot, rate_hz, least_hz, most_hz });
    }
    let imu_hz = scenario.suite.imus.first().map_or(0.0, |imu| imu.timing.rate_hz);
    if imu_hz < rate_hz {
        return Err(HilError::ImuRate { autopilot, imu_hz, rate_hz });
    }
    Ok(())
}

/// The attitude as w, x, y, z of NED ← FRD; of the two that mean the same, the one with w ≥ 0.
fn attitude_wxyz(world_from_body: UnitQuaternion<f64>) -> [f64; 4] {
    let q = ned_from_frd(world_from_body);
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.w, q.i, q.j, q.k].map(|part| sign * part)
}

/// What a beam fixed to the body measures of a height, m: autopilots take out the tilt themselves.
fn slant_m(height_m: f64, world_from_body: &UnitQuaternion<f64>) -> f64 {
    // Beyond 80° of tilt no beam finds the floor.
    height_m / tilt_rad(world_from_body).cos().max(0.17)
}

fn notice(notices: &mut Notices, severity: Severity, what: Text) {
    // Full: the newest is given up, as its doc says.
    let _ = notices.try_push((severity, what));
}
