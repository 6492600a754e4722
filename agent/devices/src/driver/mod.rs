//! A device on its port: opens, identifies, sets up, then polls. Whoever polls is a thread of its own and may wait.

pub mod bno055;
pub mod hokuyo;
pub mod invensense;
pub mod mavlink;
pub mod mocap;
pub mod registers;
pub mod stream;

use std::time::{Duration, Instant};

use arrayvec::ArrayVec;

use crate::clock::Stamp;
use crate::fault::{DeviceError, Fault};
use crate::protocol::scip;
use crate::reading::Reading;

/// A reading as it came in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heard {
    /// When its last byte was there.
    pub at: Instant,
    /// The device's own time of it.
    pub stamp: Option<Stamp>,
    /// It was measured so long after that stamp (or before its arrival, where there is none), µs.
    pub after_us: f64,
    /// What it says.
    pub reading: Reading,
}

/// A question about its clock that a device answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchange {
    /// When it was asked.
    pub asked: Instant,
    /// When the answer was there.
    pub answered: Instant,
    /// The device's own time between the two.
    pub stamp: Stamp,
}

/// A whole scan as it came in.
#[derive(Debug, Clone, PartialEq)]
pub struct Scanned {
    /// When its last byte was there.
    pub at: Instant,
    /// The scanner's own time, ms.
    pub stamp_ms: u32,
    /// From the first step on, mm; small ones are error codes.
    pub ranges_mm: ArrayVec<u16, { scip::RANGES }>,
}

/// Takes what a driver hears.
pub type Outlet<'a> = dyn FnMut(Result<Heard, Fault>) + 'a;

/// One device.
pub trait Driver: Send {
    /// Opens the port, makes sure that the right device answers, sets it up. After an error, or a loss, called again.
    ///
    /// # Errors
    /// The port, another device, another protocol version, no answer.
    fn open(&mut self) -> Result<(), DeviceError>;

    /// Time between two questions to a device that says nothing by itself; `None`: it speaks when it wants to.
    fn period(&self) -> Option<Duration> {
        None
    }

    /// Hands over what comes within about [`crate::port::WAIT`]; asks first, where there is a [`Driver::period`].
    ///
    /// # Errors
    /// The device is to be opened again.
    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError>;

    /// Did it say something since this was asked last that is neither a reading nor a fault?
    fn speaks(&mut self) -> bool {
        false
    }

    /// A question that was answered since this was asked last.
    fn exchange(&mut self) -> Option<Exchange> {
        None
    }

    /// The scan of the last poll, if it had one.
    fn scan(&mut self) -> Option<Scanned> {
        None
    }

    /// Lets the device rest and the port go.
    fn close(&mut self) {}
}
