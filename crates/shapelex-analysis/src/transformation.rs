//! Transformation classes: the linear transformations that are factored out before shapes are compared.
//!
//! ```text
//! 𝓑 = span{B_1 … B_I} ⊂ R^{d×d}   (+ translation)      S_k = { B r_k + b : B ∈ 𝓑 }
//! ```
//!
//! The matrices generate the classes named; the printed Table 3.1 swaps entries of the shear and affine rows. Classes
//! with translation act on centred shapes, which is equivalent and keeps constants out of the statistics. Rotations and
//! similarities of space do not span a proper linear class (their span is all of `R^{3×3}`): they are available with
//! generalised Procrustes alignment only.

use super::AnalysisError;
use shapelex_numeric::dense::Matrix;

/// Name of a transformation class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum ClassName {
    /// Translation only: shapes keep their size and orientation, and are not reflected.
    Translation,
    /// One factor for all axes; it may be negative.
    UniformScaling,
    /// Uniform scaling and translation.
    UniformScalingTranslation,
    /// One factor per axis.
    NonUniformScaling,
    /// One factor per axis, and translation.
    NonUniformScalingTranslation,
    /// Rotation and uniform scaling, in the plane.
    ScaledRotation,
    /// Rotation, uniform scaling and translation, in the plane. In space with Procrustes alignment only.
    Similarity,
    /// All linear maps.
    Linear,
    /// All linear maps, and translation.
    Affine,
    /// Shear along x and uniform scaling, in the plane.
    HorizontalShear,
    /// Shear along x, uniform scaling and translation, in the plane.
    HorizontalShearTranslation,
    /// Shear along y and uniform scaling, in the plane.
    VerticalShear,
    /// Shear along y, uniform scaling and translation, in the plane.
    VerticalShearTranslation,
    /// Reflection with rotation and scaling, in the plane.
    ReflectedScaledRotation,
    /// Reflection with rotation, scaling and translation, in the plane.
    ReflectedSimilarity,
    /// Rotation and translation; shapes keep their size. With Procrustes alignment only.
    Rigid,
}

/// Transformation class: the name of a class, or a list of matrices that span one.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(untagged))]
pub enum Transformation {
    /// One of the named classes.
    Named(ClassName),
    /// The class spanned by the given `d × d` matrices.
    Custom(CustomClass),
}

impl Transformation {
    /// Whether shapes that differ in size alone are the same shape modulo the class.
    pub fn removes_size(&self) -> bool {
        !matches!(self, Self::Named(ClassName::Rigid | ClassName::Translation))
    }
}

// Written by hand: the derived error for an untagged enum names neither the position nor the problem.
#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Transformation {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::Deserialize;
        use serde::de::value::{MapAccessDeserializer, StrDeserializer};

        struct ChoiceVisitor;
        impl<'de> serde::de::Visitor<'de> for ChoiceVisitor {
            type Value = Transformation;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of a class or {\"matrices\": …, \"translation\": …}")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Transformation, E> {
                ClassName::deserialize(StrDeserializer::new(name)).map(Transformation::Named)
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Transformation, A::Error> {
                CustomClass::deserialize(MapAccessDeserializer::new(map)).map(Transformation::Custom)
            }
        }
        deserializer.deserialize_any(ChoiceVisitor)
    }
}

/// Transformation class given by matrices that span it.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct CustomClass {
    /// Matrices that span the class: `d × d`, row by row, linearly independent.
    #[cfg_attr(feature = "schema", schema(example = json!([[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 0.0]]])))]
    pub matrices: Vec<Vec<Vec<f64>>>,
    /// Whether the class includes translations. Default: false.
    #[cfg_attr(feature = "serde", serde(default))]
    pub translation: bool,
}

impl ClassName {
    /// All names, in catalogue order.
    pub const ALL: [Self; 16] = [
        Self::Translation,
        Self::UniformScaling,
        Self::UniformScalingTranslation,
        Self::NonUniformScaling,
        Self::NonUniformScalingTranslation,
        Self::ScaledRotation,
        Self::Similarity,
        Self::Linear,
        Self::Affine,
        Self::HorizontalShear,
        Self::HorizontalShearTranslation,
        Self::VerticalShear,
        Self::VerticalShearTranslation,
        Self::ReflectedScaledRotation,
        Self::ReflectedSimilarity,
        Self::Rigid,
    ];

