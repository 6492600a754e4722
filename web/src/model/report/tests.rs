use plumbline_proto::v1::{self, AttackPhase};
use plumbline_rest::flight::Step;

use super::*;

fn span(live: &mut Live, sensor: i32, instance: u32, start_us: u64, end_us: u64) {
    let attack = v1::Attack { id: instance, sensor, instance, kind: 2, magnitude: 0.5, ..Default::default() };
    let mut progress = v1::AttackProgress { attack: Some(attack), ..Default::default() };
    progress.set_phase(AttackPhase::Done);
    progress.active_time_us = Some(start_us);
    progress.ended_time_us = Some(end_us);
    live.log.attacks.update(&v1::AttackState { attacks: vec![progress], ..Default::default() });
}

/// Ten seconds at 10 Hz: 10 mm high, 100 mm while sensor 2/2 is attacked, from 4 s to 6 s.
fn flown() -> Live {
    let mut live = Live::recorded();
    for i in 0..=100_u64 {
        let (t, attacked) = (i * 100_000, (40..60).contains(&i));
        live.curves.push(Curve::SetpointAltitude, t, 1.0);
        live.curves.push(Curve::TruthAltitude, t, if attacked { 1.1 } else { 1.01 });
        for instance in 1..=3 {
            // Flagged half a second late; a healthy one with it, for a moment.
            let flagged = instance == 2 && (45..60).contains(&i) || instance == 3 && i == 50;
            live.curves.push(Curve::Suspicion(2, instance), t, if flagged { 1.5 } else { 0.2 });
        }
    }
    span(&mut live, 2, 2, 4_000_000, 6_000_000);
    live
}

#[test]
fn an_attack_has_its_delay_its_damage_and_its_false_exclusions() {
    let report =
        Report::of(Flight { vehicle_id: "iris-1".into(), duration_s: 10.0, ..Flight::default() }, &flown(), Vec::new());
    let [attack] = report.attacks.as_slice() else { panic!("{:?}", report.attacks) };
    assert!((attack.isolated_after_s.unwrap() - 0.5).abs() < 1e-9);
    assert_eq!(attack.rejected_after_s, None);
    assert!((attack.largest_m.unwrap() - 0.1).abs() < 1e-6);
    assert!((attack.rms_m[1].unwrap() - 0.01).abs() < 1e-6, "{:?}", attack.rms_m);
    assert_eq!(attack.false_exclusions.len(), 1);
    assert!(report.sentence.contains("isolated after 0.50 s, altitude off by 100 mm at most."), "{}", report.sentence);
    assert!(report.sentence.contains("flew for 0:10 min") && report.sentence.ends_with("No failsafe acted."));
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
    let mut live = flown();
    assert!(ranking(&live).is_empty(), "none has flown");
    for number in [1_u16, 4] {
        live.estimates.entry(number).or_default();
        for i in 0..100_u64 {
            live.curves.push(Curve::Altitude(number), i * 100_000, if number == 1 { 1.5 } else { 1.02 });
        }
    }
    live.curves.follow_errors();
    let ranked = ranking(&live);
    assert_eq!(ranked.iter().map(|r| r.number).collect::<Vec<_>>(), [4, 1]);
    assert!(ranked[0].altitude_mm.unwrap()[1] > 79.0, "{ranked:?}");
}

#[test]
fn an_autopilot_is_held_to_what_it_was_asked_for() {
    assert!(autopilot(&flown()).is_empty(), "the motors were commanded");
    let mut live = flown();
    let rates = |x| Some(v1::Vector3 { x, y: 0.0, z: 0.0 });
    for i in 0..=100_u64 {
        // It is told of late, and then 0.1 rad/s short of what was asked.
        let autopilot = v1::AutopilotControl {
            rates_asked_flu_radps: rates(0.5),
            thrust_asked: Some(0.4),
            rates_target_flu_radps: if i < 20 { None } else { rates(0.4) },
            ..Default::default()
        };
        live.curves.push_control(&v1::Control {
            time_us: i * 100_000,
            autopilot: Some(autopilot),
            ..Default::default()
        });
    }
    let report = Report::of(Flight::default(), &live, Vec::new());
    let [roll, pitch, _, thrust] = report.autopilot.as_slice() else { panic!("{:?}", report.autopilot) };
    let [largest, off] = roll.off.unwrap();
    assert!(
        (roll.asked_rms - 0.5).abs() < 1e-6 && (off - 0.1).abs() < 1e-6 && (largest - 0.1).abs() < 1e-6,
        "{roll:?}"
    );
    assert_eq!(pitch.off, Some([0.0; 2]));
    assert_eq!((thrust.demand, thrust.off), (Demand::Thrust, None), "it did not say");
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
    let body = Report::of(flight, &live, vec![("page".into(), "1".into())]).html(&live, 0);
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
