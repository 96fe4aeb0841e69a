//! The elastic mean of curves: the template whose product with the square-root velocities of all of them is largest.
//!
//! ```text
//! J(m) = (1/K) Σ_k max_{O, γ} ⟨m, O q̃_k * γ⟩,   ‖m‖ = 1,   q̃ = (√ε q, √(1 − ε) |q|)
//! ```
//!
//! Matches and template alternate: every curve is matched to the template, then `m` becomes the average of the matched velocities at unit
//! norm. Both steps raise `J`. Means are local maxima: what is reached depends on the start, which must not depend on the order of the
//! curves. `J` does not change when all maps are followed by one and the same map; in the end their mean is made the identity, so that the
//! parameter of the template is the average fraction of the length. Sums are taken in the order of what the curves hold.
//!
//! The template is no curve: its velocities do not close. The mean shape is the mean of the reparametrised curves.
//!
//! Source: Srivastava, Klassen, Joshi, Jermyn, *Shape analysis of elastic curves in Euclidean spaces* (TPAMI 2011), with the chordal mean in
//! place of Karcher's, whose rounds need not raise the objective.

use rayon::prelude::*;

use shapelex_geometry::curve::Curve;
use shapelex_geometry::resample::polygon_area;
use shapelex_numeric::dense::Matrix;

use super::curve::{ElasticCurve, Level, level_counts};
use super::pairing::{Found, Way, composed, inverse};
use super::program::Work;
use super::search::{follow, search};
use super::space::{ElasticMatch, ElasticSpace};
use super::strips::Strips;
use crate::AnalysisError;

/// Rounds after which all curves are searched anew, from every start and in every way.
const ANEW: usize = 8;
/// Gain of `J` in a round below which it stands still.
const LEAST_GAIN: f64 = 1e-6;
/// Rounds without gain after which a mean ends.
const STILL: usize = 2;
/// Most rounds; means of twenty curves take 14 to 60.
const MOST_ROUNDS: usize = 200;

/// Predicted rounds of a mean, searches anew among them, and seconds of a round for a hundred segments of one curve.
const USUAL_ROUNDS: f64 = 40.0;
const USUAL_SEARCHES: f64 = 6.0;
const FOLLOWING: f64 = 3e-5;

/// Velocities of a strip: a tangent, and the last coordinate.
type Velocity = [f64; 4];

/// A template of unit norm, to which curves are matched.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticTemplate {
    levels: ElasticCurve,
}

/// The elastic mean of some curves.
#[derive(Debug, Clone)]
pub struct ElasticMean {
    /// The template.
    pub template: ElasticTemplate,
    /// `J`, the mean cosine of the distances of the curves from the template: 1 if all curves are copies.
    pub objective: f64,
    /// `J` after each round.
    pub history: Vec<f64>,
    /// The match of every curve, in their order: its first curve is the template.
    pub matches: Vec<ElasticMatch>,
}

/// A curve that is matched to the template.
struct Member<'a> {
    given: &'a ElasticCurve,
    /// The curve as it is laid, unless that is as given.
    laid: Option<ElasticCurve>,
    /// From the template to the laid curve; its way is that of the curve.
    found: Found,
}

impl Member<'_> {
    fn curve(&self) -> &ElasticCurve {
        self.laid.as_ref().unwrap_or(self.given)
    }
}

impl ElasticTemplate {
    /// A template with these square-root velocities, of unit norm.
    fn new(velocities: &[Velocity], dimension: usize, closed: bool) -> Self {
        let level = |count| {
            let rows = coarser(velocities, count).into_iter().map(|row| row.map(|x| x as f32)).collect();
            Level::of_rows(rows, dimension, closed)
        };
        let levels = level_counts(velocities.len()).into_iter().map(level).collect();
        Self { levels: ElasticCurve { levels, spline: None, turned: false } }
    }

    /// Square-root velocities of the strips: `d` coordinates, zeros up to three, and the last coordinate.
    pub fn velocities(&self) -> &[[f32; 4]] {
        &self.levels.finest().rows
    }
}

