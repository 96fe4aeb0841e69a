//! Shape spaces with their operators. Spaces of subdivision surfaces are cached, because preparing them takes far
//! longer than answering a request.

use std::sync::Arc;

use super::read::check_representation;
use crate::analysis::metric::Metric;
use crate::geometry::GeometryError;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::service::app::cache::{Cache, Cached};
use crate::service::app::{App, ServiceError};

impl Cached for ShapeSpace {
    const NAME: &'static str = "spaces";

    fn bytes(&self) -> usize {
        self.basis_bytes()
    }
}

impl App {
    /// Prepared space and metric of `representation`.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] below `pointer` if its sizes are out of bounds.
    pub fn space(
        &self,
        representation: &Representation,
        pointer: &str,
    ) -> Result<(ShapeSpace, Metric), ServiceError> {
        check_representation(representation, &self.limits)
            .map_err(|errors| ServiceError::below(errors, pointer))?;
        let space = prepared(&self.cache, representation).map_err(|error| {
            ServiceError::invalid(format!("{pointer}/{}", representation.decisive_field()), error.to_string())
        })?;
        let metric = Metric::of(&space);
        Ok((space, metric))
    }
}

/// Space of `representation`, cached or new. Two concurrent requests may both compute it, with the same result.
fn prepared(cache: &Cache, representation: &Representation) -> Result<ShapeSpace, GeometryError> {
    if !ShapeSpace::is_costly(representation) {
        return ShapeSpace::new(representation);
    }
    if let Some(known) = cache.find::<ShapeSpace>("", representation) {
        return Ok(ShapeSpace::clone(&known));
    }
    let space = Arc::new(ShapeSpace::new(representation)?);
    cache.keep("", representation, &space);
    Ok(ShapeSpace::clone(&space))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_space_is_made_once() {
        let read = |level: usize| -> Representation {
            let text = format!(
                r#"{{"kind":"subdivision","scheme":"loop","level":{level},"connectivity":"octahedron"}}"#
            );
            serde_json::from_str(&text).unwrap()
        };
        let cache = Cache::new(usize::MAX);
        let first = prepared(&cache, &read(2)).unwrap();
        prepared(&cache, &read(3)).unwrap();
        let again = prepared(&cache, &read(2)).unwrap();
        assert!(Arc::ptr_eq(first.gram(), again.gram()));
        assert!(cache.has::<ShapeSpace>("", &read(3)));
    }
}
