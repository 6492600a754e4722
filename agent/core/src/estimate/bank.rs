//! Estimators side by side, one of them in the loop, switched in flight without a bump.
//!
//! Every estimator sees every frame. When another one is put in the loop, the difference between
//! the two is added to its estimate and dies away with `BLEND_TIME_CONSTANT_S`: no estimator is
//! reset, so the effect of an attack on one is not handed on to the next for longer than that.

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;

use super::attitude_ekf::AttitudeEkfEstimator;
use super::complementary::Complementary;
use super::constant_acceleration::ConstantAccelerationEstimator;
use super::ekf_bias::EkfBias;
use super::fdir::isolation::Isolation;
use super::filter::ekf_hybrid::EkfHybrid;
use super::filter::innovations::Innovations;
use super::filter::ukf::Ukf;
use super::lanes::Lanes;
use super::lanes::delays::Learned;
use super::lanes::linear::Shaken;
use super::secure::{Decoder, Secure, WindowReport};
use super::twelve_state::TwelveStateEstimator;
use super::vqf::VqfEstimator;
use super::{Estimate, Estimator, EstimatorKind};
use crate::model::airframe::Airframe;
use crate::sensor::{SensorFrame, SensorModel};
use crate::types::MotorCommand;

/// Most estimators of one bank.
pub const MAX_ESTIMATORS: usize = 10;
/// Time constant with which a switch dies away, s.
const BLEND_TIME_CONSTANT_S: f64 = 0.5;
/// A difference below this is gone: it changes no sum any more, and numbers much smaller are slow to multiply.
const GONE: f64 = 1e-200;

/// Why a bank cannot be built or an estimator not selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BankError {
    /// No estimator.
    #[error("no estimator is configured")]
    Empty,
    /// Too many.
    #[error("{0} estimators are configured, at most {MAX_ESTIMATORS}")]
    TooMany(usize),
    /// Two of one kind.
    #[error("estimator {0:?} is configured twice")]
    Twice(EstimatorKind),
    /// Not built (yet).
    #[error("estimator {0:?} is not available")]
    NotAvailable(EstimatorKind),
    /// Not among those that run.
    #[error("estimator {0:?} does not run on this vehicle")]
    NotRunning(EstimatorKind),
}

/// What an estimator may assume of the vehicle it runs on.
#[derive(Debug, Clone, Copy)]
pub struct Assumptions<'a> {
    /// The vehicle; matters to those that know what the motors do.
    pub airframe: &'a Airframe,
    /// Its sensors.
    pub sensors: &'a SensorModel,
    /// Slots in the window of the secure estimator.
    pub window_slots: usize,
}

/// The estimator of `kind` for a vehicle as assumed.
///
/// # Errors
/// [`BankError::NotAvailable`] for a kind that cannot be built.
pub fn build(kind: EstimatorKind, assumed: &Assumptions) -> Result<Box<dyn Estimator>, BankError> {
    let (airframe, sensors) = (assumed.airframe, assumed.sensors.clone());
    match kind {
        EstimatorKind::EkfBias => boxed(|| Some(EkfBias::new(sensors).standing_at(airframe.standing_m()))),
        EstimatorKind::Complementary => boxed(|| Some(Complementary::new(sensors))),
        EstimatorKind::EkfHybrid => boxed(|| Some(TwelveStateEstimator::<EkfHybrid>::new(airframe, sensors))),
        EstimatorKind::Ukf => boxed(|| Some(TwelveStateEstimator::<Ukf>::new(airframe, sensors))),
        EstimatorKind::ConstantAcceleration => boxed(|| Some(ConstantAccelerationEstimator::new(sensors))),
        EstimatorKind::Vqf => boxed(|| Some(VqfEstimator::new(&sensors.imus))),
        EstimatorKind::AttitudeEkf => boxed(|| Some(AttitudeEkfEstimator::new(&sensors.imus))),
        EstimatorKind::Secure => boxed(|| Secure::new(sensors, airframe, assumed.window_slots).ok()),
        EstimatorKind::Lanes => boxed(|| Some(Lanes::new(sensors, airframe))),
        _ => None,
    }
    .ok_or(BankError::NotAvailable(kind))
}

