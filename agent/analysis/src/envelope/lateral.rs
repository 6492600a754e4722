//! The loop along one horizontal axis as it flies, about hover: tilt and velocity, and position where it is observed.
//!
//! | part | taken from |
//! |---|---|
//! | slot of a lane | finite differences of the lane that flies (`lanes/lateral.rs`), covariance steady; drag, and what bounds a motion that nothing measures |
//! | attitude and rate | mean of the lanes by the integrals of all IMUs, led by the torques as `lanes/rates.rs` does |
//! | law | its linear form, with x and y controlled where something measures them |
//! | vehicle | linearised hover behind the motors' lag: position, velocity, tilt, rate, torque |
//! | judges | the vote over accelerometer and gyroscope, a tilt apart from the others', evidence of pose or GNSS |
//! | attack | two values for each slot of an IMU, its accelerometer's along the axis and its gyroscope's about the other, over the most that may be added |
//!
//! Necessary conditions of silence as in `judges.rs`; evidence of drag and of the field is left out, which leaves more to an attacker. Pose and
//! GNSS are judged by nobody: all lanes use them alike. Nor are IMUs where no majority votes.

use std::collections::VecDeque;
use std::sync::OnceLock;

use plumbline_core::control::law::Law;
use plumbline_core::estimate::lanes::lateral::{Aid, Along, MEANS, Map, STATES, Swing, UNAIDED_SLOTS};
use plumbline_core::estimate::lanes::linear::{HORIZON_S, SLOT, Shaken, of_imus, of_rates, slot_of};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::linearize::{hover, ix};
use plumbline_core::sensor::SensorModel;
use plumbline_core::sensor::suite::{Suite, Timing};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::bank::weighted;
use super::controlled::{Controlled, Motion};
use super::flying::{ALTITUDE_M, repeating, sound, swings, usual_mps2, white};
use super::judges::{ALONG, EVIDENCE, SQUARES, TURNING, Voted};
use super::program::{Bound, Memory, Program, Statistic};
use super::{Deviation, EnvelopeError, Model, Response, Signal, program_after};

/// The loop along one axis, whoever is attacked.
#[derive(Debug, Clone)]
pub struct Lateral {
    /// IMUs, then what measures the horizontal motion.
    pub sensors: Vec<SensorId>,
    /// What that is.
    pub aid: Aid,
    pub(super) axis: usize,
    imus: usize,
    controlled: Controlled,
    pub(super) maps: Vec<Map>,
    /// How long before the end of each slot of a cycle the aid measured, s.
    ages_s: Vec<Option<f64>>,
    pub(super) white: White,
    /// Acceleration of a tilt, m/s², and angular acceleration of a torque, 1/(kg m²).
    drives: (f64, f64),
    /// What the vote takes for usual, m/s² and rad/s.
    usual: (f64, f64),
    /// Most that may be added, m/s² and rad/s.
    pub most: (f64, f64),
    /// What a lane is made of: models, and what a GNSS receiver tells as its one-sigma, m.
    lane: (SensorModel, Airframe, f64),
    /// Noise that the lanes take their accelerometers for, and what they measure of it, m/s².
    pub(super) noise: (f64, f64),
    raised: OnceLock<Vec<Vec<Map>>>,
    /// What is flown, where it is no hover.
    swing: Option<Swing>,
}

/// The deviation is followed for so many slots after the attack has ended: tilt and velocity go on.
const AFTER_SLOTS: usize = 4;

/// A swing is small enough to be followed up to this tilt, rad.
const LEAN_RAD: f64 = 0.2;

/// Noise that an attacked lane takes its accelerometer for, over that of the others: in flight it changes by little at a time.
pub(super) const RAISED: [f64; 5] = [1.0, 1.25, 1.5, 1.75, 2.0];

