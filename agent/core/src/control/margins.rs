//! How much a loop forgives: poles, gain, phase and delay margins, peak sensitivity.
//!
//! The loop is the hovering vehicle, sampled, with the motors' lag, the reaction to the rotors' acceleration about
//! yaw and one tick of delay, and a linear law around it. Margins are those of one input's loop with the other loops closed:
//! L_i = 1/S_ii − 1 with S = (I + L)⁻¹ and L = −K P, all at the inputs.
//!
//! | symbol | meaning |
//! |---|---|
//! | P(z) | errors of the 12 states from the 4 inputs asked for |
//! | K(z) | u = K(z) e: thrust minus weight and torque from the 12 states minus their references, heading frame |
//! | L, S | loop and sensitivity at the inputs |
//! | T | tick period, s |
//!
//! The factor of a gain margin, the angle of a phase margin and the time of a delay margin are what
//! brings the loop to the stability limit; crossings are found on a grid of frequencies and then by
//! false position.

use nalgebra::{DMatrix, Matrix4};

use crate::linalg::{self, Complex, LinalgError, eigenvalues};
use crate::model::airframe::Airframe;
use crate::model::discretize::{Sampled, zero_order_hold};
use crate::model::linearize::{hover, ix};
use crate::model::state_space::{StateSpace, resolvent};

/// Lowest frequency looked at, rad/s.
const LOWEST_RADPS: f64 = 0.02;
/// Frequencies of the grid.
const GRID: usize = 240;
/// Steps towards a crossing; eight are usual.
const ROOT_STEPS: usize = 40;
/// Golden-section steps towards a peak, whose height then is good to 1e-8.
const PEAK_STEPS: usize = 18;
/// Inputs.
const INPUTS: usize = 4;

/// Margins of one input's loop with the others closed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopMargins {
    /// The loop is stable up to this factor of its gain; infinite when no factor ends it.
    pub gain_up: f64,
    /// And down to this one; 0 when no factor ends it.
    pub gain_down: f64,
    /// rad; infinite when the loop gain never crosses one.
    pub phase_rad: f64,
    /// On top of the delay that is there, s; infinite when the loop gain never crosses one.
    pub delay_s: f64,
    /// Where the phase margin is, rad/s; 0 when the loop gain never crosses one.
    pub crossover_radps: f64,
    /// Largest |S_ii|.
    pub peak_sensitivity: f64,
}

/// What an examination finds, without the poles: small enough to keep beside the gains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Thrust, torque x, y, z.
    pub loops: [LoopMargins; INPUTS],
    /// Largest singular value of S: N and N m weigh alike.
    pub peak_sensitivity: f64,
    /// Largest real part of the sampled loop's poles as ln|z|/T, 1/s.
    pub slowest_pole_per_s: f64,
}

/// Everything an examination finds.
#[derive(Debug, Clone, PartialEq)]
pub struct Examination {
    /// Margins and slowest pole, lag and delay included.
    pub margins: Margins,
    /// Poles without lag and delay, as ln(z)/T, 1/s: what the law was designed for.
    pub ideal_poles_per_s: Vec<Complex>,
    /// Poles of the sampled loop with lag and delay, in the z plane.
    pub sampled_poles: Vec<Complex>,
}

/// The hovering vehicle as a law meets it at one tick rate.
#[derive(Debug, Clone)]
pub struct Plant {
    period_s: f64,
    /// States of the vehicle that are controlled, as places in [`ix`].
    kept: Vec<usize>,
    ideal: Sampled,
    /// The last four states are the wrench behind the motors' lag.
    lagged: Sampled,
    /// Frequencies and responses of P with the delay.
    grid: Vec<(f64, DMatrix<Complex>)>,
}

