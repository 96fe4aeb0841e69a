//! Search for the placements of planar shapes on their spectra.
//!
//! ```text
//! ẑ[f] = n^{−1/2} Σ_k z[k] e^{−2πi fk/n},   z = (x + iy)/‖(x, y)‖
//! score(s) = |⟨m, z_s⟩|² = |Σ_f conj(m̂[f]) ẑ[f] e^{2πi fs/n}|²     all s by one inverse transform
//! ```
//!
//! The transform is unitary and commutes with rotations and scalings, so sums of projectors and mean spaces of spectra are
//! those of the shapes, in other coordinates. A search reads the shapes once and keeps their spectra; each round then takes
//! one transform per shape and candidate.

use bytemuck::{cast_slice, cast_slice_mut};
use num_complex::Complex64;
use rand_distr::{Distribution, StandardNormal};

use super::AnalysisError;
use super::accumulate::{BLOCK, Leading, MATRIX_FREE, ShapeSource, ShapesInMemory};
use super::matching::{Matching, Moved, Placement, better, moved};
use super::mean::{Exchange, MeanSpace, ProjectorSum};
use super::metric::norm;
use super::placement_search::PlacementSearch;
use super::random::stream;
use super::subspace::Subspace;
use super::transformation::{Structure, TransformationClass};
use shapelex_numeric::fft::ComplexFft;
use shapelex_numeric::kernels::{
    add_scaled, add_split_multiple, multiply_conjugates, split_product, squared_norms,
};
use shapelex_numeric::lanczos::leading_vector;
use shapelex_numeric::parallel;

/// Shapes per task of a round.
const TASK: usize = 32;

/// Spectra of all shapes in every candidate direction and mirror image, and in their current placements.
pub(super) struct SpectralSearch<'a, 's> {
    /// The shapes, which count the work of every round.
    source: &'s dyn ShapeSource,
    /// Scaled rotations: the structure of the spectra of every class that is searched here.
    class: &'a TransformationClass,
    candidates: &'a [Placement],
    fft: ComplexFft,
    /// `e^{2πi j/n}`.
    phases: Vec<Complex64>,
    /// Spectra that start at the first row: shape by shape, a spectrum of `n` numbers for every candidate, each as a real and an
    /// imaginary part: zeros of this type come as untouched pages, which all threads then fill.
    spectra: Vec<f64>,
    /// Spectra in the current placements, as shapes: `n` real parts, then the imaginary parts.
    placed: ShapesInMemory,
    /// Number of shapes that are searched, the first ones.
    count: usize,
}

/// Memory of the spectra of `shapes` shapes in bytes.
pub(super) fn spectral_bytes(matching: &Matching, shapes: usize) -> usize {
    let per_shape = 16 * matching.size() * (matching.candidates().len() + 1) + 8;
    shapes.saturating_mul(per_shape)
}

/// Whether shapes of `class` can be searched on their spectra.
pub(super) fn is_spectral(class: &TransformationClass, matching: &Matching) -> bool {
    class.structure == Structure::Complex && matching.shifts()
}

