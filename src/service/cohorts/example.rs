//! Example cohort: outlines of real cells, loaded into an empty store.

use bytes::Bytes;
use futures_util::stream;

use super::{catalogue, upload};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::domain::cohort::CohortSpec;
use crate::service::app::{App, ServiceError};

/// Name of the example cohort.
pub const NAME: &str = "example-cells";

/// 120 outlines of mouse osteosarcoma cells (MIT licence, see `examples/cells/`).
const SHAPES: &str = include_str!("../../../examples/cells/cells.ndjson");

/// Loads the example if the store has no cohort.
///
/// # Errors
/// A failure of the store.
pub async fn load_into_empty(app: &App) -> Result<(), ServiceError> {
    let (cohorts, _) = catalogue::list(app, None, 2).await?;
    let cohort = match cohorts.as_slice() {
        [] => match catalogue::create(app, description()?).await {
            // Another replica that starts at the same time loads it.
            Err(ServiceError::NameTaken { .. }) => return Ok(()),
            created => created?,
        },
        // A process killed between the two steps has left the cohort empty.
        [only] if only.spec.name == NAME && only.revision == 0 => only.clone(),
        _ => return Ok(()),
    };
    let text = stream::iter([Ok::<_, ServiceError>(Bytes::from_static(SHAPES.as_bytes()))]);
    let stored = upload::add_stream(app, cohort, text, upload::Treatment::default(), None).await?;
    tracing::info!(shapes = stored.added, "loaded the example cohort into the empty store");
    Ok(())
}

/// Representation of the outlines, as in a request.
const REPRESENTATION: &str =
    r#"{"kind":"closed_curve","dimension":2,"control_points":100,"generator":{"name":"trigonometric"}}"#;

fn description() -> Result<CohortSpec, ServiceError> {
    Ok(CohortSpec {
        name: NAME.into(),
        description: Some("Outlines of mouse osteosarcoma cells of two lines under three treatments".into()),
        representation: serde_json::from_str(REPRESENTATION)
            .map_err(|error| ServiceError::Internal(error.to_string()))?,
        correspondence: Correspondence::Cyclic,
        direction: Direction::Either,
        mirror: Mirror::Forbid,
        length_unit: Some("pixel".into()),
    })
}
