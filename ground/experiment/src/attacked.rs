//! What is attacked, and how: everything about an attack is drawn from the flight's seed.

use plumbline_agent::attack::{Attack, Bounds, Channel, Kind, offered};
use plumbline_agent::types::ROTORS;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use crate::draw::{Dice, derived};

/// Earliest and latest onset, s.
const ONSET_S: (f64, f64) = (14.0, 22.0);
/// Shortest and longest attack, s.
const DURATION_S: (f64, f64) = (4.0, 14.0);
/// What the dice of a flight's seed are told apart by from those that others throw with it: of what is attacked, and of when.
const WHAT: u64 = 0xa77a_c4ed;
const WHEN: u64 = 0x0045_e700;
/// The smallest that is added, as a part of the most that the vehicle allows: an attack in the noise is among them.
const SMALLEST: f64 = 0.004;
/// The kinds that are drawn: every one. A rotor's command has no stamp to shift, the last.
pub const KINDS: [Kind; 12] = [
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
    Kind::Parabola,
    Kind::TimeShift,
];

/// Which sensors are attacked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Attacked {
    /// None.
    None,
    /// Any one IMU, height or barometer.
    One,
    /// One IMU and one height.
    ImuAndHeight,
    /// So many of a kind, each in its own way.
    Several(SensorKind, usize),
    /// So many heights, by the same bias at the same time.
    Colluding(usize),
    /// One sensor of a kind, in this way; the rest is drawn.
    Kind(SensorKind, Kind),
    /// One sensor in one way.
    Given(Given),
}

/// An attack of which something is given; the rest is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Given {
    /// The sensor's kind.
    pub sensor: SensorKind,
    /// Which of them.
    pub instance: Option<u8>,
    /// Its scalars.
    pub channel: Channel,
    /// What is done.
    pub kind: Kind,
    /// As [`Kind`] says; the sign of what is added may be drawn unless it is negative.
    pub magnitude: f64,
    /// Is it?
    pub sign_drawn: bool,
    /// Onset, s; otherwise the first of `count` that are drawn.
    pub start_s: Option<f64>,
    /// One; where only the onset counts, as many sensors as are attacked in the flights that are compared with it.
    pub count: usize,
    /// Duration, s; the longest of those drawn otherwise.
    pub duration_s: Option<f64>,
}

impl Given {
    /// A bias of this size on one sensor.
    pub fn bias(sensor: SensorKind, channel: Channel, magnitude: f64) -> Self {
        let kind = Kind::Bias;
        let (start_s, duration_s) = (None, None);
        Self { sensor, instance: None, channel, kind, magnitude, sign_drawn: true, start_s, count: 1, duration_s }
    }

    /// Is any sample another one after it?
    fn alters(&self) -> bool {
        let unaltered = match self.kind {
            Kind::Scale => 1.0,
            Kind::Zero | Kind::Freeze | Kind::Replay | Kind::SignFlip => return true,
            _ => 0.0,
        };
        self.magnitude != unaltered
    }
}

/// How many of a kind the vehicle has.
fn count(sensors: &[SensorId], kind: SensorKind) -> usize {
    if kind == SensorKind::Rotor {
        return ROTORS;
    }
    sensors.iter().filter(|sensor| sensor.kind == kind).count()
}

impl Attacked {
    /// Is it more than any estimator can tell from the healthy ones?
    pub fn colludes(&self) -> bool {
        matches!(self, Self::Colluding(_))
    }

    /// Is any sample another one after it?
    pub(crate) fn alters(&self) -> bool {
        match self {
            Self::None => false,
            Self::Given(given) => given.alters(),
            _ => true,
        }
    }

