//! Consensus of the IMUs: several units, one vehicle, one gyroscope and one accelerometer for the filter.
//!
//! Each axis of gyroscope and accelerometer is compared across the IMUs, those that are due in another tick
//! (units may sample in turns) with their last sample. The centre is the median (for four, the mean of the
//! middle two): one attacked unit of three or four cannot move it further than the healthy ones differ. Every
//! fresh IMU within its gate is then averaged, so that no noise is given away when all are healthy (¼ of the
//! variance instead of the median's 0.30). The deviation of every instance is published as a residual,
//! never merged.
//!
//! Why a consensus and not one filter per IMU: a per-IMU filter sees an attack only through position and
//! heading, seconds later, and on the string rig horizontally not at all; the consensus sees it in the same
//! sample, at a hundredth of the work of four filters.
//!
//! A shock (touch-down) changes everything within a tick, and where units sample in turns the fresh ones
//! then contradict the last samples of the others. Fresh samples that agree with one another have moved
//! together: they alone count, for as long as shocks last. Contradictions that stay are no shock.
//!
//! The constant difference of an IMU from the others (its bias) is learned slowly as its baseline and removed first:
//! otherwise the consensus would jump by a quarter of a bias whenever an IMU drops out. Baselines are
//! bounded, so a slow ramp ends at its gate as well.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | σ | noise of one sample | rad/s, m/s² |
//! | d | baseline: learned deviation of an instance from the consensus | rad/s, m/s² |
//! | ċ | how fast the quantity changes, by the fresh: widens the gate of samples of different times | /s |

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::baseline::Baseline;
use crate::estimate::{Channel, Residual, Residuals, median};
use crate::sensor::imu::{ImuModel, TriaxialModel};
use crate::sensor::{MAX_IMUS, SensorFrame};

/// Samples after which the prior spread between instances no longer widens the gate by half of σ.
const SAMPLES_TO_KNOW: f64 = 50.0;
/// A baseline's first value weighs one of so many.
const FIRST_WEIGHS: u32 = 20;
/// Window over which baselines are learned, samples.
const LEARNING_SAMPLES: f64 = 4000.0;
/// An instance that left its gate stays excluded this long after it came back, s.
const HOLD_OFF_S: f64 = 0.5;
/// Time constant of the slope, s: it measures motion rather than noise.
const SLOPE_S: f64 = 0.025;
/// Fresh samples may contradict those of the tick before for this long, s: a shock and its ringing. Pairs
/// that are attacked in the same way are trusted no longer than this either.
const SHOCK_S: f64 = 0.1;

/// What the instances agree on in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreed {
    /// Mean over the accepted instances.
    pub value: Vector3<f64>,
    /// How many were averaged.
    pub used: usize,
    /// Was there a majority? False when the instances contradict each other and none can be preferred.
    pub trusted: bool,
}

/// Consensus over one quantity.
#[derive(Debug, Clone)]
pub struct Consensus {
    model: TriaxialModel,
    channels: [Channel; 3],
    latest: [Option<(FlightTime, Vector3<f64>)>; MAX_IMUS],
    baseline: [Baseline<3>; MAX_IMUS],
    excluded_until: [Option<FlightTime>; MAX_IMUS],
    settled: Option<FlightTime>,
    slope: f64,
    /// For how long fresh samples have contradicted those of the ticks before, s.
    shock_s: f64,
}

/// One instance's newest sample.
#[derive(Debug, Clone, Copy)]
struct Member {
    index: usize,
    /// Sample less baseline.
    value: Vector3<f64>,
    age_s: f64,
    fresh: bool,
    accepted: bool,
}

type Members = ArrayVec<Member, MAX_IMUS>;

impl Consensus {
    /// Of the gyroscopes.
    pub fn of_gyros(imus: &ImuModel) -> Self {
        Self::new(imus.gyro, [Channel::GyroX, Channel::GyroY, Channel::GyroZ])
    }

    /// Of the accelerometers.
    pub fn of_accels(imus: &ImuModel) -> Self {
        Self::new(imus.accel, [Channel::AccelX, Channel::AccelY, Channel::AccelZ])
    }

    /// Of a quantity whose deviations go by these `channels`.
    pub fn new(model: TriaxialModel, channels: [Channel; 3]) -> Self {
        Self {
            model,
            channels,
            latest: [None; MAX_IMUS],
            baseline: [Baseline::after(0); MAX_IMUS],
            excluded_until: [None; MAX_IMUS],
            settled: None,
            slope: 0.0,
            shock_s: 0.0,
        }
    }

