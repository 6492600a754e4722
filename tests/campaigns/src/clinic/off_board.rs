//! Figures 16 to 18 (6.2): flights with a sinusoidal height, tethered and free, decoded afterwards from [Clinic]'s own
//! measurements.
//!
//! What is decoded is his position estimator (3.4.1), of which the height and the vertical velocity share no term with the
//! horizontal ones: x = (z, v_z), ten slots of a tenth of a second, sensors not weighted (Eq. 19, 22, appendix 9.2).
//!
//! | row | from |
//! |---|---|
//! | z, twice | the lasers as they arrive, late by a scan |
//! | v_z, twice | each laser's last two readings, differentiated |
//! | v_z, twice | specific force along body z less g, mean of IMUs 1 and 2 and of 3 and 4, integrated from the recording's beginning; no bias is removed |
//! | u | rotor speeds squared of the line of Figure 27, as commanded, the voltage unknown; beside it by the airframe's curve and the voltage. The floor and the tether are not known |
//!
//! Flown by altitude hold on the plain EKF, once told of its tether and once not, and by an operator's stick sideways: [Clinic]'s
//! pilot flew all of it by hand. `lanes` and the window decoder run beside on the same frames, with their own measurements.

use nalgebra::{SMatrix, SVector};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::estimate::secure::Program;
use plumbline_agent::estimate::secure::newton::Settings;
use plumbline_agent::estimate::secure::window::{Model, Row, Window};
use plumbline_agent::flight::{Flight, RigKind};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::motor_curve::MotorCurve;
use plumbline_agent::sensor::height::Height;
use plumbline_agent::sensor::imu::Imu;
use plumbline_agent::sensor::suite::{Sheet as _, Suite};
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::script::Step;
use plumbline_agent::types::{EstimatorKind, GRAVITY_MPS2, MotorCommand};
use plumbline_agent::vehicle::Truth;
use plumbline_experiment::draw::{median, parallel, worst};
use plumbline_experiment::flight::{Setup, fly_to_the_end};
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use super::Effort;
use super::motor_curve::line_measured;

const LASERS: usize = 2;
const IMUS: usize = 4;
const PAIRS: usize = IMUS / 2;
/// The lasers' rate, at which the source decodes.
const SLOT_S: f64 = 0.1;
const SLOTS: usize = 10;
/// The recording begins on the floor, s since boot; take-off is two seconds later.
const RECORDED_FROM_S: f64 = 3.0;
const TAKE_OFF_S: f64 = 5.0;
/// Errors count from here on: in the air, and so long after the floor was left that no window has it.
const JUDGED_FROM_S: f64 = 9.0;
const DURATION_S: f64 = 35.0;
/// Height asked for: about the middle by so much, one swing in so long.
const MIDDLE_M: f64 = 0.7;
const SWING_M: f64 = 0.3;
const PERIOD_S: f64 = 5.0;
/// A figure, its error in the source, %, and how it is flown.
struct Rig {
    figure: &'static str,
    paper: f64,
    name: &'static str,
    text: &'static str,
    /// Does the vehicle know what holds it? Then it is not asked to go beyond it.
    told: bool,
}

/// Taut at 0.85 m, where the upper part of every swing pulls at it.
const TETHER: &str = "[rig.tethered]\nlength_m = 0.8\n";
const RIGS: [Rig; 3] = [
    Rig { figure: "figure_16", paper: 13.0, name: "tethered", text: TETHER, told: false },
    Rig { figure: "figure_16_told", paper: 13.0, name: "tethered_and_told", text: TETHER, told: true },
    Rig { figure: "figure_17", paper: 24.0, name: "free", text: "[rig.free]\nheight_m = 0.0\n", told: true },
];

/// Height and vertical velocity.
type Vertical = SVector<f64, 2>;

/// What is recorded in one slot.
#[derive(Clone)]
struct Slot {
    t_s: f64,
    /// Newest reading of each laser, where one came in this slot, and its velocity since the one before.
    heights_m: [Option<f64>; LASERS],
    laser_mps: [Option<f64>; LASERS],
    integrated_mps: [f64; PAIRS],
    /// Motors, as commanded at the slot's end, and the battery's voltage of the nominal one, which [Clinic] did not record.
    command: MotorCommand,
    voltage_ratio: f64,
    truth: Vertical,
    lanes: Vertical,
    window_decoder: Vertical,
    tension_n: f64,
}

