//! The regions of a structure set and their contours.

use std::collections::{BTreeMap, BTreeSet};

use dicom_dictionary_std::tags;
use serde_json::{Map, Value, json};

use crate::dicom::{Node, image_of};
use crate::error::{FileError, Place};
use crate::shape::limits::Limits;
use crate::shape::options::ReadOptions;
use crate::shape::record::Points;
use crate::summary::Summary;

/// A region of interest.
pub(super) struct Region {
    /// ROI Number (3006,0022).
    pub(super) number: i64,
    /// ROI Name (3006,0026).
    pub(super) name: String,
    /// RT ROI Interpreted Type (3006,00A4), such as `ORGAN`.
    pub(super) kind: Option<String>,
    /// Red, green and blue, 0 to 255.
    pub(super) colour: Option<[f64; 3]>,
    pub(super) frame_of_reference: String,
    pub(super) contours: Vec<Contour>,
    /// Its position in the file, from 0.
    pub(super) index: u64,
}

/// A contour of a region.
pub(super) struct Contour {
    pub(super) kind: ContourKind,
    /// Positions in space, in mm.
    pub(super) points: Points,
    /// Its position among the contours of its region, from 1.
    pub(super) number: usize,
    /// The instance that it was drawn on.
    pub(super) image: Option<String>,
    pub(super) place: Place,
}

/// Contour Geometric Type (3006,0042).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ContourKind {
    Point,
    OpenPlanar,
    OpenNonplanar,
    ClosedPlanar,
    ClosedPlanarXor,
}

impl ContourKind {
    const ALL: [Self; 5] =
        [Self::Point, Self::OpenPlanar, Self::OpenNonplanar, Self::ClosedPlanar, Self::ClosedPlanarXor];

    /// The word of the standard.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Point => "POINT",
            Self::OpenPlanar => "OPEN_PLANAR",
            Self::OpenNonplanar => "OPEN_NONPLANAR",
            Self::ClosedPlanar => "CLOSED_PLANAR",
            Self::ClosedPlanarXor => "CLOSEDPLANAR_XOR",
        }
    }

    /// The kind with a word.
    pub(super) fn find(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.word() == word)
    }

    /// Whether it is a closed curve in a plane.
    pub(super) fn is_closed(self) -> bool {
        matches!(self, Self::ClosedPlanar | Self::ClosedPlanarXor)
    }

    /// Whether it has to be in a plane.
    pub(super) fn is_planar(self) -> bool {
        self.is_closed() || self == Self::OpenPlanar
    }
}

impl Region {
    /// Metadata of the region in its records.
    pub(super) fn metadata(&self) -> Map<String, Value> {
        let mut roi = Map::new();
        roi.insert("number".into(), self.number.into());
        roi.insert("name".into(), self.name.clone().into());
        if let Some(kind) = &self.kind {
            roi.insert("type".into(), kind.clone().into());
        }
        if let Some(colour) = self.colour {
            roi.insert("colour".into(), json!(colour));
        }
        let mut metadata = Map::new();
        metadata.insert("roi".into(), roi.into());
        metadata.insert("frame_of_reference".into(), self.frame_of_reference.clone().into());
        metadata
    }

    /// The line of the region in the summary of the file.
    pub(super) fn line(&self) -> Value {
        let kinds: BTreeSet<_> = self.contours.iter().map(|contour| contour.kind).collect();
        let points: usize = self.contours.iter().map(|contour| contour.points.len()).sum();
        json!({
            "number": self.number,
            "name": self.name,
            "type": self.kind,
            "colour": self.colour,
            "contours": self.contours.len(),
            "points": points,
            "kinds": kinds.into_iter().map(ContourKind::word).collect::<Vec<_>>(),
        })
    }
}

/// Facts of the three lists of a file about its regions.
pub(super) struct Regions<'f> {
    rows: Vec<Row<'f>>,
}

/// A region without its contours.
struct Row<'f> {
    number: i64,
    name: String,
    kind: Option<String>,
    frame_of_reference: String,
    node: Node<'f>,
    contours: Option<Node<'f>>,
}

