//! The simulator against physics it does not contain: closed forms, energy, statistics, and itself.

use std::hash::{DefaultHasher, Hash, Hasher};

use nalgebra::Vector3;
use plumbline_agent::frames::roll_pitch_yaw;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sim::rig::{Axis, Free, HangingStrings, Rig, SingleAxis, Tethered};
use plumbline_agent::sim::world::{Beginning, Disturbance, Push, World};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::{GRAVITY_MPS2, MotorCommand};
use plumbline_agent::vehicle::Vehicle;

const TICK_S: f64 = 0.005;
const OFF: [f64; 4] = [0.0; 4];

fn run(world: &mut World, seconds: f64, throttle: &[f64; 4], mut each: impl FnMut(f64, &World)) {
    for tick in 0..(seconds / TICK_S).round() as usize {
        world.step(throttle, &Push::default(), TICK_S);
        each((tick + 1) as f64 * TICK_S, world);
    }
}

/// Like the Iris, without drag: closed forms and energy are exact.
fn no_drag() -> Airframe {
    Airframe { linear_drag_nspm: 0.0, ..Airframe::iris() }
}

/// Kinetic, potential and the strings' elastic energy.
fn energy(a: &Airframe, world: &World) -> f64 {
    let x = world.body();
    let spin = a.inertia_kgm2.dot(&x.body_rates_radps.component_mul(&x.body_rates_radps));
    let attitude = x.attitude();
    let mut elastic = 0.0;
    for line in &world.mounted().lines {
        let knot = x.position_enu_m + attitude * line.knot_flu_m;
        let stretch = ((line.hook_enu_m - knot).norm() - line.rest_length_m).max(0.0);
        elastic += 0.5 * line.stiffness_npm * stretch * stretch;
    }
    0.5 * a.mass_kg * x.velocity_enu_mps.norm_squared() + 0.5 * spin + a.weight_n() * x.position_enu_m.z + elastic
}

#[test]
fn free_fall_follows_the_parabola_and_weighs_nothing() {
    // GIVEN a vehicle thrown at 50 m without drag, WHEN it falls for 2 s, THEN p = p0 + v t − g t²/2.
    let mut beginning = Beginning::calm(no_drag(), Rig::Free(Free { height_m: 50.0 }));
    beginning.velocity_enu_mps = Vector3::new(3.0, -2.0, 5.0);
    beginning.body_rates_radps = Vector3::new(0.3, -0.2, 1.0);
    let mut world = World::new(beginning);
    run(&mut world, 2.0, &OFF, |_, w| assert!(w.specific_force_flu_mps2().norm() < 1e-9));
    let expected = Vector3::new(6.0, -4.0, 50.0 + 10.0 - 0.5 * GRAVITY_MPS2 * 4.0);
    assert!((world.body().position_enu_m - expected).norm() < 1e-9);
}

#[test]
fn drag_brings_the_speed_down_exponentially() {
    // GIVEN the Iris in level flight at hover thrust, WHEN nothing pushes, THEN v = v0 exp(−k_d t / m).
    let a = Airframe::iris();
    let mut beginning = Beginning::calm(a.clone(), Rig::Free(Free { height_m: 20.0 }));
    beginning.velocity_enu_mps = Vector3::new(4.0, 0.0, 0.0);
    let mut world = World::new(beginning);
    run(&mut world, 2.0, &[a.hover_command(); 4], |_, _| {});
    let expected = 4.0 * (-a.linear_drag_nspm * 2.0 / a.mass_kg).exp();
    assert!((world.body().velocity_enu_mps.x - expected).abs() < 1e-6);
}

