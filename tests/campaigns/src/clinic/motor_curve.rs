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

/// A line through the readings, and its residual.
struct Fit {
    curve: MotorCurve,
    residual_rpm: f64,
}

impl Fit {
    /// As `calibrate motor-curve` fits it, to speeds brought to nominal voltage by the `voltage_ratio` that is known.
    fn to(points: &[Reading], voltage_ratio: fn(&Reading) -> f64) -> Self {
        let at_nominal =
            |p: &Reading| (command(p.pulse_us), p.read_rpm * std::f64::consts::TAU / 60.0 / voltage_ratio(p));
        let file = motor_curve(&points.iter().map(at_nominal).collect::<Vec<_>>()).unwrap();
        Self { curve: motor_curve_of(&file).unwrap(), residual_rpm: rpm(file.residual.value) }
    }

    /// [Clinic]'s line: whatever the voltage.
    fn line(points: &[Reading]) -> Self {
        Self::to(points, |_| 1.0)
    }

    fn rpm(&self, pulse_us: f64, voltage_ratio: f64) -> f64 {
        rpm(self.curve.speed_radps(command(pulse_us), voltage_ratio))
    }
}

/// [Clinic]'s line of a vehicle on the bench.
pub fn line_measured(world: &str, seed: u64) -> MotorCurve {
    Fit::line(&readings(world, seed, BENCH)).curve
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
    line: Fit,
    calibrated: Fit,
    /// Errors of thrust by the line, and by the curve with the voltage: on the bench and with a battery run down, each as
    /// [`thrust_errors`].
    by_line: [[f64; 2]; 2],
    by_curve: [[f64; 2]; 2],
}

impl Bench {
    fn of(world: &str, seed: u64) -> Self {
        let [points, late] = [BENCH, LATE].map(|charge| readings(world, seed, charge));
        let (line, calibrated) = (Fit::line(&points), Fit::to(&points, |p| p.voltage_ratio));
        let by_line = [&points, &late].map(|points| thrust_errors(points, |p| line.rpm(p.pulse_us, 1.0)));
        let told = |p: &Reading| calibrated.rpm(p.pulse_us, p.voltage_ratio);
        let by_curve = [&points, &late].map(|points| thrust_errors(points, told));
        Self { points, line, calibrated, by_line, by_curve }
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
    let slope = |radps: f64| rpm(radps) / SPAN_US;
    told("line/slope", "rpm/µs", None, &|b| slope(b.line.curve.slope_radps));
    told("line/offset_at_1000_us", "rpm", None, &|b| rpm(b.line.curve.offset_radps));
    told("line/residual", "rpm rms", None, &|b| b.line.residual_rpm);
    told("calibrate/slope", "rpm/µs", Some(slope(airframe.slope_radps)), &|b| slope(b.calibrated.curve.slope_radps));
    let offset = Some(rpm(airframe.offset_radps));
    told("calibrate/offset_at_1000_us", "rpm", offset, &|b| rpm(b.calibrated.curve.offset_radps));
    told("calibrate/residual", "rpm rms", None, &|b| b.calibrated.residual_rpm);
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
    let drawn =
        |fit: &Fit| ends.map(|us| (us, rpm(fit.curve.offset_radps + fit.curve.slope_radps * command(us)))).to_vec();
    let plot = Plot::new("Rotor speed by pulse width", "pulse width, µs", "speed, rpm")
        .with(Series::points("tachometer", bench.points.iter().map(|p| (p.pulse_us, p.read_rpm)).collect()))
        .with(Series::line("line", drawn(&bench.line)))
        .with(Series::dashed("calibrate, at nominal voltage", drawn(&bench.calibrated)));
    report.figure("figure_27", "Figure 27: eight pulse widths, one vehicle, battery nearly full.", &plot).unwrap();
}
