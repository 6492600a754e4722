//! The vehicles as a MAVLink ground control station sees them: QGroundControl, MAVProxy, MAVSDK, pymavlink.
//!
//! One UDP socket, on the loopback unless the station configured is elsewhere, speaks with that one address. Each vehicle
//! is a system with a number of its own, in the order in which they came. What a station asks goes the way of the HTTP
//! API: the account configured, its role, the lease, a command that is acknowledged, a line in the audit log. Datagrams
//! carry no password, so a station on another machine may watch and not command, unless a key is configured: then both sides sign
//! (MAVLink 2), and what is not signed with it, or with a time that was used, is refused, counted and told once a second.
//!
//! | message | when |
//! |---|---|
//! | ATTITUDE, LOCAL_POSITION_NED | 20 Hz |
//! | HEARTBEAT, SYS_STATUS, BATTERY_STATUS, VFR_HUD | 1 Hz |
//! | STATUSTEXT | each event, each refusal |
//! | PARAM_VALUE, AUTOPILOT_VERSION, MISSION_COUNT (0), TIMESYNC | when asked |
//!
//! A heartbeat of the station is its operator's sign of life. Sending never waits: what the socket does not take is lost.

mod ask;
mod say;

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use mavlink::dialects::common::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{
    MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkReader, Message as _, SigningConfig, SigningData,
};
use plumbline_proto::{Kind, codec, v1};
use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

use super::App;
use crate::config::Mavlink;
use crate::hub::Viewer;
use crate::sync::{lock, stopping};

const FAST: Duration = Duration::from_millis(50);
const SLOW: Duration = Duration::from_secs(1);
/// How often it is looked for new vehicles.
const LOOK: Duration = Duration::from_millis(500);
/// Messages that wait for a vehicle's task; the newest is given up when it is full.
const INBOX: usize = 128;
/// Largest datagram taken: several messages.
const DATAGRAM: usize = 4096;
/// Of signatures: there is one link.
const LINK: u8 = 0;
/// System numbers given away; a GCS is usually 255.
const SYSTEMS: usize = 250;

/// The way to the station for one vehicle.
#[derive(Clone)]
struct Line {
    socket: Arc<UdpSocket>,
    signing: Option<Arc<SigningData>>,
    system: u8,
    /// Of the next frame; held until that is sent, as a signature's time must be newer than the last that arrived.
    sequence: Arc<Mutex<u8>>,
}

impl Line {
    /// Sends one message, or gives it up.
    fn say(&self, message: &MavMessage) {
        let mut sequence = lock(&self.sequence);
        // 1: the autopilot of the system.
        let header = MavHeader { system_id: self.system.into(), component_id: 1, sequence: *sequence };
        *sequence = sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        match &self.signing {
            Some(signing) => {
                raw.serialize_message_for_signing(header, message);
                signing.sign_message(&mut raw);
            }
            None => raw.serialize_message(header, message),
        }
        let _ = self.socket.try_send(raw.raw_bytes());
    }
}

/// What is known of one vehicle.
#[derive(Default)]
struct Latest {
    status: v1::Status,
    estimate: Option<v1::Estimate>,
    gains: v1::GainsInUse,
}

