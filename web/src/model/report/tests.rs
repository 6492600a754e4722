use plumbline_proto::v1::{self, AttackPhase};
use plumbline_rest::flight::{EstimatorError, Samples, Step};

use super::*;
use crate::model::curves::Curve;

fn span(live: &mut Live, sensor: i32, instance: u32, start_us: u64, end_us: u64) {
    let attack = v1::Attack { id: instance, sensor, instance, kind: 2, magnitude: 0.5, ..Default::default() };
    let mut progress = v1::AttackProgress { attack: Some(attack), ..Default::default() };
    progress.set_phase(AttackPhase::Done);
    progress.active_time_us = Some(start_us);
    progress.ended_time_us = Some(end_us);
    live.log.attacks.update(&v1::AttackState { attacks: vec![progress], ..Default::default() });
}

/// Ten seconds at 10 Hz, sensor 2/2 attacked from 4 s to 6 s.
fn flown() -> Live {
    let mut live = Live::recorded();
    for i in 0..=100_u64 {
        live.curves.push(Curve::SetpointAltitude, i * 100_000, 1.0);
        live.curves.push(Curve::TruthAltitude, i * 100_000, 1.01);
        live.curves.push(Curve::Suspicion(2, 2), i * 100_000, 0.2);
    }
    span(&mut live, 2, 2, 4_000_000, 6_000_000);
    live
}

/// What the ground found in it.
fn found() -> Figures {
    let effect = AttackEffect {
        id: 2,
        isolated_after_s: Some(0.5),
        deviation_m: Some([0.1, 0.07]),
        rms_before_m: Some(0.01),
        excluded: vec![[2, 2], [2, 3]],
        ..AttackEffect::default()
    };
    let of = |estimator, rms| EstimatorError { estimator, altitude_mm: Some([rms, 90.0]), ..EstimatorError::default() };
    let estimators = vec![of(1, 80.0), of(4, 20.0)];
    Figures { truth: true, estimators, attacks: vec![effect], ..Figures::default() }
}

#[test]
fn an_attack_has_its_delay_its_damage_and_its_false_exclusions() {
    let flight = Flight { vehicle_id: "iris-1".into(), duration_s: 10.0, ..Flight::default() };
    let report = Report::of(flight, &flown(), &found(), Vec::new());
    let [attack] = report.attacks.as_slice() else { panic!("{:?}", report.attacks) };
    assert_eq!((attack.isolated_after_s, attack.rejected_after_s), (Some(0.5), None));
    assert_eq!((attack.largest_m, attack.rms_m), (Some(0.1), [Some(0.07), Some(0.01)]));
    assert_eq!(attack.false_exclusions.len(), 1, "of the attacked one none is false");
    assert!(report.sentence.contains("isolated after 0.50 s, altitude off by 100 mm at most."), "{}", report.sentence);
    assert!(report.sentence.contains("flew for 0:10 min") && report.sentence.ends_with("No failsafe acted."));
    let other =
        Figures { attacks: vec![AttackEffect { accepted_time_us: 1, ..found().attacks[0].clone() }], ..found() };
    let report = Report::of(Flight::default(), &flown(), &other, Vec::new());
    assert_eq!(report.attacks[0].largest_m, None, "that is of another schedule");
}

#[test]
fn a_single_step_has_no_sigma_and_interrupted_ones_settle_nowhere() {
    let step = |rise, interrupted| Step {
        rise_time_s: Some(rise),
        settling_time_s: Some(9.0),
        interrupted,
        ..Step::default()
    };
    let [rise, _, settling, error] = step_spreads(&[step(1.0, false), step(3.0, true)]);
    assert_eq!(rise, Some(Spread { mean: 2.0, sigma: Some(2.0_f64.sqrt()), count: 2 }));
    assert_eq!(settling, Some(Spread { mean: 9.0, sigma: None, count: 1 }));
    assert_eq!(error, None);
}

