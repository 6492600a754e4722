//! The listening socket of page and API: plain on the loopback, TLS everywhere else.
//!
//! The accept loop waits for no client: handshakes, headers and bodies run beside each other, each with a time-out, and
//! who may stay when there are too many is decided by the [table](Table). hyper is used without `axum::serve`, which
//! has no time-outs.

mod certificate;
mod table;

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::connect_info::ConnectInfo;
use axum::http::{Request, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_io_timeout::TimeoutWriter;
use tokio_rustls::TlsAcceptor;
use tokio_util::either::Either;
use tokio_util::task::TaskTracker;
use tower::ServiceExt as _;
use tower_http::timeout::TimeoutBody;

use crate::sync::stopping;
pub use certificate::{CertificateError, holds, own, tls};
use table::Table;
pub(crate) use table::{Limits, Place};
pub use table::{MAX_CONNECTIONS, RESERVED_DESCRIPTORS};

/// Longest handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// Longest wait for the next request, its header included.
const HEADER: Duration = Duration::from_secs(20);
/// Longest pause within a body.
const BODY_PAUSE: Duration = Duration::from_secs(10);
/// A client that takes nothing of what it asked for is given up after this long.
const UNREAD: Duration = Duration::from_secs(30);
/// Most bytes of a connection that wait to be read or written: 64 MiB for all of them.
const BUFFER: usize = 64 << 10;
/// Wait after the system refused a connection: it is out of something.
const OUT_OF_SOMETHING: Duration = Duration::from_millis(200);

/// Where a request comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Peer(pub(crate) SocketAddr);

/// Serves `router` until `stopped`, and then the requests in progress to their ends.
pub(crate) async fn serve(
    listener: TcpListener,
    tls: Option<Arc<rustls::ServerConfig>>,
    router: Router,
    limits: Limits,
    mut stopped: watch::Receiver<bool>,
) {
    let tls = tls.map(TlsAcceptor::from);
    let table = Arc::new(Table::new(limits));
    let open = TaskTracker::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stopping(&mut stopped) => break,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(OUT_OF_SOMETHING).await;
                continue;
            }
        };
        // Telemetry is sent as it comes: waiting to fill a segment would only age it.
        let _ = stream.set_nodelay(true);
        let place = table.enter(peer.ip()).await;
        let closed = place.closed();
        let connection = connection(stream, Peer(peer), place, tls.clone(), router.clone(), stopped.clone());
        open.spawn(async move {
            tokio::select! {
                () = connection => {}
                () = closed => tracing::debug!(%peer, "closed for others"),
            }
        });
        // Whoever came with their request is heard before the next ones come: in a crowd that comes at once they would
        // be the oldest of the fresh, and closed unheard.
        tokio::task::yield_now().await;
    }
    drop(listener);
    open.close();
    open.wait().await;
}

/// One connection to its end, or until it becomes a WebSocket.
async fn connection(
    stream: TcpStream,
    peer: Peer,
    place: Place,
    tls: Option<TlsAcceptor>,
    router: Router,
    mut stopped: watch::Receiver<bool>,
) {
    let stream = match tls {
        None => Either::Left(stream),
        Some(tls) => {
            let handshake = tokio::select! {
                handshake = tokio::time::timeout(HANDSHAKE, tls.accept(stream)) => handshake,
                () = stopping(&mut stopped) => return,
            };
            match handshake {
                Ok(Ok(stream)) => Either::Right(stream),
                Ok(Err(error)) => return tracing::debug!(peer = %peer.0, %error, "no TLS"),
                Err(_) => return tracing::debug!(peer = %peer.0, "no TLS in time"),
            }
        }
    };
    let place = Arc::new(place);
    let answer = hyper::service::service_fn(move |request: Request<Incoming>| {
        let mut request = request.map(|body| Body::new(TimeoutBody::new(BODY_PAUSE, body)));
        request.extensions_mut().insert(ConnectInfo(peer));
        request.extensions_mut().insert(place.clone());
        let answer = router.clone().oneshot(request);
        async { Ok::<Response<Body>, Infallible>(answer.await.unwrap_or_else(|never| match never {})) }
    });
    let mut stream = TimeoutWriter::new(stream);
    stream.set_timeout(Some(UNREAD));
    let io = TokioIo::new(Box::pin(stream));
    let serving = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER)
        .max_buf_size(BUFFER)
        .serve_connection(io, answer)
        .with_upgrades();
    let mut serving = pin!(serving);
    let served = tokio::select! {
        served = serving.as_mut() => served,
        () = stopping(&mut stopped) => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if let Err(error) = served {
        tracing::debug!(peer = %peer.0, %error, "connection ended");
    }
}
