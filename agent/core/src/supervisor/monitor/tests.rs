//! Each row at its time.

use super::*;

fn fine(now_s: f64) -> Inputs {
    Inputs {
        now: FlightTime::from_seconds(now_s),
        flying: true,
        imu_age_s: 0.01,
        tilt_rad: 0.1,
        tilt_agreed_rad: 0.1,
        tilt_max_rad: 0.35,
        rate_radps: 1.0,
        raw_height_m: Some(1.0),
        altitude_m: Some(1.0),
        climb_mps: 0.0,
        lift_mps2: 0.0,
        altitude_needed: true,
        lateral: None,
        position_lost: false,
        degraded: false,
        corroborated: false,
        not_moving: false,
        charge: Some(0.8),
        link_age_s: 0.1,
        operator_age_s: 0.0,
        altitude_max_m: 2.0,
        lateral_max_m: 2.0,
    }
}

/// Runs `change` from 1 s on and returns when each verdict first appears.
fn first_seen(change: impl Fn(f64, &mut Inputs)) -> Vec<(Failsafe, f64)> {
    let mut monitor = Monitor::new(Settings::default());
    let mut seen: Vec<(Failsafe, f64)> = Vec::new();
    for k in 0..1200 {
        let t = f64::from(k) * 0.005;
        let mut inputs = fine(t);
        if t >= 1.0 {
            change(t - 1.0, &mut inputs);
        }
        let verdict = monitor.judge(&inputs);
        if seen.last().is_none_or(|s| s.0 != verdict) {
            seen.push((verdict, t - 1.0));
        }
    }
    seen
}

fn expect(seen: &[(Failsafe, f64)], expected: &[(Failsafe, f64)]) {
    assert_eq!(seen.len(), expected.len() + 1, "{seen:?}");
    for (s, e) in seen.iter().skip(1).zip(expected) {
        assert!(s.0 == e.0 && (s.1 - e.1).abs() < 0.011, "{seen:?}, expected {expected:?}");
    }
}

#[test]
fn every_row_of_the_table_comes_at_its_time() {
    expect(&first_seen(|t, i| i.link_age_s = t), &[(Failsafe::LinkFreeze, 0.5), (Failsafe::LinkDescend, 2.0)]);
    expect(
        &first_seen(|t, i| i.operator_age_s = 4.0 * t),
        &[(Failsafe::OperatorFreeze, 0.75), (Failsafe::OperatorDescend, 2.5)],
    );
    expect(&first_seen(|_, i| i.tilt_rad = 61.0_f64.to_radians()), &[(Failsafe::TiltCut, 0.3)]);
    // In doubt inside the box: patience. On its way out of it upwards: none for an estimator that takes it to be lower.
    let doubted = |climb_mps: f64, altitude_m: f64| {
        move |_, i: &mut Inputs| (i.degraded, i.climb_mps, i.altitude_m) = (true, climb_mps, Some(altitude_m))
    };
    expect(&first_seen(doubted(0.0, 0.4)), &[(Failsafe::EstimatorDescend, 0.2)]);
    // Not degraded: the watchdog has to disagree, by 10 cm and more.
    let held_down = |altitude_m: f64, corroborated: bool| {
        move |_, i: &mut Inputs| (i.corroborated, i.climb_mps, i.altitude_m) = (corroborated, 4.0, Some(altitude_m))
    };
    expect(&first_seen(held_down(0.85, false)), &[(Failsafe::EstimatorDescend, 0.0)]);
    expect(&first_seen(held_down(0.85, true)), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
    expect(&first_seen(doubted(3.0, 0.4)), &[(Failsafe::EstimatorDescend, 0.0)]);
    expect(&first_seen(doubted(3.0, 1.6)), &[(Failsafe::BoxHold, 0.0), (Failsafe::EstimatorDescend, 0.2)]);
    let low = |_, i: &mut Inputs| (i.tilt_rad, i.raw_height_m) = (61.0_f64.to_radians(), Some(0.4));
    expect(&first_seen(low), &[(Failsafe::TiltCut, 0.1)]);
    // 20 degrees may be asked for, and watchdog and estimator must agree on more.
    let both = |degrees: f64, flying: bool| {
        let tilt_rad = degrees.to_radians();
        move |_, i: &mut Inputs| (i.tilt_rad, i.tilt_agreed_rad, i.flying) = (tilt_rad, tilt_rad, flying)
    };
    expect(&first_seen(both(29.0, true)), &[]);
    expect(&first_seen(both(31.0, true)), &[(Failsafe::TiltCut, 0.5)]);
    expect(&first_seen(both(31.0, false)), &[]);
    expect(&first_seen(|_, i| i.tilt_rad = 59.0_f64.to_radians()), &[]);
    expect(&first_seen(|t, i| i.tilt_agreed_rad = if t < 0.45 { 0.8 } else { 0.0 }), &[]);
    expect(&first_seen(|_, i| i.rate_radps = 1001.0_f64.to_radians()), &[(Failsafe::RateCut, 0.0)]);
    expect(&first_seen(|_, i| i.altitude_m = Some(2.4)), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
    // The estimate is wrong, the raw heights are not; or the watchdog agrees with it.
    expect(&first_seen(|_, i| i.raw_height_m = Some(2.4)), &[(Failsafe::EstimatorDescend, 0.0)]);
    expect(
        &first_seen(|_, i| (i.raw_height_m, i.corroborated) = (Some(2.4), true)),
        &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)],
    );
    expect(
        &first_seen(|_, i| i.lateral = Some(Outward { distance_m: 2.4, speed_mps: 0.0, pull_mps2: 0.0 })),
        &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)],
    );
    // Inside and slow, but tilted outwards: 0.5 m/s need 0.12 m, and with 20 degrees 0.28 m.
    let tilted = |pull_mps2| Some(Outward { distance_m: 2.05, speed_mps: 0.5, pull_mps2 });
    expect(&first_seen(|_, i| i.lateral = tilted(0.0)), &[]);
    expect(&first_seen(|_, i| i.lateral = tilted(3.5)), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
    expect(&first_seen(|_, i| i.degraded = true), &[(Failsafe::EstimatorDescend, 0.2)]);
    expect(&first_seen(|_, i| (i.degraded, i.corroborated) = (true, true)), &[(Failsafe::EstimatorDescend, 1.0)]);
    expect(&first_seen(|t, i| i.imu_age_s = t), &[(Failsafe::ImuCut, 0.08)]);
    expect(&first_seen(|_, i| i.altitude_m = None), &[(Failsafe::AltitudeDescend, 0.0)]);
    expect(&first_seen(|_, i| (i.altitude_m, i.altitude_needed) = (None, false)), &[]);
    expect(&first_seen(|t, i| i.position_lost = t < 4.0), &[(Failsafe::PositionHold, 0.0), (Failsafe::None, 4.0)]);
    expect(&first_seen(|_, i| i.charge = Some(0.24)), &[(Failsafe::BatteryLow, 3.0)]);
    expect(&first_seen(|_, i| i.charge = Some(0.14)), &[(Failsafe::BatteryDescend, 3.0)]);
    expect(&first_seen(|_, i| i.not_moving = true), &[(Failsafe::ThrustDescend, 1.5)]);
    // Inside, but too fast to stop there: 4 m/s need 1.8 m.
    expect(&first_seen(|_, i| i.climb_mps = 4.0), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
    expect(&first_seen(|_, i| i.climb_mps = 3.0), &[]);
    // With half a g of thrust to spare 3 m/s are too many.
    expect(
        &first_seen(|_, i| (i.climb_mps, i.lift_mps2) = (3.0, 4.9)),
        &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)],
    );
    // A short tilt is forgiven.
    expect(&first_seen(|t, i| i.tilt_rad = if t < 0.28 { 1.2 } else { 0.0 }), &[]);
}

