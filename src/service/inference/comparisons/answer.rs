//! Results of a comparison of groups: means, distances, tests, effects, sizes.

use tokio::runtime::Handle;

use super::{Prepared, pairs_of};
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::alignment::{Method, unwhitened};
use crate::analysis::dictionary::content::MeanRecord;
use crate::analysis::inference::comparison::{PairTests, Sample, Tested};
use crate::analysis::inference::permutation::{Tally, holm};
use crate::analysis::inference::span::Span;
use crate::analysis::mean::{MeanSpace, ProjectorSum};
use crate::analysis::metric::Metric;
use crate::analysis::rows::rows_of;
use crate::analysis::transformation::TransformationClass;
use crate::domain::comparison::{
    Comparison, EffectPoint, GroupRecord, OverallRecord, PairRecord, SizeDifference, SizeSummary,
    StatisticRecord, TestRecord,
};
use crate::geometry::sampling::Places;
use crate::numeric::dense::{Matrix, transpose_multiply};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::inference::test_sample::{self, Aligned};

impl Prepared {
    pub(super) fn compare(
        &self,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Result<Comparison, ServiceError> {
        let stop = || context.is_cancelled();
        context.report("align", 0.0, None);
        let Self { plan, cohort, setup, members, .. } = self;
        let source = (cohort, members.filters.as_slice());
        let aligned = test_sample::read_and_align(app, handle, source, &members.shapes, setup, &stop)?;
        context.report("compare", ALIGNED, None);
        let groups = self.groups(&aligned)?;
        let places = Places::along(&setup.space, plan.samples);
        let sample = Sample {
            coordinates: Span::new(&aligned.aligned, &aligned.weights)?.scores,
            points: test_sample::points_of(setup, &aligned.aligned, &places),
            dimension: setup.metric.dimension(),
            sizes: aligned.sizes.values.clone(),
            weights: aligned.weights.clone(),
        };
        let mut warnings = members.warnings(plan);
        warnings.extend(test_sample::mean_warnings(&aligned.mean));
        warnings.extend(aligned.warnings.iter().cloned());
        let all = members.relabellings(plan, None);
        let overall = if groups.len() > 2 {
            let test = sample.compare_all(&all, &stop)?;
            Some(OverallRecord { pseudo_f: statistic(&test.pseudo_f), r_squared: test.r_squared })
        } else {
            None
        };
        let mut pairs = Vec::new();
        let wanted = pairs_of(groups.len());
        for (i, &pair) in wanted.iter().enumerate() {
            context.check()?;
            context.report("compare", ALIGNED + (1.0 - ALIGNED) * i as f64 / wanted.len() as f64, None);
            let relabellings = members.relabellings(plan, Some(pair));
            if plan.permutations > 0 && relabellings.exchangeable() == 0 {
                warnings.push(format!(
                    "no labels of '{}' and '{}' can be exchanged within the strata: there is no p value",
                    members.names[pair.0], members.names[pair.1]
                ));
            }
            let chosen = sample.select(&members.of_pair(pair));
            let tests = chosen.compare_pair(&relabellings, &stop)?;
            let two = (&groups[pair.0], &groups[pair.1]);
            pairs.push(self.pair(two, tests, &aligned, &places, relabellings.exchangeable()));
        }
        correct(&mut pairs);
        Ok(Comparison {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            length_unit: cohort.length_unit.clone(),
            transformation: plan.transformation.clone(),
            alignment: plan.alignment,
            mirror: plan.mirror,
            seed: plan.seed,
            strata: plan.strata.clone(),
            shapes: members.shapes.len(),
            left_out: members.left_out,
            exchangeable: all.exchangeable(),
            pooled: MeanRecord::of(&aligned.mean, setup.metric.dimension()),
            groups: groups.into_iter().map(|group| group.record).collect(),
            pairs,
            overall,
            warnings,
        })
    }

    fn groups(&self, aligned: &Aligned) -> Result<Vec<Group>, ServiceError> {
        (0..self.members.names.len()).map(|group| self.group(group, aligned)).collect()
    }

    fn group(&self, group: usize, aligned: &Aligned) -> Result<Group, ServiceError> {
        let metric = &self.setup.metric;
        let members = self.members.of_group(group);
        let weights: Vec<f64> = members.iter().map(|&k| aligned.weights[k]).collect();
        let weight: f64 = weights.iter().sum();
        let average = test_sample::average(&aligned.aligned, &aligned.weights, &members);
        let squared = |k: usize| {
            let column = aligned.aligned.column(k);
            column.iter().zip(&average).map(|(x, m)| (x - m).powi(2)).sum::<f64>()
        };
        let spread = members.iter().map(|&k| aligned.weights[k] * squared(k)).sum::<f64>() / weight;
        let average_rows = rows_of(&unwhitened(metric, &average), metric.dimension());
        let (mean, elements) = match &self.setup.method {
            Method::Projection(class) => {
                let placed = aligned.placed.select_columns(&members);
                let (mean, elements) =
                    mean_of_space(class, placed, weights.clone(), &aligned.mean.whitened, metric)?;
                (mean, Some(elements))
            }
            Method::Procrustes(_) => {
                let control_points = average_rows.clone();
                let (eigenvalues, converged) = (Vec::new(), true);
                (MeanRecord { control_points, eigenvalues, gap: None, unique: None, converged }, None)
            }
        };
        let summary = |(m, &measure): (usize, _)| {
            let values: Vec<f64> = members.iter().map(|&k| aligned.sizes.values[(m, k)]).collect();
            let (mean, deviation) = test_sample::mean_and_deviation(&values, &weights);
            SizeSummary { measure, mean, deviation }
        };
        let record = GroupRecord {
            name: self.members.names[group].clone(),
            shapes: members.len(),
            weight,
            mean,
            average: average_rows,
            spread: spread.sqrt(),
            sizes: aligned.sizes.measures.iter().enumerate().map(summary).collect(),
        };
        Ok(Group { record, average, elements })
    }

    fn pair(
        &self,
        (first, second): (&Group, &Group),
        tests: PairTests,
        aligned: &Aligned,
        places: &Places,
        exchangeable: usize,
    ) -> PairRecord {
        let chordal = |(a, b): (&Matrix, &Matrix)| {
            let cosines = transpose_multiply(a, b).norm_squared() / a.ncols() as f64;
            (1.0 - cosines).max(0.0).sqrt()
        };
        let sizes = tests.sizes.iter().zip(&aligned.sizes.measures).map(|(tested, &measure)| {
            SizeDifference { measure, difference: tested.value.unwrap_or_default(), test: test(tested.tally) }
        });
        PairRecord {
            first: first.record.name.clone(),
            second: second.record.name.clone(),
            exchangeable,
            chordal_distance: first.elements.as_ref().zip(second.elements.as_ref()).map(chordal),
            distance: statistic(&tests.distance),
            pseudo_f: statistic(&tests.pseudo_f),
            r_squared: tests.r_squared,
            hotelling: statistic(&tests.hotelling),
            components: tests.components,
            effect: self.effect(first, &tests, places),
            sizes: sizes.collect(),
        }
    }

    fn effect(&self, first: &Group, tests: &PairTests, places: &Places) -> Vec<EffectPoint> {
        let (d, count) = (self.setup.metric.dimension(), places.count());
        let average = Matrix::from_column_slice(first.average.len(), 1, &first.average);
        let points = test_sample::points_of(&self.setup, &average, places);
        let row = |values: &[f64], i: usize| (0..d).map(|c| values[c * count + i]).collect::<Vec<f64>>();
        (0..count)
            .map(|i| {
                let difference = row(&tests.effect.difference, i);
                EffectPoint {
                    parameter: places.parameter(i),
                    surface_parameters: places.surface_parameters(i),
                    point: row(points.as_slice(), i),
                    length: difference.iter().map(|x| x * x).sum::<f64>().sqrt(),
                    difference,
                    t_squared: tests.effect.t_squared[i],
                    p: tests.effect.tallies[i].p(),
                }
            })
            .collect()
    }
}

/// Progress when the shapes are aligned.
const ALIGNED: f64 = 0.2;

/// Result of a group, with data needed for its pairs.
struct Group {
    record: GroupRecord,
    /// Arithmetic mean of the aligned shapes, whitened.
    average: Vec<f64>,
    /// Orthonormal basis of its mean space.
    elements: Option<Matrix>,
}

/// Nearest member to `pooled` of the mean space of shapes (whitened, one per column), and a basis of the space.
fn mean_of_space(
    class: &TransformationClass,
    shapes: Matrix,
    weights: Vec<f64>,
    pooled: &[f64],
    metric: &Metric,
) -> Result<(MeanRecord, Matrix), ServiceError> {
    let source = ShapesInMemory::prepared(shapes.as_slice().to_vec(), weights);
    let space = MeanSpace::new(ProjectorSum::of(&source, class, metric.len())?, REPORTED_EIGENVALUES)?;
    let control_points = rows_of(&unwhitened(metric, &space.project(pooled)), metric.dimension());
    let (gap, unique) = (Some(space.gap), Some(space.is_unique()));
    let elements = space.elements();
    let record = MeanRecord { control_points, eigenvalues: space.eigenvalues, gap, unique, converged: true };
    Ok((record, elements))
}

/// Number of reported eigenvalues of a mean space.
const REPORTED_EIGENVALUES: usize = 10;

pub(crate) fn test(tally: Tally) -> TestRecord {
    let Tally { exceeding, permutations, exact } = tally;
    TestRecord { p: tally.p(), p_holm: None, exceeding, permutations, exact }
}

fn statistic(tested: &Tested) -> StatisticRecord {
    StatisticRecord { value: tested.value, test: test(tested.tally) }
}

/// Applies Holm's correction for the number of pairs to the p values of every statistic and every size.
fn correct(pairs: &mut [PairRecord]) {
    let sizes = pairs.first().map_or(0, |pair| pair.sizes.len());
    let statistics: [fn(&mut PairRecord) -> &mut TestRecord; 3] =
        [|pair| &mut pair.distance.test, |pair| &mut pair.pseudo_f.test, |pair| &mut pair.hotelling.test];
    for of in statistics {
        correct_tests(pairs.iter_mut().map(of).collect());
    }
    for m in 0..sizes {
        correct_tests(pairs.iter_mut().map(|pair| &mut pair.sizes[m].test).collect());
    }
}

fn correct_tests(tests: Vec<&mut TestRecord>) {
    let mut tests: Vec<(f64, &mut TestRecord)> =
        tests.into_iter().filter_map(|test| test.p.map(|p| (p, test))).collect();
    let p: Vec<f64> = tests.iter().map(|(p, _)| *p).collect();
    for ((_, test), corrected) in tests.iter_mut().zip(holm(&p)) {
        test.p_holm = Some(corrected);
    }
}
