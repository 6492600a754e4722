//! Four IMUs, one vehicle: a vote before the filter.
//!
//! Each axis of gyroscope and accelerometer is compared across the IMUs, those that are due in another tick
//! (units may sample in turns) with their last sample. The centre is the median (for four, the mean of the
//! middle two): one liar of three or four cannot move it further than the honest ones lie apart. Every
//! fresh IMU within its gate is then averaged, so that no noise is given away when all are honest (¼ of the
//! variance instead of the median's 0.30). The deviation of every instance is published as a residual,
//! never merged.
//!
//! Why a vote and not one filter per IMU: a per-IMU filter sees an attack only through position and
//! heading, seconds later, and on the string rig horizontally not at all; the vote sees it in the same
//! sample, at a hundredth of the work of four filters.
//!
//! A shock (touch-down) changes everything within a tick, and where units sample in turns the fresh ones
//! then contradict the last samples of the others. Fresh samples that agree with one another have moved
//! together: they alone are asked, for as long as shocks last. Contradictions that stay are none.
//!
//! The constant difference of an IMU from the others (its bias) is learned slowly and removed first:
//! otherwise the consensus would jump by a quarter of a bias whenever an IMU drops out. What can be learned
//! is bounded, so a slow ramp ends at its gate as well.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | σ | noise of one sample | rad/s, m/s² |
//! | d | learned deviation of an instance from the consensus | rad/s, m/s² |
//! | ċ | how fast the quantity changes, by the fresh: widens the gate of samples of different times | /s |

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::{Channel, MAX_RESIDUALS, Residual, median};
use crate::vehicle::{MAX_IMUS, SensorFrame};

/// Samples after which the prior spread between instances no longer widens the gate by half of σ.
const SAMPLES_TO_KNOW: f64 = 50.0;

/// Fresh samples may contradict those of the tick before for this long, s: a shock and its ringing. Pairs
/// that lie together are believed no longer than this either.
const SHOCK_S: f64 = 0.1;

/// What the vote assumes of one quantity (gyroscope or accelerometer).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoteOptions {
    /// One-sigma of one sample: noise, and what mounting and scale let instances differ in motion.
    pub sigma: f64,
    /// One-sigma between instances before anything is learned (their biases).
    pub spread: f64,
    /// Largest deviation that is taken for a bias, per axis.
    pub largest_deviation: f64,
    /// Window over which it is learned, samples.
    pub learning_samples: f64,
    /// Gate, in sigmas.
    pub gate: f64,
    /// A sample takes part in the vote this long, s: a little more than the period of one IMU.
    pub memory_s: f64,
    /// An instance that left its gate stays out this long after it came back, s.
    pub hold_off_s: f64,
}

/// The consensus of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consensus {
    /// Mean over the accepted instances.
    pub value: Vector3<f64>,
    /// How many were averaged.
    pub used: usize,
    /// Was there a majority? False when the instances contradict each other and none can be preferred.
    pub trusted: bool,
}

/// Vote over one quantity.
#[derive(Debug, Clone)]
pub struct Vote {
    options: VoteOptions,
    channels: [Channel; 3],
    latest: [Option<(FlightTime, Vector3<f64>)>; MAX_IMUS],
    deviation: [Vector3<f64>; MAX_IMUS],
    seen: [u32; MAX_IMUS],
    out_until: [Option<FlightTime>; MAX_IMUS],
    settled: Option<FlightTime>,
    slope: f64,
    /// For how long fresh samples have contradicted those of the ticks before, s.
    shock_s: f64,
}

/// One instance in the vote.
#[derive(Debug, Clone, Copy)]
struct Ballot {
    index: usize,
    /// Sample less learned deviation.
    value: Vector3<f64>,
    age_s: f64,
    fresh: bool,
    accepted: bool,
}

impl Vote {
    /// Votes on gyroscope (`channels` GYRO_*) or accelerometer (ACCEL_*) samples.
    pub fn new(options: VoteOptions, channels: [Channel; 3]) -> Self {
        Self {
            options,
            channels,
            latest: [None; MAX_IMUS],
            deviation: [Vector3::zeros(); MAX_IMUS],
            seen: [0; MAX_IMUS],
            out_until: [None; MAX_IMUS],
            settled: None,
            slope: 0.0,
            shock_s: 0.0,
        }
    }

