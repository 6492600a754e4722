//! Where things are, and how programs are started.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

use super::XtaskError;

/// The checkout that xtask was built from, and its build folder.
#[derive(Debug, Clone)]
pub struct Workspace {
    /// Folder of the top `Cargo.toml`.
    pub root: PathBuf,
    /// Build folder: `CARGO_TARGET_DIR`, or `target` in the root.
    pub target: PathBuf,
}

impl Workspace {
    /// The workspace of this xtask. The folder known at build time is right unless the checkout has moved since.
    pub fn find() -> Result<Self, XtaskError> {
        let manifest = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
        let built_at = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
        let root = manifest
            .into_iter()
            .chain([built_at])
            .filter_map(|folder| folder.parent().map(Path::to_path_buf))
            .find(|root| root.join("proto/schema").is_dir())
            .ok_or_else(|| XtaskError::Other("this is no Plumbline checkout; start it as `cargo xtask`".into()))?;
        let target = match std::env::var_os("CARGO_TARGET_DIR") {
            Some(folder) => root.join(folder),
            None => root.join("target"),
        };
        Ok(Self { root, target })
    }

    /// The cargo that started xtask, working in this workspace.
    pub fn cargo(&self) -> Command {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.current_dir(&self.root);
        // What `cargo run` sets for xtask itself would make the same crates look changed to the nested cargo.
        forget_cargo_run(&mut cargo);
        cargo
    }

    /// Free space of the disk that holds the build folder, as `df` tells it.
    pub fn free_bytes(&self) -> Option<u64> {
        let told = Command::new("df").args(["--output=avail", "--block-size=1"]).arg(&self.target).output().ok()?;
        String::from_utf8_lossy(&told.stdout).lines().last()?.trim().parse().ok()
    }
}

/// Removes what `cargo run` tells its child about the package it runs.
pub fn forget_cargo_run(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        let told = name.to_str().is_some_and(|name| {
            name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_") || name == "CARGO_PRIMARY_PACKAGE"
        });
        if told {
            command.env_remove(name);
        }
    }
}

/// The command as one would type it, for messages.
pub fn command_line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

/// Runs to the end with our own terminal; anything but success is an error.
pub fn run(command: &mut Command) -> Result<(), XtaskError> {
    let status = command.status().map_err(|source| XtaskError::Start { command: command_line(command), source })?;
    if status.success() { Ok(()) } else { Err(XtaskError::Failed { command: command_line(command), status }) }
}

/// Runs to the end and returns what it wrote to its standard output; its standard error is ours.
pub fn output(command: &mut Command) -> Result<String, XtaskError> {
    let ran = command
        .stderr(Stdio::inherit())
        .output()
        .map_err(|source| XtaskError::Start { command: command_line(command), source })?;
    if ran.status.success() {
        Ok(String::from_utf8_lossy(&ran.stdout).into_owned())
    } else {
        Err(XtaskError::Failed { command: command_line(command), status: ran.status })
    }
}

/// What it starts takes only what everybody else leaves of the processors.
pub fn idle(command: &mut Command) -> &mut Command {
    use std::os::unix::process::CommandExt as _;
    // SAFETY: between fork and exec there is one system call, with plain numbers and a structure of its own; where the kernel refuses, it
    // takes its share as everybody does.
    unsafe {
        command.pre_exec(|| {
            let none = libc::sched_param { sched_priority: 0 };
            libc::sched_setscheduler(0, libc::SCHED_IDLE, &none);
            Ok(())
        })
    }
}

/// Whether a program of that name is on the path.
pub fn on_path(program: &str) -> Option<PathBuf> {
    std::env::split_paths(&std::env::var_os("PATH")?).map(|folder| folder.join(program)).find(|file| file.is_file())
}

/// Whether we may install system packages: root, on a system with apt.
pub fn may_install() -> bool {
    // SAFETY: geteuid reads a number of this process and cannot fail.
    let root = unsafe { libc::geteuid() } == 0;
    root && on_path("apt-get").is_some()
}

/// dpkg lets one at a time in and turns the others away; what is built and what is fetched beside it may both want something.
static APT: Mutex<()> = Mutex::new(());

/// Installs Debian packages. Only after [`may_install`].
pub fn apt_install(packages: &[&str]) -> Result<(), XtaskError> {
    let _alone = APT.lock().unwrap_or_else(PoisonError::into_inner);
    eprintln!("xtask: installing {} with apt-get", packages.join(" "));
    let apt = || {
        let mut apt = Command::new("apt-get");
        apt.env("DEBIAN_FRONTEND", "noninteractive").stdout(Stdio::null());
        apt
    };
    let install = || {
        let mut install = apt();
        install.args(["install", "--yes", "--no-install-recommends", "--quiet"]).args(packages);
        install
    };
    // The package lists may be absent or old: refresh them only when the first try fails.
    if run(install().stderr(Stdio::null())).is_ok() {
        return Ok(());
    }
    run(apt().args(["update", "--quiet"]))?;
    run(&mut install())
}
