//! Attacks along a horizontal axis that know the model, as a schedule has them, and what is expected of any schedule there.
//!
//! | generator | what is added |
//! |---|---|
//! | optimal | the maximising sequence of tilt, velocity or position, to an IMU's accelerometer and gyroscope |
//! | stealthy bias | the same constant to the accelerometers or to the gyroscopes of all IMUs attacked, the largest seen in one of twenty flights; of both the one that moves the vehicle further |
//! | covert | −a to all accelerometers along the axis and −½ a t² to the position as motion capture has it: the loop takes that for a force and sets a motion against it, which is not in what is received |

use plumbline_core::attack::Bounds;
use plumbline_core::estimate::lanes::lateral::Aid;
use plumbline_core::estimate::lanes::linear::SLOT;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, PreparedAttack};

use super::expected::Expected;
use super::heard_aside::{Heard, Pushed, Quantity};
use super::lateral::{Lateral, channels};
use super::prepare::{Adds, LONGEST_S, SEED, STEALTHY, adds, largest_unseen, named, planned, scheduled, span, unknown};
use super::sets::{SMALL_RAD, wrong};
use super::{Deviation, EnvelopeError};

/// A stealthy bias is told to within a part of 2 to this of the largest tried.
const HALVINGS: usize = 10;
/// A covert motion where no acceleration is told, m/s².
const COVERT_MPS2: f64 = 0.02;
/// The axes, as they are named.
const AXES: [&str; 2] = ["x", "y"];

/// Prepares what `question` asks for along the axis of `lateral`, and judges it.
///
/// # Errors
/// [`EnvelopeError`] naming field and value.
pub(super) fn prepared(
    question: &AttackQuestion,
    lateral: &Lateral,
    set: &[SensorId],
    rotors: bool,
    horizon_s: f64,
) -> Result<PreparedAttack, EnvelopeError> {
    if rotors {
        return Err(wrong("sensors", "have rotors: along x and y attacks are those of sensors alone".into()));
    }
    match question.generator.as_deref() {
        None => {
            let (found, note) = judged(lateral, &question.attacks);
            let within = found.as_ref().filter(|found| found.aside[0] <= SMALL_RAD).map(|found| found.aside);
            let position = within.filter(|_| lateral.aid != Aid::None).map(|[.., place]| place);
            Ok(PreparedAttack {
                attacks: question.attacks.clone(),
                probability: found.as_ref().map(Expected::probability),
                tilt_rad: within.map(|[tilt, ..]| tilt),
                velocity_mps: within.map(|[_, speed, _]| speed),
                position_m: position,
                note,
                ..PreparedAttack::default()
            })
        }
        Some("optimal") => optimal(question, lateral, set, horizon_s),
        Some("stealthy_bias") => stealthy(question, lateral, set, horizon_s),
        Some("covert") => covert(question, lateral, set, horizon_s),
        Some(other) => {
            let problem = format!("is {other:.40?}: along x and y it must be optimal, stealthy_bias or covert");
            Err(wrong("generator", problem))
        }
    }
}

/// What `question` has pushed.
fn deviation(question: &AttackQuestion, lateral: &Lateral) -> Result<Deviation, EnvelopeError> {
    match question.deviation.as_deref() {
        None | Some("tilt") => Ok(Deviation::Tilt),
        Some("velocity") => Ok(Deviation::Speed),
        Some("position") if lateral.aid == Aid::None => {
            Err(wrong("deviation", "is \"position\", which neither motion capture nor GNSS measures here".into()))
        }
        Some("position") => Ok(Deviation::Place),
        Some(other) => Err(wrong("deviation", format!("is {other:.40?}, it must be tilt, velocity or position"))),
    }
}

/// An answer that tells how far `attacks` push `deviation`: rad, m/s or m.
fn pushes(attacks: Vec<PlannedAttack>, deviation: Deviation, far: f64) -> PreparedAttack {
    let of = |one: Deviation| (one == deviation).then_some(far);
    PreparedAttack {
        attacks,
        tilt_rad: of(Deviation::Tilt),
        velocity_mps: of(Deviation::Speed),
        position_m: of(Deviation::Place),
        ..PreparedAttack::default()
    }
}

