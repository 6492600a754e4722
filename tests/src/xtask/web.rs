//! `cargo xtask web`: the page's bundle in `web/dist`.
//!
//! wasm from a nested cargo → bindings (wasm-bindgen as a library, no downloaded tools) → content-hashed names →
//! `index.html` with those names → brotli beside each file. Every file beside `web/index.html` that a browser could
//! want (css, svg, png, ico, woff2, webmanifest) is an asset. A text asset names another by its placeholder:
//! `{{style.css}}`, `{{app.js}}` and `{{app.wasm}}` become `/style-1f2e….css` and so on. `app.js` starts the wasm
//! itself: `<script type="module" src="{{app.js}}"></script>` is all that a page needs.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Instant;

use serde_json::json;

use super::toolchain::{Source, WasmToolchain};
use super::workspace::output;
use super::{Workspace, XtaskError};

/// What the whole page may weigh on the wire, every file compressed.
pub const SIZE_LIMIT_BYTES: usize = 2_000_000;

const ASSETS: [&str; 7] = ["css", "ico", "js", "png", "svg", "webmanifest", "woff2"];
const COMPRESSED: [&str; 7] = ["css", "html", "js", "svg", "wasm", "webmanifest", "ico"];
const JS: &str = "app.js";
const WASM: &str = "app.wasm";

/// How to bundle.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Options {
    /// Quick build for the edit–reload loop: little optimisation, light compression, no size limit.
    #[arg(long)]
    pub dev: bool,
    /// Where the wasm toolchain comes from; the default tries all in order. Same as PLUMBLINE_WASM.
    #[arg(long, value_name = "SOURCE")]
    pub wasm: Option<Source>,
}

/// The finished bundle.
#[derive(Debug)]
pub struct Bundle {
    /// Bytes on the wire by file name.
    pub compressed: BTreeMap<String, usize>,
}

impl Bundle {
    /// Bytes on the wire of the whole page.
    pub fn total(&self) -> usize {
        self.compressed.values().sum()
    }
}

/// Bundles the page, prints its size as one JSON line, and fails when it is too large.
pub fn run(workspace: &Workspace, options: &Options) -> Result<Bundle, XtaskError> {
    let started = Instant::now();
    let bundle = build(workspace, options)?;
    let total = bundle.total();
    let line = json!({
        "bench": "page", "name": "compressed_total", "value": total, "unit": "B", "limit": SIZE_LIMIT_BYTES,
        "profile": profile(options), "files": bundle.compressed, "built_s": round(started.elapsed().as_secs_f64()),
    });
    println!("{line}");
    if total > SIZE_LIMIT_BYTES && !options.dev {
        return Err(XtaskError::Other(format!("the page weighs {total} B compressed, above {SIZE_LIMIT_BYTES} B")));
    }
    Ok(bundle)
}

fn round(seconds: f64) -> f64 {
    (seconds * 10.0).round() / 10.0
}

fn profile(options: &Options) -> &'static str {
    if options.dev { "wasm-dev" } else { "wasm-release" }
}

/// Bundles the page; nothing is done when nothing changed.
///
/// # Errors
/// No toolchain, a build error, or a placeholder that names nothing.
pub fn build(workspace: &Workspace, options: &Options) -> Result<Bundle, XtaskError> {
    let wasm = compile(workspace, options)?;
    let module = read(&wasm)?;
    let sources = page_sources(&workspace.root.join("web"))?;
    let dist = workspace.root.join("web/dist");
    let stamp_file = workspace.target.join("web/bundle.json");
    let digest = digest(options, &module, &sources);
    if let Some(bundle) = unchanged(&stamp_file, &digest, &dist) {
        return Ok(bundle);
    }
    eprintln!("xtask: bundling {}", dist.display());
    let bindings = workspace.target.join("web/bindings");
    let built = bind(&wasm, &bindings)?;
    let files = name_and_link(built, sources)?;
    let bundle = publish(files, &bindings.join("snippets"), &dist, options)?;
    let stamp = json!({ "digest": digest, "files": bundle.compressed });
    write(&stamp_file, stamp.to_string().as_bytes())?;
    Ok(bundle)
}

/// The page's wasm, built by the nested cargo in its own folder so that neither waits for the other's lock.
fn compile(workspace: &Workspace, options: &Options) -> Result<PathBuf, XtaskError> {
    let toolchain = WasmToolchain::choose(options.wasm)?;
    eprintln!("xtask: building the page ({}, wasm toolchain: {:?})", profile(options), toolchain.source);
    // One folder per toolchain kind: their artifacts cannot be shared.
    let folder = if toolchain.source == Source::Debian { "web/debian" } else { "web" };
    let mut cargo = toolchain.cargo_build();
    cargo.current_dir(&workspace.root).args(["--package", "plumbline-web", "--lib", "--profile", profile(options)]);
    cargo.arg("--target-dir").arg(workspace.target.join(folder)).args(["--message-format", "json-render-diagnostics"]);
    let messages = output(cargo.stdin(Stdio::null()))?;
    let artifacts = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    artifacts
        .filter(|message| message["target"]["name"] == "plumbline_web")
        .filter_map(|message| message["filenames"].as_array().cloned())
        .flatten()
        .filter_map(|name| name.as_str().map(PathBuf::from))
        .find(|file| file.extension().is_some_and(|extension| extension == "wasm"))
        .ok_or_else(|| XtaskError::Other("cargo built no plumbline_web.wasm".into()))
}

