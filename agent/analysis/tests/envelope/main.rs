//! Attack envelopes: bounds, attacks, tables.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod attacks;
mod bounds;
mod table;
