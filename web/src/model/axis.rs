//! Axes: from values to fractions of the plot, and the ticks worth labelling.
//!
//! Labels are page elements: the page asks an axis for [`Tick`]s and places each label at
//! `fraction × width` (time) or `(1 − fraction) × height` (value); the charts draw their grid lines
//! from the same ticks, so text and line always agree.

/// One place on an axis that deserves a grid line and a label.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// The value there, in the axis's unit.
    pub value: f64,
    /// Where it lies: 0 at the axis's start, 1 at its end.
    pub fraction: f64,
    /// What to write there (minus as U+2212, always the same number of decimals).
    pub label: String,
}

/// Round-numbered positions `first + i·step`, `i < count`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickStep {
    /// First tick at or after the axis's start.
    pub first: f64,
    /// Distance between ticks: 1, 2 or 5 times a power of ten.
    pub step: f64,
    /// How many fit on the axis.
    pub count: usize,
    /// Decimals that tell neighbours apart.
    pub decimals: usize,
}

/// Fewest ticks that an axis carries: two say where, three say how it goes.
const LEAST_TICKS: usize = 3;

/// At most `most` round-numbered ticks in `start..=end`. `None` when the axis has no length, or a
/// border is not finite, or no tick is asked for.
pub fn ticks(start: f64, end: f64, most: usize) -> Option<TickStep> {
    if !(start.is_finite() && end.is_finite() && end > start) || most == 0 {
        return None;
    }
    let rough = (end - start) / most as f64;
    let power = rough.log10().floor();
    for (mantissa, extra) in [(1.0, 0), (2.0, 0), (5.0, 0), (10.0, 1), (20.0, 1), (50.0, 1)] {
        let step = mantissa * 10_f64.powf(power);
        if !(step.is_normal()) {
            return None;
        }
        let (low, high) = ((start / step - 1e-9).ceil(), (end / step + 1e-9).floor());
        let count = high - low + 1.0;
        if count <= most as f64 {
            let decimals = (-(power as i32 + extra)).max(0) as usize;
            return Some(TickStep { first: low * step, step, count: count.max(0.0) as usize, decimals });
        }
    }
    None
}

/// `value` with this many decimals, U+2212 for minus, and never "−0".
pub fn format_value(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|b| matches!(b, b'0' | b'.')) => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

/// The vertical axis of a chart: `min` at the bottom, `max` at the top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValueAxis {
    /// Value at the bottom edge.
    pub min: f64,
    /// Value at the top edge.
    pub max: f64,
}

impl ValueAxis {
    /// An axis from `min` to `max`.
    pub const fn new(min: f64, max: f64) -> Self {
        Self { min, max }
    }

    /// The axis that shows `min..=max` with a little air, at least `least_span` long, its borders
    /// on round numbers. `previous` is kept while the data fill it reasonably, so that the axis does
    /// not breathe with every sample: it grows at once and shrinks only when under half is used.
    pub fn fit(min: f64, max: f64, least_span: f64, previous: Option<Self>) -> Self {
        if !(min.is_finite() && max.is_finite()) || min > max {
            return previous.unwrap_or(Self::new(-least_span / 2.0, least_span / 2.0));
        }
        if let Some(kept) = previous {
            let used = (max - min).max(least_span * 0.8);
            if kept.min <= min && max <= kept.max && used > 0.5 * kept.span() {
                return kept;
            }
        }
        let span = (max - min).max(least_span * 0.8);
        let middle = (min + max) / 2.0;
        let (low, high) = (middle - span * 0.6, middle + span * 0.6);
        match ticks(low, high, 10) {
            Some(TickStep { step, .. }) => Self::new((low / step).floor() * step, (high / step).ceil() * step),
            None => Self::new(low, high),
        }
    }

    /// Length of the axis, in its unit.
    pub fn span(self) -> f64 {
        self.max - self.min
    }

    /// 0 at the bottom, 1 at the top.
    pub fn fraction(self, value: f64) -> f64 {
        (value - self.min) / self.span()
    }

    /// The value at a fraction of the height, from the bottom.
    pub fn value(self, fraction: f64) -> f64 {
        self.min + fraction * self.span()
    }

    /// Ticks at least `spacing_px` apart on an axis `height_px` tall (CSS pixels), closer where there would be fewer than
    /// three.
    pub fn ticks(self, height_px: f64, spacing_px: f64) -> Vec<Tick> {
        let most = (height_px / spacing_px.max(1.0)).floor().max(1.0) as usize;
        let enough = |step: &TickStep| step.count >= LEAST_TICKS;
        let mut tried = (most..most + 2 * LEAST_TICKS).filter_map(|most| ticks(self.min, self.max, most));
        let Some(step) = tried.find(enough) else { return Vec::new() };
        (0..step.count)
            .map(|i| {
                let value = step.first + i as f64 * step.step;
                Tick { value, fraction: self.fraction(value), label: format_value(value, step.decimals) }
            })
            .collect()
    }
}

