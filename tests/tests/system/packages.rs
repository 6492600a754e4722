//! The Debian packages hold what runs: built of these programs, unpacked, and started from there.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use plumbline_agent::recordings::skipped;
use plumbline_tests::harness::{Api, Binaries, Process, address_after, wait_until};

const START: Duration = Duration::from_secs(20);

fn done(program: &str, arguments: &[&str]) -> String {
    let ran = Command::new(program).args(arguments).output().unwrap_or_else(|error| panic!("{program}: {error}"));
    let said = String::from_utf8_lossy(&ran.stdout).into_owned() + &String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{program} {arguments:?}: {said}");
    said
}

/// Every absolute path that a unit starts, reads or shows is in its package.
fn unit_names_what_is_there(root: &Path, unit: &str) {
    let text = std::fs::read_to_string(root.join(format!("usr/lib/systemd/system/{unit}.service"))).unwrap();
    let paths = text.lines().filter(|line| line.starts_with("ExecStart=") || line.starts_with("Documentation="));
    let paths: Vec<&str> = paths
        .flat_map(|line| line.split(['=', ' ']))
        .map(|word| word.trim_start_matches("file://"))
        .filter(|word| word.starts_with('/'))
        .collect();
    assert!(paths.len() >= 3, "program, configuration and manual: {paths:?}");
    for path in paths {
        assert!(root.join(path.trim_start_matches('/')).is_file(), "{unit}: no {path}");
    }
}

/// GIVEN both packages WHEN they are unpacked THEN units, scripts and configuration are in order, and the ground runs by its own.
#[test]
fn packages_are_unpacked_and_run() {
    if !Path::new("/usr/bin/dpkg-deb").exists() {
        skipped("dpkg-deb is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |path: &str| folder.path().join(path).to_string_lossy().into_owned();
    let binaries = Binaries::of_this_build().unwrap();
    let programs = binaries.ground.parent().unwrap().to_string_lossy().into_owned();
    let said = done(env!("CARGO_BIN_EXE_xtask"), &["package", "--binaries", &programs, "--output", &at("out")]);
    for name in ["plumbline-ground", "plumbline-agent"] {
        let file = said.lines().find(|line| line.ends_with(".deb") && line.contains(&format!("/{name}_"))).unwrap();
        let fields = done("dpkg-deb", &["--field", file]);
        assert!(fields.contains(&format!("Package: {name}\n")) && fields.contains("Depends: libc6"), "{fields}");
        done("dpkg-deb", &["--raw-extract", file, &at(name)]);
        let root = folder.path().join(name);
        unit_names_what_is_there(&root, name);
        done("sh", &["-c", &format!("cd {} && md5sum --quiet -c DEBIAN/md5sums", root.display())]);
        for script in ["postinst", "prerm", "postrm"] {
            done("sh", &["-n", &at(&format!("{name}/DEBIAN/{script}"))]);
        }
        let version = done(&at(&format!("{name}/usr/bin/{name}")), &["--version"]);
        assert!(version.contains(env!("CARGO_PKG_VERSION")), "{version}");
    }
    let mut command = Command::new(at("plumbline-ground/usr/bin/plumbline-ground"));
    command.args(["--config", &at("plumbline-ground/etc/plumbline/ground.toml"), "--data", &at("data")]);
    command.args(["--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0"]);
    let mut ground = Process::start("ground", command, false).unwrap();
    let address = ground.wait_for(START, |line| address_after(line, "Plumbline is at http://")).unwrap();
    let api = Api { address, operator: "system-test".into() };
    assert!(wait_until(START, || (api.get("/readyz").ok()?.status == 200).then_some(())).is_some(), "not ready");
    assert!(ground.interrupt(START).unwrap().success());
}
