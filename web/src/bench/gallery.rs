//! Everything the canvas draws, from a synthetic flight: for looking at, and for comparing pictures.

use std::f32::consts::TAU;

use super::stage::Stage;
use crate::gpu::*;
use crate::model::axis::{TimeAxis, ValueAxis};
use crate::model::series::Series;

/// The synthetic flight's curves.
struct Flight {
    setpoint: Series,
    estimate: Series,
    other: Series,
    heights: Vec<Series>,
    truth: Series,
    angles: Vec<Series>,
    ratios: Vec<Series>,
}

/// A repeatable scatter about zero, ±0.5.
fn scatter(i: usize) -> f32 {
    let hashed = (i as u32).wrapping_mul(0x9e37_79b9).rotate_left(13).wrapping_mul(0x85eb_ca6b);
    (hashed >> 8) as f32 / (1 << 24) as f32 - 0.5
}

/// A damped answer to steps at 5, 20 and 40 s.
fn altitude(t: f32) -> f32 {
    let step = |at: f32, height: f32| {
        let s = t - at;
        if s < 0.0 { 0.0 } else { height * (1.0 - (-1.3 * s).exp() * ((2.1 * s).cos() + 0.6 * (2.1 * s).sin())) }
    };
    step(5.0, 0.5) + step(20.0, 0.3) + step(40.0, 0.2)
}

fn attacked(t: f32) -> bool {
    (28.0..36.0).contains(&t)
}

impl Flight {
    fn new() -> Self {
        let at = |i: usize, rate: f32| i as f32 / rate;
        let curve = |rate: f32, value: &dyn Fn(usize, f32) -> f32| {
            Series::from_samples((0..(60.0 * rate) as usize).map(|i| (f64::from(at(i, rate)), value(i, at(i, rate)))))
        };
        let setpoint = |t: f32| {
            if t < 5.0 {
                0.0
            } else if t < 20.0 {
                0.5
            } else if t < 40.0 {
                0.8
            } else {
                1.0
            }
        };
        let height = |instance: usize| {
            Series::from_samples((0..600).filter(|i| instance != 3 || !(460..520).contains(i)).map(|i| {
                let t = i as f32 / 10.0;
                let offset = if instance == 2 && attacked(t) { 0.5 } else { 0.0 };
                (f64::from(t), altitude(t) + offset + 0.02 * scatter(i * 3 + instance))
            }))
            .with_max_gap(0.5)
        };
        let ratio = |row: usize| {
            let rate = if row < 3 { 10.0 } else { 100.0 };
            curve(rate, &|i, t| {
                let calm = 0.25 + 0.5 * scatter(i * 7 + row).abs();
                match row {
                    1 if attacked(t) => 2.4,
                    0 | 2 if (27.0..28.0).contains(&t) => 0.85,
                    5 if (12.0..13.0).contains(&t) => 0.65,
                    _ => calm * 0.8,
                }
            })
            .with_max_gap(0.5)
        };
        Self {
            setpoint: curve(100.0, &|_, t| setpoint(t)),
            estimate: curve(100.0, &|i, t| altitude(t) + 0.004 * scatter(i)),
            other: curve(100.0, &|i, t| altitude(t - 0.2) + if attacked(t) { 0.17 } else { 0.0 } + 0.01 * scatter(i)),
            heights: (1..=3).map(height).collect(),
            truth: curve(100.0, &|_, t| altitude(t + 0.02)),
            angles: (0..3)
                .map(|axis| {
                    curve(100.0, &|i, t| {
                        let slow = (0.6 * t + axis as f32 * 2.0).sin();
                        0.06 * slow + 0.02 * (7.0 * t).sin() + 0.02 * scatter(i + axis * 99_991)
                    })
                })
                .collect(),
            ratios: (0..12).map(ratio).collect(),
        }
    }
}