    /// Takes the samples of this frame (`None`, or not finite: skipped). `None` when no sample is fresh.
    /// Residuals are added for fresh samples, where there are at least two instances to compare.
    pub fn vote(
        &mut self,
        now: FlightTime,
        samples: &[Option<Vector3<f64>>; MAX_IMUS],
        residuals: &mut ArrayVec<Residual, MAX_RESIDUALS>,
    ) -> Option<Consensus> {
        let o = self.options;
        let mut ballots: ArrayVec<Ballot, MAX_IMUS> = ArrayVec::new();
        let (mut change, mut changed) = (Vector3::zeros(), 0.0);
        let mut period_s = 0.0_f64;
        for (index, sample) in samples.iter().enumerate() {
            let fresh = sample.filter(|v| v.iter().all(|x| x.is_finite()));
            if let Some(value) = fresh {
                // An instance is compared with itself: between instances a lie would look like motion.
                if let Some((time, before)) = self.latest[index].filter(|_| !self.is_out(index, now)) {
                    change += value - before;
                    changed += 1.0;
                    period_s = period_s.max(now.seconds_since(time));
                }
                self.latest[index] = Some((now, value));
            }
            if let Some((time, value)) = self.latest[index] {
                let age_s = now.seconds_since(time);
                if (0.0..=o.memory_s).contains(&age_s) {
                    let value = value - self.deviation[index];
                    ballots.push(Ballot { index, value, age_s, fresh: fresh.is_some(), accepted: true });
                }
            }
        }
        if changed > 0.0 {
            self.learn_slope(now, (change / changed).amax(), period_s);
        }
        let n = ballots.len();
        if !ballots.iter().any(|b| b.fresh) {
            return None;
        }
        if n == 1 {
            return Some(self.settle(now, ballots[0].value, 1, true));
        }
        let mut centre = centre_of(ballots.iter());
        let mut moved = self.slope * ballots.iter().map(|b| b.age_s).fold(0.0, f64::max);
        if self.is_shock(now, &ballots, &centre, moved) {
            // The stale ones saw another motion: they neither vote nor are blamed.
            ballots.retain(|b| b.fresh);
            centre = centre_of(ballots.iter());
            moved = 0.0;
        }
        let n = ballots.len();

        let inside = |b: &Ballot| (b.value - centre).amax() <= o.gate * self.sigma_of(b.index, n, moved);
        // Two that lie together can accuse; where all contradict each other, nobody is to blame.
        let majority = ballots.iter().filter(|b| inside(b)).count() >= 2;
        for ballot in &mut ballots {
            let i = ballot.index;
            let sigma = self.sigma_of(i, n, moved);
            let gate = o.gate * sigma;
            let innovation = ballot.value - centre;
            let inside = innovation.iter().all(|x| x.abs() <= gate);
            if !inside && ballot.fresh && majority {
                self.out_until[i] = Some(FlightTime(now.0.saturating_add((o.hold_off_s * 1e6) as u64)));
            }
            ballot.accepted = inside && !self.is_out(i, now);
            if ballot.fresh {
                for axis in 0..3 {
                    let _ = residuals.try_push(Residual {
                        sensor: SensorId::new(SensorKind::Imu, i as u8 + 1),
                        channel: self.channels[axis],
                        innovation: innovation[axis],
                        sigma,
                        gate,
                        accepted: ballot.accepted,
                    });
                }
            }
        }

        let agreeing = ballots.iter().filter(|b| b.accepted).count();
        // Two that differ leave no majority; of three or four, two in agreement are one.
        let trusted = agreeing >= 2;
        if agreeing == 0 {
            let unblamed = ballots.iter().filter(|b| b.fresh && !self.is_out(b.index, now));
            let value = if unblamed.clone().count() > 0 { centre_of(unblamed) } else { centre };
            return Some(self.settle(now, value, n, false));
        }
        self.learn(&ballots, &centre, agreeing);
        // The fresh ones, or those of a tick ago where all the fresh ones lie.
        let any_fresh = ballots.iter().any(|b| b.accepted && b.fresh);
        let chosen = |b: &&Ballot| b.accepted && (b.fresh || !any_fresh);
        let used = ballots.iter().filter(chosen).count();
        let value = ballots.iter().filter(chosen).map(|b| b.value).sum::<Vector3<f64>>() / used as f64;
        Some(self.settle(now, value, used, trusted))
    }

    /// Has this instance been out of its gate lately?
    fn is_out(&self, index: usize, now: FlightTime) -> bool {
        self.out_until[index].is_some_and(|until| now < until)
    }

