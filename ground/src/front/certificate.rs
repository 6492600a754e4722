//! The certificate that browsers see: one's own, or a self-signed one made once and kept in `DATA/tls`.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustls::CertificateError as Judged;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::ServerCertVerifier as _;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use sha2::{Digest, Sha256};

const DAY_S: f64 = 86_400.0;

/// Why there is no TLS.
#[derive(Debug, thiserror::Error)]
pub enum CertificateError {
    /// A file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file holds no certificate, or no key.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// TLS refuses certificate or key.
    #[error("TLS refuses {path}: {reason}")]
    Refused {
        /// The certificate.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// It is not its time: it has ended, or has not begun.
    #[error("{path}: {reason}")]
    Term {
        /// The certificate.
        path: PathBuf,
        /// Since when, or until when.
        reason: String,
    },
    /// None could be made.
    #[error("no certificate could be made: {0}")]
    Generate(#[from] rcgen::Error),
}

/// Certificate and key of this ground's own making in `folder`, for these names and addresses; made when there are none.
///
/// # Errors
/// [`CertificateError`].
pub fn own(folder: &Path, names: &[String]) -> Result<(PathBuf, PathBuf), CertificateError> {
    use std::os::unix::fs::OpenOptionsExt as _;
    let (certificate, key) = (folder.join("cert.pem"), folder.join("key.pem"));
    if certificate.exists() && key.exists() {
        return Ok((certificate, key));
    }
    let pair = rcgen::KeyPair::generate()?;
    let mut params = rcgen::CertificateParams::new(names.to_vec())?;
    params.distinguished_name.push(rcgen::DnType::CommonName, "Plumbline ground");
    let made = params.self_signed(&pair)?;
    let write = |path: &Path, text: &str| {
        let write = || {
            std::fs::create_dir_all(folder)?;
            let mut file =
                std::fs::OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(path)?;
            io::Write::write_all(&mut file, text.as_bytes())?;
            file.sync_all()
        };
        write().map_err(|source| CertificateError::Io { path: path.to_owned(), source })
    };
    write(&key, &pair.serialize_pem())?;
    write(&certificate, &made.pem())?;
    Ok((certificate, key))
}

/// TLS 1.2 and 1.3 with this certificate chain and key (PEM); also the certificate's SHA-256, for people to compare.
///
/// # Errors
/// [`CertificateError`].
pub fn tls(certificate: &Path, key: &Path) -> Result<(Arc<rustls::ServerConfig>, String), CertificateError> {
    let malformed = |path: &Path, reason: String| CertificateError::Malformed { path: path.to_owned(), reason };
    let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect)
        .map_err(|e| malformed(certificate, e.to_string()))?;
    let first = chain.first().ok_or_else(|| malformed(certificate, "it holds no certificate".into()))?;
    let fingerprint = Sha256::digest(first.as_ref()).iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>();
    let key = PrivateKeyDer::from_pem_file(key).map_err(|e| malformed(key, e.to_string()))?;
    let refused = |e: rustls::Error| CertificateError::Refused { path: certificate.to_owned(), reason: e.to_string() };
    let mut config = rustls::ServerConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(refused)?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(refused)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok((Arc::new(config), fingerprint.join(":")))
}

/// Does this certificate hold at that time since 1970? Who issued it, and for which names, is for browsers to judge.
///
/// # Errors
/// [`CertificateError`], of which [`CertificateError::Term`] says that it does not.
pub fn holds(certificate: &Path, at: Duration) -> Result<(), CertificateError> {
    let refused = |reason: String| CertificateError::Refused { path: certificate.to_owned(), reason };
    let first = CertificateDer::from_pem_file(certificate)
        .map_err(|e| CertificateError::Malformed { path: certificate.to_owned(), reason: e.to_string() })?;
    let mut roots = rustls::RootCertStore::empty();
    roots.add(first.clone()).map_err(|e| refused(e.to_string()))?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let verifier = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build();
    let verifier = verifier.map_err(|e| refused(e.to_string()))?;
    let name = ServerName::from(std::net::Ipv4Addr::LOCALHOST);
    let judged = verifier.verify_server_cert(&first, &[], &name, &[], UnixTime::since_unix_epoch(at));
    let days = |from: UnixTime, to: UnixTime| to.as_secs().saturating_sub(from.as_secs()) as f64 / DAY_S;
    let reason = match judged {
        Err(rustls::Error::InvalidCertificate(Judged::ExpiredContext { time, not_after })) => {
            format!("it ended {:.1} days ago", days(not_after, time))
        }
        Err(rustls::Error::InvalidCertificate(Judged::NotValidYetContext { time, not_before })) => {
            format!("it begins in {:.1} days", days(time, not_before))
        }
        _ => return Ok(()),
    };
    Err(CertificateError::Term { path: certificate.to_owned(), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_holds_from_its_begin_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cert.pem");
        let day = |n: u64| Duration::from_secs(n * 86_400);
        let pair = rcgen::KeyPair::generate().unwrap();
        // 1970-01-11 to 1970-01-21, by itself and as its own authority.
        for authority in [false, true] {
            let mut params = rcgen::CertificateParams::new(vec!["bench.lab".to_owned()]).unwrap();
            (params.not_before, params.not_after) =
                (rcgen::date_time_ymd(1970, 1, 11), rcgen::date_time_ymd(1970, 1, 21));
            if authority {
                params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
            }
            std::fs::write(&path, params.self_signed(&pair).unwrap().pem()).unwrap();
            holds(&path, day(11)).unwrap();
            let early = holds(&path, day(8)).unwrap_err().to_string();
            assert!(early.contains("begins in 2.0 days") && early.contains("cert.pem"), "{early}");
            let late = holds(&path, day(24)).unwrap_err().to_string();
            assert!(late.contains("ended 4.0 days ago"), "{late}");
        }
        let (own, _) = own(&folder.path().join("own"), &["bench.lab".to_owned()]).unwrap();
        holds(&own, day(365 * 60)).unwrap();
        std::fs::write(&path, "none").unwrap();
        assert!(matches!(holds(&path, day(1)), Err(CertificateError::Malformed { .. })));
    }

    #[test]
    fn a_certificate_is_made_once_and_a_bad_one_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["192.0.2.10".to_owned(), "bench.lab".to_owned()];
        let (certificate, key) = own(folder.path(), &names).unwrap();
        let (_, fingerprint) = tls(&certificate, &key).unwrap();
        let (certificate, key) = own(folder.path(), &names).unwrap();
        assert_eq!(tls(&certificate, &key).unwrap().1, fingerprint);
        let error = tls(&key, &key).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("key.pem"), "{error}");
        assert!(tls(&certificate, &certificate).is_err());
    }
}
