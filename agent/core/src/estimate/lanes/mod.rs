//! Secure estimation by lanes: one error-state filter for each IMU, weighted by what they predict of all other sensors.
//!
//! A lane has its own biases and a noise measured from data (`noise.rs`), so that vibration widens its covariance instead
//! of blinding it. All lanes are corrected by the same sensors and couplings (`rows.rs`), at a fusion horizon
//! 100 ms back, once for each slot of 40 ms. Evidence from their predictions (`evidence.rs`) and a small majority vote
//! (`vote.rs`) give their weights; the laser heights are judged as a group (`heights.rs`), and where they step against the
//! accelerometers (`split.rs`). By how much stamps are late is learned from a vehicle that moves (`delays.rs`). The
//! estimate is the weighted mean of the lanes, brought from the horizon to now (`predictor.rs`), rate and attitude by the
//! torques as commanded (`rates.rs`).
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | p, v, R, b_a, b_g | as in `ekf_bias`, one for each lane | m, m/s, –, m/s², rad/s |
//! | f, ω | means of one IMU over a slot (`integral.rs`) | m/s², rad/s |
//! | σ_i | measured noise of lane i | m/s², rad/s |
//! | w_i | weight of lane i; Σ w_i = 1 | – |
//!
//! An exclusion is announced only where evidence and vote agree, or where a sensor repeats itself: under vibration healthy
//! lanes lose the evidence for a while, which costs nothing. Two IMUs against two others is a tie that no physics at this
//! horizon breaks without pose or GNSS: it is declared, as degraded health; so are heights most of which step at once while
//! the accelerometers say that the others are right: then no height is used and the supervisor descends.
//!
//! Valid as `ekf_bias` is; camera ranges are not used. Allocates nothing after construction.

mod account;
mod bound;
pub mod delays;
mod evidence;
mod fusion;
mod heights;
mod integral;
pub mod judged;
mod lane;
pub mod lateral;
pub mod linear;
mod noise;
mod predictor;
mod rates;
mod rows;
mod slot;
mod split;
mod stamps;
mod start;
#[cfg(test)]
mod tests;
mod thrust;
mod vote;
mod yaw;

use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use self::delays::{Delays, Learned};
use self::evidence::Evidence;
use self::heights::Heights;
use self::integral::Six;
use self::lane::Lane;
use self::noise::{Noise, Shaken};
use self::predictor::{Mixture, Predictor};
use self::rates::Rates;
use self::slot::Slots;
use self::start::Start;
use self::thrust::Thrust;
use self::vote::Vote;
use self::yaw::Yaw;
use super::aiding::floor::Floor;
use super::aiding::freshness::Freshness;
use super::aiding::idle::Idle;
use super::fdir::isolation::Isolation;
use super::secure::WindowReport;
use super::{Estimate, Estimator, EstimatorKind, median};
use crate::model::airframe::Airframe;
use crate::sensor::measure::Kinematics;
use crate::sensor::{MAX_IMUS, SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// A lane for each IMU.
const LANES: usize = MAX_IMUS;
/// One value for each lane.
type PerLane<T> = [T; LANES];
/// A slot, µs and s.
const SLOT_US: u64 = 40_000;
const SLOT_S: f64 = 1e-6 * SLOT_US as f64;
/// How far the fusion horizon lies back, µs: most samples have arrived by then.
const HORIZON_US: u64 = 100_000;
/// A gap between two ticks longer than this is another flight, s.
const LONGEST_GAP_S: f64 = 0.5;

/// Median of every component; NaN of none.
fn median_six<'a>(of: impl Iterator<Item = &'a Six> + Clone) -> Six {
    Six::from_fn(|i, _| median(of.clone().map(|six| six[i])))
}

/// The estimator. See the module.
pub struct Lanes {
    model: SensorModel,
    thrust: Thrust,
    slots: Slots,
    delays: Delays,
    /// Until the attitude is known.
    start: Option<Start>,
    lanes: PerLane<Lane>,
    judges: Judges,
    fused: Fused,
    predictor: Predictor,
    rates: Rates,
    aided: Aided,
    clock: Clock,
    isolation: Isolation,
    report: WindowReport,
    estimate: Estimate,
}

/// Who says which lanes and lasers are healthy.
struct Judges {
    noise: Noise,
    vote: Vote,
    evidence: Evidence,
    heights: Heights,
}

/// The weighted mean of the lanes, at the horizon.
struct Fused {
    at: Kinematics,
    mixture: Mixture,
    /// The lane that weighs most.
    best: usize,
    /// Slots for which each lane's IMU has been silent.
    silent: PerLane<u32>,
    /// Announced as excluded.
    announced: PerLane<bool>,
    /// How far apart in tilt lanes that weigh much usually are, at most, rad.
    usual_rad: f64,
    /// What accelerometers usually rectify along each axis of the body, squared, m²/s⁴.
    rectified_squares: Vector3<f64>,
    /// Along the thrust, in the slot before, m/s².
    rectified_before_mps2: f64,
    /// Slots in a row in which lanes that weigh much contradict each other.
    contradicted: u32,
}

