//! A rig made for one airframe: its forces on the body.
//!
//! A string is a one-sided spring: with stretch e > 0 and stretching speed ė its tension is
//! k e (1 + β ė), never negative (Hunt–Crossley: continuous where it goes slack); slack it does nothing.
//! A contact point is the same with penetration δ, plus Coulomb friction smoothed near zero speed.
//! A knot that carries a tension T resists turning with friction·T/(m g)·ω.
//! Assumes massless strings, knots that do not slip, a level floor.

use arrayvec::ArrayVec;
use nalgebra::{Vector2, Vector3};

use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::rigid_body::{State, rotate};
use plumbline_core::types::GRAVITY_MPS2;

use super::{HangingStrings, MAX_STRINGS, OnStand, Rig};

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

/// Height of the centre of mass when the vehicle stands on its feet, m.
pub fn standing_height_m(airframe: &Airframe) -> f64 {
    airframe.standing_m() - GROUND_SINK_M
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
    /// Friction of the knot, of its tension, m s.
    pub friction_ms: f64,
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
                    friction_ms: 0.0,
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
            load.torque_flu_nm -= x.body_rates_radps * (line.friction_ms * *tension);
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
            friction_ms: r.knot_friction_nms / weight,
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
