//! Identities that must not be mixed up.
use std::fmt::{self, Write as _};

use crate::{DecodeError, v1::SensorKind};

/// One sensor: a kind and an instance counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SensorId {
    /// Kind of sensor.
    pub kind: SensorKind,
    /// Instance, from 1.
    pub instance: u8,
}

impl SensorId {
    /// Sensor `instance` (from 1) of `kind`.
    pub const fn new(kind: SensorKind, instance: u8) -> Self {
        Self { kind, instance }
    }
}

impl fmt::Display for SensorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.kind {
            SensorKind::Unspecified => "SENSOR",
            kind => kind.as_str_name().trim_start_matches("SENSOR_KIND_"),
        };
        for c in name.chars() {
            f.write_char(if c == '_' { ' ' } else { c.to_ascii_lowercase() })?;
        }
        write!(f, " {}", self.instance)
    }
}

/// What is no sensor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is not a sensor, as \"imu 4\" is")]
pub struct NoSensor(pub String);

impl std::str::FromStr for SensorId {
    type Err = NoSensor;

    /// Reads what [`SensorId`] displays.
    fn from_str(name: &str) -> Result<Self, NoSensor> {
        let kinds = (1..).map_while(|kind| SensorKind::try_from(kind).ok());
        kinds
            .flat_map(|kind| (1..=u8::MAX).map(move |instance| Self::new(kind, instance)))
            .find(|sensor| sensor.to_string() == name)
            .ok_or_else(|| NoSensor(name.to_owned()))
    }
}

/// Numbers commands of one ground, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CommandId(pub u64);

/// Revision of the gains in use; 0 is the set the agent started with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct GainsRevision(pub u32);

/// Names one recorded flight: letters, digits, `-` and `_` only, so that it is safe as a file name.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FlightId(String);

impl FlightId {
    /// Longest id accepted.
    pub const MAX_LEN: usize = 64;

    /// Checks `text`.
    ///
    /// # Errors
    /// [`DecodeError::Malformed`] when it is empty, too long, or holds another character.
    pub fn new(text: impl Into<String>) -> Result<Self, DecodeError> {
        let text = text.into();
        let ok = !text.is_empty()
            && text.len() <= Self::MAX_LEN
            && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_');
        if ok {
            Ok(Self(text))
        } else {
            Err(DecodeError::Malformed {
                message: "flight id",
                reason: format!("{text:?} is not 1 to 64 letters, digits, '-' or '_'"),
            })
        }
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for FlightId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_ids_cannot_leave_their_folder() {
        assert!(FlightId::new("20261121T120000-iris-1-0001").is_ok());
        for bad in ["", "..", "a/b", "a\\b", "a b", "é", &"x".repeat(65)] {
            assert!(FlightId::new(bad).is_err(), "{bad:?}");
        }
    }
}
