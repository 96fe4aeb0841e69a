//! Sums of parts give the bits of one pass, and few-digit checks of what the sums mean.

use super::rows::Rows;
use super::*;
use crate::accumulate::{Accumulator, BLOCK, PART, Shapes};
use crate::models::anova::{Model, Testing};
use crate::models::design::{Contrasts, Table};
use crate::models::formula::{Formula, TermOrder};
use crate::models::study::Further;
use crate::models::subspaces::SumType;
use crate::random::stream;
use crate::watch::Unwatched;
use rand_distr::{Distribution, StandardNormal};
use shapelex_numeric::dense::Matrix;

const LENGTH: usize = 3;

fn noise(i: usize, k: usize) -> f64 {
    StandardNormal.sample(&mut stream(29 + i as u64, k))
}

/// Numbers that depend on a factor and a number, with weights.
fn sample(shapes: usize) -> (Table, ShapesInMemory) {
    let level = |k: usize| ["u", "v", "w"][k * k % 7 % 3];
    let number = |k: usize| 2000.0 + (k % 50) as f64;
    let table =
        Table::default().with_factor("a", (0..shapes).map(level)).with_numbers("x", (0..shapes).map(number));
    let of = |k: usize| {
        let effect = [0.0, 0.1, -0.05][k * k % 7 % 3];
        (0..LENGTH).map(move |i| 1.0 + effect * i as f64 + 0.002 * number(k) + 0.3 * noise(i, k))
    };
    let weights = (0..shapes).map(|k| 1.0 + (k % 3) as f64).collect();
    (table, ShapesInMemory::prepared((0..shapes).flat_map(of).collect(), weights))
}

fn question<'a>(formula: &'a Formula, table: &'a Table, draws: usize) -> ModelQuestion<'a> {
    ModelQuestion {
        formula,
        table,
        contrasts: Contrasts::Treatment,
        response: Response::Shape,
        testing: Testing { permutations: draws, seed: 4, ..Testing::default() },
        random: None,
        manova: None,
        covariance: None,
        at: None,
        further: Further::default(),
    }
}

/// A source whose batches have so many shapes.
struct Batched<'a>(&'a ShapesInMemory, usize);

impl ShapeSource for Batched<'_> {
    fn count(&self) -> usize {
        self.0.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        for first in (0..self.count()).step_by(self.1) {
            let (_, rest) = self.0.all().split_at(first);
            visit(rest.split_at(self.1.min(rest.weights.len())).0)?;
        }
        Ok(())
    }
}

/// Bits of the sums are those of one pass for batches of any number of blocks, any number of threads, and parts that were made apart.
#[test]
fn sums_have_the_same_bits_however_they_are_made() {
    let shapes = 2 * PART + 5 * BLOCK + 17;
    let (table, source) = sample(shapes);
    let formula = Formula::parse("a*x", TermOrder::ByDegree).unwrap();
    for draws in [0, 70] {
        let question = question(&formula, &table, draws);
        let streamed = StreamedDesign::new(&question, source.all().weights, LENGTH).unwrap();
        let exchange = streamed.exchange(None, &question);
        let origin = [5.0, 5.1, 5.2];
        let summed =
            Summed { basis: &streamed.basis, origin: &origin, exchange: exchange.as_ref(), scatter: true };
        let sum = |source: &dyn ShapeSource| accumulate(source, || DesignSums::new(summed)).unwrap();
        let whole = sum(&source).to_bytes();
        for batch in [BLOCK, 7 * BLOCK, PART, shapes] {
            assert!(sum(&Batched(&source, batch)).to_bytes() == whole, "{draws} draws, batches of {batch}");
        }
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert!(pool.install(|| sum(&source)).to_bytes() == whole, "{draws} draws, {threads} threads");
        }
        // A part by itself, written and read again, as another process would.
        let mut merged = DesignSums::new(summed);
        for first in (0..shapes).step_by(PART) {
            let (_, rest) = source.all().split_at(first);
            let (part, _) = rest.split_at(PART.min(rest.weights.len()));
            let mut own = DesignSums::new(summed);
            for unit in (0..part.weights.len()).step_by(own.unit()) {
                let mut piece = DesignSums::new(summed);
                piece
                    .update(part.split_at(unit).1.split_at(own.unit().min(part.weights.len() - unit)).0)
                    .unwrap();
                own.merge(piece);
            }
            let mut read = DesignSums::new(summed);
            read.restore(&own.to_bytes()).unwrap();
            merged.merge(read);
        }
        assert!(merged.to_bytes() == whole, "{draws} draws, parts apart");
        assert!(merged.restore(&whole[1..]).is_err() && merged.restore(&whole[..whole.len() - 8]).is_err());
    }
}

