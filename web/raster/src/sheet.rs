//! What is drawn in one frame: triangles by panel, as words, which is how the page hands them to its worker.

use bytemuck::{Pod, Zeroable};

use crate::{Depths, Flat, Solid, Tile, View};

/// What every panel lies on.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Ground {
    /// Width and height of the canvas, px.
    pub size: [u32; 2],
    /// Its colour: r, g, b, a.
    pub page: u32,
    /// Is it cleared first? Else what no panel covers stays.
    pub clear: u32,
}

/// One panel.
#[derive(Debug, Clone, Copy)]
pub struct Panel<'a> {
    /// From the canvas's corner to the panel's, px.
    pub corner: [f32; 2],
    /// Width and height, px.
    pub size: [u32; 2],
    /// Colours behind flat shapes and behind solids: r, g, b, a.
    pub colors: [u32; 2],
    /// A strip of flat shapes, before everything else.
    pub shapes: &'a [Flat],
    /// Opaque and translucent solids.
    pub solids: [&'a [Solid]; 2],
    /// How the solids are seen.
    pub view: View,
}

/// What comes before a panel's triangles.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct Head {
    corner: [f32; 2],
    size: [u32; 2],
    colors: [u32; 2],
    /// How many vertices of flat shapes, of opaque and of translucent solids follow.
    shapes: u32,
    solids: [u32; 2],
    view: View,
}

/// What is written of panels; kept between frames so that nothing is allocated.
#[derive(Debug, Default)]
pub struct Sheet {
    words: Vec<u32>,
}

impl Sheet {
    /// An empty one.
    pub fn begin(&mut self, ground: Ground) {
        self.words.clear();
        self.write(&[ground]);
    }

    /// Adds a panel.
    pub fn add(&mut self, panel: &Panel<'_>) {
        let Panel { corner, size, colors, shapes, solids, view } = *panel;
        let count = solids.map(|vertices| vertices.len() as u32);
        self.write(&[Head { corner, size, colors, shapes: shapes.len() as u32, solids: count, view }]);
        self.write(shapes);
        solids.into_iter().for_each(|vertices| self.write(vertices));
    }

    /// All of it.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    fn write<T: Pod>(&mut self, values: &[T]) {
        self.words.extend_from_slice(bytemuck::cast_slice(values));
    }
}

/// The first so many values of `words`, and the rest; `None` where there are fewer.
fn read<'a, T: Pod>(words: &mut &'a [u32], count: usize) -> Option<&'a [T]> {
    let (values, rest) = words.split_at_checked(count.checked_mul(size_of::<T>() / size_of::<u32>())?)?;
    *words = rest;
    bytemuck::try_cast_slice(values).ok()
}

/// Draws the words of a [`Sheet`]: `begin` is called with what panels lie on, then `put` with each panel that is whole, and its corner, px.
pub fn draw(
    mut words: &[u32],
    tile: &mut Tile,
    depths: &mut Depths,
    begin: impl FnOnce(&Ground),
    mut put: impl FnMut(&Tile, [f32; 2]),
) {
    let Some([ground]) = read::<Ground>(&mut words, 1) else { return };
    begin(ground);
    while let Some([head]) = read::<Head>(&mut words, 1) {
        let shapes = read::<Flat>(&mut words, head.shapes as usize);
        let [solid, clear] = head.solids.map(|count| read::<Solid>(&mut words, count as usize));
        let (Some(shapes), Some(solid), Some(clear)) = (shapes, solid, clear) else { return };
        let [page, sky] = head.colors;
        tile.clear(head.size.map(|px| px as usize), page);
        if !solid.is_empty() || !clear.is_empty() {
            tile.space([solid, clear], &head.view, sky, depths);
        }
        tile.shapes(shapes, head.corner);
        put(tile, head.corner);
    }
}
