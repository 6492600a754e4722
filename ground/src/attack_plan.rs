//! Attack plans: JSON from the page, checked, and the schedule the agent is sent.
//!
//! The ground checks shape (names, finite numbers, sensors the vehicle has); the agent alone checks
//! bounds and whether attacks are enabled at all, and its answer counts.

use plumbline_proto::limits::MAX_ATTACKS;
use plumbline_proto::v1;
use plumbline_rest::command::{AttackPlan, PlannedAttack};

use crate::names::JsonName;

/// Why a plan is not one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// Nothing in it: aborting is another request.
    #[error("the plan holds no attack; DELETE aborts the running ones")]
    Empty,
    /// Too many attacks.
    #[error("{0} attacks, limit {MAX_ATTACKS}")]
    TooMany(usize),
    /// One attack is wrong.
    #[error("attack {number}: {reason}")]
    Attack {
        /// Which, from 1.
        number: usize,
        /// Why, with the value.
        reason: String,
    },
}

/// Checks the plan against the vehicle's suite (when known) and converts it.
///
/// # Errors
/// [`PlanError`] naming the attack and the value.
pub fn to_schedule(
    plan: &AttackPlan,
    schedule_id: u32,
    suite: Option<&[v1::SensorDescription]>,
) -> Result<v1::AttackSchedule, PlanError> {
    if plan.attacks.is_empty() {
        return Err(PlanError::Empty);
    }
    if plan.attacks.len() > MAX_ATTACKS {
        return Err(PlanError::TooMany(plan.attacks.len()));
    }
    let convert = |(index, planned): (usize, &PlannedAttack)| {
        to_attack(planned, index as u32 + 1, suite).map_err(|reason| PlanError::Attack { number: index + 1, reason })
    };
    let attacks = plan.attacks.iter().enumerate().map(convert).collect::<Result<_, _>>()?;
    let followed = (1..).zip(&plan.attacks).filter_map(|(attack, planned)| {
        let value = planned.sequence.iter().map(|value| *value as f32).collect();
        planned.sequence_period_s.map(|period_s| v1::AttackSequence { attack, period_s, value })
    });
    Ok(v1::AttackSchedule { schedule_id, attacks, sequences: followed.collect() })
}

fn to_attack(planned: &PlannedAttack, id: u32, suite: Option<&[v1::SensorDescription]>) -> Result<v1::Attack, String> {
    let sensor = v1::SensorKind::from_json_name(&planned.sensor)?;
    let kind = v1::AttackKind::from_json_name(&planned.kind)?;
    let channel = v1::AttackChannel::from_json_name(&planned.channel)?;
    if sensor == v1::SensorKind::Unspecified || kind == v1::AttackKind::Unspecified {
        return Err("sensor and kind must be given".into());
    }
    for (name, value) in
        [("start_s", planned.start_s), ("duration_s", planned.duration_s), ("magnitude", planned.magnitude)]
    {
        if !value.is_finite() {
            return Err(format!("{name} is {value}, a finite number is needed"));
        }
    }
    if planned.start_s < 0.0 {
        return Err(format!("start_s is {}, it cannot be in the past", planned.start_s));
    }
    if planned.duration_s <= 0.0 {
        return Err(format!("duration_s is {}, it must be above 0", planned.duration_s));
    }
    if planned.sequence.is_empty() != planned.sequence_period_s.is_none() {
        return Err("sequence and sequence_period_s come together".into());
    }
    if let Some(suite) = suite
        && !suite.iter().any(|s| s.kind == sensor as i32 && s.instance == planned.instance)
    {
        return Err(format!("the vehicle has no {} {}", planned.sensor, planned.instance));
    }
    Ok(v1::Attack {
        id,
        sensor: sensor as i32,
        instance: planned.instance,
        channel: channel as i32,
        kind: kind as i32,
        start_s: planned.start_s,
        duration_s: planned.duration_s,
        magnitude: planned.magnitude,
        seed: planned.seed,
    })
}

/// The JSON of an attack that came back from the agent.
pub fn planned(attack: &v1::Attack) -> PlannedAttack {
    PlannedAttack {
        sensor: v1::SensorKind::json_name_of(attack.sensor),
        instance: attack.instance,
        channel: v1::AttackChannel::json_name_of(attack.channel),
        kind: v1::AttackKind::json_name_of(attack.kind),
        start_s: attack.start_s,
        duration_s: attack.duration_s,
        magnitude: attack.magnitude,
        seed: attack.seed,
        ..PlannedAttack::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: &str = r#"{"attacks":[{"sensor":"height","instance":2,"channel":"all","kind":"bias",
        "start_s":5,"duration_s":10,"magnitude":0.5,"seed":1}]}"#;

    fn suite() -> Vec<v1::SensorDescription> {
        (1..=3)
            .map(|instance| v1::SensorDescription {
                kind: v1::SensorKind::Height as i32,
                instance,
                ..Default::default()
            })
            .collect()
    }

    #[test]
    fn a_plan_becomes_a_schedule_and_comes_back() {
        let plan: AttackPlan = serde_json::from_str(PLAN).unwrap();
        let schedule = to_schedule(&plan, 7, Some(&suite())).unwrap();
        assert_eq!((schedule.schedule_id, schedule.attacks[0].id), (7, 1));
        assert_eq!(planned(&schedule.attacks[0]), plan.attacks[0]);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_value() {
        let good: AttackPlan = serde_json::from_str(PLAN).unwrap();
        let reason = |change: &dyn Fn(&mut PlannedAttack)| {
            let mut plan = good.clone();
            change(&mut plan.attacks[0]);
            to_schedule(&plan, 1, Some(&suite())).unwrap_err().to_string()
        };
        assert!(reason(&|a| a.instance = 9).contains("no height 9"));
        assert!(reason(&|a| a.duration_s = -1.0).contains("-1"));
        assert!(reason(&|a| a.magnitude = f64::NAN).contains("NaN"));
        assert!(reason(&|a| a.kind = "explode".into()).contains("\"explode\""));
        assert_eq!(to_schedule(&AttackPlan::default(), 1, None), Err(PlanError::Empty));
    }
}
