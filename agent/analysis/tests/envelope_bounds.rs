//! The attack envelope against its prototype, and against other people's solver.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use plumbline_analysis::envelope::prototype::Prototype;
use plumbline_analysis::envelope::sets::Asked;
use plumbline_analysis::envelope::{Deviation, EnvelopeError, program, recession_mps};
use plumbline_rest::envelope::EnvelopeQuestion;

fn of(lasers: usize, attacked: usize, imus: usize, gate_only: bool) -> Prototype {
    let (attacked_lasers, attacked_imus) = ((0..attacked).collect(), (0..imus).collect());
    Prototype { lasers, attacked_lasers, attacked_imus, gate_only }
}

/// The table of the prototype, cm over 10 s, and beside it with sample gates only.
const TABLE: [(usize, usize, usize, f64, f64); 8] = [
    (3, 1, 0, 4.8, 14.1),
    (3, 2, 0, 9.5, 18.5),
    (5, 1, 0, 2.9, 6.2),
    (5, 2, 0, 7.5, 16.3),
    (5, 4, 0, 11.3, 17.9),
    (3, 0, 1, 8.7, 73.0),
    (3, 0, 2, 25.0, 74.0),
    (3, 1, 1, 13.5, 73.0),
];

#[test]
fn the_table_of_the_prototype() {
    for (lasers, attacked, imus, voted, gated) in TABLE {
        for (gate_only, expected) in [(false, voted), (true, gated)] {
            let model = of(lasers, attacked, imus, gate_only);
            let bound = program(&model, 10.0, Deviation::Altitude).unwrap().solve().unwrap();
            let (upper, reached) = (100.0 * bound.upper, 100.0 * bound.reached);
            println!(
                "{attacked} of {lasers}, {imus} IMUs, gates only {gate_only}: {reached:.3} to {upper:.3} cm (prototype {expected}), {} rounds, {:?}",
                bound.rounds, bound.binding
            );
            assert!((upper / expected - 1.0).abs() < 0.05, "{upper} cm, prototype {expected}");
            assert!(reached > 0.99 * upper && reached <= upper, "{reached} {upper}");
        }
    }
}

#[test]
fn all_lasers_have_no_end_and_two_of_three_have() {
    let silent_mps = recession_mps(&of(3, 3, 0, false)).unwrap().unwrap();
    println!("all lasers drift with {silent_mps:.4} m/s for ever");
    assert!(silent_mps > 0.001);
    assert_eq!(recession_mps(&of(3, 2, 0, false)).unwrap(), None);
}

fn asked(question: EnvelopeQuestion) -> Result<Asked, EnvelopeError> {
    Asked::new(&question, None)
}

fn refused(question: EnvelopeQuestion) -> String {
    asked(question).unwrap_err().to_string()
}

#[test]
fn every_sensor_of_the_default_suite_has_a_bound_and_all_heights_have_none() {
    let one = EnvelopeQuestion { most: Some(1), ..EnvelopeQuestion::default() };
    let answer = asked(one).unwrap().answer(false, |set| println!("{set:?}")).unwrap();
    assert_eq!(answer.sets.len(), 7);
    for set in &answer.sets {
        let (upper, reached) = (set.altitude_m.unwrap(), set.reached_m.unwrap());
        assert!(reached > 0.0 && reached <= upper && reached > 0.98 * upper, "{set:?}");
        assert!(set.binding.is_some() && set.drift_mps.is_none(), "{set:?}");
    }
    // What is alike has one program.
    assert!(answer.sets.iter().filter(|set| set.took_ms == 0.0).count() == 3);
    let all = Some(["height 1", "height 2", "height 3"].map(str::to_owned).to_vec());
    let all = asked(EnvelopeQuestion { sensors: all, ..Default::default() }).unwrap().answer(false, |_| ()).unwrap();
    println!("{:?}", all.sets);
    assert!(all.sets[0].altitude_m.is_none() && all.sets[0].drift_mps.is_some_and(|drift| drift > 0.001));
}

#[test]
fn what_cannot_be_bounded_says_why_with_the_value() {
    let question = EnvelopeQuestion::default;
    let of = |names: &[&str]| Some(names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
    assert_eq!(
        refused(EnvelopeQuestion { sensors: of(&["height 9"]), ..question() }),
        "sensor height 9 is not one of the suite's heights and IMUs: height 1, height 2, height 3, imu 1, imu 2, imu 3, imu 4"
    );
    assert!(
        refused(EnvelopeQuestion { sensors: of(&["sonar"]), ..question() }).starts_with("sensor sonar is not one of")
    );
    assert_eq!(
        refused(EnvelopeQuestion { most: Some(8), ..question() }),
        "a set of 8 sensors: the suite has 7 heights and IMUs"
    );
    assert!(refused(EnvelopeQuestion { suite: Some("moon".into()), ..question() }).contains("\"moon\""));
    assert!(refused(EnvelopeQuestion { horizon_s: Some(1e9), ..question() }).contains("1000000000"));
    assert!(refused(EnvelopeQuestion { noise_mps2: Some(-1.0), ..question() }).contains("-1"));
    let mut unstable = question();
    unstable.design.tick_rate_hz = Some(200.0);
    let mut k = vec![vec![0.0; 16]; 4];
    // Pushes away from the setpoint.
    k[0][2] = -50.0;
    (unstable.design.k, unstable.design.k_attitude) = (Some(k.clone()), Some(k));
    let told = refused(unstable);
    assert!(told.starts_with("these gains do not stabilise: the slowest pole is at +"), "{told}");
    let mut odd = question();
    odd.design.tick_rate_hz = Some(333.0);
    assert_eq!(refused(odd), "tick_rate_hz is 333, it must be such that 40 ms are whole ticks");
}
