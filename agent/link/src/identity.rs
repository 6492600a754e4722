//! Who one side of the link is, and whom it trusts.
//!
//! Each side keeps a folder of its own:
//!
//! | file | what |
//! |---|---|
//! | `cert.pem` | self-signed certificate |
//! | `key.pem` | its private key, readable by its owner only |
//! | `fingerprint` | SHA-256 of the certificate, to be carried to the other side |
//! | `peers` | one trusted fingerprint a line, then a name; `#` begins a comment |
//!
//! Trust is the fingerprint and nothing else: no authority, no expiry. At the ground the name behind it is the id under
//! which that agent connects, and no other ([`Identity::enrol`]). A line taken out of `peers` ends that trust within a
//! second; a line added is seen at once, because the file is read again whenever a peer is looked up (at most
//! [`RELOADS_PER_SECOND`]). A folder that has vanished (unmounted, moved) is not an empty one: without its `cert.pem`
//! nothing in it counts, what was read before stays in force, and nobody new is trusted.
//! Sessions are never resumed, so every connection shows its certificate.

mod fingerprint;

use std::collections::HashMap;
use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use sha2::{Digest, Sha256};

pub use fingerprint::Fingerprint;

/// How often an unknown certificate may make us read `peers` again.
pub const RELOADS_PER_SECOND: u32 = 10;

/// Largest `peers` file read.
const MAX_PEERS_BYTES: u64 = 1 << 20;

/// Why an identity cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// A file does not hold what it should.
    #[error("{path}: {reason}")]
    Malformed {
        /// File.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The folder is there no more.
    #[error("{path} has vanished or is another one; the peers known before stay trusted, nobody new is")]
    Vanished {
        /// The folder.
        path: PathBuf,
    },
    /// The name is another peer's.
    #[error("the name {name:?} belongs to {holder}: revoke that one first, or choose another name")]
    Taken {
        /// The name.
        name: String,
        /// Whose it is.
        holder: Fingerprint,
    },
    /// Not a fingerprint.
    #[error("{text:?} is not a fingerprint: sha256: and 64 hexadecimal digits are needed")]
    Fingerprint {
        /// What was found.
        text: String,
    },
    /// The certificate could not be made.
    #[error("no certificate could be made: {0}")]
    Generate(#[from] rcgen::Error),
    /// TLS refuses the certificate or the key.
    #[error("{path}: TLS refuses it: {reason}")]
    Tls {
        /// Folder of the identity.
        path: PathBuf,
        /// What TLS says.
        reason: String,
    },
}

/// One side of the link: its certificate and the peers it trusts. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Identity {
    inner: Arc<Inner>,
}

struct Inner {
    folder: PathBuf,
    certificate: CertificateDer<'static>,
    key: PrivateKeyDer<'static>,
    fingerprint: Fingerprint,
    peers: Mutex<Peers>,
    refused: AtomicU64,
    broken_off: AtomicU64,
}

impl fmt::Debug for Inner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The key stays out.
        f.debug_struct("Identity").field("folder", &self.folder).field("fingerprint", &self.fingerprint).finish()
    }
}

#[derive(Debug)]
struct Peers {
    names: HashMap<Fingerprint, String>,
    read: Instant,
    /// Why the file could not be read the last time.
    trouble: Option<String>,
}

