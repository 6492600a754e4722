//! The failsafe table, by losing the real thing in the simulator: sensors, battery, a rotor's thrust, the pose.

use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::event::EventKind;
use plumbline_agent::flight::{Failsafe, FlightConfig};
use plumbline_agent::frames::tilt_rad;
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::devices::Outage;
use plumbline_agent::types::{EstimatorKind, Mode};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_support::flown::{Flown, scenario};

/// `name`, with its script up to `until_s`, changed, and in the air at 1 m or what its script asks for.
fn flying(name: &str, until_s: f64, change: impl FnOnce(&mut Scenario, &mut Option<FlightConfig>)) -> Flown {
    let mut scenario = Scenario::from_toml(&scenario(name)).unwrap();
    scenario.script.steps.retain(|s| s.at_s < until_s);
    let mut config = None;
    change(&mut scenario, &mut config);
    let config = config.unwrap_or_else(|| scenario.flight_config());
    let mut f = Flown::with_config(scenario, config);
    f.until(12.0);
    assert_eq!(f.flight.status().failsafe, Failsafe::None, "{}", f.log());
    assert!(f.last().report.armed && f.last().truth.position_enu_m.z > 0.4, "{}", f.log());
    f
}

fn silent(kind: SensorKind, instances: u8, from_s: f64) -> Vec<Outage> {
    let outage = |instance| Outage { sensor: SensorId::new(kind, instance), start_s: from_s, duration_s: 600.0 };
    (1..=instances).map(outage).collect()
}

fn acted(f: &Flown, failsafe: Failsafe, words: &str) -> f64 {
    let seen = f.events.iter().find(|e| e.text.contains(words)).map(|e| e.time.as_seconds());
    seen.unwrap_or_else(|| panic!("{failsafe:?} never says {words:?}:\n{}", f.log()))
}

fn assert_down(f: &Flown) {
    assert!(!f.last().report.armed, "still armed:\n{}", f.log());
    assert_eq!(f.last().report.command.throttle, [0.0; 4]);
}

#[test]
fn without_any_imu_the_motors_are_cut_within_a_tenth_of_a_second_on_every_rig() {
    for name in ["hover", "altitude_step"] {
        let mut f = flying(name, 14.0, |s, _| s.outages = silent(SensorKind::Imu, 4, 14.0));
        f.until(16.0);
        let status = f.flight.status();
        assert_eq!((status.mode, status.failsafe), (Mode::Cut, Failsafe::ImuCut), "{name}\n{}", f.log());
        let cut = f.rows.iter().find(|r| r.report.mode == Mode::Cut).unwrap();
        assert!((14.05..14.11).contains(&cut.t_s), "{name}: cut at {}", cut.t_s);
        assert_eq!(cut.report.command.throttle, [0.0; 4], "off in the same tick");
        assert!(tilt_rad(&cut.truth.world_from_body).to_degrees() < 10.0, "{name}: before it tumbles");
        // Whether it stands cannot be told without an IMU.
        let release = f.command(Command::ReleaseCut);
        assert!(!release.accepted && release.reason.contains("no IMU sample"), "{}", release.reason);
    }
}

#[test]
fn without_any_height_it_descends_on_attitude_alone_in_every_mode() {
    for (name, mode) in [("altitude_step", Mode::AltitudeHold), ("hover", Mode::Hold), ("hover", Mode::Stabilise)] {
        let mut f = flying(name, 14.0, |s, _| {
            s.outages = silent(SensorKind::Height, 3, 14.0);
            s.outages.extend(silent(SensorKind::MocapPose, 1, 14.0));
            s.outages.extend(silent(SensorKind::CameraRanges, 1, 14.0));
            s.outages.retain(|o| s.suite.contains(o.sensor));
        });
        if mode == Mode::Stabilise {
            f.until(13.9);
            assert!(f.command(Command::SetMode(mode)).accepted);
        }
        f.until(30.0);
        let at = acted(&f, Failsafe::AltitudeDescend, "no height any more");
        // The estimator flies on its accelerometers for two seconds.
        assert!((14.2..16.1).contains(&at), "{name} {mode:?}: at {at}");
        let highest = f.since(14.0).map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
        let tilt = f.since(14.0).map(|r| tilt_rad(&r.truth.world_from_body)).fold(0.0, f64::max);
        assert!(highest < 1.3 && tilt < 0.5, "{name} {mode:?}: {highest:.2} m, {tilt:.2} rad\n{}", f.log());
        assert_down(&f);
    }
}

