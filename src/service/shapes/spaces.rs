//! Shape spaces with their operators. Spaces of subdivision surfaces are cached, because preparing them takes far
//! longer than answering a request.

use std::sync::Arc;

use super::read::admit;
use crate::geometry::GeometryError;
use crate::geometry::capability::domain::Admitted;
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
    /// The representation of a request, if it is within the limits.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] below `/representation`.
    pub fn admit(&self, representation: Representation) -> Result<Admitted, ServiceError> {
        admit(representation, &self.limits).map_err(|errors| ServiceError::below(errors, "/representation"))
    }

    /// Prepared space of a representation.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] below `/representation` if its shapes have no such space.
    pub fn space(&self, representation: &Admitted) -> Result<ShapeSpace, ServiceError> {
        prepared(&self.cache, representation).map_err(|error| {
            let field = representation.decisive_field(&error);
            ServiceError::invalid(format!("/representation/{field}"), error.to_string())
        })
    }

    /// Prepared space of a stored or computed representation, within the limits of this process.
    ///
    /// # Errors
    /// As [`Self::admit`] and [`Self::space`].
    pub fn space_of(&self, representation: &Representation) -> Result<ShapeSpace, ServiceError> {
        self.space(&self.admit(representation.clone())?)
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
