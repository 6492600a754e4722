//! Our types into messages of the wire. Nothing here allocates: what owns memory is kept, with room for the longest.

use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::{self, SensorKind};

use crate::attack::{Attack, Bounds, Channel, Injector, Kind, Phase, Progress, offered};
use crate::calibration::applied::Used;
use crate::control::step_response::StepResponse;
use crate::estimate::secure::suite::{NAMES, Promise, SuiteError};
use crate::estimate::{Estimate, Residual};
use crate::event::Event;
use crate::flight::{FlightConfig, FlightStatus, RotorWatch, StepReport};
use crate::frames::roll_pitch_yaw;
use crate::model::airframe::{Rotor, Spin};
use crate::sensor::quantities;
use crate::sensor::suite::Description as SensorDescription;
use crate::sensor::wire::{quaternion, vector};
use crate::sim::rig::Line;
use crate::telemetry::Replay;
use crate::types::{EstimatorKind, Setpoint};
use crate::vehicle::{AutopilotState, RecordedControl, Truth};

/// Puts `text` into a string that keeps its memory.
pub(super) fn set(into: &mut String, text: &str) {
    into.clear();
    into.push_str(text);
}

pub(super) fn estimate(
    now: FlightTime,
    kind: EstimatorKind,
    estimate: &Estimate,
    in_loop: bool,
    step_time_us: f64,
) -> v1::Estimate {
    let motion = estimate.motion;
    v1::Estimate {
        time_us: now.0,
        estimator: kind as i32,
        in_loop,
        health: estimate.health as i32,
        position_enu_m: motion.and_then(|m| vector(&m.position_enu_m)),
        velocity_enu_mps: motion.and_then(|m| vector(&m.velocity_enu_mps)),
        world_from_body: quaternion(&estimate.world_from_body),
        roll_pitch_yaw_rad: vector(&roll_pitch_yaw(&estimate.world_from_body)),
        body_rates_radps: vector(&estimate.body_rates_radps),
        accel_bias_mps2: estimate.accel_bias_mps2.as_ref().and_then(vector),
        gyro_bias_radps: estimate.gyro_bias_radps.as_ref().and_then(vector),
        position_sigma_m: motion.and_then(|m| vector(&m.position_sigma_m?)),
        velocity_sigma_mps: motion.and_then(|m| vector(&m.velocity_sigma_mps?)),
        attitude_sigma_rad: estimate.attitude_sigma_rad.as_ref().and_then(vector),
        step_time_us,
        altitude_known: estimate.altitude_known(),
        horizontal_known: estimate.horizontal_known(),
    }
}

pub(super) fn residual(residual: &Residual) -> v1::Residual {
    v1::Residual {
        sensor: residual.sensor.kind as i32,
        instance: u32::from(residual.sensor.instance),
        channel: residual.channel as i32,
        innovation: residual.innovation,
        sigma: residual.sigma,
        gate: residual.gate,
        ratio: residual.ratio(),
        accepted: residual.accepted,
    }
}

pub(super) fn truth(into: &mut v1::Truth, truth: &Truth) {
    into.time_us = truth.time.0;
    into.position_enu_m = vector(&truth.position_enu_m);
    into.velocity_enu_mps = vector(&truth.velocity_enu_mps);
    into.world_from_body = quaternion(&truth.world_from_body);
    into.roll_pitch_yaw_rad = vector(&roll_pitch_yaw(&truth.world_from_body));
    into.body_rates_radps = vector(&truth.body_rates_radps);
    into.specific_force_mps2 = vector(&truth.specific_force_mps2);
    values(&mut into.rotor_speed_radps, &truth.rotor_speed_radps);
    values(&mut into.string_tension_n, &truth.string_tension_n);
    into.ground_force_n = truth.ground_force_n;
}

fn values(into: &mut Vec<f64>, from: &[f64]) {
    into.clear();
    into.extend_from_slice(from);
}

