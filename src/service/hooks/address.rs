//! Addresses to which the service may deliver. A hook must not reach what only the service can reach: services of the same
//! machine or network, or the metadata of a cloud.
//!
//! A name is checked where it is resolved for a connection ([`PublicOnly`]): the connection uses the addresses that were
//! checked, so that a name which resolves differently a moment later changes nothing.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use reqwest::Url;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};

/// Maximum length of an address.
const MAX_LENGTH: usize = 2048;

/// Address of a host that is given as a number; `None` for a name.
fn host_address(url: &Url) -> Option<IpAddr> {
    url.host_str()?.trim_matches(['[', ']']).parse().ok()
}

/// Parses the address of a hook. With `allow_private`, plain HTTP and addresses that are not public are accepted.
///
/// # Errors
/// What was expected and what was found, without repeating the address, which may hold a secret.
pub(super) fn checked(text: &str, allow_private: bool) -> Result<Url, String> {
    if text.len() > MAX_LENGTH {
        return Err(format!("expected at most {MAX_LENGTH} bytes, got {}", text.len()));
    }
    let url = Url::parse(text)
        .map_err(|_| "expected a URL such as https://pipeline.example/shapes, got another text".to_owned())?;
    match url.scheme() {
        "https" => {}
        "http" if allow_private => {}
        found => return Err(format!("expected a URL that begins with https://, got {found}://")),
    }
    if !url.username().is_empty() || url.password().is_some() || url.fragment().is_some() {
        return Err("expected a URL without user, password and fragment, got one with them".into());
    }
    let host = url.host_str().unwrap_or_default();
    if host.is_empty() {
        return Err("expected a URL with a host, got one without".into());
    }
    let is_local = host_address(&url).map_or_else(|| is_local_name(host), |address| !is_public(address));
    if is_local && !allow_private {
        return Err(
            "expected a public host, got a private, loopback or reserved address (see --allow-private-hooks)"
                .into(),
        );
    }
    Ok(url)
}

/// Whether a name belongs to this machine or its network by convention.
fn is_local_name(host: &str) -> bool {
    let host = host.trim_end_matches('.').to_ascii_lowercase();
    let endings = [".localhost", ".local", ".internal", ".home.arpa"];
    host == "localhost" || endings.iter().any(|ending| host.ends_with(ending))
}

/// Whether the address is reachable over the internet: none of the ranges with a special purpose (IANA registries).
pub(super) fn is_public(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(address) => is_public_v4(address),
        IpAddr::V6(address) => is_public_v6(address),
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let is_special = match (a, b, c) {
        // This network, private use, loopback, link-local (also the metadata of clouds).
        (0 | 10 | 127, ..) | (172, 16..=31, _) | (192, 168, _) | (169, 254, _) => true,
        // Shared by carriers, protocol assignments, relays, benchmarks, documentation.
        (100, 64..=127, _)
        | (192, 0, 0 | 2)
        | (192, 88, 99)
        | (198, 18 | 19, _)
        | (198, 51, 100)
        | (203, 0, 113) => true,
        // Multicast, reserved, broadcast.
        (224.., ..) => true,
        _ => false,
    };
    !is_special
}

fn is_public_v6(address: Ipv6Addr) -> bool {
    let segments = address.segments();
    // Global unicast is 2000::/3; everything else is local, mapped, translated or reserved.
    let is_unicast = segments[0] & 0xe000 == 0x2000;
    let is_special = match (segments[0], segments[1]) {
        // Protocol assignments with Teredo, documentation, addresses that contain IPv4 ones.
        (0x2001, 0..=0x01ff | 0x0db8) | (0x2002, _) | (0x3fff, 0..=0x0fff) => true,
        _ => false,
    };
    is_unicast && !is_special
}

/// The name of a host resolves to an address that may not be delivered to.
#[derive(Debug)]
pub(super) struct NotPublic;

impl fmt::Display for NotPublic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the host has a private, loopback or reserved address")
    }
}

impl std::error::Error for NotPublic {}

