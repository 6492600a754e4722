//! A schedule of attacks and the bounds it must keep.

use std::fmt;

use arrayvec::ArrayVec;
use plumbline_proto::{ids::SensorId, v1::SensorKind};

use super::kinds::{Channel, Kind, quantities};

/// Most attacks of one schedule.
pub use plumbline_proto::limits::MAX_ATTACKS;

/// One attack on one sensor, or on the command of one rotor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attack {
    /// Unique within the schedule.
    pub id: u32,
    /// The sensor, or the rotor.
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

/// What is done, for people: "bias of 0.5 m".
impl fmt::Display for Attack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (m, unit) = (self.magnitude, self.channel.unit(self.sensor.kind));
        match self.kind {
            Kind::Zero => write!(f, "zero"),
            Kind::Bias => write!(f, "bias of {m} {unit}"),
            Kind::Ramp => write!(f, "ramp of {m} {unit} a second"),
            Kind::Scale => write!(f, "scale by {m}"),
            Kind::Noise => write!(f, "noise of {m} {unit}"),
            Kind::Freeze => write!(f, "freeze"),
            Kind::Replay => write!(f, "replay of {m} s"),
            Kind::Delay => write!(f, "delay of {m} s"),
            Kind::Dropout => write!(f, "dropout of {m} of the samples"),
            Kind::SignFlip => write!(f, "sign flip"),
            Kind::Parabola => write!(f, "parabola of {m} {unit} a second squared"),
            Kind::TimeShift => write!(f, "time shift of {m} s"),
        }
    }
}

/// Attacks uploaded together; a schedule replaces the one before.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Schedule {
    /// Chosen by the ground.
    pub id: u32,
    /// The attacks, in any order.
    pub attacks: ArrayVec<Attack, MAX_ATTACKS>,
    /// What biases among them follow.
    pub sequences: Vec<Sequence>,
}

/// A bias that follows a table: v → v + magnitude · valueₖ, k = ⌊(t − onset)/period⌋; nothing is added behind its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Sequence {
    /// Its attack, of [`Kind::Bias`].
    pub attack: u32,
    /// s.
    pub period_s: f64,
    /// Each within ±1: the magnitude is the most that is added.
    pub values: Vec<f64>,
}

/// Longest table.
pub const MAX_SEQUENCE: usize = 4096;

