//! What the model of the lanes expects of the attack of each condition: the part of flights in which the attacked sensor is excluded.
//!
//! `plumbline_analysis::envelope::prepare` is asked what the page asks before an attack flies, about the attack as it is flown:
//! sensor, channel, kind, size, suite, airframe and gains, from the onset until the flight is over. Where the seed draws the
//! sensor, each that is attacked counts by its flights, with the median of the times left to it; the sign changes nothing.
//! Asked once, beside the flights of the plan, and kept in a file of its own: what the model draws takes as long as some flights.
//!
//! It assumes lanes in the loop, a vehicle at rest about hover, and white noise, of accelerometers as it is measured: what is flown otherwise
//! is not known, with the reason. The noise that the lanes measure of their accelerometers is that of one flight without the attack.

use std::collections::BTreeMap;

use plumbline_agent::attack::Attack;
use plumbline_agent::command::Command;
use plumbline_agent::control::tuning::{kind_name, parameters, weighted};
use plumbline_agent::envelope::prepare::prepared;
use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_agent::flight::FlightConfig;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::sensor::SensorModel;
use plumbline_agent::types::{EstimatorKind, Mode};
use plumbline_proto::v1::SensorKind;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::design::Design;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion};
use plumbline_rest::experiment::Expectation;

use crate::draw::median;
use crate::flight::{Setup, fly_watched};
use crate::judge::STEADY_S;
use crate::plan::Plan;
use crate::reception::Reception;
use crate::store::{Experiment, StoreError};

/// Conditions of a plan that are asked about: the first ones.
pub(crate) const CONDITIONS: u64 = 200;
/// Flights of each that are looked at for what their seeds draw.
const FLIGHTS: u64 = 200;
/// Its last command is so long ago, s, when a vehicle hovers.
const SETTLED_S: f64 = 5.0;
/// What the end of an attack leaves behind is judged for so long, s.
const AFTER_S: f64 = 10.0;
const FILE: &str = "expected.json";

/// By the conditions that were asked about; `None` where nothing is attacked.
pub(crate) fn kept(experiment: &Experiment) -> BTreeMap<u64, Option<Expectation>> {
    experiment.read_beside(FILE)
}

/// Asks the model about the conditions that it was not asked about yet, while `go_on` says so, and keeps each answer.
///
/// # Errors
/// [`StoreError::Io`].
pub fn keep(experiment: &Experiment, go_on: impl Fn() -> bool) -> Result<(), StoreError> {
    let mut kept = kept(experiment);
    for number in 0..experiment.plan.conditions().min(CONDITIONS) {
        if kept.contains_key(&number) {
            continue;
        }
        if !go_on() {
            break;
        }
        kept.insert(number, of(&experiment.plan, number));
        experiment.keep_beside(FILE, &kept)?;
    }
    Ok(())
}

/// What is expected of a condition; `None` where nothing is attacked, or it cannot be flown.
fn of(plan: &Plan, number: u64) -> Option<Expectation> {
    let condition = plan.condition(number).ok()?;
    let setups: Vec<_> = (0..plan.repeats.min(FLIGHTS)).map(|repeat| condition.setup(plan.seed_of(repeat))).collect();
    let first = setups.first()?;
    let then = first.recording.as_ref().is_some_and(|recorded| !recorded.attacked.is_empty());
    if first.attacks.is_empty() && !then {
        return None;
    }
    let known = expected(condition.one_attack(), first, &setups);
    Some(known.unwrap_or_else(Expectation::unknown))
}