/// Loads the identity in `folder`, or makes one there.
///
/// # Errors
/// [`IdentityError`] when the folder cannot be used or holds something else.
pub fn load_or_create(folder: &Path) -> Result<Identity, IdentityError> {
    fs::create_dir_all(folder).map_err(io_error(folder))?;
    let certificate_path = folder.join("cert.pem");
    let key_path = folder.join("key.pem");
    // A key alone is what a power cut left of an identity that nobody was shown.
    if !certificate_path.exists() {
        create(folder, &certificate_path, &key_path)?;
    }
    let certificate = CertificateDer::from_pem_file(&certificate_path)
        .map_err(|e| IdentityError::Malformed { path: certificate_path, reason: e.to_string() })?;
    let key = PrivateKeyDer::from_pem_file(&key_path)
        .map_err(|e| IdentityError::Malformed { path: key_path, reason: e.to_string() })?;
    let fingerprint = Fingerprint::of(&certificate);
    let (shown, text) = (folder.join("fingerprint"), format!("{fingerprint}\n"));
    // Only when it differs: an identity is of use on a disk that cannot be written, too.
    if fs::read_to_string(&shown).ok().as_deref() != Some(text.as_str()) {
        write_new(&shown, text.as_bytes(), 0o644)?;
    }
    let peers = Peers { names: read_peers(folder)?, read: Instant::now(), trouble: None };
    Ok(Identity {
        inner: Arc::new(Inner {
            folder: folder.to_owned(),
            certificate,
            key,
            fingerprint,
            peers: Mutex::new(peers),
            refused: AtomicU64::new(0),
            broken_off: AtomicU64::new(0),
        }),
    })
}

/// Gives the identity in `folder` a new certificate and key. Every peer must be paired anew; the old ones stay beside
/// the new as `*.old`.
///
/// # Errors
/// [`IdentityError`] when a file cannot be moved or made.
pub fn rotate(folder: &Path) -> Result<Identity, IdentityError> {
    // The certificate first: without it the rest is made anew, whatever comes between.
    for name in ["cert.pem", "key.pem"] {
        let path = folder.join(name);
        match fs::rename(&path, folder.join(format!("{name}.old"))) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(io_error(&path)(error)),
            _ => {}
        }
    }
    load_or_create(folder)
}

/// Makes two sides trust each other: first contact on one machine.
///
/// # Errors
/// [`IdentityError`] when a `peers` file cannot be written or the agent's id is another's.
pub fn pair(agent: &Identity, agent_id: &str, ground: &Identity) -> Result<(), IdentityError> {
    agent.trust(ground.fingerprint(), "ground")?;
    ground.enrol(agent.fingerprint(), agent_id)
}

impl Identity {
    /// Of this side's certificate.
    pub fn fingerprint(&self) -> Fingerprint {
        self.inner.fingerprint
    }

    /// A secret of this identity for the purpose `label`: the same after a restart, unknown to anyone else.
    pub fn secret(&self, label: &str) -> [u8; 32] {
        let mut hash = Sha256::new_with_prefix(b"plumbline ");
        hash.update(label.as_bytes());
        hash.update([0]);
        hash.update(self.inner.key.secret_der());
        hash.finalize().into()
    }

    /// Where it is kept.
    pub fn folder(&self) -> &Path {
        &self.inner.folder
    }

    /// Adds a peer to `peers`; nothing happens when it is there already.
    ///
    /// # Errors
    /// [`IdentityError`] when the file cannot be read or written.
    pub fn trust(&self, peer: Fingerprint, name: &str) -> Result<(), IdentityError> {
        let mut peers = self.peers();
        peers.names = self.read_peers()?;
        if peers.names.contains_key(&peer) {
            return Ok(());
        }
        self.add(&mut peers, peer, name)
    }

    /// Trusts a peer under a name that is its alone: the ground lets this agent connect by this id and by no other. A
    /// peer that is known already gets the new name.
    ///
    /// # Errors
    /// [`IdentityError::Taken`] when another peer has the name; others when the file cannot be read or written.
    pub fn enrol(&self, peer: Fingerprint, name: &str) -> Result<(), IdentityError> {
        let mut peers = self.peers();
        peers.names = self.read_peers()?;
        let holder = peers.names.iter().find(|(other, theirs)| **other != peer && theirs.as_str() == name);
        if let Some((holder, _)) = holder {
            return Err(IdentityError::Taken { name: name.to_owned(), holder: *holder });
        }
        match peers.names.get(&peer) {
            Some(known) if known == name => return Ok(()),
            Some(_) => self.remove(&mut peers, &[peer])?,
            None => {}
        }
        self.add(&mut peers, peer, name)
    }

