//! `cargo xtask reproduce strategies`: the control chapter of [Strategies] with its mistakes put right, and every
//! controller of the agent on the same flights. `--flights N` flies so many take-offs of each controller, `--quick` two,
//! `--seed-base N` others.

use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_agent::command::Command;
use plumbline_agent::control::hinf::reduction::balance;
use plumbline_agent::control::hinf::strategies::{self, CHANNELS, ChannelWeights, INPUT, tracking, whole_plant};
use plumbline_agent::control::hinf::weights::{Weight, mixed_sensitivity};
use plumbline_agent::control::lqg::{OUTPUTS, Replica};
use plumbline_agent::control::margins::continuous_margins;
use plumbline_agent::control::trajectory::{Shape, Trajectory, moment};
use plumbline_agent::control::tuning::{KINDS, kind_name};
use plumbline_agent::linalg::{Complex, hinf_norm};
use plumbline_agent::mix::Mixer;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::discretize::zero_order_hold;
use plumbline_agent::model::integrate::rk4;
use plumbline_agent::model::motor;
use plumbline_agent::model::rigid_body::{Input, State, derivative};
use plumbline_agent::model::state_space::StateSpace;
use plumbline_agent::types::{ControllerKind, EstimatorKind, ROTORS, Wrench};
use plumbline_experiment::draw::parallel;
use plumbline_support::effort::{Effort, Knows};
use plumbline_support::headless::Headless;
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use crate::figures::quantile;
use crate::paternain::take_offs::{AIRBORNE_M, Flown, TakeOff};

type Done<T> = Result<T, Box<dyn std::error::Error>>;

pub fn run() -> Done<()> {
    let effort = Effort::of_program(Knows { seed: 1, flights: Some([20, 2]), worlds: false, parts: false });
    let mut report =
        Report::open("reproduce", "strategies", "Control strategies: LQG, H-infinity, and all controllers in flight")?;
    lqg(&mut report)?;
    hinf(&mut report)?;
    flights(&mut report, &effort)?;
    telephone(&mut report, &effort)?;
    report.finish()?;
    Ok(())
}

/// Unit step of input `channel` answered at output `channel`: (t, y).
fn step(system: &StateSpace, channel: usize, until_s: f64, dt_s: f64) -> Vec<(f64, f64)> {
    let held = zero_order_hold(&system.a, &system.b, dt_s).unwrap();
    let mut x = DVector::zeros(system.order());
    (0..=(until_s / dt_s) as usize)
        .map(|k| {
            let y = (&system.c * &x)[channel] + system.d[(channel, channel)];
            x = &held.a * &x + held.b.column(channel);
            (k as f64 * dt_s, y)
        })
        .collect()
}

fn overshoot_percent(curve: &[(f64, f64)]) -> f64 {
    let last = curve.last().map_or(1.0, |p| p.1);
    100.0 * (curve.iter().map(|p| p.1 / last).fold(0.0, f64::max) - 1.0)
}

fn degrees(rad: f64) -> String {
    format!("{:.1}", rad.to_degrees())
}