/// The maximising sequence.
fn optimal(
    question: &AttackQuestion,
    lateral: &Lateral,
    set: &[SensorId],
    horizon_s: f64,
) -> Result<PreparedAttack, EnvelopeError> {
    let deviation = deviation(question, lateral)?;
    let solved = |deviation| {
        let unjudged =
            || wrong("sensors", "are judged by nobody along this axis, so there is no largest attack".into());
        Ok::<_, EnvelopeError>(lateral.bound(set, horizon_s, deviation)?.ok_or_else(unjudged)?.0)
    };
    let tilt = solved(Deviation::Tilt)?;
    if tilt.upper > SMALL_RAD {
        let problem = format!("may tilt it by {:.2} rad unseen: beyond small angles nothing is known", tilt.upper);
        return Err(wrong("sensors", problem));
    }
    let bound = if deviation == Deviation::Tilt { tilt } else { solved(deviation)? };
    let one = |(imu, channel, values): (SensorId, &str, Vec<f64>)| {
        let attack = PlannedAttack { channel: channel.to_owned(), ..planned(question, horizon_s, imu, "bias", 1.0) };
        scheduled(attack, SLOT, values)
    };
    let attacks: Vec<_> = lateral.sequences(set, &bound.attack).into_iter().map(one).collect();
    let (found, why) = judged(lateral, &attacks);
    let held = if lateral.aid == Aid::None { "attitude" } else { "position" };
    let part = 100.0 * bound.reached / bound.upper;
    let note = format!("{part:.0} % of the bound, about a hover that holds its {held}. {why}");
    let probability = found.as_ref().map(Expected::probability);
    Ok(PreparedAttack { probability, note: note.trim_end().to_owned(), ..pushes(attacks, deviation, bound.reached) })
}

/// The largest constant on accelerometers or gyroscopes of the `set` that is seen in at most one of twenty flights.
fn stealthy(
    question: &AttackQuestion,
    lateral: &Lateral,
    set: &[SensorId],
    horizon_s: f64,
) -> Result<PreparedAttack, EnvelopeError> {
    let deviation = deviation(question, lateral)?;
    if lateral.aid != Aid::Pose {
        return Err(wrong("generator", format!("is \"stealthy_bias\": {}", untold(lateral))));
    }
    if let Some(other) = set.iter().find(|sensor| sensor.kind != SensorKind::Imu) {
        return Err(wrong("sensors", format!("have {other}: along x and y a stealthy bias is one of IMUs")));
    }
    let heard = |quantity: Quantity, size: f64| {
        let at = move |_: f64| size;
        let pushed: Vec<Pushed<'_>> = set.iter().map(|sensor| Pushed { sensor: *sensor, quantity, at: &at }).collect();
        Heard::new(lateral, &pushed, horizon_s)
    };
    let place = match deviation {
        Deviation::Speed => 1,
        Deviation::Place => 2,
        Deviation::Tilt | Deviation::Apart(..) => 0,
    };
    let mut best: Option<(f64, PlannedAttack, Quantity, bool)> = None;
    for ((quantity, allowed), channel) in
        [(Quantity::Force, lateral.most.0), (Quantity::Rate, lateral.most.1)].into_iter().zip(lateral.channels())
    {
        let unit = heard(quantity, 1.0).furthest();
        let most = if unit[0] > 0.0 { allowed.min(SMALL_RAD / unit[0]) } else { allowed };
        let size = largest_unseen(most, HALVINGS, |size| Ok(heard(quantity, size).is_seen_in_more(STEALTHY, SEED)))?;
        let far = size * unit[place];
        if best.as_ref().is_none_or(|(before, ..)| far > *before)
            && let Some(first) = set.first()
        {
            let attack = planned(question, horizon_s, *first, "bias", size);
            best = Some((far, PlannedAttack { channel: channel.to_owned(), ..attack }, quantity, size == most));
        }
    }
    let Some((far, attack, quantity, whole)) = best else {
        return Err(wrong("sensors", "have no IMU: along x and y a stealthy bias is one of IMUs".into()));
    };
    let attacks = set.iter().map(|sensor| PlannedAttack { instance: u32::from(sensor.instance), ..attack.clone() });
    let attacks: Vec<_> = attacks.collect();
    let what = if quantity == Quantity::Force { "accelerometers" } else { "gyroscopes" };
    let mut note = format!(
        "Of accelerometers and gyroscopes the {what} move it further: so far where all weighs fully, less in flight, where IMUs vote."
    );
    if whole {
        note.push_str(" Nobody sees the largest constant that may be added within small angles.");
    }
    let found = heard(quantity, attack.magnitude).expected(SEED);
    Ok(PreparedAttack { probability: Some(found.probability()), note, ..pushes(attacks, deviation, far) })
}

