//! Is a filter as uncertain as it says? Running means of NEES and NIS.
//!
//! | symbol | meaning |
//! |---|---|
//! | NEES = x̃ᵀP⁻¹x̃ | error squared over its covariance; its mean is the number of states when P is right |
//! | NIS = ν²/s | innovation squared over its variance, per scalar; its mean is 1 |
//!
//! Above: overconfident; below: too modest. Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with
//! Applications to Tracking and Navigation", 5.4.

use arrayvec::ArrayVec;
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;

use crate::estimate::{Channel, MAX_RESIDUALS, Residual};
use crate::sensor::measure::Kinematics;

/// A running mean.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    /// Takes one value; what is not finite is skipped.
    pub fn push(&mut self, value: f64) {
        if value.is_finite() {
            self.sum += value;
            self.count += 1;
        }
    }

    /// The mean; `None` before the first value.
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// How many values.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// NEES of one instant, and over how many states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nees {
    /// x̃ᵀP⁻¹x̃.
    pub value: f64,
    /// States in x̃: 9 with position, velocity and attitude; fewer where the truth does not know all.
    pub states: usize,
}

/// Difference of two states: position, velocity, rotation vector about the world axes from `estimate` to `truth`.
/// Not finite where the truth does not know.
pub fn error(truth: &Kinematics, estimate: &Kinematics) -> SVector<f64, 9> {
    let turned: UnitQuaternion<f64> = truth.world_from_body * estimate.world_from_body.inverse();
    let parts: [Vector3<f64>; 3] = [
        truth.position_enu_m - estimate.position_enu_m,
        truth.velocity_enu_mps - estimate.velocity_enu_mps,
        turned.scaled_axis(),
    ];
    SVector::from_fn(|i, _| parts[i / 3][i % 3])
}

/// NEES of `error` under `covariance`, both of position, velocity, attitude; blocks whose error is not finite are
/// skipped. `None` when nothing is left or the covariance has no inverse.
pub fn nees(error: &SVector<f64, 9>, covariance: &SMatrix<f64, 9, 9>) -> Option<Nees> {
    let (mut x, mut p) = (*error, *covariance);
    let mut states = 9;
    for block in 0..3 {
        let known = (0..3).all(|i| error[3 * block + i].is_finite());
        if !known {
            states -= 3;
            for i in 3 * block..3 * block + 3 {
                // A state of its own without error: it adds nothing.
                x[i] = 0.0;
                p.row_mut(i).fill(0.0);
                p.column_mut(i).fill(0.0);
                p[(i, i)] = 1.0;
            }
        }
    }
    let value = x.dot(&p.cholesky()?.solve(&x));
    (states > 0 && value.is_finite()).then_some(Nees { value, states })
}

/// Means over a run. Allocates nothing.
#[derive(Debug, Clone, Default)]
pub struct Consistency {
    nees: Mean,
    states: usize,
    nis: ArrayVec<(SensorId, Channel, Mean), MAX_RESIDUALS>,
}

impl Consistency {
    /// Takes the residuals of one step; those that were refused are no part of the filter's own statistics.
    pub fn push(&mut self, residuals: &[Residual]) {
        for r in residuals.iter().filter(|r| r.accepted && r.sigma > 0.0) {
            let nis = (r.innovation / r.sigma).powi(2);
            match self.nis.iter_mut().find(|(sensor, channel, _)| (*sensor, *channel) == (r.sensor, r.channel)) {
                Some((.., mean)) => mean.push(nis),
                None => {
                    let mut mean = Mean::default();
                    mean.push(nis);
                    let _ = self.nis.try_push((r.sensor, r.channel, mean));
                }
            }
        }
    }

    /// Takes the NEES of one instant; instants with fewer states than the fullest so far are skipped.
    pub fn push_nees(&mut self, nees: Nees) {
        if nees.states > self.states {
            (self.states, self.nees) = (nees.states, Mean::default());
        }
        if nees.states == self.states {
            self.nees.push(nees.value);
        }
    }

    /// Mean NEES and its expectation, the number of states.
    pub fn nees(&self) -> Option<(f64, usize)> {
        Some((self.nees.value()?, self.states))
    }

    /// Mean NIS of every scalar, expectation 1.
    pub fn nis(&self) -> impl Iterator<Item = (SensorId, Channel, Mean)> + '_ {
        self.nis.iter().copied()
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::v1::SensorKind;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn a_right_covariance_has_a_nees_of_its_size_and_a_nis_of_one() {
        // 4000 draws of 9 degrees of freedom: the mean's own sigma is √(2·9/4000) = 0.07; of 1: 0.022.
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(3);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let a = SMatrix::<f64, 9, 9>::from_fn(|i, j| ((i * 5 + 3 * j) as f64).sin() + f64::from(u8::from(i == j)));
        let p = a * a.transpose();
        let mut consistency = Consistency::default();
        for k in 0..4000 {
            let mut x = a * SVector::<f64, 9>::from_fn(|_, _| draw());
            if k % 10 == 0 {
                x[4] = f64::NAN;
            }
            consistency.push_nees(nees(&x, &p).unwrap());
            let residual = Residual {
                sensor: SensorId::new(SensorKind::Height, 1),
                channel: Channel::Height,
                innovation: 0.3 * draw(),
                sigma: 0.3,
                gate: 1.5,
                accepted: k % 7 != 0,
            };
            consistency.push(&[residual]);
        }
        let (mean, states) = consistency.nees().unwrap();
        assert!(states == 9 && (mean - 9.0).abs() < 0.3, "{mean}");
        let (_, _, nis) = consistency.nis().next().unwrap();
        assert!((nis.value().unwrap() - 1.0).abs() < 0.1 && nis.count() == 3428);
    }

    #[test]
    fn unknown_blocks_are_left_out() {
        let mut x = SVector::<f64, 9>::repeat(1.0);
        x[7] = f64::NAN;
        let found = nees(&x, &SMatrix::identity()).unwrap();
        assert_eq!((found.value, found.states), (6.0, 6));
        assert!(nees(&SVector::repeat(f64::NAN), &SMatrix::identity()).is_none());
    }
}
