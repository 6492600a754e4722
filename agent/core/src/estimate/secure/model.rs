//! The window's linear model: its states, what each signal sees of them, and the noise assumed.
//!
//! The state is the deviation from the filter's own path as its IMUs alone would have continued it, at the
//! window's end, in the frame of the present heading: z … r of [Clinic]'s ten states and the mean deviation of
//! the accelerometers. Values are counted from that path, so the forced response (thrust, strings, ground) is
//! removed by measurement; the model of the deviations is linear about the trim.
//!
//! | state | what | sees it |
//! |---|---|---|
//! | z, v_z | height, climb, m, m/s | heights, barometers |
//! | v_x, v_y | m/s, heading frame | v̇_x = g pitch, v̇_y = −g roll; the filter's own σ |
//! | roll, pitch, yaw | rad | magnetometers (yaw); the filter's own σ |
//! | p, q, r | rad/s | gyroscopes |
//! | a_x a_y a_z | mean error of the accelerometers, m/s² | accelerometers |

use nalgebra::{SMatrix, SVector};

use super::window::{Model, Row};
use crate::estimate::Estimate;
use crate::sensor::SensorModel;
use crate::sensor::imu::TriaxialModel;

/// States of the window.
pub const STATES: usize = 13;
/// Indices of the window's states: those of [Clinic] 3.1 in order, then the accelerometers' mean error.
pub mod ix {
    /// Height, m.
    pub const Z: usize = 0;
    /// m/s, heading frame.
    pub const VX: usize = 1;
    /// m/s, heading frame.
    pub const VY: usize = 2;
    /// m/s.
    pub const VZ: usize = 3;
    /// rad.
    pub const ROLL: usize = 4;
    /// rad.
    pub const PITCH: usize = 5;
    /// rad.
    pub const YAW: usize = 6;
    /// rad/s; q and r follow.
    pub const P: usize = 7;
    /// m/s²; y and z follow.
    pub const AX: usize = 10;
}

/// Length of a slot, s.
pub const SLOT_S: f64 = 0.04;

/// What a signal measures: a row of the window's model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Laser height.
    Height,
    /// Pressure altitude.
    Barometer,
    /// Gyroscope x y z, accelerometer x y z, less the median of the IMUs.
    Inertial(usize),
    /// Magnetic heading less the filter's.
    Heading,
}

impl Quantity {
    /// Every quantity, in the order of [`rows`].
    pub const ALL: [Self; 9] = [
        Self::Height,
        Self::Barometer,
        Self::Inertial(0),
        Self::Inertial(1),
        Self::Inertial(2),
        Self::Inertial(3),
        Self::Inertial(4),
        Self::Inertial(5),
        Self::Heading,
    ];

    /// Its place in [`rows`].
    pub fn row(self) -> usize {
        match self {
            Self::Height => 0,
            Self::Barometer => 1,
            Self::Inertial(channel) => 2 + channel,
            Self::Heading => 8,
        }
    }

    /// Does an IMU measure it?
    pub fn is_of_imu(self) -> bool {
        matches!(self, Self::Inertial(_) | Self::Heading)
    }

    /// The state it sees.
    fn state(self) -> usize {
        match self {
            Self::Height | Self::Barometer => ix::Z,
            Self::Inertial(channel) if channel < 3 => ix::P + channel,
            Self::Inertial(channel) => ix::AX + channel - 3,
            Self::Heading => ix::YAW,
        }
    }
}

/// What is assumed of one signal's value in a slot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Assumed {
    /// Noise, one-sigma.
    pub sigma: f64,
    /// Constant deviation that no baseline removes: β of its row.
    pub bias: f64,
    /// Largest baseline.
    pub limit: f64,
}

