//! What an accelerometer away from the centre of mass feels of rotation: ω̇ × r + ω × (ω × r) on top of the centre's
//! specific force.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | ω, ω̇ | angular rate and acceleration, body FLU | rad/s, rad/s² |
//! | r | the accelerometer's place from the centre of mass, body FLU | m |

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

/// Time constant of ω̇, s: with a longer one it would lag, and accelerometers away from the centre would contradict each
/// other whenever a turn begins.
const TURNING_S: f64 = 0.005;
/// Rates further apart in time say nothing of ω̇, s.
const LONGEST_GAP_S: f64 = 0.1;

/// ω̇ from the rates of the gyroscopes.
#[derive(Debug, Clone, Default)]
pub struct LeverArm {
    rate: Option<(FlightTime, Vector3<f64>)>,
    turning_radps2: Vector3<f64>,
}

impl LeverArm {
    /// The gyroscopes' rate at `now`.
    pub fn push(&mut self, now: FlightTime, rate_radps: &Vector3<f64>) {
        if let Some((time, before)) = self.rate {
            let dt_s = now.seconds_since(time);
            if dt_s > 0.0 && dt_s < LONGEST_GAP_S {
                let turning = (rate_radps - before) / dt_s;
                self.turning_radps2 += (turning - self.turning_radps2) * (dt_s / (TURNING_S + dt_s));
            } else {
                self.turning_radps2 = Vector3::zeros();
            }
        }
        self.rate = Some((now, *rate_radps));
    }

    /// The last rate, rad/s.
    pub fn rate_radps(&self) -> Vector3<f64> {
        self.rate.map_or_else(Vector3::zeros, |(_, rate)| rate)
    }

    /// What is felt at `place_flu_m` at the true rate `rate_radps`, m/s².
    pub fn acceleration_mps2(&self, place_flu_m: &Vector3<f64>, rate_radps: &Vector3<f64>) -> Vector3<f64> {
        self.turning_radps2.cross(place_flu_m) + rate_radps.cross(&rate_radps.cross(place_flu_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spin_is_felt_outwards_and_its_growth_along_the_turn() {
        let mut arm = LeverArm::default();
        let place = Vector3::new(0.1, 0.0, 0.0);
        // 2 rad/s, growing by 10 rad/s² about z.
        for k in 0..200_u64 {
            arm.push(FlightTime(k * 1000), &Vector3::new(0.0, 0.0, 2.0 + 0.01 * (k as f64 - 199.0)));
        }
        let felt = arm.acceleration_mps2(&place, &arm.rate_radps());
        assert!((felt - Vector3::new(-0.4, 1.0, 0.0)).norm() < 1e-6, "{felt}");
    }
}
