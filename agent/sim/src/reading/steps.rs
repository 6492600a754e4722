//! The entries of `[[script]]`: a time, an action, and the values that go with it.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Deserialize;

use super::{Read, bad, within};
use crate::script::{Script, Shape, Step, Trajectory};
use plumbline_core::command::{Command, SetpointChange};
use plumbline_core::types::{EstimatorKind, Mode};

/// Which values go with an action, [`Given`] knows.
#[derive(Debug, Deserialize)]
pub(super) struct RawStep {
    pub at_s: f64,
    #[serde(rename = "do")]
    action: String,
    #[serde(flatten)]
    values: BTreeMap<String, toml::Value>,
}

/// The values of one `[[script]]` entry. Each is taken once by what knows it; what is left does not belong there.
struct Given {
    action: String,
    values: BTreeMap<String, toml::Value>,
}

impl Given {
    /// A number, if it is there.
    fn number(&mut self, key: &str) -> Read<Option<f64>> {
        let Some(value) = self.values.remove(key) else { return Ok(None) };
        let number = value.as_float().or_else(|| value.as_integer().map(|integer| integer as f64));
        let key = format!("script.{key}");
        number.map_or_else(|| bad(&key, &value, "a number"), |number| within(&key, number, -1000.0, 86_400.0)).map(Some)
    }

    /// A value that the action cannot do without.
    fn needed<T>(&self, key: &str, value: Option<T>) -> Read<T> {
        let absent = || bad(format!("script.{key}"), "absent", format!("optional for do = \"{}\"", self.action));
        value.map_or_else(absent, Ok)
    }

    /// A length, a duration or a speed that a shape cannot do without.
    fn size(&mut self, key: &str) -> Read<f64> {
        let number = self.number(key)?;
        within(&format!("script.{key}"), self.needed(key, number)?, 1e-3, 3600.0)
    }

    /// A name that the action cannot do without.
    fn word(&mut self, key: &str) -> Read<String> {
        match self.values.remove(key) {
            Some(toml::Value::String(word)) => Ok(word),
            Some(other) => bad(format!("script.{key}"), other, "a name"),
            None => self.needed(key, None),
        }
    }

    /// Where a shape begins, ENU, m: above the origin unless it says otherwise.
    fn place(&mut self) -> Read<Vector3<f64>> {
        let altitude_m = self.number("altitude_m")?;
        let (x_m, y_m) = (self.number("x_m")?, self.number("y_m")?);
        Ok(Vector3::new(x_m.unwrap_or(0.0), y_m.unwrap_or(0.0), self.needed("altitude_m", altitude_m)?))
    }

    /// The shape of that name, if it is one.
    fn shape(&mut self) -> Read<Option<Shape>> {
        Ok(Some(match self.action.as_str() {
            "circle" => Shape::Circle { radius_m: self.size("radius_m")?, period_s: self.size("period_s")? },
            "sine" => Shape::Sine {
                amplitude_m: self.size("amplitude_m")?,
                period_s: self.size("period_s")?,
                speed_mps: self.size("speed_mps")?,
            },
            "heave" => Shape::Heave { amplitude_m: self.size("amplitude_m")?, period_s: self.size("period_s")? },
            "square" => Shape::Square { side_m: self.size("side_m")?, period_s: self.size("period_s")? },
            _ => return Ok(None),
        }))
    }

    fn setpoint(&mut self) -> Read<SetpointChange> {
        let change = SetpointChange {
            altitude_m: self.number("altitude_m")?,
            x_m: self.number("x_m")?,
            y_m: self.number("y_m")?,
            roll_rad: self.number("roll_rad")?,
            pitch_rad: self.number("pitch_rad")?,
            yaw_rad: self.number("yaw_rad")?,
            throttle: self.number("throttle")?,
        };
        // What has no value is named as that, unless there is a value that is none of these.
        if change == SetpointChange::default() && self.values.is_empty() {
            return bad("script.do", "setpoint", "without any value");
        }
        Ok(change)
    }

    fn command(&mut self) -> Read<Command> {
        Ok(match self.action.as_str() {
            "arm" => Command::Arm,
            "disarm" => Command::Disarm,
            "cut" => Command::CutMotors,
            "release_cut" => Command::ReleaseCut,
            "abort_attacks" => Command::AbortAttacks,
            "mode" => Command::SetMode(mode(&self.word("mode")?)?),
            "estimator" => Command::SelectEstimator(estimator(&self.word("estimator")?)?),
            "setpoint" => Command::Setpoint(self.setpoint()?),
            other => {
                return bad(
                    "script.do",
                    other,
                    "one of arm, disarm, cut, release_cut, mode, setpoint, estimator, abort_attacks, circle, sine, \
                     heave, square",
                );
            }
        })
    }

    fn nothing_left(self) -> Read<()> {
        match self.values.into_iter().next() {
            Some((key, value)) => bad(format!("script.{key}"), value, format!("part of do = \"{}\"", self.action)),
            None => Ok(()),
        }
    }
}

/// Adds what one `[[script]]` entry says.
pub(super) fn read_step(raw: RawStep, script: &mut Script) -> Read<()> {
    let at_s = within("script.at_s", raw.at_s, 0.0, 86_400.0)?;
    let mut given = Given { action: raw.action, values: raw.values };
    match given.shape()? {
        Some(shape) => {
            let (duration_s, from_enu_m) = (given.size("duration_s")?, given.place()?);
            script.trajectories.push(Trajectory { start_s: at_s, duration_s, from_enu_m, shape });
        }
        None => script.steps.push(Step { at_s, command: given.command()? }),
    }
    given.nothing_left()
}

fn mode(name: &str) -> Read<Mode> {
    Ok(match name {
        "stabilise" => Mode::Stabilise,
        "altitude_hold" => Mode::AltitudeHold,
        "hold" => Mode::Hold,
        "land" => Mode::Land,
        other => return bad("script.mode", other, "one of stabilise, altitude_hold, hold, land"),
    })
}

fn estimator(name: &str) -> Read<EstimatorKind> {
    EstimatorKind::named(name).map_or_else(|| bad("script.estimator", name, EstimatorKind::NAMES), Ok)
}
