//! The H∞ design of \[Strategies\]: four outputs (x, y, z, yaw), four inputs, 20 states, and 16.
//!
//! The plant without drag falls into four channels: x from torque y and y from torque x through four
//! integrators, z from thrust and yaw from torque z through two. Each channel is its own problem (orders 6, 6,
//! 4, 4); side by side they are the controller of the source.
//!
//! Deviations from \[Strategies\]: a disturbance ε at the plant's input (ERRATA 7); one fast pole of each channel
//! is residualised instead of truncating four balanced states (ERRATA 5).

use nalgebra::DMatrix;

use super::reduction::residualise_fastest;
use super::synthesis::{Central, central, optimal_gamma};
use super::weights::{Generalised, Weight, mixed_sensitivity};
use crate::linalg::LinalgError;
use crate::model::airframe::Airframe;
use crate::model::linearize::ix;
use crate::model::state_space::StateSpace;
use crate::types::GRAVITY_MPS2;

/// Names of the channels, in order.
pub const CHANNELS: [&str; 4] = ["x", "y", "z", "yaw"];
/// Input that each channel acts on.
pub const INPUT: [usize; 4] = [ix::TORQUE_Y, ix::TORQUE_X, ix::THRUST, ix::TORQUE_Z];

/// Weights of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelWeights {
    /// On the error.
    pub performance: Weight,
    /// On the input.
    pub effort: Weight,
    /// Size of the disturbance at the plant's input.
    pub epsilon: f64,
}

impl ChannelWeights {
    /// As printed, with the disturbance that makes the problem well-posed.
    pub fn printed(epsilon: f64) -> Self {
        Self { performance: Weight::strategies_performance(), effort: Weight::strategies_effort(), epsilon }
    }
}

/// The channel `index`: a chain of integrators, its output its first state.
pub fn plant(airframe: &Airframe, index: usize) -> StateSpace {
    let i = airframe.inertia_kgm2;
    let (order, gain) = match index {
        0 => (4, GRAVITY_MPS2 / i.y),
        1 => (4, -GRAVITY_MPS2 / i.x),
        2 => (2, 1.0 / airframe.mass_kg),
        _ => (2, 1.0 / i.z),
    };
    StateSpace {
        a: DMatrix::from_fn(order, order, |r, c| if c == r + 1 { 1.0 } else { 0.0 }),
        b: DMatrix::from_fn(order, 1, |r, _| if r + 1 == order { gain } else { 0.0 }),
        c: DMatrix::from_fn(1, order, |_, c| if c == 0 { 1.0 } else { 0.0 }),
        d: DMatrix::zeros(1, 1),
    }
}

/// One channel solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// The problem.
    pub problem: Generalised,
    /// Smallest γ.
    pub gamma_opt: f64,
    /// The central controller at a γ a little larger.
    pub central: Central,
}

/// Solves the channel `index` to within `tolerance`, and its central controller at `factor` times the smallest
/// γ, or at `gamma` where it is given.
///
/// # Errors
/// When no γ is possible.
pub fn channel(
    airframe: &Airframe,
    index: usize,
    weights: &ChannelWeights,
    factor: f64,
    gamma: Option<f64>,
    tolerance: f64,
) -> Result<Channel, LinalgError> {
    let problem =
        mixed_sensitivity(&plant(airframe, index), &[weights.performance], &[weights.effort], weights.epsilon);
    let gamma_opt = optimal_gamma(&problem, tolerance)?;
    let gamma = gamma.unwrap_or(factor * gamma_opt);
    let none = LinalgError::NotConverged {
        what: "H-infinity synthesis (gamma below the smallest)",
        iterations: 0,
        change: gamma,
        residual: gamma_opt,
    };
    let central = central(&problem, gamma)?.ok_or(none)?;
    Ok(Channel { problem, gamma_opt, central })
}

/// The channels' controllers as one: from the errors of x, y, z, yaw to thrust, torque x, y, z.
pub fn assemble(channels: &[StateSpace; 4]) -> StateSpace {
    let [x, y, z, yaw] = channels;
    let stacked = x.beside(y).beside(z).beside(yaw);
    let mut c = DMatrix::zeros(4, stacked.order());
    let mut d = DMatrix::zeros(4, 4);
    for (channel, &input) in INPUT.iter().enumerate() {
        c.row_mut(input).copy_from(&stacked.c.row(channel));
        d.row_mut(input).copy_from(&stacked.d.row(channel));
    }
    StateSpace { c, d, ..stacked }
}

/// The whole plant without drag, 12 states in the order of [`ix`], outputs x, y, z, yaw.
pub fn whole_plant(airframe: &Airframe) -> StateSpace {
    let still = Airframe { linear_drag_nspm: 0.0, ..airframe.clone() };
    let linear = crate::model::linearize::hover(&still);
    let outputs = [ix::X, ix::Y, ix::Z, ix::YAW];
    StateSpace {
        a: DMatrix::from_fn(12, 12, |r, c| linear.a[(r, c)]),
        b: DMatrix::from_fn(12, 4, |r, c| linear.b[(r, c)]),
        c: DMatrix::from_fn(4, 12, |r, c| if outputs[r] == c { 1.0 } else { 0.0 }),
        d: DMatrix::zeros(4, 4),
    }
}

/// From reference to output with `controller` acting on the error.
pub fn tracking(plant: &StateSpace, controller: &StateSpace) -> StateSpace {
    let (n, k, m) = (plant.order(), controller.order(), controller.b.ncols());
    let mut a = DMatrix::zeros(n + k, n + k);
    a.view_mut((0, 0), (n, n)).copy_from(&(&plant.a - &plant.b * &controller.d * &plant.c));
    a.view_mut((0, n), (n, k)).copy_from(&(&plant.b * &controller.c));
    a.view_mut((n, 0), (k, n)).copy_from(&(-&controller.b * &plant.c));
    a.view_mut((n, n), (k, k)).copy_from(&controller.a);
    let mut b = DMatrix::zeros(n + k, m);
    b.view_mut((0, 0), (n, m)).copy_from(&(&plant.b * &controller.d));
    b.view_mut((n, 0), (k, m)).copy_from(&controller.b);
    let mut c = DMatrix::zeros(plant.c.nrows(), n + k);
    c.view_mut((0, 0), (plant.c.nrows(), n)).copy_from(&plant.c);
    StateSpace { a, b, c, d: DMatrix::zeros(plant.c.nrows(), m) }
}

/// Both controllers of the source: 20 states at `factor` γ_opt of each channel, and 16.
///
/// # Errors
/// When a channel has no solution.
pub fn controllers(
    airframe: &Airframe,
    weights: &[ChannelWeights; 4],
    factor: f64,
    tolerance: f64,
) -> Result<(StateSpace, StateSpace, [f64; 4]), LinalgError> {
    let mut full = Vec::with_capacity(4);
    let mut reduced = Vec::with_capacity(4);
    let mut gammas = [0.0; 4];
    for (index, weights) in weights.iter().enumerate() {
        let solved = channel(airframe, index, weights, factor, None, tolerance)?;
        gammas[index] = solved.gamma_opt;
        reduced.push(residualise_fastest(&solved.central.controller)?.0);
        full.push(solved.central.controller);
    }
    let four = |list: Vec<StateSpace>| {
        <[StateSpace; 4]>::try_from(list).map_err(|_| LinalgError::Singular { what: "channels", condition: 0.0 })
    };
    Ok((assemble(&four(full)?), assemble(&four(reduced)?), gammas))
}
