//! What the charts below were flown with, on their time axis: mode, estimator and gains, attacks, steps, notes.
//!
//! A piece is placed by its own times and by two properties of the whole, where the axis begins and how wide a second is:
//! while the charts move, little but those two is written.

use leptos::prelude::*;
use plumbline_proto::v1::{Mode, Severity};

use crate::{
    deck::{Deck, PIN_NAMES, Source, deck},
    model::{axis::TimeAxis, format, live::Live, names},
};

/// Of a piece so many lengths of the view before and after it are drawn, at least: a browser draws nothing that is too long.
const BEYOND: f64 = 8.0;

/// A stretch of one lane.
#[derive(Debug, Clone, PartialEq)]
struct Piece {
    start_s: f64,
    end_s: f64,
    text: String,
    class: &'static str,
}

/// Name, explanation and pieces of every lane.
type Lanes = [(&'static str, &'static str, Vec<Piece>); 5];

/// Those pieces in view that each begin somewhere and end where something else begins; `told` gives text and class of each.
fn chained<T: PartialEq>(
    begins: impl IntoIterator<Item = (f64, T)>,
    axis: TimeAxis,
    end_s: f64,
    told: impl Fn(T) -> (String, &'static str),
) -> Vec<Piece> {
    let mut begins: Vec<_> = begins.into_iter().collect();
    begins.dedup_by(|next, before| next.1 == before.1);
    let mut ends: Vec<_> = begins.iter().skip(1).map(|(start_s, _)| *start_s).collect();
    ends.push(end_s);
    let seen = begins.into_iter().zip(ends).filter(|((start_s, _), end_s)| in_view(axis, *start_s, *end_s));
    seen.map(|((start_s, of), end_s)| {
        let (text, class) = told(of);
        Piece { start_s, end_s, text, class }
    })
    .collect()
}

fn in_view(axis: TimeAxis, start_s: f64, end_s: f64) -> bool {
    end_s > axis.start_s && start_s < axis.end_s
}

fn mode_class(mode: Mode) -> &'static str {
    match mode {
        Mode::Unspecified | Mode::Disarmed => "idle",
        Mode::Land => "caution",
        Mode::Cut => "alarm",
        Mode::Stabilise | Mode::AltitudeHold | Mode::Hold => "",
    }
}

