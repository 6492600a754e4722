//! Every set of attacked sensors, its bound, and the answer to a question in JSON.

use std::time::Instant;

use plumbline_core::attack::Bounds;
use plumbline_core::control::gains::Examiner;
use plumbline_core::control::law::Law;
use plumbline_core::control::policy::MarginPolicy;
use plumbline_core::estimate::lanes::lateral::Aid;
use plumbline_core::estimate::lanes::linear::{ROWS, SLOT, Shaken};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::sensor::suite::{PRESETS, Suite};
use plumbline_core::types::TICK_RATE_HZ;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::envelope::{
    Envelope, EnvelopeCertificate, EnvelopeMultiplier, EnvelopeQuestion, EnvelopeSequence, EnvelopeSet,
};

use super::flying::{Attacked, Loop, Regime};
use super::lateral::{self, Lateral};
use super::program::{Bound, Multiplier, Program};
use super::{Deviation, EnvelopeError, Model, Signal, columns, program, recession_mps};
use crate::design::DesignError;
use crate::design::file::{field, proposal};

/// Horizons that may be asked for, s: the longest mean has 24 samples.
const HORIZON_S: (f64, f64) = (3.0, 60.0);
/// The usual one, s …
pub const USUAL_HORIZON_S: f64 = 10.0;
/// … and along a horizontal axis, where an IMU has two values for each slot and all settles within a second or grows on.
const LATERAL_HORIZON_S: f64 = 5.0;
/// How far healthy heights are guessed to be from their mean, m: the last is none.
const GUESSES_M: [f64; 6] = [0.003, 0.006, 0.012, 0.018, 0.025, f64::INFINITY];
/// Largest set asked for.
const MOST: usize = 3;
/// Beyond this tilt a linear loop says nothing, rad.
pub(super) const SMALL_RAD: f64 = 0.35;
/// Further from hover than this it says nothing either, m.
const NEAR_HOVER_M: f64 = 1.0;
/// What holds half of the IMUs where something else tells lanes apart.
const UNJUDGED: &str = "nothing: no majority of IMUs votes";
/// What holds a bound that no detector holds.
const MOST_ADDED: &str = "most that may be added";

pub(super) fn wrong(name: &str, problem: String) -> EnvelopeError {
    field(name, problem).into()
}

/// The bound of a set.
#[derive(Debug, Clone)]
pub enum Verdict {
    /// No silent attack goes further; of this program, until the end.
    Bounded(Bound, Box<Program>),
    /// There is no bound: it can drift silently as fast, m/s.
    Unbounded(f64),
    /// None is told: half of the IMUs or more, which no vote judges, jump further than what motion capture or GNSS holds against a lane at once.
    Unjudged,
}

/// What is found of a set.
#[derive(Debug, Clone)]
pub struct Found {
    /// Its bound, or none; the attack lasts for the horizon asked for.
    pub verdict: Verdict,
    /// In which the bound is the larger.
    pub regime: Regime,
    /// When the altitude is furthest, s since the onset.
    pub end_s: f64,
}

/// The bound of `sensors` attacked: the largest of the regimes, or none.
///
/// # Errors
/// [`EnvelopeError`].
pub fn verdict(
    flying: &Loop,
    sensors: &[SensorId],
    horizon_s: f64,
    deviation: Deviation,
) -> Result<Found, EnvelopeError> {
    let mut full = flying.attacked(sensors, Regime::Full)?;
    if flying.aiding().is_some() && 2 * full.imus.len() >= flying.count(SensorKind::Imu) {
        return Ok(Found { verdict: Verdict::Unjudged, regime: Regime::Full, end_s: horizon_s });
    }
    full.near_m = near_m(&full, horizon_s)?;
    let heights = flying.count(SensorKind::Height);
    if full.heights.len() == heights
        && let Some(drift_mps) = recession_mps(&full)?
    {
        return Ok(Found { verdict: Verdict::Unbounded(drift_mps), regime: Regime::Full, end_s: horizon_s });
    }
    let mut of = program(&full, horizon_s, deviation)?;
    let (mut found, mut regime, mut end_s) = (of.solve()?, Regime::Full, horizon_s);
    if 2 * full.heights.len() >= heights && full.heights.len() < heights {
        let outvoted = flying.attacked(sensors, Regime::Outvoted)?;
        // The vehicle is where the healthy height last allowed: it goes furthest at another slot than the last, by up to 5 %.
        for back in 0..flying.schedule()?.len() {
            let until_s = horizon_s - back as f64 * SLOT;
            let shorter = program(&outvoted, until_s, deviation)?;
            let other = shorter.solve()?;
            if other.upper > found.upper {
                let attack = lasting(&outvoted, &other.attack, until_s, horizon_s);
                (found, regime, end_s, of) = (Bound { attack, ..other }, Regime::Outvoted, until_s, shorter);
            }
        }
    }
    Ok(Found { verdict: Verdict::Bounded(found, Box::new(of)), regime, end_s })
}

