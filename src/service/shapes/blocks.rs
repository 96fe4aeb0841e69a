//! Shapes of several resolutions in a request: coarse control points, and blocks of finer ones.
//!
//! Sizes are checked before anything of that size is made: [`Layers`] of the factors that shapes name. The grids are prepared once for all
//! shapes of a request; each is then read, and brought to the finest grid where values are asked for
//! ([`Posted`](super::request::Posted)).

use crate::geometry::capability::domain::Admitted;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::resolution::{Block, GridFault, MAX_FACTOR, Resolutions};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::checked::{Checked, LARGE};
use crate::wire::fault::Fault;
use crate::wire::shape::{BlockInput, ShapeInput};

/// Maximum number of different resolutions in a request: each is a space.
const MAX_GRIDS: usize = 16;
/// Maximum number of blocks of a shape: each is refined to the finest grid.
const MAX_BLOCKS: usize = 64;

/// A finer grid of a request, with the place that names it.
#[derive(Debug, Clone)]
struct Named {
    factors: Vec<usize>,
    pointer: String,
}

/// Representation of the shapes of a request, with the grids of their blocks.
#[derive(Debug, Clone)]
pub struct Layers {
    coarse: Admitted,
    finest: Admitted,
    factors: Vec<usize>,
    grids: Vec<Named>,
    has_blocks: bool,
}

impl Layers {
    /// The grids that blocks of `shapes`, given with their pointers, name; and those of the request itself. Faults of the blocks
    /// themselves are found when they are read.
    ///
    /// # Errors
    /// Grids that are too many or too fine; blocks of shapes without parameters.
    pub fn new<'a>(
        app: &App,
        coarse: Admitted,
        shapes: impl IntoIterator<Item = (String, &'a ShapeInput)>,
        wanted: Option<(&[usize], &str)>,
    ) -> Result<Self, ServiceError> {
        let directions = coarse.knots().len();
        let has_parameters = coarse.domain().is_line() || coarse.domain().is_sheet();
        let (mut grids, mut has_blocks): (Vec<Named>, _) = (Vec::new(), false);
        let mut add = |factors: &[usize], pointer: String| {
            if grids.iter().all(|grid| grid.factors != factors) {
                grids.push(Named { factors: factors.to_vec(), pointer });
            }
        };
        if let Some((factors, pointer)) = wanted {
            add(factors, pointer.to_owned());
        }
        for (pointer, shape) in shapes {
            if !shape.has_blocks() {
                continue;
            }
            has_blocks = true;
            if !has_parameters {
                let detail = format!("expected no blocks: {} has no grid of knots", coarse.kind_name());
                return Err(ServiceError::invalid(format!("{pointer}/blocks"), detail));
            }
            for (j, block) in shape.blocks().iter().enumerate().take(MAX_BLOCKS) {
                if factor_faults(&block.factors, directions).is_empty() {
                    add(&block.factors, format!("{pointer}/blocks/{j}/factors"));
                }
            }
        }
        if let Some(grid) = grids.get(MAX_GRIDS) {
            let detail = format!(
                "expected at most {MAX_GRIDS} different resolutions in a request, got {}",
                grids.len()
            );
            return Err(ServiceError::invalid(&*grid.pointer, detail));
        }
        let factors = common_factors(directions, &grids)?;
        let finest = admit_finest(app, &coarse, &factors, &grids)?;
        Ok(Self { coarse, finest, factors, grids, has_blocks })
    }

    /// Of the shapes of a list `/shapes`.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn of_shapes(app: &App, coarse: Admitted, shapes: &[ShapeInput]) -> Result<Self, ServiceError> {
        Self::new(app, coarse, pointed(shapes), None)
    }

    /// The representation of the request.
    pub fn coarse(&self) -> &Admitted {
        &self.coarse
    }

    /// A representation as large as that of the finest grid.
    pub fn finest(&self) -> &Admitted {
        &self.finest
    }

    /// Factors of the finest grid, one per direction.
    pub fn factors(&self) -> &[usize] {
        &self.factors
    }

    /// Number of grids to prepare besides that of the request.
    pub fn count(&self) -> usize {
        self.grids.len()
    }

    /// Whether a shape has blocks.
    pub fn has_blocks(&self) -> bool {
        self.has_blocks
    }

    /// The grids; `None` if only that of the request is needed.
    ///
    /// # Errors
    /// A grid on which the shapes would be other functions, at the place that names it.
    pub(super) fn prepare(&self, coarse: &ShapeSpace) -> Result<Option<Resolutions>, ServiceError> {
        if self.grids.is_empty() && !self.has_blocks {
            return Ok(None);
        }
        let blocks = self.grids.iter().map(|grid| &*grid.factors);
        let prepared = Resolutions::new(coarse, blocks, &self.factors);
        prepared.map(Some).map_err(|GridFault { factors, error }| {
            let named = self.grids.iter().find(|grid| grid.factors == factors).or(self.grids.first());
            ServiceError::invalid(named.map_or("/shapes", |grid| &*grid.pointer), error.to_string())
        })
    }
}

/// Shapes with the pointers to them.
pub fn pointed(shapes: &[ShapeInput]) -> impl Iterator<Item = (String, &ShapeInput)> {
    shapes.iter().enumerate().map(|(index, shape)| (format!("/shapes/{index}"), shape))
}

