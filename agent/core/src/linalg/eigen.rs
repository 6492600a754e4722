//! Eigenvalues of a real matrix with an iteration limit: balancing, Hessenberg form by elimination,
//! then the shifted QR iteration with exceptional shifts.
//!
//! Source: EISPACK balanc, elmhes, hqr (Wilkinson and Reinsch, Handbook for Automatic Computation
//! II). nalgebra's own iteration has no exceptional shifts and never returned on a chain of
//! integrators.

use nalgebra::DMatrix;

use super::{LinalgError, check};

/// A complex number.
pub type Complex = nalgebra::Complex<f64>;

/// QR sweeps allowed for one eigenvalue.
const MAX_SWEEPS: usize = 60;

/// The eigenvalues of a square matrix, in no particular order.
///
/// # Errors
/// When the matrix is not square or not finite, or an eigenvalue does not converge.
pub fn eigenvalues(matrix: &DMatrix<f64>) -> Result<Vec<Complex>, LinalgError> {
    let n = matrix.nrows();
    check("matrix", matrix, n, n)?;
    let mut h = matrix.clone();
    balance(&mut h);
    to_hessenberg(&mut h);
    quasi_triangular(&mut h)
}

/// Scales rows and columns by powers of two until their norms are alike (balanc).
fn balance(a: &mut DMatrix<f64>) {
    let n = a.nrows();
    // Each scaling lowers the norm by 5 % at least; 100 rounds are never reached.
    for _ in 0..100 {
        let mut done = true;
        for i in 0..n {
            let (mut c, mut r) = (0.0, 0.0);
            for j in (0..n).filter(|&j| j != i) {
                c += a[(j, i)].abs();
                r += a[(i, j)].abs();
            }
            if c == 0.0 || r == 0.0 {
                continue;
            }
            let (sum, mut factor) = (c + r, 1.0);
            while c < r / 2.0 {
                factor *= 2.0;
                c *= 4.0;
            }
            while c >= r * 2.0 {
                factor /= 2.0;
                c /= 4.0;
            }
            if (c + r) / factor < 0.95 * sum {
                done = false;
                a.row_mut(i).scale_mut(1.0 / factor);
                a.column_mut(i).scale_mut(factor);
            }
        }
        if done {
            return;
        }
    }
}

/// Similarity to upper Hessenberg form by elimination with pivoting (elmhes).
fn to_hessenberg(a: &mut DMatrix<f64>) {
    let n = a.nrows();
    for m in 1..n.saturating_sub(1) {
        let (mut pivot, mut x) = (m, 0.0_f64);
        for j in m..n {
            if a[(j, m - 1)].abs() > x.abs() {
                (pivot, x) = (j, a[(j, m - 1)]);
            }
        }
        if pivot != m {
            a.swap_rows(pivot, m);
            a.swap_columns(pivot, m);
        }
        if x == 0.0 {
            continue;
        }
        for i in m + 1..n {
            let y = a[(i, m - 1)] / x;
            if y != 0.0 {
                a[(i, m - 1)] = 0.0;
                for j in m..n {
                    a[(i, j)] -= y * a[(m, j)];
                }
                for j in 0..n {
                    a[(j, m)] += y * a[(j, i)];
                }
            }
        }
    }
}

