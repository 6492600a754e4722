//! `plumbline-agent identity` and `plumbline-agent pair`: whom this agent trusts.

use std::io::Write as _;
use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use plumbline_agent::config::AgentConfig;
use plumbline_agent::link::identity::{Fingerprint, load_or_create, rotate};
use plumbline_agent::link::pairing::{self, Code, PairingError};

/// Time between two attempts to pair, while the code is carried to the ground.
const AGAIN: Duration = Duration::from_secs(2);

#[derive(Debug, clap::Args)]
pub struct IdentityArguments {
    /// Folder of the identity.
    #[arg(long, default_value = "data/agent/identity")]
    identity: PathBuf,
    /// Trust the ground with this fingerprint.
    #[arg(long)]
    trust: Option<String>,
    /// Name to remember it by.
    #[arg(long, default_value = "ground")]
    name: String,
    /// Trust the ground of this name or fingerprint no more.
    #[arg(long, value_name = "NAME")]
    revoke: Option<String>,
    /// Make a new certificate and key: the ground must be paired anew.
    #[arg(long)]
    rotate: bool,
}

impl IdentityArguments {
    pub fn run(self) -> Result<(), super::Failure> {
        let identity = if self.rotate { rotate(&self.identity)? } else { load_or_create(&self.identity)? };
        if let Some(fingerprint) = &self.trust {
            identity.trust(Fingerprint::parse(fingerprint)?, &self.name)?;
        }
        if let Some(peer) = &self.revoke
            && identity.revoke(peer)? == 0
        {
            return Err(format!("no peer is called {peer:?}").into());
        }
        Ok(writeln!(std::io::stdout(), "{}", identity.fingerprint())?)
    }
}

#[derive(Debug, clap::Args)]
pub struct PairArguments {
    /// Configuration file (TOML): id, ground and identity are taken from it.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Ground to pair with, `host:port`.
    #[arg(long)]
    ground: Option<String>,
    /// Name of this agent.
    #[arg(long)]
    id: Option<String>,
    /// Folder of the identity.
    #[arg(long)]
    identity: Option<PathBuf>,
}

impl PairArguments {
    pub fn run(self) -> Result<(), super::Failure> {
        let config = match &self.config {
            Some(path) => AgentConfig::read(path)?,
            None => AgentConfig::default(),
        };
        let id = self.id.unwrap_or(config.id);
        let ground = self.ground.unwrap_or(config.ground);
        let identity = load_or_create(&self.identity.unwrap_or(config.identity))?;
        let code = Code::random()?;
        let mut out = std::io::stdout();
        writeln!(out, "pairing code: {code}")?;
        let minutes = pairing::VALID.as_secs() / 60;
        writeln!(out, "On the ground, within {minutes} minutes:  plumbline-ground pair {code}")?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let begun = Instant::now();
        let mut told = String::new();
        while begun.elapsed() < pairing::VALID {
            let address = ground.to_socket_addrs()?.next().ok_or_else(|| format!("{ground:?} has no address"))?;
            match runtime.block_on(pairing::meet(address, &identity, &id, &code)) {
                Ok(fingerprint) => {
                    return Ok(writeln!(out, "paired with the ground {fingerprint}")?);
                }
                Err(PairingError::Identity(error)) => return Err(error.into()),
                Err(error) => {
                    let text = error.to_string();
                    if text != told {
                        eprintln!("waiting: {text}");
                        told = text;
                    }
                }
            }
            std::thread::sleep(AGAIN);
        }
        Err("nobody entered the code in time".into())
    }
}
