//! Blocks of the same subjects: shapes of a cohort, of another one, parts of shapes, labels.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::modularity::selected;
use super::parts::BlockSpec;
use super::study::{Plan, Study, StudyKind, StudyRequest, bounded, within_memory};
use crate::analysis::blocks::error::BlocksError;
use crate::analysis::blocks::parts::part_of;
use crate::analysis::blocks::pls::{Block, Form, Sampling, two_blocks};
use crate::analysis::drawing::blocks::draw_blocks;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for, mean_warnings};
use crate::analysis::inference::limits::MAX_VALUE;
use crate::analysis::models::effect_size::Transform;
use crate::analysis::watch::Watch;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::{BlockScore, ShapeBlocks};
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::representation::ShapeSpace;
use crate::service::app::faults::MAX_FAULTS;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, name_of};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::selection::Selection;
use crate::service::cost::requests;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Maximum number of blocks.
const MAX_BLOCKS: usize = 20;
/// Fewest control points of a part that is aligned with the whole shape, and of one that is aligned on its own.
const MIN_POINTS: [usize; 2] = [1, 3];

/// Options of a study of blocks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// `x`, `y` and the others.
    pub blocks: Vec<BlockSpec>,
    /// Whether parts are aligned on their own.
    pub separate: bool,
    /// Transformation of Z.
    pub z: Transform,
    /// Id and revision of the other cohort of each block.
    pub others: Vec<Option<(String, u64)>>,
}

impl Options {
    /// Options of a request.
    pub fn new(
        filter: ShapeFilter,
        [x, y]: [BlockSpec; 2],
        others: Vec<BlockSpec>,
        separate: bool,
        z: Transform,
    ) -> Self {
        Self { filter, blocks: [vec![x, y], others].concat(), separate, z, others: Vec::new() }
    }
}

fn pointer(block: usize) -> String {
    match block {
        0 => "/x".into(),
        1 => "/y".into(),
        other => format!("/others/{}", other - 2),
    }
}

/// Shapes of another cohort, in the order of those that they belong to, and their reader.
#[derive(Debug)]
struct Other {
    app: App,
    handle: Handle,
    cohort: Cohort,
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    setup: Setup,
}

/// Shapes with their blocks.
#[derive(Debug)]
pub struct BlocksOfShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    strata: Vec<usize>,
    /// Numbers of the labels of each block, by their names.
    labels: Vec<Vec<(String, Vec<f64>)>>,
    others: Vec<Option<Other>>,
    left_out: usize,
}

impl StudyKind for BlocksOfShapes {
    type Options = Options;
    type Record = ShapeBlocks;
    const KIND: JobKind = JobKind::TwoBlocks;
    const PHASE: &'static str = "two_blocks";

    fn faults(_: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let blocks = &request.options.blocks;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(request.strata_faults());
        if blocks.len() > MAX_BLOCKS {
            let detail = format!("expected at most {} blocks, got {}", MAX_BLOCKS - 2, blocks.len() - 2);
            faults.push(Fault::new("/others", detail));
        }
        for (k, block) in blocks.iter().enumerate().take(MAX_BLOCKS) {
            faults.extend(block.faults(&pointer(k)));
            if blocks[..k].contains(block) {
                faults.push(Fault::new(pointer(k), "expected different blocks, got one twice"));
            }
        }
        faults
    }

    fn complete(_: &mut Options, _: &Cohort) {}

