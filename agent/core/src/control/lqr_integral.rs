//! LQR with integrals of the tracking error (\[Paternain\] VI-B), anti-windup and error limiting
//! (\[Paternain\] VII-B).
//!
//! u = [m g, 0, 0, 0] − K [x − x_ref; ∫e], e = [x, y, z, yaw] − reference (deviation from
//! \[Paternain\] VI-B as ERRATA 8: the integrals are of the tracking error). Position and velocity
//! errors are turned into the heading frame, so that one K serves every yaw (ERRATA \[Umasankar\] 6).
//! Thrust is divided by cos(roll) cos(pitch): the vertical component is what K asks for. The reference's
//! acceleration is fed forward, as thrust and tilt.
//!
//! - Error limiting: position, velocity and yaw errors are limited before they meet K, and the
//!   horizontal loop's torque to what holds `TILT_FROM_POSITION_RAD`.
//! - Anti-windup: an integral is frozen while what the mixer could not give would be asked for
//!   even more, be it by the mixer or because something else holds the vehicle up, and limited to `INTEGRAL_LIMIT`; that of yaw
//!   also while the error is large.
//! - While the horizontal loop is open, gains designed without x and y are used.

use nalgebra::{DMatrix, SVector, Vector2, Vector3};

use super::gains::Gain;
use super::{
    COS_TILT_MIN, Controller, ControllerKind, Loops, SHORTFALL, Setpoint, TILT_FROM_POSITION_RAD, Trim, Wrench,
};
use crate::estimate::Estimate;
use crate::frames::{roll_pitch_yaw, wrap_pi};
use crate::model::airframe::Airframe;
use crate::model::linearize::ix;
use crate::model::state_space::StateSpace;
use crate::types::GRAVITY_MPS2;

/// States that are integrated, in order.
pub const INTEGRALS: [usize; 4] = [ix::X, ix::Y, ix::Z, ix::YAW];
/// Limits of the position errors x, y, z, m.
const POSITION_ERROR_MAX_M: [f64; 3] = [1.0, 1.0, 0.5];
/// Limits of the velocity errors, m/s.
const VELOCITY_ERROR_MAX_MPS: [f64; 3] = [2.0, 2.0, 1.5];
/// Limit of the yaw error, rad.
const YAW_ERROR_MAX_RAD: f64 = 0.5;
/// Larger yaw errors are not integrated, rad: somebody holds the vehicle, or it is turning.
const YAW_INTEGRATED_RAD: f64 = 0.2;
/// Limits of the integrals: m s, m s, m s, rad s.
const INTEGRAL_LIMIT: [f64; 4] = [2.0, 2.0, 1.5, 1.0];

/// Diagonal weights. State order: x y z vx vy vz roll pitch yaw p q r, then the integrals of
/// x y z yaw. Input order: thrust (N), torque x y z (N m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// ≥ 0; 1/(largest acceptable deviation)² by Bryson's rule.
    pub state: [f64; 16],
    /// > 0; 1/(largest acceptable use)².
    pub input: [f64; 4],
}

impl Weights {
    /// Bryson's rule with the deviations below; the largest uses follow from mass and inertia, so
    /// that vehicles of every size get the same bandwidth: 10° of roll or pitch may cost the torque
    /// of a 9 rad/s loop, 20° of yaw that of a 3 rad/s one, 20 cm of altitude the thrust of a
    /// 6 rad/s one. Altitude is that stiff because on the string rig, without a horizontal sensor,
    /// the vehicle drifts until a string pulls with a quarter of its weight.
    pub fn for_airframe(airframe: &Airframe) -> Self {
        const DEVIATION: [f64; 16] = [
            1.0, 1.0, 0.20, // m
            1.2, 1.2, 0.5, // m/s
            0.175, 0.175, 0.35, // rad
            3.0, 3.0, 2.0, // rad/s
            3.0, 3.0, 0.20, 1.50, // m s, rad s
        ];
        let i = airframe.inertia_kgm2;
        let largest_use = [
            airframe.mass_kg * 6.0_f64.powi(2) * DEVIATION[ix::Z],
            i.x * 9.0_f64.powi(2) * DEVIATION[ix::ROLL],
            i.y * 9.0_f64.powi(2) * DEVIATION[ix::PITCH],
            i.z * 3.0_f64.powi(2) * DEVIATION[ix::YAW],
        ];
        Self { state: DEVIATION.map(|d| d.powi(-2)), input: largest_use.map(|u| u.powi(-2)) }
    }
}

