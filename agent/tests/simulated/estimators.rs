//! Every estimator whose sensors suffice holds the altitude when it is put in the loop in flight, without a bump.

use plumbline_agent::command::Command;
use plumbline_agent::estimate::Health;
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::EstimatorKind;
use plumbline_support::flown::{Flown, scenario};

/// Each flies for this long, s.
const TURN_S: f64 = 3.0;
/// The true altitude stays this close to where it is held, m: the plain witness `primary` is the worst.
const HELD_M: f64 = 0.06;
/// In the tick of a switch thrust changes by no more than this fraction of the weight.
const BUMP: f64 = 0.05;

/// GIVEN `toml` flying at `altitude_m` from `start_s` on WHEN each of `kinds` in turn is put in the loop THEN the
/// altitude is held and nothing jumps.
fn check(toml: &str, altitude_m: f64, start_s: f64, kinds: &[EstimatorKind]) {
    let mut scenario = Scenario::from_toml(toml).unwrap();
    scenario.duration_s = start_s + 60.0;
    let mut config = scenario.flight_config();
    config.estimators = kinds.to_vec();
    config.in_loop = kinds[0];
    let weight_n = config.airframe.weight_n();
    let mut flown = Flown::with_config(scenario, config);
    flown.until(start_s);
    flown.scenario.script = Default::default();
    for (turn, kind) in kinds.iter().enumerate() {
        let before = flown.last().report.wrench.thrust_n;
        let ack = flown.command(Command::SelectEstimator(*kind));
        assert!(ack.accepted, "{kind:?}: {}", ack.reason);
        let begun = flown.last().t_s;
        flown.tick();
        let bump = (flown.last().report.wrench.thrust_n - before).abs() / weight_n;
        flown.until(start_s + TURN_S * (turn + 1) as f64);
        let off = flown.since(begun).map(|r| (r.truth.position_enu_m.z - altitude_m).abs()).fold(0.0, f64::max);
        println!("{kind:?}: {:.1} cm off at most, bump {:.1} % of the weight", off * 100.0, bump * 100.0);
        assert!(off < HELD_M, "{kind:?} is {off:.3} m off\n{}", flown.log());
        assert!(bump < BUMP, "{kind:?} jumps by {bump:.3} of the weight");
        assert_eq!(flown.last().estimate.health, Health::Healthy, "{kind:?}\n{}", flown.log());
        assert!(flown.last().report.armed);
    }
    assert!(flown.acks.iter().all(|(_, ack)| ack.accepted), "{}", flown.log());
}

#[test]
fn on_the_string_rig_by_three_laser_heights() {
    use EstimatorKind as K;
    check(&scenario("altitude_step"), 0.5, 14.0, &[K::EkfBias, K::EkfHybrid, K::Ukf, K::ConstantAcceleration]);
}

#[test]
fn under_four_cameras_alone() {
    // [Umasankar]: one IMU and the ranges, nothing else tells the height.
    use EstimatorKind as K;
    let toml = scenario("hover")
        .replace("preset = \"string_rig\"", "preset = \"umasankar\"")
        .replace("add = [\"mocap_pose\", \"camera_ranges\"]", "");
    check(&toml, 1.0, 14.0, &[K::EkfBias, K::EkfHybrid, K::Ukf]);
}

#[test]
fn an_estimator_that_does_not_run_is_refused_in_flight() {
    let mut flown = Flown::new(&scenario("altitude_step"));
    flown.until(6.0);
    let ack = flown.command(Command::SelectEstimator(EstimatorKind::Ukf));
    assert!(!ack.accepted && ack.reason.contains("UKF"), "{}", ack.reason);
}
