//! Which flight a file belongs to, kept in the file itself as MCAP metadata, so that the index can
//! always be rebuilt from the files.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::Metadata;
use plumbline_file::METADATA;

use super::flight::Completeness;

/// Name of the record at the end of a finished file.
pub(super) const END: &str = "plumbline.end";

/// What a file says of itself at its beginning.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) flight_id: String,
    pub(super) agent_id: String,
    pub(super) boot_id: u64,
    pub(super) boot_wall_time_us: u64,
    /// `None` when the beginning of the flight was not seen.
    pub(super) first_sequence: Option<u64>,
}

impl Identity {
    /// What the file at `path` says; `None` when it does not.
    pub(super) fn of(path: &Path) -> Option<Self> {
        plumbline_file::metadata(path).map(|found| Self::from_metadata(&found))
    }

    pub(super) fn to_metadata(&self) -> Metadata {
        let mut metadata = BTreeMap::from([
            ("flight_id".to_owned(), self.flight_id.clone()),
            ("agent_id".to_owned(), self.agent_id.clone()),
            ("boot_id".to_owned(), self.boot_id.to_string()),
            ("boot_wall_time_us".to_owned(), self.boot_wall_time_us.to_string()),
            ("schema".to_owned(), plumbline_proto::SCHEMA.to_string()),
        ]);
        if let Some(first) = self.first_sequence {
            metadata.insert("first_sequence".to_owned(), first.to_string());
        }
        Metadata { name: METADATA.to_owned(), metadata }
    }

    pub(super) fn from_metadata(metadata: &BTreeMap<String, String>) -> Self {
        let text = |key: &str| metadata.get(key).cloned().unwrap_or_default();
        let number = |key: &str| metadata.get(key).and_then(|v| v.parse().ok());
        Self {
            flight_id: text("flight_id"),
            agent_id: text("agent_id"),
            boot_id: number("boot_id").unwrap_or(0),
            boot_wall_time_us: number("boot_wall_time_us").unwrap_or(0),
            first_sequence: number("first_sequence"),
        }
    }
}

/// What a file says at its end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Ending {
    pub(super) last_sequence: Option<u64>,
    pub(super) completeness: Completeness,
    pub(super) live: u64,
    pub(super) filled: u64,
}

impl Ending {
    pub(super) fn to_metadata(self) -> Metadata {
        let completeness = serde_json::to_value(self.completeness).ok();
        let mut metadata = BTreeMap::from([
            ("completeness".to_owned(), completeness.and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()),
            ("live".to_owned(), self.live.to_string()),
            ("filled".to_owned(), self.filled.to_string()),
        ]);
        if let Some(last) = self.last_sequence {
            metadata.insert("last_sequence".to_owned(), last.to_string());
        }
        Metadata { name: END.to_owned(), metadata }
    }

    pub(super) fn from_metadata(metadata: &BTreeMap<String, String>) -> Self {
        let number = |key: &str| metadata.get(key).and_then(|v| v.parse().ok());
        let completeness = metadata.get("completeness").cloned().map(serde_json::Value::String);
        Self {
            last_sequence: number("last_sequence"),
            completeness: completeness.and_then(|v| serde_json::from_value(v).ok()).unwrap_or(Completeness::Filling),
            live: number("live").unwrap_or(0),
            filled: number("filled").unwrap_or(0),
        }
    }
}

/// Gives the upper half back to a sequence number of which the file holds the low 32 bits: the one
/// nearest to `near`. Flights are shorter than 2³¹ messages.
pub(super) fn widen(low: u32, near: u64) -> u64 {
    let distance = low.wrapping_sub(near as u32) as i32;
    near.saturating_add_signed(i64::from(distance))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_survive_the_loss_of_their_upper_half() {
        for (sequence, near) in [(1, 1), (7_000_000_000, 6_999_999_000), ((1 << 32) + 5, (1 << 32) - 5), (3, 900)] {
            assert_eq!(widen(sequence as u32, near), sequence);
        }
    }

    #[test]
    fn identity_and_ending_round_trip() {
        let identity = Identity {
            flight_id: "f".into(),
            agent_id: "a".into(),
            boot_id: u64::MAX,
            boot_wall_time_us: 5,
            first_sequence: Some(9),
        };
        assert_eq!(Identity::from_metadata(&identity.to_metadata().metadata), identity);
        let ending = Ending { last_sequence: Some(10), completeness: Completeness::Truncated, live: 7, filled: 2 };
        assert_eq!(Ending::from_metadata(&ending.to_metadata().metadata), ending);
    }
}
