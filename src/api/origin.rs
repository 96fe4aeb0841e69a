//! Requests that a page of another site has made.
//!
//! As long as nobody is asked for a key, being on the machine is all that a caller shows, and every page in a browser on it
//! shows that too. Browsers say which page asks (`Origin`, `Sec-Fetch-Site`); programs say nothing. With keys this is not needed:
//! a browser adds no `Authorization` by itself, and a page of another site that does is asked beforehand, which is not answered.

use axum::http::header::{HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Uri};

/// The header in which browsers say how the page that asks is related to what it asks.
const FETCH_SITE: &str = "sec-fetch-site";
/// Of the same origin, or by the hand of the user. `same-site` is another port of this machine: another program.
const OWN: [&str; 2] = ["same-origin", "none"];

/// What is foreign about a request, with the name of the header that says it.
pub fn foreign(uri: &Uri, headers: &HeaderMap) -> Option<&'static str> {
    let is_own_site = |value: &str| OWN.contains(&value);
    if !headers.get_all(FETCH_SITE).iter().all(|value| value.to_str().is_ok_and(is_own_site)) {
        return Some("Sec-Fetch-Site");
    }
    let own = own_authority(uri, headers);
    let is_own = |value: &str| own.as_ref().is_some_and(|own| is_origin_of(value, own));
    let all_own = headers.get_all(ORIGIN).iter().all(|value| value.to_str().is_ok_and(is_own));
    (!all_own).then_some("Origin")
}

/// What the request calls this service.
fn own_authority(uri: &Uri, headers: &HeaderMap) -> Option<Authority> {
    let named = || headers.get(HOST)?.to_str().ok()?.parse().ok();
    uri.authority().cloned().or_else(named)
}

/// Whether a page with this origin was loaded from here. What ends TLS in between is not known here: a page that was loaded by
/// HTTPS is its own page too.
fn is_origin_of(origin: &str, own: &Authority) -> bool {
    let Some((scheme, rest)) = origin.split_once("://") else { return false };
    let usual_port = match scheme {
        "http" => 80,
        "https" => 443,
        _ => return false,
    };
    let Ok(theirs) = rest.parse::<Authority>() else { return false };
    let port = |authority: &Authority| authority.port_u16().unwrap_or(usual_port);
    theirs.host().eq_ignore_ascii_case(own.host()) && port(&theirs) == port(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn foreign_by(headers: &[(&str, &str)]) -> Option<&'static str> {
        let mut map = HeaderMap::new();
        for (name, value) in [("host", "localhost:8080")].iter().chain(headers) {
            map.append(axum::http::HeaderName::from_bytes(name.as_bytes()).unwrap(), value.parse().unwrap());
        }
        foreign(&Uri::from_static("/v1/cohorts"), &map)
    }

    #[test]
    fn programs_and_the_own_page_are_not_foreign() {
        for headers in [
            &[][..],
            &[("sec-fetch-site", "same-origin")],
            &[("sec-fetch-site", "none")],
            &[("origin", "http://localhost:8080")],
            &[("origin", "https://LOCALHOST:8080"), ("sec-fetch-site", "same-origin")],
        ] {
            assert_eq!(foreign_by(headers), None, "{headers:?}");
        }
        let mut usual = HeaderMap::new();
        usual.append(HOST, "localhost".parse().unwrap());
        usual.append(ORIGIN, "http://localhost:80".parse().unwrap());
        assert_eq!(foreign(&Uri::from_static("/v1/x"), &usual), None);
        // HTTP/2 names the service in the address.
        usual.remove(HOST);
        assert_eq!(foreign(&Uri::from_static("http://localhost/v1/x"), &usual), None);
        assert_eq!(foreign(&Uri::from_static("/v1/x"), &usual), Some("Origin"));
    }

    #[test]
    fn other_sites_and_other_ports_are_foreign() {
        for site in ["cross-site", "same-site", "", "Same-Origin, none", "x"] {
            assert_eq!(foreign_by(&[("sec-fetch-site", site)]), Some("Sec-Fetch-Site"), "{site}");
        }
        let others = [
            "http://evil.example",
            "http://evil.example:8080",
            "http://localhost:3000",
            "http://localhost",
            "http://127.0.0.1:8080",
            "http://localhost:8080.evil.example",
            "http://localhost:8080@evil.example",
            "file://localhost:8080",
            "null",
            "",
        ];
        for origin in others {
            assert_eq!(foreign_by(&[("origin", origin)]), Some("Origin"), "{origin}");
        }
        assert_eq!(foreign_by(&[("origin", "http://localhost:8080"), ("origin", "null")]), Some("Origin"));
    }
}
