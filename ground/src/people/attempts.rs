//! Attempts to sign in: how many failures are heard, and who waits for a turn.
//!
//! Failures count for an address and an account together, so that nobody's guesses lock the owner of an account out who
//! signs in from elsewhere. Two wider counts slow down whoever tries many accounts from one address, or one account
//! from many addresses; an address that has signed in to an account before is exempt from both, for that account.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::time::{Duration, Instant};

use super::throttle::Throttle;

/// Failed attempts to sign in to one account from one address …
pub const FAILURES: u32 = 10;
/// … from one address, whatever the account …
const OF_ADDRESS: u32 = 50;
/// … and to one account, whatever the address, …
const OF_ACCOUNT: u32 = 200;
/// … within this time; more are turned away unheard.
pub const FAILURES_WITHIN: Duration = Duration::from_secs(300);
/// Attempts that wait for their turn, of one address and of all together.
const WAITING_OF_ADDRESS: usize = 32;
const WAITING: usize = 256;
/// Addresses remembered that have signed in; the oldest is forgotten first.
const MAX_KNOWN: usize = 1024;

#[derive(Debug)]
pub(super) struct Attempts {
    by_both: Throttle<(IpAddr, String)>,
    by_address: Throttle<IpAddr>,
    by_account: Throttle<String>,
    known: VecDeque<(IpAddr, String)>,
    waiting: HashMap<IpAddr, usize>,
}

/// What counts as one address: of IPv6 the network, because a host has as many addresses as it likes.
pub(crate) fn origin(from: Option<IpAddr>) -> IpAddr {
    match from {
        Some(IpAddr::V6(address)) if address.to_ipv4_mapped().is_none() => {
            let [a, b, c, d, ..] = address.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        Some(address) => address.to_canonical(),
        None => Ipv4Addr::UNSPECIFIED.into(),
    }
}

impl Attempts {
    pub(super) fn new() -> Self {
        Self {
            by_both: Throttle::new(FAILURES, FAILURES_WITHIN),
            by_address: Throttle::new(OF_ADDRESS, FAILURES_WITHIN),
            by_account: Throttle::new(OF_ACCOUNT, FAILURES_WITHIN),
            known: VecDeque::new(),
            waiting: HashMap::new(),
        }
    }

    /// How long this attempt has to wait, if it has to.
    pub(super) fn wait(&self, key: &(IpAddr, String), now: Instant) -> Option<Duration> {
        let own = self.by_both.wait(key, now);
        if self.known.contains(key) {
            return own;
        }
        own.max(self.by_address.wait(&key.0, now)).max(self.by_account.wait(&key.1, now))
    }

    pub(super) fn failed(&mut self, key: &(IpAddr, String), now: Instant) {
        self.by_both.failed(key.clone(), now);
        self.by_address.failed(key.0, now);
        self.by_account.failed(key.1.clone(), now);
    }

    pub(super) fn succeeded(&mut self, key: &(IpAddr, String)) {
        self.by_both.forgive(key);
        self.known.retain(|known| known != key);
        self.known.push_back(key.clone());
        if self.known.len() > MAX_KNOWN {
            self.known.pop_front();
        }
    }

    /// Takes a place among those that wait; `false` when there is none.
    pub(super) fn queue(&mut self, from: IpAddr) -> bool {
        if self.waiting.values().sum::<usize>() >= WAITING {
            return false;
        }
        let mine = self.waiting.entry(from).or_default();
        let free = *mine < WAITING_OF_ADDRESS;
        *mine += usize::from(free);
        free
    }

    /// Gives the place back.
    pub(super) fn leave(&mut self, from: IpAddr) {
        if let Some(mine) = self.waiting.get_mut(&from) {
            *mine -= 1;
            if *mine == 0 {
                self.waiting.remove(&from);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_counts_spare_who_has_signed_in_before() {
        let now = Instant::now();
        let key = |address: u8, account: &str| (IpAddr::from([192, 0, 2, address]), account.to_owned());
        let mut attempts = Attempts::new();
        attempts.succeeded(&key(1, "ann"));
        // One address tries many accounts, many addresses try one.
        (0..OF_ADDRESS).for_each(|n| attempts.failed(&key(1, &n.to_string()), now));
        (0..OF_ACCOUNT).for_each(|n| attempts.failed(&key(2 + (n % 200) as u8, "ann"), now));
        assert!(attempts.wait(&key(1, "bob"), now).is_some() && attempts.wait(&key(250, "ann"), now).is_some());
        assert_eq!(attempts.wait(&key(1, "ann"), now), None);
        (0..FAILURES).for_each(|_| attempts.failed(&key(1, "ann"), now));
        assert!(attempts.wait(&key(1, "ann"), now).is_some());
        let (a, b) = ("2001:db8::1".parse().ok(), "2001:db8::2".parse().ok());
        assert!(origin(a) == origin(b) && origin("::ffff:192.0.2.1".parse().ok()) == key(1, "").0);
        assert_eq!((0..99).filter(|_| attempts.queue(key(9, "").0)).count(), WAITING_OF_ADDRESS);
        (0..WAITING_OF_ADDRESS).for_each(|_| attempts.leave(key(9, "").0));
        assert!(attempts.waiting.is_empty());
    }
}
