//! Every curve a chart can show, by name; each a [`Series`] over flight time in seconds.

use std::collections::BTreeMap;
use std::ops::Range;

use plumbline_proto::v1;

use plumbline_rest::flight::{Curves as Recomputed, Figures, OVERVIEW_COLUMNS, Samples};

use super::series::Series;

mod errors;

/// How long samples of a live curve are kept, s: the longest window, ten minutes, and what is before it on its chart.
const LIVE_S: f64 = 660.0;
/// Samples kept of one at most: as long at the 40 Hz that the ground thins what a page shows to …
const LIVE_SAMPLES: usize = 1 << 15;
/// … of residuals, of which it sends 8 in each second and which are most of the curves …
const RESIDUAL_SAMPLES: usize = 1 << 13;
/// … and of what it does not thin: heights, at 100 Hz …
const HEIGHT_SAMPLES: usize = 1 << 16;
/// … and the few signals on charts, at up to 200 Hz.
const SIGNAL_SAMPLES: usize = 1 << 17;
/// Samples of a curve that the ground thinned for this page, at most: two for each of its stretches of time.
const PAST_SAMPLES: usize = 1 << 12;
/// Samples kept of one curve of a recorded flight: over an hour at 200 Hz.
const RECORDED_SAMPLES: usize = 1 << 20;
/// A live curve breaks where samples are further apart than this, s.
pub const GAP_S: f64 = 1.0;
/// A live signal does where they are further apart than this, s: some are sent once a second.
const SIGNAL_GAP_S: f64 = 2.5;

/// Degrees per radian.
pub const DEGREES: f64 = 180.0 / std::f64::consts::PI;

/// An axis of attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Axis {
    /// About the body's x.
    Roll,
    /// About y.
    Pitch,
    /// About z.
    Yaw,
}

impl Axis {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Roll, Self::Pitch, Self::Yaw];

    /// "roll"
    pub const fn name(self) -> &'static str {
        match self {
            Self::Roll => "roll",
            Self::Pitch => "pitch",
            Self::Yaw => "yaw",
        }
    }
}

/// A direction of the world that a velocity is shown along.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Way {
    /// z of the world.
    Up,
    /// x.
    East,
    /// y.
    North,
}

impl Way {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Up, Self::East, Self::North];

    /// "up"
    pub const fn name(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::East => "east",
            Self::North => "north",
        }
    }

    fn of(self, vector: &v1::Vector3) -> f64 {
        match self {
            Self::Up => vector.z,
            Self::East => vector.x,
            Self::North => vector.y,
        }
    }
}

/// An axis of the plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Horizontal {
    /// x of the world.
    East,
    /// y of it.
    North,
}

/// One scalar residual: estimator, sensor kind, instance, channel, by their numbers.
pub type ResidualKey = (u16, i32, u32, i32);

/// What an autopilot is asked for by rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Demand {
    /// A rate of the body about one of its axes.
    Rate(Axis),
    /// Collective thrust.
    Thrust,
}

impl Demand {
    /// All four.
    pub const ALL: [Self; 4] = [Self::Rate(Axis::Roll), Self::Rate(Axis::Pitch), Self::Rate(Axis::Yaw), Self::Thrust];
}

