//! The simulator, flown by a stock autopilot that speaks its own protocol for simulators.

use std::sync::Arc;
use std::time::Duration;

use super::{Chosen, Failure, FlightTime, FlyArguments, Pace, Schedule, Stop, VehicleChoice, scenario};
use plumbline_hil::{Line, Patience, PilotedVehicle, ardupilot, px4};

/// Longest and shortest wait for an answer that can be asked for, s.
const ANSWER_S: std::ops::RangeInclusive<f64> = 0.1..=3600.0;

/// Waits for the autopilot, once everything else about the flight is known to be right.
pub(super) fn piloted(
    arguments: &FlyArguments,
    schedule: Option<&Schedule>,
    pace: Pace,
    stop: &Arc<Stop>,
) -> Result<Chosen, Failure> {
    let scenario = scenario(arguments)?;
    let attacks = schedule.unwrap_or(&scenario.attacks).clone();
    if pace == Pace::Stepped {
        return Err("--speed 0: only a recording begins standing still".into());
    }
    if !ANSWER_S.contains(&arguments.answer_s) {
        let (least, most) = (ANSWER_S.start(), ANSWER_S.end());
        return Err(format!("--answer-s {} is not {least} to {most}", arguments.answer_s).into());
    }
    let asked = stop.clone();
    let patience = Patience {
        answer: Duration::from_secs_f64(arguments.answer_s),
        // At full speed nobody but the autopilot keeps the pace.
        unstepped: if pace == Pace::Free { Duration::from_secs_f64(scenario.tick_s()) } else { Duration::ZERO },
        asked_to_end: Arc::new(move || asked.asked() > 0),
    };
    let by_ardupilot = arguments.vehicle == VehicleChoice::Ardupilot;
    let reaches = if by_ardupilot { ardupilot::reaches } else { px4::reaches };
    if let Some(attack) = attacks.attacks.iter().find(|attack| !reaches(&scenario.suite, attack.sensor)) {
        let name = if by_ardupilot { "ArduPilot" } else { "PX4" };
        return Err(format!("attack {}: {} has no way to {name}", attack.id, attack.sensor).into());
    }
    let (line, kind): (Box<dyn Line>, _) = if by_ardupilot {
        let listener = ardupilot::Listener::bind(arguments.listen.unwrap_or(ardupilot::ADDRESS), &scenario)?;
        tracing::info!("waiting for ArduPilot's servo packets on udp {}", listener.address());
        (Box::new(listener.accept(patience)?), "ardupilot")
    } else {
        let listener = px4::Listener::bind(arguments.listen.unwrap_or(px4::ADDRESS), &scenario)?;
        tracing::info!("waiting for PX4 to connect to tcp {}", listener.address());
        (Box::new(listener.accept(patience)?), "px4")
    };
    let vehicle = PilotedVehicle::new(&scenario, line)?;
    tracing::info!(autopilot = kind, scenario = scenario.name, "an autopilot flies");
    Ok(Chosen {
        kind,
        attacks: Some(attacks).filter(|attacks| !attacks.attacks.is_empty()),
        end: arguments.script.then(|| FlightTime::from_seconds(scenario.duration_s)),
        ..Chosen::simulated(&scenario, Box::new(vehicle))
    })
}
