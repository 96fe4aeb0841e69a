//! Who asks: a tenant, a role, and the cohorts that are open to them.

use std::net::{IpAddr, Ipv6Addr};

use serde::{Deserialize, Serialize};

use super::cohort::name_problem;

/// The tenant of those who ask without a key, and of everything that was stored before there were tenants.
pub const DEFAULT_TENANT: &str = "default";

/// What stands for the key of those who ask without one.
const LOCAL: &str = "local";

/// What a caller may do; each role may do what those before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Reads, and computes what is not stored.
    Reader,
    /// Stores, learns, deletes.
    Writer,
    /// Gives keys and reads the audit trail.
    Admin,
}

impl Role {
    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Reader => "reader",
            Self::Writer => "writer",
            Self::Admin => "admin",
        }
    }

    /// The role with this word.
    pub fn of_word(word: &str) -> Option<Self> {
        [Self::Reader, Self::Writer, Self::Admin].into_iter().find(|role| role.as_str() == word)
    }
}

/// An authenticated caller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Principal {
    /// Whose things it sees; nobody sees those of another tenant.
    pub tenant: String,
    /// Id of its key, `oidc` for a bearer token of the identity provider, `local` without access control, `system` for the
    /// service itself.
    pub key: String,
    /// Who stands behind a bearer token.
    pub subject: Option<String>,
    /// What it may do.
    pub role: Role,
    /// Ids of the only cohorts it may touch; all of the tenant when none.
    pub cohorts: Option<Vec<String>>,
}

impl Principal {
    /// Who asks on a machine's own address as long as there are no keys.
    pub fn local() -> Self {
        Self::admin(DEFAULT_TENANT, LOCAL)
    }

    /// Whether nobody has shown who it is.
    pub fn is_local(&self) -> bool {
        self.key == LOCAL
    }

    /// The service itself, at work for a tenant.
    pub fn system(tenant: &str) -> Self {
        Self::admin(tenant, "system")
    }

    fn admin(tenant: &str, key: &str) -> Self {
        Self { tenant: tenant.into(), key: key.into(), subject: None, role: Role::Admin, cohorts: None }
    }

    /// Whether the cohort with this id is open to it.
    pub fn may_use(&self, cohort: &str) -> bool {
        self.cohorts.as_ref().is_none_or(|cohorts| cohorts.iter().any(|open| open == cohort))
    }
}

/// Why `name` cannot name a tenant, or nothing: a name as those of cohorts.
pub fn tenant_problem(name: &str) -> Option<String> {
    name_problem(name, "tenant")
}

/// Whether `host`, without a port, names this machine: `localhost` and what lies below it, or a loopback address, an IPv6
/// one in brackets.
pub fn is_loopback(host: &str) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(&host);
    host == "localhost"
        || host.ends_with(".localhost")
        || bare.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Whose addresses are counted together: of IPv6 the network of 64 bits, as whoever has one address of it has all of them.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
        address @ IpAddr::V4(_) => address,
    }
}

/// A network of [`network`] for people.
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
    fn roles_are_ordered_and_have_words() {
        assert!(Role::Reader < Role::Writer && Role::Writer < Role::Admin);
        for role in [Role::Reader, Role::Writer, Role::Admin] {
            assert_eq!(Role::of_word(role.as_str()), Some(role));
        }
        assert_eq!(Role::of_word("root"), None);
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
