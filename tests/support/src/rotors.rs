//! Rotors that lose thrust, flown: hover, the loss of a rotor that nobody but the vehicle feels, and what became of it.

use plumbline_agent::attack::{Attack, Channel, Kind};
use plumbline_agent::flight::Failsafe;
use plumbline_agent::frames::tilt_rad;
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::scenario::BrokenRotor;
use plumbline_agent::types::{EstimatorKind, Mode, ROTORS};
use plumbline_experiment::draw::Dice;
use plumbline_experiment::flight::{Setup, fly_watched};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

/// Free, and on strings.
pub const RIGS: [(&str, &str); 2] = [
    ("free", "[rig.free]\nheight_m = 0.0\n"),
    ("strings", "[rig.hanging_strings]\nmode = \"flight\"\nheight_m = 0.3\n"),
];
/// Altitude while a rotor loses thrust, m.
const HOVER_M: f64 = 1.0;
/// Earliest and latest loss, s.
const ONSET_S: (f64, f64) = (14.0, 18.0);
/// Flown on after it, s.
pub const AFTER_S: f64 = 5.0;
/// The same after one that ends the flight, s: until it is down.
const DOWN_S: f64 = 15.0;
/// From here on a loss ends the flight.
const ENDS: f64 = 0.4;
/// Length of a flight without a loss, s: steps of altitude throughout.
const CLEAN_S: f64 = 60.0;

/// How a rotor loses thrust.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// Its propeller breaks.
    Broken,
    /// Its command is attacked.
    Attacked,
    /// Its command is attacked in another way than by scaling it; the number beside it is the attack's magnitude.
    Told(Kind),
}

/// What became of a flight.
#[derive(Debug, Clone, Default)]
pub struct Flown {
    /// When the loss began, s; infinite without one.
    pub onset_s: f64,
    /// The rotor that lost thrust, from 0.
    pub rotor: usize,
    /// First isolation from the onset on: s after it, and which rotor.
    pub isolated: Option<(f64, usize)>,
    /// Rotors isolated before the onset, or other ones after it.
    pub falsely: usize,
    /// Furthest from the altitude at the onset, m.
    pub moved_m: f64,
    /// The same from its setpoint, m.
    pub off_m: f64,
    /// What the rotor was found to give, at the end.
    pub found: f64,
    /// Sigma of the innovations at the onset (or the end): rad/s² and m/s².
    pub sigma: [f64; 4],
    /// s after the onset when the motors were cut, and why.
    pub cut: Option<(f64, Failsafe)>,
    /// The failsafe at the end.
    pub failsafe: Failsafe,
    /// Largest tilt from the onset until the motors are cut, rad, and fastest descent.
    pub tilt_rad: f64,
    /// While armed, m/s.
    pub sinks_mps: f64,
    /// Why it was lost.
    pub lost: Option<String>,
    /// From the onset to the isolation, as the judge of an experiment measures it, s.
    pub delays_s: Vec<f64>,
    /// Was it watched, before the onset?
    pub watched: bool,
    /// Commands that its attack is on record to have altered or withheld.
    pub altered: u64,
    /// Did every command that reached a motor lie within 0 to 1, and as the mixer told it for every rotor but the attacked one?
    pub bounded: bool,
}

impl Flown {
    /// The right rotor, and no other one.
    pub fn right(&self) -> bool {
        self.isolated.is_some_and(|(_, rotor)| rotor == self.rotor)
    }
}

