//! OptiTrack NatNet: frames of motion capture (NatNet SDK 3.0 to 4.1, "direct depacketization"), little-endian.
//!
//! A datagram is u16 message, u16 bytes that follow. A client asks with NAT_CONNECT (0) and hears the version in
//! NAT_SERVERINFO (1); frames are NAT_FRAMEOFDATA (7): frame number, marker sets, other markers, rigid bodies, and more that is
//! not read here. From 4.1 on each count is followed by the bytes of its section.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::fault::Fault;
use crate::framer::le;
use crate::reading::PoseReading;

const CONNECT: u16 = 0;
const SERVER_INFO: u16 = 1;
const FRAME: u16 = 7;
const KEEP_ALIVE: u16 = 10;
const SHORT: Fault = Fault::Malformed("NatNet datagram");
/// More of anything than this is garbage.
const COUNT_MAX: i32 = 1000;

/// Protocol version: major, minor.
pub type Version = (u8, u8);

/// The oldest version that is read.
pub const OLDEST: Version = (3, 0);

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], Fault> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or(SHORT)?;
        self.0 = rest;
        Ok(taken)
    }
    fn i32(&mut self) -> Result<i32, Fault> {
        Ok(le::i32(self.take(4)?, 0))
    }
    fn count(&mut self) -> Result<usize, Fault> {
        let count = self.i32()?;
        if (0..=COUNT_MAX).contains(&count) {
            Ok(count as usize)
        } else {
            Err(Fault::Value { what: "NatNet count", value: count.into(), expected: "0 to 1000" })
        }
    }
    fn name(&mut self) -> Result<(), Fault> {
        let length = self.0.iter().position(|b| *b == 0).ok_or(SHORT)?;
        self.take(length + 1).map(drop)
    }
}

/// The pose of rigid body `id` and the frame's number; `None` where the body is not tracked, or not in the frame. A datagram
/// that is no frame gives `Ok(None)`.
///
/// # Errors
/// The datagram ends early, or holds what is no number.
pub fn decode(datagram: &[u8], version: Version, id: i32) -> Result<Option<(i32, Option<PoseReading>)>, Fault> {
    let mut r = Reader(datagram);
    let head = r.take(4)?;
    if le::u16(head, 0) != FRAME {
        return Ok(None);
    }
    let sized = version >= (4, 1);
    let frame = r.i32()?;
    let sets = r.count()?;
    if sized {
        let bytes = r.i32()?;
        r.take(usize::try_from(bytes).map_err(|_| SHORT)?)?;
    } else {
        for _ in 0..sets {
            r.name()?;
            let markers = r.count()?;
            r.take(12 * markers)?;
        }
    }
    let others = r.count()?;
    if sized {
        r.i32()?;
    }
    r.take(12 * others)?;
    let bodies = r.count()?;
    if sized {
        r.i32()?;
    }
    for _ in 0..bodies {
        let body = r.take(38)?;
        if le::i32(body, 0) != id {
            continue;
        }
        let f = |index: usize| f64::from(le::f32(body, 4 + 4 * index));
        let (position_m, q) = (Vector3::new(f(0), f(1), f(2)), Quaternion::new(f(6), f(3), f(4), f(5)));
        let tracked = le::u16(body, 36) & 1 != 0;
        let attitude = UnitQuaternion::try_new(q, 0.5);
        return match attitude {
            _ if !tracked => Ok(Some((frame, None))),
            Some(attitude) if position_m.iter().all(|x| x.is_finite()) && q.norm() < 2.0 => {
                Ok(Some((frame, Some(PoseReading { position_m, attitude }))))
            }
            _ => Err(Fault::Malformed("NatNet pose")),
        };
    }
    Ok(Some((frame, None)))
}

/// The version in a server's answer; `None` where the datagram is another one.
pub fn decode_server_info(datagram: &[u8]) -> Option<Version> {
    let name_and_application = 256 + 4;
    let version = datagram.get(4 + name_and_application..4 + name_and_application + 4)?;
    (le::u16(datagram, 0) == SERVER_INFO).then_some((version[0], version[1]))
}

/// What a client asks a server with.
pub fn encode_connect() -> Vec<u8> {
    let mut out = CONNECT.to_le_bytes().to_vec();
    out.extend((270_u16).to_le_bytes());
    let mut payload = [0_u8; 270];
    payload.iter_mut().zip(b"plumbline").for_each(|(to, from)| *to = *from);
    // The version that the client would like.
    payload.iter_mut().skip(260).zip([4_u8, 1, 0, 0]).for_each(|(to, from)| *to = from);
    out.extend(payload);
    out
}

/// What a client that is sent frames of its own, not those of a group, says every second or so: a server forgets it otherwise.
pub fn encode_keep_alive() -> [u8; 4] {
    let [low, high] = KEEP_ALIVE.to_le_bytes();
    [low, high, 0, 0]
}

/// Does a client ask?
pub fn is_connect(datagram: &[u8]) -> bool {
    datagram.len() >= 4 && le::u16(datagram, 0) == CONNECT
}

/// A server's answer.
pub fn encode_server_info(version: Version) -> Vec<u8> {
    let mut out = SERVER_INFO.to_le_bytes().to_vec();
    out.extend(279_u16.to_le_bytes());
    let mut payload = [0_u8; 279];
    payload.iter_mut().zip(b"Motive").for_each(|(to, from)| *to = *from);
    payload.iter_mut().skip(256).zip([3_u8, 0, 0, 0, version.0, version.1]).for_each(|(to, from)| *to = from);
    out.extend(payload);
    out
}

/// A frame with one rigid body, as a server of this version sends it.
pub fn encode(frame: i32, version: Version, id: i32, pose: &PoseReading, tracked: bool, time_s: f64) -> Vec<u8> {
    let sized = version >= (4, 1);
    let mut p = frame.to_le_bytes().to_vec();
    let section = |p: &mut Vec<u8>, count: i32, body: &[u8]| {
        p.extend(count.to_le_bytes());
        if sized {
            p.extend((body.len() as i32).to_le_bytes());
        }
        p.extend(body);
    };
    section(&mut p, 0, &[]);
    section(&mut p, 0, &[]);
    let q = pose.attitude;
    let mut body = id.to_le_bytes().to_vec();
    let position = pose.position_m;
    for value in [position.x, position.y, position.z, q.i, q.j, q.k, q.w, 1e-4] {
        body.extend((value as f32).to_le_bytes());
    }
    body.extend(i16::from(tracked).to_le_bytes());
    section(&mut p, 1, &body);
    // Skeletons, (assets from 4.1), labelled markers, force plates, devices.
    for _ in 0..if sized { 5 } else { 4 } {
        section(&mut p, 0, &[]);
    }
    // Time code, its sub-frame, time stamp, then stamps of exposure, receipt and transmission, (precise time), flags, end.
    p.extend([0; 8]);
    p.extend(time_s.to_le_bytes());
    p.extend([0; 24]);
    if sized {
        p.extend([0; 8]);
    }
    p.extend([0; 6]);
    let mut out = FRAME.to_le_bytes().to_vec();
    out.extend((p.len() as u16).to_le_bytes());
    out.extend(p);
    out
}
