//! `plumbline-bundler`: the page's bundle of its wasm. `cargo xtask` builds it beside the page and starts it.
//!
//! Bindings (wasm-bindgen as a library, no downloaded tools) → content-hashed names → `index.html` with those names →
//! brotli beside each file where asked. Every file beside `web/index.html` that a browser could
//! want (css, svg, png, ico, woff2, webmanifest) is an asset. A text asset names another by its placeholder:
//! `{{style.css}}`, `{{app.js}}` and `{{worker.js}}` become `/style-1f2e….css` and so on. Each script starts its wasm
//! itself: `<script type="module" src="{{app.js}}"></script>` is all that a page needs.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use serde_json::json;

const ASSETS: [&str; 7] = ["css", "ico", "js", "png", "svg", "webmanifest", "woff2"];
const COMPRESSED: [&str; 7] = ["css", "html", "js", "svg", "wasm", "webmanifest", "ico"];
/// What is made of a module: a script, and the module that it starts.
const PROGRAMS: [&str; 2] = ["app", "worker"];

/// Bundles the page; nothing is done when nothing changed. Its answer, on standard output: what each file takes on the wire, B.
#[derive(Debug, Parser)]
struct Arguments {
    /// The module of the page, as the compiler made it.
    #[arg(long, value_name = "FILE")]
    app: PathBuf,
    /// That of its worker.
    #[arg(long, value_name = "FILE")]
    worker: PathBuf,
    /// The page's `index.html` and what lies beside it.
    #[arg(long, value_name = "DIR")]
    page: PathBuf,
    /// Where the bundle goes.
    #[arg(long, value_name = "DIR")]
    dist: PathBuf,
    /// For what lies between, and what the last bundle was made from.
    #[arg(long, value_name = "DIR")]
    work: PathBuf,
    /// Brotli beside each file; the program must have been built with it.
    #[arg(long)]
    compress: bool,
}

/// Why there is no bundle.
#[derive(Debug, thiserror::Error)]
enum BundleError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: std::io::Error },
    /// wasm-bindgen refused the module.
    #[error("wasm-bindgen on {}: {reason}", wasm.display())]
    Bindings { wasm: PathBuf, reason: String },
    /// A text asset is not text.
    #[error("{file} is not UTF-8")]
    NotText { file: String },
    /// A placeholder names nothing.
    #[error("web/{file} names {{{{{asset}}}}}, which is no asset")]
    NoSuchAsset { file: String, asset: String },
    /// Scripts that the bundle would lack.
    #[error("{} has inline scripts: bundle them too", .0.display())]
    InlineScripts(PathBuf),
    /// Built without brotli.
    #[cfg(not(feature = "compress"))]
    #[error("built without the feature `compress`")]
    NoCompression,
}

impl BundleError {
    /// For `map_err` on file operations.
    fn file(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::File { path, source }
    }
}

fn main() -> ExitCode {
    match bundle(&Arguments::parse()) {
        Ok(sizes) => {
            println!("{}", json!(sizes));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("plumbline-bundler: {error}");
            ExitCode::FAILURE
        }
    }
}

fn bundle(arguments: &Arguments) -> Result<BTreeMap<String, usize>, BundleError> {
    let Arguments { app, worker, page, dist, work, compress } = arguments;
    let modules = [read(app)?, read(worker)?];
    let sources = page_sources(page)?;
    let stamp_file = work.join("bundle.json");
    let tool = (env!("CARGO_PKG_VERSION"), include_str!("main.rs"));
    let digest = hash_name(&(compress, tool, &modules, &sources));
    if let Some(sizes) = unchanged(&stamp_file, &digest, dist) {
        return Ok(sizes);
    }
    let bindings = work.join("bindings");
    let mut built = BTreeMap::new();
    for (program, wasm) in PROGRAMS.into_iter().zip([app, worker]) {
        built.extend(bind(program, wasm, &bindings.join(program))?);
    }
    let sizes = publish(name_and_link(built, sources)?, dist, *compress)?;
    write(&stamp_file, json!({ "digest": digest, "files": sizes }).to_string().as_bytes())?;
    Ok(sizes)
}

