//! The key that both ends of a MAVLink link sign with (MAVLink 2, message signing).

use std::path::Path;

/// Bytes of a key.
const BYTES: usize = 32;

/// A key; printed it says nothing.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; BYTES]);

impl Key {
    /// The key itself.
    pub fn bytes(&self) -> [u8; BYTES] {
        self.0
    }
}

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

/// Why a key cannot be used. The key itself is never told.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file.
    #[error("{path}: {source}")]
    File {
        /// Its name.
        path: String,
        /// Cause.
        source: std::io::Error,
    },
    /// It holds something else.
    #[error("{path}: {bytes} bytes are not a signing key: 32 bytes, or 64 hexadecimal digits")]
    NoKey {
        /// Its name.
        path: String,
        /// How many it holds.
        bytes: usize,
    },
}

/// The key in the file at `path`: 32 bytes, or 64 hexadecimal digits and white space.
///
/// # Errors
/// [`KeyError`] naming the file.
pub fn read_key(path: &Path) -> Result<Key, KeyError> {
    let name = || path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| KeyError::File { path: name(), source })?;
    let key = <[u8; BYTES]>::try_from(&*bytes).ok().or_else(|| from_hex(&bytes));
    key.map(Key).ok_or_else(|| KeyError::NoKey { path: name(), bytes: bytes.len() })
}

fn from_hex(text: &[u8]) -> Option<[u8; BYTES]> {
    let digits = std::str::from_utf8(text).ok()?.trim();
    if digits.len() != 2 * BYTES || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    let mut key = [0; BYTES];
    for (index, byte) in key.iter_mut().enumerate() {
        *byte = u8::from_str_radix(digits.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_bytes_or_digits_and_what_is_neither_is_refused_without_being_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        let read = |content: &[u8]| {
            std::fs::write(&path, content).unwrap();
            read_key(&path)
        };
        let key: [u8; BYTES] = std::array::from_fn(|index| index as u8);
        assert_eq!(read(&key).unwrap().bytes(), key);
        let digits: String = key.iter().map(|byte| format!("{byte:02X}")).collect();
        assert_eq!(read(format!("{digits}\n").as_bytes()).unwrap(), Key(key));
        assert_eq!(format!("{:?}", Key(key)), "Key");
        for wrong in ["secret", &digits[1..], &format!("{digits}00"), &format!("+{}", &digits[1..])] {
            let error = read(wrong.as_bytes()).unwrap_err().to_string();
            assert!(error.contains("are not a signing key") && !error.contains(wrong), "{error}");
        }
        assert!(read_key(Path::new("/nowhere/key")).unwrap_err().to_string().starts_with("/nowhere/key: "));
    }
}