#[test]
fn hold_without_a_pose_becomes_altitude_hold_then_lands() {
    let mut f = flying("hover", 14.0, |s, _| {
        s.outages = silent(SensorKind::MocapPose, 1, 14.0);
        s.outages.extend(silent(SensorKind::CameraRanges, 1, 14.0));
    });
    f.until(40.0);
    let held = acted(&f, Failsafe::PositionHold, "horizontal position lost: altitude hold");
    let descends = acted(&f, Failsafe::PositionDescend, "horizontal position lost for 5 s");
    assert!((descends - held - 5.0).abs() < 0.05, "{held} {descends}");
    let between = f.rows.iter().find(|r| r.t_s > held + 1.0).unwrap();
    assert_eq!(between.report.mode, Mode::AltitudeHold);
    assert!((between.truth.position_enu_m.z - 1.0).abs() < 0.1);
    assert_down(&f);
}

#[test]
fn an_emptying_battery_warns_then_lands_with_a_reserve() {
    let mut f = flying("hover", 14.0, |s, _| {
        s.battery_charge = Some(0.45);
        // A small pack, so that the test need not hover for ten minutes.
        s.airframe.battery.capacity_ah = 0.6;
    });
    f.until(90.0);
    let warned = acted(&f, Failsafe::BatteryLow, "land soon");
    let lands = acted(&f, Failsafe::BatteryDescend, "%): descending");
    assert!(lands > warned + 2.0, "{warned} {lands}\n{}", f.log());
    let sinks = f.since(lands).map(|r| -r.truth.velocity_enu_mps.z).fold(0.0, f64::max);
    let left = f.vehicle.world().battery().charge();
    assert!(sinks < 0.6 && left > 0.05, "sinks at {sinks:.2} m/s, {:.0} % left\n{}", 100.0 * left, f.log());
    let z_m: Vec<_> = f.since(lands).map(|r| r.truth.position_enu_m.z).collect();
    let stands_m = f.last().truth.position_enu_m.z;
    let down = z_m.iter().position(|z| *z < stands_m + 0.002).unwrap();
    let hops_m = z_m[down..].iter().fold(0.0, |a: f64, z| a.max(z - stands_m));
    assert!(hops_m < 0.005, "hops up to {hops_m:.3} m once down\n{}", f.log());
    assert_down(&f);
}

#[test]
fn a_battery_nobody_measures_ends_on_the_floor_with_an_event_and_disarmed() {
    let mut f = flying("hover", 14.0, |s, _| {
        s.battery_charge = Some(0.2);
        s.airframe.battery.capacity_ah = 0.4;
        s.suite.battery_sigma_v = None;
    });
    f.until(40.0);
    let sinks = f.rows.iter().find(|r| r.t_s > 12.0 && r.truth.position_enu_m.z < 0.7).unwrap().t_s;
    let said = f.events.iter().find(|e| e.kind == EventKind::Failsafe).map(|e| e.time.as_seconds());
    assert!(said.is_some_and(|at| at < sinks + 2.0), "sinks from {sinks} s on, said {said:?}\n{}", f.log());
    let off = f.rows.iter().find(|r| r.t_s > sinks && !r.report.armed).unwrap().t_s;
    assert!(off < sinks + 8.0, "sinks from {sinks} s on, disarmed at {off}");
}

