//! The attack envelope flown: GIVEN a world without noise WHEN attacks are worn THEN none goes further than its bound unseen.

use plumbline_agent::attack::{Channel, Kind};
use plumbline_agent::envelope::prepare::prepared;
use plumbline_agent::estimate::lanes::linear::Shaken;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::envelope::{AttackQuestion, EnvelopeQuestion, PreparedAttack};
use plumbline_support::envelope::aside::{ASIDE_S, Aside, CIRCLE, SWUNG};
use plumbline_support::envelope::{
    Bounds, Flown, HORIZON_S, LINEAR, Set, Worn, asked_with, fly, fly_circling, fly_heaving, fly_held,
};

#[test]
fn unseen_attacks_stay_within_their_bounds_and_the_worst_come_near() {
    let still = fly("ideal", 1, &Worn::default());
    assert!(still.seen.is_none() && still.altitude_m.iter().all(|z| (z - 1.0).abs() < 0.02), "{:?}", still.excluded);
    let bounds = Bounds::new(still.shaken);
    let moved_m = |set: &Set, attack: &Worn| {
        let flight = fly("ideal", 1, attack);
        (flight.unseen_m(&fly("ideal", 1, &set.none())), flight)
    };
    let worst = || {
        for (names, least) in [("height 2", 0.9), ("imu 1", 0.9), ("height 1, imu 1", 0.87)] {
            let set = bounds.sets.iter().find(|set| set.name() == names).unwrap();
            let (moved_m, flight) = moved_m(set, &set.worst(1.0));
            let part = moved_m / set.bound_m;
            println!("{names}: {part:.3} of {:.4} m, excluded {:?}", set.bound_m, flight.excluded);
            assert!(flight.seen.is_none() && part > least && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
        }
    };
    let drawn = || {
        for (set, seed) in bounds.sets.iter().cycle().step_by(5).zip(1..=6) {
            let (shape, attack) = set.drawn(seed);
            let part = moved_m(set, &attack).0 / set.bound_m;
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

/// GIVEN a position held under motion capture, or a circle flown, WHEN one IMU wears the worst of x or y THEN tilt, velocity and position come
/// near their bounds, and are within them while nobody sees it.
#[test]
fn along_x_and_y_the_worst_come_near_their_bounds_about_hover_and_along_a_circle() {
    for axis in [0, 1] {
        let held = |worn: &Worn| fly_held("ideal", 1, worn, ASIDE_S);
        let circling = |worn: &Worn| fly_circling("ideal", 1, worn, axis, CIRCLE);
        near(axis, None, held);
        near(axis, Some(SWUNG), circling);
    }
    // As a generator prepares it for a schedule.
    let of = EnvelopeQuestion {
        axis: Some("x".into()),
        more: Some("pose".into()),
        noise_mps2: Some(fly_held("ideal", 1, &Worn::default(), ASIDE_S).shaken.noise_mps2),
        sensors: Some(vec!["imu 1".into()]),
        ..EnvelopeQuestion::default()
    };
    let bounds = Aside::new(0, None, of.noise_mps2.unwrap());
    let (generator, deviation) = (Some("optimal".into()), Some("position".into()));
    let attack = prepared(&AttackQuestion { of, generator, deviation, ..AttackQuestion::default() }, None).unwrap();
    let [asked, worst] = [Worn::prepared(&attack, 0.0), bounds.worst(&bounds.sets[0], 2, 1.0)]
        .map(|worn| fly_held("ideal", 1, &worn, ASIDE_S).aside.last().unwrap()[0][2]);
    assert!((asked - worst).abs() < 1e-6, "{asked} {worst}");
}

/// Flies the worst of one IMU along `axis`: they reach what a lane leaves that weighs less before it is excluded, and a bound leaves that counts
/// whole slots for what nobody has heard of.
fn near(axis: usize, swing: Option<(f64, f64)>, fly: impl Fn(&Worn) -> Flown) {
    let clean = fly(&Worn::default());
    let places = || clean.aside.iter().map(|aside| aside[axis][2]);
    let swung = 0.5 * (places().fold(-9.0, f64::max) - places().fold(9.0, f64::min));
    let meant = swing.map_or(0.0, |(amplitude_m, _)| amplitude_m);
    assert!(clean.seen.is_none() && (swung - meant).abs() < 0.02, "{axis}: {swung}, {:?}", clean.excluded);
    let bounds = Aside::new(axis, swing, clean.shaken.noise_mps2);
    let set = &bounds.sets[0];
    for (which, least) in [(0, 0.35), (1, 0.45), (2, 0.7)] {
        let flown = bounds.all_worst(set, which).map(|(part, worn)| {
            let flight = fly(&worn);
            let reached = flight.unseen_aside(&clean, axis, ASIDE_S)[which] / set.bounds[which];
            println!("{axis}, {swing:?}, {which}, limits to {part:?}: {reached:.3} of {:.5}", set.bounds[which]);
            assert!(flight.seen.is_none() && reached < LINEAR, "{axis}, {which}: {reached}, {:?}", flight.excluded);
            reached
        });
        let most = flown.fold(0.0, f64::max);
        assert!(most > least, "{axis}, {swing:?}, {which}: {most}");
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
        let flight = fly_heaving("ideal", 3, &set.worst(1.0), heave);
        let part = flight.unseen_m(&fly_heaving("ideal", 3, &set.none(), heave)) / set.bound_m;
        println!("{names}: {part:.3} of {:.4} m, excluded {:?}", set.bound_m, flight.excluded);
        assert!(flight.seen.is_none() && part > 0.9 && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
    }
}

/// GIVEN an IMU that jumps by the most that may be added WHEN nobody has judged that yet THEN it moves the vehicle less than its bounds until it is excluded, within a second.
#[test]
fn an_imu_that_jumps_is_excluded_before_it_has_moved_the_vehicle_far() {
    let imu = SensorId::new(SensorKind::Imu, 1);
    let one = |channel, size| Worn::these([(imu, channel, Kind::Bias, size)], HORIZON_S, 1);
    let free = fly("ideal", 1, &Worn::default());
    let bounds = Bounds::along(free.shaken, None, Some("imu 1"));
    let flight = fly("ideal", 1, &one(Channel::AccelAxis(2), 20.0));
    let part = flight.unseen_m(&free) / bounds.sets[0].bound_m;
    assert!(flight.seen.is_some_and(|tick| tick < 200) && part < 0.5, "{part}, {:?}", flight.seen);
    let held = fly_held("ideal", 1, &Worn::default(), HORIZON_S);
    let sensors = Some(vec!["imu 1".to_owned()]);
    let posed = Bounds::asked(&EnvelopeQuestion { sensors, more: Some("pose".into()), ..asked_with(held.shaken) });
    let flight = fly_held("ideal", 1, &one(Channel::AccelAxis(2), 20.0), HORIZON_S);
    let part = flight.unseen_m(&held) / posed.sets[0].bound_m;
    assert!(flight.seen.is_some_and(|tick| tick < 200) && part <= LINEAR, "{part}, {:?}", flight.seen);
    let held = fly_held("ideal", 1, &Worn::default(), ASIDE_S);
    let bounds = Aside::new(0, None, held.shaken.noise_mps2);
    for (channel, size) in [(Channel::AccelAxis(0), 20.0), (Channel::GyroAxis(1), 5.0), (Channel::GyroAxis(1), 0.3)] {
        let flight = fly_held("ideal", 1, &one(channel, size), ASIDE_S);
        let moved = flight.unseen_aside(&held, 0, ASIDE_S);
        let parts = [0, 1, 2].map(|i| moved[i] / bounds.sets[0].bounds[i]);
        println!("{channel:?} by {size}: {parts:?} of the bounds, seen {:?}", flight.seen);
        assert!(flight.seen.is_some_and(|tick| tick < 200) && parts.iter().all(|part| *part <= LINEAR), "{parts:?}");
    }
}

/// GIVEN motion capture beside the heights WHEN the worst along z are worn THEN they come near their bounds, a tenth of those without it, not beyond.
#[test]
fn under_motion_capture_heights_move_it_by_next_to_nothing() {
    let clean = fly_held("ideal", 1, &Worn::default(), HORIZON_S);
    assert!(clean.seen.is_none(), "{:?}", clean.excluded);
    for (names, least) in [("height 2", 0.9), ("imu 1", 0.9), ("height 1, imu 1", 0.9)] {
        let sensors = Some(names.split(", ").map(str::to_owned).collect());
        let bounds =
            Bounds::asked(&EnvelopeQuestion { sensors, more: Some("pose".into()), ..asked_with(clean.shaken) });
        let set = &bounds.sets[0];
        let flight = fly_held("ideal", 1, &set.worst(1.0), HORIZON_S);
        // What the linear loop is off by does not shrink with the attack.
        let part = (flight.unseen_m(&fly_held("ideal", 1, &set.none(), HORIZON_S)) - 2e-5) / set.bound_m;
        println!("{names}: {part:.3} of {:.5} m, excluded {:?}", set.bound_m, flight.excluded);
        assert!(flight.seen.is_none() && part > least && part <= LINEAR, "{names}: {part} {:?}", flight.excluded);
    }
}

/// GIVEN IMUs that are shaken WHEN heights wear what moves the vehicle 1.1 times as far and more as the bound of IMUs that are not THEN it stays
/// within that of what these rectify.
#[test]
fn where_imus_are_shaken_heights_move_it_further_and_their_bounds_say_so() {
    // Of 2000 drawn; of shapes that no bound has a say in.
    let name = "height 1, height 3";
    for (base, index) in [(122_000, 232), (122_000, 820)] {
        let seed = base + index % 25;
        let clean = fly("datasheet", seed, &Worn::default());
        let at_rest = Shaken { rectified_mps2: 0.0, ..clean.shaken };
        let of = |shaken| {
            let all = Bounds::sampled(shaken).sets;
            all.into_iter().find(|set| set.name() == name).unwrap()
        };
        let [set, of_rest] = [clean.shaken, at_rest].map(of);
        let (shape, attack) = set.drawn(base + index);
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
