//! Sums that are made in parts have the bits of those that are made at once.

use rayon::ThreadPoolBuilder;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{
    Accumulator, BLOCK, FAN_IN, MergePart, PART, ScatterSum, ShapeSource, Shapes, ShapesInMemory, accumulate,
};
use shapelex_analysis::alignment::{Alignment, Method, mean_shape};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::dictionary::model::{Certificate, Coded, Model, Spread};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::partial_sums::Measured;
use shapelex_analysis::pass::{Aligned, Pass, Sum};
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::preparation::{Pose, Posed, Preparation};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::representation::{Representation, ShapeSpace};

/// Numbers of a shape: three landmarks in the plane.
const LENGTH: usize = 6;

/// Two whole parts and a rest that is no whole block.
const SHAPES: usize = 2 * PART + 3 * BLOCK + 17;

/// Triangles of all forms with weights of 1 to 3.
fn triangles(count: usize) -> ShapesInMemory {
    let mut state = 7_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 / (1_u64 << 53) as f64) * 0.6 - 0.3
    };
    let base = [0.0, 2.0, 0.5, 0.0, 0.3, 1.5];
    let points = (0..count * LENGTH).map(|k| base[k % LENGTH] + noise()).collect();
    let weights = (0..count).map(|k| 1.0 + (k % 3) as f64).collect();
    ShapesInMemory::new(&metric(), true, points, weights).unwrap()
}

fn space() -> ShapeSpace {
    ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: LENGTH / 2 }).unwrap()
}

fn metric() -> Metric {
    Metric::of(&space())
}

/// Shapes from one position to another, in batches of so many blocks.
struct Stretch<'a> {
    shapes: &'a ShapesInMemory,
    from: usize,
    to: usize,
    blocks: usize,
}

impl ShapeSource for Stretch<'_> {
    fn count(&self) -> usize {
        self.to - self.from
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let all = self.shapes.all();
        for first in (self.from..self.to).step_by(self.blocks * BLOCK) {
            let last = (first + self.blocks * BLOCK).min(self.to);
            let whitened = &all.whitened[first * LENGTH..last * LENGTH];
            visit(Shapes { first, whitened, weights: &all.weights[first..last] })?;
        }
        Ok(())
    }
}

/// The parts of the shapes, in their order.
fn parts(shapes: &ShapesInMemory) -> Vec<Stretch<'_>> {
    let count = shapes.count();
    let part = |from: usize| Stretch { shapes, from, to: (from + PART).min(count), blocks: 5 };
    (0..count).step_by(PART).map(part).collect()
}

fn scatter(source: &dyn ShapeSource) -> ScatterSum {
    accumulate(source, || ScatterSum::new(LENGTH)).unwrap()
}

fn merged(sums: impl IntoIterator<Item = ScatterSum>) -> Vec<u8> {
    let mut total = ScatterSum::new(LENGTH);
    sums.into_iter().for_each(|sum| total.merge(sum));
    total.to_bytes()
}

/// The sums of consecutive units, each made by itself.
fn units(shapes: &ShapesInMemory, unit: usize) -> impl Iterator<Item = ScatterSum> {
    let sum = move |from: usize| {
        let to = (from + unit).min(shapes.count());
        scatter(&Stretch { shapes, from, to, blocks: 1 })
    };
    (0..shapes.count()).step_by(unit).map(sum)
}

#[test]
fn up_to_one_part_units_merge_one_after_the_other() {
    let unit = ScatterSum::new(LENGTH).unit();
    for count in [1, BLOCK, unit + 1, PART - 1, PART] {
        let shapes = triangles(count);
        assert!(scatter(&shapes).to_bytes() == merged(units(&shapes, unit)), "{count} shapes");
    }
    // From then on it makes a difference: the order is part of what is defined.
    let shapes = triangles(SHAPES);
    assert!(scatter(&shapes).to_bytes() != merged(units(&shapes, unit)));
}

/// Vectors in batches of so many blocks.
struct Vectors<'a> {
    columns: &'a [f64],
    length: usize,
    blocks: usize,
}

