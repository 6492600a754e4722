//! The charts of one page: they share one time axis, one cursor, one zoom.
//!
//! A chart is a place on the page ([`Slot`]) and a subject ([`Picture`]); `paint.rs` measures the
//! place and draws the subject behind it. Labels are page elements fed by [`Labels`].

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use leptos::{html, leptos_dom::helpers::TimeoutHandle, prelude::*};
use plumbline_proto::v1::SensorKind;

use crate::{
    ctx::Ctx,
    model::{
        axis::{Tick, TimeAxis, ValueAxis},
        choice,
        curves::{Axis, Curve, Group, Way},
        instrument::Instrument,
        layout::{Evidence, Layout},
        live::Live,
        topic::Topic,
    },
    net,
    panel::legend::Entry,
    store,
};

/// Windows offered, s.
pub const WINDOWS_S: [f64; 6] = [10.0, 30.0, 60.0, 120.0, 300.0, 600.0];
/// The one where nothing is said, s.
const USUAL_WINDOW_S: f64 = 30.0;
/// Most signals on charts of their own at a time.
pub const MOST_SIGNALS: u8 = 6;

/// A view that has stood still this long is asked for.
const SETTLE: Duration = Duration::from_millis(250);

/// What the pinned cursors are called.
pub const PIN_NAMES: [&str; 2] = ["A", "B"];

/// What a chart shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Picture {
    /// Setpoint, estimates, heights, truth.
    Altitude,
    /// Roll, pitch, yaw.
    Attitude,
    /// Rows of innovation ratios.
    Heatmap,
    /// Innovation and gate of every channel of one sensor instance.
    Residual,
    /// How suspect the secure estimator finds each sensor.
    Suspicion,
    /// Motor commands.
    Motors,
    /// Time of a tick.
    Ticks,
    /// Altitudes of several flights.
    Compare,
    /// Their altitudes minus that of the first.
    Difference,
    /// What the estimators' altitudes are off by.
    AltitudeError,
    /// And their attitudes, one axis of it.
    AttitudeError,
    /// Velocities along one direction of the world.
    Velocity,
    /// A signal.
    Signal(u8),
    /// Artificial horizon.
    Horizon,
    /// The vehicle in space.
    Space,
}

/// Labels of a chart's axes, for the page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Along the bottom.
    pub time: Vec<Tick>,
    /// Up the side.
    pub value: Vec<Tick>,
    /// The pinned cursors, where they are in view.
    pub pins: Vec<Tick>,
}

/// A signal on a chart of its own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Charted {
    /// Number of its curve and picture.
    pub place: u8,
    /// As the ground calls it.
    pub name: String,
    /// Unit; empty for none.
    pub unit: String,
    /// Its spectrum instead of its course?
    pub spectrum: bool,
}

/// A chart with a legend, for what reads its curves: the pinned cursors, a table.
#[derive(Clone)]
pub struct Listed {
    /// Its name.
    pub name: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
    /// Decimals worth writing.
    pub decimals: usize,
    /// Its curves.
    pub entries: Signal<Vec<Entry>>,
    mark: RwSignal<()>,
}

/// A place on the page where something is drawn.
#[derive(Clone)]
pub struct Slot {
    /// What.
    pub picture: Picture,
    /// Where.
    pub node: NodeRef<html::Div>,
    /// Its labels.
    pub labels: RwSignal<Labels>,
    /// Value axis of the frame before, so that it does not breathe.
    pub axis: Rc<Cell<Option<ValueAxis>>>,
}

/// Where the charts get their data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// The vehicle flying now.
    Live,
    /// A recorded flight.
    Recorded,
}

