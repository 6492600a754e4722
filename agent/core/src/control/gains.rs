//! From a design to certified gains: checked, solved, examined on the sampled plant with the motors'
//! lag and one tick of delay, then hashed. Refused with the reason and the numbers.
//!
//! | symbol | meaning |
//! |---|---|
//! | Q, R | diagonal weights ([`Weights`]) |
//! | K | 4 × 16, u = −K [x; ∫e], for the heading frame |
//! | T | tick period, s |

mod error;
mod wire;

use nalgebra::{DMatrix, SMatrix, Vector4};
use plumbline_proto::ids::GainsRevision;
use sha2::{Digest, Sha256};

use crate::event::{Text, text};
use crate::linalg::{LinalgError, dare};
use crate::model::airframe::Airframe;
use crate::model::discretize::sampled_cost;
use crate::model::linearize::{hover, ix};
use crate::model::state_space::StateSpace;

use super::hinf::Hinf;
use super::law::Law;
use super::lqg::Lqg;
use super::lqr_integral::{INTEGRALS, LqrIntegral, Weights};
use super::margins::{Examination, Margins, Plant};
use super::pid::Pid;
use super::policy::MarginPolicy;
use super::tuning::{Design, kind_name};
use super::{Controller, ControllerKind};

pub use error::GainsError;

/// K: rows thrust (N), torque x y z (N m); columns as [`Weights::state`].
pub type Gain = SMatrix<f64, 4, 16>;

/// Weights outside these make K meaningless in double precision.
const WEIGHT_MAX: f64 = 1e12;
/// Smallest input weight.
const INPUT_WEIGHT_MIN: f64 = 1e-9;
/// Largest entry of a K pushed outright: far above any vehicle's.
const K_MAX: f64 = 1e6;

/// Gains that passed every examination. No part of it is on the heap.
#[derive(Debug, Clone, PartialEq)]
pub struct Certified {
    /// Number given by the ground; 0 is the set the agent started with.
    pub revision: GainsRevision,
    /// Period of the ticks they were sampled for, s.
    pub period_s: f64,
    /// What they come from.
    pub design: Design,
    /// The law, at rest.
    pub law: Law,
    /// Of the whole loop: the worse of position and attitude in each figure's loop.
    pub margins: Margins,
    /// The policy they passed.
    pub policy: MarginPolicy,
    /// SHA-256 of every number that the law multiplies with ([`Law::each_value`]), little-endian.
    pub sha256: [u8; 32],
}

/// Names of the states and integrals, in order.
pub const STATE_NAMES: [&str; 16] = [
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "roll",
    "pitch",
    "yaw",
    "p",
    "q",
    "r",
    "integral of x",
    "integral of y",
    "integral of z",
    "integral of yaw",
];
/// Names of the inputs, in order.
pub const INPUT_NAMES: [&str; 4] = ["thrust", "torque x", "torque y", "torque z"];
/// Outputs that are stepped, in order.
pub const OUTPUT_NAMES: [&str; 4] = ["x", "y", "z", "yaw"];

/// What the operator and the log are told of gains that were refused.
pub fn refusal(revision: GainsRevision, error: &GainsError) -> Text {
    text(format_args!("gains {} refused: {error}", revision.0))
}

/// Everything found about a law, whatever a policy makes of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    /// With the horizontal loop closed.
    pub position: Examination,
    /// Without it.
    pub attitude: Examination,
    /// Share of the motors' room that a step of 1 m in x, y, z and of 1 rad in yaw asks for, uncut.
    pub unit_step: [f64; 4],
}

/// Examines designs for one airframe, tick rate and policy.
#[derive(Debug, Clone)]
pub struct Examiner {
    airframe: Airframe,
    period_s: f64,
    policy: MarginPolicy,
    position: Plant,
    attitude: Plant,
}

impl Examiner {
    /// For `airframe` at ticks of `period_s`.
    ///
    /// # Errors
    /// [`GainsError::Solve`] for an absurd airframe.
    pub fn new(airframe: &Airframe, period_s: f64, policy: MarginPolicy) -> Result<Self, GainsError> {
        Ok(Self {
            airframe: airframe.clone(),
            period_s,
            policy,
            position: Plant::new(airframe, period_s, true)?,
            attitude: Plant::new(airframe, period_s, false)?,
        })
    }

    /// The policy it judges by.
    pub fn policy(&self) -> &MarginPolicy {
        &self.policy
    }

