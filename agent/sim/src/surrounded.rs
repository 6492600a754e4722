//! The vehicle as a named world makes it: an airframe that is not quite what was said of it, speed controllers, the air
//! about its rotors.

use nalgebra::Vector3;
use plumbline_core::model::airframe::{AIR_DENSITY_KGPM3, Airframe};
use plumbline_core::model::battery::{self, Battery};
use plumbline_core::model::rigid_body::{Input, State, rotate};
use plumbline_core::sensor::noise::Stream;
use plumbline_core::types::ROTORS;

use super::conditions::{self, Aerodynamics, Conditions, GroundEffect, Power};
use super::vibration::Slow;
use super::world::Disturbance;

/// Torque over thrust and diameter of a propeller of 8 to 10 inches, the middle of UIUC's measurements.
const TORQUE_OVER_THRUST_DIAMETER: f64 = 0.0636;
/// Thrust noise lies below 20 Hz.
const THRUST_NOISE_S: f64 = 0.008;

/// What a world changes of a vehicle.
#[derive(Debug, Clone)]
pub(crate) struct Surrounded {
    /// As it really is.
    pub(crate) airframe: Airframe,
    /// In place of the scenario's.
    pub(crate) disturbance: Disturbance,
    battery: conditions::Battery,
    power: Power,
    pub(crate) esc: SpeedController,
    aerodynamics: Aerodynamics,
    ground: GroundEffect,
    /// Of each rotor's thrust: how far it points from the body's z axis along x and y, rad.
    tilt_rad: [[f64; 2]; ROTORS],
    /// One sigma of each rotor's thrust, of itself, and where it stands.
    thrust_noise: f64,
    stirred: [Slow; ROTORS],
    near_ground: Slow,
    stream: Stream,
}

impl Surrounded {
    /// `nominal` in a world; `seed` draws what is off.
    pub(crate) fn new(conditions: &Conditions, nominal: &Airframe, seed: u64) -> Self {
        let mut stream = Stream::new(seed, "vehicle in a world");
        let mut normal = |sigma: f64| sigma * stream.normal();
        let (errors, motor, battery) = (&conditions.airframe_errors, &conditions.motor_esc, &conditions.battery);
        let mut airframe = nominal.clone();
        airframe.mass_kg *= 1.0 + normal(errors.mass_sigma_fraction);
        let inertia = Vector3::from_fn(|_, _| 1.0 + normal(errors.inertia_sigma_fraction));
        airframe.inertia_kgm2.component_mul_assign(&inertia);
        // No principal moment of a body exceeds the sum of the others.
        let sum = airframe.inertia_kgm2.sum();
        airframe.inertia_kgm2.apply(|moment| *moment = moment.min(0.999 * (sum - *moment)));
        // Places are counted from the centre of mass.
        let offset = Vector3::new(normal(errors.cg_offset_sigma_m), normal(errors.cg_offset_sigma_m), 0.0);
        airframe.rotors.iter_mut().for_each(|rotor| rotor.position_flu_m -= offset);
        airframe.feet_flu_m.iter_mut().for_each(|foot| *foot -= offset);
        airframe.motor_rise_time_constant_s = motor.rise_time_constant_s;
        airframe.motor_fall_time_constant_s = motor.fall_time_constant_s;
        // Drag is of the rotors and of the body, below.
        airframe.linear_drag_nspm = 0.0;
        let air = conditions.air.density_kgpm3 / AIR_DENSITY_KGPM3;
        airframe.thrust_coefficient_ns2 *= air;
        // An airframe's own torque constant is taken for the middle of its kind.
        let propeller = conditions.aerodynamics.torque_over_thrust_diameter / TORQUE_OVER_THRUST_DIAMETER;
        airframe.drag_torque_coefficient_nms2 *= air * propeller;
        airframe.battery.internal_resistance_ohm = f64::from(airframe.battery.cells) * battery.cell_r0_ohm;
        airframe.battery.capacity_ah *= battery.capacity_factor;
        let tilt_rad = std::array::from_fn(|_| std::array::from_fn(|_| normal(errors.rotor_tilt_sigma_rad)));
        let disturbance = Disturbance {
            wind_sigma_mps: conditions.air.sigma_mps,
            wind_time_constant_s: conditions.air.time_constant_s,
            // Of the speed; thrust goes with its square.
            motor_spread: 0.5 * motor.thrust_spread_sigma,
            ..Disturbance::NONE
        };
        Self {
            airframe,
            disturbance,
            battery: conditions.battery.clone(),
            power: conditions.power.clone(),
            esc: SpeedController::new(motor.command_rate_hz, motor.command_steps, motor.command_delay_s),
            aerodynamics: conditions.aerodynamics.clone(),
            ground: conditions.ground_effect.clone(),
            tilt_rad,
            thrust_noise: motor.thrust_noise_fraction,
            stirred: [Slow::default(); ROTORS],
            near_ground: Slow::default(),
            stream,
        }
    }

    /// A pack with this charge.
    pub(crate) fn battery(&self, charge: f64) -> Battery {
        let (c, pack) = (&self.battery, self.airframe.battery);
        let r1_ohm = f64::from(pack.cells) * c.cell_r1_ohm;
        Battery::new(pack, charge).measured(c.ocv_charge, c.ocv_v_per_cell, r1_ohm, c.r1_time_constant_s)
    }