/// The name of a curve. Angles are in degrees, as on screen; all else SI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Curve {
    /// Altitude setpoint after limits, m.
    SetpointAltitude,
    /// Altitude of an estimator, m.
    Altitude(u16),
    /// Velocity of an estimator, m/s; along the ground where it observes it.
    Velocity(u16, Way),
    /// True velocity, m/s.
    TruthVelocity(Way),
    /// A laser height as the estimators received it, m.
    Height(u16),
    /// True altitude, m.
    TruthAltitude,
    /// Altitude of the estimator in the loop less (false) or more (true) what an unseen attack on one sensor could do, m.
    Reach(bool),
    /// Position of the estimator in the loop while it knows one, east and north, m.
    Plane(Horizontal),
    /// True position, m.
    TruthPlane(Horizontal),
    /// An estimator's attitude, °.
    Attitude(u16, Axis),
    /// True attitude, °.
    TruthAttitude(Axis),
    /// Altitude of an estimator that was run over the recording again, m.
    AgainAltitude(u16),
    /// Its attitude, °.
    AgainAttitude(u16, Axis),
    /// A motor's command as applied, 0..1.
    Motor(u8),
    /// What an autopilot was asked for: a rate of the body, rad/s (FLU), or thrust, 0..1.
    Asked(Demand),
    /// What it said that its own loops aim at.
    AimedAt(Demand),
    /// Innovation of one scalar, in its screen unit.
    Innovation(ResidualKey),
    /// Gate of one scalar, in its screen unit.
    Gate(ResidualKey),
    /// Innovation ratio of the worst channel of a sensor: estimator, kind, instance.
    Worst(u16, i32, u32),
    /// How suspect the secure estimator finds a sensor (kind, instance): statistic / limit, above 1 once flagged.
    Suspicion(i32, u32),
    /// Work in a tick, median, µs.
    TickMedian,
    /// Work in a tick, 99th percentile, µs.
    TickP99,
    /// Jitter of the tick's start, 99th percentile, µs.
    TickJitter,
    /// Altitude of one of several flights compared, m.
    Compared(u8),
    /// Its setpoint, m.
    ComparedSetpoint(u8),
    /// Its altitude minus that of the first of them, mm.
    Difference(u8),
    /// Attitude setpoint, °.
    SetpointAttitude(Axis),
    /// One sigma of an estimator's altitude, as it says itself, m.
    AltitudeSigma(u16),
    /// One sigma of its attitude, rad.
    AttitudeSigma(u16, Axis),
    /// Altitude of an estimator minus truth, or minus the setpoint where no truth is known, mm; see [`Curves::follow_errors`].
    AltitudeError(u16),
    /// The same of its attitude, mrad.
    AttitudeError(u16, Axis),
    /// A signal that was put on a chart of its own, in its own unit.
    Signal(u8),
}

/// Curves that a legend folds into one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Group {
    /// Estimators that are not in the loop.
    Estimators,
    /// Laser heights as received.
    Heights,
    /// True angles.
    Truth,
    /// How far an unseen attack could move the vehicle.
    Reach,
}

impl Group {
    /// All of them, in the order of a legend.
    pub const ALL: [Self; 4] = [Self::Estimators, Self::Heights, Self::Truth, Self::Reach];

    /// As a legend has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Estimators => "estimators",
            Self::Heights => "heights",
            Self::Truth => "true angles",
            Self::Reach => "bounds of an unseen attack",
        }
    }
}

impl Curve {
    /// The group it is folded into; `None` for what is always worth a line.
    pub fn group(self, in_loop: u16) -> Option<Group> {
        match self {
            Self::Altitude(n) | Self::Velocity(n, _) | Self::AltitudeError(n) | Self::AttitudeError(n, _)
                if n != in_loop =>
            {
                Some(Group::Estimators)
            }
            Self::Height(_) => Some(Group::Heights),
            Self::TruthAttitude(_) => Some(Group::Truth),
            Self::Reach(_) => Some(Group::Reach),
            _ => None,
        }
    }

    /// Is it made of residuals?
    fn is_residual(self) -> bool {
        matches!(self, Self::Innovation(_) | Self::Gate(_) | Self::Worst(..))
    }

    /// Samples kept of it while it is live.
    fn live_samples(self) -> usize {
        match self {
            Self::Height(_) => HEIGHT_SAMPLES,
            Self::Signal(_) => SIGNAL_SAMPLES,
            _ if self.is_residual() => RESIDUAL_SAMPLES,
            _ => LIVE_SAMPLES,
        }
    }
}

/// The curves.
#[derive(Debug)]
pub struct Curves {
    map: BTreeMap<Curve, Series>,
    /// Samples kept of each.
    /// An empty series for a curve.
    empty: fn(Curve) -> Series,
    followed: errors::Followed,
    /// How often a whole curve was put in the place of another.
    replaced: u64,
    whole: Whole,
}

