//! What is told of it: the estimate, residuals, and the attacked set.

use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::{DecoderStatus, FlagReason, SensorKind};

use super::integral::Six;
use super::slot::Slot;
use super::{LANES, Lanes, noise, part};
use crate::estimate::ekf_bias::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use crate::estimate::ekf_bias::covariance::ix;
use crate::estimate::fdir::isolation::Evidence;
use crate::estimate::{Channel, Health, Motion, Residual};
use crate::sensor::SensorFrame;
use nalgebra::Vector3;

/// A tilt less certain than this is degraded, rad.
const TILT_SIGMA_DEGRADED_RAD: f64 = 0.15;
/// Lanes that contradict each other for so many slots degrade.
const CONTRADICTED_SLOTS: u32 = 25;
/// An exclusion is announced where the vote holds so much against the lane, and as long as it holds so much.
pub(super) const AGREED: f64 = 0.6;
const STILL_AGREED: f64 = 0.2;
/// Part of a climb's variance that comes of the accelerometers, the rest of what measures the altitude: of a steady Kalman filter of a
/// double integrator, whatever the noises are (poles (q/r)^¼, damping 1/√2; 3q/(2√2 ω) of √2 q/ω). Lanes differ by their accelerometers.
const CLIMB_OWN: f64 = 0.75;
/// Gate of an IMU's residual, in its σ.
const GATE: f64 = 5.0;

const CHANNELS: [Channel; 6] =
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ];

fn imu(index: usize) -> SensorId {
    SensorId::new(SensorKind::Imu, index as u8 + 1)
}

fn height(index: usize) -> SensorId {
    SensorId::new(SensorKind::Height, index as u8 + 1)
}

impl Lanes {
    /// Sensors of this frame are there.
    pub(super) fn saw(&mut self, frame: &SensorFrame) {
        for (i, _) in frame.imus.iter().enumerate().filter(|(_, sample)| sample.is_some()) {
            self.isolation.saw(imu(i), frame.time);
        }
        for (i, _) in frame.heights.iter().enumerate().filter(|(_, sample)| sample.is_some()) {
            self.isolation.saw(height(i), frame.time);
        }
    }

    /// Residuals and attacked set of a slot.
    pub(super) fn account(&mut self, slot: &Slot) {
        let evidence = &self.judges.evidence;
        let votes = self.judges.vote.against(&evidence.are_present());
        for (i, (announced, vote)) in self.fused.announced.iter_mut().zip(votes).enumerate() {
            // Announced when physics and vote agree; taken back when either no longer does.
            let agreed = vote > if *announced { STILL_AGREED } else { AGREED };
            *announced = evidence.is_excluded(i) && (agreed || evidence.is_stuck(i));
        }
        let common = self.common(&slot.imus);
        for (i, mean) in slot.imus.iter().enumerate() {
            let Some(mean) = mean else { continue };
            let (off, sigma): (Six, Six) = (mean - self.lanes[i].biases() - common, self.judges.noise.of(i));
            for ((channel, innovation), sigma) in CHANNELS.into_iter().zip(off.iter()).zip(sigma.iter()) {
                let residual = Residual::gated(imu(i), channel, *innovation, *sigma, GATE);
                let _ = self.estimate.residuals.try_push(Residual { accepted: !self.fused.announced[i], ..residual });
            }
        }
        let contradicted = self.contradicted();
        let (judges, announced, slots) = (&self.judges, &self.fused.announced, &self.slots);
        let stamped = |impossible: bool| impossible.then_some(FlagReason::Stamp);
        self.isolation.announce(slot.end(), contradicted, |sensor| {
            let i = usize::from(sensor.instance.saturating_sub(1));
            let (window_ratio, drift_ratio, reason) = match sensor.kind {
                SensorKind::Imu => {
                    let stuck = judges.evidence.is_stuck(i);
                    let reason = if stuck { FlagReason::Stuck } else { FlagReason::Window };
                    let reason = announced[i].then_some(reason);
                    (judges.evidence.ratio(i), votes[i], reason.or(stamped(slots.imu_stamps.excludes(i, slot.end()))))
                }
                _ => {
                    let reason = judges.heights.is_excluded(i).then_some(FlagReason::Window);
                    (judges.heights.ratio(i), 0.0, reason.or(stamped(slots.height_stamps.excludes(i, slot.end()))))
                }
            };
            let stuck = reason == Some(FlagReason::Stuck);
            (Evidence { window_ratio, drift_ratio, stuck, ..Evidence::default() }, reason)
        });
        self.report.time = slot.end();
        self.report.status = DecoderStatus::Solved;
        self.report.height_m = self.fused.at.position_enu_m.z;
    }

