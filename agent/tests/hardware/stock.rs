//! GIVEN doubles of a stock PX4 and a stock ArduPilot WHEN the simulator stands behind their own protocols THEN they fly in
//! it as in theirs, receive what the attack injector makes of its sensors, and the flight is recorded.
//!
//! The doubles are Python's (`tests/browser/stock_px4.py`, whose messages pymavlink reads, and `stock_ardupilot.py`).
//! No PX4 and no ArduPilot has been flown.

use std::io::Read as _;
use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use plumbline_agent::recordings;
use plumbline_proto::{ids::SensorId, v1, v1::SensorKind};
use serde_json::Value;

use crate::{Agent, pymavlink, udp_port};

/// Only what watches: every other estimator beside it takes time and shows nothing here.
const CONFIGURATION: &str = "[estimators]\nrun = [\"ekf_bias\"]\nin_loop = \"ekf_bias\"\n";
/// Where the doubles hover, m above where they stood, and how well.
const HOVERS_M: f64 = 1.0;
const WITHIN_M: f64 = 0.15;

/// A double beside the agent.
struct Double(Child);

impl Double {
    /// `None` where there is no Python with pymavlink.
    fn start(script: &str, port: u16, seconds: f64, fault: &str) -> Option<Self> {
        let python = pymavlink("a stock autopilot's double")?;
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/browser").join(script);
        let mut double = Command::new(python);
        double.arg(script).arg(port.to_string()).arg(seconds.to_string());
        if !fault.is_empty() {
            double.arg(fault);
        }
        Some(Self(double.stdout(Stdio::piped()).spawn().unwrap()))
    }

    /// What it saw.
    fn seen(mut self) -> Value {
        let mut text = String::new();
        self.0.stdout.take().unwrap().read_to_string(&mut text).unwrap();
        assert!(self.0.wait().unwrap().success(), "{text}");
        serde_json::from_str(&text).unwrap()
    }
}

impl Drop for Double {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn scenario(name: &str) -> String {
    std::fs::read_to_string(plumbline_support::scenario_file(name)).unwrap()
}

fn tcp_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn agent(vehicle: &str, port: u16, scenario: &str, attacks: &str, more: &[&str]) -> Agent {
    let listen = format!("127.0.0.1:{port}");
    let mut options = vec!["--listen", &listen];
    options.extend(more);
    Agent::start_with(tempfile::tempdir().unwrap(), vehicle, CONFIGURATION, scenario, attacks, &options)
}

/// Flies the double of PX4 for `seconds` as fast as it can.
fn px4(seconds: f64, attacks: &str, fault: &str, more: &[&str]) -> Option<(Agent, Double)> {
    px4_in(&scenario("stock_px4"), seconds, attacks, fault, more)
}

fn px4_in(scenario: &str, seconds: f64, attacks: &str, fault: &str, more: &[&str]) -> Option<(Agent, Double)> {
    let port = tcp_port();
    let double = Double::start("stock_px4.py", port, seconds, fault)?;
    let options: Vec<_> = ["--speed", "max"].iter().chain(more).copied().collect();
    Some((agent("px4", port, scenario, attacks, &options), double))
}

fn ardupilot(seconds: f64, attacks: &str, fault: &str, more: &[&str]) -> Option<(Agent, Double)> {
    let port = udp_port();
    let options: Vec<_> = ["--speed", "max"].iter().chain(more).copied().collect();
    let agent = agent("ardupilot", port, &scenario("stock_ardupilot"), attacks, &options);
    Some((agent, Double::start("stock_ardupilot.py", port, seconds, fault)?))
}

fn numbers(value: &Value) -> Vec<f64> {
    let numbers = value.as_array().unwrap_or_else(|| panic!("{value}"));
    numbers.iter().map(|number| number.as_f64().unwrap_or(f64::NAN)).collect()
}

/// Rows of numbers, their time first.
fn rows(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap_or_else(|| panic!("{value}")).iter().map(numbers).collect()
}

/// Mean of column `column` of the rows of `from_s` to `to_s`.
fn mean(rows: &[Vec<f64>], column: usize, from_s: f64, to_s: f64) -> f64 {
    let among: Vec<f64> = rows.iter().filter(|row| (from_s..to_s).contains(&row[0])).map(|row| row[column]).collect();
    assert!(among.len() > 3, "{} rows of {from_s} to {to_s} s", among.len());
    among.iter().sum::<f64>() / among.len() as f64
}

fn assert_near(values: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    let off = values.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off <= tolerance && values.len() >= expected.len(), "{what}: {values:?} is not {expected:?}");
}