/// Takes a flight down, slot by slot.
struct Recorder {
    slots: Vec<Slot>,
    lasers: [Option<(f64, f64)>; LASERS],
    heights_m: [Option<f64>; LASERS],
    laser_mps: [Option<f64>; LASERS],
    /// Each IMU's last sample, when and what, and what was integrated.
    imus: [Option<(f64, f64)>; IMUS],
    integrated_mps: [f64; IMUS],
    voltage_ratio: f64,
}

impl Recorder {
    fn new() -> Self {
        Self {
            slots: Vec::new(),
            lasers: [None; LASERS],
            heights_m: [None; LASERS],
            laser_mps: [None; LASERS],
            imus: [None; IMUS],
            integrated_mps: [0.0; IMUS],
            voltage_ratio: 1.0,
        }
    }

    fn look(&mut self, flight: &Flight, truth: &Truth) {
        let sensed = &flight.report().sensed;
        let t_s = sensed.time.as_seconds();
        if t_s < RECORDED_FROM_S {
            return;
        }
        for (laser, sample) in sensed.heights.iter().take(LASERS).enumerate() {
            let Some(sample) = sample else { continue };
            let now = (sample.time.as_seconds(), sample.height_m);
            self.heights_m[laser] = Some(now.1);
            self.laser_mps[laser] = self.lasers[laser].map(|before| (now.1 - before.1) / (now.0 - before.0));
            self.lasers[laser] = Some(now);
        }
        for (imu, sample) in sensed.imus.iter().take(IMUS).enumerate() {
            let Some(sample) = sample else { continue };
            let now = (sample.time.as_seconds(), sample.accel_mps2.z - GRAVITY_MPS2);
            if let Some(before) = self.imus[imu] {
                self.integrated_mps[imu] += 0.5 * (now.1 + before.1) * (now.0 - before.0);
            }
            self.imus[imu] = Some(now);
        }
        self.voltage_ratio =
            sensed.battery_v.map_or(self.voltage_ratio, |volts| volts / Airframe::iris().battery.nominal_v());
        if t_s - RECORDED_FROM_S + 1e-6 >= SLOT_S * self.slots.len() as f64 {
            self.close(t_s, flight, truth);
        }
    }

    fn close(&mut self, t_s: f64, flight: &Flight, truth: &Truth) {
        let estimated = |kind: EstimatorKind| {
            let of = flight.estimates().find(|(other, _)| *other == kind);
            let motion = of.and_then(|(_, estimate)| estimate.motion).unwrap_or_default();
            Vertical::new(motion.position_enu_m.z, motion.velocity_enu_mps.z)
        };
        let pair = |first: usize| 0.5 * (self.integrated_mps[first] + self.integrated_mps[first + 1]);
        self.slots.push(Slot {
            t_s,
            heights_m: std::mem::take(&mut self.heights_m),
            laser_mps: std::mem::take(&mut self.laser_mps),
            integrated_mps: [pair(0), pair(2)],
            command: flight.report().command,
            voltage_ratio: self.voltage_ratio,
            truth: Vertical::new(truth.position_enu_m.z, truth.velocity_enu_mps.z),
            lanes: estimated(EstimatorKind::Lanes),
            window_decoder: estimated(EstimatorKind::Secure),
            tension_n: truth.string_tension_n.iter().sum(),
        });
    }
}

fn scenario(rig: &str, world: &str, seed: u64) -> Scenario {
    let mut text = format!(
        "name = \"off_board\"\nduration_s = {DURATION_S}\nworld = \"{world}\"\n[[script]]\nat_s = 2\ndo = \"arm\"\n\
         [[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n"
    );
    text += rig;
    let mut scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    // As smoothly as a hand would: what moves in steps is flown with a thrust that chatters, ten times a second most of all.
    let tick_s = scenario.tick_s();
    let ticks = ((DURATION_S - TAKE_OFF_S) / tick_s) as u32;
    scenario.script.steps.extend((0..ticks).map(|tick| {
        let since_s = f64::from(tick) * tick_s;
        let altitude_m = Some(MIDDLE_M + SWING_M * (std::f64::consts::TAU * since_s / PERIOD_S).sin());
        let command = Command::Setpoint(SetpointChange { altitude_m, ..SetpointChange::default() });
        Step { at_s: TAKE_OFF_S + since_s, command }
    }));
    scenario.seed = seed;
    scenario.suite = Suite::string_rig();
    scenario.suite.heights = (1..=LASERS).map(|i| Height::laser(i, LASERS)).collect();
    scenario.suite.imus = (1..=IMUS).map(Imu::typical).collect();
    scenario
}

