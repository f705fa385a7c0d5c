//! What is connected to this computer as far as its files tell, or on Windows its registry: serial ports, and video devices of Linux. No device is
//! opened, as opening a port can already disturb who uses it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A device that could be one of the instrument's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Nearby {
    /// Its path, as a description takes it. One that stays the same when it is plugged in again, where there is one.
    pub(crate) path: String,
    /// What it says of itself; its short name where it says nothing.
    pub(crate) what: String,
}

/// The serial ports of adapters and boards, under the root of the file system.
pub(crate) fn serial_ports(root: &Path) -> Vec<Nearby> {
    if cfg!(windows) {
        // The system's own tool reads the registry, which nothing else does without unsafe code.
        let mut asked = Command::new("reg");
        asked.args(["query", r"HKLM\HARDWARE\DEVICEMAP\SERIALCOMM"]);
        let said = asked.output().map(|o| o.stdout).unwrap_or_default();
        return com_ports(&String::from_utf8_lossy(&said));
    }
    let devices = root.join("dev");
    let named = links(&devices.join("serial/by-id"));
    let is_adapter = |name: &str| {
        let kinds = ["ttyUSB", "ttyACM", "cu.usbserial", "cu.usbmodem"];
        kinds.iter().any(|kind| name.starts_with(kind))
    };
    with_names(&devices, named, is_adapter, |name| name.into())
}

/// The ports of Windows, as `reg query` lists them: the driver's name, the kind of the value, the port.
fn com_ports(said: &str) -> Vec<Nearby> {
    let ports = said.lines().filter_map(|line| {
        let (device, port) = line.split_once("REG_SZ")?;
        let port = port.trim();
        let number = port.strip_prefix("COM")?;
        let is_port = !number.is_empty() && number.chars().all(|c| c.is_ascii_digit());
        is_port.then(|| Nearby {
            path: port.into(),
            what: printable(device.trim()),
        })
    });
    let mut ports: Vec<Nearby> = ports.collect();
    ports.sort_by_key(|port| port.path[3..].parse::<u32>().unwrap_or(u32::MAX));
    ports
}

/// The video devices of Linux.
pub(crate) fn cameras(root: &Path) -> Vec<Nearby> {
    let devices = root.join("dev");
    let named = links(&devices.join("v4l/by-id"));
    let is_video = |name: &str| {
        let number = name.strip_prefix("video");
        number.is_some_and(|n| !n.is_empty() && n.chars().all(|c| c.is_ascii_digit()))
    };
    let says = |name: &str| {
        let file = root.join("sys/class/video4linux").join(name).join("name");
        let said = fs::read_to_string(file).unwrap_or_default();
        match printable(said.trim()) {
            said if said.is_empty() => name.into(),
            said => said,
        }
    };
    with_names(&devices, named, is_video, says)
}

/// Links by their paths, with the device that each leads to.
fn links(folder: &Path) -> Vec<(PathBuf, PathBuf)> {
    let links = names(folder).into_iter().map(|name| folder.join(name));
    links
        .filter_map(|link| Some((link.clone(), link.canonicalize().ok()?)))
        .collect()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    names
}

/// The devices of a kind, each by the link that tells which it is, where there is one.
fn with_names(
    devices: &Path,
    named: Vec<(PathBuf, PathBuf)>,
    is_one: impl Fn(&str) -> bool,
    says: impl Fn(&str) -> String,
) -> Vec<Nearby> {
    let all = names(devices).into_iter().filter(|name| is_one(name));
    all.map(|name| {
        let device = devices.join(&name);
        let real = device.canonicalize().unwrap_or(device.clone());
        let link = named.iter().find(|(_, to)| *to == real);
        Nearby {
            path: link.map_or(&device, |(link, _)| link).display().to_string(),
            what: says(&name),
        }
    })
    .collect()
}

/// A device's own words, without what would do something to a terminal.
fn printable(said: &str) -> String {
    said.chars().filter(|c| !c.is_control()).take(80).collect()
}

/// What was found, as comments of a description.
pub(crate) fn comments(ports: &[Nearby], cameras: &[Nearby]) -> String {
    let mut text = String::new();
    for (kind, all) in [("serial port", ports), ("video device", cameras)] {
        for Nearby { path, what } in all {
            text += &format!("# found here, a {kind}: {path} ({what})\n");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder as the root of a computer with these devices.
    fn computer(files: &[&str]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for file in files {
            let path = root.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
        root
    }

    #[test]
    fn ports_and_cameras_are_found_and_other_devices_are_not() {
        let root = computer(&[
            "dev/ttyUSB0",
            "dev/ttyACM1",
            "dev/tty1",
            "dev/ttyS0",
            "dev/null",
            "dev/cu.usbserial-A1",
            "dev/video0",
            "dev/video12",
            "dev/videos",
        ]);
        let names = root.path().join("sys/class/video4linux/video0");
        fs::create_dir_all(&names).unwrap();
        fs::write(names.join("name"), "USB \u{1b}[2JMicroscope\n").unwrap();
        let of = |all: Vec<Nearby>| -> Vec<(String, String)> {
            let root = root.path().display().to_string();
            all.into_iter()
                .map(|n| (n.path.replace(&root, ""), n.what))
                .collect()
        };
        let pair = |path: &str, what: &str| (path.to_owned(), what.to_owned());
        assert_eq!(
            of(serial_ports(root.path())),
            [
                pair("/dev/cu.usbserial-A1", "cu.usbserial-A1"),
                pair("/dev/ttyACM1", "ttyACM1"),
                pair("/dev/ttyUSB0", "ttyUSB0")
            ]
        );
        assert_eq!(
            of(cameras(root.path())),
            [
                pair("/dev/video0", "USB [2JMicroscope"),
                pair("/dev/video12", "video12")
            ]
        );
        let none = computer(&["etc/passwd"]);
        assert!(serial_ports(none.path()).is_empty() && cameras(none.path()).is_empty());
    }

    #[test]
    fn the_ports_of_windows_are_those_that_its_registry_lists() {
        let said = "\r\nHKEY_LOCAL_MACHINE\\HARDWARE\\DEVICEMAP\\SERIALCOMM\r\n    \\Device\\VCP0    REG_SZ    COM12\r\n    \
                    \\Device\\USBSER000    REG_SZ    COM3\r\n    \\Device\\Serial0    REG_SZ    COM1\r\n    odd    REG_SZ    LPT1\r\n\r\n";
        let found: Vec<_> = com_ports(said)
            .into_iter()
            .map(|n| (n.path, n.what))
            .collect();
        let pair = |path: &str, what: &str| (path.to_owned(), what.to_owned());
        assert_eq!(
            found,
            [
                pair("COM1", "\\Device\\Serial0"),
                pair("COM3", "\\Device\\USBSER000"),
                pair("COM12", "\\Device\\VCP0")
            ]
        );
        for none in [
            "",
            "ERROR: The system was unable to find the specified registry key or value.",
            "x REG_SZ COM",
            "REG_SZ COMX",
        ] {
            assert_eq!(com_ports(none), []);
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_port_goes_by_the_link_that_stays_the_same() {
        let root = computer(&["dev/ttyUSB3"]);
        let links = root.path().join("dev/serial/by-id");
        fs::create_dir_all(&links).unwrap();
        std::os::unix::fs::symlink("../../ttyUSB3", links.join("usb-Marlin_board")).unwrap();
        let found = serial_ports(root.path());
        assert!(
            found[0].path.ends_with("dev/serial/by-id/usb-Marlin_board"),
            "{found:?}"
        );
        assert!(comments(&found, &[]).starts_with("# found here, a serial port: "));
    }
}
