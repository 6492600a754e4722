//! What a ground is told at its start: defaults, then the configuration file, then the command line.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plumbline_ground::{Fleet, GroundConfig, Mavlink};
use plumbline_link::signing;
use serde::{Deserialize, Serialize};

/// Every key of the configuration file, TOML.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    pub listen: SocketAddr,
    pub agent_listen: SocketAddr,
    pub data: PathBuf,
    pub identity: Option<PathBuf>,
    pub allow_hosts: Vec<String>,
    pub allow_origins: Vec<String>,
    pub tls: bool,
    pub certificate: Option<PathBuf>,
    pub key: Option<PathBuf>,
    pub json_log: bool,
    pub metrics_open: bool,
    pub mavlink: Option<SocketAddr>,
    pub mavlink_account: Option<String>,
    pub mavlink_key: Option<PathBuf>,
    pub lease_idle_s: f64,
    pub command_timeout_s: f64,
    pub reserve_bytes: u64,
    pub retention_days: Option<f64>,
    pub retention_bytes: Option<u64>,
    pub retention_backup: Option<PathBuf>,
    pub retention_notice_hours: f64,
    pub fleet_name: Option<String>,
    pub fleet_address: Option<String>,
    pub fleet_nats: Option<String>,
    pub fleet_archive: Option<String>,
    pub fleet_index: Option<String>,
    pub backfill_after_s: f64,
    pub settle_after_s: f64,
}

/// What each key means, in the order they are printed.
const ABOUT: [(&str, &str); 28] = [
    ("listen", "Address of the page and the API. Anything but the loopback needs accounts, and is served by TLS."),
    ("agent_listen", "Address (UDP) that agents connect to."),
    ("data", "Folder of flight files, index, gains book, identities, accounts and audit log."),
    (
        "identity",
        "Folder of this ground's certificate and of the agents it trusts; absent: `identity` in the data folder.",
    ),
    ("allow_hosts", "Host names, beside localhost and IP addresses, under which the page may be reached."),
    (
        "allow_origins",
        "Pages of others that may open the Foxglove link, and so command by it, such as https://app.foxglove.dev; an app on a \
         desktop may be file://.",
    ),
    ("tls", "Serve the page by TLS on the loopback, too."),
    ("certificate", "Certificate chain (PEM) for the page; absent: a self-signed one, made once in the data folder."),
    ("key", "Its private key (PEM)."),
    ("json_log", "Log as JSON lines instead of text. RUST_LOG sets the level."),
    ("metrics_open", "/metrics for everybody who reaches this ground, not only for this machine and those signed in."),
    (
        "mavlink",
        "Address (UDP) where a MAVLink ground control station listens, such as 127.0.0.1:14550; absent: MAVLink is off. \
         One on another machine may watch, and command only with `mavlink_key`.",
    ),
    ("mavlink_account", "The account that this station commands as; needed as soon as there are accounts."),
    (
        "mavlink_key",
        "File with the key that both sides sign with, 32 bytes or 64 hexadecimal digits; absent: nothing is signed. With it \
         what the station says unsigned is refused.",
    ),
    ("lease_idle_s", "Control is given up when its holder does nothing and shows no sign of life for this long, s."),
    ("command_timeout_s", "How long a command waits for its acknowledgement, s."),
    ("reserve_bytes", "Recording stops, loudly, when the disk has less than this left, bytes."),
    (
        "retention_days",
        "Complete flights without name and notes are deleted so many days after their end; absent: never.",
    ),
    ("retention_bytes", "The oldest of them are deleted when all flights take more than this, bytes; absent: never."),
    (
        "retention_backup",
        "Only flights that this folder of `plumbline-ground archive backup` holds are deleted; absent: all.",
    ),
    ("retention_notice_hours", "So long before it is deleted a flight is told to be due, hours."),
    (
        "fleet_name",
        "What this ground is called among those it shares vehicles and flights with (a ground built with `--features many`); \
         absent: it shares nothing.",
    ),
    ("fleet_address", "Where the page of this ground is, for people at the others; absent: where it listens."),
    (
        "fleet_nats",
        "NATS server by which the grounds show each other their vehicles, such as tls://USER:PASSWORD@nats.lab: whoever may \
         publish there may cut motors.",
    ),
    (
        "fleet_archive",
        "Folder or s3://BUCKET/PREFIX where all of them keep their flights (keys, region and endpoint from AWS_* of the \
         environment); needs fleet_index.",
    ),
    (
        "fleet_index",
        "PostgreSQL database with the index of these flights, such as postgresql://USER:PASSWORD@db.lab/plumbline.",
    ),
    ("backfill_after_s", "A message that has not come after this long is asked for again, s."),
    ("settle_after_s", "A flight whose gaps do not shrink for this long after its end is closed as it is, s."),
];

