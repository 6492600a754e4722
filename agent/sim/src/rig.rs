//! What holds the vehicle: nothing, a pivot, strings, a tether, a stand; and the floor under it.
//!
//! | rig | source | what acts |
//! |---|---|---|
//! | free | [Umasankar], [Clinic] untethered | the floor |
//! | single axis | [Paternain] VIII-A | a pivot that leaves one rotation, gravity at the offset centre of mass |
//! | hanging strings | [Paternain] VIII-B, and altitude steps | one or four strings from above, and the floor |
//! | tethered | [Clinic] 6.2 | a string to the floor, and the floor |
//! | on stand | – | a platform under the feet, and the floor |
//!
//! How it pulls and pushes is in `rig/mounted.rs`.

mod mounted;

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use serde::Deserialize;

use plumbline_core::flight::RigKind;
use plumbline_core::model::airframe::Airframe;

pub use mounted::{Line, Load, Mounted, Pivot, standing_height_m};

/// Most strings of a rig.
pub const MAX_STRINGS: usize = 4;

/// An axis of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// About body x.
    Roll,
    /// About body y.
    Pitch,
    /// About body z.
    Yaw,
}

impl Axis {
    /// Unit vector, FLU.
    pub fn unit(self) -> Vector3<f64> {
        match self {
            Self::Roll => Vector3::x(),
            Self::Pitch => Vector3::y(),
            Self::Yaw => Vector3::z(),
        }
    }
}

/// What a hanging-string test is for; the agent limits thrust or altitude accordingly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StringMode {
    /// Thrust stays below lift-off: only the attitude is controlled ([Paternain] VIII-B).
    Orientation,
    /// The vehicle lifts off its strings; they catch it.
    #[default]
    Flight,
}

/// Nothing holds the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Free {
    /// Height of the centre of mass at the start, m; 0 stands it on its feet.
    pub height_m: f64,
}

/// One rotation is left.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SingleAxis {
    /// The free axis.
    pub axis: Axis,
    /// Height of the pivot, m.
    #[serde(default = "one")]
    pub height_m: f64,
    /// Friction of the pivot, N m s.
    #[serde(default = "pivot_friction")]
    pub friction_nms: f64,
    /// How far the centre of mass lies below the pivot, m; the airframe's offset when absent.
    #[serde(default)]
    pub cg_below_pivot_m: Option<f64>,
}

fn one() -> f64 {
    1.0
}

fn pivot_friction() -> f64 {
    0.01
}

/// Hanging from the ceiling.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HangingStrings {
    /// What the test is for.
    pub mode: StringMode,
    /// One string to the top of the frame, or four.
    pub strings: usize,
    /// Height of the centre of mass when it hangs still with the motors off, m.
    pub height_m: f64,
    /// Height of the hooks, m.
    pub ceiling_m: f64,
    /// Four strings: hooks at (± this, ± this), m.
    pub hook_spread_m: f64,
    /// Four strings: knots at (± this, ± this) on the body, m.
    pub knot_spread_m: f64,
    /// Knots above the centre of mass, m.
    pub knot_above_m: f64,
    /// Stretch of the strings under the weight, m: sets their stiffness.
    pub stretch_m: f64,
    /// Damping ratio of the bounce on taut strings.
    pub damping_ratio: f64,
    /// Friction of the knots while they carry the weight, N m s; in proportion to the pull.
    pub knot_friction_nms: f64,
}

impl Default for HangingStrings {
    /// Hooks in the corners of a 3 m cage, knots gathered on a ring near the centre: a drifting vehicle (its
    /// horizontal position is not measured) is turned back gently and hardly tilted. With knots on the arms the
    /// same strings tilt it by 0.2 rad and disturb its altitude by 10 cm. Their friction (chosen: μ T r of strings of 2 mm
    /// is 4 mN m, which a rocking of 0.3 rad/s feels as much of) stills in some seconds what a drop onto the strings leaves.
    fn default() -> Self {
        Self {
            mode: StringMode::Flight,
            strings: 4,
            height_m: 0.3,
            ceiling_m: 2.8,
            hook_spread_m: 1.5,
            knot_spread_m: 0.03,
            knot_above_m: 0.04,
            stretch_m: 0.01,
            damping_ratio: 0.2,
            knot_friction_nms: 0.013,
        }
    }
}

/// Tied to the floor.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tethered {
    /// Length of the tether from floor to knot, m.
    pub length_m: f64,
    /// Knot below the centre of mass, m.
    pub knot_below_m: f64,
    /// Stretch under a pull as large as the weight, m.
    pub stretch_m: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
}

impl Default for Tethered {
    fn default() -> Self {
        Self { length_m: 1.5, knot_below_m: 0.05, stretch_m: 0.03, damping_ratio: 0.3 }
    }
}

/// On a platform it may take off from and land on.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OnStand {
    /// Height of the platform, m.
    pub height_m: f64,
    /// Radius of the platform about the origin, m. Lasers look past it, at the floor.
    pub radius_m: f64,
}

impl Default for OnStand {
    fn default() -> Self {
        Self { height_m: 0.5, radius_m: 0.4 }
    }
}

/// A rig as a scenario writes it: `[rig.hanging_strings]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Rig {
    /// Nothing holds it.
    Free(Free),
    /// A pivot.
    SingleAxis(SingleAxis),
    /// Strings from above.
    HangingStrings(HangingStrings),
    /// A tether to the floor.
    Tethered(Tethered),
    /// A platform.
    OnStand(OnStand),
}

