//! GIVEN a double of a PX4 autopilot that keeps its documented rules WHEN the agent flies it by body rates and thrust THEN it
//! enters offboard mode at once, steps and lands, and lets it go when it cannot keep the rules any more.
//!
//! The double is pymavlink's (`tests/browser/autopilot.py`). No PX4 has been flown.

use std::io::Read as _;
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::Agent;

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

/// The double; `None` where there is no Python with pymavlink.
fn double(port: u16, options: &[&str]) -> Option<Child> {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import pymavlink"]).output();
    if !has.is_ok_and(|ran| ran.status.success()) {
        plumbline_agent::recordings::skipped("an autopilot's double: no Python with pymavlink");
        return None;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/browser/autopilot.py");
    let mut double = Command::new(python);
    double.arg(script).arg(port.to_string()).args(options);
    Some(double.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap())
}

/// What the double saw.
fn seen(mut double: Child) -> Value {
    drop(double.stdin.take());
    let mut text = String::new();
    double.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    assert!(double.wait().unwrap().success());
    serde_json::from_str(&text).unwrap()
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn fly(port: u16) -> Agent {
    let configuration = format!(
        "[rig.free]\nheight_m = 0.0\n\n[[device]]\nname = \"autopilot\"\ndriver = \"mavlink\"\nport = \"udp:127.0.0.1:{port}\"\n\
         sensors = [\"imu 1\", \"barometer 1\", \"height 1\"]\n\n\
         [motors]\ndriver = \"mavlink\"\nport = \"udp:127.0.0.1:{port}\"\nhover_thrust = 0.4\n"
    );
    Agent::start(tempfile::tempdir().unwrap(), "mavlink", &configuration, SCENARIO, "")
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
    let port = free_port();
    let Some(double) = double(port, &["12"]) else { return };
    let mut agent = fly(port);
    let status = agent.end();
    let seen = seen(double);
    let figures =
        ["refused", "left_offboard", "wrong_setpoints", "rate_hz", "gap_max_s", "timesync_ms", "disarmed_by_force"];
    println!("{:?}", figures.map(|name| (name, seen[name].clone())));
    assert!(status.success(), "{}", agent.said());
    assert_eq!((&seen["refused"], &seen["left_offboard"], &seen["wrong_setpoints"]), (&0.into(), &0.into(), &0.into()));
    assert!(seen["rate_hz"].as_f64().unwrap() > 50.0 && seen["timesync_ms"].is_number(), "{seen}");
    assert!(seen["heartbeats"].as_u64().unwrap() > 20 && seen["armed"] == false, "{seen}");
    let course = course(&seen);
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

#[test]
fn an_agent_that_stops_is_left_by_the_autopilot_which_lands_and_is_not_cut_in_the_air() {
    let port = free_port();
    let Some(double) = double(port, &["12"]) else { return };
    let mut agent = fly(port);
    std::thread::sleep(Duration::from_secs(15));
    agent.signal("-STOP");
    // The autopilot waits for half a second; a landing from 0.6 m takes longer than one.
    std::thread::sleep(Duration::from_millis(1200));
    agent.signal("-CONT");
    std::thread::sleep(Duration::from_secs(4));
    agent.signal("-INT");
    let status = agent.end();
    let seen = seen(double);
    assert!(status.success(), "{}", agent.said());
    assert_eq!((&seen["left_offboard"], &seen["disarmed_by_force"]), (&1.into(), &0.into()), "{seen}");
    agent.assert_told(&["flight thread silent"]);
    let course = course(&seen);
    assert!(course.iter().any(|row| row.2 && !row.3 && row.1 > 0.2), "in the air, for itself\n{seen}");
    assert!(course.last().unwrap().1 < 0.05, "it landed by itself\n{seen}");
}

#[test]
fn a_pilot_who_takes_over_keeps_it() {
    let port = free_port();
    let Some(double) = double(port, &["12", "8"]) else { return };
    let mut agent = fly(port);
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
}

#[test]
fn another_autopilot_than_configured_is_refused_by_name() {
    let port = free_port();
    let Some(double) = double(port, &["3"]) else { return };
    let agent = fly(port);
    std::thread::sleep(Duration::from_secs(8));
    assert!(agent.said().contains("MAV_AUTOPILOT_ARDUPILOTMEGA, not MAV_AUTOPILOT_PX4"), "{}", agent.said());
    agent.signal("-INT");
    let seen = seen(double);
    assert!(seen["armed"] == false && course(&seen).iter().all(|row| !row.2), "{seen}");
}
