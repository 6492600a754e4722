//! What the motors do, as commanded: whether they stand, and whether anything but them and the air holds the vehicle.

use nalgebra::{Vector2, Vector3};

use super::SLOT_S;
use crate::model::airframe::Airframe;
use crate::model::motor::Rotors;
use crate::sensor::SensorFrame;
use crate::types::MotorCommand;

/// Throttle of motors that stand.
const STANDING: f64 = 1e-3;
/// Less thrust than this part of the weight does not fly.
const FLYING: f64 = 0.5;
/// Thrust that explains the specific force along it to this part of the weight: nothing else holds the vehicle up.
const FREE: f64 = 0.25;
/// Specific force in the rotors' plane beyond so many sigmas of what the biases of all IMUs make of it together, for long: strings hold
/// the vehicle aside. Time constant of its mean, s.
const ASIDE: f64 = 3.0;
const ASIDE_S: f64 = 8.0;
/// Time constant of the mean of the specific force beside the thrust, s.
const BESIDE_S: f64 = 0.2;
/// By so much beyond drag a rig or a hand holds it, m/s².
const HELD_MPS2: f64 = 1.0;
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
    /// Specific force in the rotors' plane, mean over [`ASIDE_S`] in flight, m/s².
    aside_mps2: Vector2<f64>,
    /// Specific force along the thrust beside it, mean over [`BESIDE_S`] in flight, m/s².
    beside_mps2: f64,
}

impl Thrust {
    /// Of motors that stand.
    pub fn new(airframe: &Airframe, gravity_mps2: f64) -> Self {
        let (airframe, rotors, aside_mps2) = (airframe.clone(), Rotors::default(), Vector2::zeros());
        Self { airframe, rotors, voltage_ratio: 1.0, gravity_mps2, off: 0.0, aside_mps2, beside_mps2: 0.0 }
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

    /// After a slot with `thrust_mps2` and a specific force of `force_mps2` along it: what else held the vehicle lately, m/s².
    pub fn beside_mps2(&mut self, thrust_mps2: f64, force_mps2: f64) -> f64 {
        let beside_mps2 = if self.flies(thrust_mps2) { force_mps2 - thrust_mps2 } else { 0.0 };
        if beside_mps2.is_finite() {
            self.beside_mps2 += (beside_mps2 - self.beside_mps2) * (SLOT_S / BESIDE_S);
        }
        self.beside_mps2
    }

    /// Is so much thrust over mass meant to fly?
    pub fn flies(&self, thrust_mps2: f64) -> bool {
        thrust_mps2 > FLYING * self.gravity_mps2
    }

    /// After a slot with `thrust_mps2`, the specific force `force_mps2` and the speed `speed_mps`, body FLU, where the biases of all IMUs
    /// together may be `bias_mps2`: drag over mass, 1/s; `None` on strings or on the ground, where something else holds the vehicle.
    /// What strings hold aside for long would be learned as bias, and the vehicle, level by what is left, leans on them the more.
    pub fn drag(
        &mut self,
        thrust_mps2: f64,
        force_mps2: &Vector3<f64>,
        speed_mps: &Vector3<f64>,
        bias_mps2: f64,
    ) -> Option<f64> {
        let drag = self.airframe.linear_drag_nspm / self.airframe.mass_kg;
        let flies = self.flies(thrust_mps2);
        // Beyond drag.
        let aside_mps2 = if flies { force_mps2.xy() + speed_mps.xy() * drag } else { Vector2::zeros() };
        let gain = if flies { SLOT_S / ASIDE_S } else { 1.0 };
        if aside_mps2.iter().all(|x| x.is_finite()) {
            self.aside_mps2 += (aside_mps2 - self.aside_mps2) * gain;
        }
        let up = (thrust_mps2 - force_mps2.z).abs() < FREE * self.gravity_mps2;
        let free = up && self.aside_mps2.norm() < ASIDE * bias_mps2 && aside_mps2.norm() < HELD_MPS2;
        (free && flies).then_some(drag)
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

    /// GIVEN a tether that pulls by 5 m/s² THEN that is known within half a second, and forgotten as soon when it is slack or the vehicle
    /// stands; one sample that is no number changes nothing.
    #[test]
    fn what_holds_the_vehicle_beside_its_thrust_is_known() {
        let g = 9.81;
        let mut thrust = Thrust::new(&Airframe::iris(), g);
        let mut after = |thrust_mps2: f64, force_mps2: f64, slots: u32| {
            (0..slots).map(|_| thrust.beside_mps2(thrust_mps2, force_mps2)).last().unwrap()
        };
        assert!((after(g + 5.0, g, 13) + 5.0).abs() < 0.4);
        assert!((after(g, f64::NAN, 1) + 5.0).abs() < 0.4);
        assert!(after(g, g, 13).abs() < 0.4);
        assert!(after(0.0, g, 13).abs() < 0.1);
    }

    /// GIVEN a vehicle in the air WHEN strings hold it aside for long, or a hand hard, THEN drag explains nothing, until they let go; gusts, biases
    /// and a stand on a slope before it change nothing.
    #[test]
    fn what_strings_hold_aside_for_long_is_no_drag() {
        let g = 9.81;
        let mut thrust = Thrust::new(&Airframe::iris(), g);
        let mut slots = |seconds: f64, lift: f64, aside_mps2: f64| {
            let force = Vector3::new(0.6 * aside_mps2, 0.8 * aside_mps2, g);
            let told =
                (0..(seconds / SLOT_S) as usize).map(|_| thrust.drag(lift, &force, &Vector3::zeros(), 0.1).is_some());
            told.last().unwrap()
        };
        let told = [
            slots(10.0, 0.0, 2.0),
            slots(10.0, g, 0.25),
            slots(1.0, g, 0.9),
            slots(10.0, g, 0.0),
            slots(20.0, g, 0.5),
            slots(15.0, g, 0.0),
            slots(0.1, g, 2.0),
            slots(0.1, g, 0.0),
            slots(1.0, g, f64::NAN),
            slots(1.0, 0.7 * g, 0.0),
        ];
        assert_eq!(told, [false, true, true, true, false, true, false, true, false, false]);
    }
}
