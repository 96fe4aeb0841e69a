//! DICOM segmentations of one slice, made cell by cell.

use crate::dicom::{EXPLICIT, file};

/// Columns and rows.
pub(crate) const SIZE: [i64; 2] = [40, 24];

/// Content of a file.
pub(crate) struct Segments<'a> {
    /// SOP Instance UID.
    pub(crate) instance: &'a str,
    /// Patient ID.
    pub(crate) patient: &'a str,
    /// Whether a cell is of the segment, for segments 1, 2, and so on.
    pub(crate) cells: &'a [&'a dyn Fn(i64, i64) -> bool],
}

/// A disc around a cell.
pub(crate) fn disc(x: i64, y: i64, radius: i64) -> impl Fn(i64, i64) -> bool {
    move |u, v| (u - x).pow(2) + (v - y).pow(2) <= radius.pow(2)
}

impl Segments<'_> {
    /// The file: segments of cells of 1 mm, which may overlap, of a CT scan.
    pub(crate) fn file(&self) -> Vec<u8> {
        let e = EXPLICIT;
        let plane = e.sequence(0x0020_9116, &[e.text(0x0020_0037, "DS", "1\\0\\0\\0\\1\\0")]);
        let measures = [e.text(0x0018_0088, "DS", "2"), e.text(0x0028_0030, "DS", "1\\1")].concat();
        let shared = [plane, e.sequence(0x0028_9110, &[measures])].concat();
        let numbers = 1..=self.cells.len() as u16;
        let segments: Vec<_> = numbers.clone().map(|number| self.segment(number)).collect();
        let frames: Vec<_> = numbers.map(frame).collect();
        let image =
            [e.text(0x0008_1150, "UI", "1.2.840.10008.5.1.4.1.1.2"), e.text(0x0008_1155, "UI", "1.2.3.1")];
        let series = [e.sequence(0x0008_114a, &[image.concat()]), e.text(0x0020_000e, "UI", "1.2.6")];
        let set = [
            e.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.66.4"),
            e.text(0x0008_0018, "UI", self.instance),
            e.text(0x0008_0060, "CS", "SEG"),
            e.text(0x0008_0080, "LO", "Hospital of Secrets"),
            e.sequence(0x0008_1115, &[series.concat()]),
            e.text(0x0010_0010, "PN", "Secret^Name"),
            e.text(0x0010_0020, "LO", self.patient),
            e.text(0x0018_0015, "CS", "CHEST"),
            e.text(0x0020_000d, "UI", "1.2.5"),
            e.text(0x0020_000e, "UI", "1.2.7"),
            e.text(0x0020_0052, "UI", "1.2.4"),
            e.text(0x0028_0008, "IS", &self.cells.len().to_string()),
            e.number(0x0028_0010, SIZE[1] as u16),
            e.number(0x0028_0011, SIZE[0] as u16),
            e.number(0x0028_0100, 1),
            e.text(0x0062_0001, "CS", "BINARY"),
            e.sequence(0x0062_0002, &segments),
            e.sequence(0x5200_9229, &[shared]),
            e.sequence(0x5200_9230, &frames),
            e.bytes(0x7fe0_0010, "OB", &self.bits()),
        ];
        file(e.syntax(), &set.concat())
    }

    fn segment(&self, number: u16) -> Vec<u8> {
        let e = EXPLICIT;
        let code = [e.text(0x0008_0100, "SH", &format!("8089100{number}")), e.text(0x0008_0102, "SH", "SCT")];
        [
            e.number(0x0062_0004, number),
            e.text(0x0062_0005, "LO", &format!("part {number}")),
            e.text(0x0062_0006, "ST", "typed by a secret person"),
            e.sequence(0x0062_000f, &[code.concat()]),
        ]
        .concat()
    }

    /// Bits of all frames, one after the other, the least significant one of a byte first.
    fn bits(&self) -> Vec<u8> {
        let [columns, rows] = SIZE;
        let cells = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        let all: Vec<bool> =
            self.cells.iter().flat_map(|inside| cells.clone().map(|(x, y)| inside(x, y))).collect();
        let byte = |bits: &[bool]| (0..).zip(bits).map(|(k, bit)| u8::from(*bit) << k).sum();
        all.chunks(8).map(byte).collect()
    }
}

fn frame(segment: u16) -> Vec<u8> {
    let e = EXPLICIT;
    let position = e.text(0x0020_0032, "DS", "-10\\-20\\5");
    let number = e.number(0x0062_000b, segment);
    [e.sequence(0x0020_9113, &[position]), e.sequence(0x0062_000a, &[number])].concat()
}
