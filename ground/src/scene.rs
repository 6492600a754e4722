//! Foxglove's own schemas beside ours: `foxglove.FrameTransform` of the estimate in the loop, `foxglove.SceneUpdate` with
//! the vehicle, its strings and what every estimator says, `foxglove.Log` of events, `foxglove.LaserScan` of scans where they are
//! recorded. A viewer shows them without being told how.
//!
//! As JSON, which those schemas have beside protobuf. Frames are ours: `map` is east-north-up, `base_link` forward-left-up.
//! The live link and the export of a flight say the same by it; a flight file holds the downlink alone.

use std::collections::BTreeMap;

use plumbline_proto::codec::Frame;
use plumbline_proto::{Kind, v1};
use serde_json::{Value, json};

use crate::names::JsonName as _;

/// Least time between two scenes, µs: 20 Hz.
const SCENE_EVERY_US: u64 = 50_000;
/// Half the length of an arm, for the eye: of an Iris.
const ARM_M: f64 = 0.25;
/// What an estimate says further from the one in the loop than this, m, bears its name.
const APART_M: f64 = 0.1;
/// Colours told apart by most people (Okabe and Ito 2008), and three of Tol's (2021): one for the vehicle, and for each estimator.
const COLOURS: [[f64; 3]; 10] = [
    [0.0, 0.447, 0.698],
    [0.902, 0.624, 0.0],
    [0.0, 0.62, 0.451],
    [0.8, 0.475, 0.655],
    [0.835, 0.369, 0.0],
    [0.337, 0.706, 0.914],
    [0.941, 0.894, 0.259],
    [0.533, 0.133, 0.333],
    [0.2, 0.133, 0.533],
    [0.6, 0.6, 0.2],
];

/// What there is of those schemas. All but scans are offered at once, so that a panel finds its topic before the first event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Offer {
    Transform,
    Scene,
    Log,
    Laser,
}

impl Offer {
    pub(crate) const ALL: [Self; 4] = [Self::Transform, Self::Scene, Self::Log, Self::Laser];

    pub(crate) const fn topic(self) -> &'static str {
        match self {
            Self::Transform => "/tf",
            Self::Scene => "/scene",
            Self::Log => "/log",
            Self::Laser => "/laser",
        }
    }

    pub(crate) const fn schema_name(self) -> &'static str {
        match self {
            Self::Transform => "foxglove.FrameTransform",
            Self::Scene => "foxglove.SceneUpdate",
            Self::Log => "foxglove.Log",
            Self::Laser => "foxglove.LaserScan",
        }
    }

    /// Its JSON schema. Foxglove refuses a channel where an object has no `properties`; shapes that are never drawn have
    /// empty ones.
    pub(crate) fn schema(self) -> Value {
        let [number, integer, text, boolean] =
            ["number", "integer", "string", "boolean"].map(|name| json!({ "type": name }));
        let object = |fields: Value| json!({ "type": "object", "properties": fields });
        let list = |of: &Value| json!({ "type": "array", "items": of });
        let time = object(json!({ "sec": integer, "nsec": integer }));
        let vector = object(json!({ "x": number, "y": number, "z": number }));
        let rotation = object(json!({ "x": number, "y": number, "z": number, "w": number }));
        let pose = object(json!({ "position": vector, "orientation": rotation }));
        let mut schema = match self {
            Self::Transform => object(json!({ "timestamp": time, "parent_frame_id": text, "child_frame_id": text,
                "translation": vector, "rotation": rotation })),
            Self::Log => {
                object(json!({ "timestamp": time, "level": integer, "message": text, "name": text, "file": text,
                "line": integer }))
            }
            Self::Laser => object(json!({ "timestamp": time, "frame_id": text, "pose": pose, "start_angle": number,
                "end_angle": number, "ranges": list(&number), "intensities": list(&number) })),
            Self::Scene => {
                let colour = object(json!({ "r": number, "g": number, "b": number, "a": number }));
                let solid = list(&object(json!({ "pose": pose, "size": vector, "color": colour })));
                let line = object(json!({ "type": integer, "pose": pose, "thickness": number,
                    "scale_invariant": boolean, "points": list(&vector), "color": colour, "colors": list(&colour),
                    "indices": list(&integer) }));
                let words = list(&object(json!({ "pose": pose, "billboard": boolean, "font_size": number,
                    "scale_invariant": boolean, "color": colour, "text": text })));
                let none = list(&object(json!({})));
                let entity = object(json!({ "timestamp": time, "frame_id": text, "id": text, "lifetime": time,
                    "frame_locked": boolean, "metadata": none, "arrows": none, "cubes": solid, "spheres": solid,
                    "cylinders": none, "lines": list(&line), "triangles": none, "texts": words, "models": none }));
                object(json!({ "deletions": none, "entities": list(&entity) }))
            }
        };
        schema["title"] = self.schema_name().into();
        schema
    }
}