/// White noise, one sigma: by the data sheets, of accelerometers at least as measured.
#[derive(Debug, Clone, Default)]
pub(super) struct White {
    /// Means over a slot of accelerometer and gyroscope of each IMU used, in the order of the sensors: m/s² and rad/s.
    pub(super) imus: Vec<[f64; 2]>,
    /// Position (m), velocity (m/s) and tilt (rad) as the aid measures them; 0 for what it does not.
    pub(super) aid: [f64; 3],
}

impl White {
    fn new(suite: &Suite, used: &[SensorId], aid: Aid, measured_mps2: f64) -> Self {
        let one = |sensor: &SensorId| {
            let imu = suite.imus.get(usize::from(sensor.instance).checked_sub(1)?)?;
            Some(white(imu, measured_mps2))
        };
        let imus = used.iter().filter(|sensor| sensor.kind == SensorKind::Imu).filter_map(one).collect();
        let measures = match (aid, &suite.mocap_pose, &suite.gnss) {
            (Aid::Pose, Some(pose), _) => [pose.position.total_sigma(), 0.0, pose.attitude.total_sigma()],
            (Aid::Gnss, _, Some(gnss)) => [gnss.horizontal.total_sigma(), gnss.velocity.total_sigma(), 0.0],
            _ => [0.0; 3],
        };
        Self { imus, aid: measures }
    }
}

/// What the vehicle does of what is added, and what its sensors read of that: slot after slot, without noise.
#[derive(Debug, Clone, Default)]
pub(super) struct Course {
    /// Tilt (rad), velocity (m/s) and position (m) at the beginning of each slot.
    pub(super) aside: Vec<[f64; 3]>,
    /// Means over each slot that healthy accelerometers and gyroscopes read; see [`MEANS`].
    pub(super) felt: Vec<[f64; MEANS]>,
    /// Position (m), velocity (m/s) and tilt (rad) as received from the aid in each slot that has a sample.
    pub(super) received: Vec<Option<[f64; 3]>>,
}

/// A loop under attack.
struct Attacked<'a> {
    of: &'a Lateral,
    /// Attacked IMUs.
    imus: Vec<SensorId>,
    /// What is added to the position that the aid measures, m, of seconds since the onset.
    aid: Option<&'a dyn Fn(f64) -> f64>,
}

impl Lateral {
    /// Along `axis` (0: x with pitch, 1: y with roll), of `suite` less what is `without`; an attack adds at most `most`, m/s² and rad/s. The
    /// rest as [`super::flying::Loop::new`].
    ///
    /// # Errors
    /// [`EnvelopeError`] with the offending value.
    #[allow(clippy::too_many_arguments, reason = "what a loop is made of")]
    pub fn new(
        suite: &Suite,
        without: &[SensorId],
        airframe: &Airframe,
        law: &Law,
        tick_rate_hz: f64,
        noise_mps2: f64,
        most: (f64, f64),
        axis: usize,
    ) -> Result<Self, EnvelopeError> {
        sound(tick_rate_hz, &Shaken { noise_mps2, rectified_mps2: 0.0 })?;
        let mut used = sensors(suite);
        used.retain(|sensor| !without.contains(sensor));
        let imus = used.iter().filter(|sensor| sensor.kind == SensorKind::Imu).count();
        if imus == 0 {
            return Err(EnvelopeError::Value {
                what: "IMUs that are not excluded",
                value: 0.0,
                expected: "at least 1",
            });
        }
        let aiding = aiding(suite, without);
        let aid = match aiding {
            Some((SensorKind::MocapPose, _)) => Aid::Pose,
            Some(_) => Aid::Gnss,
            None => Aid::None,
        };
        used.retain(|sensor| sensor.kind == SensorKind::Imu || aiding.is_some_and(|(kind, _)| kind == sensor.kind));
        let ages_s = aiding.map_or_else(|| Ok(vec![None; UNAIDED_SLOTS]), |(_, timing)| ages_s(&timing))?;
        let model = SensorModel::from(suite);
        let gnss_sigma_m = suite.gnss.as_ref().map_or(1.0, |gnss| gnss.horizontal.total_sigma());
        let (measured_mps2, noise_mps2) = (noise_mps2, noise_mps2.max(of_imus::NOISE_MPS2));
        let (about, other) = (hover(airframe), 1 - axis);
        let kept = [ix::X + axis, ix::VX + axis, ix::ROLL + other, ix::P + other];
        let input = ix::TORQUE_X + other;
        let controlled = Controlled::new(airframe, law, 1.0 / tick_rate_hz, &kept, input, aid != Aid::None)?;
        let white = White::new(suite, &used, aid, measured_mps2);
        let drives = (about.a[(ix::VX + axis, ix::ROLL + other)], about.b[(ix::P + other, input)]);
        let usual = (usual_mps2(measured_mps2), of_imus::USUAL_RADPS);
        let lane = (model, airframe.clone(), gnss_sigma_m);
        let raised = OnceLock::new();
        // What a minority adds counts no further than this before anybody has judged it, and later the vote limits it to less.
        let reach_mps2 = of_imus::reach_mps2(&Shaken { noise_mps2: measured_mps2, rectified_mps2: 0.0 });
        let most = (most.0.min(reach_mps2), most.1.min(of_imus::REACH_RADPS));
        let noise = (noise_mps2, measured_mps2);
        let lateral = Self {
            sensors: used,
            aid,
            axis,
            imus,
            controlled,
            maps: Vec::new(),
            ages_s,
            white,
            drives,
            usual,
            most,
            lane,
            noise,
            raised,
            swing: None,
        };
        Ok(Self { maps: lateral.cycle(1.0), ..lateral })
    }

