//! For machines that watch over this one: `GET /healthz`, `GET /readyz`, `GET /metrics`.
//!
//! The first two are open to everybody and tell nothing else. Figures name vehicles: they are for this machine, for
//! whoever is signed in, and for everybody only where the configuration says so (`metrics_open`).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::extract::{ConnectInfo, Extension, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use plumbline_proto::{Kind, v1};

use super::App;
use super::access::token;
use super::error::ApiError;
use crate::front::Peer;
use crate::metrics::{MEDIA, Metrics, Type};

/// Classes of status.
const CLASSES: [&str; 5] = ["1xx", "2xx", "3xx", "4xx", "5xx"];

/// What is counted from the start on.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Samples that Foxglove clients were too slow for.
    pub(super) foxglove_dropped: Arc<AtomicU64>,
    /// MAVLink messages that were not signed with the configured key.
    pub(super) mavlink_refused: AtomicU64,
    /// Requests, by class of the answer's status.
    requests: [AtomicU64; CLASSES.len()],
}

impl Counts {
    /// A request was answered so.
    pub(super) fn answered(&self, status: StatusCode) {
        if let Some(class) = self.requests.get(usize::from(status.as_u16() / 100).saturating_sub(1)) {
            class.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The ground answers.
pub(crate) async fn alive() -> &'static str {
    "ok\n"
}

/// The next flight would be recorded whole.
pub(crate) async fn ready(State(app): State<App>) -> Result<&'static str, ApiError> {
    if let Some(error) = app.recorder.error() {
        return Err(ApiError::Unavailable(format!("nothing can be recorded: {error}")));
    }
    if !app.recorder.ready() {
        return Err(ApiError::Unavailable("the index of flights is being put in line with their files".into()));
    }
    Ok("ready\n")
}

/// Figures.
pub(crate) async fn metrics(
    State(app): State<App>,
    peer: Option<Extension<ConnectInfo<Peer>>>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let here = peer.is_some_and(|Extension(ConnectInfo(Peer(address)))| address.ip().is_loopback());
    if !here && !app.config.metrics_open && app.people.person(token(&headers).as_ref()).is_none() {
        return Err(ApiError::SignIn("figures are for whoever is signed in; metrics_open opens them".into()));
    }
    let recorder = app.recorder.clone();
    let storage = tokio::task::spawn_blocking(move || recorder.storage()).await;
    let storage = storage.map_err(|e| ApiError::Broken(e.to_string()))?;
    let mut out = Metrics::default();
    out.family(Type::Gauge, "build_info", "Version of the ground.", [("version", env!("CARGO_PKG_VERSION"), 1.0)]);
    out.one(Type::Gauge, "uptime_seconds", "Since the ground's start.", app.started.elapsed().as_secs_f64());
    out.one(Type::Gauge, "disk_free_bytes", "Free on the disk of the recordings.", storage.free_bytes as f64);
    out.one(Type::Gauge, "flights_bytes", "Size of all flight files.", storage.used_bytes as f64);
    out.one(Type::Gauge, "flights", "Flights kept.", storage.flights as f64);
    recorder_figures(&app, &mut out);
    queue_figures(&app, &mut out);
    fleet_figures(&app, &mut out);
    vehicle_figures(&app, &mut out);
    Ok(([(header::CONTENT_TYPE, MEDIA)], out.text()).into_response())
}

fn recorder_figures(app: &App, out: &mut Metrics) {
    let recorder = &app.recorder;
    let flag = |holds: bool| f64::from(u8::from(holds));
    out.one(Type::Gauge, "recorder_healthy", "1 where what comes can be recorded.", flag(recorder.error().is_none()));
    out.one(Type::Gauge, "recorder_ready", "1 once the index is in line with the files.", flag(recorder.ready()));
    out.one(Type::Gauge, "recorder_queued_bytes", "Waiting to be written.", recorder.queued_bytes() as f64);
    let refused = recorder.refused() as f64;
    out.one(
        Type::Counter,
        "recorder_refused_total",
        "Batches that found its queue full; they are asked for again.",
        refused,
    );
    let aside = recorder.set_aside().len() as f64;
    out.one(Type::Gauge, "recorder_set_aside", "Damaged files put aside since the start.", aside);
    if let Some(identity) = &app.config.link_identity {
        let refused = identity.refused() as f64;
        out.one(Type::Counter, "link_refused_total", "Agents refused for their certificates.", refused);
        let broken = identity.broken_off() as f64;
        out.one(Type::Counter, "link_handshakes_broken_off_total", "Connections that never said who they are.", broken);
    }
}

fn fleet_figures(app: &App, out: &mut Metrics) {
    let Some(fleet) = app.fleet.shown() else { return };
    let flag = |error: Option<String>| f64::from(u8::from(error.is_none()));
    if fleet.archive.is_some() {
        out.one(Type::Gauge, "fleet_waiting", "Flights not in the shared archive yet.", fleet.waiting as f64);
        out.one(Type::Gauge, "fleet_archive_reached", "1 while it is reached.", flag(fleet.archive_error));
    }
    if let Some(grounds) = fleet.grounds {
        out.one(Type::Gauge, "fleet_grounds", "Other grounds that are heard.", grounds.len() as f64);
        out.one(Type::Gauge, "fleet_live", "1 while they can be heard.", flag(fleet.live_error));
    }
}

fn queue_figures(app: &App, out: &mut Metrics) {
    let counts = &app.counts;
    out.one(Type::Gauge, "viewers", "Live views.", app.viewers.count() as f64);
    out.one(Type::Gauge, "viewer_queued_bytes", "Waiting for live views.", app.hub.queued_bytes() as f64);
    let dropped = app.hub.dropped() as f64;
    out.one(Type::Counter, "viewer_dropped_total", "Messages that live views were too slow for.", dropped);
    let dropped = counts.foxglove_dropped.load(Ordering::Relaxed) as f64;
    out.one(Type::Counter, "foxglove_dropped_total", "Samples that Foxglove clients were too slow for.", dropped);
    let refused = counts.mavlink_refused.load(Ordering::Relaxed) as f64;
    out.one(Type::Counter, "mavlink_refused_total", "MAVLink messages not signed with the configured key.", refused);
    let waiting = app.commands.waiting() as f64;
    out.one(Type::Gauge, "commands_waiting", "Commands that wait for acknowledgements.", waiting);
    out.one(Type::Gauge, "downloads_open", "Downloads that go on.", app.downloads.count() as f64);
    let running = f64::from(u8::from(app.experiments.running()));
    out.one(Type::Gauge, "experiments_running", "Experiments flown here now.", running);
    let classes = CLASSES.iter().zip(&counts.requests);
    let requests = classes.map(|(class, count)| ("status", *class, count.load(Ordering::Relaxed) as f64));
    out.family(Type::Counter, "http_requests_total", "Requests answered, by class of status.", requests);
}

/// What one vehicle's figure is made of.
struct Seen {
    id: String,
    link: v1::LinkStatus,
    recording: v1::RecordingStatus,
    status: Option<v1::Status>,
    secure: Option<v1::SecureStatus>,
}

type Figure = (Type, &'static str, &'static str, fn(&Seen) -> Option<f64>);

const FIGURES: &[Figure] = &[
    (Type::Gauge, "vehicle_connected", "1 while its link is up.", |s| Some(f64::from(u8::from(s.link.connected)))),
    (Type::Gauge, "link_age_seconds", "Since the newest message was sensed.", |s| Some(s.link.age_ms * 1e-3)),
    (Type::Gauge, "link_round_trip_seconds", "Round trip.", |s| Some(s.link.round_trip_ms * 1e-3)),
    (Type::Gauge, "link_clock_offset_seconds", "Ground's clock less agent's.", |s| Some(s.link.clock_offset_us * 1e-6)),
    (Type::Gauge, "link_rate_hertz", "Control messages received a second.", |s| Some(s.link.rate_hz)),
    (Type::Gauge, "link_loss_ratio", "Lost over the last second.", |s| Some(s.link.loss_percent * 1e-2)),
    (Type::Counter, "link_received_total", "Messages received.", |s| Some(s.link.received as f64)),
    (Type::Gauge, "recording", "1 while a flight is recorded.", |s| Some(f64::from(u8::from(s.recording.recording)))),
    (Type::Gauge, "recording_missing", "Messages of this flight not here yet.", |s| Some(s.recording.missing as f64)),
    (Type::Gauge, "armed", "1 while armed.", |s| Some(f64::from(u8::from(s.status.as_ref()?.armed)))),
    (Type::Gauge, "battery_volts", "Battery.", |s| Some(s.status.as_ref()?.battery_v)),
    (Type::Gauge, "tick_rate_hertz", "Ticks a second.", |s| Some(s.status.as_ref()?.tick_rate_hz)),
    (Type::Gauge, "tick_p50_seconds", "Work in a tick, median.", |s| Some(s.status.as_ref()?.tick_time_p50_us * 1e-6)),
    (Type::Gauge, "tick_p99_seconds", "Work in a tick, 99 %.", |s| Some(s.status.as_ref()?.tick_time_p99_us * 1e-6)),
    (Type::Gauge, "tick_jitter_p99_seconds", "Start less due, 99 %.", |s| {
        Some(s.status.as_ref()?.tick_jitter_p99_us * 1e-6)
    }),
    (Type::Counter, "tick_deadline_misses_total", "Late ticks.", |s| Some(s.status.as_ref()?.deadline_misses as f64)),
    (Type::Counter, "telemetry_dropped_total", "Messages that the agent's radio queue gave up.", |s| {
        Some(s.status.as_ref()?.telemetry_dropped as f64)
    }),
    (Type::Gauge, "decoder_seconds", "Decode and identify, last window.", |s| {
        Some(s.secure.as_ref()?.solve_time_us * 1e-6)
    }),
    (Type::Gauge, "decoder_gap_ratio", "Certified gap of the last window.", |s| Some(s.secure.as_ref()?.gap)),
    (Type::Gauge, "attacked_sensors", "Sensors in the attacked set.", |s| {
        Some(s.secure.as_ref()?.sensors.iter().filter(|sensor| sensor.flagged).count() as f64)
    }),
];

fn vehicle_figures(app: &App, out: &mut Metrics) {
    let seen = |id: String| {
        Some(Seen {
            link: app.hub.link_status(&id)?,
            recording: app.recorder.status(&id),
            status: app.hub.latest(&id, Kind::Status),
            secure: app.hub.latest(&id, Kind::Secure),
            id,
        })
    };
    let all: Vec<Seen> = app.hub.ids().into_iter().filter_map(seen).collect();
    for (kind, name, help, of) in FIGURES {
        let samples = all.iter().filter_map(|seen| Some(("vehicle", seen.id.as_str(), of(seen)?)));
        out.family(*kind, name, help, samples);
    }
}
