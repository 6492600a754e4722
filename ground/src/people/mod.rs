//! Who may do what: accounts, sessions, roles.
//!
//! On the loopback without accounts there is one operator, who may do everything: whoever sits at this
//! machine. As soon as there is an account, everybody signs in; without one the ground does not serve
//! another address. Accounts are made by `plumbline-ground account`, and count within a quarter of a second.

mod accounts;
mod attempts;
mod role;
mod sessions;
pub(crate) mod throttle;
mod tickets;
mod totp;

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};
use std::time::Instant;

pub use accounts::{Account, AccountError, Accounts, MIN_PASSWORD};
use attempts::Attempts;
pub(crate) use attempts::origin;
pub use attempts::{FAILURES, FAILURES_WITHIN};
pub use role::{Access, Role};
pub(crate) use sessions::LONGEST_S as SESSION_LONGEST_S;
pub use sessions::{COOKIE, SessionKey, Sessions, Token};
use tickets::Tickets;
pub use tickets::VALID as TICKET_VALID;
pub use totp::Authenticator;

use plumbline_rest::people::SignedIn;

use crate::sync::{lock, wall_time_us};

/// Passwords checked at once; each takes 19 MiB and some ten milliseconds. Others wait for their turn.
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
    /// The password is right, and the account signs in by two steps.
    #[error("the code of your authenticator is needed")]
    CodeNeeded,
    /// Too many attempts.
    #[error("too many attempts; try again in {0} s")]
    Throttled(u64),
    /// Too many wait for their turn.
    #[error("too many people sign in at once; try again")]
    Busy,
    /// The accounts cannot be read.
    #[error("{0}")]
    Broken(String),
}

/// The people of this ground.
#[derive(Debug)]
pub struct People {
    accounts: Arc<Accounts>,
    /// With it ends the thread that looks at the accounts.
    _watched: Sender<()>,
    sessions: Sessions,
    tickets: Mutex<Tickets>,
    attempts: Mutex<Attempts>,
    /// The last step of an authenticator that each account signed in by: a code counts once.
    steps: Mutex<HashMap<String, u64>>,
    checks: Arc<tokio::sync::Semaphore>,
    loopback: bool,
    /// An account that commands without a session.
    standing: Option<String>,
}

impl People {
    /// The people of the ground in `data_folder` that serves `address`.
    pub fn open(data_folder: &Path, address: SocketAddr) -> Self {
        let folder = data_folder.join("people");
        let accounts = Arc::new(Accounts::in_folder(&folder).keeping_an_admin());
        Self {
            _watched: accounts.watch(),
            accounts,
            sessions: Sessions::open(&folder),
            tickets: Mutex::default(),
            attempts: Mutex::new(Attempts::new()),
            steps: Mutex::default(),
            checks: Arc::new(tokio::sync::Semaphore::new(CHECKS_AT_ONCE)),
            loopback: address.ip().is_loopback(),
            standing: None,
        }
    }

    /// The same, where `account` also commands without a session: that of a MAVLink station.
    pub fn with_standing(self, account: Option<String>) -> Self {
        Self { standing: account, ..self }
    }

    /// Who commands without a session: everybody where nobody signs in, else the standing account while there is one.
    pub fn standing(&self) -> Option<Person> {
        if !self.sign_in_needed() {
            return self.person(None);
        }
        let (name, accounts) = (self.standing.as_deref()?, self.accounts.known()?);
        let account = accounts.iter().find(|account| account.name == name)?;
        Some(Person { account: Some(name.to_owned()), role: account.role })
    }

    /// Must people sign in? Accounts that cannot be read are no reason to let everyone in.
    pub fn sign_in_needed(&self) -> bool {
        !self.loopback || !matches!(self.accounts.known(), Some(accounts) if accounts.is_empty())
    }

    /// The accounts.
    pub fn accounts(&self) -> &Accounts {
        &self.accounts
    }

