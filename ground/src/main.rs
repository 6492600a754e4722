//! `plumbline-ground`: arguments, sockets, shutdown.

use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use plumbline_agent::link::identity;
use plumbline_ground::GroundConfig;
use plumbline_ground::agent_link::{AgentLink, AgentLinkConfig};
use tokio::sync::mpsc;

/// How long the link may take to say goodbye.
const GOODBYE: std::time::Duration = std::time::Duration::from_secs(2);
/// Events of the agents waiting for the ground.
const LINK_EVENTS: usize = 4096;

/// The ground server of Plumbline: records flights, passes commands, serves the page.
#[derive(Debug, Parser)]
#[command(name = "plumbline-ground", version)]
struct Arguments {
    /// Address of the page and the API.
    #[arg(long, default_value = "127.0.0.1:4747")]
    listen: SocketAddr,
    /// Address (UDP) that agents connect to.
    #[arg(long, visible_alias = "link", default_value = "127.0.0.1:4748")]
    agent_listen: SocketAddr,
    /// Folder of this ground's certificate and of the agents it trusts [default: DATA/identity].
    #[arg(long)]
    identity: Option<PathBuf>,
    /// Folder of flight files, index and gains book.
    #[arg(long, default_value = "./data")]
    data: PathBuf,
    /// Host name, beside localhost and IP addresses, under which the page may be reached (repeatable).
    #[arg(long = "allow-host", value_name = "NAME")]
    allow_hosts: Vec<String>,
    /// Log as JSON lines instead of text. RUST_LOG sets the level.
    #[arg(long)]
    json_log: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    start_log(arguments.json_log);
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return fail(&format!("the runtime could not be started: {error}")),
    };
    match runtime.block_on(serve(arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(text) => fail(&text),
    }
}

fn fail(text: &str) -> ExitCode {
    eprintln!("plumbline-ground: {text}");
    ExitCode::FAILURE
}

fn start_log(json: bool) {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    if json {
        log.json().init();
    } else {
        log.init();
    }
}

async fn serve(arguments: Arguments) -> Result<(), String> {
    let Arguments { listen, agent_listen, identity, data, allow_hosts, json_log: _ } = arguments;
    let listener = tokio::net::TcpListener::bind(listen).await.map_err(|error| match error.kind() {
        std::io::ErrorKind::AddrInUse => format!("{listen} is occupied; choose another address with --listen"),
        _ => format!("cannot listen on {listen}: {error}"),
    })?;
    let address = listener.local_addr().map_err(|e| format!("cannot listen on {listen}: {e}"))?;
    let folder = identity.unwrap_or_else(|| data.join("identity"));
    let identity = identity::load_or_create(&folder).map_err(|e| format!("identity: {e}"))?;
    let link = AgentLink::bind(AgentLinkConfig::new(agent_listen, identity)).map_err(|e| e.to_string())?;
    println!("Plumbline is at http://{address}/");
    println!("agents connect to udp://{}", link.local_addr());

    let mut config = GroundConfig::new(data);
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
