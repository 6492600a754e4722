//! What is computed of recordings and designs, on the ground as on the vehicle: no flight thread, no sockets, nothing
//! that is sent.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod recordings;

pub mod design;

pub mod envelope;

pub mod offline;
