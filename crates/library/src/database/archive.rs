//! What a backup is made of: a tar archive of plain files, of which the last tells the SHA-256 of all others, as `sha256sum` writes it.

use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::io::{self, Read};

/// What the database is called in the archive.
pub(crate) const DATABASE: &str = "library.sqlite3";
/// The folder of the files beside.
pub(crate) const OBJECTS: &str = "objects";
/// The sums of all, the last member: without it an archive has no end.
pub(crate) const SUMS: &str = "SHA256SUMS";

/// Members of an archive by name, with their sums.
pub(crate) type Sums = BTreeMap<String, String>;

/// Reads on, and sums what was read.
pub(crate) struct Summed<R> {
    from: R,
    sum: Sha256,
    bytes: u64,
}

impl<R: Read> Summed<R> {
    pub(crate) fn new(from: R) -> Self {
        Self {
            from,
            sum: Sha256::new(),
            bytes: 0,
        }
    }

    /// The sum of what was read, and how much it was.
    pub(crate) fn end(self) -> (String, u64) {
        let digest = self.sum.finalize();
        let sum = digest.iter().map(|b| format!("{b:02x}")).collect();
        (sum, self.bytes)
    }
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(to)?;
        self.sum.update(&to[..count]);
        self.bytes += count as u64;
        Ok(count)
    }
}

/// Where an object lies in the archive.
pub(crate) fn place(object: &str) -> String {
    format!("{OBJECTS}/{}/{object}", object.get(..2).unwrap_or(""))
}

/// The object that lies there, and its sum; `None` where no object does.
pub(crate) fn object(place_of: &str) -> Option<(&str, &str)> {
    let object = place_of.rsplit('/').next()?;
    let (sum, ending) = object.split_once('.')?;
    let is_sum = sum.len() == 64 && sum.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    let is_ending = !ending.is_empty() && ending.bytes().all(|b| b.is_ascii_alphanumeric());
    (is_sum && is_ending && place(object) == place_of).then_some((object, sum))
}

pub(crate) fn to_text(sums: &Sums) -> String {
    let lines = sums.iter().map(|(name, sum)| format!("{sum}  {name}\n"));
    lines.collect()
}

/// What the last member says; `None` where it does not say that.
pub(crate) fn from_text(text: &[u8]) -> Option<Sums> {
    let text = std::str::from_utf8(text).ok()?;
    let lines = text.lines().map(|line| {
        let (sum, name) = line.split_once("  ")?;
        Some((name.to_owned(), sum.to_owned()))
    });
    let sums: Sums = lines.collect::<Option<_>>()?;
    // Told in one way only.
    (to_text(&sums) == text).then_some(sums)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_object_in_its_own_place_is_one() {
        let sum = "ab".repeat(32);
        let object_in = |place: &str| object(place).map(|(object, _)| object.to_owned());
        let own = format!("{sum}.png");
        assert_eq!(object_in(&format!("objects/ab/{own}")), Some(own.clone()));
        for other in [
            format!("objects/ba/{own}"),
            format!("objects/{own}"),
            format!("/objects/ab/{own}"),
            format!("objects/../objects/ab/{own}"),
            format!("objects/ab/{sum}"),
            format!("objects/ab/{sum}."),
            format!("objects/ab/{sum}.p/g"),
            format!("objects/ab/{}.png", sum.to_uppercase()),
            "objects/é/é.png".into(),
            String::new(),
        ] {
            assert_eq!(object_in(&other), None, "{other}");
        }
    }

    #[test]
    fn sums_are_told_in_one_way() {
        let sums = Sums::from([("a b".into(), "1".into()), ("c".into(), "2".into())]);
        let text = to_text(&sums);
        assert_eq!(text, "1  a b\n2  c\n");
        assert_eq!(from_text(text.as_bytes()), Some(sums));
        for other in [
            "2  c\n1  a b\n",
            "1  a b\n2  c",
            "1 a b\n",
            "1  c\n2  c\n",
            "\u{fffd}",
        ] {
            assert_eq!(from_text(other.as_bytes()), None, "{other}");
        }
    }
}
