//! Who is lying: the attacked set, from statistics of the decoded window, of seconds, and of single samples.
//!
//! | test | statistic | limit | catches |
//! |---|---|---|---|
//! | window | ‖whitened residual‖² of a row | χ² at 99.9 % for a whole window long, or far beyond it twice | what contradicts the others now |
//! | drift | two-sided CUSUM of the deviation from the group's median (Page 1954) | [`CUSUM_LIMIT`] | slow ramps, low-amplitude replay |
//! | stuck | equal samples in a row while others of the type move | by σ and resolution | freeze |
//!
//! One window in a thousand is suspect without any attack, and there are 25 a second: nothing is flagged
//! for one. A flag falls after [`CALM`] windows within every limit. The rank guard keeps a group that measures the same
//! quantity from being emptied, and where a group contradicts itself without a majority nobody is flagged
//! who is not far worse than the rest: the caller is told ([`Identifier::contradicted`]).

use arrayvec::ArrayVec;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
pub use plumbline_proto::v1::FlagReason;
use plumbline_proto::v1::SensorKind;

use crate::vehicle::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS};

/// Most sensors judged.
pub const MAX_DEVICES: usize = MAX_IMUS + MAX_HEIGHTS + MAX_BAROMETERS;
/// Ratio to the 99.9 % limit above which two windows in a row flag.
pub const CERTAIN: f64 = 3.0;
/// Windows in a row within every limit after which a flag falls: 2 s.
const CALM: u32 = 50;
/// Worse than the next of a group without a majority by this factor, a sensor is flagged all the same.
const FAR_WORSE: f64 = 4.0;
/// A sensor is present this long after its last sample, s.
const PRESENT_S: f64 = 1.0;
/// What a CUSUM forgives, in sigmas of one value.
const CUSUM_SLACK: f64 = 0.75;
/// An IMU or a height whose CUSUM is above this part of its limit is left out while most of the others are not: where
/// several measure the same, going without one for a moment costs less than a lie that is not yet certain.
const DOUBT: f64 = 0.3;
/// Below this part of its limit a CUSUM is where noise takes it.
const CALM_RATIO: f64 = 0.125;
/// Limit of a CUSUM, in sigmas: a mean time between false alarms of weeks for independent values (Wald:
/// exp(2 k h) / 2 k² values).
pub const CUSUM_LIMIT: f64 = 16.0;

/// Quantile of χ² with `n` degrees of freedom at `z` one-sided sigmas (Wilson and Hilferty 1931).
pub fn chi_square(n: usize, z: f64) -> f64 {
    let n = n.max(1) as f64;
    let a = 2.0 / (9.0 * n);
    n * (1.0 - a + z * a.sqrt()).powi(3)
}

/// One-sided sigmas of 99.9 %.
pub const Z_999: f64 = 3.0902;

/// Cumulative sums in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cusum {
    up: f64,
    down: f64,
    /// Values since each was last zero: Page's estimate of how long the drift has lasted.
    up_for: u32,
    down_for: u32,
}

impl Cusum {
    /// Takes one deviation, in sigmas; what is not finite is left out.
    pub fn take(&mut self, deviation: f64) {
        if deviation.is_finite() {
            // A single outlier is the window's business; a cap lets the sum fall again when the lie ends.
            let d = deviation.clamp(-4.0, 4.0);
            let sum = |before: f64, d: f64| (before + d - CUSUM_SLACK).clamp(0.0, 1.5 * CUSUM_LIMIT);
            (self.up, self.down) = (sum(self.up, d), sum(self.down, -d));
            let length = |before: u32, sum: f64| if sum > 0.0 { before.saturating_add(1) } else { 0 };
            (self.up_for, self.down_for) = (length(self.up_for, self.up), length(self.down_for, self.down));
        }
    }

    /// Is it so far up that its sensor is in doubt?
    pub fn is_in_doubt(&self) -> bool {
        self.ratio() > DOUBT
    }

    /// Is it where noise alone takes it?
    pub fn is_calm(&self) -> bool {
        self.ratio() < CALM_RATIO
    }

    /// The larger sum over its limit.
    pub fn ratio(&self) -> f64 {
        self.up.max(self.down) / CUSUM_LIMIT
    }

