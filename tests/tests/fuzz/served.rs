//! The whole ground, served to one test: agents that say odd things in any order, requests with odd bodies, restarts.

use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use arbitrary::{Result, Unstructured};
use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig, CommandSender, LinkEvent};
use plumbline_ground::{GroundConfig, GroundError, access_table};
use plumbline_link::tls::Purpose;
use plumbline_link::{identity, pairing, tls};
use plumbline_proto::{Kind, Message as _, codec, v1};
use plumbline_tests::harness::http::Api;
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use super::engine::{Scratch, drawn, panics};
use super::odd;

/// No answer, restart or end takes longer.
const PATIENCE: Duration = Duration::from_secs(8);

fn runtime() -> Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

/// A ground within this process.
struct Ground {
    api: Api,
    link: mpsc::Sender<LinkEvent>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<std::result::Result<(), GroundError>>,
}

impl Ground {
    fn start(runtime: &Runtime, data: &Path) -> Self {
        let mut config = GroundConfig::new(data);
        config.settle_after = Duration::from_millis(10);
        config.backfill_after = Duration::from_millis(2);
        config.command_timeout = Duration::from_millis(5);
        config.reserve_bytes = 0;
        let (link, events) = mpsc::channel(4096);
        let (stop, stopped) = oneshot::channel::<()>();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let api = Api { address: listener.local_addr().unwrap(), operator: "fuzz".into() };
            let run = plumbline_ground::run(config, listener, events, async move { drop(stopped.await) });
            Self { api, link, stop, task: tokio::spawn(run) }
        })
    }

    fn stop(self, runtime: &Runtime) {
        self.stop.send(()).unwrap();
        let ended = runtime.block_on(async { tokio::time::timeout(PATIENCE, self.task).await });
        ended.expect("the ground ends").unwrap().unwrap();
    }

    fn send(&self, event: LinkEvent) {
        self.link.blocking_send(event).unwrap();
    }

    /// Asks; an answer comes, and it is no fault of the ground. 503 and 504 tell of a vehicle that is not there.
    fn ask(&self, method: &str, path: &str, body: &Value) {
        let body = (method != "GET").then(|| body.to_string().into_bytes());
        let reply = self.api.request(&method.to_uppercase(), path, body.as_deref(), &[]);
        let reply = reply.unwrap_or_else(|error| panic!("{method} {path}: {error}"));
        let known = reply.status < 500 || matches!(reply.status, 503 | 504);
        assert!(known, "{method} {path} {body:?}: {} {}", reply.status, reply.text());
    }

    /// Whatever was recorded is listed and comes out in every form.
    fn read_all(&self) {
        let begun = Instant::now();
        let flights = loop {
            let list = self.api.get_json("/api/v1/flights?limit=1000").unwrap();
            if list["ready"] == true {
                break list["flights"].as_array().unwrap().clone();
            }
            assert!(begun.elapsed() < PATIENCE, "the flights are not ready: {list}");
            std::thread::sleep(Duration::from_millis(2));
        };
        for flight in flights {
            let id = flight["id"].as_str().unwrap();
            for form in ["", "/mcap", "/csv", "/frames", "/csv?topic=/status", "/estimate?estimator=ekf_bias"] {
                self.ask("GET", &format!("/api/v1/flights/{id}{form}"), &Value::Null);
            }
        }
        for vehicle in ["iris-1", "iris-2"] {
            for view in ["history?seconds=60", "gains", "gains/export", "lease", "calibration"] {
                self.ask("GET", &format!("/api/v1/vehicles/{vehicle}/{view}"), &Value::Null);
            }
        }
    }
}

/// An agent, as the recorder's state machine meets it.
struct Agent {
    id: &'static str,
    boot_id: u64,
    next: u64,
    /// Kept open, so that commands wait for an answer that does not come.
    _down: Option<plumbline_ground::agent_link::CommandReceiver>,
}

impl Agent {
    fn act(&mut self, u: &mut Unstructured<'_>, ground: &Ground) -> Result<()> {
        let agent_id = self.id.to_owned();
        let event = match u.int_in_range(0..=9)? {
            0 | 1 => {
                let (commands, down) = CommandSender::channel();
                self._down = Some(down);
                if u.ratio(1, 2)? {
                    (self.boot_id, self.next) = (u.int_in_range(0..=3)?, 0);
                }
                let boot_wall_time_us = odd::count(u)?;
                LinkEvent::Connected {
                    agent_id,
                    boot_id: self.boot_id,
                    boot_wall_time_us,
                    version: odd::text(u)?,
                    commands,
                }
            }
            2 => LinkEvent::Disconnected { agent_id, reason: odd::text(u)? },
            3 => LinkEvent::Stats { agent_id, round_trip_ms: odd::number(u)?, clock_offset_us: odd::number(u)? },
            4 => {
                let request = v1::BackfillRequest {
                    flight_id: odd::text(u)?,
                    first_sequence: odd::count(u)?,
                    last_sequence: odd::count(u)?,
                };
                LinkEvent::BackfillUnavailable { agent_id, request }
            }
            kind => {
                let mut batch = Vec::new();
                codec::begin_batch(&mut batch);
                for _ in 0..u.int_in_range(1..=12)? {
                    odd::frame(u, &mut self.next, &mut batch)?;
                    if u.ratio(1, 4)? {
                        self.mark(u, &mut batch)?;
                    }
                }
                let backfill = kind == 5;
                let Ok(batch) = codec::Batch::parse(batch.into()) else { return Ok(()) };
                LinkEvent::Batch { agent_id, batch, received: Instant::now(), backfill }
            }
        };
        ground.send(event);
        Ok(())
    }

