//! Frames in a stream of bytes.
//!
//! A protocol says of the bytes at hand what they begin with; the framer keeps them in a fixed buffer and moves on. A frame
//! that fails its check costs its first byte only, so that what follows it, or hides in it, is found: after garbage no
//! valid frame is lost that is not itself damaged. Nothing is allocated.

use crate::fault::Fault;

/// What the bytes at hand begin with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scan<R> {
    /// So many bytes (at least 1) that belong to no frame.
    Skip(usize),
    /// What may become a frame, or nothing.
    More,
    /// So many bytes (at least 1) that are dealt with, and what they say.
    Frame(usize, Result<R, Fault>),
}

/// Reads one device's bytes. Pure: the same bytes, in whatever pieces, give the same results.
pub trait Protocol {
    /// What a frame says.
    type Reading;
    /// The longest frame, bytes.
    const LONGEST: usize;

    /// What `bytes` (never empty) begin with. With [`Protocol::LONGEST`] bytes at hand [`Scan::More`] means garbage.
    fn scan(&mut self, bytes: &[u8]) -> Scan<Self::Reading>;
}

/// Bytes kept, at most: twice the longest frame there is (a scan of the URG-04LX).
const CAPACITY: usize = 8192;

/// A protocol with the bytes that wait for it.
#[derive(Debug, Clone)]
pub struct Framer<P> {
    protocol: P,
    buffer: Box<[u8; CAPACITY]>,
    begin: usize,
    end: usize,
    skipped: u64,
}

impl<P: Protocol> Framer<P> {
    /// Without any byte yet.
    pub fn new(protocol: P) -> Self {
        Self { protocol, buffer: Box::new([0; CAPACITY]), begin: 0, end: 0, skipped: 0 }
    }

    /// The protocol, for what it keeps besides.
    pub fn protocol(&self) -> &P {
        &self.protocol
    }

    /// The same, to alter.
    pub fn protocol_mut(&mut self) -> &mut P {
        &mut self.protocol
    }

    /// Bytes that belonged to no frame, so far.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        (self.begin, self.end) = (0, 0);
    }

    /// Takes as many of `bytes` as there is room for; returns the rest. After [`Framer::next`] has returned `None`,
    /// there is room for at least one.
    #[must_use]
    pub fn fill<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        self.buffer.copy_within(self.begin..self.end, 0);
        self.end -= self.begin;
        self.begin = 0;
        let (taken, rest) = bytes.split_at(bytes.len().min(CAPACITY - self.end));
        if let Some(room) = self.buffer.get_mut(self.end..self.end + taken.len()) {
            room.copy_from_slice(taken);
            self.end += taken.len();
        }
        rest
    }

    /// The next frame among the bytes taken.
    #[allow(clippy::should_implement_trait, reason = "more may come after `None`")]
    pub fn next(&mut self) -> Option<Result<P::Reading, Fault>> {
        loop {
            let bytes = self.buffer.get(self.begin..self.end).filter(|bytes| !bytes.is_empty())?;
            let at_hand = bytes.len();
            match self.protocol.scan(bytes) {
                Scan::Skip(n) => self.skip(n),
                Scan::More if at_hand >= P::LONGEST.min(CAPACITY) => self.skip(1),
                Scan::More => return None,
                Scan::Frame(n, outcome) => {
                    self.begin += n.clamp(1, at_hand);
                    return Some(outcome);
                }
            }
        }
    }

    /// What waits is no frame, as nothing more comes: its first byte is skipped, so that [`Framer::next`] finds what hides in it.
    /// False where nothing waits.
    pub fn give_up(&mut self) -> bool {
        let waits = self.begin < self.end;
        if waits {
            self.skip(1);
        }
        waits
    }

    fn skip(&mut self, n: usize) {
        let n = n.clamp(1, self.end - self.begin);
        self.begin += n;
        self.skipped += n as u64;
    }

    /// Takes all of `bytes` and shows every frame.
    pub fn push(&mut self, mut bytes: &[u8], mut each: impl FnMut(Result<P::Reading, Fault>)) {
        while !bytes.is_empty() {
            bytes = self.fill(bytes);
            while let Some(outcome) = self.next() {
                each(outcome);
            }
        }
    }
}

/// Skips to the next byte that is `first`; all of them where there is none.
pub(crate) fn to<R>(bytes: &[u8], first: u8) -> Scan<R> {
    let from_second = bytes.iter().skip(1).position(|b| *b == first);
    Scan::Skip(from_second.map_or(bytes.len(), |at| at + 1))
}

/// Little-endian numbers at an offset; zero where the bytes end, which lengths checked before rule out.
pub(crate) mod le {
    pub fn bytes<const N: usize>(from: &[u8], at: usize) -> [u8; N] {
        from.get(at..at + N).and_then(|bytes| bytes.try_into().ok()).unwrap_or([0; N])
    }
    pub fn i16(from: &[u8], at: usize) -> i16 {
        i16::from_le_bytes(bytes(from, at))
    }
    pub fn u16(from: &[u8], at: usize) -> u16 {
        u16::from_le_bytes(bytes(from, at))
    }
    pub fn i32(from: &[u8], at: usize) -> i32 {
        i32::from_le_bytes(bytes(from, at))
    }
    pub fn u32(from: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes(from, at))
    }
    pub fn f32(from: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes(from, at))
    }
    pub fn f64(from: &[u8], at: usize) -> f64 {
        f64::from_le_bytes(bytes(from, at))
    }
}
