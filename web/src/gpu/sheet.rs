//! What the processor draws in one frame: triangles by panel, as words, which is how the page hands them to its worker.

use bytemuck::{Pod, Zeroable};

use super::attitude3d::Space;
use super::chart::{Scratch, draw_chart};
use super::color::Color;
use super::grid::Plot;
use super::heatmap::draw_heatmap;
use super::horizon::draw_horizon;
use super::raster::{Depths, Tile};
use super::scene::Content;
use super::shape::Shapes;
use super::{mesh, shape};

/// What every panel lies on.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct Ground {
    /// Width and height of the canvas, px.
    pub size: [u32; 2],
    /// Its colour: r, g, b, a.
    pub page: u32,
    /// Is it cleared first? Else what no panel covers stays.
    pub clear: u32,
}

/// What comes before a panel's triangles.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct Head {
    /// From the canvas's corner to the panel's, px.
    corner: [f32; 2],
    /// Width and height, px.
    size: [u32; 2],
    /// Colours behind flat shapes and behind solids: r, g, b, a.
    page: u32,
    sky: u32,
    /// How many vertices of flat shapes, of opaque and of translucent solids follow.
    shapes: u32,
    solid: u32,
    clear: u32,
    /// How the solids are seen.
    view: mesh::View,
}

/// What is written of panels; kept between frames so that nothing is allocated.
#[derive(Default)]
pub(super) struct Sheet {
    words: Vec<u32>,
    shapes: Shapes,
    scratch: Scratch,
    space: Space,
}

impl Sheet {
    /// An empty one.
    pub fn begin(&mut self, ground: Ground) {
        self.words.clear();
        write(&mut self.words, &[ground]);
    }

    /// Adds a panel, on a page of this colour; how many vertices of flat shapes and of solids it has.
    pub fn panel(&mut self, plot: Plot, content: &Content<'_>, page: Color) -> [usize; 2] {
        let Self { words, shapes, scratch, space } = self;
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
        let solids: [&[mesh::Vertex]; 2] =
            if seen.is_some() { [space.solid.vertices(), space.clear.vertices()] } else { [&[], &[]] };
        let [solid, clear] = solids.map(|vertices| vertices.len() as u32);
        let (view, sky) = seen.unwrap_or((Zeroable::zeroed(), page));
        let head = Head {
            corner: [plot.left, plot.top],
            size: [plot.width(), plot.height()].map(|px| px as u32),
            page: page.packed(),
            sky: sky.packed(),
            shapes: shapes.vertices().len() as u32,
            solid,
            clear,
            view,
        };
        write(words, &[head]);
        write(words, shapes.vertices());
        solids.into_iter().for_each(|vertices| write(words, vertices));
        [shapes.vertices().len(), (solid + clear) as usize]
    }

    /// All of it.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
}

fn write<T: Pod>(words: &mut Vec<u32>, values: &[T]) {
    words.extend_from_slice(bytemuck::cast_slice(values));
}

/// The first so many values of `words`, and the rest; `None` where there are fewer.
fn read<'a, T: Pod>(words: &mut &'a [u32], count: usize) -> Option<&'a [T]> {
    let (values, rest) = words.split_at_checked(count.checked_mul(size_of::<T>() / size_of::<u32>())?)?;
    *words = rest;
    bytemuck::try_cast_slice(values).ok()
}

/// Draws what is written on a sheet: `begin` is called with what panels lie on, then `put` with each panel and its corner, px.
pub(super) fn draw(
    mut words: &[u32],
    tile: &mut Tile,
    depths: &mut Depths,
    begin: impl FnOnce(&Ground),
    mut put: impl FnMut(&Tile, [f32; 2]),
) {
    let Some([ground]) = read::<Ground>(&mut words, 1) else { return };
    begin(ground);
    while let Some([head]) = read::<Head>(&mut words, 1) {
        let shapes = read::<shape::Vertex>(&mut words, head.shapes as usize);
        let solid = read::<mesh::Vertex>(&mut words, head.solid as usize);
        let clear = read::<mesh::Vertex>(&mut words, head.clear as usize);
        let (Some(shapes), Some(solid), Some(clear)) = (shapes, solid, clear) else { return };
        tile.clear(head.size.map(|px| px as usize), head.page);
        if !solid.is_empty() || !clear.is_empty() {
            tile.space([solid, clear], &head.view, head.sky, depths);
        }
        tile.shapes(shapes, head.corner);
        put(tile, head.corner);
    }
}
