//! Checked settings for an image, and their faults.

use std::f64::consts::SQRT_2;

use super::image::Coordinates;
use super::kinds::Kinds;
use super::reference::Structure;
use super::request::{EnergyInput, FieldInput, StageInput};
use super::sheets;
use super::starts::Starts;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::image::Grid;
use crate::wire::shape::ShapeInput;
use crate::wire::unit::Unit;

/// Factor between the areas of a result and its initial shape beyond which it is usually another object, and between their volumes:
/// `√2` along each side. A box whose sides are a quarter too short or too long has 0.56 or 1.56 times the area, 0.42 or 1.95 times the
/// volume.
const SIZE_FACTORS: [f64; 2] = [2.0, 2.0 * SQRT_2];
/// Factor by which boxes are usually scaled: of one whose sides and centre are wrong by a quarter, the object ends within it.
const BOX_FACTOR: f64 = 1.5;
/// Largest factor; larger ones are as useless.
const MAX_FACTOR: f64 = 1e6;

/// Settings for an image.
#[derive(Debug)]
pub struct Wanted {
    /// Representations of the shapes, and the class of the prior.
    pub kinds: Kinds,
    /// Where objects begin.
    pub starts: Starts,
    /// Energy and stages.
    pub energy: EnergyInput,
    /// Shape whose class attracts, with its weight.
    pub prior: Option<(Reference, f64)>,
    /// Coordinates of shapes, blurs and the answer.
    pub coordinates: Coordinates,
    /// Unit of these coordinates, whatever the image states.
    pub unit: Option<Unit>,
    /// Bounds that keep results near their start.
    pub keeping: Keeping,
    /// Labels of the truth, one for each object; all but 0 without.
    pub truth_labels: Option<Vec<u32>>,
    /// Further answers.
    pub answered: Answered,
}

/// Shape whose class attracts.
#[derive(Debug)]
pub enum Reference {
    /// A posted shape.
    Posted(ShapeInput),
    /// Shapes of the representation, of which the nearest attract.
    Stored(Vec<Structure>),
}

impl Reference {
    /// The only shape that attracts, of the store.
    pub(super) fn stored_shape(&self) -> Option<Vec<f64>> {
        match self {
            Self::Stored(structures) => match structures.as_slice() {
                [Structure { shapes, is_span: false, .. }] => Some(shapes.concat()),
                _ => None,
            },
            Self::Posted(_) => None,
        }
    }

    /// Those of the attracting span.
    pub(super) fn spans(&self) -> impl Iterator<Item = &[Vec<f64>]> {
        let structures = match self {
            Self::Stored(structures) => structures.as_slice(),
            Self::Posted(_) => &[],
        };
        structures.iter().filter(|one| one.is_span).map(|one| one.shapes.as_slice())
    }

    /// Id of the dictionary at a position, where there are several to choose from.
    pub(super) fn choice(&self, index: usize) -> Option<&str> {
        match self {
            Self::Stored(structures) if structures.len() > 1 => structures.get(index)?.dictionary.as_deref(),
            _ => None,
        }
    }
}

/// Bounds that keep results near their start, as far as they are asked for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Keeping {
    /// Factor between sizes beyond which a result has left its object.
    pub size_factor: Option<f64>,
    /// Factor by which the box around an initial shape is scaled.
    pub box_factor: Option<f64>,
    /// Whether shapes may leave these boxes.
    pub leave_box: Option<bool>,
}

impl Keeping {
    /// The factor between the sizes of a result and of the initial shape at `index`. A seed without a radius says nothing about
    /// a size.
    pub(super) fn size_factor(&self, starts: &Starts, index: usize, dimension: usize) -> f64 {
        let usual = if starts.has_size(index) { SIZE_FACTORS[dimension - 2] } else { f64::INFINITY };
        self.size_factor.unwrap_or(usual)
    }

    /// The factor by which boxes are scaled; `None` where shapes may leave them.
    pub(super) fn box_factor(&self, starts: &Starts) -> Option<f64> {
        let is_usual = matches!(starts, Starts::Boxes(_)) || self.box_factor.is_some();
        let leaves = self.leave_box.unwrap_or(!is_usual);
        (!leaves).then(|| self.box_factor.unwrap_or(BOX_FACTOR))
    }

    fn faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (name, factor) in [("size_factor", self.size_factor), ("box_factor", self.box_factor)] {
            if let Some(factor) = factor.filter(|factor| !(1.0..=MAX_FACTOR).contains(factor)) {
                let detail = format!("expected a number between 1 and {MAX_FACTOR:e}, got {factor}");
                faults.push(Fault::new(format!("/{name}"), detail));
            }
        }
        if self.leave_box == Some(true) && self.box_factor.is_some() {
            let detail = "expected no box_factor where shapes may leave their boxes, got both";
            faults.push(Fault::new("/box_factor", detail));
        }
        faults
    }
}

