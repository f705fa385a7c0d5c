//! By which names we may be asked.

use std::net::SocketAddr;

/// The names and ports under which this server may be asked: a page of another name that leads here is somebody else's.
#[derive(Debug, Clone)]
pub(crate) struct Names {
    /// Of this computer alone.
    own: Vec<String>,
    /// Of a proxy, or as others know this computer.
    others: Vec<String>,
    /// Pages of ours come by TLS and in no other way.
    by_tls: bool,
}

/// What browsers leave out.
const USUAL_PORTS: [&str; 2] = [":80", ":443"];

impl Names {
    /// Those that mean this computer, at these ports, and others that were told; those without a port have the first one.
    pub(crate) fn of(ports: &[u16], others: &[String], by_tls: bool) -> Self {
        let own = ports.iter().flat_map(|port| {
            ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"))
        });
        let first = ports.first().copied().unwrap_or_default();
        let others = others.iter().map(|name| match has_port(name) {
            true => name.to_ascii_lowercase(),
            false => format!("{}:{first}", name.to_ascii_lowercase()),
        });
        Self {
            own: own.flat_map(as_browsers_say).collect(),
            others: others.flat_map(as_browsers_say).collect(),
            by_tls,
        }
    }

    /// Whether it is one of them, or the address at which whoever asks has come.
    pub(crate) fn has(&self, host: &str, at: SocketAddr) -> bool {
        self.is_own(host, at) || self.others.contains(&host.to_ascii_lowercase())
    }

    /// Whether it is a name that means this computer wherever it is said, or the address at which whoever asks has come.
    pub(crate) fn is_own(&self, host: &str, at: SocketAddr) -> bool {
        let host = host.to_ascii_lowercase();
        self.own.contains(&host) || as_browsers_say(at.to_string()).any(|at| at == host)
    }

    /// The host of an origin, where it came by a way that pages of ours come.
    pub(crate) fn host_of<'a>(&self, origin: &'a str) -> Option<&'a str> {
        let plain = origin.strip_prefix("http://").filter(|_| !self.by_tls);
        plain.or_else(|| origin.strip_prefix("https://"))
    }
}

fn has_port(name: &str) -> bool {
    let after = name.rsplit(']').next().unwrap_or_default();
    after.contains(':')
}

/// With its port, and without one that goes without saying.
fn as_browsers_say(name: String) -> impl Iterator<Item = String> {
    let short = USUAL_PORTS.iter().find_map(|port| name.strip_suffix(port));
    let short = short.map(str::to_owned);
    std::iter::once(name).chain(short)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_own_names_lead_here() {
        let names = Names::of(
            &[7070],
            &["Scope-3.lab".into(), "proxy.lab:443".into()],
            false,
        );
        let at = "127.0.0.1:7070".parse().unwrap();
        for host in [
            "127.0.0.1:7070",
            "LOCALHOST:7070",
            "[::1]:7070",
            "scope-3.lab:7070",
            "proxy.lab:443",
            // As browsers say it.
            "proxy.lab",
        ] {
            assert!(names.has(host, at), "{host}");
        }
        for host in [
            "localhost",
            "127.0.0.1:80",
            "evil.example:7070",
            "scope-3.lab.evil:7070",
            "scope-3.lab",
            "10.0.0.5:7070",
            "",
        ] {
            assert!(!names.has(host, at), "{host}");
        }
        let has = |origin: &str| {
            names
                .host_of(origin)
                .is_some_and(|host| names.has(host, at))
        };
        assert!(has("http://localhost:7070"));
        assert!(has("https://proxy.lab"));
        for origin in [
            "null",
            "http://localhost:7071",
            "file://localhost:7070",
            "http://evil.example",
        ] {
            assert!(!has(origin), "{origin}");
        }
    }

    #[test]
    fn by_tls_the_address_that_was_reached_is_a_name_and_plain_pages_are_not_ours() {
        let names = Names::of(&[443, 50123], &[], true);
        let at = "[::ffff:10.0.0.5]:443".parse().unwrap();
        assert!(!names.has("10.0.0.5", at));
        let at = "10.0.0.5:443".parse().unwrap();
        for host in ["10.0.0.5", "10.0.0.5:443", "127.0.0.1", "localhost:50123"] {
            assert!(names.is_own(host, at), "{host}");
        }
        assert!(!names.has("10.0.0.6", at) && !names.has("10.0.0.5:50123", at));
        assert_eq!(names.host_of("https://10.0.0.5"), Some("10.0.0.5"));
        assert_eq!(names.host_of("http://10.0.0.5"), None);
    }
}
