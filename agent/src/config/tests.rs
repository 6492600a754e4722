//! What is set reaches the flight; what is wrong is named.

use super::*;
use crate::flight::{Flight, RigKind};
use crate::model::airframe::Airframe;
use crate::sensor::Accuracy;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

#[test]
fn what_is_set_reaches_the_flight_and_the_rest_keeps_its_default() {
    let config = AgentConfig::from_toml(
        "id = \"clinic-2\"\ntick_rate_hz = 400\n[limits]\naltitude_max_m = 1.5\n[attacks]\nenabled = true\n\
         [failsafe]\nindependent = [\"imu 4\"]\n\
         [estimators]\nrun = [\"primary\", \"ekf_bias\"]\nin_loop = \"ekf_bias\"\n[log]\nmax_mib = 100\n\
         [site]\nlatitude_deg = 4.6\nlongitude_deg = -74.1\naltitude_m = 2600\ndate = \"2026-11-21\"\n\
         [[sensors.heights]]\nname = \"h\"\ntiming = { rate_hz = 10 }\nposition_flu_m = [0, 0, 0]\n\
         height = { sigma = 0.2, gate_sigmas = 3 }\n",
    )
    .unwrap();
    let mut flight = FlightConfig::new(Airframe::iris(), RigKind::Free, &Suite::string_rig());
    let before = flight.limits;
    config.apply(&mut flight).unwrap();
    assert_eq!(flight.independent, [SensorId::new(SensorKind::Imu, 4)]);
    let none = AgentConfig::from_toml("[failsafe]\nindependent = [\"imu 9\"]").unwrap();
    let refused = none.apply(&mut flight.clone()).unwrap_err().to_string();
    assert!(refused.contains("failsafe.independent = \"imu 9\" is not a sensor of this vehicle"), "{refused}");
    assert_eq!((flight.tick_rate_hz, flight.limits.altitude_max_m), (400.0, 1.5));
    assert_eq!(flight.limits.lateral_max_m, before.lateral_max_m);
    assert!(flight.attacks.enabled);
    assert_eq!(flight.sensor_model.heights, Accuracy { sigma: 0.2, gate: 3.0 });
    // Bogotá: about 8° west.
    assert!(
        (flight.sensor_model.imus.mag.declination_rad.to_degrees() + 7.9).abs() < 1.0,
        "{}",
        flight.sensor_model.imus.mag.declination_rad
    );
    assert_eq!(flight.estimators, [EstimatorKind::Complementary, EstimatorKind::EkfBias]);
    assert_eq!((config.id.as_str(), config.log.max_mib), ("clinic-2", 100));
    assert_eq!(AgentConfig::from_toml("").unwrap(), AgentConfig::default());
}

#[test]
fn limits_that_leave_no_altitude_make_no_flight() {
    // What is left out keeps its default, and the rig's reach counts as well.
    for (text, rig, most) in [
        ("[limits]\naltitude_min_m = 2.5", RigKind::Free, "2.5 is not below 2:"),
        (
            "[limits]\naltitude_min_m = 1.6\naltitude_max_m = 3",
            RigKind::Tethered { reach_m: 1.5 },
            "1.6 is not below 1.5:",
        ),
    ] {
        let mut flight = FlightConfig::new(Airframe::iris(), rig, &Suite::string_rig());
        AgentConfig::from_toml(text).unwrap().apply(&mut flight).unwrap();
        let refused = Flight::new(flight).unwrap_err().to_string();
        assert!(refused.contains("limits.altitude_min_m") && refused.contains(most), "{refused}");
    }
}

#[test]
fn errors_name_key_and_value() {
    for (text, expected) in [
        ("flavour = 3", "flavour"),
        ("tick_rate_hz = 20", "tick_rate_hz = 20 is not 50 to 1000 Hz"),
        ("tick_rate_hz = nan", "tick_rate_hz = NaN"),
        ("id = \"../x\"", "../x"),
        ("ground = \"nowhere\"", "ground = \"nowhere\" is not host:port"),
        ("[limits]\naltitude_max_m = -1", "limits.altitude_max_m = -1"),
        ("[limits]\naltitude_min_m = 2\naltitude_max_m = 1", "limits.altitude_min_m = 2"),
        ("[estimators]\nin_loop = \"oracle\"", "estimators.in_loop = \"oracle\""),
        ("[estimators]\ndecoder = \"l3\"", "estimators.decoder = \"l3\""),
        ("[estimators]\nwindow = 51", "estimators.window = 51 is not 5 to 50 slots"),
        ("[weights]\nstate = [1]\ninput = [1, 1, 1, 1]", "state"),
        ("[site]\nlatitude_deg = 95\nlongitude_deg = 0\ndate = \"2026-11-21\"", "latitude 95"),
        ("[site]\nlatitude_deg = 5\nlongitude_deg = 0\ndate = \"now\"", "site: \"now\" is not a day"),
        (
            "[[sensors.heights]]\nname = \"h\"\ntiming = { rate_hz = 10 }\nposition_flu_m = [0, 0, 0]\nheight = { sigma = -1 }",
            "sensors: suite: heights[0].height.sigma = -1",
        ),
        ("[controller]\nkind = \"magic\"", "controller.kind = \"magic\""),
        ("[margins]\npolicy = \"none\"", "margins.policy = \"none\""),
        ("[margins]\nphase_min_rad = 2", "margins.phase_min_rad = 2"),
        ("[log]\nmax_mib = 1", "log.max_mib = 1"),
    ] {
        let message = AgentConfig::from_toml(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text}\ngives: {message}");
    }
}

#[test]
fn every_key_stands_in_the_instructions_of_the_package() {
    let text = include_str!("../../../docs/install.md");
    let words: Vec<&str> = text.split(|c: char| !(c.is_alphanumeric() || c == '_')).collect();
    for table in [
        "",
        "[limits]",
        "[attacks]",
        "[failsafe]",
        "[envelope]",
        "[watermark]",
        "[estimators]",
        "[weights]",
        "[site]",
        "[controller]",
        "[margins]",
        "[log]",
        "[link]",
        "[[device]]",
        "[motors]",
    ] {
        // Who is asked for a key that there is not names all that there are.
        let message = AgentConfig::from_toml(&format!("{table}\nnowhere = 1")).unwrap_err().to_string();
        let (_, known) = message.split_once("unknown field `nowhere`, expected ").unwrap();
        for key in known.split('`').skip(1).step_by(2) {
            assert!(words.contains(&key), "{table} {key}");
        }
    }
}
