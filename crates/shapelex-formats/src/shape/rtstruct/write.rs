//! Shapes as regions of a structure set.

use std::collections::BTreeMap;
use std::io::Write;

use serde_json::Value;

use super::NAME;
use super::plane::{Basis, FLAT_MM};
use super::regions::{self, ContourKind};
use super::structure::{self, Contour, Moment, Region};
use crate::dicom::SeriesImage;
use crate::error::{FaultKind, FileError, Place};
use crate::shape::options::WriteOptions;
use crate::shape::record::{Geometry, Points, Record};
use crate::shape::text::left_out;
use crate::shape::write::{Opened, Output, Writer};
use crate::summary::Summary;

/// Most characters of the name of a region (type LO) and of its type (CS).
const LONGEST_NAME: usize = 64;
const LONGEST_KIND: usize = 16;

/// Facts of regions and contours about their shapes: parts of records, else keys of the metadata.
const KEPT: [&str; 6] = ["label", "ring", "roi", "contour", "plane", "frame_of_reference"];

/// Collects regions; the file is written at the end, because lists of all regions come before their contours.
struct Structures<'a> {
    output: Output<'a>,
    series: Vec<SeriesImage>,
    created: Option<Moment>,
    regions: Vec<Region>,
    /// Positions in `regions` by number and name.
    known: BTreeMap<(Option<i64>, String), usize>,
    held: usize,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    let fault = |detail: String| {
        let place = Box::new(Place::tag("series"));
        Err(FileError { kind: FaultKind::Option, place, detail })
    };
    let Some(first) = options.series.first() else {
        return fault("expected the images of a series that the structure set refers to, got none".into());
    };
    let shared = |image: &SeriesImage| {
        (image.series.clone(), image.study.instance.clone(), image.frame_of_reference.clone())
    };
    if let Some(k) = options.series.iter().position(|image| shared(image) != shared(first)) {
        return fault(format!(
            "expected images of one series in one frame of reference, got another at image {k}"
        ));
    }
    let shared = [&first.series, &first.study.instance, &first.frame_of_reference];
    let own = options.series.iter().flat_map(|image| [&image.class, &image.instance]);
    if let Some(uid) = shared.into_iter().chain(own).find(|uid| !is_uid(uid)) {
        let detail = "expected identifiers of the images of the series, at most 64 digits and points, got";
        return fault(format!("{detail} '{}'", uid.escape_default()));
    }
    let (study, patient) = (&first.study, &first.patient);
    let texts = [&study.id, &study.accession_number, &study.referring_physician, &patient.name, &patient.id];
    for text in texts.into_iter().chain([&study.date, &study.time, &patient.birth_date, &patient.sex]) {
        check_text(text, LONGEST_NAME, "what is said of patient and study")?;
    }
    let created = options.created.as_deref().map(moment).transpose()?;
    Ok(Box::new(Structures {
        output,
        series: options.series.clone(),
        created,
        regions: Vec::new(),
        known: BTreeMap::new(),
        held: 0,
        summary: Summary::default(),
    }))
}

fn is_uid(text: &str) -> bool {
    (1..=64).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.')
}

/// `2026-11-26T03:00:00` as `20261126` and `030000`.
fn moment(text: &str) -> Result<Moment, FileError> {
    let pattern = "dddd-dd-ddTdd:dd:dd";
    let fits =
        |(found, wanted): (u8, u8)| if wanted == b'd' { found.is_ascii_digit() } else { found == wanted };
    if text.len() != pattern.len() || !text.bytes().zip(pattern.bytes()).all(fits) {
        let detail =
            "expected a date and a time such as 2026-11-26T03:00:00 (option created), got another text";
        return Err(FileError::new(FaultKind::Option, detail));
    }
    let digits = |part: &str| part.chars().filter(char::is_ascii_digit).collect();
    Ok(Moment { date: digits(&text[..10]), time: digits(&text[11..]) })
}

