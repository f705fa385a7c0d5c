//! As much of DER (ITU-T X.690) as a certificate of ours is written in, and as is read of others: until when they hold.

/// Tags.
pub(super) const INTEGER: u8 = 0x02;
pub(super) const BIT_STRING: u8 = 0x03;
pub(super) const OCTET_STRING: u8 = 0x04;
pub(super) const OID: u8 = 0x06;
pub(super) const UTF8: u8 = 0x0c;
pub(super) const UTC_TIME: u8 = 0x17;
pub(super) const GENERAL_TIME: u8 = 0x18;
pub(super) const SEQUENCE: u8 = 0x30;
pub(super) const SET: u8 = 0x31;
/// The version of a certificate, and its extensions.
pub(super) const VERSION: u8 = 0xa0;
pub(super) const EXTENSIONS: u8 = 0xa3;

/// One value of that tag.
pub(super) fn value(tag: u8, content: &[u8]) -> Vec<u8> {
    let mut all = vec![tag];
    let length = content.len().to_be_bytes();
    let digits = &length[length.iter().take_while(|b| **b == 0).count()..];
    match content.len() {
        short @ 0..128 => all.push(short as u8),
        _ => {
            all.push(0x80 | digits.len() as u8);
            all.extend(digits);
        }
    }
    all.extend(content);
    all
}

/// One value that holds others.
pub(super) fn of(tag: u8, parts: &[Vec<u8>]) -> Vec<u8> {
    value(tag, &parts.concat())
}

/// Bits, all of whole bytes.
pub(super) fn bits(bytes: &[u8]) -> Vec<u8> {
    value(BIT_STRING, &[&[0], bytes].concat())
}

/// The first value of what is there: its tag, its content, and the rest.
pub(super) fn first(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (tag, rest) = bytes.split_first()?;
    let (length, rest) = rest.split_first()?;
    let (length, rest) = match length {
        short @ 0..128 => (usize::from(*short), rest),
        long => {
            let (digits, rest) = rest.split_at_checked(usize::from(long & 0x7f))?;
            if digits.len() > 4 {
                return None;
            }
            let length = digits.iter().fold(0, |n, b| n << 8 | usize::from(*b));
            (length, rest)
        }
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((*tag, content, rest))
}

/// From when and until when a certificate holds, both as `YYYYMMDDHHMMSSZ`: such texts are in the order of time.
pub(super) fn holds(certificate: &[u8]) -> Option<[String; 2]> {
    let (_, certificate, _) = first(certificate)?;
    let (_, mut rest, _) = first(certificate)?;
    if first(rest)?.0 == VERSION {
        rest = first(rest)?.2;
    }
    // The number, the algorithm, and who signed it.
    for _ in 0..3 {
        rest = first(rest)?.2;
    }
    let (_, span, _) = first(rest)?;
    let (tag, from, rest) = first(span)?;
    let from = time(tag, from)?;
    let (tag, until, _) = first(rest)?;
    Some([from, time(tag, until)?])
}

fn time(tag: u8, digits: &[u8]) -> Option<String> {
    let digits = std::str::from_utf8(digits).ok()?;
    match tag {
        GENERAL_TIME => Some(digits.to_owned()),
        // Two digits of the year: those of 1950 to 2049.
        UTC_TIME => {
            let year: u8 = digits.get(..2)?.parse().ok()?;
            let century = if year >= 50 { "19" } else { "20" };
            Some(format!("{century}{digits}"))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_written_as_they_are_read() {
        for (length, head) in [
            (0, vec![4, 0]),
            (127, vec![4, 127]),
            (128, vec![4, 0x81, 128]),
            (256, vec![4, 0x82, 1, 0]),
            (70_000, vec![4, 0x83, 1, 0x11, 0x70]),
        ] {
            let content = vec![7; length];
            let written = value(OCTET_STRING, &content);
            assert_eq!(written[..head.len()], head);
            let read = first(&written);
            assert_eq!(read, Some((OCTET_STRING, &content[..], &[][..])));
            // What is cut off is nothing.
            if length > 0 {
                assert_eq!(first(&written[..written.len() - 1]), None);
            }
        }
    }

    #[test]
    fn both_forms_of_time_are_in_the_order_of_time() {
        let read = [
            (UTC_TIME, "500101000000Z", "19500101000000Z"),
            (UTC_TIME, "491231235959Z", "20491231235959Z"),
            (GENERAL_TIME, "20500101000000Z", "20500101000000Z"),
        ];
        for (tag, written, told) in read {
            assert_eq!(time(tag, written.as_bytes()).as_deref(), Some(told));
        }
        assert_eq!(time(UTF8, b"20500101000000Z"), None);
        assert_eq!(time(UTC_TIME, b"x"), None);
        assert_eq!(holds(b""), None);
        assert_eq!(holds(&[0x30, 0x80, 1, 2, 3]), None);
    }
}
