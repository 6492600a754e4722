//! A ground on port 0 in a temporary folder, an agent made of two channels, and small clients.
#![allow(dead_code)]

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::future::Future;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use plumbline_ground::GroundConfig;
use plumbline_ground::agent_link::{CommandReceiver, CommandSender, LinkEvent, Outgoing};
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::{Kind, Message, v1};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest};

/// How long a test waits for something that must happen.
pub const PATIENCE: Duration = Duration::from_secs(20);

pub struct Ground {
    pub address: SocketAddr,
    pub link: mpsc::Sender<LinkEvent>,
    pub data: PathBuf,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<Result<(), plumbline_ground::GroundError>>,
}

impl Ground {
    pub async fn start(data: &Path) -> Self {
        let mut config = GroundConfig::new(data);
        config.settle_after = Duration::from_millis(700);
        config.backfill_after = Duration::from_millis(100);
        config.reserve_bytes = 1;
        Self::start_with(config).await
    }

    pub async fn start_with(config: GroundConfig) -> Self {
        Self::start_on(config, "127.0.0.1:0").await
    }

    pub async fn start_on(config: GroundConfig, address: &str) -> Self {
        let listener = TcpListener::bind(address).await.unwrap();
        let address = listener.local_addr().unwrap();
        let (link, events) = mpsc::channel(4096);
        let (stop, stopped) = oneshot::channel::<()>();
        let data = config.data_folder.clone();
        let task = tokio::spawn(plumbline_ground::run(config, listener, events, async move {
            let _ = stopped.await;
        }));
        Self { address, link, data, stop: Some(stop), task }
    }

    pub async fn stop(mut self) {
        self.stop.take().unwrap().send(()).unwrap();
        tokio::time::timeout(PATIENCE, self.task).await.unwrap().unwrap().unwrap();
    }

    pub async fn send(&self, event: LinkEvent) {
        self.link.send(event).await.unwrap();
    }

    pub async fn agent(&self, id: &str, boot_id: u64) -> Agent {
        Agent::connect(self.link.clone(), id, boot_id).await
    }

    pub async fn request(&self, method: &str, path: &str, body: &str) -> Response {
        self.request_as(method, path, body, &[]).await
    }

