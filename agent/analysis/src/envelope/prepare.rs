//! Attacks that know the model, as a schedule has them, and what is expected of any schedule.
//!
//! | generator | what is added |
//! |---|---|
//! | optimal | the maximising sequence of the envelope, everything weighing fully, sample by sample |
//! | stealthy bias | the same constant to every height attacked, the largest seen in one of twenty flights |
//! | covert | −½ a t² to heights and −a to accelerometers: what a motion of a upward would have them add is taken off again; with the rotors attacked too that motion is commanded, and the model's response to it taken off |
//! | zero dynamics | what no healthy sensor sees, along the zeros of the loop that do not die away; none where there is none |
//!
//! Those along a horizontal axis are in `aside`.

use plumbline_core::attack::Bounds;
use plumbline_core::estimate::lanes::linear::Shaken;
use plumbline_core::flight::{ROTOR_SIGMA, rotor_information};
use plumbline_core::model::airframe::Airframe;
use plumbline_core::sensor::suite::Suite;
use plumbline_core::types::ROTORS;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};

use super::expected::{Added, Expected, expected};
use super::flying::Regime;
use super::sets::{Asked, Found, Verdict, sequences, verdict, wrong};
use super::{Deviation, EnvelopeError, aside, program, rotors, theory};

/// A stealthy bias is seen in so many flights …
pub(super) const STEALTHY: f64 = 0.05;
/// … and told to within a part of 2 to this.
pub(super) const HALVINGS: usize = 7;
/// Largest bias tried, m.
const LARGEST_M: f64 = 0.5;
/// Accelerometers that rectify more are shaken, m/s²: it is 0.03 where nothing vibrates.
const SHAKEN_MPS2: f64 = 0.1;
/// Seed of the noise drawn: the same question, the same answer.
pub(super) const SEED: u64 = 21;
/// Longest attack that is judged, s.
pub(super) const LONGEST_S: f64 = 60.0;
/// The closed form of a rotor's loss holds where at most, or at least, so much of its thrust is left.
const LEFT: (f64, f64) = (0.9, 0.98);
/// Largest watermark that can be configured, m/s².
const WATERMARK_MPS2: f64 = 0.5;