    /// A flight begins or ends, more or less as it should.
    fn mark(&mut self, u: &mut Unstructured<'_>, out: &mut Vec<u8>) -> Result<()> {
        self.next = self.next.wrapping_add(1);
        let template = odd::message(u, Kind::Flight.message_name())?;
        let mut mark = v1::FlightMark::decode(template.as_slice()).unwrap_or_default();
        if u.ratio(3, 4)? {
            mark.flight_id = (*u.choose(&["f-1", "f-2"])?).to_owned();
            mark.first_sequence = if u.ratio(3, 4)? { self.next } else { u.int_in_range(0..=self.next.min(1 << 20))? };
            mark.last_sequence = u.ratio(1, 2)?.then_some(self.next);
        }
        codec::encode_message(out, Kind::Flight, 0, self.next, self.next.saturating_mul(5000), &mark);
        Ok(())
    }
}

/// A body that a route takes.
fn template(path: &str) -> Value {
    let attack = json!({ "sensor": "height", "instance": 2, "channel": "all", "kind": "bias", "start_s": 1.0,
        "duration_s": 5.0, "magnitude": 0.3, "seed": 1 });
    match path.rsplit('/').next().unwrap_or_default() {
        "mode" => json!({ "mode": "altitude_hold" }),
        "estimator" => json!({ "estimator": "secure" }),
        "decoder" => json!({ "decoder": "newton" }),
        "recording" => json!({ "on": true }),
        "replay" => json!({ "speed": 1.0, "step": 1 }),
        "simulator" => json!({ "battery": true, "reset": false }),
        "setpoint" => json!({ "altitude_m": 0.5, "x_m": 0.0, "roll_rad": 0.1, "throttle": 0.5 }),
        "attacks" => json!({ "attacks": [attack] }),
        "gains" => json!({ "state_weight": vec![1.0; 16], "input_weight": vec![0.5; 4] }),
        "preview" => json!({ "airframe": "iris", "state_weight": vec![1.0; 16], "input_weight": vec![0.5; 4] }),
        "revert" => json!({ "revision": 1 }),
        "trajectory" => json!({ "shape": "altitudes", "altitude_m": [0.5, 1.0], "hold_s": 2.0 }),
        "calibrations" => json!({ "kind": "motor_curve", "csv": "command,speed_radps\n0.1,100\n0.5,500\n1,900\n",
            "name": "curve", "from_s": 0.0, "to_s": 9.0 }),
        "people" => json!({ "name": "bob", "role": "viewer", "password": "short" }),
        "session" => json!({ "name": "bob", "password": "wrong" }),
        "pairing" => json!({ "code": "ABCD-EFGH" }),
        _ => json!({ "name": "a flight", "notes": "of ours" }),
    }
}

fn request(u: &mut Unstructured<'_>, ground: &Ground) -> Result<()> {
    let table = access_table();
    let (method, path, _) = table[u.choose_index(table.len())?];
    let id = match u.int_in_range(0..=7)? {
        0 => "%2e%2e%2fx",
        1 => "nobody",
        2 => "%ff%fe",
        _ if path.contains("vehicles") => "iris-1",
        _ => "f-1",
    };
    let mut asked = path.replace("{id}", id);
    if path.ends_with("/live") {
        return Ok(());
    }
    if method == "get" && u.ratio(1, 2)? {
        let key = *u.choose(&["history", "seconds", "topic", "kinds", "revision", "estimator", "sensors", "limit"])?;
        let value = match u.int_in_range(0..=3)? {
            0 => odd::count(u)?.to_string(),
            1 => odd::number(u)?.to_string(),
            2 => "secure".into(),
            _ => "%00%ff,,".into(),
        };
        asked = format!("{asked}?{key}={value}");
    }
    // A calibration's table is read by rows, the others by JSON.
    ground.ask(method, &asked, &odd::json(u, &template(path))?);
    Ok(())
}

