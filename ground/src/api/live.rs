//! `GET /api/vehicles/{id}/live`: a WebSocket of codec batches.
//!
//! First the latest of every topic and the history, then live batches, each at most 10 ms old when
//! it leaves the hub. A viewer that stops reading fills its own queue ([`ViewerQueue`]), loses the
//! oldest, sees the count in its `LinkStatus`, and is closed after [`STALLED`].
//!
//! [`ViewerQueue`]: crate::hub::ViewerQueue

use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Query, State};
use axum::response::Response;
use plumbline_proto::{Kind, Message as _, codec, v1};
use serde::Deserialize;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::App;
use super::error::ApiError;
use super::operator::Operator;
use crate::hub::{MAX_HISTORY_SECONDS, Viewer, ViewerQueue};
use crate::sync::stopping;

/// A viewer that takes nothing for this long is closed.
const STALLED: Duration = Duration::from_secs(30);
/// How often the state of the link is sent.
const LINK_EVERY: Duration = Duration::from_millis(250);
/// Viewers have nothing to say but that they are there.
const MAX_INCOMING: usize = 4096;

#[derive(Deserialize)]
pub(crate) struct Asked {
    #[serde(default)]
    history: f64,
    /// What the page calls itself, where nobody signs in: a browser sends no headers of ours here.
    operator: Option<String>,
}

pub(crate) async fn live(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
    who: Operator,
    upgrade: WebSocketUpgrade,
) -> Result<Response, ApiError> {
    if !asked.history.is_finite() || asked.history < 0.0 {
        return Err(ApiError::Invalid(format!("history {} is not a number of seconds", asked.history)));
    }
    let history = Duration::from_secs_f64(asked.history.min(MAX_HISTORY_SECONDS as f64));
    let permit = app.viewers.clone().try_acquire_owned();
    let permit = permit.map_err(|_| ApiError::Unavailable(format!("{} viewers are connected", super::MAX_VIEWERS)))?;
    if !app.hub.knows(&id) {
        return Err(crate::hub::VehicleError::Unknown(id).into());
    }
    Ok(upgrade.max_message_size(MAX_INCOMING).max_frame_size(MAX_INCOMING).on_upgrade(move |socket| async move {
        let _permit = permit;
        let who = if app.people.sign_in_needed() { who.0 } else { asked.operator.unwrap_or(who.0) };
        if let Ok(viewer) = app.hub.subscribe(&id, history) {
            serve(&app, &id, &who, viewer, socket).await;
        }
    }))
}

async fn serve(app: &App, id: &str, who: &str, viewer: Viewer, mut socket: WebSocket) {
    let Viewer { backlog, queue } = viewer;
    if !send(&mut socket, link_batch(app, id, &queue)).await {
        return;
    }
    for shared in backlog {
        if shared.messages > 0 && !send(&mut socket, shared.batch).await {
            return;
        }
    }
    let mut stopped = app.stopped.clone();
    let mut link = interval(LINK_EVERY);
    link.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let batch = tokio::select! {
            shared = queue.next() => shared.batch,
            _ = link.tick() => link_batch(app, id, &queue),
            incoming = socket.recv() => match incoming {
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(Message::Binary(bytes))) => {
                    alive(app, id, who, &bytes);
                    continue;
                }
                Some(Ok(_)) => continue,
            },
            () = stopping(&mut stopped) => {
                let _ = timeout(Duration::from_secs(1), socket.send(Message::Close(None))).await;
                return;
            }
        };
        if !send(&mut socket, batch).await {
            return;
        }
    }
}

/// Passes on the sign of life of the operator in control; what else a viewer may say is ignored.
fn alive(app: &App, id: &str, who: &str, bytes: &[u8]) {
    if let Ok(alive) = v1::OperatorAlive::decode(bytes)
        && app.leases.alive(id, who)
        && let Ok(commands) = app.hub.commands(id)
    {
        commands.try_operator_alive(alive.challenge);
    }
}

/// Sends one batch; `false` when the viewer is gone or has stalled.
async fn send(socket: &mut WebSocket, batch: Bytes) -> bool {
    matches!(timeout(STALLED, socket.send(Message::Binary(batch))).await, Ok(Ok(())))
}

/// The link's state, with this viewer's own losses.
fn link_batch(app: &App, id: &str, queue: &ViewerQueue) -> Bytes {
    let mut batch = Vec::new();
    codec::begin_batch(&mut batch);
    if let Some(mut status) = app.hub.link_status(id) {
        status.missing = app.recorder.status(id).missing;
        status.viewer_dropped = queue.dropped();
        codec::encode_message(&mut batch, Kind::Link, 0, 0, status.wall_time_us, &status);
    }
    batch.into()
}
