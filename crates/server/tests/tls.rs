//! TLS: with a certificate of our own, with one that is given, and what is refused of either.

mod common;

use common::{Bench, HURRIED, PATIENCE};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use scopeservo_server::{Certificate, ServeError, Settings, TlsError};
use serde_json::json;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;

/// The fingerprint as somebody else computes it.
fn fingerprint(path: &Path) -> String {
    use sha2::Digest as _;
    let certificate = CertificateDer::from_pem_file(path).unwrap();
    let bytes = sha2::Sha256::digest(&certificate);
    let pairs: Vec<String> = bytes.iter().map(|b| format!("{b:02X}")).collect();
    pairs.join(":")
}

/// Somebody who trusts that certificate and no other.
fn trusting(certificate: &Path) -> Arc<ClientConfig> {
    let mut roots = RootCertStore::empty();
    roots
        .add(CertificateDer::from_pem_file(certificate).unwrap())
        .unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap();
    Arc::new(config.with_root_certificates(roots).with_no_client_auth())
}

/// One request by TLS, as bytes say it, to a server that goes by that name.
fn ask(
    config: &Arc<ClientConfig>,
    name: &str,
    at: SocketAddr,
    request: &str,
) -> std::io::Result<String> {
    let stream = TcpStream::connect(at)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let name = ServerName::try_from(name.to_owned()).unwrap();
    let connection = ClientConnection::new(config.clone(), name).unwrap();
    let mut stream = StreamOwned::new(connection, stream);
    stream.write_all(request.as_bytes())?;
    let mut answer = String::new();
    match stream.read_to_string(&mut answer) {
        Err(e) if answer.is_empty() => Err(e),
        _ => Ok(answer),
    }
}

fn get(host: impl std::fmt::Display, path: &str, more: &str) -> String {
    format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n{more}\r\n")
}

fn post(host: impl std::fmt::Display, path: &str, more: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "POST {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n{more}\r\n{body}"
    )
}

fn served(folder: &Arc<TempDir>, set: impl FnOnce(&mut Settings)) -> Bench {
    Bench::set(HURRIED, false, folder.clone(), |settings| {
        settings.tls = Some(Certificate::Own);
        set(settings);
    })
}

#[test]
fn a_certificate_of_our_own_is_made_once_and_known_by_its_fingerprint() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = served(&folder, |_| {});
    let file = folder.path().join("server/tls.pem");
    let told = bench.server.fingerprint().unwrap().to_owned();
    assert_eq!(told, fingerprint(&file));
    assert_eq!(told.len(), 95);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = file.metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "others can read the key");
    }
    assert!(bench.server.link().starts_with("https://127.0.0.1:"));
    // Whoever trusts it is served by each of its names, and by no other.
    let trusting = trusting(&file);
    let at = bench.address();
    for name in ["127.0.0.1", "localhost"] {
        let host = format!("{name}:{}", at.port());
        let page = ask(&trusting, name, at, &get(host, "/", "")).unwrap();
        assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    }
    assert!(ask(&trusting, "evil.example", at, &get(at, "/", "")).is_err());
    // What is spoken without it is answered or closed, and harms nobody.
    let plain = bench.stranger().get("/api/v1/state");
    assert_eq!((plain.status, plain.code().as_str()), (400, "not_tls"));
    let mut noise = TcpStream::connect(at).unwrap();
    noise.write_all(&[0x16, 3, 1, 0xff, 0xff, 1, 2, 3]).unwrap();
    noise.shutdown(std::net::Shutdown::Write).unwrap();
    let mut rest = Vec::new();
    let _ = noise.read_to_end(&mut rest);
    let silent = TcpStream::connect(at).unwrap();
    drop(silent);
    let page = ask(&trusting, "127.0.0.1", at, &get(at, "/", "")).unwrap();
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    // Another start has the same, and one under another name another.
    drop(bench);
    let again = served(&folder, |_| {});
    assert_eq!(again.server.fingerprint(), Some(told.as_str()));
    drop(again);
    let named = served(&folder, |settings| {
        settings.names = vec!["Scope-3.lab".into()]
    });
    assert_ne!(named.server.fingerprint(), Some(told.as_str()));
    // One that is damaged is made anew.
    drop(named);
    std::fs::write(&file, "-----BEGIN CERTIFICATE-----\nAAAA\n").unwrap();
    let mended = served(&folder, |_| {});
    assert_eq!(
        mended.server.fingerprint(),
        Some(fingerprint(&file).as_str())
    );
}

