//! Each IMU against the others: what enters the window of the secure estimator.
//!
//! Over a slot every IMU has a mean, its accelerometer's lever arm removed. IMUs that sample in turns saw the
//! motion at other times: a mean is moved to the middle of all of them with the slope of the motion (the
//! median of the IMUs' own slopes). What is left after the median of all is the deviation: a minority moves
//! neither slope nor median, however large its attack.
//!
//! Where the motion is rough (vibration, touch-down, ringing strings) a slope does not describe it all: an IMU that samples
//! at other times sees another vibration v. Its slot mean then differs from that of the others by the noise and by
//! the mean of two independent vibrations: σ² + 2 σ_v² instead of σ², per sample. What each IMU changes against
//! itself from sample to sample has the variance 2 (σ² + σ_v²); the median over the IMUs, so that a minority can
//! neither claim a shock nor hide one, says how much less differences count, down to nothing.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use crate::estimate::aiding::lever_arm::LeverArm;
use crate::estimate::fdir::synchronous::SlotMean;
use crate::estimate::median;
use crate::sensor::SensorModel;
use crate::sensor::{MAX_IMUS, SensorFrame};

/// Vibration is averaged over this long, s; a slot that is rougher than the average counts by itself.
const ROUGH_S: f64 = 0.4;
/// A slot discounted by more than this is not used.
const LARGEST_DISCOUNT: f64 = 10.0;
/// Scale and mounting of healthy IMUs differ by this fraction: a sample in motion counts less.
const SCALE_SPREAD: f64 = 0.02;

/// What a slot of the IMUs was: gyroscope x y z (rad/s), accelerometer x y z (m/s²).
#[derive(Debug, Clone, Copy)]
pub struct Slot {
    /// Mean of each IMU less the median of all.
    pub deviations: [Option<[f64; 6]>; MAX_IMUS],
    /// By how much what differs from a constant counts less in each axis: NaN where the motion was too rough to
    /// compare.
    pub discount: [f64; 6],
    /// Mean of each IMU where it was.
    pub means: [Option<SlotMean>; MAX_IMUS],
    /// What scale and mounting let healthy ones differ by in this motion.
    pub scale: [f64; 6],
}

#[derive(Debug, Clone, Copy, Default)]
struct Unit {
    latest: Option<(FlightTime, [f64; 6])>,
    first: Option<(f64, [f64; 6])>,
    last: Option<(f64, [f64; 6])>,
    sum: [f64; 6],
    times_s: f64,
    samples: u32,
    /// Σ of squared changes since the sample before, and how many.
    change: [f64; 6],
    changes: u32,
}

/// The IMUs of a vehicle.
#[derive(Debug, Clone)]
pub struct Inertial {
    units: [Unit; MAX_IMUS],
    place_flu_m: [Vector3<f64>; MAX_IMUS],
    sigma: [f64; 2],
    memory_s: f64,
    began: FlightTime,
    lever_arm: LeverArm,
    /// (σ² + σ_v²) / σ² of each axis, averaged.
    rough: [f64; 6],
}

impl Inertial {
    /// IMUs like these.
    pub fn new(model: &SensorModel) -> Self {
        Self {
            units: [Unit::default(); MAX_IMUS],
            place_flu_m: model.imus.position_flu_m,
            sigma: [model.imus.gyro.sigma, model.imus.accel.sigma],
            memory_s: model.imus.gyro.memory_s.max(model.imus.accel.memory_s),
            began: FlightTime::default(),
            lever_arm: LeverArm::default(),
            rough: [1.0; 6],
        }
    }

    /// Takes the samples of a tick.
    pub fn take(&mut self, frame: &SensorFrame) {
        let now = frame.time;
        let rate = self.lever_arm.rate_radps();
        for ((unit, imu), place) in self.units.iter_mut().zip(&frame.imus).zip(&self.place_flu_m) {
            let Some(imu) = imu else { continue };
            let accel = imu.accel_mps2 - self.lever_arm.acceleration_mps2(place, &rate);
            let (w, f) = (imu.gyro_radps, accel);
            let sample = [w.x, w.y, w.z, f.x, f.y, f.z];
            if !sample.iter().all(|v| v.is_finite()) {
                continue;
            }
            if let Some((time, before)) = unit.latest
                && now.seconds_since(time) <= 2.0 * self.memory_s
            {
                for (change, (now, before)) in unit.change.iter_mut().zip(sample.iter().zip(&before)) {
                    *change += (now - before).powi(2);
                }
                unit.changes += 1;
            }
            let at_s = now.seconds_since(self.began);
            unit.latest = Some((now, sample));
            unit.first = unit.first.or(Some((at_s, sample)));
            unit.last = Some((at_s, sample));
            unit.sum.iter_mut().zip(sample).for_each(|(sum, v)| *sum += v);
            unit.times_s += at_s;
            unit.samples += 1;
        }
        let fresh = |u: &&Unit| u.latest.is_some_and(|(time, _)| now.seconds_since(time) <= self.memory_s);
        let of = |axis: usize| {
            median(self.units.iter().filter(fresh).filter_map(|u| u.latest.map(|(_, sample)| sample[axis])))
        };
        let rate = Vector3::new(of(0), of(1), of(2));
        if rate.iter().all(|v| v.is_finite()) {
            self.lever_arm.push(now, &rate);
        }
    }

