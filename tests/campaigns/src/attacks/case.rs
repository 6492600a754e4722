//! What is attacked, and how: everything about an attack is drawn from the flight's seed.

use plumbline_agent::attack::{Attack, Bounds, Channel, Kind, offered};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use crate::draw::Dice;

/// Earliest and latest onset, s.
const ONSET_S: (f64, f64) = (14.0, 22.0);
/// Shortest and longest attack, s.
const DURATION_S: (f64, f64) = (4.0, 14.0);
/// The smallest that is added, as a part of the most that the vehicle allows: an attack in the noise is among them.
const SMALLEST: f64 = 0.004;
const KINDS: [Kind; 10] = [
    Kind::Zero,
    Kind::Bias,
    Kind::Ramp,
    Kind::Scale,
    Kind::Noise,
    Kind::Freeze,
    Kind::Replay,
    Kind::Delay,
    Kind::Dropout,
    Kind::SignFlip,
];

/// Which sensors are attacked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Attacked {
    None,
    /// Any one IMU, height or barometer.
    One,
    /// One IMU and one height.
    ImuAndHeight,
    /// So many of a kind, each in its own way.
    Several(SensorKind, usize),
    /// So many heights, by the same bias at the same time.
    Colluding(usize),
    /// One sensor by one kind of attack of one size, for curves.
    Sized(SensorKind, Channel, f64),
}

/// A row of the table.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    pub name: &'static str,
    pub world: &'static str,
    pub heights: usize,
    pub imus: usize,
    pub attacked: Attacked,
    /// Most that e/e* may be: median, 95th percentile, worst.
    pub altitude: [f64; 3],
    /// The same of the tilt's error.
    pub tilt: [f64; 3],
    /// Most flights lost of a hundred.
    pub lost: f64,
}

/// No limit.
const ANY: [f64; 3] = [f64::INFINITY; 3];

impl Case {
    const PLAIN: Self = Self {
        name: "none",
        world: "datasheet",
        heights: 3,
        imus: 4,
        attacked: Attacked::None,
        altitude: [1.05, 1.15, 1.25],
        tilt: ANY,
        lost: 0.0,
    };

    /// The rows of the table.
    pub const ALL: [Self; 8] = [
        Self::PLAIN,
        Self {
            name: "one_sensor",
            attacked: Attacked::One,
            altitude: [1.15, 1.3, 1.5],
            tilt: [1.1, 1.7, 2.0],
            ..Self::PLAIN
        },
        Self { name: "imu_and_height", attacked: Attacked::ImuAndHeight, altitude: [1.15, 1.35, 1.6], ..Self::PLAIN },
        Self {
            name: "two_of_five_heights",
            heights: 5,
            imus: 5,
            attacked: Attacked::Several(SensorKind::Height, 2),
            altitude: [1.3, 1.6, 1.8],
            ..Self::PLAIN
        },
        Self {
            name: "two_of_five_imus",
            heights: 5,
            imus: 5,
            attacked: Attacked::Several(SensorKind::Imu, 2),
            altitude: [1.1, 1.3, 1.5],
            tilt: [1.2, 2.2, 2.5],
            ..Self::PLAIN
        },
        Self { name: "two_of_three_heights_colluding", attacked: Attacked::Colluding(2), altitude: ANY, ..Self::PLAIN },
        Self { name: "harsh_none", world: "harsh", altitude: ANY, lost: 1.0, ..Self::PLAIN },
        Self {
            name: "harsh_one_sensor",
            world: "harsh",
            attacked: Attacked::One,
            altitude: [1.3, 1.8, f64::INFINITY],
            lost: 1.0,
            ..Self::PLAIN
        },
    ];

    /// One sensor attacked by a bias of this size.
    pub fn sized(sensor: SensorKind, channel: Channel, size: f64) -> Self {
        Self { name: "curve", attacked: Attacked::Sized(sensor, channel, size), altitude: ANY, ..Self::PLAIN }
    }

