//! A filter that can be rewound: checkpoints of what it was, and every frame since.
//!
//! An attack acts from its onset and is detected later. Replaying the frames since a checkpoint from before the onset,
//! without the attacked sensor, gives the filter that never used it, where opening a covariance would only make
//! it forget. Two checkpoints are kept, [`SPACING`] frames apart, so that the older one is always between one and two
//! spacings old (1.28 to 2.56 s at 200 Hz). [`PER_TICK`] frames are replayed in a tick while the filter flies on: the
//! longest replay takes 10 ticks. An attack that has lasted longer than the older checkpoint cannot be undone: then the
//! variance of its accelerometer bias is opened where the replay begins.
//!
//! Allocates nothing after construction.

use super::filter::clean;
use crate::estimate::Estimator;
use crate::estimate::ekf_bias::EkfBias;
use crate::estimate::fdir::isolation::SensorSet;
use crate::sensor::SensorFrame;
use crate::types::MotorCommand;

/// Frames between checkpoints.
const SPACING: u64 = 256;
/// Frames replayed in a tick.
const PER_TICK: usize = 60;
/// Ticks of the longest replay.
const LONGEST_REPLAY: usize = 10;
/// Frames kept: two spacings, and those that arrive during a replay, twice if it has to begin anew.
const FRAMES: usize = 2 * SPACING as usize + 2 * LONGEST_REPLAY;
/// A drift is noticed by its sum: it began before the sum did, at most by this factor.
const ONSET: f64 = 2.0;

/// What one tick of the filter had.
#[derive(Debug, Clone, Copy, Default)]
struct Past {
    frame: SensorFrame,
    applied: MotorCommand,
    excluded: SensorSet,
}

/// A filter as it was after `frames` frames.
#[derive(Clone)]
struct Checkpoint {
    filter: EkfBias,
    frames: u64,
}

/// The last moments of a filter.
pub struct Rewind {
    ring: Vec<Past>,
    /// Frames so far.
    frames: u64,
    // Each as large as a filter: not where its owner is made.
    old: Box<Checkpoint>,
    young: Box<Checkpoint>,
    /// On its way from `old` to now, without `attacked`.
    replay: Box<Checkpoint>,
    attacked: SensorSet,
    under_way: bool,
    count: u32,
}

impl Rewind {
    /// Nothing but the present.
    pub fn new(filter: &EkfBias) -> Self {
        let checkpoint = Box::new(Checkpoint { filter: filter.clone(), frames: 0 });
        Self {
            ring: vec![Past::default(); FRAMES],
            frames: 0,
            old: checkpoint.clone(),
            young: checkpoint.clone(),
            replay: checkpoint,
            attacked: SensorSet::default(),
            under_way: false,
            count: 0,
        }
    }

    /// Forgets what was before `filter`.
    pub fn start_over(&mut self, filter: &EkfBias) {
        for checkpoint in [&mut self.old, &mut self.young] {
            checkpoint.filter.clone_from(filter);
            checkpoint.frames = self.frames;
        }
        self.under_way = false;
    }

    /// Rewinds so far.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// `filter` has taken `frame` without `excluded`.
    pub fn remember(&mut self, filter: &EkfBias, frame: &SensorFrame, applied: &MotorCommand, excluded: SensorSet) {
        if let Some(past) = self.ring.get_mut((self.frames % FRAMES as u64) as usize) {
            *past = Past { frame: *frame, applied: *applied, excluded };
        }
        self.frames += 1;
        if !self.under_way && self.frames - self.young.frames >= SPACING {
            std::mem::swap(&mut self.old, &mut self.young);
            self.young.filter.clone_from(filter);
            self.young.frames = self.frames;
        }
    }

    /// Sensors newly `attacked`, of which an IMU has drifted for so long, are to be excluded from the last moments as well.
    pub fn begin(&mut self, attacked: SensorSet, drift_s: f64) {
        self.attacked = if self.under_way { self.attacked.with(attacked) } else { attacked };
        self.count += 1;
        if self.under_way && (self.frames - self.old.frames) as usize + LONGEST_REPLAY > FRAMES {
            // The first frames would be overwritten before they are replayed: the replay under way goes on without them.
            return;
        }
        self.replay.filter.clone_from(&self.old.filter);
        self.replay.frames = self.old.frames;
        self.under_way = true;
        let now = self.past(self.frames.saturating_sub(1)).frame.time;
        if ONSET * drift_s > now.seconds_since(self.old.filter.estimate().time) {
            self.replay.filter.open_accel_bias();
        }
    }

    /// Replays on; the filter that never used the attacked sensors, when it has arrived.
    pub fn advance(&mut self) -> Option<&EkfBias> {
        if !self.under_way {
            return None;
        }
        for _ in 0..PER_TICK {
            if self.replay.frames == self.young.frames {
                // The younger checkpoint had used them as well.
                self.young.filter.clone_from(&self.replay.filter);
            }
            if self.replay.frames >= self.frames {
                break;
            }
            let past = self.past(self.replay.frames);
            self.replay.filter.step(&clean(&past.frame, past.excluded.with(self.attacked)), &past.applied);
            self.replay.frames += 1;
        }
        self.under_way = self.replay.frames < self.frames;
        (!self.under_way).then_some(&self.replay.filter)
    }

    fn past(&self, frame: u64) -> Past {
        self.ring.get((frame % FRAMES as u64) as usize).copied().unwrap_or_default()
    }
}