    /// One-sigma of the deviation of instance `i` among `n`, with `moved` between their samples.
    fn sigma_of(&self, i: usize, n: usize, moved: f64) -> f64 {
        let o = &self.options;
        let known = SAMPLES_TO_KNOW / (SAMPLES_TO_KNOW + f64::from(self.seen[i]));
        (o.sigma * o.sigma * (1.0 + 1.0 / n as f64) + (o.spread * known).powi(2) + moved * moved).sqrt()
    }

    /// Do the fresh samples contradict the stale ones, but not one another, and not for too long?
    fn is_shock(&mut self, now: FlightTime, ballots: &[Ballot], centre: &Vector3<f64>, moved: f64) -> bool {
        let outside = |b: &Ballot, centre: &Vector3<f64>, n: usize, moved: f64| {
            (b.value - centre).amax() > self.options.gate * self.sigma_of(b.index, n, moved)
        };
        let fresh = || ballots.iter().filter(|b| b.fresh && !self.is_out(b.index, now));
        let n = fresh().count();
        let contradicted = n < ballots.len() && fresh().any(|b| outside(b, centre, ballots.len(), moved));
        let own = centre_of(fresh());
        let together = n >= 2 && fresh().all(|b| !outside(b, &own, n, 0.0));
        let dt_s = self.settled.map_or(0.0, |time| now.seconds_since(time).clamp(0.0, self.options.memory_s));
        let shock = contradicted && together;
        // Leaks, so that a contradiction that flickers counts as well.
        self.shock_s = (self.shock_s + if shock { dt_s } else { -0.5 * dt_s }).clamp(0.0, 2.0 * SHOCK_S);
        shock && self.shock_s <= SHOCK_S
    }

    /// Remembers the consensus.
    fn settle(&mut self, now: FlightTime, value: Vector3<f64>, used: usize, trusted: bool) -> Consensus {
        self.settled = Some(now);
        Consensus { value, used, trusted }
    }

    /// `change` within one period of an instance, on average over the fresh. Instances that sample in turns
    /// lie half a period apart, and all of the change may have come within that half.
    fn learn_slope(&mut self, now: FlightTime, change: f64, period_s: f64) {
        let dt_s = self.settled.map_or(0.0, |time| now.seconds_since(time));
        if period_s > 0.0 && dt_s > 0.0 {
            let slope = (change - 2.0 * self.options.sigma).max(0.0) / (0.5 * period_s);
            // Over about 25 ms, so that it measures motion rather than noise.
            self.slope += (slope - self.slope) * (dt_s / 0.025).min(1.0);
        }
    }

    /// Moves the learned deviations towards what is seen, about the median: about the mean, a slow ramp of
    /// one instance would be shared out to the honest ones and move the consensus by a quarter of itself.
    fn learn(&mut self, ballots: &[Ballot], centre: &Vector3<f64>, agreeing: usize) {
        if agreeing < 2 {
            return;
        }
        let limit = self.options.largest_deviation;
        for ballot in ballots.iter().filter(|b| b.accepted && b.fresh) {
            let i = ballot.index;
            self.seen[i] = self.seen[i].saturating_add(1);
            // A recursive mean first, then an exponential window.
            let gain = (1.0 / f64::from(self.seen[i].max(20))).max(1.0 / self.options.learning_samples);
            self.deviation[i] = (self.deviation[i] + gain * (ballot.value - centre)).map(|x| x.clamp(-limit, limit));
        }
    }
}

