//! The true state, stepped: body, rotors, battery, wind and disturbances.
//!
//! One tick is cut into equal sub-steps of at most [`SUB_STEP_S`], each a fourth-order Runge–Kutta step over
//! body and rotor speeds together; commands, wind, process noise and the battery's voltage are constant
//! over a tick. The stiffest rig allowed (strings or floor with 1–2 mm of stretch, 100 rad/s, and the friction
//! of the feet, 300 1/s) stays well inside the method's limit of 2.8 at that step.

use nalgebra::Vector3;

use super::conditions::Conditions;
use super::rig::{Load, Mounted, Rig};
use super::surrounded::Surrounded;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::battery::Battery;
use plumbline_core::model::integrate::{Integrable, rk4};
use plumbline_core::model::motor;
use plumbline_core::model::rigid_body::{self, Derivative, Input, State, rotate};
use plumbline_core::sensor::noise::Stream;
use plumbline_core::types::{GRAVITY_MPS2, ROTORS};

/// Longest integration step, s.
pub const SUB_STEP_S: f64 = 0.001_25;

/// How far the world is from calm and exact. The white noises are the air that the rotors stir: none while they stand
/// still, all of it from half of the hovering thrust on.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbance {
    /// White acceleration, m/s²/√Hz.
    pub accel_noise: f64,
    /// White angular acceleration, rad/s²/√Hz.
    pub angular_noise: f64,
    /// Wind per horizontal axis, one sigma, m/s; half of it vertically.
    pub wind_sigma_mps: f64,
    /// How long a gust lasts, s.
    pub wind_time_constant_s: f64,
    /// Each motor's speed differs from its curve by this fraction, one sigma.
    pub motor_spread: f64,
}

impl Default for Disturbance {
    /// Process noise of the reference flights (0.02 m/s²/√Hz, 0.1 rad/s²/√Hz); a draught; 1 % motors.
    fn default() -> Self {
        Self {
            accel_noise: 0.02,
            angular_noise: 0.1,
            wind_sigma_mps: 0.1,
            wind_time_constant_s: 1.0,
            motor_spread: 0.01,
        }
    }
}

impl Disturbance {
    /// A perfectly calm world with perfect motors.
    pub const NONE: Self = Self {
        accel_noise: 0.0,
        angular_noise: 0.0,
        wind_sigma_mps: 0.0,
        wind_time_constant_s: 1.0,
        motor_spread: 0.0,
    };
}

/// A hand on the vehicle during a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Push {
    /// At the centre of mass, ENU, N.
    pub force_enu_n: Vector3<f64>,
    /// FLU, N m.
    pub torque_flu_nm: Vector3<f64>,
    /// Holds the body's rotation about an axis (FLU) at an angle (rad).
    pub deflect: Option<(Vector3<f64>, f64)>,
}

/// Natural frequency of a hand holding an angle, rad/s.
const HAND_RADPS: f64 = 40.0;
/// What a hand can give, N m.
const HAND_TORQUE_NM: f64 = 20.0;

impl Push {
    fn torque(&self, airframe: &Airframe, x: &State) -> Vector3<f64> {
        let Some((axis, angle)) = self.deflect else { return self.torque_flu_nm };
        let rpy = plumbline_core::frames::roll_pitch_yaw(&x.attitude());
        let missing = plumbline_core::frames::wrap_pi(angle - axis.dot(&rpy));
        let inertia = axis.dot(&airframe.inertia_kgm2);
        let rate = axis.dot(&x.body_rates_radps);
        let hand = inertia * HAND_RADPS * (HAND_RADPS * missing - 2.0 * rate);
        self.torque_flu_nm + axis * hand.clamp(-HAND_TORQUE_NM, HAND_TORQUE_NM)
    }
}

/// Body and rotors, integrated together.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Moving {
    body: State,
    rotor_speed_radps: [f64; ROTORS],
}

#[derive(Debug, Clone, Copy)]
struct MovingDerivative {
    body: Derivative,
    rotor_acceleration_radps2: [f64; ROTORS],
}

