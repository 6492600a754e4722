//! Every scalar signal of the sensors: its mean over a slot, its baseline, and its slow deviations.
//!
//! | symbol | meaning |
//! |---|---|
//! | y | mean of a signal over a slot |
//! | d | its baseline: the constant deviation learned |
//! | λ | by how much a deviation counts less in rough motion (`inertial.rs`) |
//! | e = (y − ŷ − d)/λ | deviation; less the median of its quantity, what baselines and CUSUMs take |
//!
//! A barometer's offset wanders without bound: it follows the filter and is compared with nothing.

use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::inertial;
use super::model::{Assumed, Quantity, SLOT_S};
use crate::estimate::fdir::baseline::Baseline;
use crate::estimate::fdir::cusum::Cusum;
use crate::estimate::median;
use crate::sensor::SensorModel;
use crate::sensor::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS};

/// Signals of one IMU: six inertial channels and the heading.
const OF_IMU: usize = 7;
const FIRST_OF_IMUS: usize = MAX_HEIGHTS + MAX_BAROMETERS;
/// Signals of all sensors.
pub(super) const SIGNALS: usize = FIRST_OF_IMUS + OF_IMU * MAX_IMUS;

/// Time constant with which baselines follow, s, …
const BASELINE_S: f64 = 20.0;
/// … once they are known: before, they are the mean of what was seen, the first of it of so many values.
const FIRST_WEIGHS: u32 = 10;
/// Gain of a barometer's baseline while all is learned.
const BAROMETER_GAIN: f64 = 0.3;
/// Deviations this many slots old still take part in a median: sensors may sample in turns.
const RECENT_SLOTS: u64 = 4;
/// σ of a deviation from a median of three, in sigmas of one value.
const CUSUM_SIGMAS: f64 = 1.25;

/// Mean of what came in one slot.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    total: f64,
    samples: u32,
}

impl Mean {
    fn take(&mut self) -> Option<f64> {
        let mean = (self.samples > 0).then(|| self.total / f64::from(self.samples));
        *self = Self::default();
        mean
    }
}

/// One scalar of one sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signal {
    /// Whose.
    pub sensor: SensorId,
    /// Of what.
    pub quantity: Quantity,
    /// What is assumed of it.
    pub assumed: Assumed,
    running: Mean,
    /// Mean of the slot that ended last.
    value: Option<f64>,
    /// λ of that slot.
    discount: f64,
    baseline: Baseline<1>,
    /// Slot and value of the last deviation.
    deviation: Option<(u64, f64)>,
    /// Deviation in the slot that ended last, less the median of its quantity; NaN where there is none.
    from_median: f64,
    cusum: Cusum,
}

impl Signal {
    fn new(sensor: SensorId, quantity: Quantity, model: &SensorModel) -> Self {
        Self {
            sensor,
            quantity,
            assumed: Assumed::of(quantity, model),
            running: Mean::default(),
            value: None,
            discount: 1.0,
            baseline: Baseline::after(FIRST_WEIGHS - 1),
            deviation: None,
            from_median: f64::NAN,
            cusum: Cusum::default(),
        }
    }

    /// Takes a sample into the running slot; what is not finite is skipped.
    pub fn add(&mut self, sample: f64) {
        if sample.is_finite() {
            self.running.total += sample;
            self.running.samples += 1;
        }
    }

    /// What enters the window: the slot's mean, its baseline removed, discounted.
    pub fn whitened(&self) -> Option<f64> {
        Some((self.value? - self.learned()) / self.discount)
    }

    /// Sum of its slow deviations.
    pub fn cusum(&self) -> &Cusum {
        &self.cusum
    }

    fn learned(&self) -> f64 {
        let [offset] = *self.baseline.offset();
        offset
    }

    fn learn(&mut self, deviation: f64, gain: f64) {
        self.baseline.learn(&[deviation], gain, self.assumed.limit);
    }

    fn deviation_of(&self, slot: u64) -> Option<f64> {
        self.deviation.filter(|(of, _)| *of == slot).map(|(_, deviation)| deviation)
    }

