//! What the agent does with a simulated vehicle and with recordings.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod altitude;
mod attitude;
mod by_pose;
mod calibrated;
mod controllers;
mod ending;
mod envelope_check;
mod estimators;
mod failsafes;
mod gains;
mod gains_pushed;
mod headless_recording;
mod landings;
mod lanes;
mod losses;
mod random_walk;
mod recorded;
mod replay;
mod replay_commands;
mod secure;
mod simulator;
mod strategies;
mod tools;
mod ulog;
mod worlds;
