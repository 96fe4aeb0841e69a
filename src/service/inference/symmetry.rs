//! Symmetry of the shapes of a cohort: of each beside its own image, or of left shapes beside mirrored right ones.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::modularity::selected;
use super::sample::labels_of;
use super::study::{Plan, Study, StudyKind, StudyRequest, bounded, within_memory};
use crate::analysis::correspondence::Mirror;
use crate::analysis::drawing::symmetry::draw_symmetry;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::models::design::MAX_COLUMNS;
use crate::analysis::models::effect_size::Transform;
use crate::analysis::models::error::ModelError;
use crate::analysis::symmetry::error::{MIN_INDIVIDUALS, SymmetryError};
use crate::analysis::symmetry::records::SymmetryKind;
use crate::analysis::symmetry::relabelling::{Relabelling, mirrored};
use crate::analysis::symmetry::sample::{Sides, SymmetryTesting};
use crate::analysis::symmetry::study::{SymmetryQuestion, symmetry};
use crate::analysis::watch::Watch;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::ShapeSymmetry;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Maximum number of places of all maps in an answer.
const MAX_MAP_POINTS: usize = 100_000;

/// Options of a study of symmetry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// Kind of symmetry.
    pub kind: SymmetryKind,
    /// Points that change places.
    pub pairs: Vec<[usize; 2]>,
    /// Attribute whose values are the individuals.
    pub individual: Option<String>,
    /// Attribute whose two values are the sides.
    pub side: Option<String>,
    /// Value of the left side.
    pub left: Option<String>,
    /// Attribute whose values tell replicates apart.
    pub replicate: Option<String>,
    /// Whether right shapes are mirror images already.
    pub mirrored: bool,
    /// Number of places along the shape.
    pub samples: Option<usize>,
    /// Whether each individual has a map.
    pub maps: bool,
    /// Transformation of Z.
    pub z: Transform,
}

impl Options {
    /// Attributes with their pointers.
    fn attributes(&self) -> impl Iterator<Item = (&'static str, &String)> {
        [("/individual", &self.individual), ("/side", &self.side), ("/replicate", &self.replicate)]
            .into_iter()
            .filter_map(|(pointer, name)| Some((pointer, name.as_ref()?)))
    }

    fn is_object(&self) -> bool {
        self.kind == SymmetryKind::Object
    }

    /// Faults of fields that do not fit the kind.
    fn kind_faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut unless = |holds: bool, pointer: &str, detail: &str| {
            if !holds {
                faults.push(Fault::new(pointer, detail));
            }
        };
        match self.kind {
            SymmetryKind::Object => {
                unless(self.side.is_none(), "/side", "expected with matching symmetry only");
                unless(self.left.is_none(), "/left", "expected with matching symmetry only");
                unless(!self.mirrored, "/mirrored", "expected with matching symmetry only");
                let named = self.replicate.is_none() || self.individual.is_some();
                unless(named, "/replicate", "expected with individual only: replicates of what");
            }
            SymmetryKind::Matching => {
                unless(
                    self.side.is_some(),
                    "/side",
                    "expected the attribute that tells left from right, got none",
                );
                unless(self.pairs.is_empty(), "/pairs", "expected with object symmetry only");
            }
        }
        faults
    }
}

/// Shapes of a study of symmetry, with their individuals and sides.
#[derive(Debug)]
pub struct SymmetricShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    names: Vec<String>,
    individual: Vec<usize>,
    side: Vec<usize>,
    /// Values of the sides.
    sides: Option<[String; 2]>,
    samples: usize,
}

impl StudyKind for SymmetricShapes {
    type Options = Options;
    type Record = ShapeSymmetry;
    const KIND: JobKind = JobKind::Symmetry;
    const PHASE: &'static str = "symmetry";

    fn faults(app: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let options = &request.options;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(options.kind_faults());
        if !request.strata.is_empty() {
            let detail = "expected no strata: exchanges are within sides and individuals";
            faults.push(Fault::new("/strata", detail));
        }
        if request.mirror == Some(Mirror::Allow) {
            let detail = "expected \"forbid\": mirror images would be turned back";
            faults.push(Fault::new("/mirror", detail));
        }
        for (pointer, name) in options.attributes().filter(|(_, name)| Attribute::parse(name).is_none()) {
            faults.push(Fault::new(pointer, format!("{}, got '{name}'", Attribute::WANTED)));
        }
        let most = app.limits.samples;
        if let Some(samples) = options.samples.filter(|samples| !(1..=most).contains(samples)) {
            let detail = format!("expected a number between 1 and {most}, got {samples}");
            faults.push(Fault::new("/samples", detail));
        }
        faults
    }