    fn add(&self, peers: &mut Peers, peer: Fingerprint, name: &str) -> Result<(), IdentityError> {
        let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let path = peers_path(&self.inner.folder);
        let mut text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == io::ErrorKind::NotFound => String::new(),
            Err(source) => return Err(IdentityError::Io { path, source }),
        };
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        text.push_str(&format!("{peer} {name}\n"));
        write_new(&path, text.as_bytes(), 0o600)?;
        peers.names.insert(peer, name);
        Ok(())
    }

    /// Takes the lines of these peers out of the file.
    fn remove(&self, peers: &mut Peers, gone: &[Fingerprint]) -> Result<(), IdentityError> {
        let path = peers_path(&self.inner.folder);
        let text = fs::read_to_string(&path).map_err(io_error(&path))?;
        let stays = |line: &&str| {
            let digits = line.split_whitespace().next().unwrap_or_default();
            Fingerprint::parse(digits).map_or(true, |peer| !gone.contains(&peer))
        };
        let left: String = text.lines().filter(stays).map(|line| format!("{line}\n")).collect();
        write_new(&path, left.as_bytes(), 0o600)?;
        peers.names = self.read_peers()?;
        Ok(())
    }

    /// Ends the trust in the peers of this name or fingerprint: their connections are closed within a second, and they
    /// find no new ones. Answers how many there were.
    ///
    /// # Errors
    /// [`IdentityError`] when the file cannot be read or written.
    pub fn revoke(&self, name_or_fingerprint: &str) -> Result<usize, IdentityError> {
        let mut peers = self.peers();
        let known = self.read_peers()?;
        let wanted = Fingerprint::parse(name_or_fingerprint).ok();
        let meant = |peer: &Fingerprint, name: &str| wanted == Some(*peer) || name == name_or_fingerprint;
        let revoked: Vec<_> = known.iter().filter(|(peer, name)| meant(peer, name)).map(|(peer, _)| *peer).collect();
        if revoked.is_empty() {
            return Ok(0);
        }
        self.remove(&mut peers, &revoked)?;
        Ok(revoked.len())
    }

    /// Completes when `peer` is trusted no more.
    pub async fn revoked(&self, peer: Fingerprint) {
        while self.peer(peer).is_some() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }

    /// The name given to this peer, `None` when it is not trusted. An unknown peer makes us look
    /// into the file again.
    pub fn peer(&self, peer: Fingerprint) -> Option<String> {
        let mut peers = self.peers();
        // Every look is at the file as it stands, so that a revocation counts at once; only floods
        // of strangers are served from memory.
        if peers.read.elapsed() >= Duration::from_secs(1) / RELOADS_PER_SECOND {
            peers.read = Instant::now();
            match self.read_peers() {
                Ok(names) => {
                    peers.names = names;
                    peers.trouble = None;
                }
                // A file that cannot be read trusts nobody new: what is known stays. Logged once.
                Err(error) => {
                    let error = error.to_string();
                    if peers.trouble.as_ref() != Some(&error) {
                        tracing::error!(error, "the peers cannot be read");
                        peers.trouble = Some(error);
                    }
                }
            }
        }
        peers.names.get(&peer).cloned()
    }

    /// Why the peers cannot be read now; those read before stay trusted.
    pub fn trouble(&self) -> Option<String> {
        self.peers().trouble.clone()
    }

    /// The peers as the folder has them; an error when the folder is not the one this identity was loaded from.
    fn read_peers(&self) -> Result<HashMap<Fingerprint, String>, IdentityError> {
        let certificate = CertificateDer::from_pem_file(self.inner.folder.join("cert.pem"));
        // Another certificate is that of a rotation, which counts at the next start.
        if certificate.is_err() {
            return Err(IdentityError::Vanished { path: self.inner.folder.clone() });
        }
        read_peers(&self.inner.folder)
    }

    /// Peers refused for their certificate since the start.
    pub fn refused(&self) -> u64 {
        self.inner.refused.load(Ordering::Relaxed)
    }

    /// Checks a certificate shown by a peer; counts and reports refusals.
    pub(super) fn check(&self, certificate: &CertificateDer<'_>) -> Result<Fingerprint, Fingerprint> {
        let fingerprint = Fingerprint::of(certificate);
        if self.peer(fingerprint).is_some() {
            return Ok(fingerprint);
        }
        self.refuse(fingerprint);
        Err(fingerprint)
    }

    /// Counts and reports a peer that is not trusted.
    pub fn refuse(&self, fingerprint: Fingerprint) {
        let refused = self.inner.refused.fetch_add(1, Ordering::Relaxed);
        if refused < 10 || refused.is_multiple_of(100) {
            tracing::warn!(
                %fingerprint, refused = refused + 1, peers = %peers_path(&self.inner.folder).display(),
                "unpaired peer refused; pair it by its code, or add its fingerprint to the peers file"
            );
        }
    }

    /// Handshakes that came to nothing since the start: replayed packets, strangers, fades at the wrong moment.
    pub fn broken_off(&self) -> u64 {
        self.inner.broken_off.load(Ordering::Relaxed)
    }

    /// Counts a handshake that came to nothing.
    pub fn break_off(&self) {
        self.inner.broken_off.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn certificate(&self) -> CertificateDer<'static> {
        self.inner.certificate.clone()
    }

    pub(super) fn key(&self) -> PrivateKeyDer<'static> {
        self.inner.key.clone_key()
    }

    fn peers(&self) -> MutexGuard<'_, Peers> {
        self.inner.peers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn create(folder: &Path, certificate_path: &Path, key_path: &Path) -> Result<(), IdentityError> {
    let key = rcgen::KeyPair::generate()?;
    let mut params = rcgen::CertificateParams::new(vec![super::tls::SERVER_NAME.to_owned()])?;
    params.distinguished_name.push(rcgen::DnType::CommonName, "Plumbline");
    let certificate = params.self_signed(&key)?;
    // The key first: where a certificate is, its key is, too.
    write_new(key_path, key.serialize_pem().as_bytes(), 0o600)?;
    write_new(certificate_path, certificate.pem().as_bytes(), 0o644)?;
    tracing::info!(folder = %folder.display(), "a new identity was made");
    Ok(())
}