/// Resolves names for connections; a name with an address that is not public is refused.
#[derive(Debug, Clone, Copy)]
pub(super) struct PublicOnly;

impl Resolve for PublicOnly {
    fn resolve(&self, name: Name) -> Resolving {
        Box::pin(async move {
            // The port is set by the client.
            let found: Vec<SocketAddr> = tokio::net::lookup_host((name.as_str(), 0)).await?.collect();
            if found.iter().any(|address| !is_public(address.ip())) {
                return Err(NotPublic.into());
            }
            Ok(Box::new(found.into_iter()) as Addrs)
        })
    }
}

/// Whether the failure of a request was [`NotPublic`].
pub(super) fn was_not_public(error: &reqwest::Error) -> bool {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(found) = cause {
        if found.is::<NotPublic>() {
            return true;
        }
        cause = found.source();
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_public_addresses_are_public() {
        for text in [
            "8.8.8.8",
            "1.1.1.1",
            "172.32.0.1",
            "192.0.1.1",
            "2606:4700::1111",
            "2a00:1450::1",
            "::ffff:8.8.8.8",
        ] {
            assert!(is_public(text.parse().unwrap()), "{text}");
        }
        for text in [
            "0.0.0.0",
            "10.0.0.1",
            "100.64.0.1",
            "127.0.0.1",
            "127.255.255.254",
            "169.254.169.254",
            "172.16.0.1",
            "172.31.255.255",
            "192.0.0.1",
            "192.0.2.1",
            "192.88.99.1",
            "192.168.1.1",
            "198.18.0.1",
            "198.51.100.7",
            "203.0.113.9",
            "224.0.0.1",
            "240.0.0.1",
            "255.255.255.255",
            "::",
            "::1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "::127.0.0.1",
            "64:ff9b::7f00:1",
            "64:ff9b:1::1",
            "100::1",
            "2001::1",
            "2001:db8::1",
            "2002:7f00:1::",
            "3fff::1",
            "fc00::1",
            "fd12::1",
            "fe80::1",
            "fec0::1",
            "ff02::1",
        ] {
            assert!(!is_public(text.parse().unwrap()), "{text}");
        }
    }

    #[test]
    fn addresses_of_hooks_are_checked_when_they_are_given() {
        assert!(checked("https://hooks.example/in?token=1", false).is_ok());
        // Other spellings of numbers become numbers.
        for local in [
            "https://127.0.0.1/",
            "https://2130706433/",
            "https://0x7f.1/",
            "https://0177.0.0.1/",
            "https://[::1]/",
            "https://[::ffff:10.0.0.1]/",
            "https://localhost/",
            "https://a.localhost./",
            "https://db.internal/",
            "https://169.254.169.254/latest/meta-data/",
            "https://１２７.0.0.1/",
        ] {
            let refused = checked(local, false).unwrap_err();
            assert!(refused.starts_with("expected a public host"), "{local}: {refused}");
            assert!(checked(local, true).is_ok(), "{local}");
        }
        for wrong in [
            "http://hooks.example/",
            "ftp://hooks.example/",
            "file:///etc/passwd",
            "hooks.example",
            "",
            "https://",
            "https://user:secret@hooks.example/",
            "https://hooks.example/#top",
            "gopher://hooks.example/",
        ] {
            let refused = checked(wrong, false).unwrap_err();
            assert!(refused.starts_with("expected ") && !refused.contains("secret"), "{wrong}: {refused}");
        }
        assert!(checked("http://127.0.0.1:9/", true).is_ok());
        assert!(checked("ftp://127.0.0.1:9/", true).is_err());
    }

    #[tokio::test]
    async fn a_name_of_this_machine_is_not_resolved() {
        let resolved = PublicOnly.resolve("localhost".parse().unwrap()).await;
        assert!(resolved.err().unwrap().is::<NotPublic>());
        let client = reqwest::Client::builder().no_proxy().dns_resolver(PublicOnly).build().unwrap();
        let error = client.get("http://localhost:9/").send().await.unwrap_err();
        assert!(was_not_public(&error), "{error:?}");
    }
}
