//! Boundaries of the labels of an image as records of a file: the features of a label image.

use std::collections::BTreeMap;

use super::contours::{ComponentOutput, Found, LabelBoundary, SurfaceOutput, Wanted, label_bytes};
use super::image::file_limits;
use crate::service::app::{Limits, ServiceError};
use crate::wire::dicom::Instance;
use crate::wire::files::{
    EVERY, FaultKind, FileError, Geometry, Holes, Mesh, Names, Place, Points, ReadOptions, Record, Ring,
    Scope, Sink, Summary, Value,
};
use crate::wire::image::{
    Format, Grid, ImageError, LABEL_OPTIONS, LabelNames, LabelPart, LengthUnit, describe,
};
use crate::wire::json;
use crate::wire::unit::{Ratio, Unit};

/// Number of cells below which a component is left out unless the options say another: as few enclose no cell.
const LEAST_CELLS: usize = 5;

/// Reads a label image: one record for the outer boundary of each component of each label but 0, in world coordinates.
///
/// The name of a record is its label, of the largest component; others have their rank behind it: `2`, `2.1`, `2.2`. Its class is the name
/// that the file gives to the label, if any. `select` takes numbers and names. `bytes` are those of the whole file.
///
/// # Errors
/// Faults of the image; options other than [`LABEL_OPTIONS`]; a photograph; holes under [`Holes::Refuse`]; errors of `sink`.
pub fn read_label_image(
    format: &Format,
    bytes: &[u8],
    options: &ReadOptions,
    limits: &Limits,
    stop: &(dyn Fn() -> bool + Sync),
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    check_options(format, options)?;
    let wanted = wanted(options)?;
    let faulty = |error| placed(&error, bytes.len());
    // Answers are bounded by their written length.
    let limits = Limits { answer_numbers: usize::MAX, ..*limits };
    let LabelNames { of: names, warnings } =
        format.label_names(bytes, &file_limits(&limits)).map_err(faulty)?;
    let title = |label: u32| names.get(&label).map(String::as_str);
    let selects = |label: u32| {
        options.selects(&label.to_string()) || title(label).is_some_and(|title| options.selects(title))
    };
    let (mut found, mut added) = (Found::default(), Ok(()));
    let mut give = |part: LabelPart| {
        added = found.add(&part.image, part.label, &wanted, &limits, stop);
        added.is_ok()
    };
    format.each_label_image(bytes, &file_limits(&limits), &selects, &mut give).map_err(faulty)?;
    added.map_err(refused)?;
    let mut summary = said(&found, options);
    summary.warnings.extend(warnings);
    let unit = found.grid.as_ref().and_then(Grid::unit);
    let told = found.grid.as_ref().and_then(told);
    let ranks = ranks(&found.boundaries);
    let instance = instance_of(format, bytes, &limits, &mut summary)?;
    for ((object, boundary), rank) in (0..).zip(found.boundaries).zip(ranks) {
        let of = *boundary.component();
        let name = name_of(of.label, rank);
        if selects(of.label) {
            let (number, instance) = (object + 1, instance.as_ref());
            let identity = Identity { name: &name, label: of.label, number, rank, instance, options };
            let title = title(of.label).map(str::to_owned);
            let mut titled = |record: Record| {
                let record = identity.named(Record { label: title.clone(), unit, ..record });
                sink(match told {
                    Some((unit, of_shapes)) => record.converted(unit, of_shapes)?,
                    None => record,
                })
            };
            give_on(boundary, object, &name, options, &mut summary, &mut titled)?;
            summary.records += 1;
        }
    }
    Ok(summary)
}

/// Name of an object: its label, and behind the first one of a label its rank.
fn name_of(label: u32, rank: usize) -> String {
    if rank == 0 { label.to_string() } else { format!("{label}.{rank}") }
}

/// Warning about a volume whose file gives no sizes of its voxels.
fn without_sizes(grid: &Grid) -> Option<String> {
    let [x, y, z] = grid.units();
    let unknown = |unit: LengthUnit| unit.length().is_none();
    match (grid.is_planar(), unknown(x) || unknown(y), z) {
        (false, _, LengthUnit::Cell) => {
            Some("the file gives no sizes of its voxels: they are taken for cubes of side 1".into())
        }
        (false, false, LengthUnit::Unknown) => Some(
            "the file gives no distance between its layers: it is taken for 1 mm, and the unit of the shapes for unknown"
                .into(),
        ),
        _ => None,
    }
}

/// Unit of positions, and that in which the file gives lengths.
fn told(grid: &Grid) -> Option<(Unit, Unit)> {
    grid.unit().zip(grid.unit_of_shapes())
}