    async fn fix(app: &App, options: &mut Options) -> Result<(), ServiceError> {
        for (k, block) in options.blocks.iter().enumerate() {
            let other = match &block.cohort {
                None => None,
                Some(name) => {
                    let pointer = format!("{}/cohort", pointer(k));
                    let found = catalogue::find(app, name).await.map_err(|error| error.named_at(&pointer))?;
                    Some((found.id, found.revision))
                }
            };
            options.others.push(other);
        }
        Ok(())
    }

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let options = &plan.options;
        let described = selected(app, cohort, &options.filter).await?;
        let all = described.len();
        let mut others = Vec::with_capacity(options.blocks.len());
        let mut shapes = described;
        for k in 0..options.blocks.len() {
            let other = Other::of(app, cohort, plan, k).await?;
            if let Some(other) = &other {
                shapes = with_partners(shapes, other, &pointer(k))?;
            }
            others.push(other);
        }
        // Partners of the shapes that are left, which have one in every other cohort.
        for other in others.iter_mut().flatten() {
            let of: BTreeMap<Option<String>, ShapeDescription> =
                other.shapes.drain(..).map(|shape| (shape.subject.clone(), shape)).collect();
            other.shapes = shapes.iter().filter_map(|shape| of.get(&shape.subject).cloned()).collect();
        }
        let labels = numbers(options, &shapes)?;
        let strata = super::sample::strata(&plan.strata, &shapes)?;
        let distinct = strata.iter().collect::<BTreeSet<_>>().len();
        if plan.permutations > 0 && !plan.strata.is_empty() && distinct == shapes.len() {
            let detail = "no two shapes share a stratum: nothing can be exchanged";
            return Err(ServiceError::invalid("/strata", detail));
        }
        let left_out = all - shapes.len();
        Ok(Self { shapes, filter: [options.filter.clone()], strata, labels, others, left_out })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        let shapes = self.shapes.len();
        let work = TestWork { shapes, samples: 0, permutations: 0, columns: 0, pairs: 0, pair_shapes: 0 };
        let mut estimate = within_memory(app, setup, &work, "/filter")?;
        let mut lengths = Vec::with_capacity(self.others.len());
        for (k, block) in plan.options.blocks.iter().enumerate() {
            let setup = self.others[k].as_ref().map_or(setup, |other| &other.setup);
            if self.others[k].is_some() {
                estimate = estimate.and(Estimate::for_tests(setup.measured(), &work));
            }
            let dimension = setup.metric.dimension();
            lengths.push(match (block.part(), &block.labels) {
                (Some(part), _) => {
                    let fewest = MIN_POINTS[usize::from(plan.options.separate)];
                    dimension * part.indices(&setup.space, fewest, &pointer(k))?.len()
                }
                (None, Some(labels)) => labels.len(),
                (None, None) => setup.metric.len(),
            });
        }
        bounded(app, estimate.with_blocks(&lengths, plan.permutations), "/permutations")
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeBlocks, ServiceError> {
        let mut blocks = Vec::with_capacity(study.plan.options.blocks.len());
        let mut warnings = [study.caveats(), mean_warnings(&shapes.mean)].concat();
        for (k, spec) in study.plan.options.blocks.iter().enumerate() {
            blocks.push(block(study, shapes, (k, spec), &mut warnings, watch)?);
        }
        record(study, &blocks, &shapes.weights, warnings, watch)
    }

    fn draw(study: &Study<Self>, record: &ShapeBlocks) -> Drawing {
        let blocks = study.plan.options.blocks.iter().zip(&study.sample.others);
        let spaces: Vec<Option<&ShapeSpace>> = blocks
            .map(|(block, other)| {
                let setup = other.as_ref().map_or(&study.setup, |other| &other.setup);
                (block.part().is_none() && block.labels.is_none()).then_some(&setup.space)
            })
            .collect();
        let title = format!("covariation of {} shapes of {}", record.header.shapes, study.cohort.spec.name);
        draw_blocks(&spaces, &study.setup.method, &title, &record.found)
    }
}

impl Other {
    /// The other cohort of a block, if it has one.
    async fn of(
        app: &App,
        cohort: &Cohort,
        plan: &Plan<Options>,
        k: usize,
    ) -> Result<Option<Self>, ServiceError> {
        let Some((id, revision)) = plan.options.others.get(k).cloned().flatten() else { return Ok(None) };
        let (spec, pointer) = (&plan.options.blocks[k], pointer(k));
        let found = app.store.find_cohort(&id).await?;
        let other = found.ok_or(ServiceError::NotFound { kind: "cohort", key: id })?.at(revision);
        let dimensions = [cohort, &other].map(|cohort| cohort.spec.representation.dimension());
        if dimensions[0] != dimensions[1] {
            let detail = format!("expected shapes in {} dimensions, got {}", dimensions[0], dimensions[1]);
            return Err(ServiceError::invalid(format!("{pointer}/cohort"), detail));
        }
        let filter = spec.filter.clone().unwrap_or_default();
        let shapes = attributes::describe(app, &other, &filter, &format!("{pointer}/filter")).await?;
        let (task_app, settings) = (app.clone(), plan.settings(&other));
        let work = requests::space(&other.spec.representation, &app.limits);
        let setup = app.pool.weighing(work).run(move || Setup::of(&task_app, settings)).await?;
        Ok(Some(Self {
            app: app.clone(),
            handle: Handle::current(),
            cohort: other,
            shapes,
            filter: [filter],
            setup,
        }))
    }
}

