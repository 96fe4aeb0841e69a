//! Symmetry of aligned shapes: table, indices of individuals, and where the sides differ.

use super::error::SymmetryError;
use super::plane::{best_plane, planes_of_curve, reversed};
use super::records::{
    AsymmetryPoint, AsymmetryRecord, CurvePlaneRecord, DirectionalRecord, PlaneRecord, SymmetryKind,
    SymmetryRecord, SymmetryTable,
};
use super::relabelling::Relabelling;
use super::sample::{Averages, Sides, SymmetryTesting, symmetry_table};
use crate::inference::aligned::{AlignedShapes, mean_warnings};
use crate::metric::norm;
use crate::transformation::{ClassName, Transformation};
use crate::watch::Watch;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// Directional asymmetry over the root mean square of the differences below which it has no direction.
const NO_DIRECTION: f64 = 1e-12;

/// Levels of the terms of object symmetry other than sides, in 2 000 null sets of `docs/evaluation.md`.
const LEVELS_OF_OBJECTS: &str = "object symmetry exchanges shapes and their images as if they were independent: at a level of 5 %, individuals \
    have p ≤ 0.05 in 11 % of null sets, and fluctuating asymmetry in none";

/// Question about aligned shapes.
#[derive(Debug, Clone, Copy)]
pub struct SymmetryQuestion<'a> {
    /// Kind of symmetry.
    pub kind: SymmetryKind,
    /// Individual and side of each aligned shape.
    pub sides: Sides<'a>,
    /// The relabelling of object symmetry.
    pub relabelling: Option<&'a Relabelling<'a>>,
    /// The class that was removed.
    pub transformation: &'a Transformation,
    /// Tests.
    pub testing: SymmetryTesting<'a>,
    /// Number of places along the shape ([`Places::along`]).
    pub samples: usize,
    /// Whether each individual has a map.
    pub maps: bool,
}

/// Symmetry of aligned shapes: of left shapes and mirrored right ones, or of shapes and their images ([`Relabelling::image`]). For object
/// symmetry the mean of shapes and images is symmetric.
///
/// Cost: that of [`symmetry_table`].
///
/// # Errors
/// Those of the table.
pub fn symmetry(
    shapes: &AlignedShapes<'_>,
    question: &SymmetryQuestion<'_>,
    watch: &dyn Watch,
) -> Result<SymmetryRecord, SymmetryError> {
    let (sides, metric) = (&question.sides, shapes.space.metric);
    let imaged = match question.relabelling {
        Some(relabelling) => Some(Imaged::new(shapes, relabelling)?),
        None => None,
    };
    let vectors = imaged.as_ref().map_or(&shapes.aligned, |imaged| &imaged.vectors);
    let averages = Averages::new(vectors, &shapes.weights, sides)?;
    let mut table = symmetry_table(vectors, &shapes.weights, sides, &averages, &question.testing, watch)?;
    let fixed = imaged.as_ref().map_or(Some(metric.size()), |imaged| imaged.fixed);
    set_dimensions(&mut table, question, metric.dimension(), metric.size(), fixed);
    let differences = averages.differences();
    let directional: Vec<f64> = differences.column_mean().iter().copied().collect();
    let noise = noise((vectors, &shapes.weights), question, &averages, &table);
    let average: Vec<f64> = averages.vectors.column_mean().iter().copied().collect();
    let places = Places::along(shapes.space.space, question.samples);
    let maps = Maps::new(shapes, &places, &differences, &directional);
    let mut warnings = mean_warnings(&shapes.mean);
    warnings.extend(table.terms.iter().filter(|term| term.row.distinct.is_some_and(|d| d < 20.0)).map(
        |term| {
            format!("{} has too few distinct exchanges for a p value: expected at least 20", term.row.term)
        },
    ));
    // Sides keep their level.
    let tested = |k: usize| table.terms.get(k).is_some_and(|term| term.row.p.is_some());
    if question.kind == SymmetryKind::Object && (tested(0) || tested(2)) {
        warnings.push(LEVELS_OF_OBJECTS.into());
    }
    Ok(SymmetryRecord {
        individuals: indices(sides.names, &differences, &directional, noise.as_deref(), |i| {
            question.maps.then(|| maps.individual(i))
        }),
        map: maps.points(shapes, &places, &average),
        plane: imaged.map(|imaged| imaged.plane),
        directional: DirectionalRecord { norm: norm(&directional), shape: metric.rows(&directional) },
        average: metric.rows(&average),
        table,
        warnings,
    })
}

