//! One flight of [Clinic]'s closed loop: who estimates, who is attacked, and how it went.

use plumbline_agent::attack::{Attack, Channel, Kind};
use plumbline_agent::sensor::SensorModel;
use plumbline_agent::sensor::height::Height;
use plumbline_agent::sensor::imu::{Imu, ImuModel};
use plumbline_agent::sensor::suite::{Sheet as _, Suite};
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::{EstimatorKind, Mode};
use plumbline_experiment::flight::{Setup, fly_to_the_end};
use plumbline_experiment::reception::Reception;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

pub const ATTACK_S: (f64, f64) = (9.0, 27.0);
const JUDGED_FROM_S: f64 = 8.0;
/// Altitudes of a flight: from when, s, and how high, m.
pub type Profile<'a> = &'a [(f64, f64)];
pub const STEPS: Profile = &[(5.0, 0.5), (12.0, 1.0), (20.0, 0.6)];
/// Strings go taut at 0.3 m: steps down to there and up again.
pub const TAUT: Profile = &[(5.0, 0.6), (11.0, 0.3), (14.0, 0.7), (20.0, 0.3), (23.0, 0.6)];
/// The feet stand at 0.11 m: steps down onto the ground and up again.
pub const GROUND: Profile = &[(5.0, 0.6), (11.0, 0.1), (14.0, 0.7), (20.0, 0.1), (23.0, 0.6)];
/// Raised by so much, the same steps meet neither strings nor ground.
pub const CLEAR_M: f64 = 0.5;
pub const STRINGS: (&str, &str) = ("strings", "[rig.hanging_strings]\nmode = \"flight\"\nheight_m = 0.3\n");
pub const FREE: (&str, &str) = ("free", "[rig.free]\nheight_m = 0.0\n");
pub const RIGS: [(&str, &str); 2] = [STRINGS, FREE];

/// How many there are.
pub const PILOTS: usize = 6;

/// Factors on the noise that the filter assumes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    pub height: f64,
    pub accel: f64,
}

/// Who estimates: see [`super::flights`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pilot {
    Plain,
    Augmented(Tuning),
    Gated,
    Decoder,
    Lanes,
    Oracle,
}

impl Pilot {
    pub fn every(tuning: Tuning) -> [Pilot; PILOTS] {
        [Pilot::Plain, Pilot::Augmented(tuning), Pilot::Gated, Pilot::Decoder, Pilot::Lanes, Pilot::Oracle]
    }

    fn assume(self, model: &mut SensorModel) {
        const OPEN: f64 = 1e9;
        if matches!(self, Pilot::Plain | Pilot::Augmented(_)) {
            let ImuModel { gyro, accel, mag, .. } = &mut model.imus;
            let others = [&mut model.heights.gate, &mut model.barometers.altitude.gate];
            for gate in
                [&mut gyro.gate, &mut accel.gate, &mut mag.gate, &mut mag.field_tolerance].into_iter().chain(others)
            {
                *gate = OPEN;
            }
        }
        if let Pilot::Augmented(Tuning { height, accel }) = self {
            model.heights.sigma *= height;
            model.imus.accel.noise_density *= accel;
            model.imus.accel.common_noise_density *= accel;
        }
    }
}

/// One flight to fly.
#[derive(Clone)]
pub struct Plan {
    pub rig: &'static str,
    pub profile: Vec<(f64, f64)>,
    pub duration_s: f64,
    pub attacked: Vec<SensorId>,
    pub attack: &'static str,
    pub heights: usize,
    pub imus: usize,
    pub seed: u64,
    /// The bench, unless it is named.
    pub world: String,
    pub pilot: Pilot,
    pub keep_track: bool,
}

impl Plan {
    pub fn new(rig: &'static str, profile: Profile, seed: u64, pilot: Pilot) -> Self {
        Self {
            rig,
            profile: profile.to_vec(),
            duration_s: 30.0,
            attacked: Vec::new(),
            attack: "none",
            heights: 3,
            imus: 4,
            seed,
            world: "datasheet".into(),
            pilot,
            keep_track: false,
        }
    }

