//! Serving: sockets, TLS, shutdown.

use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::path::PathBuf;

use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig};
use plumbline_ground::front;
use plumbline_link::identity;
use tokio::sync::mpsc;
use tracing_appender::non_blocking::WorkerGuard;

use super::settings::Settings;

/// How long the link may take to say goodbye.
const GOODBYE: std::time::Duration = std::time::Duration::from_secs(2);
/// Events of the agents waiting for the ground.
const LINK_EVENTS: usize = 4096;

/// What to serve, and where. Options come before the configuration file, and that before the defaults.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ServeArguments {
    /// Configuration file (TOML); `--print-config` shows every key.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the configuration that results, every key with its meaning, and end.
    #[arg(long)]
    print_config: bool,
    /// Address of the page and the API [default: 127.0.0.1:4747]. Anything but the loopback needs accounts, and is
    /// served by TLS.
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// Address (UDP) that agents connect to [default: 127.0.0.1:4748].
    #[arg(long, visible_alias = "link")]
    agent_listen: Option<SocketAddr>,
    /// Folder of this ground's certificate and of the agents it trusts [default: DATA/identity].
    #[arg(long)]
    identity: Option<PathBuf>,
    /// Folder of flight files, index, gains book, identities, accounts and audit log [default: ./data].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Host name, beside localhost and IP addresses, under which the page may be reached (repeatable).
    #[arg(long = "allow-host", value_name = "NAME")]
    allow_hosts: Vec<String>,
    /// Page of others that may open the Foxglove link, and so command by it, such as https://app.foxglove.dev (repeatable).
    #[arg(long = "allow-origin", value_name = "ORIGIN")]
    allow_origins: Vec<String>,
    /// Serve the page by TLS on the loopback, too.
    #[arg(long)]
    tls: bool,
    /// Certificate chain (PEM) for the page [default: a self-signed one, made once in DATA/tls].
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// Its private key (PEM).
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
    /// Log as JSON lines instead of text. RUST_LOG sets the level.
    #[arg(long)]
    json_log: bool,
}

impl ServeArguments {
    /// What results of defaults, file and options.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn settings(&self) -> Result<Settings, String> {
        let mut all = self.config.as_deref().map_or_else(|| Ok(Settings::default()), Settings::read)?;
        let Self {
            listen,
            agent_listen,
            identity,
            data,
            allow_hosts,
            allow_origins,
            tls,
            certificate,
            key,
            json_log,
            ..
        } = self;
        all.listen = listen.unwrap_or(all.listen);
        all.agent_listen = agent_listen.unwrap_or(all.agent_listen);
        all.identity = identity.clone().or(all.identity);
        all.data = data.clone().unwrap_or(all.data);
        all.allow_hosts.extend(allow_hosts.iter().cloned());
        all.allow_origins.extend(allow_origins.iter().cloned());
        all.tls |= tls;
        all.certificate = certificate.clone().or(all.certificate);
        all.key = key.clone().or(all.key);
        all.json_log |= json_log;
        Ok(all)
    }
}

/// Serves until Ctrl-C.
///
/// # Errors
/// A sentence for people.
pub fn run(arguments: &ServeArguments) -> Result<(), String> {
    let settings = arguments.settings()?;
    if arguments.print_config {
        print!("{}", settings.print()?);
        return Ok(());
    }
    let _log = start_log(settings.json_log);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|error| format!("the runtime could not be started: {error}"))?.block_on(serve(&settings))
}

/// A thread of its own writes: a terminal that takes no more lines (Ctrl-S, a full pipe) holds up nothing else. What is
/// left is written when the guard is dropped.
fn start_log(json: bool) -> WorkerGuard {
    let (writer, guard) = tracing_appender::non_blocking(std::io::stderr());
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(writer)
        .with_ansi(std::io::stderr().is_terminal());
    if json {
        log.json().init();
    } else {
        log.init();
    }
    guard
}

async fn serve(settings: &Settings) -> Result<(), String> {
    let (listen, allow_hosts) = (settings.listen, &settings.allow_hosts);
    let mut config = settings.config()?;
    let own = settings.own_certificate()?;
    let listener = tokio::net::TcpListener::bind(listen).await.map_err(|error| match error.kind() {
        std::io::ErrorKind::AddrInUse => format!("{listen} is occupied; choose another address with --listen"),
        _ => format!("cannot listen on {listen}: {error}"),
    })?;
    let address = listener.local_addr().map_err(|e| format!("cannot listen on {listen}: {e}"))?;
    let identity = identity::load_or_create(&settings.identity_folder()).map_err(|e| format!("identity: {e}"))?;
    let link = AgentLinkConfig::new(settings.agent_listen, identity.clone());
    let link = AgentLink::bind(link).map_err(|e| e.to_string())?;
    config.link_identity = Some(identity);
    if settings.by_tls() {
        let (certificate, key) = match own {
            Some((certificate, key)) => (certificate.to_owned(), key.to_owned()),
            None => front::own(&settings.data.join("tls"), &names(&address, allow_hosts)).map_err(|e| e.to_string())?,
        };
        let (tls, fingerprint) = front::tls(&certificate, &key).map_err(|e| e.to_string())?;
        config.tls = Some(tls);
        println!("TLS certificate {}, SHA-256 {fingerprint}", certificate.display());
    }
    println!("Plumbline is at {}://{address}/", if config.tls.is_some() { "https" } else { "http" });
    println!("agents connect to udp://{}", link.local_addr());

    serving();
    let (stop, stopped) = tokio::sync::watch::channel(false);
    tokio::spawn(async move {
        interrupted().await;
        tracing::info!("stopping: open recordings are finished");
        stop.send_replace(true);
    });
    let (events, arriving) = mpsc::channel(LINK_EVENTS);
    let (mut link_until, mut ground_until) = (stopped.clone(), stopped);
    let agents = tokio::spawn(async move {
        let until = async move {
            let _ = link_until.wait_for(|stop| *stop).await;
        };
        if let Err(error) = link.run(events, until).await {
            tracing::error!(%error, "agents can no longer be reached");
        }
    });
    let served = plumbline_ground::run(config, listener, arriving, async move {
        let _ = ground_until.wait_for(|stop| *stop).await;
    })
    .await;
    // Time for a goodbye to the agents; they notice a silent end as well.
    let _ = tokio::time::timeout(GOODBYE, agents).await;
    served.map_err(|e| e.to_string())
}

/// Tells systemd, where it started this ground, that it serves, and from then on that its threads run.
fn serving() {
    let tell = |state| {
        if let Err(error) = sd_notify::notify(&[state]) {
            tracing::warn!(%error, "systemd is not reached");
        }
    };
    tell(sd_notify::NotifyState::Ready);
    if let Some(limit) = sd_notify::watchdog_enabled() {
        let mut due = tokio::time::interval(limit / 3);
        tokio::spawn(async move {
            loop {
                due.tick().await;
                tell(sd_notify::NotifyState::Watchdog);
            }
        });
    }
}

/// What the ground's own certificate stands for.
fn names(address: &SocketAddr, hosts: &[String]) -> Vec<String> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    if !address.ip().is_unspecified() {
        names.push(address.ip().to_string());
    }
    names.extend(hosts.iter().cloned());
    names.sort();
    names.dedup();
    names
}

/// Ctrl-C or a request to terminate.
async fn interrupted() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}
