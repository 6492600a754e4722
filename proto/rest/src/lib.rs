//! The contract of the HTTP API: what is asked and answered in JSON, once for ground, page and tests.
//!
//! What is asked refuses fields it does not know: a name misspelt is told, and changes nothing. What is answered takes
//! fields that are not there for their defaults: a page may be older or newer than its ground.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod calibration;
pub mod command;
pub mod design;
pub mod experiment;
pub mod flight;
pub mod ground;
pub mod people;

use serde::{Deserialize, Deserializer, Serialize};

/// The body of every error.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Refusal {
    /// A sentence with the offending value.
    pub error: String,
}

/// For optional numbers: `null` is not absence but a NaN that JSON swallowed.
fn number<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    <f64 as Deserialize>::deserialize(from).map(Some)
}
