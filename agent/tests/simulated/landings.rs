//! GIVEN any scenario of the workspace WHEN it is flown to its end, and landed where its script does not
//! THEN the vehicle stands, disarmed, and no failsafe had to help.

use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::control::trajectory::Trajectory;
use plumbline_agent::estimate::{Estimate, Estimator, Health, ekf_bias::EkfBias};
use plumbline_agent::event::EventKind;
use plumbline_agent::flight::{Failsafe, Flight, FlightConfig};
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::types::{EstimatorKind, Mode, MotorCommand};
use plumbline_support::flown::{Flown, scenario};

/// Most ticks of an armed flight on which the estimator in the loop may be anything but healthy: a fifth
/// of the patience of the failsafe (40 ticks).
const UNHEALTHY_TICKS_MAX: usize = 8;
/// A landing and its disarming take no longer than this after the floor is reached, s: 0.5 s to see it, or
/// 1 s by the raw heights alone, and the 2 s rule.
const DISARM_MAX_S: f64 = 3.5;

/// Every scenario file, by name.
fn names() -> Vec<String> {
    let folder = format!("{}/../tests/scenarios", env!("CARGO_MANIFEST_DIR"));
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Lands a vehicle that is still armed; one that cannot lift is disarmed.
fn bring_down(f: &mut Flown) {
    if f.last().report.armed {
        let command = if f.flight.config().rig.can_lift() { Command::SetMode(Mode::Land) } else { Command::Disarm };
        let ack = f.command(command);
        assert!(ack.accepted, "{}", ack.reason);
        let end = f.last().t_s + 12.0;
        f.until(end);
    }
}

#[test]
fn every_scenario_ends_disarmed_with_a_healthy_estimator() {
    let mut broken = String::new();
    let names = names();
    assert!(names.len() >= 10, "{names:?}");
    for name in names {
        let mut f = Flown::new(&scenario(&name));
        let end = f.scenario.duration_s;
        f.until(end);
        bring_down(&mut f);
        let unhealthy = f.rows.iter().filter(|r| r.report.armed && r.estimate.health != Health::Healthy).count();
        let refused = f.acks.iter().find(|a| !a.1.accepted);
        let failsafes = f.events.iter().filter(|e| e.kind == EventKind::Failsafe).count();
        println!("{name:26} unhealthy for {unhealthy} ticks");
        let armed = f.last().report.armed;
        if armed || failsafes > 0 || unhealthy > UNHEALTHY_TICKS_MAX || refused.is_some() {
            broken += &format!(
                "{name}: armed {armed}, {failsafes} failsafes, unhealthy for {unhealthy} ticks, refused: {refused:?}\n{}",
                f.log()
            );
        }
    }
    assert!(broken.is_empty(), "{broken}");
}

/// The EKF, its estimate altered at each time, s.
struct Altered {
    filter: EkfBias,
    estimate: Estimate,
    alter: fn(f64, &mut Estimate),
}

impl Estimator for Altered {
    fn kind(&self) -> EstimatorKind {
        self.filter.kind()
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        self.estimate = self.filter.step(received, applied).clone();
        (self.alter)(received.time.as_seconds(), &mut self.estimate);
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

/// The hover with such an estimator, its script up to `until_s`.
fn altered(until_s: f64, change: impl FnOnce(&mut FlightConfig), alter: fn(f64, &mut Estimate)) -> Flown {
    let mut f = Flown::new(&scenario("hover"));
    let mut config = f.scenario.flight_config();
    config.in_loop = EstimatorKind::EkfBias;
    change(&mut config);
    let altered = Altered { filter: EkfBias::new(config.sensor_model.clone()), estimate: Estimate::default(), alter };
    f.flight = Flight::with_estimators(config, vec![Box::new(altered)]).unwrap();
    f.scenario.script.steps.retain(|s| s.at_s < until_s);
    f
}

/// From 14 s on it says that it is degraded and estimates a metre too much.
fn lost(t_s: f64, estimate: &mut Estimate) {
    if t_s > 14.0 {
        estimate.health = Health::Degraded;
        estimate.motion.as_mut().unwrap().position_enu_m.z += 1.0;
        // So that neither the estimate nor the watchdog's agreement with it can help.
        estimate.world_from_body *= nalgebra::UnitQuaternion::from_euler_angles(0.3, 0.0, 0.0);
    }
}

/// From 4 s on it sinks.
fn sinking(t_s: f64, estimate: &mut Estimate) {
    if let Some(motion) = estimate.motion.as_mut() {
        motion.position_enu_m.z -= 0.03 * (t_s - 4.0).max(0.0);
    }
}

/// It takes the vehicle to be beside its box.
fn beside(_t_s: f64, estimate: &mut Estimate) {
    if let Some(motion) = estimate.motion.as_mut() {
        motion.position_enu_m.x -= 2.5;
    }
}

/// True height at which it was said to have landed, m.
fn landed_m(f: &Flown) -> f64 {
    let landed = f.events.iter().find(|e| e.text.as_str() == "landed").unwrap_or_else(|| panic!("{}", f.log()));
    f.since(landed.time.as_seconds()).next().unwrap().truth.position_enu_m.z
}

#[test]
fn a_descent_on_attitude_alone_ends_disarmed_soon_after_the_floor() {
    let mut f = altered(10.0, |_| {}, lost);
    f.until(13.9);
    assert!(f.last().report.armed && f.last().truth.position_enu_m.z > 0.8, "{}", f.log());
    f.until(24.0);
    let log = f.log();
    assert!(log.contains("descending on attitude alone"), "{log}");
    // The feet stand on the floor at 0.109 m.
    let floor_s = f.since(14.0).find(|r| r.truth.position_enu_m.z < 0.115).map(|r| r.t_s).expect(&log);
    let off_s = f.since(14.0).find(|r| !r.report.armed).map(|r| r.t_s).expect(&log);
    println!("floor at {floor_s:.2} s, disarmed at {off_s:.2} s");
    assert!(
        off_s > floor_s && off_s - floor_s < DISARM_MAX_S,
        "floor at {floor_s:.2} s, disarmed at {off_s:.2} s\n{log}"
    );
    assert_ne!(f.flight.failsafe(), Failsafe::TiltCut);
}

#[test]
fn a_descent_on_attitude_alone_that_still_sinks_outlasts_its_time() {
    let mut f = altered(10.0, |c| (c.failsafe.blind_descend_s, c.failsafe.descend_mps) = (1.0, 0.5), lost);
    f.until(24.0);
    assert!(f.log().contains("descending on attitude alone"), "{}", f.log());
    let landed_m = landed_m(&f);
    assert!(landed_m < 0.2 && !f.last().report.armed, "landed at {landed_m:.2} m\n{}", f.log());
}

#[test]
fn a_landing_beside_its_stand_ends_on_the_floor() {
    // GIVEN a vehicle that took off from a stand of a metre and went aside WHEN it lands THEN it comes down to the floor
    let on_stand = scenario("takeoff").replace("[rig.free]\nheight_m = 0.0", "[rig.on_stand]\nheight_m = 1.0");
    let mut f = Flown::new(&on_stand.replace("altitude_m = 1.0", "altitude_m = 1.6"));
    f.until(9.0);
    let aside = SetpointChange { x_m: Some(1.2), ..SetpointChange::default() };
    assert!(f.command(Command::Setpoint(aside)).accepted);
    f.until(13.0);
    let place = f.last().truth.position_enu_m;
    assert!((place.z - 1.6).abs() < 0.1 && place.x > 1.0, "at {place}\n{}", f.log());
    assert!(f.command(Command::SetMode(Mode::Land)).accepted);
    f.until(26.0);
    let landed_m = landed_m(&f);
    assert!(landed_m < 0.2 && !f.last().report.armed, "landed at {landed_m:.2} m\n{}", f.log());
}

#[test]
fn an_estimate_that_sinks_on_the_ground_is_no_take_off() {
    let mut f = altered(4.0, |_| {}, sinking);
    f.until(4.1);
    let ack = f.command(Command::SetMode(Mode::Hold));
    assert!(ack.accepted, "{}", ack.reason);
    f.until(9.0);
    assert!(f.last().report.armed && f.last().estimate.motion.unwrap().position_enu_m.z < 0.0, "{}", f.log());
    // Nor is a path that is stopped before it begins.
    let list = Trajectory::Altitudes { altitude_m: [0.5].into_iter().collect(), hold_s: 5.0 };
    for order in [Command::Trajectory(Some(list)), Command::Trajectory(None)] {
        let ack = f.command(order);
        assert!(ack.accepted, "{}", ack.reason);
    }
    f.until(10.0);
    assert!(
        f.last().report.armed && f.rows.iter().all(|r| r.report.wrench.thrust_n == 0.0),
        "it took off\n{}",
        f.log()
    );
}

#[test]
fn a_vehicle_that_stands_beside_its_box_is_not_armed() {
    let mut f = altered(3.0, |_| {}, beside);
    f.until(3.5);
    let ack = f.command(Command::Arm);
    assert!(!ack.accepted && ack.reason.contains("m aside, at most 2.00 m"), "{}", ack.reason);
}