    /// Values since the larger sum was zero.
    pub fn lasts(&self) -> u32 {
        if self.up > self.down { self.up_for } else { self.down_for }
    }
}

/// Counts equal samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stuck<const N: usize> {
    last: Option<[f64; N]>,
    repeats: u32,
}

impl<const N: usize> Stuck<N> {
    /// Takes a sample; how many before it were the same.
    pub fn take(&mut self, sample: [f64; N]) -> u32 {
        // The same bits: no tolerance is meant.
        self.repeats = if self.last.is_some_and(|last| last == sample) { self.repeats.saturating_add(1) } else { 0 };
        self.last = Some(sample);
        self.repeats
    }
}

/// How many equal samples in a row noise of `sigma`, read in steps of `resolution`, does not explain (once in
/// 10⁸). The chance of one is resolution / 2√π σ.
pub fn stuck_limit(sigma: f64, resolution: f64) -> u32 {
    let chance = (resolution / (3.545 * sigma)).clamp(1e-6, 0.5);
    ((1e-8f64).ln() / chance.ln()).ceil().clamp(3.0, 30.0) as u32
}

/// What is measured about one sensor in one window.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Evidence {
    /// Largest χ² statistic of its rows over the 99.9 % limit.
    pub window_ratio: f64,
    /// Largest CUSUM of its rows over its limit.
    pub drift_ratio: f64,
    /// How long that drift has lasted, s.
    pub drift_s: f64,
    /// Is it stuck?
    pub stuck: bool,
    /// Does it drift from those that sample with it?
    pub apart: bool,
}

/// One sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Device {
    /// Which.
    pub sensor: SensorId,
    /// Its last sample.
    pub seen: FlightTime,
    /// Did a sample arrive lately?
    pub present: bool,
    /// The last evidence.
    pub evidence: Evidence,
    /// Since when, and why, it is flagged.
    pub flagged: Option<(FlightTime, FlagReason)>,
    suspect: u32,
    certain: u32,
    calm: u32,
}

/// A set of sensors that are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Withheld(u16);

impl Withheld {
    fn bit(sensor: SensorId) -> u16 {
        let index = usize::from(sensor.instance.saturating_sub(1));
        let first = match sensor.kind {
            SensorKind::Imu => 0,
            SensorKind::Height => MAX_IMUS,
            _ => MAX_IMUS + MAX_HEIGHTS,
        };
        1u16.checked_shl((first + index) as u32).unwrap_or_default()
    }

    /// Leaves out `sensor` as well.
    pub fn add(&mut self, sensor: SensorId) {
        self.0 |= Self::bit(sensor);
    }

    /// Is `sensor` left out?
    pub fn contains(self, sensor: SensorId) -> bool {
        self.0 & Self::bit(sensor) != 0
    }

    /// Who is in either.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Who is in this and not in `other`.
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Nobody.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// What stands between a type of sensor and a wrong state: m − 2·flagged more attacks than half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Margin {
    /// Type.
    pub kind: SensorKind,
    /// Present.
    pub present: usize,
    /// Flagged.
    pub flagged: usize,
}

impl Margin {
    /// m − 2·flagged: 0 or less promises nothing.
    pub fn margin(&self) -> i32 {
        self.present as i32 - 2 * self.flagged as i32
    }
}

/// Types that are judged.
pub const KINDS: [SensorKind; 3] = [SensorKind::Imu, SensorKind::Height, SensorKind::Barometer];

/// The attacked set.
#[derive(Debug, Clone)]
pub struct Identifier {
    devices: ArrayVec<Device, MAX_DEVICES>,
    /// Windows in a row above the 99.9 % limit that flag: one more than the slots of a window, so that no sample of the
    /// first is left in the last. One outlier is in ten windows of ten slots and never in eleven.
    confirm: u32,
    /// Windows in a row in which a group contradicted itself.
    contradicted: u32,
}

impl Identifier {
    /// Nobody known yet; windows of so many slots.
    pub fn new(slots: usize) -> Self {
        Self {
            devices: ArrayVec::new(),
            confirm: u32::try_from(slots).unwrap_or(u32::MAX).saturating_add(1),
            contradicted: 0,
        }
    }