/// # Errors
/// Why nothing is.
fn expected(words: Option<&[String; 3]>, first: &Setup, setups: &[Setup]) -> Result<Expectation, String> {
    same_as_the_model(first)?;
    let words = words.ok_or("several sensors are attacked, or each flight draws another kind or size")?;
    // Each sensor attacked, and how long each of its flights goes on from the onset, s.
    let mut sensors: Vec<(Attack, Vec<f64>)> = Vec::new();
    for setup in setups {
        for attack in &setup.attacks {
            let judged_s = hovers_s(setup, attack.start_s)?;
            match sensors.iter_mut().find(|(known, _)| known.sensor == attack.sensor) {
                Some((_, all)) => all.push(judged_s),
                None => sensors.push((*attack, vec![judged_s])),
            }
        }
    }
    let [noise_mps2, rectified_mps2] = shaken(first)?.map(Some);
    let of = EnvelopeQuestion { noise_mps2, rectified_mps2, ..question(&first.config) };
    let (mut sum, mut note) = (0.0, String::new());
    for (attack, judged_s) in &sensors {
        let attacks = planned(words, attack, median(judged_s));
        let question = AttackQuestion { of: of.clone(), attacks, ..AttackQuestion::default() };
        let answer = prepared(&question, Some(first.scenario.suite.clone())).map_err(|error| error.to_string())?;
        note = answer.note;
        let Some(probability) = answer.probability else { return Err(note) };
        sum += probability * judged_s.len() as f64;
    }
    Ok(Expectation { probability: Some(sum / setups.len() as f64), note, ..Expectation::default() })
}

/// Does the model know such a vehicle in such a world?
///
/// # Errors
/// Why it does not.
fn same_as_the_model(setup: &Setup) -> Result<(), String> {
    let Setup { scenario, config, .. } = setup;
    let world = match &scenario.conditions {
        Some(conditions) => conditions.world.as_str(),
        None if scenario.ideal => "ideal",
        None => "bench",
    };
    let mut sheets = SensorModel::from(&scenario.suite);
    sheets.imus.mag.declination_rad = config.sensor_model.imus.mag.declination_rad;
    let besides = [SensorKind::Gnss, SensorKind::MocapPose, SensorKind::CameraRanges];
    let beside = config.sensors.iter().find(|sensor| besides.contains(&sensor.kind));
    let airframe = Airframe::by_name(&config.airframe.name);
    let in_loop = config.in_loop.as_str_name().trim_start_matches("ESTIMATOR_KIND_").to_lowercase();
    let plain = |command: &Command| matches!(command, Command::Arm | Command::SetMode(_) | Command::Setpoint(_));
    let unknown = [
        (setup.recording.is_some(), "a recording is flown again: the model knows no flight of then".to_owned()),
        (setup.reception != Reception::All, "what stands before the estimator is not in the model".to_owned()),
        (config.in_loop != EstimatorKind::Lanes, format!("the model has lanes in the loop, not {in_loop}")),
        (
            !["bench", "datasheet"].contains(&world),
            format!("the model has the noise of data sheets, not of the world {world}"),
        ),
        (scenario.disturbance != Default::default(), "the plan's own disturbance is not in the model".to_owned()),
        (sheets != config.sensor_model, "the agent assumes other sensors than those that are flown".to_owned()),
        (beside.is_some(), format!("{} is not in the model", beside.map(ToString::to_string).unwrap_or_default())),
        (!scenario.outages.is_empty(), "a sensor falls silent".to_owned()),
        (!scenario.broken.is_empty(), "a propeller breaks".to_owned()),
        (!config.rig.can_lift(), format!("the model hovers, and {} cannot", config.rig.name())),
        (
            !airframe.is_ok_and(|known| known == config.airframe),
            format!("the airframe {:?} is the plan's own", config.airframe.name),
        ),
        (
            !scenario.script.steps.iter().all(|step| plain(&step.command)),
            "the script does more than arm, and set modes and setpoints".to_owned(),
        ),
    ];
    unknown.into_iter().find(|(is, _)| *is).map_or(Ok(()), |(_, why)| Err(why))
}

