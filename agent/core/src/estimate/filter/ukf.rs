//! Unscented Kalman filter with 2n sigma points (\[Umasankar\] Algorithm 2).
//!
//! | symbol | meaning |
//! |---|---|
//! | x̂, P | the twelve states of [`EulerBody`] and their covariance |
//! | L | lower Cholesky factor of nP: the points are x̂ ± its columns |
//! | Q_k | process noise of the interval, accumulated along the mean's trajectory |
//! | P_y, P_xy, K | covariance of the prediction, cross covariance, gain |
//!
//! Deviations from \[Umasankar\] Alg. 2 (ERRATA 8): the second set of points is drawn from x̂⁻, P⁻, which are
//! known, not from x̂⁺, P⁺, which are not yet; columns of a lower factor (rows would need an upper one);
//! the yaw innovation is wrapped. An interval between measurements is one prediction: the points are kept
//! through all its steps, as in the reference.

use nalgebra::{SMatrix, SVector};

use super::kalman;
use super::measurement::{MAX_ROWS, Measurement, TwelveState};
use crate::estimate::{EstimatorKind, Residual, Residuals};
use crate::model::euler_body::{EulerBody, Input, M, N, X};

/// Number of sigma points.
const POINTS: usize = 2 * N;
/// Added to the diagonal, relative to it, when rounding has left P without a Cholesky factor.
const JITTER: f64 = 1e-12;

/// State, covariance, model, and the points of the interval under way.
#[derive(Debug, Clone)]
pub struct Ukf {
    /// The model.
    pub body: EulerBody,
    /// x̂ at the last measurement, or predicted since.
    x: X,
    p: M,
    points: [X; POINTS],
    /// The mean's own trajectory, along which Q_k is accumulated.
    centre: X,
    q: M,
    predicting: bool,
}

impl TwelveState for Ukf {
    const KIND: EstimatorKind = EstimatorKind::Ukf;

    fn new(body: EulerBody, x: X, p: M) -> Self {
        Self { body, x, p, points: [X::zeros(); POINTS], centre: x, q: M::zeros(), predicting: false }
    }

    fn restart(&mut self, x: X, p: M) {
        (self.x, self.p, self.predicting) = (x, p, false);
    }

    /// Alg. 2, lines 7–12.
    fn predict(&mut self, u: &impl Input, h: f64, q: &M) {
        let first = !self.predicting;
        if first {
            self.points = sigma_points(&self.x, &self.p);
            self.centre = self.x;
            self.predicting = true;
        }
        let action = u.action(&self.body);
        for point in &mut self.points {
            *point = self.body.step(point, &action, h);
        }
        let next = self.body.step(&self.centre, &action, h);
        self.q = if first {
            *q
        } else {
            let phi = self.body.transition(&self.centre, &next, &action, h);
            kalman::predict(&self.q, &phi, q)
        };
        self.centre = next;
    }

    /// Alg. 2, lines 15–26.
    fn correct(&mut self, rows: &[Measurement], residuals: &mut Residuals) {
        // The smallest size that holds them: the work grows with it.
        match rows.len() {
            0 => self.settle(),
            1..=4 => self.correct_up_to::<4>(rows, residuals),
            5..=8 => self.correct_up_to::<8>(rows, residuals),
            _ => self.correct_up_to::<MAX_ROWS>(rows, residuals),
        }
    }

    /// Alg. 2, lines 13–14.
    fn moments(&self) -> (X, M) {
        if !self.predicting {
            return (self.x, self.p);
        }
        let mean = self.points.iter().sum::<X>() / POINTS as f64;
        let mut p = self.q;
        for point in &self.points {
            let d = point - mean;
            p.ger(1.0 / POINTS as f64, &d, &d, 1.0);
        }
        kalman::symmetrise(&mut p);
        (mean, p)
    }
}

impl Ukf {
    /// Ends the interval: from here on the points are drawn afresh. For use between measurements that are
    /// far apart, where one set of points would spread too wide.
    pub fn settle(&mut self) {
        (self.x, self.p) = self.moments();
        self.predicting = false;
    }

