//! The estimator `secure`: slots → window → decode → isolate → filter → rewind.
//!
//! Every tick the filter takes the samples of the sensors that are not excluded (`filter.rs`), and goes through its last
//! moments again when a sensor is newly excluded (`rewind.rs`). Every slot (40 ms: [Clinic] asks for 25 Hz) the window
//! takes one value of each signal (`signals.rs`, `model.rs`), is decoded (`decode.rs`), and from the evidence
//! (`evidence.rs`) the attacked set is isolated (`fdir/isolation.rs`).
//!
//! Valid up to [`TILT_MAX_RAD`] and [`RATE_MAX_RADPS`]. Beyond, nothing is decoded: status
//! `OUTSIDE_MODEL`, health degraded, and the filter (nonlinear, with its own gates) flies on with the
//! attacked set of before. Fallbacks of a decode that came too late: the anytime iterate with its certified
//! gap, then the attacked set of before.

#[cfg(test)]
mod tests;

use nalgebra::SVector;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
pub use plumbline_proto::v1::{DecoderStatus, SecureFallback};

use super::decode::{AuditCase, FlyingDecoder};
use super::evidence::{self, Tests};
use super::filter::CleanFilter;
use super::inertial::Inertial;
use super::model::{Assumed, Quantity, SLOT_S, STATES, ix, prior};
use super::newton::Deadline;
use super::path::{Path, ResetRule};
use super::signals::{Context, Signals};
use super::{Decoded, Decoder, SecureError, Status};
use crate::estimate::fdir::isolation::{Isolation, Z_999};
use crate::estimate::{Channel, Estimate, Estimator, EstimatorKind, Health, Residual};
use crate::frames::tilt_rad;
use crate::model::airframe::Airframe;
use crate::sensor::SensorFrame;
use crate::sensor::SensorModel;
use crate::sensor::heading;
use crate::types::MotorCommand;

/// Slots of the window unless configured otherwise (\[Clinic\]: T = 10).
pub const SLOTS: usize = 10;
/// Least: through 2 slots a sensor whose attack has ended was still excluded 15 s later, through 5 after 2 s.
pub const SLOTS_MIN: usize = 5;
/// Most: 2 s.
pub const SLOTS_MAX: usize = 50;
/// Beyond this tilt the window's model is not valid.
pub const TILT_MAX_RAD: f64 = 0.7;
/// Beyond this rate the attitude turns too far within a window.
pub const RATE_MAX_RADPS: f64 = 4.0;
/// Without a stopwatch nothing is late; with one, a decode may take this long, µs.
pub const DEADLINE_US: u64 = 1000;
/// An iterate whose certified gap is larger than this isolates no sensor.
const GAP_USABLE: f64 = 1e-2;
/// A gap in time longer than this empties the window, s.
const LONGEST_GAP_S: f64 = 0.5;

/// What the last window said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowReport {
    /// Time of its end.
    pub time: FlightTime,
    /// How it ended.
    pub status: DecoderStatus,
    /// What was fallen back on.
    pub fallback: SecureFallback,
    /// Objective.
    pub objective: f64,
    /// Certified bound below it.
    pub lower_bound: f64,
    /// Iterations.
    pub iterations: u32,
    /// Decode and isolate, µs; zero without a stopwatch.
    pub solve_time_us: f64,
    /// Decoded height, m.
    pub height_m: f64,
    /// Slots closed so far: changes with each.
    pub count: u64,
}

impl Default for WindowReport {
    fn default() -> Self {
        Self {
            time: FlightTime::default(),
            status: DecoderStatus::Filling,
            fallback: SecureFallback::None,
            objective: 0.0,
            lower_bound: 0.0,
            iterations: 0,
            solve_time_us: 0.0,
            height_m: 0.0,
            count: 0,
        }
    }
}

/// The estimator. See the module.
pub struct Secure {
    model: SensorModel,
    signals: Signals,
    inertial: Inertial,
    tests: Tests,
    decoder: FlyingDecoder,
    isolation: Isolation,
    filter: CleanFilter,
    path: Path,
    reset_rule: ResetRule,
    report: WindowReport,
    estimate: Estimate,
    clock: Clock,
}

/// Where it is in flight time.
#[derive(Debug, Clone, Copy, Default)]
struct Clock {
    /// Time of the last frame, and number of the slot it was in.
    now: Option<FlightTime>,
    slot: u64,
    /// Counts nanoseconds, where windows are timed.
    stopwatch: Option<fn() -> u64>,
}

