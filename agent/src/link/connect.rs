//! Getting a connection through a radio that may be gone, for as long as it takes.
//!
//! One attempt alone repeats its first packet ever more rarely, so it would notice the radio's
//! return late. Attempts are therefore started one after the other, several at once, and the first
//! that succeeds wins. Their rate falls the longer the ground is away.

use std::net::SocketAddr;
use std::time::Duration;

use quinn::{ClientConfig, Connection, ConnectionError, Endpoint};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};

use super::tls::SERVER_NAME;
use super::{LinkState, transport};

/// Most attempts under way at once; the oldest gives way. Each lives long enough to repeat a packet that was lost, which
/// QUIC does after a second, and to be served by a machine that has much else to do.
const ATTEMPTS: usize = 12;

/// Time between two attempts after trying for `tried`.
fn spacing(tried: Duration) -> Duration {
    match tried.as_secs() {
        0..2 => Duration::from_millis(100),
        2..60 => Duration::from_millis(250),
        _ => Duration::from_secs(1),
    }
}

/// Connects to `ground`, trying until it succeeds. Reasons for failing are told when they change.
pub async fn persistently(
    endpoint: &Endpoint,
    config: &ClientConfig,
    ground: SocketAddr,
    state: &LinkState,
) -> Connection {
    let begun = Instant::now();
    let mut attempts: JoinSet<Result<Connection, ConnectionError>> = JoinSet::new();
    let mut handles = std::collections::VecDeque::new();
    let mut next = Instant::now();
    loop {
        tokio::select! {
            Some(ended) = attempts.join_next(), if !attempts.is_empty() => match ended {
                Ok(Ok(connection)) => return connection,
                Ok(Err(error)) => state.tell(&transport::reason(&error)),
                // Given up for a newer attempt.
                Err(_) => {}
            },
            () = sleep(next.saturating_duration_since(Instant::now())) => {
                next = Instant::now() + spacing(begun.elapsed());
                if handles.len() >= ATTEMPTS && let Some(oldest) = handles.pop_front() {
                    let oldest: tokio::task::AbortHandle = oldest;
                    oldest.abort();
                }
                match endpoint.connect_with(config.clone(), ground, SERVER_NAME) {
                    Ok(connecting) => handles.push_back(attempts.spawn(connecting)),
                    Err(error) => state.tell(&error.to_string()),
                }
                handles.retain(|handle| !handle.is_finished());
            }
        }
    }
}
