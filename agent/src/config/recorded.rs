//! How a recording is flown again: its airframe, sensors and rate, as far as it says.

use arrayvec::ArrayVec;
use plumbline_proto::v1::SensorKind;

use crate::flight::{FlightConfig, RigKind};
use crate::model::airframe::{Airframe, AirframeError};
use crate::recordings::RecordingInfo;
use crate::sensor::MAX_SENSORS;
use crate::sensor::suite::{Description, Suite};
use crate::sim::Scenario;
use crate::sim::scenario::ScenarioError;
use crate::types::TICK_RATE_HZ;

/// Why a recording cannot be flown again.
#[derive(Debug, thiserror::Error)]
pub enum RecordedError {
    /// The scenario in it.
    #[error("its scenario: {0}")]
    Scenario(#[from] ScenarioError),
    /// The airframe that is taken where it names none that is known.
    #[error(transparent)]
    Airframe(#[from] AirframeError),
}

/// What a recording says of its flight.
#[derive(Debug, Clone)]
pub struct RecordedFlight {
    /// As it is flown again; attacks enabled.
    pub flight: FlightConfig,
    /// Scenario of a simulated one: airframe, rig and suite are known by it.
    pub scenario: Option<Scenario>,
    /// Sensors with samples in it.
    pub sensors: ArrayVec<Description, MAX_SENSORS>,
}

impl RecordedFlight {
    /// Of a recording; where it does not say which airframe it is, it is taken as the one called `airframe`.
    ///
    /// # Errors
    /// [`RecordedError`].
    pub fn new(info: &RecordingInfo, airframe: &str) -> Result<Self, RecordedError> {
        let scenario = match &info.scenario {
            Some(text) if !text.is_empty() => Some(Scenario::from_toml(text)?),
            _ => None,
        };
        let mut flight = match &scenario {
            Some(scenario) => scenario.flight_config().with_every_estimator(),
            None => {
                let airframe = airframe_of(info.airframe.as_deref(), airframe)?;
                // Nothing is said of its sensors: the assumptions of `estimate`.
                let assumed = FlightConfig::new(airframe, RigKind::Free, &Suite::empty());
                // Lanes go by the thrust as commanded.
                let imus = info.sensors.iter().filter(|sensor| sensor.id.kind == SensorKind::Imu).count();
                let in_loop = FlightConfig::in_loop_of(if info.has_motors { imus } else { 0 });
                FlightConfig { sensor_model: info.sensor_model(), in_loop, ..assumed }
            }
        };
        flight.attacks.enabled = true;
        flight.sensors = info.sensors.iter().map(|sensor| sensor.id).collect();
        let flown_s = info.span.1.seconds_since(info.span.0);
        if scenario.is_none() && flown_s > 0.0 {
            let rate_hz = (info.ticks as f64 / flown_s).round();
            flight.tick_rate_hz = rate_hz.clamp(*TICK_RATE_HZ.start(), *TICK_RATE_HZ.end());
        }
        let suite = scenario.as_ref().map(|scenario| scenario.suite.descriptions()).unwrap_or_default();
        let sensors = info.sensors.iter().map(|sensor| {
            let known = suite.iter().find(|described| described.id == sensor.id).cloned();
            known.unwrap_or_else(|| Description {
                id: sensor.id,
                name: sensor.id.to_string(),
                rate_hz: sensor.rate_hz,
                // Not part of any of these formats.
                sigma: 0.0,
            })
        });
        let sensors = sensors.collect();
        Ok(Self { flight, scenario, sensors })
    }
}

/// The airframe that a recording names. One that is not known is taken as the configured one, and says so:
/// nothing of a recording is controlled with it.
fn airframe_of(recorded: Option<&str>, configured: &str) -> Result<Airframe, AirframeError> {
    const TAKEN: &str = ", taken as ";
    let recorded = recorded.map(|name| name.split(TAKEN).next().unwrap_or(name));
    if let Some(known) = recorded.and_then(|name| Airframe::by_name(name).ok()) {
        return Ok(known);
    }
    let mut airframe = Airframe::by_name(configured)?;
    airframe.name = format!("{}{TAKEN}{configured}", recorded.unwrap_or("unknown airframe"));
    Ok(airframe)
}