/// Where every recorded sample is on the curves, and not what is left of it after thinning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whole {
    /// Between these times, s.
    pub between_s: [f64; 2],
    /// Residuals, too?
    pub residuals: bool,
}

impl Default for Whole {
    fn default() -> Self {
        Self { between_s: [f64::NEG_INFINITY, f64::INFINITY], residuals: true }
    }
}

impl Whole {
    /// Nowhere.
    pub const NOWHERE: Self = Self { between_s: [f64::INFINITY, f64::NEG_INFINITY], residuals: false };

    /// Is a curve whole between two times?
    pub fn covers(&self, curve: Curve, from_s: f64, to_s: f64) -> bool {
        self.between_s[0] <= from_s && to_s <= self.between_s[1] && (self.residuals || !curve.is_residual())
    }
}

impl Default for Curves {
    fn default() -> Self {
        Self::of(|curve| Series::new(curve.live_samples()).with_span(LIVE_S))
    }
}

impl Curves {
    fn of(empty: fn(Curve) -> Series) -> Self {
        Self {
            map: BTreeMap::new(),
            empty,
            followed: errors::Followed::default(),
            replaced: 0,
            whole: Whole::default(),
        }
    }

    /// For a recorded flight: everything is kept.
    pub fn unbounded() -> Self {
        Self::of(|_| Series::new(RECORDED_SAMPLES))
    }

    /// For a past that is to be laid under live curves.
    pub fn short() -> Self {
        Self::of(|_| Series::new(PAST_SAMPLES))
    }

    /// Lays `past` under each curve, between `from_s` and the curve's first sample after that.
    pub fn fill(&mut self, from_s: f64, past: &Self) {
        // Samples are numbered anew below.
        self.forget_errors();
        let empty = self.empty;
        for (curve, past) in &past.map {
            let series = self.map.entry(*curve).or_insert_with(|| empty(*curve).with_max_gap(GAP_S));
            let cut = series.upper_bound(from_s);
            let until_s = series.get(cut).map_or(f64::INFINITY, |(time_s, _)| time_s);
            let mut between = past.samples(past.upper_bound(from_s)..past.lower_bound(until_s)).peekable();
            if between.peek().is_none() {
                continue;
            }
            let after = series.split_off(cut);
            for (time_s, value) in between.chain(after) {
                series.push(time_s, value);
            }
        }
    }

    /// Does every sample of a curve that was recorded between two times lie on it?
    pub fn is_whole(&self, curve: Curve, one_s: f64, other_s: f64) -> bool {
        // Outside of the flight there is none.
        let Some(span) = self.time_span_s() else { return true };
        let [one_s, other_s] = [one_s, other_s].map(|time_s| time_s.clamp(span.start, span.end));
        self.whole.covers(curve, one_s.min(other_s), one_s.max(other_s))
    }

    /// Was nothing of them thinned?
    pub fn is_everywhere_whole(&self) -> bool {
        self.whole == Whole::default()
    }

    /// The same curves once more, to refine them from.
    pub fn copy(&self) -> Self {
        Self { map: self.map.clone(), ..Self::of(self.empty) }
    }

    /// Takes the curves of `overview`, whose samples stand for `step_s` each, with those of `detail` between two times in
    /// their place; `whole` says where every sample is. Curves that neither has stay.
    pub fn refine(&mut self, overview: &Self, step_s: f64, detail: Option<(&Self, [f64; 2])>, whole: Whole) {
        self.forget_errors();
        let gap_s = GAP_S.max(2.5 * step_s);
        let names = overview.map.keys().chain(detail.iter().flat_map(|(detail, _)| detail.map.keys()));
        for name in names.copied().collect::<std::collections::BTreeSet<_>>() {
            let all = |series: &Series| series.samples(series.first()..series.end()).collect::<Vec<_>>();
            let outer = overview.map.get(&name).map(all).unwrap_or_default();
            let fine = detail.and_then(|(detail, span)| Some((all(detail.map.get(&name)?), span)));
            let samples = match fine {
                None => outer,
                Some((inner, [from_s, to_s])) => {
                    let before = outer.iter().copied().filter(|(time_s, _)| *time_s < from_s);
                    let after = outer.iter().copied().filter(|(time_s, _)| *time_s > to_s);
                    let inner = with_gaps(inner).filter(|(time_s, _)| (from_s..=to_s).contains(time_s));
                    before.chain(inner).chain(after).collect()
                }
            };
            self.map.insert(name, Series::from_samples(samples).with_max_gap(gap_s));
        }
        self.whole = whole;
        self.replaced += 1;
    }

