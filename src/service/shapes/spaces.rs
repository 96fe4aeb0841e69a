//! Shape spaces with their operators. Spaces of subdivision surfaces are cached, because preparing them takes far
//! longer than answering a request. Of the others, those of the last requests are kept: preparing one is a third of the
//! work on a small shape.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hashlink::LruCache;

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

/// Number of other spaces that are kept.
const RECENT: usize = 64;
/// Maximum number of control points of a space that is kept: a few hundred kilobytes.
const RECENT_POINTS: usize = 1024;

/// Spaces of the last requests, except those in the cache.
#[derive(Debug)]
struct Recent(Mutex<LruCache<Representation, ShapeSpace>>);

impl Default for Recent {
    fn default() -> Self {
        Self(Mutex::new(LruCache::new(RECENT)))
    }
}

impl Recent {
    fn locked(&self) -> MutexGuard<'_, LruCache<Representation, ShapeSpace>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The space of `representation`, kept or new.
    fn space(&self, representation: &Representation) -> Result<ShapeSpace, GeometryError> {
        if representation.size() > RECENT_POINTS {
            return ShapeSpace::new(representation);
        }
        if let Some(known) = self.locked().get(representation) {
            return Ok(known.clone());
        }
        let space = ShapeSpace::new(representation)?;
        self.locked().insert(representation.clone(), space.clone());
        Ok(space)
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
        let prepared = match ShapeSpace::is_costly(representation) {
            true => cached(&self.cache, representation),
            false => self.state::<Recent>().space(representation),
        };
        prepared.map_err(|error| {
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
fn cached(cache: &Cache, representation: &Representation) -> Result<ShapeSpace, GeometryError> {
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
    fn the_spaces_of_the_last_requests_are_kept() {
        let read = |points: usize| -> Representation {
            let text = format!(
                r#"{{"kind":"closed_curve","dimension":2,"control_points":{points},"generator":{{"name":"cubic"}}}}"#
            );
            serde_json::from_str(&text).unwrap()
        };
        let recent = Recent::default();
        let space = |points: usize| recent.space(&read(points)).unwrap();
        let first = space(12);
        assert!(Arc::ptr_eq(first.gram(), space(12).gram()));
        let large = space(RECENT_POINTS + 1);
        assert!(!Arc::ptr_eq(large.gram(), space(RECENT_POINTS + 1).gram()), "too large to be kept");
        (20..20 + RECENT).for_each(|points| drop(space(points)));
        assert!(!Arc::ptr_eq(first.gram(), space(12).gram()), "{RECENT} others have come since");
    }

    #[test]
    fn a_space_is_made_once() {
        let read = |level: usize| -> Representation {
            let text = format!(
                r#"{{"kind":"subdivision","scheme":"loop","level":{level},"connectivity":"octahedron"}}"#
            );
            serde_json::from_str(&text).unwrap()
        };
        let cache = Cache::new(usize::MAX, std::time::Duration::from_secs(600));
        let first = cached(&cache, &read(2)).unwrap();
        cached(&cache, &read(3)).unwrap();
        let again = cached(&cache, &read(2)).unwrap();
        assert!(Arc::ptr_eq(first.gram(), again.gram()));
        assert!(cache.has::<ShapeSpace>("", &read(3)));
    }
}
