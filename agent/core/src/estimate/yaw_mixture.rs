//! Yaw where no magnetometer tells it: a sum of Gaussians over yaw, weighed by how well each explains the
//! position fixes.
//!
//! A vehicle that accelerates shows its yaw: the specific force, levelled, points somewhere in the vehicle's own
//! heading, the fixes say where it went. One Kalman filter cannot be started there, since it linearises about a
//! yaw that may be 180° wrong; eight that start 45° apart can, and those that are wrong explain the fixes worse
//! and worse (after EKFGSF of PX4; D. Alspach, H. Sorenson, "Nonlinear Bayesian estimation using Gaussian sum
//! approximations", 1972). Until they agree their mixture is the estimate: where yaw cannot be seen (a vertical
//! flight) it also matters little.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | p, v | horizontal position and velocity, ENU | m, m/s |
//! | ψ | yaw of the level frame, in which the attitude filter integrates the gyroscope from the start | rad |
//! | b | horizontal error of the levelled force (tilt), in the level frame | m/s² |
//! | T | time constant with which the attitude filter forgets a wrong tilt | s |
//! | a | levelled specific force without gravity, in the level frame | m/s² |
//! | τ | lead of the fixes: y = p + τ v + ½ τ² v̇ | s |
//!
//! ```text
//! ṗ = v     v̇ = R(ψ)(a − b) + n     ḃ = −b/T + n_b     ψ walks
//! ```
//! Deviation from EKFGSF: fixes of position, not only of velocity, and the error b, without which a tilt wrong by
//! 3° (0.5 m/s²) outweighs the accelerations of a quiet flight. An attitude filter that is started in a turn takes
//! the specific force for the vertical and is wrong by up to 30° for its first seconds: b starts as large as that
//! and, like the filter's error, dies away. Each yaw also comes with fixes that lead the IMU
//! by 0, ¼ and ½ s: receivers predict, and logs of two devices have two clocks; half a second at 4 m/s is four
//! times the noise of a fix, and takes the wrong yaw for the right one.

use nalgebra::{Matrix2, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use plumbline_proto::time::FlightTime;

use super::filter::kalman;
use super::vqf::{TAU_ACCEL_S, Vqf, VqfOptions};
use crate::frames::{roll_pitch_yaw, wrap_pi};
use crate::sensor::GnssSample;

/// Yaws that the Gaussians start at, evenly spaced.
const YAWS: usize = 8;
/// Leads of the fixes, s.
const LEADS_S: [f64; 3] = [0.0, 0.25, 0.5];
/// Gaussians.
pub const HYPOTHESES: usize = YAWS * LEADS_S.len();
/// Yaw is known when the mixture's standard deviation is below this, rad (20°).
pub const AGREED_RAD: f64 = 0.35;
/// States of one Gaussian.
const N: usize = 7;
type X = SVector<f64, N>;
type M = SMatrix<f64, N, N>;

/// Places of the states.
mod ix {
    pub const POSITION: usize = 0;
    pub const VELOCITY: usize = 2;
    pub const YAW: usize = 4;
    pub const ERROR: usize = 5;
}

/// Forces are gathered for this long before the Gaussians are moved, s.
const PERIOD_S: f64 = 0.02;
/// Acceleration that nothing explains, (m/s²)²/Hz.
const ACCEL_DENSITY_SQUARED: f64 = 0.1;
/// Walk of ψ: gyroscope bias and scale, rad²/s.
const YAW_WALK: f64 = 1e-5;
/// b where the attitude filter has only just begun, one-sigma, m/s² (18° of tilt), and in the long run (1.5°).
const FIRST_ERROR_SIGMA_MPS2: f64 = 3.0;
const ERROR_SIGMA_MPS2: f64 = 0.25;
/// Speed at start, one-sigma, m/s.
const SPEED_SIGMA_MPS: f64 = 3.0;
/// A fix speaks against a hypothesis no louder than this (squared Mahalanobis distance): one bad fix is not all.
const LOUDEST: f64 = 25.0;
/// So many fixes in a row that no hypothesis explains start the mixture again.
const UNEXPLAINED_MOST: u32 = 4;
/// A fix further than this from every hypothesis (squared Mahalanobis distance, 10σ) is not used.
const WILD: f64 = 100.0;
/// No hypothesis is ever given up beyond this log-weight.
const LEAST_LOG_WEIGHT: f64 = -60.0;

#[derive(Debug, Clone, Copy)]
struct Gaussian {
    x: X,
    p: M,
    lead_s: f64,
    /// Acceleration over the last period, ENU, m/s².
    acceleration_mps2: Vector2<f64>,
    log_weight: f64,
}

/// One horizontal fix, ENU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Position, m, and one-sigma of each axis.
    pub position: (Vector2<f64>, f64),
    /// Velocity, m/s, and one-sigma of each axis, where there is one.
    pub velocity: Option<(Vector2<f64>, f64)>,
}

