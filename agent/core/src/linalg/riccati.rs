//! Algebraic Riccati equations, continuous and discrete, by structure-preserving doubling.
//!
//! - CARE: AᵀX + XA − XGX + Q = 0, with G = B R⁻¹ Bᵀ for regulators; G may be indefinite (H∞).
//! - DARE: X = AᵀX(I + GX)⁻¹A + Q, the same G.
//!
//! Source: E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Structure-preserving algorithms for
//! periodic discrete-time algebraic Riccati equations, Int. J. Control 77 (2004), and Chu, Fan,
//! Lin, A structure-preserving doubling algorithm for continuous-time algebraic Riccati equations,
//! Linear Algebra Appl. 396 (2005). The doubling is followed by at most three Newton corrections
//! (a Lyapunov or Stein equation in the closed loop), each kept only when it lowers the residual.
//! Where that is no solution or a regulator's residual is still above 1e-13 (modes hardly controllable, many
//! unstable modes on one input, R over many decades) the doubling is done again in twice the working precision
//! ([`super::wide`]), whose result is right to the last digit of a double.
//! Independent cross-check for the CARE: [`care_by_sign`], the scaled matrix sign function of the
//! Hamiltonian (Roberts 1971, determinantal scaling of Byers 1987).
//!
//! | symbol | meaning |
//! |---|---|
//! | A, B, Q, R | plant and weights |
//! | G, H | doubling iterates; H → X |
//! | γ | parameter of the Cayley transform, 1/s |

mod doubling;
mod newton;
mod sign;
#[cfg(test)]
mod tests;

use nalgebra::{Cholesky, DMatrix};

use self::doubling::{CAYLEY_FACTORS, care_start, cayley_scale, dare_start};
use self::newton::accept;
use super::wide::{self, Wide};
use super::{Complex, LinalgError, check, eigenvalues, symmetric, symmetrised};

pub use self::sign::{care_by_sign, care_indefinite};

/// Regulators with a larger relative residual are solved again in twice the working precision.
const WIDE_ABOVE: f64 = 1e-13;
/// The largest relative residual of a solution that is right to the last digit: what is left is the rounding of X, which
/// a closed loop with large entries multiplies.
const WORST_ROUNDING: f64 = 1e-6;

/// The stabilising solution of a regulator's Riccati equation.
#[derive(Debug, Clone, PartialEq)]
pub struct RiccatiSolution {
    /// X, symmetric.
    pub p: DMatrix<f64>,
    /// u = −K x.
    pub k: DMatrix<f64>,
    /// Eigenvalues of A − BK.
    pub poles: Vec<Complex>,
    /// ‖residual‖ over the sum of the norms of the equation's terms, Frobenius.
    pub residual: f64,
    /// Iterations of the doubling; 0 where it was done in twice the working precision.
    pub iterations: usize,
}