    /// No onset is later, s.
    pub(crate) fn latest_onset_s(&self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Given(given) => given.start_s.unwrap_or(ONSET_S.1),
            _ => ONSET_S.1,
        }
    }

    /// The attacks of the flight of this `seed` on a vehicle with these sensors. The first onset follows from the seed and from how
    /// many sensors are attacked, not from what is done to them.
    pub fn attacks(&self, sensors: &[SensorId], seed: u64) -> Vec<Attack> {
        let [imus, heights, barometers] =
            [SensorKind::Imu, SensorKind::Height, SensorKind::Barometer].map(|kind| count(sensors, kind));
        let mut dice = Dice::new(seed ^ WHAT);
        let mut any = |kind, of| SensorId::new(kind, 1 + (dice.uniform() * of as f64) as u8);
        match *self {
            Attacked::None => Vec::new(),
            Attacked::One => {
                let index = (dice.uniform() * (imus + heights + barometers) as f64) as usize;
                let sensor = if index < imus {
                    SensorId::new(SensorKind::Imu, 1 + index as u8)
                } else if index < imus + heights {
                    SensorId::new(SensorKind::Height, 1 + (index - imus) as u8)
                } else {
                    SensorId::new(SensorKind::Barometer, 1 + (index - imus - heights) as u8)
                };
                vec![drawn(&mut dice, seed, 1, sensor)]
            }
            Attacked::ImuAndHeight => {
                let sensors = [any(SensorKind::Imu, imus), any(SensorKind::Height, heights)];
                sensors.into_iter().zip(1..).map(|(sensor, id)| drawn(&mut dice, seed, id, sensor)).collect()
            }
            Attacked::Several(kind, several) => {
                let chosen = dice.choose(several, count(sensors, kind));
                let sensors = chosen.into_iter().map(|index| SensorId::new(kind, 1 + index as u8));
                sensors.zip(1..).map(|(sensor, id)| drawn(&mut dice, seed, id, sensor)).collect()
            }
            Attacked::Colluding(several) => {
                let chosen = dice.choose(several, heights);
                let size = sign(&mut dice) * (0.3 + 1.7 * dice.uniform());
                let (start_s, duration_s) = first(seed, chosen.len());
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
            Attacked::Kind(of, kind) => {
                let sensor = any(of, count(sensors, of));
                vec![drawn_of(&mut dice, seed, 1, sensor, kind)]
            }
            Attacked::Given(given) => {
                let there = count(sensors, given.sensor);
                let drawn = any(given.sensor, there);
                let sensor = given.instance.map_or(drawn, |instance| SensorId::new(given.sensor, instance));
                let sign = sign(&mut dice);
                let added = matches!(given.kind, Kind::Bias | Kind::Ramp) && given.magnitude >= 0.0;
                let magnitude = if added && given.sign_drawn { sign * given.magnitude } else { given.magnitude };
                let (start_s, _) = first(seed, given.count.min(there).max(1));
                let (start_s, duration_s) =
                    (given.start_s.unwrap_or(start_s), given.duration_s.unwrap_or(DURATION_S.1));
                let Given { channel, kind, .. } = given;
                vec![Attack { id: 1, sensor, channel, kind, start_s, duration_s, magnitude, seed }]
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

/// Onset and duration of an attack, s.
fn when(seed: u64, id: u32) -> (f64, f64) {
    let mut dice = Dice::new(derived(seed ^ WHEN, id.into()));
    (between(&mut dice, ONSET_S), between(&mut dice, DURATION_S))
}

/// The same of the first of so many attacks.
fn first(seed: u64, count: usize) -> (f64, f64) {
    let all = (1..).take(count).map(|id| when(seed, id));
    all.min_by(|(one, _), (other, _)| one.total_cmp(other)).unwrap_or((ONSET_S.1, DURATION_S.1))
}

/// Any attack on `sensor` that the vehicle takes: kind, channel, size, sign, onset and duration.
fn drawn(dice: &mut Dice, seed: u64, id: u32, sensor: SensorId) -> Attack {
    let kinds = KINDS.len() - usize::from(sensor.kind == SensorKind::Rotor);
    let kind = KINDS[pick(dice, kinds)];
    drawn_of(dice, seed, id, sensor, kind)
}

fn pick(dice: &mut Dice, count: usize) -> usize {
    ((dice.uniform() * count as f64) as usize).min(count - 1)
}

/// The same, of this kind.
fn drawn_of(dice: &mut Dice, seed: u64, id: u32, sensor: SensorId, kind: Kind) -> Attack {
    let bounds = Bounds::default();
    let channels: Vec<_> =
        offered(sensor.kind, &bounds).filter(|(_, _, most)| !kind.is_additive() || *most > 0.0).collect();
    let (channel, _, most) = channels[pick(dice, channels.len())];
    let magnitude = match kind {
        // Every size is as likely as the tenfold: most are small beside what the vehicle allows.
        Kind::Bias | Kind::Ramp | Kind::Parabola => sign(dice) * most * SMALLEST.powf(dice.uniform()),
        Kind::Noise => most * SMALLEST.powf(dice.uniform()),
        Kind::Scale => between(dice, (-2.0, 3.0)),
        Kind::Replay => between(dice, (0.5, bounds.replay_max_s)),
        Kind::Delay => between(dice, (0.05, bounds.delay_max_s)),
        Kind::TimeShift => sign(dice) * between(dice, (0.05, bounds.delay_max_s)),
        Kind::Dropout => between(dice, (0.2, 1.0)),
        Kind::Zero | Kind::Freeze | Kind::SignFlip => 0.0,
    };
    let (start_s, duration_s) = when(seed, id);
    let seed = (dice.uniform() * 1e9) as u64;
    Attack { id, sensor, channel, kind, start_s, duration_s, magnitude, seed }
}

#[cfg(test)]
mod tests {
    use plumbline_agent::attack::{Injector, Schedule};
    use plumbline_proto::time::FlightTime;

    use super::*;

    #[test]
    fn any_one_sensor_is_every_one_of_them_now_and_then() {
        let kinds = [(SensorKind::Imu, 2), (SensorKind::Height, 2), (SensorKind::Barometer, 2)];
        let each = |(kind, of): (SensorKind, u8)| (1..=of).map(move |instance| SensorId::new(kind, instance));
        let sensors: Vec<_> = kinds.into_iter().flat_map(each).collect();
        let attacked: Vec<_> = (0..200).flat_map(|seed| Attacked::One.attacks(&sensors, seed)).collect();
        assert!(attacked.iter().all(|attack| sensors.contains(&attack.sensor)));
        assert!(sensors.iter().all(|sensor| attacked.iter().any(|attack| attack.sensor == *sensor)), "{attacked:?}");
    }

    #[test]
    fn every_kind_is_drawn_and_every_vehicle_takes_what_is() {
        let now = FlightTime(0);
        for kind in [SensorKind::Imu, SensorKind::Height, SensorKind::Barometer, SensorKind::Rotor] {
            let sensors = [1, 2, 3, 4].map(|instance| SensorId::new(kind, instance));
            let drawn: Vec<_> = (0..400).flat_map(|seed| Attacked::Several(kind, 1).attacks(&sensors, seed)).collect();
            for attack in &drawn {
                let schedule = Schedule { attacks: [*attack].into_iter().collect(), ..Schedule::default() };
                let taken = Injector::new(Bounds::default(), true, &sensors).upload(&schedule, now);
                assert!(taken.is_ok(), "{attack:?}: {taken:?}");
            }
            for one in KINDS {
                let stamped = one != Kind::TimeShift || kind != SensorKind::Rotor;
                assert_eq!(drawn.iter().any(|attack| attack.kind == one), stamped, "{one:?} of {kind:?}");
            }
        }
    }

    #[test]
    fn a_sign_that_is_given_is_not_drawn() {
        let sensors = [SensorId::new(SensorKind::Height, 1)];
        let signs = |sign_drawn, magnitude| {
            let given = Given { sign_drawn, ..Given::bias(SensorKind::Height, Channel::All, magnitude) };
            let of = |seed| Attacked::Given(given).attacks(&sensors, seed)[0].magnitude.signum();
            (0..40).map(of).sum::<f64>().abs() as u32
        };
        assert!(signs(true, 0.5) < 40);
        assert_eq!((signs(false, 0.5), signs(true, -0.5)), (40, 40));
    }

    #[test]
    fn some_sizes_alter_nothing() {
        let alters = |kind: Kind, magnitude: f64| {
            let given = Given { kind, ..Given::bias(SensorKind::Height, Channel::All, magnitude) };
            Attacked::Given(given).alters()
        };
        for kind in [Kind::Bias, Kind::Ramp, Kind::Noise, Kind::Delay, Kind::Dropout, Kind::TimeShift] {
            assert_eq!([0.0, 0.1].map(|size| alters(kind, size)), [false, true], "{kind:?}");
        }
        assert_eq!([0.0, 1.0].map(|size| alters(Kind::Scale, size)), [true, false]);
        assert!(alters(Kind::Freeze, 0.0) && Attacked::One.alters() && !Attacked::None.alters());
    }
}
