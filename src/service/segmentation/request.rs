//! What a segmentation is asked for, as it is posted, and the same as settings of a run.

use serde::{Deserialize, Serialize};

use super::image::Coordinates;
use super::sheets::{self, SheetField};
use crate::formats::fault::Fault;
use crate::segmentation::energy::Polarity;
use crate::segmentation::run::scene::{EdgeScale, ImageTerm};
use crate::segmentation::run::{Method, Settings, Stage};
use crate::segmentation::snake::reparametrisation::Free;

/// Maximum number of terms, and of stages.
pub const MAX_TERMS: usize = 8;
/// Maximum number of iterations of a stage.
pub const MAX_ITERATIONS: usize = 2000;
/// Maximum blur in cells: kernels have 8 times as many numbers.
pub const MAX_BLUR: f64 = 64.0;
/// Least blur in cells along every axis for the contour term: with less, sampled second derivatives are wrong by more than a third, and
/// without a blur there are none.
pub const LEAST_BLUR: f64 = 0.5;
/// Largest weight; smaller ones are as useless.
const MAX_WEIGHT: f64 = 1e9;

/// Whether objects are brighter (`bright`) or darker (`dark`) than what is around them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectPolarity {
    /// Brighter.
    #[default]
    Bright,
    /// Darker.
    Dark,
}

impl From<ObjectPolarity> for Polarity {
    fn from(polarity: ObjectPolarity) -> Self {
        match polarity {
            ObjectPolarity::Bright => Self::Bright,
            ObjectPolarity::Dark => Self::Dark,
        }
    }
}

/// Scale of edges, by which the contour term is divided.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum EdgeInput {
    /// A percentile of the length of the gradient at the blur of the stage.
    Percentile {
        /// Between 0 and 100. 99 to 99.5 is usual.
        #[schema(minimum = 0, maximum = 100)]
        percent: f64,
    },
    /// For thin sheets in noise: the percentile at a blur of three cells, scaled to the blur of the stage.
    Sheets {
        /// Between 0 and 100.
        #[schema(minimum = 0, maximum = 100)]
        percent: f64,
    },
    /// A given scale, in units of the image per length.
    Given {
        /// The scale.
        #[schema(exclusive_minimum = 0)]
        scale: f64,
    },
}

/// What an image term integrates: the image; or, of volumes, sheets that are detected in it, as `POST /v1/sheets` does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum FieldInput {
    /// The image.
    Intensity {},
    /// Responses of the detector, 0 where they are negative.
    Sheets {
        /// Blur of the detector, in the unit of the coordinates. Default: two cells.
        #[serde(default)]
        #[schema(exclusive_minimum = 0)]
        sigma: Option<f64>,
        /// Whether sheets are brighter or darker than what is around them. Default: `bright`.
        #[serde(default)]
        #[schema(required = false)]
        polarity: ObjectPolarity,
    },
    /// 1 on the largest component of the innermost surface of crests around a point, 0 elsewhere: edges that enclose an object, which
    /// is `dark` in this field.
    EdgeMap {
        /// Blur of the detector, in the unit of the coordinates. Default: two cells.
        #[serde(default)]
        #[schema(exclusive_minimum = 0)]
        sigma: Option<f64>,
        /// Whether sheets are brighter or darker than what is around them. Default: `bright`.
        #[serde(default)]
        #[schema(required = false)]
        polarity: ObjectPolarity,
        /// Part of a percentile of the positive responses from which on there are crests. Default: 0.3.
        #[serde(default = "usual_fraction")]
        #[schema(minimum = 0, maximum = 1, default = 0.3)]
        fraction: f64,
        /// The percentile. Default: 99.
        #[serde(default = "usual_percent")]
        #[schema(minimum = 0, maximum = 100, default = 99)]
        percent: f64,
        /// Point around which the surface lies. Default: the middle of the volume.
        #[serde(default)]
        centre: Option<[f64; 3]>,
        /// Distance from this point above which the surface is looked for. Default: 0.
        #[serde(default)]
        #[schema(minimum = 0, default = 0)]
        beyond: f64,
    },
}

impl Default for FieldInput {
    fn default() -> Self {
        Self::Intensity {}
    }
}

fn usual_fraction() -> f64 {
    sheets::FRACTION
}

fn usual_percent() -> f64 {
    sheets::PERCENT
}

