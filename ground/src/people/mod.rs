//! Who may do what: accounts, sessions, roles.
//!
//! On the loopback without accounts there is one operator, who may do everything: whoever sits at this
//! machine. As soon as there is an account, everybody signs in; without one the ground does not serve
//! another address. Accounts are made by `plumbline-ground account`, and count at once.

mod accounts;
mod role;
mod sessions;
mod throttle;

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};

pub use accounts::{Account, AccountError, Accounts, MIN_PASSWORD};
pub use role::{Access, Role};
pub(crate) use sessions::LONGEST_S as SESSION_LONGEST_S;
pub use sessions::{COOKIE, Sessions, Token};
use throttle::Throttle;

use crate::sync::lock;

/// Failed attempts to sign in that one address, or one account, may make …
pub const FAILURES: u32 = 10;
/// … within this time; more are turned away unheard.
pub const FAILURES_WITHIN: Duration = Duration::from_secs(300);
/// Passwords checked at once; each takes 19 MiB and some ten milliseconds.
const CHECKS_AT_ONCE: usize = 2;

/// A signed-in person, or whoever sits at this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Person {
    /// Account; `None` where none is needed.
    pub account: Option<String>,
    /// What they may do.
    pub role: Role,
}

/// Why nobody was signed in.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SignInError {
    /// Wrong name or password; not said which.
    #[error("name or password is wrong")]
    Wrong,
    /// Too many attempts.
    #[error("too many attempts; try again in {0} s")]
    Throttled(u64),
    /// Too many passwords are being checked.
    #[error("too many people sign in at once; try again")]
    Busy,
    /// The accounts cannot be read.
    #[error("{0}")]
    Broken(String),
}

/// The people of this ground.
#[derive(Debug)]
pub struct People {
    accounts: Accounts,
    sessions: Sessions,
    by_address: Mutex<Throttle<IpAddr>>,
    by_account: Mutex<Throttle<String>>,
    checks: tokio::sync::Semaphore,
    loopback: bool,
}

impl People {
    /// The people of the ground in `data_folder` that serves `address`.
    pub fn open(data_folder: &Path, address: SocketAddr) -> Self {
        let folder = data_folder.join("people");
        Self {
            accounts: Accounts::in_folder(&folder),
            sessions: Sessions::open(&folder),
            by_address: Mutex::new(Throttle::new(FAILURES, FAILURES_WITHIN)),
            by_account: Mutex::new(Throttle::new(FAILURES, FAILURES_WITHIN)),
            checks: tokio::sync::Semaphore::new(CHECKS_AT_ONCE),
            loopback: address.ip().is_loopback(),
        }
    }

    /// Must people sign in? Accounts that cannot be read are no reason to let everyone in.
    pub fn sign_in_needed(&self) -> bool {
        !self.loopback || !matches!(self.accounts.all(), Ok(accounts) if accounts.is_empty())
    }

    /// The accounts.
    pub fn accounts(&self) -> &Accounts {
        &self.accounts
    }

    /// Who shows `token`; `None` when nobody known does.
    pub fn person(&self, token: Option<&Token>) -> Option<Person> {
        if !self.sign_in_needed() {
            return Some(Person { account: None, role: Role::Admin });
        }
        let accounts = self.accounts.all().ok()?;
        let session = self.sessions.seen(token?)?;
        // An account that was removed, or has a new password, ends its sessions.
        let account = accounts.iter().find(|account| account.name == session.account)?;
        (account.stamp() == session.stamp).then_some(Person { account: Some(session.account), role: account.role })
    }

