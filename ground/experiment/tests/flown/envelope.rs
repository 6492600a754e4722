//! The attack envelope flown: GIVEN a world without noise WHEN attacks are worn THEN none goes further than its bound unseen.

use plumbline_agent::envelope::Deviation;
use plumbline_agent::envelope::sets::Asked;
use plumbline_rest::envelope::EnvelopeQuestion;
use plumbline_support::envelope::{Bounds, LINEAR, Worn, fly, fly_held};

/// So much of its bound a drawn attack may reach.
const CLIPPED: f64 = 1.05;

#[test]
fn unseen_attacks_stay_within_their_bounds_and_the_worst_come_near() {
    let clean = fly("ideal", 1, &Worn::default());
    assert!(clean.seen.is_none() && clean.altitude_m.iter().all(|z| (z - 1.0).abs() < 0.02), "{:?}", clean.excluded);
    let bounds = Bounds::new(clean.noise_mps2);
    for names in ["height 2", "imu 1", "height 1, imu 1"] {
        let set = bounds.sets.iter().find(|set| set.name() == names).unwrap();
        let flight = fly("ideal", 1, &bounds.worst(set, 1.0));
        let part = flight.unseen_m(&clean) / set.bound_m;
        println!("{names}: {part:.3} of {:.4} m, excluded {:?}", set.bound_m, flight.excluded);
        assert!(flight.seen.is_none() && part > 0.9 && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
    }
    for (set, seed) in bounds.sets.iter().cycle().step_by(5).zip(1..=6) {
        let (shape, attack) = bounds.drawn(set, seed);
        let part = fly("ideal", 1, &attack).unseen_m(&clean) / set.bound_m;
        println!("{}, {shape}: {part:.3}", set.name());
        // Samples beyond the reach count as if they were at it, which the linear loop does not know.
        assert!(part <= CLIPPED, "{}, {shape} of seed {seed}: {part}", set.name());
    }
}

/// GIVEN a position held under motion capture WHEN one IMU wears the worst of x THEN pitch, velocity and position come near their bounds,
/// and are within them while nobody sees it.
#[test]
fn along_x_the_worst_come_near_their_bounds_too() {
    let clean = fly_held("ideal", 1, &Worn::default(), 5.0);
    assert!(clean.seen.is_none(), "{:?}", clean.excluded);
    let question = EnvelopeQuestion {
        axis: Some("x".into()),
        more: Some("pose".into()),
        noise_mps2: Some(clean.noise_mps2),
        ..EnvelopeQuestion::default()
    };
    let lateral = Asked::new(&question, None).unwrap().lateral.unwrap();
    let imu = ["imu 1".parse().unwrap()];
    let flown = [Deviation::Tilt, Deviation::Speed, Deviation::Place].into_iter().enumerate().map(|(i, deviation)| {
        let bound = lateral.program(&imu, 5.0, deviation).unwrap().unwrap().solve().unwrap();
        let flight = fly_held("ideal", 1, &Worn::along_x(&imu, &bound.attack, 1.0), 5.0);
        let part = flight.unseen_along_x(&clean, 5.0)[i] / bound.upper;
        println!("{deviation:?}: {part:.3} of {:.5}, excluded {:?}", bound.upper, flight.excluded);
        (flight.seen, part)
    });
    let flown: Vec<_> = flown.collect();
    assert!(flown.iter().all(|(seen, part)| seen.is_none() && (0.5..1.05).contains(part)), "{flown:?}");
}
