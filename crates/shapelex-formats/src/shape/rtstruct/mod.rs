//! DICOM RT structure sets: the regions that were drawn on the slices of a scan.
//!
//! A record for each contour, with three coordinates in mm as in the file, two in the plane of its slice, or a surface for each
//! region (option `contours`). Contours are never joined: holes, parts of a slice, and contours that touch themselves are told
//! apart and reported.

mod ear;
mod plane;
mod regions;
mod slices;
mod stack;
mod structure;
mod write;

use dicom_dictionary_std::uids;
use serde_json::json;

use super::format::Format;
use super::options::{Contours, Holes, ReadOptions};
use super::record::{Geometry, Kind, Record, Ring};
use super::source::Source;
use super::{limits::Limits, record::Sink};
use crate::dicom::{self, Content, Instance};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use plane::{Basis, FLAT_MM};
use regions::{Contour, ContourKind, Region, Regions};
use slices::{Contact, Slice};

/// DICOM RT structure sets.
pub(super) static FORMAT: Format = Format {
    id: "rtstruct",
    name: NAME,
    media_types: &["application/dicom"],
    extensions: &["dcm", "dicom"],
    recognise: dicom::is_dicom,
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh],
    options: &["select", "holes", "contours"],
    read: Some(read),
    open: Some(write::open),
};

const NAME: &str = "DICOM RT Structure Set";

/// Directions of the coordinates of patients.
const AXES: &str = "x to the left, y to the back, z to the head of the patient (LPS)";

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let bytes = source.bytes()?;
    let limits = *source.limits();
    let grow = |inflated: usize| source.reserve(bytes.len().saturating_add(inflated));
    let content = Content::new(&bytes, limits.content.min(limits.held as u64), grow)?;
    let file = content.parse(limits.depth)?;
    let root = file.root();
    dicom::check_class(&root, &[uids::RT_STRUCTURE_SET_STORAGE], &format!("a {NAME}"))?;
    let mut summary = Summary::default();
    dicom::list_identifying(&file, &mut summary);
    summary.set("axes", AXES);
    let regions = Regions::new(&root, &mut summary)?;
    let instance = Instance::of(&root)?;
    let mut reading = Reading { options, limits, summary, instance, sink, objects: 0 };
    let mut lines = Vec::new();
    for (index, unique) in regions.unique_names().iter().enumerate() {
        let (name, place) = regions.name(index);
        if !options.selects(name) {
            reading.summary.drop("regions that are not selected", Some(name), || place);
            continue;
        }
        let region = regions.region(index, &limits, options, &mut reading.summary)?;
        lines.push(region.line());
        reading.region(region, unique)?;
    }
    let mut summary = reading.summary;
    if lines.is_empty() {
        let select = options.select.as_deref().unwrap_or_default();
        summary.warnings.push(format!("no region has a name that '{select}' selects"));
    }
    summary.set("regions", lines);
    summary.warnings.extend(file.warning());
    Ok(summary)
}

/// A file that is being read.
struct Reading<'a, 'b> {
    options: &'a ReadOptions,
    limits: Limits,
    summary: Summary,
    /// Where records come from, and the names of stored ones.
    instance: Instance,
    sink: Sink<'b>,
    /// Number of slices so far.
    objects: u64,
}

/// The slices of a region: that of each contour, `None` for those that are in none.
struct Sliced {
    basis: Option<Basis>,
    slices: Vec<Slice>,
    of_contour: Vec<Option<usize>>,
}

impl Reading<'_, '_> {
    /// Gives on all records of a region.
    fn region(&mut self, mut region: Region, name: &str) -> Result<(), FileError> {
        let place = Place::item(region.index);
        if region.contours.is_empty() {
            self.summary.drop("regions without contours", Some(&region.name), || place);
            return Ok(());
        }
        self.tidy(&mut region, name);
        let sliced = self.sliced(&region)?;
        self.warn(&region, &sliced);
        let wanted = self.options.contours.unwrap_or_default();
        if wanted != Contours::Space && sliced.basis.is_none() {
            let what = "regions without contours in parallel planes";
            self.summary.drop(what, Some(&region.name), || place);
            return Ok(());
        }
        if wanted == Contours::Stack {
            self.stack(&region, name, &sliced)
        } else {
            self.curves(&region, name, &sliced)
        }
    }

