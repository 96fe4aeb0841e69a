//! Where shapes go to and come from: a service, or a store beside it.

use std::sync::Arc;

use clap::Args;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue};
use reqwest::{Client, RequestBuilder, Response, Url};

use crate::cli::at::At;
use crate::domain::access::{DEFAULT_TENANT, Principal, tenant_problem};
use crate::service::app::{App, Limits};
use crate::store_location::{self, StoreLocation};

/// Number of database connections of a command.
const CONNECTIONS: u32 = 4;
/// Time to connect to a service.
const CONNECT: std::time::Duration = std::time::Duration::from_secs(10);

/// A cohort of a service, or of a store.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct TargetArgs {
    /// Address of a service, such as http://127.0.0.1:8080. Default: the store itself, even while the service runs
    #[arg(long, env = "SHAPELEX_SERVER", value_name = "URL")]
    server: Option<String>,
    /// Key for the service
    #[arg(long, env = "SHAPELEX_KEY", hide_env_values = true, value_name = "KEY")]
    key: Option<String>,
    /// Tenant of the cohort, in a store
    #[arg(long, default_value = DEFAULT_TENANT)]
    tenant: String,
}

/// A service or a store.
pub(super) enum Target {
    Service(Box<Service>),
    Store(Box<App>),
}

/// A service that is asked over HTTP.
pub(super) struct Service {
    client: Client,
    address: Url,
    key: Option<HeaderValue>,
}

impl TargetArgs {
    /// Refuses a service where no cohort is named.
    ///
    /// # Errors
    /// A service, which has no whole stores.
    pub(super) fn check_without_cohort(&self) -> Result<(), String> {
        match self.server {
            None => Ok(()),
            Some(_) => Err("expected --cohort beside --server, got none".into()),
        }
    }

    /// Opens the store, or prepares requests.
    pub(super) async fn open(self, at: At) -> Result<Target, String> {
        let Some(server) = self.server else {
            if self.key.is_some() {
                return Err("expected --server beside --key, got none".into());
            }
            return store(&self.tenant, at).await.map(|app| Target::Store(Box::new(app)));
        };
        let mut address: Url = server
            .parse()
            .map_err(|error| format!("expected the address of a service, got '{server}': {error}"))?;
        if !address.path().ends_with('/') {
            address.set_path(&format!("{}/", address.path()));
        }
        let client = Client::builder().connect_timeout(CONNECT).build().map_err(|error| error.to_string())?;
        let bearer = |key: String| {
            let mut value = HeaderValue::from_str(&format!("Bearer {}", key.trim()))
                .map_err(|_| "expected a key of printable characters".to_owned())?;
            value.set_sensitive(true);
            Ok::<_, String>(value)
        };
        Ok(Target::Service(Box::new(Service { client, address, key: self.key.map(bearer).transpose()? })))
    }
}

/// The service over a store, as seen by the system user of a tenant.
async fn store(tenant: &str, at: At) -> Result<App, String> {
    if let Some(problem) = tenant_problem(tenant) {
        return Err(format!("tenant '{tenant}': {problem}"));
    }
    let (data_dir, database_url, database_url_file) = at.parts();
    let place = StoreLocation {
        database_url: store_location::database_url(&database_url, database_url_file.as_deref())?,
        database_connections: CONNECTIONS,
        data_dir,
        accepts_loss: false,
    };
    // The memory of the machine is that of the command.
    let limits = Limits { answer_bytes: usize::MAX, ..Limits::default() };
    let app = App::new(place.attach().await?, limits, 0);
    Ok(app.of(Arc::new(Principal::system(tenant))))
}

impl Service {
    /// A request to a path below the address.
    pub(super) fn request(
        &self,
        method: reqwest::Method,
        segments: &[&str],
        query: &[(String, String)],
    ) -> Result<RequestBuilder, String> {
        let mut address = self.address.clone();
        let refused = || format!("expected an address with a host, got '{}'", self.address);
        address.path_segments_mut().map_err(|()| refused())?.pop_if_empty().extend(segments);
        if !query.is_empty() {
            address.query_pairs_mut().extend_pairs(query);
        }
        let request = self.client.request(method, address);
        Ok(match &self.key {
            Some(key) => request.header(AUTHORIZATION, key.clone()),
            None => request,
        })
    }

    /// A request whose body is a file.
    pub(super) fn with_file(request: RequestBuilder, body: reqwest::Body) -> RequestBuilder {
        request.header(CONTENT_TYPE, "application/octet-stream").body(body)
    }
}

/// The sentence of a refusal, with its faults.
pub(super) async fn refusal(response: Response) -> String {
    let status = response.status();
    let document: serde_json::Value = response.json().await.unwrap_or_default();
    let Some(detail) = document["detail"].as_str() else { return format!("the service answers {status}") };
    let place = document["errors"][0]["place"].as_object().map(|place| {
        let parts = place.iter().map(|(name, value)| match value.as_str() {
            Some(text) => format!("{name} {text}"),
            None => format!("{name} {value}"),
        });
        parts.collect::<Vec<_>>().join(", ")
    });
    match place {
        Some(place) => format!("{place}: {detail}"),
        None => detail.to_owned(),
    }
}
