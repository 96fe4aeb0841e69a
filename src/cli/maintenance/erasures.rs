//! `shapelex erasures`: the list of erasures, and their repetition in a store that was restored from an older backup.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Outcome, is_standard, open, say};
use crate::domain::access::Principal;
use crate::domain::erasure::{Erasure, ErasureState, subject_digest};
use crate::service::app::now_ms;
use crate::store::maintenance::{MaintenanceError, Site};
use crate::store::{Store, StoreError};
use crate::wire::json;
use crate::wire::time::rfc3339;

/// A line of the list.
#[derive(Debug, Serialize, Deserialize)]
struct Line {
    tenant: String,
    /// Digest of the subject, in hexadecimal digits.
    subject: String,
    erased_at: String,
    files: Files,
}

/// Whether the files of the store may hold remains.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Files {
    Pending,
    Done,
}

impl From<&Erasure> for Line {
    fn from(erasure: &Erasure) -> Self {
        Self {
            tenant: erasure.tenant.clone(),
            subject: hex(erasure.subject),
            erased_at: rfc3339(erasure.erased_at_ms),
            files: if erasure.state == ErasureState::Done { Files::Done } else { Files::Pending },
        }
    }
}

fn hex(digest: [u8; 32]) -> String {
    blake3::Hash::from_bytes(digest).to_hex().to_string()
}

/// Prints the list.
pub(super) async fn list(site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = Store::inspect(site).await?;
    let mut last: Option<Erasure> = None;
    loop {
        let page = store.list_erasures(last.as_ref()).await?;
        for erasure in &page {
            say(&serde_json::to_string(&Line::from(erasure)).map_err(std::io::Error::from)?);
        }
        match page.into_iter().last() {
            Some(erasure) => last = Some(erasure),
            None => break,
        }
    }
    store.close().await;
    Ok(Outcome::Done)
}

/// Erases the subjects of a list that the store holds.
pub(super) async fn repeat(file: &Path, site: &Site) -> Result<Outcome, MaintenanceError> {
    let failed = |source| MaintenanceError::File { path: file.to_path_buf(), source };
    let listed = if is_standard(file) {
        read(std::io::stdin().lock())?
    } else {
        read(BufReader::new(File::open(file).map_err(failed)?))?
    };
    let store = open(site).await?;
    let erased = erase_listed(&store, &listed).await;
    let (subjects, shapes) = match erased {
        Ok(erased) => erased,
        Err(error) => {
            store.close().await;
            return Err(error.into());
        }
    };
    let compacted = if subjects > 0 { store.compact(now_ms()).await.map(drop) } else { Ok(()) };
    store.close().await;
    say(&format!("erased {shapes} shapes of {subjects} subjects, of {} in the list", listed.len()));
    compacted.map(|()| Outcome::Done)
}

/// Tenants and digests of a list.
fn read(lines: impl BufRead) -> Result<BTreeSet<(String, String)>, MaintenanceError> {
    let mut listed = BTreeSet::new();
    for (number, line) in (1..).zip(lines.lines()) {
        let wrong = |error| MaintenanceError::Format { line: number, detail: format!("{error}") };
        let Line { tenant, subject, .. } = json::from_text(&line?).map_err(wrong)?;
        listed.insert((tenant, subject));
    }
    Ok(listed)
}

/// Erases the listed subjects; returns their number and that of their shapes.
async fn erase_listed(store: &Store, listed: &BTreeSet<(String, String)>) -> Result<(u64, u64), StoreError> {
    let (mut subjects, mut shapes) = (0, 0);
    let mut last: Option<(String, String)> = None;
    loop {
        let page = store.list_subjects(last.as_ref()).await?;
        for (tenant, subject) in &page {
            if !listed.contains(&(tenant.clone(), hex(subject_digest(tenant, subject)))) {
                continue;
            }
            let store = store.of(Principal::system(tenant).into());
            for cohort in store.find_subject(subject).await? {
                let erased = store.erase_subject(cohort, subject, now_ms()).await?;
                shapes += erased.map_or(0, |cohort| cohort.shapes);
            }
            store.finish_erasures(Some(subject), now_ms()).await?;
            subjects += 1;
        }
        match page.into_iter().last() {
            Some(found) => last = Some(found),
            None => return Ok((subjects, shapes)),
        }
    }
}
