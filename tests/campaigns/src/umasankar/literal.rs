//! Algorithm 1 as it is printed: to show what the errata say, never to be flown.

use nalgebra::{SMatrix, SVector};
use plumbline_agent::estimate::filter::mocap_recipe::{LOG_RATE_HZ, measurements};
use plumbline_agent::frames::wrap_pi;
use plumbline_agent::model::euler_body::{EulerBody, M, ix};

use super::Plant;
use super::flights::Flown;
use super::score::{Sums, start};

/// Measurements of one instant.
const MEASURED: usize = 7;
/// An estimate this far off is lost, m.
const LOST_M: f64 = 1.0;

/// How line 14 is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Literal {
    /// `+ R`, put into the upper left corner.
    AsPrinted,
    /// `+ K R Kᵀ`, the errata's correction; lines 8 and 11 stay as printed.
    JosephUpdate,
}

impl Literal {
    pub fn name(self) -> &'static str {
        match self {
            Self::AsPrinted => "as_printed",
            Self::JosephUpdate => "line_14_corrected",
        }
    }
}

/// What became of it.
pub struct Outcome {
    /// When it was lost, s.
    pub lost_s: Option<f64>,
    /// σ of x up to then, m.
    pub std_m: Option<f64>,
    pub nees: Option<f64>,
    /// Share of the updates whose P⁻ had a negative eigenvalue.
    pub indefinite_share: f64,
    /// The least of them.
    pub least_eigenvalue: f64,
}

pub fn run(flown: &Flown, plant: Plant, hz: usize, variant: Literal) -> Outcome {
    let body = EulerBody::iris();
    let every = LOG_RATE_HZ / hz;
    let h = 1.0 / LOG_RATE_HZ as f64;
    let dt = every as f64 * h;
    // Q of a continuous white noise.
    let mut q = M::zeros();
    for axis in 0..3 {
        q[(ix::VX + axis, ix::VX + axis)] = plant.accel.powi(2);
        q[(ix::P + axis, ix::P + axis)] = plant.turn.powi(2);
    }
    let (mut x, mut p) = start();
    let mut sums = Sums::default();
    let mut outcome =
        Outcome { lost_s: None, std_m: None, nees: None, indefinite_share: 0.0, least_eigenvalue: f64::INFINITY };
    let (mut updates, mut indefinite) = (0.0, 0.0);
    for (k, pair) in flown.log.windows(2).enumerate() {
        x = body.step(&x, &pair[0].input, h);
        if (k + 1) % every != 0 {
            continue;
        }
        // Lines 7 to 11: A at x̂⁻, one Euler step over the whole interval.
        let a = body.jacobian(&x, &pair[0].input);
        p += (a * p + p * a.transpose() + q) * dt;
        let off = (x - pair[1].truth).fixed_rows::<3>(ix::X).norm();
        let lost = off.is_nan() || off > LOST_M || !p.iter().all(|v| v.is_finite());
        if lost {
            outcome.lost_s = Some(pair[1].time_s);
            break;
        }
        updates += 1.0;
        let least = p.symmetric_eigenvalues().min();
        outcome.least_eigenvalue = outcome.least_eigenvalue.min(least);
        indefinite += f64::from(u8::from(least < 0.0));
        // Lines 10 to 14.
        let rows = measurements(&pair[1]);
        let mut jacobian = SMatrix::<f64, MEASURED, 12>::zeros();
        let mut r = SMatrix::<f64, MEASURED, MEASURED>::zeros();
        let mut innovation = SVector::<f64, MEASURED>::zeros();
        for (i, row) in rows.iter().enumerate() {
            jacobian.set_row(i, &row.jacobian(&x).transpose());
            r[(i, i)] = row.noise.sigma.powi(2);
            innovation[i] = row.difference(row.value, row.predict(&x));
        }
        let s = jacobian * p * jacobian.transpose() + r;
        let Some(inverse) = s.try_inverse() else {
            outcome.lost_s = Some(pair[1].time_s);
            break;
        };
        let gain = p * jacobian.transpose() * inverse;
        x += gain * innovation;
        x[ix::YAW] = wrap_pi(x[ix::YAW]);
        let left = M::identity() - gain * jacobian;
        p = left * p * left.transpose();
        match variant {
            Literal::AsPrinted => {
                let mut corner = p.fixed_view_mut::<MEASURED, MEASURED>(0, 0);
                corner += r;
            }
            Literal::JosephUpdate => p += gain * r * gain.transpose(),
        }
        p = (p + p.transpose()) * 0.5;
        sums.add(&pair[1], &x, &p);
    }
    if updates > 0.0 {
        let errors = sums.errors();
        outcome.std_m = Some(errors.variance_m2[0].max(0.0).sqrt());
        outcome.nees = Some(errors.nees).filter(|v| v.is_finite());
        outcome.indefinite_share = indefinite / updates;
    }
    outcome
}
