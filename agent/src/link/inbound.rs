//! Commands from the wire, turned into the agent's own types and checked for nonsense.
//!
//! Only form is checked here (known kinds, finite numbers, sizes); whether a command may be obeyed
//! is decided by the flight code. What cannot be understood becomes [`Request::Refused`], so that
//! the operator gets a numbered answer with the reason.

use plumbline_proto::ids::{CommandId, GainsRevision, SensorId};
use plumbline_proto::v1::{self, command::Body};

use crate::attack::{Attack, Channel, Kind, MAX_ATTACKS, Schedule, Sequence};
use crate::calibration::applied::Correction;
use crate::calibration::{CalibrationFile, Kind as Of};
use crate::command::{Command, SetpointChange};
use crate::control::gains::Gain;
use crate::control::lqr_integral::Weights;
use crate::control::trajectory::{MAX_ALTITUDES, Shape, Trajectory};
use crate::control::tuning::Proposal;
use crate::types::ControllerKind;
use crate::vehicle::Service;

/// A command with its number.
#[derive(Debug, Clone, PartialEq)]
pub struct Inbound {
    /// Number given by the ground; the answer repeats it.
    pub id: CommandId,
    /// What is asked.
    pub request: Request,
}

/// What is asked, and of whom.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a box would be freed on the flight thread; the queue's room is taken once"
)]
pub enum Request {
    /// For the flight code.
    Flight(Command),
    /// For the runner: solve and certify this design away from the flight thread, then use it.
    Gains {
        /// Number given by the ground.
        revision: GainsRevision,
        /// What is asked for.
        proposal: Proposal,
    },
    /// For the runner: start or stop a recording by hand.
    Recording(bool),
    /// For the runner: how a recorded flight is played.
    Replay(ReplayRate),
    /// For the runner: what only a simulated vehicle can be given.
    Simulator(Service),
    /// For the runner: how samples are corrected.
    Calibration(Calibrating),
    /// Not understood.
    Refused(String),
}

/// How time runs in a replay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayRate {
    /// Times real time; 0 stands still.
    pub speed: f64,
    /// Ticks to go while standing still.
    pub step: u32,
}

/// A change of what corrects the samples of an IMU.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "handed over once per command; a box would be freed on the flight thread"
)]
pub enum Calibrating {
    /// Put this to use.
    Use {
        /// What it does.
        correction: Correction,
        /// The whole file, to be kept.
        file: String,
    },
    /// Use none of this kind any more.
    Drop {
        /// Which.
        kind: Of,
        /// Which IMU, from 1.
        imu: u8,
    },
}

/// Fastest replay, times real time.
pub const REPLAY_SPEED_MAX: f64 = 1_000.0;

/// Turns a command of the wire into one of ours.
pub fn parse(command: v1::Command) -> Inbound {
    let id = CommandId(command.command_id);
    let request = match command.body {
        Some(body) => request(body).unwrap_or_else(Request::Refused),
        None => Request::Refused("the command is empty, or newer than this agent".to_owned()),
    };
    Inbound { id, request }
}

