//! One flight that does what it can to leave its box: random commands of one mode on one rig, everything in order.

use super::{MARGIN_M, RIGS, Rng, Seen, altitude, setpoint, throttle};
use crate::flown::Flown;
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::control::trajectory::{Shape, Trajectory};
use plumbline_agent::flight::Failsafe;
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::{EstimatorKind, Mode};
use rand::{RngExt, SeedableRng};

/// Modes an operator may choose.
pub const MODES: [Mode; 4] = [Mode::Stabilise, Mode::AltitudeHold, Mode::Hold, Mode::Land];
/// Pairs of a mode and a rig.
pub const PAIRS: usize = MODES.len() * RIGS.len();
/// The mode is commanded from here on, s, after a take-off …
const FROM_S: f64 = 5.0;
/// … until here.
const LENGTH_S: f64 = 14.0;

/// A stick held against its stop, the same for all of a flight.
fn stubborn(mode: Mode, rng: &mut Rng) -> Command {
    let end = |rng: &mut Rng, most: f64| if rng.random_bool(0.5) { most } else { -most };
    let change = match mode {
        Mode::Stabilise => SetpointChange {
            throttle: Some(rng.random_range(1.0..1.5)),
            roll_rad: Some(rng.random_range(-0.35..0.35)),
            pitch_rad: Some(rng.random_range(-0.35..0.35)),
            ..SetpointChange::default()
        },
        Mode::AltitudeHold => SetpointChange {
            altitude_m: Some(2.0),
            roll_rad: Some(end(rng, 0.35)),
            pitch_rad: Some(rng.random_range(-0.35..0.35)),
            ..SetpointChange::default()
        },
        _ => SetpointChange {
            altitude_m: Some(2.0),
            x_m: Some(end(rng, 2.0)),
            y_m: Some(end(rng, 2.0)),
            ..SetpointChange::default()
        },
    };
    Command::Setpoint(change)
}

fn path(rng: &mut Rng) -> Command {
    let period_s = rng.random_range(1.0..12.0);
    let shape = match rng.random_range(0..3) {
        0 => Shape::Circle { radius_m: rng.random_range(0.1..2.0), period_s },
        1 => Shape::Square { side_m: rng.random_range(0.1..2.0), period_s },
        _ => Shape::Heave { amplitude_m: rng.random_range(0.05..1.0), period_s },
    };
    Command::Trajectory(Some(Trajectory::Shape { shape, duration_s: 0.0 }))
}

fn tilt(rng: &mut Rng) -> Command {
    let angle = |rng: &mut Rng| Some(rng.random_range(-0.35..0.35));
    let (roll_rad, pitch_rad) = (angle(rng), angle(rng));
    Command::Setpoint(SetpointChange { roll_rad, pitch_rad, ..SetpointChange::default() })
}

/// A vehicle in order that `pilot` flies, with its place measured or not.
fn vehicle(rig: &str, seed: u64, pilot: EstimatorKind, placed: bool) -> Flown {
    let add = if placed { "\nadd = [\"mocap_pose\"]" } else { "" };
    let text = format!(
        "name = \"edge\"\nseed = {seed}\nduration_s = {LENGTH_S}\n{rig}\n[suite]\npreset = \"string_rig\"{add}\n"
    );
    let scenario = Scenario::from_toml(&text).unwrap();
    let mut config = scenario.flight_config();
    (config.estimators, config.in_loop) = (vec![pilot, EstimatorKind::Complementary], pilot);
    Flown::with_config(scenario, config)
}

/// Flies the pair of mode and rig `n` (modulo [`PAIRS`]); says how far beyond its limits the vehicle came, m (altitude,
/// place), and what the flight went through.
///
/// # Errors
/// How far it left its box, with the seed and the log.
pub fn edge(n: usize, seed: u64, pilot: EstimatorKind) -> Result<((f64, f64), Seen), String> {
    let (mode, rig) = (MODES[n % MODES.len()], RIGS[n / MODES.len() % RIGS.len()]);
    let mut rng = Rng::seed_from_u64(seed);
    let placed = mode == Mode::Hold || rng.random_bool(0.5);
    let mut f = vehicle(rig, seed, pilot, placed);
    let lifts = f.flight.config().rig.can_lift();
    f.until(3.0);
    f.command(Command::Arm);
    if lifts {
        f.command(Command::SetMode(Mode::AltitudeHold));
        f.command(altitude(&mut rng));
    }
    f.until(FROM_S);
    let held = stubborn(mode, &mut rng);
    let pause_s = if rng.random_bool(0.3) { 0.005..0.01 } else { 0.05..1.0 };
    let (mut next_s, mut beyond_m, mut seen) = (FROM_S, (-f64::INFINITY, -f64::INFINITY), Seen::default());
    let (altitude_max_m, lateral_max_m) = (f.flight.config().altitude_max_m(), f.flight.config().limits.lateral_max_m);
    let mut blind = false;
    while f.last().t_s < LENGTH_S {
        if f.last().t_s >= next_s {
            next_s += rng.random_range(pause_s.clone());
            // What took over is overruled at once.
            let entered = f.command(Command::SetMode(mode)).accepted;
            if entered && !lifts && !matches!(mode, Mode::Stabilise | Mode::Land) {
                return Err(format!("seed {seed}, {pilot:?}: {mode:?} on a rig that cannot lift\n{}", f.log()));
            }
            let command = match rng.random_range(0..8) {
                0..=3 => held.clone(),
                4 => throttle(&mut rng),
                5 => tilt(&mut rng),
                6 => path(&mut rng),
                _ => setpoint(&mut rng),
            };
            f.command(command);
        }
        f.tick();
        let (row, failsafe) = (f.last(), f.flight.failsafe());
        let place = row.truth.position_enu_m;
        seen.note(failsafe, row.report.armed, place.z);
        beyond_m.0 = beyond_m.0.max(place.z - altitude_max_m);
        // What descends on attitude alone goes where it goes, and stays there.
        blind |= matches!(failsafe, Failsafe::EstimatorDescend | Failsafe::AltitudeDescend);
        if row.estimate.horizontal_known() && !blind {
            beyond_m.1 = beyond_m.1.max(place.x.abs().max(place.y.abs()) - lateral_max_m);
        }
        if beyond_m.0.max(beyond_m.1) > MARGIN_M {
            return Err(format!(
                "seed {seed}, {pilot:?}, {mode:?}, {rig}: at {:.3} s {:.2} m beyond the limit of altitude, {:.2} m beyond that of place\n{}",
                row.t_s,
                beyond_m.0,
                beyond_m.1,
                f.log()
            ));
        }
        f.forget();
    }
    Ok((beyond_m, seen))
}
