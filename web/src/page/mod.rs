//! The pages: each arranges panels.

mod calibrate;
mod compare;
mod experiments;
pub mod flight;
pub mod flights;
mod fly;
mod help;
mod numbers;
mod people;
mod setup;
mod tune;

pub use calibrate::Calibrate;
pub use compare::Compare;
pub use experiments::ExperimentsPage;
pub use flight::{FlightPage, ReportPage};
pub use flights::FlightsPage;
pub use fly::Fly;
pub use help::Help;
pub use setup::Setup;
pub use tune::Tune;
