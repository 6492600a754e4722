//! The model of the prototype: altitude, lasers and accelerometers of an idealised bank, slots of 50 ms.
//!
//! Truth (z, v, a), a delayed Kalman filter (z, v, b) 0.1 s back with lasers at 10 Hz, an output predictor, LQR with
//! integral, thrust behind a lag of 60 ms. Its numbers are the fixture of `program`.

use nalgebra::{DMatrix, Matrix3, RowVector3, Vector3};
use plumbline_core::estimate::filter::lqe;
use plumbline_core::linalg::care;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::program::Statistic;
use super::{EnvelopeError, Model, Response, Signal};

const SLOT_S: f64 = 0.05;
const LATE: usize = 2;
const LAG_S: f64 = 0.06;
/// One-sigma of a laser in the filter, m.
const LASER_M: f64 = 0.025;
/// One-sigmas of a laser sample and of what it is off by, m.
const SAMPLE_M: (f64, f64) = (0.017, 0.02);
const OFF_M: f64 = 0.012;
const MOST: f64 = 50.0;

/// Who is attacked.
#[derive(Debug, Clone, PartialEq)]
pub struct Prototype {
    /// Lasers there are.
    pub lasers: usize,
    /// Of which are attacked.
    pub attacked_lasers: Vec<usize>,
    /// Of four accelerometers.
    pub attacked_imus: Vec<usize>,
    /// Only the gate of each sample, no vote, no windows.
    pub gate_only: bool,
}

/// Accelerometers there are.
const IMUS: f64 = 4.0;

fn laser(i: usize) -> SensorId {
    SensorId::new(SensorKind::Height, i as u8 + 1)
}

fn imu(i: usize) -> SensorId {
    SensorId::new(SensorKind::Imu, i as u8 + 1)
}

/// What the detectors look at, over time.
#[derive(Default)]
struct Heard {
    innovations: Vec<Vec<Signal>>,
    residuals: Vec<Vec<Signal>>,
    shares: Vec<Vec<Signal>>,
    thrust: Vec<Signal>,
}

/// Means of windows of `n` over a series, each with its end.
fn means(series: &[Signal], n: usize) -> Vec<(usize, Signal)> {
    let Some(first) = series.first() else { return Vec::new() };
    let mut sums = vec![Signal::zeros(first.len())];
    for x in series {
        let next = sums.last().map_or_else(|| x.clone(), |sum| sum + x);
        sums.push(next);
    }
    if series.len() <= n {
        return Vec::new();
    }
    sums.iter().zip(sums.iter().skip(n)).enumerate().map(|(i, (a, b))| (i + n, (b - a) / n as f64)).collect()
}

impl Prototype {
    /// Filter gain, one column for each laser, and the variance of the predicted altitude.
    fn filter(&self) -> Result<(Vec<Vector3<f64>>, f64), EnvelopeError> {
        let n = self.lasers;
        let a = DMatrix::from_row_slice(3, 3, transition().transpose().as_slice());
        let noise = [1e-8, 0.12_f64.powi(2) * SLOT_S, 0.02_f64.powi(2) * SLOT_S];
        let q = DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&noise));
        let two = (&a * &a, &a * &q * a.transpose() + &q);
        let h = DMatrix::from_fn(n, 3, |_, c| if c == 0 { 1.0 } else { 0.0 });
        let found = lqe::discrete(&two.0, &h, &two.1, &(DMatrix::identity(n, n) * LASER_M.powi(2)))?;
        let gain = (0..n).map(|l| Vector3::from_fn(|r, _| found.gain[(r, l)])).collect();
        Ok((gain, found.covariance[(0, 0)]))
    }

    fn regulator() -> Result<RowVector3<f64>, EnvelopeError> {
        let a = DMatrix::from_row_slice(3, 3, &[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let b = DMatrix::from_row_slice(3, 1, &[0.0, 1.0, 0.0]);
        let q = DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&[9.0, 1.0, 1.0]));
        let k = care(&a, &b, &q, &DMatrix::from_element(1, 1, 0.1))?.k;
        Ok(RowVector3::from_fn(|_, c| k[(0, c)]))
    }

    fn judged(&self, heard: &Heard, predicted_variance: f64) -> Vec<Statistic> {
        let mut out = Vec::new();
        let mut add = |detector, sensor, slot: usize, every: f64, limit, row: Signal| {
            out.push(Statistic { detector, sensor, time_s: slot as f64 * every, limit, row });
        };
        let sample_m = SAMPLE_M.0.hypot(SAMPLE_M.1);
        for (l, series) in heard.innovations.iter().enumerate() {
            for (k, x) in series.iter().enumerate() {
                let limit = 3.3 * sample_m.hypot(predicted_variance.sqrt());
                add("sample gate", Some(laser(l)), k, 0.1, limit, x.clone());
            }
        }
        if self.gate_only {
            return out;
        }
        for (l, series) in heard.residuals.iter().enumerate() {
            let limit = 3.3 * (SAMPLE_M.0 / 24.0_f64.sqrt()).hypot(OFF_M);
            means(series, 24).into_iter().for_each(|(k, x)| add("window mean", Some(laser(l)), k, 0.1, limit, x));
            let against: Vec<Signal> = (0..series.len()).map(|k| self.against_the_others(heard, l, k)).collect();
            for (window, sigma) in [(5, 0.015), (24, 0.010)] {
                let of = means(&against, window);
                of.into_iter().for_each(|(k, x)| add("laser vote", Some(laser(l)), k, 0.1, 3.5 * sigma, x));
            }
        }
        let part = 1.0 - self.attacked_imus.len() as f64 / IMUS;
        let drift = 0.13_f64.hypot(0.035);
        let long = (0.13 / 3.0_f64.sqrt()).hypot(0.035);
        for (i, series) in heard.shares.iter().enumerate().filter(|_| part > 0.0) {
            let of = self.attacked_imus.get(i).map(|i| imu(*i));
            for (window, sigma) in [(4, 0.9), (16, drift), (48, long)] {
                let each = means(series, window).into_iter();
                each.for_each(|(k, x)| add("IMU mean", of, k, SLOT_S, 3.3 * sigma, x * part));
            }
        }
        if !self.attacked_imus.is_empty() {
            for (window, sigma) in [(16, 0.3_f64.hypot(0.13)), (48, 0.15)] {
                let each = means(&heard.thrust, window).into_iter();
                each.for_each(|(k, x)| add("thrust mean", None, k, SLOT_S, 3.3 * sigma, x));
            }
        }
        out
    }

    /// Residual of one laser less the mean of the others'.
    fn against_the_others(&self, heard: &Heard, l: usize, k: usize) -> Signal {
        let at = |l: usize| heard.residuals.get(l).and_then(|series| series.get(k));
        let Some(own) = at(l) else { return Signal::zeros(0) };
        let mut others = Signal::zeros(own.len());
        (0..self.lasers).filter(|j| *j != l).filter_map(at).for_each(|x| others += x);
        own - others / (self.lasers - 1).max(1) as f64
    }
}

