//! What systemd is told, where it started this agent.

use std::sync::Arc;

use plumbline_agent::link::clock::FlightClock;
use sd_notify::NotifyState;

/// Says that the agent flies, and from then on, three times in what systemd allows, that its ticks go on. One whose flight thread stands
/// is started anew; its motors have stopped by themselves long before.
pub(super) fn serving(clock: Arc<FlightClock>) {
    tell(NotifyState::Ready);
    let Some(limit) = sd_notify::watchdog_enabled() else { return };
    let watch = move || {
        let mut seen = clock.last_tick();
        loop {
            std::thread::sleep(limit / 3);
            let newest = clock.last_tick();
            if newest != seen {
                tell(NotifyState::Watchdog);
            }
            seen = newest;
        }
    };
    if let Err(error) = std::thread::Builder::new().name("systemd".into()).spawn(watch) {
        tracing::warn!(%error, "no thread for systemd's watchdog");
    }
}

fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "systemd is not reached");
    }
}