pub(super) fn run(stage: Stage, mut renderer: Renderer, dark: bool) {
    let flight = Flight::new();
    let theme = Theme::of(dark);
    let mut drawn = 0;
    stage.each_frame(move |stage, now_ms| {
        let (width, height, ratio) = stage.size();
        renderer.resize(width, height, ratio);
        let (rotors, strings) = (rotors(), strings());
        let panels = panels(&flight, &theme, &rotors, &strings, width as f32);
        renderer.lay_out(&theme, &panels.iter().map(|panel| panel.rect).collect::<Vec<_>>());
        let outcome = renderer.frame(&theme, &panels);
        drawn += u32::from(outcome == FrameOutcome::Drawn);
        // By a worker the first is on the canvas when the second begins.
        if drawn > 2 && now_ms > 500.0 {
            stage.say("gallery-drawn", "drawn");
        }
        outcome != FrameOutcome::Rebuild
    });
}

/// Hands the gallery's panels to a test.
#[cfg(test)]
pub(crate) fn with_panels(theme: &Theme, width: f32, use_them: impl FnOnce(&[Panel<'_>])) {
    let (flight, rotors, strings) = (Flight::new(), rotors(), strings());
    use_them(&panels(&flight, theme, &rotors, &strings, width));
}

fn strings() -> [StringLine; 1] {
    [StringLine { anchor_enu_m: [0.0, 0.0, 2.6], attach_flu_m: [0.0, 0.0, 0.03], length_m: 1.9 }]
}

fn rotors() -> Vec<Rotor> {
    (0..4)
        .map(|i| {
            let (sin, cos) = ((i as f32 + 0.5) * TAU / 4.0).sin_cos();
            let level = [0.42, 0.55, 0.8, 0.95][i];
            Rotor { position_flu_m: [0.25 * cos, 0.25 * sin, 0.0], radius_m: 0.127, level, saturated: i == 3 }
        })
        .collect()
}

/// Of attacks and of gates.
const ATTACK: u32 = 0xd55e00;

fn sensor_colors(theme: &Theme) -> [Color; 3] {
    [0xe69f00, 0x56b4e9, if theme.dark { 0xd8c83a } else { 0xa89a1a }].map(Color::hex)
}

fn estimate_color(theme: &Theme) -> Color {
    Color::hex(if theme.dark { 0x3d9fe0 } else { 0x0072b2 })
}

fn whole_flight() -> TimeAxis {
    TimeAxis::new(0.0, 60.0)
}

fn spans() -> Vec<Span> {
    let color = Color::hex(ATTACK);
    vec![
        Span { start_s: 28.0, end_s: 36.0, color, planned: false },
        Span { start_s: 52.0, end_s: 57.0, color, planned: true },
    ]
}

fn heights<'a>(flight: &'a Flight, theme: &Theme) -> ChartView<'a> {
    let mut heights = ChartView::new(whole_flight(), ValueAxis::new(-0.2, 1.6), *theme);
    for (series, color) in flight.heights.iter().zip(sensor_colors(theme)) {
        heights = heights.curve(series, color, Style::Thin);
    }
    ChartView { spans: spans(), cursor_s: Some(24.0), ..heights }
        .curve(&flight.other, Color::hex(0x009e73), Style::Solid)
        .curve(&flight.truth, theme.ink.alpha(0.6), Style::Solid)
        .dashed(Dash::Dashed)
        .curve(&flight.setpoint, theme.ink.alpha(0.85), Style::Step)
        .curve(&flight.estimate, estimate_color(theme), Style::Strong)
}

fn zoomed<'a>(flight: &'a Flight, theme: &Theme) -> ChartView<'a> {
    let [first, second, _] = sensor_colors(theme);
    ChartView {
        marks: vec![Mark { time_s: 28.0, color: Color::hex(ATTACK) }],
        ..ChartView::new(TimeAxis::new(26.0, 31.0), ValueAxis::new(0.6, 1.6), *theme)
    }
    .curve(&flight.heights[1], second, Style::Points)
    .curve(&flight.heights[0], first, Style::Points)
    .curve(&flight.truth, theme.ink.alpha(0.6), Style::Solid)
    .dashed(Dash::Dashed)
    .curve(&flight.estimate, estimate_color(theme), Style::Strong)
}

