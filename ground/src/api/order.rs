//! Commands that do not come by HTTP: from a MAVLink station, by a service of Foxglove's. They go its way all the same: role,
//! lease, acknowledgement, audit log.

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use plumbline_rest::command::{Mode, Setpoint};

use super::App;
use super::body::Body;
use super::control::{self, Answer};
use super::error::ApiError;
use super::extract::Path;
use super::operator::Operator;
use super::setpoint;
use crate::audit::{Deed, redacted};
use crate::people::{Access, Role};
use crate::sync::wall_time_us;

/// A command of the API.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Order {
    Arm,
    Disarm,
    Cut,
    Mode(Mode),
    Setpoint(Setpoint),
}

/// Who orders, and how.
#[derive(Debug, Clone)]
pub(super) struct Sender {
    pub(super) name: String,
    pub(super) role: Role,
    /// Address.
    pub(super) from: String,
    /// What the audit log has where HTTP has a method.
    pub(super) way: &'static str,
}

#[cfg(feature = "many")]
impl App {
    /// Cuts a vehicle's motors for a person at another ground, who may: that ground has looked.
    ///
    /// # Errors
    /// Why not, for people.
    pub(crate) async fn cut_for(&self, vehicle: &str, name: String) -> Result<(), String> {
        let sender = Sender { name, role: Role::Operator, from: "fleet".into(), way: "FLEET" };
        Order::Cut.carry_out(self, vehicle, sender).await.map(drop).map_err(|error| error.text())
    }
}

impl Order {
    /// The last part of its path.
    const fn name(&self) -> &'static str {
        match self {
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Cut => "cut",
            Self::Mode(_) => "mode",
            Self::Setpoint(_) => "setpoint",
        }
    }

    /// As HTTP would have it.
    fn body(&self) -> Vec<u8> {
        let text = match self {
            Self::Arm | Self::Disarm | Self::Cut => return Vec::new(),
            Self::Mode(mode) => serde_json::to_vec(mode),
            Self::Setpoint(setpoint) => serde_json::to_vec(setpoint),
        };
        text.unwrap_or_default()
    }

    /// Has the vehicle do it as `sender`, and writes down what came of it.
    pub(super) async fn carry_out(self, app: &App, vehicle: &str, sender: Sender) -> Answer {
        let Sender { name, role, from, way } = sender;
        let path = format!("/api/v1/vehicles/{vehicle}/{}", self.name());
        let body = redacted(&self.body());
        let outcome = if Access::Operate.open_to(role) {
            self.send(app, vehicle, Operator::new(name.clone(), &HeaderMap::new())).await
        } else {
            let (role, least) = (role.name(), Access::Operate.least().name());
            Err(ApiError::Foreign(format!("a {role} may not do this; it needs the role {least}")))
        };
        let status = outcome.as_ref().map_or_else(|error| error.kind().0, |_| StatusCode::OK);
        let deed = Deed {
            unix_us: wall_time_us(),
            who: name,
            role: role.name(),
            from,
            method: way.into(),
            path,
            body,
            status: status.as_u16(),
            times: 1,
        };
        if matches!(outcome, Err(ApiError::Foreign(_))) {
            app.audit.refuse(deed);
        } else {
            app.audit.record(deed);
        }
        outcome
    }

    async fn send(self, app: &App, vehicle: &str, operator: Operator) -> Answer {
        let (app, id) = (State(app.clone()), Path(vehicle.to_owned()));
        match self {
            Self::Arm => control::arm(app, id, operator).await,
            Self::Disarm => control::disarm(app, id, operator).await,
            Self::Cut => control::cut(app, id, operator).await,
            Self::Mode(mode) => control::mode(app, id, operator, Body(mode)).await,
            Self::Setpoint(setpoint) => setpoint::set(app, id, operator, Body(setpoint)).await,
        }
    }
}
