//! The ground server: records flights, passes commands, serves the page.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod agent_link;
