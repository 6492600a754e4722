//! Gains pushed in flight: bad ones refused, good ones applied without a bump.

use plumbline_agent::command::{Ack, Command};
use plumbline_agent::control::gains::{Examiner, refusal};
use plumbline_agent::control::lqr_integral::Weights;
use plumbline_agent::control::tuning::Design;
use plumbline_proto::ids::GainsRevision;
use plumbline_support::flown::{Flown, scenario};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Thrust may jump by this much of the weight when gains change in steady flight.
const BUMP: f64 = 0.08;

/// What the runner does with a push, in one thread: certify, then use between ticks.
fn push(f: &mut Flown, examiner: &Examiner, revision: u32, weights: Weights) -> Ack {
    let revision = GainsRevision(revision);
    match examiner.certify(&Design::from_weights(weights), revision) {
        Ok(gains) => f.command(Command::UseGains(gains)),
        Err(error) => Ack { accepted: false, reason: refusal(revision, &error) },
    }
}

#[test]
fn random_gains_are_refused_or_flown() {
    let mut f = Flown::new(&scenario("altitude_step"));
    f.scenario.script.steps.retain(|s| s.at_s < 6.0);
    f.until(12.0);
    let start = f.flight.gains_in_use().clone();
    let config = f.flight.config();
    let examiner = Examiner::new(&config.airframe, 1.0 / config.tick_rate_hz, config.margins).unwrap();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);

    // Malformed: one entry is not a usable number.
    for n in 0..300 {
        let mut weights = start.design.weights;
        let bad = [f64::NAN, f64::INFINITY, -1.0, -1e-300, 1e13][n % 5];
        match rng.random_range(0..20) {
            i @ 0..16 => weights.state[i] = bad,
            i => weights.input[i - 16] = bad,
        }
        let ack = push(&mut f, &examiner, 1000, weights);
        assert!(!ack.accepted && ack.reason.contains("weight"), "{weights:?}: {}", ack.reason);
    }
    // Too eager for the motors' lag.
    for _ in 0..100 {
        let mut weights = start.design.weights;
        let eager = 10.0_f64.powf(rng.random_range(-12.0..-6.0));
        weights.input = weights.input.map(|w| (w * eager).max(1e-9));
        weights.state = weights.state.map(|w| (w / eager).min(1e12));
        let ack = push(&mut f, &examiner, 2000, weights);
        assert!(!ack.accepted, "{weights:?}: {}", ack.reason);
    }
    assert_eq!(f.flight.gains_in_use().sha256, start.sha256, "a refused push changed something");
    assert_eq!(f.flight.gains_in_use().revision, start.revision);

    // Good ones: up to three times more or less of every weight, applied in flight.
    let mut applied = 0;
    for n in 0..60 {
        let mut weights = start.design.weights;
        weights.state = weights.state.map(|w| w * 3.0_f64.powf(rng.random_range(-1.0..1.0)));
        weights.input = weights.input.map(|w| w * 3.0_f64.powf(rng.random_range(-1.0..1.0)));
        let before = f.last().report.given.thrust_n;
        let ack = push(&mut f, &examiner, n + 1, weights);
        assert!(ack.accepted, "{}", ack.reason);
        applied += 1;
        f.tick();
        let bump = (f.last().report.given.thrust_n - before).abs() / (1.545 * 9.81);
        assert!(bump < BUMP, "thrust jumps by {:.0} % of the weight: {}", 100.0 * bump, ack.reason);
        let end = f.last().t_s + 0.25;
        f.until(end);
        let z = f.last().truth.position_enu_m.z;
        assert!((z - 0.5).abs() < 0.25 && f.last().report.armed, "at {z:.2} m after {}", ack.reason);
        assert_eq!(f.flight.gains_in_use().revision, GainsRevision(n + 1));
        f.events.clear();
    }
    assert_eq!(applied, 60);
    assert_ne!(f.flight.gains_in_use().sha256, start.sha256);
}

#[test]
fn switching_the_estimator_in_flight_makes_no_bump() {
    use plumbline_agent::types::EstimatorKind::{Complementary, EkfBias};
    let mut f = Flown::new(&scenario("altitude_step"));
    f.scenario.script.steps.retain(|s| s.at_s < 6.0);
    f.until(12.0);
    for kind in [Complementary, EkfBias] {
        let before = f.last().report.given;
        let ack = f.command(Command::SelectEstimator(kind));
        assert!(ack.accepted, "{}", ack.reason);
        f.tick();
        let bump = (f.last().report.given.thrust_n - before.thrust_n).abs() / (1.545 * 9.81);
        assert!(bump < 0.05, "{kind:?}: thrust jumps by {:.1} %", 100.0 * bump);
        assert_eq!(f.flight.estimator_in_loop(), kind);
        let end = f.last().t_s + if kind == Complementary { 0.5 } else { 6.0 };
        f.until(end);
    }
    let z = f.last().truth.position_enu_m.z;
    assert!((z - 0.5).abs() < 0.06, "back at {z:.3} m:\n{}", f.log());
}
