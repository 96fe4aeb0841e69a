//! Content of a file that a cohort would take, told without storing it.

use serde::Serialize;
use serde_json::Value;

use super::adding::{Adding, Content, sentence};
use super::target::{Service, Target, refusal};
use crate::service::app::App;
use crate::service::cohorts::catalogue;
use crate::service::cohorts::preview::Preview;
use crate::service::cohorts::upload_file::preview_file;
use crate::service::files::FileFormat;
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::lengths::FileUnits;
use crate::wire::summary::FileSummary;

/// Number of kinds of faults in lines for people.
const FAULTS: usize = 20;

/// Effect that an upload of a file would have.
#[derive(Debug, Serialize)]
pub(super) struct Outlook {
    /// Number of new shapes, of those that are there already, and of those that would not be stored; of these, number of those whose
    /// name belongs to another shape.
    added: u64,
    unchanged: u64,
    skipped: u64,
    conflicts: u64,
    /// Revision of the cohort.
    revision: u64,
    warnings: Vec<String>,
    /// Faults of invalid shapes by kind.
    faults: Vec<Fault>,
    /// Why nothing would be stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    refusal: Option<String>,
    summary: FileSummary,
}

/// Looks at a file; the inner error is the refusal of the file as a whole.
///
/// # Errors
/// Faults that would refuse all files.
pub(super) async fn look(
    adding: &Adding<'_>,
    content: &Content<'_>,
    format: FileFormat,
    query: &[(String, String)],
) -> Result<Result<Outlook, String>, String> {
    match &adding.target {
        Target::Service(service) => ask(adding, service, content, query).await,
        Target::Store(app) => look_in(adding, app, content, format, query).await,
    }
}

/// Asks a service.
async fn ask(
    adding: &Adding<'_>,
    service: &Service,
    content: &Content<'_>,
    query: &[(String, String)],
) -> Result<Result<Outlook, String>, String> {
    let query = [query, &[("cohort".to_owned(), adding.cohort.clone())]].concat();
    let request = service.request(reqwest::Method::POST, &["v1", "inspect"], &query)?;
    let body = match adding.body(content).await {
        Ok(body) => body,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let sent = Service::with_file(request, body).send().await;
    let response = sent.map_err(|error| format!("the service does not answer: {error}"))?;
    match response.status().as_u16() {
        200 => {
            let answer: Value = response.json().await.map_err(|error| error.to_string())?;
            match answer["cohort"].is_object() {
                true => Ok(Ok(Outlook::answered(&answer))),
                false => {
                    Err("the service is of a release that does not look at files against a cohort".into())
                }
            }
        }
        // These would refuse every file.
        401 | 403 | 404 => Err(refusal(response).await),
        _ => Ok(Err(refusal(response).await)),
    }
}

/// Looks into a store.
async fn look_in(
    adding: &Adding<'_>,
    app: &App,
    content: &Content<'_>,
    format: FileFormat,
    query: &[(String, String)],
) -> Result<Result<Outlook, String>, String> {
    let (file, treatment) = adding.file(app, format, query)?;
    let cohort = catalogue::find(app, &adding.cohort).await.map_err(|error| error.to_string())?;
    let stream = match adding.pieces(content).await {
        Ok(stream) => stream,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let found = preview_file(app, cohort, stream, file, treatment).await;
    Ok(found.map(Outlook::from).map_err(|error| sentence(&error)))
}

impl From<Preview> for Outlook {
    fn from(preview: Preview) -> Self {
        let Preview { stored, file, conflicts, faults, refusal, .. } = preview;
        Self {
            added: stored.added as u64,
            unchanged: stored.unchanged as u64,
            skipped: stored.skipped as u64,
            conflicts: conflicts as u64,
            revision: stored.revision,
            warnings: stored.warnings,
            faults: faults.into_listed(),
            refusal: refusal.as_ref().map(sentence),
            summary: file,
        }
    }
}

impl Outlook {
    /// That of an answer to `POST /v1/inspect`.
    fn answered(answer: &Value) -> Self {
        let found = &answer["cohort"];
        let count = |name: &str| found[name].as_u64().unwrap_or_default();
        Self {
            added: count("added"),
            unchanged: count("unchanged"),
            skipped: count("skipped"),
            conflicts: count("conflicts"),
            revision: count("revision"),
            warnings: json::from_value(&found["warnings"]).unwrap_or_default(),
            faults: json::from_value(&found["faults"]).unwrap_or_default(),
            refusal: found["refusal"]["detail"].as_str().map(str::to_owned),
            summary: json::from_value(answer).unwrap_or_default(),
        }
    }

    /// Whether the upload would not be refused.
    pub(super) fn is_accepted(&self) -> bool {
        self.refusal.is_none()
    }

    /// Whether something of the file would not be stored.
    pub(super) fn has_findings(&self) -> bool {
        !self.is_accepted() || self.skipped > 0
    }

    /// The same in words.
    pub(super) fn lines(&self, file: &str) -> Vec<String> {
        let Self { added, unchanged, skipped, conflicts, summary, .. } = self;
        let mut parts = vec![format!("{file}: {added} shapes would be added")];
        if *unchanged > 0 {
            parts.push(format!("{unchanged} are there already"));
        }
        if *skipped > 0 {
            let of_others = if *conflicts > 0 {
                format!(", {conflicts} of them under the names of others")
            } else {
                String::new()
            };
            parts.push(format!("{skipped} cannot be stored{of_others}"));
        }
        parts.extend(summary.left_out.iter().map(|left| format!("{} {} left out", left.count, left.what)));
        parts.extend(summary.units.as_ref().and_then(FileUnits::sentence));
        let mut lines = vec![parts.join("; ")];
        let warnings = self.warnings.iter().chain(&summary.warnings);
        lines.extend(warnings.map(|warning| format!("  warning: {warning}")));
        lines.extend(self.faults.iter().take(FAULTS).map(told));
        lines.extend(self.refusal.as_ref().map(|refusal| format!("  nothing would be stored: {refusal}")));
        lines
    }
}

/// A fault with its place and the number of those that say the same.
fn told(fault: &Fault) -> String {
    let place = fault.place.as_ref().map_or_else(String::new, |place| format!("{place}: "));
    let times = fault.alike.as_ref().map_or_else(String::new, |alike| format!(" ({} times)", alike.count));
    format!("  {place}{}{times}", fault.detail)
}
