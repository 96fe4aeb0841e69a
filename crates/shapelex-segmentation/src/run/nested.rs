//! Models of one space of shapes and of the finer control meshes that stages split it into.

use shapelex_geometry::GeometryError;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::representation::{Representation, ShapeSpace};

use super::Level;
use crate::snake::Refined;
use crate::snake::kind::SpaceModel;

/// The model of a space, and those after each split of its control mesh.
pub struct Nested {
    model: SpaceModel,
    /// The finer models, with the maps from the control points before.
    finer: Vec<Refined<3>>,
    /// The representation of the last one.
    finest: Option<Representation>,
}

impl Nested {
    /// The models of a space after so many splits, as far as its representation has them.
    ///
    /// # Errors
    /// A fault of a field of the representation if its shapes enclose nothing; a control mesh without rules.
    pub fn new(space: &ShapeSpace, splits: usize) -> Result<Self, FieldFault> {
        let fault = |error: GeometryError| FieldFault::new("", error.to_string());
        let (model, mut finer, mut finest) = (SpaceModel::new(space)?, Vec::<Refined<3>>::new(), None);
        if let SpaceModel::Space(first) = &model {
            for _ in 0..splits {
                let before = finer.last().map_or(&**first, |(model, _)| &**model);
                let Some(next) = before.refined().map_err(fault)? else { break };
                finest = finest.as_ref().unwrap_or(space.representation()).split().map_err(fault)?;
                finer.push(next);
            }
        }
        Ok(Self { model, finer, finest })
    }

    /// The representation after all splits; `None` without any.
    pub fn finest(&self) -> Option<&Representation> {
        self.finest.as_ref()
    }

    /// The only level of shapes in the plane, for so many stages; `None` for shapes in space.
    pub fn in_plane(&self, stages: usize) -> Option<Vec<Level<'_, 2>>> {
        match &self.model {
            SpaceModel::Plane(model) => Some(vec![Level { model: &**model, step: None, stages }]),
            SpaceModel::Space(_) => None,
        }
    }

    /// The levels of shapes in space, for stages with so many splits before each; `None` for shapes in the plane.
    pub fn in_space(&self, splits: impl Iterator<Item = usize>) -> Option<Vec<Level<'_, 3>>> {
        let SpaceModel::Space(model) = &self.model else { return None };
        let first: Level<'_, 3> = Level { model: &**model, step: None, stages: 0 };
        let finer =
            self.finer.iter().map(|(model, step)| Level { model: &**model, step: Some(step), stages: 0 });
        let mut levels: Vec<Level<'_, 3>> = std::iter::once(first).chain(finer).collect();
        let mut at = 0;
        for splits in splits {
            at = (at + splits).min(levels.len() - 1);
            levels[at].stages += 1;
        }
        Some(levels)
    }
}