/// Horizontal state of the mixture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Horizontal {
    /// Position ENU, m.
    pub position_m: Vector2<f64>,
    /// Velocity ENU, m/s.
    pub velocity_mps: Vector2<f64>,
    /// Variances of position, spread of the Gaussians included, m².
    pub position_variance: Vector2<f64>,
    /// Variances of velocity, (m/s)².
    pub velocity_variance: Vector2<f64>,
    /// Yaw of the body, rad.
    pub yaw_rad: f64,
    /// Circular standard deviation of yaw, rad; large while the Gaussians disagree.
    pub yaw_sigma_rad: f64,
}

/// The mixture. See the module.
#[derive(Debug, Clone)]
pub struct YawMixture {
    attitude: Vqf,
    /// How long the attitude filter has run, s.
    levelled_s: f64,
    gaussians: [Gaussian; HYPOTHESES],
    started: bool,
    unexplained: u32,
    elapsed_s: f64,
    /// Gathered since the Gaussians were moved: Δv and Δp of the levelled force, level frame.
    gained_mps: Vector2<f64>,
    moved_m: Vector2<f64>,
}

impl Default for YawMixture {
    fn default() -> Self {
        Self::new()
    }
}

impl YawMixture {
    /// Nothing known.
    pub fn new() -> Self {
        let nothing = Gaussian {
            x: X::zeros(),
            p: M::zeros(),
            lead_s: 0.0,
            acceleration_mps2: Vector2::zeros(),
            log_weight: 0.0,
        };
        Self {
            attitude: Vqf::new(VqfOptions { use_mag: false, ..VqfOptions::default() }),
            levelled_s: 0.0,
            gaussians: [nothing; HYPOTHESES],
            started: false,
            unexplained: 0,
            elapsed_s: 0.0,
            gained_mps: Vector2::zeros(),
            moved_m: Vector2::zeros(),
        }
    }

    /// One IMU sample (rad/s, m/s²), `dt_s` after the one before.
    pub fn push(&mut self, dt_s: f64, gyro_radps: &Vector3<f64>, force_mps2: &Vector3<f64>) {
        self.attitude.push(dt_s, gyro_radps, force_mps2, None);
        self.levelled_s += dt_s;
        if !self.started {
            return;
        }
        let level = self.attitude.world_from_body() * force_mps2;
        let a = level.xy();
        self.moved_m += self.gained_mps * dt_s + a * (0.5 * dt_s * dt_s);
        self.gained_mps += a * dt_s;
        self.elapsed_s += dt_s;
        if self.elapsed_s >= PERIOD_S {
            self.advance();
        }
    }

