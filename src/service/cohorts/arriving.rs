//! Shapes of an upload on their way: as received, and as rows for the store.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use super::measures::Measuring;
use super::placer::{Found, MeshFit, Placer};
use super::upload::UploadResult;
use crate::analysis::conversion::{Beginning, Conversion};
use crate::analysis::correspondence::Correspondence;
use crate::domain::id;
use crate::domain::shape::{MAX_NAMES, NewShape, ShapeMeasures};
use crate::geometry::resample::check_extent;
use crate::service::app::ServiceError;
use crate::service::shapes::names::external_id;
use crate::service::shapes::read::{ReadShape, Reading, parse, read_shape};
use crate::store::ShapeRow;
use crate::wire::fault::Fault;
use crate::wire::files::{Geometry, Place, Record};
use crate::wire::ndjson::Line;
use crate::wire::record::Placing;
use crate::wire::shape::ShapeInput;
use crate::wire::unit::Unit;

/// A shape as received.
pub(super) enum Incoming {
    Line(Line),
    Parsed(Box<ShapeInput>),
    Record(Box<Record>),
}

/// Where a shape was in a body, a stream or a file.
#[derive(Debug, Default)]
pub(super) struct Origin {
    /// Position in the input, from 0.
    index: usize,
    external_id: Option<String>,
    line: Option<u64>,
    place: Place,
    /// Whether it came in a file, whose shapes may be numbered.
    is_of_file: bool,
}

impl Origin {
    /// The fault with the known parts of its place.
    pub(super) fn of(&self, fault: Fault) -> Fault {
        Fault { line: self.line, ..fault }.at_place(&self.place)
    }

    /// The fault that the external id belongs to another shape.
    pub(super) fn conflict(&self, external_id: &str, prefix: &str) -> Fault {
        let pointer = match prefix {
            "" => "/external_id".into(),
            prefix => format!("{prefix}{}/external_id", self.index),
        };
        let mut detail = format!(
            "the external id '{external_id}' belongs to another shape of the cohort, with other points"
        );
        if self.is_of_file {
            detail.push_str(
                ": the parameter name or prefix tells the shapes of files apart, names=number those of one file",
            );
        }
        self.of(Fault::new(pointer, detail).at_shape(self.index))
    }

    /// Outcome of the shape if its external id belongs to another one.
    pub(super) fn refused(&self, prefix: &str) -> UploadResult {
        let name = self.external_id.clone();
        let faults = vec![self.conflict(name.as_deref().unwrap_or_default(), prefix)];
        UploadResult { index: self.index, external_id: name, faults, ..UploadResult::default() }
    }
}

/// Names of the further attributes of shapes that are read at the same time, each once and no more than are refused.
#[derive(Default)]
pub(super) struct BroughtNames(Mutex<BTreeSet<String>>);

impl BroughtNames {
    fn add<'a>(&self, of_shape: impl Iterator<Item = &'a String>) {
        let mut names = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if names.len() <= MAX_NAMES {
            for name in of_shape {
                if !names.contains(name) {
                    names.insert(name.clone());
                }
            }
        }
    }

    pub(super) fn into_set(self) -> BTreeSet<String> {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

/// External id of an input, and its shape or its faults.
pub(super) type Taken = (Option<String>, Result<Arrived, Vec<Fault>>);

/// A shape on its way to the store, with its place in the stream.
pub(super) struct Arrived {
    pub(super) origin: Origin,
    pub(super) row: ShapeRow,
    /// Number of repeated points that were dropped.
    pub(super) repeated_points: usize,
    pub(super) measures: ShapeMeasures,
    /// Warnings of the fit of a surface to a mesh.
    pub(super) warnings: Vec<String>,
}

impl Incoming {
    /// Bytes to be parsed.
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Line(line) => line.text.len(),
            Self::Parsed(_) | Self::Record(_) => 0,
        }
    }

    /// Unit of the coordinates of a record, where it is known.
    pub(super) fn unit(&self, placing: &Placing) -> Option<Unit> {
        match self {
            Self::Record(record) => placing.unit_of(record),
            Self::Line(_) | Self::Parsed(_) => None,
        }
    }

    /// Number of vertices of a mesh.
    pub(super) fn mesh_vertices(&self) -> Option<usize> {
        match self {
            Self::Record(record) => match &record.geometry {
                Geometry::Mesh(mesh) => Some(mesh.vertices.len()),
                _ => None,
            },
            Self::Line(_) | Self::Parsed(_) => None,
        }
    }
}

