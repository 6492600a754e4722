//! The altitude of a flight at a glance: least and greatest of equal stretches of time, few enough for a list of flights.

use std::collections::BTreeMap;

use plumbline_rest::flight;

/// Most stretches: two pixels each of a picture in a list.
const STRETCHES: usize = 64;
/// Width of a stretch at first, µs.
const FIRST_US: u64 = 100_000;

/// Stretches of an equal width that doubles as the flight grows, from samples in any order.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    width_us: u64,
    /// Least and greatest, m, by the number of the stretch, counted from the agent's boot.
    stretches: BTreeMap<u64, [f64; 2]>,
}

impl Default for Outline {
    fn default() -> Self {
        Self { width_us: FIRST_US, stretches: BTreeMap::new() }
    }
}

impl Outline {
    /// Takes one sample, m.
    pub(super) fn take(&mut self, time_us: u64, altitude_m: f64) {
        if altitude_m.is_finite() {
            self.widen(time_us / self.width_us, [altitude_m; 2]);
            self.fit();
        }
    }

    /// Takes in another one of the same flight.
    pub(super) fn absorb(&mut self, other: &Self) {
        while self.width_us < other.width_us {
            self.double();
        }
        for (number, range) in &other.stretches {
            self.widen(number * other.width_us / self.width_us, *range);
        }
        self.fit();
    }

    /// For the list; times count from `start_us`. `None` where nothing is known.
    pub(super) fn describe(&self, start_us: u64) -> Option<flight::Outline> {
        let (first, last) = (*self.stretches.keys().next()?, *self.stretches.keys().next_back()?);
        let cm = |m: f64| (100.0 * m).round() as i32;
        let stretch = |number| self.stretches.get(&number).map(|range: &[f64; 2]| range.map(cm));
        Some(flight::Outline {
            from_s: ((first * self.width_us) as f64 - start_us as f64) / 1e6,
            step_s: self.width_us as f64 / 1e6,
            altitude_cm: (first..=last).map(stretch).collect(),
        })
    }

    fn widen(&mut self, number: u64, [least, greatest]: [f64; 2]) {
        let range = self.stretches.entry(number).or_insert([least, greatest]);
        *range = [range[0].min(least), range[1].max(greatest)];
    }

    /// Coarser until they are few enough, those between the first and the last that hold nothing included.
    fn fit(&mut self) {
        let span = |all: &BTreeMap<u64, [f64; 2]>| match (all.keys().next(), all.keys().next_back()) {
            (Some(first), Some(last)) => last - first,
            _ => 0,
        };
        while span(&self.stretches) >= STRETCHES as u64 {
            self.double();
        }
    }

    fn double(&mut self) {
        self.width_us *= 2;
        for (number, range) in std::mem::take(&mut self.stretches) {
            self.widen(number / 2, range);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A climb to 10 m in 100 s, 100 times a second.
    fn climb(steps: impl Iterator<Item = u64>) -> Outline {
        let mut outline = Outline::default();
        steps.for_each(|k| outline.take(7_000_000 + k * 10_000, k as f64 * 1e-3));
        outline
    }

    #[test]
    fn every_peak_is_kept_in_few_stretches_whatever_the_order() {
        let whole = climb(0..10_000).describe(7_000_000).unwrap();
        assert!(whole.altitude_cm.len() <= STRETCHES && whole.altitude_cm.len() > STRETCHES / 2);
        assert!(
            whole.step_s * whole.altitude_cm.len() as f64 >= 100.0 && (-whole.step_s..=0.0).contains(&whole.from_s)
        );
        let known: Vec<_> = whole.altitude_cm.iter().flatten().collect();
        assert_eq!((known[0][0], known[known.len() - 1][1]), (0, 1000));
        assert!(known.windows(2).all(|pair| pair[1][0] >= pair[0][1]), "it climbs");
        assert_eq!(climb((0..10_000).rev()).describe(7_000_000), Some(whole.clone()));
        let (mut early, late) = (climb(0..100), climb(100..10_000));
        early.absorb(&late);
        assert_eq!(early.describe(7_000_000), Some(whole.clone()));
        let mut late = late;
        late.absorb(&climb(0..100));
        assert_eq!(late.describe(7_000_000), Some(whole));
    }

    #[test]
    fn a_pause_is_a_pause_and_a_stray_time_costs_no_memory() {
        let mut outline = climb((0..100).chain(900..1000));
        assert!(outline.describe(7_000_000).unwrap().altitude_cm.contains(&None));
        outline.take(u64::MAX, 1.0);
        outline.take(0, f64::NAN);
        assert!(outline.describe(7_000_000).unwrap().altitude_cm.len() <= STRETCHES);
        assert_eq!(Outline::default().describe(0), None);
    }
}
