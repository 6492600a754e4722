//! Zero dynamics and covert motions by command, as a schedule has them, and what is expected of them.

use plumbline_core::attack::Bounds;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::types::{GRAVITY_MPS2, ROTORS};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::envelope::{AttackQuestion, PreparedAttack};

use super::EnvelopeError;
use super::commanded::{Commanded, Course, Found};
use super::expected::{Added, Expected, expected};
use super::prepare::{HALVINGS, SEED, STEALTHY, largest_unseen};
use super::sets::{Asked, wrong};

/// All rotors, among the names of those attacked.
const NAME: &str = "rotors";
/// Values of a sequence at most, and how fine: eleven of them fit into the body of a request.
const VALUES: usize = 2000;
const FINE: f64 = 1e5;
/// Acceleration that is commanded where none is asked for, m/s².
const USUAL_MPS2: f64 = 0.02;

/// Are the rotors among `sensors`? Their name is taken off.
///
/// # Errors
/// For a generator that attacks none.
pub(super) fn taken(sensors: &mut Option<Vec<String>>, generator: Option<&str>) -> Result<bool, EnvelopeError> {
    let Some(names) = sensors.as_mut().filter(|names| names.iter().any(|name| name == NAME)) else { return Ok(false) };
    names.retain(|name| name != NAME);
    match generator {
        Some("zero_dynamics" | "covert") => Ok(true),
        _ => Err(wrong("sensors", format!("have {NAME}: only zero_dynamics and covert attack them"))),
    }
}

/// What an attack along the zero dynamics adds, or why there is none.
///
/// # Errors
/// [`EnvelopeError`] naming field and value.
pub(super) fn zero_dynamics(
    question: &AttackQuestion,
    asked: &Asked,
    set: &[SensorId],
    rotors: bool,
) -> Result<PreparedAttack, EnvelopeError> {
    let of = Prepared::new(question, asked, set, rotors)?;
    let (course, zeros) = match of.model.zero_dynamics(asked.horizon_s)? {
        Found::Attack(course, zeros) => (course, zeros),
        Found::None(why) => {
            return Ok(PreparedAttack { note: format!("No attack: {why}."), ..PreparedAttack::default() });
        }
    };
    if !rotors {
        let course = of.largest(&course)?;
        let found = of.expected(&course)?;
        let note = format!("Along the {zeros}. As large as one of twenty flights sees it. ");
        return of.planned(&course, &found, Some(found.altitude_m), note);
    }
    let most = course.most_mps2();
    if most <= 0.0 {
        // No rotor has a part in it.
        return zero_dynamics(question, asked, set, false);
    }
    let course = course.times(of.accel_mps2.abs() / most);
    let (held_s, sensor) = of.model.held()?;
    let onset = sensor.map_or_else(String::new, |sensor| format!(" Its onset must fall on a sample of {sensor}."));
    let note = format!("Along the {zeros}. The thrust is held for {:.0} ms.{onset} ", 1e3 * held_s);
    let found = of.expected(&course)?;
    of.planned(&course, &found, Some(furthest_m(&course)), note)
}

/// A covert motion that the rotors are told to make.
///
/// # Errors
/// [`EnvelopeError`] naming field and value.
pub(super) fn covert(
    question: &AttackQuestion,
    asked: &Asked,
    set: &[SensorId],
) -> Result<PreparedAttack, EnvelopeError> {
    let of = Prepared::new(question, asked, set, true)?;
    let course = of.model.covert(of.accel_mps2, asked.horizon_s);
    let found = of.expected(&course)?;
    // A healthy sensor, and the loop with it, hears of the motion.
    let whole = asked.flying.sensors.iter().all(|sensor| set.contains(sensor));
    let note = if whole {
        "No healthy height or IMU is left: what is received is what it would be. ".to_owned()
    } else {
        "A healthy sensor reads the motion. ".to_owned()
    };
    of.planned(&course, &found, whole.then(|| furthest_m(&course)), note)
}

fn furthest_m(course: &Course) -> f64 {
    course.altitude_m.iter().fold(0.0, |most, z| most.max(z.abs()))
}

/// A question, with what its answer is made of.
struct Prepared<'a> {
    question: &'a AttackQuestion,
    asked: &'a Asked,
    rotors: bool,
    model: Commanded,
    airframe: Airframe,
    accel_mps2: f64,
}

