//! Figure 27 (5.5): rotor speed at eight pulse widths by a tachometer, and the straight line through them.
//!
//! [Clinic] prints its points as a picture, so that only what the simulated bench gives can be told: the speed controllers,
//! motors and battery of a world, the vehicle held by its roll axis, all four motors told the same. The simulated motor is
//! linear in its command and proportional to the voltage; what bends the curve is the battery, which gives less the more is
//! drawn. `calibrate motor-curve` fits the same line to speeds brought to the nominal voltage, and is told the voltage when
//! it is used.

use plumbline_agent::calibration::motor_curve::{motor_curve, motor_curve_of};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::motor_curve::MotorCurve;
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::world::{Push, World};
use plumbline_agent::types::ROTORS;
use plumbline_experiment::draw::{Dice, median, parallel, worst};
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use super::Effort;

/// Eight pulse widths, µs: 1000 stands still.
const PULSES_US: [f64; 8] = [1125.0, 1250.0, 1375.0, 1500.0, 1625.0, 1750.0, 1875.0, 2000.0];
/// That at which an Iris is nearest to hovering.
const HOVERS_US: f64 = 1625.0;
/// Pulse widths of command 0, and from there to command 1.
const IDLE_US: f64 = 1000.0;
const SPAN_US: f64 = 1000.0;
/// A command is held so long before the speed is read: the battery's slow sag lasts 5 s.
const HELD_S: f64 = 10.0;
const TICK_S: f64 = 0.005;
/// A tachometer in the hand reads to 0.05 %, and whole revolutions a minute.
const TACHOMETER: f64 = 5e-4;
/// Charge of the battery on the bench, and late in a flight.
const BENCH: f64 = 0.95;
const LATE: f64 = 0.3;

fn rpm(radps: f64) -> f64 {
    radps * 60.0 / std::f64::consts::TAU
}

fn command(pulse_us: f64) -> f64 {
    (pulse_us - IDLE_US) / SPAN_US
}

/// One pulse width held until the speed is steady.
#[derive(Clone, Copy)]
pub struct Reading {
    pulse_us: f64,
    /// By the tachometer, and as it is.
    read_rpm: f64,
    true_rpm: f64,
    /// Of the battery's nominal voltage.
    voltage_ratio: f64,
}

/// Rotor 1 of a vehicle of `seed` in `world` at [`PULSES_US`], one after the other, with a battery of this charge.
fn readings(world: &str, seed: u64, charge: f64) -> Vec<Reading> {
    let text = format!("name = \"bench\"\nworld = \"{world}\"\n[rig.single_axis]\naxis = \"roll\"\n");
    let mut scenario = Scenario::from_toml(&text).unwrap();
    (scenario.seed, scenario.battery_charge) = (seed, Some(charge));
    let nominal_v = scenario.airframe.battery.nominal_v();
    let mut bench = World::new(scenario.beginning());
    let mut dice = Dice::new(seed);
    let held = Push { deflect: Some((nalgebra::Vector3::x(), 0.0)), ..Push::default() };
    let mut reading = |pulse_us: f64| {
        for _ in 0..(HELD_S / TICK_S) as usize {
            bench.step(&[command(pulse_us); ROTORS], &held, TICK_S);
        }
        let true_rpm = rpm(bench.rotor_speed_radps()[0]);
        let read_rpm = (true_rpm * (1.0 + TACHOMETER * dice.normal())).round();
        Reading { pulse_us, read_rpm, true_rpm, voltage_ratio: bench.battery_v() / nominal_v }
    };
    PULSES_US.map(&mut reading).to_vec()
}

/// [Clinic]'s line: revolutions a minute over the pulse width, whatever the voltage.
#[derive(Clone, Copy)]
pub struct Line {
    slope_rpm_per_us: f64,
    /// At 1000 µs.
    offset_rpm: f64,
    residual_rpm: f64,
}

impl Line {
    fn fitted(points: &[Reading]) -> Self {
        let n = points.len() as f64;
        let mean = |of: &dyn Fn(&Reading) -> f64| points.iter().map(of).sum::<f64>() / n;
        let (pulse, speed) = (mean(&|p| p.pulse_us), mean(&|p| p.read_rpm));
        let slope = mean(&|p| (p.pulse_us - pulse) * (p.read_rpm - speed)) / mean(&|p| (p.pulse_us - pulse).powi(2));
        let at = |pulse_us: f64| speed + slope * (pulse_us - pulse);
        let residual_rpm = mean(&|p| (p.read_rpm - at(p.pulse_us)).powi(2)).sqrt();
        Self { slope_rpm_per_us: slope, offset_rpm: at(IDLE_US), residual_rpm }
    }

    /// On the bench of a vehicle, by the readings of [`readings`].
    pub fn measured(world: &str, seed: u64) -> Self {
        Self::fitted(&readings(world, seed, BENCH))
    }

    fn rpm(&self, pulse_us: f64) -> f64 {
        self.offset_rpm + self.slope_rpm_per_us * (pulse_us - IDLE_US)
    }

