//! Which of several estimators flies, by the rules of PX4's `EKF2Selector`.
//!
//! | what | rule |
//! |---|---|
//! | score | Σ (test ratio − that of the one in the loop), within ±1; improvements below 0.2 do not count |
//! | test ratio | largest (innovation / (gate σ))² of the heights, gate 5 |
//! | IMU fault | from the median of all: Σ (difference − 7 °/s) dt beyond 15°, Σ (difference − 1 m/s²) dt beyond 2 m/s |
//!
//! The one in the loop is left when its IMU is faulty, or when another's score is below −0.5.

use nalgebra::Vector3;
use plumbline_agent::flight::Flight;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::imu::ImuSample;
use plumbline_proto::v1::SensorKind;

use crate::draw::median;
use crate::monitor::FRESH_S;

/// `EKF2_SEL_ERR_RED`, and the limits of the score.
const REDUCTION: f64 = 0.2;
const SCORE_MAX: f64 = 1.0;
const SCORE_CHANGES: f64 = 0.5;
/// `EKF2_SEL_IMU_RAT`, rad/s, `_ANG`, rad, `_ACC`, m/s², `_VEL`, m/s.
const RATE_RADPS: f64 = 0.122;
const ANGLE_RAD: f64 = 0.262;
const ACCELERATION_MPS2: f64 = 1.0;
const VELOCITY_MPS: f64 = 2.0;
/// Gate of a test ratio, σ.
const GATE: f64 = 5.0;

#[derive(Debug, Clone, Copy, Default)]
struct Instance {
    test_ratio: f64,
    score: f64,
    angle_rad: f64,
    velocity_mps: f64,
    sample: Option<ImuSample>,
}

impl Instance {
    fn faulty(&self) -> bool {
        self.angle_rad > ANGLE_RAD || self.velocity_mps > VELOCITY_MPS || self.sample.is_none()
    }
}

/// See the module.
#[derive(Debug, Clone)]
pub(crate) struct Selector {
    instances: Vec<Instance>,
    chosen: usize,
    last_s: f64,
}

impl Selector {
    pub(crate) fn new(count: usize) -> Self {
        Self { instances: vec![Instance::default(); count], chosen: 0, last_s: 0.0 }
    }

    pub(crate) fn chosen(&self) -> usize {
        self.chosen
    }

    /// One tick: what all received, and what each of `flights` made of it with its IMU.
    pub(crate) fn take(&mut self, received: &SensorFrame, flights: &[Flight]) {
        let t = received.time.as_seconds();
        let dt_s = (t - self.last_s).clamp(0.0, 0.1);
        self.last_s = t;
        for (instance, new) in self.instances.iter_mut().zip(&received.imus) {
            let fresh = |sample: &ImuSample| received.time.seconds_since(sample.time) < 2.0 * FRESH_S;
            instance.sample = new.or(instance.sample).filter(fresh);
        }
        let of = |value: fn(&ImuSample) -> Vector3<f64>| {
            let fresh: Vec<_> = self.instances.iter().filter_map(|i| i.sample.as_ref()).map(value).collect();
            Vector3::from_fn(|axis, _| median(&fresh.iter().map(|v| v[axis]).collect::<Vec<_>>()))
        };
        let (rate, force) = (of(|sample| sample.gyro_radps), of(|sample| sample.accel_mps2));
        for instance in &mut self.instances {
            let Some(sample) = instance.sample else { continue };
            let grown = |sum: f64, off: f64, most: f64| (sum + (off - most) * dt_s).max(0.0);
            instance.angle_rad = grown(instance.angle_rad, (sample.gyro_radps - rate).norm(), RATE_RADPS);
            instance.velocity_mps = grown(instance.velocity_mps, (sample.accel_mps2 - force).norm(), ACCELERATION_MPS2);
        }
        let mut anew = false;
        for (instance, flight) in self.instances.iter_mut().zip(flights) {
            let Some(estimate) = flight.estimate_in_loop() else { continue };
            let heights = estimate.residuals.iter().filter(|r| r.sensor.kind == SensorKind::Height && r.sigma > 0.0);
            if let Some(worst) = heights.map(|r| (r.innovation / (GATE * r.sigma)).powi(2)).reduce(f64::max) {
                (instance.test_ratio, anew) = (worst, true);
            }
        }
        if anew {
            self.score();
        }
        self.choose();
    }

    fn score(&mut self) {
        let primary = self.instances.get(self.chosen).map_or(0.0, |instance| instance.test_ratio);
        for instance in &mut self.instances {
            let delta = instance.test_ratio - primary;
            if !(-REDUCTION..=0.0).contains(&delta) {
                instance.score = (instance.score + delta).clamp(-SCORE_MAX, SCORE_MAX);
            }
        }
    }

    fn choose(&mut self) {
        let sound = self.instances.iter().enumerate().filter(|(i, instance)| *i != self.chosen && !instance.faulty());
        let Some((best, other)) = sound.min_by(|a, b| a.1.score.total_cmp(&b.1.score)) else { return };
        let faulty = self.instances.get(self.chosen).is_none_or(Instance::faulty);
        if faulty || other.score < -SCORE_CHANGES {
            self.chosen = best;
            self.instances.iter_mut().for_each(|instance| instance.score = 0.0);
        }
    }
}
