//! The vehicle in space, as its description and its newest values have it.

use leptos::prelude::*;
use plumbline_proto::v1::{self, Description};

use super::frame::Frame;
use crate::{
    deck::Source,
    gpu::{Attitude3dView, Camera, Pose, Rotor, StringLine},
    model::{instrument::Instrument, live::Live},
};

/// Radius of a drawn rotor as a share of the distance to its nearest neighbour: the discs do not touch.
const ROTOR_SHARE: f32 = 0.45;
/// Command from which a motor is drawn as saturated.
const SATURATED: f32 = 0.999;

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

impl Frame {
    /// The estimate in the loop; the truth beside it as an outline, where it is known.
    pub(super) fn space<'a>(&self, live: &Live, instrument: &Instrument, body: &'a Body) -> Attitude3dView<'a> {
        let (azimuth_rad, elevation_rad, zoom_out) = self.deck.camera.get_untracked();
        let east_north = instrument.east_north_m.unwrap_or_default();
        let pose = Pose {
            position_enu_m: [east_north[0], east_north[1], instrument.altitude_m.unwrap_or(0.0)].map(|v| v as f32),
            world_from_body: instrument.world_from_body.map_or([1.0, 0.0, 0.0, 0.0], |q| q.map(|v| v as f32)),
        };
        let ghost = (self.deck.source == Source::Live).then(|| live.truth.get()).flatten().map(|t| Pose {
            position_enu_m: metres(t.position_enu_m.as_ref()),
            world_from_body: t
                .world_from_body
                .map_or([1.0, 0.0, 0.0, 0.0], |q| [q.w as f32, q.x as f32, q.y as f32, q.z as f32]),
        });
        Attitude3dView {
            pose,
            ghost,
            rotors: &body.rotors,
            strings: &body.strings,
            camera: Camera { azimuth_rad, elevation_rad, zoom_out },
            stale: instrument.stale,
            theme: self.theme,
        }
    }
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
