//! Isolation of the attacked set, from statistics of the decoded window, of seconds, and of single samples.
//!
//! | test | statistic | limit | catches |
//! |---|---|---|---|
//! | window | ‖whitened residual‖² of a row | χ² at 99.9 % for a whole window long, or far beyond it twice | what contradicts the others now |
//! | drift | two-sided CUSUM of the deviation from the group's median (`cusum.rs`) | its limit | slow ramps, low-amplitude replay |
//! | stuck | equal samples in a row while others of the type move | by σ and resolution | freeze |
//!
//! One window in a thousand is suspect without any attack, and there are 25 a second: nothing is flagged
//! for one. A flag falls after `CALM` windows within every limit. The rank guard keeps a group that measures the same
//! quantity from being emptied, and where a group contradicts itself without a majority only a sensor far worse
//! than the rest is flagged: the group is inconsistent ([`Isolation::contradicted`]).
//!
//! Isolated (flagged): in the attacked set. Excluded: not given to the filter; the isolated, and those in doubt while
//! most of their kind are not.

use arrayvec::ArrayVec;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
pub use plumbline_proto::v1::FlagReason;
use plumbline_proto::v1::SensorKind;

use super::cusum::DOUBT;
use crate::sensor::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS};

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
/// Quantile of χ² with `n` degrees of freedom at `z` one-sided sigmas (Wilson and Hilferty 1931).
pub fn chi_square(n: usize, z: f64) -> f64 {
    let n = n.max(1) as f64;
    let a = 2.0 / (9.0 * n);
    n * (1.0 - a + z * a.sqrt()).powi(3)
}

/// One-sided sigmas of 99.9 %.
pub const Z_999: f64 = 3.0902;

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
    /// Does it diverge from the IMUs that sample with it?
    pub diverging: bool,
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

/// A set of sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SensorSet(u16);

impl SensorSet {
    fn bit(sensor: SensorId) -> u16 {
        let index = usize::from(sensor.instance.saturating_sub(1));
        let first = match sensor.kind {
            SensorKind::Imu => 0,
            SensorKind::Height => MAX_IMUS,
            _ => MAX_IMUS + MAX_HEIGHTS,
        };
        1u16.checked_shl((first + index) as u32).unwrap_or_default()
    }

    /// Adds `sensor`.
    pub fn add(&mut self, sensor: SensorId) {
        self.0 |= Self::bit(sensor);
    }

    /// Is `sensor` in it?
    pub fn contains(self, sensor: SensorId) -> bool {
        self.0 & Self::bit(sensor) != 0
    }

    /// What is in either.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// What is in this and not in `other`.
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Is it empty?
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
pub struct Isolation {
    devices: ArrayVec<Device, MAX_DEVICES>,
    /// Windows in a row above the 99.9 % limit that flag: one more than the slots of a window, so that no sample of the
    /// first is left in the last. One outlier is in ten windows of ten slots and never in eleven.
    confirm: u32,
    /// Windows in a row in which a group contradicted itself.
    contradicted: u32,
}

impl Isolation {
    /// No sensor known yet; windows of so many slots.
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

