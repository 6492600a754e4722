//! The linear program of an envelope, and what makes its answer a bound.
//!
//! For any multipliers λ, whoever found them, and every attack that keeps the limits,
//! cᵀa = Σ λᵢ mᵢᵀa + (c − Σ λᵢ mᵢ)ᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ: this is the bound told, never the solver's objective.
//! The attack told is scaled until it keeps every limit: what it reaches is a bound from below.
//!
//! A detector that sums squares, Σ wₖ xₖ² ≤ 1 with xₖ = mₖᵀa/lₖ, is no linear one, but linear ones follow from it: for any attack a*
//! every silent one has Σ wₖ x*ₖ xₖ ≤ √Σ wₖ x*ₖ² (Cauchy and Schwarz). Of the attack told such a cut for each time is in the proof. The
//! squares are kept at some times, every [`SUMMED_S`]; the attack is scaled until it keeps them at all.
//!
//! `interior` solves; what it ends with is only ever a proposal.

use nalgebra::DMatrix;
use plumbline_proto::ids::SensorId;

use super::interior::{Interior, Proof, STEPS, Squares};
use super::{EnvelopeError, Signal};

/// The bound told is at most this part above what is reached, …
const NEAR: f64 = 1e-3;
/// … and where rounding ends the search before, what is reached is at least this part of the bound.
const LEAST: f64 = 0.95;

/// Squares that are forgotten are summed this often, s: in between they pass their limit by 1 - exp(-this/memory) at most.
const SUMMED_S: f64 = 0.08;
/// Squares that count for less than this part are left out of a sum, which leaves more to an attacker.
const COUNTED: f64 = 1e-4;

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

/// The squares of one sensor in one detector.
struct Kept {
    memory: Memory,
    /// Its statistics among those heard, and their times, s, in order.
    rows: Vec<usize>,
    times_s: Vec<f64>,
    /// When they are summed, s.
    ends_s: Vec<f64>,
}

impl Kept {
    fn weights(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.ends_s.len(), self.rows.len(), |end, row| {
            let weight = self.memory.weight(self.ends_s[end] - self.times_s[row]);
            if weight > COUNTED { weight } else { 0.0 }
        })
    }

    /// The largest sum at any time, of these `values` of what is heard.
    fn largest(&self, values: &Signal) -> f64 {
        let x = || self.rows.iter().map(|row| values[*row]);
        let sum = |end_s: &f64| -> f64 {
            x().zip(&self.times_s).map(|(x, time_s)| self.memory.weight(end_s - time_s) * x * x).sum()
        };
        self.times_s.iter().map(sum).fold(0.0, f64::max)
    }
}