/// How far attacks may go. Part of the agent's own configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Latest onset after acceptance, s.
    pub start_max_s: f64,
    /// Longest duration, s.
    pub duration_max_s: f64,
    /// Largest offset of a length (height, position, range), m. Ramps: per second, parabolas: per second squared.
    pub length_max_m: f64,
    /// Largest offset of an angular rate, rad/s.
    pub rate_max_radps: f64,
    /// Largest offset of a specific force, m/s².
    pub accel_max_mps2: f64,
    /// Largest offset of a magnetic field, µT.
    pub mag_max_ut: f64,
    /// Largest offset of a pressure, Pa.
    pub pressure_max_pa: f64,
    /// Largest offset of a rotor's thrust, as a part of its full one.
    pub thrust_max: f64,
    /// Largest factor of `Scale`, either sign.
    pub scale_max: f64,
    /// Longest window of `Replay`, s.
    pub replay_max_s: f64,
    /// Longest `Delay`, and furthest `TimeShift`, s.
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
            thrust_max: 1.0,
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
    /// The configuration names the sensor as independent.
    #[error("attack {id}: {sensor} is configured as independent: nothing can be injected there")]
    Independent {
        /// Attack.
        id: u32,
        /// Sensor.
        sensor: SensorId,
    },
    /// The sensor has no such channel, or the kind needs one unit or a stamp.
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
    /// A table for an attack that follows none.
    #[error("sequence of attack {0}: there is no such attack, or it is no bias")]
    NoBias(u32),
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
        let stamped = sensor.kind != SensorKind::Rotor || kind != Kind::TimeShift;
        let mask = channel.mask(sensor.kind, kind).filter(|_| stamped);
        let mask = mask.ok_or(AttackError::Channel { id, sensor, channel, kind })?;
        let magnitude = attack.magnitude;
        match kind {
            Kind::Bias | Kind::Ramp | Kind::Parabola | Kind::Noise => {
                let max = self.offset_max(sensor.kind, channel);
                let min = if kind == Kind::Noise { 0.0 } else { -max };
                within("magnitude", magnitude, min, max)?;
            }
            Kind::Scale => within("scale", magnitude, -self.scale_max, self.scale_max)?,
            Kind::Replay => within("replay window (s)", magnitude, 0.05, self.replay_max_s)?,
            Kind::Delay => within("delay (s)", magnitude, 0.0, self.delay_max_s)?,
            Kind::TimeShift => within("time shift (s)", magnitude, -self.delay_max_s, self.delay_max_s)?,
            Kind::Dropout => within("dropout probability", magnitude, 0.0, 1.0)?,
            Kind::Zero | Kind::Freeze | Kind::SignFlip => {}
        }
        Ok(mask)
    }

    /// Checks what the biases among `attacks` follow.
    pub(super) fn check_sequence(attacks: &[Attack], sequence: &Sequence) -> Result<(), AttackError> {
        let id = sequence.attack;
        if !attacks.iter().any(|attack| attack.id == id && attack.kind == Kind::Bias) {
            return Err(AttackError::NoBias(id));
        }
        let within = |what, value: f64, min: f64, max: f64| {
            if value >= min && value <= max {
                Ok(())
            } else {
                Err(AttackError::OutOfBounds { id, what, value, min, max })
            }
        };
        within("sequence period (s)", sequence.period_s, 1e-3, 10.0)?;
        within("values of a sequence", sequence.values.len() as f64, 1.0, MAX_SEQUENCE as f64)?;
        sequence.values.iter().try_for_each(|value| within("value of a sequence", *value, -1.0, 1.0))
    }

    fn offset_max(&self, sensor: SensorKind, channel: Channel) -> f64 {
        match channel.unit(sensor) {
            "rad/s" => self.rate_max_radps,
            "m/s²" => self.accel_max_mps2,
            "µT" => self.mag_max_ut,
            "Pa" => self.pressure_max_pa,
            "of full thrust" => self.thrust_max,
            _ => self.length_max_m,
        }
    }
}

/// The channels of `sensor` that an attack can name, each with its unit (empty where its parts have several) and the
/// most that an attack may add to it (0 where it may add nothing).
pub fn offered(sensor: SensorKind, bounds: &Bounds) -> impl Iterator<Item = (Channel, &'static str, f64)> {
    use Channel::{Accel, AccelAxis, All, Axis, Gyro, GyroAxis, Mag};
    let axes = |axis: fn(u8) -> Channel| (0..3).map(axis);
    let every = [All, Gyro, Accel, Mag].into_iter().chain(axes(Axis)).chain(axes(GyroAxis)).chain(axes(AccelAxis));
    // A single scalar, or one range of many, is no axis.
    let spatial = quantities(sensor).first().is_some_and(|first| first.scalars == 3);
    every
        .filter(move |channel| (spatial || !matches!(channel, Axis(_))) && channel.mask(sensor, Kind::Zero).is_some())
        .map(move |channel| {
            let additive = channel.mask(sensor, Kind::Bias).is_some();
            let (unit, most) =
                if additive { (channel.unit(sensor), bounds.offset_max(sensor, channel)) } else { ("", 0.0) };
            (channel, unit, most)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_offers_the_channels_it_has_with_unit_and_bound() {
        let of = |sensor| offered(sensor, &Bounds::default()).collect::<Vec<_>>();
        assert_eq!(of(SensorKind::Height), [(Channel::All, "m", 5.0)]);
        assert_eq!(of(SensorKind::Barometer), [(Channel::All, "Pa", 500.0)]);
        assert_eq!(of(SensorKind::Gnss).len(), 4);
        let imu = of(SensorKind::Imu);
        assert_eq!(imu.len(), 10, "{imu:?}");
        assert_eq!(imu[0], (Channel::All, "", 0.0), "an attack that adds must name a quantity");
        assert_eq!(imu[3], (Channel::Mag, "µT", 100.0));
        assert!(imu.contains(&(Channel::AccelAxis(2), "m/s²", 20.0)));
        assert_eq!(of(SensorKind::Rotor), [(Channel::All, "of full thrust", 1.0)]);
        assert!(of(SensorKind::Unspecified).is_empty());
    }
}
