//! Accounts: `people/accounts.json`, passwords as Argon2id hashes, read again whenever it changes.
//!
//! Every request asks who there is, the motor cut as well, and waits for no disk: a thread of its own looks at the file
//! ([`Accounts::watch`]), and what it found last is in memory ([`Accounts::known`]).

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use argon2::Argon2;
use argon2::password_hash::{PasswordHash, PasswordHasher, PasswordVerifier, SaltString};
use plumbline_file::write_atomically;
use ring::rand::{SecureRandom as _, SystemRandom};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{Authenticator, Role};
use crate::sync::lock;

/// Longest name.
pub(super) const MAX_NAME: usize = 64;
/// Shortest password, characters.
pub const MIN_PASSWORD: usize = 10;
/// Longest password, bytes.
const MAX_PASSWORD: usize = 1024;
/// Most accounts.
const MAX_ACCOUNTS: usize = 1000;
/// How often the file is looked at: what another process changes counts after this long at most.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// One account.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// Who.
    pub name: String,
    /// What they may do.
    pub role: Role,
    /// Argon2id, in the PHC string format.
    password: String,
    /// Secret of its authenticator in base 32; `None` where a password is enough.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    totp: Option<String>,
}

impl Account {
    /// What its second step is checked by; `None` where a password is enough.
    ///
    /// # Errors
    /// [`AccountError::Secret`] where the file holds none that could be checked.
    pub fn authenticator(&self) -> Result<Option<Authenticator>, AccountError> {
        self.totp.as_ref().map(|secret| Authenticator::of(&self.name, secret)).transpose()
    }

    /// Does it sign in by two steps?
    pub fn two_steps(&self) -> bool {
        self.totp.is_some()
    }

    /// Changes with the password; says nothing about it.
    pub(super) fn stamp(&self) -> String {
        let digest = Sha256::digest(self.password.as_bytes());
        digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Why accounts cannot be used or changed.
#[derive(Debug, thiserror::Error)]
pub enum AccountError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is not what it should be.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Not a name.
    #[error("{0:?} is no name: 1 to {MAX_NAME} letters, digits, '.', '-' or '_' are needed")]
    Name(String),
    /// Taken.
    #[error("there is an account {0:?} already")]
    Exists(String),
    /// Not there.
    #[error("there is no account {0:?}")]
    Unknown(String),
    /// Too short or too long.
    #[error("the password has {0} characters: at least {MIN_PASSWORD} are needed, {MAX_PASSWORD} bytes at most")]
    Password(usize),
    /// The system gives no random numbers.
    #[error("the system gives no random numbers")]
    Random,
    /// No secret of an authenticator.
    #[error("this is no secret of an authenticator: 16 to 64 bytes in base 32 are needed")]
    Secret,
    /// Not the code of now.
    #[error("this is not the code that the authenticator shows now; is its clock right?")]
    Code,
    /// Its authenticator is given up by a code of it, before there is another.
    #[error("this account signs in by two steps already: its authenticator is given up first")]
    TwoSteps,
    /// Too many.
    #[error("there are {MAX_ACCOUNTS} accounts already")]
    Full,
    /// Nobody could manage the others any more.
    #[error("one account has to be an admin; the last one is made, and goes, by `plumbline-ground account`")]
    LastAdmin,
}

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    accounts: Vec<Account>,
}

type Stamp = Option<(SystemTime, u64)>;

/// The accounts of a folder.
#[derive(Debug)]
pub struct Accounts {
    path: PathBuf,
    /// Held for memory only.
    read: Mutex<Option<(Stamp, Arc<Vec<Account>>)>>,
    /// The last look at the file did not tell who there is.
    unreadable: AtomicBool,
    /// Held while the file is changed.
    changing: Mutex<()>,
    admin_stays: bool,
}

impl Accounts {
    /// The accounts of a ground's data folder.
    pub fn of(data_folder: &Path) -> Self {
        Self::in_folder(&data_folder.join("people"))
    }

    pub(super) fn in_folder(folder: &Path) -> Self {
        Self {
            path: folder.join("accounts.json"),
            read: Mutex::new(None),
            unreadable: AtomicBool::new(false),
            changing: Mutex::new(()),
            admin_stays: false,
        }
    }

    /// Refuses every change after which no account would be an admin.
    pub(super) fn keeping_an_admin(self) -> Self {
        Self { admin_stays: true, ..self }
    }