/// A flight and its recording.
fn flown(rig: &Rig, world: &str, seed: u64) -> Vec<Slot> {
    let scenario = scenario(rig.text, world, seed);
    let mut config = scenario.flight_config();
    if !rig.told {
        config.rig = RigKind::Free;
    }
    config.estimators = vec![EstimatorKind::EkfBias, EstimatorKind::Secure, EstimatorKind::Lanes];
    config.in_loop = EstimatorKind::EkfBias;
    let setup = Setup::simulated(scenario, config, JUDGED_FROM_S);
    let mut recorder = Recorder::new();
    fly_to_the_end(&setup, |flight, truth| recorder.look(flight, truth)).unwrap();
    recorder.slots
}

/// Rotor speed of a command.
#[derive(Clone, Copy)]
enum Speeds {
    /// By the line of Figure 27.
    Line(MotorCurve),
    /// By the airframe's own curve and the voltage, which `calibrate motor-curve` finds.
    Curve,
}

/// z and v_z over one slot under an acceleration a: [Clinic] Eq. 5 and 8 about hover.
struct Motion {
    airframe: Airframe,
    speeds: Speeds,
    a: SMatrix<f64, 2, 2>,
    b: Vertical,
}

impl Motion {
    fn new(speeds: Speeds) -> Self {
        let airframe = Airframe::iris();
        let drag = airframe.linear_drag_nspm / airframe.mass_kg;
        let kept = (-drag * SLOT_S).exp();
        let moved_s = (1.0 - kept) / drag;
        let a = SMatrix::from([[1.0, 0.0], [moved_s, kept]]);
        Self { airframe, speeds, a, b: Vertical::new((SLOT_S - moved_s) / drag, moved_s) }
    }

    /// What the motors of `slot` add in the next one.
    fn forced(&self, slot: &Slot) -> Vertical {
        let speed_radps = |throttle: f64| match self.speeds {
            Speeds::Line(line) => line.speed_radps(throttle, 1.0),
            Speeds::Curve => self.airframe.motor_curve.speed_radps(throttle, slot.voltage_ratio),
        };
        let squared: f64 = slot.command.throttle.iter().map(|throttle| speed_radps(*throttle).powi(2)).sum();
        self.b * (self.airframe.thrust_coefficient_ns2 * squared / self.airframe.mass_kg - GRAVITY_MPS2)
    }

    /// A window of which no sensor weighs more than another.
    fn window(&self, program: Program) -> Window<2> {
        let row = |c| Row { c, sigma: 1.0, bias_sigma: 0.0 };
        let rows = [row(Vertical::new(1.0, 0.0)), row(Vertical::new(0.0, 1.0))];
        let model = Model { a: self.a, q: SMatrix::zeros() };
        let mut window = Window::new(&model, &rows, &[0, 0, 1, 1, 1, 1], SLOTS, Settings::default()).unwrap();
        window.use_program(program);
        window
    }

    /// The state at the end of every slot, where its window is full.
    fn decode<'a>(&self, slots: &'a [Slot], program: Program) -> Vec<Option<Vertical>> {
        let mut window = self.window(program);
        let mut before: Option<&Slot> = None;
        let mut decode = |slot: &'a Slot| {
            let forced = before.replace(slot).map(|before| self.forced(before));
            window.advance(forced.as_ref());
            let lasers = slot.heights_m.into_iter().chain(slot.laser_mps);
            for (sensor, value) in lasers.chain(slot.integrated_mps.map(Some)).enumerate() {
                value.into_iter().for_each(|value| window.put(sensor, value));
            }
            window.is_ready().then(|| window.decode(|_| false, &[], None).ok().map(|decoded| decoded.x)).flatten()
        };
        slots.iter().map(&mut decode).collect()
    }
}

