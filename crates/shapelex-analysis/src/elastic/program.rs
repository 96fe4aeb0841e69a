//! The best path within a band around another one, by dynamic programming in single precision.
//!
//! ```text
//! V_{i+1}(t') = max_{0 ≤ b ≤ B} V_i(t' − b) + √(Σ_{cells from t' − b to t'} (w_i⁺)² h / M)
//! ```
//!
//! States are the ends of cells, `f` of which divide a segment. States run in lanes of a fixed width within the loop over `b`, where the
//! sums grow by one cell a step. A closed path is cut at a strip, where it keeps its place.

use shapelex_numeric::lanes::vectorised;

use super::Rotation;
use super::strips::Strips;

/// Numbers in a vector.
const LANES: usize = 8;

/// A band around a path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Band {
    /// `f`, cells of a segment: 1, 2 or 4.
    pub(super) cells: usize,
    /// States, a multiple of the lanes.
    pub(super) width: usize,
    /// `B`, cells of the longest step.
    pub(super) steps: usize,
}

/// Memory of programs.
#[derive(Debug, Default)]
pub(super) struct Work {
    /// `ε Oᵀ u_a` and `1 − ε`, a strip after the other.
    turned: Vec<[f32; 4]>,
    /// First state of every band, in cells.
    low: Vec<i32>,
    values: [Vec<f32>; 2],
    /// `(w⁺)² h / M` of segments, then of cells.
    squares: Vec<f32>,
    cells: Vec<f32>,
    /// Steps that led to the states.
    steps: Vec<[i32; LANES]>,
}

/// Replaces `path` by the best one within `band` around it, with the place at strip `cut` rounded to a cell. `cut` is 0 of open curves.
///
/// Cost: `M · width · (B + 1)` square roots.
pub(super) fn improve(
    strips: &Strips<'_>,
    path: &mut [f64],
    (rotation, cut): (&Rotation, usize),
    band: Band,
    work: &mut Work,
) {
    let count = strips.count();
    let grid = (band.cells * count) as f64;
    let at = |node: usize| path[node % count] + (node / count) as f64;
    let base = if strips.closed { at(cut).round() } else { 0.0 };
    work.turned.clear();
    work.turned.extend((0..count).map(|k| strips.turned((cut + k) % count, rotation).map(|x| x as f32)));
    let node = |k: usize| if strips.closed { at(cut + k) } else { path[k] };
    let centres: Vec<i32> = (0..=count).map(|k| nearest((node(k) - base) * grid)).collect();
    work.set_band(centres, band, grid as i32, strips.closed);
    vectorised(
        #[inline(always)]
        || forward(strips, band, work),
    );
    let mut state = band.width / 2;
    for k in (0..=count).rev() {
        let cell = work.low[k] + state as i32;
        let node = cut + k;
        if !strips.closed {
            path[k] = f64::from(cell) / grid;
        } else if k < count {
            path[node % count] = f64::from(cell) / grid + base - (node / count) as f64;
        }
        if k > 0 {
            let step = work.steps[(k - 1) * (band.width / LANES) + state / LANES][state % LANES];
            state = (cell - step - work.low[k - 1]) as usize;
        }
    }
    if strips.closed {
        // The path begins in the first turn.
        let turns = path[0].floor();
        path.iter_mut().for_each(|t| *t -= turns);
        path[count] = path[0] + 1.0;
    }
}

/// The nearest whole number, of numbers within a million: a call of the library takes longer.
fn nearest(x: f64) -> i32 {
    const ABOVE: i32 = 1 << 20;
    (x + f64::from(ABOVE) + 0.5) as i32 - ABOVE
}

