//! Play, speed, position and event marks of a recorded flight.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::time::Duration;

use leptos::{ev, html, prelude::*};

use crate::{
    ctx::every,
    deck::Deck,
    keys::Takes,
    model::{curves::Curve, live::Live},
    net,
};

/// Playback speeds.
const SPEEDS: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];

/// Stretches of time that the altitude below it is drawn in.
const STRETCHES: usize = 300;
/// The least range of altitude that fills its height, m.
const LEAST_M: f32 = 0.1;

/// Events of one kind that are marked, at most.
const MOST_MARKS: usize = 60;

/// Play, speed, position, event marks.
#[component]
pub(super) fn Scrub(
    deck: Deck,
    /// What is being read of the recording; empty: nothing.
    reading: RwSignal<String>,
) -> impl IntoView {
    let playing = RwSignal::new(false);
    let speed = RwSignal::new(1.0);
    let bar = NodeRef::<html::Div>::new();
    let (begin, end) = deck
        .data
        .with_value(|live| live.curves.time_span_s().map_or((0.0, 1.0), |s| (s.start, s.end.max(s.start + 0.001))));
    let length = end - begin;
    let last = StoredValue::new(net::now_ms());
    let step = move || {
        let now = net::now_ms();
        let passed = (now - last.get_value()) * 1e-3;
        last.set_value(now);
        if !playing.get_untracked() {
            return;
        }
        let next = deck.playhead.get_untracked() + passed * speed.get_untracked();
        deck.playhead.set(next.min(end));
        deck.follow(end);
        if next >= end {
            playing.set(false);
        }
    };
    every(Duration::from_millis(33), step);
    let toggle = move || {
        if !playing.get_untracked() && deck.playhead.get_untracked() >= end - 1e-6 {
            deck.playhead.set(begin);
        }
        playing.update(|p| *p = !*p);
    };
    let seek = move |delta: f64| deck.playhead.update(|t| *t = (*t + delta).clamp(begin, end));
    let keys = window_event_listener(ev::keydown, move |e| {
        let takes = Takes::by(&e);
        if takes == Takes::All || e.ctrl_key() || e.alt_key() || e.meta_key() {
            return;
        }
        let far = if e.shift_key() { 10.0 } else { 1.0 };
        match e.key().as_str() {
            " " if takes == Takes::Nothing => toggle(),
            "ArrowLeft" => seek(-far),
            "ArrowRight" => seek(far),
            "Home" => deck.playhead.set(begin),
            "End" => deck.playhead.set(end),
            _ => return,
        }
        e.prevent_default();
    });
    on_cleanup(move || keys.remove());
    let go_to = move |e: &ev::PointerEvent| {
        let Some(bar) = bar.get_untracked() else { return };
        let rect = bar.get_bounding_client_rect();
        let fraction = ((f64::from(e.client_x()) - rect.left()) / rect.width().max(1.0)).clamp(0.0, 1.0);
        deck.playhead.set(begin + fraction * length);
    };
    let percent = move |time: f64| (time - begin) / length * 100.0;
    let marks = deck.data.with_value(|live| {
        let events = live.log.events.iter().map(|e| (e.time_us as f64 * 1e-6, e.kind.clone(), e.text.clone()));
        let marks: Vec<_> = events.filter(|(t, _, _)| *t >= begin && *t <= end).collect();
        // What happens all the time (a stick's setpoints) marks nothing.
        let mut count = HashMap::<String, usize>::new();
        marks.iter().for_each(|(_, kind, _)| *count.entry(kind.clone()).or_default() += 1);
        marks.into_iter().filter(|(_, kind, _)| count.get(kind).is_none_or(|n| *n <= MOST_MARKS)).collect::<Vec<_>>()
    });
    let spans = deck.data.with_value(|live| {
        let seen = live.log.attacks.between(begin, end).filter(|s| s.seen);
        seen.map(|s| (s.start_s.max(begin), s.end_s.min(end))).collect::<Vec<_>>()
    });
    let curve = deck.data.with_value(|live| outline(live, begin, end));
    view! {
        <div class="card scrub" role="group" aria-label="Replay">
          <div class="scrub-side">
            <button type="button" class="play" aria-label=move || if playing.get() { "Pause replay" } else { "Play replay" } title="Space" on:click=move |_| toggle()>
                {move || if playing.get() { "❚❚" } else { "▶" }}
            </button>
            <select class="small" aria-label="Replay speed" on:change:target=move |e| speed.set(e.target().value().parse().unwrap_or(1.0))>
                {SPEEDS.into_iter().map(|s| view! { <option value=s.to_string() selected=move || speed.get() == s>{format!("{s}×")}</option> }).collect::<Vec<_>>()}
            </select>
            <output class="num">{move || format!("{} / {}", tenths(deck.playhead.get() - begin), tenths(length))}</output>
            <small class="quiet one-line" role="status">{reading}</small>
          </div>
            <div
                class="scrub-bar"
                node_ref=bar
                role="slider"
                tabindex="0"
                aria-label="Position in the flight, in seconds"
                aria-valuemin="0"
                aria-valuemax=format!("{length:.1}")
                aria-valuenow=move || format!("{:.1}", deck.playhead.get() - begin)
                on:pointerdown=move |e| {
                    if let Some(bar) = bar.get_untracked() {
                        let _ = bar.set_pointer_capture(e.pointer_id());
                    }
                    go_to(&e);
                }
                on:pointermove=move |e| if e.buttons() == 1 { go_to(&e) }
            >
                <svg class="scrub-curve" viewBox=format!("0 0 {STRETCHES} 1") preserveAspectRatio="none" aria-hidden="true"><path d=curve></path></svg>
                {spans.into_iter().map(|(a, b)| view! {
                    <i class="scrub-attack" style=format!("left:{:.2}%;width:{:.2}%", percent(a), (percent(b) - percent(a)).max(0.3))></i>
                }).collect::<Vec<_>>()}
                {marks.into_iter().map(|(time, kind, text)| view! {
                    <i class=format!("scrub-mark {kind}") style=format!("left:{:.2}%", percent(time)) title=text></i>
                }).collect::<Vec<_>>()}
                {move || deck.zoom.get().map(|(a, b)| view! {
                    <i class="scrub-zoom" style=format!("left:{:.2}%;width:{:.2}%", percent(a).max(0.0), (percent(b).min(100.0) - percent(a).max(0.0)).max(0.3))></i>
                })}
                <b class="scrub-head" style=move || format!("left:{:.2}%", percent(deck.playhead.get()))></b>
            </div>
        </div>
    }
}