    /// Moves every Gaussian by what was gathered.
    fn advance(&mut self) {
        let t = self.elapsed_s;
        if t <= 0.0 {
            return;
        }
        // Of b after this time.
        let kept = (-t / TAU_ACCEL_S).exp();
        let mut q = M::zeros();
        for axis in 0..2 {
            let (p, v) = (ix::POSITION + axis, ix::VELOCITY + axis);
            q[(p, p)] = ACCEL_DENSITY_SQUARED * t * t * t / 3.0;
            q[(p, v)] = ACCEL_DENSITY_SQUARED * t * t / 2.0;
            q[(v, p)] = q[(p, v)];
            q[(v, v)] = ACCEL_DENSITY_SQUARED * t;
            q[(ix::ERROR + axis, ix::ERROR + axis)] = ERROR_SIGMA_MPS2 * ERROR_SIGMA_MPS2 * (1.0 - kept * kept);
        }
        q[(ix::YAW, ix::YAW)] = YAW_WALK * t;
        for gaussian in &mut self.gaussians {
            let x = &mut gaussian.x;
            let (sin, cos) = x[ix::YAW].sin_cos();
            let turn = Matrix2::new(cos, -sin, sin, cos);
            // ∂R/∂ψ u = R(ψ + 90°) u.
            let turned = Matrix2::new(-sin, -cos, cos, -sin);
            let b = Vector2::new(x[ix::ERROR], x[ix::ERROR + 1]);
            let (gained, moved) = (self.gained_mps - b * t, self.moved_m - b * (0.5 * t * t));
            let mut phi = M::identity();
            for (start, effect, by_error) in [(ix::VELOCITY, gained, t), (ix::POSITION, moved, 0.5 * t * t)] {
                let by_yaw = turned * effect;
                for i in 0..2 {
                    phi[(start + i, ix::YAW)] = by_yaw[i];
                    for j in 0..2 {
                        phi[(start + i, ix::ERROR + j)] = -turn[(i, j)] * by_error;
                    }
                }
            }
            for axis in 0..2 {
                phi[(ix::POSITION + axis, ix::VELOCITY + axis)] = t;
            }
            let (dv, dp) = (turn * gained, turn * moved);
            gaussian.acceleration_mps2 = dv / t;
            for axis in 0..2 {
                x[ix::POSITION + axis] += x[ix::VELOCITY + axis] * t + dp[axis];
                x[ix::VELOCITY + axis] += dv[axis];
                x[ix::ERROR + axis] *= kept;
                phi[(ix::ERROR + axis, ix::ERROR + axis)] = kept;
            }
            gaussian.p = kalman::predict(&gaussian.p, &phi, &q);
        }
        self.elapsed_s = 0.0;
        self.gained_mps = Vector2::zeros();
        self.moved_m = Vector2::zeros();
    }

    /// One fix: corrects every Gaussian and weighs them anew.
    pub fn fix(&mut self, fix: &Fix) {
        if !fix.position.0.iter().all(|x| x.is_finite()) {
            return;
        }
        if !self.started {
            self.start(fix);
            return;
        }
        self.advance();
        let nearest = self.gaussians.iter().map(|g| g.distance(&fix.position)).fold(f64::INFINITY, f64::min);
        if nearest > WILD {
            // None can explain it: a bad fix, or, when they go on, a start that was one.
            self.unexplained += 1;
            self.started = self.unexplained < UNEXPLAINED_MOST;
            return;
        }
        self.unexplained = 0;
        for gaussian in &mut self.gaussians {
            let mut against = gaussian.correct_position(&fix.position);
            if let Some(velocity) = fix.velocity.filter(|(v, _)| v.iter().all(|x| x.is_finite())) {
                against += gaussian.correct_velocity(&velocity);
            }
            gaussian.log_weight -= 0.5 * against;
        }
        let most = self.gaussians.iter().map(|g| g.log_weight).fold(f64::NEG_INFINITY, f64::max);
        for gaussian in &mut self.gaussians {
            gaussian.log_weight = (gaussian.log_weight - most).max(LEAST_LOG_WEIGHT);
        }
    }

