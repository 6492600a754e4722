//! What the page knows, apart from how it looks. Pure: everything here is tested natively.

pub mod axis;
pub mod decimate;
pub mod series;
