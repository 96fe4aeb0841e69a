//! Forms: a JSON document and files, as `multipart/form-data` (RFC 7578).
//!
//! The part `parameters` comes first. Every part is bounded while it arrives, and all are bounded together with the bodies of
//! other requests.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, header};
use futures_util::{Stream, StreamExt, stream};
use multer::{Constraints, Field, Multipart, SizeLimit};

use super::body::{HeldBody, LONG, too_many_values, unreadable};
use super::extract::TWICE;
use super::media_type::{is_form, is_json, media_type};
use super::overload::most_form_bytes;
use super::problem::{Problem, ProblemKind};
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError};
use crate::wire::bounds::Census;

/// Name of the JSON document.
const PARAMETERS: &str = "parameters";
/// A form with its files.
#[derive(Debug)]
pub struct Form {
    /// The JSON document.
    pub parameters: Bytes,
    files: Vec<(&'static str, Bytes)>,
}

impl Form {
    /// The file with this name, if there is one.
    pub fn file(&self, name: &str) -> Option<Bytes> {
        self.files.iter().find(|(own, _)| *own == name).map(|(_, bytes)| bytes.clone())
    }

    /// All parts with their names, in order.
    pub fn parts(&self) -> Vec<(&'static str, Bytes)> {
        let document = (PARAMETERS, self.parameters.clone());
        std::iter::once(document).chain(self.files.iter().cloned()).collect()
    }

    /// The file with this name.
    ///
    /// # Errors
    /// A fault at `/name` if there is none.
    pub fn required(&self, name: &str) -> Result<Bytes, ServiceError> {
        self.file(name).ok_or_else(|| {
            ServiceError::invalid(format!("/{name}"), "expected a file in this part, got no part")
        })
    }
}

/// Reads a form with files of the given names, each at most once.
///
/// # Errors
/// Another media type; parts that are unknown, repeated, too long or broken; [`ProblemKind::Overloaded`] if memory is short.
pub async fn read(app: &App, request: Request, names: &'static [&'static str]) -> Result<Form, Problem> {
    let found = media_type(request.headers());
    if !is_form(&found) {
        let detail = format!("expected multipart/form-data, got '{found}'");
        return Err(Problem::new(ProblemKind::UnsupportedMediaType, detail));
    }
    let boundary = boundary(request.headers())
        .ok_or_else(|| malformed("expected a boundary in the media type multipart/form-data, got none"))?;
    let is_short = length(request.headers()).is_some_and(|length| length <= LONG);
    let reading =
        Reading { app: app.clone(), names, form: Form { parameters: Bytes::new(), files: Vec::new() } };
    let parts = reading.read(request.into_body(), boundary);
    if is_short { parts.await } else { app.pool.read_body(parts).await? }
}

fn length(headers: &HeaderMap) -> Option<usize> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

fn boundary(headers: &HeaderMap) -> Option<String> {
    multer::parse_boundary(headers.get(header::CONTENT_TYPE)?.to_str().ok()?).ok()
}

fn malformed(detail: &str) -> Problem {
    Problem::new(ProblemKind::MalformedBody, detail)
}

/// The pieces of a body, of which only one is ready at a time: the parser takes all that are ready into a buffer that no account
/// covers, and takes an end that comes with the first piece for a body without parts.
fn piecewise(body: Body) -> impl Stream<Item = Result<Bytes, axum::Error>> {
    stream::unfold((body.into_data_stream(), true), |(mut pieces, is_first)| async move {
        if !is_first {
            tokio::task::yield_now().await;
        }
        pieces.next().await.map(|piece| (piece, (pieces, false)))
    })
}

/// A form of which some parts have been read.
struct Reading {
    app: App,
    names: &'static [&'static str],
    form: Form,
}

impl Reading {
    async fn read(mut self, body: Body, boundary: String) -> Result<Form, Problem> {
        let most = most_form_bytes(&self.app.limits) as u64;
        let bounds = Constraints::new().size_limit(SizeLimit::new().whole_stream(most));
        let mut parts = Multipart::with_constraints(piecewise(body), boundary, bounds);
        let mut is_first = true;
        while let Some(part) = parts.next_field().await.map_err(|error| self.broken(error))? {
            self.take(part, is_first).await?;
            is_first = false;
        }
        if is_first {
            return Err(
                ServiceError::invalid("/parameters", "expected the part parameters, got no part").into()
            );
        }
        Ok(self.form)
    }

