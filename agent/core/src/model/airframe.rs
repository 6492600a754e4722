//! Airframes as data: mass, inertia, rotor places and spins; no sign is written in code elsewhere.
//!
//! Sources: the 3DR Iris of \[Umasankar\] (mass and inertia), the vehicle of \[Paternain\] II–III, the model
//! of \[Clinic\] 3.2. What a source does not give is said at the constructor that chose it.
//!
//! | symbol | field | unit |
//! |---|---|---|
//! | m | `mass_kg` | kg |
//! | Ixx Iyy Izz | `inertia_kgm2` | kg m², about the centre of mass, body axes principal |
//! | k | `thrust_coefficient_ns2` | N s² (T = k ω²) |
//! | b | `drag_torque_coefficient_nms2` | N m s² (Q = b ω²) |
//! | k_d | `linear_drag_nspm` | N s/m (\[Clinic\] Eq. 2: F_D = −k_d v) |
//! | – | `propeller_diameter_m` | m; the power that thrust takes |
//! | I_zzm | `rotor_inertia_kgm2` | kg m², one rotor with its motor bell |
//! | d | `cg_below_rotors_m` | m; matters on a pivot rig only (ERRATA \[Paternain\] 4) |

use nalgebra::{Matrix4, Vector3};
use serde::Deserialize;

use crate::model::battery::BatteryPack;
use crate::model::motor_curve::MotorCurve;
use crate::types::{GRAVITY_MPS2, ROTORS, Wrench};

/// Density of the air at 15 °C and sea level, kg/m³.
pub const AIR_DENSITY_KGPM3: f64 = 1.225;

/// Which way a rotor turns, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spin {
    /// Angular velocity along +z of the body; its reaction turns the body clockwise.
    CounterClockwise,
    /// Angular velocity along −z of the body.
    Clockwise,
}

impl Spin {
    /// +1 for a rotor whose angular velocity points up, −1 for the other.
    pub fn sign(self) -> f64 {
        match self {
            Self::CounterClockwise => 1.0,
            Self::Clockwise => -1.0,
        }
    }
}

/// One rotor; thrust along the body's +z.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotor {
    /// Hub, from the centre of mass, body FLU, m.
    pub position_flu_m: Vector3<f64>,
    /// Which way it turns.
    pub spin: Spin,
}

/// A quadrotor as data. Build by name or from TOML; both are validated.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Airframe {
    /// Short name, as used in scenarios.
    pub name: String,
    /// Mass with battery, kg.
    pub mass_kg: f64,
    /// Principal moments of inertia about the centre of mass, kg m².
    pub inertia_kgm2: Vector3<f64>,
    /// The rotors, in the order of the motor commands.
    pub rotors: [Rotor; ROTORS],
    /// T = k ω², N s².
    pub thrust_coefficient_ns2: f64,
    /// Q = b ω², N m s².
    pub drag_torque_coefficient_nms2: f64,
    /// F_D = −k_d v, N s/m (\[Clinic\] Eq. 2).
    pub linear_drag_nspm: f64,
    /// Diameter of its propellers, m: with the thrust it gives the power, which b of a Gazebo model does not.
    #[serde(default = "ten_inches")]
    pub propeller_diameter_m: f64,
    /// Moment of inertia of one rotor about its axis, kg m².
    pub rotor_inertia_kgm2: f64,
    /// Time constant of the motor's first-order lag when it speeds up, s.
    pub motor_rise_time_constant_s: f64,
    /// The same when it slows down, s.
    pub motor_fall_time_constant_s: f64,
    /// Command ─► speed at nominal voltage (\[Clinic\] 5.5).
    pub motor_curve: MotorCurve,
    /// How far the centre of mass lies below the rotor plane, m (\[Paternain\] Eq. 2, `d`).
    pub cg_below_rotors_m: f64,
    /// Feet, from the centre of mass, body FLU, m.
    pub feet_flu_m: [Vector3<f64>; 4],
    /// Its battery.
    pub battery: BatteryPack,
}

