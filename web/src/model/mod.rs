//! What the page knows, apart from how it looks. Pure: everything here is tested natively.

pub mod api;
pub mod axis;
pub mod calibration;
pub mod clock;
pub mod configuration;
pub mod csv;
pub mod curves;
pub mod decimate;
pub mod draft;
pub mod envelope;
pub mod experiment;
pub mod format;
pub mod instrument;
pub mod listing;
pub mod live;
pub mod liveness;
pub mod measure;
pub mod names;
pub mod operator;
pub mod path;
pub mod report;
pub mod route;
pub mod series;
pub mod spans;
pub mod topic;
pub mod tuning;
