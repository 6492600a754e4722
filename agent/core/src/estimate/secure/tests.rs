//! The decoders against the reference windows.

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
    let text = std::fs::read_to_string(crate::shared::shared("reference/sse_windows.json")?).unwrap();
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

/// Three height sensors on a double integrator, one of them attacked: recovered exactly.
#[test]
fn a_minority_attack_without_noise_is_recovered_exactly() {
    let rows = DMatrix::from_fn(10, 2, |t, j| if j == 0 { 1.0 } else { 0.04 * t as f64 });
    let phi = vec![rows.clone(), rows.clone(), rows.clone()];
    let truth = nalgebra::Vector2::new(0.8, -0.3);
    let mut window = Vec::new();
    for sensor in 0..3 {
        for t in 0..10 {
            let attack = if sensor == 1 { 0.5 + 0.3 * (t as f64).sin() } else { 0.0 };
            window.push((rows.row(t) * truth)[0] + attack);
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
    assert!(matches!(Compressed::<2>::new(&[not_finite], Program::L1), Err(SecureError::NotFinite { sample: 2, .. })));
}
