//! A client that is signed in, plain or by TLS, as slow or as rude as a load wants it.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustls::pki_types::{CertificateDer, pem::PemObject as _};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use serde_json::Value;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{WebSocket, client};

pub const PASSWORD: &str = "a long enough password";
const LIMIT: Duration = Duration::from_secs(10);

/// A connection.
pub trait Stream: Read + Write + Send {}
impl<S: Read + Write + Send> Stream for S {}

/// Who is signed in where.
#[derive(Clone)]
pub struct Client {
    pub address: SocketAddr,
    /// The ground's data folder.
    pub data: PathBuf,
    /// Cookie of whoever flies.
    pub pilot: String,
    /// Cookies of the others.
    pub crowd: Vec<String>,
    tls: Option<Arc<ClientConfig>>,
}

impl Client {
    pub fn plain(address: SocketAddr, data: &Path, crowd: usize) -> Self {
        Self::signed_in(address, data, crowd, None)
    }

    /// Trusts exactly the ground's own certificate.
    pub fn by_tls(address: SocketAddr, data: &Path, crowd: usize) -> Self {
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_file(data.join("tls/cert.pem")).unwrap()).unwrap();
        let config = ClientConfig::builder_with_provider(rustls::crypto::ring::default_provider().into())
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        Self::signed_in(address, data, crowd, Some(Arc::new(config)))
    }

    fn signed_in(address: SocketAddr, data: &Path, crowd: usize, tls: Option<Arc<ClientConfig>>) -> Self {
        let mut client = Self { address, data: data.to_owned(), pilot: String::new(), crowd: Vec::new(), tls };
        client.pilot = client.sign_in("pilot", PASSWORD).expect("a session");
        client.crowd =
            (0..crowd).map(|n| client.sign_in(&format!("crowd-{n}"), PASSWORD).expect("a session")).collect();
        client
    }

    /// The cookie of a new session.
    pub fn sign_in(&self, name: &str, password: &str) -> Option<String> {
        let body = serde_json::json!({ "name": name, "password": password }).to_string();
        let answer = self.exchange(&self.request("POST", "/api/v1/session", "", &body)).ok()?;
        let line = answer.lines().find(|line| line.to_ascii_lowercase().starts_with("set-cookie:"))?;
        Some(line.split_once(':')?.1.trim().split(';').next()?.to_owned())
    }

    /// A command of the pilot: status and body; `None` when there is no answer.
    pub fn command(&self, route: &str, body: &Value) -> Option<(u16, String)> {
        let path = format!("/api/v1/vehicles/iris-1/{route}");
        parse(&self.exchange(&self.request("POST", &path, &self.pilot, &body.to_string())).ok()?)
    }

    pub fn get(&self, path: &str, cookie: &str) -> Option<(u16, String)> {
        parse(&self.exchange(&self.request("GET", path, cookie, "")).ok()?)
    }

    /// The bytes of a request.
    pub fn request(&self, method: &str, path: &str, cookie: &str, body: &str) -> String {
        format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nOrigin: {}\r\nCookie: {cookie}\r\nConnection: close\r\n\
             X-Plumbline-Operator: page\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
            self.address,
            self.origin(),
            body.len()
        )
    }

    fn origin(&self) -> String {
        format!("{}://{}", if self.tls.is_some() { "https" } else { "http" }, self.address)
    }

    pub fn open(&self) -> io::Result<Box<dyn Stream>> {
        let stream = TcpStream::connect_timeout(&self.address, LIMIT)?;
        stream.set_read_timeout(Some(LIMIT))?;
        stream.set_nodelay(true)?;
        let Some(tls) = &self.tls else { return Ok(Box::new(stream)) };
        let connection = ClientConnection::new(tls.clone(), "localhost".try_into().unwrap());
        Ok(Box::new(StreamOwned::new(connection.map_err(io::Error::other)?, stream)))
    }

    /// Sends a request and reads to the end.
    pub fn exchange(&self, request: &str) -> io::Result<String> {
        let mut stream = self.open()?;
        stream.write_all(request.as_bytes())?;
        let mut answer = Vec::new();
        let read = stream.read_to_end(&mut answer);
        if answer.is_empty() {
            read?;
        }
        Ok(String::from_utf8_lossy(&answer).into_owned())
    }

    pub fn socket(&self, path: &str, cookie: &str) -> Option<WebSocket<Box<dyn Stream>>> {
        let mut request = format!("{}{path}", self.origin().replacen("http", "ws", 1)).into_client_request().ok()?;
        request.headers_mut().insert("origin", self.origin().parse().ok()?);
        request.headers_mut().insert("cookie", cookie.parse().ok()?);
        client(request, self.open().ok()?).ok().map(|(socket, _)| socket)
    }
}

fn parse(answer: &str) -> Option<(u16, String)> {
    let (head, body) = answer.split_once("\r\n\r\n")?;
    Some((head.split(' ').nth(1)?.parse().ok()?, body.to_owned()))
}