impl Writer for Structures<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let at = |error: FileError| error.at(record.place.clone());
        let frame = record.metadata.get("frame_of_reference").and_then(Value::as_str);
        let wanted = &self.series[0].frame_of_reference;
        if let Some(frame) = frame.filter(|frame| frame != wanted) {
            let detail =
                format!("expected shapes in the frame of reference of the series, {wanted}, got {frame}");
            return Err(at(FileError::new(FaultKind::Unsupported, detail)));
        }
        let contours = self.contours(record).map_err(at)?;
        let index = self.region(record).map_err(at)?;
        self.count_lost(record, index);
        let region = &mut self.regions[index];
        region.xor |= record.ring.as_ref().is_some_and(|ring| ring.hole);
        region.contours.extend(contours);
        self.held += record.bytes();
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.held
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if self.regions.is_empty() {
            let detail = format!("expected at least one shape for a {NAME}, got none");
            return Err(FileError::new(FaultKind::Unsupported, detail));
        }
        let (bytes, away) = structure::file(&self.regions, &self.series, self.created.as_ref())?;
        self.output.write_all(&bytes)?;
        self.output.flush()?;
        if away > 0 {
            let warning =
                format!("{away} contours are in the plane of no image of the series and refer to none");
            self.summary.warnings.push(warning);
        }
        Ok(self.summary)
    }
}

impl Structures<'_> {
    /// Position of the region that a shape belongs to: that with its number and name.
    fn region(&mut self, record: &Record) -> Result<usize, FileError> {
        let roi = record.metadata.get("roi");
        let field = |name: &str| roi.and_then(|roi| roi.get(name));
        let number = field("number").and_then(Value::as_i64).filter(|number| i32::try_from(*number).is_ok());
        let named = field("name").and_then(Value::as_str);
        let name = record.label.as_deref().or(named).or(record.name.as_deref()).unwrap_or("Shape").trim();
        check_text(name, LONGEST_NAME, "the name of a region")?;
        let kind = field("type").and_then(Value::as_str).map(str::to_owned);
        if let Some(kind) = &kind {
            check_text(kind, LONGEST_KIND, "the type of a region")?;
        }
        let colour = field("colour").and_then(Value::as_array).and_then(|colour| {
            let parts: Option<Vec<u8>> = colour.iter().map(|x| x.as_f64().and_then(byte)).collect();
            parts.and_then(|parts| <[u8; 3]>::try_from(parts).ok())
        });
        let regions = &mut self.regions;
        let index = *self.known.entry((number, name.to_owned())).or_insert_with(|| {
            let (name, kind) = (name.to_owned(), kind.clone());
            regions.push(Region { number, name, kind, colour, contours: Vec::new(), xor: false });
            regions.len() - 1
        });
        let region = &regions[index];
        if kind.is_some() && kind != region.kind || colour.is_some() && colour != region.colour {
            let what = "types and colours other than those of the first shape of a region";
            self.summary.drop(what, record.name.as_deref(), || record.place.clone());
        }
        Ok(index)
    }

    /// Counts the facts about its next shape that a region does not hold. A name is kept if it is that of the region, or the one that the
    /// contour has when it is read: that of the region, its number if others have that name too, and the position of the contour.
    fn count_lost(&mut self, record: &Record, region: usize) {
        let place = || record.place.clone();
        let Region { number, name: own, contours, .. } = &self.regions[region];
        let position = contours.len() + 1;
        let numbered = number.map(|number| format!("{own} ({number}) {position}"));
        let known = [Some(own.clone()), Some(format!("{own} {position}")), numbered];
        let of_region = record.metadata.get("roi").and_then(|roi| roi.get("name")).and_then(Value::as_str);
        let names = [record.name.as_deref(), of_region.filter(|name| name.trim() != own)];
        for name in
            names.into_iter().flatten().filter(|name| !known.iter().flatten().any(|own| own == name.trim()))
        {
            self.summary.drop("names", Some(name), place);
        }
        left_out(&mut self.summary, record, &KEPT);
    }

    fn contours(&mut self, record: &Record) -> Result<Vec<Contour>, FileError> {
        let unsupported = |detail: String| Err(FileError::new(FaultKind::Unsupported, detail));
        match &record.geometry {
            Geometry::Curve { points, closed } => {
                if let Some(point) = points.missing().first() {
                    return unsupported(format!(
                        "expected curves without missing points, got one at point {point}"
                    ));
                }
                let points = in_space(points, record)?;
                let (kind, kept) = kind(&points, *closed, record)?;
                Ok(vec![Contour { kind, kept, coordinates: points.coordinates().to_vec() }])
            }
            Geometry::Landmarks(points) => {
                let missing = points.missing();
                for _ in &missing {
                    self.summary.drop("missing points", record.name.as_deref(), || record.place.clone());
                }
                let points = in_space(points, record)?;
                let rows = points.rows().filter(|row| row.iter().all(|x| !x.is_nan()));
                let point =
                    |row: &[f64]| Contour { kind: ContourKind::Point, kept: true, coordinates: row.to_vec() };
                Ok(rows.map(point).collect())
            }
            Geometry::Mesh(_) => unsupported(format!("expected curves or points for a {NAME}, got a mesh")),
            Geometry::Fourier(_) => {
                unsupported(format!("expected curves or points for a {NAME}, got Fourier coefficients"))
            }
        }
    }
}

