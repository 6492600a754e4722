//! The schema's enums as people read them, and as the ground's JSON writes them.

use plumbline_proto::v1::{
    AttackChannel, AttackKind, AttackPhase, Channel, Decoder, EstimatorKind, Failsafe, Mode, SensorKind,
};

/// The JSON name: the proto name without its prefix, in lower snake case.
fn json(proto_name: &str, prefix: &str) -> String {
    proto_name.strip_prefix(prefix).unwrap_or(proto_name).to_ascii_lowercase()
}

/// JSON name of a mode: `altitude_hold`.
pub fn mode_json(mode: Mode) -> String {
    json(mode.as_str_name(), "MODE_")
}

/// JSON name of an estimator: `ekf_bias`.
pub fn estimator_json(kind: EstimatorKind) -> String {
    json(kind.as_str_name(), "ESTIMATOR_KIND_")
}

/// JSON name of a decoder: `l1_split`.
pub fn decoder_json(decoder: Decoder) -> String {
    json(decoder.as_str_name(), "DECODER_")
}

/// JSON name of a sensor kind: `height`.
pub fn sensor_json(kind: SensorKind) -> String {
    json(kind.as_str_name(), "SENSOR_KIND_")
}

/// JSON name of an attack kind: `sign_flip`.
pub fn attack_kind_json(kind: AttackKind) -> String {
    json(kind.as_str_name(), "ATTACK_KIND_")
}

/// JSON name of an attack's channel: `gyro_x`.
pub fn attack_channel_json(channel: AttackChannel) -> String {
    json(channel.as_str_name(), "ATTACK_CHANNEL_")
}

/// A mode for people.
pub fn mode(mode: Mode) -> &'static str {
    match mode {
        Mode::Unspecified => "—",
        Mode::Disarmed => "Disarmed",
        Mode::Stabilise => "Stabilise",
        Mode::AltitudeHold => "Altitude hold",
        Mode::Hold => "Hold",
        Mode::Land => "Land",
        Mode::Cut => "Motors cut",
    }
}

/// What a mode does, for its tooltip.
pub fn mode_help(mode: Mode) -> &'static str {
    match mode {
        Mode::Unspecified => "Not known yet",
        Mode::Disarmed => "Motors stopped",
        Mode::Stabilise => "Attitude held, thrust as given",
        Mode::AltitudeHold => "Attitude and altitude held",
        Mode::Hold => "Position, altitude and yaw held",
        Mode::Land => "Descends, then disarms",
        Mode::Cut => "Motors cut and latched",
    }
}

/// Does an estimator of this kind estimate the altitude? Where it does not, no mode that holds one can be flown.
pub fn estimates_altitude(kind: EstimatorKind) -> bool {
    !kind.attitude_only()
}

/// An estimator for people, by its number.
pub fn estimator_numbered(number: u16) -> &'static str {
    EstimatorKind::try_from(i32::from(number)).unwrap_or_default().title()
}

/// A sensor kind for people: the words of its name in the schema, so that a new kind needs none here.
pub fn sensor(kind: SensorKind) -> String {
    match kind {
        SensorKind::Unspecified => "sensor".to_owned(),
        SensorKind::Imu => "IMU".to_owned(),
        SensorKind::Gnss => "GNSS".to_owned(),
        other => sensor_json(other).replace('_', " "),
    }
}

/// One sensor for people: "height 2".
pub fn instance(kind: SensorKind, number: u32) -> String {
    format!("{} {number}", sensor(kind))
}

/// A residual's channel for people.
pub fn channel(channel: Channel) -> &'static str {
    match channel {
        Channel::Unspecified => "",
        Channel::X => "x",
        Channel::Y => "y",
        Channel::Z => "z",
        Channel::GyroX => "gyro x",
        Channel::GyroY => "gyro y",
        Channel::GyroZ => "gyro z",
        Channel::AccelX => "accel x",
        Channel::AccelY => "accel y",
        Channel::AccelZ => "accel z",
        Channel::Heading => "heading",
        Channel::Height => "height",
        Channel::PressureAltitude => "altitude",
        Channel::VelocityX => "velocity x",
        Channel::VelocityY => "velocity y",
        Channel::VelocityZ => "velocity z",
        Channel::Roll => "roll",
        Channel::Pitch => "pitch",
        Channel::Yaw => "yaw",
        Channel::Range1 => "range 1",
        Channel::Range2 => "range 2",
        Channel::Range3 => "range 3",
        Channel::Range4 => "range 4",
    }
}

/// A residual channel on screen: its unit, and the factor from SI to it (degrees for angles).
pub fn channel_unit(channel: Channel) -> (&'static str, f64) {
    let degrees = 180.0 / std::f64::consts::PI;
    match channel {
        Channel::GyroX | Channel::GyroY | Channel::GyroZ => ("°/s", degrees),
        Channel::Heading | Channel::Roll | Channel::Pitch | Channel::Yaw => ("°", degrees),
        Channel::AccelX | Channel::AccelY | Channel::AccelZ => ("m/s²", 1.0),
        Channel::VelocityX | Channel::VelocityY | Channel::VelocityZ => ("m/s", 1.0),
        Channel::Unspecified => ("", 1.0),
        _ => ("m", 1.0),
    }
}

