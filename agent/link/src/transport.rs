//! Settings of the two QUIC connections, the reasons they are closed with, and framed streams.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use plumbline_proto::DecodeError;
use plumbline_proto::codec::{Delimited, encode_delimited};
use plumbline_proto::v1::{CommandFrame, command_frame::Body};
use quinn::{Connection, ConnectionError, IdleTimeout, RecvStream, SendStream, TransportConfig, VarInt};

use super::tls::Purpose;
use super::window::{CubicAboveFirst, FixedWindowFactory};

/// Silence after which a connection is lost for good. Longer than a fade, so that sending goes on through it
/// and the first packet after it arrives at once; nothing waits for it: failsafes have their own times, a
/// restarted ground says at once that it knows the connection no more, and what comes late is refused
/// (`lateness.rs` of the agent). After a longer fade the agent connects anew (`connect.rs`).
pub const IDLE_TIMEOUT_MS: u32 = 8_000;
/// Largest datagram, batch header included: fits every path of 1200 bytes.
pub const MAX_DATAGRAM: usize = 1_100;
/// Datagrams waiting inside QUIC; the oldest give way.
pub const DATAGRAM_SEND_BUFFER: usize = 16 * 1024;
/// Rate of the ground's heartbeats.
pub const HEARTBEAT_PERIOD: Duration = Duration::from_millis(100);

/// Assumed before the first measurement, so that a lost first packet is repeated after 150 ms
/// instead of a second.
const INITIAL_RTT: Duration = Duration::from_millis(50);
const KEEP_ALIVE: Duration = Duration::from_millis(500);
/// Bytes the ground holds for a hub that is busy; the oldest give way.
const DATAGRAM_RECEIVE_BUFFER: usize = 1 << 20;

/// Why one side closes a connection on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum CloseCode {
    /// This side ends.
    Shutdown = 1,
    /// The peers speak different schemas.
    Schema = 2,
    /// Another agent of this id is connected.
    Duplicate = 3,
    /// The peer broke the protocol.
    Protocol = 4,
    /// The other connection of the pair is gone.
    Companion = 5,
}

impl CloseCode {
    /// Closes `connection` with this code and a reason for people.
    pub fn close(self, connection: &Connection, reason: &str) {
        // QUIC carries the reason in one packet.
        let mut end = reason.len().min(900);
        while !reason.is_char_boundary(end) {
            end -= 1;
        }
        connection.close(VarInt::from_u32(self as u32), reason.get(..end).unwrap_or_default().as_bytes());
    }
}

/// What ended a connection, for people.
pub fn reason(error: &ConnectionError) -> String {
    match error {
        ConnectionError::TimedOut => format!("silent for {:.0} s", f64::from(IDLE_TIMEOUT_MS) * 1e-3),
        ConnectionError::ApplicationClosed(close) => String::from_utf8_lossy(&close.reason).into_owned(),
        ConnectionError::LocallyClosed => "closed by this side".to_owned(),
        other => other.to_string(),
    }
}

/// Where to bind a socket that speaks to `peer`: any port of its address family.
pub fn any_port(peer: SocketAddr) -> SocketAddr {
    match peer {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    }
}

/// Settings of the side that connects. `rate_bytes_per_s` is the telemetry cap.
pub fn client(purpose: Purpose, rate_bytes_per_s: f64) -> Arc<TransportConfig> {
    let mut config = common();
    match purpose {
        Purpose::Telemetry => {
            let outage_s = f64::from(IDLE_TIMEOUT_MS) * 1e-3 * 1.5;
            let window = ((rate_bytes_per_s * outage_s) as u64).max(256 * 1024);
            config
                .datagram_send_buffer_size(DATAGRAM_SEND_BUFFER)
                // None would switch datagrams off both ways; the ground sends none.
                .datagram_receive_buffer_size(Some(2 * MAX_DATAGRAM))
                .mtu_discovery_config(None)
                .congestion_controller_factory(Arc::new(FixedWindowFactory(window)));
        }
        Purpose::Commands | Purpose::Pairing => {
            config.datagram_receive_buffer_size(None).congestion_controller_factory(Arc::new(CubicAboveFirst));
        }
    }
    Arc::new(config)
}

