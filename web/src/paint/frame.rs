//! What each chart shows in one frame: data and colours, no device.

use plumbline_proto::v1::{AttackPhase, Severity};

use super::space::Body;
use crate::{
    deck::{Deck, Labels, PIN_NAMES, Picture, Slot},
    gpu::{
        ChartView, Content, Dash, HeatRow, HeatmapView, HorizonView, LevelLine, Mark, Rect, Span, Style,
        TIME_TICK_SPACING_PX, Theme, VALUE_TICK_SPACING_PX,
    },
    model::{
        axis::{Tick, TimeAxis, ValueAxis},
        curves::{Axis, Curve, DEGREES},
        instrument::Instrument,
        live::Live,
        series::Series,
    },
    palette::{self, Stroke},
};
use leptos::prelude::*;

/// Shortest altitude range shown, m.
const ALTITUDE_SPAN_M: f64 = 0.02;
/// Share of the altitude range left free on top for the figures of steps.
const STEP_ROOM: f64 = 0.35;
/// Shortest attitude range shown, °.
const ATTITUDE_SPAN_DEG: f64 = 6.0;

/// Shortest range of errors and differences shown, mm or mrad.
const ERROR_SPAN: f64 = 10.0;
/// And of velocities.
const VELOCITY_SPAN_MPS: f64 = 0.1;
/// Shortest range of a signal shown, in its unit.
const SIGNAL_SPAN: f64 = 1e-6;
/// What an error of one estimator in the loop leaves to the others and to the band: so many times its own range.
const ERROR_REACH: f64 = 4.0;
/// Opacity of the band of ±3σ.
const BAND_OPACITY: f32 = 0.16;

/// Opacity of the other curves while a legend points at one.
const BACK_OPACITY: f32 = 0.2;

/// Is a step's response written on this stretch?
fn step_in_view(live: &Live, axis: TimeAxis) -> bool {
    let seconds = |us: u64| us as f64 * 1e-6;
    live.log.steps.iter().any(|s| seconds(s.start_time_us) <= axis.end_s && seconds(s.time_us) >= axis.start_s)
}

/// What all charts of one frame share.
pub(super) struct Frame {
    pub deck: Deck,
    pub dark: bool,
    pub theme: Theme,
}