/// Everything K is multiplied with in one tick: the horizontal loop's part, and the rest.
struct Errors {
    horizontal: SVector<f64, 16>,
    rest: SVector<f64, 16>,
}

/// The controller.
#[derive(Debug, Clone, PartialEq)]
pub struct LqrIntegral {
    k: Gain,
    k_attitude: Gain,
    weight_n: f64,
    /// ∫e: x and y in the world frame.
    integral: [f64; 4],
    /// What could not be given at the tick before: asked − given; thrust, torque x y z.
    shortfall: [f64; 4],
    /// Taken over where there is no integral to carry it.
    held: Trim,
}

impl LqrIntegral {
    /// With `k`, and `k_attitude` while the horizontal loop is open, for a vehicle of this weight.
    pub fn new(airframe: &Airframe, k: Gain, k_attitude: Gain) -> Self {
        Self {
            k,
            k_attitude,
            weight_n: airframe.weight_n(),
            integral: [0.0; 4],
            shortfall: [0.0; 4],
            held: Trim::default(),
        }
    }

    /// K with the horizontal loop closed, and without it.
    pub fn gains(&self) -> [&Gain; 2] {
        [&self.k, &self.k_attitude]
    }

    /// The law for small errors at ticks of `period_s`. Its states are the integrals that have a gain.
    pub fn linear(&self, period_s: f64, horizontal: bool) -> StateSpace {
        let k = if horizontal { &self.k } else { &self.k_attitude };
        let used: Vec<usize> = (0..4).filter(|&i| k.column(12 + i).amax() > 0.0).collect();
        let n = used.len();
        let summed = DMatrix::from_fn(n, 12, |r, c| if INTEGRALS[used[r]] == c { period_s } else { 0.0 });
        let c = DMatrix::from_fn(4, n, |row, i| -k[(row, 12 + used[i])]);
        // The integral of a tick counts in that tick already.
        let d = DMatrix::from_fn(4, 12, |row, column| -k[(row, column)]) + &c * &summed;
        StateSpace { a: DMatrix::identity(n, n), b: summed, c, d }
    }
}

/// Input on which each integral acts.
const ROWS: [usize; 4] = [ix::TORQUE_Y, ix::TORQUE_X, ix::THRUST, ix::TORQUE_Z];

