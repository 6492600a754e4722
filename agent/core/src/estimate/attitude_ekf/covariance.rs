//! Covariance of the 26 error states, and its propagation.
//!
//! ```text
//! ε = −R (δb + δS γ)        error of the rate, about the axes of L
//! δθ̇ = ε_xy                 δv̇ = (θ_y f_z, −θ_x f_z) − (R δb_a)_xy − δv / 8 s
//! δḣ = ε_z (h_y, −h_x, 0)   the others are constant or walk
//! ```

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::{DEGREE, VELOCITY_LEAK_S};
use crate::estimate::filter::kalman;

/// Places of the error states. Those that the magnetometer corrects stand last.
pub(super) mod ix {
    /// Tilt error about x and y of L.
    pub const TILT: usize = 0;
    /// Horizontal velocity.
    pub const VELOCITY: usize = 2;
    /// S, row by row.
    pub const GYRO_MATRIX: usize = 4;
    /// b_a.
    pub const ACCEL_BIAS: usize = 13;
    /// b.
    pub const GYRO_BIAS: usize = 16;
    /// h.
    pub const FIELD: usize = 19;
    /// m_b.
    pub const HARD_IRON: usize = 22;
    /// τ.
    pub const LAG: usize = 25;
}

/// Error states.
pub(super) const N: usize = 26;
/// Covariance.
pub(super) type Covariance = SMatrix<f64, N, N>;
/// Error state, or a row of H.
pub(super) type ErrorState = SVector<f64, N>;

/// One-sigmas at start: gyroscope bias, rad/s …
const GYRO_BIAS_SIGMA: f64 = 0.5 * DEGREE;
/// … each entry of S …
const GYRO_MATRIX_SIGMA: f64 = 0.005;
/// … accelerometer bias, m/s² …
const ACCEL_BIAS_SIGMA: f64 = 0.02;
/// … field, µT …
const FIELD_SIGMA: f64 = 20.0;
/// … hard iron of a calibrated magnetometer, µT …
const HARD_IRON_SIGMA: f64 = 0.5;
/// … lag, s …
const LAG_SIGMA: f64 = 0.02;
/// … tilt once the first mean is known, rad …
const TILT_SIGMA: f64 = 0.15;
/// … and velocity, m/s.
const VELOCITY_SIGMA: f64 = 1.0;

/// Noise of one second, one-sigma: tilt, rad …
const TILT_WALK: f64 = 0.35 * DEGREE;
/// … heading, rad …
const HEADING_WALK: f64 = 0.1 * DEGREE;
/// … both for each rad/s of turning, rad …
const TURNING_WALK: f64 = 0.001;
/// … velocity, m/s …
const VELOCITY_WALK: f64 = 0.1;
/// … gyroscope bias, up to its one-sigma at start, rad/s …
const GYRO_BIAS_WALK: f64 = 0.01 * DEGREE;
/// … field, µT …
const FIELD_WALK: f64 = 0.03;
/// … hard iron, µT.
const HARD_IRON_WALK: f64 = 0.005;

/// Error states that propagation changes otherwise than by a walk.
const CHANGED: [usize; 6] = [ix::TILT, ix::TILT + 1, ix::VELOCITY, ix::VELOCITY + 1, ix::FIELD, ix::FIELD + 1];

/// P before the first sample.
pub(super) fn prior() -> Covariance {
    let mut sigma = ErrorState::zeros();
    for (first, count, value) in [
        (ix::TILT, 2, TILT_SIGMA),
        (ix::VELOCITY, 2, VELOCITY_SIGMA),
        (ix::GYRO_MATRIX, 9, GYRO_MATRIX_SIGMA),
        (ix::ACCEL_BIAS, 3, ACCEL_BIAS_SIGMA),
        (ix::GYRO_BIAS, 3, GYRO_BIAS_SIGMA),
        (ix::FIELD, 3, FIELD_SIGMA),
        (ix::HARD_IRON, 3, HARD_IRON_SIGMA),
        (ix::LAG, 1, LAG_SIGMA),
    ] {
        sigma.rows_mut(first, count).fill(value);
    }
    Covariance::from_diagonal(&sigma.map(|s| s * s))
}

/// Forgets tilt, velocity and field; what was learned of the sensors stays.
pub(super) fn restart(p: &mut Covariance) {
    for (first, count, sigma) in
        [(ix::TILT, 2, TILT_SIGMA), (ix::VELOCITY, 2, VELOCITY_SIGMA), (ix::FIELD, 3, FIELD_SIGMA)]
    {
        (first..first + count).for_each(|i| kalman::forget(p, i, sigma * sigma));
    }
}

