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
//! A string is a one-sided spring: with stretch e > 0 and stretching speed ė its tension is
//! k e (1 + β ė), never negative (Hunt–Crossley: continuous where it goes slack); slack it does nothing.
//! A contact point is the same with penetration δ, plus Coulomb friction smoothed near zero speed.
//! Assumes massless strings, knots that do not slip, a level floor.

use arrayvec::ArrayVec;
use nalgebra::{Vector2, Vector3};
use serde::Deserialize;

use plumbline_core::flight::RigKind;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::rigid_body::{State, rotate};
use plumbline_core::types::GRAVITY_MPS2;

/// Most strings of a rig.
pub const MAX_STRINGS: usize = 4;
/// A spring stiffens by its damping to at most this many times its force at rest: keeps a hard impact
/// inside what the fixed step integrates.
const DAMPING_FACTOR_MAX: f64 = 8.0;
/// Sink of the feet under the vehicle's weight, m.
const GROUND_SINK_M: f64 = 0.001;
/// Damping ratio of a landing.
const GROUND_DAMPING_RATIO: f64 = 0.7;
/// Coulomb friction between feet and floor.
const FRICTION: f64 = 0.6;
/// Friction is proportional to the speed below this, m/s.
const FRICTION_SPEED_MPS: f64 = 0.02;

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
}

impl Default for HangingStrings {
    /// Hooks in the corners of a 3 m cage, knots gathered on a ring near the centre: a drifting vehicle (its
    /// horizontal position is not measured) is turned back gently and hardly tilted. With knots on the arms the
    /// same strings tilt it by 0.2 rad and disturb its altitude by 10 cm.
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
                within("hanging_strings.damping_ratio", r.damping_ratio, 0.0, 2.0, "0 to 2")
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

/// Height of the centre of mass when the vehicle stands on its feet, m.
pub fn standing_height_m(airframe: &Airframe) -> f64 {
    let lowest = airframe.feet_flu_m.iter().map(|f| f.z).fold(f64::INFINITY, f64::min);
    -lowest - GROUND_SINK_M
}

/// A one-sided elastic string between a point of the world and a point of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Hook, ENU, m.
    pub hook_enu_m: Vector3<f64>,
    /// Knot, FLU from the centre of mass, m.
    pub knot_flu_m: Vector3<f64>,
    /// Length at which it becomes taut, m.
    pub rest_length_m: f64,
    /// N/m.
    pub stiffness_npm: f64,
    /// β of the module's header, s/m.
    pub damping_spm: f64,
}

/// The pivot of a single-axis rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pivot {
    /// Free axis, FLU.
    pub axis: Vector3<f64>,
    /// The pivot, ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Centre of mass from the pivot, FLU, m.
    pub cg_flu_m: Vector3<f64>,
    /// N m s.
    pub friction_nms: f64,
}

/// Forces of a rig on the body.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Load {
    /// ENU, N.
    pub force_enu_n: Vector3<f64>,
    /// About the centre of mass, FLU, N m.
    pub torque_flu_nm: Vector3<f64>,
    /// Each string, N.
    pub tension_n: [f64; MAX_STRINGS],
    /// Floor and platform together, upward, N.
    pub ground_n: f64,
}

/// A rig made for one airframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Mounted {
    /// Its strings.
    pub lines: ArrayVec<Line, MAX_STRINGS>,
    /// Its pivot; floor and strings are absent then.
    pub pivot: Option<Pivot>,
    /// Where it starts, at rest.
    pub start: State,
    platform: OnStand,
    points_flu_m: [Vector3<f64>; 8],
    lowest_m: f64,
    contact_npm: f64,
    contact_spm: f64,
}

