//! Predict and correct: the algebra every Kalman filter here shares.
//!
//! | symbol | meaning |
//! |---|---|
//! | P | covariance of the state's error, n × n |
//! | Φ, Q | transition over one step and the noise it adds |
//! | h, r | row of H of one scalar measurement and its variance |
//! | s = h P hᵀ + r | variance of the innovation |
//! | k = P hᵀ / s | gain |
//!
//! Vector measurements with independent noise are taken one scalar at a time: no inverse, and each
//! scalar has its own gate. Corrections use Joseph's form, which keeps P symmetric and positive for any
//! gain, the literal "P ← P + dt(AP + PAᵀ + Q)" of \[Umasankar\] Alg. 1 does not (errata 7).

use nalgebra::{SMatrix, SVector};

/// P ← Φ P Φᵀ + Q, symmetric to the last bit.
#[must_use]
pub fn predict<const N: usize>(
    p: &SMatrix<f64, N, N>,
    phi: &SMatrix<f64, N, N>,
    q: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    let mut next = phi * p * phi.transpose() + q;
    symmetrise(&mut next);
    next
}

/// P hᵀ and s = h P hᵀ + r of one scalar measurement.
#[must_use]
pub fn innovation_variance<const N: usize>(
    p: &SMatrix<f64, N, N>,
    h: &SVector<f64, N>,
    r: f64,
) -> (SVector<f64, N>, f64) {
    let ph = p * h;
    let s = h.dot(&ph) + r;
    (ph, s)
}

/// One scalar correction with any gain `k`, in Joseph's form: P ← (I − k h) P (I − k h)ᵀ + k r kᵀ.
pub fn correct_scalar<const N: usize>(p: &mut SMatrix<f64, N, N>, h: &SVector<f64, N>, r: f64, k: &SVector<f64, N>) {
    // (I − k h) P, a rank-one change: P is symmetric, so h P = (P hᵀ)ᵀ.
    let ph = *p * h;
    p.ger(-1.0, k, &ph, 1.0);
    // (…)(I − k h)ᵀ + k r kᵀ = (…) − ((…) hᵀ − r k) kᵀ.
    let right = *p * h - r * k;
    p.ger(-1.0, &right, k, 1.0);
    symmetrise(p);
}

/// P and Pᵀ averaged: rounding keeps no memory.
pub fn symmetrise<const N: usize>(p: &mut SMatrix<f64, N, N>) {
    for column in 0..N {
        for row in 0..column {
            let mean = 0.5 * (p[(row, column)] + p[(column, row)]);
            p[(row, column)] = mean;
            p[(column, row)] = mean;
        }
    }
}

/// Forgets everything about state `i` except that its variance is `variance`.
pub fn forget<const N: usize>(p: &mut SMatrix<f64, N, N>, i: usize, variance: f64) {
    p.row_mut(i).fill(0.0);
    p.column_mut(i).fill(0.0);
    p[(i, i)] = variance;
}

#[cfg(test)]
mod tests {
    use super::*;

    type M = SMatrix<f64, 4, 4>;

    fn spd(seed: u64) -> M {
        let a = M::from_fn(|i, j| ((i * 7 + j * 3) as f64 * 1.3 + seed as f64).sin());
        a * a.transpose() + M::identity() * 0.05
    }

    #[test]
    fn joseph_equals_the_information_form() {
        // (P⁻¹ + hᵀ r⁻¹ h)⁻¹ is the textbook posterior.
        for seed in 0..20 {
            let p0 = spd(seed);
            let h = SVector::<f64, 4>::from_fn(|i, _| (i as f64 + seed as f64).cos());
            let r = 0.3;
            let (ph, s) = innovation_variance(&p0, &h, r);
            let mut p = p0;
            correct_scalar(&mut p, &h, r, &(ph / s));
            let expected = (p0.try_inverse().unwrap() + h * h.transpose() / r).try_inverse().unwrap();
            assert!((p - expected).norm() < 1e-10 * expected.norm());
        }
    }

    #[test]
    fn any_gain_keeps_p_positive() {
        // GIVEN the covariance that breaks the literal update, WHEN corrected with a wrong gain 1e6 times
        // too large or with exact measurements, THEN it stays positive.
        for scale in [0.0, 0.5, 1.0, 3.0] {
            let mut p = M::from_diagonal(&SVector::from([1e-4, 1e-2, 1e6, 1e-12]));
            let h = SVector::from([1.0, 1.0, 1.0, 1.0]);
            for _ in 0..100 {
                let (ph, s) = innovation_variance(&p, &h, 1e-9);
                correct_scalar(&mut p, &h, 1e-9, &(ph * (scale / s)));
            }
            assert_eq!(p, p.transpose());
            assert!(p.symmetric_eigenvalues().min() > -1e-9 * p.norm(), "scale {scale}");
        }
    }

    #[test]
    fn predict_stays_symmetric() {
        let phi = M::from_fn(|i, j| if i == j { 1.0 } else { 0.01 * (i as f64 - j as f64) });
        let mut p = spd(1);
        for _ in 0..1000 {
            p = predict(&p, &phi, &(M::identity() * 1e-6));
            assert_eq!(p, p.transpose());
        }
        assert!(p.symmetric_eigenvalues().min() > 0.0);
    }
}
