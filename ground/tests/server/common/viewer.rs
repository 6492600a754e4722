//! Somebody who watches a vehicle by WebSocket.

use std::collections::VecDeque;

use futures_util::{SinkExt, StreamExt};
use plumbline_proto::{Kind, Message, codec};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest};

use super::PATIENCE;

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