impl Plant {
    /// `airframe` hovering, sampled at `period_s`; without x and y when the horizontal loop is open.
    ///
    /// # Errors
    /// When an exponential overflows: an absurd airframe.
    pub fn new(airframe: &Airframe, period_s: f64, horizontal: bool) -> Result<Self, LinalgError> {
        let linear = hover(airframe);
        let open = |state: &usize| horizontal || ![ix::X, ix::Y, ix::VX, ix::VY].contains(state);
        let kept: Vec<usize> = (0..12).filter(open).collect();
        let n = kept.len();
        let a = DMatrix::from_fn(n, n, |r, c| linear.a[(kept[r], kept[c])]);
        let b = DMatrix::from_fn(n, INPUTS, |r, c| linear.b[(kept[r], c)]);
        let ideal = zero_order_hold(&a, &b, period_s)?;
        // x' = A x + B w, w' = (u − w)/lag; yaw has the reaction to the rotors' acceleration as well, w + lead w':
        // without it the gain margin of yaw would be told three times too large.
        let lag = 0.5 * (airframe.motor_rise_time_constant_s + airframe.motor_fall_time_constant_s);
        let mut slow = DMatrix::zeros(n + INPUTS, n + INPUTS);
        slow.view_mut((0, 0), (n, n)).copy_from(&a);
        slow.view_mut((0, n), (n, INPUTS)).copy_from(&b);
        let mut input = DMatrix::zeros(n + INPUTS, INPUTS);
        for i in 0..INPUTS {
            slow[(n + i, n + i)] = -1.0 / lag;
            input[(n + i, i)] = 1.0 / lag;
        }
        let at_once = airframe.yaw_lead_s() / lag;
        for row in 0..n {
            slow[(row, n + ix::TORQUE_Z)] *= 1.0 - at_once;
            input[(row, ix::TORQUE_Z)] = at_once * b[(row, ix::TORQUE_Z)];
        }
        let lagged = zero_order_hold(&slow, &input, period_s)?;
        let mut plant = Self { period_s, kept, ideal, lagged, grid: Vec::new() };
        let highest = std::f64::consts::PI / period_s;
        let ratio = (highest / LOWEST_RADPS).ln();
        for i in 0..GRID {
            let w = LOWEST_RADPS * (ratio * i as f64 / (GRID - 1) as f64).exp();
            plant.grid.push((w, plant.response(w)?));
        }
        Ok(plant)
    }

    /// P at the frequency `w_radps`, the tick of delay included: kept states × 4.
    fn response(&self, w_radps: f64) -> Result<DMatrix<Complex>, LinalgError> {
        let z = Complex::from_polar(1.0, w_radps * self.period_s);
        let full = resolvent(&self.lagged.a, &self.lagged.b, z)?;
        Ok(full.rows(0, self.kept.len()) / z)
    }

    /// Poles and margins with `law` around it.
    ///
    /// # Errors
    /// When an eigenvalue does not converge or the law has a pole on the grid.
    pub fn examine(&self, law: &StateSpace) -> Result<Examination, LinalgError> {
        let law = self.restricted(law);
        let ideal = eigenvalues(&closed_loop(&self.ideal, &law, false))?;
        let sampled_poles = eigenvalues(&closed_loop(&self.lagged, &law, true))?;
        let radius = sampled_poles.iter().map(|z| z.norm()).fold(0.0, f64::max);
        let transfer = |w: f64, response: &DMatrix<Complex>| -> Result<Matrix4<Complex>, LinalgError> {
            let z = Complex::from_polar(1.0, w * self.period_s);
            let k = law.response(z)?;
            Ok(Matrix4::from_fn(|r, c| {
                -k.row(r).iter().zip(response.column(c).iter()).map(|(k, p)| k * p).sum::<Complex>()
            }))
        };
        let grid: Vec<(f64, Matrix4<Complex>)> =
            self.grid.iter().map(|(w, p)| Ok((*w, transfer(*w, p)?))).collect::<Result<_, LinalgError>>()?;
        let at = |w: f64| transfer(w, &self.response(w)?);
        let (loops, peak_sensitivity) = margins(&grid, at)?;
        Ok(Examination {
            margins: Margins { loops, peak_sensitivity, slowest_pole_per_s: radius.ln() / self.period_s },
            // A pole at zero is a delay, not a mode.
            ideal_poles_per_s: ideal.iter().filter(|z| z.norm() > 1e-9).map(|z| z.ln() / self.period_s).collect(),
            sampled_poles,
        })
    }

