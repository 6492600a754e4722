//! DESIGN's failsafe table, row by row, through the simulator.

use plumbline_agent::attack::{Attack, Channel, Kind, Schedule};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::control::setpoint::Limits;
use plumbline_agent::event::text;
use plumbline_agent::flight::{Failsafe, FlightConfig};
use plumbline_agent::frames::tilt_rad;
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::Mode;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_support::flown::{Flown, scenario};

/// The string rig, hovering at 0.8 m at 12 s, without script from there.
fn hovering() -> Flown {
    hovering_with(|_| {})
}

fn hovering_with(change: impl FnOnce(&mut FlightConfig)) -> Flown {
    let toml = scenario("altitude_step").replace("altitude_m = 0.5", "altitude_m = 0.8");
    let mut scenario = Scenario::from_toml(&toml).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 6.0);
    let mut config = scenario.flight_config();
    change(&mut config);
    let mut flown = Flown::with_config(scenario, config);
    flown.until(12.0);
    let z = flown.last().truth.position_enu_m.z;
    assert!((z - 0.8).abs() < 0.06, "hovers at {z}:\n{}", flown.log());
    flown
}

fn setpoint(altitude_m: f64) -> Command {
    Command::Setpoint(SetpointChange { altitude_m: Some(altitude_m), ..SetpointChange::default() })
}

fn bias_on(
    kind: SensorKind,
    instances: std::ops::RangeInclusive<u8>,
    what: Kind,
    channel: Channel,
    magnitude: f64,
) -> Command {
    let attacks = instances
        .map(|instance| Attack {
            id: u32::from(instance),
            sensor: SensorId::new(kind, instance),
            channel,
            kind: what,
            start_s: 0.5,
            duration_s: 60.0,
            magnitude,
            seed: 1,
        })
        .collect();
    Command::Attack(Schedule { id: 1, attacks, ..Schedule::default() })
}

/// Landed on its strings, motors off.
fn assert_down(f: &Flown) {
    let last = f.last();
    assert!(!last.report.armed, "still armed at {:.1} s:\n{}", last.t_s, f.log());
    assert_eq!(last.report.command.throttle, [0.0; 4]);
}

#[test]
fn link_loss_freezes_aborts_attacks_then_descends_and_disarms() {
    let mut f = hovering();
    assert!(f.command(bias_on(SensorKind::Height, 2..=2, Kind::Bias, Channel::All, 0.3)).accepted);
    f.until(13.0);
    assert!(f.flight.attacks().any_active());
    f.link_lost_s = 13.0;
    f.until(13.6);
    assert_eq!(f.flight.status().failsafe, Failsafe::LinkFreeze, "{}", f.log());
    assert!(!f.flight.attacks().any_active(), "attacks go on without a link");
    let refused = f.command(setpoint(1.0));
    assert!(!refused.accepted && refused.reason.contains("no heartbeat for 0."), "{}", refused.reason);
    f.until(14.9);
    assert_eq!(f.last().report.mode, Mode::AltitudeHold);
    f.until(15.1);
    let status = f.flight.status();
    assert_eq!((status.mode, status.failsafe), (Mode::Land, Failsafe::LinkDescend), "{}", f.log());
    let z = f.last().truth.position_enu_m.z;
    f.until(16.1);
    let sunk = z - f.last().truth.position_enu_m.z;
    assert!((0.15..0.42).contains(&sunk), "sank {sunk:.2} m in a second, 0.3 expected");
    f.until(22.0);
    assert_down(&f);
}

