//! Bounds along a horizontal axis under motion capture, and what is flown against them.

use plumbline_agent::envelope::program::Program;
use plumbline_agent::envelope::sets::Asked;
use plumbline_agent::envelope::{Deviation, EVIDENCE, Signal};
use plumbline_agent::estimate::lanes::linear::SLOT;
use plumbline_proto::ids::SensorId;
use plumbline_rest::envelope::{EnvelopeQuestion, Swing};
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Worn, channel_of, drawn_value};

/// How long an attack along x or y lasts, s.
pub const ASIDE_S: f64 = 5.0;
/// A circle, m and s, and the swing along x and y that the vehicle makes of it.
pub const CIRCLE: (f64, f64) = (0.8, 6.0);
/// See [`CIRCLE`].
pub const SWUNG: (f64, f64) = (0.89, 6.0);
/// Parts of the limits that an attack keeps to: of the root of the evidence at which a lane weighs steeply less, of the others.
const HELD: [(f64, f64); 2] = [(1.0, 0.95), (0.8, 1.0)];
/// What is bounded: rad, m/s, m.
const DEVIATIONS: [Deviation; 3] = [Deviation::Tilt, Deviation::Speed, Deviation::Place];

/// A set of IMUs, how far it can push tilt (rad), velocity (m/s) and position (m) unseen, and what pushes each furthest.
#[derive(Debug, Clone)]
pub struct AsideSet {
    /// Those attacked.
    pub sensors: Vec<SensorId>,
    /// The bounds.
    pub bounds: [f64; 3],
    worst: [Signal; 3],
    programs: [Program; 3],
}

impl AsideSet {
    /// "imu 1, imu 2"
    pub fn name(&self) -> String {
        self.sensors.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}

/// The loop of the default suite with motion capture along an axis, and each set of its IMUs that is judged.
pub struct Aside {
    asked: Asked,
    /// In order.
    pub sets: Vec<AsideSet>,
}

impl Aside {
    /// Along `axis` (0: x, 1: y), about a hover or a swing of this amplitude and period, m and s, where the lanes measure `noise_mps2`.
    pub fn new(axis: usize, swing: Option<(f64, f64)>, noise_mps2: f64) -> Self {
        let question = EnvelopeQuestion {
            axis: Some(["x", "y"][axis].to_owned()),
            more: Some("pose".to_owned()),
            swing: swing.map(|(amplitude_m, period_s)| Swing { amplitude_m, period_s }),
            noise_mps2: Some(noise_mps2),
            ..EnvelopeQuestion::default()
        };
        let asked = Asked::new(&question, None).unwrap();
        let lateral = asked.lateral.as_ref().unwrap();
        let bounded = |sensors: &Vec<SensorId>| {
            let [tilt, speed, place] = DEVIATIONS.map(|deviation| lateral.bound(sensors, ASIDE_S, deviation).unwrap());
            let found = [tilt?, speed?, place?];
            Some(AsideSet {
                sensors: sensors.clone(),
                bounds: found.each_ref().map(|(bound, _)| bound.upper),
                worst: found.each_ref().map(|(bound, _)| bound.attack.clone()),
                programs: found.map(|(_, program)| program),
            })
        };
        let sets = asked.sets.iter().filter_map(bounded).collect();
        Self { asked, sets }
    }

    fn worn(&self, set: &AsideSet, attack: &Signal, part: f64) -> Worn {
        let mut worn = Worn::default();
        let sequences = self.asked.lateral.as_ref().unwrap().sequences(&set.sensors, &(attack * part));
        for (sensor, channel, values) in sequences {
            worn.add(sensor, channel_of(channel), ASIDE_S, SLOT, values.into_iter());
        }
        worn
    }

    /// What pushes `set` furthest, times `part`: with 0 the tilt, 1 the velocity, 2 the position.
    pub fn worst(&self, set: &AsideSet, which: usize, part: f64) -> Worn {
        self.worn(set, &set.worst[which], part)
    }

    /// What pushes `set` furthest within each of [`HELD`]. A lane weighs less long before it is excluded for what is held against it, so an
    /// attack that keeps below a limit may push further.
    pub fn all_worst<'a>(&'a self, set: &'a AsideSet, which: usize) -> impl Iterator<Item = ((f64, f64), Worn)> + 'a {
        HELD.into_iter().map(move |(evidence, rest)| {
            let mut program = set.programs[which].clone();
            for one in &mut program.statistics {
                one.limit *= if one.detector == EVIDENCE { evidence } else { rest };
            }
            ((evidence, rest), self.worn(set, &program.solve().unwrap().attack, 1.0))
        })
    }

    /// An attack drawn by `seed`, and what it is: a step, a ramp, a sine or noise on each accelerometer and each gyroscope, or one of the worst
    /// sequences smaller or larger.
    pub fn drawn(&self, set: &AsideSet, seed: u64) -> (&'static str, Worn) {
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
        let shape = dice.random_range(0..5);
        if shape == 4 {
            let which = dice.random_range(0..3);
            return ("worst", self.worst(set, which, dice.random_range(0.5..1.3)));
        }
        let most = self.asked.lateral.as_ref().unwrap().most;
        let mut values = Signal::zeros(set.worst[0].len());
        // By turns an accelerometer's and a gyroscope's, slot after slot, over the most that may be added.
        let count = values.len() / (2 * set.sensors.len());
        for channel in 0..2 * set.sensors.len() {
            // From what nobody could see to the most that may be added.
            let (least, largest, most) =
                if channel % 2 == 0 { (0.05_f64, 20.0_f64, most.0) } else { (0.002, 5.0, most.1) };
            let sign = if dice.random_bool(0.5) { 1.0 } else { -1.0 };
            let size = sign * dice.random_range(least.ln()..largest.ln()).exp() / most;
            let period_s = dice.random_range(0.5..ASIDE_S);
            let first = (channel / 2) * 2 * count + channel % 2;
            for k in 0..count {
                values[first + 2 * k] = size * drawn_value(shape, k as f64 * SLOT, ASIDE_S, period_s, &mut dice);
            }
        }
        (["step", "ramp", "sine", "noise"][shape], self.worn(set, &values, 1.0))
    }
}
