//! What goes wrong with a device: of one frame, and of the device as a whole.

use plumbline_core::event::Text;

/// Why one frame is given up. The stream goes on.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The sum over the frame is another one.
    #[error("checksum {got:#x} instead of {expected:#x}")]
    Checksum {
        /// As computed.
        expected: u32,
        /// As sent.
        got: u32,
    },
    /// The frame is shaped otherwise than its kind.
    #[error("malformed {0}")]
    Malformed(&'static str),
    /// A value no such device can mean.
    #[error("{what} {value} is not {expected}")]
    Value {
        /// The quantity.
        what: &'static str,
        /// The offending value.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// It carries no signature made with the configured key, or one that was used before.
    #[error("not signed with the configured key")]
    Unsigned,
    /// The device does not send this message as often as it was asked to.
    #[error("the device refuses the interval of {what}, result {code}")]
    Refused {
        /// The message.
        what: &'static str,
        /// Its MAV_RESULT.
        code: u32,
    },
    /// The device says nothing to what was asked.
    #[error("the device does not answer for the interval of {what}")]
    Unanswered {
        /// The message.
        what: &'static str,
    },
    /// The device itself reports an error.
    #[error("the device reports {what} {code}")]
    Reported {
        /// What sort of error.
        what: &'static str,
        /// Its code.
        code: u32,
    },
}

/// Why a device cannot be used now. Its reader closes it and tries again.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The port.
    #[error("{port}: {source}")]
    Port {
        /// Its name.
        port: String,
        /// Cause.
        source: std::io::Error,
    },
    /// Something else answers, or it is set up otherwise.
    #[error("{what} is {value}, not {expected}")]
    Wrong {
        /// What was asked.
        what: &'static str,
        /// The answer.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
    /// Others are there, and not the one that is configured.
    #[error("system {wanted} is silent; system {heard} is heard")]
    Stranger {
        /// As configured.
        wanted: u8,
        /// Who speaks instead.
        heard: u32,
    },
    /// Nothing that makes sense came.
    #[error("no {what} within {seconds:.2} s")]
    Silent {
        /// What was waited for.
        what: &'static str,
        /// How long.
        seconds: f64,
    },
    /// A frame that matters could not be read.
    #[error(transparent)]
    Frame(#[from] Fault),
}

impl DeviceError {
    /// The reason, short enough for an event.
    pub fn text(&self) -> Text {
        plumbline_core::event::text(format_args!("{self}"))
    }
}