    /// The law without the columns of states that are not controlled.
    fn restricted(&self, law: &StateSpace) -> StateSpace {
        StateSpace {
            a: law.a.clone(),
            b: law.b.select_columns(&self.kept),
            c: law.c.clone(),
            d: law.d.select_columns(&self.kept),
        }
    }
}

/// The sampled plant with the law around it; `delayed`: what is asked for acts one tick later.
fn closed_loop(plant: &Sampled, law: &StateSpace, delayed: bool) -> DMatrix<f64> {
    let (n, m) = (plant.a.nrows(), law.a.nrows());
    // The law sees the vehicle's states only, which come first.
    let seen = law.d.ncols();
    let extra = if delayed { INPUTS } else { 0 };
    let mut out = DMatrix::zeros(n + m + extra, n + m + extra);
    out.view_mut((0, 0), (n, n)).copy_from(&plant.a);
    out.view_mut((n, 0), (m, seen)).copy_from(&law.b);
    out.view_mut((n, n), (m, m)).copy_from(&law.a);
    if delayed {
        out.view_mut((0, n + m), (n, INPUTS)).copy_from(&plant.b);
        out.view_mut((n + m, 0), (INPUTS, seen)).copy_from(&law.d);
        out.view_mut((n + m, n), (INPUTS, m)).copy_from(&law.c);
    } else {
        let fed = &plant.b * &law.d;
        let mut direct = out.view_mut((0, 0), (n, seen));
        direct += fed;
        out.view_mut((0, n), (n, m)).copy_from(&(&plant.b * &law.c));
    }
    out
}

/// Margins at the inputs of a continuous `plant` with a continuous `controller` (u = K y) around it, and the peak of
/// σ(S); crossings are looked for from 0.01 to 1400 rad/s.
///
/// # Errors
/// When the loop is not 4 × 4, or a pole lies on the imaginary axis where the response is asked for.
pub fn continuous_margins(
    plant: &StateSpace,
    controller: &StateSpace,
) -> Result<([LoopMargins; INPUTS], f64), LinalgError> {
    let at = |w: f64| {
        let s = Complex::new(0.0, w);
        let l = -(controller.response(s)? * plant.response(s)?);
        if l.shape() != (INPUTS, INPUTS) {
            let (rows, columns) = l.shape();
            let (what, expected_rows, expected_columns) = ("loop at the inputs", INPUTS, INPUTS);
            return Err(LinalgError::Shape { what, rows, columns, expected_rows, expected_columns });
        }
        Ok(Matrix4::from_fn(|r, c| l[(r, c)]))
    };
    let grid: Result<Vec<_>, LinalgError> =
        (0..600).map(|i| 0.01 * 1.02_f64.powi(i)).map(|w| Ok((w, at(w)?))).collect();
    margins(&grid?, at)
}

