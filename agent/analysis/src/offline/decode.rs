//! Windows from a JSON file, decoded one by one: `plumbline-agent decode`.
//!
//! The file holds `Phi` (one T × N matrix per sensor, nested lists) and `cases`, each with `Y` (one
//! list of T samples per sensor). N may be 1 to 16. One JSON line per case goes to `out`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::DMatrix;
use plumbline_core::estimate::secure::compress::Compressed;
use plumbline_core::estimate::secure::conic::Conic;
use plumbline_core::estimate::secure::newton::{Newton, Settings};
use plumbline_core::estimate::secure::{Decoded, Program, SecureError};

/// Who solves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    /// The specialised primal-dual Newton.
    Newton,
    /// Clarabel on the compressed cones.
    Clarabel,
}

/// Why a file cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The file cannot be read, or the output written.
    #[error("{path}: {source}")]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not the JSON described above.
    #[error("{path}: {source}")]
    Json {
        /// File.
        path: PathBuf,
        /// Cause, with line and column.
        source: serde_json::Error,
    },
    /// Shapes that do not fit.
    #[error("{0}")]
    Shape(String),
    /// The suite cannot be decoded.
    #[error(transparent)]
    Secure(#[from] SecureError),
}

/// A file of windows.
#[derive(Debug, Clone, serde::Deserialize)]
pub struct Windows {
    /// One T × N matrix per sensor.
    #[serde(rename = "Phi")]
    pub phi: Vec<Vec<Vec<f64>>>,
    /// The windows.
    pub cases: Vec<Case>,
}

/// One window.
#[derive(Debug, Clone, serde::Deserialize)]
pub struct Case {
    /// T samples per sensor.
    #[serde(rename = "Y")]
    pub y: Vec<Vec<f64>>,
}

impl Windows {
    /// Reads `input`.
    ///
    /// # Errors
    /// [`DecodeError`] when it cannot be read or is not the JSON described above.
    pub fn read(input: &Path) -> Result<Self, DecodeError> {
        let path = input.to_owned();
        let text = std::fs::read_to_string(input).map_err(|source| DecodeError::Io { path: path.clone(), source })?;
        serde_json::from_str(&text).map_err(|source| DecodeError::Json { path, source })
    }

    /// Φ of every sensor for N states.
    ///
    /// # Errors
    /// [`DecodeError::Shape`] naming the row.
    pub fn matrices<const N: usize>(&self) -> Result<Vec<DMatrix<f64>>, DecodeError> {
        let mut phi = Vec::with_capacity(self.phi.len());
        for (sensor, rows) in self.phi.iter().enumerate() {
            if let Some((t, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != N) {
                let found = row.len();
                return Err(DecodeError::Shape(format!("Phi[{sensor}][{t}] has {found} entries, {N} are needed")));
            }
            phi.push(DMatrix::from_row_iterator(rows.len(), N, rows.iter().flatten().copied()));
        }
        Ok(phi)
    }
}

/// Decodes every case of `input`.
///
/// # Errors
/// [`DecodeError`] for the file as a whole; a case that fails prints a line with `error`.
pub fn run(input: &Path, program: Program, engine: Engine, out: &mut dyn Write) -> Result<(), DecodeError> {
    let windows = Windows::read(input)?;
    let states = windows.phi.first().and_then(|p| p.first()).map_or(0, Vec::len);
    macro_rules! dispatch {
        ($($n:literal)*) => {
            match states {
                $($n => decode::<$n>(&windows, program, engine, out),)*
                _ => Err(DecodeError::Shape(format!("{states} states: Phi needs 1 to 16 columns"))),
            }
        };
    }
    dispatch!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16)
}

fn decode<const N: usize>(
    windows: &Windows,
    program: Program,
    engine: Engine,
    out: &mut dyn Write,
) -> Result<(), DecodeError> {
    let phi = windows.matrices::<N>()?;
    let problem = Compressed::<N>::new(&phi, program)?;
    let mut newton = Newton::new(&problem, Settings::default());
    let mut conic = Conic::new(&problem)?;
    for (case, window) in windows.cases.iter().enumerate() {
        let lengths = windows.phi.iter().map(Vec::len);
        if !window.y.iter().map(Vec::len).eq(lengths.clone()) {
            let found: Vec<_> = window.y.iter().map(Vec::len).collect();
            let needed: Vec<_> = lengths.collect();
            let error = format!("Y has {found:?} samples per sensor, {needed:?} are needed");
            print(out, &serde_json::json!({ "case": case, "error": error }))?;
            continue;
        }
        let samples = window.y.concat();
        let begun = Instant::now();
        let decoded = match engine {
            Engine::Newton => newton.decode(&problem, &samples, None),
            Engine::Clarabel => conic.decode(&problem, &samples),
        };
        let time_us = begun.elapsed().as_secs_f64() * 1e6;
        let line = match decoded {
            Ok(Decoded { x, objective, lower_bound, iterations, status }) => serde_json::json!({
                "case": case, "x": x.as_slice(), "objective": objective, "lower_bound": lower_bound,
                "iterations": iterations, "time_us": time_us, "status": status.to_string(),
            }),
            Err(error) => serde_json::json!({ "case": case, "error": error.to_string() }),
        };
        print(out, &line)?;
    }
    Ok(())
}

fn print(out: &mut dyn Write, line: &serde_json::Value) -> Result<(), DecodeError> {
    writeln!(out, "{line}").map_err(|source| DecodeError::Io { path: "output".into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str, engine: Engine) -> Result<Vec<serde_json::Value>, DecodeError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let mut out = Vec::new();
        run(file.path(), Program::L2, engine, &mut out)?;
        Ok(String::from_utf8(out).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect())
    }

    #[test]
    fn each_case_gets_a_line_whatever_the_others_are() {
        let text = r#"{"Phi": [[[1],[1]],[[1],[1]],[[1],[1]]],
                       "cases": [{"Y": [[1,1],[1,1],[9,9]]}, {"Y": [[1,1],[1]]}]}"#;
        for engine in [Engine::Newton, Engine::Clarabel] {
            let lines = lines(text, engine).unwrap();
            assert!((lines[0]["x"][0].as_f64().unwrap() - 1.0).abs() < 1e-6, "{}", lines[0]);
            assert_eq!(lines[0]["status"], "solved");
            assert_eq!(lines[1]["error"], "Y has [2, 1] samples per sensor, [2, 2, 2] are needed");
        }
    }

    #[test]
    fn files_that_do_not_fit_are_refused_with_the_place() {
        let error = |text| lines(text, Engine::Newton).unwrap_err().to_string();
        assert!(error(r#"{"Phi": [], "cases": []}"#).contains("0 states"));
        assert!(error(r#"{"Phi": [[[1,2],[1]]], "cases": []}"#).contains("Phi[0][1] has 1 entries, 2 are needed"));
        assert!(error("{").contains("line 1 column 1"));
    }
}