/// The smallest factors that those of all grids divide.
///
/// # Errors
/// Factors beyond [`MAX_FACTOR`], at the grid that leads there.
fn common_factors(directions: usize, grids: &[Named]) -> Result<Vec<usize>, ServiceError> {
    let mut common = vec![1; directions];
    for grid in grids {
        for (common, factor) in common.iter_mut().zip(&grid.factors) {
            // Both are at most MAX_FACTOR.
            let multiple = (1..=*factor).map(|i| i * *common).find(|multiple| multiple % factor == 0);
            *common = multiple.unwrap_or(*common * factor);
            if *common > MAX_FACTOR {
                let detail = format!(
                    "expected factors of all blocks with a common multiple of at most {MAX_FACTOR}, got {common}"
                );
                return Err(ServiceError::invalid(&*grid.pointer, detail));
            }
        }
    }
    Ok(common)
}

/// The representation of the finest grid, within the limits.
fn admit_finest(
    app: &App,
    coarse: &Admitted,
    factors: &[usize],
    grids: &[Named],
) -> Result<Admitted, ServiceError> {
    let Some(largest) = grids.iter().max_by_key(|grid| grid.factors.iter().product::<usize>()) else {
        return Ok(coarse.clone());
    };
    app.admit(coarse.with_factors(factors)).map_err(|error| match error {
        ServiceError::Invalid(faults) => {
            let placed = |fault: Fault| {
                let detail = format!("{} on the finest grid", fault.detail);
                Fault { pointer: largest.pointer.clone(), detail, ..fault }
            };
            ServiceError::Invalid(faults.map(placed))
        }
        other => other,
    })
}

/// Faults of the factors of a grid, with pointers relative to the list.
fn factor_faults(factors: &[usize], directions: usize) -> Vec<Fault> {
    if factors.len() != directions {
        let detail = format!("expected one number per direction, {directions} in all, got {}", factors.len());
        return vec![Fault::new("", detail)];
    }
    let wild = factors.iter().enumerate().filter(|(_, factor)| !(1..=MAX_FACTOR).contains(*factor));
    let mut faults: Vec<Fault> = wild
        .map(|(i, factor)| {
            Fault::new(format!("/{i}"), format!("expected a number between 1 and {MAX_FACTOR}, got {factor}"))
        })
        .collect();
    if faults.is_empty() && factors.iter().all(|factor| *factor == 1) {
        faults.push(Fault::new("", "expected a factor of at least 2, got 1 along every direction"));
    }
    faults
}

/// The blocks of a shape, on prepared grids.
///
/// # Errors
/// All their faults, with pointers relative to the shape.
pub(super) fn read_blocks(
    blocks: Checked<Option<Vec<BlockInput>>, LARGE>,
    grids: &Resolutions,
) -> Result<Vec<Block>, Vec<Fault>> {
    let mut faults = Vec::new();
    let blocks = blocks.take("/blocks", &mut faults).flatten().unwrap_or_default();
    if blocks.len() > MAX_BLOCKS {
        faults.push(Fault::new(
            "/blocks",
            format!("expected at most {MAX_BLOCKS} blocks, got {}", blocks.len()),
        ));
        return Err(faults);
    }
    let mut read = Vec::with_capacity(blocks.len());
    for (j, block) in blocks.into_iter().enumerate() {
        let pointer = format!("/blocks/{j}");
        match read_block(block, grids) {
            Ok(block) => read.push(block),
            Err(found) => faults.extend(found.into_iter().map(|fault| fault.below(&pointer))),
        }
    }
    if faults.is_empty() { Ok(read) } else { Err(faults) }
}

fn read_block(block: BlockInput, grids: &Resolutions) -> Result<Block, Vec<Fault>> {
    let BlockInput { factors, indices, offsets, .. } = block;
    let representation = grids.coarse().representation();
    let below = |field: &'static str| move |fault: Fault| fault.below(field);
    let wrong = factor_faults(&factors, representation.knots().len()).into_iter();
    let mut faults: Vec<Fault> = wrong.map(below("/factors")).collect();
    if let Some(grid) = grids.grid(&factors) {
        faults.extend(index_fault(&indices, grid.size()).map(below("/indices")));
    }
    let (dimension, count) = (representation.dimension(), indices.len());
    match offsets.checked(dimension) {
        Err(found) => faults.extend(found.into_iter().map(below("/offsets"))),
        Ok(_) if offsets.len() != count || offsets.grid().is_some() => {
            let detail = format!("expected a list of {count} offsets, one per index, got {}", offsets.len());
            faults.push(Fault::new("/offsets", detail));
        }
        Ok(coordinates) if faults.is_empty() => {
            let offsets = Matrix::from_row_slice(count, dimension, coordinates);
            return Ok(Block { factors, indices, offsets });
        }
        Ok(_) => {}
    }
    Err(faults)
}

/// The first index that is not on a grid of `size` control points, or not after the one before it.
fn index_fault(indices: &[usize], size: usize) -> Option<Fault> {
    if let Some((i, index)) = indices.iter().enumerate().find(|(_, index)| **index >= size) {
        return Some(Fault::new(
            format!("/{i}"),
            format!("expected an index from 0 and below {size}, got {index}"),
        ));
    }
    let i = indices.windows(2).position(|pair| pair[1] <= pair[0])?;
    let detail = format!("expected ascending indices, got {} after {}", indices[i + 1], indices[i]);
    Some(Fault::new(format!("/{}", i + 1), detail))
}
