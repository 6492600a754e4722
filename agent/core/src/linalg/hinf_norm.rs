//! H∞ norm of a stable system by bisection on the Hamiltonian's imaginary eigenvalues.
//!
//! Source: N. A. Bruinsma, M. Steinbuch, A fast algorithm to compute the H∞-norm of a transfer function
//! matrix, Systems & Control Letters 14 (1990). With R = γ²I − DᵀD:
//! H(γ) = [[A + B R⁻¹DᵀC, B R⁻¹Bᵀ], [−Cᵀ(I + D R⁻¹Dᵀ)C, −(A + B R⁻¹DᵀC)ᵀ]] has imaginary eigenvalues
//! exactly where a singular value of the response equals γ.

use nalgebra::DMatrix;

use super::{Complex, LinalgError, check, eigenvalues, inverse, symmetric_eigen};

/// Levels raised at most; each at least by the tolerance, usually far more.
const MAX_LEVELS: usize = 60;
/// An eigenvalue counts as imaginary when its real part is below this part of its size.
const IMAGINARY: f64 = 1e-7;

/// Largest singular value over all frequencies, to the relative `tolerance`, and a frequency near where it
/// is, rad/s.
///
/// # Errors
/// When shapes do not fit, entries are not finite, or A is not stable.
pub fn hinf_norm(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    d: &DMatrix<f64>,
    tolerance: f64,
) -> Result<(f64, f64), LinalgError> {
    let n = a.nrows();
    check("A", a, n, n)?;
    check("B", b, n, b.ncols())?;
    check("C", c, c.nrows(), n)?;
    check("D", d, c.nrows(), b.ncols())?;
    let poles = eigenvalues(a)?;
    let slowest = poles.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max);
    if slowest >= 0.0 {
        return Err(LinalgError::NotStabilising {
            what: "H-infinity norm",
            measure: "largest real part",
            value: slowest,
        });
    }
    let at = |w: f64| -> Result<f64, LinalgError> {
        let mut m = a.map(|v| Complex::new(-v, 0.0));
        for i in 0..n {
            m[(i, i)] += Complex::new(0.0, w);
        }
        let singular = LinalgError::Singular { what: "jw - A", condition: f64::INFINITY };
        let x = m.lu().solve(&b.map(|v| Complex::new(v, 0.0))).ok_or(singular)?;
        largest_singular_value(&(c.map(|v| Complex::new(v, 0.0)) * x + d.map(|v| Complex::new(v, 0.0))))
    };
    // From below: zero, infinity and the poles' own frequencies.
    let mut best = (largest_singular_value(&d.map(|v| Complex::new(v, 0.0)))?, f64::INFINITY);
    for w in std::iter::once(0.0).chain(poles.iter().flat_map(|p| [p.norm(), p.im.abs()])) {
        let value = at(w)?;
        if value > best.0 {
            best = (value, w);
        }
    }
    for _ in 0..MAX_LEVELS {
        let gamma = best.0 * (1.0 + 2.0 * tolerance);
        if gamma <= 0.0 {
            return Ok(best);
        }
        let mut crossings = crossings(a, b, c, d, gamma)?;
        crossings.sort_by(f64::total_cmp);
        if crossings.is_empty() {
            return Ok((best.0 * (1.0 + tolerance), best.1));
        }
        // The response lies above the level between two crossings: look in the middle, and at the ends.
        let middles =
            crossings.windows(2).map(|pair| 0.5 * (pair.first().unwrap_or(&0.0) + pair.last().unwrap_or(&0.0)));
        let before = best.0;
        for w in middles.chain(crossings.iter().copied()).collect::<Vec<_>>() {
            let value = at(w)?;
            if value > best.0 {
                best = (value, w);
            }
        }
        if best.0 <= before * (1.0 + tolerance) {
            return Ok((best.0.max(before), best.1));
        }
    }
    Err(LinalgError::NotConverged {
        what: "H-infinity norm",
        iterations: MAX_LEVELS,
        change: f64::NAN,
        residual: best.0,
    })
}

/// Frequencies where a singular value of the response equals `gamma`.
fn crossings(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    d: &DMatrix<f64>,
    gamma: f64,
) -> Result<Vec<f64>, LinalgError> {
    let (n, m, p) = (a.nrows(), b.ncols(), c.nrows());
    let r = inverse("gamma^2 - D'D", &(DMatrix::identity(m, m) * (gamma * gamma) - d.transpose() * d))?;
    let top = a + b * &r * d.transpose() * c;
    let mut h = DMatrix::zeros(2 * n, 2 * n);
    h.view_mut((0, 0), (n, n)).copy_from(&top);
    h.view_mut((0, n), (n, n)).copy_from(&(b * &r * b.transpose()));
    let lower = -(c.transpose() * (DMatrix::identity(p, p) + d * &r * d.transpose()) * c);
    h.view_mut((n, 0), (n, n)).copy_from(&lower);
    h.view_mut((n, n), (n, n)).copy_from(&-top.transpose());
    let scale = f64::EPSILON.sqrt() * a.norm().min(1.0);
    let imaginary = |e: &&Complex| e.re.abs() <= IMAGINARY * e.norm().max(scale);
    Ok(eigenvalues(&h)?.iter().filter(imaginary).map(|e| e.im.abs()).collect())
}

/// From the eigenvalues of the smaller of MᴴM and MMᴴ, as the real symmetric matrix of twice the size.
///
/// # Errors
/// When they do not converge.
pub fn largest_singular_value(m: &DMatrix<Complex>) -> Result<f64, LinalgError> {
    let h = if m.nrows() < m.ncols() { m * m.adjoint() } else { m.adjoint() * m };
    let n = h.nrows();
    let real = DMatrix::from_fn(2 * n, 2 * n, |r, c| {
        let v = h[(r % n, c % n)];
        match (r < n, c < n) {
            (true, true) | (false, false) => v.re,
            (true, false) => -v.im,
            (false, true) => v.im,
        }
    });
    Ok(symmetric_eigen("singular values", real)?.eigenvalues.max().max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    #[test]
    fn closed_forms() {
        // 1/(s² + 2ζs + 1): peak 1/(2ζ√(1−ζ²)) at √(1−2ζ²).
        for zeta in [0.01_f64, 0.1, 0.5] {
            let a = dmatrix![0.0, 1.0; -1.0, -2.0 * zeta];
            let (norm, w) = hinf_norm(&a, &dmatrix![0.0; 1.0], &dmatrix![1.0, 0.0], &dmatrix![0.0], 1e-10).unwrap();
            let peak = 1.0 / (2.0 * zeta * (1.0 - zeta * zeta).sqrt());
            assert!((norm / peak - 1.0).abs() < 1e-8, "{zeta}: {norm} {peak}");
            assert!((w - (1.0 - 2.0 * zeta * zeta).sqrt()).abs() < 1e-3);
        }
        // A low pass: the peak is at zero; a high pass: at infinity.
        let (norm, _) = hinf_norm(&dmatrix![-1e-4], &dmatrix![1.0], &dmatrix![1e-4], &dmatrix![0.0], 1e-10).unwrap();
        assert!((norm - 1.0).abs() < 1e-9);
        let (norm, _) = hinf_norm(&dmatrix![-1.0], &dmatrix![1.0], &dmatrix![-1.0], &dmatrix![1.0], 1e-10).unwrap();
        assert!((norm - 1.0).abs() < 1e-9);
        assert!(hinf_norm(&dmatrix![0.1], &dmatrix![1.0], &dmatrix![1.0], &dmatrix![0.0], 1e-8).is_err());
    }
}
