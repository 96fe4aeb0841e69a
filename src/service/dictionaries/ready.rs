//! Dictionaries prepared for use, and cached: stored content with its space, metric, model and classifier.

use std::sync::Arc;

use super::classifier_record;
use crate::analysis::alignment::Method as Alignment;
use crate::analysis::classification::Classifier;
use crate::analysis::dictionary::algebra::Algebra;
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::learning::Learning;
use crate::analysis::dictionary::method::{Codes, Method};
use crate::analysis::dictionary::model::{Model, Spread};
use crate::analysis::dictionary::preparation::{Pose, Preparation};
use crate::analysis::pca::FunctionalPca;
use crate::analysis::rows::{Row, columns_of};
use crate::analysis::sparse::{Coder, GroupLasso, Lasso, Pursuit};
use crate::domain::dictionary::Dictionary;
use crate::numeric::dense::Matrix;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::statistics::{Settings, Setup};

/// A dictionary prepared for use.
#[derive(Debug)]
pub struct Ready {
    /// The stored dictionary.
    pub dictionary: Dictionary,
    /// Space, metric and class.
    pub setup: Setup,
    /// Preparation of shapes for the dictionary.
    pub preparation: Preparation,
    /// Atoms or components.
    pub model: Model,
    /// Classifier, if there is one.
    pub classifier: Option<Classifier>,
}

impl Cached for Ready {
    const NAME: &'static str = "dictionaries";

    fn bytes(&self) -> usize {
        // Atoms as stored, whitened and in the model, and their products; the shapes of a classifier need no more than
        // that.
        let (length, atoms) = (self.setup.metric.len(), self.dictionary.content.atoms.len());
        8 * (6 * length * (atoms + 2) + atoms * atoms) + self.setup.space.bytes()
    }
}

/// Finds a dictionary by id, `name@version`, or name (the latest version), and prepares it for use.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, key: &str) -> Result<Arc<Ready>, ServiceError> {
    let not_found = || ServiceError::NotFound { kind: "dictionary", key: key.into() };
    let id = app.store.find_dictionary_id(key).await?.ok_or_else(not_found)?;
    app.touched.note("dictionary_id", &id);
    if let Some(ready) = app.cache.find(&id, &()) {
        return Ok(ready);
    }
    let dictionary = app.store.read_dictionary(&id).await?.ok_or_else(not_found)?;
    let (task_app, content) = (app.clone(), &dictionary.content);
    let atoms = Counts::new(&content.representation, content.atoms.len(), &app.limits);
    let work = requests::space(&content.representation, &app.limits) + requests::project(atoms);
    let ready = app
        .pool
        .weighing(work)
        .run(move || {
            let (setup, preparation, model) = prepare(&task_app, &dictionary.content)?;
            let record = dictionary.content.classifier.as_ref();
            let classifier = record.map(|record| classifier_record::classifier_of(record, &setup.metric));
            Ok(Arc::new(Ready { dictionary, setup, preparation, model, classifier }))
        })
        .await?;
    app.cache.keep(&id, &(), &ready);
    Ok(ready)
}

/// Settings of a dictionary.
pub fn settings(content: &Content) -> Settings {
    Settings {
        representation: content.representation.clone(),
        correspondence: content.correspondence,
        direction: content.direction,
        mirror: content.mirror,
        transformation: content.transformation.clone(),
        alignment: content.alignment,
        frame: content.frame,
    }
}

/// Prepares a content for use. Training and use start from the same stored numbers.
///
/// # Errors
/// [`ServiceError::Invalid`] if the parts are inconsistent (in an imported file).
pub fn prepare(app: &App, content: &Content) -> Result<(Setup, Preparation, Model), ServiceError> {
    let setup = Setup::new(app, &settings(content))?;
    let whitened = |rows: &[Row]| {
        let mut columns = columns_of(rows, setup.metric.dimension());
        setup.metric.whiten(&mut columns);
        columns
    };
    let columns = content.atoms.iter().flat_map(|atom| whitened(&atom.control_points)).collect();
    let atoms = Matrix::from_vec(setup.metric.len(), content.atoms.len(), columns);
    let (pose, model) = match &content.method {
        Method::FunctionalPca { centre, .. } => {
            let mean = content.centre.as_deref().map_or_else(Vec::new, whitened);
            let pca = FunctionalPca {
                mean,
                eigenvalues: content.atoms.iter().filter_map(|atom| atom.eigenvalue).collect(),
                explained: content.atoms.iter().filter_map(|atom| atom.explained).collect(),
                eigenshapes: atoms,
                centred: *centre,
            };
            let spread = match &content.statistics.scores {
                Some(scores) => {
                    let size = scores.mean.len();
                    Spread::new(
                        scores.mean.clone(),
                        Matrix::from_fn(size, size, |i, j| scores.covariance[i][j]),
                    )
                }
                None => Spread::of(&pca, content.statistics.shapes, content.statistics.weight),
            };
            (Pose::Aligned { normalise: false }, Model::Components { pca, spread })
        }
        Method::Sparse { .. } => {
            let (pose, learning) = learning(&content.method, &setup.method)?;
            let (rows, columns) = (setup.metric.len() / learning.algebra.size(), learning.algebra.size());
            let atoms =
                atoms.reshape_generic(nalgebra::Dyn(rows), nalgebra::Dyn(columns * content.atoms.len()));
            (pose, learning.model(&atoms))
        }
    };
    let preparation = Preparation {
        metric: setup.metric.clone(),
        method: setup.method.clone(),
        matching: setup.matching.clone(),
        mean: whitened(&content.mean.control_points),
        pose,
    };
    Ok((setup, preparation, model))
}

/// Parameters of sparse learning.
///
/// # Errors
/// [`ServiceError::Invalid`] for invariant codes under a class that is not closed.
pub fn learning(method: &Method, alignment: &Alignment) -> Result<(Pose, Learning), ServiceError> {
    let &Method::Sparse {
        atoms,
        lambda,
        nonzeros,
        codes,
        nonnegative,
        normalise,
        seed,
        max_epochs,
        tolerance,
        schedule,
    } = method
    else {
        return Err(ServiceError::Internal("components are not learnt by sparse coding".into()));
    };
    let (pose, algebra) = match (codes, alignment) {
        (Codes::Aligned, _) => (Pose::Aligned { normalise }, Algebra::numbers()),
        (Codes::Invariant, Alignment::Projection(class)) => {
            let algebra = Algebra::of(class)
                .map_err(|error| ServiceError::invalid("/method/codes", error.to_string()))?;
            (Pose::Invariant(algebra.clone()), algebra)
        }
        (Codes::Invariant, Alignment::Procrustes(_)) => {
            let detail = "invariant codes require a linear class and \"alignment\": \"projection\"";
            return Err(ServiceError::invalid("/method/codes", detail));
        }
    };
    let coder = match (lambda, nonzeros) {
        (None, nonzeros) => Coder::Pursuit(Pursuit { nonzeros: nonzeros.unwrap_or(1) }),
        (Some(lambda), _) if algebra.parameters() == 1 => Coder::Lasso(Lasso::new(lambda, nonnegative)),
        (Some(lambda), _) => Coder::GroupLasso(GroupLasso::new(lambda)),
    };
    Ok((pose, Learning { atoms, coder, algebra, schedule, seed, max_epochs, tolerance }))
}
