//! A schedule of attacks and the bounds it must keep.

use arrayvec::ArrayVec;
use plumbline_proto::{ids::SensorId, v1::SensorKind};

use super::kinds::{Channel, Kind};

/// Most attacks of one schedule.
pub const MAX_ATTACKS: usize = 32;

/// One attack on one sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attack {
    /// Unique within the schedule.
    pub id: u32,
    /// The sensor.
    pub sensor: SensorId,
    /// Its scalars.
    pub channel: Channel,
    /// What is done to them.
    pub kind: Kind,
    /// Onset, s after the schedule is accepted.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// In the channel's unit, or as [`Kind`] says.
    pub magnitude: f64,
    /// Seed of the noise and of the dropouts.
    pub seed: u64,
}

/// Attacks uploaded together; a schedule replaces the one before.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Schedule {
    /// Chosen by the ground.
    pub id: u32,
    /// The attacks, in any order.
    pub attacks: ArrayVec<Attack, MAX_ATTACKS>,
}

/// How far attacks may go. Part of the agent's own configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Latest onset after acceptance, s.
    pub start_max_s: f64,
    /// Longest duration, s.
    pub duration_max_s: f64,
    /// Largest offset of a length (height, position, range), m. Ramps: per second.
    pub length_max_m: f64,
    /// Largest offset of an angular rate, rad/s.
    pub rate_max_radps: f64,
    /// Largest offset of a specific force, m/s².
    pub accel_max_mps2: f64,
    /// Largest offset of a magnetic field, µT.
    pub mag_max_ut: f64,
    /// Largest offset of a pressure, Pa.
    pub pressure_max_pa: f64,
    /// Largest factor of `Scale`, either sign.
    pub scale_max: f64,
    /// Longest window of `Replay`, s.
    pub replay_max_s: f64,
    /// Longest `Delay`, s.
    pub delay_max_s: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            start_max_s: 600.0,
            duration_max_s: 120.0,
            length_max_m: 5.0,
            rate_max_radps: 5.0,
            accel_max_mps2: 20.0,
            mag_max_ut: 100.0,
            pressure_max_pa: 500.0,
            scale_max: 10.0,
            replay_max_s: 10.0,
            delay_max_s: 2.0,
        }
    }
}

/// Why a schedule is refused. Nothing of it runs.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AttackError {
    /// The agent's configuration does not allow attacks.
    #[error("attacks are not enabled in this agent's configuration")]
    Disabled,
    /// Two attacks with one id.
    #[error("attack id {0} appears twice")]
    DuplicateId(u32),
    /// The sensor is not in the suite.
    #[error("attack {id}: the vehicle has no {sensor}")]
    NoSuchSensor {
        /// Attack.
        id: u32,
        /// Sensor.
        sensor: SensorId,
    },
    /// The sensor has no such channel, or the kind needs one unit.
    #[error("attack {id}: {kind:?} cannot cover {channel:?} of {sensor}")]
    Channel {
        /// Attack.
        id: u32,
        /// Sensor.
        sensor: SensorId,
        /// Channel asked for.
        channel: Channel,
        /// Kind asked for.
        kind: Kind,
    },
    /// A number out of bounds or not finite.
    #[error("attack {id}: {what} {value} is outside {min} to {max}")]
    OutOfBounds {
        /// Attack.
        id: u32,
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Smallest allowed.
        min: f64,
        /// Largest allowed.
        max: f64,
    },
}

impl Bounds {
    /// Checks one attack; returns the mask of its scalars.
    pub(super) fn check(&self, attack: &Attack) -> Result<u16, AttackError> {
        let Attack { id, sensor, channel, kind, .. } = *attack;
        let within = |what, value: f64, min: f64, max: f64| {
            // A NaN fails both comparisons.
            if value >= min && value <= max {
                Ok(())
            } else {
                Err(AttackError::OutOfBounds { id, what, value, min, max })
            }
        };
        within("start (s)", attack.start_s, 0.0, self.start_max_s)?;
        within("duration (s)", attack.duration_s, 1e-3, self.duration_max_s)?;
        let mask = channel.mask(sensor.kind, kind).ok_or(AttackError::Channel { id, sensor, channel, kind })?;
        let magnitude = attack.magnitude;
        match kind {
            Kind::Bias | Kind::Ramp | Kind::Noise => {
                let max = self.offset_max(sensor.kind, channel);
                let min = if kind == Kind::Noise { 0.0 } else { -max };
                within("magnitude", magnitude, min, max)?;
            }
            Kind::Scale => within("scale", magnitude, -self.scale_max, self.scale_max)?,
            Kind::Replay => within("replay window (s)", magnitude, 0.05, self.replay_max_s)?,
            Kind::Delay => within("delay (s)", magnitude, 0.0, self.delay_max_s)?,
            Kind::Dropout => within("dropout probability", magnitude, 0.0, 1.0)?,
            Kind::Zero | Kind::Freeze | Kind::SignFlip => {}
        }
        Ok(mask)
    }

    fn offset_max(&self, sensor: SensorKind, channel: Channel) -> f64 {
        match (sensor, channel) {
            (SensorKind::Imu, Channel::Gyro | Channel::GyroAxis(_)) => self.rate_max_radps,
            (SensorKind::Imu, Channel::Mag) => self.mag_max_ut,
            (SensorKind::Imu, _) => self.accel_max_mps2,
            (SensorKind::Barometer, _) => self.pressure_max_pa,
            _ => self.length_max_m,
        }
    }
}
