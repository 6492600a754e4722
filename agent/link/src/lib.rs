//! The radio, as far as both of its ends need it: QUIC over mutually pinned TLS, identities, pairing by a short code,
//! framing of the reliable stream, and the greeting. What the agent's end alone does (reconnecting, pacing, backfill)
//! is `plumbline-agent`'s, and the ground's end is the ground's.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod hello;
pub mod identity;
pub mod pairing;
pub mod signing;
pub mod tls;
pub mod transport;
mod window;