impl Frame {
    pub(super) fn content<'a>(
        &self,
        slot: &Slot,
        rect: Rect,
        live: &'a Live,
        axis: TimeAxis,
        instrument: &Instrument,
        body: &'a Body,
    ) -> Option<Content<'a>> {
        match slot.picture {
            Picture::Horizon => Some(Content::Horizon(self.horizon(instrument))),
            Picture::Space => Some(Content::Attitude3d(self.space(live, instrument, body))),
            Picture::Heatmap | Picture::Suspicion => {
                let origin = self.deck.label_origin_s(live, axis);
                self.label(slot, rect, axis, None, origin);
                Some(Content::Heatmap(self.heatmap(slot.picture, live, axis)))
            }
            Picture::Altitude => Some(self.chart(slot, rect, live, axis, self.altitude(live), ALTITUDE_SPAN_M, None)),
            Picture::Compare => {
                let span = if self.deck.another.get_untracked() { SIGNAL_SPAN } else { ALTITUDE_SPAN_M };
                Some(self.chart(slot, rect, live, axis, self.compared(live), span, None))
            }
            Picture::Attitude => Some(self.chart(slot, rect, live, axis, self.attitude(live), ATTITUDE_SPAN_DEG, None)),
            Picture::Residual => Some(self.chart(slot, rect, live, axis, self.residual(live), 1e-3, None)),
            Picture::Motors => {
                Some(self.chart(slot, rect, live, axis, self.motors(live), 1.0, Some(ValueAxis::new(-0.02, 1.02))))
            }
            Picture::Ticks => Some(self.chart(slot, rect, live, axis, self.ticks(live), 20.0, None)),
            Picture::AltitudeError => {
                Some(self.chart(slot, rect, live, axis, self.errors(live, None), ERROR_SPAN, None))
            }
            Picture::AttitudeError => {
                let of = Some(self.deck.error_axis.get_untracked());
                Some(self.chart(slot, rect, live, axis, self.errors(live, of), ERROR_SPAN, None))
            }
            Picture::Velocity => Some(self.chart(slot, rect, live, axis, self.velocity(live), VELOCITY_SPAN_MPS, None)),
            Picture::Signal(place) => {
                let drawn = self.drawn(live, Curve::Signal(place), Style::Solid);
                // Before it is read its axis says nothing.
                let fixed = drawn.is_none().then_some(ValueAxis::new(0.0, 1.0));
                Some(self.chart(slot, rect, live, axis, drawn.into_iter().collect(), SIGNAL_SPAN, fixed))
            }
            Picture::Difference => {
                let span = if self.deck.another.get_untracked() { SIGNAL_SPAN } else { ERROR_SPAN };
                Some(self.chart(slot, rect, live, axis, self.differences(live), span, None))
            }
        }
    }

    fn horizon(&self, instrument: &Instrument) -> HorizonView {
        let [roll, pitch, _] = instrument.roll_pitch_yaw_deg.unwrap_or_default();
        HorizonView {
            roll_rad: (roll / DEGREES) as f32,
            pitch_flu_rad: (pitch / DEGREES) as f32,
            stale: instrument.stale,
            theme: self.theme,
        }
    }

    fn heatmap<'a>(&self, picture: Picture, live: &'a Live, axis: TimeAxis) -> HeatmapView<'a> {
        let estimator = self.deck.residual_estimator(live);
        let suspicion = picture == Picture::Suspicion;
        let sensors = if suspicion { live.suspicion_rows() } else { live.residual_rows(estimator) };
        let mut kind_before = None;
        let rows = sensors
            .into_iter()
            .filter_map(|(sensor, instance)| {
                let worst = Curve::Worst(estimator, sensor, instance);
                let ratio = live.curves.get(if suspicion { Curve::Suspicion(sensor, instance) } else { worst })?;
                let group_start = kind_before.replace(sensor).is_some_and(|before| before != sensor);
                Some(HeatRow { ratio, group_start })
            })
            .collect();
        HeatmapView {
            time: axis,
            rows,
            spans: self.spans(live, axis),
            cursor_s: self.cursor(),
            time_origin_s: self.deck.label_origin_s(live, axis),
            theme: self.theme,
        }
    }

    /// The cursor, or where a replay stands.
    fn cursor(&self) -> Option<f64> {
        let playhead = (self.deck.source == crate::deck::Source::Recorded).then(|| self.deck.playhead.get_untracked());
        self.deck.cursor.get_untracked().or(playhead)
    }

    fn spans(&self, live: &Live, axis: TimeAxis) -> Vec<Span> {
        live.log
            .attacks
            .between(axis.start_s, axis.end_s)
            .map(|s| Span {
                start_s: s.start_s,
                end_s: s.end_s,
                color: palette::ATTACK.on(self.dark),
                planned: s.phase == AttackPhase::Accepted,
            })
            .collect()
    }

    fn altitude<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let in_loop = live.in_loop();
        let mut out = Vec::new();
        // Raw sensors lie below, the estimate in the loop on top.
        let heights = live.curves.names_between(Curve::Height(0), Curve::Height(u16::MAX));
        let thin = heights.chain([false, true].map(Curve::Reach));
        out.extend(thin.filter_map(|curve| self.drawn(live, curve, Style::Thin)));
        out.extend(self.drawn(live, Curve::TruthAltitude, Style::Solid));
        for curve in live.curves.names_between(Curve::Altitude(0), Curve::Altitude(u16::MAX)) {
            if let Curve::Altitude(number) = curve
                && number != in_loop
            {
                // One that diverges does not squeeze the rest.
                let other = self.drawn(live, curve, Style::Solid);
                out.extend(other.map(|drawn| Drawn { room: Room::None, ..drawn }));
            }
        }
        for curve in live.curves.names_between(Curve::AgainAltitude(0), Curve::AgainAltitude(u16::MAX)) {
            let again = self.drawn(live, curve, Style::Solid);
            out.extend(again.map(|drawn| Drawn { room: Room::None, ..drawn }));
        }
        out.extend(self.drawn(live, Curve::SetpointAltitude, Style::Step));
        out.extend(self.drawn(live, Curve::Altitude(in_loop), Style::Strong));
        out
    }

    fn attitude<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let in_loop = live.in_loop();
        let truth = Axis::ALL.map(Curve::TruthAttitude);
        let own = Axis::ALL.map(|axis| Curve::Attitude(in_loop, axis));
        let [first, last] = [(0, Axis::Roll), (u16::MAX, Axis::Yaw)].map(|(n, axis)| Curve::AgainAttitude(n, axis));
        let all = truth.into_iter().chain(own).chain(live.curves.names_between(first, last));
        all.filter_map(|curve| self.drawn(live, curve, Style::Solid)).collect()
    }

    fn residual<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let Some((sensor, instance)) = self.deck.residual.get_untracked() else { return Vec::new() };
        let estimator = self.deck.residual_estimator(live);
        let named = |channel| Curve::Innovation((estimator, sensor, instance, channel));
        let [first, last] = [i32::MIN, i32::MAX].map(named);
        let keys = live.curves.names_between(first, last).filter_map(|c| match c {
            Curve::Innovation(key) => Some(key),
            _ => None,
        });
        let mut out = Vec::new();
        for (i, key) in keys.enumerate() {
            let stroke = palette::series(i);
            let gate = self.drawn_as(live, Curve::Gate(key), stroke.dashed(), Style::Solid);
            out.extend(gate.map(|g| Drawn { scale: -1.0, ..g }));
            out.extend(gate);
            out.extend(self.drawn_as(live, Curve::Innovation(key), stroke, Style::Solid));
        }
        out
    }

    fn compared<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let all = (0..16).map(Curve::ComparedSetpoint).chain((0..16).map(Curve::Compared));
        all.filter_map(|curve| self.drawn(live, curve, Style::Solid)).collect()
    }

    fn differences<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        (0..16).filter_map(|i| self.drawn(live, Curve::Difference(i), Style::Solid)).collect()
    }

    /// Errors of altitude or of one axis, and about none three sigma of each estimator that says how sure it is. A band is
    /// shown with the curve it belongs to.
    fn errors<'a>(&self, live: &'a Live, axis: Option<Axis>) -> Vec<Drawn<'a>> {
        let in_loop = live.in_loop();
        let (own, others): (Vec<_>, Vec<_>) = live.curves.error_names(axis).partition(|(_, n)| *n == in_loop);
        // The estimator in the loop lies on top; others leave it its room.
        let all = || others.iter().chain(&own).copied();
        let bands = all().filter(|(curve, _)| self.deck.shows(live, *curve)).filter_map(|(_, n)| {
            let sigma = axis.map_or(Curve::AltitudeSigma(n), |axis| Curve::AttitudeSigma(n, axis));
            let band = self.drawn(live, sigma, Style::Band)?;
            let room = if n == in_loop { Room::Some } else { Room::None };
            // Sigmas are stored in m and rad, errors in mm and mrad.
            Some(Drawn { color: band.color.alpha(BAND_OPACITY), dash: Dash::None, scale: 3e3, room, ..band })
        });
        let curves = all().filter_map(|(curve, n)| {
            let style = if n == in_loop { Style::Strong } else { Style::Solid };
            let drawn = self.drawn(live, curve, style)?;
            Some(if n == in_loop { drawn } else { Drawn { room: Room::Some, ..drawn } })
        });
        bands.chain(curves).collect()
    }

    /// Velocities along one direction: truth below, the estimator in the loop on top.
    fn velocity<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let (in_loop, way) = (live.in_loop(), self.deck.way.get_untracked());
        let others = live.curves.velocities(way).filter(|(_, n)| *n != in_loop).map(|(curve, _)| (curve, Style::Solid));
        let own = (Curve::Velocity(in_loop, way), Style::Strong);
        let all = std::iter::once((Curve::TruthVelocity(way), Style::Solid)).chain(others).chain([own]);
        all.filter_map(|(curve, style)| self.drawn(live, curve, style)).collect()
    }

    fn motors<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        (0..8).filter_map(|i| self.drawn(live, Curve::Motor(i), Style::Solid)).collect()
    }

    fn ticks<'a>(&self, live: &'a Live) -> Vec<Drawn<'a>> {
        let all = [Curve::TickJitter, Curve::TickMedian, Curve::TickP99];
        all.into_iter().filter_map(|curve| self.drawn(live, curve, Style::Solid)).collect()
    }

    fn drawn<'a>(&self, live: &'a Live, curve: Curve, style: Style) -> Option<Drawn<'a>> {
        self.drawn_as(live, curve, palette::stroke(curve, live.in_loop()), style)
    }

    fn drawn_as<'a>(&self, live: &'a Live, curve: Curve, stroke: Stroke, style: Style) -> Option<Drawn<'a>> {
        if !self.deck.shows(live, curve) {
            return None;
        }
        Some(Drawn {
            curve,
            series: live.curves.get(curve)?,
            color: stroke.ink.on(self.dark),
            dash: stroke.dash,
            style,
            scale: 1.0,
            room: Room::All,
        })
    }

    #[allow(clippy::too_many_arguments)]
    fn chart<'a>(
        &self,
        slot: &Slot,
        rect: Rect,
        live: &'a Live,
        axis: TimeAxis,
        drawn: Vec<Drawn<'a>>,
        least_span: f64,
        fixed: Option<ValueAxis>,
    ) -> Content<'a> {
        let value = self.deck.value_zoom_of(slot.picture).or(fixed).unwrap_or_else(|| {
            let (low, mut high) = range(&drawn, axis, least_span);
            if slot.picture == Picture::Altitude && step_in_view(live, axis) {
                // Room for the figures of the steps, written along the top.
                high += STEP_ROOM * (high - low).max(0.0);
            }
            ValueAxis::fit(low, high, least_span, slot.axis.get())
        });
        slot.axis.set(Some(value));
        let origin = self.deck.label_origin_s(live, axis);
        self.label(slot, rect, axis, Some(value), origin);
        let mut view = ChartView::new(axis, value, self.theme);
        view.time_origin_s = origin;
        view.cursor_s = self.cursor();
        view.spans = self.spans(live, axis);
        view.marks = self.marks(live, axis);
        let ends = self.deck.pins.get_untracked().into_iter().chain(self.deck.kept.get_untracked()).flatten();
        view.marks.extend(ends.map(|time_s| Mark { time_s, color: self.theme.ink }));
        if matches!(
            slot.picture,
            Picture::Residual
                | Picture::AltitudeError
                | Picture::AttitudeError
                | Picture::Velocity
                | Picture::Difference
        ) {
            view.levels.push(LevelLine { value: 0.0, color: self.theme.axis, dashed: false });
        }
        if let Some(most) = self.deck.tolerance.get_untracked().filter(|_| slot.picture == Picture::Difference) {
            let color = palette::ATTACK.on(self.dark);
            view.levels.extend([-most, most].map(|value| LevelLine { value, color, dashed: true }));
        }
        if slot.picture == Picture::Altitude {
            self.step_lines(live, axis, &mut view);
        }
        // What the legend points at lies on top, and the others of its chart step back.
        let lit = self.deck.lit.get_untracked().filter(|lit| drawn.iter().any(|d| d.curve == *lit));
        let mut drawn = drawn;
        drawn.sort_by_key(|d| Some(d.curve) == lit);
        for d in drawn {
            let back = lit.is_some_and(|lit| lit != d.curve);
            view = view.curve(d.series, if back { d.color.alpha(BACK_OPACITY) } else { d.color }, d.style);
            view = view.dashed(d.dash);
            if let Some(last) = view.curves.last_mut() {
                last.scale = d.scale;
            }
        }
        Content::Chart(view)
    }

    /// The band the newest step in view must stay in, and the moment it did.
    fn step_lines(&self, live: &Live, axis: TimeAxis, view: &mut ChartView<'_>) {
        let newest = live.log.steps.iter().rev().find(|s| s.start_time_us as f64 * 1e-6 <= axis.end_s);
        let Some(step) = newest.filter(|s| s.time_us as f64 * 1e-6 >= axis.start_s && s.band_m > 0.0) else { return };
        let color = palette::OTHER_1.on(self.dark);
        for side in [-1.0, 1.0] {
            view.levels.push(LevelLine {
                value: step.to_m + side * step.band_m,
                color: color.alpha(0.55),
                dashed: true,
            });
        }
        if let Some(settled) = step.settling_time_s {
            view.marks.push(Mark { time_s: step.start_time_us as f64 * 1e-6 + settled, color });
        }
    }

    /// Warnings and worse, and changes of mode.
    fn marks(&self, live: &Live, axis: TimeAxis) -> Vec<Mark> {
        live.log
            .events
            .iter()
            .filter(|e| {
                let loud = matches!(e.severity(), Severity::Warning | Severity::Critical);
                loud || matches!(e.kind.as_str(), "mode" | "armed" | "failsafe")
            })
            .map(|e| Mark {
                time_s: e.time_us as f64 * 1e-6,
                color: if e.severity() == Severity::Critical { palette::ATTACK.on(self.dark) } else { self.theme.axis },
            })
            .filter(|m| m.time_s >= axis.start_s && m.time_s <= axis.end_s)
            .collect()
    }

    /// Writes the labels of a chart, if they changed.
    fn label(&self, slot: &Slot, rect: Rect, axis: TimeAxis, value: Option<ValueAxis>, origin_s: f64) {
        let time = axis.ticks(f64::from(rect.width), TIME_TICK_SPACING_PX, origin_s);
        let values = value.map(|v| v.ticks(f64::from(rect.height), VALUE_TICK_SPACING_PX)).unwrap_or_default();
        let pinned = |(time_s, label): (f64, &str)| {
            let fraction = axis.fraction(time_s);
            (0.0..=1.0).contains(&fraction).then(|| Tick { value: time_s, fraction, label: label.to_owned() })
        };
        let pins: Vec<Tick> = self
            .deck
            .pins
            .get_untracked()
            .into_iter()
            .flat_map(|p| p.into_iter().zip(PIN_NAMES).filter_map(pinned))
            .collect();
        let same = slot.labels.with_untracked(|old| {
            let near = |a: &[Tick], b: &[Tick]| {
                a.len() == b.len()
                    && a.iter().zip(b).all(|(x, y)| x.label == y.label && (x.fraction - y.fraction).abs() < 5e-4)
            };
            near(&old.time, &time) && near(&old.value, &values) && near(&old.pins, &pins)
        });
        if !same {
            slot.labels.set(Labels { time, value: values, pins });
        }
    }
}