/// What an autopilot was asked for and said; the message keeps its memory while there is none.
pub(super) fn autopilot(into: &mut v1::AutopilotControl, state: &AutopilotState) {
    let rates = |pair: &Option<(nalgebra::Vector3<f64>, f64)>| pair.as_ref().and_then(|(rates, _)| vector(rates));
    let thrust = |pair: Option<(nalgebra::Vector3<f64>, f64)>| pair.map(|(_, thrust)| thrust);
    (into.rates_asked_flu_radps, into.thrust_asked) = (rates(&state.asked), thrust(state.asked));
    (into.rates_target_flu_radps, into.thrust_target) = (rates(&state.aims_at), thrust(state.aims_at));
    values(&mut into.motor_output, state.outputs.as_ref().map_or(&[], |outputs| &outputs.throttle));
}

/// `recorded` is what a recording did then: shown in the place of a flight that only watches.
pub(super) fn control(into: &mut v1::Control, report: &StepReport, recorded: Option<&RecordedControl>) {
    let attacked = recorded.is_none() && report.command != report.commanded;
    values(&mut into.motor_attacked, if attacked { &report.command.throttle } else { &[] });
    let now = RecordedControl {
        mode: report.mode,
        armed: report.armed,
        setpoint: report.setpoint,
        wrench: report.wrench,
        command: report.commanded,
        saturated: report.saturated,
        integrator: report.integrator,
        step_response: report.step_response,
        motors_known: true,
    };
    let shown = recorded.unwrap_or(&now);
    into.time_us = report.sensed.time.0;
    into.mode = shown.mode as i32;
    into.armed = shown.armed;
    into.setpoint = Some(setpoint(&shown.setpoint));
    into.thrust_n = shown.wrench.thrust_n;
    into.torque_flu_nm = vector(&shown.wrench.torque_flu_nm);
    for (into, motors) in [(&mut into.motor_command, &shown.command), (&mut into.motor_applied, &report.applied)] {
        values(into, if shown.motors_known { &motors.throttle } else { &[] });
    }
    into.saturated = shown.saturated;
    values(&mut into.integrator, &shown.integrator);
    into.battery_v = report.sensed.battery_v;
}

fn setpoint(setpoint: &Setpoint) -> v1::Setpoint {
    let (position, angles) = (setpoint.position_enu_m, setpoint.roll_pitch_yaw_rad);
    // A recording made elsewhere does not know everything.
    let known = |value: f64| value.is_finite().then_some(value);
    v1::Setpoint {
        altitude_m: known(position.z),
        x_m: known(position.x),
        y_m: known(position.y),
        roll_rad: known(angles.x),
        pitch_rad: known(angles.y),
        yaw_rad: known(angles.z),
        throttle: known(setpoint.throttle),
    }
}

pub(super) fn step_response(now: FlightTime, response: &StepResponse) -> v1::StepResponse {
    v1::StepResponse {
        time_us: now.0,
        step: response.step,
        start_time_us: response.start.0,
        from_m: response.from_m,
        to_m: response.to_m,
        rise_time_s: response.rise_time_s,
        overshoot_percent: response.overshoot_percent,
        settling_time_s: response.settling_time_s,
        band_m: response.band_m,
        steady_error_m: response.steady_error_m,
        finished: response.finished,
        tracking_rms_m: response.tracking_rms_m,
        interrupted: response.interrupted,
    }
}

pub(super) fn event(into: &mut v1::Event, event: &Event) {
    into.time_us = event.time.0;
    into.set_severity(event.severity);
    set(&mut into.kind, event.kind.as_str());
    set(&mut into.text, &event.text);
}

/// Fills what the flight knows; the rest is the runner's.
pub(super) fn flight_status(into: &mut v1::Status, status: &FlightStatus) {
    into.mode = status.mode as i32;
    into.armed = status.armed;
    into.cut_latched = status.cut_latched;
    into.failsafe = status.failsafe as i32;
    set(&mut into.failsafe_reason, &status.failsafe_reason);
    into.checks.resize_with(status.checks.len(), v1::Check::default);
    for (into, check) in into.checks.iter_mut().zip(&status.checks) {
        set(&mut into.name, check.name);
        into.passed = check.passed;
        set(&mut into.reason, &check.reason);
    }
    into.disarms_in_s = status.disarms_in_s;
    into.ready_to_arm = status.ready_to_arm;
    into.battery_v = status.battery_v.unwrap_or(0.0);
    into.battery_fraction = status.battery_fraction.unwrap_or(0.0);
    into.estimator_in_loop = status.estimator_in_loop as i32;
    into.deadline_misses = status.deadline_misses;
    into.gains_revision = status.gains_revision.0;
}