/// Eigenvalues of an upper Hessenberg matrix (hqr); destroys it.
fn quasi_triangular(a: &mut DMatrix<f64>) -> Result<Vec<Complex>, LinalgError> {
    let n = a.nrows();
    let mut out = Vec::with_capacity(n);
    let mut norm = 0.0;
    for i in 0..n {
        for j in i.saturating_sub(1)..n {
            norm += a[(i, j)].abs();
        }
    }
    let small = |value: f64, scale: f64| value.abs() <= f64::EPSILON * if scale == 0.0 { norm } else { scale };
    let mut shift = 0.0;
    let mut sweeps = 0;
    let mut size = n;
    while size > 0 {
        let last = size - 1;
        // Look for a negligible subdiagonal element.
        let mut l = last;
        while l > 0 && !small(a[(l, l - 1)], a[(l - 1, l - 1)].abs() + a[(l, l)].abs()) {
            l -= 1;
        }
        if l > 0 {
            a[(l, l - 1)] = 0.0;
        }
        let x = a[(last, last)];
        if l == last {
            out.push(Complex::new(x + shift, 0.0));
            size -= 1;
            sweeps = 0;
            continue;
        }
        let y = a[(last - 1, last - 1)];
        let w = a[(last, last - 1)] * a[(last - 1, last)];
        if l + 1 == last {
            out.extend(pair(x, y, w).map(|e| e + shift));
            size -= 2;
            sweeps = 0;
            continue;
        }
        if sweeps == MAX_SWEEPS {
            return Err(LinalgError::NotConverged {
                what: "QR iteration for eigenvalues",
                iterations: sweeps,
                change: a[(last, last - 1)].abs() / norm,
                residual: a[(last, last - 1)].abs(),
            });
        }
        let (mut x, mut y, mut w) = (x, y, w);
        if sweeps % 10 == 0 && sweeps > 0 {
            // Exceptional shift.
            shift += x;
            for i in 0..size {
                a[(i, i)] -= x;
            }
            let s = a[(last, last - 1)].abs() + a[(last - 1, last - 2)].abs();
            (x, y) = (0.75 * s, 0.75 * s);
            w = -0.4375 * s * s;
        }
        sweeps += 1;
        double_step(a, l, last, x, y, w);
    }
    Ok(out)
}

/// Eigenvalues of [[y, b], [c, x]] with w = b c.
fn pair(x: f64, y: f64, w: f64) -> [Complex; 2] {
    let p = 0.5 * (y - x);
    let q = p * p + w;
    let root = q.abs().sqrt();
    if q >= 0.0 {
        let z = p + root.copysign(p);
        let second = if z == 0.0 { x } else { x - w / z };
        [Complex::new(x + z, 0.0), Complex::new(second, 0.0)]
    } else {
        [Complex::new(x + p, root), Complex::new(x + p, -root)]
    }
}

