//! Secure state estimation: the state recovered although some sensors are attacked ([Clinic] 3).
//!
//! The decoder of Fawzi, Tabuada and Diggavi: over a window of T samples, with Y the outputs of each
//! sensor after the forced response is removed,
//!
//! x̂ = argmin over x of Σᵢ ‖Yᵢ − Φᵢ x‖₂   (ℓ1/ℓ2, [Clinic] Eq. 19) or Σᵢ ‖Yᵢ − Φᵢ x‖₁ (ℓ1/ℓ1).
//!
//! | symbol | meaning | shape |
//! |---|---|---|
//! | x | state at the window's anchor | N |
//! | Yᵢ | whitened outputs of sensor i | T |
//! | Φᵢ | whitened observability rows of sensor i | T × N |
//!
//! Before flight: [`suite`] says what the sensors can promise. In flight: [`flying`] is the estimator `secure`; [`window`] holds the last T slots, [`identify`] finds the
//! attacked set with what [`inertial`] and `together.rs` tell of the IMUs, [`gated`] is the filter on what is clean, which goes through its last moments again when a liar is found.
//!
//! [`compress`] makes the problem small without changing it, [`newton`] solves it with a certificate,
//! [`conic`] solves the same programs with Clarabel, as reference and audit; [`offline`] decodes
//! windows from a file.

pub mod compress;
pub mod conic;
pub mod flying;
pub mod gated;
pub mod identify;
pub mod inertial;
pub mod newton;
pub mod offline;
mod rewind;
pub mod suite;
mod together;
pub mod window;

use std::fmt;

pub use plumbline_proto::v1::Decoder;

/// Which norm is taken over one sensor's window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// ℓ1/ℓ2: the 2-norm over time, one term per sensor.
    L2,
    /// ℓ1/ℓ1: the 1-norm over time, one term per sample.
    L1,
}

/// Program of `decoder`, and whether position and orientation are split in it.
pub(super) fn parts(decoder: Decoder) -> (Program, bool) {
    match decoder {
        Decoder::Unspecified | Decoder::L2 => (Program::L2, false),
        Decoder::L1 => (Program::L1, false),
        Decoder::L2Split => (Program::L2, true),
        Decoder::L1Split => (Program::L1, true),
    }
}

/// How a solve ended. Not an error: the iterate is always usable with its certified gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The gap is within tolerance.
    Solved,
    /// The iteration limit came first.
    MaxIterations,
    /// The deadline came first.
    MaxTime,
    /// No further decrease in double precision.
    Stalled,
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Status::Solved => "solved",
            Status::MaxIterations => "max_iterations",
            Status::MaxTime => "max_time",
            Status::Stalled => "stalled",
        })
    }
}

/// A decoded window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoded<const N: usize> {
    /// Minimiser found.
    pub x: nalgebra::SVector<f64, N>,
    /// Objective there.
    pub objective: f64,
    /// Certified: no x has an objective below this (up to rounding).
    pub lower_bound: f64,
    /// Iterations used.
    pub iterations: u32,
    /// How it ended.
    pub status: Status,
}

impl<const N: usize> Decoded<N> {
    /// (objective − lower bound) / objective, 0 for a zero objective. Certifies optimality, not truth.
    pub fn relative_gap(&self) -> f64 {
        if self.objective > 0.0 { (self.objective - self.lower_bound).max(0.0) / self.objective } else { 0.0 }
    }
}