/// A text of at most `longest` characters without the separator of values and control characters.
fn check_text(text: &str, longest: usize, what: &str) -> Result<(), FileError> {
    let count = text.chars().count();
    if count <= longest && !text.contains('\\') && !text.chars().any(char::is_control) {
        return Ok(());
    }
    let detail = format!(
        "expected at most {longest} characters for {what}, without backslashes and control characters, got {count} \
         characters"
    );
    Err(FileError::new(FaultKind::Unsupported, detail))
}

fn byte(x: f64) -> Option<u8> {
    (0..=u8::MAX).find(|byte| f64::from(*byte) == x)
}

/// Points with three coordinates: as they are, or from the plane that the metadata give.
fn in_space(points: &Points, record: &Record) -> Result<Points, FileError> {
    let fault = |detail: &str| Err(FileError::new(FaultKind::Unsupported, detail));
    if points.dimension() == 3 {
        return Ok(points.clone());
    }
    let vector = |name: &str| -> Option<[f64; 3]> {
        let list = record.metadata.get("plane")?.get(name)?.as_array()?;
        let numbers: Option<Vec<f64>> = list.iter().map(Value::as_f64).collect();
        <[f64; 3]>::try_from(numbers?).ok()
    };
    let offset = record.metadata.get("plane").and_then(|plane| plane.get("offset")).and_then(Value::as_f64);
    let (Some(u), Some(v), Some(normal), Some(offset)) = (vector("u"), vector("v"), vector("normal"), offset)
    else {
        return fault(
            "expected three coordinates, or two and the plane they are in (metadata plane), got neither",
        );
    };
    if points.dimension() != 2 {
        return fault("expected points with two or three coordinates, got others");
    }
    let mut space = Points::new(3);
    for row in points.rows() {
        space.push(&[0, 1, 2].map(|k| row[0] * u[k] + row[1] * v[k] + offset * normal[k]));
    }
    Ok(space)
}