impl Controller for LqrIntegral {
    fn kind(&self) -> ControllerKind {
        let integral = self.k.columns(12, 4).amax().max(self.k_attitude.columns(12, 4).amax()) > 0.0;
        if integral { ControllerKind::LqrIntegral } else { ControllerKind::Lqr }
    }

    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench {
        let angles = roll_pitch_yaw(&estimate.world_from_body);
        let motion = estimate.motion_or_rest();
        let position = limited(motion.position_enu_m - setpoint.position_enu_m, &POSITION_ERROR_MAX_M);
        let velocity = limited(motion.velocity_enu_mps - setpoint.velocity_enu_mps, &VELOCITY_ERROR_MAX_MPS);
        let yaw = wrap_pi(angles.z - setpoint.roll_pitch_yaw_rad.z).clamp(-YAW_ERROR_MAX_RAD, YAW_ERROR_MAX_RAD);
        let tilt = angles.xy() - setpoint.tilt_rad(loops, angles.z);
        let rates = estimate.body_rates_radps;
        let k = if loops.horizontal { self.k } else { self.k_attitude };
        self.integrate([position.x, position.y, position.z, yaw], &k, loops, dt_s);
        let errors = Errors::new(loops, angles.z, position, velocity, tilt, yaw, rates, &self.integral);
        let mut u = errors.law(&k);
        u[ix::THRUST] += self.held.thrust_n;
        u[ix::TORQUE_Z] += self.held.yaw_torque_nm;
        if loops.horizontal {
            // The tilt that gives the acceleration, in the heading frame.
            let (sin, cos) = angles.z.sin_cos();
            let a = self.held.acceleration_mps2 / GRAVITY_MPS2;
            u[ix::TORQUE_Y] += k[(ix::TORQUE_Y, ix::PITCH)] * (cos * a.x + sin * a.y);
            u[ix::TORQUE_X] -= k[(ix::TORQUE_X, ix::ROLL)] * (cos * a.y - sin * a.x);
        }

        let thrust_n = if loops.altitude {
            let fed = self.weight_n / GRAVITY_MPS2 * setpoint.acceleration_enu_mps2.z;
            (self.weight_n + fed + u[ix::THRUST]) / (angles.x.cos() * angles.y.cos()).max(COS_TILT_MIN)
        } else {
            self.weight_n * setpoint.throttle
        };
        let torque_flu_nm = Vector3::new(u[ix::TORQUE_X], u[ix::TORQUE_Y], u[ix::TORQUE_Z]);
        Wrench { thrust_n: thrust_n.max(0.0), torque_flu_nm }
    }

    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64) {
        let torque = asked.torque_flu_nm - given.torque_flu_nm;
        self.shortfall = [asked.thrust_n - given.thrust_n - support_n, torque.x, torque.y, torque.z];
    }

    fn integrator(&self) -> [f64; 4] {
        self.integral
    }

    fn reset(&mut self) {
        self.integral = [0.0; 4];
        self.shortfall = [0.0; 4];
        self.held = Trim::default();
    }

    fn trim(&self) -> Trim {
        let given = |i: usize| -self.k[(ROWS[i], 12 + i)] * self.integral[i];
        // Torque that an angle answers with K: the tilt it settles at.
        let tilt = |i: usize, angle: usize| {
            let stiffness = self.k[(ROWS[i], angle)];
            if stiffness == 0.0 { 0.0 } else { given(i) / stiffness }
        };
        Trim {
            thrust_n: given(2) + self.held.thrust_n,
            acceleration_mps2: Vector2::new(tilt(0, ix::PITCH), -tilt(1, ix::ROLL)) * GRAVITY_MPS2
                + self.held.acceleration_mps2,
            yaw_torque_nm: given(3) + self.held.yaw_torque_nm,
        }
    }

    fn take_over(&mut self, trim: &Trim) {
        let tilt = trim.acceleration_mps2 / GRAVITY_MPS2;
        let wanted = [
            self.k[(ix::TORQUE_Y, ix::PITCH)] * tilt.x,
            -self.k[(ix::TORQUE_X, ix::ROLL)] * tilt.y,
            trim.thrust_n,
            trim.yaw_torque_nm,
        ];
        self.held = *trim;
        for i in 0..4 {
            let integral = -wanted[i] / self.k[(ROWS[i], 12 + i)];
            self.integral[i] = 0.0;
            if integral.is_finite() {
                self.integral[i] = integral.clamp(-INTEGRAL_LIMIT[i], INTEGRAL_LIMIT[i]);
                match i {
                    0 => self.held.acceleration_mps2.x = 0.0,
                    1 => self.held.acceleration_mps2.y = 0.0,
                    2 => self.held.thrust_n = 0.0,
                    _ => self.held.yaw_torque_nm = 0.0,
                }
            }
        }
    }
}

impl Errors {
    #[expect(clippy::too_many_arguments, reason = "one line of the state each")]
    fn new(
        loops: Loops,
        heading_rad: f64,
        position: Vector3<f64>,
        velocity: Vector3<f64>,
        tilt: Vector2<f64>,
        yaw: f64,
        rates: Vector3<f64>,
        integral: &[f64; 4],
    ) -> Self {
        let (sin, cos) = heading_rad.sin_cos();
        let mut horizontal = SVector::<f64, 16>::zeros();
        if loops.horizontal {
            let integral = Vector2::new(integral[0], integral[1]);
            for (at, v) in [(ix::X, position.xy()), (ix::VX, velocity.xy()), (12, integral)] {
                // Into the heading frame.
                horizontal[at] = cos * v.x + sin * v.y;
                horizontal[at + 1] = cos * v.y - sin * v.x;
            }
        }
        let mut rest = SVector::<f64, 16>::zeros();
        rest.fixed_rows_mut::<2>(ix::ROLL).copy_from(&tilt);
        rest[ix::YAW] = yaw;
        rest.fixed_rows_mut::<3>(ix::P).copy_from(&rates);
        rest[15] = integral[3];
        if loops.altitude {
            rest[ix::Z] = position.z;
            rest[ix::VZ] = velocity.z;
            rest[14] = integral[2];
        }
        Self { horizontal, rest }
    }

