//! What makes a simulated world as hard as a real one: the numbers of `worlds/*.toml`, each with its unit in its name and
//! its source beside it.
//!
//! They change what is true and what sensors read. What estimators and controllers assume comes from the agent's
//! configuration and never from here.

use serde::Deserialize;

use super::scenario::ScenarioError;

/// Worlds that a scenario may name, and their numbers.
const WORLDS: [(&str, &str); 2] =
    [("datasheet", include_str!("../worlds/datasheet.toml")), ("harsh", include_str!("../worlds/harsh.toml"))];

/// The world in which nothing disturbs, and sensors have no bias and next to no noise.
pub const IDEAL: &str = "ideal";
/// Noise there, of that of the data sheets: values that repeat would be those of a sensor that is stuck.
pub(crate) const QUIET: f64 = 0.01;

/// Slowest flight loop in which the vibration's bands can be made, Hz.
pub const TICK_RATE_MIN_HZ: f64 = 150.0;

/// The conditions of one world: one field for each key or table of its file, hence so many.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Its name.
    pub world: String,
    pub(crate) vibration: Vibration,
    #[serde(rename = "imu_bno055")]
    pub(crate) imu: Imu,
    pub(crate) temperature: Temperature,
    pub(crate) barometer: Barometer,
    #[serde(rename = "magnetic_disturbance")]
    pub(crate) magnetic: Magnetic,
    #[serde(rename = "laser_urg04lx_ug01")]
    pub(crate) laser: Laser,
    pub(crate) gnss: Gnss,
    #[serde(rename = "mocap_optitrack")]
    pub(crate) mocap: Mocap,
    pub(crate) battery: Battery,
    pub(crate) power: Power,
    pub(crate) motor_esc: MotorEsc,
    #[serde(rename = "rotor_aerodynamics")]
    pub(crate) aerodynamics: Aerodynamics,
    pub(crate) ground_effect: GroundEffect,
    pub(crate) air: Air,
    pub(crate) airframe_errors: AirframeErrors,
    pub(crate) clocks: Clocks,
}

