//! Artificial horizon with altitude tape and compass, or the vehicle in space.
//!
//! Horizon and vehicle are drawn behind the page; tape and compass are page elements that slide.

use leptos::{ev, html, prelude::*};

use crate::{
    deck::{Picture, deck},
    gpu::horizon::{LADDER_HALF, LADDER_PER_RAD, ladder_lies, ladder_numbers},
    model::format,
};

/// Height of one metre on the tape, px.
const TAPE_PX_PER_M: f64 = 100.0;
/// Marks of a decimetre on each side of the middle.
const TAPE_MARKS: i64 = 40;
/// Width of one degree on the compass, px.
const COMPASS_PX_PER_DEG: f64 = 1.7;

/// From the end of a rung to the middle of its number, px.
const BESIDE_PX: f64 = 11.0;

/// The camera above the vehicle: azimuth, elevation, distance.
const FROM_ABOVE: (f32, f32, f32) = (-std::f32::consts::FRAC_PI_2, 1.5, 3.0);

/// The instrument at the top left.
#[component]
pub fn HorizonCard() -> impl IntoView {
    let deck = deck();
    let here = Memo::new(move |_| deck.space.get() && !deck.wide.get());
    view! {
        <section class="card horizon-card" aria-label="Attitude instrument">
            <h2 class="visually-hidden">"Attitude instrument"</h2>
            <div class="horizon-row">
                {move || if here.get() { view! { <Space /> }.into_any() } else { view! { <Horizon /> }.into_any() }}
                <Tape />
            </div>
            <Compass />
            <button
                type="button"
                class="small swap"
                aria-pressed=move || here.get().to_string()
                aria-label="3D view"
                title="Horizon or the vehicle in space"
                on:click=move |_| {
                    deck.space.set(!here.get_untracked());
                    deck.wide.set(false);
                }
            >
                {move || if here.get() { "horizon" } else { "3D" }}
            </button>
            <Show when=move || here.get()>
                <div class="swap second buttons-row">
                    <FromAbove />
                    <button type="button" class="small" aria-label="Expand the 3D view" title="In the middle of the page" on:click=move |_| deck.wide.set(true)>"⤢"</button>
                </div>
            </Show>
        </section>
    }
}

#[component]
fn FromAbove() -> impl IntoView {
    let deck = deck();
    view! { <button type="button" class="small" title="Seen from above, north up" on:click=move |_| deck.camera.set(FROM_ABOVE)>"top"</button> }
}

/// The vehicle in space in the middle of the page.
#[component]
pub fn SpaceCard() -> impl IntoView {
    let deck = deck();
    view! {
        <section class="card chart scene" aria-label="3D view">
            <header>
                <h2>"3D view"</h2>
                <span class="push buttons-row">
                    <FromAbove />
                    <button type="button" class="small" title="Back to the charts (Esc)" on:click=move |_| deck.wide.set(false)>"Charts"</button>
                </span>
            </header>
            <Space />
        </section>
    }
}

#[component]
fn Horizon() -> impl IntoView {
    let deck = deck();
    let node = NodeRef::<html::Div>::new();
    deck.slot(Picture::Horizon, node);
    let label = move || {
        let i = deck.instrument();
        match i.roll_pitch_yaw_deg {
            Some([roll, pitch, yaw]) => format!("Roll {roll:.0}°, pitch {pitch:.0}°, yaw {yaw:.0}°"),
            None => "No attitude yet".to_owned(),
        }
    };
    view! {
        <div class="horizon plot" role="img" aria-label=label node_ref=node>
            <Ladder />
        </div>
    }
}

/// The numbers beside the pitch ladder, where the canvas draws its rungs: they move together.
#[component]
fn Ladder() -> impl IntoView {
    let deck = deck();
    let attitude = Memo::new(move |_| {
        let instrument = deck.instrument();
        let [roll, pitch, _] = instrument.roll_pitch_yaw_deg.filter(|_| !instrument.stale)?;
        // To what can be seen.
        Some([roll, pitch].map(|degrees| (degrees * 20.0).round() / 20.0))
    });
    let numbers = Memo::new(move |_| {
        attitude.get().map_or_else(Vec::new, |[_, pitch]| ladder_numbers(pitch.to_radians() as f32))
    });
    let percent = |share: f32| f64::from(share) * 100.0;
    let turned = move || {
        let [roll, pitch] = attitude.get().unwrap_or_default();
        let (turn_deg, fall) = ladder_lies(roll, pitch);
        format!("transform:rotate({turn_deg:.2}deg) translateY({:.2}cqmin)", fall * 100.0)
    };
    view! {
        <div class="ladder" aria-hidden="true">
            <div style=turned>
                {move || numbers.get().into_iter().flat_map(|degrees| [-1.0, 1.0].map(|side| {
                    let rise = f64::from(degrees).to_radians() * percent(LADDER_PER_RAD);
                    let (half, beside) = (side * percent(LADDER_HALF), side * BESIDE_PX);
                    view! {
                        <span style=format!("transform:translate(calc({half:.2}cqmin + {beside}px - 50%),{:.2}cqmin)", -rise)>
                            {degrees.abs()}
                        </span>
                    }
                })).collect::<Vec<_>>()}
            </div>
        </div>
    }
}