/// How long a flight goes on after an onset, s, at rest about hover.
///
/// # Errors
/// What it does instead.
fn hovers_s(setup: &Setup, onset_s: f64) -> Result<f64, String> {
    let script = &setup.scenario.script;
    let ends = |command: &Command| matches!(command, Command::Disarm | Command::SetMode(_));
    let mut after = script.steps.iter().filter(|step| step.at_s > onset_s.max(STEADY_S));
    let end_s = after.find(|step| ends(&step.command)).map_or(setup.scenario.duration_s, |step| step.at_s);
    let from_s = onset_s - SETTLED_S;
    let moves = script.steps.iter().map(|step| (step.at_s, step.at_s));
    let moves = moves.chain(script.trajectories.iter().map(|path| (path.start_s, path.start_s + path.duration_s)));
    let mut moves = moves.chain(script.pushes.iter().map(|push| (push.at_s, push.at_s + push.duration_s)));
    if let Some((at_s, _)) = moves.find(|(begin_s, last_s)| *begin_s < end_s && *last_s > from_s) {
        return Err(format!(
            "the model hovers, and this one is moved at {at_s} s, judged from {onset_s:.1} to {end_s} s"
        ));
    }
    let before = || script.steps.iter().rev().filter(|step| step.at_s <= onset_s);
    let mode = before().find_map(|step| if let Command::SetMode(mode) = step.command { Some(mode) } else { None });
    let height = before().any(|step| matches!(&step.command, Command::Setpoint(to) if to.altitude_m.is_some()));
    if !height || !matches!(mode, Some(Mode::AltitudeHold | Mode::Hold)) {
        return Err("the model hovers, and no altitude is held here before the onset".into());
    }
    Ok(end_s - onset_s)
}

/// What the lanes measure of their accelerometers from the onset on, noise and what they rectify, m/s²: the mean, in a flight of this seed
/// without the attack.
///
/// # Errors
/// Why it cannot be flown.
fn shaken(setup: &Setup) -> Result<[f64; 2], String> {
    let clean = Setup { attacks: Vec::new(), ..setup.clone() };
    let (mut usual, mut count) = ([0.0; 2], 0.0);
    let flown = fly_watched(&clean, |flight, _| {
        let judged = flight.report().sensed.time.as_seconds() >= setup.judged_from_s;
        if let Some(lanes) = flight.lanes().filter(|_| judged) {
            count += 1.0;
            let Shaken { noise_mps2, rectified_mps2 } = lanes.shaken();
            for (usual, now) in usual.iter_mut().zip([noise_mps2, rectified_mps2]) {
                *usual += (now - *usual) / count;
            }
        }
    });
    flown.map_or_else(|error| Err(error.to_string()), |_| Ok(usual))
}

/// The gains as flown, of this airframe at this rate.
fn question(config: &FlightConfig) -> EnvelopeQuestion {
    let FlightConfig { design, airframe, tick_rate_hz, .. } = config;
    let named = parameters(design.kind).iter().map(|parameter| parameter.name.to_owned());
    let weights = weighted(design.kind).then_some(&design.weights);
    let design = Design {
        controller: Some(kind_name(design.kind).to_owned()),
        state_weight: weights.map(|weights| weights.state.to_vec()),
        input_weight: weights.map(|weights| weights.input.to_vec()),
        parameters: named.zip(design.parameters.iter().copied()).collect(),
        airframe: Some(airframe.name.clone()),
        tick_rate_hz: Some(*tick_rate_hz),
        ..Design::default()
    };
    EnvelopeQuestion { design, ..EnvelopeQuestion::default() }
}