fn request(body: Body) -> Result<Request, String> {
    Ok(Request::Flight(match body {
        Body::Arm(_) => Command::Arm,
        Body::Disarm(_) => Command::Disarm,
        Body::CutMotors(_) => Command::CutMotors,
        Body::ReleaseCut(_) => Command::ReleaseCut,
        Body::SetMode(set) => match v1::Mode::try_from(set.mode) {
            Ok(mode) if mode != v1::Mode::Unspecified => Command::SetMode(mode),
            _ => return Err(format!("mode {} is not known", set.mode)),
        },
        Body::Setpoint(setpoint) => Command::Setpoint(setpoint_change(&setpoint)?),
        Body::AttackSchedule(schedule) => Command::Attack(attack_schedule(&schedule)?),
        Body::AbortAttacks(_) => Command::AbortAttacks,
        Body::SelectEstimator(select) => match v1::EstimatorKind::try_from(select.estimator) {
            Ok(kind) if kind != v1::EstimatorKind::Unspecified => Command::SelectEstimator(kind),
            _ => return Err(format!("estimator {} is not known", select.estimator)),
        },
        Body::SelectDecoder(select) => match v1::Decoder::try_from(select.decoder) {
            Ok(decoder) if decoder != v1::Decoder::Unspecified => Command::SelectDecoder(decoder),
            _ => return Err(format!("decoder {} is not known", select.decoder)),
        },
        Body::SetRecording(recording) => return Ok(Request::Recording(recording.on)),
        Body::PushGains(push) => {
            let revision = GainsRevision(push.revision);
            return Ok(Request::Gains { revision, proposal: proposal(&push)? });
        }
        Body::SetTrajectory(set) => Command::Trajectory(trajectory(&set)?),
        Body::SetSimulator(v1::SetSimulator { new_battery, reset }) => {
            return Ok(Request::Simulator(Service { battery: new_battery, reset }));
        }
        Body::UseCalibration(v1::UseCalibration { file }) => {
            let read = CalibrationFile::from_json(&file).and_then(|read| Correction::of(&read));
            let correction = read.map_err(|error| error.to_string())?;
            return Ok(Request::Calibration(Calibrating::Use { correction, file }));
        }
        Body::DropCalibration(v1::DropCalibration { kind, imu }) => {
            let kind = Of::by_name(&kind).map_err(|error| error.to_string())?;
            let imu = u8::try_from(imu).map_err(|_| format!("there is no IMU {imu}"))?;
            return Ok(Request::Calibration(Calibrating::Drop { kind, imu }));
        }
        Body::SetReplay(replay) => {
            let speed = finite("replay speed", replay.speed)?;
            if !(0.0..=REPLAY_SPEED_MAX).contains(&speed) {
                return Err(format!("replay speed {speed} is outside 0 to {REPLAY_SPEED_MAX}"));
            }
            return Ok(Request::Replay(ReplayRate { speed, step: replay.step }));
        }
    }))
}

/// A design on the wire in our own types: form and finiteness only.
fn proposal(push: &v1::PushGains) -> Result<Proposal, String> {
    let kind = match v1::ControllerKind::try_from(push.controller) {
        // What a ground from before other controllers sends.
        Ok(ControllerKind::Unspecified) => ControllerKind::LqrIntegral,
        Ok(kind) => kind,
        Err(_) => return Err(format!("controller {} is not known", push.controller)),
    };
    let mut proposal = Proposal::new(kind);
    if let Some(weights) = &push.weights {
        proposal.weights = Some(Weights {
            state: exactly("state_weight", &weights.state_weight)?,
            input: exactly("input_weight", &weights.input_weight)?,
        });
    }
    for parameter in &push.parameters {
        proposal.parameter(&parameter.name, finite(&parameter.name, parameter.value)?)?;
    }
    proposal.k = match (&push.k, &push.k_attitude) {
        (None, None) => None,
        (Some(k), Some(k_attitude)) => Some([gain("k", k)?, gain("k_attitude", k_attitude)?]),
        (Some(_), None) => return Err("k without k_attitude".to_owned()),
        (None, Some(_)) => return Err("k_attitude without k".to_owned()),
    };
    Ok(proposal)
}

fn gain(name: &str, matrix: &v1::Matrix) -> Result<Gain, String> {
    if (matrix.rows, matrix.columns) != (4, 16) {
        return Err(format!("{name} is {} x {}, 4 x 16 is needed", matrix.rows, matrix.columns));
    }
    Ok(Gain::from_row_slice(&exactly::<64>(name, &matrix.values)?))
}

/// A path on the wire in our own types; limits are the flight code's business.
fn trajectory(set: &v1::SetTrajectory) -> Result<Option<Trajectory>, String> {
    use v1::TrajectoryShape as Wire;
    let wire = Wire::try_from(set.shape).map_err(|_| format!("trajectory shape {} is not known", set.shape))?;
    let period_s = finite("period_s", set.period_s)?;
    let size_m = finite("size_m", set.size_m)?;
    let speed_mps = finite("speed_mps", set.speed_mps)?;
    let shape = match wire {
        Wire::Unspecified => return Ok(None),
        Wire::Altitudes => {
            let altitude_m = set.altitude_m.iter().map(|z| finite("altitude_m", *z)).collect::<Result<Vec<_>, _>>()?;
            let many = format!("{} altitudes, at most {MAX_ALTITUDES}", altitude_m.len());
            let altitude_m = altitude_m.as_slice().try_into().map_err(|_| many)?;
            return Ok(Some(Trajectory::Altitudes { altitude_m, hold_s: finite("hold_s", set.hold_s)? }));
        }
        Wire::Circle => Shape::Circle { radius_m: size_m, period_s },
        Wire::Sine => Shape::Sine { amplitude_m: size_m, period_s, speed_mps },
        Wire::Square => Shape::Square { side_m: size_m, period_s },
        Wire::Heave => Shape::Heave { amplitude_m: size_m, period_s },
    };
    Ok(Some(Trajectory::Shape { shape, duration_s: finite("duration_s", set.duration_s)? }))
}