fn peers_path(folder: &Path) -> PathBuf {
    folder.join("peers")
}

fn read_peers(folder: &Path) -> Result<HashMap<Fingerprint, String>, IdentityError> {
    let path = peers_path(folder);
    let text = match fs::metadata(&path) {
        Ok(meta) if meta.len() > MAX_PEERS_BYTES => {
            let reason = format!("{} bytes, limit {MAX_PEERS_BYTES}", meta.len());
            return Err(IdentityError::Malformed { path, reason });
        }
        Ok(_) => fs::read_to_string(&path).map_err(io_error(&path))?,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(HashMap::new()),
        Err(source) => return Err(IdentityError::Io { path, source }),
    };
    let mut names = HashMap::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let (digits, name) = line.split_once(char::is_whitespace).unwrap_or((line, "peer"));
        match Fingerprint::parse(digits) {
            Ok(fingerprint) => {
                names.insert(fingerprint, name.trim().to_owned());
            }
            // One bad line must not lock out the others.
            Err(error) => tracing::warn!(file = %path.display(), line = number + 1, %error, "line skipped"),
        }
    }
    Ok(names)
}

/// Writes beside the target, then renames: a crash leaves the old file or the new one.
pub(super) fn write_new(path: &Path, bytes: &[u8], mode: u32) -> Result<(), IdentityError> {
    use std::os::unix::fs::OpenOptionsExt;
    let temporary = path.with_extension(format!("tmp{}", std::process::id()));
    let write = || -> io::Result<()> {
        let mut file = fs::OpenOptions::new().write(true).create(true).truncate(true).mode(mode).open(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    };
    write().map_err(io_error(path))
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> IdentityError + '_ {
    move |source| IdentityError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
