//! Whoever draws: a graphics card by WebGPU or WebGL2, or the processor where there is none.

use web_sys::HtmlCanvasElement;

use super::Theme;
use super::context::{Card, FrameOutcome, FrameStats};
use super::error::GpuError;
use super::paper::{Paper, without_card};
use super::scene::{Panel, Rect};
use super::screen::{Backend, Over};

/// Draws panels on one canvas.
pub struct Renderer {
    means: Means,
    /// What is drawn on instead of the page's own canvas, if anything.
    _over: Option<Over>,
}

enum Means {
    Card(Box<Card>),
    Paper(Box<Paper>),
}

impl Renderer {
    /// A renderer on this canvas: by WebGPU where the browser has it and what it draws is seen, else by WebGL2 where a graphics card draws
    /// that, else by the processor.
    pub async fn new(canvas: HtmlCanvasElement) -> Result<Self, GpuError> {
        // A browser that has an adapter to tell of may have none when it is asked to draw, its process that draws having ended
        // meanwhile, or may draw what nobody sees.
        let mut failed = None;
        if wgpu::util::is_browser_webgpu_supported().await {
            match Card::seen(canvas.clone(), wgpu::Backends::BROWSER_WEBGPU).await {
                Ok(card) => return Ok(Self { means: Means::Card(Box::new(card)), _over: None }),
                Err(error) => failed = Some(error),
            }
        }
        if let Some(why) = without_card()
            && let Some(over) = Over::new(&canvas)
            && let Some(paper) = Paper::new(over.canvas(), why).await
        {
            return Ok(Self { means: Means::Paper(Box::new(paper)), _over: Some(over) });
        }
        let Some(error) = failed else { return Self::new_webgl(canvas).await };
        let over = Over::new(&canvas).ok_or(error)?;
        let card = Card::new(over.canvas().clone(), wgpu::Backends::GL).await?;
        Ok(Self { means: Means::Card(Box::new(card)), _over: Some(over) })
    }

    /// The same by WebGL2 whatever there is: for comparison, and for faulty drivers.
    pub async fn new_webgl(canvas: HtmlCanvasElement) -> Result<Self, GpuError> {
        Ok(Self { means: Means::Card(Box::new(Card::new(canvas, wgpu::Backends::GL).await?)), _over: None })
    }

    /// Interface in use.
    pub fn backend(&self) -> Backend {
        match &self.means {
            Means::Card(card) => card.backend(),
            Means::Paper(_) => Backend::Processor,
        }
    }

    /// What the browser calls its graphics adapter, or why there is none.
    pub fn adapter_name(&self) -> &str {
        match &self.means {
            Means::Card(card) => card.adapter_name(),
            Means::Paper(paper) => &paper.why,
        }
    }

    /// What the last frame cost.
    pub fn stats(&self) -> FrameStats {
        match &self.means {
            Means::Card(card) => card.stats(),
            Means::Paper(paper) => paper.stats,
        }
    }

    /// Fit the canvas to its size on the page (CSS pixels) and the device pixel ratio. Cheap when
    /// nothing changed, so it may be called before each frame.
    pub fn resize(&mut self, css_width: f64, css_height: f64, device_pixel_ratio: f64) {
        match &mut self.means {
            Means::Card(card) => card.resize(css_width, css_height, device_pixel_ratio),
            Means::Paper(paper) => paper.resize(css_width, css_height, device_pixel_ratio),
        }
    }

    /// Says where panels are, before [`Self::frame`] draws them; must all of them be drawn? By the processor what is not drawn anew stays.
    pub fn lay_out(&mut self, theme: &Theme, places: &[Rect]) -> bool {
        match &mut self.means {
            Means::Card(_) => true,
            Means::Paper(paper) => paper.lay_out(theme, places),
        }
    }

    /// Is a frame still being drawn? The next one is skipped until it is.
    pub fn is_busy(&self) -> bool {
        match &self.means {
            Means::Card(_) => false,
            Means::Paper(paper) => paper.is_busy(),
        }
    }

    /// Draw these panels on a canvas of the theme's page colour.
    pub fn frame(&mut self, theme: &Theme, panels: &[Panel<'_>]) -> FrameOutcome {
        match &mut self.means {
            Means::Card(card) => card.frame(theme, panels),
            Means::Paper(paper) => paper.frame(theme, panels),
        }
    }
}
