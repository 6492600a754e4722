//! Random sequences of commands, faults and recoveries, and what must hold in every tick whatever they are.
//!
//! Sixty walks, and more flights that try to leave their box; `cargo xtask chaos sensors` flies ten thousand and
//! more, from any seed.

use plumbline_agent::flight::Failsafe;
use plumbline_support::walk::edge::{PAIRS, edge};
use plumbline_support::walk::{PILOTS, Seen, walk};

/// Walks of an ordinary run.
const WALKS: u64 = 60;
/// Walks that broke once: heights lost as it lands, and a take-off on what the estimator made of that; a descent on
/// attitude alone with a hover thrust learned from a weak motor, without and with heights; a right estimator given up on
/// its way to the edge for a frozen height; all heights lost as it sank, and an estimate that sank on while it climbed;
/// lasers lost, bumped onto the floor, and the altitude of motion capture refused for two seconds (twice); a fast climb
/// without a height, which the descent on attitude alone hardly braked; an estimator that a frozen IMU held down while it climbed.
const BROKE: [u64; 9] =
    [1_000_399, 1_004_455, 2_003_980, 7_008_829, 11_005_329, 18_003_868, 18_006_185, 20_000_535, 23_000_189];
/// Flights that left their box once: after a bump the estimator refused a right place for seconds; thrown up by the
/// strings, levelled with too much thrust; crashed onto the stand and driven along the floor; dropped onto the floor so hard that the
/// accelerometers clipped, and held by an estimator that never heard of it; taken over a
/// little late for what it can brake sideways; held where a path had carried its setpoint, outside; held by an
/// estimator whose speed a reset of its place had stopped; bumped onto the floor, and right heights refused for two seconds; the same
/// against its stand, and right places.
const LEFT: [u64; 12] = [
    1_003_392, 2_000_096, 2_004_524, 2_002_628, 4_000_172, 6_007_936, 8_002_080, 8_008_334, 8_002_688, 9_004_076,
    12_009_312, 13_005_580,
];
/// Flights of each mode on each rig.
const FLIGHTS_EACH: usize = 5;

#[test]
fn whatever_happens_the_invariants_hold() {
    let (mut all, mut broken) = (Seen::default(), Vec::new());
    let seeds = (1..=WALKS).chain(BROKE).flat_map(|seed| PILOTS.map(|pilot| (seed, pilot)));
    let seeds: Vec<_> = seeds.collect();
    // By two threads: by one it goes on for seconds after every other test.
    let walked: Vec<_> = std::thread::scope(|scope| {
        let halves = seeds.chunks(seeds.len().div_ceil(2));
        let halves = halves
            .map(|half| scope.spawn(move || half.iter().map(|(seed, pilot)| walk(*seed, *pilot)).collect::<Vec<_>>()));
        let halves: Vec<_> = halves.collect();
        halves.into_iter().flat_map(|half| half.join().unwrap()).collect()
    });
    for walked in walked {
        match walked {
            Ok(seen) => {
                all.failsafes.extend(seen.failsafes);
                all.flown_s += seen.flown_s;
            }
            Err(what) => broken.push(what),
        }
    }
    let names: Vec<_> = all.failsafes.iter().filter_map(|f| Failsafe::try_from(*f).ok()).collect();
    println!("{WALKS} walks, {:.0} s in the air, {} broken, failsafes {names:?}", all.flown_s, broken.len());
    assert!(
        broken.is_empty(),
        "{} of {WALKS}:\n{}",
        broken.len(),
        broken.iter().take(3).map(String::as_str).collect::<String>()
    );
    assert!(all.flown_s > WALKS as f64, "the walks hardly fly: {:.0} s", all.flown_s);
    assert!(names.len() >= 12, "few failsafes were met: {names:?}");
}

/// GIVEN every mode on every rig WHEN random commands come, or the stick is held against its stop, whatever takes over
/// THEN the vehicle stays within half a metre of its limits: the 0.3 m of the box, and what an estimate is off.
#[test]
fn in_every_mode_and_on_every_rig_the_box_is_kept() {
    let (mut highest_m, mut farthest_m, mut flown_s, mut broken) = (f64::MIN, f64::MIN, 0.0, Vec::new());
    let each = (0..PAIRS * FLIGHTS_EACH).map(|n| (n, n as u64 + 1));
    let each = each.chain(LEFT.map(|seed| (seed as usize, seed)));
    for (n, seed, pilot) in each.flat_map(|(n, seed)| PILOTS.map(|pilot| (n, seed, pilot))) {
        match edge(n, seed, pilot) {
            Ok(((above_m, aside_m), seen)) => {
                (highest_m, farthest_m) = (highest_m.max(above_m), farthest_m.max(aside_m));
                flown_s += seen.flown_s;
            }
            Err(what) => broken.push(what),
        }
    }
    println!("{highest_m:.2} m above, {farthest_m:.2} m aside of the limits, {flown_s:.0} s in the air");
    let heads: Vec<_> = broken.iter().filter_map(|b| b.lines().next()).collect();
    assert!(broken.is_empty(), "{} of {}:\n{heads:#?}\n{}", broken.len(), PAIRS * FLIGHTS_EACH, broken[0]);
    assert!(highest_m > 0.0 && farthest_m > 0.0, "nothing came to the edge: {highest_m} m, {farthest_m} m");
    assert!(flown_s > (PAIRS * FLIGHTS_EACH) as f64, "they hardly fly: {flown_s:.0} s");
}
