//! Commands whose order matters go to the ground one after another, as they were asked: a browser sends each on a connection of its own,
//! and of two the later may come first.

use futures_channel::oneshot::{self, Receiver, Sender};

/// Who has asked and was not answered yet.
#[derive(Debug, Default)]
pub struct Turns {
    newest: Option<Receiver<()>>,
    /// So many waited for nobody.
    urgent: u64,
}

/// A place behind all that were asked before; whoever comes after it waits until it is dropped.
#[derive(Debug)]
pub struct Turn {
    before: Option<Receiver<()>>,
    urgent: u64,
    _ends: Sender<()>,
}

impl Turns {
    /// The next place. An `urgent` one waits for nobody, and what waits then is [overtaken](Self::overtook).
    pub fn take(&mut self, urgent: bool) -> Turn {
        let (ends, end) = oneshot::channel();
        let before = self.newest.replace(end).filter(|_| !urgent);
        self.urgent += u64::from(urgent);
        Turn { before, urgent: self.urgent, _ends: ends }
    }

    /// Has something urgent been asked since? Then what waited is not what is wanted any more.
    pub fn overtook(&self, turn: &Turn) -> bool {
        turn.urgent != self.urgent
    }
}

impl Turn {
    /// Waits for all that were asked before.
    pub async fn comes(&mut self) {
        if let Some(before) = &mut self.before {
            // It ends by being dropped.
            let _ = before.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::task::{Context, Poll, Waker};

    use super::*;

    /// Would it wait?
    fn waits(turn: &mut Turn) -> bool {
        let mut comes = std::pin::pin!(turn.comes());
        let waiting = comes.as_mut().poll(&mut Context::from_waker(Waker::noop())) == Poll::Pending;
        waiting
    }

    #[test]
    fn each_waits_for_those_before_it() {
        let mut turns = Turns::default();
        let [mut first, mut second] = [turns.take(false), turns.take(false)];
        assert!(!waits(&mut first));
        assert!(waits(&mut second), "the first is not over");
        drop(first);
        assert!(!waits(&mut second) && !turns.overtook(&second));
        drop(second);
        assert!(!waits(&mut turns.take(false)), "all are over");
    }

    #[test]
    fn what_is_urgent_waits_for_nobody_and_overtakes_what_waits() {
        let mut turns = Turns::default();
        let first = turns.take(false);
        let second = turns.take(false);
        let mut urgent = turns.take(true);
        assert!(!waits(&mut urgent));
        assert!(turns.overtook(&first) && turns.overtook(&second) && !turns.overtook(&urgent));
        let mut after = turns.take(false);
        assert!(!turns.overtook(&after));
        assert!(waits(&mut after), "it came before what was urgent");
    }
}