    /// A GNSS sample arrived at `now`, brought forward by its age.
    pub fn take(&mut self, now: FlightTime, sample: &GnssSample, sigma_m: f64, velocity_sigma_mps: f64) {
        let age_s = now.seconds_since(sample.time).clamp(0.0, 1.0);
        let moved = self.horizontal().map_or(Vector2::zeros(), |h| h.velocity_mps * age_s);
        let velocity = sample.velocity_enu_mps.xy();
        let velocity = velocity.iter().all(|v| v.is_finite()).then_some((velocity, velocity_sigma_mps));
        self.fix(&Fix { position: (sample.position_enu_m.xy() + moved, sigma_m), velocity });
    }

    fn start(&mut self, fix: &Fix) {
        let (place, sigma) = fix.position;
        let (velocity, speed_sigma) = fix.velocity.unwrap_or((Vector2::zeros(), SPEED_SIGMA_MPS));
        let spacing = std::f64::consts::TAU / YAWS as f64;
        let error = ERROR_SIGMA_MPS2.hypot(FIRST_ERROR_SIGMA_MPS2 * (-self.levelled_s / TAU_ACCEL_S).exp());
        for (i, gaussian) in self.gaussians.iter_mut().enumerate() {
            let (yaw, lead_s) = (wrap_pi(spacing * (i / LEADS_S.len()) as f64), LEADS_S[i % LEADS_S.len()]);
            let x = [place.x, place.y, velocity.x, velocity.y, yaw, 0.0, 0.0];
            // Uniform over one spacing has the variance spacing²/12; four times that, so that neighbours overlap.
            let yaw_variance = spacing * spacing / 3.0;
            let (p, v, e) = (sigma * sigma, speed_sigma * speed_sigma, error * error);
            *gaussian = Gaussian {
                x: X::from(x),
                p: M::from_diagonal(&X::from([p, p, v, v, yaw_variance, e, e])),
                lead_s,
                acceleration_mps2: Vector2::zeros(),
                log_weight: 0.0,
            };
        }
        (self.started, self.unexplained) = (true, 0);
    }

    /// Mean and spread; `None` before the first fix.
    pub fn horizontal(&self) -> Option<Horizontal> {
        if !self.started {
            return None;
        }
        let total: f64 = self.gaussians.iter().map(|g| g.log_weight.exp()).sum();
        let mut mean = SVector::<f64, 4>::zeros();
        let mut square = SVector::<f64, 4>::zeros();
        let mut direction = Vector2::zeros();
        for g in &self.gaussians {
            let w = g.log_weight.exp() / total;
            let (state, variance) = g.present();
            mean += state * w;
            square += (variance + state.component_mul(&state)) * w;
            // The mean of a direction whose angle has the variance σ² is shorter by exp(−σ²/2).
            direction += Vector2::new(g.x[ix::YAW].cos(), g.x[ix::YAW].sin()) * (w * (-0.5 * g.p[(4, 4)]).exp());
        }
        let variance = (square - mean.component_mul(&mean)).map(|v| v.max(1e-6));
        // What was gathered since moves the mean as the mean yaw has it.
        let yaw = direction.y.atan2(direction.x);
        let (sin, cos) = yaw.sin_cos();
        let turn = Matrix2::new(cos, -sin, sin, cos);
        let velocity = mean.fixed_rows::<2>(2).into_owned();
        let length = direction.norm().clamp(1e-9, 1.0);
        Some(Horizontal {
            position_m: mean.fixed_rows::<2>(0) + velocity * self.elapsed_s + turn * self.moved_m * length,
            velocity_mps: velocity + turn * self.gained_mps * length,
            position_variance: variance.fixed_rows::<2>(0).into_owned(),
            velocity_variance: variance.fixed_rows::<2>(2).into_owned(),
            yaw_rad: wrap_pi(yaw + roll_pitch_yaw(&self.attitude.world_from_body()).z),
            yaw_sigma_rad: (-2.0 * length.ln()).sqrt(),
        })
    }

