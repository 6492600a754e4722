//! Lets the recorder's retention look at the flights now and then, and writes down what it says and does.

use std::sync::Arc;

use plumbline_rest::flight::Due;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};

use crate::audit::{Audit, Deed};
use crate::recorder::archive::Pruner;
use crate::sync::{stopping, wall_time_us};

/// Runs until the ground stops.
pub(crate) async fn run(pruner: Arc<Pruner>, audit: Audit, mut stopped: watch::Receiver<bool>) {
    let mut look = interval(pruner.every());
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = look.tick() => {}
            () = stopping(&mut stopped) => return,
        }
        let pruner = pruner.clone();
        match tokio::task::spawn_blocking(move || pruner.pass(wall_time_us())).await {
            Ok(Ok((told, deleted))) => {
                told.iter().for_each(|due| say(&audit, due, "DUE", 202));
                deleted.iter().for_each(|due| say(&audit, due, "DELETE", 204));
            }
            Ok(Err(error)) => tracing::error!(%error, "retention"),
            Err(error) => tracing::error!(%error, "retention"),
        }
    }
}

fn say(audit: &Audit, due: &Due, method: &str, status: u16) {
    tracing::warn!(flight = due.id, why = due.why, bytes = due.bytes, "retention: {method}");
    audit.record(Deed {
        unix_us: wall_time_us(),
        who: "retention".into(),
        role: "ground",
        from: String::new(),
        method: method.into(),
        path: format!("/api/v1/flights/{}", due.id),
        body: due.why.clone(),
        status,
        times: 1,
    });
}
