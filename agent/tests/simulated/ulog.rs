//! PX4's logs as our reader has them, beside a third party's.

use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Vector3;
use plumbline_agent::recordings::{open, shared, skipped};
use plumbline_proto::v1::SensorKind;
use serde_json::Value;

/// What pyulog finds in these files: see `tests/browser/ulog.py`.
fn by_pyulog(paths: &[PathBuf]) -> Option<Value> {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    if !Command::new(&python).args(["-c", "import pyulog"]).output().is_ok_and(|ran| ran.status.success()) {
        skipped("no Python with pyulog");
        return None;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/browser/ulog.py");
    let ran = Command::new(&python).arg(script).args(paths).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    Some(serde_json::from_slice(&ran.stdout).unwrap())
}

/// GIVEN ULog files of several years WHEN pyulog reads them, too THEN each finds as many samples, of the same sums.
#[test]
fn ulog_holds_what_pyulog_finds_in_it() {
    let files = ["sample.ulg", "sample_logging_tagged_and_default_params.ulg", "test_ulog.ulg"];
    let paths: Option<Vec<_>> = files.iter().map(|file| shared(&format!("data/px4_ulog/{file}"))).collect();
    let Some(paths) = paths else { return };
    let Some(told) = by_pyulog(&paths) else { return };
    println!("pyulog {}", told["version"]);
    for (path, by_others) in paths.iter().zip(told["files"].as_array().unwrap()) {
        let mut recording = open(path).unwrap();
        let sensed: Vec<_> = std::iter::from_fn(|| recording.next_tick()).map(|tick| tick.sensed).collect();
        let imus: Vec<_> = sensed.iter().filter_map(|frame| frame.imus[0]).collect();
        let mags: Vec<_> = imus.iter().filter_map(|imu| imu.mag_ut).collect();
        let baros: Vec<_> = sensed.iter().filter_map(|frame| frame.barometers[0]).collect();
        let fixes: Vec<_> = sensed.iter().filter_map(|frame| frame.gnss).collect();
        let (info, theirs) = (recording.info(), |name: &str| by_others[name].as_u64().unwrap_or(0));
        let duration_s = info.span.1.seconds_since(info.span.0);
        let read = |kind| {
            let sensor = info.sensors.iter().find(|sensor| sensor.id.kind == kind);
            sensor.map_or(0, |sensor| (sensor.rate_hz * duration_s).round() as u64)
        };
        for (name, count) in [
            ("imu", imus.len() as u64),
            ("mag", mags.len() as u64),
            ("baro", read(SensorKind::Barometer)),
            ("gnss", read(SensorKind::Gnss)),
        ] {
            assert_eq!(count, theirs(name), "{name} of {}", path.display());
        }
        let sums: [(&str, Vector3<f64>); 4] = [
            ("gyro_radps", imus.iter().map(|imu| imu.gyro_radps).sum()),
            ("accel_mps2", imus.iter().map(|imu| imu.accel_mps2).sum()),
            ("mag_ut", mags.iter().sum()),
            ("gnss_enu_mps", fixes.iter().map(|fix| fix.velocity_enu_mps).sum()),
        ];
        let mut compared = 0;
        let mut compare = |name: &str, ours: f64, theirs: Option<f64>| {
            let Some(theirs) = theirs else { return };
            let close = (ours - theirs).abs() <= 1e-9 * theirs.abs().max(1.0);
            assert!(close, "{name} of {}: {ours}, {theirs}", path.display());
            compared += 1;
        };
        for (name, sum) in sums {
            sum.iter().enumerate().for_each(|(axis, ours)| compare(name, *ours, by_others[name][axis].as_f64()));
        }
        // Of two samples between two ticks the later is kept: there the sums are of other samples.
        if baros.len() as u64 == theirs("baro") {
            compare("baro_pa", baros.iter().map(|baro| baro.pressure_pa).sum(), by_others["baro_pa"].as_f64());
        }
        assert!(compared >= 9, "{compared} sums of {}", path.display());
    }
}