    /// The name as written in requests.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Translation => "translation",
            Self::UniformScaling => "uniform_scaling",
            Self::UniformScalingTranslation => "uniform_scaling_translation",
            Self::NonUniformScaling => "non_uniform_scaling",
            Self::NonUniformScalingTranslation => "non_uniform_scaling_translation",
            Self::ScaledRotation => "scaled_rotation",
            Self::Similarity => "similarity",
            Self::Linear => "linear",
            Self::Affine => "affine",
            Self::HorizontalShear => "horizontal_shear",
            Self::HorizontalShearTranslation => "horizontal_shear_translation",
            Self::VerticalShear => "vertical_shear",
            Self::VerticalShearTranslation => "vertical_shear_translation",
            Self::ReflectedScaledRotation => "reflected_scaled_rotation",
            Self::ReflectedSimilarity => "reflected_similarity",
            Self::Rigid => "rigid",
        }
    }

    /// Whether the class includes translations.
    pub fn translates(self) -> bool {
        use ClassName::*;
        match self {
            Translation
            | UniformScalingTranslation
            | NonUniformScalingTranslation
            | Similarity
            | Affine
            | HorizontalShearTranslation
            | VerticalShearTranslation
            | ReflectedSimilarity
            | Rigid => true,
            UniformScaling
            | NonUniformScaling
            | ScaledRotation
            | Linear
            | HorizontalShear
            | VerticalShear
            | ReflectedScaledRotation => false,
        }
    }

    /// Dimensions in which shapes can be projected onto the class.
    pub fn projection_dimensions(self) -> &'static [usize] {
        use ClassName::*;
        match self {
            Translation
            | UniformScaling
            | UniformScalingTranslation
            | NonUniformScaling
            | NonUniformScalingTranslation
            | Linear
            | Affine => &[2, 3],
            ScaledRotation
            | Similarity
            | HorizontalShear
            | HorizontalShearTranslation
            | VerticalShear
            | VerticalShearTranslation
            | ReflectedScaledRotation
            | ReflectedSimilarity => &[2],
            Rigid => &[],
        }
    }

    /// Whether the class supports generalised Procrustes alignment.
    pub fn procrustes(self) -> bool {
        matches!(self, Self::Similarity | Self::Rigid)
    }
}

/// Decomposition of the projector of a class.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Structure {
    /// `P = I_d ⊗ P'`: all coordinates share the span of the `d` coordinate functions.
    PerCoordinate,
    /// Every axis is a separate scalar problem.
    PerAxis,
    /// `S = C·y` with `y = B_1 r` and `B_2 = J B_1`, where `J` is the quarter turn: one unit vector represents both.
    Complex,
    /// No structure: the span of `vec(B_i r)`.
    General,
}

/// A validated class in dimension `d`.
#[derive(Debug, Clone, PartialEq)]
pub struct TransformationClass {
    name: Option<ClassName>,
    dimension: usize,
    matrices: Vec<Matrix>,
    translation: bool,
    pub(super) structure: Structure,
}

impl TransformationClass {
    /// The class given by `transformation` in dimension `d`, for projection.
    ///
    /// # Errors
    /// [`AnalysisError::NotAProperClass`] if the class does not exist in this dimension or is not linear, or if its
    /// matrices have the wrong shape or are linearly dependent.
    pub fn new(transformation: &Transformation, dimension: usize) -> Result<Self, AnalysisError> {
        match transformation {
            Transformation::Named(name) => Self::named(*name, dimension),
            Transformation::Custom(custom) => Self::custom(custom, dimension),
        }
    }

