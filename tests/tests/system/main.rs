//! The whole system through real sockets: both programs as processes, each test with its own.
//!
//! - [`altitude_step`]: the main job, an altitude step on the strings.
//! - [`attack_visible`]: an attack is scheduled, seen and aborted.
//! - [`record_download`]: a flight is recorded and downloaded.
//! - [`replay_exact`]: a flight file is flown again.
//! - [`stations`]: ground control stations of others fly the vehicle.
//! - [`live_stream`]: what viewers are told.
//! - [`trust`]: identities are revoked and changed in flight.
//! - [`packages`]: Debian packages, unpacked and started.
//! - [`bad_start`]: what cannot work says so.
//! - [`chaos`]: programs are killed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod altitude_step;
mod attack_visible;
mod bad_start;
mod chaos;
mod live_stream;
mod packages;
mod record_download;
mod replay_exact;
mod stations;
mod trust;
