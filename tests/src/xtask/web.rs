//! `cargo xtask web`: the page's bundle in `web/dist`.
//!
//! wasm from a nested cargo, then `plumbline-bundler` (`tests/bundler`), which is built meanwhile: xtask itself has few
//! dependencies and starts at once.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;

use serde_json::json;

use super::progress::Progress;
use super::toolchain::{Source, WasmToolchain};
use super::workspace::output;
use super::{Workspace, XtaskError, test};

/// What the whole page may weigh on the wire, every file compressed.
pub const SIZE_LIMIT_BYTES: usize = 2_000_000;
/// The program that makes the bundle.
pub const BUNDLER: &str = "plumbline-bundler";

/// How to bundle.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Options {
    /// As `cargo xtask run` does it: little optimisation, no compression, no size limit.
    #[arg(long)]
    pub dev: bool,
    /// Where the wasm toolchain comes from; the default tries all in order. Same as PLUMBLINE_WASM.
    #[arg(long, value_name = "SOURCE")]
    pub wasm: Option<Source>,
}

/// Bundles the page, prints its size as one JSON line, and fails when it is too large.
///
/// # Errors
/// No toolchain, a build error, a placeholder that names nothing, or a page that is too large.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let bundler = bundler(workspace)?;
    weigh(workspace, options, || Ok(bundler))
}

/// [`run`] with a bundler that is there already, or is once the page is compiled.
pub fn weigh(
    workspace: &Workspace,
    options: &Options,
    bundler: impl FnOnce() -> Result<PathBuf, XtaskError>,
) -> Result<(), XtaskError> {
    let progress = Progress::new();
    let files = build(workspace, options, &progress, bundler)?;
    let total: usize = files.values().sum();
    let line = json!({
        "bench": "page", "name": "compressed_total", "value": total, "unit": "B", "limit": SIZE_LIMIT_BYTES,
        "profile": profile(options), "files": files, "built_s": (progress.seconds() * 10.0).round() / 10.0,
    });
    println!("{line}");
    if total > SIZE_LIMIT_BYTES && !options.dev {
        return Err(XtaskError::Other(format!("the page weighs {total} B compressed, above {SIZE_LIMIT_BYTES} B")));
    }
    Ok(())
}

fn profile(options: &Options) -> &'static str {
    if options.dev { "wasm-dev" } else { "wasm-release" }
}

/// Bundles the page, with a bundler that may still be in the making while the page is compiled: each file's bytes on the
/// wire by its name. The bundler does nothing when nothing changed; a page of the other profile is a change.
///
/// # Errors
/// No toolchain, a build error, or a placeholder that names nothing.
pub fn build(
    workspace: &Workspace,
    options: &Options,
    progress: &Progress,
    bundler: impl FnOnce() -> Result<PathBuf, XtaskError>,
) -> Result<BTreeMap<String, usize>, XtaskError> {
    let [app, worker] = compile(workspace, options, progress)?;
    let web = workspace.root.join("web");
    let mut bundle = Command::new(bundler()?);
    bundle
        .arg("--app")
        .arg(app)
        .arg("--worker")
        .arg(worker)
        .arg("--page")
        .arg(&web)
        .arg("--dist")
        .arg(web.join("dist"));
    bundle.arg("--work").arg(workspace.target.join("web")).args((!options.dev).then_some("--compress"));
    let answer = output(&mut bundle)?;
    serde_json::from_str(&answer).map_err(|error| XtaskError::Other(format!("{BUNDLER} answered {answer:?}: {error}")))
}

/// The program that makes the bundle, with compression; built with the features that the tests ask for, which build it again
/// otherwise.
///
/// # Errors
/// It could not be built.
pub fn bundler(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    let mut cargo = workspace.cargo();
    cargo.arg("build").args(test::EVERYTHING).args(["--bin", BUNDLER]);
    let [bundler] = built("bundler", &mut cargo, &Progress::new(), [BUNDLER], std::env::consts::EXE_EXTENSION)?;
    Ok(bundler)
}

/// The page's wasm and its worker's, built by the nested cargo in its own folder so that neither waits for the other's lock.
fn compile(workspace: &Workspace, options: &Options, progress: &Progress) -> Result<[PathBuf; 2], XtaskError> {
    let toolchain = WasmToolchain::choose(options.wasm)?;
    eprintln!("xtask: building the page ({}, wasm toolchain: {:?})", profile(options), toolchain.source);
    // One folder per toolchain kind: their artifacts cannot be shared.
    let folder = if toolchain.source == Source::Debian { "web/debian" } else { "web" };
    let mut cargo = toolchain.cargo_build();
    cargo.current_dir(&workspace.root).args(["--package", "plumbline-web", "--package", "plumbline-worker"]);
    cargo.args(["--lib", "--profile", profile(options)]);
    cargo.arg("--target-dir").arg(workspace.target.join(folder));
    built("page", &mut cargo, progress, ["plumbline_web", "plumbline_worker"], "wasm")
}

/// Builds, and finds the file of each of `targets` that ends so.
fn built<const N: usize>(
    name: &'static str,
    cargo: &mut Command,
    progress: &Progress,
    targets: [&str; N],
    extension: &str,
) -> Result<[PathBuf; N], XtaskError> {
    let mut found = [const { PathBuf::new() }; N];
    progress.build(name, cargo, |made, file| {
        if let Some(n) = targets.iter().position(|target| *target == made)
            && file.extension().unwrap_or_default() == extension
        {
            found[n] = file.to_owned();
        }
    })?;
    match targets.iter().zip(&found).find(|(_, file)| file.as_os_str().is_empty()) {
        Some((target, _)) => Err(XtaskError::Other(format!("cargo built no {target}"))),
        None => Ok(found),
    }
}