    /// u = −K e, the horizontal loop limited to the torque that holds [`TILT_FROM_POSITION_RAD`].
    fn law(&self, k: &Gain) -> SVector<f64, 4> {
        let mut u = -(k * self.rest);
        let horizontal = -(k * self.horizontal);
        for (row, angle) in [(ix::TORQUE_X, ix::ROLL), (ix::TORQUE_Y, ix::PITCH)] {
            let limit = (k[(row, angle)] * TILT_FROM_POSITION_RAD).abs();
            u[row] += horizontal[row].clamp(-limit, limit);
        }
        u
    }
}

impl LqrIntegral {
    fn integrate(&mut self, errors: [f64; 4], k: &Gain, loops: Loops, dt_s: f64) {
        let closed = [loops.horizontal, loops.horizontal, loops.altitude, true];
        // Integrals of z and yaw act on one input each; those of x and y through both tilt torques.
        let input = [None, None, Some(ix::THRUST), Some(ix::TORQUE_Z)];
        let tilt_short = self.shortfall[ix::TORQUE_X].abs().max(self.shortfall[ix::TORQUE_Y].abs()) > SHORTFALL;
        for i in 0..4 {
            if !closed[i] || (INTEGRALS[i] == ix::YAW && errors[i].abs() > YAW_INTEGRATED_RAD) {
                continue;
            }
            let step = errors[i] * dt_s;
            let frozen = match input[i] {
                // −K ∫e: does this step ask for more of what could not be given?
                Some(row) => {
                    let shortfall = self.shortfall[row];
                    let threshold = if row == ix::THRUST { SHORTFALL * self.weight_n } else { SHORTFALL };
                    shortfall.abs() > threshold && -k[(row, 12 + i)] * step * shortfall > 0.0
                }
                None => tilt_short,
            };
            if !frozen && step.is_finite() {
                self.integral[i] = (self.integral[i] + step).clamp(-INTEGRAL_LIMIT[i], INTEGRAL_LIMIT[i]);
            }
        }
    }
}

