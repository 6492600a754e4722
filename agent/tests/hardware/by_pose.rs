//! GIVEN a double of a PX4 autopilot that knows of itself what the agent says WHEN it is flown by pose THEN it steps and lands on our
//! estimate, and lands by itself when that is lost.

use std::time::Duration;

use plumbline_proto::v1;
use serde_json::Value;

use crate::Agent;
use crate::autopilot::{SCENARIO, course, double, fly_on, holds_and_lands, in_time, in_time_through_a_terminal, seen};

/// Estimate, place and velocity that ODOMETRY says are off by at most this: one-centimetre steps of a height, a millimetre of
/// motion capture, 20 ms between two.
const ODOMETRY_M: f64 = 0.06;
const ODOMETRY_MPS: f64 = 0.25;
const ODOMETRY_RAD: f64 = 0.05;

fn pose(vicon: u16) -> (String, &'static str, String) {
    let devices = format!(
        "[estimators]\nin_loop = \"lanes\"\n\n[[device]]\nname = \"vicon\"\ndriver = \"vicon\"\nport = \"udp:127.0.0.1:{vicon}\"\n\
         body = \"quad\"\nsensors = [\"mocap pose 1\"]\n"
    );
    (devices, "depth = \"pose\"\n", SCENARIO.replace("altitude_hold", "hold"))
}

#[test]
fn the_autopilot_flies_altitude_steps_on_our_estimate() {
    in_time(|| {
        let Some(double) = double(&["--pose"]) else { return };
        let (devices, motors, scenario) = pose(double.vicon);
        let mut agent = fly_on(&format!("udp:127.0.0.1:{}", double.port), &devices, motors, &scenario);
        let status = agent.end();
        let seen = seen(double);
        let odometry = &seen["odometry"];
        println!("{odometry}");
        println!(
            "{:?}",
            ["refused", "wrong_setpoints", "vision_lost", "gap_max_s", "round_trips"].map(|n| (n, &seen[n]))
        );
        assert!(status.success(), "{}", agent.said());
        let events: Vec<v1::Event> = agent.recorded("/event");
        println!("{:?}", events.iter().map(|e| (e.time_us / 1000, e.text.as_str())).collect::<Vec<_>>());
        for never in ["refused", "left_offboard", "wrong_setpoints", "vision_lost", "disarmed_by_force"] {
            assert_eq!(seen[never], 0, "{never}: {}\n{seen}", agent.said());
        }
        let refused = odometry["refused"].as_object().unwrap();
        assert!(refused.keys().all(|why| why == "no TIMESYNC yet"), "{odometry}");
        let number = |key: &str| odometry[key].as_f64().unwrap();
        assert!((30.0..=52.0).contains(&number("rate_hz")) && number("resets") == 0.0, "{odometry}");
        assert!(
            number("place_error_max_m") < ODOMETRY_M && number("velocity_error_max_mps") < ODOMETRY_MPS,
            "{odometry}"
        );
        assert!(number("attitude_error_max_rad") < ODOMETRY_RAD && number("age_max_s") < 0.1, "{odometry}");
        holds_and_lands(&seen, &agent);
        assert!(
            seen["armed"] == false
                && seen["place"].as_array().unwrap()[..2].iter().all(|c| c.as_f64().unwrap().abs() < 0.1),
            "{seen}"
        );

        let told: Vec<v1::Description> = agent.recorded("/description");
        assert_eq!((told[0].actuation.as_str(), told[0].actuators.len()), ("pose", 0));
        // Applied is what it said that its outputs are.
        let flown: Vec<v1::Control> = agent.recorded("/control");
        let flying: Vec<&v1::Control> = flown.iter().filter(|c| c.motor_applied.iter().all(|t| *t > 0.2)).collect();
        assert!(flying.len() > 2000, "{}", flying.len());
        // As it was after the tick before.
        assert!(
            flying
                .iter()
                .all(|c| c.autopilot.as_ref().is_some_and(|a| a.motor_output.len() == 4 && a.thrust_asked.is_none()))
        );
        covariances_are_those_of_the_estimate(&agent, odometry);
    });
}

