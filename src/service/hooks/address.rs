//! Addresses to which the service may deliver. A hook must not reach addresses that only the service can reach: services of the same
//! machine or network, or the metadata of a cloud. The operator may open single networks.
//!
//! A name is checked where it is resolved for a connection ([`Reachable`]): the connection uses the addresses that were
//! checked, so that a name which resolves differently a moment later changes nothing.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;

use reqwest::Url;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};

/// Maximum length of an address.
const MAX_LENGTH: usize = 2048;

/// Addresses that begin with the same bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network {
    address: IpAddr,
    bits: u32,
}

impl Network {
    /// Networks separated by commas, such as `10.1.0.0/16, fd12::/16`; an address alone is a network of one.
    ///
    /// # Errors
    /// The part that is none.
    pub fn list(text: &str) -> Result<Arc<[Self]>, String> {
        text.split(',').map(str::trim).filter(|part| !part.is_empty()).map(Self::of).collect()
    }

    fn of(text: &str) -> Result<Self, String> {
        let (address, bits) =
            text.split_once('/').map_or((text, None), |(address, bits)| (address, Some(bits)));
        let refused = || format!("expected networks such as 10.1.0.0/16 or fd12::/16, got '{text}'");
        let address: IpAddr = address.parse().map_err(|_| refused())?;
        let most = if address.is_ipv4() { 32 } else { 128 };
        let bits = bits.map_or(Ok(most), |bits| bits.parse().map_err(|_| refused()))?;
        if bits > most { Err(refused()) } else { Ok(Self { address, bits }) }
    }

    fn has(self, address: IpAddr) -> bool {
        // A shift by all bits leaves nothing to compare.
        match (self.address, address.to_canonical()) {
            (IpAddr::V4(own), IpAddr::V4(other)) => {
                (own.to_bits() ^ other.to_bits()).checked_shr(32 - self.bits).unwrap_or(0) == 0
            }
            (IpAddr::V6(own), IpAddr::V6(other)) => {
                (own.to_bits() ^ other.to_bits()).checked_shr(128 - self.bits).unwrap_or(0) == 0
            }
            _ => false,
        }
    }
}

/// Whether the address is public, or in one of these networks.
fn is_open(address: IpAddr, networks: &[Network]) -> bool {
    is_public(address) || networks.iter().any(|network| network.has(address))
}

/// Address of a host that is given as a number; `None` for a name.
fn host_address(url: &Url) -> Option<IpAddr> {
    url.host_str()?.trim_matches(['[', ']']).parse().ok()
}

/// Parses the address of a hook. With `allow_private`, plain HTTP and addresses that are not public are accepted; with networks,
/// their addresses, and local names, which are checked when they are resolved.
///
/// # Errors
/// The expected and the actual form, without repeating the address, which may hold a secret.
pub(super) fn checked(text: &str, allow_private: bool, networks: &[Network]) -> Result<Url, String> {
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
    let is_local = host_address(&url)
        .map_or_else(|| is_local_name(host) && networks.is_empty(), |address| !is_open(address, networks));
    if is_local && !allow_private {
        return Err(
            "expected a public host, got a private, loopback or reserved address (see --hook-networks)"
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

/// Resolves names for connections; a name with an address that is neither public nor in one of the networks is refused.
#[derive(Debug, Clone)]
pub(super) struct Reachable(pub(super) Arc<[Network]>);

impl Resolve for Reachable {
    fn resolve(&self, name: Name) -> Resolving {
        let networks = Arc::clone(&self.0);
        Box::pin(async move {
            // The port is set by the client.
            let found: Vec<SocketAddr> = tokio::net::lookup_host((name.as_str(), 0)).await?.collect();
            if found.iter().any(|address| !is_open(address.ip(), &networks)) {
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
    fn networks_open_their_addresses_only() {
        let networks = Network::list("10.1.0.0/16, fd12::/16,192.168.7.7").unwrap();
        for (url, wanted) in [
            ("https://10.1.2.3/", true),
            ("https://10.2.0.1/", false),
            ("https://[fd12:9::1]/", true),
            ("https://[fd13::1]/", false),
            ("https://[::ffff:10.1.0.1]/", true),
            ("https://192.168.7.7/", true),
            ("https://192.168.7.8/", false),
            ("https://169.254.169.254/", false),
            ("https://receiver.internal/", true),
            ("https://8.8.8.8/", true),
            ("http://10.1.2.3/", false),
        ] {
            assert_eq!(super::checked(url, false, &networks).is_ok(), wanted, "{url}");
        }
        assert!(Network::list("0.0.0.0/0").unwrap()[0].has("10.0.0.1".parse().unwrap()));
        assert_eq!(Network::list("").unwrap().len(), 0);
        for wrong in ["10.0.0.0/33", "fd12::/129", "clinic", "10.0.0.0/", "10.0/8", "10.0.0.0/-1"] {
            assert!(Network::list(wrong).unwrap_err().ends_with(&format!("got '{wrong}'")), "{wrong}");
        }
    }

    fn checked(text: &str, allow_private: bool) -> Result<Url, String> {
        super::checked(text, allow_private, &[])
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
        let resolved = async |networks: &str| {
            Reachable(Network::list(networks).unwrap()).resolve("localhost".parse().unwrap()).await
        };
        assert!(resolved("").await.err().unwrap().is::<NotPublic>());
        assert!(resolved("10.0.0.0/8").await.err().unwrap().is::<NotPublic>());
        assert!(resolved("127.0.0.0/8, ::1").await.is_ok());
        let client =
            reqwest::Client::builder().no_proxy().dns_resolver(Reachable(Arc::default())).build().unwrap();
        let error = client.get("http://localhost:9/").send().await.unwrap_err();
        assert!(was_not_public(&error), "{error:?}");
    }
}
