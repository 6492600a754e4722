//! The estimator `secure`: window, decoder, identification, and the filter on what is clean.
//!
//! Every tick the filter takes the samples of the sensors that are not flagged. Every slot (40 ms: [Clinic]
//! asks for 25 Hz) the window takes one value of each sensor, is decoded, and the attacked set is judged.
//!
//! The window's state is the deviation from the filter's own path as its IMUs alone would have continued it,
//! at the window's end, in the frame of the present heading: x y z of [Clinic]'s ten states and the mean
//! deviation of the accelerometers. Values are counted from that path, so the forced response (thrust,
//! strings, ground) is removed by measurement; the model of the deviations is linear about the trim.
//!
//! | state | what | sees it |
//! |---|---|---|
//! | z, v_z | height, climb, m, m/s | heights, barometers |
//! | v_x, v_y | m/s, heading frame | v̇_x = g pitch, v̇_y = −g roll; the filter's own σ |
//! | roll, pitch, yaw | rad | magnetometers (yaw); the filter's own σ |
//! | p, q, r | rad/s | gyroscopes |
//! | a_x a_y a_z | mean error of the accelerometers, m/s² | accelerometers |
//!
//! Valid up to [`TILT_MAX_RAD`] and [`RATE_MAX_RADPS`]. Beyond, nothing is decoded: status
//! `OUTSIDE_MODEL`, health degraded, and the filter (nonlinear, with its own gates) flies on with the
//! attacked set of before. Fallbacks of a decode that came too late: the anytime iterate with its certified
//! gap, then the attacked set of before.

use nalgebra::{SMatrix, SVector};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;
pub use plumbline_proto::v1::{DecoderStatus, SecureFallback};

use super::compress::Compressed;
use super::gated::Gated;
use super::identify::{CERTAIN, Cusum, Evidence, Identifier, Stuck, Z_999, chi_square, stuck_limit};
use super::inertial::{self, Inertial};
use super::newton::{Deadline, Settings};
use super::together::Together;
use super::window::{Model, Row, Window, room};
use super::{Decoded, Decoder, SecureError, Status, parts};
use crate::estimate::ekf_bias::EkfOptions;
use crate::estimate::imu_vote::VoteOptions;
use crate::estimate::{Channel, Estimate, Estimator, EstimatorKind, Health, Residual};
use crate::frames::tilt_rad;
use crate::model::airframe::Airframe;
use crate::model::measure::barometer::pressure_altitude_m;
use crate::model::measure::{Kinematics, heading};
use crate::vehicle::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS, MotorCommand, SensorFrame};

/// States of the window.
pub const STATES: usize = 13;
/// Indices of the window's states: those of [Clinic] 3.1 in order, then the accelerometers' mean error.
pub mod ix {
    /// Height, m.
    pub const Z: usize = 0;
    /// m/s, heading frame.
    pub const VX: usize = 1;
    /// m/s, heading frame.
    pub const VY: usize = 2;
    /// m/s.
    pub const VZ: usize = 3;
    /// rad.
    pub const ROLL: usize = 4;
    /// rad.
    pub const PITCH: usize = 5;
    /// rad.
    pub const YAW: usize = 6;
    /// rad/s; q and r follow.
    pub const P: usize = 7;
    /// m/s²; y and z follow.
    pub const AX: usize = 10;
}

/// Length of a slot, s.
pub const SLOT_S: f64 = 0.04;
/// Slots of the window unless configured otherwise ([Clinic]: T = 10).
pub const SLOTS: usize = 10;
/// Least: through 2 slots a sensor that has stopped lying was still not believed 15 s later, through 5 after 2 s.
pub const SLOTS_MIN: usize = 5;
/// Most: 2 s.
pub const SLOTS_MAX: usize = 50;
/// Beyond this tilt the window's model is not valid.
pub const TILT_MAX_RAD: f64 = 0.7;
/// Beyond this rate the attitude turns too far within a window.
pub const RATE_MAX_RADPS: f64 = 4.0;
/// Windows during which deviations are only learned: 2 s.
const LEARNING: u32 = 50;
/// Time constant with which learned deviations follow, s, …
const LEARNED_S: f64 = 20.0;
/// … once they are known: before, they are the mean of what was seen, the first of it of so many values.
const FEWEST_LESSONS: u32 = 10;
/// After a flag the loop flies on other sensors, and what the rest of them differ by (ripple of the loop at
/// their sampling rate) is learned anew during so many windows: 1 s.
const RELEARNING: u32 = 25;
/// Deviations this many slots old still take part in a median: sensors may sample in turns.
const RECENT_SLOTS: u64 = 4;
/// σ of a deviation from a median of three, in sigmas of one value.
const CUSUM_SIGMAS: f64 = 1.25;
/// Height decoded further than this from the filter …
const RESET_M: f64 = 0.06;
/// … in so many windows in a row resets the filter to it: 0.6 s.
const RESET_WINDOWS: u32 = 15;
/// Without a stopwatch nothing is late; with one, a decode may take this long, µs.
pub const DEADLINE_US: u64 = 1000;
/// An iterate whose certified gap is larger than this identifies nobody.
const GAP_USABLE: f64 = 1e-2;
/// Gap at which the flying decoder stops.
const GAP: f64 = 1e-6;
/// A gap in time longer than this empties the window, s.
const LONGEST_GAP_S: f64 = 0.5;

const ROWS_OF_IMU: usize = 7;
const HEIGHT: usize = 0;
const BAROMETER: usize = MAX_HEIGHTS;
const IMU: usize = MAX_HEIGHTS + MAX_BAROMETERS;
const SENSORS: usize = IMU + ROWS_OF_IMU * MAX_IMUS;

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
    /// Decode and identify, µs; zero without a stopwatch.
    pub solve_time_us: f64,
    /// Decoded height, m.
    pub height_m: f64,
    /// Windows decoded so far: changes with each.
    pub count: u64,
}

