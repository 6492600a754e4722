//! GIVEN a double of a PX4 autopilot that keeps its documented rules WHEN the agent flies it by body rates and thrust, or by
//! pose, THEN it enters offboard mode at once, steps and lands, and lets it go when it cannot keep the rules any more.
//!
//! The double is pymavlink's (`tests/browser/autopilot.py`). No PX4 has been flown.

use std::cell::Cell;
use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Condvar, Mutex};
use std::time::Duration;

use plumbline_proto::v1;
use serde_json::Value;

use crate::wires::unless_late;
use crate::{Agent, pymavlink, udp_port};

const SCENARIO: &str = r#"
name = "autopilot"
seed = 1
duration_s = 38
airframe = "iris"
[rig.free]
height_m = 0.0
[suite]
preset = "string_rig"
[[script]]
at_s = 6
do = "arm"
[[script]]
at_s = 8
do = "mode"
mode = "altitude_hold"
[[script]]
at_s = 9
do = "setpoint"
altitude_m = 0.6
[[script]]
at_s = 18
do = "setpoint"
altitude_m = 1.0
[[script]]
at_s = 27
do = "mode"
mode = "land"
"#;

/// Altitude while held, m: one range sensor of 1 cm steps.
const HOLDING_M: f64 = 0.1;

/// The double, with what its command line takes besides its ports; `None` where there is no Python with pymavlink.
fn double(options: &[&str]) -> Option<Double> {
    let python = pymavlink("an autopilot's double")?;
    let turn = Turn::wait();
    // Not before: what is free while a test waits for its turn is somebody else's by then.
    let (port, vicon) = (udp_port(), udp_port());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/browser/autopilot.py");
    let mut double = Command::new(python);
    double.arg(script).arg(port.to_string()).args(options);
    if options.contains(&"--pose") {
        double.args(["--vicon", &vicon.to_string()]);
    }
    let process = double.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    Some(Double { process, port, vicon, _turn: turn })
}

struct Double {
    process: Child,
    /// Where the agent hears it, and where it hears of its pose, which only `--pose` has sent.
    port: u16,
    vicon: u16,
    _turn: Turn,
}

/// Doubles that fly at once: each takes a fifth of a core.
const AT_ONCE: usize = 2;
static FLYING: (Mutex<usize>, Condvar) = (Mutex::new(0), Condvar::new());

/// One of those that fly, until it is dropped.
struct Turn;

impl Turn {
    fn wait() -> Self {
        let flying = FLYING.0.lock().unwrap();
        *FLYING.1.wait_while(flying, |flying| *flying >= AT_ONCE).unwrap() += 1;
        Self
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        *FLYING.0.lock().unwrap() -= 1;
        FLYING.1.notify_one();
    }
}

/// What the double saw.
fn seen(mut double: Double) -> Value {
    drop(double.process.stdin.take());
    let mut text = String::new();
    double.process.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    assert!(double.process.wait().unwrap().success());
    let seen: Value = serde_json::from_str(&text).unwrap();
    LATE.set(Duration::from_secs_f64(seen["late_s"].as_f64().unwrap()));
    seen
}