/// Estimators are large, and are made where the caller's stack is: each in a frame that goes with it, not all in one.
#[inline(never)]
fn boxed<E: Estimator + 'static>(make: impl FnOnce() -> Option<E>) -> Option<Box<dyn Estimator>> {
    Some(Box::new(make()?))
}

/// An estimator that says which sensors it excludes.
#[derive(Clone, Copy)]
pub enum Judge<'a> {
    /// The decoder of a window.
    Secure(&'a Secure),
    /// The lanes.
    Lanes(&'a Lanes),
}

impl<'a> Judge<'a> {
    /// Its last window, or slot.
    pub fn window(self) -> &'a WindowReport {
        match self {
            Self::Secure(secure) => secure.window(),
            Self::Lanes(lanes) => lanes.window(),
        }
    }

    /// The attacked set.
    pub fn isolation(self) -> &'a Isolation {
        match self {
            Self::Secure(secure) => secure.isolation(),
            Self::Lanes(lanes) => lanes.isolation(),
        }
    }

    /// How much `sensor` counts beside the one of its kind that counts most, 0..1, announced as excluded or not; 1 of what it does
    /// not judge.
    pub fn counts(self, sensor: SensorId) -> f64 {
        match self {
            Self::Secure(secure) if secure.isolation().excluded().contains(sensor) => 0.0,
            Self::Secure(_) => 1.0,
            Self::Lanes(lanes) => lanes.counts(sensor),
        }
    }

    /// Most that its altitude is off by, m; `None` where it promises nothing.
    pub fn height_bound_m(self) -> Option<f64> {
        match self {
            Self::Secure(secure) => secure.height_bound_m(),
            Self::Lanes(lanes) => lanes.height_bound_m(),
        }
    }

    /// What it measures of the accelerometers; `None` where it measures nothing.
    pub fn shaken(self) -> Option<Shaken> {
        match self {
            Self::Secure(_) => None,
            Self::Lanes(lanes) => Some(lanes.shaken()),
        }
    }

    /// By how much it has learned that stamps are late; nothing where it does not learn that.
    pub fn delays(self) -> Learned {
        match self {
            Self::Secure(_) => Learned::default(),
            Self::Lanes(lanes) => lanes.delays(),
        }
    }

    /// Which it is.
    pub fn kind(self) -> EstimatorKind {
        match self {
            Self::Secure(_) => EstimatorKind::Secure,
            Self::Lanes(_) => EstimatorKind::Lanes,
        }
    }

    /// The decoder of a window, where it is that.
    pub fn secure(self) -> Option<&'a Secure> {
        match self {
            Self::Secure(secure) => Some(secure),
            Self::Lanes(_) => None,
        }
    }
}

/// The bank.
pub struct Bank {
    estimators: ArrayVec<Box<dyn Estimator>, MAX_ESTIMATORS>,
    in_loop: usize,
    estimate: Estimate,
    /// What each is surprised by.
    innovations: [Innovations; MAX_ESTIMATORS],
    /// What is left of the last switch.
    offset: Option<Offset>,
    /// Counts nanoseconds; given from outside, since estimators have no clock.
    stopwatch: Option<fn() -> u64>,
    /// How long each took in the last step, ns.
    step_ns: [u64; MAX_ESTIMATORS],
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Offset {
    position_m: Vector3<f64>,
    velocity_mps: Vector3<f64>,
    attitude: UnitQuaternion<f64>,
    rates_radps: Vector3<f64>,
}

impl Offset {
    /// What is left of it once the part `keep` remains; `None` when nothing is.
    fn fade(mut self, keep: f64) -> Option<Self> {
        self.position_m *= keep;
        self.velocity_mps *= keep;
        self.rates_radps *= keep;
        self.attitude = UnitQuaternion::from_scaled_axis(self.attitude.scaled_axis() * keep);
        (self.largest() > GONE).then_some(self)
    }

    fn largest(&self) -> f64 {
        let vectors = self.position_m.amax().max(self.velocity_mps.amax()).max(self.rates_radps.amax());
        vectors.max(self.attitude.imag().amax())
    }