    /// Attitude: tilt of the attitude filter, yaw of the mixture (of the start, before the first fix).
    pub fn world_from_body(&self) -> UnitQuaternion<f64> {
        let level = self.attitude.world_from_body();
        let turned = self.horizontal().map_or(0.0, |h| h.yaw_rad - roll_pitch_yaw(&level).z);
        UnitQuaternion::from_scaled_axis(Vector3::z() * turned) * level
    }

    /// Gyroscope bias of the attitude filter, rad/s.
    pub fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.attitude.gyro_bias_radps()
    }
}

impl Gaussian {
    /// Position and velocity where the fixes are: ahead of the IMU by the lead. And their variances.
    fn present(&self) -> (SVector<f64, 4>, SVector<f64, 4>) {
        let (x, p, lead) = (&self.x, &self.p, self.lead_s);
        let mut state = x.fixed_rows::<4>(0).into_owned();
        let mut variance = SVector::<f64, 4>::zeros();
        for axis in 0..2 {
            let v = ix::VELOCITY + axis;
            state[axis] += lead * x[v] + 0.5 * lead * lead * self.acceleration_mps2[axis];
            state[v] += lead * self.acceleration_mps2[axis];
            variance[axis] = p[(axis, axis)] + 2.0 * lead * p[(axis, v)] + lead * lead * p[(v, v)];
            variance[v] = p[(v, v)];
        }
        (state, variance)
    }

    /// P Hᵀ, S and the innovation of a position.
    fn position_row(&self, (place, sigma): &(Vector2<f64>, f64)) -> (SMatrix<f64, N, 2>, Matrix2<f64>, Vector2<f64>) {
        let lead = self.lead_s;
        let ph = self.p.fixed_columns::<2>(ix::POSITION) + self.p.fixed_columns::<2>(ix::VELOCITY) * lead;
        let s = ph.fixed_rows::<2>(ix::POSITION)
            + ph.fixed_rows::<2>(ix::VELOCITY) * lead
            + Matrix2::identity() * (sigma * sigma);
        (ph, s, place - self.present().0.fixed_rows::<2>(ix::POSITION))
    }

    /// Squared Mahalanobis distance of a position.
    fn distance(&self, position: &(Vector2<f64>, f64)) -> f64 {
        let (_, s, innovation) = self.position_row(position);
        s.try_inverse().map_or(f64::INFINITY, |inverse| (innovation.transpose() * inverse * innovation).x)
    }

    fn correct_position(&mut self, position: &(Vector2<f64>, f64)) -> f64 {
        let (ph, s, innovation) = self.position_row(position);
        self.correct(&ph, &s, &innovation)
    }

    fn correct_velocity(&mut self, (velocity, sigma): &(Vector2<f64>, f64)) -> f64 {
        let ph = self.p.fixed_columns::<2>(ix::VELOCITY).into_owned();
        let s = ph.fixed_rows::<2>(ix::VELOCITY) + Matrix2::identity() * (sigma * sigma);
        let innovation = velocity - self.present().0.fixed_rows::<2>(ix::VELOCITY);
        self.correct(&ph, &s, &innovation)
    }

