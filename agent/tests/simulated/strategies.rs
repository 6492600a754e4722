//! LQG and H∞ of [Strategies] against the independent references; skipped where those are absent.

use nalgebra::{DMatrix, DVector};
use plumbline_agent::control::hinf::reduction::{balance, residualise_fastest};
use plumbline_agent::control::hinf::strategies::{ChannelWeights, assemble, channel, tracking, whole_plant};
use plumbline_agent::control::hinf::synthesis::central;
use plumbline_agent::control::hinf::weights::{Weight, mixed_sensitivity};
use plumbline_agent::control::lqg::{DEFAULTS, OUTPUTS, Replica};
use plumbline_agent::control::margins::continuous_margins;
use plumbline_agent::control::structure::{
    controllable_rank, detectable, gramian, observable_rank, unobservable_states,
};
use plumbline_agent::estimate::filter::lqe;
use plumbline_agent::linalg::{Complex, eigenvalues, hinf_norm};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::discretize::zero_order_hold;
use plumbline_agent::model::linearize::ix;
use plumbline_agent::model::state_space::StateSpace;
use plumbline_agent::recordings::shared;
use serde_json::Value;

/// Gains, relative to their largest entry.
const GAIN_TOLERANCE: f64 = 1e-8;
/// Step responses; the reference has nine digits.
const STEP_TOLERANCE: f64 = 1e-6;
/// Margins, relative: the reference read them from a grid.
const MARGIN_TOLERANCE: f64 = 1e-3;
/// Smallest γ, relative.
const GAMMA_TOLERANCE: f64 = 1e-6;
/// Norms and Hankel singular values, relative.
const NORM_TOLERANCE: f64 = 1e-5;

fn text(name: &str) -> Option<String> {
    std::fs::read_to_string(shared(&format!("reference/{name}"))?).ok()
}

fn json(name: &str) -> Option<Value> {
    text(name).map(|text| serde_json::from_str(&text).unwrap())
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |r, c| rows[r][c])
}

fn close(what: &str, found: &DMatrix<f64>, expected: &DMatrix<f64>, tolerance: f64) {
    let error = (found - expected).amax() / expected.amax();
    println!("{what}: relative error {error:.1e}");
    assert!(error < tolerance, "{what}: {error:.1e}\nfound {found:.9}expected {expected:.9}");
}

fn near(what: &str, found: f64, expected: f64, tolerance: f64) {
    let error = (found / expected - 1.0).abs();
    println!("{what}: {found:.9} ({error:.1e})");
    assert!(error < tolerance, "{what}: {found} against {expected}");
}

/// Where each channel x, y, z, yaw acts.
const INPUTS: [usize; 4] = [ix::TORQUE_Y, ix::TORQUE_X, ix::THRUST, ix::TORQUE_Z];

#[test]
fn lqg_gains_poles_and_steady_gains_equal_the_reference() {
    let Some(reference) = json("lqg.json") else { return };
    let lqg = Replica::printed(&Airframe::iris()).unwrap();
    close("F", &lqg.f, &matrix(&reference["F"]), GAIN_TOLERANCE);
    close("Fe", &lqg.fe, &matrix(&reference["Fe"]), GAIN_TOLERANCE);
    let c = lqg.plant.c.clone();
    let v = lqg.reference_gain(&c).unwrap();
    close("v", &v, &matrix(&reference["v"]), GAIN_TOLERANCE);
    let literal = lqg.literal_reference_gain(&c).unwrap();
    close("literal v", &literal, &matrix(&reference["v_literal"]), GAIN_TOLERANCE);
    let closed = lqg.closed_loop(Some(&v));
    close("closed loop", &closed.a, &matrix(&reference["Acl"]), GAIN_TOLERANCE);
    close("its input", &closed.b, &matrix(&reference["B_cl_ref"]), GAIN_TOLERANCE);
    let dc = |v| lqg.closed_loop(v).response(Complex::new(0.0, 0.0)).unwrap().map(|z| z.re);
    assert!((dc(Some(&v)) - DMatrix::identity(4, 4)).amax() < 1e-9);
    assert!((dc(None) - DMatrix::identity(4, 4)).amax() < 1e-9);
    close("gain of the literal v", &dc(Some(&literal)), &matrix(&reference["dc_gain_literal_v"]), 1e-8);
}