impl FieldInput {
    /// What is wanted of the detector; `None` for the image itself.
    pub(super) fn detector(self, coordinates: Coordinates) -> Option<sheets::Wanted> {
        let of_response = |sigma, polarity| sheets::Wanted {
            field: SheetField::Response,
            sigma,
            polarity,
            fraction: sheets::FRACTION,
            percent: sheets::PERCENT,
            centre: None,
            beyond: 0.0,
            coordinates,
            slice: None,
        };
        match self {
            Self::Intensity {} => None,
            Self::Sheets { sigma, polarity } => Some(of_response(sigma, polarity)),
            Self::EdgeMap { sigma, polarity, fraction, percent, centre, beyond } => Some(sheets::Wanted {
                field: SheetField::Surface,
                fraction,
                percent,
                centre: centre.map(Vec::from),
                beyond,
                ..of_response(sigma, polarity)
            }),
        }
    }
}

/// A term of the energy, with its weight (default: 1). All terms are dimensionless: weights depend neither on the unit of the image
/// nor on the size of the object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "name", rename_all = "snake_case", deny_unknown_fields)]
pub enum TermInput {
    /// Flux of the gradient of the image through the boundary.
    Contour {
        /// Weight.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
        /// Default: `bright`.
        #[serde(default)]
        #[schema(required = false)]
        polarity: ObjectPolarity,
        /// Default: the percentile 99.
        #[serde(default = "usual_edges")]
        #[schema(required = false)]
        edges: EdgeInput,
        /// What the term integrates. Default: `intensity`.
        #[serde(default)]
        #[schema(required = false)]
        field: FieldInput,
    },
    /// Region that is brighter than a fraction `theta` of a level.
    Threshold {
        /// Weight.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
        /// Default: 0.7.
        #[serde(default = "usual_theta")]
        #[schema(exclusive_minimum = 0, default = 0.7)]
        theta: f64,
        /// The level. Default: the median of the image in the initial shape.
        #[serde(default)]
        level: Option<f64>,
        /// What the term integrates. Default: `intensity`.
        #[serde(default)]
        #[schema(required = false)]
        field: FieldInput,
    },
    /// Mean of the image in the shape against that in a shell around it.
    LocalContrast {
        /// Weight.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
        /// Default: `bright`.
        #[serde(default)]
        #[schema(required = false)]
        polarity: ObjectPolarity,
        /// What the term integrates. Default: `intensity`.
        #[serde(default)]
        #[schema(required = false)]
        field: FieldInput,
    },
    /// Two means, in the shape and outside of it.
    TwoClass {
        /// Weight.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
        /// What the term integrates. Default: `intensity`.
        #[serde(default)]
        #[schema(required = false)]
        field: FieldInput,
    },
    /// Length or area of the boundary, relative to that of the initial shape.
    Boundary {
        /// Weight `κ`.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
    },
    /// Unevenness of the parameterisation, which keeps shapes from folding. Default without this term: weight 0.1.
    Spacing {
        /// Weight `ρ`.
        #[serde(default = "one")]
        #[schema(minimum = 0, default = 1)]
        weight: f64,
    },
}

fn one() -> f64 {
    1.0
}

fn usual_theta() -> f64 {
    0.7
}

fn usual_edges() -> EdgeInput {
    EdgeInput::Percentile { percent: 99.0 }
}

/// What is free in a stage: an affine map of the shape (`affine`), distances from its centre (`radial`), or all points (`all`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FreeInput {
    /// An affine map.
    Affine,
    /// Distances from the centre.
    Radial,
    /// All points.
    #[default]
    All,
}

/// Method of minimisation: `lbfgs`; `newton`, damped, for curves; or `coordinates`, one point after the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Minimiser {
    /// L-BFGS.
    #[default]
    Lbfgs,
    /// Damped Newton.
    Newton,
    /// One point after the other, with parabolas.
    Coordinates,
}

impl From<Minimiser> for Method {
    fn from(method: Minimiser) -> Self {
        match method {
            Minimiser::Lbfgs => Self::Lbfgs,
            Minimiser::Newton => Self::Newton,
            Minimiser::Coordinates => Self::Coordinates,
        }
    }
}

/// A stage of the minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StageInput {
    /// What is free. Default: `all`.
    #[serde(default)]
    #[schema(required = false)]
    pub free: FreeInput,
    /// Standard deviation of the blur of the image, in the unit of the coordinates.
    #[schema(minimum = 0)]
    pub sigma: f64,
    /// Maximum number of iterations; 0 evaluates the energy. Default: 150.
    #[serde(default = "usual_iterations")]
    #[schema(minimum = 0, maximum = 2000, default = 150)]
    pub iterations: usize,
}