/// One message of such a schema.
pub(crate) struct Drawn {
    pub(crate) offer: Offer,
    pub(crate) json: Value,
    pub(crate) sampled: bool,
}

/// What is drawn next.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    estimates: BTreeMap<u16, v1::Estimate>,
    truth: Option<v1::Vector3>,
    strings: Vec<v1::StringDescription>,
    drawn_us: u64,
}

/// `world` in the body's axes: the inverse rotation of a unit quaternion, v + 2 u × (u × v − w v) with u its vector part.
pub(crate) fn body_from_world(q: &v1::Quaternion, world: &v1::Vector3) -> v1::Vector3 {
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let (u, v) = ([q.x, q.y, q.z], [world.x, world.y, world.z]);
    let inner = cross(u, v);
    let inner = [inner[0] - q.w * v[0], inner[1] - q.w * v[1], inner[2] - q.w * v[2]];
    let turn = cross(u, inner);
    v1::Vector3 { x: v[0] + 2.0 * turn[0], y: v[1] + 2.0 * turn[1], z: v[2] + 2.0 * turn[2] }
}

fn time(us: u64) -> Value {
    json!({ "sec": us / 1_000_000, "nsec": us % 1_000_000 * 1000 })
}

fn vector(vector: &v1::Vector3) -> Value {
    json!({ "x": vector.x, "y": vector.y, "z": vector.z })
}

fn colour(at: usize, alpha: f64) -> Value {
    let [r, g, b] = COLOURS[at % COLOURS.len()];
    json!({ "r": r, "g": g, "b": b, "a": alpha })
}