fn limited(v: Vector3<f64>, limit: &[f64; 3]) -> Vector3<f64> {
    Vector3::new(v.x.clamp(-limit[0], limit[0]), v.y.clamp(-limit[1], limit[1]), v.z.clamp(-limit[2], limit[2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::gains::lqr_gains;
    use crate::estimate::Motion;
    use crate::frames::from_roll_pitch_yaw;

    const FULL: Loops = Loops { horizontal: true, altitude: true };

    fn iris() -> (LqrIntegral, Airframe) {
        let airframe = Airframe::iris();
        let [k, k_attitude] = lqr_gains(&airframe, 0.005, &Weights::for_airframe(&airframe)).unwrap();
        (LqrIntegral::new(&airframe, k, k_attitude), airframe)
    }

    fn at(x: f64, y: f64, yaw: f64) -> Estimate {
        Estimate {
            motion: Some(Motion { position_enu_m: Vector3::new(x, y, 1.0), ..Motion::default() }),
            world_from_body: from_roll_pitch_yaw(&Vector3::new(0.0, 0.0, yaw)),
            ..Estimate::default()
        }
    }

    fn hold(yaw: f64) -> Setpoint {
        Setpoint {
            position_enu_m: Vector3::new(0.0, 0.0, 1.0),
            roll_pitch_yaw_rad: Vector3::new(0.0, 0.0, yaw),
            ..Setpoint::default()
        }
    }

    #[test]
    fn at_the_setpoint_it_carries_the_weight_and_nothing_else() {
        let (mut controller, airframe) = iris();
        let w = controller.control(&at(0.0, 0.0, 0.3), &hold(0.3), FULL, 0.005);
        assert!((w.thrust_n - airframe.weight_n()).abs() < 1e-9 && w.torque_flu_nm.norm() < 1e-9, "{w:?}");
    }

    #[test]
    fn the_response_turns_with_the_heading() {
        // The same error ahead of the nose, whatever the yaw, gives the same pitch torque.
        let ahead = |yaw: f64| {
            let (mut controller, _) = iris();
            controller.control(&at(-0.4 * yaw.cos(), -0.4 * yaw.sin(), yaw), &hold(yaw), FULL, 0.005).torque_flu_nm
        };
        let straight = ahead(0.0);
        assert!(straight.y > 0.01 && straight.x.abs() < 1e-12, "target ahead: pitch (nose down in FLU) {straight}");
        for yaw in [0.5, 2.0, -3.0] {
            assert!((ahead(yaw) - straight).norm() < 1e-9);
        }
    }

    #[test]
    fn integrals_stop_while_the_mixer_cannot_give_more() {
        let (mut controller, _) = iris();
        let mut low = at(0.0, 0.0, 0.0);
        low.motion.as_mut().unwrap().position_enu_m.z = 0.6;
        for _ in 0..200 {
            let asked = controller.control(&low, &hold(0.0), FULL, 0.005);
            let given = Wrench { thrust_n: asked.thrust_n - 1.0, ..asked };
            controller.applied(&asked, &given, 0.0);
        }
        let stuck = controller.integrator()[2];
        assert!(stuck.abs() <= 0.4 * 0.005 + 1e-12, "wound up to {stuck}");
        // Above the setpoint it unwinds even while saturated.
        low.motion.as_mut().unwrap().position_enu_m.z = 1.4;
        controller.control(&low, &hold(0.0), FULL, 0.005);
        assert!(controller.integrator()[2] > stuck);
    }

    #[test]
    fn errors_are_limited_and_open_loops_ignored() {
        let (mut controller, _) = iris();
        let near = controller.control(&at(5.0, 0.0, 0.0), &hold(0.0), FULL, 0.0);
        let far = controller.control(&at(5000.0, 0.0, 0.0), &hold(0.0), FULL, 0.0);
        assert_eq!(near, far);
        let attitude = Loops { horizontal: false, altitude: false };
        let sp = Setpoint { throttle: 0.7, ..hold(0.0) };
        let w = controller.control(&at(9.0, -9.0, 0.0), &sp, attitude, 0.005);
        assert!(w.torque_flu_nm.norm() < 1e-12 && (w.thrust_n / 1.545 / 9.81 - 0.7).abs() < 1e-12);
        assert_eq!(controller.integrator()[0], 0.0);
    }

    #[test]
    fn what_it_learned_is_handed_on_whole() {
        let (mut controller, airframe) = iris();
        controller.integral = [0.2, -0.1, -0.3, 0.1];
        let trim = controller.trim();
        let before = controller.control(&at(0.0, 0.0, 0.7), &hold(0.7), FULL, 0.0);
        let mut weights = Weights::for_airframe(&airframe);
        weights.state[14] *= 3.0;
        weights.state[15] = 0.0;
        weights.input[0] *= 0.7;
        let [k, k_attitude] = lqr_gains(&airframe, 0.005, &weights).unwrap();
        let mut next = LqrIntegral::new(&airframe, k, k_attitude);
        next.take_over(&trim);
        let after = next.control(&at(0.0, 0.0, 0.7), &hold(0.7), FULL, 0.0);
        assert!((after.thrust_n - before.thrust_n).abs() < 1e-9);
        assert!((after.torque_flu_nm.z - before.torque_flu_nm.z).abs() < 1e-9, "without an integral it is held");
        let back = next.trim();
        assert!(
            (back.thrust_n - trim.thrust_n).abs() < 1e-12 && (back.yaw_torque_nm - trim.yaw_torque_nm).abs() < 1e-12
        );
        assert!((back.acceleration_mps2 - trim.acceleration_mps2).norm() < 1e-12);
    }
}
