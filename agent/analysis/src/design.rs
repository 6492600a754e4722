//! Control design on the ground: designs from files, previews, Riccati cases.
//!
//! A Riccati case is an object with `name` and the matrices `A`, `B`, `Q`, `R`, row-major nested lists; a file
//! holds one case or `{"cases": [...]}`. A case that cannot be solved gives a line with `error`; the
//! others are solved all the same.

pub mod file;
pub mod preview;
pub mod response;

use nalgebra::DMatrix;
use plumbline_core::control::gains::GainsError;
use plumbline_core::control::structure::unseen_mode;
use plumbline_core::linalg::{Complex, RiccatiSolution, care, dare};
use serde_json::{Map, Value, json};

/// Which equation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Equation {
    /// Continuous time.
    Care,
    /// Discrete time.
    Dare,
}

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DesignError {
    /// Not JSON.
    #[error("not JSON: {0}")]
    Syntax(#[from] serde_json::Error),
    /// JSON, but no case.
    #[error("expected one case or {{\"cases\": [...]}}, found {0}")]
    NoCases(&'static str),
    /// JSON, but no design.
    #[error("expected an object with a design")]
    NoDesign,
    /// A field of a design is wrong.
    #[error("{name} {problem}")]
    Field {
        /// Where.
        name: String,
        /// What is wrong, with the value.
        problem: String,
    },
    /// Nothing solves it, or a value is out of its range.
    #[error(transparent)]
    Gains(#[from] GainsError),
}

/// Largest dimension accepted: far above any vehicle, far below what would take minutes.
const MAX_DIMENSION: usize = 200;

/// Solves every case of `text`; gives one JSON line each, in order.
///
/// # Errors
/// [`DesignError`] when the text as a whole is not a file of cases.
pub fn solve_cases(equation: Equation, text: &str, mut line: impl FnMut(String)) -> Result<(), DesignError> {
    let root: Value = serde_json::from_str(text)?;
    let cases = match &root {
        Value::Object(object) => match object.get("cases") {
            Some(Value::Array(cases)) => cases.as_slice(),
            Some(_) => return Err(DesignError::NoCases("\"cases\" that is no list")),
            None => std::slice::from_ref(&root),
        },
        Value::Array(cases) => cases.as_slice(),
        _ => return Err(DesignError::NoCases("a plain value")),
    };
    for (index, case) in cases.iter().enumerate() {
        let name = match case.get("name").and_then(Value::as_str) {
            Some(name) => name.to_owned(),
            None => format!("case {index}"),
        };
        let answer = match solve(equation, case) {
            Ok(s) => json!({
                "name": name,
                "P": rows(&s.p),
                "K": rows(&s.k),
                "poles": s.poles.iter().map(|p| [p.re, p.im]).collect::<Vec<_>>(),
                "residual": s.residual,
                "iterations": s.iterations,
            }),
            Err(error) => json!({ "name": name, "error": error }),
        };
        line(answer.to_string());
    }
    Ok(())
}

fn solve(equation: Equation, case: &Value) -> Result<RiccatiSolution, String> {
    let object = case.as_object().ok_or("the case is not an object")?;
    let [a, b, q, r] = [matrix(object, "A")?, matrix(object, "B")?, matrix(object, "Q")?, matrix(object, "R")?];
    let solved = match equation {
        Equation::Care => care(&a, &b, &q, &r),
        Equation::Dare => dare(&a, &b, &q, &r),
    };
    solved.map_err(|error| match immovable(equation, &a, &b) {
        Some(mode) => format!("{error}; A has the mode {:.6} {:+.6}i, which B does not move", mode.re, mode.im),
        None => error.to_string(),
    })
}

/// A mode of A that does not die away and that no input moves: then no gain stabilises.
fn immovable(equation: Equation, a: &DMatrix<f64>, b: &DMatrix<f64>) -> Option<Complex> {
    if !a.is_square() || b.nrows() != a.nrows() {
        return None;
    }
    let lasting = |mode: &Complex| match equation {
        Equation::Care => mode.re >= 0.0,
        Equation::Dare => mode.norm() >= 1.0,
    };
    unseen_mode(&a.transpose(), &b.transpose(), lasting).ok()?
}

fn matrix(object: &Map<String, Value>, key: &str) -> Result<DMatrix<f64>, String> {
    let value = object.get(key).ok_or_else(|| format!("{key} is missing"))?;
    let rows = value.as_array().ok_or_else(|| format!("{key} is not a list of rows"))?;
    let columns = rows.first().and_then(Value::as_array).map_or(0, Vec::len);
    if rows.is_empty() || columns == 0 || rows.len() > MAX_DIMENSION || columns > MAX_DIMENSION {
        return Err(format!("{key} is {} x {columns}, expected 1 to {MAX_DIMENSION} each way", rows.len()));
    }
    let mut out = DMatrix::zeros(rows.len(), columns);
    for (i, row) in rows.iter().enumerate() {
        let row = row.as_array().filter(|r| r.len() == columns);
        let row = row.ok_or_else(|| format!("{key} row {i} does not have {columns} numbers"))?;
        for (j, entry) in row.iter().enumerate() {
            out[(i, j)] = entry.as_f64().ok_or_else(|| format!("{key}[{i}, {j}] is {entry}, not a number"))?;
        }
    }
    Ok(out)
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str) -> Vec<Value> {
        let mut out = Vec::new();
        solve_cases(Equation::Care, text, |l| out.push(serde_json::from_str(&l).unwrap())).unwrap();
        out
    }

    #[test]
    fn good_cases_are_solved_beside_bad_ones() {
        let out = lines(
            r#"{"cases": [
                {"name": "scalar", "A": [[0]], "B": [[1]], "Q": [[4]], "R": [[1]]},
                {"name": "ragged", "A": [[0, 1], [0]], "B": [[1]], "Q": [[4]], "R": [[1]]},
                {"name": "no R", "A": [[0]], "B": [[1]], "Q": [[4]]},
                {"A": [[1]], "B": [[0]], "Q": [[1]], "R": [[1]]}
            ]}"#,
        );
        assert_eq!(out.len(), 4);
        assert!((out[0]["P"][0][0].as_f64().unwrap() - 2.0).abs() < 1e-14);
        assert!((out[0]["poles"][0][0].as_f64().unwrap() + 2.0).abs() < 1e-14);
        assert_eq!(out[1]["error"], "A row 1 does not have 2 numbers");
        assert_eq!(out[2]["error"], "R is missing");
        assert_eq!(out[3]["name"], "case 3");
        let told = out[3]["error"].as_str().unwrap();
        assert!(
            told.contains("CARE") && told.ends_with("A has the mode 1.000000 +0.000000i, which B does not move"),
            "{told}"
        );
    }

    #[test]
    fn one_case_alone_and_files_without_cases() {
        assert_eq!(lines(r#"{"A": [[0]], "B": [[1]], "Q": [[1]], "R": [[1]]}"#).len(), 1);
        assert!(solve_cases(Equation::Dare, "{", |_| ()).is_err());
        assert!(solve_cases(Equation::Dare, "3", |_| ()).unwrap_err().to_string().contains("plain value"));
        assert!(solve_cases(Equation::Dare, r#"{"cases": 3}"#, |_| ()).is_err());
    }
}