impl ShapeSource for Vectors<'_> {
    fn count(&self) -> usize {
        self.columns.len() / self.length
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let size = self.blocks * BLOCK;
        for (i, whitened) in self.columns.chunks(size * self.length).enumerate() {
            let weights: Vec<f64> =
                (0..whitened.len() / self.length).map(|k| 1.0 + ((i * size + k) % 4) as f64).collect();
            visit(Shapes { first: i * size, whitened, weights: &weights })?;
        }
        Ok(())
    }
}

#[test]
fn sums_of_any_size_are_those_of_the_formula_and_have_the_same_bits_on_any_threads() {
    // Below and above the size from which threads share the matrix; few vectors are kept as they are.
    for (length, count) in [(1, 3000), (40, 19), (40, 2100), (256, 700), (300, 140), (300, 1100), (333, 9000)]
    {
        let columns: Vec<f64> = (0..count * length).map(|k| ((k * k) as f64 * 0.37).sin()).collect();
        let origin: Vec<f64> = (0..length).map(|i| (i as f64).cos()).collect();
        let summed = |threads: usize, blocks: usize| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let source = Vectors { columns: &columns, length, blocks };
            pool.install(|| FunctionalPca::scatter(&source, &origin).unwrap())
        };
        let whole = summed(1, 1000);
        for (threads, blocks) in [(2, 1), (4, 7), (3, 64)] {
            assert!(
                summed(threads, blocks).to_bytes() == whole.to_bytes(),
                "{length} x {count}, {threads} threads"
            );
        }
        let weight = |k: usize| 1.0 + (k % 4) as f64;
        let total: f64 = (0..count).map(weight).sum();
        assert_eq!(whole.weight(), total);
        let y = |k: usize, i: usize| columns[k * length + i] - origin[i];
        let mean = whole.mean();
        // Sums of random signs lose a few digits of `count` terms.
        let tolerance = 1e-13 * count as f64;
        for i in [0, length / 2, length - 1] {
            let direct: f64 = (0..count).map(|k| weight(k) * y(k, i)).sum();
            assert!((mean[i] * total - direct).abs() < tolerance, "{length} x {count}: mean of {i}");
        }
        let trace: f64 =
            (0..count).map(|k| weight(k) * (0..length).map(|i| y(k, i).powi(2)).sum::<f64>()).sum();
        let (found, pairs) = whole.leading(false, 2).unwrap();
        assert!(
            (found - trace).abs() < 1e-13 * trace * (length as f64),
            "{length} x {count}: {found} {trace}"
        );
        let first = pairs.vectors.column(0);
        let quotient: f64 = (0..count)
            .map(|k| weight(k) * (0..length).map(|i| first[i] * y(k, i)).sum::<f64>().powi(2))
            .sum();
        assert!(
            (quotient - pairs.values[0]).abs() < 1e-11 * trace,
            "{length} x {count}: {quotient} {:?}",
            pairs.values
        );
    }
}

#[test]
fn parts_give_the_same_bits_on_any_threads_and_made_in_any_order() {
    let shapes = triangles(SHAPES);
    let whole = scatter(&shapes).to_bytes();
    for (threads, blocks) in [(1, 1), (2, 7), (4, 64), (3, 1000)] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let source = Stretch { shapes: &shapes, from: 0, to: SHAPES, blocks };
        assert!(pool.install(|| scatter(&source).to_bytes()) == whole, "{threads} threads, {blocks} blocks");
    }
    let mut sums: Vec<ScatterSum> = parts(&shapes).iter().rev().map(|part| scatter(part)).collect();
    sums.reverse();
    assert_eq!(sums.len(), 3);
    assert!(merged(sums.clone()) == whole);
    assert!(merged(sums.into_iter().rev()) != whole, "merged in another order");
}

