//! Where the product's binaries are.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use crate::xtask::XtaskError;

/// The programs under test.
#[derive(Debug, Clone)]
pub struct Binaries {
    /// `plumbline-agent`.
    pub agent: PathBuf,
    /// `plumbline-ground`.
    pub ground: PathBuf,
    /// `plumbline-wires`.
    pub wires: PathBuf,
}

impl Binaries {
    /// In this folder, whether they are there yet or not.
    pub fn inside(folder: &Path) -> Self {
        let program = |name: &str| folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
        Self {
            agent: program("plumbline-agent"),
            ground: program("plumbline-ground"),
            wires: program("plumbline-wires"),
        }
    }

    /// Those that belong to the running program: in the folder that `PLUMBLINE_BINARIES` names, or beside it. Those of a
    /// test or a bench lie one folder higher, and are built first.
    ///
    /// # Errors
    /// The build failed.
    pub fn of_this_build() -> Result<Self, XtaskError> {
        if let Some(folder) = std::env::var_os("PLUMBLINE_BINARIES") {
            return Ok(Self::inside(Path::new(&folder)));
        }
        let program = std::env::current_exe().map_err(XtaskError::file("the running program"))?;
        let folder = program.parent().unwrap_or(Path::new("."));
        // Where cargo puts tests and benches.
        let Some(folder) = folder.parent().filter(|_| folder.ends_with("deps")) else {
            return Ok(Self::inside(folder));
        };
        static BUILT: OnceLock<bool> = OnceLock::new();
        if *BUILT.get_or_init(|| build(folder)) {
            Ok(Self::inside(folder))
        } else {
            Err(XtaskError::Other(format!("the binaries for {} could not be built", folder.display())))
        }
    }
}

/// Builds them in the profile whose folder this is.
fn build(folder: &Path) -> bool {
    let release = folder.file_name().is_some_and(|name| name == "release");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(Stdio::null()).stdout(Stdio::null());
    // The whole workspace, as the tests are built: fewer packages would ask other features of the libraries.
    cargo.args(["build", "--quiet", "--workspace", "--bin", "plumbline-ground", "--bin", "plumbline-agent"]);
    cargo.args(["--bin", "plumbline-wires"]);
    if release {
        cargo.arg("--release");
    }
    crate::xtask::forget_cargo_run(&mut cargo);
    cargo.status().is_ok_and(|status| status.success())
}
