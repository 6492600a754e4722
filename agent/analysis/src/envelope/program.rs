//! The linear program of an envelope, and what makes its answer a bound.
//!
//! For any multipliers λ, whoever found them, and every attack that keeps the limits,
//! cᵀa = Σ λᵢ mᵢᵀa + (c − Σ λᵢ mᵢ)ᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ: this is the bound told, never the solver's objective.
//! The attack told is scaled until it keeps every limit: what it reaches is a bound from below.
//!
//! A detector that sums squares, Σ wₖ xₖ² ≤ 1 with xₖ = mₖᵀa/lₖ, is no linear one. Cut by cut it is made of linear ones: for the
//! attack a* found so far every silent one has Σ wₖ x*ₖ xₖ ≤ √Σ wₖ x*ₖ² (Cauchy and Schwarz), which a* itself does not keep
//! \[Kelley 1960\]. So each bound on the way is one; the attack is scaled until it keeps the squares themselves.
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

/// Cuts are added so often at most, and while what is reached is less than this part of the bound.
const ROUNDS: usize = 5;
const CLOSE: f64 = 0.93;
/// Squares are cut this often, s.
const CUT_S: f64 = 0.2;

/// How long a square counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Memory {
    /// It is forgotten within so long, s.
    Forgotten(f64),
    /// It counts in full for so long, s.
    Last(f64),
}

impl Memory {
    /// What a square of `age_s` counts.
    pub fn weight(self, age_s: f64) -> f64 {
        match self {
            _ if age_s < -1e-9 => 0.0,
            Self::Forgotten(within_s) => (-age_s / within_s).exp(),
            Self::Last(s) => f64::from(u8::from(age_s < s - 1e-9)),
        }
    }
}

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

/// One multiplier of a certificate.
#[derive(Debug, Clone, PartialEq)]
pub struct Multiplier {
    /// λ; its sign says which side of the limit.
    pub value: f64,
    /// Detector, sensor, when, and its limit l.
    pub detector: &'static str,
    /// See [`Statistic`].
    pub sensor: Option<SensorId>,
    /// s.
    pub time_s: f64,
    /// l.
    pub limit: f64,
    /// m as statistics of the program, by their places, each times so much: itself, or those whose squares were cut.
    pub of: Vec<(usize, f64)>,
}

/// A linear one that follows from squares, and what it is made of.
#[derive(Debug)]
struct Cut(Statistic, Vec<(usize, f64)>);

/// See the module of the envelope.
#[derive(Debug, Clone)]
pub struct Program {
    /// c.
    pub objective: Signal,
    /// m and l.
    pub statistics: Vec<Statistic>,
    /// Detectors whose statistics, over their limits, sum their squares to at most one, sensor by sensor.
    pub squares: Vec<(&'static str, Memory)>,
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
    /// λ, the proof of `upper`: Σ |λᵢ| lᵢ, and `added`.
    pub certificate: Vec<Multiplier>,
    /// Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ.
    pub added: f64,
    /// Of the interior point method.
    pub steps: usize,
}

impl Program {
    /// Solves it.
    ///
    /// # Errors
    /// [`EnvelopeError::Infeasible`] for a limit that nothing keeps, [`EnvelopeError::Solver`].
    pub fn solve(&self) -> Result<Bound, EnvelopeError> {
        let mut cuts: Vec<Cut> = Vec::new();
        let mut best = self.kept()?;
        for _ in 0..ROUNDS {
            let found = self.within(&cuts)?;
            let (largest, mut new) = self.cut(&found.attack);
            // Halfway to the best one that keeps the squares a cut goes deeper.
            if let Some(best) = &best {
                new.extend(self.cut(&(0.5 * (&found.attack + &best.attack))).1);
            }
            let scale = largest.max(1.0).sqrt();
            let kept = Bound { attack: &found.attack / scale, reached: found.reached / scale, ..found };
            let steps = kept.steps + best.as_ref().map_or(0, |best| best.steps);
            let now = Bound { steps, ..best.take().map_or(kept.clone(), |before| before.and(kept)) };
            let done = new.is_empty() || now.reached >= CLOSE * now.upper;
            best = Some(now);
            if done {
                break;
            }
            cuts.extend(new);
        }
        best.ok_or_else(|| self.unsolved(0))
    }

