//! `plumbline-agent envelope`: how far an attacker who is not seen can push the vehicle.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use plumbline_agent::design::file;
use plumbline_agent::envelope::sets::Asked;
use plumbline_agent::offline::ArgumentError;
use plumbline_agent::sensor::suite::{PRESETS, Suite};
use plumbline_rest::design::Design;
use plumbline_rest::envelope::{EnvelopeQuestion, EnvelopeSet, Swing};

use super::{Failure, in_file, read};

/// Bounds what every set of attacked sensors can do to the altitude, or along x or y, while every detector is silent: a table, or one
/// JSON line for each set. Bounds are proved by the multipliers of a linear program about hover; "unbounded" by a drift that
/// stays silent for ever.
#[derive(Debug, clap::Args)]
pub struct EnvelopeArguments {
    /// default (the string rig), another preset of the simulator, or a TOML file with the sensors.
    #[arg(long, default_value = "default")]
    suite: String,
    /// Gains or a design (JSON), as `design` writes and reads them; defaults of the LQR with integrals without it.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// Airframe; that of the gains, or iris.
    #[arg(long)]
    airframe: Option<String>,
    /// All sets of at most so many sensors.
    #[arg(long, default_value_t = 2)]
    most: usize,
    /// Only this set: "height 1,imu 2".
    #[arg(long, value_delimiter = ',')]
    sensors: Option<Vec<String>>,
    /// Sensors that are excluded: neither used nor attacked.
    #[arg(long, value_delimiter = ',')]
    without: Vec<String>,
    /// z (the altitude), or x or y: tilt, velocity and, with GNSS or motion capture, position along it.
    #[arg(long)]
    axis: Option<String>,
    /// One sensor more of this kind: height, imu, gnss or pose.
    #[arg(long)]
    more: Option<String>,
    /// How long the attack lasts, s: 10, or 5 along x or y.
    #[arg(long)]
    horizon_s: Option<f64>,
    /// Noise that the lanes measure of their accelerometers, m/s².
    #[arg(long)]
    noise_mps2: Option<f64>,
    /// What they take all of them to be off by alike as they are shaken, m/s²; along z.
    #[arg(long)]
    rectified_mps2: Option<f64>,
    /// Along a swing along the axis in the place of a hover: amplitude, m, and period, s: "0.3,4".
    #[arg(long, value_name = "M,S", value_parser = swing)]
    swing: Option<Swing>,
    /// Bounds the climb as well.
    #[arg(long)]
    climb: bool,
    /// One JSON line for each set instead of the table.
    #[arg(long)]
    json: bool,
    /// In the JSON line also the maximising sequence, and the multipliers that prove the bound; of one set, --sensors.
    #[arg(long, requires = "json")]
    proof: bool,
}

/// Amplitude, m, and period, s, of "0.3,4".
fn swing(text: &str) -> Result<Swing, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[amplitude_m, period_s]) => Ok(Swing { amplitude_m, period_s }),
        _ => Err(format!("{text:?} is no amplitude, m, and period, s, as in 0.3,4")),
    }
}

impl EnvelopeArguments {
    /// Prints a line for each set as it is solved.
    pub fn run(&self) -> Result<(), Failure> {
        let mut design = match &self.gains {
            Some(path) => file::read(read(path)?.as_bytes()).map_err(|e| in_file(path, e))?,
            None => Design::default(),
        };
        design.airframe = self.airframe.clone().or(design.airframe);
        let (name, suite) = self.suite()?;
        let question = EnvelopeQuestion {
            design,
            suite: Some(name),
            most: Some(self.most),
            sensors: self.sensors.clone(),
            without: self.without.clone(),
            axis: self.axis.clone(),
            more: self.more.clone(),
            horizon_s: self.horizon_s,
            noise_mps2: self.noise_mps2,
            rectified_mps2: self.rectified_mps2,
            swing: self.swing,
            climb: self.climb,
            proof: self.proof,
        };
        let asked = Asked::new(&question, Some(suite))?;
        let mut out = std::io::stdout();
        let row = if asked.lateral.is_some() { aside } else { row };
        if !self.json {
            let [one, two, three] = match asked.lateral {
                Some(_) => ["tilt", "velocity", "position"],
                None => ["at most", "reached", "climb"],
            };
            writeln!(out, "{:<24} {one:>12} {two:>12} {three:>10} {:>9}  holds", "attacked", "solved")?;
        }
        let mut failed = None;
        asked.answer(|set| {
            let line = if self.json { serde_json::to_string(set).map_err(Failure::from) } else { Ok(row(set)) };
            let written = line.and_then(|line| Ok(writeln!(out, "{line}")?));
            failed = written.err();
            failed.is_none()
        })?;
        failed.map_or(Ok(()), Err)
    }

    fn suite(&self) -> Result<(String, Suite), Failure> {
        let name = if self.suite == "default" { "string_rig" } else { &self.suite };
        if let Some(suite) = Suite::preset(name) {
            return Ok((name.to_owned(), suite));
        }
        let path = Path::new(name);
        if !path.is_file() {
            let reason = format!("neither a file nor one of default, {}", PRESETS.join(", "));
            return Err(ArgumentError::new("suite", name, reason).into());
        }
        let suite: Suite = toml::from_str(&read(path)?).map_err(|e| in_file(path, e))?;
        // The fastest loop there is: rates are judged when the suite flies.
        suite.validate(1000.0)?;
        Ok((name.to_owned(), suite))
    }
}

fn row(set: &EnvelopeSet) -> String {
    let cm = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |m| format!("{:.2} cm", 100.0 * m));
    let bound = match (set.altitude_m, set.drift_mps) {
        (None, Some(_)) => "unbounded".to_owned(),
        (bound, _) => cm(bound),
    };
    let holds = match (&set.binding, set.drift_mps) {
        (Some(binding), _) => binding.clone(),
        (None, drift_mps) => format!("nothing: drifts with {:.1} cm/s", 100.0 * drift_mps.unwrap_or_default()),
    };
    let climb = set.climb_mps.map_or_else(|| "-".to_owned(), |mps| format!("{mps:.3} m/s"));
    let (sensors, reached) = (set.sensors.join(", "), cm(set.reached_m));
    format!("{sensors:<24} {bound:>12} {reached:>12} {climb:>10} {:>6.0} ms  {holds}", set.took_ms)
}

fn aside(set: &EnvelopeSet) -> String {
    let of =
        |value: Option<f64>, unit: &str| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3} {unit}"));
    let (tilt, velocity) = (of(set.tilt_rad.map(f64::to_degrees), "°"), of(set.velocity_mps, "m/s"));
    let (sensors, position) = (set.sensors.join(", "), of(set.position_m, "m"));
    let reached = set.reached.map_or_else(String::new, |part| format!("; {part:.2} reached"));
    let holds = set.binding.as_ref().map_or_else(|| "nobody judges them".to_owned(), |held| format!("{held}{reached}"));
    format!("{sensors:<24} {tilt:>12} {velocity:>12} {position:>10} {:>6.0} ms  {holds}", set.took_ms)
}