fn transition() -> Matrix3<f64> {
    let d = SLOT_S;
    Matrix3::new(1.0, d, -0.5 * d * d, 0.0, 1.0, -d, 0.0, 0.0, 1.0)
}

/// Three signals: altitude, climb and the third state.
type Three = [Signal; 3];

fn predicted(x: &Three, force: &Signal) -> Three {
    let a = transition();
    let row = |r: usize| &x[0] * a[(r, 0)] + &x[1] * a[(r, 1)] + &x[2] * a[(r, 2)];
    [row(0) + force * (0.5 * SLOT_S * SLOT_S), row(1) + force * SLOT_S, row(2)]
}

impl Model for Prototype {
    fn attacked(&self) -> Vec<(SensorId, f64, f64)> {
        let lasers = self.attacked_lasers.iter().map(|i| (laser(*i), 2.0 * SLOT_S, MOST));
        lasers.chain(self.attacked_imus.iter().map(|i| (imu(*i), SLOT_S, MOST))).collect()
    }

    fn respond(
        &self,
        horizon_s: f64,
        width: usize,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Response, EnvelopeError> {
        let (gain, variance) = self.filter()?;
        let k_lqr = Self::regulator()?;
        let zero = || Signal::zeros(width);
        let slots = (horizon_s / SLOT_S).round() as usize;
        let (mut z, mut v, mut a, mut integral) = (zero(), zero(), zero(), zero());
        let mut x: Three = [zero(), zero(), zero()];
        let (mut forces, mut altitudes): (Vec<Signal>, Vec<Signal>) = (Vec::new(), Vec::new());
        let mut heard = Heard {
            innovations: vec![Vec::new(); self.lasers],
            residuals: vec![Vec::new(); self.lasers],
            shares: vec![Vec::new(); self.attacked_imus.len()],
            thrust: Vec::new(),
        };
        let mut response = Response::default();
        for k in 0..slots {
            let mut force = a.clone();
            for (i, series) in self.attacked_imus.iter().zip(&mut heard.shares) {
                let share = attack(imu(*i), k);
                force += &share / IMUS;
                series.push(share);
            }
            forces.push(force);
            altitudes.push(z.clone());
            let taken = k.checked_sub(LATE).and_then(|h| Some((h, forces.get(h)?, altitudes.get(h + 1)?)));
            if let Some((h, force, altitude)) = taken {
                x = predicted(&x, force);
                if h % 2 == 0 {
                    let measured = |l: usize| match self.attacked_lasers.contains(&l) {
                        true => altitude + attack(laser(l), h / 2),
                        false => altitude.clone(),
                    };
                    let before = x[0].clone();
                    let y: Vec<Signal> = (0..self.lasers).map(measured).collect();
                    for ((y, gain), kept) in y.iter().zip(&gain).zip(&mut heard.innovations) {
                        let innovation = y - &before;
                        x.iter_mut().zip(gain.iter()).for_each(|(x, g)| x.axpy(*g, &innovation, 1.0));
                        kept.push(innovation);
                    }
                    y.iter().zip(&mut heard.residuals).for_each(|(y, kept)| kept.push(y - &x[0]));
                }
            }
            let since = forces.iter().skip((k + 1).saturating_sub(LATE));
            let now = since.fold(x.clone(), |x, force| predicted(&x, force));
            integral.axpy(SLOT_S, &now[0], 1.0);
            let u = -(&now[0] * k_lqr[0] + &now[1] * k_lqr[1] + &integral * k_lqr[2]);
            if let Some(force) = forces.last() {
                heard.thrust.push(force - &x[2] - &a);
            }
            response.place_m.push(z.clone());
            response.speed_mps.push(v.clone());
            z += &v * SLOT_S + &a * (0.5 * SLOT_S * SLOT_S);
            v += &a * SLOT_S;
            a = &a + (u - &a) * (SLOT_S / LAG_S);
        }
        response.statistics = self.judged(&heard, variance);
        Ok(response)
    }
}
