//! What control costs: Riccati equations, H∞ synthesis, certification, one tick of each controller; beside them the
//! same cases by scipy and slycot, and pushes by the thousand. Prints JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::hint::black_box;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command as Process, Stdio};
use std::time::Instant;

use nalgebra::DMatrix;
use plumbline_agent::command::{Ack, Command};
use plumbline_agent::control::Controller as _;
use plumbline_agent::control::gains::{Certified, Examiner, Gain};
use plumbline_agent::control::hinf::strategies::{ChannelWeights, controllers, whole_plant};
use plumbline_agent::control::hinf::synthesis::optimal_gamma;
use plumbline_agent::control::hinf::weights::{Generalised, mixed_sensitivity};
use plumbline_agent::control::lqr_integral::Weights;
use plumbline_agent::control::policy::MarginPolicy;
use plumbline_agent::control::tuning::{Design, KINDS, kind_name};
use plumbline_agent::estimate::{Estimate, Motion};
use plumbline_agent::flight::FlightConfig;
use plumbline_agent::linalg::{care, dare};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::discretize::zero_order_hold;
use plumbline_agent::model::linearize::hover;
use plumbline_agent::types::{Loops, Setpoint};
use plumbline_proto::ids::GainsRevision;
use plumbline_support::headless::Headless;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};

/// Thrust may jump by this part of the weight when good gains replace others in flight.
const BUMP: f64 = 0.08;
/// Random bad and good pushes.
const BAD: u32 = 10_000;
const GOOD: u32 = 1_000;

fn line(name: &str, value: f64, unit: &str, limit: Option<f64>) {
    println!(
        "{}",
        json!({ "bench": "control", "name": name, "value": (value * 1e3).round() / 1e3, "unit": unit, "limit": limit })
    );
}

fn median_us(runs: usize, mut run: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[runs / 2]
}

struct Case {
    name: &'static str,
    continuous: bool,
    matrices: [DMatrix<f64>; 4],
    limit_us: Option<f64>,
}

/// The hovering Iris with 12 states, with the four integrals, and both sampled at 100 Hz.
fn riccati_cases(airframe: &Airframe) -> Vec<Case> {
    let linear = hover(airframe);
    let weights = Weights::for_airframe(airframe);
    let mut cases = Vec::new();
    for (n, names, limit_us) in [(12, ["care_12", "dare_12"], 300.0), (16, ["care_16", "dare_16"], 600.0)] {
        let mut a = DMatrix::zeros(n, n);
        let mut b = DMatrix::zeros(n, 4);
        a.view_mut((0, 0), (12, 12)).copy_from(&linear.a);
        b.view_mut((0, 0), (12, 4)).copy_from(&linear.b);
        for (i, state) in [0, 1, 2, 8].into_iter().enumerate().filter(|(i, _)| 12 + i < n) {
            a[(12 + i, state)] = 1.0;
        }
        let q = DMatrix::from_fn(n, n, |r, c| if r == c { weights.state[r] } else { 0.0 });
        let r = DMatrix::from_fn(4, 4, |r, c| if r == c { weights.input[r] } else { 0.0 });
        let sampled = zero_order_hold(&a, &b, 0.01).unwrap();
        let continuous = [a, b, q.clone(), r.clone()];
        cases.push(Case { name: names[0], continuous: true, matrices: continuous, limit_us: Some(limit_us) });
        let sampled = [sampled.a, sampled.b, q, r];
        cases.push(Case { name: names[1], continuous: false, matrices: sampled, limit_us: None });
    }
    cases
}

fn main() {
    let iris = Airframe::iris();
    let cases = riccati_cases(&iris);
    for case in &cases {
        let [a, b, q, r] = &case.matrices;
        let solve = if case.continuous { care } else { dare };
        let time = median_us(301, || {
            black_box(solve(a, b, q, r).unwrap());
        });
        line(case.name, time, "us", case.limit_us);
    }

    let weights = [ChannelWeights::printed(0.1); 4];
    let time = median_us(11, || {
        black_box(controllers(&iris, &weights, 1.001, 1e-6).unwrap());
    });
    line("hinf_synthesis", time / 1e3, "ms", Some(200.0));
    let plant = whole_plant(&iris);
    let problem = mixed_sensitivity(&plant, &weights.map(|w| w.performance), &weights.map(|w| w.effort), 0.1);
    let time = median_us(3, || {
        black_box(optimal_gamma(&problem, 1e-6).unwrap());
    });
    line("hinf_gamma_of_all_20_states", time / 1e3, "ms", None);

    let examiner = Examiner::new(&iris, 0.005, MarginPolicy::default()).unwrap();
    for kind in KINDS {
        let design = Design::new(kind, &iris);
        let time = median_us(11, || {
            black_box(examiner.certify(&design, GainsRevision(1)).unwrap());
        });
        line(&format!("certify_{}", kind_name(kind)), time / 1e3, "ms", None);
        let mut law = examiner.solve(&design).unwrap();
        let position_enu_m = nalgebra::Vector3::new(0.1, -0.2, 0.9);
        let estimate = Estimate { motion: Some(Motion { position_enu_m, ..Motion::default() }), ..Estimate::default() };
        let setpoint = Setpoint { position_enu_m: nalgebra::Vector3::z(), ..Setpoint::default() };
        let loops = Loops { horizontal: true, altitude: true };
        // A thousand at a time: one is shorter than the clock is fine.
        let time = median_us(101, || {
            for _ in 0..1000 {
                let wrench = law.control(black_box(&estimate), black_box(&setpoint), loops, 0.005);
                law.applied(&wrench, &wrench, 0.0);
                black_box(wrench);
            }
        });
        line(&format!("tick_{}", kind_name(kind)), time / 1e3, "us", Some(2.0));
    }

    python(&cases, &problem);
    pushes();
}

