//! Segmentation of an object: stages of minimisation from coarse to fine, each followed by a check.
//!
//! ```text
//! E = Σ w_i E_i (image) + κ A/A₀ + ρ E_ρ + γ E_prior + ω E_box
//! ```
//!
//! * [`scene`] — an image with its fields, prepared once for any number of objects;
//! * [`check`](mod@check) — folds, shapes that leave the image, and collapse;
//! * [`nested`] — models of control meshes that stages split;
//! * [`moved`] — a result beside its start: shapes that have left their object.
//!
//! A stage whose result fails the check is repeated from its start with `10 ρ` and half of the clip, twice at most.

pub mod check;
pub mod moved;
pub mod nested;
pub mod scene;

use std::sync::Arc;

use shapelex_numeric::bounded::Stop;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::descent::{Ending, Minimum, Objective, Rules};
use shapelex_numeric::newton::Curved;
use shapelex_numeric::sparse::SparseRows;
use shapelex_numeric::{coordinates, lbfgs, newton};

use crate::SegmentationError;
use crate::blur::Blur;
use crate::boundary::Boundary;
use crate::energy::{BoundaryCost, Energy, Hold, Prior, Shape, Spacing, Term, TermValue, Wall};
use crate::snake::Model;
use crate::snake::reparametrisation::{Free, Reparametrisation};
use check::{Fault, check};
use moved::Moved;
use scene::{Measures, Scene};

/// Factor on `ρ` and on the clip when a stage is repeated.
const REPAIR: (f64, f64) = (10.0, 0.5);
/// `ρ` of the first repetition if it was zero.
const LEAST_SPACING: f64 = 0.1;
/// `ω`: a boundary that is a tenth of the half sides beyond the wall everywhere costs as much as an edge gains.
const WALL: f64 = 100.0;
/// Number of free points from which the clip is halved.
const MANY: usize = 100;

/// A stage of a segmentation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// The free part.
    pub free: Free,
    /// Blur of the image; one of those of the scene.
    pub sigma: Blur,
    /// Maximum number of iterations.
    pub iterations: usize,
}

impl Stage {
    /// A stage with the usual number of iterations.
    pub fn new(free: Free, sigma: impl Into<Blur>) -> Self {
        Self { free, sigma: sigma.into(), iterations: 150 }
    }
}

/// A model with the number of stages that it runs. Models of nested shapes follow each other from coarse to fine.
#[derive(Clone, Copy)]
pub struct Level<'a, const D: usize> {
    /// The model.
    pub model: &'a dyn Model<D>,
    /// Map from the free points of the level before to those of the same shape in this one; `None`: they are the same.
    pub step: Option<&'a SparseRows>,
    /// Number of stages, of those of the settings in order.
    pub stages: usize,
}

/// How the energy of a stage is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Quasi-Newton steps, for all models: see [`lbfgs`].
    #[default]
    Lbfgs,
    /// Damped Newton steps with the curvature along the boundary, for planar curves: see [`newton`].
    Newton,
    /// One point after the other, as in papers on snakes: see [`coordinates`].
    Coordinates,
}

/// Weights and rules of a segmentation.
#[derive(Debug, Clone)]
pub struct Settings<const D: usize> {
    /// Stages in order, from coarse to fine.
    pub stages: Vec<Stage>,
    /// `κ`, the cost of the boundary.
    pub boundary: f64,
    /// `ρ`, the cost of uneven spacing.
    pub spacing: f64,
    /// The prior with its weight `γ`.
    pub prior: Option<(Prior<D>, f64)>,
    /// Displacement below which a step is small, in cells.
    pub tolerance: f64,
    /// Largest displacement of a step, in cells; half of it with more than 100 free points.
    pub clip: f64,
    /// Number of times that a stage may be repeated after a failed check.
    pub repairs: usize,
    /// The method of minimisation.
    pub method: Method,
    /// Factor by which the box around the first shape is scaled, beyond which the boundary costs; `None`: it may go anywhere.
    pub wall: Option<f64>,
    /// `η`, the weight of the attraction to the first shape.
    pub hold: f64,
    /// Factor between the sizes of the result and the first shape beyond which the result has left its object; `None`: results are
    /// not compared. See [`Moved::has_left`].
    pub size_factor: Option<f64>,
}