impl<'a, 's> SpectralSearch<'a, 's> {
    /// Reads the shapes of `source`, which belong to `class` and stand in `placements`; `rotations` are the scaled rotations of
    /// the plane.
    ///
    /// # Errors
    /// Errors of the source; degenerate shapes.
    pub(super) fn new(
        source: &'s dyn ShapeSource,
        class: &TransformationClass,
        rotations: &'a TransformationClass,
        matching: &'a Matching,
        placements: &[Placement],
    ) -> Result<Self, AnalysisError> {
        let (n, candidates) = (matching.size(), matching.candidates());
        let phase = |j: usize| Complex64::cis(std::f64::consts::TAU * j as f64 / n as f64);
        let mut search = Self {
            source,
            class: rotations,
            candidates,
            fft: ComplexFft::new(n),
            phases: (0..n).map(phase).collect(),
            spectra: Vec::new(),
            placed: ShapesInMemory::prepared(Vec::new(), Vec::new()),
            count: source.count(),
        };
        let mut spectra = vec![0.0; 2 * source.count() * n * candidates.len()];
        let mut weights = Vec::with_capacity(source.count());
        source.for_each_batch(&mut |batch| {
            let write = |k: usize, spectra: &mut [Complex64]| {
                let mut scratch = search.fft.scratch();
                let mut rows =
                    batch.block(k, BLOCK).iter().zip(spectra.chunks_exact_mut(n * candidates.len()));
                rows.try_for_each(|((position, x, _), spectra)| {
                    for (&candidate, spectrum) in candidates.iter().zip(spectra.chunks_exact_mut(n)) {
                        write_spectrum(class, &matching.place(x, candidate), spectrum)
                            .map_err(|error| error.at(position))?;
                        search.fft.forward(spectrum, &mut scratch);
                    }
                    Ok::<_, AnalysisError>(())
                })
            };
            let spectra = &mut cast_slice_mut(&mut spectra)[weights.len() * n * candidates.len()..];
            let spectra = &mut spectra[..batch.weights.len() * n * candidates.len()];
            parallel::try_for_each_chunk(spectra, BLOCK * n * candidates.len(), &write)?;
            weights.extend_from_slice(batch.weights);
            Ok(())
        })?;
        search.spectra = spectra;
        let mut placed = vec![0.0; 2 * n * weights.len()];
        parallel::for_each_chunk(&mut placed, 2 * n, &|k, row| search.write_placed(k, placements[k], row));
        search.placed = ShapesInMemory::prepared(placed, weights);
        Ok(search)
    }

    /// `n`.
    fn size(&self) -> usize {
        self.phases.len()
    }

    /// Spectra of the shapes from `first` on.
    fn spectra_from(&self, first: usize) -> &[Complex64] {
        &cast_slice(&self.spectra)[first * self.size() * self.candidates.len()..]
    }

    /// Writes the spectrum of shape `k` in a placement: real parts, then imaginary parts.
    fn write_placed(&self, k: usize, placement: Placement, out: &mut [f64]) {
        let n = self.size();
        let of_shape = self.spectra_from(k);
        let candidate = self.candidates.iter().position(|c| c.is_image_of(placement)).unwrap_or(0);
        let (re, im) = out.split_at_mut(n);
        let mut phase = 0;
        for (f, value) in of_shape[candidate * n..(candidate + 1) * n].iter().enumerate() {
            let placed = value * self.phases[phase];
            (re[f], im[f]) = (placed.re, placed.im);
            phase = (phase + placement.shift as usize) % n;
        }
    }

    /// `Σ_k w_k z_k ⟨z_k, v⟩` over the spectra in their placements, real parts first. Blocks have sums that are added in order, so
    /// the bits are the same on any number of threads. `None` once reading should end.
    fn product(&self, v: &[f64]) -> Option<Vec<f64>> {
        self.source.check().ok()?;
        let (shapes, _) = self.placed.all().split_at(self.count);
        let sums = parallel::map(self.count.div_ceil(BLOCK), &|k| {
            let mut sum = vec![0.0; v.len()];
            for (_, z, weight) in shapes.block(k, BLOCK).iter() {
                let [re, im] = split_product(z, v);
                add_split_multiple(&mut sum, [weight * re, weight * im], z);
            }
            sum
        });
        let mut total = vec![0.0; v.len()];
        sums.iter().for_each(|sum| add_scaled(&mut total, 1.0, sum));
        Some(total)
    }