    /// The largest attack each of whose statistics is so small that no sum of squares passes its limit: no bound, but one that
    /// keeps everything. `None` where nothing is squared.
    fn kept(&self) -> Result<Option<Bound>, EnvelopeError> {
        let mut inner = Self { squares: Vec::new(), ..self.clone() };
        for (detector, memory) in &self.squares {
            let times: Vec<(f64, Option<SensorId>)> =
                self.statistics.iter().filter(|s| s.detector == *detector).map(|s| (s.time_s, s.sensor)).collect();
            let Some((last_s, sensor)) = times.last().copied() else { continue };
            let weights =
                times.iter().filter(|(_, of)| *of == sensor).map(|(time_s, _)| memory.weight(last_s - time_s));
            let part = weights.sum::<f64>().max(1.0).sqrt();
            inner.statistics.iter_mut().filter(|s| s.detector == *detector).for_each(|s| s.limit /= part);
        }
        if self.squares.iter().all(|(detector, _)| self.statistics.iter().all(|s| s.detector != *detector)) {
            return Ok(None);
        }
        inner.within(&[]).map(|found| Some(Bound { upper: f64::INFINITY, ..found }))
    }

    fn unsolved(&self, rows: usize) -> EnvelopeError {
        let status = "no bound that is nearly reached".to_owned();
        EnvelopeError::Solver { status, columns: self.objective.len(), rows }
    }

    /// The largest sum of squares that `attack` makes, and the cuts that it does not keep.
    fn cut(&self, attack: &Signal) -> (f64, Vec<Cut>) {
        let (mut largest, mut cuts) = (0.0_f64, Vec::new());
        for (detector, memory) in &self.squares {
            let of = |sensor| move |s: &&Statistic| s.detector == *detector && s.sensor == sensor;
            let mut sensors: Vec<Option<SensorId>> = Vec::new();
            for s in self.statistics.iter().filter(|s| s.detector == *detector) {
                if !sensors.contains(&s.sensor) {
                    sensors.push(s.sensor);
                }
            }
            for sensor in sensors {
                let mine: Vec<(usize, &Statistic)> =
                    self.statistics.iter().enumerate().filter(|(_, s)| of(sensor)(s)).collect();
                let x: Vec<f64> = mine.iter().map(|(_, s)| s.row.dot(attack) / s.limit).collect();
                let mut next_s = f64::NEG_INFINITY;
                for (_, end) in &mine {
                    let weights = || mine.iter().zip(&x).map(|(s, x)| (s, x, memory.weight(end.time_s - s.1.time_s)));
                    let sum: f64 = weights().map(|(_, x, weight)| weight * x * x).sum();
                    largest = largest.max(sum);
                    if sum <= 1.0 + 1e-6 || end.time_s < next_s {
                        continue;
                    }
                    next_s = end.time_s + CUT_S - 1e-9;
                    let (mut row, mut made_of) = (Signal::zeros(attack.len()), Vec::new());
                    for ((place, s), x, weight) in weights().filter(|(_, _, weight)| *weight > 1e-4) {
                        let part = weight * x / (s.limit * sum.sqrt());
                        row.axpy(part, &s.row, 1.0);
                        made_of.push((*place, part));
                    }
                    // What was left out of the sum is in the limit.
                    let rest: f64 = weights().filter(|(_, _, weight)| *weight <= 1e-4).map(|(_, x, w)| w * x * x).sum();
                    let limit = ((sum - rest) / sum).sqrt();
                    cuts.push(Cut(Statistic { detector, sensor, time_s: end.time_s, limit, row }, made_of));
                }
            }
        }
        (largest, cuts)
    }