/// Shapes with a partner in another cohort.
///
/// # Errors
/// Shapes without a subject, subjects with several shapes, no partners at all.
fn with_partners(
    shapes: Vec<ShapeDescription>,
    other: &Other,
    pointer: &str,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    let pointer = format!("{pointer}/cohort");
    let own = subjects(&shapes, &pointer)?;
    let partners = subjects(&other.shapes, &pointer)?;
    if own.is_disjoint(&partners) {
        let detail =
            format!("expected shapes of the same subjects, got none in '{}'", other.cohort.spec.name);
        return Err(ServiceError::invalid(pointer, detail));
    }
    let has_partner = |shape: &ShapeDescription| shape.subject.as_ref().is_some_and(|s| partners.contains(s));
    Ok(shapes.into_iter().filter(has_partner).collect())
}

/// Subjects, each of one shape.
fn subjects(shapes: &[ShapeDescription], pointer: &str) -> Result<BTreeSet<String>, ServiceError> {
    let mut subjects = BTreeSet::new();
    for shape in shapes {
        let refused = |detail: String| Err(ServiceError::invalid(pointer, detail));
        match &shape.subject {
            None => {
                return refused(format!(
                    "expected a subject of every shape, got none of '{}'",
                    name_of(shape)
                ));
            }
            Some(subject) if !subjects.insert(subject.clone()) => {
                return refused(format!("expected one shape of each subject, got several of '{subject}'"));
            }
            Some(_) => {}
        }
    }
    Ok(subjects)
}

/// Labels by name, with a number for each shape.
type Numbered = Vec<(String, Vec<f64>)>;

/// Numbers of the labels of each block.
fn numbers(options: &Options, shapes: &[ShapeDescription]) -> Result<Vec<Numbered>, ServiceError> {
    let (mut all, mut faults) = (Vec::with_capacity(options.blocks.len()), Vec::new());
    for (k, block) in options.blocks.iter().enumerate() {
        let mut own = Vec::new();
        for (i, name) in block.labels.iter().flatten().enumerate() {
            let attribute = Attribute::parse(name);
            let number = |shape: &ShapeDescription| attribute.as_ref().and_then(|own| own.number(shape));
            let values: Vec<Option<f64>> = shapes.iter().map(number).collect();
            for (shape, value) in shapes.iter().zip(&values) {
                if value.is_none_or(|value| value.abs() > MAX_VALUE) && faults.len() < MAX_FAULTS {
                    let detail = format!("{name} is missing or no number on the shape '{}'", name_of(shape));
                    faults.push(Fault::new(format!("{}/labels/{i}", pointer(k)), detail));
                }
            }
            own.push((name.clone(), values.into_iter().flatten().collect()));
        }
        all.push(own);
    }
    ServiceError::unless_empty(faults)?;
    Ok(all)
}