/// An attack of `end_s` with nothing added from there until `horizon_s`.
fn lasting(model: &dyn Model, attack: &Signal, end_s: f64, horizon_s: f64) -> Signal {
    let (short, long) = (columns(model, end_s), columns(model, horizon_s));
    let mut out = Signal::zeros(long.iter().map(|(_, _, count)| count).sum());
    for ((_, from, count), (_, to, _)) in short.into_iter().zip(long) {
        out.rows_mut(to, count).copy_from(&attack.rows(from, count));
    }
    out
}

/// How far the median of all heights may be from the mean of the healthy ones, m, while a minority is attacked. Guessed, and proved by
/// induction over the samples: while no healthy height was further from that mean than the guess, none comes further than what is found,
/// which is no more than the guess.
fn near_m(of: &Attacked<'_>, horizon_s: f64) -> Result<f64, EnvelopeError> {
    let healthy = of.flying.count(SensorKind::Height) - of.heights.len();
    if of.heights.is_empty() || of.heights.len() >= healthy {
        return Ok(0.0);
    }
    let schedule = of.flying.schedule()?;
    let sampled = |slot: &&[Option<f64>; ROWS]| of.heights.iter().any(|i| slot.get(*i).is_some_and(Option::is_some));
    let slots = (of.period_s(horizon_s) / SLOT).round() as usize;
    let samples = schedule.iter().cycle().take(slots).filter(sampled).count();
    // Two are as far from their mean as each other.
    let each = if healthy == 2 { 1 } else { healthy };
    let mut guessed = of.clone();
    for guess_m in GUESSES_M {
        guessed.near_m = guess_m;
        let mut found_m: f64 = 0.0;
        for (i, before) in (0..each).flat_map(|i| (0..samples).map(move |before| (i, before))) {
            let found = program(&guessed, horizon_s, Deviation::Apart(i, before))?;
            // As exactly as it says more than the others before.
            let bound = found.until(|upper, reached| upper <= found_m || reached > guess_m)?;
            found_m = found_m.max(bound.upper);
            if found_m > guess_m {
                break;
            }
        }
        if found_m <= guess_m {
            return Ok(found_m);
        }
    }
    Ok(f64::INFINITY)
}

/// Sets of `count` of `sensors`, in order.
fn sets(sensors: &[SensorId], count: usize) -> Vec<Vec<SensorId>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for (i, first) in sensors.iter().enumerate() {
        for rest in sets(sensors.get(i + 1..).unwrap_or_default(), count - 1) {
            all.push(std::iter::once(*first).chain(rest).collect());
        }
    }
    all
}

/// What a set's program depends on: its sensors other than IMUs, and how many IMUs (the model has them alike).
fn class(set: &[SensorId]) -> (Vec<SensorId>, usize) {
    let others: Vec<SensorId> = set.iter().copied().filter(|sensor| sensor.kind != SensorKind::Imu).collect();
    let imus = set.len() - others.len();
    (others, imus)
}

/// The largest bound of the altitude over all sets of at most `most` sensors of `flying`, m, whenever its heights sample; `None` where a
/// set has none. Given up where `go_on` says no.
///
/// # Errors
/// [`EnvelopeError`].
pub fn largest_m(
    flying: &Loop,
    most: usize,
    horizon_s: f64,
    go_on: impl Fn() -> bool,
) -> Result<Option<f64>, EnvelopeError> {
    if most > flying.sensors.len() {
        return Err(EnvelopeError::SetTooLarge { size: most, sensors: flying.sensors.len() });
    }
    let mut known = Vec::new();
    let mut largest_m: f64 = 0.0;
    for set in (1..=most).flat_map(|count| sets(&flying.sensors, count)) {
        if known.contains(&class(&set)) {
            continue;
        }
        if !go_on() {
            return Err(EnvelopeError::GivenUp);
        }
        match verdict(&flying.at_worst_moments(&set), &set, horizon_s, Deviation::Place)?.verdict {
            Verdict::Bounded(bound, _) if bound.upper <= NEAR_HOVER_M => largest_m = largest_m.max(bound.upper),
            Verdict::Bounded(..) | Verdict::Unbounded(_) | Verdict::Unjudged => return Ok(None),
        }
        known.push(class(&set));
    }
    Ok(Some(largest_m))
}

