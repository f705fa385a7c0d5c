//! What is no regular file is refused at once, and what is too large is not read.

use scopeservo_files::{open, read, read_text};
use std::io::ErrorKind;
use std::path::Path;

#[test]
fn a_file_is_read_up_to_its_bound_and_no_further() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    for n in [0, 1, 99, 100] {
        std::fs::write(&path, vec![b'x'; n]).unwrap();
        assert_eq!(read(&path, 100).unwrap().len(), n);
        assert_eq!(read(&path, u64::MAX).unwrap().len(), n);
        assert_eq!(open(&path).unwrap().1, n as u64);
    }
    for n in [101, 102, 5000] {
        std::fs::write(&path, vec![b'x'; n]).unwrap();
        let e = read(&path, 100).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::FileTooLarge);
        assert!(e.to_string().contains("100 bytes"), "{e}");
    }
}

#[test]
fn folders_are_named_and_so_is_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    assert_eq!(
        read(dir.path(), 9).unwrap_err().kind(),
        ErrorKind::IsADirectory
    );
    let missing = read(&dir.path().join("no"), 9).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
}

#[test]
fn text_that_is_none_is_told_by_its_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    std::fs::write(&path, "\u{b5}m").unwrap();
    assert_eq!(read_text(&path, 100).unwrap(), "\u{b5}m");
    for (bytes, line) in [(&b"\xb5m"[..], 1), (b"a\nb\xff", 2), (b"\n\n\n\xc3", 4)] {
        std::fs::write(&path, bytes).unwrap();
        let e = read_text(&path, 100).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::InvalidData);
        assert!(e.to_string().contains(&format!("line {line} ")), "{e}");
    }
}

/// No test waits here: before the fix the first of these did for ever.
#[cfg(unix)]
#[test]
fn pipes_devices_and_links_to_them_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    let link = dir.path().join("link");
    std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
    let mut paths = vec![Path::new("/dev/zero"), Path::new("/dev/null"), &link];
    if made.is_ok_and(|s| s.success()) {
        paths.push(&pipe);
    }
    for path in paths {
        let e = read(path, 100).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::InvalidInput, "{}", path.display());
        assert!(e.to_string().contains("no regular file"), "{e}");
    }
}