/// Vectors of a block.
fn block<'a>(
    study: &'a Study<BlocksOfShapes>,
    aligned: &AlignedShapes<'_>,
    (k, spec): (usize, &BlockSpec),
    warnings: &mut Vec<String>,
    watch: &dyn Watch,
) -> Result<Block<'a>, ServiceError> {
    let refused = |error| refused(error, &pointer(k));
    if spec.labels.is_some() {
        return Block::of_numbers(k, &study.sample.labels[k], &aligned.weights).map_err(refused);
    }
    let of_other;
    let (setup, aligned) = match &study.sample.others[k] {
        None => (&study.setup, aligned),
        Some(other) => {
            of_other = aligned_other(study, other, &pointer(k), watch)?;
            warnings.extend(mean_warnings(&of_other.mean));
            (&other.setup, &of_other)
        }
    };
    let (name, part) = (spec.name(), spec.part());
    let Some(part) = part else {
        return Ok(Block { name, vectors: aligned.aligned.clone(), form: Form::Shape(&setup.metric) });
    };
    let separate = study.plan.options.separate;
    let points = part.indices(&setup.space, MIN_POINTS[usize::from(separate)], &pointer(k))?;
    let vectors = part_of(aligned, &points, separate, watch).map_err(refused)?;
    Ok(Block { name, vectors, form: Form::Points(setup.metric.dimension()) })
}

/// Aligned shapes of another cohort.
fn aligned_other<'a>(
    study: &'a Study<BlocksOfShapes>,
    other: &'a Other,
    pointer: &str,
    watch: &dyn Watch,
) -> Result<AlignedShapes<'a>, ServiceError> {
    let setup = &other.setup;
    let selection = Selection { shapes: &other.shapes, filters: &other.filter };
    let (control_points, weights) =
        selection.read(&other.app, &other.handle, &other.cohort, setup.metric.len(), &|| watch.stop())?;
    let space = StudySpace {
        space: &setup.space,
        metric: &setup.metric,
        method: &setup.method,
        tangent: study.plan.is_tangent(),
        frame: frame_for(&study.plan.transformation),
        matching: &setup.matching,
    };
    AlignedShapes::new(space, control_points, weights, watch)
        .map_err(|error| selection.named(super::study::refused(error, pointer), &other.cohort.spec.name))
}

fn record(
    study: &Study<BlocksOfShapes>,
    blocks: &[Block<'_>],
    weights: &[f64],
    mut warnings: Vec<String>,
    watch: &dyn Watch,
) -> Result<ShapeBlocks, ServiceError> {
    let Study { plan, cohort, sample, .. } = study;
    let sampling = Sampling {
        strata: &sample.strata,
        permutations: plan.permutations,
        seed: plan.seed,
        transform: plan.options.z,
        given: None,
    };
    let mut found =
        two_blocks(blocks, weights, &sampling, watch).map_err(|error| refused(error, "/filter"))?;
    let parts = plan.options.blocks.iter().filter(|block| block.part().is_some() && block.cohort.is_none());
    if parts.count() > 1 && !plan.options.separate {
        warnings.push(
            "parts of one aligned shape share its alignment, which makes them covary: ask for separate alignment to take it out"
                .into(),
        );
    }
    warnings.extend(super::sample::subject_warning(&sample.shapes, &plan.strata));
    if sample.left_out > 0 {
        warnings
            .push(format!("{} shapes have no partner in another cohort and are left out", sample.left_out));
    }
    found.record.warnings = warnings;
    let scores = sample.shapes.iter().zip(&found.scores).map(|(shape, &[first, second])| BlockScore {
        id: shape.id.clone(),
        external_id: shape.external_id.clone(),
        first,
        second,
    });
    Ok(ShapeBlocks {
        cohort: cohort.id.clone(),
        cohort_revision: plan.revision,
        header: plan.header(sample.shapes.len(), sample.left_out),
        separate: plan.options.separate,
        scores: scores.collect(),
        found: found.record,
    })
}

/// Refusal for an error of blocks or modules; `place` is the pointer of errors that do not name it themselves.
pub(super) fn refused(error: BlocksError, place: &str) -> ServiceError {
    match error {
        BlocksError::Analysis(error) => error.into(),
        BlocksError::Study(error) => super::study::refused(error, place),
        BlocksError::Constant { block, .. } if place == "/filter" => {
            ServiceError::invalid(pointer(block), error.to_string())
        }
        BlocksError::FewSubjects { .. } => ServiceError::invalid("/filter", error.to_string()),
        BlocksError::Exchange(_) => ServiceError::invalid("/permutations", error.to_string()),
        BlocksError::Constant { .. } | BlocksError::Geometry(_) => {
            ServiceError::invalid(place, error.to_string())
        }
    }
}