/// Median of every axis.
fn centre_of<'a>(ballots: impl Iterator<Item = &'a Ballot> + Clone) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| median(ballots.clone().map(|b| b.value[axis])))
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

    const OPTIONS: VoteOptions = VoteOptions {
        sigma: 0.05,
        spread: 0.2,
        largest_deviation: 0.5,
        learning_samples: 2000.0,
        gate: 5.0,
        memory_s: 0.012,
        hold_off_s: 0.5,
    };

    fn vote() -> Vote {
        Vote::new(OPTIONS, [Channel::AccelX, Channel::AccelY, Channel::AccelZ])
    }

    /// Deterministic noise of about σ 0.03.
    fn noise(k: usize, i: usize) -> Vector3<f64> {
        Vector3::from_fn(|a, _| 0.04 * ((k * 37 + i * 101 + a * 17) as f64 * 1.618).sin())
    }

    fn run(v: &mut Vote, k: usize, bias: [f64; 4], attack: f64) -> (Consensus, ArrayVec<Residual, MAX_RESIDUALS>) {
        let mut samples = [None; MAX_IMUS];
        for (i, s) in samples.iter_mut().enumerate().take(4) {
            let lie = if i == 1 { attack } else { 0.0 };
            *s = Some(Vector3::new(bias[i] + lie, 0.0, 9.81) + noise(k, i));
        }
        let mut residuals = ArrayVec::new();
        let c = v.vote(FlightTime(k as u64 * 5000), &samples, &mut residuals).unwrap();
        (c, residuals)
    }

    #[test]
    fn one_liar_of_four_is_out_and_the_consensus_does_not_jump() {
        let bias = [0.1, -0.1, 0.05, -0.05];
        let mut v = vote();
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
            let liar = residuals.iter().find(|r| r.sensor.instance == 2 && r.channel == Channel::AccelX).unwrap();
            assert!(liar.ratio() > 1.0 && !liar.accepted);
            assert!(residuals.iter().filter(|r| r.sensor.instance != 2).all(|r| r.accepted && r.ratio() < 1.0));
            after += c.value / 2000.0;
        }
        assert!((after - before).norm() < 0.01, "{before} {after}");
    }

    #[test]
    fn a_slow_ramp_ends_at_its_gate_and_never_moves_the_consensus() {
        let mut v = vote();
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
        assert!(crossed, "a 2 m/s² lie was never seen");
    }

    #[test]
    fn pairs_that_sample_in_turns_still_outvote_a_liar() {
        // GIVEN IMUs 1, 3 on even ticks and 2, 4 on odd ones, WHEN 2 lies, THEN 4 alone is used on its ticks.
        let mut v = vote();
        for k in 0..2000u64 {
            let mut samples = [None; MAX_IMUS];
            for (i, sample) in samples.iter_mut().enumerate().take(4) {
                if k % 2 == i as u64 % 2 {
                    let lie = if i == 1 && k >= 1000 { 1.0 } else { 0.0 };
                    *sample = Some(Vector3::new(lie, 0.0, 9.81) + noise(k as usize, i));
                }
            }
            let mut residuals = ArrayVec::new();
            let c = v.vote(FlightTime(k * 5000), &samples, &mut residuals).unwrap();
            assert!(c.trusted && c.value.x.abs() < 0.15, "{c:?} at {k}");
            assert_eq!(residuals.len(), 6);
            if k >= 1000 && k % 2 == 1 {
                assert_eq!(c.used, 1);
                let liar = residuals.iter().find(|r| r.sensor.instance == 2 && r.channel == Channel::AccelX).unwrap();
                assert!(liar.ratio() > 1.0 && !liar.accepted);
            }
        }
    }

    /// IMUs 1, 3 on even ticks and 2, 4 on odd ones, with `extra(k, i)` on the x axis.
    fn in_turns(v: &mut Vote, k: u64, extra: impl Fn(u64, usize) -> f64) -> Consensus {
        let mut samples = [None; MAX_IMUS];
        for (i, sample) in samples.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
            *sample = Some(Vector3::new(extra(k, i), 0.0, 9.81) + noise(k as usize, i));
        }
        v.vote(FlightTime(k * 5000), &samples, &mut ArrayVec::new()).unwrap()
    }

    #[test]
    fn a_shock_that_all_feel_blames_nobody_and_is_believed_at_once() {
        let mut v = vote();
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
        assert!(v.out_until.iter().all(Option::is_none));
    }

    #[test]
    fn a_liar_is_blamed_in_a_shock_as_well() {
        let mut v = vote();
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
    fn a_pair_that_lies_together_is_not_trusted_after_a_shocks_time() {
        let mut v = vote();
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
        let mut v = vote();
        let mut residuals = ArrayVec::new();
        let mut samples = [None; MAX_IMUS];
        samples[0] = Some(Vector3::new(0.0, 0.0, 9.81));
        samples[2] = Some(Vector3::new(8.0, 0.0, 9.81));
        let c = v.vote(FlightTime(1), &samples, &mut residuals).unwrap();
        assert!(!c.trusted && (c.value.x - 4.0).abs() < 1e-12);
        assert!(residuals.iter().all(|r| !r.accepted));
    }

    #[test]
    fn samples_that_are_not_finite_are_skipped() {
        let mut v = vote();
        let mut residuals = ArrayVec::new();
        let mut samples = [None; MAX_IMUS];
        samples[..4].fill(Some(Vector3::new(0.0, 0.0, 9.81)));
        samples[3] = Some(Vector3::new(f64::NAN, 0.0, 0.0));
        let c = v.vote(FlightTime(1), &samples, &mut residuals).unwrap();
        assert_eq!(c.used, 3);
        assert!(v.vote(FlightTime(2), &[None; MAX_IMUS], &mut residuals).is_none());
    }
}
