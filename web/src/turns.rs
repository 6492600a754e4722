//! Commands whose order matters go to the ground one after another, as they were asked: a browser sends each on a connection of its own,
//! and of two the later may come first.

use std::time::Duration;

use futures_channel::oneshot::{self, Receiver, Sender};

/// No command is waited for longer than this: one that was asked so long ago is too old for the vehicle.
pub const LONGEST: Duration = Duration::from_secs(2);

/// Who has asked and was not answered yet.
#[derive(Debug, Default)]
pub struct Turns {
    newest: Option<Receiver<()>>,
    /// So many waited for nobody.
    urgent: u64,
}

/// A place behind all that were asked before.
#[derive(Debug)]
pub struct Turn {
    before: Option<Receiver<()>>,
    urgent: u64,
}

/// While it is kept, whoever asks later waits.
#[derive(Debug)]
pub struct Kept(#[expect(dead_code, reason = "it tells by being dropped")] Sender<()>);

impl Turns {
    /// The next place. An `urgent` one waits for nobody, and what waits then is [overtaken](Self::overtook).
    pub fn take(&mut self, urgent: bool) -> (Turn, Kept) {
        let (sender, end) = oneshot::channel();
        let before = self.newest.replace(end).filter(|_| !urgent);
        self.urgent += u64::from(urgent);
        (Turn { before, urgent: self.urgent }, Kept(sender))
    }

    /// Has something urgent been asked since, by whoever waited for somebody? Then that is not what is wanted any more.
    pub fn overtook(&self, turn: &Turn) -> bool {
        turn.before.is_some() && turn.urgent != self.urgent
    }
}

impl Turn {
    /// Waits until nobody who was asked before is waited for.
    pub async fn comes(&mut self) {
        if let Some(before) = &mut self.before {
            // Its sender was dropped, which is what is waited for.
            let _ = before.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::task::{Context, Poll, Waker};

    use super::*;

    fn waits(turn: &mut Turn) -> bool {
        let mut comes = std::pin::pin!(turn.comes());
        comes.as_mut().poll(&mut Context::from_waker(Waker::noop())) == Poll::Pending
    }

    #[test]
    fn each_waits_for_the_one_before_it_while_that_is_kept() {
        let mut turns = Turns::default();
        let ((mut first, first_kept), (mut second, second_kept)) = (turns.take(false), turns.take(false));
        assert!(!waits(&mut first));
        assert!(waits(&mut second), "the first is not over");
        drop(first_kept);
        assert!(!waits(&mut second) && !turns.overtook(&second));
        drop(second_kept);
        assert!(!waits(&mut turns.take(false).0), "all are over");
    }

    #[test]
    fn what_is_urgent_waits_for_nobody_and_overtakes_what_waits() {
        let mut turns = Turns::default();
        let ((_, _first), (second, _second)) = (turns.take(false), turns.take(false));
        let (mut urgent, _kept) = turns.take(true);
        assert!(!waits(&mut urgent));
        assert!(turns.overtook(&second));
        let (mut after, _) = turns.take(false);
        assert!(!turns.overtook(&after));
        assert!(waits(&mut after), "it came before what was urgent");
        let _cut = turns.take(true);
        assert!(turns.overtook(&after) && !turns.overtook(&urgent), "to land is sent, too, when a cut follows");
    }
}
