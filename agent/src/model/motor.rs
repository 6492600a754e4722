//! A motor with its rotor: first-order lag of the speed behind the curve's steady speed.
//!
//! ω̇ = (ω_steady(command, voltage) − ω) / τ, with one τ for speeding up and one for slowing down.

use crate::model::airframe::Airframe;
use crate::vehicle::ROTORS;

/// Rotor accelerations (rad/s²) towards `steady_radps`.
pub fn acceleration(airframe: &Airframe, speed_radps: &[f64; ROTORS], steady_radps: &[f64; ROTORS]) -> [f64; ROTORS] {
    std::array::from_fn(|i| {
        let missing = steady_radps[i] - speed_radps[i];
        let tau =
            if missing >= 0.0 { airframe.motor_rise_time_constant_s } else { airframe.motor_fall_time_constant_s };
        missing / tau
    })
}

/// Steady speeds (rad/s) for `throttle` (0..1 each) at `voltage_ratio` of the nominal voltage.
pub fn steady_speed(airframe: &Airframe, throttle: &[f64; ROTORS], voltage_ratio: f64) -> [f64; ROTORS] {
    throttle.map(|command| airframe.motor_curve.speed_radps(command, voltage_ratio))
}

/// Speeds after `dt_s` of a constant `steady_radps`: the exact solution of the lag, for estimators that
/// carry the rotor speeds along.
pub fn after(
    airframe: &Airframe,
    speed_radps: &[f64; ROTORS],
    steady_radps: &[f64; ROTORS],
    dt_s: f64,
) -> [f64; ROTORS] {
    std::array::from_fn(|i| {
        let missing = steady_radps[i] - speed_radps[i];
        let tau =
            if missing >= 0.0 { airframe.motor_rise_time_constant_s } else { airframe.motor_fall_time_constant_s };
        steady_radps[i] - missing * (-dt_s / tau).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reaches_63_percent_after_one_time_constant_each_way() {
        let a = Airframe::iris();
        let up = after(&a, &[0.0; 4], &[800.0; 4], a.motor_rise_time_constant_s);
        assert!((up[0] / 800.0 - 0.632_120_558).abs() < 1e-6);
        let down = after(&a, &[800.0; 4], &[0.0; 4], a.motor_fall_time_constant_s);
        assert!((down[0] / 800.0 - 0.367_879_441).abs() < 1e-6);
    }

    #[test]
    fn acceleration_is_the_derivative_of_the_exact_solution() {
        let a = Airframe::iris();
        let h = 1e-7;
        for (speed, steady) in [(300.0, 800.0), (800.0, 300.0)] {
            let numeric = (after(&a, &[speed; 4], &[steady; 4], h)[0] - speed) / h;
            assert!((numeric / acceleration(&a, &[speed; 4], &[steady; 4])[0] - 1.0).abs() < 1e-4);
        }
    }
}