    /// Takes the samples of this frame (`None`, or not finite: skipped). `None` when no sample is fresh.
    /// Residuals are added for fresh samples, where there are at least two instances to compare.
    pub fn take(
        &mut self,
        now: FlightTime,
        samples: &[Option<Vector3<f64>>; MAX_IMUS],
        residuals: &mut Residuals,
    ) -> Option<Agreed> {
        let mut members = self.gather(now, samples);
        if !members.iter().any(|m| m.fresh) {
            return None;
        }
        if let [alone] = members.as_slice() {
            return Some(self.settle(now, alone.value, 1, true));
        }
        let mut centre = centre_of(members.iter());
        let mut moved = self.slope * members.iter().map(|m| m.age_s).fold(0.0, f64::max);
        if self.is_shock(now, &members, &centre, moved) {
            // The stale ones saw another motion: they neither count nor are excluded.
            members.retain(|m| m.fresh);
            centre = centre_of(members.iter());
            moved = 0.0;
        }
        self.gate(now, &mut members, &centre, moved, residuals);
        let agreeing = members.iter().filter(|m| m.accepted).count();
        if agreeing == 0 {
            let candidates = members.iter().filter(|m| m.fresh && !self.is_excluded(m.index, now));
            let value = if candidates.clone().count() > 0 { centre_of(candidates) } else { centre };
            return Some(self.settle(now, value, members.len(), false));
        }
        self.learn(&members, &centre, agreeing);
        // The fresh ones, or those of a tick ago where every fresh one is outside its gate.
        let any_fresh = members.iter().any(|m| m.accepted && m.fresh);
        let chosen = |m: &&Member| m.accepted && (m.fresh || !any_fresh);
        let used = members.iter().filter(chosen).count();
        let value = members.iter().filter(chosen).map(|m| m.value).sum::<Vector3<f64>>() / used as f64;
        // Two that differ leave no majority; of three or four, two in agreement are one.
        Some(self.settle(now, value, used, agreeing >= 2))
    }

    /// The newest sample of each instance that has one young enough, baseline removed.
    fn gather(&mut self, now: FlightTime, samples: &[Option<Vector3<f64>>; MAX_IMUS]) -> Members {
        let mut members = Members::new();
        let (mut change, mut changed) = (Vector3::zeros(), 0.0);
        let mut period_s = 0.0_f64;
        for (index, sample) in samples.iter().enumerate() {
            let fresh = sample.filter(|v| v.iter().all(|x| x.is_finite()));
            if let Some(value) = fresh {
                // An instance is compared with itself: between instances an attack would look like motion.
                if let Some((time, before)) = self.latest[index].filter(|_| !self.is_excluded(index, now)) {
                    change += value - before;
                    changed += 1.0;
                    period_s = period_s.max(now.seconds_since(time));
                }
                self.latest[index] = Some((now, value));
            }
            if let Some((time, value)) = self.latest[index] {
                let age_s = now.seconds_since(time);
                if (0.0..=self.model.memory_s).contains(&age_s) {
                    let value = value - Vector3::from(*self.baseline[index].offset());
                    members.push(Member { index, value, age_s, fresh: fresh.is_some(), accepted: true });
                }
            }
        }
        if changed > 0.0 {
            self.learn_slope(now, (change / changed).amax(), period_s);
        }
        members
    }

    /// Accepts the members within their gates; a fresh one that a majority contradicts is excluded for a while.
    fn gate(
        &mut self,
        now: FlightTime,
        members: &mut Members,
        centre: &Vector3<f64>,
        moved: f64,
        residuals: &mut Residuals,
    ) {
        let n = members.len();
        let gate_of = |m: &Member| self.model.gate * self.sigma_of(m.index, n, moved);
        // Two that are attacked in the same way can exclude others; where all contradict each other, none is excluded.
        let majority = members.iter().filter(|m| (m.value - centre).amax() <= gate_of(m)).count() >= 2;
        for member in members {
            let i = member.index;
            let sigma = self.sigma_of(i, n, moved);
            let gate = self.model.gate * sigma;
            let innovation = member.value - centre;
            let inside = innovation.iter().all(|x| x.abs() <= gate);
            if !inside && member.fresh && majority {
                let hold_off_us = (HOLD_OFF_S * 1e6) as u64;
                self.excluded_until[i] = Some(FlightTime(now.0.saturating_add(hold_off_us)));
            }
            member.accepted = inside && !self.is_excluded(i, now);
            if member.fresh {
                for (channel, innovation) in self.channels.into_iter().zip(innovation.iter()) {
                    let _ = residuals.try_push(Residual {
                        sensor: SensorId::new(SensorKind::Imu, i as u8 + 1),
                        channel,
                        innovation: *innovation,
                        sigma,
                        gate,
                        accepted: member.accepted,
                    });
                }
            }
        }
    }

