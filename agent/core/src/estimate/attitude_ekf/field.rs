//! The magnetometer: gate, what a disturbance makes uncertain, and the correction.
//!
//! ```text
//! m' = m − m_b     c = ω × m'     y = R (m' − τ c)     y − h = θ × y − R δm_b − R c δτ − δh + noise
//! ```
//! A field that does not fit is weighed down, and meanwhile hard iron becomes uncertain, and the field too until it has
//! fitted for long: iron on the vehicle ends up in m_b, which turns with it, and another place in h, which does not.
//!
//! Near a magnet that stands, most samples pass the gate and all are a little wrong, the same way for as long as the
//! vehicle stays. Strength and dip of y scatter there, so while they did of late every sample counts for less:
//!
//! ```text
//! s² = (|y| − |h|)² + |h|² (dip y − dip h)²     u = mean of s² / (s² + 3² µT²) over 10 s of motion     weight · (1 − u)²
//! ```
//!
//! Strength and dip of h, once they have fitted in motion, are the reference. While those of y differ from it, h and b
//! are considered and not corrected: a magnet that stands nearby would otherwise become the field within a minute. After
//! two minutes it does, since the reference may have been wrong. A magnet that leaves both nearly as they are is not
//! told from a turn of the vehicle, and a field known from rest alone, at a place of iron, is slow to be given up. (The reference as in Laidig & Seel 2023, section 3.6.)

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::covariance::{Covariance, ErrorState, N, ix};
use super::{DEGREE, State, correct_scalar};
use crate::frames::skew;

/// Magnetometer, one-sigma, µT …
const SIGMA_UT: f64 = 3.2;
/// … correlated over this, s.
const CORRELATION_S: f64 = 1.0;
/// Gate of the Mahalanobis distance d …
const GATE: f64 = 1.75;
/// … whose covariance has this much noise, µT …
const GATE_SIGMA_UT: f64 = 1.5;
/// … beyond which the least weight is this.
const WEIGHT_MIN: f64 = 0.01;
/// A sample at rest counts for so many: lag and scale err in motion only.
const REST_WEIGHT: f64 = 3.0;
/// Scatter of strength and dip that halves what a sample says of the field …
const SCATTER_UT: f64 = 3.0;
/// … as a mean over so much motion, s.
const SCATTER_S: f64 = 10.0;
/// Each second beyond the gate makes hard iron this uncertain, µT …
const HARD_IRON_DISTURBED_UT: f64 = 4.0;
/// … and the field, until it has fitted for long, this …
const FIELD_UNSETTLED_UT: f64 = 6.0;
/// … up to this.
const DISTURBED_MAX_UT: f64 = 40.0;
/// The field has to fit for so long before it is settled, s; each second beyond the gate takes off two.
const SETTLED_S: f64 = 10.0;

/// Strength may differ from that of the reference by this fraction …
const STRENGTH: f64 = 0.08;
/// … and dip by this, rad.
const DIP_RAD: f64 = 8.0 * DEGREE;
/// The reference holds once a settled field has fitted for so long in motion, s …
const KNOWN_S: f64 = 5.0;
/// … fits again after this long, s …
const FITS_AGAIN_S: f64 = 1.0;
/// … and is given up after so long without, s.
const REJECT_S: f64 = 120.0;
/// Time that fits makes up for so many times as much that does not.
const MAKES_UP: f64 = 2.0;

/// The gate.
#[derive(Debug, Clone, Default)]
pub(super) struct Gate {
    /// For how long the field has been within it.
    fitting_s: f64,
    disturbed: bool,
    /// u: 0 where strength and dip are those of h, 1 where they are far from them.
    scatter: f64,
    /// y.
    measured_ut: Vector3<f64>,
    reference: Reference,
}

/// How well the strength and the dip of h are known.
#[derive(Debug, Clone, Default)]
struct Reference {
    /// For how long they have fitted in motion.
    known_s: f64,
    /// For how long since they last did not.
    fits_s: f64,
    /// For how long they have not.
    rejected_s: f64,
}

/// One magnetometer sample, and what it is looked at with.
pub(super) struct Sample<'a> {
    /// m, body frame, µT.
    pub field_ut: &'a Vector3<f64>,
    /// R.
    pub rotation: &'a Matrix3<f64>,
    /// ω, rad/s.
    pub rate: &'a Vector3<f64>,
    /// Does the vehicle move?
    pub moving: bool,
    /// What it stands for, s.
    pub t: f64,
}

impl Gate {
    /// Was the last field beyond it?
    pub fn disturbed(&self) -> bool {
        self.disturbed
    }

    /// The last field in L, lag and hard iron removed, µT.
    pub fn measured_ut(&self) -> &Vector3<f64> {
        &self.measured_ut
    }