impl<'f> Regions<'f> {
    /// Joins the lists of regions, contours and observations by the numbers of the regions.
    pub(super) fn new(root: &Node<'f>, summary: &mut Summary) -> Result<Self, FileError> {
        let frames = frames(root)?;
        let mut kinds = kinds(root)?;
        let mut contours = contours(root)?;
        let mut rows: Vec<Row<'f>> = Vec::new();
        let mut numbers = BTreeSet::new();
        for node in root.items(tags::STRUCTURE_SET_ROI_SEQUENCE)? {
            let number = number(&node, tags::ROI_NUMBER)?;
            if !numbers.insert(number) {
                let detail = format!("expected a number for each region, got {number} twice");
                return Err(node.malformed(tags::ROI_NUMBER, detail));
            }
            let name = match node.short_text(tags::ROI_NAME)? {
                Some(name) => name,
                None => format!("ROI {number}"),
            };
            let frame_of_reference = frame(&node, number, &frames)?;
            let (kind, contours) = (kinds.remove(&number), contours.remove(&number));
            rows.push(Row { number, name, kind, frame_of_reference, node, contours });
        }
        if rows.is_empty() {
            let tag = tags::STRUCTURE_SET_ROI_SEQUENCE;
            return Err(root.malformed(tag, "expected at least one region, got none"));
        }
        if let Some((number, node)) = contours.into_iter().next() {
            let detail = format!("expected the number of a region of the file, got {number}");
            return Err(node.malformed(tags::REFERENCED_ROI_NUMBER, detail));
        }
        let frames: BTreeSet<_> = rows.iter().map(|row| row.frame_of_reference.clone()).collect();
        let frames: Vec<_> = frames.into_iter().collect();
        match &frames[..] {
            [frame] => summary.set("frame_of_reference", frame.clone()),
            _ => {
                summary.set("frame_of_reference", frames);
                summary.warnings.push("the regions have several frames of reference".into());
            }
        }
        Ok(Self { rows })
    }

    /// Names that differ: a number follows a name that several regions have.
    pub(super) fn unique_names(&self) -> Vec<String> {
        let mut counts = BTreeMap::new();
        for row in &self.rows {
            *counts.entry(row.name.as_str()).or_insert(0_usize) += 1;
        }
        let mut taken: BTreeSet<String> = counts.keys().map(|name| (*name).to_owned()).collect();
        let mut unique = |row: &Row<'_>| {
            let mut name = row.name.clone();
            if counts.get(name.as_str()).is_some_and(|count| *count > 1) {
                name = format!("{name} ({})", row.number);
                while !taken.insert(name.clone()) {
                    name.push('\'');
                }
            }
            name
        };
        self.rows.iter().map(&mut unique).collect()
    }

    /// The name of a region, and its place.
    pub(super) fn name(&self, index: usize) -> (&str, Place) {
        let row = &self.rows[index];
        (&row.name, row.node.place(tags::ROI_NAME))
    }

    /// A region with its contours; broken ones are left out where the options say so.
    pub(super) fn region(
        &self,
        index: usize,
        limits: &Limits,
        options: &ReadOptions,
        summary: &mut Summary,
    ) -> Result<Region, FileError> {
        let row = &self.rows[index];
        let item = index as u64;
        let at = |error: FileError| error.at(Place::item(item));
        let mut region = Region {
            number: row.number,
            name: row.name.clone(),
            kind: row.kind.clone(),
            colour: None,
            frame_of_reference: row.frame_of_reference.clone(),
            contours: Vec::new(),
            index: item,
        };
        let Some(node) = &row.contours else { return Ok(region) };
        region.colour = node.array(tags::ROI_DISPLAY_COLOR).map_err(at)?;
        for (k, item) in node.items(tags::CONTOUR_SEQUENCE).map_err(at)?.iter().enumerate() {
            match contour(item, k + 1, limits).map_err(at) {
                Ok(mut contour) => {
                    contour.place.item = Some(index as u64);
                    region.contours.push(contour);
                }
                Err(error) => options.leave_out(error, summary)?,
            }
        }
        Ok(region)
    }
}

fn number(node: &Node<'_>, tag: dicom_core::Tag) -> Result<i64, FileError> {
    node.integer(tag)?.ok_or_else(|| node.malformed(tag, "expected the number of a region, got none"))
}

