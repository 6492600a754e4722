//! What is attached to the vehicle that is really there: checked with the offending line.

use plumbline_devices::spec::{self, SpecError};

use super::{AgentConfig, ConfigError};

/// Checks devices and motors of a configuration that was read from `text`.
pub(super) fn check(config: &AgentConfig, text: &str) -> Result<(), ConfigError> {
    spec::check(&config.device).map_err(|error| shown(error, text))?;
    config.motors.as_ref().map_or(Ok(()), |motors| motors.check().map_err(|error| shown(error, text)))
}

/// `source` with the line that it is about: that of its key in its table, or the table's head where the key is left out.
fn shown(source: SpecError, text: &str) -> ConfigError {
    let (head, nth) = source.device.map_or(("[motors]", 0), |index| ("[[device]]", index));
    let of_head = |(_, line): &(usize, &str)| line.trim_start().starts_with(head);
    let lines = || (1..).zip(text.lines());
    let begin = lines().filter(of_head).nth(nth).unwrap_or((0, ""));
    let own = lines().skip(begin.0).take_while(|(_, line)| !line.trim_start().starts_with('['));
    let is_key = |line: &str| line.split_once('=').is_some_and(|(key, _)| key.trim() == source.key);
    let (line, shown) = own.into_iter().find(|(_, line)| is_key(line)).unwrap_or(begin);
    let table = source.device.map_or("[motors]".to_owned(), |index| format!("[[device]] {}", index + 1));
    ConfigError::Hardware { table, source: Box::new(source), line, text: shown.trim().to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "\
[[device]]
name = \"imu\"
driver = \"bno055\"
port = \"/dev/ttyUSB0\"
sensors = [\"imu 1\"]

[[device]]
name = \"laser\"
driver = \"hokuyo\"
port = \"/dev/ttyACM0\"
sensors = [\"height 1\"]
position_flu_m = [0.08, 0.0, -0.05]

[motors]
driver = \"pca9685\"
port = \"/dev/i2c-1\"
";

    #[test]
    fn devices_are_read_and_make_a_suite() {
        let config = AgentConfig::from_toml(GOOD).unwrap();
        let suite = spec::suite(&config.device).unwrap();
        assert_eq!((suite.imus.len(), suite.heights.len(), suite.barometers.len()), (1, 1, 0));
        assert_eq!(suite.heights[0].position_flu_m.x, 0.08);
        assert_eq!(suite.heights[0].timing.rate_hz, 10.0);
        let recorded = GOOD.replace("\"hokuyo\"\n", "\"hokuyo\"\nrecord_scans = true\n");
        assert!(AgentConfig::from_toml(&recorded).unwrap().device[1].record_scans);
        let on_spi = GOOD.replace("\"bno055\"\nport = \"/dev/ttyUSB0\"", "\"invensense\"\nport = \"/dev/spidev0.0\"");
        assert_eq!(AgentConfig::from_toml(&on_spi).unwrap().device[0].port, "/dev/spidev0.0");
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        let cases = [
            (
                "/dev/ttyACM0",
                "COM3",
                "[[device]] 2: port = \"COM3\" is not a port that this driver can use; line 10: port",
            ),
            (
                "\"/dev/ttyACM0\"",
                "\"/dev/ttyUSB0\"",
                "is not a port, or an address on it, that no other device has; line 10",
            ),
            ("/dev/ttyACM0", "/dev/ttyUSB0", "line 10: port = \"/dev/ttyUSB0\""),
            (
                "height 1",
                "height 2",
                "sensors = \"height 2\" is not the next instance of its kind, counted from 1; line 11",
            ),
            ("height 1", "imu 2", "\"imu 2\" is not a sensor that this driver gives"),
            ("-0.05]", "-5.0]", "position_flu_m = -5 is not within 1 m of the centre of mass; line 12: position_flu_m"),
            (
                "\"hokuyo\"\n",
                "\"hokuyo\"\nbaud = 19200\n",
                "[[device]] 2: baud = 19200 is not 115200, the only one of this device; line 10: baud = 19200",
            ),
            ("\"bno055\"\n", "\"bno055\"\nbaud = 9600\n", "baud = 9600 is not 115200, the only one"),
            (
                "\"bno055\"\nport = \"/dev/ttyUSB0\"",
                "\"bno055\"\nbaud = 9600\nport = \"/dev/i2c-1\"",
                "baud = 9600 is not for this port: only a serial one has a baud rate; line 4",
            ),
            ("\"hokuyo\"\n", "\"tfmini\"\nbaud = 50\n", "baud = 50 is not 1200 to 4000000; line 10"),
            (
                "port = \"/dev/ttyACM0\"\nsensors = [\"height 1\"]",
                "port = \"/dev/ttyACM0\"\nsensors = [\"height 1\"]\nmounting_rpy_rad = [0.0, 0.0, 90.0]",
                "mounting_rpy_rad = 90 is not angles within ±2π rad; line 12: mounting_rpy_rad",
            ),
            (
                "\"hokuyo\"\nport = \"/dev/ttyACM0\"\nsensors = [\"height 1\"]",
                "\"bno055\"\nport = \"/dev/ttyACM0\"\nsensors = [\"imu 1\"]",
                "[[device]] 2: sensors = \"imu 1\" is not a sensor that no other device is; line 11: sensors",
            ),
            (
                "/dev/ttyACM0",
                "/dev/spidev0.0",
                "port = \"/dev/spidev0.0\" is not a port that this driver can use; line 10",
            ),
            (
                "\"bno055\"\n",
                "\"bno055\"\nrecord_scans = true\n",
                "[[device]] 1: record_scans = true is not for this device: only a hokuyo that is a height has scans; line 4",
            ),
            (
                "sensors = [\"height 1\"]",
                "",
                "[[device]] 2: sensors = [] is not the sensors that it is, as \"imu 1\"; line 7",
            ),
            ("\"laser\"", "\"imu\"", "name = \"imu\" is not a name of its own; line 8"),
            ("pca9685", "dshot", "[motors]: driver = \"dshot\""),
            ("\"hokuyo\"", "\"sick\"", "unknown variant `sick`"),
        ];
        for (from, to, expected) in cases {
            let error = AgentConfig::from_toml(&GOOD.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let error = AgentConfig::from_toml(&format!("{GOOD}pulse_us = [1000, 2600]\n")).unwrap_err().to_string();
        assert!(error.contains("line 17: pulse_us = [1000, 2600]"), "{error}");
    }
}
