//! What a ground does, asked over its ports: one program, as one is linked faster than twenty.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod access;
mod api;
mod archive;
mod by_hand;
mod calibrations;
mod commands;
mod common;
mod design;
mod envelope;
mod experiments;
mod export;
mod fade;
#[cfg(feature = "many")]
mod fleet;
mod flights;
mod foxglove;
mod import;
mod live;
mod live_agent;
mod log;
#[cfg(feature = "many")]
mod many;
mod mavlink;
mod origin;
mod recording;
mod repair;
