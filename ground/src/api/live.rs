//! `GET /api/v1/vehicles/{id}/live`: a WebSocket of codec batches, and `GET /api/v1/vehicles/{id}/history?seconds=120`: what
//! charts show of the past, in one batch.
//!
//! First the latest of every topic (and, where it is asked for, the whole history), then live batches, each at most
//! 10 ms old when it leaves the hub; with `thinned=true` only what a page shows of them (`hub/thinned.rs`), at most 35 ms old. The page asks for no history here: minutes of messages before the newest one
//! would make what it shows minutes old, and its operator's sign of life too late. A viewer that stops reading fills its own queue ([`ViewerQueue`]), loses the
//! oldest, sees the count in its `LinkStatus`, and is closed after [`STALLED`].
//!
//! [`ViewerQueue`]: crate::hub::ViewerQueue

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse as _, Response};
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::thinning::Thinner;
use plumbline_proto::{Kind, Message as _, v1};
use serde::Deserialize;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::App;
use super::access::token;
use super::error::ApiError;
use super::extract::{Path, Query};
use super::operator::{self, Operator};
use crate::front::Place;
use crate::hub::{MAX_HISTORY_SECONDS, Shared, Viewer, ViewerQueue};
use crate::people::SessionKey;
use crate::sync::stopping;
use crate::viewers::MAX_VIEWERS;

/// A viewer that takes nothing for this long is closed.
pub(super) const STALLED: Duration = Duration::from_secs(30);
/// How often it is asked whether a viewer may still watch.
const ASK_EVERY: Duration = Duration::from_millis(250);
/// How often the state of the link is sent.
const LINK_EVERY: Duration = Duration::from_millis(250);
/// Stretches of the past: charts are some 700 pixels wide.
const COLUMNS: u64 = 480;
/// Viewers have nothing to say but that they are there.
const MAX_INCOMING: usize = 4096;

#[derive(Deserialize)]
pub(crate) struct Asked {
    #[serde(default)]
    history: f64,
    /// Only what a page shows; the newest of every topic first, all the same.
    #[serde(default)]
    thinned: bool,
    /// What the page calls itself, where nobody signs in: a browser sends no headers of ours here.
    operator: Option<String>,
}

pub(crate) async fn live(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(asked): Query<Asked>,
    who: Operator,
    place: Option<Extension<Arc<Place>>>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let upgrade = upgrade.map_err(|e| ApiError::Upgrade(format!("a WebSocket is served here: {}", e.body_text())))?;
    if !asked.history.is_finite() || asked.history < 0.0 {
        return Err(ApiError::Invalid(format!("history {} is not a number of seconds", asked.history)));
    }
    let history = Duration::from_secs_f64(asked.history.min(MAX_HISTORY_SECONDS as f64));
    let who = if app.people.sign_in_needed() { who.name } else { operator::named(asked.operator, who.name)? };
    if !app.hub.knows(&id) {
        return Err(crate::hub::VehicleError::Unknown(id).into());
    }
    let control = app.leases.holder(&id).is_some_and(|holder| holder == who);
    let seat = app.viewers.enter(&who, control);
    let seat = seat.ok_or_else(|| ApiError::Unavailable(format!("{MAX_VIEWERS} viewers are connected")))?;
    let session = token(&headers).map(|token| token.key());
    Ok(upgrade.max_message_size(MAX_INCOMING).max_frame_size(MAX_INCOMING).on_upgrade(move |mut socket| async move {
        if let Some(Extension(place)) = &place {
            place.watch();
        }
        if let Ok(viewer) = app.hub.subscribe(&id, history, asked.thinned) {
            app.leases.page_opened(&id, &who);
            tokio::select! {
                () = serve(&app, &id, &who, viewer, &mut socket) => {}
                () = seat.closed() => tracing::debug!(who, "an older socket gives way"),
                () = expelled(&app, session.as_ref()) => {
                    let _ = timeout(Duration::from_secs(1), socket.send(Message::Close(None))).await;
                }
            }
            app.leases.page_closed(&id, &who);
        }
    }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Past {
    seconds: u64,
}

/// Not a stream: whoever asks has the newest state already, and reads this when there is time.
pub(crate) async fn history(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(Past { seconds }): Query<Past>,
) -> Result<Response, ApiError> {
    if !(1..=MAX_HISTORY_SECONDS).contains(&seconds) {
        return Err(ApiError::Invalid(format!("seconds {seconds} is outside 1 to {MAX_HISTORY_SECONDS}")));
    }
    // In turn: it keeps a processor busy for a while.
    let _turn = app.thinning.acquire().await.map_err(|_| ApiError::Unavailable("the ground is stopping".into()))?;
    let batches = app.hub.past(&id, Duration::from_secs(seconds))?;
    let thinned = tokio::task::spawn_blocking(move || past(&batches, seconds)).await;
    let thinned = thinned.map_err(|e| ApiError::Broken(e.to_string()))?;
    Ok(([(header::CONTENT_TYPE, "application/octet-stream")], thinned).into_response())
}

/// One batch with what charts show of `batches`, which are of the last `seconds`; each topic in the order of time. What
/// the newest state repeats (description, gains) is left out.
fn past(batches: &[Shared], seconds: u64) -> Vec<u8> {
    let mut out = Vec::new();
    codec::begin_batch(&mut out);
    let mut thinner = Thinner::new(seconds * 1_000_000, COLUMNS);
    let frames = batches.iter().filter_map(|shared| codec::decode_batch(&shared.batch).ok()).flatten();
    let repeated = |frame: &Frame<'_>| matches!(frame.known_kind(), Some(Kind::Description | Kind::Gains));
    frames.map_while(Result::ok).filter(|frame| !repeated(frame)).for_each(|frame| thinner.take(&frame, &mut out));
    thinner.finish(&mut out);
    out
}

/// Completes when whoever has this session may watch no more: signed out, removed, or with another password.
pub(super) async fn expelled(app: &App, session: Option<&SessionKey>) {
    let mut ask = interval(ASK_EVERY);
    ask.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while app.people.person_of(session).is_some() {
        ask.tick().await;
    }
}

async fn serve(app: &App, id: &str, who: &str, viewer: Viewer, socket: &mut WebSocket) {
    let Viewer { backlog, queue } = viewer;
    if !send(socket, link_batch(app, id, &queue)).await {
        return;
    }
    for shared in backlog {
        if shared.messages > 0 && !send(socket, shared.batch).await {
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
        if !send(socket, batch).await {
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
