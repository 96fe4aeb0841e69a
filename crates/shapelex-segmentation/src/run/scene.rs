//! An image with the fields of the image terms, prepared once for any number of objects.

use std::ops::Range;
use std::sync::Arc;

use crate::SegmentationError;
use crate::blur::Blur;
use crate::energy::{Contour, LocalContrast, Polarity, Shape, Term, Threshold, TwoClass};
use crate::field::filter::{DerivativeRows, LaplacianRows, blur, gradient_length, laplacian};
use crate::field::image::percentile;
use crate::field::{Image, Integrated, Value};
use crate::frame::Frame;
use crate::snake::{Model, Outline};

use shapelex_geometry::raster::Grid;
use shapelex_numeric::bounded::{Stop, never};

/// Blur at which edges of noisy images are measured, in cells.
const MEASURED: f64 = 3.0;
/// Decrease of the edge scale of thin sheets with the blur.
const SHEET_POWER: f64 = 1.5;
/// Volume of a first shape, in cells, that is rounding.
const NOTHING: f64 = 1e-6;
/// Size of the box whose cells are near a shape, relative to that around it.
const NEAR: f64 = 1.5;
/// Percentiles between which the range of an image is measured: outliers do not count.
const RANGE: [f64; 2] = [1.0, 99.0];

/// The scale `e_σ` of edges in the contour energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EdgeScale {
    /// A percentile of `|∇f_σ|`; 99 to 99.5 is usual.
    Percentile(f64),
    /// For thin sheets in noise: `e_3 (3/max(σ, 1))^1.5` with the percentile of `|∇f_3|` at a blur of three cells. The
    /// percentile at a small blur would measure the noise.
    Sheets(f64),
    /// A given scale, in units of the image per length.
    Given(f64),
}

/// An image term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ImageTerm {
    /// See [`crate::energy::contour`].
    Contour {
        /// The sign.
        polarity: Polarity,
        /// The scale of edges.
        edges: EdgeScale,
    },
    /// See [`crate::energy::threshold`].
    Threshold {
        /// `θ`.
        theta: f64,
        /// The level; `None`: the median of the image inside of the first shape.
        level: Option<f64>,
    },
    /// See [`crate::energy::local_contrast`].
    LocalContrast {
        /// The sign.
        polarity: Polarity,
    },
    /// See [`crate::energy::two_class`].
    TwoClass,
}

/// An image term with the field that it integrates: the image, or a derived one.
#[derive(Debug, Clone)]
pub struct FieldTerm {
    /// The field.
    pub field: Arc<Image>,
    /// The term.
    pub term: ImageTerm,
    /// Its weight.
    pub weight: f64,
    /// Whether the polarity is that of the contrast of the field in and around the first shape, in place of that of the term.
    pub by_contrast: bool,
}

impl FieldTerm {
    /// Prepares the term for a blur. `measured`: see [`measured`](fn@measured).
    fn prepared<const D: usize>(&self, frame: &Frame<D>, measured: Option<f64>, sigma: Blur) -> Prepared<D> {
        prepare(&self.field, frame, &self.term, measured, sigma)
    }
}

/// The field whose median in the first shape is a level.
fn field_of_levels(terms: &[FieldTerm]) -> Option<Arc<Image>> {
    let open = |term: &&FieldTerm| matches!(term.term, ImageTerm::Threshold { level: None, .. });
    terms.iter().find(open).map(|term| term.field.clone())
}

/// The different ones of `sigmas`, in order.
fn distinct(sigmas: &[Blur]) -> Vec<Blur> {
    let mut found = Vec::new();
    for sigma in sigmas {
        if !found.contains(sigma) {
            found.push(*sigma);
        }
    }
    found
}

/// Prepared form of a term for one blur.
#[derive(Debug, Clone)]
enum Prepared<const D: usize> {
    Contour {
        laplacian: Arc<Integrated<D>>,
        polarity: Polarity,
        edge: f64,
    },
    Threshold {
        saturated: Arc<Integrated<D>>,
        theta: f64,
    },
    /// The level comes with the first shape.
    Blurred {
        image: Arc<Image>,
        theta: f64,
    },
    LocalContrast {
        image: Arc<Integrated<D>>,
        polarity: Polarity,
        contrast: f64,
    },
    TwoClass {
        centred: Arc<Integrated<D>>,
        total: f64,
        variance: f64,
    },
}