    /// Ideal induced power by which a battery of the usual efficiency and electronics is drawn as by this world's, W.
    pub(crate) fn drawn_w(&self, induced_power_w: f64) -> f64 {
        let more_w = self.power.avionics_w - self.airframe.battery.electronics_w();
        battery::EFFICIENCY * (induced_power_w / self.power.eta_ideal_to_electric + more_w)
    }

    /// The air of one tick.
    pub(crate) fn stir(&mut self, dt_s: f64) {
        for slow in self.stirred.iter_mut().chain([&mut self.near_ground]) {
            slow.step(dt_s, THRUST_NOISE_S, &mut self.stream);
        }
    }

    /// Adds to `input` what the air does to a body that moves as `x` with rotors at `speed_radps`.
    pub(crate) fn act(&self, x: &State, speed_radps: &[f64; ROTORS], input: &mut Input) {
        let (a, airframe) = (&self.aerodynamics, &self.airframe);
        let air_flu = rotate(&x.world_from_body.conjugate(), &(x.velocity_enu_mps - input.wind_enu_mps));
        let radius_m = 0.5 * airframe.propeller_diameter_m;
        let (mut force_flu, mut torque_flu, mut carried_n) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for (rotor, (speed, (tilt, stirred))) in
            airframe.rotors.iter().zip(speed_radps.iter().zip(self.tilt_rad.iter().zip(&self.stirred)))
        {
            let thrust_n = airframe.thrust_coefficient_ns2 * speed * speed;
            carried_n += thrust_n;
            let lateral2 = air_flu.x * air_flu.x + air_flu.y * air_flu.y;
            let turning = (thrust_n / (0.25 * airframe.weight_n())).min(1.0);
            let height_m = (x.position_enu_m.z + rotor.position_flu_m.z).max(0.5 * radius_m);
            let image = self.ground.cheeseman_bennett_c * (radius_m / (4.0 * height_m)).powi(2);
            let near = if height_m < 2.0 * radius_m { self.ground.near_ground_force_noise_fraction } else { 0.0 };
            let lost = a.vortex_ring_thrust_loss * vortex_ring(-air_flu.z, thrust_n, radius_m);
            let more_n = thrust_n * (image / (1.0 - image) - lost)
                + thrust_n * (self.thrust_noise * stirred.value() + near * self.near_ground.value())
                + turning * a.translational_lift_n_per_mps2 * lateral2
                - a.inflow_thrust_loss_ns_per_rad_m * speed * air_flu.z;
            let force = Vector3::new(tilt[0] * thrust_n, tilt[1] * thrust_n, more_n.max(-thrust_n));
            force_flu += force;
            torque_flu += rotor.position_flu_m.cross(&force);
        }
        let level = carried_n / airframe.weight_n();
        let drag = Vector3::new(a.rotor_drag_per_mass_x_1ps, a.rotor_drag_per_mass_y_1ps, 0.0);
        force_flu -= drag.component_mul(&air_flu) * (airframe.mass_kg * level);
        force_flu -= air_flu * (a.body_drag_n_per_mps2 * air_flu.norm());
        input.force_enu_n += rotate(&x.world_from_body, &force_flu);
        input.torque_flu_nm += torque_flu;
    }
}

/// How far a rotor of `thrust_n` that sinks at `sinks_mps` is in the ring of its own wake, 0 to 1: from half of its induced
/// velocity on, all of it at that velocity, until the wake has left it above at twice as much.
fn vortex_ring(sinks_mps: f64, thrust_n: f64, radius_m: f64) -> f64 {
    let disc_m2 = std::f64::consts::PI * radius_m * radius_m;
    let induced_mps = (thrust_n.max(0.0) / (2.0 * AIR_DENSITY_KGPM3 * disc_m2)).sqrt();
    if induced_mps <= 0.0 {
        return 0.0;
    }
    let ratio = sinks_mps / induced_mps;
    (2.0 * ratio - 1.0).min(4.0 - 2.0 * ratio).clamp(0.0, 1.0)
}

/// Longest delay of a command, ticks.
const DELAY_MAX: usize = 16;

/// How commands reach the motors: at a rate, in steps, late.
#[derive(Debug, Clone)]
pub(crate) struct SpeedController {
    period_s: f64,
    steps: f64,
    delay_s: f64,
    since_s: f64,
    held: [f64; ROTORS],
    /// Commands of the last ticks, the newest first.
    under_way: [[f64; ROTORS]; DELAY_MAX],
}

impl SpeedController {
    fn new(rate_hz: f64, steps: f64, delay_s: f64) -> Self {
        let none = [0.0; ROTORS];
        Self { period_s: 1.0 / rate_hz, steps, delay_s, since_s: 0.0, held: none, under_way: [none; DELAY_MAX] }
    }

    /// What the motors are told in a tick of `dt_s` in which the flight loop says `throttle`. A delay counts in whole
    /// ticks, as the motors' lag counts from the tick's begin.
    pub(crate) fn command(&mut self, throttle: &[f64; ROTORS], dt_s: f64) -> [f64; ROTORS] {
        self.under_way.rotate_right(1);
        self.under_way[0] = *throttle;
        self.since_s += dt_s;
        // Half a tick early is now.
        if self.since_s + 0.5 * dt_s >= self.period_s {
            self.since_s = 0.0;
            let back = ((self.delay_s / dt_s).round() as usize).min(DELAY_MAX - 1);
            self.held = self.under_way[back].map(|t| (t * self.steps).round() / self.steps);
        }
        self.held
    }
}

#[cfg(test)]
mod tests;
