//! Comparison of groups of shapes: means, distances, tests, effects along the shape, sizes.

use super::aligned::{AlignedShapes, mean_and_deviation, mean_warnings};
use super::comparison::{PairTests, Sample};
use super::error::StudyError;
use super::groups::Groups;
use super::limits::MIN_MEMBERS;
use super::permutation::{Draws, holm};
use super::records::{
    EffectPoint, GroupComparison, GroupRecord, OverallRecord, PairRecord, SizeDifference, SizeSummary,
    TestRecord,
};
use super::span::Span;
use super::studentised::studentised;
use crate::AnalysisError;
use crate::accumulate::ShapesInMemory;
use crate::alignment::Method;
use crate::mean::{MeanSpace, ProjectorSum};
use crate::mean_record::MeanRecord;
use crate::transformation::TransformationClass;
use crate::watch::{Counted, Watch};
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::{Matrix, transpose_multiply};

/// Number of reported eigenvalues of a mean space.
const REPORTED_EIGENVALUES: usize = 10;

/// Ratio of spreads from which tests are told to be uncertain. Between groups of equal scatter sampling makes a ratio of 1.2 in one of
/// ten comparisons of 20 and 20 shapes that vary in about six directions.
pub(crate) const UNEQUAL_SPREADS: f64 = 1.25;

/// Compares groups of shapes: every two groups, and all at once if there are more than two.
///
/// For every two groups: the chordal distance of their mean spaces, the distance of their averages, pseudo-F, Hotelling's
/// statistic, the effect at `samples` places along the shape ([`Places::along`]) and the sizes, each with a permutation test
/// by `draws`, and p values corrected by Holm for the number of pairs. `watch` receives the fraction of
/// the relabellings that are done.
///
/// Cost: that of [`Sample::compare_pair`] for every two groups, and one mean space per group.
///
/// # Errors
/// [`StudyError::FewMembers`]; a degenerate mean of a group; [`AnalysisError::Interrupted`] once `watch` stops.
pub fn compare(
    shapes: &AlignedShapes<'_>,
    groups: &Groups,
    draws: Draws<'_>,
    samples: usize,
    watch: &dyn Watch,
) -> Result<GroupComparison, StudyError> {
    Study::new(shapes, groups, draws, samples)?.comparison(watch)
}

/// Data from which the groups and their pairs are computed.
struct Study<'a> {
    shapes: &'a AlignedShapes<'a>,
    groups: &'a Groups,
    draws: Draws<'a>,
    places: Places,
    sample: Sample,
}

/// Result of a group, with data needed for its pairs.
struct Group {
    record: GroupRecord,
    /// Arithmetic mean of the aligned shapes, whitened.
    average: Vec<f64>,
    /// Orthonormal basis of its mean space.
    elements: Option<Matrix>,
}

impl<'a> Study<'a> {
    fn new(
        shapes: &'a AlignedShapes<'a>,
        groups: &'a Groups,
        draws: Draws<'a>,
        samples: usize,
    ) -> Result<Self, StudyError> {
        for (group, name) in groups.names.iter().enumerate() {
            let found = groups.members(group).len();
            if found < MIN_MEMBERS {
                return Err(StudyError::FewMembers { group: name.clone(), found });
            }
        }
        let places = Places::along(shapes.space.space, samples);
        let sample = Sample {
            coordinates: Span::new(&shapes.aligned, &shapes.weights)?.scores,
            points: shapes.points(&shapes.aligned, &places),
            dimension: shapes.space.metric.dimension(),
            sizes: shapes.sizes.values.clone(),
            weights: shapes.weights.clone(),
        };
        Ok(Self { shapes, groups, draws, places, sample })
    }

    fn comparison(&self, watch: &dyn Watch) -> Result<GroupComparison, StudyError> {
        let groups: Vec<Group> =
            (0..self.groups.names.len()).map(|group| self.group(group)).collect::<Result<_, _>>()?;
        let mut warnings = mean_warnings(&self.shapes.mean);
        warnings.extend(self.shapes.size_warning());
        warnings.extend(spread_warning(groups.iter().map(|group| &group.record)));
        let (mut pairs, wanted) = (Vec::new(), self.groups.pairs());
        let tests = wanted.len() + usize::from(groups.len() > 2);
        let watch = &Counted::new(watch, tests * self.draws.permutations);
        let overall = if groups.len() > 2 { Some(self.overall(watch)?) } else { None };
        for pair in wanted {
            watch.check()?;
            let record = self.pair(pair, &groups, watch)?;
            if self.draws.permutations > 0 && record.exchangeable == 0 {
                warnings.push(format!(
                    "no labels of '{}' and '{}' can be exchanged within the strata: there is no p value",
                    record.first, record.second
                ));
            }
            pairs.push(record);
        }
        correct(&mut pairs);
        Ok(GroupComparison {
            exchangeable: self.groups.relabellings(self.draws).exchangeable(),
            pooled: MeanRecord::of(&self.shapes.mean, self.shapes.space.metric.dimension()),
            groups: groups.into_iter().map(|group| group.record).collect(),
            pairs,
            overall,
            warnings,
        })
    }