fn angles<'a>(flight: &'a Flight, theme: &Theme) -> ChartView<'a> {
    let mut angles = ChartView::new(whole_flight(), ValueAxis::new(-8.0, 8.0), *theme);
    for (series, color) in flight.angles.iter().zip([0x0072b2, 0x009e73, 0xcc79a7]) {
        angles.curves.push(Curve {
            series,
            color: Color::hex(color),
            style: Style::Solid,
            dash: Dash::None,
            scale: 57.29578,
        });
    }
    let gate = |value| LevelLine { value, color: Color::hex(ATTACK), dashed: true };
    ChartView { levels: vec![gate(6.0), gate(-6.0)], spans: spans(), ..angles }
}

fn heat<'a>(flight: &'a Flight, theme: &Theme) -> HeatmapView<'a> {
    let rows = flight.ratios.iter().enumerate().map(|(i, ratio)| HeatRow { ratio, group_start: i % 3 == 0 });
    HeatmapView {
        time: whole_flight(),
        rows: rows.collect(),
        spans: spans(),
        cursor_s: Some(24.0),
        time_origin_s: 0.0,
        theme: *theme,
    }
}

/// In flight on its strings with a ghost beside it, and standing.
fn spaces<'a>(theme: &Theme, rotors: &'a [Rotor], strings: &'a [StringLine]) -> [Attitude3dView<'a>; 2] {
    let pose = Pose { position_enu_m: [0.1, 0.05, 0.85], world_from_body: [0.985, 0.10, -0.045, 0.13] };
    let flying = Attitude3dView {
        pose,
        ghosts: vec![Ghost { pose: Pose { position_enu_m: [0.16, 0.05, 0.95], ..pose }, color: theme.ink }],
        trail: (0..40).map(|i| [0.1 - 0.01 * i as f32, 0.05, 0.45 + 0.01 * i as f32]).collect(),
        bounds: Some(Bounds { half_m: 2.0, top_m: 2.0 }),
        goal: Some([0.1, 0.05, 1.0]),
        rotors,
        strings,
        camera: Camera::default(),
        stale: false,
        theme: *theme,
    };
    let standing = Attitude3dView {
        pose: Pose { position_enu_m: [0.0, 0.0, 0.08], ..Pose::ORIGIN },
        ghosts: Vec::new(),
        trail: Vec::new(),
        bounds: None,
        goal: None,
        strings: &[],
        camera: Camera { azimuth_rad: 0.7, elevation_rad: 0.6, zoom_out: 1.4 },
        ..flying.clone()
    };
    [flying, standing]
}

fn panels<'a>(
    flight: &'a Flight,
    theme: &Theme,
    rotors: &'a [Rotor],
    strings: &'a [StringLine],
    width: f32,
) -> Vec<Panel<'a>> {
    let [flying, standing] = spaces(theme, rotors, strings);
    let horizon = HorizonView { roll_rad: 0.21, pitch_flu_rad: -0.09, stale: false, theme: *theme };
    let wide = (width - 330.0).max(200.0);
    let panel = |x, y, width, height, content| Panel { rect: Rect::new(x, y, width, height), content };
    vec![
        panel(10.0, 10.0, 300.0, 225.0, Content::Horizon(horizon)),
        panel(10.0, 245.0, 300.0, 260.0, Content::Attitude3d(flying)),
        panel(10.0, 515.0, 145.0, 145.0, Content::Attitude3d(standing)),
        panel(165.0, 515.0, 145.0, 145.0, Content::Horizon(HorizonView { stale: true, ..horizon })),
        panel(320.0, 10.0, wide, 200.0, Content::Chart(heights(flight, theme))),
        panel(320.0, 220.0, wide, 140.0, Content::Chart(zoomed(flight, theme))),
        panel(320.0, 370.0, wide, 130.0, Content::Chart(angles(flight, theme))),
        panel(320.0, 510.0, wide, 150.0, Content::Heatmap(heat(flight, theme))),
    ]
}