/// Its course: it hovers from `from_s` on.
fn assert_hovers(seen: &Value, from_s: f64) {
    let course = rows(&seen["course"]);
    let late: Vec<_> = course.iter().filter(|row| row[0] >= from_s).collect();
    assert!(late.len() > 5, "{seen}");
    let off = late.iter().map(|row| (row[3] - HOVERS_M).abs()).fold(0.0, f64::max);
    let drift = late.iter().map(|row| row[1].hypot(row[2])).fold(0.0, f64::max);
    println!("hovers within {off:.3} m of its altitude and {drift:.3} m of its place");
    assert!(off < WITHIN_M && drift < 0.5, "{off} m, {drift} m\n{}", seen["course"]);
}

fn flight_file(agent: &Agent) -> PathBuf {
    let files = std::fs::read_dir(agent.folder.path().join("log")).unwrap().flatten().map(|entry| entry.path());
    files.filter(|path| path.extension().is_some_and(|e| e == "mcap")).max().unwrap()
}

/// Its flight was closed in order, and nothing of it is missing.
fn assert_whole(agent: &Agent) {
    let marks: Vec<v1::FlightMark> = agent.recorded("/flight");
    let (first, last) = (marks.first().unwrap(), marks.last().unwrap());
    assert_eq!((marks.len(), first.last_sequence), (2, None), "{marks:?}");
    let bytes = std::fs::read(flight_file(agent)).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).count() as u64;
    assert_eq!(Some(first.first_sequence + messages - 1), last.last_sequence, "{marks:?}");
}

const ATTACKS: &str = r#"
[[attack]]
sensor = "height"
instance = 2
kind = "bias"
start_s = 6
duration_s = 2
magnitude = 0.5
[[attack]]
sensor = "imu"
instance = 2
channel = "gyro_z"
kind = "bias"
start_s = 6
duration_s = 2
magnitude = 0.3
[[attack]]
sensor = "barometer"
kind = "ramp"
start_s = 6
duration_s = 2
magnitude = 50
[[attack]]
sensor = "gnss"
channel = "x"
kind = "bias"
start_s = 6
duration_s = 2
magnitude = 3
"#;

