//! The floor where the vehicle stood last: GNSS altitude counts from there, and over it the rotors' wash is on the barometer.

/// Part of what a fix says anew of the floor that is taken.
const GAIN: f64 = 0.2;
/// One-sigma of what the wash adds to a barometer right above the floor, m …
const WASH_SIGMA_M: f64 = 1.5;
/// … less by e every so high, m: two rotor radii.
const WASH_DECAY_M: f64 = 0.25;

/// Altitudes of the floor, each by its own measure.
#[derive(Debug, Clone, Copy, Default)]
pub struct Floor {
    gnss_m: Option<f64>,
    stood_m: Option<f64>,
}

impl Floor {
    /// What a fix at `gnss_m`, off by metres and by the same for a minute, says of the height over the floor, m, where
    /// `altitude_m` is estimated; nothing while the vehicle is `resting`, where it says where the floor is.
    pub fn height_m(&mut self, gnss_m: f64, altitude_m: f64, resting: bool) -> Option<f64> {
        let floor_m = gnss_m - altitude_m;
        let known_m = self.gnss_m.get_or_insert(floor_m);
        if resting {
            *known_m += GAIN * (floor_m - *known_m);
            return None;
        }
        Some(gnss_m - *known_m)
    }

    /// One-sigma of what the wash may add to a barometer at the estimated `altitude_m`, m; none while it is `resting`, nor
    /// where nobody knows the floor.
    pub fn wash_sigma_m(&mut self, altitude_m: f64, resting: bool) -> f64 {
        if resting {
            self.stood_m = Some(altitude_m);
            return 0.0;
        }
        self.stood_m.map_or(0.0, |stood_m| WASH_SIGMA_M * (-(altitude_m - stood_m).max(0.0) / WASH_DECAY_M).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_count_from_where_it_stood_last() {
        let mut floor = Floor::default();
        let near = |height_m: Option<f64>, m: f64| height_m.is_some_and(|height_m| (height_m - m).abs() < 1e-3);
        assert!(near(floor.height_m(7.0, 0.1, false), 0.1), "where it began");
        for _ in 0..50 {
            assert_eq!(floor.height_m(8.0, 0.0, true), None);
        }
        assert!(near(floor.height_m(9.5, 1.0, false), 1.5));
    }

    #[test]
    fn over_the_floor_it_stood_on_a_barometer_is_worth_little() {
        let mut floor = Floor::default();
        assert_eq!(floor.wash_sigma_m(3.0, false), 0.0, "it never stood");
        assert_eq!(floor.wash_sigma_m(3.0, true), 0.0, "its motors stand");
        assert!(floor.wash_sigma_m(3.0, false) > 1.0 && floor.wash_sigma_m(4.0, false) < 0.05);
    }
}
