//! What devices say: recorded bytes, data sheets' own examples, peers' implementations, and garbage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../../analysis/src/recordings/shared.rs"]
#[allow(dead_code)]
mod shared;

mod protocols;
