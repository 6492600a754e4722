//! GIVEN a wire rig with a device of each driver WHEN the agent flies it THEN the altitude is that of the same flight without
//! wires, what is lost is told and comes back, motion capture that is silent refuses arming and is a failsafe in flight,
//! and what answers is found by asking.

use std::process::Command;
use std::time::Duration;

use plumbline_agent::config::AgentConfig;
use plumbline_agent::sim::Scenario;
use plumbline_proto::v1;
use plumbline_support::flown;
use plumbline_wires::{Plug, Wire, Wiring};

use crate::wires::{Flown, HOLDING_M, SCENARIO, in_time, rig};

/// The issue asks for the figures of the flight without wires within 10 %.
const ALTITUDE_LIMIT: f64 = 1.1;

/// Altitude less setpoint from the take-off on: rms over both steps, and over what is held 5 s after each; the largest
/// overshoot, m. Times count from where the vehicle has left its strings by 5 cm, as the rig began before the agent.
fn figures(truth: &[(f64, f64)]) -> [f64; 3] {
    let begun = truth.iter().find(|(_, z)| *z > 0.35).unwrap().0;
    let steps = [(0.0, 15.0, 0.5), (16.0, 29.0, 0.8)];
    let within = |from: f64, until: f64| {
        truth.iter().filter(move |(t, _)| (begun + from..begun + until).contains(t)).map(|(_, z)| *z)
    };
    let rms = |after: f64| {
        let all =
            steps.iter().flat_map(|(from, until, to)| within(from + after, *until).map(move |z| (z - to).powi(2)));
        let all: Vec<f64> = all.collect();
        (all.iter().sum::<f64>() / all.len() as f64).sqrt()
    };
    let beyond = steps.iter().flat_map(|(from, until, to)| within(*from, *until).map(move |z| z - to));
    [rms(0.0), rms(5.0), beyond.fold(0.0, f64::max)]
}

/// Of the same flight in the simulator alone.
fn without_wires(scenario: &Scenario) -> [f64; 3] {
    let mut flown = flown::Flown::with_config(scenario.clone(), scenario.flight_config());
    flown.until(scenario.duration_s);
    figures(&flown.rows.iter().map(|row| (row.t_s, row.truth.position_enu_m.z)).collect::<Vec<_>>())
}

/// A few that were on their way when the recording began or ended.
const SCANS_AT_ENDS: usize = 5;

/// GIVEN scanners whose scans are recorded WHEN a flight is over THEN its file has each scan as it was sent, at the time of the
/// height that was found in it.
fn scans_are_those_on_the_wire(flown: &Flown) {
    let sent = flown.rig.scans();
    for height in [0, 1] {
        let scans: Vec<v1::Scan> = flown.agent.recorded(&format!("/scan/{}", height + 1));
        let heights: Vec<v1::HeightSample> = flown.agent.recorded(&format!("/sensor/height/{}", height + 1));
        let of = |stamp_ms| sent.iter().find(move |scan| scan.height == height && scan.stamp_ms == stamp_ms);
        for scan in &scans {
            let sent = of(scan.device_time_ms).unwrap_or_else(|| panic!("none was sent at {} ms", scan.device_time_ms));
            let same = scan.range_mm.iter().copied().eq(sent.ranges_mm.iter().map(|mm| u32::from(*mm)));
            assert!(same, "the scan of {} ms", scan.device_time_ms);
            assert!((scan.first_angle_rad + 2.086).abs() < 1e-3 && scan.position_flu_m.is_some(), "{scan:?}");
        }
        let beside = heights.iter().filter(|sample| scans.iter().any(|scan| scan.time_us == sample.time_us)).count();
        println!(
            "height {}: {} scans and {} heights recorded, {beside} together",
            height + 1,
            scans.len(),
            heights.len()
        );
        assert!(scans.len() > 300 && beside + SCANS_AT_ENDS >= heights.len(), "{beside} of {}", heights.len());
    }
}