    fn complete(options: &mut Options, cohort: &Cohort) {
        options.samples.get_or_insert(cohort.spec.representation.comparison_places());
        if !options.is_object() {
            options.individual.get_or_insert_with(|| "subject".into());
        }
    }

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let options = &plan.options;
        let shapes = selected(app, cohort, &options.filter).await?;
        let of = |name: &Option<String>, pointer: &str| -> Result<Option<Vec<String>>, ServiceError> {
            let Some(name) = name else { return Ok(None) };
            labels_of(std::slice::from_ref(name), &shapes, pointer)?;
            let attribute = Attribute::parse(name);
            let text = |shape| attribute.as_ref().and_then(|own| own.text(shape)).unwrap_or_default();
            Ok(Some(shapes.iter().map(text).collect()))
        };
        let individuals = match of(&options.individual, "/individual")? {
            Some(names) => names,
            None => {
                shapes.iter().map(|shape| shape.external_id.clone().unwrap_or(shape.id.clone())).collect()
            }
        };
        let sides = of(&options.side, "/side")?.map(|values| two_sides(&values, options)).transpose()?;
        let replicates = of(&options.replicate, "/replicate")?;
        // In the order of the cohort.
        let mut numbers = BTreeMap::new();
        let mut names: Vec<String> = Vec::new();
        let individual: Vec<usize> = individuals
            .iter()
            .map(|name| {
                *numbers.entry(name).or_insert_with(|| {
                    names.push(name.clone());
                    names.len() - 1
                })
            })
            .collect();
        let (sides, side) = match sides {
            Some((sides, side)) => (Some(sides), side),
            None => (None, vec![0; shapes.len()]),
        };
        check_replicates(&names, &individual, &side, replicates.as_deref())?;
        let samples = options.samples.unwrap_or_else(|| cohort.spec.representation.comparison_places());
        if options.maps && samples.saturating_mul(names.len()) > MAX_MAP_POINTS {
            let detail = format!(
                "expected at most {MAX_MAP_POINTS} places over all maps, got {samples} of each of {} individuals",
                names.len()
            );
            return Err(ServiceError::invalid("/maps", detail));
        }
        let filter = [options.filter.clone()];
        Ok(Self { shapes, filter, names, individual, side, sides, samples })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        let (options, count) = (&plan.options, self.names.len());
        if options.is_object() {
            Relabelling::new(&setup.space, &options.pairs).map_err(refused)?;
        }
        if count < MIN_INDIVIDUALS {
            return Err(refused(SymmetryError::FewIndividuals { found: count }));
        }
        let copies = if options.is_object() { 2 } else { 1 };
        let shapes = copies * self.shapes.len();
        let columns = if shapes > 2 * count { 2 * count } else { count + 1 };
        if columns > MAX_COLUMNS {
            let detail = format!(
                "expected a table of at most {MAX_COLUMNS} columns, got {columns} for {count} individuals"
            );
            return Err(ServiceError::invalid("/filter", detail));
        }
        let (permutations, samples) = (plan.permutations, self.samples);
        let work = TestWork { shapes, samples, permutations, columns: 3 * columns, pairs: 0, pair_shapes: 0 };
        let mut estimate = within_memory(app, setup, &work, "/filter")?;
        // Shapes with exact images, their residuals, averages and differences.
        estimate.memory_bytes += 8.0 * 4.0 * (shapes * setup.metric.len()) as f64;
        bounded(app, estimate.with_design(2 * columns, 3, 3 * permutations), "/permutations")
    }

    fn prepared(
        study: &Study<Self>,
        mut control_points: Vec<f64>,
        mut weights: Vec<f64>,
    ) -> (Vec<f64>, Vec<f64>) {
        let Study { plan, sample, setup, cohort, .. } = study;
        let length = setup.metric.len();
        match Relabelling::new(&setup.space, &plan.options.pairs) {
            Ok(relabelling) if plan.options.is_object() => {
                let mut images = control_points.clone();
                images.chunks_exact_mut(length).for_each(|shape| relabelling.image(shape));
                control_points.extend(images);
                weights.extend_from_within(..);
            }
            _ if plan.options.mirrored => {}
            _ => {
                let shapes = control_points.chunks_exact_mut(length).zip(&sample.side);
                for (shape, _) in shapes.filter(|(_, side)| **side == 1) {
                    mirrored(&setup.space, cohort.spec.correspondence, shape);
                }
            }
        }
        (control_points, weights)
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeSymmetry, ServiceError> {
        let Study { plan, cohort, sample, setup, .. } = study;
        let options = &plan.options;
        let relabelling = match options.is_object() {
            true => Some(Relabelling::new(&setup.space, &options.pairs).map_err(refused)?),
            false => None,
        };
        let twice = |list: &[usize]| [list, list].concat();
        let count = sample.shapes.len();
        let (individual, side, measured) = match &relabelling {
            Some(_) => {
                let side: Vec<usize> = (0..2 * count).map(|k| k / count).collect();
                (twice(&sample.individual), side, Some((0..2 * count).map(|k| k % count).collect::<Vec<_>>()))
            }
            None => (sample.individual.clone(), sample.side.clone(), None),
        };
        let question = SymmetryQuestion {
            kind: options.kind,
            sides: Sides {
                names: &sample.names,
                individual: &individual,
                side: &side,
                measured: measured.as_deref(),
            },
            relabelling: relabelling.as_ref(),
            transformation: &plan.transformation,
            testing: SymmetryTesting {
                permutations: plan.permutations,
                seed: plan.seed,
                transform: options.z,
                ..SymmetryTesting::default()
            },
            samples: sample.samples,
            maps: options.maps,
        };
        let mut found = symmetry(shapes, &question, watch).map_err(refused)?;
        found.warnings = [study.caveats(), found.warnings].concat();
        Ok(ShapeSymmetry {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(count, 0),
            kind: options.kind,
            sides: sample.sides.clone(),
            found,
        })
    }

    fn draw(study: &Study<Self>, record: &ShapeSymmetry) -> Drawing {
        let setup = &study.setup;
        let title = format!("asymmetry of {} shapes of {}", record.header.shapes, study.cohort.spec.name);
        draw_symmetry((&setup.space, &setup.metric, &setup.method), &title, &record.found)
    }
}

