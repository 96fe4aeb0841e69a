//! The parts of a revision, and the metric of its shapes.

use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::partial_sums::Measured;
use shapelex_analysis::preparation::{Pose, Preparation};
use shapelex_analysis::transformation::Transformation;
use shapelex_geometry::representation::ShapeSpace;

use crate::EngineError;
use crate::cohort::manifest::Manifest;
use crate::cohort::part::{Expected, Numbers};
use crate::cohort::part_path;
use crate::objects::Objects;

/// A revision whose parts can be read.
#[derive(Debug)]
pub struct Revision {
    objects: Objects,
    manifest: Manifest,
    digest: String,
    width: usize,
}

impl Revision {
    /// Opens a revision: reads its manifest.
    ///
    /// # Errors
    /// As [`Manifest::read`].
    pub async fn open(objects: Objects, id: &str, revision: u64) -> Result<Self, EngineError> {
        let (manifest, digest) = Manifest::read(&objects, id, revision).await?;
        let width = manifest.cohort.width()?;
        Ok(Self { objects, manifest, digest, width })
    }

    /// Its manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Its digest.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        self.manifest.parts.len()
    }

    /// Number of shapes.
    pub fn shapes(&self) -> usize {
        self.manifest.cohort.shape_count as usize
    }

    /// Number of coordinates of a shape.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Where its objects are.
    pub(crate) fn objects(&self) -> &Objects {
        &self.objects
    }

    /// Numbers of the part `k`, and its lists with these names.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] unless length, digest and counts are those of the manifest; errors of the store.
    pub async fn read(&self, k: usize, lists: &[&'static str]) -> Result<Numbers, EngineError> {
        let part = self.manifest.parts.get(k).ok_or_else(|| {
            let detail = format!("expected a part below {}, got {k}", self.parts());
            EngineError::refused(format!("revision of '{}'", self.manifest.cohort.id), detail)
        })?;
        let bytes = self.manifest.read_part(&self.objects, k).await?;
        let object = part_path(&self.manifest.cohort.id, &part.digest)?.to_string();
        Expected { number: k, shapes: part.shapes as usize, width: self.width }.decode(&object, bytes, lists)
    }
}

/// Metric and alignment of shapes.
#[derive(Debug)]
pub struct Setting {
    /// Class of transformations that is removed.
    pub transformation: Transformation,
    /// The alignment that was asked for.
    pub alignment: Option<Alignment>,
    /// The alignment that is used: the usual one of the class, unless another one was asked for.
    pub chosen: Alignment,
    /// The metric of the representation.
    pub metric: Metric,
    /// Projection or Procrustes.
    pub method: Method,
    /// Start points, directions, mirror images.
    pub matching: Matching,
}

impl Setting {
    /// Prepares the space of a cohort.
    ///
    /// # Errors
    /// A class that does not suit the shapes, a space that cannot be prepared.
    pub fn new(
        manifest: &Manifest,
        transformation: &Transformation,
        alignment: Option<Alignment>,
    ) -> Result<Self, EngineError> {
        let cohort = &manifest.cohort;
        let dimension = cohort.representation.dimension();
        let chosen = alignment.unwrap_or_else(|| Alignment::usual(transformation, dimension));
        let method = Method::new(transformation, chosen, dimension)?;
        let space = ShapeSpace::new(&cohort.representation)?;
        let matching = Matching::new(&space, cohort.correspondence, cohort.direction, cohort.mirror)
            .translating(method.translates());
        let metric = Metric::of(&space);
        Ok(Self { transformation: transformation.clone(), alignment, chosen, metric, method, matching })
    }

    /// The shapes of a part, prepared.
    ///
    /// # Errors
    /// A degenerate shape, with its position in the part.
    pub(crate) fn shapes(&self, numbers: Numbers) -> Result<ShapesInMemory, EngineError> {
        let Numbers { control_points, weights, .. } = numbers;
        Ok(ShapesInMemory::new(&self.metric, self.method.translates(), control_points, weights)?)
    }

    /// Prepares shapes for alignment to a whitened mean, and to unit norm if `normalise`.
    pub fn aligned_to(&self, mean: &[f64], normalise: bool) -> Preparation {
        Preparation {
            metric: self.metric.clone(),
            method: self.method.clone(),
            matching: self.matching.clone(),
            mean: mean.to_vec(),
            pose: Pose::Aligned { normalise },
        }
    }

    /// The same as the analysis takes it.
    pub fn measured(&self) -> Measured<'_> {
        Measured { metric: &self.metric, method: &self.method, matching: &self.matching }
    }
}