#[test]
fn a_stock_px4_flies_in_lockstep_and_receives_the_attacked_samples() {
    let Some((mut agent, double)) = px4(9.0, ATTACKS, "", &[]) else { return };
    let seen = double.seen();
    let status = agent.end();
    assert!(!status.success() && agent.said().contains("closed the connection"), "{}", agent.said());
    println!("counts {}, {} s by the wall", seen["counts"], seen["wall_s"]);

    // Its clock goes on by one tick with each answer, and stands without one.
    assert_eq!((&seen["went_back"], &seen["bad"], &seen["unasked"]), (&0.into(), &0.into(), &0.into()), "{seen}");
    assert_eq!(seen["steps_us"].as_object().unwrap().keys().collect::<Vec<_>>(), ["4000"], "{}", seen["steps_us"]);
    assert_eq!(seen["senders"], serde_json::json!([[1, 200]]));
    assert!(seen["heartbeats"].as_u64().unwrap() >= 8, "{}", seen["heartbeats"]);

    // What is fresh, and nothing else: accelerometer, gyroscope, magnetometer 0x1ff; the barometer every fifth time.
    let fields = |id: &str| seen["fields"][id].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(
        (fields("0"), fields("1"), fields("2")),
        (vec!["511".into(), "7167".into()], vec!["511".into()], vec!["63".into()])
    );
    let count = |id: &str, bits: &str| seen["fields"][id][bits].as_f64().unwrap();
    assert!((count("0", "511") / count("0", "7167") - 4.0).abs() < 0.1, "{}", seen["fields"]);
    assert!(seen["fields"]["3"].is_null(), "PX4 takes three IMUs");

    // At rest, facing east: forward, right, down; gauss; hPa; 1e-7 degrees.
    let rest = |key: &str| numbers(&seen["rest"][key]);
    for id in 0..3 {
        assert_near(&rest(&format!("accel {id}")), &[0.0, 0.0, -9.81], 0.25, "specific force, m/s²");
        assert_near(&rest(&format!("gyro {id}")), &[0.0; 3], 0.02, "angular rate, rad/s");
    }
    assert_near(&rest("mag 0"), &[-0.032, -0.168, -0.153], 0.02, "field, gauss");
    assert_near(&rest("barometer")[..2], &[1009.66, 30.1], 2.5, "pressure and its altitude");
    assert_near(&rest("gps")[..2], &[-34.918, -56.167], 5e-5, "place");
    assert_near(&rest("gps")[2..], &[30.1, 3.0, 11.0], 6.0, "altitude, fix, satellites");
    assert_near(&rest("distance 0"), &[0.11, 25.0, 0.0], 0.05, "height, looking down, laser");
    let half = std::f64::consts::FRAC_1_SQRT_2;
    assert_near(&rest("state"), &[half, 0.0, 0.0, half], 0.02, "attitude");
    assert_near(&rest("state")[4..5], &[-1000.0], 20.0, "specific force, mg");
    assert_near(&rest("state")[5..], &[30.11], 0.05, "altitude, m");
    assert_hovers(&seen, 5.5);

    // The attacks, on the samples that PX4 receives, from their onsets on.
    let height = |id: &str| rows(&seen["distances"][id]);
    let apart = |from_s, to_s| mean(&height("1"), 1, from_s, to_s) - mean(&height("0"), 1, from_s, to_s);
    println!("height 2 off by {:.3} m, {:.3} m before", apart(6.1, 8.0), apart(4.0, 6.0));
    assert!((apart(6.1, 8.0) - 0.5).abs() < 0.05 && apart(4.0, 6.0).abs() < 0.05 && apart(8.1, 9.0).abs() < 0.05);
    let onset = height("1").iter().find(|row| row[1] > 1.4).unwrap()[0];
    assert!((6.0..6.11).contains(&onset), "{onset} s");
    let turning = |id: &str, from_s, to_s| mean(&rows(&seen["gyro_z"][id]), 1, from_s, to_s);
    let apart = turning("1", 6.0, 8.0) - turning("0", 6.0, 8.0);
    assert!((apart + 0.3).abs() < 0.02, "0.3 rad/s to the left is −0.3 about down: {apart}");
    let pressure = rows(&seen["barometer"]);
    let ramp = mean(&pressure, 1, 7.9, 8.0) - mean(&pressure, 1, 5.5, 6.0);
    assert!((ramp - 0.98).abs() < 0.1, "50 Pa/s for 1.95 s, in hPa: {ramp}");
    let east = mean(&rows(&seen["gps"]), 2, 6.1, 8.0) - mean(&rows(&seen["gps"]), 2, 4.0, 6.0);
    assert!((east - 3.0).abs() < 0.7, "{east} m to the east");

    // The flight file has all of it: truth, motors, samples before and behind the injector.
    assert_whole(&agent);
    let recording = recordings::open(&flight_file(&agent)).unwrap();
    let info = recording.info();
    assert!(info.has_truth && info.has_motors, "{info:?}");
    let attacked =
        |kind, instance| info.attacked.iter().find(|(id, _)| *id == SensorId::new(kind, instance)).unwrap().1;
    let recorded = attacked(SensorKind::Height, 2).as_seconds();
    assert!((6.0..6.11).contains(&recorded), "{recorded} s");
    assert_eq!(info.attacked.len(), 4, "{:?}", info.attacked);
    let described: Vec<v1::Description> = agent.recorded("/description");
    assert_eq!(described[0].vehicle, "px4");
    let control: Vec<v1::Control> = agent.recorded("/control");
    assert!(control.iter().any(|c| c.armed) && !control[10].armed, "armed as the autopilot says");
    let hovering = &control[control.len() - 50].motor_applied;
    assert!(hovering.iter().all(|motor| (0.5..0.9).contains(motor)), "{hovering:?}");
    let truth: Vec<v1::Truth> = agent.recorded("/truth");
    let height_m = truth.last().unwrap().position_enu_m.as_ref().unwrap().z;
    assert!((height_m - 1.11).abs() < WITHIN_M, "{height_m} m");
}

#[test]
fn the_same_seed_and_the_same_answers_give_the_same_bytes() {
    let flown = || {
        let (mut agent, double) = px4(4.0, "", "", &[])?;
        let mut seen = double.seen();
        agent.end();
        seen.as_object_mut().unwrap().remove("wall_s");
        Some(seen)
    };
    let Some(first) = flown() else { return };
    assert_eq!(first, flown().unwrap());
}

