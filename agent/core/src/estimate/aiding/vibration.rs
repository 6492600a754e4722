//! How much the consensus of the IMUs changes from sample to sample: vibration, which no data sheet tells.

use nalgebra::Vector3;

/// Time constant of what is taken for vibration, s.
const MEAN_S: f64 = 1.0;
/// Noise density of what it leaves, per one-sigma of a sample about the one before over √2, √s: so that errors are as large as said in
/// the world `datasheet` (NEES).
const DENSITY: f64 = 0.01;
/// Part of the squares that an accelerometer takes for an acceleration upward, 1/(m/s²): clipping and its own filter; and for how long, s.
const RECTIFIES_PER_MPS2: f64 = 0.03;
const RECTIFIES_S: f64 = 2.0;
/// The same in the plane, for good: so that tilt is off by as much as said in the world `harsh` (NEES).
const TILTS_PER_MPS2: f64 = 0.035;

/// See the module. Mean squares of changes over 2, body FLU, (m/s²)² and (rad/s)².
#[derive(Debug, Clone, Copy, Default)]
pub struct Vibration {
    accel: Vector3<f64>,
    gyro: Vector3<f64>,
}

impl Vibration {
    /// Takes by how much specific force (m/s²) and angular rate (rad/s) changed in `dt_s`, from one sample to the next.
    pub fn take(&mut self, dt_s: f64, accel_mps2: &Vector3<f64>, gyro_radps: &Vector3<f64>) {
        let gain = (dt_s / MEAN_S).clamp(0.0, 1.0);
        for (mean, change) in [(&mut self.accel, accel_mps2), (&mut self.gyro, gyro_radps)] {
            *mean += (change.component_mul(change) * 0.5 - *mean) * gain;
        }
    }

    /// What an accelerometer in the plane rectifies, one sigma, m/s²: nothing tells it from gravity.
    pub fn lasting_mps2(&self) -> f64 {
        TILTS_PER_MPS2 * self.accel.mean()
    }

    /// Walk of each axis of an accelerometer's bias, (m/s²)²/s, and the variance beyond which it stops, of what they are at rest. Upward
    /// alone: in the plane nothing tells a bias from tilt.
    pub fn widens(&self, walk: f64, most: f64) -> [(f64, f64); 3] {
        let rectified = (RECTIFIES_PER_MPS2 * self.accel.mean()).powi(2);
        [(walk, most), (walk, most), (walk + rectified / RECTIFIES_S, most + rectified)]
    }

    /// Squares of the noise densities of accelerometers and gyroscopes, body FLU, (m/s²)²/Hz and (rad/s)²/Hz.
    pub fn densities(&self) -> [Vector3<f64>; 2] {
        [self.accel, self.gyro].map(|squares| squares * (DENSITY * DENSITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shakes_from_sample_to_sample_is_noise_and_a_steady_turn_is_none() {
        let densities = |accel: fn(u64) -> f64| {
            let mut vibration = Vibration::default();
            for k in 1..1000 {
                vibration.take(0.01, &(Vector3::z() * (accel(k) - accel(k - 1))), &Vector3::zeros());
            }
            vibration.densities().map(|density| density.map(f64::sqrt))
        };
        let [accel, gyro] = densities(|k| if k.is_multiple_of(2) { 12.0 } else { 8.0 });
        assert!((accel.z - DENSITY * 4.0 / std::f64::consts::SQRT_2).abs() < 1e-4, "{accel}");
        assert_eq!((accel.x, gyro.norm()), (0.0, 0.0));
        assert!(densities(|k| 9.81 + 0.001 * k as f64)[0].z < 1e-5);
    }
}
