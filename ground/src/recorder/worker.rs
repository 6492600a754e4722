//! The recorder's thread.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;

use super::{Input, Shared};
use crate::config::GroundConfig;

pub(super) struct Worker {
    #[allow(dead_code)]
    config: GroundConfig,
    shared: Arc<Shared>,
}

impl Worker {
    pub(super) fn new(config: GroundConfig, shared: Arc<Shared>) -> Self {
        Self { config, shared }
    }

    pub(super) fn run(self, inputs: &Receiver<Input>) {
        while let Ok(input) = inputs.recv() {
            match input {
                Input::Batch { batch, .. } => {
                    self.shared.queued_bytes.fetch_sub(batch.len(), Ordering::Relaxed);
                }
                Input::Finish => break,
                _ => {}
            }
        }
    }
}
