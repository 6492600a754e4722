//! Inject an attack, watch which sensor is attacked, abort it.

use std::time::Duration;

use plumbline_proto::{Kind, v1};
use plumbline_support::system::{Live, OwnedFrame, Rig, scenario};
use serde_json::json;

const SECONDS_20: Duration = Duration::from_secs(20);

/// Largest |innovation| / gate of each height sensor in this frame, if it holds any, for the estimator in the loop.
fn height_ratio(frame: &OwnedFrame, instance: u32) -> Option<f64> {
    let residuals: v1::Residuals = frame.message(Kind::Residuals)?;
    let mine = residuals.residuals.iter();
    mine.filter(|r| r.sensor() == v1::SensorKind::Height && r.instance == instance).map(|r| r.ratio).reduce(f64::max)
}

#[test]
fn an_attack_is_accepted_seen_active_crosses_its_gate_and_is_aborted() {
    // GIVEN a vehicle that holds 0.5 m
    let rig = Rig::start(&scenario("altitude_step"));
    let mut live = rig.live();
    rig.fly_to(0.5);
    live.step_response(0.5);
    // WHEN height 2 is to lie by half a metre, one second from now
    let attack = json!({ "sensor": "height", "instance": 2, "channel": "all", "kind": "bias",
        "start_s": 1.0, "duration_s": 10.0, "magnitude": 0.5, "seed": 1 });
    rig.command("PUT", "attacks", json!({ "attacks": [attack] }));
    // THEN it is accepted first, and seen active only once a sample was altered
    let phase = |frame: &OwnedFrame, wanted: v1::AttackPhase| {
        let state: v1::AttackState = frame.message(Kind::Attacks)?;
        let progress = state.attacks.first()?;
        (progress.phase() == wanted).then_some(*progress)
    };
    let accepted = live.until(SECONDS_20, "accepted attack", |frame| phase(frame, v1::AttackPhase::Accepted));
    assert_eq!((accepted.active_time_us, accepted.altered_samples), (None, 0));
    let active = live.until(SECONDS_20, "active attack", |frame| phase(frame, v1::AttackPhase::Active));
    let onset_s = (active.active_time_us.unwrap() - active.accepted_time_us) as f64 * 1e-6;
    assert!((1.0..1.2).contains(&onset_s), "first altered sample {onset_s} s after acceptance");
    // AND its residual crosses the gate while its neighbours' stay inside
    let attacked =
        live.until(SECONDS_20, "height 2 beyond its gate", |frame| height_ratio(frame, 2).filter(|ratio| *ratio > 1.0));
    assert!(attacked > 1.0);
    let mut healthy = Vec::new();
    live.until(SECONDS_20, "ten residuals of height 1 and 3", |frame| {
        healthy.extend(height_ratio(frame, 1));
        healthy.extend(height_ratio(frame, 3));
        (healthy.len() >= 10).then_some(())
    });
    healthy.sort_by(f64::total_cmp);
    assert!(healthy[healthy.len() / 2] < 0.8, "the healthy sensors are rejected: {healthy:?}");
    // AND sensed and received samples differ by the bias, only on that sensor
    let sample = |live: &mut Live, instance: u16| {
        live.until(SECONDS_20, "height sample", |frame| {
            (frame.instance == instance).then(|| frame.message::<v1::HeightSample>(Kind::Height)).flatten()
        })
    };
    let biased = sample(&mut live, 2);
    assert!((biased.received_m.unwrap() - biased.sensed_m - 0.5).abs() < 1e-6, "{biased:?}");
    let healthy = sample(&mut live, 1);
    assert_eq!(healthy.received_m.unwrap_or(healthy.sensed_m), healthy.sensed_m, "{healthy:?}");
    // WHEN it is aborted with one action THEN it ends at once
    rig.command("DELETE", "attacks", json!({}));
    live.until(SECONDS_20, "aborted attack", |frame| phase(frame, v1::AttackPhase::Aborted));
    // AND the flight file tells of it
    rig.disarm();
    let flight = rig.finished_flight();
    let told = &flight["attacks"][0];
    assert_eq!((told["sensor"].as_str(), told["instance"].as_u64()), (Some("height"), Some(2)), "{told}");
    assert_eq!(told["phase"], "aborted", "{told}");
    rig.stop();
}