fn lqg(report: &mut Report) -> Done<()> {
    report.heading("LQG");
    report.paragraph(
        "Q = C'C, R = 0.7 I, Qe = BB', Re = 0.9 I as printed. The reference gain is v = -(C (A+BF)^-1 B)^-1; as printed, \
         with FeC in it, the outputs would go 25.7 (x, y) and 3.8 (z, yaw) times too far. The loop is \
         [A, BF; -FeC, A+BF+FeC].",
    );
    let iris = Airframe::iris();
    let lqg = Replica::printed(&iris)?;
    let c = lqg.plant.c.clone();
    let (v, literal) = (lqg.reference_gain(&c)?, lqg.literal_reference_gain(&c)?);
    let closed = lqg.closed_loop(Some(&v));
    let driven = lqg.closed_loop(None);
    let mut plot = Plot::new("LQG, unit steps with v", "t, s", "output over reference");
    let mut other = Plot::new("LQG, the reference subtracted from the measurement", "t, s", "output over reference");
    for (i, name) in CHANNELS.into_iter().enumerate() {
        let (with_v, without) = (step(&closed, i, 10.0, 0.02), step(&driven, i, 14.0, 0.02));
        report.value(
            &format!("lqg/overshoot/{name}"),
            overshoot_percent(&with_v),
            "%",
            json!({ "how": "u = F x + v r" }),
        );
        report.value(&format!("lqg/overshoot_error_driven/{name}"), overshoot_percent(&without), "%", json!({}));
        plot = plot.with(Series::line(name, with_v));
        other = other.with(Series::line(name, without));
    }
    report.figure("lqg_steps", "Steps of each reference; no steady error.", &plot)?;
    report.figure("lqg_error_driven", "The same controller without v: it works, and overshoots far.", &other)?;
    let gain = |v: &DMatrix<f64>| lqg.closed_loop(Some(v)).response(Complex::new(0.0, 0.0)).map(|y| y.map(|z| z.re));
    let (right, wrong) = (gain(&v)?, gain(&literal)?);
    for (i, name) in CHANNELS.into_iter().enumerate() {
        report.value(&format!("lqg/steady_gain/{name}"), right[(i, i)], "1", json!({ "literal_v": wrong[(i, i)] }));
    }
    let nine = StateSpace {
        c: DMatrix::from_fn(9, 12, |r, c| if OUTPUTS[r] == c { 1.0 } else { 0.0 }),
        d: DMatrix::zeros(9, 4),
        ..lqg.plant.clone()
    };
    let (acceleration, turn) = (0.3_f64.powi(2), 1.0);
    let qe = DMatrix::from_fn(12, 12, |r, c| match r {
        _ if r != c => 0.0,
        3..=5 => acceleration,
        9..=11 => turn,
        _ => 0.0,
    });
    let re = DMatrix::from_fn(9, 9, |r, c| if r == c { [4e-6, 2.5e-7, 1e-6][r / 3] } else { 0.0 });
    let safe = Replica::new(nine, &(c.transpose() * &c), &(DMatrix::<f64>::identity(4, 4) * 0.7), &qe, &re)?;
    let mut rows = Vec::new();
    for (outputs, design) in [("four, as printed", &lqg), ("nine, as flown", &safe)] {
        let (loops, whole) = continuous_margins(&design.plant, &design.controller())?;
        report.value(
            &format!("lqg/peak_sensitivity/{}", outputs.replace(", ", "_").replace(' ', "_")),
            whole,
            "1",
            json!({}),
        );
        for (i, name) in CHANNELS.into_iter().enumerate() {
            let m = &loops[INPUT[i]];
            rows.push(vec![
                outputs.into(),
                name.into(),
                degrees(m.phase_rad),
                format!("{:.2}", m.gain_up),
                format!("{:.2}", m.gain_down),
                format!("{:.1}", 1e3 * m.delay_s),
                format!("{:.2}", m.peak_sensitivity),
            ]);
        }
    }
    report.table(
        "lqg_margins",
        "Margins of each loop, motors without lag: why the design as printed does not fly.",
        &["outputs", "channel", "phase, deg", "gain up", "gain down", "delay, ms", "peak of S"],
        &rows,
    )?;
    Ok(())
}

