//! The linear program of an envelope, and what makes its answer a bound.
//!
//! For any multipliers λ, whoever found them, and every attack that keeps the limits,
//! cᵀa = Σ λᵢ mᵢᵀa + (c − Σ λᵢ mᵢ)ᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ: this is the bound told, never the solver's objective.
//! The attack told is scaled until it keeps every limit: what it reaches is a bound from below. Where a detector is no linear one, its
//! limits are necessary for its silence in the bound, and sufficient (`silent`) for the attack.
//!
//! `interior` solves; what it ends with is only ever a proposal.

use nalgebra::DMatrix;
use plumbline_proto::ids::SensorId;

use super::interior::{Interior, STEPS};
use super::{EnvelopeError, Signal};

/// The bound told is at most this part above what is reached, …
const NEAR: f64 = 1e-3;
/// … and where rounding ends the search before, what is reached is at least this part of the bound.
const LEAST: f64 = 0.95;

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
    /// At most l: whoever keeps this one everywhere keeps what l stands for, such as an energy.
    pub silent: f64,
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
    /// Of the interior point method.
    pub steps: usize,
}

impl Program {
    /// Solves it.
    ///
    /// # Errors
    /// [`EnvelopeError::Infeasible`] for a limit that nothing keeps, [`EnvelopeError::Solver`].
    pub fn solve(&self) -> Result<Bound, EnvelopeError> {
        let bound = self.within(|s| s.limit)?;
        if self.statistics.iter().all(|s| s.silent == s.limit) {
            return Ok(bound);
        }
        let Bound { attack, reached, .. } = self.within(|s| s.silent)?;
        Ok(Bound { attack, reached, ..bound })
    }

    /// With these limits.
    fn within(&self, limit: fn(&Statistic) -> f64) -> Result<Bound, EnvelopeError> {
        for s in &self.statistics {
            if limit(s).is_nan() || limit(s) <= 0.0 || !s.row.iter().all(|x| x.is_finite()) {
                return Err(EnvelopeError::Infeasible { detector: s.detector, limit: limit(s) });
            }
        }
        // Those that can pass their limit, in the order of time; columns as they are first heard of.
        let loud =
            |s: &&Statistic| s.row.iter().zip(&self.most).map(|(x, most)| (x * most).abs()).sum::<f64>() > limit(s);
        let mut heard: Vec<&Statistic> = self.statistics.iter().filter(loud).collect();
        heard.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let n = self.objective.len();
        let first = |j: &usize| heard.iter().position(|s| s.row[*j] != 0.0).unwrap_or(heard.len());
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_cached_key(first);
        let scaled = |i: usize, j: usize| heard.get(i).map_or(0.0, |s| s.row[order[j]] / limit(s));
        let m = DMatrix::from_fn(heard.len(), n, scaled);
        let most = Signal::from_iterator(n, order.iter().map(|j| self.most[*j]));
        let mut interior = Interior::new(m, self.objective.select_rows(&order), &most);
        let mut best: Option<Bound> = None;
        for steps in 1..=STEPS {
            let nearer = interior.step();
            let mut attack = Signal::zeros(n);
            order.iter().zip(&interior.attack).for_each(|(j, x)| attack[*j] = *x);
            let found = self.certified(&attack, &heard, &interior.signed(), limit, steps);
            // Of either the best so far: each proves itself.
            best = Some(match best.take() {
                Some(before) => before.and(found),
                None => found,
            });
            let enough = best.as_ref().is_some_and(|best| best.upper - best.reached <= NEAR * best.upper);
            if enough || !nearer {
                break;
            }
        }
        best.filter(|best| best.upper.is_finite() && best.reached >= LEAST * best.upper).ok_or_else(|| {
            EnvelopeError::Solver {
                status: "no bound that is nearly reached".to_owned(),
                columns: n,
                rows: heard.len(),
            }
        })
    }

    /// What attack and multipliers prove. Neither is taken on trust.
    fn certified(
        &self,
        attack: &Signal,
        heard: &[&Statistic],
        multipliers: &[f64],
        limit: fn(&Statistic) -> f64,
        steps: usize,
    ) -> Bound {
        let mut left = self.objective.clone();
        let mut upper = 0.0;
        let mut shares: Vec<(&'static str, f64)> = Vec::new();
        for (s, z) in heard.iter().zip(multipliers).filter(|(_, z)| z.is_finite()) {
            left.axpy(-z / limit(s), &s.row, 1.0);
            upper += z.abs();
            match shares.iter_mut().find(|(detector, _)| *detector == s.detector) {
                Some((_, share)) => *share += z.abs(),
                None => shares.push((s.detector, z.abs())),
            }
        }
        let rest: f64 = left.iter().zip(&self.most).map(|(left, most)| left.abs() * most).sum();
        let over = |ratio: f64| if ratio.is_finite() { ratio.max(1.0) } else { f64::INFINITY };
        let bounded = attack.iter().zip(&self.most).map(|(a, most)| (a / most).abs());
        let limits = self.statistics.iter().map(|s| (s.row.dot(attack) / limit(s)).abs());
        let scale = bounded.chain(limits).map(over).fold(1.0, f64::max);
        let attack = attack / scale;
        let binding = shares.iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > rest);
        Bound {
            upper: upper + rest,
            reached: self.objective.dot(&attack),
            binding: binding.map(|(detector, _)| *detector),
            attack,
            steps,
        }
    }
}

impl Bound {
    /// The better of each.
    fn and(self, other: Self) -> Self {
        let (steps, nearer) = (other.steps, other.reached > self.reached);
        let (upper, binding) =
            if other.upper < self.upper { (other.upper, other.binding) } else { (self.upper, self.binding) };
        let (reached, attack) = if nearer { (other.reached, other.attack) } else { (self.reached, self.attack) };
        Self { upper, reached, attack, binding, steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistic(row: &[f64], limit: f64) -> Statistic {
        Statistic {
            detector: "test",
            sensor: None,
            time_s: 0.0,
            limit,
            silent: limit,
            row: Signal::from_column_slice(row),
        }
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
        assert!(
            (bound.upper - 11.0).abs() < 0.011 && bound.upper >= 11.0 - 1e-9 && (bound.reached - 11.0).abs() < 0.011,
            "{bound:?}"
        );
        assert!(bound.reached <= bound.upper && bound.binding == Some("test"));
    }

    #[test]
    fn the_bound_is_that_of_the_limits_and_the_attack_keeps_the_silent_ones() {
        let half = Statistic { silent: 2.0, ..statistic(&[1.0], 4.0) };
        let program =
            Program { objective: Signal::from_column_slice(&[3.0]), statistics: vec![half], most: vec![10.0] };
        let bound = program.solve().unwrap();
        assert!((bound.upper - 12.0).abs() < 0.02 && (bound.reached - 6.0).abs() < 0.02, "{bound:?}");
        assert!((bound.attack[0] - 2.0).abs() < 0.01);
    }

    #[test]
    fn multipliers_of_nothing_prove_only_what_may_be_added() {
        let program = Program {
            objective: Signal::from_column_slice(&[1.0, -2.0]),
            statistics: vec![statistic(&[1.0, 1.0], 4.0)],
            most: vec![5.0; 2],
        };
        let heard: Vec<&Statistic> = program.statistics.iter().collect();
        let bound = program.certified(&Signal::from_column_slice(&[9.0, -9.0]), &heard, &[0.0], |s| s.limit, 1);
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
