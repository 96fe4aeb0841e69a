//! Boundary integrals and their gradients against the stored vectors and differences.

use serde_json::Value;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::knot_line::Line;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis};
use shapelex_geometry::surface::seam::Seam;
use shapelex_geometry::surface::sphere::handle_length;
use shapelex_numeric::sparse::SparseRows;
use shapelex_segmentation::boundary::curve::CurveBoundary;
use shapelex_segmentation::boundary::cylinder::{CylinderBoundary, CylinderMesh};
use shapelex_segmentation::boundary::mesh::MeshBoundary;
use shapelex_segmentation::boundary::tensor::TensorBoundary;
use shapelex_segmentation::boundary::{Boundary, Differential};
use shapelex_segmentation::field::Integrated;
use shapelex_segmentation::frame::Frame;

use crate::vectors::{assert_close, count, image, load, number, numbers, points};

const TOLERANCE: f64 = 1e-8;

/// Value and gradient of a functional against an entry of a document.
fn assert_differential<const D: usize>(found: &Differential<D>, expected: &Value, what: &str) {
    let value = if expected["value"].is_null() { &expected["E"] } else { &expected["value"] };
    assert_close(&[found.value], &[number(value)], TOLERANCE, what);
    assert_close(
        &found.gradient.concat(),
        &numbers(&expected["grad"]),
        TOLERANCE,
        &format!("gradient of {what}"),
    );
}

/// Gradients of all functionals against central differences along a fixed direction.
fn assert_differences<const D: usize>(
    boundary: &dyn Boundary<D>,
    rows: &[[f64; D]],
    integral: impl Fn(&shapelex_segmentation::boundary::Samples<D>) -> Differential<D>,
) {
    let direction: Vec<[f64; D]> = (0..rows.len())
        .map(|i| std::array::from_fn(|c| (1.7 * i as f64 + 2.3 * c as f64 + 0.4).sin()))
        .collect();
    let moved = |h: f64| -> Vec<[f64; D]> {
        let move_one = |(p, d): (&[f64; D], &[f64; D])| std::array::from_fn(|c| p[c] + h * d[c]);
        rows.iter().zip(&direction).map(move_one).collect()
    };
    let all = |rows: &[[f64; D]]| {
        let samples = boundary.sample(rows);
        [
            integral(&samples),
            boundary.volume(&samples),
            boundary.measure(&samples),
            boundary.spacing(&samples),
        ]
    };
    let h = 1e-5;
    let (at, above, below) = (all(rows), all(&moved(h)), all(&moved(-h)));
    for (which, at) in at.iter().enumerate() {
        let slope: f64 =
            at.gradient.iter().flatten().zip(direction.iter().flatten()).map(|(g, d)| g * d).sum();
        let difference = (above[which].value - below[which].value) / (2.0 * h);
        let error = (slope - difference).abs() / slope.abs().max(1e-3);
        assert!(error < 1e-6, "functional {which}: {slope} for {difference}, error {error:.1e}");
    }
}

fn lines(topology: Topology, intervals: [usize; 2]) -> SurfaceBasis {
    let extent = Extent { topology, intervals };
    SurfaceBasis::new(extent, Seam::Straight, &topology.usual_generators()).expect("usual generators")
}

#[test]
fn planar_curves_are_those_of_the_vectors() {
    let document = load("curve2d");
    let field = Integrated::<2>::new(&image(&document));
    let rows = points::<2>(&document["control"]);
    let line = Line::new(&GeneratorKind::Trigonometric {}, rows.len(), true).unwrap();
    let per_span = count(&document["samples_per_span"]);
    let boundary = CurveBoundary::new(&line, per_span, &rows, Frame::identity());
    let samples = boundary.sample(&rows);
    assert_differential(&boundary.integral(&samples, &field), &document["integral"], "integral");
    assert_differential(&boundary.volume(&samples), &document["area"], "area");
    assert_differential(&boundary.measure(&samples), &document["length"], "length");
    assert_differential(&boundary.spacing(&samples), &document["reparam"], "reparam");
    let fine = CurveBoundary::new(&line, 4096, &rows, Frame::identity());
    let limit = fine.integral(&fine.sample(&rows), &field).value;
    assert_close(&[limit], &[number(&document["integral_limit_E"])], 1e-5, "limit");
    assert_differences(&boundary, &rows, |samples| boundary.integral(samples, &field));
    // The reversed curve encloses the same.
    let mut reversed = rows.clone();
    reversed[1..].reverse();
    let turned = CurveBoundary::new(&line, per_span, &reversed, Frame::identity());
    let found = turned.integral(&turned.sample(&reversed), &field).value;
    assert_close(&[found], &[number(&document["integral"]["E"])], 1e-12, "reversed");
}

/// Gradients of the document are for poles and tangents, ours for poles and handles: `∂E/∂T = κ ∂E/∂h`, and the gradient for a
/// pole is that of its row and both handles.
fn with_tangents(found: Differential<3>, intervals: usize) -> Differential<3> {
    let kappa = handle_length(intervals);
    let mut gradient = found.gradient;
    let first = gradient.len() - 6;
    for pole in 0..2 {
        for handle in [first + 2 + 2 * pole, first + 3 + 2 * pole] {
            for c in 0..3 {
                gradient[first + pole][c] += gradient[handle][c];
                gradient[handle][c] *= kappa;
            }
        }
    }
    Differential { value: found.value, gradient }
}

