//! A random field over the room: what iron does to a magnetometer, what a floor's colours do to a laser.

use nalgebra::Vector3;
use plumbline_core::sensor::noise::Stream;

use super::normal3;

const WAVES: usize = 8;

/// Waves with wave vector (1/m), phase and amplitude.
#[derive(Debug, Clone)]
pub(super) struct Field([(Vector3<f64>, f64, Vector3<f64>); WAVES]);

impl Field {
    /// Of this one sigma in each component, and correlation exp(−d² / 2 L²) over a distance d, with L = `length_m`.
    pub(super) fn new(sigma: f64, length_m: f64, stream: &mut Stream) -> Self {
        let amplitude = sigma * (2.0 / WAVES as f64).sqrt();
        // Waves that are normal with 1/L.
        Self(std::array::from_fn(|_| {
            let k = normal3(stream) / length_m;
            (k, std::f64::consts::TAU * stream.uniform(), normal3(stream) * amplitude)
        }))
    }

    /// Its value at `place_m`.
    pub(super) fn at(&self, place_m: &Vector3<f64>) -> Vector3<f64> {
        self.0
            .iter()
            .fold(Vector3::zeros(), |sum, (k, phase, amplitude)| sum + amplitude * (k.dot(place_m) + phase).cos())
    }
}