/// See the module documentation. Over fifteen fields: each is a choice that a chart, a key or a card makes by itself, and
/// holds no more than a handle; in groups, every use of one would only be longer.
#[derive(Clone, Copy)]
pub struct Deck {
    /// Live or recorded.
    pub source: Source,
    /// The data.
    pub data: StoredValue<Live, LocalStorage>,
    /// Length of the window, s.
    pub window_s: RwSignal<f64>,
    /// A stretch zoomed into, s of flight time.
    pub zoom: RwSignal<Option<(f64, f64)>>,
    /// Right edge where the charts stand still, s; data goes on being kept.
    pub paused_at: RwSignal<Option<f64>>,
    /// Time under the pointer, s.
    pub cursor: RwSignal<Option<f64>>,
    /// Stretches of values zoomed into, for each chart that has one.
    pub value_zoom: RwSignal<Vec<(Picture, ValueAxis)>>,
    /// Sensor instance whose channels are charted, else all in rows.
    pub residual: RwSignal<Option<(i32, u32)>>,
    /// Estimator whose residuals are shown; 0: the one in the loop.
    pub residuals_of: RwSignal<u16>,
    /// What stands below altitude and attitude.
    pub evidence: RwSignal<Evidence>,
    /// Axis whose errors are shown.
    pub error_axis: RwSignal<Axis>,
    /// Direction whose velocity is shown.
    pub way: RwSignal<Way>,
    /// Is the velocity shown below the errors, in the place of the attitude?
    pub velocity: RwSignal<bool>,
    /// Signals on charts of their own.
    pub signals: RwSignal<Vec<Charted>>,
    /// A stretch of time, s of flight time, whose spectra are kept to lie under those of what is looked at.
    pub kept: RwSignal<Option<[f64; 2]>>,
    /// Motors and the time of a tick charted?
    pub motors: RwSignal<bool>,
    /// Notes that name a time of the flight: s of flight time, text.
    pub notes: RwSignal<Vec<(f64, String)>>,
    /// Two pinned cursors, s of flight time.
    pub pins: RwSignal<Option<[f64; 2]>>,
    /// Curves that their legend was asked to hide.
    pub hidden: RwSignal<Vec<Curve>>,
    /// Differences up to here pass, in the unit they are drawn in.
    pub tolerance: RwSignal<Option<f64>>,
    /// Is what is compared another quantity than the altitude?
    pub another: RwSignal<bool>,
    /// Curve that its legend points at: the others of its chart step back.
    pub lit: RwSignal<Option<Curve>>,
    /// Groups of curves that are unfolded, and drawn.
    pub unfolded: RwSignal<Vec<Group>>,
    /// Charts on the page that have a legend.
    pub listed: RwSignal<Vec<Listed>>,
    /// Recorded flights: where the replay stands, s.
    pub playhead: RwSignal<f64>,
    /// Recorded flights: begin of the flight, s of flight time.
    pub origin_s: RwSignal<f64>,
    /// The vehicle in space instead of the horizon?
    pub space: RwSignal<bool>,
    /// In the middle of the page instead?
    pub wide: RwSignal<bool>,
    /// View of the vehicle in space: azimuth, elevation, distance.
    pub camera: RwSignal<(f32, f32, f32)>,
    tick: RwSignal<u64>,
    slots: StoredValue<Vec<Slot>, LocalStorage>,
}

impl Deck {
    fn new(source: Source, data: StoredValue<Live, LocalStorage>, tick: RwSignal<u64>) -> Self {
        let window_s = store::get("window_s").and_then(|t| t.parse().ok()).filter(|w| WINDOWS_S.contains(w));
        Self {
            source,
            data,
            window_s: RwSignal::new(window_s.unwrap_or(USUAL_WINDOW_S)),
            zoom: RwSignal::new(None),
            paused_at: RwSignal::new(None),
            cursor: RwSignal::new(None),
            value_zoom: RwSignal::new(Vec::new()),
            residual: RwSignal::new(None),
            residuals_of: RwSignal::new(0),
            evidence: RwSignal::new(Evidence::default()),
            error_axis: RwSignal::new(Axis::Roll),
            way: RwSignal::new(Way::Up),
            velocity: RwSignal::new(false),
            signals: RwSignal::new(Vec::new()),
            kept: RwSignal::new(None),
            motors: RwSignal::new(false),
            notes: RwSignal::new(Vec::new()),
            pins: RwSignal::new(None),
            hidden: RwSignal::new(Vec::new()),
            tolerance: RwSignal::new(None),
            another: RwSignal::new(false),
            lit: RwSignal::new(None),
            unfolded: RwSignal::new(store::unfolded()),
            listed: RwSignal::new(Vec::new()),
            playhead: RwSignal::new(0.0),
            origin_s: RwSignal::new(0.0),
            space: RwSignal::new(false),
            wide: RwSignal::new(false),
            camera: RwSignal::new((-2.55, 0.38, 1.0)),
            tick,
            slots: StoredValue::new_local(Vec::new()),
        }
    }