/// Settings of the side that listens.
pub fn server() -> Arc<TransportConfig> {
    let mut config = common();
    config
        .datagram_receive_buffer_size(Some(DATAGRAM_RECEIVE_BUFFER))
        .congestion_controller_factory(Arc::new(CubicAboveFirst));
    Arc::new(config)
}

fn common() -> TransportConfig {
    let mut config = TransportConfig::default();
    config
        .max_idle_timeout(Some(IdleTimeout::from(VarInt::from_u32(IDLE_TIMEOUT_MS))))
        .keep_alive_interval(Some(KEEP_ALIVE))
        .initial_rtt(INITIAL_RTT)
        .max_concurrent_bidi_streams(VarInt::from_u32(2))
        .max_concurrent_uni_streams(VarInt::from_u32(8))
        .stream_receive_window(VarInt::from_u32(1 << 20))
        .receive_window(VarInt::from_u32(4 << 20))
        .send_window(4 << 20);
    config
}

/// Why a stream of [`CommandFrame`]s ended early.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// The connection broke.
    #[error("{}", reason(.0))]
    Connection(#[from] ConnectionError),
    /// The stream broke while reading.
    #[error("reading: {0}")]
    Read(quinn::ReadError),
    /// The stream broke while writing.
    #[error("writing: {0}")]
    Write(quinn::WriteError),
    /// The peer sent what is no [`CommandFrame`].
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The peer sent another frame than the one that is due, or none.
    #[error("expected {expected}, got {found}")]
    Unexpected {
        /// What was due.
        expected: &'static str,
        /// What came.
        found: String,
    },
    /// Nothing came in time.
    #[error("no {expected} within {seconds} s")]
    Timeout {
        /// What was due.
        expected: &'static str,
        /// How long was waited.
        seconds: f64,
    },
}

impl From<quinn::ReadError> for StreamError {
    fn from(error: quinn::ReadError) -> Self {
        match error {
            quinn::ReadError::ConnectionLost(error) => Self::Connection(error),
            other => Self::Read(other),
        }
    }
}

impl From<quinn::WriteError> for StreamError {
    fn from(error: quinn::WriteError) -> Self {
        match error {
            quinn::WriteError::ConnectionLost(error) => Self::Connection(error),
            other => Self::Write(other),
        }
    }
}

/// Reads [`CommandFrame`]s from a stream. Cancel-safe: a frame half read stays.
pub struct FrameReader {
    stream: RecvStream,
    delimited: Delimited,
}

impl FrameReader {
    /// Reads from `stream`.
    pub fn new(stream: RecvStream) -> Self {
        Self { stream, delimited: Delimited::default() }
    }

    /// The next frame's body; `None` when the peer finished the stream. Frames without a known body
    /// (newer than this build) are skipped.
    ///
    /// # Errors
    /// [`StreamError`] when the connection breaks or the bytes are no frames.
    pub async fn next(&mut self) -> Result<Option<Body>, StreamError> {
        loop {
            while let Some(frame) = self.delimited.next_frame()? {
                if let Some(body) = frame.body {
                    return Ok(Some(body));
                }
            }
            match self.stream.read_chunk(64 * 1024, true).await? {
                Some(chunk) => self.delimited.push(&chunk.bytes),
                None => return Ok(None),
            }
        }
    }
}

/// Writes [`CommandFrame`]s to a stream.
pub struct FrameWriter {
    stream: SendStream,
    buffer: Vec<u8>,
}

impl FrameWriter {
    /// Writes to `stream`.
    pub fn new(stream: SendStream) -> Self {
        Self { stream, buffer: Vec::new() }
    }

    /// Among the streams of a connection, higher goes first.
    pub fn priority(self, priority: i32) -> Self {
        // Fails only when the stream is closed, which the first write reports.
        let _ = self.stream.set_priority(priority);
        self
    }

    /// Sends one frame.
    ///
    /// # Errors
    /// [`StreamError`] when the connection breaks.
    pub async fn send(&mut self, body: Body) -> Result<(), StreamError> {
        self.buffer.clear();
        encode_delimited(&mut self.buffer, &CommandFrame { body: Some(body) });
        Ok(self.stream.write_all(&self.buffer).await?)
    }

    /// Says that nothing follows.
    pub fn finish(mut self) {
        // Fails only when the stream is closed already.
        let _ = self.stream.finish();
    }
}