    /// Checks a password and begins a session.
    ///
    /// # Errors
    /// [`SignInError`].
    pub async fn sign_in(
        &self,
        from: Option<IpAddr>,
        name: &str,
        password: String,
    ) -> Result<(Token, Person), SignInError> {
        let now = Instant::now();
        let key: String = name.chars().take(accounts::MAX_NAME).collect();
        let wait = lock(&self.by_account).wait(&key, now);
        let wait = wait.max(from.and_then(|from| lock(&self.by_address).wait(&from, now)));
        if let Some(wait) = wait {
            return Err(SignInError::Throttled(wait.as_secs() + 1));
        }
        // Counted before it is checked: attempts at the same time count each.
        lock(&self.by_account).failed(key.clone(), now);
        if let Some(from) = from {
            lock(&self.by_address).failed(from, now);
        }
        let _check = self.checks.try_acquire().map_err(|_| SignInError::Busy)?;
        let accounts = self.accounts.all().map_err(|error| SignInError::Broken(error.to_string()))?;
        let account = accounts.iter().find(|account| account.name == name).cloned();
        let checked = tokio::task::spawn_blocking(move || accounts::verify(account, &password)).await;
        let account = checked.ok().flatten().ok_or(SignInError::Wrong)?;
        lock(&self.by_account).forgive(&key);
        if let Some(from) = from {
            lock(&self.by_address).forgive(&from);
        }
        let token = self.sessions.begin(&account);
        Ok((token, Person { account: Some(account.name), role: account.role }))
    }

    /// Ends a session.
    pub fn sign_out(&self, token: &Token) {
        self.sessions.end(token);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANN: &str = "correct horse battery";

    fn people(folder: &Path, address: &str) -> People {
        People::open(folder, address.parse().unwrap())
    }

    #[tokio::test]
    async fn one_operator_at_this_machine_until_there_are_accounts() {
        let folder = tempfile::tempdir().unwrap();
        let here = people(folder.path(), "127.0.0.1:1");
        assert_eq!(here.person(None), Some(Person { account: None, role: Role::Admin }));
        assert_eq!(people(folder.path(), "0.0.0.0:1").person(None), None, "nobody enters from a network without one");
        Accounts::of(folder.path()).add("ann", Role::Operator, ANN).unwrap();
        assert_eq!(here.person(None), None, "counts at once");

        let address = "192.0.2.7".parse().ok();
        assert_eq!(here.sign_in(address, "ann", "wrong".into()).await.unwrap_err(), SignInError::Wrong);
        assert_eq!(here.sign_in(address, "bob", ANN.into()).await.unwrap_err(), SignInError::Wrong);
        let (token, person) = here.sign_in(address, "ann", ANN.into()).await.unwrap();
        assert_eq!(person, Person { account: Some("ann".into()), role: Role::Operator });
        assert_eq!(here.person(Some(&token)), Some(person.clone()));
        // Sessions outlive the ground: nobody is signed out in flight.
        let again = people(folder.path(), "127.0.0.1:1");
        assert_eq!(again.person(Some(&token)), Some(person));
        // A new password, a removal, or signing out ends them.
        Accounts::of(folder.path()).set_password("ann", "another password").unwrap();
        assert_eq!(here.person(Some(&token)), None);
        let (token, _) = here.sign_in(address, "ann", "another password".into()).await.unwrap();
        here.sign_out(&token);
        assert_eq!(here.person(Some(&token)), None);
        // A file that cannot be read lets nobody in.
        std::fs::write(folder.path().join("people/accounts.json"), "{").unwrap();
        assert_eq!(here.person(None), None);
    }

    #[tokio::test]
    async fn guessing_is_slowed_down() {
        let folder = tempfile::tempdir().unwrap();
        Accounts::of(folder.path()).add("ann", Role::Viewer, ANN).unwrap();
        let people = people(folder.path(), "0.0.0.0:1");
        let address = "192.0.2.7".parse().ok();
        for _ in 0..FAILURES {
            assert_eq!(people.sign_in(address, "ann", "guess".into()).await.unwrap_err(), SignInError::Wrong);
        }
        let right = people.sign_in(address, "ann", ANN.into()).await.unwrap_err();
        assert!(matches!(right, SignInError::Throttled(seconds) if seconds <= 301), "{right}");
        let elsewhere = people.sign_in("192.0.2.8".parse().ok(), "ann", ANN.into()).await.unwrap_err();
        assert!(matches!(elsewhere, SignInError::Throttled(_)), "the account, too: {elsewhere}");
    }
}
