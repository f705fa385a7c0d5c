//! A backup is brought back whole, or nothing of it is.

mod common;

use common::{keep, label, run};
use scopeservo_library::{Database, Label, LibraryError, Targets as _, restore};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// One header of an archive, and what is filled up to.
const BLOCK: usize = 512;

/// A library with a few things in it, and its backup.
fn backed_up() -> (tempfile::TempDir, Database, Vec<u8>) {
    let dir = tempfile::tempdir().unwrap();
    let library = Database::new(dir.path().join("data"));
    keep(&library, "spot", &label("17-B", "a note")).unwrap();
    keep(&library, "other", &Label::default()).unwrap();
    run(&library, "reposition", "spot", 4, b"<p>");
    let file = dir.path().join("backup.tar");
    library.back_up(&file, &mut |_, _| {}).unwrap();
    let bytes = fs::read(file).unwrap();
    (dir, library, bytes)
}

/// Where each member lies, its header first; and what it is called.
fn members(archive: &[u8]) -> Vec<(String, Range<usize>, Range<usize>)> {
    let mut all = Vec::new();
    let mut at = 0;
    while archive[at..].iter().take(BLOCK).any(|b| *b != 0) {
        let header = &archive[at..at + BLOCK];
        let name = header[..100].split(|b| *b == 0).next().unwrap();
        let size = std::str::from_utf8(&header[124..135]).unwrap();
        let size = usize::from_str_radix(size.trim_matches(['\0', ' ']), 8).unwrap();
        let data = at + BLOCK..at + BLOCK + size;
        let name = String::from_utf8(name.to_vec()).unwrap();
        all.push((name, at..at + BLOCK, data.clone()));
        at = data.end.next_multiple_of(BLOCK);
    }
    all
}

/// Tries to bring an archive back into a folder of its own.
fn tried(
    dir: &Path,
    archive: &[u8],
    without_sums: bool,
) -> (Result<scopeservo_library::Restored, LibraryError>, PathBuf) {
    let within = tempfile::tempdir_in(dir).unwrap().keep();
    let file = within.join("backup.tar");
    fs::write(&file, archive).unwrap();
    let data = within.join("data");
    (restore(&file, &data, without_sums), data)
}

fn is_empty(folder: &Path) -> bool {
    !folder.exists() || fs::read_dir(folder).unwrap().next().is_none()
}

#[test]
fn a_backup_tells_its_sums_as_other_programs_check_them() {
    let (dir, _, bytes) = backed_up();
    let all = members(&bytes);
    let names: Vec<&str> = all.iter().map(|(name, ..)| name.as_str()).collect();
    assert_eq!(names[0], "library.sqlite3");
    assert_eq!(names[names.len() - 1], "SHA256SUMS");
    let (_, _, sums) = &all[all.len() - 1];
    let text = std::str::from_utf8(&bytes[sums.clone()]).unwrap();
    assert_eq!(text.lines().count(), names.len() - 1);
    for (name, ..) in &all[1..all.len() - 1] {
        let sum = name.rsplit('/').next().unwrap().split('.').next().unwrap();
        assert!(text.contains(&format!("{sum}  {name}\n")), "{name}");
    }
    let (brought, data) = tried(dir.path(), &bytes, false);
    assert_eq!(brought.unwrap().objects, names.len() - 2);
    let back = Database::new(data);
    assert_eq!(back.target_names().unwrap(), ["other", "spot"]);
    assert_eq!(back.check(false, &mut |_, _| {}).unwrap().faults, []);
}

#[test]
fn a_backup_that_ends_early_is_refused_wherever_it_ends() {
    let (dir, _, bytes) = backed_up();
    let all = members(&bytes);
    let mut cuts = vec![0, 1];
    for (_, header, data) in &all {
        cuts.extend([
            header.start,
            header.start + 1,
            header.start + 257,
            header.end,
            data.start + data.len() / 2,
            data.end - 1,
        ]);
    }
    for cut in cuts {
        for without_sums in [false, true] {
            let (brought, data) = tried(dir.path(), &bytes[..cut], without_sums);
            let is_between = all.iter().any(|(_, header, _)| header.start == cut) && cut > 0;
            match brought {
                // Between two members nothing tells that there were more, but for the sums.
                Err(LibraryError::NoSums { .. }) => assert!(is_between && !without_sums, "{cut}"),
                Err(LibraryError::Damaged { .. }) => assert!(!is_between, "{cut}"),
                Err(other) => panic!("{cut}: {other}"),
                Ok(brought) => {
                    assert!(is_between && without_sums, "{cut}");
                    assert!(!brought.summed);
                    // What the database names and the archive does not have is told.
                    let there = all.iter().filter(|(_, header, _)| header.start < cut);
                    assert_eq!(brought.objects, there.count() - 1, "{cut}");
                    let gone = all.len() - 2 - brought.objects;
                    assert_eq!(brought.missing.len(), gone, "{cut}");
                    continue;
                }
            }
            assert!(is_empty(&data), "{cut}");
        }
    }
    // With its last member, but without what tar adds at the end, all of it is there.
    let end = all.last().unwrap().2.end.next_multiple_of(BLOCK);
    assert!(tried(dir.path(), &bytes[..end], false).0.unwrap().summed);
}