impl Secure {
    /// Nothing known yet; `slots` in its window.
    ///
    /// # Errors
    /// Sensors without noise, which cannot be whitened; a window of less than [`SLOTS_MIN`] or more than [`SLOTS_MAX`].
    pub fn new(model: SensorModel, airframe: &Airframe, slots: usize) -> Result<Self, SecureError> {
        let signals = Signals::new(&model);
        Ok(Self {
            decoder: FlyingDecoder::new(&signals, &model, slots)?,
            signals,
            inertial: Inertial::new(&model),
            tests: Tests::new(&model),
            isolation: Isolation::new(slots),
            filter: CleanFilter::new(model.clone(), airframe),
            path: Path::default(),
            reset_rule: ResetRule::default(),
            report: WindowReport::default(),
            estimate: Estimate::default(),
            clock: Clock::default(),
            model,
        })
    }

    /// The program being solved.
    pub fn decoder(&self) -> Decoder {
        self.decoder.decoder()
    }

    /// T of its window.
    pub fn slots(&self) -> usize {
        self.decoder.slots()
    }

    /// Solves another program from the next full window on; the attacked set stays. Allocates nothing.
    pub fn use_decoder(&mut self, decoder: Decoder) {
        if self.decoder.select(decoder) {
            self.restart_window();
        }
    }

    /// Times its windows with `stopwatch` (ns), which may take `limit_us`.
    pub fn time_with(&mut self, stopwatch: fn() -> u64, limit_us: Option<u64>) {
        self.clock.stopwatch = Some(stopwatch);
        self.decoder.limit(limit_us.map(|limit_us| Deadline { stopwatch, limit_us }));
    }

    /// The last window.
    pub fn window(&self) -> &WindowReport {
        &self.report
    }

    /// The attacked set.
    pub fn isolation(&self) -> &Isolation {
        &self.isolation
    }

    /// Force that neither thrust nor gravity explains, ENU, N.
    pub fn disturbance_enu_n(&self) -> nalgebra::Vector3<f64> {
        self.filter.disturbance_enu_n()
    }

    /// Filter resets to the decoder so far.
    pub fn resets(&self) -> u32 {
        self.reset_rule.resets()
    }

    /// Rewinds of the filter so far.
    pub fn rewinds(&self) -> u32 {
        self.filter.rewinds()
    }

    /// Error bound of the decoded height, m; `None` where the theory promises nothing.
    ///
    /// Of m values of which q are arbitrary, the point of least total distance lies within
    /// 2(m − q)/(m − 2q) times the radius of the healthy ones (Minsker 2015, Lemma 2.1); the radius is taken
    /// at 99.9 %. Without a majority (m ≤ 2q), or with two heights only, nothing is promised.
    pub fn height_bound_m(&self) -> Option<f64> {
        let margin = self.isolation.margin(SensorKind::Height);
        let decoded = matches!(self.report.status, DecoderStatus::Solved | DecoderStatus::MaxIterations);
        // Isolated ones are not in the decode; one more attacked and not yet isolated is allowed for.
        let m = margin.present - margin.flagged.min(margin.present);
        let unseen = usize::from(margin.flagged == 0);
        if !decoded || self.isolation.contradicted() || m <= 2 * unseen || margin.margin() <= 0 {
            return None;
        }
        let Assumed { sigma, bias, .. } = Assumed::of(Quantity::Height, &self.model);
        let heights = self.signals.iter().enumerate().filter(|(_, signal)| signal.quantity == Quantity::Height);
        let values = heights.map(|(index, _)| self.decoder.count(index)).filter(|n| *n > 0).min()?;
        let radius = Z_999 * (sigma * sigma / values as f64 + bias * bias).sqrt();
        Some(2.0 * (m - unseen) as f64 / (m - 2 * unseen) as f64 * radius)
    }

    /// Copies the last window into `case`, to be solved again where there is time; false when none was decoded. Allocates
    /// nothing.
    pub fn audit(&self, case: &mut AuditCase) -> bool {
        if self.report.status != DecoderStatus::Solved {
            return false;
        }
        let (problem, samples) = self.decoder.problem();
        case.problem.copy_from(problem);
        case.samples.clear();
        case.samples.extend_from_slice(samples);
        case.time = self.report.time;
        case.objective = self.report.objective;
        true
    }