fn setpoint_change(setpoint: &v1::Setpoint) -> Result<SetpointChange, String> {
    let field = |name, value: Option<f64>| value.map(|value| finite(name, value)).transpose();
    Ok(SetpointChange {
        altitude_m: field("setpoint altitude_m", setpoint.altitude_m)?,
        x_m: field("setpoint x_m", setpoint.x_m)?,
        y_m: field("setpoint y_m", setpoint.y_m)?,
        roll_rad: field("setpoint roll_rad", setpoint.roll_rad)?,
        pitch_rad: field("setpoint pitch_rad", setpoint.pitch_rad)?,
        yaw_rad: field("setpoint yaw_rad", setpoint.yaw_rad)?,
        throttle: field("setpoint throttle", setpoint.throttle)?,
    })
}

/// Turns a schedule of the wire into one of ours; bounds are the injector's business.
///
/// # Errors
/// A text with the offending value.
pub fn attack_schedule(schedule: &v1::AttackSchedule) -> Result<Schedule, String> {
    if schedule.attacks.len() > MAX_ATTACKS {
        return Err(format!("{} attacks in one schedule, at most {MAX_ATTACKS}", schedule.attacks.len()));
    }
    let attacks = schedule.attacks.iter().map(attack).collect::<Result<_, _>>()?;
    let sequence = |sequence: &v1::AttackSequence| Sequence {
        attack: sequence.attack,
        period_s: sequence.period_s,
        values: sequence.value.iter().map(|value| f64::from(*value)).collect(),
    };
    let sequences = schedule.sequences.iter().map(sequence).collect();
    Ok(Schedule { id: schedule.schedule_id, attacks, sequences })
}

fn attack(attack: &v1::Attack) -> Result<Attack, String> {
    let id = attack.id;
    let number = |name: &str, value| finite(&format!("attack {id}: {name}"), value);
    let instance = u8::try_from(attack.instance)
        .map_err(|_| format!("attack {id}: no sensor has instance {}", attack.instance))?;
    Ok(Attack {
        id,
        sensor: match v1::SensorKind::try_from(attack.sensor) {
            Ok(kind) if kind != v1::SensorKind::Unspecified => SensorId::new(kind, instance),
            _ => return Err(format!("attack {id}: sensor kind {} is not known", attack.sensor)),
        },
        channel: v1::AttackChannel::try_from(attack.channel)
            .map(channel)
            .map_err(|_| format!("attack {id}: channel {} is not known", attack.channel))?,
        kind: v1::AttackKind::try_from(attack.kind)
            .ok()
            .and_then(kind)
            .ok_or_else(|| format!("attack {id}: kind {} is not known", attack.kind))?,
        start_s: number("start_s", attack.start_s)?,
        duration_s: number("duration_s", attack.duration_s)?,
        magnitude: number("magnitude", attack.magnitude)?,
        seed: attack.seed,
    })
}

fn channel(channel: v1::AttackChannel) -> Channel {
    use v1::AttackChannel as Wire;
    match channel {
        Wire::All => Channel::All,
        Wire::Gyro => Channel::Gyro,
        Wire::Accel => Channel::Accel,
        Wire::Mag => Channel::Mag,
        Wire::X => Channel::Axis(0),
        Wire::Y => Channel::Axis(1),
        Wire::Z => Channel::Axis(2),
        Wire::GyroX => Channel::GyroAxis(0),
        Wire::GyroY => Channel::GyroAxis(1),
        Wire::GyroZ => Channel::GyroAxis(2),
        Wire::AccelX => Channel::AccelAxis(0),
        Wire::AccelY => Channel::AccelAxis(1),
        Wire::AccelZ => Channel::AccelAxis(2),
    }
}

fn kind(kind: v1::AttackKind) -> Option<Kind> {
    use v1::AttackKind as Wire;
    Some(match kind {
        Wire::Unspecified => return None,
        Wire::Zero => Kind::Zero,
        Wire::Bias => Kind::Bias,
        Wire::Ramp => Kind::Ramp,
        Wire::Scale => Kind::Scale,
        Wire::Noise => Kind::Noise,
        Wire::Freeze => Kind::Freeze,
        Wire::Replay => Kind::Replay,
        Wire::Delay => Kind::Delay,
        Wire::Dropout => Kind::Dropout,
        Wire::SignFlip => Kind::SignFlip,
        Wire::Parabola => Kind::Parabola,
        Wire::TimeShift => Kind::TimeShift,
    })
}