    /// About a swing along the axis in the place of a hover: the loop varies along it. The law divides its thrust by the tilt as it is
    /// estimated, so thrust that leans pushes along the axis as much as its estimate is off; the lanes turn what they feel by their tilt.
    ///
    /// # Errors
    /// [`EnvelopeError::Value`] for one that leans too far, whose turn is not whole slots, or that nothing measures.
    pub fn swinging(mut self, amplitude_m: f64, period_s: f64) -> Result<Self, EnvelopeError> {
        if self.aid == Aid::None {
            let expected = "1: motion capture or GNSS, without which no path is flown";
            return Err(EnvelopeError::Value { what: "sensors that measure the position", value: 0.0, expected });
        }
        swings(period_s)?;
        self.swing = Some(Swing { amplitude_m, period_s });
        let lean_rad = self.tilt_rad(0.25 * period_s).abs();
        if !(0.0..=LEAN_RAD).contains(&lean_rad) || amplitude_m < 0.0 {
            let expected = "as far as leans by 0.2 rad at most";
            return Err(EnvelopeError::Value { what: "amplitude_m", value: amplitude_m, expected });
        }
        (self.maps, self.raised) = (self.cycle(1.0), OnceLock::new());
        Ok(self)
    }

    /// Tilt of what is flown so long after the onset, rad.
    fn tilt_rad(&self, time_s: f64) -> f64 {
        let (model, airframe, _) = &self.lane;
        let drag = airframe.linear_drag_nspm / airframe.mass_kg;
        self.swing.map_or(0.0, |swing| swing.tilt_rad(time_s, self.axis, drag, model.imus.gravity_mps2))
    }

    /// The maps of a lane that takes its accelerometer for `part` times as noisy.
    fn cycle(&self, part: f64) -> Vec<Map> {
        let (model, airframe, gnss_sigma_m) = &self.lane;
        let (axis, aid, swing) = (self.axis, self.aid, self.swing);
        let along = Along { axis, aid, ages_s: &self.ages_s, gnss_sigma_m: *gnss_sigma_m, swing };
        along.cycle(model, airframe, part * self.noise.0, ALTITUDE_M)
    }

    /// The maps of a lane that takes its accelerometer for [`RAISED`] times as noisy.
    pub(super) fn raised(&self) -> &[Vec<Map>] {
        self.raised.get_or_init(|| RAISED.iter().map(|part| self.cycle(*part)).collect())
    }

