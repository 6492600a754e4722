//! Rest, by gyroscope and accelerometer alone (Laidig & Seel 2023, section 3.5), and the sample period it is judged at.

use nalgebra::Vector3;

use super::{BIAS_LIMIT_RADPS, DEGREE};
use crate::estimate::filter::low_pass::LowPass;

/// Rest: for this long, s …
const REST_S: f64 = 1.5;
/// … the rate stays this close to its low-pass, rad/s …
const REST_RATE_RADPS: f64 = 2.0 * DEGREE;
/// … and the specific force too, m/s² …
const REST_FORCE_MPS2: f64 = 0.5;
/// … low-passed over this, s.
const REST_TAU_S: f64 = 0.5;

/// The low-passes want the real sample rate: it is measured.
#[derive(Debug, Clone, Copy)]
pub struct Period {
    used_s: f64,
    measured_s: f64,
    samples: u32,
}

impl Period {
    /// About `nominal_s` between two samples.
    pub fn new(nominal_s: f64) -> Self {
        Self { used_s: nominal_s, measured_s: nominal_s, samples: 0 }
    }

    /// Takes the time between two samples; true when the low-passes must be retuned.
    pub fn take(&mut self, dt_s: f64) -> bool {
        if dt_s > 0.0 && dt_s < 0.1 {
            self.samples = self.samples.saturating_add(1);
            let gain = (1.0 / f64::from(self.samples)).max(0.002);
            self.measured_s += gain * (dt_s - self.measured_s);
        }
        let changed = (self.measured_s / self.used_s - 1.0).abs() > 0.05 && self.samples > 4;
        if changed {
            self.used_s = self.measured_s;
        }
        changed
    }

    /// What the low-passes are tuned to, s.
    pub fn used_s(&self) -> f64 {
        self.used_s
    }
}

/// Has nothing moved for a while?
#[derive(Debug, Clone)]
pub struct Rest {
    rate: LowPass<3>,
    force: LowPass<3>,
    slow_rate: Vector3<f64>,
    lasts_s: f64,
}

impl Rest {
    pub fn new(period_s: f64) -> Self {
        Self {
            rate: LowPass::new(REST_TAU_S, period_s),
            force: LowPass::new(REST_TAU_S, period_s),
            slow_rate: Vector3::zeros(),
            lasts_s: 0.0,
        }
    }

    pub fn retune(&mut self, period_s: f64) {
        self.rate.retune(period_s);
        self.force.retune(period_s);
    }

    pub fn push_gyro(&mut self, gyro: &Vector3<f64>) {
        self.slow_rate = self.rate.push(*gyro);
        if (gyro - self.slow_rate).norm() >= REST_RATE_RADPS || self.slow_rate.amax() > BIAS_LIMIT_RADPS {
            self.lasts_s = 0.0;
        }
    }

    pub fn push_force(&mut self, dt_s: f64, force: &Vector3<f64>) {
        let slow = self.force.push(*force);
        if (force - slow).norm() >= REST_FORCE_MPS2 {
            self.lasts_s = 0.0;
        } else {
            self.lasts_s += dt_s;
        }
    }

    pub fn holds(&self) -> bool {
        self.lasts_s >= REST_S
    }

    /// The rate, low-passed, rad/s.
    pub fn slow_rate(&self) -> &Vector3<f64> {
        &self.slow_rate
    }

    /// … while at rest.
    pub fn rate_at_rest(&self) -> Option<&Vector3<f64>> {
        self.holds().then_some(&self.slow_rate)
    }
}