#[test]
fn hover_command_hovers() {
    for name in Airframe::NAMES {
        // GIVEN no drag, WHEN all motors run at the hover command for a second, THEN nothing accelerates.
        let a = Airframe { linear_drag_nspm: 0.0, ..Airframe::by_name(name).unwrap() };
        let mut world = World::new(Beginning::calm(a.clone(), Rig::Free(Free { height_m: 20.0 })));
        run(&mut world, 1.0, &[a.hover_command(); 4], |_, _| {});
        let before = *world.body();
        run(&mut world, TICK_S, &[a.hover_command(); 4], |_, _| {});
        let accel = (world.body().velocity_enu_mps - before.velocity_enu_mps) / TICK_S;
        assert!(accel.norm() < 1e-6, "{name}: {accel:?}");
        assert!(before.body_rates_radps.norm() < 1e-9, "{name}: {:?}", before.body_rates_radps);
    }
}

#[test]
fn feet_rest_on_the_floor_and_do_not_creep() {
    for name in Airframe::NAMES {
        // GIVEN a drop from 30 cm with a tilt and a sideways speed, THEN it comes to rest on its feet.
        let a = Airframe::by_name(name).unwrap();
        let mut beginning = Beginning::calm(a.clone(), Rig::Free(Free { height_m: 0.3 }));
        beginning.roll_pitch_yaw_rad = Vector3::new(0.15, -0.1, 0.7);
        beginning.velocity_enu_mps = Vector3::new(0.3, 0.1, -0.5);
        let mut world = World::new(beginning);
        run(&mut world, 3.0, &OFF, |_, _| {});
        let at_rest = world.body().position_enu_m;
        assert!((world.load().ground_n / a.weight_n() - 1.0).abs() < 1e-3, "{name}");
        let rpy = roll_pitch_yaw(&world.body().attitude());
        assert!(rpy.xy().norm() < 1e-3, "{name} lies at {rpy}");
        run(&mut world, 5.0, &OFF, |_, _| {});
        assert!((world.body().position_enu_m - at_rest).norm() < 1e-4, "{name} creeps");
        // The specific force at rest is +g up.
        assert!((world.specific_force_flu_mps2() - Vector3::new(0.0, 0.0, GRAVITY_MPS2)).norm() < 0.02);
    }
}

#[test]
fn contacts_only_take_energy() {
    // GIVEN a tumbling drop from 2 m, THEN energy never rises by more than 1 % and the bounce stays below half.
    let a = no_drag();
    let mut beginning = Beginning::calm(a.clone(), Rig::Free(Free { height_m: 2.0 }));
    beginning.roll_pitch_yaw_rad = Vector3::new(0.5, 0.3, 0.0);
    beginning.body_rates_radps = Vector3::new(2.0, -1.0, 1.0);
    let mut world = World::new(beginning);
    let start = energy(&a, &world);
    let mut top_after = 0.0f64;
    run(&mut world, 6.0, &OFF, |t, w| {
        assert!(energy(&a, w) < 1.01 * start, "at {t}: {} of {start}", energy(&a, w));
        if t > 1.0 {
            top_after = top_after.max(w.body().position_enu_m.z);
        }
    });
    assert!(top_after < 1.0, "bounced to {top_after} m");
    assert!(world.body().velocity_enu_mps.norm() < 0.05);
}

#[test]
fn hangs_still_at_its_height_with_equal_taut_strings() {
    for strings in [1, 4] {
        let a = Airframe::iris();
        let rig = HangingStrings { strings, height_m: 0.6, ..HangingStrings::default() };
        let mut world = World::new(Beginning::calm(a.clone(), Rig::HangingStrings(rig)));
        run(&mut world, 2.0, &OFF, |_, _| {});
        assert!((world.body().position_enu_m - Vector3::new(0.0, 0.0, 0.6)).norm() < 1e-9);
        let load = world.load();
        assert!((load.force_enu_n.z - a.weight_n()).abs() < 1e-6);
        let tensions = &load.tension_n[..strings];
        assert!(tensions.iter().all(|t| *t > 0.0 && (t - tensions[0]).abs() < 1e-9), "{tensions:?}");
        assert!(load.tension_n[strings..].iter().all(|t| *t == 0.0));
    }
}