/// All lanes over a stretch of time; `end_s` is where nothing more is known.
fn lanes(live: &Live, notes: &[(f64, String)], axis: TimeAxis, end_s: f64) -> Lanes {
    let seconds = |us: u64| us as f64 * 1e-6;
    let states = &live.log.states;
    let modes = states.iter().map(|s| (s.from_s, s.mode));
    let mode = |mode: Mode| (names::mode(mode).to_owned(), mode_class(mode));
    let loops = states.iter().map(|s| (s.from_s, (s.estimator, s.gains)));
    let in_loop = |(estimator, gains): (u16, u32)| {
        let gains = if gains > 0 { format!(" · gains {gains}") } else { String::new() };
        (format!("{}{gains}", names::estimator_numbered(estimator)), "loop")
    };
    let steps = live.log.steps.iter().map(|s| (seconds(s.start_time_us), (s.to_m, s.finished)));
    let step =
        |(to_m, finished): (f64, bool)| (format!("{} m", format::fixed(to_m, 2)), if finished { "" } else { "idle" });
    let attacks = live.log.attacks.between(axis.start_s, axis.end_s).filter(|s| in_view(axis, s.start_s, s.end_s));
    let attacks = attacks.map(|span| {
        let of = &span.attack;
        let text = format!("{} {}", names::instance(of.sensor(), of.instance), names::attack_kind(of.kind()));
        let class = if span.seen { "attack" } else { "attack planned" };
        Piece { start_s: span.start_s, end_s: span.end_s, text, class }
    });
    let events = live.log.events.iter().filter_map(|e| match e.severity() {
        Severity::Critical => Some((seconds(e.time_us), (e.text.as_str(), "alarm"))),
        Severity::Warning => Some((seconds(e.time_us), (e.text.as_str(), "caution"))),
        _ => None,
    });
    let mut told: Vec<_> = notes.iter().map(|(at, text)| (*at, (text.as_str(), "note"))).chain(events).collect();
    told.sort_by(|a, b| a.0.total_cmp(&b.0));
    let note = |(text, class): (&str, &'static str)| (text.to_owned(), class);
    // Moved on seldom, so that a piece stays what it is while time passes.
    let drawn_s = (BEYOND * axis.span_s()).log2().ceil().exp2();
    let from_s = ((axis.start_s / drawn_s).floor() - 1.0) * drawn_s;
    let to_s = ((axis.end_s / drawn_s).floor() + 2.0) * drawn_s;
    [
        ("Mode", "Mode of flight", chained(modes, axis, end_s, mode)),
        ("Loop", "What estimated in the loop, and revision of the gains", chained(loops, axis, end_s, in_loop)),
        ("Attack", "Attacks, from the first sample altered to the last", attacks.collect()),
        ("Step", "Altitude asked for", chained(steps, axis, end_s, step)),
        ("Note", "Warnings, and lines of the notes that begin with a time", chained(told, axis, end_s, note)),
    ]
    .map(|(name, about, mut pieces)| {
        for piece in &mut pieces {
            (piece.start_s, piece.end_s) = (piece.start_s.max(from_s), piece.end_s.min(to_s));
        }
        (name, about, pieces)
    })
}

/// Where a time is, as a style's length within a lane.
fn left(time_s: f64) -> String {
    format!("calc(({time_s:.3} - var(--begin)) * var(--second))")
}

fn style(piece: &Piece) -> String {
    format!("left:{};width:calc({:.3} * var(--second))", left(piece.start_s), piece.end_s - piece.start_s)
}

/// The lanes. They stay on top while the charts scroll below them.
#[component]
pub fn Lanes() -> impl IntoView {
    let deck = deck();
    let axis = move || deck.data.with_value(|live| deck.axis(live));
    let moved = move || {
        deck.zoom.track();
        deck.window_s.track();
        deck.beat();
    };
    let all = Memo::new(move |_| {
        moved();
        deck.notes.with(|notes| deck.data.with_value(|live| lanes(live, notes, axis(), end_s(deck, live))))
    });
    let place = Memo::new(move |_| {
        moved();
        let axis = axis();
        format!("--begin:{:.3};--second:{:.5}%", axis.start_s, 100.0 / axis.span_s())
    });
    let now = move || deck.cursor.get().or_else(|| (deck.source == Source::Recorded).then(|| deck.playhead.get()));
    let line =
        |time_s: f64, name: String| view! { <i class="lane-line" style=format!("left:{}", left(time_s))>{name}</i> };
    let clock = move |time_s: f64| {
        deck.zoom.track();
        deck.window_s.track();
        axis().label(time_s, deck.data.with_value(|live| deck.begin_s(live)))
    };
    view! {
        <section class="card lanes" aria-label="Timeline" style=place>
            {move || all.get().into_iter().map(|(name, about, pieces)| view! {
                <div class="lane">
                    <h3 title=about>{name}</h3>
                    <ul aria-label=about>
                        {pieces.into_iter().map(|piece| view! {
                            <li class=piece.class style=style(&piece) title=piece.text.clone()><span>{piece.text.clone()}</span></li>
                        }).collect_view()}
                    </ul>
                </div>
            }).collect_view()}
            <div class="lane-lines" aria-hidden="true">
                {move || now().map(|time_s| line(time_s, clock(time_s)))}
                {move || deck.pins.get().map(|pins| pins.into_iter().zip(PIN_NAMES).map(|(time_s, name)| line(time_s, name.to_owned())).collect_view())}
            </div>
        </section>
    }
}

/// Where nothing more is known: the end of a recording; never, while it flies.
fn end_s(deck: Deck, live: &Live) -> f64 {
    match deck.source {
        Source::Live => f64::INFINITY,
        Source::Recorded => live.curves.time_span_s().map_or(f64::INFINITY, |span| span.end),
    }
}

/// The lines of notes that begin with a time of the flight, `m:ss` or `m:ss.s`: s from its begin, and the rest of the line.
pub fn timed_notes(notes: &str) -> Vec<(f64, String)> {
    let timed = |line: &str| {
        let (time, text) = line.trim().split_once(' ')?;
        let (minutes, seconds) = time.trim_end_matches(',').split_once(':')?;
        let minutes: u32 = minutes.parse().ok()?;
        let seconds: f64 = seconds.parse().ok().filter(|s| (0.0..60.0).contains(s))?;
        Some((60.0 * f64::from(minutes) + seconds, text.trim().to_owned()))
    };
    notes.lines().filter_map(timed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::v1;

    #[test]
    fn a_state_lasts_until_the_next_and_what_is_out_of_view_is_left_out() {
        let mut live = Live::default();
        for (at_s, mode, gains) in [(1, Mode::Disarmed, 0), (4, Mode::AltitudeHold, 0), (6, Mode::AltitudeHold, 2)] {
            let status = v1::Status {
                time_us: at_s * 1_000_000,
                mode: mode.into(),
                estimator_in_loop: 1,
                gains_revision: gains,
                ..Default::default()
            };
            live.log.status(&status);
        }
        let seen = lanes(&live, &[(5.0, "gust".into())], TimeAxis::new(4.5, 10.0), 20.0);
        let of = |i: usize| seen[i].2.iter().map(|p| (p.start_s, p.end_s, p.text.as_str())).collect::<Vec<_>>();
        assert_eq!(of(0), [(4.0, 20.0, "Altitude hold")]);
        assert_eq!(of(1).len(), 2);
        assert!(of(1)[1].2.ends_with("gains 2") && of(1)[0].1 == 6.0, "{:?}", of(1));
        assert_eq!(of(4), [(5.0, 20.0, "gust")]);
    }

    #[test]
    fn a_mode_that_lasts_for_hours_is_drawn_all_along_and_stays_what_it_is_for_a_while() {
        let mut live = Live::default();
        let status = v1::Status { time_us: 1_000_000, mode: Mode::Hold.into(), ..Default::default() };
        live.log.status(&status);
        let mode = |start_s: f64| {
            let [(.., pieces), ..] = lanes(&live, &[], TimeAxis::new(start_s, start_s + 10.0), f64::INFINITY);
            pieces
        };
        for start_s in [0.0, 100.0, 7200.0, 36_000.0, 1e6] {
            let pieces = mode(start_s);
            assert_eq!(pieces.len(), 1, "{start_s}");
            let piece = &pieces[0];
            assert!(piece.start_s <= start_s.max(1.0) && piece.end_s >= start_s + 10.0, "{start_s}: {piece:?}");
            assert!(piece.end_s - piece.start_s <= 400.0, "{start_s}: {piece:?}");
        }
        assert_eq!(mode(36_000.0), mode(36_060.0));
    }

    #[test]
    fn lines_of_notes_that_begin_with_a_time_are_placed() {
        let notes = "windy\n0:12 door opened\n1:02.5, string slack\n1:75 no time\n3:10";
        assert_eq!(timed_notes(notes), [(12.0, "door opened".to_owned()), (62.5, "string slack".to_owned())]);
    }
}
