//! Errors of the filters over one flight, and the floor below which no filter can be.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_agent::estimate::filter::ekf_hybrid::EkfHybrid;
use plumbline_agent::estimate::filter::measurement::TwelveState;
use plumbline_agent::estimate::filter::mocap_recipe::{LOG_RATE_HZ, LogRow, measurements};
use plumbline_agent::estimate::filter::ukf::Ukf;
use plumbline_agent::frames::wrap_pi;
use plumbline_agent::model::euler_body::{EulerBody, M, X, ix, process_noise};

use super::flights::{Flown, PATHS};
use super::{Plant, RATES_HZ};

/// The filters, in the order of every array here.
pub const FILTERS: [&str; 2] = ["EKF", "UKF"];

/// Of one filter over one flight.
#[derive(Debug, Clone, Copy, Default)]
pub struct Errors {
    pub variance_m2: [f64; 3],
    pub nees: f64,
}

/// Of one flight at one rate.
#[derive(Debug, Clone, Copy, Default)]
pub struct Scored {
    pub filters: [Errors; FILTERS.len()],
    pub floor_m2: [f64; 3],
}

/// Of one path at one rate, over all runs.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cell {
    pub std_m: [[f64; 3]; FILTERS.len()],
    pub nees: [f64; FILTERS.len()],
    pub floor_m: [f64; 3],
}

/// Sums over the runs.
#[derive(Debug, Default)]
pub struct Tables {
    sums: [[Vec<Scored>; RATES_HZ.len()]; PATHS.len()],
}

impl Tables {
    pub fn take(&mut self, path: usize, scored: [Scored; RATES_HZ.len()]) {
        for (list, one) in self.sums[path].iter_mut().zip(scored) {
            list.push(one);
        }
    }

    pub fn cell(&self, path: usize, rate: usize) -> Cell {
        let runs = &self.sums[path][rate];
        let mean = |of: &dyn Fn(&Scored) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
        let mut cell = Cell::default();
        for axis in 0..3 {
            cell.floor_m[axis] = mean(&|s| s.floor_m2[axis]).sqrt();
            for f in 0..FILTERS.len() {
                cell.std_m[f][axis] = mean(&|s| s.filters[f].variance_m2[axis]).sqrt();
            }
        }
        for f in 0..FILTERS.len() {
            cell.nees[f] = mean(&|s| s.filters[f].nees);
        }
        cell
    }
}

/// Start of every filter: the origin, known to 1 mm and 1 mrad.
pub fn start() -> (X, M) {
    (X::zeros(), M::identity() * 1e-6)
}

/// Both filters and the floor at every rate.
pub fn score(flown: &Flown, plant: Plant) -> [Scored; RATES_HZ.len()] {
    RATES_HZ.map(|hz| {
        let (x, p) = start();
        Scored {
            filters: [
                run(flown, plant, hz, &mut EkfHybrid::new(EulerBody::iris(), x, p)),
                run(flown, plant, hz, &mut Ukf::new(EulerBody::iris(), x, p)),
            ],
            floor_m2: floor(flown, plant, hz),
        }
    })
}

fn run(flown: &Flown, plant: Plant, hz: usize, filter: &mut impl TwelveState) -> Errors {
    let every = LOG_RATE_HZ / hz;
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(plant.accel, plant.turn, h);
    let mut sums = Sums::default();
    let mut residuals = ArrayVec::new();
    for (k, pair) in flown.log.windows(2).enumerate() {
        filter.predict(&pair[0].input, h, &q);
        if (k + 1) % every == 0 {
            residuals.clear();
            filter.correct(&measurements(&pair[1]), &mut residuals);
            let (x, p) = filter.moments();
            sums.add(&pair[1], &x, &p);
        }
    }
    sums.errors()
}

/// Running sums over the updates of one flight.
#[derive(Debug, Default)]
pub struct Sums {
    count: f64,
    error: Vector3<f64>,
    square: Vector3<f64>,
    nees: f64,
}

impl Sums {
    pub fn add(&mut self, row: &LogRow, x: &X, p: &M) {
        let mut error = x - row.truth;
        for i in ix::ROLL..=ix::YAW {
            error[i] = wrap_pi(error[i]);
        }
        let e = Vector3::new(error[ix::X], error[ix::Y], error[ix::Z]);
        self.count += 1.0;
        self.error += e;
        self.square += e.component_mul(&e);
        self.nees += p.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(&error)));
    }

    pub fn errors(&self) -> Errors {
        let mean = self.error / self.count;
        let variance = self.square / self.count - mean.component_mul(&mean);
        Errors { variance_m2: [variance.x, variance.y, variance.z], nees: self.nees / self.count }
    }
}

/// Posterior Cramér–Rao bound: the covariance recursion linearised along the true flight, at the updates.
fn floor(flown: &Flown, plant: Plant, hz: usize) -> [f64; 3] {
    let body = EulerBody::iris();
    let every = LOG_RATE_HZ / hz;
    let h = 1.0 / LOG_RATE_HZ as f64;
    let q = process_noise(plant.accel, plant.turn, h);
    let mut p = start().1;
    let mut sum = Vector3::zeros();
    let mut count = 0.0;
    for (k, pair) in flown.log.windows(2).enumerate() {
        let phi = body.transition(&pair[0].truth, &pair[1].truth, &pair[0].input, h);
        p = phi * p * phi.transpose() + q;
        if (k + 1) % every == 0 {
            for row in measurements(&pair[1]) {
                let jacobian = row.jacobian(&pair[1].truth);
                let ph = p * jacobian;
                let s = jacobian.dot(&ph) + row.noise.sigma * row.noise.sigma;
                p -= ph * ph.transpose() / s;
            }
            p = (p + p.transpose()) * 0.5;
            sum += Vector3::new(p[(ix::X, ix::X)], p[(ix::Y, ix::Y)], p[(ix::Z, ix::Z)]);
            count += 1.0;
        }
    }
    (sum / count).into()
}
