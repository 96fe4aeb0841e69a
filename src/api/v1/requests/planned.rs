//! Studies of stored shapes, answered inline or by a job: common fields of their requests, and their handler.

use axum::body::Bytes;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio::runtime::Handle;

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::defaults::PERMUTATIONS;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Format, Prefer};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, picture};
use crate::api::v1::administration::jobs::accepted;
use crate::api::v1::requests::request_macros::priority_of;
use crate::domain::job::{Job, JobStatus, Priority};
use crate::service::app::{App, ServiceError, Work};
use crate::service::inference::study::{Study, StudyKind, StudyRequest};
use crate::service::jobs;
use crate::service::jobs::inline_or_job::{PlannedTest, submit};
use crate::wire::checked::Checked;
use crate::wire::fault::Fault;
use crate::wire::json;

/// Request for a study of kind [`Self::Kind`].
pub(in crate::api::v1) trait StudyBody: DeserializeOwned {
    /// Kind of study.
    type Kind: StudyKind;

    /// Takes the priority of the job.
    fn take_priority(&mut self) -> Option<Checked<Priority>>;

    /// The checked request.
    fn request(self) -> Result<StudyRequest<<Self::Kind as StudyKind>::Options>, ServiceError>;
}

/// Answers a request for a study.
pub(in crate::api::v1) async fn answer_study<B: StudyBody>(
    app: App,
    format: Format,
    prefer: Prefer,
    body: Bytes,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: B = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.take_priority())?);
    let study = Study::<B::Kind>::prepare(&app, request.request()?).await?;
    answered(app, study, format, prefer).await
}

/// Answers small tests inline. Others become a job: returns its result if it is ready within the client's `wait`, else the job.
pub(in crate::api::v1) async fn answered<T: PlannedTest>(
    app: App,
    test: T,
    format: Format,
    prefer: Prefer,
) -> Result<Response, Problem> {
    if test.is_quick() {
        let (handle, work) = (Handle::current(), Work::from_seconds(test.seconds()) + format.work());
        return compute(app.weighing(work), move |app| {
            let answer = test.answer(app, &handle, &app.pool.context())?;
            match format {
                Format::Picture(file) => picture(&test.draw(&answer), &file),
                Format::Json => json(StatusCode::OK, &answer),
            }
        })
        .await;
    }
    let mut job = match waited(&app, submit(&app, &test).await?, prefer).await? {
        Waited::Succeeded(job) => job,
        Waited::Else(response) => return Ok(response),
    };
    let Some(result) = job.result.take() else { return Ok(accepted(*job)?) };
    compute(app.weighing(Work::MOMENT + format.work()), move |_| match format {
        Format::Json => json(StatusCode::OK, &result),
        Format::Picture(file) => {
            let answer = json::from_value(&result)
                .map_err(|error| ServiceError::Internal(format!("the result of a job: {error}")))?;
            picture(&test.draw(&answer), &file)
        }
    })
    .await
}

/// A job for which the client has waited.
pub(in crate::api::v1) enum Waited {
    /// It succeeded within the wait.
    Succeeded(Box<Job>),
    /// It did not: the response.
    Else(Response),
}

/// Waits for a job as long as the client wants to.
///
/// # Errors
/// A job that failed.
pub(in crate::api::v1) async fn waited(app: &App, job: Job, prefer: Prefer) -> Result<Waited, Problem> {
    // Without `wait`, the client gets the job, even if a replayed request finds it finished.
    let Some(time) = prefer.wait else { return Ok(Waited::Else(accepted(job)?)) };
    let job = jobs::wait(app, &job.id, time).await?;
    match job.status {
        JobStatus::Succeeded => Ok(Waited::Succeeded(Box::new(job))),
        JobStatus::Failed => Err(Problem::from_failed(&job)),
        _ => Ok(Waited::Else(accepted(job)?)),
    }
}

