//! Mutual TLS 1.3 with pinned certificates, for both ends of the link.
//!
//! Each side shows its self-signed certificate and proves that it holds the key; each side accepts
//! exactly the certificates whose fingerprints its identity trusts. An unpaired peer fails the
//! handshake and gets nothing. No session is resumed and nothing is sent before the handshake ends
//! (no 0-RTT), so a recorded conversation cannot be replayed.

use std::sync::Arc;

use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use rustls::client::Resumption;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::server::NoServerSessionStorage;
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::{CertificateError, DigitallySignedStruct, DistinguishedName, Error, SignatureScheme};

use super::identity::{Fingerprint, Identity, IdentityError};
use super::pairing;

/// Name in every certificate; trust does not depend on it.
pub const SERVER_NAME: &str = "plumbline";

/// What a connection is for, agreed upon in the handshake (ALPN).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Unreliable datagrams, agent to ground.
    Telemetry,
    /// Reliable streams both ways.
    Commands,
    /// First contact by a code ([`super::pairing`]).
    Pairing,
}

const PURPOSES: [Purpose; 3] = [Purpose::Telemetry, Purpose::Commands, Purpose::Pairing];

impl Purpose {
    /// The protocol name in the handshake.
    pub const fn alpn(self) -> &'static [u8] {
        match self {
            Purpose::Telemetry => b"plumbline-telemetry",
            Purpose::Commands => b"plumbline-commands",
            Purpose::Pairing => b"plumbline-pairing-2",
        }
    }

    /// The purpose of an accepted connection.
    pub fn of(connection: &quinn::Connection) -> Option<Self> {
        let data = connection.handshake_data()?.downcast::<quinn::crypto::rustls::HandshakeData>().ok()?;
        let name = data.protocol?;
        PURPOSES.into_iter().find(|purpose| purpose.alpn() == name)
    }
}

/// The fingerprint of the peer's certificate.
pub fn peer_fingerprint(connection: &quinn::Connection) -> Option<Fingerprint> {
    let certificates = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    certificates.first().map(Fingerprint::of)
}

/// TLS of the side that listens.
///
/// # Errors
/// [`IdentityError::Tls`] when the certificate or the key is not usable.
pub fn server(identity: &Identity) -> Result<QuicServerConfig, IdentityError> {
    let provider = Arc::new(ring::default_provider());
    let strangers = Strangers::WhilePairing;
    let pinned = Arc::new(Pinned { identity: identity.clone(), provider: provider.clone(), strangers });
    let mut config = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(refused(identity))?
        .with_client_cert_verifier(pinned)
        .with_single_cert(vec![identity.certificate()], identity.key())
        .map_err(refused(identity))?;
    config.alpn_protocols = PURPOSES.iter().map(|purpose| purpose.alpn().to_vec()).collect();
    config.session_storage = Arc::new(NoServerSessionStorage {});
    config.send_tls13_tickets = 0;
    config.max_early_data_size = 0;
    QuicServerConfig::try_from(config).map_err(|e| refused(identity)(Error::General(e.to_string())))
}

/// TLS of the side that connects.
///
/// # Errors
/// [`IdentityError::Tls`] when the certificate or the key is not usable.
pub fn client(identity: &Identity, purpose: Purpose) -> Result<QuicClientConfig, IdentityError> {
    let provider = Arc::new(ring::default_provider());
    let strangers = if purpose == Purpose::Pairing { Strangers::Always } else { Strangers::Never };
    let pinned = Arc::new(Pinned { identity: identity.clone(), provider: provider.clone(), strangers });
    let mut config = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(refused(identity))?
        .dangerous()
        .with_custom_certificate_verifier(pinned)
        .with_client_auth_cert(vec![identity.certificate()], identity.key())
        .map_err(refused(identity))?;
    config.alpn_protocols = vec![purpose.alpn().to_vec()];
    config.resumption = Resumption::disabled();
    config.enable_early_data = false;
    QuicClientConfig::try_from(config).map_err(|e| refused(identity)(Error::General(e.to_string())))
}

fn refused(identity: &Identity) -> impl Fn(Error) -> IdentityError + '_ {
    |error| IdentityError::Tls { path: identity.folder().to_owned(), reason: error.to_string() }
}

/// May a certificate that nobody knows pass the handshake?
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Strangers {
    Never,
    /// While a pairing code is waiting. What the connection is for is not known yet: whoever accepts it must refuse
    /// strangers all but pairing.
    WhilePairing,
    Always,
}

/// Accepts the certificates an identity trusts; proof of the key is checked as TLS wants it.
#[derive(Debug)]
struct Pinned {
    identity: Identity,
    provider: Arc<CryptoProvider>,
    strangers: Strangers,
}

impl Pinned {
    fn check(&self, certificate: &CertificateDer<'_>) -> Result<(), Error> {
        let welcome = match self.strangers {
            Strangers::Never => false,
            Strangers::WhilePairing => pairing::waiting(self.identity.folder()).is_some(),
            Strangers::Always => true,
        };
        if welcome {
            return Ok(());
        }
        self.identity
            .check(certificate)
            .map(|_| ())
            .map_err(|_| Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
    }
}

/// The proof of the key, which both traits ask for in the same words.
macro_rules! proof_of_the_key {
    () => {
        fn verify_tls12_signature(
            &self,
            message: &[u8],
            cert: &CertificateDer<'_>,
            dss: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            verify_tls12_signature(message, cert, dss, &self.provider.signature_verification_algorithms)
        }

        fn verify_tls13_signature(
            &self,
            message: &[u8],
            cert: &CertificateDer<'_>,
            dss: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            verify_tls13_signature(message, cert, dss, &self.provider.signature_verification_algorithms)
        }

        fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
            self.provider.signature_verification_algorithms.supported_schemes()
        }
    };
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        self.check(end_entity).map(|()| ServerCertVerified::assertion())
    }

    proof_of_the_key!();
}

impl ClientCertVerifier for Pinned {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _now: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        self.check(end_entity).map(|()| ClientCertVerified::assertion())
    }

    proof_of_the_key!();
}