/// Left and right, and the side of each shape.
fn two_sides(values: &[String], options: &Options) -> Result<([String; 2], Vec<usize>), ServiceError> {
    let distinct: Vec<&String> = values.iter().collect::<BTreeSet<_>>().into_iter().collect();
    let [first, second] = distinct.as_slice() else {
        let detail = format!("expected two values, one of each side, got {}", distinct.len());
        return Err(ServiceError::invalid("/side", detail));
    };
    let [left, right] = match &options.left {
        Some(left) if left == *second => [second, first],
        Some(left) if left != *first => {
            let detail = format!("expected '{first}' or '{second}', got '{left}'");
            return Err(ServiceError::invalid("/left", detail));
        }
        _ => [first, second],
    };
    let side = values.iter().map(|value| usize::from(value == *right)).collect();
    Ok(([left.to_string(), right.to_string()], side))
}

/// Checks that replicates differ within each individual and side.
fn check_replicates(
    names: &[String],
    individual: &[usize],
    side: &[usize],
    replicates: Option<&[String]>,
) -> Result<(), ServiceError> {
    let Some(replicates) = replicates else { return Ok(()) };
    let mut seen = BTreeSet::new();
    for ((&i, &side), replicate) in individual.iter().zip(side).zip(replicates) {
        if !seen.insert((i, side, replicate)) {
            let detail = format!(
                "expected different replicates of each individual and side, got '{replicate}' twice of '{}'",
                names[i]
            );
            return Err(ServiceError::invalid("/replicate", detail));
        }
    }
    Ok(())
}

/// Refusal for an error of a study of symmetry.
fn refused(error: SymmetryError) -> ServiceError {
    let pointer = match &error {
        SymmetryError::Pair { position, .. } => format!("/pairs/{position}"),
        SymmetryError::PairsOfCurve { .. } | SymmetryError::NoPairs | SymmetryError::NotAnIsometry => {
            "/pairs".into()
        }
        SymmetryError::OneSided { .. } => "/side".into(),
        SymmetryError::FewIndividuals { .. } | SymmetryError::Model(ModelError::FewShapes { .. }) => {
            "/filter".into()
        }
        SymmetryError::NoExtent => "/shape".into(),
        SymmetryError::Model(_) => "/individual".into(),
        SymmetryError::Analysis(_) => String::new(),
    };
    match error {
        SymmetryError::Analysis(error) | SymmetryError::Model(ModelError::Analysis(error)) => error.into(),
        other => ServiceError::invalid(pointer, other.to_string()),
    }
}