/// What is known of the rotors.
pub(super) fn rotors(into: &mut v1::Status, watch: &RotorWatch) {
    values(&mut into.rotor_effectiveness, watch.effectiveness());
    into.rotors_watched = watch.watches();
}

/// A recording cannot be armed, whatever its samples look like; its mode is the one of then.
pub(super) fn replay_status(into: &mut v1::Status, replay: &Replay) {
    into.replay_speed = replay.speed;
    into.replay_progress = replay.progress;
    let reason = "a recording is flown: its motors are those of then";
    watched_status(into, &replay.recorded, "recording", reason);
}

/// What is only watched cannot be armed; one check called `name` says why.
pub(super) fn watched_status(into: &mut v1::Status, control: &RecordedControl, name: &str, reason: &str) {
    into.mode = control.mode as i32;
    into.armed = control.armed;
    into.ready_to_arm = false;
    into.checks.resize_with(1, v1::Check::default);
    if let Some(check) = into.checks.first_mut() {
        set(&mut check.name, name);
        check.passed = false;
        set(&mut check.reason, reason);
    }
}

pub(super) fn attacks(into: &mut v1::AttackState, now: FlightTime, injector: &Injector) {
    into.time_us = now.0;
    into.enabled = injector.enabled();
    into.schedule_id = injector.schedule_id();
    into.attacks.clear();
    into.attacks.extend(injector.state().iter().map(progress));
}

fn progress(progress: &Progress) -> v1::AttackProgress {
    let phase = match progress.phase {
        Phase::Accepted => v1::AttackPhase::Accepted,
        Phase::Active => v1::AttackPhase::Active,
        Phase::Done => v1::AttackPhase::Done,
        Phase::Aborted => v1::AttackPhase::Aborted,
    };
    v1::AttackProgress {
        attack: Some(wire_attack(&progress.attack)),
        phase: phase as i32,
        accepted_time_us: progress.accepted.0,
        active_time_us: progress.active.map(|time| time.0),
        ended_time_us: progress.ended.map(|time| time.0),
        altered_samples: progress.altered_samples,
    }
}

fn wire_channel(channel: Channel) -> v1::AttackChannel {
    use v1::AttackChannel as Wire;
    match channel {
        Channel::All => Wire::All,
        Channel::Gyro => Wire::Gyro,
        Channel::Accel => Wire::Accel,
        Channel::Mag => Wire::Mag,
        Channel::Axis(0) => Wire::X,
        Channel::Axis(1) => Wire::Y,
        Channel::Axis(_) => Wire::Z,
        Channel::GyroAxis(0) => Wire::GyroX,
        Channel::GyroAxis(1) => Wire::GyroY,
        Channel::GyroAxis(_) => Wire::GyroZ,
        Channel::AccelAxis(0) => Wire::AccelX,
        Channel::AccelAxis(1) => Wire::AccelY,
        Channel::AccelAxis(_) => Wire::AccelZ,
    }
}

/// An attack as a schedule of the wire has it.
pub fn wire_attack(attack: &Attack) -> v1::Attack {
    let kind = match attack.kind {
        Kind::Zero => v1::AttackKind::Zero,
        Kind::Bias => v1::AttackKind::Bias,
        Kind::Ramp => v1::AttackKind::Ramp,
        Kind::Scale => v1::AttackKind::Scale,
        Kind::Noise => v1::AttackKind::Noise,
        Kind::Freeze => v1::AttackKind::Freeze,
        Kind::Replay => v1::AttackKind::Replay,
        Kind::Delay => v1::AttackKind::Delay,
        Kind::Dropout => v1::AttackKind::Dropout,
        Kind::SignFlip => v1::AttackKind::SignFlip,
        Kind::Parabola => v1::AttackKind::Parabola,
        Kind::TimeShift => v1::AttackKind::TimeShift,
    };
    v1::Attack {
        id: attack.id,
        sensor: attack.sensor.kind as i32,
        instance: u32::from(attack.sensor.instance),
        channel: wire_channel(attack.channel) as i32,
        kind: kind as i32,
        start_s: attack.start_s,
        duration_s: attack.duration_s,
        magnitude: attack.magnitude,
        seed: attack.seed,
    }
}

