//! The seam: something that can be flown. Real, simulated and recorded flights differ only here.

pub mod calibrated;

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::{ids::SensorId, time::FlightTime};

use crate::control::step_response::StepResponse;
use crate::event::{Severity, Text};
use crate::flight::Guide;
use crate::sensor::SensorFrame;
use crate::types::{Mode, MotorCommand, ROTORS, Setpoint, Wrench};

/// True state, known to the simulator and to some recordings. For telemetry and tests only:
/// estimators and controllers cannot reach it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// When.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
    /// Angular rate in the body frame FLU, rad/s.
    pub body_rates_radps: Vector3<f64>,
    /// Specific force in the body frame FLU, m/s².
    pub specific_force_mps2: Vector3<f64>,
    /// Rotor speeds, rad/s; zero when unknown.
    pub rotor_speed_radps: [f64; ROTORS],
    /// Tension of each string, N; zero when slack or absent.
    pub string_tension_n: [f64; 4],
    /// Force of the ground on the vehicle, N.
    pub ground_force_n: f64,
}

impl Truth {
    /// Nothing known at `time`: vectors NaN, attitude level, forces zero.
    pub fn unknown(time: FlightTime) -> Self {
        let nan = Vector3::from_element(f64::NAN);
        Self {
            time,
            position_enu_m: nan,
            velocity_enu_mps: nan,
            world_from_body: UnitQuaternion::identity(),
            body_rates_radps: nan,
            specific_force_mps2: nan,
            rotor_speed_radps: [0.0; ROTORS],
            string_tension_n: [0.0; 4],
            ground_force_n: 0.0,
        }
    }
}

/// Why a vehicle can no longer be flown.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The recording is over; not a fault.
    #[error("the recording ends at {0}")]
    Finished(FlightTime),
    /// The input is not what it should be.
    #[error("{what}: {reason}")]
    Invalid {
        /// File or device.
        what: String,
        /// Reason, with the offending value.
        reason: String,
    },
}

/// Motors stop by themselves when no command reaches them for this long, s: every vehicle promises it, whether its speed
/// controllers, its driver or the simulator keep the promise.
pub const MOTOR_TIMEOUT_S: f64 = 0.1;

/// How one device of a vehicle is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviceState<'a> {
    /// For people.
    pub name: &'a str,
    /// Where it is attached.
    pub port: &'a str,
    /// Does it give readings?
    pub up: bool,
    /// Readings a second, over the last second.
    pub rate_hz: f64,
    /// Since its last reading, s; `None` before the first.
    pub age_s: Option<f64>,
    /// One sigma of the delays of its frames, µs; `None` without a clock of its own.
    pub jitter_us: Option<f64>,
    /// Least time from a question about its clock to the answer, µs; `None` where it is not asked.
    pub round_trip_us: Option<f64>,
    /// Its clock less flight time by those answers, µs.
    pub clock_offset_us: Option<f64>,
    /// Frames given up.
    pub faults: u64,
    /// Readings that a full queue refused.
    pub given_up: u64,
    /// Times it was opened.
    pub opened: u64,
    /// The last fault, or why it is not up.
    pub reason: Text,
}

/// An autopilot in front of the motors: what it was asked for in a tick, and what it said last that it does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AutopilotState {
    /// Body rates FLU, rad/s, and thrust, 0 to 1, asked for; `None` where it flies by pose.
    pub asked: Option<(Vector3<f64>, f64)>,
    /// Those that its own loops aim at; `None` where it did not say lately.
    pub aims_at: Option<(Vector3<f64>, f64)>,
    /// Its outputs to the motors as commands; `None` where it did not say lately.
    pub outputs: Option<MotorCommand>,
}

/// One whole scan of a scanner. Range i lies at `first_angle_rad + i * step_angle_rad`, from x towards y of the scan's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan<'a> {
    /// Which height it is, from 1.
    pub instance: u16,
    /// As of the height that was found in it; of its arrival where none was.
    pub time: FlightTime,
    /// By the scanner's own clock, as sent, ms.
    pub device_time_ms: u32,
    /// Of the first range.
    pub first_angle_rad: f64,
    /// From one range to the next.
    pub step_angle_rad: f64,
    /// mm; below 20 the scanner's error code.
    pub ranges_mm: &'a [u16],
    /// Where the scanner sits, FLU from the centre of mass, m.
    pub position_flu_m: Vector3<f64>,
    /// The scan's axes in the body: x straight ahead of the scanner, z the axis that it turns about.
    pub body_from_scan: UnitQuaternion<f64>,
}

/// Stops the motors of a vehicle from any thread, whatever its own thread does.
pub trait MotorStop: Send + Sync + std::fmt::Debug {
    /// Motors off, now. The next command may start them again.
    fn stop(&self);
}

/// What only a simulated vehicle can be given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Service {
    /// A full battery.
    pub battery: bool,
    /// Its place at the begin, at rest.
    pub reset: bool,
}

/// The frame that a caller waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Awaited {
    /// When it is due.
    pub time: FlightTime,
    /// By how much flight time is to be set back before, ns, so that samples are young at ticks.
    pub set_back_ns: i64,
}

