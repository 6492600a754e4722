//! What the charts of a recorded flight are drawn from: of a long one, what is left of it after the ground has thinned it to
//! the width of the charts; and beside it, in its place, every sample of what is looked at.

use leptos::prelude::*;
use plumbline_rest::flight::{OVERVIEW_COLUMNS, OVERVIEW_KINDS};

use super::load;
use crate::{
    deck::{Deck, settled},
    event::Failure,
    model::{
        curves::{Curves, Whole},
        layout::Evidence,
        live::Live,
    },
};

/// A flight of up to so many seconds comes whole at once: 25 MB.
pub const WHOLE_S: f64 = 60.0;
/// Stretches of time that a longer one is thinned to.
const COLUMNS: f64 = OVERVIEW_COLUMNS as f64;
/// While nothing is zoomed into, what lies about the play head is read in pieces so long, with so much before and after, s.
const PIECE_S: f64 = 10.0;
const BEFORE_S: f64 = 2.0;
const AFTER_S: f64 = 4.0;
/// The ground counts from the first message, the charts from the first that they show: never so much later, s.
const SLACK_S: f64 = 0.5;

/// Plotted kinds. Residuals are half of all bytes.
const FLOWN: &str = "estimate,control,truth,height,status,secure";

/// Messages of a flight that lasts `length_s`, thinned where it is long; `told` as by [`load`].
pub(super) async fn overview(id: &str, length_s: f64, told: impl Fn(f64)) -> Result<Live, Failure> {
    if length_s <= WHOLE_S {
        return load(id, OVERVIEW_KINDS, "", told).await;
    }
    let mut flight = load(id, OVERVIEW_KINDS, &format!("&columns={COLUMNS}"), told).await?;
    let thinned = std::mem::replace(&mut flight.curves, Curves::unbounded());
    flight.curves.refine(&thinned, length_s / COLUMNS, None, Whole::NOWHERE);
    Ok(flight)
}

/// A part of a flight, s of flight time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    /// What is looked at.
    seen_s: [f64; 2],
    /// What is read for it, and a little more of the way one may go.
    read_s: [f64; 2],
    /// Every sample of it? Else as many as charts need.
    whole: bool,
}

impl Part {
    fn length_s(&self) -> f64 {
        self.read_s[1] - self.read_s[0]
    }

    /// Stretches of time in each second; infinite: every sample.
    fn density(&self) -> f64 {
        if self.whole { f64::INFINITY } else { 3.0 * COLUMNS / self.length_s() }
    }

    /// Is `other` to be seen well enough in this?
    fn shows(&self, other: &Self) -> bool {
        let inside = self.read_s[0] <= other.seen_s[0] && other.seen_s[1] <= self.read_s[1];
        inside && (self.whole || (!other.whole && 2.0 * self.density() >= other.density()))
    }

    fn has_residuals(&self) -> bool {
        !self.whole || self.length_s() <= WHOLE_S
    }

    /// The query that reads it, of a flight that begins at `begin_s`.
    fn query(&self, begin_s: f64) -> String {
        let [from_s, to_s] = self.read_s.map(|time_s| time_s - begin_s);
        let columns = if self.whole { String::new() } else { format!("&columns={}", 3.0 * COLUMNS) };
        format!("&from_s={:.3}&to_s={:.3}{columns}", (from_s - SLACK_S).max(0.0), to_s + SLACK_S)
    }
}

/// What is looked at of a flight that lasts over `span_s`.
#[derive(Debug, Clone, Copy)]
struct Look {
    span_s: [f64; 2],
    zoom: Option<[f64; 2]>,
    /// Errors are found from every sample of what is in view.
    errors: bool,
    /// And so is what lies between the pinned cursors.
    pins: Option<[f64; 2]>,
    playhead_s: f64,
}

impl Look {
    /// What it takes; `None` where the overview will do.
    fn part(&self) -> Option<Part> {
        let inside = |[from, to]: [f64; 2]| [from, to].map(|time_s| time_s.clamp(self.span_s[0], self.span_s[1]));
        let in_view = inside(self.zoom.unwrap_or(self.span_s));
        let pinned = self.pins.map(|[a, b]| inside([a.min(b), a.max(b)]));
        let exact = match (self.errors, pinned) {
            (true, Some([from, to])) => Some([from.min(in_view[0]), to.max(in_view[1])]),
            (true, None) => Some(in_view),
            (false, pinned) => pinned,
        };
        let around = |[from, to]: [f64; 2], side: f64| inside([from - side, to + side]);
        if let Some(seen_s) = exact {
            let length_s = seen_s[1] - seen_s[0];
            let side = if 3.0 * length_s <= WHOLE_S { length_s } else { 0.0 };
            return Some(Part { seen_s, read_s: around(seen_s, side), whole: true });
        }
        if self.zoom.is_some() {
            let read_s = around(in_view, in_view[1] - in_view[0]);
            return Some(Part { seen_s: in_view, read_s, whole: read_s[1] - read_s[0] <= WHOLE_S });
        }
        let begin_s = self.span_s[0];
        (self.playhead_s > begin_s).then(|| {
            let from = begin_s + ((self.playhead_s - begin_s) / PIECE_S).floor() * PIECE_S;
            let to = from + PIECE_S;
            Part { seen_s: inside([from, to]), read_s: inside([from - BEFORE_S, to + AFTER_S]), whole: true }
        })
    }
}

