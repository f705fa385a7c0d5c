//! Is a JPEG stream complete? Decoders paint the missing rest grey and say nothing, so the markers are walked here.

/// True if the stream reaches its end-of-image marker: segments by their length, scans by their markers
/// (ITU-T T.81, annex B).
pub(crate) fn is_complete(data: &[u8]) -> bool {
    let mut at = 2;
    while let (Some(&lead), Some(&marker)) = (data.get(at), data.get(at + 1)) {
        if lead != 0xFF {
            // Stray bytes between segments; decoders skip them too.
            at += 1;
            continue;
        }
        match marker {
            0xFF => at += 1,
            0xD9 => return true,
            0x00 | 0x01 | 0xD0..=0xD8 => at += 2,
            _ => {
                let Some(len) = data.get(at + 2..at + 4) else {
                    return false;
                };
                at += 2 + usize::from(u16::from_be_bytes([len[0], len[1]]));
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::is_complete;

    #[test]
    fn an_end_marker_inside_a_segment_does_not_count() {
        let app = [0xFF, 0xD8, 0xFF, 0xE1, 0, 6, 0xFF, 0xD9, 1, 2];
        assert!(!is_complete(&app));
        let with_end = [&app[..], &[0xFF, 0xDA, 0, 2, 7, 0xFF, 0x00, 0xFF, 0xD9]].concat();
        assert!(is_complete(&with_end));
        assert!(!is_complete(&with_end[..with_end.len() - 1]));
        assert!(!is_complete(&[]));
    }
}