/// A world whose IMUs lose samples, an attack that withholds every one of IMU 1 for a second, and motion capture.
#[test]
fn a_px4_whose_first_imu_is_silent_is_not_waited_for() {
    let scenario = scenario("stock_px4").replace("add = [\"gnss\"]", "add = [\"gnss\", \"mocap_pose\"]");
    let scenario = scenario.replace("tick_rate_hz", "world = \"harsh\"\ntick_rate_hz");
    let attack = "[[attack]]\nsensor = \"imu\"\nkind = \"dropout\"\nmagnitude = 1\nstart_s = 3\nduration_s = 1\n";
    let Some((mut agent, double)) = px4_in(&scenario, 5.0, attack, "", &["--answer-s", "5"]) else { return };
    let seen = double.seen();
    agent.end();
    assert_eq!((&seen["stopped"], &seen["went_back"]), (&"done".into(), &0.into()), "{}", agent.said());
    // With its clock, but nothing of its sensors, or of the barometer alone.
    let fields = seen["fields"]["0"].as_object().unwrap();
    let silent: u64 = ["0", "6656"].iter().filter_map(|bits| fields.get(*bits)?.as_u64()).sum();
    assert!((250..400).contains(&silent), "{fields:?}");
    let poses = rows(&seen["odometry"]);
    assert!(poses.len() > 300, "{} poses", poses.len());
    // NED (1), motion capture (6): the numbers of the common dialect.
    assert_eq!(poses[100][4..], [1.0, 6.0]);
    assert_near(&poses[20][1..4], &[0.0, 0.0, -0.11], 0.03, "pose at rest");
}

#[test]
fn an_old_answer_is_no_answer_and_noise_between_them_is_told() {
    for (fault, told) in [("old", None), ("noise", Some("no MAVLink"))] {
        let Some((mut agent, double)) = px4(7.0, "", fault, &[]) else { return };
        let seen = double.seen();
        agent.end();
        assert_hovers(&seen, 5.5);
        if let Some(told) = told {
            agent.assert_told(&[told]);
        }
    }
}

#[test]
fn a_px4_that_leaves_answers_no_more_or_sends_garbage_ends_the_flight_with_its_reason() {
    for (fault, reasons) in [
        ("leave", ["closed the connection", "PX4 at 127.0.0.1:"]),
        ("silent", ["no actuator controls for 1 s (damaged frames: 0, bytes of no frame: 0), at 6.0", "PX4 at"]),
        ("garbage", ["no actuator controls for 1 s (damaged frames:", "PX4 at 127.0.0.1:"]),
    ] {
        let Some((mut agent, double)) = px4(12.0, "", fault, &["--answer-s", "1"]) else { return };
        let status = agent.end();
        assert!(!status.success(), "{fault}: {}", agent.said());
        let last = agent.said().lines().last().unwrap_or_default().to_owned();
        assert!(reasons.iter().all(|reason| last.contains(reason)), "{fault}: {last}");
        agent.assert_told(&["the vehicle can be flown no longer: PX4 at", reasons[0]]);
        assert_whole(&agent);
        double.seen();
    }
}

#[test]
fn a_px4_without_lockstep_flies_in_real_time() {
    let port = tcp_port();
    let Some(double) = Double::start("stock_px4.py", port, 7.0, "free") else { return };
    let mut agent = agent("px4", port, &scenario("stock_px4"), "", &["--speed", "1"]);
    let seen = double.seen();
    agent.end();
    agent.assert_told(&["flies without lockstep: in real time only"]);
    assert!(seen["unasked"].as_u64().unwrap() > 30, "its simulator does not wait: {}", seen["unasked"]);
    assert!((6.5..20.0).contains(&seen["wall_s"].as_f64().unwrap()), "{}", seen["wall_s"]);
}

#[test]
fn asked_to_end_it_ends_at_once_and_finishes_the_file() {
    let Some((mut agent, _double)) = px4(60.0, "", "silent", &["--answer-s", "60"]) else { return };
    agent.wait_recording();
    // It waits for an answer that does not come, once its file grows no longer.
    let length = || std::fs::metadata(flight_file(&agent)).unwrap().len();
    let mut grown = None;
    while grown != Some(length()) {
        grown = Some(length());
        std::thread::sleep(Duration::from_secs(1));
    }
    agent.signal(libc::SIGINT);
    let asked = Instant::now();
    let status = agent.end();
    assert!(status.success(), "{}", agent.said());
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    assert_whole(&agent);
}