    /// Drops last points that repeat the first one, and closed contours of fewer than three points.
    fn tidy(&mut self, region: &mut Region, name: &str) {
        for contour in region.contours.iter_mut().filter(|contour| contour.kind.is_closed()) {
            if contour.points.open() {
                self.summary.drop("points that repeat the first one", None, || contour.place.clone());
            }
        }
        region.contours.retain(|contour| {
            let short = contour.kind.is_closed() && contour.points.len() < 3;
            if short {
                let name = contour_name(name, contour);
                let what = "closed contours of fewer than three points";
                self.summary.drop(what, Some(&name), || contour.place.clone());
            }
            !short
        });
    }

    fn sliced(&mut self, region: &Region) -> Result<Sliced, FileError> {
        let planar: Vec<&Contour> =
            region.contours.iter().filter(|contour| contour.kind.is_planar()).collect();
        let basis = Basis::of(&planar);
        let mut of_contour = vec![None; region.contours.len()];
        let furthest = |basis: &Basis| planar.iter().map(|c| basis.deviation(&c.points)).fold(0.0, f64::max);
        let off = basis.as_ref().map_or(0.0, furthest);
        if off > FLAT_MM {
            self.summary.warnings.push(format!(
                "region '{}': its contours are not in parallel planes (a point is {off:.3} mm from that of its contour); \
                 slices are not told apart",
                region.name
            ));
        }
        let Some(basis) = basis.filter(|_| off <= FLAT_MM) else {
            return Ok(Sliced { basis: None, slices: Vec::new(), of_contour });
        };
        let slices = slices::slices(region, &basis)?;
        for (index, slice) in slices.iter().enumerate() {
            for ring in &slice.rings {
                of_contour[ring.contour] = Some(index);
            }
        }
        Ok(Sliced { basis: Some(basis), slices, of_contour })
    }

    /// Warns of surprises: several contours a slice, holes that follow from positions alone, keyholes.
    fn warn(&mut self, region: &Region, sliced: &Sliced) {
        let several = sliced.slices.iter().filter(|slice| slice.rings.len() > 1).count();
        let rings = || sliced.slices.iter().flat_map(|slice| &slice.rings);
        let kind = |contour: usize| region.contours[contour].kind;
        let holes =
            rings().filter(|ring| ring.hole && kind(ring.contour) == ContourKind::ClosedPlanar).count();
        let contacts = |wanted| {
            let closed = region.contours.iter().filter(|contour| contour.kind.is_closed());
            closed.filter(|contour| slices::contact(contour) == wanted).count()
        };
        let found = [
            (several, "slices have several contours, which are records of their own"),
            (holes, "contours of type CLOSED_PLANAR lie within another one and are taken for holes"),
            (
                contacts(Contact::Keyhole),
                "contours run along a channel in both directions (keyholes); their holes are not cut out",
            ),
            (contacts(Contact::Touches), "contours touch themselves"),
        ];
        for (count, what) in found.into_iter().filter(|(count, _)| *count > 0) {
            self.summary.warnings.push(format!("region '{}': {count} {what}", region.name));
        }
    }

    /// A record for each contour; those of a slice stand next to each other.
    fn curves(&mut self, region: &Region, name: &str, sliced: &Sliced) -> Result<(), FileError> {
        let mut done = vec![false; sliced.slices.len()];
        for (k, contour) in region.contours.iter().enumerate() {
            let Some(index) = sliced.of_contour[k] else {
                self.curve(region, name, contour, sliced, None)?;
                continue;
            };
            if std::mem::replace(&mut done[index], true) {
                continue;
            }
            let rings = &sliced.slices[index].rings;
            let object = self.objects;
            self.objects += 1;
            for ring in rings {
                let contour = &region.contours[ring.contour];
                if ring.hole && !self.keeps_hole(contour, name)? {
                    continue;
                }
                let place = Ring { object, part: ring.part as u64, hole: ring.hole };
                self.curve(region, name, contour, sliced, (rings.len() > 1).then_some(place))?;
            }
        }
        Ok(())
    }

    fn keeps_hole(&mut self, contour: &Contour, name: &str) -> Result<bool, FileError> {
        match self.options.holes.unwrap_or_default() {
            Holes::Keep => Ok(true),
            Holes::Skip => {
                let name = contour_name(name, contour);
                self.summary.drop("holes", Some(&name), || contour.place.clone());
                Ok(false)
            }
            Holes::Refuse => {
                let detail = "expected contours without holes (option holes), got one within another";
                Err(FileError::unsupported(contour.place.clone(), detail))
            }
        }
    }