/// Margins of each loop and the peak of σ(S), from L on a `grid` of frequencies and `at` any other.
///
/// # Errors
/// What `at` reports.
pub fn margins(
    grid: &[(f64, Matrix4<Complex>)],
    at: impl Fn(f64) -> Result<Matrix4<Complex>, LinalgError>,
) -> Result<([LoopMargins; INPUTS], f64), LinalgError> {
    let mut loops = [LoopMargins {
        gain_up: f64::INFINITY,
        gain_down: 0.0,
        phase_rad: f64::INFINITY,
        delay_s: f64::INFINITY,
        crossover_radps: 0.0,
        peak_sensitivity: 0.0,
    }; INPUTS];
    let mut sensitivity = Vec::with_capacity(grid.len());
    for (w, l) in grid {
        sensitivity.push((*w, invert(&(l + Matrix4::identity()))?));
    }
    for (i, found) in loops.iter_mut().enumerate() {
        // L_i with the other loops closed.
        let open = |s: &Matrix4<Complex>| Complex::new(1.0, 0.0) / s[(i, i)] - Complex::new(1.0, 0.0);
        let loop_at = |w: f64| Ok::<_, LinalgError>(open(&invert(&(at(w)? + Matrix4::identity()))?));
        for pair in sensitivity.windows(2) {
            let [(w0, s0), (w1, s1)] = pair else { continue };
            let (l0, l1) = (open(s0), open(s1));
            if (l0.norm() - 1.0) * (l1.norm() - 1.0) < 0.0 {
                let w = root(*w0, *w1, |w| Ok(loop_at(w)?.norm() - 1.0))?;
                let l = loop_at(w)?;
                // −L leads the critical point by this angle.
                let phase = (-l).arg();
                if phase.abs() < found.phase_rad.abs() {
                    (found.phase_rad, found.crossover_radps) = (phase.abs(), w);
                }
                found.delay_s = found.delay_s.min(phase.rem_euclid(std::f64::consts::TAU) / w);
            }
            if l0.im * l1.im < 0.0 && (l0.re < 0.0 || l1.re < 0.0) {
                let w = root(*w0, *w1, |w| Ok(loop_at(w)?.im))?;
                let l = loop_at(w)?;
                // A pole between the two frequencies changes the sign as well, far from the axis.
                if l.re < 0.0 && l.im.abs() < 1e-3 * l.re.abs() {
                    let factor = -1.0 / l.re;
                    if factor > 1.0 {
                        found.gain_up = found.gain_up.min(factor);
                    } else {
                        found.gain_down = found.gain_down.max(factor);
                    }
                }
            }
        }
        found.peak_sensitivity =
            peak(&sensitivity, |s| Ok(s[(i, i)].norm()), |w| invert(&(at(w)? + Matrix4::identity())))?;
    }
    let whole = peak(&sensitivity, largest_singular_value, |w| invert(&(at(w)? + Matrix4::identity())))?;
    Ok((loops, whole))
}

fn invert(m: &Matrix4<Complex>) -> Result<Matrix4<Complex>, LinalgError> {
    m.try_inverse().ok_or(LinalgError::Singular { what: "I + L on the frequency axis", condition: f64::INFINITY })
}

/// A root of `f` between `low` and `high`, by false position (Illinois).
fn root(mut low: f64, mut high: f64, f: impl Fn(f64) -> Result<f64, LinalgError>) -> Result<f64, LinalgError> {
    let (mut at_low, mut at_high) = (f(low)?, f(high)?);
    let mut middle = low;
    for _ in 0..ROOT_STEPS {
        middle = (low * at_high - high * at_low) / (at_high - at_low);
        let value = f(middle)?;
        if value.abs() < 1e-12 || (high - low).abs() < 1e-12 * high {
            break;
        }
        if value * at_high < 0.0 {
            (low, at_low) = (high, at_high);
        } else {
            at_low *= 0.5;
        }
        (high, at_high) = (middle, value);
    }
    Ok(middle)
}

/// Largest `size` over the grid, refined around it by golden section.
fn peak<S>(
    grid: &[(f64, S)],
    size: impl Fn(&S) -> Result<f64, LinalgError>,
    at: impl Fn(f64) -> Result<S, LinalgError>,
) -> Result<f64, LinalgError> {
    let mut largest = (0, 0.0);
    for (index, (_, s)) in grid.iter().enumerate() {
        let value = size(s)?;
        if value > largest.1 {
            largest = (index, value);
        }
    }
    let place = |index: usize| grid.get(index).map_or(0.0, |(w, _)| *w);
    let (mut low, mut high) = (place(largest.0.saturating_sub(1)), place((largest.0 + 1).min(grid.len() - 1)));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let mut best = largest.1;
    let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
    let (mut at_a, mut at_b) = (size(&at(a)?)?, size(&at(b)?)?);
    for _ in 0..PEAK_STEPS {
        best = best.max(at_a).max(at_b);
        if at_a > at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - golden * (high - low);
            at_a = size(&at(a)?)?;
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + golden * (high - low);
            at_b = size(&at(b)?)?;
        }
    }
    Ok(best)
}