impl Conditions {
    /// The world called `name`; `None` for `bench`, where sensors are what their data sheets in the suite say, and the
    /// vehicle is what its airframe says, and for [`IDEAL`].
    ///
    /// # Errors
    /// [`ScenarioError`], naming the world.
    pub fn of_world(name: &str) -> Result<Option<Self>, ScenarioError> {
        if ["bench", IDEAL].contains(&name) {
            return Ok(None);
        }
        let Some((_, text)) = WORLDS.into_iter().find(|(world, _)| *world == name) else {
            return Err(ScenarioError::Value {
                key: "world".into(),
                value: format!("{name:?}"),
                expected: "ideal, bench, datasheet or harsh".into(),
            });
        };
        toml::from_str(text).map(Some).map_err(|error| ScenarioError::Syntax(format!("world {name}: {error}")))
    }
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Vibration {
    pub(crate) reference_rotor_hz: f64,
    pub(crate) acc_1p_mps2: [f64; 3],
    pub(crate) acc_2p_mps2: [f64; 3],
    pub(crate) acc_broadband_mps2_per_sqrthz: [f64; 3],
    pub(crate) acc_structure_mps2_per_sqrthz: [f64; 3],
    pub(crate) structure_band_hz: [f64; 2],
    pub(crate) gyr_1p_radps: [f64; 3],
    pub(crate) gyr_2p_radps: [f64; 3],
    pub(crate) gyr_broadband_radps_per_sqrthz: [f64; 3],
    pub(crate) shared_power_fraction: f64,
    pub(crate) amplitude_modulation_sigma: f64,
    pub(crate) amplitude_modulation_time_constant_s: f64,
    pub(crate) rotor_unbalance_sigma: f64,
}

/// The IMUs: one field for each key of the table, hence so many.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Imu {
    pub(crate) acc_density_mps2_per_sqrthz: f64,
    pub(crate) acc_bias_left_after_calibration_mps2: f64,
    pub(crate) acc_tco_mps2_per_k: f64,
    pub(crate) acc_tcs_per_k: f64,
    pub(crate) acc_cross_axis: f64,
    pub(crate) acc_nonlinearity_fraction: f64,
    pub(crate) acc_range_mps2: f64,
    pub(crate) acc_lsb_mps2: f64,
    pub(crate) acc_lowpass_hz: f64,
    pub(crate) acc_rectification_mps2_per_mps2sq: f64,
    pub(crate) acc_walk_mps2_per_sqrts: f64,
    pub(crate) acc_walk_time_constant_s: f64,
    pub(crate) gyr_density_radps_per_sqrthz: f64,
    pub(crate) gyr_bias_sigma_radps: f64,
    pub(crate) gyr_tco_radps_per_k: f64,
    pub(crate) gyr_g_sensitivity_radps_per_mps2: f64,
    pub(crate) gyr_scale_sigma: f64,
    pub(crate) gyr_lsb_radps: f64,
    pub(crate) gyr_lowpass_hz: f64,
    pub(crate) gyr_walk_radps_per_sqrts: f64,
    pub(crate) gyr_walk_time_constant_s: f64,
    pub(crate) mag_sigma_ut: f64,
    pub(crate) mag_rate_hz: f64,
    pub(crate) mag_lsb_ut: f64,
    pub(crate) mag_tco_ut_per_k: f64,
    pub(crate) sample_clock_error_sigma: f64,
    pub(crate) read_jitter_s: f64,
    pub(crate) missing_fraction: f64,
    pub(crate) gap_rate_per_s: f64,
    pub(crate) gap_max_s: f64,
    pub(crate) transport_delay_s: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Temperature {
    pub(crate) warm_up_k: f64,
    pub(crate) warm_up_time_constant_s: f64,
    pub(crate) rotor_wash_step_k: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Barometer {
    pub(crate) noise_pa: f64,
    pub(crate) resolution_pa: f64,
    pub(crate) slow_sigma_pa: f64,
    pub(crate) slow_time_constant_s: f64,
    pub(crate) warm_up_pa_per_k: f64,
    pub(crate) ground_wash_fraction_of_disk_loading: f64,
    pub(crate) ground_wash_decay_rotor_radii: f64,
    pub(crate) ground_wash_sign_probability_reads_high: f64,
    pub(crate) thrust_fraction_of_disk_loading: f64,
    pub(crate) airspeed_pressure_coefficient: f64,
    pub(crate) wash_turbulence_pa: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Magnetic {
    pub(crate) motor_ut_per_a: f64,
    pub(crate) indoor_anomaly_sigma_ut: f64,
    pub(crate) indoor_anomaly_length_m: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Laser {
    pub(crate) range_max_m: f64,
    pub(crate) beam_sigma_m: f64,
    pub(crate) beam_sigma_beyond_2m_m: f64,
    pub(crate) bad_beam_fraction: f64,
    pub(crate) bad_beam_gain: f64,
    pub(crate) spurious_fraction: f64,
    pub(crate) spurious_again_fraction: f64,
    pub(crate) bias_sigma_m: f64,
    pub(crate) scale_error_sigma: f64,
    pub(crate) warm_up_drift_m: f64,
    pub(crate) surface_bias_sigma_m: f64,
    pub(crate) scan_period_s: f64,
    pub(crate) nadir_after_scan_start_s: f64,
    pub(crate) delivery_delay_s: f64,
    pub(crate) host_stamp_jitter_s: f64,
    pub(crate) intermittent_invalid_fraction: f64,
    pub(crate) mounting_tilt_sigma_rad: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Gnss {
    pub(crate) delay_s: f64,
    pub(crate) white_horizontal_m: f64,
    pub(crate) white_vertical_m: f64,
    pub(crate) fast_sigma_horizontal_m: f64,
    pub(crate) fast_sigma_vertical_m: f64,
    pub(crate) fast_time_constant_s: f64,
    pub(crate) slow_sigma_horizontal_m: f64,
    pub(crate) slow_sigma_vertical_m: f64,
    pub(crate) slow_time_constant_s: f64,
    pub(crate) velocity_sigma_mps: f64,
    pub(crate) jump_rate_per_s: f64,
    pub(crate) jump_sigma_m: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Mocap {
    pub(crate) position_sigma_m: f64,
    pub(crate) attitude_sigma_rad: f64,
    pub(crate) calibration_scale_sigma: f64,
    pub(crate) delay_s: f64,
    pub(crate) delay_jitter_s: f64,
    pub(crate) dropout_rate_per_s: f64,
    pub(crate) dropout_mean_s: f64,
    pub(crate) swap_rate_per_s: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Battery {
    pub(crate) cell_r0_ohm: f64,
    pub(crate) cell_r1_ohm: f64,
    pub(crate) r1_time_constant_s: f64,
    pub(crate) ocv_charge: [f64; 5],
    pub(crate) ocv_v_per_cell: [f64; 5],
    pub(crate) capacity_factor: f64,
    pub(crate) voltage_gain_sigma: f64,
    pub(crate) voltage_noise_v: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Power {
    pub(crate) eta_ideal_to_electric: f64,
    pub(crate) avionics_w: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MotorEsc {
    pub(crate) rise_time_constant_s: f64,
    pub(crate) fall_time_constant_s: f64,
    pub(crate) command_rate_hz: f64,
    pub(crate) command_steps: f64,
    pub(crate) command_delay_s: f64,
    pub(crate) thrust_spread_sigma: f64,
    pub(crate) thrust_noise_fraction: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Aerodynamics {
    pub(crate) torque_over_thrust_diameter: f64,
    pub(crate) rotor_drag_per_mass_x_1ps: f64,
    pub(crate) rotor_drag_per_mass_y_1ps: f64,
    pub(crate) body_drag_n_per_mps2: f64,
    pub(crate) inflow_thrust_loss_ns_per_rad_m: f64,
    pub(crate) translational_lift_n_per_mps2: f64,
    pub(crate) vortex_ring_thrust_loss: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct GroundEffect {
    pub(crate) cheeseman_bennett_c: f64,
    pub(crate) near_ground_force_noise_fraction: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Air {
    pub(crate) sigma_mps: f64,
    pub(crate) time_constant_s: f64,
    pub(crate) density_kgpm3: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AirframeErrors {
    pub(crate) mass_sigma_fraction: f64,
    pub(crate) inertia_sigma_fraction: f64,
    pub(crate) cg_offset_sigma_m: f64,
    pub(crate) rotor_tilt_sigma_rad: f64,
    pub(crate) imu_misalignment_sigma_rad: f64,
    pub(crate) imu_lever_error_sigma_m: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Clocks {
    pub(crate) imu_to_imu_offset_s: f64,
    pub(crate) delay_jump_rate_per_s: f64,
    pub(crate) delay_jump_s: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_world_can_be_read_and_others_are_refused_by_name() {
        for (name, _) in WORLDS {
            assert_eq!(Conditions::of_world(name).unwrap().unwrap().world, name);
        }
        assert!(["bench", IDEAL].iter().all(|name| Conditions::of_world(name).unwrap().is_none()));
        let refused = Conditions::of_world("moon").unwrap_err().to_string();
        assert!(refused.contains("moon") && refused.contains("harsh"), "{refused}");
    }

    /// Harsh is nowhere kinder.
    #[test]
    fn the_harsh_world_is_harder() {
        let [datasheet, harsh] = ["datasheet", "harsh"].map(|name| Conditions::of_world(name).unwrap().unwrap());
        assert!(harsh.vibration.acc_2p_mps2[2] > 2.9 * datasheet.vibration.acc_2p_mps2[2]);
        assert!(harsh.laser.delivery_delay_s > datasheet.laser.delivery_delay_s);
        assert!(harsh.imu.gap_rate_per_s > 0.0 && datasheet.imu.gap_rate_per_s == 0.0);
        assert!(harsh.power.eta_ideal_to_electric < datasheet.power.eta_ideal_to_electric);
    }
}
