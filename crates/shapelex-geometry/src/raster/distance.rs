//! Distances between the surface cells of two masks: an exact Euclidean distance transform.

use rayon::prelude::*;
use shapelex_numeric::bounded::Stop;

use super::grid::Mask;

/// No cell on the line.
const FAR: u32 = u32::MAX;

/// Maximum number of minima on a line that are searched one by one. Most lines meet a surface twice; skipping their
/// envelopes reduces the time for the overlap of two balls to three quarters.
const FEW: usize = 4;

/// A box of cells.
pub(super) struct Window {
    first: [usize; 3],
    size: [usize; 3],
    spacing: [f64; 3],
}

impl Window {
    /// Bounding box of the cells of two masks; `None` if both are empty.
    pub(super) fn around(a: &Mask, b: &Mask) -> Option<Self> {
        let [rows, columns, length] = a.grid.size;
        let (mut first, mut last) = ([usize::MAX; 3], [0; 3]);
        for row in 0..rows * columns {
            let ray = row * length..(row + 1) * length;
            let mut ray = a.inside[ray.clone()].iter().zip(&b.inside[ray]).map(|(a, b)| *a || *b);
            let Some(from) = ray.position(|inside| inside) else { continue };
            let to = ray.rposition(|inside| inside).map_or(from, |beyond| from + 1 + beyond);
            let (i, j) = (row / columns, row % columns);
            first = std::array::from_fn(|axis| first[axis].min([i, j, from][axis]));
            last = std::array::from_fn(|axis| last[axis].max([i, j, to][axis]));
        }
        let size = |axis: usize| last[axis] - first[axis] + 1;
        (first[0] < usize::MAX).then(|| Self {
            first,
            size: std::array::from_fn(size),
            spacing: a.grid.spacing,
        })
    }

    /// The surface cells of a mask that lies within the window.
    pub(super) fn surface(&self, mask: &Mask) -> Vec<bool> {
        let ([i, j, k], [rows, columns, length]) = (self.first, self.size);
        let ray = |row: usize| {
            let (i, j) = (i + row / columns, j + row % columns);
            (k..k + length).map(move |k| mask.is_surface([i, j, k]))
        };
        (0..rows * columns).into_par_iter().flat_map_iter(ray).collect()
    }

    /// Distances from the cells in `from` to the nearest cell in `to`, which must not be empty.
    ///
    /// ```text
    /// D²(i, j, k) = min_{j'} s₁²(j − j')² + min_{k'} s₂²(k − k')² + min_{i'} s₀²(i − i')² + 0 if (i', j', k') ∈ to, else ∞
    /// ```
    ///
    /// Exact Euclidean distance transform, one axis after the other, `O(cells)`. Along the first axis, steps to the nearest cell are
    /// counted; then every layer across it is finished on its own, so that memory is 4 bytes per cell and 8 per cell of one layer and
    /// thread. The last step is only done for the cells in `from`.
    ///
    /// # Source
    /// Felzenszwalb, Huttenlocher 2012, Distance transforms of sampled functions, sections 2 and 2.1.
    pub(super) fn distances(&self, from: &[bool], to: &[bool], stop: Stop<'_>) -> Vec<f64> {
        let [layers, rows, columns] = self.size;
        let layer = rows * columns;
        let steps = steps(to, layer);
        // In units of the largest spacing, squares cannot overflow.
        let unit = self.spacing.into_iter().fold(0.0, f64::max);
        let weights = self.spacing.map(|spacing| (spacing / unit).powi(2).max(f64::MIN_POSITIVE));
        let of_layer = |envelope: &mut Envelope, i: usize| -> Vec<f64> {
            let cells = i * layer..(i + 1) * layer;
            let (from, steps) = (&from[cells.clone()], &steps[cells]);
            // The incomplete result is discarded.
            if stop() || !from.contains(&true) {
                return Vec::new();
            }
            let mut field: Vec<f64> = steps.iter().map(|steps| square(*steps, weights[0])).collect();
            field.chunks_mut(columns).for_each(|line| envelope.lower(line, weights[2]));
            let (mut line, mut squares) = (vec![0.0; rows], Vec::new());
            for k in 0..columns {
                let asked: Vec<usize> = (0..rows).filter(|j| from[j * columns + k]).collect();
                if asked.is_empty() {
                    continue;
                }
                (0..rows).for_each(|j| line[j] = field[j * columns + k]);
                if asked.len() <= FEW {
                    squares.extend(asked.into_iter().map(|j| lowest(&line, j, weights[1])));
                } else {
                    envelope.lower(&mut line, weights[1]);
                    squares.extend(asked.into_iter().map(|j| line[j]));
                }
            }
            squares.into_iter().map(|square| unit * square.sqrt()).collect()
        };
        // Collected in the order of the layers, so that the result does not depend on threads.
        (0..layers).into_par_iter().map_init(Envelope::default, of_layer).flatten_iter().collect()
    }
}

