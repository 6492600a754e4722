//! What each estimator is off by: its altitude and attitude minus truth, or minus the setpoint where no truth is known.
//!
//! Truth is taken at the time of the estimate, straight between its samples; a setpoint holds until the next one. The
//! errors are followed from sample to sample while somebody looks at them, and forgotten after: [`Curves::follow_errors`].

use std::collections::BTreeMap;

use super::{Axis, Curve, Curves, GAP_S};
use crate::model::series::Series;

/// mm of a metre.
const MM: f64 = 1e3;
/// mrad of a degree.
const MRAD: f64 = 1e3 * std::f64::consts::PI / 180.0;

/// How far the errors are known.
#[derive(Debug, Default)]
pub(super) struct Followed {
    /// Number of the first sample of a curve that has no error yet.
    next: BTreeMap<Curve, u64>,
    /// Against truth?
    truth: bool,
}

/// The error of a curve: its name, and what it is measured against (truth, setpoint).
fn error_of(curve: Curve) -> Option<(Curve, [Curve; 2])> {
    match curve {
        Curve::Altitude(n) => Some((Curve::AltitudeError(n), [Curve::TruthAltitude, Curve::SetpointAltitude])),
        Curve::Attitude(n, axis) => {
            Some((Curve::AttitudeError(n, axis), [Curve::TruthAttitude(axis), Curve::SetpointAttitude(axis)]))
        }
        _ => None,
    }
}

/// An angle within ±180°.
fn wrapped(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

/// What the reference was at times that only grow.
struct Reference<'a> {
    series: &'a Series,
    /// First sample after the time asked for last.
    after: u64,
    /// Between its samples; else it holds.
    straight: bool,
    angle: bool,
}

impl Reference<'_> {
    /// At a time; `None` when the reference has not come so far yet.
    fn at(&mut self, time_s: f64) -> Option<f64> {
        while self.series.get(self.after).is_some_and(|(t, _)| t <= time_s) {
            self.after += 1;
        }
        let Some((t0, v0)) = self.after.checked_sub(1).and_then(|i| self.series.get(i)) else { return Some(f64::NAN) };
        if !self.straight {
            return Some(f64::from(v0));
        }
        if t0 == time_s {
            return Some(f64::from(v0));
        }
        let (t1, v1) = self.series.get(self.after)?;
        if t1 - t0 > GAP_S {
            return Some(f64::NAN);
        }
        let way = f64::from(v1) - f64::from(v0);
        let way = if self.angle { wrapped(way) } else { way };
        Some(f64::from(v0) + way * (time_s - t0) / (t1 - t0))
    }
}

impl Curves {
    /// Are errors measured against truth? Else against the setpoint.
    pub fn has_truth(&self) -> bool {
        self.map.contains_key(&Curve::TruthAltitude)
    }

    /// Brings the errors of all estimators up to date: [`Curve::AltitudeError`], [`Curve::AttitudeError`].
    pub fn follow_errors(&mut self) {
        if self.followed.truth != self.has_truth() {
            self.forget_errors();
            self.followed.truth = self.has_truth();
        }
        let sources: Vec<Curve> = self.names().filter(|c| error_of(*c).is_some()).collect();
        for source in sources {
            self.follow(source);
        }
    }

    /// Lets the errors go: they are many, and seldom looked at.
    pub fn forget_errors(&mut self) {
        self.followed = Followed::default();
        self.map.retain(|curve, _| !matches!(curve, Curve::AltitudeError(_) | Curve::AttitudeError(..)));
    }

    fn follow(&mut self, source: Curve) {
        let Some((error, [truth, setpoint])) = error_of(source) else { return };
        let straight = self.followed.truth;
        let (Some(series), Some(against)) = (self.get(source), self.get(if straight { truth } else { setpoint }))
        else {
            return;
        };
        // What thinning left of two curves cannot be compared.
        let [from_s, to_s] = self.whole.between_s;
        let (first, end) = (series.lower_bound(from_s), series.upper_bound(to_s));
        let begin = self.followed.next.get(&source).copied().unwrap_or(0).max(first);
        let begun_s = series.get(begin).map_or(0.0, |(time_s, _)| time_s);
        let angle = matches!(source, Curve::Attitude(..));
        let mut reference = Reference { series: against, after: against.upper_bound(begun_s), straight, angle };
        let mut found = Vec::new();
        for (time_s, value) in series.samples(begin..end.max(begin)) {
            let Some(reference) = reference.at(time_s) else { break };
            let off = f64::from(value) - reference;
            found.push((time_s, if angle { wrapped(off) * MRAD } else { off * MM }));
        }
        let empty = self.empty;
        let errors = self.map.entry(error).or_insert_with(|| empty(error).with_max_gap(GAP_S));
        for (time_s, off) in &found {
            errors.push(*time_s, *off as f32);
        }
        self.followed.next.insert(source, begin + found.len() as u64);
    }