    /// Has this instance been out of its gate lately?
    fn is_excluded(&self, index: usize, now: FlightTime) -> bool {
        self.excluded_until[index].is_some_and(|until| now < until)
    }

    /// One-sigma of the deviation of instance `i` among `n`, with `moved` between their samples.
    fn sigma_of(&self, i: usize, n: usize, moved: f64) -> f64 {
        let m = &self.model;
        let known = SAMPLES_TO_KNOW / (SAMPLES_TO_KNOW + f64::from(self.baseline[i].values()));
        (m.sigma * m.sigma * (1.0 + 1.0 / n as f64) + (m.spread * known).powi(2) + moved * moved).sqrt()
    }

    /// Do the fresh samples contradict the stale ones, but not one another, and not for too long?
    fn is_shock(&mut self, now: FlightTime, members: &[Member], centre: &Vector3<f64>, moved: f64) -> bool {
        let outside = |m: &Member, centre: &Vector3<f64>, n: usize, moved: f64| {
            (m.value - centre).amax() > self.model.gate * self.sigma_of(m.index, n, moved)
        };
        let fresh = || members.iter().filter(|m| m.fresh && !self.is_excluded(m.index, now));
        let n = fresh().count();
        let contradicted = n < members.len() && fresh().any(|m| outside(m, centre, members.len(), moved));
        let own = centre_of(fresh());
        let agree = n >= 2 && fresh().all(|m| !outside(m, &own, n, 0.0));
        let dt_s = self.settled.map_or(0.0, |time| now.seconds_since(time).clamp(0.0, self.model.memory_s));
        let shock = contradicted && agree;
        // Leaks, so that a contradiction that flickers counts as well.
        self.shock_s = (self.shock_s + if shock { dt_s } else { -0.5 * dt_s }).clamp(0.0, 2.0 * SHOCK_S);
        shock && self.shock_s <= SHOCK_S
    }

    fn settle(&mut self, now: FlightTime, value: Vector3<f64>, used: usize, trusted: bool) -> Agreed {
        self.settled = Some(now);
        Agreed { value, used, trusted }
    }

    /// `change` within one period of an instance, on average over the fresh. Instances that sample in turns
    /// lie half a period apart, and all of the change may have come within that half.
    fn learn_slope(&mut self, now: FlightTime, change: f64, period_s: f64) {
        let dt_s = self.settled.map_or(0.0, |time| now.seconds_since(time));
        if period_s > 0.0 && dt_s > 0.0 {
            let slope = (change - 2.0 * self.model.sigma).max(0.0) / (0.5 * period_s);
            self.slope += (slope - self.slope) * (dt_s / SLOPE_S).min(1.0);
        }
    }

    /// Moves the baselines towards what is seen, about the median: about the mean, a slow ramp of
    /// one instance would be shared out to the healthy ones and move the consensus by a quarter of itself.
    fn learn(&mut self, members: &[Member], centre: &Vector3<f64>, agreeing: usize) {
        if agreeing < 2 {
            return;
        }
        let (window, limit) = (1.0 / LEARNING_SAMPLES, self.model.largest_deviation);
        for member in members.iter().filter(|m| m.accepted && m.fresh) {
            let baseline = &mut self.baseline[member.index];
            baseline.count();
            baseline.learn(&(member.value - centre).into(), baseline.gain(FIRST_WEIGHS, window), limit);
        }
    }
}

/// Median of every axis.
fn centre_of<'a>(members: impl Iterator<Item = &'a Member> + Clone) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| median(members.clone().map(|m| m.value[axis])))
}