/// A motion of at most `accel_mps2` that the loop sets against a force that is none; all that measures it has it taken off.
fn covert(
    question: &AttackQuestion,
    lateral: &Lateral,
    set: &[SensorId],
    horizon_s: f64,
) -> Result<PreparedAttack, EnvelopeError> {
    let accel_mps2 = question.accel_mps2.unwrap_or(COVERT_MPS2);
    let bounds = Bounds::default();
    if !accel_mps2.is_finite() || accel_mps2.abs() > bounds.accel_max_mps2 {
        let most = bounds.accel_max_mps2;
        return Err(wrong("accel_mps2", format!("is {accel_mps2}, it must be within ±{most}")));
    }
    let healthy: Vec<String> =
        lateral.sensors.iter().filter(|sensor| !set.contains(sensor)).map(ToString::to_string).collect();
    if !healthy.is_empty() {
        let who = healthy.join(", ");
        return Err(wrong("sensors", format!("leave out {who}: what is not attacked still sees the motion")));
    }
    if let (Aid::Gnss, Some(gnss)) = (lateral.aid, lateral.measuring()) {
        let problem = format!("have {gnss}, whose velocity nothing can be added to: it still sees the motion");
        return Err(wrong("sensors", problem));
    }
    let heard = |size: f64| {
        let (force, place) = (move |_: f64| -size, move |t: f64| -0.5 * size * t * t);
        let one = |sensor: &SensorId| match sensor.kind {
            SensorKind::Imu => Pushed { sensor: *sensor, quantity: Quantity::Force, at: &force },
            _ => Pushed { sensor: *sensor, quantity: Quantity::Place, at: &place },
        };
        Heard::new(lateral, &set.iter().map(one).collect::<Vec<_>>(), horizon_s)
    };
    // The loop overshoots, or takes its time: of what is added it makes so much.
    let unit = heard(1.0);
    let over = unit.accelerated_mps2();
    if over.is_nan() || over <= 0.0 {
        return Err(wrong("sensors", "move nothing along this axis".into()));
    }
    let size = accel_mps2 / over;
    let [tilt_rad, _, far_m] = unit.furthest().map(|of| of * size.abs());
    if tilt_rad > SMALL_RAD {
        let problem =
            format!("is {accel_mps2}, which tilts it by {tilt_rad:.2} rad: beyond small angles nothing is known");
        return Err(wrong("accel_mps2", problem));
    }
    let place = AXES.get(lateral.axis).copied().unwrap_or_default();
    let [force, _] = lateral.channels();
    let one = |sensor: &SensorId| {
        let (kind, channel) = if sensor.kind == SensorKind::Imu { ("bias", force) } else { ("parabola", place) };
        PlannedAttack { channel: channel.to_owned(), ..planned(question, horizon_s, *sensor, kind, -size) }
    };
    let found = heard(size).expected(SEED);
    let note = format!("{size:.3} m/s² are added, of which the loop makes a motion of at most {accel_mps2} m/s².");
    Ok(PreparedAttack {
        probability: Some(found.probability()),
        note,
        ..pushes(set.iter().map(one).collect(), Deviation::Place, far_m)
    })
}

/// Why nothing is expected along the axis of `lateral`.
fn untold(lateral: &Lateral) -> String {
    let axis = AXES.get(lateral.axis).copied().unwrap_or_default();
    let measures = lateral.measuring().map_or_else(|| "nothing".to_owned(), |sensor| format!("{sensor} alone"));
    format!(
        "{measures} measures the motion along {axis}, where rotor drag does most to tell lanes apart, which is not in the model"
    )
}

/// What `attack` adds to along `axis`, 0: x, 1: y.
fn quantity(attack: &PlannedAttack, axis: usize) -> Option<Quantity> {
    let [force, rate] = channels(axis);
    match attack.sensor.as_str() {
        "imu" if attack.channel == force => Some(Quantity::Force),
        "imu" if attack.channel == rate => Some(Quantity::Rate),
        "mocap_pose" | "gnss" if AXES.get(axis) == Some(&attack.channel.as_str()) => Some(Quantity::Place),
        _ => None,
    }
}

/// The axis that all of `attacks` are along, x or y, by name.
pub(super) fn axis_of(attacks: &[PlannedAttack]) -> Option<&'static str> {
    let along = |axis: &usize| !attacks.is_empty() && attacks.iter().all(|attack| quantity(attack, *axis).is_some());
    (0..AXES.len()).find(along).and_then(|axis| AXES.get(axis).copied())
}

/// What is expected of `attacks` along the axis of `lateral`, and what keeps anything from being expected, or from being told.
pub(super) fn judged(lateral: &Lateral, attacks: &[PlannedAttack]) -> (Option<Expected>, String) {
    let (first_s, end_s) = span(attacks);
    let mut of: Vec<(SensorId, Quantity, Adds<'_>)> = Vec::new();
    for attack in attacks {
        let sensor = named(attack).filter(|sensor| lateral.sensors.contains(sensor));
        let (Some(sensor), Some(quantity), Some(adds)) =
            (sensor, quantity(attack, lateral.axis), adds(attack, first_s))
        else {
            return (None, unknown(attack, attacks.len() == 1));
        };
        of.push((sensor, quantity, adds));
    }
    if of.is_empty() {
        return (None, String::new());
    }
    if lateral.aid != Aid::Pose {
        return (None, format!("Nothing is expected: {}.", untold(lateral)));
    }
    if end_s - first_s > LONGEST_S {
        return (None, format!("nothing is expected beyond {LONGEST_S} s"));
    }
    let pushed: Vec<Pushed<'_>> =
        of.iter().map(|(sensor, quantity, at)| Pushed { sensor: *sensor, quantity: *quantity, at }).collect();
    let found = Heard::new(lateral, &pushed, end_s - first_s).expected(SEED);
    let tilt_rad = found.aside[0];
    let far = format!("It would tilt by {tilt_rad:.2} rad: how far it goes is not known beyond small angles.");
    let note = if tilt_rad > SMALL_RAD { far } else { String::new() };
    (Some(found), note)
}