fn altitude_is_that_without_wires(wiring: &Wiring) {
    in_time(|| {
        let mut flown = Flown::on(wiring, SCENARIO, "");
        flown.hold(0.5);
        flown.hold(0.8);
        flown.land();
        let truths = flown.rig.truths();
        let seconds = |at: std::time::Instant| at.saturating_duration_since(truths[0].0).as_secs_f64();
        let truth: Vec<(f64, f64)> = truths.iter().map(|(at, truth)| (seconds(*at), truth.position_enu_m.z)).collect();
        let (wired, plain) = (figures(&truth), without_wires(flown.rig.scenario()));
        let names = ["altitude_rms", "altitude_held_rms", "altitude_overshoot"];
        for ((name, wired), plain) in names.into_iter().zip(wired).zip(plain) {
            println!("{name}: {wired:.4} m through the wires, {plain:.4} m without, {:.2} times", wired / plain);
        }
        scans_are_those_on_the_wire(&flown);
        let told = flown.agent.said();
        let lost: Vec<_> = told.lines().filter(|line| line.contains("device lost")).collect();
        assert_eq!((flown.agent.ups(), lost), (wiring.devices.len(), vec![]), "{told}");
        assert!(wired[0] < ALTITUDE_LIMIT * plain[0], "{wired:?} {plain:?}");
    });
}

#[test]
fn through_a_device_of_each_driver_the_altitude_is_that_without_wires() {
    altitude_is_that_without_wires(&Wiring::every());
}

#[test]
fn through_the_other_ways_to_the_same_the_altitude_is_that_without_wires() {
    altitude_is_that_without_wires(&Wiring::others());
}

/// Everything of which more than one is there, and what a flight does without: out, or there and silent.
const LOST: [(&str, Plug); 8] = [
    ("imu2", Plug::Out),
    ("imu3", Plug::Hanging),
    ("height1", Plug::Hanging),
    ("baro1", Plug::Out),
    ("baro2", Plug::Hanging),
    ("gnss", Plug::Hanging),
    ("mocap", Plug::Out),
    ("battery", Plug::Hanging),
];

#[test]
fn devices_on_the_bus_gnss_and_motion_capture_are_lost_in_flight_and_come_back() {
    in_time(|| {
        let wiring = Wiring::every();
        let mut flown = Flown::on(&wiring, SCENARIO, "");
        flown.hold(0.5);
        LOST.iter().for_each(|(name, plug)| flown.rig.plug(name, *plug));
        // GNSS of 1 Hz counts as lost after five seconds.
        flown.wait("all lost", |flown| LOST.iter().all(|(name, _)| flown.agent.lost(name)));
        assert!(flown.off(0.5) < 2.0 * HOLDING_M, "{} m off", flown.off(0.5));
        LOST.iter().for_each(|(name, _)| flown.rig.plug(name, Plug::In));
        let ups = wiring.devices.len() + LOST.len();
        flown.wait("all back", |flown| flown.agent.ups() == ups);
        flown.hold(0.8);
        flown.land();
        for (name, _) in LOST {
            flown.agent.assert_told(&[&format!("{name} lost"), &format!("{name} gives readings")]);
        }
    });
}

/// Motion capture alone knows where the vehicle is; armed twice, as it is refused first.
const HOLD: &str = r#"
name = "hold"
seed = 2
duration_s = 90
airframe = "iris"
[rig.hanging_strings]
[suite]
preset = "string_rig"
[battery]
charge = 0.95
[[script]]
at_s = 4
do = "arm"
[[script]]
at_s = 12
do = "arm"
[[script]]
at_s = 13
do = "mode"
mode = "altitude_hold"
[[script]]
at_s = 14
do = "setpoint"
altitude_m = 0.5
[[script]]
at_s = 22
do = "mode"
mode = "hold"
"#;

