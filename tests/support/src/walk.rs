//! One random walk: a drawn vehicle, drawn commands, faults and recoveries, and what must hold in every tick.

pub mod edge;

use crate::flown::Flown;
use plumbline_agent::attack::{Attack, Channel, Kind, Schedule};
use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::flight::{Failsafe, FlightConfig};
use plumbline_agent::frames::tilt_rad;
use plumbline_agent::sim::Scenario;
use plumbline_agent::sim::devices::Outage;
use plumbline_agent::supervisor::monitor::DESCENDS;
use plumbline_agent::supervisor::severity;
use plumbline_agent::types::{EstimatorKind, Mode};
use plumbline_agent::vehicle::Vehicle;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Length of one, s.
const LENGTH_S: f64 = 25.0;
/// Beyond its limits, m: the 0.3 m that the box allows, and what an estimate is off and a fault adds to a stop.
pub const MARGIN_M: f64 = 0.5;
/// Upside down on the floor for longer than this is a fault, s: the tilt failsafe's 0.3 s and its filter.
const UPSIDE_DOWN_S: f64 = 0.8;

/// Who flies: what a vehicle is flown by that has one IMU, and what one with more is.
pub const PILOTS: [EstimatorKind; 2] = [EstimatorKind::EkfBias, EstimatorKind::Lanes];

type Rng = Xoshiro256PlusPlus;

const RIGS: [&str; 8] = [
    "[rig.free]\nheight_m = 0.0",
    "[rig.hanging_strings]\nmode = \"flight\"",
    "[rig.hanging_strings]\nmode = \"orientation\"",
    "[rig.on_stand]\nheight_m = 0.3",
    "[rig.tethered]\nlength_m = 1.5",
    "[rig.single_axis]\naxis = \"roll\"\ncg_below_pivot_m = 0.01",
    "[rig.single_axis]\naxis = \"pitch\"\ncg_below_pivot_m = 0.01",
    "[rig.single_axis]\naxis = \"yaw\"",
];

/// A vehicle on some rig that `pilot` flies, with what will fail of it.
fn drawn(seed: u64, pilot: EstimatorKind, rng: &mut Rng) -> Flown {
    let rig = RIGS[rng.random_range(0..RIGS.len())];
    let pose = if rng.random_bool(0.5) { "\nadd = [\"mocap_pose\"]" } else { "" };
    let charge = if rng.random_bool(0.2) { 0.32 } else { 0.9 };
    let text = format!(
        "name = \"walk\"\nseed = {seed}\nduration_s = {LENGTH_S}\n{rig}\n[suite]\npreset = \"string_rig\"{pose}\n[battery]\ncharge = {charge}\n"
    );
    let mut scenario = Scenario::from_toml(&text).unwrap();
    if charge < 0.5 {
        scenario.airframe.battery.capacity_ah = 0.4;
    }
    for (kind, count) in [(SensorKind::Imu, 4), (SensorKind::Height, 3), (SensorKind::MocapPose, 1)] {
        if rng.random_bool(0.25) {
            let (start_s, duration_s) = (rng.random_range(4.0..20.0), rng.random_range(0.05..8.0));
            let lost = if rng.random_bool(0.5) { count } else { 1 };
            let outage = |instance| Outage { sensor: SensorId::new(kind, instance), start_s, duration_s };
            scenario.outages.extend((1..=lost).map(outage).filter(|o| scenario.suite.contains(o.sensor)));
        }
    }
    let config = FlightConfig { in_loop: pilot, ..scenario.flight_config() }.with_every_estimator();
    Flown::with_config(scenario, config)
}

fn setpoint(rng: &mut Rng) -> Command {
    let mut some = |low: f64, high: f64, wild: f64| {
        let value = if rng.random_bool(0.05) { wild } else { rng.random_range(low..high) };
        rng.random_bool(0.5).then_some(value)
    };
    Command::Setpoint(SetpointChange {
        altitude_m: some(0.0, 2.2, f64::NAN),
        x_m: some(-2.0, 2.0, 1e9),
        y_m: some(-2.0, 2.0, f64::INFINITY),
        roll_rad: some(-0.3, 0.3, 3.0),
        pitch_rad: some(-0.3, 0.3, -3.0),
        yaw_rad: some(-3.0, 3.0, f64::NAN),
        throttle: some(0.0, 1.5, 9.0),
    })
}

/// One field only: others are refused in most modes.
fn throttle(rng: &mut Rng) -> Command {
    let throttle = Some(rng.random_range(0.0..1.5));
    Command::Setpoint(SetpointChange { throttle, ..SetpointChange::default() })
}

fn altitude(rng: &mut Rng) -> Command {
    let altitude_m = Some(rng.random_range(0.2..2.0));
    Command::Setpoint(SetpointChange { altitude_m, ..SetpointChange::default() })
}

/// An attack on one IMU or one of three heights: a minority, which must not lead anything out of the box.
fn attack(rng: &mut Rng) -> Command {
    let (kind, instance, channel, most) = if rng.random_bool(0.5) {
        (SensorKind::Height, rng.random_range(1..=3), Channel::All, 1.0)
    } else {
        (SensorKind::Imu, rng.random_range(1..=4), Channel::AccelAxis(2), 3.0)
    };
    let what = [Kind::Bias, Kind::Ramp, Kind::Noise, Kind::Freeze, Kind::Dropout][rng.random_range(0..5)];
    let attack = Attack {
        id: 1,
        sensor: SensorId::new(kind, instance),
        channel,
        kind: what,
        start_s: 0.1,
        duration_s: rng.random_range(0.5..6.0),
        magnitude: if what == Kind::Dropout { 1.0 } else { rng.random_range(0.05..most) },
        seed: 3,
    };
    Command::Attack(Schedule { id: 1, attacks: [attack].into_iter().collect(), ..Schedule::default() })
}