/// Settings of the boundaries from the options.
fn wanted(options: &ReadOptions) -> Result<Wanted, FileError> {
    let blur = options.blur.unwrap_or(0.0);
    if !(blur >= 0.0 && blur.is_finite()) {
        let detail = format!("expected a number of at least 0, got {blur}");
        return Err(FileError::of(FaultKind::Option, Place::tag("blur"), detail));
    }
    Ok(Wanted {
        blur,
        least_cells: options.least_cells.unwrap_or(LEAST_CELLS),
        largest: options.largest == Some(true),
        fill: options.fill == Some(true),
        photograph: options.photograph.unwrap_or_default(),
        ..Wanted::default()
    })
}

/// Summary of an image beside its boundaries.
fn said(found: &Found, options: &ReadOptions) -> Summary {
    let mut summary = Summary { warnings: found.warnings(), ..Summary::default() };
    if let Some(grid) = &found.grid {
        let told = told(grid);
        // From positions to the unit of lengths of the file.
        let ratio = told.and_then(|(unit, of_shapes)| unit.to(of_shapes)).unwrap_or(Ratio::ONE);
        summary.set("size", grid.size().to_vec());
        summary.set("spacing", grid.spacing().map(|size| ratio.times(size)).to_vec());
        summary.properties.extend(told.map(|(_, unit)| ("unit".to_owned(), unit.word().into())));
        summary.warnings.extend(without_sizes(grid));
        summary.set("cut_by_edge", found.cut_by_edge());
    }
    let least = options.least_cells.unwrap_or(LEAST_CELLS);
    let what = match options.largest {
        Some(true) => format!("components of fewer than {least} cells or beside the largest of their label"),
        _ => format!("components of fewer than {least} cells"),
    };
    summary.drop_many(&what, found.dropped.components as u64, None, Place::default);
    summary
}

/// For each component its rank by size among those of its label, from 0; of equal ones that with the earlier first cell comes first. So the
/// largest one has the same rank whatever specks there are beside it.
fn ranks(found: &[LabelBoundary]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by_key(|at| {
        let of = found[*at].component();
        (of.label, std::cmp::Reverse(of.cells), of.component)
    });
    let mut ranks = vec![0; found.len()];
    for pair in order.windows(2) {
        if found[pair[0]].component().label == found[pair[1]].component().label {
            ranks[pair[1]] = ranks[pair[0]] + 1;
        }
    }
    ranks
}

/// Identity of a DICOM segmentation. Values that identify a person in it are counted.
fn instance_of(
    format: &Format,
    bytes: &[u8],
    limits: &Limits,
    summary: &mut Summary,
) -> Result<Option<Instance>, FileError> {
    if !format.media_types.contains(&"application/dicom") {
        return Ok(None);
    }
    let mut instance = Instance::read(bytes, file_limits(limits).bytes)?;
    summary.dropped.append(&mut instance.left_out.dropped);
    Ok(Some(instance))
}

/// Names of a component.
struct Identity<'a> {
    name: &'a str,
    label: u32,
    /// Its position in the file, from 1.
    number: u64,
    /// Its rank among the components of its label, from 0.
    rank: usize,
    instance: Option<&'a Instance>,
    options: &'a ReadOptions,
}

impl Identity<'_> {
    /// A record of the component with its name: of DICOM the unique one, of a surface that of its segment, of others that of the contour.
    fn named(&self, mut record: Record) -> Record {
        let Self { name, label, number, rank, .. } = self;
        let rest =
            record.name.as_deref().and_then(|own| own.strip_prefix(name)).unwrap_or_default().to_owned();
        let Some(instance) = self.instance else {
            if self.options.names == Some(Names::Number) {
                record.name = Some(format!("{number}{rest}"));
            }
            return record;
        };
        let contour = matches!(record.geometry, Geometry::Curve { .. }).then_some(rank + 1);
        instance.origin.tell(&mut record.labels, i64::from(*label), contour, None);
        let storing = self.options.storing;
        let uid = storing.and(instance.uid.as_deref());
        match (self.options.names, uid) {
            (Some(Names::Number), _) => record.name = Some(format!("{number}{rest}")),
            (None | Some(Names::Id), Some(uid)) => {
                let part = match (rank, &record.geometry) {
                    (0, Geometry::Mesh(_)) => String::new(),
                    (rank, _) => format!("/{}", rank + 1),
                };
                record.name = Some(format!("{uid}/{label}{part}{rest}"));
                record.scope = Scope::Everywhere;
            }
            _ => {}
        }
        record.person = instance.person.clone().filter(|_| storing.is_some_and(|storing| storing.persons));
        record
    }
}