fn rows(m: &DMatrix<f64>) -> Value {
    m.row_iter().map(|r| r.iter().copied().collect::<Vec<_>>()).collect::<Vec<_>>().into()
}

fn skipped(reason: &str) {
    println!("{}", json!({ "bench": "control", "name": "python", "skipped": reason }));
}

fn python(cases: &[Case], problem: &Generalised) {
    let Some(python) = std::env::var_os("PLUMBLINE_SLYCOT").filter(|python| !python.is_empty()) else {
        return skipped("PLUMBLINE_SLYCOT names no Python with scipy and slycot");
    };
    let riccati: Vec<Value> = cases
        .iter()
        .map(|case| {
            let [a, b, q, r] = &case.matrices;
            let kind = if case.continuous { "care" } else { "dare" };
            json!({ "name": case.name, "kind": kind, "A": rows(a), "B": rows(b), "Q": rows(q), "R": rows(r) })
        })
        .collect();
    let Generalised { a, b1, b2, c1, c2, d11, d12, d21 } = problem;
    let hinf = json!({
        "gamma": 4.0, "A": rows(a), "B1": rows(b1), "B2": rows(b2), "C1": rows(c1), "C2": rows(c2),
        "D11": rows(d11), "D12": rows(d12), "D21": rows(d21),
    });
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/control.py");
    let started = Process::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let mut child = match started {
        Ok(child) => child,
        Err(error) => return skipped(&error.to_string()),
    };
    let text = json!({ "riccati": riccati, "hinf": hinf }).to_string();
    let _ = child.stdin.take().unwrap().write_all(text.as_bytes());
    let output = child.wait_with_output().unwrap();
    for text in String::from_utf8_lossy(&output.stdout).lines() {
        let mut value: Value = serde_json::from_str(text).unwrap();
        value["bench"] = "control".into();
        println!("{value}");
    }
    if !output.status.success() {
        skipped(&format!("the script ended with {}", output.status));
    }
}

/// A flight in altitude hold, and what new gains for it are made of.
struct Pushed {
    flown: Headless,
    config: FlightConfig,
    examiner: Examiner,
    rng: Xoshiro256PlusPlus,
    /// Good pushes that were not to be, by the policy: for their change, for their margins.
    refused: u32,
    uncertified: u32,
}

impl Pushed {
    fn start() -> Self {
        let mut flown = Headless::start("altitude_step");
        flown.scenario.script.steps.retain(|step| step.at_s < 6.0);
        let rate = flown.scenario.tick_rate_hz;
        fly(&mut flown, (12.0 * rate) as usize);
        let config = flown.flight.config().clone();
        let examiner = Examiner::new(&config.airframe, 1.0 / rate, config.margins).unwrap();
        let rng = Xoshiro256PlusPlus::seed_from_u64(11);
        Self { flown, config, examiner, rng, refused: 0, uncertified: 0 }
    }

    fn push(&mut self, gains: Certified) -> Ack {
        let now = self.flown.flight.report().sensed.time;
        self.flown.flight.apply(&Command::UseGains(gains), now)
    }