impl Multiplier {
    /// m, as `program` has it.
    pub fn row(&self, program: &Program) -> Signal {
        let mut row = Signal::zeros(program.objective.len());
        for (place, part) in &self.of {
            if let Some(statistic) = program.statistics.get(*place) {
                row.axpy(*part, &statistic.row, 1.0);
            }
        }
        row
    }
}

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
        self.until(|_, _| false)
    }

    /// The same, or as far as it is `known` of the bound and what is reached: both are proved at any time.
    pub(super) fn until(&self, known: impl Fn(f64, f64) -> bool) -> Result<Bound, EnvelopeError> {
        for s in &self.statistics {
            if s.limit.is_nan() || s.limit <= 0.0 || !s.row.iter().all(|x| x.is_finite()) {
                return Err(EnvelopeError::Infeasible { detector: s.detector, limit: s.limit });
            }
        }
        // Those that can pass their limit or are summed, in the order of time; columns as they are first heard of.
        let summed = |s: &Statistic| self.squares.iter().any(|(detector, _)| *detector == s.detector);
        let loud =
            |s: &Statistic| s.row.iter().zip(&self.most).map(|(x, most)| (x * most).abs()).sum::<f64>() > s.limit;
        let mut heard: Vec<(usize, &Statistic)> =
            self.statistics.iter().enumerate().filter(|(_, s)| summed(s) || loud(s)).collect();
        heard.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
        let n = self.objective.len();
        let first = |j: usize| (heard.iter().position(|(_, s)| s.row[j] != 0.0).unwrap_or(heard.len()), j);
        let mut order: Vec<(usize, usize)> = (0..n).map(first).collect();
        // What nobody hears of and moves nothing is left at rest.
        order.retain(|(first, j)| *first < heard.len() || self.objective[*j] != 0.0);
        order.sort_unstable();
        let order: Vec<usize> = order.into_iter().map(|(_, j)| j).collect();
        let scaled = |i: usize, j: usize| heard.get(i).map_or(0.0, |(_, s)| s.row[order[j]] / s.limit);
        let m = DMatrix::from_fn(heard.len(), order.len(), scaled);
        let objective = self.objective.select_rows(&order);
        let most = Signal::from_iterator(order.len(), order.iter().map(|j| self.most[*j]));
        let kept = self.kept(&heard);
        let squares = kept.iter().map(|kept| Squares { rows: kept.rows.clone(), weights: kept.weights() }).collect();
        let mut interior = Interior::new(m.clone(), objective.clone(), &most, squares);
        let (mut best, mut held, mut enough) = (Bound::none(n), None, false);
        for steps in 1..=STEPS {
            let nearer = interior.step();
            let proof = interior.proof();
            let (upper, added) = proof.bound(&most);
            let values = &m * &interior.attack;
            let scale = scale(&interior.attack, &most, &values, &kept);
            let reached = objective.dot(&interior.attack) / scale;
            // Of either the best so far: each proves itself.
            if upper < best.upper {
                (best.upper, best.added) = (upper, added);
                held = Some((proof, values));
            }
            if reached > best.reached || steps == 1 {
                best.reached = reached;
                order.iter().zip(&interior.attack).for_each(|(j, x)| best.attack[*j] = x / scale);
            }
            best.steps = steps;
            enough = known(best.upper, best.reached);
            if enough || best.upper - best.reached <= NEAR * best.upper || !nearer {
                break;
            }
        }
        let held = held.filter(|_| enough || (best.upper.is_finite() && best.reached >= LEAST * best.upper));
        let Some((proof, values)) = held else {
            let status = "no bound that is nearly reached".to_owned();
            return Err(EnvelopeError::Solver { status, columns: n, rows: heard.len() });
        };
        (best.certificate, best.binding) = certificate(&proof, best.added, &heard, &kept, &values);
        Ok(best)
    }

    /// The squares of what is heard, detector by detector and sensor by sensor.
    fn kept(&self, heard: &[(usize, &Statistic)]) -> Vec<Kept> {
        let mut all: Vec<(&'static str, Option<SensorId>, Kept)> = Vec::new();
        for (row, (_, s)) in heard.iter().enumerate() {
            let Some((_, memory)) = self.squares.iter().find(|(detector, _)| *detector == s.detector) else { continue };
            let place = all.iter().position(|(detector, sensor, _)| (*detector, *sensor) == (s.detector, s.sensor));
            let place = place.unwrap_or_else(|| {
                let kept = Kept { memory: *memory, rows: Vec::new(), times_s: Vec::new(), ends_s: Vec::new() };
                all.push((s.detector, s.sensor, kept));
                all.len() - 1
            });
            if let Some((_, _, kept)) = all.get_mut(place) {
                kept.rows.push(row);
                kept.times_s.push(s.time_s);
            }
        }
        for (_, _, kept) in &mut all {
            let every_s = if matches!(kept.memory, Memory::Forgotten(_)) { SUMMED_S } else { 0.0 };
            // From the last one back: the end is where an attacker has nothing to lose.
            for time_s in kept.times_s.iter().rev() {
                if kept.ends_s.last().is_none_or(|after| time_s + every_s <= after + 1e-9 && time_s < after) {
                    kept.ends_s.push(*time_s);
                }
            }
            kept.ends_s.reverse();
        }
        all.into_iter().map(|(_, _, kept)| kept).collect()
    }
}

/// By how much an attack is too large for one of the limits: for all, also those not heard, which nothing passes.
fn scale(attack: &Signal, most: &Signal, values: &Signal, kept: &[Kept]) -> f64 {
    let over = |ratio: f64| if ratio.is_finite() { ratio.max(1.0) } else { f64::INFINITY };
    let bounded = attack.iter().zip(most).map(|(a, most)| (a / most).abs());
    let summed = kept.iter().map(|kept| kept.largest(values).sqrt());
    bounded.chain(values.iter().map(|x| x.abs())).chain(summed).map(over).fold(1.0, f64::max)
}