    /// A sample of `sensor` arrived.
    pub fn saw(&mut self, sensor: SensorId, now: FlightTime) {
        match self.devices.iter_mut().find(|d| d.sensor == sensor) {
            Some(device) => {
                device.seen = now;
                device.present = true;
            }
            None => {
                let _ = self.devices.try_push(Device {
                    sensor,
                    seen: now,
                    present: true,
                    evidence: Evidence::default(),
                    flagged: None,
                    suspect: 0,
                    certain: 0,
                    calm: 0,
                });
            }
        }
    }

    /// Every sensor seen so far.
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// Is `sensor` flagged?
    pub fn is_flagged(&self, sensor: SensorId) -> bool {
        self.devices.iter().any(|d| d.sensor == sensor && d.flagged.is_some())
    }

    /// Who is left out: the flagged, IMUs and heights in doubt while most of their type are not, and those that
    /// stand apart from their company while two and half of their type neither do nor are in doubt.
    pub fn withheld(&self) -> Withheld {
        let in_doubt = |d: &Device| d.flagged.is_some() || d.evidence.drift_ratio > DOUBT;
        let mut withheld = Withheld::default();
        for kind in KINDS {
            let of = || self.devices.iter().filter(|d| d.sensor.kind == kind && d.present);
            let (all, doubted) = (of().count(), of().filter(|d| in_doubt(d)).count());
            let left = of().filter(|d| !in_doubt(d) && !d.evidence.apart).count();
            let spared = kind != SensorKind::Barometer && 2 * doubted < all;
            let enough = left >= 2 && 2 * left >= all;
            let out = |d: &&Device| spared && in_doubt(d) || enough && d.evidence.apart;
            of().filter(out).for_each(|d| withheld.add(d.sensor));
        }
        self.devices.iter().filter(|d| d.flagged.is_some()).for_each(|d| withheld.add(d.sensor));
        withheld
    }

    /// Is `sensor` above a limit, flagged or not?
    pub fn is_suspect(&self, sensor: SensorId) -> bool {
        self.devices.iter().any(|d| d.sensor == sensor && (d.flagged.is_some() || d.suspect > 0))
    }

    /// Margin of `kind`.
    pub fn margin(&self, kind: SensorKind) -> Margin {
        let of = || self.devices.iter().filter(|d| d.sensor.kind == kind && d.present);
        Margin { kind, present: of().count(), flagged: of().filter(|d| d.flagged.is_some()).count() }
    }

    /// Has a group contradicted itself for a whole window so that nobody could be blamed?
    pub fn contradicted(&self) -> bool {
        self.contradicted >= self.confirm
    }

    /// Forgets every flag and count; the sensors stay known.
    pub fn reset(&mut self) {
        for device in &mut self.devices {
            (device.flagged, device.suspect, device.certain, device.calm) = (None, 0, 0, 0);
        }
        self.contradicted = 0;
    }

    /// Takes the evidence of one decoded window; while `learning`, no flag is raised for it.
    pub fn judge(&mut self, now: FlightTime, learning: bool, evidence: impl Fn(SensorId) -> Evidence) {
        for device in &mut self.devices {
            device.present = now.seconds_since(device.seen) <= PRESENT_S;
            let e = evidence(device.sensor);
            device.evidence = e;
            let count = |counter: &mut u32, holds: bool| *counter = if holds { counter.saturating_add(1) } else { 0 };
            count(&mut device.suspect, e.window_ratio > 1.0);
            count(&mut device.certain, e.window_ratio > CERTAIN);
            count(&mut device.calm, e.window_ratio <= 1.0 && e.drift_ratio <= 0.5 && !e.stuck);
            if device.flagged.is_some() && device.calm >= CALM {
                device.flagged = None;
            }
        }
        if learning {
            self.contradicted = 0;
            return;
        }
        // The worst first. No more flags than sensors: every pass raises one or is the last.
        for _ in 0..MAX_DEVICES {
            let worst = (0..self.devices.len())
                .filter_map(|i| Some((i, self.reason(i)?)))
                .max_by(|a, b| self.badness(a.0).total_cmp(&self.badness(b.0)));
            let Some((index, reason)) = worst else { break };
            if !self.may_flag(index) {
                self.contradicted = self.contradicted.saturating_add(1);
                return;
            }
            if let Some(device) = self.devices.get_mut(index) {
                device.flagged = Some((now, reason));
                device.calm = 0;
            }
        }
        self.contradicted = 0;
    }