fn still() -> Value {
    json!({ "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 })
}

/// A thing with all the kinds of shapes that the schema has, of which `shapes` says some.
fn entity(id: &str, frame: &str, now_us: u64, shapes: &Value) -> Value {
    let mut entity = json!({ "timestamp": time(now_us), "frame_id": frame, "id": id, "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": true, "metadata": [], "arrows": [], "cubes": [], "spheres": [], "cylinders": [], "lines": [],
        "triangles": [], "texts": [], "models": [] });
    for (name, shape) in shapes.as_object().into_iter().flatten() {
        entity[name] = shape.clone();
    }
    entity
}

fn ball(at: &v1::Vector3, colour: &Value) -> Value {
    json!([{ "pose": { "position": vector(at), "orientation": still() }, "size": { "x": 0.08, "y": 0.08, "z": 0.08 },
        "color": colour }])
}

impl Scene {
    /// What follows from one message, of what is `wanted`.
    pub(crate) fn take(
        &mut self,
        kind: Kind,
        frame: &Frame<'_>,
        now_us: u64,
        wanted: impl Fn(Offer) -> bool,
    ) -> Vec<Drawn> {
        match kind {
            Kind::Event if !wanted(Offer::Log) => Vec::new(),
            Kind::Scan if !wanted(Offer::Laser) => Vec::new(),
            Kind::Event => frame.message().map_or_else(|_| Vec::new(), |event| vec![log(&event, now_us)]),
            Kind::Scan => frame.message().map_or_else(|_| Vec::new(), |scan| vec![laser(&scan, now_us)]),
            Kind::Description => {
                self.strings = frame.message::<v1::Description>().map_or_else(|_| Vec::new(), |told| told.strings);
                Vec::new()
            }
            Kind::Truth => {
                self.truth = frame.message::<v1::Truth>().ok().and_then(|truth| truth.position_enu_m);
                Vec::new()
            }
            Kind::Estimate => {
                let Ok(estimate) = frame.message::<v1::Estimate>() else { return Vec::new() };
                let leads = estimate.in_loop;
                self.estimates.insert(frame.instance, estimate);
                if !leads {
                    return Vec::new();
                }
                let transform = wanted(Offer::Transform).then(|| self.transform(frame.instance, now_us)).flatten();
                let mut drawn: Vec<Drawn> = transform.into_iter().collect();
                if wanted(Offer::Scene) && now_us.abs_diff(self.drawn_us) >= SCENE_EVERY_US {
                    self.drawn_us = now_us;
                    drawn.push(self.scene(frame.instance, now_us));
                }
                drawn
            }
            _ => Vec::new(),
        }
    }

    fn transform(&self, instance: u16, now_us: u64) -> Option<Drawn> {
        let estimate = self.estimates.get(&instance)?;
        let q = estimate.world_from_body?;
        let json = json!({ "timestamp": time(now_us), "parent_frame_id": "map", "child_frame_id": "base_link",
            "translation": vector(&estimate.position_enu_m.unwrap_or_default()),
            "rotation": { "x": q.x, "y": q.y, "z": q.z, "w": q.w } });
        Some(Drawn { offer: Offer::Transform, json, sampled: true })
    }

    /// Strings from their hooks to where an estimate has their knots; pale ones are slack.
    fn strings(&self, estimate: &v1::Estimate, now_us: u64) -> Vec<Value> {
        let (Some(place), Some(q)) = (estimate.position_enu_m, estimate.world_from_body) else { return Vec::new() };
        let back = v1::Quaternion { w: q.w, x: -q.x, y: -q.y, z: -q.z };
        let mut drawn = Vec::new();
        for (number, string) in self.strings.iter().enumerate() {
            let (Some(hook), Some(knot)) = (&string.hook_enu_m, &string.knot_flu_m) else { continue };
            let arm = body_from_world(&back, knot);
            let knot = v1::Vector3 { x: place.x + arm.x, y: place.y + arm.y, z: place.z + arm.z };
            let length = (hook.x - knot.x).hypot(hook.y - knot.y).hypot(hook.z - knot.z);
            let alpha = if length < string.rest_length_m { 0.3 } else { 1.0 };
            let line = json!({ "lines": [{ "type": 0, "pose": { "position": vector(&v1::Vector3::default()),
                "orientation": still() }, "thickness": 0.01, "scale_invariant": false,
                "points": [vector(hook), vector(&knot)], "color": { "r": 0.3, "g": 0.3, "b": 0.3, "a": alpha },
                "colors": [], "indices": [] }] });
            drawn.push(entity(&format!("string {}", number + 1), "map", now_us, &line));
        }
        drawn
    }

    fn scene(&self, leader: u16, now_us: u64) -> Drawn {
        let arm = ARM_M / std::f64::consts::SQRT_2;
        let points: Vec<Value> = [(arm, arm), (-arm, -arm), (arm, -arm), (-arm, arm)]
            .map(|(x, y)| json!({ "x": x, "y": y, "z": 0.0 }))
            .into();
        let here = json!({ "position": vector(&v1::Vector3::default()), "orientation": still() });
        let body = json!({
            "cubes": [{ "pose": here, "size": { "x": 0.2, "y": 0.1, "z": 0.06 }, "color": colour(0, 1.0) }],
            "lines": [{ "type": 2, "pose": here, "thickness": 0.02, "scale_invariant": false, "points": points,
                "color": colour(0, 1.0), "colors": [], "indices": [] }],
        });
        let mut entities = vec![entity("vehicle", "base_link", now_us, &body)];
        let leads = self.estimates.get(&leader);
        entities.extend(leads.map_or_else(Vec::new, |estimate| self.strings(estimate, now_us)));
        let leads = leads.and_then(|estimate| estimate.position_enu_m).unwrap_or_default();
        for (at, estimate) in self.estimates.values().enumerate() {
            let (Some(position), true) = (estimate.position_enu_m, estimate.altitude_known) else { continue };
            let name = v1::EstimatorKind::json_name(estimate.estimator());
            let mut shapes = json!({ "spheres": ball(&position, &colour(at + 1, 0.8)) });
            let apart = (position.x - leads.x).hypot(position.y - leads.y).hypot(position.z - leads.z);
            if apart > APART_M {
                let above = v1::Vector3 { z: position.z + 0.08, ..position };
                shapes["texts"] = json!([{ "pose": { "position": vector(&above), "orientation": still() },
                    "billboard": true, "font_size": 14.0, "scale_invariant": true, "color": colour(at + 1, 1.0),
                    "text": name }]);
            }
            entities.push(entity(&name, "map", now_us, &shapes));
        }
        if let Some(truth) = &self.truth {
            let grey = json!({ "r": 0.5, "g": 0.5, "b": 0.5, "a": 0.6 });
            entities.push(entity("truth", "map", now_us, &json!({ "spheres": ball(truth, &grey) })));
        }
        let json = json!({ "deletions": [], "entities": entities });
        Drawn { offer: Offer::Scene, json, sampled: true }
    }
}

fn log(event: &v1::Event, now_us: u64) -> Drawn {
    // foxglove.Log: 2 information, 3 warning, 4 error.
    let level = match event.severity() {
        v1::Severity::Warning => 3,
        v1::Severity::Critical => 4,
        _ => 2,
    };
    let json = json!({ "timestamp": time(now_us), "level": level, "message": event.text, "name": event.kind, "file": "", "line": 0 });
    Drawn { offer: Offer::Log, json, sampled: false }
}

/// A range below this is the scanner's error code, mm.
const RANGE_MIN_MM: u32 = 20;

/// Error codes are no ranges. JSON has no number for that: they lie at the scanner itself.
fn laser(scan: &v1::Scan, now_us: u64) -> Drawn {
    let steps = scan.range_mm.len().saturating_sub(1) as f64;
    let range = |mm: &u32| if *mm >= RANGE_MIN_MM { f64::from(*mm) * 1e-3 } else { 0.0 };
    let ranges: Vec<f64> = scan.range_mm.iter().map(range).collect();
    let q = scan.body_from_scan.unwrap_or_default();
    let pose = json!({ "position": vector(&scan.position_flu_m.unwrap_or_default()),
        "orientation": { "x": q.x, "y": q.y, "z": q.z, "w": q.w } });
    let json = json!({ "timestamp": time(now_us), "frame_id": "base_link", "pose": pose, "start_angle": scan.first_angle_rad,
        "end_angle": scan.first_angle_rad + steps * scan.step_angle_rad, "ranges": ranges, "intensities": [] });
    Drawn { offer: Offer::Laser, json, sampled: true }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::Message as _;

    use super::*;

    #[test]
    fn velocities_are_turned_into_the_body() {
        // A quarter turn to the left: what goes north goes forward.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let q = v1::Quaternion { w: half, x: 0.0, y: 0.0, z: half };
        let v = body_from_world(&q, &v1::Vector3 { x: 0.0, y: 2.0, z: 1.0 });
        assert!((v.x - 2.0).abs() < 1e-12 && v.y.abs() < 1e-12 && (v.z - 1.0).abs() < 1e-12, "{v:?}");
    }

    #[test]
    fn a_scan_is_a_laser_scan_and_its_error_codes_are_no_ranges() {
        let scan = v1::Scan {
            first_angle_rad: -1.0,
            step_angle_rad: 0.5,
            range_mm: vec![1500, 7, 20, 4000],
            position_flu_m: Some(v1::Vector3 { x: 0.08, y: 0.0, z: -0.05 }),
            body_from_scan: Some(v1::Quaternion { w: 0.0, x: 0.6, y: 0.0, z: -0.8 }),
            ..Default::default()
        };
        let payload = scan.encode_to_vec();
        let frame = Frame { kind: Kind::Scan.to_wire(), instance: 2, sequence: 1, time_us: 5, payload: &payload };
        let drawn = Scene::default().take(Kind::Scan, &frame, 1_500_000, |_| true);
        assert_eq!((drawn.len(), drawn[0].offer), (1, Offer::Laser));
        let laser = &drawn[0].json;
        assert_eq!(laser["ranges"], json!([1.5, 0.0, 0.02, 4.0]));
        assert_eq!((laser["start_angle"].as_f64(), laser["end_angle"].as_f64()), (Some(-1.0), Some(0.5)));
        assert_eq!(laser["pose"]["orientation"], json!({ "x": 0.6, "y": 0.0, "z": -0.8, "w": 0.0 }));
        assert_eq!(laser["timestamp"], json!({ "sec": 1, "nsec": 500_000_000 }));
    }

    /// GIVEN two estimates WHEN they part THEN the one that is not in the loop bears its name, and each has a colour of its own.
    #[test]
    fn what_parts_from_the_loop_bears_its_name() {
        let mut scene = Scene::default();
        let mut texts = |z: f64, now_us: u64| {
            let mut last = Vec::new();
            for (instance, estimator, in_loop, z) in
                [(2, v1::EstimatorKind::Secure, false, z), (1, v1::EstimatorKind::EkfBias, true, 1.0)]
            {
                let position_enu_m = Some(v1::Vector3 { x: 0.0, y: 0.0, z });
                let world_from_body = Some(v1::Quaternion { w: 1.0, ..Default::default() });
                let mut estimate = v1::Estimate {
                    in_loop,
                    position_enu_m,
                    world_from_body,
                    altitude_known: true,
                    ..Default::default()
                };
                estimate.set_estimator(estimator);
                let payload = estimate.encode_to_vec();
                let frame =
                    Frame { kind: Kind::Estimate.to_wire(), instance, sequence: 1, time_us: now_us, payload: &payload };
                last = scene.take(Kind::Estimate, &frame, now_us, |offer| offer == Offer::Scene);
            }
            let entities = last[0].json["entities"].as_array().unwrap().clone();
            entities.iter().flat_map(|entity| entity["texts"].as_array().unwrap().clone()).collect::<Vec<_>>()
        };
        assert!(texts(1.05, 100_000).is_empty());
        let apart = texts(1.2, 200_000);
        assert_eq!((apart.len(), apart[0]["text"].as_str()), (1, Some("secure")));
        let colours: std::collections::BTreeSet<String> = COLOURS.iter().map(|colour| format!("{colour:?}")).collect();
        let kinds = (1..).take_while(|kind| v1::EstimatorKind::try_from(*kind).is_ok()).count();
        assert!(colours.len() > kinds, "{} colours, {kinds} estimators", colours.len());
    }

    /// GIVEN a quarter turn to the left, 2 m up WHEN drawn THEN a string ends at its knot as it is turned, pale while slack.
    #[test]
    fn strings_end_at_their_knots() {
        let vector = |x, y, z| Some(v1::Vector3 { x, y, z });
        let string = |rest_length_m| v1::StringDescription {
            hook_enu_m: vector(0.0, 0.0, 3.0),
            knot_flu_m: vector(0.25, 0.0, 0.0),
            rest_length_m,
        };
        let mut scene = Scene::default();
        let mut take = |kind: Kind, payload: &[u8]| {
            let frame = Frame { kind: kind.to_wire(), instance: 1, sequence: 1, time_us: 100_000, payload };
            scene.take(kind, &frame, 100_000, |_| true)
        };
        let described = v1::Description { strings: vec![string(0.5), string(5.0)], ..Default::default() };
        assert!(take(Kind::Description, &described.encode_to_vec()).is_empty());
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let estimate = v1::Estimate {
            in_loop: true,
            position_enu_m: vector(0.0, 0.0, 2.0),
            world_from_body: Some(v1::Quaternion { w: half, x: 0.0, y: 0.0, z: half }),
            ..Default::default()
        };
        let drawn = take(Kind::Estimate, &estimate.encode_to_vec());
        let entities = drawn[1].json["entities"].as_array().unwrap();
        let alphas: Vec<_> = entities.iter().filter(|e| e["id"].as_str().unwrap().starts_with("string")).collect();
        assert_eq!(alphas.len(), 2);
        let knot = &alphas[0]["lines"][0]["points"][1];
        for (axis, expected) in [("x", 0.0), ("y", 0.25), ("z", 2.0)] {
            assert!((knot[axis].as_f64().unwrap() - expected).abs() < 1e-12, "{knot}");
        }
        let alpha = |at: usize| alphas[at]["lines"][0]["color"]["a"].as_f64();
        assert_eq!((alpha(0), alpha(1)), (Some(1.0), Some(0.3)));
    }
}