/// The time axis shared by all charts: a stretch of flight time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeAxis {
    /// Time at the left edge, s.
    pub start_s: f64,
    /// Time at the right edge, s.
    pub end_s: f64,
}

/// Steps a reader of clocks expects, s.
const TIME_STEPS_S: [f64; 20] = [
    0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0,
    1800.0,
];

/// Places of a pointer that the label of a time tells apart: one every few pixels.
const TOLD_APART: f64 = 200.0;

impl TimeAxis {
    /// An axis over `start_s..end_s`.
    pub const fn new(start_s: f64, end_s: f64) -> Self {
        Self { start_s, end_s }
    }

    /// The newest `length_s` up to now.
    pub fn ending_at(now_s: f64, length_s: f64) -> Self {
        Self::new(now_s - length_s, now_s)
    }

    /// Length, s.
    pub fn span_s(self) -> f64 {
        self.end_s - self.start_s
    }

    /// 0 at the left edge, 1 at the right edge.
    pub fn fraction(self, time_s: f64) -> f64 {
        (time_s - self.start_s) / self.span_s()
    }

    /// The time at a fraction of the width: what a pointer there means.
    pub fn time_s(self, fraction: f64) -> f64 {
        self.start_s + fraction * self.span_s()
    }

    /// A time from `origin_s` on as a label has it, with the decimals that a pointer on this axis tells apart.
    pub fn label(self, time_s: f64, origin_s: f64) -> String {
        let step = TIME_STEPS_S.into_iter().rev().find(|step| *step <= self.span_s() / TOLD_APART);
        format_time(time_s - origin_s, step.unwrap_or(TIME_STEPS_S[0]))
    }

    /// Ticks at least `spacing_px` apart on an axis `width_px` wide (CSS pixels), labelled in
    /// `m:ss` (or seconds with decimals, when zoomed in) from `origin_s`, for example take-off.
    pub fn ticks(self, width_px: f64, spacing_px: f64, origin_s: f64) -> Vec<Tick> {
        let most = (width_px / spacing_px.max(1.0)).floor().max(1.0);
        let (start, end) = (self.start_s - origin_s, self.end_s - origin_s);
        if !(start.is_finite() && end.is_finite() && end > start) {
            return Vec::new();
        }
        let least = (end - start) / most;
        let longest = 3600.0 * (least / 3600.0).ceil();
        let within = |step: f64| ((start / step - 1e-9).ceil() as i64, (end / step + 1e-9).floor() as i64);
        let enough = |step: f64| within(step).1 - within(step).0 + 1 >= LEAST_TICKS as i64;
        let wide = TIME_STEPS_S.into_iter().find(|step| *step >= least).unwrap_or(longest);
        // Closer, where there would be fewer than three.
        let closer = || TIME_STEPS_S.into_iter().rev().find(|step| *step < wide && enough(*step));
        let step = if enough(wide) { wide } else { closer().unwrap_or(wide) };
        let (low, high) = within(step);
        (low..=high)
            .map(|i| {
                let time_s = i as f64 * step;
                let value = time_s + origin_s;
                Tick { value, fraction: self.fraction(value), label: format_time(time_s, step) }
            })
            .collect()
    }
}

