//! A thread beside the flight thread, which hands it work through a queue, wakes it, and never waits for it.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// The thread; it is told to end, and waited for, when this is dropped.
#[derive(Debug)]
pub(super) struct Worker {
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Is the thread to go on? What it does between two looks is finished.
#[derive(Debug, Clone)]
pub(super) struct Going(Arc<AtomicBool>);

impl Going {
    /// Yes, until the worker is dropped.
    pub(super) fn on(&self) -> bool {
        !self.0.load(Ordering::Acquire)
    }

    /// Sleeps until it is woken, or told to end. A wake since the last look into a queue is not lost: this returns at once.
    pub(super) fn sleep(&self) {
        std::thread::park();
    }
}

impl Worker {
    /// Starts the thread `name`, to do `work`.
    ///
    /// # Errors
    /// No thread could be started.
    pub(super) fn start(name: &str, work: impl FnOnce(Going) + Send + 'static) -> io::Result<Self> {
        let ended = Arc::new(AtomicBool::new(false));
        let going = Going(ended.clone());
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || work(going))?;
        Ok(Self { ended, thread: Some(thread) })
    }

    /// There is work.
    pub(super) fn wake(&self) {
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        self.wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
