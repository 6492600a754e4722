use super::*;
use crate::scenario::Scenario;

fn surrounded(world: &str, seed: u64) -> (Airframe, Surrounded) {
    let conditions = Conditions::of_world(world).unwrap().unwrap();
    let nominal = Airframe::iris();
    let real = Surrounded::new(&conditions, &nominal, seed);
    (nominal, real)
}

#[test]
fn the_airframe_is_off_by_what_the_world_says_and_differently_for_each_seed() {
    const SEEDS: u64 = 400;
    let mut squares = 0.0;
    for seed in 0..SEEDS {
        let (nominal, real) = surrounded("harsh", seed);
        squares += (real.airframe.mass_kg / nominal.mass_kg - 1.0).powi(2);
        real.airframe.validate().unwrap();
    }
    // 3 % one sigma; the sample's sigma is good to 3.5 %.
    assert!(((squares / SEEDS as f64).sqrt() / 0.03 - 1.0).abs() < 0.15);
}

/// GIVEN the same vehicle on the bench and in a hard world THEN what flies it assumes the same.
#[test]
fn nothing_that_estimators_and_controllers_assume_comes_from_the_world() {
    let assumed = |world: &str| {
        let text = format!(
            "name = \"assumed\"\nworld = \"{world}\"\n[suite]\npreset = \"string_rig\"\nadd = [\"mocap_pose\", \"gnss\"]\n"
        );
        format!("{:?}", Scenario::from_toml(&text).unwrap().flight_config())
    };
    let bench = assumed("bench");
    assert_eq!(bench, assumed("datasheet"));
    assert_eq!(bench, assumed("harsh"));
}

#[test]
fn commands_come_in_steps_at_their_rate_and_late() {
    let mut esc = SpeedController::new(50.0, 256.0, 0.02);
    let told: Vec<f64> = (0..40).map(|k| esc.command(&[if k < 10 { 0.0 } else { 0.5004 }; ROTORS], 0.005)[0]).collect();
    let first = told.iter().position(|t| *t > 0.0).unwrap();
    // Said in tick 10: 20 ms late, and taken every fourth tick.
    assert!((14..=18).contains(&first), "{first}");
    assert_eq!(told[39], 128.0 / 256.0);
    let mut quick = SpeedController::new(400.0, 1000.0, 0.002);
    assert_eq!(quick.command(&[0.1234; ROTORS], 0.005)[0], 0.123);
}

#[test]
fn the_ground_lifts_by_a_fourteenth_at_one_radius_and_air_drags() {
    let (_, mut real) = surrounded("datasheet", 3);
    (real.thrust_noise, real.tilt_rad) = (0.0, [[0.0; 2]; ROTORS]);
    real.ground.near_ground_force_noise_fraction = 0.0;
    let speed = [real.airframe.hover_speed_radps(); ROTORS];
    let hub_m = real.airframe.rotors[0].position_flu_m.z;
    let force_at = |height_m: f64, velocity: Vector3<f64>| {
        let x = State { velocity_enu_mps: velocity, ..State::at_rest(Vector3::new(0.0, 0.0, height_m - hub_m)) };
        let mut input = Input::default();
        real.act(&x, &speed, &mut input);
        input.force_enu_n
    };
    let radius_m = 0.5 * real.airframe.propeller_diameter_m;
    let share = force_at(radius_m, Vector3::zeros()).z / real.airframe.weight_n();
    // 1 / (1 − 1/16) − 1.
    assert!((share - 1.0 / 15.0).abs() < 1e-9, "{share}");
    assert!(force_at(20.0, Vector3::zeros()).z / real.airframe.weight_n() < 1e-3);
    let drag = force_at(20.0, Vector3::new(1.0, 0.0, 0.0)).x / real.airframe.mass_kg;
    assert!((drag + 0.2 + 0.01 / real.airframe.mass_kg).abs() < 1e-6, "{drag}");
}

#[test]
fn air_and_propeller_are_those_of_the_world() {
    let (nominal, real) = surrounded("harsh", 5);
    let airframe = &real.airframe;
    assert!((airframe.thrust_coefficient_ns2 / nominal.thrust_coefficient_ns2 - 1.15 / 1.225).abs() < 1e-12);
    let torque_over_thrust = |a: &Airframe| a.drag_torque_coefficient_nms2 / a.thrust_coefficient_ns2;
    assert!((torque_over_thrust(airframe) / torque_over_thrust(&nominal) - 0.0741 / 0.0636).abs() < 1e-9);
}

/// GIVEN a rotor that carries 3.7 N, whose wake leaves it at 5.4 m/s THEN it loses lift where it sinks into that, and nowhere
/// else.
#[test]
fn a_rotor_loses_lift_where_it_sinks_into_its_own_wake() {
    let (nominal, _) = surrounded("harsh", 5);
    let radius_m = 0.5 * nominal.propeller_diameter_m;
    let induced_mps = (3.7 / (2.0 * 1.225 * std::f64::consts::PI * radius_m * radius_m)).sqrt();
    let at = |ratio: f64| vortex_ring(ratio * induced_mps, 3.7, radius_m);
    assert_eq!([-1.0, 0.0, 0.49, 2.01, 3.0].map(at), [0.0; 5]);
    assert!((at(0.75) - 0.5).abs() < 1e-9 && at(1.2) == 1.0 && (at(1.75) - 0.5).abs() < 1e-9);
    assert_eq!(vortex_ring(2.0, 0.0, radius_m), 0.0);
}
