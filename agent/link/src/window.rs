//! Congestion windows for a radio, which loses packets without being full.
//!
//! *Telemetry*: a window of fixed size. It is held to its rate by the sender's own cap (`rate.rs`). A controller that
//! shrinks its window on loss makes live data stale on a lossy radio (measured: 757 ms at p99 with 30 % loss); this one
//! keeps sending what is fresh. The window only bounds the memory of unacknowledged packets: at least what the cap lets
//! out within the idle timeout, so that sending goes on through an outage and the first packet after it arrives at once.
//!
//! *Commands*: Cubic, which never falls below the window that it begins with. Its least window of two packets is full
//! after the first two that a fade swallows; then only QUIC's probes go out, each after twice the time of the one before
//! (RFC 9002, 6.2.1), and after a fade of some seconds the next one is as many seconds away. The first window has room
//! for the heartbeats of a whole idle timeout, so that one of them is under way as soon as the fade ends.

use std::any::Any;
use std::sync::Arc;
use std::time::Instant;

use quinn_proto::RttEstimator;
use quinn_proto::congestion::{Controller, ControllerFactory, CubicConfig};

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

/// Makes Cubic controllers that keep their first window.
#[derive(Debug, Clone, Copy, Default)]
pub struct CubicAboveFirst;

impl ControllerFactory for CubicAboveFirst {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(AboveFirst(Arc::new(CubicConfig::default()).build(now, current_mtu)))
    }
}

/// A controller whose window never falls below its first one.
struct AboveFirst(Box<dyn Controller>);

impl Controller for AboveFirst {
    fn on_sent(&mut self, now: Instant, bytes: u64, last_packet_number: u64) {
        self.0.on_sent(now, bytes, last_packet_number);
    }

    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, rtt: &RttEstimator) {
        self.0.on_ack(now, sent, bytes, app_limited, rtt);
    }

    fn on_end_acks(&mut self, now: Instant, in_flight: u64, app_limited: bool, largest_acked: Option<u64>) {
        self.0.on_end_acks(now, in_flight, app_limited, largest_acked);
    }

    fn on_congestion_event(&mut self, now: Instant, sent: Instant, persistent: bool, lost_bytes: u64) {
        self.0.on_congestion_event(now, sent, persistent, lost_bytes);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.0.on_mtu_update(new_mtu);
    }

    fn window(&self) -> u64 {
        self.0.window().max(self.0.initial_window())
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Self(self.0.clone_box()))
    }

    fn initial_window(&self) -> u64 {
        self.0.initial_window()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::transport::{HEARTBEAT_PERIOD, IDLE_TIMEOUT_MS};

    #[test]
    fn a_fade_leaves_room_for_the_heartbeats_of_a_whole_idle_timeout() {
        let begun = Instant::now();
        let mut cubic = Arc::new(CubicConfig::default()).build(begun, 1200);
        let mut kept = Arc::new(CubicAboveFirst).build(begun, 1200);
        for second in 1..9 {
            let now = begun + Duration::from_secs(second);
            for controller in [&mut cubic, &mut kept] {
                controller.on_congestion_event(now, now, true, 1200);
            }
        }
        // A heartbeat in a packet of its own, with the operator's sign of life beside it.
        let heartbeats = 120 * u64::from(IDLE_TIMEOUT_MS) / HEARTBEAT_PERIOD.as_millis() as u64;
        assert!(cubic.window() < heartbeats, "{} bytes are room enough by themselves", cubic.window());
        assert!(kept.window() >= heartbeats, "{} bytes of {heartbeats}", kept.window());
    }
}