/// The attack of a flight that goes on for `judged_s` from its onset.
fn planned([sensor, channel, kind]: &[String; 3], attack: &Attack, judged_s: f64) -> Vec<PlannedAttack> {
    let duration_s = attack.duration_s.min(judged_s);
    let one = PlannedAttack {
        sensor: sensor.clone(),
        instance: attack.sensor.instance.into(),
        channel: channel.clone(),
        kind: kind.clone(),
        duration_s,
        magnitude: attack.magnitude,
        ..PlannedAttack::default()
    };
    // Who is judged until then may be excluded when it ends.
    let left_s = (judged_s - duration_s).min(AFTER_S);
    let nothing = PlannedAttack { start_s: duration_s, duration_s: left_s, magnitude: 0.0, ..one.clone() };
    let after = (attack.kind.is_additive() && left_s > 0.0).then_some(nothing);
    std::iter::once(one).chain(after).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: &str = r#"
name = "expected"
repeats = 2
[scenario]
world = "datasheet"
duration_s = 24
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 1.0 },
]
[agent]
estimators = { in_loop = "lanes" }
[attack]
sensor = "height"
kind = "bias"
magnitude = 0.3
start_s = 15.0
duration_s = 4.0
"#;

    /// What is expected of [`PLAN`] with `from` changed into `to`.
    fn changed(from: &str, to: &str) -> Option<Expectation> {
        assert!(PLAN.contains(from), "{from}");
        let plan = Plan::from_toml(&PLAN.replace(from, to)).unwrap_or_else(|error| panic!("{to}: {error}"));
        of(&plan, 0)
    }

    #[test]
    fn a_large_bias_is_expected_and_what_is_not_attacked_has_no_expectation() {
        let large = changed("", "").unwrap();
        assert_eq!((large.probability, large.note.as_str()), (Some(1.0), ""));
        assert_eq!(changed("kind = \"bias\"", "kind = \"none\""), None);
    }

    #[test]
    fn what_the_model_does_not_know_is_not_made_up() {
        let step = "altitude_m = 1.0 },";
        for (from, to, why) in [
            ("\"lanes\"", "\"ekf_bias\"", "lanes in the loop, not ekf_bias"),
            ("\"datasheet\"", "\"harsh\"", "not of the world harsh"),
            ("\"datasheet\"", "\"ideal\"", "not of the world ideal"),
            (
                "sensor = \"height\"",
                "sensor = \"imu\"\nchannel = \"accel_z\"",
                "nothing is expected of an accelerometer where all rectify 0.",
            ),
            ("repeats = 2", "repeats = 2\nreception = \"median\"", "what stands before the estimator"),
            (
                "[attack]",
                "[[scenario.outage]]\nsensor = \"height\"\ninstance = 2\nstart_s = 3\nduration_s = 1\n[attack]",
                "falls silent",
            ),
            (step, "altitude_m = 1.0 }, { at_s = 17, do = \"setpoint\", altitude_m = 1.3 },", "moved at 17 s"),
            (step, "altitude_m = 1.0 }, { at_s = 6, do = \"estimator\", estimator = \"lanes\" },", "more than arm"),
            ("altitude_hold", "stabilise", "no altitude is held"),
            (
                "duration_s = 24",
                "duration_s = 24\nsuite = { add = [\"mocap_pose\"] }",
                "mocap pose 1 is not in the model",
            ),
            ("kind = \"bias\"", "kind = \"replay\"", "nothing is expected of replay"),
            ("sensor = \"height\"", "sensor = \"barometer\"", "nothing is expected of bias on all of barometer"),
        ] {
            let found = changed(from, to).unwrap();
            assert!(found.probability.is_none() && found.note.contains(why), "{to}: {found:?}");
        }
        let drawn = PLAN.split("kind = \"bias\"").next().map(|head| format!("{head}kind = \"drawn\"\n"));
        let drawn = of(&Plan::from_toml(&drawn.unwrap()).unwrap(), 0).unwrap();
        assert!(drawn.probability.is_none() && drawn.note.contains("draws another kind or size"), "{drawn:?}");
    }

    #[test]
    fn an_attack_that_ends_first_is_judged_on_for_a_while() {
        let condition = Plan::from_toml(PLAN).unwrap().condition(0).unwrap();
        let setup = condition.setup(1);
        assert_eq!(hovers_s(&setup, 15.0), Ok(9.0));
        let words = condition.one_attack().unwrap();
        let spans = |judged_s| {
            let attacks = planned(words, &setup.attacks[0], judged_s);
            attacks.iter().map(|a| (a.start_s, a.duration_s, a.magnitude == 0.0)).collect::<Vec<_>>()
        };
        assert_eq!(spans(9.0), [(0.0, 4.0, false), (4.0, 5.0, true)]);
        assert_eq!(spans(3.0), [(0.0, 3.0, false)]);
        assert_eq!(spans(60.0)[1], (4.0, AFTER_S, true));
    }
}
