//! Certificates, addresses, and the check that all processes are of one build.

use std::error::Error;
use std::net::IpAddr;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use ballista_core::extension::EndpointOverrideFn;
use tonic::service::Interceptor;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity, Server, ServerTlsConfig, Uri};
use tonic::{Request, Status};

use crate::EngineError;

/// Maximum size of a message in bytes: a sum, or a plan.
pub const MAX_MESSAGE_BYTES: usize = 256 << 20;

/// Duration after which a connection that was not made is given up.
const CONNECT: Duration = Duration::from_secs(5);

/// Host and port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address {
    /// Name or address of the host.
    pub host: String,
    /// Port.
    pub port: u16,
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected host:port, got '{text}'");
        let (host, port) = text.rsplit_once(':').ok_or_else(expected)?;
        let port = port.parse().map_err(|_| expected())?;
        if host.is_empty() || host.contains('/') {
            return Err(expected());
        }
        Ok(Self { host: host.into(), port })
    }
}

impl Address {
    /// Whether only this machine reaches it.
    fn is_local(&self) -> bool {
        let address = self.host.trim_matches(['[', ']']).parse::<IpAddr>();
        self.host == "localhost" || address.is_ok_and(|address| address.is_loopback())
    }
}

/// How processes of a cluster speak to each other: with certificates on both sides, or on this machine alone.
#[derive(Clone)]
pub struct Network {
    certificates: Option<Certificates>,
}

#[derive(Clone)]
struct Certificates {
    own: Identity,
    authority: Certificate,
}

impl Network {
    /// Without certificates, for addresses of this machine.
    pub fn local() -> Self {
        Self { certificates: None }
    }

    /// With the certificate of this process, its private key, and the certificate of the authority that signed those of all
    /// processes: files in PEM.
    ///
    /// # Errors
    /// Files that cannot be read.
    pub fn with_certificates(certificate: &Path, key: &Path, authority: &Path) -> Result<Self, EngineError> {
        let read = |path: &Path| {
            let refused =
                |error: std::io::Error| EngineError::refused(path.display().to_string(), error.to_string());
            std::fs::read(path).map_err(refused)
        };
        let own = Identity::from_pem(read(certificate)?, read(key)?);
        let authority = Certificate::from_pem(read(authority)?);
        Ok(Self { certificates: Some(Certificates { own, authority }) })
    }

    /// Whether connections are encrypted.
    pub fn is_encrypted(&self) -> bool {
        self.certificates.is_some()
    }

    /// Refuses addresses of other machines without certificates: any client that reaches a scheduler can read every cohort.
    ///
    /// # Errors
    /// [`EngineError::Refused`], naming the option at fault.
    pub fn check(&self, option: &str, address: &Address) -> Result<(), EngineError> {
        if self.is_encrypted() || address.is_local() {
            return Ok(());
        }
        let detail =
            format!("expected certificates for an address of another machine, got '{}'", address.host);
        Err(EngineError::refused(option, detail))
    }

    /// The endpoint of a process at this address.
    ///
    /// # Errors
    /// An address that is none, certificates that are none.
    pub fn endpoint(&self, address: &Address) -> Result<Endpoint, EngineError> {
        let uri = format!("http://{}:{}", address.host, address.port);
        let refused = |error: &dyn Error| EngineError::refused(&*uri, text(error));
        let endpoint = Endpoint::from_shared(uri.clone()).map_err(|error| refused(&error))?;
        self.secure(endpoint).map_err(|error| refused(&*error))
    }

    /// Settings that Ballista applies to every endpoint before it connects.
    pub fn endpoints(&self) -> EndpointOverrideFn {
        let network = self.clone();
        Arc::new(move |endpoint| network.secure(endpoint))
    }