/// Of S at one frequency.
fn largest_singular_value(s: &Matrix4<Complex>) -> Result<f64, LinalgError> {
    linalg::largest_singular_value(&DMatrix::from_column_slice(4, 4, s.as_slice()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The yaw loop of state feedback alone, L = (P + D s)(1 + t s) e^{−1.5 T s}/(s² (1 + lag s)), on its own grid.
    #[test]
    fn the_rotors_acceleration_is_in_the_yaw_loop() {
        let iris = Airframe::iris();
        let period_s = 0.002;
        let (p, d) = (9.0, 4.5);
        let mut gains = DMatrix::zeros(4, 12);
        // Enough elsewhere for a stable loop.
        for (row, state, k) in [(0, ix::Z, 5.0), (0, ix::VZ, 5.0), (1, ix::ROLL, 1.0), (2, ix::PITCH, 1.0)] {
            gains[(row, state)] = -k;
        }
        for axis in 1..3 {
            gains[(axis, ix::P + axis - 1)] = -0.25;
        }
        (gains[(3, ix::YAW)], gains[(3, ix::R)]) = (-p * iris.inertia_kgm2.z, -d * iris.inertia_kgm2.z);
        let law = StateSpace { a: DMatrix::zeros(0, 0), b: DMatrix::zeros(0, 12), c: DMatrix::zeros(4, 0), d: gains };
        let found = Plant::new(&iris, period_s, false).unwrap().examine(&law).unwrap().margins.loops[3];
        let lag = 0.5 * (iris.motor_rise_time_constant_s + iris.motor_fall_time_constant_s);
        let l = |w: f64| {
            let s = Complex::new(0.0, w);
            (s * d + p) * (s * iris.yaw_lead_s() + 1.0) * (-s * 1.5 * period_s).exp() / (s * s * (s * lag + 1.0))
        };
        let grid: Vec<f64> = (0..40_000).map(|i| 1.0 * 1.0002_f64.powi(i)).collect();
        let up = grid.windows(2).find(|w| l(w[0]).im < 0.0 && l(w[1]).im >= 0.0).map(|w| -1.0 / l(w[0]).re).unwrap();
        let crossing = grid.windows(2).find(|w| l(w[1]).norm() < 1.0).unwrap()[0];
        let phase = (-l(crossing)).arg();
        println!("up {:.2} ({up:.2}), phase {:.3} ({phase:.3})", found.gain_up, found.phase_rad);
        // A hold is not quite a delay of half a tick: 5 % where the gain margin is, which without the lead would be 73.
        assert!((found.gain_up / up - 1.0).abs() < 0.08 && (found.phase_rad - phase).abs() < 0.02);
    }

    /// Phase, gain and delay margins of L(s) = 2/(s(s+1)²) in each channel, from its closed forms.
    #[test]
    fn a_textbook_loop_has_its_textbook_margins() {
        let l = |w: f64| {
            let s = Complex::new(0.0, w);
            Complex::new(0.5, 0.0) / (s * (s + 1.0).powi(2))
        };
        let at = |w: f64| Ok(Matrix4::from_diagonal_element(l(w)));
        let grid: Vec<_> = (0..100).map(|i| 0.01 * 1.08_f64.powi(i)).map(|w| (w, at(w).unwrap())).collect();
        let (loops, whole) = margins(&grid, at).unwrap();
        // Phase −180° at w = 1, |L(1)| = 0.25.
        assert!((loops[0].gain_up - 4.0).abs() < 1e-9 && loops[0].gain_down == 0.0, "{:?}", loops[0]);
        let w = loops[0].crossover_radps;
        assert!((l(w).norm() - 1.0).abs() < 1e-9);
        let phase = std::f64::consts::FRAC_PI_2 - 2.0 * w.atan();
        assert!((loops[0].phase_rad - phase).abs() < 1e-9 && (loops[0].delay_s - phase / w).abs() < 1e-9);
        let brute = (0..200_000).map(|i| 0.01 + 1e-4 * f64::from(i)).map(|w| 1.0 / (l(w) + 1.0).norm());
        let brute = brute.fold(0.0, f64::max);
        assert!((loops[0].peak_sensitivity - brute).abs() < 1e-6 && (whole - brute).abs() < 1e-6);
    }
}