/// An image with fields for a list of blurs.
#[derive(Debug, Clone)]
pub struct Scene<const D: usize> {
    size: [usize; 3],
    /// The image whose median in the first shape is a level, where a term needs one.
    levels: Option<Arc<Image>>,
    frame: Frame<D>,
    /// For every term, the field whose contrast is its polarity.
    contrasts: Vec<Option<Arc<Image>>>,
    /// For every blur, the terms with their weights.
    fields: Vec<(Blur, Vec<(Prepared<D>, f64)>)>,
}

/// Measures of a first shape that scale the terms.
#[derive(Debug, Clone, PartialEq)]
pub struct Measures {
    /// `A₀`, the length or area of the boundary.
    pub boundary: f64,
    /// `V₀`, the enclosed area or volume.
    pub volume: f64,
    /// Median of the image inside.
    pub median: Option<f64>,
    /// For each image term, the polarity by the contrast of its field; `None` where it is given.
    pub polarities: Vec<Option<Polarity>>,
}

impl Measures {
    /// Measures a first shape in a scene.
    ///
    /// # Errors
    /// [`SegmentationError::NoVolume`].
    pub(super) fn of<const D: usize>(
        scene: &Scene<D>,
        model: &dyn Model<D>,
        rows: &[[f64; D]],
    ) -> Result<Self, SegmentationError> {
        let boundary = model.boundary(rows, 1.0, scene.frame);
        let shape = Shape::new(&*boundary, rows);
        let (volume, measure) = (shape.volume.value, boundary.measure(&shape.samples).value);
        let cells = volume / scene.frame.determinant().abs();
        if !(cells > NOTHING && measure > 0.0 && volume.is_finite() && measure.is_finite()) {
            return Err(SegmentationError::NoVolume { volume });
        }
        let median = scene.median(model, rows);
        let polarities = scene.polarities(&model.outline(rows));
        Ok(Self { boundary: measure, volume, median, polarities })
    }
}

impl<const D: usize> Scene<D> {
    /// Prepares an image for terms with weights, at the blurs of the stages.
    ///
    /// Memory: about 24 bytes per cell and blur of every term while preparing, 8 to keep; in the plane, rows of the terms `Contour` and
    /// `LocalContrast` are made when an object asks for them.
    pub fn new<T: Value>(
        image: &Image<T>,
        frame: Frame<D>,
        terms: &[(ImageTerm, f64)],
        sigmas: &[impl Into<Blur> + Copy],
    ) -> Self {
        let sigmas: Vec<Blur> = sigmas.iter().map(|sigma| (*sigma).into()).collect();
        let field: Arc<Image> = Arc::new(image.map(|value| value));
        let of_image = |(term, weight): &(ImageTerm, f64)| FieldTerm {
            field: field.clone(),
            term: *term,
            weight: *weight,
            by_contrast: false,
        };
        let terms: Vec<FieldTerm> = terms.iter().map(of_image).collect();
        Self::of_fields(image.size(), frame, &terms, &sigmas, &never).expect("nothing stops")
    }

    /// As [`Scene::new`] for terms with separate fields, all of one `size`. `None` if the caller wants to stop, which is looked at
    /// before each term and blur.
    pub fn of_fields(
        size: [usize; 3],
        frame: Frame<D>,
        terms: &[FieldTerm],
        sigmas: &[Blur],
        stop: Stop<'_>,
    ) -> Option<Self> {
        let (levels, mut fields) = (field_of_levels(terms), Vec::new());
        let known = terms.iter().map(|term| (!stop()).then(|| measured(&term.field, &frame, &term.term)));
        let known: Vec<Option<f64>> = known.collect::<Option<_>>()?;
        for sigma in distinct(sigmas) {
            let prepared = terms
                .iter()
                .zip(&known)
                .map(|(term, known)| (!stop()).then(|| (term.prepared(&frame, *known, sigma), term.weight)));
            fields.push((sigma, prepared.collect::<Option<_>>()?));
        }
        let contrasts = terms.iter().map(|term| term.by_contrast.then(|| term.field.clone())).collect();
        Some(Self { size, levels, frame, contrasts, fields })
    }

    /// Number of cells of the image along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The frame of the image.
    pub fn frame(&self) -> &Frame<D> {
        &self.frame
    }