/// `m:ss`, with the decimals that `step_s` needs.
fn format_time(time_s: f64, step_s: f64) -> String {
    let decimals = if step_s >= 1.0 { 0 } else { (-step_s.log10() - 1e-9).ceil().max(1.0) as usize };
    let scale = 10_f64.powi(decimals as i32);
    let units = (time_s.abs() * scale).round();
    let sign = if time_s < 0.0 && units > 0.0 { "\u{2212}" } else { "" };
    let minutes = (units / (60.0 * scale)).floor();
    let seconds = (units - minutes * 60.0 * scale) / scale;
    let width = if decimals > 0 { decimals + 3 } else { 2 };
    format!("{sign}{minutes:.0}:{seconds:0width$.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    #[test]
    fn value_ticks_are_round_and_never_too_many() {
        let axis = ValueAxis::new(-0.13, 1.04);
        assert_eq!(labels(&axis.ticks(200.0, 40.0)), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(&axis.ticks(40.0, 40.0)), ["0.0", "0.5", "1.0"], "three, however low the chart is");
        assert_eq!(labels(&axis.ticks(300.0, 40.0)), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(
            labels(&ValueAxis::new(-45.0, 45.0).ticks(200.0, 40.0)),
            ["\u{2212}40", "\u{2212}20", "0", "20", "40"]
        );
        for exponent in -6..7 {
            for i in 1..60 {
                let span = 10_f64.powi(exponent) * f64::from(i) * 0.37;
                let start = -0.311 * span + 10_f64.powi(exponent);
                for most in 1..12 {
                    let step = ticks(start, start + span, most).unwrap();
                    assert!(step.count <= most, "{step:?}");
                    let last = step.first + step.step * (step.count as f64 - 1.0);
                    assert!(
                        step.count == 0 || (step.first >= start - 1e-6 * span && last <= start + span * (1.0 + 1e-6))
                    );
                    assert!(most < 4 || step.count * 3 >= most, "too few: {step:?} of {most}");
                }
            }
        }
    }

    #[test]
    fn an_axis_without_length_has_no_ticks() {
        assert_eq!(ticks(1.0, 1.0, 5), None);
        assert_eq!(ticks(f64::NAN, 1.0, 5), None);
        assert_eq!(ticks(0.0, f64::INFINITY, 5), None);
        assert!(ValueAxis::new(2.0, 2.0).ticks(100.0, 20.0).is_empty());
        assert!(TimeAxis::new(2.0, 2.0).ticks(100.0, 20.0, 0.0).is_empty());
    }

    #[test]
    fn time_ticks_read_like_a_clock() {
        let axis = TimeAxis::new(50.0, 110.0);
        assert_eq!(labels(&axis.ticks(600.0, 100.0, 0.0)), ["0:50", "1:00", "1:10", "1:20", "1:30", "1:40", "1:50"]);
        let narrow = TimeAxis::new(50.0, 110.0).ticks(150.0, 90.0, 0.0);
        assert_eq!(labels(&narrow), ["1:00", "1:15", "1:30", "1:45"], "three or more, however narrow the chart is");
        let axis = TimeAxis::new(59.7, 60.3);
        assert_eq!(labels(&axis.ticks(600.0, 150.0, 0.0)), ["0:59.8", "1:00.0", "1:00.2"]);
        let axis = TimeAxis::new(98.0, 103.0);
        assert_eq!(labels(&axis.ticks(600.0, 200.0, 100.0)), ["\u{2212}0:02", "0:00", "0:02"]);
        assert!((axis.ticks(600.0, 200.0, 100.0)[1].fraction - 0.4).abs() < 1e-12);
    }

    #[test]
    fn a_time_under_the_pointer_has_the_decimals_that_the_axis_shows() {
        let label = |span_s: f64| TimeAxis::new(50.0, 50.0 + span_s).label(72.3456, 10.0);
        let labels = [600.0, 30.0, 4.0, 0.5, 0.02].map(label);
        assert_eq!(labels, ["1:02", "1:02.3", "1:02.35", "1:02.346", "1:02.346"]);
    }

    #[test]
    fn every_axis_carries_three_ticks() {
        for i in 1..200 {
            let span = 0.013 * f64::from(i) * f64::from(i);
            let start = 17.3 - 0.4 * f64::from(i);
            for px in [10.0, 40.0, 75.0, 300.0] {
                assert!(ValueAxis::new(start, start + span).ticks(px, 36.0).len() >= 3, "{start} {span} {px}");
                assert!(TimeAxis::new(start, start + span).ticks(px, 90.0, 2.2).len() >= 3, "{start} {span} {px}");
            }
        }
    }

    #[test]
    fn a_fitted_axis_holds_the_data_and_does_not_breathe() {
        let axis = ValueAxis::fit(0.02, 0.83, 0.5, None);
        assert!(axis.min <= 0.02 && axis.max >= 0.83 && axis.span() < 1.3, "{axis:?}");
        assert_eq!(ValueAxis::fit(0.05, 0.84, 0.5, Some(axis)), axis);
        let grown = ValueAxis::fit(0.0, 5.0, 0.5, Some(axis));
        assert!(grown.max >= 5.0);
        let shrunk = ValueAxis::fit(0.0, 0.8, 0.5, Some(grown));
        assert!(shrunk.span() < 1.5, "{shrunk:?}");
        let flat = ValueAxis::fit(3.0, 3.0, 0.5, None);
        assert!(flat.span() >= 0.4 && flat.min < 3.0 && flat.max > 3.0, "{flat:?}");
        let nothing = ValueAxis::fit(f64::INFINITY, f64::NEG_INFINITY, 1.0, None);
        assert_eq!(nothing, ValueAxis::new(-0.5, 0.5));
    }

    #[test]
    fn minus_zero_is_zero() {
        assert_eq!(format_value(-0.0001, 2), "0.00");
        assert_eq!(format_value(-1.25, 1), "\u{2212}1.2");
    }
}