    /// A design that must not be flown, of one of five sorts.
    fn bad_design(&mut self, n: u32) -> Design {
        let k: [Gain; 2] = self.flown.flight.gains_in_use().law.gains().map(|[k, attitude]| [*k, *attitude]).unwrap();
        let rng = &mut self.rng;
        let mut design = Design::from_weights(self.config.design.weights);
        match n % 5 {
            // Malformed weights.
            0 => {
                let bad = [f64::NAN, f64::INFINITY, -1.0, -1e-300, 1e13][rng.random_range(0..5)];
                match rng.random_range(0..20) {
                    i @ 0..16 => design.weights.state[i] = bad,
                    i => design.weights.input[i - 16] = bad,
                }
            }
            // Malformed K.
            1 => {
                let mut spoiled = k;
                let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e7][rng.random_range(0..4)];
                spoiled[rng.random_range(0..2)][(rng.random_range(0..4), rng.random_range(0..16))] = bad;
                design.k = Some(spoiled);
            }
            // Destabilising K: one loop with the wrong sign.
            2 => {
                let mut spoiled = k;
                let row = rng.random_range(0..4);
                let factor = -rng.random_range(0.05..5.0);
                spoiled.iter_mut().for_each(|k| k.row_mut(row).scale_mut(factor));
                design.k = Some(spoiled);
            }
            // Far too loud for lag and delay.
            3 => {
                let mut spoiled = k;
                let factor = rng.random_range(30.0..300.0);
                spoiled.iter_mut().for_each(|k| *k *= factor);
                design.k = Some(spoiled);
            }
            // Weights that ask for it.
            _ => {
                let eager = 10.0_f64.powf(rng.random_range(-12.0..-6.0));
                design.weights.input = design.weights.input.map(|w| (w * eager).max(1e-9));
                design.weights.state = design.weights.state.map(|w| (w / eager).min(1e12));
            }
        }
        design
    }

    /// Certified gains no further from those in use than the policy allows while armed. Weights four times more or less
    /// each give a K up to sixteen times the one before: those few are refused, and drawn again, as are those whose
    /// margins the policy does not admit.
    fn good_gains(&mut self, revision: u32) -> Certified {
        loop {
            let mut design = Design::from_weights(self.config.design.weights);
            let mut spread = || 4.0_f64.powf(self.rng.random_range(-1.0..1.0));
            design.weights.state = design.weights.state.map(|w| w * spread());
            design.weights.input = design.weights.input.map(|w| w * spread());
            let gains = match self.examiner.certify(&design, GainsRevision(revision)) {
                Ok(gains) => gains,
                Err(error) => {
                    self.uncertified += 1;
                    assert!(self.uncertified <= GOOD, "more designs refused than certified: {error}");
                    continue;
                }
            };
            let (_, change) = gains.change_from(self.flown.flight.gains_in_use()).unwrap();
            if change <= self.config.margins.change_max {
                return gains;
            }
            let ack = self.push(gains);
            assert!(!ack.accepted && ack.reason.contains("change"), "{change}: {}", ack.reason);
            self.refused += 1;
        }
    }
}

fn fly(flown: &mut Headless, ticks: usize) {
    for _ in 0..ticks {
        let sensed = flown.sense();
        flown.fly(&sensed);
    }
}

/// Ten thousand bad designs refused, a thousand good ones applied, one after the other in one flight.
fn pushes() {
    let mut pushed = Pushed::start();
    bad_pushes(&mut pushed);
    good_pushes(&mut pushed);
}

fn bad_pushes(pushed: &mut Pushed) {
    let before = pushed.flown.flight.gains_in_use().sha256;
    let mut applied = 0;
    for n in 0..BAD {
        let design = pushed.bad_design(n);
        if let Ok(gains) = pushed.examiner.certify(&design, GainsRevision(n + 1)) {
            applied += u32::from(pushed.push(gains).accepted);
        }
        if n % 20 == 0 {
            fly(&mut pushed.flown, 1);
        }
    }
    line("bad_pushes", f64::from(BAD), "pushes", None);
    line("bad_pushes_applied", f64::from(applied), "pushes", Some(0.0));
    assert_eq!(before, pushed.flown.flight.gains_in_use().sha256, "a refused push changed the gains");
}

fn good_pushes(pushed: &mut Pushed) {
    let rate = pushed.flown.scenario.tick_rate_hz;
    let (mut applied, mut worst, mut lost) = (0, 0.0_f64, 0);
    let (mut least_up, mut least_phase, mut peak) = (f64::INFINITY, f64::INFINITY, 0.0_f64);
    for n in 0..GOOD {
        let gains = pushed.good_gains(BAD + n + 1);
        for found in &gains.margins.loops {
            least_up = least_up.min(found.gain_up);
            least_phase = least_phase.min(found.phase_rad.to_degrees());
            peak = peak.max(found.peak_sensitivity);
        }
        let thrust_n = pushed.flown.flight.report().given.thrust_n;
        applied += u32::from(pushed.push(gains).accepted);
        fly(&mut pushed.flown, 1);
        let jump_n = (pushed.flown.flight.report().given.thrust_n - thrust_n).abs();
        worst = worst.max(jump_n / pushed.config.airframe.weight_n());
        fly(&mut pushed.flown, (0.1 * rate) as usize);
        let z = pushed.flown.truth().position_enu_m.z;
        lost += u32::from(!z.is_finite() || (z - 0.5).abs() > 0.3 || !pushed.flown.flight.report().armed);
    }
    let margins = pushed.config.margins;
    line("good_pushes_least_gain_margin", least_up, "1", Some(margins.gain_up_min));
    line("good_pushes_least_phase_margin", least_phase, "deg", Some(margins.phase_min_rad.to_degrees()));
    line("good_pushes_largest_sensitivity", peak, "1", Some(margins.sensitivity_max));
    line("designs_refused_for_their_margins", f64::from(pushed.uncertified), "designs", None);
    line("pushes_refused_for_their_change", f64::from(pushed.refused), "pushes", None);
    line("good_pushes_applied", f64::from(applied), "pushes", Some(f64::from(GOOD)));
    line("good_pushes_largest_bump", 100.0 * worst, "% of the weight", Some(100.0 * BUMP));
    line("good_pushes_that_lost_the_altitude", f64::from(lost), "pushes", Some(0.0));
}