#[test]
fn what_cannot_be_flown_is_refused_before_anybody_is_waited_for() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let datagrams = UdpSocket::bind("127.0.0.1:0").unwrap();
    let (port, udp) = (taken.local_addr().unwrap().port(), datagrams.local_addr().unwrap().port());
    let changed = |from: &str, to: &str| scenario("stock_px4").replace(from, to);
    let attack =
        |sensor: &str| format!("[[attack]]\nsensor = {sensor}\nkind = \"zero\"\nstart_s = 1\nduration_s = 1\n");
    for (vehicle, port, scenario, attacks, more, reason) in [
        (
            "px4",
            port,
            scenario("stock_px4"),
            String::new(),
            &[][..],
            format!("cannot listen for PX4 on 127.0.0.1:{port}: Address already in use"),
        ),
        (
            "ardupilot",
            udp,
            scenario("stock_ardupilot"),
            String::new(),
            &[][..],
            format!("cannot listen for ArduPilot on 127.0.0.1:{udp}: Address already in use"),
        ),
        (
            "px4",
            0,
            changed("\"iris\"", "\"clinic\""),
            String::new(),
            &[][..],
            "airframe clinic: no rotor front right, where motor 1".into(),
        ),
        (
            "px4",
            0,
            changed("tick_rate_hz = 250", "tick_rate_hz = 500"),
            String::new(),
            &[][..],
            "tick_rate_hz = 500: PX4 is simulated at 200 to 400 Hz".into(),
        ),
        (
            "px4",
            0,
            changed("kind = \"imu\"\nrate_hz = 250", "kind = \"imu\"\nrate_hz = 200"),
            String::new(),
            &[][..],
            "IMU 1 samples at 200 Hz, the scenario ticks at 250 Hz".into(),
        ),
        ("px4", 0, scenario("stock_px4"), attack("\"imu\"\ninstance = 4"), &[][..], "imu 4 has no way to PX4".into()),
        (
            "ardupilot",
            0,
            scenario("stock_ardupilot"),
            attack("\"barometer\""),
            &[][..],
            "barometer 1 has no way to ArduPilot".into(),
        ),
        (
            "px4",
            0,
            scenario("stock_px4"),
            String::new(),
            &["--answer-s", "0"][..],
            "--answer-s 0 is not 0.1 to 3600".into(),
        ),
        (
            "px4",
            0,
            scenario("stock_px4"),
            String::new(),
            &["--speed", "0"][..],
            "--speed 0: only a recording begins standing still".into(),
        ),
    ] {
        let mut agent = agent(vehicle, port, &scenario, &attacks, more);
        let status = agent.end();
        assert!(!status.success() && agent.said().contains(&reason), "{reason}: {}", agent.said());
    }
}