impl Mounted {
    /// Mounts `airframe` on `rig`, at rest at yaw zero.
    pub fn new(rig: &Rig, airframe: &Airframe) -> Self {
        let weight = airframe.weight_n();
        let mut lines = ArrayVec::new();
        let mut pivot = None;
        let mut platform = OnStand { height_m: 0.0, radius_m: 0.0 };
        let mut height = standing_height_m(airframe);
        match rig {
            Rig::Free(r) => height = height.max(r.height_m),
            Rig::OnStand(r) => {
                platform = *r;
                height += r.height_m;
            }
            Rig::Tethered(r) => {
                let stiffness = weight / r.stretch_m;
                lines.push(Line {
                    hook_enu_m: Vector3::zeros(),
                    knot_flu_m: Vector3::new(0.0, 0.0, -r.knot_below_m),
                    rest_length_m: r.length_m,
                    stiffness_npm: stiffness,
                    damping_spm: beta(r.damping_ratio, stiffness, airframe.mass_kg, weight),
                });
            }
            Rig::HangingStrings(r) => {
                height = r.height_m;
                lines = hanging(r, airframe);
            }
            Rig::SingleAxis(r) => {
                let d = r.cg_below_pivot_m.unwrap_or(airframe.cg_below_rotors_m);
                height = r.height_m - d;
                pivot = Some(Pivot {
                    axis: r.axis.unit(),
                    position_enu_m: Vector3::new(0.0, 0.0, r.height_m),
                    cg_flu_m: Vector3::new(0.0, 0.0, -d),
                    friction_nms: r.friction_nms,
                });
            }
        }
        let [a, b, c, d] = airframe.feet_flu_m;
        let [e, f, g, h] = airframe.rotors.map(|rotor| rotor.position_flu_m);
        let points_flu_m = [a, b, c, d, e, f, g, h];
        let contact_npm = weight / GROUND_SINK_M / 4.0;
        Self {
            lines,
            pivot,
            start: State::at_rest(Vector3::new(0.0, 0.0, height)),
            platform,
            points_flu_m,
            lowest_m: points_flu_m.iter().map(|p| p.norm()).fold(0.0, f64::max),
            contact_npm,
            contact_spm: beta(GROUND_DAMPING_RATIO, 4.0 * contact_npm, airframe.mass_kg, weight),
        }
    }

    /// Strings, floor and platform on a body in state `x`. A pivot is not in it: see [`Pivot`].
    pub fn load(&self, x: &State) -> Load {
        let mut load = Load::default();
        for (line, tension) in self.lines.iter().zip(&mut load.tension_n) {
            let knot = rotate(&x.world_from_body, &line.knot_flu_m);
            let to_hook = line.hook_enu_m - x.position_enu_m - knot;
            let length = to_hook.norm();
            let stretch = length - line.rest_length_m;
            if stretch <= 0.0 {
                continue;
            }
            let direction = to_hook / length;
            let speed = -direction.dot(&point_velocity(x, &line.knot_flu_m));
            *tension = one_sided(line.stiffness_npm, line.damping_spm, stretch, speed);
            add(&mut load.force_enu_n, &mut load.torque_flu_nm, x, &line.knot_flu_m, direction * *tension);
        }
        if self.pivot.is_none() && x.position_enu_m.z < self.platform.height_m + self.lowest_m {
            self.touch(x, &mut load);
        }
        load
    }

    fn touch(&self, x: &State, load: &mut Load) {
        for point in &self.points_flu_m {
            let place = x.position_enu_m + rotate(&x.world_from_body, point);
            let on_platform = place.xy().norm() <= self.platform.radius_m && place.z > self.platform.height_m - 0.05;
            let surface = if on_platform { self.platform.height_m } else { 0.0 };
            let depth = surface - place.z;
            if depth <= 0.0 {
                continue;
            }
            let velocity = point_velocity(x, point);
            let normal = one_sided(self.contact_npm, self.contact_spm, depth, -velocity.z);
            let slide = velocity.xy();
            let friction: Vector2<f64> = slide * (-FRICTION * normal / slide.norm().max(FRICTION_SPEED_MPS));
            load.ground_n += normal;
            let force = Vector3::new(friction.x, friction.y, normal);
            add(&mut load.force_enu_n, &mut load.torque_flu_nm, x, point, force);
        }
    }
}