    fn add_to(&self, estimate: &mut Estimate) {
        if let Some(motion) = &mut estimate.motion {
            motion.position_enu_m += self.position_m;
            motion.velocity_enu_mps += self.velocity_mps;
        }
        estimate.body_rates_radps += self.rates_radps;
        estimate.world_from_body = self.attitude * estimate.world_from_body;
    }
}

impl Bank {
    /// `estimators` with the one of kind `in_loop` in the loop.
    ///
    /// # Errors
    /// [`BankError`].
    pub fn new(estimators: Vec<Box<dyn Estimator>>, in_loop: EstimatorKind) -> Result<Self, BankError> {
        let count = estimators.len();
        if count == 0 {
            return Err(BankError::Empty);
        }
        if count > MAX_ESTIMATORS {
            return Err(BankError::TooMany(count));
        }
        for (i, one) in estimators.iter().enumerate() {
            if estimators.iter().take(i).any(|other| other.kind() == one.kind()) {
                return Err(BankError::Twice(one.kind()));
            }
        }
        let at = estimators.iter().position(|e| e.kind() == in_loop).ok_or(BankError::NotRunning(in_loop))?;
        Ok(Self {
            estimators: estimators.into_iter().collect(),
            in_loop: at,
            estimate: Estimate::default(),
            innovations: [Innovations::default(); MAX_ESTIMATORS],
            offset: None,
            stopwatch: None,
            step_ns: [0; MAX_ESTIMATORS],
        })
    }

    /// Times every step with `stopwatch`, a count of nanoseconds. It never changes an estimate.
    pub fn time_steps_with(&mut self, stopwatch: fn() -> u64) {
        self.stopwatch = Some(stopwatch);
    }

    /// Gives estimators that can give up early their limit, µs, by `stopwatch`. In simulations and replays that
    /// must repeat bit by bit there is none.
    pub fn limit_steps(&mut self, stopwatch: fn() -> u64, limit_us: Option<u64>) {
        self.estimators
            .iter_mut()
            .filter_map(|e| e.secure_mut())
            .for_each(|secure| secure.time_with(stopwatch, limit_us));
    }

    /// The secure estimator, where it runs.
    pub fn secure(&self) -> Option<&Secure> {
        self.estimators.iter().find_map(|estimator| estimator.secure())
    }

    /// The estimator by lanes, where it runs.
    pub fn lanes(&self) -> Option<&Lanes> {
        self.estimators.iter().find_map(|estimator| estimator.lanes())
    }

    /// Who judges the sensors: the one in the loop where it does, else the lanes, else the window decoder.
    pub fn judge(&self) -> Option<Judge<'_>> {
        let (lanes, secure) = (self.lanes().map(Judge::Lanes), self.secure().map(Judge::Secure));
        if self.in_loop_kind() == EstimatorKind::Secure { secure } else { lanes.or(secure) }
    }

    /// Makes the secure estimator solve another program.
    ///
    /// # Errors
    /// [`BankError::NotRunning`].
    pub fn use_decoder(&mut self, decoder: Decoder) -> Result<(), BankError> {
        let secure = self.estimators.iter_mut().find_map(|estimator| estimator.secure_mut());
        secure.ok_or(BankError::NotRunning(EstimatorKind::Secure))?.use_decoder(decoder);
        Ok(())
    }

    /// How long the last step of the estimator of `kind` took, µs; zero when it is not timed or does not run.
    pub fn step_time_us(&self, kind: EstimatorKind) -> f64 {
        let timed = self.estimators.iter().zip(&self.step_ns).find(|(e, _)| e.kind() == kind);
        timed.map_or(0.0, |(_, ns)| *ns as f64 * 1e-3)
    }