impl ElasticSpace {
    /// The template that is a curve of these control points (coordinate-major) with its own parameter, such as a mean shape.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of polygons; [`AnalysisError::Unsuitable`] of a curve without length.
    pub fn template_of(&self, control_points: &[f64]) -> Result<ElasticTemplate, AnalysisError> {
        let (d, points) = (self.dimension(), self.settings().points);
        let matrix = Matrix::from_column_slice(control_points.len() / d, d, control_points);
        let curve = self.space().and_then(|space| Curve::of(space, &matrix));
        let curve = curve.ok_or_else(|| AnalysisError::Parameter {
            field: "representation",
            detail: "expected curves, got polygons".to_owned(),
        })?;
        let places: Vec<Vec<f64>> =
            (0..=points).map(|i| curve.evaluate(i as f64 / points as f64, 0)).collect();
        let velocity = |ends: &[Vec<f64>]| {
            let mut step = [0.0; 3];
            (0..d).for_each(|c| step[c] = ends[1][c] - ends[0][c]);
            let root = step.iter().map(|x| x * x).sum::<f64>().sqrt().sqrt();
            let unit = step.map(|x| if root > 0.0 { x / root } else { 0.0 });
            [unit[0], unit[1], unit[2], root]
        };
        let mut rows: Vec<Velocity> = places.windows(2).map(velocity).collect();
        let norm = self.norm(&rows);
        if !(norm > 0.0 && norm.is_finite()) {
            let detail = "expected a curve with a length, got one without".to_owned();
            return Err(AnalysisError::Unsuitable { index: 0, detail });
        }
        rows.iter_mut().flatten().for_each(|x| *x /= norm);
        let turned = self.orients() && {
            let corners = Matrix::from_fn(points, d, |i, c| places[i][c]);
            polygon_area(&corners) < 0.0
        };
        if turned {
            rows.reverse();
            rows.iter_mut().for_each(|row| (0..3).for_each(|c| row[c] = -row[c]));
        }
        let mut template = ElasticTemplate::new(&rows, d, self.is_closed());
        template.levels.turned = turned;
        Ok(template)
    }

    /// The match of a curve to a template, which stays as it is. Cost: [`ElasticSpace::seconds`].
    pub fn onto(&self, template: &ElasticTemplate, curve: &ElasticCurve) -> ElasticMatch {
        let found = self.searched(template, curve, &mut Work::default());
        self.answered(found, [template.levels.turned, curve.turned])
    }

    /// The elastic mean of some curves, from the best of some starts: usually the mean of the same curves under another correspondence.
    ///
    /// `go_on` receives the number of rounds that were completed and returns whether to continue.
    ///
    /// Cost: [`Self::mean_seconds`]; 14 to 60 rounds.
    ///
    /// # Errors
    /// [`AnalysisError::TooFewShapes`] without curves; [`AnalysisError::Interrupted`] once `go_on` returns false.
    pub fn mean(
        &self,
        curves: &[ElasticCurve],
        starts: &[ElasticCurve],
        go_on: &(dyn Fn(usize) -> bool + Sync),
    ) -> Result<ElasticMean, AnalysisError> {
        let mut order: Vec<usize> = (0..curves.len()).collect();
        order.sort_by(|&a, &b| curves[a].order(&curves[b]));
        let mut best: Option<ElasticMean> = None;
        for start in starts.iter().filter(|_| !curves.is_empty()) {
            let found = Rounds { space: self, order: &order }.run(curves, start, go_on)?;
            if best.as_ref().is_none_or(|best| found.objective > best.objective) {
                best = Some(found);
            }
        }
        best.ok_or(AnalysisError::TooFewShapes { found: 0, needed: 1 })
    }

    /// Predicted seconds of the mean of `count` curves on one thread.
    pub fn mean_seconds(&self, count: usize) -> f64 {
        let following = USUAL_ROUNDS * FOLLOWING * self.settings().points as f64 / 100.0;
        count as f64 * (USUAL_SEARCHES * self.seconds() + following)
    }

    fn searched(&self, template: &ElasticTemplate, curve: &ElasticCurve, work: &mut Work) -> Found {
        let found = search([&template.levels, curve], self.settings(), (self.is_closed(), self.ways()), work);
        found.laid(self.is_closed())
    }

    fn answered(&self, found: Found, turned: [bool; 2]) -> ElasticMatch {
        let distance = found.value.clamp(0.0, 1.0).acos();
        self.as_given(found, distance, turned)
    }

    fn strips<'a>(&self, template: &'a ElasticTemplate, curve: &'a ElasticCurve) -> Strips<'a> {
        Strips {
            first: template.velocities(),
            second: curve.finest(),
            elasticity: self.settings().elasticity,
            closed: self.is_closed(),
            turns: self.settings().rotation,
        }
    }

    /// The norm of some velocities.
    fn norm(&self, velocities: &[Velocity]) -> f64 {
        let e = self.settings().elasticity;
        let square = |v: &Velocity| e * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) + (1.0 - e) * v[3] * v[3];
        (velocities.iter().map(square).sum::<f64>() / velocities.len() as f64).sqrt()
    }
}

/// The rounds of a mean.
struct Rounds<'a> {
    space: &'a ElasticSpace,
    /// Positions of the curves in the order of what they hold.
    order: &'a [usize],
}