    /// The attacks of the flight of this `seed`.
    pub fn attacks(&self, seed: u64) -> Vec<Attack> {
        let mut dice = Dice::new(seed ^ 0xa77a_c4ed);
        let mut any = |kind, of| SensorId::new(kind, 1 + (dice.uniform() * of as f64) as u8);
        match self.attacked {
            Attacked::None => Vec::new(),
            Attacked::One => {
                let index = (dice.uniform() * (self.imus + self.heights + 1) as f64) as usize;
                let sensor = if index < self.imus {
                    SensorId::new(SensorKind::Imu, 1 + index as u8)
                } else if index < self.imus + self.heights {
                    SensorId::new(SensorKind::Height, 1 + (index - self.imus) as u8)
                } else {
                    SensorId::new(SensorKind::Barometer, 1)
                };
                vec![drawn(&mut dice, 1, sensor)]
            }
            Attacked::ImuAndHeight => {
                let sensors = [any(SensorKind::Imu, self.imus), any(SensorKind::Height, self.heights)];
                sensors.into_iter().zip(1..).map(|(sensor, id)| drawn(&mut dice, id, sensor)).collect()
            }
            Attacked::Several(kind, count) => {
                let of = if kind == SensorKind::Imu { self.imus } else { self.heights };
                let chosen = dice.choose(count, of);
                let sensors = chosen.into_iter().map(|index| SensorId::new(kind, 1 + index as u8));
                sensors.zip(1..).map(|(sensor, id)| drawn(&mut dice, id, sensor)).collect()
            }
            Attacked::Colluding(count) => {
                let chosen = dice.choose(count, self.heights);
                let size = sign(&mut dice) * (0.3 + 1.7 * dice.uniform());
                let (start_s, duration_s) = when(&mut dice);
                let attack = |(index, id): (usize, u32)| Attack {
                    id,
                    sensor: SensorId::new(SensorKind::Height, 1 + index as u8),
                    channel: Channel::All,
                    kind: Kind::Bias,
                    start_s,
                    duration_s,
                    magnitude: size,
                    seed,
                };
                chosen.into_iter().zip(1..).map(attack).collect()
            }
            Attacked::Sized(kind, channel, size) => {
                let sensor = any(kind, if kind == SensorKind::Imu { self.imus } else { self.heights });
                let magnitude = sign(&mut dice) * size;
                let (start_s, _) = when(&mut dice);
                let duration_s = DURATION_S.1;
                vec![Attack { id: 1, sensor, channel, kind: Kind::Bias, start_s, duration_s, magnitude, seed }]
            }
        }
    }
}

fn sign(dice: &mut Dice) -> f64 {
    if dice.uniform() < 0.5 { -1.0 } else { 1.0 }
}

fn between(dice: &mut Dice, (low, high): (f64, f64)) -> f64 {
    low + (high - low) * dice.uniform()
}

/// Onset and duration, s.
fn when(dice: &mut Dice) -> (f64, f64) {
    (between(dice, ONSET_S), between(dice, DURATION_S))
}

/// Any attack on `sensor` that the vehicle takes: kind, channel, size, sign, onset and duration.
fn drawn(dice: &mut Dice, id: u32, sensor: SensorId) -> Attack {
    let bounds = Bounds::default();
    let mut pick = |count: usize| ((dice.uniform() * count as f64) as usize).min(count - 1);
    let kind = KINDS[pick(KINDS.len())];
    let channels: Vec<_> =
        offered(sensor.kind, &bounds).filter(|(_, _, most)| !kind.is_additive() || *most > 0.0).collect();
    let (channel, _, most) = channels[pick(channels.len())];
    let magnitude = match kind {
        // Every size is as likely as the tenfold: most are small beside what the vehicle allows.
        Kind::Bias | Kind::Ramp => sign(dice) * most * SMALLEST.powf(dice.uniform()),
        Kind::Noise => most * SMALLEST.powf(dice.uniform()),
        Kind::Scale => between(dice, (-2.0, 3.0)),
        Kind::Replay => between(dice, (0.5, bounds.replay_max_s)),
        Kind::Delay => between(dice, (0.05, bounds.delay_max_s)),
        Kind::Dropout => between(dice, (0.2, 1.0)),
        Kind::Zero | Kind::Freeze | Kind::SignFlip => 0.0,
    };
    let (start_s, duration_s) = when(dice);
    let seed = (dice.uniform() * 1e9) as u64;
    Attack { id, sensor, channel, kind, start_s, duration_s, magnitude, seed }
}