    /// The law of `design`, solved but not examined.
    ///
    /// # Errors
    /// [`GainsError`] with the offending value.
    pub fn solve(&self, design: &Design) -> Result<Law, GainsError> {
        design.check()?;
        Ok(match (design.kind, &design.k) {
            (ControllerKind::Pid, _) => Law::Pid(Pid::new(&self.airframe, &design.parameters)),
            (ControllerKind::Lqg, _) => {
                Law::Lqg(Lqg::new(&self.airframe, self.period_s, &design.weights, &design.parameters)?)
            }
            (ControllerKind::Hinf, _) => Law::Hinf(Hinf::new(&self.airframe, self.period_s, &design.parameters)?),
            (kind, given) => {
                let mut weights = design.weights;
                if kind == ControllerKind::Lqr {
                    weights.state[12..].fill(0.0);
                }
                let [k, k_attitude] = match given {
                    Some(given) => *given,
                    None => lqr_gains(&self.airframe, self.period_s, &weights)?,
                };
                Law::StateFeedback(LqrIntegral::new(&self.airframe, k, k_attitude))
            }
        })
    }

    /// Poles and margins of `law`, whatever the policy.
    ///
    /// # Errors
    /// [`GainsError::Solve`] when an eigenvalue does not converge.
    pub fn examine(&self, law: &Law) -> Result<Findings, GainsError> {
        let position = law.linear(self.period_s, true);
        Ok(Findings {
            position: self.position.examine(&position)?,
            attitude: self.attitude.examine(&law.linear(self.period_s, false))?,
            unit_step: self.unit_step(&position),
        })
    }

    /// Judges what was found about a law.
    ///
    /// # Errors
    /// The first figure that breaks a limit of the policy.
    pub fn judge(&self, findings: &Findings) -> Result<(), GainsError> {
        self.policy.judge("position", &findings.position.margins)?;
        self.policy.judge("attitude", &findings.attitude.margins)?;
        for (i, (output, share)) in OUTPUT_NAMES.into_iter().zip(findings.unit_step).enumerate() {
            if share.is_nan() || share > self.policy.unit_step_max {
                let unit = if i == 3 { "rad" } else { "m" };
                let limit = self.policy.unit_step_max;
                return Err(GainsError::Saturation { output, unit, share, limit, policy: self.policy.name });
            }
        }
        Ok(())
    }

    /// Checks, solves, examines, judges and hashes `design`.
    ///
    /// Pure, allocates, and takes milliseconds: never on the flight thread.
    ///
    /// # Errors
    /// [`GainsError`] with the offending value.
    pub fn certify(&self, design: &Design, revision: GainsRevision) -> Result<Certified, GainsError> {
        let law = self.solve(design)?;
        let findings = self.examine(&law)?;
        self.judge(&findings)?;
        let mut hash = Sha256::new();
        law.each_value(|value| hash.update(value.to_le_bytes()));
        Ok(Certified {
            revision,
            period_s: self.period_s,
            design: design.clone(),
            law,
            margins: worse(&findings.position.margins, &findings.attitude.margins),
            policy: self.policy,
            sha256: hash.finalize().into(),
        })
    }

    /// Largest share of the room between hover and the nearer end of a rotor's range, for each output.
    fn unit_step(&self, law: &StateSpace) -> [f64; 4] {
        let hover = self.airframe.weight_n() / crate::types::ROTORS as f64;
        let room = (self.airframe.max_rotor_thrust_n() - hover).min(hover).max(f64::MIN_POSITIVE);
        let Some(inverse) = self.airframe.allocation().try_inverse() else { return [f64::INFINITY; 4] };
        INTEGRALS.map(|output| {
            let asked = Vector4::from_fn(|row, _| law.d[(row, output)]);
            (inverse * asked).amax() / room
        })
    }
}

/// Certifies one design for `airframe` at ticks of `period_s`, by the standard policy.
///
/// # Errors
/// [`GainsError`] with the offending value.
pub fn certify(
    airframe: &Airframe,
    period_s: f64,
    design: &Design,
    revision: GainsRevision,
) -> Result<Certified, GainsError> {
    Examiner::new(airframe, period_s, MarginPolicy::default())?.certify(design, revision)
}

