//! First contact: a short code, shown by the agent and typed in at the ground, makes both trust each other.
//!
//! The two meet by TLS 1.3 with certificates that neither knows yet, and agree on a key by SPAKE2 (RFC 9382, crate
//! `spake2`) from the code: whoever does not know it can try one code in each meeting and learns nothing that would let
//! it try others by itself. Then each proves that it has the same key, bound to both certificates and to this very
//! connection (RFC 5705 exporter), so that somebody in between, who shows other certificates, cannot pass it on.
//!
//! ```text
//! agent ─► hello, X ─► ground ─► hello, Y ─► agent       X, Y: SPAKE2 messages; k = SPAKE2(code, X, Y, fingerprints)
//! agent ─► proof_agent ─► ground ─► proof_ground ─► agent
//! proof_s = HMAC-SHA256(k; s ‖ agent's fingerprint ‖ ground's fingerprint ‖ exporter),  s the side that proves
//! ```
//!
//! At the ground a code is worth something for [`VALID`] and for [`ATTEMPTS`] proofs, then never again; whoever serves
//! the connection says how many each address may make. Only proofs count: a stranger that says less spends nothing. The
//! code waits in the file `pairing` of the identity's folder, where the page, the command line, or a person may put it.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use plumbline_proto::v1::{Hello, PairingProof, command_frame::Body};
use quinn::{ClientConfig, Connection, Endpoint};
use ring::hmac;
use ring::rand::{SecureRandom as _, SystemRandom};
use spake2::{Ed25519Group, Identity as Side, Password, Spake2};

use super::hello;
use super::identity::{Fingerprint, Identity, IdentityError, write_new};
use super::tls::{self, Purpose};
use super::transport::{CloseCode, FrameReader, FrameWriter, StreamError, any_port};

/// How long a code may be used.
pub const VALID: Duration = Duration::from_secs(600);
/// Wrong proofs, from all addresses, after which a code is worth nothing: all of them together guess it once in 10⁹.
pub const ATTEMPTS: u32 = 500;

/// Letters that nobody takes for another: about 39 bits in [`LENGTH`] of them.
const LETTERS: &[u8; 31] = b"23456789ABCDEFGHJKMNPQRSTUVWXYZ";
const LENGTH: usize = 8;
const AGENT: &[u8] = b"agent";
const GROUND: &[u8] = b"ground";
const EXPORTER: &[u8] = b"EXPORTER plumbline pairing";
/// Longest message of an exchange, bytes.
const MAX_MESSAGE: usize = 64;
/// The other side may take this long to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why two sides did not pair.
#[derive(Debug, thiserror::Error)]
pub enum PairingError {
    /// Not a code.
    #[error("{0:?} is no pairing code: {LENGTH} letters and digits are needed")]
    Code(String),
    /// The other side does not know the code.
    #[error("the other side does not know this code")]
    Wrong,
    /// This address has to wait.
    #[error("too many wrong proofs from this address")]
    Paced,
    /// No code is waiting.
    #[error("no pairing code is waiting; enter the one that the agent shows")]
    None,
    /// The connection failed.
    #[error("{0}")]
    Connection(String),
    /// A file or the system failed.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// No random numbers, or no keying material.
    #[error("the code could not be used")]
    System,
}

impl From<StreamError> for PairingError {
    fn from(error: StreamError) -> Self {
        Self::Connection(error.to_string())
    }
}

/// A short code.
#[derive(Clone, PartialEq, Eq)]
pub struct Code(String);

impl Code {
    /// A new one.
    ///
    /// # Errors
    /// [`PairingError::System`] without random numbers.
    pub fn random() -> Result<Self, PairingError> {
        let mut code = String::new();
        while code.len() < LENGTH {
            let mut byte = [0];
            SystemRandom::new().fill(&mut byte).map_err(|_| PairingError::System)?;
            // Values beyond a multiple of the letters would make some likelier.
            if let Some(letter) = LETTERS.get(usize::from(byte[0] & 31)) {
                code.push(char::from(*letter));
            }
        }
        Ok(Self(code))
    }