impl Integrable for Moving {
    type Derivative = MovingDerivative;
    fn moved(&self, d: &MovingDerivative, h: f64) -> Self {
        let mut rotor_speed_radps = self.rotor_speed_radps;
        for (speed, acceleration) in rotor_speed_radps.iter_mut().zip(d.rotor_acceleration_radps2) {
            *speed += acceleration * h;
        }
        Self { body: self.body.moved(&d.body, h), rotor_speed_radps }
    }
}

/// Everything that is true.
#[derive(Debug, Clone)]
pub struct World {
    airframe: Airframe,
    mounted: Mounted,
    moving: Moving,
    steady_speed_radps: [f64; ROTORS],
    motor_factor: [f64; ROTORS],
    /// Of each rotor's speed, what its blades are worth: less than 1 where one is broken.
    blades: [f64; ROTORS],
    battery: Battery,
    battery_sags: bool,
    disturbance: Disturbance,
    surrounded: Option<Surrounded>,
    noise: Stream,
    wind_enu_mps: Vector3<f64>,
    // What acted at the end of the last sub-step, for the sensors.
    angular_acceleration_radps2: Vector3<f64>,
    specific_force_flu_mps2: Vector3<f64>,
    load: Load,
}

fn charged(surrounded: Option<&Surrounded>, airframe: &Airframe, charge: f64) -> Battery {
    surrounded.map_or_else(|| Battery::new(airframe.battery, charge), |surrounded| surrounded.battery(charge))
}

/// How a world begins.
#[derive(Debug, Clone)]
pub struct Beginning {
    /// The vehicle.
    pub airframe: Airframe,
    /// What holds it.
    pub rig: Rig,
    /// How rough the world is.
    pub disturbance: Disturbance,
    /// Of a named world; they take the place of `disturbance`.
    pub conditions: Option<Conditions>,
    /// Battery charge, 0..1; `None` holds the nominal voltage for ever.
    pub battery_charge: Option<f64>,
    /// Added to the rig's resting state: position (ENU, m).
    pub offset_enu_m: Vector3<f64>,
    /// Velocity, ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Roll, pitch, yaw, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Body rates, rad/s.
    pub body_rates_radps: Vector3<f64>,
    /// Seed of the disturbances.
    pub seed: u64,
}

impl Beginning {
    /// `airframe` at rest on `rig` in a calm world with a battery that never empties.
    pub fn calm(airframe: Airframe, rig: Rig) -> Self {
        Self {
            airframe,
            rig,
            disturbance: Disturbance::NONE,
            conditions: None,
            battery_charge: None,
            offset_enu_m: Vector3::zeros(),
            velocity_enu_mps: Vector3::zeros(),
            roll_pitch_yaw_rad: Vector3::zeros(),
            body_rates_radps: Vector3::zeros(),
            seed: 0,
        }
    }
}

impl World {
    /// The world at time zero, motors stopped.
    pub fn new(beginning: Beginning) -> Self {
        let Beginning { airframe, rig, disturbance, conditions, battery_charge, seed, .. } = beginning;
        let surrounded = conditions.map(|conditions| Surrounded::new(&conditions, &airframe, seed));
        let charge = battery_charge.unwrap_or(0.5);
        let (airframe, disturbance) = match &surrounded {
            Some(surrounded) => (surrounded.airframe.clone(), surrounded.disturbance),
            None => (airframe, disturbance),
        };
        let mounted = Mounted::new(&rig, &airframe);
        let mut body = mounted.start;
        body.position_enu_m += beginning.offset_enu_m;
        body.velocity_enu_mps = beginning.velocity_enu_mps;
        body.world_from_body = *plumbline_core::frames::from_roll_pitch_yaw(&beginning.roll_pitch_yaw_rad);
        body.body_rates_radps = beginning.body_rates_radps;
        if let Some(pivot) = &mounted.pivot {
            body = pivot.held(body);
        }
        let mut motors = Stream::new(seed, "motors");
        let motor_factor = std::array::from_fn(|_| 1.0 + disturbance.motor_spread * motors.normal());
        let mut world = Self {
            battery: charged(surrounded.as_ref(), &airframe, charge),
            battery_sags: battery_charge.is_some(),
            airframe,
            mounted,
            moving: Moving { body, rotor_speed_radps: [0.0; ROTORS] },
            steady_speed_radps: [0.0; ROTORS],
            motor_factor,
            blades: [1.0; ROTORS],
            disturbance,
            surrounded,
            noise: Stream::new(seed, "disturbance"),
            wind_enu_mps: Vector3::zeros(),
            angular_acceleration_radps2: Vector3::zeros(),
            specific_force_flu_mps2: Vector3::zeros(),
            load: Load::default(),
        };
        world.settle(&Input::default());
        world
    }

