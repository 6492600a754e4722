//! A bound of the attack envelope, demanded for arming: GIVEN a demand WHEN the gains in use have no bound, or a larger one, THEN the
//! check refuses with the value.

use plumbline_agent::config::AgentConfig;
use plumbline_agent::event::text;
use plumbline_agent::flight::{Flight, FlightConfig, RigKind};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::sensor::suite::Suite;
use plumbline_proto::ids::GainsRevision;
use plumbline_proto::time::FlightTime;

fn flight(in_loop: &str) -> Flight {
    let text = format!("[envelope]\naltitude_max_m = 0.03\nsensors = 2\n[estimators]\nin_loop = \"{in_loop}\"\n");
    let mut config = FlightConfig::new(Airframe::iris(), RigKind::Free, &Suite::string_rig());
    AgentConfig::from_toml(&text).unwrap().apply(&mut config).unwrap();
    Flight::new(config).unwrap()
}

fn check(flight: &Flight) -> (bool, String) {
    let checks = flight.checks(FlightTime(0));
    let check = checks.iter().find(|check| check.name == "envelope").unwrap();
    (check.passed, check.reason.to_string())
}

#[test]
fn arming_waits_for_the_bound_and_refuses_a_larger_one() {
    let mut flight = flight("lanes");
    let told = |flight: &Flight, passed: bool, reason: &str| assert_eq!(check(flight), (passed, reason.to_owned()));
    told(&flight, false, "not bounded yet for the gains in use");
    flight.envelope_bounded(GainsRevision(7), Ok(Some(0.01)));
    told(&flight, false, "not bounded yet for the gains in use");
    flight.envelope_bounded(GainsRevision(0), Ok(Some(0.0251)));
    told(&flight, true, "2 sensors attacked move it 2.5 cm unseen, at most 3.0 cm");
    flight.envelope_bounded(GainsRevision(0), Ok(Some(0.18)));
    told(&flight, false, "2 sensors attacked move it 18.0 cm unseen, at most 3.0 cm");
    flight.envelope_bounded(GainsRevision(0), Ok(None));
    told(&flight, false, "no bound with 2 sensors attacked, at most 3.0 cm asked");
    flight.envelope_bounded(GainsRevision(0), Err(text(format_args!("no bound: why"))));
    told(&flight, false, "no bound: why");
}

#[test]
fn bounds_are_those_of_lanes_and_a_demand_is_in_range() {
    let mut flight = flight("ekf_bias");
    flight.envelope_bounded(GainsRevision(0), Ok(Some(0.0)));
    let (passed, reason) = check(&flight);
    assert!(!passed && reason.contains("Secure (lanes), EKF with biases is in the loop"), "{reason}");
    for (text, named) in [
        ("[envelope]\naltitude_max_m = -1.0\n", "envelope.altitude_max_m = -1"),
        ("[envelope]\naltitude_max_m = 0.1\nsensors = 9\n", "envelope.sensors = 9"),
        ("[envelope]\n", "altitude_max_m"),
        ("[watermark]\nrms_mps2 = 9\n", "watermark.rms_mps2 = 9"),
    ] {
        let refused = AgentConfig::from_toml(text).unwrap_err().to_string();
        assert!(refused.contains(named), "{refused}");
    }
    // Nothing demanded, nothing checked.
    let free = Flight::new(FlightConfig::new(Airframe::iris(), RigKind::Free, &Suite::string_rig())).unwrap();
    assert!(free.checks(FlightTime(0)).iter().all(|check| check.name != "envelope"));
}
