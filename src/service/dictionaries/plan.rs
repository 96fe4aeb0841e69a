//! Plan of a dictionary, as stored with its job.

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use crate::analysis::alignment::Alignment;
use crate::analysis::classifier_record::ClassifierSettings;
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::held_out;
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::recipe::Recipe;
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::filter::ShapeFilter;
use crate::service::app::{App, ServiceError};
use crate::service::statistics::{Settings, Setup};

/// Checked parameters of learning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the dictionary.
    pub name: String,
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort.
    pub revision: u64,
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Frame: selects the representative of the mean space that is the mean shape.
    pub frame: Frame,
    /// Whether mirror images may be matched.
    pub mirror: Mirror,
    /// Components or sparse atoms.
    pub method: Method,
    /// Whether shapes unlike the majority are left out, or count less.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub robust: bool,
    /// Seed of the choice of the shapes that are held out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub held_out_seed: u64,
    /// Settings of the classifier, if one is wanted.
    #[serde(default)]
    pub classifier: Option<ClassifierSettings>,
    /// Whether the client says that the parameters of surfaces correspond.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub corresponding: bool,
    /// Id of the version from which learning continues.
    pub continue_from: Option<String>,
}

fn is_zero(seed: &u64) -> bool {
    *seed == 0
}

/// Name and version of the program.
pub fn program() -> String {
    concat!("shapelex ", env!("CARGO_PKG_VERSION")).into()
}

impl Plan {
    /// The cohort at the revision of the plan.
    pub(crate) fn cohort(&self, app: &App, handle: &Handle) -> Result<Cohort, ServiceError> {
        let cohort = handle.block_on(app.store.find_cohort(&self.cohort))?;
        let cohort =
            cohort.ok_or_else(|| ServiceError::NotFound { kind: "cohort", key: self.cohort.clone() })?;
        let cohort = cohort.at(self.revision);
        let spec = CohortSpec { mirror: self.mirror, ..cohort.spec };
        Ok(Cohort { spec, ..cohort })
    }

    /// Parameters of learning from `cohort`.
    pub(crate) fn recipe(&self, cohort: &Cohort) -> Recipe {
        Recipe {
            representation: cohort.spec.representation.clone(),
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: self.mirror,
            length_unit: cohort.spec.shown_unit().map(str::to_owned),
            transformation: self.transformation.clone(),
            alignment: self.alignment,
            frame: self.frame,
            method: self.method.clone(),
            estimator: Estimator::robust(self.robust),
            held_out_seed: self.held_out_seed,
        }
    }

    /// Number of trainings from scratch that hold out some of `shapes` shapes.
    pub(crate) fn held_out_trainings(&self, setup: &Setup, shapes: usize) -> usize {
        held_out::trainings(&self.method, setup.matching.searches(), shapes)
    }

    /// Settings for comparing the shapes of `cohort`.
    pub(crate) fn settings(&self, cohort: &Cohort) -> Settings {
        Settings {
            representation: cohort.spec.representation.clone(),
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: self.mirror,
            transformation: self.transformation.clone(),
            alignment: self.alignment,
            frame: self.frame,
            estimator: Estimator::robust(self.robust),
        }
    }
}

/// Why a version cannot be continued.
pub(crate) const NO_STATE: &str = "the version has no sums to continue from (it was imported, or they are larger \
                                   than 64 MiB): learn again from the whole cohort";