    /// From now on each rotor gives this part of the thrust and of the drag torque that its speed should.
    pub fn break_rotors(&mut self, parts: &[f64; ROTORS]) {
        self.blades = parts.map(f64::sqrt);
    }

    /// Moves on by `dt_s` with each motor told `throttle` (0..1) and a hand's `push`.
    pub fn step(&mut self, throttle: &[f64; ROTORS], push: &Push, dt_s: f64) {
        let voltage_ratio = if self.battery_sags { self.battery.voltage_ratio() } else { 1.0 };
        let throttle = match &mut self.surrounded {
            Some(surrounded) => &surrounded.esc.command(throttle, dt_s),
            None => throttle,
        };
        self.steady_speed_radps = motor::steady_speed(&self.airframe, throttle, voltage_ratio);
        for (speed, factor) in self.steady_speed_radps.iter_mut().zip(self.motor_factor) {
            *speed *= factor;
        }
        let d = self.disturbance;
        let mut input = Input { force_enu_n: push.force_enu_n, ..Input::default() };
        if d.wind_sigma_mps > 0.0 {
            let keep = (-dt_s / d.wind_time_constant_s).exp();
            let kick = d.wind_sigma_mps * (1.0 - keep * keep).sqrt();
            let n = self.normal3();
            self.wind_enu_mps = self.wind_enu_mps * keep + n.component_mul(&Vector3::new(kick, kick, 0.5 * kick));
            input.wind_enu_mps = self.wind_enu_mps;
        }
        let thrust_n: f64 =
            self.moving.rotor_speed_radps.iter().map(|w| self.airframe.thrust_coefficient_ns2 * w * w).sum();
        let stirred = (2.0 * thrust_n / self.airframe.weight_n()).min(1.0) / dt_s.sqrt();
        if d.accel_noise > 0.0 {
            input.force_enu_n += self.normal3() * (d.accel_noise * stirred * self.airframe.mass_kg);
        }
        if let Some(surrounded) = &mut self.surrounded {
            surrounded.stir(dt_s);
        }
        let noise_torque = if d.angular_noise > 0.0 {
            (self.normal3() * (d.angular_noise * stirred)).component_mul(&self.airframe.inertia_kgm2)
        } else {
            Vector3::zeros()
        };
        let steps = (dt_s / SUB_STEP_S).ceil().max(1.0);
        let h = dt_s / steps;
        for _ in 0..steps as usize {
            input.torque_flu_nm = noise_torque + push.torque(&self.airframe, &self.moving.body);
            let mut next = rk4(&self.moving, h, |x| self.derivative(x, &input).0);
            next.body = match &self.mounted.pivot {
                Some(pivot) => pivot.held(next.body),
                None => next.body.normalised(),
            };
            self.moving = next;
        }
        self.settle(&input);
        if self.battery_sags {
            let induced_w = self.airframe.induced_power_w(&self.moving.rotor_speed_radps);
            let drawn_w = self.surrounded.as_ref().map_or(induced_w, |surrounded| surrounded.drawn_w(induced_w));
            self.battery.draw(drawn_w, dt_s);
        }
    }

    fn normal3(&mut self) -> Vector3<f64> {
        Vector3::new(self.noise.normal(), self.noise.normal(), self.noise.normal())
    }

