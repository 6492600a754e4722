//! What an attack does to one sample, seen as a short list of scalars.
//!
//! Every sensor's sample is viewed as up to nine scalars; an attack alters those its channel covers.
//! Additive kinds (bias, ramp, parabola, noise) need one unit, so on `All` they cover the sensor's first
//! quantity only (position of a GNSS fix, pressure of a barometer); on an IMU, whose quantities are
//! equals, they must name one. The command of a rotor is one scalar, the thrust it asks for as a part of the rotor's full one.

use plumbline_proto::v1::SensorKind;
use serde::Deserialize;

use crate::sensor::sample::Quantity;

/// What an attack on the command of a rotor alters.
const ROTOR: [Quantity; 1] = [Quantity { name: "thrust", unit: "of full thrust", scalars: 1, named: false }];

/// What there is to alter of a target of this kind.
pub(super) fn quantities(target: SensorKind) -> &'static [Quantity] {
    if target == SensorKind::Rotor { &ROTOR } else { crate::sensor::quantities(target) }
}

/// The named quantities of an IMU.
const GYRO: &str = "gyro";
const ACCEL: &str = "accel";
const MAG: &str = "mag";

/// What is done to the covered scalars; in files in lower snake case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// v → 0
    Zero,
    /// v → v + magnitude
    Bias,
    /// v → v + magnitude · (t − onset)
    Ramp,
    /// v → v · magnitude
    Scale,
    /// v → v + N(0, magnitude²)
    Noise,
    /// v → last value before onset
    Freeze,
    /// v → the `magnitude` seconds before onset, or what is remembered of them, played again and again
    Replay,
    /// v → the value `magnitude` seconds ago
    Delay,
    /// The sample is withheld with probability `magnitude`; a motor then keeps what it was told last.
    Dropout,
    /// v → −v
    SignFlip,
    /// v → v + magnitude · (t − onset)²/2; with a bias of the accelerometers as large, a motion that is none
    Parabola,
    /// The sample is stamped `magnitude` seconds later; the command of a rotor has no stamp.
    TimeShift,
}

impl Kind {
    /// Adds a value in the channel's unit, so that it must cover scalars of one unit.
    pub fn is_additive(self) -> bool {
        matches!(self, Kind::Bias | Kind::Ramp | Kind::Noise | Kind::Parabola)
    }
}

/// Which scalars of the sensor are covered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Every scalar; see the module documentation for additive kinds.
    All,
    /// Angular rates of an IMU.
    Gyro,
    /// Specific force of an IMU.
    Accel,
    /// Magnetic field of an IMU.
    Mag,
    /// One axis: of the position, or the n-th scalar.
    Axis(u8),
    /// One axis of the gyroscope, 0..3.
    GyroAxis(u8),
    /// One axis of the accelerometer, 0..3.
    AccelAxis(u8),
}

impl Channel {
    /// Bit mask over the scalars of `sensor` for `kind`; `None` when the sensor has no such channel.
    pub(super) fn mask(self, sensor: SensorKind, kind: Kind) -> Option<u16> {
        let quantities = quantities(sensor);
        let bits = |scalars: usize| (1_u16 << scalars) - 1;
        let all = bits(quantities.iter().map(|quantity| quantity.scalars).sum());
        let first = quantities.first().map_or(0, |first| if first.named { 0 } else { bits(first.scalars) });
        let quantity = |name: &str| {
            let at = quantities.iter().position(|quantity| quantity.named && quantity.name == name)?;
            let begin: usize = quantities.iter().take(at).map(|quantity| quantity.scalars).sum();
            quantities.get(at).map(|quantity| (begin, bits(quantity.scalars) << begin))
        };
        let whole = |name| quantity(name).map_or(0, |(_, mask)| mask);
        let axis = |name, axis: u8| quantity(name).map_or(0, |(begin, mask)| mask & 1 << (begin + usize::from(axis)));
        let mask = match self {
            Channel::All if kind.is_additive() => first,
            Channel::All => all,
            Channel::Gyro => whole(GYRO),
            Channel::Accel => whole(ACCEL),
            Channel::Mag => whole(MAG),
            Channel::GyroAxis(n @ 0..3) => axis(GYRO, n),
            Channel::AccelAxis(n @ 0..3) => axis(ACCEL, n),
            Channel::Axis(n @ 0..3) => first & 1 << n,
            Channel::Axis(_) | Channel::GyroAxis(_) | Channel::AccelAxis(_) => 0,
        };
        (mask != 0).then_some(mask)
    }

    /// Unit of what an additive attack on this channel of `sensor` adds.
    pub(super) fn unit(self, sensor: SensorKind) -> &'static str {
        let named = match self {
            Channel::Gyro | Channel::GyroAxis(_) => Some(GYRO),
            Channel::Accel | Channel::AccelAxis(_) => Some(ACCEL),
            Channel::Mag => Some(MAG),
            Channel::All | Channel::Axis(_) => None,
        };
        let meant = |quantity: &&Quantity| named.is_none_or(|name| quantity.name == name);
        quantities(sensor).iter().find(meant).map_or("", |quantity| quantity.unit)
    }
}
