//! `shapelex key`: creates, lists and revokes API keys, beside a running service or before its first start.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, Subcommand};

use crate::domain::access::{DEFAULT_TENANT, Principal, Role, tenant_problem};
use crate::domain::key::Key;
use crate::service::access::keys::{self, NewKey};
use crate::service::app::{App, Limits, ServiceError, now_ms};
use crate::store_location::{self, StoreLocation};
use crate::wire::time::rfc3339;

/// Number of database connections of a command.
const CONNECTIONS: u32 = 2;
/// Number of keys read at a time.
const PAGE: usize = 1000;

/// Subcommands of `shapelex key`.
#[derive(Debug, Subcommand)]
pub(super) enum KeyCommand {
    /// Create a key; its secret is printed only once
    Create(CreateArgs),
    /// List the keys of a tenant, or of all, including expired and revoked ones
    List(ListArgs),
    /// Revoke a key permanently
    Revoke(RevokeArgs),
}

#[derive(Debug, Args)]
pub(super) struct CreateArgs {
    /// Display name
    #[arg(long)]
    name: String,
    /// Role: `reader`, `writer` or `admin`
    #[arg(long, value_parser = role)]
    role: Role,
    /// Id or name of the only cohort the key gives access to; may be repeated
    #[arg(long = "cohort", value_name = "COHORT")]
    cohorts: Vec<String>,
    /// Days until the key expires. Default: never
    #[arg(long, value_name = "N")]
    expires_in_days: Option<u32>,
    /// File with the text of a key generated elsewhere (`shk_`, 32 hexadecimal digits, `_`, 64 more); only its id is printed
    #[arg(long, value_name = "FILE")]
    secret_file: Option<PathBuf>,
    #[command(flatten)]
    at: WhereArgs,
}

#[derive(Debug, Args)]
pub(super) struct ListArgs {
    /// List the keys of all tenants
    #[arg(long, conflicts_with = "tenant")]
    all_tenants: bool,
    #[command(flatten)]
    at: WhereArgs,
}

#[derive(Debug, Args)]
pub(super) struct RevokeArgs {
    /// Id of the key: `key_…`. Without a tenant, that of any tenant
    id: String,
    #[command(flatten)]
    at: WhereArgs,
}

#[derive(Debug, Args)]
pub(super) struct WhereArgs {
    /// Tenant that owns the keys [default: default]
    #[arg(long)]
    tenant: Option<String>,
    /// Folder of the embedded store
    #[arg(long, env = "SHAPELEX_DATA_DIR", default_value = "shapelex-data")]
    data_dir: PathBuf,
    /// Address of the PostgreSQL database, if the store is not embedded
    #[arg(long, env = "DATABASE_URL", hide_env_values = true, default_value = "")]
    database_url: String,
    /// File with the address of the PostgreSQL database, in place of the address itself
    #[arg(long, env = "SHAPELEX_DATABASE_URL_FILE", value_name = "FILE")]
    database_url_file: Option<PathBuf>,
}

fn role(word: &str) -> Result<Role, String> {
    Role::from_word(word).ok_or_else(|| "expected reader, writer or admin".into())
}

/// Executes the command; returns its output.
///
/// # Errors
/// Reason for the failure, in one sentence.
pub(super) async fn run(command: KeyCommand) -> Result<String, String> {
    let at = match &command {
        KeyCommand::Create(args) => &args.at,
        KeyCommand::Revoke(args) => &args.at,
        KeyCommand::List(args) => &args.at,
    };
    let app = at.open().await?;
    let answer = match command {
        KeyCommand::Create(args) => create(&app, args).await,
        KeyCommand::List(args) => list(&app, args.all_tenants).await,
        KeyCommand::Revoke(args) => revoke(&app, &args).await,
    };
    app.store.close().await;
    answer.map_err(|error| error.to_string())
}

impl WhereArgs {
    /// The service as seen by an administrator of the tenant.
    async fn open(&self) -> Result<App, String> {
        let tenant = self.tenant.as_deref().unwrap_or(DEFAULT_TENANT);
        if let Some(problem) = tenant_problem(tenant) {
            return Err(format!("tenant '{tenant}': {problem}"));
        }
        let place = StoreLocation {
            database_url: store_location::database_url(
                &self.database_url,
                self.database_url_file.as_deref(),
            )?,
            database_connections: CONNECTIONS,
            data_dir: self.data_dir.clone(),
            accepts_loss: false,
        };
        let app = App::new(place.attach().await?, Limits::default(), 1);
        Ok(app.of(Arc::new(Principal::system(tenant))))
    }
}

/// Returns the secret alone, for `KEY=$(shapelex key create …)`; for a given secret, the id.
async fn create(app: &App, args: CreateArgs) -> Result<String, ServiceError> {
    let cohorts = (!args.cohorts.is_empty()).then_some(args.cohorts);
    let new = NewKey { name: args.name, role: args.role, cohorts, expires_in_days: args.expires_in_days };
    let Some(file) = args.secret_file else {
        let issued = keys::create(app, new).await?;
        return Ok(format!("{}\n", issued.secret.reveal()));
    };
    let text = std::fs::read_to_string(&file)
        .map_err(|error| ServiceError::Query(format!("{}: {error}", file.display())))?;
    let key = keys::create_given(app, new, text.trim()).await?;
    Ok(format!("{}\n", key.id))
}

/// Revokes a key of the tenant that was named, else of any tenant.
async fn revoke(app: &App, args: &RevokeArgs) -> Result<String, ServiceError> {
    let found = if args.at.tenant.is_some() { None } else { app.store.find_key(&args.id).await? };
    let of_owner = found.map(|key| app.of(Arc::new(Principal::system(&key.tenant))));
    keys::revoke(of_owner.as_ref().unwrap_or(app), &args.id).await?;
    Ok(format!("{} is revoked\n", args.id))
}

/// One line per key, with fields separated by tabs; those of all tenants begin with the tenant.
async fn list(app: &App, all_tenants: bool) -> Result<String, ServiceError> {
    let head = "id\trole\tstate\tlast use\tcohorts\tname\n";
    let mut lines = if all_tenants { format!("tenant\t{head}") } else { head.to_owned() };
    let tenant = (!all_tenants).then_some(app.principal.tenant.as_str());
    let mut after: Option<String> = None;
    loop {
        let keys = app.store.list_keys(tenant, after.as_deref(), PAGE).await?;
        let tenant_of = |key: &Key| if all_tenants { format!("{}\t", key.tenant) } else { String::new() };
        lines.extend(keys.iter().map(|key| tenant_of(key) + &line(key, now_ms())));
        match keys.last().filter(|_| keys.len() == PAGE) {
            Some(last) => after = Some(last.id.clone()),
            None => return Ok(lines),
        }
    }
}

fn line(key: &Key, now: i64) -> String {
    let state = match (key.revoked_at_ms, key.expires_at_ms) {
        (Some(_), _) => "revoked".into(),
        (None, Some(end)) if end <= now => "expired".into(),
        (None, Some(end)) => format!("until {}", rfc3339(end)),
        (None, None) => "valid".into(),
    };
    let used = key.used_at_ms.map_or_else(|| "never".into(), rfc3339);
    let cohorts = key.cohorts.as_ref().map_or_else(|| "all".into(), |ids| ids.join(","));
    format!("{}\t{}\t{state}\t{used}\t{cohorts}\t{}\n", key.id, key.role.as_str(), key.name)
}
