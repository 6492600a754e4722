//! The vehicle in space, as its description and its newest values have it.

use leptos::prelude::*;
use plumbline_proto::v1::{self, Description};

use super::frame::Frame;
use crate::{
    deck::Source,
    gpu::{Attitude3dView, Bounds, Camera, Ghost, Pose, Rotor, StringLine},
    model::{
        curves::{Axis, Curve, DEGREES, Horizontal},
        instrument::{Instrument, quaternion},
        live::Live,
    },
    palette,
};

/// Radius of a drawn rotor as a share of the distance to its nearest neighbour: the discs do not touch.
const ROTOR_SHARE: f32 = 0.45;
/// Command from which a motor is drawn as saturated.
const SATURATED: f32 = 0.999;

/// The trail goes back so far, s …
const TRAIL_S: f64 = 12.0;
/// … in so many pieces.
const TRAIL_POINTS: usize = 90;
/// Estimators nearer to the one in the loop than this are not drawn beside it, m …
const APART_M: f32 = 0.05;
/// … and rad.
const APART_RAD: f32 = 0.05;

/// Rotors and strings of the vehicle shown.
pub(super) struct Body {
    rotors: Vec<Rotor>,
    strings: Vec<StringLine>,
}

impl Body {
    /// As described, with the motors of `instrument`. Nothing is drawn of what is not described.
    pub(super) fn new(live: &Live, instrument: &Instrument) -> Self {
        let Some(description) = live.description.get() else { return Self { rotors: Vec::new(), strings: Vec::new() } };
        Self { rotors: rotors(description, &instrument.motors), strings: strings(description) }
    }
}

fn metres(v: Option<&v1::Vector3>) -> [f32; 3] {
    v.map_or([0.0; 3], |v| [v.x as f32, v.y as f32, v.z as f32])
}

fn rotors(description: &Description, motors: &[f64]) -> Vec<Rotor> {
    let hubs: Vec<[f32; 3]> = description.rotors.iter().map(|r| metres(r.position_flu_m.as_ref())).collect();
    let distance = |a: &[f32; 3], b: &[f32; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let nearest = |i: usize| {
        let others = hubs.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, other)| distance(&hubs[i], other)).fold(f32::INFINITY, f32::min)
    };
    let radius = (0..hubs.len()).map(nearest).fold(f32::INFINITY, f32::min) * ROTOR_SHARE;
    let radius_m = if radius.is_finite() { radius } else { 0.0 };
    let level = |i: usize| motors.get(i).copied().unwrap_or(0.0) as f32;
    hubs.iter()
        .enumerate()
        .map(|(i, hub)| Rotor { position_flu_m: *hub, radius_m, level: level(i), saturated: level(i) >= SATURATED })
        .collect()
}

fn strings(description: &Description) -> Vec<StringLine> {
    let line = |s: &v1::StringDescription| StringLine {
        anchor_enu_m: metres(s.hook_enu_m.as_ref()),
        attach_flu_m: metres(s.knot_flu_m.as_ref()),
        length_m: s.rest_length_m as f32,
    };
    description.strings.iter().map(line).collect()
}

/// Position in the plane as the estimator in the loop has it, else the true one, else above the origin.
fn plane(live: &Live, time_s: f64) -> [f32; 2] {
    let place = |of| live.curves.place_at(of, time_s);
    place(Curve::Plane).or_else(|| place(Curve::TruthPlane)).unwrap_or_default().map(|v| v as f32)
}

/// The pose that altitude and angles give, at a place in the plane.
fn pose(live: &Live, time_s: f64, [x, y]: [f32; 2], up: Curve, angle: impl Fn(Axis) -> Curve) -> Option<Pose> {
    let read = |curve| live.curves.value_at(curve, time_s);
    let [roll, pitch, yaw] = Axis::ALL.map(|axis| read(angle(axis)).map(|deg| deg / DEGREES));
    Some(Pose {
        position_enu_m: [x, y, read(up)? as f32],
        world_from_body: quaternion(roll?, pitch?, yaw?).map(|v| v as f32),
    })
}

/// Are they apart by what can be seen?
fn part(a: &Pose, b: &Pose) -> bool {
    let apart_m = (0..3).map(|i| (a.position_enu_m[i] - b.position_enu_m[i]).powi(2)).sum::<f32>().sqrt();
    let dot: f32 = (0..4).map(|i| a.world_from_body[i] * b.world_from_body[i]).sum();
    apart_m > APART_M || dot.abs() < (APART_RAD / 2.0).cos()
}

