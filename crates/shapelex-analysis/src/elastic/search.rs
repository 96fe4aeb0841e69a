//! The search of a pair: coarse programs from several starts, wide ones from the best of these, fine ones and a refinement at the end.

use super::candidates::{candidates, product};
use super::curve::ElasticCurve;
use super::pairing::{Found, Way, composed};
use super::program::{Band, Work, improve};
use super::settings::{Effort, ElasticSettings};
use super::strips::Strips;
use super::{IDENTITY, Rotation};

/// Band of the coarse programs: a sixth of the length on either side, slopes up to 4.
const COARSE: Band = Band { cells: 1, width: 16, steps: 4 };
/// Band of the coarse programs of open curves, which have one start.
const COARSE_OPEN: Band = Band { cells: 1, width: 32, steps: 4 };
/// Band of the wide programs: ten segments on either side, slopes 0 to 6 in halves. Slopes between 0 and 1 decide between paths.
const WIDE: Band = Band { cells: 2, width: 40, steps: 12 };
/// Band in place of the wide one, with little effort.
const NARROW: Band = Band { cells: 1, width: 16, steps: 4 };
/// Band of the fine programs: two segments on either side.
const FINE: Band = Band { cells: 4, width: 16, steps: 16 };

/// Difference of values within which the second best path is followed too.
const CLOSE: f64 = 0.004;
/// Gain of a fine program below which there is no other.
const LEAST_GAIN: f64 = 1e-5;
/// Factor by which turns become smaller above which they have no limit that is near.
const MOST_CONTRACTION: f64 = 0.9;
/// Largest distance of two paths on the coarse polygon, in segments, that count as one.
const SAME: f64 = 1.5;

/// Differences to the best value from which matches are given up: after coarse programs, before wide ones, and after these. Of 404 pairs of
/// silhouettes, all had the same distance without it.
const HOPELESS: [f64; 3] = [0.1, 0.03, 0.01];

/// Strips on either side of a place that are relaxed together with it, one after the other.
const SPACINGS: [usize; 3] = [16, 7, 3];

/// Numbers of an effort.
struct Plan {
    /// Whether hopeless matches are given up.
    drops: bool,
    candidates: usize,
    kept: usize,
    wide: Band,
    wide_rounds: usize,
    fine_rounds: usize,
    /// Relaxations of many places together.
    relaxations: usize,
    sweeps: usize,
}

impl Plan {
    fn of(effort: Effort) -> Self {
        match effort {
            Effort::Fast => Self {
                drops: true,
                candidates: 4,
                kept: 2,
                wide: NARROW,
                wide_rounds: 1,
                fine_rounds: 2,
                relaxations: 0,
                sweeps: 0,
            },
            Effort::Normal => Self {
                drops: true,
                candidates: 6,
                kept: 3,
                wide: WIDE,
                wide_rounds: 2,
                fine_rounds: 4,
                relaxations: 1,
                sweeps: 3,
            },
            Effort::Thorough => Self {
                drops: false,
                candidates: 12,
                kept: 8,
                wide: WIDE,
                wide_rounds: 2,
                fine_rounds: 4,
                relaxations: 4,
                sweeps: 10,
            },
        }
    }
}

impl Plan {
    /// Leaves out the matches that are far from the best one.
    fn drop_hopeless(&self, all: &mut Vec<Found>, stage: usize) {
        let least = best(all) - HOPELESS[stage];
        all.retain(|found| !self.drops || found.value >= least);
    }
}

/// The largest value.
fn best(all: &[Found]) -> f64 {
    all.iter().map(|found| found.value).fold(f64::NEG_INFINITY, f64::max)
}

/// A pair at one level, for each way to lay the first curve.
struct Pair<'a> {
    first: &'a ElasticCurve,
    second: &'a ElasticCurve,
    settings: &'a ElasticSettings,
    closed: bool,
    /// Square-root velocities of the first curve, by level and way.
    laid: Vec<Vec<Vec<[f32; 4]>>>,
    ways: &'a [Way],
}