    /// As a person types it: case, spaces and dashes do not matter.
    ///
    /// # Errors
    /// [`PairingError::Code`].
    pub fn parse(text: &str) -> Result<Self, PairingError> {
        let letters: String =
            text.chars().filter(|c| !c.is_whitespace() && *c != '-').map(|c| c.to_ascii_uppercase()).collect();
        let good = letters.len() == LENGTH && letters.bytes().all(|byte| LETTERS.contains(&byte));
        if good { Ok(Self(letters)) } else { Err(PairingError::Code(text.chars().take(40).collect())) }
    }

    /// Begins an agreement on a key between these two.
    fn agree(&self, meeting: &Meeting, side: &[u8]) -> (Spake2<Ed25519Group>, Vec<u8>) {
        let password = Password::new(self.0.as_bytes());
        let (agent, ground) = (Side::new(meeting.agent.bytes()), Side::new(meeting.ground.bytes()));
        if side == AGENT {
            Spake2::<Ed25519Group>::start_a(&password, &agent, &ground)
        } else {
            Spake2::<Ed25519Group>::start_b(&password, &agent, &ground)
        }
    }
}

/// The key of an agreement, from the other side's message.
fn key(agreement: Spake2<Ed25519Group>, theirs: &[u8]) -> Result<hmac::Key, PairingError> {
    let key = agreement.finish(theirs).map_err(|error| PairingError::Connection(format!("no agreement: {error:?}")))?;
    Ok(hmac::Key::new(hmac::HMAC_SHA256, &key))
}

impl std::fmt::Display for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (first, second) = self.0.split_at_checked(LENGTH / 2).unwrap_or((&self.0, ""));
        write!(f, "{first}-{second}")
    }
}

impl std::fmt::Debug for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Code")
    }
}

/// What each side proves, and to whom.
struct Meeting {
    agent: Fingerprint,
    ground: Fingerprint,
    exported: [u8; 32],
}

impl Meeting {
    fn new(connection: &Connection, agent: Fingerprint, ground: Fingerprint) -> Result<Self, PairingError> {
        let mut exported = [0; 32];
        connection.export_keying_material(&mut exported, EXPORTER, b"").map_err(|_| PairingError::System)?;
        Ok(Self { agent, ground, exported })
    }

    fn words(&self, side: &[u8]) -> Vec<u8> {
        [side, self.agent.bytes(), self.ground.bytes(), &self.exported].concat()
    }
}

fn waiting_path(folder: &Path) -> PathBuf {
    folder.join("pairing")
}

/// Seconds that every process of this machine counts alike and that no step of its wall clock moves: since it started.
/// The wall clock where the system does not tell.
fn now_s() -> u64 {
    let uptime = fs::read_to_string("/proc/uptime").ok();
    let seconds = uptime.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    let wall = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    seconds.map_or_else(wall, |seconds| seconds as u64)
}

/// Lets `code` be used at the ground whose identity is in `folder`, for [`VALID`].
///
/// # Errors
/// [`PairingError::Identity`] when the file cannot be written.
pub fn expect(folder: &Path, code: &Code) -> Result<(), PairingError> {
    let text = format!("{} {} {ATTEMPTS}\n", code.0, now_s() + VALID.as_secs());
    Ok(write_new(&waiting_path(folder), text.as_bytes(), 0o600)?)
}

/// The code that is waiting at a ground, and how many proofs it still allows.
pub(super) fn waiting(folder: &Path) -> Option<(Code, u64, u32)> {
    let text = fs::read_to_string(waiting_path(folder)).ok()?;
    let mut words = text.split_whitespace();
    let code = Code::parse(words.next()?).ok()?;
    // A person who writes the file by hand need not reckon with seconds.
    let until = words.next().map_or(Some(u64::MAX), |word| word.parse().ok())?;
    let left = words.next().map_or(Some(ATTEMPTS), |word| word.parse().ok())?;
    let now = now_s();
    // One that would count for longer than any is from before the machine was started again.
    let counts = until == u64::MAX || (now..=now + VALID.as_secs()).contains(&until);
    (counts && left > 0).then_some((code, until, left))
}

fn forget(folder: &Path) {
    if let Err(error) = fs::remove_file(waiting_path(folder))
        && error.kind() != io::ErrorKind::NotFound
    {
        tracing::error!(%error, "the pairing code stays where it is; remove the file `pairing`");
    }
}

