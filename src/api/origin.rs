//! Cross-site requests, made by pages of other sites in a browser.
//!
//! As long as no keys exist, being on the machine is a caller's only credential, and every page in a browser on it has that
//! too. Browsers declare the origin of a request (`Origin`, `Sec-Fetch-Site`); other programs do not. With keys the check is
//! unnecessary: a browser does not add `Authorization` by itself, and a cross-site page that adds it triggers a preflight,
//! which the service answers only for the origins that its operator allows.

use axum::http::header::{HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Uri};

/// Header in which browsers describe the relation between the requesting page and the target.
const FETCH_SITE: &str = "sec-fetch-site";
/// Same origin, or started by the user. `same-site` includes other ports of this machine, hence other programs.
const OWN: [&str; 2] = ["same-origin", "none"];

/// Name of the header that shows a request to be cross-site, or `None`.
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

/// Origin of the page that makes the request, if it names exactly one.
pub fn only(headers: &HeaderMap) -> Option<&str> {
    let mut values = headers.get_all(ORIGIN).iter();
    let value = values.next().filter(|_| values.next().is_none())?;
    value.to_str().ok()
}

/// Authority that the request addresses.
fn own_authority(uri: &Uri, headers: &HeaderMap) -> Option<Authority> {
    let named = || headers.get(HOST)?.to_str().ok()?.parse().ok();
    uri.authority().cloned().or_else(named)
}

/// Whether `origin` is this service. A proxy may terminate TLS, so an HTTPS page with the same authority counts too.
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
        // HTTP/2 has the authority in the URI.
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