/// Declares the request of a study: its own fields, which follow the cohort; descriptions of common fields; further fields.
macro_rules! study_request {
    ($(#[$meta:meta])* $name:ident { $($own:tt)* } {
        $(#[$permutations:meta])* permutations
        $(#[$seed:meta])* seed
        $(#[$strata:meta])* strata
    } { $($further:tt)* }) => {
        crate::wire::checked::document! {
            $(#[$meta])*
            pub(in crate::api::v1) struct $name {
                /// Id or name of the cohort.
                #[schema(value_type = String, required = true)]
                cohort: crate::wire::checked::Checked<String>, required;
                $($own)*
                /// Transformation class to remove. Default: `similarity`.
                #[schema(value_type = Option<crate::analysis::transformation::Transformation>)]
                transformation: crate::wire::checked::Checked<crate::analysis::transformation::Transformation>;
                /// Alignment method. Default: `projection`, or where the class is no linear space `partial_procrustes` (`similarity` in
                /// three dimensions) or `procrustes` (`rigid`).
                #[schema(value_type = Option<crate::analysis::alignment::Alignment>)]
                alignment: crate::wire::checked::Checked<crate::analysis::alignment::Alignment>;
                /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean, so that shapes do not shrink with
                /// their own roughness. Default: true where the class removes size, unless `alignment` is `projection` or `procrustes`.
                #[schema(value_type = Option<bool>)]
                tangent: crate::wire::checked::Checked<bool>;
                /// Whether shapes may be matched to mirror images. Default: the cohort's setting.
                #[schema(value_type = Option<crate::analysis::correspondence::Mirror>)]
                mirror: crate::wire::checked::Checked<crate::analysis::correspondence::Mirror>;
                $(#[$permutations])*
                #[schema(value_type = Option<usize>, maximum = 100000)]
                permutations: crate::wire::checked::Checked<usize>;
                $(#[$seed])*
                #[schema(value_type = Option<u64>)]
                seed: crate::wire::checked::Checked<u64>;
                $(#[$strata])*
                #[schema(value_type = Option<Vec<String>>)]
                strata: crate::wire::checked::Checked<crate::api::v1::requests::planned::Names>;
                $($further)*
                /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
                #[schema(value_type = Option<crate::domain::job::Priority>)]
                priority: crate::wire::checked::Checked<crate::domain::job::Priority>;
            }
        }

        impl $name {
            /// Takes the common fields but the cohort; faults go to `errors`.
            fn take_common(
                &mut self,
                errors: &mut Vec<crate::wire::fault::Fault>,
            ) -> crate::api::v1::requests::planned::Common {
                use crate::wire::checked::{take_given, take_or_default};
                crate::api::v1::requests::planned::Common {
                    transformation: take_given(self.transformation.take(), "/transformation", errors),
                    alignment: take_given(self.alignment.take(), "/alignment", errors),
                    tangent: take_given(self.tangent.take(), "/tangent", errors),
                    mirror: take_given(self.mirror.take(), "/mirror", errors),
                    permutations: take_given(self.permutations.take(), "/permutations", errors),
                    seed: take_or_default(self.seed.take(), "/seed", errors),
                    strata: take_or_default(self.strata.take(), "/strata", errors),
                }
            }
        }
    };
}
pub(in crate::api::v1) use study_request;

/// Common fields of requests for studies, but the cohort.
pub(in crate::api::v1) struct Common {
    pub(in crate::api::v1) transformation: Option<Transformation>,
    pub(in crate::api::v1) alignment: Option<Alignment>,
    pub(in crate::api::v1) tangent: Option<bool>,
    pub(in crate::api::v1) mirror: Option<Mirror>,
    pub(in crate::api::v1) permutations: Option<usize>,
    pub(in crate::api::v1) seed: Option<u64>,
    pub(in crate::api::v1) strata: Option<Names>,
}

impl Common {
    /// The request, provided that there are no faults.
    ///
    /// # Errors
    /// `faults`.
    pub(in crate::api::v1) fn request<O>(
        self,
        cohort: Option<String>,
        options: Option<O>,
        faults: Vec<Fault>,
    ) -> Result<StudyRequest<O>, ServiceError> {
        ServiceError::unless_empty(faults)?;
        let incomplete = || ServiceError::invalid("", "the request is incomplete");
        Ok(StudyRequest {
            cohort: cohort.ok_or_else(incomplete)?,
            transformation: self.transformation.unwrap_or(Transformation::Named(ClassName::Similarity)),
            alignment: self.alignment,
            tangent: self.tangent,
            mirror: self.mirror,
            permutations: self.permutations.unwrap_or(PERMUTATIONS),
            seed: self.seed.ok_or_else(incomplete)?,
            strata: self.strata.ok_or_else(incomplete)?.0,
            options: options.ok_or_else(incomplete)?,
        })
    }
}

/// One name or a list of names.
#[derive(Debug, Clone, Default)]
pub(in crate::api::v1) struct Names(pub(in crate::api::v1) Vec<String>);

/// Written by hand: the derived error of an untagged enum names neither the place nor the fault.
impl<'de> Deserialize<'de> for Names {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NamesVisitor;
        impl<'de> serde::de::Visitor<'de> for NamesVisitor {
            type Value = Names;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of an attribute or a list of names")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Names, E> {
                Ok(Names(vec![name.to_owned()]))
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, list: A) -> Result<Names, A::Error> {
                Vec::deserialize(serde::de::value::SeqAccessDeserializer::new(list)).map(Names)
            }
        }
        deserializer.deserialize_any(NamesVisitor)
    }
}