/// Prepares what `question` asks for, of the vehicle with the sensors of `suite`, and judges it.
///
/// # Errors
/// [`EnvelopeError`] naming field and value.
pub fn prepared(question: &AttackQuestion, suite: Option<Suite>) -> Result<PreparedAttack, EnvelopeError> {
    let mut of = question.of.clone();
    let rotors = rotors::taken(&mut of.sensors, question.generator.as_deref())?;
    if question.generator.is_none() {
        of.sensors = Some(Vec::new());
        of.axis = of.axis.or_else(|| aside::axis_of(&question.attacks).map(str::to_owned));
    } else if !rotors && of.sensors.as_ref().is_none_or(Vec::is_empty) {
        return Err(wrong("sensors", "is empty, a generator attacks at least one".into()));
    }
    let asked = Asked::new(&of, suite)?;
    let set = asked.sets.first().cloned().unwrap_or_default();
    if let Some(lateral) = &asked.lateral {
        return aside::prepared(question, lateral, &set, rotors, asked.horizon_s);
    }
    if let Some(deviation) = &question.deviation {
        return Err(wrong(
            "deviation",
            format!("is {deviation:.40?}, without an axis x or y: it is the altitude that is pushed"),
        ));
    }
    let planned =
        |sensor: SensorId, kind: &str, magnitude: f64| planned(question, asked.horizon_s, sensor, kind, magnitude);
    if let Some(generator @ ("zero_dynamics" | "covert")) = question.generator.as_deref()
        && let Some(aiding) = asked.flying.aiding()
    {
        let problem =
            format!("is {generator}: {aiding} measures along z, too, where it is not attacked, and sees the motion");
        return Err(wrong("generator", problem));
    }
    match question.generator.as_deref() {
        Some("zero_dynamics") => return rotors::zero_dynamics(question, &asked, &set, rotors),
        Some("covert") if rotors => return rotors::covert(question, &asked, &set),
        _ => {}
    }
    let mut note = String::new();
    let attacks = match question.generator.as_deref() {
        None => question.attacks.clone(),
        Some("optimal") => {
            let Found { verdict, regime, .. } = verdict(&asked.flying, &set, asked.horizon_s, Deviation::Place)?;
            let Verdict::Bounded(bound, _) = verdict else {
                return Err(wrong(
                    "sensors",
                    "have no bound, so no largest attack: a covert one goes on for ever".into(),
                ));
            };
            let model = asked.flying.attacked(&set, Regime::Full)?;
            let attack = if regime == Regime::Full {
                bound.attack
            } else {
                // What flies and is judged has everything weighing fully.
                let full = program(&model, asked.horizon_s, Deviation::Place)?.solve()?;
                note = format!(
                    "The bound of {:.1} cm has the healthy heights outvoted all the time, which no flight can; this is the \
                     sequence with all of them weighing fully, which reaches {:.1} cm.",
                    100.0 * bound.upper,
                    100.0 * full.reached,
                );
                full.attack
            };
            let one = |(sensor, period_s, values): (SensorId, f64, Vec<f64>)| {
                scheduled(planned(sensor, "bias", 1.0), period_s, values)
            };
            sequences(&model, &attack, asked.horizon_s).into_iter().map(one).collect()
        }
        Some("stealthy_bias") => {
            let bias_m = stealthy_m(&asked, &set)?;
            set.iter().map(|sensor| planned(*sensor, "bias", bias_m)).collect()
        }
        Some("covert") => {
            let accel_mps2 = question.accel_mps2.unwrap_or(0.02);
            let most = Bounds::default().accel_max_mps2;
            if accel_mps2.is_nan() || accel_mps2.abs() > most {
                return Err(wrong("accel_mps2", format!("is {accel_mps2}, it must be within ±{most}")));
            }
            let of = |sensor: &SensorId| match sensor.kind {
                SensorKind::Imu => planned(*sensor, "bias", -accel_mps2),
                _ => planned(*sensor, "parabola", -accel_mps2),
            };
            set.iter().map(of).collect()
        }
        Some(other) => {
            let problem = format!("is {other:.40?}, it must be optimal, stealthy_bias, zero_dynamics or covert");
            return Err(wrong("generator", problem));
        }
    };
    if let Some(rms_mps2) = question.watermark_mps2.filter(|rms_mps2| !(0.0..=WATERMARK_MPS2).contains(rms_mps2)) {
        return Err(wrong("watermark_mps2", format!("is {rms_mps2}, it must be 0 to {WATERMARK_MPS2}")));
    }
    if let Some((probability, note)) = closed(&asked, &attacks, question.watermark_mps2.unwrap_or(0.0))? {
        return Ok(PreparedAttack { attacks, probability: Some(probability), note, ..PreparedAttack::default() });
    }
    let (found, why) = judged(&asked, &attacks)?;
    note.push_str(&why);
    Ok(PreparedAttack {
        attacks,
        probability: found.as_ref().map(Expected::probability),
        altitude_m: found.as_ref().map(|found| found.altitude_m),
        note,
        ..PreparedAttack::default()
    })
}

/// An attack on `sensor`, of an IMU on its accelerometer along z, for as long as was asked.
pub(super) fn planned(
    question: &AttackQuestion,
    horizon_s: f64,
    sensor: SensorId,
    kind: &str,
    magnitude: f64,
) -> PlannedAttack {
    PlannedAttack {
        sensor: sensor.kind.as_str_name().trim_start_matches("SENSOR_KIND_").to_ascii_lowercase(),
        instance: u32::from(sensor.instance),
        channel: if sensor.kind == SensorKind::Imu { "accel_z" } else { "all" }.to_owned(),
        kind: kind.to_owned(),
        start_s: question.start_s,
        duration_s: horizon_s,
        magnitude,
        seed: 1,
        ..PlannedAttack::default()
    }
}

/// `attack` with these values, one after another.
pub(super) fn scheduled(attack: PlannedAttack, period_s: f64, values: Vec<f64>) -> PlannedAttack {
    let magnitude = values.iter().fold(1e-9, |most: f64, x| most.max(x.abs()));
    let sequence = values.into_iter().map(|x| x / magnitude).collect();
    PlannedAttack { magnitude, sequence, sequence_period_s: Some(period_s), ..attack }
}

