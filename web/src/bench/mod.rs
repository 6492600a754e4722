//! Pages without a vehicle: the benchmark of the charts (`/?bench`) and a gallery of everything the
//! canvas draws, from synthetic data (`/?gallery`, `/?gallery&dark`).
//!
//! The benchmark draws eight curves of 100 000 samples (`/?bench&samples=1000000`: of so many) at 800×500, sliding and growing
//! as in a flight, and writes its figure as text into `#bench-frames-per-second` and as one JSON line into
//! `#bench-result`. It reads the pixels back: a frame counter alone also rises on a white canvas.

mod charts;
pub(crate) mod gallery;
mod stage;

use stage::Stage;

/// Of each curve of the benchmark, unless the address says otherwise.
const SAMPLES: usize = 100_000;

/// Which of these pages the address asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Page {
    /// The benchmark.
    Charts {
        /// Of each curve.
        samples: usize,
    },
    /// The gallery.
    Gallery {
        /// In dark colours.
        dark: bool,
    },
}

/// The page that this query (`?bench`, `?gallery&dark`) asks for, if any, and whether WebGL2 is to
/// be used even where there is WebGPU (`&webgl`).
pub fn page_of(query: &str) -> Option<(Page, bool)> {
    let words: Vec<&str> = query.trim_start_matches('?').split('&').collect();
    let has = |word: &str| words.contains(&word);
    let samples = words.iter().find_map(|word| word.strip_prefix("samples=")?.parse().ok());
    let page = if has("bench") {
        Page::Charts { samples: samples.unwrap_or(SAMPLES) }
    } else if has("gallery") {
        Page::Gallery { dark: has("dark") }
    } else {
        return None;
    };
    Some((page, has("webgl")))
}

/// Starts the page that the address asks for; `false` when it asks for the ordinary one.
pub fn start() -> bool {
    let query = web_sys::window().and_then(|window| window.location().search().ok()).unwrap_or_default();
    let Some((page, webgl)) = page_of(&query) else { return false };
    wasm_bindgen_futures::spawn_local(async move {
        let Some(stage) = Stage::new() else { return };
        match stage.renderer(webgl).await {
            Ok(renderer) => match page {
                Page::Charts { samples } => charts::run(stage, renderer, samples),
                Page::Gallery { dark } => gallery::run(stage, renderer, dark),
            },
            Err(error) => stage.say("bench-error", &error.to_string()),
        }
    });
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_these_queries_leave_the_ordinary_page() {
        assert_eq!(page_of(""), None);
        assert_eq!(page_of("?flight=bench"), None);
        assert_eq!(page_of("?bench"), Some((Page::Charts { samples: 100_000 }, false)));
        assert_eq!(page_of("?bench&samples=5000&webgl"), Some((Page::Charts { samples: 5000 }, true)));
        assert_eq!(page_of("?gallery&dark"), Some((Page::Gallery { dark: true }, false)));
    }
}
