//! MAVLink stations of others fly the vehicle: they arm it, step its altitude and land it, through the ground.

use std::net::UdpSocket;

use plumbline_support::files;
use plumbline_support::system::{Rig, scenario};

/// GIVEN ground and vehicle WHEN a station flies it THEN it holds the altitude asked for, lands and is recorded.
fn flies(station: &str, module: &str) {
    let Some(python) = files::python_with(module) else { return };
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let rig = Rig::configured(&scenario("altitude_step"), &format!("mavlink = \"127.0.0.1:{port}\"\n"));
    let found = files::station_by(&python, &format!("{station}-flies"), port).unwrap_or_else(|error| panic!("{error}"));
    println!("{station} {}: {found}", found["version"]);
    let number = |key: &str| found[key].as_f64().unwrap();
    assert!((number("held_m") - 0.8).abs() < 0.05 && number("landed_m") < 0.6, "{found}");
    // The flight is recorded as any other, and the audit log names who asked.
    let flight = rig.finished_flight();
    let steps = flight["steps"].as_array().unwrap();
    assert!(steps.iter().any(|step| (step["to_m"].as_f64().unwrap() - 0.8).abs() < 1e-6), "{flight}");
    let deeds = rig.api().get_json("/api/v1/audit?search=mavlink&limit=1000").unwrap();
    let asked = deeds["deeds"].as_array().unwrap().len();
    assert!(asked >= 4, "arm, mode, setpoint, land: {deeds}");
    rig.stop();
}

#[test]
fn mavsdk_flies_the_vehicle() {
    flies("mavsdk", "mavsdk.plugins.mavlink_direct");
}

#[test]
fn pymavlink_flies_the_vehicle() {
    flies("pymavlink", "pymavlink.mavutil");
}
