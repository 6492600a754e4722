//! Sessions: a random token in the browser's cookie, its SHA-256 here. They outlive the ground, so that a restart in
//! flight signs nobody out.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::accounts::{Account, write_private};
use crate::sync::{lock, wall_time_us};

/// Name of the cookie.
pub const COOKIE: &str = "plumbline_session";
/// Most sessions; the one unseen for longest gives way.
const MAX_SESSIONS: usize = 256;
/// A session unseen for this long is over, s.
const IDLE_S: u64 = 12 * 3600;
/// A session is over after this long, s.
pub(crate) const LONGEST_S: u64 = 7 * 24 * 3600;
/// When a session was seen is written down this often, s.
const KEEP_EVERY_S: u64 = 600;

/// What a browser shows; never kept here.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    fn new() -> Self {
        let mut bytes = [0; 32];
        // Without randomness from the system nothing of TLS would work either.
        if SystemRandom::new().fill(&mut bytes).is_err() {
            tracing::error!("the system gives no random numbers");
            std::process::abort();
        }
        Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
    }

    /// From a cookie.
    pub fn from_cookie(value: &str) -> Option<Self> {
        (value.len() == 64 && value.bytes().all(|b| b.is_ascii_hexdigit())).then(|| Self(value.to_owned()))
    }

    /// For the cookie.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn key(&self) -> String {
        Sha256::digest(self.0.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

/// One session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Session {
    pub(super) account: String,
    /// Stamp of the account's password when it began.
    pub(super) stamp: String,
    begun_s: u64,
    seen_s: u64,
}

impl Session {
    fn over(&self, now_s: u64) -> bool {
        now_s.saturating_sub(self.seen_s) > IDLE_S || now_s.saturating_sub(self.begun_s) > LONGEST_S
    }
}

/// The sessions of this ground.
#[derive(Debug)]
pub struct Sessions {
    path: PathBuf,
    known: Mutex<HashMap<String, Session>>,
}

impl Sessions {
    pub(super) fn open(folder: &Path) -> Self {
        let path = folder.join("sessions.json");
        let known = std::fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        Self { path, known: Mutex::new(known) }
    }

    pub(super) fn begin(&self, account: &Account) -> Token {
        let token = Token::new();
        let now_s = wall_time_us() / 1_000_000;
        let session = Session { account: account.name.clone(), stamp: account.stamp(), begun_s: now_s, seen_s: now_s };
        let mut known = lock(&self.known);
        known.retain(|_, session| !session.over(now_s));
        if known.len() >= MAX_SESSIONS
            && let Some(oldest) = known.iter().min_by_key(|(_, s)| s.seen_s).map(|(key, _)| key.clone())
        {
            known.remove(&oldest);
        }
        known.insert(token.key(), session);
        self.keep(&known);
        token
    }

    /// The session of `token`, which is in use now.
    pub(super) fn seen(&self, token: &Token) -> Option<Session> {
        let now_s = wall_time_us() / 1_000_000;
        let mut known = lock(&self.known);
        let session = known.get_mut(&token.key()).filter(|session| !session.over(now_s))?;
        let due = now_s.saturating_sub(session.seen_s) >= KEEP_EVERY_S;
        if due {
            session.seen_s = now_s;
        }
        let session = session.clone();
        if due {
            self.keep(&known);
        }
        Some(session)
    }

    pub(super) fn end(&self, token: &Token) {
        let mut known = lock(&self.known);
        known.remove(&token.key());
        self.keep(&known);
    }

    fn keep(&self, known: &HashMap<String, Session>) {
        let text = serde_json::to_vec(known).unwrap_or_default();
        if let Err(error) = write_private(&self.path, &text) {
            // They last as long as this ground.
            tracing::warn!(path = %self.path.display(), %error, "sessions cannot be kept");
        }
    }
}