#[component]
fn Space() -> impl IntoView {
    let deck = deck();
    let node = NodeRef::<html::Div>::new();
    deck.slot(Picture::Space, node);
    let held = RwSignal::new(None::<(i32, i32)>);
    let down = move |e: ev::PointerEvent| {
        held.set(Some((e.client_x(), e.client_y())));
        if let Some(node) = node.get_untracked() {
            let _ = node.set_pointer_capture(e.pointer_id());
        }
    };
    let moved = move |e: ev::PointerEvent| {
        let Some((x, y)) = held.get_untracked() else { return };
        let (dx, dy) = ((e.client_x() - x) as f32, (e.client_y() - y) as f32);
        held.set(Some((e.client_x(), e.client_y())));
        deck.camera.update(|(azimuth, elevation, _)| {
            *azimuth -= dx * 0.01;
            *elevation = (*elevation + dy * 0.01).clamp(-0.2, 1.5);
        });
    };
    let wheel = move |e: ev::WheelEvent| {
        e.prevent_default();
        let factor = if e.delta_y() > 0.0 { 1.15 } else { 1.0 / 1.15 };
        deck.camera.update(|(_, _, out)| *out = (*out * factor).clamp(0.4, 6.0));
    };
    view! {
        <div
            class="horizon plot space"
            role="img"
            aria-label="The vehicle in space; drag to turn, wheel to move away"
            node_ref=node
            on:pointerdown=down
            on:pointermove=moved
            on:pointerup=move |_| held.set(None)
            on:pointercancel=move |_| held.set(None)
            on:wheel=wheel
            on:dblclick=move |_| deck.camera.set((-2.55, 0.38, 1.0))
        ></div>
    }
}

/// Altitude tape, on the right of the horizon.
#[component]
fn Tape() -> impl IntoView {
    let deck = deck();
    let altitude = Memo::new(move |_| deck.instrument().altitude_m.map(|a| (a * 200.0).round() / 200.0));
    let setpoint = Memo::new(move |_| deck.instrument().setpoint_m);
    let stale = Memo::new(move |_| deck.instrument().stale);
    // Labels are made anew only when the tape has moved by half a metre.
    let centre = Memo::new(move |_| altitude.get().map_or(0.0, |a| (a * 2.0).round() / 2.0));
    let labels = move || {
        let centre = centre.get();
        (-TAPE_MARKS..=TAPE_MARKS)
            .map(|i| {
                let value = centre + i as f64 * 0.1;
                let y = -value * TAPE_PX_PER_M;
                let tenth = (value * 10.0).round() as i64;
                let major = tenth % 5 == 0;
                view! {
                    <line x1="0" x2=if major { "9" } else { "5" } y1=y.to_string() y2=y.to_string() />
                    {major.then(|| view! { <text x="13" y=(y + 3.5).to_string()>{format::fixed(value, 1)}</text> })}
                }
            })
            .collect::<Vec<_>>()
    };
    view! {
        <div class="tape" class:stale=stale aria-hidden="true">
            <svg viewBox="0 -400 48 800">
                <g style=move || format!("transform:translateY({:.1}px)", altitude.get().unwrap_or(0.0) * TAPE_PX_PER_M)>
                    {labels}
                    {move || setpoint.get().map(|s| {
                        let y = -s * TAPE_PX_PER_M;
                        view! { <path class="bug" d=format!("M0 {y} l8 -5 v10 z") /> }
                    })}
                </g>
            </svg>
            <output class="tape-box num">{move || format::maybe(altitude.get(), 2)}</output>
        </div>
    }
}

/// Heading, 0..360 clockwise from north, of a yaw anticlockwise from east (ENU).
fn heading_deg(yaw_deg: f64) -> f64 {
    (90.0 - yaw_deg).rem_euclid(360.0)
}

fn compass_label(degrees: i64) -> String {
    match degrees.rem_euclid(360) {
        0 => "N".to_owned(),
        90 => "E".to_owned(),
        180 => "S".to_owned(),
        270 => "W".to_owned(),
        other => other.to_string(),
    }
}

/// Compass strip below the horizon.
#[component]
fn Compass() -> impl IntoView {
    let deck = deck();
    let heading = Memo::new(move |_| {
        deck.instrument().roll_pitch_yaw_deg.map(|[_, _, yaw]| (heading_deg(yaw) * 2.0).round() / 2.0)
    });
    let centre = Memo::new(move |_| heading.get().map_or(0, |h| (h / 15.0).round() as i64 * 15));
    let labels = move || {
        let centre = centre.get();
        (-12..=12).map(|i| {
            let degrees = centre + i * 15;
            let x = degrees as f64 * COMPASS_PX_PER_DEG;
            let major = degrees.rem_euclid(30) == 0;
            view! {
                <line x1=x.to_string() x2=x.to_string() y1="0" y2=if major { "6" } else { "3" } />
                {major.then(|| view! {
                    <text x=x.to_string() y="17" class:cardinal=degrees.rem_euclid(90) == 0>{compass_label(degrees)}</text>
                })}
            }
        }).collect::<Vec<_>>()
    };
    view! {
        <div class="compass" aria-hidden="true">
            <svg viewBox="-220 0 440 22">
                <g style=move || format!("transform:translateX({:.1}px)", -heading.get().unwrap_or(0.0) * COMPASS_PX_PER_DEG)>{labels}</g>
                <path class="lubber" d="M-5 0 h10 l-5 7 z" />
            </svg>
            <output class="compass-box num">
                {move || heading.get().map_or_else(|| format::NONE.to_owned(), |h| format!("{:03.0}°", h.rem_euclid(360.0)))}
            </output>
        </div>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nose_to_the_east_heads_090() {
        assert_eq!(heading_deg(0.0), 90.0);
        assert_eq!(heading_deg(90.0), 0.0);
        assert_eq!(heading_deg(180.0), 270.0);
        assert_eq!(compass_label(-90), "W");
        assert_eq!(compass_label(360), "N");
    }
}
