//! Ports behind two narrow traits: a stream of bytes, and a bus of registers.
//!
//! | port | what it is |
//! |---|---|
//! | `/dev/ttyUSB0` | serial |
//! | `/dev/i2c-1` | I²C of the kernel |
//! | `/dev/spidev0.0` | SPI of the kernel, one chip |
//! | `unix:/path` | the wire rig's I²C: a socket that carries the same transfers |
//! | `udp:0.0.0.0:1511`, `udp:239.255.42.99:1511` | datagrams; a multicast group is joined |

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::fault::DeviceError;

/// Longest wait of one read; whoever owns the port looks about in between.
pub const WAIT: Duration = Duration::from_millis(50);
/// Longest transfer of the wire rig's bus, and of SPI, bytes.
pub const TRANSFER_MAX: usize = 64;

/// Bytes in order.
pub trait Stream: Send {
    /// Some bytes; 0 when none came within [`WAIT`].
    ///
    /// # Errors
    /// The port is gone.
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize>;

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// The port is gone, or takes no more.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
}

/// Registers of devices that share two wires.
pub trait Bus: Send {
    /// Writes, then reads without letting the bus go.
    ///
    /// # Errors
    /// Nobody answers at `address`, or the bus is gone.
    fn transfer(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> io::Result<()>;
}

/// One chip on SPI: while bytes go out, as many come back.
pub trait Exchange: Send {
    /// Sends `out`; what comes back meanwhile is as long.
    ///
    /// # Errors
    /// The port is gone.
    fn exchange(&mut self, out: &[u8], back: &mut [u8]) -> io::Result<()>;
}

/// Into the first byte, a register: it is read.
const READS: u8 = 0x80;

/// A chip on SPI as a bus of one, whatever its address. The first byte is a register with its highest bit for reading, as of
/// InvenSense, Bosch and ST; those after it are its value and its successors' (MPU-6500 product specification 7.5).
pub struct Spi<E>(pub E);

impl<E: Exchange> Bus for Spi<E> {
    fn transfer(&mut self, _address: u8, write: &[u8], read: &mut [u8]) -> io::Result<()> {
        let mut out = arrayvec::ArrayVec::<u8, TRANSFER_MAX>::new();
        let (written, length) = (write.len(), write.len() + read.len());
        if length > TRANSFER_MAX || out.try_extend_from_slice(write).is_err() {
            return Err(io::Error::new(ErrorKind::InvalidInput, format!("a transfer of {length} bytes, at most 64")));
        }
        if let Some(register) = out.first_mut().filter(|_| !read.is_empty()) {
            *register |= READS;
        }
        out.extend(std::iter::repeat_n(0, read.len()));
        let mut back = [0; TRANSFER_MAX];
        let back = back.get_mut(..length).unwrap_or_default();
        self.0.exchange(&out, back)?;
        read.iter_mut().zip(back.iter().skip(written)).for_each(|(to, from)| *to = *from);
        Ok(())
    }
}

/// What a port's name means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortName {
    /// A serial port's file.
    Serial(String),
    /// The kernel's I²C.
    I2c(String),
    /// The kernel's SPI.
    Spi(String),
    /// The wire rig's I²C.
    Socket(String),
    /// Where datagrams come in.
    Datagrams(SocketAddrV4),
}

impl PortName {
    /// Reads a name; `None` where it means nothing.
    pub fn parse(name: &str) -> Option<Self> {
        if let Some(address) = name.strip_prefix("udp:") {
            return address.parse().ok().map(Self::Datagrams);
        }
        if let Some(path) = name.strip_prefix("unix:") {
            return (!path.is_empty()).then(|| Self::Socket(path.to_owned()));
        }
        let kind = match name.rsplit('/').next() {
            Some(file) if file.starts_with("i2c-") => Self::I2c,
            Some(file) if file.starts_with("spidev") => Self::Spi,
            _ => Self::Serial,
        };
        name.starts_with('/').then(|| kind(name.to_owned()))
    }