/// Why an airframe cannot be flown.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AirframeError {
    /// The name is not one of ours.
    #[error("airframe \"{0}\" is unknown; known are iris, paternain, clinic")]
    Unknown(String),
    /// Not TOML, or not the fields of an airframe.
    #[error("airframe: {0}")]
    Syntax(String),
    /// A value is out of its range.
    #[error("airframe {name}: {key} = {value} is not {expected}")]
    Value {
        /// Airframe.
        name: String,
        /// The key.
        key: String,
        /// The offending value.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
}

impl Airframe {
    /// Names accepted by [`Airframe::by_name`].
    pub const NAMES: [&str; 3] = ["iris", "paternain", "clinic"];

    /// The airframe called `name`.
    ///
    /// # Errors
    /// [`AirframeError::Unknown`] naming it.
    pub fn by_name(name: &str) -> Result<Self, AirframeError> {
        match name {
            "iris" => Ok(Self::iris()),
            "paternain" => Ok(Self::paternain()),
            "clinic" => Ok(Self::clinic()),
            other => Err(AirframeError::Unknown(other.to_owned())),
        }
    }

    /// Reads and validates an airframe written as TOML.
    ///
    /// # Errors
    /// [`AirframeError`] naming the key and its value.
    pub fn from_toml(text: &str) -> Result<Self, AirframeError> {
        let airframe: Self = toml::from_str(text).map_err(|e| AirframeError::Syntax(e.to_string()))?;
        airframe.validate()?;
        Ok(airframe)
    }

    /// 3DR Iris: mass and inertia of \[Umasankar\]. Rotor places, thrust (5.84e-6 N s²) and torque
    /// (0.06 m × thrust) coefficients, time constants (12.5 and 25 ms) and the curve 100 + 1000 · command
    /// rad/s are those of the Gazebo Iris model which that paper flies. Chosen here: rotor inertia (an 11 g,
    /// 10-inch blade pair as a thin rod), linear drag, feet, battery (3S, 5.1 Ah).
    pub fn iris() -> Self {
        let rotor = |x, y, spin| Rotor { position_flu_m: Vector3::new(x, y, 0.023), spin };
        Self {
            name: "iris".into(),
            mass_kg: 1.545,
            inertia_kgm2: Vector3::new(0.029125, 0.029125, 0.055225),
            rotors: [
                rotor(0.13, -0.22, Spin::CounterClockwise),
                rotor(-0.13, 0.20, Spin::CounterClockwise),
                rotor(0.13, 0.22, Spin::Clockwise),
                rotor(-0.13, -0.20, Spin::Clockwise),
            ],
            thrust_coefficient_ns2: 5.84e-6,
            drag_torque_coefficient_nms2: 0.06 * 5.84e-6,
            linear_drag_nspm: 0.30,
            propeller_diameter_m: ten_inches(),
            rotor_inertia_kgm2: 5.9e-5,
            motor_rise_time_constant_s: 0.0125,
            motor_fall_time_constant_s: 0.025,
            motor_curve: MotorCurve { offset_radps: 100.0, slope_radps: 1000.0 },
            cg_below_rotors_m: 0.023,
            feet_flu_m: square_feet(0.14, 0.11),
            battery: BatteryPack::lipo(3, 5.1, 0.015),
        }
    }

