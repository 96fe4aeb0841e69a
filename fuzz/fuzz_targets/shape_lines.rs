//! NDJSON in chunks of any length, each line a shape, each shape read into several representations.
//!
//! The first byte is the length of the chunks: where they end must not matter.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use shapelex_server::analysis::conversion::Conversion;
use shapelex_server::analysis::correspondence::{Correspondence, Direction};
use shapelex_server::wire::ndjson::{Line, LineTooLong, Lines};
use shapelex_server::wire::shape::ShapeInput;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::resample::RepeatedPoints;
use shapelex_server::service::shapes::read::{ReadShape, Reading, own_faults, parse, read_shape};
use shapelex_fuzz::LIMITS;

/// Representations, as they stand in a request, and how points become theirs.
const REPRESENTATIONS: [(&str, Correspondence); 4] = [
    (
        r#"{"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "trigonometric"}}"#,
        Correspondence::Cyclic,
    ),
    (
        r#"{"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "bspline", "degree": 3}}"#,
        Correspondence::ArcLength,
    ),
    (
        r#"{"kind": "open_curve", "dimension": 3, "intervals": 5, "generator": {"name": "cubic"}}"#,
        Correspondence::ArcLength,
    ),
    (r#"{"kind": "landmarks", "dimension": 2, "points": 3}"#, Correspondence::Landmarks),
];

static SPACES: LazyLock<Vec<(ShapeSpace, Correspondence)>> = LazyLock::new(|| {
    let space = |(text, correspondence): (&str, Correspondence)| {
        let representation: Representation = serde_json::from_str(text).expect("a representation");
        (ShapeSpace::new(&representation).expect("a space"), correspondence)
    };
    REPRESENTATIONS.into_iter().map(space).collect()
});

fn lines(text: &[u8], chunk: usize) -> Result<Vec<Line>, LineTooLong> {
    let (mut lines, mut found) = (Lines::new(LIMITS.line_bytes), Vec::new());
    for piece in text.chunks(chunk) {
        lines.push(piece.to_vec(), |line| found.push(line))?;
    }
    lines.finish(|line| found.push(line))?;
    Ok(found)
}

fuzz_target!(|data: &[u8]| {
    let Some((&chunk, text)) = data.split_first() else { return };
    let found = lines(text, usize::from(chunk).max(1));
    assert_eq!(found, lines(text, text.len().max(1)), "chunks of {chunk}");
    for line in found.unwrap_or_default() {
        let Ok(shape) = parse::<ShapeInput>(&LIMITS, &line.text) else { continue };
        for (space, correspondence) in SPACES.iter() {
            let (correspondence, direction) = (*correspondence, Direction::Either);
            let repeated_points = RepeatedPoints::Drop;
            let conversion = Conversion { space, correspondence, direction, repeated_points };
            let reading = Reading { conversion, limits: &LIMITS };
            if let Ok(ReadShape { control_points, attributes, .. }) = read_shape(&reading, shape.clone()) {
                let representation = space.representation();
                assert_eq!(control_points.len(), representation.size() * representation.dimension());
                assert!(control_points.iter().all(|value| value.is_finite()), "{control_points:?}");
                assert!(attributes.weight > 0.0 && attributes.weight.is_finite(), "{}", attributes.weight);
                assert_eq!(own_faults(shape.clone()), [], "what was accepted has faults");
            }
        }
    }
});
