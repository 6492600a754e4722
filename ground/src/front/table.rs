//! Who may stay connected when there are more clients than places.
//!
//! A connection is **fresh** until a request on it was admitted: everybody can open those, and leave them half open. When
//! there is no place, the oldest fresh connection of whoever has most of them is closed: a newcomer always gets in, and
//! stays for as long as it takes to ask for something. A connection on which a known person asked is **kept**, and a
//! socket of a **viewer** is: neither is closed for a newcomer. Kept ones are counted by person, those beyond
//! [`Limits::kept_each`] stay fresh; viewers are counted by [`crate::viewers`].

use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::{Arc, Mutex};

use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

use crate::sync::lock;

/// Most connections at once, where the system gives so many descriptors.
pub const MAX_CONNECTIONS: usize = 1024;
/// Descriptors that no connection takes: flight files being recorded and downloaded, the index, logs, agents.
pub const RESERVED_DESCRIPTORS: usize = 1024;
/// Connections being closed that may still hold a descriptor while the next ones are accepted.
const CLOSING: usize = 64;

/// How many of which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Limits {
    /// All together.
    pub(crate) total: usize,
    /// Fresh ones of one address.
    pub(crate) fresh_each: usize,
    /// Kept ones of all people together, without viewers.
    pub(crate) kept: usize,
    /// Kept ones of one person.
    pub(crate) kept_each: usize,
}

impl Limits {
    /// For a process that may open `descriptors` files: some are reserved, and a quarter of the rest is for the fresh.
    pub(crate) fn of(descriptors: usize) -> Self {
        let spare = descriptors.saturating_sub(RESERVED_DESCRIPTORS).max(descriptors / 2);
        let total = spare.saturating_sub(CLOSING).clamp(8, MAX_CONNECTIONS);
        Self { total, fresh_each: total / 4, kept: total / 2, kept_each: total / 16 + 1 }
    }
}

/// The connections there are.
#[derive(Debug)]
pub(crate) struct Table {
    limits: Limits,
    entries: Mutex<Entries>,
    /// One for each descriptor: what was told to close counts until it has.
    descriptors: Arc<Semaphore>,
}

#[derive(Debug, Default)]
struct Entries {
    /// By age.
    open: BTreeMap<u64, Entry>,
    next: u64,
}

#[derive(Debug)]
struct Entry {
    network: IpAddr,
    standing: Standing,
    closed: Arc<Notify>,
}

#[derive(Debug, PartialEq, Eq)]
enum Standing {
    Fresh,
    Kept(String),
    Viewer,
}

/// A connection's place, among the extensions of each of its requests; given back when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    table: Arc<Table>,
    number: u64,
    closed: Arc<Notify>,
    _descriptor: Option<OwnedSemaphorePermit>,
}

impl Table {
    pub(crate) fn new(limits: Limits) -> Self {
        let descriptors = Arc::new(Semaphore::new(limits.total + CLOSING));
        Self { limits, entries: Mutex::default(), descriptors }
    }

    /// A place for a newcomer, at the expense of a fresh connection where there is no other. Waits only for closed
    /// connections to be gone.
    pub(crate) async fn enter(self: &Arc<Self>, from: IpAddr) -> Place {
        let closed = Arc::new(Notify::new());
        let number = lock(&self.entries).enter(crate::people::origin(Some(from)), closed.clone(), &self.limits);
        // An error would mean that the semaphore is closed, which it never is.
        let descriptor = self.descriptors.clone().acquire_owned().await.ok();
        Place { table: self.clone(), number, closed, _descriptor: descriptor }
    }
}

impl Entries {
    fn enter(&mut self, network: IpAddr, closed: Arc<Notify>, limits: &Limits) -> u64 {
        let mut fresh: HashMap<IpAddr, usize> = HashMap::new();
        for entry in self.open.values().filter(|entry| entry.standing == Standing::Fresh) {
            *fresh.entry(entry.network).or_default() += 1;
        }
        if fresh.get(&network).is_some_and(|count| *count >= limits.fresh_each) {
            self.close_oldest(network);
        } else if self.open.len() >= limits.total
            && let Some((crowd, _)) = fresh.into_iter().max_by_key(|(_, count)| *count)
        {
            self.close_oldest(crowd);
        }
        let number = self.next;
        self.next += 1;
        self.open.insert(number, Entry { network, standing: Standing::Fresh, closed });
        number
    }

