//! What the processor draws in one frame: panels to triangles as everywhere, written on a sheet for the page's worker.

use bytemuck::Zeroable as _;
use plumbline_raster::{Ground, View};

use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::color::Color;
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::scene::Content;
use super::shape::Shapes;

/// What is written of panels; kept between frames so that nothing is allocated.
#[derive(Default)]
pub(super) struct Sheet {
    written: plumbline_raster::Sheet,
    shapes: Shapes,
    scratch: Scratch,
    space: Space,
}

impl Sheet {
    /// An empty one.
    pub fn begin(&mut self, ground: Ground) {
        self.written.begin(ground);
    }

    /// Adds a panel, on a page of this colour; how many vertices of flat shapes and of solids it has.
    pub fn panel(&mut self, plot: Plot, content: &Content<'_>, page: Color) -> [usize; 2] {
        let Self { written, shapes, scratch, space } = self;
        shapes.clear();
        let mut seen = None;
        match content {
            Content::Chart(view) => draw_chart(shapes, scratch, plot, view),
            Content::Heatmap(view) => draw_heatmap(shapes, scratch, plot, view),
            Content::Horizon(view) => draw_horizon(shapes, plot, view),
            Content::Attitude3d(view) => {
                seen = Some((space.build(view, [plot.width(), plot.height()], plot.scale), view.theme.plot));
            }
        }
        let solids: [&[_]; 2] =
            if seen.is_some() { [space.solid.vertices(), space.clear.vertices()] } else { [&[], &[]] };
        let (view, sky) = seen.unwrap_or((View::zeroed(), page));
        written.add(&plumbline_raster::Panel {
            corner: [plot.left, plot.top],
            size: [plot.width(), plot.height()].map(|px| px as u32),
            colors: [page.packed(), sky.packed()],
            shapes: shapes.vertices(),
            solids,
            view,
        });
        [shapes.vertices().len(), solids.map(<[_]>::len).iter().sum()]
    }

    /// All of it.
    pub fn words(&self) -> &[u32] {
        self.written.words()
    }
}

#[cfg(test)]
mod tests {
    use plumbline_raster::{Depths, Tile, draw};

    use super::*;
    use crate::gpu::Theme;
    use crate::gpu::scene::{ChartView, Curve, Dash, Panel, Rect, Style};
    use crate::model::axis::{TimeAxis, ValueAxis};
    use crate::model::series::Series;

    /// Black ink on a white plot, 200 × 100, values 0..1, time 0..10 s.
    fn drawn(series: &Series, style: Style) -> Tile {
        let theme = Theme {
            plot: Color::hex(0xffffff),
            grid: Color::hex(0xffffff),
            axis: Color::hex(0xffffff),
            ..Theme::LIGHT
        };
        let mut view = ChartView::new(TimeAxis::new(0.0, 10.0), ValueAxis::new(0.0, 1.0), theme);
        view.curves.push(Curve { series, color: Color::hex(0), style, dash: Dash::None, scale: 1.0 });
        let mut tile = Tile::default();
        let panel = Panel { rect: Rect::new(0.0, 0.0, 200.0, 100.0), content: Content::Chart(view) };
        let mut sheet = Sheet::default();
        sheet.begin(Ground { size: [200, 100], page: theme.page.packed(), clear: 1 });
        sheet.panel(Plot::new(panel.rect, 1.0), &panel.content, theme.page);
        draw(sheet.words(), &mut tile, &mut Depths::default(), |_| (), |_, _| ());
        tile
    }

    /// 0..=1.
    fn red(image: &Tile, x: usize, y: usize) -> f32 {
        f32::from(image.pixels()[y * image.size()[0] + x].to_le_bytes()[0]) / 255.0
    }

    /// Ink in each column, in pixels.
    fn ink(image: &Tile) -> Vec<f32> {
        (0..image.size()[0]).map(|x| (0..image.size()[1]).map(|y| 1.0 - red(image, x, y)).sum()).collect()
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
            .fold(1.0_f32, |least, (x, y)| least.min(red(&image, x, y)));
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
                let size = [1280.0 * scale, 680.0 * scale].map(|px| px as u32);
                let mut sheet = Sheet::default();
                sheet.begin(Ground { size, page: theme.page.packed(), clear: 1 });
                let mut written = 0;
                crate::bench::gallery::with_panels(&theme, 1280.0, |panels| {
                    for panel in panels {
                        sheet.panel(Plot::new(panel.rect, scale), &panel.content, theme.page);
                        written += 1;
                    }
                });
                let wide = size[0] as usize;
                let mut picture = vec![theme.page.packed(); wide * size[1] as usize];
                let (mut tile, mut drawn) = (Tile::default(), 0);
                let begin = |ground: &Ground| assert_eq!(*ground, Ground { size, page: theme.page.packed(), clear: 1 });
                draw(sheet.words(), &mut tile, &mut Depths::default(), begin, |tile, [left, top]| {
                    let colors: std::collections::HashSet<u32> = tile.pixels().iter().copied().collect();
                    assert!(colors.len() > 8, "panel {drawn} shows {} colours", colors.len());
                    for (y, row) in tile.pixels().chunks(tile.size()[0]).enumerate() {
                        let at = (top as usize + y) * wide + left as usize;
                        picture[at..at + row.len()].copy_from_slice(row);
                    }
                    drawn += 1;
                });
                assert_eq!(drawn, written);
                if let Some(folder) = &folder {
                    let name = format!("gallery-{}-{scale}x.ppm", if dark { "dark" } else { "light" });
                    std::fs::write(std::path::Path::new(folder).join(name), ppm(&picture, size)).unwrap();
                }
            }
        }
    }

    /// GIVEN a sheet that ends too soon WHEN it is drawn THEN what is whole is drawn, and nothing else.
    #[test]
    fn of_a_sheet_cut_short_the_whole_panels_are_drawn() {
        let theme = Theme::LIGHT;
        let mut sheet = Sheet::default();
        sheet.begin(Ground { size: [1280, 680], page: theme.page.packed(), clear: 1 });
        let mut ends = Vec::new();
        crate::bench::gallery::with_panels(&theme, 640.0, |panels| {
            for panel in panels {
                sheet.panel(Plot::new(panel.rect, 0.25), &panel.content, theme.page);
                ends.push(sheet.words().len());
            }
        });
        for cut in [0, 1, 4, 7, ends[0] - 1, ends[0], ends[1] - 1, ends[2] + 3] {
            let mut drawn = 0;
            let words = &sheet.words()[..cut];
            draw(words, &mut Tile::default(), &mut Depths::default(), |_| (), |_, _| drawn += 1);
            assert_eq!(drawn, ends.iter().filter(|end| **end <= cut).count(), "{cut} words");
        }
    }

    fn ppm(picture: &[u32], [width, height]: [u32; 2]) -> Vec<u8> {
        let mut bytes = format!("P6\n{width} {height}\n255\n").into_bytes();
        bytes.extend(picture.iter().flat_map(|pixel| pixel.to_le_bytes()[..3].to_vec()));
        bytes
    }
}
