//! How far an attacker who is not seen can push the vehicle: the attack envelope.
//!
//! For a set of attacked sensors and a horizon T, the largest deviation that keeps every detector silent:
//!
//! maximise  cᵀa   subject to   |mᵢᵀa| ≤ lᵢ,  |aⱼ| ≤ uⱼ
//!
//! | symbol | meaning |
//! |---|---|
//! | a | what is added to each sample of the attacked sensors, m and m/s² |
//! | c | deviation of the vehicle at T from each of them, closed loop and linear |
//! | mᵢ, lᵢ | statistic of one detector at one time, and its limit |
//! | uⱼ | most that an attack may add |
//!
//! Three models give c and m: `prototype` (its table is a fixture), `flying`, the altitude as it flies, and `lateral`, a horizontal
//! axis. `program` solves, and proves the bound by its multipliers alone. Without noise; deviations are those from a flight without the attack.

mod aside;
mod bank;
mod commanded;
mod controlled;
pub mod expected;
pub mod flying;
mod heard_aside;
mod interior;
mod judges;
pub mod lateral;
pub mod prepare;
pub mod program;
pub mod prototype;
mod rotors;
pub mod sets;
pub mod theory;

use nalgebra::DVector;
use plumbline_core::estimate::lanes::linear::SLOT;
use plumbline_core::linalg::LinalgError;
use plumbline_proto::ids::SensorId;

pub use self::judges::EVIDENCE;
use self::program::{Memory, Program, Statistic};
use crate::design::DesignError;

/// A row: what a quantity of the loop is made of, one number for each column of the attack.
pub type Signal = DVector<f64>;

/// Ramps are followed for so long, s …
const RAMP_S: f64 = 180.0;
/// … after which no statistic is larger than this part of its largest, and the deviation follows the ramp to this part.
const SETTLED: f64 = 0.02;

/// Largest program: a second of computing.
const COLUMNS: usize = 1000;