    fn stamp(&self) -> Result<Stamp, AccountError> {
        match fs::metadata(&self.path) {
            Ok(meta) => Ok(Some((meta.modified().unwrap_or(SystemTime::UNIX_EPOCH), meta.len()))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(AccountError::Io { path: self.path.clone(), source }),
        }
    }

    /// Looks at the file, and from then on every quarter of a second on a thread of its own, until what is answered is
    /// dropped.
    pub(super) fn watch(self: &Arc<Self>) -> Sender<()> {
        // What is wrong with the file is told by whoever reads it for more than who may enter.
        let _ = self.all();
        let (watched, ended) = channel();
        let accounts = self.clone();
        let look = move || {
            while ended.recv_timeout(LOOK_EVERY) == Err(RecvTimeoutError::Timeout) {
                let _ = accounts.all();
            }
        };
        if let Err(error) = std::thread::Builder::new().name("accounts".into()).spawn(look) {
            tracing::error!(%error, "what another process makes of the accounts is not seen: no thread");
        }
        watched
    }

    /// All accounts, as the last look or change found them; `None` where the file could not be read or makes no sense.
    /// Waits for nothing.
    pub fn known(&self) -> Option<Arc<Vec<Account>>> {
        let read = lock(&self.read).as_ref().map(|(_, accounts)| accounts.clone());
        read.filter(|_| !self.unreadable.load(Ordering::Relaxed))
    }

    /// All accounts; none where there is no file. A file that has vanished (its disk was unmounted, its folder moved)
    /// is not one without accounts: those read last still count. Asks the disk.
    ///
    /// # Errors
    /// [`AccountError`] when the file cannot be read or makes no sense.
    pub fn all(&self) -> Result<Arc<Vec<Account>>, AccountError> {
        let read = self.look();
        self.unreadable.store(read.is_err(), Ordering::Relaxed);
        read
    }

    fn look(&self) -> Result<Arc<Vec<Account>>, AccountError> {
        let stamp = self.stamp()?;
        if let Some((known, accounts)) = &mut *lock(&self.read) {
            let vanished = stamp.is_none() && !accounts.is_empty();
            if vanished && known.take().is_some() {
                tracing::error!(path = %self.path.display(), "the accounts have vanished; those read last still count");
            }
            if vanished || *known == stamp {
                return Ok(accounts.clone());
            }
        }
        // Not under the lock: the disk may take its time.
        let file = match stamp {
            None => File::default(),
            Some(_) => {
                let text =
                    fs::read(&self.path).map_err(|source| AccountError::Io { path: self.path.clone(), source })?;
                serde_json::from_slice(&text)
                    .map_err(|e| AccountError::Malformed { path: self.path.clone(), reason: e.to_string() })?
            }
        };
        let accounts = Arc::new(file.accounts);
        *lock(&self.read) = Some((stamp, accounts.clone()));
        Ok(accounts)
    }

    /// Adds an account.
    ///
    /// # Errors
    /// [`AccountError`].
    pub fn add(&self, name: &str, role: Role, password: &str) -> Result<(), AccountError> {
        let good = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        if name.is_empty() || name.len() > MAX_NAME || !name.chars().all(good) {
            return Err(AccountError::Name(crate::names::clip(name)));
        }
        let _changing = lock(&self.changing);
        let mut accounts = self.all()?.to_vec();
        if accounts.iter().any(|account| account.name == name) {
            return Err(AccountError::Exists(name.to_owned()));
        }
        if accounts.len() >= MAX_ACCOUNTS {
            return Err(AccountError::Full);
        }
        accounts.push(Account { name: name.to_owned(), role, password: hash(password)?, totp: None });
        self.write(accounts)
    }

    /// Removes an account; its sessions end.
    ///
    /// # Errors
    /// [`AccountError`].
    pub fn remove(&self, name: &str) -> Result<(), AccountError> {
        let _changing = lock(&self.changing);
        let mut accounts = self.all()?.to_vec();
        let before = accounts.len();
        accounts.retain(|account| account.name != name);
        if accounts.len() == before {
            return Err(AccountError::Unknown(crate::names::clip(name)));
        }
        self.write(accounts)
    }

    /// Gives an account another role or password; a new password ends its sessions.
    ///
    /// # Errors
    /// [`AccountError`].
    pub fn change(&self, name: &str, role: Option<Role>, password: Option<&str>) -> Result<(), AccountError> {
        let password = password.map(hash).transpose()?;
        self.edit(name, |account| {
            account.role = role.unwrap_or(account.role);
            account.password = password.unwrap_or_else(|| account.password.clone());
            Ok(())
        })
    }

    /// Makes an account sign in by two steps, or by its password alone.
    ///
    /// # Errors
    /// [`AccountError`]; [`AccountError::TwoSteps`] where another authenticator would take the place of one.
    pub fn set_totp(&self, name: &str, with: Option<&Authenticator>) -> Result<(), AccountError> {
        self.edit(name, |account| {
            if with.is_some() && account.two_steps() {
                return Err(AccountError::TwoSteps);
            }
            account.totp = with.map(Authenticator::secret);
            Ok(())
        })
    }

    fn edit(
        &self,
        name: &str,
        change: impl FnOnce(&mut Account) -> Result<(), AccountError>,
    ) -> Result<(), AccountError> {
        let _changing = lock(&self.changing);
        let mut accounts = self.all()?.to_vec();
        let account = accounts.iter_mut().find(|account| account.name == name);
        let account = account.ok_or_else(|| AccountError::Unknown(crate::names::clip(name)))?;
        change(account)?;
        self.write(accounts)
    }

    fn write(&self, accounts: Vec<Account>) -> Result<(), AccountError> {
        if self.admin_stays && !accounts.iter().any(|account| account.role == Role::Admin) {
            return Err(AccountError::LastAdmin);
        }
        let accounts = Arc::new(accounts);
        let text = serde_json::to_vec_pretty(&File { accounts: accounts.to_vec() })
            .map_err(|e| AccountError::Malformed { path: self.path.clone(), reason: e.to_string() })?;
        write_private(&self.path, &text).map_err(|source| AccountError::Io { path: self.path.clone(), source })?;
        *lock(&self.read) = Some((self.stamp()?, accounts));
        Ok(())
    }
}

/// Writes a file into a folder that only its owner may enter.
pub(super) fn write_private(path: &Path, text: &[u8]) -> io::Result<()> {
    use std::os::unix::fs::DirBuilderExt as _;
    if let Some(folder) = path.parent() {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    }
    write_atomically(path, text)
}

fn hash(password: &str) -> Result<String, AccountError> {
    let length = password.chars().count();
    if length < MIN_PASSWORD || password.len() > MAX_PASSWORD {
        return Err(AccountError::Password(length));
    }
    let mut bytes = [0; 16];
    SystemRandom::new().fill(&mut bytes).map_err(|_| AccountError::Random)?;
    // Neither fails for a salt of this length and the default parameters.
    let salt = SaltString::encode_b64(&bytes).map_err(|_| AccountError::Random)?;
    let hash = Argon2::default().hash_password(password.as_bytes(), &salt);
    Ok(hash.map_err(|_| AccountError::Password(length))?.to_string())
}

/// The account, when the password is its. Takes as long when there is no such account.
pub(super) fn verify(account: Option<Account>, password: &str) -> Option<Account> {
    const NOBODY: &str =
        "$argon2id$v=19$m=19456,t=2,p=1$AAAAAAAAAAAAAAAAAAAAAA$AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";
    let kept = account.as_ref().map_or(NOBODY, |account| account.password.as_str());
    let right =
        PasswordHash::new(kept).is_ok_and(|kept| Argon2::default().verify_password(password.as_bytes(), &kept).is_ok());
    account.filter(|_| right && password.len() <= MAX_PASSWORD)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accounts_are_checked_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let accounts = Accounts::of(folder.path());
        assert!(accounts.all().unwrap().is_empty());
        assert_eq!(
            accounts.add("ann", Role::Admin, "short").unwrap_err().to_string(),
            "the password has 5 characters: at least 10 are needed, 1024 bytes at most"
        );
        assert!(accounts.add("ann smith", Role::Admin, "long enough, surely").is_err());
        accounts.add("ann", Role::Admin, "long enough, surely").unwrap();
        assert!(matches!(accounts.add("ann", Role::Viewer, "long enough, surely"), Err(AccountError::Exists(_))));
        let kept = fs::read_to_string(folder.path().join("people/accounts.json")).unwrap();
        assert!(kept.contains("$argon2id$") && !kept.contains("surely"));
        // Another process changes the file.
        Accounts::of(folder.path()).remove("ann").unwrap();
        assert!(accounts.all().unwrap().is_empty());
        assert!(matches!(accounts.remove("ann"), Err(AccountError::Unknown(_))));
    }

    #[test]
    fn accounts_that_vanished_are_not_none() {
        let folder = tempfile::tempdir().unwrap();
        let accounts = Accounts::of(folder.path());
        accounts.add("ann", Role::Admin, "long enough, surely").unwrap();
        let (here, away) = (folder.path().join("people"), folder.path().join("away"));
        fs::rename(&here, &away).unwrap();
        assert_eq!(accounts.all().unwrap().len(), 1);
        fs::rename(&away, &here).unwrap();
        Accounts::of(folder.path()).remove("ann").unwrap();
        assert!(accounts.all().unwrap().is_empty(), "an empty file is");
    }
}