    /// One curve minus another, straight between the samples of the other, where both are known.
    pub fn minus(&self, one: Curve, other: Curve) -> Vec<(f64, f64)> {
        let (Some(series), Some(against)) = (self.get(one), self.get(other)) else { return Vec::new() };
        let mut reference = Reference { series: against, after: against.first(), straight: true, angle: false };
        let known = series.samples(series.first()..series.end());
        let off = known.filter_map(|(time_s, value)| Some((time_s, f64::from(value) - reference.at(time_s)?)));
        off.filter(|(_, off)| off.is_finite()).collect()
    }

    /// The errors that are followed, of altitude, or of one axis of attitude.
    pub fn error_names(&self, axis: Option<Axis>) -> impl Iterator<Item = (Curve, u16)> + '_ {
        self.names().filter_map(move |curve| match (curve, axis) {
            (Curve::AltitudeError(n), None) => Some((curve, n)),
            (Curve::AttitudeError(n, a), Some(axis)) if a == axis => Some((curve, n)),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(curves: &Curves, curve: Curve, time_s: f64) -> f64 {
        curves.value_at(curve, time_s).unwrap_or(f64::NAN)
    }

    #[test]
    fn truth_is_taken_between_its_samples_and_awaited() {
        let mut curves = Curves::default();
        for i in 0..5_u64 {
            curves.push(Curve::Altitude(1), i * 10_000, 1.0);
        }
        curves.push(Curve::TruthAltitude, 0, 1.0);
        curves.push(Curve::TruthAltitude, 20_000, 1.2);
        curves.follow_errors();
        assert_eq!(curves.len(Curve::AltitudeError(1)), 3, "what truth has not reached yet has no error");
        assert!((at(&curves, Curve::AltitudeError(1), 0.010) + 100.0).abs() < 1e-3);
        assert!((at(&curves, Curve::AltitudeError(1), 0.020) + 200.0).abs() < 1e-3);
        curves.push(Curve::TruthAltitude, 40_000, 1.0);
        curves.follow_errors();
        assert_eq!(curves.len(Curve::AltitudeError(1)), 5);
        assert!((at(&curves, Curve::AltitudeError(1), 0.030) + 100.0).abs() < 1e-3);
        curves.forget_errors();
        assert!(curves.get(Curve::AltitudeError(1)).is_none());
        curves.follow_errors();
        assert_eq!(curves.len(Curve::AltitudeError(1)), 5, "they are found again from the begin");
    }

    #[test]
    fn without_truth_the_setpoint_holds_and_yaw_goes_round() {
        let mut curves = Curves::default();
        curves.push(Curve::SetpointAltitude, 0, 0.5);
        curves.push(Curve::SetpointAltitude, 30_000, 0.8);
        curves.push(Curve::Altitude(7), 20_000, 0.52);
        curves.push(Curve::Altitude(7), 30_000, 0.52);
        curves.push(Curve::SetpointAttitude(Axis::Yaw), 0, 179.0);
        curves.push(Curve::Attitude(7, Axis::Yaw), 20_000, -179.0);
        curves.follow_errors();
        assert!(!curves.has_truth());
        assert!((at(&curves, Curve::AltitudeError(7), 0.02) - 20.0).abs() < 1e-3);
        assert!((at(&curves, Curve::AltitudeError(7), 0.03) + 280.0).abs() < 1e-3);
        assert!((at(&curves, Curve::AttitudeError(7, Axis::Yaw), 0.02) - 34.907).abs() < 1e-2);
        assert_eq!(curves.error_names(None).count(), 1);
        assert_eq!(curves.error_names(Some(Axis::Roll)).count(), 0);
    }
}