    /// Appends one sample. Samples that run backwards in time are left out.
    pub fn push(&mut self, curve: Curve, time_us: u64, value: f64) {
        let empty = self.empty;
        self.map
            .entry(curve)
            .or_insert_with(|| empty(curve).with_max_gap(GAP_S))
            .push(time_us as f64 * 1e-6, value as f32);
    }

    /// The curve, once it has a sample.
    pub fn get(&self, curve: Curve) -> Option<&Series> {
        self.map.get(&curve)
    }

    /// Samples held of a curve.
    pub fn len(&self, curve: Curve) -> usize {
        self.map.get(&curve).map_or(0, Series::len)
    }

    /// What changes with every sample: how many are held of all curves, and how often curves were replaced.
    pub fn state(&self) -> (usize, u64) {
        (self.map.values().map(Series::len).sum(), self.replaced)
    }

    /// Has a curve hold these samples: time, s, rising, and value; with a gap where they are further apart than `gap_s`.
    pub fn set(&mut self, curve: Curve, samples: impl IntoIterator<Item = (f64, f64)>, gap_s: f64) {
        let samples = samples.into_iter().map(|(time_s, value)| (time_s, value as f32));
        self.map.insert(curve, Series::from_samples(samples).with_max_gap(gap_s.max(GAP_S)));
        self.replaced += 1;
    }

    /// Appends what came of a signal since: time, s, and value.
    pub fn extend_signal(&mut self, place: u8, samples: impl IntoIterator<Item = (f64, f64)>) {
        let curve = Curve::Signal(place);
        let empty = self.empty;
        let new = || empty(curve).with_max_gap(SIGNAL_GAP_S);
        let series = self.map.entry(curve).or_insert_with(new);
        for (time_s, value) in samples {
            series.push(time_s, value as f32);
        }
    }

    /// Takes it away.
    pub fn remove_signal(&mut self, place: u8) {
        self.map.remove(&Curve::Signal(place));
    }

    /// No curve at all?
    pub fn is_empty(&self) -> bool {
        self.map.is_empty()
    }

