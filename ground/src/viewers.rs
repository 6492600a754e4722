//! Who watches: so many sockets altogether, so many of one person, and one more for whoever holds control.
//!
//! Beyond their share the person's own oldest socket is closed: it is the one that a reload or a sleeping computer left
//! behind. Beyond [`MAX_VIEWERS`] a newcomer is refused, but never whoever holds control.

use std::sync::{Arc, Mutex};

use tokio::sync::Notify;

use crate::sync::lock;

/// Most viewers, all vehicles together.
pub const MAX_VIEWERS: usize = 256;
/// Most of one person.
pub const MAX_VIEWERS_EACH: usize = 32;

/// The viewers there are.
#[derive(Debug, Default)]
pub(crate) struct Viewers(Mutex<Seats>);

#[derive(Debug, Default)]
struct Seats {
    /// By age.
    taken: Vec<(u64, String, Arc<Notify>)>,
    next: u64,
}

/// A viewer's seat; given back when dropped.
#[derive(Debug)]
pub(crate) struct Seat {
    viewers: Arc<Viewers>,
    number: u64,
    closed: Arc<Notify>,
}

impl Viewers {
    /// A seat for `who`; `None` when there is none, which is never so for whoever holds `control`.
    pub(crate) fn enter(self: &Arc<Self>, who: &str, control: bool) -> Option<Seat> {
        let closed = Arc::new(Notify::new());
        let mut seats = lock(&self.0);
        let mut own = seats.taken.iter().enumerate().filter(|(_, (_, name, _))| name == who).map(|(index, _)| index);
        let oldest = own.next();
        if own.count() + 1 >= MAX_VIEWERS_EACH
            && let Some(index) = oldest
        {
            seats.taken.remove(index).2.notify_one();
        } else if seats.taken.len() >= MAX_VIEWERS && !control {
            return None;
        }
        let number = seats.next;
        seats.next += 1;
        seats.taken.push((number, who.to_owned(), closed.clone()));
        Some(Seat { viewers: self.clone(), number, closed })
    }
}

impl Viewers {
    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        lock(&self.0).taken.len()
    }
}

impl Seat {
    /// Completes when a newer socket of the same person has taken the seat.
    pub(crate) async fn closed(&self) {
        self.closed.notified().await;
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        lock(&self.viewers.0).taken.retain(|(number, ..)| *number != self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn whoever_holds_control_gets_in_and_the_oldest_of_a_crowd_gives_way() {
        let viewers = Arc::new(Viewers::default());
        let crowd: Vec<_> = (0..MAX_VIEWERS).map(|n| viewers.enter(&format!("viewer {n}"), false).unwrap()).collect();
        assert!(viewers.enter("bob", false).is_none());
        let mut own: Vec<_> = (0..MAX_VIEWERS_EACH).map(|_| viewers.enter("ann", true).unwrap()).collect();
        // One reload more, even without control: her oldest gives way.
        own.push(viewers.enter("ann", false).unwrap());
        own[0].closed().await;
        assert_eq!(lock(&viewers.0).taken.len(), MAX_VIEWERS + MAX_VIEWERS_EACH);
        drop((crowd, own));
        assert!(viewers.enter("bob", false).is_some());
    }
}