/// A value of a rig that makes no sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("rig.{key} = {value} is not {expected}")]
pub struct RigError {
    /// The key.
    pub key: &'static str,
    /// The offending value.
    pub value: f64,
    /// What it should be.
    pub expected: &'static str,
}

impl Rig {
    /// Its name, as in scenarios and telemetry.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Free(_) => "free",
            Self::SingleAxis(_) => "single_axis",
            Self::HangingStrings(_) => "hanging_strings",
            Self::Tethered(_) => "tethered",
            Self::OnStand(_) => "on_stand",
        }
    }

    /// Altitudes (m) the vehicle can reach: the floor or its hanging height, and what the strings or the
    /// tether allow; `None` above where nothing does. With strings the ceiling is kept 0.5 m away.
    pub fn altitude_reach_m(&self, airframe: &Airframe) -> (f64, Option<f64>) {
        match self {
            Self::Free(_) | Self::OnStand(_) => (standing_height_m(airframe), None),
            Self::SingleAxis(r) => (r.height_m, Some(r.height_m)),
            Self::HangingStrings(r) => (r.height_m, Some(r.ceiling_m - 0.5)),
            Self::Tethered(r) => (standing_height_m(airframe), Some(r.length_m + r.knot_below_m)),
        }
    }

    /// What a flight has to know of it.
    pub fn kind(&self, airframe: &Airframe) -> RigKind {
        let reach_m = self.altitude_reach_m(airframe).1.unwrap_or(f64::INFINITY);
        match self {
            Self::Free(_) => RigKind::Free,
            Self::SingleAxis(_) => RigKind::SingleAxis,
            Self::HangingStrings(r) if r.mode == StringMode::Orientation => RigKind::StringsOrientation,
            Self::HangingStrings(_) => RigKind::StringsFlight { reach_m },
            Self::Tethered(_) => RigKind::Tethered { reach_m },
            Self::OnStand(_) => RigKind::OnStand,
        }
    }

    /// Its strings, tether included, made for `airframe`.
    pub fn lines(&self, airframe: &Airframe) -> ArrayVec<Line, MAX_STRINGS> {
        Mounted::new(self, airframe).lines
    }

    /// Checks every value; the first bad one is named.
    ///
    /// # Errors
    /// [`RigError`].
    pub fn validate(&self, airframe: &Airframe) -> Result<(), RigError> {
        let within = |key, value: f64, min: f64, max: f64, expected| {
            // A NaN fails both comparisons.
            if value >= min && value <= max { Ok(()) } else { Err(RigError { key, value, expected }) }
        };
        match self {
            Self::Free(r) => within("free.height_m", r.height_m, 0.0, 1000.0, "0 to 1000 m"),
            Self::SingleAxis(r) => {
                within("single_axis.height_m", r.height_m, 0.3, 100.0, "0.3 to 100 m")?;
                within("single_axis.friction_nms", r.friction_nms, 0.0, 10.0, "0 to 10 N m s")?;
                let d = r.cg_below_pivot_m.unwrap_or(0.0);
                within("single_axis.cg_below_pivot_m", d, -0.5, 0.5, "within half a metre of the pivot")
            }
            Self::HangingStrings(r) => {
                if r.strings != 1 && r.strings != 4 {
                    let (key, value) = ("hanging_strings.strings", r.strings as f64);
                    return Err(RigError { key, value, expected: "1 or 4" });
                }
                let stand = standing_height_m(airframe);
                within("hanging_strings.height_m", r.height_m, stand, 100.0, "clear of the floor")?;
                let low = r.height_m + r.knot_above_m + 0.2;
                within("hanging_strings.ceiling_m", r.ceiling_m, low, 100.0, "0.2 m or more above the knots")?;
                within("hanging_strings.hook_spread_m", r.hook_spread_m, 0.0, 20.0, "0 to 20 m")?;
                within("hanging_strings.knot_spread_m", r.knot_spread_m, 0.0, 2.0, "0 to 2 m")?;
                within("hanging_strings.knot_above_m", r.knot_above_m, 0.0, 1.0, "0 to 1 m")?;
                within("hanging_strings.stretch_m", r.stretch_m, 0.002, 0.5, "0.002 to 0.5 m")?;
                within("hanging_strings.damping_ratio", r.damping_ratio, 0.0, 2.0, "0 to 2")?;
                within("hanging_strings.knot_friction_nms", r.knot_friction_nms, 0.0, 1.0, "0 to 1 N m s")
            }
            Self::Tethered(r) => {
                within("tethered.length_m", r.length_m, 0.2, 100.0, "0.2 to 100 m")?;
                within("tethered.knot_below_m", r.knot_below_m, 0.0, 1.0, "0 to 1 m")?;
                within("tethered.stretch_m", r.stretch_m, 0.002, 0.5, "0.002 to 0.5 m")?;
                within("tethered.damping_ratio", r.damping_ratio, 0.0, 2.0, "0 to 2")
            }
            Self::OnStand(r) => {
                within("on_stand.height_m", r.height_m, 0.0, 10.0, "0 to 10 m")?;
                within("on_stand.radius_m", r.radius_m, 0.0, 10.0, "0 to 10 m")
            }
        }
    }
}