/// The altitude over the whole flight, true where that is known: least and greatest of each stretch, 0 to 1 from the top; empty where
/// there is none.
fn outline(live: &Live, begin_s: f64, end_s: f64) -> String {
    let known = live.curves.get(Curve::TruthAltitude).or_else(|| live.curves.get(Curve::Altitude(live.in_loop())));
    let Some(altitude) = known else { return String::new() };
    let whole = altitude.extent_between(begin_s, end_s);
    let range_m = (whole.max - whole.min).max(LEAST_M);
    let place = |value: f32| 1.0 - 0.96 * (value - whole.min) / range_m;
    let step_s = (end_s - begin_s) / STRETCHES as f64;
    let stretches = (0..STRETCHES).map(|n| {
        let from_s = begin_s + n as f64 * step_s;
        (n, altitude.extent_between(from_s, from_s + step_s))
    });
    stretches.filter(|(_, extent)| !extent.is_empty()).fold(String::new(), |mut path, (n, extent)| {
        // Writing to a string does not fail.
        let _ = write!(
            path,
            "{}{n} {:.3}V{:.3}",
            if path.is_empty() { 'M' } else { 'L' },
            place(extent.max),
            place(extent.min)
        );
        path
    })
}

/// `m:ss.t`
fn tenths(seconds: f64) -> String {
    let tenth = (seconds.max(0.0) * 10.0).round() as u64;
    format!("{}:{:02}.{}", tenth / 600, tenth / 10 % 60, tenth % 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_altitude_lies_below_the_bar_with_its_peaks() {
        let mut live = Live::recorded();
        assert_eq!(outline(&live, 0.0, 10.0), "");
        for i in 0..=1000_u64 {
            live.curves.push(Curve::TruthAltitude, i * 10_000, if i == 505 { 2.0 } else { 1.0 });
        }
        let path = outline(&live, 0.0, 10.0);
        assert!(path.starts_with("M0 1.000V1.000L1 ") && path.contains("V1.000"), "{path}");
        assert_eq!(path.matches(" 0.040V").count(), 1, "one peak");
        assert!(path.ends_with("L299 1.000V1.000"), "{path}");
    }

    #[test]
    fn positions_have_tenths() {
        assert_eq!(super::tenths(62.34), "1:02.3");
        assert_eq!(super::tenths(-1.0), "0:00.0");
        assert_eq!(super::tenths(59.97), "1:00.0");
    }
}
