//! What a station asks, done as the account configured.

use std::f64::consts::FRAC_PI_2;

use mavlink::dialects::common::*;
use mavlink::{Message as _, MessageData as _};
use plumbline_proto::{Kind, v1};
use plumbline_rest::command as rest;

use super::super::App;
use super::super::control;
use super::super::error::ApiError;
use super::super::order::{Order, Sender};
use super::{Latest, Line, say};
use crate::config::Mavlink;
use crate::names::JsonName as _;
use crate::people::{Access, Person, Role};

/// Of [`MavCmd::MAV_CMD_COMPONENT_ARM_DISARM`], second parameter: disarm in flight.
const FORCE: f32 = 21196.0;
/// Setpoints closer than this are the same, m and rad.
const SAME: f64 = 1e-4;

/// Who asks of which vehicle.
#[derive(Clone)]
pub(super) struct Who {
    pub(super) app: App,
    pub(super) vehicle: String,
    pub(super) config: Mavlink,
}

/// What a message is about.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Asked {
    /// An order, and the command to acknowledge; setpoints have none.
    Order(Order, Option<MavCmd>),
    /// To be answered at once.
    Answer(Vec<MavMessage>),
    /// A command that is not known here.
    Unsupported(MavCmd),
    /// A sign of life.
    Alive,
    /// Nothing that concerns us.
    Nothing,
}

/// The system that a message is for; `None` where it is for all. An order to 0, everybody, is nobody's.
pub(super) fn target(message: &MavMessage) -> Option<u8> {
    use MavMessage::{MISSION_REQUEST_LIST, PARAM_REQUEST_LIST, PARAM_REQUEST_READ, TIMESYNC};
    let changes_nothing =
        matches!(message, PARAM_REQUEST_LIST(_) | PARAM_REQUEST_READ(_) | MISSION_REQUEST_LIST(_) | TIMESYNC(_));
    message.target_system_id().filter(|system| *system > 0 || !changes_nothing)
}

/// Reads one message of a station.
#[allow(deprecated, reason = "stations go on sending SET_MODE")]
pub(super) fn read(message: &MavMessage, latest: &Latest) -> Asked {
    match message {
        MavMessage::HEARTBEAT(heartbeat) if heartbeat.mavtype == MavType::MAV_TYPE_GCS => Asked::Alive,
        MavMessage::COMMAND_LONG(m) => command(m.command, [m.param1, m.param2]),
        MavMessage::COMMAND_INT(m) => command(m.command, [m.param1, m.param2]),
        MavMessage::SET_MODE(m) => mode(m.custom_mode, None),
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(m) => position(m),
        MavMessage::PARAM_REQUEST_LIST(_) => {
            let all = say::parameters(&latest.gains);
            Asked::Answer((0..all.len()).filter_map(|index| say::parameter(&all, index)).collect())
        }
        MavMessage::PARAM_REQUEST_READ(m) => {
            Asked::Answer(one_parameter(latest, m.param_id.to_str(), m.param_index).into_iter().collect())
        }
        MavMessage::PARAM_SET(m) => {
            let mut answer = say::text(v1::Severity::Warning, "parameters are read-only here");
            answer.extend(one_parameter(latest, m.param_id.to_str(), -1));
            Asked::Answer(answer)
        }
        MavMessage::MISSION_REQUEST_LIST(m) => Asked::Answer(vec![MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
            count: 0,
            target_system: 0,
            target_component: 0,
            mission_type: m.mission_type,
            ..MISSION_COUNT_DATA::DEFAULT
        })]),
        MavMessage::TIMESYNC(m) if m.tc1 == 0 => Asked::Answer(vec![say::time(m.ts1)]),
        _ => Asked::Nothing,
    }
}

fn one_parameter(latest: &Latest, name: Result<&str, std::str::Utf8Error>, index: i16) -> Option<MavMessage> {
    let all = say::parameters(&latest.gains);
    let by_name = || all.iter().position(|(known, _)| name.is_ok_and(|name| name == known));
    say::parameter(&all, usize::try_from(index).ok().or_else(by_name)?)
}

#[allow(deprecated, reason = "stations go on asking for capabilities by the old command")]
fn command(command: MavCmd, [first, second]: [f32; 2]) -> Asked {
    let order = match command {
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if first == 1.0 => Order::Arm,
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if first == 0.0 && second == FORCE => Order::Cut,
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if first == 0.0 => Order::Disarm,
        MavCmd::MAV_CMD_DO_FLIGHTTERMINATION if first == 1.0 => Order::Cut,
        MavCmd::MAV_CMD_NAV_LAND => mode_order(v1::Mode::Land),
        MavCmd::MAV_CMD_DO_SET_MODE => return mode(second as u32, Some(command)),
        MavCmd::MAV_CMD_REQUEST_MESSAGE if first == AUTOPILOT_VERSION_DATA::ID as f32 => return version(command),
        MavCmd::MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES => return version(command),
        _ => return Asked::Unsupported(command),
    };
    Asked::Order(order, Some(command))
}

fn version(command: MavCmd) -> Asked {
    Asked::Answer(vec![acknowledged(command, MavResult::MAV_RESULT_ACCEPTED), say::version()])
}