#[test]
fn few_vectors_are_centred_as_they_are_and_many_in_the_matrix() {
    for (length, count) in [(300, 40), (300, 700), (24, 20), (24, 200)] {
        let columns: Vec<f64> = (0..count * length).map(|k| ((k * k) as f64 * 0.37).sin() + 3.0).collect();
        let source = Vectors { columns: &columns, length, blocks: 1 };
        let sum = FunctionalPca::scatter(&source, &vec![0.0; length]).unwrap();
        let (mean, weight) = (sum.mean(), |k: usize| 1.0 + (k % 4) as f64);
        let away = |k: usize, i: usize| columns[k * length + i] - mean[i];
        let wanted: f64 =
            (0..count).map(|k| weight(k) * (0..length).map(|i| away(k, i).powi(2)).sum::<f64>()).sum();
        // As version 0.1.0 wrote it, without the roots of the weights.
        let bytes = sum.to_bytes();
        let roots = if count < length / 2 || count < 128 { count } else { 0 };
        let mut old = ScatterSum::new(length);
        old.restore(&bytes[..bytes.len() - 8 * (1 + roots)]).unwrap();
        let mut again = ScatterSum::new(length);
        again.restore(&bytes).unwrap();
        assert!(again.to_bytes() == bytes);
        let (trace, pairs) = again.leading(true, 3).unwrap();
        let (in_matrix, others) = old.leading(true, 3).unwrap();
        // The matrix loses digits: the mean is nine times as far from zero as the shapes from it.
        assert!((trace - wanted).abs() < 1e-13 * wanted, "{length} x {count}: {trace} {wanted}");
        assert!((in_matrix - wanted).abs() < 1e-11 * wanted, "{length} x {count}: {in_matrix} {wanted}");
        for (value, other) in pairs.values.iter().zip(&others.values) {
            assert!((value - other).abs() < 1e-11 * wanted, "{length} x {count}: {value} {other}");
        }
    }
}

/// Has the last part made first, each from the pass as it is written down.
struct Elsewhere<'a> {
    shapes: &'a ShapesInMemory,
    measured: Measured<'a>,
}

impl ShapeSource for Elsewhere<'_> {
    fn count(&self) -> usize {
        self.shapes.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.shapes.for_each_batch(visit)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        let written = serde_json::to_string(pass).unwrap();
        let make = |part: &Stretch<'_>| {
            let pass: Pass = serde_json::from_str(&written).unwrap();
            pass.make(part, self.measured).unwrap()
        };
        let mut results: Vec<Vec<u8>> = parts(self.shapes).iter().rev().map(make).collect();
        results.reverse();
        results.iter().try_for_each(|result| merge(result))?;
        Ok(true)
    }
}