/// Rows with handles, of a list that ends in poles and tangents.
fn with_handles(mut points: Vec<[f64; 3]>, intervals: usize) -> Vec<[f64; 3]> {
    let (kappa, first) = (handle_length(intervals), points.len() - 6);
    for pole in 0..2 {
        for handle in [first + 2 + 2 * pole, first + 3 + 2 * pole] {
            points[handle] = std::array::from_fn(|c| points[first + pole][c] + kappa * points[handle][c]);
        }
    }
    points
}

#[test]
fn spheres_are_those_of_the_vectors() {
    let document = load("sphere3d");
    let field = Integrated::<3>::new(&image(&document));
    let intervals = [&document["M1"], &document["M2"]].map(count);
    let basis = lines(Topology::Sphere, intervals);
    let rows = with_handles(points(&document["free_points"]), intervals[1]);
    let net = basis.control_net();
    assert_close(&net.apply(&rows).concat(), &numbers(&document["control_net"]), 1e-9, "net");
    let per_span = [&document["Su"], &document["gauss_per_span"]].map(count);
    let boundary = TensorBoundary::new(basis.lines(), net.clone(), per_span, &rows, Frame::identity());
    let samples = boundary.sample(&rows);
    let check = |found: Differential<3>, name: &str| {
        assert_differential(&with_tangents(found, intervals[1]), &document[name], name);
    };
    check(boundary.integral(&samples, &field), "integral");
    check(boundary.volume(&samples), "volume_enclosed");
    check(boundary.measure(&samples), "area");
    check(boundary.spacing(&samples), "reparam");
    let fine = TensorBoundary::new(basis.lines(), net, [160, 80], &rows, Frame::identity());
    let fine_samples = fine.sample(&rows);
    let limits = [fine.integral(&fine_samples, &field).value, fine.volume(&fine_samples).value];
    for (limit, expected) in
        limits.iter().zip([&document["integral_limit_E"], &document["volume_enclosed"]["limit"]])
    {
        assert_close(&[*limit], &[number(expected)], 1e-4, "limit");
    }
    assert_differences(&boundary, &rows, |samples| boundary.integral(samples, &field));
}

#[test]
fn cylinders_are_those_of_the_vectors() {
    let document = load("cylinder3d");
    let field = Integrated::<3>::new(&image(&document));
    let basis = lines(Topology::Cylinder, [&document["M1"], &document["M2"]].map(count));
    let rows = points::<3>(&document["free_points"]);
    // The lateral surface alone.
    let net = shapelex_segmentation::boundary::cylinder::extension(basis.lines());
    assert_close(&net.apply(&rows).concat(), &numbers(&document["control_net"]), 1e-9, "net");
    let per_span = [&document["Su"], &document["gauss_per_span"]].map(count);
    let open = TensorBoundary::new(basis.lines(), net, per_span, &rows, Frame::identity());
    let samples = open.sample(&rows);
    assert_differential(&open.integral(&samples, &field), &document["open_integral"], "open integral");
    let expected = &document["closed_mesh_24x10_rings3"];
    let mesh = CylinderMesh { counts: [24, 10], rings: 3 };
    let boundary = CylinderBoundary::new(basis.lines(), mesh, &rows, Frame::identity());
    let samples = boundary.sample(&rows);
    assert_differential(&boundary.integral(&samples, &field), expected, "closed mesh");
    assert_close(&[boundary.volume(&samples).value], &[number(&expected["volume"])], TOLERANCE, "volume");
    assert_close(
        &[boundary.measure(&samples).value],
        &[number(&document["lateral_area"])],
        TOLERANCE,
        "area",
    );
    assert_differences(&boundary, &rows, |samples| boundary.integral(samples, &field));
}

#[test]
fn meshes_are_those_of_the_vectors() {
    let document = load("mesh3d");
    let field = Integrated::<3>::new(&image(&document));
    let rows = points::<3>(&document["control"]);
    let mut entries: Vec<Vec<(u32, f64)>> = vec![Vec::new(); count(&document["n_vertices"])];
    for [row, column, weight] in points::<3>(&document["S"]) {
        entries[row as usize].push((column as u32, weight));
    }
    let mut operator = SparseRows::new(rows.len(), entries.len(), 0);
    entries.iter().for_each(|row| operator.push(row));
    let faces = points::<3>(&document["triangles"]).into_iter().map(|face| face.map(|vertex| vertex as u32));
    let boundary = MeshBoundary::new(operator, faces.collect(), &rows, Frame::identity());
    let samples = boundary.sample(&rows);
    assert_differential(&boundary.integral(&samples, &field), &document["integral"], "integral");
    assert_differential(&boundary.volume(&samples), &document["volume_enclosed"], "volume");
    assert_differential(&boundary.spacing(&samples), &document["triangle_spread"], "spread");
    assert_close(&[boundary.measure(&samples).value], &[number(&document["area"])], TOLERANCE, "area");
    assert_differences(&boundary, &rows, |samples| boundary.integral(samples, &field));
}