/// What is expected of a schedule of one attack by a closed form, and by which.
fn closed(
    asked: &Asked,
    attacks: &[PlannedAttack],
    watermark_mps2: f64,
) -> Result<Option<(f64, String)>, EnvelopeError> {
    let [attack] = attacks else { return Ok(None) };
    let along_z = ["all", "accel", "accel_z"].contains(&attack.channel.as_str());
    let lasts_s = attack.duration_s.max(0.0);
    Ok(match (attack.sensor.as_str(), attack.kind.as_str()) {
        ("imu", "replay") if along_z && watermark_mps2 > 0.0 => {
            let note = format!(
                "imu {} told by a watermark of {watermark_mps2} m/s², which excludes nobody: by the deflection and spread flown with \
                 0.1 m/s²",
                attack.instance
            );
            Some((theory::replay_told(watermark_mps2, lasts_s), note))
        }
        ("rotor", kind @ ("scale" | "zero")) if (1..=ROTORS as u32).contains(&attack.instance) => {
            let left = if kind == "zero" { 0.0 } else { attack.magnitude };
            if !(0.0..=LEFT.0).contains(&left) && !(LEFT.1..=1.0).contains(&left) {
                return Ok(None);
            }
            let loss = 1.0 - left;
            let airframe = Airframe::by_name(&asked.airframe).map_err(|e| wrong("airframe", e.to_string()))?;
            let information = rotor_information(&airframe, attack.instance as usize - 1, &ROTOR_SIGMA.into());
            let note = format!(
                "rotor {} isolated, whatever estimator is in the loop: by the theory of its sum (Wald 1947) in a calm flight",
                attack.instance
            );
            Some((theory::rotor_isolated(loss, information, lasts_s), note))
        }
        _ => None,
    })
}

/// Why nothing is expected of an attack, which is `alone` or one of several.
pub(super) fn unknown(attack: &PlannedAttack, alone: bool) -> String {
    let PlannedAttack { kind, channel, sensor, instance, magnitude, .. } = attack;
    let why = match (sensor.as_str(), kind.as_str()) {
        ("imu", "replay") => ": at hover it is noise of another time, which only a watermark (`watermark_mps2`) tells",
        (_, "replay") => ": at hover it is noise of another time, which no judge tells from that of now",
        (_, "time_shift") => ": what stamps do to the slots of the lanes is not in the model",
        ("height" | "imu", "noise") => ": it moves the estimate that it is judged by another way in each flight",
        ("rotor", "scale") if *magnitude > LEFT.0 && *magnitude < LEFT.1 => {
            ": between a loss of 2 and of 10 % the theory says more than what is flown"
        }
        ("rotor", "scale" | "zero") if !alone => ": its closed form is of one attack alone",
        ("rotor", "bias") => ": thrust that is added is judged only as it is prepared",
        _ => "",
    };
    format!("nothing is expected of {kind} on {channel} of {sensor} {instance}{why}")
}

/// Power: what is expected of the attacks of `question` with their magnitudes times each of `parts`; with 0 those are false alarms.
/// `None` where nothing is expected of them.
///
/// # Errors
/// [`EnvelopeError`] naming field and value.
pub fn power(
    question: &AttackQuestion,
    suite: Option<Suite>,
    parts: &[f64],
) -> Result<Vec<Option<Expected>>, EnvelopeError> {
    let axis = question.of.axis.clone().or_else(|| aside::axis_of(&question.attacks).map(str::to_owned));
    let asked = Asked::new(&EnvelopeQuestion { sensors: Some(Vec::new()), axis, ..question.of.clone() }, suite)?;
    let scaled = |part: &f64| {
        let one = |attack: &PlannedAttack| PlannedAttack { magnitude: part * attack.magnitude, ..attack.clone() };
        let attacks: Vec<_> = question.attacks.iter().map(one).collect();
        match &asked.lateral {
            Some(lateral) => Ok(aside::judged(lateral, &attacks).0),
            None => Ok(judged(&asked, &attacks)?.0),
        }
    };
    parts.iter().map(scaled).collect()
}

/// The largest bias on all of `set` that is seen in at most one of twenty flights, m.
fn stealthy_m(asked: &Asked, set: &[SensorId]) -> Result<f64, EnvelopeError> {
    if let Some(other) = set.iter().find(|sensor| sensor.kind != SensorKind::Height) {
        return Err(wrong("sensors", format!("have {other}: a stealthy bias is one of heights")));
    }
    let seen = |bias_m: f64| {
        let at = move |_: f64| bias_m;
        let added: Vec<Added<'_>> = set.iter().map(|sensor| Added { sensor: *sensor, at: &at }).collect();
        Ok::<bool, EnvelopeError>(expected(&asked.flying, &added, asked.horizon_s, SEED)?.probability() > STEALTHY)
    };
    largest_unseen(LARGEST_M, HALVINGS, seen)
}

