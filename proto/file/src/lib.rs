//! A flight file (MCAP, with the messages of the downlink) as those who write and read one share it: the onboard log, the
//! ground's recorder and whoever analyses a recording.
//!
//! A table of them, or of many flights, is a Parquet file: [`parquet`].
//!
//! Nothing here reads without bound or panics, whatever the bytes.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod chunk;
mod ends;
pub mod parquet;
mod space;
mod sync;
mod whole;

pub use chunk::{MAX_RECORD, chunk_records};
pub use ends::{METADATA, ends_with_magic, metadata};
pub use space::free_bytes;
pub use sync::{SyncedFile, Syncer};
pub use whole::write_atomically;