fn usual_iterations() -> usize {
    150
}

impl StageInput {
    /// An affine stage at a blur of two cells, then all points at blurs of two cells and of one, at least `least`.
    pub fn usual(cell: f64, least: f64) -> Vec<Self> {
        let sigma = |cells: f64| (cells * cell).max(least);
        let stage = |free, cells| Self { free, sigma: sigma(cells), iterations: usual_iterations() };
        vec![stage(FreeInput::Affine, 2.0), stage(FreeInput::All, 2.0), stage(FreeInput::All, 1.0)]
    }

    fn stage(self) -> Stage {
        let free = match self.free {
            FreeInput::Affine => Free::Affine,
            FreeInput::Radial => Free::Radial,
            FreeInput::All => Free::All,
        };
        Stage { iterations: self.iterations, ..Stage::new(free, self.sigma) }
    }
}

/// Box that the initial ellipse, ellipsoid, cylinder or torus fills, in the coordinates of the request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxInput {
    /// Corner with the smallest coordinates.
    #[schema(min_items = 2, max_items = 3)]
    pub lower: Vec<f64>,
    /// Corner with the largest coordinates.
    #[schema(min_items = 2, max_items = 3)]
    pub upper: Vec<f64>,
}

impl BoxInput {
    /// Faults of the box for shapes of a dimension, with pointers relative to it.
    pub(super) fn faults(&self, dimension: usize) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (name, corner) in [("lower", &self.lower), ("upper", &self.upper)] {
            if corner.len() != dimension {
                let detail = format!("expected {dimension} coordinates, got {}", corner.len());
                faults.push(Fault::new(format!("/{name}"), detail));
            }
            let wild = corner.iter().position(|value| !(value.abs() <= crate::numeric::MAX_NUMBER));
            faults.extend(wild.map(|at| {
                let detail =
                    format!("expected a number within ±{:e}, got {}", crate::numeric::MAX_NUMBER, corner[at]);
                Fault::new(format!("/{name}/{at}"), detail)
            }));
        }
        let is_empty = |(low, high): (&f64, &f64)| !(low < high);
        if faults.is_empty()
            && let Some(at) = self.lower.iter().zip(&self.upper).position(is_empty)
        {
            let detail = format!("expected a number above lower, {}, got {}", self.lower[at], self.upper[at]);
            faults.push(Fault::new(format!("/upper/{at}"), detail));
        }
        faults
    }
}

/// Energy and stages.
#[derive(Debug, Clone, PartialEq)]
pub struct EnergyInput {
    /// Terms; at least one of the image.
    pub terms: Vec<TermInput>,
    /// Stages; the usual ones if there are none.
    pub stages: Vec<StageInput>,
    /// Method of minimisation.
    pub method: Minimiser,
}

impl EnergyInput {
    /// Least blur that the terms allow, in an image whose cells have this longest side.
    pub(super) fn least_blur(&self, longest: f64) -> f64 {
        let by_edges = self.terms.iter().any(|term| matches!(term, TermInput::Contour { .. }));
        if by_edges { LEAST_BLUR * longest } else { 0.0 }
    }