/// Optional parts of the answer.
#[derive(Debug, Clone, Copy, Default)]
pub struct Answered {
    /// The energy after every iteration.
    pub history: bool,
    /// The gradient of the energy at the result.
    pub gradient: bool,
    /// The cells of the results.
    pub mask: bool,
    /// Outlines, for pictures and label images.
    pub outlines: bool,
}

impl Wanted {
    pub(super) fn faults(&self, grid: &Grid, app: &App) -> Vec<Fault> {
        let mut faults = self.energy.faults(self.cell(grid), &self.sides(grid));
        let axes = if grid.is_planar() { 2 } else { 3 };
        faults.extend(self.kinds.faults(self.starts.count(), axes, &self.energy.stages, &app.limits));
        for (index, detector) in self.detectors() {
            let place = |fault: Fault| match fault.pointer.as_str() {
                "/image" => Fault { pointer: String::new(), ..fault },
                _ => fault,
            };
            let below = |fault| place(fault).below(&format!("/terms/{index}/field"));
            faults.extend(detector.faults(grid).into_iter().map(below));
        }
        faults.extend(self.starts.faults(self.kinds.usual().representation.dimension(), &app.limits));
        faults.extend(self.keeping.faults());
        let count = self.starts.count();
        if let Some(labels) = &self.truth_labels
            && labels.len() != count
        {
            let detail = format!("expected a label for each of {count} shapes, got {}", labels.len());
            faults.push(Fault::new("/truth_labels", detail));
        }
        if self.prior.is_some() && !self.kinds.is_one(&self.energy.stages) {
            let detail = "expected one representation of all objects, and stages without splits, for a prior, got several";
            faults.push(Fault::new("/prior", detail));
        }
        if let Some((reference, _)) = &self.prior
            && reference.spans().next().is_some()
            && self.kinds.usual().linear_class().is_none()
        {
            let detail = "expected a linear class for components and atoms: Procrustes fits have no span";
            faults.push(Fault::new("/prior/transformation", detail));
        }
        if let Some((_, weight)) = self.prior
            && !(0.0..=1e9).contains(&weight)
        {
            faults.push(Fault::new(
                "/prior/weight",
                format!("expected a number between 0 and 1e9, got {weight}"),
            ));
        }
        faults
    }

    /// Converts shapes of the store that attract to the unit of the coordinates, where the class keeps sizes.
    ///
    /// # Errors
    /// Lengths where the others are none, and the other way round.
    pub(super) fn convert_prior(&mut self, unit: Option<Unit>) -> Result<(), ServiceError> {
        let keeps_size = !self.kinds.usual().transformation.removes_size();
        let (Some(unit), Some((Reference::Stored(structures), _)), true) =
            (unit, &mut self.prior, keeps_size)
        else {
            return Ok(());
        };
        for (index, structure) in structures.iter_mut().enumerate() {
            structure.convert(unit).map_err(|own| {
                let (own, unit) = (own.word(), unit.word());
                let detail = format!(
                    "expected coordinates in {own}, as those of reference {index} of the prior, whose class keeps sizes, got {unit}"
                );
                ServiceError::invalid("/prior", detail)
            })?;
        }
        Ok(())
    }

    /// Settings of the detector of sheets, by the positions of terms.
    pub(super) fn detectors(&self) -> impl Iterator<Item = (usize, sheets::Wanted)> {
        let detector = |(index, field): (usize, FieldInput)| Some((index, field.detector(self.coordinates)?));
        self.energy.fields().filter_map(detector)
    }

    /// Those that differ.
    pub(super) fn different_detectors(&self) -> Vec<sheets::Wanted> {
        let mut found: Vec<(FieldInput, sheets::Wanted)> = Vec::new();
        for (_, field) in self.energy.fields() {
            if let Some(detector) = field.detector(self.coordinates)
                && found.iter().all(|(known, _)| *known != field)
            {
                found.push((field, detector));
            }
        }
        found.into_iter().map(|(_, detector)| detector).collect()
    }

    /// The side of a cell in the unit of the coordinates.
    pub(super) fn cell(&self, grid: &Grid) -> f64 {
        match self.coordinates {
            Coordinates::Index => 1.0,
            Coordinates::World if grid.is_planar() => (grid.spacing()[0] * grid.spacing()[1]).sqrt(),
            Coordinates::World => grid.determinant().abs().cbrt(),
        }
    }

    /// The sides of a cell along the axes of the image, in the unit of the coordinates.
    pub(super) fn sides(&self, grid: &Grid) -> Vec<f64> {
        let axes = if grid.is_planar() { 2 } else { 3 };
        match self.coordinates {
            Coordinates::Index => vec![1.0; axes],
            Coordinates::World => grid.spacing()[..axes].to_vec(),
        }
    }

    pub(super) fn stages(&self, grid: &Grid) -> Vec<StageInput> {
        if self.energy.stages.is_empty() {
            let units = self.sides(grid);
            StageInput::usual(&grid.spacing()[..units.len()], &units, self.energy.least_blur())
        } else {
            self.energy.stages.clone()
        }
    }
}

/// Size of an image in messages.
pub(super) fn size(grid: &Grid) -> String {
    grid.size().map(|count| count.to_string()).join(" × ")
}