/// Each figure from the loop where it is worse.
fn worse(a: &Margins, b: &Margins) -> Margins {
    let mut out = *a;
    for (out, other) in out.loops.iter_mut().zip(&b.loops) {
        out.gain_up = out.gain_up.min(other.gain_up);
        out.gain_down = out.gain_down.max(other.gain_down);
        if other.phase_rad < out.phase_rad {
            (out.phase_rad, out.crossover_radps) = (other.phase_rad, other.crossover_radps);
        }
        out.delay_s = out.delay_s.min(other.delay_s);
        out.peak_sensitivity = out.peak_sensitivity.max(other.peak_sensitivity);
    }
    out.peak_sensitivity = out.peak_sensitivity.max(b.peak_sensitivity);
    out.slowest_pole_per_s = out.slowest_pole_per_s.max(b.slowest_pole_per_s);
    out
}

impl Certified {
    /// Largest ‖K − K of `other`‖ / ‖K of `other`‖ over the rows, with the horizontal loop closed and without it, and which
    /// row it is; `None` between laws of different kinds, or laws without K.
    pub fn change_from(&self, other: &Self) -> Option<(&'static str, f64)> {
        let ([new, new_attitude], [old, old_attitude]) = (self.law.gains()?, other.law.gains()?);
        if self.law.kind() != other.law.kind() {
            return None;
        }
        let (closed, open) = (change(new, old), change(new_attitude, old_attitude));
        Some(if open.1 > closed.1 { open } else { closed })
    }

    /// Name of the controller.
    pub fn controller(&self) -> &'static str {
        kind_name(self.law.kind())
    }
}

/// Largest ‖K − K of `other`‖ / ‖K of `other`‖ over the rows, and which row it is.
pub fn change(new: &Gain, old: &Gain) -> (&'static str, f64) {
    let mut worst = (INPUT_NAMES[0], 0.0);
    for (row, name) in INPUT_NAMES.into_iter().enumerate() {
        let change = (new.row(row) - old.row(row)).norm() / old.row(row).norm().max(1e-12);
        if change > worst.1 {
            worst = (name, change);
        }
    }
    worst
}

/// Checks the entries of a K.
pub(super) fn check_k(k: &Gain) -> Result<(), GainsError> {
    for row in 0..4 {
        for column in 0..16 {
            let value = k[(row, column)];
            if value.is_nan() || value.abs() > K_MAX {
                return Err(GainsError::Entry { row, column, value });
            }
        }
    }
    Ok(())
}

/// Checks every weight.
pub(super) fn check_weights(weights: &Weights) -> Result<(), GainsError> {
    for (index, (&value, name)) in weights.state.iter().zip(STATE_NAMES).enumerate() {
        if !(0.0..=WEIGHT_MAX).contains(&value) {
            return Err(GainsError::Weight { which: "state", index, name, value, expected: "0 to 1e12" });
        }
    }
    for (index, (&value, name)) in weights.input.iter().zip(INPUT_NAMES).enumerate() {
        if !(INPUT_WEIGHT_MIN..=WEIGHT_MAX).contains(&value) {
            return Err(GainsError::Weight { which: "input", index, name, value, expected: "1e-9 to 1e12" });
        }
    }
    Ok(())
}

/// K with the horizontal loop closed, and K designed without x and y (those columns are zero).
///
/// # Errors
/// When the Riccati equation has no stabilising solution.
pub fn lqr_gains(airframe: &Airframe, period_s: f64, weights: &Weights) -> Result<[Gain; 2], GainsError> {
    // An integral without weight is left out: no integral action there.
    let everything: Vec<usize> = (0..16).filter(|&i| i < 12 || weights.state[i] > 0.0).collect();
    // Without x and y: their states, velocities and integrals.
    let attitude: Vec<usize> =
        everything.iter().copied().filter(|i| ![ix::X, ix::Y, ix::VX, ix::VY, 12, 13].contains(i)).collect();
    Ok([lqr(airframe, period_s, weights, &everything)?, lqr(airframe, period_s, weights, &attitude)?])
}