#[test]
fn an_operator_whose_page_falls_silent_is_waited_for_then_the_vehicle_lands() {
    let mut f = hovering();
    // A flight by script never had a page: nobody is missed.
    assert_eq!(f.flight.status().failsafe, Failsafe::None);
    (f.operator_from_s, f.operator_lost_s) = (12.0, 14.0);
    f.until(13.0);
    assert!(f.command(bias_on(SensorKind::Height, 2..=2, Kind::Bias, Channel::All, 0.3)).accepted);
    f.until(16.9);
    assert!(f.flight.attacks().any_active(), "a reload of the page disturbs nothing");
    f.until(17.1);
    assert_eq!(f.flight.status().failsafe, Failsafe::OperatorFreeze, "{}", f.log());
    assert!(!f.flight.attacks().any_active());
    // The page is back: thawed.
    (f.operator_from_s, f.operator_lost_s) = (17.1, 17.5);
    f.until(17.5);
    assert_eq!(f.flight.status().failsafe, Failsafe::None);
    // A command is a sign as well.
    f.until(20.0);
    assert!(f.command(setpoint(0.7)).accepted);
    f.until(22.9);
    assert_eq!(f.flight.status().failsafe, Failsafe::None, "{}", f.log());
    f.until(30.2);
    assert_eq!(f.flight.status().mode, Mode::Land, "{}", f.log());
    f.until(36.0);
    assert_down(&f);
}

#[test]
fn a_vehicle_that_stands_does_not_take_off_on_a_lost_link() {
    // GIVEN it armed in hold on the floor, below the lowest altitude that may be asked for
    let mut scenario = Scenario::from_toml(&scenario("takeoff")).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 4.5);
    let mut config = scenario.flight_config();
    config.limits.altitude_min_m = 0.5;
    let mut f = Flown::with_config(scenario, config);
    f.link_lost_s = 5.0;
    f.until(6.9);
    assert_eq!(f.flight.status().failsafe, Failsafe::LinkFreeze, "{}", f.log());
    assert!(f.last().report.armed && f.rows.iter().all(|r| r.report.wrench.thrust_n == 0.0), "{}", f.log());
}

#[test]
fn each_attack_of_a_schedule_that_replaces_another_is_told() {
    let mut f = hovering();
    for _ in 0..2 {
        assert!(f.command(bias_on(SensorKind::Height, 2..=2, Kind::Bias, Channel::All, 0.3)).accepted);
        f.tick();
    }
    let told = f.events.iter().filter(|e| e.text.contains(": accepted (")).count();
    assert_eq!(told, 2, "{}", f.log());
}

#[test]
fn spinning_too_fast_cuts_at_once_and_stays_cut() {
    // GIVEN one axis free, and a kick that no control could stop in time
    let toml = scenario("single_axis_roll")
        .replace("axis = \"roll\"\nangle_rad = 0.349", "torque_flu_nm = [8, 0, 0]")
        .replace("duration_s = 0.4", "duration_s = 0.15");
    let mut f = Flown::new(&toml);
    f.until(9.2);
    let status = f.flight.status();
    assert_eq!((status.mode, status.failsafe, status.cut_latched), (Mode::Cut, Failsafe::RateCut, true), "{}", f.log());
    let cut = f.rows.iter().find(|r| r.report.mode == Mode::Cut).unwrap();
    let rate_dps = cut.truth.body_rates_radps.norm().to_degrees();
    assert!(rate_dps > 900.0, "cut at {rate_dps:.0} °/s");
    assert_eq!(f.last().report.command.throttle, [0.0; 4]);
    assert!(!f.command(Command::Arm).accepted);
}

#[test]
fn a_returning_link_thaws_the_setpoint() {
    let mut f = hovering();
    f.link_lost_s = 12.0;
    f.until(13.0);
    assert_eq!(f.flight.status().failsafe, Failsafe::LinkFreeze);
    f.link_lost_s = f64::INFINITY;
    f.until(13.1);
    assert_eq!(f.flight.status().failsafe, Failsafe::None);
    assert!(f.command(setpoint(0.9)).accepted);
}

#[test]
fn too_much_tilt_cuts_and_stays_cut_until_released() {
    let toml = scenario("single_axis_roll")
        .replace("angle_rad = 0.349", "angle_rad = 1.2")
        .replace("duration_s = 0.4", "duration_s = 1.0");
    let mut f = Flown::new(&toml);
    f.until(9.2);
    let status = f.flight.status();
    assert_eq!((status.mode, status.failsafe, status.cut_latched), (Mode::Cut, Failsafe::TiltCut, true), "{}", f.log());
    let cut_s = f.rows.iter().find(|r| r.report.mode == Mode::Cut).unwrap().t_s;
    assert!((8.3..8.6).contains(&cut_s), "cut at {cut_s}");
    assert!(!f.command(Command::Arm).accepted);
    assert!(!f.command(Command::SetMode(Mode::Stabilise)).accepted);
    // It swings like a pendulum for a while.
    let swinging = f.command(Command::ReleaseCut);
    assert!(!swinging.accepted && swinging.reason.contains("still turning at"), "{}", swinging.reason);
    f.until(90.0);
    let released = f.command(Command::ReleaseCut);
    assert!(released.accepted, "{}", released.reason);
    assert_eq!(f.flight.status().mode, Mode::Disarmed);
}

