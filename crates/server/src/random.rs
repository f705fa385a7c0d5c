//! Secrets: random, told once, kept as checksums.

use sha2::{Digest as _, Sha256};

/// So many random bytes, as hexadecimal digits.
///
/// # Errors
/// Where the system has no random numbers.
pub(crate) fn secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0u8; 32];
    getrandom::fill(&mut bytes)?;
    Ok(hex(&bytes))
}

/// What is kept of a secret.
pub(crate) fn checksum(secret: &str) -> String {
    hex(&Sha256::digest(secret.as_bytes()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_differ_and_are_long() {
        let [a, b] = [secret().unwrap(), secret().unwrap()];
        assert_ne!(a, b);
        assert_eq!(a.len(), 64);
        assert_eq!(
            checksum("abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }
}
