//! The whole system as a user has it: real binaries, real sockets, port 0.
//!
//! [`System::start`] gives a ground and a simulated (or replayed) vehicle, paired with each other, in a data folder of
//! their own; [`System::stop`] ends both as Ctrl-C would. `cargo xtask run` stands on the same pieces.

pub mod binaries;
pub mod http;
pub mod process;
pub mod radio;
pub mod system;

pub use binaries::Binaries;
pub use http::{Api, Reply};
pub use process::Process;
pub use radio::{Faults, Radio};
pub use system::{Agent, Ground, Options as SystemOptions, System, Vehicle, address_after, wait_until};
