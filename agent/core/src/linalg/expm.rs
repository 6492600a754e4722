//! Matrix exponential by scaling and squaring with the diagonal Padé approximant of degree 13.
//!
//! Source: N. J. Higham, The scaling and squaring method for the matrix exponential revisited,
//! SIAM J. Matrix Anal. Appl. 26 (2005), Algorithm 2.3 (degree 13 only: our matrices are small). Own code, since
//! nalgebra's `exp` unwraps its solve where there is no exponential; what is asked here may come from a user's design.

use nalgebra::DMatrix;

use super::{LinalgError, check, norm_1, symmetrised};

/// Largest 1-norm for which degree 13 reaches double precision (Higham 2005, Table 2.3).
const THETA_13: f64 = 5.371_920_351_148_152;
/// Coefficients b₀…b₁₃ of the approximant.
const B: [f64; 14] = [
    64_764_752_532_480_000.0,
    32_382_376_266_240_000.0,
    7_771_770_303_897_600.0,
    1_187_353_796_428_800.0,
    129_060_195_264_000.0,
    10_559_470_521_600.0,
    670_442_572_800.0,
    33_522_128_640.0,
    1_323_241_920.0,
    40_840_800.0,
    960_960.0,
    16_380.0,
    182.0,
    1.0,
];
/// Squarings at most: a norm above 2⁶⁰ has no meaningful exponential in double precision.
const MAX_SQUARINGS: i32 = 64;

/// exp(A) of a square matrix.
///
/// # Errors
/// When A is not square or not finite, or so large that its exponential overflows.
pub fn expm(a: &DMatrix<f64>) -> Result<DMatrix<f64>, LinalgError> {
    let n = a.nrows();
    check("matrix to exponentiate", a, n, n)?;
    let squarings = (norm_1(a) / THETA_13).log2().ceil().max(0.0) as i32;
    let failed = |residual| LinalgError::NotConverged {
        what: "matrix exponential",
        iterations: squarings as usize,
        change: norm_1(a),
        residual,
    };
    if squarings > MAX_SQUARINGS {
        return Err(failed(f64::INFINITY));
    }
    let a = a * 0.5_f64.powi(squarings);
    let identity = DMatrix::identity(n, n);
    let a2 = &a * &a;
    let a4 = &a2 * &a2;
    let a6 = &a4 * &a2;
    let odd = &a6 * (&a6 * B[13] + &a4 * B[11] + &a2 * B[9]) + &a6 * B[7] + &a4 * B[5] + &a2 * B[3] + &identity * B[1];
    let u = &a * odd;
    let v = &a6 * (&a6 * B[12] + &a4 * B[10] + &a2 * B[8]) + &a6 * B[6] + &a4 * B[4] + &a2 * B[2] + &identity * B[0];
    // (V − U) R = V + U; V − U is well conditioned for norms up to θ₁₃.
    let mut r = (&v - &u).lu().solve(&(v + u)).ok_or(failed(f64::NAN))?;
    for _ in 0..squarings {
        r = &r * &r;
    }
    if r.iter().all(|v| v.is_finite()) { Ok(r) } else { Err(failed(f64::INFINITY)) }
}

/// e^{FT} and ∫₀ᵀ e^{Fᵀs} W e^{Fs} ds for a symmetric W.
///
/// Source: C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
/// Control 23 (1978): exp([[−Fᵀ, W], [0, F]] T) = [[·, Φ12], [0, Φ22]] holds both, Φ22 and Φ22ᵀ Φ12.
///
/// # Errors
/// As [`expm`].
pub fn expm_with_integral(
    f: &DMatrix<f64>,
    w: &DMatrix<f64>,
    t: f64,
) -> Result<(DMatrix<f64>, DMatrix<f64>), LinalgError> {
    let n = f.nrows();
    check("matrix to exponentiate", f, n, n)?;
    check("weight of the integral", w, n, n)?;
    let mut block = DMatrix::zeros(2 * n, 2 * n);
    block.view_mut((0, 0), (n, n)).copy_from(&(-f.transpose()));
    block.view_mut((0, n), (n, n)).copy_from(w);
    block.view_mut((n, n), (n, n)).copy_from(f);
    let e = expm(&(block * t))?;
    let phi = e.view((n, n), (n, n)).into_owned();
    let integral = symmetrised(&(phi.transpose() * e.view((0, n), (n, n))));
    Ok((phi, integral))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_nilpotent_and_stiff_have_closed_forms() {
        let angle = 40.0_f64;
        let rotation = expm(&DMatrix::from_row_slice(2, 2, &[0.0, -angle, angle, 0.0])).unwrap();
        let expected = DMatrix::from_row_slice(2, 2, &[angle.cos(), -angle.sin(), angle.sin(), angle.cos()]);
        assert!((rotation - expected).amax() < 1e-13);

        let chain = DMatrix::from_fn(5, 5, |r, c| if c == r + 1 { 2.0 } else { 0.0 });
        let e = expm(&chain).unwrap();
        let factorial = [1.0, 1.0, 2.0, 6.0, 24.0];
        for (r, c) in (0..5).flat_map(|r| (r..5).map(move |c| (r, c))) {
            let expected = 2.0_f64.powi((c - r) as i32) / factorial[c - r];
            assert!((e[(r, c)] - expected).abs() < 1e-14 * expected, "{r} {c}");
        }

        let stiff = expm(&DMatrix::from_diagonal(&nalgebra::dvector![-1e4, -1.0, 3.0])).unwrap();
        assert!(
            (stiff[(1, 1)] - (-1.0_f64).exp()).abs() < 1e-12 && (stiff[(2, 2)] / 3.0_f64.exp() - 1.0).abs() < 1e-12
        );
    }

    #[test]
    fn refuses_what_has_no_exponential() {
        assert!(matches!(expm(&DMatrix::from_element(2, 2, f64::NAN)), Err(LinalgError::NotFinite { .. })));
        assert!(matches!(expm(&DMatrix::zeros(2, 3)), Err(LinalgError::Shape { .. })));
        assert!(expm(&DMatrix::from_element(2, 2, 1e30)).is_err());
        assert!(expm(&DMatrix::from_element(1, 1, 1e4)).is_err());
    }
}