#[test]
fn fuzz_ground() {
    let (scratch, runtime, before) = (Scratch::new(), runtime(), panics());
    drawn("ground", |u| {
        let folder = tempfile::tempdir_in(scratch.folder.path()).unwrap();
        let mut serving = Some(Ground::start(&runtime, folder.path()));
        let mut agents = ["iris-1", "iris-2"].map(|id| Agent { id, boot_id: 1, next: 0, _down: None });
        while !u.is_empty() {
            let ground = serving.get_or_insert_with(|| Ground::start(&runtime, folder.path()));
            let Ok(choice) = u.int_in_range(0..=15) else { break };
            let mut step = Ok(());
            match choice {
                0..=9 => step = agents[usize::from(u.ratio(1, 4).unwrap_or(false))].act(u, ground),
                10..=13 => step = request(u, ground),
                14 => ground.read_all(),
                _ => serving.take().into_iter().for_each(|ground| ground.stop(&runtime)),
            }
            if step.is_err() {
                break;
            }
        }
        if let Some(ground) = serving {
            ground.read_all();
            ground.stop(&runtime);
        }
        // What it left is found again.
        let ground = Ground::start(&runtime, folder.path());
        ground.read_all();
        ground.stop(&runtime);
        assert_eq!(panics(), before, "a thread of the ground panicked");
    });
}

#[test]
fn fuzz_pairing() {
    let (scratch, runtime, before) = (Scratch::new(), runtime(), panics());
    let ours = identity::load_or_create(&scratch.folder.path().join("ground")).unwrap();
    let theirs = identity::load_or_create(&scratch.folder.path().join("agent")).unwrap();
    let (address, _link) = runtime.block_on(async {
        let link = AgentLink::bind(AgentLinkConfig::new(([127, 0, 0, 1], 0).into(), ours.clone())).unwrap();
        let address = link.local_addr();
        let (events, mut taken) = mpsc::channel(4096);
        tokio::spawn(async move { while taken.recv().await.is_some() {} });
        (address, tokio::spawn(link.run(events, std::future::pending())))
    });
    drawn("pairing", |u| {
        pairing::expect(ours.folder(), &pairing::Code::random().unwrap()).unwrap();
        let _ = runtime.block_on(async { tokio::time::timeout(PATIENCE, stranger(u, &theirs, address)).await });
        assert!(ours.peer(theirs.fingerprint()).is_none(), "paired without the code");
        assert_eq!(panics(), before, "a thread of the ground panicked");
    });
}

/// Whoever does not know the code, and says whatever comes to mind.
async fn stranger(u: &mut Unstructured<'_>, identity: &identity::Identity, ground: SocketAddr) {
    let purpose = if u.ratio(1, 4).unwrap_or(false) { Purpose::Telemetry } else { Purpose::Pairing };
    let endpoint = quinn::Endpoint::client(([127, 0, 0, 1], 0).into()).unwrap();
    let crypto = std::sync::Arc::new(tls::client(identity, purpose).unwrap());
    let Ok(connecting) = endpoint.connect_with(quinn::ClientConfig::new(crypto), ground, tls::SERVER_NAME) else {
        return;
    };
    let Ok(connection) = connecting.await else { return };
    let Ok((mut send, mut receive)) = connection.open_bi().await else { return };
    for _ in 0..u.int_in_range(1..=5).unwrap_or(1) {
        let mut out = Vec::new();
        let Ok(body) = frame(u) else { break };
        codec::encode_delimited(&mut out, &v1::CommandFrame { body: Some(body) });
        if u.ratio(1, 12).unwrap_or(false) {
            out.truncate(out.len() / 2);
        }
        if send.write_all(&out).await.is_err() {
            break;
        }
    }
    let _ = send.finish();
    let _ = tokio::time::timeout(Duration::from_millis(20), receive.read_chunk(1 << 16, true)).await;
    connection.close(0_u32.into(), b"");
    endpoint.wait_idle().await;
}

fn frame(u: &mut Unstructured<'_>) -> Result<v1::command_frame::Body> {
    use v1::command_frame::Body;
    Ok(match u.int_in_range(0..=5)? {
        0 | 1 => {
            let hello = odd::message(u, "plumbline.v1.Hello")?;
            let mut hello = v1::Hello::decode(hello.as_slice()).unwrap_or_default();
            hello.schema = if u.ratio(5, 6)? { u32::from(plumbline_proto::SCHEMA) } else { hello.schema };
            Body::Hello(hello)
        }
        2..=4 => {
            let length = *u.choose(&[0, 1, 31, 32, 33, 34, 64, 5000])?;
            Body::PairingProof(v1::PairingProof { proof: (0..length).map(|_| u.arbitrary()).collect::<Result<_>>()? })
        }
        _ => Body::Heartbeat(v1::Heartbeat { ground_time_us: odd::count(u)?, agent_time_us: Some(odd::count(u)?) }),
    })
}
