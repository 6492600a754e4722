//! The loop as it flies, about hover: the lanes of the secure estimator, their judges, the gains in use, lag and delay.
//!
//! | part | taken from |
//! |---|---|
//! | slot of a lane | finite differences of the lane that flies (`lanes/linear.rs`), covariance steady |
//! | fused altitude | mean of the lanes, brought from the horizon to now by the integrals of all IMUs |
//! | law | its linear form, that margins are judged by |
//! | vehicle | linearised hover, motors' lag as margins have it; no delay, as the simulator has none |
//! | judges | `judges.rs`, their limits the constants in use; what a height reaches, from the healthy one nearer to it (`sets.rs`) |
//! | attack | a value for each sample of a height; for an IMU one for each slot, whose mean is all that a lane is given |
//!
//! Where a judge makes a sensor weigh less before it excludes it, the loop is linear up to there only: it is solved as
//! [`Regime::Full`], everything weighing fully and that limit not passed, and where heights attacked are no minority also as
//! [`Regime::Outvoted`], the healthy ones weighing as little as they do just before their exclusion. The larger bound is told.
//! Beyond the limit of the first an attacked sensor's pull falls with its deviation (ρ² against ρ), so it is held to be one; that
//! is argued, not proved: of 2000 drawn flights without noise none went further by more than 1 %.

use std::collections::VecDeque;

use plumbline_core::control::law::Law;
use plumbline_core::estimate::lanes::linear::{
    GNSS, HORIZON_S, POSE, ROWS, SLOT, Shaken, cycle, of_heights, of_imus, slot_of, together,
};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::linearize::ix;
use plumbline_core::sensor::imu::Imu;
use plumbline_core::sensor::suite::{Suite, Timing};
use plumbline_core::sensor::{MAX_HEIGHTS, SensorModel};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::bank::Bank;
use super::controlled::{Controlled, Motion};
use super::judges::{Judges, SQUARES};
use super::program::Memory;
use super::{EnvelopeError, Model, Response, Signal, lateral};

/// Altitude of the hover, m.
pub(super) const ALTITUDE_M: f64 = 1.0;
/// Furthest up and down of a heave, m: it stays between floor and ceiling, and no limit is reached.
const HEAVE_M: f64 = 0.7;
/// Shortest and longest swing, s: no limit is reached.
const SWINGS_S: (f64, f64) = (2.0, 20.0);
/// Where in a slot attacked heights sample when they do the most, s from its beginning …
const LATE_S: f64 = 0.015;
/// … how long before them the first of the healthy ones, and each of the others before that one, s: heights of a slot are taken in order, so
/// it is another where one that is attacked is the last of all.
const BEFORE_S: (f64, f64) = (0.015, 0.02);
const BEFORE_THE_LAST_S: (f64, f64) = (0.025, 0.03);
/// Slots after which the samples of all heights must repeat.
const LONGEST_CYCLE: usize = 25;

/// The loop, whoever is attacked.
#[derive(Debug, Clone)]
pub struct Loop {
    /// Heights and IMUs, in the order of the suite.
    pub sensors: Vec<SensorId>,
    pub(super) model: SensorModel,
    /// White noise of a sample of each row that measures, m and m/s, and of each accelerometer over a slot, m/s²; one sigma.
    pub(super) white: ([f64; ROWS], Vec<f64>),
    /// Rate, Hz, and time of the first sample, s, of each height; `None` for one that is excluded.
    pub(super) timing: Vec<Option<(f64, f64)>>,
    /// What else measures along z, its row, and for each slot of a cycle how long before its end, s. Nobody judges it: it is healthy.
    aid: Option<(SensorId, usize, Vec<Option<f64>>)>,
    pub(super) imus: usize,
    controlled: Controlled,
    /// What the lanes measure of their accelerometers.
    pub(super) shaken: Shaken,
    pub(super) most: (f64, f64),
    /// Up and down about the hover, m and s; the attack begins where a swing does.
    heave: Option<(f64, f64)>,
}