    fn recent(&self, slot: u64) -> Option<f64> {
        self.deviation.filter(|(of, _)| slot.saturating_sub(*of) < RECENT_SLOTS).map(|(_, deviation)| deviation)
    }
}

/// What the comparison must know of the attacked set and of the flight so far.
pub(super) struct Context<I, S> {
    /// Is a sensor isolated?
    pub isolated: I,
    /// Is it isolated or above a limit?
    pub suspect: S,
    /// Are baselines only learned so far?
    pub learning: bool,
    /// … those of the IMUs anew?
    pub relearning: bool,
}

/// The signals of a vehicle.
pub(super) struct Signals {
    all: [Signal; SIGNALS],
    slot: u64,
}

impl Signals {
    /// Of sensors like these.
    pub fn new(model: &SensorModel) -> Self {
        let all = std::array::from_fn(|index| {
            let (kind, instance, quantity) = match index {
                i if i < MAX_HEIGHTS => (SensorKind::Height, i, Quantity::Height),
                i if i < FIRST_OF_IMUS => (SensorKind::Barometer, i - MAX_HEIGHTS, Quantity::Barometer),
                i => {
                    let (imu, channel) = ((i - FIRST_OF_IMUS) / OF_IMU, (i - FIRST_OF_IMUS) % OF_IMU);
                    let quantity = if channel < 6 { Quantity::Inertial(channel) } else { Quantity::Heading };
                    (SensorKind::Imu, imu, quantity)
                }
            };
            Signal::new(SensorId::new(kind, instance as u8 + 1), quantity, model)
        });
        Self { all, slot: 0 }
    }

    /// Every signal, in the order of the window.
    pub fn iter(&self) -> impl Iterator<Item = &Signal> {
        self.all.iter()
    }

    /// The signals of `sensor` with their places in the window.
    pub fn of(&self, sensor: SensorId) -> impl Iterator<Item = (usize, &Signal)> {
        self.all.iter().enumerate().filter(move |(_, signal)| signal.sensor == sensor)
    }

    /// A sample of `quantity` arrived from `sensor`.
    pub fn add(&mut self, sensor: SensorId, quantity: Quantity, sample: f64) {
        let signal = self.all.iter_mut().find(|s| s.sensor == sensor && s.quantity == quantity);
        signal.into_iter().for_each(|s| s.add(sample));
    }

    /// Forgets the running slot.
    pub fn restart_slot(&mut self) {
        self.all.iter_mut().for_each(|signal| signal.running = Mean::default());
    }

    /// Slot number `slot` is over; the inertial channels' means come from `imus`.
    pub fn close(&mut self, slot: u64, imus: &inertial::Slot) {
        self.slot = slot;
        for signal in &mut self.all {
            signal.value = signal.running.take();
            if let Quantity::Inertial(channel) = signal.quantity {
                signal.discount = imus.discount[channel];
                let deviations = imus.deviations.get(usize::from(signal.sensor.instance.saturating_sub(1)));
                let deviation = deviations.copied().flatten().map(|d| d[channel]);
                signal.value = deviation.filter(|d| d.is_finite() && signal.discount.is_finite());
            }
        }
    }

    /// Learns baselines and sums up slow deviations; heights and barometers are counted from `path_m`.
    pub fn compare(&mut self, path_m: f64, context: &Context<impl Fn(SensorId) -> bool, impl Fn(SensorId) -> bool>) {
        for signal in &mut self.all {
            signal.from_median = f64::NAN;
            if let Some(value) = signal.value {
                let reference = if signal.quantity.is_of_imu() { 0.0 } else { path_m };
                let deviation = (value - reference - signal.learned()) / signal.discount;
                signal.deviation = Some((self.slot, deviation));
            }
        }
        for quantity in Quantity::ALL {
            match quantity {
                Quantity::Barometer => self.follow_barometers(context),
                quantity => self.compare_one(quantity, context),
            }
        }
        self.centre_heights(&context.isolated);
    }

