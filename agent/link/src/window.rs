//! A congestion controller that does not control: a window of fixed size.
//!
//! Telemetry is held to its rate by the sender's own cap (`rate.rs`). A controller that shrinks its
//! window on loss makes live data stale on a lossy radio (measured: 757 ms at p99 with 30 % loss);
//! this one keeps sending what is fresh. The window only bounds the memory of unacknowledged
//! packets: at least what the cap lets out within the idle timeout, so that sending goes on through
//! an outage and the first packet after it arrives at once.

use std::any::Any;
use std::sync::Arc;
use std::time::Instant;

use quinn_proto::RttEstimator;
use quinn_proto::congestion::{Controller, ControllerFactory};

/// Makes [`FixedWindow`]s of this many bytes.
#[derive(Debug, Clone, Copy)]
pub struct FixedWindowFactory(pub u64);

impl ControllerFactory for FixedWindowFactory {
    fn build(self: Arc<Self>, _now: Instant, _current_mtu: u16) -> Box<dyn Controller> {
        Box::new(FixedWindow(self.0))
    }
}

/// Bytes that may be in flight, whatever happens.
#[derive(Debug, Clone, Copy)]
struct FixedWindow(u64);

impl Controller for FixedWindow {
    fn on_ack(&mut self, _now: Instant, _sent: Instant, _bytes: u64, _app_limited: bool, _rtt: &RttEstimator) {}

    fn on_congestion_event(&mut self, _now: Instant, _sent: Instant, _persistent: bool, _lost_bytes: u64) {}

    fn on_mtu_update(&mut self, _new_mtu: u16) {}

    fn window(&self) -> u64 {
        self.0
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(*self)
    }

    fn initial_window(&self) -> u64 {
        self.0
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