/// For every cell the number of steps along the first axis to the nearest cell in `to`, or [`FAR`]. `layer`: cells of a layer.
fn steps(to: &[bool], layer: usize) -> Vec<u32> {
    let mut steps: Vec<u32> = to.iter().map(|to| if *to { 0 } else { FAR }).collect();
    for at in layer..steps.len() {
        steps[at] = steps[at].min(steps[at - layer].saturating_add(1));
    }
    for at in (layer..steps.len()).rev() {
        steps[at - layer] = steps[at - layer].min(steps[at].saturating_add(1));
    }
    steps
}

/// `weight · steps²`; infinite without an end.
fn square(steps: u32, weight: f64) -> f64 {
    if steps == FAR { f64::INFINITY } else { weight * f64::from(steps).powi(2) }
}

/// `min_q f(q) + weight · (p − q)²`, from the nearest `q` outwards until the weight alone is larger.
fn lowest(line: &[f64], p: usize, weight: f64) -> f64 {
    let mut least = line[p];
    for distance in 1..line.len() {
        let added = weight * (distance as f64).powi(2);
        if added >= least {
            break;
        }
        let [below, above] = [p.checked_sub(distance), p.checked_add(distance)];
        for height in [below, above].into_iter().flatten().filter_map(|q| line.get(q)) {
            least = least.min(height + added);
        }
    }
    least
}

/// The lower envelope of parabolas of one width. It is reused between lines to save allocations.
#[derive(Default)]
struct Envelope {
    parabolas: Vec<Parabola>,
}

/// `height + weight · (x − apex)²`, the lowest parabola from `from` to the start of the next one.
struct Parabola {
    apex: f64,
    height: f64,
    from: f64,
}

impl Envelope {
    /// Replaces `f` by `min_q f(q) + weight · (p − q)²`, in place. Cost: each parabola is added once and removed at most
    /// once.
    fn lower(&mut self, line: &mut [f64], weight: f64) {
        self.parabolas.clear();
        for (q, height) in line.iter().copied().enumerate().filter(|(_, height)| height.is_finite()) {
            self.add(q as f64, height, weight);
        }
        let mut pieces = self.parabolas.iter().peekable();
        let Some(mut piece) = pieces.next() else { return };
        for (p, value) in line.iter_mut().enumerate() {
            let x = p as f64;
            while let Some(next) = pieces.next_if(|next| next.from <= x) {
                piece = next;
            }
            *value = piece.height + weight * (x - piece.apex).powi(2);
        }
    }

    /// Adds a parabola to the right of all others.
    fn add(&mut self, apex: f64, height: f64, weight: f64) {
        let mut from = f64::NEG_INFINITY;
        while let Some(last) = self.parabolas.last() {
            // h + w(x − q)² = h' + w(x − q')²  ⟺  x = (q + q')/2 + (h' − h)/2 / (w(q' − q))
            let middle = 0.5 * (last.apex + apex);
            let (rise, slope) = (0.5 * (height - last.height), weight * (apex - last.apex));
            if rise > slope * (last.from - middle) {
                from = middle + rise / slope;
                break;
            }
            self.parabolas.pop();
        }
        self.parabolas.push(Parabola { apex, height, from });
    }
}