    /// Who shows `token`; `None` when nobody known does.
    pub fn person(&self, token: Option<&Token>) -> Option<Person> {
        self.person_of(token.map(Token::key).as_ref())
    }

    /// Whose session `key` is; `None` when it is nobody's.
    pub fn person_of(&self, key: Option<&SessionKey>) -> Option<Person> {
        if !self.sign_in_needed() {
            return Some(Person { account: None, role: Role::Admin });
        }
        let accounts = self.accounts.known()?;
        let session = self.sessions.seen(key?)?;
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
        code: &str,
    ) -> Result<(Token, Person), SignInError> {
        let key = key(from, name);
        self.heard(&key)?;
        let check = {
            let _place = Place::take(&self.attempts, key.0)?;
            self.checks.clone().acquire_owned().await.map_err(|_| SignInError::Busy)?
        };
        // Others may have failed meanwhile.
        self.heard(&key)?;
        let (accounts, named) = (self.accounts.clone(), name.to_owned());
        let checked = tokio::task::spawn_blocking(move || {
            // Held until the check is over, also when nobody waits for it any more.
            let _check = check;
            // From the disk, so that an account counts as soon as it is made.
            let account = accounts.all()?.iter().find(|account| account.name == named).cloned();
            Ok::<_, AccountError>(accounts::verify(account, &password))
        });
        let checked = checked.await.unwrap_or(Ok(None));
        let account = checked.map_err(|error| SignInError::Broken(error.to_string()))?;
        let second = account.as_ref().map_or(Err(SignInError::Wrong), |account| self.second_step(account, code));
        let Some(account) = account.filter(|_| second.is_ok()) else {
            if second == Err(SignInError::Wrong) {
                lock(&self.attempts).failed(&key, Instant::now());
            }
            return Err(second.err().unwrap_or(SignInError::Wrong));
        };
        lock(&self.attempts).succeeded(&key);
        let token = self.sessions.begin(&account, from.map_or_else(String::new, |from| from.to_string())).await;
        Ok((token, Person { account: Some(account.name), role: account.role }))
    }

    fn second_step(&self, account: &Account, code: &str) -> Result<(), SignInError> {
        let authenticator = account.authenticator().map_err(|error| SignInError::Broken(error.to_string()))?;
        let Some(authenticator) = authenticator else { return Ok(()) };
        if code.is_empty() {
            return Err(SignInError::CodeNeeded);
        }
        let step = authenticator.step(code, wall_time_us() / 1_000_000).ok_or(SignInError::Wrong)?;
        let mut steps = lock(&self.steps);
        let last = steps.entry(account.name.clone()).or_default();
        if step <= *last {
            return Err(SignInError::Wrong);
        }
        *last = step;
        Ok(())
    }

    /// Is `code` what the authenticator of `account` shows, where it has one? Failures count with those of signing in.
    ///
    /// # Errors
    /// [`SignInError::Throttled`]; [`SignInError::Broken`] where there is nothing to check it by.
    pub fn confirmed(&self, from: Option<IpAddr>, account: &str, code: &str) -> Result<bool, SignInError> {
        let key = key(from, account);
        self.heard(&key)?;
        let unreadable = || SignInError::Broken("the accounts cannot be read".into());
        let accounts = self.accounts.known().ok_or_else(unreadable)?;
        let known = accounts.iter().find(|known| known.name == account);
        let authenticator = known.map(Account::authenticator).transpose();
        let authenticator = authenticator.map_err(|error| SignInError::Broken(error.to_string()))?.flatten();
        let right = authenticator.is_none_or(|it| it.step(code, wall_time_us() / 1_000_000).is_some());
        if !right {
            lock(&self.attempts).failed(&key, Instant::now());
        }
        Ok(right)
    }

    fn heard(&self, key: &(IpAddr, String)) -> Result<(), SignInError> {
        let wait = lock(&self.attempts).wait(key, Instant::now());
        wait.map_or(Ok(()), |wait| Err(SignInError::Throttled(wait.as_secs() + 1)))
    }