    /// Time moves on to `now`: by how much, s, and whether a slot is over.
    fn advance(&mut self, now: FlightTime) -> (f64, bool) {
        let dt_s = self.clock.now.map_or(0.0, |last| now.seconds_since(last));
        if !(0.0..=LONGEST_GAP_S).contains(&dt_s) {
            // Time went backwards, or stood: what is in the window belongs to another flight.
            self.restart_window();
        }
        self.clock.now = Some(now);
        let slot = (now.as_seconds() / SLOT_S + 1e-6) as u64;
        let over = slot != self.clock.slot;
        self.clock.slot = slot;
        (dt_s.clamp(0.0, LONGEST_GAP_S), over)
    }

    /// Samples of this tick into their slot.
    fn gather(&mut self, frame: &SensorFrame) {
        let id = |kind, index: usize| SensorId::new(kind, index as u8 + 1);
        let state = self.filter.estimate().kinematics();
        for (i, imu) in frame.imus.iter().enumerate() {
            let Some(imu) = imu else { continue };
            self.isolation.saw(id(SensorKind::Imu, i), frame.time);
            let mag = imu.mag_ut.filter(|m| m.iter().all(|v| v.is_finite()));
            if let Some(heading) =
                mag.and_then(|mag| heading::heading(&state, &mag, self.model.imus.mag.declination_rad))
            {
                self.signals.add(id(SensorKind::Imu, i), Quantity::Heading, heading.row.innovation);
            }
        }
        self.inertial.take(frame);
        let path_m = state.position_enu_m.z - self.path.below_m();
        for (i, height) in frame.heights.iter().enumerate() {
            let Some(height) = height else { continue };
            self.isolation.saw(id(SensorKind::Height, i), frame.time);
            self.signals.add(id(SensorKind::Height, i), Quantity::Height, height.height_m - path_m);
        }
        for (i, barometer) in frame.barometers.iter().enumerate() {
            let Some(barometer) = barometer else { continue };
            self.isolation.saw(id(SensorKind::Barometer, i), frame.time);
            let altitude_m = self.model.barometers.altitude_m(barometer);
            self.signals.add(id(SensorKind::Barometer, i), Quantity::Barometer, altitude_m - path_m);
        }
        self.tests.stuck.take(frame);
    }

    /// The slot is over: its means go into the window, which is decoded, and the attacked set is isolated.
    fn close_slot(&mut self, now: FlightTime) {
        let begun = self.clock.stopwatch.map(|read| read());
        self.compare(now);
        self.decoder.push(&self.signals, &self.path.rebase());
        self.report.time = now;
        self.report.count += 1;
        self.report.fallback = SecureFallback::None;
        let estimate = self.filter.estimate();
        let turning = estimate.body_rates_radps.norm() > RATE_MAX_RADPS;
        if estimate.health == Health::Initialising || !self.decoder.is_ready() {
            self.report.status = DecoderStatus::Filling;
        } else if tilt_rad(&estimate.world_from_body) > TILT_MAX_RAD || turning {
            self.fall_back(DecoderStatus::OutsideModel);
        } else if let Some(x) = self.decode() {
            self.isolate(now);
            self.reset_filter(&x);
        }
        if let (Some(read), Some(begun)) = (self.clock.stopwatch, begun) {
            self.report.solve_time_us = read().saturating_sub(begun) as f64 * 1e-3;
        }
    }

    /// Every sensor against the others of its kind: baselines, slow deviations, IMUs that sample together.
    fn compare(&mut self, now: FlightTime) {
        let imus = self.inertial.slot(SLOT_S);
        self.inertial.begin(now);
        self.signals.close(self.clock.slot, &imus);
        let isolation = &self.isolation;
        let learning = self.tests.training.is_learning();
        let context = Context {
            isolated: |sensor| isolation.is_flagged(sensor),
            suspect: |sensor| isolation.is_suspect(sensor),
            learning,
            relearning: self.tests.training.is_relearning(),
        };
        self.signals.compare(self.path.below_m(), &context);
        let isolated = |i: usize| isolation.is_flagged(SensorId::new(SensorKind::Imu, i as u8 + 1));
        let from_median = self.signals.inertial_from_median();
        self.tests.synchronous.take(&imus.means, &from_median, isolated, &imus.scale, SLOT_S, learning);
    }