/// Asset name → content: `index.html` and what lies beside it.
fn page_sources(web: &Path) -> Result<BTreeMap<String, Vec<u8>>, XtaskError> {
    let mut sources = BTreeMap::new();
    for entry in std::fs::read_dir(web).map_err(XtaskError::file(web))?.flatten() {
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        if name == "index.html" || (path.is_file() && ASSETS.contains(&extension(&name))) {
            sources.insert(name, read(&path)?);
        }
    }
    if sources.contains_key("index.html") {
        Ok(sources)
    } else {
        Err(XtaskError::Other(format!("{} is missing", web.join("index.html").display())))
    }
}

fn digest(options: &Options, module: &[u8], sources: &BTreeMap<String, Vec<u8>>) -> String {
    let tool = (env!("CARGO_PKG_VERSION"), include_str!("web.rs"));
    hash_name(&(profile(options), tool, module, sources))
}

fn hash_name(content: &impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    content.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

/// The last bundle, if it was made from the same bytes and still lies there.
fn unchanged(stamp_file: &Path, digest: &str, dist: &Path) -> Option<Bundle> {
    let stamp: serde_json::Value = serde_json::from_slice(&std::fs::read(stamp_file).ok()?).ok()?;
    let compressed: BTreeMap<String, usize> = serde_json::from_value(stamp["files"].clone()).ok()?;
    let whole = stamp["digest"] == digest && compressed.keys().all(|name| dist.join(name).is_file());
    whole.then_some(Bundle { compressed })
}

/// wasm-bindgen: the module without its descriptors, and the JavaScript that starts it.
fn bind(wasm: &Path, folder: &Path) -> Result<BTreeMap<String, Vec<u8>>, XtaskError> {
    let other = |error| XtaskError::Other(format!("wasm-bindgen on {}: {error:#}", wasm.display()));
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(XtaskError::file(folder))?;
    }
    let mut bindgen = wasm_bindgen_cli_support::Bindgen::new();
    bindgen.input_path(wasm).out_name("app").typescript(false).remove_name_section(true).remove_producers_section(true);
    bindgen.omit_default_module_path(true).web(true).map_err(other)?.generate(folder).map_err(other)?;
    let js = read(&folder.join("app.js"))?;
    let module = read(&folder.join("app_bg.wasm"))?;
    Ok(BTreeMap::from([(JS.to_owned(), js), (WASM.to_owned(), module)]))
}

/// Gives every file its hashed name and writes those names into the placeholders of the others.
fn name_and_link(
    mut built: BTreeMap<String, Vec<u8>>,
    mut sources: BTreeMap<String, Vec<u8>>,
) -> Result<BTreeMap<String, Vec<u8>>, XtaskError> {
    let mut files = BTreeMap::new();
    let mut names = BTreeMap::new();
    let mut add = |name: &str, content: Vec<u8>, names: &mut BTreeMap<String, String>| {
        let hashed = hashed_name(name, &content);
        names.insert(name.to_owned(), hashed.clone());
        files.insert(hashed, content);
    };
    let index = sources.remove("index.html").unwrap_or_default();
    // Who is named before who names: images and fonts, then css, then the module, its script, and the page.
    let (sheets, leaves): (BTreeMap<_, _>, BTreeMap<_, _>) = sources.into_iter().partition(|(n, _)| is_text(n));
    for (name, content) in leaves {
        add(&name, content, &mut names);
    }
    for (name, content) in sheets {
        let linked = link(&name, &content, &names)?;
        add(&name, linked, &mut names);
    }
    if let Some(module) = built.remove(WASM) {
        add(WASM, module, &mut names);
    }
    if let Some(mut script) = built.remove(JS) {
        let module = names.get(WASM).cloned().unwrap_or_default();
        let start = format!("\n__wbg_init({{ module_or_path: new URL('{module}', import.meta.url) }});\n");
        script.extend_from_slice(start.as_bytes());
        add(JS, script, &mut names);
    }
    files.insert("index.html".to_owned(), link("index.html", &index, &names)?);
    Ok(files)
}

fn extension(name: &str) -> &str {
    name.rsplit_once('.').map_or("", |(_, extension)| extension)
}

fn is_text(name: &str) -> bool {
    matches!(extension(name), "css" | "js" | "webmanifest")
}

fn hashed_name(name: &str, content: &[u8]) -> String {
    let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
    format!("{stem}-{}.{extension}", hash_name(&content))
}

