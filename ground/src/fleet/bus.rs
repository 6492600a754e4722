//! Live vehicles over NATS: what the hub of one ground has, the hubs of all others have a moment later.
//!
//! | subject | what |
//! |---|---|
//! | `plumbline.fleet.GROUND.VEHICLE.live` | a batch as viewers get it, within 10 ms |
//! | `plumbline.fleet.GROUND.here` | four times a second: there is such a ground ([`Here`], JSON) |
//! | `plumbline.fleet.GROUND.VEHICLE.linked` | as often: the vehicle is linked there ([`Linked`], JSON) |
//! | `plumbline.fleet.GROUND.VEHICLE.kept` | every two seconds: the latest of every topic, for grounds that came later |
//! | `plumbline.fleet.GROUND.cut` | a request to cut a vehicle's motors ([`Cut`], answered by [`Done`]) |
//! | `plumbline.fleet.GROUND.time` | a request, answered by that ground's clock, µs |
//!
//! Whoever may publish there may cut motors: NATS is for the grounds alone, with credentials and TLS (`tls://USER:PASSWORD@…`).

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use async_nats::connection::State;
use async_nats::{Client, ConnectOptions, Message};
use futures_util::StreamExt as _;
use plumbline_proto::codec::Batch;
use plumbline_proto::v1::{self, command::Body};
use plumbline_rest::ground::{AtGround, Fleet as Shown};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_util::task::AbortOnDropHandle;

use super::{FleetError, Trouble, until_stopped};
use crate::agent_link::clock::wall_us;
use crate::agent_link::offset::OffsetEstimator;
use crate::agent_link::{CommandReceiver, CommandSender, Outgoing};
use crate::api::App;
use crate::hub::{Linked, Viewer};
use crate::sync::lock;

const ROOT: &str = "plumbline.fleet";
/// A vehicle's ground says so often that it is linked there, and clocks are compared as often.
const SAYS: Duration = Duration::from_millis(250);
/// The latest of every topic is told each so many times.
const KEPT_EVERY: u32 = 8;
/// A vehicle or a ground that was not heard of for so long is gone.
const GONE_AFTER: Duration = Duration::from_secs(2);

/// The grounds' live link.
#[derive(Debug)]
pub(crate) struct Bus {
    own: AtGround,
    url: String,
    /// Tells a second ground of the same name from this one.
    instance: u64,
    heard: Mutex<Heard>,
    trouble: Trouble,
}

#[derive(Debug, Default)]
struct Heard {
    grounds: BTreeMap<String, Ground>,
    vehicles: BTreeMap<String, Vehicle>,
    /// When another ground of this one's name was heard.
    twin: Option<Instant>,
}

/// Another ground.
#[derive(Debug)]
struct Ground {
    at: Instant,
    address: String,
    clocks: OffsetEstimator,
}

/// A vehicle of another ground.
#[derive(Debug)]
struct Vehicle {
    ground: String,
    at: Instant,
    /// Carries cuts there.
    _down: AbortOnDropHandle<()>,
}

/// A ground says that it is there.
#[derive(Debug, Serialize, Deserialize)]
struct Here {
    instance: u64,
    address: String,
}

/// A cut that is asked for.
#[derive(Debug, Serialize, Deserialize)]
struct Cut {
    vehicle: String,
    operator: String,
}

/// What came of it.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Done {
    accepted: bool,
    reason: String,
}

/// A vehicle's name as a part of a subject.
fn token(id: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_';
    id.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("={b:02x}") }).collect()
}

impl Bus {
    /// As `own` is called, over the NATS server at `url`; nothing is connected yet.
    pub(crate) fn new(own: AtGround, url: &str) -> Self {
        let instance = wall_us(Instant::now()) ^ (u64::from(std::process::id()) << 44);
        let trouble = Trouble::with("the grounds of the fleet");
        Self { own, url: url.to_owned(), instance, heard: Mutex::default(), trouble }
    }