/// Slots after which samples at these rates repeat.
pub(super) fn repeating(rates_hz: impl Iterator<Item = f64> + Clone) -> Result<usize, EnvelopeError> {
    let repeats = |slots: &usize| {
        rates_hz.clone().all(|rate_hz| {
            let samples = *slots as f64 * SLOT * rate_hz;
            (samples - samples.round()).abs() < 1e-6 && samples.round() >= 1.0
        })
    };
    let value = rates_hz.clone().next().unwrap_or(f64::NAN);
    let expected = "such that all samples repeat within 1 s";
    let found = (1..=LONGEST_CYCLE).find(repeats);
    found.ok_or(EnvelopeError::Value { what: "rate_hz of the sensors", value, expected })
}

/// May a swing take so long, s?
pub(super) fn swings(period_s: f64) -> Result<(), EnvelopeError> {
    let slots = period_s / SLOT;
    if (SWINGS_S.0..=SWINGS_S.1).contains(&period_s) && (slots - slots.round()).abs() <= 1e-6 {
        return Ok(());
    }
    Err(EnvelopeError::Value { what: "period_s", value: period_s, expected: "2 to 20, in whole slots of 40 ms" })
}

/// Scatter of an accelerometer's means over slots of which its lane measures so much over 0.8 s, one sigma, m/s²: of white noise. Vibration
/// averages out faster, and scatters by more.
fn of_slots_mps2(measured_mps2: f64) -> f64 {
    measured_mps2 * f64::from(of_imus::NOISE_SLOTS).sqrt()
}

/// White noise of the means over a slot that accelerometer and gyroscope of `imu` read, one sigma, m/s² and rad/s: as the data sheet has
/// it, of the accelerometer as its lane measures it where that is more.
pub(super) fn white(imu: &Imu, measured_mps2: f64) -> [f64; 2] {
    let mean = (SLOT * imu.timing.rate_hz).max(1.0).sqrt();
    let [accel, gyro] = [&imu.accel, &imu.gyro].map(|quality| quality.total_sigma() / mean);
    [accel.max(of_slots_mps2(measured_mps2)), gyro]
}

/// What the vote, which compares slots, takes for the usual deviation of an accelerometer, m/s².
pub(super) fn usual_mps2(measured_mps2: f64) -> f64 {
    of_imus::USUAL_MPS2.max(of_slots_mps2(measured_mps2))
}

/// May a loop have these?
pub(super) fn sound(tick_rate_hz: f64, shaken: &Shaken) -> Result<(), EnvelopeError> {
    let per_slot = SLOT * tick_rate_hz;
    if (per_slot - per_slot.round()).abs() > 1e-9 || per_slot < 1.0 {
        let expected = "such that 40 ms are whole ticks";
        return Err(EnvelopeError::Value { what: "tick_rate_hz", value: tick_rate_hz, expected });
    }
    let all = [("noise_mps2", shaken.noise_mps2), ("rectified_mps2", shaken.rectified_mps2)];
    match all.into_iter().find(|(_, value)| !(0.0..=5.0).contains(value)) {
        Some((what, value)) => Err(EnvelopeError::Value { what, value, expected: "0 to 5" }),
        None => Ok(()),
    }
}

/// Which heights weigh how much.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Regime {
    /// All fully; attacked ones stay where they weigh fully.
    Full,
    /// Healthy ones as just before their exclusion.
    Outvoted,
}

/// A loop under attack.
#[derive(Debug, Clone)]
pub struct Attacked<'a> {
    /// The loop.
    pub flying: &'a Loop,
    /// Places of the attacked heights and IMUs among their kind.
    pub heights: Vec<usize>,
    /// See `heights`.
    pub imus: Vec<usize>,
    /// See [`Regime`].
    pub regime: Regime,
    /// The median of all heights is no further from the mean of the healthy ones, m: an attacked one is used as far as its reach from
    /// that median.
    pub near_m: f64,
}

