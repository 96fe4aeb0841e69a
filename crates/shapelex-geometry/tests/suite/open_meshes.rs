//! Meshes with a boundary: Loop and the normal-based scheme.

use shapelex_geometry::generator::Exact;
use shapelex_geometry::mesh::{MeshError, TriangleMesh};
use shapelex_geometry::subdivision::basis::SubdivisionBasis;
use shapelex_geometry::subdivision::control::ControlMesh;
use shapelex_geometry::subdivision::limit::Limit;
use shapelex_geometry::subdivision::measures::{frames, measure};
use shapelex_geometry::subdivision::refinement::{Depth, refine_mesh};
use shapelex_geometry::subdivision::stencil::step;
use shapelex_geometry::subdivision::{Frequency, LoopWeights, Scheme, Subdivision};
use shapelex_geometry::vector::{dot, minus, norm};
use shapelex_geometry::{GeometryError, size::SizeMeasure};
use shapelex_numeric::operator::SymmetricOperator;

const LOOP: Scheme = Scheme::Loop(LoopWeights::Original);

/// Vertex 0 on the boundary with `faces` faces, over a sheet without symmetry.
fn half_disc(faces: u32) -> TriangleMesh {
    let at = |angle: f64, radius: f64| {
        let (x, y) = (radius * angle.cos(), radius * angle.sin());
        [x, y, 0.3 * x - 0.2 * y + 0.4 * x * x - 0.1 * x * y + 0.2 * y * y]
    };
    let rim = (0..=faces).map(|j| {
        let turn = f64::from(j) / f64::from(faces);
        at(3.0 * turn, 1.0 + 0.2 * (5.0 * turn).sin())
    });
    let vertices = [[0.05, -0.1, 0.02]].into_iter().chain(rim).collect();
    TriangleMesh { vertices, normals: None, faces: (1..=faces).map(|j| [0, j, j + 1]).collect() }
}

