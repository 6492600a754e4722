//! The contract of the HTTP API: what is asked and answered in JSON, once for ground, page and tests.
//!
//! What is asked refuses fields it does not know: a name misspelt is told, and changes nothing. What is answered takes
//! fields that are not there for their defaults: a page may be older or newer than its ground.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod calibration;
pub mod command;
pub mod design;
pub mod envelope;
pub mod experiment;
pub mod flight;
pub mod ground;
pub mod people;

use serde::{Deserialize, Deserializer, Serialize};

/// The body of every error, `application/problem+json` (RFC 9457): [`Problem::code`] is stable, [`Problem::detail`] is
/// for people.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Problem {
    /// `about:blank`: the status says what kind of problem it is.
    #[serde(rename = "type")]
    pub kind: String,
    /// What the status means.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// A sentence with the offending value.
    pub detail: String,
    /// For programs: `not_found`, `invalid`, `held`, `rejected` …
    pub code: String,
    /// Who holds control, where that is the problem.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub holder: Option<String>,
    /// Number of the command that the vehicle rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command_id: Option<u64>,
    /// Number of the gains that the vehicle rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revision: Option<u32>,
}

/// For optional numbers: `null` is not absence but a NaN that JSON swallowed.
fn number<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    <f64 as Deserialize>::deserialize(from).map(Some)
}
