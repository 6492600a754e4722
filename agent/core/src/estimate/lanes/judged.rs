//! The judges alone: whom would they exclude, were heights and lanes off by so much? For whoever asks before a flight.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use super::PerLane;
use super::account::AGREED;
use super::evidence::{Evidence, Heard};
use super::heights::Heights;
use super::integral::Six;
use super::linear::ROWS;
use super::vote::Vote;
use crate::sensor::MAX_HEIGHTS;

/// What a lane made of a slot.
#[derive(Debug, Clone, Copy, Default)]
pub struct LaneHeard {
    /// Innovations of what was sampled, over their one-sigma.
    pub innovations: [Option<f64>; ROWS],
    /// Specific force along z, less that of all, m/s².
    pub force_mps2: f64,
    /// What of it the lane holds for its bias, m/s².
    pub bias_mps2: f64,
}

/// The judges about hover, with everything learned.
#[derive(Debug, Clone)]
pub struct Judged {
    heights: Heights,
    evidence: Evidence,
    vote: Vote,
}

impl Default for Judged {
    fn default() -> Self {
        Self { heights: Heights::default(), evidence: Evidence::default(), vote: Vote::new() }
    }
}

fn along_z(value: f64) -> Six {
    Six::new(0.0, 0.0, value, 0.0, 0.0, 0.0)
}

impl Judged {
    /// A slot that ends at `end`, the vehicle at `z_m`: when each height measured what, m, from where the lanes had it and `coasted`, by
    /// accelerations alone, which is what decides once heights part; and what each lane made of it.
    pub fn take(
        &mut self,
        end: FlightTime,
        z_m: f64,
        heights: &[Option<(FlightTime, f64)>; MAX_HEIGHTS],
        coasted: &[Option<(FlightTime, f64)>; MAX_HEIGHTS],
        lanes: &PerLane<Option<LaneHeard>>,
    ) {
        let mut samples = *coasted;
        for (i, (sample, measured)) in samples.iter_mut().zip(heights).enumerate() {
            let learned_m = self.heights.off_m(i, z_m);
            sample.iter_mut().for_each(|(_, off_m)| *off_m -= learned_m);
            if let Some((time, off_m)) = measured {
                let admitted = self.heights.admit(i, off_m - learned_m, *time);
                *sample = sample.filter(|_| admitted);
                self.heights.take(i, *time, off_m - learned_m);
            }
        }
        self.heights.split.take(end, (0.0, 0.0), (0.0, 0.0), &samples);
        let _ = self.heights.decode(end, z_m, false, true);
        self.vote.take(&lanes.map(|lane| lane.map(|lane| along_z(lane.force_mps2))));
        self.evidence.take(&lanes.map(|lane| {
            lane.map(|lane| {
                let mut heard = Heard { up: Vector3::z(), z_m, ..Heard::default() };
                lane.innovations.iter().flatten().for_each(|innovation| heard.hear(innovation * innovation));
                heard
            })
        }));
        let doubted = std::array::from_fn(|i| self.evidence.is_doubted(i));
        self.vote.learn(&lanes.map(|lane| lane.map(|lane| along_z(lane.bias_mps2))), &doubted, false);
    }

    /// Is height `index` excluded?
    pub fn height(&self, index: usize) -> bool {
        self.heights.is_excluded(index)
    }

    /// Is height `index` not used, since it parted from others?
    pub fn refuses(&self, index: usize) -> bool {
        self.heights.split.refuses(index)
    }

    /// Do the heights contradict each other, so that none is used?
    pub fn contradicted(&self) -> bool {
        self.heights.split.is_contradicted()
    }

    /// The worst statistic of height `index` over its limit.
    pub fn height_ratio(&self, index: usize) -> f64 {
        self.heights.ratio(index)
    }

    /// Evidence against IMU `index` over its limit.
    pub fn imu_ratio(&self, index: usize) -> f64 {
        self.evidence.ratio(index)
    }

    /// Is the exclusion of IMU `index` announced?
    pub fn imu(&self, index: usize) -> bool {
        let votes = self.vote.against(&self.evidence.are_present());
        self.evidence.is_excluded(index) && votes.get(index).is_some_and(|vote| *vote > AGREED)
    }
}