    pub(super) fn show(&self, shown: &mut Shown) {
        shown.grounds = Some(lock(&self.heard).grounds.keys().cloned().collect());
        shown.live_error = self.trouble.now();
    }

    fn subject(&self, rest: &str) -> String {
        format!("{ROOT}.{}.{rest}", self.own.name)
    }

    fn wrong(&self, client: &Client) -> Option<FleetError> {
        if client.connection_state() != State::Connected {
            return Some(FleetError::Nats("the server is away".into()));
        }
        let twin = lock(&self.heard).twin.is_some_and(|heard| heard.elapsed() < GONE_AFTER);
        let name = &self.own.name;
        twin.then(|| FleetError::Settings(format!("another ground is called {name:?}")))
    }

    /// Passes on and listens until the ground stops.
    pub(crate) async fn run(self: Arc<Self>, app: App, stopped: watch::Receiver<bool>) {
        until_stopped(&self.trouble, stopped, || self.serve(&app)).await;
    }

    async fn serve(self: &Arc<Self>, app: &App) -> Result<(), FleetError> {
        let options = ConnectOptions::new().name(format!("plumbline {}", self.own.name)).no_echo();
        let client = options.connect(self.url.as_str()).await.map_err(nats)?;
        // Cuts do not wait behind what other grounds' vehicles send.
        let mut cuts = client.subscribe(self.subject("cut")).await.map_err(nats)?;
        let mut messages = client.subscribe(format!("{ROOT}.>")).await.map_err(nats)?;
        let ended = || FleetError::Nats("the connection ended".into());
        let mut passing: BTreeMap<String, AbortOnDropHandle<()>> = BTreeMap::new();
        let mut say = interval(SAYS);
        say.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                message = cuts.next() => {
                    let (app, client, message) = (app.clone(), client.clone(), message.ok_or_else(ended)?);
                    tokio::spawn(async move { cut(&app, &client, &message).await });
                }
                _ = say.tick() => {
                    self.trouble.set(self.wrong(&client));
                    let here = Here { instance: self.instance, address: self.own.address.clone() };
                    let here = serde_json::to_vec(&here).unwrap_or_default();
                    if client.connection_state() == State::Connected {
                        let _ = client.publish(self.subject("here"), here.into()).await;
                    }
                    passing.retain(|_, task| !task.is_finished());
                    for vehicle in app.hub.linked_here() {
                        passing.entry(vehicle.id.clone()).or_insert_with(|| {
                            let (own, app, client) = (self.clone(), app.clone(), client.clone());
                            AbortOnDropHandle::new(tokio::spawn(async move { own.pass_on(&app, &client, &vehicle.id).await }))
                        });
                    }
                    self.look(app, &client);
                }
                message = messages.next() => self.take(app, &client, &message.ok_or_else(ended)?),
            }
        }
    }

    /// Passes one vehicle on, while it is linked here.
    async fn pass_on(&self, app: &App, client: &Client, id: &str) {
        let Ok(Viewer { queue, .. }) = app.hub.subscribe(id, Duration::ZERO, false) else { return };
        let subject = |what: &str| self.subject(&format!("{}.{what}", token(id)));
        let (live, linked, kept) = (subject("live"), subject("linked"), subject("kept"));
        let mut say = interval(SAYS);
        say.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut said = 0_u32;
        loop {
            tokio::select! {
                shared = queue.next() => {
                    if client.connection_state() == State::Connected {
                        let _ = client.publish(live.clone(), shared.batch).await;
                    }
                }
                _ = say.tick() => {
                    let Some(told) = app.hub.linked_here().into_iter().find(|linked| linked.id == id) else { return };
                    if client.connection_state() != State::Connected {
                        continue;
                    }
                    let told = serde_json::to_vec(&told).unwrap_or_default();
                    let _ = client.publish(linked.clone(), told.into()).await;
                    if said.is_multiple_of(KEPT_EVERY)
                        && let Some(latest) = app.hub.latest_of_all(id)
                    {
                        let _ = client.publish(kept.clone(), latest.batch).await;
                    }
                    said = said.wrapping_add(1);
                }
            }
        }
    }

    fn take(self: &Arc<Self>, app: &App, client: &Client, message: &Message) {
        let parts = message.subject.as_str().strip_prefix(ROOT).and_then(|rest| rest.strip_prefix('.'));
        let parts: Vec<&str> = parts.unwrap_or_default().split('.').collect();
        let own = parts.first().is_some_and(|ground| *ground == self.own.name);
        match *parts.as_slice() {
            [_, "time"] if own => {
                if let Some(reply) = message.reply.clone() {
                    let (client, now) = (client.clone(), wall_us(Instant::now()).to_string());
                    tokio::spawn(async move { client.publish(reply, now.into()).await });
                }
            }
            [ground, "here"] => {
                let Ok(Here { instance, address }) = serde_json::from_slice(&message.payload) else { return };
                let (mut heard, now) = (lock(&self.heard), Instant::now());
                if !own {
                    let known = heard.grounds.entry(ground.to_owned());
                    let known = known.or_insert_with(|| Ground {
                        at: now,
                        address: String::new(),
                        clocks: OffsetEstimator::default(),
                    });
                    (known.at, known.address) = (now, address);
                } else if instance != self.instance {
                    heard.twin = Some(now);
                }
            }
            [ground, _, "linked"] if !own => {
                if let Ok(told) = serde_json::from_slice(&message.payload) {
                    self.heard_of(app, client, ground, told);
                }
            }
            [ground, vehicle, what @ ("live" | "kept")] if !own => {
                let id = {
                    let heard = lock(&self.heard);
                    let of = |(id, known): &(&String, &Vehicle)| known.ground == ground && token(id) == vehicle;
                    heard.vehicles.iter().find(of).map(|(id, _)| id.clone())
                };
                if let (Some(id), Ok(batch)) = (id, Batch::parse(message.payload.clone())) {
                    app.hub.passed_on(ground, &id, &batch, what == "kept");
                }
            }
            _ => {}
        }
    }

    /// A vehicle is linked to `ground`.
    fn heard_of(self: &Arc<Self>, app: &App, client: &Client, ground: &str, told: Linked) {
        let now = Instant::now();
        let mut heard = lock(&self.heard);
        // A ground says so of itself first.
        let Some(known) = heard.grounds.get(ground) else { return };
        let (between_ms, ahead_us) = known.clocks.estimate().unwrap_or_default();
        let at = AtGround { name: ground.to_owned(), address: known.address.clone() };
        let told = Linked {
            round_trip_ms: told.round_trip_ms + between_ms,
            clock_offset_us: told.clock_offset_us + ahead_us,
            ..told
        };
        let id = told.id.clone();
        if let Some(vehicle) = heard.vehicles.get_mut(&id).filter(|vehicle| vehicle.ground == ground) {
            if app.hub.linked_at(&at, &told, None) {
                vehicle.at = now;
            } else {
                heard.vehicles.remove(&id);
            }
            return;
        }
        let (commands, outgoing) = CommandSender::channel();
        if app.hub.linked_at(&at, &told, Some(commands)) {
            let down = carry(self.clone(), app.clone(), client.clone(), (ground.to_owned(), id.clone()), outgoing);
            let down = AbortOnDropHandle::new(tokio::spawn(down));
            heard.vehicles.insert(id, Vehicle { ground: ground.to_owned(), at: now, _down: down });
        }
    }

    /// Forgets who is gone, and compares clocks with who is there.
    fn look(self: &Arc<Self>, app: &App, client: &Client) {
        let grounds: Vec<String> = {
            let mut heard = lock(&self.heard);
            let gone: Vec<String> = {
                let gone = heard.vehicles.iter().filter(|(_, vehicle)| vehicle.at.elapsed() >= GONE_AFTER);
                gone.map(|(id, _)| id.clone()).collect()
            };
            for id in gone {
                // Its task ends with it, and with that the way down.
                heard.vehicles.remove(&id);
                app.hub.disconnected(&id);
            }
            heard.grounds.retain(|_, ground| ground.at.elapsed() < GONE_AFTER);
            heard.grounds.keys().cloned().collect()
        };
        for ground in grounds {
            let (own, client) = (self.clone(), client.clone());
            tokio::spawn(async move {
                let sent_us = wall_us(Instant::now());
                let asked = client.request(format!("{ROOT}.{ground}.time"), bytes::Bytes::new());
                let Ok(Ok(answer)) = timeout(SAYS, asked).await else { return };
                let received_us = wall_us(Instant::now());
                let theirs_us = std::str::from_utf8(&answer.payload).ok().and_then(|text| text.parse().ok());
                if let (Some(theirs_us), Some(known)) = (theirs_us, lock(&own.heard).grounds.get_mut(&ground)) {
                    known.clocks.add(sent_us, theirs_us, received_us);
                }
            });
        }
    }
}