impl Assumed {
    /// Of `quantity` by sensors like these.
    pub fn of(quantity: Quantity, model: &SensorModel) -> Self {
        // The consensus' memory is 1.25 periods of an IMU.
        let samples = |memory_s: f64| (SLOT_S / (memory_s / 1.25).clamp(1e-3, SLOT_S)).max(1.0);
        // IMUs that sample in turns see the ripple of the loop at their own phase: as much as healthy units spread.
        let imu = |assumed: &TriaxialModel, least: f64| Self {
            sigma: assumed.sigma.max(least) / samples(assumed.memory_s).sqrt(),
            bias: assumed.spread,
            limit: 3.0 * assumed.spread,
        };
        let height = model.heights.sigma.max(1e-3);
        let barometer = model.barometers.altitude.sigma.max(0.01);
        let heading = model.imus.mag.floor_rad.max(1e-3);
        match quantity {
            Quantity::Height => Self { sigma: height, bias: 0.25 * height, limit: 2.0 * height },
            Quantity::Barometer => Self { sigma: barometer, bias: 0.5 * barometer, limit: f64::INFINITY },
            Quantity::Inertial(channel) if channel < 3 => imu(&model.imus.gyro, 1e-4),
            Quantity::Inertial(_) => imu(&model.imus.accel, 1e-3),
            Quantity::Heading => Self { sigma: heading, bias: heading, limit: 6.0 * heading },
        }
    }
}

/// One row for each quantity.
pub(super) fn rows(model: &SensorModel) -> [Row<STATES>; Quantity::ALL.len()] {
    Quantity::ALL.map(|quantity| {
        let mut c = SVector::zeros();
        c[quantity.state()] = 1.0;
        let Assumed { sigma, bias, .. } = Assumed::of(quantity, model);
        Row { c, sigma, bias_sigma: bias }
    })
}

/// Deviations about the trim over one slot, exact: F⁴ = 0. Split, a tilt makes no speed.
pub(super) fn transition(model: &SensorModel, split: bool) -> Model<STATES> {
    let mut f = SMatrix::<f64, STATES, STATES>::zeros();
    f[(ix::Z, ix::VZ)] = 1.0;
    if !split {
        f[(ix::VX, ix::PITCH)] = model.imus.gravity_mps2;
        f[(ix::VY, ix::ROLL)] = -model.imus.gravity_mps2;
    }
    for k in 0..3 {
        f[(ix::ROLL + k, ix::P + k)] = 1.0;
    }
    let f = f * SLOT_S;
    let a = SMatrix::identity() + f + f * f * 0.5 + f * f * f * (1.0 / 6.0);
    let mut q = SVector::<f64, STATES>::zeros();
    // The IMUs' path over a slot: a quarter of a bias, vibration, and what turns between samples.
    let climb = 0.25 * model.imus.accel.bias_prior * SLOT_S + model.imus.accel.noise_density * SLOT_S.sqrt();
    q[ix::Z] = (0.2e-3f64).powi(2);
    q[ix::VZ] = climb * climb;
    for (state, sigma) in [(ix::VX, 0.02), (ix::VY, 0.02), (ix::ROLL, 1e-3), (ix::PITCH, 1e-3), (ix::YAW, 1e-3)] {
        q[state] = sigma * sigma;
    }
    let gyro = Assumed::of(Quantity::Inertial(0), model).sigma;
    let accel = Assumed::of(Quantity::Inertial(3), model).sigma;
    for k in 0..3 {
        q[ix::P + k] = (0.3 * gyro).powi(2);
        q[ix::AX + k] = (0.3 * accel).powi(2);
    }
    Model { a, q: SMatrix::from_diagonal(&q) }
}

/// States and one-sigmas that `estimate` knows around zero; height among them only without `vertical` sensors, so that
/// a vehicle without heights and barometers still has its IMUs examined.
pub(super) fn prior(estimate: &Estimate, vertical: bool) -> [(usize, f64); STATES] {
    let motion = estimate.motion_or_rest();
    let [p, v, a] = [motion.position_sigma_m, motion.velocity_sigma_mps, estimate.attitude_sigma_rad]
        .map(Option::unwrap_or_default);
    [
        (ix::Z, if vertical { f64::INFINITY } else { p.z.clamp(0.05, 10.0) }),
        (ix::VX, v.x.clamp(0.05, 5.0)),
        (ix::VY, v.y.clamp(0.05, 5.0)),
        (ix::VZ, 2.0),
        (ix::ROLL, a.x.clamp(0.005, 1.0)),
        (ix::PITCH, a.y.clamp(0.005, 1.0)),
        (ix::YAW, 0.5),
        (ix::P, 2.0),
        (ix::P + 1, 2.0),
        (ix::P + 2, 2.0),
        (ix::AX, 10.0),
        (ix::AX + 1, 10.0),
        (ix::AX + 2, 10.0),
    ]
}