/// Something that can be flown: the real quadrotor, the simulator, or a recording.
pub trait Vehicle: Send {
    /// The next frame, calibrated and in SI units. Time comes from here and nowhere else.
    ///
    /// Never sleeps: the caller paces the loop to `SensorFrame::time` in real time, or not at all.
    ///
    /// # Errors
    /// [`VehicleError::Finished`] at the end of a recording; the others when the input fails.
    fn sense(&mut self) -> Result<SensorFrame, VehicleError>;

    /// When its next frame is due, for one whose samples arrive by themselves: the caller waits before it senses, so that
    /// the frame holds what has arrived by then. `None`: sense first, then wait.
    fn awaited(&mut self) -> Option<Awaited> {
        None
    }

    /// Something to tell of its devices: one was lost, or is back. Asked each tick until there is no more.
    fn notice(&mut self) -> Option<(Severity, Text)> {
        None
    }

    /// How its device `index` is doing; `None` beyond the last. Asked a few times a second; must not wait.
    fn device(&mut self, index: usize) -> Option<DeviceState<'_>> {
        let _ = index;
        None
    }

    /// What an autopilot flies by whose own controller flies, before [`Vehicle::actuate`] in each tick; `None` where nothing
    /// carries a flight. Nothing to any other vehicle.
    fn guide(&mut self, guide: Option<&Guide<'_>>) {
        let _ = guide;
    }

    /// The autopilot in front of its motors after [`Vehicle::actuate`]; `None` where there is none.
    fn autopilot(&self) -> Option<AutopilotState> {
        None
    }

    /// Shows the scans that came since the last call, of those devices whose configuration asks for them. Asked each tick;
    /// must not wait.
    fn scans(&mut self, each: &mut dyn FnMut(Scan<'_>)) {
        let _ = each;
    }

    /// Applies one motor command; returns what was really applied (clipped, or recorded).
    ///
    /// # Errors
    /// When the motors cannot be reached.
    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError>;

    /// A way to its motors for the thread that watches over the flight thread; `None` where nothing can turn, or where
    /// only the motors' own time-out stops them.
    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        None
    }

    /// `gap_s` went by since the frame last sensed was due, and nobody flew. Returns how much of it the next frame passes
    /// over, s: the whole ticks of it for what moves on its own, nothing for a recording, which waits.
    fn pass_over(&mut self, gap_s: f64) -> f64 {
        let _ = gap_s;
        0.0
    }

    /// True state of the frame last sensed, where it is known.
    fn truth(&self) -> Option<Truth> {
        None
    }

    /// Itself, if it is simulated.
    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        None
    }

    /// Itself, if it is a recording.
    fn recorded(&self) -> Option<&dyn Recorded> {
        None
    }

    /// Itself, if an autopilot of its own flies it: the flight code only watches.
    fn piloted(&mut self) -> Option<&mut dyn Piloted> {
        None
    }
}

/// What a simulated vehicle does besides.
pub trait Simulated {
    /// Gives it what is asked. May take memory: no tick calls it.
    fn serve(&mut self, service: Service);
}

/// What a recording knows besides.
pub trait Recorded {
    /// How much of it is flown, 0 to 1.
    fn progress(&self) -> f64;

    /// What the estimators received of the frame last sensed, where that differs from what was sensed: the attacks of
    /// then are seen again.
    fn reception(&self) -> Option<SensorFrame>;

    /// Mode and setpoint of the frame last sensed.
    fn control(&self) -> RecordedControl;
}

/// What a vehicle does besides that an autopilot of its own flies.
pub trait Piloted {
    /// What the autopilot is to receive of the frame last sensed, attacks included. [`Vehicle::actuate`] hands it over and
    /// waits for the answer, whatever it is told itself.
    fn receive(&mut self, received: &SensorFrame);

    /// Is there a way for the samples of `sensor` to the autopilot?
    fn reaches(&self, sensor: SensorId) -> bool;

    /// What the autopilot does.
    fn control(&self) -> RecordedControl;

    /// Was the autopilot started anew since this was asked last? Then the world has begun anew with it.
    fn began_anew(&mut self) -> bool;
}

/// What a flight that is only watched was told to do, and did about it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RecordedControl {
    /// Flight mode.
    pub mode: Mode,
    /// Were the motors allowed to turn?
    pub armed: bool,
    /// Setpoint in use; NaN where the recording does not say.
    pub setpoint: Setpoint,
    /// Wrench asked for by the controller.
    pub wrench: Wrench,
    /// Motor command asked for.
    pub command: MotorCommand,
    /// Could the mixer not give what was asked?
    pub saturated: bool,
    /// Integrators of x, y, z (m s) and yaw (rad s).
    pub integrator: [f64; 4],
    /// Response to the last altitude step, where it was told in this tick.
    pub step_response: Option<StepResponse>,
    /// Does the recording carry motor commands at all?
    pub motors_known: bool,
}

impl RecordedControl {
    /// Of a recording that holds sensors only.
    pub fn unknown() -> Self {
        let setpoint = Setpoint {
            position_enu_m: Vector3::repeat(f64::NAN),
            velocity_enu_mps: Vector3::zeros(),
            acceleration_enu_mps2: Vector3::zeros(),
            roll_pitch_yaw_rad: Vector3::repeat(f64::NAN),
            throttle: f64::NAN,
        };
        Self { mode: Mode::Unspecified, setpoint, ..Self::default() }
    }
}
