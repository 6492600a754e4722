//! Everything that can happen to the page's state. Closed: what is not here cannot happen.

use plumbline_rest::command::Answer;
use plumbline_rest::ground::{Ground, Vehicle};

use crate::model::live::Live;

/// Why a request failed.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// HTTP status; 0 when the ground did not answer at all.
    pub status: u16,
    /// What to tell the operator.
    pub text: String,
}

/// One thing that happened.
#[derive(Debug)]
pub enum Event {
    /// Time to ask the ground for its state.
    Poll,
    /// What the ground says of itself.
    Ground(Result<Ground, Failure>),
    /// The vehicles it knows.
    Vehicles(Result<Vec<Vehicle>, Failure>),
    /// The operator chose a vehicle.
    Choose(String),
    /// The live socket opened.
    SocketOpened,
    /// It closed, or could not open.
    SocketClosed,
    /// Time to try again.
    Reconnect,
    /// A batch of messages, at a time of the browser's monotonic clock, ms.
    Batch(Vec<u8>, f64),
    /// The past of this vehicle, so many seconds of it, read.
    History(String, f64, Box<Live>),
    /// The ground answered a command.
    Answered(String, Result<Answer, Failure>),
    /// Something to tell the operator.
    Tell(Tone, String),
    /// A notice was read, or is old.
    Dismiss(u64),
}

/// How loud a notice is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tone {
    /// Done as asked.
    Done,
    /// Worth knowing.
    Info,
    /// Not done, or wrong.
    Error,
}

/// What the runtime has to do after an update.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// Ask for `/api/v1/ground` and `/api/v1/vehicles`.
    FetchState,
    /// Open the live socket of this vehicle.
    OpenSocket(String),
    /// Ask for so much of its history, s.
    FetchHistory(String, f64),
    /// Send `Event::Reconnect` in so many ms.
    RetryIn(u32),
    /// Remember the chosen vehicle for a reload.
    Remember(String),
    /// Send `Event::Dismiss` for this notice in so many ms.
    DismissIn(u64, u32),
}
