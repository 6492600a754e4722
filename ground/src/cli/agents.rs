//! `plumbline-ground pair` and `plumbline-ground identity`: which agents this ground trusts.

use std::path::PathBuf;

use plumbline_link::identity::{Fingerprint, load_or_create, rotate};
use plumbline_link::pairing::{self, Code};

use super::DataFolder;

/// Where the identity of the link is kept.
#[derive(Debug, clap::Args)]
pub struct IdentityFolder {
    #[command(flatten)]
    data: DataFolder,
    /// Folder of this ground's certificate and of the agents it trusts [default: DATA/identity].
    #[arg(long)]
    identity: Option<PathBuf>,
}

impl IdentityFolder {
    fn path(&self) -> PathBuf {
        self.identity.clone().unwrap_or_else(|| self.data.data.join("identity"))
    }
}

/// The code that an agent shows.
#[derive(Debug, clap::Args)]
pub struct PairArguments {
    /// What `plumbline-agent pair` printed.
    code: String,
    #[command(flatten)]
    folder: IdentityFolder,
}

/// Lets the running ground accept the agent that knows the code.
///
/// # Errors
/// A sentence for people.
pub fn pair(arguments: &PairArguments) -> Result<(), String> {
    let folder = arguments.folder.path();
    // A ground makes it when it starts: made here, the code would wait where no ground looks.
    let certificate = folder.join("cert.pem");
    if !certificate.try_exists().map_err(|error| format!("{}: {error}", certificate.display()))? {
        return Err(format!("no ground has run in {}: name its folder by --data", folder.display()));
    }
    let code = Code::parse(&arguments.code).map_err(|error| error.to_string())?;
    pairing::expect(&folder, &code).map_err(|error| error.to_string())?;
    let minutes = pairing::VALID.as_secs() / 60;
    println!("the running ground of {} accepts the agent with this code for {minutes} minutes", folder.display());
    Ok(())
}

/// Whom to trust.
#[derive(Debug, clap::Args)]
pub struct IdentityArguments {
    #[command(flatten)]
    folder: IdentityFolder,
    /// Trust the agent with this fingerprint.
    #[arg(long, requires = "name")]
    trust: Option<String>,
    /// Its id, under which alone it may connect.
    #[arg(long)]
    name: Option<String>,
    /// Trust the agent of this name or fingerprint no more; its connection ends within a second.
    #[arg(long, value_name = "NAME")]
    revoke: Option<String>,
    /// Make a new certificate and key: every agent must be paired anew, after the ground was started again.
    #[arg(long)]
    rotate: bool,
}

/// Changes the trust and prints this ground's fingerprint.
///
/// # Errors
/// A sentence for people.
pub fn identity(arguments: &IdentityArguments) -> Result<(), String> {
    let folder = arguments.folder.path();
    let identity = if arguments.rotate { rotate(&folder) } else { load_or_create(&folder) };
    let identity = identity.map_err(|error| error.to_string())?;
    if let (Some(fingerprint), Some(name)) = (&arguments.trust, &arguments.name) {
        let fingerprint = Fingerprint::parse(fingerprint).map_err(|error| error.to_string())?;
        identity.enrol(fingerprint, name).map_err(|error| error.to_string())?;
    }
    if let Some(peer) = &arguments.revoke
        && identity.revoke(peer).map_err(|error| error.to_string())? == 0
    {
        return Err(format!("no agent is called {peer:?}"));
    }
    println!("{}", identity.fingerprint());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_is_left_only_where_a_ground_has_run() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let code = Code::random().unwrap().to_string();
        let identity = IdentityFolder { data: DataFolder { data: data.clone() }, identity: None };
        let arguments = PairArguments { code, folder: identity };
        let refused = pair(&arguments).unwrap_err();
        assert!(refused.contains("no ground has run in") && refused.contains("--data"), "{refused}");
        assert!(!data.exists(), "nothing is made");
        // What cannot be looked into is not taken for empty.
        std::fs::write(&data, "no folder").unwrap();
        let refused = pair(&arguments).unwrap_err();
        assert!(refused.contains("cert.pem: Not a directory"), "{refused}");
        std::fs::remove_file(&data).unwrap();
        load_or_create(&arguments.folder.path()).unwrap();
        pair(&arguments).unwrap();
        assert!(arguments.folder.path().join("pairing").exists());
    }
}