    /// A vector without structure: where the search for a mean space begins that none is near to.
    fn structureless(&self) -> Vec<f64> {
        let mut random = stream(0, 0);
        (0..2 * self.size()).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    /// Best placements of the shapes from `first` on for the spectrum `target`; `standing` are their current ones.
    fn best(&self, first: usize, target: &[Complex64], standing: &mut [Placement]) {
        let (n, of_shape) = (self.size(), self.size() * self.candidates.len());
        let spectra = &self.spectra_from(first)[..standing.len() * of_shape];
        let mut products = vec![Complex64::ZERO; spectra.len()];
        for (product, spectrum) in products.chunks_exact_mut(n).zip(spectra.chunks_exact(n)) {
            multiply_conjugates(product, target, spectrum);
        }
        self.fft.inverse(&mut products, &mut self.fft.scratch());
        let mut scores = vec![0.0; of_shape];
        for (placement, products) in standing.iter_mut().zip(products.chunks_exact(of_shape)) {
            squared_norms(&mut scores, products);
            *placement = better(self.candidates.iter().copied().zip(scores.chunks_exact(n)), *placement);
        }
    }
}

/// Writes `z` of the whitened shape `x`.
fn write_spectrum(
    class: &TransformationClass,
    x: &[f64],
    out: &mut [Complex64],
) -> Result<(), AnalysisError> {
    let n = out.len();
    let mut basis = vec![0.0; x.len()];
    Subspace::write_basis(class, x, (n as f64).sqrt().recip(), &mut basis)?;
    let (re, im) = basis.split_at(n);
    out.iter_mut().zip(re.iter().zip(im)).for_each(|(z, (&re, &im))| *z = Complex64::new(re, im));
    Ok(())
}

impl<'a> PlacementSearch<'a> for SpectralSearch<'a, '_> {
    fn restrict(&mut self, count: usize) {
        self.count = count;
    }

    fn sum(&self, _: &[Placement]) -> Result<ProjectorSum<'a>, AnalysisError> {
        let placed = Leading { source: &self.placed, count: self.count };
        let sum = ProjectorSum::of(&placed, self.class, 2 * self.size())?;
        self.source.worked(self.count);
        Ok(sum)
    }

    fn mean(&self, near: Option<&MeanSpace<'a>>) -> Result<Option<MeanSpace<'a>>, AnalysisError> {
        if self.size() < MATRIX_FREE {
            return Ok(None);
        }
        let start =
            near.map_or_else(|| self.structureless(), |space| space.bases[0].column(0).as_slice().to_vec());
        let vector = leading_vector(|v| self.product(v), &start);
        self.source.check()?;
        self.source.worked(self.count);
        vector.map(|vector| MeanSpace::from_shape(self.class, &vector)).transpose()
    }

    fn cosines(&self, space: &MeanSpace<'a>) -> Result<Vec<f64>, AnalysisError> {
        let cosine = |k: usize| {
            let spectrum = self.placed.shape(k);
            norm(&space.project(spectrum)) / norm(spectrum)
        };
        Ok(parallel::map(self.count, &cosine))
    }

    fn space_of(&self, position: usize, _: &[f64]) -> Result<MeanSpace<'a>, AnalysisError> {
        MeanSpace::from_shape(self.class, self.placed.shape(position))
    }

    fn improve(
        &mut self,
        space: &MeanSpace<'a>,
        placements: &mut [Placement],
    ) -> Result<Vec<Moved>, AnalysisError> {
        let n = self.size();
        let elements = space.elements();
        let (re, im) = elements.as_slice()[..2 * n].split_at(n);
        let target: Vec<Complex64> = re.iter().zip(im).map(|(&re, &im)| Complex64::new(re, im)).collect();
        let placements = &mut placements[..self.count];
        let mut improved = placements.to_vec();
        parallel::for_each_chunk(&mut improved, TASK, &|task, standing| {
            self.best(task * TASK, &target, standing);
            self.source.worked(standing.len());
        });
        let moved = moved(placements, &improved);
        let mut row = vec![0.0; 2 * n];
        for &(k, _) in &moved {
            self.write_placed(k, improved[k], &mut row);
            self.placed.replace(k, &row);
        }
        placements.copy_from_slice(&improved);
        Ok(moved)
    }

