//! The everyday use: a hanging-string test with altitude steps, through the real programs.

use plumbline_proto::{Kind, v1};
use plumbline_support::system::{PATIENCE, Rig, scenario};
use serde_json::json;

/// "Must reach" of the main job: 0.5 → 1.0 m on the strings.
const SETTLING_LIMIT_S: f64 = 4.0;
const OVERSHOOT_LIMIT_PERCENT: f64 = 15.0;
/// The band of the settling time, and what the integral action must get inside.
const BAND_M: f64 = 0.05;
/// Holding an altitude: within 2 cm of it, and moving less than 2 cm/s.
const HOLDING_M: f64 = 0.02;

#[test]
fn an_altitude_step_on_the_strings_settles_as_promised() {
    // GIVEN the quadrotor on its strings, armed, holding 0.5 m
    let rig = Rig::start(&scenario("altitude_step"));
    let mut live = rig.live();
    rig.fly_to(0.5);
    live.step_response(0.5);
    live.until(PATIENCE, "steady 0.5 m", |frame| {
        let truth: v1::Truth = frame.message(Kind::Truth)?;
        ((truth.position_enu_m?.z - 0.5).abs() < HOLDING_M && truth.velocity_enu_mps?.z.abs() < HOLDING_M).then_some(())
    });
    // WHEN the setpoint steps to 1.0 m
    rig.command("POST", "setpoint", json!({ "altitude_m": 1.0 }));
    let step = live.step_response(1.0);
    // THEN it settles in time, with little overshoot, and stays there
    let settling = step.settling_time_s.expect("settles");
    assert!(settling <= SETTLING_LIMIT_S, "settles in {settling} s: {step:?}");
    assert!(step.overshoot_percent <= OVERSHOOT_LIMIT_PERCENT, "{step:?}");
    assert!(step.rise_time_s.is_some_and(|rise| rise > 0.0 && rise < settling), "{step:?}");
    assert!(step.steady_error_m.is_some_and(|error| error.abs() < BAND_M), "{step:?}");
    assert_eq!(step.band_m, BAND_M);
    // AND what the meter says is what the truth did
    let truth = live.until(PATIENCE, "truth", |frame| frame.message::<v1::Truth>(Kind::Truth));
    let altitude = truth.position_enu_m.unwrap().z;
    assert!((altitude - 1.0).abs() < 2.0 * BAND_M, "true altitude {altitude} m");
    // AND what was asked on a picture of seconds ago is refused, whatever held it up
    let asked_on = |time_us: u64| {
        let body = json!({ "altitude_m": 0.7 }).to_string();
        let seen = [("X-Plumbline-Seen", &*time_us.to_string())];
        rig.api().request("POST", &rig.system().vehicle("setpoint"), Some(body.as_bytes()), &seen).unwrap()
    };
    let seen_us = live.status("a status", |status| status.armed).time_us;
    let stale = asked_on(seen_us - 3_000_000);
    assert!(stale.status == 409 && stale.text().contains("picture 3."), "{} {}", stale.status, stale.text());
    let rebooted = asked_on(seen_us + 60_000_000);
    assert!(rebooted.status == 409 && rebooted.text().contains("before the agent's start"), "{}", rebooted.text());
    let newest_us = rig.live().status("a new status", |status| status.time_us > seen_us).time_us;
    assert_eq!(asked_on(newest_us).status, 200);
    rig.disarm();
    live.status("disarmed status", |status| !status.armed);
    rig.stop();
}
