//! Callers: tenant, role, and the cohorts they may access.

use std::net::{IpAddr, Ipv6Addr};

use serde::{Deserialize, Serialize};

use super::cohort::name_problem;

/// Tenant of callers without a key, and of everything stored before there were tenants.
pub const DEFAULT_TENANT: &str = "default";

/// Stands for the key of callers without one.
const LOCAL: &str = "local";

/// Role of a caller; each role includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Reads, and computes without storing, also by jobs.
    Reader,
    /// Stores, learns and deletes.
    Writer,
    /// Manages keys and hooks, and reads the audit trail.
    Admin,
}

impl Role {
    /// Name used in JSON and the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Reader => "reader",
            Self::Writer => "writer",
            Self::Admin => "admin",
        }
    }

    /// Role with this name.
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Reader, Self::Writer, Self::Admin].into_iter().find(|role| role.as_str() == word)
    }
}

/// Whose requests are counted together.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Caller {
    /// Tenant.
    pub tenant: String,
    /// Key, or subject of a token: all tokens of the identity provider share one key.
    pub name: String,
}

/// An authenticated caller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Principal {
    /// Tenant whose objects the caller can access; no other tenant's are visible.
    pub tenant: String,
    /// Id of the key, `oidc` for a bearer token of the identity provider, `local` without access control, `system` for the
    /// service itself.
    pub key: String,
    /// Subject of the bearer token.
    pub subject: Option<String>,
    /// Role of the caller.
    pub role: Role,
    /// Ids of the only cohorts it may access; `None` for all of the tenant.
    pub cohorts: Option<Vec<String>>,
}

impl Principal {
    /// Caller on the loopback interface while no keys exist.
    pub fn local() -> Self {
        Self::admin(DEFAULT_TENANT, LOCAL)
    }

    /// Whether the caller is unauthenticated.
    pub fn is_local(&self) -> bool {
        self.key == LOCAL
    }

    /// The service itself, working for a tenant.
    pub fn system(tenant: &str) -> Self {
        Self::admin(tenant, "system")
    }

    fn admin(tenant: &str, key: &str) -> Self {
        Self { tenant: tenant.into(), key: key.into(), subject: None, role: Role::Admin, cohorts: None }
    }

    /// Tells callers apart without a name: the subject of a token may be that of a person.
    pub fn fingerprint(&self) -> String {
        let caller = [self.key.as_str(), self.subject.as_deref().unwrap_or_default()].join("\0");
        blake3::hash(caller.as_bytes()).to_hex()[..32].to_owned()
    }

    /// The caller as its requests are counted.
    pub fn caller(&self) -> Caller {
        let name = self.subject.as_ref().unwrap_or(&self.key);
        Caller { tenant: self.tenant.clone(), name: name.clone() }
    }

    /// Whether the caller may access the cohort with this id.
    pub fn may_use(&self, cohort: &str) -> bool {
        self.cohorts.as_ref().is_none_or(|cohorts| cohorts.iter().any(|open| open == cohort))
    }
}

/// Reason why `name` is not a valid tenant name, if any; the rules are those of cohort names.
pub fn tenant_problem(name: &str) -> Option<String> {
    name_problem(name, "tenant")
}

/// Whether `host`, without a port, names this machine: `localhost` and its subdomains, or a loopback address (IPv6 in
/// brackets).
pub fn is_loopback(host: &str) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(&host);
    host == "localhost"
        || host.ends_with(".localhost")
        || bare.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Network whose requests are counted together: for IPv6 the /64 network, since its owner controls all addresses in it.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
        address @ IpAddr::V4(_) => address,
    }
}

/// Text form of a [`network`].
pub fn network_text(network: IpAddr) -> String {
    if network.is_ipv6() { format!("{network}/64") } else { network.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_one_network_are_counted_together() {
        let network = |text: &str| network_text(network(text.parse().unwrap()));
        assert_eq!(network("2001:db8:0:1:aa::1"), "2001:db8:0:1::/64");
        assert_eq!(network("::ffff:10.1.2.3"), "10.1.2.3");
        assert_eq!(network("10.1.2.3"), "10.1.2.3");
    }

    #[test]
    fn fingerprints_tell_callers_apart() {
        let of = |key: &str, subject: Option<&str>| {
            Principal { subject: subject.map(str::to_owned), ..Principal::admin("a", key) }.fingerprint()
        };
        assert_eq!(of("oidc", Some("ann")), of("oidc", Some("ann")));
        assert_ne!(of("oidc", Some("ann")), of("oidc", Some("bob")));
        assert_ne!(of("key_1", None), of("key_2", None));
        assert!(!of("oidc", Some("ann")).contains("ann"));
    }

    #[test]
    fn roles_are_ordered_and_have_words() {
        assert!(Role::Reader < Role::Writer && Role::Writer < Role::Admin);
        for role in [Role::Reader, Role::Writer, Role::Admin] {
            assert_eq!(Role::from_word(role.as_str()), Some(role));
        }
        assert_eq!(Role::from_word("root"), None);
    }

    #[test]
    fn only_this_machine_is_loopback() {
        for host in ["localhost", "LOCALHOST.", "shapes.localhost", "127.0.0.1", "127.9.9.9", "[::1]", "::1"]
        {
            assert!(is_loopback(host), "{host}");
        }
        let others = [
            "",
            "evil.example",
            "localhost.evil.example",
            "notlocalhost",
            "127.0.0.1.evil.example",
            "10.0.0.1",
            "0.0.0.0",
        ];
        for host in others {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