fn hinf(report: &mut Report) -> Done<()> {
    report.heading("H-infinity");
    report.paragraph(
        "As printed the problem is ill-posed: the plant's poles at zero are on the axis and nothing enters at its input. \
         A disturbance of size epsilon does. Truncating the last four balanced states, as the source does, makes the \
         loop unstable; residualising the fastest pole of each channel keeps it.",
    );
    let iris = Airframe::iris();
    let plant = whole_plant(&iris);
    let seed = |epsilon| [ChannelWeights::printed(epsilon); 4];
    let weights = |wb, ku, kh, pk, epsilon| ChannelWeights {
        performance: Weight::performance(wb, 2.0, 1e-3),
        effort: Weight::effort(ku, kh, pk),
        epsilon,
    };
    let horizontal = weights(0.2, 1.0, 0.1, 200.0, 1e-3);
    let better = [horizontal, horizontal, weights(0.7, 15.0, 0.5, 100.0, 0.05), weights(0.8, 0.5, 0.03, 100.0, 0.003)];
    let mut rows = Vec::new();
    let mut plot = Plot::new("H-infinity, unit steps of x", "t, s", "x over reference");
    for (name, weights) in [("epsilon 0.1", seed(0.1)), ("epsilon 0.01", seed(0.01)), ("better weights", better)] {
        let (full, reduced, gammas) = strategies::controllers(&iris, &weights, 1.001, 1e-9)?;
        let stem = name.replace(' ', "_");
        for (channel, gamma) in CHANNELS.into_iter().zip(gammas) {
            report.value(&format!("hinf/gamma_opt/{stem}/{channel}"), gamma, "1", json!({}));
        }
        let balanced = balance(&full)?;
        let truncated = balanced.truncated(16);
        for (what, controller) in [("full", &full), ("residualised", &reduced), ("truncated", &truncated)] {
            let (cells, x) = around(report, &plant, (name, what), controller)?;
            rows.push(cells);
            plot = x.into_iter().fold(plot, Plot::with);
        }
        if name == "better weights" {
            source_flights(report, &iris, &full, &reduced)?;
        }
        let problem = mixed_sensitivity(
            &plant,
            &weights.map(|w| w.performance),
            &weights.map(|w| w.effort),
            // One size for all inputs: that of x (the norm below is of the source's weights only).
            weights[0].epsilon,
        );
        if name != "better weights" {
            let closed = problem.closed(&full);
            let (norm, _) = hinf_norm(&closed.a, &closed.b, &closed.c, &closed.d, 1e-8)?;
            report.value(&format!("hinf/norm/{stem}"), norm, "1", json!({}));
        }
        let values = balanced.values.iter().enumerate().map(|(i, v)| (i as f64 + 1.0, *v)).collect();
        let hankel = Plot::new(&format!("Hankel singular values, {name}"), "state", "value")
            .with(Series::points("full controller", values))
            .axes(plumbline_tests::report::Axis::Linear, plumbline_tests::report::Axis::Log);
        report.figure(&format!("hankel_{stem}"), "The last four are small, and still cannot be dropped.", &hankel)?;
    }
    report.table(
        "hinf_orders",
        "Controllers of 20 and 16 states around the plant.",
        &[
            "weights",
            "controller",
            "order",
            "slowest pole, 1/s",
            "phase margin of x, deg",
            "peak of S",
            "overshoot of x, %",
        ],
        &rows,
    )?;
    report.figure("hinf_steps", "Raw unit steps: the vehicle is never given one.", &plot)?;
    Ok(())
}

/// A controller around the plant: its row of the table, and the step of x where the loop is stable.
fn around(
    report: &mut Report,
    plant: &StateSpace,
    (name, what): (&str, &str),
    controller: &StateSpace,
) -> Done<(Vec<String>, Option<Series>)> {
    let loop_ = tracking(plant, controller);
    let (stem, order, slowest) = (name.replace(' ', "_"), controller.order(), loop_.slowest()?);
    report.value(&format!("hinf/slowest_pole/{stem}/{what}_{order}"), slowest, "1/s", json!({}));
    let mut cells = vec![name.to_string(), what.to_string(), order.to_string(), format!("{slowest:.4}")];
    if slowest < 0.0 {
        let negative = StateSpace { b: -&controller.b, d: -&controller.d, ..controller.clone() };
        let (loops, peak) = continuous_margins(plant, &negative)?;
        let x = step(&loop_, 0, 20.0, 0.01);
        let (phase, over) = (degrees(loops[INPUT[0]].phase_rad), overshoot_percent(&x));
        cells.extend([phase, format!("{peak:.3}"), format!("{over:.0}")]);
        return Ok((cells, Some(Series::line(&format!("{name}, {what} {order}"), x))));
    }
    cells.extend(["unstable".into(), String::new(), String::new()]);
    Ok((cells, None))
}

/// Prefilter of the references, rad/s: the source's controllers answer a raw step with up to twice its size.
const PREFILTER_RADPS: f64 = 0.8;
/// Ticks of the source's controllers, s.
const PERIOD_S: f64 = 0.005;