    /// Median of the image of levels in the cells of a shape.
    fn median(&self, model: &dyn Model<D>, rows: &[[f64; D]]) -> Option<f64> {
        let (image, size) = (self.levels.as_ref()?, self.size);
        let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size };
        let mask = model.outline(rows).cells(&grid);
        let cells = mask.inside.iter().enumerate().filter(|(_, inside)| **inside);
        let value = |(at, _): (usize, &bool)| {
            image.at([at / (size[1] * size[2]), at / size[2] % size[1], at % size[2]])
        };
        percentile(cells.map(value).collect(), 50.0)
    }

    /// For each term, the polarity by the contrast of its field in a shape and around it, where it is not given: `Dark` if the mean
    /// of the cells in the shape is below that of the others of the box around it, [`NEAR`] times as large.
    fn polarities(&self, outline: &Outline) -> Vec<Option<Polarity>> {
        if self.contrasts.iter().all(Option::is_none) {
            return vec![None; self.contrasts.len()];
        }
        let around = around(outline.bounds(), self.size);
        let [along_x, along_y, along_z] = around.clone();
        let grid = Grid {
            first: around.each_ref().map(|range| range.start as f64),
            spacing: [1.0; 3],
            size: around.each_ref().map(ExactSizeIterator::len),
        };
        let mask = outline.cells(&grid);
        let polarity = |field: &Arc<Image>| {
            let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
            let cells = along_x.clone().flat_map(|i| along_y.clone().map(move |j| (i, j)));
            let cells = cells.flat_map(|(i, j)| along_z.clone().map(move |k| [i, j, k]));
            for (cell, inside) in cells.zip(&mask.inside) {
                sums[usize::from(*inside)] += field.at(cell);
                counts[usize::from(*inside)] += 1.0;
            }
            let is_dark = sums[1] * counts[0] < sums[0] * counts[1];
            if is_dark { Polarity::Dark } else { Polarity::Bright }
        };
        self.contrasts.iter().map(|field| field.as_ref().map(polarity)).collect()
    }

    /// The image terms at a blur.
    pub(super) fn terms(
        &self,
        sigma: Blur,
        measures: &Measures,
        centre: &[f64],
    ) -> Result<Vec<(Term<D>, f64)>, SegmentationError> {
        let known = self.fields.iter().find(|(known, _)| *known == sigma);
        let (_, terms) = known.ok_or(SegmentationError::Stages { sigma: Some(sigma) })?;
        let polarities = measures.polarities.iter();
        let term = |((prepared, weight), polarity): (&(Prepared<D>, f64), &Option<Polarity>)| {
            let mut term = prepared.term(measures, centre)?;
            match (&mut term, polarity) {
                (Term::Contour(term), Some(polarity)) => term.polarity = *polarity,
                (Term::LocalContrast(term), Some(polarity)) => term.polarity = *polarity,
                _ => {}
            }
            Ok((term, *weight))
        };
        terms.iter().zip(polarities).map(term).collect()
    }
}

/// The cells of an image of this size in the box between two corners, [`NEAR`] times as large.
fn around(bounds: Option<[[f64; 3]; 2]>, size: [usize; 3]) -> [Range<usize>; 3] {
    let [lower, upper] = bounds.unwrap_or([[0.0; 3]; 2]);
    std::array::from_fn(|c| {
        let (middle, half) = (0.5 * (lower[c] + upper[c]), 0.5 * NEAR * (upper[c] - lower[c]));
        let last = size[c] as f64;
        (middle - half).ceil().clamp(0.0, last) as usize
            ..((middle + half).floor() + 1.0).clamp(0.0, last) as usize
    })
}

/// The Laplacian of the blurred image. In the plane, rows are made when an object asks for them.
fn integrated_laplacian<const D: usize>(
    image: &Arc<Image>,
    frame: &Frame<D>,
    cells: [f64; 3],
) -> Integrated<D> {
    if D != 2 {
        return Integrated::new(&laplacian(image, cells, frame.metric()));
    }
    let (image, rows) = (image.clone(), LaplacianRows::new(image.size(), cells, frame.metric()));
    Integrated::of_rows(image.size(), Arc::new(move |j| rows.row(&image, j)))
}

/// The blurred image, likewise.
fn integrated_blur<const D: usize>(image: &Arc<Image>, cells: [f64; 3]) -> Integrated<D> {
    if D != 2 {
        return Integrated::new(&blur(image, cells));
    }
    let (image, rows) = (image.clone(), DerivativeRows::new(image.size(), cells, [0; 3]));
    Integrated::of_rows(image.size(), Arc::new(move |j| rows.row(&image, j)))
}

