//! What the page's shaders do, by the processor, for machines without a graphics card: a browser's emulation of one takes longer and has
//! to be waited for.
//!
//! The page writes what a frame is made of on a [`Sheet`]: triangles, by panel, as words. The page's worker has [`draw`] make each
//! panel a [`Tile`] of pixels. Neither knows a browser.

mod sheet;
mod tile;
mod vertex;

pub use sheet::{Ground, Panel, Sheet, draw};
pub use tile::{Depths, Tile};
pub use vertex::{Flat, INSIDE, Solid, View};
