//! The one task that takes the agents' events, in order, and hands each to hub, recorder and
//! commands. It never waits for any of them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_proto::{Kind, v1};
use tokio::sync::{mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};

use crate::agent_link::LinkEvent;
use crate::commands::Commands;
use crate::hub::{FLUSH_EVERY, Hub};
use crate::lease::{Leases, PAGE_GONE};
use crate::people::People;
use crate::recorder::RecorderHandle;
use crate::sync::{stopping, wall_time_us};

/// How often the recording's state is sent to the page; the link's is made for each viewer.
const STATUS_EVERY: Duration = Duration::from_millis(250);

/// What the events are handed to.
pub(crate) struct Ground {
    pub(crate) hub: Arc<Hub>,
    pub(crate) commands: Arc<Commands>,
    pub(crate) leases: Arc<Leases>,
    pub(crate) people: Arc<People>,
    pub(crate) recorder: RecorderHandle,
    /// Control unused for this long is given up.
    pub(crate) lease_idle: Duration,
}

pub(crate) async fn run(mut link: mpsc::Receiver<LinkEvent>, ground: Ground, mut stopped: watch::Receiver<bool>) {
    let Ground { hub, commands, leases, people, recorder, lease_idle } = ground;
    let mut flush = interval(FLUSH_EVERY);
    flush.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut status = interval(STATUS_EVERY);
    status.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut link_open = true;
    loop {
        tokio::select! {
            event = link.recv(), if link_open => match event {
                Some(event) => take(event, &hub, &commands, &recorder),
                None => link_open = false,
            },
            _ = flush.tick() => hub.flush(),
            _ = status.tick() => {
                publish_recordings(&hub, &recorder);
                hub.expire(Instant::now());
                for (vehicle, holder) in leases.expire(lease_idle, PAGE_GONE, |holder| people.may_command(holder)) {
                    tracing::info!(%vehicle, %holder, "control ended: unused, the page closed, or its holder may no more");
                    publish_lease(&hub, &leases, &vehicle, "");
                }
            }
            () = recorder.changed() => publish_recordings(&hub, &recorder),
            () = stopping(&mut stopped) => break,
        }
    }
    // What is already here is recorded before the files are finished.
    while let Ok(event) = link.try_recv() {
        take(event, &hub, &commands, &recorder);
    }
    hub.flush();
}

fn take(event: LinkEvent, hub: &Hub, commands: &Commands, recorder: &RecorderHandle) {
    match event {
        LinkEvent::Connected { agent_id, boot_id, boot_wall_time_us, version, commands } => {
            tracing::info!(%agent_id, boot_id, %version, "agent connected");
            hub.connected(&agent_id, boot_id, boot_wall_time_us, &version, commands.clone());
            recorder.connected(agent_id, boot_id, boot_wall_time_us, commands);
        }
        LinkEvent::Batch { agent_id, batch, received: _, backfill } => {
            if !backfill {
                hub.batch(&agent_id, &batch).into_iter().for_each(|ack| commands.resolve(&agent_id, ack));
            }
            recorder.batch(agent_id, batch, backfill);
        }
        LinkEvent::BackfillUnavailable { agent_id, request } => recorder.unavailable(agent_id, request),
        LinkEvent::Stats { agent_id, round_trip_ms, clock_offset_us } => {
            hub.stats(&agent_id, round_trip_ms, clock_offset_us);
        }
        LinkEvent::Disconnected { agent_id, reason } => {
            tracing::warn!(%agent_id, %reason, "agent disconnected");
            hub.disconnected(&agent_id);
            recorder.disconnected(agent_id);
        }
    }
}

/// Tells every viewer who holds control of `vehicle`, and who lost it to them.
pub(crate) fn publish_lease(hub: &Hub, leases: &Leases, vehicle: &str, taken_from: &str) {
    let holder = leases.holder(vehicle).unwrap_or_default();
    let lease = v1::ControlLease { wall_time_us: wall_time_us(), holder, taken_from: taken_from.to_owned() };
    hub.publish(vehicle, Kind::Lease, &lease);
}

fn publish_recordings(hub: &Hub, recorder: &RecorderHandle) {
    for id in hub.ids().into_iter().filter(|id| hub.ground_of(id).is_none()) {
        let mut status = recorder.status(&id);
        status.wall_time_us = wall_time_us();
        hub.publish(&id, Kind::Recording, &status);
    }
}
