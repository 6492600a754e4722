//! Wrench ─► rotor thrusts ─► speeds ─► motor commands, with the saturation reported.
//!
//! t = A⁻¹ [T, τ]; A is the airframe's allocation. When that leaves the range of the rotors, what
//! is given up, in this order: yaw torque, then thrust, last roll and pitch torque; for these thrust is raised above
//! what was asked by `LENT` at most. The command inverts the motor curve at the battery's present voltage.
//!
//! A rotor found to give only the part e of its thrust ([`Mixer::weaken`]) is asked for t/e, and its range ends at e times
//! the full thrust.

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::model::airframe::Airframe;
use crate::types::{MotorCommand, ROTORS, Wrench};

/// A rotor that gives less than this part is asked for no more than that one would be.
pub const LEAST_EFFECTIVENESS: f64 = 0.2;
/// Command of motors that turn without lifting.
pub const IDLE_COMMAND: f64 = 0.05;
/// Relative to the largest rotor thrust: less is not reported as saturation.
const UNNOTICED: f64 = 1e-6;
/// Thrust that roll and pitch torque may add to what was asked, in weights: a vehicle that strings throw upwards is not
/// levelled at the price of a climb out of its box.
const LENT: f64 = 0.5;
/// Battery ratio is followed with this time constant, s: sag is slow, its measurement is not.
const VOLTAGE_TIME_CONSTANT_S: f64 = 0.2;
/// Voltage ratios outside this range are measurement errors.
const VOLTAGE_RATIO: (f64, f64) = (0.7, 1.25);

/// The mixer of one airframe.
#[derive(Debug, Clone)]
pub struct Mixer {
    airframe: Airframe,
    allocation: Matrix4<f64>,
    inverse: Matrix4<f64>,
    voltage_ratio: f64,
    thrust_ceiling_n: f64,
    effectiveness: Vector4<f64>,
}

/// What the mixer makes of a wrench.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mixed {
    /// For the motors.
    pub command: MotorCommand,
    /// The wrench these commands give in the steady state.
    pub given: Wrench,
    /// Does it differ from what was asked?
    pub saturated: bool,
    /// What was asked is no number: the least thrust, no torque.
    pub invalid: bool,
}

impl Mixer {
    /// For `airframe`, never above `thrust_ceiling_n` in total. `None` when its rotors cannot give
    /// every wrench (a valid airframe's can).
    pub fn new(airframe: &Airframe, thrust_ceiling_n: f64) -> Option<Self> {
        let allocation = airframe.allocation();
        let inverse = allocation.try_inverse()?;
        let effectiveness = Vector4::repeat(1.0);
        Some(Self {
            airframe: airframe.clone(),
            allocation,
            inverse,
            voltage_ratio: 1.0,
            thrust_ceiling_n,
            effectiveness,
        })
    }

    /// What each rotor gives of the thrust that its command should give, 1 for all of it. At less than
    /// [`LEAST_EFFECTIVENESS`] nothing is made up for any more.
    pub fn weaken(&mut self, effectiveness: &[f64; ROTORS]) {
        self.effectiveness = Vector4::from(*effectiveness).map(|e| e.clamp(LEAST_EFFECTIVENESS, 1.0));
    }

    /// Follows the battery's voltage; `None` (not measured) leaves the compensation as it is.
    pub fn battery(&mut self, voltage_v: Option<f64>, dt_s: f64) {
        let ratio = voltage_v.map(|v| v / self.airframe.battery.nominal_v());
        if let Some(ratio) = ratio.filter(|r| (VOLTAGE_RATIO.0..=VOLTAGE_RATIO.1).contains(r)) {
            let share = (dt_s / VOLTAGE_TIME_CONSTANT_S).clamp(0.0, 1.0);
            self.voltage_ratio += share * (ratio - self.voltage_ratio);
        }
    }

    /// Motors turning without lifting.
    pub fn idle(&self) -> MotorCommand {
        MotorCommand { throttle: [IDLE_COMMAND; ROTORS] }
    }