    /// Opens it as a bus.
    ///
    /// # Errors
    /// It cannot be opened, or is none.
    pub fn open_bus(&self) -> Result<Box<dyn Bus>, DeviceError> {
        match self {
            Self::I2c(path) => kernel::open(path).map_err(|error| self.error(error)),
            Self::Spi(path) => kernel_spi::open(path).map_err(|error| self.error(error)),
            Self::Socket(path) => {
                let mut socket = Socket { path: path.clone(), open: None };
                socket.open().map_err(|error| self.error(error))?;
                Ok(Box::new(socket))
            }
            _ => Err(self.error(io::Error::new(ErrorKind::InvalidInput, "neither I²C nor SPI"))),
        }
    }

    /// Opens it as a serial port.
    ///
    /// # Errors
    /// It cannot be opened, or is none.
    pub fn open_serial(&self, baud: u32) -> Result<Box<dyn Stream>, DeviceError> {
        Ok(Box::new(Serial(self.serial(baud, WAIT)?)))
    }

    /// The serial port itself, whose writes wait for `room` at most.
    pub(crate) fn serial(&self, baud: u32, room: Duration) -> Result<serial2::SerialPort, DeviceError> {
        let Self::Serial(path) = self else {
            return Err(self.error(io::Error::new(ErrorKind::InvalidInput, "not a serial port")));
        };
        let open = || {
            let mut port = serial2::SerialPort::open(path, baud)?;
            port.set_read_timeout(WAIT)?;
            port.set_write_timeout(room)?;
            port.discard_buffers()?;
            Ok(port)
        };
        open().map_err(|error| self.error(error))
    }

    /// Opens it for datagrams.
    ///
    /// # Errors
    /// It cannot be opened, or is none.
    pub fn open_datagrams(&self) -> Result<UdpSocket, DeviceError> {
        let Self::Datagrams(address) = self else {
            return Err(self.error(io::Error::new(ErrorKind::InvalidInput, "not a place for datagrams")));
        };
        let open = || {
            if !address.ip().is_multicast() {
                return UdpSocket::bind(address);
            }
            let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, address.port()))?;
            socket.join_multicast_v4(address.ip(), &Ipv4Addr::UNSPECIFIED)?;
            Ok(socket)
        };
        let socket = open().map_err(|error| self.error(error))?;
        socket.set_read_timeout(Some(WAIT)).map_err(|error| self.error(error))?;
        Ok(socket)
    }

    /// `source` as an error of this port.
    pub fn error(&self, source: io::Error) -> DeviceError {
        let group = match self {
            Self::Serial(_) => Some("dialout"),
            Self::I2c(_) => Some("i2c"),
            Self::Spi(_) => Some("spi"),
            Self::Socket(_) | Self::Datagrams(_) => None,
        };
        let source = match group {
            Some(group) if source.kind() == ErrorKind::PermissionDenied => {
                io::Error::new(source.kind(), format!("{source}: the user has to be in the group {group}"))
            }
            _ => source,
        };
        DeviceError::Port { port: self.to_string(), source }
    }
}

impl std::fmt::Display for PortName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Serial(path) | Self::I2c(path) | Self::Spi(path) => f.write_str(path),
            Self::Socket(path) => write!(f, "unix:{path}"),
            Self::Datagrams(address) => write!(f, "udp:{address}"),
        }
    }
}

/// Serial ports of this machine.
pub fn serial_ports() -> Vec<std::path::PathBuf> {
    serial2::SerialPort::available_ports().unwrap_or_default()
}

/// I²C buses of this machine, and its chips on SPI.
pub fn buses() -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten().map(|entry| entry.path());
    let is_bus = |path: &std::path::PathBuf| {
        matches!(PortName::parse(&path.to_string_lossy()), Some(PortName::I2c(_) | PortName::Spi(_)))
    };
    let mut all: Vec<_> = entries.filter(is_bus).collect();
    all.sort();
    all
}

