//! A filter that can be taken back: what it was a moment ago, and every frame since.
//!
//! A lie acts from its onset and is found later. Going through the frames since a state from before the onset once more,
//! without the liar, gives the filter that never believed it, where opening a covariance would only make
//! it forget. Two states are kept, each [`SPACING`] frames younger than the other, so that the older one is always between one and two
//! spacings old (1.28 to 2.56 s at 200 Hz). [`PER_TICK`] frames are gone through in a tick while the filter flies on: the longest
//! way takes 10 ticks. A lie that has lasted longer than the oldest state cannot be undone: then the state's
//! accelerometer bias is doubted where it begins.
//!
//! Allocates nothing after construction.

use super::gated::clean;
use super::identify::Withheld;
use crate::estimate::Estimator;
use crate::estimate::ekf_bias::EkfBias;
use crate::vehicle::{MotorCommand, SensorFrame};

/// Frames between the states that are kept.
const SPACING: u64 = 256;
/// Frames gone through again in a tick.
const PER_TICK: usize = 60;
/// Frames that arrive while the longest way is gone again.
const LONGEST_WAY: usize = 10;
/// Frames kept: two spacings, and those that arrive on the way, twice if it has to begin anew.
const FRAMES: usize = 2 * SPACING as usize + 2 * LONGEST_WAY;
/// A drift is noticed by its sum: it began before the sum did, at most by this factor.
const ONSET: f64 = 2.0;

/// What one tick of the filter had.
#[derive(Debug, Clone, Copy, Default)]
struct Past {
    frame: SensorFrame,
    applied: MotorCommand,
    withheld: Withheld,
}

/// A filter as it was after `frames` frames.
#[derive(Clone)]
struct Then {
    filter: EkfBias,
    frames: u64,
}

/// The last moments of a filter.
pub struct Rewind {
    ring: Vec<Past>,
    /// Frames so far.
    frames: u64,
    old: Then,
    young: Then,
    /// On its way from `old` to now, without the liars.
    again: Then,
    liars: Withheld,
    under_way: bool,
    count: u32,
}

impl Rewind {
    /// Nothing but the present.
    pub fn new(filter: &EkfBias) -> Self {
        let then = Then { filter: filter.clone(), frames: 0 };
        Self {
            ring: vec![Past::default(); FRAMES],
            frames: 0,
            old: then.clone(),
            young: then.clone(),
            again: then,
            liars: Withheld::default(),
            under_way: false,
            count: 0,
        }
    }

    /// Forgets what was before `filter`.
    pub fn start_over(&mut self, filter: &EkfBias) {
        for then in [&mut self.old, &mut self.young] {
            then.filter.clone_from(filter);
            then.frames = self.frames;
        }
        self.under_way = false;
    }

    /// How often the way was gone again.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// `filter` has taken `frame` without `withheld`.
    pub fn remember(&mut self, filter: &EkfBias, frame: &SensorFrame, applied: &MotorCommand, withheld: Withheld) {
        if let Some(past) = self.ring.get_mut((self.frames % FRAMES as u64) as usize) {
            *past = Past { frame: *frame, applied: *applied, withheld };
        }
        self.frames += 1;
        if !self.under_way && self.frames - self.young.frames >= SPACING {
            std::mem::swap(&mut self.old, &mut self.young);
            self.young.filter.clone_from(filter);
            self.young.frames = self.frames;
        }
    }

    /// `liars`, of whom an IMU has drifted for so long, are to be left out of the last moments as well.
    pub fn begin(&mut self, liars: Withheld, lied_s: f64) {
        self.liars = if self.under_way { self.liars.with(liars) } else { liars };
        self.count += 1;
        if self.under_way && (self.frames - self.old.frames) as usize + LONGEST_WAY > FRAMES {
            // What it would begin with would be overwritten before it comes there: it goes on without them.
            return;
        }
        self.again.filter.clone_from(&self.old.filter);
        self.again.frames = self.old.frames;
        self.under_way = true;
        let now = self.past(self.frames.saturating_sub(1)).frame.time;
        if ONSET * lied_s > now.seconds_since(self.old.filter.estimate().time) {
            self.again.filter.doubt_accel_bias();
        }
    }

    /// Goes on; the filter that never heard the liars, when it has arrived.
    pub fn go_on(&mut self) -> Option<&EkfBias> {
        if !self.under_way {
            return None;
        }
        for _ in 0..PER_TICK {
            if self.again.frames == self.young.frames {
                // What is younger has heard them as well.
                self.young.filter.clone_from(&self.again.filter);
            }
            if self.again.frames >= self.frames {
                break;
            }
            let past = self.past(self.again.frames);
            self.again.filter.step(&clean(&past.frame, past.withheld.with(self.liars)), &past.applied);
            self.again.frames += 1;
        }
        self.under_way = self.again.frames < self.frames;
        (!self.under_way).then_some(&self.again.filter)
    }

    fn past(&self, frame: u64) -> Past {
        self.ring.get((frame % FRAMES as u64) as usize).copied().unwrap_or_default()
    }
}