/// Asset name → content: `index.html` and what lies beside it.
fn page_sources(web: &Path) -> Result<BTreeMap<String, Vec<u8>>, BundleError> {
    let mut sources = BTreeMap::new();
    for entry in std::fs::read_dir(web).map_err(BundleError::file(web))?.flatten() {
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        if name == "index.html" || (path.is_file() && ASSETS.contains(&extension(&name))) {
            sources.insert(name, read(&path)?);
        }
    }
    if sources.contains_key("index.html") {
        Ok(sources)
    } else {
        Err(BundleError::file(web.join("index.html"))(std::io::ErrorKind::NotFound.into()))
    }
}

fn hash_name(content: &impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    content.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

/// The last bundle, if it was made from the same bytes and still lies there.
fn unchanged(stamp_file: &Path, digest: &str, dist: &Path) -> Option<BTreeMap<String, usize>> {
    let stamp: serde_json::Value = serde_json::from_slice(&std::fs::read(stamp_file).ok()?).ok()?;
    let sizes: BTreeMap<String, usize> = serde_json::from_value(stamp["files"].clone()).ok()?;
    let whole = stamp["digest"] == digest && sizes.keys().all(|name| dist.join(name).is_file());
    whole.then_some(sizes)
}

/// wasm-bindgen: the module without its descriptors, and the JavaScript that starts it.
fn bind(program: &str, wasm: &Path, folder: &Path) -> Result<BTreeMap<String, Vec<u8>>, BundleError> {
    let refused = |reason| BundleError::Bindings { wasm: wasm.to_owned(), reason: format!("{reason:#}") };
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(BundleError::file(folder))?;
    }
    let mut bindgen = wasm_bindgen_cli_support::Bindgen::new();
    bindgen
        .input_path(wasm)
        .out_name(program)
        .typescript(false)
        .remove_name_section(true)
        .remove_producers_section(true);
    bindgen.omit_default_module_path(true).web(true).map_err(refused)?.generate(folder).map_err(refused)?;
    let snippets = folder.join("snippets");
    if snippets.exists() {
        return Err(BundleError::InlineScripts(snippets));
    }
    let script = read(&folder.join(format!("{program}.js")))?;
    let module = read(&folder.join(format!("{program}_bg.wasm")))?;
    Ok(BTreeMap::from([(format!("{program}.js"), script), (format!("{program}.wasm"), module)]))
}

