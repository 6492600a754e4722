//! Pages without a vehicle: the benchmark of the charts (`/?bench`) and a gallery of everything the
//! canvas draws, from synthetic data (`/?gallery`, `/?gallery&dark`).
//!
//! The benchmark draws eight curves of 100 000 samples at 800×500, sliding and growing as in a
//! flight, and writes its figure as text into `#bench-frames-per-second` and as one JSON line into
//! `#bench-result`. It reads the pixels back: a frame counter alone also rises on a white canvas.

mod charts;
pub(crate) mod gallery;
mod pixels;
mod stage;

use stage::Stage;

/// Which of these pages the address asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Page {
    /// The benchmark.
    Charts,
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
    let page = if has("bench") {
        Page::Charts
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
                Page::Charts => charts::run(stage, renderer),
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
        assert_eq!(page_of("?bench"), Some((Page::Charts, false)));
        assert_eq!(page_of("?bench&webgl"), Some((Page::Charts, true)));
        assert_eq!(page_of("?gallery&dark"), Some((Page::Gallery { dark: true }, false)));
    }
}