/// Seconds in one.
const HOUR_S: f64 = 3600.0;

impl Default for Settings {
    fn default() -> Self {
        let config = GroundConfig::new("./data");
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 4747)),
            agent_listen: SocketAddr::from(([127, 0, 0, 1], 4748)),
            data: config.data_folder,
            identity: None,
            allow_hosts: config.allowed_hosts,
            allow_origins: config.allowed_origins,
            tls: false,
            certificate: None,
            key: None,
            json_log: false,
            metrics_open: config.metrics_open,
            mavlink: None,
            mavlink_account: None,
            mavlink_key: None,
            lease_idle_s: config.lease_idle.as_secs_f64(),
            command_timeout_s: config.command_timeout.as_secs_f64(),
            reserve_bytes: config.reserve_bytes,
            retention_days: None,
            retention_bytes: None,
            retention_backup: None,
            fleet_name: None,
            fleet_address: None,
            fleet_nats: None,
            fleet_archive: None,
            fleet_index: None,
            retention_notice_hours: config.retention.notice.as_secs_f64() / HOUR_S,
            backfill_after_s: config.backfill_after.as_secs_f64(),
            settle_after_s: config.settle_after.as_secs_f64(),
        }
    }
}

impl Settings {
    /// Reads a configuration file; what it leaves out has its default.
    ///
    /// # Errors
    /// A sentence with the file, the line and the key.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        toml::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))
    }

    /// As a configuration file, every key with what it means.
    ///
    /// # Errors
    /// A path that is no text.
    pub fn print(&self) -> Result<String, String> {
        let table = toml::Table::try_from(self).map_err(|error| format!("configuration: {error}"))?;
        let line = |(key, about): &(&str, &str)| match table.get(*key) {
            Some(value) => format!("# {about}\n{key} = {value}\n"),
            None => format!("# {about}\n# {key} =\n"),
        };
        Ok(ABOUT.iter().map(line).collect::<Vec<_>>().join("\n"))
    }

    /// Where this ground's certificate for the link is.
    pub fn identity_folder(&self) -> PathBuf {
        self.identity.clone().unwrap_or_else(|| self.data.join("identity"))
    }

    /// Is the page served by TLS?
    pub fn by_tls(&self) -> bool {
        self.tls || self.certificate.is_some() || !self.listen.ip().is_loopback()
    }

    /// Certificate and key of one's own; `None` for those that the ground makes.
    ///
    /// # Errors
    /// One without the other.
    pub fn own_certificate(&self) -> Result<Option<(&Path, &Path)>, String> {
        match (self.certificate.as_deref(), self.key.as_deref()) {
            (Some(certificate), Some(key)) => Ok(Some((certificate, key))),
            (None, None) => Ok(None),
            (Some(_), None) => Err("certificate without key: both are needed".into()),
            (None, Some(_)) => Err("key without certificate: both are needed".into()),
        }
    }

    /// Origins as browsers say them.
    ///
    /// # Errors
    /// One that no browser says.
    fn origins(&self) -> Result<Vec<String>, String> {
        let said = |origin: &String| {
            let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
            let web = host.is_some_and(|host| {
                let authority = host.parse::<axum::http::uri::Authority>().ok();
                authority.is_some_and(|authority| authority.as_str() == host && !host.contains('@'))
            });
            if web || origin == "file://" {
                Ok(origin.clone())
            } else {
                Err(format!("allow_origins: {origin:?} is no origin such as https://app.foxglove.dev, without a path"))
            }
        };
        self.allow_origins.iter().map(said).collect()
    }

    /// What is shared with other grounds.
    ///
    /// # Errors
    /// A key without the other that it needs.
    pub fn fleet(&self) -> Result<Option<Fleet>, String> {
        let Self { fleet_name, fleet_address, fleet_nats, fleet_archive, fleet_index, .. } = self;
        let archive = match (fleet_archive, fleet_index) {
            (Some(archive), Some(index)) => Some((archive.clone(), index.clone())),
            (None, None) => None,
            (Some(_), None) => return Err("fleet_archive without fleet_index: both are needed".into()),
            (None, Some(_)) => return Err("fleet_index without fleet_archive: both are needed".into()),
        };
        let Some(name) = fleet_name else {
            let any = fleet_address.is_some() || fleet_nats.is_some() || archive.is_some();
            return if any { Err("fleet_name is needed to share anything".into()) } else { Ok(None) };
        };
        let own = || format!("{}://{}/", if self.by_tls() { "https" } else { "http" }, self.listen);
        let address = fleet_address.clone().unwrap_or_else(own);
        Ok(Some(Fleet { name: name.clone(), address, nats: fleet_nats.clone(), archive }))
    }

    /// What the ground itself is told.
    ///
    /// # Errors
    /// A time that is none.
    pub fn config(&self) -> Result<GroundConfig, String> {
        let time = |key: &str, value: f64| {
            let time = Duration::try_from_secs_f64(value).ok().filter(|time| !time.is_zero());
            time.ok_or_else(|| format!("{key} = {value}: a number of seconds above 0 is needed"))
        };
        let mut config = GroundConfig::new(&self.data);
        config.allowed_hosts.clone_from(&self.allow_hosts);
        config.allowed_origins = self.origins()?;
        config.metrics_open = self.metrics_open;
        let key = self.mavlink_key.as_deref().map(signing::read_key).transpose();
        let key = key.map_err(|error| format!("mavlink_key: {error}"))?;
        let account = self.mavlink_account.clone();
        config.mavlink = self.mavlink.map(|station| Mavlink { station, account, key });
        config.reserve_bytes = self.reserve_bytes;
        config.retention.bytes = self.retention_bytes;
        config.retention.backup.clone_from(&self.retention_backup);
        config.retention.age =
            self.retention_days.map(|days| time("retention_days", days * 24.0 * HOUR_S)).transpose()?;
        config.retention.notice = time("retention_notice_hours", self.retention_notice_hours * HOUR_S)?;
        config.fleet = self.fleet()?;
        config.lease_idle = time("lease_idle_s", self.lease_idle_s)?;
        config.command_timeout = time("command_timeout_s", self.command_timeout_s)?;
        config.backfill_after = time("backfill_after_s", self.backfill_after_s)?;
        config.settle_after = time("settle_after_s", self.settle_after_s)?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_read_back_and_no_key_is_without_its_meaning() {
        let text = Settings::default().print().unwrap();
        assert_eq!(toml::from_str::<Settings>(&text).unwrap(), Settings::default());
        let bare = text.replace("# identity =", "identity = \"a\"").replace("# certificate =", "certificate = \"b\"");
        let bare = bare.replace("# mavlink =", "mavlink = \"127.0.0.1:14550\"");
        let bare = bare.replace("# mavlink_account =", "mavlink_account = \"d\"");
        let bare = bare.replace("# mavlink_key =", "mavlink_key = \"k\"");
        let bare = bare.replace("# retention_days =", "retention_days = 30.0");
        let bare = bare
            .replace("# retention_bytes =", "retention_bytes = 1")
            .replace("# retention_backup =", "retention_backup = \"d\"");
        let fleet = ["name", "address", "nats", "archive", "index"].map(|key| format!("# fleet_{key} ="));
        let bare = fleet.iter().fold(bare, |text, key| text.replace(key, &format!("{} \"e\"", &key[2..])));
        let all: toml::Table = toml::from_str(&bare.replace("# key =", "key = \"c\"")).unwrap();
        assert_eq!(all.len(), ABOUT.len());
        assert_eq!(toml::Table::try_from(toml::from_str::<Settings>(&all.to_string()).unwrap()).unwrap(), all);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ground.toml");
        assert!(Settings::read(&path).unwrap_err().contains("ground.toml"));
        for (text, named) in
            [("lisen = \"127.0.0.1:1\"", "lisen"), ("listen = \"here\"", "listen"), ("tls = 1", "tls"), ("[", "1")]
        {
            std::fs::write(&path, text).unwrap();
            let error = Settings::read(&path).unwrap_err();
            assert!(error.contains("ground.toml") && error.contains(named), "{text}: {error}");
        }
        for seconds in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
            let settings = Settings { command_timeout_s: seconds, ..Settings::default() };
            assert!(settings.config().unwrap_err().contains("command_timeout_s"));
        }
        for origin in ["app.foxglove.dev", "https://app.foxglove.dev/", "https://a@b", "null", "https://"] {
            let settings = Settings { allow_origins: vec![origin.to_owned()], ..Settings::default() };
            let error = settings.config().unwrap_err();
            assert!(error.contains("allow_origins") && error.contains(origin), "{origin}: {error}");
        }
        let [e, none] = [Some("e".to_owned()), None];
        for (name, archive, index, named) in [
            (&none, &e, &e, "fleet_name is needed"),
            (&e, &e, &none, "fleet_archive without fleet_index"),
            (&e, &none, &e, "fleet_index without fleet_archive"),
        ] {
            let [fleet_name, fleet_archive, fleet_index] = [name, archive, index].map(Clone::clone);
            let settings = Settings { fleet_name, fleet_archive, fleet_index, ..Settings::default() };
            assert!(settings.config().unwrap_err().contains(named));
        }
        let half = Settings { key: Some("k.pem".into()), ..Settings::default() };
        assert!(half.own_certificate().unwrap_err().contains("certificate"));
    }
}
