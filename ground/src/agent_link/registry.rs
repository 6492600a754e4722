//! Which agents are connected; one session per id.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use plumbline_link::identity::Fingerprint;
use plumbline_link::transport::CloseCode;
use quinn::Connection;
use tokio::sync::watch;

/// An agent that has not answered for this long may be replaced by its own restart.
pub const ANSWERS_WITHIN: Duration = Duration::from_millis(500);

/// Who an agent says and proves it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Who {
    /// Its name.
    pub agent_id: String,
    /// This start of it.
    pub boot_id: u64,
    /// Its certificate.
    pub fingerprint: Fingerprint,
}

/// The sessions.
#[derive(Debug, Default, Clone)]
pub struct Registry {
    sessions: Arc<Mutex<HashMap<String, Session>>>,
}

#[derive(Debug)]
struct Session {
    who: Who,
    commands: Connection,
    telemetry: Option<Connection>,
    heard: Arc<Mutex<Instant>>,
    ended: watch::Receiver<bool>,
}

/// A place in the registry; given back when dropped, after which a waiting successor may begin.
#[derive(Debug)]
pub struct Claim {
    registry: Registry,
    agent_id: String,
    commands: usize,
    heard: Arc<Mutex<Instant>>,
    ended: watch::Sender<bool>,
}

impl Claim {
    /// The agent has answered.
    pub fn heard(&self) {
        *self.heard.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut sessions = self.registry.sessions();
        if sessions.get(&self.agent_id).is_some_and(|session| session.commands.stable_id() == self.commands)
            && let Some(session) = sessions.remove(&self.agent_id)
            && let Some(telemetry) = session.telemetry
        {
            CloseCode::Companion.close(&telemetry, "the commands connection is gone");
        }
        drop(sessions);
        self.ended.send_replace(true);
    }
}

impl Registry {
    /// Takes the place of `who`, waiting for a predecessor to leave.
    ///
    /// # Errors
    /// Why not, for the agent: another one of this name is connected and answers.
    pub async fn claim(&self, who: Who, commands: &Connection) -> Result<Claim, String> {
        loop {
            let mut ended = {
                let mut sessions = self.sessions();
                match sessions.get(&who.agent_id) {
                    None => {
                        let (ended, receiver) = watch::channel(false);
                        let heard = Arc::new(Mutex::new(Instant::now()));
                        let claim = Claim {
                            registry: self.clone(),
                            agent_id: who.agent_id.clone(),
                            commands: commands.stable_id(),
                            heard: heard.clone(),
                            ended,
                        };
                        let session =
                            Session { commands: commands.clone(), telemetry: None, heard, ended: receiver, who };
                        sessions.insert(claim.agent_id.clone(), session);
                        return Ok(claim);
                    }
                    Some(old) => {
                        let silent = old.heard.lock().unwrap_or_else(PoisonError::into_inner).elapsed();
                        // The same start of the same agent comes back before we noticed its going;
                        // a restarted one has to wait until its former self is silent.
                        let same = old.who == who;
                        let restarted = old.who.fingerprint == who.fingerprint && silent > ANSWERS_WITHIN;
                        if !same && !restarted {
                            return Err(format!(
                                "agent id {:?} is already connected from {} (boot {:016x}); give this agent another id",
                                who.agent_id,
                                old.commands.remote_address(),
                                old.who.boot_id,
                            ));
                        }
                        CloseCode::Duplicate.close(&old.commands, "replaced by a newer connection of the same agent");
                        old.ended.clone()
                    }
                }
            };
            // An error means that the claim is gone, which is what is waited for.
            let _ = ended.wait_for(|ended| *ended).await;
        }
    }

    /// Adds the telemetry connection to the session of `who`.
    ///
    /// # Errors
    /// Why not, for the agent.
    pub fn join(&self, who: &Who, telemetry: &Connection) -> Result<(), String> {
        let mut sessions = self.sessions();
        match sessions.get_mut(&who.agent_id) {
            Some(session) if session.who == *who => {
                if let Some(old) = session.telemetry.replace(telemetry.clone()) {
                    CloseCode::Duplicate.close(&old, "replaced by a newer connection of the same agent");
                }
                Ok(())
            }
            _ => Err(format!("agent {:?} has no commands connection", who.agent_id)),
        }
    }

    fn sessions(&self) -> MutexGuard<'_, HashMap<String, Session>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
