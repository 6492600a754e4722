//! A calibration on disk: one JSON file per fit, written by the tools, read by the agent.
//!
//! ```json
//! { "schema": 1, "kind": "magnetometer", "date": "2026-01-31T12:00:00Z", "input": "flight.mcap",
//!   "sensor": 1, "span_s": [0.0, 84.5], "samples": 1109,
//!   "residual": { "value": 1.03, "unit": "µT" },
//!   "parameters": [ { "name": "hard_x", "value": -1.6, "sigma": 0.05, "unit": "µT" } ],
//!   "covariance": [[…]], "notes": ["…"],
//!   "picture": [ { "title": "…", "x": "…", "y": "…", "log": false,
//!                  "series": [ { "name": "…", "line": false, "points": [[x, y]] } ] } ] }
//! ```
//! `covariance` is over `parameters` in their order; `sensor` counts IMUs from 1 and is absent for what is no
//! IMU. The picture is what a page draws of the fit: any number of plots, each with series of points or lines.

use serde::Deserialize;
use serde_json::{Value, json};

use super::CalibrationError;
use super::fit::Fit;

/// Version of the file.
pub const SCHEMA: u32 = 1;
/// Most points of one series: a picture, not the data.
pub const POINTS_MAX: usize = 400;

/// What is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Scale, misalignment and bias of an accelerometer.
    Accelerometer,
    /// The same of a gyroscope, aligned with its accelerometer.
    Gyroscope,
    /// Hard and soft iron.
    Magnetometer,
    /// Drift with temperature.
    Thermal,
    /// Command ─► rotor speed.
    MotorCurve,
    /// Thrust and drag torque over speed squared.
    Thrust,
    /// Mass and inertia.
    Mass,
    /// Noise of an IMU at rest.
    Allan,
    /// How late heights and motion capture are stamped.
    Delays,
}

impl Kind {
    /// Every kind, with its name in files and on the command line.
    pub const ALL: [(&'static str, Self); 9] = [
        ("accelerometer", Self::Accelerometer),
        ("gyroscope", Self::Gyroscope),
        ("magnetometer", Self::Magnetometer),
        ("thermal", Self::Thermal),
        ("motor-curve", Self::MotorCurve),
        ("thrust", Self::Thrust),
        ("mass", Self::Mass),
        ("allan", Self::Allan),
        ("delays", Self::Delays),
    ];

    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, kind)| *kind == self).map_or("unknown", |(name, _)| name)
    }

    /// The kind of that name.
    ///
    /// # Errors
    /// [`CalibrationError::File`] naming it.
    pub fn by_name(name: &str) -> Result<Self, CalibrationError> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|(name, _)| *name).collect();
            CalibrationError::File(format!("kind {name:?} is not one of {}", known.join(", ")))
        })
    }
}

/// One fitted number.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Parameter {
    /// Name within its kind.
    pub name: String,
    /// Value, in `unit`.
    pub value: f64,
    /// One-sigma; absent where nothing is known of it.
    #[serde(default)]
    pub sigma: Option<f64>,
    /// Unit; empty for a pure number.
    pub unit: String,
}

/// Points of one kind in a plot.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Series {
    /// For the legend.
    pub name: String,
    /// Joined by a line?
    pub line: bool,
    /// The points.
    pub points: Vec<[f64; 2]>,
}

impl Series {
    /// A series of at most [`POINTS_MAX`] points, evenly thinned; those that are not finite are left out.
    pub fn new(name: impl Into<String>, line: bool, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let all: Vec<[f64; 2]> = points.into_iter().filter(|p| p.iter().all(|v| v.is_finite())).collect();
        let every = all.len().div_ceil(POINTS_MAX).max(1);
        Self { name: name.into(), line, points: all.into_iter().step_by(every).collect() }
    }
}

/// One plot of a fit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Plot {
    /// Headline.
    pub title: String,
    /// Label of the x axis, with unit.
    pub x: String,
    /// Label of the y axis, with unit.
    pub y: String,
    /// Both axes logarithmic?
    pub log: bool,
    /// What is in it.
    pub series: Vec<Series>,
}

/// A fit as it is kept.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct CalibrationFile {
    /// [`SCHEMA`].
    pub schema: u32,
    /// What is calibrated.
    pub kind: Kind,
    /// When, ISO 8601, given by the caller: the library has no clock.
    pub date: String,
    /// Name of the recording or table it was fitted to.
    pub input: String,
    /// Which IMU, from 1.
    #[serde(default)]
    pub sensor: Option<u8>,
    /// Stretch of the recording used, s.
    #[serde(default)]
    pub span_s: Option<[f64; 2]>,
    /// How many samples (poses, points) the fit rests on.
    pub samples: usize,
    /// Root mean square of what the model leaves.
    pub residual: Residual,
    /// The numbers.
    pub parameters: Vec<Parameter>,
    /// Covariance over `parameters`, row by row; empty where nothing is known.
    pub covariance: Vec<Vec<f64>>,
    /// What a user should know.
    pub notes: Vec<String>,
    /// What to draw.
    #[serde(default)]
    pub picture: Vec<Plot>,
}

/// What the model leaves.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Residual {
    /// Root mean square.
    pub value: f64,
    /// Unit.
    pub unit: String,
}

