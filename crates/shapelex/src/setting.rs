//! Treatment of shapes before they are compared, with a default for everything.

use std::sync::Arc;

use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::defaults::PERMUTATIONS;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::recipe::{self, Recipe};
use shapelex_analysis::factors::Estimator;
use shapelex_analysis::inference::aligned::{StudySpace, frame_for};
use shapelex_analysis::tangent::LinearAlignment;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::representation::{Representation, ShapeSpace};

use crate::error::{Error, Result};

/// Treatment of shapes before they are compared. The class names the differences that do not count; everything else has a default.
///
/// ```
/// use shapelex::{Class, Mirror, Setting};
///
/// let mut setting = Setting::new(Class::Similarity);
/// setting.mirror = Mirror::Allow;
/// setting.permutations = 499;
/// assert!(!setting.robust);
/// // A class alone is a setting where one is expected.
/// assert_eq!(Setting::from(Class::Rigid).class, Class::Rigid);
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Setting {
    /// The class of transformations that is removed. Default: [`ClassName::Similarity`], position, size and rotation.
    pub class: ClassName,
    /// How it is removed. Default: projection in closed form; Procrustes fits where the class is not a linear space; in space, tests and
    /// components in the tangent space take [`Alignment::PartialProcrustes`].
    pub alignment: Option<Alignment>,
    /// How the points of two shapes correspond. Default: start points of contours are searched, all other points correspond by their
    /// order.
    pub correspondence: Option<Correspondence>,
    /// Whether the direction of a contour counts. Default: it does not where the start point is searched.
    pub direction: Option<Direction>,
    /// Whether a shape may be compared by its mirror image. Default: it may not.
    pub mirror: Mirror,
    /// Whether shapes unlike the majority are left out of means and models; tests refuse it. Default: false.
    pub robust: bool,
    /// Number of permutations of a test. Default: 1000.
    pub permutations: usize,
    /// Seed of random numbers. Default: 0.
    pub seed: u64,
}

impl Setting {
    /// The defaults for a class.
    pub fn new(class: ClassName) -> Self {
        Self {
            class,
            alignment: None,
            correspondence: None,
            direction: None,
            mirror: Mirror::Forbid,
            robust: false,
            permutations: PERMUTATIONS,
            seed: 0,
        }
    }
}

impl Default for Setting {
    fn default() -> Self {
        Self::new(ClassName::Similarity)
    }
}

impl From<ClassName> for Setting {
    fn from(class: ClassName) -> Self {
        Self::new(class)
    }
}

impl From<&Setting> for Setting {
    fn from(setting: &Setting) -> Self {
        setting.clone()
    }
}

/// A setting that is prepared for shapes of one representation.
#[derive(Debug)]
pub(crate) struct Prepared {
    pub(crate) recipe: Recipe,
    pub(crate) setting: recipe::Setting,
    /// The setting as it was given.
    pub(crate) given: Setting,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean.
    tangent: bool,
}

/// Aim of an alignment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Aim {
    /// A mean, or a dictionary.
    Mean,
    /// A test of groups or of an attribute.
    Test,
}

impl Prepared {
    /// Prepares a setting for shapes that usually correspond in this way.
    pub(crate) fn new(
        given: Setting,
        representation: Representation,
        correspondence: Correspondence,
        (aim, method): (Aim, Method),
    ) -> Result<Arc<Self>> {
        let (transformation, dimension) = (Transformation::Named(given.class), representation.dimension());
        let correspondence = given.correspondence.unwrap_or(correspondence);
        if let Some(detail) = correspondence.fault(representation.domain()) {
            return Err(Error::Setting { field: "correspondence", detail: detail.into() });
        }
        if let Some(detail) = given.mirror.fault(representation.domain()) {
            return Err(Error::Setting { field: "mirror", detail: detail.into() });
        }
        let usual = || Alignment::usual(&transformation, dimension);
        let (alignment, tangent) = match aim {
            Aim::Mean => (given.alignment.unwrap_or_else(usual), false),
            Aim::Test => {
                let chosen = LinearAlignment::of_test(&transformation, dimension, given.alignment, None)?;
                (chosen.alignment, chosen.tangent)
            }
        };
        let direction = given.direction.unwrap_or_else(|| Direction::usual(correspondence, &representation));
        let recipe = Recipe {
            correspondence,
            direction,
            mirror: given.mirror,
            alignment,
            estimator: if given.robust { Estimator::Robust } else { Estimator::Plain },
            held_out_seed: given.seed,
            ..Recipe::new(representation, transformation, method)
        };
        let setting = recipe.setting()?;
        Ok(Arc::new(Self { recipe, setting, given, tangent }))
    }

    pub(crate) fn space(&self) -> &ShapeSpace {
        &self.setting.space
    }

    pub(crate) fn dimension(&self) -> usize {
        self.recipe.representation.dimension()
    }

    /// The space of a test.
    pub(crate) fn study(&self) -> StudySpace<'_> {
        StudySpace {
            space: &self.setting.space,
            metric: &self.setting.metric,
            method: &self.setting.method,
            tangent: self.tangent,
            frame: frame_for(&self.recipe.transformation),
            matching: &self.setting.matching,
        }
    }
}