/// Why a suite or a window cannot be decoded.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SecureError {
    /// A matrix or window has the wrong shape.
    #[error("{what} has {found} entries, {expected} are needed")]
    Shape {
        /// Which.
        what: String,
        /// Size found.
        found: usize,
        /// Size needed.
        expected: usize,
    },
    /// A number that is NaN or infinite.
    #[error("sensor {sensor}, sample {sample}: {value} is not finite")]
    NotFinite {
        /// Sensor, from 0.
        sensor: usize,
        /// Sample in the window, from 0.
        sample: usize,
        /// The value.
        value: f64,
    },
    /// The rows of all sensors together do not determine the state.
    #[error("the suite does not observe the state: smallest pivot {pivot:.3e} against {largest:.3e}, state {state}")]
    Unobservable {
        /// Smallest pivot of ΣΦᵢᵀΦᵢ.
        pivot: f64,
        /// Largest diagonal.
        largest: f64,
        /// Index of the state at that pivot.
        state: usize,
    },
    /// The QR factorisation does not reproduce its matrix.
    #[error("sensor {sensor}: QR reproduces its rows to {error:.1e} only")]
    Factorisation {
        /// Sensor, from 0.
        sensor: usize,
        /// Relative error.
        error: f64,
    },
    /// A window with too few slots, or with too many.
    #[error("a window of {slots} slots: {least} to {most} are possible")]
    Slots {
        /// Asked for.
        slots: usize,
        /// Least.
        least: usize,
        /// Most.
        most: usize,
    },
    /// The transition over one slot has no inverse.
    #[error("the model's transition has no inverse: a window cannot be anchored at its end")]
    Transition,
    /// A row without (finite, positive) noise cannot be whitened.
    #[error("row {row}: whitening is singular with a sigma of {sigma}")]
    Whitening {
        /// Row, from 0.
        row: usize,
        /// Its sigma.
        sigma: f64,
    },
    /// The conic solver gave up.
    #[error("Clarabel: {0}")]
    Conic(String),
}

#[cfg(test)]
mod tests {
    use super::{compress::Compressed, conic::Conic, newton::Newton, newton::Settings, *};
    use nalgebra::DMatrix;

    #[derive(serde::Deserialize)]
    struct Reference {
        #[serde(rename = "Phi")]
        phi: Vec<Vec<Vec<f64>>>,
        cases: Vec<Case>,
    }

    #[derive(serde::Deserialize)]
    struct Case {
        #[serde(rename = "Y")]
        y: Vec<Vec<f64>>,
        l2_objective: f64,
        l1_objective: f64,
    }

    /// Φ, and for each case its window with the ℓ1/ℓ2 and the ℓ1/ℓ1 objective.
    type Cases = (Vec<DMatrix<f64>>, Vec<(Vec<f64>, f64, f64)>);

    fn reference() -> Option<Cases> {
        let root = std::env::var_os("PLUMBLINE_DATA").map_or_else(
            || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
            std::path::PathBuf::from,
        );
        let path = root.join("reference/sse_windows.json");
        let Ok(text) = std::fs::read_to_string(&path) else {
            println!("skipped: {} is absent", path.display());
            return None;
        };
        let reference: Reference = serde_json::from_str(&text).unwrap();
        let phi = reference.phi.iter().map(|rows| DMatrix::from_fn(rows.len(), 10, |i, j| rows[i][j])).collect();
        let cases = reference.cases.into_iter().map(|c| (c.y.concat(), c.l2_objective, c.l1_objective)).collect();
        Some((phi, cases))
    }

    #[test]
    fn l2_windows_reach_the_reference_with_a_true_certificate() {
        let Some((phi, cases)) = reference() else { return };
        let problem = Compressed::<10>::new(&phi, Program::L2).unwrap();
        println!("{} terms, {} rows", problem.terms(), problem.rows());
        let mut newton = Newton::new(&problem, Settings::default());
        for (index, (window, l2, _)) in cases.iter().enumerate() {
            let got = newton.decode(&problem, window, None).unwrap();
            println!("case {index}: {} iterations, gap {:.1e}", got.iterations, got.relative_gap());
            assert_eq!(got.status, Status::Solved, "case {index}: {got:?}");
            assert!((got.objective / l2 - 1.0).abs() <= 1e-7, "case {index}: {} against {l2}", got.objective);
            assert!(got.relative_gap() <= 1e-6);
            // Bound ≤ reference ≤ value, up to the rounding of either side.
            assert!(got.lower_bound <= l2 * (1.0 + 1e-12) && *l2 <= got.objective * (1.0 + 1e-12), "case {index}");
        }
    }