    /// All curves there are, in the order of their names.
    pub fn names(&self) -> impl Iterator<Item = Curve> + '_ {
        self.map.keys().copied()
    }

    /// Those from one name to another, both included.
    pub fn names_between(&self, first: Curve, last: Curve) -> impl Iterator<Item = Curve> + '_ {
        self.map.range(first..=last).map(|(curve, _)| *curve)
    }

    /// Value of the newest sample at or before `time_s`.
    pub fn value_at(&self, curve: Curve, time_s: f64) -> Option<f64> {
        let (_, value) = self.map.get(&curve)?.at(time_s)?;
        value.is_finite().then_some(f64::from(value))
    }

    /// Newest value of a curve.
    pub fn newest(&self, curve: Curve) -> Option<f64> {
        let (_, value) = self.map.get(&curve)?.last()?;
        value.is_finite().then_some(f64::from(value))
    }

    /// A place in the plane at or before `time_s`, east and north, m: of the estimate ([`Curve::Plane`]), or the true one.
    pub fn place_at(&self, of: fn(Horizontal) -> Curve, time_s: f64) -> Option<[f64; 2]> {
        let axis = |axis| self.value_at(of(axis), time_s);
        Some([axis(Horizontal::East)?, axis(Horizontal::North)?])
    }

    /// First and last time of all curves.
    pub fn time_span_s(&self) -> Option<Range<f64>> {
        self.map.values().filter_map(Series::time_span_s).fold(None, |span: Option<Range<f64>>, (first, last)| {
            Some(match span {
                None => first..last,
                Some(s) => s.start.min(first)..s.end.max(last),
            })
        })
    }

    /// One controller tick.
    pub fn push_control(&mut self, control: &v1::Control) {
        if let Some(altitude) = control.setpoint.as_ref().and_then(|s| s.altitude_m) {
            self.push(Curve::SetpointAltitude, control.time_us, altitude);
        }
        if let Some(s) = &control.setpoint {
            for (axis, angle) in Axis::ALL.into_iter().zip([s.roll_rad, s.pitch_rad, s.yaw_rad]) {
                if let Some(angle) = angle {
                    self.push(Curve::SetpointAttitude(axis), control.time_us, angle * DEGREES);
                }
            }
        }
        for (i, applied) in control.motor_applied.iter().enumerate().take(8) {
            self.push(Curve::Motor(i as u8), control.time_us, *applied);
        }
        if let Some(autopilot) = &control.autopilot {
            self.push_autopilot(control.time_us, autopilot);
        }
    }

    fn push_autopilot(&mut self, time_us: u64, autopilot: &v1::AutopilotControl) {
        let demand = |rates: &Option<v1::Vector3>, thrust| {
            let rates = rates.as_ref().map_or([None; 3], |r| [r.x, r.y, r.z].map(Some));
            let [roll, pitch, yaw] = rates;
            Demand::ALL.into_iter().zip([roll, pitch, yaw, thrust])
        };
        let asked = demand(&autopilot.rates_asked_flu_radps, autopilot.thrust_asked);
        let aimed_at = demand(&autopilot.rates_target_flu_radps, autopilot.thrust_target);
        let asked = asked.map(|(of, value)| (Curve::Asked(of), value));
        for (curve, value) in asked.chain(aimed_at.map(|(of, value)| (Curve::AimedAt(of), value))) {
            if let Some(value) = value {
                self.push(curve, time_us, value);
            }
        }
    }

    /// One estimate of estimator `number`.
    pub fn push_estimate(&mut self, number: u16, estimate: &v1::Estimate) {
        let time = estimate.time_us;
        // What an estimator holds before its sensors have told it anything is no estimate: a gap.
        let known = if estimate.health() == v1::Health::Initialising { f64::NAN } else { 1.0 };
        if let Some(position) = &estimate.position_enu_m {
            self.push(Curve::Altitude(number), time, position.z * known);
        }
        if let Some(velocity) = &estimate.velocity_enu_mps {
            for way in Way::ALL.into_iter().filter(|way| *way == Way::Up || estimate.horizontal_known) {
                self.push(Curve::Velocity(number, way), time, way.of(velocity) * known);
            }
        }
        if let Some(angles) = &estimate.roll_pitch_yaw_rad {
            for (axis, value) in Axis::ALL.into_iter().zip([angles.x, angles.y, angles.z]) {
                self.push(Curve::Attitude(number, axis), time, value * DEGREES * known);
            }
        }
        self.push_sigma(number, estimate, known);
        if estimate.in_loop
            && let Some(position) = estimate.position_enu_m.as_ref().filter(|_| estimate.horizontal_known)
        {
            self.push(Curve::Plane(Horizontal::East), time, position.x * known);
            self.push(Curve::Plane(Horizontal::North), time, position.y * known);
        }
    }

    /// How sure estimator `number` is of itself; zero says nothing, and one that never says has no curve.
    fn push_sigma(&mut self, number: u16, estimate: &v1::Estimate, known: f64) {
        let altitude = estimate.position_sigma_m.iter().map(|sigma| (Curve::AltitudeSigma(number), sigma.z));
        let attitude = estimate.attitude_sigma_rad.iter().flat_map(|sigma| {
            let axes = Axis::ALL.into_iter().zip([sigma.x, sigma.y, sigma.z]);
            axes.map(|(axis, value)| (Curve::AttitudeSigma(number, axis), value))
        });
        for (curve, sigma) in altitude.chain(attitude) {
            if sigma > 0.0 {
                self.push(curve, estimate.time_us, sigma * known);
            } else if self.map.contains_key(&curve) {
                self.push(curve, estimate.time_us, f64::NAN);
            }
        }
    }

    /// Truth.
    pub fn push_truth(&mut self, truth: &v1::Truth) {
        if let Some(position) = &truth.position_enu_m {
            self.push(Curve::TruthAltitude, truth.time_us, position.z);
            self.push(Curve::TruthPlane(Horizontal::East), truth.time_us, position.x);
            self.push(Curve::TruthPlane(Horizontal::North), truth.time_us, position.y);
        }
        if let Some(velocity) = &truth.velocity_enu_mps {
            Way::ALL.into_iter().for_each(|way| self.push(Curve::TruthVelocity(way), truth.time_us, way.of(velocity)));
        }
        if let Some(angles) = &truth.roll_pitch_yaw_rad {
            for (axis, value) in Axis::ALL.into_iter().zip([angles.x, angles.y, angles.z]) {
                self.push(Curve::TruthAttitude(axis), truth.time_us, value * DEGREES);
            }
        }
    }

    /// The velocities along one direction, with the number of each estimator.
    pub fn velocities(&self, along: Way) -> impl Iterator<Item = (Curve, u16)> + '_ {
        let all = self.names_between(Curve::Velocity(0, Way::Up), Curve::Velocity(u16::MAX, Way::North));
        all.filter_map(move |curve| match curve {
            Curve::Velocity(n, way) if way == along => Some((curve, n)),
            _ => None,
        })
    }

    /// The recording estimated again by estimator `number`, instead of what it said before.
    pub fn set_again(&mut self, number: u16, again: &Recomputed) {
        self.remove_again(number);
        let angles = [&again.roll_rad, &again.pitch_rad, &again.yaw_rad];
        for (k, time_s) in again.time_s.iter().enumerate() {
            let time_us = (time_s * 1e6).max(0.0) as u64;
            let at = |column: &[Option<f32>]| column.get(k).copied().flatten().map_or(f64::NAN, f64::from);
            self.push(Curve::AgainAltitude(number), time_us, at(&again.altitude_m));
            for (axis, column) in Axis::ALL.into_iter().zip(angles) {
                self.push(Curve::AgainAttitude(number, axis), time_us, at(column) * DEGREES);
            }
        }
    }

    /// The errors of altitude that the ground found.
    pub fn set_errors(&mut self, found: &Figures) {
        for of in &found.estimators {
            let Samples { time_s, value, .. } = &of.altitude_error_mm;
            let step_s = time_s.last().map_or(0.0, |last_s| last_s / OVERVIEW_COLUMNS as f64);
            let times = time_s.iter().map(|time_s| found.start_s + time_s);
            self.set(Curve::AltitudeError(of.estimator), times.zip(value.iter().copied()), 2.5 * step_s);
        }
    }

    /// Takes that away.
    pub fn remove_again(&mut self, number: u16) {
        self.map.remove(&Curve::AgainAltitude(number));
        for axis in Axis::ALL {
            self.map.remove(&Curve::AgainAttitude(number, axis));
        }
    }

    /// The residuals of estimator `number` in one tick.
    pub fn push_residuals(&mut self, number: u16, message: &v1::Residuals) {
        let mut worst: BTreeMap<(i32, u32), f64> = BTreeMap::new();
        for residual in &message.residuals {
            let key = (number, residual.sensor, residual.instance, residual.channel);
            let factor = super::names::channel_unit(residual.channel()).1;
            self.push(Curve::Innovation(key), message.time_us, residual.innovation * factor);
            self.push(Curve::Gate(key), message.time_us, residual.gate * factor);
            let ratio = worst.entry((residual.sensor, residual.instance)).or_insert(0.0);
            *ratio = ratio.max(residual.ratio);
        }
        for ((sensor, instance), ratio) in worst {
            self.push(Curve::Worst(number, sensor, instance), message.time_us, ratio);
        }
    }

    /// The secure estimator's account of its sensors.
    pub fn push_secure(&mut self, status: &v1::SecureStatus) {
        for s in &status.sensors {
            let ratio = if s.present { suspicion(s) } else { f64::NAN };
            self.push(Curve::Suspicion(s.sensor, s.instance), status.time_us, ratio);
        }
    }

    /// `bound_m` about the altitude that estimator `number` has.
    pub fn push_reach(&mut self, number: u16, time_us: u64, bound_m: f64) {
        if let Some(altitude_m) = self.value_at(Curve::Altitude(number), time_us as f64 * 1e-6) {
            self.push(Curve::Reach(false), time_us, altitude_m - bound_m);
            self.push(Curve::Reach(true), time_us, altitude_m + bound_m);
        }
    }

    /// The status of the agent.
    pub fn push_status(&mut self, status: &v1::Status) {
        self.push(Curve::TickMedian, status.time_us, status.tick_time_p50_us);
        self.push(Curve::TickP99, status.time_us, status.tick_time_p99_us);
        self.push(Curve::TickJitter, status.time_us, status.tick_jitter_p99_us);
    }
}