    /// Excluded from the filter: the flagged, IMUs and heights in doubt while most of their type are not, and IMUs that
    /// diverge from those that sample with them while two and half of their type neither do nor are in doubt.
    pub fn excluded(&self) -> SensorSet {
        let in_doubt = |d: &Device| d.flagged.is_some() || d.evidence.drift_ratio > DOUBT;
        let mut excluded = SensorSet::default();
        for kind in KINDS {
            let of = || self.devices.iter().filter(|d| d.sensor.kind == kind && d.present);
            let (all, doubted) = (of().count(), of().filter(|d| in_doubt(d)).count());
            let healthy = of().filter(|d| !in_doubt(d) && !d.evidence.diverging).count();
            let spared = kind != SensorKind::Barometer && 2 * doubted < all;
            let enough = healthy >= 2 && 2 * healthy >= all;
            let out = |d: &&Device| spared && in_doubt(d) || enough && d.evidence.diverging;
            of().filter(out).for_each(|d| excluded.add(d.sensor));
        }
        self.devices.iter().filter(|d| d.flagged.is_some()).for_each(|d| excluded.add(d.sensor));
        excluded
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

    /// Has a group been inconsistent for a whole window so that no sensor could be isolated?
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
    pub fn isolate(&mut self, now: FlightTime, learning: bool, evidence: impl Fn(SensorId) -> Evidence) {
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
        // The worst first. No more passes than sensors: each flags one, or spares one for good: those of other types may
        // be flagged all the same.
        let mut spared = SensorSet::default();
        for _ in 0..MAX_DEVICES {
            let worst = (0..self.devices.len())
                .filter_map(|i| Some((i, self.reason(i)?)))
                .filter(|(i, _)| self.devices.get(*i).is_some_and(|d| !spared.contains(d.sensor)))
                .max_by(|a, b| self.badness(a.0).total_cmp(&self.badness(b.0)));
            let Some((index, reason)) = worst else { break };
            let may_flag = self.may_flag(index);
            let Some(device) = self.devices.get_mut(index) else { break };
            if may_flag {
                device.flagged = Some((now, reason));
                device.calm = 0;
            } else {
                spared.add(device.sensor);
            }
        }
        self.contradicted = if spared.is_empty() { 0 } else { self.contradicted.saturating_add(1) };
    }

    /// Takes evidence and verdict of another judge: the flags are what `judged` says of each sensor, and whether a group is
    /// `contradicted`.
    pub fn announce(
        &mut self,
        now: FlightTime,
        contradicted: bool,
        judged: impl Fn(SensorId) -> (Evidence, Option<FlagReason>),
    ) {
        for device in &mut self.devices {
            device.present = now.seconds_since(device.seen) <= PRESENT_S;
            let (evidence, verdict) = judged(device.sensor);
            device.evidence = evidence;
            device.flagged = verdict.map(|reason| (device.flagged.map_or(now, |(since, _)| since), reason));
        }
        self.contradicted = if contradicted { self.confirm } else { 0 };
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

    /// The rank guard: something of the same quantity stays, and a majority stays or the candidate is far worse.
    fn may_flag(&self, index: usize) -> bool {
        let Some(candidate) = self.devices.get(index) else { return false };
        let vertical = |kind| matches!(kind, SensorKind::Height | SensorKind::Barometer);
        let same = |d: &&Device| {
            d.sensor.kind == candidate.sensor.kind || (vertical(d.sensor.kind) && vertical(candidate.sensor.kind))
        };
        let left = |d: &&Device| d.present && d.flagged.is_none() && d.sensor != candidate.sensor;
        if !self.devices.iter().filter(same).any(|d| left(&d)) {
            return false;
        }
        let margin = self.margin(candidate.sensor.kind);
        // With it out, more than half are left: 3 of which 1, 4 of which 1, 5 of which 2.
        if margin.margin() >= 3 || candidate.evidence.stuck {
            return true;
        }
        let own_kind = self.devices.iter().filter(|d| d.sensor.kind == candidate.sensor.kind);
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

    fn seen(heights: u8) -> Isolation {
        let mut isolation = Isolation::new(10);
        (1..=heights).for_each(|i| isolation.saw(height(i), FlightTime(0)));
        isolation
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
    fn one_bad_window_isolates_nothing_and_eleven_do() {
        let mut isolation = seen(3);
        let isolate = |isolation: &mut Isolation, k: u64, ratio: f64| {
            let now = FlightTime(k * 40_000);
            (1..=3).for_each(|i| isolation.saw(height(i), now));
            isolation.isolate(now, false, |s| window(if s.instance == 2 { ratio } else { 0.3 }));
        };
        for k in 0..10_u32 {
            isolate(&mut isolation, u64::from(k), 1.2);
        }
        assert!(!isolation.is_flagged(height(2)) && isolation.is_suspect(height(2)));
        isolate(&mut isolation, 10, 0.9);
        for k in 11..11 + 11 {
            isolate(&mut isolation, k, 1.2);
        }
        assert!(isolation.is_flagged(height(2)));
        assert_eq!(isolation.margin(SensorKind::Height).margin(), 1);
        // It stays flagged until it has been calm for long.
        for k in 30..30 + u64::from(CALM) - 1 {
            isolate(&mut isolation, k, 0.5);
        }
        assert!(isolation.is_flagged(height(2)));
        isolate(&mut isolation, 100, 0.5);
        assert!(!isolation.is_flagged(height(2)));
        // Gross attacks take two windows.
        isolate(&mut isolation, 101, 50.0);
        isolate(&mut isolation, 102, 50.0);
        assert!(isolation.is_flagged(height(2)));
    }

    #[test]
    fn a_group_is_never_emptied_and_two_that_contradict_each_other_stay() {
        let mut isolation = seen(2);
        for _ in 0..20 {
            isolation.isolate(FlightTime(0), false, |s| window(if s.instance == 1 { 9.0 } else { 8.0 }));
        }
        assert!(isolation.contradicted() && !isolation.is_flagged(height(1)) && !isolation.is_flagged(height(2)));
        // Nor do they keep one of another type from being flagged.
        let imu = |instance| SensorId::new(SensorKind::Imu, instance);
        (1..=4).for_each(|i| isolation.saw(imu(i), FlightTime(0)));
        for _ in 0..20 {
            isolation.isolate(FlightTime(0), false, |s| match (s.kind, s.instance) {
                (SensorKind::Height, 1) => window(9.0),
                (SensorKind::Height, _) => window(8.0),
                (_, 3) => window(5.0),
                _ => window(0.3),
            });
        }
        assert!((1..=4).all(|i| isolation.is_flagged(imu(i)) == (i == 3)));
        assert!(isolation.contradicted() && !isolation.is_flagged(height(1)) && !isolation.is_flagged(height(2)));
        let mut isolation = seen(3);
        for _ in 0..20 {
            isolation.isolate(FlightTime(0), false, |_| window(1000.0));
        }
        let flagged = isolation.devices().iter().filter(|d| d.flagged.is_some()).count();
        assert_eq!((flagged, isolation.contradicted()), (1, true));
        // One alone is never flagged.
        let mut isolation = seen(1);
        isolation.isolate(FlightTime(0), false, |_| Evidence { stuck: true, ..Evidence::default() });
        assert!(!isolation.is_flagged(height(1)));
    }

    #[test]
    fn while_learning_nothing_is_flagged_and_absent_sensors_do_not_count() {
        let mut isolation = seen(3);
        (0..30).for_each(|_| isolation.isolate(FlightTime(0), true, |_| window(9.0)));
        assert_eq!(isolation.margin(SensorKind::Height).flagged, 0);
        isolation.saw(height(1), FlightTime(5_000_000));
        isolation.isolate(FlightTime(5_000_000), false, |_| Evidence::default());
        assert_eq!(isolation.margin(SensorKind::Height).present, 1);
    }

    #[test]
    fn a_sensor_in_doubt_is_excluded_while_most_of_its_type_are_not() {
        for (kind, expected) in [(SensorKind::Imu, [0, 1, 0]), (SensorKind::Height, [0, 1, 0])] {
            let judged = |doubted: u8| {
                let mut isolation = Isolation::new(10);
                (1..=4).for_each(|i| isolation.saw(SensorId::new(kind, i), FlightTime(0)));
                let drift = |s: SensorId| if s.instance <= doubted { 0.7 } else { 0.1 };
                isolation.isolate(FlightTime(0), false, |s| Evidence { drift_ratio: drift(s), ..Evidence::default() });
                (1..=4).filter(|i| isolation.excluded().contains(SensorId::new(kind, *i))).count()
            };
            assert_eq!([judged(0), judged(1), judged(2)], expected);
        }
        // And one that diverges while two and half are left.
        let diverging = |all: u8, apart: u8| {
            let mut isolation = seen(all);
            isolation
                .isolate(FlightTime(0), false, |s| Evidence { diverging: s.instance <= apart, ..Evidence::default() });
            (1..=all).filter(|i| isolation.excluded().contains(height(*i))).count()
        };
        assert_eq!(
            [diverging(2, 1), diverging(3, 1), diverging(3, 2), diverging(4, 2), diverging(5, 3)],
            [0, 1, 0, 2, 0]
        );
        let mut excluded = SensorSet::default();
        excluded.add(height(3));
        assert!(excluded.contains(height(3)) && !excluded.contains(height(2)) && !excluded.is_empty());
        assert!(excluded.without(excluded).is_empty() && excluded.with(SensorSet::default()) == excluded);
    }
}
