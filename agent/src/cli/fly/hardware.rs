//! The quadrotor that the configuration describes: a reader for each device, the motors behind their guard.

use super::{
    AgentConfig, Airframe, Calibration, Chosen, Failure, FlightConfig, FlightTime, FlyArguments, Observed, Scenario,
    Zero, in_file, read,
};
use crate::cli::motors;
use plumbline_agent::sim::rig::{HangingStrings, Rig};
use plumbline_agent::types::EstimatorKind;
use plumbline_devices::spec;
use plumbline_devices::vehicle::HardwareVehicle;

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
    if suite.imus.len() > 1 {
        // Each samples on a clock of its own: what shakes the frame differs between them, and an estimator that compares
        // them at one instant takes that for faults.
        flight.in_loop = EstimatorKind::Lanes;
    }
    let line = motors::guarded(file, config)?;
    let zero = Zero::default();
    let mut devices = Vec::new();
    for device in &config.device {
        devices.extend(device.start(&zero)?);
    }
    // The same script as in the simulator, where one is asked for: its commands only.
    let scenario = match &arguments.scenario {
        Some(path) if arguments.script => Some(Scenario::from_toml(&read(path)?).map_err(|e| in_file(path, e))?),
        _ => None,
    };
    Ok(Chosen {
        vehicle: Box::new(HardwareVehicle::new(devices, line, tick_rate_hz)),
        calibration: Calibration::default(),
        sensors: suite.descriptions(),
        strings: rig.lines(&airframe),
        promise: Some(Observed::promise_at_hover(&suite, &airframe)),
        flight,
        kind: "hardware",
        rig: rig.name().to_owned(),
        scenario: String::new(),
        seed: 0,
        source_file: String::new(),
        end: scenario.as_ref().map(|scenario| FlightTime::from_seconds(scenario.duration_s)),
        script: scenario.map(|scenario| scenario.script),
        zero: Some(zero),
    })
}
