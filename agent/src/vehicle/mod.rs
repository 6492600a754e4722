//! The seam: something that can be flown. Real, simulated and recorded flights differ only here.
//!
//! Everything is SI, calibrated, in the body frame FLU or the world frame ENU; NED, FRD and degrees
//! stay inside the driver that speaks them.

pub mod calibrated;
pub mod replay;
pub mod sim;
pub mod suite;

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use crate::calibration::applied::FieldReport;
use crate::recordings::RecordedControl;

/// Most sensors of one kind that a frame can carry.
pub const MAX_IMUS: usize = 5;
/// Most laser heights.
pub const MAX_HEIGHTS: usize = 5;
/// Most barometers.
pub const MAX_BAROMETERS: usize = 2;
/// Cameras of the motion-capture system.
pub const CAMERAS: usize = 4;
/// Rotors of the vehicle.
pub const ROTORS: usize = 4;

/// One sample of an IMU, in the body frame FLU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Angular rate, rad/s.
    pub gyro_radps: Vector3<f64>,
    /// Specific force, m/s²: +9.81 along z at rest and level.
    pub accel_mps2: Vector3<f64>,
    /// Magnetic field, µT; `None` when this sample carries none.
    pub mag_ut: Option<Vector3<f64>>,
    /// Die temperature, °C.
    pub temperature_c: f64,
}

/// Distance to the floor along the world's vertical, mounting removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeightSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Height, m.
    pub height_m: f64,
}

/// One barometer sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BarometerSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Pressure, Pa.
    pub pressure_pa: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
}

/// One GNSS fix, in local metres about the configured origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Geodetic latitude, longitude (deg) and altitude above mean sea level (m).
    pub geodetic: [f64; 3],
    /// One-sigma of the horizontal position, m.
    pub horizontal_sigma_m: f64,
    /// One-sigma of the vertical position, m.
    pub vertical_sigma_m: f64,
    /// Satellites used.
    pub satellites: u32,
}

/// One motion-capture pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MocapPoseSample {
    /// When it was measured.
    pub time: FlightTime,
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
}

/// Ranges from the motion-capture cameras to the markers' centroid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraRangesSample {
    /// When they were measured.
    pub time: FlightTime,
    /// One range per camera, m.
    pub range_m: [f64; CAMERAS],
}

/// Everything that arrived since the frame before. A field is `None` when that sensor had nothing new.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorFrame {
    /// Time of this tick.
    pub time: FlightTime,
    /// IMUs; index 0 is instance 1.
    pub imus: [Option<ImuSample>; MAX_IMUS],
    /// Laser heights.
    pub heights: [Option<HeightSample>; MAX_HEIGHTS],
    /// Barometers.
    pub barometers: [Option<BarometerSample>; MAX_BAROMETERS],
    /// GNSS.
    pub gnss: Option<GnssSample>,
    /// Motion-capture pose.
    pub mocap_pose: Option<MocapPoseSample>,
    /// Motion-capture camera ranges.
    pub camera_ranges: Option<CameraRangesSample>,
    /// Battery voltage at this tick, V; `None` when not measured.
    pub battery_v: Option<f64>,
}

/// One motor command: what each motor is told, 0 (stopped) to 1 (full).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorCommand {
    /// One value per motor, 0..1.
    pub throttle: [f64; ROTORS],
}

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
    /// A recording or a device could not be read.
    #[error("{what}: {source}")]
    Io {
        /// File or device.
        what: String,
        /// Cause.
        source: std::io::Error,
    },
    /// The input is not what it should be.
    #[error("{what}: {reason}")]
    Invalid {
        /// File or device.
        what: String,
        /// Reason, with the offending value.
        reason: String,
    },
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

    /// Applies one motor command; returns what was really applied (clipped, or recorded).
    ///
    /// # Errors
    /// When the motors cannot be reached.
    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError>;

    /// True state of the frame last sensed, where it is known.
    fn truth(&self) -> Option<Truth> {
        None
    }

    /// How much of a recording is flown, 0 to 1; `None` where there is no end.
    fn progress(&self) -> Option<f64> {
        None
    }

    /// What the estimators received of the frame last sensed, when it comes from a recording in which that
    /// differs from what was sensed: the attacks of then are seen again.
    fn recorded_reception(&self) -> Option<SensorFrame> {
        None
    }

    /// Mode and setpoint of the frame last sensed, when it comes from a recording that knows them.
    fn recorded_control(&self) -> Option<RecordedControl> {
        None
    }

    /// How its calibrated magnetometers fare.
    fn fields(&self) -> ArrayVec<FieldReport, MAX_IMUS> {
        ArrayVec::new()
    }
}
