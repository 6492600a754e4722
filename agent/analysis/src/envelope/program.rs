//! The linear program of an envelope, and what makes its answer a bound.
//!
//! For any multipliers λ, whoever found them, and every attack that keeps the limits,
//! cᵀa = Σ λᵢ mᵢᵀa + (c − Σ λᵢ mᵢ)ᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ: this is the bound told, never the solver's objective.
//! The attack told is scaled until it keeps every limit: what it reaches is a bound from below.
//!
//! Solved by cutting planes: few statistics at first, then those that the solution breaks. A statistic left out has λᵢ = 0.

use std::collections::HashSet;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use plumbline_proto::ids::SensorId;

use super::{EnvelopeError, Signal};

/// One in so many statistics is there from the start.
const FIRST: usize = 8;
/// Rounds of cutting, and how far a statistic may be beyond its limit in the end.
const ROUNDS: usize = 12;
const BEYOND: f64 = 1e-3;
/// Statistics added in a round, the worst first.
const ADDED: usize = 120;
/// A coefficient below this part of its row's largest is not given to the solver. The certificate takes them all.
const SMALL: f64 = 1e-7;

/// One detector at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistic {
    /// Its name.
    pub detector: &'static str,
    /// Whose, where it is a sensor's.
    pub sensor: Option<SensorId>,
    /// When, s.
    pub time_s: f64,
    /// l > 0.
    pub limit: f64,
    /// m.
    pub row: Signal,
}

/// See the module of the envelope.
#[derive(Debug, Clone)]
pub struct Program {
    /// c.
    pub objective: Signal,
    /// m and l.
    pub statistics: Vec<Statistic>,
    /// u.
    pub most: Vec<f64>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// No silent attack goes further: proved by the multipliers.
    pub upper: f64,
    /// The attack below goes as far.
    pub reached: f64,
    /// Silent.
    pub attack: Signal,
    /// The detector that holds most of the bound; `None` where the most that may be added does.
    pub binding: Option<&'static str>,
    /// Rounds of cutting.
    pub rounds: usize,
}

/// Some statistics with a sign, and the multipliers found for them.
type Cut = (usize, f64);

impl Program {
    /// Solves it.
    ///
    /// # Errors
    /// [`EnvelopeError::Infeasible`] for a limit that nothing keeps, [`EnvelopeError::Solver`].
    pub fn solve(&self) -> Result<Bound, EnvelopeError> {
        for s in &self.statistics {
            if s.limit.is_nan() || s.limit <= 0.0 || !s.row.iter().all(|x| x.is_finite()) {
                return Err(EnvelopeError::Infeasible { detector: s.detector, limit: s.limit });
            }
        }
        let every = self.statistics.iter().enumerate().filter(|(i, s)| i % FIRST == 0 && s.row.amax() > 0.0);
        let mut cuts: Vec<Cut> = every.flat_map(|(i, _)| [(i, 1.0), (i, -1.0)]).collect();
        let mut there: HashSet<(usize, bool)> = cuts.iter().map(|(i, sign)| (*i, *sign > 0.0)).collect();
        let mut rounds = 0;
        loop {
            rounds += 1;
            let (attack, multipliers) = self.relaxed(&cuts)?;
            let mut broken: Vec<(usize, f64, f64)> = Vec::new();
            let mut worst: f64 = 1.0;
            for (i, s) in self.statistics.iter().enumerate() {
                let ratio = s.row.dot(&attack) / s.limit;
                worst = worst.max(ratio.abs());
                if ratio.abs() > 1.0 + 0.5 * BEYOND && !there.contains(&(i, ratio > 0.0)) {
                    broken.push((i, ratio.signum(), ratio.abs()));
                }
            }
            if worst < 1.0 + BEYOND || broken.is_empty() || rounds == ROUNDS {
                return Ok(self.certified(&attack, &cuts, &multipliers, rounds));
            }
            broken.sort_unstable_by(|a, b| b.2.total_cmp(&a.2));
            for (i, sign, _) in broken.into_iter().take(ADDED) {
                there.insert((i, sign > 0.0));
                cuts.push((i, sign));
            }
        }
    }