    /// The largest `deviation` by an attack on `attacked` until the judges have heard of all of it, and its program; `None` where nobody judges
    /// them.
    ///
    /// # Errors
    /// [`EnvelopeError`].
    pub fn bound(
        &self,
        attacked: &[SensorId],
        horizon_s: f64,
        deviation: Deviation,
    ) -> Result<Option<(Bound, Program)>, EnvelopeError> {
        let mut largest: Option<(Bound, Program)> = None;
        for after in 0..=AFTER_SLOTS {
            let Some(program) = self.program(attacked, horizon_s, deviation, after)? else { return Ok(None) };
            let bound = program.solve()?;
            if largest.as_ref().is_none_or(|(before, _)| bound.upper > before.upper) {
                largest = Some((bound, program));
            }
        }
        Ok(largest)
    }

    /// The program of the largest `deviation` so many slots `after` the horizon, at which the attack ends; `None` where nobody judges
    /// `attacked`.
    ///
    /// # Errors
    /// [`EnvelopeError`].
    pub fn program(
        &self,
        attacked: &[SensorId],
        horizon_s: f64,
        deviation: Deviation,
        after: usize,
    ) -> Result<Option<Program>, EnvelopeError> {
        let model = Attacked { of: self, imus: self.those_of(attacked), aid: None };
        if model.imus.is_empty() {
            return Err(EnvelopeError::Value { what: "sensors attacked", value: 0.0, expected: "at least 1" });
        }
        let judged = model.imus.iter().all(|sensor| sensor.kind == SensorKind::Imu) && model.is_minority();
        // A slot is closed a horizon after its end, so at most a horizon and a slot are in the loop that nobody has heard of; whole slots are.
        let heard_s = horizon_s - HORIZON_S - SLOT + 1e-6;
        judged.then(|| program_after(&model, horizon_s, deviation, after, heard_s)).transpose()
    }

    /// What an `attack` of [`Self::program`] adds, by channels of a schedule: one value for each [`SLOT`], m/s² and rad/s.
    pub fn sequences(&self, attacked: &[SensorId], attack: &Signal) -> Vec<(SensorId, &'static str, Vec<f64>)> {
        let channels = self.channels();
        let imus = self.those_of(attacked);
        let each = attack.len() / imus.len().max(1);
        let of = |(place, imu): (usize, SensorId)| {
            let own = attack.rows(place * each, each);
            let by_turns = [(0, self.most.0), (1, self.most.1)]
                .map(|(turn, most)| own.iter().skip(turn).step_by(2).map(|part| most * part).collect::<Vec<_>>());
            channels.into_iter().zip(by_turns).map(move |(channel, values)| (imu, channel, values))
        };
        imus.into_iter().enumerate().flat_map(of).collect()
    }

    /// Channels of an IMU that have a say here: its accelerometer's along the axis, its gyroscope's about the other.
    pub(super) fn channels(&self) -> [&'static str; 2] {
        channels(self.axis)
    }