/// Indices of differences, one a column; `noise` is the share of the error of replicates in the square of each. `map`: map of an individual.
pub fn indices(
    names: &[String],
    differences: &Matrix,
    directional: &[f64],
    noise: Option<&[f64]>,
    map: impl Fn(usize) -> Option<Vec<f64>>,
) -> Vec<AsymmetryRecord> {
    let length = norm(directional);
    let scale = (differences.norm_squared() / differences.ncols().max(1) as f64).sqrt();
    let of = |(i, name): (usize, &String)| {
        let own = differences.column(i);
        let about = own.iter().zip(directional).map(|(a, mean)| (a - mean).powi(2)).sum::<f64>();
        let along = own.iter().zip(directional).map(|(a, mean)| a * mean).sum::<f64>();
        let corrected = |squared: f64| noise.map(|noise| (squared - noise[i]).max(0.0).sqrt());
        AsymmetryRecord {
            individual: name.clone(),
            unsigned: own.norm(),
            fluctuating: about.sqrt(),
            signed: (length > NO_DIRECTION * scale).then(|| along / length),
            unsigned_corrected: corrected(own.norm_squared()),
            fluctuating_corrected: corrected(about),
            map: map(i),
        }
    };
    names.iter().enumerate().map(of).collect()
}

/// Share of the error of the replicates in the squared length of the difference of each individual; `None` without replicates.
fn noise(
    (vectors, shape_weights): (&Matrix, &[f64]),
    question: &SymmetryQuestion<'_>,
    averages: &Averages,
    table: &SymmetryTable,
) -> Option<Vec<f64>> {
    let (residual, weights, count) =
        (table.residual.as_ref()?, &averages.weights, question.sides.names.len());
    let Some(measured) = question.sides.measured else {
        return Some(
            (0..count)
                .map(|i| residual.mean_square * (1.0 / weights[2 * i] + 1.0 / weights[2 * i + 1]))
                .collect(),
        );
    };
    // A shape and its image share their error: differences of single measurements about those of their individual.
    let all = measured.len() / 2;
    let mut sum = 0.0;
    for k in 0..all {
        let i = question.sides.individual[k];
        let own = vectors.column(k) - vectors.column(all + k);
        let mean = averages.vectors.column(2 * i) - averages.vectors.column(2 * i + 1);
        sum += shape_weights[k] * (own - mean).norm_squared();
    }
    Some((0..count).map(|i| sum / (all - count) as f64 / weights[2 * i]).collect())
}

/// Degrees of freedom in the space of shapes.
fn set_dimensions(
    table: &mut SymmetryTable,
    question: &SymmetryQuestion<'_>,
    dimension: usize,
    size: usize,
    fixed: Option<usize>,
) {
    let Some([even, odd]) = fixed.and_then(|fixed| dimensions(question, dimension, [size, fixed])) else {
        return;
    };
    for (k, term) in table.terms.iter_mut().enumerate() {
        let own = match (question.kind, k) {
            (SymmetryKind::Matching, _) => even + odd,
            (SymmetryKind::Object, 0) => even,
            (SymmetryKind::Object, _) => odd,
        };
        term.df_shape = Some(term.row.degrees * own);
    }
    // A shape and its image are one measurement of both parts.
    let free = table.residual.as_ref().map(|residual| match question.kind {
        SymmetryKind::Matching => residual.degrees,
        SymmetryKind::Object => residual.degrees / 2,
    });
    table.residual_df_shape = free.map(|degrees| degrees * (even + odd));
}

/// Dimensions of the symmetric and the asymmetric part of shapes of `size` points, of which `fixed` stay; of matching symmetry only the
/// sum counts.
///
/// Source: Klingenberg, Barluenga and Meyer 2002, for similarity.
fn dimensions(question: &SymmetryQuestion<'_>, d: usize, [size, fixed]: [usize; 2]) -> Option<[usize; 2]> {
    let Transformation::Named(class) = question.transformation else { return None };
    // Those of the members of the class that commute with the reflection, and of the others.
    let (moves, turns) = ([d - 1, 1], [(d - 1) * d.saturating_sub(2) / 2, d - 1]);
    let class = match class {
        ClassName::Translation => moves,
        ClassName::Rigid => [0, 1].map(|i| moves[i] + turns[i]),
        ClassName::Similarity => [moves[0] + turns[0] + 1, moves[1] + turns[1]],
        ClassName::Affine => [moves[0] + (d - 1) * (d - 1) + 1, moves[1] + 2 * (d - 1)],
        _ => return None,
    };
    let pairs = (size - fixed) / 2;
    let own = [d * pairs + (d - 1) * fixed, d * pairs + fixed];
    Some([own[0].checked_sub(class[0])?, own[1].checked_sub(class[1])?])
}

