//! `plumbline-ground doctor`: would a ground start here, and record? Each finding says what to do.

use std::io::{ErrorKind, Write as _};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use plumbline_ground::{front, page_is_built, people::Accounts};

use super::serve::ServeArguments;
use super::settings::Settings;

/// A disk with less is worth a word: some hours of flight.
const ROOM_BYTES: u64 = 2 << 30;
/// 2026-01-01: no clock that is right shows less.
const NOT_BEFORE: Duration = Duration::from_secs(1_767_225_600);

/// Options as for serving: what they say is looked at.
#[derive(Debug, clap::Args)]
pub struct DoctorArguments {
    #[command(flatten)]
    serve: ServeArguments,
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Level {
    Ok,
    Warning,
    Failure,
}

type Finding = (Level, &'static str, String);

/// Looks at everything and says what it found.
///
/// # Errors
/// How much of it keeps a ground from working.
pub fn run(arguments: &DoctorArguments) -> Result<(), String> {
    let settings = arguments.serve.settings()?;
    let findings = examine(&settings);
    for (level, what, text) in &findings {
        let level = match level {
            Level::Ok => "ok     ",
            Level::Warning => "warning",
            Level::Failure => "FAILURE",
        };
        println!("{level}  {what}: {text}");
    }
    match findings.iter().filter(|(level, ..)| *level == Level::Failure).count() {
        0 => Ok(()),
        failures => Err(format!("{failures} of {} checks failed", findings.len())),
    }
}

fn examine(settings: &Settings) -> Vec<Finding> {
    vec![
        port("page and API", settings.listen, "--listen", TcpListener::bind(settings.listen).map(drop)),
        port("agents", settings.agent_listen, "--agent-listen", UdpSocket::bind(settings.agent_listen).map(drop)),
        folder(&settings.data),
        disk(settings),
        clock(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()),
        certificate(settings),
        accounts(settings),
        page(),
        descriptors(),
        times(settings),
    ]
}

fn port(what: &'static str, address: SocketAddr, option: &str, bound: std::io::Result<()>) -> Finding {
    match bound {
        Ok(()) => (Level::Ok, what, format!("{address} is free")),
        Err(error) if error.kind() == ErrorKind::AddrInUse => {
            (Level::Failure, what, format!("{address} is occupied; is a ground running? Else choose another: {option}"))
        }
        Err(error) => (Level::Failure, what, format!("{address}: {error}; choose another: {option}")),
    }
}

fn folder(data: &Path) -> Finding {
    let probe = data.join(".doctor");
    let written = || {
        std::fs::create_dir_all(data)?;
        let mut file = std::fs::File::create(&probe)?;
        file.write_all(b"plumbline")?;
        file.sync_all()?;
        std::fs::remove_file(&probe)
    };
    match written() {
        Ok(()) => (Level::Ok, "data folder", format!("{} can be written", data.display())),
        Err(error) => {
            let text = format!("{}: {error}; let this user write there, or choose another: --data", data.display());
            (Level::Failure, "data folder", text)
        }
    }
}

fn disk(settings: &Settings) -> Finding {
    let existing = settings.data.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    match plumbline_file::free_bytes(existing) {
        None => (Level::Failure, "disk", format!("{}: its disk does not say how full it is", existing.display())),
        Some(free) => {
            let text = format!("{} MiB free", free >> 20);
            if free <= settings.reserve_bytes {
                (
                    Level::Failure,
                    "disk",
                    format!("{text}, and recording stops at reserve_bytes = {}; make room", settings.reserve_bytes),
                )
            } else if free < ROOM_BYTES {
                (Level::Warning, "disk", format!("{text}: some hours of flight; delete or move flights"))
            } else {
                (Level::Ok, "disk", text)
            }
        }
    }
}

fn clock(now: Duration) -> Finding {
    if now < NOT_BEFORE {
        let text =
            format!("it shows {} s after 1970, which is long ago; set it, flights are dated by it", now.as_secs());
        return (Level::Failure, "clock", text);
    }
    let synchronised = Path::new("/run/systemd/timesync/synchronized").exists();
    let known = Path::new("/run/systemd/timesync").exists();
    if known && !synchronised {
        return (Level::Warning, "clock", "it is not synchronised: timedatectl set-ntp true".into());
    }
    (Level::Ok, "clock", "plausible".into())
}

fn certificate(settings: &Settings) -> Finding {
    let what = "certificate";
    let loaded = |certificate: &Path, key: &Path| match front::tls(certificate, key) {
        Ok((_, fingerprint)) => (Level::Ok, what, format!("{}, SHA-256 {fingerprint}", certificate.display())),
        Err(error) => (Level::Failure, what, format!("{error}; give another by --certificate and --key")),
    };
    match settings.own_certificate() {
        Err(error) => (Level::Failure, what, error),
        Ok(Some((certificate, key))) => loaded(certificate, key),
        Ok(None) if !settings.by_tls() => (Level::Ok, what, "none is needed on the loopback".into()),
        Ok(None) => {
            let (certificate, key) = (settings.data.join("tls/cert.pem"), settings.data.join("tls/key.pem"));
            if certificate.exists() && key.exists() {
                loaded(&certificate, &key)
            } else {
                (Level::Ok, what, "a self-signed one will be made at the start".into())
            }
        }
    }
}

fn accounts(settings: &Settings) -> Finding {
    let make = "make one: plumbline-ground account add NAME --role admin";
    match Accounts::of(&settings.data).all() {
        Err(error) => (Level::Failure, "accounts", error.to_string()),
        Ok(all) if !all.is_empty() => (Level::Ok, "accounts", format!("{}", all.len())),
        Ok(_) if settings.listen.ip().is_loopback() => {
            (Level::Ok, "accounts", "none: whoever sits at this machine may do everything".into())
        }
        Ok(_) => (Level::Failure, "accounts", format!("none, and {} is a network address; {make}", settings.listen)),
    }
}

fn page() -> Finding {
    if page_is_built() {
        (Level::Ok, "page", "built in".into())
    } else {
        let text = "not built into this program: cargo xtask web, then build the ground again; the API works without";
        (Level::Warning, "page", text.into())
    }
}

fn descriptors() -> Finding {
    let most = rlimit::getrlimit(rlimit::Resource::NOFILE).map_or(0, |(_, hard)| hard);
    let wanted = (front::RESERVED_DESCRIPTORS + front::MAX_CONNECTIONS) as u64;
    if most < wanted {
        let text = format!("at most {most} may be open, {wanted} are wanted: ulimit -Hn, or LimitNOFILE in a unit");
        (Level::Warning, "open files", text)
    } else {
        (Level::Ok, "open files", format!("at most {most}"))
    }
}

fn times(settings: &Settings) -> Finding {
    match settings.config() {
        Ok(_) => (Level::Ok, "configuration", "every value can be used".into()),
        Err(error) => (Level::Failure, "configuration", error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(findings: &[Finding], what: &str) -> Level {
        findings.iter().find(|(_, name, _)| *name == what).unwrap().0
    }

    #[test]
    fn what_would_keep_a_ground_from_working_is_found_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        let well = Settings { listen: any, agent_listen: any, data: folder.path().join("data"), ..Settings::default() };
        let findings = examine(&well);
        assert!(findings.iter().all(|(level, ..)| *level != Level::Failure), "{findings:?}");

        let taken = TcpListener::bind(any).unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "no folder").unwrap();
        let ill = Settings {
            listen: taken.local_addr().unwrap(),
            data: file.join("data"),
            reserve_bytes: u64::MAX,
            certificate: Some(file.clone()),
            key: Some(file),
            settle_after_s: -1.0,
            ..well.clone()
        };
        let findings = examine(&ill);
        for what in ["page and API", "data folder", "disk", "certificate", "configuration"] {
            assert_eq!(level(&findings, what), Level::Failure, "{findings:?}");
        }
        let outside = Settings { listen: SocketAddr::from(([0, 0, 0, 0], 0)), ..well };
        assert_eq!(level(&examine(&outside), "accounts"), Level::Failure);
        assert_eq!(clock(Duration::from_secs(86_400)).0, Level::Failure);
    }
}