/// Replaces `{{name}}` by `/hashed-name`; a placeholder that names nothing is an error.
fn link(file: &str, content: &[u8], names: &BTreeMap<String, String>) -> Result<Vec<u8>, XtaskError> {
    let mut text =
        String::from_utf8(content.to_vec()).map_err(|_| XtaskError::Other(format!("{file} is not UTF-8")))?;
    for (name, hashed) in names {
        text = text.replace(&format!("{{{{{name}}}}}"), &format!("/{hashed}"));
    }
    let unknown = text.split("{{").skip(1).filter_map(|rest| rest.split_once("}}")).map(|(name, _)| name);
    match unknown.into_iter().find(|name| !name.contains(['\n', ' '])) {
        Some(name) => Err(XtaskError::Other(format!("web/{file} names {{{{{name}}}}}, which is no asset"))),
        None => Ok(text.into_bytes()),
    }
}

/// Writes the new files, then the page that names them, then removes what nobody names: never a moment without a page.
fn publish(
    mut files: BTreeMap<String, Vec<u8>>,
    snippets: &Path,
    dist: &Path,
    options: &Options,
) -> Result<Bundle, XtaskError> {
    std::fs::create_dir_all(dist).map_err(XtaskError::file(dist))?;
    let index = files.remove_entry("index.html");
    let mut compressed = BTreeMap::new();
    let mut kept = Vec::new();
    for (name, content) in files.into_iter().chain(index) {
        write(&dist.join(&name), &content)?;
        let mut on_wire = content.len();
        if COMPRESSED.contains(&extension(&name)) {
            let brotli = brotli(&content, options)?;
            on_wire = brotli.len();
            write(&dist.join(format!("{name}.br")), &brotli)?;
            kept.push(format!("{name}.br"));
        }
        kept.push(name.clone());
        compressed.insert(name, on_wire);
    }
    if snippets.exists() {
        return Err(XtaskError::Other(format!("{} has inline scripts: bundle them too", snippets.display())));
    }
    for entry in std::fs::read_dir(dist).map_err(XtaskError::file(dist))?.flatten() {
        let old = !kept.contains(&entry.file_name().to_string_lossy().into_owned());
        if old && entry.path().is_file() {
            std::fs::remove_file(entry.path()).map_err(XtaskError::file(entry.path()))?;
        }
    }
    Ok(Bundle { compressed })
}

fn brotli(content: &[u8], options: &Options) -> Result<Vec<u8>, XtaskError> {
    let quality = if options.dev { 4 } else { 11 };
    let parameters =
        brotli::enc::BrotliEncoderParams { quality, lgwin: 22, size_hint: content.len(), ..Default::default() };
    let mut compressed = Vec::new();
    brotli::BrotliCompress(&mut &content[..], &mut compressed, &parameters).map_err(XtaskError::file("brotli"))?;
    Ok(compressed)
}

fn read(path: &Path) -> Result<Vec<u8>, XtaskError> {
    std::fs::read(path).map_err(XtaskError::file(path))
}

/// Whole or not at all: a reader never sees half a file.
fn write(path: &Path, content: &[u8]) -> Result<(), XtaskError> {
    let new = path.with_added_extension("new");
    std::fs::write(&new, content).map_err(XtaskError::file(&new))?;
    std::fs::rename(&new, path).map_err(XtaskError::file(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_placeholder_becomes_the_hashed_name_and_an_unknown_one_is_refused() {
        let names = BTreeMap::from([("style.css".to_owned(), "style-0f.css".to_owned())]);
        let linked = link("index.html", b"<link href=\"{{style.css}}\">", &names).unwrap();
        assert_eq!(linked, b"<link href=\"/style-0f.css\">");
        let error = link("index.html", b"<img src=\"{{logo.svg}}\">", &names).unwrap_err().to_string();
        assert!(error.contains("logo.svg"), "{error}");
    }

    #[test]
    fn the_page_names_every_file_by_its_content() {
        let built = BTreeMap::from([(WASM.to_owned(), b"\0asm".to_vec()), (JS.to_owned(), b"//".to_vec())]);
        let sources = BTreeMap::from([
            ("index.html".to_owned(), b"{{style.css}} {{app.js}}".to_vec()),
            ("style.css".to_owned(), b"url({{logo.svg}})".to_vec()),
            ("logo.svg".to_owned(), b"<svg/>".to_vec()),
        ]);
        let files = name_and_link(built, sources).unwrap();
        let name = |start: &str| files.keys().find(|name| name.starts_with(start)).unwrap().clone();
        let text = |name: &str| String::from_utf8(files[name].clone()).unwrap();
        assert_eq!(text("index.html"), format!("/{} /{}", name("style-"), name("app-")));
        assert_eq!(text(&name("style-")), format!("url(/{})", name("logo-")));
        let script = files.iter().find(|(name, _)| name.ends_with(".js")).unwrap().1;
        let module = files.keys().find(|name| name.ends_with(".wasm")).unwrap();
        assert!(String::from_utf8_lossy(script).contains(&format!("new URL('{module}', import.meta.url)")));
    }
}
