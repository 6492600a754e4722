//! The tick allocates nothing, and the same seed gives the same bits.
#![allow(clippy::unwrap_used)]

use plumbline_agent::sim::Scenario;
use plumbline_agent::telemetry::{Around, Outlet, Telemetry};
use plumbline_agent::types::EstimatorKind;
use plumbline_agent::vehicle::Vehicle;
use plumbline_support::counting::{self, Counting};
use plumbline_support::flown::{Flown, identification, scenario};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_tick_allocates_nothing_from_the_ground_to_landing_under_attack() {
    let toml = scenario("altitude_step")
        + &scenario("height_attack").split_once("[[attack]]").map_or(String::new(), |a| format!("[[attack]]{}", a.1));
    let scenario = Scenario::from_toml(&toml).unwrap();
    let mut config = scenario.flight_config();
    config.estimators.push(EstimatorKind::Secure);
    let mut f = Flown::with_config(scenario, config);
    let schedule = f.scenario.attacks.clone();
    assert_eq!(schedule.attacks.len(), 1);
    let mut radio = telemetry_of(&f, 32 << 20);
    let (mut ticks, mut total, mut told) = (0, 0, 0);
    let mut before = None;
    let mut uploaded = false;
    while f.vehicle.time().as_seconds() < 47.0 {
        let frame = f.vehicle.sense().unwrap();
        f.flight.heartbeat(frame.time);
        let script = f.scenario.script.clone();
        script.commands(before, frame.time, |c| assert!(f.flight.apply(c, frame.time).accepted));
        if !uploaded && frame.time.as_seconds() > 1.0 {
            uploaded = true;
            let ack = f.flight.apply(&plumbline_agent::command::Command::Attack(schedule.clone()), frame.time);
            assert!(ack.accepted, "{}", ack.reason);
        }
        before = Some(frame.time);
        let counted = counting::requests();
        let command = f.flight.step(&frame).command;
        f.flight.applied(command);
        total += counting::requests() - counted;
        let truth = f.vehicle.truth();
        let counted = counting::requests();
        radio.0.tick(&mut f.flight, truth.as_ref(), &Around::default());
        told += counting::requests() - counted;
        // The thread of the radio does this.
        let waiting = radio.1.slots();
        radio.1.read_chunk(waiting).unwrap().commit_all();
        ticks += 1;
        f.vehicle.actuate(&command).unwrap();
    }
    assert!(ticks > 9000);
    assert_eq!(total, 0, "{total} allocations in {ticks} ticks");
    assert_eq!(told, 0, "{told} allocations of telemetry in {ticks} ticks");
    assert_eq!(radio.0.refused(), (0, 0));
    assert!(radio.0.sequence() > 5 * ticks, "{} messages", radio.0.sequence());
}

/// Telemetry into a ring as wide as `bytes`, and the far end of it.
fn telemetry_of(f: &Flown, bytes: usize) -> (Telemetry, rtrb::Consumer<u8>) {
    let (ring, far_end) = rtrb::RingBuffer::new(bytes);
    (Telemetry::new(identification(&f.scenario), &f.flight, Some(Outlet::new(ring)), None), far_end)
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let fly = |seed: u64| {
        let toml = scenario("altitude_step").replace("seed = 1", &format!("seed = {seed}"));
        let mut f = Flown::new(&toml);
        f.until(20.0);
        let bits: Vec<u64> = f
            .rows
            .iter()
            .flat_map(|r| {
                let truth = r.truth.position_enu_m.iter().chain(r.truth.body_rates_radps.iter()).copied();
                let estimated = r.estimate.kinematics().position_enu_m;
                let estimate = estimated.iter().chain(r.estimate.accel_bias_mps2.iter().flatten()).copied();
                truth.chain(estimate).chain(r.report.command.throttle).map(f64::to_bits).collect::<Vec<_>>()
            })
            .collect();
        (bits, f.log())
    };
    let (a, log_a) = fly(7);
    let (b, log_b) = fly(7);
    assert!(a == b && log_a == log_b, "same seed, different flight");
    assert!(a != fly(8).0, "another seed, the same flight");
}
