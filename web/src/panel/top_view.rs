//! The plane from above: the box the vehicle stays in, where it was, is and is to be. In hold a click sets the position;
//! the fields on its card do the same by keyboard.

use std::fmt::Write as _;

use leptos::prelude::*;
use plumbline_proto::v1::Mode;
use serde_json::json;

use super::alarms::Guarded;
use crate::{
    ctx::ctx,
    deck::{Deck, Source, deck},
    model::{
        curves::{Axis, Curve, Horizontal},
        format::fixed,
        layout::Evidence,
        live::Live,
    },
};

/// The trail goes back so far, s …
const TRAIL_S: f64 = 12.0;
/// … in so many stretches.
const TRAIL_POINTS: u32 = 60;
/// Lines of the grid are so far apart, m.
const GRID_M: f64 = 0.5;
/// Clicks are rounded to this, m.
const CLICK_M: f64 = 0.01;
/// Room around the box, as a part of it.
const ROOM: f64 = 1.08;

/// What is drawn, m and degrees; north is up.
#[derive(Debug, Clone, PartialEq, Default)]
struct Seen {
    half_m: f64,
    /// Oldest first.
    trail: Vec<[f64; 2]>,
    yaw_deg: f64,
    goal: Option<[f64; 2]>,
    truth: Option<[f64; 2]>,
}

impl Seen {
    /// At a flight time; the newest, where none is given.
    fn new(live: &Live, at_s: Option<f64>) -> Self {
        let now_s = at_s.unwrap_or(live.clock.newest_us() as f64 * 1e-6);
        let times = (0..=TRAIL_POINTS).rev().map(|n| now_s - TRAIL_S * f64::from(n) / f64::from(TRAIL_POINTS));
        let control = live.control.get().filter(|_| at_s.is_none());
        let setpoint = control.and_then(|control| control.setpoint.as_ref());
        let limits = live.description.get().and_then(|description| description.limits.as_ref());
        Self {
            half_m: limits.map_or(0.0, |limits| limits.lateral_max_m),
            trail: times.filter_map(|time_s| live.curves.place_at(Curve::Plane, time_s)).collect(),
            yaw_deg: live.curves.value_at(Curve::Attitude(live.in_loop(), Axis::Yaw), now_s).unwrap_or(0.0),
            goal: setpoint.and_then(|setpoint| Some([setpoint.x_m?, setpoint.y_m?])),
            truth: live.curves.place_at(Curve::TruthPlane, now_s),
        }
    }

    /// Half of the picture's side, m.
    fn side_m(&self) -> f64 {
        (self.half_m * ROOM).max(GRID_M)
    }

    fn label(&self) -> String {
        let told = |what: &str, [x, y]: [f64; 2]| format!("{what} {} m east, {} m north", fixed(x, 2), fixed(y, 2));
        match (self.trail.last(), self.goal) {
            (Some(now), Some(goal)) => format!("From above: {}, {}", told("vehicle", *now), told("setpoint", goal)),
            (Some(now), None) => format!("From above: {}", told("vehicle", *now)),
            _ => "From above: the position is not known".into(),
        }
    }
}

/// Where a click lies in the plane, m: so many px from the left and the top of a square picture of `px`, that shows
/// `side_m` to each side; within the box.
fn place(from_left: f64, from_top: f64, px: f64, side_m: f64, half_m: f64) -> [f64; 2] {
    let metres = |from: f64| {
        let m = (2.0 * from / px - 1.0) * side_m;
        ((m / CLICK_M).round() * CLICK_M).clamp(-half_m, half_m)
    };
    [metres(from_left), 0.0 - metres(from_top)]
}

fn points(trail: &[[f64; 2]]) -> String {
    trail.iter().fold(String::new(), |mut out, [x, y]| {
        // Writing to a string does not fail.
        let _ = write!(out, "{x:.3},{:.3} ", -y);
        out
    })
}

/// Is the position observed at a flight time, or now?
fn observed(live: &Live, at_s: Option<f64>) -> bool {
    let now_s = at_s.unwrap_or(live.clock.newest_us() as f64 * 1e-6);
    let newest = live.curves.get(Curve::Plane(Horizontal::East)).and_then(|series| series.at(now_s));
    newest.is_some_and(|(time_s, east_m)| east_m.is_finite() && now_s - time_s < TRAIL_S)
}

/// Beside the errors, in every mode in which a position is observed.
#[component]
pub fn FromAbove() -> impl IntoView {
    let (ctx, deck) = (ctx(), deck());
    let known = Memo::new(move |_| {
        let at_s = deck.reading_s();
        deck.evidence.get() == Evidence::Errors && deck.read(|live| observed(live, at_s))
    });
    let sets = Memo::new(move |_| {
        deck.source == Source::Live && ctx.live(|live| !live.is_replay() && live.mode() == Mode::Hold)
    });
    move || {
        known.get().then(|| {
            let picture = if sets.get() {
                view! { <Guarded><TopView settable=true /></Guarded> }.into_any()
            } else {
                view! { <TopView settable=false /> }.into_any()
            };
            view! {
                <section class="card from-above" aria-label="Position from above">
                    <header><h2>"From above"</h2><span class="quiet">"north up"</span></header>
                    {picture}
                </section>
            }
        })
    }
}

