//! Prepared spaces of subdivision surfaces: their operators take far longer to make than the shapes of a request to answer.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use crate::geometry::GeometryError;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::subdivision::basis::SubdivisionBasis;

/// Bytes of all spaces that are kept.
const MOST_BYTES: usize = 512 << 20;

/// Spaces that were asked for lately, the last one first, as far as there is room.
#[derive(Debug, Default)]
pub struct SpaceCache {
    spaces: Mutex<VecDeque<ShapeSpace>>,
}

impl SpaceCache {
    /// The space of `representation`, as it was made before or new. Two requests at once may both make it; they make the same.
    ///
    /// # Errors
    /// Those of [`ShapeSpace::new`].
    pub fn find_or_make(&self, representation: &Representation) -> Result<ShapeSpace, GeometryError> {
        if representation.subdivision().is_none() {
            return ShapeSpace::new(representation);
        }
        if let Some(space) = self.take(representation) {
            self.keep(space.clone());
            return Ok(space);
        }
        let space = ShapeSpace::new(representation)?;
        self.keep(space.clone());
        Ok(space)
    }

    fn take(&self, representation: &Representation) -> Option<ShapeSpace> {
        let mut spaces = self.spaces.lock().unwrap_or_else(PoisonError::into_inner);
        let place = spaces.iter().position(|space| space.representation() == representation)?;
        spaces.remove(place)
    }

    fn keep(&self, space: ShapeSpace) {
        let mut spaces = self.spaces.lock().unwrap_or_else(PoisonError::into_inner);
        spaces.retain(|other| other.representation() != space.representation());
        spaces.push_front(space);
        let mut room = MOST_BYTES;
        spaces.retain(|space| {
            let bytes = space.subdivision().map_or(0, SubdivisionBasis::bytes);
            let kept = bytes <= room;
            room = room.saturating_sub(bytes);
            kept
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn a_space_is_made_once() {
        let read = |level: usize| -> Representation {
            let text = format!(
                r#"{{"kind":"subdivision","scheme":"loop","level":{level},"connectivity":"octahedron"}}"#
            );
            serde_json::from_str(&text).unwrap()
        };
        let cache = SpaceCache::default();
        let first = cache.find_or_make(&read(2)).unwrap();
        cache.find_or_make(&read(3)).unwrap();
        let again = cache.find_or_make(&read(2)).unwrap();
        assert!(Arc::ptr_eq(first.gram(), again.gram()));
        assert_eq!(cache.spaces.lock().unwrap().len(), 2);
    }
}