/// The gyroscope samples of a frame, rad/s.
pub fn gyros(frame: &SensorFrame) -> [Option<Vector3<f64>>; MAX_IMUS] {
    frame.imus.map(|imu| imu.map(|s| s.gyro_radps))
}

/// The accelerometer samples of a frame, m/s².
pub fn accels(frame: &SensorFrame) -> [Option<Vector3<f64>>; MAX_IMUS] {
    frame.imus.map(|imu| imu.map(|s| s.accel_mps2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn consensus() -> Consensus {
        let typical = ImuModel::default().accel;
        let model =
            TriaxialModel { sigma: 0.05, spread: 0.2, largest_deviation: 0.5, gate: 5.0, memory_s: 0.012, ..typical };
        Consensus::new(model, [Channel::AccelX, Channel::AccelY, Channel::AccelZ])
    }

    /// Deterministic noise of about σ 0.03.
    fn noise(k: usize, i: usize) -> Vector3<f64> {
        Vector3::from_fn(|a, _| 0.04 * ((k * 37 + i * 101 + a * 17) as f64 * 1.618).sin())
    }

    fn run(v: &mut Consensus, k: usize, bias: [f64; 4], attack: f64) -> (Agreed, Residuals) {
        let mut samples = [None; MAX_IMUS];
        for (i, s) in samples.iter_mut().enumerate().take(4) {
            let added = if i == 1 { attack } else { 0.0 };
            *s = Some(Vector3::new(bias[i] + added, 0.0, 9.81) + noise(k, i));
        }
        let mut residuals = ArrayVec::new();
        let c = v.take(FlightTime(k as u64 * 5000), &samples, &mut residuals).unwrap();
        (c, residuals)
    }

    #[test]
    fn one_attacked_of_four_is_excluded_and_the_consensus_does_not_jump() {
        let bias = [0.1, -0.1, 0.05, -0.05];
        let mut v = consensus();
        let mut before = Vector3::zeros();
        for k in 0..2000 {
            let (c, _) = run(&mut v, k, bias, 0.0);
            assert_eq!(c.used, 4);
            before += c.value / 2000.0;
        }
        let mut after = Vector3::zeros();
        for k in 2000..4000 {
            let (c, residuals) = run(&mut v, k, bias, 1.0);
            assert_eq!((c.used, c.trusted), (3, true));
            let attacked = residuals.iter().find(|r| r.sensor.instance == 2 && r.channel == Channel::AccelX).unwrap();
            assert!(attacked.ratio() > 1.0 && !attacked.accepted);
            assert!(residuals.iter().filter(|r| r.sensor.instance != 2).all(|r| r.accepted && r.ratio() < 1.0));
            after += c.value / 2000.0;
        }
        assert!((after - before).norm() < 0.01, "{before} {after}");
    }

    #[test]
    fn a_slow_ramp_ends_at_its_gate_and_never_moves_the_consensus() {
        let mut v = consensus();
        let mut crossed = false;
        for k in 0..20_000 {
            let ramp = 0.02 * k as f64 * 0.005;
            let (c, residuals) = run(&mut v, k, [0.0; 4], ramp);
            // At its gate (5 σ √1.25) one of four still has a quarter of the say; noise on top.
            assert!(
                c.value.x.abs() < 0.25 * 5.0 * 0.05 * 1.25f64.sqrt() + 0.06,
                "consensus {} at ramp {ramp}",
                c.value.x
            );
            crossed |= residuals.iter().any(|r| r.sensor.instance == 2 && r.ratio() > 1.0);
        }
        assert!(crossed, "a bias of 2 m/s² was never seen");
    }

    #[test]
    fn pairs_that_sample_in_turns_still_exclude_an_attacked_one() {
        // GIVEN IMUs 1, 3 on even ticks and 2, 4 on odd ones, WHEN 2 is attacked, THEN 4 alone is used on its ticks.
        let mut v = consensus();
        for k in 0..2000u64 {
            let mut samples = [None; MAX_IMUS];
            for (i, sample) in samples.iter_mut().enumerate().take(4) {
                if k % 2 == i as u64 % 2 {
                    let added = if i == 1 && k >= 1000 { 1.0 } else { 0.0 };
                    *sample = Some(Vector3::new(added, 0.0, 9.81) + noise(k as usize, i));
                }
            }
            let mut residuals = ArrayVec::new();
            let c = v.take(FlightTime(k * 5000), &samples, &mut residuals).unwrap();
            assert!(c.trusted && c.value.x.abs() < 0.15, "{c:?} at {k}");
            assert_eq!(residuals.len(), 6);
            if k >= 1000 && k % 2 == 1 {
                assert_eq!(c.used, 1);
                let attacked =
                    residuals.iter().find(|r| r.sensor.instance == 2 && r.channel == Channel::AccelX).unwrap();
                assert!(attacked.ratio() > 1.0 && !attacked.accepted);
            }
        }
    }

    /// IMUs 1, 3 on even ticks and 2, 4 on odd ones, with `extra(k, i)` on the x axis.
    fn in_turns(v: &mut Consensus, k: u64, extra: impl Fn(u64, usize) -> f64) -> Agreed {
        let mut samples = [None; MAX_IMUS];
        for (i, sample) in samples.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
            *sample = Some(Vector3::new(extra(k, i), 0.0, 9.81) + noise(k as usize, i));
        }
        v.take(FlightTime(k * 5000), &samples, &mut ArrayVec::new()).unwrap()
    }

    #[test]
    fn a_shock_that_all_feel_excludes_none_and_counts_at_once() {
        let mut v = consensus();
        // A touch-down: 30 m/s² in one tick, gone in the next, ringing for 20 ms more.
        let shock = |k: u64, _| match k {
            1000 => 30.0,
            1001 => -6.0,
            1002..=1005 => 4.0 - 8.0 * (k % 2) as f64,
            _ => 0.0,
        };
        for k in 0..1400 {
            let c = in_turns(&mut v, k, shock);
            assert!(c.trusted && c.used == 2, "{c:?} at {k}");
            assert!((c.value.x - shock(k, 0)).abs() < 0.15, "{c:?} at {k}");
        }
        assert!(v.excluded_until.iter().all(Option::is_none));
    }

    #[test]
    fn an_attacked_one_is_excluded_in_a_shock_as_well() {
        let mut v = consensus();
        for k in 0..1400 {
            let c = in_turns(
                &mut v,
                k,
                |k, i| if k == 1000 { 30.0 } else { 0.0 } + if i == 1 && k > 900 { 2.0 } else { 0.0 },
            );
            if k > 901 {
                // Just after the shock one IMU stands against the samples of the tick before.
                assert!(c.trusted || k == 1001, "{c:?} at {k}");
                let expected = if k == 1000 { 30.0 } else { 0.0 };
                assert!((c.value.x - expected).abs() < 0.2, "{c:?} at {k}");
            }
        }
    }

    #[test]
    fn a_pair_attacked_in_the_same_way_is_not_trusted_after_a_shocks_time() {
        let mut v = consensus();
        let mut trusted_ticks = 0;
        for k in 0..2000 {
            let c = in_turns(&mut v, k, |k, i| if k >= 1000 && i % 2 == 0 { 3.0 } else { 0.0 });
            trusted_ticks += u64::from(k >= 1000 && c.trusted);
            assert!(k < 1000 + 40 || !c.trusted, "{c:?} at {k}");
        }
        assert!(trusted_ticks <= 25, "{trusted_ticks}");
    }

    #[test]
    fn two_that_contradict_each_other_are_not_trusted() {
        let mut v = consensus();
        let mut residuals = ArrayVec::new();
        let mut samples = [None; MAX_IMUS];
        samples[0] = Some(Vector3::new(0.0, 0.0, 9.81));
        samples[2] = Some(Vector3::new(8.0, 0.0, 9.81));
        let c = v.take(FlightTime(1), &samples, &mut residuals).unwrap();
        assert!(!c.trusted && (c.value.x - 4.0).abs() < 1e-12);
        assert!(residuals.iter().all(|r| !r.accepted));
    }

    #[test]
    fn samples_that_are_not_finite_are_skipped() {
        let mut v = consensus();
        let mut residuals = ArrayVec::new();
        let mut samples = [None; MAX_IMUS];
        samples[..4].fill(Some(Vector3::new(0.0, 0.0, 9.81)));
        samples[3] = Some(Vector3::new(f64::NAN, 0.0, 0.0));
        let c = v.take(FlightTime(1), &samples, &mut residuals).unwrap();
        assert_eq!(c.used, 3);
        assert!(v.take(FlightTime(2), &[None; MAX_IMUS], &mut residuals).is_none());
    }
}