#[test]
fn by_tls_sessions_go_by_no_other_way_and_plain_pages_are_strangers() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = served(&folder, |settings| {
        settings.names = vec!["scope-3.lab".into()];
    });
    let (at, trusting) = (
        bench.address(),
        trusting(&folder.path().join("server/tls.pem")),
    );
    let key = bench.key.clone().unwrap();
    let claim = json!({"key": key, "name": "anna", "password": "long enough"}).to_string();
    let say = |request: &str| ask(&trusting, "127.0.0.1", at, request).unwrap();
    // A page that came without TLS is somebody else's, though it has our name.
    let plain = format!("origin: http://{at}\r\n");
    let refused = say(&post(at, "/api/v1/claim", &plain, &claim));
    assert!(refused.contains("wrong_origin"), "{refused}");
    let evil = say(&post("evil.example", "/api/v1/claim", "", &claim));
    assert!(evil.contains("wrong_host"), "{evil}");
    // Also where no page asks at all the session is for TLS alone.
    let come = say(&post(at, "/api/v1/claim", "", &claim));
    assert!(come.starts_with("HTTP/1.1 200"), "{come}");
    let cookie = come.lines().find_map(|l| l.strip_prefix("set-cookie: "));
    let cookie = cookie.unwrap();
    assert!(cookie.ends_with("; Secure"), "{cookie}");
    let session = format!("cookie: {}\r\n", cookie.split(';').next().unwrap());
    let own = format!("{session}origin: https://{at}\r\n");
    let me = say(&get(at, "/api/v1/me", &own));
    assert!(me.contains("\"here\":true"), "{me}");
    // By another name of this computer one may look, and is not at the microscope.
    let name = format!("scope-3.lab:{}", at.port());
    let other = get(
        &name,
        "/api/v1/me",
        &format!("{session}origin: https://{name}\r\n"),
    );
    let me = ask(&trusting, "scope-3.lab", at, &other).unwrap();
    assert!(me.contains("\"here\":false"), "{me}");
    // The command line comes by a door of its own, which opens to loopback.
    let door = std::fs::read(folder.path().join("server/door.json")).unwrap();
    let door: serde_json::Value = serde_json::from_slice(&door).unwrap();
    let inside: SocketAddr = door["address"].as_str().unwrap().parse().unwrap();
    assert!(inside.ip().is_loopback() && inside != at);
    let terminal = common::Client {
        address: inside,
        cookie: None,
    };
    let bearer = format!("Bearer {}", door["token"].as_str().unwrap());
    let state = terminal.with("GET", "/api/v1/state", &[("authorization", &bearer)], "");
    assert_eq!(state.status, 200, "{}", state.head);
}