/// Did nothing come in time?
pub fn timed_out(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

struct Serial(serial2::SerialPort);

impl Stream for Serial {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        some_of(&self.0, into)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }
}

/// Some bytes of a serial port; 0 when none came in time.
pub(crate) fn some_of(port: &serial2::SerialPort, into: &mut [u8]) -> io::Result<usize> {
    match port.read(into) {
        // A serial port has no end but its own.
        Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "unplugged")),
        Err(error) if timed_out(&error) => Ok(0),
        other => other,
    }
}

/// The kernel's I²C.
#[cfg(feature = "i2c")]
mod kernel {
    use std::io;

    use i2cdev::core::{I2CMessage as _, I2CTransfer as _};
    use i2cdev::linux::{LinuxI2CBus, LinuxI2CMessage};

    struct Kernel(LinuxI2CBus);

    pub fn open(path: &str) -> io::Result<Box<dyn super::Bus>> {
        Ok(Box::new(Kernel(LinuxI2CBus::new(path).map_err(io::Error::from)?)))
    }

    impl super::Bus for Kernel {
        fn transfer(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> io::Result<()> {
            let to = LinuxI2CMessage::write(write).with_address(address.into());
            let done = if read.is_empty() {
                self.0.transfer(&mut [to])
            } else {
                self.0.transfer(&mut [to, LinuxI2CMessage::read(read).with_address(address.into())])
            };
            done.map(drop).map_err(io::Error::from)
        }
    }
}

#[cfg(not(feature = "i2c"))]
mod kernel {
    use std::io;

    pub fn open(_path: &str) -> io::Result<Box<dyn super::Bus>> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "built without I²C: build with --features i2c"))
    }
}

/// The kernel's SPI: mode 3 and 1 MHz, which every register of these chips bears (a burst of theirs takes 0.12 ms).
#[cfg(feature = "spi")]
mod kernel_spi {
    use std::io;

    use spidev::{SpiModeFlags, Spidev, SpidevOptions, SpidevTransfer};

    const CLOCK_HZ: u32 = 1_000_000;

    struct Kernel(Spidev);

    pub fn open(path: &str) -> io::Result<Box<dyn super::Bus>> {
        let mut device = Spidev::open(path)?;
        let options =
            SpidevOptions::new().bits_per_word(8).max_speed_hz(CLOCK_HZ).mode(SpiModeFlags::SPI_MODE_3).build();
        device.configure(&options)?;
        Ok(Box::new(super::Spi(Kernel(device))))
    }

    impl super::Exchange for Kernel {
        fn exchange(&mut self, out: &[u8], back: &mut [u8]) -> io::Result<()> {
            self.0.transfer(&mut SpidevTransfer::read_write(out, back))
        }
    }
}

#[cfg(not(feature = "spi"))]
mod kernel_spi {
    use std::io;

    pub fn open(_path: &str) -> io::Result<Box<dyn super::Bus>> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "built without SPI: build with --features spi"))
    }
}

/// Address, bytes to write, bytes to read, what is written; the answer is 0 and what was read, or another number.
struct Socket {
    path: String,
    /// None once a transfer has failed: its answer may still come, and is none to the next one.
    open: Option<UnixStream>,
}

impl Socket {
    fn open(&mut self) -> io::Result<&mut UnixStream> {
        let open = match self.open.take() {
            Some(open) => open,
            None => {
                let new = UnixStream::connect(&self.path)?;
                new.set_read_timeout(Some(WAIT))?;
                new
            }
        };
        Ok(self.open.insert(open))
    }
}