/// Four strings, or one, that carry the weight at the hanging height with the stretch asked for.
fn hanging(r: &HangingStrings, airframe: &Airframe) -> ArrayVec<Line, MAX_STRINGS> {
    let weight = airframe.weight_n();
    let corners: &[(f64, f64)] = match r.strings {
        1 => &[(0.0, 0.0)],
        _ => &[(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)],
    };
    let mut lines = ArrayVec::new();
    for (x, y) in corners {
        let hook = Vector3::new(x * r.hook_spread_m, y * r.hook_spread_m, r.ceiling_m);
        let knot = Vector3::new(x * r.knot_spread_m, y * r.knot_spread_m, r.knot_above_m);
        let vector = hook - knot - Vector3::new(0.0, 0.0, r.height_m);
        let length = vector.norm();
        // n T cos α = m g with all strings alike.
        let tension = weight / corners.len() as f64 * length / vector.z;
        let stiffness = tension / r.stretch_m;
        let vertical = weight / r.stretch_m;
        lines.push(Line {
            hook_enu_m: hook,
            knot_flu_m: knot,
            rest_length_m: length - r.stretch_m,
            stiffness_npm: stiffness,
            damping_spm: beta(r.damping_ratio, vertical, airframe.mass_kg, weight),
        });
    }
    lines
}

/// β that gives `ratio` of critical damping about the stretch under `weight`.
fn beta(ratio: f64, stiffness_npm: f64, mass_kg: f64, weight_n: f64) -> f64 {
    2.0 * ratio * (stiffness_npm * mass_kg).sqrt() / weight_n
}

/// k e (1 + β ė), never pulling the wrong way.
fn one_sided(stiffness_npm: f64, damping_spm: f64, stretch_m: f64, speed_mps: f64) -> f64 {
    stiffness_npm * stretch_m * (1.0 + damping_spm * speed_mps).clamp(0.0, DAMPING_FACTOR_MAX)
}

/// Velocity of a point of the body, ENU.
fn point_velocity(x: &State, point_flu_m: &Vector3<f64>) -> Vector3<f64> {
    x.velocity_enu_mps + rotate(&x.world_from_body, &x.body_rates_radps.cross(point_flu_m))
}

/// Adds `force_enu_n` at `point_flu_m`.
fn add(
    force: &mut Vector3<f64>,
    torque_flu: &mut Vector3<f64>,
    x: &State,
    point_flu_m: &Vector3<f64>,
    force_enu_n: Vector3<f64>,
) {
    *force += force_enu_n;
    *torque_flu += point_flu_m.cross(&rotate(&x.world_from_body.conjugate(), &force_enu_n));
}

impl Pivot {
    /// Angular acceleration about the free axis (rad/s²) under `torque_flu_nm` about the centre of mass and
    /// `force_enu_n` at it (weight excluded).
    ///
    /// [Paternain] Eq. 2, −dMg cosφ sinψ and −dMg sinφ: right here, on a pivot, and nowhere else
    /// (ERRATA [Paternain] 4). Deviation: the moment of inertia is about the pivot, I + m d².
    pub fn angular_acceleration(
        &self,
        airframe: &Airframe,
        x: &State,
        torque_flu_nm: &Vector3<f64>,
        force_enu_n: &Vector3<f64>,
    ) -> f64 {
        let weight = Vector3::new(0.0, 0.0, -airframe.mass_kg * GRAVITY_MPS2);
        let force_flu = rotate(&x.world_from_body.conjugate(), &(weight + force_enu_n));
        let torque = torque_flu_nm + self.cg_flu_m.cross(&force_flu);
        let arm = self.axis.cross(&self.cg_flu_m);
        let inertia =
            self.axis.dot(&airframe.inertia_kgm2.component_mul(&self.axis)) + airframe.mass_kg * arm.norm_squared();
        let rate = self.axis.dot(&x.body_rates_radps);
        (self.axis.dot(&torque) - self.friction_nms * rate) / inertia
    }

    /// The state with everything but the free rotation put back in place.
    pub fn held(&self, mut x: State) -> State {
        let along = self.axis.dot(&x.world_from_body.imag());
        let q = nalgebra::Quaternion::from_parts(x.world_from_body.scalar(), self.axis * along);
        x.world_from_body = q.normalize();
        x.body_rates_radps = self.axis * self.axis.dot(&x.body_rates_radps);
        let arm = rotate(&x.world_from_body, &self.cg_flu_m);
        x.position_enu_m = self.position_enu_m + arm;
        x.velocity_enu_mps = rotate(&x.world_from_body, &x.body_rates_radps.cross(&self.cg_flu_m));
        x
    }
}