/// Hovers in free flight within these limits; from 12 s on a gust pushes it aside for so long.
fn in_a_gust(duration_s: f64, force_n: f64, limit: impl FnOnce(&mut Limits)) -> Flown {
    let gust = format!("\n[[push]]\nat_s = 12\nduration_s = {duration_s}\nforce_enu_n = [{force_n}, 0, 0]\n");
    let mut scenario = Scenario::from_toml(&(scenario("hover") + &gust)).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 20.0);
    let mut config = scenario.flight_config();
    limit(&mut config.limits);
    Flown::with_config(scenario, config)
}

#[test]
fn holding_against_a_gust_is_no_loss_of_control_however_little_tilt_may_be_asked_for() {
    // GIVEN hold, and no tilt at all for the operator WHEN a gust takes 15° to hold against THEN it leans and flies on
    let mut f = in_a_gust(2.5, 4.0, |limits| limits.tilt_max_rad = 0.0);
    f.until(14.5);
    let leaning = f.since(12.0).filter(|r| tilt_rad(&r.truth.world_from_body) > 0.18).count();
    assert!(leaning > 120, "leans for {leaning} ticks only");
    assert_eq!(f.last().report.mode, Mode::Hold, "{}", f.log());
}

#[test]
fn an_independent_height_vetoes_an_estimate_that_is_led_astray() {
    let third = SensorId::new(SensorKind::Height, 3);
    let mut f = hovering_with(|c| {
        c.limits.altitude_max_m = 1.0;
        c.independent = vec![third];
    });
    let all = f.command(bias_on(SensorKind::Height, 1..=3, Kind::Ramp, Channel::All, -0.1));
    assert!(!all.accepted && all.reason.contains("height 3 is configured as independent"), "{}", all.reason);
    // Two of three sink slowly together: the estimator follows the majority, and would lead the vehicle up. Its target
    // sinks with what the third says, until the two are so far apart that it descends on attitude alone.
    assert!(f.command(bias_on(SensorKind::Height, 1..=2, Kind::Ramp, Channel::All, -0.1)).accepted);
    f.until(40.0);
    let seen: Vec<_> = f.events.iter().map(|e| e.text.to_string()).collect();
    assert!(seen.iter().any(|t| t.contains("descending on attitude alone")), "{}", f.log());
    let highest = f.rows.iter().map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
    assert!(highest > 0.95 && highest < 1.1, "climbs to {highest:.2} m\n{}", f.log());
    assert_down(&f);
}

#[test]
fn a_vehicle_blown_out_of_its_box_descends() {
    // GIVEN free flight in a box of half a metre WHEN a gust stronger than the tilt it is allowed holds against carries it away
    let mut f = in_a_gust(8.0, 9.0, |limits| limits.lateral_max_m = 0.5);
    f.until(12.0);
    assert_eq!(f.flight.status().failsafe, Failsafe::None, "{}", f.log());
    // THEN it holds at the edge, descends after two seconds outside, and ends on the ground
    f.until(30.0);
    let at = |words: &str| f.events.iter().find(|e| e.text.contains(words)).map(|e| e.time.as_seconds());
    let (held_s, descends_s) = (at("holding at the edge"), at("descending"));
    assert!(held_s.is_some() && descends_s.is_some(), "{held_s:?}, {descends_s:?}\n{}", f.log());
    let (held_s, descends_s) = (held_s.unwrap(), descends_s.unwrap());
    assert!((1.9..2.2).contains(&(descends_s - held_s)), "{held_s} s, {descends_s} s\n{}", f.log());
    let outside = f.rows.iter().find(|r| r.t_s >= held_s).unwrap().truth.position_enu_m.x;
    // Before it is outside, by what it takes to stop.
    assert!((0.05..0.8).contains(&outside), "held at {outside:.2} m");
    assert_down(&f);
}

