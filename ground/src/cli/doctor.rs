//! `plumbline-ground doctor`: would a ground start here, and record? Each finding says what to do.

use std::io::{ErrorKind, Write as _};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use plumbline_ground::recorder::archive;
use plumbline_ground::{front, page_is_built, people::Accounts};
use plumbline_link::identity::load_or_create;
use plumbline_link::{signing, tls};

use super::serve::ServeArguments;
use super::settings::Settings;

/// A disk with less is worth a word: some hours of flight.
const ROOM_BYTES: u64 = 2 << 30;
/// 2026-01-01: no clock that is right shows less.
const NOT_BEFORE: Duration = Duration::from_secs(1_767_225_600);
/// A certificate that ends sooner is worth a word.
const ENDS_SOON: Duration = Duration::from_secs(14 * 86_400);

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

/// The servers of a fleet.
#[cfg(feature = "many")]
fn fleet(settings: &Settings) -> Vec<Finding> {
    const NAME: &str = "fleet";
    let Ok(Some(fleet)) = settings.fleet() else { return Vec::new() };
    let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return vec![(Level::Failure, NAME, error.to_string())],
    };
    let looked = runtime.block_on(plumbline_ground::examine_fleet(&fleet));
    let finding = |looked: Result<String, String>| match looked {
        Ok(text) => (Level::Ok, NAME, text),
        // It flies and records all the same.
        Err(text) => (Level::Warning, NAME, format!("{text}; flights wait until it is reached")),
    };
    looked.into_iter().map(finding).collect()
}

#[cfg(not(feature = "many"))]
fn fleet(settings: &Settings) -> Vec<Finding> {
    let without = || (Level::Failure, "fleet", "this ground was built without --features many".to_owned());
    settings.fleet().ok().flatten().map(|_| without()).into_iter().collect()
}

fn examine(settings: &Settings) -> Vec<Finding> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let mut all = vec![
        port("page and API", settings.listen, "--listen", TcpListener::bind(settings.listen).map(drop)),
        port("agents", settings.agent_listen, "--agent-listen", UdpSocket::bind(settings.agent_listen).map(drop)),
        folder(&settings.data),
        disk(settings),
        clock(now),
        certificate(settings, now),
        identity(settings),
        accounts(settings),
        mavlink(settings),
        backup(settings),
        page(),
        descriptors(),
        times(settings),
    ];
    all.extend(fleet(settings));
    all
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
    let trouble = |error: std::io::Error| {
        let text = format!("{}: {error}; let this user write there, or choose another: --data", data.display());
        (Level::Failure, "data folder", text)
    };
    // Made here it would belong to whoever looks, who may be root, and not to the ground.
    if !data.try_exists().unwrap_or(true) {
        return match can_be_made(data) {
            Ok(()) => (Level::Ok, "data folder", format!("{} will be made at the start", data.display())),
            Err(error) => trouble(error),
        };
    }
    let written = || {
        let mut file = std::fs::File::create(&probe)?;
        file.write_all(b"plumbline")?;
        file.sync_all()?;
        std::fs::remove_file(&probe)
    };
    match written() {
        Ok(()) => (Level::Ok, "data folder", format!("{} can be written", data.display())),
        Err(error) => trouble(error),
    }
}