impl<const D: usize> Settings<D> {
    /// Usual rules without `κ`, a prior, a wall and a comparison of sizes: `ρ = 0.1`, steps of at most 2 cells, to 0.005 cells in the plane and 0.01 in space.
    pub fn new(stages: Vec<Stage>) -> Self {
        let tolerance = if D == 2 { 0.005 } else { 0.01 };
        let (clip, repairs, method) = (2.0, 2, Method::default());
        let (boundary, spacing, prior) = (0.0, 0.1, None);
        let (wall, hold, size_factor) = (None, 0.0, None);
        Self { stages, boundary, spacing, prior, tolerance, clip, repairs, method, wall, hold, size_factor }
    }
}

/// Reason for which a segmentation ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The last stage converged.
    Converged,
    /// The last stage reached its number of iterations.
    Limit,
    /// No step decreased the energy of the last stage: normal at the level of the noise.
    LineSearch,
    /// A stage folded the shape; the result is that of the stage before.
    Folded,
    /// A stage moved the shape out of the image; the result is that of the stage before.
    LeftImage,
    /// A stage shrank the shape to nothing; the result is that of the stage before.
    Collapsed,
    /// The result is of another size than the first shape, or somewhere else.
    LeftObject,
    /// The caller wanted to stop.
    Stopped,
}

impl Outcome {
    /// Whether the last stage ended by its own rules, with a shape that passed the check.
    fn has_ended(self) -> bool {
        matches!(self, Self::Converged | Self::Limit | Self::LineSearch)
    }

    /// Name in answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Limit => "limit",
            Self::LineSearch => "line_search",
            Self::Folded => "folded",
            Self::LeftImage => "left_image",
            Self::Collapsed => "collapsed",
            Self::LeftObject => "left_object",
            Self::Stopped => "stopped",
        }
    }
}

impl From<Ending> for Outcome {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Converged => Self::Converged,
            Ending::Limit => Self::Limit,
            Ending::LineSearch => Self::LineSearch,
            Ending::Stopped => Self::Stopped,
        }
    }
}

impl From<Fault> for Outcome {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Folded => Self::Folded,
            Fault::LeftImage => Self::LeftImage,
            Fault::Collapsed => Self::Collapsed,
        }
    }
}

/// Report on one run of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct StageReport {
    /// Position of the stage.
    pub stage: usize,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of evaluations of the energy and its gradient.
    pub evaluations: usize,
    /// Energy at the start and after every iteration.
    pub history: Vec<f64>,
    /// `ρ` that was used.
    pub spacing: f64,
    /// Why the minimisation ended.
    pub ending: Ending,
    /// Fault found by the check.
    pub fault: Option<Fault>,
}

/// Result of a segmentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Segmentation<const D: usize> {
    /// Free points of the last level in index coordinates.
    pub rows: Vec<[f64; D]>,
    /// Why the segmentation ended.
    pub outcome: Outcome,
    /// Terms of the energy of the last stage, at the result.
    pub terms: Vec<TermValue>,
    /// Runs of stages in order, with those that failed the check.
    pub stages: Vec<StageReport>,
    /// The result beside the first shape.
    pub moved: Moved<D>,
}

impl<const D: usize> Segmentation<D> {
    /// Number of iterations of all runs.
    pub fn iterations(&self) -> usize {
        self.stages.iter().map(|stage| stage.iterations).sum()
    }
}

/// The energy of a shape in the last stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation<const D: usize> {
    /// Terms of the energy.
    pub terms: Vec<TermValue>,
    /// Gradient with respect to the free points, in index coordinates.
    pub gradient: Vec<[f64; D]>,
}

