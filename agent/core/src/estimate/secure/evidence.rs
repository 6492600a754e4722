//! What a decoded window and the seconds before it say about each sensor.

use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::decode::FlyingDecoder;
use super::model::SLOT_S;
use super::signals::Signals;
use crate::estimate::fdir::isolation::{CERTAIN, Evidence, Z_999, chi_square};
use crate::estimate::fdir::stuck::{Stuck, stuck_limit};
use crate::estimate::fdir::synchronous::Synchronous;
use crate::sensor::SensorModel;
use crate::sensor::{MAX_HEIGHTS, MAX_IMUS, SensorFrame};

/// Windows during which deviations are only learned: 2 s.
const LEARNING: u32 = 50;
/// After an IMU is isolated the loop flies on other sensors, and what the rest of them differ by (ripple of the loop at
/// their sampling rate) is learned anew during so many windows: 1 s.
const RELEARNING: u32 = 25;
/// Resolution of a height, m.
const HEIGHT_RESOLUTION_M: f64 = 1e-3;

/// How many windows have been examined, and whether baselines are still being learned.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Training {
    windows: u32,
    relearning_until: u32,
    isolated_imus: usize,
}

impl Training {
    /// One more window was decoded.
    pub fn count(&mut self) {
        self.windows = self.windows.saturating_add(1);
    }

    /// Are baselines only learned so far, and nothing isolated?
    pub fn is_learning(&self) -> bool {
        self.windows < LEARNING
    }

    /// Are those of the IMUs learned anew?
    pub fn is_relearning(&self) -> bool {
        self.windows < self.relearning_until
    }

    /// So many IMUs are isolated now; true where that has changed, and relearning begins.
    pub fn isolated(&mut self, imus: usize) -> bool {
        let changed = imus != self.isolated_imus;
        if changed {
            self.isolated_imus = imus;
            self.relearning_until = self.windows.saturating_add(RELEARNING);
        }
        changed
    }
}

/// Equal samples in a row of IMUs and heights.
#[derive(Debug, Clone)]
pub(super) struct StuckTests {
    imus: [Stuck<6>; MAX_IMUS],
    heights: [Stuck<1>; MAX_HEIGHTS],
    imu_limit: u32,
    height_limit: u32,
}

impl StuckTests {
    /// For sensors like these.
    pub fn new(model: &SensorModel) -> Self {
        Self {
            imus: [Stuck::default(); MAX_IMUS],
            heights: [Stuck::default(); MAX_HEIGHTS],
            imu_limit: stuck_limit(model.imus.gyro.sigma, 0.5 * model.imus.gyro.sigma),
            height_limit: stuck_limit(model.heights.sigma, HEIGHT_RESOLUTION_M),
        }
    }

    /// Takes the samples of a tick.
    pub fn take(&mut self, frame: &SensorFrame) {
        for (test, imu) in self.imus.iter_mut().zip(&frame.imus) {
            let Some(imu) = imu else { continue };
            let (w, f) = (imu.gyro_radps, imu.accel_mps2);
            test.take([w.x, w.y, w.z, f.x, f.y, f.z]);
        }
        for (test, height) in self.heights.iter_mut().zip(&frame.heights) {
            if let Some(height) = height {
                test.take([height.height_m]);
            }
        }
    }

    /// Does `sensor` repeat itself while others of its kind move? A group of which none moves is not stuck: it is
    /// logged twice, or silent.
    pub fn is_stuck(&self, sensor: SensorId) -> bool {
        let index = usize::from(sensor.instance.saturating_sub(1));
        match sensor.kind {
            SensorKind::Imu => repeats(&self.imus, index, self.imu_limit),
            SensorKind::Height => repeats(&self.heights, index, self.height_limit),
            _ => false,
        }
    }
}

fn repeats<const N: usize>(group: &[Stuck<N>], index: usize, limit: u32) -> bool {
    let moving = group.iter().any(|test| test.repeats() == 0);
    moving && group.get(index).is_some_and(|test| test.repeats() >= limit)
}

/// What is tested beside the decoder, over seconds.
pub(super) struct Tests {
    /// IMUs that sample together.
    pub synchronous: Synchronous,
    /// Sensors that repeat themselves.
    pub stuck: StuckTests,
    /// How far the baselines are learned.
    pub training: Training,
}

impl Tests {
    /// For sensors like these.
    pub fn new(model: &SensorModel) -> Self {
        Self { synchronous: Synchronous::default(), stuck: StuckTests::new(model), training: Training::default() }
    }
}

/// Evidence of one window.
pub(super) struct Window<'a> {
    /// Its decoder.
    pub decoder: &'a FlyingDecoder,
    /// Baselines and slow deviations.
    pub signals: &'a Signals,
    /// The tests beside it.
    pub tests: &'a Tests,
}

impl Window<'_> {
    /// About `sensor`.
    pub fn about(&self, sensor: SensorId) -> Evidence {
        let mut evidence = Evidence { stuck: self.tests.stuck.is_stuck(sensor), ..Evidence::default() };
        for (index, signal) in self.signals.of(sensor) {
            let statistic = self.decoder.statistic(index);
            if statistic.values > 0 {
                let ratio = statistic.square / chi_square(statistic.values, Z_999);
                evidence.window_ratio = evidence.window_ratio.max(ratio);
            }
            let drift = signal.cusum();
            if drift.ratio() > evidence.drift_ratio {
                evidence.drift_ratio = drift.ratio();
                evidence.drift_s = SLOT_S * f64::from(drift.lasts());
            }
        }
        if sensor.kind == SensorKind::Imu {
            if let Some(slots) = self.tests.synchronous.diverging_for(usize::from(sensor.instance.saturating_sub(1))) {
                evidence.diverging = true;
                evidence.drift_s = evidence.drift_s.max(SLOT_S * f64::from(slots));
            }
            if self.tests.training.is_relearning() {
                // What is in the window was counted from the baselines of before: only what is certain counts.
                evidence.window_ratio /= CERTAIN;
            }
        }
        evidence
    }
}