impl Loop {
    /// Of `suite` on `airframe` with `law` at `tick_rate_hz`; an attack adds at most `most`, m and m/s².
    ///
    /// # Errors
    /// [`EnvelopeError`] with the offending value.
    pub fn new(
        suite: &Suite,
        airframe: &Airframe,
        law: &Law,
        tick_rate_hz: f64,
        shaken: Shaken,
        most: (f64, f64),
    ) -> Result<Self, EnvelopeError> {
        sound(tick_rate_hz, &shaken)?;
        let controlled = Controlled::new(airframe, law, 1.0 / tick_rate_hz, &[ix::Z, ix::VZ], ix::THRUST, false)?;
        let timing: Vec<_> = suite.heights.iter().map(|h| Some((h.timing.rate_hz, h.timing.phase_s))).collect();
        let of = |kind: SensorKind, count: usize| (1..=count).map(move |i| SensorId::new(kind, i as u8));
        let sensors = of(SensorKind::Height, timing.len()).chain(of(SensorKind::Imu, suite.imus.len())).collect();
        if suite.imus.is_empty() || timing.is_empty() {
            let value = suite.imus.len().min(timing.len()) as f64;
            return Err(EnvelopeError::Value { what: "heights or IMUs of the suite", value, expected: "at least 1" });
        }
        let mut noise = [0.0; ROWS];
        noise.iter_mut().zip(&suite.heights).for_each(|(sigma_m, height)| *sigma_m = height.height.total_sigma());
        let aided = |(kind, timing): (SensorKind, Timing)| {
            let row = if kind == SensorKind::MocapPose { POSE } else { GNSS };
            Ok::<_, EnvelopeError>((SensorId::new(kind, 1), row, lateral::ages_s(&timing)?))
        };
        let aid = lateral::aiding(suite, &[]).map(aided).transpose()?;
        noise[POSE] = suite.mocap_pose.as_ref().map_or(0.0, |pose| pose.position.total_sigma());
        noise[GNSS] = suite.gnss.as_ref().map_or(0.0, |gnss| gnss.velocity.total_sigma());
        Ok(Self {
            sensors,
            model: SensorModel::from(suite),
            white: (noise, suite.imus.iter().map(|imu| white(imu, shaken.noise_mps2)[0]).collect()),
            timing,
            aid,
            imus: suite.imus.len(),
            controlled,
            shaken,
            most,
            heave: None,
        })
    }

    /// About a heave of `amplitude_m` and `period_s` in the place of a hover: the loop varies along it. About one the thrust that is commanded
    /// enters v̇ as about the other; what the heights' judges learn as scale depends on the altitude.
    ///
    /// # Errors
    /// [`EnvelopeError::Value`] for one beyond small accelerations, or whose swing is not whole slots.
    pub fn heaving(self, amplitude_m: f64, period_s: f64) -> Result<Self, EnvelopeError> {
        if !(0.0..=HEAVE_M).contains(&amplitude_m) {
            return Err(EnvelopeError::Value { what: "amplitude_m", value: amplitude_m, expected: "0 to 0.7" });
        }
        swings(period_s)?;
        Ok(Self { heave: Some((amplitude_m, period_s)), ..self })
    }

    /// The same with accelerometers that rectify nothing.
    pub(super) fn at_rest(&self) -> Self {
        Self { shaken: Shaken { rectified_mps2: 0.0, ..self.shaken }, ..self.clone() }
    }

    /// So long after the onset, m.
    pub(super) fn altitude_m(&self, time_s: f64) -> f64 {
        let swing = |(m, period_s): (f64, f64)| m * (std::f64::consts::TAU * time_s / period_s).sin();
        ALTITUDE_M + self.heave.map_or(0.0, swing)
    }