/// Sensors by `names`, each one `of` these, and none twice.
fn named(field: &str, names: &[String], of: &[SensorId]) -> Result<Vec<SensorId>, EnvelopeError> {
    let known = || of.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let unknown = |name: &String| EnvelopeError::UnknownSensor { sensor: name.clone(), known: known() };
    let one = |name: &String| name.parse().ok().filter(|sensor| of.contains(sensor)).ok_or_else(|| unknown(name));
    let mut found = Vec::with_capacity(names.len());
    for name in names {
        let sensor = one(name)?;
        if found.contains(&sensor) {
            return Err(wrong(field, format!("names {sensor} twice")));
        }
        found.push(sensor);
    }
    Ok(found)
}

/// The sets of `sensors` that are asked for.
fn sets_of(question: &EnvelopeQuestion, sensors: &[SensorId]) -> Result<Vec<Vec<SensorId>>, EnvelopeError> {
    let most = question.most.unwrap_or(2);
    let size = question.sensors.as_ref().map_or(most, Vec::len);
    if size > sensors.len() {
        return Err(EnvelopeError::SetTooLarge { size, sensors: sensors.len() });
    }
    if let Some(names) = &question.sensors {
        return Ok(vec![named("sensors", names, sensors)?]);
    }
    if !(1..=MOST).contains(&most) {
        return Err(wrong("most", format!("is {most}, it must be 1 to {MOST}")));
    }
    let mut all: Vec<_> = (1..=most).flat_map(|count| sets(sensors, count)).collect();
    // Where the promise ends.
    let heights = sensors.iter().copied().filter(|sensor| sensor.kind == SensorKind::Height);
    let heights: Vec<SensorId> = heights.collect();
    if heights.len() > most {
        all.push(heights);
    }
    Ok(all)
}

/// A question, understood.
#[derive(Debug)]
pub struct Asked {
    /// The loop of the altitude.
    pub flying: Loop,
    /// That of a horizontal axis, where one is asked about.
    pub lateral: Option<Lateral>,
    suite: String,
    pub(super) airframe: String,
    pub(super) horizon_s: f64,
    climb: bool,
    proof: bool,
    /// In order, the smaller first.
    pub sets: Vec<Vec<SensorId>>,
}