    /// Charts of the live vehicle.
    pub fn live(ctx: Ctx) -> Self {
        Self::new(Source::Live, ctx.live, ctx.tick)
    }

    /// Charts of a recorded flight.
    pub fn recorded(ctx: Ctx, flight: Live) -> Self {
        let span = flight.curves.time_span_s().unwrap_or(0.0..0.0);
        let deck = Self::new(Source::Recorded, StoredValue::new_local(flight), ctx.tick);
        deck.origin_s.set(span.start);
        deck.playhead.set(span.start);
        deck.window_s.set((span.end - span.start).max(1.0));
        deck
    }

    /// Reads the data; runs again ten times a second.
    pub fn read<T>(self, read: impl FnOnce(&Live) -> T) -> T {
        self.tick.track();
        self.data.with_value(read)
    }

    /// Is the newest message of a topic too old to be shown as what is? Never of a recording; runs again with each beat.
    pub fn is_old<T>(self, topic: fn(&Live) -> &Topic<T>) -> bool {
        self.source == Source::Live && self.read(|live| live.is_old(topic(live), net::now_ms()))
    }

    /// Beats of the page so far; runs again with each.
    pub fn beat(self) -> u64 {
        self.tick.get()
    }

    /// Value of a curve where the charts are read, see [`Deck::reading_s`]; runs again with each beat.
    pub fn value(self, curve: Curve) -> Option<f64> {
        let at = self.reading_s();
        self.read(|live| match at {
            Some(time_s) => live.curves.value_at(curve, time_s),
            None => live.curves.newest(curve),
        })
    }

    /// Adds a chart for as long as the calling component lives.
    pub fn slot(self, picture: Picture, node: NodeRef<html::Div>) -> Slot {
        let labels = RwSignal::new(Labels::default());
        let slot = Slot { picture, node, labels, axis: Rc::new(Cell::new(None)) };
        self.slots.update_value(|slots| slots.push(slot.clone()));
        on_cleanup(move || {
            self.slots.try_update_value(|slots| slots.retain(|s| s.labels != labels));
        });
        slot
    }

    /// Names the curves of a chart for as long as the calling component lives.
    pub fn list(self, name: &'static str, unit: &'static str, decimals: usize, entries: Signal<Vec<Entry>>) {
        let mark = RwSignal::new(());
        self.listed.update(|all| all.push(Listed { name, unit, decimals, entries, mark }));
        on_cleanup(move || {
            self.listed.try_update(|all| all.retain(|l| l.mark != mark));
        });
    }

    /// Is this curve folded away? One of an attacked sensor is not, while its attack is in view.
    pub fn folds(self, live: &Live, curve: Curve) -> bool {
        let shut = |group| !self.unfolded.with(|unfolded| unfolded.contains(&group));
        curve.group(live.in_loop()).is_some_and(shut) && !self.attacked(live, curve)
    }

    fn attacked(self, live: &Live, curve: Curve) -> bool {
        let Curve::Height(instance) = curve else { return false };
        let axis = self.axis(live);
        live.log.attacks.between(axis.start_s, axis.end_s).any(|span| {
            let of = &span.attack;
            span.seen && of.sensor() == SensorKind::Height && of.instance == u32::from(instance)
        })
    }

    /// Is this curve to be drawn?
    pub fn shows(self, live: &Live, curve: Curve) -> bool {
        untrack(|| !self.hidden.with(|hidden| hidden.contains(&curve)) && !self.folds(live, curve))
    }

    /// Folds a group of curves, or unfolds it.
    pub fn toggle_group(self, group: Group) {
        self.unfolded.update(|unfolded| choice::toggle(unfolded, group));
        self.unfolded.with_untracked(|unfolded| store::keep_unfolded(unfolded));
    }