    /// Without the squares, but for these `cuts`.
    fn within(&self, cuts: &[Cut]) -> Result<Bound, EnvelopeError> {
        for s in &self.statistics {
            if s.limit.is_nan() || s.limit <= 0.0 || !s.row.iter().all(|x| x.is_finite()) {
                return Err(EnvelopeError::Infeasible { detector: s.detector, limit: s.limit });
            }
        }
        // Those that can pass their limit, in the order of time; columns as they are first heard of.
        let loud =
            |s: &Statistic| s.row.iter().zip(&self.most).map(|(x, most)| (x * most).abs()).sum::<f64>() > s.limit;
        let itself = self.statistics.iter().enumerate().map(|(place, s)| (s, vec![(place, 1.0)]));
        let mut all: Vec<_> =
            itself.chain(cuts.iter().map(|cut| (&cut.0, cut.1.clone()))).filter(|(s, _)| loud(s)).collect();
        all.sort_by(|a, b| a.0.time_s.total_cmp(&b.0.time_s));
        let heard: Vec<&Statistic> = all.iter().map(|(s, _)| *s).collect();
        let n = self.objective.len();
        let first = |j: &usize| heard.iter().position(|s| s.row[*j] != 0.0).unwrap_or(heard.len());
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_cached_key(first);
        let scaled = |i: usize, j: usize| heard.get(i).map_or(0.0, |s| s.row[order[j]] / s.limit);
        let m = DMatrix::from_fn(heard.len(), n, scaled);
        let most = Signal::from_iterator(n, order.iter().map(|j| self.most[*j]));
        let mut interior = Interior::new(m, self.objective.select_rows(&order), &most);
        let (mut best, mut proof): (Option<Bound>, _) = (None, Vec::new());
        for steps in 1..=STEPS {
            let nearer = interior.step();
            let mut attack = Signal::zeros(n);
            order.iter().zip(&interior.attack).for_each(|(j, x)| attack[*j] = *x);
            let multipliers = interior.signed();
            let found = self.certified(&attack, &heard, &multipliers, steps);
            if best.as_ref().is_none_or(|best| found.upper < best.upper) {
                proof = multipliers;
            }
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
        let near = |best: &Bound| best.upper.is_finite() && best.reached >= LEAST * best.upper;
        let mut best = best.filter(near).ok_or_else(|| self.unsolved(heard.len()))?;
        let multipliers = all.into_iter().zip(proof).filter(|(_, z)| z.is_finite() && *z != 0.0);
        best.certificate = multipliers
            .map(|((s, of), z)| {
                let Statistic { detector, sensor, time_s, limit, .. } = *s;
                Multiplier { value: z / limit, detector, sensor, time_s, limit, of }
            })
            .collect();
        Ok(best)
    }

    /// What attack and multipliers prove. Neither is taken on trust.
    fn certified(&self, attack: &Signal, heard: &[&Statistic], multipliers: &[f64], steps: usize) -> Bound {
        let mut left = self.objective.clone();
        let mut upper = 0.0;
        let mut shares: Vec<(&'static str, f64)> = Vec::new();
        for (s, z) in heard.iter().zip(multipliers).filter(|(_, z)| z.is_finite()) {
            left.axpy(-z / s.limit, &s.row, 1.0);
            upper += z.abs();
            match shares.iter_mut().find(|(detector, _)| *detector == s.detector) {
                Some((_, share)) => *share += z.abs(),
                None => shares.push((s.detector, z.abs())),
            }
        }
        let rest: f64 = left.iter().zip(&self.most).map(|(left, most)| left.abs() * most).sum();
        let over = |ratio: f64| if ratio.is_finite() { ratio.max(1.0) } else { f64::INFINITY };
        let bounded = attack.iter().zip(&self.most).map(|(a, most)| (a / most).abs());
        // Also what was not heard, which it cannot pass.
        let limits = heard.iter().map(|s| (s.row.dot(attack) / s.limit).abs());
        let scale = bounded.chain(limits).map(over).fold(1.0, f64::max);
        let attack = attack / scale;
        let binding = shares.iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > rest);
        Bound {
            upper: upper + rest,
            reached: self.objective.dot(&attack),
            binding: binding.map(|(detector, _)| *detector),
            certificate: Vec::new(),
            added: rest,
            attack,
            steps,
        }
    }
}

impl Bound {
    /// The better of each.
    fn and(self, other: Self) -> Self {
        let (steps, nearer) = (other.steps, other.reached > self.reached);
        let (upper, binding, certificate, added) = if other.upper < self.upper {
            (other.upper, other.binding, other.certificate, other.added)
        } else {
            (self.upper, self.binding, self.certificate, self.added)
        };
        let (reached, attack) = if nearer { (other.reached, other.attack) } else { (self.reached, self.attack) };
        Self { upper, reached, attack, binding, certificate, added, steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistic(row: &[f64], limit: f64) -> Statistic {
        Statistic { detector: "test", sensor: None, time_s: 0.0, limit, row: Signal::from_column_slice(row) }
    }

    /// What the certificate alone proves; that each cut follows from its squares is looked at as well.
    fn summed(program: &Program, bound: &Bound) -> f64 {
        let (mut left, mut sum) = (program.objective.clone(), 0.0);
        for one in &bound.certificate {
            let of = || one.of.iter().map(|(place, part)| (&program.statistics[*place], part));
            of().for_each(|(s, part)| left.axpy(-one.value * part, &s.row, 1.0));
            let squares = program.squares.iter().find(|(detector, _)| *detector == one.detector);
            // Cauchy and Schwarz; one alone keeps its own limit.
            let weight = |s: &Statistic| squares.map_or(1.0, |(_, memory)| memory.weight(one.time_s - s.time_s));
            let limit = of().map(|(s, part)| (part * s.limit).powi(2) / weight(s)).sum::<f64>().sqrt();
            assert!(limit <= one.limit * (1.0 + 1e-9), "{limit} of {one:?}");
            sum += one.value.abs() * one.limit;
        }
        sum + left.iter().zip(&program.most).map(|(left, most)| left.abs() * most).sum::<f64>()
    }

    #[test]
    fn a_corner_is_found_and_proved() {
        // max 3x + 2y with |x + y| ≤ 4, |x| ≤ 3 (a statistic), |y| ≤ 10: (3, 1), 11.
        let program = Program {
            objective: Signal::from_column_slice(&[3.0, 2.0]),
            statistics: vec![statistic(&[1.0, 1.0], 4.0), statistic(&[1.0, 0.0], 3.0)],
            squares: Vec::new(),
            most: vec![10.0; 2],
        };
        let bound = program.solve().unwrap();
        assert!(
            (bound.upper - 11.0).abs() < 0.011 && bound.upper >= 11.0 - 1e-9 && (bound.reached - 11.0).abs() < 0.011,
            "{bound:?}"
        );
        assert!(bound.reached <= bound.upper && bound.binding == Some("test"));
        assert!((summed(&program, &bound) / bound.upper - 1.0).abs() < 1e-12);
    }

    #[test]
    fn squares_are_cut_until_the_attack_keeps_them() {
        // max 3x + 4y with (x/2)² + (y/2)² ≤ 1: 10, at (1.2, 1.6).
        let program = Program {
            objective: Signal::from_column_slice(&[3.0, 4.0]),
            statistics: vec![statistic(&[1.0, 0.0], 2.0), statistic(&[0.0, 1.0], 2.0)],
            squares: vec![("test", Memory::Last(1.0))],
            most: vec![10.0; 2],
        };
        let bound = program.solve().unwrap();
        assert!(bound.upper >= 10.0 && bound.upper < 10.5 && bound.reached > 9.6 && bound.reached <= 10.0, "{bound:?}");
        assert!((bound.attack.norm() - 2.0).abs() < 1e-3);
        assert!((summed(&program, &bound) / bound.upper - 1.0).abs() < 1e-12);
        assert!(bound.certificate.iter().any(|one| one.of.len() == 2), "{bound:?}");
        let free = Program { squares: Vec::new(), ..program };
        assert!((free.solve().unwrap().upper - 14.0).abs() < 0.02);
        assert_eq!([0.0, 0.5, 1.0].map(|age| Memory::Last(1.0).weight(age)), [1.0, 1.0, 0.0]);
        assert!((Memory::Forgotten(2.0).weight(2.0) - (-1.0_f64).exp()).abs() < 1e-12);
    }

    #[test]
    fn multipliers_of_nothing_prove_only_what_may_be_added() {
        let program = Program {
            objective: Signal::from_column_slice(&[1.0, -2.0]),
            statistics: vec![statistic(&[1.0, 1.0], 4.0)],
            squares: Vec::new(),
            most: vec![5.0; 2],
        };
        let heard: Vec<&Statistic> = program.statistics.iter().collect();
        let bound = program.certified(&Signal::from_column_slice(&[9.0, -9.0]), &heard, &[0.0], 1);
        assert!((bound.upper - 15.0).abs() < 1e-12 && (bound.reached - 15.0).abs() < 1e-12 && bound.binding.is_none());
    }

    #[test]
    fn a_limit_that_nothing_keeps_is_named() {
        let program = Program {
            objective: Signal::from_column_slice(&[1.0]),
            statistics: vec![statistic(&[1.0], -0.25)],
            squares: Vec::new(),
            most: vec![5.0],
        };
        assert_eq!(program.solve().unwrap_err().to_string(), "the program is infeasible: the limit of test is -0.25");
    }
}
