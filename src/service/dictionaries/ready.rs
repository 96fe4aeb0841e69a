//! Dictionaries prepared for use, and cached: stored content with its space, metric, model and classifier.

use std::sync::Arc;

use crate::analysis::assessment::Assessor;
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::in_use::Dictionary;
use crate::analysis::factors::Estimator;
use crate::domain::dictionary::Listed;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::statistics::{CheckedSettings, Settings, Setup};

/// A dictionary prepared for use.
#[derive(Debug)]
pub struct Ready {
    /// Identity of the stored version.
    pub listed: Listed,
    /// Space, metric and class.
    pub setup: Setup,
    /// Content, model and classifier.
    pub assessor: Assessor,
}

impl Ready {
    /// Content and model.
    pub fn dictionary(&self) -> &Dictionary {
        &self.assessor.dictionary
    }
}

impl Cached for Ready {
    const NAME: &'static str = "dictionaries";

    fn bytes(&self) -> usize {
        // Atoms as stored, whitened and in the model, and their products; the shapes of a classifier need no more than
        // that.
        let (length, atoms) = (self.setup.metric.len(), self.dictionary().content.atoms.len());
        8 * (6 * length * (atoms + 2) + atoms * atoms) + self.setup.space.bytes()
    }
}

/// Finds a dictionary by id, `name@version`, `name@alias`, or name (the latest version), and prepares it for use.
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
    let (listed, content) = app.store.read_dictionary(&id).await?.ok_or_else(not_found)?.parts();
    let task_app = app.clone();
    let atoms = Counts::for_stored(&content.representation, content.atoms.len(), &app.limits);
    let work = requests::space(&content.representation, &app.limits) + requests::project(atoms);
    let ready = app
        .pool
        .weighing(work)
        .run(move || {
            let settings = settings(&content).checked(&task_app.limits)?;
            let (setup, dictionary) = prepare(&task_app, settings, content)?;
            Ok(Arc::new(Ready { listed, setup, assessor: Assessor::new(dictionary) }))
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
        estimator: Estimator::Plain,
    }
}

/// Prepares a content with its settings for use. Training and use start from the same stored numbers.
///
/// # Errors
/// [`ServiceError::Invalid`] if the parts are inconsistent (in an imported file).
pub fn prepare(
    app: &App,
    settings: CheckedSettings,
    content: Content,
) -> Result<(Setup, Dictionary), ServiceError> {
    let setup = Setup::new(app, settings)?;
    let dictionary = Dictionary::new(content, setup.measured())?;
    Ok((setup, dictionary))
}