#[test]
fn one_string_swings_with_the_period_of_a_pendulum() {
    // GIVEN the vehicle on one long string at its centre of mass, WHEN it swings by 2°, THEN its period is
    // 2π √(l/g), l from hook to centre of mass.
    let (length, angle) = (3.0, 2f64.to_radians());
    let rig = HangingStrings {
        strings: 1,
        height_m: 1.0,
        ceiling_m: 1.0 + length,
        knot_above_m: 0.0,
        stretch_m: 0.005,
        ..HangingStrings::default()
    };
    let mut beginning = Beginning::calm(no_drag(), Rig::HangingStrings(rig));
    beginning.offset_enu_m = Vector3::new(length * angle.sin(), 0.0, length * (1.0 - angle.cos()));
    let mut world = World::new(beginning);
    let mut crossings = Crossings::new(world.body().position_enu_m.x);
    run(&mut world, 20.0, &OFF, |t, w| crossings.add(t, w.body().position_enu_m.x));
    let expected = std::f64::consts::TAU * (length / GRAVITY_MPS2).sqrt() * (1.0 + angle * angle / 16.0);
    let period = crossings.period();
    // The stretch swings too: its share is (angle²) of the length.
    assert!((period / expected - 1.0).abs() < 1e-3, "{period} s, expected {expected} s");
}

/// Downward zero crossings of a sampled swing.
struct Crossings {
    before: f64,
    times: Vec<f64>,
}

impl Crossings {
    fn new(start: f64) -> Self {
        Self { before: start, times: Vec::new() }
    }

    fn add(&mut self, t: f64, value: f64) {
        if self.before > 0.0 && value <= 0.0 {
            self.times.push(t - TICK_S * value / (value - self.before));
        }
        self.before = value;
    }

    fn period(&self) -> f64 {
        let turns = self.times.len() - 1;
        assert!(turns >= 4, "{:?}", self.times);
        (self.times[turns] - self.times[0]) / turns as f64
    }
}

#[test]
fn strings_go_slack_when_lifted_and_catch_without_giving_energy() {
    // GIVEN the Iris lifted 0.5 m above its hanging height without thrust, WHEN it drops, THEN it falls freely
    // on slack strings, is caught, never gains energy, and ends hanging where it began.
    for strings in [1, 4] {
        let a = no_drag();
        let rig = HangingStrings { strings, height_m: 1.0, ..HangingStrings::default() };
        let mut beginning = Beginning::calm(a.clone(), Rig::HangingStrings(rig));
        beginning.offset_enu_m = Vector3::new(0.02, -0.01, 0.5);
        let mut world = World::new(beginning);
        let start = energy(&a, &world);
        let (mut fell_freely, mut lowest, mut hardest) = (false, f64::MAX, 0.0f64);
        run(&mut world, 60.0, &OFF, |t, w| {
            assert!(energy(&a, w) < start * 1.001, "{strings} strings at {t}: {} of {start}", energy(&a, w));
            fell_freely |= t < 0.3 && w.load().tension_n == [0.0; 4] && w.specific_force_flu_mps2().norm() < 1e-9;
            lowest = lowest.min(w.body().position_enu_m.z);
            hardest = hardest.max(w.load().force_enu_n.z);
        });
        assert!(fell_freely);
        assert!(lowest > 0.8 && lowest < 1.0, "{strings} strings caught it at {lowest} m");
        assert!(hardest > 3.0 * a.weight_n(), "{hardest} N");
        assert!((world.body().position_enu_m.z - 1.0).abs() < 0.01, "{}", world.body().position_enu_m);
        assert!(world.load().tension_n[0] > 0.0);
    }
}

#[test]
fn what_a_drop_onto_the_strings_leaves_is_still_in_seconds() {
    // GIVEN a vehicle dropped askew from 0.2 m above its strings, WHEN ten seconds have passed, THEN it may be armed again (30 °/s).
    let rig = HangingStrings { height_m: 1.0, ..HangingStrings::default() };
    let mut beginning = Beginning::calm(Airframe::iris(), Rig::HangingStrings(rig));
    beginning.offset_enu_m = Vector3::new(0.05, 0.02, 0.2);
    beginning.roll_pitch_yaw_rad = Vector3::new(0.05, -0.03, 0.1);
    let mut world = World::new(beginning);
    let (mut shaken, mut after) = (0.0f64, 0.0f64);
    run(&mut world, 20.0, &OFF, |t, w| {
        let rates_radps = w.body().body_rates_radps.norm();
        if t < 10.0 {
            shaken = shaken.max(rates_radps);
        } else {
            after = after.max(rates_radps);
        }
    });
    let [shaken, after] = [shaken, after].map(f64::to_degrees);
    assert!(shaken > 40.0 && after < 10.0, "{shaken} °/s, then {after}");
}

