//! Proving to know a secret without saying it: HMAC-SHA256 of a nonce.

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// A secret that two programs share. Shown to nobody.
#[derive(Clone)]
pub struct Secret(Vec<u8>);

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl Secret {
    /// The shortest allowed, bytes.
    pub const MIN_BYTES: usize = 16;

    /// A secret from a file's bytes; white space at its ends does not count. `None` when it is shorter than
    /// [`Secret::MIN_BYTES`].
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.trim_ascii();
        (bytes.len() >= Self::MIN_BYTES).then(|| Self(bytes.to_vec()))
    }

    fn mac(&self, nonce: &str) -> Hmac<Sha256> {
        let mac = Hmac::<Sha256>::new_from_slice(&self.0);
        // A key of any length is one.
        let mut mac = mac.unwrap_or_else(|_| unreachable!("HMAC takes keys of any length"));
        mac.update(nonce.as_bytes());
        mac
    }

    /// The proof for a nonce.
    pub fn proof(&self, nonce: &str) -> String {
        hex(&self.mac(nonce).finalize().into_bytes())
    }

    /// Whether a proof is right, in a time that does not tell how much of it is.
    pub fn proves(&self, nonce: &str, proof: &str) -> bool {
        let bytes = unhex(proof);
        bytes.is_some_and(|bytes| self.mac(nonce).verify_slice(&bytes).is_ok())
    }
}

/// A nonce nobody has seen before.
pub(crate) fn nonce() -> Result<String, std::io::Error> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
    Ok(hex(&bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let digit = |b: u8| (b as char).to_digit(16);
    text.as_bytes()
        .chunks(2)
        .map(|pair| match pair {
            [high, low] => Some((digit(*high)? * 16 + digit(*low)?) as u8),
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_proof_is_hmac_sha256() {
        // Test case 2 of RFC 4231 has a key of four bytes: too short for us, so by the inside.
        let secret = Secret(b"Jefe".to_vec());
        let proof = secret.proof("what do ya want for nothing?");
        assert_eq!(
            proof,
            "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843"
        );
        assert!(secret.proves("what do ya want for nothing?", &proof));
        assert!(!secret.proves("what do ya want for nothing", &proof));
        for wrong in ["", "5", "5bdc", "zz", "ä"] {
            assert!(!secret.proves("what do ya want for nothing?", wrong));
        }
    }

    #[test]
    fn short_secrets_are_none_and_nonces_differ() {
        assert!(Secret::new(b"  short secret \n").is_none());
        assert!(Secret::new(b"0123456789abcdef\n").is_some());
        assert_eq!(nonce().unwrap().len(), 32);
        assert_ne!(nonce().unwrap(), nonce().unwrap());
        let shown = format!("{:?}", Secret::new(b"0123456789abcdef").unwrap());
        assert!(!shown.contains("0123"));
    }
}