/// The row of H that is state `i` itself.
pub(super) fn unit(i: usize) -> ErrorState {
    let mut h = ErrorState::zeros();
    h[i] = 1.0;
    h
}

/// What one sample propagates P by.
pub(super) struct Propagation {
    /// Since the sample before, s.
    pub dt_s: f64,
    /// R.
    pub rotation: Matrix3<f64>,
    /// γ, rad/s.
    pub gamma: Vector3<f64>,
    /// ω, rad/s.
    pub rate: Vector3<f64>,
    /// f_z, m/s².
    pub force_up_mps2: f64,
    /// h, µT.
    pub field_ut: Vector3<f64>,
}

impl Propagation {
    /// F T, the rows of `CHANGED`: Φ = I + F T.
    fn rows(&self) -> SMatrix<f64, 6, N> {
        let Self { dt_s: t, rotation: r, gamma, force_up_mps2: f_z, field_ut: h, .. } = self;
        let mut f = SMatrix::<f64, 6, N>::zeros();
        // ε, and which multiple of it each row is.
        for (row, axis, factor) in [(0, 0, 1.0), (1, 1, 1.0), (4, 2, h.y), (5, 2, -h.x)] {
            for j in 0..3 {
                let of_bias = -t * factor * r[(axis, j)];
                f[(row, ix::GYRO_BIAS + j)] = of_bias;
                (0..3).for_each(|c| f[(row, ix::GYRO_MATRIX + 3 * j + c)] = of_bias * gamma[c]);
            }
        }
        f[(2, ix::TILT + 1)] = t * f_z;
        f[(3, ix::TILT)] = -t * f_z;
        for i in 0..2 {
            f[(2 + i, ix::VELOCITY + i)] = -t / VELOCITY_LEAK_S;
            (0..3).for_each(|j| f[(2 + i, ix::ACCEL_BIAS + j)] = -t * r[(i, j)]);
        }
        f
    }
}

/// P ← Φ P Φᵀ + Q over one sample.
pub(super) fn propagate(p: &mut Covariance, by: &Propagation) {
    let f = by.rows();
    // P Fᵀ: the rows of F are mostly zero.
    let mut pf = SMatrix::<f64, N, 6>::zeros();
    for (row, mut column) in pf.column_iter_mut().enumerate() {
        for j in 0..N {
            let factor = f[(row, j)];
            if factor != 0.0 {
                column.axpy(factor, &p.column(j), 1.0);
            }
        }
    }
    let fpf = f * pf;
    for (c, &place) in CHANGED.iter().enumerate() {
        for i in 0..N {
            p[(i, place)] += pf[(i, c)];
            p[(place, i)] += pf[(i, c)];
        }
    }
    for (i, &row) in CHANGED.iter().enumerate() {
        for (j, &column) in CHANGED.iter().enumerate() {
            // Symmetric to the last bit.
            p[(row, column)] += 0.5 * (fpf[(i, j)] + fpf[(j, i)]);
        }
    }
    add_noise(p, by);
}

/// Q over one sample.
fn add_noise(p: &mut Covariance, by: &Propagation) {
    let t = by.dt_s;
    let turning = TURNING_WALK.powi(2) * by.rate.norm_squared();
    for i in 0..2 {
        p[(ix::TILT + i, ix::TILT + i)] += t * (TILT_WALK.powi(2) + turning);
        p[(ix::VELOCITY + i, ix::VELOCITY + i)] += t * VELOCITY_WALK.powi(2);
    }
    for i in 0..3 {
        let bias = (ix::GYRO_BIAS + i, ix::GYRO_BIAS + i);
        if p[bias] < GYRO_BIAS_SIGMA.powi(2) {
            p[bias] += t * GYRO_BIAS_WALK.powi(2);
        }
        p[(ix::FIELD + i, ix::FIELD + i)] += t * FIELD_WALK.powi(2);
        p[(ix::HARD_IRON + i, ix::HARD_IRON + i)] += t * HARD_IRON_WALK.powi(2);
    }
    // Heading noise turns h.
    let (u, yaw) = ([by.field_ut.y, -by.field_ut.x], t * (HEADING_WALK.powi(2) + turning));
    for i in 0..2 {
        for j in 0..2 {
            p[(ix::FIELD + i, ix::FIELD + j)] += yaw * u[i] * u[j];
        }
    }
}
