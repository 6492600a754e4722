//! `cargo xtask package`: Debian packages of ground and agent, for this computer or for the vehicle's.
//!
//! For another architecture, and for computers with an older libc than ours, `cargo-zigbuild` links against glibc 2.31
//! (Debian 11, Raspberry Pi OS of 2021); what is built so runs here under qemu, which writes its own help into the package.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::ValueEnum;

use super::workspace::{forget_cargo_run, on_path, output, run};
use super::{Workspace, XtaskError, tools, web};
use crate::harness::Binaries;

/// What to put into the packages.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Take the programs of this folder instead of building them.
    #[arg(long, value_name = "DIR")]
    pub binaries: Option<PathBuf>,
    /// Build for this architecture and glibc 2.31 [default: this computer's, and its libc].
    #[arg(long = "for", value_name = "ARCH")]
    pub architecture: Option<Architecture>,
    /// Run the tests of what flies (plumbline-core) on that architecture, emulated where it is not ours.
    #[arg(long, requires = "architecture")]
    pub check: bool,
    /// Where the packages go [default: target/package].
    #[arg(long, value_name = "DIR")]
    pub output: Option<PathBuf>,
}

/// An architecture as Debian names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Architecture {
    /// x86, 64 bits.
    Amd64,
    /// ARMv8, 64 bits: Raspberry Pi 3 and later, Jetson.
    Arm64,
    /// ARMv7 with floating point: the companion computers of [Paternain] and [Clinic].
    Armhf,
}

impl Architecture {
    fn name(self) -> &'static str {
        match self {
            Self::Amd64 => "amd64",
            Self::Arm64 => "arm64",
            Self::Armhf => "armhf",
        }
    }

    /// As Rust names it.
    fn target(self) -> &'static str {
        match self {
            Self::Amd64 => "x86_64-unknown-linux-gnu",
            Self::Arm64 => "aarch64-unknown-linux-gnu",
            Self::Armhf => "armv7-unknown-linux-gnueabihf",
        }
    }

    /// What runs its programs here, with the libc that they find.
    fn emulator(self) -> Result<Vec<String>, XtaskError> {
        let (cpu, library) = match self {
            Self::Amd64 => return Ok(Vec::new()),
            Self::Arm64 => ("aarch64", "aarch64-linux-gnu"),
            Self::Armhf => ("arm", "arm-linux-gnueabihf"),
        };
        tools::emulator(cpu, self.name()).map(|qemu| vec![qemu, "-L".into(), format!("/usr/{library}")])
    }
}

/// The libc that programs for the vehicle's computer are linked against.
const GLIBC: &str = "2.31";

/// A program that may be another architecture's: how it is started here.
struct Runs<'a> {
    emulator: &'a [String],
    program: &'a Path,
}

impl Runs<'_> {
    fn says(&self, arguments: &[&str]) -> Result<String, XtaskError> {
        let program = self.program.to_string_lossy().into_owned();
        let words: Vec<&str> = self.emulator.iter().chain([&program]).map(String::as_str).collect();
        let [first, rest @ ..] = words.as_slice() else { return Ok(String::new()) };
        output(Command::new(first).args(rest).args(arguments))
    }
}

/// One package.
struct Package {
    name: &'static str,
    member: &'static str,
    summary: &'static str,
    about: &'static str,
    manual: &'static str,
    /// Groups that its unit names, which not every Debian has.
    groups: &'static [&'static str],
    /// What gives these groups their devices.
    recommends: Option<&'static str>,
    /// What becomes of a running one when another version comes: a ground is started again, an agent may be in the air.
    upgraded: &'static str,
}

const PACKAGES: [Package; 2] = [
    Package {
        name: "plumbline-ground",
        member: "ground",
        summary: "ground station of a lab quadrotor: recorder, API and page",
        about: "Records every flight, passes commands, schedules sensor attacks and serves\n the page. Its flights are kept in /var/lib/plumbline/ground, also on purge.",
        manual: "manual.md",
        groups: &[],
        recommends: Some("ca-certificates"),
        upgraded: "deb-systemd-helper enable plumbline-ground.service >/dev/null || true\n\
                   [ ! -d /run/systemd/system ] || deb-systemd-invoke restart plumbline-ground.service || true",
    },
    Package {
        name: "plumbline-agent",
        member: "agent",
        summary: "onboard agent of a lab quadrotor: fusion, control, attacks, log",
        about: "Flies the vehicle that /etc/plumbline/agent.toml describes. Not started by\n itself: pair it, test its motors, then systemctl enable --now plumbline-agent.",
        manual: "install.md",
        groups: &["i2c", "spi", "gpio"],
        recommends: Some("i2c-tools"),
        upgraded: "[ -z \"$2\" ] || echo 'plumbline-agent: the running one goes on; restart it while the vehicle stands'",
    },
];