    /// Rotor speed for a motor command of 0 to 1, rad/s.
    pub fn speed_radps(&self, command: f64) -> f64 {
        self.rpm(IDLE_US + SPAN_US * command) * std::f64::consts::TAU / 60.0
    }
}

/// The line of `calibrate motor-curve`, and its residual.
fn calibrated(points: &[Reading]) -> (MotorCurve, f64) {
    let at_nominal = |p: &Reading| (command(p.pulse_us), p.read_rpm * std::f64::consts::TAU / 60.0 / p.voltage_ratio);
    let file = motor_curve(&points.iter().map(at_nominal).collect::<Vec<_>>()).unwrap();
    (motor_curve_of(&file).unwrap(), rpm(file.residual.value))
}

/// Errors of thrust (speed squared) at `points`, of the thrust there: the largest, and that near hovering.
fn thrust_errors(points: &[Reading], speed_rpm: impl Fn(&Reading) -> f64) -> [f64; 2] {
    let error = |p: &Reading| ((speed_rpm(p) / p.true_rpm).powi(2) - 1.0).abs();
    let largest = points.iter().map(error).fold(0.0, f64::max);
    [largest, points.iter().find(|p| p.pulse_us == HOVERS_US).map_or(f64::NAN, error)]
}

/// One vehicle on the bench and with its battery run down.
struct Bench {
    points: Vec<Reading>,
    line: Line,
    curve: MotorCurve,
    curve_residual_rpm: f64,
    /// Errors of thrust by the line, and by the curve with the voltage: on the bench and with a battery run down, each as
    /// [`thrust_errors`].
    by_line: [[f64; 2]; 2],
    by_curve: [[f64; 2]; 2],
}

impl Bench {
    fn of(world: &str, seed: u64) -> Self {
        let [points, late] = [BENCH, LATE].map(|charge| readings(world, seed, charge));
        let line = Line::fitted(&points);
        let (curve, curve_residual_rpm) = calibrated(&points);
        let by_line = [&points, &late].map(|points| thrust_errors(points, |p| line.rpm(p.pulse_us)));
        let told = |p: &Reading| rpm(curve.speed_radps(command(p.pulse_us), p.voltage_ratio));
        let by_curve = [&points, &late].map(|points| thrust_errors(points, told));
        Self { points, line, curve, curve_residual_rpm, by_line, by_curve }
    }
}

pub fn run(report: &mut Report, effort: &Effort) {
    report.heading("Figure 27: motor calibration curve");
    let benches = parallel(effort.seeds(), |n| Bench::of(&effort.flown.world, effort.flown.seed_base + n as u64));
    let all = |of: &dyn Fn(&Bench) -> f64| benches.iter().map(of).collect::<Vec<_>>();
    let airframe = Airframe::iris().motor_curve;
    let mut told = |name: &str, unit: &str, nominal: Option<f64>, of: &dyn Fn(&Bench) -> f64| {
        let values = all(of);
        let more = json!({ "worst": worst(&values), "airframe": nominal, "vehicles": values.len() });
        report.value(&format!("figure_27/{name}"), median(&values), unit, more);
    };
    told("line/slope", "rpm/µs", None, &|b| b.line.slope_rpm_per_us);
    told("line/offset_at_1000_us", "rpm", None, &|b| b.line.offset_rpm);
    told("line/residual", "rpm rms", None, &|b| b.line.residual_rpm);
    let slope = |radps: f64| rpm(radps) / SPAN_US;
    told("calibrate/slope", "rpm/µs", Some(slope(airframe.slope_radps)), &|b| slope(b.curve.slope_radps));
    let offset = Some(rpm(airframe.offset_radps));
    told("calibrate/offset_at_1000_us", "rpm", offset, &|b| rpm(b.curve.offset_radps));
    told("calibrate/residual", "rpm rms", None, &|b| b.curve_residual_rpm);
    for (when, name) in ["battery_nearly_full", "battery_run_down"].into_iter().enumerate() {
        for (place, name) in [format!("{name}/largest"), format!("{name}/near_hovering")].into_iter().enumerate() {
            told(&format!("thrust_error/line/{name}"), "%", None, &|b| 100.0 * b.by_line[when][place]);
            told(&format!("thrust_error/calibrate/{name}"), "%", None, &|b| 100.0 * b.by_curve[when][place]);
        }
    }
    picture(report, &benches[0]);
}

fn picture(report: &mut Report, bench: &Bench) {
    let ends = [IDLE_US, IDLE_US + SPAN_US];
    let nominal = |pulse_us: f64| rpm(bench.curve.offset_radps + bench.curve.slope_radps * command(pulse_us));
    let plot = Plot::new("Rotor speed by pulse width", "pulse width, µs", "speed, rpm")
        .with(Series::points("tachometer", bench.points.iter().map(|p| (p.pulse_us, p.read_rpm)).collect()))
        .with(Series::line("line", ends.map(|us| (us, bench.line.rpm(us))).to_vec()))
        .with(Series::dashed("calibrate, at nominal voltage", ends.map(|us| (us, nominal(us))).to_vec()));
    report.figure("figure_27", "Figure 27: eight pulse widths, one vehicle, battery nearly full.", &plot).unwrap();
}