#[test]
fn what_is_learnt_from_parts_made_elsewhere_has_the_same_bits() {
    let (shapes, metric) = (triangles(SHAPES), metric());
    let correspondence = (Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let matching = Matching::new(&space(), correspondence.0, correspondence.1, correspondence.2);
    for (class, alignment) in [
        (ClassName::Similarity, Alignment::Projection),
        (ClassName::Affine, Alignment::Projection),
        (ClassName::Rigid, Alignment::Procrustes),
    ] {
        let method = Method::new(&Transformation::Named(class), alignment, 2).unwrap();
        let measured = Measured { metric: &metric, method: &method, matching: &matching };
        let elsewhere = Elsewhere { shapes: &shapes, measured };
        let here = mean_shape(&shapes, &metric, &method, Frame::Training, &matching).unwrap();
        let mean = mean_shape(&elsewhere, &metric, &method, Frame::Training, &matching).unwrap();
        assert_eq!(mean.whitened, here.whitened, "the mean under {class:?}");
        let preparation = Preparation {
            metric: metric.clone(),
            method: method.clone(),
            matching: matching.clone(),
            mean: mean.whitened,
            pose: Pose::Aligned { normalise: false },
        };
        let posed = Posed { source: &shapes, preparation: &preparation };
        let other = Posed { source: &elsewhere, preparation: &preparation };
        let origin = FunctionalPca::origin(&preparation.mean, true);
        let sum = FunctionalPca::scatter(&posed, &origin).unwrap();
        assert_eq!(FunctionalPca::scatter(&other, &origin).unwrap(), sum, "the scatter under {class:?}");

        let pca = FunctionalPca::from_sum(sum, &metric, &origin, true, 2).unwrap();
        let spread = Spread::of(&pca, SHAPES, 2.0 * SHAPES as f64);
        let model = Model::Components { pca, spread };
        let mut coded = Coded::default();
        for part in parts(&shapes) {
            let part = Posed { source: &part, preparation: &preparation };
            coded.append(&Coded::new(&model, &part, &Unwatched).unwrap().to_bytes()).unwrap();
        }
        let certificate = Certificate::new(&model, &posed, &Unwatched).unwrap();
        assert_eq!(coded.certificate(), certificate, "the certificate under {class:?}");
    }
}

#[test]
fn groups_of_parts_merge_first_and_what_merged_elsewhere_has_the_same_bits() {
    let (shapes, metric) = (triangles((FAN_IN + 2) * PART + 5), metric());
    let similarity = Transformation::Named(ClassName::Similarity);
    let projection = Method::new(&similarity, Alignment::Projection, 2).unwrap();
    let procrustes = Method::new(&similarity, Alignment::Procrustes, 2).unwrap();
    let Method::Procrustes(fit) = procrustes else { panic!("expected a fit") };
    let matching = Matching::new(&space(), Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let mean = shapes.all().whitened[..LENGTH].to_vec();
    let aligned = Some(Aligned { mean: mean.clone(), normalise: true });
    let elements = [mean.clone(), shapes.all().whitened[LENGTH..2 * LENGTH].to_vec()].concat();
    for (aligned, sum, method) in [
        (None, Sum::Projectors, &projection),
        (None, Sum::Frame { elements }, &projection),
        (None, Sum::Fits { fit, mean: mean.clone() }, &procrustes),
        (aligned, Sum::Scatter { origin: mean }, &projection),
    ] {
        let measured = Measured { metric: &metric, method, matching: &matching };
        let pass = Pass { aligned, sum };
        let merged = |sums: &[Vec<u8>]| {
            let sums: Vec<&[u8]> = sums.iter().map(Vec::as_slice).collect();
            pass.merge(&sums, measured).unwrap()
        };
        let whole = pass.make(&shapes, measured).unwrap();
        let sums: Vec<Vec<u8>> =
            parts(&shapes).iter().map(|part| pass.make(part, measured).unwrap()).collect();
        let groups: Vec<Vec<u8>> = sums.chunks(FAN_IN).map(merged).collect();
        assert_eq!(groups.len(), 2);
        assert!(merged(&groups) == whole, "{:?}", pass.sum);
        assert!(merged(&sums) != whole, "{:?}: the tree does not matter", pass.sum);
        // In two calls, and an empty sum changes nothing.
        let begun = merged(&sums[..5]);
        assert!(merged(&[&[begun], &sums[5..FAN_IN]].concat()) == groups[0], "{:?}", pass.sum);
        assert!(merged(&[merged(&[]), whole.clone()]) == whole, "{:?}", pass.sum);
        let other = Pass { aligned: None, sum: Sum::Scatter { origin: vec![0.0; LENGTH + 1] } };
        assert!(other.merge(&[&whole], measured).is_err());
        assert!(pass.merge(&[&whole[..whole.len() - 1]], measured).is_err());
    }
}

#[test]
fn codes_that_are_something_else_are_refused() {
    let (metric, shapes) = (metric(), triangles(40));
    let origin = vec![0.0; LENGTH];
    let sum = FunctionalPca::scatter(&shapes, &origin).unwrap();
    let pca = FunctionalPca::from_sum(sum, &metric, &origin, false, 2).unwrap();
    let spread = Spread::of(&pca, 40, 80.0);
    let model = Model::Components { pca, spread };
    let bytes = Coded::new(&model, &shapes, &Unwatched).unwrap().to_bytes();
    for end in [0, 7, 100, bytes.len() - 1] {
        assert!(Coded::default().append(&bytes[..end]).is_err(), "{end} bytes");
    }
    let other = scatter(&shapes).to_bytes();
    assert!(Coded::default().append(&other).is_err());
}