#[test]
fn the_string_rig_limits_altitude_climb_and_descent() {
    let mut f = hovering();
    assert!(f.command(setpoint(2.0)).accepted);
    f.until(18.0);
    assert!(f.command(setpoint(0.3)).accepted);
    f.until(24.0);
    let highest = f.since(12.0).map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
    assert!((1.9..2.15).contains(&highest), "highest {highest:.2} m");
    // Mean speed over half a second: what the profile asks for, not what the strings shake.
    let rows: Vec<_> = f.since(12.0).map(|r| r.truth.position_enu_m.z).collect();
    let climbs = || rows.windows(100).map(|w| (w[99] - w[0]) / (99.0 * 0.005));
    let (up, down) = (climbs().fold(0.0, f64::max), climbs().fold(0.0, f64::min));
    let limits = f.flight.config().limits;
    assert!((0.8..1.15).contains(&(up / limits.climb_max_mps)), "climbs {up:.2} m/s");
    assert!((0.8..1.15).contains(&(-down / limits.descent_max_mps)), "descends {down:.2} m/s");
}

#[test]
fn two_seconds_after_landing_the_motors_stop() {
    let mut f = hovering();
    assert!(f.command(Command::SetMode(Mode::Land)).accepted);
    f.until(24.0);
    assert_down(&f);
    let disarmed_s = f.rows.iter().find(|r| r.t_s > 12.0 && !r.report.armed).unwrap().t_s;
    let last = f.last().truth.position_enu_m.z;
    let landed_s = f.since(12.0).find(|r| r.truth.position_enu_m.z < last + 0.03).unwrap().t_s;
    assert!((1.0..4.0).contains(&(disarmed_s - landed_s)), "down at {landed_s:.1} s, disarmed at {disarmed_s:.1} s");
}

#[test]
fn imus_that_an_attack_silences_are_as_good_as_lost() {
    // The watchdog has no samples of its own: what the attack withholds is missing there as well.
    let mut f = hovering();
    assert!(f.command(bias_on(SensorKind::Imu, 1..=4, Kind::Dropout, Channel::All, 1.0)).accepted);
    f.until(13.0);
    let status = f.flight.status();
    assert_eq!((status.mode, status.failsafe), (Mode::Cut, Failsafe::ImuCut), "{}", f.log());
    let cut_s = f.rows.iter().find(|r| r.report.mode == Mode::Cut).unwrap().t_s;
    assert!((12.55..12.62).contains(&cut_s), "attacked from 12.5 s on, cut at {cut_s}");
}

#[test]
fn missed_deadlines_warn_then_descend() {
    let mut f = hovering();
    f.flight.ticks_lost(f.vehicle.time(), 6);
    f.until(12.02);
    assert_eq!(f.flight.status().failsafe, Failsafe::DeadlineWarn);
    f.until(13.2);
    assert_eq!(f.flight.status().failsafe, Failsafe::None);
    f.flight.ticks_lost(f.vehicle.time(), 25);
    f.until(20.0);
    assert!(f.events.iter().any(|e| e.text.contains("25 control ticks lost")), "{}", f.log());
    assert_down(&f);
}

#[test]
fn the_operators_cut_is_immediate_latched_and_needs_no_link() {
    let mut f = hovering();
    f.link_lost_s = 12.0;
    f.until(12.1);
    assert!(f.command(Command::CutMotors).accepted);
    f.tick();
    let cut_s = f.last().t_s;
    // Nothing but a release leads out of it.
    assert!(!f.command(Command::Arm).accepted);
    f.until(12.6);
    assert!(f.since(cut_s).all(|r| r.report.command.throttle == [0.0; 4]), "{}", f.log());
    assert!(f.flight.status().cut_latched);
}

#[test]
fn armed_without_take_off_disarms_after_ten_seconds() {
    let toml = scenario("altitude_step");
    let mut scenario = Scenario::from_toml(&toml).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 3.5);
    let config = scenario.flight_config();
    let mut f = Flown::with_config(scenario, config);
    f.until(12.9);
    assert!(f.last().report.armed, "{}", f.log());
    f.until(13.1);
    assert!(!f.last().report.armed);
    assert_eq!(f.flight.status().failsafe, Failsafe::TakeoffTimeout);
}