fn finite(name: &str, value: f64) -> Result<f64, String> {
    if value.is_finite() { Ok(value) } else { Err(format!("{name} is {value}, a finite number is needed")) }
}

fn exactly<const N: usize>(name: &str, values: &[f64]) -> Result<[f64; N], String> {
    let values: [f64; N] =
        values.try_into().map_err(|_| format!("{name} has {} values, {N} are needed", values.len()))?;
    values.iter().try_for_each(|value| finite(name, *value).map(|_| ()))?;
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(body: Body) -> String {
        match parse(v1::Command { command_id: 7, operator: "t".into(), seen_us: None, body: Some(body) }) {
            Inbound { id: CommandId(7), request: Request::Refused(reason) } => reason,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn nonsense_is_refused_with_its_value() {
        let setpoint = v1::Setpoint { altitude_m: Some(f64::NAN), ..Default::default() };
        assert_eq!(refusal(Body::Setpoint(setpoint)), "setpoint altitude_m is NaN, a finite number is needed");
        assert_eq!(refusal(Body::SetMode(v1::SetMode { mode: 99 })), "mode 99 is not known");
        assert_eq!(
            refusal(Body::SetReplay(v1::SetReplay { speed: -1.0, step: 0 })),
            "replay speed -1 is outside 0 to 1000"
        );
        let weights = v1::LqrWeights { state_weight: vec![1.0; 15], input_weight: vec![1.0; 4] };
        let push = v1::PushGains { revision: 3, weights: Some(weights), ..Default::default() };
        assert_eq!(refusal(Body::PushGains(push)), "state_weight has 15 values, 16 are needed");
        let push = v1::PushGains { controller: 77, ..Default::default() };
        assert_eq!(refusal(Body::PushGains(push)), "controller 77 is not known");
        let flat = v1::Matrix { rows: 1, columns: 64, values: vec![0.0; 64] };
        let push = v1::PushGains { k: Some(flat.clone()), k_attitude: Some(flat), ..Default::default() };
        assert_eq!(refusal(Body::PushGains(push)), "k is 1 x 64, 4 x 16 is needed");
        let infinite = v1::Parameter { name: "tilt_p".into(), value: f64::INFINITY };
        let push = v1::PushGains { parameters: vec![infinite], ..Default::default() };
        assert_eq!(refusal(Body::PushGains(push)), "tilt_p is inf, a finite number is needed");
        let attack = v1::Attack { id: 4, sensor: 2, instance: 300, kind: 2, ..Default::default() };
        let schedule = v1::AttackSchedule { schedule_id: 1, attacks: vec![attack], ..Default::default() };
        assert_eq!(refusal(Body::AttackSchedule(schedule)), "attack 4: no sensor has instance 300");
        let schedule =
            v1::AttackSchedule { schedule_id: 1, attacks: vec![attack; MAX_ATTACKS + 1], ..Default::default() };
        assert_eq!(refusal(Body::AttackSchedule(schedule)), "33 attacks in one schedule, at most 32");
        let empty = parse(v1::Command { command_id: 1, ..Default::default() });
        assert!(matches!(empty.request, Request::Refused(_)));
    }

    #[test]
    fn every_kind_and_channel_of_the_wire_is_understood() {
        for number in 1..=10 {
            let wire = v1::Attack {
                id: 1,
                sensor: v1::SensorKind::Height as i32,
                instance: 2,
                channel: v1::AttackChannel::All as i32,
                kind: number,
                start_s: 5.0,
                duration_s: 10.0,
                magnitude: 0.5,
                seed: 1,
            };
            let ours = attack(&wire).unwrap();
            assert_eq!(ours.sensor.to_string(), "height 2");
            let name = v1::AttackKind::try_from(number).unwrap().as_str_name();
            let ours = format!("{:?}", ours.kind).to_uppercase();
            assert_eq!(name.trim_start_matches("ATTACK_KIND_").replace('_', ""), ours);
        }
        assert!((0..=12).all(|number| v1::AttackChannel::try_from(number).is_ok()));
    }
}