/// A step of `size` in channel `output` through the prefilter, flown by `controller` (four outputs, exactly known)
/// on the nonlinear Iris with motors' lag, mixer and one tick of delay: curve of the output, largest tilt (rad).
fn source_step(iris: &Airframe, controller: &StateSpace, output: usize, size: f64) -> (Vec<(f64, f64)>, f64) {
    let held = zero_order_hold(&controller.a, &controller.b, PERIOD_S).unwrap();
    let mixer = Mixer::new(iris, f64::INFINITY).unwrap();
    let mut memory = DVector::zeros(controller.order());
    let mut state = State::at_rest(Vector3::z());
    let mut speeds = [iris.hover_speed_radps(); ROTORS];
    let mut waiting = [iris.hover_command(); ROTORS];
    let (mut reference, mut tilt, mut curve) = (0.0, 0.0_f64, Vec::new());
    for tick in 0..(20.0 / PERIOD_S) as u32 {
        let (roll, pitch, yaw) = state.attitude().euler_angles();
        tilt = tilt.max(roll.abs()).max(pitch.abs());
        let p = state.position_enu_m;
        let reached = [p.x, p.y, p.z - 1.0, yaw];
        curve.push((f64::from(tick) * PERIOD_S, reached[output] / size));
        reference += (size - reference) * (1.0 - (-PREFILTER_RADPS * PERIOD_S).exp());
        let mut e = DVector::from_fn(4, |i, _| if i == output { reference - reached[i] } else { -reached[i] });
        (e[0], e[1]) = (yaw.cos() * e[0] + yaw.sin() * e[1], yaw.cos() * e[1] - yaw.sin() * e[0]);
        let u = &controller.c * &memory + &controller.d * &e;
        memory = &held.a * memory + &held.b * e;
        let asked = Wrench { thrust_n: iris.weight_n() + u[0], torque_flu_nm: Vector3::new(u[1], u[2], u[3]) };
        let acting = std::mem::replace(&mut waiting, mixer.mix(&asked).command.throttle);
        let steady = motor::steady_speed(iris, &acting, 1.0);
        let h = 0.5 * PERIOD_S;
        for _ in 0..2 {
            let input = Input::from_rotors(iris, &speeds, &motor::acceleration(iris, &speeds, &steady));
            state = rk4(&state, h, |x| derivative(iris, x, &input)).normalised();
            speeds = motor::after(iris, &speeds, &steady, h);
        }
        if !state.is_finite() {
            return (curve, f64::INFINITY);
        }
    }
    (curve, tilt)
}

/// The source's controllers of 20 and 16 states in the air.
fn source_flights(report: &mut Report, iris: &Airframe, full: &StateSpace, reduced: &StateSpace) -> Done<()> {
    let mut rows = Vec::new();
    let mut plot = Plot::new("Four outputs, 20 and 16 states: a step of 1 m in x", "t, s", "x over reference");
    for controller in [full, reduced] {
        let order = controller.order();
        for (output, size) in [(0, 1.0), (1, 1.0), (2, 0.5), (3, 0.5)] {
            let (curve, tilt) = source_step(iris, controller, output, size);
            let over = 100.0 * (curve.iter().map(|p| p.1).fold(0.0, f64::max) - 1.0);
            let end = curve.last().map_or(f64::NAN, |p| p.1);
            let name = CHANNELS[output];
            report.value(&format!("hinf/nonlinear_overshoot/{order}/{name}"), over, "%", json!({ "end": end }));
            rows.push(vec![order.to_string(), name.into(), format!("{over:.1}"), format!("{end:.3}"), degrees(tilt)]);
            if output == 0 {
                let sparse = curve.iter().step_by(10).copied().collect();
                plot = plot.with(Series::line(&format!("{order} states"), sparse));
            }
        }
    }
    report.table(
        "hinf_source_flights",
        "The source's own structure (x, y, z and yaw in, no attitude) on the nonlinear Iris with motors' lag and one tick of \
         delay, references through 0.8 rad/s. It flies where x and y are known; with a phase margin of 25 degrees in x and y \
         and no hold on the attitude without them, it is not what the agent flies.",
        &["states", "channel", "overshoot, %", "after 20 s", "largest tilt, deg"],
        &rows,
    )?;
    report.figure(
        "hinf_source_steps",
        "Both fly. The drag that the design leaves out halves the damping of the slow pair in x and y (-0.29 to -0.16 1/s): \
         they ring.",
        &plot,
    )?;
    Ok(())
}

/// A flight's figures and curve.
struct Angle {
    /// When it is let go, deg from where it was before it was held.
    from: f64,
    rise_s: Option<f64>,
    beyond: f64,
    curve: Vec<(f64, f64)>,
}

