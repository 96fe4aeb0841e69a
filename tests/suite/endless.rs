//! Measures that once had no end are answered.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::server::{assert_relative, shared};

fn measured(body: &Value) -> Value {
    let answer: Value = shared().post("/v1/measure", body).expect(200);
    // A collapsed curve has no extent but that of rounding.
    let of_rounding = |warning: &Value| warning.as_str().unwrap().contains("so far from the origin");
    assert!(answer["results"][0]["warnings"].as_array().unwrap().iter().all(of_rounding), "{answer}");
    answer["results"][0].clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Closed curves of `generator` through one point but for one at `moved`, and the point alone.
fn against_a_point(generator: Value, size: usize, at: [f64; 2], moved: [f64; 2]) -> Value {
    let points = vec![at; size];
    let mut reference = points.clone();
    reference[3] = moved;
    json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": size, "generator": generator},
        "shapes": [{"points": points}], "reference": {"points": reference}})
}

/// The curve runs along a line: `1000 φ` from the point, with φ from 0 to −2/27, to 1, and back; `∫ φ² = 57/70`. Where it turns
/// back within a piece its speed has a kink, which costs the fixed rule of the mean four digits.
#[test]
fn a_collapsed_curve_has_distances() {
    let body = against_a_point(json!({"name": "cubic"}), 8, [1000.0, 1000.0], [0.0, 1000.0]);
    let distances = &measured(&body)["distances"];
    let dip: f64 = 2.0 / 27.0;
    let mean_square = 1e6 * (2.0 + 4.0 * dip.powi(3)) / (3.0 * (2.0 + 4.0 * dip));
    assert_relative("l2", number(&distances["l2"]), 1000.0 * (57.0_f64 / 560.0).sqrt(), 1e-13);
    assert_relative("symmetric", number(&distances["symmetric_l2"]), (0.5 * mean_square).sqrt(), 1e-4);
    assert_relative("Hausdorff", number(&distances["hausdorff"]), 1000.0, 1e-9);
}

#[test]
fn a_collapsed_curve_of_an_interpolator_has_distances() {
    let generator = json!({"name": "interpolator", "family": "integer_shifts", "poles": [[0, 0], [0, 0], [0, 0], [0, 0]]});
    let body = against_a_point(generator, 8, [1.0, 1.0], [0.0, 1.0]);
    assert_relative("Hausdorff", number(&measured(&body)["distances"]["hausdorff"]), 1.0, 1e-9);
}

fn around(count: usize, centre: [f64; 2], axes: [f64; 2]) -> Vec<[f64; 2]> {
    let angle = |i: usize| TAU * i as f64 / count as f64;
    (0..count).map(|i| [centre[0] + axes[0] * angle(i).cos(), centre[1] + axes[1] * angle(i).sin()]).collect()
}

fn of_circles(generator: &str, shape: &[[f64; 2]], reference: &[[f64; 2]]) -> Value {
    json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": shape.len(),
        "generator": {"name": generator}}, "shapes": [{"points": shape}], "reference": {"points": reference}})
}

/// An ellipse with the semi-axes 2 and 1 about a point at (10⁶, 10⁶), which has 10 digits behind the point there.
#[test]
fn a_point_far_off_has_distances_from_an_ellipse_either_way_round() {
    let (centre, ellipse) = ([1e6; 2], around(8, [1e6; 2], [2.0, 1.0]));
    for (shape, reference) in [(vec![centre; 8], ellipse.clone()), (ellipse, vec![centre; 8])] {
        let body = of_circles("trigonometric", &shape, &reference);
        let distances = measured(&body)["distances"].clone();
        assert_relative("Hausdorff", number(&distances["hausdorff"]), 2.0, 1e-8);
        assert_relative("l2", number(&distances["l2"]), (0.5_f64 * 5.0).sqrt(), 1e-8);
    }
}

/// All points of the circle are equally far from its centre: no half-segment rules out another.
#[test]
fn a_circle_of_many_points_has_a_distance_from_its_centre() {
    let body = of_circles("cubic", &around(64, [0.0; 2], [1.0; 2]), &[[0.0; 2]; 64]);
    let answer: Value = shared().post("/v1/measure", &body).expect(200);
    let distances = &answer["results"][0]["distances"];
    // Tolerances grow until halves that differ by less than the curve from a circle are ruled out; this is said.
    let warnings = answer["results"][0]["warnings"].as_array().unwrap();
    assert!(warnings.iter().all(|text| text.as_str().unwrap().contains("accurate to")), "{answer}");
    // Interpolated by cubics, 2·10⁻⁶ beyond the circle.
    assert_relative("Hausdorff", number(&distances["hausdorff"]), 1.0, 1e-5);
    assert_relative("symmetric", number(&distances["symmetric_l2"]), 1.0, 1e-5);
}

/// A circle has `2πr`, `πr²` (smaller than any number with all its digits), and turns once whatever its size.
#[test]
fn a_tiny_curve_has_measures() {
    for radius in [1e-158, 1e-155, 1e-100, 1e99] {
        let circle = around(8, [0.0; 2], [radius; 2]);
        let body = json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 8,
            "generator": {"name": "trigonometric"}}, "shapes": [{"points": circle}]});
        let measures = measured(&body);
        assert_relative("length", number(&measures["length"]), TAU * radius, 1e-12);
        assert_relative("turning", number(&measures["turning"]), TAU, 1e-12);
        assert_eq!(
            (&measures["orientation"], &measures["self_intersecting"]),
            (&json!("counter_clockwise"), &json!(false))
        );
        let area = PI * radius * radius;
        assert!((number(&measures["area"]) - area).abs() <= 1e-12 * area + 5e-324, "{measures}");
    }
}