    /// Range of a healthy rotor's thrust at the present voltage, N.
    pub fn range_n(&self) -> (f64, f64) {
        let thrust = |command: f64| {
            let speed = self.airframe.motor_curve.speed_radps(command, self.voltage_ratio);
            self.airframe.thrust_coefficient_ns2 * speed * speed
        };
        (thrust(IDLE_COMMAND), thrust(1.0))
    }

    /// The commands for `asked`; one that is not finite gets the least thrust.
    pub fn mix(&self, asked: &Wrench) -> Mixed {
        let valid = asked.thrust_n.is_finite() && asked.torque_flu_nm.iter().all(|t| t.is_finite());
        if !valid {
            return Mixed { saturated: true, invalid: true, ..self.mix(&Wrench::default()) };
        }
        let (least, full) = self.range_n();
        let range = (&(self.effectiveness * least), &(self.effectiveness * full));
        let (low, high) = range;
        let column = |wrench: Vector4<f64>| self.inverse * wrench;
        let torque = asked.torque_flu_nm;

        // Roll and pitch torque first: as much as the range between idle and full can hold, and as it may lend.
        let tilt = column(Vector4::new(0.0, torque.x, torque.y, 0.0));
        let lift = column(Vector4::new(1.0, 0.0, 0.0, 0.0));
        let idle = thrust_range(&Vector4::zeros(), &lift, range).0;
        let ceiling = self.thrust_ceiling_n.min(asked.thrust_n.max(idle) + LENT * self.airframe.weight_n());
        let share = (0..=TILT_STEPS)
            .map(|step| 1.0 - f64::from(step) / f64::from(TILT_STEPS))
            .find(|&share| {
                let (least, most) = thrust_range(&(tilt * share), &lift, range);
                least <= most.min(ceiling)
            })
            .unwrap_or(0.0);
        let tilt = tilt * share;

        // Then thrust, between what the torque leaves.
        let (least, most) = thrust_range(&tilt, &lift, range);
        let thrust = asked.thrust_n.min(most.min(self.thrust_ceiling_n)).max(least);
        let rotors = tilt + lift * thrust;

        // Yaw takes what is left.
        let yaw = column(Vector4::new(0.0, 0.0, 0.0, torque.z));
        let bounds = low.iter().zip(high.iter());
        let share = rotors.iter().zip(yaw.iter()).zip(bounds).fold(1.0_f64, |share, ((&t, &y), (low, high))| {
            let room = if y > 0.0 {
                (high - t) / y
            } else if y < 0.0 {
                (low - t) / y
            } else {
                1.0
            };
            share.min(room.max(0.0))
        });
        let rotors = (rotors + yaw * share).sup(low).inf(high);

        let w = self.allocation * rotors;
        let given = Wrench { thrust_n: w.x, torque_flu_nm: Vector3::new(w.y, w.z, w.w) };
        let wanted = self.inverse * Vector4::new(asked.thrust_n, torque.x, torque.y, torque.z);
        let mut command = MotorCommand::default();
        let asked_of = rotors.component_div(&self.effectiveness);
        for (throttle, thrust) in command.throttle.iter_mut().zip(asked_of.iter()) {
            let speed = (thrust / self.airframe.thrust_coefficient_ns2).max(0.0).sqrt();
            *throttle = self.airframe.motor_curve.command(speed, self.voltage_ratio);
        }
        Mixed { command, given, saturated: (wanted - rotors).amax() > UNNOTICED * full, invalid: false }
    }
}

/// Tilt torque is given up in steps of 5 %.
const TILT_STEPS: u32 = 20;

