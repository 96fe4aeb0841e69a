//! The request for a segmentation, as it is posted, and the same as settings of a run.

use serde::{Deserialize, Serialize};

use super::image::Coordinates;
use super::sheets::{self, SheetField};
use crate::segmentation::blur::Blur;
use crate::segmentation::energy::Polarity;
use crate::segmentation::run::scene::{EdgeScale, ImageTerm};
use crate::segmentation::run::{Method, Settings, Stage};
use crate::segmentation::snake::reparametrisation::Free;
use crate::wire::fault::Fault;

/// Maximum number of terms, and of stages.
pub const MAX_TERMS: usize = 8;
/// Maximum number of iterations of a stage.
pub const MAX_ITERATIONS: usize = 2000;
/// Maximum blur in cells: kernels have 8 times as many numbers.
pub const MAX_BLUR: f64 = 64.0;
/// Least blur in cells along every axis for the contour term: with less, sampled second derivatives are wrong by more than a third, and
/// without a blur there are none.
pub const LEAST_BLUR: f64 = 0.5;
/// Usual weight of the attraction to initial shapes that fill boxes. Of nuclei in boxes that are wrong by a tenth, fewer are lost than
/// with 1; in boxes that are wrong by a quarter, contours are better than with 4.
const USUAL_START: f64 = 2.0;
/// Largest weight; smaller ones are as useless.
const MAX_WEIGHT: f64 = 1e9;

/// Whether objects are brighter (`bright`) or darker (`dark`) than their surroundings.
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

/// Field that an image term integrates: the image; or, of volumes, sheets that are detected in it, as `POST /v1/sheets`
/// does.
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
        /// Whether sheets are brighter or darker than their surroundings. Default: `bright`.
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
        /// Whether sheets are brighter or darker than their surroundings. Default: `bright`.
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
    /// Settings of the detector; `None` for the image itself.
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
        /// Default: by the contrast of the field in the initial shape and around it.
        #[serde(default)]
        polarity: Option<ObjectPolarity>,
        /// Default: the percentile 99.
        #[serde(default = "usual_edges")]
        #[schema(required = false)]
        edges: EdgeInput,
        /// Field that the term integrates. Default: `intensity`.
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
        /// Field that the term integrates. Default: `intensity`.
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
        /// Default: by the contrast of the field in the initial shape and around it.
        #[serde(default)]
        polarity: Option<ObjectPolarity>,
        /// Field that the term integrates. Default: `intensity`.
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
        /// Field that the term integrates. Default: `intensity`.
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
    /// Square distance from the initial shape, relative to its box. Default without this term: weight 2 with the term `contour`
    /// where shapes are kept to their boxes, else 0.
    Start {
        /// Weight `η`.
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

/// Degrees of freedom of a stage: an affine map of the shape (`affine`), distances from its centre (`radial`), or all
/// points (`all`).
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

/// Standard deviation of a blur: one number, or one for each axis of the image, x first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "expected a number, or a list of one for each axis of the image")]
pub enum SigmaInput {
    /// The same in all directions.
    Same(f64),
    /// Along x and y of an image in the plane.
    InPlane([f64; 2]),
    /// Along x, y and z of a volume.
    InSpace([f64; 3]),
}

impl SigmaInput {
    /// Along x, y and z.
    pub(super) fn along(self) -> [f64; 3] {
        match self {
            Self::Same(sigma) => [sigma; 3],
            Self::InPlane([x, y]) => [x, y, 0.0],
            Self::InSpace(sigmas) => sigmas,
        }
    }

    /// Number of axes that it is given for; `None` for all.
    fn axes(self) -> Option<usize> {
        match self {
            Self::Same(_) => None,
            Self::InPlane(_) => Some(2),
            Self::InSpace(_) => Some(3),
        }
    }

    /// In the cells of each axis, which have these sides.
    pub(super) fn in_cells(self, sides: &[f64]) -> impl Iterator<Item = f64> {
        self.along().into_iter().zip(sides).map(|(sigma, side)| sigma / side)
    }

    /// Faults at the field, in an image with cells of these sides and mean side `cell`; a blur needs `least` cells along every axis.
    fn faults(self, sides: &[f64], cell: f64, least: f64) -> Vec<Fault> {
        if let Some(axes) = self.axes().filter(|axes| *axes != sides.len()) {
            let detail = format!("expected a number, or one for each of {} axes, got {axes}", sides.len());
            return vec![Fault::new("", detail)];
        }
        let most = MAX_BLUR * cell;
        let longest = sides.iter().copied().fold(0.0, f64::max);
        let of_axis = |(axis, side): (usize, &f64)| {
            let side = if self.axes().is_some() { *side } else { longest };
            let (sigma, least) = (self.along()[axis], least * side);
            let detail = if !(0.0..=most).contains(&sigma) {
                format!("expected a number between 0 and {most} ({MAX_BLUR} cells), got {sigma}")
            } else if sigma < least {
                let what = "half a cell along every axis, for the term contour";
                format!("expected at least {least} ({what}), got {sigma}")
            } else {
                return None;
            };
            let place = if self.axes().is_some() { format!("/{axis}") } else { String::new() };
            Some(Fault::new(place, detail))
        };
        let axes = self.axes().unwrap_or(1);
        sides.iter().enumerate().take(axes).filter_map(of_axis).collect()
    }
}

impl From<SigmaInput> for Blur {
    fn from(sigma: SigmaInput) -> Self {
        Self::along(sigma.along())
    }
}

/// A stage of the minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StageInput {
    /// Degrees of freedom. Default: `all`.
    #[serde(default)]
    #[schema(required = false)]
    pub free: FreeInput,
    /// Standard deviation of the blur of the image, in the unit of the coordinates: one number, or one for each axis of the image.
    pub sigma: SigmaInput,
    /// Maximum number of iterations; 0 evaluates the energy. Default: 150.
    #[serde(default = "usual_iterations")]
    #[schema(minimum = 0, maximum = 2000, default = 150)]
    pub iterations: usize,
    /// How often the control mesh of a `subdivision` is split before the stage, at most as often in all stages as its `level` is: of 6
    /// control points one split makes 18, two 66, three 258. The surface stays the same, and later stages may move more
    /// of it. Default: 0.
    #[serde(default)]
    #[schema(required = false, maximum = 15)]
    pub splits: usize,
}