/// A sheet of `columns × rows` squares, each of two triangles.
fn sheet(columns: u32, rows: u32, height: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    let at = |i: u32, j: u32| i * (rows + 1) + j;
    let vertices = (0..=columns).flat_map(|i| (0..=rows).map(move |j| (f64::from(i), f64::from(j))));
    let square = |i: u32, j: u32| {
        [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    };
    let faces = (0..columns).flat_map(|i| (0..rows).flat_map(move |j| square(i, j)));
    TriangleMesh {
        vertices: vertices.map(|(x, y)| [x, y, height(x, y)]).collect(),
        normals: None,
        faces: faces.collect(),
    }
}

fn refined(
    scheme: Scheme,
    mesh: &TriangleMesh,
    level: usize,
    with_limit: bool,
) -> (TriangleMesh, Option<Limit>) {
    let found = refine_mesh(scheme, mesh.clone(), Depth::Level(level), 1_000_000, with_limit);
    let (refined, limit) = found.unwrap();
    (refined.shape, limit)
}

/// The weights of the notes: edges ½, ½ and vertices ⅛, ¾, ⅛ along the boundary; ⅜, ⅜, ⅛, ⅛ inside, also between two vertices of the
/// boundary.
#[test]
fn boundaries_of_loop_have_the_weights_of_the_notes() {
    let square = sheet(1, 1, |_, _| 0.0);
    let connectivity = LOOP.connectivity(4, square.faces).unwrap();
    let rows = step(LOOP, 1.0, &connectivity);
    let row = |i: usize| {
        let mut weights = [0.0; 4];
        rows.row(i).iter().for_each(|(j, weight)| weights[*j as usize] += weight);
        weights
    };
    // The boundary runs 0, 2, 3, 1; the diagonal is 0, 3.
    assert_eq!(row(0), [0.75, 0.125, 0.125, 0.0]);
    assert_eq!(row(2), [0.125, 0.0, 0.75, 0.125]);
    assert_eq!(connectivity.edges(), [[0, 1], [0, 2], [0, 3], [1, 3], [2, 3]]);
    assert_eq!(row(4), [0.5, 0.5, 0.0, 0.0]);
    assert_eq!(row(6), [0.375, 0.125, 0.125, 0.375]);
    assert_eq!(row(8), [0.0, 0.0, 0.5, 0.5]);
}

#[test]
fn the_boundary_of_loop_is_the_spline_of_its_own_vertices() {
    let smooth = sheet(4, 3, |x, y| 0.1 * x * y);
    let other =
        sheet(
            4,
            3,
            |x, y| if (0.5..3.5).contains(&x) && (0.5..2.5).contains(&y) { 7.0 } else { 0.1 * x * y },
        );
    let [a, b] = [&smooth, &other].map(|mesh| refined(LOOP, mesh, 4, true));
    let on_boundary = LOOP.connectivity(a.0.vertices.len(), a.0.faces.clone()).unwrap();
    let (mut same, mut apart) = (0, 0.0_f64);
    for vertex in 0..a.0.vertices.len() {
        let pairs = [(&a.0, &b.0)].map(|(a, b)| (a.vertices[vertex], b.vertices[vertex]))[0];
        let limits = [&a.1, &b.1].map(|limit| limit.as_ref().unwrap().points[vertex]);
        if on_boundary.is_on_boundary(vertex as u32) {
            assert_eq!(pairs.0, pairs.1);
            assert_eq!(limits[0], limits[1]);
            same += 1;
        } else {
            apart = apart.max(norm(minus(pairs.0, pairs.1)));
        }
    }
    // 14 edges of the boundary, split four times.
    assert_eq!(same, 14 << 4);
    assert!(apart > 5.0, "{apart}");
    // Limits of straight sides, with their ends: Σ of the uniform cubic B-spline.
    let flat = refined(LOOP, &sheet(4, 3, |_, _| 0.0), 0, true).1.unwrap();
    assert_eq!(flat.points[4], [1.0, 0.0, 0.0]);
}

/// The functionals are left eigenvectors of a step: the limit of a vertex is the same from every level on.
#[test]
fn limits_on_boundaries_do_not_depend_on_the_level() {
    for faces in 1..=7 {
        let mesh = half_disc(faces);
        let [first, later] = [0, 4].map(|level| refined(LOOP, &mesh, level, true).1.unwrap());
        assert!(norm(minus(first.points[0], later.points[0])) < 1e-14, "{faces}");
        let [n, m] = [first, later].map(|limit| limit.normals.unwrap()[0]);
        if faces > 5 {
            assert_eq!((n, m), ([0.0; 3], [0.0; 3]), "{faces}");
            continue;
        }
        assert!((norm(n) - 1.0).abs() < 1e-14 && norm(minus(n, m)) < 1e-10, "{faces}: {n:?} {m:?}");
        assert!(n[2] > 0.0, "faces are counter-clockwise from above: {n:?}");
    }
}

#[test]
fn limits_on_boundaries_are_those_of_late_levels() {
    for (faces, tolerance) in [(1, 0.02), (2, 0.02), (3, 0.02), (4, 0.1)] {
        let mesh = half_disc(faces);
        let wanted = refined(LOOP, &mesh, 0, true).1.unwrap();
        let (late, _) = refined(LOOP, &mesh, 8, false);
        let error = norm(minus(late.vertices[0], wanted.points[0]));
        assert!(error < 2e-5, "{faces}: {error}");
        let normal = frames(&late)[0].normal.unwrap();
        let error = norm(minus(normal, wanted.normals.unwrap()[0]));
        assert!(error < tolerance, "{faces}: {error}");
    }
}

#[test]
fn open_surfaces_of_loop_have_statistics_and_no_volume() {
    let mesh = sheet(3, 2, |x, y| 0.2 * x * x - 0.1 * y * y);
    let subdivision =
        Subdivision { scheme: LOOP, level: 3, connectivity: ControlMesh::Faces(mesh.faces.clone()) };
    let basis = SubdivisionBasis::new(&subdivision).unwrap();
    assert_eq!(basis.finest().vertices(), subdivision.size().vertices);
    assert!(!basis.control().is_closed());
    let mut ones = vec![1.0; basis.gram().size()];
    basis.gram().apply(&mut ones);
    assert!((ones.iter().sum::<f64>() - 1.0).abs() < 1e-13);
    let representation = shapelex_geometry::representation::Representation::Subdivision(subdivision);
    let space = shapelex_geometry::representation::ShapeSpace::new(&representation).unwrap();
    assert_eq!(SizeMeasure::of(&space), [SizeMeasure::Area, SizeMeasure::CentroidSize]);
    assert!(space.enclosure().is_err());
    let (fine, _) = refined(LOOP, &mesh, 4, false);
    let measures = measure(&fine, true);
    assert!(measures.enclosed.is_none() && measures.area > 4.0);
    // Curvature is inside only.
    let count = frames(&fine).iter().filter(|frame| frame.curvatures.is_none()).count();
    assert_eq!(count, 10 << 4);
    // Schemes without rules for boundaries name the open edge.
    for scheme in
        [Scheme::Blob(Frequency::Real(Exact::new(1.0))), Scheme::Butterfly { tension: Exact::new(0.0) }]
    {
        let found = refine_mesh(scheme, mesh.clone(), Depth::Level(1), 1000, false).unwrap_err();
        assert!(matches!(found, GeometryError::Mesh(MeshError::Open { face: 0, .. })), "{found}");
    }
}

/// A spherical cap with radial normals: the rule is that of edges, so that a boundary changes nothing.
#[test]
fn caps_of_spheres_stay_on_them() {
    let mut mesh = half_disc(5);
    mesh.vertices.iter_mut().for_each(|vertex| {
        let point = [vertex[0], vertex[1], 1.5];
        *vertex = point.map(|x| x / norm(point));
    });
    mesh.normals = Some(mesh.vertices.clone());
    let scheme = Scheme::NormalBased { balance: Exact::new(0.0) };
    let (fine, _) = refined(scheme, &mesh, 5, false);
    assert_eq!(fine.faces.len(), 5 << 10);
    for (point, normal) in fine.vertices.iter().zip(fine.normals.as_ref().unwrap()) {
        assert!((norm(*point) - 1.0).abs() < 1e-14 && dot(*point, *normal) > 1.0 - 1e-12, "{point:?}");
    }
    assert!(measure(&fine, true).enclosed.is_none());
}