    /// Derivative of body and rotors, and the rig's load.
    fn derivative(&self, x: &Moving, outside: &Input) -> (MovingDerivative, Load) {
        let rotor_acceleration_radps2 =
            motor::acceleration(&self.airframe, &x.rotor_speed_radps, &self.steady_speed_radps);
        let mut input = Input::from_rotors(&self.airframe, &x.rotor_speed_radps, &rotor_acceleration_radps2);
        let mut lifting_radps = x.rotor_speed_radps;
        lifting_radps.iter_mut().zip(self.blades).for_each(|(speed, part)| *speed *= part);
        input.rotors = self.airframe.wrench(&lifting_radps);
        let load = self.mounted.load(&x.body);
        input.force_enu_n = outside.force_enu_n + load.force_enu_n;
        input.torque_flu_nm = outside.torque_flu_nm + load.torque_flu_nm;
        input.wind_enu_mps = outside.wind_enu_mps;
        if let Some(surrounded) = &self.surrounded {
            surrounded.act(&x.body, &lifting_radps, &mut input);
        }
        let mut body = rigid_body::derivative(&self.airframe, &x.body, &input);
        if let Some(pivot) = &self.mounted.pivot {
            let torque =
                input.rotors.torque_flu_nm + input.torque_flu_nm - Vector3::new(0.0, 0.0, input.rotor_momentum_rate_nm);
            // Rotor thrust acts along body z through the centre of mass: no lever about the pivot's offset
            // along the same axis, so the pivot takes it. Pushes at the centre of mass do have one.
            let acceleration = pivot.angular_acceleration(&self.airframe, &x.body, &torque, &input.force_enu_n);
            let w = x.body.body_rates_radps;
            let alpha = pivot.axis * acceleration;
            let arm = pivot.cg_flu_m;
            let a_flu = alpha.cross(&arm) + w.cross(&w.cross(&arm));
            body.body_rates_radps = alpha;
            body.velocity_enu_mps = rotate(&x.body.world_from_body, &a_flu);
        }
        (MovingDerivative { body, rotor_acceleration_radps2 }, load)
    }

    /// Keeps what acts now, for the sensors.
    fn settle(&mut self, outside: &Input) {
        let (d, load) = self.derivative(&self.moving, outside);
        let q = self.moving.body.world_from_body;
        let against_gravity = d.body.velocity_enu_mps + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        self.specific_force_flu_mps2 = rotate(&q.conjugate(), &against_gravity);
        self.angular_acceleration_radps2 = d.body.body_rates_radps;
        self.load = load;
    }

    /// Body state.
    pub fn body(&self) -> &State {
        &self.moving.body
    }

    /// Rotor speeds, rad/s.
    pub fn rotor_speed_radps(&self) -> &[f64; ROTORS] {
        &self.moving.rotor_speed_radps
    }

    /// Specific force at the centre of mass, FLU, m/s².
    pub fn specific_force_flu_mps2(&self) -> Vector3<f64> {
        self.specific_force_flu_mps2
    }

    /// Angular acceleration, FLU, rad/s².
    pub fn angular_acceleration_radps2(&self) -> Vector3<f64> {
        self.angular_acceleration_radps2
    }

    /// Strings and ground, now.
    pub fn load(&self) -> &Load {
        &self.load
    }

    /// Voltage at the battery's terminals, V.
    pub fn battery_v(&self) -> f64 {
        if self.battery_sags { self.battery.voltage_v() } else { self.airframe.battery.nominal_v() }
    }

    /// Puts this battery in.
    pub fn replace_battery(&mut self, battery: Battery) {
        self.battery = battery;
    }

    /// A full one of the kind that the vehicle has.
    pub fn full_battery(&self) -> Battery {
        charged(self.surrounded.as_ref(), &self.airframe, 1.0)
    }

    /// The battery.
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// The vehicle.
    pub fn airframe(&self) -> &Airframe {
        &self.airframe
    }

    /// The rig as mounted.
    pub fn mounted(&self) -> &Mounted {
        &self.mounted
    }
}
