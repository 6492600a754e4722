//! Programs that are not Rust: found, or installed where that is allowed, or named.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

use super::workspace::{apt_install, may_install, on_path, output, run};
use super::{Workspace, XtaskError};

/// What the browser scripts are written for: what drives any recent Chromium, the reader of flight files, the client of the
/// live link and the schemas that Foxglove has, and the checker of accessibility.
const NODE_PACKAGES: [&str; 7] = [
    "playwright-core@1.56.1",
    "@mcap/core@2.2.2",
    "fzstd@0.1.1",
    "@foxglove/ws-protocol@0.8.0",
    "@foxglove/schemas@2.1.0",
    "ws@8.18.3",
    "axe-core@4.14.1",
];
/// Third-party readers of our flight files, of the results of experiments, of PX4's logs and of what devices send, MAVLink
/// ground control stations, and a double of S3-compatible storage.
const READERS: PythonTools = PythonTools {
    folder: "python",
    module: "mcap.reader, scipy.io, duckdb, polars, rosbags.highlevel, pyulog, pymavlink.mavutil, MAVProxy, mavsdk, boto3, moto.server, flask, pyubx2, natnet.data_frame, hokuyolx",
    packages: &[
        "mcap>=1.2",
        "mcap-protobuf-support>=0.5",
        "scipy>=1.11",
        "duckdb>=1.0",
        "polars>=1.0",
        "rosbags>=0.11",
        "pyulog>=1.2",
        "pymavlink>=2.4.41",
        "pyserial>=3.5",
        "mavsdk>=4.1",
        "moto[s3,server]>=5.0",
        "pyubx2>=1.2",
        "natnet>=0.3",
        "hokuyolx>=0.9",
    ],
    // With what it asks for it takes 1.2 GB, of which its command line needs nothing.
    bare: &["MAVProxy>=1.8.70"],
};
/// The peer of `bench estimate`.
const FILTERPY: PythonTools =
    PythonTools { folder: "filterpy", module: "filterpy.kalman", packages: &["filterpy", "numpy", "scipy"], bare: &[] };
/// The peers of `bench control`.
const SLYCOT: PythonTools = PythonTools {
    folder: "slycot",
    module: "scipy.linalg, slycot",
    packages: &["numpy", "scipy", "slycot"],
    bare: &[],
};

/// A linker and a C compiler for every architecture and libc.
const ZIG: PythonTools = PythonTools {
    folder: "zig",
    module: "ziglang",
    packages: &["ziglang==0.17.1", "cargo-zigbuild==0.24.1"],
    bare: &[],
};

/// Packages in a Python environment of their own.
struct PythonTools {
    /// Under `target/tools`.
    folder: &'static str,
    /// Can be imported when they are there.
    module: &'static str,
    packages: &'static [&'static str],
    /// Installed without what they depend on.
    bare: &'static [&'static str],
}

/// Has all that the tests want, so that it is there when they do: mostly others are waited for, and a compiler has the time. What cannot
/// be had is told by whoever wants it.
pub fn fetch(workspace: &Workspace, with_browser: bool) {
    let _ = python(workspace);
    let _ = plumbline(workspace);
    for tool in [nats_server, postgres, faketime, promtool] {
        let _ = tool(workspace);
    }
    let _ = octave();
    if with_browser {
        let _ = browser(workspace);
    }
}