    fn overall(&self, watch: &dyn Watch) -> Result<OverallRecord, AnalysisError> {
        let test = self.sample.compare_all(&self.groups.relabellings(self.draws), watch)?;
        let (r_squared, histogram) = (test.r_squared, test.histogram);
        Ok(OverallRecord { pseudo_f: test.pseudo_f.into(), r_squared, histogram })
    }

    fn group(&self, group: usize) -> Result<Group, StudyError> {
        let members = self.groups.members(group);
        let weights: Vec<f64> = members.iter().map(|&k| self.shapes.weights[k]).collect();
        let average = self.shapes.average(&members);
        let rows = self.shapes.rows(&average);
        let (mean, elements) = match self.shapes.space.method {
            Method::Projection(class) => {
                let (mean, elements) = self.mean_space(class, &members, weights.clone())?;
                (mean, Some(elements))
            }
            Method::Procrustes(_) => {
                let (control_points, eigenvalues) = (rows.clone(), Vec::new());
                (MeanRecord { control_points, eigenvalues, gap: None, unique: None, converged: true }, None)
            }
        };
        let record = GroupRecord {
            name: self.groups.names[group].clone(),
            shapes: members.len(),
            weight: weights.iter().sum(),
            mean,
            spread: self.spread(&members, &average),
            average: rows,
            sizes: self.sizes(&members, &weights),
        };
        Ok(Group { record, average, elements })
    }

    /// Root of the weighted mean squared distance of the aligned shapes at `members` from `average`.
    fn spread(&self, members: &[usize], average: &[f64]) -> f64 {
        let weights = &self.shapes.weights;
        let weight: f64 = members.iter().map(|&k| weights[k]).sum();
        let squared = |k: usize| {
            let column = self.shapes.aligned.column(k);
            column.iter().zip(average).map(|(x, m)| (x - m).powi(2)).sum::<f64>()
        };
        (members.iter().map(|&k| weights[k] * squared(k)).sum::<f64>() / weight).sqrt()
    }

    fn sizes(&self, members: &[usize], weights: &[f64]) -> Vec<SizeSummary> {
        let summary = |(m, &measure): (usize, _)| {
            let values: Vec<f64> = members.iter().map(|&k| self.shapes.sizes.values[(m, k)]).collect();
            let (mean, deviation) = mean_and_deviation(&values, weights);
            SizeSummary { measure, mean, deviation }
        };
        self.shapes.sizes.measures.iter().enumerate().map(summary).collect()
    }

    /// Nearest member to the pooled mean of the mean space of the shapes at `members`, and a basis of the space.
    fn mean_space(
        &self,
        class: &TransformationClass,
        members: &[usize],
        weights: Vec<f64>,
    ) -> Result<(MeanRecord, Matrix), AnalysisError> {
        let placed = self.shapes.placed.select_columns(members);
        let source = ShapesInMemory::prepared(placed.as_slice().to_vec(), weights);
        let sum = ProjectorSum::of(&source, class, self.shapes.space.metric.len())?;
        let space = MeanSpace::new(sum, REPORTED_EIGENVALUES)?;
        let control_points = self.shapes.rows(&space.project(&self.shapes.mean.whitened));
        let (gap, unique) = (Some(space.gap), Some(space.is_unique()));
        let elements = space.elements();
        let eigenvalues = space.eigenvalues;
        Ok((MeanRecord { control_points, eigenvalues, gap, unique, converged: true }, elements))
    }

    fn pair(
        &self,
        pair: (usize, usize),
        groups: &[Group],
        watch: &dyn Watch,
    ) -> Result<PairRecord, AnalysisError> {
        let (first, second) = (&groups[pair.0], &groups[pair.1]);
        let relabellings = self.groups.relabellings_of_pair(pair, self.draws);
        let chosen = self.sample.select(&self.groups.members_of_pair(pair));
        let tests = chosen.compare_pair(&relabellings, watch)?;
        let studentised = match relabellings.is_stratified() {
            true => None,
            false => {
                let drawn = (self.draws.seed, self.draws.permutations);
                studentised(&chosen, relabellings.observed(), drawn, watch)?
            }
        };
        let effect = self.effect(first, &tests);
        let sizes =
            tests.sizes.iter().zip(&self.shapes.sizes.measures).map(|(tested, &measure)| SizeDifference {
                measure,
                difference: tested.value.unwrap_or_default(),
                test: tested.tally.into(),
            });
        Ok(PairRecord {
            first: first.record.name.clone(),
            second: second.record.name.clone(),
            exchangeable: relabellings.exchangeable(),
            chordal_distance: first.elements.as_ref().zip(second.elements.as_ref()).map(chordal_distance),
            sizes: sizes.collect(),
            distance: tests.distance.into(),
            pseudo_f: tests.pseudo_f.into(),
            r_squared: tests.r_squared,
            hotelling: tests.hotelling.into(),
            components: tests.components,
            studentised: studentised.map(Into::into),
            histogram: tests.histogram,
            effect,
        })
    }

