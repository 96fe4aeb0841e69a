//! Alternation of the mean space of a set of shapes with the placements of the shapes on it.
//!
//! Each step raises `tr(P_S̄ Σ_k w_k P_k)`, so the alternation ends: with placements that no round changes, or after
//! [`MAX_ROUNDS`]. It begins with the shapes as given, or with placements known from a search of all.
//!
//! A large set of a class whose rounds are cheap is searched in stages: the first [`PART`] shapes, then twice as many, and so on,
//! then the largest multiple of `PART`, then all. Each stage begins with the mean of the one before. The last but one is the *leading* shapes: as long as
//! these stay the same, a search of more of them may begin with the placements that they had, and has the same result.

use super::AnalysisError;
use super::accumulate::{Leading, PART, ShapeSource, map_shapes, smallest_eligible};
use super::matching::{Matching, Moved, Placed, Placement, Target};
use super::mean::{Exchange, MeanSpace, ProjectorSum};
use super::metric::norm;
use super::subspace::Subspace;
use super::transformation::{Structure, TransformationClass};

/// Maximum number of rounds in which the mean and the placements alternate.
pub(super) const MAX_ROUNDS: usize = 1000;

/// Maximum number of rounds of a stage before the leading shapes: its mean is only where the next stage begins.
const STAGE_ROUNDS: usize = 16;

/// Relative difference below which two shapes are equally near to a mean space.
const TIE: f64 = 1e-12;