    /// With `excluded` sensors left out: neither used nor attacked.
    ///
    /// # Errors
    /// [`EnvelopeError::UnknownSensor`], [`EnvelopeError::Value`] where no height or no IMU is left.
    pub fn without(mut self, excluded: &[SensorId]) -> Result<Self, EnvelopeError> {
        Self::known(excluded, &self.used().collect::<Vec<_>>())?;
        self.aid = self.aid.filter(|(sensor, ..)| !excluded.contains(sensor));
        self.sensors.retain(|sensor| !excluded.contains(sensor));
        for (i, timing) in self.timing.iter_mut().enumerate() {
            *timing = timing.filter(|_| !excluded.contains(&SensorId::new(SensorKind::Height, i as u8 + 1)));
        }
        self.imus = self.count(SensorKind::Imu);
        let least = self.imus.min(self.count(SensorKind::Height));
        if least == 0 {
            let what = "heights or IMUs that are not excluded";
            return Err(EnvelopeError::Value { what, value: 0.0, expected: "at least 1" });
        }
        Ok(self)
    }

    /// The same with heights that sample at those moments at which `set` does the most, of those searched: attacked ones late in a slot,
    /// the healthy ones before them, so that it is long until the next of these. Attacked ones that are a majority sample evenly. Nobody
    /// keeps the samples of lasers where the slots are, so a bound is that of these moments.
    pub fn at_worst_moments(&self, set: &[SensorId]) -> Self {
        let heights = self.sensors.iter().filter(|sensor| sensor.kind == SensorKind::Height);
        let (own, others): (Vec<SensorId>, Vec<SensorId>) = heights.partition(|sensor| set.contains(sensor));
        let spread = if own.len() > others.len() { 1.0 / own.len() as f64 } else { 0.0 };
        let is_last = own.last().map(|sensor| sensor.instance) > others.last().map(|sensor| sensor.instance);
        let (first_s, apart_s) = if is_last { BEFORE_THE_LAST_S } else { BEFORE_S };
        let own = (0..).map(f64::from).zip(own).map(|(n, sensor)| (sensor, n * spread, 0.0));
        let others = others.into_iter().rev();
        let others = (0..).map(f64::from).zip(others).map(|(n, sensor)| (sensor, 0.0, first_s + n * apart_s));
        let mut timing = self.timing.clone();
        for (sensor, periods, before_s) in own.chain(others) {
            if let Some(Some((rate_hz, phase_s))) = timing.get_mut(usize::from(sensor.instance) - 1) {
                let period_s = 1.0 / *rate_hz;
                *phase_s = (LATE_S - before_s - periods * period_s).rem_euclid(period_s);
            }
        }
        Self { timing, ..self.clone() }
    }

    /// When each height samples first, s; none of one that is excluded.
    pub fn phases_s(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        self.timing.iter().map(|timing| timing.map(|(_, phase_s)| phase_s))
    }

    /// How many of `kind` are used.
    pub fn count(&self, kind: SensorKind) -> usize {
        self.sensors.iter().filter(|sensor| sensor.kind == kind).count()
    }

    /// What measures beside heights and IMUs.
    pub(super) fn aiding(&self) -> Option<SensorId> {
        self.aid.as_ref().map(|(sensor, ..)| *sensor)
    }

