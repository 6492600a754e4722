//! Which Rust builds the page: the page is wasm, and not every machine's Rust can make it.
//!
//! Tried in this order, or forced with `PLUMBLINE_WASM=present|rustup|debian` (or `--wasm …`):
//! 1. *present*: the calling toolchain already has the `wasm32-unknown-unknown` standard library;
//! 2. *rustup*: `rustup target add` brings it;
//! 3. *debian*: Debian's `rustc-web cargo-web rust-web-src lld-19` with `-Zbuild-std`, installed when we are root.

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::ValueEnum;

use super::XtaskError;
use super::workspace::{apt_install, forget_cargo_run, may_install, on_path, output, run};

/// The target triple of the page.
pub const TARGET: &str = "wasm32-unknown-unknown";

const DEBIAN_PACKAGES: [&str; 4] = ["rustc-web", "cargo-web", "rust-web-src", "lld-19"];
/// The oldest Rust that builds this workspace.
const NEEDED: &str = env!("CARGO_PKG_RUST_VERSION");

const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_LINKER: &str = "wasm-ld-19";

/// A way to get a wasm toolchain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Source {
    /// The calling toolchain, as it is.
    Present,
    /// The calling toolchain, after `rustup target add`.
    Rustup,
    /// Debian's packages.
    Debian,
}

/// A cargo and rustc that can build the page.
#[derive(Debug, Clone)]
pub struct WasmToolchain {
    /// How it was found.
    pub source: Source,
    cargo: PathBuf,
    rustc: PathBuf,
    build_std: bool,
    linker: Option<PathBuf>,
}

impl WasmToolchain {
    /// Finds one, installing what is allowed; `forced` leaves no choice.
    pub fn choose(forced: Option<Source>) -> Result<Self, XtaskError> {
        let forced = match forced {
            Some(path) => Some(path),
            None => forced_by_environment()?,
        };
        match forced {
            Some(Source::Present) => present()?.ok_or_else(missing),
            Some(Source::Rustup) => rustup(),
            Some(Source::Debian) => debian(),
            None => {
                if let Some(found) = present()? {
                    return Ok(found);
                }
                rustup().or_else(|error| {
                    eprintln!("xtask: no wasm target from rustup ({error}); trying Debian's packages");
                    debian()
                })
            }
        }
    }

    /// `cargo build` for the page, free of what the calling cargo and its environment say about the native build.
    pub fn cargo_build(&self) -> Command {
        let mut cargo = Command::new(&self.cargo);
        forget_cargo_run(&mut cargo);
        for name in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS", "RUSTC_WRAPPER"] {
            cargo.env_remove(name);
        }
        cargo.env("RUSTC", &self.rustc).args(["build", "--locked", "--target", TARGET]);
        if self.build_std {
            cargo.env("RUSTC_BOOTSTRAP", "1").arg("-Zbuild-std=std,panic_abort");
        }
        if let Some(linker) = &self.linker {
            cargo.env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER", linker);
        }
        cargo
    }
}

fn forced_by_environment() -> Result<Option<Source>, XtaskError> {
    match std::env::var("PLUMBLINE_WASM") {
        Ok(value) if value.is_empty() => Ok(None),
        Ok(value) => Source::from_str(&value, true).map(Some).map_err(|_| {
            XtaskError::Other(format!("PLUMBLINE_WASM is `{value}`; it may be present, rustup or debian"))
        }),
        Err(_) => Ok(None),
    }
}

fn missing() -> XtaskError {
    XtaskError::Missing {
        what: format!("the Rust standard library for {TARGET}"),
        how: format!(
            "  rustup target add {TARGET}\nor, on Debian:\n  sudo apt-get install {}",
            DEBIAN_PACKAGES.join(" ")
        ),
    }
}

/// The compiler of the cargo that started us: beside it, or what `RUSTC` or the path say.
fn calling() -> (PathBuf, PathBuf) {
    let cargo = std::env::var_os("CARGO").map_or_else(|| PathBuf::from("cargo"), PathBuf::from);
    let beside = cargo.with_file_name("rustc");
    let rustc = match std::env::var_os("RUSTC") {
        Some(rustc) => PathBuf::from(rustc),
        None if beside.is_file() => beside,
        None => PathBuf::from("rustc"),
    };
    (cargo, rustc)
}