    /// What stands on the page now; runs again when that changes.
    pub fn layout(self) -> Layout {
        Layout {
            evidence: self.evidence.get(),
            axis: self.error_axis.get(),
            signals: self.signals.with(|all| all.iter().map(|c| (c.name.clone(), c.spectrum)).collect()),
            unfolded: self.unfolded.get(),
            motors: self.motors.get(),
            velocity: self.velocity.get(),
            space: self.space.get(),
            wide: self.wide.get(),
            window_s: (self.source == Source::Live).then(|| self.window_s.get()).filter(|s| *s != USUAL_WINDOW_S),
        }
    }

    /// Puts that on the page.
    pub fn show(self, layout: Layout) {
        let before = self.signals.get_untracked();
        self.data.update_value(|live| before.iter().for_each(|charted| live.curves.remove_signal(charted.place)));
        let charted = layout.signals.into_iter().zip(0..MOST_SIGNALS).map(|((name, spectrum), place)| {
            let unit = before.iter().find(|c| c.name == name).map(|c| c.unit.clone()).unwrap_or_default();
            Charted { place, name, unit, spectrum }
        });
        self.signals.set(charted.collect());
        self.evidence.set(layout.evidence);
        self.error_axis.set(layout.axis);
        self.unfolded.set(layout.unfolded);
        self.motors.set(layout.motors);
        self.velocity.set(layout.velocity);
        self.space.set(layout.space);
        self.wide.set(layout.wide);
        if self.source == Source::Live {
            let window_s = layout.window_s.filter(|s| WINDOWS_S.contains(s));
            self.window_s.set(window_s.unwrap_or(USUAL_WINDOW_S));
            self.zoom.set(None);
        }
    }

    /// Hides a curve, or shows it again.
    pub fn toggle_curve(self, curve: Curve) {
        self.hidden.update(|hidden| choice::toggle(hidden, curve));
    }

    /// Shows this curve alone of `all`; all of them again where it is alone.
    pub fn solo_curve(self, curve: Curve, all: &[Curve]) {
        self.hidden.update(|hidden| solo(hidden, curve, all));
    }

    /// Pins two cursors a quarter from both edges, or takes them away.
    pub fn toggle_pins(self) {
        let axis = self.data.with_value(|live| self.axis(live));
        self.pins.update(|pins| *pins = pins.is_none().then(|| [axis.time_s(0.25), axis.time_s(0.75)]));
    }

    /// Moves the nearer one of the pinned cursors here; false when there are none.
    pub fn pin(self, time_s: f64) -> bool {
        let moved = self
            .pins
            .get_untracked()
            .map(|[a, b]| if (time_s - a).abs() <= (time_s - b).abs() { [time_s, b] } else { [a, time_s] });
        if moved.is_some() {
            self.pins.set(moved);
        }
        moved.is_some()
    }

    /// The charts now on the page.
    pub fn slots(self) -> Vec<Slot> {
        self.slots.try_with_value(Clone::clone).unwrap_or_default()
    }

    /// The time axis, untracked.
    pub fn axis(self, live: &Live) -> TimeAxis {
        if let Some((start, end)) = self.zoom.get_untracked() {
            return TimeAxis::new(start, end);
        }
        let window = self.window_s.get_untracked();
        match self.source {
            Source::Live => {
                let edge = live.edge_us(net::now_ms()) * 1e-6;
                TimeAxis::ending_at(self.paused_at.get_untracked().unwrap_or(edge), window)
            }
            Source::Recorded => {
                let start = self.origin_s.get_untracked();
                TimeAxis::new(start, start + window)
            }
        }
    }

    /// What the charts show, s of flight time; runs again when that changes otherwise than by time that passes.
    pub fn in_view(self) -> [f64; 2] {
        self.origin_s.track();
        self.window_s.track();
        self.zoom.track();
        self.paused_at.track();
        let axis = self.data.with_value(|live| self.axis(live));
        [axis.start_s, axis.end_s]
    }

    /// Does every sample that a curve was recorded with lie on it in view?
    pub fn is_whole(self, live: &Live, curve: Curve) -> bool {
        let axis = self.axis(live);
        live.curves.is_whole(curve, axis.start_s, axis.end_s)
    }