impl<'a> Prepared<'a> {
    fn new(
        question: &'a AttackQuestion,
        asked: &'a Asked,
        set: &[SensorId],
        rotors: bool,
    ) -> Result<Self, EnvelopeError> {
        let airframe = Airframe::by_name(&asked.airframe).map_err(|e| wrong("airframe", e.to_string()))?;
        let tick_s = 1.0 / question.of.design.tick_rate_hz.unwrap_or(200.0);
        let accel_mps2 = question.accel_mps2.unwrap_or(USUAL_MPS2);
        // Neither stopped nor full, and no more than may be added.
        let full_mps2 = airframe.max_thrust_n() / airframe.mass_kg;
        let most = GRAVITY_MPS2.min(full_mps2 - GRAVITY_MPS2).min(Bounds::default().thrust_max * full_mps2);
        if accel_mps2.is_nan() || accel_mps2.abs() > most {
            return Err(wrong("accel_mps2", format!("is {accel_mps2}, it must be within ±{most:.2}")));
        }
        let model = Commanded::new(&asked.flying, &airframe, set, rotors, tick_s)?;
        Ok(Self { question, asked, rotors, model, airframe, accel_mps2 })
    }

    /// What is expected of `course`: every sensor of the loop receives what the motion and the attack make of it.
    fn expected(&self, course: &Course) -> Result<Expected, EnvelopeError> {
        let tick_s = self.model.tick_s;
        let received = |sensor: &SensorId| {
            let values = course.received(*sensor);
            let at = move |t: f64| values.get((t / tick_s + 0.5).max(0.0) as usize).copied().unwrap_or_default();
            (*sensor, at)
        };
        let attacked = |sensor: &&SensorId| self.rotors || course.added.iter().any(|(of, _)| of == *sensor);
        let received: Vec<_> = self.asked.flying.sensors.iter().filter(attacked).map(received).collect();
        let added: Vec<Added<'_>> = received.iter().map(|(sensor, at)| Added { sensor: *sensor, at }).collect();
        expected(&self.asked.flying, &added, course.thrust_mps2.len() as f64 * tick_s, SEED)
    }

    /// As large as at most one of twenty flights sees, and as may be added.
    fn largest(&self, course: &Course) -> Result<Course, EnvelopeError> {
        let bounds = Bounds::default();
        let part = |(sensor, values): &(SensorId, Vec<f64>)| {
            let allowed = if sensor.kind == SensorKind::Imu { bounds.accel_max_mps2 } else { bounds.length_max_m };
            values.iter().fold(0.0, |most: f64, x| most.max(x.abs())) / allowed
        };
        let whole = course.clone().times(1.0 / course.added.iter().map(part).fold(f64::MIN_POSITIVE, f64::max));
        let seen =
            |part: f64| Ok::<_, EnvelopeError>(self.expected(&whole.clone().times(part))?.probability() > STEALTHY);
        let part = largest_unseen(1.0, 2 * HALVINGS, seen)?;
        Ok(whole.times(part))
    }

    /// The schedule of `course`. What is shorter than the horizon ends with it.
    fn planned(
        &self,
        course: &Course,
        found: &Expected,
        altitude_m: Option<f64>,
        note: String,
    ) -> Result<PreparedAttack, EnvelopeError> {
        let tick_s = self.model.tick_s;
        let every = course.thrust_mps2.len().div_ceil(VALUES).max(1);
        let duration_s = course.thrust_mps2.len() as f64 * tick_s;
        let one = |sensor: &str, instance: u32, channel: &str, values: &[f64]| {
            let most = values.iter().fold(1e-9, |most: f64, x| most.max(x.abs()));
            PlannedAttack {
                sensor: sensor.to_owned(),
                instance,
                channel: channel.to_owned(),
                kind: "bias".to_owned(),
                start_s: self.question.start_s + (self.asked.horizon_s - duration_s).max(0.0),
                duration_s,
                magnitude: most,
                seed: 1,
                sequence: values.iter().step_by(every).map(|x| (FINE * x / most).round() / FINE).collect(),
                sequence_period_s: Some(every as f64 * tick_s),
            }
        };
        let sensor = |(sensor, values): &(SensorId, Vec<f64>)| match sensor.kind {
            SensorKind::Imu => one("imu", u32::from(sensor.instance), "accel_z", values),
            _ => one("height", u32::from(sensor.instance), "all", values),
        };
        let mut attacks: Vec<PlannedAttack> = course.added.iter().map(sensor).collect();
        if self.rotors {
            let part = self.airframe.mass_kg / self.airframe.max_thrust_n();
            let thrust: Vec<f64> = course.thrust_mps2.iter().map(|d| part * d).collect();
            attacks
                .extend((1..=ROTORS as u32).map(|instance| one(NAME.trim_end_matches('s'), instance, "all", &thrust)));
        }
        Ok(PreparedAttack {
            attacks,
            probability: Some(found.probability()),
            altitude_m,
            note: note.trim_end().to_owned(),
            ..PreparedAttack::default()
        })
    }
}