fn usual_iterations() -> usize {
    150
}

impl StageInput {
    /// An affine stage at a blur of two cells, then all points at blurs of two cells and of one, for cells with these `sides` in the
    /// world and in the coordinates of the request (`units`). Cells are counted by their shortest side in the world; along an axis
    /// with longer ones the blur has at least `least` cells of that axis. So slices that are thick beside their pixels are hardly
    /// blurred across, and small structures within them are still seen.
    pub fn usual(sides: &[f64], units: &[f64], least: f64) -> Vec<Self> {
        let shortest = sides.iter().copied().fold(f64::INFINITY, f64::min);
        let along = |cells: f64, axis: usize| units[axis] * (cells * shortest / sides[axis]).max(least);
        let sigma = |cells: f64| match sides.len() {
            _ if (0..sides.len()).all(|axis| along(cells, axis) == along(cells, 0)) => {
                SigmaInput::Same(along(cells, 0))
            }
            2 => SigmaInput::InPlane([0, 1].map(|axis| along(cells, axis))),
            _ => SigmaInput::InSpace([0, 1, 2].map(|axis| along(cells, axis))),
        };
        let stage =
            |free, cells| Self { free, sigma: sigma(cells), iterations: usual_iterations(), splits: 0 };
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
    /// Least blur that the terms allow, in cells along every axis.
    pub(super) fn least_blur(&self) -> f64 {
        if self.is_by_edges() { LEAST_BLUR } else { 0.0 }
    }

    /// Whether the term `contour` is among the terms. Its edges hold a shape against the attraction to the initial one, which the
    /// weaker pull of terms of regions would not reach.
    fn is_by_edges(&self) -> bool {
        self.terms.iter().any(|term| matches!(term, TermInput::Contour { .. }))
    }

    /// Faults of terms and stages, in an image whose cells have this mean side, and these sides along the axes.
    pub(super) fn faults(&self, cell: f64, sides: &[f64]) -> Vec<Fault> {
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
            let below = |fault: Fault| fault.below(&format!("/stages/{index}/sigma"));
            faults.extend(stage.sigma.faults(sides, cell, self.least_blur()).into_iter().map(below));
            if stage.iterations > MAX_ITERATIONS {
                let detail = format!("expected at most {MAX_ITERATIONS}, got {}", stage.iterations);
                faults.push(Fault::new(format!("/stages/{index}/iterations"), detail));
            }
        }
        faults
    }

    /// For each image term, whether its polarity is that of the contrast.
    pub(super) fn by_contrast(&self) -> impl Iterator<Item = bool> {
        self.terms.iter().filter(|term| term.of_image().is_some()).map(|term| {
            matches!(
                term,
                TermInput::Contour { polarity: None, .. } | TermInput::LocalContrast { polarity: None, .. }
            )
        })
    }

    /// The weight of the attraction to initial shapes; `None` without the term.
    fn start(&self) -> Option<f64> {
        self.terms
            .iter()
            .find_map(|term| if let TermInput::Start { weight } = term { Some(*weight) } else { None })
    }

    /// Image terms with their weights.
    pub(super) fn image_terms(&self) -> Vec<(ImageTerm, f64)> {
        self.terms.iter().filter_map(|term| term.of_image()).collect()
    }

    /// Positions and fields of the image terms.
    pub(super) fn fields(&self) -> impl Iterator<Item = (usize, FieldInput)> {
        self.terms.iter().enumerate().filter_map(|(index, term)| Some((index, term.field()?)))
    }

    /// Settings of a run with these stages, whose shapes are kept to their boxes scaled by a factor, or not.
    pub(super) fn settings<const D: usize>(&self, stages: &[StageInput], wall: Option<f64>) -> Settings<D> {
        let mut settings = Settings::new(stages.iter().map(|stage| stage.stage()).collect());
        settings.wall = wall;
        let usual = if wall.is_some() && self.is_by_edges() { USUAL_START } else { 0.0 };
        settings.hold = self.start().unwrap_or(usual);
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
            | Self::Start { weight }
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
            Self::Boundary { .. } | Self::Start { .. } | Self::Spacing { .. } => None,
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
                ImageTerm::Contour { polarity: polarity.unwrap_or_default().into(), edges }
            }
            Self::Threshold { theta, level, .. } => ImageTerm::Threshold { theta, level },
            Self::LocalContrast { polarity, .. } => {
                ImageTerm::LocalContrast { polarity: polarity.unwrap_or_default().into() }
            }
            Self::TwoClass { .. } => ImageTerm::TwoClass,
            Self::Boundary { .. } | Self::Start { .. } | Self::Spacing { .. } => return None,
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
