//! The same programs as Clarabel cones: reference, audit of the flying solution, and the naive form.
//!
//! minimise Σ tᵢ with (tᵢ, bᵢ − Rᵢ x, cᵢ) in a second-order cone per term. Compressed problems keep
//! their matrices; only the right-hand side changes from window to window (`update_b`, which needs
//! presolve off and zeros kept).

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::SVector;

use super::compress::Compressed;
use super::{Decoded, SecureError, Status};

/// A prebuilt Clarabel problem.
pub struct Conic<const N: usize> {
    solver: DefaultSolver<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    rhs: Vec<f64>,
    ranks: Vec<usize>,
}

impl<const N: usize> Conic<N> {
    /// Builds the cones of `problem`.
    ///
    /// # Errors
    /// [`SecureError::Conic`] when Clarabel refuses the problem.
    pub fn new(problem: &Compressed<N>) -> Result<Self, SecureError> {
        let terms = problem.terms();
        let columns = N + terms;
        let (mut i, mut j, mut v) = (Vec::new(), Vec::new(), Vec::new());
        let mut cones = Vec::with_capacity(terms);
        let mut ranks = Vec::with_capacity(terms);
        let mut row = 0;
        // A z + s = rhs, s in the cone: s = (t, b − R x, c).
        for (index, term) in problem.term_rows().enumerate() {
            i.push(row);
            j.push(N + index);
            v.push(-1.0);
            for (k, values) in term.rows.chunks_exact(term.support.len().max(1)).enumerate() {
                for (column, value) in term.support.iter().zip(values) {
                    i.push(row + 1 + k);
                    j.push(*column);
                    v.push(*value);
                }
            }
            row += term.rank + 2;
            cones.push(SupportedConeT::SecondOrderConeT(term.rank + 2));
            ranks.push(term.rank);
        }
        let a = CscMatrix::new_from_triplets(row, columns, i, j, v);
        let p = CscMatrix::zeros((columns, columns));
        let mut q = vec![0.0; columns];
        q.iter_mut().skip(N).for_each(|v| *v = 1.0);
        let rhs = vec![0.0; row];
        let settings = DefaultSettings {
            verbose: false,
            presolve_enable: false,
            input_sparse_dropzeros: false,
            tol_gap_abs: 1e-10,
            tol_gap_rel: 1e-10,
            tol_feas: 1e-10,
            ..DefaultSettings::default()
        };
        let solver =
            DefaultSolver::new(&p, &q, &a, &rhs, &cones, settings).map_err(|e| SecureError::Conic(e.to_string()))?;
        Ok(Self { solver, b: vec![0.0; problem.rows()], c: vec![0.0; terms], rhs, ranks })
    }

    /// Decodes one window.
    ///
    /// # Errors
    /// A window that is no window, or a solve that ended without a solution.
    pub fn decode(&mut self, problem: &Compressed<N>, window: &[f64]) -> Result<Decoded<N>, SecureError> {
        problem.right_hand_side(window, &mut self.b, &mut self.c)?;
        let mut rhs = self.rhs.iter_mut();
        let mut b = self.b.iter();
        for (rank, c) in self.ranks.iter().zip(&self.c) {
            let mut put = |value| {
                if let Some(slot) = rhs.next() {
                    *slot = value;
                }
            };
            put(0.0);
            for value in b.by_ref().take(*rank) {
                put(*value);
            }
            put(*c);
        }
        self.solver.update_b(&self.rhs).map_err(|e| SecureError::Conic(e.to_string()))?;
        self.solver.solve();
        let solution = &self.solver.solution;
        let status = match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => Status::Solved,
            SolverStatus::MaxIterations => Status::MaxIterations,
            SolverStatus::MaxTime => Status::MaxTime,
            SolverStatus::InsufficientProgress => Status::Stalled,
            other => return Err(SecureError::Conic(format!("{other:?}"))),
        };
        let x = SVector::<f64, N>::from_fn(|i, _| solution.x.get(i).copied().unwrap_or(f64::NAN));
        Ok(Decoded {
            x,
            objective: solution.obj_val,
            lower_bound: solution.obj_val_dual,
            iterations: solution.iterations,
            status,
        })
    }
}