#[test]
fn lqg_steps_equal_the_reference() {
    let Some(csv) = text("lqg_steps.csv") else { return };
    let lqg = Replica::printed(&Airframe::iris()).unwrap();
    let v = lqg.reference_gain(&lqg.plant.c).unwrap();
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    let dt = rows[1][0];
    for (prefix, gain) in [("ff", Some(&v)), ("err", None)] {
        let closed = lqg.closed_loop(gain);
        let step = zero_order_hold(&closed.a, &closed.b, dt).unwrap();
        for (channel, name) in ["x", "y", "z", "psi"].into_iter().enumerate() {
            let column = header.iter().position(|h| *h == format!("{prefix}_{name}")).unwrap();
            let mut x = DVector::zeros(24);
            let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
            for row in &rows {
                worst = worst.max(((&closed.c * &x)[channel] - row[column]).abs());
                largest = largest.max(row[column].abs());
                x = &step.a * x + step.b.column(channel);
            }
            println!("{prefix}_{name}: {worst:.1e} of {largest:.2}");
            assert!(worst < STEP_TOLERANCE, "{prefix}_{name}: {worst:.1e}");
        }
    }
}

#[test]
fn lqg_margins_equal_the_reference() {
    let Some(reference) = json("lqg.json") else { return };
    let lqg = Replica::printed(&Airframe::iris()).unwrap();
    let (loops, whole) = continuous_margins(&lqg.plant, &lqg.controller()).unwrap();
    near("peak of S at the inputs", whole, reference["Ms_input"].as_f64().unwrap(), MARGIN_TOLERANCE);
    for (name, input) in ["x", "y", "z", "psi"].into_iter().zip(INPUTS) {
        let (found, expected) = (&loops[input], &reference["loop_margins"][name]);
        let degrees = expected["phase_margin_deg"].as_f64().unwrap();
        near(&format!("{name} phase"), found.phase_rad.to_degrees(), degrees, MARGIN_TOLERANCE);
        let delay = expected["delay_margin_s"].as_f64().unwrap();
        near(&format!("{name} delay"), found.delay_s, delay, MARGIN_TOLERANCE);
        near(&format!("{name} peak"), found.peak_sensitivity, expected["Ms"].as_f64().unwrap(), MARGIN_TOLERANCE);
        for factor in expected["gain_margin_factors"].as_array().unwrap() {
            let factor = factor[0].as_f64().unwrap();
            let ours = if factor > 1.0 { found.gain_up } else { found.gain_down };
            near(&format!("{name} gain"), ours, factor, MARGIN_TOLERANCE);
        }
    }
}

#[test]
fn lqg_of_nine_outputs_equals_the_reference_and_forgives_the_lag_it_says() {
    let Some(reference) = json("lqg_outputs_margins.json") else { return };
    let four = whole_plant(&Airframe::iris());
    let plant = StateSpace {
        c: DMatrix::from_fn(9, 12, |r, c| if OUTPUTS[r] == c { 1.0 } else { 0.0 }),
        d: DMatrix::zeros(9, 4),
        ..four
    };
    let [acceleration, turn, position, angle, rate] = DEFAULTS.map(|v| v * v);
    let qe = DMatrix::from_fn(12, 12, |r, c| match r {
        _ if r != c => 0.0,
        ix::VX..=ix::VZ => acceleration,
        ix::P..=ix::R => turn,
        _ => 0.0,
    });
    let re = DMatrix::from_fn(9, 9, |r, c| if r == c { [position, angle, rate][r / 3] } else { 0.0 });
    let l = lqe::continuous(&plant.a, &plant.c, &qe, &re).unwrap().gain;
    for name in ["out9_realistic", "out9_bryson"] {
        let expected = &reference[name];
        close(&format!("{name} L"), &-&l, &matrix(&expected["L"]), GAIN_TOLERANCE);
        let lqg = Replica { plant: plant.clone(), f: matrix(&expected["F"]), fe: -&l };
        let (_, whole) = continuous_margins(&plant, &lqg.controller()).unwrap();
        near(&format!("{name} peak of S"), whole, expected["Ms_input"].as_f64().unwrap(), MARGIN_TOLERANCE);
        // The largest first-order motor lag that is stable, on a grid of 5 ms.
        let limit = expected["max_motor_lag_s"].as_f64().unwrap();
        for (lag, stable) in [(limit, true), (limit + 0.005, false)] {
            let k = lqg.controller();
            let n = 12 + 4 + k.order();
            let mut a = DMatrix::zeros(n, n);
            a.view_mut((0, 0), (12, 12)).copy_from(&plant.a);
            a.view_mut((0, 12), (12, 4)).copy_from(&plant.b);
            for i in 12..16 {
                a[(i, i)] = -1.0 / lag;
            }
            a.view_mut((12, 16), (4, k.order())).copy_from(&(&k.c / lag));
            a.view_mut((16, 0), (k.order(), 12)).copy_from(&(&k.b * &plant.c));
            a.view_mut((16, 16), (k.order(), k.order())).copy_from(&k.a);
            // The estimator knows what was asked for, not what the motors give.
            let slowest = eigenvalues(&a).unwrap().iter().map(|e| e.re).fold(f64::NEG_INFINITY, f64::max);
            assert_eq!(slowest < 0.0, stable, "{name} with a lag of {lag} s: {slowest}");
        }
    }
}

