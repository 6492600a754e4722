//! Who holds control of a vehicle: one operator at a time, any number of viewers.
//!
//! A command while nobody holds control takes it; taking over is always possible, explicit, and
//! shown to everyone. Control that is not used, by an operator who shows no sign of life, is given
//! up after a while, and soon when the operator's page is closed. The motor cut never asks.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::sync::lock;

/// Another operator holds control.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("operator {holder:?} holds control")]
pub struct Held {
    /// Who.
    pub holder: String,
}

/// A closed page gives control back after this time: a reload opens the next one sooner.
pub const PAGE_GONE: Duration = Duration::from_secs(5);

#[derive(Debug)]
struct Lease {
    holder: String,
    used: Instant,
}

/// The pages of one operator that show one vehicle.
#[derive(Debug)]
struct Pages {
    open: u32,
    /// When the last one was closed.
    closed: Instant,
}

/// The leases of all vehicles.
#[derive(Debug, Default)]
pub struct Leases {
    leases: Mutex<BTreeMap<String, Lease>>,
    /// By vehicle and operator. Bounded: one for each connected viewer, and those that left lately.
    pages: Mutex<BTreeMap<(String, String), Pages>>,
}

impl Leases {
    /// Lets `operator` command `vehicle` when it holds control or nobody does.
    /// Answers whether the holder changed.
    ///
    /// # Errors
    /// [`Held`] by someone else.
    pub fn claim(&self, vehicle: &str, operator: &str) -> Result<bool, Held> {
        let mut leases = lock(&self.leases);
        match leases.get_mut(vehicle) {
            Some(lease) if lease.holder == operator => {
                lease.used = Instant::now();
                Ok(false)
            }
            Some(lease) => Err(Held { holder: lease.holder.clone() }),
            None => {
                leases.insert(vehicle.to_owned(), Lease { holder: operator.to_owned(), used: Instant::now() });
                Ok(true)
            }
        }
    }

    /// Takes control, from whoever has it. Answers the holder before.
    pub fn take(&self, vehicle: &str, operator: &str) -> Option<String> {
        let lease = Lease { holder: operator.to_owned(), used: Instant::now() };
        lock(&self.leases).insert(vehicle.to_owned(), lease).map(|before| before.holder)
    }

    /// A sign of life of `operator`; does it hold control of `vehicle`?
    pub fn alive(&self, vehicle: &str, operator: &str) -> bool {
        let mut leases = lock(&self.leases);
        let Some(lease) = leases.get_mut(vehicle).filter(|lease| lease.holder == operator) else { return false };
        lease.used = Instant::now();
        true
    }

    /// A page of `operator` shows `vehicle`.
    pub fn page_opened(&self, vehicle: &str, operator: &str) {
        let key = (vehicle.to_owned(), operator.to_owned());
        lock(&self.pages).entry(key).or_insert(Pages { open: 0, closed: Instant::now() }).open += 1;
    }

    /// It does no more.
    pub fn page_closed(&self, vehicle: &str, operator: &str) {
        if let Some(pages) = lock(&self.pages).get_mut(&(vehicle.to_owned(), operator.to_owned())) {
            *pages = Pages { open: pages.open.saturating_sub(1), closed: Instant::now() };
        }
    }

    /// Gives control back.
    ///
    /// # Errors
    /// [`Held`] by someone else. Releasing what nobody holds is not an error.
    pub fn release(&self, vehicle: &str, operator: &str) -> Result<(), Held> {
        let mut leases = lock(&self.leases);
        match leases.get(vehicle) {
            Some(lease) if lease.holder != operator => Err(Held { holder: lease.holder.clone() }),
            _ => {
                leases.remove(vehicle);
                Ok(())
            }
        }
    }

