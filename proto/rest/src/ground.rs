//! What a ground is and whom it knows: `GET /api/v1/ground`, `GET /api/v1/vehicles`, `/api/v1/vehicles/{id}/lease`.

use serde::{Deserialize, Serialize};

/// `GET /api/v1/ground`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Ground {
    /// Its version.
    pub version: String,
    /// Version of the contract.
    pub schema: u32,
    /// Where it is reached.
    pub address: String,
    /// Since its start, s.
    pub uptime_s: f64,
    /// Where flights are kept.
    pub data_folder: String,
    /// How full that is.
    pub storage: Storage,
    /// Why nothing can be recorded.
    pub recording_error: Option<String>,
    /// Damaged files, by the names they were given.
    pub set_aside: Vec<String>,
    /// Agents refused for their certificates since the start.
    pub refused_peers: u64,
    /// Why the agents it trusts cannot be read.
    pub identity_error: Option<String>,
    /// Connections that ended before they said who they are.
    pub handshakes_broken_off: u64,
    /// What it shares with other grounds; absent where nothing is.
    pub fleet: Option<Box<Fleet>>,
}

/// What grounds share.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Fleet {
    /// What this ground is called among them.
    pub name: String,
    /// Where the files of flights are kept; absent where no archive is shared.
    pub archive: Option<String>,
    /// Where their index is.
    pub index: Option<String>,
    /// Flights of this ground that are not in the archive yet.
    pub waiting: u64,
    /// Why the archive is not reached.
    pub archive_error: Option<String>,
    /// Grounds whose vehicles are seen here; absent where no live view is shared.
    pub grounds: Option<Vec<String>>,
    /// Why they are not heard.
    pub live_error: Option<String>,
}

/// What the recordings take and leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Storage {
    /// Size of all flight files, bytes.
    pub used_bytes: u64,
    /// Free on their disk, bytes.
    pub free_bytes: u64,
    /// Flights.
    pub flights: u64,
}

/// One of `GET /api/v1/vehicles`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Vehicle {
    /// The agent's id.
    pub id: String,
    /// Is it connected now?
    pub connected: bool,
    /// The ground that it is connected to; absent where that is this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ground: Option<AtGround>,
    /// Changes with every start of the agent.
    pub boot_id: u64,
    /// Version of the agent.
    pub version: String,
    /// `sim`, `replay` or `hardware`.
    pub vehicle: String,
    /// Rig.
    pub rig: String,
    /// Mode; absent before the first status.
    pub mode: Option<String>,
    /// Armed? Absent before the first status.
    pub armed: Option<bool>,
}

/// Another ground.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct AtGround {
    /// What it is called.
    pub name: String,
    /// Where its page is, as it says itself; empty where it does not.
    pub address: String,
}

/// Who holds control of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Lease {
    /// Nobody where it is absent.
    pub holder: Option<String>,
    /// From whom it was taken just now.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken_from: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_that_has_said_nothing_yet_is_listed() {
        let text = r#"[{"id":"iris-1","connected":true,"boot_id":1,"mode":null,"armed":null,"new_field":1}]"#;
        let vehicles: Vec<Vehicle> = serde_json::from_str(text).unwrap();
        assert_eq!((vehicles[0].connected, vehicles[0].armed), (true, None));
    }
}