/// Carries what is sent down to a vehicle of another ground: motor cuts. Nothing else may pass.
async fn carry(bus: Arc<Bus>, app: App, client: Client, (ground, id): (String, String), mut outgoing: CommandReceiver) {
    while let Some(next) = outgoing.recv().await {
        let Outgoing::Command(v1::Command { command_id, operator, body, .. }) = next else { continue };
        let done = if matches!(body, Some(Body::CutMotors(_))) {
            let operator = format!("{operator} at {}", bus.own.name);
            let cut = Cut { vehicle: id.clone(), operator };
            let payload = serde_json::to_vec(&cut).unwrap_or_default();
            let asked = client.request(format!("{ROOT}.{ground}.cut"), payload.into());
            // No longer than whoever asks waits: the next one goes at once.
            match timeout(app.config.command_timeout, asked).await {
                Ok(Ok(answer)) => serde_json::from_slice(&answer.payload).unwrap_or_default(),
                Ok(Err(error)) => {
                    Done { accepted: false, reason: format!("ground {ground:?} is not reached: {error}") }
                }
                Err(_) => continue,
            }
        } else {
            Done { accepted: false, reason: format!("{id:?} is flown from ground {ground:?}") }
        };
        let stage = if done.accepted { v1::AckStage::Accepted } else { v1::AckStage::Rejected };
        app.commands
            .resolve(&id, v1::Ack { command_id, stage: stage as i32, reason: done.reason, ..v1::Ack::default() });
    }
}

/// Cuts a vehicle of this ground for another one.
async fn cut(app: &App, client: &Client, message: &Message) {
    let Some(reply) = message.reply.clone() else { return };
    let done = match serde_json::from_slice::<Cut>(&message.payload) {
        Ok(Cut { vehicle, operator }) => match app.cut_for(&vehicle, operator).await {
            Ok(()) => Done { accepted: true, reason: String::new() },
            Err(reason) => Done { accepted: false, reason },
        },
        Err(error) => Done { accepted: false, reason: error.to_string() },
    };
    let _ = client.publish(reply, serde_json::to_vec(&done).unwrap_or_default().into()).await;
}

fn nats(error: impl std::fmt::Display) -> FleetError {
    FleetError::Nats(error.to_string())
}

/// Is the server at `url`, which is not told, reached?
pub(super) async fn reached(url: &str) -> Result<String, FleetError> {
    let client = ConnectOptions::new().name("plumbline doctor").connect(url).await.map_err(nats)?;
    Ok(format!("NATS {}", client.server_info().version))
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_vehicle_of_any_name_is_one_part_of_a_subject() {
        assert_eq!(["iris-1", "a.b", "x >*"].map(super::token), ["iris-1", "a=2eb", "x=20=3e=2a"]);
    }
}