/// The picture: where the charts are read, of a vehicle with charts.
#[component]
pub fn TopView(
    /// Does a click set the position?
    settable: bool,
) -> impl IntoView {
    let ctx = ctx();
    let node = NodeRef::<leptos::svg::Svg>::new();
    let deck = use_context::<Deck>();
    let seen = Memo::new(move |_| match deck {
        Some(deck) => {
            let at_s = deck.reading_s();
            deck.read(|live| Seen::new(live, at_s))
        }
        None => ctx.live(|live| Seen::new(live, None)),
    });
    let old =
        Memo::new(move |_| deck.is_none_or(|deck| deck.source == Source::Live) && ctx.is_old(|live| &live.control));
    let click = move |event: leptos::ev::MouseEvent| {
        if !settable {
            return;
        }
        let Some(rect) = node.get_untracked().map(|node| node.get_bounding_client_rect()) else { return };
        let (side_m, half_m) = seen.with_untracked(|seen| (seen.side_m(), seen.half_m));
        let px = rect.width().min(rect.height());
        // The square lies in the middle of its place.
        let from = |at: f64, begin: f64, length: f64| at - begin - (length - px) / 2.0;
        let from_left = from(event.client_x().into(), rect.left(), rect.width());
        let from_top = from(event.client_y().into(), rect.top(), rect.height());
        let [x_m, y_m] = place(from_left, from_top, px, side_m, half_m);
        ctx.command("Position", "POST", "setpoint", json!({ "x_m": x_m, "y_m": y_m }));
    };
    let body = move || {
        let seen = seen.get();
        let (half, side) = (seen.half_m, seen.side_m());
        let lines = (half / GRID_M).floor() as i32;
        let grid = (-lines..=lines).map(|n| f64::from(n) * GRID_M).map(|at| {
            view! { <path class="grid" d=format!("M{at} {}V{half}M{} {at}H{half}", -half, -half)></path> }
        });
        // Sizes are shares of the picture's side.
        let mark = side * 0.05;
        let cross = |[x, y]: [f64; 2], class: &'static str| {
            let d = format!("M{} {}h{}M{x} {}v{}", x - mark, -y, 2.0 * mark, -y - mark, 2.0 * mark);
            view! { <path class=class d=d></path> }
        };
        let arrow = seen.trail.last().map(|[x, y]| {
            let turned = format!("translate({x:.3} {:.3}) rotate({:.1})", -y, -seen.yaw_deg);
            let d = format!("M{} 0L{} {}L{} 0L{} {}Z", 1.6 * mark, -mark, 0.9 * mark, -0.5 * mark, -mark, -0.9 * mark);
            view! { <path class="vehicle" transform=turned d=d></path> }
        });
        view! {
            {grid.collect::<Vec<_>>()}
            <rect class="box" x=-half y=-half width=2.0 * half height=2.0 * half></rect>
            <polyline class="trail" points=points(&seen.trail)></polyline>
            {seen.truth.map(|at| cross(at, "truth"))}
            {arrow}
            {seen.goal.map(|at| cross(at, "goal"))}
        }
    };
    view! {
        <svg
            class="top-view"
            class:stale=old
            class:settable=settable
            role="img"
            aria-label=move || seen.with(Seen::label)
            node_ref=node
            viewBox=move || seen.with(|seen| format!("{0} {0} {1} {1}", -seen.side_m(), 2.0 * seen.side_m()))
            on:click=click
        >
            <title>{if settable { "From above, north up; lines are 0.5 m apart. A click sets the position." } else { "From above, north up; lines are 0.5 m apart." }}</title>
            {body}
        </svg>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_click_is_a_place_in_the_box_with_north_up() {
        assert_eq!(place(100.0, 100.0, 200.0, 2.0, 1.8), [0.0, 0.0]);
        assert_eq!(place(150.0, 50.0, 200.0, 2.0, 1.8), [1.0, 1.0]);
        assert_eq!(place(0.0, 200.0, 200.0, 2.0, 1.8), [-1.8, -1.8]);
    }

    #[test]
    fn what_is_seen_is_said() {
        let mut seen = Seen { half_m: 2.0, ..Seen::default() };
        assert_eq!(seen.label(), "From above: the position is not known");
        seen.trail = vec![[0.0, 0.0], [0.25, -1.0]];
        assert_eq!(seen.label(), "From above: vehicle 0.25 m east, −1.00 m north");
        seen.goal = Some([0.5, 0.0]);
        assert_eq!(seen.label(), "From above: vehicle 0.25 m east, −1.00 m north, setpoint 0.50 m east, 0.00 m north");
        assert_eq!(points(&seen.trail), "0.000,-0.000 0.250,1.000 ");
    }
}