/// Gives every file its hashed name and writes those names into the placeholders of the others.
fn name_and_link(
    mut built: BTreeMap<String, Vec<u8>>,
    mut sources: BTreeMap<String, Vec<u8>>,
) -> Result<BTreeMap<String, Vec<u8>>, BundleError> {
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
    for program in PROGRAMS {
        let [script, module] = ["js", "wasm"].map(|extension| format!("{program}.{extension}"));
        if let (Some(mut text), Some(wasm)) = (built.remove(&script), built.remove(&module)) {
            let hashed = hashed_name(&module, &wasm);
            let start = format!("\n__wbg_init({{ module_or_path: new URL('{hashed}', import.meta.url) }});\n");
            text.extend_from_slice(start.as_bytes());
            add(&module, wasm, &mut names);
            add(&script, text, &mut names);
        }
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
fn link(file: &str, content: &[u8], names: &BTreeMap<String, String>) -> Result<Vec<u8>, BundleError> {
    let mut text = String::from_utf8(content.to_vec()).map_err(|_| BundleError::NotText { file: file.to_owned() })?;
    for (name, hashed) in names {
        text = text.replace(&format!("{{{{{name}}}}}"), &format!("/{hashed}"));
    }
    let unknown = text.split("{{").skip(1).filter_map(|rest| rest.split_once("}}")).map(|(name, _)| name);
    match unknown.into_iter().find(|name| !name.contains(['\n', ' '])) {
        Some(asset) => Err(BundleError::NoSuchAsset { file: file.to_owned(), asset: asset.to_owned() }),
        None => Ok(text.into_bytes()),
    }
}

/// Writes the new files, then the page that names them, then removes what nobody names: never a moment without a page.
fn publish(
    mut files: BTreeMap<String, Vec<u8>>,
    dist: &Path,
    compress: bool,
) -> Result<BTreeMap<String, usize>, BundleError> {
    std::fs::create_dir_all(dist).map_err(BundleError::file(dist))?;
    let index = files.remove_entry("index.html");
    let mut sizes = BTreeMap::new();
    let mut kept = Vec::new();
    for (name, content) in files.into_iter().chain(index) {
        write(&dist.join(&name), &content)?;
        let mut on_wire = content.len();
        if compress && COMPRESSED.contains(&extension(&name)) {
            let brotli = brotli(&content)?;
            on_wire = brotli.len();
            write(&dist.join(format!("{name}.br")), &brotli)?;
            kept.push(format!("{name}.br"));
        }
        kept.push(name.clone());
        sizes.insert(name, on_wire);
    }
    for entry in std::fs::read_dir(dist).map_err(BundleError::file(dist))?.flatten() {
        let old = !kept.contains(&entry.file_name().to_string_lossy().into_owned());
        if old && entry.path().is_file() {
            std::fs::remove_file(entry.path()).map_err(BundleError::file(entry.path()))?;
        }
    }
    Ok(sizes)
}

#[cfg(feature = "compress")]
fn brotli(content: &[u8]) -> Result<Vec<u8>, BundleError> {
    let parameters =
        brotli::enc::BrotliEncoderParams { quality: 11, lgwin: 22, size_hint: content.len(), ..Default::default() };
    let mut compressed = Vec::new();
    brotli::BrotliCompress(&mut &content[..], &mut compressed, &parameters).map_err(BundleError::file("brotli"))?;
    Ok(compressed)
}

#[cfg(not(feature = "compress"))]
fn brotli(_: &[u8]) -> Result<Vec<u8>, BundleError> {
    Err(BundleError::NoCompression)
}

fn read(path: &Path) -> Result<Vec<u8>, BundleError> {
    std::fs::read(path).map_err(BundleError::file(path))
}

/// Whole or not at all: a reader never sees half a file.
fn write(path: &Path, content: &[u8]) -> Result<(), BundleError> {
    let new = path.with_added_extension("new");
    std::fs::write(&new, content).map_err(BundleError::file(&new))?;
    std::fs::rename(&new, path).map_err(BundleError::file(path))
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
        let built = ["app", "worker"].into_iter().flat_map(|program| {
            [(format!("{program}.js"), b"//".to_vec()), (format!("{program}.wasm"), program.as_bytes().to_vec())]
        });
        let sources = BTreeMap::from([
            ("index.html".to_owned(), b"{{style.css}} {{app.js}} {{worker.js}}".to_vec()),
            ("style.css".to_owned(), b"url({{logo.svg}})".to_vec()),
            ("logo.svg".to_owned(), b"<svg/>".to_vec()),
        ]);
        let files = name_and_link(built.collect(), sources).unwrap();
        let name = |start: &str| files.keys().find(|name| name.starts_with(start)).unwrap().clone();
        let script =
            |start: &str| files.keys().find(|name| name.starts_with(start) && name.ends_with(".js")).unwrap().clone();
        let text = |name: &str| String::from_utf8(files[name].clone()).unwrap();
        assert_eq!(text("index.html"), format!("/{} /{} /{}", name("style-"), script("app-"), script("worker-")));
        assert_eq!(text(&name("style-")), format!("url(/{})", name("logo-")));
        for program in ["app-", "worker-"] {
            let module = files.keys().find(|name| name.starts_with(program) && name.ends_with(".wasm")).unwrap();
            assert!(text(&script(program)).contains(&format!("new URL('{module}', import.meta.url)")));
        }
    }
}