/// May this user make a folder that is not there? What is there of its path says so.
fn can_be_made(folder: &Path) -> std::io::Result<()> {
    let path = std::path::absolute(folder)?;
    let Some(there) = path.ancestors().find(|part| part.exists()) else { return Ok(()) };
    if !there.is_dir() {
        return Err(ErrorKind::NotADirectory.into());
    }
    // A file without a name: it needs the same permission, and leaves nothing.
    tempfile::tempfile_in(there).map(drop)
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

fn certificate(settings: &Settings, now: Duration) -> Finding {
    let what = "certificate";
    let loaded = |certificate: &Path, key: &Path| {
        let another = "give another by --certificate and --key, or remove the ground's own, and it makes a new one";
        let judged = front::tls(certificate, key).and_then(|(_, fingerprint)| {
            front::holds(certificate, now)?;
            Ok(fingerprint)
        });
        match judged {
            Err(error) => (Level::Failure, what, format!("{error}; {another}")),
            Ok(_) if front::holds(certificate, now + ENDS_SOON).is_err() => {
                let days = ENDS_SOON.as_secs() / 86_400;
                (Level::Warning, what, format!("{} ends within {days} days; {another}", certificate.display()))
            }
            Ok(fingerprint) => (Level::Ok, what, format!("{}, SHA-256 {fingerprint}", certificate.display())),
        }
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

/// What agents know this ground by. One that is not there yet is left to the start.
fn identity(settings: &Settings) -> Finding {
    let (what, folder) = ("link identity", settings.identity_folder());
    let key = folder.join("key.pem");
    if !key.exists() && !folder.join("cert.pem").exists() {
        return (Level::Ok, what, format!("one will be made in {} at the start", folder.display()));
    }
    let found = load_or_create(&folder).and_then(|identity| tls::server(&identity).map(|_| identity.fingerprint()));
    let open = std::fs::metadata(&key).is_ok_and(|meta| meta.permissions().mode() & 0o077 != 0);
    match found {
        Err(error) => {
            let text = "put back what is missing, or make a new one, by which every agent is paired anew";
            (Level::Failure, what, format!("{error}; {text}: plumbline-ground identity --rotate"))
        }
        Ok(_) if open => (Level::Warning, what, format!("others may read {0}: chmod 600 {0}", key.display())),
        Ok(fingerprint) => (Level::Ok, what, fingerprint.to_string()),
    }
}

fn mavlink(settings: &Settings) -> Finding {
    let what = "MAVLink";
    let Some(station) = settings.mavlink else { return (Level::Ok, what, "off".into()) };
    let any = if station.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let reached = match UdpSocket::bind(any).and_then(|socket| socket.connect(station)) {
        _ if station.ip().is_unspecified() || station.port() == 0 => Err("no station can listen there".to_owned()),
        reached => reached.map_err(|error| error.to_string()),
    };
    if let Err(error) = reached {
        let text = format!("mavlink = {station}: {error}; it is the address of the station, such as 127.0.0.1:14550");
        return (Level::Failure, what, text);
    }
    let watching = |why: &str| (Level::Warning, what, format!("{station} may watch and not command: {why}"));
    if let Some(Err(error)) = settings.mavlink_key.as_deref().map(signing::read_key) {
        return (Level::Failure, what, format!("mavlink_key: {error}"));
    }
    if !station.ip().is_loopback() && settings.mavlink_key.is_none() {
        return watching("it is another machine, and there is no mavlink_key");
    }
    // That accounts cannot be read is told of them.
    let accounts = Accounts::of(&settings.data).all().unwrap_or_default();
    match &settings.mavlink_account {
        None if !accounts.is_empty() => watching("there are accounts, and mavlink_account names none"),
        Some(name) if !accounts.is_empty() && accounts.iter().all(|account| account.name != *name) => {
            watching(&format!("there is no account {name:?}, which mavlink_account names"))
        }
        _ => (Level::Ok, what, station.to_string()),
    }
}

fn backup(settings: &Settings) -> Finding {
    let what = "retention";
    let limits = settings.retention_days.is_some() || settings.retention_bytes.is_some();
    let Some(folder) = settings.retention_backup.as_deref() else {
        let text = if limits { "flights are deleted, whether or not there is a copy" } else { "nothing is deleted" };
        return (Level::Ok, what, text.into());
    };
    let fill = format!("plumbline-ground archive backup {} --data {}", folder.display(), settings.data.display());
    match archive::listed(folder) {
        Err(error) => (Level::Failure, what, format!("retention_backup: {error}; nothing is deleted before: {fill}")),
        Ok(0) => (Level::Warning, what, format!("retention_backup holds no flight: nothing is deleted before: {fill}")),
        Ok(_) if !limits => {
            let text = "retention_backup changes nothing without retention_days or retention_bytes";
            (Level::Warning, what, text.into())
        }
        Ok(flights) => (Level::Ok, what, format!("only of the {flights} flights in {}", folder.display())),
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
    use plumbline_ground::people::Role;
    use std::path::PathBuf;

    fn level(findings: &[Finding], what: &str) -> Level {
        findings.iter().find(|(_, name, _)| *name == what).unwrap().0
    }

    #[test]
    fn what_would_keep_a_ground_from_working_is_found_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        let well = well(folder.path());
        let findings = examine(&well);
        assert!(findings.iter().all(|(level, ..)| *level != Level::Failure), "{findings:?}");
        let there: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
        assert!(there.is_empty(), "looking makes nothing: {there:?}");
        assert!(said(&well, "data folder").1.contains("will be made"));
        std::fs::create_dir(&well.data).unwrap();
        assert!(said(&well, "data folder").1.contains("can be written"));
        assert_eq!(std::fs::read_dir(&well.data).unwrap().count(), 0);

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

    /// What is said of one thing, and how bad it is.
    fn said(settings: &Settings, what: &str) -> (Level, String) {
        let found = examine(settings).into_iter().find(|(_, name, _)| *name == what).unwrap();
        (found.0, found.2)
    }

    fn well(folder: &Path) -> Settings {
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        Settings { listen: any, agent_listen: any, data: folder.join("data"), ..Settings::default() }
    }

    #[test]
    fn a_certificate_that_has_ended_or_has_not_begun_or_ends_soon_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        let pair = rcgen::KeyPair::generate().unwrap();
        std::fs::write(&key, pair.serialize_pem()).unwrap();
        let settings = Settings { certificate: Some(certificate.clone()), key: Some(key), ..well(folder.path()) };
        let mut params = rcgen::CertificateParams::new(vec!["bench.lab".to_owned()]).unwrap();
        (params.not_before, params.not_after) = (rcgen::date_time_ymd(2030, 1, 1), rcgen::date_time_ymd(2031, 1, 1));
        std::fs::write(&certificate, params.self_signed(&pair).unwrap().pem()).unwrap();
        // 2030-01-01.
        let begin = Duration::from_secs(1_893_456_000);
        let day = |n: u32| begin + n * Duration::from_secs(86_400);
        for (now, level, named) in [
            (begin - Duration::from_secs(86_400), Level::Failure, "begins in 1.0 days"),
            (day(1), Level::Ok, "SHA-256"),
            (day(360), Level::Warning, "within 14 days"),
            (day(367), Level::Failure, "ended 2.0 days ago"),
        ] {
            let found = super::certificate(&settings, now);
            assert!(found.0 == level && found.2.contains(named), "{found:?}");
        }
    }

    #[test]
    fn an_address_of_mavlink_that_leads_nowhere_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let of = |station: &str, account: Option<&str>| {
            let (mavlink, mavlink_account) = (Some(station.parse().unwrap()), account.map(str::to_owned));
            said(&Settings { mavlink, mavlink_account, ..well(folder.path()) }, "MAVLink")
        };
        assert_eq!(said(&well(folder.path()), "MAVLink"), (Level::Ok, "off".into()));
        assert_eq!(of("127.0.0.1:14550", None).0, Level::Ok);
        for nowhere in ["0.0.0.0:14550", "127.0.0.1:0"] {
            assert!(matches!(of(nowhere, None), (Level::Failure, text) if text.contains(nowhere)));
        }
        // With accounts it needs one that there is.
        Accounts::of(&folder.path().join("data")).add("ann", Role::Admin, "a long enough password").unwrap();
        assert!(matches!(of("127.0.0.1:14550", None), (Level::Warning, text) if text.contains("names none")));
        assert!(matches!(of("127.0.0.1:14550", Some("bob")), (Level::Warning, text) if text.contains("bob")));
        assert_eq!(of("127.0.0.1:14550", Some("ann")).0, Level::Ok);
        let signed = |mavlink_key: Option<PathBuf>| {
            let (mavlink, mavlink_account) = (Some("127.0.0.1:14550".parse().unwrap()), Some("ann".to_owned()));
            said(&Settings { mavlink, mavlink_account, mavlink_key, ..well(folder.path()) }, "MAVLink")
        };
        let key = folder.path().join("signing");
        assert!(matches!(signed(Some(key.clone())), (Level::Failure, text) if text.contains("signing")));
        std::fs::write(&key, [7; 32]).unwrap();
        assert_eq!(signed(Some(key)).0, Level::Ok);
    }

    #[test]
    fn a_backup_that_is_not_there_and_an_identity_that_is_not_whole_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let backup = folder.path().join("backup");
        let kept =
            |retention_days| Settings { retention_backup: Some(backup.clone()), retention_days, ..well(folder.path()) };
        assert!(matches!(said(&kept(Some(9.0)), "retention"), (Level::Failure, text) if text.contains("SHA256SUMS")));
        std::fs::create_dir(&backup).unwrap();
        let sums = backup.join(archive::SUMS);
        std::fs::write(&sums, "").unwrap();
        assert!(matches!(said(&kept(Some(9.0)), "retention"), (Level::Warning, text) if text.contains("no flight")));
        std::fs::write(&sums, format!("{}  f1.mcap\n{}  f1.json\n", "a".repeat(64), "b".repeat(64))).unwrap();
        assert!(matches!(said(&kept(Some(9.0)), "retention"), (Level::Ok, text) if text.contains("1 flights")));
        assert!(matches!(said(&kept(None), "retention"), (Level::Warning, text) if text.contains("retention_days")));

        let settings = well(folder.path());
        let identity = settings.identity_folder();
        assert!(matches!(said(&settings, "link identity"), (Level::Ok, text) if text.contains("will be made")));
        assert!(!identity.exists(), "looking makes nothing");
        let made = load_or_create(&identity).unwrap();
        assert_eq!(said(&settings, "link identity"), (Level::Ok, made.fingerprint().to_string()));
        let key = identity.join("key.pem");
        std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o644)).unwrap();
        assert_eq!(said(&settings, "link identity").0, Level::Warning);
        // The key of another.
        std::fs::write(&key, rcgen::KeyPair::generate().unwrap().serialize_pem()).unwrap();
        assert_eq!(said(&settings, "link identity").0, Level::Failure);
        std::fs::remove_file(&key).unwrap();
        assert!(matches!(said(&settings, "link identity"), (Level::Failure, text) if text.contains("key.pem")));
    }
}
