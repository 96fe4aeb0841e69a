//! Alternation of the mean space of a set of shapes with the placements of the shapes on it.
//!
//! Each step raises `tr(P_S̄ Σ_k w_k P_k)`, so the alternation ends: with placements that no round changes, or after
//! [`MAX_ROUNDS`]. It begins with the shapes as given, or with placements known from a search of most of them.

use super::AnalysisError;
use super::accumulate::{ShapeSource, map_shapes, smallest_eligible};
use super::matching::{Matching, Moved, Placed, Placement, Target};
use super::mean::{Exchange, MeanSpace, ProjectorSum};
use super::metric::norm;
use super::subspace::Subspace;
use super::transformation::{Structure, TransformationClass};

/// Maximum number of rounds in which the mean and the placements alternate.
pub(super) const MAX_ROUNDS: usize = 1000;

/// Relative difference below which two shapes are equally near to a mean space.
const TIE: f64 = 1e-12;

/// Shapes whose placements are searched, in the coordinates in which this takes place.
pub(super) trait PlacementSearch<'a> {
    /// Error of a round.
    type Error: From<AnalysisError>;

    /// Sum of the projectors of the shapes in their placements.
    fn sum(&self, placements: &[Placement]) -> Result<ProjectorSum<'a>, Self::Error>;

    /// Cosine between every shape as given and `space`.
    fn cosines(&self, space: &MeanSpace<'a>) -> Result<Vec<f64>, Self::Error>;

    /// Subspace of the shape `x`, which is at `position`, as a mean space.
    fn space_of(&self, position: usize, x: &[f64]) -> Result<MeanSpace<'a>, Self::Error>;

    /// Places every shape on `space`; returns the shapes that moved.
    fn improve(
        &mut self,
        space: &MeanSpace<'a>,
        placements: &mut Vec<Placement>,
    ) -> Result<Vec<Moved>, Self::Error>;

    /// The shapes that moved, before and after.
    fn exchanges(&self, placements: &[Placement], moved: &[Moved]) -> Result<Vec<Exchange>, Self::Error>;
}

/// Outcome of a search.
#[derive(Debug, Clone)]
pub(super) struct Found {
    /// Placement of every shape.
    pub(super) placements: Vec<Placement>,
    pub(super) rounds: usize,
    /// Whether the last round changed nothing.
    pub(super) converged: bool,
}

impl Found {
    /// The shapes of a set without a search.
    pub(super) fn as_given(count: usize) -> Self {
        Self { placements: vec![Placement::default(); count], rounds: 0, converged: true }
    }
}

/// Placements with which a search begins.
#[derive(Debug, Clone)]
pub(super) struct Start {
    pub(super) placements: Vec<Placement>,
    /// Whether an earlier search has found them.
    pub(super) known: bool,
}

impl Start {
    /// All shapes as given.
    pub(super) fn as_given(count: usize) -> Self {
        Self { placements: vec![Placement::default(); count], known: false }
    }

    /// Placements that the source knows, or else the shapes as given.
    ///
    /// # Errors
    /// Errors of the source.
    pub(super) fn of<S: ShapeSource>(source: &S) -> Result<Self, S::Error> {
        let known = source.known_placements()?.filter(|known| known.len() == source.count());
        let as_known = |placements| Self { placements, known: true };
        Ok(known.map_or_else(|| Self::as_given(source.count()), as_known))
    }
}

/// Places the shapes of `source`, which stand as in `start`.
///
/// # Errors
/// Errors of the source; degenerate shapes.
pub(super) fn alternate<'a, S: ShapeSource, P: PlacementSearch<'a>>(
    search: &mut P,
    source: &S,
    matching: &Matching,
    start: Start,
) -> Result<Found, S::Error>
where
    S::Error: From<P::Error>,
{
    let mut found = Found { placements: start.placements, rounds: 0, converged: false };
    // The search needs the space alone; its certificate is computed at the end.
    let mut space = MeanSpace::new(search.sum(&found.placements)?, 0)?;
    if matching.mirrors() && !start.known {
        let single = best_matched(search, source, &space)?;
        search.improve(&single, &mut found.placements)?;
        space = MeanSpace::new(search.sum(&found.placements)?, 0)?;
    }
    let mut sum: Option<ProjectorSum<'_>> = None;
    while !found.converged && found.rounds < MAX_ROUNDS {
        source.check()?;
        found.rounds += 1;
        let moved = search.improve(&space, &mut found.placements)?;
        found.converged = moved.is_empty();
        if !found.converged {
            let next = match exchanged(search, &found.placements, &moved, sum.take())? {
                Some(sum) => sum,
                None => search.sum(&found.placements)?,
            };
            space = MeanSpace::near(next.clone(), &space)?;
            sum = Some(next);
        }
    }
    Ok(found)
}