/// One curve to draw.
#[derive(Clone, Copy)]
struct Drawn<'a> {
    curve: Curve,
    series: &'a Series,
    color: crate::gpu::Color,
    dash: Dash,
    style: Style,
    scale: f32,
    room: Room,
}

/// What the value axis does for a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Room {
    /// It holds all of it.
    All,
    /// It holds it as far as it is not many times the range of those it holds all of.
    Some,
    /// Nothing.
    None,
}

/// The values to be shown, least and largest.
fn range(drawn: &[Drawn<'_>], axis: TimeAxis, least_span: f64) -> (f64, f64) {
    let extent = |d: &Drawn<'_>| {
        let extent = d.series.extent_between(axis.start_s, axis.end_s);
        let (a, b) = (f64::from(extent.min * d.scale), f64::from(extent.max * d.scale));
        let low = if d.style == Style::Band { -b } else { a.min(b) };
        (!extent.is_empty()).then(|| (low, a.max(b)))
    };
    let of = |room: Room| drawn.iter().filter(move |d| d.room == room).filter_map(extent);
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = of(Room::All).fold(none, |(low, high), (a, b)| (low.min(a), high.max(b)));
    let own = if low > high { f64::INFINITY } else { low.abs().max(high.abs()).max(least_span / 2.0) };
    let reach = ERROR_REACH * own;
    of(Room::Some).fold((low, high), |(low, high), (a, b)| (low.min(a.max(-reach)), high.max(b.min(reach))))
}
