//! What a curve does between two times: where it stands at both, how far it went, mean, RMS and slope.
//!
//! Every sample weighs as much time as it stands for, so that stretches that were thinned count like all others.

use super::series::Series;

/// A stretch of a curve, in the curve's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// Value at the first time; NaN before the first sample.
    pub from: f64,
    /// Value at the second.
    pub to: f64,
    /// Mean over time.
    pub mean: f64,
    /// Root of the mean square over time.
    pub rms: f64,
    /// Slope of the straight line of least squares, 1/s; NaN of a single sample.
    pub slope_per_s: f64,
}

impl Measure {
    /// From the first time to the second.
    pub fn change(&self) -> f64 {
        self.to - self.from
    }
}

/// The curve between two times, in any order; `None` where it has no finite sample.
pub fn measure(series: &Series, one_s: f64, other_s: f64) -> Option<Measure> {
    let (start_s, end_s) = (one_s.min(other_s), one_s.max(other_s));
    let mut sums = Sums::default();
    let mut before: Option<(f64, f64)> = None;
    for (time_s, value) in series.samples(series.lower_bound(start_s)..series.upper_bound(end_s)) {
        if !value.is_finite() {
            before = None;
            continue;
        }
        let (t, v) = (time_s - start_s, f64::from(value));
        match before {
            Some((t0, v0)) if t - t0 <= series.max_gap_s() => {
                let half = 0.5 * (t - t0);
                sums.add(t0, v0, half);
                sums.add(t, v, half);
            }
            // A sample with no neighbour still counts, next to nothing.
            _ => sums.add(t, v, 1e-9),
        }
        before = Some((t, v));
    }
    let at = |time_s: f64| series.at(time_s).map_or(f64::NAN, |(_, v)| f64::from(v));
    sums.done(at(one_s), at(other_s))
}

/// The root of the mean square of a curve between two times.
pub fn rms(series: &Series, start_s: f64, end_s: f64) -> Option<f64> {
    measure(series, start_s, end_s).map(|m| m.rms)
}

/// Weighted sums of 1, t, v, t², tv, v².
#[derive(Debug, Default)]
struct Sums {
    w: f64,
    t: f64,
    v: f64,
    tt: f64,
    tv: f64,
    vv: f64,
}

impl Sums {
    fn add(&mut self, t: f64, v: f64, weight: f64) {
        self.w += weight;
        self.t += weight * t;
        self.v += weight * v;
        self.tt += weight * t * t;
        self.tv += weight * t * v;
        self.vv += weight * v * v;
    }

    fn done(&self, from: f64, to: f64) -> Option<Measure> {
        if self.w <= 0.0 {
            return None;
        }
        let (t, mean) = (self.t / self.w, self.v / self.w);
        let spread = self.tt / self.w - t * t;
        let slope_per_s = if spread > 1e-12 { (self.tv / self.w - t * mean) / spread } else { f64::NAN };
        Some(Measure { from, to, mean, rms: (self.vv / self.w).sqrt(), slope_per_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_has_its_slope_and_thinning_changes_nothing() {
        let ramp = |t: f64| (t, (2.0 + 0.5 * t) as f32);
        let dense = Series::from_samples((0..=1000).map(|i| ramp(100.0 + f64::from(i) * 0.01)));
        // The second half has a tenth of the samples.
        let thinned = (0..500).map(|i| f64::from(i) * 0.01).chain((0..=50).map(|i| 5.0 + f64::from(i) * 0.1));
        let thinned = Series::from_samples(thinned.map(|t| ramp(100.0 + t)));
        for series in [&dense, &thinned] {
            let m = measure(series, 100.0, 110.0).unwrap();
            assert!((m.slope_per_s - 0.5).abs() < 1e-4, "{m:?}");
            assert!((m.mean - (2.0 + 0.5 * 105.0)).abs() < 1e-3 && (m.change() - 5.0).abs() < 1e-3, "{m:?}");
        }
        let back = measure(&dense, 110.0, 100.0).unwrap();
        assert!((back.change() + 5.0).abs() < 1e-3, "from the first cursor to the second");
    }

    #[test]
    fn rms_of_a_sine_gaps_and_nothing() {
        let sine = Series::from_samples(
            (0..=1000)
                .map(|i| (f64::from(i) * 0.001, (f64::from(i) * 0.001 * 20.0 * std::f64::consts::PI).sin() as f32)),
        );
        assert!((rms(&sine, 0.0, 1.0).unwrap() - 0.5_f64.sqrt()).abs() < 1e-3);
        let broken = Series::from_samples([(0.0, 1.0), (0.5, f32::NAN), (1.0, 3.0)]);
        let m = measure(&broken, 0.0, 1.0).unwrap();
        assert!((m.mean - 2.0).abs() < 1e-6, "{m:?}");
        assert_eq!(measure(&broken, 0.2, 0.8), None);
        assert!(measure(&broken, 0.9, 1.1).unwrap().slope_per_s.is_nan());
    }
}