    pub fn under_attack(self, place: &str, attack: &'static str) -> Self {
        let height = |i| SensorId::new(SensorKind::Height, i);
        let imu = |i| SensorId::new(SensorKind::Imu, i);
        let (attacked, count) = match place {
            "height" => (vec![height(2)], (3, 4)),
            "imu_and_height" => (vec![height(2), imu(2)], (3, 4)),
            "minority_of_5" => (vec![height(1), height(2), imu(1), imu(2)], (5, 5)),
            "none_of_5" => (Vec::new(), (5, 5)),
            "height_of_2" => (vec![height(2)], (2, 4)),
            "none_of_2" => (Vec::new(), (2, 4)),
            _ => (Vec::new(), (3, 4)),
        };
        Self { attacked, attack, heights: count.0, imus: count.1, ..self }
    }

    pub fn raised(mut self, by_m: f64) -> Self {
        self.profile.iter_mut().for_each(|(_, altitude)| *altitude += by_m);
        self
    }

    fn scenario(&self) -> Scenario {
        let mut text = format!(
            "name = \"clinic\"\nduration_s = {}\nworld = \"{}\"\n[[script]]\nat_s = 3\ndo = \"arm\"\n\
             [[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n",
            self.duration_s, self.world
        );
        for (at_s, altitude) in &self.profile {
            text += &format!("[[script]]\nat_s = {at_s}\ndo = \"setpoint\"\naltitude_m = {altitude}\n");
        }
        text += self.rig;
        let mut scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        scenario.seed = self.seed;
        scenario.suite = Suite::string_rig();
        scenario.suite.heights = (1..=self.heights).map(|i| Height::laser(i, self.heights)).collect();
        scenario.suite.imus = (1..=self.imus).map(Imu::typical).collect();
        scenario
    }

    /// Each with its own dice.
    fn attacks(&self) -> Vec<Attack> {
        let attack = |(i, sensor): (usize, &SensorId)| {
            let imu = sensor.kind == SensorKind::Imu;
            let (kind, magnitude) = match (self.attack, imu) {
                ("zero", _) => (Kind::Zero, 0.0),
                ("bias", true) => (Kind::Bias, 2.0),
                ("bias", false) => (Kind::Bias, 0.5),
                ("ramp", true) => (Kind::Ramp, 0.5),
                ("ramp", false) => (Kind::Ramp, 0.1),
                ("random", true) => (Kind::Noise, 2.0),
                ("random", false) => (Kind::Noise, 0.5),
                _ => (Kind::Replay, 3.0),
            };
            let one_quantity = imu && kind.is_additive();
            Attack {
                id: i as u32 + 1,
                sensor: *sensor,
                channel: if one_quantity { Channel::Accel } else { Channel::All },
                kind,
                start_s: ATTACK_S.0,
                duration_s: ATTACK_S.1 - ATTACK_S.0,
                magnitude,
                seed: 100 * self.seed + i as u64,
            }
        };
        self.attacked.iter().enumerate().map(attack).collect()
    }

    /// The script's altitude.
    fn altitude_at(&self, t: f64) -> f64 {
        self.profile.iter().rev().find(|(from, _)| t >= *from).map_or(0.0, |(_, altitude)| *altitude)
    }
}

#[derive(Clone, Default)]
pub struct Outcome {
    /// rms of true altitude − setpoint.
    pub error_m: f64,
    /// rms of estimated − true altitude.
    pub estimate_m: f64,
    /// From the onset to the first flag of every attacked sensor, s.
    pub delays_s: Vec<f64>,
    pub missed: usize,
    /// Flags raised on healthy sensors, which they were, and the longest, s.
    pub false_flags: usize,
    pub false_exclusions: Vec<SensorId>,
    pub longest_false_s: f64,
    /// Altitude hold was lost.
    pub lost: bool,
    /// (t, true z, setpoint).
    pub track: Vec<(f64, f64, f64)>,
}