    fn exchanges(&self, _: &[Placement], moved: &[Moved]) -> Result<Vec<Exchange>, AnalysisError> {
        let n = 2 * self.size();
        let exchange = |i: usize| {
            let (k, before) = moved[i];
            let mut leaving = vec![0.0; n];
            self.write_placed(k, before, &mut leaving);
            let (arriving, weight) = (self.placed.shape(k).to_vec(), self.placed.all().weights[k]);
            Exchange { leaving, arriving, weight }
        };
        Ok(parallel::map(moved.len(), &exchange))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accumulate::PART;
    use crate::correspondence::{Correspondence, Direction, Mirror};
    use crate::metric::Metric;
    use crate::placement_search::{Start, StreamedSearch, alternate, stages};
    use crate::transformation::ClassName;
    use shapelex_geometry::generator::GeneratorKind;
    use shapelex_geometry::representation::{Representation, ShapeSpace};

    /// Contours of one family, each in a pose, from a start point and, every third one, mirrored.
    fn contours(count: usize, n: usize) -> Vec<f64> {
        let contour = |k: usize| {
            let (bump, turn, start) = (0.1 + 0.02 * k as f64, 0.7 * k as f64, 5 * k % n);
            let point = move |i: usize| {
                let t = std::f64::consts::TAU * ((i + start) % n) as f64 / n as f64;
                let r =
                    1.0 + 0.4 * (2.0 * t).cos() + bump * (3.0 * t + 0.3).sin() + 0.01 * (k as f64 * t).cos();
                let (x, y) = (r * t.cos(), if k % 3 == 2 { -r * t.sin() } else { r * t.sin() });
                [x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos()]
            };
            let column = move |c: usize| (0..n).map(move |i| point(i)[c]);
            column(0).chain(column(1)).collect::<Vec<f64>>()
        };
        (0..count).flat_map(contour).collect()
    }

    /// Spectra are other coordinates of the same search.
    #[test]
    fn spectra_are_placed_as_their_shapes() {
        let sizes = [
            (12, GeneratorKind::Trigonometric {}),
            (25, GeneratorKind::Cubic {}),
            // Without sums of projectors.
            (MATRIX_FREE, GeneratorKind::Trigonometric {}),
        ];
        for (n, generator) in sizes {
            let representation = Representation::ClosedCurve { dimension: 2, control_points: n, generator };
            let space = ShapeSpace::new(&representation).unwrap();
            let metric = Metric::of(&space);
            let weights: Vec<f64> = (0..40).map(|k| 1.0 + 0.5 * f64::from(k % 4)).collect();
            let source = ShapesInMemory::new(&metric, true, contours(40, n), weights).unwrap();
            let rotations = TransformationClass::named(ClassName::ScaledRotation, 2).unwrap();
            for mirror in [Mirror::Forbid, Mirror::Allow] {
                let matching = Matching::new(&space, Correspondence::Cyclic, Direction::Given, mirror);
                for name in [ClassName::Similarity, ClassName::ReflectedSimilarity] {
                    let class = TransformationClass::named(name, 2).unwrap();
                    assert!(is_spectral(&class, &matching));
                    let all = [source.count()];
                    let start = Start::of(&source, &all, &matching).unwrap();
                    let mut spectral =
                        SpectralSearch::new(&source, &class, &rotations, &matching, &start.placements)
                            .unwrap();
                    let found = alternate(&mut spectral, &source, &matching, &all, start.clone()).unwrap();
                    let mut streamed = StreamedSearch::new(&source, &class, &matching, metric.len());
                    let expected = alternate(&mut streamed, &source, &matching, &all, start).unwrap();
                    assert_eq!(found.placements, expected.placements, "{n} {mirror:?} {name:?}");
                    assert_eq!((found.rounds, found.converged), (expected.rounds, true));
                    let starts = found.placements.iter().filter(|placement| placement.shift > 0).count();
                    assert!(starts > 20, "the search has something to do: {starts}");
                }
            }
        }
    }

    /// The mean without the sum of the projectors is that of the sum, from any start, with the same bits on any number of threads.
    #[test]
    fn products_with_the_shapes_give_the_mean_of_their_sum() {
        let n = MATRIX_FREE + 3;
        let generator = GeneratorKind::Trigonometric {};
        let representation = Representation::ClosedCurve { dimension: 2, control_points: n, generator };
        let space = ShapeSpace::new(&representation).unwrap();
        let metric = Metric::of(&space);
        let weights: Vec<f64> = (0..300).map(|k| 1.0 + 0.5 * f64::from(k % 4)).collect();
        let source = ShapesInMemory::new(&metric, true, contours(300, n), weights).unwrap();
        let rotations = TransformationClass::named(ClassName::ScaledRotation, 2).unwrap();
        let class = TransformationClass::named(ClassName::Similarity, 2).unwrap();
        let matching = Matching::new(&space, Correspondence::Cyclic, Direction::Given, Mirror::Forbid);
        let placements: Vec<Placement> = (0..300)
            .map(|k| Placement { shift: (n - 5 * k % n) as u32 % n as u32, ..Default::default() })
            .collect();
        let search = SpectralSearch::new(&source, &class, &rotations, &matching, &placements).unwrap();
        let expected = MeanSpace::new(search.sum(&placements).unwrap(), 0).unwrap().elements();
        let near = MeanSpace::from_shape(&rotations, search.placed.shape(17)).unwrap();
        for near in [None, Some(&near)] {
            let found = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| search.mean(near)).unwrap().expect("many points").elements()
            };
            let one = found(1);
            let rest = &expected - &one * (one.transpose() * &expected);
            assert!(rest.norm() < 1e-10, "{:e}", rest.norm());
            assert_eq!(found(3), one);
        }
    }

    /// More than two parts: the search takes stages.
    #[test]
    fn a_search_that_begins_with_the_leading_shapes_has_the_same_result() {
        let (n, count) = (8, 2 * PART + 300);
        let representation = Representation::ClosedCurve {
            dimension: 2,
            control_points: n,
            generator: GeneratorKind::Cubic {},
        };
        let space = ShapeSpace::new(&representation).unwrap();
        let metric = Metric::of(&space);
        let class = TransformationClass::named(ClassName::Similarity, 2).unwrap();
        let rotations = TransformationClass::named(ClassName::ScaledRotation, 2).unwrap();
        let all = contours(count, n);
        for mirror in [Mirror::Forbid, Mirror::Allow] {
            let matching = Matching::new(&space, Correspondence::Cyclic, Direction::Given, mirror);
            let search = |count: usize, known: Vec<Placement>| {
                let shapes = all[..count * 2 * n].to_vec();
                let source = ShapesInMemory::new(&metric, true, shapes, vec![1.0; count]).unwrap();
                let known_count = known.len();
                let mut start = Start { placements: known, known: known_count };
                start.placements.resize(count, Placement::default());
                let mut spectral =
                    SpectralSearch::new(&source, &class, &rotations, &matching, &start.placements).unwrap();
                let found =
                    alternate(&mut spectral, &source, &matching, &stages(count), start.clone()).unwrap();
                let mut streamed = StreamedSearch::new(&source, &class, &matching, metric.len());
                let same = alternate(&mut streamed, &source, &matching, &stages(count), start).unwrap();
                assert_eq!((&found.placements, found.rounds), (&same.placements, same.rounds));
                assert_eq!(found.leading, same.leading);
                found
            };
            let fewer = search(count - 200, Vec::new());
            assert!(fewer.converged && fewer.leading.len() == 2 * PART);
            let cold = search(count, Vec::new());
            assert_eq!(cold.leading, fewer.leading);
            let warm = search(count, fewer.leading);
            assert_eq!((warm.placements, warm.rounds), (cold.placements.clone(), cold.rounds));
            // Placements of all shapes replace all stages.
            assert_eq!(search(count, cold.placements.clone()).placements, cold.placements);
        }
    }
}