/// K over the states `kept`, others zero.
fn lqr(airframe: &Airframe, period_s: f64, weights: &Weights, kept: &[usize]) -> Result<Gain, GainsError> {
    let linear = hover(airframe);
    let mut a = DMatrix::zeros(16, 16);
    let mut b = DMatrix::zeros(16, 4);
    a.view_mut((0, 0), (12, 12)).copy_from(&linear.a);
    b.view_mut((0, 0), (12, 4)).copy_from(&linear.b);
    // [Paternain] VI-B: XI' = [x, y, z, yaw], of the tracking error (ERRATA 8).
    for (i, &state) in INTEGRALS.iter().enumerate() {
        a[(12 + i, state)] = 1.0;
    }
    let n = kept.len();
    let a = DMatrix::from_fn(n, n, |r, c| a[(kept[r], kept[c])]);
    let b = DMatrix::from_fn(n, 4, |r, c| b[(kept[r], c)]);
    let q = DMatrix::from_fn(n, n, |r, c| if r == c { weights.state[kept[r]] } else { 0.0 });
    let r = DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&weights.input));
    let (plant, cost) = sampled_cost(&a, &b, &q, &r, period_s)?;
    // The cross term is eliminated: A − B R⁻¹Nᵀ, Q − N R⁻¹Nᵀ, and K = K' + R⁻¹Nᵀ.
    let shift = cost
        .r
        .clone()
        .lu()
        .solve(&cost.n.transpose())
        .ok_or(LinalgError::Singular { what: "sampled input weight", condition: f64::INFINITY })?;
    let q = &cost.q - &cost.n * &shift;
    let solution = dare(&(&plant.a - &plant.b * &shift), &plant.b, &((&q + q.transpose()) * 0.5), &cost.r)?;
    let k = solution.k + shift;
    let mut full = Gain::zeros();
    for (column, &state) in kept.iter().enumerate() {
        full.set_column(state, &k.column(column));
    }
    Ok(full)
}

#[cfg(test)]
mod tests {
    use super::super::tuning::KINDS;
    use super::*;

    #[test]
    fn defaults_of_every_airframe_are_certified_at_every_tick_rate() {
        for name in Airframe::NAMES {
            let airframe = Airframe::by_name(name).unwrap();
            for rate in [50.0, 100.0, 200.0, 500.0, 1000.0] {
                let examiner = Examiner::new(&airframe, 1.0 / rate, MarginPolicy::default()).unwrap();
                for kind in KINDS {
                    let design = Design::new(kind, &airframe);
                    let found = examiner.examine(&examiner.solve(&design).unwrap()).unwrap();
                    println!("{name} {kind:?} {rate} Hz: steps {:.1?}", found.unit_step);
                    for l in found.position.margins.loops.iter().chain(&found.attitude.margins.loops) {
                        println!(
                            "   up {:6.2} down {:.2} phase {:5.1} delay {:5.1} ms at {:5.2} peak {:.2}",
                            l.gain_up,
                            l.gain_down,
                            l.phase_rad.to_degrees(),
                            1e3 * l.delay_s,
                            l.crossover_radps,
                            l.peak_sensitivity
                        );
                    }
                    let certified = examiner.certify(&design, GainsRevision(0));
                    // Slow motors and slow ticks leave too little of the phase: refused, with the number.
                    if rate < 100.0 && name != "iris" {
                        if let Err(error) = certified {
                            assert!(error.to_string().contains("policy standard"), "{error}");
                        }
                        continue;
                    }
                    let certified = certified.unwrap_or_else(|e| panic!("{name} {kind:?} {rate} Hz: {e}"));
                    assert!(certified.margins.slowest_pole_per_s < -0.03, "{:?}", certified.margins);
                }
            }
        }
    }

    #[test]
    fn bad_weights_are_refused_with_their_values() {
        let airframe = Airframe::iris();
        let examiner = Examiner::new(&airframe, 0.005, MarginPolicy::default()).unwrap();
        let good = Weights::for_airframe(&airframe);
        let refuse = |spoil: &dyn Fn(&mut Weights)| {
            let mut weights = good;
            spoil(&mut weights);
            examiner.certify(&Design::from_weights(weights), GainsRevision(1)).unwrap_err().to_string()
        };
        assert_eq!(refuse(&|w| w.state[2] = f64::NAN), "state weight 2 (z) is NaN: it must be 0 to 1e12");
        assert_eq!(refuse(&|w| w.input[0] = 0.0), "input weight 0 (thrust) is 0: it must be 1e-9 to 1e12");
        assert!(refuse(&|w| w.state[6] = -1.0).contains("state weight 6 (roll) is -1"));
        // No weight on z at all: nothing brings it back.
        let lost = refuse(&|w| (w.state[2], w.state[14]) = (0.0, 0.0));
        assert!(lost.starts_with("no gains: DARE") || lost.contains("must decay at"), "{lost}");
        // So eager that the motors' lag makes the loop unstable.
        let eager = refuse(&|w| w.input = w.input.map(|v| v * 1e-6));
        assert!(eager.contains("motor lag"), "{eager}");
    }