    /// Corrects with P Hᵀ, S and the innovation; −2 log of the likelihood, without its constant.
    fn correct(&mut self, ph: &SMatrix<f64, N, 2>, s: &Matrix2<f64>, innovation: &Vector2<f64>) -> f64 {
        let Some(inverse) = s.try_inverse() else { return 0.0 };
        let distance = (innovation.transpose() * inverse * innovation).x;
        let k = ph * inverse;
        self.x += k * innovation;
        self.x[ix::YAW] = wrap_pi(self.x[ix::YAW]);
        self.p -= k * ph.transpose();
        kalman::symmetrise(&mut self.p);
        distance.min(LOUDEST) + s.determinant().max(1e-12).ln()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::frames::from_roll_pitch_yaw;

    /// A vehicle that starts at `yaw`, sways and turns; fixes once a second with `sigma`. Mixture, true yaw and true
    /// position at the end.
    fn fly(yaw: f64, sway_mps2: f64, seconds: f64, sigma: f64, seed: u64) -> (YawMixture, f64, Vector2<f64>) {
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut draw = |sigma: f64| -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
        let mut mixture = YawMixture::new();
        let h = 0.005;
        let (mut p, mut v) = (Vector2::new(4.0, -3.0), Vector2::new(1.0, 2.0));
        let attitude = |t: f64| from_roll_pitch_yaw(&Vector3::new(0.1 * t.sin(), 0.1 * (0.7 * t).cos(), yaw + 0.1 * t));
        let steps = (seconds / h) as usize;
        for k in 0..steps {
            let t = k as f64 * h;
            let a = Vector2::new((1.1 * t).sin(), (0.8 * t + 1.0).cos()) * sway_mps2;
            let q = attitude(t);
            let rate = (attitude(t - h).inverse() * q).scaled_axis() / h;
            let force = q.inverse() * Vector3::new(a.x, a.y, 9.81);
            let noise = Vector3::new(draw(0.3), draw(0.3), draw(0.3));
            mixture.push(h, &rate, &(force + noise + Vector3::new(0.1, -0.1, 0.0)));
            p += v * h + a * (0.5 * h * h);
            v += a * h;
            if k % 200 == 0 {
                let place = p + Vector2::new(draw(sigma), draw(sigma));
                mixture.fix(&Fix { position: (place, sigma), velocity: None });
            }
        }
        (mixture, yaw + 0.1 * (seconds - h), p)
    }

    #[test]
    fn yaw_is_found_from_any_start_by_positions_alone() {
        for (seed, yaw) in [0.2, 1.4, 2.9, -2.2, -0.7].into_iter().enumerate() {
            let (mixture, truth, position) = fly(yaw, 2.0, 20.0, 0.5, seed as u64);
            let found = mixture.horizontal().unwrap();
            let error = wrap_pi(found.yaw_rad - truth).abs();
            assert!(found.yaw_sigma_rad < AGREED_RAD, "start {yaw}: σ {}", found.yaw_sigma_rad);
            // The tilt it starts with is the mean of a swaying force: up to 16° of yaw, of 180°, are left of that.
            assert!(error < AGREED_RAD, "start {yaw}: {error} rad off");
            // A fix has 0.5 m per axis; a second after it, at 3 m/s, less than what was moved since.
            assert!((found.position_m - position).norm() < 4.0, "start {yaw}: {}", found.position_m - position);
        }
    }

    #[test]
    fn without_acceleration_yaw_stays_open_and_the_place_is_known() {
        let (mixture, _, position) = fly(2.0, 0.0, 20.0, 0.5, 9);
        let found = mixture.horizontal().unwrap();
        assert!(found.yaw_sigma_rad > AGREED_RAD, "σ {}", found.yaw_sigma_rad);
        assert!((found.position_m - position).norm() < 1.5);
    }

    #[test]
    fn one_wild_fix_does_not_decide() {
        let (mut mixture, _, position) = fly(-2.2, 2.0, 20.0, 0.5, 3);
        let before = mixture.horizontal().unwrap();
        for wild in [position + Vector2::new(300.0, 0.0), Vector2::new(f64::NAN, 0.0)] {
            mixture.fix(&Fix { position: (wild, 0.5), velocity: None });
            let after = mixture.horizontal().unwrap();
            // What was gathered since the last move is taken by each Gaussian now, by their mean before.
            assert!((after.position_m - before.position_m).norm() < 0.05, "{after:?} after {before:?}");
            assert!(wrap_pi(after.yaw_rad - before.yaw_rad).abs() < 1e-3);
        }
        // When they go on, the vehicle is there.
        let there = position + Vector2::new(300.0, 0.0);
        for _ in 0..8 {
            mixture.fix(&Fix { position: (there, 0.5), velocity: None });
        }
        assert!((mixture.horizontal().unwrap().position_m - there).norm() < 1.0);
    }
}
