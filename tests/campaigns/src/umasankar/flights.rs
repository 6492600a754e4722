//! The four paths, flown by an LQR on the corrected model with process noise; what the cameras and the IMU saw.

use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_agent::estimate::filter::mocap_recipe::{
    ANGLE_SIGMA_RAD, CAMERAS_ENU_M, LOG_RATE_HZ, LogRow, RANGE_SIGMA_M,
};
use plumbline_agent::linalg::care;
use plumbline_agent::model::euler_body::{EulerBody, U, X, ix};
use plumbline_agent::sensor::noise::Stream;

use super::Plant;

/// Length of a flight, s.
pub const DURATION_S: f64 = 40.0;
/// Climb to this height …
const HEIGHT_M: f64 = 3.0;
/// … in this time, s; the path begins 2 s later.
const CLIMB_S: f64 = 6.0;
const BEGIN_S: f64 = 8.0;
/// Weights of the LQR: on the inputs thrust, torques (states have weight one); chosen for a loop of about 1 rad/s.
const INPUT_WEIGHTS: [f64; 4] = [0.0036, 1.0, 1.0, 1.44];

/// A path of the paper.
#[derive(Debug, Clone, Copy)]
pub struct Path {
    pub name: &'static str,
    /// Position at t, m.
    at: fn(f64) -> Vector3<f64>,
}

pub const PATHS: [Path; 4] = [
    Path { name: "hover", at: hover },
    Path { name: "circle", at: circle },
    Path { name: "square", at: square },
    Path { name: "sine", at: sine },
];

/// From 0 to 1 with no velocity or acceleration at the ends (minimum jerk).
fn ease(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// Up to 3 m and down again.
fn hover(t: f64) -> Vector3<f64> {
    Vector3::z() * (HEIGHT_M * (ease(t / CLIMB_S) - ease((t - 32.0) / CLIMB_S)))
}

fn aloft(t: f64) -> Vector3<f64> {
    Vector3::z() * (HEIGHT_M * ease(t / CLIMB_S))
}

/// How long the path has been flown at full speed, s: gathered over the first 3 s, for a step in velocity would ask
/// for an infinite tilt.
fn under_way(t: f64) -> f64 {
    const GATHER_S: f64 = 3.0;
    let since = (t - BEGIN_S).max(0.0);
    if since < GATHER_S { since * since / (2.0 * GATHER_S) } else { since - GATHER_S / 2.0 }
}

/// Radius 1 m.
fn circle(t: f64) -> Vector3<f64> {
    let angle = 0.75 * under_way(t);
    aloft(t) + Vector3::new(angle.sin(), 1.0 - angle.cos(), 0.0)
}

/// Sides of 4 m, 6 s each with a rest at the corners.
fn square(t: f64) -> Vector3<f64> {
    let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(|(x, y)| Vector3::new(x, y, 0.0));
    let side = (t - BEGIN_S).max(0.0) / 8.0;
    let (from, to) = (side as usize % 4, (side as usize + 1) % 4);
    aloft(t) + corners[from] + (corners[to] - corners[from]) * ease(side.fract() * 8.0 / 6.0)
}

/// A wave of 1.5 m across while going along +x.
fn sine(t: f64) -> Vector3<f64> {
    let along = under_way(t);
    aloft(t) + Vector3::new(0.25 * along, 1.5 * (1.1 * along).sin(), 0.0)
}

/// One flight.
pub struct Flown {
    pub log: Vec<LogRow>,
}

impl Flown {
    /// Flies `path`; `run` seeds its noise, the same on every machine.
    pub fn fly(path: Path, plant: Plant, run: u64) -> Self {
        let body = EulerBody::iris();
        let gain = gain(&body);
        let h = 1.0 / LOG_RATE_HZ as f64;
        let mut noise = Stream::new(run, &format!("plant {} {}", plant.name, path.name));
        let mut cameras = Stream::new(run, &format!("cameras {} {}", plant.name, path.name));
        let mut x = X::zeros();
        let mut log = Vec::new();
        for k in 0..=(DURATION_S / h).round() as usize {
            let t = k as f64 * h;
            let input = control(&body, &gain, path, t, &x);
            log.push(measured(t, &x, input, &mut cameras));
            // White noise held over the step: Qd of the filters.
            let held = |density: f64, noise: &mut Stream| -> Vector3<f64> {
                Vector3::from_fn(|_, _| density / h.sqrt() * noise.normal())
            };
            let (accel, turn) = (held(plant.accel, &mut noise), held(plant.turn, &mut noise));
            x = body.step(&x, &input, h);
            for axis in 0..3 {
                x[ix::X + axis] += accel[axis] * h * h / 2.0;
                x[ix::VX + axis] += accel[axis] * h;
                x[ix::ROLL + axis] += turn[axis] * h * h / 2.0;
                x[ix::P + axis] += turn[axis] * h;
            }
        }
        Self { log }
    }
}

fn gain(body: &EulerBody) -> DMatrix<f64> {
    let hover = U::new(body.mass_kg * body.gravity_mps2, 0.0, 0.0, 0.0);
    let a = body.jacobian(&X::zeros(), &hover);
    let a = DMatrix::from_fn(12, 12, |i, j| a[(i, j)]);
    let mut b = DMatrix::zeros(12, 4);
    b[(ix::VZ, 0)] = 1.0 / body.mass_kg;
    for axis in 0..3 {
        b[(ix::P + axis, 1 + axis)] = 1.0 / body.inertia_kgm2[axis];
    }
    let r = DMatrix::from_diagonal(&DVector::from_row_slice(&INPUT_WEIGHTS));
    care(&a, &b, &DMatrix::identity(12, 12), &r).expect("a hovering Iris can be regulated").k
}

/// u = (mg, 0, 0, 0) − K(x − x_ref) (ERRATA, [Umasankar] 6).
fn control(body: &EulerBody, gain: &DMatrix<f64>, path: Path, t: f64, x: &X) -> U {
    const D: f64 = 1e-3;
    let (before, now, after) = ((path.at)(t - D), (path.at)(t), (path.at)(t + D));
    let (velocity, accel) = ((after - before) / (2.0 * D), (after - now * 2.0 + before) / (D * D));
    let mut reference = X::zeros();
    for axis in 0..3 {
        reference[ix::X + axis] = now[axis];
        reference[ix::VX + axis] = velocity[axis];
    }
    // The tilt that the path's acceleration takes: v̇x = g pitch, v̇y = −g roll.
    reference[ix::PITCH] = accel.x / body.gravity_mps2;
    reference[ix::ROLL] = -accel.y / body.gravity_mps2;
    let error = x - reference;
    let u = |row: usize| -(0..12).map(|j| gain[(row, j)] * error[j]).sum::<f64>();
    U::new(body.mass_kg * body.gravity_mps2 + u(0), u(1), u(2), u(3))
}

fn measured(time_s: f64, x: &X, input: U, noise: &mut Stream) -> LogRow {
    let position_m = Vector3::new(x[ix::X], x[ix::Y], x[ix::Z]);
    LogRow {
        time_s,
        input,
        truth: *x,
        position_m,
        range_m: std::array::from_fn(|i| (position_m - CAMERAS_ENU_M[i]).norm() + RANGE_SIGMA_M[i] * noise.normal()),
        angle_rad: std::array::from_fn(|i| x[ix::ROLL + i] + ANGLE_SIGMA_RAD * noise.normal()),
    }
}