impl Proof {
    /// The bound, and what of it is what may be added.
    fn bound(&self, most: &Signal) -> (f64, f64) {
        let added: f64 = self.left.iter().zip(most).map(|(left, most)| left.abs() * most).sum();
        let sums: f64 = self.sums.iter().map(Signal::sum).sum();
        (self.linear.iter().map(|z| z.abs()).sum::<f64>() + sums + added, added)
    }
}

/// λ of what is heard, whose statistics have these `values`, and the detector that holds most of the bound.
fn certificate(
    proof: &Proof,
    added: f64,
    heard: &[(usize, &Statistic)],
    kept: &[Kept],
    values: &Signal,
) -> (Vec<Multiplier>, Option<&'static str>) {
    let mut all = Vec::new();
    for ((place, s), z) in heard.iter().zip(&proof.linear).filter(|(_, z)| **z != 0.0) {
        let Statistic { detector, sensor, time_s, limit, .. } = **s;
        all.push(Multiplier { value: z / limit, detector, sensor, time_s, limit, of: vec![(*place, 1.0)] });
    }
    for (kept, sums) in kept.iter().zip(&proof.sums) {
        let weights = kept.weights();
        for ((end, time_s), value) in kept.ends_s.iter().enumerate().zip(sums).filter(|(_, value)| **value > 0.0) {
            let weights = weights.row(end);
            let counted = || kept.rows.iter().zip(weights.iter()).filter(|(_, weight)| **weight > 0.0);
            let sum: f64 = counted().map(|(row, weight)| weight * values[*row] * values[*row]).sum();
            let part = |(row, weight): (&usize, &f64)| {
                let (place, s) = heard.get(*row)?;
                Some((*place, weight * values[*row] / (s.limit * sum.sqrt())))
            };
            let Some((_, s)) = kept.rows.first().and_then(|row| heard.get(*row)) else { continue };
            let (detector, sensor, of) = (s.detector, s.sensor, counted().filter_map(part).collect());
            all.push(Multiplier { value: *value, detector, sensor, time_s: *time_s, limit: 1.0, of });
        }
    }
    let mut shares: Vec<(&'static str, f64)> = Vec::new();
    for one in &all {
        let share = one.value.abs() * one.limit;
        match shares.iter_mut().find(|(detector, _)| *detector == one.detector) {
            Some((_, sum)) => *sum += share,
            None => shares.push((one.detector, share)),
        }
    }
    let binding = shares.iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > added);
    (all, binding.map(|(detector, _)| *detector))
}

impl Bound {
    /// Nothing proved yet, nothing added.
    fn none(columns: usize) -> Self {
        let (upper, attack) = (f64::INFINITY, Signal::zeros(columns));
        Self { upper, reached: 0.0, attack, binding: None, certificate: Vec::new(), added: f64::INFINITY, steps: 0 }
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
    fn squares_are_kept_and_their_cuts_prove_it() {
        // max 3x + 4y with (x/2)² + (y/2)² ≤ 1: 10, at (1.2, 1.6).
        let program = Program {
            objective: Signal::from_column_slice(&[3.0, 4.0]),
            statistics: vec![statistic(&[1.0, 0.0], 2.0), statistic(&[0.0, 1.0], 2.0)],
            squares: vec![("test", Memory::Last(1.0))],
            most: vec![10.0; 2],
        };
        let bound = program.solve().unwrap();
        assert!(
            bound.upper >= 10.0 && bound.upper < 10.01 && bound.reached > 9.99 && bound.reached <= 10.0,
            "{bound:?}"
        );
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
        let (objective, most) = (Signal::from_column_slice(&[1.0, -2.0]), Signal::from_element(2, 5.0));
        let proof = Proof { linear: Signal::zeros(1), sums: Vec::new(), left: objective };
        assert_eq!(proof.bound(&most), (15.0, 15.0));
        // Twice what may be added, three times a limit of another kind.
        let attack = Signal::from_column_slice(&[10.0, -4.0]);
        assert!((scale(&attack, &most, &Signal::from_element(1, 0.5), &[]) - 2.0).abs() < 1e-12);
        assert!((scale(&attack, &most, &Signal::from_element(1, -3.0), &[]) - 3.0).abs() < 1e-12);
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
