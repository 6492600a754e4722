//! Sessions: a random token in the browser's cookie, its SHA-256 here. They outlive the ground, so that a restart in
//! flight signs nobody out.
//!
//! Their times are those of a clock that no step of the machine's moves: one that was set after the start (no battery
//! beside it, a time server late) would else end every session, of whoever is flying as well, or lengthen them all.
//!
//! Every request asks for its session, the motor cut as well: the lock is held for memory only. A thread of its own
//! writes the file, as often as the disk allows; who signs in or out waits for it, nobody else does.

use std::collections::HashMap;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use plumbline_rest::people::SignedIn;
use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use tokio::sync::watch;

use super::accounts::{Account, write_private};
use crate::agent_link::clock::wall_us;
use crate::sync::lock;

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

/// What a session is kept under: the SHA-256 of its token, by which nobody signs in.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SessionKey(String);

impl Token {
    pub(super) fn new() -> Self {
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

    /// Of the session that it is for.
    pub fn key(&self) -> SessionKey {
        SessionKey(Sha256::digest(self.0.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

/// Unix time on the ground's steady clock, s.
fn now_s() -> u64 {
    wall_us(Instant::now()) / 1_000_000
}

/// One session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Session {
    pub(super) account: String,
    /// Stamp of the account's password when it began.
    pub(super) stamp: String,
    begun_s: u64,
    seen_s: u64,
    /// Address it began from.
    #[serde(default)]
    from: String,
}

/// Digits of a session's key that are shown.
const SHOWN: usize = 16;

impl Session {
    fn over(&self, now_s: u64) -> bool {
        now_s.saturating_sub(self.seen_s) > IDLE_S || now_s.saturating_sub(self.begun_s) > LONGEST_S
    }
}

/// The sessions of this ground.
#[derive(Debug)]
pub struct Sessions {
    known: Arc<Mutex<Known>>,
    /// Wakes the writer. One wake is enough for any number of changes.
    changed: SyncSender<()>,
    /// Revision on the disk.
    kept: watch::Receiver<u64>,
}

#[derive(Debug, Default)]
struct Known {
    sessions: HashMap<String, Session>,
    /// Grows with every change.
    revision: u64,
}

impl Sessions {
    pub(super) fn open(folder: &Path) -> Self {
        let path = folder.join("sessions.json");
        let read = std::fs::read(&path).ok();
        let mut sessions: HashMap<String, Session> =
            read.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        // A clock that has been set back since must not lengthen them.
        let now_s = now_s();
        for session in sessions.values_mut() {
            session.begun_s = session.begun_s.min(now_s);
            session.seen_s = session.seen_s.min(now_s);
        }
        let known = Arc::new(Mutex::new(Known { sessions, revision: 0 }));
        let (changed, changes) = sync_channel(1);
        let (written, kept) = watch::channel(0);
        let writer = {
            let known = known.clone();
            move || write(&path, &known, &changes, &written)
        };
        if let Err(error) = std::thread::Builder::new().name("sessions".into()).spawn(writer) {
            tracing::error!(%error, "sessions cannot be kept: no thread");
        }
        Self { known, changed, kept }
    }

    /// Begins a session of `account`, from an address. Answers when it is on the disk, or cannot be.
    pub(super) async fn begin(&self, account: &Account, from: String) -> Token {
        let token = Token::new();
        let now_s = now_s();
        let session =
            Session { account: account.name.clone(), stamp: account.stamp(), begun_s: now_s, seen_s: now_s, from };
        let revision = self.change(|known| {
            known.retain(|_, session| !session.over(now_s));
            if known.len() >= MAX_SESSIONS
                && let Some(oldest) = known.iter().min_by_key(|(_, s)| s.seen_s).map(|(key, _)| key.clone())
            {
                known.remove(&oldest);
            }
            known.insert(token.key().0, session);
        });
        self.kept(revision).await;
        token
    }

    /// The session kept under `key`, which is in use now. Waits for nothing.
    pub(super) fn seen(&self, key: &SessionKey) -> Option<Session> {
        let now_s = now_s();
        let mut known = lock(&self.known);
        let session = known.sessions.get_mut(&key.0).filter(|session| !session.over(now_s))?;
        let due = now_s.saturating_sub(session.seen_s) >= KEEP_EVERY_S;
        if due {
            session.seen_s = now_s;
        }
        let session = session.clone();
        drop(known);
        if due {
            self.change(|_| ());
        }
        Some(session)
    }

    /// Ends a session. Answers when the disk knows it, or cannot.
    pub(super) async fn end(&self, token: &Token) {
        let revision = self.change(|known| drop(known.remove(&token.key().0)));
        self.kept(revision).await;
    }

    fn change(&self, change: impl FnOnce(&mut HashMap<String, Session>)) -> u64 {
        let mut known = lock(&self.known);
        change(&mut known.sessions);
        known.revision += 1;
        let revision = known.revision;
        drop(known);
        // Full: the writer has yet to begin, and will see this change as well.
        let _ = self.changed.try_send(());
        revision
    }

    /// Sessions that are not over and that `counts` lets pass.
    pub(super) fn list(&self, counts: impl Fn(&Session) -> bool) -> Vec<SignedIn> {
        let now_s = now_s();
        let known = lock(&self.known);
        let live = known.sessions.iter().filter(|(_, session)| !session.over(now_s) && counts(session));
        let mut list: Vec<SignedIn> = live
            .map(|(key, session)| SignedIn {
                id: key.chars().take(SHOWN).collect(),
                account: session.account.clone(),
                from: session.from.clone(),
                begun_s: session.begun_s,
                seen_s: session.seen_s,
            })
            .collect();
        list.sort_by_key(|shown| std::cmp::Reverse(shown.begun_s));
        list
    }

    /// Ends the session shown as `id`, when it is one of `account` or of anybody; answers whether there was one, when the
    /// disk knows it, or cannot.
    pub(super) async fn end_shown(&self, id: &str, account: Option<&str>) -> bool {
        let meant = |key: &str, session: &Session| {
            key.get(..SHOWN) == Some(id) && account.is_none_or(|account| session.account == account)
        };
        let mut ended = false;
        let revision = self.change(|known| {
            let before = known.len();
            known.retain(|key, session| !meant(key, session));
            ended = known.len() < before;
        });
        if ended {
            self.kept(revision).await;
        }
        ended
    }

    async fn kept(&self, revision: u64) {
        // An error means that there is no writer: nothing to wait for.
        let _ = self.kept.clone().wait_for(|kept| *kept >= revision).await;
    }
}

/// Writes the sessions whenever they have changed, until nobody can change them any more.
fn write(path: &Path, known: &Mutex<Known>, changes: &Receiver<()>, written: &watch::Sender<u64>) {
    for () in changes {
        let (text, revision) = {
            let known = lock(known);
            (serde_json::to_vec(&known.sessions).unwrap_or_default(), known.revision)
        };
        if let Err(error) = write_private(path, &text) {
            // They last as long as this ground.
            tracing::warn!(path = %path.display(), %error, "sessions cannot be kept");
        }
        written.send_replace(revision);
    }
}