    /// Corrects `p` and `x` by a sample.
    pub fn correct(&mut self, p: &mut Covariance, x: &mut ErrorState, state: &State, sample: &Sample) {
        let Sample { rotation, rate, t, .. } = *sample;
        let iron_free = sample.field_ut - state.hard_iron_ut;
        let change = rate.cross(&iron_free);
        let y = rotation * (iron_free - state.lag_s * change);
        let innovation = state.field_ut - y;

        let mut h = SMatrix::<f64, 3, N>::zeros();
        // θ × y = −[y]× θ, and θ_z = 0.
        h.fixed_view_mut::<3, 2>(0, ix::TILT).copy_from(&(-skew(&y)).fixed_columns::<2>(0));
        h.fixed_view_mut::<3, 3>(0, ix::HARD_IRON).copy_from(&-rotation);
        h.fixed_view_mut::<3, 1>(0, ix::LAG).copy_from(&-(rotation * change));
        h.fixed_view_mut::<3, 3>(0, ix::FIELD).copy_from(&-Matrix3::identity());

        let strength_ut = state.field_ut.norm();
        let stronger = y.norm() / strength_ut - 1.0;
        let steeper_rad = dip_rad(&y) - dip_rad(&state.field_ut);
        let scatter = strength_ut.powi(2) * (stronger.powi(2) + steeper_rad.powi(2));
        let weight = self.weigh(p, &h, &innovation, t) * self.evenness(scatter, sample);
        self.measured_ut = y;
        let fits = stronger.abs() <= STRENGTH && steeper_rad.abs() <= DIP_RAD;
        let first = if self.holds_field(fits, sample) { ix::HARD_IRON } else { ix::GYRO_BIAS };
        let r = 2.0 * SIGMA_UT.powi(2) * CORRELATION_S / (t * weight);
        for i in 0..3 {
            correct_scalar(p, x, &h.row(i).transpose(), innovation[i], r, first);
        }
    }

    /// (1 − u)², or what rest counts for. `scatter` is s², µT².
    fn evenness(&mut self, scatter: f64, sample: &Sample) -> f64 {
        if sample.moving && scatter.is_finite() {
            let share = scatter / (scatter + SCATTER_UT.powi(2));
            self.scatter += (sample.t / SCATTER_S).min(1.0) * (share - self.scatter);
        }
        (1.0 - self.scatter).powi(2) * if sample.moving { 1.0 } else { REST_WEIGHT }
    }

    /// Is the reference to be held against this sample, which `fits` it or not?
    fn holds_field(&mut self, fits: bool, &Sample { moving, t, .. }: &Sample) -> bool {
        let reference = &mut self.reference;
        if fits && !self.disturbed {
            reference.known_s += if moving { t } else { 0.0 };
        } else if reference.known_s < KNOWN_S {
            reference.known_s = (reference.known_s - MAKES_UP * t).max(0.0);
        }
        if reference.known_s < KNOWN_S || self.fitting_s < SETTLED_S {
            reference.rejected_s = 0.0;
            return false;
        }
        if fits {
            reference.fits_s += t;
            reference.rejected_s = (reference.rejected_s - MAKES_UP * t).max(0.0);
        } else {
            reference.fits_s = 0.0;
            reference.rejected_s += t;
            if reference.rejected_s > REJECT_S {
                *reference = Reference::default();
                self.fitting_s = 0.0;
                return false;
            }
        }
        reference.fits_s < FITS_AGAIN_S
    }

    /// Weight of a sample of this `innovation`; a disturbed one makes hard iron and field uncertain.
    fn weigh(&mut self, p: &mut Covariance, h: &SMatrix<f64, 3, N>, innovation: &Vector3<f64>, t: f64) -> f64 {
        let s = h * *p * h.transpose() + Matrix3::identity() * GATE_SIGMA_UT.powi(2);
        let distance = s.cholesky().map_or(f64::INFINITY, |s| innovation.dot(&s.solve(innovation)));
        let gate = GATE * GATE;
        self.disturbed = distance > gate;
        if !self.disturbed {
            self.fitting_s += t;
            return 1.0;
        }
        let mut walk = 0.0;
        if self.fitting_s < SETTLED_S {
            self.fitting_s = (self.fitting_s - 2.0 * t).max(0.0);
            walk = FIELD_UNSETTLED_UT;
        }
        for i in 0..3 {
            for (place, walk) in [(ix::HARD_IRON + i, HARD_IRON_DISTURBED_UT), (ix::FIELD + i, walk)] {
                let variance = &mut p[(place, place)];
                *variance = (*variance + t * walk * walk).min(DISTURBED_MAX_UT.powi(2));
            }
        }
        (gate / distance).powi(2).max(WEIGHT_MIN)
    }
}

/// How far the field points down, rad.
fn dip_rad(field: &Vector3<f64>) -> f64 {
    (-field.z).atan2(field.xy().norm())
}
