//! Results of studies of symmetry as records.

use crate::models::records::{ResidualRecord, TermRecord, TotalRecord};

/// Kind of symmetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum SymmetryKind {
    /// Shapes that have a plane of symmetry in themselves: each beside its own image.
    Object,
    /// Left shapes beside mirrored right ones.
    Matching,
}

/// The best plane of reflection of a shape.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PlaneRecord {
    /// Unit normal; the plane passes through the mean position.
    pub normal: Vec<f64>,
    /// Direction of the axis in the plane, degrees from 0 to 180; null in space.
    pub axis_degrees: Option<f64>,
    /// Correlation of the shape with its image.
    pub correlation: f64,
    /// `‖c − S c‖/(2 ‖c‖)`: length of the asymmetric part of a shape of unit size.
    pub asymmetry: f64,
    /// `‖c + S c‖/(2 ‖c‖)`: length of the symmetric part.
    pub symmetric_part: f64,
}

/// A plane of a closed curve without markings.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CurvePlaneRecord {
    /// Point `n` of the curve has point `shift − n` as its image.
    pub shift: usize,
    /// Parameters at which the plane crosses the curve, to a fraction of the spacing of the points.
    pub crossings: [f64; 2],
    /// The plane.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub plane: PlaneRecord,
}

/// Symmetry of a sample.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SymmetryRecord {
    /// The table.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub table: SymmetryTable,
    /// Mean of the sides: the average of the aligned shapes.
    pub average: Vec<Vec<f64>>,
    /// Plane of the average in its frame; null for matching symmetry, whose sides have none.
    pub plane: Option<PlaneRecord>,
    /// Left minus mirrored right, averaged over the individuals.
    pub directional: DirectionalRecord,
    /// Indices of each individual.
    pub individuals: Vec<AsymmetryRecord>,
    /// Where the sides differ, along the average.
    pub map: Vec<AsymmetryPoint>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Analysis of variance of individuals and sides.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SymmetryTable {
    /// Individual, side (directional asymmetry), individual × side (fluctuating asymmetry). The first two are tested against the third,
    /// on the averages of the replicates; the third against the replicates, and not without them.
    pub terms: Vec<SymmetryTerm>,
    /// Replicates; null without any.
    pub residual: Option<ResidualRecord>,
    /// Degrees of freedom of the replicates in the space of shapes.
    pub residual_df_shape: Option<usize>,
    /// Squared distances of the shapes from their mean.
    pub total: TotalRecord,
}

/// A term of the table.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SymmetryTerm {
    /// The row.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub row: TermRecord,
    /// Degrees of freedom times the dimensions of shapes in which the term acts, for parametric F of isotropic errors: the symmetric ones
    /// for individuals and the asymmetric ones for sides of object symmetry, all for matching symmetry. Null for classes and shapes
    /// whose dimensions are not known.
    pub df_shape: Option<usize>,
}

/// Directional asymmetry.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DirectionalRecord {
    /// Length in the norm of the shapes.
    pub norm: f64,
    /// Displacements of the control points, left minus mirrored right.
    pub shape: Vec<Vec<f64>>,
}

/// Asymmetry of an individual, `a`: left minus mirrored right, each the average of its replicates.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AsymmetryRecord {
    /// The individual.
    pub individual: String,
    /// `‖a‖`.
    pub unsigned: f64,
    /// `‖a − ā‖`, about directional asymmetry `ā`.
    pub fluctuating: f64,
    /// `⟨a, ā⟩/‖ā‖`; null without directional asymmetry.
    pub signed: Option<f64>,
    /// `unsigned` without the contribution of the error of the replicates, in squares, at least 0; null without
    /// replicates.
    pub unsigned_corrected: Option<f64>,
    /// `fluctuating` without the contribution of the error of the replicates, in squares, at least 0; null without
    /// replicates.
    pub fluctuating_corrected: Option<f64>,
    /// `‖a(t)‖` at the places of the map; absent unless asked for.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub map: Option<Vec<f64>>,
}

/// Asymmetry at a place along the average.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AsymmetryPoint {
    /// Parameter `u` on curves; index of a landmark; on surfaces the index `k n_v + l` on the grid of knots.
    pub parameter: f64,
    /// Parameters `u` and `v` on surfaces.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub surface_parameters: Option<[f64; 2]>,
    /// Point on the average.
    pub point: Vec<f64>,
    /// `‖ā(t)‖`: length of the directional asymmetry.
    pub directional: f64,
    /// Root of the mean of `‖a(t) − ā(t)‖²` over the individuals.
    pub fluctuating: f64,
}