/// Total thrusts that keep every rotor between the least and the most of its `range` on top of `tilt`.
fn thrust_range(tilt: &Vector4<f64>, lift: &Vector4<f64>, range: (&Vector4<f64>, &Vector4<f64>)) -> (f64, f64) {
    let bounds = range.0.iter().zip(range.1.iter());
    tilt.iter().zip(lift.iter()).zip(bounds).fold((0.0, f64::INFINITY), |(least, most), ((&t, &l), (low, high))| {
        if l > 0.0 { (f64::max(least, (low - t) / l), f64::min(most, (high - t) / l)) } else { (least, most) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrench(t: f64, x: f64, y: f64, z: f64) -> Wrench {
        Wrench { thrust_n: t, torque_flu_nm: Vector3::new(x, y, z) }
    }

    /// The wrench that the commands give, through the motor curve, at `voltage_ratio`.
    fn flown(airframe: &Airframe, command: &MotorCommand, voltage_ratio: f64) -> Wrench {
        airframe.wrench(&command.throttle.map(|c| airframe.motor_curve.speed_radps(c, voltage_ratio)))
    }

    #[test]
    fn mixing_then_flying_is_the_identity_at_any_voltage() {
        for name in Airframe::NAMES {
            let airframe = Airframe::by_name(name).unwrap();
            let weight = airframe.weight_n();
            for ratio in [1.0, 0.9, 1.1] {
                let mut mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
                for _ in 0..2000 {
                    mixer.battery(Some(ratio * airframe.battery.nominal_v()), 0.005);
                }
                let asked = wrench(weight, 0.02 * weight * 0.2, -0.03 * weight * 0.2, 0.002 * weight);
                let mixed = mixer.mix(&asked);
                let flown = flown(&airframe, &mixed.command, ratio);
                assert!(!mixed.saturated, "{name} {ratio}");
                assert!((flown.thrust_n - asked.thrust_n).abs() < 1e-6 * weight, "{name} {ratio} {flown:?}");
                assert!((flown.torque_flu_nm - asked.torque_flu_nm).norm() < 1e-6 * weight, "{name} {ratio}");
            }
        }
    }

    #[test]
    fn yaw_gives_way_first_then_thrust_never_tilt() {
        let airframe = Airframe::iris();
        let mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
        let most = airframe.max_thrust_n();
        // Full thrust and a roll torque: thrust is lowered until the torque fits.
        let mixed = mixer.mix(&wrench(most, 0.5, 0.0, 0.0));
        assert!(mixed.saturated && mixed.given.thrust_n < most - 1.0);
        assert!((mixed.given.torque_flu_nm - Vector3::new(0.5, 0.0, 0.0)).norm() < 1e-9, "{mixed:?}");
        // Too much yaw: thrust and tilt stay.
        let mixed = mixer.mix(&wrench(15.0, 0.1, 0.1, 9.0));
        assert!(mixed.saturated && (mixed.given.thrust_n - 15.0).abs() < 1e-9);
        assert!((mixed.given.torque_flu_nm.xy() - nalgebra::Vector2::new(0.1, 0.1)).norm() < 1e-9);
        assert!(mixed.given.torque_flu_nm.z > 0.1 && mixed.given.torque_flu_nm.z < 9.0);
        // No thrust asked: the torque is still given, with thrust.
        let mixed = mixer.mix(&wrench(0.0, 0.3, 0.0, 0.0));
        assert!((mixed.given.torque_flu_nm.x - 0.3).abs() < 1e-9 && mixed.given.thrust_n > 0.0);
    }

    #[test]
    fn levelling_lends_half_a_weight_of_thrust_at_most() {
        let airframe = Airframe::iris();
        let mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
        let weight = airframe.weight_n();
        for asked_n in [0.0, 0.3 * weight, weight] {
            let idle_n = mixer.mix(&wrench(asked_n, 0.0, 0.0, 0.0)).given.thrust_n;
            let levelled = mixer.mix(&wrench(asked_n, 4.0, 0.0, 0.0)).given;
            assert!(levelled.thrust_n <= idle_n + LENT * weight + 1e-9, "{asked_n}: {levelled:?}");
            assert!(levelled.torque_flu_nm.x > 1.0, "{asked_n}: {levelled:?}");
        }
    }

    #[test]
    fn commands_stay_in_range_and_under_the_ceiling() {
        let airframe = Airframe::paternain();
        let ceiling = 0.9 * airframe.weight_n();
        let mixer = Mixer::new(&airframe, ceiling).unwrap();
        for k in 0..5000_u32 {
            let pseudo =
                |salt: u32| f64::from((k.wrapping_mul(2_654_435_761) ^ salt.wrapping_mul(40_503)) % 1000) / 500.0 - 1.0;
            let asked = wrench(60.0 * pseudo(1), 5.0 * pseudo(2), 5.0 * pseudo(3), pseudo(4));
            let mixed = mixer.mix(&asked);
            assert!(mixed.command.throttle.iter().all(|c| (0.0..=1.0).contains(c)), "{asked:?}");
            assert!(mixed.given.thrust_n <= ceiling + 1e-9, "{asked:?} gives {:?}", mixed.given);
        }
    }

    #[test]
    fn what_is_no_number_gets_the_least_thrust() {
        let airframe = Airframe::iris();
        let mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
        for asked in
            [wrench(f64::NAN, 0.1, 0.0, 0.0), wrench(f64::INFINITY, 0.0, 0.0, 0.0), wrench(9.0, 0.0, f64::NAN, 0.0)]
        {
            let mixed = mixer.mix(&asked);
            assert!(mixed.invalid && mixed.saturated, "{asked:?}");
            for (command, idle) in mixed.command.throttle.iter().zip(mixer.idle().throttle) {
                assert!((command - idle).abs() < 1e-9, "{asked:?}: {command}");
            }
        }
        assert!(!mixer.mix(&wrench(9.0, 0.0, 0.0, 0.0)).invalid);
    }

    #[test]
    fn a_weakened_rotor_is_asked_for_more_and_the_wrench_stays() {
        let airframe = Airframe::iris();
        let weight = airframe.weight_n();
        let mut mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
        mixer.weaken(&[1.0, 0.7, 1.0, 0.9]);
        let given = |mixed: &Mixed| {
            let mut speeds = mixed.command.throttle.map(|c| airframe.motor_curve.speed_radps(c, 1.0));
            (speeds[1], speeds[3]) = (speeds[1] * 0.7_f64.sqrt(), speeds[3] * 0.9_f64.sqrt());
            airframe.wrench(&speeds)
        };
        for asked in [wrench(weight, 0.1, -0.05, 0.01), wrench(0.9 * weight, -0.1, 0.1, -0.02)] {
            let mixed = mixer.mix(&asked);
            let flown = given(&mixed);
            assert!(!mixed.saturated, "{mixed:?}");
            assert!((flown.thrust_n - asked.thrust_n).abs() < 1e-6 * weight, "{flown:?}");
            assert!((flown.torque_flu_nm - asked.torque_flu_nm).norm() < 1e-6 * weight, "{flown:?}");
        }
        // Beyond what it can give thrust is given up before roll and pitch, as ever.
        mixer.weaken(&[1.0, 0.4, 1.0, 1.0]);
        let mixed = mixer.mix(&wrench(1.3 * weight, 0.1, 0.0, 0.0));
        assert!(mixed.saturated && mixed.given.thrust_n < weight, "{mixed:?}");
        assert!((mixed.given.torque_flu_nm.xy() - nalgebra::Vector2::new(0.1, 0.0)).norm() < 1e-9, "{mixed:?}");
    }

    #[test]
    fn absurd_voltages_are_ignored() {
        let airframe = Airframe::iris();
        let mut mixer = Mixer::new(&airframe, f64::INFINITY).unwrap();
        let before = mixer.mix(&wrench(15.0, 0.0, 0.0, 0.0));
        for v in [Some(0.0), Some(f64::NAN), Some(40.0), None] {
            mixer.battery(v, 1.0);
        }
        assert_eq!(mixer.mix(&wrench(15.0, 0.0, 0.0, 0.0)), before);
    }
}