#[test]
fn a_tether_holds_down_what_would_fly_away() {
    // GIVEN more thrust than weight, WHEN the tether is taut, THEN it stays within its reach, pulling on average
    // by what is too much.
    let a = no_drag();
    let throttle = 0.75;
    let excess = 4.0 * a.thrust_coefficient_ns2 * a.motor_curve.speed_radps(throttle, 1.0).powi(2) - a.weight_n();
    let rig = Tethered { length_m: 1.0, ..Tethered::default() };
    let mut world = World::new(Beginning::calm(a, Rig::Tethered(rig)));
    run(&mut world, 0.2, &[throttle; 4], |_, w| assert_eq!(w.load().tension_n[0], 0.0));
    run(&mut world, 20.0, &[throttle; 4], |_, w| assert!(w.body().position_enu_m.z < 1.15));
    let mut pull = 0.0;
    run(&mut world, 20.0, &[throttle; 4], |_, w| pull += w.load().tension_n[0] / 4000.0);
    assert!(excess > 1.0 && (pull / excess - 1.0).abs() < 0.1, "{pull} N, expected {excess} N");
    assert!((world.body().position_enu_m.z - 1.05).abs() < 0.02, "{}", world.body().position_enu_m);
}

#[test]
fn a_single_axis_stays_on_its_axis_and_swings_as_a_pendulum() {
    for axis in [Axis::Roll, Axis::Pitch, Axis::Yaw] {
        let a = Airframe::paternain();
        let rig = SingleAxis { axis, height_m: 1.0, friction_nms: 0.0, cg_below_pivot_m: None };
        let mut beginning = Beginning::calm(a.clone(), Rig::SingleAxis(rig));
        let angle = 0.05;
        beginning.roll_pitch_yaw_rad = axis.unit() * angle;
        let mut world = World::new(beginning);
        let mut crossings = Crossings::new(angle);
        run(&mut world, 20.0, &OFF, |t, w| {
            let x = w.body();
            let rpy = roll_pitch_yaw(&x.attitude());
            let off_axis = rpy - axis.unit() * axis.unit().dot(&rpy);
            assert!(off_axis.norm() < 1e-12, "{axis:?} at {t}: {rpy}");
            let centre = x.position_enu_m - Vector3::new(0.0, 0.0, 1.0);
            assert!((centre.norm() - a.cg_below_rotors_m).abs() < 1e-12);
            crossings.add(t, axis.unit().dot(&rpy));
        });
        if axis == Axis::Yaw {
            assert!((crossings.before - angle).abs() < 1e-9, "gravity does not turn yaw");
            continue;
        }
        // Compound pendulum: 2π √((I + m d²) / (m g d)), [Paternain] Eq. 2 with its sign (ERRATA 4).
        let (i, d) = (axis.unit().dot(&a.inertia_kgm2), a.cg_below_rotors_m);
        let inertia = i + a.mass_kg * d * d;
        let expected = std::f64::consts::TAU * (inertia / (a.weight_n() * d)).sqrt() * (1.0 + angle * angle / 16.0);
        let period = crossings.period();
        assert!((period / expected - 1.0).abs() < 1e-4, "{axis:?}: {period} s, expected {expected} s");
    }
}