thread_local! {
    /// How long the last double waited for its processor at most.
    static LATE: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Flies `test`. An IMU that is silent for 80 ms cuts the motors, as it should: a flight that fails while its double waited nearly as
/// long for its processor is none.
fn in_time(test: impl Fn()) {
    let watch = || {
        LATE.set(Duration::ZERO);
        || LATE.get()
    };
    unless_late("the double", watch, test);
}

fn fly(double: &Double) -> Agent {
    fly_on(&format!("udp:127.0.0.1:{}", double.port), "", "", SCENARIO)
}

/// Flies `scenario` with the autopilot on `port`, `devices` beside it and what `[motors]` says of it.
fn fly_on(port: &str, devices: &str, motors: &str, scenario: &str) -> Agent {
    let configuration = format!(
        "[rig.free]\nheight_m = 0.0\n\n{devices}\n[[device]]\nname = \"autopilot\"\ndriver = \"mavlink\"\nport = \"{port}\"\n\
         sensors = [\"imu 1\", \"barometer 1\", \"height 1\"]\n\n\
         [motors]\ndriver = \"mavlink\"\nport = \"{port}\"\nhover_thrust = 0.4\n{motors}"
    );
    Agent::start(tempfile::tempdir().unwrap(), "mavlink", &configuration, scenario, "")
}

/// Time, altitude, armed, offboard, ten times a second.
fn course(seen: &Value) -> Vec<(f64, f64, bool, bool)> {
    let row = |row: &Value| {
        (row[0].as_f64().unwrap(), row[1].as_f64().unwrap(), row[2].as_bool().unwrap(), row[3].as_bool().unwrap())
    };
    seen["altitudes"].as_array().unwrap().iter().map(row).collect()
}

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
        holds_and_lands(&seen);
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

/// Held 0.6 m and 1 m, as the script asks, and then stood on the floor.
fn holds_and_lands(seen: &Value) {
    let course = course(seen);
    // The seconds before the second setpoint and before the landing, by the double's own clock.
    let armed_s = course.iter().find(|row| row.2).expect("it armed").0;
    for (from_s, altitude_m) in [(8.0, 0.6), (17.0, 1.0)] {
        let held = course.iter().filter(|row| (armed_s + from_s..armed_s + from_s + 3.0).contains(&row.0));
        let off = held.map(|row| (row.1 - altitude_m).abs()).fold(0.0, f64::max);
        println!("holds {altitude_m} m within {off:.3} m behind the autopilot");
        assert!(off < HOLDING_M, "{altitude_m} m: {off} m off\n{seen}");
    }
    assert!(course.last().unwrap().1 < 0.05, "on the floor\n{seen}");
}

/// Estimate, place and velocity that ODOMETRY says are off by at most this: one-centimetre steps of a height, a millimetre of
/// motion capture, 20 ms between two.
const ODOMETRY_M: f64 = 0.06;
const ODOMETRY_MPS: f64 = 0.25;
const ODOMETRY_RAD: f64 = 0.05;

fn by_pose(vicon: u16) -> (String, &'static str, String) {
    let devices = format!(
        "[estimators]\nin_loop = \"lanes\"\n\n[[device]]\nname = \"vicon\"\ndriver = \"vicon\"\nport = \"udp:127.0.0.1:{vicon}\"\n\
         body = \"quad\"\nsensors = [\"mocap pose 1\"]\n"
    );
    (devices, "depth = \"pose\"\n", SCENARIO.replace("altitude_hold", "hold"))
}

#[test]
fn by_pose_the_autopilot_flies_altitude_steps_on_our_estimate() {
    in_time(|| {
        let Some(double) = double(&["--pose"]) else { return };
        let (devices, motors, scenario) = by_pose(double.vicon);
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
        holds_and_lands(&seen);
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
fn by_pose_an_estimate_that_is_lost_ends_offboard_mode_and_the_autopilot_lands() {
    in_time(|| {
        let Some(double) = double(&["--pose", "--hide_s", "13"]) else { return };
        let (devices, motors, scenario) = by_pose(double.vicon);
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
fn by_pose_over_a_serial_port_that_breaks_frames_and_signs() {
    in_time(|| {
        let folder = tempfile::tempdir().unwrap();
        let (terminal, key) = (folder.path().join("tty"), folder.path().join("key"));
        let digits: String = (0..32).map(|byte| format!("{byte:02x}")).collect();
        std::fs::write(&key, &digits).unwrap();
        let options = ["--pose", "--pty", terminal.to_str().unwrap(), "--key", &digits];
        let Some(double) = double(&options) else { return };
        while !terminal.exists() {
            std::thread::sleep(Duration::from_millis(20));
        }
        let (devices, motors, scenario) = by_pose(double.vicon);
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
        holds_and_lands(&seen);
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