/// Why there is no envelope.
#[derive(Debug, thiserror::Error)]
pub enum EnvelopeError {
    /// No such sensor, or none whose attack the model knows.
    #[error("sensor {sensor} is not one that this loop uses: {known}")]
    UnknownSensor {
        /// As asked for.
        sensor: String,
        /// Those there are.
        known: String,
    },
    /// More sensors than there are.
    #[error("a set of {size} sensors: this loop uses {sensors}")]
    SetTooLarge {
        /// Asked for.
        size: usize,
        /// In the loop.
        sensors: usize,
    },
    /// The loop has no envelope.
    #[error("these gains do not stabilise: the slowest pole is at {pole_per_s:+.4} 1/s")]
    Unstable {
        /// Largest real part, 1/s.
        pole_per_s: f64,
    },
    /// A number that has no meaning.
    #[error("{what} is {value}, it must be {expected}")]
    Value {
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// No attack, not even none, keeps this detector silent.
    #[error("the program is infeasible: the limit of {detector} is {limit}")]
    Infeasible {
        /// Whose.
        detector: &'static str,
        /// Its limit.
        limit: f64,
    },
    /// The solver ended without an answer.
    #[error("the program of {columns} columns and {rows} rows ended with {status}")]
    Solver {
        /// What it said.
        status: String,
        /// Of the program.
        columns: usize,
        /// Of the program.
        rows: usize,
    },
    /// Nobody waits for it.
    #[error("given up: nobody waits for the bound")]
    GivenUp,
    /// The gains, or another field of the question.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// A matrix could not be solved with.
    #[error(transparent)]
    Linalg(#[from] LinalgError),
}

/// What the loop makes of an attack.
#[derive(Debug, Clone, Default)]
pub struct Response {
    /// Place along the axis at the beginning of each slot, m.
    pub place_m: Vec<Signal>,
    /// Speed along it there, m/s.
    pub speed_mps: Vec<Signal>,
    /// Tilt about the other axis there, rad, for a horizontal axis.
    pub tilt_rad: Vec<Signal>,
    /// Every detector at every time.
    pub statistics: Vec<Statistic>,
    /// Each time, s, that an attacked height is sampled: how far each healthy one, as last heard, is from their mean, m.
    pub apart_m: Vec<(f64, Vec<Signal>)>,
    /// Residuals of the heights, nothing learned taken off: number of the slot, height, m. For a model that tells them.
    pub residuals_m: Vec<(usize, usize, Signal)>,
}

/// A linear loop with its detectors.
pub trait Model {
    /// Those attacked, each with the time between two of its columns, s, and the most that may be added.
    fn attacked(&self) -> Vec<(SensorId, f64, f64)>;

    /// After so long, s, everything repeats: what is heard of a sample is heard of the one so much later, so much later. The horizon
    /// for a model that does not say.
    fn period_s(&self, horizon_s: f64) -> f64 {
        horizon_s
    }

    /// Detectors that sum squares, see [`Program`].
    fn squares(&self) -> Vec<(&'static str, Memory)> {
        Vec::new()
    }

    /// The loop over `horizon_s`, from rest, where `attack` is added to the n-th sample of a sensor.
    ///
    /// # Errors
    /// When a gain cannot be found.
    fn respond(
        &self,
        horizon_s: f64,
        width: usize,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Response, EnvelopeError>;
}

/// Which quantity is pushed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deviation {
    /// Along the axis, m: the altitude.
    Place,
    /// Along the axis, m/s: the climb.
    Speed,
    /// About the other horizontal axis, rad.
    Tilt,
    /// Of a healthy height from the mean of the healthy ones, m: which of them, and how many samples of attacked heights before the last;
    /// judged is what was heard before that.
    Apart(usize, usize),
}

/// Columns of a model over a horizon: sensor, its first column, how many.
pub fn columns(model: &dyn Model, horizon_s: f64) -> Vec<(SensorId, usize, usize)> {
    let mut first = 0;
    let place = |(sensor, every_s, _): (SensorId, f64, f64)| {
        let count = (horizon_s / every_s + 1e-9).floor() as usize;
        first += count;
        (sensor, first - count, count)
    };
    model.attacked().into_iter().map(place).collect()
}

/// The program of `model` for the largest `deviation` at the end of the horizon. The loop is followed for the samples of one period
/// only; what is heard of the others is the same, later.
///
/// # Errors
/// As [`Model::respond`].
pub fn program(model: &dyn Model, horizon_s: f64, deviation: Deviation) -> Result<Program, EnvelopeError> {
    program_after(model, horizon_s, deviation, 0, f64::INFINITY)
}

/// The same for the deviation so many slots after the horizon, at which the attack ends; the judges hear of slots that end by `heard_s`.
///
/// # Errors
/// As [`Model::respond`].
pub fn program_after(
    model: &dyn Model,
    horizon_s: f64,
    deviation: Deviation,
    after: usize,
    heard_s: f64,
) -> Result<Program, EnvelopeError> {
    let period_s = model.period_s(horizon_s);
    let (all, own) = (columns(model, horizon_s), columns(model, period_s));
    let width = |of: &[(SensorId, usize, usize)]| of.iter().map(|(_, _, count)| count).sum::<usize>();
    if width(&all) > COLUMNS {
        let value = width(&all) as f64;
        return Err(EnvelopeError::Value {
            what: "what the set may add over the horizon, values,",
            value,
            expected: "at most 1000",
        });
    }
    let unit = |sensor: SensorId, k: usize| {
        let mut signal = Signal::zeros(width(&own));
        let place = own.iter().find(|(of, _, count)| *of == sensor && k < *count);
        if let Some(one) = place.and_then(|(_, first, _)| signal.get_mut(first + k)) {
            *one = 1.0;
        }
        signal
    };
    let response = model.respond(horizon_s + after as f64 * SLOT, width(&own), &unit)?;
    let followed = match deviation {
        Deviation::Place => response.place_m,
        Deviation::Speed => response.speed_mps,
        Deviation::Tilt => response.tilt_rad,
        Deviation::Apart(i, _) => response.apart_m.iter().filter_map(|(_, of)| of.get(i).cloned()).collect(),
    };
    // Places of a period in what is followed, and in what is judged.
    let slots = (followed.len().saturating_sub(after) as f64 * period_s / horizon_s).round() as usize;
    let judged = response.statistics.iter().take_while(|s| s.time_s < period_s + 1e-9).count();
    let row = |at: usize, places: usize, heard: &dyn Fn(usize) -> Option<Signal>| {
        let mut row = Signal::zeros(width(&all));
        for ((_, to, count), (_, from, each)) in all.iter().zip(&own).filter(|(_, (_, _, each))| *each > 0) {
            for periods in 0..count.div_ceil(*each) {
                let Some(heard) = at.checked_sub(periods * places).and_then(heard) else { break };
                let fewer = (count - periods * each).min(*each);
                row.rows_mut(to + periods * each, fewer).copy_from(&heard.rows(*from, fewer));
            }
        }
        row
    };
    let before = if let Deviation::Apart(_, before) = deviation { before } else { 0 };
    let last = followed.len().saturating_sub(1 + before);
    let until_s = match deviation {
        Deviation::Apart(..) => response.apart_m.get(last).map_or(0.0, |(time_s, _)| *time_s),
        _ => heard_s,
    };
    let heard = |at: usize| response.statistics.get(at).map(|s| s.row.clone());
    let statistics = response.statistics.iter().enumerate().filter(|(_, s)| s.time_s < until_s - 1e-9);
    let statistics = statistics.map(|(at, s)| Statistic { row: row(at, judged, &heard), ..*s }).collect();
    let most = model.attacked().into_iter().zip(&all).flat_map(|((_, _, most), (_, _, n))| vec![most; *n]).collect();
    let objective = row(last, slots, &|at| followed.get(at).cloned());
    Ok(Program { objective, statistics, squares: model.squares(), most })
}

/// Is there a direction without an end? A ramp of 1 m/s in all attacked heights that moves the vehicle as fast while every
/// statistic dies away: scaled down it is silent for ever, and the deviation grows with time. The fastest silent one, m/s.
///
/// # Errors
/// As [`Model::respond`].
pub fn recession_mps(model: &dyn Model) -> Result<Option<f64>, EnvelopeError> {
    use plumbline_proto::v1::SensorKind::Height;
    let every = model.attacked();
    let of = |sensor: SensorId| every.iter().find(|(of, ..)| *of == sensor).map_or(0.0, |(_, every_s, _)| *every_s);
    let ramp = |sensor: SensorId, k: usize| {
        let at = if sensor.kind == Height { k as f64 * of(sensor) } else { 0.0 };
        Signal::from_element(1, at)
    };
    let response = model.respond(RAMP_S, 1, &ramp)?;
    let z = |back: usize| response.place_m.iter().nth_back(back).map_or(0.0, |z| z[0]);
    // The last tenth of the way.
    let tenth = response.place_m.len() / 10;
    let rate_mps = (z(0) - z(tenth)).abs() / (0.1 * RAMP_S);
    let ratio = |s: &Statistic| (s.row[0] / s.limit).abs();
    let peak = response.statistics.iter().map(ratio).fold(0.0, f64::max);
    let late = response.statistics.iter().filter(|s| s.time_s > 0.9 * RAMP_S);
    let left = late.map(ratio).fold(0.0, f64::max);
    let follows = (rate_mps - 1.0).abs() < SETTLED && left < SETTLED * peak;
    Ok((follows && peak > 0.0).then(|| rate_mps / peak))
}
