//! Requests for segmentations as they are posted: every field keeps its faults.

use super::contours;
use super::image::Coordinates;
use super::kinds::{self, Kinds};
use super::reference::{DictionaryPart, Source, Stored};
use super::request::{BoxInput, EnergyInput, Minimiser, StageInput, TermInput};
use super::starts::{SeedInput, Starts};
use super::wanted::{Answered, Keeping, Reference, Wanted};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::domain::job::Priority;
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError};
use crate::service::statistics::{CheckedSettings, Settings};
use crate::wire::checked::{
    Checked, List, Many, Raw, SMALL, document, take_given, take_many, take_or_default,
};
use crate::wire::fault::Fault;
use crate::wire::lengths::unit_of;
use crate::wire::representation::Read;
use crate::wire::shape::{ObjectInput, ShapeInput};
use crate::wire::unit::Unit;

/// Declares two requests with the same fields, of which the second one has further ones.
macro_rules! requests {
    ($(#[$meta:meta])* $plain:ident; $(#[$more_meta:meta])* $more:ident { $($further:tt)* } {
        $($(#[$field_meta:meta])* $field:ident: $type:ty $(, $required:ident)?;)*
    }) => {
        document! {
            $(#[$meta])*
            pub struct $plain {
                $($(#[$field_meta])* $field: $type $(, $required)?;)*
            }
        }

        document! {
            $(#[$more_meta])*
            pub struct $more {
                $($(#[$field_meta])* $field: $type $(, $required)?;)*
                $($further)*
            }
        }

        impl $more {
            /// Takes the common fields, and the faults.
            fn take_plain(&mut self) -> $plain {
                $plain { $($field: self.$field.take(),)* faults: std::mem::take(&mut self.faults) }
            }
        }
    };
}

requests! {
    /// Segmentation that is wanted of an image.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "trigonometric"}},
        "boxes": [{"lower": [6, 6], "upper": [20, 18]}],
        "terms": [{"name": "contour"}], "coordinates": "index"
    }))]
    SegmentRequest;

    /// Segmentation of an image whose objects go into a cohort.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 24, "generator": {"name": "cubic"}},
        "boxes": [{"lower": [6, 6], "upper": [20, 18]}], "objects": [{"external_id": "cell-1", "label": "control"}],
        "terms": [{"name": "contour"}], "coordinates": "index", "unit": "mm"
    }))]
    CohortSegmentRequest {
        /// Attributes, one entry for each object, in order. Posted `shapes` have attributes of their own.
        #[schema(value_type = Option<Vec<ObjectInput>>)]
        objects: List<ObjectInput>;
        /// Whether objects are stored that leave their object, or that fold, collapse or leave the image: these as they were before.
        /// Default: false.
        #[schema(value_type = Option<bool>)]
        store_failed: Checked<bool>;
        /// Unit of the coordinates, whatever the image states: `m`, `cm`, `mm`, `um`, `nm`, `inch`, `pixel`, `voxel` or
        /// `none`. Lengths are stored in the unit of the cohort. Default: `mm` where the image states lengths, `pixel`
        /// or `voxel` where it counts cells.
        #[schema(value_type = Option<String>)]
        unit: Checked<String>;
    } {
        /// Representation of the shapes: `closed_curve` in the plane; `surface` with the topology `sphere`, `cylinder` (closed by lids)
        /// or `torus`; `subdivision` with a linear scheme.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Representations of single objects, one entry for each: others than `representation`, or `null` for it. All of the dimension
        /// of the image; for a prior all objects have one.
        #[schema(value_type = Option<Vec<Option<Representation>>>)]
        representations: List<Option<Read<Representation>>>;
        /// Conversion of posted points to control points. Default: `landmarks`.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// Initial shapes, one for each object, in either direction: also those of an earlier answer. One of `shapes`, `boxes`,
        /// `seeds` and the part `mask` tells where objects begin.
        #[schema(value_type = Option<Vec<ShapeInput>>)]
        shapes: List<ShapeInput>;
        /// Boxes, one for each object, whose largest ellipse, ellipsoid, cylinder or torus is the initial shape.
        #[schema(value_type = Option<Vec<BoxInput>>)]
        boxes: Many<BoxInput>;
        /// Points in objects, one for each, around which the initial shapes lie.
        #[schema(value_type = Option<Vec<SeedInput>>)]
        seeds: Many<SeedInput>;
        /// Labels of the part `mask` that begin objects, one for each component. Default: all but 0.
        #[schema(value_type = Option<Vec<u32>>)]
        mask_labels: Many<u32>;
        /// Number of cells of a component of the part `mask` below which it begins no object. Default: 1.
        #[schema(value_type = Option<usize>)]
        mask_least_cells: Checked<usize>;
        /// Slice of a volume, by its index along z from 0, which is segmented as an image in the plane; also of volumes in the parts
        /// `mask` and `truth`. Default: the whole volume.
        #[schema(value_type = Option<usize>)]
        slice: Checked<usize>;
        /// Terms of the energy: at least one of the image, each at most once.
        #[schema(value_type = Vec<TermInput>, required = true, max_items = 8)]
        terms: Many<TermInput>, required;
        /// Stages of the minimisation, from coarse to fine. Default: an affine map at a blur of two cells, then all points at blurs of
        /// two cells and of one.
        #[schema(value_type = Option<Vec<StageInput>>, max_items = 8)]
        stages: Many<StageInput>;
        /// Method of minimisation. Default: `lbfgs`.
        #[schema(value_type = Option<Minimiser>)]
        method: Checked<Minimiser>;
        /// Attraction to the class of a shape.
        #[schema(value_type = Option<ShapePrior>)]
        prior: ShapePrior;
        /// Coordinates of shapes, boxes, blurs and the answer. Default: `world`.
        #[schema(value_type = Option<Coordinates>)]
        coordinates: Checked<Coordinates>;
        /// Factor between the sizes of a result and its initial shape beyond which the result has left its object (`stop` is
        /// `left_object`). Default: 2 for areas, 2.83 for volumes; around seeds without a radius, which say nothing about a size, any.
        #[schema(value_type = Option<f64>, minimum = 1)]
        size_factor: Checked<f64>;
        /// Factor by which the box around an initial shape is scaled; a boundary that goes beyond costs energy. Default: 1.5 for
        /// `boxes`, else anywhere.
        #[schema(value_type = Option<f64>, minimum = 1)]
        box_factor: Checked<f64>;
        /// Whether shapes may leave the boxes where they begin at no cost. Default: false with `boxes`, and where `box_factor` is
        /// given.
        #[schema(value_type = Option<bool>)]
        leave_box: Checked<bool>;
        /// Labels of the truth, one for each object. Default: all but 0.
        #[schema(value_type = Option<Vec<u32>>)]
        truth_labels: Many<u32>;
        /// Whether to answer the energy after every iteration. Default: false.
        #[schema(value_type = Option<bool>)]
        history: Checked<bool>;
        /// Whether to answer the gradient of the energy at the result. Default: false.
        #[schema(value_type = Option<bool>)]
        gradient: Checked<bool>;
        /// Whether to answer the cells inside of each result; with the format `png` the answer is a picture of labels. Default: false.
        #[schema(value_type = Option<bool>)]
        mask: Checked<bool>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// A shape, or a part of a dictionary.
#[derive(Debug, utoipa::ToSchema, serde::Serialize)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
enum PriorReference {
    /// A posted shape.
    Shape(#[serde(skip)] Box<ShapeInput>),
    /// A part of a dictionary.
    Part(DictionaryPart),
}

/// How the objects of a request go into a cohort.
pub struct Storing {
    /// Attributes of the objects.
    pub objects: Option<Vec<ShapeInput>>,
    /// Whether those are stored that have failed.
    pub store_failed: bool,
    /// Unit of the coordinates, whatever the image says.
    pub unit: Option<Unit>,
}

impl CohortSegmentRequest {
    /// The request for the segmentation, and further settings.
    ///
    /// # Errors
    /// Faults of the further fields; a representation that is not that of the cohort.
    pub fn split(mut self, cohort: &Cohort) -> Result<(SegmentRequest, Storing), ServiceError> {
        let asked = self.take_plain();
        let mut errors = Vec::new();
        let objects = self.objects.map(|objects| objects.take("/objects", &mut errors));
        let objects = objects.map(|objects| objects.into_iter().map(ShapeInput::from).collect());
        let store_failed =
            take_or_default(self.store_failed, "/store_failed", &mut errors).unwrap_or_default();
        let unit = take_given(self.unit, "/unit", &mut errors).map(|text| unit_of(&text)).transpose();
        let unit = unit.map_err(|detail| errors.push(Fault::new("/unit", detail))).ok().flatten();
        if asked.representations.is_some() {
            let detail = "expected the representation of the cohort for all objects, got representations";
            errors.push(Fault::new("/representations", detail));
        }
        let stages = asked.stages.as_ref().and_then(Many::get).unwrap_or_default();
        let splits = kinds::splits(stages);
        if let Some(posted) = asked.representation.as_ref().and_then(Read::get)
            && !posted.becomes(&cohort.spec.representation, splits).unwrap_or(false)
        {
            let after = if splits > 0 { " after the splits of all stages" } else { "" };
            let detail = format!("expected the representation of the cohort{after}, got another one");
            errors.push(Fault::new("/representation", detail));
        }
        ServiceError::unless_empty(errors)?;
        Ok((asked, Storing { objects, store_failed, unit }))
    }
}

/// Numbers of dictionaries to choose from.
const STRUCTURES: std::ops::RangeInclusive<usize> = 2..=16;

document! {
    /// Attraction to the shapes that a class of transformations makes of a reference: `weight · ‖c − c*‖²/V^(2/d)`, with `c*` the
    /// nearest of them and `V` the area or volume.
    pub struct ShapePrior {
        /// The reference: any shape of the representation, in place of `cohort` and `dictionary`; or the part of the
        /// dictionary that attracts. Default: its mean.
        #[schema(value_type = Option<PriorReference>)]
        reference: Raw;
        /// Id or name of a cohort of the representation, whose mean under the class is the reference.
        #[schema(value_type = Option<String>)]
        cohort: Checked<String>;
        /// Id, `name@version`, `name@alias` or name of a dictionary of the representation.
        #[schema(value_type = Option<String>)]
        dictionary: Checked<String>;
        /// Two to sixteen dictionaries of one representation in place of `dictionary`: the one that lies nearest attracts, at each step
        /// anew.
        #[schema(value_type = Option<Vec<String>>, min_items = 2, max_items = 16)]
        dictionaries: Many<String>;
        /// Class of transformations.
        #[schema(value_type = Transformation, required = true)]
        transformation: Checked<Transformation>, required;
        /// Default: `projection`, or `procrustes` where the class is no linear space.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Weight `γ`. Default: 1.
        #[schema(value_type = Option<f64>, minimum = 0)]
        weight: Checked<f64>;
    }
}

/// A request whose fields were checked.
pub struct Checks {
    /// Settings; of a part `mask` the components are not known yet.
    pub wanted: Wanted,
    /// Settings for a part `mask`.
    pub of_mask: contours::Wanted,
    /// Slice of a volume.
    pub slice: Option<usize>,
}

impl SegmentRequest {
    /// The checked request; a part `mask` is named, but not read yet.
    ///
    /// # Errors
    /// All faults of the fields.
    pub fn wanted(
        mut self,
        app: &App,
        stored: Option<Stored>,
        has_mask: bool,
    ) -> Result<Checks, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let starts = self.starts(has_mask, &mut errors);
        let mask_labels = take_many(self.mask_labels, "/mask_labels", &mut errors);
        let least_cells = take_given(self.mask_least_cells, "/mask_least_cells", &mut errors).unwrap_or(1);
        let slice = take_given(self.slice, "/slice", &mut errors);
        let representation = self.representation.and_then(|field| field.take("/representation", &mut errors));
        let correspondence = take_or_default(self.correspondence, "/correspondence", &mut errors);
        let terms = take_many(self.terms, "/terms", &mut errors).unwrap_or_default();
        let stages = take_many(self.stages, "/stages", &mut errors).unwrap_or_default();
        let method = take_or_default(self.method, "/method", &mut errors).unwrap_or_default();
        let prior = self.prior.map(|prior| prior.taken(&mut errors));
        let coordinates = take_or_default(self.coordinates, "/coordinates", &mut errors);
        let keeping = Keeping {
            size_factor: take_given(self.size_factor, "/size_factor", &mut errors),
            box_factor: take_given(self.box_factor, "/box_factor", &mut errors),
            leave_box: take_given(self.leave_box, "/leave_box", &mut errors),
        };
        let truth_labels = take_many(self.truth_labels, "/truth_labels", &mut errors);
        let answered = answered(self.history, self.gradient, self.mask, &mut errors);
        let reference = match (&prior, &representation) {
            (Some(prior), Some(representation)) => prior.reference(stored, representation, &mut errors),
            _ => None,
        };
        let settings = settings(app, representation.zip(correspondence), prior.as_ref(), &mut errors)?;
        let kinds = kinds(app, settings, self.representations, &mut errors)?;
        ServiceError::unless_empty(errors)?;
        match (kinds, starts, coordinates) {
            (Some(kinds), Some(starts), Some(coordinates)) => {
                let wanted = Wanted {
                    kinds,
                    starts,
                    energy: EnergyInput { terms, stages, method },
                    prior: reference.zip(prior.and_then(|prior| prior.weight)),
                    coordinates,
                    unit: None,
                    keeping,
                    truth_labels,
                    answered,
                };
                let of_mask = contours::Wanted {
                    labels: mask_labels,
                    least_cells,
                    coordinates,
                    ..contours::Wanted::default()
                };
                Ok(Checks { wanted, of_mask, slice })
            }
            _ => Err(ServiceError::invalid("", "the request is incomplete")),
        }
    }
}

impl SegmentRequest {
    /// Where objects begin: exactly one of three fields and the part `mask`, whose components are not known yet.
    fn starts(&mut self, has_mask: bool, errors: &mut Vec<Fault>) -> Option<Starts> {
        let given = [
            ("/shapes", self.shapes.is_some()),
            ("/boxes", self.boxes.is_some()),
            ("/seeds", self.seeds.is_some()),
            ("/mask", has_mask),
        ];
        let given: Vec<&str> = given.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
        if !has_mask {
            let of_mask = [
                ("/mask_labels", self.mask_labels.is_some()),
                ("/mask_least_cells", self.mask_least_cells.is_some()),
            ];
            for (name, _) in of_mask.iter().filter(|(_, given)| *given) {
                errors.push(Fault::new(*name, "expected only with a part mask"));
            }
        }
        let found = match (self.shapes.take(), self.boxes.take(), self.seeds.take()) {
            (Some(shapes), ..) => Some(Starts::Shapes(shapes.take("/shapes", errors))),
            (_, Some(boxes), _) => take_many(Some(boxes), "/boxes", errors).map(Starts::Boxes),
            (.., seeds @ Some(_)) => take_many(seeds, "/seeds", errors).map(Starts::Seeds),
            _ => has_mask.then(|| Starts::Components(Vec::new())),
        };
        match given[..] {
            [_] => found,
            // A request whose fields could not be read has faults already.
            [] if !errors.is_empty() => None,
            _ => {
                let names = "expected one of shapes, boxes, seeds and a part mask";
                let detail = format!("{names}, got {}", given.len());
                errors.push(Fault::new(given.last().copied().unwrap_or("/shapes"), detail));
                None
            }
        }
    }
}

/// Further answers.
fn answered(
    history: Option<Checked<bool>>,
    gradient: Option<Checked<bool>>,
    mask: Option<Checked<bool>>,
    errors: &mut Vec<Fault>,
) -> Answered {
    let mut taken = |given, pointer| take_or_default(given, pointer, errors).unwrap_or_default();
    Answered {
        history: taken(history, "/history"),
        gradient: taken(gradient, "/gradient"),
        mask: taken(mask, "/mask"),
        outlines: false,
    }
}

/// The fields of a prior that could be read.
struct Taken {
    reference: Option<ShapeInput>,
    cohort: Option<String>,
    dictionary: Option<String>,
    dictionaries: Option<Vec<String>>,
    transformation: Option<Transformation>,
    alignment: Option<Alignment>,
    weight: Option<f64>,
}

impl ShapePrior {
    /// The mean that is the reference, with its class and alignment, where one is named and all of them could be read.
    pub fn stored(&self) -> Option<(Source, Transformation, Option<Alignment>)> {
        let part = match &self.reference {
            Some(part) => part.read(SMALL, "", &mut Vec::new()),
            None => Some(DictionaryPart::default()),
        };
        let source = match (&self.reference, &self.cohort, &self.dictionary, &self.dictionaries) {
            (None, Some(key), None, None) => Source::Cohort(key.get()?.clone()),
            (_, None, Some(key), None) => Source::Dictionaries(vec![key.get()?.clone()], part?),
            (_, None, None, Some(keys)) => Source::Dictionaries(structures(keys)?.to_vec(), part?),
            _ => return None,
        };
        let alignment = match &self.alignment {
            Some(alignment) => Some(*alignment.get()?),
            None => None,
        };
        Some((source, self.transformation.as_ref()?.get()?.clone(), alignment))
    }

    /// Whether it names a dictionary, or several.
    fn names_dictionaries(&self) -> bool {
        self.dictionary.is_some() || self.dictionaries.is_some()
    }

    fn taken(self, errors: &mut Vec<Fault>) -> Taken {
        let of_dictionaries = self.names_dictionaries();
        errors.extend(self.faults.into_iter().map(|fault| fault.below("/prior")));
        // The name of a part of a dictionary was read with it, unless it is faulty.
        let reference = self.reference.and_then(|reference| match (of_dictionaries, reference.is_text()) {
            (true, true) => {
                reference.read::<DictionaryPart>(SMALL, "/prior/reference", errors);
                None
            }
            _ => reference.read_large("/prior/reference", errors),
        });
        Taken {
            reference,
            cohort: take_given(self.cohort, "/prior/cohort", errors),
            dictionary: take_given(self.dictionary, "/prior/dictionary", errors),
            dictionaries: take_many(self.dictionaries, "/prior/dictionaries", errors),
            transformation: take_given(self.transformation, "/prior/transformation", errors),
            alignment: take_given(self.alignment, "/prior/alignment", errors),
            weight: self.weight.map_or(Some(1.0), |weight| weight.take("/prior/weight", errors)),
        }
    }
}

impl Taken {
    /// The reference, which is one of a shape and a mean of the representation.
    fn reference(
        &self,
        stored: Option<Stored>,
        representation: &Representation,
        errors: &mut Vec<Fault>,
    ) -> Option<Reference> {
        if let Some(keys) = &self.dictionaries
            && !STRUCTURES.contains(&keys.len())
        {
            let (least, most) = STRUCTURES.into_inner();
            let detail = format!("expected {least} to {most} dictionaries, got {}", keys.len());
            errors.push(Fault::new("/prior/dictionaries", detail));
            return None;
        }
        let named = [
            ("reference", self.reference.is_some()),
            ("cohort", self.cohort.is_some()),
            ("dictionary", self.dictionary.is_some()),
            ("dictionaries", self.dictionaries.is_some()),
        ];
        let given: Vec<&str> = named.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
        let [field] = given[..] else {
            // A key that could not be read has a fault already.
            if given.len() > 1 || errors.is_empty() {
                let names = named.map(|(name, _)| name).join(", ");
                let detail = format!("expected one of {names}, got {}", given.len());
                errors.push(Fault::new("/prior/reference", detail));
            }
            return None;
        };
        match (self.reference.clone(), stored) {
            (Some(shape), _) => Some(Reference::Posted(shape)),
            (None, Some(stored)) if stored.representation == *representation => {
                Some(Reference::Stored(std::iter::once(stored.first).chain(stored.others).collect()))
            }
            (None, Some(_)) => {
                let detail = format!("expected {field} of the representation of the request, got another");
                errors.push(Fault::new(format!("/prior/{field}"), detail));
                None
            }
            (None, None) => None,
        }
    }
}

/// The dictionaries to choose from, where they are as many as may be.
fn structures(keys: &Many<String>) -> Option<&[String]> {
    keys.get().filter(|keys| STRUCTURES.contains(&keys.len()))
}

/// The usual settings of the objects, and those of single ones, with faults at `/representations`.
fn kinds(
    app: &App,
    usual: Option<CheckedSettings>,
    others: Option<List<Option<Read<Representation>>>>,
    errors: &mut Vec<Fault>,
) -> Result<Option<Kinds>, ServiceError> {
    let given = others.is_some();
    let others = others.map(|others| others.take("/representations", errors)).unwrap_or_default();
    if given && others.is_empty() && errors.is_empty() {
        errors.push(Fault::new("/representations", "expected one for each object, got 0"));
    }
    let Some(usual) = usual else { return Ok(None) };
    let correspondence = usual.correspondence;
    let mut kinds = Kinds::new(usual);
    for (index, entry) in others.into_iter().enumerate() {
        let place = format!("/representations/{index}");
        let other = match entry.map(|entry| entry.take(&place, errors)) {
            Some(None) => continue,
            given => given.flatten(),
        };
        let mut own = Vec::new();
        let pushed = kinds.push(other, |other| {
            let found = settings(app, Some((other, correspondence)), None, &mut own);
            found.map_err(Some)?.ok_or(None)
        });
        errors.extend(own.into_iter().map(|fault| match fault.pointer.strip_prefix("/representation") {
            Some(below) => Fault { pointer: format!("{place}{below}"), ..fault },
            None => Fault { detail: format!("of {place}: {}", fault.detail), ..fault },
        }));
        if let Err(Some(error)) = pushed {
            return Err(error);
        }
    }
    Ok(Some(kinds))
}

/// Settings of the shapes and of the class of the prior; without a prior the class is not used.
fn settings(
    app: &App,
    shapes: Option<(Representation, Correspondence)>,
    prior: Option<&Taken>,
    errors: &mut Vec<Fault>,
) -> Result<Option<CheckedSettings>, ServiceError> {
    let Some((representation, correspondence)) = shapes else { return Ok(None) };
    let transformation = match prior {
        Some(prior) => prior.transformation.clone(),
        None => Some(Transformation::Named(ClassName::Affine)),
    };
    let Some(transformation) = transformation else { return Ok(None) };
    let usual = Alignment::usual(&transformation, representation.dimension());
    // Start points are compared between curves of one direction.
    let direction = match correspondence {
        Correspondence::Cyclic => Direction::Either,
        Correspondence::Landmarks | Correspondence::ArcLength => Direction::Given,
    };
    let settings = Settings {
        representation,
        correspondence,
        direction,
        mirror: Mirror::Forbid,
        transformation,
        alignment: prior.and_then(|prior| prior.alignment).unwrap_or(usual),
        frame: Frame::default(),
        estimator: Estimator::Plain,
    };
    match settings.checked(&app.limits) {
        Ok(settings) => Ok(Some(settings)),
        Err(ServiceError::Invalid(faults)) => {
            errors.extend(faults.into_listed().into_iter().map(|fault| match fault.pointer.as_str() {
                "/transformation" | "/alignment" => fault.below("/prior"),
                _ => fault,
            }));
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