#[test]
fn ranks_and_finite_gramians_equal_the_reference() {
    let Some(reference) = json("lqg.json") else { return };
    let plant = whole_plant(&Airframe::iris());
    let state = |name: &str| match name {
        "x" => ix::X,
        "y" => ix::Y,
        "z" => ix::Z,
        "vx" => ix::VX,
        "vy" => ix::VY,
        "vz" => ix::VZ,
        "phi" => ix::ROLL,
        "theta" => ix::PITCH,
        "psi" => ix::YAW,
        "r" => ix::R,
        other => panic!("{other}"),
    };
    assert_eq!(controllable_rank(&plant.a, &plant.b), 12);
    for (names, expected) in reference["observability"].as_object().unwrap().iter().filter(|(_, v)| v.is_object()) {
        let outputs: Vec<usize> = names.split(',').map(state).collect();
        let c = DMatrix::from_fn(outputs.len(), 12, |r, column| if outputs[r] == column { 1.0 } else { 0.0 });
        assert_eq!(observable_rank(&plant.a, &c) as u64, expected["obsv_rank"].as_u64().unwrap(), "{names}");
        let pbh = plumbline_agent::control::structure::pbh_rank(&plant.a, &c, Complex::new(0.0, 0.0));
        assert_eq!(pbh as u64, expected["pbh_rank_at_0"].as_u64().unwrap(), "{names}");
        assert_eq!(detectable(&plant.a, &c).unwrap(), expected["detectable"].as_bool().unwrap(), "{names}");
        let unseen = expected["unobservable_states"].as_array().unwrap();
        let unseen: Vec<usize> = unseen.iter().map(|n| state(n.as_str().unwrap())).collect();
        let found = unobservable_states(&plant.a, &c);
        assert!(unseen.iter().all(|s| found.contains(s)) && found.len() == unseen.len(), "{names}: {found:?}");
    }
    for horizon in ["1.0", "5.0"] {
        let expected = &reference["finite_gramians"][horizon];
        let t: f64 = horizon.parse().unwrap();
        let wc = gramian(&plant.a, &plant.b, t).unwrap();
        let wo = gramian(&plant.a.transpose(), &plant.c.transpose(), t).unwrap();
        near("trace of Wc", wc.trace(), expected["Wc_trace"].as_f64().unwrap(), 1e-10);
        near("trace of Wo", wo.trace(), expected["Wo_trace"].as_f64().unwrap(), 1e-10);
        if horizon == "1.0" {
            close("Wc", &wc, &matrix(&expected["Wc"]), 1e-10);
            close("Wo", &wo, &matrix(&expected["Wo"]), 1e-10);
        }
    }
}

#[test]
fn smallest_gammas_equal_the_reference() {
    let Some(reference) = json("hinf.json") else { return };
    let iris = Airframe::iris();
    for (index, name) in [(0, "x"), (2, "z"), (3, "psi")] {
        for (epsilon, expected) in reference["gamma_opt_vs_eps"][name].as_object().unwrap() {
            let weights = ChannelWeights::printed(epsilon.parse().unwrap());
            let solved = channel(&iris, index, &weights, 1.01, None, 1e-9).unwrap();
            near(&format!("{name} at {epsilon}"), solved.gamma_opt, expected.as_f64().unwrap(), GAMMA_TOLERANCE);
        }
    }
}

#[test]
fn recommended_weights_give_the_recommended_poles() {
    let Some(reference) = json("hinf.json") else { return };
    let iris = Airframe::iris();
    for (index, name) in [(0, "x"), (1, "y"), (2, "z"), (3, "psi")] {
        let expected = &reference["recommended_weights"][name];
        let value = |key: &str| expected[key].as_f64().unwrap();
        let weights = ChannelWeights {
            performance: Weight::performance(value("wb"), value("Ms"), value("A")),
            effort: Weight::effort(value("ku"), value("kh"), value("pk")),
            epsilon: value("eps"),
        };
        let solved = channel(&iris, index, &weights, 1.0, Some(value("gamma")), 1e-9).unwrap();
        near(&format!("{name} gamma"), solved.gamma_opt, value("gamma"), GAMMA_TOLERANCE);
        let (reduced, fast) = residualise_fastest(&solved.central.controller).unwrap();
        assert_eq!(reduced.order() as u64, expected["order"].as_u64().unwrap());
        assert!(fast < -1e4, "{fast}");
        let found = eigenvalues(&reduced.a).unwrap();
        for pole in expected["poles"].as_array().unwrap() {
            let pole = Complex::new(pole[0].as_f64().unwrap(), pole[1].as_f64().unwrap());
            let distance = found.iter().map(|p| (p - pole).norm()).fold(f64::INFINITY, f64::min);
            assert!(distance < 1e-3 * pole.norm().max(1e-3), "{name}: {pole} in {found:?}");
        }
    }
}