/// What is not in every build: devices on I²C and SPI, and grounds that share.
const FEATURES: &str = "plumbline-agent/i2c,plumbline-agent/spi,plumbline-ground/many";
const MAINTAINER: &str = "The Plumbline developers <plumbline@example.org>";
const COPYRIGHT: &str = "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\n\
    Upstream-Name: Plumbline\n\nFiles: *\nCopyright: 2026 The Plumbline developers\nLicense: MIT or Apache-2.0\n \
    Either license at your option. The Apache license is in\n /usr/share/common-licenses/Apache-2.0 on Debian.\n\n\
    Files: web/inter.woff2\nCopyright: 2016 The Inter Project Authors\nLicense: OFL-1.1\n \
    Inside of the ground's page; https://openfontlicense.org.\n";

/// Builds both and prints where they are.
///
/// # Errors
/// What is missing, could not be built, or is refused by lintian where that is installed.
pub fn package(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    if on_path("dpkg-deb").is_none() {
        return Err(XtaskError::Missing { what: "dpkg-deb".into(), how: "  sudo apt-get install dpkg".into() });
    }
    let emulator = options.architecture.map_or(Ok(Vec::new()), Architecture::emulator)?;
    let binaries = match &options.binaries {
        Some(folder) => Binaries::inside(folder),
        None => {
            web::run(workspace, &web::Options::default())?;
            Binaries::inside(&built(workspace, options.architecture)?)
        }
    };
    let folder = options.output.clone().unwrap_or_else(|| workspace.target.join("package"));
    let architecture = match options.architecture {
        Some(architecture) => architecture.name().to_owned(),
        None => output(Command::new("dpkg").arg("--print-architecture"))?.trim().to_owned(),
    };
    if let Some(architecture) = options.architecture.filter(|_| options.check) {
        cross(workspace, architecture, &["test", "--lib", "--package", "plumbline-core"])?;
    }
    for package in &PACKAGES {
        let program = if package.member == "ground" { &binaries.ground } else { &binaries.agent };
        let tree = folder.join(package.name);
        if tree.exists() {
            std::fs::remove_dir_all(&tree).map_err(XtaskError::file(&tree))?;
        }
        lay_out(workspace, package, &Runs { emulator: &emulator, program }, &tree, &architecture)?;
        let file = folder.join(format!("{}_{}_{architecture}.deb", package.name, env!("CARGO_PKG_VERSION")));
        run(Command::new("dpkg-deb").args(["--root-owner-group", "-Zxz", "--build"]).arg(&tree).arg(&file))?;
        if on_path("lintian").is_some() {
            run(Command::new("lintian").args(["--fail-on", "error", "--allow-root"]).arg(&file))?;
        } else {
            eprintln!("xtask: skipped: lintian is not installed");
        }
        println!("{}", file.display());
    }
    Ok(())
}

/// Builds the programs, and says where they are.
fn built(workspace: &Workspace, architecture: Option<Architecture>) -> Result<PathBuf, XtaskError> {
    let programs = ["--bins", "--features", FEATURES];
    let Some(architecture) = architecture else {
        run(workspace.cargo().args(["build", "--locked", "--release", "--workspace"]).args(programs))?;
        return Ok(workspace.target.join("release"));
    };
    let only = ["zigbuild", "--package", "plumbline-ground", "--package", "plumbline-agent"];
    cross(workspace, architecture, &[&only[..], &programs].concat())?;
    Ok(workspace.target.join(architecture.target()).join("release"))
}

/// `cargo-zigbuild` with these arguments, optimised, for `architecture` with the old libc.
fn cross(workspace: &Workspace, architecture: Architecture, arguments: &[&str]) -> Result<(), XtaskError> {
    let (zig, target) = (tools::zig(workspace)?, architecture.target());
    run(Command::new("rustup").args(["target", "add", target]))?;
    let mut cargo = Command::new(zig.join("cargo-zigbuild"));
    forget_cargo_run(&mut cargo);
    cargo.current_dir(&workspace.root).args(arguments);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::env::join_paths(std::iter::once(zig.clone()).chain(std::env::split_paths(&path)));
    let path = path.map_err(|error| XtaskError::Other(format!("the path {}: {error}", zig.display())))?;
    cargo.env("PATH", path).args(["--locked", "--release", "--target", &format!("{target}.{GLIBC}")]);
    // The strip of this computer knows its own programs only.
    cargo.env("CARGO_PROFILE_RELEASE_STRIP", "symbols");
    let runner = format!("CARGO_TARGET_{}_RUNNER", target.to_uppercase().replace('-', "_"));
    let emulator = architecture.emulator()?;
    if !emulator.is_empty() {
        cargo.env(runner, emulator.join(" "));
    }
    run(&mut cargo)
}