impl Rounds<'_> {
    fn run(
        &self,
        curves: &[ElasticCurve],
        start: &ElasticCurve,
        go_on: &(dyn Fn(usize) -> bool + Sync),
    ) -> Result<ElasticMean, AnalysisError> {
        let rows: Vec<Velocity> = start.finest().rows.iter().map(|row| row.map(f64::from)).collect();
        let mut template = ElasticTemplate::new(&rows, self.space.dimension(), self.space.is_closed());
        let mut members: Vec<Member<'_>> = Vec::new();
        let (mut history, mut still, mut is_new) = (Vec::new(), 0, false);
        // Whether `J` has risen since all curves were searched.
        let mut pending = true;
        for round in 0..MOST_ROUNDS {
            if !go_on(round) {
                return Err(AnalysisError::Interrupted);
            }
            let anew = round == 0 || round % ANEW == 0 || is_new;
            members = self.matched(curves, members, &template, (anew, round));
            let (next, objective) = self.averaged(&members, &template);
            template = next;
            let gain = objective - history.last().copied().unwrap_or(0.0);
            history.push(objective);
            let rises = gain >= LEAST_GAIN;
            pending = if anew { rises } else { pending || rises };
            still = if rises { 0 } else { still + 1 };
            is_new = still >= STILL && pending;
            if still >= STILL && !pending {
                break;
            }
        }
        Ok(self.finished(members, template, history))
    }

    /// Matches of all curves to a template, by searches if `anew`, else near those of the round before.
    fn matched<'c>(
        &self,
        curves: &'c [ElasticCurve],
        before: Vec<Member<'c>>,
        template: &ElasticTemplate,
        (anew, round): (bool, usize),
    ) -> Vec<Member<'c>> {
        let mut known: Vec<Option<Member<'c>>> = before.into_iter().map(Some).collect();
        known.resize_with(curves.len(), || None);
        let one = |work: &mut Work, (given, known): (&'c ElasticCurve, Option<Member<'c>>)| {
            let known = known.map(|mut member| {
                let strips = self.space.strips(template, member.laid.as_ref().unwrap_or(given));
                follow(&strips, &mut member.found, round, work);
                member
            });
            match known {
                Some(member) if !anew => member,
                known => {
                    let found = self.space.searched(template, given, work);
                    let kept = known.filter(|member| member.found.value >= found.value);
                    kept.unwrap_or_else(|| self.member(given, found))
                }
            }
        };
        curves.par_iter().zip(known).map_init(Work::default, one).collect()
    }

    fn member<'c>(&self, given: &'c ElasticCurve, found: Found) -> Member<'c> {
        let laid = |level: &Level| {
            Level::of_rows(found.way.lay(level), self.space.dimension(), self.space.is_closed())
        };
        let laid = (found.way != Way::default()).then(|| ElasticCurve {
            levels: vec![laid(given.finest())],
            spline: None,
            turned: given.turned,
        });
        Member { given, laid, found }
    }

    /// The template that fits the matches best, and its `J`.
    fn averaged(&self, members: &[Member<'_>], template: &ElasticTemplate) -> (ElasticTemplate, f64) {
        let average = |member: &Member<'_>| {
            let strips = self.space.strips(template, member.curve());
            strips.averages(&member.found.path, &member.found.rotation)
        };
        let averages: Vec<Vec<Velocity>> = members.par_iter().map(average).collect();
        let mut sum = vec![[0.0; 4]; template.velocities().len()];
        for &k in self.order {
            for (sum, own) in sum.iter_mut().zip(&averages[k]) {
                (0..4).for_each(|c| sum[c] += own[c]);
            }
        }
        let norm = self.space.norm(&sum);
        if !(norm > 0.0) {
            return (template.clone(), 0.0);
        }
        sum.iter_mut().flatten().for_each(|x| *x /= norm);
        let next = ElasticTemplate::new(&sum, self.space.dimension(), self.space.is_closed());
        (next, norm / members.len() as f64)
    }

    /// The mean with maps whose mean is the identity.
    fn finished(
        &self,
        mut members: Vec<Member<'_>>,
        template: ElasticTemplate,
        history: Vec<f64>,
    ) -> ElasticMean {
        let count = template.velocities().len();
        let mut mean = vec![0.0; count + 1];
        for &k in self.order {
            let path = &members[k].found.path;
            mean.iter_mut().zip(path).for_each(|(sum, t)| *sum += (t - path[0]) / self.order.len() as f64);
        }
        let mut back = inverse(&mean);
        (back[0], back[count]) = (0.0, 1.0);
        members.iter_mut().for_each(|member| member.found.path = composed(&member.found.path, &back));
        let rows: Vec<Velocity> = template.velocities().iter().map(|row| row.map(f64::from)).collect();
        let moved = moved(&rows, &back);
        let moved = ElasticTemplate::new(&moved, self.space.dimension(), self.space.is_closed());
        let (template, objective) = self.averaged(&members, &moved);
        let answered = |member: Member<'_>| {
            let strips = self.space.strips(&template, member.curve());
            let value = strips.sums(&member.found.path, &member.found.rotation).value;
            self.space.answered(Found { value, ..member.found }, [false, member.given.turned])
        };
        let matches = members.into_iter().map(answered).collect();
        ElasticMean { template, objective, history, matches }
    }
}