#[test]
fn orders_that_do_not_fit_are_refused_with_their_values() {
    let mut f = hovering();
    for (command, words) in [
        (setpoint(f64::NAN), "altitude NaN is not a number"),
        (setpoint(3.4), "altitude 3.4 m above limit 2 m"),
        (setpoint(-0.1), "altitude -0.1 m below limit 0 m"),
        (Command::SetMode(Mode::Hold), "horizontal position"),
        (Command::Setpoint(SetpointChange::default()), "changes nothing"),
        (
            Command::Setpoint(SetpointChange { x_m: Some(0.1), ..SetpointChange::default() }),
            "x is not controlled in mode altitude hold",
        ),
        (Command::Arm, "already armed"),
        (Command::ReleaseCut, "no cut is latched"),
        (Command::SelectEstimator(plumbline_agent::types::EstimatorKind::Ukf), "UKF does not run"),
    ] {
        let ack = f.command(command.clone());
        assert!(!ack.accepted && ack.reason.contains(words), "{command:?}: {}", ack.reason);
    }
    f.until(13.0);
    let z = f.last().truth.position_enu_m.z;
    assert!((z - 0.8).abs() < 0.06, "the flight goes on at {z}");
}

#[test]
fn orientation_keeps_below_lift_off_and_refuses_altitude() {
    let mut f = Flown::new(&scenario("string_yaw"));
    f.until(5.0);
    let ack = f.command(Command::SetMode(Mode::AltitudeHold));
    assert!(!ack.accepted && ack.reason.contains("strings, orientation: no altitude hold"), "{}", ack.reason);
    let push = SetpointChange { throttle: Some(1.4), ..SetpointChange::default() };
    assert!(f.command(Command::Setpoint(push)).accepted);
    f.until(9.0);
    let (z, tension) = (f.last().truth.position_enu_m.z, f.last().truth.string_tension_n.iter().sum::<f64>());
    // The string carries what the motors may not, and what swings about on it does not rise far.
    assert!(tension > 0.1 * f.flight.config().airframe.weight_n(), "{tension} N left on the string");
    assert!(z < 1.1, "lifted to {z}");
    // There is nothing to come down from: asked to land, it stops.
    let ack = f.command(Command::SetMode(Mode::Land));
    assert!(ack.accepted && ack.reason.contains("strings, orientation: disarmed"), "{}", ack.reason);
    f.tick();
    assert_down(&f);
}

#[test]
fn arming_names_every_check_that_fails() {
    let mut f = Flown::new(&scenario("altitude_step"));
    f.link_lost_s = 0.0;
    f.until(2.9);
    f.flight.log_health(Some("disk full: 0 bytes free"));
    let ack = f.command(Command::Arm);
    assert!(!ack.accepted && ack.reason.starts_with("link: last heartbeat inf s ago"), "{}", ack.reason);
    assert!(ack.reason.contains("1 more"), "{}", ack.reason);
    let status = f.flight.status();
    assert!(!status.ready_to_arm);
    let failing: Vec<_> = status.checks.iter().filter(|c| !c.passed).map(|c| (c.name, c.reason.as_str())).collect();
    assert_eq!(failing.len(), 2, "{failing:?}");
    assert_eq!(failing[1], ("log", "disk full: 0 bytes free"));
}

#[test]
fn a_device_that_gives_nothing_refuses_arming_by_its_name() {
    let mut f = Flown::new(&scenario("altitude_step"));
    f.until(2.9);
    assert!(f.flight.status().checks.iter().all(|check| check.name != "devices"), "a simulated vehicle has none");
    f.flight.device_health(3, Some(text(format_args!("cameras: no reading within 0.50 s"))));
    let ack = f.command(Command::Arm);
    assert!(!ack.accepted && ack.reason.as_str() == "devices: cameras: no reading within 0.50 s", "{}", ack.reason);
    f.flight.device_health(3, None);
    let ack = f.command(Command::Arm);
    assert!(ack.accepted, "{}", ack.reason);
}