impl Asked {
    /// Reads `question`; `suite` is the one it names, where that is none of the presets.
    ///
    /// # Errors
    /// [`EnvelopeError`] naming field and value.
    pub fn new(question: &EnvelopeQuestion, suite: Option<Suite>) -> Result<Self, EnvelopeError> {
        let name = question.suite.as_deref().unwrap_or("string_rig");
        let known = || wrong("suite", format!("is {name:.40?}, expected one of {}", PRESETS.join(", ")));
        let mut suite = suite.or_else(|| Suite::preset(name)).ok_or_else(known)?;
        let axis = match question.axis.as_deref() {
            None | Some("z") => None,
            Some("x") => Some(0),
            Some("y") => Some(1),
            Some(other) => return Err(wrong("axis", format!("is {other:.40?}, it must be x, y or z"))),
        };
        if let Some(more) = &question.more {
            let added = match more.as_str() {
                "height" => suite.add(SensorKind::Height),
                "imu" => suite.add(SensorKind::Imu),
                "gnss" => suite.add(SensorKind::Gnss),
                "pose" => suite.add(SensorKind::MocapPose),
                _ => return Err(wrong("more", format!("is {more:.40?}, it must be height, imu, gnss or pose"))),
            };
            if !added {
                return Err(wrong("more", format!("is {more}, there is no place for another")));
            }
        }
        let airframe = question.design.airframe.as_deref().unwrap_or("iris");
        let airframe = Airframe::by_name(airframe).map_err(|e| wrong("airframe", e.to_string()))?;
        let tick_rate_hz = question.design.tick_rate_hz.unwrap_or(200.0);
        if !TICK_RATE_HZ.contains(&tick_rate_hz) {
            return Err(wrong("tick_rate_hz", format!("is {tick_rate_hz}, it must be 50 to 1000")));
        }
        if question.proof && (axis.is_some() || question.sensors.is_none()) {
            return Err(wrong("proof", "is true, it is told of one set of `sensors` along z".into()));
        }
        let horizon_s = question.horizon_s.unwrap_or(match axis {
            Some(_) => LATERAL_HORIZON_S,
            None => USUAL_HORIZON_S,
        });
        if !(HORIZON_S.0..=HORIZON_S.1).contains(&horizon_s) {
            return Err(wrong("horizon_s", format!("is {horizon_s}, it must be {} to {}", HORIZON_S.0, HORIZON_S.1)));
        }
        let solved = || -> Result<Law, DesignError> {
            let examiner = Examiner::new(&airframe, 1.0 / tick_rate_hz, MarginPolicy::EXPERIMENTAL)?;
            Ok(examiner.solve(&proposal(&question.design)?.complete(&airframe)?)?)
        };
        let law = solved()?;
        let bounds = Bounds::default();
        let most = (bounds.length_max_m, bounds.accel_max_mps2);
        let shaken = Shaken {
            noise_mps2: question.noise_mps2.unwrap_or(0.0),
            rectified_mps2: question.rectified_mps2.unwrap_or(0.0),
        };
        let flying = Loop::new(&suite, &airframe, &law, tick_rate_hz, shaken, most)?;
        let without = match axis {
            None => named("without", &question.without, &flying.used().collect::<Vec<_>>())?,
            Some(_) => Vec::new(),
        };
        let mut flying = flying.without(&without)?;
        if let Some(swing) = question.swing.filter(|_| axis.is_none()) {
            flying = flying.heaving(swing.amplitude_m, swing.period_s)?;
        }
        let lateral = axis.map(|axis| {
            let without = named("without", &question.without, &lateral::sensors(&suite))?;
            let most = (bounds.accel_max_mps2, bounds.rate_max_radps);
            let lateral = Lateral::new(&suite, &without, &airframe, &law, tick_rate_hz, shaken.noise_mps2, most, axis)?;
            match question.swing {
                Some(swing) => lateral.swinging(swing.amplitude_m, swing.period_s),
                None => Ok(lateral),
            }
        });
        let lateral = lateral.transpose()?;
        let sets = sets_of(question, lateral.as_ref().map_or(&flying.sensors, |lateral| &lateral.sensors))?;
        let (suite, airframe) = (name.to_owned(), airframe.name.clone());
        let EnvelopeQuestion { climb, proof, .. } = *question;
        Ok(Self { flying, lateral, suite, airframe, horizon_s, climb, proof, sets })
    }

    /// What `set` can do to the altitude.
    fn above(&self, set: &[SensorId]) -> Result<EnvelopeSet, EnvelopeError> {
        let flying = self.flying.at_worst_moments(set);
        let of = |deviation| verdict(&flying, set, self.horizon_s, deviation);
        let place = of(Deviation::Place)?;
        let mut found = told(&place.verdict);
        if self.proof
            && let Verdict::Bounded(bound, of) = &place.verdict
        {
            let model = flying.attacked(set, place.regime)?;
            let sequences = sequences(&model, &bound.attack, self.horizon_s).into_iter();
            let named = |(sensor, period_s, values): (SensorId, f64, Vec<f64>)| EnvelopeSequence {
                sensor: sensor.to_string(),
                period_s,
                values,
            };
            found.attack = sequences.map(named).collect();
            found.certificate = Some(certificate(bound, of, place.regime, place.end_s));
        }
        if self.climb
            && let Verdict::Bounded(bound, _) = of(Deviation::Speed)?.verdict
        {
            found.climb_mps = Some(bound.upper);
        }
        Ok(found)
    }

