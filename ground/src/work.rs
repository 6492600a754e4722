//! Threads for whatever may take long: reading flights, passwords, previews, estimates, lists.
//!
//! The threads that serve connections, the link and the commands do nothing else. Everything that computes or waits for
//! a disk is done here, with less claim to the processor: a motor cut never waits behind it.

use std::time::Duration;

use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio_util::task::AbortOnDropHandle;
use tracing::Instrument as _;

use crate::api::ApiError;
use crate::sync::give_way;

/// Threads that run the handlers.
const THREADS: usize = 2;
/// Most threads that wait for a disk or compute; what needs more waits for its turn.
const BLOCKING: usize = 64;
/// A thread without work ends after this long.
const IDLE: Duration = Duration::from_secs(10);

/// The threads; they end, without waiting, with it.
#[derive(Debug)]
pub(crate) struct Work(Option<Runtime>);

impl Work {
    /// # Errors
    /// No threads.
    pub(crate) fn start() -> std::io::Result<Self> {
        let mut threads = Builder::new_multi_thread();
        threads.worker_threads(THREADS).max_blocking_threads(BLOCKING).thread_keep_alive(IDLE);
        threads.thread_name("work").on_thread_start(give_way).enable_all();
        threads.build().map(|runtime| Self(Some(runtime)))
    }

    /// Where to spawn.
    pub(crate) fn handle(&self) -> Handle {
        self.0.as_ref().map_or_else(Handle::current, |runtime| runtime.handle().clone())
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

/// Answers a request on these threads; ends with the request.
pub(crate) async fn there(State(threads): State<Handle>, request: Request, next: Next) -> Response {
    let answer = AbortOnDropHandle::new(threads.spawn(next.run(request).in_current_span()));
    answer.await.unwrap_or_else(|error| ApiError::Broken(error.to_string()).into_response())
}