/// Parses the shape at `index` of the upload and makes a row of it. Its text and parsed values end here.
pub(super) fn read(
    placer: &Placer<'_>,
    measuring: &Measuring,
    names: &BroughtNames,
    incoming: Incoming,
    index: usize,
    prefix: &str,
) -> Taken {
    let reading = placer.reading();
    let at = Origin { index, ..Origin::default() };
    let (mut origin, shape) = match incoming {
        Incoming::Line(Line { number, text }) => {
            let origin = Origin { line: Some(number), ..at };
            (origin, parse(reading.limits, text.trim_ascii_end()).map(Incoming::Parsed))
        }
        Incoming::Parsed(shape) => (at, Ok(Incoming::Parsed(shape))),
        Incoming::Record(record) => {
            let place = record.place.clone();
            (Origin { line: place.line, place, is_of_file: true, ..at }, Ok(Incoming::Record(record)))
        }
    };
    // Each line is a separate document; in a body, pointers include the position of the shape.
    let prefix = if prefix.is_empty() { String::new() } else { format!("{prefix}{index}") };
    let placed = |fault: Fault| {
        let pointer = format!("{prefix}{}", fault.pointer);
        origin.of(Fault { pointer, index: Some(index), ..fault })
    };
    let all = |faults: Vec<Fault>| faults.into_iter().map(placed).collect();
    let (external_id, shape) = match shape {
        Ok(Incoming::Parsed(shape)) => {
            (external_id(&shape).map(str::to_owned), read_shape(reading, *shape).map(Found::from))
        }
        Ok(Incoming::Record(record)) => (record.name.clone(), placer.read(*record)),
        Ok(Incoming::Line(_)) => return (None, Err(vec![placed(Fault::new("", "expected a shape"))])),
        Err(ServiceError::Malformed(faults)) => return (None, Err(all(faults))),
        Err(other) => return (None, Err(vec![placed(Fault::new("", other.to_string()))])),
    };
    let shape = shape.and_then(|found| {
        // Once stored, a shape without extent would break every mean of the cohort.
        check_extent(&found.shape.control_points, reading.conversion.space.representation().size())
            .map_err(|error| vec![Fault::new("", error.to_string())])?;
        Ok(found)
    });
    let Found { shape, fit, warnings } = match shape {
        Ok(found) => found,
        Err(faults) => return (external_id, Err(all(faults))),
    };
    let ReadShape { control_points, attributes, points, repeated_points, beginning } = shape;
    let measures = measuring.measure(&control_points, Some(points));
    let measures = completed(measures, reading, (fit, beginning));
    names.add(attributes.labels.keys());
    let shape = NewShape { id: id::new_id(id::SHAPE), attributes, measures, control_points };
    origin.external_id.clone_from(&external_id);
    let arrived = Arrived { origin, row: shape.into(), repeated_points, measures, warnings };
    (external_id, Ok(arrived))
}

/// The measures of a shape with facts of its arrival: the residual of its fit, and the direction of a contour.
fn completed(
    measures: ShapeMeasures,
    reading: &Reading<'_>,
    (fit, beginning): (Option<MeshFit>, Beginning),
) -> ShapeMeasures {
    let Conversion { space, correspondence, .. } = &reading.conversion;
    let searched = *correspondence == Correspondence::Cyclic && space.domain().is_line();
    ShapeMeasures {
        fit: fit.and_then(|fit| fit.residual(measures.area)),
        beginning: (searched || beginning.reversed).then_some(beginning),
        ..measures
    }
}