/// Everything as it will lie on the computer, and what dpkg is told of it.
fn lay_out(
    workspace: &Workspace,
    package: &Package,
    runs: &Runs<'_>,
    tree: &Path,
    architecture: &str,
) -> Result<(), XtaskError> {
    let Package { name, member, manual, .. } = package;
    let read = |path: &Path| std::fs::read(path).map_err(XtaskError::file(path));
    let put = |path: String, content: &[u8], mode| put(&tree.join(path), content, mode);
    let root = &workspace.root;
    let bytes = read(runs.program)?;
    put(format!("usr/bin/{name}"), &bytes, 0o755)?;
    // Symbols are of use to who builds, and ten times the program.
    if runs.emulator.is_empty() && on_path("strip").is_some() {
        run(Command::new("strip").arg(tree.join(format!("usr/bin/{name}"))))?;
    }
    let unit = read(&root.join(member).join(format!("package/{name}.service")))?;
    put(format!("usr/lib/systemd/system/{name}.service"), &unit, 0o644)?;
    put(format!("etc/plumbline/{member}.toml"), &configuration(workspace, member, runs)?, 0o644)?;
    put(format!("usr/share/doc/{name}/{manual}"), &read(&root.join("docs").join(manual))?, 0o644)?;
    let book = root.join("docs/book");
    for entry in std::fs::read_dir(&book).map_err(XtaskError::file(&book))?.flatten() {
        let page = entry.file_name().to_string_lossy().into_owned();
        put(format!("usr/share/doc/{name}/book/{page}"), &read(&entry.path())?, 0o644)?;
    }
    put(format!("usr/share/doc/{name}/copyright"), COPYRIGHT.as_bytes(), 0o644)?;
    put(format!("usr/share/doc/{name}/CHANGELOG.md"), &read(&root.join("CHANGELOG.md"))?, 0o644)?;
    let date = output(Command::new("date").arg("--rfc-email"))?;
    let changes = format!(
        "{name} ({}) unstable; urgency=medium\n\n  * What changed stands in CHANGELOG.md beside this file.\n\n -- {MAINTAINER}  {date}",
        env!("CARGO_PKG_VERSION")
    );
    put_compressed(&tree.join(format!("usr/share/doc/{name}/changelog")), changes.as_bytes())?;
    let help = runs.says(&["--help"])?.replace('\\', "\\\\").replace('-', "\\-");
    let page = format!(
        ".TH {} 1\n.SH NAME\n{name} \\- {}\n.SH DESCRIPTION\n.nf\n{help}.fi\n.SH FILES\n/etc/plumbline/{member}.toml\n",
        name.to_uppercase(),
        package.summary
    );
    put_compressed(&tree.join(format!("usr/share/man/man1/{name}.1")), page.as_bytes())?;
    put("DEBIAN/conffiles".into(), format!("/etc/plumbline/{member}.toml\n").as_bytes(), 0o644)?;
    put("DEBIAN/postinst".into(), after(package).as_bytes(), 0o755)?;
    let stop = format!(
        "#!/bin/sh\nset -e\nif [ \"$1\" = remove ] && [ -d /run/systemd/system ]; then\n    deb-systemd-invoke stop {name}.service\nfi\n"
    );
    put("DEBIAN/prerm".into(), stop.as_bytes(), 0o755)?;
    let forget = format!(
        "#!/bin/sh\nset -e\nif [ \"$1\" = purge ]; then\n    deb-systemd-helper purge {name}.service >/dev/null || true\nfi\n"
    );
    put("DEBIAN/postrm".into(), forget.as_bytes(), 0o755)?;
    run(Command::new("sh").args(["-c", "find usr -type f -exec md5sum {} + > DEBIAN/md5sums"]).current_dir(tree))?;
    let size = output(Command::new("du").args(["-sk"]).arg(tree))?;
    let size = size.split_whitespace().next().unwrap_or("0").to_owned();
    let recommends = package.recommends.map(|other| format!("Recommends: {other}\n")).unwrap_or_default();
    let control = format!(
        "Package: {name}\nVersion: {}\nArchitecture: {architecture}\nMaintainer: {MAINTAINER}\n\
         Installed-Size: {size}\nDepends: libc6 (>= {}), libgcc-s1, adduser\n{recommends}Section: science\n\
         Priority: optional\nDescription: {}\n {}\n",
        env!("CARGO_PKG_VERSION"),
        newest_glibc(&bytes),
        package.summary,
        package.about,
    );
    put("DEBIAN/control".into(), control.as_bytes(), 0o644)
}

