//! Models that are kept for predictions, without their shapes.
//!
//! A kept model holds the attributes as they occur, coefficients with `C⁻ᵀ`, and for bands the covariances `Σ(t)` of the residuals at places
//! and the changes of the coefficients there for residuals that were drawn anew:
//!
//! ```text
//! ŷ_0 = x_0 B̂,   h_0 = ‖C⁻ᵀ x_0ᵀ‖²,   ŷ*_0(t) − ŷ_0(t) = x_0 (B* − B̂)(t)
//! ```
//!
//! The changes are those of the bands of the model, so that the factor of a simultaneous band is the same; they are kept to seven digits.

use std::collections::BTreeMap;

use super::anova::{Model, Testing};
use super::bands::{Followed, Spread, factor_at};
use super::coefficients::Coefficients;
use super::error::ModelError;
use super::outcome::PredictionRecord;
use super::predictor::{Attributes, Predictor};
use super::records::At;
use super::resample::Functions;
use crate::inference::aligned::AlignedShapes;
use crate::metric::Metric;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

/// Most numbers of the changes of coefficients: 64 MiB. With more, fewer draws are kept.
pub const MAX_CHANGES: usize = 1 << 24;
/// Fewest draws of a quantile.
const FEWEST_DRAWS: usize = 99;

/// A model without its shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptModel {
    attributes: Attributes,
    /// With `inverse` and `aliases`.
    coefficients: Coefficients,
    bands: Option<KeptBands>,
}

/// Numbers behind bands.
#[derive(Debug, Clone, PartialEq)]
struct KeptBands {
    /// Coefficients at places, coordinate-major, one a column.
    at_places: Matrix,
    spread: Spread,
    /// Changes of these numbers, draw by draw.
    changes: Vec<f32>,
}

/// Sizes and attributes of a kept model, beside its numbers.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct KeptHead {
    attributes: Attributes,
    kept: Vec<usize>,
    left_out: Vec<usize>,
    length: usize,
    places: usize,
    dimension: usize,
    degrees: usize,
    draws: usize,
}

/// Number of draws of which a model of `columns` columns, `numbers` numbers at places each, keeps the changes.
pub fn kept_draws(permutations: usize, columns: usize, numbers: usize) -> usize {
    let most = MAX_CHANGES / columns.saturating_mul(numbers).max(1);
    let draws = permutations.min(most);
    if draws < FEWEST_DRAWS { 0 } else { draws }
}