    /// All that it uses.
    pub(super) fn used(&self) -> impl Iterator<Item = SensorId> + '_ {
        self.sensors.iter().copied().chain(self.aiding())
    }

    fn known(sensors: &[SensorId], of: &[SensorId]) -> Result<(), EnvelopeError> {
        let Some(unknown) = sensors.iter().find(|sensor| !of.contains(sensor)) else { return Ok(()) };
        let known = of.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        Err(EnvelopeError::UnknownSensor { sensor: unknown.to_string(), known })
    }

    /// Under an attack on `sensors`.
    ///
    /// # Errors
    /// [`EnvelopeError::UnknownSensor`], [`EnvelopeError::SetTooLarge`].
    pub fn attacked(&self, sensors: &[SensorId], regime: Regime) -> Result<Attacked<'_>, EnvelopeError> {
        if sensors.len() > self.sensors.len() {
            return Err(EnvelopeError::SetTooLarge { size: sensors.len(), sensors: self.sensors.len() });
        }
        Self::known(sensors, &self.sensors)?;
        let of = |kind: SensorKind| {
            let mine = sensors.iter().filter(move |sensor| sensor.kind == kind);
            let mut places: Vec<usize> = mine.map(|sensor| usize::from(sensor.instance) - 1).collect();
            places.sort_unstable();
            places.dedup();
            places
        };
        Ok(Attacked { flying: self, heights: of(SensorKind::Height), imus: of(SensorKind::Imu), regime, near_m: 0.0 })
    }

    /// When each row is sampled in a cycle of slots: how long before the slot's end, s.
    pub(super) fn schedule(&self) -> Result<Vec<[Option<f64>; ROWS]>, EnvelopeError> {
        let own = repeating(self.timing.iter().flatten().map(|(rate_hz, _)| *rate_hz))?;
        let aided = self.aid.as_ref().map_or(1, |(_, _, ages_s)| ages_s.len());
        let slots = together(&[own, aided]);
        let mut ages = vec![[None; ROWS]; slots];
        if let Some((_, row, ages_s)) = &self.aid {
            for (slot, age_s) in ages.iter_mut().zip(ages_s.iter().cycle()) {
                if let Some(place) = slot.get_mut(*row) {
                    *place = *age_s;
                }
            }
        }
        for (i, timing) in self.timing.iter().enumerate() {
            let Some((rate_hz, phase_s)) = timing else { continue };
            for k in 0..(slots as f64 * SLOT * rate_hz).round() as usize {
                let (slot, age_s) = slot_of(phase_s + k as f64 / rate_hz);
                if let Some(place) = ages.get_mut(slot % slots).and_then(|slot| slot.get_mut(i)) {
                    *place = Some(age_s);
                }
            }
        }
        Ok(ages)
    }
}

impl Attacked<'_> {
    /// How far what is added to an accelerometer counts before anybody has judged it, m/s²: of a minority. Later the vote limits it to less.
    fn reach_mps2(&self) -> f64 {
        let minority = 2 * self.imus.len() < self.flying.imus;
        if minority { of_imus::reach_mps2(&self.flying.shaken) } else { f64::INFINITY }
    }
}

/// From the horizon to now.
struct Predictor {
    now: [Signal; 2],
    bias: Signal,
    /// What the specific forces grew by in each tick since the oldest slot that may be closed, m/s.
    grown: VecDeque<Signal>,
}

impl Predictor {
    fn follow(state: &mut [Signal; 2], grown: &Signal, bias: &Signal, tick_s: f64) {
        let gained = grown - bias * tick_s;
        let [z, v] = state;
        z.axpy(tick_s, v, 1.0);
        z.axpy(0.5 * tick_s, &gained, 1.0);
        *v += gained;
    }
}

impl Attacked<'_> {
    /// Height `i` as received: sampled `age_s` before the end of slot `number`.
    fn height(
        &self,
        i: usize,
        number: usize,
        age_s: f64,
        altitudes: &[Signal],
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Signal {
        let time_s = (number + 1) as f64 * SLOT - age_s;
        let tick = (time_s / self.flying.controlled.tick_s).round() as usize;
        let altitude = altitudes.get(tick).or(altitudes.last()).cloned().unwrap_or_else(|| Signal::zeros(0));
        match self.flying.timing.get(i).copied().flatten().filter(|_| self.heights.contains(&i)) {
            Some((rate_hz, phase_s)) if time_s > phase_s - 1e-9 => {
                let sample = ((time_s - phase_s) * rate_hz).round() as usize;
                altitude + attack(SensorId::new(SensorKind::Height, i as u8 + 1), sample)
            }
            _ => altitude,
        }
    }
}

