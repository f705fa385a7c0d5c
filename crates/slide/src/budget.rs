//! How much memory a picture may take.

use std::io::Read;

use crate::Fault;

/// Bytes that reading a picture may hold at once, what it gives back included. Asked before each allocation that a file decides about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// The bound, bytes.
    pub bytes: u64,
}

/// No picture takes more on any machine.
const MOST: u64 = 2 << 30;

impl Budget {
    /// The smaller of 2 GiB and half of the memory of this machine, where the system tells it (Linux).
    #[must_use]
    pub fn of_this_machine() -> Self {
        let half = memory().map_or(MOST, |bytes| bytes / 2);
        Self {
            bytes: half.min(MOST),
        }
    }

    /// Refuses a picture whose reading would hold `needed` bytes.
    pub(crate) fn check(self, size: [u32; 2], needed: u64) -> Result<(), Fault> {
        match needed <= self.bytes {
            true => Ok(()),
            false => Err(Fault::TooLarge {
                width: size[0],
                height: size[1],
                needed_mb: needed.div_ceil(1_000_000),
                allowed_mb: self.bytes / 1_000_000,
            }),
        }
    }
}

impl Default for Budget {
    fn default() -> Self {
        Self::of_this_machine()
    }
}

/// Memory of this machine, or of the container that the program runs in, bytes.
fn memory() -> Option<u64> {
    let text = |path: &str| {
        let mut text = String::new();
        let file = std::fs::File::open(path).ok()?;
        file.take(1 << 16).read_to_string(&mut text).ok()?;
        Some(text)
    };
    let machine = text("/proc/meminfo").and_then(|t| total(&t));
    let container = text("/sys/fs/cgroup/memory.max").and_then(|t| t.trim().parse().ok());
    machine.into_iter().chain(container).min()
}

/// `MemTotal:       24576000 kB`
fn total(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|l| l.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kilobytes.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_of_a_machine_is_read() {
        let text = "MemTotal:       24576000 kB\nMemFree:  1 kB\n";
        assert_eq!(total(text), Some(24_576_000 * 1024));
        assert_eq!(total("MemFree: 1 kB"), None);
        assert_eq!(total("MemTotal: x kB"), None);
        let bytes = Budget::of_this_machine().bytes;
        assert!(bytes > 0 && bytes <= MOST);
    }
}