/// Evaluates the energy of the last stage at a shape, given by its free points in index coordinates. Terms that are relative to a
/// first shape are relative to this one.
///
/// # Errors
/// As for [`segment`].
pub fn evaluate<const D: usize>(
    scene: &Scene<D>,
    model: &dyn Model<D>,
    rows: &[[f64; D]],
    settings: &Settings<D>,
) -> Result<Evaluation<D>, SegmentationError> {
    let Some(last) = settings.stages.last() else { return Err(SegmentationError::Stages { sigma: None }) };
    let run = Run::new(scene, model, rows, settings)?;
    let (boundary, energy) = (run.boundary(last), run.energy(last)?);
    let shape = Shape::new(&*boundary, rows);
    Ok(Evaluation { terms: energy.values(&shape), gradient: energy.evaluate(&shape).gradient })
}

/// Segments an object from a first shape, given by its free points in index coordinates.
///
/// # Errors
/// [`SegmentationError::Rows`], [`SegmentationError::NoVolume`] and [`SegmentationError::Flat`] for the first shape;
/// [`SegmentationError::Stages`] without stages, or for a blur that the scene does not have.
pub fn segment<const D: usize>(
    scene: &Scene<D>,
    model: &dyn Model<D>,
    start: &[[f64; D]],
    settings: &Settings<D>,
    stop: Stop<'_>,
) -> Result<Segmentation<D>, SegmentationError> {
    segment_nested(
        scene,
        &[Level { model, step: None, stages: settings.stages.len() }],
        start,
        settings,
        stop,
    )
}

/// As [`segment`], through the levels of a shape: the result of each one is where the next, with more freedom, begins. Terms that are
/// relative to the first shape stay so. A prior would need one for every level, and is refused with several.
///
/// # Errors
/// As for [`segment`]; [`SegmentationError::Stages`] unless the levels have the stages of the settings, and one at least.
pub fn segment_nested<const D: usize>(
    scene: &Scene<D>,
    levels: &[Level<'_, D>],
    start: &[[f64; D]],
    settings: &Settings<D>,
    stop: Stop<'_>,
) -> Result<Segmentation<D>, SegmentationError> {
    let (Some(first), Some(last)) = (levels.first(), settings.stages.last()) else {
        return Err(SegmentationError::Stages { sigma: None });
    };
    let planned: usize = levels.iter().map(|level| level.stages).sum();
    if planned != settings.stages.len() || (levels.len() > 1 && settings.prior.is_some()) {
        return Err(SegmentationError::Stages { sigma: None });
    }
    let mut run = Run::new(scene, first.model, start, settings)?;
    let before = (first.model.outline(start), run.enclosed(start));
    let (mut reports, mut outcome, mut reached) = (Vec::new(), Outcome::Limit, 0);
    let of_stages = levels.iter().enumerate().flat_map(|(at, level)| std::iter::repeat_n(at, level.stages));
    for ((index, stage), at) in settings.stages.iter().enumerate().zip(of_stages) {
        for level in &levels[reached + 1..=at.max(reached)] {
            run.refine(level);
        }
        reached = at;
        outcome = run.stage(index, stage, &mut reports, stop)?;
        if !outcome.has_ended() {
            break;
        }
    }
    levels[reached + 1..].iter().for_each(|level| run.refine(level));
    let boundary = run.boundary(last);
    let energy = run.energy(last)?;
    let shape = Shape::new(&*boundary, &run.rows);
    let terms = energy.values(&shape);
    let after = (run.model.outline(&run.rows), run.enclosed(&run.rows));
    let moved = Moved::between((&before.0, before.1), (&after.0, after.1), scene.frame());
    if outcome.has_ended() && settings.size_factor.is_some_and(|factor| moved.has_left(factor)) {
        outcome = Outcome::LeftObject;
    }
    Ok(Segmentation { rows: run.rows, outcome, terms, stages: reports, moved })
}

/// State between stages.
struct Run<'a, const D: usize> {
    scene: &'a Scene<D>,
    model: &'a dyn Model<D>,
    settings: &'a Settings<D>,
    measures: Measures,
    /// The box that the shape is kept to.
    wall: Option<Wall<D>>,
    /// Attraction to the first shape.
    hold: Option<Hold<D>>,
    /// Boundary that measures areas and volumes exactly.
    enclosing: Arc<dyn Boundary<D>>,
    rows: Vec<[f64; D]>,
    spacing: f64,
    clip: f64,
}