#[test]
fn a_battery_that_is_not_measured_any_more_has_no_charge_and_refuses_arming() {
    let mut f = Flown::new(&scenario("hover"));
    f.scenario.script.steps.clear();
    f.until(2.0);
    assert!(f.flight.status().battery_v.is_some());
    f.voltmeter_lost_s = 2.0;
    f.until(5.2);
    let status = f.flight.status();
    assert_eq!((status.battery_v, status.battery_fraction), (None, None));
    let check = status.checks.iter().find(|check| check.name == "battery").unwrap();
    assert!(!check.passed && check.reason.as_str() == "not measured any more, for 3 s", "{}", check.reason);
    assert_eq!(f.events.iter().filter(|e| e.text.contains("battery not measured for 3 s")).count(), 1, "{}", f.log());
}

#[test]
fn a_warning_of_a_low_battery_stays_when_nobody_measures_it_any_more() {
    let mut f = flying("hover", 14.0, |s, _| {
        s.battery_charge = Some(0.45);
        s.airframe.battery.capacity_ah = 0.6;
    });
    while f.flight.status().failsafe != Failsafe::BatteryLow {
        let next = f.last().t_s + 0.1;
        assert!(next < 90.0, "{}", f.log());
        f.until(next);
    }
    f.voltmeter_lost_s = f.last().t_s;
    let end = f.voltmeter_lost_s + 6.0;
    f.until(end);
    let status = f.flight.status();
    assert_eq!((status.failsafe, status.battery_v), (Failsafe::BatteryLow, None), "{}", f.log());
}

#[test]
fn thrust_that_is_commanded_and_not_answered_disarms_a_vehicle_that_stays_on_its_feet() {
    for mode in [Mode::Hold, Mode::Stabilise] {
        let mut scenario = Scenario::from_toml(&scenario("hover")).unwrap();
        scenario.script.steps.retain(|s| s.at_s < 4.5 && mode == Mode::Hold || s.at_s < 3.5);
        let config = scenario.flight_config();
        let mut f = Flown::with_config(scenario, config);
        f.motor_factor = [0.5; 4];
        f.until(4.5);
        if mode == Mode::Stabilise {
            let up = SetpointChange { throttle: Some(1.4), ..SetpointChange::default() };
            assert!(f.command(Command::Setpoint(up)).accepted);
        }
        f.until(12.0);
        let at = acted(&f, Failsafe::ThrustDescend, "the vehicle does not follow");
        assert!((5.5..8.5).contains(&at), "{mode:?}: at {at}");
        assert_down(&f);
    }
}

#[test]
fn a_rotor_that_is_dead_from_take_off_on_ends_the_flight_before_it_spins_in_its_strings() {
    // The rotor test stands back during take-off and on taut strings, and the strings hold the vehicle below 60°.
    for rotor in 0..4 {
        let mut f = Flown::new(&scenario("altitude_step"));
        f.motor_factor[rotor] = 0.0;
        f.until(12.0);
        let armed = || f.rows.iter().filter(|r| r.report.armed);
        let beyond_s = armed().find(|r| tilt_rad(&r.truth.world_from_body) > 0.53).map(|r| r.t_s).unwrap();
        let at_s = acted(&f, Failsafe::TiltCut, "where 20° may be asked for: motors cut");
        assert!((0.5..0.6).contains(&(at_s - beyond_s)), "rotor {}: {beyond_s}, {at_s}\n{}", rotor + 1, f.log());
        let fastest = armed().map(|r| r.truth.body_rates_radps.norm()).fold(0.0, f64::max);
        assert!(fastest < 7.0, "rotor {}: {fastest} rad/s", rotor + 1);
        assert_down(&f);
    }
}

