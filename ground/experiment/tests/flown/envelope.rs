//! The attack envelope flown: GIVEN a world without noise WHEN attacks are worn THEN none goes further than its bound unseen.

use plumbline_agent::envelope::prepare::prepared;
use plumbline_agent::envelope::sets::Asked;
use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use plumbline_support::envelope::{Bounds, LINEAR, Worn, fly, fly_heaving, fly_held};

#[test]
fn unseen_attacks_stay_within_their_bounds_and_the_worst_come_near() {
    let clean = fly("ideal", 1, &Worn::default());
    assert!(clean.seen.is_none() && clean.altitude_m.iter().all(|z| (z - 1.0).abs() < 0.02), "{:?}", clean.excluded);
    let bounds = Bounds::new(clean.shaken);
    let worst = || {
        for names in ["height 2", "imu 1", "height 1, imu 1"] {
            let set = bounds.sets.iter().find(|set| set.name() == names).unwrap();
            let flight = fly("ideal", 1, &bounds.worst(set, 1.0));
            let part = flight.unseen_m(&clean) / set.bound_m;
            println!("{names}: {part:.3} of {:.4} m, excluded {:?}", set.bound_m, flight.excluded);
            assert!(flight.seen.is_none() && part > 0.9 && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
        }
    };
    let drawn = || {
        for (set, seed) in bounds.sets.iter().cycle().step_by(5).zip(1..=6) {
            let (shape, attack) = bounds.drawn(set, seed);
            let part = fly("ideal", 1, &attack).unseen_m(&clean) / set.bound_m;
            println!("{}, {shape}: {part:.3}", set.name());
            assert!(part <= LINEAR, "{}, {shape} of seed {seed}: {part}", set.name());
        }
    };
    // Beside each other: one after the other they go on for seconds after every other test.
    std::thread::scope(|scope| {
        scope.spawn(worst);
        drawn();
    });
}

/// GIVEN a position held under motion capture WHEN one IMU wears the worst of x or y, as prepared for a schedule, whole or a little less,
/// THEN tilt, velocity and position come near their bounds, and are within them while nobody sees it.
#[test]
fn along_x_and_y_the_worst_come_near_their_bounds_too() {
    let clean = fly_held("ideal", 1, &Worn::default(), 5.0);
    assert!(clean.seen.is_none(), "{:?}", clean.excluded);
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        let question = EnvelopeQuestion {
            axis: Some(name.into()),
            more: Some("pose".into()),
            noise_mps2: Some(clean.shaken.noise_mps2),
            sensors: Some(vec!["imu 1".into()]),
            horizon_s: Some(5.0),
            ..EnvelopeQuestion::default()
        };
        let bounds = Asked::new(&question, None).unwrap().answer(|_| true).unwrap().sets.remove(0);
        let bounds = [bounds.tilt_rad, bounds.velocity_mps, bounds.position_m].map(Option::unwrap);
        let flown = ["tilt", "velocity", "position"].into_iter().enumerate().map(|(i, deviation)| {
            let attack = AttackQuestion {
                of: question.clone(),
                generator: Some("optimal".into()),
                deviation: Some(deviation.into()),
                ..AttackQuestion::default()
            };
            let worn = Worn::prepared(&prepared(&attack, None).unwrap(), 0.0);
            let parts = [1.0, 0.95, 0.9].map(|scaled| {
                let flight = fly_held("ideal", 1, &worn.clone().scaled(scaled), 5.0);
                let part = flight.unseen_aside(&clean, axis, 5.0)[i] / bounds[i];
                println!(
                    "{name}, {deviation}, times {scaled}: {part:.3} of {:.5}, excluded {:?}",
                    bounds[i], flight.excluded
                );
                assert!(flight.seen.is_none() && part < 1.05, "{name}, {deviation}: {part}");
                part
            });
            parts.into_iter().fold(0.0, f64::max)
        });
        let flown: Vec<_> = flown.collect();
        assert!(flown.iter().all(|part| *part > 0.75), "{name}: {flown:?}");
    }
}

