//! The revision that a command is about.

use std::sync::Arc;

use clap::Args;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::manifest::revisions;
use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::objects::Objects;

#[derive(Debug, Args)]
pub(crate) struct Selection {
    /// Id of the cohort.
    #[arg(long)]
    cohort: String,
    /// Revision. Default: the latest.
    #[arg(long)]
    revision: Option<u64>,
}

impl Selection {
    pub(crate) async fn open(&self, objects: Objects) -> Result<Arc<Revision>, EngineError> {
        let revision = match self.revision {
            Some(revision) => revision,
            None => revisions(&objects, &self.cohort).await?.pop().ok_or_else(|| EngineError::Refused {
                place: "cohort".into(),
                detail: format!("expected a cohort with a revision, got '{}'", self.cohort),
            })?,
        };
        Ok(Arc::new(Revision::open(objects, &self.cohort, revision).await?))
    }
}