/// Prepares a term for a blur. `measured`: see [`measured`].
fn prepare<const D: usize>(
    image: &Arc<Image>,
    frame: &Frame<D>,
    term: &ImageTerm,
    measured: Option<f64>,
    sigma: Blur,
) -> Prepared<D> {
    let cells = sigma.in_cells(frame);
    match term {
        ImageTerm::Contour { polarity, edges } => {
            let cell = cell_side(frame);
            let edge = match edges {
                EdgeScale::Given(edge) => *edge,
                EdgeScale::Percentile(percent) => edge(image, frame, sigma, *percent),
                EdgeScale::Sheets(_) => {
                    measured.unwrap_or(0.0) * (MEASURED * cell / sigma.mean(D).max(cell)).powf(SHEET_POWER)
                }
            };
            let laplacian = Arc::new(integrated_laplacian(image, frame, cells));
            Prepared::Contour { laplacian, polarity: *polarity, edge }
        }
        ImageTerm::Threshold { theta, level: Some(level) } => {
            let saturated = Arc::new(Integrated::new(&blur(image, cells).saturate(*level)));
            Prepared::Threshold { saturated, theta: *theta }
        }
        ImageTerm::Threshold { theta, level: None } => {
            Prepared::Blurred { image: Arc::new(blur(image, cells)), theta: *theta }
        }
        ImageTerm::LocalContrast { polarity } => {
            let image = Arc::new(integrated_blur(image, cells));
            Prepared::LocalContrast { image, polarity: *polarity, contrast: measured.unwrap_or(0.0) }
        }
        ImageTerm::TwoClass => {
            let blurred = blur(image, cells);
            let (mean, variance) = (blurred.mean(), blurred.variance());
            let total = blurred.values().len() as f64 * frame.determinant().abs();
            let centred = Arc::new(Integrated::new(&blurred.map::<f64>(|value| value - mean)));
            Prepared::TwoClass { centred, total, variance }
        }
    }
}

/// The percentile of `|∇f_σ|`.
fn edge<const D: usize>(image: &Image, frame: &Frame<D>, sigma: Blur, percent: f64) -> f64 {
    gradient_length(image, sigma.in_cells(frame), frame.metric()).percentile(percent)
}

/// The side of a cell in units of length.
fn cell_side<const D: usize>(frame: &Frame<D>) -> f64 {
    frame.determinant().abs().powf(1.0 / D as f64)
}

/// Data of a term that do not depend on the blur of a stage: `e_3` for sheets, `con` for the local contrast.
fn measured<const D: usize>(image: &Image, frame: &Frame<D>, term: &ImageTerm) -> Option<f64> {
    match term {
        ImageTerm::Contour { edges: EdgeScale::Sheets(percent), .. } => {
            Some(edge(image, frame, Blur::from(MEASURED * cell_side(frame)), *percent))
        }
        ImageTerm::LocalContrast { .. } => {
            let [low, high] = RANGE.map(|percent| image.percentile(percent));
            Some(high - low)
        }
        _ => None,
    }
}

impl<const D: usize> Prepared<D> {
    fn term(&self, measures: &Measures, centre: &[f64]) -> Result<Term<D>, SegmentationError> {
        Ok(match self {
            Self::Contour { laplacian, polarity, edge } => {
                let scale = positive("edges", edge * measures.boundary)?;
                Term::Contour(Contour { laplacian: laplacian.clone(), polarity: *polarity, scale })
            }
            Self::Threshold { saturated, theta } => {
                let (saturated, theta, scale) = (saturated.clone(), *theta, measures.volume);
                Term::Threshold(Threshold { saturated, theta, scale })
            }
            Self::Blurred { image, theta } => {
                let level = positive("the median in the first shape", measures.median.unwrap_or(0.0))?;
                let saturated = Arc::new(Integrated::new(&image.saturate(level)));
                Term::Threshold(Threshold { saturated, theta: *theta, scale: measures.volume })
            }
            Self::LocalContrast { image, polarity, contrast } => Term::LocalContrast(LocalContrast {
                image: image.clone(),
                polarity: *polarity,
                contrast: positive("the range of the image", *contrast)?,
                centre: centre.into(),
            }),
            Self::TwoClass { centred, total, variance } => Term::TwoClass(TwoClass {
                centred: centred.clone(),
                total: *total,
                variance: positive("the variance of the image", *variance)?,
            }),
        })
    }
}

/// Scales that divide must be positive.
fn positive(what: &'static str, value: f64) -> Result<f64, SegmentationError> {
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err(SegmentationError::Scale { what, value }) }
}