/// What pymavlink read of the last ODOMETRY above half a metre against the estimate that was recorded there.
fn covariances_are_those_of_the_estimate(agent: &Agent, odometry: &Value) {
    let lanes = format!("/estimate/{}", v1::EstimatorKind::Lanes as i32);
    let estimates: Vec<v1::Estimate> = agent.recorded(&lanes);
    let above = |estimate: &&v1::Estimate| estimate.position_enu_m.unwrap().z > 0.5;
    let last = estimates.iter().rfind(above).unwrap();
    let read = |list: usize, index: usize| odometry["above"][list][index].as_f64().unwrap_or(f64::NAN);
    let [place, speed] = [last.position_sigma_m.unwrap(), last.velocity_sigma_mps.unwrap()];
    // Down is the last of the three, and the velocity's is turned with a body that stands level.
    for (name, got, sigma) in [
        ("down", read(0, 11), place.z),
        ("north", read(0, 0), place.y),
        ("east", read(0, 6), place.x),
        ("climb", read(1, 11), speed.z),
    ] {
        println!("{name}: variance {got:.2e}, sigma recorded {sigma:.4}");
        assert!((got.sqrt() / sigma - 1.0).abs() < 0.1, "{name}: {got} and {sigma}");
    }
    assert!((15..21).all(|index| read(0, index).is_finite()) && read(0, 3).is_nan(), "{odometry}");
}

#[test]
fn an_estimate_that_is_lost_ends_offboard_mode_and_the_autopilot_lands() {
    in_time(|| {
        let Some(double) = double(&["--pose", "--hide_s", "13"]) else { return };
        let (devices, motors, scenario) = pose(double.vicon);
        let mut agent = fly_on(&format!("udp:127.0.0.1:{}", double.port), &devices, motors, &scenario);
        let status = agent.end();
        std::thread::sleep(Duration::from_secs(3));
        let seen = seen(double);
        assert!(!status.success(), "{}", agent.said());
        agent.assert_told(&["left offboard mode"]);
        assert_eq!(seen["disarmed_by_force"], 0, "{seen}");
        assert!(seen["left_offboard"].as_u64().unwrap() + seen["vision_lost"].as_u64().unwrap() == 1, "{seen}");
        assert!(course(&seen).last().unwrap().1 < 0.05, "it landed by itself\n{seen}");
    });
}

#[test]
fn over_a_serial_port_that_breaks_frames_and_signs() {
    in_time_through_a_terminal(|| {
        let folder = tempfile::tempdir().unwrap();
        let (terminal, key) = (folder.path().join("tty"), folder.path().join("key"));
        let digits: String = (0..32).map(|byte| format!("{byte:02x}")).collect();
        std::fs::write(&key, &digits).unwrap();
        let options = ["--pose", "--pty", terminal.to_str().unwrap(), "--key", &digits];
        let Some(double) = double(&options) else { return };
        while !terminal.exists() {
            std::thread::sleep(Duration::from_millis(20));
        }
        let (devices, motors, scenario) = pose(double.vicon);
        let motors = format!("{motors}signing_key = {key:?}\n");
        let mut agent = fly_on(terminal.to_str().unwrap(), &devices, &motors, &scenario);
        let status = agent.end();
        let seen = seen(double);
        println!("{} {}", seen["odometry"], seen["signing"]);
        assert!(status.success(), "{}", agent.said());
        assert_eq!(
            (&seen["left_offboard"], &seen["wrong_setpoints"], &seen["signing"]["bad"]),
            (&0.into(), &0.into(), &0.into())
        );
        assert!(seen["signing"]["good"].as_u64().unwrap() > 1000, "{seen}");
        holds_and_lands(&seen, &agent);
        // Garbage between frames costs itself, and is counted.
        let states: Vec<v1::DeviceState> = agent.recorded("/device/2");
        let state = states.last().unwrap();
        println!("{state:?}");
        assert!(state.faults > 0 && state.opened == 1 && state.rate_hz > 150.0, "{state:?}");
        assert!(
            state.round_trip_us.is_some_and(|us| us < 30e3) && state.clock_offset_us.is_some_and(|us| us > 1e6),
            "{state:?}"
        );
    });
}