    #[test]
    fn k_given_outright_gets_the_same_examination() {
        let airframe = Airframe::iris();
        let examiner = Examiner::new(&airframe, 0.005, MarginPolicy::default()).unwrap();
        let solved = lqr_gains(&airframe, 0.005, &Weights::for_airframe(&airframe)).unwrap();
        let push = |k: [Gain; 2]| {
            let design = Design { k: Some(k), ..Design::new(ControllerKind::LqrIntegral, &airframe) };
            examiner.certify(&design, GainsRevision(1))
        };
        let same = push(solved).unwrap();
        let by_weights = examiner.certify(&Design::new(ControllerKind::LqrIntegral, &airframe), GainsRevision(1));
        assert_eq!(same.sha256, by_weights.unwrap().sha256);
        // The wrong sign, a loop turned up, an entry that is no number, a controller that is not K.
        assert!(push(solved.map(|k| -k)).unwrap_err().to_string().contains("grows at"));
        let loud = push(solved.map(|k| k * 20.0)).unwrap_err().to_string();
        assert!(loud.contains("margin") || loud.contains("sensitivity") || loud.contains("grows at"), "{loud}");
        let mut nan = solved;
        nan[1][(2, 7)] = f64::NAN;
        assert_eq!(push(nan).unwrap_err().to_string(), "K[2, 7] is NaN: it must be within ±1e6");
        let pid = Design { k: Some(solved), ..Design::new(ControllerKind::Pid, &airframe) };
        assert!(examiner.certify(&pid, GainsRevision(1)).unwrap_err().to_string().contains("pid is not given by K"));
    }

    #[test]
    fn too_little_margin_is_refused_by_the_policy_that_asks_for_more() {
        let airframe = Airframe::iris();
        let mut policy = MarginPolicy::CAREFUL;
        policy.phase_min_rad = 1.2;
        let examiner = Examiner::new(&airframe, 0.005, policy).unwrap();
        let error = examiner.certify(&Design::new(ControllerKind::LqrIntegral, &airframe), GainsRevision(1));
        let error = error.unwrap_err().to_string();
        assert!(error.contains("phase margin of") && error.contains("at least 68.75° (policy careful)"), "{error}");
    }

    #[test]
    fn an_integral_without_weight_is_off() {
        let airframe = Airframe::iris();
        let mut weights = Weights::for_airframe(&airframe);
        weights.state[14] = 0.0;
        let certified = certify(&airframe, 0.005, &Design::from_weights(weights), GainsRevision(1)).unwrap();
        let [k, _] = certified.law.gains().unwrap();
        assert!(k.column(14).amax() == 0.0 && k.column(15).amax() > 0.0);
        assert!(certified.margins.slowest_pole_per_s < -0.1);
    }

    #[test]
    fn the_hash_is_of_the_gains_and_changes_are_measured() {
        let airframe = Airframe::iris();
        let weights = Weights::for_airframe(&airframe);
        let by = |weights, n| certify(&airframe, 0.005, &Design::from_weights(weights), GainsRevision(n)).unwrap();
        let (a, again) = (by(weights, 0), by(weights, 3));
        assert_eq!(a.sha256, again.sha256);
        // Anybody can compute it from the two matrices as they go over the wire.
        let mut hash = Sha256::new();
        for k in a.law.gains().unwrap() {
            for row in 0..4 {
                (0..16).for_each(|column| hash.update(k[(row, column)].to_le_bytes()));
            }
        }
        assert_eq!(a.sha256, <[u8; 32]>::from(hash.finalize()));
        let mut more = weights;
        more.state[2] *= 4.0;
        let b = by(more, 1);
        assert_ne!(a.sha256, b.sha256);
        let (row, change) = b.change_from(&a).unwrap();
        assert!(row == "thrust" && change > 0.1 && change < 1.0, "{row} {change}");
        assert_eq!(a.change_from(&again).unwrap().1, 0.0);
        // Without a horizontal position the second matrix flies.
        let ([k, k_attitude], mut other) = (a.law.gains().unwrap(), a.clone());
        other.law = Law::StateFeedback(LqrIntegral::new(&airframe, *k, 3.0 * k_attitude));
        let (_, change) = other.change_from(&a).unwrap();
        assert!((change - 2.0).abs() < 1e-9, "{change}");
        // The law examined is the law flown.
        let pid = certify(&airframe, 0.005, &Design::new(ControllerKind::Pid, &airframe), GainsRevision(2)).unwrap();
        assert!(pid.change_from(&a).is_none());
    }
}
