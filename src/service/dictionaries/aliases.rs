//! Aliases of dictionaries: `name@alias` is the version that the alias names at that moment.
//!
//! They belong to the name, not to a version: every key of the dictionary finds them.

use std::sync::Arc;

use crate::domain::access::Principal;
use crate::domain::dictionary::{Alias, alias_problem};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue::Expected;
use crate::store::{AliasMove, AliasMoved, MAX_ALIASES};

/// Entity tag of an alias, which changes with every move.
pub fn alias_tag(alias: &Alias) -> String {
    format!("\"{}-{}\"", alias.id, alias.moves)
}

/// Aliases of the dictionary with this key, in alphabetic order.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn list(app: &App, key: &str) -> Result<Vec<Alias>, ServiceError> {
    let name = name_of(app, key).await?;
    Ok(app.store.list_aliases(&name, None).await?)
}

/// An alias of the dictionary with this key.
///
/// # Errors
/// [`ServiceError::NotFound`] for the dictionary or the alias.
pub async fn find(app: &App, key: &str, alias: &str) -> Result<Alias, ServiceError> {
    let name = name_of(app, key).await?;
    let found = app.store.find_alias(&name, alias).await?.ok_or_else(|| not_found(&name, alias))?;
    app.touched.note("dictionary_id", &found.id);
    Ok(found)
}

/// Makes an alias name a version of the dictionary with this key; returns whether it is new.
///
/// # Errors
/// [`ServiceError::NotFound`] for the dictionary; a text that is not an alias; a version that does not exist; too many aliases;
/// [`ServiceError::Changed`]; [`ServiceError::Forbidden`] if the alias names a version that is hidden from the caller.
pub async fn set(
    app: &App,
    key: &str,
    alias: &str,
    version: u64,
    expected: Option<Expected>,
) -> Result<(Alias, bool), ServiceError> {
    let name = name_of(app, key).await?;
    if let Some(problem) = alias_problem(alias) {
        return Err(ServiceError::parameter("alias", problem));
    }
    let no_version = || {
        let detail = format!("expected the number of a version of '{name}' that exists, got {version}");
        ServiceError::invalid("/version", detail)
    };
    let id = app.store.find_dictionary_id(&format!("{name}@{version}")).await?.ok_or_else(no_version)?;
    app.touched.note("dictionary_id", &id);
    let present = app.store.find_alias(&name, alias).await?;
    if let Some(present) = &present {
        app.touched.note("dictionary_id", &present.id);
    } else {
        check_is_open(app, &name, alias).await?;
    }
    let expected = moves_expected(present.as_ref(), expected)?;
    let wanted = AliasMove { name: &name, alias, id: &id, expected };
    let created = match app.store.set_alias(&wanted, app.clock().stamp_ms()).await? {
        AliasMoved::Created => true,
        AliasMoved::Moved => false,
        AliasMoved::NoVersion => return Err(no_version()),
        AliasMoved::TooMany => {
            let detail = format!("expected at most {MAX_ALIASES} aliases of a dictionary, got one more");
            return Err(ServiceError::parameter("alias", detail));
        }
    };
    let set = app.store.find_alias(&name, alias).await?.ok_or_else(|| not_found(&name, alias))?;
    Ok((set, created))
}

/// Removes an alias of the dictionary with this key.
///
/// # Errors
/// [`ServiceError::NotFound`] for the dictionary or the alias; [`ServiceError::Changed`].
pub async fn remove(
    app: &App,
    key: &str,
    alias: &str,
    expected: Option<Expected>,
) -> Result<(), ServiceError> {
    let present = find(app, key, alias).await?;
    let expected = moves_expected(Some(&present), expected)?;
    if app.store.remove_alias(&present.name, alias, expected, app.clock().stamp_ms()).await? {
        return Ok(());
    }
    Err(not_found(&present.name, alias))
}

async fn name_of(app: &App, key: &str) -> Result<String, ServiceError> {
    let found = app.store.find_dictionary_name(key).await?;
    found.ok_or_else(|| ServiceError::NotFound { kind: "dictionary", key: key.into() })
}

fn not_found(name: &str, alias: &str) -> ServiceError {
    ServiceError::NotFound { kind: "alias", key: format!("{name}@{alias}") }
}

/// Number of moves of an alias that must be at an expected version.
fn moves_expected(present: Option<&Alias>, expected: Option<Expected>) -> Result<Option<u64>, ServiceError> {
    let Some(expected) = expected else { return Ok(None) };
    let Some(present) = present else {
        return Err(ServiceError::Changed("the alias does not exist: list the aliases again".into()));
    };
    expected.check(&alias_tag(present))?;
    Ok(Some(present.moves))
}

/// Refuses a caller limited to certain cohorts an alias that names a version of another cohort: those who use it would get
/// another version.
async fn check_is_open(app: &App, name: &str, alias: &str) -> Result<(), ServiceError> {
    if app.principal.cohorts.is_none() {
        return Ok(());
    }
    let whole_tenant = app.store.of(Arc::new(Principal::system(&app.principal.tenant)));
    if whole_tenant.find_alias(name, alias).await?.is_none() {
        return Ok(());
    }
    let detail =
        format!("the alias '{name}@{alias}' names a dictionary of another cohort: choose another alias");
    Err(ServiceError::Forbidden(detail))
}