    /// The vehicle of \[Paternain\]: rotors on the axes, 61.5 cm between opposite ones, 2 and 4 clockwise,
    /// 990 g without payload. The source gives neither inertia nor coefficients; chosen here: 0.41 kg of
    /// payload (computer, box, guards) so 1.40 kg, inertia of crossed rods with motors at their ends,
    /// thrust and drag torque of a 10-inch propeller, d = 5 cm (also used for the figure in ERRATA).
    pub fn paternain() -> Self {
        const L: f64 = 0.615 / 2.0;
        let rotor = |x, y, spin| Rotor { position_flu_m: Vector3::new(x, y, 0.05), spin };
        Self {
            name: "paternain".into(),
            mass_kg: 1.40,
            inertia_kgm2: Vector3::new(0.0216, 0.0216, 0.0410),
            // [Paternain] Eq. 2: roll from L (T2 − T4), pitch from L (T3 − T1), yaw from −Q1 + Q2 − Q3 + Q4.
            rotors: [
                rotor(L, 0.0, Spin::CounterClockwise),
                rotor(0.0, L, Spin::Clockwise),
                rotor(-L, 0.0, Spin::CounterClockwise),
                rotor(0.0, -L, Spin::Clockwise),
            ],
            thrust_coefficient_ns2: 1.616e-5,
            drag_torque_coefficient_nms2: 2.9e-7,
            linear_drag_nspm: 0.25,
            propeller_diameter_m: ten_inches(),
            rotor_inertia_kgm2: 6.5e-5,
            motor_rise_time_constant_s: 0.03,
            motor_fall_time_constant_s: 0.04,
            motor_curve: MotorCurve { offset_radps: 50.0, slope_radps: 600.0 },
            cg_below_rotors_m: 0.05,
            feet_flu_m: square_feet(0.12, 0.10),
            battery: BatteryPack::lipo(3, 4.0, 0.018),
        }
    }

    /// The model of \[Clinic\] 3.2, whose constants are not in the source: these are of the tutorial it
    /// adapted (\[Clinic\] reference 8), as in the reference linear models. Motor curve, lag, rotor inertia,
    /// feet and battery (14.8 V, \[Clinic\] 5.7) are chosen here.
    pub fn clinic() -> Self {
        const L: f64 = 0.25;
        let rotor = |x, y, spin| Rotor { position_flu_m: Vector3::new(x, y, 0.02), spin };
        Self {
            name: "clinic".into(),
            mass_kg: 0.5,
            inertia_kgm2: Vector3::new(5e-3, 5e-3, 10e-3),
            // [Clinic] Eq. 12–14: roll from L k (u1 − u3), pitch from L k (u2 − u4), yaw from b (u1 − u2 + u3 − u4).
            rotors: [
                rotor(0.0, L, Spin::Clockwise),
                rotor(-L, 0.0, Spin::CounterClockwise),
                rotor(0.0, -L, Spin::Clockwise),
                rotor(L, 0.0, Spin::CounterClockwise),
            ],
            thrust_coefficient_ns2: 3e-6,
            drag_torque_coefficient_nms2: 1e-7,
            linear_drag_nspm: 0.25,
            propeller_diameter_m: ten_inches(),
            rotor_inertia_kgm2: 1.2e-5,
            motor_rise_time_constant_s: 0.02,
            motor_fall_time_constant_s: 0.03,
            motor_curve: MotorCurve { offset_radps: 80.0, slope_radps: 870.0 },
            cg_below_rotors_m: 0.02,
            feet_flu_m: square_feet(0.10, 0.08),
            battery: BatteryPack::lipo(4, 3.3, 0.016),
        }
    }

