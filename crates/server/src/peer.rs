//! Whoever a connection came from, and at which of our addresses.

use axum::http::HeaderMap;
use std::net::{IpAddr, SocketAddr};

/// What proxies add for whom they ask.
pub(crate) const FORWARDED: [&str; 4] = [
    "forwarded",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-real-ip",
];

/// The two ends of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Peer {
    /// From where.
    pub(crate) ip: IpAddr,
    /// Which of our addresses was reached.
    pub(crate) at: SocketAddr,
    /// By TLS of our own.
    pub(crate) by_tls: bool,
    /// It is one of the proxies that were named.
    pub(crate) is_proxy: bool,
}

/// Where whoever asks is, by a name.
#[derive(Debug, Clone)]
pub(crate) struct Whence(pub(crate) String);

impl Peer {
    /// Addresses as they are, not as IPv6 writes those of IPv4.
    pub(crate) fn new(from: SocketAddr, at: SocketAddr, by_tls: bool, proxies: &[IpAddr]) -> Self {
        let ip = from.ip().to_canonical();
        Self {
            ip,
            at: SocketAddr::new(at.ip().to_canonical(), at.port()),
            by_tls,
            is_proxy: proxies.contains(&ip),
        }
    }

    /// Whether it came from this computer, whoever asked there for whom.
    pub(crate) fn is_of_this_computer(&self) -> bool {
        self.ip.is_loopback() || self.ip == self.at.ip()
    }

    /// A name for where whoever asks is: what is limited is limited by it. Who sits here is kept from nothing by who comes through a proxy here.
    pub(crate) fn place(&self, headers: &HeaderMap, here: bool) -> String {
        match here {
            true => "here".into(),
            false => network(self.whose(headers)),
        }
    }

    /// For whom it is asked: what proxies say of that counts where the proxy is one that was named.
    pub(crate) fn whose(&self, headers: &HeaderMap) -> IpAddr {
        if !self.is_proxy {
            return self.ip;
        }
        // Each adds the one before it: the last one is what ours saw.
        let said = headers.get_all("x-forwarded-for").iter().next_back();
        let said = said.and_then(|said| said.to_str().ok());
        let last = said.and_then(|said| said.rsplit(',').next()?.trim().parse().ok());
        last.map_or(self.ip, |ip: IpAddr| ip.to_canonical())
    }
}

/// An address that one person has: of IPv6 everybody has a whole network.
pub(crate) fn network(ip: IpAddr) -> String {
    match ip {
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => {
            let [a, b, c, d, ..] = ip.segments();
            format!("{a:x}:{b:x}:{c:x}:{d:x}::/64")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_forwarded_counts_by_a_named_proxy_alone() {
        let peer = |from: &str, proxies: &[&str]| {
            let from = SocketAddr::new(from.parse().unwrap(), 50_000);
            let proxies: Vec<IpAddr> = proxies.iter().map(|p| p.parse().unwrap()).collect();
            Peer::new(from, "10.0.0.5:7070".parse().unwrap(), false, &proxies)
        };
        let mut headers = HeaderMap::new();
        headers.append("x-forwarded-for", "1.2.3.4".parse().unwrap());
        headers.append("x-forwarded-for", "6.6.6.6, 10.0.0.9".parse().unwrap());
        let ip = |text: &str| text.parse::<IpAddr>().unwrap();
        let stranger = peer("10.0.0.7", &["10.0.0.2"]);
        assert_eq!(stranger.whose(&headers), ip("10.0.0.7"));
        assert!(!stranger.is_proxy && !stranger.is_of_this_computer());
        // The end of the list is what the proxy saw itself.
        let proxy = peer("::ffff:10.0.0.2", &["10.0.0.2"]);
        assert_eq!(proxy.whose(&headers), ip("10.0.0.9"));
        assert_eq!(proxy.whose(&HeaderMap::new()), ip("10.0.0.2"));
        headers.insert("x-forwarded-for", "nonsense".parse().unwrap());
        assert_eq!(proxy.whose(&headers), ip("10.0.0.2"));
        // Of IPv6 the network counts.
        let [a, b] = ["2001:db8::1", "2001:db8::ffff:2"].map(|text| peer(text, &[]));
        let none = HeaderMap::new();
        assert_eq!(a.place(&none, false), b.place(&none, false));
        assert_eq!(stranger.place(&headers, false), "10.0.0.7");
        assert_eq!(peer("127.0.0.1", &[]).place(&none, true), "here");
        for own in ["127.0.0.1", "::1", "10.0.0.5"] {
            assert!(peer(own, &[]).is_of_this_computer(), "{own}");
        }
    }
}