/// Shapes and their images, with the plane of their average.
struct Imaged {
    /// Whitened shapes, then their images, one a column.
    vectors: Matrix,
    plane: PlaneRecord,
    /// Number of control points that stay; `None` where it is not known.
    fixed: Option<usize>,
}

impl Imaged {
    fn new(shapes: &AlignedShapes<'_>, relabelling: &Relabelling<'_>) -> Result<Self, SymmetryError> {
        let (metric, mut vectors) = (shapes.space.metric, shapes.aligned.clone());
        let (size, dimension) = (metric.size(), metric.dimension());
        if shapes.space.matching.shifts() && shapes.space.space.representation().is_closed() {
            let average = vectors.column_mean();
            let planes = planes_of_curve(average.as_slice(), dimension)?;
            let best = planes.first().ok_or(SymmetryError::NoExtent)?;
            reflect(&mut vectors, size, best);
            let average = vectors.column_mean();
            let image = reversed(average.as_slice(), size, best.shift);
            let fixed = if size % 2 == 1 { 1 } else { 2 * (1 - best.shift % 2) };
            return Ok(Self {
                plane: best_plane(average.as_slice(), &image, dimension)?,
                vectors,
                fixed: Some(fixed),
            });
        }
        let mut own: Vec<f64> = vectors.column_mean().iter().copied().collect();
        metric.unwhiten(&mut own);
        metric.centre(&mut own);
        let mut image = own.clone();
        image.chunks_exact_mut(size).for_each(|column| relabelling.relabel(column));
        metric.whiten(&mut own);
        metric.whiten(&mut image);
        Ok(Self { plane: best_plane(&own, &image, dimension)?, vectors, fixed: relabelling.fixed() })
    }
}

/// Replaces the images of closed curves by those in one plane from one start, which a search finds for each of them alone: so the average
/// is symmetric. Whitening commutes with reversals and shifts of closed curves.
fn reflect(vectors: &mut Matrix, size: usize, best: &CurvePlaneRecord) {
    let (count, normal) = (vectors.ncols() / 2, &best.plane.normal);
    for k in 0..count {
        let mut image = reversed(vectors.column(k).as_slice(), size, best.shift);
        for n in 0..size {
            let along: f64 = normal.iter().enumerate().map(|(c, x)| x * image[c * size + n]).sum();
            normal.iter().enumerate().for_each(|(c, x)| image[c * size + n] -= 2.0 * x * along);
        }
        vectors.column_mut(count + k).copy_from_slice(&image);
    }
}

/// Differences at places along the shape.
struct Maps {
    dimension: usize,
    /// One column for each individual, coordinate-major.
    differences: Matrix,
    directional: Vec<f64>,
}

impl Maps {
    fn new(shapes: &AlignedShapes<'_>, places: &Places, differences: &Matrix, directional: &[f64]) -> Self {
        let directional = Matrix::from_column_slice(directional.len(), 1, directional);
        Self {
            dimension: shapes.space.metric.dimension(),
            differences: shapes.points(differences, places),
            directional: shapes.points(&directional, places).as_slice().to_vec(),
        }
    }

    fn length(&self, at: impl Fn(usize) -> f64, place: usize) -> f64 {
        let count = self.directional.len() / self.dimension;
        (0..self.dimension).map(|c| at(c * count + place).powi(2)).sum::<f64>().sqrt()
    }

    fn individual(&self, i: usize) -> Vec<f64> {
        let count = self.directional.len() / self.dimension;
        (0..count).map(|place| self.length(|row| self.differences[(row, i)], place)).collect()
    }

    fn points(&self, shapes: &AlignedShapes<'_>, places: &Places, average: &[f64]) -> Vec<AsymmetryPoint> {
        let average = shapes.points(&Matrix::from_column_slice(average.len(), 1, average), places);
        let (count, individuals) = (places.count(), self.differences.ncols());
        let fluctuating = |place: usize| {
            let about = |i: usize| {
                self.length(|row| self.differences[(row, i)] - self.directional[row], place).powi(2)
            };
            ((0..individuals).map(about).sum::<f64>() / individuals as f64).sqrt()
        };
        (0..count)
            .map(|place| AsymmetryPoint {
                parameter: places.parameter(place),
                surface_parameters: places.surface_parameters(place),
                point: (0..self.dimension).map(|c| average[(c * count + place, 0)]).collect(),
                directional: self.length(|row| self.directional[row], place),
                fluctuating: fluctuating(place),
            })
            .collect()
    }
}