    /// A named class.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn named(name: ClassName, dimension: usize) -> Result<Self, AnalysisError> {
        if !name.projection_dimensions().contains(&dimension) {
            return Err(AnalysisError::NotAProperClass(improper(name, dimension)));
        }
        let structure = match name {
            ClassName::Linear | ClassName::Affine => Structure::PerCoordinate,
            ClassName::NonUniformScaling | ClassName::NonUniformScalingTranslation => Structure::PerAxis,
            ClassName::ScaledRotation
            | ClassName::Similarity
            | ClassName::ReflectedScaledRotation
            | ClassName::ReflectedSimilarity => Structure::Complex,
            _ => Structure::General,
        };
        let matrices = basis(name, dimension);
        Ok(Self { name: Some(name), dimension, matrices, translation: name.translates(), structure })
    }

    fn custom(custom: &CustomClass, d: usize) -> Result<Self, AnalysisError> {
        let refuse = |why: String| Err(AnalysisError::NotAProperClass(why));
        if custom.matrices.is_empty() || custom.matrices.len() > d * d {
            return refuse(format!(
                "expected between 1 and {1} matrices, got {0}",
                custom.matrices.len(),
                d * d
            ));
        }
        if let Some(bad) =
            custom.matrices.iter().position(|m| m.len() != d || m.iter().any(|row| row.len() != d))
        {
            return refuse(format!("expected matrices of {d} × {d} numbers, matrix {bad} is not"));
        }
        let matrices: Vec<Matrix> =
            custom.matrices.iter().map(|rows| Matrix::from_fn(d, d, |i, j| rows[i][j])).collect();
        if let Some(bad) = matrices.iter().position(|m| !m.iter().all(|v| v.is_finite() && v.abs() <= 1e100))
        {
            return refuse(format!("expected entries within ±1e100, matrix {bad} has one beyond"));
        }
        let columns = Matrix::from_fn(d * d, matrices.len(), |i, j| {
            matrices[j].as_slice()[i] / matrices[j].norm().max(f64::MIN_POSITIVE)
        });
        let singular = columns.singular_values();
        let ratio = singular.min() / singular.max();
        if !(ratio > super::DEGENERATE) {
            return refuse(format!(
                "the matrices are linearly dependent: relative singular value {ratio:.1e}"
            ));
        }
        let translation = custom.translation;
        Ok(Self { name: None, dimension: d, matrices, translation, structure: Structure::General })
    }

    /// Whether shapes are rows of complex numbers under the class: similarities in the plane.
    pub(super) fn is_complex(&self) -> bool {
        self.structure == Structure::Complex
    }

    /// The same class without the use of structure: the reference for comparisons in tests.
    pub fn unstructured(&self) -> Self {
        Self { structure: Structure::General, ..self.clone() }
    }

    /// Name of the class. `None` if it was given by matrices.
    pub fn name(&self) -> Option<ClassName> {
        self.name
    }

    /// Label of the class for messages.
    pub fn label(&self) -> &'static str {
        self.name.map_or("the given matrices", ClassName::as_str)
    }

    /// Dimension of the points, `d`.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The matrices `B_1 … B_I`; empty for pure translation.
    pub fn matrices(&self) -> &[Matrix] {
        &self.matrices
    }

    /// Whether the class includes translations.
    pub fn translates(&self) -> bool {
        self.translation
    }
}

fn improper(name: ClassName, dimension: usize) -> String {
    let name_text = name.as_str();
    match (name, dimension) {
        (ClassName::Rigid, _) => {
            "rigid motions do not span a linear class: use \"alignment\": \"procrustes\"".into()
        }
        (ClassName::Similarity | ClassName::ScaledRotation, 3) => format!(
            "{name_text} is not a proper linear class in 3 dimensions (its span is all 3 × 3 matrices): \
             use \"alignment\": \"procrustes\" with similarity or rigid, or the class affine"
        ),
        _ => format!("{name_text} does not exist in {dimension} dimensions"),
    }
}

/// Table 3.1, corrected: `B_i` in the order of the columns of the projector's basis.
fn basis(name: ClassName, d: usize) -> Vec<Matrix> {
    use ClassName::*;
    let plane = |entries: [f64; 4]| Matrix::from_row_slice(2, 2, &entries);
    let unit = |i: usize, j: usize| Matrix::from_fn(d, d, |r, c| f64::from(r == i && c == j));
    match name {
        Translation | Rigid => Vec::new(),
        UniformScaling | UniformScalingTranslation => vec![Matrix::identity(d, d)],
        NonUniformScaling | NonUniformScalingTranslation => (0..d).map(|i| unit(i, i)).collect(),
        ScaledRotation | Similarity => vec![Matrix::identity(2, 2), plane([0.0, -1.0, 1.0, 0.0])],
        Linear | Affine => {
            (0..d).flat_map(|i| (0..d).map(move |j| (i, j))).map(|(i, j)| unit(i, j)).collect()
        }
        HorizontalShear | HorizontalShearTranslation => vec![Matrix::identity(2, 2), unit(0, 1)],
        VerticalShear | VerticalShearTranslation => vec![Matrix::identity(2, 2), unit(1, 0)],
        ReflectedScaledRotation | ReflectedSimilarity => {
            vec![plane([1.0, 0.0, 0.0, -1.0]), plane([0.0, 1.0, 1.0, 0.0])]
        }
    }
}
