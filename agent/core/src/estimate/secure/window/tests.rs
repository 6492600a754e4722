//! The window under masks, drop-outs and thrust.

use super::*;

const DT_S: f64 = 0.04;

/// Height and climb, three heights, climb noise.
fn window(slots: usize) -> Window<2> {
    let model =
        Model { a: SMatrix::from([[1.0, 0.0], [DT_S, 1.0]]), q: SMatrix::from_diagonal(&SVector::from([1e-12, 1e-4])) };
    let row = Row { c: SVector::from([1.0, 0.0]), sigma: 0.007, bias_sigma: 0.004 };
    Window::new(&model, &[row], &[0, 0, 0], slots, Settings::default()).unwrap()
}

#[test]
fn an_attack_is_recovered_under_masks_drop_outs_and_thrust() {
    let mut w = window(10);
    let (mut z, mut v) = (0.5, 0.0_f64);
    let thrust = 1.5;
    for k in 0..40_usize {
        let forced = SVector::from([0.5 * thrust * DT_S * DT_S, thrust * DT_S]);
        z += v * DT_S + forced[0];
        v += forced[1];
        w.advance(Some(&forced));
        for sensor in 0..3 {
            // Staggered, every second or third slot, one sample lost.
            if (k + sensor) % (2 + sensor % 2) == 0 && !(k == 35 && sensor == 0) {
                w.put(sensor, if sensor == 1 { 2.0 } else { z });
            }
        }
        assert_eq!(w.is_ready(), k >= 9);
    }
    let got = w.decode(|_| false, &[], None).unwrap();
    assert!((got.x - SVector::from([z, v])).norm() < 1e-5, "{got:?} against {z} {v}");
    assert!(w.statistic(1).square > 1e3 && w.statistic(0).square < 1e-3, "{:?}", w.statistic(1));
    assert_eq!(w.statistic(0).values, w.count(0));
    // Excluded, it has a statistic all the same.
    let without = w.decode(|sensor| sensor == 1, &[], Some(&got.x)).unwrap();
    assert!((without.x - got.x).norm() < 1e-5 && w.statistic(1).square > 1e3);
    // The 1-norm over time recovers it as well, each value a term of its own.
    w.use_program(Program::L1);
    let got = w.decode(|_| false, &[], None).unwrap();
    let values: usize = (0..3).map(|sensor| w.count(sensor)).sum();
    assert_eq!(w.problem().0.terms(), values);
    assert!((got.x - SVector::from([z, v])).norm() < 1e-5, "{got:?} against {z} {v}");
}

#[test]
fn factors_whiten_exactly() {
    // GIVEN any mask, THEN ‖whitened residual‖² is the quadratic form with the inverse covariance.
    let mut w = window(10);
    let y: Vec<f64> = (0..10).map(|k| 0.01 * f64::from(k * k % 7)).collect();
    for (k, value) in y.iter().enumerate() {
        w.advance(None);
        if [0, 3, 4, 8, 9].contains(&k) {
            w.put(0, *value);
        }
        w.put(1, 0.0);
    }
    w.decode(|_| false, &[(0, 1e-9), (1, 1e-9)], None).unwrap();
    let ages = [0, 1, 5, 6, 9];
    let phase = &w.phases[0];
    let c = DMatrix::from_fn(5, 5, |a, b| phase.covariance[ages[a] * 10 + ages[b]]);
    let v = nalgebra::DVector::from_fn(5, |a, _| y[9 - ages[a]]);
    let expected = v.dot(&c.cholesky().unwrap().solve(&v));
    assert!((w.statistic(0).square / expected - 1.0).abs() < 1e-6, "{} {expected}", w.statistic(0).square);
}

#[test]
fn moving_the_reference_moves_the_state() {
    let mut w = window(10);
    for k in 0..12 {
        w.advance(None);
        (0..3).for_each(|s| w.put(s, 0.1 * f64::from(k) * DT_S));
    }
    let before = w.decode(|_| false, &[], None).unwrap().x;
    let by = SVector::from([0.3, -0.2]);
    w.rebase(&by);
    let after = w.decode(|_| false, &[], None).unwrap().x;
    assert!((before - after - by).norm() < 1e-6);
}

#[test]
fn what_is_not_finite_is_skipped_and_bad_suites_are_refused() {
    let mut w = window(4).growing();
    assert!(!w.is_ready());
    w.advance(None);
    w.put(0, f64::NAN);
    w.put(1, f64::INFINITY);
    w.put(9, 1.0);
    assert_eq!((w.count(0), w.count(1)), (0, 0));
    assert!(w.is_ready());
    // One height in one slot says nothing of the climb.
    w.put(0, 1.0);
    assert!(matches!(w.decode(|_| false, &[], None), Err(SecureError::Unobservable { state: 1, .. })));
    let model = Model::<1> { a: SMatrix::from([[1.0]]), q: SMatrix::zeros() };
    let row = |sigma| Row { c: SVector::from([1.0]), sigma, bias_sigma: 0.0 };
    for sigma in [0.0, -1.0, f64::NAN] {
        let error = Window::new(&model, &[row(sigma)], &[0], 4, Settings::default()).unwrap_err();
        assert!(error.to_string().contains("whitening"), "{error}");
    }
    let flat = Model::<1> { a: SMatrix::zeros(), q: SMatrix::zeros() };
    assert!(Window::new(&flat, &[row(1.0)], &[0], 4, Settings::default()).is_err());
    assert!(Window::new(&model, &[row(1.0)], &[0], 0, Settings::default()).is_err());
    assert!(Window::new(&model, &[row(1.0)], &[1], 4, Settings::default()).is_err());
}