    /// With these statistics only: the attack, and a multiplier for each of them.
    fn relaxed(&self, cuts: &[Cut]) -> Result<(Signal, Vec<f64>), EnvelopeError> {
        let n = self.objective.len();
        let (mut i, mut j, mut v) = (Vec::new(), Vec::new(), Vec::new());
        let mut rhs = Vec::with_capacity(cuts.len() + 2 * n);
        for (row, (statistic, sign)) in cuts.iter().enumerate() {
            let Some(s) = self.statistics.get(*statistic) else { continue };
            let small = SMALL * s.row.amax();
            for (column, x) in s.row.iter().enumerate().filter(|(_, x)| x.abs() > small) {
                i.push(row);
                j.push(column);
                v.push(sign * x / s.limit);
            }
            rhs.push(1.0);
        }
        for (column, most) in self.most.iter().enumerate() {
            for sign in [1.0, -1.0] {
                i.push(rhs.len());
                j.push(column);
                v.push(sign);
                rhs.push(*most);
            }
        }
        let rows = rhs.len();
        let a = CscMatrix::new_from_triplets(rows, n, i, j, v);
        let q: Vec<f64> = self.objective.iter().map(|c| -c).collect();
        let settings = DefaultSettings { verbose: false, presolve_enable: false, ..DefaultSettings::default() };
        let failed = |status: String| EnvelopeError::Solver { status, columns: n, rows };
        let cones = [SupportedConeT::NonnegativeConeT(rows)];
        let mut solver = DefaultSolver::new(&CscMatrix::zeros((n, n)), &q, &a, &rhs, &cones, settings)
            .map_err(|error| failed(error.to_string()))?;
        solver.solve();
        let solution = &solver.solution;
        match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved | SolverStatus::InsufficientProgress => {
                let multipliers = solution.z.iter().take(cuts.len()).copied().collect();
                Ok((Signal::from_column_slice(&solution.x), multipliers))
            }
            other => Err(failed(format!("{other:?}"))),
        }
    }

    /// What attack and multipliers prove. Neither is taken on trust.
    fn certified(&self, attack: &Signal, cuts: &[Cut], multipliers: &[f64], rounds: usize) -> Bound {
        let mut left = self.objective.clone();
        let mut upper = 0.0;
        let mut shares: Vec<(&'static str, f64)> = Vec::new();
        for ((statistic, sign), z) in cuts.iter().zip(multipliers) {
            let Some(s) = self.statistics.get(*statistic).filter(|_| z.is_finite() && *z > 0.0) else { continue };
            left.axpy(-sign * z / s.limit, &s.row, 1.0);
            upper += z;
            match shares.iter_mut().find(|(detector, _)| *detector == s.detector) {
                Some((_, share)) => *share += z,
                None => shares.push((s.detector, *z)),
            }
        }
        let rest: f64 = left.iter().zip(&self.most).map(|(left, most)| left.abs() * most).sum();
        let over = |ratio: f64| if ratio.is_finite() { ratio.max(1.0) } else { f64::INFINITY };
        let bounded = attack.iter().zip(&self.most).map(|(a, most)| (a / most).abs());
        let limits = self.statistics.iter().map(|s| (s.row.dot(attack) / s.limit).abs());
        let scale = bounded.chain(limits).map(over).fold(1.0, f64::max);
        let attack = attack / scale;
        let binding = shares.iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > rest);
        Bound {
            upper: upper + rest,
            reached: self.objective.dot(&attack),
            binding: binding.map(|(detector, _)| *detector),
            attack,
            rounds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistic(row: &[f64], limit: f64) -> Statistic {
        Statistic { detector: "test", sensor: None, time_s: 0.0, limit, row: Signal::from_column_slice(row) }
    }

    #[test]
    fn a_corner_is_found_and_proved() {
        // max 3x + 2y with |x + y| ≤ 4, |x| ≤ 3 (a statistic), |y| ≤ 10: (3, 1), 11.
        let program = Program {
            objective: Signal::from_column_slice(&[3.0, 2.0]),
            statistics: vec![statistic(&[1.0, 1.0], 4.0), statistic(&[1.0, 0.0], 3.0)],
            most: vec![10.0; 2],
        };
        let bound = program.solve().unwrap();
        assert!((bound.upper - 11.0).abs() < 1e-5 && (bound.reached - 11.0).abs() < 0.02, "{bound:?}");
        assert!(bound.reached <= bound.upper && bound.binding == Some("test"));
    }

    #[test]
    fn multipliers_of_nothing_prove_only_what_may_be_added() {
        let program = Program {
            objective: Signal::from_column_slice(&[1.0, -2.0]),
            statistics: vec![statistic(&[1.0, 1.0], 4.0)],
            most: vec![5.0; 2],
        };
        let bound = program.certified(&Signal::from_column_slice(&[9.0, -9.0]), &[(0, 1.0)], &[0.0], 1);
        assert!((bound.upper - 15.0).abs() < 1e-12 && (bound.reached - 15.0).abs() < 1e-12 && bound.binding.is_none());
    }

    #[test]
    fn a_limit_that_nothing_keeps_is_named() {
        let program = Program {
            objective: Signal::from_column_slice(&[1.0]),
            statistics: vec![statistic(&[1.0], -0.25)],
            most: vec![5.0],
        };
        assert_eq!(program.solve().unwrap_err().to_string(), "the program is infeasible: the limit of test is -0.25");
    }
}