    /// Checks every value; the first bad one is named.
    ///
    /// # Errors
    /// [`AirframeError::Value`].
    pub fn validate(&self) -> Result<(), AirframeError> {
        let bad = |key: &str, value: String, expected| {
            Err(AirframeError::Value { name: self.name.clone(), key: key.to_owned(), value, expected })
        };
        for (key, value) in [
            ("mass_kg", self.mass_kg),
            ("thrust_coefficient_ns2", self.thrust_coefficient_ns2),
            ("drag_torque_coefficient_nms2", self.drag_torque_coefficient_nms2),
            ("motor_rise_time_constant_s", self.motor_rise_time_constant_s),
            ("motor_fall_time_constant_s", self.motor_fall_time_constant_s),
            ("motor_curve.slope_radps", self.motor_curve.slope_radps),
            ("propeller_diameter_m", self.propeller_diameter_m),
            ("battery.capacity_ah", self.battery.capacity_ah),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return bad(key, value.to_string(), "a positive number");
            }
        }
        for (key, value) in [
            ("linear_drag_nspm", self.linear_drag_nspm),
            ("rotor_inertia_kgm2", self.rotor_inertia_kgm2),
            ("motor_curve.offset_radps", self.motor_curve.offset_radps),
            ("cg_below_rotors_m", self.cg_below_rotors_m),
            ("battery.internal_resistance_ohm", self.battery.internal_resistance_ohm),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return bad(key, value.to_string(), "zero or a positive number");
            }
        }
        if !(1..=12).contains(&self.battery.cells) {
            return bad("battery.cells", self.battery.cells.to_string(), "1 to 12");
        }
        let i = self.inertia_kgm2;
        if !i.iter().all(|v| v.is_finite() && *v > 0.0) {
            return bad("inertia_kgm2", list(&i), "three positive numbers");
        }
        // A body of positive mass: no principal moment exceeds the sum of the other two.
        if i.x > i.y + i.z || i.y > i.x + i.z || i.z > i.x + i.y {
            return bad("inertia_kgm2", list(&i), "the inertia of a real body (triangle inequality)");
        }
        for (index, rotor) in self.rotors.iter().enumerate() {
            if !rotor.position_flu_m.iter().all(|v| v.is_finite() && v.abs() <= 5.0) {
                let key = format!("rotors[{index}].position_flu_m");
                return bad(&key, list(&rotor.position_flu_m), "three numbers within 5 m");
            }
        }
        for (index, foot) in self.feet_flu_m.iter().enumerate() {
            if !foot.iter().all(|v| v.is_finite() && v.abs() <= 5.0) || foot.z >= 0.0 {
                return bad(&format!("feet_flu_m[{index}]"), list(foot), "a point below the centre of mass");
            }
        }
        if self.allocation().determinant().abs() < 1e-9 {
            return bad("rotors", "these places and spins".into(), "able to give thrust and all three torques");
        }
        let (most, weight) = (self.max_thrust_n(), self.weight_n());
        if most <= weight {
            let value = format!("{most:.2} N of thrust at full command");
            return bad("motor_curve", value, "enough to carry the weight");
        }
        Ok(())
    }

    /// Height of the centre of mass over the floor it stands on, m.
    pub fn standing_m(&self) -> f64 {
        -self.feet_flu_m.iter().map(|foot| foot.z).fold(f64::INFINITY, f64::min)
    }

    /// Weight, N.
    pub fn weight_n(&self) -> f64 {
        self.mass_kg * GRAVITY_MPS2
    }

    /// Thrust of all rotors at full command and nominal voltage, N.
    pub fn max_thrust_n(&self) -> f64 {
        ROTORS as f64 * self.max_rotor_thrust_n()
    }

    /// Thrust of one rotor at full command and nominal voltage, N.
    pub fn max_rotor_thrust_n(&self) -> f64 {
        self.thrust_coefficient_ns2 * self.motor_curve.full_speed_radps().powi(2)
    }

    /// Speed of each rotor that carries the weight when all turn alike, rad/s.
    pub fn hover_speed_radps(&self) -> f64 {
        (self.weight_n() / (ROTORS as f64 * self.thrust_coefficient_ns2)).sqrt()
    }

    /// What the reaction to the rotors' own acceleration adds to a yaw torque, as the time of a lead, s: at hover
    /// Q + I_zzm ω̇ = Q + (I_zzm / 2 b ω) Q̇.
    pub fn yaw_lead_s(&self) -> f64 {
        self.rotor_inertia_kgm2 / (2.0 * self.drag_torque_coefficient_nms2 * self.hover_speed_radps())
    }

    /// Command that hovers when all motors get the same, at nominal voltage.
    pub fn hover_command(&self) -> f64 {
        self.motor_curve.command(self.hover_speed_radps(), 1.0)
    }

    /// Rotor thrusts (N) ─► [thrust N; torque FLU N m]. Row 4 is the reaction −spin · b/k · T.
    pub fn allocation(&self) -> Matrix4<f64> {
        let ratio = self.drag_torque_coefficient_nms2 / self.thrust_coefficient_ns2;
        let mut columns = Matrix4::zeros();
        for (mut column, rotor) in columns.column_iter_mut().zip(&self.rotors) {
            let r = rotor.position_flu_m;
            // r × (0, 0, T) = (y T, −x T, 0)
            column.copy_from_slice(&[1.0, r.y, -r.x, -rotor.spin.sign() * ratio]);
        }
        columns
    }

    /// Ideal induced power of rotors turning at `speed_radps`, W: Σ T^1.5 / √(2 ρ A), momentum theory in hover.
    pub fn induced_power_w(&self, speed_radps: &[f64; ROTORS]) -> f64 {
        let disc_m2 = std::f64::consts::PI * (0.5 * self.propeller_diameter_m).powi(2);
        let thrust = |speed: &f64| self.thrust_coefficient_ns2 * speed * speed;
        speed_radps.iter().map(|speed| thrust(speed).powf(1.5)).sum::<f64>()
            / (2.0 * AIR_DENSITY_KGPM3 * disc_m2).sqrt()
    }

    /// Wrench of rotors turning steadily at `speed_radps`.
    pub fn wrench(&self, speed_radps: &[f64; ROTORS]) -> Wrench {
        let mut wrench = Wrench::default();
        for (rotor, speed) in self.rotors.iter().zip(speed_radps) {
            let thrust = self.thrust_coefficient_ns2 * speed * speed;
            let r = rotor.position_flu_m;
            wrench.thrust_n += thrust;
            wrench.torque_flu_nm.x += r.y * thrust;
            wrench.torque_flu_nm.y -= r.x * thrust;
            wrench.torque_flu_nm.z -= rotor.spin.sign() * self.drag_torque_coefficient_nms2 * speed * speed;
        }
        wrench
    }
}