    fn correct_up_to<const ROWS: usize>(&mut self, rows: &[Measurement], residuals: &mut Residuals) {
        self.settle();
        let points = sigma_points(&self.x, &self.p);
        let mut y_points = [SVector::<f64, ROWS>::zeros(); POINTS];
        // Rows that are not used keep a unit variance, no covariance and no innovation: they do nothing.
        let mut p_y = SMatrix::<f64, ROWS, ROWS>::identity();
        let mut innovation = SVector::<f64, ROWS>::zeros();
        let mut used = [false; ROWS];
        for (j, row) in rows.iter().enumerate().take(ROWS) {
            // Deviations from the central prediction keep angles away from the wrap.
            let central = row.predict(&self.x);
            let mut mean = 0.0;
            for (y, point) in y_points.iter_mut().zip(&points) {
                y[j] = row.difference(row.predict(point), central);
                mean += y[j] / POINTS as f64;
            }
            let mut s = row.noise.sigma * row.noise.sigma;
            for y in &mut y_points {
                y[j] -= mean;
                s += y[j] * y[j] / POINTS as f64;
            }
            let nu = row.difference(row.value, central + mean);
            let (finite, sigma) = (nu.is_finite() && s.is_finite(), s.sqrt());
            used[j] = finite && nu.abs() <= row.noise.gate * sigma;
            if let Some((sensor, channel)) = row.of.filter(|_| finite) {
                let _ = residuals.try_push(Residual::gated(sensor, channel, nu, sigma, row.noise.gate));
            }
            if used[j] {
                innovation[j] = nu;
            } else {
                y_points.iter_mut().for_each(|y| y[j] = 0.0);
            }
        }
        let mut p_xy = SMatrix::<f64, N, ROWS>::zeros();
        let mut spread = SMatrix::<f64, ROWS, ROWS>::zeros();
        for (y, point) in y_points.iter().zip(&points) {
            p_xy.ger(1.0 / POINTS as f64, &(point - self.x), y, 1.0);
            spread.ger(1.0 / POINTS as f64, y, y, 1.0);
        }
        for (j, row) in rows.iter().enumerate().take(ROWS) {
            if used[j] {
                p_y[(j, j)] = row.noise.sigma * row.noise.sigma;
            }
        }
        p_y += spread;
        let Some(cholesky) = p_y.cholesky() else { return };
        // K = P_xy P_y⁻¹, by solving P_y Kᵀ = P_xyᵀ.
        let k = cholesky.solve(&p_xy.transpose()).transpose();
        self.x += k * innovation;
        // P⁺ = P⁻ − K P_y Kᵀ.
        self.p -= k * p_y * k.transpose();
        kalman::symmetrise(&mut self.p);
    }
}

/// x ± the columns of the lower Cholesky factor of nP.
fn sigma_points(x: &X, p: &M) -> [X; POINTS] {
    let scaled = p * N as f64;
    let factor = scaled.cholesky().map(|c| c.unpack()).unwrap_or_else(|| {
        // Rounding took a variance to zero: the smallest lift that makes a factor exist.
        let lifted = |jitter: f64| {
            let mut m = scaled;
            for i in 0..N {
                m[(i, i)] = m[(i, i)].max(0.0) + jitter * (m[(i, i)].abs() + 1.0);
            }
            m.cholesky().map(|c| c.unpack())
        };
        lifted(JITTER)
            .or_else(|| lifted(1e-6))
            .unwrap_or_else(|| M::from_diagonal(&scaled.diagonal().map(|v| v.abs().sqrt())))
    });
    let mut points = [*x; POINTS];
    for i in 0..N {
        points[i] += factor.column(i);
        points[N + i] -= factor.column(i);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::super::mocap_recipe::{self, Golden};
    use super::*;

    #[test]
    fn equals_the_independent_reference() {
        mocap_recipe::check("ukf", || Ukf::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6));
    }

    #[test]
    fn a_camera_that_drops_out_leaves_p_positive() {
        let Some(golden) = Golden::load() else { return };
        let mut log = golden.log("sine");
        for (k, row) in log.iter_mut().enumerate() {
            if k % 3 == 0 {
                row.range_m[0] = f64::NAN;
            }
            if k > 2000 {
                row.range_m[2] = f64::NAN;
            }
        }
        let mut filter = Ukf::new(EulerBody::iris(), X::zeros(), M::identity() * 1e-6);
        let found = mocap_recipe::run(&log, 12, &mut filter);
        assert!(filter.p.symmetric_eigenvalues().min() > 0.0);
        let last = &log[log.len() - 1];
        let end = found.last().unwrap();
        assert!((end.fixed_rows::<3>(0) - last.position_m).norm() < 0.2, "{end}");
    }

    #[test]
    fn points_have_the_moments_they_were_drawn_from() {
        let a = M::from_fn(|i, j| ((i * 5 + j * 3) as f64).sin());
        let p = a * a.transpose() + M::identity() * 0.1;
        let x = X::from_fn(|i, _| i as f64);
        let points = sigma_points(&x, &p);
        let mean = points.iter().sum::<X>() / POINTS as f64;
        let mut found = M::zeros();
        for point in &points {
            found += (point - mean) * (point - mean).transpose() / POINTS as f64;
        }
        assert!((mean - x).norm() < 1e-12 && (found - p).norm() < 1e-10 * p.norm());
    }
}
