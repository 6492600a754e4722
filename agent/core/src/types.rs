//! What rooms exchange: the lowest room, so that any other may name these.

use nalgebra::{Vector2, Vector3};

pub use plumbline_proto::v1::{ControllerKind, EstimatorKind, Mode};

/// Standard gravity of the sources, m/s² (\[Umasankar\]).
pub const GRAVITY_MPS2: f64 = 9.81;
/// Slowest and fastest flight loop, Hz.
pub const TICK_RATE_HZ: std::ops::RangeInclusive<f64> = 50.0..=1000.0;
/// Rotors of the vehicle.
pub const ROTORS: usize = 4;
/// Cameras of the motion-capture system.
pub const CAMERAS: usize = 4;

/// What a vehicle is commanded by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Actuation {
    /// Its motors.
    #[default]
    Motors,
    /// Body rates and thrust, for an autopilot that turns motor commands back into them.
    Rates,
    /// Where it is and where it shall be: an autopilot's own controller flies, and motor commands only say whether the
    /// motors shall turn.
    Pose,
}

impl Actuation {
    /// For people and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Motors => "motors",
            Self::Rates => "rates",
            Self::Pose => "pose",
        }
    }
}

/// One motor command: what each motor is told, 0 (stopped) to 1 (full).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorCommand {
    /// One value per motor, 0..1.
    pub throttle: [f64; ROTORS],
}

/// Total thrust along body z and torque about the body axes FLU.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// N.
    pub thrust_n: f64,
    /// N m.
    pub torque_flu_nm: Vector3<f64>,
}

/// What the controller is asked to hold; already limited.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Position in the world frame ENU, m; z is the altitude above the floor.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s, fed forward.
    pub velocity_enu_mps: Vector3<f64>,
    /// In the world frame ENU, m/s², fed forward: upwards as thrust, sideways as tilt.
    pub acceleration_enu_mps2: Vector3<f64>,
    /// Roll, pitch, yaw, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Collective thrust as a fraction of the weight; used only where altitude is not controlled.
    pub throttle: f64,
}

impl Setpoint {
    /// Roll and pitch asked for at a heading, rad; while x and y are controlled with what the acceleration takes.
    pub fn tilt_rad(&self, loops: Loops, heading_rad: f64) -> Vector2<f64> {
        let asked = self.roll_pitch_yaw_rad.xy();
        if !loops.horizontal {
            return asked;
        }
        let a = self.acceleration_enu_mps2 / GRAVITY_MPS2;
        let (sin, cos) = heading_rad.sin_cos();
        asked + Vector2::new(sin * a.x - cos * a.y, cos * a.x + sin * a.y)
    }
}

/// Which errors the loop closes; set by the flight mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Loops {
    /// x and y, through roll and pitch.
    pub horizontal: bool,
    /// Altitude, through thrust.
    pub altitude: bool,
}