/// Held at an angle (roll, or the heading from where the vehicle held it) and let go.
fn released(effort: &Effort, name: &str, kind: ControllerKind, heading: bool) -> Angle {
    let mut flown = Headless::start_seeded(name, kind, |own| effort.seed(own));
    let held = flown.scenario.script.pushes.iter().map(|push| push.at_s).fold(f64::INFINITY, f64::min);
    let released = flown.scenario.script.pushes.iter().map(|push| push.at_s + push.duration_s).fold(0.0, f64::max);
    let (mut curve, mut before) = (Vec::new(), 0.0);
    flown.run(|tick| {
        let (roll, _, yaw) = tick.truth.world_from_body.euler_angles();
        let (t_s, angle) = (tick.time.as_seconds(), if heading { yaw } else { roll }.to_degrees());
        if heading && t_s < held {
            // As the magnetometer tells it.
            before = angle;
        }
        curve.push((t_s - released, angle - before));
    });
    let after: Vec<(f64, f64)> = curve.iter().copied().filter(|(t, _)| *t >= 0.0).collect();
    let from = after.first().map_or(f64::NAN, |p| p.1);
    let first = |part: f64| after.iter().find(|(_, a)| a / from <= part).map(|p| p.0);
    let rise_s = first(0.1).zip(first(0.9)).map(|(low, high)| low - high);
    let beyond = after.iter().map(|(_, a)| -a * from.signum()).fold(0.0, f64::max);
    curve.retain(|(t, _)| (-0.5..4.0).contains(t));
    Angle { from: from.abs(), rise_s, beyond, curve }
}

/// Root mean square of the distance to the path, m, and the track.
fn follow(effort: &Effort, name: &str, kind: ControllerKind) -> (f64, Vec<(f64, f64)>) {
    let mut flown = Headless::start_seeded(name, kind, |own| effort.seed(own));
    let planned = flown.scenario.script.trajectories.remove(0);
    let mut start = None;
    let (mut sum, mut count, mut track) = (0.0, 0.0_f64, Vec::new());
    let ticks = ((planned.start_s + planned.duration_s) * flown.scenario.tick_rate_hz) as usize;
    let mut from = Vector3::zeros();
    for _ in 0..ticks {
        let sensed = flown.sense();
        let now = sensed.time.as_seconds();
        flown.fly(&sensed);
        if now >= planned.start_s && start.is_none() {
            from = flown.flight.report().setpoint.position_enu_m;
            let path = Trajectory::Shape { shape: planned.shape, duration_s: planned.duration_s };
            let ack = flown.flight.apply(&Command::Trajectory(Some(path)), sensed.time);
            assert!(ack.accepted, "{name}: {}", ack.reason);
            start = Some(now);
        }
        if let Some(start) = start {
            let truth = flown.truth().position_enu_m;
            let shape: Shape = planned.shape;
            sum += (truth - moment(&shape, &from, now - start).position_enu_m).norm_squared();
            count += 1.0;
            track.push((truth.x, truth.y));
        }
    }
    ((sum / count.max(1.0)).sqrt(), track)
}

fn flights(report: &mut Report, effort: &Effort) -> Done<()> {
    report.heading("Every controller in flight");
    report.paragraph(
        "The simulator with its sensors' noise, the agent's own estimator, motors' lag and delay. Every controller with its \
         default design, certified by the standard policy. Paths are fed forward and compared with the true position.",
    );
    let mut rows = Vec::new();
    let blank = |title: &str, unit: &str| Plot::new(title, "t, s", unit);
    let mut rolls = blank("Roll let go at 20 degrees", "roll, deg");
    let mut yaws = blank("Yaw on one string let go at 0.5 rad", "yaw, deg");
    let mut climbs = blank("Take-off to 1 m", "z, m");
    let mut tracks =
        [Plot::new("Circle", "x, m", "y, m"), Plot::new("Sine", "x, m", "y, m"), Plot::new("Square", "x, m", "y, m")];
    for kind in KINDS {
        let name = kind_name(kind);
        let roll = released(effort, "single_axis_roll", kind, false);
        let yaw = released(effort, "string_yaw", kind, true);
        let mut flown = Headless::start_seeded("takeoff", kind, |own| effort.seed(own));
        let mut climb = Vec::new();
        flown.run(|tick| climb.push((tick.time.as_seconds(), tick.truth.position_enu_m.z)));
        let over = climb.iter().map(|p| p.1 - 1.0).fold(0.0, f64::max);
        let yaw_percent = 100.0 * yaw.beyond / yaw.from;
        let rise = |r: Option<f64>| r.unwrap_or(f64::NAN);
        report.value(&format!("flight/roll_rise/{name}"), rise(roll.rise_s), "s", json!({ "limit": 0.4 }));
        report.value(&format!("flight/roll_overshoot/{name}"), roll.beyond, "deg", json!({ "limit": 4.0 }));
        report.value(&format!("flight/yaw_rise/{name}"), rise(yaw.rise_s), "s", json!({ "limit": 1.6 }));
        report.value(&format!("flight/yaw_overshoot/{name}"), yaw_percent, "%", json!({ "limit": 13.0 }));
        report.value(&format!("flight/take_off_overshoot/{name}"), over, "m", json!({ "limit": 0.1 }));
        let mut cells = vec![
            name.to_string(),
            format!("{:.3}", rise(roll.rise_s)),
            format!("{:.2}", roll.beyond),
            format!("{:.3}", rise(yaw.rise_s)),
            format!("{yaw_percent:.1}"),
            format!("{over:.3}"),
        ];
        for (plot, path) in tracks.iter_mut().zip(["circle", "sine", "square"]) {
            let (rmse, track) = follow(effort, path, kind);
            report.value(&format!("flight/{path}_rmse/{name}"), rmse, "m", json!({}));
            cells.push(format!("{rmse:.3}"));
            *plot = plot.clone().with(Series::line(name, track));
        }
        rows.push(cells);
        rolls = rolls.with(Series::line(name, roll.curve));
        yaws = yaws.with(Series::line(name, yaw.curve));
        climbs = climbs.with(Series::line(name, climb));
    }
    report.table(
        "controllers",
        "Limits: roll 0.4 s and 4 deg, yaw 1.6 s and 13 %, take-off 0.1 m.",
        &[
            "controller",
            "roll rise, s",
            "roll overshoot, deg",
            "yaw rise, s",
            "yaw overshoot, %",
            "take-off overshoot, m",
            "circle RMSE, m",
            "sine RMSE, m",
            "square RMSE, m",
        ],
        &rows,
    )?;
    report.figure("roll", "Single-axis rig, held at 20 degrees for 0.4 s.", &rolls)?;
    report.figure("yaw", "One string, held at 0.5 rad for 1.2 s.", &yaws)?;
    report.figure("take_off", "Free flight; the limit is 1.1 m.", &climbs)?;
    for (plot, stem) in tracks.iter().zip(["circle", "sine", "square"]) {
        report.figure(stem, "True positions.", plot)?;
    }
    Ok(())
}

