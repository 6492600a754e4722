//! The quadrotor that the configuration describes: a reader for each device, the motors behind their guard or an autopilot.

use std::sync::Arc;

use super::{
    AgentConfig, Chosen, Failure, FlightConfig, FlightTime, FlyArguments, Observed, Scenario, VehicleChoice, Zero,
    in_file, read,
};
use crate::cli::motors;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::sim::rig::{HangingStrings, Rig};
use plumbline_agent::types::Actuation;
use plumbline_devices::autopilot::pose::PoseLine;
use plumbline_devices::autopilot::rates::RatesLine;
use plumbline_devices::driver::Driver;
use plumbline_devices::driver::mavlink::Mavlink;
use plumbline_devices::motors::Motors;
use plumbline_devices::port::PortName;
use plumbline_devices::spec::{self, DriverKind, MotorsSpec};
use plumbline_devices::vehicle::HardwareVehicle;
use plumbline_link::signing;

/// Opens everything; what does not answer yet is waited for by its reader, and keeps the vehicle from arming.
pub(super) fn attached(arguments: &FlyArguments, config: &AgentConfig) -> Result<Chosen, Failure> {
    let file = arguments.config.as_deref().ok_or("--vehicle hardware: needs --config with [[device]] and [motors]")?;
    if arguments.speed != "1" {
        return Err(format!("--speed {}: a vehicle that is there flies at 1", arguments.speed).into());
    }
    if config.device.is_empty() {
        return Err(in_file(file, "no [[device]]: nothing to sense with"));
    }
    let airframe = Airframe::by_name(&config.airframe)?;
    let rig = config.rig.unwrap_or(Rig::HangingStrings(HangingStrings::default()));
    let suite = spec::suite(&config.device)?;
    let tick_rate_hz = config.tick_rate_hz.unwrap_or(200.0);
    let mut flight = FlightConfig { tick_rate_hz, ..FlightConfig::new(airframe.clone(), rig.kind(&airframe), &suite) };
    let zero = Zero::ticking(tick_rate_hz);
    let (mut devices, mut autopilot) = (Vec::new(), None);
    for device in &config.device {
        let driver = match &config.motors {
            Some(motors) if device.driver == DriverKind::Mavlink && motors.port == device.port => {
                let key = motors.signing_key.as_deref().map(signing::read_key).transpose()?;
                let found = Arc::new(motors.autopilot(port(&device.port)?, device.baud(), key.map(|key| key.bytes())));
                autopilot = Some((found.clone(), motors));
                Some(Box::new(Mavlink::new(found, device.rate_hz())) as Box<dyn Driver>)
            }
            _ => device.driver(),
        };
        devices.extend(driver.map(|driver| device.start_with(driver, &zero, config.real_time)).transpose()?);
    }
    let line: Arc<dyn Motors> = match (arguments.vehicle, autopilot) {
        (VehicleChoice::Mavlink, Some((autopilot, motors))) => {
            flight.actuation = motors.actuation();
            match flight.actuation {
                Actuation::Pose => Arc::new(PoseLine::new(autopilot, zero.clone())),
                _ => Arc::new(RatesLine::new(autopilot, airframe.clone(), motors.hover_thrust, motors.rate_loop_s)),
            }
        }
        (VehicleChoice::Mavlink, None) => {
            let wanted = "--vehicle mavlink: needs [motors] and a [[device]], both driver = \"mavlink\" on one port";
            return Err(in_file(file, wanted));
        }
        _ if config.motors.as_ref().is_some_and(MotorsSpec::is_autopilot) => {
            return Err(in_file(file, "[motors] are an autopilot's: --vehicle mavlink flies it"));
        }
        _ => Arc::new(motors::guarded(file, config)?),
    };
    // The same script as in the simulator, where one is asked for: its commands only.
    let scenario = match &arguments.scenario {
        Some(path) if arguments.script => Some(Scenario::from_toml(&read(path)?).map_err(|e| in_file(path, e))?),
        _ => None,
    };
    Ok(Chosen {
        vehicle: Box::new(HardwareVehicle::new(devices, line, zero.clone())),
        sensors: suite.descriptions(),
        strings: rig.lines(&airframe),
        promise: Some(Observed::promise_at_hover(&suite, &airframe)),
        flight,
        kind: if arguments.vehicle == VehicleChoice::Mavlink { "mavlink" } else { "hardware" },
        rig: rig.name().to_owned(),
        scenario: String::new(),
        seed: 0,
        source_file: String::new(),
        end: scenario.as_ref().map(|scenario| FlightTime::from_seconds(scenario.duration_s)),
        script: scenario.map(|scenario| scenario.script),
        attacks: None,
        zero: Some(zero),
    })
}

fn port(name: &str) -> Result<PortName, Failure> {
    Ok(PortName::parse(name).ok_or_else(|| format!("{name:?} is no port"))?)
}