    /// Instances that measure the same quantity, some of them in turns.
    fn compare_one(
        &mut self,
        quantity: Quantity,
        context: &Context<impl Fn(SensorId) -> bool, impl Fn(SensorId) -> bool>,
    ) {
        let slot = self.slot;
        let of = |signal: &&Signal| signal.quantity == quantity && !(context.isolated)(signal.sensor);
        let recent = || self.all.iter().filter(of).filter_map(|signal| signal.recent(slot));
        let (count, centre) = (recent().count(), median(recent()));
        if count == 0 {
            return;
        }
        let learning = context.learning || (quantity.is_of_imu() && context.relearning);
        for signal in self.all.iter_mut().filter(|signal| signal.quantity == quantity) {
            let Some(deviation) = signal.deviation_of(slot).map(|deviation| deviation - centre) else { continue };
            signal.from_median = deviation;
            // Two can contradict each other, but make no majority.
            if (!learning || signal.cusum.is_in_doubt()) && count >= 3 {
                let Assumed { sigma, bias, .. } = signal.assumed;
                signal.cusum.take(deviation / (CUSUM_SIGMAS * sigma.hypot(0.5 * bias)));
            }
            let learnable = learning || !(context.suspect)(signal.sensor);
            // What begins to drift is not learned away.
            if !(context.isolated)(signal.sensor) && learnable && signal.cusum.is_calm() {
                signal.baseline.count();
                let gain = signal.baseline.gain(1, SLOT_S / BASELINE_S);
                signal.learn(deviation, gain);
            }
        }
    }

    fn follow_barometers(&mut self, context: &Context<impl Fn(SensorId) -> bool, impl Fn(SensorId) -> bool>) {
        for signal in self.all.iter_mut().filter(|signal| signal.quantity == Quantity::Barometer) {
            let Some(deviation) = signal.deviation_of(self.slot) else { continue };
            if context.learning || !(context.suspect)(signal.sensor) {
                let gain = if context.learning { BAROMETER_GAIN } else { SLOT_S / BASELINE_S };
                signal.learn(deviation, gain);
            }
        }
    }

    /// Baselines of the heights are about the mean of all while none is isolated: then it does not matter which one is.
    fn centre_heights(&mut self, isolated: impl Fn(SensorId) -> bool) {
        let known = |signal: &Signal| signal.quantity == Quantity::Height && signal.deviation.is_some();
        let count = self.all.iter().filter(|s| known(s)).count();
        if count == 0 || self.all.iter().any(|s| known(s) && isolated(s.sensor)) {
            return;
        }
        let mean = self.all.iter().filter(|s| known(s)).map(Signal::learned).sum::<f64>() / count as f64;
        for signal in self.all.iter_mut().filter(|s| known(s)) {
            signal.baseline.learn(&[-mean], 1.0, f64::INFINITY);
        }
    }

    /// Deviations of the inertial channels of every IMU from the median of all.
    pub fn inertial_from_median(&self) -> [[f64; 6]; MAX_IMUS] {
        let mut from_median = [[f64::NAN; 6]; MAX_IMUS];
        for signal in &self.all {
            let imu = from_median.get_mut(usize::from(signal.sensor.instance.saturating_sub(1)));
            if let (Quantity::Inertial(channel), Some(imu)) = (signal.quantity, imu) {
                imu[channel] = signal.from_median;
            }
        }
        from_median
    }

    /// Baseline of each height, m.
    pub fn height_baselines_m(&self) -> [f64; MAX_HEIGHTS] {
        std::array::from_fn(|i| self.all.get(i).map_or(0.0, Signal::learned))
    }

    /// The set of IMUs in the loop has changed: their baselines are learned anew, except of those already in doubt.
    pub fn relearn_imus(&mut self) {
        for signal in self.all.iter_mut().filter(|s| s.quantity.is_of_imu() && !s.cusum.is_in_doubt()) {
            signal.cusum = Cusum::default();
            signal.baseline.weigh(FIRST_WEIGHS - 1);
        }
    }
}