    /// Reads a part.
    async fn take(&mut self, part: Field<'_>, is_first: bool) -> Result<(), Problem> {
        let name = part.name().unwrap_or_default().to_owned();
        if is_first != (name == PARAMETERS) {
            return Err(self.misplaced(&name, is_first).into());
        }
        if is_first {
            self.form.parameters = self.document(part).await?;
            return Ok(());
        }
        let known = self.names.iter().find(|known| **known == name);
        let Some(known) = known else { return Err(self.unknown(&name).into()) };
        if self.form.file(known).is_some() {
            return Err(ServiceError::invalid(format!("/{known}"), TWICE.replace("parameter", "part")).into());
        }
        let limit = self.app.limits.image_bytes;
        let file = self.bytes(part, known, limit, |length, _| Ok(length)).await?;
        self.form.files.push((known, file));
        Ok(())
    }

    /// A part that is not where it belongs.
    fn misplaced(&self, name: &str, is_first: bool) -> ServiceError {
        if !is_first {
            return ServiceError::invalid("/parameters", "expected the part parameters once, got it twice");
        }
        let is_known = self.names.contains(&name);
        let detail = format!("expected the part parameters first, got \"{name}\"");
        if is_known { ServiceError::invalid("/parameters", detail) } else { self.unknown(name) }
    }

    fn unknown(&self, name: &str) -> ServiceError {
        let detail =
            format!("expected one of the parts {PARAMETERS}, {}, got \"{name}\"", self.names.join(", "));
        ServiceError::invalid(format!("/{}", name.replace('~', "~0").replace('/', "~1")), detail)
    }

    /// Reads the JSON document.
    async fn document(&self, part: Field<'_>) -> Result<Bytes, Problem> {
        let found = part.content_type().map(|found| found.essence_str().to_ascii_lowercase());
        if let Some(found) = found.filter(|found| !is_json(found)) {
            let detail = format!("expected application/json in the part parameters, got '{found}'");
            return Err(Problem::new(ProblemKind::UnsupportedMediaType, detail));
        }
        let limits = self.app.limits;
        let mut census = Census::default();
        let memory = move |_, piece: &[u8]| {
            census = census.and(Census::of(piece));
            if census.values > limits.json_values {
                return Err(too_many_values(limits.json_values));
            }
            Ok(census.memory(limits.shapes))
        };
        self.bytes(part, PARAMETERS, limits.body_bytes, memory).await
    }

    /// Reads a part to its end. `memory` tells how much to reserve for the bytes so far and the values made of them.
    async fn bytes(
        &self,
        mut part: Field<'_>,
        name: &str,
        limit: usize,
        mut memory: impl FnMut(usize, &[u8]) -> Result<usize, Problem>,
    ) -> Result<Bytes, Problem> {
        let (mut bytes, mut room) = (Vec::new(), self.app.memory.hold(Purpose::Bodies, 0)?);
        while let Some(piece) = part.chunk().await.map_err(|error| self.broken(error))? {
            if bytes.len() + piece.len() > limit {
                let detail = format!("the part {name} is longer than {limit} bytes");
                return Err(Problem::new(ProblemKind::PayloadTooLarge, detail));
            }
            room.resize(memory(bytes.len() + piece.len(), &piece)?)?;
            bytes.extend_from_slice(&piece);
        }
        Ok(HeldBody::of(bytes, room))
    }

    /// Problem of a form that is cut off or no form.
    fn broken(&self, error: multer::Error) -> Problem {
        let most = most_form_bytes(&self.app.limits);
        match error {
            multer::Error::StreamReadFailed(error) => unreadable(axum::Error::new(error), most),
            multer::Error::StreamSizeExceeded { .. } => {
                Problem::new(ProblemKind::PayloadTooLarge, format!("the form is longer than {most} bytes"))
            }
            multer::Error::IncompleteHeaders
            | multer::Error::IncompleteFieldData { .. }
            | multer::Error::IncompleteStream => {
                malformed("expected the closing boundary of the form, got the end of the body")
            }
            _ => malformed("expected a boundary and the header of a part, got other bytes"),
        }
    }
}
