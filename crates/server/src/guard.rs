//! Who is let in: by the address that was asked for, the page that asks, the form of what is sent, and who it is.

use crate::app::App;
use crate::error::ApiError;
use crate::names::Names;
use crate::need::Need;
use crate::peer::{FORWARDED, Peer, Whence};
use crate::people::Caller;
use axum::body::Body;
use axum::extract::{Extension, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Instant;

/// The cookie of a browser that is logged in.
pub(crate) const COOKIE: &str = "scopeservo";

/// What of everything that is answered holds.
const HEADERS: [(&str, &str); 6] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; font-src 'self'; \
         frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
];

/// Whether whoever asks sits at this computer. What came through a proxy comes from this computer, too: it is known by the name that was asked
/// for, by the page that asks, and by what proxies add. When in doubt it comes from elsewhere.
fn is_here(names: &Names, peer: &Peer, headers: &HeaderMap) -> bool {
    let host = text(headers, header::HOST).unwrap_or_default();
    let origin = text(headers, header::ORIGIN);
    let is_own = |origin| {
        let host = names.host_of(origin);
        host.is_some_and(|host| names.is_own(host, peer.at))
    };
    peer.is_of_this_computer()
        && names.is_own(host, peer.at)
        && origin.is_none_or(is_own)
        && !FORWARDED.iter().any(|name| headers.contains_key(*name))
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// The first gate: what is refused here has reached nothing.
pub(crate) async fn guard(
    State(app): State<Arc<App>>,
    Extension(peer): Extension<Peer>,
    mut request: Request,
    next: Next,
) -> Response {
    let refused = is_ours(&app.names, &peer, &request).err();
    let mut response = match refused {
        Some(refused) => refused.into_response(),
        None => {
            let here = is_here(&app.names, &peer, request.headers());
            let whence = peer.place(request.headers(), here);
            let caller = known(&app, request.headers(), here);
            let whose = caller.as_ref().map_or(&whence, |caller| &caller.key);
            match within_limits(&app, whose, request.uri().path()) {
                Err(refused) => refused.into_response(),
                Ok(()) => {
                    request.extensions_mut().insert(Whence(whence));
                    if let Some(caller) = caller {
                        let near = here || app.elsewhere_for().is_some();
                        let caller = Caller { near, ..caller };
                        request.extensions_mut().insert(caller);
                    }
                    next.run(request).await
                }
            }
        }
    };
    for (name, value) in HEADERS {
        let headers = response.headers_mut();
        if !headers.contains_key(name) {
            headers.insert(
                HeaderName::from_static(name),
                HeaderValue::from_static(value),
            );
        }
    }
    response
}

/// Whether so much may be asked. A stop always may, and the word that whoever drives is there still.
fn within_limits(app: &App, whose: &str, path: &str) -> Result<(), ApiError> {
    if path.ends_with("/stop") || path == "/api/v1/lease" {
        return Ok(());
    }
    let taken = crate::lock(&app.rates).take(whose, Instant::now());
    taken.map_err(|wait| {
        let s = wait.as_secs_f64().ceil();
        let message = format!(
            "too many requests in so short a time: wait {s:.0} s, and ask for less at once"
        );
        ApiError::too_many(message, wait)
    })
}

/// Whether it comes from a page of ours, or from a program, in a form that no other page can send.
fn is_ours(names: &Names, peer: &Peer, request: &Request<Body>) -> Result<(), ApiError> {
    let headers = request.headers();
    // HTTP/1.1 has it in the header, a proxy of another kind in the address.
    let host =
        text(headers, header::HOST).or_else(|| request.uri().authority().map(|a| a.as_str()));
    if !host.is_some_and(|host| names.has(host, peer.at)) {
        let message = format!(
            "this server does not go by the name '{}': use the address that it told, or name it with --name",
            host.unwrap_or_default()
        );
        return Err(ApiError::new(StatusCode::FORBIDDEN, "wrong_host", message));
    }
    if let Some(origin) = headers.get(header::ORIGIN) {
        let origin = origin.to_str().unwrap_or_default();
        let host = names.host_of(origin);
        if !host.is_some_and(|host| names.has(host, peer.at)) {
            let message = format!("a page of '{origin}' may ask nothing here");
            return Err(ApiError::forbidden("wrong_origin", message));
        }
    }
    let site = text(headers, HeaderName::from_static("sec-fetch-site"));
    let changes = !matches!(*request.method(), Method::GET | Method::HEAD);
    if changes && site.is_some_and(|site| !matches!(site, "same-origin" | "none")) {
        let message = "a page of another site may ask nothing here";
        return Err(ApiError::forbidden("wrong_origin", message));
    }
    let kind = text(headers, header::CONTENT_TYPE).unwrap_or_default();
    let is_json = kind
        .split(';')
        .next()
        .is_some_and(|k| k.trim().eq_ignore_ascii_case("application/json"));
    // Other methods no page of another site can send unasked.
    let is_sent = matches!(*request.method(), Method::POST | Method::PATCH);
    if is_sent && !is_json {
        let message = "what is sent must be JSON, and say so: content-type: application/json";
        let status = StatusCode::UNSUPPORTED_MEDIA_TYPE;
        return Err(ApiError::new(status, "not_json", message));
    }
    Ok(())
}

/// Who asks, by token or cookie.
fn known(app: &App, headers: &HeaderMap, here: bool) -> Option<Caller> {
    if let Some(bearer) = text(headers, header::AUTHORIZATION) {
        return app
            .people
            .of_token(bearer.strip_prefix("Bearer ")?.trim(), here);
    }
    app.people.of_session(cookie(headers)?, here)
}

/// The secret of the session.
fn cookie(headers: &HeaderMap) -> Option<&str> {
    let all = text(headers, header::COOKIE)?.split(';');
    let mut pairs = all.filter_map(|pair| pair.trim().split_once('='));
    pairs
        .find(|(name, _)| *name == COOKIE)
        .map(|(_, secret)| secret)
}

/// The header that makes a browser remember a session, or forget it.
pub(crate) fn set_cookie(
    session: Option<&str>,
    peer: &Peer,
    headers: &HeaderMap,
) -> [(HeaderName, String); 1] {
    let (session, age) = match session {
        Some(session) => (session, ""),
        None => ("", "; Max-Age=0"),
    };
    // What came by TLS, of ours or of a proxy, goes by no other way.
    let origin = text(headers, header::ORIGIN).unwrap_or_default();
    let secure = match peer.by_tls || origin.starts_with("https://") {
        true => "; Secure",
        false => "",
    };
    let cookie = format!("{COOKIE}={session}; Path=/; HttpOnly; SameSite=Strict{secure}{age}");
    [(header::SET_COOKIE, cookie)]
}

/// The second gate, before each route.
pub(crate) async fn require(need: Need, request: Request, next: Next) -> Response {
    match need.met_by(request.extensions().get::<Caller>()) {
        Ok(()) => next.run(request).await,
        Err(refused) => refused.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_through_a_proxy_is_not_here() {
        let names = Names::of(&[7070], &["scope-3.lab:443".into()], false);
        let headers = |all: &[(&'static str, &str)]| {
            let all = all.iter();
            let all = all.map(|(n, v)| (HeaderName::from_static(n), v.parse().unwrap()));
            all.collect::<HeaderMap>()
        };
        let peer = |from: &str, at: &str| {
            let from = format!("{from}:50000").parse().unwrap();
            Peer::new(from, at.parse().unwrap(), false, &[])
        };
        let local = peer("127.0.0.1", "127.0.0.1:7070");
        let own = ("host", "127.0.0.1:7070");
        assert!(is_here(&names, &local, &headers(&[own])));
        assert!(is_here(
            &names,
            &local,
            &headers(&[own, ("origin", "http://localhost:7070")])
        ));
        for through in [
            vec![("host", "scope-3.lab:443")],
            vec![own, ("origin", "https://scope-3.lab:443")],
            vec![own, ("x-forwarded-for", "10.0.0.7")],
            vec![own, ("forwarded", "for=10.0.0.7")],
            vec![],
        ] {
            assert!(!is_here(&names, &local, &headers(&through)), "{through:?}");
        }
        assert!(!is_here(
            &names,
            &peer("10.0.0.7", "10.0.0.5:7070"),
            &headers(&[own])
        ));
        // By its own address in the network, this computer is still this one.
        let outward = peer("10.0.0.5", "10.0.0.5:7070");
        let host = ("host", "10.0.0.5:7070");
        assert!(is_here(&names, &outward, &headers(&[host])));
        let far = peer("10.0.0.7", "10.0.0.5:7070");
        assert!(!is_here(&names, &far, &headers(&[host])));
    }
}