#[test]
fn motion_capture_that_is_silent_refuses_arming_and_is_a_failsafe_in_flight() {
    in_time(|| {
        let mut wiring = Wiring::every();
        wiring.devices.retain(|device| device.name != "gnss");
        let mut flown = Flown::on(&wiring, HOLD, "");
        // Frames come, and the body is in none of them.
        flown.rig.plug("mocap", Plug::Hanging);
        flown.wait("the others are up", |flown| flown.agent.ups() >= wiring.devices.len() - 1);
        flown.wait("mocap is lost", |flown| flown.agent.lost("mocap"));
        // The script arms in the meantime.
        std::thread::sleep(Duration::from_secs(5));
        let turning = |flown: &Flown| flown.rig.pulses().iter().any(|(_, widths)| widths[0] > 1050.0);
        assert!(!turning(&flown), "armed without motion capture: {}", flown.agent.said());
        flown.rig.plug("mocap", Plug::In);
        flown.hold(0.5);
        // In hold, for a while.
        let airborne = flown.rig.truths().len();
        flown.wait("hold", |flown| flown.rig.truths().len() > airborne + 10 * 200);
        flown.rig.plug("mocap", Plug::Out);
        flown.stands(std::time::Instant::now());
        flown.agent.signal(libc::SIGINT);
        flown.land();
        flown.agent.assert_told(&[
            "mocap lost",
            "horizontal position lost: altitude hold",
            "horizontal position lost for 5 s",
        ]);
    });
}

fn driver_on(device: &toml::Value) -> (&str, &str, Option<i64>) {
    let address = device.get("address").and_then(toml::Value::as_integer);
    (device["driver"].as_str().unwrap(), device["port"].as_str().unwrap(), address)
}

/// What is plugged in is found by asking, as a configuration that the agent takes; and each shows its readings.
#[test]
fn what_answers_on_ports_and_bus_is_found_by_asking_and_shows_its_readings() {
    let folder = tempfile::tempdir().unwrap();
    let wiring = Wiring::every();
    let rig = rig(SCENARIO, folder.path(), &wiring);
    let file = folder.path().join("agent.toml");
    std::fs::write(&file, rig.configuration()).unwrap();
    let wired: toml::Table = rig.configuration().parse().unwrap();
    let wired = wired["device"].as_array().unwrap();
    // One of them says nothing. Voltmeters have the address of motors, and motion capture has no port of its own.
    rig.plug("height2", Plug::Hanging);
    let silent = ["height2", "battery", "mocap"];
    let mut asked: Vec<&str> = Vec::new();
    for (device, attached) in wired.iter().zip(&wiring.devices) {
        let (_, port, _) = driver_on(device);
        if attached.wire != Wire::Datagrams && !asked.contains(&port) {
            asked.push(port);
        }
    }
    let agent = |arguments: &[&str]| {
        let run = Command::new(env!("CARGO_BIN_EXE_plumbline-agent")).arg("devices").args(arguments).output().unwrap();
        let said = String::from_utf8(run.stdout).unwrap();
        assert!(run.status.success(), "{said}\n{}", String::from_utf8_lossy(&run.stderr));
        said
    };
    let said = agent(&[&["probe"], &asked[..]].concat());
    let found: toml::Table = said.parse().unwrap();
    let mut found: Vec<_> = found["device"].as_array().unwrap().iter().map(driver_on).collect();
    let expected = wired.iter().filter(|device| !silent.contains(&device["name"].as_str().unwrap()));
    let mut expected: Vec<_> = expected.map(driver_on).collect();
    found.sort_unstable();
    expected.sort_unstable();
    assert_eq!(found, expected, "{said}");
    assert!(said.contains("nothing that a driver knows"), "{said}");
    // The Mongoose's is the third.
    assert!(said.contains("no room for barometer 3"), "{said}");
    AgentConfig::from_toml(&said).unwrap();
    let config = file.to_str().unwrap();
    for (name, shown) in [
        ("imu2", "Imu("),
        ("imu3", "Imu("),
        ("height1", "Range("),
        ("baro1", "Barometer("),
        ("baro2", "Barometer("),
        ("gnss", "Fix("),
        ("mocap", "Pose("),
        ("battery", "Battery("),
    ] {
        let said = agent(&["--config", config, "test", name, "--seconds", "2.5"]);
        assert!(said.contains(shown) && said.contains("opened 1 times"), "{name}: {said}");
    }
}