#[test]
fn motors_that_nobody_commands_stop_by_themselves() {
    use plumbline_agent::vehicle::Vehicle;
    let mut f = flying("hover", 14.0, |_, _| {});
    let (before, passed_s) = (f.vehicle.time(), f.vehicle.pass_over(0.5));
    assert!((passed_s - 0.5).abs() < 0.01);
    f.flight.stalled(0.5);
    f.tick();
    assert!((f.vehicle.time().seconds_since(before) - 0.505).abs() < 0.006);
    // 100 ms at hover, 400 ms falling: half a square of 0.4 s times g.
    let truth = f.last().truth;
    assert!((-4.2..-3.4).contains(&truth.velocity_enu_mps.z), "{} m/s", truth.velocity_enu_mps.z);
    assert!(truth.rotor_speed_radps.iter().all(|w| *w < 200.0), "{:?}", truth.rotor_speed_radps);
    let status = f.flight.status();
    assert_eq!((status.mode, status.failsafe), (Mode::Cut, Failsafe::StallCut), "{}", f.log());
    assert!(status.failsafe_reason.contains("silent for 0.50 s (limit 0.1 s)"), "{}", status.failsafe_reason);
}

#[test]
fn a_page_seen_before_arming_demands_nothing() {
    let mut f = Flown::new(&scenario("altitude_step"));
    (f.operator_from_s, f.operator_lost_s) = (0.0, 2.0);
    f.until(25.0);
    let failsafes: Vec<_> = f.events.iter().filter(|e| e.text.contains("operator's page")).collect();
    assert!(f.last().report.armed && failsafes.is_empty(), "{}", f.log());
}

#[test]
fn an_estimator_that_does_not_know_the_altitude_flies_no_mode_that_needs_it() {
    let mut scenario = Scenario::from_toml(&scenario("altitude_step")).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 6.0);
    let config = scenario.flight_config().with_every_estimator();
    let mut f = Flown::with_config(scenario, config);
    f.until(2.0);
    assert!(f.command(Command::SelectEstimator(EstimatorKind::Vqf)).accepted);
    f.tick();
    let arm = f.command(Command::Arm);
    assert!(!arm.accepted && arm.reason.contains("altitude: not known to VQF"), "{}", arm.reason);
    assert!(f.command(Command::SelectEstimator(EstimatorKind::EkfBias)).accepted);
    f.until(12.0);
    let refused = f.command(Command::SelectEstimator(EstimatorKind::Vqf));
    assert!(!refused.accepted && refused.reason.contains("altitude hold needs the altitude"), "{}", refused.reason);
    let hold = f.command(Command::SetMode(Mode::Hold));
    assert!(!hold.accepted && hold.reason.contains("hold needs the horizontal position"), "{}", hold.reason);
}

/// Free flight, each rig and mode, with a stick that only goes up: the box is kept to half a metre beyond its limit.
#[test]
fn full_throttle_in_stabilise_does_not_leave_the_box() {
    for (name, limit_m) in [("hover", 2.0), ("altitude_step", 2.0), ("hover", 5.0)] {
        let mut f = flying(name, 14.0, |s, config| {
            let mut limited = s.flight_config();
            limited.limits.altitude_max_m = limit_m;
            *config = Some(limited);
        });
        assert!(f.command(Command::SetMode(Mode::Stabilise)).accepted);
        let up = SetpointChange { throttle: Some(1.5), ..SetpointChange::default() };
        assert!(f.command(Command::Setpoint(up)).accepted);
        f.until(45.0);
        let limit_m = f.flight.config().altitude_max_m();
        let highest = f.since(12.0).map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
        println!("{name}: limit {limit_m} m, highest {highest:.2} m");
        assert!(highest < limit_m + 0.3, "{name}: {highest:.2} m with a limit of {limit_m} m\n{}", f.log());
        assert!(highest > 0.7 * limit_m, "{name}: {highest:.2} m: taken over far too early\n{}", f.log());
        acted(&f, Failsafe::BoxHold, "holding at the edge");
        acted(&f, Failsafe::BoxDescend, "descending");
        assert_down(&f);
    }
}