#[test]
fn lost_ticks_warn_then_descend_and_are_forgotten_after_a_second() {
    let mut monitor = Monitor::new(Settings::default());
    monitor.ticks_lost(FlightTime(10_000), 4);
    assert_eq!(monitor.judge(&fine(0.02)), Failsafe::None);
    monitor.ticks_lost(FlightTime(25_000), 1);
    assert_eq!(monitor.judge(&fine(0.03)), Failsafe::DeadlineWarn);
    monitor.ticks_lost(FlightTime(150_000), 15);
    assert_eq!(monitor.judge(&fine(0.16)), Failsafe::DeadlineDescend);
    assert_eq!(monitor.judge(&fine(1.2)), Failsafe::None);
    // One gap of three seconds is as many ticks as it lasted.
    monitor.ticks_lost(FlightTime(4_000_000), 600);
    assert_eq!(monitor.judge(&fine(4.0)), Failsafe::DeadlineDescend);
}

#[test]
fn the_edge_of_the_box_comes_before_a_frozen_setpoint() {
    let leaving = |i: &mut Inputs, age_s: f64| (i.climb_mps, i.link_age_s, i.operator_age_s) = (4.0, age_s, 4.0);
    expect(&first_seen(|_, i| leaving(i, 1.0)), &[(Failsafe::BoxHold, 0.0), (Failsafe::BoxDescend, 2.0)]);
}

#[test]
fn what_was_taken_over_stays_so_until_the_operator_acts() {
    let mut monitor = Monitor::new(Settings::default());
    monitor.took_over();
    assert_eq!(monitor.judge(&fine(1.0)), Failsafe::BoxHold);
    assert_eq!(monitor.judge(&fine(3.1)), Failsafe::BoxDescend);
    monitor.operator_acted();
    assert_eq!(monitor.judge(&fine(3.2)), Failsafe::None);
}

#[test]
fn what_is_not_measured_is_said_to_be_so() {
    let monitor = Monitor::new(Settings::default());
    let inputs = Inputs { altitude_m: Some(2.4), raw_height_m: None, lateral: None, ..fine(1.0) };
    let said = monitor.reason(Failsafe::BoxHold, &inputs);
    assert!(said.contains("altitude 2.40 m (raw not measured") && said.contains("lateral not measured:"), "{said}");
    let aside = Some(Outward { distance_m: 2.05, speed_mps: 0.5, pull_mps2: 0.0 });
    let said = monitor.reason(Failsafe::BoxHold, &Inputs { lateral: aside, ..inputs });
    assert!(said.contains("lateral 2.05 m (limit 2.00 m) at 0.5 m/s"), "{said}");
}