impl CalibrationFile {
    /// A file of `kind` with nothing in it yet; the caller adds date and input.
    pub fn new(kind: Kind, samples: usize, residual: f64, unit: &str) -> Self {
        Self {
            schema: SCHEMA,
            kind,
            date: String::new(),
            input: String::new(),
            sensor: None,
            span_s: None,
            samples,
            residual: Residual { value: residual, unit: unit.to_owned() },
            parameters: Vec::new(),
            covariance: Vec::new(),
            notes: Vec::new(),
            picture: Vec::new(),
        }
    }

    /// Takes parameters and covariance from `fit`, named in its order.
    #[must_use]
    pub fn with_fit(mut self, fit: &Fit, names: &[(&str, &str)]) -> Self {
        for (i, (name, unit)) in names.iter().enumerate() {
            self.push(name, fit.x[i], Some(fit.sigma(i)), unit);
        }
        let n = names.len();
        self.covariance = (0..n).map(|i| (0..n).map(|j| fit.covariance[(i, j)]).collect()).collect();
        self
    }

    /// Adds one parameter.
    pub fn push(&mut self, name: &str, value: f64, sigma: Option<f64>, unit: &str) {
        self.parameters.push(Parameter { name: name.to_owned(), value, sigma, unit: unit.to_owned() });
    }

    /// The value of the parameter called `name`.
    ///
    /// # Errors
    /// [`CalibrationError::File`] where there is none.
    pub fn value(&self, name: &str) -> Result<f64, CalibrationError> {
        let found = self.parameters.iter().find(|p| p.name == name).map(|p| p.value);
        found.ok_or_else(|| CalibrationError::File(format!("no parameter {name:?} in a {} file", self.kind.name())))
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// [`CalibrationError::File`]: not JSON, another schema, or a number that is not finite.
    pub fn from_json(text: &str) -> Result<Self, CalibrationError> {
        let file: Self = serde_json::from_str(text).map_err(|e| CalibrationError::File(e.to_string()))?;
        if file.schema != SCHEMA {
            return Err(CalibrationError::File(format!("schema {}, this build reads schema {SCHEMA}", file.schema)));
        }
        if let Some(p) = file.parameters.iter().find(|p| !p.value.is_finite()) {
            return Err(CalibrationError::File(format!("{} is {}", p.name, p.value)));
        }
        Ok(file)
    }

    /// The file as JSON. Numbers that are not finite do not pass: they become null and are refused on reading.
    pub fn to_value(&self) -> Value {
        let parameters: Vec<Value> = self
            .parameters
            .iter()
            .map(|p| json!({ "name": p.name, "value": p.value, "sigma": p.sigma, "unit": p.unit }))
            .collect();
        let series = |s: &Series| json!({ "name": s.name, "line": s.line, "points": s.points });
        let picture: Vec<Value> = self
            .picture
            .iter()
            .map(|p| {
                let series: Vec<Value> = p.series.iter().map(series).collect();
                json!({ "title": p.title, "x": p.x, "y": p.y, "log": p.log, "series": series })
            })
            .collect();
        json!({
            "schema": self.schema,
            "kind": self.kind.name(),
            "date": self.date,
            "input": self.input,
            "sensor": self.sensor,
            "span_s": self.span_s,
            "samples": self.samples,
            "residual": { "value": self.residual.value, "unit": self.residual.unit },
            "parameters": parameters,
            "covariance": self.covariance,
            "notes": self.notes,
            "picture": picture,
        })
    }

    /// One line for people's scripts: everything but covariance and picture.
    pub fn summary(&self) -> Value {
        let mut value = self.to_value();
        if let Some(object) = value.as_object_mut() {
            object.remove("covariance");
            object.remove("picture");
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_comes_back_as_it_was_written() {
        let mut file = CalibrationFile::new(Kind::MotorCurve, 8, 1.5, "rad/s");
        file.push("offset", 100.25, Some(0.5), "rad/s");
        file.push("slope", 1000.0, None, "rad/s");
        file.covariance = vec![vec![0.25, 0.0], vec![0.0, 1.0]];
        file.notes.push("a note".into());
        let points = (0..1000).map(|i| [f64::from(i), f64::NAN]).chain([[1.0, 2.0]]);
        let series = vec![Series::new("all", true, points)];
        file.picture.push(Plot { title: "t".into(), x: "x".into(), y: "y".into(), log: true, series });
        let back = CalibrationFile::from_json(&file.to_value().to_string()).unwrap();
        assert_eq!(back, file);
        assert_eq!(back.value("offset").unwrap(), 100.25);
        assert!(back.value("none").unwrap_err().to_string().contains("no parameter \"none\" in a motor-curve file"));
        assert!(file.summary().get("picture").is_none());
    }

    #[test]
    fn what_is_no_such_file_is_refused() {
        let text = |value: Value| CalibrationFile::from_json(&value.to_string()).unwrap_err().to_string();
        let mut good = CalibrationFile::new(Kind::Thrust, 2, 0.0, "N");
        good.push("k", 1.0, None, "N s²");
        let mut other = good.to_value();
        other["schema"] = 9.into();
        assert!(text(other).contains("schema 9"));
        good.parameters[0].value = f64::NAN;
        assert!(text(good.to_value()).contains("null"));
        assert!(text(json!({ "kind": "soup" })).contains("soup") || text(json!({})).contains("schema"));
    }
}