pub(super) fn calibration_in_use(used: &Used) -> v1::CalibrationInUse {
    v1::CalibrationInUse {
        kind: used.kind.name().to_owned(),
        imu: u32::from(used.imu),
        date: used.date.to_string(),
        input: used.input.to_string(),
        configured: used.configured,
    }
}

pub(super) fn rotor_description(rotor: &Rotor) -> v1::RotorDescription {
    v1::RotorDescription {
        position_flu_m: vector(&rotor.position_flu_m),
        counter_clockwise: rotor.spin == Spin::CounterClockwise,
    }
}

pub(super) fn string_description(line: &Line) -> v1::StringDescription {
    v1::StringDescription {
        hook_enu_m: vector(&line.hook_enu_m),
        knot_flu_m: vector(&line.knot_flu_m),
        rest_length_m: line.rest_length_m,
    }
}

pub(super) fn observability(promise: &Result<Promise, SuiteError>) -> v1::Observability {
    let promise = match promise {
        Ok(promise) => promise,
        Err(error) => return v1::Observability { error: error.to_string(), ..v1::Observability::default() },
    };
    let state = |(name, rows): (&&str, &usize)| v1::StateObservability {
        state: (*name).to_owned(),
        rows_to_lose: *rows as u32,
    };
    let of_type = |(kind, rows, correctable): &(SensorKind, usize, usize)| v1::TypeObservability {
        sensor: *kind as i32,
        rows: *rows as u32,
        correctable: *correctable as u32,
    };
    v1::Observability {
        error: String::new(),
        rows: promise.rows as u32,
        rank: promise.rank as u32,
        sparse_observable: promise.sparse as u32,
        correctable: promise.correctable as u32,
        binding_state: NAMES.get(promise.binding).copied().unwrap_or_default().to_owned(),
        states: NAMES.iter().zip(&promise.to_lose).map(state).collect(),
        types: promise.kinds.iter().map(of_type).collect(),
    }
}

fn channel_description((channel, unit, offset_max): (Channel, &str, f64)) -> v1::SensorChannel {
    v1::SensorChannel { channel: wire_channel(channel) as i32, unit: unit.to_owned(), offset_max }
}

pub(super) fn sensor_description(sensor: &SensorDescription, bounds: &Bounds) -> v1::SensorDescription {
    v1::SensorDescription {
        kind: sensor.id.kind as i32,
        instance: u32::from(sensor.id.instance),
        name: sensor.name.clone(),
        rate_hz: sensor.rate_hz,
        sigma: sensor.sigma,
        unit: quantities(sensor.id.kind).first().map_or("", |first| first.unit).to_owned(),
        channels: offered(sensor.id.kind, bounds).map(channel_description).collect(),
    }
}

/// A rotor, as a target of attacks.
pub(super) fn actuator_description(instance: u8, config: &FlightConfig) -> v1::SensorDescription {
    let id = SensorId::new(SensorKind::Rotor, instance);
    let channels: Vec<_> = offered(id.kind, &config.attacks.bounds).map(channel_description).collect();
    v1::SensorDescription {
        kind: id.kind as i32,
        instance: u32::from(instance),
        name: id.to_string(),
        rate_hz: config.tick_rate_hz,
        sigma: 0.0,
        unit: channels.first().map_or_else(String::new, |channel| channel.unit.clone()),
        channels,
    }
}

pub(super) fn limits(config: &FlightConfig) -> v1::Limits {
    let limits = &config.limits;
    v1::Limits {
        altitude_min_m: limits.altitude_min_m,
        altitude_max_m: config.altitude_max_m(),
        lateral_max_m: limits.lateral_max_m,
        climb_max_mps: limits.climb_max_mps,
        descent_max_mps: limits.descent_max_mps,
        tilt_max_rad: limits.tilt_max_rad,
        thrust_max_n: config.airframe.max_thrust_n().min(config.rig.thrust_ceiling_n(config.airframe.weight_n())),
        attack_max_duration_s: config.attacks.bounds.duration_max_s,
    }
}