fn sysroot(rustc: &Path) -> Result<PathBuf, XtaskError> {
    Ok(PathBuf::from(output(Command::new(rustc).args(["--print", "sysroot"]))?.trim()))
}

fn has_wasm_std(sysroot: &Path) -> bool {
    let libraries = sysroot.join("lib/rustlib").join(TARGET).join("lib");
    std::fs::read_dir(libraries)
        .is_ok_and(|entries| entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with("libstd-")))
}

fn present() -> Result<Option<WasmToolchain>, XtaskError> {
    let (cargo, rustc) = calling();
    let sysroot = sysroot(&rustc)?;
    let bundled = std::fs::read_dir(sysroot.join("lib/rustlib"))
        .is_ok_and(|hosts| hosts.flatten().any(|host| host.path().join("bin/rust-lld").is_file()));
    let linker = if bundled {
        None
    } else {
        match ["rust-lld", "wasm-ld", DEBIAN_LINKER].into_iter().find_map(on_path) {
            Some(linker) => Some(linker),
            None => return Ok(None),
        }
    };
    let found = WasmToolchain { source: Source::Present, cargo, rustc, build_std: false, linker };
    Ok(has_wasm_std(&sysroot).then_some(found))
}

fn rustup() -> Result<WasmToolchain, XtaskError> {
    let rustup = on_path("rustup").ok_or_else(missing)?;
    let (_, rustc) = calling();
    let sysroot = sysroot(&rustc)?;
    // rustup names a toolchain by its folder; RUSTUP_TOOLCHAIN says the same when cargo came through rustup.
    let name = std::env::var("RUSTUP_TOOLCHAIN").ok().filter(|name| !name.is_empty());
    let name = name.or_else(|| sysroot.file_name().map(|name| name.to_string_lossy().into_owned()));
    let name = name.ok_or_else(|| XtaskError::Other(format!("no toolchain name in {}", sysroot.display())))?;
    run(Command::new(rustup).args(["target", "add", TARGET, "--toolchain", &name]))?;
    let found = present()?.ok_or_else(missing)?;
    Ok(WasmToolchain { source: Source::Rustup, ..found })
}

fn debian() -> Result<WasmToolchain, XtaskError> {
    let standard_library = Path::new("/usr/lib/rustlib/src/rust/library/std/Cargo.toml");
    let complete = || {
        let files = [DEBIAN_CARGO, DEBIAN_RUSTC].map(Path::new);
        files.iter().all(|file| file.exists()) && standard_library.exists() && on_path(DEBIAN_LINKER).is_some()
    };
    if !complete() {
        if !may_install() {
            return Err(missing());
        }
        apt_install(&DEBIAN_PACKAGES)?;
    }
    if !complete() {
        return Err(missing());
    }
    let told = output(Command::new(DEBIAN_RUSTC).arg("--version"))?;
    if version(&told) < version(NEEDED) {
        return Err(XtaskError::Missing {
            what: format!("a Rust {NEEDED} for the page (Debian's here is {})", told.trim()),
            how: format!("  rustup target add {TARGET}\nor a newer Debian's rustc-web"),
        });
    }
    let found = WasmToolchain {
        source: Source::Debian,
        cargo: DEBIAN_CARGO.into(),
        rustc: DEBIAN_RUSTC.into(),
        build_std: true,
        linker: on_path(DEBIAN_LINKER),
    };
    Ok(found)
}

/// Major and minor of the first word that is a version: `rustc 1.85.0 (…)`.
fn version(text: &str) -> Option<(u32, u32)> {
    text.split_whitespace().find_map(|word| {
        let mut numbers = word.split('.').map(|number| number.parse().ok());
        Some((numbers.next()??, numbers.next()??))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_by_number() {
        assert_eq!(version("rustc 1.85.0 (4d91de4e4 2025-02-17) (built from a source tarball)"), Some((1, 85)));
        assert!(version("rustc 1.100.0-nightly") > version(NEEDED) && version("1.9") < version("1.10.3"));
        assert_eq!(version("rustc"), None);
    }
}