/// GIVEN a heave in the place of a hover WHEN the worst of single sensors and of a height with an IMU along it are worn THEN they come near their bounds along it, not beyond.
#[test]
fn along_a_heave_the_worst_come_near_their_bounds_too() {
    let heave = (0.3, 4.0);
    let clean = fly_heaving("ideal", 3, &Worn::default(), heave);
    let (low, high) = clean.altitude_m.iter().fold((9.0_f64, 0.0_f64), |(low, high), z| (low.min(*z), high.max(*z)));
    assert!(clean.seen.is_none() && (low - 0.7).abs() < 0.05 && (high - 1.3).abs() < 0.05, "{low} {high}");
    for names in ["height 2", "imu 2", "height 2, imu 2"] {
        let bounds = Bounds::along(clean.shaken, Some(heave), Some(names));
        let set = &bounds.sets[0];
        let flight = fly_heaving("ideal", 3, &bounds.worst(set, 1.0), heave);
        let part = flight.unseen_m(&clean) / set.bound_m;
        println!("{names}: {part:.3} of {:.4} m, excluded {:?}", set.bound_m, flight.excluded);
        assert!(flight.seen.is_none() && part > 0.9 && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
    }
}

/// GIVEN IMUs that are shaken WHEN heights wear what moves the vehicle 1.1 times as far and more as the bound of IMUs that are not THEN it stays
/// within that of what these rectify.
#[test]
fn where_imus_are_shaken_heights_move_it_further_and_their_bounds_say_so() {
    // Of 2000 drawn; of shapes that no bound has a say in.
    let two = "height 1, height 3";
    for (base, index, name) in [(122_000, 232, two), (122_000, 820, two), (184_000, 393, "height 2")] {
        let seed = base + index % 25;
        let clean = fly("datasheet", seed, &Worn::default());
        let at_rest = Shaken { rectified_mps2: 0.0, ..clean.shaken };
        let [bounds, at_rest] = [clean.shaken, at_rest].map(|shaken| Bounds::along(shaken, None, Some(name)));
        let [set, of_rest] = [&bounds.sets[0], &at_rest.sets[0]];
        let (shape, attack) = bounds.drawn(set, base + index);
        let moved_m = fly("datasheet", seed, &attack).unseen_m(&clean);
        println!(
            "{name}, {shape}: {moved_m:.4} of {:.4} m, {:.4} at rest, {:?}",
            set.bound_m, of_rest.bound_m, clean.shaken
        );
        assert!(moved_m <= LINEAR * set.bound_m, "{name}, {shape}: {moved_m} of {} m", set.bound_m);
        assert!(moved_m > 1.1 * of_rest.bound_m, "{name}, {shape}: {moved_m} m shows nothing");
    }
}

/// What `generator` makes of every sensor and rotor but those `healthy`, for 10 s.
fn of_all(generator: &str, accel_mps2: f64, healthy: &[&str]) -> PreparedAttack {
    let all = ["height 1", "height 2", "height 3", "imu 1", "imu 2", "imu 3", "imu 4", "rotors"];
    let sensors = all.iter().filter(|name| !healthy.contains(name)).map(|name| (*name).to_owned()).collect();
    let of = EnvelopeQuestion { sensors: Some(sensors), ..EnvelopeQuestion::default() };
    let generator = Some(generator.to_owned());
    prepared(&AttackQuestion { of, generator, accel_mps2: Some(accel_mps2), ..AttackQuestion::default() }, None)
        .unwrap()
}

/// GIVEN a world without noise WHEN every height, IMU and rotor is attacked covertly THEN the vehicle goes where it is told, and nobody hears it.
#[test]
fn a_covert_motion_by_command_is_flown_as_asked_and_not_heard() {
    let clean = fly("ideal", 2, &Worn::default());
    let attack = of_all("covert", 0.02, &[]);
    let flight = fly("ideal", 2, &Worn::prepared(&attack, 0.0));
    // Behind its end everything is seen at once.
    let last = 1990;
    let moved_m = flight.altitude_m[last] - clean.altitude_m[last];
    let asked_m = attack.altitude_m.unwrap();
    println!("asked {asked_m:.3} m, moved {moved_m:.3} m, seen {:?}, excluded {:?}", flight.seen, flight.excluded);
    assert!((moved_m / asked_m - 1.0).abs() < 0.02, "{moved_m} of {asked_m} m");
    assert!(flight.seen.is_none_or(|tick| tick > last), "{:?} {:?}", flight.seen, flight.excluded);
}

/// GIVEN one healthy height WHEN a thrust grows along the zero of its samples THEN nobody hears it.
#[test]
fn a_thrust_along_the_zero_of_a_height_is_not_in_its_samples() {
    let clean = fly("ideal", 2, &Worn::default());
    let attack = of_all("zero_dynamics", 0.5, &["height 3"]);
    let flight = fly("ideal", 2, &Worn::prepared(&attack, 0.065));
    let apart = |tick: usize| (flight.altitude_m[tick] - clean.altitude_m[tick]).abs();
    let furthest_m = (0..1990).map(apart).fold(0.0, f64::max);
    println!("{} asked {:?}, moved {furthest_m:.5}, seen {:?}", attack.note, attack.altitude_m, flight.seen);
    assert!(flight.seen.is_none_or(|tick| tick > 1990), "{:?} {:?}", flight.seen, flight.excluded);
}
