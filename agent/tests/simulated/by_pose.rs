//! What may be commanded of a vehicle whose autopilot flies by pose, and what it is given to fly by.

use plumbline_agent::attack::{Attack, Bounds, Channel, Kind, Schedule};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::flight::{AttackPolicy, FlightConfig};
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::{Actuation, Mode};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_support::flown::{Flown, scenario};

fn flown(toml: &str, actuation: Actuation) -> Flown {
    let scenario = Scenario::from_toml(toml).unwrap();
    let attacks = AttackPolicy { enabled: true, bounds: Bounds::default() };
    let config = FlightConfig { actuation, attacks, ..scenario.flight_config() };
    Flown::with_config(scenario, config)
}

fn refused(f: &mut Flown, command: Command, named: &str) {
    let ack = f.command(command);
    assert!(!ack.accepted && ack.reason.contains(named), "{}", ack.reason);
}

/// GIVEN a vehicle in hold by pose WHEN it is asked for what its autopilot controls THEN that is refused with its value.
#[test]
fn what_the_autopilot_controls_is_refused() {
    let mut f = flown(&scenario("hover"), Actuation::Pose);
    assert!(f.flight.guide().is_none(), "nothing is known before the first frame");
    f.until(3.5);
    let guide = f.flight.guide().unwrap();
    assert!(guide.setpoint.is_none(), "it stands");
    f.until(12.0);
    let guide = f.flight.guide().unwrap();
    assert!((guide.setpoint.unwrap().position_enu_m.z - 1.0).abs() < 1e-6, "{:?}", guide.setpoint);
    assert!((guide.estimate.altitude_m().unwrap() - 1.0).abs() < 0.1, "{}", f.log());
    refused(&mut f, Command::SetMode(Mode::Stabilise), "by pose the autopilot controls");
    let roll = SetpointChange { roll_rad: Some(0.1), ..SetpointChange::default() };
    refused(&mut f, Command::Setpoint(roll), "roll 0.1 rad: by pose");
    let step = SetpointChange { altitude_m: Some(0.8), ..SetpointChange::default() };
    assert!(f.command(Command::Setpoint(step)).accepted);
    assert!(f.command(Command::SetMode(Mode::AltitudeHold)).accepted);
}

/// GIVEN no horizontal position WHEN a vehicle by pose shall arm THEN its check says so, and by motors nobody asks.
#[test]
fn without_a_place_it_does_not_arm() {
    let toml = scenario("hover").replace("add = [\"mocap_pose\", \"camera_ranges\"]\n", "");
    for (actuation, passes) in [(Actuation::Pose, Some(false)), (Actuation::Motors, None)] {
        let mut f = flown(&toml, actuation);
        f.until(2.5);
        let checks = f.flight.checks(f.now());
        assert_eq!(checks.iter().find(|check| check.name == "pose").map(|check| check.passed), passes);
        assert!(f.flight.guide().is_none());
    }
}

/// GIVEN a schedule on a rotor WHEN no command of ours reaches the motors THEN it is refused, and else accepted.
#[test]
fn a_rotor_that_is_not_commanded_cannot_be_attacked() {
    let attack = Attack {
        id: 1,
        sensor: SensorId::new(SensorKind::Rotor, 2),
        channel: Channel::All,
        kind: Kind::Bias,
        start_s: 1.0,
        duration_s: 1.0,
        magnitude: -0.1,
        seed: 1,
    };
    let mut attacks = Schedule { id: 1, ..Schedule::default() };
    attacks.attacks.push(attack);
    for (actuation, accepted) in [(Actuation::Rates, true), (Actuation::Pose, false)] {
        let mut f = flown(&scenario("hover"), actuation);
        f.until(2.0);
        let ack = f.command(Command::Attack(attacks.clone()));
        assert_eq!(ack.accepted, accepted, "{actuation:?}: {}", ack.reason);
        assert!(accepted || ack.reason.contains("rotor 2"), "{}", ack.reason);
    }
}
