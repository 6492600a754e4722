//! `GET /api/v1/vehicles/{id}/foxglove`: the Foxglove WebSocket protocol (`foxglove.websocket.v1`, `foxglove.sdk.v1`).
//!
//! Channels are the topics of a flight file, with the same bytes and the same descriptors, and beside them well-known
//! schemas of Foxglove's ([`crate::scene`]). What nobody subscribed to is not sent. Gains and limits are [`parameters`] to be read; mode,
//! setpoint and cut are [`services`] under the lease. Roles are those of the live view and of commands. Foxglove cannot sign in: `POST`
//! to the same path answers an [`address`] with a ticket.
//!
//! Two queues lie between hub and socket. Samples: [`MAX_WAITING_BYTES`], the oldest goes when it is full. What is rare
//! (events, acknowledgements, states): [`MAX_RARE`], and a client that lets even these fill is closed: none is lost in
//! silence.
//!
//! Source: Foxglove, *ws-protocol*, `docs/spec.md`.

mod client;
mod parameters;
mod services;

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Json;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, Extension, State};
use axum::http::{HeaderMap, Uri, header};
use axum::response::Response;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::{Kind, v1};
use plumbline_rest::people::LiveAddress;
use serde::Deserialize;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::App;
use super::error::ApiError;
use super::extract::{Path, Query};
use super::live::{STALLED, expelled};
use super::operator::{self, Operator};
use crate::front::{Peer, Place};
use crate::hub::{Viewer, ViewerQueue};
use crate::people::{SessionKey, TICKET_VALID};
use crate::scene::{Drawn, Offer, Scene};
use crate::sync::{lock, stopping};
use crate::viewers::MAX_VIEWERS;
use client::Asked;
use services::Caller;

/// What is spoken here, the best first.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Channels of [`Offer`]s begin here, beyond those of any kind.
const FIRST_OFFER: u32 = 0xffff_0000;
/// Most bytes of samples that wait for a client.
const MAX_WAITING_BYTES: usize = 4 << 20;
/// Most rare messages that wait.
const MAX_RARE: usize = 4096;
/// Longest request of a client: subscriptions to hundreds of channels.
const MAX_INCOMING: usize = 64 << 10;
/// Most subscriptions of a client.
const MAX_SUBSCRIPTIONS: usize = 1024;

/// What the address says.
#[derive(Deserialize)]
pub(crate) struct Said {
    /// What a client calls itself, where nobody signs in.
    operator: Option<String>,
}

pub(crate) async fn live(
    State(app): State<App>,
    (Path(id), Query(said)): (Path<String>, Query<Said>),
    who: Operator,
    place: Option<Extension<Arc<Place>>>,
    peer: Option<Extension<ConnectInfo<Peer>>>,
    session: Option<Extension<SessionKey>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let upgrade = upgrade.map_err(|e| ApiError::Upgrade(format!("a WebSocket is served here: {}", e.body_text())))?;
    let upgrade = upgrade.protocols(PROTOCOLS);
    if upgrade.selected_protocol().is_none() {
        return Err(ApiError::Upgrade(format!("one of the sub-protocols {} is needed", PROTOCOLS.join(", "))));
    }
    if !app.hub.knows(&id) {
        return Err(crate::hub::VehicleError::Unknown(id).into());
    }
    let name = if app.people.sign_in_needed() { who.name } else { operator::named(said.operator, who.name)? };
    let seat = app.viewers.enter(&name, false);
    let seat = seat.ok_or_else(|| ApiError::Unavailable(format!("{MAX_VIEWERS} viewers are connected")))?;
    let from = peer.map_or_else(String::new, |Extension(ConnectInfo(Peer(address)))| address.ip().to_string());
    let caller =
        Caller { app: app.clone(), vehicle: id.clone(), name, session: session.map(|Extension(key)| key), from };
    Ok(upgrade.max_message_size(MAX_INCOMING).max_frame_size(MAX_INCOMING).on_upgrade(move |socket| async move {
        if let Some(Extension(place)) = &place {
            place.watch();
        }
        let Ok(viewer) = app.hub.subscribe(&id, Duration::ZERO, false) else { return };
        tokio::select! {
            () = serve(&caller, viewer, socket) => {}
            () = seat.closed() => {}
            () = expelled(&app, caller.session.as_ref()) => {}
        }
    }))
}