/// A failsafe for people; empty when none is on.
pub fn failsafe(failsafe: Failsafe) -> &'static str {
    match failsafe {
        Failsafe::None => "",
        Failsafe::LinkFreeze => "Link lost: setpoint frozen",
        Failsafe::LinkDescend => "Link lost: descending",
        Failsafe::OperatorFreeze => "No sign of the operator: setpoint frozen",
        Failsafe::OperatorDescend => "No sign of the operator: descending",
        Failsafe::TiltCut => "Tilt: motors cut",
        Failsafe::RateCut => "Rate: motors cut",
        Failsafe::BoxHold => "Box: held at its edge",
        Failsafe::BoxDescend => "Box: descending",
        Failsafe::EstimatorDescend => "Estimator degraded: descending",
        Failsafe::DeadlineWarn => "Control deadline missed",
        Failsafe::DeadlineDescend => "Control deadline missed: descending",
        Failsafe::OperatorCut => "Motors cut by the operator",
        Failsafe::TakeoffTimeout => "No take-off: disarmed",
        Failsafe::ImuCut => "No IMU: motors cut",
        Failsafe::StallCut => "Flight thread silent: motors cut",
        Failsafe::BatteryLow => "Battery low",
        Failsafe::BatteryDescend => "Battery empty",
        Failsafe::ThrustDescend => "Does not follow its thrust: descending",
        Failsafe::AltitudeDescend => "No height: descending on attitude alone",
        Failsafe::PositionHold => "Position lost: altitude hold",
        Failsafe::PositionDescend => "Position lost: descending",
        Failsafe::ShutdownDescend => "Agent asked to end: descending",
        Failsafe::RotorDescend => "Rotor too weak to hover: descending",
        Failsafe::RotorCut => "Rotor lost: motors cut",
        Failsafe::ShutdownCut => "Agent ended: motors cut",
    }
}

/// An attack kind for people.
pub fn attack_kind(kind: AttackKind) -> &'static str {
    match kind {
        AttackKind::Unspecified => "—",
        AttackKind::Zero => "zero",
        AttackKind::Bias => "bias",
        AttackKind::Ramp => "ramp",
        AttackKind::Scale => "scale",
        AttackKind::Noise => "noise",
        AttackKind::Freeze => "freeze",
        AttackKind::Replay => "replay",
        AttackKind::Delay => "delay",
        AttackKind::Dropout => "dropout",
        AttackKind::SignFlip => "sign flip",
        AttackKind::Parabola => "parabola",
        AttackKind::TimeShift => "time shift",
    }
}

/// An attack's channel for people.
pub fn attack_channel(channel: AttackChannel) -> &'static str {
    match channel {
        AttackChannel::All => "all channels",
        AttackChannel::Gyro => "gyro",
        AttackChannel::Accel => "accel",
        AttackChannel::Mag => "mag",
        AttackChannel::X => "x",
        AttackChannel::Y => "y",
        AttackChannel::Z => "z",
        AttackChannel::GyroX => "gyro x",
        AttackChannel::GyroY => "gyro y",
        AttackChannel::GyroZ => "gyro z",
        AttackChannel::AccelX => "accel x",
        AttackChannel::AccelY => "accel y",
        AttackChannel::AccelZ => "accel z",
    }
}

/// Where an attack stands.
pub fn phase(phase: AttackPhase) -> &'static str {
    match phase {
        AttackPhase::Unspecified => "draft",
        AttackPhase::Accepted => "accepted",
        AttackPhase::Active => "active",
        AttackPhase::Done => "done",
        AttackPhase::Aborted => "aborted",
    }
}

/// Every attack kind a schedule can hold.
pub const ATTACK_KINDS: [AttackKind; 12] = [
    AttackKind::Bias,
    AttackKind::Ramp,
    AttackKind::Scale,
    AttackKind::Noise,
    AttackKind::Zero,
    AttackKind::Freeze,
    AttackKind::Replay,
    AttackKind::Delay,
    AttackKind::Dropout,
    AttackKind::SignFlip,
    AttackKind::Parabola,
    AttackKind::TimeShift,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_names_are_the_contract() {
        assert_eq!(mode_json(Mode::AltitudeHold), "altitude_hold");
        assert_eq!(estimator_json(EstimatorKind::EkfBias), "ekf_bias");
        assert_eq!(decoder_json(Decoder::L1Split), "l1_split");
        assert_eq!(sensor_json(SensorKind::MocapPose), "mocap_pose");
        assert_eq!(
            (sensor(SensorKind::MocapPose), instance(SensorKind::Imu, 2)),
            ("mocap pose".into(), "IMU 2".into())
        );
        assert_eq!(attack_kind_json(AttackKind::SignFlip), "sign_flip");
        assert_eq!(attack_channel_json(AttackChannel::GyroX), "gyro_x");
    }

    #[test]
    fn angles_are_shown_in_degrees() {
        let (unit, factor) = channel_unit(Channel::Heading);
        assert_eq!(unit, "°");
        assert!((factor * std::f64::consts::PI - 180.0).abs() < 1e-9);
        assert_eq!(channel_unit(Channel::Height), ("m", 1.0));
    }
}
