//! Figure 30 (6.1): MATLAB against C. The initial state from the whole recording by one solver, and the state at the end of a
//! sliding window by another.
//!
//! | [Clinic] | here |
//! |---|---|
//! | MATLAB, CVX: x\[0\] of Eq. 19 to 21, the window grows | Clarabel, the same program: SI units, no weights |
//! | C, CVXgen: Eq. 22, N = 10, absolute values summed | the decoder's own Newton on its window of 10, absolute values (ℓ1) and norms over time (ℓ1/ℓ2) |
//!
//! As there, noise is drawn for each of the two. Their errors are those of the height, of the true height.

use nalgebra::{DMatrix, SMatrix, SVector};
use plumbline_agent::estimate::secure::Program;
use plumbline_agent::estimate::secure::compress::Compressed;
use plumbline_agent::estimate::secure::conic::Conic;
use plumbline_agent::estimate::secure::suite::STATES;
use plumbline_agent::estimate::secure::window::Window;
use plumbline_experiment::draw::{Dice, median, parallel, worst};
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use super::Effort;
use super::decoder::{Flight, PERIOD_S, SLOTS};

/// Two lasers, 38 rows ([Clinic] Eq. 18).
const HEIGHTS: usize = 2;
const STEPS: usize = 100;
/// Both are asked every so many slots: from the first window that is full.
const EVERY: usize = 5;
/// Noise over that of the data sheets, by which a height errs by 4 % of a metre on average: [Clinic] 4.2.2 has 4 % of the
/// sensors that are not compromised.
const NOISE: f64 = 5.0;

/// Every sample since the beginning: the window that grows, anchored at its first slot.
struct Whole {
    a: SMatrix<f64, STATES, STATES>,
    /// A^k of the newest slot, and the state that the known inputs alone lead to.
    power: SMatrix<f64, STATES, STATES>,
    forced: SVector<f64, STATES>,
    /// c A^k and y − c g_k of each sensor, slot by slot (Eq. 21).
    rows: Vec<Vec<SVector<f64, STATES>>>,
    values: Vec<Vec<f64>>,
}

impl Whole {
    fn new(a: SMatrix<f64, STATES, STATES>, sensors: usize) -> Self {
        let (power, forced) = (SMatrix::identity(), SVector::zeros());
        Self { a, power, forced, rows: vec![vec![]; sensors], values: vec![vec![]; sensors] }
    }

    fn advance(&mut self, known: &SVector<f64, STATES>) {
        self.power = self.a * self.power;
        self.forced = self.a * self.forced + known;
    }

    fn put(&mut self, sensor: usize, c: &SVector<f64, STATES>, value: f64) {
        self.rows[sensor].push(self.power.transpose() * c);
        self.values[sensor].push(value - c.dot(&self.forced));
    }

    /// x\[0\], moved on to the newest slot.
    fn decode(&self) -> SVector<f64, STATES> {
        let phi: Vec<DMatrix<f64>> =
            self.rows.iter().map(|rows| DMatrix::from_fn(rows.len(), STATES, |k, j| rows[k][j])).collect();
        let problem = Compressed::<STATES>::new(&phi, Program::L2).unwrap();
        let first = Conic::new(&problem).unwrap().decode(&problem, &self.values.concat()).unwrap().x;
        self.power * first + self.forced
    }
}

/// Heights at one time.
struct Heights {
    t_s: f64,
    truth_m: f64,
    /// Whole recording, window with norms over time, window with absolute values.
    decoded_m: [f64; 3],
    sensor_m: f64,
}

impl Heights {
    fn error(&self, height_m: f64) -> f64 {
        ((height_m - self.truth_m) / self.truth_m).abs()
    }
}

fn fly(thrust_factor: f64, seed: u64) -> Vec<Heights> {
    let mut flight = Flight::new(HEIGHTS, thrust_factor);
    let scalars = flight.observed.scalars.clone();
    let mut whole = Whole::new(flight.a, scalars.len());
    let mut windows = [Program::L2, Program::L1].map(|program| {
        let mut window = flight.window(SLOTS);
        window.use_program(program);
        window
    });
    let [mut matlab, mut c] = [2 * seed, 2 * seed + 1].map(Dice::new);
    let mut heights = Vec::new();
    for step in 1..=STEPS {
        let known = flight.step();
        whole.advance(&known);
        windows.iter_mut().for_each(|window| window.advance(Some(&known)));
        let mut sensor_m = f64::NAN;
        for (sensor, scalar) in scalars.iter().enumerate() {
            let clean = scalar.c.dot(&flight.x);
            let noisy = |dice: &mut Dice| clean + NOISE * scalar.sigma * dice.normal();
            whole.put(sensor, &scalar.c, noisy(&mut matlab));
            let value = noisy(&mut c);
            windows.iter_mut().for_each(|window| window.put(sensor, value));
            sensor_m = if sensor == 0 { value } else { sensor_m };
        }
        if step >= SLOTS && step % EVERY == 0 {
            let slid = |window: &mut Window<STATES>| window.decode(|_| false, &[], None).unwrap().x[0];
            let [norms, absolute] = &mut windows;
            let decoded_m = [whole.decode()[0], slid(norms), slid(absolute)];
            heights.push(Heights { t_s: step as f64 * PERIOD_S, truth_m: flight.x[0], decoded_m, sensor_m });
        }
    }
    heights
}

pub fn run(report: &mut Report, effort: &Effort) {
    report.heading("Figure 30: MATLAB against C");
    let trials = effort.trials.min(10) as usize;
    for (plant, thrust_factor) in [("as_modelled", 1.0), ("five_percent_weaker", 0.95)] {
        let runs = parallel(trials, |i| fly(thrust_factor, effort.flown.seed(30_000 + i as u64)));
        let mean = |run: &[Heights], height: &dyn Fn(&Heights) -> f64| {
            100.0 * run.iter().map(|heights| heights.error(height(heights))).sum::<f64>() / run.len() as f64
        };
        let errors = |height: &dyn Fn(&Heights) -> f64| runs.iter().map(|run| mean(run, height)).collect::<Vec<_>>();
        let sensor = median(&errors(&|heights| heights.sensor_m));
        let solved = [("matlab", Some(3.0)), ("c_norms_over_time", None), ("c", Some(2.0))];
        for (which, (name, paper)) in solved.into_iter().enumerate() {
            let errors = errors(&|heights| heights.decoded_m[which]);
            let more = json!({ "paper": paper, "worst": worst(&errors), "sensor_percent": sensor, "trials": trials });
            report.value(&format!("figure_30/{plant}/{name}"), median(&errors), "%", more);
        }
        let line = |height: &dyn Fn(&Heights) -> f64| runs[0].iter().map(|h| (h.t_s, height(h))).collect();
        let plot = Plot::new("Height step to 1 m", "t, s", "z, m")
            .with(Series::dashed("truth", line(&|h| h.truth_m)))
            .with(Series::points("one laser", line(&|h| h.sensor_m)))
            .with(Series::line("whole recording, Clarabel", line(&|h| h.decoded_m[0])))
            .with(Series::line("window of 10, Newton, ℓ1/ℓ2", line(&|h| h.decoded_m[1])))
            .with(Series::line("window of 10, Newton, ℓ1", line(&|h| h.decoded_m[2])));
        let caption = format!("Figure 30: thrust {} of the modelled one.", thrust_factor);
        report.figure(&format!("figure_30_{plant}"), &caption, &plot).unwrap();
    }
}