impl Work {
    /// Bands around `centres`, which are moved until steps from one to the next are possible.
    fn set_band(&mut self, mut centres: Vec<i32>, band: Band, grid: i32, closed: bool) {
        let (last, most) = (centres.len() - 1, band.steps as i32);
        centres[0] = if closed { centres[0] } else { 0 };
        centres[last] = centres[0] + grid;
        for k in 1..last {
            centres[k] = centres[k].clamp(centres[k - 1], centres[k - 1] + most);
        }
        for k in (1..last).rev() {
            centres[k] = centres[k].clamp(centres[k + 1] - most, centres[k + 1]);
        }
        self.low.clear();
        self.low.extend(centres.into_iter().map(|centre| centre - (band.width / 2) as i32));
        let Band { cells, width, steps } = band;
        for values in &mut self.values {
            values.clear();
            values.resize(width + 2 * steps, f32::NEG_INFINITY);
        }
        self.values[0][steps + width / 2] = 0.0;
        let segments = ((width + steps) / cells + 2).next_multiple_of(LANES);
        self.squares.clear();
        self.squares.resize(segments, 0.0);
        self.cells.clear();
        self.cells.resize(segments * cells, 0.0);
        self.steps.clear();
        self.steps.resize(last * (width / LANES), [0; LANES]);
    }
}

/// Values of all states, one strip after the other.
#[inline(always)]
fn forward(strips: &Strips<'_>, band: Band, work: &mut Work) {
    let Band { cells, width, steps } = band;
    let count = strips.count();
    let grid = (cells * count) as i32;
    let Work { turned, low, values: [now, next], squares, cells: of_cells, steps: chosen } = work;
    for k in 0..count {
        let before = low[k + 1] - steps as i32;
        let first = before.div_euclid(cells as i32);
        fill_squares(strips, &turned[k], first, cells, squares);
        match cells {
            1 => spread::<1>(squares, of_cells),
            2 => spread::<2>(squares, of_cells),
            _ => spread::<4>(squares, of_cells),
        }
        let cells = &of_cells[(before - first * cells as i32) as usize..];
        let moved = (low[k + 1] - low[k]) as usize;
        for chunk in 0..width / LANES {
            // Without a step, nothing is added; every step takes in the cell before.
            let (mut best, mut step, mut sum) = ([0.0; LANES], [0; LANES], [0.0_f32; LANES]);
            let values = &now[chunk * LANES + moved..][..steps + LANES];
            best.copy_from_slice(&values[steps..]);
            let values = values[..steps + LANES - 1].array_windows::<LANES>();
            let cells = cells[chunk * LANES..][..steps + LANES - 1].array_windows::<LANES>();
            for (b, (values, cells)) in (1..).zip(values.zip(cells).rev()) {
                for l in 0..LANES {
                    sum[l] += cells[l];
                    let candidate = values[l] + sum[l].sqrt();
                    let better = candidate > best[l];
                    best[l] = if better { candidate } else { best[l] };
                    step[l] = if better { b } else { step[l] };
                }
            }
            if !strips.closed {
                for l in 0..LANES {
                    let place = low[k + 1] + (chunk * LANES + l) as i32;
                    best[l] = if place < 0 || place > grid { f32::NEG_INFINITY } else { best[l] };
                }
            }
            next[steps + chunk * LANES..][..LANES].copy_from_slice(&best);
            chosen[k * (width / LANES) + chunk] = step;
        }
        std::mem::swap(now, next);
    }
}

/// The values of segments for each of their `F` cells.
#[inline(always)]
fn spread<const F: usize>(squares: &[f32], cells: &mut [f32]) {
    cells.as_chunks_mut::<F>().0.iter_mut().zip(squares).for_each(|(cells, square)| *cells = [*square; F]);
}

/// `(w⁺)² h / M` of the segments from `first` on.
#[inline(always)]
fn fill_squares(strips: &Strips<'_>, turned: &[f32; 4], first: i32, cells: usize, squares: &mut [f32]) {
    let count = strips.count();
    let scale = ((cells * count * count) as f32).recip();
    let from = (first + strips.second.pad as i32) as usize;
    for (k, squares) in squares.chunks_exact_mut(LANES).enumerate() {
        let mut weights = [turned[3]; LANES];
        for c in 0..strips.second.dimension() {
            let column = &strips.second.column(c)[from + k * LANES..][..LANES];
            (0..LANES).for_each(|l| weights[l] += turned[c] * column[l]);
        }
        for l in 0..LANES {
            let positive = if weights[l] > 0.0 { weights[l] } else { 0.0 };
            squares[l] = scale * positive * positive;
        }
    }
}
