//! A motor with its rotor: first-order lag of the speed behind the curve's steady speed.
//!
//! ω̇ = (ω_steady(command, voltage) − ω) / τ, with one τ for speeding up and one for slowing down.

use crate::model::airframe::Airframe;
use crate::types::ROTORS;

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

/// Observer of the rotors: their speeds as the applied commands and the motors' lag make them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rotors {
    speed_radps: [f64; ROTORS],
}

impl Rotors {
    /// After `dt_s` of `throttle` at `voltage_ratio` of the nominal voltage. A command that is not finite drives nothing,
    /// and a voltage that is not finite stops the observer.
    pub fn step(&mut self, airframe: &Airframe, throttle: &[f64; ROTORS], voltage_ratio: f64, dt_s: f64) {
        let throttle = throttle.map(|t| if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 });
        let steady = steady_speed(airframe, &throttle, voltage_ratio);
        let speed = after(airframe, &self.speed_radps, &steady, dt_s);
        self.speed_radps = if speed.iter().all(|w| w.is_finite()) { speed } else { [0.0; ROTORS] };
    }

    /// Speeds, rad/s.
    pub fn speed_radps(&self) -> &[f64; ROTORS] {
        &self.speed_radps
    }
}

/// Speeds after `dt_s` of a constant `steady_radps`: the exact solution of the lag.
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
    fn a_command_that_is_not_finite_drives_nothing_and_leaves_no_trace() {
        let airframe = Airframe::iris();
        let mut rotors = Rotors::default();
        rotors.step(&airframe, &[0.5, f64::NAN, f64::INFINITY, 2.0], 1.0, 10.0);
        let [half, nan, infinite, full] = *rotors.speed_radps();
        assert!(half > 0.0 && full > half && nan == 0.0 && infinite == 0.0);
        rotors.step(&airframe, &[0.5; 4], 1.0, 10.0);
        assert!(rotors.speed_radps().iter().all(|w| (w / half - 1.0).abs() < 1e-9));
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