/// Counts one proof against the code that waits; `None` when it is worth nothing any more.
fn spend(folder: &Path, code: &Code) -> Result<Option<()>, PairingError> {
    let Some((waiting, until, left)) = waiting(folder).filter(|(waiting, ..)| waiting == code) else { return Ok(None) };
    let text = format!("{} {until} {}\n", waiting.0, left - 1);
    Ok(Some(write_new(&waiting_path(folder), text.as_bytes(), 0o600)?))
}

/// The ground's side: serves one connection whose purpose is pairing. `may_try` is asked once for each proof, before it
/// is looked at. Answers the agent's name.
///
/// # Errors
/// [`PairingError`].
pub async fn serve(
    connection: &Connection,
    identity: &Identity,
    ground_id: &str,
    may_try: impl FnOnce() -> bool,
) -> Result<String, PairingError> {
    let agent = tls::peer_fingerprint(connection).ok_or(PairingError::System)?;
    let (code, ..) = waiting(identity.folder()).ok_or(PairingError::None)?;
    let meeting = Meeting::new(connection, agent, identity.fingerprint())?;
    let exchange = async {
        let (send, receive) = connection.accept_bi().await.map_err(StreamError::from)?;
        let (mut reader, mut writer) = (FrameReader::new(receive), FrameWriter::new(send));
        let theirs = hello::receive(&mut reader).await?;
        let name = hello::check(&theirs).map(|()| theirs.id).map_err(|e| PairingError::Connection(e.to_string()))?;
        let (agreement, message) = code.agree(&meeting, GROUND);
        let key = key(agreement, &receive_message(&mut reader).await?)?;
        writer.send(Body::Hello(mine(ground_id))).await?;
        writer.send(Body::PairingProof(PairingProof { proof: message })).await?;
        let proof = receive_message(&mut reader).await?;
        // Spent before it is tried: attempts at the same time count each.
        if !may_try() {
            return Err(PairingError::Paced);
        }
        spend(identity.folder(), &code)?.ok_or(PairingError::None)?;
        hmac::verify(&key, &meeting.words(AGENT), &proof).map_err(|_| PairingError::Wrong)?;
        identity.enrol(agent, &name)?;
        forget(identity.folder());
        let answer = hmac::sign(&key, &meeting.words(GROUND)).as_ref().to_vec();
        writer.send(Body::PairingProof(PairingProof { proof: answer })).await?;
        writer.finish();
        // The agent closes when it has read.
        connection.closed().await;
        Ok(name)
    };
    let outcome = tokio::time::timeout(PATIENCE, exchange).await;
    outcome.unwrap_or_else(|_| Err(PairingError::Connection("no answer in time".into())))
}

/// The agent's side: tries once to pair with `ground`. Answers the ground's fingerprint, now trusted.
///
/// # Errors
/// [`PairingError`].
pub async fn meet(
    ground: SocketAddr,
    identity: &Identity,
    agent_id: &str,
    code: &Code,
) -> Result<Fingerprint, PairingError> {
    let failed = |error: &dyn std::fmt::Display| PairingError::Connection(error.to_string());
    let endpoint = Endpoint::client(any_port(ground)).map_err(|e| failed(&e))?;
    let config = ClientConfig::new(Arc::new(tls::client(identity, Purpose::Pairing)?));
    let exchange = async {
        let connecting = endpoint.connect_with(config, ground, tls::SERVER_NAME).map_err(|e| failed(&e))?;
        let connection = connecting.await.map_err(|e| failed(&e))?;
        let theirs = tls::peer_fingerprint(&connection).ok_or(PairingError::System)?;
        let meeting = Meeting::new(&connection, identity.fingerprint(), theirs)?;
        let (send, receive) = connection.open_bi().await.map_err(StreamError::from)?;
        let (mut reader, mut writer) = (FrameReader::new(receive), FrameWriter::new(send));
        writer.send(Body::Hello(mine(agent_id))).await?;
        let (agreement, message) = code.agree(&meeting, AGENT);
        writer.send(Body::PairingProof(PairingProof { proof: message })).await?;
        hello::receive(&mut reader).await?;
        let key = key(agreement, &receive_message(&mut reader).await?)?;
        let answer = hmac::sign(&key, &meeting.words(AGENT)).as_ref().to_vec();
        writer.send(Body::PairingProof(PairingProof { proof: answer })).await?;
        let proof = receive_message(&mut reader).await?;
        hmac::verify(&key, &meeting.words(GROUND), &proof).map_err(|_| PairingError::Wrong)?;
        identity.trust(theirs, "ground")?;
        CloseCode::Shutdown.close(&connection, "paired");
        Ok(theirs)
    };
    let outcome = tokio::time::timeout(2 * PATIENCE, exchange).await;
    let _ = tokio::time::timeout(PATIENCE, endpoint.wait_idle()).await;
    outcome.unwrap_or_else(|_| Err(PairingError::Connection("no answer in time".into())))
}