/// A window to be solved again by somebody else.
#[derive(Debug, Clone)]
pub struct AuditCase {
    /// Its time.
    pub time: FlightTime,
    /// The problem.
    pub problem: Compressed<STATES>,
    /// Its samples.
    pub samples: Vec<f64>,
    /// Objective that flew.
    pub objective: f64,
}

/// Sums of one slot.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    total: f64,
    samples: u32,
}

impl Sum {
    fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.total += value;
            self.samples += 1;
        }
    }

    fn take(&mut self) -> Option<f64> {
        let mean = (self.samples > 0).then(|| self.total / f64::from(self.samples));
        *self = Self::default();
        mean
    }
}

/// The estimator. See the module.
pub struct Secure {
    options: EkfOptions,
    gated: Gated,
    decoder: Decoder,
    window: Window<STATES>,
    /// That of the other coupling, empty: changed over without allocating.
    spare: Window<STATES>,
    identifier: Identifier,
    inertial: Inertial,
    together: Together,
    estimate: Estimate,
    report: WindowReport,

    now: Option<FlightTime>,
    slot: u64,
    /// Corrections of the filter already taken into the window, and where its own path is from the filter's.
    corrections: (f64, f64),
    path: (f64, f64),
    slots: [Sum; SENSORS],
    sigma: [Sigma; SENSORS],
    learned: [f64; SENSORS],
    /// Values that it was learned from.
    lessons: [u32; SENSORS],
    value: [Option<f64>; SENSORS],
    /// By how much what a row of the IMUs differs by counts less in this slot (`inertial.rs`).
    discount: [f64; 6],
    /// Slot and value of the last deviation from what the sensor should read, the learned one removed.
    deviation: [Option<(u64, f64)>; SENSORS],
    /// That of this slot less the median of all of its kind; NaN where there is none.
    from_all: [f64; SENSORS],
    cusum: [Cusum; SENSORS],
    stuck_imu: [Stuck<6>; MAX_IMUS],
    stuck_height: [Stuck<1>; MAX_HEIGHTS],
    stuck: [u32; MAX_IMUS + MAX_HEIGHTS],
    windows: u32,
    /// Windows until which deviations of IMUs are learned anew, and how many flags there were.
    relearn_until: u32,
    flags: usize,
    apart: u32,
    resets: u32,
    last: Option<SVector<f64, STATES>>,
    stopwatch: Option<fn() -> u64>,
}

impl Secure {
    /// Nothing known yet.
    ///
    /// # Errors
    /// Options without noise, which cannot be whitened.
    pub fn new(options: EkfOptions, airframe: &Airframe) -> Result<Self, SecureError> {
        let sigma = sigmas(&options);
        let settings = Settings { tolerance: GAP, ..Settings::default() };
        let kinds: [usize; SENSORS] = std::array::from_fn(kind_of);
        let slots = options.window_slots;
        if !(SLOTS_MIN..=SLOTS_MAX).contains(&slots) {
            return Err(SecureError::Slots { slots, least: SLOTS_MIN, most: SLOTS_MAX });
        }
        let window = |split| Window::new(&model(&options, &sigma, split), &rows(&sigma), &kinds, slots, settings);
        Ok(Self {
            decoder: Decoder::L2,
            window: window(false)?,
            spare: window(true)?,
            gated: Gated::new(options.clone(), airframe),
            identifier: Identifier::new(slots),
            inertial: Inertial::new(&options),
            together: Together::default(),
            estimate: Estimate::default(),
            report: WindowReport {
                time: FlightTime::default(),
                status: DecoderStatus::Filling,
                fallback: SecureFallback::None,
                objective: 0.0,
                lower_bound: 0.0,
                iterations: 0,
                solve_time_us: 0.0,
                height_m: 0.0,
                count: 0,
            },
            now: None,
            slot: 0,
            corrections: (0.0, 0.0),
            path: (0.0, 0.0),
            slots: [Sum::default(); SENSORS],
            sigma,
            learned: [0.0; SENSORS],
            lessons: [0; SENSORS],
            value: [None; SENSORS],
            discount: [1.0; 6],
            deviation: [None; SENSORS],
            from_all: [f64::NAN; SENSORS],
            cusum: [Cusum::default(); SENSORS],
            stuck_imu: [Stuck::default(); MAX_IMUS],
            stuck_height: [Stuck::default(); MAX_HEIGHTS],
            stuck: [0; MAX_IMUS + MAX_HEIGHTS],
            windows: 0,
            relearn_until: 0,
            flags: 0,
            apart: 0,
            resets: 0,
            last: None,
            stopwatch: None,
            options,
        })
    }

    /// The program being solved.
    pub fn decoder(&self) -> Decoder {
        self.decoder
    }

    /// T of its window.
    pub fn slots(&self) -> usize {
        self.options.window_slots
    }

    /// Solves another program from the next full window on; the attacked set stays. Allocates nothing.
    ///
    /// [Clinic] 3.4.1 solves position and orientation apart because two programs are smaller than one. Without the
    /// coupling no sensor's term holds states of both, so the minimum of the sum is the sum of the minima: both
    /// are found by one solve here.
    pub fn use_decoder(&mut self, decoder: Decoder) {
        let (program, split) = parts(decoder);
        if split != parts(self.decoder).1 {
            std::mem::swap(&mut self.window, &mut self.spare);
            self.start_over();
        }
        self.window.use_program(program);
        self.last = None;
        self.decoder = decoder;
    }

    /// The last window.
    pub fn window(&self) -> &WindowReport {
        &self.report
    }

    /// The attacked set.
    pub fn identifier(&self) -> &Identifier {
        &self.identifier
    }

    /// Force that neither thrust nor gravity explains, ENU, N.
    pub fn disturbance_enu_n(&self) -> nalgebra::Vector3<f64> {
        self.gated.disturbance_enu_n()
    }