fn ten_inches() -> f64 {
    0.254
}

/// Four feet at (±x, ±x, −below).
fn square_feet(x: f64, below: f64) -> [Vector3<f64>; 4] {
    [(x, x), (-x, x), (-x, -x), (x, -x)].map(|(x, y)| Vector3::new(x, y, -below))
}

fn list(v: &Vector3<f64>) -> String {
    format!("[{}, {}, {}]", v.x, v.y, v.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Iris as a user would write it.
    const IRIS_TOML: &str = r#"
        name = "iris"
        mass_kg = 1.545
        inertia_kgm2 = [0.029125, 0.029125, 0.055225]
        thrust_coefficient_ns2 = 5.84e-6
        drag_torque_coefficient_nms2 = 3.504e-7
        linear_drag_nspm = 0.3
        rotor_inertia_kgm2 = 5.9e-5
        motor_rise_time_constant_s = 0.0125
        motor_fall_time_constant_s = 0.025
        motor_curve = { offset_radps = 100, slope_radps = 1000 }
        cg_below_rotors_m = 0.023
        feet_flu_m = [[0.14, 0.14, -0.11], [-0.14, 0.14, -0.11], [-0.14, -0.14, -0.11], [0.14, -0.14, -0.11]]
        battery = { cells = 3, capacity_ah = 5.1, internal_resistance_ohm = 0.015 }
        [[rotors]]
        position_flu_m = [0.13, -0.22, 0.023]
        spin = "counter_clockwise"
        [[rotors]]
        position_flu_m = [-0.13, 0.20, 0.023]
        spin = "counter_clockwise"
        [[rotors]]
        position_flu_m = [0.13, 0.22, 0.023]
        spin = "clockwise"
        [[rotors]]
        position_flu_m = [-0.13, -0.20, 0.023]
        spin = "clockwise"
    "#;

    #[test]
    fn every_named_airframe_is_valid_and_the_iris_can_be_written_as_toml() {
        for name in Airframe::NAMES {
            Airframe::by_name(name).unwrap().validate().unwrap();
        }
        let mut read = Airframe::from_toml(IRIS_TOML).unwrap();
        let iris = Airframe::iris();
        // 0.06 · 5.84e-6 is not the double nearest to 3.504e-7.
        assert!((read.drag_torque_coefficient_nms2 / iris.drag_torque_coefficient_nms2 - 1.0).abs() < 1e-15);
        read.drag_torque_coefficient_nms2 = iris.drag_torque_coefficient_nms2;
        assert_eq!(read, iris);
        assert!(Airframe::by_name("concorde").unwrap_err().to_string().contains("concorde"));
    }

    #[test]
    fn hover_speed_carries_the_weight_without_torque() {
        for name in Airframe::NAMES {
            let airframe = Airframe::by_name(name).unwrap();
            let wrench = airframe.wrench(&[airframe.hover_speed_radps(); 4]);
            assert!((wrench.thrust_n - airframe.weight_n()).abs() < 1e-9);
            assert!(wrench.torque_flu_nm.norm() < 1e-9, "{name}: {:?}", wrench.torque_flu_nm);
            let hover = airframe.hover_command();
            assert!((0.2..0.85).contains(&hover), "{name} hovers at {hover}");
        }
    }

    /// [Clinic] Eq. 12–14 and the hover input of its reference model.
    #[test]
    fn clinic_signs_follow_its_equations() {
        let a = Airframe::clinic();
        assert!((a.hover_speed_radps().powi(2) - 408_750.0).abs() < 1e-6);
        let torque = |i: usize| {
            let mut speed = [0.0; 4];
            speed[i] = 1000.0;
            a.wrench(&speed).torque_flu_nm
        };
        let (lk, b) = (0.25 * 3e-6 * 1e6, 1e-7 * 1e6);
        for (i, expected) in [[lk, 0.0, b], [0.0, lk, -b], [-lk, 0.0, b], [0.0, -lk, -b]].into_iter().enumerate() {
            assert!((torque(i) - Vector3::from(expected)).norm() < 1e-12, "u{}", i + 1);
        }
    }

    /// [Paternain] Eq. 2: roll L (T2 − T4), pitch L (T3 − T1), yaw −Q1 + Q2 − Q3 + Q4.
    #[test]
    fn paternain_signs_follow_its_equations() {
        let a = Airframe::paternain();
        let speed: [f64; 4] = [300.0, 320.0, 340.0, 360.0];
        let t = speed.map(|w| a.thrust_coefficient_ns2 * w * w);
        let q = speed.map(|w| a.drag_torque_coefficient_nms2 * w * w);
        let l = 0.3075;
        let expected = Vector3::new(l * (t[1] - t[3]), l * (t[2] - t[0]), -q[0] + q[1] - q[2] + q[3]);
        assert!((a.wrench(&speed).torque_flu_nm - expected).norm() < 1e-12);
    }

    #[test]
    fn errors_name_key_and_value() {
        type Spoil = fn(&mut Airframe);
        let cases: [(&str, Spoil); 4] = [
            ("mass_kg = -1", |a| a.mass_kg = -1.0),
            ("inertia_kgm2 = [0.029125, 0.029125, 1]", |a| a.inertia_kgm2.z = 1.0),
            ("linear_drag_nspm = NaN", |a| a.linear_drag_nspm = f64::NAN),
            ("motor_curve = ", |a| a.motor_curve.slope_radps = 100.0),
        ];
        for (expected, spoil) in cases {
            let mut airframe = Airframe::iris();
            spoil(&mut airframe);
            let text = airframe.validate().unwrap_err().to_string();
            assert!(text.contains(expected), "{text}");
        }
        let unknown = format!("wings = 2\n{IRIS_TOML}");
        assert!(Airframe::from_toml(&unknown).unwrap_err().to_string().contains("wings"));
    }
}
