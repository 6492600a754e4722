//! Hokuyo URG-04LX on its serial port (USB), looking down.

use std::time::{Duration, Instant};

use arrayvec::ArrayVec;

use super::{Driver, Heard, Outlet, Scanned};
use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::framer::Framer;
use crate::port::{PortName, Stream};
use crate::protocol::scan_height;
use crate::protocol::scip::{self, FRONT_STEP, ROLL_OVER_MS, STEPS, STEPS_PER_TURN, Scip, ScipReading};
use crate::reading::{RangeReading, Reading};

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_millis(600);
/// Length of a turn at 600 rpm, µs.
const TURN_US: f64 = 100e3;
/// How long after the front the last step is measured, µs. The stamp is the turn's begin; a scan is sent when it is whole, so its
/// shortest way, which a clock takes for none, ends there.
const AFTER_FRONT_US: f64 = TURN_US * (*STEPS.end() - FRONT_STEP) as f64 / STEPS_PER_TURN as f64;

/// The scanner.
pub struct Hokuyo {
    port: PortName,
    framer: Framer<Scip>,
    open: Option<Box<dyn Stream>>,
    /// When the scan of the last poll was there, and its stamp, ms.
    scanned: Option<(Instant, u32)>,
}

impl Hokuyo {
    /// On `port`, closed.
    pub fn new(port: PortName) -> Self {
        Self { port, framer: Framer::new(Scip::default()), open: None, scanned: None }
    }

    /// Ranges of the last scan, mm, from step 44 on.
    pub fn ranges(&self) -> &[u16] {
        self.framer.protocol().ranges()
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let Some(port) = &mut self.open else { return Ok(()) };
        port.write(bytes).map_err(|error| self.port.error(error))
    }

    /// The next block, if one comes within one wait.
    fn block(&mut self) -> Result<Option<Result<ScipReading, Fault>>, DeviceError> {
        if let Some(block) = self.framer.next() {
            return Ok(Some(block));
        }
        let Some(port) = &mut self.open else { return Ok(None) };
        let mut bytes = [0; 2048];
        let count = port.read(&mut bytes).map_err(|error| self.port.error(error))?;
        // The framer has just run dry: it has room for more than a read.
        let _ = self.framer.fill(bytes.get(..count).unwrap_or_default());
        Ok(self.framer.next())
    }

    /// Asks, and waits for the answer that `fits`.
    fn ask(&mut self, command: &[u8], fits: impl Fn(ScipReading) -> Option<u8>) -> Result<u8, DeviceError> {
        self.write(command)?;
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(Ok(reading)) = self.block()?
                && let Some(status) = fits(reading)
            {
                return Ok(status);
            }
        }
        Err(DeviceError::Silent { what: "answer in SCIP 2.0", seconds: PATIENCE.as_secs_f64() })
    }
}

fn reply_to(command: [u8; 2]) -> impl Fn(ScipReading) -> Option<u8> {
    move |reading| match reading {
        ScipReading::Reply(to, status) if to == command => Some(status),
        ScipReading::Info(to) if to == command => Some(0),
        _ => None,
    }
}

impl Driver for Hokuyo {
    fn open(&mut self) -> Result<(), DeviceError> {
        self.framer.clear();
        self.open = Some(self.port.open_serial(115_200)?);
        // It may stream still, or speak SCIP 1.1 yet: neither answer is waited for.
        self.write(scip::SCIP_2)?;
        self.ask(scip::QUIT, reply_to(*b"QT"))?;
        self.ask(scip::VERSION, reply_to(*b"VV"))?;
        let info = |key: &str| self.framer.protocol().info(key).unwrap_or("absent").to_owned();
        for (key, what, expected) in
            [("PROT", "protocol", "SCIP 2.0"), ("PROD", "product", "URG-04LX, with 682 steps of a turn of 1024")]
        {
            let (value, wanted) = (info(key), expected.split(',').next().unwrap_or(expected));
            if !value.contains(wanted) {
                return Err(DeviceError::Wrong { what, value, expected });
            }
        }
        // 2: it is on already.
        let status = self.ask(scip::LASER_ON, reply_to(*b"BM"))?;
        if !matches!(status, 0 | 2) {
            return Err(Fault::Reported { what: "laser status", code: status.into() }.into());
        }
        let status = self.ask(scip::STREAM, reply_to(*b"MD"))?;
        if status != 0 {
            return Err(Fault::Reported { what: "streaming status", code: status.into() }.into());
        }
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        match self.block()? {
            None => {}
            Some(Err(fault)) => out(Err(fault)),
            Some(Ok(ScipReading::Scan { stamp_ms })) => {
                let at = Instant::now();
                self.scanned = Some((at, stamp_ms));
                let stamp = Stamp { ticks: stamp_ms.into(), tick_us: 1e3, roll_over: ROLL_OVER_MS.into() };
                let after_us = -AFTER_FRONT_US;
                out(scan_height::fit(self.ranges()).map(|height| Heard {
                    at,
                    stamp: Some(stamp),
                    after_us,
                    reading: Reading::Range(RangeReading {
                        distance_m: height.distance_m,
                        scanned: true,
                        sigma_m: height.sigma_m,
                    }),
                }));
            }
            // Streaming has been refused since.
            Some(Ok(ScipReading::Reply([b'M', _], code))) if code != 0 => {
                return Err(Fault::Reported { what: "streaming status", code: code.into() }.into());
            }
            Some(Ok(_)) => {}
        }
        Ok(())
    }

    fn scan(&mut self) -> Option<Scanned> {
        let (at, stamp_ms) = self.scanned.take()?;
        Some(Scanned { at, stamp_ms, ranges_mm: ArrayVec::try_from(self.ranges()).ok()? })
    }

    fn close(&mut self) {
        let _ = self.write(scip::QUIT);
        self.open = None;
    }
}