impl KeptModel {
    /// Keeps a model. Models with random parts or a covariance of the shapes have no bands; shapes of blocks are not independent,
    /// and have no simultaneous ones. Shapes are followed at `samples` places along curves.
    ///
    /// Cost: `n q` multiply-adds for each number at the places and each draw.
    ///
    /// # Errors
    /// A design that is as good as singular; an end of the time.
    pub(super) fn new(
        model: &Model,
        (attributes, coefficients): (Attributes, Coefficients),
        (shapes, samples): (Option<&AlignedShapes<'_>>, usize),
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Self, ModelError> {
        let singular = || ModelError::Setting {
            field: "keep",
            detail:
                "expected a design whose coefficients can be told apart, got one that is as good as singular"
                    .into(),
        };
        let Some(inverse) = coefficients.inverse.clone() else { return Err(singular()) };
        if coefficients.aliases.is_none() {
            return Err(singular());
        }
        let has_bands = model.design.formula.random.is_empty() && !model.space.is_correlated();
        let bands = has_bands.then(|| {
            KeptBands::new(model, Functions::of_columns(model, inverse), (shapes, samples), testing, watch)
        });
        Ok(Self { attributes, coefficients, bands: bands.transpose()? })
    }

    /// Attributes of the model.
    pub fn attributes(&self) -> &Attributes {
        &self.attributes
    }

    /// Number of places at which predictions have bands.
    pub fn places(&self) -> usize {
        self.bands.as_ref().map_or(0, |bands| bands.spread.covariances.len())
    }

    /// Number of draws whose changes are kept.
    pub fn draws(&self) -> usize {
        self.bands.as_ref().map_or(0, KeptBands::draws)
    }

    /// Multiply-adds of so many predictions.
    pub fn cost(&self, predictions: usize, with_bands: bool) -> f64 {
        let changes = self.bands.as_ref().filter(|_| with_bands).map_or(0, |bands| bands.changes.len());
        predictions as f64 * (changes + self.coefficients.rows.len() + 1000) as f64
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        let of_bands = |bands: &KeptBands| 4 * bands.changes.len() + 8 * 3 * bands.at_places.len();
        let (columns, design) = (self.coefficients.kept.len(), self.attributes.design());
        let of_attributes = design.shapes() * (1 + design.variables.len()) + 16 * design.columns.len();
        let of_columns = columns * (columns + self.coefficients.left_out.len());
        8 * (self.coefficients.rows.len() + of_columns + of_attributes)
            + self.bands.as_ref().map_or(0, of_bands)
    }

    /// Predictions at values of attributes, with bands at `level`. `metric` is that of the shapes; none if numbers are modelled.
    ///
    /// Cost: as of [`Self::cost`].
    ///
    /// # Errors
    /// Unknown attributes and levels; values that the shapes do not determine; bands of a model that has none.
    pub fn predictions(
        &self,
        at: &[BTreeMap<String, At>],
        level: Option<f64>,
        metric: Option<&Metric>,
    ) -> Result<Vec<PredictionRecord>, ModelError> {
        let bands = match (level, &self.bands) {
            (None, _) => None,
            (Some(level), Some(bands)) => Some((level, bands)),
            (Some(_), None) => {
                let detail =
                    "expected none of a model with random parts or a covariance of the shapes, got a level";
                return Err(ModelError::Setting { field: "bands", detail: detail.into() });
            }
        };
        let Self { attributes, coefficients, .. } = self;
        let predictor = Predictor { attributes, coefficients, metric };
        let predict = |(k, at): (usize, &BTreeMap<String, At>)| {
            let (row, mut record) = predictor.predict(k, at)?;
            let kept = self.coefficients.of_kept(&row);
            record.band = bands.map(|(level, bands)| bands.at(&kept, record.leverage, level));
            Ok(record)
        };
        at.iter().enumerate().map(predict).collect()
    }

    /// The numbers, little-endian, beside the rest.
    pub fn to_parts(&self) -> (KeptHead, Vec<u8>) {
        let Coefficients { rows, kept, inverse, left_out, aliases } = &self.coefficients;
        let spread = self.bands.as_ref().map(|bands| &bands.spread);
        let head = KeptHead {
            attributes: self.attributes.clone(),
            kept: kept.clone(),
            left_out: left_out.clone(),
            length: rows.ncols(),
            places: self.places(),
            dimension: spread.map_or(1, |spread| spread.dimension),
            degrees: spread.map_or(0, |spread| spread.degrees),
            draws: self.draws(),
        };
        let matrices = [Some(rows), inverse.as_ref(), aliases.as_ref()].into_iter().flatten();
        let of_bands = self.bands.iter().flat_map(|bands| {
            bands.at_places.iter().chain(bands.spread.covariances.iter().flatten()).copied()
        });
        let numbers = matrices.flat_map(|matrix| matrix.iter().copied()).chain(of_bands);
        let mut bytes: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
        let changes = self.bands.iter().flat_map(|bands| &bands.changes);
        bytes.extend(changes.flat_map(|change| change.to_le_bytes()));
        (head, bytes)
    }

    /// The model of its parts; `None` if the bytes are not as many as the head says.
    pub fn of_parts(head: KeptHead, bytes: &[u8]) -> Option<Self> {
        let KeptHead { attributes, kept, left_out, length, places, dimension, degrees, draws } = head;
        let columns = kept.len();
        let mut rest = bytes;
        let mut take = |rows: usize, columns: usize| {
            let (own, others) = rest.split_at_checked(rows.checked_mul(columns)?.checked_mul(8)?)?;
            rest = others;
            let numbers = own.as_chunks::<8>().0.iter().map(|number| f64::from_le_bytes(*number));
            Some(Matrix::from_vec(rows, columns, numbers.collect()))
        };
        let (rows, inverse) = (take(columns, length)?, take(columns, columns)?);
        let aliases = take(columns, left_out.len())?;
        let entries = dimension.checked_add(1)?.checked_mul(dimension)? / 2;
        let (at_places, covariances) =
            (take(places.checked_mul(dimension)?, columns)?, take(entries, places)?);
        let changes: Vec<f32> =
            rest.as_chunks::<4>().0.iter().map(|number| f32::from_le_bytes(*number)).collect();
        if !rest.len().is_multiple_of(4) || Some(changes.len()) != at_places.len().checked_mul(draws) {
            return None;
        }
        let covariances = covariances.column_iter().map(|column| column.iter().copied().collect());
        let spread = Spread::new(covariances.collect(), dimension, degrees);
        let bands = (places > 0).then_some(KeptBands { at_places, spread, changes });
        let coefficients =
            Coefficients { rows, kept, inverse: Some(inverse), left_out, aliases: Some(aliases) };
        Some(Self { attributes, coefficients, bands })
    }
}

impl KeptBands {
    fn new(
        model: &Model,
        functions: Functions,
        (shapes, samples): (Option<&AlignedShapes<'_>>, usize),
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Self, ModelError> {
        let followed = Followed::new(shapes, samples);
        let at_places = followed.at(functions.vectors(model));
        let spread = model.spread(&followed);
        let draws = match testing.blocks {
            None => kept_draws(testing.permutations, at_places.ncols(), at_places.nrows()),
            Some(_) => 0,
        };
        let mut changes = Vec::new();
        if draws > 0 {
            let one = vec![0; model.design.shapes()];
            let strata = testing.strata.unwrap_or(&one);
            let drawn = followed.at(model.drawn_residuals(strata));
            let testing = Testing { permutations: draws, ..testing.clone() };
            let short = |changes: Matrix| changes.iter().map(|change| *change as f32).collect::<Vec<f32>>();
            changes.reserve_exact(draws * at_places.len());
            for own in model.redrawn((&functions, &drawn), strata, &testing, &short, watch)? {
                changes.extend(own);
            }
        }
        Ok(Self { at_places, spread, changes })
    }

    fn draws(&self) -> usize {
        self.changes.len() / self.at_places.len().max(1)
    }

    /// The band of a row of the kept columns.
    fn at(&self, row: &[f64], leverage: f64, level: f64) -> super::bands::BandRecord {
        let length = self.at_places.nrows();
        let points = sum_of(row, self.at_places.as_slice(), length);
        let draws = self.changes.chunks_exact(self.at_places.len().max(1));
        let largest = draws.map(|changes| self.spread.largest(leverage, &sum_of(row, changes, length)));
        self.spread.band(level, leverage, &points, factor_at(largest.collect(), level))
    }
}

/// `Σ_j x_j b_j` of vectors of `length` numbers, one after the other.
fn sum_of<T: Copy + Into<f64>>(row: &[f64], vectors: &[T], length: usize) -> Vec<f64> {
    let mut sum = vec![0.0; length];
    for (x, vector) in row.iter().zip(vectors.chunks_exact(length)).filter(|(x, _)| **x != 0.0) {
        sum.iter_mut().zip(vector).for_each(|(sum, value)| *sum += x * (*value).into());
    }
    sum
}