/// A flight, decoded.
struct Decoded {
    slots: Vec<Slot>,
    /// ℓ1/ℓ2 (Eq. 19), and absolute values summed (3.4.1, what CVXgen solves).
    norms: Vec<Option<Vertical>>,
    absolute: Vec<Option<Vertical>>,
    /// ℓ1/ℓ2 with [`Speeds::Curve`].
    with_voltage: Vec<Option<Vertical>>,
}

impl Decoded {
    fn of(rig: &Rig, effort: &Effort, n: usize) -> Self {
        let seed = effort.flown.seed_base + n as u64;
        let slots = flown(rig, &effort.flown.world, seed);
        let motion = Motion::new(Speeds::Line(line_measured(&effort.flown.world, seed)));
        let [norms, absolute] = [Program::L2, Program::L1].map(|program| motion.decode(&slots, program));
        let with_voltage = Motion::new(Speeds::Curve).decode(&slots, Program::L2);
        Self { slots, norms, absolute, with_voltage }
    }

    /// Slots that are judged, with their places.
    fn judged(&self) -> impl Iterator<Item = (usize, &Slot)> {
        self.slots.iter().enumerate().filter(|(_, slot)| slot.t_s >= JUDGED_FROM_S)
    }

    /// Mean of |value − reference| / reference, %.
    fn relative(&self, value: impl Fn(usize, &Slot) -> Option<f64>, reference: impl Fn(&Slot) -> Option<f64>) -> f64 {
        let errors: Vec<f64> = self
            .judged()
            .filter_map(|(k, slot)| Some(((value(k, slot)? - reference(slot)?) / reference(slot)?).abs()))
            .collect();
        100.0 * errors.iter().sum::<f64>() / errors.len() as f64
    }

    /// Mean of |value − reference| over the mean of |reference|, %: velocities pass through zero.
    fn of_mean(&self, value: impl Fn(usize, &Slot) -> Option<f64>, reference: impl Fn(&Slot) -> Option<f64>) -> f64 {
        let pairs: Vec<(f64, f64)> =
            self.judged().filter_map(|(k, slot)| Some((value(k, slot)?, reference(slot)?))).collect();
        let off: f64 = pairs.iter().map(|(value, reference)| (value - reference).abs()).sum();
        100.0 * off / pairs.iter().map(|(_, reference)| reference.abs()).sum::<f64>()
    }
}

/// Mean of the readings there are.
fn mean(readings: &[Option<f64>]) -> Option<f64> {
    let there: Vec<f64> = readings.iter().copied().flatten().collect();
    (!there.is_empty()).then(|| there.iter().sum::<f64>() / there.len() as f64)
}

pub fn run(report: &mut Report, effort: &Effort) {
    report.heading("Figures 16 to 18: decoded off board");
    for rig in RIGS {
        let flights = parallel(effort.seeds(), |n| Decoded::of(&rig, effort, n));
        heights(report, &rig, &flights);
        velocities(report, rig.name, &flights);
        pictures(report, rig.figure, rig.name, &flights[0]);
    }
}

fn heights(report: &mut Report, rig: &Rig, flights: &[Decoded]) {
    let truth = |slot: &Slot| Some(slot.truth[0]);
    let errors = |of: &dyn Fn(&Decoded) -> f64| flights.iter().map(of).collect::<Vec<_>>();
    let all = errors(&|f| f.relative(|k, _| Some(f.norms[k]?[0]), truth));
    let lasers = errors(&|f| f.relative(|k, _| Some(f.norms[k]?[0]), |slot| mean(&slot.heights_m)));
    let absolute = errors(&|f| f.relative(|k, _| Some(f.absolute[k]?[0]), truth));
    let with_voltage = errors(&|f| f.relative(|k, _| Some(f.with_voltage[k]?[0]), truth));
    let one_laser = errors(&|f| f.relative(|_, slot| slot.heights_m[0], truth));
    let decoder = errors(&|f| f.relative(|_, slot| Some(slot.window_decoder[0]), truth));
    let lanes = errors(&|f| f.relative(|_, slot| Some(slot.lanes[0]), truth));
    let lanes_off_m =
        errors(&|f| f.judged().map(|(_, slot)| (slot.lanes[0] - slot.truth[0]).abs()).fold(0.0, f64::max));
    let taut = errors(&|f| {
        let taut = f.judged().filter(|(_, slot)| slot.tension_n > 0.0).count();
        taut as f64 / f.judged().count() as f64
    });
    let more = json!({ "paper": rig.paper, "worst": worst(&all), "against_lasers": median(&lasers),
        "absolute_values": median(&absolute), "with_voltage": median(&with_voltage), "one_laser": median(&one_laser),
        "window_decoder": median(&decoder), "lanes": median(&lanes), "lanes_worst": worst(&lanes),
        "lanes_off_most_m": worst(&lanes_off_m), "lanes_off_most_median_m": median(&lanes_off_m),
        "taut": median(&taut), "flights": flights.len() });
    report.value(&format!("{}/{}/height_error", rig.figure, rig.name), median(&all), "%", more);
}