/// The largest size up to `most` that is not `seen`, to within a part of 2 to `halvings`.
pub(super) fn largest_unseen(
    most: f64,
    halvings: usize,
    seen: impl Fn(f64) -> Result<bool, EnvelopeError>,
) -> Result<f64, EnvelopeError> {
    if !seen(most)? {
        return Ok(most);
    }
    let (mut low, mut high) = (0.0, most);
    for _ in 0..halvings {
        let middle = 0.5 * (low + high);
        if seen(middle)? { high = middle } else { low = middle }
    }
    Ok(low)
}

/// What is added at so many seconds since the first onset.
pub(super) type Adds<'a> = Box<dyn Fn(f64) -> f64 + 'a>;

/// First onset and last end of a schedule, s after it is accepted.
pub(super) fn span(attacks: &[PlannedAttack]) -> (f64, f64) {
    let first_s = attacks.iter().map(|attack| attack.start_s).fold(f64::INFINITY, f64::min);
    (first_s, attacks.iter().map(|attack| attack.start_s + attack.duration_s).fold(0.0, f64::max))
}

/// The sensor of an attack.
pub(super) fn named(attack: &PlannedAttack) -> Option<SensorId> {
    format!("{} {}", attack.sensor.replace('_', " "), attack.instance).parse().ok()
}

/// Is the attack on what moves the altitude?
fn is_upward(attack: &PlannedAttack) -> bool {
    matches!((attack.sensor.as_str(), attack.channel.as_str()), ("height", "all") | ("imu", "accel_z"))
}

/// What an attack of a schedule adds at so many seconds since the first onset; `None` where it does not just add.
pub(super) fn adds(attack: &PlannedAttack, first_s: f64) -> Option<Adds<'_>> {
    let sound = [attack.start_s, attack.duration_s, attack.magnitude].iter().all(|x| x.is_finite());
    let shape: fn(f64) -> f64 = match attack.kind.as_str() {
        "bias" => |_| 1.0,
        "ramp" => |t| t,
        "parabola" => |t| 0.5 * t * t,
        _ => return None,
    };
    sound.then(|| -> Adds<'_> {
        Box::new(move |since_s| {
            let t = since_s + first_s - attack.start_s;
            if !(-1e-9..attack.duration_s).contains(&t) {
                return 0.0;
            }
            let part = attack.sequence_period_s.map_or(1.0, |period_s| {
                attack.sequence.get((t.max(0.0) / period_s + 1e-9) as usize).copied().unwrap_or(0.0)
            });
            attack.magnitude * part * shape(t.max(0.0))
        })
    })
}

/// What is expected of `attacks`, and what keeps anything from being expected.
fn judged(asked: &Asked, attacks: &[PlannedAttack]) -> Result<(Option<Expected>, String), EnvelopeError> {
    let (first_s, end_s) = span(attacks);
    let mut of: Vec<(SensorId, Vec<Adds<'_>>)> = Vec::new();
    for attack in attacks {
        let sensor = named(attack).filter(|sensor| is_upward(attack) && asked.flying.sensors.contains(sensor));
        let (Some(sensor), Some(adds)) = (sensor, adds(attack, first_s)) else {
            return Ok((None, unknown(attack, attacks.len() == 1)));
        };
        match of.iter_mut().find(|(known, _)| *known == sensor) {
            Some((_, all)) => all.push(adds),
            None => of.push((sensor, vec![adds])),
        }
    }
    if of.is_empty() || end_s - first_s > LONGEST_S {
        let longest = format!("nothing is expected beyond {LONGEST_S} s");
        return Ok((None, if of.is_empty() { String::new() } else { longest }));
    }
    let Shaken { rectified_mps2, .. } = asked.flying.shaken;
    if rectified_mps2 > SHAKEN_MPS2 && of.iter().any(|(sensor, _)| sensor.kind == SensorKind::Imu) {
        let why = format!(
            "nothing is expected of an accelerometer where all rectify {rectified_mps2:.2} m/s², above {SHAKEN_MPS2}: without that the model sees \
             one of 1 m/s², with it none of 4, and half are seen at 3"
        );
        return Ok((None, why));
    }
    let sums: Vec<_> =
        of.iter().map(|(sensor, all)| (*sensor, move |t: f64| all.iter().map(|f| f(t)).sum::<f64>())).collect();
    let added: Vec<Added<'_>> = sums.iter().map(|(sensor, at)| Added { sensor: *sensor, at }).collect();
    Ok((Some(expected(&asked.flying, &added, end_s - first_s, SEED)?), String::new()))
}
