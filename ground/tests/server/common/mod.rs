//! A ground on port 0 in a temporary folder, an agent made of two channels, and small clients.
#![allow(dead_code)]

pub mod agent;
pub mod servers;
pub mod viewer;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub use agent::Agent;
use plumbline_ground::GroundConfig;
use plumbline_ground::agent_link::LinkEvent;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use viewer::Viewer;

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
        self.request_with(method, path, "application/json", body.as_bytes(), headers).await
    }

    /// The same with a body of any kind.
    pub async fn request_with(
        &self,
        method: &str,
        path: &str,
        kind: &str,
        body: &[u8],
        headers: &[(&str, &str)],
    ) -> Response {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let mut text = format!(
            "{method} {path} HTTP/1.1\r\nconnection: close\r\ncontent-type: {kind}\r\ncontent-length: {}\r\n",
            body.len()
        );
        if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("host")) {
            text += &format!("host: {}\r\n", self.address);
        }
        for (name, value) in headers {
            text += &format!("{name}: {value}\r\n");
        }
        // At once: a server that refuses before the rest of a request came resets the connection, and its answer may be lost.
        let _ = stream.write_all(&[text.as_bytes(), b"\r\n", body].concat()).await;
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

    /// A figure without labels, or with them as they are told.
    pub async fn figure(&self, name: &str) -> f64 {
        let text = self.get("/metrics").await.text();
        let told = text.lines().find_map(|line| line.strip_prefix("plumbline_")?.strip_prefix(name)?.strip_prefix(' '));
        told.unwrap_or_else(|| panic!("no {name} in {text}")).parse().unwrap()
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

    /// Waits until it says that it is ready: before that its index of flights may lack some.
    pub async fn wait_ready(&self) {
        let start = Instant::now();
        while self.get("/readyz").await.status != 200 {
            assert!(start.elapsed() < PATIENCE, "{}", self.get("/readyz").await.text());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub async fn view(&self, vehicle: &str, history: u32) -> Viewer {
        let url = format!("ws://{}/api/v1/vehicles/{vehicle}/live?history={history}", self.address);
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
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{}", self.text());
        self.json()["detail"].as_str().unwrap_or_else(|| panic!("no detail in {}", self.text())).to_owned()
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