/// The custom mode is the number of our own mode; which may be asked for says the API.
fn mode(number: u32, command: Option<MavCmd>) -> Asked {
    let mode = i32::try_from(number).ok().and_then(|number| v1::Mode::try_from(number).ok());
    Asked::Order(mode_order(mode.unwrap_or_default()), command)
}

fn mode_order(mode: v1::Mode) -> Order {
    Order::Mode(rest::Mode { mode: mode.json_name() })
}

fn position(asked: &SET_POSITION_TARGET_LOCAL_NED_DATA) -> Asked {
    use PositionTargetTypemask as Mask;
    if asked.coordinate_frame != MavFrame::MAV_FRAME_LOCAL_NED {
        return Asked::Answer(say::text(v1::Severity::Warning, "setpoints: only MAV_FRAME_LOCAL_NED"));
    }
    let given = |ignored: Mask, value: f64| (!asked.type_mask.contains(ignored)).then_some(value);
    let setpoint = rest::Setpoint {
        altitude_m: given(Mask::POSITION_TARGET_TYPEMASK_Z_IGNORE, -f64::from(asked.z)),
        x_m: given(Mask::POSITION_TARGET_TYPEMASK_Y_IGNORE, f64::from(asked.y)),
        y_m: given(Mask::POSITION_TARGET_TYPEMASK_X_IGNORE, f64::from(asked.x)),
        yaw_rad: given(Mask::POSITION_TARGET_TYPEMASK_YAW_IGNORE, FRAC_PI_2 - f64::from(asked.yaw)),
        ..rest::Setpoint::default()
    };
    Asked::Order(Order::Setpoint(setpoint), None)
}

/// Deals with one message. What takes time has a task of its own, so that nothing waits behind it.
pub(super) fn answer(who: &Who, line: &Line, latest: &Latest, message: MavMessage) {
    match read(&message, latest) {
        Asked::Order(order, command) => {
            let (who, line) = (who.clone(), line.clone());
            tokio::spawn(async move { who.obey(&line, order, command).await });
        }
        Asked::Answer(messages) => messages.iter().for_each(|message| line.say(message)),
        Asked::Unsupported(command) => line.say(&acknowledged(command, MavResult::MAV_RESULT_UNSUPPORTED)),
        Asked::Alive => who.alive(latest.status.challenge),
        Asked::Nothing => {}
    }
}

fn acknowledged(command: MavCmd, result: MavResult) -> MavMessage {
    MavMessage::COMMAND_ACK(COMMAND_ACK_DATA { command, result, ..COMMAND_ACK_DATA::DEFAULT })
}

impl Who {
    /// Under which name, and as what. A station on another machine only watches, unless it signs.
    fn person(&self) -> (String, Role) {
        let person = self.app.people.standing();
        let Person { account, role } = person.unwrap_or(Person { account: None, role: Role::Viewer });
        let trusted = self.config.station.ip().is_loopback() || self.config.key.is_some();
        let role = if trusted { role } else { Role::Viewer };
        (account.unwrap_or_else(|| "mavlink".into()), role)
    }

    /// Passes the station's sign of life on, while it holds control.
    fn alive(&self, challenge: u64) {
        let (name, role) = self.person();
        if Access::Operate.open_to(role)
            && self.app.leases.alive(&self.vehicle, &name)
            && let Ok(commands) = self.app.hub.commands(&self.vehicle)
        {
            commands.try_operator_alive(challenge);
        }
    }

    /// Does what is ordered, writes it down, and says what came of it.
    async fn obey(&self, line: &Line, order: Order, command: Option<MavCmd>) {
        if self.is_so_already(&order) {
            return;
        }
        let (name, role) = self.person();
        let sender = Sender { name, role, from: self.config.station.to_string(), way: "MAVLINK" };
        let outcome = order.carry_out(&self.app, &self.vehicle, sender).await;
        if let Some(command) = command {
            line.say(&acknowledged(command, result(&outcome)));
        }
        if let Err(error) = outcome {
            say::text(v1::Severity::Warning, &error.text()).iter().for_each(|message| line.say(message));
        }
    }

    /// Stations repeat a setpoint many times a second: only what differs from the one in use is asked of the vehicle.
    fn is_so_already(&self, order: &Order) -> bool {
        let Order::Setpoint(asked) = order else { return false };
        let control = self.app.hub.latest::<v1::Control>(&self.vehicle, Kind::Control);
        let Some(used) = control.and_then(|control| control.setpoint) else { return false };
        let same = |asked: Option<f64>, used: Option<f64>| {
            asked.is_none_or(|asked| used.is_some_and(|used| (asked - used).abs() < SAME))
        };
        same(asked.altitude_m, used.altitude_m)
            && same(asked.x_m, used.x_m)
            && same(asked.y_m, used.y_m)
            && same(asked.yaw_rad, used.yaw_rad)
    }
}

fn result(outcome: &control::Answer) -> MavResult {
    match outcome {
        Ok(_) => MavResult::MAV_RESULT_ACCEPTED,
        Err(ApiError::Rejected { .. } | ApiError::Conflict(_)) => MavResult::MAV_RESULT_TEMPORARILY_REJECTED,
        Err(ApiError::Foreign(_) | ApiError::Held(_) | ApiError::Invalid(_)) => MavResult::MAV_RESULT_DENIED,
        Err(_) => MavResult::MAV_RESULT_FAILED,
    }
}