/// Shapes whose placements are searched, in the coordinates in which this takes place.
pub(super) trait PlacementSearch<'a> {
    /// Restricts the following rounds to the first `count` shapes.
    fn restrict(&mut self, count: usize);

    /// Sum of the projectors of the shapes in their placements.
    fn sum(&self, placements: &[Placement]) -> Result<ProjectorSum<'a>, AnalysisError>;

    /// The mean space of the shapes in their placements, without the sum of their projectors, from a space `near` it; `None` where
    /// the sum costs less. It has no certificate.
    fn mean(&self, near: Option<&MeanSpace<'a>>) -> Result<Option<MeanSpace<'a>>, AnalysisError> {
        let _ = near;
        Ok(None)
    }

    /// Cosine between every shape as given and `space`.
    fn cosines(&self, space: &MeanSpace<'a>) -> Result<Vec<f64>, AnalysisError>;

    /// Subspace of the shape `x`, which is at `position`, as a mean space.
    fn space_of(&self, position: usize, x: &[f64]) -> Result<MeanSpace<'a>, AnalysisError>;

    /// Places every shape on `space`; returns the shapes that moved.
    fn improve(
        &mut self,
        space: &MeanSpace<'a>,
        placements: &mut [Placement],
    ) -> Result<Vec<Moved>, AnalysisError>;

    /// The shapes that moved, before and after.
    fn exchanges(&self, placements: &[Placement], moved: &[Moved]) -> Result<Vec<Exchange>, AnalysisError>;
}

/// Outcome of a search.
#[derive(Debug, Clone)]
pub(super) struct Found {
    /// Placement of every shape.
    pub(super) placements: Vec<Placement>,
    /// Placements of the leading shapes when all were added; empty if all shapes were searched at once.
    pub(super) leading: Vec<Placement>,
    /// Rounds of the last stage.
    pub(super) rounds: usize,
    /// Whether the last round changed nothing.
    pub(super) converged: bool,
}

impl Found {
    /// The shapes of a set without a search.
    pub(super) fn as_given(count: usize) -> Self {
        Self {
            placements: vec![Placement::default(); count],
            leading: Vec::new(),
            rounds: 0,
            converged: true,
        }
    }
}

/// Placements with which a search begins.
#[derive(Debug, Clone)]
pub(super) struct Start {
    pub(super) placements: Vec<Placement>,
    /// Number of shapes whose placements an earlier search has found, the first ones.
    pub(super) known: usize,
}

impl Start {
    /// All shapes as given.
    pub(super) fn as_given(count: usize) -> Self {
        Self { placements: vec![Placement::default(); count], known: 0 }
    }

    /// Placements that the source knows of all or of the leading shapes, and the other shapes where their search begins: surfaces
    /// whose parameters move at their canonical position, all others as given.
    ///
    /// # Errors
    /// Errors of the source.
    pub(super) fn of(
        source: &dyn ShapeSource,
        stages: &[usize],
        matching: &Matching,
    ) -> Result<Self, AnalysisError> {
        let count = source.count();
        let known = source.known_placements()?.filter(|known| replaces_a_search(stages, known.len()));
        let mut placements = known.unwrap_or_default();
        let known = placements.len();
        if matching.moves() && known < count {
            let first = |k: usize, x: &[f64], _: f64| {
                Ok(placements.get(k).copied().unwrap_or_else(|| matching.first(x)))
            };
            placements = map_shapes(source, first)?;
        }
        placements.resize(count, Placement::default());
        Ok(Self { placements, known })
    }
}

/// Whether placements of the first `known` shapes are those of all, or of the leading ones. Those of other stages, which end after
/// fewer rounds here, would lead to another result.
fn replaces_a_search(stages: &[usize], known: usize) -> bool {
    stages.iter().rev().take(2).any(|stage| *stage == known)
}

/// Numbers of shapes of the stages of a search of `count` shapes, ascending.
pub(super) fn stages(count: usize) -> Vec<usize> {
    let leading = count.saturating_sub(1) / PART * PART;
    let doubled = std::iter::successors(Some(PART), |stage| stage.checked_mul(2));
    let first = doubled.take_while(|stage| *stage < leading);
    first.chain((leading > 0).then_some(leading)).chain([count]).collect()
}

/// Places the shapes of `source`, which stand as in `start`, in stages of so many shapes, the last of all.
///
/// # Errors
/// Errors of the source; degenerate shapes.
pub(super) fn alternate<'a, P: PlacementSearch<'a>>(
    search: &mut P,
    source: &dyn ShapeSource,
    matching: &Matching,
    stages: &[usize],
    start: Start,
) -> Result<Found, AnalysisError> {
    let (count, Start { placements, known }) = (source.count(), start);
    let mut found = Found { placements, ..Found::as_given(0) };
    // Placements of all shapes replace all stages but the last.
    let mut before = if known < count { known } else { 0 };
    let leading = stages.len().checked_sub(2).map_or(0, |at| stages[at]);
    for stage in stages.iter().copied().filter(|&stage| stage > known || stage == count) {
        if before > 0 {
            search.restrict(before);
            let space = mean(search, &found.placements)?;
            search.restrict(stage);
            search.improve(&space, &mut found.placements)?;
        } else {
            search.restrict(stage);
            if matching.mirrors() && known == 0 {
                match_mirrors(search, &Leading { source, count: stage }, &mut found.placements)?;
            }
        }
        if stage == count {
            found.leading = found.placements[..before].to_vec();
        }
        let most = if stage < leading { STAGE_ROUNDS } else { MAX_ROUNDS };
        settle(search, &Leading { source, count: stage }, &mut found, most)?;
        before = stage;
    }
    Ok(found)
}

/// Alternates the mean and the placements of the shapes of `source`, in at most `most` rounds.
fn settle<'a, P: PlacementSearch<'a>>(
    search: &mut P,
    source: &dyn ShapeSource,
    found: &mut Found,
    most: usize,
) -> Result<(), AnalysisError> {
    (found.rounds, found.converged) = (0, false);
    // The search needs the space alone; its certificate is computed at the end.
    let mut space = mean(search, &found.placements)?;
    let mut sum: Option<ProjectorSum<'_>> = None;
    while !found.converged && found.rounds < most {
        source.check()?;
        found.rounds += 1;
        let moved = search.improve(&space, &mut found.placements)?;
        found.converged = moved.is_empty();
        if found.converged {
            break;
        }
        if let Some(next) = search.mean(Some(&space))? {
            // A sum of an earlier round lacks the shapes of this one.
            (space, sum) = (next, None);
        } else {
            let mut next = match exchanged(search, &found.placements[..source.count()], &moved, sum.take())? {
                Some(sum) => sum,
                None => search.sum(&found.placements)?,
            };
            space = MeanSpace::near(&mut next, &space)?;
            sum = Some(next);
        }
    }
    Ok(())
}

/// The mean space of the shapes in their placements.
fn mean<'a, P: PlacementSearch<'a>>(
    search: &P,
    placements: &[Placement],
) -> Result<MeanSpace<'a>, AnalysisError> {
    match search.mean(None)? {
        Some(space) => Ok(space),
        None => MeanSpace::new(search.sum(placements)?, 0),
    }
}

/// The sum of projectors after the shapes `moved`. `None` if recomputing it from scratch costs less.
fn exchanged<'a, P: PlacementSearch<'a>>(
    search: &P,
    placements: &[Placement],
    moved: &[Moved],
    sum: Option<ProjectorSum<'a>>,
) -> Result<Option<ProjectorSum<'a>>, AnalysisError> {
    let Some(mut sum) = sum.filter(|_| moved.len() * 4 < placements.len()) else { return Ok(None) };
    let exchanges = search.exchanges(placements, moved)?;
    Ok(sum.exchange(&exchanges)?.then_some(sum))
}