/// Memory that reading a label image takes, by its header.
///
/// # Errors
/// Faults of the header.
pub fn label_image_bytes(bytes: &[u8], options: &ReadOptions, limits: &Limits) -> Result<usize, FileError> {
    let description = describe(bytes, &file_limits(limits)).map_err(|error| placed(&error, bytes.len()))?;
    Ok(label_bytes(&description, options.fill == Some(true)))
}

/// Number of cells of a label image, by its header.
///
/// # Errors
/// Faults of the header.
pub fn label_image_cells(bytes: &[u8], limits: &Limits) -> Result<usize, FileError> {
    let description = describe(bytes, &file_limits(limits)).map_err(|error| placed(&error, bytes.len()))?;
    Ok(description.grid.cells())
}

/// A fault of an image of `length` bytes, as one of a file of shapes.
fn placed(error: &ImageError, length: usize) -> FileError {
    let end = Place::byte(length as u64);
    let (kind, place) = match error {
        ImageError::Truncated { place, .. } => (FaultKind::Truncated, Place::tag(*place).within(&end)),
        ImageError::Short { .. } => (FaultKind::Truncated, end),
        ImageError::Cells { .. } => (FaultKind::TooLarge, Place::tag("size")),
        ImageError::Bytes { place, .. } => (FaultKind::TooLarge, Place::tag(*place)),
        ImageError::Excess { place, .. } => (FaultKind::Malformed, Place::tag(*place)),
        ImageError::NotFinite { index, .. }
        | ImageError::Label { index, .. }
        | ImageError::Colour { index, .. }
        | ImageError::Overlap { index, .. } => (FaultKind::Malformed, Place::tag(format!("cell {index}"))),
        ImageError::Pages { page, .. } => (FaultKind::Malformed, Place::tag(format!("page {page}"))),
        ImageError::Unsupported { .. } => (FaultKind::Unsupported, Place::default()),
        _ => (FaultKind::Malformed, Place::default()),
    };
    FileError::of(kind, place, error)
}

/// Refuses options that label images do not have.
fn check_options(format: &Format, options: &ReadOptions) -> Result<(), FileError> {
    let given = json::to_value(options).unwrap_or_default();
    let given = given.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    for (name, _) in given {
        if !LABEL_OPTIONS.contains(&name.as_str()) && !EVERY.contains(&name.as_str()) {
            let known = LABEL_OPTIONS.join(", ");
            let detail =
                format!("expected options of label images ({known}), got {name} for {}", format.name);
            return Err(FileError {
                place: Box::new(Place::tag(name)),
                ..FileError::new(FaultKind::Option, detail)
            });
        }
    }
    Ok(())
}

/// Gives on the outer boundary of a component, and its holes as the options say.
fn give_on(
    boundary: LabelBoundary,
    object: u64,
    name: &str,
    options: &ReadOptions,
    summary: &mut Summary,
    sink: Sink<'_>,
) -> Result<(), FileError> {
    let (component, outer, holes): (_, _, Vec<Geometry>) = match boundary {
        LabelBoundary::Region(region) => {
            let holes = region.holes.iter().map(|hole| curve(hole)).collect();
            (region.component, curve(&region.points), holes)
        }
        LabelBoundary::Solid(solid) => {
            let holes = solid.cavities.into_iter().map(mesh).collect();
            (solid.component, mesh(solid.outer), holes)
        }
    };
    let policy = options.holes.unwrap_or_default();
    if policy == Holes::Refuse && !holes.is_empty() {
        let detail = format!("expected labels without holes, got {} in '{name}'", holes.len());
        return Err(FileError::unsupported(Place::item(object), detail));
    }
    let is_alone = holes.is_empty() || policy == Holes::Skip;
    sink(record(
        outer,
        &component,
        name,
        (!is_alone).then_some(Ring { object, part: 0, hole: false }),
        object,
    ))?;
    for (number, hole) in (1..).zip(holes) {
        if policy == Holes::Skip {
            summary.drop("holes", Some(name), || Place::item(object));
            continue;
        }
        let ring = Some(Ring { object, part: 0, hole: true });
        sink(record(hole, &component, &format!("{name}.hole{number}"), ring, object))?;
        summary.records += 1;
    }
    Ok(())
}

fn record(geometry: Geometry, of: &ComponentOutput, name: &str, ring: Option<Ring>, object: u64) -> Record {
    let number = |value: usize| Value::Number(value as f64);
    let labels = BTreeMap::from([
        ("label".to_owned(), Value::Number(f64::from(of.label))),
        ("component".to_owned(), number(of.component)),
        ("cells".to_owned(), number(of.cells)),
        ("edge_sides".to_owned(), number(of.edge_sides)),
    ]);
    Record { name: Some(name.to_owned()), labels, ring, ..Record::new(geometry, Place::item(object)) }
}

