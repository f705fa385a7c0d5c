//! By which names we may be asked.

use std::net::SocketAddr;

/// The names and ports under which this server may be asked: a page of another name that leads here is somebody else's.
#[derive(Debug, Clone)]
pub(crate) struct Names {
    /// Of this computer alone.
    own: Vec<String>,
    /// Of a proxy.
    others: Vec<String>,
}

impl Names {
    /// Those of a loopback address, and others that were told.
    pub(crate) fn of(address: SocketAddr, others: &[String]) -> Self {
        let port = address.port();
        let own = ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"));
        let others = others.iter().map(|name| match name.contains(':') {
            true => name.to_ascii_lowercase(),
            false => format!("{}:{port}", name.to_ascii_lowercase()),
        });
        Self {
            own: own.into(),
            others: others.collect(),
        }
    }

    pub(crate) fn has(&self, host: &str) -> bool {
        self.is_own(host) || self.others.contains(&host.to_ascii_lowercase())
    }

    /// Whether it is a name that means this computer wherever it is said.
    pub(crate) fn is_own(&self, host: &str) -> bool {
        self.own.contains(&host.to_ascii_lowercase())
    }
}

/// The host of an origin.
pub(crate) fn host_of(origin: &str) -> &str {
    let rest = origin.strip_prefix("http://");
    let rest = rest.or_else(|| origin.strip_prefix("https://"));
    rest.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_own_names_lead_here() {
        let address = "127.0.0.1:7070".parse().unwrap();
        let names = Names::of(address, &["Scope-3.lab".into(), "proxy.lab:443".into()]);
        for host in [
            "127.0.0.1:7070",
            "LOCALHOST:7070",
            "[::1]:7070",
            "scope-3.lab:7070",
            "proxy.lab:443",
        ] {
            assert!(names.has(host), "{host}");
        }
        for host in [
            "localhost",
            "127.0.0.1:80",
            "evil.example:7070",
            "scope-3.lab.evil:7070",
            "",
        ] {
            assert!(!names.has(host), "{host}");
        }
        assert!(names.has(host_of("http://localhost:7070")));
        for origin in [
            "null",
            "http://localhost:7071",
            "file://localhost:7070",
            "http://evil.example",
        ] {
            assert!(!names.has(host_of(origin)), "{origin}");
        }
    }
}
