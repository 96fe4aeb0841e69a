//! Names of the shapes of a request, by which their results are recognised.

use super::read::is_text;
use crate::domain::shape::Shape;
use crate::wire::checked::Checked;
use crate::wire::shape::ShapeInput;

/// Names of an input shape.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct InputNames {
    /// Id of a stored shape.
    pub id: Option<String>,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
}

impl InputNames {
    /// Names of posted shapes; an external id that is not valid is left out.
    pub fn of_posted(shapes: &[ShapeInput]) -> Vec<Self> {
        let names = |shape| Self { id: None, external_id: external_id(shape).map(str::to_owned) };
        shapes.iter().map(names).collect()
    }

    /// Names of a stored shape.
    pub fn of_stored(shape: &Shape) -> Self {
        Self { id: Some(shape.id.clone()), external_id: shape.attributes.external_id.clone() }
    }
}

/// External id of a posted shape, if it has a valid one.
pub(crate) fn external_id(shape: &ShapeInput) -> Option<&str> {
    let text = shape.external_id.as_ref().and_then(Checked::get)?.as_deref()?;
    is_text(text).then_some(text)
}