    /// Filter resets to the decoder so far.
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// Error bound of the decoded height, m; `None` where the theory promises nothing.
    ///
    /// Of m values of which q are arbitrary, the point of least total distance lies within
    /// 2(m − q)/(m − 2q) times the radius of the honest ones (Minsker 2015, Lemma 2.1); the radius is taken
    /// at 99.9 %. Without a majority (m ≤ 2q), or with two heights only, nothing is promised.
    pub fn height_bound_m(&self) -> Option<f64> {
        let margin = self.identifier.margin(SensorKind::Height);
        let decoded = matches!(self.report.status, DecoderStatus::Solved | DecoderStatus::MaxIterations);
        // Flagged ones are left out of the decode; one more unseen liar is allowed for.
        let m = margin.present - margin.flagged.min(margin.present);
        let unseen = usize::from(margin.flagged == 0);
        if !decoded || self.identifier.contradicted() || m <= 2 * unseen || margin.margin() <= 0 {
            return None;
        }
        let Sigma { sigma, bias, .. } = self.sigma[HEIGHT];
        let values = (0..MAX_HEIGHTS).map(|i| self.window.count(HEIGHT + i)).filter(|n| *n > 0).min()?;
        let radius = Z_999 * (sigma * sigma / values as f64 + bias * bias).sqrt();
        Some(2.0 * (m - unseen) as f64 / (m - 2 * unseen) as f64 * radius)
    }

    /// Memory for [`Self::audit`].
    ///
    /// # Errors
    /// Never for this number of states.
    pub fn audit_case() -> Result<AuditCase, SecureError> {
        Ok(AuditCase {
            time: FlightTime::default(),
            problem: room(SENSORS, SLOTS_MAX)?,
            samples: Vec::with_capacity(SENSORS * (SLOTS_MAX + 1) + 2 * STATES),
            objective: 0.0,
        })
    }

    /// Copies the last window into `case`, for somebody with time; false when none was decoded. Allocates
    /// nothing.
    pub fn audit(&self, case: &mut AuditCase) -> bool {
        if self.report.status != DecoderStatus::Solved {
            return false;
        }
        let (problem, samples) = self.window.problem();
        case.problem.copy_from(problem);
        case.samples.clear();
        case.samples.extend_from_slice(samples);
        case.time = self.report.time;
        case.objective = self.report.objective;
        true
    }

    /// Samples of this tick into the sums of their slot.
    fn gather(&mut self, frame: &SensorFrame) {
        let now = frame.time;
        let identifier = &mut self.identifier;
        for (i, imu) in frame.imus.iter().enumerate() {
            let Some(imu) = imu else { continue };
            identifier.saw(SensorId::new(SensorKind::Imu, i as u8 + 1), now);
            let (w, f) = (imu.gyro_radps, imu.accel_mps2);
            self.stuck[i] = self.stuck_imu[i].take([w.x, w.y, w.z, f.x, f.y, f.z]);
            if let Some(mag) = imu.mag_ut.filter(|m| m.iter().all(|v| v.is_finite())) {
                let e = self.gated.estimate();
                let state = Kinematics {
                    position_enu_m: e.position_enu_m,
                    velocity_enu_mps: e.velocity_enu_mps,
                    world_from_body: e.world_from_body,
                };
                if let Some(heading) = heading::heading(&state, &mag, self.options.declination_rad) {
                    self.slots[IMU + ROWS_OF_IMU * i + 6].add(heading.row.innovation);
                }
            }
        }
        self.inertial.take(frame);
        // The filter's path without its corrections since the slot began.
        let z = self.gated.estimate().position_enu_m.z - self.path.0;
        for (i, height) in frame.heights.iter().enumerate() {
            let Some(height) = height else { continue };
            identifier.saw(SensorId::new(SensorKind::Height, i as u8 + 1), now);
            self.stuck[MAX_IMUS + i] = self.stuck_height[i].take([height.height_m]);
            self.slots[HEIGHT + i].add(height.height_m - z);
        }
        for (i, barometer) in frame.barometers.iter().enumerate() {
            let Some(barometer) = barometer else { continue };
            identifier.saw(SensorId::new(SensorKind::Barometer, i as u8 + 1), now);
            let altitude = pressure_altitude_m(barometer.pressure_pa, self.options.reference_pressure_pa);
            self.slots[BAROMETER + i].add(altitude - z);
        }
    }

    /// The filter's path without its corrections moves on.
    fn follow(&mut self, dt_s: f64) {
        let corrections = self.gated.vertical_corrections();
        let (dz, dv) = (corrections.0 - self.corrections.0, corrections.1 - self.corrections.1);
        self.corrections = corrections;
        self.path.0 += self.path.1 * dt_s + dz;
        self.path.1 += dv;
    }

    /// The slot is over: its means go into the window, which is decoded and judged.
    fn close(&mut self, now: FlightTime) {
        let begun = self.stopwatch.map(|read| read());
        self.window.advance(None);
        let inertial::Slot { deviations, discount, means, scale } = self.inertial.slot(SLOT_S);
        self.discount = discount;
        for (i, deviation) in deviations.into_iter().enumerate() {
            for (k, slot) in self.slots.iter_mut().skip(IMU + ROWS_OF_IMU * i).take(6).enumerate() {
                *slot = Sum::default();
                let told = discount.get(k).is_some_and(|less| less.is_finite());
                slot.add(deviation.filter(|_| told).and_then(|d| d.get(k).copied()).unwrap_or(f64::NAN));
            }
        }
        self.inertial.begin(now);
        for sensor in 0..SENSORS {
            self.value[sensor] = self.slots[sensor].take();
        }
        self.learn();
        let imu = |i: usize| SensorId::new(SensorKind::Imu, i as u8 + 1);
        let (identifier, learning) = (&self.identifier, self.windows < LEARNING);
        let from_all = std::array::from_fn(|i| std::array::from_fn(|k| self.from_all[IMU + ROWS_OF_IMU * i + k]));
        self.together.take(&means, &from_all, |i| identifier.is_flagged(imu(i)), &scale, SLOT_S, learning);
        for sensor in 0..SENSORS {
            if let Some(value) = self.value[sensor] {
                self.window.put(sensor, (value - self.learned[sensor]) / self.discount_of(sensor));
            }
        }
        // From now on deviations are counted from the filter's present path.
        let mut by = SVector::<f64, STATES>::zeros();
        (by[ix::Z], by[ix::VZ]) = self.path;
        self.window.rebase(&by);
        self.path = (0.0, 0.0);

        self.report.time = now;
        self.report.count += 1;
        self.report.fallback = SecureFallback::None;
        let estimate = self.gated.estimate();
        let turning = estimate.body_rates_radps.norm() > RATE_MAX_RADPS;
        if estimate.health == Health::Initialising || !self.window.is_ready() {
            self.report.status = DecoderStatus::Filling;
        } else if tilt_rad(&estimate.world_from_body) > TILT_MAX_RAD || turning {
            self.fall_back(DecoderStatus::OutsideModel);
        } else {
            self.decode(now);
        }
        if let (Some(read), Some(begun)) = (self.stopwatch, begun) {
            self.report.solve_time_us = read().saturating_sub(begun) as f64 * 1e-3;
        }
    }