    /// The deviation from the filter at the window's end; `None` where it cannot be used.
    fn decode(&mut self) -> Option<SVector<f64, STATES>> {
        let estimate = self.filter.estimate();
        let (isolation, signals) = (&self.isolation, &self.signals);
        let of_vertical = |signal: &super::signals::Signal| !signal.quantity.is_of_imu();
        let vertical = signals.iter().enumerate().any(|(i, signal)| of_vertical(signal) && self.decoder.count(i) > 0);
        let excluded = |index: usize| signals.iter().nth(index).is_some_and(|s| isolation.is_flagged(s.sensor));
        let decoded = self.decoder.decode(excluded, &prior(estimate, vertical));
        let Ok(Decoded { x, objective, lower_bound, iterations, status }) = decoded else {
            self.fall_back(DecoderStatus::Unobservable);
            return None;
        };
        self.report.objective = objective;
        self.report.lower_bound = lower_bound;
        self.report.iterations = iterations;
        self.report.height_m = self.filter.estimate().motion_or_rest().position_enu_m.z + x[ix::Z];
        self.report.status = match status {
            Status::Solved => DecoderStatus::Solved,
            Status::MaxIterations => DecoderStatus::MaxIterations,
            Status::MaxTime => DecoderStatus::MaxTime,
            Status::Stalled => DecoderStatus::Stalled,
        };
        if status != Status::Solved {
            self.report.fallback = SecureFallback::Anytime;
            if objective - lower_bound > GAP_USABLE * objective {
                self.report.fallback = SecureFallback::PreviousSet;
                return None;
            }
        }
        Some(x)
    }

    fn fall_back(&mut self, status: DecoderStatus) {
        self.report.status = status;
        self.report.fallback = SecureFallback::PreviousSet;
        self.decoder.forget_start();
        self.reset_rule.restart();
    }

    /// The attacked set, by the evidence of this window.
    fn isolate(&mut self, now: FlightTime) {
        self.tests.training.count();
        let window = evidence::Window { decoder: &self.decoder, signals: &self.signals, tests: &self.tests };
        self.isolation.isolate(now, self.tests.training.is_learning(), |sensor| window.about(sensor));
        if self.tests.training.isolated(self.isolation.margin(SensorKind::Imu).flagged) {
            self.signals.relearn_imus();
        }
    }

    fn reset_filter(&mut self, x: &SVector<f64, STATES>) {
        let bound_m = self.height_bound_m();
        if let Some(to) = self.reset_rule.take(x, bound_m, self.filter.estimate()) {
            self.filter.reset_to(&to);
            self.restart_window();
        }
    }

    /// Empties the window and what is counted from the filter's path; the attacked set stays.
    fn restart_window(&mut self) {
        self.decoder.clear();
        self.signals.restart_slot();
        self.inertial.begin(self.clock.now.unwrap_or_default());
        self.path.begin(self.filter.vertical_corrections());
        self.reset_rule.restart();
        self.report.status = DecoderStatus::Filling;
    }

    fn publish(&mut self, received: &SensorFrame) {
        self.estimate.clone_from(self.filter.estimate());
        // Excluded sensors keep their residuals.
        let e = &mut self.estimate;
        let motion = e.motion_or_rest();
        for (i, height) in received.heights.iter().enumerate() {
            let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
            if let Some(height) = height.filter(|_| self.isolation.is_flagged(sensor)) {
                let sigma = self.model.heights.sigma.hypot(motion.position_sigma_m.map_or(0.0, |sigma| sigma.z));
                let innovation = height.height_m - motion.position_enu_m.z;
                let residual = Residual::gated(sensor, Channel::Height, innovation, sigma, self.model.heights.gate);
                let _ = e.residuals.try_push(Residual { accepted: false, ..residual });
            }
        }
        let outside = self.report.status == DecoderStatus::OutsideModel;
        if e.health == Health::Healthy && (outside || self.isolation.contradicted()) {
            e.health = Health::Degraded;
        }
        if self.filter.estimate().health == Health::Degraded && received.imus.iter().all(Option::is_none) {
            self.report.fallback = SecureFallback::Prediction;
        }
    }
}

impl Estimator for Secure {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Secure
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let (dt_s, slot_over) = self.advance(received.time);
        if slot_over {
            self.close_slot(received.time);
        }
        let baselines_m = self.signals.height_baselines_m();
        self.filter.step(received, applied, &self.isolation, &baselines_m, dt_s);
        self.path.follow(self.filter.vertical_corrections(), dt_s);
        self.gather(received);
        self.publish(received);
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}