/// The sum of projectors after the shapes `moved`. `None` if recomputing it from scratch costs less.
fn exchanged<'a, P: PlacementSearch<'a>>(
    search: &P,
    placements: &[Placement],
    moved: &[Moved],
    sum: Option<ProjectorSum<'a>>,
) -> Result<Option<ProjectorSum<'a>>, P::Error> {
    let Some(mut sum) = sum.filter(|_| moved.len() * 4 < placements.len()) else { return Ok(None) };
    let exchanges = search.exchanges(placements, moved)?;
    Ok(sum.exchange(&exchanges)?.then_some(sum))
}

/// The shape nearest to the mean space. Mirror images are first decided against this shape: the mean of a set in
/// which half of the shapes are mirrored is symmetric and would prefer neither side.
fn best_matched<'a, S: ShapeSource, P: PlacementSearch<'a>>(
    search: &P,
    source: &S,
    space: &MeanSpace<'a>,
) -> Result<MeanSpace<'a>, S::Error>
where
    S::Error: From<P::Error>,
{
    let cosines = search.cosines(space)?;
    let best = cosines.iter().copied().fold(0.0, f64::max);
    let (position, x) = smallest_eligible(source, |k| cosines[k] >= best * (1.0 - TIE))?;
    Ok(search.space_of(position, &x)?)
}

/// Shapes that are read from their source in every round.
pub(super) struct StreamedSearch<'a, 's, S> {
    pub(super) source: &'s S,
    pub(super) class: &'a TransformationClass,
    pub(super) matching: &'s Matching,
    /// Numbers of a shape, `d·N`.
    pub(super) length: usize,
}

impl<'a, S: ShapeSource> PlacementSearch<'a> for StreamedSearch<'a, '_, S> {
    type Error = S::Error;

    fn sum(&self, placements: &[Placement]) -> Result<ProjectorSum<'a>, S::Error> {
        let Self { source, matching, .. } = *self;
        ProjectorSum::of(&Placed { source, matching, placements }, self.class, self.length)
    }

    fn cosines(&self, space: &MeanSpace<'a>) -> Result<Vec<f64>, S::Error> {
        let cosine = |x: &[f64]| norm(&space.project(x)) / norm(x);
        if self.class.structure != Structure::Complex {
            return map_shapes(self.source, |_, x, _| Ok(cosine(x)));
        }
        // A reflected shape is not in its own subspace.
        map_shapes(self.source, |k, x, _| {
            let mut basis = vec![0.0; x.len()];
            Subspace::write_basis(self.class, x, 1.0, &mut basis).map_err(|error| error.at(k))?;
            Ok(cosine(&basis))
        })
    }

    fn space_of(&self, _: usize, x: &[f64]) -> Result<MeanSpace<'a>, S::Error> {
        Ok(MeanSpace::from_shape(self.class, x)?)
    }

    fn improve(
        &mut self,
        space: &MeanSpace<'a>,
        placements: &mut Vec<Placement>,
    ) -> Result<Vec<Moved>, S::Error> {
        self.matching.improve(self.source, &Target::subspace(space, self.matching), placements)
    }

    fn exchanges(&self, placements: &[Placement], moved: &[Moved]) -> Result<Vec<Exchange>, S::Error> {
        let mut exchanges = Vec::with_capacity(moved.len());
        let mut left = moved.iter().peekable();
        self.source.for_each_batch(&mut |batch| {
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
