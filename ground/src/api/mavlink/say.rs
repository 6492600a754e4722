//! What is known of a vehicle as MAVLink messages of the `common` dialect. World NED and body FRD, as that has them.

use std::f64::consts::FRAC_PI_2;
use std::time::{SystemTime, UNIX_EPOCH};

use mavlink::dialects::common::*;
use mavlink::types::CharArray;
use plumbline_core::frames::wrap_pi;
use plumbline_proto::v1;

use super::Latest;

/// Characters of one STATUSTEXT.
const TEXT: usize = 50;
/// Longest text of an event that is passed on, in pieces of [`TEXT`].
const PIECES: usize = 6;

/// Attitude and position of the estimate in the loop.
pub(super) fn motion(latest: &Latest) -> Vec<MavMessage> {
    let Some(estimate) = &latest.estimate else { return Vec::new() };
    let time_boot_ms = (estimate.time_us / 1000) as u32;
    let [angle, rate, place, speed] =
        [estimate.roll_pitch_yaw_rad, estimate.body_rates_radps, estimate.position_enu_m, estimate.velocity_enu_mps]
            .map(Option::unwrap_or_default);
    // Not known is NaN, not the origin.
    let level = |value: f64| if estimate.horizontal_known { value as f32 } else { f32::NAN };
    vec![
        MavMessage::ATTITUDE(ATTITUDE_DATA {
            time_boot_ms,
            roll: angle.x as f32,
            pitch: -angle.y as f32,
            yaw: wrap_pi(FRAC_PI_2 - angle.z) as f32,
            rollspeed: rate.x as f32,
            pitchspeed: -rate.y as f32,
            yawspeed: -rate.z as f32,
        }),
        MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            time_boot_ms,
            x: level(place.y),
            y: level(place.x),
            z: -place.z as f32,
            vx: level(speed.y),
            vy: level(speed.x),
            vz: -speed.z as f32,
        }),
    ]
}

/// Heartbeat, battery, and what a head-up display shows.
pub(super) fn state(latest: &Latest) -> Vec<MavMessage> {
    let status = &latest.status;
    let percent = (100.0 * status.battery_fraction).clamp(0.0, 100.0).round() as i8;
    let measured = status.battery_v > 0.0;
    let millivolts = if measured { (1e3 * status.battery_v) as u16 } else { u16::MAX };
    let remaining = if measured { percent } else { -1 };
    let mut voltages = [u16::MAX; 10];
    voltages[0] = millivolts;
    let sensors =
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL;
    let mut all = vec![
        heartbeat(status),
        MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            onboard_control_sensors_present: sensors,
            onboard_control_sensors_enabled: sensors,
            onboard_control_sensors_health: sensors,
            load: (1e-3 * status.tick_time_p50_us * status.tick_rate_hz).clamp(0.0, 1e3) as u16,
            voltage_battery: millivolts,
            current_battery: -1,
            battery_remaining: remaining,
            onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
            ..SYS_STATUS_DATA::DEFAULT
        }),
        MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA {
            id: 0,
            battery_function: MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL,
            mavtype: MavBatteryType::MAV_BATTERY_TYPE_LIPO,
            temperature: i16::MAX,
            voltages,
            current_battery: -1,
            current_consumed: -1,
            energy_consumed: -1,
            battery_remaining: remaining,
            fault_bitmask: MavBatteryFault::empty(),
            ..BATTERY_STATUS_DATA::DEFAULT
        }),
    ];
    if let Some(estimate) = &latest.estimate {
        let speed = estimate.velocity_enu_mps.unwrap_or_default();
        let yaw_rad = estimate.roll_pitch_yaw_rad.map_or(0.0, |angle| angle.z);
        all.push(MavMessage::VFR_HUD(VFR_HUD_DATA {
            airspeed: 0.0,
            groundspeed: speed.x.hypot(speed.y) as f32,
            alt: estimate.position_enu_m.map_or(0.0, |place| place.z) as f32,
            climb: speed.z as f32,
            heading: (FRAC_PI_2 - yaw_rad).to_degrees().rem_euclid(360.0) as i16,
            throttle: 0,
        }));
    }
    all
}

