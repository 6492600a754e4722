//! H∞ mixed sensitivity (\[Strategies\]): weights, synthesis, reduction, and the controller that flies.
//!
//! [`strategies`] is the design of the source by the recipe that works: 20 states, and 16 after one fast pole
//! of each channel is residualised. [`flight`] is what the vehicle flies: the same synthesis on the double
//! integrators of angles and positions.

pub mod flight;
pub mod reduction;
pub mod strategies;
pub mod synthesis;
pub mod weights;

pub use flight::{DEFAULTS, Hinf, PARAMETERS};
