//! Refused requests, gathered: whoever is refused a thousand times a second fills two lines a minute.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::Deed;

/// Refusals of one address and status are one line for this long.
const WINDOW: Duration = Duration::from_secs(60);
/// Most addresses and statuses told apart; what is beyond shares a line for each status.
const MAX_KEYS: usize = 256;

#[derive(Debug, Default)]
pub(super) struct Refusals {
    open: HashMap<(String, u16), Window>,
}

#[derive(Debug)]
struct Window {
    since: Instant,
    /// Refusals after the first, which was written at once: the last of them, with their number.
    last: Option<Deed>,
}

impl Refusals {
    /// Takes a refusal; gives it back when it is to be written at once.
    pub(super) fn take(&mut self, deed: Deed, now: Instant) -> Option<Deed> {
        let mut key = (deed.from.clone(), deed.status);
        if self.open.len() >= MAX_KEYS && !self.open.contains_key(&key) {
            key.0 = "others".to_owned();
        }
        match self.open.get_mut(&key) {
            None => {
                self.open.insert(key, Window { since: now, last: None });
                Some(deed)
            }
            Some(window) => {
                let times = window.last.as_ref().map_or(0, |last| last.times) + 1;
                window.last = Some(Deed { times, ..deed });
                None
            }
        }
    }

    /// Lines that are due; `all` at the end.
    pub(super) fn due(&mut self, now: Instant, all: bool) -> Vec<Deed> {
        let mut lines = Vec::new();
        self.open.retain(|_, window| {
            let over = all || now.saturating_duration_since(window.since) >= WINDOW;
            if over && let Some(last) = window.last.take() {
                lines.push(last);
                // It goes on: the next line is due a window later, and nothing is written at once.
                window.since = now;
                return true;
            }
            !over
        });
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_memory_are_bounded_whoever_asks() {
        let start = Instant::now();
        let mut refusals = Refusals::default();
        let mut written = 0;
        for n in 0..100_000_u32 {
            let deed = Deed { from: n.to_string(), status: 401, ..super::super::tests::deed(1) };
            written += u32::from(refusals.take(deed, start).is_some());
        }
        assert_eq!((written as usize, refusals.open.len()), (MAX_KEYS + 1, MAX_KEYS + 1));
        assert!(refusals.due(start, false).is_empty());
        let lines = refusals.due(start + WINDOW, false);
        assert_eq!((lines.len(), u32::try_from(lines[0].times).unwrap()), (1, 100_000 - written));
        assert_eq!(refusals.open.len(), 1, "quiet addresses are forgotten");
        assert!(refusals.due(start + 2 * WINDOW, false).is_empty() && refusals.open.is_empty());
    }
}