/// The ground says its own configuration; the agent's is a beginning.
fn configuration(workspace: &Workspace, member: &str, runs: &Runs<'_>) -> Result<Vec<u8>, XtaskError> {
    if member == "ground" {
        let text = runs.says(&["--data", "/var/lib/plumbline/ground", "--print-config"])?;
        return Ok(text.into_bytes());
    }
    let path = workspace.root.join("agent/package/agent.toml");
    std::fs::read(&path).map_err(XtaskError::file(&path))
}

/// After it is unpacked: its own user and groups, and what becomes of one that runs.
fn after(package: &Package) -> String {
    let upgraded = package.upgraded.replace('\n', "\n    ");
    let group = |group: &&str| format!("getent group {group} >/dev/null || addgroup --system --quiet {group}\n    ");
    let groups: String = package.groups.iter().map(group).collect();
    // The folder of its state is there before its first start, so that it can be paired; the configuration may hold passwords.
    let own = format!(
        "install -d -o plumbline -g plumbline -m 750 /var/lib/plumbline/{0}\n    \
         chgrp plumbline /etc/plumbline/{0}.toml && chmod 640 /etc/plumbline/{0}.toml",
        package.member
    );
    format!(
        "#!/bin/sh\nset -e\nif [ \"$1\" = configure ]; then\n    if ! getent passwd plumbline >/dev/null; then\n        \
         adduser --system --group --quiet --home /var/lib/plumbline --no-create-home plumbline\n    fi\n    {groups}{own}\n    \
         [ ! -d /run/systemd/system ] || systemctl --system daemon-reload >/dev/null || true\n    {upgraded}\nfi\n"
    )
}

/// The newest symbol version of glibc that a program asks for: what is not older runs it.
fn newest_glibc(program: &[u8]) -> String {
    let mark = b"GLIBC_2.";
    let versions = program.windows(mark.len() + 3).filter(|window| window.starts_with(mark)).filter_map(|window| {
        let digits = window.get(mark.len()..)?.iter().take_while(|byte| byte.is_ascii_digit());
        String::from_utf8(digits.copied().collect()).ok()?.parse::<u32>().ok()
    });
    format!("2.{}", versions.max().unwrap_or(31))
}

fn put(path: &Path, content: &[u8], mode: u32) -> Result<(), XtaskError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(XtaskError::file(folder))?;
        let open = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(folder, open).map_err(XtaskError::file(folder))?;
    }
    std::fs::write(path, content).map_err(XtaskError::file(path))?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).map_err(XtaskError::file(path))
}

fn put_compressed(path: &Path, content: &[u8]) -> Result<(), XtaskError> {
    put(path, content, 0o644)?;
    run(Command::new("gzip").args(["--best", "--no-name", "--force"]).arg(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_glibc_is_found_in_a_program() {
        assert_eq!(newest_glibc(b"..GLIBC_2.4\0GLIBC_2.34\0GLIBC_2.17\0GLIBC_PRIVATE\0...."), "2.34");
    }

    #[test]
    fn every_group_and_folder_of_a_unit_is_made_by_its_package() {
        for package in &PACKAGES {
            let unit = format!("../{0}/package/{1}.service", package.member, package.name);
            let unit = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(unit)).unwrap();
            let groups = unit.lines().find_map(|line| line.strip_prefix("SupplementaryGroups=")).unwrap_or_default();
            let script = after(package);
            // base-passwd has it everywhere.
            for group in groups.split(' ').filter(|group| !matches!(*group, "" | "dialout")) {
                assert!(script.contains(&format!("addgroup --system --quiet {group}\n")), "{}: {group}", package.name);
            }
            let state = unit.lines().find_map(|line| line.strip_prefix("StateDirectory=")).unwrap();
            assert!(script.contains(&format!("install -d -o plumbline -g plumbline -m 750 /var/lib/{state}\n")));
            // A path that may be absent keeps it from starting.
            assert!(!unit.contains("ReadWritePaths=/"), "{}", package.name);
        }
    }
}