    /// Every set; `line` is told each as it comes, and ends it with false.
    ///
    /// # Errors
    /// [`EnvelopeError`].
    pub fn answer(&self, mut line: impl FnMut(&EnvelopeSet) -> bool) -> Result<Envelope, EnvelopeError> {
        let mut known: Vec<((Vec<SensorId>, usize), EnvelopeSet)> = Vec::new();
        let mut sets = Vec::with_capacity(self.sets.len());
        for set in &self.sets {
            let same = known.iter().find(|(of, _)| *of == class(set)).map(|(_, found)| found.clone());
            let mut found = match same {
                Some(found) => EnvelopeSet { took_ms: 0.0, ..found },
                None => {
                    let begun = Instant::now();
                    let mut found = match &self.lateral {
                        Some(lateral) => aside(lateral, set, self.horizon_s)?,
                        None => self.above(set)?,
                    };
                    found.took_ms = 1e3 * begun.elapsed().as_secs_f64();
                    known.push((class(set), found.clone()));
                    found
                }
            };
            found.sensors = set.iter().map(ToString::to_string).collect();
            sets.push(found);
            if !sets.last().is_some_and(&mut line) {
                break;
            }
        }
        Ok(Envelope { suite: self.suite.clone(), airframe: self.airframe.clone(), horizon_s: self.horizon_s, sets })
    }
}

/// What `attack` of `model` adds to each sensor: the time between two values, s, and the values.
pub(super) fn sequences(model: &dyn Model, attack: &Signal, horizon_s: f64) -> Vec<(SensorId, f64, Vec<f64>)> {
    let every = model.attacked().into_iter().zip(columns(model, horizon_s));
    let one = |((sensor, period_s, most), (_, first, count)): ((SensorId, f64, f64), (SensorId, usize, usize))| {
        (sensor, period_s, attack.rows(first, count).iter().map(|x| x.clamp(-most, most)).collect())
    };
    every.map(one).collect()
}

fn certificate(bound: &Bound, of: &Program, regime: Regime, end_s: f64) -> EnvelopeCertificate {
    let told = |one: &Multiplier| EnvelopeMultiplier {
        detector: one.detector.to_owned(),
        sensor: one.sensor.map(|sensor| sensor.to_string()),
        time_s: one.time_s,
        limit: one.limit,
        multiplier: one.value,
        statistics: one.of.len(),
        row: one.row(of).iter().copied().collect(),
    };
    let regime = if regime == Regime::Full { "full" } else { "outvoted" };
    EnvelopeCertificate {
        regime: regime.to_owned(),
        end_s,
        multipliers: bound.certificate.iter().map(told).collect(),
        added_m: bound.added,
        objective: of.objective.iter().copied().collect(),
        most: of.most.clone(),
    }
}

/// What `set` can do along a horizontal axis; nothing is told where nobody judges it.
fn aside(lateral: &Lateral, set: &[SensorId], horizon_s: f64) -> Result<EnvelopeSet, EnvelopeError> {
    let mut told = EnvelopeSet::default();
    let mut reached = f64::INFINITY;
    let mut of = |deviation| {
        let bound = lateral.bound(set, horizon_s, deviation)?;
        Ok::<_, EnvelopeError>(bound.map(|(bound, _)| {
            reached = f64::min(reached, bound.reached / bound.upper);
            let binding = bound.binding.unwrap_or(MOST_ADDED).to_owned();
            (bound.upper, binding)
        }))
    };
    let tilt = of(Deviation::Tilt)?;
    if tilt.as_ref().is_some_and(|(tilt_rad, _)| *tilt_rad > SMALL_RAD) {
        told.binding = Some("nothing within small angles".to_owned());
        return Ok(told);
    }
    let velocity = of(Deviation::Speed)?;
    let position = if lateral.aid == Aid::None { None } else { of(Deviation::Place)? };
    (told.tilt_rad, told.binding) = tilt.unzip();
    told.velocity_mps = velocity.map(|(upper, _)| upper);
    told.position_m = position.map(|(upper, _)| upper);
    told.reached = reached.is_finite().then_some(reached);
    Ok(told)
}

fn told(verdict: &Verdict) -> EnvelopeSet {
    match verdict {
        Verdict::Bounded(bound, _) if bound.upper > NEAR_HOVER_M => {
            let binding = Some(format!("nothing within {NEAR_HOVER_M} m of the hover"));
            EnvelopeSet { binding, ..EnvelopeSet::default() }
        }
        Verdict::Bounded(bound, _) => EnvelopeSet {
            altitude_m: Some(bound.upper),
            reached_m: Some(bound.reached),
            binding: Some(bound.binding.unwrap_or(MOST_ADDED).to_owned()),
            ..EnvelopeSet::default()
        },
        Verdict::Unjudged => EnvelopeSet { binding: Some(UNJUDGED.to_owned()), ..EnvelopeSet::default() },
        Verdict::Unbounded(drift_mps) => EnvelopeSet { drift_mps: Some(*drift_mps), ..EnvelopeSet::default() },
    }
}
