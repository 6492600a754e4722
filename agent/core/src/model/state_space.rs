//! Linear systems by their matrices: ẋ = A x + B u (or x₊), y = C x + D u.

use nalgebra::DMatrix;

use crate::linalg::{Complex, LinalgError, eigenvalues};

/// A, B, C, D of a continuous or sampled system.
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace {
    /// States from states.
    pub a: DMatrix<f64>,
    /// States from inputs.
    pub b: DMatrix<f64>,
    /// Outputs from states.
    pub c: DMatrix<f64>,
    /// Outputs from inputs.
    pub d: DMatrix<f64>,
}

impl StateSpace {
    /// C (s I − A)⁻¹ B + D; s = jω, or z on the unit circle.
    ///
    /// # Errors
    /// When s is a pole.
    pub fn response(&self, s: Complex) -> Result<DMatrix<Complex>, LinalgError> {
        let mut out = self.d.map(real);
        if self.a.nrows() > 0 {
            out += self.c.map(real) * resolvent(&self.a, &self.b, s)?;
        }
        Ok(out)
    }

    /// Number of states.
    pub fn order(&self) -> usize {
        self.a.nrows()
    }

    /// Largest real part of the poles.
    ///
    /// # Errors
    /// When an eigenvalue does not converge.
    pub fn slowest(&self) -> Result<f64, LinalgError> {
        Ok(eigenvalues(&self.a)?.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max))
    }

    /// Side by side, nothing shared: inputs and outputs one after the other.
    pub fn beside(&self, other: &Self) -> Self {
        let join = |p: &DMatrix<f64>, q: &DMatrix<f64>| {
            let mut out = DMatrix::zeros(p.nrows() + q.nrows(), p.ncols() + q.ncols());
            out.view_mut((0, 0), p.shape()).copy_from(p);
            out.view_mut(p.shape(), q.shape()).copy_from(q);
            out
        };
        Self {
            a: join(&self.a, &other.a),
            b: join(&self.b, &other.b),
            c: join(&self.c, &other.c),
            d: join(&self.d, &other.d),
        }
    }
}

/// (sI − A)⁻¹ B, s or z alike.
///
/// # Errors
/// When s is an eigenvalue.
pub fn resolvent(a: &DMatrix<f64>, b: &DMatrix<f64>, s: Complex) -> Result<DMatrix<Complex>, LinalgError> {
    let mut m = a.map(|v| real(-v));
    for i in 0..a.nrows() {
        m[(i, i)] += s;
    }
    let singular = LinalgError::Singular { what: "sI - A", condition: f64::INFINITY };
    m.lu().solve(&b.map(real)).ok_or(singular)
}

fn real(v: f64) -> Complex {
    Complex::new(v, 0.0)
}
