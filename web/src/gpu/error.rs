//! Why there is nothing to draw on.

/// Why the canvas cannot be used. The page falls back to numbers and keeps its controls.
#[derive(Debug, Clone, thiserror::Error)]
pub enum GpuError {
    /// Neither WebGPU nor WebGL2 gives a surface for the canvas.
    #[error("no graphics surface for the canvas: {0}")]
    Surface(String),
    /// A surface, but nothing that draws on it.
    #[error("no graphics adapter for the canvas: {0}")]
    Adapter(String),
    /// The adapter refused a device within WebGL2's limits.
    #[error("no graphics device: {0}")]
    Device(String),
    /// The surface offers no format to draw in.
    #[error("adapter {adapter:?} offers no format for the canvas")]
    Format {
        /// Name of the adapter.
        adapter: String,
    },
    /// Frames are drawn, and the canvas stays empty: some browsers have WebGPU and no way from there to their window.
    #[error("what adapter {adapter:?} draws does not reach the canvas")]
    Unseen {
        /// Name of the adapter.
        adapter: String,
    },
}