#[test]
fn halving_the_step_changes_little_even_on_stiff_strings() {
    // GIVEN a catch on the strings and a landing, WHEN the tick (and with it the sub-step) is four times finer,
    // THEN the path differs by less than 5 mm.
    let path = |tick_s: f64| {
        let rig = HangingStrings { height_m: 1.0, ..HangingStrings::default() };
        let mut beginning = Beginning::calm(Airframe::iris(), Rig::HangingStrings(rig));
        beginning.offset_enu_m = Vector3::new(0.05, 0.02, 0.4);
        let mut world = World::new(beginning);
        let every = (0.01 / tick_s).round() as usize;
        let mut places = Vec::new();
        for tick in 1..=(1.0 / tick_s).round() as usize {
            world.step(&[0.3; 4], &Push::default(), tick_s);
            if tick % every == 0 {
                places.push(world.body().position_enu_m);
            }
        }
        places
    };
    let worst = path(0.005).iter().zip(path(0.0003125)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(worst < 5e-3, "{worst} m");
}

fn fly(scenario: &Scenario, ticks: usize, throttle: [f64; 4]) -> Vec<SensorFrame> {
    let mut vehicle = SimVehicle::new(scenario).unwrap();
    (0..ticks)
        .map(|_| {
            let frame = vehicle.sense().unwrap();
            vehicle.actuate(&MotorCommand { throttle }).unwrap();
            frame
        })
        .collect()
}

fn hash(frames: &[SensorFrame]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for frame in frames {
        // Debug prints the shortest text that reads back as the same bits.
        format!("{frame:?}").hash(&mut hasher);
    }
    hasher.finish()
}

fn everything() -> Scenario {
    Scenario::from_toml(
        "name = \"everything\"\n[suite]\nadd = [\"gnss\", \"mocap_pose\", \"camera_ranges\"]\n\
         [[sensor]]\nkind = \"height\"\ndropout = 0.2\n",
    )
    .unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let scenario = everything();
    let throttle = [0.6, 0.62, 0.61, 0.6];
    let first = hash(&fly(&scenario, 2000, throttle));
    assert_eq!(first, hash(&fly(&scenario, 2000, throttle)));
    let other = Scenario { seed: 2, ..scenario };
    assert_ne!(first, hash(&fly(&other, 2000, throttle)));
}

#[test]
fn adding_a_sensor_changes_no_other() {
    let with = everything();
    let mut without = with.clone();
    without.suite.gnss = None;
    without.suite.heights.remove(2);
    without.suite.imus.pop();
    for (a, b) in fly(&with, 1000, OFF).iter().zip(fly(&without, 1000, OFF)) {
        assert_eq!(a.imus[..3], b.imus[..3]);
        assert_eq!(a.heights[..2], b.heights[..2]);
        assert_eq!((a.barometers, a.mocap_pose, a.camera_ranges), (b.barometers, b.mocap_pose, b.camera_ranges));
    }
}

fn statistics(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
}

#[test]
fn sensors_at_rest_measure_truth_with_the_rates_and_errors_of_their_suite() {
    // GIVEN a vehicle standing still for 100 s, its IMU biases constant.
    let mut scenario = everything();
    scenario.rig = Rig::Free(Free::default());
    scenario.disturbance = Disturbance::NONE;
    for imu in &mut scenario.suite.imus {
        (imu.gyro.bias_walk, imu.accel.bias_walk) = (0.0, 0.0);
    }
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let truth = vehicle.truth().unwrap();
    let biases: Vec<_> = (0..4)
        .map(|i| (vehicle.sensors().gyro_bias_radps(i).unwrap(), vehicle.sensors().accel_bias_mps2(i).unwrap()))
        .collect();
    let frames: Vec<SensorFrame> = (0..20_000).map(|_| vehicle.sense().unwrap()).collect();
    // A mean of n samples is good to σ/√n, a sigma to σ/√(2n): five times that is allowed, and 1 % for rounding.
    let close = |what: &str, values: &[f64], mean: f64, sigma: f64| {
        let (m, s) = statistics(values);
        let n = values.len() as f64;
        assert!((m - mean).abs() < 5.0 * sigma / n.sqrt() + 1e-6, "{what}: mean {m}, expected {mean}");
        assert!((s / sigma - 1.0).abs() < 5.0 / (2.0 * n).sqrt() + 0.01, "{what}: sigma {s}, expected {sigma}");
    };
    let suite = &scenario.suite;
    for (i, (gyro_bias, accel_bias)) in biases.iter().enumerate() {
        let samples: Vec<_> = frames.iter().filter_map(|f| f.imus[i]).collect();
        assert_eq!(samples.len(), 10_000, "100 Hz for 100 s");
        let gyro: Vec<f64> = samples.iter().map(|s| s.gyro_radps.y).collect();
        close("gyro", &gyro, gyro_bias.y, suite.imus[i].gyro.total_sigma());
        let accel: Vec<f64> = samples.iter().map(|s| s.accel_mps2.z).collect();
        close("accel", &accel, GRAVITY_MPS2 + accel_bias.z, suite.imus[i].accel.total_sigma());
        assert!(samples.iter().all(|s| s.mag_ut.is_some()));
    }
    for i in 0..3 {
        let samples: Vec<f64> = frames.iter().filter_map(|f| f.heights[i]).map(|s| s.height_m).collect();
        // 1000 due, a fifth lost: binomial, σ = 12.6.
        assert!((740..860).contains(&samples.len()), "{}", samples.len());
        let (mean, sigma) = statistics(&samples);
        assert!((mean - truth.position_enu_m.z).abs() < 5.0 * 0.004, "mounting error {mean}");
        assert!((sigma / suite.heights[i].height.total_sigma() - 1.0).abs() < 0.15, "{sigma}");
        assert!(samples.iter().all(|h| {
            let raw = (h + suite.heights[i].position_flu_m.z) * 1000.0;
            (raw - raw.round()).abs() < 1e-6
        }));
    }
    let gnss: Vec<_> = frames.iter().filter_map(|f| f.gnss.map(|g| (f.time, g))).collect();
    assert_eq!(gnss.len(), 100);
    assert!(gnss.iter().all(|(arrived, g)| (arrived.seconds_since(g.time) - 0.2).abs() < 1e-9));
    let poses: Vec<_> = frames.iter().filter_map(|f| f.mocap_pose).collect();
    let x: Vec<f64> = poses.iter().map(|p| p.position_enu_m.x).collect();
    close("mocap", &x, truth.position_enu_m.x, 0.001);
    let ranges: Vec<_> = frames.iter().filter_map(|f| f.camera_ranges).collect();
    assert!((11_990..=12_000).contains(&ranges.len()), "{}", ranges.len());
    let first: Vec<f64> = ranges.iter().map(|r| r.range_m[0]).collect();
    close("range", &first, (truth.position_enu_m - Vector3::new(10.0, 10.0, 10.0)).norm(), 0.0015);
    assert_eq!(frames.iter().filter(|f| f.barometers[0].is_some()).count(), 10_000);
    let temperature = frames[19_998].imus[0].unwrap().temperature_c;
    let expected = 22.0 + 12.0 * (1.0 - (-99.99f64 / 180.0).exp());
    assert!((temperature - expected).abs() < 1e-6, "{temperature}");
}

#[test]
fn the_barometer_drifts_with_its_temperature() {
    // GIVEN two vehicles alike but for the thermal drift, THEN their pressures differ by drift · warming.
    let mut scenario = everything();
    scenario.suite.barometers[0].pressure.resolution = 0.0;
    let mut still = scenario.clone();
    still.suite.barometers[0].drift_pa_per_c = 0.0;
    let (a, b) = (fly(&scenario, 12_000, OFF), fly(&still, 12_000, OFF));
    let (a, b) = (a[11_998].barometers[0].unwrap(), b[11_998].barometers[0].unwrap());
    let expected = 1.2 * (a.temperature_c - 22.0);
    assert!(expected > 3.0);
    assert!((a.pressure_pa - b.pressure_pa - expected).abs() < 1e-6);
}

#[test]
fn an_off_centre_accelerometer_feels_the_rotation() {
    // GIVEN a yaw spin of 6 rad/s in free fall, THEN each IMU of the plate reads ω² r towards the centre.
    let mut scenario = everything();
    scenario.rig = Rig::Free(Free { height_m: 100.0 });
    scenario.initial.body_rates_radps = Vector3::new(0.0, 0.0, 6.0);
    scenario.airframe.linear_drag_nspm = 0.0;
    scenario.disturbance = Disturbance::NONE;
    for imu in &mut scenario.suite.imus {
        for q in [&mut imu.gyro, &mut imu.accel] {
            (q.sigma, q.bias_sigma, q.bias_walk, q.resolution) = (0.0, 0.0, 0.0, 0.0);
        }
    }
    let frames = fly(&scenario, 10, OFF);
    for i in 0..4 {
        let sample = frames.iter().rev().find_map(|f| f.imus[i]).unwrap();
        let expected = -36.0 * scenario.suite.imus[i].position_flu_m;
        assert!((sample.accel_mps2 - expected).norm() < 1e-9, "IMU {}: {}", i + 1, sample.accel_mps2);
        assert!((sample.gyro_radps.z - 6.0).abs() < 1e-12);
    }
}

#[test]
fn an_outage_silences_its_sensor_only() {
    let scenario = Scenario::from_toml(
        "name = \"outage\"\n[[outage]]\nsensor = \"imu\"\ninstance = 3\nstart_s = 1\nduration_s = 2\n",
    )
    .unwrap();
    let plain = Scenario { outages: Vec::new(), ..scenario.clone() };
    for (a, b) in fly(&scenario, 1000, OFF).iter().zip(fly(&plain, 1000, OFF)) {
        let out = (1_000_000..3_000_000).contains(&a.time.0);
        assert_eq!(a.imus[2], if out { None } else { b.imus[2] }, "at {}", a.time);
        assert_eq!((a.imus[0], a.heights, a.barometers), (b.imus[0], b.heights, b.barometers));
    }
}

#[test]
fn a_hand_holds_the_single_axis_at_its_angle() {
    let text = include_str!("../../../tests/scenarios/single_axis_roll.toml");
    let scenario = Scenario::from_toml(text).unwrap();
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let mut roll_at = |seconds: f64| {
        while vehicle.time().as_seconds() < seconds - 1e-9 {
            vehicle.sense().unwrap();
        }
        roll_pitch_yaw(&vehicle.truth().unwrap().world_from_body).x
    };
    assert!(roll_at(7.9).abs() < 0.1);
    let held = roll_at(8.395);
    assert!((held - 0.349).abs() < 0.02, "{held}");
}

#[test]
fn the_battery_sags_and_slows_the_rotors() {
    let scenario = Scenario::from_toml("name = \"low\"\n[battery]\ncharge = 0.1\n").unwrap();
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    for _ in 0..400 {
        vehicle.sense().unwrap();
        vehicle.actuate(&MotorCommand { throttle: [0.7; 4] }).unwrap();
    }
    let voltage = vehicle.world().battery_v();
    let nominal = scenario.airframe.battery.nominal_v();
    assert!(voltage < nominal - 0.3, "{voltage} V of {nominal} V");
    let measured = vehicle.sense().unwrap().battery_v.unwrap();
    assert!((measured - voltage).abs() < 0.1, "{measured}");
    let mean = vehicle.truth().unwrap().rotor_speed_radps.iter().sum::<f64>() / 4.0;
    let expected = scenario.airframe.motor_curve.speed_radps(0.7, voltage / nominal);
    // Motors differ by 1 % each.
    assert!((mean / expected - 1.0).abs() < 0.02, "{mean} against {expected}");
}

#[test]
fn commands_are_clipped_and_nan_stops_the_motor() {
    let mut vehicle = SimVehicle::new(&Scenario::bare()).unwrap();
    let applied = vehicle.actuate(&MotorCommand { throttle: [-1.0, 2.0, f64::NAN, 0.4] }).unwrap();
    assert_eq!(applied.throttle, [0.0, 1.0, 0.0, 0.4]);
}
