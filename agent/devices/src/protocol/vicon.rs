//! Vicon UDP object stream (port 51001): one datagram a frame, little-endian.
//!
//! u32 frame number, u8 number of items, then for each: u8 id (0: an object), u16 bytes that follow, name (24 bytes, zero
//! padded), translation x y z (f64, mm), rotation x y z (f64, rad; intrinsic rotations about x, then y, then z).

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use crate::fault::Fault;
use crate::framer::le;
use crate::reading::PoseReading;

const ITEM: usize = 72;
const NAME: usize = 24;

/// The pose of the object `name` and the frame's number; `None` where the datagram does not hold it, or the object is
/// hidden (all zero).
///
/// # Errors
/// The datagram ends early, or holds what is no number.
pub fn decode(datagram: &[u8], name: &str) -> Result<(u32, Option<PoseReading>), Fault> {
    const SHORT: Fault = Fault::Malformed("Vicon datagram");
    let head = datagram.get(..5).ok_or(SHORT)?;
    let (frame, items) = (le::u32(head, 0), head.last().copied().unwrap_or_default());
    let mut rest = datagram.get(5..).unwrap_or_default();
    for _ in 0..items {
        let size = usize::from(le::u16(rest.get(..3).ok_or(SHORT)?, 1));
        let object = rest.first() == Some(&0);
        let body = rest.get(3..3 + size).ok_or(SHORT)?;
        rest = rest.get(3 + size..).unwrap_or_default();
        let own = body.get(..NAME).and_then(|bytes| bytes.split(|b| *b == 0).next()).unwrap_or_default();
        if !object || own != name.as_bytes() {
            continue;
        }
        if size < ITEM {
            return Err(SHORT);
        }
        let three = |at: usize| Vector3::from_fn(|axis, _| le::f64(body, at + 8 * axis));
        let (translation, turn) = (three(NAME) * 1e-3, three(NAME + 24));
        if !translation.iter().chain(turn.iter()).all(|value| value.is_finite()) {
            return Err(Fault::Malformed("Vicon pose"));
        }
        if translation == Vector3::zeros() && turn == Vector3::zeros() {
            return Ok((frame, None));
        }
        let about = |axis: Vector3<f64>, angle: f64| Rotation3::from_scaled_axis(axis * angle);
        let rotation = about(Vector3::x(), turn.x) * about(Vector3::y(), turn.y) * about(Vector3::z(), turn.z);
        let attitude = UnitQuaternion::from_rotation_matrix(&rotation);
        return Ok((frame, Some(PoseReading { position_m: translation, attitude })));
    }
    Ok((frame, None))
}

/// A datagram with one object, as a Vicon server sends it.
pub fn encode(frame: u32, name: &str, pose: &PoseReading) -> Vec<u8> {
    let mut out = frame.to_le_bytes().to_vec();
    out.extend([1, 0]);
    out.extend((ITEM as u16).to_le_bytes());
    let mut padded = [0; NAME];
    padded.iter_mut().zip(name.bytes()).for_each(|(to, from)| *to = from);
    out.extend(padded);
    let r = pose.attitude.to_rotation_matrix();
    // R = Rx(a) Ry(b) Rz(c).
    let turn = [(-r[(1, 2)]).atan2(r[(2, 2)]), r[(0, 2)].clamp(-1.0, 1.0).asin(), (-r[(0, 1)]).atan2(r[(0, 0)])];
    for value in (pose.position_m * 1e3).iter().chain(&turn) {
        out.extend(value.to_le_bytes());
    }
    out
}
