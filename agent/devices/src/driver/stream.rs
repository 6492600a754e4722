//! Devices that talk without being asked: TFmini, Mongoose, GNSS.

use std::time::Instant;

use super::{Driver, Heard, Outlet};
use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::framer::{Framer, Protocol};
use crate::port::{PortName, Stream};
use crate::protocol::gnss::{GnssReading, GnssStream};
use crate::protocol::mongoose::{Mongoose, MongooseReading};
use crate::protocol::tfmini::TfMini;
use crate::reading::Reading;

/// So many bytes without one frame are another device, or another baud rate: a few frames, and less than comes while one that
/// is silent is waited for.
const STRANGE_BYTES: u64 = 384;

/// A protocol whose frames are readings.
pub trait Spoken: Protocol + Default + Send {
    /// For people, with the usual baud rate.
    const NAME: &'static str;

    /// Shows the readings of a frame, with the device's stamp.
    fn readings(frame: Self::Reading, each: &mut dyn FnMut(Option<Stamp>, Reading));
}

impl Spoken for TfMini {
    const NAME: &'static str = "a TFmini (115200 baud)";
    fn readings(frame: Reading, each: &mut dyn FnMut(Option<Stamp>, Reading)) {
        each(None, frame);
    }
}

impl Spoken for Mongoose {
    const NAME: &'static str = "a Mongoose (115200 baud)";
    fn readings(frame: MongooseReading, each: &mut dyn FnMut(Option<Stamp>, Reading)) {
        let stamp = Stamp { ticks: frame.stamp_us.into(), tick_us: 1.0, roll_over: 1 << 32 };
        each(Some(stamp), Reading::Imu(frame.imu));
        each(Some(stamp), Reading::Barometer(frame.barometer));
    }
}

impl Spoken for GnssStream {
    const NAME: &'static str = "a GNSS receiver (UBX or NMEA; 9600 or 38400 baud)";
    fn readings(frame: GnssReading, each: &mut dyn FnMut(Option<Stamp>, Reading)) {
        if let GnssReading::Fix { stamp_ms, roll_over_ms, fix } = frame {
            let stamp = Stamp { ticks: stamp_ms.into(), tick_us: 1e3, roll_over: roll_over_ms.into() };
            each(Some(stamp), Reading::Fix(fix));
        }
    }
}

/// A device of protocol `P` on a serial port.
pub struct Talker<P> {
    port: PortName,
    baud: u32,
    framer: Framer<P>,
    open: Option<Box<dyn Stream>>,
    frames: u64,
    /// A frame came since that was asked.
    speaks: bool,
}

impl<P: Spoken> Talker<P> {
    /// On `port`, closed.
    pub fn new(port: PortName, baud: u32) -> Self {
        Self { port, baud, framer: Framer::new(P::default()), open: None, frames: 0, speaks: false }
    }
}

impl<P: Spoken> Driver for Talker<P> {
    fn open(&mut self) -> Result<(), DeviceError> {
        // What the protocol has learnt of the device goes, too: one that lost its power may have begun anew.
        self.framer = Framer::new(P::default());
        self.frames = 0;
        self.open = Some(self.port.open_serial(self.baud)?);
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let Some(port) = &mut self.open else { return Ok(()) };
        let mut bytes = [0; 512];
        let count = port.read(&mut bytes).map_err(|error| self.port.error(error))?;
        let (at, skipped) = (Instant::now(), self.framer.skipped());
        let (frames, speaks) = (&mut self.frames, &mut self.speaks);
        self.framer.push(bytes.get(..count).unwrap_or_default(), |frame| match frame {
            Ok(frame) => {
                *frames += 1;
                *speaks = true;
                P::readings(frame, &mut |stamp, reading| out(Ok(Heard { at, stamp, after_us: 0.0, reading })));
            }
            Err(fault) => out(Err(fault)),
        });
        if self.framer.skipped() > skipped && self.frames > 0 {
            out(Err(Fault::Malformed("bytes between frames")));
        }
        let strange = self.framer.skipped();
        if self.frames == 0 && strange > STRANGE_BYTES {
            let value = format!("{strange} bytes without a frame at {} baud", self.baud);
            return Err(DeviceError::Wrong { what: "what speaks", value, expected: P::NAME });
        }
        Ok(())
    }

    fn speaks(&mut self) -> bool {
        std::mem::take(&mut self.speaks)
    }

    fn close(&mut self) {
        self.open = None;
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsRawFd as _;

    use nalgebra::Vector3;

    use super::*;
    use crate::protocol::{nmea, ubx};
    use crate::reading::FixReading;

    /// GIVEN a receiver that spoke UBX WHEN its port is opened again and it speaks NMEA, as after a loss of its power THEN its fixes
    /// count, and what it says without one is a sign of life.
    #[test]
    fn a_receiver_that_comes_back_with_nmea_is_read() {
        let (own, other) = serial2::SerialPort::pair().unwrap();
        let path = std::fs::read_link(format!("/proc/self/fd/{}", other.as_raw_fd())).unwrap();
        let mut receiver = Talker::<GnssStream>::new(PortName::parse(path.to_str().unwrap()).unwrap(), 38_400);
        let fix = FixReading {
            geodetic: [47.5, 8.75, 400.0],
            velocity_enu_mps: Vector3::zeros(),
            horizontal_sigma_m: 1.25,
            vertical_sigma_m: 2.5,
            satellites: 11,
        };
        let nmea = nmea::encode(43_200.0, &fix);
        let motion = nmea.split_inclusive('\n').next().unwrap();
        for (sent, fixes) in [(&ubx::encode_nav_pvt(1000, &fix)[..], 1), (motion.as_bytes(), 0), (nmea.as_bytes(), 1)] {
            receiver.open().unwrap();
            own.write_all(sent).unwrap();
            let mut found = 0;
            for _ in 0..100 {
                receiver.poll(&mut |heard| found += usize::from(heard.is_ok())).unwrap();
                if receiver.speaks() && found == fixes {
                    break;
                }
            }
            assert_eq!(found, fixes, "{}", String::from_utf8_lossy(sent));
            assert!(!receiver.speaks(), "told once");
        }
    }
}
