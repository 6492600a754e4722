//! Time-based one-time passwords (RFC 6238): a second step of signing in, for accounts that want one.

use qrcode::QrCode;
use qrcode::render::svg;
use ring::rand::{SecureRandom as _, SystemRandom};
use totp_rs::{Builder, Secret, Totp};

use super::AccountError;

/// Length of a secret, bytes: that of the hash (RFC 4226, section 4).
const SECRET: usize = 20;
/// Shown beside the account by the authenticator.
const ISSUER: &str = "Plumbline";
/// Width of the picture, pixels.
const PICTURE: u32 = 200;

/// What an authenticator and the ground both know of an account.
#[derive(Debug)]
pub struct Authenticator {
    account: String,
    totp: Totp,
}

impl Authenticator {
    /// A new one for `account`; nothing is kept.
    ///
    /// # Errors
    /// [`AccountError::Random`].
    pub fn new(account: &str) -> Result<Self, AccountError> {
        let mut secret = [0; SECRET];
        SystemRandom::new().fill(&mut secret).map_err(|_| AccountError::Random)?;
        Self::with(account, Secret::from(secret))
    }

    /// That of a `secret` in base 32.
    ///
    /// # Errors
    /// [`AccountError::Secret`].
    pub fn of(account: &str, secret: &str) -> Result<Self, AccountError> {
        Self::with(account, Secret::try_from_base32(secret).map_err(|_| AccountError::Secret)?)
    }

    fn with(account: &str, secret: Secret) -> Result<Self, AccountError> {
        // Six digits, steps of 30 s, one step early or late: what every authenticator takes for granted.
        let totp = Builder::new().with_secret(secret).build().map_err(|_| AccountError::Secret)?;
        Ok(Self { account: account.to_owned(), totp })
    }

    /// The secret in base 32, to be typed.
    pub fn secret(&self) -> String {
        self.totp.secret().to_base32()
    }

    /// The secret as authenticators scan it. Names of accounts need no escaping.
    pub fn url(&self) -> String {
        format!("otpauth://totp/{ISSUER}:{}?secret={}&issuer={ISSUER}", self.account, self.secret())
    }

    /// [`Authenticator::url`] as a QR code, SVG.
    pub fn picture(&self) -> String {
        let code = QrCode::new(self.url());
        let code = code.map(|code| code.render::<svg::Color>().min_dimensions(PICTURE, PICTURE).build());
        code.unwrap_or_default()
    }

    /// The code of now, as the authenticator shows it.
    pub fn code(&self, unix_s: u64) -> String {
        self.totp.generate(unix_s).to_string()
    }

    /// The step that `code` is of, if it is the code of now. A step counts once (RFC 6238, section 5.2): that is for the
    /// caller to see to.
    pub fn step(&self, code: &str, unix_s: u64) -> Option<u64> {
        let code: String = code.chars().filter(|c| !c.is_whitespace()).collect();
        self.totp.check(&code, unix_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_rfc_6238() {
        // Appendix B, SHA-1; six digits are the last six of the eight there.
        let authenticator = Authenticator::with("ann", Secret::from(*b"12345678901234567890")).unwrap();
        for (unix_s, code) in [(59, "287082"), (1_111_111_109, "081804"), (20_000_000_000, "353130")] {
            assert_eq!(authenticator.step(code, unix_s), Some(unix_s / 30), "{code}");
            assert_eq!(authenticator.step(code, unix_s + 90), None, "{code}");
        }
        assert_eq!(authenticator.step("28 70 82", 59), Some(1), "as it is shown");
        for wrong in ["", "287083", "28708", "2870822", "x"] {
            assert_eq!(authenticator.step(wrong, 59), None, "{wrong}");
        }
    }

    #[test]
    fn a_secret_survives_being_written_down_and_a_short_one_is_refused() {
        let new = Authenticator::new("ann").unwrap();
        assert_eq!(Authenticator::of("ann", &new.secret()).unwrap().secret(), new.secret());
        assert!(new.url().starts_with("otpauth://totp/Plumbline:ann?secret="), "{}", new.url());
        assert!(new.picture().contains("<svg"));
        for bad in ["", "GEZDGNBV", "not base 32!"] {
            assert!(matches!(Authenticator::of("ann", bad), Err(AccountError::Secret)), "{bad}");
        }
    }
}
