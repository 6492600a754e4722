//! GIVEN any scenario of the workspace WHEN it is flown to its end, and landed where its script does not
//! THEN the vehicle stands, disarmed, and no failsafe had to help.

use plumbline_agent::command::Command;
use plumbline_agent::estimate::{Estimate, Estimator, Health, ekf_bias::EkfBias};
use plumbline_agent::event::EventKind;
use plumbline_agent::flight::{Failsafe, Flight};
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

/// The EKF, which says from some time on that it is degraded and estimates a metre too much.
struct Lost {
    filter: EkfBias,
    estimate: Estimate,
    from_s: f64,
}

impl Estimator for Lost {
    fn kind(&self) -> EstimatorKind {
        self.filter.kind()
    }

    fn step(&mut self, received: &SensorFrame, applied: &MotorCommand) -> &Estimate {
        self.estimate = self.filter.step(received, applied).clone();
        if received.time.as_seconds() > self.from_s {
            self.estimate.health = Health::Degraded;
            self.estimate.motion.as_mut().unwrap().position_enu_m.z += 1.0;
            // So that neither the estimate nor the watchdog's agreement with it can help.
            self.estimate.world_from_body *= nalgebra::UnitQuaternion::from_euler_angles(0.3, 0.0, 0.0);
        }
        &self.estimate
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }
}

#[test]
fn a_descent_on_attitude_alone_ends_disarmed_soon_after_the_floor() {
    let mut f = Flown::new(&scenario("hover"));
    let config = f.scenario.flight_config();
    let lost = Lost { filter: EkfBias::new(config.sensor_model.clone()), estimate: Estimate::default(), from_s: 14.0 };
    f.flight = Flight::with_estimators(config, vec![Box::new(lost)]).unwrap();
    f.scenario.script.steps.retain(|s| s.at_s < 10.0);
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