    fn close_oldest(&mut self, network: IpAddr) {
        let fresh = |(_, entry): &(&u64, &Entry)| entry.network == network && entry.standing == Standing::Fresh;
        let oldest = self.open.iter().find(fresh).map(|(number, _)| *number);
        if let Some(entry) = oldest.and_then(|number| self.open.remove(&number)) {
            // One permit is kept for a task that does not wait yet.
            entry.closed.notify_one();
        }
    }
}

impl Place {
    /// Completes when the connection has to go.
    pub(crate) fn closed(&self) -> impl Future<Output = ()> + use<> {
        let closed = self.closed.clone();
        async move { closed.notified().await }
    }

    /// Keeps the connection, on which `person` asked for something, where they have not too many already.
    pub(crate) fn keep(&self, person: &str) {
        let limits = &self.table.limits;
        let mut entries = lock(&self.table.entries);
        if entries.open.get(&self.number).is_none_or(|entry| entry.standing != Standing::Fresh) {
            return;
        }
        let kept = |entry: &&Entry| matches!(entry.standing, Standing::Kept(_));
        let theirs = |entry: &&Entry| matches!(&entry.standing, Standing::Kept(name) if name == person);
        if entries.open.values().filter(kept).count() < limits.kept
            && entries.open.values().filter(theirs).count() < limits.kept_each
            && let Some(entry) = entries.open.get_mut(&self.number)
        {
            entry.standing = Standing::Kept(person.to_owned());
        }
    }

    /// The connection has become a viewer's socket, which is counted among the viewers.
    pub(crate) fn watch(&self) {
        if let Some(entry) = lock(&self.table.entries).open.get_mut(&self.number) {
            entry.standing = Standing::Viewer;
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        lock(&self.table.entries).open.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::pin::Pin;
    use std::task::{Context, Waker};

    const LIMITS: Limits = Limits { total: 8, fresh_each: 4, kept: 4, kept_each: 2 };

    fn address(last: u8) -> IpAddr {
        IpAddr::from([192, 0, 2, last])
    }

    fn closed(place: &Place) -> bool {
        let closed: Pin<&mut _> = std::pin::pin!(place.closed());
        closed.poll(&mut Context::from_waker(Waker::noop())).is_ready()
    }

    async fn enter(table: &Arc<Table>, count: usize, last: u8) -> Vec<Place> {
        let mut places = Vec::new();
        for _ in 0..count {
            places.push(table.enter(address(last)).await);
        }
        places
    }

    #[tokio::test]
    async fn a_newcomer_takes_the_place_of_whoever_has_most() {
        let table = Arc::new(Table::new(LIMITS));
        let crowd = enter(&table, 4, 1).await;
        let others = enter(&table, 2, 2).await;
        let third = enter(&table, 2, 3).await;
        let newcomer = table.enter(address(4)).await;
        assert!(closed(&crowd[0]), "the oldest of the crowd goes");
        assert!(!crowd[1..].iter().chain(&others).chain(&third).chain([&newcomer]).any(closed));
        // One address never has more than its share.
        let _fifth = enter(&table, 2, 1).await;
        assert!(closed(&crowd[1]));
    }

    #[tokio::test]
    async fn who_is_known_keeps_a_few_and_viewers_all() {
        let table = Arc::new(Table::new(LIMITS));
        let first = enter(&table, 4, 1).await;
        first[..3].iter().for_each(|place| place.keep("ann"));
        first[3].watch();
        let crowd = enter(&table, 20, 1).await;
        assert!(!closed(&first[0]) && !closed(&first[1]) && !closed(&first[3]));
        assert!(closed(&first[2]), "beyond her share it is as fresh as any");
        assert_eq!(crowd.iter().filter(|place| !closed(place)).count(), LIMITS.fresh_each);
    }

    #[test]
    fn descriptors_stay_for_the_recordings() {
        assert_eq!(Limits::of(1 << 20).total, MAX_CONNECTIONS);
        assert_eq!(Limits::of(1500).total, 1500 / 2 - CLOSING);
        assert!(Limits::of(256).total + CLOSING <= 128);
    }
}