    /// Changes the accounts, as an admin does by the page: one of them stays an admin. Passwords are hashed in turn.
    ///
    /// # Errors
    /// [`AccountError`].
    pub async fn change(
        self: &Arc<Self>,
        act: impl FnOnce(&Accounts) -> Result<(), AccountError> + Send + 'static,
    ) -> Result<(), AccountError> {
        let people = self.clone();
        let check = self.checks.clone().acquire_owned().await.map_err(|_| AccountError::Random)?;
        let changed = tokio::task::spawn_blocking(move || {
            let _check = check;
            act(people.accounts())
        });
        changed.await.unwrap_or(Err(AccountError::Random))
    }

    /// The sessions of an account, or of everybody.
    pub fn sessions(&self, account: Option<&str>) -> Vec<SignedIn> {
        let Some(accounts) = self.accounts.known() else { return Vec::new() };
        self.sessions.list(|session| {
            account.is_none_or(|account| session.account == account)
                && accounts.iter().any(|a| a.name == session.account && a.stamp() == session.stamp)
        })
    }

    /// Ends a session of `account`, or of anybody; answers whether there was one.
    pub async fn end_session(&self, id: &str, account: Option<&str>) -> bool {
        self.sessions.end_shown(id, account).await
    }

    /// May whoever commands under this name go on? Not without an account that may, nor without a session of it.
    pub fn may_command(&self, name: &str) -> bool {
        if !self.sign_in_needed() {
            return true;
        }
        let Some(accounts) = self.accounts.known() else { return true };
        let may = accounts.iter().any(|account| account.name == name && Access::Operate.open_to(account.role));
        may && (self.standing.as_deref() == Some(name) || !self.sessions(Some(name)).is_empty())
    }

    /// A ticket by which a program without a session opens `path`, once, for the session of `key`.
    pub fn ticket(&self, key: SessionKey, path: &str) -> String {
        lock(&self.tickets).issue(key, path.to_owned(), Instant::now())
    }

    /// The session that a ticket for `path` stands for; it counts no more.
    pub fn redeem(&self, ticket: &str, path: &str) -> Option<SessionKey> {
        lock(&self.tickets).redeem(ticket, path, Instant::now())
    }

    /// Ends a session.
    pub async fn sign_out(&self, token: &Token) {
        self.sessions.end(token).await;
    }
}

/// What attempts are counted by.
fn key(from: Option<IpAddr>, account: &str) -> (IpAddr, String) {
    (origin(from), account.chars().take(accounts::MAX_NAME).collect())
}

/// A place among those that wait to sign in.
struct Place<'a>(&'a Mutex<Attempts>, IpAddr);

