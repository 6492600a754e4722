//! The tables of the configuration file, and what each alone means.

use std::collections::BTreeMap;
use std::path::PathBuf;

use plumbline_proto::ids::SensorId;
use serde::Deserialize;

use super::ConfigError;
use crate::control::policy::MarginPolicy;
use crate::model::declination::{DeclinationError, day, declination_rad};
use crate::model::geodesy::Geodetic;
use crate::{link, log};

/// Limits of setpoints; what is left out keeps its default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Lowest altitude setpoint, m.
    pub altitude_min_m: Option<f64>,
    /// Highest altitude setpoint, m.
    pub altitude_max_m: Option<f64>,
    /// Largest |x| and |y|, m.
    pub lateral_max_m: Option<f64>,
    /// Fastest climb, m/s.
    pub climb_max_mps: Option<f64>,
    /// Fastest descent, m/s.
    pub descent_max_mps: Option<f64>,
    /// Largest roll and pitch setpoint, rad.
    pub tilt_max_rad: Option<f64>,
    /// Highest collective throttle in stabilise mode, fraction of the weight.
    pub throttle_max: Option<f64>,
}

/// May sensors be attacked, and how far?
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Attacks {
    /// Off unless set; on in the simulator and in replays, where nothing can fall.
    pub enabled: Option<bool>,
    /// Longest duration, s.
    pub duration_max_s: Option<f64>,
    /// Largest offset of a length, m.
    pub length_max_m: Option<f64>,
    /// Largest offset of an angular rate, rad/s.
    pub rate_max_radps: Option<f64>,
    /// Largest offset of a specific force, m/s².
    pub accel_max_mps2: Option<f64>,
    /// Largest offset of a rotor's thrust, as a part of its full one.
    pub thrust_max: Option<f64>,
}

/// What the failsafes rely on.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Failsafe {
    /// Sensors on a wire of their own, as "height 3": the watchdog reads only these of their kind, and they cannot be attacked.
    pub independent: Vec<String>,
}

/// A bound of the attack envelope without which it does not arm.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Envelope {
    /// Nobody who is not seen may move the altitude further, m …
    pub altitude_max_m: f64,
    /// … who owns so many sensors, 1 to 3 …
    #[serde(default = "one")]
    pub sensors: usize,
    /// … while the lanes measure this noise of their accelerometers, m/s²; none, where nothing is said, is the least bound of an IMU.
    #[serde(default)]
    pub noise_mps2: f64,
    /// … and take all of them to be off by this alike as they are shaken, m/s²; none is the least bound of a height.
    #[serde(default)]
    pub rectified_mps2: f64,
}

fn one() -> usize {
    1
}

/// Noise on the thrust that tells what is replayed.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Watermark {
    /// Its rms, m/s².
    pub rms_mps2: f64,
    /// The same seed, the same watermark.
    #[serde(default)]
    pub seed: u64,
}

/// Which estimators run.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Estimators {
    /// Side by side, by name.
    pub run: Option<Vec<String>>,
    /// The one in the loop.
    pub in_loop: Option<String>,
    /// The program that the secure estimator solves: l2, l1, l2_split or l1_split.
    pub decoder: Option<String>,
    /// Slots of 40 ms in its window, 5 to 50.
    pub window: Option<usize>,
}

/// Diagonals of the LQR weights.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// x y z vx vy vz roll pitch yaw p q r, integrals of x y z yaw.
    pub state: [f64; 16],
    /// Thrust, torque x y z.
    pub input: [f64; 4],
}

/// A place and a day: the World Magnetic Model gives the declination there.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// Latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Altitude, m.
    #[serde(default)]
    pub altitude_m: f64,
    /// Day, as 2026-11-21; the declination changes by about a tenth of a degree a year.
    pub date: String,
}

impl Site {
    pub(super) fn declination_rad(&self) -> Result<f64, DeclinationError> {
        let place = Geodetic::from_degrees(self.latitude_deg, self.longitude_deg, self.altitude_m);
        declination_rad(&place, day(&self.date)?)
    }
}

/// The controller to start with.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// `lqr_integral`, `lqr`, `lqg`, `hinf` or `pid`.
    pub kind: Option<String>,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, f64>,
}

/// A named margin policy, and what of it is changed.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Margins {
    /// `standard`, `careful` or `experimental`.
    pub policy: Option<String>,
    /// Least factor by which the gain of each loop may rise.
    pub gain_up_min: Option<f64>,
    /// Largest factor to which it may have to fall.
    pub gain_down_max: Option<f64>,
    /// Least phase margin, rad.
    pub phase_min_rad: Option<f64>,
    /// Least delay margin, s.
    pub delay_min_s: Option<f64>,
    /// Largest sensitivity.
    pub sensitivity_max: Option<f64>,
    /// The slowest pole, 1/s (negative).
    pub slowest_pole_per_s: Option<f64>,
    /// Largest change of a row of K while armed, of the one in use.
    pub change_max: Option<f64>,
    /// Largest share of the motors' room that a unit step may ask for.
    pub unit_step_max: Option<f64>,
}

impl Margins {
    pub(super) fn policy(&self) -> Result<MarginPolicy, ConfigError> {
        let name = self.policy.as_deref().unwrap_or(MarginPolicy::STANDARD.name);
        let mut policy = MarginPolicy::by_name(name).ok_or_else(|| ConfigError::Value {
            key: "margins.policy".to_owned(),
            value: format!("{name:?}"),
            expected: "standard, careful or experimental",
        })?;
        let named = policy;
        for (into, value) in [
            (&mut policy.gain_up_min, self.gain_up_min),
            (&mut policy.gain_down_max, self.gain_down_max),
            (&mut policy.phase_min_rad, self.phase_min_rad),
            (&mut policy.delay_min_s, self.delay_min_s),
            (&mut policy.sensitivity_max, self.sensitivity_max),
            (&mut policy.slowest_pole_per_s, self.slowest_pole_per_s),
            (&mut policy.change_max, self.change_max),
            (&mut policy.unit_step_max, self.unit_step_max),
        ] {
            if let Some(value) = value {
                *into = value;
            }
        }
        if policy != named {
            policy.name = "custom";
        }
        Ok(policy)
    }
}

/// The onboard log.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Log {
    /// Its folder.
    pub folder: PathBuf,
    /// The folder stays below this, MiB.
    pub max_mib: u64,
}

/// The radio.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Link {
    /// Telemetry cap, kB/s.
    pub telemetry_kb_per_s: f64,
    /// Backfill, kB/s.
    pub backfill_kb_per_s: f64,
}

impl Default for Log {
    fn default() -> Self {
        Self { folder: PathBuf::from("data/agent/log"), max_mib: log::DEFAULT_MAX_BYTES >> 20 }
    }
}

impl Default for Link {
    fn default() -> Self {
        Self {
            telemetry_kb_per_s: link::TELEMETRY_BYTES_PER_S * 1e-3,
            backfill_kb_per_s: link::BACKFILL_BYTES_PER_S * 1e-3,
        }
    }
}

impl Failsafe {
    /// The independent ones of these `sensors`.
    pub(super) fn independent(&self, sensors: &[SensorId]) -> Result<Vec<SensorId>, ConfigError> {
        let read = |name: &String| {
            let sensor = name.parse::<SensorId>().ok().filter(|sensor| sensors.contains(sensor));
            sensor.ok_or_else(|| ConfigError::Value {
                key: "failsafe.independent".to_owned(),
                value: format!("{name:?}"),
                expected: "a sensor of this vehicle, as \"height 3\"",
            })
        };
        self.independent.iter().map(read).collect()
    }
}
