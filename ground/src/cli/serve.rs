//! Serving: sockets, TLS, shutdown.

use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::path::PathBuf;

use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig};
use plumbline_ground::{GroundConfig, front};
use plumbline_link::identity;
use tokio::sync::mpsc;
use tracing_appender::non_blocking::WorkerGuard;

use super::DataFolder;

/// How long the link may take to say goodbye.
const GOODBYE: std::time::Duration = std::time::Duration::from_secs(2);
/// Events of the agents waiting for the ground.
const LINK_EVENTS: usize = 4096;

/// What to serve, and where.
#[derive(Debug, clap::Args)]
pub struct ServeArguments {
    /// Address of the page and the API. Anything but the loopback needs accounts, and is served by TLS.
    #[arg(long, default_value = "127.0.0.1:4747")]
    listen: SocketAddr,
    /// Address (UDP) that agents connect to.
    #[arg(long, visible_alias = "link", default_value = "127.0.0.1:4748")]
    agent_listen: SocketAddr,
    /// Folder of this ground's certificate and of the agents it trusts [default: DATA/identity].
    #[arg(long)]
    identity: Option<PathBuf>,
    #[command(flatten)]
    data: DataFolder,
    /// Host name, beside localhost and IP addresses, under which the page may be reached (repeatable).
    #[arg(long = "allow-host", value_name = "NAME")]
    allow_hosts: Vec<String>,
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

/// Serves until Ctrl-C.
///
/// # Errors
/// A sentence for people.
pub fn run(arguments: ServeArguments) -> Result<(), String> {
    let _log = start_log(arguments.json_log);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|error| format!("the runtime could not be started: {error}"))?.block_on(serve(arguments))
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

async fn serve(arguments: ServeArguments) -> Result<(), String> {
    let ServeArguments { listen, agent_listen, identity, data: DataFolder { data }, allow_hosts, .. } = arguments;
    let listener = tokio::net::TcpListener::bind(listen).await.map_err(|error| match error.kind() {
        std::io::ErrorKind::AddrInUse => format!("{listen} is occupied; choose another address with --listen"),
        _ => format!("cannot listen on {listen}: {error}"),
    })?;
    let address = listener.local_addr().map_err(|e| format!("cannot listen on {listen}: {e}"))?;
    let folder = identity.unwrap_or_else(|| data.join("identity"));
    let identity = identity::load_or_create(&folder).map_err(|e| format!("identity: {e}"))?;
    let link = AgentLink::bind(AgentLinkConfig::new(agent_listen, identity.clone())).map_err(|e| e.to_string())?;
    let mut config = GroundConfig::new(&data);
    config.link_identity = Some(identity);
    if arguments.tls || arguments.certificate.is_some() || !address.ip().is_loopback() {
        let (certificate, key) = match arguments.certificate.zip(arguments.key) {
            Some(own) => own,
            None => front::own(&data.join("tls"), &names(&address, &allow_hosts)).map_err(|e| e.to_string())?,
        };
        let (tls, fingerprint) = front::tls(&certificate, &key).map_err(|e| e.to_string())?;
        config.tls = Some(tls);
        println!("TLS certificate {}, SHA-256 {fingerprint}", certificate.display());
    }
    println!("Plumbline is at {}://{address}/", if config.tls.is_some() { "https" } else { "http" });
    println!("agents connect to udp://{}", link.local_addr());

    config.allowed_hosts = allow_hosts;
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