/// The type of a curve, and whether it is the one of the file that the curve comes from.
fn kind(points: &Points, closed: bool, record: &Record) -> Result<(ContourKind, bool), FileError> {
    let given =
        record.metadata.get("contour").and_then(|contour| contour.get("type")).and_then(Value::as_str);
    let given = given.and_then(ContourKind::find);
    if closed && points.len() < 3 {
        let detail = format!("expected at least three points of a closed curve, got {}", points.len());
        return Err(FileError::new(FaultKind::Unsupported, detail));
    }
    if points.is_empty() {
        return Err(FileError::new(
            FaultKind::Unsupported,
            "expected at least one point of a curve, got none",
        ));
    }
    let contour = regions::Contour {
        image: None,
        kind: ContourKind::ClosedPlanar,
        points: points.clone(),
        number: 1,
        place: Place::default(),
    };
    // A straight curve is in many planes.
    let off = Basis::of(&[&contour]).map_or(0.0, |basis| basis.deviation(points));
    if closed && off > FLAT_MM {
        let detail = format!("expected closed curves in a plane, got one with a point {off:.3} mm from it");
        return Err(FileError::new(FaultKind::Unsupported, detail));
    }
    let kept = given.filter(|kind| kind.is_closed() == closed && *kind != ContourKind::Point);
    let found = match (closed, off <= FLAT_MM) {
        (true, _) => ContourKind::ClosedPlanar,
        (false, true) => ContourKind::OpenPlanar,
        (false, false) => ContourKind::OpenNonplanar,
    };
    Ok((kept.unwrap_or(found), kept.is_some()))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::shape::record::Ring;
    use crate::value::Value as Attribute;

    fn point(name: &str, label: Option<&str>, roi: &Value) -> Record {
        let mut record = Record::new(Geometry::Landmarks(Points::from_rows(3, vec![1.0; 3])), Place::item(0));
        record.metadata.insert("roi".into(), roi.clone());
        record.metadata.insert("contour".into(), json!({ "number": 1, "type": "POINT" }));
        Record { name: Some(name.into()), label: label.map(str::to_owned), ..record }
    }

    fn lost(records: &[Record]) -> Vec<(String, String)> {
        let image = SeriesImage { class: "1.2".into(), instance: "1.3".into(), ..SeriesImage::default() };
        let image = SeriesImage { series: "1.4".into(), frame_of_reference: "1.5".into(), ..image };
        let study = crate::dicom::Study { instance: "1.6".into(), ..Default::default() };
        let options =
            WriteOptions { series: vec![SeriesImage { study, ..image }], ..WriteOptions::default() };
        let mut writer = super::super::FORMAT.writer(std::io::sink(), &options).unwrap();
        records.iter().for_each(|record| writer.push(record).unwrap());
        let summary = writer.finish().unwrap();
        summary.dropped.into_iter().map(|dropped| (dropped.what, dropped.names.join(", "))).collect()
    }

    #[test]
    fn names_that_are_read_again_are_kept() {
        let heart = json!({ "number": 3, "name": "Heart", "type": "ORGAN", "colour": [1.0, 2.0, 3.0] });
        let shared = json!({ "number": 4, "name": "Heart" });
        let mut records = vec![
            point("Heart 1", Some("Heart"), &heart),
            point("Heart 2", None, &heart),
            point("Heart (4) 1", Some("Heart"), &shared),
            point("apex", None, &Value::Null),
        ];
        records[1].ring = Some(Ring { object: 0, part: 0, hole: true });
        assert_eq!(lost(&records), []);
        // The first contour is not read as the second one.
        records.remove(0);
        records[2].label = Some("Apex".into());
        records[2].metadata.insert("roi".into(), json!({ "name": "Tip" }));
        assert_eq!(lost(&records), [("names".into(), "Heart 2, apex, Tip".into())]);
    }

    #[test]
    fn what_regions_cannot_say_is_counted() {
        let roi = json!({ "number": 3, "colour": [1, 2, 3] });
        let mut record = point("a", Some("a"), &roi);
        record.subject = Some("p".into());
        record.weight = Some(2.0);
        record.labels.insert("age".into(), Attribute::Number(7.0));
        record.metadata.insert("scanner".into(), 7.into());
        let red = point("a", Some("a"), &json!({ "number": 3, "colour": [255, 0, 0] }));
        let colours = "types and colours other than those of the first shape of a region";
        let expected =
            [("labels", "a"), ("subject", "a"), ("weight", "a"), ("metadata", "scanner"), (colours, "a")];
        assert_eq!(lost(&[record, red]), expected.map(|(what, names)| (what.into(), names.into())));
    }
}