    fn curve(
        &mut self,
        region: &Region,
        name: &str,
        contour: &Contour,
        sliced: &Sliced,
        ring: Option<Ring>,
    ) -> Result<(), FileError> {
        let planar = contour.kind.is_planar();
        let basis = sliced.basis.as_ref().filter(|_| planar);
        let in_plane = self.options.contours == Some(Contours::Plane);
        if in_plane && basis.is_none() {
            let name = contour_name(name, contour);
            let what = "points and curves that are in no plane";
            self.summary.drop(what, Some(&name), || contour.place.clone());
            return Ok(());
        }
        let points = match basis.filter(|_| in_plane) {
            Some(basis) => basis.project(&contour.points),
            None => contour.points.clone(),
        };
        let geometry = match contour.kind {
            ContourKind::Point => Geometry::Landmarks(points),
            kind => Geometry::Curve { points, closed: kind.is_closed() },
        };
        let mut record = Record::new(geometry, contour.place.clone());
        record.name = Some(contour_name(name, contour));
        self.identify(&mut record, region, Some(contour));
        record.label = Some(region.name.clone());
        record.ring = ring;
        record.metadata = region.metadata();
        let mut about = json!({ "number": contour.number, "type": contour.kind.word() });
        match slices::contact(contour) {
            Contact::Keyhole if contour.kind.is_closed() => about["contact"] = "keyhole".into(),
            Contact::Touches if contour.kind.is_closed() => about["contact"] = "touches".into(),
            _ => {}
        }
        record.metadata.insert("contour".into(), about);
        if let Some(basis) = basis {
            record.planar_by = Some("contours=plane");
            record.metadata.insert("plane".into(), basis.describe(&contour.points));
        }
        (self.sink)(record)
    }

    /// One surface for the region, or the reason why there is none.
    fn stack(&mut self, region: &Region, name: &str, sliced: &Sliced) -> Result<(), FileError> {
        let Some(basis) = &sliced.basis else { return Ok(()) };
        for (k, contour) in region.contours.iter().enumerate() {
            if sliced.of_contour[k].is_none() {
                let name = contour_name(name, contour);
                let what = "points and open curves beside a surface";
                self.summary.drop(what, Some(&name), || contour.place.clone());
            }
        }
        let mut outer = Vec::new();
        for slice in &sliced.slices {
            let mut parts = Vec::new();
            for ring in &slice.rings {
                let contour = &region.contours[ring.contour];
                if !ring.hole || self.keeps_hole(contour, name)? {
                    parts.push(contour);
                }
            }
            outer.push((slice.offset, parts));
        }
        match stack::surface(outer, basis, &self.limits) {
            Ok(stack) => {
                let mut record = Record::new(stack.mesh, Place::item(region.index));
                record.name = Some(name.to_owned());
                self.identify(&mut record, region, None);
                record.label = Some(region.name.clone());
                record.metadata = region.metadata();
                record.metadata.insert("stack".into(), stack.about);
                if let Some(warning) = stack.warning {
                    self.summary.warnings.push(format!("region '{}': {warning}", region.name));
                }
                (self.sink)(record)
            }
            Err(fault) if fault.kind == FaultKind::Unsupported => {
                self.summary.drop("regions that make no surface", Some(&region.name), || {
                    fault.place.as_ref().clone()
                });
                self.summary
                    .warnings
                    .push(format!("region '{}' makes no surface: {}", region.name, fault.detail));
                Ok(())
            }
            Err(fault) => Err(fault),
        }
    }
}

impl Reading<'_, '_> {
    /// Says which region, or which contour of it, a record is in all files of the world, and who it is of.
    fn identify(&self, record: &mut Record, region: &Region, contour: Option<&Contour>) {
        let instance = &self.instance;
        let number = contour.map(|contour| contour.number);
        let image = contour.and_then(|contour| contour.image.as_deref());
        instance.origin.tell(&mut record.labels, region.number, number, image);
        record.labels.insert("frame_of_reference".into(), region.frame_of_reference.as_str().into());
        let Some(storing) = self.options.storing else { return };
        record.id = instance.uid.as_ref().map(|uid| match contour {
            Some(contour) => format!("{uid}/{}/{}", region.number, contour.number),
            None => format!("{uid}/{}", region.number),
        });
        record.person = instance.person.clone().filter(|_| storing.persons);
    }
}

/// Name of the record of a contour: that of its region, and its number there.
fn contour_name(region: &str, contour: &Contour) -> String {
    format!("{region} {}", contour.number)
}