/// The larger of a sensor's two statistics over its limit. Flagged is always above 1: hysteresis keeps a sensor
/// out while its statistics are already small. Not flagged never is: one window above its limit flags nothing.
pub fn suspicion(sensor: &v1::SecureSensor) -> f64 {
    const ABOVE: f64 = 1.01;
    let ratio = sensor.window_ratio.max(sensor.drift_ratio);
    if sensor.flagged { ratio.max(ABOVE) } else { ratio.min(1.0) }
}

/// Samples, drawn with a gap where neighbours are further apart than [`GAP_S`], whatever the curve they come on allows.
fn with_gaps(samples: Vec<(f64, f32)>) -> impl Iterator<Item = (f64, f32)> {
    let mut last_s = f64::INFINITY;
    samples.into_iter().flat_map(move |(time_s, value)| {
        let gap = (time_s - last_s > GAP_S).then_some((last_s, f32::NAN));
        last_s = time_s;
        gap.into_iter().chain([(time_s, value)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimator_that_knows_nothing_yet_draws_nothing() {
        let mut curves = Curves::default();
        let position = v1::Vector3 { z: 0.5, ..Default::default() };
        for (time_us, health) in [(1_000_000, v1::Health::Initialising), (2_000_000, v1::Health::Healthy)] {
            let mut estimate = v1::Estimate { time_us, position_enu_m: Some(position), ..Default::default() };
            estimate.set_health(health);
            curves.push_estimate(7, &estimate);
        }
        assert_eq!(curves.value_at(Curve::Altitude(7), 1.5), None);
        assert_eq!((curves.newest(Curve::Altitude(7)), curves.newest(Curve::Altitude(8))), (Some(0.5), None));
        assert_eq!(curves.value_at(Curve::Altitude(7), 2.0), Some(0.5));
    }

    #[test]
    fn what_the_longest_window_shows_is_kept_and_little_more() {
        let window_s = crate::deck::WINDOWS_S.into_iter().fold(0.0, f64::max);
        let key = (1, 1, 1, 1);
        // As often as the ground sends them to a page.
        for (curve, rate_hz) in [
            (Curve::Altitude(1), 40),
            (Curve::Height(1), 100),
            (Curve::Signal(1), 200),
            (Curve::Innovation(key), 8),
            (Curve::Worst(1, 1, 1), 8),
        ] {
            let mut curves = Curves::default();
            (0..2000 * rate_hz).for_each(|i| curves.push(curve, i * 1_000_000 / rate_hz, 0.5));
            let span = curves.time_span_s().unwrap();
            let kept_s = span.end - span.start;
            assert!(kept_s >= window_s && kept_s < 2.0 * window_s, "{curve:?}: {kept_s} s");
        }
    }

    #[test]
    fn each_estimator_that_has_a_covariance_has_a_band_and_no_other() {
        let mut curves = Curves::default();
        let sigma = |z| Some(v1::Vector3 { x: 0.01, y: 0.02, z });
        let mut push = |number, time_us, in_loop, altitude, attitude| {
            let estimate = v1::Estimate {
                time_us,
                in_loop,
                position_sigma_m: altitude,
                attitude_sigma_rad: attitude,
                health: v1::Health::Healthy.into(),
                ..Default::default()
            };
            curves.push_estimate(number, &estimate);
        };
        push(1, 1_000_000, true, sigma(0.05), sigma(0.03));
        push(4, 1_000_000, false, sigma(0.07), None);
        push(2, 1_000_000, false, sigma(0.0), None);
        push(4, 2_000_000, false, sigma(0.0), None);
        let at = |curve, time_s| curves.value_at(curve, time_s).map(|sigma| (sigma * 1e3).round());
        assert_eq!(at(Curve::AltitudeSigma(1), 1.5), Some(50.0));
        assert_eq!(at(Curve::AttitudeSigma(1, Axis::Pitch), 1.5), Some(20.0));
        assert_eq!((at(Curve::AltitudeSigma(4), 1.5), at(Curve::AltitudeSigma(4), 2.0)), (Some(70.0), None));
        assert!(curves.get(Curve::AttitudeSigma(4, Axis::Roll)).is_none());
        assert!(curves.get(Curve::AltitudeSigma(2)).is_none(), "it says nothing of itself");
    }

    #[test]
    fn angles_become_degrees_and_the_worst_channel_is_kept_per_instance() {
        let mut curves = Curves::default();
        let angles = v1::Vector3 { x: std::f64::consts::PI, y: 0.0, z: 0.0 };
        curves.push_estimate(
            1,
            &v1::Estimate { time_us: 1_000_000, roll_pitch_yaw_rad: Some(angles), ..Default::default() },
        );
        assert_eq!(curves.value_at(Curve::Attitude(1, Axis::Roll), 1.0), Some(180.0));
        assert_eq!(curves.value_at(Curve::Attitude(1, Axis::Roll), 0.9), None);
        let again = Recomputed { time_s: vec![2.0, 2.04], altitude_m: vec![None, Some(1.5)], ..Recomputed::default() };
        curves.set_again(4, &again);
        assert_eq!((curves.value_at(Curve::AgainAltitude(4), 2.0), curves.len(Curve::AgainAltitude(4))), (None, 2));
        assert_eq!(curves.value_at(Curve::AgainAltitude(4), 2.1), Some(1.5));
        curves.remove_again(4);
        assert!(curves.get(Curve::AgainAltitude(4)).is_none());
        let residual = |channel, ratio| v1::Residual { sensor: 1, instance: 3, channel, ratio, ..Default::default() };
        curves.push_residuals(
            1,
            &v1::Residuals { time_us: 5, estimator: 1, residuals: vec![residual(4, 0.5), residual(5, 0.75)] },
        );
        assert_eq!(curves.value_at(Curve::Worst(1, 1, 3), 1.0), Some(0.75));
        let flagged = v1::SecureSensor {
            sensor: 2,
            instance: 1,
            present: true,
            flagged: true,
            window_ratio: 0.2,
            ..Default::default()
        };
        let spike = v1::SecureSensor { instance: 2, flagged: false, drift_ratio: 1.7, ..flagged };
        let gone = v1::SecureSensor { instance: 3, present: false, ..flagged };
        curves.push_secure(&v1::SecureStatus { time_us: 5, sensors: vec![flagged, spike, gone], ..Default::default() });
        let at = |instance| curves.value_at(Curve::Suspicion(2, instance), 1.0);
        assert!(at(1).is_some_and(|r| r > 1.0) && at(2) == Some(1.0) && at(3).is_none());
        let span = curves.time_span_s().unwrap();
        assert!((span.start - 5e-6).abs() < 1e-9 && span.end == 1.0);
    }
}
