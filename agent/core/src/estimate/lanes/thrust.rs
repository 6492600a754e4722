//! What the motors do, as commanded: whether they stand, and whether anything but them and the air holds the vehicle.

use nalgebra::Vector3;

use crate::model::airframe::Airframe;
use crate::model::motor::Rotors;
use crate::sensor::SensorFrame;
use crate::types::MotorCommand;

/// Throttle of motors that stand.
const STANDING: f64 = 1e-3;
/// Less thrust than this part of the weight does not fly.
const FLYING: f64 = 0.5;
/// Thrust that explains the specific force along it to this part of the weight: nothing else holds the vehicle.
const FREE: f64 = 0.25;
/// Time constant with which the part is learned by which the thrust is not as commanded, s, and the largest.
const LEARNED_S: f64 = 5.0;
const OFF_MAX: f64 = 0.25;

/// Observer of the thrust over the mass.
#[derive(Debug, Clone)]
pub struct Thrust {
    airframe: Airframe,
    rotors: Rotors,
    voltage_ratio: f64,
    gravity_mps2: f64,
    /// Part by which the thrust over the mass is less than commands and battery say: mass, propellers, air.
    off: f64,
}

impl Thrust {
    /// Of motors that stand.
    pub fn new(airframe: &Airframe, gravity_mps2: f64) -> Self {
        Self { airframe: airframe.clone(), rotors: Rotors::default(), voltage_ratio: 1.0, gravity_mps2, off: 0.0 }
    }

    /// After a tick with `applied`: thrust over mass, m/s², and whether the motors are told to stand.
    pub fn step(&mut self, frame: &SensorFrame, applied: &MotorCommand, dt_s: f64) -> (f64, bool) {
        if let Some(v) = frame.battery_v.filter(|v| v.is_finite() && *v > 0.0) {
            self.voltage_ratio = v / self.airframe.battery.nominal_v();
        }
        self.rotors.step(&self.airframe, &applied.throttle, self.voltage_ratio, dt_s.clamp(0.0, 0.1));
        let thrust_n = self.airframe.wrench(self.rotors.speed_radps()).thrust_n;
        ((1.0 - self.off) * thrust_n / self.airframe.mass_kg, applied.throttle.iter().all(|t| t.abs() < STANDING))
    }

    /// Angular acceleration that the rotors' torques give a body turning at `rate_radps`, rad/s².
    pub fn turning_radps2(&self, rate_radps: &Vector3<f64>) -> Vector3<f64> {
        let inertia = self.airframe.inertia_kgm2;
        let gyroscopic = rate_radps.cross(&inertia.component_mul(rate_radps));
        (self.airframe.wrench(self.rotors.speed_radps()).torque_flu_nm - gyroscopic).component_div(&inertia)
    }

    /// After a slot with `share` of the specific force from a thrust over mass of `thrust_mps2`, which what measures the altitude corrected
    /// by `corrected_mps` of climb: corrections to one side for long say that the thrust is not as commanded.
    pub fn learn(&mut self, corrected_mps: f64, share: f64, thrust_mps2: f64) {
        if self.flies(thrust_mps2) {
            self.off = (self.off - share * corrected_mps / (LEARNED_S * thrust_mps2)).clamp(-OFF_MAX, OFF_MAX);
        }
    }

    /// Is so much thrust over mass meant to fly?
    pub fn flies(&self, thrust_mps2: f64) -> bool {
        thrust_mps2 > FLYING * self.gravity_mps2
    }

    /// Drag over mass, 1/s, where thrust explains the specific force `up_mps2` along body z; `None` on strings or on the
    /// ground, where something else holds the vehicle.
    pub fn drag(&self, thrust_mps2: f64, up_mps2: f64) -> Option<f64> {
        let free = (thrust_mps2 - up_mps2).abs() < FREE * self.gravity_mps2;
        (free && self.flies(thrust_mps2)).then(|| self.airframe.linear_drag_nspm / self.airframe.mass_kg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::ROTORS;

    fn hovering(thrust: &mut Thrust, throttle: f64) -> f64 {
        let applied = MotorCommand { throttle: [throttle; ROTORS] };
        (0..200).map(|_| thrust.step(&SensorFrame::default(), &applied, 0.005).0).last().unwrap()
    }

    /// GIVEN a vehicle whose rotors lift a tenth less than commanded WHEN its altitude is measured for a while THEN the thrust is known,
    /// and nothing is learned where accelerometers say all, or of a vehicle that stands.
    #[test]
    fn a_thrust_that_is_not_as_commanded_is_learned() {
        let g = 9.81;
        let learned = |share: f64, throttle: f64| {
            let mut thrust = Thrust::new(&Airframe::iris(), g);
            let commanded = hovering(&mut thrust, throttle);
            for _ in 0..(20.0 / 0.04) as usize {
                let told = hovering(&mut thrust, throttle);
                thrust.learn(share * (0.9 * commanded - told) * 0.04, share, told);
            }
            hovering(&mut thrust, throttle) / commanded
        };
        assert!((learned(1.0, 0.6) - 0.9).abs() < 0.01, "{}", learned(1.0, 0.6));
        assert_eq!([learned(0.0, 0.6), learned(1.0, 0.2)], [1.0, 1.0]);
    }
}
