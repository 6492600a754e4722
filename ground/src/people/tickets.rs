//! Tickets: a program that cannot sign in, as it sends no cookie of ours, opens one address with one of them, once.
//!
//! A ticket stands for the session of whoever asked for it: it has that role as it is when it is used, and is worth nothing once the
//! session has ended. Only its SHA-256 is kept, in memory: a restart ends them all.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::sessions::{SessionKey, Token};

/// So long a ticket waits to be used.
pub const VALID: Duration = Duration::from_secs(300);
/// Most that wait; the oldest gives way.
const MAX_TICKETS: usize = 256;

#[derive(Debug)]
struct Ticket {
    session: SessionKey,
    /// The one path that it opens.
    path: String,
    issued: Instant,
}

/// The tickets that wait.
#[derive(Debug, Default)]
pub(super) struct Tickets(HashMap<SessionKey, Ticket>);

impl Tickets {
    /// A new one, as an address carries it.
    pub(super) fn issue(&mut self, session: SessionKey, path: String, now: Instant) -> String {
        self.forget(now);
        if self.0.len() >= MAX_TICKETS
            && let Some(oldest) = self.0.iter().min_by_key(|(_, ticket)| ticket.issued).map(|(key, _)| key.clone())
        {
            self.0.remove(&oldest);
        }
        let token = Token::new();
        self.0.insert(token.key(), Ticket { session, path, issued: now });
        token.as_str().to_owned()
    }

    /// The session of a ticket for `path`, which counts no more from now on; elsewhere it stays what it was.
    pub(super) fn redeem(&mut self, ticket: &str, path: &str, now: Instant) -> Option<SessionKey> {
        self.forget(now);
        let key = Token::from_cookie(ticket)?.key();
        self.0.get(&key).filter(|ticket| ticket.path == path)?;
        self.0.remove(&key).map(|ticket| ticket.session)
    }

    fn forget(&mut self, now: Instant) {
        self.0.retain(|_, ticket| now.saturating_duration_since(ticket.issued) < VALID);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_counts_once_for_one_path_within_minutes() {
        let (mut tickets, session, now) = (Tickets::default(), Token::new().key(), Instant::now());
        let mut issue = || tickets.issue(session.clone(), "/here".into(), now);
        let [used, late, other] = [issue(), issue(), issue()];
        assert_eq!(tickets.redeem(&used, "/here", now), Some(session.clone()));
        assert_eq!(tickets.redeem(&used, "/here", now), None, "used");
        assert_eq!(tickets.redeem(&other, "/there", now), None, "of another path");
        for garbage in ["", "x", &"0".repeat(64)] {
            assert_eq!(tickets.redeem(garbage, "/here", now), None, "{garbage}");
        }
        let moment = Duration::from_millis(1);
        assert_eq!(tickets.redeem(&other, "/here", now + VALID - moment), Some(session));
        assert_eq!(tickets.redeem(&late, "/here", now + VALID), None, "expired");
    }

    #[test]
    fn so_many_wait_and_the_oldest_gives_way() {
        let (mut tickets, session, now) = (Tickets::default(), Token::new().key(), Instant::now());
        let all: Vec<String> = (0..=MAX_TICKETS)
            .map(|n| tickets.issue(session.clone(), "/here".into(), now + Duration::from_millis(n as u64)))
            .collect();
        let now = now + Duration::from_secs(1);
        assert_eq!(all.iter().filter(|ticket| tickets.redeem(ticket, "/here", now).is_none()).count(), 1);
        assert_eq!(tickets.redeem(&all[0], "/here", now), None);
    }
}
