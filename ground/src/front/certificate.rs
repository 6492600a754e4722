//! The certificate that browsers see: one's own, or a self-signed one made once and kept in `DATA/tls`.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use sha2::{Digest, Sha256};

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

#[cfg(test)]
mod tests {
    use super::*;

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