/// The source's vehicle senses with a telephone only.
fn telephone(report: &mut Report, effort: &Effort) -> Done<()> {
    report.heading("With a telephone's sensors");
    report.paragraph(
        "The source senses with a telephone alone: one nine-axis IMU, a barometer, GNSS at 1 Hz. Here the Iris takes off to 1 m \
         and stays there for 28 s with those, in the world of the data sheets, which has GNSS and barometers that drift and wash on \
         the barometer; altitude is judged by truth. Deviations: attitude and position by the agent's EKF, \
         not by the telephone's own filter and the source's (errata 8 to 12); an operator who sees the vehicle keeps it over its place.",
    );
    let mut rows = Vec::new();
    for controller in KINDS {
        let name = kind_name(controller);
        let flown = parallel(effort.flights as usize, |i| {
            let (estimator, seed) = (EstimatorKind::EkfBias, effort.seed_base + i as u64);
            TakeOff { airframe: "iris", world: "datasheet", estimator, controller, seed }.fly()
        });
        let airborne = flown.iter().filter(|f| f.most_m() >= AIRBORNE_M).count();
        let lost = flown.iter().filter(|f| f.lost.is_some()).count();
        let mut over: Vec<f64> = flown.iter().map(|f| (f.most_m() - 1.0).max(0.0)).collect();
        let mut rms: Vec<f64> = flown.iter().map(Flown::rms_m).collect();
        let [over_median, over_most] = [0.5, 1.0].map(|share| quantile(&mut over, share));
        let [rms_median, rms_most] = [0.5, 1.0].map(|share| quantile(&mut rms, share));
        report.value(
            &format!("telephone/altitude/{name}"),
            rms_median,
            "m",
            json!({ "worst": rms_most, "overshoot_median_m": over_median, "overshoot_most_m": over_most,
                "airborne": airborne, "lost": lost, "flights": effort.flights, "seed_base": effort.seed_base, "world": "datasheet" }),
        );
        let metres = |m: f64| format!("{m:.2}");
        let counts = [airborne.to_string(), lost.to_string()];
        let figures = [over_median, over_most, rms_median, rms_most].map(metres);
        rows.push([vec![name.to_string()], counts.to_vec(), figures.to_vec()].concat());
    }
    let headers = ["controller", "airborne", "lost", "overshoot, m", "most", "altitude from 8 s on, m rms", "worst"];
    report.table("telephone", &format!("Medians and worst of {} flights of each.", effort.flights), &headers, &rows)?;
    Ok(())
}
