//! The rings that carry encoded frames away from the flight thread.

use plumbline_proto::codec::{FRAME_HEADER, encode_message};
use plumbline_proto::time::FlightTime;
use plumbline_proto::{Kind, Message};
use rtrb::Producer;

/// Room for any message of a tick; a larger one makes the buffer grow once.
const SCRATCH_BYTES: usize = 64 << 10;

/// One ring. Frames are written whole or not at all, and never waited for.
#[derive(Debug)]
pub struct Outlet {
    ring: Producer<u8>,
    refused: u64,
}

impl Outlet {
    /// Writes into `ring`.
    pub fn new(ring: Producer<u8>) -> Self {
        Self { ring, refused: 0 }
    }

    fn write(&mut self, frame: &[u8]) {
        self.refused += u64::from(self.ring.push_entire_slice(frame).is_err());
    }
}

/// Both rings and the sequence that runs through them.
#[derive(Debug)]
pub(super) struct Outlets {
    link: Option<Outlet>,
    log: Option<Outlet>,
    /// Is a flight open, so that the log wants it?
    pub recording: bool,
    sequence: u64,
    scratch: Vec<u8>,
}

impl Outlets {
    pub(super) fn new(link: Option<Outlet>, log: Option<Outlet>) -> Self {
        let scratch = Vec::with_capacity(SCRATCH_BYTES + FRAME_HEADER);
        Self { link, log, recording: false, sequence: 0, scratch }
    }

    /// Encodes once, writes the same bytes into both rings.
    pub(super) fn send<M: Message>(&mut self, kind: Kind, instance: u16, time: FlightTime, message: &M) {
        self.sequence += 1;
        self.scratch.clear();
        encode_message(&mut self.scratch, kind, instance, self.sequence, time.0, message);
        if let Some(link) = &mut self.link {
            link.write(&self.scratch);
        }
        if self.recording
            && let Some(log) = &mut self.log
        {
            log.write(&self.scratch);
        }
    }

    pub(super) fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Bytes that the ring of the log still takes; `None` where nothing is being logged.
    pub(super) fn log_room(&self) -> Option<usize> {
        self.log.as_ref().filter(|_| self.recording).map(|log| log.ring.slots())
    }

    /// Messages refused by each ring: radio, log.
    pub(super) fn refused(&self) -> (u64, u64) {
        let of = |outlet: &Option<Outlet>| outlet.as_ref().map_or(0, |outlet| outlet.refused);
        (of(&self.link), of(&self.log))
    }
}