#[test]
fn one_byte_that_is_another_is_noticed_wherever_it_lies() {
    let (dir, library, bytes) = backed_up();
    let all = members(&bytes);
    let mut places = Vec::new();
    for (_, header, data) in &all {
        places.extend([header.start, header.start + 3, header.start + 130]);
        places.extend([header.start + 156, header.start + 148]);
        places.extend([data.start, data.start + data.len() / 3, data.end - 1]);
    }
    for at in places {
        let mut bad = bytes.clone();
        bad[at] ^= 0x01;
        let (brought, data) = tried(dir.path(), &bad, false);
        let said = brought.unwrap_err();
        assert!(
            matches!(
                said,
                LibraryError::Damaged { .. } | LibraryError::NoSums { .. }
            ),
            "{at}: {said}"
        );
        assert!(is_empty(&data), "{at}");
    }
    // Members that change places, one that is there twice, and one too many.
    let member = |k: usize| bytes[all[k].1.start..all[k].2.end.next_multiple_of(BLOCK)].to_vec();
    let last = all.len() - 1;
    for (what, order) in [
        (
            "not in it",
            (0..last).filter(|k| *k != 2).chain([last]).collect(),
        ),
        (
            "twice",
            [&[0, 1, 1][..], &(2..=last).collect::<Vec<_>>()].concat(),
        ),
        (
            "comes after its end",
            [(0..=last).collect(), vec![1]].concat(),
        ),
    ] {
        let order: Vec<usize> = order;
        let bad: Vec<u8> = order.into_iter().flat_map(member).collect();
        let (brought, data) = tried(dir.path(), &bad, false);
        let said = brought.unwrap_err().to_string();
        assert!(said.contains(what), "{said}");
        assert!(is_empty(&data), "{what}");
    }
    assert_eq!(library.target_names().unwrap().len(), 2);
}

/// A header with a sum that is right, whatever it says.
fn header(name: &str, size: u64, kind: u8) -> Vec<u8> {
    let mut header = tar::Header::new_gnu();
    header.set_path(name).unwrap();
    header.set_size(size);
    header.set_mode(0o644);
    header.set_entry_type(tar::EntryType::new(kind));
    header.set_cksum();
    header.as_bytes().to_vec()
}

#[test]
fn a_member_that_claims_to_be_huge_or_is_no_plain_file_is_refused_unread() {
    let (dir, _, bytes) = backed_up();
    let first = members(&bytes)[1].1.start;
    let object = format!("objects/ab/{}.png", "ab".repeat(32));
    let (huge, more) = (1 << 60, bytes.len() as u64);
    for (name, size, kind, what) in [
        (&*object, huge, b'0', "is said to have"),
        (&*object, 2 << 30, b'0', "is said to have"),
        ("SHA256SUMS", huge, b'0', "is said to have"),
        ("library.sqlite3", more * 4, b'0', "is said to have"),
        // Names and sizes told by others, holes, links, folders, devices.
        ("././@LongLink", 700, b'L', "is no plain file"),
        ("pax", 700, b'x', "is no plain file"),
        ("pax", 700, b'g', "is no plain file"),
        (&*object, 700, b'S', "is no plain file"),
        (&*object, 0, b'1', "is no plain file"),
        (&*object, 0, b'2', "is no plain file"),
        ("objects/", 0, b'5', "is no plain file"),
        (&*object, 0, b'6', "is no plain file"),
        // What would lie elsewhere.
        ("objects/ab/x.png", 700, b'0', "is nothing of a library"),
        ("elsewhere", 700, b'0', "is nothing of a library"),
    ] {
        for at in [0, first] {
            let mut bad = bytes[..at].to_vec();
            bad.extend(header(name, size, kind));
            bad.extend([7; 1024]);
            bad.extend(&bytes[at..]);
            for without_sums in [false, true] {
                let (brought, data) = tried(dir.path(), &bad, without_sums);
                let said = brought.unwrap_err().to_string();
                let is_second = at > 0 && name == "library.sqlite3";
                assert!(said.contains(what) || is_second, "{name} {size}: {said}");
                assert!(is_empty(&data), "{name}");
            }
        }
    }
}

#[test]
fn a_library_that_was_there_is_left_alone_with_what_it_has_written_ahead() {
    let (dir, _, bytes) = backed_up();
    let file = dir.path().join("again.tar");
    fs::write(&file, bytes).unwrap();
    for part in ["", "-wal", "-shm", "-journal"] {
        let data = tempfile::tempdir().unwrap();
        let there = data.path().join(format!("library.sqlite3{part}"));
        fs::write(&there, "of another").unwrap();
        let said = restore(&file, data.path(), false).unwrap_err();
        assert!(matches!(said, LibraryError::NotKept { .. }), "{said}");
        assert!(said.to_string().contains(there.to_str().unwrap()), "{said}");
        assert_eq!(fs::read(&there).unwrap(), b"of another");
        assert_eq!(fs::read_dir(data.path()).unwrap().count(), 1);
    }
}
