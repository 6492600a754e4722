//! `plumbline-agent identity`: first contact by hand.

use std::path::PathBuf;

use plumbline_agent::link::identity::{Fingerprint, load_or_create};

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
}

impl IdentityArguments {
    pub fn run(self) -> Result<(), Box<dyn std::error::Error>> {
        let identity = load_or_create(&self.identity)?;
        if let Some(fingerprint) = &self.trust {
            identity.trust(Fingerprint::parse(fingerprint)?, &self.name)?;
        }
        println!("{}", identity.fingerprint());
        Ok(())
    }
}