fn curve(points: &[[f64; 2]]) -> Geometry {
    Geometry::Curve { points: Points::from_rows(2, points.as_flattened().to_vec()), closed: true }
}

fn mesh(surface: SurfaceOutput) -> Geometry {
    let vertices = Points::from_rows(3, surface.vertices.as_flattened().to_vec());
    let mut mesh = Mesh { vertices, ..Mesh::default() };
    surface.faces.into_iter().for_each(|face| mesh.faces.push(face));
    mesh.into()
}

/// The refusal of an image as one of a file.
fn refused(error: ServiceError) -> FileError {
    match error {
        ServiceError::Cancelled => FileError::new(FaultKind::Stopped, "the reading was stopped"),
        ServiceError::Invalid(faults) => {
            let detail = faults.listed().first().map_or_else(String::new, |fault| fault.detail.clone());
            FileError::new(FaultKind::Unsupported, detail)
        }
        other => FileError::new(FaultKind::Unsupported, other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::image::detect;
    use crate::wire::image::write::png_u8;

    /// An image of 6 × 5 cells: a ring of label 7 around a hole, and two cells of label 3 apart.
    fn image() -> Vec<u8> {
        let rows = ["777.3.", "7.7...", "777...", "......", "3....."];
        let cell = |c: char| c.to_digit(10).map_or(0, |digit| digit as u8);
        let cells: Vec<u8> = rows.iter().flat_map(|row| row.chars().map(cell)).collect();
        let grid = Grid::along_axes([6, 5, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
        png_u8(&grid, &cells).unwrap()
    }

    fn records(options: &ReadOptions) -> Result<(Vec<Record>, Summary), FileError> {
        // The two cells of label 3 are kept.
        let options = &ReadOptions { least_cells: options.least_cells.or(Some(1)), ..options.clone() };
        let (bytes, mut found) = (image(), Vec::new());
        let format = detect(&bytes).unwrap();
        let summary =
            read_label_image(format, &bytes, options, &Limits::default(), &|| false, &mut |record| {
                found.push(record);
                Ok(())
            })?;
        Ok((found, summary))
    }

    fn names(records: &[Record]) -> Vec<&str> {
        records.iter().filter_map(|record| record.name.as_deref()).collect()
    }

    #[test]
    fn features_are_kept_by_label_and_holes_as_the_options_say() {
        let (found, summary) = records(&ReadOptions::default()).unwrap();
        assert_eq!(names(&found), ["7", "3", "3.1"]);
        assert_eq!(
            (summary.records, summary.dropped[0].what.as_str(), summary.dropped[0].count),
            (3, "holes", 1)
        );
        assert_eq!(found[0].labels["cells"], Value::Number(8.0));
        let keep =
            ReadOptions { holes: Some(Holes::Keep), select: Some("7".into()), ..ReadOptions::default() };
        let (found, summary) = records(&keep).unwrap();
        assert_eq!((names(&found), summary.records), (vec!["7", "7.hole1"], 2));
        assert_eq!(found[1].ring, Some(Ring { object: 0, part: 0, hole: true }));
        let refuse = ReadOptions { holes: Some(Holes::Refuse), ..ReadOptions::default() };
        let error = records(&refuse).unwrap_err();
        assert_eq!(error.to_string(), "item 0: expected labels without holes, got 1 in '7'");
        let usual = ReadOptions { least_cells: Some(5), ..ReadOptions::default() };
        let (found, summary) = records(&usual).unwrap();
        assert_eq!((names(&found), summary.dropped[0].count), (vec!["7"], 2));
        assert_eq!(summary.dropped[0].what, "components of fewer than 5 cells");
        assert_eq!(summary.properties["cut_by_edge"], 1);
        let whole =
            ReadOptions { fill: Some(true), largest: Some(true), holes: Some(Holes::Refuse), ..usual };
        let whole = ReadOptions { least_cells: None, ..whole };
        let (found, summary) = records(&whole).unwrap();
        assert_eq!((names(&found), summary.dropped[0].count), (vec!["7", "3"], 1));
        let blur = ReadOptions { blur: Some(-1.0), ..ReadOptions::default() };
        assert_eq!(records(&blur).unwrap_err().to_string(), "blur: expected a number of at least 0, got -1");
        let numbers = ReadOptions { names: Some(Names::Number), ..ReadOptions::default() };
        assert_eq!(names(&records(&numbers).unwrap().0), ["1", "2", "3"]);
        let closed = ReadOptions { closed: Some(true), ..ReadOptions::default() };
        assert_eq!(records(&closed).unwrap_err().kind, FaultKind::Option);
    }
}