fn velocities(report: &mut Report, rig: &str, flights: &[Decoded]) {
    let truth = |slot: &Slot| Some(slot.truth[1]);
    let by_laser = |slot: &Slot| mean(&slot.laser_mps);
    type Of<'a> = &'a dyn Fn(&Decoded, usize, &Slot) -> Option<f64>;
    let rows: [(&str, Option<f64>, Of); 8] = [
        ("estimated", Some(57.0), &|f, k, _| Some(f.norms[k]?[1])),
        ("estimated_absolute_values", None, &|f, k, _| Some(f.absolute[k]?[1])),
        ("estimated_with_voltage", None, &|f, k, _| Some(f.with_voltage[k]?[1])),
        ("integrated_imus_1_2", Some(3000.0), &|_, _, slot| Some(slot.integrated_mps[0])),
        ("integrated_imus_3_4", Some(8000.0), &|_, _, slot| Some(slot.integrated_mps[1])),
        ("laser_1_differentiated", None, &|_, _, slot| slot.laser_mps[0]),
        ("window_decoder", None, &|_, _, slot| Some(slot.window_decoder[1])),
        ("lanes", None, &|_, _, slot| Some(slot.lanes[1])),
    ];
    for (name, paper, of) in rows {
        let all: Vec<f64> = flights.iter().map(|f| f.of_mean(|k, slot| of(f, k, slot), truth)).collect();
        let lasers: Vec<f64> = flights.iter().map(|f| f.of_mean(|k, slot| of(f, k, slot), by_laser)).collect();
        let more = json!({ "paper": paper, "worst": worst(&all), "against_lasers": median(&lasers), "flights": flights.len() });
        report.value(&format!("figure_18/{rig}/{name}"), median(&all), "%", more);
    }
}

fn pictures(report: &mut Report, figure: &str, rig: &str, flight: &Decoded) {
    let line = |of: &dyn Fn(usize, &Slot) -> Option<f64>| {
        let slots = flight.slots.iter().enumerate();
        slots.filter_map(|(k, slot)| Some((slot.t_s - RECORDED_FROM_S, of(k, slot)?))).collect::<Vec<_>>()
    };
    let plot = Plot::new(&format!("Height, {rig}"), "t, s", "z, m")
        .with(Series::dashed("truth", line(&|_, slot| Some(slot.truth[0]))))
        .with(Series::points("mean of the lasers", line(&|_, slot| mean(&slot.heights_m))))
        .with(Series::line("decoded off board", line(&|k, _| Some(flight.norms[k]?[0]))))
        .with(Series::line("lanes", line(&|_, slot| Some(slot.lanes[0]))));
    let number = figure.trim_start_matches("figure_").trim_end_matches("_told");
    let caption = format!("Figure {number}: on the floor for the first two seconds; his measurements, ℓ1/ℓ2.");
    report.figure(figure, &caption, &plot).unwrap();
    let plot = Plot::new(&format!("Vertical velocity, {rig}"), "t, s", "v_z, m/s")
        .with(Series::line("laser 1", line(&|_, slot| slot.laser_mps[0])))
        .with(Series::line("laser 2", line(&|_, slot| slot.laser_mps[1])))
        .with(Series::line("IMUs 1 and 2", line(&|_, slot| Some(slot.integrated_mps[0]))))
        .with(Series::line("IMUs 3 and 4", line(&|_, slot| Some(slot.integrated_mps[1]))))
        .with(Series::line("decoded off board", line(&|k, _| Some(flight.norms[k]?[1]))));
    let caption = "Figure 18: what the velocity is decoded from, accelerations integrated without removing a bias.";
    report.figure(&format!("figure_18_{rig}"), caption, &plot).unwrap();
}