    /// Those used that are IMUs.
    pub(super) fn imus(&self) -> impl Iterator<Item = SensorId> + '_ {
        self.sensors.iter().copied().filter(|sensor| sensor.kind == SensorKind::Imu)
    }

    /// What measures the motion, where anything does.
    pub(super) fn measuring(&self) -> Option<SensorId> {
        self.sensors.iter().copied().find(|sensor| sensor.kind != SensorKind::Imu)
    }

    /// Does what measures the motion measure in slot `number`?
    pub(super) fn measured(&self, number: usize) -> bool {
        self.ages_s.get(number % self.ages_s.len().max(1)).copied().flatten().is_some()
    }

    /// What comes of adding `imus` (an IMU, slot: m/s² and rad/s) and, to the position as measured, `place` (seconds since the onset: m).
    pub(super) fn course(
        &self,
        horizon_s: f64,
        imus: &dyn Fn(SensorId, usize) -> [f64; 2],
        place: &dyn Fn(f64) -> f64,
    ) -> Course {
        let model = Attacked { of: self, imus: self.imus().collect(), aid: Some(place) };
        let attack = |imu: SensorId, k: usize| {
            let [force, rate] = imus(imu, k / 2);
            Signal::from_element(1, if k.is_multiple_of(2) { force / self.most.0 } else { rate / self.most.1 })
        };
        // The last slots are closed behind the horizon of the lanes.
        let run = model.run(horizon_s + HORIZON_S + SLOT, 1, &attack);
        let own = |signals: [&Signal; 3]| signals.map(|signal| signal[0]);
        let Response { place_m, speed_mps, tilt_rad, .. } = &run.response;
        let aside = tilt_rad.iter().zip(speed_mps).zip(place_m).map(|((tilt, speed), place)| own([tilt, speed, place]));
        let felt = run.means.iter().map(|means| std::array::from_fn(|i| means.get(i).map_or(0.0, |mean| mean[0])));
        let received = run.received.iter().map(|one| one.as_ref().map(|[x, v, tilt]| own([x, v, tilt])));
        Course { aside: aside.collect(), felt: felt.collect(), received: received.collect() }
    }

    /// Those of `attacked` that have a say, each once.
    fn those_of(&self, attacked: &[SensorId]) -> Vec<SensorId> {
        let mut of: Vec<SensorId> = Vec::new();
        for sensor in attacked.iter().filter(|sensor| self.sensors.contains(sensor)) {
            if !of.contains(sensor) {
                of.push(*sensor);
            }
        }
        of
    }
}

/// Channels of an IMU along `axis`, 0: x, 1: y.
pub(super) fn channels(axis: usize) -> [&'static str; 2] {
    if axis == 0 { ["accel_x", "gyro_y"] } else { ["accel_y", "gyro_x"] }
}

/// Those of `suite` that have a say in the horizontal motion.
pub fn sensors(suite: &Suite) -> Vec<SensorId> {
    let imus = (1..=suite.imus.len()).map(|i| SensorId::new(SensorKind::Imu, i as u8));
    let others = [SensorKind::Gnss, SensorKind::MocapPose].map(|kind| SensorId::new(kind, 1));
    imus.chain(others.into_iter().filter(|sensor| suite.contains(*sensor))).collect()
}

/// What measures the motion of `suite` but for IMUs and heights, and when. Beside a pose GNSS says next to nothing.
pub(super) fn aiding(suite: &Suite, without: &[SensorId]) -> Option<(SensorKind, Timing)> {
    let has = |kind: SensorKind| !without.contains(&SensorId::new(kind, 1));
    let pose = suite.mocap_pose.as_ref().map(|pose| (SensorKind::MocapPose, pose.timing));
    let gnss = suite.gnss.as_ref().map(|gnss| (SensorKind::Gnss, gnss.timing));
    [pose, gnss].into_iter().flatten().find(|(kind, _)| has(*kind))
}

/// For each slot of a cycle how long before its end the sample that is used was taken, s. One that arrives when its slot is closed is taken in the
/// oldest that is open.
pub(super) fn ages_s(timing: &Timing) -> Result<Vec<Option<f64>>, EnvelopeError> {
    let slots = repeating(std::iter::once(timing.rate_hz))?;
    let mut ages_s = vec![None; slots];
    for k in 0..(slots as f64 * SLOT * timing.rate_hz).round() as usize {
        let time_s = timing.phase_s + k as f64 / timing.rate_hz;
        let oldest = ((time_s + timing.delay_s - HORIZON_S) / SLOT - 1e-9).ceil() as usize;
        let number = slot_of(time_s).0.max(oldest.saturating_sub(1));
        if let Some(place) = ages_s.get_mut(number % slots) {
            *place = Some(((number + 1) as f64 * SLOT - time_s).min(0.5));
        }
    }
    Ok(ages_s)
}