/// Something happens; true where the operator chose a mode or let go of a cut.
fn happen(f: &mut Flown, rng: &mut Rng) -> bool {
    let now_s = f.last().t_s;
    let modes = [Mode::Stabilise, Mode::AltitudeHold, Mode::Hold, Mode::Land];
    let command = match rng.random_range(0..24) {
        0..=3 => Command::Arm,
        4..=6 => Command::SetMode(Mode::AltitudeHold),
        7..=8 => Command::SetMode(modes[rng.random_range(0..4)]),
        9..=11 => altitude(rng),
        12..=13 => throttle(rng),
        14 => setpoint(rng),
        15 => attack(rng),
        16 => {
            Command::SelectEstimator(EstimatorKind::try_from(rng.random_range(1..8)).unwrap_or(EstimatorKind::EkfBias))
        }
        17 if rng.random_bool(0.2) => Command::CutMotors,
        17 => Command::ReleaseCut,
        18 if rng.random_bool(0.2) => Command::Disarm,
        19 => {
            f.link_lost_s = if f.link_lost_s.is_finite() { f64::INFINITY } else { now_s };
            return false;
        }
        20 => {
            (f.operator_from_s, f.operator_lost_s) = (now_s, now_s + rng.random_range(0.5..20.0));
            return false;
        }
        21 if rng.random_bool(0.15) => {
            let gap_s = rng.random_range(0.02..1.0);
            f.flight.ticks_lost(f.vehicle.time(), (gap_s * 200.0) as u32);
            f.flight.stalled(gap_s);
            f.vehicle.pass_over(gap_s);
            return false;
        }
        22 if rng.random_bool(0.15) => {
            f.motor_factor[rng.random_range(0..4)] = rng.random_range(0.3..1.0);
            return false;
        }
        _ => {
            f.motor_factor = [1.0; 4];
            f.link_lost_s = f64::INFINITY;
            return false;
        }
    };
    let takes_over =
        matches!(command, Command::SetMode(_) | Command::ReleaseCut | Command::Disarm | Command::CutMotors);
    f.command(command).accepted && takes_over
}

/// Flies one walk by the estimator `pilot`; says what broke, and when.
///
/// # Errors
/// The invariant that did not hold, with the seed, the time and the log.
pub fn walk(seed: u64, pilot: EstimatorKind) -> Result<Seen, String> {
    let mut rng = Rng::seed_from_u64(seed);
    let mut f = drawn(seed, pilot, &mut rng);
    f.until(3.0);
    if rng.random_bool(0.5) {
        // Half of them begin in the air: what goes wrong on the floor is seldom much.
        f.command(Command::Arm);
        f.command(Command::SetMode(Mode::AltitudeHold));
        f.command(altitude(&mut rng));
    }
    let limit_m = f.flight.config().altitude_max_m() + MARGIN_M;
    let (mut next_s, mut upside_down_s, mut seen) = (3.0, 0.0, Seen::default());
    while f.last().t_s < LENGTH_S {
        let before = (f.flight.failsafe(), f.last().report.mode);
        let took_over = f.last().t_s >= next_s && {
            next_s += rng.random_range(0.05..1.5);
            happen(&mut f, &mut rng)
        };
        f.tick();
        let row = f.last();
        let (report, truth) = (&row.report, &row.truth);
        let failsafe = f.flight.failsafe();
        let broken = |what: String| Err(format!("seed {seed}, {pilot:?}, at {:.3} s: {what}\n{}", row.t_s, f.log()));
        if !report.armed && report.command.throttle != [0.0; 4] {
            return broken(format!("motors told {:?} in mode {:?}", report.command.throttle, report.mode));
        }
        if before.1 == Mode::Cut && report.mode != Mode::Cut && !took_over {
            return broken("a latched cut went away by itself".into());
        }
        let was_descending = severity(before.0) >= DESCENDS && !matches!(before.1, Mode::Disarmed | Mode::Cut);
        if was_descending && report.armed && report.mode != Mode::Land && !took_over {
            return broken(format!("{:?} ended in {:?} by itself", before.0, report.mode));
        }
        let on_floor = truth.ground_force_n > 0.0 && tilt_rad(&truth.world_from_body) > 2.0;
        upside_down_s = if report.armed && on_floor { upside_down_s + 0.005 } else { 0.0 };
        if upside_down_s > UPSIDE_DOWN_S {
            return broken("armed upside down on the floor".into());
        }
        if report.armed && truth.position_enu_m.z > limit_m {
            return broken(format!(
                "{:.2} m high, the box ends {MARGIN_M} m below {limit_m} m",
                truth.position_enu_m.z
            ));
        }
        seen.note(failsafe, report.armed, truth.position_enu_m.z);
        f.forget();
    }
    Ok(seen)
}

/// What a walk went through: walks that see nothing prove nothing.
#[derive(Debug, Default)]
pub struct Seen {
    /// Failsafes met, as on the wire.
    pub failsafes: std::collections::BTreeSet<i32>,
    /// Time armed and off the floor, s.
    pub flown_s: f64,
}

impl Seen {
    fn note(&mut self, failsafe: Failsafe, armed: bool, z_m: f64) {
        self.failsafes.insert(failsafe as i32);
        self.flown_s += if armed && z_m > 0.4 { 0.005 } else { 0.0 };
    }
}