/// Serves `config.station` until the ground stops.
///
/// # Errors
/// No socket could be had.
pub(crate) async fn serve(app: App, config: Mavlink) -> std::io::Result<()> {
    let own: IpAddr = match config.station {
        SocketAddr::V4(to) if to.ip().is_loopback() => Ipv4Addr::LOCALHOST.into(),
        SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(to) if to.ip().is_loopback() => Ipv6Addr::LOCALHOST.into(),
        SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = Arc::new(UdpSocket::bind((own, 0)).await?);
    // From now on the kernel drops what comes from anywhere else.
    socket.connect(config.station).await?;
    tracing::info!(station = %config.station, "MAVLink");
    let signing = config.key.as_ref().map(|key| {
        let config = SigningConfig::new(key.bytes(), LINK, true, false);
        Arc::new(SigningData::from_config(config))
    });
    let mut stations: Vec<Station> = Vec::new();
    let mut told = None;
    let (mut look, mut stopped) = (interval(LOOK), app.stopped.clone());
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut datagram = [0; DATAGRAM];
    loop {
        tokio::select! {
            _ = look.tick() => find(&app, &config, &socket, signing.as_ref(), &mut stations),
            came = socket.recv(&mut datagram) => match came {
                Ok(length) => {
                    let refused = hand_out(datagram.get(..length).unwrap_or_default(), &stations, signing.as_deref());
                    tell_refused(&app, refused, &mut told, stations.first());
                }
                // Nobody listens there yet.
                Err(_) => tokio::time::sleep(FAST).await,
            },
            () = stopping(&mut stopped) => return Ok(()),
        }
    }
}

/// A vehicle that has, or had, a task.
struct Station {
    id: String,
    line: Line,
    inbox: mpsc::Sender<MavMessage>,
}

/// Begins a task for each vehicle that is connected and has none.
fn find(
    app: &App,
    config: &Mavlink,
    socket: &Arc<UdpSocket>,
    signing: Option<&Arc<SigningData>>,
    stations: &mut Vec<Station>,
) {
    for id in app.hub.ids() {
        let known = stations.iter().position(|station| station.id == id);
        let idle = known.and_then(|at| stations.get(at)).is_none_or(|station| station.inbox.is_closed());
        if !idle || app.hub.commands(&id).is_err() || (known.is_none() && stations.len() >= SYSTEMS) {
            continue;
        }
        let (inbox, messages) = mpsc::channel(INBOX);
        let line = if let Some(station) = known.and_then(|at| stations.get_mut(at)) {
            station.inbox = inbox;
            station.line.clone()
        } else {
            let system = stations.len() as u8 + 1;
            let line = Line { socket: socket.clone(), signing: signing.cloned(), system, sequence: Arc::default() };
            stations.push(Station { id: id.clone(), line: line.clone(), inbox });
            line
        };
        let who = ask::Who { app: app.clone(), vehicle: id, config: config.clone() };
        tokio::spawn(attend(who, line, messages));
    }
}

/// Counts messages that were `refused`, and says so to the station once a second.
fn tell_refused(app: &App, refused: u64, told: &mut Option<Instant>, station: Option<&Station>) {
    if refused == 0 {
        return;
    }
    let all = app.counts.mavlink_refused.fetch_add(refused, Ordering::Relaxed) + refused;
    if told.is_some_and(|last| last.elapsed() < SLOW) {
        return;
    }
    *told = Some(Instant::now());
    tracing::warn!(all, "MAVLink: not signed with the configured key");
    let text = format!("refused {all}: not signed with the configured key");
    let said = say::text(v1::Severity::Warning, &text);
    said.iter().zip(station.into_iter().cycle()).for_each(|(message, station)| station.line.say(message));
}

/// Gives each message of a datagram to the vehicle that it names, or to all where it names none. How many were refused,
/// as they are not signed.
fn hand_out(datagram: &[u8], stations: &[Station], signing: Option<&SigningData>) -> u64 {
    let mut refused = 0;
    for message in messages(datagram, signing, &mut refused) {
        let target = ask::target(&message);
        for station in stations.iter().filter(|station| target.is_none_or(|system| system == station.line.system)) {
            let _ = station.inbox.try_send(message.clone());
        }
    }
    refused
}

/// The messages of a datagram; what is damaged, or of another dialect, is passed over, and what is not signed counted.
fn messages<'a>(
    datagram: &'a [u8],
    signing: Option<&'a SigningData>,
    refused: &'a mut u64,
) -> impl Iterator<Item = MavMessage> + 'a {
    let mut reader = MavlinkReader::new(datagram);
    std::iter::from_fn(move || {
        loop {
            let raw = match reader.read_any_raw_message::<MavMessage>() {
                Ok(raw) => raw,
                Err(MessageReadError::Io(_)) => return None,
                // A whole frame was taken.
                Err(MessageReadError::Parse(_)) => continue,
            };
            let trusted = match (signing, &raw) {
                (None, _) => true,
                (Some(signing), MAVLinkMessageRaw::V2(raw)) => signing.verify_signature(raw),
                (Some(_), MAVLinkMessageRaw::V1(_)) => false,
            };
            if !trusted {
                *refused += 1;
            } else if let Ok(message) = MavMessage::parse(raw.version(), raw.message_id(), raw.payload()) {
                return Some(message);
            }
        }
    })
}

/// Messages of a datagram that mean something to a vehicle. Pure: what [`serve`] makes of what anybody sends.
pub fn understood(datagram: &[u8]) -> usize {
    let latest = Latest::default();
    let meant = |message: &MavMessage| ask::read(message, &latest) != ask::Asked::Nothing;
    messages(datagram, None, &mut 0).filter(meant).count()
}

/// Speaks for one vehicle while it is connected.
async fn attend(who: ask::Who, line: Line, mut messages: mpsc::Receiver<MavMessage>) {
    let app = &who.app;
    let Ok(Viewer { backlog, queue }) = app.hub.subscribe(&who.vehicle, Duration::ZERO, false) else { return };
    let mut latest = Latest::default();
    backlog.iter().for_each(|shared| take(&mut latest, &shared.batch, &line));
    let (mut fast, mut slow, mut stopped) = (interval(FAST), interval(SLOW), app.stopped.clone());
    fast.set_missed_tick_behavior(MissedTickBehavior::Delay);
    slow.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            shared = queue.next() => take(&mut latest, &shared.batch, &line),
            _ = fast.tick() => say::motion(&latest).iter().for_each(|message| line.say(message)),
            _ = slow.tick() => {
                if app.hub.commands(&who.vehicle).is_err() {
                    return;
                }
                say::state(&latest).iter().for_each(|message| line.say(message));
            }
            Some(message) = messages.recv() => ask::answer(&who, &line, &latest, message),
            () = stopping(&mut stopped) => return,
        }
    }
}

/// Keeps what is newest, and passes events on.
fn take(latest: &mut Latest, batch: &[u8], line: &Line) {
    let Ok(frames) = codec::decode_batch(batch) else { return };
    for frame in frames.map_while(Result::ok) {
        match frame.known_kind() {
            Some(Kind::Status) => latest.status = frame.message().unwrap_or_default(),
            Some(Kind::Gains) => latest.gains = frame.message().unwrap_or_default(),
            Some(Kind::Estimate) if i32::from(frame.instance) == latest.status.estimator_in_loop => {
                latest.estimate = frame.message().ok();
            }
            Some(Kind::Event) => {
                if let Ok(event) = frame.message::<v1::Event>() {
                    say::text(event.severity(), &event.text).iter().for_each(|message| line.say(message));
                }
            }
            _ => {}
        }
    }
}
