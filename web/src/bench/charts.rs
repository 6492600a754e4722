//! The benchmark: eight curves at 800×500, sliding and growing.

use super::stage::Stage;
use crate::gpu::{Backend, ChartView, Color, Content, FrameOutcome, Panel, Pixels, Rect, Renderer, Style, Theme};
use crate::model::axis::{TimeAxis, ValueAxis};
use crate::model::series::Series;

const CURVES: usize = 8;
/// Time between samples, s.
const STEP_S: f64 = 0.001;
/// Samples appended to every curve in every frame: 1 kHz at 60 frames/s.
const APPENDED: usize = 16;
const SIZE_PX: [f32; 2] = [800.0, 500.0];
/// Frames before the clock starts: shaders compile, buffers grow.
const WARM_UP: usize = 20;
/// The measurement takes this long, ms.
const LENGTH_MS: f64 = 5000.0;

const COLORS: [Color; CURVES] = [
    Color::hex(0x0072b2),
    Color::hex(0x009e73),
    Color::hex(0xcc79a7),
    Color::hex(0xe69f00),
    Color::hex(0x56b4e9),
    Color::hex(0xb5a614),
    Color::hex(0xd55e00),
    Color::hex(0x1c2128),
];

/// A signal in its own lane: a slow wave, a fast one and noise, as of a sensor.
fn signal(curve: usize, sample: usize) -> f32 {
    let t = sample as f32 * STEP_S as f32;
    let hashed = (sample as u32).wrapping_mul(0x9e37_79b9).rotate_left(13).wrapping_mul(0x85eb_ca6b);
    let noise = (hashed >> 8) as f32 / (1 << 24) as f32 - 0.5;
    curve as f32 + 0.5 + 0.22 * (0.2 * t + curve as f32).sin() + 0.08 * (3.0 * t).sin() + 0.14 * noise
}

struct Bench {
    renderer: Renderer,
    /// Of each curve.
    samples: usize,
    series: Vec<Series>,
    appended: usize,
    frames: usize,
    started_ms: f64,
    last_ms: f64,
    /// Time from frame to frame.
    intervals_ms: Vec<f64>,
    /// Time spent in the page's own code.
    busy_ms: Vec<f64>,
    first: Option<Pixels>,
}

pub(super) fn run(stage: Stage, renderer: Renderer, samples: usize) {
    let series = (0..CURVES)
        .map(|curve| {
            let mut series = Series::new(samples);
            (0..samples).for_each(|i| {
                series.push(i as f64 * STEP_S, signal(curve, i));
            });
            series
        })
        .collect();
    let mut bench = Bench {
        renderer,
        samples,
        series,
        appended: samples,
        frames: 0,
        started_ms: 0.0,
        last_ms: 0.0,
        intervals_ms: Vec::new(),
        busy_ms: Vec::new(),
        first: None,
    };
    stage.each_frame(move |stage, now_ms| bench.step(stage, now_ms));
}

impl Bench {
    fn step(&mut self, stage: &Stage, now_ms: f64) -> bool {
        let (width, height, ratio) = stage.size();
        if self.renderer.is_busy() {
            return true;
        }
        self.renderer.resize(width, height, ratio);
        if self.frames == WARM_UP {
            self.started_ms = now_ms;
        } else if self.frames > WARM_UP {
            self.intervals_ms.push(now_ms - self.last_ms);
        }
        self.last_ms = now_ms;
        for (curve, series) in self.series.iter_mut().enumerate() {
            for i in self.appended..self.appended + APPENDED {
                series.push(i as f64 * STEP_S, signal(curve, i));
            }
        }
        self.appended += APPENDED;
        let outcome = self.draw();
        self.frames += 1;
        if outcome == FrameOutcome::Rebuild {
            stage.say("bench-error", "graphics context lost");
            return false;
        }
        self.busy_ms.push(stage.now_ms() - now_ms);
        let [wide, high] = SIZE_PX.map(|px| (f64::from(px) * ratio) as u32);
        if self.frames == WARM_UP {
            self.first = Pixels::read(&stage.drawn_on(), wide, high);
        }
        if self.frames > WARM_UP && now_ms - self.started_ms >= LENGTH_MS {
            let last = Pixels::read(&stage.drawn_on(), wide, high);
            self.report(stage, now_ms, last);
            return false;
        }
        true
    }

    fn draw(&mut self) -> FrameOutcome {
        let end_s = self.appended as f64 * STEP_S;
        let time = TimeAxis::ending_at(end_s, self.samples as f64 * STEP_S);
        let mut view = ChartView::new(time, ValueAxis::new(0.0, CURVES as f64), Theme::LIGHT);
        for (series, color) in self.series.iter().zip(COLORS) {
            view = view.curve(series, color, Style::Solid);
        }
        let rect = Rect::new(0.0, 0.0, SIZE_PX[0], SIZE_PX[1]);
        self.renderer.lay_out(&Theme::LIGHT, &[rect]);
        self.renderer.frame(&Theme::LIGHT, &[Panel { rect, content: Content::Chart(view) }])
    }

    fn report(&mut self, stage: &Stage, now_ms: f64, last: Option<Pixels>) {
        let rate = self.intervals_ms.len() as f64 / ((now_ms - self.started_ms) / 1000.0);
        let seen =
            last.as_ref().map_or(0, |pixels| COLORS.iter().filter(|color| pixels.columns_with(**color) > 0.95).count());
        let moved = match (&self.first, &last) {
            (Some(first), Some(last)) => first.differing(last),
            _ => 0,
        };
        let [median_ms, p99_ms] = [0.5, 0.99].map(|q| quantile(&mut self.intervals_ms, q));
        let backend = match self.renderer.backend() {
            Backend::WebGpu => "webgpu",
            Backend::WebGl => "webgl2",
            Backend::Processor => "processor",
        };
        let line = serde_json::json!({
            "bench": "charts", "name": format!("{CURVES}x{}k_800x500", self.samples / 1000), "value": round(rate), "unit": "frames/s",
            "median_ms": round(median_ms), "p99_ms": round(p99_ms),
            "busy_median_ms": round(quantile(&mut self.busy_ms, 0.5)),
            "curves_seen": seen, "curves": CURVES, "pixels_moved": moved,
            "vertices": self.renderer.stats().shape_vertices,
            "backend": backend, "adapter": self.renderer.adapter_name(),
        });
        stage.say("bench-frames-per-second", &format!("{rate:.1}"));
        stage.say("bench-result", &line.to_string());
    }
}

fn round(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// The value below which this share lies; zero of nothing.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((last as f64 * share).round() as usize).copied().unwrap_or(0.0)
}
