//! What is really on the canvas.

use wasm_bindgen::JsCast as _;
use web_sys::{CanvasRenderingContext2d, HtmlCanvasElement};

use super::Color;

/// A copy of part of the canvas: rows of r, g, b, a.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pixels {
    width: usize,
    bytes: Vec<u8>,
}

impl Pixels {
    /// Copies the upper left corner. By a card only in the task that drew the frame: afterwards the browser may have emptied the
    /// buffer. By the processor it is the last frame that the browser has been given.
    pub fn read(canvas: &HtmlCanvasElement, width: u32, height: u32) -> Option<Self> {
        let copy: HtmlCanvasElement = canvas.owner_document()?.create_element("canvas").ok()?.dyn_into().ok()?;
        copy.set_width(width);
        copy.set_height(height);
        let context: CanvasRenderingContext2d = copy.get_context("2d").ok()??.dyn_into().ok()?;
        context.draw_image_with_html_canvas_element(canvas, 0.0, 0.0).ok()?;
        let data = context.get_image_data(0.0, 0.0, f64::from(width), f64::from(height)).ok()?;
        Some(Self { width: width as usize, bytes: data.data().0 })
    }

    /// Has anything been painted? No page is black.
    pub fn are_painted(&self) -> bool {
        self.bytes.iter().take(3).all(|channel| *channel > 0)
    }

    /// Share of the columns with at least one pixel of about this colour.
    pub fn columns_with(&self, color: Color) -> f64 {
        let mut seen = vec![false; self.width];
        for (i, pixel) in self.bytes.chunks_exact(4).enumerate() {
            let near = |a: u8, b: u8| a.abs_diff(b) < 24;
            if near(pixel[0], color.r) && near(pixel[1], color.g) && near(pixel[2], color.b) {
                seen[i % self.width.max(1)] = true;
            }
        }
        seen.iter().filter(|seen| **seen).count() as f64 / self.width.max(1) as f64
    }

    /// How many pixels differ.
    pub fn differing(&self, other: &Self) -> usize {
        self.bytes.chunks_exact(4).zip(other.bytes.chunks_exact(4)).filter(|(a, b)| a != b).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_white_canvas_is_painted_and_shows_no_curve() {
        assert!(!Pixels { width: 1, bytes: vec![0; 4] }.are_painted());
        let mut pixels = Pixels { width: 4, bytes: vec![255; 4 * 4 * 3] };
        assert!(pixels.are_painted());
        assert_eq!(pixels.columns_with(Color::hex(0x0072b2)), 0.0);
        let before = pixels.clone();
        pixels.bytes[20..23].copy_from_slice(&[0x02, 0x70, 0xb0]);
        assert_eq!(pixels.columns_with(Color::hex(0x0072b2)), 0.25);
        assert_eq!(pixels.differing(&before), 1);
    }
}
