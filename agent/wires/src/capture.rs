//! Motion capture as its servers send it: OptiTrack's frames once they are asked for, Vicon's always.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use plumbline_core::sensor::MocapPoseSample;
use plumbline_devices::protocol::{natnet, vicon};
use plumbline_devices::reading::PoseReading;

use crate::wiring::{BODY, CAPTURED, Speaks};
use crate::{Measured, Plug, body_from_sensor};

/// A client that says nothing for so long is forgotten.
const FORGOTTEN: Duration = Duration::from_secs(3);
/// Of the protocol.
const VERSION: natnet::Version = (4, 1);

/// A server of motion capture.
pub struct Capture {
    speaks: Speaks,
    socket: UdpSocket,
    /// Where frames go, and when that client was last heard.
    to: Option<SocketAddr>,
    heard: Instant,
    /// Length of a frame, µs.
    period_us: f64,
}

impl Capture {
    /// On a port of its own on the loopback; frames of Vicon go to `agent`, as that is where it was told to send them.
    pub fn new(speaks: Speaks, agent: u16, rate_hz: f64) -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.set_nonblocking(true)?;
        let to = (speaks == Speaks::Vicon).then(|| (Ipv4Addr::LOCALHOST, agent).into());
        Ok(Self { speaks, socket, to, heard: Instant::now(), period_us: 1e6 / rate_hz })
    }

    /// Its port.
    pub fn port(&self) -> io::Result<u16> {
        Ok(self.socket.local_addr()?.port())
    }

    /// Until `stop`. Plugged out it sends nothing and answers nobody; hanging it has lost its body.
    pub fn run(mut self, inlet: &Receiver<Measured>, plug: &AtomicU8, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            let state = plug.load(Ordering::Acquire);
            let mut asked = [0; 512];
            while let Ok((count, from)) = self.socket.recv_from(&mut asked) {
                self.heard = Instant::now();
                let connects = natnet::is_connect(asked.get(..count).unwrap_or_default());
                if self.speaks == Speaks::Natnet && connects && state != Plug::Out as u8 {
                    self.to = Some(from);
                    let _ = self.socket.send_to(&natnet::encode_server_info(VERSION), from);
                }
            }
            if self.speaks == Speaks::Natnet && self.heard.elapsed() > FORGOTTEN {
                self.to = None;
            }
            match inlet.recv_timeout(Duration::from_millis(5)) {
                Ok(measured) if state != Plug::Out as u8 => self.send(&measured, state == Plug::In as u8),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn send(&self, measured: &Measured, tracked: bool) {
        let (Some(sample), Some(to)) = (measured.frame.mocap_pose, self.to) else { return };
        let frame = (sample.time.0 as f64 / self.period_us).round();
        let (id, object) = BODY;
        let datagram = match self.speaks {
            Speaks::Vicon => vicon::encode(frame as u32, object, &seen(&sample, false, tracked)),
            _ => {
                let pose = seen(&sample, true, tracked);
                natnet::encode(frame as i32, VERSION, id, &pose, tracked, sample.time.as_seconds())
            }
        };
        let _ = self.socket.send_to(&datagram, to);
    }
}

/// The pose of the body's pivot as the system has it, whose y axis is up or whose z axis is; all zero where it is hidden.
fn seen(sample: &MocapPoseSample, y_up: bool, tracked: bool) -> PoseReading {
    if !tracked {
        return PoseReading { position_m: Vector3::zeros(), attitude: UnitQuaternion::identity() };
    }
    let [arm_flu_m, rpy_rad] = CAPTURED.map(Vector3::from);
    let body_from_pivot: Rotation3<f64> = body_from_sensor(&rpy_rad);
    let quarter = if y_up { -std::f64::consts::FRAC_PI_2 } else { 0.0 };
    let system_from_world = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), quarter);
    let position_enu_m = sample.position_enu_m + sample.world_from_body * arm_flu_m;
    let attitude = sample.world_from_body * UnitQuaternion::from_rotation_matrix(&body_from_pivot);
    PoseReading { position_m: system_from_world * position_enu_m, attitude: system_from_world * attitude }
}