impl Model for Attacked<'_> {
    fn attacked(&self) -> Vec<(SensorId, f64, f64)> {
        let of = &self.flying;
        let height = |i: &usize| {
            let every_s = of.timing.get(*i).copied().flatten().map_or(1.0, |(rate_hz, _)| 1.0 / rate_hz);
            (SensorId::new(SensorKind::Height, *i as u8 + 1), every_s, of.most.0)
        };
        let imu = |i: &usize| (SensorId::new(SensorKind::Imu, *i as u8 + 1), SLOT, of.most.1.min(self.reach_mps2()));
        self.heights.iter().map(height).chain(self.imus.iter().map(imu)).collect()
    }

    fn period_s(&self, horizon_s: f64) -> f64 {
        let Ok(schedule) = self.flying.schedule() else { return horizon_s };
        let swing = self.flying.heave.map_or(1, |(_, period_s)| (period_s / SLOT).round() as usize);
        let slots = together(&[schedule.len(), of_heights::EVERY, swing]);
        (slots as f64 * SLOT).min(horizon_s)
    }

    fn squares(&self) -> Vec<(&'static str, Memory)> {
        SQUARES.to_vec()
    }

    fn respond(
        &self,
        horizon_s: f64,
        width: usize,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Response, EnvelopeError> {
        let of = self.flying;
        let zero = || Signal::zeros(width);
        let schedule = of.schedule()?;
        let rates_hz: Vec<_> = of.timing.iter().map(|timing| timing.map(|(rate_hz, _)| rate_hz)).collect();
        let mut weights = [1.0; MAX_HEIGHTS];
        if self.regime == Regime::Outvoted {
            let healthy = of.count(SensorKind::Height) - self.heights.len();
            let weight = Judges::outvoted(self.heights.len(), healthy);
            weights.iter_mut().enumerate().filter(|(i, _)| !self.heights.contains(i)).for_each(|(_, w)| *w = weight);
        }
        let maps = cycle(&of.model, &schedule, &weights, &of.shaken, ALTITUDE_M);
        let mut running = Running {
            of: self,
            attack,
            schedule,
            width,
            bank: Bank {
                maps: &maps,
                healthy: std::array::from_fn(|_| zero()),
                differ: self.imus.iter().map(|_| std::array::from_fn(|_| zero())).collect(),
                share: 1.0 / of.imus as f64,
            },
            judges: Judges::new(self, &rates_hz, of.imus, of.shaken.noise_mps2, width),
            vehicle: Motion::new(&of.controlled, width),
            predictor: Predictor { now: [zero(), zero()], bias: zero(), grown: VecDeque::new() },
            altitudes: Vec::new(),
            climbs: Vec::new(),
            response: Response::default(),
        };
        (0..(horizon_s / of.controlled.tick_s).round() as usize).for_each(|tick| running.tick(tick));
        Ok(running.response)
    }
}

/// A loop as it runs.
struct Running<'a> {
    of: &'a Attacked<'a>,
    attack: &'a dyn Fn(SensorId, usize) -> Signal,
    schedule: Vec<[Option<f64>; ROWS]>,
    width: usize,
    bank: Bank<'a>,
    judges: Judges,
    vehicle: Motion<'a>,
    predictor: Predictor,
    /// At each tick.
    altitudes: Vec<Signal>,
    climbs: Vec<Signal>,
    /// Altitude and climb at the beginning of each slot, and what the judges heard.
    response: Response,
}

