//! The contract between agent, ground and page.
//!
//! Messages are protobuf ([`v1`], generated from `schema/`). A message is encoded once, on the
//! agent, and travels as the payload of a [`codec::Frame`]: into the onboard log, over the radio,
//! into the flight file and on to the browser.
//!
//! # Versions
//! [`SCHEMA`] is carried by every handshake and every batch of frames.
//! - Adding a field, an enum value or a [`Kind`] keeps the number: old readers skip what they do
//!   not know ([`Kind::from_wire`] answers `None`, the frame survives).
//! - Removing or renumbering a field, or changing a unit, a frame or the frame header, bumps it.
//!   Peers with different numbers refuse each other, naming both.
//! - A flight file embeds its own descriptors, so files of every schema stay readable.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod codec;
pub mod descriptor;
mod error;
pub mod ids;
mod kind;
pub mod limits;
mod names;
pub mod thinning;
pub mod time;

pub use error::DecodeError;
pub use kind::Kind;

/// Version of the contract. See the module documentation for when it is bumped.
pub const SCHEMA: u8 = 1;

/// The generated messages, package `plumbline.v1`. Their documentation is in `schema/`.
#[allow(missing_docs, clippy::all, clippy::pedantic)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/plumbline.v1.rs"));
}

/// Re-exported so that users of the messages encode and decode with the same `prost`.
pub use prost::Message;