    fn fall_back(&mut self, status: DecoderStatus) {
        self.report.status = status;
        self.report.fallback = SecureFallback::PreviousSet;
        self.last = None;
        self.apart = 0;
    }

    fn decode(&mut self, now: FlightTime) {
        let e = self.gated.estimate();
        let (v, a) = (e.velocity_sigma_mps, e.attitude_sigma_rad);
        // A vehicle without heights and barometers still has IMUs to judge.
        let vertical = (HEIGHT..IMU).any(|sensor| self.window.count(sensor) > 0);
        let prior = [
            (ix::Z, if vertical { f64::INFINITY } else { e.position_sigma_m.z.clamp(0.05, 10.0) }),
            (ix::VX, v.x.clamp(0.05, 5.0)),
            (ix::VY, v.y.clamp(0.05, 5.0)),
            (ix::VZ, 2.0),
            (ix::ROLL, a.x.clamp(0.005, 1.0)),
            (ix::PITCH, a.y.clamp(0.005, 1.0)),
            (ix::YAW, 0.5),
            (ix::P, 2.0),
            (ix::P + 1, 2.0),
            (ix::P + 2, 2.0),
            (ix::AX, 10.0),
            (ix::AX + 1, 10.0),
            (ix::AX + 2, 10.0),
        ];
        let identifier = &self.identifier;
        let decoded = self.window.decode(|sensor| identifier.is_flagged(device_of(sensor)), &prior, self.last.as_ref());
        let Ok(Decoded { x, objective, lower_bound, iterations, status }) = decoded else {
            return self.fall_back(DecoderStatus::Unobservable);
        };
        self.last = Some(x);
        self.report.objective = objective;
        self.report.lower_bound = lower_bound;
        self.report.iterations = iterations;
        self.report.height_m = e.position_enu_m.z + x[ix::Z];
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
                return;
            }
        }
        self.windows = self.windows.saturating_add(1);
        self.judge(now);
        self.keep_together(&x);
    }

    fn judge(&mut self, now: FlightTime) {
        let Self { window, cusum, stuck, identifier, options, windows, relearn_until, together, .. } = self;
        let relearning = *windows < *relearn_until;
        let imu_stuck = stuck_limit(options.gyro_vote.sigma, 0.5 * options.gyro_vote.sigma);
        let height_stuck = stuck_limit(options.height_sigma_m, 1e-3);
        // A group of which none moves is not stuck: it is logged twice, or silent.
        let moving = |part: std::ops::Range<usize>| stuck.get(part).unwrap_or_default().contains(&0);
        let (imus_move, heights_move) = (moving(0..MAX_IMUS), moving(MAX_IMUS..MAX_IMUS + MAX_HEIGHTS));
        identifier.judge(now, *windows < LEARNING, |id| {
            let i = usize::from(id.instance.saturating_sub(1));
            let (sensors, is_stuck) = match id.kind {
                SensorKind::Imu => {
                    let first = IMU + ROWS_OF_IMU * i;
                    (first..first + ROWS_OF_IMU, imus_move && stuck.get(i).is_some_and(|n| *n >= imu_stuck))
                }
                SensorKind::Height => (
                    HEIGHT + i..HEIGHT + i + 1,
                    heights_move && stuck.get(MAX_IMUS + i).is_some_and(|n| *n >= height_stuck),
                ),
                _ => (BAROMETER + i..BAROMETER + i + 1, false),
            };
            let mut evidence = Evidence { stuck: is_stuck, ..Evidence::default() };
            for sensor in sensors {
                let statistic = window.statistic(sensor);
                if statistic.values > 0 {
                    let ratio = statistic.square / chi_square(statistic.values, Z_999);
                    evidence.window_ratio = evidence.window_ratio.max(ratio);
                }
                let drift = cusum.get(sensor).copied().unwrap_or_default();
                if drift.ratio() > evidence.drift_ratio {
                    evidence.drift_ratio = drift.ratio();
                    evidence.drift_s = SLOT_S * f64::from(drift.lasts());
                }
            }
            if let Some(slots) = together.doubted_for(i).filter(|_| id.kind == SensorKind::Imu) {
                evidence.apart = true;
                evidence.drift_s = evidence.drift_s.max(SLOT_S * f64::from(slots));
            }
            if relearning && id.kind == SensorKind::Imu {
                // What is in the window was counted from what had been learned before: only what is certain counts.
                evidence.window_ratio /= CERTAIN;
            }
            evidence
        });
        let flags = self.identifier.margin(SensorKind::Imu).flagged;
        if flags != self.flags {
            self.flags = flags;
            self.relearn_until = self.windows.saturating_add(RELEARNING);
            // Who is in doubt already is not excused.
            let others =
                self.cusum.iter_mut().zip(&mut self.lessons).skip(IMU).filter(|(cusum, _)| !cusum.is_in_doubt());
            others.for_each(|(cusum, lessons)| (*cusum, *lessons) = (Cusum::default(), 0));
        }
    }

    /// Constant deviations are learned and slow ones summed up, both from the median of the instances.
    fn learn(&mut self) {
        self.from_all = [f64::NAN; SENSORS];
        for sensor in 0..SENSORS {
            let Some(value) = self.value[sensor] else { continue };
            let reference = if sensor < IMU { self.path.0 } else { 0.0 };
            let deviation = (value - reference - self.learned[sensor]) / self.discount_of(sensor);
            self.deviation[sensor] = Some((self.slot, deviation));
        }
        for row in 0..ROWS_OF_IMU {
            self.compare(&std::array::from_fn::<_, MAX_IMUS, _>(|i| IMU + ROWS_OF_IMU * i + row));
        }
        let heights = std::array::from_fn::<_, MAX_HEIGHTS, _>(|i| HEIGHT + i);
        self.compare(&heights);
        self.centre(&heights);
        // A barometer's offset wanders without bound.
        for sensor in BAROMETER..IMU {
            let Some((_, deviation)) = self.deviation[sensor].filter(|(slot, _)| *slot == self.slot) else { continue };
            let learning = self.windows < LEARNING;
            if learning || !self.identifier.is_suspect(device_of(sensor)) {
                self.learned[sensor] += if learning { 0.3 } else { SLOT_S / LEARNED_S } * deviation;
            }
        }
    }

    /// By how much what `sensor` differs by counts less now. What has been learned of it, a constant, is removed first.
    fn discount_of(&self, sensor: usize) -> f64 {
        let row = sensor.checked_sub(IMU).map(|row| row % ROWS_OF_IMU);
        row.and_then(|row| self.discount.get(row).copied()).unwrap_or(1.0)
    }

    /// `members` measure the same thing, some of them in turns.
    fn compare(&mut self, members: &[usize]) {
        let mut sorted: arrayvec::ArrayVec<f64, { MAX_IMUS + MAX_HEIGHTS }> = arrayvec::ArrayVec::new();
        for sensor in members {
            let recent = self.deviation[*sensor].filter(|(slot, _)| self.slot.saturating_sub(*slot) < RECENT_SLOTS);
            if let Some((_, deviation)) = recent.filter(|_| !self.identifier.is_flagged(device_of(*sensor))) {
                let _ = sorted.try_push(deviation);
            }
        }
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len();
        let Some((low, high)) = sorted.get(n.saturating_sub(1) / 2).zip(sorted.get(n / 2)) else { return };
        let median = 0.5 * (low + high);
        let imus = members.first().is_some_and(|sensor| *sensor >= IMU);
        let learning = self.windows < LEARNING || (imus && self.windows < self.relearn_until);
        for sensor in members {
            let Some((_, deviation)) = self.deviation[*sensor].filter(|(slot, _)| *slot == self.slot) else { continue };
            let deviation = deviation - median;
            self.from_all[*sensor] = deviation;
            let Sigma { sigma, bias, limit } = self.sigma[*sensor];
            let in_doubt = self.cusum[*sensor].is_in_doubt();
            // Two can contradict each other, but not outvote.
            if (!learning || in_doubt) && n >= 3 {
                self.cusum[*sensor].take(deviation / (CUSUM_SIGMAS * sigma.hypot(0.5 * bias)));
            }
            let device = device_of(*sensor);
            let learnable = learning || !self.identifier.is_suspect(device);
            // What begins to drift is not learned away.
            if !self.identifier.is_flagged(device) && learnable && self.cusum[*sensor].is_calm() {
                let lessons = self.lessons[*sensor].saturating_add(1).max(FEWEST_LESSONS);
                self.lessons[*sensor] = lessons;
                let gain = (1.0 / f64::from(lessons)).max(SLOT_S / LEARNED_S);
                self.learned[*sensor] = (self.learned[*sensor] + gain * deviation).clamp(-limit, limit);
            }
        }
    }

    /// Learned about the mean of all while nobody is left out: then it does not matter who is.
    fn centre(&mut self, members: &[usize]) {
        let heard = || members.iter().filter(|sensor| self.deviation[**sensor].is_some());
        let count = heard().count();
        if count == 0 || heard().any(|sensor| self.identifier.is_flagged(device_of(*sensor))) {
            return;
        }
        let mean = heard().map(|sensor| self.learned[*sensor]).sum::<f64>() / count as f64;
        for sensor in members.iter().filter(|sensor| self.deviation[**sensor].is_some()) {
            self.learned[*sensor] -= mean;
        }
    }

    /// The reset rule: a filter that stays away from a decoder which has a majority is moved to it.
    fn keep_together(&mut self, x: &SVector<f64, STATES>) {
        let promised = self.height_bound_m();
        let limit = promised.map_or(f64::INFINITY, |bound| bound.max(RESET_M));
        self.apart = if x[ix::Z].abs() > limit { self.apart + 1 } else { 0 };
        if self.apart >= RESET_WINDOWS {
            self.apart = 0;
            self.resets += 1;
            let mut to = self.gated.estimate().clone();
            to.position_enu_m.z += x[ix::Z];
            to.velocity_enu_mps.z += x[ix::VZ];
            to.position_sigma_m.z = promised.unwrap_or(0.1);
            to.velocity_sigma_mps.z = 0.2;
            self.gated.reset_to(&to);
            self.start_over();
        }
    }

    /// The window and what is counted from the filter's path; flags stay.
    fn start_over(&mut self) {
        self.window.clear();
        self.slots = [Sum::default(); SENSORS];
        self.inertial.begin(self.now.unwrap_or_default());
        self.path = (0.0, 0.0);
        self.corrections = self.gated.vertical_corrections();
        self.last = None;
        self.apart = 0;
        self.report.status = DecoderStatus::Filling;
    }

    fn publish(&mut self, received: &SensorFrame) {
        self.estimate.clone_from(self.gated.estimate());
        // Who is left out is shown as well.
        let e = &mut self.estimate;
        for (i, height) in received.heights.iter().enumerate() {
            let sensor = SensorId::new(SensorKind::Height, i as u8 + 1);
            if let Some(height) = height.filter(|_| self.identifier.is_flagged(sensor)) {
                let sigma = self.options.height_sigma_m.hypot(e.position_sigma_m.z);
                let _ = e.residuals.try_push(Residual {
                    sensor,
                    channel: Channel::Height,
                    innovation: height.height_m - e.position_enu_m.z,
                    sigma,
                    gate: self.options.gates.height * sigma,
                    accepted: false,
                });
            }
        }
        let outside = self.report.status == DecoderStatus::OutsideModel;
        if e.health == Health::Healthy && (outside || self.identifier.contradicted()) {
            e.health = Health::Degraded;
        }
        if self.gated.estimate().health == Health::Degraded && received.imus.iter().all(Option::is_none) {
            self.report.fallback = SecureFallback::Prediction;
        }
    }
}

