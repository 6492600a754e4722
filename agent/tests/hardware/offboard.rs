//! GIVEN a double of a PX4 autopilot that keeps its documented rules WHEN the agent flies it by body rates and thrust THEN it enters
//! offboard mode at once, steps and lands, and lets it go when it cannot keep the rules any more.

use std::time::Duration;

use plumbline_proto::v1;

use crate::autopilot::{SCENARIO, course, double, fly, fly_on, holds_and_lands, in_time, seen};

#[test]
fn altitude_steps_in_offboard_mode() {
    in_time(|| {
        let Some(double) = double(&["12"]) else { return };
        let mut agent = fly(&double);
        let status = agent.end();
        let seen = seen(double);
        let figures =
            ["refused", "left_offboard", "wrong_setpoints", "rate_hz", "gap_max_s", "timesync_ms", "disarmed_by_force"];
        println!("{:?}", figures.map(|name| (name, seen[name].clone())));
        assert!(status.success(), "{}", agent.said());
        assert_eq!(
            (&seen["refused"], &seen["left_offboard"], &seen["wrong_setpoints"]),
            (&0.into(), &0.into(), &0.into())
        );
        assert!(seen["rate_hz"].as_f64().unwrap() > 50.0 && seen["timesync_ms"].is_number(), "{seen}");
        assert!(seen["heartbeats"].as_u64().unwrap() > 20 && seen["armed"] == false, "{seen}");
        holds_and_lands(&seen, &agent);
        // What was asked for and what it said that it does, beside each other.
        let flown: Vec<v1::Control> = agent.recorded("/control");
        let flying = flown.iter().filter(|control| control.thrust_n > 10.0);
        let beside: Vec<[f64; 2]> = flying
            .filter_map(|control| control.autopilot.as_ref())
            .filter_map(|autopilot| Some([autopilot.thrust_asked?, autopilot.thrust_target?]))
            .collect();
        let off = beside.iter().map(|[asked, target]| (asked - target).abs()).sum::<f64>() / beside.len() as f64;
        println!("{} ticks with thrust asked for and aimed at, {off:.4} apart in the mean", beside.len());
        assert!(beside.len() > 2000 && off < 0.05, "{} {off}", beside.len());
        let outputs = flown.iter().filter(|c| c.autopilot.as_ref().is_some_and(|a| a.motor_output.len() == 4)).count();
        assert!(outputs > 2000, "{outputs}");
        let told: Vec<v1::Description> = agent.recorded("/description");
        assert_eq!((told[0].actuation.as_str(), told[0].actuators.len()), ("rates", 4));
    });
}

#[test]
fn intervals_that_are_refused_are_told_and_without_its_imu_it_is_not_used() {
    // What tells how it is aimed is flown without: it arms, and the state of its device, recorded each second, says so.
    let Some(double) = double(&["--deny", "83"]) else { return };
    let mut agent = fly(&double);
    agent.wait_recording();
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(agent.ended(), None, "{}", agent.said());
    agent.signal(libc::SIGINT);
    agent.end();
    seen(double);
    let states: Vec<v1::DeviceState> = agent.recorded("/device/1");
    let told = |state: &v1::DeviceState| state.up && state.reason.contains("refuses the interval of ATTITUDE_TARGET");
    assert!(states.iter().any(told), "{states:?}");

    let Some(double) = self::double(&["--deny", "105"]) else { return };
    let mut agent = fly(&double);
    agent.wait_said("the interval of HIGHRES_IMU is MAV_RESULT_DENIED, not MAV_RESULT_ACCEPTED");
    agent.signal(libc::SIGINT);
    seen(double);
}

#[test]
fn another_system_than_configured_is_named() {
    let Some(double) = double(&["--system", "7"]) else { return };
    let mut agent = fly(&double);
    agent.wait_said("system 1 is silent; system 7 is heard");
    agent.signal(libc::SIGINT);
    assert!(seen(double)["armed"] == false);
}

#[test]
fn an_autopilot_whose_clock_jumps_back_is_told() {
    in_time(|| {
        let Some(double) = double(&["--jump_s", "6"]) else { return };
        let mut agent = fly(&double);
        agent.wait_said("clock jumped");
        agent.signal(libc::SIGINT);
        agent.end();
        seen(double);
    });
}

#[test]
fn an_agent_that_stops_is_left_by_the_autopilot_which_lands_and_is_not_cut_in_the_air() {
    in_time(|| {
        let Some(double) = double(&["12"]) else { return };
        let mut agent = fly(&double);
        std::thread::sleep(Duration::from_secs(15));
        agent.signal(libc::SIGSTOP);
        // The autopilot waits for half a second; a landing from 0.6 m takes longer than one.
        std::thread::sleep(Duration::from_millis(1200));
        agent.signal(libc::SIGCONT);
        std::thread::sleep(Duration::from_secs(4));
        agent.signal(libc::SIGINT);
        let status = agent.end();
        let seen = seen(double);
        assert!(status.success(), "{}", agent.said());
        assert_eq!((&seen["left_offboard"], &seen["disarmed_by_force"]), (&1.into(), &0.into()), "{seen}");
        agent.assert_told(&["flight thread silent"]);
        let course = course(&seen);
        assert!(course.iter().any(|row| row.2 && !row.3 && row.1 > 0.2), "in the air, for itself\n{seen}");
        assert!(course.last().unwrap().1 < 0.05, "it landed by itself\n{seen}");
    });
}

#[test]
fn a_pilot_who_takes_over_keeps_it() {
    in_time(|| {
        let Some(double) = double(&["12", "8"]) else { return };
        let mut agent = fly(&double);
        let status = agent.end();
        // As long as the pilot's landing takes.
        std::thread::sleep(Duration::from_secs(3));
        let seen = seen(double);
        assert!(!status.success(), "{}", agent.said());
        agent.assert_told(&["left offboard mode"]);
        assert_eq!((&seen["left_offboard"], &seen["disarmed_by_force"]), (&0.into(), &0.into()), "{seen}");
        let course = course(&seen);
        let taken = course.iter().position(|row| row.2 && !row.3).expect("the pilot flew");
        assert!(course[taken..].iter().all(|row| !(row.2 && row.3)), "not taken back\n{seen}");
    });
}

#[test]
fn another_autopilot_than_configured_is_refused_by_name() {
    let Some(double) = double(&["3"]) else { return };
    // Its script arms soon, and in vain.
    let scenario = SCENARIO.replace("at_s = 6", "at_s = 1");
    let mut agent = fly_on(&format!("udp:127.0.0.1:{}", double.port), "", "", &scenario);
    agent.wait_said("MAV_AUTOPILOT_ARDUPILOTMEGA, not MAV_AUTOPILOT_PX4");
    std::thread::sleep(Duration::from_secs(2));
    agent.signal(libc::SIGINT);
    let seen = seen(double);
    assert!(seen["armed"] == false && course(&seen).iter().all(|row| !row.2), "{seen}");
}