    /// Ends the leases unused for `idle`, those whose holder closed its last page `gone` ago and has sent nothing since,
    /// and those whose holder `may` not have one; answers vehicle and former holder of each.
    pub fn expire(&self, idle: Duration, gone: Duration, may: impl Fn(&str) -> bool) -> Vec<(String, String)> {
        let holders: BTreeSet<String> = lock(&self.leases).values().map(|lease| lease.holder.clone()).collect();
        // Not under the lock, which every command takes: this may read the disk.
        let barred: BTreeSet<String> = holders.into_iter().filter(|holder| !may(holder)).collect();
        let now = Instant::now();
        let mut ended = Vec::new();
        let mut pages = lock(&self.pages);
        lock(&self.leases).retain(|vehicle, lease| {
            let left = pages.get(&(vehicle.clone(), lease.holder.clone())).filter(|pages| pages.open == 0);
            let left = left.is_some_and(|pages| now.saturating_duration_since(pages.closed.max(lease.used)) >= gone);
            let unused = now.saturating_duration_since(lease.used) >= idle;
            let keep = !left && !unused && !barred.contains(&lease.holder);
            if !keep {
                ended.push((vehicle.clone(), lease.holder.clone()));
            }
            keep
        });
        pages.retain(|_, pages| pages.open > 0 || now.saturating_duration_since(pages.closed) < 2 * gone);
        ended
    }

    /// Who holds control.
    pub fn holder(&self, vehicle: &str) -> Option<String> {
        lock(&self.leases).get(vehicle).map(|lease| lease.holder.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anybody(_: &str) -> bool {
        true
    }

    #[test]
    fn one_holder_until_someone_takes_over() {
        let leases = Leases::default();
        assert_eq!(leases.claim("v", "ann"), Ok(true));
        assert_eq!(leases.claim("v", "ann"), Ok(false));
        assert_eq!(leases.claim("v", "bob"), Err(Held { holder: "ann".into() }));
        assert_eq!(leases.claim("w", "bob"), Ok(true), "another vehicle is another lease");
        assert_eq!(leases.take("v", "bob"), Some("ann".into()));
        assert!(leases.release("v", "ann").is_err());
        assert_eq!(leases.release("v", "bob"), Ok(()));
        assert_eq!(leases.holder("v"), None);
    }

    #[test]
    fn unused_control_is_given_up_and_a_sign_of_life_keeps_it() {
        let leases = Leases::default();
        leases.claim("v", "ann").unwrap();
        assert!(leases.expire(Duration::from_secs(60), PAGE_GONE, anybody).is_empty());
        std::thread::sleep(Duration::from_millis(30));
        assert!(leases.alive("v", "ann") && !leases.alive("v", "bob"));
        assert!(leases.expire(Duration::from_millis(20), PAGE_GONE, anybody).is_empty());
        std::thread::sleep(Duration::from_millis(30));
        assert_eq!(leases.expire(Duration::from_millis(20), PAGE_GONE, anybody), [("v".to_owned(), "ann".to_owned())]);
        leases.claim("w", "eve").unwrap();
        let ended = leases.expire(Duration::from_secs(60), PAGE_GONE, |who| who != "eve");
        assert_eq!(ended, [("w".to_owned(), "eve".to_owned())]);
        assert_eq!(leases.claim("v", "bob"), Ok(true));
    }

    #[test]
    fn a_closed_page_gives_control_back_and_a_reloaded_one_keeps_it() {
        let (idle, gone) = (Duration::from_secs(60), Duration::from_millis(30));
        let leases = Leases::default();
        leases.page_opened("v", "ann");
        leases.claim("v", "ann").unwrap();
        leases.page_closed("v", "ann");
        assert!(leases.expire(idle, gone, anybody).is_empty(), "not at once");
        leases.page_opened("v", "ann");
        std::thread::sleep(2 * gone);
        assert!(leases.expire(idle, gone, anybody).is_empty(), "it came back");
        leases.page_closed("v", "ann");
        std::thread::sleep(2 * gone);
        assert_eq!(leases.expire(idle, gone, anybody), [("v".to_owned(), "ann".to_owned())]);
        // A script has no page to close.
        leases.claim("v", "script").unwrap();
        std::thread::sleep(2 * gone);
        assert!(leases.expire(idle, gone, anybody).is_empty());
        assert!(lock(&leases.pages).is_empty(), "nothing is kept of those who left");
    }
}