/// What has been corrected by which sensors, and when.
#[derive(Default)]
struct Aided {
    horizontal: Freshness,
    vertical: Freshness,
    heights: Freshness,
    pose: Freshness,
    idle: Idle,
    /// Beside a barometer only.
    floor: Floor,
    /// Strength of the magnetic field where it started, µT.
    field_ut: Option<f64>,
    yaw: Yaw,
}

/// Where it is in time, and what it has lived through.
#[derive(Default)]
struct Clock {
    now: Option<FlightTime>,
    /// Slots flown since the start, at rest in a row, and with too little thrust to fly in a row.
    flown: u32,
    resting: u32,
    unladen: u32,
}

impl Lanes {
    /// Nothing known yet.
    pub fn new(model: SensorModel, airframe: &Airframe) -> Self {
        let gravity_mps2 = model.imus.gravity_mps2;
        let place = model.imus.position_flu_m;
        let predictor = Predictor::new(gravity_mps2);
        let mut aided = Aided::default();
        aided.idle.anchor.z = airframe.standing_m();
        Self {
            thrust: Thrust::new(airframe, gravity_mps2),
            slots: Slots::new(),
            delays: Delays::default(),
            start: Some(Start::new()),
            lanes: std::array::from_fn(|i| Lane::new(place[i], gravity_mps2)),
            judges: Judges {
                noise: Noise::new(),
                vote: Vote::new(),
                evidence: Evidence::default(),
                heights: Heights::default(),
            },
            fused: Fused {
                at: *predictor.now(),
                mixture: Mixture::new(),
                best: 0,
                silent: [0; LANES],
                announced: [false; LANES],
                usual_rad: 0.0,
                rectified_squares: Vector3::zeros(),
                rectified_before_mps2: 0.0,
                contradicted: 0,
            },
            predictor,
            rates: Rates::new(),
            aided,
            clock: Clock::default(),
            isolation: Isolation::new(1),
            report: WindowReport::default(),
            estimate: Estimate::default(),
            model,
        }
    }

    /// The attacked set, as announced.
    pub fn isolation(&self) -> &Isolation {
        &self.isolation
    }

    /// The last slot, as the window of the secure estimator is reported.
    pub fn window(&self) -> &WindowReport {
        &self.report
    }

    /// Weight of each lane; they sum to one.
    pub fn weights(&self) -> [f64; MAX_IMUS] {
        self.fused.mixture.weights
    }

    /// How much `sensor` counts beside the one of its kind that counts most, 0..1: an IMU by the weight of its lane, a laser by its
    /// own. 1 of every other sensor, and of all until there is an estimate.
    pub fn counts(&self, sensor: SensorId) -> f64 {
        let index = usize::from(sensor.instance.saturating_sub(1));
        let weights = self.weights();
        let most = weights.into_iter().fold(0.0, f64::max);
        match sensor.kind {
            SensorKind::Imu if most > 0.0 => weights.get(index).map_or(1.0, |weight| weight / most),
            SensorKind::Height if self.start.is_none() => self.judges.heights.weight(index),
            _ => 1.0,
        }
    }

    /// By how much stamps are late, as far as that has been learned.
    pub fn delays(&self) -> Learned {
        self.delays.learned()
    }

    /// What is measured of the accelerometers along z: the noise is the largest of the lanes in use.
    pub fn shaken(&self) -> Shaken {
        let used = self.weights().into_iter().enumerate().filter(|(_, weight)| *weight > 0.0).map(|(lane, _)| lane);
        let noise_mps2 = used.map(|lane| self.judges.noise.measured(lane)[2]).fold(0.0, f64::max);
        Shaken { noise_mps2, rectified_mps2: self.fused.rectified_squares.z.sqrt() }
    }

    /// Nothing of what was before belongs to this flight, but for what has been learned of the sensors.
    fn restart(&mut self) {
        self.slots = Slots::new();
        self.start = Some(Start::new());
        self.predictor.clear();
        self.aided = Aided { idle: self.aided.idle, ..Aided::default() };
        self.fused.silent = [0; LANES];
    }
}

impl Estimator for Lanes {
    fn kind(&self) -> EstimatorKind {
        EstimatorKind::Lanes
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        let now = received.time;
        let dt_s = self.clock.now.map_or(0.0, |before| now.seconds_since(before));
        if !(0.0..=LONGEST_GAP_S).contains(&dt_s) {
            self.restart();
        }
        self.clock.now = Some(now);
        self.estimate.residuals.clear();
        let (thrust_mps2, standing) = self.thrust.step(received, applied, dt_s);
        self.slots.gather(received, thrust_mps2, standing);
        self.saw(received);
        self.predictor.follow(now, self.slots.integrals(), thrust_mps2);
        self.turn(now, dt_s, thrust_mps2);
        while let Some(slot) = self.slots.close(now) {
            self.advance(&slot);
        }
        self.publish(now);
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

/// Three of six.
fn part(six: &Six, first: usize) -> Vector3<f64> {
    six.fixed_rows::<3>(first).into_owned()
}
