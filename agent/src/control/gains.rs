//! From weights to certified gains: checked, solved, examined on the sampled plant with the motors'
//! lag and one tick of delay, then hashed. Refused with the reason and the numbers.
//!
//! | symbol | meaning |
//! |---|---|
//! | Q, R | diagonal weights ([`Weights`]) |
//! | K | 4 × 16, u = −K [x; ∫e], for the heading frame |
//! | T | tick period, s |

use nalgebra::{DMatrix, SMatrix};
use plumbline_proto::ids::GainsRevision;
use sha2::{Digest, Sha256};

use crate::event::{Text, text};
use crate::linalg::{LinalgError, dare, eigenvalues};
use crate::model::airframe::Airframe;
use crate::model::discretize::{sampled_cost, zero_order_hold};
use crate::model::linearize::{hover, ix};

use super::lqr_integral::{INTEGRALS, Weights};

/// K: rows thrust (N), torque x y z (N m); columns as [`Weights::state`].
pub type Gain = SMatrix<f64, 4, 16>;

/// Weights outside these make K meaningless in double precision.
const WEIGHT_MAX: f64 = 1e12;
/// Smallest input weight.
const INPUT_WEIGHT_MIN: f64 = 1e-9;
/// The slowest pole of the sampled loop must decay at least this fast, 1/s.
const SLOWEST_POLE_PER_S: f64 = -0.02;
/// Largest ratio ‖K − K in use‖ / ‖K in use‖ of one row accepted while armed.
pub const CHANGE_MAX: f64 = 4.0;

/// Gains that passed every examination.
#[derive(Debug, Clone, PartialEq)]
pub struct Certified {
    /// Number given by the ground; 0 is the set the agent started with.
    pub revision: GainsRevision,
    /// Period of the ticks they were sampled for, s.
    pub period_s: f64,
    /// The weights they come from.
    pub weights: Weights,
    /// With the horizontal loop closed.
    pub k: Gain,
    /// Designed without x and y, for attitude only; those columns are zero.
    pub k_attitude: Gain,
    /// Largest real part of the poles of the sampled loop, motors' lag and one tick of delay
    /// included, as ln|z|/T, 1/s.
    pub slowest_pole_per_s: f64,
    /// SHA-256 of K's values, then those of `k_attitude`, each row-major, little-endian: every number
    /// that the controller multiplies with.
    pub sha256: [u8; 32],
}

/// Why gains are refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GainsError {
    /// A weight is not a usable number.
    #[error("{which} weight {index} ({name}) is {value}: it must be {expected}")]
    Weight {
        /// `state` or `input`.
        which: &'static str,
        /// Position in the list, from 0.
        index: usize,
        /// Which state or input.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// What is accepted.
        expected: &'static str,
    },
    /// The Riccati equation has no usable solution.
    #[error("no gains: {0}")]
    Solve(#[from] LinalgError),
    /// The loop with motors' lag and delay is unstable or too slow.
    #[error(
        "closed loop ({what}, motor lag and one tick of delay included) decays at {pole_per_s:.3} 1/s, must be below {limit} 1/s"
    )]
    Unstable {
        /// `position` or `attitude`.
        what: &'static str,
        /// ln of the spectral radius over the tick period, 1/s.
        pole_per_s: f64,
        /// The limit.
        limit: f64,
    },
    /// Certified for ticks of another length.
    #[error("certified for ticks of {certified_s} s, these are {period_s} s")]
    Period {
        /// What they were sampled for, s.
        certified_s: f64,
        /// Ticks of this flight, s.
        period_s: f64,
    },
    /// Too far from the gains in use to switch in flight.
    #[error("{row} gains change by {change:.1} times those in use, at most {limit} while armed")]
    Jump {
        /// Which row of K.
        row: &'static str,
        /// ‖ΔK‖ / ‖K‖.
        change: f64,
        /// The limit.
        limit: f64,
    },
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