/// Continuous-time regulator: minimises ∫ xᵀQx + uᵀRu, ẋ = Ax + Bu.
///
/// # Errors
/// When shapes do not fit, entries are not finite, Q is not symmetric, R not symmetric positive
/// definite, or there is no stabilising solution.
pub fn care(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<RiccatiSolution, LinalgError> {
    regulator(
        "CARE",
        [a, b, q, r],
        &Regulator {
            start: care_start,
            gain: care_gain,
            wide: care_wide,
            residual: wide::care_residual,
            measure: ("largest real part", |pole| pole.re, 0.0),
        },
    )
}

/// Discrete-time regulator: minimises Σ xᵀQx + uᵀRu, x₊ = Ax + Bu. A may be singular.
///
/// # Errors
/// As [`care`].
pub fn dare(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<RiccatiSolution, LinalgError> {
    regulator(
        "DARE",
        [a, b, q, r],
        &Regulator {
            start: dare_start,
            gain: dare_gain,
            wide: wide::dare,
            residual: wide::dare_residual,
            measure: ("spectral radius", |pole| pole.norm(), 1.0),
        },
    )
}

type Matrix = DMatrix<f64>;
/// Relative residual of X for A, B, Q, R.
type Residual = fn([&Matrix; 4], &Matrix) -> Option<f64>;
/// X, iterations and relative residual from A, G, Q.
type Started = Result<(Matrix, usize, f64), LinalgError>;

/// What differs between continuous and sampled time.
struct Regulator {
    /// Doubling and plain corrections.
    start: fn(&Matrix, &Matrix, &Matrix) -> Started,
    /// K from A, B, R, its factor and X.
    gain: fn(&Matrix, &Matrix, &Matrix, &Factor, &Matrix) -> Option<Matrix>,
    /// X and K from A, B, Q, R in twice the working precision.
    wide: fn([&Matrix; 4]) -> Option<(Wide, Wide)>,
    /// Of what is found.
    residual: Residual,
    /// What is measured of each pole of the closed loop, and which value it must not reach.
    measure: (&'static str, fn(&Complex) -> f64, f64),
}

type Factor = Cholesky<f64, nalgebra::Dyn>;

fn regulator(what: &'static str, data: [&Matrix; 4], how: &Regulator) -> Result<RiccatiSolution, LinalgError> {
    let [a, b, q, r] = data;
    let factor = checked(a, b, r)?;
    let q = symmetric("Q", q, a.nrows())?;
    let data = [a, b, &q, r];
    let g = symmetrised(&(b * factor.solve(&b.transpose())));
    let (name, of_pole, limit) = how.measure;
    let stabilising = |closed: &Matrix| {
        let poles = eigenvalues(closed)?;
        let value = poles.iter().map(of_pole).fold(f64::NEG_INFINITY, f64::max);
        let stable = value < limit;
        if stable { Ok(poles) } else { Err(LinalgError::NotStabilising { what, measure: name, value }) }
    };
    let double = || {
        let (p, iterations, residual) = (how.start)(a, &g, &q)?;
        let (p, residual) = accept(what, (p, residual), iterations)?;
        let singular = LinalgError::Singular { what: "R + B'PB", condition: f64::INFINITY };
        let k = (how.gain)(a, b, r, &factor, &p).ok_or(singular)?;
        let poles = stabilising(&(a - b * &k))?;
        Ok(RiccatiSolution { p, k, poles, residual, iterations })
    };
    let found = double();
    if found.as_ref().is_ok_and(|s| s.residual <= WIDE_ABOVE) {
        return found;
    }
    let wide = || {
        let (p, k) = (how.wide)(data)?;
        // A − BK cancels: rounded at the end only.
        let poles = stabilising(&Wide::new(a).minus(&Wide::new(b).times(&k)).rounded()).ok()?;
        let p = symmetrised(&p.rounded());
        let residual = (how.residual)(data, &p).filter(|residual| *residual <= WORST_ROUNDING)?;
        Some(RiccatiSolution { p, k: k.rounded(), poles, residual, iterations: 0 })
    };
    // What double precision found, or why it did not, where twice the precision finds nothing.
    wide().map_or(found, Ok)
}

/// In twice the working precision, with the first parameter of the Cayley transform that leads anywhere.
fn care_wide(data: [&Matrix; 4]) -> Option<(Wide, Wide)> {
    let [a, b, q, r] = data;
    let scale = cayley_scale(a, b.norm_squared() / r.norm().max(f64::MIN_POSITIVE), q.norm());
    CAYLEY_FACTORS.into_iter().find_map(|factor| wide::care(data, factor * scale))
}

/// R⁻¹BᵀX.
fn care_gain(_: &Matrix, b: &Matrix, _: &Matrix, factor: &Factor, x: &Matrix) -> Option<Matrix> {
    Some(factor.solve(&(b.transpose() * x)))
}

/// (R + BᵀXB)⁻¹BᵀXA.
fn dare_gain(a: &Matrix, b: &Matrix, r: &Matrix, _: &Factor, x: &Matrix) -> Option<Matrix> {
    let bt_x = b.transpose() * x;
    symmetrised(&(r + &bt_x * b)).lu().solve(&(bt_x * a))
}

/// Stabilising solution of AᵀX + XA − XGX + Q = 0, its doublings and relative residual. G and Q
/// are symmetric, possibly indefinite. Whether A − GX is stable is for the caller to check.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or no parameter of the Cayley transform leads
/// to convergence.
pub fn care_general(a: &Matrix, g: &Matrix, q: &Matrix) -> Started {
    general("CARE", a, g, q, care_start)
}

/// Stabilising solution of X = AᵀX(I + GX)⁻¹A + Q, its doublings and relative residual.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or the doubling does not converge.
pub fn dare_general(a: &Matrix, g: &Matrix, q: &Matrix) -> Started {
    general("DARE", a, g, q, dare_start)
}

fn general(
    what: &'static str,
    a: &Matrix,
    g: &Matrix,
    q: &Matrix,
    start: fn(&Matrix, &Matrix, &Matrix) -> Started,
) -> Started {
    let n = a.nrows();
    check("A", a, n, n)?;
    let (x, iterations, residual) = start(a, &symmetric("G", g, n)?, &symmetric("Q", q, n)?)?;
    let (x, residual) = accept(what, (x, residual), iterations)?;
    Ok((x, iterations, residual))
}

/// Checks a regulator's data; the Cholesky factor of R.
fn checked(a: &Matrix, b: &Matrix, r: &Matrix) -> Result<Factor, LinalgError> {
    let n = a.nrows();
    check("A", a, n, n)?;
    check("B", b, n, b.ncols())?;
    let r = symmetric("R", r, b.ncols())?;
    Cholesky::new(r.clone()).ok_or_else(|| LinalgError::NotPositiveDefinite {
        what: "R",
        pivot: r.lu().u().diagonal().iter().copied().fold(f64::INFINITY, f64::min),
    })
}