/// An address for a program that cannot sign in: with a ticket where people must.
pub(crate) async fn address(
    State(app): State<App>,
    Path(id): Path<String>,
    session: Option<Extension<SessionKey>>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Json<LiveAddress>, ApiError> {
    if !app.hub.knows(&id) {
        return Err(crate::hub::VehicleError::Unknown(id).into());
    }
    // The guard has looked at it: it is one of this ground's names.
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    let host = host.map_or_else(|| app.address.to_string(), str::to_owned);
    let (scheme, path) = (if app.secure() { "wss" } else { "ws" }, uri.path());
    let ticket = app.people.sign_in_needed().then(|| session.map(|Extension(key)| app.people.ticket(key, path)));
    let (ticket, valid_s) = match ticket {
        Some(Some(ticket)) => (format!("?ticket={ticket}"), Some(TICKET_VALID.as_secs())),
        Some(None) => return Err(ApiError::SignIn("sign in first".into())),
        None => (String::new(), None),
    };
    Ok(Json(LiveAddress { url: format!("{scheme}://{host}{path}{ticket}"), valid_s }))
}

async fn serve(caller: &Caller, viewer: Viewer, socket: WebSocket) {
    let (sender, receiver) = socket.split();
    let all_dropped = caller.app.counts.foxglove_dropped.clone();
    let outbox = Arc::new(Outbox { all_dropped, ..Outbox::default() });
    let client = Mutex::new(Client::new(caller.app.hub.latest(&caller.vehicle, Kind::Description)));
    outbox.rare(client::server_info(&caller.vehicle));
    outbox.rare(services::advertise());
    for offer in [Offer::Transform, Offer::Scene, Offer::Log] {
        lock(&client).offer(offer, &outbox);
    }
    let Viewer { backlog, queue } = viewer;
    for shared in backlog {
        take(&client, &outbox, &shared.batch);
    }
    let mut stopped = caller.app.stopped.clone();
    tokio::select! {
        () = send(sender, &outbox) => {}
        () = pump(&queue, &client, &outbox) => {}
        () = listen(receiver, &client, caller, &outbox) => {}
        () = stopping(&mut stopped) => {}
    }
}

/// From the hub into the outbox; ends when the client has let what is rare pile up.
async fn pump(queue: &ViewerQueue, client: &Mutex<Client>, outbox: &Outbox) {
    while !outbox.overflown() {
        let shared = queue.next().await;
        take(client, outbox, &shared.batch);
        // Where many wait the next is there at once: what sends and what listens would not have their turn until all are taken.
        tokio::task::yield_now().await;
    }
}

fn take(client: &Mutex<Client>, outbox: &Outbox, batch: &[u8]) {
    let Ok(frames) = codec::decode_batch(batch) else { return };
    let mut client = lock(client);
    frames.flatten().for_each(|frame| client.take(&frame, outbox));
}

/// What the client says; ends with it, and when it asks without taking the answers.
async fn listen(mut receiver: SplitStream<WebSocket>, client: &Mutex<Client>, caller: &Caller, outbox: &Arc<Outbox>) {
    while let Some(Ok(message)) = receiver.next().await
        && !outbox.overflown()
    {
        match message {
            Message::Text(text) => lock(client).asked(&text, outbox),
            Message::Binary(bytes) => match client::call(&bytes) {
                Ok(call) => {
                    let (caller, outbox) = (caller.clone(), outbox.clone());
                    tokio::spawn(async move { outbox.rare(caller.call(call).await) });
                }
                Err(why) => outbox.rare(client::trouble(&why)),
            },
            Message::Close(_) => return,
            Message::Ping(_) | Message::Pong(_) => {}
        }
    }
}

async fn send(mut sender: SplitSink<WebSocket, Message>, outbox: &Outbox) {
    loop {
        let message = outbox.next().await;
        if !matches!(timeout(STALLED, sender.send(message)).await, Ok(Ok(()))) {
            return;
        }
    }
}

/// What waits for the socket.
#[derive(Debug, Default)]
struct Outbox {
    waiting: Mutex<Waiting>,
    ready: Notify,
    /// Samples that all clients were too slow for.
    all_dropped: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct Waiting {
    rare: VecDeque<Message>,
    samples: VecDeque<Vec<u8>>,
    bytes: usize,
    dropped: u64,
}

impl Outbox {
    fn rare(&self, message: Message) {
        lock(&self.waiting).rare.push_back(message);
        self.ready.notify_one();
    }

    fn sample(&self, message: Vec<u8>) {
        let mut waiting = lock(&self.waiting);
        waiting.bytes += message.len();
        waiting.samples.push_back(message);
        while waiting.bytes > MAX_WAITING_BYTES {
            let Some(oldest) = waiting.samples.pop_front() else { break };
            waiting.bytes -= oldest.len();
            waiting.dropped += 1;
            self.all_dropped.fetch_add(1, Ordering::Relaxed);
        }
        drop(waiting);
        self.ready.notify_one();
    }

    fn overflown(&self) -> bool {
        lock(&self.waiting).rare.len() > MAX_RARE
    }

    /// What is rare first; then, where samples were dropped, that they were; then samples.
    fn pop(&self) -> Option<Message> {
        let mut waiting = lock(&self.waiting);
        if let Some(message) = waiting.rare.pop_front() {
            return Some(message);
        }
        if waiting.dropped > 0 {
            let dropped = std::mem::take(&mut waiting.dropped);
            return Some(client::warning(&format!(
                "{dropped} samples were dropped: they came faster than they could be sent"
            )));
        }
        let sample = waiting.samples.pop_front()?;
        waiting.bytes -= sample.len();
        Some(Message::Binary(sample.into()))
    }

    async fn next(&self) -> Message {
        loop {
            if let Some(message) = self.pop() {
                return message;
            }
            self.ready.notified().await;
        }
    }
}

/// One client: what it was offered, what it subscribed to.
struct Client {
    /// Wall time of the agent's boot, µs.
    boot_us: u64,
    /// Topics by channel.
    channels: BTreeMap<u32, String>,
    /// Channel by subscription, and the other way round.
    subscriptions: HashMap<u32, u32>,
    /// The latest of channels that say little: a new subscriber is sent it.
    latest: HashMap<u32, (u64, Vec<u8>)>,
    scene: Scene,
}

/// Is this kind sent many times a second?
fn sampled(kind: Option<Kind>) -> bool {
    kind.is_none_or(|kind| {
        kind.is_sensor()
            || matches!(
                kind,
                Kind::Estimate | Kind::Residuals | Kind::Truth | Kind::Secure | Kind::Control | Kind::Link | Kind::Scan
            )
    })
}

impl Client {
    fn new(description: Option<v1::Description>) -> Self {
        Self {
            boot_us: description.map_or(0, |description| description.boot_wall_time_us),
            channels: BTreeMap::new(),
            subscriptions: HashMap::new(),
            latest: HashMap::new(),
            scene: Scene::default(),
        }
    }

    fn take(&mut self, frame: &Frame<'_>, outbox: &Outbox) {
        let Some(kind) = frame.known_kind() else { return };
        if kind == Kind::Description
            && let Ok(description) = frame.message::<v1::Description>()
        {
            self.boot_us = description.boot_wall_time_us;
        }
        let channel = u32::from(frame.kind) << 16 | u32::from(frame.instance);
        self.channels.entry(channel).or_insert_with(|| {
            let topic = kind.topic(frame.instance);
            outbox.rare(client::advertise(channel, &topic, kind.message_name()));
            topic
        });
        // The ground's own messages are stamped with the wall's time.
        let boot = WallTime(if kind.is_ground_made() { 0 } else { self.boot_us });
        let since = boot.at(FlightTime(frame.time_us));
        self.put(channel, since.as_nanos(), frame.payload, sampled(Some(kind)), outbox);
        if kind == Kind::Scan {
            self.offer(Offer::Laser, outbox);
        }
        // Events are few, and kept for who subscribes later.
        let subscriptions = &self.subscriptions;
        let wanted = |offer| offer == Offer::Log || subscriptions.values().any(|of| *of == FIRST_OFFER + offer as u32);
        for Drawn { offer, json, sampled } in self.scene.take(kind, frame, since.0, wanted) {
            self.put(FIRST_OFFER + offer as u32, since.as_nanos(), json.to_string().as_bytes(), sampled, outbox);
        }
    }

    fn offer(&mut self, offer: Offer, outbox: &Outbox) {
        let channel = FIRST_OFFER + offer as u32;
        self.channels.entry(channel).or_insert_with(|| {
            outbox.rare(client::advertise_json(channel, offer));
            offer.topic().to_owned()
        });
    }

    fn put(&mut self, channel: u32, time_ns: u64, payload: &[u8], sampled: bool, outbox: &Outbox) {
        if !sampled {
            self.latest.insert(channel, (time_ns, payload.to_vec()));
        }
        for (subscription, _) in self.subscriptions.iter().filter(|(_, of)| **of == channel) {
            let data = client::data(*subscription, time_ns, payload);
            if sampled { outbox.sample(data) } else { outbox.rare(Message::Binary(data.into())) }
        }
    }

    fn asked(&mut self, text: &str, outbox: &Outbox) {
        match serde_json::from_str(text) {
            Ok(Asked::Subscribe { subscriptions }) => {
                for client::Subscription { id, channel } in subscriptions {
                    if let Err(text) = self.subscribe(id, channel, outbox) {
                        outbox.rare(client::trouble(&text));
                    }
                }
            }
            Ok(Asked::Unsubscribe { subscriptions }) => {
                for id in subscriptions {
                    if self.subscriptions.remove(&id).is_none() {
                        outbox.rare(client::warning(&format!("there is no subscription {id}")));
                    }
                }
            }
            Ok(Asked::GetParameters { names, id }) => {
                outbox.rare(client::parameters(parameters::values(&self.parameters(), &names), id));
            }
            Ok(Asked::SetParameters { parameters: wanted, id }) => {
                outbox.rare(client::trouble(
                    "parameters are read only: gains are pushed on the page, limits are the agent's configuration",
                ));
                let names: Vec<String> = wanted.into_iter().map(|parameter| parameter.name).collect();
                if id.is_some() && !names.is_empty() {
                    outbox.rare(client::parameters(parameters::values(&self.parameters(), &names), id));
                }
            }
            Ok(Asked::Other) => outbox
                .rare(client::trouble("this is not done here: subscriptions, getParameters and calls of services are")),
            Err(error) => outbox.rare(client::trouble(&format!("the request cannot be read: {error}"))),
        }
    }

    /// As the vehicle has said them last.
    fn parameters(&self) -> Vec<(String, serde_json::Value)> {
        let gains: Option<v1::GainsInUse> = self.said(Kind::Gains);
        let description: Option<v1::Description> = self.said(Kind::Description);
        parameters::all(gains.as_ref(), description.and_then(|description| description.limits).as_ref())
    }

    fn said<M: plumbline_proto::Message + Default>(&self, kind: Kind) -> Option<M> {
        let (_, payload) = self.latest.get(&(u32::from(kind.to_wire()) << 16))?;
        M::decode(payload.as_slice()).ok()
    }

    fn subscribe(&mut self, id: u32, channel: u32, outbox: &Outbox) -> Result<(), String> {
        if !self.channels.contains_key(&channel) {
            return Err(format!("there is no channel {channel}"));
        }
        if self.subscriptions.contains_key(&id) {
            return Err(format!("there is a subscription {id} already"));
        }
        if self.subscriptions.len() >= MAX_SUBSCRIPTIONS {
            return Err(format!("{MAX_SUBSCRIPTIONS} subscriptions are the most"));
        }
        self.subscriptions.insert(id, channel);
        if let Some((time_ns, payload)) = self.latest.get(&channel) {
            outbox.rare(Message::Binary(client::data(id, *time_ns, payload).into()));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_give_way_and_what_is_rare_does_not() {
        let outbox = Outbox::default();
        for _ in 0..5 {
            outbox.sample(vec![0; MAX_WAITING_BYTES / 4]);
        }
        outbox.rare(client::warning("rare"));
        let next = || outbox.pop();
        assert!(matches!(next(), Some(Message::Text(text)) if text.contains("rare")));
        assert!(matches!(next(), Some(Message::Text(text)) if text.contains("1 samples were dropped")));
        assert_eq!((0..).map_while(|_| next()).count(), 4);
        assert_eq!(outbox.all_dropped.load(Ordering::Relaxed), 1, "counted for all, also once it was told");
        assert!(!outbox.overflown());
        (0..=MAX_RARE).for_each(|_| outbox.rare(client::warning("")));
        assert!(outbox.overflown());
    }

    /// GIVEN a queue with a hundred batches WHEN they are taken THEN what shares the task has its turn between them.
    #[tokio::test]
    async fn a_backlog_leaves_turns_to_what_sends_and_listens() {
        let (queue, outbox, client) = (ViewerQueue::default(), Outbox::default(), Mutex::new(Client::new(None)));
        for _ in 0..100 {
            queue.push(crate::hub::Shared { batch: vec![1].into(), messages: 1 });
        }
        let turns = async {
            for _ in 0..10 {
                tokio::task::yield_now().await;
            }
        };
        tokio::select! {
            () = pump(&queue, &client, &outbox) => panic!("it ends with the client alone"),
            () = turns => {}
        }
        assert!(queue.queued_bytes() > 50, "{} batches are left after ten turns", queue.queued_bytes());
    }

    #[test]
    fn what_is_not_subscribed_to_is_not_sent_and_odd_requests_are_answered() {
        let (outbox, mut client) = (Outbox::default(), Client::new(None));
        client
            .take(&Frame { kind: Kind::Status.to_wire(), instance: 0, sequence: 1, time_us: 1, payload: &[] }, &outbox);
        let channel = u32::from(Kind::Status.to_wire()) << 16;
        assert!(matches!(outbox.pop(), Some(Message::Text(text)) if text.contains("/status")));
        assert!(outbox.pop().is_none());
        client.asked(&format!(r#"{{"op":"subscribe","subscriptions":[{{"id":7,"channelId":{channel}}}]}}"#), &outbox);
        assert!(
            matches!(outbox.pop(), Some(Message::Binary(data)) if data[..5] == [1, 7, 0, 0, 0]),
            "the latest at once"
        );
        for (text, named) in [
            ("{", "cannot be read"),
            (r#"{"op":"subscribe","subscriptions":[{"id":8,"channelId":5}]}"#, "no channel 5"),
            (r#"{"op":"unsubscribe","subscriptionIds":[9]}"#, "no subscription 9"),
            (r#"{"op":"setParameters","parameters":[]}"#, "read only"),
            (r#"{"op":"getParameters","parameterNames":[],"id":"x"}"#, "\"parameters\":[]"),
            (r#"{"op":"advertise","channels":[]}"#, "not done here"),
        ] {
            client.asked(text, &outbox);
            assert!(matches!(outbox.pop(), Some(Message::Text(text)) if text.contains(named)), "{text}");
        }
    }
}
