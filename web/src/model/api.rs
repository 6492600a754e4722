//! The ground's JSON, as the page reads and writes it.

use serde::{Deserialize, Serialize};

/// `GET /api/ground`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Ground {
    /// Version of the ground.
    pub version: String,
    /// Version of the contract.
    pub schema: u32,
    /// Seconds since its start.
    pub uptime_s: f64,
    /// Where flights are kept.
    pub data_folder: String,
    /// How full that is.
    pub storage: Storage,
    /// Why nothing can be recorded.
    pub recording_error: Option<String>,
    /// Damaged files, by the names they were given.
    pub set_aside: Vec<String>,
}

/// `GET /api/session`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Session {
    /// Account that is signed in; `None` where none is needed.
    pub name: Option<String>,
    /// What it may do: viewer, operator, attacker or admin.
    pub role: Option<String>,
    /// Does it sign in by two steps?
    #[serde(default)]
    pub two_steps: bool,
}

/// An authenticator that is being set up.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct NewAuthenticator {
    /// To be typed, base 32.
    pub secret: String,
    /// To be opened by an authenticator on this device.
    pub url: String,
    /// To be scanned by one on another.
    pub svg: String,
}

impl Session {
    /// Who is signed in, as what; `None` where nobody needs to be.
    pub fn who(&self) -> Option<String> {
        let name = self.name.as_ref()?;
        Some(self.role.as_ref().map_or_else(|| name.clone(), |role| format!("{name} ({role})")))
    }
}

/// `GET /api/people`, and `GET /api/sessions` without accounts.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct People {
    /// Every account.
    pub accounts: Vec<Account>,
    /// Who is signed in.
    pub sessions: Vec<SignedIn>,
}

/// One account.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct Account {
    /// Name to sign in with.
    pub name: String,
    /// What it may do.
    pub role: String,
}

/// One session.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct SignedIn {
    /// By which it is ended.
    pub id: String,
    /// Whose.
    pub account: String,
    /// Address it began from.
    pub from: String,
    /// When it began, Unix time in s.
    pub begun_s: f64,
}

/// Storage of the ground.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Storage {
    /// Bytes of all flights.
    pub used_bytes: f64,
    /// Bytes left.
    pub free_bytes: f64,
    /// Flights kept.
    pub flights: u64,
}

/// One of `GET /api/vehicles`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Vehicle {
    /// The agent's id.
    pub id: String,
    /// Is it connected now?
    pub connected: bool,
    /// sim, replay or hardware.
    pub vehicle: String,
    /// Rig.
    pub rig: String,
    /// Mode, as JSON names it; absent before the first status.
    pub mode: Option<String>,
    /// Armed? Absent before the first status.
    pub armed: Option<bool>,
}

/// `GET /api/flights`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Flights {
    /// The flights.
    pub flights: Vec<Flight>,
    /// How full the storage is.
    pub storage: Storage,
}

/// A recorded flight.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Flight {
    pub id: String,
    pub name: Option<String>,
    pub notes: Option<String>,
    pub vehicle_id: String,
    pub vehicle: String,
    pub rig: String,
    pub airframe: String,
    pub seed: Option<u64>,
    pub agent_version: String,
    pub started_unix_us: u64,
    pub duration_s: f64,
    pub messages: u64,
    pub missing: u64,
    pub completeness: String,
    pub size_bytes: f64,
    pub tracking_rms_m: Option<f64>,
    pub steps: Vec<Step>,
    pub attacks: Vec<FlownAttack>,
    pub counts: std::collections::BTreeMap<String, u64>,
}

impl Flight {
    /// Its name, or the id where it has none.
    pub fn title(&self) -> &str {
        self.name.as_deref().filter(|n| !n.trim().is_empty()).unwrap_or(&self.id)
    }
}

/// One setpoint step of a flight.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Step {
    pub start_s: f64,
    pub from_m: f64,
    pub to_m: f64,
    pub rise_time_s: Option<f64>,
    pub overshoot_percent: Option<f64>,
    pub settling_time_s: Option<f64>,
    pub steady_error_m: Option<f64>,
    pub interrupted: bool,
}

