//! The kernel's PWM as files: what is written into which, and what is told where one is missing.

use std::path::Path;

use plumbline_devices::motors::Pulses as _;
use plumbline_devices::motors::Sysfs;

/// A chip with these channels exported, each as another program left it.
fn chip(folder: &Path, channels: [u8; 4]) -> Sysfs {
    for channel in channels {
        let pwm = folder.join(format!("pwm{channel}"));
        std::fs::create_dir(&pwm).unwrap();
        for (file, left) in [("period", "20000000"), ("duty_cycle", "1900000"), ("enable", "1")] {
            std::fs::write(pwm.join(file), left).unwrap();
        }
    }
    Sysfs { chip: folder.to_owned(), channels, rate_hz: 400.0 }
}

#[test]
fn period_pulse_and_enable_of_each_channel_are_set_in_nanoseconds() {
    let folder = tempfile::tempdir().unwrap();
    let channels = [2, 0, 3, 5];
    let mut pulses = chip(folder.path(), channels);
    let read = |channel: u8, file: &str| {
        std::fs::read_to_string(folder.path().join(format!("pwm{channel}/{file}"))).unwrap().trim().to_owned()
    };
    pulses.open().unwrap();
    for channel in channels {
        let all = ["period", "duty_cycle", "enable"].map(|file| read(channel, file));
        assert_eq!(all, ["2500000", "0", "1"], "channel {channel}: what another program left turns nothing");
    }
    pulses.set(&[1000.0, 1234.5, 1999.9, 2000.0]).unwrap();
    assert_eq!(channels.map(|channel| read(channel, "duty_cycle")), ["1000000", "1234500", "1999900", "2000000"]);
    // Shorter than what was there before: nothing of that is left behind it.
    pulses.set(&[950.0; 4]).unwrap();
    assert_eq!(channels.map(|channel| read(channel, "duty_cycle")), ["950000"; 4]);
}

#[test]
fn a_channel_that_is_not_there_is_told_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut pulses = chip(folder.path(), [0, 1, 2, 3]);
    std::fs::remove_dir_all(folder.path().join("pwm2")).unwrap();
    let error = pulses.set(&[1000.0; 4]).unwrap_err().to_string();
    assert!(error.contains("pwm2/duty_cycle: No such file"), "{error}");
    // `export` takes the channel, and no folder follows.
    std::fs::write(folder.path().join("export"), "").unwrap();
    let error = pulses.open().unwrap_err().to_string();
    assert!(error.contains("pwm2/period: No such file"), "{error}");
    assert_eq!(std::fs::read_to_string(folder.path().join("export")).unwrap(), "2\n");
}

#[test]
fn what_nobody_reads_is_an_error_and_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut pulses = chip(folder.path(), [0, 1, 2, 3]);
    let pipe = folder.path().join("pwm1/duty_cycle");
    std::fs::remove_file(&pipe).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let error = pulses.set(&[1000.0; 4]).unwrap_err().to_string();
    assert!(error.contains("pwm1/duty_cycle: No such device or address"), "{error}");
}