#[test]
fn a_stock_ardupilot_flies_and_receives_the_attacked_samples() {
    let attacks =
        ATTACKS.split("[[attack]]").skip(1).take(2).map(|attack| format!("[[attack]]{attack}")).collect::<String>();
    let attacks = attacks.replace("sensor = \"imu\"\ninstance = 2", "sensor = \"imu\"\ninstance = 1");
    for fault in ["", "wide"] {
        // Its own loop flies by the attacked gyroscope.
        let attacks = if fault.is_empty() { attacks.as_str() } else { "" };
        let Some((mut agent, double)) = ardupilot(9.0, attacks, fault, &["--script", "--answer-s", "3"]) else {
            return;
        };
        let seen = double.seen();
        agent.end();
        assert_eq!((&seen["went_back"], &seen["stopped"]), (&0.into(), &"done".into()), "{seen}");
        assert_eq!(seen["steps_ms"].as_object().unwrap().keys().collect::<Vec<_>>(), ["2.5"], "{}", seen["steps_ms"]);
        let keys = ["battery", "imu", "position", "quaternion", "rng_1", "rng_2", "rng_3", "timestamp", "velocity"];
        assert_eq!(seen["keys"], serde_json::json!(keys));
        let rest = numbers(&seen["rest"]);
        assert_near(&rest[..3], &[0.0, 0.0, -9.81], 0.25, "specific force, m/s²");
        assert_near(&rest[3..6], &[0.0; 3], 0.02, "angular rate, rad/s");
        assert_near(&rest[6..9], &[0.0, 0.0, -0.109], 0.02, "place, down");
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert_near(&rest[9..], &[half, 0.0, 0.0, half], 0.02, "attitude: facing east");
        assert_hovers(&seen, 5.5);
        assert!((10.0..13.0).contains(&seen["volts"].as_f64().unwrap()), "{}", seen["volts"]);
        if attacks.is_empty() {
            continue;
        }
        let ranges = rows(&seen["ranges"]);
        let apart = |from_s, to_s| mean(&ranges, 2, from_s, to_s) - mean(&ranges, 1, from_s, to_s);
        println!("height 2 off by {:.3} m, {:.3} m before", apart(6.2, 8.0), apart(4.0, 6.0));
        assert!((apart(6.2, 8.0) - 0.5).abs() < 0.05 && apart(4.0, 6.0).abs() < 0.05);
        // The gyroscope says −0.3 rad/s about down while nothing turns; the vehicle stands where the error of yaw makes up for
        // that, 0.2 rad off by the gains of the double.
        let said = mean(&rows(&seen["gyro_z"]), 1, 7.2, 8.0);
        let truth: Vec<v1::Truth> = agent.recorded("/truth");
        let yaw = |t: &v1::Truth| vec![t.time_us as f64 * 1e-6, t.roll_pitch_yaw_rad.as_ref().unwrap().z];
        let yaws: Vec<_> = truth.iter().map(yaw).collect();
        let turned = mean(&yaws, 1, 7.2, 8.0) - mean(&yaws, 1, 5.0, 6.0);
        println!("gyroscope at {said:.3} rad/s, turned by {turned:.3} rad");
        assert!((said + 0.3).abs() < 0.05 && (turned + 0.2).abs() < 0.05, "{said} rad/s, {turned} rad");
        assert_whole(&agent);
        let info = recordings::open(&flight_file(&agent)).unwrap().info().clone();
        assert!(info.has_truth && info.has_motors && info.attacked.len() == 2, "{info:?}");
        let described: Vec<v1::Description> = agent.recorded("/description");
        assert_eq!(described[0].vehicle, "ardupilot");
    }
}

#[test]
fn lost_doubled_and_foreign_packets_cost_an_ardupilot_nothing() {
    for fault in ["lost", "twice", "skips", "wrong"] {
        let Some((mut agent, double)) = ardupilot(7.0, "", fault, &["--answer-s", "3"]) else { return };
        let seen = double.seen();
        agent.end();
        println!("{fault}: asked again {}, repeated {}", seen["again"], seen["repeated"]);
        assert_eq!((&seen["went_back"], &seen["stopped"]), (&0.into(), &"done".into()), "{fault}: {seen}");
        assert_eq!(
            seen["steps_ms"].as_object().unwrap().keys().collect::<Vec<_>>(),
            ["2.5"],
            "{fault}: the world stood"
        );
        assert_hovers(&seen, 5.5);
        let (again, repeated) = (seen["again"].as_u64().unwrap(), seen["repeated"].as_u64().unwrap());
        match fault {
            "lost" => assert!(again > 5, "{seen}"),
            "twice" => assert!(repeated > 5, "{seen}"),
            "wrong" => agent.assert_told(&["is no servo packet: magic 18459 is not 18458 or 29569"]),
            _ => {}
        }
    }
}

#[test]
fn an_ardupilot_started_anew_begins_where_it_stood_and_one_that_is_silent_ends_the_flight() {
    let Some((mut agent, double)) = ardupilot(6.0, "", "anew", &["--answer-s", "3"]) else { return };
    let seen = double.seen();
    agent.end();
    let after = numbers(&seen["after_anew"]);
    assert!(after[0] < 0.01 && after[3] > -0.2, "time and place of its first line: {after:?}");
    agent.assert_told(&["ArduPilot was started anew at"]);
    let control: Vec<v1::Control> = agent.recorded("/control");
    assert!(control.windows(2).all(|two| two[1].time_us > two[0].time_us), "flight time goes on");

    let Some((mut agent, double)) = ardupilot(20.0, "", "silent", &["--answer-s", "1"]) else { return };
    let status = agent.end();
    assert!(
        !status.success() && agent.said().contains("no servo packet for 1 s (datagrams of none: 0), at 5.0"),
        "{}",
        agent.said()
    );
    assert_whole(&agent);
    double.seen();
}