/// Tables of sums beside those of shapes in memory with the same exchanges: p and the numbers of exchanges equal, the rest to rounding.
/// Shapes share 150 rows of `a*x`, have one each of `poly(x,2)`, and are exchanged freely and within strata.
#[test]
fn tables_are_those_of_shapes_in_memory() {
    let shapes = 700;
    let (table, source) = sample(shapes);
    let labels: Vec<usize> = (0..shapes).map(|k| k / 9 % 4).collect();
    let short: Vec<u32> = labels.iter().map(|&label| label as u32).collect();
    let vectors = Matrix::from_column_slice(LENGTH, shapes, source.all().whitened);
    let weights = source.all().weights.to_vec();
    for (text, kind) in
        [("a*x", SumType::I), ("a*x", SumType::II), ("a+x", SumType::III), ("0+a", SumType::II)]
            .into_iter()
            .chain([("poly(x,2)+a", SumType::I), ("a/x", SumType::II)])
    {
        let formula = Formula::parse(text, TermOrder::ByDegree).unwrap();
        for strata in [None, Some(labels.as_slice())] {
            let mut question = question(&formula, &table, 60);
            question.testing = Testing { kind, strata, ..question.testing };
            let streamed = StreamedDesign::new(&question, &weights, LENGTH).unwrap();
            let exchange = streamed.exchange(strata.map(|_| short.as_slice()), &question).unwrap();
            let given: Vec<Vec<usize>> = (0..60).map(|draw| exchange.list(draw, shapes)).collect();
            let origin = if formula.intercept { [5.0, 5.1, 5.2] } else { [0.0; 3] };
            let summed = Summed {
                basis: &streamed.basis,
                origin: &origin,
                exchange: Some(&exchange),
                scatter: strata.is_none(),
            };
            let sums = accumulate(&source, || DesignSums::new(summed)).unwrap();
            let found =
                Solved::new(&streamed, summed, sums).record(&question, None, f64::INFINITY).unwrap().anova;
            let model =
                Model::new(&formula, &table, Contrasts::Treatment, vectors.clone(), weights.clone()).unwrap();
            let testing = Testing { given: Some(&given), ..question.testing.clone() };
            let expected = model.anova(&testing, &Unwatched).unwrap();
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-11 * b.abs().max(1e-12);
            assert!(near(found.total.sum_of_squares, expected.total.sum_of_squares), "{text}");
            assert!(near(found.residual.sum_of_squares, expected.residual.sum_of_squares), "{text}");
            assert_eq!((&found.design, &found.warnings), (&expected.design, &expected.warnings), "{text}");
            for (found, expected) in found.terms.iter().zip(&expected.terms) {
                let what = format!("{text} {kind:?}, {}: {found:?} for {expected:?}", found.term);
                assert_eq!((&found.term, found.degrees), (&expected.term, expected.degrees));
                assert!(near(found.sum_of_squares, expected.sum_of_squares), "{what}");
                assert!(near(found.f.unwrap(), expected.f.unwrap()), "{what}");
                assert_eq!((found.p, found.permutations), (expected.p, expected.permutations), "{what}");
                assert!((found.z.unwrap() - expected.z.unwrap()).abs() < 1e-7, "{what}");
                let upper = |row: &crate::models::records::TermRecord| row.histogram.as_ref().unwrap().upper;
                assert!(near(upper(found), upper(expected)), "{what}");
                assert_eq!(found.p_asymptotic.is_some(), strata.is_none(), "{what}");
            }
        }
    }
}

/// Without an effect, p of exchanges and of many shapes are estimates of one probability.
#[test]
fn asymptotic_p_values_are_those_of_exchanges() {
    let shapes = 3000;
    let table = Table::default().with_factor("g", (0..shapes).map(|k| ["u", "v", "w"][k % 3]));
    let formula = Formula::parse("g", TermOrder::ByDegree).unwrap();
    let scales = [1.0, 0.5, 0.1];
    for set in 0..6 {
        let of = |k: usize| (0..LENGTH).map(move |i| scales[i] * noise(100 * (set + 1) + i, k));
        let source = ShapesInMemory::prepared((0..shapes).flat_map(of).collect(), vec![1.0; shapes]);
        let question = question(&formula, &table, 1999);
        let streamed = StreamedDesign::new(&question, source.all().weights, LENGTH).unwrap();
        let exchange = streamed.exchange(None, &question);
        let origin = [0.0; LENGTH];
        let summed =
            Summed { basis: &streamed.basis, origin: &origin, exchange: exchange.as_ref(), scatter: true };
        let sums = accumulate(&source, || DesignSums::new(summed)).unwrap();
        let record = Solved::new(&streamed, summed, sums).record(&question, None, f64::INFINITY).unwrap();
        let row = &record.anova.terms[0];
        let (p, asymptotic) = (row.p.unwrap(), row.p_asymptotic.unwrap());
        // Four standard errors of p, and the difference of a finite number of shapes.
        let allowed = 4.0 * (asymptotic * (1.0 - asymptotic) / 2000.0).sqrt() + 2e-3;
        assert!((p - asymptotic).abs() < allowed, "{p} and {asymptotic}");
    }
}

#[test]
fn distinct_exchanges_are_counted() {
    let formula = Formula::parse("g", TermOrder::ByDegree).unwrap();
    let table = Table::default().with_factor("g", (0..12).map(|k| ["u", "v"][k % 2]));
    let rows = Rows::new(&[&formula], &table, 12);
    assert_eq!((rows.count(), rows.distinct(None)), (2, 924.0));
    let strata: Vec<u32> = (0..12).map(|k| k / 6).collect();
    assert_eq!(rows.distinct(Some(&strata)), 400.0);
    let own = Table::default().with_numbers("g", (0..12).map(f64::from));
    assert_eq!(Rows::new(&[&formula], &own, 12).distinct(Some(&strata)), f64::INFINITY);
}