/// The best match that is found, from `first`, laid in one of `ways`, to `second`.
pub(super) fn search(
    [first, second]: [&ElasticCurve; 2],
    settings: &ElasticSettings,
    (closed, ways): (bool, &[Way]),
    work: &mut Work,
) -> Found {
    let lay = |level| ways.iter().map(|way| way.lay(level)).collect();
    let laid = first.levels.iter().map(lay).collect();
    let pair = Pair { first, second, settings, closed, laid, ways };
    pair.search(&Plan::of(settings.effort), work)
}

impl Pair<'_> {
    fn strips(&self, level: usize, way: Way) -> Strips<'_> {
        let position = self.ways.iter().position(|other| *other == way).unwrap_or_default();
        Strips {
            first: &self.laid[level][position],
            second: &self.second.levels[level],
            elasticity: self.settings.elasticity,
            closed: self.closed,
            turns: self.settings.rotation,
        }
    }

    fn search(&self, plan: &Plan, work: &mut Work) -> Found {
        let start = |&way: &Way| candidates(&self.strips(0, way), way, plan.candidates);
        let mut starts: Vec<Found> = self.ways.iter().flat_map(start).collect();
        let band = if self.closed { COARSE } else { COARSE_OPEN };
        for round in 0..2 {
            self.steps(&mut starts, 0, (band, [round, 2]), work);
            plan.drop_hopeless(&mut starts, 0);
        }
        let mut kept = self.kept(starts, plan.kept);
        plan.drop_hopeless(&mut kept, 1);
        for round in 0..plan.wide_rounds {
            self.steps(&mut kept, 1, (plan.wide, [2 * round + 1, 4]), work);
            plan.drop_hopeless(&mut kept, 2);
        }
        let mut kept = self.kept(kept, 2);
        let best = best(&kept);
        kept.retain(|found| found.value >= best - CLOSE);
        kept.iter_mut().for_each(|found| self.finish(found, plan, work));
        let better = |one: Found, two: Found| if two.value > one.value { two } else { one };
        let mut found = kept.into_iter().reduce(better).unwrap_or_else(|| self.nothing());
        self.settle(&mut found, plan);
        found
    }

    /// A program for each match, at one level, cut at a part `share / of` of all strips.
    fn steps(
        &self,
        all: &mut [Found],
        level: usize,
        (band, [share, of]): (Band, [usize; 2]),
        work: &mut Work,
    ) {
        for found in all {
            found.path = resampled(&found.path, self.first.levels[level].count);
            let strips = self.strips(level, found.way);
            step(&strips, found, (band, cut(&strips, share, of)), work);
        }
    }

    /// Steps at the finest levels.
    fn finish(&self, found: &mut Found, plan: &Plan, work: &mut Work) {
        let last = self.first.levels.len() - 1;
        for level in 2..=last {
            found.path = resampled(&found.path, self.first.levels[level].count);
            let strips = self.strips(level, found.way);
            step(&strips, found, (FINE, cut(&strips, level, 3)), work);
        }
        let strips = self.strips(last, found.way);
        let (mut best, mut turn) = (found.clone(), 0.0);
        for round in 0..plan.fine_rounds {
            step(&strips, found, (FINE, cut(&strips, round + 1, 3)), work);
            let gain = found.value - best.value;
            if gain > 0.0 {
                let delta = product(&found.rotation, &transposed(&best.rotation));
                let before = std::mem::replace(&mut turn, angle(&delta));
                best = found.clone();
                for _ in 0..turns_ahead(turn, before) {
                    found.rotation = product(&delta, &found.rotation);
                }
            }
            if gain < LEAST_GAIN {
                break;
            }
        }
        *found = best;
    }

    /// Exact moves of the places at the finest level.
    fn settle(&self, found: &mut Found, plan: &Plan) {
        let strips = self.strips(self.first.levels.len() - 1, found.way);
        for _ in 0..plan.relaxations {
            for spacing in SPACINGS.into_iter().filter(|spacing| 4 * spacing <= strips.count()) {
                strips.relax(&mut found.path, &found.rotation, spacing);
            }
            (found.rotation, _) = strips.rotation(&strips.sums(&found.path, &found.rotation));
        }
        for _ in 0..plan.sweeps {
            strips.refine(&mut found.path, &found.rotation);
            (found.rotation, _) = strips.rotation(&strips.sums(&found.path, &found.rotation));
        }
        found.value = strips.sums(&found.path, &found.rotation).value;
    }

    /// The best `most` of some matches, each of them once.
    fn kept(&self, mut all: Vec<Found>, most: usize) -> Vec<Found> {
        all.sort_by(|a, b| b.value.total_cmp(&a.value));
        let mut kept: Vec<Found> = Vec::new();
        for found in all {
            if kept.len() < most && !kept.iter().any(|other| self.is_same(other, &found)) {
                kept.push(found);
            }
        }
        kept
    }

    fn is_same(&self, one: &Found, two: &Found) -> bool {
        let near = SAME / self.first.levels[0].count as f64;
        let apart = |(s, t): (&f64, &f64)| {
            let apart = if self.closed { (s - t).rem_euclid(1.0) } else { (s - t).abs() };
            if self.closed { apart.min(1.0 - apart) } else { apart }
        };
        one.way == two.way && one.path.iter().zip(&two.path).all(|places| apart(places) < near)
    }

    /// The match of equal fractions, which no search begins without.
    fn nothing(&self) -> Found {
        let count = self.first.finest().count;
        let path = (0..=count).map(|i| i as f64 / count as f64).collect();
        Found { way: self.ways[0], rotation: IDENTITY, path, value: 0.0 }
    }
}

