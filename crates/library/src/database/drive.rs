//! Whether a folder lies on this computer: locks, and memory that two programs share, do not hold across a network.

use std::path::{Path, PathBuf};

/// File systems that reach another computer, as Linux calls them.
const NETWORK: [&str; 21] = [
    "nfs",
    "nfs4",
    "cifs",
    "smb3",
    "smbfs",
    "afs",
    "ceph",
    "9p",
    "ncpfs",
    "coda",
    "lustre",
    "glusterfs",
    "beegfs",
    "gpfs",
    "davfs",
    "vboxsf",
    "fuse.sshfs",
    "fuse.rclone",
    "fuse.glusterfs",
    "fuse.s3fs",
    "fuse.davfs2",
];

/// The kind of network drive that a folder lies on, or that one of its parents does when it is not there yet. `None` for one of this computer,
/// and where the system does not say.
pub(crate) fn network(folder: &Path) -> Option<String> {
    let there = folder.ancestors().find_map(|f| f.canonicalize().ok());
    let there = there.or_else(|| std::env::current_dir().ok())?;
    if is_share(&there) {
        return Some("a share of another computer".into());
    }
    let mounts = std::fs::read_to_string("/proc/self/mountinfo").ok()?;
    let kind = kind_of(&there, &mounts)?;
    NETWORK.contains(&kind.as_str()).then_some(kind)
}

/// Whether it is `\\computer\share` of Windows, which canonical paths write `\\?\UNC\computer\share`.
fn is_share(path: &Path) -> bool {
    let text = path.to_string_lossy();
    match text.strip_prefix(r"\\") {
        None => false,
        Some(rest) => rest.starts_with(r"?\UNC\") || !rest.starts_with(['?', '.']),
    }
}

/// The file system of a path, by the lines of `mountinfo`: the last one whose mount point holds it most closely.
fn kind_of(path: &Path, mounts: &str) -> Option<String> {
    let of = |line: &str| {
        let (mount, device) = line.split_once(" - ")?;
        let point = unescaped(mount.split(' ').nth(4)?);
        let kind = device.split(' ').next()?;
        path.starts_with(&point)
            .then(|| (point.components().count(), kind.to_owned()))
    };
    // Of two at one place the later covers the earlier; `max_by_key` takes the last.
    let closest = mounts
        .lines()
        .filter_map(of)
        .max_by_key(|(depth, _)| *depth);
    closest.map(|(_, kind)| kind)
}

/// Blanks and the like are written as three digits.
fn unescaped(point: &str) -> PathBuf {
    let mut out = String::new();
    let mut rest = point;
    while let Some((before, after)) = rest.split_once('\\') {
        out.push_str(before);
        let digits = after.get(..3).and_then(|d| u8::from_str_radix(d, 8).ok());
        match digits {
            Some(code) => {
                out.push(code.into());
                rest = &after[3..];
            }
            None => {
                out.push('\\');
                rest = after;
            }
        }
    }
    out.push_str(rest);
    PathBuf::from(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOUNTS: &str = r"22 1 254:0 / / rw,relatime - ext4 /dev/vda rw
30 22 0:26 / /home rw,nosuid - nfs4 server:/home rw,vers=4.2
31 30 254:1 / /home/anna/local\040disk rw - xfs /dev/vdb rw
32 22 0:30 / /mnt/share rw - cifs //nas/data rw
33 22 0:31 / /mnt/ssh rw - fuse.sshfs me@there:/ rw
34 22 0:32 / /media/usb rw - fuseblk /dev/sdb1 rw
35 22 254:9 / /twice rw - ext4 /dev/vdc rw
36 22 0:33 / /twice rw - nfs server:/twice rw";

    #[test]
    fn the_closest_mount_tells() {
        for (path, kind) in [
            ("/var/lib/scopeservo", "ext4"),
            ("/home/anna/data", "nfs4"),
            ("/home/anna/local disk/data", "xfs"),
            ("/homes/anna", "ext4"),
            ("/mnt/share", "cifs"),
            ("/mnt/ssh/x", "fuse.sshfs"),
            ("/media/usb/data", "fuseblk"),
            ("/twice/x", "nfs"),
        ] {
            assert_eq!(
                kind_of(Path::new(path), MOUNTS).as_deref(),
                Some(kind),
                "{path}"
            );
        }
        assert_eq!(kind_of(Path::new("/x"), "nonsense\n\n- - -"), None);
    }

    #[test]
    fn shares_of_windows_are_known_by_name() {
        for share in [r"\\nas\data\scope", r"\\?\UNC\nas\data"] {
            assert!(is_share(Path::new(share)), "{share}");
        }
        for own in [
            r"C:\Users\anna",
            r"\\?\C:\Users\anna",
            r"\\.\pipe",
            "/home/anna",
        ] {
            assert!(!is_share(Path::new(own)), "{own}");
        }
    }

    #[test]
    fn the_temporary_folder_is_of_this_computer_or_the_test_says_so() {
        let dir = tempfile::tempdir().unwrap();
        let kind = network(&dir.path().join("not/yet/there"));
        assert_eq!(kind, None, "tests need a temporary folder on this computer");
    }
}