#[test]
fn full_order_norms_and_hankel_values_equal_the_reference_and_truncation_destabilises() {
    let Some(reference) = json("hinf.json") else { return };
    let iris = Airframe::iris();
    let plant = whole_plant(&iris);
    for (name, expected) in reference["designs"].as_object().unwrap() {
        let (epsilon, gamma) = (expected["eps"].as_f64().unwrap(), expected["gamma"].as_f64().unwrap());
        let weights = ChannelWeights::printed(epsilon);
        let channels: [StateSpace; 4] =
            std::array::from_fn(|i| channel(&iris, i, &weights, 1.0, Some(gamma), 1e-3).unwrap().central.controller);
        let full = assemble(&channels);
        assert_eq!(full.order(), 20);
        // The whole problem at once: the same controller.
        let problem = mixed_sensitivity(&plant, &[weights.performance; 4], &[weights.effort; 4], epsilon);
        let whole = central(&problem, gamma).unwrap().unwrap().controller;
        let frequencies = expected["K_freqresp"]["w"].as_array().unwrap();
        // Thrust from z, torque x from y, torque y from x, torque z from yaw.
        let pairs = [(0, 2), (1, 1), (2, 0), (3, 3)];
        for (w, row) in frequencies.iter().zip(expected["K_freqresp"]["H"].as_array().unwrap()) {
            let s = Complex::new(0.0, w.as_f64().unwrap());
            for controller in [&full, &whole] {
                let found = controller.response(s).unwrap();
                for ((output, input), value) in pairs.into_iter().zip(row.as_array().unwrap()) {
                    let value = Complex::new(value[0].as_f64().unwrap(), value[1].as_f64().unwrap());
                    let error = (found[(output, input)] - value).norm() / value.norm();
                    assert!(error < NORM_TOLERANCE, "{name} K({s}) [{output}, {input}]: {error:.1e}");
                }
            }
        }
        let closed = problem.closed(&full);
        let (norm, _) = hinf_norm(&closed.a, &closed.b, &closed.c, &closed.d, 1e-8).unwrap();
        near(&format!("{name} norm"), norm, expected["full"]["hinf_ab13dd"].as_f64().unwrap(), NORM_TOLERANCE);
        let slowest = tracking(&plant, &full).slowest().unwrap();
        near(
            &format!("{name} slowest pole"),
            slowest,
            expected["full"]["true_loop_max_re"].as_f64().unwrap(),
            NORM_TOLERANCE,
        );

        let balanced = balance(&full).unwrap();
        for (i, value) in expected["hsv"].as_array().unwrap().iter().enumerate() {
            near(&format!("{name} hsv {i}"), balanced.values[i], value.as_f64().unwrap(), NORM_TOLERANCE);
        }
        let truncated = tracking(&plant, &balanced.truncated(16)).slowest().unwrap();
        let unstable = expected["reduced16"]["true_loop_max_re"].as_f64().unwrap();
        near(&format!("{name} truncated to 16"), truncated, unstable, NORM_TOLERANCE);
        assert!(truncated > 1.0, "the source's reduction does not hold");
    }
}

#[test]
fn sixteen_states_by_residualisation_are_stable_and_as_good_as_twenty() {
    let Some(reference) = json("hinf.json") else { return };
    let iris = Airframe::iris();
    let plant = whole_plant(&iris);
    for epsilon in [0.1, 0.01] {
        let study = &reference["reduction_study"][format!("eps{epsilon}_per_channel_1.001")];
        let weights = [ChannelWeights::printed(epsilon); 4];
        let (full, reduced, _) =
            plumbline_agent::control::hinf::strategies::controllers(&iris, &weights, 1.001, 1e-9).unwrap();
        assert_eq!((full.order(), reduced.order()), (20, 16));
        for (what, controller) in [("full20", &full), ("residualised16", &reduced)] {
            let slowest = tracking(&plant, controller).slowest().unwrap();
            assert!(slowest < 0.0, "{what} at {epsilon}: {slowest}");
            let expected = study[what]["true_loop_max_re"].as_f64().unwrap();
            near(&format!("{what} slowest pole"), slowest, expected, 1e-4);
            // Errors of the reference are the inputs of K: u = K (r − y).
            let negative = StateSpace { b: -&controller.b, d: -&controller.d, ..controller.clone() };
            let (_, peak) = continuous_margins(&plant, &negative).unwrap();
            near(&format!("{what} peak of S"), peak, study[what]["peak_S"].as_f64().unwrap(), MARGIN_TOLERANCE);
        }
    }
}
