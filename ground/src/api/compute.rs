//! Computations that take long: in turn, off the threads that answer everybody, and given up when nobody waits for them.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::Semaphore;

use super::error::ApiError;

/// So many computations at a time; more wait.
const COMPUTING: usize = 2;

/// The turns.
#[derive(Debug)]
pub(crate) struct Turns(Arc<Semaphore>);

/// Says whether anybody still waits for the outcome.
#[derive(Debug, Clone, Default)]
pub(crate) struct Waited(Arc<AtomicBool>);

/// Held by the request; its end is the end of the waiting.
struct Request(Waited);

impl Drop for Request {
    fn drop(&mut self) {
        self.0.0.store(true, Ordering::Release);
    }
}

impl Waited {
    /// # Errors
    /// The request has gone away.
    pub(crate) fn check(&self) -> Result<(), ApiError> {
        if self.0.load(Ordering::Acquire) {
            return Err(ApiError::Unavailable("nobody waits for the answer any more".into()));
        }
        Ok(())
    }

    /// `inner`, until the request goes away.
    pub(crate) fn reading<R: Read>(&self, inner: R) -> impl Read + use<R> {
        Reading(self.clone(), inner)
    }
}

struct Reading<R>(Waited, R);

impl<R: Read> Read for Reading<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.check().map_err(|_| io::Error::from(io::ErrorKind::ConnectionAborted))?;
        // Small bites, so that the end is noticed.
        let bite = buffer.len().min(1 << 16);
        self.1.read(buffer.get_mut(..bite).unwrap_or_default())
    }
}

impl Turns {
    pub(crate) fn new() -> Self {
        Self(Arc::new(Semaphore::new(COMPUTING)))
    }

    /// Waits for a turn, then does `work`, which is told when the request has gone away. The turn lasts as long as the
    /// work, whether anybody waits for it or not.
    ///
    /// # Errors
    /// Those of `work`.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Waited) -> Result<T, ApiError> + Send + 'static,
    ) -> Result<T, ApiError> {
        self.after(async { Ok(()) }, |(), waited| work(waited)).await
    }

    /// The same for work that needs something large first, which is fetched within the turn.
    ///
    /// # Errors
    /// Those of `fetch` and `work`.
    pub(crate) async fn after<B: Send + 'static, T: Send + 'static>(
        &self,
        fetch: impl Future<Output = Result<B, ApiError>>,
        work: impl FnOnce(B, &Waited) -> Result<T, ApiError> + Send + 'static,
    ) -> Result<T, ApiError> {
        let turn = self.0.clone().acquire_owned().await;
        let turn = turn.map_err(|_| ApiError::Unavailable("the ground is stopping".into()))?;
        let fetched = fetch.await?;
        let request = Request(Waited::default());
        let waited = request.0.clone();
        let done = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            work(fetched, &waited)
        });
        let done = done.await;
        drop(request);
        done.map_err(|error| ApiError::Broken(error.to_string()))?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn work_ends_with_its_request_and_keeps_its_turn_until_then() {
        let turns = Turns::new();
        let (begun, mut running) = tokio::sync::mpsc::unbounded_channel();
        let endless = move |waited: &Waited| {
            begun.send(()).unwrap();
            loop {
                waited.check()?;
                std::thread::yield_now();
            }
        };
        // GIVEN as many endless computations as there are turns
        let mut abandoned = Box::pin(async {
            let both = futures_util::future::join(turns.run::<()>(endless.clone()), turns.run::<()>(endless.clone()));
            both.await
        });
        tokio::select! {
            _ = &mut abandoned => unreachable!(),
            () = async { for _ in 0..COMPUTING { running.recv().await.unwrap() } } => {}
        }
        assert_eq!(turns.0.available_permits(), 0);
        // WHEN their requests go away THEN they end, and the next one has its turn
        drop(abandoned);
        assert_eq!(turns.run(|_| Ok(7)).await.unwrap(), 7);
    }
}