/// One attack of a flight.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct FlownAttack {
    pub sensor: String,
    pub instance: u32,
    pub channel: String,
    pub kind: String,
    pub start_s: f64,
    pub duration_s: f64,
    pub magnitude: f64,
    pub phase: String,
}

/// `GET /api/flights/{id}/estimate`: a recording estimated again; columns of equal length.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Again {
    pub score: Score,
    pub time_s: Vec<f64>,
    pub altitude_m: Vec<Option<f32>>,
    pub roll_rad: Vec<Option<f32>>,
    pub pitch_rad: Vec<Option<f32>>,
    pub yaw_rad: Vec<Option<f32>>,
}

/// Root mean square errors against truth; absent where there is none.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Score {
    pub position_rmse_xyz_m: [Option<f64>; 3],
    pub velocity_rmse_xyz_mps: [Option<f64>; 3],
    pub heading_rmse_deg: Option<f64>,
    pub inclination_rmse_deg: Option<f64>,
    pub nees: Option<f64>,
    pub nees_states: Option<u32>,
}

/// The ground's answer to a command.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Answer {
    /// Number of the command.
    pub command_id: u64,
    /// accepted or rejected.
    pub stage: String,
    /// What was done, or why not.
    pub reason: String,
}

/// The body of any error.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Refusal {
    /// Text with the offending value.
    pub error: String,
    /// Some refusals are answers of the agent.
    pub reason: String,
}

/// One attack of a schedule, as `PUT …/attacks` wants it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct AttackBody {
    pub sensor: String,
    pub instance: u32,
    pub channel: String,
    pub kind: String,
    pub start_s: f64,
    pub duration_s: f64,
    pub magnitude: f64,
    pub seed: u64,
}

/// What to tell the operator about a failed request: the ground's own text where it gave one.
pub fn failure_text(status: u16, body: &str) -> String {
    let refusal: Refusal = serde_json::from_str(body).unwrap_or_default();
    if !refusal.error.is_empty() {
        return refusal.error;
    }
    if !refusal.reason.is_empty() {
        return refusal.reason;
    }
    match status {
        0 => "the ground station does not answer".to_owned(),
        423 => "another operator holds control".to_owned(),
        503 => "the vehicle is not connected".to_owned(),
        504 => "the vehicle did not answer within 2 s".to_owned(),
        other => format!("the ground answered {other}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_are_read_with_whatever_is_absent() {
        let text = r#"{"flights":[{"id":"a","name":"","duration_s":42.5,"completeness":"complete","seed":7,
            "steps":[{"start_s":1,"from_m":0.5,"to_m":0.8,"rise_time_s":null,"overshoot_percent":3.0}],
            "counts":{"/estimate/1":1234},"new_field":1}],"storage":{"used_bytes":10,"free_bytes":20,"flights":1}}"#;
        let flights: Flights = serde_json::from_str(text).unwrap();
        assert_eq!(flights.flights[0].title(), "a");
        assert_eq!(flights.flights[0].steps[0].rise_time_s, None);
        assert_eq!(flights.flights[0].counts["/estimate/1"], 1234);
    }

    #[test]
    fn a_vehicle_that_has_said_nothing_yet_is_listed() {
        let text = r#"[{"id":"iris-1","connected":true,"boot_id":1,"version":"","vehicle":"","rig":"","mode":null,"armed":null}]"#;
        let vehicles: Vec<Vehicle> = serde_json::from_str(text).unwrap();
        assert_eq!((vehicles[0].connected, vehicles[0].armed), (true, None));
    }

    #[test]
    fn failures_say_what_the_ground_said() {
        assert_eq!(
            failure_text(422, r#"{"error":"height 3.4 m above limit 2.0 m"}"#),
            "height 3.4 m above limit 2.0 m"
        );
        assert_eq!(
            failure_text(409, r#"{"command_id":3,"stage":"rejected","reason":"battery 13.1 V below 14.0 V"}"#),
            "battery 13.1 V below 14.0 V"
        );
        assert_eq!(failure_text(504, "<html>"), "the vehicle did not answer within 2 s");
        assert_eq!(failure_text(418, ""), "the ground answered 418");
    }
}
