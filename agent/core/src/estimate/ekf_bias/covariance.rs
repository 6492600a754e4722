//! Covariance of the 17 error states, and its propagation block by block.
//!
//! Error state: δp, δv, δφ (attitude error about the **world** axes, R = exp(δφ×)R̂), δb_a, δb_g, offsets of
//! two barometers. With the error about the world axes a tilt correction cannot turn yaw and yaw's
//! uncertainty stays yaw's, whatever the attitude.
//!
//! ```text
//! δṗ = δv     δv̇ = −[R̂f]× δφ − R̂ δb_a + n_a     δφ̇ = −R̂ δb_g + n_g     the others walk
//! ```

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::estimate::filter::kalman;
use crate::frames::skew;

/// Places of the error states.
pub mod ix {
    /// Position, 3.
    pub const POSITION: usize = 0;
    /// Velocity, 3.
    pub const VELOCITY: usize = 3;
    /// Attitude error about the world axes, 3.
    pub const ATTITUDE: usize = 6;
    /// Accelerometer bias, 3.
    pub const ACCEL_BIAS: usize = 9;
    /// Gyroscope bias, 3.
    pub const GYRO_BIAS: usize = 12;
    /// Barometer offsets, one per instance.
    pub const BAROMETER: usize = 15;
}

/// Error states.
pub const N: usize = 17;
/// Covariance.
pub type Covariance = SMatrix<f64, N, N>;
/// Error state, or a row of H.
pub type ErrorState = SVector<f64, N>;

/// Noise added per second, as variances.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    /// Of the specific force along the world axes, (m/s²)²/Hz.
    pub accel: Vector3<f64>,
    /// Of the angular rate about the world axes, (rad/s)²/Hz.
    pub gyro: Vector3<f64>,
    /// Walk of the accelerometer bias along each axis, (m/s²)²/s, and the variance beyond which it stops.
    pub accel_bias: [(f64, f64); 3],
    /// Walk of the gyroscope bias, (rad/s)²/s, and the variance beyond which it stops.
    pub gyro_bias: (f64, f64),
    /// Walk of the barometer offsets, m²/s.
    pub barometer: f64,
}

/// P ← Φ P Φᵀ + Q over `dt_s`, with `force_world` = R̂f and `rotation` = R̂ at the middle of the step.
///
/// Φ differs from 1 in few blocks; P Φᵀ is a handful of column operations, done twice with a transposition
/// between. Same result as the dense product (tested), a fifth of the work.
pub fn propagate(p: &mut Covariance, force_world: &Vector3<f64>, rotation: &Matrix3<f64>, dt_s: f64, noise: &Noise) {
    let dt = dt_s;
    let a = -skew(force_world);
    let b = -rotation;
    let ab = a * b;

    for _ in 0..2 {
        times_phi_transposed(&mut p.data.0, &a, &b, &ab, dt);
        p.transpose_mut();
    }

    for i in 0..3 {
        let (position, velocity) = (ix::POSITION + i, ix::VELOCITY + i);
        p[(position, position)] += noise.accel[i] * dt * dt * dt / 3.0;
        p[(position, velocity)] += noise.accel[i] * dt * dt / 2.0;
        p[(velocity, position)] += noise.accel[i] * dt * dt / 2.0;
        p[(velocity, velocity)] += noise.accel[i] * dt;
        p[(ix::ATTITUDE + i, ix::ATTITUDE + i)] += noise.gyro[i] * dt;
        for (start, (walk, most)) in [(ix::ACCEL_BIAS, noise.accel_bias[i]), (ix::GYRO_BIAS, noise.gyro_bias)] {
            if p[(start + i, start + i)] < most {
                p[(start + i, start + i)] += walk * dt;
            }
        }
    }
    for i in ix::BAROMETER..N {
        p[(i, i)] += noise.barometer * dt;
    }
    kalman::symmetrise(p);
}

/// Columns of P Φᵀ: column i becomes Σⱼ Φᵢⱼ columnⱼ. In the order position, velocity, attitude every
/// column read is still the old one.
fn times_phi_transposed(c: &mut [[f64; N]; N], a: &Matrix3<f64>, b: &Matrix3<f64>, ab: &Matrix3<f64>, dt: f64) {
    let half = 0.5 * dt * dt;
    for i in 0..3 {
        let mut sum = c[ix::POSITION + i];
        add(&mut sum, dt, &c[ix::VELOCITY + i]);
        for j in 0..3 {
            add(&mut sum, half * a[(i, j)], &c[ix::ATTITUDE + j]);
            add(&mut sum, half * b[(i, j)], &c[ix::ACCEL_BIAS + j]);
        }
        c[ix::POSITION + i] = sum;
    }
    for i in 0..3 {
        let mut sum = c[ix::VELOCITY + i];
        for j in 0..3 {
            add(&mut sum, dt * a[(i, j)], &c[ix::ATTITUDE + j]);
            add(&mut sum, dt * b[(i, j)], &c[ix::ACCEL_BIAS + j]);
            add(&mut sum, half * ab[(i, j)], &c[ix::GYRO_BIAS + j]);
        }
        c[ix::VELOCITY + i] = sum;
    }
    for i in 0..3 {
        let mut sum = c[ix::ATTITUDE + i];
        for j in 0..3 {
            add(&mut sum, dt * b[(i, j)], &c[ix::GYRO_BIAS + j]);
        }
        c[ix::ATTITUDE + i] = sum;
    }
}