/// What the operator and the log are told of gains that were refused.
pub fn refusal(revision: GainsRevision, error: &GainsError) -> Text {
    text(format_args!("gains {} refused: {error}", revision.0))
}

/// Checks `weights`, solves for `airframe` at `period_s`, examines the loop.
///
/// Pure, allocates, and takes milliseconds: never on the flight thread.
///
/// # Errors
/// [`GainsError`] with the offending value.
pub fn certify(
    airframe: &Airframe,
    period_s: f64,
    weights: &Weights,
    revision: GainsRevision,
) -> Result<Certified, GainsError> {
    check(weights)?;
    // An integral without weight is left out: no integral action there.
    let everything: Vec<usize> = (0..16).filter(|&i| i < 12 || weights.state[i] > 0.0).collect();
    // Without x and y: their states, velocities and integrals.
    let attitude: Vec<usize> =
        everything.iter().copied().filter(|i| ![ix::X, ix::Y, ix::VX, ix::VY, 12, 13].contains(i)).collect();
    let (k, pole) = solve(airframe, period_s, weights, &everything, "position")?;
    let (k_attitude, attitude_pole) = solve(airframe, period_s, weights, &attitude, "attitude")?;
    let mut hash = Sha256::new();
    // The columns of the transpose are the rows.
    for value in k.transpose().iter().chain(k_attitude.transpose().iter()) {
        hash.update(value.to_le_bytes());
    }
    Ok(Certified {
        revision,
        period_s,
        weights: *weights,
        k,
        k_attitude,
        slowest_pole_per_s: pole.max(attitude_pole),
        sha256: hash.finalize().into(),
    })
}

impl Certified {
    /// Largest ‖K − K of `other`‖ / ‖K of `other`‖ over the rows, and which row it is.
    pub fn change_from(&self, other: &Self) -> (&'static str, f64) {
        let mut worst = (INPUT_NAMES[0], 0.0);
        for (row, name) in INPUT_NAMES.into_iter().enumerate() {
            let change = (self.k.row(row) - other.k.row(row)).norm() / other.k.row(row).norm().max(1e-12);
            if change > worst.1 {
                worst = (name, change);
            }
        }
        worst
    }
}

