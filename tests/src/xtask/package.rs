//! `cargo xtask package`: Debian packages of ground and agent, for the architecture of this computer.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::workspace::{on_path, output, run};
use super::{Workspace, XtaskError, web};
use crate::harness::Binaries;

/// What to put into the packages.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Take the programs of this folder instead of building them.
    #[arg(long, value_name = "DIR")]
    pub binaries: Option<PathBuf>,
    /// Where the packages go [default: target/package].
    #[arg(long, value_name = "DIR")]
    pub output: Option<PathBuf>,
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
        recommends: None,
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
        upgraded: "echo 'plumbline-agent: the running one goes on; restart it while the vehicle stands'",
    },
];

/// What is not in every build: devices on I²C, and grounds that share.
const FEATURES: &str = "plumbline-agent/i2c,plumbline-ground/many";
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
    let binaries = match &options.binaries {
        Some(folder) => Binaries::inside(folder),
        None => {
            web::run(workspace, &web::Options::default())?;
            let build = ["build", "--locked", "--release", "--workspace", "--bins", "--features", FEATURES];
            run(workspace.cargo().args(build))?;
            Binaries::inside(&workspace.target.join("release"))
        }
    };
    let folder = options.output.clone().unwrap_or_else(|| workspace.target.join("package"));
    let architecture = output(Command::new("dpkg").arg("--print-architecture"))?.trim().to_owned();
    for package in &PACKAGES {
        let program = if package.member == "ground" { &binaries.ground } else { &binaries.agent };
        let tree = folder.join(package.name);
        if tree.exists() {
            std::fs::remove_dir_all(&tree).map_err(XtaskError::file(&tree))?;
        }
        lay_out(workspace, package, program, &tree, &architecture)?;
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

/// Everything as it will lie on the computer, and what dpkg is told of it.
fn lay_out(
    workspace: &Workspace,
    package: &Package,
    program: &Path,
    tree: &Path,
    architecture: &str,
) -> Result<(), XtaskError> {
    let Package { name, member, manual, .. } = package;
    let read = |path: &Path| std::fs::read(path).map_err(XtaskError::file(path));
    let put = |path: String, content: &[u8], mode| put(&tree.join(path), content, mode);
    let root = &workspace.root;
    let bytes = read(program)?;
    put(format!("usr/bin/{name}"), &bytes, 0o755)?;
    // Symbols are of use to who builds, and ten times the program.
    if on_path("strip").is_some() {
        run(Command::new("strip").arg(tree.join(format!("usr/bin/{name}"))))?;
    }
    let unit = read(&root.join(member).join(format!("package/{name}.service")))?;
    put(format!("usr/lib/systemd/system/{name}.service"), &unit, 0o644)?;
    put(format!("etc/plumbline/{member}.toml"), &configuration(workspace, member, program)?, 0o644)?;
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
    let help = output(Command::new(program).arg("--help"))?.replace('\\', "\\\\").replace('-', "\\-");
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
fn configuration(workspace: &Workspace, member: &str, program: &Path) -> Result<Vec<u8>, XtaskError> {
    if member == "ground" {
        let text = output(Command::new(program).args(["--data", "/var/lib/plumbline/ground", "--print-config"]))?;
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
    // It may hold passwords.
    let own = format!("chgrp plumbline /etc/plumbline/{0}.toml && chmod 640 /etc/plumbline/{0}.toml", package.member);
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
    fn every_group_of_a_unit_is_made_by_its_package() {
        for package in &PACKAGES {
            let unit = format!("../{0}/package/{1}.service", package.member, package.name);
            let unit = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(unit)).unwrap();
            let groups = unit.lines().find_map(|line| line.strip_prefix("SupplementaryGroups=")).unwrap_or_default();
            let script = after(package);
            // base-passwd has it everywhere.
            for group in groups.split(' ').filter(|group| !matches!(*group, "" | "dialout")) {
                assert!(script.contains(&format!("addgroup --system --quiet {group}\n")), "{}: {group}", package.name);
            }
            // The unit's own folders are made by it; a path that may be absent keeps it from starting.
            assert!(!unit.contains("ReadWritePaths=/"), "{}", package.name);
        }
    }
}