    fn secure(&self, endpoint: Endpoint) -> Result<Endpoint, Box<dyn Error + Send + Sync>> {
        let mut uri = endpoint.uri().clone().into_parts();
        let scheme = if self.is_encrypted() { "https" } else { "http" };
        uri.scheme = Some(scheme.parse()?);
        let host = endpoint.uri().host().unwrap_or_default().trim_matches(['[', ']']).to_string();
        let endpoint = Endpoint::from(Uri::from_parts(uri)?)
            .user_agent(BUILD)?
            .connect_timeout(CONNECT)
            .tcp_nodelay(true)
            .http2_keep_alive_interval(CONNECT)
            .keep_alive_timeout(CONNECT)
            .keep_alive_while_idle(true);
        let Some(Certificates { own, authority }) = &self.certificates else { return Ok(endpoint) };
        let tls =
            ClientTlsConfig::new().domain_name(host).ca_certificate(authority.clone()).identity(own.clone());
        Ok(endpoint.tls_config(tls)?)
    }

    /// A server that demands a certificate of its clients.
    ///
    /// # Errors
    /// Certificates that are none.
    pub fn server(&self) -> Result<Server, EngineError> {
        let server = Server::builder().tcp_nodelay(true).http2_keepalive_interval(Some(CONNECT));
        let Some(Certificates { own, authority }) = &self.certificates else { return Ok(server) };
        let tls = ServerTlsConfig::new().identity(own.clone()).client_ca_root(authority.clone());
        server.tls_config(tls).map_err(|error| EngineError::refused("certificates", text(&error)))
    }
}

/// An error and its causes.
pub(super) fn text(error: &dyn Error) -> String {
    let mut texts = vec![error.to_string()];
    let mut cause = error.source();
    while let Some(error) = cause {
        texts.push(error.to_string());
        cause = error.source();
    }
    texts.dedup();
    texts.join(": ")
}

/// Name of this build: version, and digest of sources, compiler and optimisation. Sums have the same bits only by the same build.
pub const BUILD: &str =
    concat!("shapelex-engine/", env!("CARGO_PKG_VERSION"), "-", env!("SHAPELEX_ENGINE_BUILD"));

/// Refuses requests of processes of another build.
#[derive(Debug, Clone, Copy)]
pub struct SameBuild;

impl Interceptor for SameBuild {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        let agent = request.metadata().get("user-agent").and_then(|agent| agent.to_str().ok());
        let found = agent.unwrap_or_default().split(' ').next().unwrap_or_default();
        if found == BUILD {
            return Ok(request);
        }
        Err(Status::failed_precondition(format!("expected a process of build {}, got '{found}'", BUILD)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_have_a_host_and_a_port() {
        let address = |text: &str| text.parse::<Address>();
        assert_eq!(address("a.b:50"), Ok(Address { host: "a.b".into(), port: 50 }));
        assert_eq!(address("[::1]:50").unwrap().host, "[::1]");
        for wrong in ["", "a", "a:", ":5", "a:70000", "http://a:5"] {
            assert_eq!(address(wrong), Err(format!("expected host:port, got '{wrong}'")));
        }
    }

    #[test]
    fn other_machines_need_certificates() {
        let check = |host: &str| {
            Network::local()
                .check("--listen", &Address { host: host.into(), port: 1 })
                .map_err(|error| error.to_string())
        };
        for local in ["localhost", "127.0.0.1", "127.1.2.3", "[::1]"] {
            assert_eq!(check(local), Ok(()), "{local}");
        }
        let expected = "--listen: expected certificates for an address of another machine, got '10.0.0.1'";
        assert_eq!(check("10.0.0.1").unwrap_err(), expected);
        assert!(check("localhost.example").is_err());
    }

    #[test]
    fn other_builds_are_refused() {
        let request = |agent: &str| {
            let mut request = Request::new(());
            request.metadata_mut().insert("user-agent", agent.parse().unwrap());
            SameBuild.call(request).map(drop).map_err(|status| status.message().to_string())
        };
        assert_eq!(request(&format!("{} tonic/0.14.9", BUILD)), Ok(()));
        let refused = request("shapelex-engine/0.0.9-ab tonic/0.14.9").unwrap_err();
        assert!(refused.ends_with("got 'shapelex-engine/0.0.9-ab'"), "{refused}");
        assert!(SameBuild.call(Request::new(())).is_err());
    }
}