fn scenario(rig: &str, world: &str, seed: u64, steps: bool) -> Scenario {
    let end_s = if steps { CLEAN_S } else { ONSET_S.1 + DOWN_S + 1.0 };
    let mut text = format!("name = \"rotors\"\nseed = {seed}\nduration_s = {end_s}\nworld = \"{world}\"\n");
    text += "[[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n";
    let altitudes: &[(f64, f64)] = if steps {
        &[(5.0, 0.9), (15.0, 1.2), (24.0, 0.8), (33.0, 1.3), (42.0, 0.7), (51.0, 1.0)]
    } else {
        &[(5.0, HOVER_M)]
    };
    for (at_s, altitude_m) in altitudes {
        text += &format!("[[script]]\nat_s = {at_s}\ndo = \"setpoint\"\naltitude_m = {altitude_m}\n");
    }
    text += RIGS.iter().find(|(name, _)| *name == rig).unwrap_or_else(|| panic!("no rig {rig}")).1;
    text += "[suite]\npreset = \"string_rig\"\n";
    Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// A flight of this seed on `rig` in `world`, the lanes in the loop; a rotor drawn from the seed loses the part `loss` of its thrust.
pub fn fly(rig: &str, world: &str, seed: u64, loss: Option<(How, f64)>) -> Flown {
    let mut scenario = scenario(rig, world, seed, loss.is_none());
    let mut config = scenario.flight_config();
    (config.estimators, config.in_loop) = (vec![EstimatorKind::Lanes], EstimatorKind::Lanes);
    let mut dice = Dice::new(seed ^ 0x0070_7042);
    let rotor = ((dice.uniform() * ROTORS as f64) as usize).min(ROTORS - 1);
    let onset_s = ONSET_S.0 + (ONSET_S.1 - ONSET_S.0) * dice.uniform();
    let attack = |kind, magnitude| Attack {
        id: 1,
        sensor: SensorId::new(SensorKind::Rotor, rotor as u8 + 1),
        channel: Channel::All,
        kind,
        start_s: onset_s,
        duration_s: 60.0,
        magnitude,
        seed,
    };
    let mut attacks = Vec::new();
    match loss {
        Some((How::Broken, loss)) => {
            scenario.broken.push(BrokenRotor { rotor: rotor + 1, at_s: onset_s, left: 1.0 - loss });
        }
        Some((How::Attacked, loss)) => attacks.push(attack(Kind::Scale, 1.0 - loss)),
        Some((How::Told(kind), magnitude)) => attacks.push(attack(kind, magnitude)),
        None => {}
    }
    let onset_s = if loss.is_some() { onset_s } else { f64::INFINITY };
    let ends = loss.is_some_and(|(how, loss)| !matches!(how, How::Told(_)) && loss >= ENDS);
    scenario.duration_s = scenario.duration_s.min(onset_s + if ends { DOWN_S } else { AFTER_S });
    let setup = Setup { attacks, comes_down: ends, ..Setup::simulated(scenario, config, onset_s.min(5.0)) };
    let mut flown = Flown { onset_s, rotor, bounded: true, ..Flown::default() };
    let (mut before, mut altitude_m) = ([false; ROTORS], None);
    let outcome = fly_watched(&setup, |flight, truth| {
        let after_s = truth.time.as_seconds() - onset_s;
        let parts = flight.rotors().effectiveness();
        for (i, (part, before)) in parts.iter().zip(&mut before).enumerate() {
            let weak = *part < 1.0;
            if weak && !*before {
                let right = after_s >= 0.0 && i == rotor;
                flown.falsely += usize::from(!right);
                if after_s >= 0.0 {
                    flown.isolated.get_or_insert((after_s, i));
                }
            }
            *before = weak;
        }
        flown.found = parts[rotor];
        flown.altered = flight.attack_state().first().map_or(0, |progress| progress.altered_samples);
        let report = flight.report();
        let commands = report.command.throttle.iter().zip(&report.commanded.throttle).enumerate();
        for (i, (reached, told)) in commands {
            flown.bounded &= (0.0..=1.0).contains(reached) && (i == rotor || reached == told);
        }
        if after_s < 0.0 {
            flown.watched = flight.rotors().watches();
            flown.sigma = flight.rotors().sigma().into();
            altitude_m = Some(truth.position_enu_m.z);
        } else if flown.cut.is_none() && flight.report().mode != Mode::Disarmed {
            let z = truth.position_enu_m.z;
            flown.moved_m = flown.moved_m.max((z - altitude_m.unwrap_or(z)).abs());
            flown.tilt_rad = flown.tilt_rad.max(tilt_rad(&truth.world_from_body));
            if flight.report().armed {
                flown.sinks_mps = flown.sinks_mps.max(-truth.velocity_enu_mps.z);
            }
            flown.off_m = flown.off_m.max((z - flight.report().setpoint.position_enu_m.z).abs());
        }
        flown.failsafe = flight.failsafe();
        if flight.status().cut_latched {
            flown.cut.get_or_insert((after_s, flown.failsafe));
        }
    });
    let outcome = outcome.unwrap();
    (flown.lost, flown.delays_s) = (outcome.lost, outcome.delays_s);
    flown
}