/// Places the shapes of `source` on the one nearest to their mean space. Mirror images are first decided against this shape: the
/// mean of a set in which half of the shapes are mirrored is symmetric and would prefer neither side.
fn match_mirrors<'a, P: PlacementSearch<'a>>(
    search: &mut P,
    source: &dyn ShapeSource,
    placements: &mut [Placement],
) -> Result<(), AnalysisError> {
    let cosines = search.cosines(&mean(search, placements)?)?;
    let best = cosines.iter().copied().fold(0.0, f64::max);
    let (position, x) = smallest_eligible(source, |k| cosines[k] >= best * (1.0 - TIE))?;
    let single = search.space_of(position, &x)?;
    search.improve(&single, placements)?;
    Ok(())
}

/// Shapes that are read from their source in every round.
pub(super) struct StreamedSearch<'a, 's> {
    shapes: Leading<'s>,
    class: &'a TransformationClass,
    matching: &'s Matching,
    /// Numbers of a shape, `d·N`.
    length: usize,
}

impl<'a, 's> StreamedSearch<'a, 's> {
    /// A search of all shapes of `source`, of `length` numbers each.
    pub(super) fn new(
        source: &'s dyn ShapeSource,
        class: &'a TransformationClass,
        matching: &'s Matching,
        length: usize,
    ) -> Self {
        Self { shapes: Leading { source, count: source.count() }, class, matching, length }
    }
}

impl<'a> PlacementSearch<'a> for StreamedSearch<'a, '_> {
    fn restrict(&mut self, count: usize) {
        self.shapes.count = count;
    }

    fn sum(&self, placements: &[Placement]) -> Result<ProjectorSum<'a>, AnalysisError> {
        let Self { shapes: source, matching, .. } = self;
        ProjectorSum::of(&Placed { source, matching, placements }, self.class, self.length)
    }

    fn cosines(&self, space: &MeanSpace<'a>) -> Result<Vec<f64>, AnalysisError> {
        let cosine = |x: &[f64]| norm(&space.project(x)) / norm(x);
        if self.class.structure != Structure::Complex {
            return map_shapes(&self.shapes, |_, x, _| Ok(cosine(x)));
        }
        // A reflected shape is not in its own subspace.
        map_shapes(&self.shapes, |k, x, _| {
            let mut basis = vec![0.0; x.len()];
            Subspace::write_basis(self.class, x, 1.0, &mut basis).map_err(|error| error.at(k))?;
            Ok(cosine(&basis))
        })
    }

    fn space_of(&self, _: usize, x: &[f64]) -> Result<MeanSpace<'a>, AnalysisError> {
        MeanSpace::from_shape(self.class, x)
    }

    fn improve(
        &mut self,
        space: &MeanSpace<'a>,
        placements: &mut [Placement],
    ) -> Result<Vec<Moved>, AnalysisError> {
        self.matching.improve(&self.shapes, &Target::subspace(space, self.matching), placements)
    }

    fn exchanges(&self, placements: &[Placement], moved: &[Moved]) -> Result<Vec<Exchange>, AnalysisError> {
        let mut exchanges = Vec::with_capacity(moved.len());
        let mut left = moved.iter().peekable();
        self.shapes.for_each_batch(&mut |batch| {
            let length = batch.whitened.len() / batch.weights.len().max(1);
            while let Some(&(k, before)) = left.next_if(|(k, _)| *k < batch.first + batch.weights.len()) {
                let i = k - batch.first;
                let x = &batch.whitened[i * length..(i + 1) * length];
                let leaving = self.matching.place(x, before).into_owned();
                let arriving = self.matching.place(x, placements[k]).into_owned();
                exchanges.push(Exchange { leaving, arriving, weight: batch.weights[i] });
            }
            Ok(())
        })?;
        Ok(exchanges)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_leading_shapes_of_a_set_replace_its_first_stages() {
        assert_eq!(stages(PART), [PART]);
        assert_eq!(stages(3 * PART + 1), [PART, 2 * PART, 3 * PART, 3 * PART + 1]);
        let stages = stages(3 * PART + 1);
        assert!(replaces_a_search(&stages, 3 * PART) && replaces_a_search(&stages, 3 * PART + 1));
        // Leading shapes of a smaller set: there they had all their rounds.
        assert!(!replaces_a_search(&stages, 2 * PART) && !replaces_a_search(&stages, 0));
    }
}
