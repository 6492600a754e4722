//! Rotors that lose thrust: GIVEN a hovering vehicle WHEN a propeller breaks, or its command is attacked, THEN the rotor is named and
//! made up for, or the flight ends as promised. `cargo xtask reproduce rotors` flies a hundred seeds of each.

use plumbline_agent::attack::Kind;
use plumbline_agent::flight::Failsafe;
use plumbline_support::rotors::{How, RIGS, fly};

/// Not those that thresholds were chosen on.
const SEEDS: std::ops::Range<u64> = 41_000..41_004;

#[test]
fn a_fifth_of_a_rotor_is_isolated_and_made_up_for() {
    for (rig, _) in RIGS {
        for how in [How::Broken, How::Attacked] {
            for seed in SEEDS {
                let flown = fly(rig, "datasheet", seed, Some((how, 0.2)));
                let (after_s, rotor) =
                    flown.isolated.unwrap_or_else(|| panic!("{rig}, {how:?}, seed {seed}: not found"));
                assert_eq!((rotor, flown.falsely), (flown.rotor, 0), "{rig}, {how:?}, seed {seed}: {flown:?}");
                assert!(after_s <= 0.3, "{rig}, {how:?}, seed {seed}: after {after_s} s");
                // A rotor that breaks is as little healthy as one that is attacked.
                assert_eq!(flown.delays_s.len(), 1, "{rig}, {how:?}, seed {seed}: {flown:?}");
                assert!(flown.moved_m <= 0.1, "{rig}, {how:?}, seed {seed}: {} m", flown.moved_m);
                assert!((flown.found - 0.8).abs() < 0.06, "{rig}, {how:?}, seed {seed}: found {}", flown.found);
                assert!(flown.lost.is_none(), "{rig}, {how:?}, seed {seed}: {:?}", flown.lost);
            }
        }
    }
}

#[test]
fn a_rotor_that_is_gone_cuts_the_motors() {
    for (rig, _) in RIGS {
        for seed in SEEDS {
            let flown = fly(rig, "datasheet", seed, Some((How::Broken, 1.0)));
            let (after_s, why) = flown.cut.unwrap_or_else(|| panic!("{rig}, seed {seed}: {flown:?}"));
            assert!(
                (0.0..0.5).contains(&after_s) && why == Failsafe::RotorCut,
                "{rig}, seed {seed}: {why:?} after {after_s} s"
            );
        }
    }
}

#[test]
fn nothing_is_isolated_where_nothing_is_lost() {
    for (rig, _) in RIGS {
        for seed in SEEDS {
            let flown = fly(rig, "datasheet", seed, None);
            assert!(flown.watched && flown.falsely == 0, "{rig}, seed {seed}: {flown:?}");
        }
    }
}

#[test]
fn a_rotor_told_something_else_stays_bounded_is_recorded_and_isolated_or_survived() {
    for (kind, magnitude) in [(Kind::Bias, -0.1), (Kind::Freeze, 0.0), (Kind::Delay, 0.02), (Kind::Dropout, 0.3)] {
        let flown = fly("free", "datasheet", SEEDS.start, Some((How::Told(kind), magnitude)));
        println!("{kind:?} {magnitude}: {flown:?}");
        assert!(flown.watched && flown.bounded && flown.altered > 0, "{kind:?}: {flown:?}");
        assert_eq!(flown.falsely, 0, "{kind:?}: {flown:?}");
        let survived = flown.lost.is_none() && flown.moved_m <= 0.1;
        assert!(flown.right() || survived, "{kind:?}: {flown:?}");
    }
}