impl<'a, const D: usize> Run<'a, D> {
    fn new(
        scene: &'a Scene<D>,
        model: &'a dyn Model<D>,
        start: &[[f64; D]],
        settings: &'a Settings<D>,
    ) -> Result<Self, SegmentationError> {
        if start.len() != model.rows() {
            return Err(SegmentationError::Rows { expected: model.rows(), found: start.len() });
        }
        let measures = Measures::of(scene, model, start)?;
        let clip = if start.len() > MANY { 0.5 * settings.clip } else { settings.clip };
        let wall = |factor| wall(scene, model, start, factor);
        let hold = (settings.hold > 0.0).then(|| wall(1.0)).flatten();
        let hold = hold.map(|wall| Hold { start: start.to_vec(), wall });
        let wall = settings.wall.and_then(wall);
        let enclosing = Arc::from(model.exact(start, *scene.frame()));
        let (rows, spacing) = (start.to_vec(), settings.spacing);
        Ok(Self { scene, model, settings, measures, wall, hold, enclosing, rows, spacing, clip })
    }

    /// Goes on with the same shape at the next level.
    fn refine(&mut self, level: &Level<'a, D>) {
        let finer = |rows: &[[f64; D]]| level.step.map_or_else(|| rows.to_vec(), |step| step.apply(rows));
        let rows = finer(&self.rows);
        if self.rows.len() <= MANY && rows.len() > MANY {
            self.clip *= 0.5;
        }
        if let Some(hold) = &mut self.hold {
            hold.start = finer(&hold.start);
        }
        self.model = level.model;
        self.enclosing = Arc::from(level.model.exact(&rows, *self.scene.frame()));
        self.rows = rows;
    }

    /// The area or volume that free points enclose.
    fn enclosed(&self, rows: &[[f64; D]]) -> f64 {
        self.enclosing.volume(&self.enclosing.sample(rows)).value
    }

    fn boundary(&self, stage: &Stage) -> Box<dyn Boundary<D>> {
        let cells = stage.sigma.in_cells(self.scene.frame());
        let sigma = cells[..D].iter().copied().fold(f64::INFINITY, f64::min);
        self.model.boundary(&self.rows, sigma, *self.scene.frame())
    }

    fn energy(&self, stage: &Stage) -> Result<Energy<D>, SegmentationError> {
        let mut terms = self.scene.terms(stage.sigma, &self.measures, &self.model.centre())?;
        if self.settings.boundary > 0.0 {
            let cost = BoundaryCost { scale: self.measures.boundary };
            terms.push((Term::BoundaryCost(cost), self.settings.boundary));
        }
        if self.spacing > 0.0 {
            terms.push((Term::Spacing(Spacing {}), self.spacing));
        }
        if let Some((prior, gamma)) = &self.settings.prior {
            terms.push((Term::Prior(prior.clone().measured_by(self.enclosing.clone())), *gamma));
        }
        terms.extend(self.wall.map(|wall| (Term::Wall(wall), WALL)));
        terms.extend(self.hold.clone().map(|hold| (Term::Hold(hold), self.settings.hold)));
        Ok(Energy { terms })
    }