#[inline(always)]
fn add(sum: &mut [f64; N], factor: f64, column: &[f64; N]) {
    for (s, x) in sum.iter_mut().zip(column) {
        *s += factor * x;
    }
}

/// Adds a barometer's offset to the estimate: offset = reading − z, so its error is −δz plus noise.
pub fn augment_barometer(p: &mut Covariance, i: usize, variance: f64) {
    let z = ix::POSITION + 2;
    kalman::forget(p, i, 0.0);
    for j in 0..N {
        if j != i {
            let covariance = -p[(z, j)];
            p[(i, j)] = covariance;
            p[(j, i)] = covariance;
        }
    }
    p[(i, i)] = p[(z, z)] + variance;
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn random_covariance(seed: u64) -> Covariance {
        let a = Covariance::from_fn(|i, j| ((i * 31 + j * 17) as f64 * 0.77 + seed as f64).sin() * 0.3);
        a * a.transpose() + Covariance::identity() * 0.01
    }

    const NOISE: Noise = Noise {
        accel: Vector3::new(1e-4, 1e-4, 1e-4),
        gyro: Vector3::new(1e-6, 1e-6, 1e-6),
        accel_bias: [(1e-7, 1e9); 3],
        gyro_bias: (1e-10, 1e9),
        barometer: 1e-4,
    };

    fn dense(force: &Vector3<f64>, rotation: &Matrix3<f64>, dt: f64) -> Covariance {
        let (a, b) = (-skew(force), -rotation);
        let mut f = Covariance::zeros();
        f.fixed_view_mut::<3, 3>(ix::POSITION, ix::VELOCITY).copy_from(&Matrix3::identity());
        f.fixed_view_mut::<3, 3>(ix::VELOCITY, ix::ATTITUDE).copy_from(&a);
        f.fixed_view_mut::<3, 3>(ix::VELOCITY, ix::ACCEL_BIAS).copy_from(&b);
        f.fixed_view_mut::<3, 3>(ix::ATTITUDE, ix::GYRO_BIAS).copy_from(&b);
        Covariance::identity() + f * dt + f * f * (0.5 * dt * dt)
    }

    #[test]
    fn blocks_equal_the_dense_product() {
        let rotation = nalgebra::Rotation3::from_euler_angles(0.3, -0.5, 2.0).into_inner();
        let force = Vector3::new(0.4, -1.0, 10.2);
        for seed in 0..5 {
            let p0 = random_covariance(seed);
            let mut p = p0;
            let none = Vector3::zeros();
            let quiet =
                Noise { accel: none, gyro: none, accel_bias: [(0.0, 0.0); 3], gyro_bias: (0.0, 0.0), barometer: 0.0 };
            propagate(&mut p, &force, &rotation, 0.01, &quiet);
            let phi = dense(&force, &rotation, 0.01);
            let expected = phi * p0 * phi.transpose();
            assert!((p - expected).norm() < 1e-12 * expected.norm(), "{}", (p - expected).norm());
        }
    }

    #[test]
    fn p_stays_symmetric_and_positive_over_a_long_run() {
        let mut p = random_covariance(3);
        for k in 0..20_000 {
            let t = f64::from(k) * 0.005;
            let rotation = nalgebra::Rotation3::from_euler_angles(t.sin(), 0.4 * (0.7 * t).cos(), t).into_inner();
            propagate(&mut p, &Vector3::new(t.cos(), 0.3, 9.8 + t.sin()), &rotation, 0.005, &NOISE);
            if k % 20 == 0 {
                let mut h = ErrorState::zeros();
                h[(k as usize / 20) % 9] = 1.0;
                let (ph, s) = kalman::innovation_variance(&p, &h, 1e-6);
                kalman::correct_scalar(&mut p, &h, 1e-6, &(ph / s));
            }
            assert_eq!(p, p.transpose());
        }
        let least = p.symmetric_eigenvalues().min();
        assert!(least > 0.0, "least eigenvalue {least}");
    }

    #[test]
    fn an_added_barometer_keeps_p_positive_and_the_sum_known() {
        let mut p = random_covariance(7);
        let others = p;
        augment_barometer(&mut p, ix::BAROMETER, 0.04);
        // z + offset is the reading: its variance is the reading's alone.
        let (z, b) = (2, ix::BAROMETER);
        assert!((p[(z, z)] + p[(b, b)] + 2.0 * p[(z, b)] - 0.04).abs() < 1e-12);
        assert_eq!(p[(0, 4)], others[(0, 4)]);
        assert!(p.symmetric_eigenvalues().min() > 0.0);
    }
}