    /// Steps every estimator; the estimate in the loop.
    pub fn step(&mut self, received: &SensorFrame, applied: &MotorCommand, dt_s: f64) -> &Estimate {
        let read = || self.stopwatch.map_or(0, |now| now());
        let mut before = read();
        for ((estimator, took), innovations) in
            self.estimators.iter_mut().zip(&mut self.step_ns).zip(&mut self.innovations)
        {
            estimator.step(received, applied);
            innovations.scale(estimator.estimate_mut());
            let after = read();
            *took = after.saturating_sub(before);
            before = after;
        }
        if let Some(own) = self.estimators.get(self.in_loop) {
            self.estimate.clone_from(own.estimate());
        }
        self.offset = self.offset.and_then(|offset| offset.fade((-dt_s / BLEND_TIME_CONSTANT_S).exp()));
        if let Some(offset) = &self.offset {
            offset.add_to(&mut self.estimate);
        }
        &self.estimate
    }

    /// The estimate in the loop, as the controller sees it.
    pub fn in_loop(&self) -> &Estimate {
        &self.estimate
    }

    /// Kind of the estimator in the loop.
    pub fn in_loop_kind(&self) -> EstimatorKind {
        self.estimators.get(self.in_loop).map_or(EstimatorKind::Unspecified, |e| e.kind())
    }

    /// Every estimator's own estimate.
    pub fn estimates(&self) -> impl Iterator<Item = (EstimatorKind, &Estimate)> {
        self.estimators.iter().map(|e| (e.kind(), e.estimate()))
    }

    /// The own estimate of the estimator of `kind`.
    pub fn estimate_of(&self, kind: EstimatorKind) -> Option<&Estimate> {
        self.estimators.iter().find(|e| e.kind() == kind).map(|e| e.estimate())
    }

    /// Puts the estimator of `kind` in the loop, without a bump.
    ///
    /// # Errors
    /// [`BankError::NotRunning`].
    pub fn select(&mut self, kind: EstimatorKind) -> Result<(), BankError> {
        let at = self.estimators.iter().position(|e| e.kind() == kind).ok_or(BankError::NotRunning(kind))?;
        if at == self.in_loop {
            return Ok(());
        }
        self.in_loop = at;
        if let Some(own) = self.estimators.get(at) {
            let (before, new) = (&self.estimate, own.estimate());
            // From or to an estimator without a position there is nothing to blend.
            let (position_m, velocity_mps) = before.motion.zip(new.motion).map_or_else(Default::default, |(a, b)| {
                (a.position_enu_m - b.position_enu_m, a.velocity_enu_mps - b.velocity_enu_mps)
            });
            let offset = Offset {
                position_m,
                velocity_mps,
                attitude: before.world_from_body * new.world_from_body.inverse(),
                rates_radps: before.body_rates_radps - new.body_rates_radps,
            };
            let finite = offset.position_m.norm() + offset.velocity_mps.norm() + offset.rates_radps.norm();
            self.offset = finite.is_finite().then_some(offset);
        }
        Ok(())
    }
}

impl std::fmt::Debug for Bank {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bank").field("in_loop", &self.in_loop_kind()).field("count", &self.estimators.len()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::secure::SLOTS;
    use crate::estimate::{Health, Motion};

    struct Fixed(EstimatorKind, Estimate);

    impl Estimator for Fixed {
        fn kind(&self) -> EstimatorKind {
            self.0
        }
        fn step(&mut self, _: &SensorFrame, _: &MotorCommand) -> &Estimate {
            &self.1
        }
        fn estimate(&self) -> &Estimate {
            &self.1
        }
        fn estimate_mut(&mut self) -> &mut Estimate {
            &mut self.1
        }
    }

    fn fixed(kind: EstimatorKind, z: f64, yaw: f64) -> Box<dyn Estimator> {
        let estimate = Estimate {
            motion: Some(Motion { position_enu_m: Vector3::new(0.0, 0.0, z), ..Motion::default() }),
            world_from_body: UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
            health: Health::Healthy,
            ..Estimate::default()
        };
        Box::new(Fixed(kind, estimate))
    }

