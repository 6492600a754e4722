//! Motion capture over UDP: OptiTrack NatNet and Vicon.

use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::{Driver, Heard, Outlet};
use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::port::{PortName, timed_out};
use crate::protocol::natnet::{self, Version};
use crate::protocol::vicon;
use crate::reading::Reading;

/// Longest wait for a server's answer.
const PATIENCE: Duration = Duration::from_millis(500);
/// How often a server is told that somebody listens still.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// Largest datagram.
const DATAGRAM: usize = 65_536;

/// Which system, and which of its bodies.
#[derive(Debug, Clone, PartialEq)]
pub enum System {
    /// OptiTrack.
    NatNet {
        /// Its command port, asked for the version of the protocol.
        server: SocketAddr,
        /// Streaming id of the rigid body.
        id: i32,
        /// Frames a second: the frame number is the clock.
        rate_hz: f64,
    },
    /// Vicon.
    Vicon {
        /// Name of the object.
        object: String,
        /// Frames a second.
        rate_hz: f64,
    },
}

/// The stream of one system.
pub struct Mocap {
    port: PortName,
    system: System,
    version: Version,
    alive_due: Instant,
    socket: Option<UdpSocket>,
    datagram: Box<[u8; DATAGRAM]>,
}

impl Mocap {
    /// On `port`, closed.
    pub fn new(port: PortName, system: System) -> Self {
        Self {
            port,
            system,
            version: natnet::OLDEST,
            alive_due: Instant::now(),
            socket: None,
            datagram: Box::new([0; DATAGRAM]),
        }
    }

    fn version_of(&mut self, socket: &UdpSocket, server: SocketAddr) -> Result<Version, DeviceError> {
        socket.send_to(&natnet::encode_connect(), server).map_err(|error| self.port.error(error))?;
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            match socket.recv(self.datagram.as_mut()) {
                Ok(count) => {
                    if let Some(version) = self.datagram.get(..count).and_then(natnet::decode_server_info) {
                        return Ok(version);
                    }
                }
                Err(error) if timed_out(&error) => {}
                Err(error) => return Err(self.port.error(error)),
            }
        }
        Err(DeviceError::Silent { what: "answer of a NatNet server", seconds: PATIENCE.as_secs_f64() })
    }
}

impl Driver for Mocap {
    fn open(&mut self) -> Result<(), DeviceError> {
        let socket = self.port.open_datagrams()?;
        if let System::NatNet { server, .. } = self.system {
            self.version = self.version_of(&socket, server)?;
            if self.version < natnet::OLDEST || self.version.0 > 4 {
                let value = format!("{}.{}", self.version.0, self.version.1);
                return Err(DeviceError::Wrong { what: "NatNet version", value, expected: "3.0 to 4.x" });
            }
        }
        self.socket = Some(socket);
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let Some(socket) = &self.socket else { return Ok(()) };
        if let System::NatNet { server, .. } = self.system
            && Instant::now() >= self.alive_due
        {
            self.alive_due = Instant::now() + KEEP_ALIVE;
            socket.send_to(&natnet::encode_keep_alive(), server).map_err(|error| self.port.error(error))?;
        }
        let count = match socket.recv(self.datagram.as_mut()) {
            Ok(count) => count,
            Err(error) if timed_out(&error) => return Ok(()),
            Err(error) => return Err(self.port.error(error)),
        };
        let at = Instant::now();
        let datagram = self.datagram.get(..count).unwrap_or_default();
        let (frame, rate_hz) = match &self.system {
            System::NatNet { id, rate_hz, .. } => {
                let frame = natnet::decode(datagram, self.version, *id);
                (frame.map(|frame| frame.map(|(number, pose)| (number as u32, pose))), *rate_hz)
            }
            System::Vicon { object, rate_hz } => (vicon::decode(datagram, object).map(Some), *rate_hz),
        };
        match frame {
            Err(fault) => out(Err(fault)),
            Ok(Some((number, Some(pose)))) => {
                let stamp = Stamp { ticks: number.into(), tick_us: 1e6 / rate_hz, roll_over: 1 << 32 };
                out(Ok(Heard { at, stamp: Some(stamp), after_us: 0.0, reading: Reading::Pose(pose) }));
            }
            Ok(Some((_, None))) => out(Err(Fault::Malformed("pose: the body is not tracked"))),
            Ok(None) => {}
        }
        Ok(())
    }

    fn close(&mut self) {
        self.socket = None;
    }
}