impl Estimator for Secure {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Secure
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        let dt_s = self.now.map_or(0.0, |last| now.seconds_since(last));
        if !(0.0..=LONGEST_GAP_S).contains(&dt_s) {
            // Time went backwards, or stood: what is in the window belongs to another flight.
            self.start_over();
        }
        let dt_s = dt_s.clamp(0.0, LONGEST_GAP_S);
        self.now = Some(now);
        let slot = (now.as_seconds() / SLOT_S + 1e-6) as u64;
        if slot != self.slot {
            self.slot = slot;
            self.close(now);
        }
        let learned_m = std::array::from_fn(|i| self.learned.get(HEIGHT + i).copied().unwrap_or_default());
        self.gated.step(received, applied, &self.identifier, &learned_m, dt_s);
        self.follow(dt_s);
        self.gather(received);
        self.publish(received);
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn reset_to(&mut self, estimate: &Estimate) {
        self.gated.reset_to(estimate);
        self.estimate = self.gated.estimate().clone();
        self.start_over();
    }

    fn secure(&self) -> Option<&Secure> {
        Some(self)
    }

    fn use_decoder(&mut self, decoder: Decoder) -> bool {
        Secure::use_decoder(self, decoder);
        true
    }

    fn time_with(&mut self, stopwatch: fn() -> u64, limit_us: Option<u64>) {
        self.stopwatch = Some(stopwatch);
        let deadline = limit_us.map(|limit_us| Deadline { stopwatch, limit_us });
        for window in [&mut self.window, &mut self.spare] {
            let settings = Settings { deadline, ..*window.newton().settings() };
            window.newton().settle_for(settings);
        }
    }
}

