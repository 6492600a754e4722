//! A plain software rasteriser with the shaders' arithmetic, for tests: what a frame would look like,
//! pixel by pixel, without a graphics device.
//!
//! With `PLUMBLINE_PICTURES=FOLDER` the gallery is written there as PPM files, to be looked at.

use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::color::{Color, Theme};
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::mesh;
use super::scene::{Attitude3dView, ChartView, Content, Curve, Panel, Rect, Style};
use super::shape::{Shapes, Vertex};
use crate::model::axis::{TimeAxis, ValueAxis};
use crate::model::series::Series;

struct Image {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

fn channels(color: u32) -> [f32; 4] {
    color.to_le_bytes().map(|byte| f32::from(byte) / 255.0)
}

/// Calls `hit` with each covered pixel's index and its corner weights; clockwise or not, shared edges
/// belong to one triangle only.
fn cover(corners: [[f32; 2]; 3], clip: [usize; 4], mut hit: impl FnMut(usize, usize, [f32; 3])) {
    let [a, mut b, mut c] = corners.map(|p| [f64::from(p[0]), f64::from(p[1])]);
    let cross = |o: [f64; 2], p: [f64; 2], q: [f64; 2]| (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
    let mut area = cross(a, b, c);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let swapped = area < 0.0;
    if swapped {
        std::mem::swap(&mut b, &mut c);
        area = -area;
    }
    let bound = |axis: usize, low: usize, high: usize| {
        let values = [a[axis], b[axis], c[axis]];
        let least = values.iter().copied().fold(f64::MAX, f64::min).floor().max(low as f64) as usize;
        let most = values.iter().copied().fold(f64::MIN, f64::max).ceil().min(high as f64).max(0.0) as usize;
        least..most
    };
    let inside = |p: [f64; 2], q: [f64; 2], at: [f64; 2]| {
        let e = cross(p, q, at);
        let top_left = q[1] < p[1] || (q[1] == p[1] && q[0] > p[0]);
        (e > 0.0 || (e == 0.0 && top_left)).then_some(e / area)
    };
    for y in bound(1, clip[1], clip[3]) {
        for x in bound(0, clip[0], clip[2]) {
            let at = [x as f64 + 0.5, y as f64 + 0.5];
            if let (Some(wa), Some(wb), Some(wc)) = (inside(b, c, at), inside(c, a, at), inside(a, b, at)) {
                let (wb, wc) = if swapped { (wc, wb) } else { (wb, wc) };
                hit(x, y, [wa as f32, wb as f32, wc as f32]);
            }
        }
    }
}

impl Image {
    fn new(width: usize, height: usize, color: Color) -> Self {
        let [r, g, b, _] = channels(color.packed());
        Self { width, height, pixels: vec![[r, g, b]; width * height] }
    }

    fn blend(&mut self, x: usize, y: usize, color: [f32; 3], alpha: f32) {
        let pixel = &mut self.pixels[y * self.width + x];
        for (old, new) in pixel.iter_mut().zip(color) {
            *old += (new - *old) * alpha;
        }
    }

    /// What `shape.wgsl` does.
    fn shapes(&mut self, vertices: &[Vertex], plot: Plot) {
        let clip = plot.edges().map(|edge| edge.max(0.0) as usize);
        let clip = [clip[0], clip[1], clip[2].min(self.width), clip[3].min(self.height)];
        for corners in vertices.windows(3) {
            let colors = [0, 1, 2].map(|i| channels(corners[i].color));
            cover([0, 1, 2].map(|i| corners[i].position), clip, |x, y, weights| {
                let mix = |of: [f32; 3]| of[0] * weights[0] + of[1] * weights[1] + of[2] * weights[2];
                let edge = [0, 1].map(|n| mix([0, 1, 2].map(|i| corners[i].edge[n])));
                let coverage = (edge[1] + 0.5 - edge[0].abs()).clamp(0.0, 1.0);
                let color = [0, 1, 2, 3].map(|n| mix(colors.map(|c| c[n])));
                self.blend(x, y, [color[0], color[1], color[2]], color[3] * coverage);
            });
        }
    }

    /// What `mesh.wgsl` does, with four samples per pixel.
    fn space(&mut self, plot: Plot, view: &Attitude3dView<'_>) {
        let (width, height) = (plot.width() as usize * 2, plot.height() as usize * 2);
        let mut space = Space::default();
        let seen = space.build(view, [plot.width(), plot.height()], plot.scale);
        let mut fine = Image::new(width, height, view.theme.plot);
        let mut depths = vec![1.0_f32; width * height];
        for (mesh, solid) in [(&space.solid, true), (&space.clear, false)] {
            for corners in mesh.vertices().chunks_exact(3) {
                fine.lit(corners, &seen, &mut depths, solid);
            }
        }
        for y in 0..height / 2 {
            for x in 0..width / 2 {
                let four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| fine.pixels[(2 * y + i) * width + 2 * x + j]);
                let mean = [0, 1, 2].map(|n| four.iter().map(|p| p[n]).sum::<f32>() / 4.0);
                self.blend(plot.left as usize + x, plot.top as usize + y, mean, 1.0);
            }
        }
    }

    fn lit(&mut self, corners: &[mesh::Vertex], view: &mesh::View, depths: &mut [f32], solid: bool) {
        let m = view.clip_from_world;
        let clip = [0, 1, 2].map(|i| {
            let p = corners[i].position;
            [0, 1, 2, 3].map(|r| m[0][r] * p[0] + m[1][r] * p[1] + m[2][r] * p[2] + m[3][r])
        });
        if clip.iter().any(|c| c[3] < 0.02) {
            return;
        }
        let (width, height) = (self.width as f32, self.height as f32);
        let screen = clip.map(|c| [(c[0] / c[3] * 0.5 + 0.5) * width, (0.5 - c[1] / c[3] * 0.5) * height]);
        let colors = [0, 1, 2].map(|i| {
            let [r, g, b, a] = channels(corners[i].color);
            let normal = corners[i].normal;
            let light = [view.light[0], view.light[1], view.light[2]];
            let shade = view.light[3] + (1.0 - view.light[3]) * mesh::dot(normal, light).max(0.0);
            let shade = if mesh::dot(normal, normal) > 0.25 { shade } else { 1.0 };
            [r * shade, g * shade, b * shade, a]
        });
        cover(screen, [0, 0, self.width, self.height], |x, y, weights| {
            let per_w = [0, 1, 2].map(|i| weights[i] / clip[i][3]);
            let whole: f32 = per_w.iter().sum();
            let depth: f32 = (0..3).map(|i| weights[i] * clip[i][2] / clip[i][3]).sum();
            let color = [0, 1, 2, 3].map(|n| (0..3).map(|i| per_w[i] * colors[i][n]).sum::<f32>() / whole);
            let kept = &mut depths[y * width as usize + x];
            if depth <= *kept {
                if solid {
                    *kept = depth;
                }
                self.blend(x, y, [color[0], color[1], color[2]], color[3]);
            }
        });
    }

    fn panels(&mut self, panels: &[Panel<'_>], scale: f32) {
        let mut scratch = Scratch::default();
        for panel in panels {
            let plot = Plot::new(panel.rect, scale);
            let mut shapes = Shapes::default();
            match &panel.content {
                Content::Chart(view) => draw_chart(&mut shapes, &mut scratch, plot, view),
                Content::Heatmap(view) => draw_heatmap(&mut shapes, &mut scratch, plot, view),
                Content::Horizon(view) => draw_horizon(&mut shapes, plot, view),
                Content::Attitude3d(view) => self.space(plot, view),
            }
            self.shapes(shapes.vertices(), plot);
        }
    }

    fn ppm(&self) -> Vec<u8> {
        let mut bytes = format!("P6\n{} {}\n255\n", self.width, self.height).into_bytes();
        bytes.extend(self.pixels.iter().flatten().map(|channel| (channel * 255.0).round() as u8));
        bytes
    }
}

/// Black ink on a white plot, 200 × 100, values 0..1, time 0..10 s.
fn drawn(series: &Series, style: Style) -> Image {
    let theme =
        Theme { plot: Color::hex(0xffffff), grid: Color::hex(0xffffff), axis: Color::hex(0xffffff), ..Theme::LIGHT };
    let mut view = ChartView::new(TimeAxis::new(0.0, 10.0), ValueAxis::new(0.0, 1.0), theme);
    view.curves.push(Curve { series, color: Color::hex(0), style, scale: 1.0 });
    let mut image = Image::new(200, 100, Color::hex(0xffffff));
    image.panels(&[Panel { rect: Rect::new(0.0, 0.0, 200.0, 100.0), content: Content::Chart(view) }], 1.0);
    image
}

/// Ink in each column, in pixels.
fn ink(image: &Image) -> Vec<f32> {
    (0..image.width).map(|x| (0..image.height).map(|y| 1.0 - image.pixels[y * image.width + x][0]).sum()).collect()
}

#[test]
fn sparse_or_dense_a_calm_curve_has_the_same_weight() {
    for samples in [20, 200, 5000, 100_000] {
        let series = Series::from_samples((0..=samples).map(|i| (10.0 * f64::from(i) / f64::from(samples), 0.503)));
        let ink = ink(&drawn(&series, Style::Solid));
        for (x, ink) in ink.iter().enumerate().take(198).skip(2) {
            assert!((ink - 1.5).abs() < 0.05, "{samples} samples, column {x}: {ink}");
        }
    }
}

#[test]
fn a_slope_keeps_its_width_sparse_or_dense() {
    // 45° on screen: 100 px up over 100 px.
    let weight = |samples: i32| {
        let value = |t: f64| ((t - 2.5) / 5.0).clamp(0.0, 1.0) as f32;
        let series = Series::from_samples((0..=samples).map(|i| {
            let t = 10.0 * f64::from(i) / f64::from(samples);
            (t, value(t))
        }));
        ink(&drawn(&series, Style::Solid))[80..120].iter().sum::<f32>() / 40.0
    };
    let expected = 1.5 * std::f32::consts::SQRT_2;
    for samples in [16, 200, 5000, 100_000] {
        let weight = weight(samples);
        assert!((weight / expected - 1.0).abs() < 0.12, "{samples} samples: {weight} instead of {expected}");
    }
}

#[test]
fn one_sample_among_a_hundred_thousand_is_seen() {
    let series =
        Series::from_samples((0..100_000).map(|i| (f64::from(i) * 1e-4, if i == 50_321 { 0.95 } else { 0.1 })));
    let image = drawn(&series, Style::Solid);
    let darkest_above = (0..50)
        .flat_map(|y| (0..200).map(move |x| (x, y)))
        .fold(1.0_f32, |least, (x, y)| least.min(image.pixels[y * 200 + x][0]));
    assert!(darkest_above < 0.35, "{darkest_above}");
}

#[test]
fn a_gap_stays_white() {
    let series = Series::from_samples(
        (0..1000).map(|i| (f64::from(i) * 0.01, if (400..600).contains(&i) { f32::NAN } else { 0.5 })),
    );
    let ink = ink(&drawn(&series, Style::Solid));
    assert!(ink[85..115].iter().all(|ink| ink.abs() < 1e-3), "{:?}", &ink[85..115]);
    assert!(ink[20] > 1.0 && ink[180] > 1.0);
}

#[test]
fn every_part_of_the_gallery_shows_several_colours() {
    // Small pictures for the test, full ones for people.
    let folder = std::env::var_os("PLUMBLINE_PICTURES");
    let scales: &[f32] = if folder.is_some() { &[1.0, 2.0] } else { &[0.5] };
    for dark in [false, true] {
        for &scale in scales {
            let theme = Theme::of(dark);
            let size = [1280.0 * scale, 680.0 * scale].map(|px| px as usize);
            let mut image = Image::new(size[0], size[1], theme.page);
            crate::bench::gallery::with_panels(&theme, 1280.0, |panels| {
                image.panels(panels, scale);
                for (i, panel) in panels.iter().enumerate() {
                    let plot = Plot::new(panel.rect, scale);
                    let mut colors = std::collections::HashSet::new();
                    for y in plot.top as usize..plot.bottom as usize {
                        for x in plot.left as usize..plot.right as usize {
                            colors.insert(image.pixels[y * image.width + x].map(|c| (c * 255.0) as u8));
                        }
                    }
                    assert!(colors.len() > 8, "panel {i} shows {} colours", colors.len());
                }
            });
            if let Some(folder) = &folder {
                let name = format!("gallery-{}-{scale}x.ppm", if dark { "dark" } else { "light" });
                std::fs::write(std::path::Path::new(folder).join(name), image.ppm()).unwrap();
            }
        }
    }
}
