//! Where an autopilot's bytes come and go: a serial port, or datagrams.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use crate::fault::DeviceError;
use crate::port::{PortName, some_of, timed_out};

/// Longest that a frame waits for room.
const ROOM: Duration = Duration::from_millis(1);

/// An open port.
#[derive(Debug)]
pub(crate) enum Wire {
    Serial(serial2::SerialPort),
    Datagrams(UdpSocket),
}

impl Wire {
    /// Opens `port`, at `baud` where it is a serial one.
    pub fn open(port: &PortName, baud: u32) -> Result<Self, DeviceError> {
        if matches!(port, PortName::Serial(_)) {
            return port.serial(baud, ROOM).map(Self::Serial);
        }
        let socket = port.open_datagrams()?;
        socket.set_write_timeout(Some(ROOM)).map_err(|error| port.error(error))?;
        Ok(Self::Datagrams(socket))
    }

    /// Some bytes, or one datagram and its sender; 0 bytes when none came in time.
    pub fn read(&self, into: &mut [u8]) -> io::Result<(usize, Option<SocketAddr>)> {
        match self {
            Self::Serial(port) => some_of(port, into).map(|count| (count, None)),
            Self::Datagrams(socket) => match socket.recv_from(into) {
                Ok((count, from)) => Ok((count, Some(from))),
                // Nobody listens there just now.
                Err(error) if timed_out(&error) || error.kind() == ErrorKind::ConnectionRefused => Ok((0, None)),
                Err(error) => Err(error),
            },
        }
    }

    /// Does a read give whole frames only?
    pub fn is_datagrams(&self) -> bool {
        matches!(self, Self::Datagrams(_))
    }

    /// From here on nobody but `peer` is heard, nor spoken to.
    pub fn keep_to(&self, peer: Option<SocketAddr>) -> io::Result<()> {
        match (self, peer) {
            (Self::Datagrams(socket), Some(peer)) => socket.connect(peer),
            _ => Ok(()),
        }
    }

    /// Writes a frame. What finds no room is given up, as a whole or its end: the next one is read again.
    pub fn write(&self, frame: &[u8]) {
        let _ = match self {
            Self::Serial(port) => port.write(frame),
            // Fails while there is nobody yet.
            Self::Datagrams(socket) => socket.send(frame),
        };
    }
}