fn check(weights: &Weights) -> Result<(), GainsError> {
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

/// K over the states `kept` (others zero) and the slowest pole of its sampled loop.
fn solve(
    airframe: &Airframe,
    period_s: f64,
    weights: &Weights,
    kept: &[usize],
    what: &'static str,
) -> Result<(Gain, f64), GainsError> {
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
    let pole_per_s = slowest_pole(airframe, period_s, &a, &b, &k)?;
    if pole_per_s.is_nan() || pole_per_s > SLOWEST_POLE_PER_S {
        return Err(GainsError::Unstable { what, pole_per_s, limit: SLOWEST_POLE_PER_S });
    }
    let mut full = Gain::zeros();
    for (column, &state) in kept.iter().enumerate() {
        full.set_column(state, &k.column(column));
    }
    Ok((full, pole_per_s))
}

/// ln(spectral radius)/T of the sampled loop: plant, lag of the motors, one tick of delay.
fn slowest_pole(
    airframe: &Airframe,
    period_s: f64,
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    k: &DMatrix<f64>,
) -> Result<f64, LinalgError> {
    let n = a.nrows();
    let lag = 0.5 * (airframe.motor_rise_time_constant_s + airframe.motor_fall_time_constant_s);
    // x' = A x + B w, w' = (u − w)/lag.
    let mut lagged = DMatrix::zeros(n + 4, n + 4);
    lagged.view_mut((0, 0), (n, n)).copy_from(a);
    lagged.view_mut((0, n), (n, 4)).copy_from(b);
    let mut input = DMatrix::zeros(n + 4, 4);
    for i in 0..4 {
        lagged[(n + i, n + i)] = -1.0 / lag;
        input[(n + i, i)] = 1.0 / lag;
    }
    let plant = zero_order_hold(&lagged, &input, period_s)?;
    // u[k] acts from tick k+1 on: it is a state.
    let mut closed = DMatrix::zeros(n + 8, n + 8);
    closed.view_mut((0, 0), (n + 4, n + 4)).copy_from(&plant.a);
    closed.view_mut((0, n + 4), (n + 4, 4)).copy_from(&plant.b);
    closed.view_mut((n + 4, 0), (4, n)).copy_from(&-k);
    let radius = eigenvalues(&closed)?.iter().map(|z| z.norm()).fold(0.0, f64::max);
    Ok(radius.ln() / period_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_of_every_airframe_are_certified_at_every_tick_rate() {
        for name in Airframe::NAMES {
            let airframe = Airframe::by_name(name).unwrap();
            for rate in [50.0, 100.0, 200.0, 500.0, 1000.0] {
                let certified =
                    certify(&airframe, 1.0 / rate, &Weights::for_airframe(&airframe), GainsRevision(0)).unwrap();
                println!("{name} {rate} Hz: slowest pole {:.3}", certified.slowest_pole_per_s);
                assert!(certified.slowest_pole_per_s < -0.1);
            }
        }
    }

    #[test]
    fn bad_weights_are_refused_with_their_values() {
        let airframe = Airframe::iris();
        let good = Weights::for_airframe(&airframe);
        let refuse = |spoil: &dyn Fn(&mut Weights)| {
            let mut weights = good;
            spoil(&mut weights);
            certify(&airframe, 0.005, &weights, GainsRevision(1)).unwrap_err().to_string()
        };
        assert_eq!(refuse(&|w| w.state[2] = f64::NAN), "state weight 2 (z) is NaN: it must be 0 to 1e12");
        assert_eq!(refuse(&|w| w.input[0] = 0.0), "input weight 0 (thrust) is 0: it must be 1e-9 to 1e12");
        assert!(refuse(&|w| w.state[6] = -1.0).contains("state weight 6 (roll) is -1"));
        // No weight on z at all: nothing brings it back.
        let lost = refuse(&|w| (w.state[2], w.state[14]) = (0.0, 0.0));
        assert!(lost.starts_with("no gains: DARE") || lost.contains("decays at"), "{lost}");
        // So eager that the motors' lag makes the loop unstable.
        let eager = refuse(&|w| w.input = w.input.map(|v| v * 1e-6));
        assert!(eager.contains("motor lag"), "{eager}");
    }

    #[test]
    fn an_integral_without_weight_is_off() {
        let airframe = Airframe::iris();
        let mut weights = Weights::for_airframe(&airframe);
        weights.state[14] = 0.0;
        let certified = certify(&airframe, 0.005, &weights, GainsRevision(1)).unwrap();
        assert!(certified.k.column(14).amax() == 0.0 && certified.k.column(15).amax() > 0.0);
        assert!(certified.slowest_pole_per_s < -0.1);
    }

    #[test]
    fn the_hash_is_of_the_gains_and_changes_are_measured() {
        let airframe = Airframe::iris();
        let weights = Weights::for_airframe(&airframe);
        let a = certify(&airframe, 0.005, &weights, GainsRevision(0)).unwrap();
        let again = certify(&airframe, 0.005, &weights, GainsRevision(3)).unwrap();
        assert_eq!(a.sha256, again.sha256);
        // Anybody can compute it from the two matrices as they go over the wire.
        let mut hash = Sha256::new();
        for k in [&a.k, &a.k_attitude] {
            for row in 0..4 {
                (0..16).for_each(|column| hash.update(k[(row, column)].to_le_bytes()));
            }
        }
        assert_eq!(a.sha256, <[u8; 32]>::from(hash.finalize()));
        let mut more = weights;
        more.state[2] *= 4.0;
        let b = certify(&airframe, 0.005, &more, GainsRevision(1)).unwrap();
        assert_ne!(a.sha256, b.sha256);
        let (row, change) = b.change_from(&a);
        assert!(row == "thrust" && change > 0.1 && change < 1.0, "{row} {change}");
        assert_eq!(a.change_from(&again).1, 0.0);
    }
}
