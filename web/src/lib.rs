//! The page of Plumbline.
//!
//! `model` is what the page knows (pure, tested natively), `gpu` draws on one canvas behind the page.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod gpu;
pub mod model;