    /// Time that labels count from, s: the moving edge while live, else the flight's begin.
    pub fn label_origin_s(self, live: &Live, axis: TimeAxis) -> f64 {
        if self.is_still() { self.begin_s(live) } else { axis.end_s }
    }

    /// Begin of the flight, s of flight time; that of the vehicle before there is a flight.
    pub fn begin_s(self, live: &Live) -> f64 {
        match self.source {
            Source::Recorded => self.origin_s.get_untracked(),
            Source::Live => {
                live.status.get().filter(|s| s.flight_start_us > 0).map_or(0.0, |s| s.flight_start_us as f64 * 1e-6)
            }
        }
    }

    /// Do the charts stand still?
    pub fn is_still(self) -> bool {
        self.source == Source::Recorded
            || self.paused_at.get_untracked().is_some()
            || self.zoom.get_untracked().is_some()
    }

    /// Time that values beside the charts are read at: under the pointer, else the playhead, else `None`: newest.
    pub fn reading_s(self) -> Option<f64> {
        self.cursor.get().or_else(|| match self.source {
            Source::Live => self.paused_at.get(),
            Source::Recorded => Some(self.playhead.get()),
        })
    }

    /// What the instruments show: newest while live, the playhead's values of a recorded flight.
    pub fn instrument(self) -> Instrument {
        self.tick.track();
        match self.source {
            Source::Live => self.data.with_value(|live| Instrument::newest(live, live.clock.now_us(net::now_ms()))),
            Source::Recorded => {
                let time = self.playhead.get();
                self.data.with_value(|live| Instrument::at(live, time))
            }
        }
    }

    /// As [`Deck::instrument`], untracked, for animation frames.
    pub fn instrument_now(self) -> Instrument {
        untrack(|| self.instrument())
    }

    /// The estimator whose residuals are shown.
    pub fn residual_estimator(self, live: &Live) -> u16 {
        match self.residuals_of.get_untracked() {
            0 => live.in_loop(),
            chosen => chosen,
        }
    }

    /// Stops or restarts the charts.
    pub fn toggle_pause(self) {
        let edge = self.data.with_value(|live| live.edge_us(net::now_ms()) * 1e-6);
        self.paused_at.update(|p| *p = if p.is_some() { None } else { Some(edge) });
        if self.paused_at.get_untracked().is_none() {
            self.zoom.set(None);
        }
    }

    /// The values that a chart was zoomed into.
    pub fn value_zoom_of(self, picture: Picture) -> Option<ValueAxis> {
        self.value_zoom.with_untracked(|all| all.iter().find(|(of, _)| *of == picture).map(|(_, axis)| *axis))
    }

    /// Shows some values of one chart.
    pub fn zoom_values(self, picture: Picture, axis: ValueAxis) {
        self.value_zoom.update(|all| {
            all.retain(|(of, _)| *of != picture);
            all.push((picture, axis));
        });
    }

    /// Is a stretch of time or of values zoomed into?
    pub fn is_zoomed(self) -> bool {
        self.zoom.with(Option::is_some) || self.value_zoom.with(|all| !all.is_empty())
    }

    /// Shows a stretch; nothing under 20 ms.
    pub fn zoom_to(self, from: f64, to: f64) {
        let (start, end) = (from.min(to), from.max(to));
        if end - start < 0.02 {
            return;
        }
        if self.source == Source::Live && self.paused_at.get_untracked().is_none() {
            self.toggle_pause();
        }
        self.zoom.set(Some((start, end)));
    }

    /// Zooms so that `share` of the present span remains, and what is at `time_s` stays where it is.
    pub fn zoom_about(self, time_s: f64, share: f64) {
        let axis = self.data.with_value(|live| self.axis(live));
        self.zoom_to(time_s - share * (time_s - axis.start_s), time_s + share * (axis.end_s - time_s));
    }

    /// Moves the stretch zoomed into along with the play head, up to the end of the flight.
    pub fn follow(self, end_s: f64) {
        let time_s = self.playhead.get_untracked();
        let zoom = self.zoom.get_untracked();
        let moved = zoom.map(|zoom| followed(zoom, time_s, end_s));
        if moved != zoom {
            self.zoom.set(moved);
        }
    }