/// Every flag named: the defaults of flags are not empty.
fn heartbeat(status: &v1::Status) -> MavMessage {
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, status.armed);
    let system_status = if status.cut_latched {
        MavState::MAV_STATE_FLIGHT_TERMINATION
    } else if status.failsafe() != v1::Failsafe::None {
        MavState::MAV_STATE_CRITICAL
    } else if status.armed {
        MavState::MAV_STATE_ACTIVE
    } else {
        MavState::MAV_STATE_STANDBY
    };
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: status.mode.try_into().unwrap_or_default(),
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        base_mode,
        system_status,
        mavlink_version: 3,
    })
}

/// A text for people; a long one in numbered pieces.
pub(super) fn text(severity: v1::Severity, text: &str) -> Vec<MavMessage> {
    let severity = match severity {
        v1::Severity::Critical => MavSeverity::MAV_SEVERITY_CRITICAL,
        v1::Severity::Warning => MavSeverity::MAV_SEVERITY_WARNING,
        _ => MavSeverity::MAV_SEVERITY_INFO,
    };
    // One byte a character, as stations show it.
    let plain: Vec<u8> = text.chars().map(|c| if c.is_ascii() { c as u8 } else { b'?' }).collect();
    let pieces = plain.chunks(TEXT).take(PIECES).enumerate();
    // Pieces of one text share a number other than 0.
    let id = if plain.len() > TEXT { (crc(&plain) | 1) & 0x7fff } else { 0 };
    pieces
        .map(|(number, piece)| {
            let mut bytes = [0; TEXT];
            bytes.iter_mut().zip(piece).for_each(|(to, from)| *to = *from);
            let text = CharArray::new(bytes);
            MavMessage::STATUSTEXT(STATUSTEXT_DATA { severity, text, id, chunk_seq: number as u8 })
        })
        .collect()
}

fn crc(bytes: &[u8]) -> u16 {
    mavlink::calculate_crc(bytes, 0)
}

/// Gains as parameters: names of at most 16 characters, and values.
pub(super) fn parameters(gains: &v1::GainsInUse) -> Vec<(String, f64)> {
    let weights = gains.weights.clone().unwrap_or_default();
    let numbered = |name: &'static str, values: Vec<f64>| {
        values.into_iter().enumerate().map(move |(index, value)| (format!("{name}{}", index + 1), value))
    };
    let mut all = vec![("GAINS_REVISION".to_owned(), f64::from(gains.revision))];
    all.extend(numbered("LQR_STATE_", weights.state_weight));
    all.extend(numbered("LQR_INPUT_", weights.input_weight));
    all.extend(gains.parameters.iter().map(|parameter| (parameter.name.to_uppercase(), parameter.value)));
    all.into_iter().map(|(name, value)| (name.chars().filter(char::is_ascii).take(16).collect(), value)).collect()
}

/// Parameter `index` of `all`.
pub(super) fn parameter(all: &[(String, f64)], index: usize) -> Option<MavMessage> {
    let (name, value) = all.get(index)?;
    let mut param_id = [0; 16];
    param_id.iter_mut().zip(name.bytes()).for_each(|(to, from)| *to = from);
    Some(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_id: CharArray::new(param_id),
        param_value: *value as f32,
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
        param_count: all.len() as u16,
        param_index: index as u16,
    }))
}

/// What this system can do. No number of PX4's or ArduPilot's: it is neither.
pub(super) fn version() -> MavMessage {
    MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION,
        ..AUTOPILOT_VERSION_DATA::DEFAULT
    })
}

/// Our clock beside the station's.
pub(super) fn time(theirs_ns: i64) -> MavMessage {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: now.as_nanos() as i64, ts1: theirs_ns, ..TIMESYNC_DATA::DEFAULT })
}
