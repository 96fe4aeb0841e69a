//! Shapes of several resolutions: control points of a coarse grid, and blocks of control points of finer grids in parts of the domain.
//!
//! ```text
//! σ(u, v) = Σ_k c[k] φ_k(u, v) + Σ_b Σ_{l ∈ L_b} o_b[l] β_{b,l}((u, v) + δ_b)
//! ```
//!
//! `β_b` are the basis functions of the grid that divides every interval of the coarse one into `m_b` (*factors*, one per direction), `L_b`
//! the control points of a block, `o_b` their offsets. All zero, they change no point of the shape; those of [`ParameterRegion`] change
//! it within a region only, because the supports of their basis functions lie in it. The coarse control points still move the whole, with
//! its details.
//!
//! Every grid has a two-scale relation to every finer one whose factors are multiples of its factors, so that such a shape *is* one of the
//! finest grid ([`Resolutions::flatten`]): evaluated, measured, drawn and stored as any other.
//!
//! * [`Finer`] — shapes of a space on a finer grid, exactly;
//! * [`ParameterRegion`] — the part of the domain of a block;
//! * [`Resolutions`] — the grids of the blocks of some shapes, up to the finest.
//!
//! Source: Schmitter, *Spline Shape Processing*, 6.3.3 and Fig. 6.8; the two-scale relations are (6.53)–(6.57).

mod finer;
mod region;

pub use finer::{Finer, MAX_FACTOR};
pub use region::ParameterRegion;

use crate::GeometryError;
use crate::influence::weights;
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Control points of a finer grid that are moved from where the coarse shape has them.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Numbers of parts of an interval of the coarse grid, one per direction.
    pub factors: Vec<usize>,
    /// Indices of the control points on the finer grid, in ascending order.
    pub indices: Vec<usize>,
    /// Their offsets, `L × d`, in the unit of the points.
    pub offsets: Matrix,
}

/// A shape with its blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct Detailed {
    /// Control points of the coarse grid, `N × d`.
    pub control_points: Matrix,
    /// Blocks of finer grids, in any order; their offsets add up.
    pub blocks: Vec<Block>,
}

/// A grid of blocks, and the way from it to the finest grid.
#[derive(Debug)]
struct Level {
    grid: Finer,
    rise: Finer,
}

/// A grid that shapes do not have.
#[derive(Debug, Clone, PartialEq)]
pub struct GridFault {
    /// Its factors.
    pub factors: Vec<usize>,
    /// The reason.
    pub error: GeometryError,
}

/// The grids of the blocks of some shapes, and a grid that refines them all.
#[derive(Debug)]
pub struct Resolutions {
    coarse: ShapeSpace,
    levels: Vec<Level>,
    finest: Finer,
}

impl Resolutions {
    /// Prepares blocks with these factors over shapes of `coarse`; `finest` is a multiple of all of them, direction by direction. Cost: a
    /// space per grid.
    ///
    /// # Errors
    /// The first grid with an error of [`Finer::new`].
    pub fn new<'b>(
        coarse: &ShapeSpace,
        blocks: impl IntoIterator<Item = &'b [usize]>,
        finest: &[usize],
    ) -> Result<Self, GridFault> {
        let grid_with = |factors: &[usize]| {
            Finer::new(coarse, factors).map_err(|error| GridFault { factors: factors.to_vec(), error })
        };
        let mut grids: Vec<Finer> = Vec::new();
        for factors in blocks {
            if grids.iter().all(|grid| grid.factors() != factors) {
                grids.push(grid_with(factors)?);
            }
        }
        let finest = grid_with(finest)?;
        let level = |grid: Finer| match grid.rise(&finest) {
            Ok(rise) => Ok(Level { grid, rise }),
            Err(error) => Err(GridFault { factors: grid.factors().to_vec(), error }),
        };
        let levels = grids.into_iter().map(level).collect::<Result<_, _>>()?;
        Ok(Self { coarse: coarse.clone(), levels, finest })
    }

    /// Shapes of `coarse` without blocks.
    pub fn uniform(coarse: &ShapeSpace) -> Self {
        let finest = Finer::same(coarse);
        Self { coarse: coarse.clone(), levels: Vec::new(), finest }
    }

    /// The space of the coarse control points.
    pub fn coarse(&self) -> &ShapeSpace {
        &self.coarse
    }

    /// The finest grid.
    pub fn finest(&self) -> &Finer {
        &self.finest
    }

    /// The grid with these factors, if it was given to [`Self::new`] as one of blocks.
    pub fn grid(&self, factors: &[usize]) -> Option<&Finer> {
        self.levels.iter().map(|level| &level.grid).find(|grid| grid.factors() == factors)
    }

    /// The grid of a block whose factors were given to [`Self::new`].
    pub fn grid_of(&self, block: &Block) -> &Finer {
        &self.level_of(block).grid
    }

    fn level_of(&self, block: &Block) -> &Level {
        let level = self.levels.iter().find(|level| level.grid.factors() == block.factors);
        level.expect("grids are prepared for the factors of all blocks")
    }

    /// The same shape by control points of the finest grid: `σ(u, v)` is the flat shape at `(u, v) + δ`, where `δ` are the
    /// [`shifts`](Finer::shifts) of the finest grid. Equal to rounding (tested to 3e-12 of the control points). Cost: the control points
    /// of the finest grid times the lengths of the filters, for the coarse shape and for every block.
    pub fn flatten(&self, shape: &Detailed) -> Matrix {
        let mut flat = self.finest.apply(&self.coarse, &shape.control_points);
        for block in &shape.blocks {
            let level = self.level_of(block);
            add_block(&mut flat, block, &level.grid, &level.rise);
        }
        flat
    }

    /// Places of the control points of a block, `L × d`: those of the coarse shape on the grid of the block, with the offsets of all
    /// blocks of `shape` whose grids it refines. Cost: as of [`Self::flatten`], to the grid of the block.
    ///
    /// # Errors
    /// As for [`Finer::new`].
    pub fn places(&self, shape: &Detailed, block: &Block) -> Result<Matrix, GeometryError> {
        let grid = self.grid_of(block);
        let mut flat = grid.apply(&self.coarse, &shape.control_points);
        let refines =
            |other: &&Block| other.factors.iter().zip(&block.factors).all(|(less, more)| more % less == 0);
        for other in shape.blocks.iter().filter(refines) {
            let from = self.grid_of(other);
            add_block(&mut flat, other, from, &from.rise(grid)?);
        }
        Ok(flat.select_rows(&block.indices))
    }

    /// Displacement by the blocks of a shape at a place of it, `d` numbers.
    pub fn detail_at(&self, blocks: &[Block], parameters: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; self.coarse.representation().dimension()];
        for block in blocks {
            let grid = self.grid_of(block);
            for (index, weight) in weights(grid.space(), &grid.parameters(parameters)) {
                let Ok(row) = block.indices.binary_search(&index) else { continue };
                let offset = block.offsets.row(row);
                sum.iter_mut().zip(offset.iter()).for_each(|(sum, offset)| *sum += weight * offset);
            }
        }
        sum
    }
}

/// Adds the offsets of a block on `grid` to the control points of a finer one, to which `rise` leads.
fn add_block(flat: &mut Matrix, block: &Block, grid: &Finer, rise: &Finer) {
    if block.offsets.iter().all(|offset| *offset == 0.0) {
        return;
    }
    let mut rows = Matrix::zeros(grid.size(), block.offsets.ncols());
    for (row, &index) in block.indices.iter().enumerate() {
        rows.row_mut(index).copy_from(&block.offsets.row(row));
    }
    *flat += rise.apply(grid.space(), &rows);
}