/// Frames of reference that the file names for all of its regions.
fn frames(root: &Node<'_>) -> Result<Vec<String>, FileError> {
    let mut frames = Vec::new();
    for node in root.items(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE)? {
        frames.extend(node.short_text(tags::FRAME_OF_REFERENCE_UID)?);
    }
    frames.extend(root.short_text(tags::FRAME_OF_REFERENCE_UID)?);
    frames.sort_unstable();
    frames.dedup();
    Ok(frames)
}

/// That of a region, or the only one of the file.
fn frame(node: &Node<'_>, number: i64, frames: &[String]) -> Result<String, FileError> {
    let tag = tags::REFERENCED_FRAME_OF_REFERENCE_UID;
    match (node.short_text(tag)?, frames) {
        (Some(frame), _) => Ok(frame),
        (None, [frame]) => Ok(frame.clone()),
        (None, frames) => {
            let found = if frames.is_empty() { "none" } else { "several in the file" };
            let detail = format!("expected the frame of reference of region {number}, got {found}");
            Err(node.malformed(tag, detail))
        }
    }
}

/// Interpreted types by numbers of regions.
fn kinds(root: &Node<'_>) -> Result<BTreeMap<i64, String>, FileError> {
    let mut kinds = BTreeMap::new();
    for node in root.items(tags::RTROI_OBSERVATIONS_SEQUENCE)? {
        if let Some(kind) = node.short_text(tags::RTROI_INTERPRETED_TYPE)? {
            kinds.entry(number(&node, tags::REFERENCED_ROI_NUMBER)?).or_insert(kind);
        }
    }
    Ok(kinds)
}

/// Lists of contours by numbers of regions.
fn contours<'f>(root: &Node<'f>) -> Result<BTreeMap<i64, Node<'f>>, FileError> {
    let mut contours = BTreeMap::new();
    let lists = root.items(tags::ROI_CONTOUR_SEQUENCE)?;
    if lists.is_empty() {
        return Err(
            root.malformed(tags::ROI_CONTOUR_SEQUENCE, "expected the contours of the regions, got none")
        );
    }
    for node in lists {
        let tag = tags::REFERENCED_ROI_NUMBER;
        let number = number(&node, tag)?;
        let place = node.place(tag);
        if contours.insert(number, node).is_some() {
            let detail = format!("expected one list of contours for each region, got two of region {number}");
            return Err(FileError::malformed(place, detail));
        }
    }
    Ok(contours)
}

fn contour(node: &Node<'_>, number: usize, limits: &Limits) -> Result<Contour, FileError> {
    let word = node.required_text(tags::CONTOUR_GEOMETRIC_TYPE, "the type of a contour")?;
    let kind = ContourKind::find(&word).ok_or_else(|| {
        let known = ContourKind::ALL.map(ContourKind::word).join(", ");
        let detail = format!("expected one of {known}, got '{}'", word.escape_default());
        FileError::unsupported(node.place(tags::CONTOUR_GEOMETRIC_TYPE), detail)
    })?;
    let tag = tags::CONTOUR_DATA;
    let separators = node.bytes(tag)?.unwrap_or_default().iter().filter(|byte| **byte == b'\\').count();
    limits.points(separators as u64 / 3 + 1, || node.place(tag))?;
    let coordinates = node.numbers(tag)?;
    if coordinates.is_empty() || !coordinates.len().is_multiple_of(3) {
        let detail = format!("expected three numbers a point, got {} numbers", coordinates.len());
        return Err(node.malformed(tag, detail));
    }
    let count = coordinates.len() / 3;
    let claimed = node.integer(tags::NUMBER_OF_CONTOUR_POINTS)?;
    if let Some(claimed) = claimed.filter(|claimed| usize::try_from(*claimed) != Ok(count)) {
        let detail = format!("expected {count} points, as many as there are, got {claimed}");
        return Err(node.malformed(tags::NUMBER_OF_CONTOUR_POINTS, detail));
    }
    let (image, place) = (image_of(node)?, node.place(tag));
    Ok(Contour { kind, points: Points::from_rows(3, coordinates), number, image, place })
}