/// One double QR step on rows and columns l to last with shifts given by x, y, w.
fn double_step(a: &mut DMatrix<f64>, l: usize, last: usize, x: f64, y: f64, w: f64) {
    let (mut p, mut q, mut r);
    // Two consecutive small subdiagonal elements let the sweep start lower.
    let mut m = last - 2;
    loop {
        let z = a[(m, m)];
        let (rr, ss) = (x - z, y - z);
        p = (rr * ss - w) / a[(m + 1, m)] + a[(m, m + 1)];
        q = a[(m + 1, m + 1)] - z - rr - ss;
        r = a[(m + 2, m + 1)];
        let s = f64::abs(p) + f64::abs(q) + f64::abs(r);
        p /= s;
        q /= s;
        r /= s;
        if m == l {
            break;
        }
        let u = a[(m, m - 1)].abs() * (f64::abs(q) + f64::abs(r));
        let v = f64::abs(p) * (a[(m - 1, m - 1)].abs() + z.abs() + a[(m + 1, m + 1)].abs());
        if u <= f64::EPSILON * v {
            break;
        }
        m -= 1;
    }
    for i in m + 2..=last {
        a[(i, i - 2)] = 0.0;
        if i > m + 2 {
            a[(i, i - 3)] = 0.0;
        }
    }
    for k in m..last {
        let mut x = 0.0;
        if k != m {
            p = a[(k, k - 1)];
            q = a[(k + 1, k - 1)];
            r = if k + 1 < last { a[(k + 2, k - 1)] } else { 0.0 };
            x = p.abs() + q.abs() + r.abs();
            if x == 0.0 {
                continue;
            }
            p /= x;
            q /= x;
            r /= x;
        }
        let s = (p * p + q * q + r * r).sqrt().copysign(p);
        if s == 0.0 {
            continue;
        }
        if k == m {
            if l != m {
                a[(k, k - 1)] = -a[(k, k - 1)];
            }
        } else {
            a[(k, k - 1)] = -s * x;
        }
        p += s;
        let (x, y, z) = (p / s, q / s, r / s);
        q /= p;
        r /= p;
        let three = k + 1 < last;
        for j in k..=last {
            let mut t = a[(k, j)] + q * a[(k + 1, j)];
            if three {
                t += r * a[(k + 2, j)];
                a[(k + 2, j)] -= t * z;
            }
            a[(k + 1, j)] -= t * y;
            a[(k, j)] -= t * x;
        }
        for i in l..=last.min(k + 3) {
            let mut t = x * a[(i, k)] + y * a[(i, k + 1)];
            if three {
                t += z * a[(i, k + 2)];
                a[(i, k + 2)] -= t * r;
            }
            a[(i, k + 1)] -= t * q;
            a[(i, k)] -= t;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    fn sorted(matrix: &DMatrix<f64>) -> Vec<Complex> {
        let mut e = eigenvalues(matrix).unwrap();
        e.sort_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
        e
    }

    #[test]
    fn companion_matrix_of_known_roots() {
        // (s+1)(s+2)(s²+2s+5)(s−3) = s⁵ + 2s⁴ − 2s³ − 16s² − 59s − 30... built by convolution below.
        let factors: [&[f64]; 4] = [&[1.0, 1.0], &[1.0, 2.0], &[1.0, 2.0, 5.0], &[1.0, -3.0]];
        let polynomial = factors.iter().fold(vec![1.0], |poly, factor| {
            let mut out = vec![0.0; poly.len() + factor.len() - 1];
            for (i, a) in poly.iter().enumerate() {
                for (j, b) in factor.iter().enumerate() {
                    out[i + j] += a * b;
                }
            }
            out
        });
        let companion = DMatrix::from_fn(5, 5, |r, c| {
            if r == 0 {
                -polynomial[c + 1]
            } else if r == c + 1 {
                1.0
            } else {
                0.0
            }
        });
        let expected = [(-2.0, 0.0), (-1.0, -2.0), (-1.0, 0.0), (-1.0, 2.0), (3.0, 0.0)];
        for e in expected.map(|(re, im)| Complex::new(re, im)) {
            assert!(sorted(&companion).iter().any(|x| (x - e).norm() < 1e-9), "{e} in {:?}", sorted(&companion));
        }
    }

    #[test]
    fn integrator_chains_and_cyclic_matrices_return() {
        let chain = DMatrix::from_fn(12, 12, |r, c| if c == r + 1 { 1.0 } else { 0.0 });
        assert!(eigenvalues(&chain).unwrap().iter().all(|e| e.norm() == 0.0));
        let chain = chain.transpose();
        assert!(eigenvalues(&chain).unwrap().iter().all(|e| e.norm() == 0.0));
        // A cyclic permutation stalls the iteration without exceptional shifts: roots of unity.
        let cycle = DMatrix::from_fn(6, 6, |r, c| if r == (c + 1) % 6 { 1.0 } else { 0.0 });
        assert!(eigenvalues(&cycle).unwrap().iter().all(|e| (e.norm() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn trace_and_determinant_agree_on_random_matrices() {
        let mut state = 7_u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for n in 1..24 {
            let m = DMatrix::from_fn(n, n, |_, _| random());
            let e = eigenvalues(&m).unwrap();
            let (sum, product) =
                e.iter().fold((Complex::new(0.0, 0.0), Complex::new(1.0, 0.0)), |(s, p), &e| (s + e, p * e));
            assert!((sum.re - m.trace()).abs() < 1e-12 * n as f64 && sum.im.abs() < 1e-12, "trace, n = {n}");
            let det = m.determinant();
            assert!(
                (product.re - det).abs() < 1e-9 * det.abs().max(1e-12),
                "determinant, n = {n}: {} {det}",
                product.re
            );
        }
    }

    #[test]
    fn empty_and_bad_matrices() {
        assert!(eigenvalues(&DMatrix::zeros(0, 0)).unwrap().is_empty());
        assert!(eigenvalues(&dmatrix![1.0, f64::INFINITY; 0.0, 1.0]).is_err());
    }
}