/// The sensor that a row of the window belongs to.
fn device_of(sensor: usize) -> SensorId {
    let (kind, index) = match sensor {
        s if s < BAROMETER => (SensorKind::Height, s - HEIGHT),
        s if s < IMU => (SensorKind::Barometer, s - BAROMETER),
        s => (SensorKind::Imu, (s - IMU) / ROWS_OF_IMU),
    };
    SensorId::new(kind, index as u8 + 1)
}

/// Which of [`rows`] a sensor has: one for each quantity.
fn kind_of(sensor: usize) -> usize {
    match sensor {
        s if s < BAROMETER => 0,
        s if s < IMU => 1,
        s => 2 + (s - IMU) % ROWS_OF_IMU,
    }
}

/// What is assumed of one sensor's value in a slot.
#[derive(Debug, Clone, Copy)]
struct Sigma {
    /// Noise.
    sigma: f64,
    /// Constant deviation that stays unlearned: β of its row.
    bias: f64,
    /// Largest deviation that is learned.
    limit: f64,
}

fn sigmas(options: &EkfOptions) -> [Sigma; SENSORS] {
    // A vote's memory is 1.25 periods of an IMU.
    let samples = |memory_s: f64| (SLOT_S / (memory_s / 1.25).clamp(1e-3, SLOT_S)).max(1.0);
    // IMUs that sample in turns see the ripple of the loop at their own phase: as much as honest units spread.
    let imu = |vote: &VoteOptions, least: f64| Sigma {
        sigma: vote.sigma.max(least) / samples(vote.memory_s).sqrt(),
        bias: vote.spread,
        limit: 3.0 * vote.spread,
    };
    let height = options.height_sigma_m.max(1e-3);
    let barometer = options.barometer_sigma_m.max(0.01);
    let heading = options.heading_floor_rad.max(1e-3);
    std::array::from_fn(|sensor| match kind_of(sensor) {
        0 => Sigma { sigma: height, bias: 0.25 * height, limit: 2.0 * height },
        1 => Sigma { sigma: barometer, bias: 0.5 * barometer, limit: f64::INFINITY },
        2..5 => imu(&options.gyro_vote, 1e-4),
        5..8 => imu(&options.accel_vote, 1e-3),
        _ => Sigma { sigma: heading, bias: heading, limit: 6.0 * heading },
    })
}

/// One row for each quantity.
fn rows(sigma: &[Sigma; SENSORS]) -> [Row<STATES>; 2 + ROWS_OF_IMU] {
    let seen = [ix::Z, ix::Z, ix::P, ix::P + 1, ix::P + 2, ix::AX, ix::AX + 1, ix::AX + 2, ix::YAW];
    std::array::from_fn(|kind| {
        let sensor = (0..SENSORS).find(|s| kind_of(*s) == kind).unwrap_or_default();
        let mut c = SVector::zeros();
        c[seen[kind]] = 1.0;
        Row { c, sigma: sigma[sensor].sigma, bias_sigma: sigma[sensor].bias }
    })
}

