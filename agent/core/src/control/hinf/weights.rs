//! First-order weights and the generalised plant of a mixed-sensitivity problem.
//!
//! min ‖[W_S S; W_K K S]‖∞ (\[Strategies\]), S = (I + G K)⁻¹. Deviations from \[Strategies\], whose problem as
//! printed is ill-posed because the plant's poles at zero are on the axis (ERRATA 6, 7): a small disturbance
//! ε d enters at the plant's input, and the weights that fly have a floor 1/M_S.
//!
//! | symbol | meaning |
//! |---|---|
//! | w = [d; r] | disturbance at the plant's input, reference |
//! | z = [W_S e; W_K u] | what is kept small, e = r − y |
//! | v = e | what the controller sees |

use nalgebra::DMatrix;

use crate::model::state_space::StateSpace;

/// ẋ = a x + u, y = c x + d u.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weight {
    /// Pole, 1/s.
    pub a: f64,
    /// Output from the state.
    pub c: f64,
    /// Direct.
    pub d: f64,
}

impl Weight {
    /// W_S = (s/M_S + ω_b)/(s + ω_b A): errors below ω_b are kept small down to A, the peak of S below M_S.
    pub fn performance(bandwidth_radps: f64, peak: f64, floor: f64) -> Self {
        let pole = bandwidth_radps * floor;
        Self { a: -pole, c: bandwidth_radps - pole / peak, d: 1.0 / peak }
    }

    /// W_K = (s/k_h + p/k_u)/(s + p): inputs below k_u at low frequencies and below k_h at high ones.
    pub fn effort(low: f64, high: f64, corner_radps: f64) -> Self {
        Self { a: -corner_radps, c: corner_radps / low - corner_radps / high, d: 1.0 / high }
    }

    /// W_S of \[Strategies\] as printed: (ω_s/M_s)/(s + ω_s).
    pub fn strategies_performance() -> Self {
        const W: f64 = 1e-4;
        const M: f64 = 1e-4;
        Self { a: -W, c: W / M, d: 0.0 }
    }

    /// W_K of \[Strategies\] as printed: (c/M_k)(s + ω_k)/(s + c ω_k).
    pub fn strategies_effort() -> Self {
        const W: f64 = 20.0;
        const M: f64 = 20.0;
        const C: f64 = 1e3;
        Self { a: -C * W, c: C / M * (W - C * W), d: C / M }
    }
}

/// ẋ = A x + B₁ w + B₂ u, z = C₁ x + D₁₁ w + D₁₂ u, v = C₂ x + D₂₁ w.
#[derive(Debug, Clone, PartialEq)]
pub struct Generalised {
    /// States from states.
    pub a: DMatrix<f64>,
    /// States from disturbance and reference.
    pub b1: DMatrix<f64>,
    /// States from the controller.
    pub b2: DMatrix<f64>,
    /// What is kept small, from states.
    pub c1: DMatrix<f64>,
    /// What the controller sees, from states.
    pub c2: DMatrix<f64>,
    /// What is kept small, from disturbance and reference.
    pub d11: DMatrix<f64>,
    /// What is kept small, from the controller.
    pub d12: DMatrix<f64>,
    /// What the controller sees, from disturbance and reference.
    pub d21: DMatrix<f64>,
}

/// The problem of a square `plant` with one performance and one effort weight for each output and input, and
/// disturbances of size `epsilon` at its inputs. States: plant, performance weights, effort weights.
pub fn mixed_sensitivity(plant: &StateSpace, performance: &[Weight], effort: &[Weight], epsilon: f64) -> Generalised {
    let (n, m, p) = (plant.order(), plant.b.ncols(), plant.c.nrows());
    let total = n + p + m;
    let mut g = Generalised {
        a: DMatrix::zeros(total, total),
        b1: DMatrix::zeros(total, m + p),
        b2: DMatrix::zeros(total, m),
        c1: DMatrix::zeros(p + m, total),
        c2: DMatrix::zeros(p, total),
        d11: DMatrix::zeros(p + m, m + p),
        d12: DMatrix::zeros(p + m, m),
        d21: DMatrix::zeros(p, m + p),
    };
    g.a.view_mut((0, 0), (n, n)).copy_from(&plant.a);
    g.b1.view_mut((0, 0), (n, m)).copy_from(&(&plant.b * epsilon));
    g.b2.view_mut((0, 0), (n, m)).copy_from(&plant.b);
    g.c2.view_mut((0, 0), (p, n)).copy_from(&-&plant.c);
    for (i, w) in performance.iter().enumerate().take(p) {
        g.a.view_mut((n + i, 0), (1, n)).copy_from(&-plant.c.row(i));
        g.a[(n + i, n + i)] = w.a;
        g.b1[(n + i, m + i)] = 1.0;
        g.c1.view_mut((i, 0), (1, n)).copy_from(&(-plant.c.row(i) * w.d));
        g.c1[(i, n + i)] = w.c;
        g.d11[(i, m + i)] = w.d;
        g.d21[(i, m + i)] = 1.0;
    }
    for (i, w) in effort.iter().enumerate().take(m) {
        g.a[(n + p + i, n + p + i)] = w.a;
        g.b2[(n + p + i, i)] = 1.0;
        g.c1[(p + i, n + p + i)] = w.c;
        g.d12[(p + i, i)] = w.d;
    }
    g
}

impl Generalised {
    /// From w to z with `controller` closed around it.
    pub fn closed(&self, controller: &StateSpace) -> StateSpace {
        let (n, k) = (self.a.nrows(), controller.order());
        let StateSpace { a: ak, b: bk, c: ck, d: dk } = controller;
        let mut a = DMatrix::zeros(n + k, n + k);
        a.view_mut((0, 0), (n, n)).copy_from(&(&self.a + &self.b2 * dk * &self.c2));
        a.view_mut((0, n), (n, k)).copy_from(&(&self.b2 * ck));
        a.view_mut((n, 0), (k, n)).copy_from(&(bk * &self.c2));
        a.view_mut((n, n), (k, k)).copy_from(ak);
        let mut b = DMatrix::zeros(n + k, self.b1.ncols());
        b.view_mut((0, 0), self.b1.shape()).copy_from(&(&self.b1 + &self.b2 * dk * &self.d21));
        b.view_mut((n, 0), (k, self.b1.ncols())).copy_from(&(bk * &self.d21));
        let mut c = DMatrix::zeros(self.c1.nrows(), n + k);
        c.view_mut((0, 0), self.c1.shape()).copy_from(&(&self.c1 + &self.d12 * dk * &self.c2));
        c.view_mut((0, n), (self.c1.nrows(), k)).copy_from(&(&self.d12 * ck));
        let d = &self.d11 + &self.d12 * dk * &self.d21;
        StateSpace { a, b, c, d }
    }
}