impl Frame {
    /// The estimate in the loop where it was, is and is to be, in its box; truth and other estimators beside it, as
    /// outlines, where they part from it.
    pub(super) fn space<'a>(&self, live: &Live, instrument: &Instrument, body: &'a Body) -> Attitude3dView<'a> {
        let (azimuth_rad, elevation_rad, zoom_out) = self.deck.camera.get_untracked();
        let time_s = match self.deck.source {
            Source::Live => live.clock.newest_us() as f64 * 1e-6,
            Source::Recorded => self.deck.playhead.get_untracked(),
        };
        let [x, y] = plane(live, time_s);
        let own = Pose {
            position_enu_m: [x, y, instrument.altitude_m.unwrap_or(0.0) as f32],
            world_from_body: instrument.world_from_body.map_or([1.0, 0.0, 0.0, 0.0], |q| q.map(|v| v as f32)),
        };
        Attitude3dView {
            pose: own,
            ghosts: self.ghosts(live, time_s, &own),
            trail: trail(live, time_s),
            bounds: live
                .description
                .get()
                .and_then(|d| d.limits.as_ref())
                .map(|limits| Bounds { half_m: limits.lateral_max_m as f32, top_m: limits.altitude_max_m as f32 }),
            goal: goal(live, self.deck.source, instrument, &own),
            rotors: &body.rotors,
            strings: &body.strings,
            camera: Camera { azimuth_rad, elevation_rad, zoom_out },
            stale: instrument.stale,
            theme: self.theme,
        }
    }

    fn ghosts(&self, live: &Live, time_s: f64, own: &Pose) -> Vec<Ghost> {
        let in_loop = live.in_loop();
        let [x, y, _] = own.position_enu_m;
        let read = |axis| live.curves.value_at(Curve::TruthPlane(axis), time_s).map(|v| v as f32);
        let true_plane = [read(Horizontal::East).unwrap_or(x), read(Horizontal::North).unwrap_or(y)];
        let truth = pose(live, time_s, true_plane, Curve::TruthAltitude, Curve::TruthAttitude);
        let mut ghosts: Vec<_> = truth.map(|pose| Ghost { pose, color: self.theme.ink }).into_iter().collect();
        for curve in live.curves.names() {
            let Curve::Altitude(number) = curve else { continue };
            // Only the estimator in the loop says where it is in the plane: the others hang beside it.
            let other = pose(live, time_s, [x, y], curve, |axis| Curve::Attitude(number, axis));
            if let Some(pose) = other.filter(|pose| number != in_loop && part(pose, own)) {
                ghosts.push(Ghost { pose, color: palette::estimator(number, in_loop).ink.on(self.dark) });
            }
        }
        ghosts
    }
}

/// Where the estimate in the loop was during the last seconds.
fn trail(live: &Live, time_s: f64) -> Vec<[f32; 3]> {
    let up = Curve::Altitude(live.in_loop());
    let at = |i: usize| {
        let time_s = time_s - TRAIL_S * (1.0 - i as f64 / TRAIL_POINTS as f64);
        let [x, y] = plane(live, time_s);
        Some([x, y, live.curves.value_at(up, time_s)? as f32])
    };
    (0..=TRAIL_POINTS).filter_map(at).collect()
}

/// The altitude setpoint above where the vehicle is, or above where it is to be, where that is held.
fn goal(live: &Live, source: Source, instrument: &Instrument, own: &Pose) -> Option<[f32; 3]> {
    let setpoint = live.control.get().filter(|_| source == Source::Live).and_then(|c| c.setpoint.as_ref());
    let [x, y, _] = own.position_enu_m;
    let held = |of: Option<f64>, own: f32| of.map_or(own, |v| v as f32);
    let (x, y) = (held(setpoint.and_then(|s| s.x_m), x), held(setpoint.and_then(|s| s.y_m), y));
    Some([x, y, instrument.setpoint_m? as f32])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hub(x: f64, y: f64) -> v1::RotorDescription {
        v1::RotorDescription { position_flu_m: Some(v1::Vector3 { x, y, z: 0.0 }), counter_clockwise: true }
    }

    #[test]
    fn discs_of_any_layout_do_not_touch_and_show_their_motor() {
        let square = [(0.2, 0.13), (-0.2, -0.13), (0.2, -0.13), (-0.2, 0.13)];
        let description =
            Description { rotors: square.iter().map(|(x, y)| hub(*x, *y)).collect(), ..Default::default() };
        let made = rotors(&description, &[0.5, 1.0, 0.0]);
        assert_eq!(
            made.iter().map(|r| (r.level, r.saturated)).collect::<Vec<_>>(),
            [(0.5, false), (1.0, true), (0.0, false), (0.0, false)]
        );
        assert!(made.iter().all(|r| r.radius_m > 0.1 && r.radius_m < 0.13), "{made:?}");
        assert!(rotors(&Description::default(), &[0.5]).is_empty());
    }
}