    /// The slot, which lasted `slot_s`.
    pub fn slot(&mut self, slot_s: f64) -> Slot {
        let filled = || self.units.iter().filter(|u| u.samples > 0);
        let count = filled().count().max(1) as f64;
        let middle_s = filled().map(|u| u.times_s / f64::from(u.samples)).sum::<f64>() / count;
        let (mut deviations, mut discount, mut scale) = ([None; MAX_IMUS], [f64::NAN; 6], [0.0; 6]);
        let mut means = [[f64::NAN; 6]; MAX_IMUS];
        for axis in 0..6 {
            let slope = |u: &Unit| {
                let ((from_s, from), (to_s, to)) = (u.first?, u.last?);
                (to_s > from_s).then(|| (to[axis] - from[axis]) / (to_s - from_s))
            };
            let slope = median(filled().filter_map(slope));
            let slope = if slope.is_finite() { slope } else { 0.0 };
            for (mean, unit) in means.iter_mut().zip(&self.units).filter(|(_, u)| u.samples > 0) {
                let n = f64::from(unit.samples);
                mean[axis] = unit.sum[axis] / n - slope * (unit.times_s / n - middle_s);
            }
        }
        for quantity in 0..2 {
            let motion = self.motion(quantity, &means);
            for axis in 3 * quantity..3 * quantity + 3 {
                scale[axis] = SCALE_SPREAD * motion * self.sigma[quantity];
                discount[axis] = self.discount(axis, motion, slot_s);
                let centre = median(means.iter().map(|m| m[axis]).filter(|v| v.is_finite()));
                for ((out, mean), unit) in deviations.iter_mut().zip(&means).zip(&self.units) {
                    if unit.samples > 0 {
                        out.get_or_insert([f64::NAN; 6])[axis] = mean[axis] - centre;
                    }
                }
            }
        }
        let means = self.units.map(|unit| {
            let n = f64::from(unit.samples);
            (unit.samples > 0).then(|| SlotMean {
                value: unit.sum.map(|sum| sum / n),
                middle_s: unit.times_s / n,
                samples: unit.samples,
            })
        });
        Slot { deviations, discount, means, scale }
    }

    /// Begins a new slot.
    pub fn begin(&mut self, now: FlightTime) {
        self.began = now;
        for unit in &mut self.units {
            *unit = Unit { latest: unit.latest, ..Unit::default() };
        }
    }

    /// How far a quantity is from rest, in sigmas.
    fn motion(&self, quantity: usize, means: &[[f64; 6]; MAX_IMUS]) -> f64 {
        let part = 3 * quantity;
        let size = |m: &[f64; 6]| (part..part + 3).map(|a| m[a] * m[a]).sum::<f64>().sqrt();
        let size = median(means.iter().map(size).filter(|v| v.is_finite()));
        // A resting accelerometer reads g: its scale is part of what is learned as its bias.
        (if quantity == 0 { size } else { (size - 9.81).abs() }) / self.sigma[quantity]
    }

    /// By how much differences of an axis count less in this slot; NaN for not at all.
    fn discount(&mut self, axis: usize, motion: f64, slot_s: f64) -> f64 {
        let variance = 2.0 * self.sigma[axis / 3].powi(2);
        let changed = self.units.iter().filter(|u| u.changes > 0);
        let rough = median(changed.map(|u| u.change[axis] / f64::from(u.changes) / variance));
        let mut worst = self.rough[axis];
        if rough.is_finite() {
            // A shock is over when it is over: it must not outlast itself by more than the averaging time.
            let bounded = rough.clamp(1.0, LARGEST_DISCOUNT * LARGEST_DISCOUNT);
            self.rough[axis] += (bounded - self.rough[axis]) * (slot_s / (ROUGH_S + slot_s));
            worst = self.rough[axis].max(rough);
        }
        let less = (1.0 + 2.0 * (worst - 1.0)).sqrt().hypot(SCALE_SPREAD * motion);
        if less > LARGEST_DISCOUNT { f64::NAN } else { less }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::ImuSample;

    fn frame(k: u64, value: impl Fn(usize) -> f64) -> SensorFrame {
        let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
        for (i, imu) in frame.imus.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
            *imu = Some(ImuSample {
                time: FlightTime(k * 5000),
                gyro_radps: Vector3::zeros(),
                accel_mps2: Vector3::new(value(i), 0.0, 9.81),
                mag_ut: None,
                temperature_c: 20.0,
            });
        }
        frame
    }

    #[test]
    fn an_attacked_one_deviates_in_a_motion_that_all_share() {
        let mut inertial = Inertial::new(&SensorModel::default());
        inertial.begin(FlightTime(0));
        // All feel a ramp, each at its own times.
        for k in 0..8 {
            inertial.take(&frame(k, |i| 0.01 * k as f64 + if i == 1 { 1.0 } else { 0.0 }));
        }
        let slot = inertial.slot(0.04);
        let x = slot.deviations.map(|d| d.map_or(f64::NAN, |d| d[3]));
        assert!((x[1] - 1.0).abs() < 1e-3 && [0, 2, 3].iter().all(|i| x[*i].abs() < 1e-3), "{x:?}");
        assert!((1.0..1.01).contains(&slot.discount[3]), "{:?}", slot.discount);
    }

    #[test]
    fn half_of_them_make_a_shock_and_one_does_not() {
        let run = |shock: fn(u64, usize) -> bool| {
            let mut inertial = Inertial::new(&SensorModel::default());
            for k in 0..8 {
                inertial.take(&frame(k, |i| if shock(k, i) { 30.0 } else { 0.0 }));
            }
            inertial.slot(0.04).discount[3]
        };
        assert!(run(|k, _| k == 4 || k == 5).is_nan());
        assert!(run(|k, i| k >= 4 && i == 0).is_finite());
    }
}