    /// Faults of terms and stages, in an image whose cells have this side, and this longest side along an axis.
    pub(super) fn faults(&self, cell: f64, longest: f64) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (list, count) in [("terms", self.terms.len()), ("stages", self.stages.len())] {
            if count > MAX_TERMS {
                let detail = format!("expected at most {MAX_TERMS} entries, got {count}");
                faults.push(Fault::new(format!("/{list}"), detail));
            }
        }
        if self.image_terms().is_empty() {
            let detail = "expected at least one of contour, threshold, local_contrast, two_class, got none";
            faults.push(Fault::new("/terms", detail));
        }
        for (index, term) in self.terms.iter().enumerate() {
            let same = |other: &TermInput| std::mem::discriminant(other) == std::mem::discriminant(term);
            if self.terms[..index].iter().any(same) {
                faults.push(Fault::new(format!("/terms/{index}"), "expected each term once, got it twice"));
            }
            let below = |fault: Fault| fault.below(&format!("/terms/{index}"));
            faults.extend(term.faults().into_iter().map(below));
        }
        for (index, stage) in self.stages.iter().enumerate() {
            let most = MAX_BLUR * cell;
            if !(0.0..=most).contains(&stage.sigma) {
                let detail =
                    format!("expected a number between 0 and {most} ({MAX_BLUR} cells), got {}", stage.sigma);
                faults.push(Fault::new(format!("/stages/{index}/sigma"), detail));
            } else if stage.sigma < self.least_blur(longest) {
                let least = self.least_blur(longest);
                let what = "half a cell along every axis, for the term contour";
                let detail = format!("expected at least {least} ({what}), got {}", stage.sigma);
                faults.push(Fault::new(format!("/stages/{index}/sigma"), detail));
            }
            if stage.iterations > MAX_ITERATIONS {
                let detail = format!("expected at most {MAX_ITERATIONS}, got {}", stage.iterations);
                faults.push(Fault::new(format!("/stages/{index}/iterations"), detail));
            }
        }
        faults
    }

    /// Image terms with their weights.
    pub(super) fn image_terms(&self) -> Vec<(ImageTerm, f64)> {
        self.terms.iter().filter_map(|term| term.of_image()).collect()
    }

    /// Positions and fields of the image terms.
    pub(super) fn fields(&self) -> impl Iterator<Item = (usize, FieldInput)> {
        self.terms.iter().enumerate().filter_map(|(index, term)| Some((index, term.field()?)))
    }

    /// Settings of a run with these stages.
    pub(super) fn settings<const D: usize>(&self, stages: &[StageInput]) -> Settings<D> {
        let mut settings = Settings::new(stages.iter().map(|stage| stage.stage()).collect());
        settings.method = self.method.into();
        for term in &self.terms {
            match term {
                TermInput::Boundary { weight } => settings.boundary = *weight,
                TermInput::Spacing { weight } => settings.spacing = *weight,
                _ => {}
            }
        }
        settings
    }
}

impl TermInput {
    fn weight(&self) -> f64 {
        match self {
            Self::Contour { weight, .. }
            | Self::Threshold { weight, .. }
            | Self::LocalContrast { weight, .. }
            | Self::TwoClass { weight, .. }
            | Self::Boundary { weight }
            | Self::Spacing { weight } => *weight,
        }
    }

    /// The field of an image term.
    fn field(&self) -> Option<FieldInput> {
        match self {
            Self::Contour { field, .. }
            | Self::Threshold { field, .. }
            | Self::LocalContrast { field, .. }
            | Self::TwoClass { field, .. } => Some(*field),
            Self::Boundary { .. } | Self::Spacing { .. } => None,
        }
    }

    fn of_image(&self) -> Option<(ImageTerm, f64)> {
        let term = match *self {
            Self::Contour { polarity, edges, .. } => {
                let edges = match edges {
                    EdgeInput::Percentile { percent } => EdgeScale::Percentile(percent),
                    EdgeInput::Sheets { percent } => EdgeScale::Sheets(percent),
                    EdgeInput::Given { scale } => EdgeScale::Given(scale),
                };
                ImageTerm::Contour { polarity: polarity.into(), edges }
            }
            Self::Threshold { theta, level, .. } => ImageTerm::Threshold { theta, level },
            Self::LocalContrast { polarity, .. } => ImageTerm::LocalContrast { polarity: polarity.into() },
            Self::TwoClass { .. } => ImageTerm::TwoClass,
            Self::Boundary { .. } | Self::Spacing { .. } => return None,
        };
        Some((term, self.weight()))
    }

    /// Faults, with pointers relative to the term.
    fn faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut expect = |holds: bool, field: &str, expected: &str, found: f64| {
            if !holds {
                faults.push(Fault::new(field, format!("expected {expected}, got {found}")));
            }
        };
        let weight = self.weight();
        expect((0.0..=MAX_WEIGHT).contains(&weight), "/weight", "a number between 0 and 1e9", weight);
        let positive = |value: f64| value > 0.0 && value <= MAX_WEIGHT;
        match *self {
            Self::Contour {
                edges: EdgeInput::Percentile { percent } | EdgeInput::Sheets { percent },
                ..
            } => {
                let holds = (0.0..=100.0).contains(&percent);
                expect(holds, "/edges/percent", "a number between 0 and 100", percent);
            }
            Self::Contour { edges: EdgeInput::Given { scale }, .. } => {
                expect(positive(scale), "/edges/scale", "a positive number of at most 1e9", scale);
            }
            Self::Threshold { theta, level, .. } => {
                expect(positive(theta), "/theta", "a positive number of at most 1e9", theta);
                if let Some(level) = level {
                    expect(positive(level), "/level", "a positive number of at most 1e9", level);
                }
            }
            _ => {}
        }
        faults
    }
}