    #[test]
    fn l1_windows_reach_the_reference() {
        let Some((phi, cases)) = reference() else { return };
        let problem = Compressed::<10>::new(&phi, Program::L1).unwrap();
        let mut newton = Newton::new(&problem, Settings::default());
        let mut conic = Conic::new(&problem).unwrap();
        for (index, (window, _, l1)) in cases.iter().enumerate() {
            let got = newton.decode(&problem, window, None).unwrap();
            println!("case {index}: {} iterations, gap {:.1e} {}", got.iterations, got.relative_gap(), got.status);
            assert!((got.objective / l1 - 1.0).abs() <= 1e-6, "case {index}: {} against {l1}", got.objective);
            assert!(got.relative_gap() <= 1e-6, "case {index}");
            let audit = conic.decode(&problem, window).unwrap();
            assert!((audit.objective / l1 - 1.0).abs() <= 1e-6, "case {index}: Clarabel {}", audit.objective);
        }
    }

    #[test]
    fn clarabel_agrees_on_the_same_cones() {
        let Some((phi, cases)) = reference() else { return };
        let problem = Compressed::<10>::new(&phi, Program::L2).unwrap();
        let mut conic = Conic::new(&problem).unwrap();
        for (window, l2, _) in &cases {
            let got = conic.decode(&problem, window).unwrap();
            assert!((got.objective / l2 - 1.0).abs() <= 1e-7, "{} against {l2}", got.objective);
        }
    }

    /// Three height sensors on a double integrator, one of them lying: recovered exactly.
    #[test]
    fn a_minority_attack_without_noise_is_recovered_exactly() {
        let rows = DMatrix::from_fn(10, 2, |t, j| if j == 0 { 1.0 } else { 0.04 * t as f64 });
        let phi = vec![rows.clone(), rows.clone(), rows.clone()];
        let truth = nalgebra::Vector2::new(0.8, -0.3);
        let mut window = Vec::new();
        for sensor in 0..3 {
            for t in 0..10 {
                let lie = if sensor == 1 { 0.5 + 0.3 * (t as f64).sin() } else { 0.0 };
                window.push((rows.row(t) * truth)[0] + lie);
            }
        }
        for program in [Program::L2, Program::L1] {
            let problem = Compressed::<2>::new(&phi, program).unwrap();
            let mut newton = Newton::new(&problem, Settings::default());
            let got = newton.decode(&problem, &window, None).unwrap();
            assert_eq!(got.status, Status::Solved, "{got:?}");
            assert!((got.x - truth).norm() < 1e-6, "{program:?}: {got:?}");
        }
        // Nothing attacked, nothing noisy: the objective is zero and the solver still stops.
        let clean: Vec<f64> = (0..3).flat_map(|_| (0..10).map(|t| (rows.row(t) * truth)[0])).collect();
        let problem = Compressed::<2>::new(&phi, Program::L2).unwrap();
        let got = Newton::new(&problem, Settings::default()).decode(&problem, &clean, None).unwrap();
        assert!(got.objective < 1e-8 && (got.x - truth).norm() < 1e-8, "{got:?}");
    }

    #[test]
    fn bad_input_is_named() {
        let good = DMatrix::from_fn(10, 2, |t, j| if j == 0 { 1.0 } else { t as f64 });
        let blind = DMatrix::from_fn(10, 2, |_, j| if j == 0 { 1.0 } else { 0.0 });
        let error = Compressed::<2>::new(&[blind], Program::L2).unwrap_err().to_string();
        assert!(error.contains("state 1"), "{error}");
        let problem = Compressed::<2>::new(std::slice::from_ref(&good), Program::L2).unwrap();
        let mut newton = Newton::new(&problem, Settings::default());
        let error = newton.decode(&problem, &[0.0; 7], None).unwrap_err().to_string();
        assert_eq!(error, "the window has 7 entries, 10 are needed");
        let mut window = [0.0; 10];
        window[3] = f64::NAN;
        let error = newton.decode(&problem, &window, None).unwrap_err().to_string();
        assert_eq!(error, "sensor 0, sample 3: NaN is not finite");
        let mut not_finite = good;
        not_finite[(2, 1)] = f64::INFINITY;
        assert!(matches!(
            Compressed::<2>::new(&[not_finite], Program::L1),
            Err(SecureError::NotFinite { sample: 2, .. })
        ));
    }
}