    #[test]
    fn a_switch_makes_no_bump_and_dies_away() {
        let both = vec![fixed(EstimatorKind::EkfBias, 1.0, 0.0), fixed(EstimatorKind::Complementary, 1.3, 0.4)];
        let mut bank = Bank::new(both, EstimatorKind::EkfBias).unwrap();
        let (frame, command) = (SensorFrame::default(), MotorCommand::default());
        let before = bank.step(&frame, &command, 0.005).clone();
        bank.select(EstimatorKind::Complementary).unwrap();
        let after = bank.step(&frame, &command, 0.005).clone();
        let z = |estimate: &Estimate| estimate.motion.unwrap().position_enu_m.z;
        assert!((z(&after) - z(&before)).abs() < 0.3 * 0.011);
        assert!(after.world_from_body.angle_to(&before.world_from_body) < 0.4 * 0.011);
        for _ in 0..1000 {
            bank.step(&frame, &command, 0.005);
        }
        assert!((z(bank.in_loop()) - 1.3).abs() < 1e-4);
        assert_eq!(bank.in_loop_kind(), EstimatorKind::Complementary);
        assert_eq!(z(bank.estimate_of(EstimatorKind::EkfBias).unwrap()), 1.0);
    }

    #[test]
    fn from_an_attitude_filter_the_altitude_is_right_at_once() {
        let attitude = Fixed(EstimatorKind::Vqf, Estimate { health: Health::Healthy, ..Estimate::default() });
        let both = vec![Box::new(attitude) as Box<dyn Estimator>, fixed(EstimatorKind::EkfBias, 1.3, 0.0)];
        let mut bank = Bank::new(both, EstimatorKind::Vqf).unwrap();
        let (frame, command) = (SensorFrame::default(), MotorCommand::default());
        assert_eq!(bank.step(&frame, &command, 0.005).motion, None);
        bank.select(EstimatorKind::EkfBias).unwrap();
        assert_eq!(bank.step(&frame, &command, 0.005).motion.unwrap().position_enu_m.z, 1.3);
    }

    #[test]
    fn each_step_is_timed_by_the_stopwatch_given() {
        thread_local!(static NS: std::cell::Cell<u64> = const { std::cell::Cell::new(0) });
        // 2 µs, 4 µs, 6 µs … between one reading and the next.
        fn stopwatch() -> u64 {
            NS.set(NS.get() + 2000);
            NS.get() * NS.get() / 4000
        }
        let (frame, command) = (SensorFrame::default(), MotorCommand::default());
        let both = vec![fixed(EstimatorKind::EkfBias, 1.0, 0.0), fixed(EstimatorKind::Complementary, 1.3, 0.4)];
        let mut bank = Bank::new(both, EstimatorKind::EkfBias).unwrap();
        bank.step(&frame, &command, 0.005);
        assert_eq!(bank.step_time_us(EstimatorKind::EkfBias), 0.0);
        bank.time_steps_with(stopwatch);
        bank.step(&frame, &command, 0.005);
        assert_eq!(
            (bank.step_time_us(EstimatorKind::EkfBias), bank.step_time_us(EstimatorKind::Complementary)),
            (3.0, 5.0)
        );
        assert_eq!(bank.step_time_us(EstimatorKind::Ukf), 0.0);
    }

    #[test]
    fn what_can_be_configured_is_built_and_the_rest_is_refused() {
        let (airframe, sensors) = (Airframe::iris(), SensorModel::default());
        let assumed = Assumptions { airframe: &airframe, sensors: &sensors, window_slots: SLOTS };
        use EstimatorKind as K;
        for kind in K::all().filter(|kind| *kind != K::Secure) {
            assert_eq!(build(kind, &assumed).unwrap().kind(), kind);
        }
        assert_eq!(build(K::Unspecified, &assumed).err(), Some(BankError::NotAvailable(K::Unspecified)));
    }

    #[test]
    fn impossible_banks_are_refused() {
        let kind = EstimatorKind::EkfBias;
        assert_eq!(Bank::new(vec![], kind).unwrap_err(), BankError::Empty);
        assert_eq!(
            Bank::new(vec![fixed(kind, 0.0, 0.0), fixed(kind, 0.0, 0.0)], kind).unwrap_err(),
            BankError::Twice(kind)
        );
        let missing = EstimatorKind::Ukf;
        assert_eq!(Bank::new(vec![fixed(kind, 0.0, 0.0)], missing).unwrap_err(), BankError::NotRunning(missing));
    }
}