impl Bus for Socket {
    fn transfer(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> io::Result<()> {
        let mut request = arrayvec::ArrayVec::<u8, { TRANSFER_MAX + 3 }>::new();
        let long = || io::Error::new(ErrorKind::InvalidInput, "a transfer longer than 64 bytes");
        request.try_extend_from_slice(&[address, write.len() as u8, read.len() as u8]).map_err(|_| long())?;
        request.try_extend_from_slice(write).map_err(|_| long())?;
        let socket = self.open()?;
        let mut status = [0];
        let mut answer = || {
            socket.write_all(&request)?;
            socket.read_exact(&mut status)?;
            if status == [0] { socket.read_exact(read) } else { Ok(()) }
        };
        if let Err(error) = answer() {
            self.open = None;
            return Err(error);
        }
        if status != [0] {
            return Err(io::Error::new(ErrorKind::NotFound, format!("nobody answers at address {address:#x}")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_they_are() {
        assert_eq!(PortName::parse("/dev/ttyUSB0"), Some(PortName::Serial("/dev/ttyUSB0".into())));
        assert_eq!(PortName::parse("/dev/i2c-1"), Some(PortName::I2c("/dev/i2c-1".into())));
        assert_eq!(PortName::parse("/dev/spidev0.1"), Some(PortName::Spi("/dev/spidev0.1".into())));
        assert_eq!(PortName::parse("unix:/tmp/bus").unwrap().to_string(), "unix:/tmp/bus");
        assert!(
            matches!(PortName::parse("udp:239.255.42.99:1511"), Some(PortName::Datagrams(a)) if a.ip().is_multicast())
        );
        for wrong in ["", "ttyUSB0", "udp:", "udp:1511", "unix:", "COM1"] {
            assert_eq!(PortName::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn who_may_not_open_a_port_is_told_its_group() {
        let denied = || io::Error::from_raw_os_error(13);
        for (name, group) in [("/dev/ttyUSB0", "dialout"), ("/dev/i2c-1", "i2c"), ("/dev/spidev0.0", "spi")] {
            let error = PortName::parse(name).unwrap().error(denied()).to_string();
            assert!(error.starts_with(&format!("{name}: Permission denied")), "{error}");
            assert!(error.ends_with(&format!("the user has to be in the group {group}")), "{error}");
        }
        let absent = io::Error::from_raw_os_error(2);
        assert!(!PortName::parse("/dev/ttyUSB0").unwrap().error(absent).to_string().contains("group"));
    }

    #[test]
    fn a_port_that_cannot_be_opened_is_named() {
        let error = PortName::parse("/nowhere/ttyUSB9").unwrap().open_serial(115_200).err().unwrap();
        assert!(error.to_string().starts_with("/nowhere/ttyUSB9: "), "{error}");
        let error = PortName::parse("/dev/null").unwrap().open_bus().err().unwrap();
        assert!(error.to_string().contains("neither I²C nor SPI"), "{error}");
    }

    /// A chip that counts up from its register, and keeps what went over the wires.
    #[derive(Default)]
    struct Wires(Vec<Vec<u8>>);

    impl Exchange for Wires {
        fn exchange(&mut self, out: &[u8], back: &mut [u8]) -> io::Result<()> {
            assert_eq!(out.len(), back.len(), "as many come back");
            self.0.push(out.to_vec());
            back.iter_mut().zip(0..).for_each(|(to, at)| *to = at);
            Ok(())
        }
    }

    #[test]
    fn registers_on_spi_are_read_in_one_burst_with_their_highest_bit_set() {
        let mut bus = Spi(Wires::default());
        let (mut burst, mut one) = ([0; 14], [0]);
        bus.transfer(0x68, &[0x3B], &mut burst).unwrap();
        bus.transfer(0x68, &[0x75], &mut one).unwrap();
        bus.transfer(0x68, &[0x6B, 0x01], &mut []).unwrap();
        let read = [&[0xBB][..], &[0; 14]].concat();
        assert_eq!(bus.0.0, [read, vec![0xF5, 0], vec![0x6B, 0x01]], "no address, no read bit in what is written");
        // What comes back with the register's own byte is none of its value.
        assert_eq!((burst, one), (std::array::from_fn(|at| at as u8 + 1), [1]));
        let long = bus.transfer(0, &[0x3B], &mut [0; 64]).unwrap_err().to_string();
        assert_eq!(long, "a transfer of 65 bytes, at most 64");
    }
}