    /// Runs a stage until its result passes the check.
    fn stage(
        &mut self,
        index: usize,
        stage: &Stage,
        reports: &mut Vec<StageReport>,
        stop: Stop<'_>,
    ) -> Result<Outcome, SegmentationError> {
        let before = self.rows.clone();
        let mut repairs = 0;
        loop {
            let boundary = self.boundary(stage);
            let free = Reparametrisation::new(stage.free, &self.rows, &self.model.centre())
                .ok_or(SegmentationError::Flat)?;
            let energy = self.energy(stage)?;
            if self.settings.method == Method::Newton
                && energy.curvature(&Shape::new(&*boundary, &self.rows)).is_none()
            {
                return Err(SegmentationError::Method);
            }
            let mut objective = StageObjective { boundary: &*boundary, energy: &energy, free: &free, stop };
            let mut x = free.start();
            let minimum = self.minimise(stage, &mut objective, &mut x, stop);
            let rows = free.rows(&x).unwrap_or_else(|| before.clone());
            let volume =
                boundary.volume(&boundary.sample(&rows)).value / self.scene.frame().determinant().abs();
            let fault = check(&self.model.outline(&rows), volume, self.scene.size());
            // Loops that are narrower than a cell have no cells.
            let fault = fault.or_else(|| self.model.crosses_itself(&rows).then_some(Fault::Folded));
            reports.push(StageReport {
                stage: index,
                iterations: minimum.iterations,
                evaluations: minimum.evaluations,
                history: minimum.history,
                spacing: self.spacing,
                ending: minimum.ending,
                fault,
            });
            let Some(fault) = fault else {
                self.rows = rows;
                return Ok(minimum.ending.into());
            };
            if repairs == self.settings.repairs || minimum.ending == Ending::Stopped {
                return Ok(fault.into());
            }
            repairs += 1;
            self.spacing = (REPAIR.0 * self.spacing).max(LEAST_SPACING);
            self.clip *= REPAIR.1;
        }
    }

    fn minimise(
        &self,
        stage: &Stage,
        objective: &mut StageObjective<'_, D>,
        x: &mut Vec<f64>,
        stop: Stop<'_>,
    ) -> Minimum {
        let rules = Rules {
            iterations: stage.iterations,
            clip: self.clip,
            tolerance: self.settings.tolerance,
            ..Rules::default()
        };
        match self.settings.method {
            Method::Lbfgs => lbfgs::minimise(objective, x, &rules, stop),
            Method::Newton => newton::minimise(objective, x, &rules, stop),
            Method::Coordinates => {
                let group = objective.free.group();
                coordinates::minimise(objective, x, group, &rules, stop)
            }
        }
    }
}

/// The wall around the box of a shape, in the frame.
fn wall<const D: usize>(
    scene: &Scene<D>,
    model: &dyn Model<D>,
    rows: &[[f64; D]],
    factor: f64,
) -> Option<Wall<D>> {
    let frame = *scene.frame();
    let world = |point: &[f64; 3]| frame.to_world(std::array::from_fn(|c| point[c]));
    Wall::around(model.outline(rows).points().iter().map(world), factor, frame)
}

/// The energy as a function of the unknowns of a stage.
struct StageObjective<'a, const D: usize> {
    boundary: &'a dyn Boundary<D>,
    energy: &'a Energy<D>,
    free: &'a Reparametrisation<D>,
    stop: Stop<'a>,
}

impl<const D: usize> Objective for StageObjective<'_, D> {
    /// Everything is forbidden once the caller wants to stop: a sweep over many points then ends at once.
    fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
        if (self.stop)() {
            return f64::INFINITY;
        }
        let Some(rows) = self.free.rows(x) else { return f64::INFINITY };
        let energy = self.energy.evaluate(&Shape::new(self.boundary, &rows));
        gradient.copy_from_slice(&self.free.pull(&energy.gradient));
        energy.value
    }

    fn displacement(&self, direction: &[f64]) -> f64 {
        self.free.displacement(direction)
    }
}

impl<const D: usize> Curved for StageObjective<'_, D> {
    fn curvature(&mut self, x: &[f64]) -> Matrix {
        let rows = self.free.rows(x);
        let found = rows.and_then(|rows| self.energy.curvature(&Shape::new(self.boundary, &rows)));
        // Points of the minimisation are allowed, and boundaries without curvature are refused before.
        found.map_or_else(|| Matrix::identity(x.len(), x.len()), |curvature| self.free.pull_twice(&curvature))
    }
}