/// Deviations about the trim over one slot, exact: F⁴ = 0. Split, a tilt makes no speed.
fn model(options: &EkfOptions, sigma: &[Sigma; SENSORS], split: bool) -> Model<STATES> {
    let mut f = SMatrix::<f64, STATES, STATES>::zeros();
    f[(ix::Z, ix::VZ)] = 1.0;
    if !split {
        f[(ix::VX, ix::PITCH)] = options.gravity_mps2;
        f[(ix::VY, ix::ROLL)] = -options.gravity_mps2;
    }
    for k in 0..3 {
        f[(ix::ROLL + k, ix::P + k)] = 1.0;
    }
    let f = f * SLOT_S;
    let a = SMatrix::identity() + f + f * f * 0.5 + f * f * f * (1.0 / 6.0);
    let mut q = SVector::<f64, STATES>::zeros();
    // The IMUs' path over a slot: a quarter of a bias, vibration, and what turns between samples.
    let climb = 0.25 * options.accel_bias_prior_mps2 * SLOT_S + options.accel_noise_density * SLOT_S.sqrt();
    q[ix::Z] = (0.2e-3f64).powi(2);
    q[ix::VZ] = climb * climb;
    for (state, sigma) in [(ix::VX, 0.02), (ix::VY, 0.02), (ix::ROLL, 1e-3), (ix::PITCH, 1e-3), (ix::YAW, 1e-3)] {
        q[state] = sigma * sigma;
    }
    for k in 0..3 {
        q[ix::P + k] = (0.3 * sigma[IMU].sigma).powi(2);
        q[ix::AX + k] = (0.3 * sigma[IMU + 3].sigma).powi(2);
    }
    Model { a, q: SMatrix::from_diagonal(&q) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{HeightSample, ImuSample};
    use nalgebra::Vector3;

    /// Bounded pseudo-noise of unit variance.
    fn noise(k: u64, i: u64) -> f64 {
        1.414 * ((k * 7919 + i * 104_729) as f64 * 0.618).sin()
    }

    /// A vehicle at rest at 0.5 m: four IMUs, and heights that read `heights[i]` more.
    fn frame(k: u64, heights: &[f64]) -> SensorFrame {
        let time = FlightTime(k * 5000);
        let mut frame = SensorFrame { time, ..SensorFrame::default() };
        for (i, imu) in frame.imus.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
            let n = |a: u64| noise(k, 10 * i as u64 + a);
            *imu = Some(ImuSample {
                time,
                gyro_radps: Vector3::new(n(0), n(1), n(2)) * 0.003,
                accel_mps2: Vector3::new(n(3) * 0.05, n(4) * 0.05, 9.81 + n(5) * 0.05),
                mag_ut: Some(Vector3::new(0.0, 20.0, -40.0)),
                temperature_c: 20.0,
            });
        }
        for (i, (slot, more)) in frame.heights.iter_mut().zip(heights).enumerate() {
            if k % 20 == 7 * i as u64 {
                *slot = Some(HeightSample { time, height_m: 0.5 + more + 0.005 * noise(k, 50 + i as u64) });
            }
        }
        frame
    }

    fn secure() -> Secure {
        Secure::new(EkfOptions::default(), &Airframe::iris()).unwrap()
    }

    fn fly(secure: &mut Secure, from_s: f64, to_s: f64, heights: &[f64]) {
        for k in (from_s * 200.0) as u64..(to_s * 200.0) as u64 {
            secure.step(&frame(k, heights), &MotorCommand::default());
        }
    }

    #[test]
    fn at_rest_it_decodes_the_height_with_a_bound_and_flags_nobody() {
        let mut s = secure();
        fly(&mut s, 0.0, 8.0, &[0.0; 3]);
        assert_eq!(s.window().status, DecoderStatus::Solved);
        assert!((s.window().height_m - 0.5).abs() < s.height_bound_m().unwrap(), "{:?}", s.window());
        assert!(s.window().objective - s.window().lower_bound <= 2.0 * GAP * s.window().objective);
        assert!(s.identifier().devices().iter().all(|d| d.flagged.is_none()));
        assert_eq!(s.estimate().health, Health::Healthy);
        assert_eq!(s.identifier().margin(SensorKind::Height).margin(), 3);
    }

    #[test]
    fn a_lie_is_flagged_and_the_promise_shrinks_to_what_is_left() {
        let mut s = secure();
        fly(&mut s, 0.0, 6.0, &[0.0; 3]);
        fly(&mut s, 6.0, 8.0, &[0.0, 0.3, 0.0]);
        assert!(s.identifier().is_flagged(SensorId::new(SensorKind::Height, 2)));
        assert!((s.estimate().position_enu_m.z - 0.5).abs() < 0.02, "{}", s.estimate().position_enu_m.z);
        assert_eq!(s.identifier().margin(SensorKind::Height).margin(), 1);
        // A second liar: nothing is promised any more.
        fly(&mut s, 8.0, 10.0, &[0.4, 0.3, 0.0]);
        assert!(s.height_bound_m().is_none(), "{:?}", s.identifier().devices());
    }

    #[test]
    fn a_height_that_is_left_out_takes_its_learned_deviation_with_it() {
        let mut s = secure();
        let mut mean = |from: u64, to: u64, heights: &[f64]| {
            let heard = (from..to).map(|k| s.step(&frame(k, heights), &MotorCommand::default()).position_enu_m.z);
            let last = heard.skip((to - from) as usize - 400);
            (last.sum::<f64>() / 400.0, s.identifier().margin(SensorKind::Height).flagged)
        };
        let (before, nobody) = mean(0, 2400, &[0.008, -0.002, 0.0]);
        let (after, flagged) = mean(2400, 3400, &[0.508, -0.002, 0.0]);
        assert_eq!((nobody, flagged), (0, 1));
        // About their mean, not about that of the two that are left, 3 mm lower.
        assert!((before - 0.502).abs() < 1.5e-3 && (after - before).abs() < 1.5e-3, "{before} {after}");
    }

    #[test]
    fn an_imu_that_drifted_is_taken_out_of_the_last_moments_as_well() {
        // A ramp of 0.5 m/s³ upward in IMU 2 from 6 s on, until a while after it is left out.
        let flown = |ramp: f64| {
            let mut s = secure();
            let liar = SensorId::new(SensorKind::Imu, 2);
            let mut left_out_at = None;
            for k in 0..1800 {
                let mut frame = frame(k, &[0.0; 3]);
                let t = k as f64 * 0.005;
                if let Some(imu) = &mut frame.imus[1] {
                    imu.accel_mps2.z += ramp * (t - 6.0).max(0.0);
                }
                s.step(&frame, &MotorCommand::default());
                if s.identifier().withheld().contains(liar) {
                    left_out_at = left_out_at.or(Some(t));
                }
            }
            (s.estimate().clone(), left_out_at, s.gated.rewinds())
        };
        let (honest, never, none) = flown(0.0);
        let (lied, at, rewinds) = flown(0.5);
        assert!(never.is_none() && none == 0 && rewinds >= 1, "{never:?} {none} {rewinds}");
        assert!(at.unwrap() < 8.0, "{at:?}");
        let bias = (lied.accel_bias_mps2.z - honest.accel_bias_mps2.z).abs();
        let climb = lied.velocity_enu_mps.z.abs();
        assert!(bias < 0.02 && climb < 0.01, "{bias} {climb}");
    }

    #[test]
    fn a_constant_difference_learned_at_rest_accuses_nobody_in_vibration() {
        let mut s = secure();
        for k in 0..4000 {
            let mut frame = frame(k, &[0.0; 3]);
            let vibration = if k < 1200 { 0.0 } else { noise(k, 99) };
            for (i, imu) in frame.imus.iter_mut().enumerate().filter_map(|(i, imu)| Some((i, imu.as_mut()?))) {
                imu.accel_mps2.z += vibration + if i == 2 { 0.3 } else { 0.0 };
            }
            s.step(&frame, &MotorCommand::default());
            assert!(s.identifier().withheld().is_empty(), "{k}: {:?}", s.identifier().devices());
        }
    }

    #[test]
    fn every_decoder_finds_the_lie_and_a_change_of_decoder_keeps_the_attacked_set() {
        for decoder in [Decoder::L2, Decoder::L1, Decoder::L2Split, Decoder::L1Split] {
            let mut s = secure();
            s.use_decoder(decoder);
            fly(&mut s, 0.0, 6.0, &[0.0; 3]);
            assert_eq!(s.window().status, DecoderStatus::Solved, "{decoder:?}");
            assert!((s.window().height_m - 0.5).abs() < 0.01, "{decoder:?}: {:?}", s.window());
            assert!(s.identifier().devices().iter().all(|d| d.flagged.is_none()), "{decoder:?}");
            fly(&mut s, 6.0, 8.0, &[0.0, 0.3, 0.0]);
            let flagged = |s: &Secure| s.identifier().devices().iter().filter(|d| d.flagged.is_some()).count();
            let liar = SensorId::new(SensorKind::Height, 2);
            assert!(s.identifier().is_flagged(liar) && flagged(&s) == 1, "{decoder:?}");
            let other = if decoder == Decoder::L2 { Decoder::L1Split } else { Decoder::L2 };
            s.use_decoder(other);
            fly(&mut s, 8.0, 9.0, &[0.0, 0.3, 0.0]);
            assert_eq!((s.decoder(), s.window().status), (other, DecoderStatus::Solved));
            assert!(s.identifier().is_flagged(liar) && flagged(&s) == 1, "{decoder:?} to {other:?}");
        }
    }

    #[test]
    fn windows_of_any_length_find_the_lie_and_accuse_nobody_else() {
        for slots in [SLOTS_MIN, 20, SLOTS_MAX] {
            let options = EkfOptions { window_slots: slots, ..EkfOptions::default() };
            let mut s = Secure::new(options, &Airframe::iris()).unwrap();
            fly(&mut s, 0.0, 8.0, &[0.0; 3]);
            assert_eq!(s.window().status, DecoderStatus::Solved, "{slots} slots");
            assert!(s.identifier().devices().iter().all(|d| d.flagged.is_none()), "{slots} slots");
            fly(&mut s, 8.0, 11.0, &[0.0, 0.3, 0.0]);
            let flagged: Vec<_> = s.identifier().devices().iter().filter(|d| d.flagged.is_some()).collect();
            assert!(
                flagged.len() == 1 && flagged[0].sensor == SensorId::new(SensorKind::Height, 2),
                "{slots}: {flagged:?}"
            );
            assert!((s.estimate().position_enu_m.z - 0.5).abs() < 0.01, "{slots}: {}", s.estimate().position_enu_m.z);
        }
        for slots in [SLOTS_MIN - 1, SLOTS_MAX + 1] {
            let options = EkfOptions { window_slots: slots, ..EkfOptions::default() };
            assert!(Secure::new(options, &Airframe::iris()).is_err());
        }
    }

    #[test]
    fn two_heights_that_contradict_each_other_promise_nothing_and_are_told() {
        let mut s = secure();
        fly(&mut s, 0.0, 6.0, &[0.0; 2]);
        assert!(s.height_bound_m().is_none(), "two heights guarantee nothing");
        fly(&mut s, 6.0, 9.0, &[0.0, 0.1]);
        let flagged = s.identifier().margin(SensorKind::Height).flagged;
        assert!(flagged <= 1, "{:?}", s.identifier().devices());
        assert!(s.height_bound_m().is_none());
    }

    #[test]
    fn garbage_gaps_and_time_running_backwards_never_panic_nor_poison_the_estimate() {
        let mut s = secure();
        fly(&mut s, 0.0, 5.0, &[0.0; 3]);
        for k in 1000..1100 {
            let mut bad = frame(k, &[f64::NAN, f64::INFINITY, -1e300]);
            bad.imus.iter_mut().flatten().for_each(|imu| imu.gyro_radps.x = f64::NAN);
            s.step(&bad, &MotorCommand { throttle: [f64::NAN; 4] });
        }
        assert!(s.estimate().position_enu_m.iter().all(|v| v.is_finite()));
        assert!(s.disturbance_enu_n().iter().all(|v| v.is_finite()));
        fly(&mut s, 2.0, 2.1, &[0.0; 3]);
        assert_eq!(s.window().status, DecoderStatus::Filling, "time went backwards: another flight's window is void");
        for k in 0..200 {
            let empty = SensorFrame { time: FlightTime(3_000_000 + k * 5000), ..SensorFrame::default() };
            s.step(&empty, &MotorCommand::default());
        }
        assert_eq!(s.estimate().health, Health::Degraded);
        assert_eq!(s.window().fallback, SecureFallback::Prediction);
        let never = secure().step(&SensorFrame::default(), &MotorCommand::default()).health;
        assert_eq!(never, Health::Initialising);
    }
}