    /// Difference along the shape, from the average of the first group.
    fn effect(&self, first: &Group, tests: &PairTests) -> Vec<EffectPoint> {
        let (d, count) = (self.shapes.space.metric.dimension(), self.places.count());
        let average = Matrix::from_column_slice(first.average.len(), 1, &first.average);
        let points = self.shapes.points(&average, &self.places);
        let row = |values: &[f64], i: usize| (0..d).map(|c| values[c * count + i]).collect::<Vec<f64>>();
        (0..count)
            .map(|i| {
                let difference = row(&tests.effect.difference, i);
                EffectPoint {
                    parameter: self.places.parameter(i),
                    surface_parameters: self.places.surface_parameters(i),
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

/// Groups that scatter unequally: that of the largest and that of the least unbiased spread, `√(n/(n−1))` times the spread about the
/// group's average, with both spreads; `None` if these differ by less than a quarter.
pub(crate) fn unequal_spreads<'a>(
    groups: impl Iterator<Item = &'a GroupRecord>,
) -> Option<[(f64, &'a GroupRecord); 2]> {
    let unbiased = |group: &GroupRecord| {
        let n = group.shapes as f64;
        group.spread * (n / (n - 1.0)).sqrt()
    };
    let mut spreads: Vec<(f64, &GroupRecord)> = groups.map(|group| (unbiased(group), group)).collect();
    spreads.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (narrow, wide) = (*spreads.first()?, *spreads.last()?);
    (wide.0 > UNEQUAL_SPREADS * narrow.0).then_some([wide, narrow])
}

/// How unequally groups scatter, in words.
pub(crate) fn scatter_text([(largest, wide), (least, narrow)]: [(f64, &GroupRecord); 2]) -> String {
    let (wide, narrow) = (&wide.name, &narrow.name);
    match least > 0.0 {
        true => format!(
            "the shapes of '{wide}' scatter {:.2} times as much as those of '{narrow}'",
            largest / least
        ),
        false => format!("the shapes of '{wide}' scatter, those of '{narrow}' are equal"),
    }
}

/// Warning about groups that scatter unequally.
fn spread_warning<'a>(groups: impl Iterator<Item = &'a GroupRecord>) -> Option<String> {
    let unequal = unequal_spreads(groups)?;
    let [(_, wide), (_, narrow)] = unequal;
    // Groups of nearly equal size: the smaller one has four fifths of the larger one.
    let follows = match (5 * wide.shapes < 4 * narrow.shapes, 4 * wide.shapes > 5 * narrow.shapes) {
        (true, _) => "the smaller group scatters more, so that all tests find differences too often",
        (_, true) => "the larger group scatters more, so that all tests find differences too seldom",
        _ => "Hotelling's test assumes equal covariances and finds differences too often",
    };
    Some(format!("{}: {follows}; the test `studentised` allows for it", scatter_text(unequal)))
}

/// `√(1 − ‖AᵀB‖²/I)` of two orthonormal bases of `I` columns.
fn chordal_distance((a, b): (&Matrix, &Matrix)) -> f64 {
    let cosines = transpose_multiply(a, b).norm_squared() / a.ncols() as f64;
    (1.0 - cosines).max(0.0).sqrt()
}

/// Applies Holm's correction for the number of pairs to the p values of every statistic and every size.
fn correct(pairs: &mut [PairRecord]) {
    let sizes = pairs.first().map_or(0, |pair| pair.sizes.len());
    let statistics: [fn(&mut PairRecord) -> &mut TestRecord; 3] =
        [|pair| &mut pair.distance.test, |pair| &mut pair.pseudo_f.test, |pair| &mut pair.hotelling.test];
    for of in statistics {
        correct_tests(pairs.iter_mut().map(of).collect());
    }
    let studentised = pairs.iter_mut().filter_map(|pair| pair.studentised.as_mut());
    correct_tests(studentised.map(|statistic| &mut statistic.test).collect());
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