/// The averages of some velocities over `count` strips.
fn coarser(velocities: &[Velocity], count: usize) -> Vec<Velocity> {
    if count == velocities.len() {
        return velocities.to_vec();
    }
    let ratio = velocities.len() as f64 / count as f64;
    let average = |i: usize| over(velocities, [i as f64 * ratio, (i + 1) as f64 * ratio]).map(|x| x / ratio);
    (0..count).map(average).collect()
}

/// `m(β(s)) √β'(s)` on every strip.
fn moved(velocities: &[Velocity], back: &[f64]) -> Vec<Velocity> {
    let count = velocities.len() as f64;
    let strip = |ends: &[f64]| {
        let [from, to] = [ends[0], ends[1]].map(|s| count * s);
        // The mean over the strip, of length `to − from`, times the root of the slope.
        let root = (to - from).sqrt();
        over(velocities, [from, to]).map(|x| if root > 0.0 { x / root } else { 0.0 })
    };
    back.windows(2).map(strip).collect()
}

/// Integral of some velocities from one place to another, in strips.
fn over(velocities: &[Velocity], [from, to]: [f64; 2]) -> Velocity {
    let mut sum = [0.0; 4];
    let last = velocities.len() - 1;
    for j in (from as usize).min(last)..=(to as usize).min(last) {
        let part = to.min((j + 1) as f64) - from.max(j as f64);
        if part > 0.0 {
            (0..4).for_each(|c| sum[c] += part * velocities[j][c]);
        }
    }
    sum
}

/// Positions of `most` curves that stand for all of them, by the matrix of distances, row by row: each lowers the sum of the distances to
/// the nearest one most (Kaufman and Rousseeuw 1990, *build*). Of equal gains, the curve with the smaller sum of distances, then the first.
pub fn medoids(matrix: &[f64], most: usize) -> Vec<usize> {
    let count = matrix.len().isqrt();
    let row = |i: usize| &matrix[i * count..(i + 1) * count];
    let mut nearest = vec![f64::INFINITY; count];
    let mut chosen = Vec::new();
    while chosen.len() < most.min(count) {
        let rest = |i: usize| -> f64 { row(i).iter().zip(&nearest).map(|(d, known)| d.min(*known)).sum() };
        let best = (0..count).filter(|i| !chosen.contains(i)).min_by(|&a, &b| rest(a).total_cmp(&rest(b)));
        let Some(best) = best else { break };
        nearest.iter_mut().zip(row(best)).for_each(|(known, d)| *known = known.min(*d));
        chosen.push(best);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medoids_stand_for_the_groups() {
        let places: [f64; 7] = [0.0, 0.1, 0.2, 5.0, 5.1, 5.3, 9.0];
        let matrix: Vec<f64> = places.iter().flat_map(|a| places.map(|b| (a - b).abs())).collect();
        let mut found = medoids(&matrix, 3);
        assert_eq!(found[0], 3);
        found.sort_unstable();
        assert!(found[0] < 3, "{found:?}");
        assert_eq!(medoids(&matrix, 20).len(), 7);
        assert!(medoids(&[], 2).is_empty());
    }

    #[test]
    fn velocities_keep_their_norm_under_a_map() {
        let count = 64;
        let wave = |i: usize| [1.0, 0.1 * (i as f64 / 10.0).sin(), 0.0, 1.0];
        let velocities: Vec<Velocity> = (0..count).map(wave).collect();
        let bend = |s: f64| s + 0.05 * (std::f64::consts::TAU * s).sin() / std::f64::consts::TAU;
        let back: Vec<f64> = (0..=count).map(|i| bend(i as f64 / count as f64)).collect();
        let square = |all: &[Velocity]| -> f64 { all.iter().flatten().map(|x| x * x).sum() };
        let (before, after) = (square(&velocities), square(&moved(&velocities, &back)));
        assert!((after / before - 1.0).abs() < 1e-3, "{before} {after}");
        assert_eq!(coarser(&velocities, 64), velocities);
        assert!((coarser(&velocities, 32)[3][1] - 0.5 * (velocities[6][1] + velocities[7][1])).abs() < 1e-15);
    }
}
