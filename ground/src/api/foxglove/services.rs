//! Services of the protocol: mode, setpoint and cut, done as HTTP does them ([`Order`]): role, lease, acknowledgement, audit log.
//!
//! Requests and answers are JSON of the same types and schemas. Each call has a task of its own, so that a cut waits behind nothing;
//! how many there may be is the bound of commands.

use plumbline_rest::command::{Answer, Mode, Setpoint};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use utoipa::PartialSchema;

use super::super::App;
use super::super::error::ApiError;
use super::super::order::{Order, Sender};
use super::client;
use crate::people::SessionKey;
use axum::extract::ws::Message;

/// One service: its number, its name, what it is asked, and the command that comes of it.
struct Service {
    id: u32,
    name: &'static str,
    request: fn() -> Value,
    order: fn(&[u8]) -> Result<Order, serde_json::Error>,
}

const SERVICES: [Service; 3] = [
    Service { id: 1, name: "mode", request: schema::<Mode>, order: |text| Ok(Order::Mode(read(text)?)) },
    Service { id: 2, name: "setpoint", request: schema::<Setpoint>, order: |text| Ok(Order::Setpoint(read(text)?)) },
    Service { id: 3, name: "cut", request: nothing, order: |_| Ok(Order::Cut) },
];

fn read<T: DeserializeOwned>(text: &[u8]) -> Result<T, serde_json::Error> {
    serde_json::from_slice(text)
}

/// A cut is asked nothing, and refused for no odd request.
fn nothing() -> Value {
    json!({ "type": "object", "properties": {} })
}

/// The schema of a type of the HTTP API. Fields that may be left out are told by `required` alone: Foxglove reads one type for each.
fn schema<T: PartialSchema>() -> Value {
    let mut schema = json!(T::schema());
    for field in schema["properties"].as_object_mut().into_iter().flat_map(|fields| fields.values_mut()) {
        let kinds = field["type"].as_array().cloned().unwrap_or_default();
        if let Some(kind) = kinds.into_iter().find(|kind| kind != "null") {
            field["type"] = kind;
        }
    }
    schema
}

/// What a client is told of them.
pub(super) fn advertise() -> Message {
    let typed = |name: &str, mut schema: Value| {
        schema["title"] = name.into();
        json!({ "encoding": "json", "schemaName": name, "schemaEncoding": "jsonschema", "schema": schema.to_string() })
    };
    let services = SERVICES.map(|service| {
        let kind = format!("plumbline.{}", service.name);
        let (request, response) = (typed(&kind, (service.request)()), typed("plumbline.answer", schema::<Answer>()));
        // Older clients, such as Foxglove Studio 1.48, read the schemas alone.
        json!({ "id": service.id, "name": service.name, "type": kind, "requestSchema": request["schema"],
            "responseSchema": response["schema"], "request": request, "response": response })
    });
    client::text(&json!({ "op": "advertiseServices", "services": services }))
}

/// Who calls.
#[derive(Clone)]
pub(super) struct Caller {
    pub(super) app: App,
    pub(super) vehicle: String,
    /// Account, or what it calls itself where nobody signs in.
    pub(super) name: String,
    pub(super) session: Option<SessionKey>,
    /// Address.
    pub(super) from: String,
}

impl Caller {
    /// Does what a call asks; the message that answers it.
    pub(super) async fn call(&self, call: client::Call) -> Message {
        match self.answer(&call).await {
            Ok(answer) => client::answered(&call, &serde_json::to_vec(&answer).unwrap_or_default()),
            Err(error) => client::failed(&call, &error.text()),
        }
    }

    async fn answer(&self, call: &client::Call) -> Result<Answer, ApiError> {
        let service = SERVICES.iter().find(|service| service.id == call.service);
        let service = service.ok_or_else(|| ApiError::NotFound(format!("there is no service {}", call.service)))?;
        if call.encoding != "json" && service.name != "cut" {
            let encoding = crate::names::clip(&call.encoding);
            return Err(ApiError::Invalid(format!("encoding {encoding:?} is not taken: json is")));
        }
        let order = (service.order)(&call.payload).map_err(|e| ApiError::Invalid(format!("{}: {e}", service.name)))?;
        // The role as it is now: it may have changed since the socket was opened.
        let person = self.app.people.person_of(self.session.as_ref());
        let role = person.ok_or_else(|| ApiError::SignIn("sign in first".into()))?.role;
        let sender = Sender { name: self.name.clone(), role, from: self.from.clone(), way: "FOXGLOVE" };
        Ok(order.carry_out(&self.app, &self.vehicle, sender).await?.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_service_says_what_it_takes_with_one_type_for_each_field() {
        let Message::Text(text) = advertise() else { panic!("text") };
        let told: Value = serde_json::from_str(&text).unwrap();
        let services = told["services"].as_array().unwrap();
        assert_eq!(
            services.iter().map(|s| s["name"].as_str().unwrap()).collect::<Vec<_>>(),
            ["mode", "setpoint", "cut"]
        );
        for service in services {
            for side in ["request", "response"] {
                let schema: Value = serde_json::from_str(service[side]["schema"].as_str().unwrap()).unwrap();
                let fields = schema["properties"].as_object().unwrap();
                assert!(fields.values().all(|field| field["type"].is_string()), "{schema}");
                assert!(service["name"] != "setpoint" || side != "request" || fields["altitude_m"]["type"] == "number");
            }
        }
    }
}
