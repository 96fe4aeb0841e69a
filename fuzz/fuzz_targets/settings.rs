//! What shapes are made of and what is disregarded: a representation, a generator, the target of a fit, a transformation.
//!
//! What is accepted can be prepared, written, and read again as the same.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use shapelex_server::analysis::transformation::{Transformation, TransformationClass};
use shapelex_server::wire::checked::Checked;
use shapelex_server::wire::representation::{FitTarget, Readable, read_generator};
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::numeric::dense::Matrix;
use shapelex_server::service::shapes::read::{admit_linear, parse};
use shapelex_fuzz::LIMITS;

fuzz_target!(|text: &[u8]| {
    transformation(text);
    let Ok(value) = serde_json::from_slice::<Value>(text) else { return };
    generator(value.clone());
    if let Ok(target) = FitTarget::read(value.clone())
        && let Ok(admitted) = admit_linear(target.representation, &LIMITS)
    {
        // It may be refused, but must not fail in another way.
        let _ = ShapeSpace::new(&admitted);
    }
    representation(value);
});

fn generator(value: Value) {
    let Ok(kind) = read_generator(value) else { return };
    // What has faults of its own is never built.
    if kind.faults().is_empty() && kind.properties().fewest_control_points <= LIMITS.control_points {
        let _ = kind.build(kind.properties().fewest_control_points);
    }
}

fn representation(value: Value) {
    let Ok(representation) = Representation::read(value) else { return };
    let written = serde_json::to_string(&representation).expect("a representation is JSON");
    let again: Representation = serde_json::from_str(&written).expect("what was written is read");
    assert_eq!(again, representation);
    let Ok(representation) = admit_linear(representation, &LIMITS) else { return };
    let Ok(space) = ShapeSpace::new(&representation) else { return };
    let points = Matrix::from_element(representation.point_count(), representation.dimension(), 1.0);
    let Ok(control_points) = space.interpolate(points) else { return };
    assert_eq!(control_points.shape(), (representation.size(), representation.dimension()), "{written}");
}

fn transformation(text: &[u8]) {
    let Ok(read) = parse::<Checked<Transformation>>(&LIMITS, text) else { return };
    let mut errors = Vec::new();
    let Some(transformation) = read.take("/transformation", &mut errors) else {
        assert!(!errors.is_empty(), "a refusal without a reason");
        return;
    };
    let written = serde_json::to_string(&transformation).expect("a transformation is JSON");
    let again: Transformation = serde_json::from_str(&written).expect("what was written is read");
    assert_eq!(again, transformation);
    for dimension in [2, 3] {
        let Ok(class) = TransformationClass::new(&transformation, dimension) else { continue };
        assert!(!class.matrices().is_empty() || class.translates(), "{written}");
        let square = |matrix: &Matrix| matrix.shape() == (dimension, dimension);
        assert!(class.matrices().iter().all(square), "{written}");
    }
}