    /// Why `index`, not yet flagged, should be.
    fn reason(&self, index: usize) -> Option<FlagReason> {
        let d = self.devices.get(index).filter(|d| d.flagged.is_none() && d.present)?;
        if d.evidence.stuck {
            Some(FlagReason::Stuck)
        } else if d.suspect >= self.confirm || d.certain >= 2 {
            Some(FlagReason::Window)
        } else if d.evidence.drift_ratio > 1.0 {
            Some(FlagReason::Drift)
        } else {
            None
        }
    }

    fn badness(&self, index: usize) -> f64 {
        self.devices.get(index).map_or(0.0, |d| {
            let e = d.evidence;
            e.window_ratio.max(e.drift_ratio) + if e.stuck { 1e6 } else { 0.0 }
        })
    }

    /// The rank guard: something of the same quantity stays, and a majority stays or the accused is far worse.
    fn may_flag(&self, index: usize) -> bool {
        let Some(accused) = self.devices.get(index) else { return false };
        let vertical = |kind| matches!(kind, SensorKind::Height | SensorKind::Barometer);
        let same = |d: &&Device| {
            d.sensor.kind == accused.sensor.kind || (vertical(d.sensor.kind) && vertical(accused.sensor.kind))
        };
        let left = |d: &&Device| d.present && d.flagged.is_none() && d.sensor != accused.sensor;
        if !self.devices.iter().filter(same).any(|d| left(&d)) {
            return false;
        }
        let margin = self.margin(accused.sensor.kind);
        // With it out, more than half are left: 3 of which 1, 4 of which 1, 5 of which 2.
        if margin.margin() >= 3 || accused.evidence.stuck {
            return true;
        }
        let own_kind = self.devices.iter().filter(|d| d.sensor.kind == accused.sensor.kind);
        let next =
            own_kind.filter(left).map(|d| d.evidence.window_ratio.max(d.evidence.drift_ratio)).fold(0.0, f64::max);
        self.badness(index) > FAR_WORSE * next.max(0.25)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn height(instance: u8) -> SensorId {
        SensorId::new(SensorKind::Height, instance)
    }

    fn seen(heights: u8) -> Identifier {
        let mut identifier = Identifier::new(10);
        (1..=heights).for_each(|i| identifier.saw(height(i), FlightTime(0)));
        identifier
    }

    fn window(ratio: f64) -> Evidence {
        Evidence { window_ratio: ratio, ..Evidence::default() }
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (n, expected) in [(1, 10.83), (4, 18.47), (10, 29.59)] {
            assert!((chi_square(n, Z_999) / expected - 1.0).abs() < 0.04, "{n}: {}", chi_square(n, Z_999));
        }
    }

    #[test]
    fn one_bad_window_flags_nobody_and_ten_do() {
        let mut identifier = seen(3);
        let judge = |identifier: &mut Identifier, k: u64, ratio: f64| {
            let now = FlightTime(k * 40_000);
            (1..=3).for_each(|i| identifier.saw(height(i), now));
            identifier.judge(now, false, |s| window(if s.instance == 2 { ratio } else { 0.3 }));
        };
        for k in 0..10_u32 {
            judge(&mut identifier, u64::from(k), 1.2);
        }
        assert!(!identifier.is_flagged(height(2)) && identifier.is_suspect(height(2)));
        judge(&mut identifier, 10, 0.9);
        for k in 11..11 + 11 {
            judge(&mut identifier, k, 1.2);
        }
        assert!(identifier.is_flagged(height(2)));
        assert_eq!(identifier.margin(SensorKind::Height).margin(), 1);
        // It stays flagged until it has been calm for long.
        for k in 30..30 + u64::from(CALM) - 1 {
            judge(&mut identifier, k, 0.5);
        }
        assert!(identifier.is_flagged(height(2)));
        judge(&mut identifier, 100, 0.5);
        assert!(!identifier.is_flagged(height(2)));
        // Gross lies take two windows.
        judge(&mut identifier, 101, 50.0);
        judge(&mut identifier, 102, 50.0);
        assert!(identifier.is_flagged(height(2)));
    }

    #[test]
    fn a_group_is_never_emptied_and_two_that_contradict_each_other_blame_nobody() {
        let mut identifier = seen(2);
        for _ in 0..20 {
            identifier.judge(FlightTime(0), false, |s| window(if s.instance == 1 { 9.0 } else { 8.0 }));
        }
        assert!(identifier.contradicted() && !identifier.is_flagged(height(1)) && !identifier.is_flagged(height(2)));
        let mut identifier = seen(3);
        for _ in 0..20 {
            identifier.judge(FlightTime(0), false, |_| window(1000.0));
        }
        let flagged = identifier.devices().iter().filter(|d| d.flagged.is_some()).count();
        assert_eq!((flagged, identifier.contradicted()), (1, true));
        // One alone is never flagged.
        let mut identifier = seen(1);
        identifier.judge(FlightTime(0), false, |_| Evidence { stuck: true, ..Evidence::default() });
        assert!(!identifier.is_flagged(height(1)));
    }

    #[test]
    fn while_learning_nobody_is_flagged_and_absent_sensors_do_not_count() {
        let mut identifier = seen(3);
        (0..30).for_each(|_| identifier.judge(FlightTime(0), true, |_| window(9.0)));
        assert_eq!(identifier.margin(SensorKind::Height).flagged, 0);
        identifier.saw(height(1), FlightTime(5_000_000));
        identifier.judge(FlightTime(5_000_000), false, |_| Evidence::default());
        assert_eq!(identifier.margin(SensorKind::Height).present, 1);
    }

    #[test]
    fn a_sensor_in_doubt_is_left_out_while_most_of_its_type_are_not() {
        for (kind, expected) in [(SensorKind::Imu, [0, 1, 0]), (SensorKind::Height, [0, 1, 0])] {
            let judged = |doubted: u8| {
                let mut identifier = Identifier::new(10);
                (1..=4).for_each(|i| identifier.saw(SensorId::new(kind, i), FlightTime(0)));
                let drift = |s: SensorId| if s.instance <= doubted { 0.7 } else { 0.1 };
                identifier.judge(FlightTime(0), false, |s| Evidence { drift_ratio: drift(s), ..Evidence::default() });
                (1..=4).filter(|i| identifier.withheld().contains(SensorId::new(kind, *i))).count()
            };
            assert_eq!([judged(0), judged(1), judged(2)], expected);
        }
        // And one that stands apart while two and half are left.
        let apart = |all: u8, apart: u8| {
            let mut identifier = seen(all);
            identifier.judge(FlightTime(0), false, |s| Evidence { apart: s.instance <= apart, ..Evidence::default() });
            (1..=all).filter(|i| identifier.withheld().contains(height(*i))).count()
        };
        assert_eq!([apart(2, 1), apart(3, 1), apart(3, 2), apart(4, 2), apart(5, 3)], [0, 1, 0, 2, 0]);
        let mut withheld = Withheld::default();
        withheld.add(height(3));
        assert!(withheld.contains(height(3)) && !withheld.contains(height(2)) && !withheld.is_empty());
        assert!(withheld.without(withheld).is_empty() && withheld.with(Withheld::default()) == withheld);
    }

    #[test]
    fn a_cusum_rises_for_a_drift_and_not_for_noise() {
        let mut cusum = Cusum::default();
        for k in 0..20_000_u32 {
            // Bounded pseudo-noise of unit variance.
            cusum.take(1.414 * (f64::from(k * k % 9973) * 0.7).sin());
            assert!(cusum.ratio() < 1.0, "at {k}");
        }
        let mut taken = 0;
        while cusum.ratio() <= 1.0 && taken < 1000 {
            cusum.take(1.5 + 1.414 * (f64::from(taken * taken % 997) * 0.7).sin());
            taken += 1;
        }
        assert!(taken < 60, "{taken}");
        cusum.take(f64::NAN);
        assert!(cusum.ratio().is_finite());
    }

    #[test]
    fn equal_samples_are_counted() {
        let mut stuck = Stuck::<2>::default();
        assert_eq!([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 3.0]].map(|s| stuck.take(s)), [0, 1, 2, 0]);
        // 1 mm steps, 7 mm of noise: one in 25 is equal to the one before.
        assert_eq!(stuck_limit(0.007, 0.001), 6);
        assert_eq!(stuck_limit(1.0, 0.0), 3);
    }
}
