//! Answers about an image.

use std::collections::BTreeMap;

use serde::Serialize;

use super::contours::ComponentOutput;
use super::image::{Coordinates, ImageOutput};
use super::place::{self, MovedOutput, SharedOutput};
use crate::geometry::raster::{Mask, Overlap};
use crate::geometry::representation::Representation;
use crate::segmentation::energy::TermValue;
use crate::segmentation::run::{Outcome, Segmentation};
use crate::wire::shape::Points;

/// Value of a term of the energy; null for a shape on which it is not defined, such as two classes without an outside.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct TermOutput {
    /// Without its weight.
    value: Option<f64>,
    /// Times the weight.
    weighted: Option<f64>,
}

/// One run of a stage; a stage whose result is faulty runs again with more spacing and shorter steps.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct StageOutput {
    /// Position of the stage.
    pub(super) stage: usize,
    /// Number of iterations.
    pub(super) iterations: usize,
    /// Number of evaluations of the energy and its gradient.
    pub(super) evaluations: usize,
    /// Weight of the spacing term.
    pub(super) spacing: f64,
    /// Fault of the result: `folded`, `left_image` or `collapsed`.
    pub(super) fault: Option<&'static str>,
    /// Energy at the start and after every iteration, where asked for; without those of shapes on which a term is not defined.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) history: Vec<f64>,
}

/// Overlap with the truth, counted in the cells of the image.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct TruthOutput {
    /// `|A ∩ B|/|A ∪ B|`; 1 for two empty bodies.
    jaccard: f64,
    /// `2|A ∩ B|/(|A| + |B|)`; 1 for two empty bodies.
    dice: f64,
    /// Largest distance from the surface of one to that of the other, in the unit of the coordinates; null if one is empty.
    hausdorff: Option<f64>,
    /// 95th percentile of these distances from one to the other, the larger one of both directions.
    hausdorff_95: Option<f64>,
    /// Mean of these distances.
    mean_surface_distance: Option<f64>,
    /// Number of cells inside the shape and the truth.
    cells: [usize; 2],
}

/// Cells of an image: a mask as `POST /v1/overlap` takes it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct CellsOutput {
    /// Number of cells along x, y and, in space, z.
    size: Vec<usize>,
    /// Distances between neighbouring centres.
    spacing: Vec<f64>,
    /// Position of the first centre: the origin.
    first: Vec<f64>,
    /// Run lengths of cells outside, inside, outside, and so on, the last axis fastest; the first may be 0.
    runs: Vec<usize>,
}

impl CellsOutput {
    /// Runs of a mask whose last axis is fastest, with the spacing of an image of `axes` axes.
    pub(super) fn new(mask: &Mask, spacing: [f64; 3], axes: usize) -> Self {
        let (mut runs, mut current) = (vec![0], false);
        for inside in &mask.inside {
            if *inside != current {
                runs.push(0);
                current = *inside;
            }
            if let Some(run) = runs.last_mut() {
                *run += 1;
            }
        }
        let size = mask.grid.size[..axes].to_vec();
        Self { size, spacing: spacing[..axes].to_vec(), first: vec![0.0; axes], runs }
    }
}

/// A segmented object.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SegmentedOutput {
    /// Position of its initial shape.
    pub(super) index: usize,
    /// The shape, in the coordinates of the request.
    pub(super) control_points: Points,
    /// Its representation, where stages split the control mesh of the initial shape.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) representation: Option<Representation>,
    /// Whether the last stage converged.
    pub(super) converged: bool,
    /// Why the segmentation ended: `converged`, `limit`, `line_search` (no step decreases the energy: usual at the level of the
    /// noise), `left_object` (see `moved`), `folded`, `left_image` or `collapsed`. After the last three the shape is that of the
    /// stage before.
    pub(super) stop: &'static str,
    /// The result beside its initial shape.
    pub(super) moved: MovedOutput,
    /// Results of this request that cover some of the same cells.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) shared: Vec<SharedOutput>,
    /// Number of iterations of all stages.
    pub(super) iterations: usize,
    /// The terms of the energy at the result.
    pub(super) energies: BTreeMap<&'static str, TermOutput>,
    /// Runs of the stages.
    pub(super) stages: Vec<StageOutput>,
    /// Gradient of the energy with respect to the free points, where asked for: all control points, without those of a cylinder
    /// beyond its ends, which follow the free ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gradient: Option<Points>,
    /// Positions of the free points among `control_points`, one for each row of `gradient`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) gradient_rows: Option<Vec<usize>>,
    /// Overlap with the truth, where it was posted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) overlap: Option<TruthOutput>,
    /// Cells of the image inside the shape, where asked for, in the grid of its indices.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mask: Option<CellsOutput>,
    /// Component of the part `mask` where the object began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) component: Option<ComponentOutput>,
    /// Id of the dictionary of the prior that lies nearest to the result, where `dictionaries` names several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) chosen_dictionary: Option<String>,
    /// Limitations of the result.
    pub(super) warnings: Vec<String>,
}

impl SegmentedOutput {
    /// Whether the shape left its object, or is that of the stage before the one in which it folded, collapsed or left the image.
    pub(super) fn has_failed(&self) -> bool {
        let faults = [Outcome::Folded, Outcome::LeftImage, Outcome::Collapsed, Outcome::LeftObject];
        faults.into_iter().any(|fault| fault.name() == self.stop)
    }
}

/// Segmented objects of an image.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SegmentAnswer {
    /// The image.
    pub(super) image: ImageOutput,
    /// Coordinates of the shapes.
    pub(super) coordinates: Coordinates,
    /// One entry for each initial shape, in order.
    pub(super) results: Vec<SegmentedOutput>,
}

/// Value of a term, which is dimensionless, that may be rounding: where a shape begins far from all edges, sums of any sign are left.
const ROUNDING: f64 = 1e-6;

/// The value, if it is a number.
pub(super) fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Limitations of a result; `begun` are the terms at the initial shape, `size_factor` is that between its size and that of the result.
pub(super) fn warnings<const D: usize>(
    found: &Segmentation<D>,
    begun: &[TermValue],
    size_factor: f64,
) -> Vec<String> {
    let mut warnings = Vec::new();
    if found.outcome == Outcome::LeftObject {
        warnings.push(place::left(&found.moved, size_factor));
    }
    let fault = match found.outcome {
        Outcome::Folded => Some("folded"),
        Outcome::LeftImage => Some("left the image"),
        Outcome::Collapsed => Some("collapsed"),
        _ => None,
    };
    if let (Some(fault), Some(last)) = (fault, found.stages.last()) {
        let stage = last.stage;
        warnings.push(format!("the shape {fault} in stage {stage}: the shape before that stage is answered"));
    }
    let is_other =
        |term: &&TermValue| matches!(term.name, "contour" | "local_contrast") && term.value > ROUNDING;
    for term in begun.iter().filter(is_other) {
        warnings.push(format!(
            "the term {} is positive at the initial shape ({:.2e}), as for an object of the other polarity",
            term.name, term.value
        ));
    }
    warnings
}

impl From<TermValue> for TermOutput {
    fn from(TermValue { value, weighted, .. }: TermValue) -> Self {
        Self { value: finite(value), weighted: finite(weighted) }
    }
}

impl From<Overlap> for TruthOutput {
    fn from(overlap: Overlap) -> Self {
        let Overlap { jaccard, dice, hausdorff, hausdorff_95, mean_surface_distance, cells, .. } = overlap;
        Self { jaccard, dice, hausdorff, hausdorff_95, mean_surface_distance, cells }
    }
}