    /// Back from a zoom, of values too, and back to the moving edge.
    pub fn zoom_out(self) {
        self.zoom.set(None);
        self.value_zoom.set(Vec::new());
        if self.source == Source::Live {
            self.paused_at.set(None);
        }
    }

    /// Another window.
    pub fn set_window(self, seconds: f64) {
        self.window_s.set(seconds);
        self.zoom.set(None);
        if self.source == Source::Live {
            store::set("window_s", &seconds.to_string());
        }
    }
}

/// Runs `act` with what `view` gives once that has stood still; at first at once.
pub fn settled<T: PartialEq + Copy + Send + Sync + 'static>(
    view: impl Fn() -> T + Send + Sync + 'static,
    act: impl Fn(T) + Clone + 'static,
) {
    let waiting = StoredValue::new(None::<TimeoutHandle>);
    Effect::new(move |before: Option<T>| {
        let now = view();
        if before == Some(now) {
            return now;
        }
        if let Some(handle) = waiting.get_value() {
            handle.clear();
        }
        let act = act.clone();
        if before.is_none() {
            act(now);
        } else {
            waiting.set_value(set_timeout_with_handle(move || act(now), SETTLE).ok());
        }
        now
    });
    on_cleanup(move || {
        if let Some(Some(handle)) = waiting.try_get_value() {
            handle.clear();
        }
    });
}

/// Where the play head stands in a view that moves with it, and where it begins in one that it was outside of.
const FOLLOWED_AT: f64 = 0.75;
const BEGINS_AT: f64 = 0.25;

/// The stretch `from_s` to `to_s`, moved so that the play head is in view and has a part of the view before it.
fn followed((from_s, to_s): (f64, f64), time_s: f64, end_s: f64) -> (f64, f64) {
    let span_s = to_s - from_s;
    let start_s = if (from_s..=to_s).contains(&time_s) {
        from_s.max((time_s - FOLLOWED_AT * span_s).min(from_s.max(end_s - span_s)))
    } else {
        (time_s - BEGINS_AT * span_s).min(time_s.max(end_s) - span_s)
    };
    (start_s, start_s + span_s)
}

fn solo(hidden: &mut Vec<Curve>, curve: Curve, all: &[Curve]) {
    let others: Vec<Curve> = all.iter().copied().filter(|other| *other != curve).collect();
    let alone = !hidden.contains(&curve) && others.iter().all(|other| hidden.contains(other));
    hidden.retain(|h| !all.contains(h));
    if !alone {
        hidden.extend(others);
    }
}

/// The charts of the page around a component.
pub fn deck() -> Deck {
    expect_context()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zoomed_view_goes_along_with_the_play_head_and_stops_at_the_end() {
        assert_eq!(followed((10.0, 14.0), 12.0, 60.0), (10.0, 14.0), "it stands still until three quarters");
        assert_eq!(followed((10.0, 14.0), 13.5, 60.0), (10.5, 14.5));
        assert_eq!(followed((10.0, 14.0), 40.0, 60.0), (39.0, 43.0), "a view without the play head jumps to it");
        assert_eq!(followed((10.0, 14.0), 2.0, 60.0), (1.0, 5.0));
        assert_eq!(followed((56.0, 60.0), 59.9, 60.0), (56.0, 60.0), "nothing is beyond the end");
        assert_eq!(followed((10.0, 14.0), 59.9, 60.0), (56.0, 60.0));
    }

    #[test]
    fn one_curve_is_shown_alone_and_then_all_are_again() {
        let all = [Curve::TickMedian, Curve::TickP99, Curve::TickJitter];
        let mut hidden = vec![Curve::TickMedian, Curve::TruthAltitude];
        solo(&mut hidden, Curve::TickMedian, &all);
        assert_eq!(hidden, [Curve::TruthAltitude, Curve::TickP99, Curve::TickJitter], "another chart's stays hidden");
        solo(&mut hidden, Curve::TickP99, &all);
        assert_eq!(hidden, [Curve::TruthAltitude, Curve::TickMedian, Curve::TickJitter]);
        solo(&mut hidden, Curve::TickP99, &all);
        assert_eq!(hidden, [Curve::TruthAltitude]);
    }
}