#[test]
fn a_certificate_that_cannot_be_served_is_refused_with_what_to_do() {
    let folder = Arc::new(TempDir::new().unwrap());
    let of = |name: &str| folder.path().join(name);
    // Two pairs, as two servers made them.
    let pairs: Vec<PathBuf> = ["a", "b"]
        .iter()
        .map(|name| {
            let made = Arc::new(TempDir::new().unwrap());
            drop(served(&made, |_| {}));
            let pem = std::fs::read_to_string(made.path().join("server/tls.pem")).unwrap();
            let path = of(&format!("{name}.pem"));
            std::fs::write(&path, pem).unwrap();
            path
        })
        .collect();
    let [a, b] = [&pairs[0], &pairs[1]];
    std::fs::write(of("nothing.pem"), "no certificate at all").unwrap();
    std::fs::write(of("ended.pem"), ended(a)).unwrap();
    let files = |certificate: &Path, key: &Path| Certificate::Files {
        certificate: certificate.into(),
        key: key.into(),
    };
    let refused = |tls: Certificate| {
        let settings = Settings {
            listen: "127.0.0.1:0".parse().unwrap(),
            names: Vec::new(),
            tls: Some(tls),
            proxies: Vec::new(),
            limits: Default::default(),
            demo: true,
            folder: folder.path().join("server"),
        };
        match common::refused(&settings) {
            ServeError::Tls(error) => (error.to_string(), error),
            other => panic!("{other}"),
        }
    };
    let (said, why) = refused(files(&of("missing.pem"), a));
    assert!(matches!(why, TlsError::Certificate { .. }), "{said}");
    let (said, why) = refused(files(&of("nothing.pem"), a));
    assert!(matches!(why, TlsError::Certificate { .. }), "{said}");
    assert!(said.contains("there is none in it"), "{said}");
    let (said, why) = refused(files(a, &of("nothing.pem")));
    assert!(matches!(why, TlsError::Key { .. }), "{said}");
    let (said, why) = refused(files(a, b));
    assert!(matches!(why, TlsError::DoesNotFit { .. }), "{said}");
    let (said, why) = refused(files(&of("ended.pem"), a));
    assert!(matches!(why, TlsError::Expired { .. }), "{said}");
    assert!(said.contains("has ended (2001-"), "{said}");
    // A pair that fits is served as our own is.
    let bench = Bench::set(HURRIED, true, folder.clone(), |settings| {
        settings.tls = Some(files(a, a));
    });
    assert_eq!(bench.server.fingerprint(), Some(fingerprint(a).as_str()));
}

#[test]
fn what_others_can_reach_is_by_tls_or_for_a_proxy_that_was_named() {
    let open = Settings {
        listen: "0.0.0.0:0".parse().unwrap(),
        names: Vec::new(),
        tls: None,
        proxies: Vec::new(),
        limits: Default::default(),
        demo: true,
        folder: PathBuf::new(),
    };
    let said = common::refused(&open).to_string();
    assert!(said.contains("add --tls, or --proxy"), "{said}");
    // By TLS at all addresses; this computer reaches it by its own.
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = served(&folder, |settings| settings.listen = open.listen);
    let trusting = trusting(&folder.path().join("server/tls.pem"));
    let port = bench.address().port();
    let near = SocketAddr::from(([127, 0, 0, 1], port));
    let page = ask(&trusting, "127.0.0.1", near, &get(near, "/", "")).unwrap();
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(bench.server.link().starts_with("https://127.0.0.1:"));
    // Its address in the network, where it has one, is one of its names.
    if let Some(outside) = bench.server.outside() {
        let host = outside.trim_start_matches("https://").trim_end_matches('/');
        let at: SocketAddr = host.parse().unwrap();
        let page = ask(&trusting, &at.ip().to_string(), at, &get(host, "/", "")).unwrap();
        assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    }
    drop(bench);
    // For a proxy: this computer is heard, as it is here.
    let bench = Bench::set(HURRIED, true, folder, |settings| {
        settings.listen = open.listen;
        settings.proxies = vec!["10.0.0.2".parse().unwrap()];
    });
    let near = SocketAddr::from(([127, 0, 0, 1], bench.address().port()));
    let client = common::Client {
        address: near,
        cookie: None,
    };
    assert_eq!(client.get("/").status, 200);
    assert_eq!(bench.server.outside(), None);
}

/// The same certificate as if it had ended in 2001, the digits of its times replaced.
fn ended(path: &Path) -> String {
    use base64::Engine as _;
    let mut der = CertificateDer::from_pem_file(path).unwrap().to_vec();
    let times = (0..der.len() - 15).filter(|k| der[*k..k + 2] == [0x17, 13]);
    let times: Vec<usize> = times.collect();
    for (at, digits) in times.into_iter().zip(["000101000000Z", "010101000000Z"]) {
        der[at + 2..at + 15].copy_from_slice(digits.as_bytes());
    }
    let text = base64::engine::general_purpose::STANDARD.encode(der);
    format!("-----BEGIN CERTIFICATE-----\n{text}\n-----END CERTIFICATE-----\n")
}