    pub async fn request_as(&self, method: &str, path: &str, body: &str, headers: &[(&str, &str)]) -> Response {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let mut text = format!(
            "{method} {path} HTTP/1.1\r\nconnection: close\r\ncontent-type: application/json\r\ncontent-length: {}\r\n",
            body.len()
        );
        if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("host")) {
            text += &format!("host: {}\r\n", self.address);
        }
        for (name, value) in headers {
            text += &format!("{name}: {value}\r\n");
        }
        stream.write_all(format!("{text}\r\n{body}").as_bytes()).await.unwrap();
        let mut raw = Vec::new();
        // A server that refuses a large body may reset the connection after its answer.
        let _ = stream.read_to_end(&mut raw).await;
        Response::parse(&raw)
    }

    pub async fn get(&self, path: &str) -> Response {
        self.request("GET", path, "").await
    }

    pub async fn json(&self, path: &str) -> serde_json::Value {
        let response = self.get(path).await;
        assert_eq!(response.status, 200, "{path}: {}", response.text());
        response.json()
    }

    /// Asks `path` until `done` says so.
    pub async fn wait_json(&self, path: &str, done: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
        let start = Instant::now();
        loop {
            let response = self.get(path).await;
            let last = if response.status == 200 { response.json() } else { serde_json::Value::Null };
            if done(&last) {
                return last;
            }
            assert!(start.elapsed() < PATIENCE, "{path} stays {last:#} ({})", response.status);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub async fn view(&self, vehicle: &str, history: u32) -> Viewer {
        let url = format!("ws://{}/api/vehicles/{vehicle}/live?history={history}", self.address);
        // The agent's connection may still be on its way to the hub: unknown until then.
        let start = Instant::now();
        loop {
            match Viewer::connect(&url, None).await {
                Ok(viewer) => return viewer,
                Err(error) => assert!(start.elapsed() < PATIENCE, "{url}: {error}"),
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}

pub struct Response {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Response {
    pub fn parse(raw: &[u8]) -> Self {
        let end = raw.windows(4).position(|w| w == b"\r\n\r\n").expect("an HTTP answer");
        let head = String::from_utf8(raw[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let mut body = raw[end + 4..].to_vec();
        if head.to_ascii_lowercase().contains("transfer-encoding: chunked") {
            body = unchunk(&body);
        }
        Self { status, head, body }
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().find_map(|line| {
            let (key, value) = line.split_once(':')?;
            key.eq_ignore_ascii_case(name).then(|| value.trim())
        })
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }

    pub fn error(&self) -> String {
        self.json()["error"].as_str().unwrap_or_else(|| panic!("no error in {}", self.text())).to_owned()
    }
}

fn unchunk(mut body: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    loop {
        let end = body.windows(2).position(|w| w == b"\r\n").expect("chunk size");
        let size = usize::from_str_radix(std::str::from_utf8(&body[..end]).unwrap().trim(), 16).unwrap();
        if size == 0 {
            return out;
        }
        out.extend_from_slice(&body[end + 2..end + 2 + size]);
        body = &body[end + 2 + size + 2..];
    }
}

/// Sends a request and reads to the end.
pub async fn exchange(
    stream: &mut (impl tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin),
    request: &str,
) -> Vec<u8> {
    let _ = stream.write_all(request.as_bytes()).await;
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer).await;
    answer
}

/// A connection by TLS that trusts exactly `certificate`.
pub async fn tls(ground: &Ground, certificate: &Path) -> tokio_rustls::client::TlsStream<TcpStream> {
    use rustls::pki_types::{CertificateDer, pem::PemObject as _};
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(certificate).unwrap()).unwrap();
    let config = rustls::ClientConfig::builder_with_provider(rustls::crypto::ring::default_provider().into())
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let stream = TcpStream::connect(("127.0.0.1", ground.address.port())).await.unwrap();
    let connector = tokio_rustls::TlsConnector::from(std::sync::Arc::new(config));
    connector.connect("localhost".try_into().unwrap(), stream).await.unwrap()
}

/// One message as a viewer or a test sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Got {
    pub kind: Option<Kind>,
    pub instance: u16,
    pub sequence: u64,
    pub time_us: u64,
    pub payload: Vec<u8>,
}

impl Got {
    pub fn message<M: Message + Default>(&self) -> M {
        M::decode(self.payload.as_slice()).unwrap()
    }
}

pub fn frames(batch: &[u8]) -> Vec<Got> {
    codec::decode_batch(batch)
        .unwrap()
        .map(|frame| {
            let frame = frame.unwrap();
            Got {
                kind: frame.known_kind(),
                instance: frame.instance,
                sequence: frame.sequence,
                time_us: frame.time_us,
                payload: frame.payload.to_vec(),
            }
        })
        .collect()
}

type Socket = tokio_tungstenite::WebSocketStream<tokio_tungstenite::MaybeTlsStream<TcpStream>>;

pub struct Viewer {
    pub socket: Socket,
    ready: VecDeque<Got>,
}

impl Viewer {
    pub async fn connect(url: &str, origin: Option<&str>) -> Result<Self, tungstenite::Error> {
        Self::connect_as(url, origin, None).await
    }

    pub async fn connect_as(url: &str, origin: Option<&str>, cookie: Option<&str>) -> Result<Self, tungstenite::Error> {
        let mut request = url.into_client_request()?;
        if let Some(cookie) = cookie {
            request.headers_mut().insert("cookie", cookie.parse().unwrap());
        }
        if let Some(origin) = origin {
            request.headers_mut().insert("origin", origin.parse().unwrap());
        }
        let (socket, _) = tokio_tungstenite::connect_async(request).await?;
        Ok(Self { socket, ready: VecDeque::new() })
    }

    pub async fn next(&mut self) -> Got {
        while self.ready.is_empty() {
            let message = tokio::time::timeout(PATIENCE, self.socket.next()).await.expect("a message in time");
            match message.expect("an open socket").unwrap() {
                tungstenite::Message::Binary(batch) => self.ready.extend(frames(&batch)),
                other => panic!("{other:?}"),
            }
        }
        self.ready.pop_front().unwrap()
    }

    /// The next message of `kind`; others are passed over.
    pub async fn next_of(&mut self, kind: Kind) -> Got {
        loop {
            let got = self.next().await;
            if got.kind == Some(kind) {
                return got;
            }
        }
    }

    pub async fn close(mut self) {
        let _ = self.socket.send(tungstenite::Message::Close(None)).await;
    }
}

/// An agent: it numbers its messages, keeps its own log, and answers as it is told.
pub struct Agent {
    pub id: String,
    pub boot_id: u64,
    link: mpsc::Sender<LinkEvent>,
    pub outgoing: CommandReceiver,
    /// The onboard log: every frame ever encoded, with its sequence number.
    pub log: Vec<(u64, Vec<u8>)>,
    pub sequence: u64,
    pub time_us: u64,
    /// What the onboard log has lost.
    pub forgotten: BTreeSet<u64>,
}

pub const BOOT_WALL_US: u64 = 1_700_000_000_000_000;

impl Agent {
    pub async fn connect(link: mpsc::Sender<LinkEvent>, id: &str, boot_id: u64) -> Self {
        let (commands, outgoing) = CommandSender::channel();
        let agent = Self {
            id: id.into(),
            boot_id,
            link,
            outgoing,
            log: Vec::new(),
            sequence: 0,
            time_us: 0,
            forgotten: BTreeSet::new(),
        };
        agent.hello(commands).await;
        agent
    }

    async fn hello(&self, commands: CommandSender) {
        let event = LinkEvent::Connected {
            agent_id: self.id.clone(),
            boot_id: self.boot_id,
            boot_wall_time_us: BOOT_WALL_US,
            version: "test".into(),
            commands,
        };
        self.link.send(event).await.unwrap();
    }

    /// Comes back, to this or another ground, with its log and its count.
    pub async fn reconnect(&mut self, link: mpsc::Sender<LinkEvent>) {
        let (commands, outgoing) = CommandSender::channel();
        self.link = link;
        self.outgoing = outgoing;
        self.hello(commands).await;
    }

    pub async fn disconnect(&mut self) {
        self.outgoing.close();
        let event = LinkEvent::Disconnected { agent_id: self.id.clone(), reason: "test".into() };
        self.link.send(event).await.unwrap();
    }

    /// Encodes one message into the log and returns its sequence number. Nothing is sent.
    pub fn encode<M: Message>(&mut self, kind: Kind, instance: u16, message: &M) -> u64 {
        self.sequence += 1;
        let payload = message.encode_to_vec();
        let mut bytes = Vec::new();
        Frame { kind: kind.to_wire(), instance, sequence: self.sequence, time_us: self.time_us, payload: &payload }
            .encode(&mut bytes);
        self.log.push((self.sequence, bytes));
        self.sequence
    }

    /// Sends frames of the log as one batch.
    pub async fn send(&self, sequences: impl IntoIterator<Item = u64>, backfill: bool) {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        for sequence in sequences {
            let (found, bytes) = &self.log[sequence as usize - 1];
            assert_eq!(*found, sequence);
            batch.extend_from_slice(bytes);
        }
        let event = LinkEvent::Batch {
            agent_id: self.id.clone(),
            batch: Bytes::from(batch),
            received: Instant::now(),
            backfill,
        };
        self.link.send(event).await.unwrap();
    }

    /// Encodes and sends at once.
    pub async fn say<M: Message>(&mut self, kind: Kind, instance: u16, message: &M) -> u64 {
        let sequence = self.encode(kind, instance, message);
        self.send([sequence], false).await;
        sequence
    }

    /// One tick of 5 ms: control, estimate, one height. Returns the sequence numbers, unsent.
    pub fn tick(&mut self) -> Vec<u64> {
        self.time_us += 5000;
        let t = self.time_us as f64 * 1e-6;
        let control = v1::Control {
            time_us: self.time_us,
            mode: v1::Mode::AltitudeHold as i32,
            armed: true,
            setpoint: Some(v1::Setpoint { altitude_m: Some(0.8), ..Default::default() }),
            thrust_n: 9.81 * t,
            motor_command: vec![0.5; 4],
            motor_applied: vec![0.5; 4],
            integrator: vec![0.0; 4],
            ..Default::default()
        };
        let estimate = v1::Estimate {
            time_us: self.time_us,
            estimator: v1::EstimatorKind::EkfBias as i32,
            in_loop: true,
            position_enu_m: Some(v1::Vector3 { x: 0.0, y: 0.0, z: 0.9 }),
            ..Default::default()
        };
        let height = v1::HeightSample { time_us: self.time_us, sensed_m: 0.81, ..Default::default() };
        vec![
            self.encode(Kind::Control, 0, &control),
            self.encode(Kind::Estimate, 1, &estimate),
            self.encode(Kind::Height, 2, &height),
        ]
    }

    /// So many ticks, sent as they come.
    pub async fn fly(&mut self, ticks: usize) {
        for _ in 0..ticks {
            let tick = self.tick();
            self.send(tick, false).await;
        }
    }

    pub async fn describe(&mut self) {
        let sensor = |instance| v1::SensorDescription {
            kind: v1::SensorKind::Height as i32,
            instance,
            name: format!("height {instance}"),
            ..Default::default()
        };
        let description = v1::Description {
            agent_id: self.id.clone(),
            agent_version: "test 1".into(),
            schema: 1,
            vehicle: "sim".into(),
            airframe: "iris".into(),
            rig: "strings".into(),
            seed: 7,
            sensors: (1..=3).map(sensor).collect(),
            boot_wall_time_us: BOOT_WALL_US,
            ..Default::default()
        };
        self.say(Kind::Description, 0, &description).await;
    }

    /// Opens a flight; its first message is the mark itself.
    pub async fn begin(&mut self, flight_id: &str) -> u64 {
        let first_sequence = self.sequence + 1;
        let mark = v1::FlightMark {
            time_us: self.time_us,
            flight_id: flight_id.into(),
            first_sequence,
            last_sequence: None,
            reason: "armed".into(),
        };
        self.say(Kind::Flight, 0, &mark).await
    }

    /// Encodes the mark that closes a flight and is its last message.
    pub fn end(&mut self, flight_id: &str, first_sequence: u64) -> u64 {
        let mark = v1::FlightMark {
            time_us: self.time_us,
            flight_id: flight_id.into(),
            first_sequence,
            last_sequence: Some(self.sequence + 1),
            reason: "disarmed".into(),
        };
        self.encode(Kind::Flight, 0, &mark)
    }

    /// The next command the ground sent; backfill requests are answered from the log on the way.
    pub async fn command(&mut self) -> v1::Command {
        loop {
            let outgoing = tokio::time::timeout(PATIENCE, self.outgoing.recv()).await.expect("a command in time");
            match outgoing.expect("an open link") {
                Outgoing::Command(command) => return command,
                Outgoing::Backfill(request) => self.backfill(&request).await,
                Outgoing::OperatorAlive(_) | Outgoing::FlightKept(_) => {}
            }
        }
    }

    /// Answers from the log; what it does not hold (any more) is said to be unavailable.
    pub async fn backfill(&mut self, request: &v1::BackfillRequest) {
        let last = request.last_sequence.min(self.sequence);
        let asked = request.first_sequence..=last;
        let (gone, held): (Vec<u64>, Vec<u64>) = asked.partition(|s| self.forgotten.contains(s));
        for piece in held.chunks(200) {
            self.send(piece.iter().copied(), true).await;
        }
        for sequence in gone {
            self.unavailable(request, sequence, sequence).await;
        }
        if request.last_sequence > last {
            self.unavailable(request, request.first_sequence.max(last + 1), request.last_sequence).await;
        }
    }

    async fn unavailable(&self, request: &v1::BackfillRequest, first_sequence: u64, last_sequence: u64) {
        let request = v1::BackfillRequest { first_sequence, last_sequence, ..request.clone() };
        self.link.send(LinkEvent::BackfillUnavailable { agent_id: self.id.clone(), request }).await.unwrap();
    }

    /// Answers backfill requests while `work` goes on.
    pub async fn answering<T>(&mut self, work: impl Future<Output = T>) -> T {
        tokio::pin!(work);
        loop {
            tokio::select! {
                done = &mut work => return done,
                Some(outgoing) = self.outgoing.recv() => if let Outgoing::Backfill(request) = outgoing {
                    self.backfill(&request).await;
                },
            }
        }
    }

    /// Says that a flight goes on (or, with an empty name, that none does).
    pub async fn status(&mut self, flight_id: &str, flight_start_us: u64) {
        let status =
            v1::Status { time_us: self.time_us, flight_id: flight_id.into(), flight_start_us, ..Default::default() };
        self.say(Kind::Status, 0, &status).await;
    }

    /// Messages of each topic that the log holds of `first..=last`.
    pub fn counts(&self, first: u64, last: u64) -> BTreeMap<String, u64> {
        let mut counts = BTreeMap::new();
        for (_, bytes) in self.log.iter().filter(|(s, _)| (first..=last).contains(s)) {
            let frame = codec::decode_frames(bytes).next().unwrap().unwrap();
            *counts.entry(frame.known_kind().unwrap().topic(frame.instance)).or_default() += 1;
        }
        counts
    }

    pub async fn ack(&mut self, command_id: u64, stage: v1::AckStage, reason: &str) {
        let ack = v1::Ack { time_us: self.time_us, command_id, stage: stage as i32, reason: reason.into() };
        self.say(Kind::Ack, 0, &ack).await;
    }

    /// Takes one command and accepts it.
    pub async fn accept(&mut self) -> v1::Command {
        let command = self.command().await;
        self.ack(command.command_id, v1::AckStage::Accepted, "done").await;
        command
    }
}

/// Counts of a flight as its file has them, read by the mcap crate.
pub fn mcap_counts(file: &[u8]) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for message in mcap::MessageStream::new(file).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_default() += 1;
    }
    counts
}

/// Counts of a flight as the API promises them.
pub fn api_counts(flight: &serde_json::Value) -> BTreeMap<String, u64> {
    serde_json::from_value(flight["counts"].clone()).unwrap()
}

/// A copy of a data folder as it is now: what a kill at this moment would leave.
pub fn freeze(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            freeze(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
