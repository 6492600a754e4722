//! A double of a PX4 autopilot that keeps its documented rules, and what is flown with it: by body rates and thrust in [`crate::offboard`],
//! by pose in [`crate::by_pose`].
//!
//! The double is pymavlink's (`tests/browser/autopilot.py`). No PX4 has been flown.

use std::cell::Cell;
use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Condvar, Mutex};
use std::time::Duration;

use serde_json::Value;

use crate::wires::{self, unless_late};
use crate::{Agent, pymavlink, udp_port};

pub const SCENARIO: &str = r#"
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
pub fn double(options: &[&str]) -> Option<Double> {
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

pub struct Double {
    process: Child,
    /// Where the agent hears it, and where it hears of its pose, which only `--pose` has sent.
    pub port: u16,
    pub vicon: u16,
    _turn: Turn,
}

/// Doubles that fly at once: each takes a fifth of a core.
const AT_ONCE: usize = 3;
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
pub fn seen(mut double: Double) -> Value {
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
pub fn in_time(test: impl Fn()) {
    let watch = || {
        LATE.set(Duration::ZERO);
        || LATE.get()
    };
    unless_late("the double", watch, test);
}

/// The same where it flies through a pseudo terminal, which may be served later still.
pub fn in_time_through_a_terminal(test: impl Fn()) {
    wires::in_time(|| in_time(&test));
}

pub fn fly(double: &Double) -> Agent {
    fly_on(&format!("udp:127.0.0.1:{}", double.port), "", "", SCENARIO)
}

/// Flies `scenario` with the autopilot on `port`, `devices` beside it and what `[motors]` says of it.
pub fn fly_on(port: &str, devices: &str, motors: &str, scenario: &str) -> Agent {
    let configuration = format!(
        "[rig.free]\nheight_m = 0.0\n\n{devices}\n[[device]]\nname = \"autopilot\"\ndriver = \"mavlink\"\nport = \"{port}\"\n\
         sensors = [\"imu 1\", \"barometer 1\", \"height 1\"]\n\n\
         [motors]\ndriver = \"mavlink\"\nport = \"{port}\"\nhover_thrust = 0.4\n{motors}"
    );
    Agent::start(tempfile::tempdir().unwrap(), "mavlink", &configuration, scenario, "")
}

/// Time, altitude, armed, offboard, ten times a second.
pub fn course(seen: &Value) -> Vec<(f64, f64, bool, bool)> {
    let row = |row: &Value| {
        (row[0].as_f64().unwrap(), row[1].as_f64().unwrap(), row[2].as_bool().unwrap(), row[3].as_bool().unwrap())
    };
    seen["altitudes"].as_array().unwrap().iter().map(row).collect()
}

/// Held 0.6 m and 1 m, as the script asks, and then stood on the floor.
pub fn holds_and_lands(seen: &Value, agent: &Agent) {
    let course = course(seen);
    // The seconds before the second setpoint and before the landing, by the double's own clock.
    let armed_s = course.iter().find(|row| row.2).expect("it armed").0;
    for (from_s, altitude_m) in [(8.0, 0.6), (17.0, 1.0)] {
        let held = course.iter().filter(|row| (armed_s + from_s..armed_s + from_s + 3.0).contains(&row.0));
        let off = held.map(|row| (row.1 - altitude_m).abs()).fold(0.0, f64::max);
        println!("holds {altitude_m} m within {off:.3} m behind the autopilot");
        assert!(off < HOLDING_M, "{altitude_m} m: {off} m off\n{}\n{seen}", agent.said());
    }
    assert!(course.last().unwrap().1 < 0.05, "on the floor\n{seen}");
}