fn mine(id: &str) -> Hello {
    Hello {
        schema: u32::from(plumbline_proto::SCHEMA),
        id: id.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Hello::default()
    }
}

async fn receive_message(reader: &mut FrameReader) -> Result<Vec<u8>, PairingError> {
    match reader.next().await? {
        Some(Body::PairingProof(PairingProof { proof })) if proof.len() <= MAX_MESSAGE => Ok(proof),
        _ => Err(PairingError::Connection("the other side did not go on; does it know the code?".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_survive_being_typed_and_nonsense_is_named() {
        let code = Code::random().unwrap();
        let shown = code.to_string();
        assert_eq!(shown.len(), LENGTH + 1);
        assert!(Code::parse(&shown.to_lowercase()).unwrap() == code);
        assert!(Code::parse(&format!("  {} ", shown.replace('-', " "))).unwrap() == code);
        for bad in ["", "ABCD-EFG", "ABCD-EFG0", "ABCD-EFGHI", "ÄBCD-EFGH"] {
            assert!(Code::parse(bad).is_err(), "{bad}");
        }
        assert!(code != Code::random().unwrap());
    }

    #[test]
    fn one_meeting_tries_one_code_and_gives_no_means_to_try_others() {
        let meeting = Meeting {
            agent: Fingerprint::parse(&"a1".repeat(32)).unwrap(),
            ground: Fingerprint::parse(&"b2".repeat(32)).unwrap(),
            exported: [7; 32],
        };
        let [right, guess, other] = ["ABCD-EFGH", "ABCD-EFGJ", "ABCD-EFGK"].map(|code| Code::parse(code).unwrap());
        let words = meeting.words(AGENT);
        let proves = |agent: &Code, ground: &Code| {
            let (a, x) = agent.agree(&meeting, AGENT);
            let (b, y) = ground.agree(&meeting, GROUND);
            let proof = hmac::sign(&key(a, &y).unwrap(), &words).as_ref().to_vec();
            hmac::verify(&key(b, &x).unwrap(), &words, &proof).is_ok()
        };
        assert!(proves(&right, &right) && !proves(&right, &guess));
        // GIVEN a false ground that met with a guess and has kept all that it saw
        let (a, x) = right.agree(&meeting, AGENT);
        let (_, y) = guess.agree(&meeting, GROUND);
        let proof = hmac::sign(&key(a, &y).unwrap(), &words).as_ref().to_vec();
        // WHEN it tries other codes by itself, the right one among them, THEN none fits what it saw
        for code in [&right, &guess, &other] {
            let (b, _) = code.agree(&meeting, GROUND);
            assert!(hmac::verify(&key(b, &x).unwrap(), &words, &proof).is_err());
        }
        assert!(
            key(right.agree(&meeting, GROUND).0, &[0; 33]).is_err()
                && key(right.agree(&meeting, GROUND).0, b"").is_err()
        );
    }

    #[test]
    fn a_code_waits_for_a_while_and_for_so_many_proofs() {
        let folder = tempfile::tempdir().unwrap();
        assert!(waiting(folder.path()).is_none());
        let code = Code::random().unwrap();
        expect(folder.path(), &code).unwrap();
        let (found, until, left) = waiting(folder.path()).unwrap();
        assert!(found == code && left == ATTEMPTS && until > now_s() + 590);
        let path = waiting_path(folder.path());
        fs::write(&path, format!("{code} {} 3", now_s() - 1)).unwrap();
        assert!(waiting(folder.path()).is_none(), "over");
        fs::write(&path, format!("{code} {} 0", now_s() + 9)).unwrap();
        assert!(waiting(folder.path()).is_none(), "spent");
        fs::write(&path, format!("{code}\n")).unwrap();
        assert!(waiting(folder.path()).is_some(), "written by hand");
        forget(folder.path());
        assert!(waiting(folder.path()).is_none());
    }
}