impl Running<'_> {
    fn added(&self, i: usize, slot: usize) -> Signal {
        (self.attack)(SensorId::new(SensorKind::Imu, i as u8 + 1), slot)
    }

    fn tick(&mut self, tick: usize) {
        let tick_s = self.of.flying.controlled.tick_s;
        let (per_slot, late) = ((SLOT / tick_s).round() as usize, (HORIZON_S / tick_s).round() as usize);
        self.altitudes.push(self.vehicle.x[0].clone());
        self.climbs.push(self.vehicle.x[1].clone());
        if tick.is_multiple_of(per_slot) {
            self.response.place_m.push(self.vehicle.x[0].clone());
            self.response.speed_mps.push(self.vehicle.x[1].clone());
        }
        let closed = tick.checked_sub(late).filter(|end| end.is_multiple_of(per_slot) && *end > 0);
        if let Some(number) = closed.map(|end| end / per_slot - 1) {
            self.close(number);
            let back = self.predictor.grown.len().saturating_sub(late);
            self.predictor.grown.drain(..back);
            for grown in &self.predictor.grown {
                Predictor::follow(&mut self.predictor.now, grown, &self.predictor.bias, tick_s);
            }
        }
        let before = self.vehicle.x[1].clone();
        self.vehicle.step(&self.predictor.now, self.width);
        // What the accelerometers feel of this tick.
        let mut grown = &self.vehicle.x[1] - before;
        let reach_mps2 = self.of.reach_mps2();
        for i in &self.of.imus {
            let counted = self.added(*i, tick / per_slot).map(|x| x.clamp(-reach_mps2, reach_mps2));
            grown.axpy(tick_s * self.bank.share * self.of.flying.shaken.own(), &counted, 1.0);
        }
        Predictor::follow(&mut self.predictor.now, &grown, &self.predictor.bias, tick_s);
        self.predictor.grown.push_back(grown);
    }

    /// Slot `number`: the lanes take it, and the judges hear of it.
    fn close(&mut self, number: usize) {
        let climbs = &self.response.speed_mps;
        let force = match (climbs.get(number), climbs.get(number + 1)) {
            (Some(before), Some(after)) => (after - before) / SLOT,
            _ => Signal::zeros(self.width),
        };
        let added: Vec<Signal> = self.of.imus.iter().map(|i| self.added(*i, number)).collect();
        let ages = self.schedule.get(number % self.schedule.len()).copied().unwrap_or_default();
        let height = |i: usize, age_s: f64| self.of.height(i, number, age_s, &self.altitudes, self.attack);
        let measured: Vec<Option<Signal>> =
            ages.iter().take(MAX_HEIGHTS).enumerate().map(|(i, age_s)| age_s.map(|age_s| height(i, age_s))).collect();
        let aided = [(POSE, &self.altitudes), (GNSS, &self.climbs)].map(|(row, of)| {
            let time_s = (number + 1) as f64 * SLOT - ages.get(row).copied().flatten()?;
            of.get((time_s / self.of.flying.controlled.tick_s).round().max(0.0) as usize).cloned()
        });
        let z_m = self.of.flying.altitude_m((number + 1) as f64 * SLOT);
        let corrected = self.judges.without_offsets(&measured, z_m);
        let all: Vec<Option<Signal>> =
            corrected.iter().cloned().chain((corrected.len()..MAX_HEIGHTS).map(|_| None)).chain(aided).collect();
        let own: Vec<Signal> = added.iter().map(|added| added * self.of.flying.shaken.own()).collect();
        let innovations = self.bank.take(number, &force, &own, &all, self.width);
        let (z, v) = (self.bank.fused(0), self.bank.fused(1));
        let after = |(y, age_s): (&Option<Signal>, &Option<f64>)| Some(y.as_ref()? - &z + &v * (*age_s)?);
        let raw = measured.iter().zip(&ages).enumerate();
        self.response.residuals_m.extend(raw.filter_map(|(i, of)| Some((number, i, after(of)?))));
        if self.of.heights.iter().any(|i| ages.get(*i).is_some_and(Option::is_some)) {
            self.response.apart_m.push(((number + 1) as f64 * SLOT, self.judges.apart()));
        }
        let residuals: Vec<Option<Signal>> = corrected.iter().zip(&ages).map(after).collect();
        let (time_s, out) = ((number + 1) as f64 * SLOT, &mut self.response.statistics);
        self.judges.hear_heights((time_s, z_m), number, &innovations, &residuals, out);
        self.judges.hear_imus(time_s, &added, &innovations, &self.bank.differ, out);
        self.predictor.bias = self.bank.fused(2) * self.of.flying.shaken.own();
        self.predictor.now = [z, v];
    }
}