impl Attacked<'_> {
    fn is_minority(&self) -> bool {
        2 * self.imus.len() < self.of.imus
    }

    /// The loop over `horizon_s`, from rest; see [`Model::respond`].
    fn run<'s>(&'s self, horizon_s: f64, width: usize, attack: &'s dyn Fn(SensorId, usize) -> Signal) -> Running<'s> {
        let zeros = |count: usize| vec![Signal::zeros(width); count];
        let of = self.of;
        let judge = |_: &SensorId| Judge {
            votes: [Voted::new(ALONG, of.usual.0, width), Voted::new(TURNING, of.usual.1, width)],
        };
        let mut running = Running {
            of: self,
            attack,
            width,
            motion: Motion::new(&of.controlled, width),
            places: Vec::new(),
            felt: zeros(MEANS),
            lift: Signal::zeros(width),
            means: Vec::new(),
            received: Vec::new(),
            healthy: zeros(STATES),
            differ: self.imus.iter().map(|_| zeros(STATES)).collect(),
            judges: self.imus.iter().map(judge).collect(),
            now: zeros(3),
            biases: zeros(2),
            grown: VecDeque::new(),
            turned: VecDeque::from(zeros(1)),
            response: Response::default(),
        };
        (0..(horizon_s / of.controlled.tick_s).round() as usize).for_each(|tick| running.tick(tick));
        running
    }
}

impl Model for Attacked<'_> {
    fn attacked(&self) -> Vec<(SensorId, f64, f64)> {
        self.imus.iter().map(|imu| (*imu, 0.5 * SLOT, 1.0)).collect()
    }

    fn period_s(&self, horizon_s: f64) -> f64 {
        (self.of.maps.len() as f64 * SLOT).min(horizon_s)
    }

    fn squares(&self) -> Vec<(&'static str, Memory)> {
        let mut squares = SQUARES.to_vec();
        squares.push((TURNING.1, Memory::Last(of_imus::SLOTS as f64 * SLOT)));
        squares
    }

    fn respond(
        &self,
        horizon_s: f64,
        width: usize,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Response, EnvelopeError> {
        Ok(self.run(horizon_s, width, attack).response)
    }
}

/// What is held against one IMU.
struct Judge {
    votes: [Voted; 2],
}

/// A loop as it runs.
struct Running<'a> {
    of: &'a Attacked<'a>,
    attack: &'a dyn Fn(SensorId, usize) -> Signal,
    width: usize,
    motion: Motion<'a>,
    /// Position, velocity, tilt at each tick.
    places: Vec<[Signal; 3]>,
    /// Growth of specific force, rate and thrust in the slot that runs, without the attack: m/s, rad, m/s.
    felt: Vec<Signal>,
    /// Thrust over mass behind the motors' lag, m/s².
    lift: Signal,
    /// Their means over each slot.
    means: Vec<Vec<Signal>>,
    /// What came of the aid in each slot closed: position, velocity, tilt.
    received: Vec<Option<[Signal; 3]>>,
    healthy: Vec<Signal>,
    /// What the lanes of the attacked IMUs differ by.
    differ: Vec<Vec<Signal>>,
    judges: Vec<Judge>,
    /// Position, velocity, tilt as estimated, before the torques lead them; biases of accelerometer and gyroscope.
    now: Vec<Signal>,
    biases: Vec<Signal>,
    /// What the force along the axis and the rate grew by in each tick since the oldest slot that may be closed.
    grown: VecDeque<[Signal; 2]>,
    /// m of `rates.rs`, the oldest first.
    turned: VecDeque<Signal>,
    response: Response,
}