impl<'a> Place<'a> {
    fn take(attempts: &'a Mutex<Attempts>, from: IpAddr) -> Result<Self, SignInError> {
        if lock(attempts).queue(from) { Ok(Self(attempts, from)) } else { Err(SignInError::Busy) }
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        lock(self.0).leave(self.1);
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
    async fn an_account_with_an_authenticator_signs_in_by_two_steps_and_a_code_counts_once() {
        let folder = tempfile::tempdir().unwrap();
        let here = people(folder.path(), "127.0.0.1:1");
        let ann = Authenticator::new("ann").unwrap();
        here.accounts().add("eve", Role::Admin, ANN).unwrap();
        here.accounts().add("ann", Role::Operator, ANN).unwrap();
        here.accounts().set_totp("ann", Some(&ann)).unwrap();
        let sign_in =
            async |password: &str, code: &str| here.sign_in(None, "ann", password.into(), code).await.map(drop);
        assert_eq!(sign_in(ANN, "").await, Err(SignInError::CodeNeeded));
        assert_eq!(sign_in("a wrong password", "").await, Err(SignInError::Wrong), "a wrong password learns nothing");
        assert_eq!(sign_in(ANN, "12345").await, Err(SignInError::Wrong));
        let known = Authenticator::of("ann", &ann.secret()).unwrap();
        let code = known.code(wall_time_us() / 1_000_000);
        assert_eq!(sign_in(ANN, &code).await, Ok(()));
        assert_eq!(sign_in(ANN, &code).await, Err(SignInError::Wrong), "overlooked and used again");
        assert!(std::fs::read_to_string(folder.path().join("people/accounts.json")).unwrap().contains(&ann.secret()));
        // Another takes its place only after it was given up, by a code of it; guesses count with those of signing in.
        let other = Authenticator::new("ann").unwrap();
        assert!(matches!(here.accounts().set_totp("ann", Some(&other)), Err(AccountError::TwoSteps)));
        let now = || known.code(wall_time_us() / 1_000_000);
        assert_eq!(here.confirmed(None, "ann", &now()), Ok(true));
        let until_heard_no_more = (0..=FAILURES).map_while(|_| here.confirmed(None, "ann", "12345").ok());
        assert!(until_heard_no_more.eq([false; FAILURES as usize - 1]), "one failed above");
        assert!(matches!(here.confirmed(None, "ann", &now()), Err(SignInError::Throttled(_))));
        assert!(matches!(sign_in(ANN, &now()).await, Err(SignInError::Throttled(_))));
        here.accounts().set_totp("ann", None).unwrap();
        let elsewhere = here.sign_in("192.0.2.7".parse().ok(), "ann", ANN.into(), "").await;
        assert_eq!(elsewhere.map(drop), Ok(()));
    }

    #[tokio::test]
    async fn one_operator_at_this_machine_until_there_are_accounts() {
        let folder = tempfile::tempdir().unwrap();
        let here = people(folder.path(), "127.0.0.1:1");
        assert_eq!(here.person(None), Some(Person { account: None, role: Role::Admin }));
        assert_eq!(people(folder.path(), "0.0.0.0:1").person(None), None, "nobody enters from a network without one");
        Accounts::of(folder.path()).add("ann", Role::Operator, ANN).unwrap();
        while here.person(None).is_some() {
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }

        let address = "192.0.2.7".parse().ok();
        assert_eq!(here.sign_in(address, "ann", "wrong".into(), "").await.unwrap_err(), SignInError::Wrong);
        assert_eq!(here.sign_in(address, "bob", ANN.into(), "").await.unwrap_err(), SignInError::Wrong);
        let (token, person) = here.sign_in(address, "ann", ANN.into(), "").await.unwrap();
        assert_eq!(person, Person { account: Some("ann".into()), role: Role::Operator });
        assert_eq!(here.person(Some(&token)), Some(person.clone()));
        // Sessions outlive the ground: nobody is signed out in flight.
        let again = people(folder.path(), "127.0.0.1:1");
        assert_eq!(again.person(Some(&token)), Some(person));
        // A new password, a removal, or signing out ends them.
        Accounts::of(folder.path()).change("ann", None, Some("another password")).unwrap();
        here.accounts().all().unwrap();
        assert_eq!(here.person(Some(&token)), None);
        let (token, _) = here.sign_in(address, "ann", "another password".into(), "").await.unwrap();
        here.sign_out(&token).await;
        assert_eq!(here.person(Some(&token)), None);
        // A file that cannot be read lets nobody in.
        std::fs::write(folder.path().join("people/accounts.json"), "{").unwrap();
        assert!(here.accounts().all().is_err());
        assert_eq!(here.person(None), None);
    }

    #[tokio::test]
    async fn a_clock_that_was_set_back_lengthens_no_session() {
        let folder = tempfile::tempdir().unwrap();
        Accounts::of(folder.path()).add("ann", Role::Viewer, ANN).unwrap();
        let before = people(folder.path(), "0.0.0.0:1");
        let (token, _) = before.sign_in(None, "ann", ANN.into(), "").await.unwrap();
        let begun_s = before.sessions(None)[0].begun_s;
        drop(before);
        // GIVEN a session that a clock a year ahead began WHEN the ground starts with a right one THEN it begins now
        let path = folder.path().join("people/sessions.json");
        let kept = std::fs::read_to_string(&path).unwrap();
        let ahead = kept.replace(&begun_s.to_string(), &(begun_s + 31_536_000).to_string());
        assert_ne!(kept, ahead);
        std::fs::write(&path, ahead).unwrap();
        let after = people(folder.path(), "0.0.0.0:1");
        assert!(after.sessions(None)[0].begun_s <= begun_s + 60, "{:?}", after.sessions(None));
        assert!(after.person(Some(&token)).is_some());
    }

    #[tokio::test]
    async fn guessing_is_slowed_down() {
        let folder = tempfile::tempdir().unwrap();
        Accounts::of(folder.path()).add("ann", Role::Viewer, ANN).unwrap();
        let people = people(folder.path(), "0.0.0.0:1");
        let address = "192.0.2.7".parse().ok();
        for _ in 0..FAILURES {
            assert_eq!(people.sign_in(address, "ann", "guess".into(), "").await.unwrap_err(), SignInError::Wrong);
        }
        let right = people.sign_in(address, "ann", ANN.into(), "").await.unwrap_err();
        assert!(matches!(right, SignInError::Throttled(seconds) if seconds <= 301), "{right}");
        let (_, person) = people.sign_in("192.0.2.8".parse().ok(), "ann", ANN.into(), "").await.unwrap();
        assert_eq!(person.account.as_deref(), Some("ann"), "elsewhere it is the owner's");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn right_sign_ins_at_once_wait_for_their_turn() {
        let folder = tempfile::tempdir().unwrap();
        Accounts::of(folder.path()).add("ann", Role::Viewer, ANN).unwrap();
        let people = Arc::new(people(folder.path(), "0.0.0.0:1"));
        let mut all = tokio::task::JoinSet::new();
        for _ in 0..24 {
            let people = people.clone();
            all.spawn(async move { people.sign_in("192.0.2.7".parse().ok(), "ann", ANN.into(), "").await.map(drop) });
        }
        while let Some(outcome) = all.join_next().await {
            assert_eq!(outcome.unwrap(), Ok(()));
        }
        assert_eq!(people.sessions(Some("ann")).len(), 24);
    }

    #[tokio::test]
    async fn admins_manage_and_one_of_them_stays() {
        let folder = tempfile::tempdir().unwrap();
        let people = Arc::new(people(folder.path(), "127.0.0.1:1"));
        let add = |name: &'static str, role| people.change(move |accounts| accounts.add(name, role, ANN));
        assert!(matches!(add("ann", Role::Operator).await, Err(AccountError::LastAdmin)), "nobody could go on");
        add("ann", Role::Admin).await.unwrap();
        add("bob", Role::Operator).await.unwrap();
        let demoted = people.change(|accounts| accounts.change("ann", Some(Role::Viewer), None)).await;
        assert!(matches!(demoted, Err(AccountError::LastAdmin)));
        assert!(matches!(people.change(|accounts| accounts.remove("ann")).await, Err(AccountError::LastAdmin)));
        // The lease of an account ends with its role, its sessions, or itself.
        assert!(!people.may_command("bob"));
        let (token, _) = people.sign_in(None, "bob", ANN.into(), "").await.unwrap();
        assert!(people.may_command("bob"));
        people.change(|accounts| accounts.change("bob", Some(Role::Viewer), None)).await.unwrap();
        assert!(!people.may_command("bob") && people.person(Some(&token)).is_some());
        people.change(|accounts| accounts.change("bob", Some(Role::Attacker), None)).await.unwrap();
        let shown = people.sessions(None);
        assert!(people.may_command("bob") && shown.len() == 1);
        assert!(!people.end_session(&shown[0].id, Some("ann")).await);
        assert!(people.end_session(&shown[0].id, Some("bob")).await);
        assert!(!people.may_command("bob") && people.person(Some(&token)).is_none());
    }
}