/// Runs quietly and says whether it worked.
fn works(command: &mut Command) -> bool {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// The first of `programs` on the path, installing `package` if none is.
fn program(programs: &[&str], package: &str) -> Result<PathBuf, XtaskError> {
    let find = || programs.iter().find_map(|program| on_path(program));
    if let Some(found) = find() {
        return Ok(found);
    }
    let missing =
        || XtaskError::Missing { what: programs.join(" or "), how: format!("  sudo apt-get install {package}") };
    if !may_install() {
        return Err(missing());
    }
    apt_install(&[package])?;
    find().ok_or_else(missing)
}

/// rustfmt and clippy of the calling toolchain.
///
/// # Errors
/// What is missing and how to get it.
pub fn rust_components(workspace: &Workspace) -> Result<(), XtaskError> {
    for (subcommand, component) in [("fmt", "rustfmt"), ("clippy", "clippy")] {
        let present = || works(workspace.cargo().args([subcommand, "--version"]));
        if !present() {
            let _ = run(Command::new("rustup").args(["component", "add", component]));
        }
        if !present() {
            let how = format!("  rustup component add {component}");
            return Err(XtaskError::Missing { what: component.into(), how });
        }
    }
    Ok(())
}

/// A Python that can read MCAP, and the tables made of it.
///
/// # Errors
/// What is missing and how to get it.
pub fn python(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    python_with(workspace, &READERS)
}

/// A Python with filterpy.
///
/// # Errors
/// What is missing and how to get it.
pub fn filterpy(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    python_with(workspace, &FILTERPY)
}

/// A Python with scipy and slycot.
///
/// # Errors
/// What is missing and how to get it.
pub fn slycot(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    python_with(workspace, &SLYCOT)
}

/// The folder of `cargo-zigbuild`, and of a Python that has its zig.
///
/// # Errors
/// What is missing and how to get it.
pub fn zig(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    let python = python_with(workspace, &ZIG)?;
    let missing =
        || XtaskError::Missing { what: "cargo-zigbuild".into(), how: "  pip install cargo-zigbuild ziglang".into() };
    python.parent().map(Path::to_owned).filter(|folder| folder.join("cargo-zigbuild").is_file()).ok_or_else(missing)
}

/// qemu that runs programs of `cpu`, and the libc that they need, of Debian's `architecture`.
///
/// # Errors
/// What is missing and how to get it.
pub fn emulator(cpu: &str, architecture: &str) -> Result<String, XtaskError> {
    let qemu = program(&[&format!("qemu-{cpu}-static"), &format!("qemu-{cpu}")], "qemu-user-static")?;
    let (libc, libgcc) = (format!("libc6-{architecture}-cross"), format!("libgcc-s1-{architecture}-cross"));
    let installed = |package: &str| Path::new(&format!("/usr/share/doc/{package}")).is_dir();
    if !(installed(&libc) && installed(&libgcc)) {
        if !may_install() {
            let how = format!("  sudo apt-get install {libc} {libgcc}");
            return Err(XtaskError::Missing { what: format!("a libc of {architecture}"), how });
        }
        apt_install(&[&libc, &libgcc])?;
    }
    Ok(qemu.to_string_lossy().into_owned())
}

/// A Python with what `tests/python/requirements.txt` pins.
///
/// # Errors
/// What is missing and how to get it.
pub fn plumbline(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    let pins = workspace.root.join("tests/python/requirements.txt");
    let wanted = std::fs::read(&pins).map_err(XtaskError::file(&pins))?;
    let folder = workspace.target.join("tools/plumbline");
    let (own, installed) = (folder.join("bin/python"), folder.join("installed.txt"));
    if std::fs::read(&installed).ok().as_ref() != Some(&wanted) {
        let system = program(&["python3"], "python3")?;
        eprintln!("xtask: a Python environment as {} says in {}", pins.display(), folder.display());
        environment(&system, &folder)?;
        run(Command::new(&own).args(["-m", "pip", "install", "--quiet", "--requirement"]).arg(&pins))?;
        std::fs::write(&installed, wanted).map_err(XtaskError::file(&installed))?;
    }
    Ok(own)
}

/// `promtool`, of Debian's package of Prometheus.
///
/// # Errors
/// What is missing and how to get it.
pub fn promtool(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    taken_out(workspace, "prometheus", "usr/bin/promtool")
}

/// Octave without its windows; with what it needs it takes 263 MB.
///
/// # Errors
/// What is missing and how to get it.
pub fn octave() -> Result<PathBuf, XtaskError> {
    program(&["octave-cli"], "octave")
}

/// `nats-server`, of the Debian package of that name.
///
/// # Errors
/// What is missing and how to get it.
pub fn nats_server(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    taken_out(workspace, "nats-server", "usr/sbin/nats-server")
}

/// The library by which a program sees another time, of Debian's `libfaketime`.
///
/// # Errors
/// What is missing and how to get it.
pub fn faketime(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    let library = format!("usr/lib/{}-linux-gnu/faketime/libfaketime.so.1", std::env::consts::ARCH);
    let installed = Path::new("/").join(&library);
    if installed.is_file() { Ok(installed) } else { taken_out(workspace, "libfaketime", &library) }
}

/// The folder of PostgreSQL's programs, of Debian's packages.
///
/// # Errors
/// What is missing and how to get it.
pub fn postgres(workspace: &Workspace) -> Result<PathBuf, XtaskError> {
    let here =
        |folder: &PathBuf| ["initdb", "postgres"].iter().all(|p| works(Command::new(folder.join(p)).arg("--version")));
    let installed = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    if let Some(found) = installed.map(|version| version.path().join("bin")).find(here) {
        return Ok(found);
    }
    let missing = || XtaskError::Missing { what: "PostgreSQL".into(), how: "  sudo apt-get install postgresql".into() };
    // The package of that name is empty and needs the one of the version that Debian has.
    let depends = output(Command::new("apt-cache").args(["depends", "postgresql"])).unwrap_or_default();
    let version =
        depends.lines().find_map(|line| line.trim().strip_prefix("Depends: postgresql-")?.parse::<u32>().ok());
    let version = version.ok_or_else(missing)?;
    let program = format!("usr/lib/postgresql/{version}/bin/postgres");
    let own = taken_out(workspace, &format!("postgresql-{version}"), &program)?;
    let own = own.parent().map(Path::to_owned).ok_or_else(missing)?;
    // Taken out, it lacks the libraries that a bare machine has not.
    if !here(&own) && may_install() {
        apt_install(&["libpq5", "libxml2"])?;
    }
    Some(own).filter(here).ok_or_else(missing)
}

/// A program of a Debian package, which is not installed: it would start a server.
fn taken_out(workspace: &Workspace, package: &str, program: &str) -> Result<PathBuf, XtaskError> {
    let folder = workspace.target.join("tools").join(package);
    let own = folder.join(program);
    let name = program.rsplit('/').next().unwrap_or(program);
    if let Some(found) = on_path(name).or_else(|| own.is_file().then(|| own.clone())) {
        return Ok(found);
    }
    let how = format!("  sudo apt-get install {package}");
    let missing = || XtaskError::Missing { what: name.into(), how };
    std::fs::create_dir_all(&folder).map_err(XtaskError::file(&folder))?;
    let take_out = format!("apt-get -qq download {package} && dpkg-deb -x {package}_*.deb . && rm {package}_*.deb");
    let taken = works(Command::new("sh").args(["-c", &take_out]).current_dir(&folder));
    (taken && own.is_file()).then_some(own).ok_or_else(missing)
}

/// An empty Python environment in `folder`.
fn environment(system: &Path, folder: &Path) -> Result<(), XtaskError> {
    let create = || run(Command::new(system).args(["-m", "venv", "--clear"]).arg(folder));
    if create().is_err() {
        if !may_install() {
            let how = "  sudo apt-get install python3-venv".into();
            return Err(XtaskError::Missing { what: "python3 -m venv".into(), how });
        }
        apt_install(&["python3-venv"])?;
        create()?;
    }
    Ok(())
}

/// Pythons that were asked whether they have it all, by the folder of their packages: to ask again would take a second each time.
static PYTHONS: Mutex<BTreeMap<&str, PathBuf>> = Mutex::new(BTreeMap::new());

fn python_with(workspace: &Workspace, tools: &PythonTools) -> Result<PathBuf, XtaskError> {
    let mut known = PYTHONS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(python) = known.get(tools.folder) {
        return Ok(python.clone());
    }
    let python = python_made(workspace, tools)?;
    known.insert(tools.folder, python.clone());
    Ok(python)
}

/// One that has it all, made where there is none.
fn python_made(workspace: &Workspace, tools: &PythonTools) -> Result<PathBuf, XtaskError> {
    let import = format!("import {}", tools.module);
    let reads = |python: &PathBuf| works(Command::new(python).args(["-c", &import]));
    let folder = workspace.target.join("tools").join(tools.folder);
    let own = folder.join("bin/python");
    if reads(&own) {
        return Ok(own);
    }
    let system = program(&["python3"], "python3")?;
    if reads(&system) {
        return Ok(system);
    }
    eprintln!("xtask: a Python environment with {} in {}", tools.packages.join(", "), folder.display());
    environment(&system, &folder)?;
    run(Command::new(&own).args(["-m", "pip", "install", "--quiet"]).args(tools.packages))?;
    if !tools.bare.is_empty() {
        run(Command::new(&own).args(["-m", "pip", "install", "--quiet", "--no-deps"]).args(tools.bare))?;
    }
    Ok(own)
}

/// What drives the browser.
#[derive(Debug)]
pub struct BrowserTools {
    /// Node.
    pub node: PathBuf,
    /// Chromium.
    pub chromium: PathBuf,
    /// The folder that holds `node_modules`.
    pub modules: PathBuf,
}

/// Node with its packages, and Chromium.
///
/// # Errors
/// What is missing and how to get it.
pub fn browser(workspace: &Workspace) -> Result<BrowserTools, XtaskError> {
    let chromium = program(&["chromium", "chromium-browser", "google-chrome"], "chromium")?;
    let node = program(&["node", "nodejs"], "nodejs")?;
    let modules = workspace.target.join("tools/node");
    let present = |package: &&str| {
        let (name, wanted) = package.rsplit_once('@').unwrap_or((package, ""));
        let text = std::fs::read(modules.join("node_modules").join(name).join("package.json")).unwrap_or_default();
        serde_json::from_slice::<serde_json::Value>(&text).is_ok_and(|package| package["version"] == wanted)
    };
    if !NODE_PACKAGES.iter().all(present) {
        let npm = program(&["npm"], "npm")?;
        eprintln!("xtask: {} into {}", NODE_PACKAGES.join(", "), modules.display());
        std::fs::create_dir_all(&modules).map_err(XtaskError::file(&modules))?;
        let mut install = Command::new(npm);
        install.args(["install", "--no-save", "--no-package-lock", "--no-audit", "--no-fund"]);
        // A connection that hangs is given up after seconds, not after five minutes, and tried again.
        install.args(["--fetch-timeout=20000", "--fetch-retries=4", "--fetch-retry-mintimeout=1000", "--prefix"]);
        run(install.arg(&modules).args(NODE_PACKAGES).current_dir(&modules))?;
    }
    Ok(BrowserTools { node, chromium, modules })
}