/// Strip at which a closed path is cut: the part `share / of` of all.
fn cut(strips: &Strips<'_>, share: usize, of: usize) -> usize {
    if strips.closed { share % of * strips.count() / of } else { 0 }
}

/// A program, and the best rotation for the path that it gives.
fn step(strips: &Strips<'_>, found: &mut Found, (band, cut): (Band, usize), work: &mut Work) {
    improve(strips, &mut found.path, (&found.rotation, cut), band, work);
    (found.rotation, found.value) = strips.rotation(&strips.sums(&found.path, &found.rotation));
}

/// The number of times that a rotation is turned again, if it turned by `now` after `before`: paths and rotations alternate, and
/// rotations approach their limit by a constant factor.
fn turns_ahead(now: f64, before: f64) -> usize {
    let factor = if before > 0.0 { now / before } else { 0.0 };
    if factor < MOST_CONTRACTION { (factor / (1.0 - factor)).round() as usize } else { 0 }
}

/// Angle of a rotation.
fn angle(rotation: &Rotation) -> f64 {
    (0.5 * (rotation[0][0] + rotation[1][1] + rotation[2][2] - 1.0)).clamp(-1.0, 1.0).acos()
}

fn transposed(rotation: &Rotation) -> Rotation {
    let mut transposed = *rotation;
    (0..3).for_each(|r| (0..3).for_each(|c| transposed[r][c] = rotation[c][r]));
    transposed
}

/// Follows a match to a template that has moved: a fine program around its path, exact moves of its places, and the best rotation. Its value,
/// that under this template, is not below that of the path as it was.
pub(super) fn follow(strips: &Strips<'_>, found: &mut Found, round: usize, work: &mut Work) {
    (found.rotation, found.value) = strips.rotation(&strips.sums(&found.path, &found.rotation));
    let mut next = found.clone();
    step(strips, &mut next, (FINE, cut(strips, round, 3)), work);
    strips.refine(&mut next.path, &next.rotation);
    (next.rotation, next.value) = strips.rotation(&strips.sums(&next.path, &next.rotation));
    if next.value > found.value {
        *found = next;
    }
}

/// A path at `count + 1` places, by linear interpolation.
fn resampled(path: &[f64], count: usize) -> Vec<f64> {
    if path.len() == count + 1 {
        return path.to_vec();
    }
    let places: Vec<f64> = (0..=count).map(|i| i as f64 / count as f64).collect();
    composed(path, &places)
}