/// Reads what is looked at of a thinned flight, and puts it in its place; what is told of that.
pub(super) fn follow(deck: Deck, id: String) -> RwSignal<String> {
    let told = RwSignal::new(String::new());
    let [begin_s, end_s] = deck.in_view();
    let thinned = deck.data.with_value(|live| {
        let everywhere = live.curves.is_everywhere_whole();
        (!everywhere).then(|| live.curves.copy())
    });
    let Some(thinned) = thinned else { return told };
    let thinned = StoredValue::new_local(thinned);
    let shown = StoredValue::new(None::<Part>);
    let asked = StoredValue::new(0_u32);
    let look = move || Look {
        span_s: [begin_s, end_s],
        zoom: deck.zoom.get().map(|(from, to)| [from, to]),
        errors: deck.evidence.get() == Evidence::Errors,
        pins: deck.pins.get(),
        playhead_s: deck.playhead.get(),
    };
    settled(
        move || look().part(),
        move |part| {
            let Some(part) = part.filter(|part| shown.get_value().is_none_or(|shown| !shown.shows(part))) else {
                return;
            };
            let number = asked.get_value() + 1;
            asked.set_value(number);
            told.set("reading…".to_owned());
            let id = id.clone();
            leptos::task::spawn_local(async move {
                let kinds = if part.has_residuals() { format!("{FLOWN},residuals") } else { FLOWN.to_owned() };
                let answer = load(&id, &kinds, &part.query(begin_s), |_| {}).await;
                // The page may have been left meanwhile, or something else be looked at.
                if asked.try_get_value() != Some(number) {
                    return;
                }
                let detail = match answer {
                    Ok(detail) => detail,
                    Err(failure) => return drop(told.try_set(format!("not read in full: {}", failure.text))),
                };
                told.set(String::new());
                shown.set_value(Some(part));
                let whole = Whole { between_s: part.read_s, residuals: part.has_residuals() };
                let whole = if part.whole { whole } else { Whole::NOWHERE };
                thinned.with_value(|thinned| {
                    deck.data.update_value(|live| {
                        live.curves.refine(
                            thinned,
                            (end_s - begin_s) / COLUMNS,
                            Some((&detail.curves, part.read_s)),
                            whole,
                        );
                    });
                });
            });
        },
    );
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLIGHT: Look = Look { span_s: [100.0, 820.0], zoom: None, errors: false, pins: None, playhead_s: 100.0 };

    #[test]
    fn at_first_the_overview_will_do() {
        assert_eq!(FLIGHT.part(), None);
    }

    #[test]
    fn the_play_head_is_read_in_pieces_that_reach_into_the_next() {
        let at = |playhead_s| Look { playhead_s, ..FLIGHT }.part().unwrap();
        let part = at(117.0);
        assert_eq!((part.seen_s, part.read_s, part.whole), ([110.0, 120.0], [108.0, 124.0], true));
        assert_eq!(at(118.0), part);
        assert!(!part.shows(&at(121.0)));
        assert_eq!(at(820.0).read_s, [818.0, 820.0]);
    }

    #[test]
    fn a_long_view_comes_thinned_and_a_short_one_whole() {
        let zoomed = |from, to| Look { zoom: Some([from, to]), ..FLIGHT }.part().unwrap();
        let long = zoomed(200.0, 320.0);
        assert_eq!((long.read_s, long.whole), ([100.0, 440.0], false));
        assert!(long.shows(&zoomed(210.0, 300.0)) && !long.shows(&zoomed(210.0, 211.0)));
        let short = zoomed(210.0, 220.0);
        assert_eq!((short.read_s, short.whole), ([200.0, 230.0], true));
        assert!(short.shows(&zoomed(205.0, 206.0)) && !short.shows(&zoomed(195.0, 205.0)));
        assert_eq!(short.query(100.0), "&from_s=99.500&to_s=130.500");
        assert!(long.query(100.0).ends_with("&columns=1800"));
    }

    #[test]
    fn errors_and_cursors_take_every_sample() {
        let errors = Look { errors: true, ..FLIGHT };
        let all = errors.part().unwrap();
        assert_eq!((all.read_s, all.whole, all.has_residuals()), ([100.0, 820.0], true, false));
        let near = Look { zoom: Some([300.0, 310.0]), pins: Some([340.0, 330.0]), ..errors }.part().unwrap();
        assert_eq!((near.seen_s, near.whole), ([300.0, 340.0], true));
        let pinned = Look { pins: Some([340.0, 330.0]), ..FLIGHT }.part().unwrap();
        assert_eq!((pinned.seen_s, pinned.read_s, pinned.has_residuals()), ([330.0, 340.0], [320.0, 350.0], true));
        assert!(!Look { zoom: Some([300.0, 420.0]), ..FLIGHT }.part().unwrap().shows(&pinned));
    }
}