#[test]
fn estimators_are_ranked_by_altitude_where_truth_is_known() {
    let ranked = ranking(&found());
    assert_eq!(ranked.iter().map(|r| r.number).collect::<Vec<_>>(), [4, 1]);
    assert_eq!(ranked[0].altitude_mm, Some([20.0, 90.0]));
    assert!(ranking(&Figures { truth: false, ..found() }).is_empty());
}

#[test]
fn the_errors_of_a_report_are_drawn_at_their_time() {
    let mut live = flown();
    let altitude_error_mm = Samples { samples: 2, time_s: vec![0.0, 3.0], value: vec![5.0, -7.0] };
    let of = EstimatorError { estimator: 4, altitude_error_mm, ..EstimatorError::default() };
    live.curves.set_errors(&Figures { start_s: 2.0, estimators: vec![of], ..Figures::default() });
    assert_eq!(live.curves.value_at(Curve::AltitudeError(4), 5.0), Some(-7.0));
    assert!(figures(&live).iter().any(|figure| figure.title == "Altitude: estimate minus truth"));
}

#[test]
fn an_autopilot_is_held_to_what_it_was_asked_for() {
    let told = |asked: f64, off| plumbline_rest::flight::Followed { asked_rms: Some(asked), off };
    let autopilot = vec![told(0.5, Some([0.1, 0.1])), told(0.0, None), told(0.0, None), told(0.4, None)];
    let mut live = flown();
    let rates = Some(v1::Vector3 { x: 0.5, y: 0.0, z: 0.0 });
    for i in 0..=100_u64 {
        let autopilot = v1::AutopilotControl { rates_asked_flu_radps: rates, ..Default::default() };
        live.curves.push_control(&v1::Control {
            time_us: i * 100_000,
            autopilot: Some(autopilot),
            ..Default::default()
        });
    }
    let report = Report::of(Flight::default(), &live, &Figures { autopilot, ..found() }, Vec::new());
    let body = report.html(&live, 0);
    assert!(
        body.contains("<td>roll rate, rad/s</td><td class=\"num\">0.500</td><td class=\"num\">0.100</td>"),
        "{body}"
    );
    assert!(body.contains("Rates asked of the autopilot") && report.latex(0).contains("thrust, 0 to 1 & 0.400 & ---"));
}

#[test]
fn the_document_needs_nothing_else_and_says_only_what_was_said() {
    let flight =
        Flight { name: "<script>alert(1)</script> & more".into(), notes: "a \"note\"".into(), ..Flight::default() };
    let live = flown();
    let body = Report::of(flight, &live, &found(), vec![("page".into(), "1".into())]).html(&live, 0);
    let text = document("a < b", &body);
    assert!(text.contains("&lt;script&gt;alert(1)&lt;/script&gt; &amp; more") && !text.contains("<script"));
    for elsewhere in ["http:", "https:", "src=", "href=", "url("] {
        assert!(!text.contains(elsewhere), "{elsewhere}");
    }
    assert!(text.contains("<svg") && text.contains("class=\"attacked\"") && text.contains("No step of the altitude"));
}

#[test]
fn a_report_alone_has_the_colours_of_the_light_page() {
    let style = include_str!("../../../report.css");
    let light = include_str!("../../../style.css").split_once("\n}\n").unwrap().0;
    let named: Vec<&str> =
        style.split("--").skip(1).filter_map(|part| part.split_once(": #")).map(|(name, _)| name).collect();
    assert!(named.len() >= 30, "both of them, alone and printed");
    for part in style.split("--").skip(1).filter(|part| part.contains(": #")) {
        let declared = format!("--{}", part.split(';').next().unwrap());
        assert!(light.contains(&declared), "{declared} is not the page's");
    }
    let sizes = ["small", "text", "large", "title"].into_iter().filter(|size| style.contains(&format!("--{size}: ")));
    let named: Vec<&str> = named.into_iter().chain(sizes).collect();
    for used in style.split("var(--").skip(1).filter_map(|part| part.split_once(')')).map(|(name, _)| name) {
        assert!(named.contains(&used), "--{used} is not declared");
    }
}