pub fn fly(plan: &Plan) -> Outcome {
    let scenario = plan.scenario();
    let mut config = scenario.flight_config();
    let kind = match plan.pilot {
        Pilot::Plain | Pilot::Augmented(_) | Pilot::Gated => EstimatorKind::EkfBias,
        Pilot::Decoder => EstimatorKind::Secure,
        Pilot::Lanes | Pilot::Oracle => EstimatorKind::Lanes,
    };
    config.estimators = vec![kind];
    config.in_loop = kind;
    plan.pilot.assume(&mut config.sensor_model);
    let setup = Setup {
        reception: if plan.pilot == Pilot::Oracle { Reception::Oracle } else { Reception::All },
        attacks: plan.attacks(),
        ..Setup::simulated(scenario, config, JUDGED_FROM_S)
    };
    let mut outcome = Outcome::default();
    let (mut square, mut estimate_square, mut count) = (0.0, 0.0, 0.0);
    let mut flags = Flags::default();
    fly_to_the_end(&setup, |flight, truth| {
        let t = flight.report().sensed.time.as_seconds();
        let z = truth.position_enu_m.z;
        let holds = flight.report().armed && flight.report().mode == Mode::AltitudeHold;
        let setpoint = if holds { flight.report().setpoint.position_enu_m.z } else { plan.altitude_at(t) };
        if t >= JUDGED_FROM_S {
            outcome.lost |= !holds;
            square += (z - setpoint).powi(2);
            let estimated = flight.estimates().next().map_or(f64::NAN, |(_, e)| e.kinematics().position_enu_m.z);
            estimate_square += (estimated - z).powi(2);
            count += 1.0;
        }
        if plan.keep_track {
            outcome.track.push((t, z, setpoint));
        }
        if let Some(judge) = flight.judge() {
            let devices = judge.isolation().devices().iter();
            let flagged = devices.map(|device| (device.sensor, device.flagged.is_some()));
            flags.look(t, flagged, &plan.attacked, &mut outcome);
        }
    })
    .unwrap();
    outcome.missed = plan.attacked.len() - flags.found.len();
    outcome.error_m = (square / count).sqrt();
    outcome.estimate_m = (estimate_square / count).sqrt();
    outcome
}

/// Flags raised so far.
#[derive(Default)]
struct Flags {
    /// Those that stand, and since when, s.
    raised: Vec<(SensorId, f64)>,
    /// Attacked sensors that were flagged since the onset.
    found: Vec<SensorId>,
}

impl Flags {
    /// Takes note, at `t`, of each sensor and whether it is flagged.
    fn look(
        &mut self,
        t: f64,
        flagged: impl Iterator<Item = (SensorId, bool)>,
        attacked: &[SensorId],
        outcome: &mut Outcome,
    ) {
        for (sensor, flagged) in flagged {
            let known = self.raised.iter().position(|(id, _)| *id == sensor);
            match (flagged, known) {
                (true, None) => {
                    self.raised.push((sensor, t));
                    let attacked = attacked.contains(&sensor) && t >= ATTACK_S.0;
                    if attacked && !self.found.contains(&sensor) {
                        self.found.push(sensor);
                        outcome.delays_s.push(t - ATTACK_S.0);
                    }
                    if !attacked {
                        outcome.false_flags += 1;
                        outcome.false_exclusions.push(sensor);
                    }
                }
                (false, Some(at)) => {
                    self.raised.remove(at);
                }
                _ => {}
            }
            if let Some((_, since)) = self.raised.iter().find(|(id, _)| *id == sensor && !attacked.contains(id)) {
                outcome.longest_false_s = outcome.longest_false_s.max(t - since);
            }
        }
    }
}
