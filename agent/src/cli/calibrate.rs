//! `plumbline-agent calibrate KIND`: a calibration from a recording or a table; its summary is the line on stdout.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use plumbline_agent::calibration::Kind;
use plumbline_agent::offline::ArgumentError;
use plumbline_agent::offline::calibrate::{Request, from_path, iso_8601, read, write};
use plumbline_proto::time::WallTime;

use super::Failure;

#[derive(Debug, clap::Args)]
pub struct CalibrateArguments {
    /// accelerometer, gyroscope, magnetometer, thermal, motor-curve, thrust, mass, allan or delays.
    #[arg(value_parser = |name: &str| Kind::by_name(name))]
    kind: Kind,
    /// A recording the agent can read, or a CSV table.
    #[arg(long)]
    input: PathBuf,
    /// plumbline, broad, phantom4, rotorpy, px4-ulog or csv; judged by the content when left out.
    #[arg(long)]
    format: Option<String>,
    /// JSON to write.
    #[arg(long)]
    output: PathBuf,
    /// Which IMU of the recording.
    #[arg(long, default_value_t = 1)]
    imu: usize,
    /// Use the recording from here on, s.
    #[arg(long)]
    from: Option<f64>,
    /// Use it up to here, s.
    #[arg(long)]
    to: Option<f64>,
    /// Use its first half.
    #[arg(long)]
    first_half: bool,
    /// Gravity of the place, m/s².
    #[arg(long)]
    gravity: Option<f64>,
    /// Accelerometer calibration to use for a gyroscope's (JSON).
    #[arg(long)]
    accelerometer: Option<PathBuf>,
    /// Propeller of a table of many, as in "apcsf 10x4.7".
    #[arg(long)]
    propeller: Option<String>,
    /// Air density for a tunnel's coefficients, kg/m³.
    #[arg(long)]
    air_density: Option<f64>,
    /// Date to note in the file, ISO 8601; now when left out.
    #[arg(long)]
    date: Option<String>,
}

impl CalibrateArguments {
    pub fn run(&self) -> Result<(), Failure> {
        let date = match &self.date {
            Some(date) => date.clone(),
            None => iso_8601(WallTime(SystemTime::now().duration_since(UNIX_EPOCH)?.as_micros() as u64)),
        };
        for (name, value) in [("gravity", self.gravity), ("air-density", self.air_density)] {
            if value.is_some_and(|v| !(v.is_finite() && v > 0.0)) {
                return Err(ArgumentError::new(name, value.unwrap_or_default(), "not a number above 0").into());
            }
        }
        let standard = Request::new(self.kind, date);
        let request = Request {
            imu: self.imu,
            from_s: self.from,
            to_s: self.to,
            first_half: self.first_half,
            gravity_mps2: self.gravity.unwrap_or(standard.gravity_mps2),
            accelerometer: self.accelerometer.as_deref().map(read).transpose()?,
            propeller: self.propeller.clone(),
            air_density_kgpm3: self.air_density.unwrap_or(standard.air_density_kgpm3),
            ..standard
        };
        let file = from_path(&self.input, self.format.as_deref(), &request)?;
        write(&self.output, &file)?;
        Ok(writeln!(std::io::stdout(), "{}", file.summary())?)
    }
}