    /// The estimate at `now`.
    pub(super) fn publish(&mut self, now: FlightTime) {
        let health = self.health(now);
        let state = *self.predictor.now();
        let heights_off_sigma_m = Some(self.judges.heights.mean_off_sigma_m(state.position_enu_m.z));
        let e = &mut self.estimate;
        e.time = now;
        e.health = health;
        if health == Health::Initialising {
            e.motion = None;
            return;
        }
        let lane = &self.lanes[self.fused.best];
        let sigma = |i: usize| Vector3::from_fn(|a, _| lane.p[(i + a, i + a)].max(0.0).sqrt());
        let mut velocity_sigma_mps = sigma(ix::VELOCITY);
        // Of the mean of the lanes, not of one.
        let share: f64 = self.fused.mixture.weights.iter().map(|weight| weight * weight).sum();
        velocity_sigma_mps.z *= (1.0 - CLIMB_OWN + CLIMB_OWN * share.min(1.0)).sqrt();
        // Tilt is off by the lanes' own biases of accelerometers, and by what all of them rectify alike.
        let common = state.world_from_body.to_rotation_matrix().matrix().map(|x| x * x) * self.fused.rectified_squares;
        let mut attitude_sigma_rad = sigma(ix::ATTITUDE);
        for (about, along) in [(0, 1), (1, 0)] {
            let own = attitude_sigma_rad[about] * share.min(1.0).sqrt();
            attitude_sigma_rad[about] = own.hypot(noise::lasting_mps2(common[along]) / self.model.imus.gravity_mps2);
        }
        let altitude_known = self.aided.vertical.within(now, VERTICAL_MEMORY_S);
        e.motion = Some(Motion {
            position_enu_m: state.position_enu_m,
            velocity_enu_mps: state.velocity_enu_mps,
            position_sigma_m: Some(sigma(ix::POSITION)),
            velocity_sigma_mps: Some(velocity_sigma_mps),
            heights_off_sigma_m,
            horizontal_known: self.aided.horizontal.within(now, HORIZONTAL_MEMORY_S),
            altitude_known,
        });
        e.world_from_body = state.world_from_body * self.rates.lead();
        e.accel_bias_mps2 = Some(lane.accel_bias);
        e.gyro_bias_radps = Some(lane.gyro_bias);
        e.attitude_sigma_rad = Some(attitude_sigma_rad);
        e.body_rates_radps = self.rates.rate_radps();
    }

    /// Rate and lead of the attitude at `now`.
    pub(super) fn turn(&mut self, now: FlightTime, dt_s: f64, thrust_mps2: f64) {
        let mixture = &self.fused.mixture;
        let (mut told, mut late_s, mut weights) = ([None; LANES], 0.0, 0.0);
        let lanes = mixture.weights.iter().zip(&mixture.biases).zip(&mut told);
        for (integral, ((weight, bias), told)) in self.slots.integrals().iter().zip(lanes) {
            if let Some((time, latest)) = integral.latest(now) {
                *told = Some(latest - bias);
                late_s += now.seconds_since(time) * weight;
                weights += weight;
            }
        }
        let measured = mixture.mean(&told, 1.0).map(|mean| {
            let late_us = 1e6 * late_s / weights;
            (FlightTime(now.0.saturating_sub(late_us as u64)), part(&mean, 3))
        });
        let flies = self.thrust.flies(thrust_mps2);
        let turning = flies.then(|| self.thrust.turning_radps2(&self.rates.rate_radps()));
        self.rates.step(now, dt_s.clamp(0.0, 0.1), turning.as_ref(), measured);
    }

    /// Do sensors contradict each other so that none can be told to be healthy?
    fn contradicted(&self) -> bool {
        self.fused.contradicted > CONTRADICTED_SLOTS || self.judges.heights.split.is_contradicted()
    }

    fn health(&self, now: FlightTime) -> Health {
        if self.start.is_some() {
            return Health::Initialising;
        }
        let p = &self.lanes[self.fused.best].p;
        let tilt = p[(ix::ATTITUDE, ix::ATTITUDE)].max(p[(ix::ATTITUDE + 1, ix::ATTITUDE + 1)]);
        let tilted = tilt.is_nan() || tilt > TILT_SIGMA_DEGRADED_RAD.powi(2);
        let silent = self.fused.silent.iter().all(|slots| *slots > 2);
        let altitude_lost = self.aided.vertical.lapsed(now, VERTICAL_MEMORY_S);
        if silent || tilted || altitude_lost || self.contradicted() { Health::Degraded } else { Health::Healthy }
    }
}
