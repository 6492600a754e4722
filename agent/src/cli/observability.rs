//! `plumbline-agent observability`: what a suite promises before it flies, as one JSON document.

use std::io::Write as _;
use std::path::Path;

use plumbline_agent::estimate::secure::suite::{NAMES, Observed, STATES};
use plumbline_agent::estimate::secure::{SLOT_S, SLOTS};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::trim::Trim;
use plumbline_agent::offline::ArgumentError;
use plumbline_agent::sensor::suite::{PRESETS, Suite};
use plumbline_proto::v1::SensorKind;
use serde_json::json;

use super::{Failure, in_file, read};

/// Sampling phases shown: the default rig's rates repeat after five slots.
const PHASES: usize = 5;

/// Which suite, and where it flies.
#[derive(Debug, clap::Args)]
pub struct ObservabilityArguments {
    /// default (the string rig), clinic (38 rows of [Clinic] Eq. 18), clinic-3 (with a third laser), another
    /// preset of the simulator, or a TOML file with the sensors.
    #[arg(long, default_value = "default")]
    suite: String,
    /// Airframe; that of [Clinic] for its suites, iris otherwise.
    #[arg(long)]
    airframe: Option<String>,
    /// hover, straight:SPEED (m/s) or circle:RADIUS,SPEED (m, m/s).
    #[arg(long, default_value = "hover")]
    trim: String,
    /// Slots of the window.
    #[arg(long, default_value_t = SLOTS)]
    slots: usize,
}

impl ObservabilityArguments {
    /// Prints the report; an unobservable suite is an error that names the states.
    pub fn run(&self) -> Result<(), Failure> {
        let clinic = ["clinic", "clinic-3"].contains(&self.suite.as_str());
        let name = self.airframe.as_deref().unwrap_or(if clinic { "clinic" } else { "iris" });
        let airframe = Airframe::by_name(name)?;
        let trim = trim(&self.trim, &airframe)?;
        let observed = match self.suite.as_str() {
            "clinic" => Observed::clinic(2, &airframe, &trim),
            "clinic-3" => Observed::clinic(3, &airframe, &trim),
            other => Observed::of(&suite(other)?, &airframe, &trim),
        };
        let promise = observed.promise()?;
        let scalars: Vec<_> = observed
            .scalars
            .iter()
            .map(|s| {
                json!({ "sensor": kind_name(s.kind),
                    "instance": s.instance, "measures": s.name, "row": s.c.as_slice(), "sigma": s.sigma,
                    "rate_hz": s.timing.rate_hz })
            })
            .collect();
        let kinds: Vec<_> = promise
            .kinds
            .iter()
            .map(|(kind, count, correctable)| {
                json!({ "sensor": kind_name(*kind),
                    "rows": count, "correctable": correctable })
            })
            .collect();
        let states: Vec<_> = (0..STATES)
            .map(|j| {
                let lost = promise.to_lose[j];
                json!({ "state": NAMES[j], "rows_to_lose_it": lost, "correctable": lost.saturating_sub(1) / 2 })
            })
            .collect();
        let phases: Vec<Vec<String>> = observed
            .phases(self.slots, SLOT_S, PHASES)
            .iter()
            .map(|masks| masks.iter().map(|m| format!("{m:0width$b}", width = self.slots.clamp(1, 128))).collect())
            .collect();
        let report = json!({
            "suite": self.suite, "airframe": airframe.name, "trim": self.trim, "rows": scalars.len(),
            "rank": promise.rank, "states": states, "sparse_observable": promise.sparse,
            "correctable_attacks": promise.correctable, "binding_state": NAMES[promise.binding],
            "per_type": kinds, "scalars": scalars,
            "window": { "slots": self.slots, "slot_s": SLOT_S, "filled_slots_by_phase": phases },
        });
        Ok(writeln!(std::io::stdout(), "{report:#}")?)
    }
}

/// A kind by its name in scenarios: `mocap_pose`.
fn kind_name(kind: SensorKind) -> String {
    kind.as_str_name().trim_start_matches("SENSOR_KIND_").to_lowercase()
}

fn suite(name: &str) -> Result<Suite, Failure> {
    let name = if name == "default" { "string_rig" } else { name };
    if let Some(suite) = Suite::preset(name) {
        return Ok(suite);
    }
    let path = Path::new(name);
    if !path.is_file() {
        let reason = format!("neither a file nor one of default, clinic, clinic-3, {}", PRESETS.join(", "));
        return Err(ArgumentError::new("suite", name, reason).into());
    }
    let suite: Suite = toml::from_str(&read(path)?).map_err(|e| in_file(path, e))?;
    // The fastest loop there is: rates are judged when the suite flies.
    suite.validate(1000.0)?;
    Ok(suite)
}

fn trim(text: &str, airframe: &Airframe) -> Result<Trim, ArgumentError> {
    let bad = |reason: String| ArgumentError::new("trim", text, reason);
    let (what, values) = text.split_once(':').unwrap_or((text, ""));
    let numbers: Vec<f64> = values
        .split(',')
        .filter(|v| !v.is_empty())
        .map(|v| v.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0))
        .collect::<Option<_>>()
        .ok_or_else(|| bad(format!("{values} is not a list of positive numbers")))?;
    match (what, numbers.as_slice()) {
        ("hover", []) => Ok(Trim::hover(airframe)),
        ("straight", [speed]) => Ok(Trim::straight(airframe, nalgebra::Vector3::new(*speed, 0.0, 0.0))),
        ("circle", [radius, speed]) => Ok(Trim::circle(airframe, *radius, *speed)),
        _ => Err(bad("not hover, straight:SPEED or circle:RADIUS,SPEED".to_owned())),
    }
}