impl Running<'_> {
    fn lateral(&self) -> &Lateral {
        self.of.of
    }

    /// What is added to the accelerometer and the gyroscope of `imu` in slot `number`.
    fn added(&self, imu: SensorId, number: usize) -> [Signal; 2] {
        let most = self.lateral().most;
        [(self.attack)(imu, 2 * number) * most.0, (self.attack)(imu, 2 * number + 1) * most.1]
    }

    /// Mean of what is added to all IMUs.
    fn shared(&self, number: usize) -> [Signal; 2] {
        let share = 1.0 / self.lateral().imus as f64;
        let none = [Signal::zeros(self.width), Signal::zeros(self.width)];
        self.of.imus.iter().fold(none, |[force, rate], imu| {
            let [a, w] = self.added(*imu, number);
            [force + a * share, rate + w * share]
        })
    }

    fn follow(&mut self, grown: &[Signal; 2]) {
        let (tick_s, pull) = (self.lateral().controlled.tick_s, self.lateral().drives.0);
        let turned = &grown[1] - &self.biases[1] * tick_s;
        let mut gained = &grown[0] - &self.biases[0] * tick_s;
        gained.axpy(pull * tick_s, &(&self.now[2] + &turned * 0.5), 1.0);
        let [place, speed, tilt] = &mut self.now[..] else { return };
        place.axpy(tick_s, speed, 1.0);
        place.axpy(0.5 * tick_s, &gained, 1.0);
        *speed += gained;
        *tilt += turned;
    }

    fn tick(&mut self, tick: usize) {
        let Lateral { controlled, drives, .. } = self.lateral();
        let (tick_s, lag, drives) = (controlled.tick_s, controlled.lags, *drives);
        let (per_slot, late) = ((SLOT / tick_s).round() as usize, (HORIZON_S / tick_s).round() as usize);
        let [place, speed, tilt, rate, torque] = std::array::from_fn(|i| self.motion.x[i].clone());
        self.places.push([place.clone(), speed.clone(), tilt.clone()]);
        if tick.is_multiple_of(per_slot) {
            self.response.place_m.push(place);
            self.response.speed_mps.push(speed.clone());
            self.response.tilt_rad.push(tilt.clone());
        }
        let closed = tick.checked_sub(late).filter(|end| end.is_multiple_of(per_slot) && *end > 0);
        if let Some(number) = closed.map(|end| end / per_slot - 1) {
            self.close(number);
            let back = self.grown.len().saturating_sub(late);
            self.grown.drain(..back);
            let grown: Vec<_> = self.grown.iter().cloned().collect();
            grown.iter().for_each(|grown| self.follow(grown));
        }
        let added = self.shared(tick / per_slot);
        let estimate = self.led(&rate, &added[1], &torque);
        let (sin, cos) = self.lateral().tilt_rad(tick as f64 * tick_s).sin_cos();
        // Thrust over mass is g over the cosine of the tilt as estimated; positive where it lifts.
        let (gravity_mps2, way) = (drives.0.abs(), drives.0.signum());
        let asked = &estimate[2] * (gravity_mps2 * sin / (cos * cos));
        self.motion.step(&estimate, self.width);
        self.lift.axpy(lag, &(asked - &self.lift), 1.0);
        let lifted = &self.lift * tick_s;
        self.motion.x[0].axpy(0.5 * tick_s * way * sin, &lifted, 1.0);
        self.motion.x[1].axpy(way * sin, &lifted, 1.0);
        // What the IMUs feel of this tick.
        let (after, turned) = (&self.motion.x[1], &self.motion.x[2] - &tilt);
        let mut force = after - &speed - (&tilt + &turned * 0.5) * (drives.0 * tick_s);
        force.axpy(-way * sin, &lifted, 1.0);
        for (sum, grown) in self.felt.iter_mut().zip([&force, &turned, &lifted]) {
            *sum += grown;
        }
        if (tick + 1).is_multiple_of(per_slot) {
            let mean = |sum: &mut Signal| std::mem::replace(sum, Signal::zeros(sum.len())) / SLOT;
            let means = self.felt.iter_mut().map(mean).collect();
            self.means.push(means);
        }
        let mut along = force + &added[0] * (cos * tick_s);
        along.axpy(way * sin, &lifted, 1.0);
        let grown = [along, turned + &added[1] * tick_s];
        self.follow(&grown);
        self.grown.push_back(grown);
    }

    /// What the law is given: the torques bring tilt and rate to now.
    fn led(&mut self, rate: &Signal, added: &Signal, torque: &Signal) -> Vec<Signal> {
        let Lateral { controlled, drives, .. } = self.lateral();
        let (tick_s, turning) = (controlled.tick_s, drives.1);
        let ticks = (of_rates::LATE_S / tick_s).round() as usize;
        let last = self.turned.back().cloned().unwrap_or_else(|| Signal::zeros(self.width));
        let kept = 1.0 - tick_s / of_rates::FORGOTTEN_S;
        self.turned.push_back(last * kept + torque * (turning * tick_s));
        let more = self.turned.len().saturating_sub(ticks + 1);
        self.turned.drain(..more);
        let measured = rate + added - &self.biases[1];
        let then = self.turned.front().cloned().unwrap_or_else(|| Signal::zeros(self.width));
        let mut lead = &measured * of_rates::LATE_S;
        self.turned.iter().skip(1).for_each(|model| lead.axpy(tick_s, &(model - &then), 1.0));
        let now = self.turned.back().map_or_else(|| Signal::zeros(self.width), |now| now - &then);
        vec![self.now[0].clone(), self.now[1].clone(), &self.now[2] + lead, measured + now]
    }

    /// Slot `number`: the lanes take it, and the judges hear of it.
    fn close(&mut self, number: usize) {
        let (width, time_s, lateral) = (self.width, (number + 1) as f64 * SLOT, self.of.of);
        let Some(map) = lateral.maps.get(number % lateral.maps.len().max(1)) else { return };
        let taken = |states: &[Signal], means: &[Signal], measured: &[Signal]| -> Vec<Signal> {
            let inputs = || states.iter().chain(means).chain(measured);
            (0..map.nrows()).map(|row| weighted(map.row(row).iter().copied(), inputs(), width)).collect()
        };
        let none = || vec![Signal::zeros(width); MEANS];
        let age_s = lateral.ages_s.get(number % lateral.ages_s.len().max(1)).copied().flatten();
        let tick = |age_s: f64| ((time_s - age_s) / lateral.controlled.tick_s).round().max(0.0) as usize;
        let mut measured = age_s.and_then(|age_s| self.places.get(tick(age_s)).cloned());
        if let (Some([place, ..]), Some(added), Some(age_s)) = (&mut measured, self.of.aid, age_s) {
            place.add_scalar_mut(added(time_s - age_s));
        }
        self.received.push(measured.clone());
        let measured = measured.unwrap_or_else(|| std::array::from_fn(|_| Signal::zeros(width)));
        let means = self.means.get(number).cloned().unwrap_or_else(none);
        let mut states = taken(&self.healthy, &means, &measured);
        states.truncate(STATES);
        self.healthy = states;
        let imus = &self.of.imus;
        for (place, imu) in imus.iter().enumerate() {
            let added = self.added(*imu, number);
            let (Some(differ), Some(judge)) = (self.differ.get_mut(place), self.judges.get_mut(place)) else {
                continue;
            };
            let [force, rate] = &added;
            *differ = taken(differ, &[force.clone(), rate.clone(), Signal::zeros(width)], &[]);
            let rows = differ.split_off(STATES);
            let mut add = |detector, limit, row| {
                self.response.statistics.push(Statistic { detector, sensor: Some(*imu), time_s, limit, row });
            };
            if !self.of.is_minority() {
                continue;
            }
            let biases = differ.iter().skip(STATES - 2);
            for ((vote, added), bias) in judge.votes.iter_mut().zip(&added).zip(biases) {
                vote.hear(added, bias, &mut add);
            }
            add("IMU tilt", of_imus::APART_RAD, differ[2].clone());
            if age_s.is_some() {
                rows.into_iter().for_each(|row| add(EVIDENCE, of_imus::EVIDENCE.sqrt(), row));
            }
        }
        let share = 1.0 / lateral.imus as f64;
        let fused = |state: usize| {
            let differ = self.differ.iter().filter_map(|lane| lane.get(state));
            differ.fold(self.healthy[state].clone(), |sum, other| sum + other * share)
        };
        self.now = (0..3).map(fused).collect();
        self.biases = (STATES - 2..STATES).map(fused).collect();
    }
}
