//! Subdivision surfaces against stored vectors, closed forms and invariance laws.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::GeometryError;
use shapelex_geometry::generator::Exact;
use shapelex_geometry::mesh::{Connectivity, TriangleMesh};
use shapelex_geometry::raster::{self, Grid};
use shapelex_geometry::subdivision::basis::{SubdivisionBasis, steps};
use shapelex_geometry::subdivision::control::{ControlMesh, StartMesh};
use shapelex_geometry::subdivision::limit::limit;
use shapelex_geometry::subdivision::measures::{frames, measure};
use shapelex_geometry::subdivision::normal_based::{
    Oriented, circle_normals, refine_polyline, sphere_normals, split,
};
use shapelex_geometry::subdivision::refinement::{Depth, refine_mesh};
use shapelex_geometry::subdivision::stencil::{BlobWeights, check_valences, loop_beta, step};
use shapelex_geometry::subdivision::{Frequency, LoopWeights, Scheme, Subdivision};
use shapelex_geometry::vector::{cross, dot, minus, norm};
use shapelex_numeric::dense::Matrix;

use crate::vectors::{cases, list, load, matrix, number, numbers, text};

fn points(value: &Value) -> Vec<[f64; 3]> {
    let point = |point: &Value| match numbers(point)[..] {
        [x, y] => [x, y, 0.0],
        [x, y, z] => [x, y, z],
        _ => panic!("no point: {point}"),
    };
    list(value).iter().map(point).collect()
}

fn faces(value: &Value) -> Vec<[u32; 3]> {
    let face = |face: &Value| [0, 1, 2].map(|i| face[i].as_u64().unwrap() as u32);
    list(value).iter().map(face).collect()
}

fn exact(value: f64) -> Exact {
    Exact::new(value)
}

fn blob(lambda: &Value) -> Scheme {
    let [re, im] = ["re", "im"].map(|part| number(&lambda[part]));
    Scheme::Blob(if im == 0.0 { Frequency::Real(exact(re)) } else { Frequency::Imaginary(exact(im)) })
}

fn pi_half() -> Scheme {
    Scheme::Blob(Frequency::Real(exact(FRAC_PI_2)))
}

/// Largest coordinate, at least 1: what the tolerances of points are parts of.
fn scale(points: &[[f64; 3]]) -> f64 {
    points.iter().flatten().fold(1.0, |most, x| most.max(x.abs()))
}

fn apart(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| norm(minus(*a, *b))).fold(0.0, f64::max)
}

fn refine(scheme: Scheme, mesh: &TriangleMesh, level: usize) -> TriangleMesh {
    refine_mesh(scheme, mesh.clone(), Depth::Level(level), 1_000_000, false).unwrap().0.shape
}

fn named(text: &str) -> ControlMesh {
    ControlMesh::Named(text.parse().unwrap())
}

fn mesh_of(text: &str) -> TriangleMesh {
    text.parse::<StartMesh>().unwrap().mesh()
}

fn rows(points: &[[f64; 3]]) -> Matrix {
    Matrix::from_fn(points.len(), 3, |i, c| points[i][c])
}

/// Every case of a file whose levels are made one after the other.
fn check_levels(file: &str, scheme: impl Fn(&Value) -> Scheme) {
    let document = load(&format!("subdivision/{file}"));
    let tolerance = number(&document["tolerance"]);
    for case in cases(&document) {
        let mesh =
            TriangleMesh { vertices: points(&case["vertices"]), normals: None, faces: faces(&case["faces"]) };
        for level in list(&case["levels"]) {
            let k = level["level"].as_u64().unwrap() as usize;
            let wanted = points(&level["vertices"]);
            let found = refine(scheme(case), &mesh, k);
            let error = apart(&found.vertices, &wanted);
            assert!(error < tolerance * scale(&wanted), "{file} {} level {k}: {error}", case["name"]);
            // A basis gives the same vertices.
            let control = mesh.connectivity().unwrap();
            let (matrices, levels, _) = steps(scheme(case), &control, k).unwrap();
            let applied = matrices.iter().fold(mesh.vertices.clone(), |points, matrix| matrix.apply(&points));
            assert_eq!(levels[k].faces(), &found.faces[..]);
            assert!(apart(&applied, &found.vertices) < 1e-14 * scale(&wanted));
        }
    }
}

#[test]
fn meshes_of_blob_match() {
    check_levels("blob_meshes.json", |case| blob(&case["lambda"]));
}

#[test]
fn meshes_of_the_butterfly_match() {
    check_levels("butterfly.json", |case| Scheme::Butterfly { tension: exact(number(&case["w"])) });
}

fn loop_weights(case: &Value) -> LoopWeights {
    match text(&case["weights"]) {
        "loop" => LoopWeights::Original,
        "simplified_3_over_8n" => LoopWeights::Simplified,
        other => panic!("unknown weights {other}"),
    }
}

#[test]
fn meshes_and_limits_of_loop_match() {
    check_levels("loop.json", |case| Scheme::Loop(loop_weights(case)));
    let document = load("subdivision/loop.json");
    for case in cases(&document) {
        let connectivity = Connectivity::new(list(&case["vertices"]).len(), faces(&case["faces"])).unwrap();
        let scheme = Scheme::Loop(loop_weights(case));
        let control = points(&case["vertices"]);
        let found = limit(scheme, 1.0, &connectivity, &control);
        let wanted = points(&case["limit_of_control_vertices"]);
        assert!(apart(&found.points, &wanted) < 1e-12 * scale(&wanted), "{}", case["name"]);
        let normals = points(&case["limit_normals_of_control_vertices"]);
        assert!(apart(found.normals.as_ref().unwrap(), &normals) < 1e-12, "{}", case["name"]);
        // One step on the limit of the same vertices is the same.
        let finer = step(scheme, 1.0, &connectivity).apply(&control);
        let later = limit(scheme, 1.0, &connectivity.split(), &finer);
        assert!(apart(&later.points[..wanted.len()], &wanted) < 1e-12 * scale(&wanted));
    }
}

#[test]
fn weights_of_blob_match() {
    let document = load("subdivision/blob_weights.json");
    for case in cases(&document) {
        let k = case["k"].as_u64().unwrap() as usize;
        let v = blob(&case["lambda"]).parameters().nth(k).unwrap();
        let tolerance = number(&document["tolerance"]);
        assert!((v - number(&case["v"])).abs() < tolerance * v, "{case}");
        let w = BlobWeights::new(v);
        for (name, found) in [
            ("a", w.a),
            ("b", w.b),
            ("c", w.c),
            ("d", w.d),
            ("e", w.e),
            ("f", w.f),
            ("g", w.g),
            ("h", w.h),
            ("a_tilde", w.aa),
            ("b_tilde", w.bb),
            ("d_tilde", w.dd),
            ("e_tilde", w.ee),
            ("f_tilde", w.ff),
        ] {
            let wanted = number(&case["weights"][name]);
            assert!((found - wanted).abs() < tolerance, "{name} {found} {wanted} of {case}");
        }
    }
}

/// A doubly periodic grid with diagonals in the direction (1, 1), and where point `(2i, 2j)` … of the finer grid is in the split
/// mesh.
fn torus(rows: usize, columns: usize) -> Vec<[u32; 3]> {
    let at = |i: usize, j: usize| (columns * (i % rows) + j % columns) as u32;
    let cell = |i: usize, j: usize| {
        [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    };
    (0..rows).flat_map(|i| (0..columns).flat_map(move |j| cell(i, j))).collect()
}

/// Vertices of a split torus in the order of the finer grid.
fn in_grid(connectivity: &Connectivity, rows: usize, columns: usize, split: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let at = |i: usize, j: usize| (columns * (i % rows) + j % columns) as u32;
    let edge = |a: u32, b: u32| {
        let key = [a.min(b), a.max(b)];
        connectivity.vertices() + connectivity.edges().binary_search(&key).unwrap()
    };
    let place = |i: usize, j: usize| {
        let (a, b) = (at(i / 2, j / 2), at(i.div_ceil(2), j.div_ceil(2)));
        split[if a == b { a as usize } else { edge(a, b) }]
    };
    (0..2 * rows).flat_map(|i| (0..2 * columns).map(move |j| (i, j))).map(|(i, j)| place(i, j)).collect()
}

#[test]
fn tori_of_blob_match_the_mask_of_the_grid() {
    let document = load("subdivision/blob_regular.json");
    for case in list(&document["tori"]) {
        let [rows, columns] = ["I", "J"].map(|name| case[name].as_u64().unwrap() as usize);
        let grid: Vec<[f64; 3]> = list(&case["grid"]).iter().flat_map(points).collect();
        let wanted: Vec<[f64; 3]> = list(&case["grid_level1"]).iter().flat_map(points).collect();
        let connectivity = Connectivity::new(rows * columns, torus(rows, columns)).unwrap();
        assert_eq!(connectivity.genus(), 1);
        let v = number(&case["v"]);
        let split = step(Scheme::Blob(Frequency::Start(exact(v))), v, &connectivity).apply(&grid);
        let found = in_grid(&connectivity, rows, columns, &split);
        assert!(apart(&found, &wanted) < number(&document["tolerance"]) * scale(&wanted), "{}", case["name"]);
    }
}

/// The grid with 28 points gives an ellipsoid of revolution with open poles, exactly; waves scaled before give the unit sphere.
#[test]
fn the_sphere_grid_is_an_exact_ellipsoid() {
    let document = load("subdivision/blob_regular.json");
    for case in list(&document["sphere_grid"]) {
        let grid: Vec<[f64; 3]> = list(&case["full_grid"]).iter().flat_map(points).collect();
        let scheme = blob(&case["lambda"]);
        let (mut connectivity, mut current) = (Connectivity::new(36, torus(6, 6)).unwrap(), grid);
        let mut side = 6;
        for (v, level) in scheme.parameters().zip(list(&case["levels"])) {
            let split = step(scheme, v, &connectivity).apply(&current);
            current = in_grid(&connectivity, side, side, &split);
            side *= 2;
            connectivity = Connectivity::new(side * side, torus(side, side)).unwrap();
            let wanted: Vec<[f64; 3]> = list(&level["rows"]).iter().flat_map(points).collect();
            let (count, columns) = (list(&level["rows"]).len(), list(&level["rows"][0]).len());
            assert_eq!((count, columns), (side / 2 + 1, side));
            assert!(apart(&current[..count * columns], &wanted) < 1e-13);
        }
    }
    // The named grid of the same 36 vertices: points on a quadric at every level.
    let mesh = mesh_of("pole_grid");
    let scheme = Scheme::Blob(Frequency::Real(exact(FRAC_PI_3)));
    let products = scheme.parameters().take(6).fold([1.0, 1.0], |[a, b], v| {
        [a * 2.0 * v.powi(3) * (2.0 * v - 1.0) / (v + 1.0), b * 2.0 * v * v / (v + 1.0)]
    });
    let [a, b] = products;
    let refined = refine(scheme, &mesh, 6);
    let worst = refined
        .vertices
        .iter()
        .map(|[x, y, z]| (x * x + y * y + a / b * z * z - (0.5 * (a + b)).powi(2)).abs());
    assert!(worst.fold(0.0, f64::max) < 1e-14);
    // The rows of the sphere, with the first column again at the end: 18·4ᵏ + 9·2ᵏ + 1 points.
    for k in 0..9_u32 {
        let (rows, columns) = (3 * 2_usize.pow(k) + 1, 6 * 2_usize.pow(k) + 1);
        let table = [28, 91, 325, 1225, 4753, 18721, 74305, 296_065, 1_181_953];
        assert_eq!(rows * columns, table[k as usize]);
    }
    // The poles are open.
    let radius = refined.vertices[..6].iter().map(|[x, y, _]| x.hypot(*y)).fold(0.0, f64::max);
    assert!((radius - 0.16824).abs() < 1e-5, "{radius}");
}

/// The closed sphere grid: every linear scheme keeps it closed, outwards and once around.
#[test]
fn the_closed_sphere_grid_covers_the_sphere_once() {
    let schemes = [
        Scheme::Blob(Frequency::Real(exact(FRAC_PI_3))),
        Scheme::Loop(LoopWeights::Original),
        Scheme::Loop(LoopWeights::Simplified),
    ];
    for scheme in schemes {
        check_valences(scheme, &mesh_of("sphere_grid").connectivity().unwrap()).unwrap();
        let refined = refine(scheme, &mesh_of("sphere_grid"), 4);
        assert_eq!(refined.vertices.len(), 12 * 4_usize.pow(4) + 2);
        assert_eq!(refined.connectivity().unwrap().genus(), 0);
        let radii: Vec<f64> = refined.vertices.iter().map(|p| norm(*p)).collect();
        let [least, most] = [f64::min as fn(f64, f64) -> f64, f64::max]
            .map(|pick| radii.iter().copied().reduce(pick).unwrap());
        let ball = |radius: f64| 4.0 / 3.0 * PI * radius.powi(3);
        // A mesh between two spheres about the origin that covers them once encloses a volume between theirs.
        let volume: f64 = refined
            .faces
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|vertex| refined.vertices[vertex as usize]);
                (a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0]))
                    / 6.0
            })
            .sum();
        assert!(least > 0.3 && ball(0.99 * least) < volume && volume < ball(most), "{volume} {least} {most}");
    }
}

#[test]
fn sphericity_of_the_octahedron() {
    let document = load("subdivision/sphericity.json");
    for case in cases(&document) {
        let scheme = match text(&case["scheme"]) {
            "blob" => blob(&case["lambda"]),
            "loop" => Scheme::Loop(LoopWeights::Original),
            "loop_simplified_3_over_8n" => Scheme::Loop(LoopWeights::Simplified),
            other => panic!("unknown scheme {other}"),
        };
        for level in list(&case["levels"]) {
            let k = level["level"].as_u64().unwrap() as usize;
            let refined = refine(scheme, &mesh_of("octahedron"), k);
            assert_eq!(refined.vertices.len() as u64, level["vertices"].as_u64().unwrap());
            let radii: Vec<f64> = refined.vertices.iter().map(|p| norm(*p)).collect();
            let [least, most] = [f64::min as fn(f64, f64) -> f64, f64::max]
                .map(|pick| radii.iter().copied().reduce(pick).unwrap());
            let mean = radii.iter().sum::<f64>() / radii.len() as f64;
            for (found, name) in [(most - least, "eps"), (least, "r_min"), (most, "r_max"), (mean, "r_mean")]
            {
                assert!((found - number(&level[name])).abs() < 1e-12, "{name} of {case}");
            }
        }
    }
}

#[test]
fn overlap_equals_the_vectors() {
    let document = load("segmentation/overlap.json");
    let [size, spacing] = ["shape", "spacing_zyx"].map(|name| numbers(&document[name]));
    let grid = Grid {
        first: [0.0; 3],
        spacing: [0, 1, 2].map(|axis| spacing[axis]),
        size: [0, 1, 2].map(|axis| size[axis] as usize),
    };
    let [a, b] = ["a", "b"].map(|name| raster::Mask {
        grid,
        inside: text(&document[name]).bytes().map(|cell| cell == b'1').collect(),
    });
    let found = raster::overlap(&a, &b);
    let compared = [
        (found.jaccard, "jaccard"),
        (found.dice, "dice"),
        (found.hausdorff.unwrap(), "hausdorff"),
        (found.hausdorff_95.unwrap(), "hausdorff95"),
        (found.mean_surface_distance.unwrap(), "mean_surface_distance"),
    ];
    for (found, name) in compared {
        // The vectors have 13 decimals.
        assert!((found - number(&document[name])).abs() < 1e-12, "{name}: {found}");
    }
}

#[test]
fn invalid_meshes_are_refused_with_their_place() {
    let document = load("subdivision/invalid_meshes.json");
    let said = cases(&document).iter().map(|case| {
        let count = case["n_vertices"].as_u64().unwrap() as usize;
        let refused = Connectivity::new(count, faces(&case["faces"]))
            .map_err(GeometryError::from)
            .and_then(|connectivity| check_valences(pi_half(), &connectivity));
        refused.unwrap_err().to_string()
    });
    let said: Vec<String> = said.collect();
    let wanted = [
        "vertex 0 has 3 neighbours",
        "has no face on its other side",
        "vertex 0 has 5 neighbours",
        "both run from vertex",
        "vertex 6 belongs to no face",
    ];
    assert_eq!(said.len(), wanted.len());
    for (said, wanted) in said.iter().zip(wanted) {
        assert!(said.contains(wanted), "{said}");
    }
}

#[test]
fn gram_matrices_match() {
    let document = load("subdivision/gram.json");
    for case in cases(&document) {
        let scheme = match text(&case["scheme"]) {
            "loop" => Scheme::Loop(LoopWeights::Original),
            _ => blob(&case["lambda"]),
        };
        let level = case["levels"].as_u64().unwrap() as usize;
        let connectivity = ControlMesh::Faces(faces(&case["faces"]));
        let basis = SubdivisionBasis::new(&Subdivision { scheme, level, connectivity }).unwrap();
        let operator = basis.operator();
        assert_eq!(vec![operator.rows() as f64, operator.columns() as f64], numbers(&case["operator_shape"]));
        assert_eq!(operator.len() as f64, number(&case["operator_nonzeros"]));
        assert!((basis.gram().matrix() - matrix(&case["gram"])).amax() < 1e-11);
        let close = |found: f64, wanted: &Value| {
            let wanted = number(wanted);
            assert!((found - wanted).abs() < 1e-11 * wanted.abs().max(1.0), "{found} {wanted}");
        };
        let weights = basis.gram().matrix() * Matrix::from_element(6, 1, 1.0);
        for (found, wanted) in weights.iter().zip(list(&case["mean_weights"])) {
            close(*found, wanted);
        }
    }
}

#[test]
fn quantities_of_meshes_match() {
    let document = load("subdivision/quantities.json");
    for case in cases(&document) {
        let level = case["levels"].as_u64().unwrap() as usize;
        let control = points(&case["vertices"]);
        let connectivity = ControlMesh::Faces(faces(&case["faces"]));
        let basis =
            SubdivisionBasis::new(&Subdivision { scheme: blob(&case["lambda"]), level, connectivity })
                .unwrap();
        let mesh = basis.mesh(&rows(&control));
        let measures = measure(&mesh, true);
        let close = |found: f64, wanted: &Value| {
            let wanted = number(wanted);
            assert!((found - wanted).abs() < 1e-10 * wanted.abs().max(1.0), "{found} {wanted}");
        };
        let enclosed = measures.enclosed.unwrap();
        close(enclosed.signed_volume, &case["volume"]);
        close(measures.area, &case["area"]);
        assert!(
            apart(&[enclosed.centroid.unwrap()], &points(&serde_json::json!([case["volume_centroid"]])))
                < 1e-10
        );
        let normals = frames(&mesh);
        for (frame, wanted) in normals.iter().zip(points(&case["angle_weighted_normals_first6"])) {
            assert!(norm(minus(frame.normal.unwrap(), wanted)) < 1e-10);
        }
        // ∂V/∂C = T_Kᵀ ∂V/∂X, ∂V/∂a = Σ b × c / 6.
        let mut gradient = vec![[0.0; 3]; mesh.vertices.len()];
        let mut energy = 0.0;
        let gaussian = &case["energy"];
        let (sigma, centre) = (number(&gaussian["sigma"]), numbers(&gaussian["c"]));
        for face in &mesh.faces {
            let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
            for i in 0..3 {
                let part = cross(corners[(i + 1) % 3], corners[(i + 2) % 3]);
                (0..3).for_each(|c| gradient[face[i] as usize][c] += part[c] / 6.0);
            }
            let place = [0, 1, 2].map(|c| corners.iter().map(|p| p[c]).sum::<f64>() / 3.0 - centre[c]);
            let value = (-dot(place, place) / (2.0 * sigma * sigma)).exp();
            let slope = place.map(|x| -x / (sigma * sigma) * value);
            let sheet = cross(minus(corners[1], corners[0]), minus(corners[2], corners[0])).map(|x| 0.5 * x);
            energy -= dot(slope, sheet);
        }
        close(energy, &gaussian["centroid_rule"]);
        let mut by_control = vec![[0.0; 3]; 6];
        for (row, part) in basis.operator().iter().zip(&gradient) {
            row.iter().for_each(|(i, w)| (0..3).for_each(|c| by_control[*i as usize][c] += w * part[c]));
        }
        assert!(apart(&by_control, &points(&case["volume_gradient_wrt_control"])) < 1e-10);
        // Voxels, without tolerance.
        let voxels = &case["voxels"];
        let first = numbers(&voxels["first_centre"]);
        let size = numbers(&voxels["shape"]);
        let grid = Grid {
            first: [0, 1, 2].map(|c| first[c]),
            spacing: [number(&voxels["spacing"]); 3],
            size: [0, 1, 2].map(|c| size[c] as usize),
        };
        let (turn, by) = (matrix(&voxels["second_shape"]["R"]), numbers(&voxels["second_shape"]["t"]));
        let mut second = mesh.clone();
        second.vertices.iter_mut().for_each(|p| {
            *p = [0, 1, 2].map(|i| by[i] + (0..3).map(|j| turn[(i, j)] * p[j]).sum::<f64>());
        });
        let [a, b] = [&mesh, &second].map(|mesh| raster::from_mesh(mesh, &grid));
        let overlap = raster::overlap(&a, &b);
        assert_eq!(overlap.cells[0] as f64, number(&voxels["count"]));
        assert_eq!(overlap.cells[1] as f64, number(&voxels["second_shape"]["count"]));
        close(overlap.jaccard, &voxels["jaccard"]);
    }
}

fn normal_based() -> Scheme {
    Scheme::NormalBased { balance: exact(0.0) }
}

#[test]
fn curves_of_the_normal_based_scheme_match() {
    for file in ["normal_circle.json", "normal_curves.json"] {
        let document = load(&format!("subdivision/{file}"));
        let tolerance = number(&document["tolerance"]);
        for case in cases(&document) {
            let closed = case["closed"].as_bool().unwrap();
            let mut shape = Oriented { points: points(&case["points"]), normals: points(&case["normals"]) };
            for level in list(&case["levels"]) {
                shape = refine_polyline(&shape, closed, 0.0, |_| [0.0; 3]).unwrap();
                let wanted = points(&level["points"]);
                assert!(apart(&shape.points, &wanted) < tolerance * scale(&wanted), "{}", case["name"]);
                assert!(apart(&shape.normals, &points(&level["normals"])) < tolerance, "{}", case["name"]);
            }
        }
    }
}

#[test]
fn edges_of_the_normal_based_scheme_match() {
    let document = load("subdivision/normal_edges.json");
    let tolerance = number(&document["tolerance"]);
    let plain = cases(&document).iter().chain(list(&document["extension_cases"]));
    for case in plain {
        let [p0, n0, p1, n1] =
            ["p0", "n0", "p1", "n1"].map(|name| points(&serde_json::json!([case[name]]))[0]);
        let binormal = case.get("fallback").map(|axis| points(&serde_json::json!([axis]))[0]);
        let balance = case.get("balance").map_or(0.0, number);
        let found = split(p0, n0, p1, n1, balance, binormal);
        if case.get("expect").is_some_and(|expect| expect == "error") {
            assert!(found.is_err(), "{}", case["name"]);
            continue;
        }
        let (point, normal) = found.unwrap();
        let [wanted, direction] = ["point", "normal"].map(|name| points(&serde_json::json!([case[name]]))[0]);
        let ends = [p0, p1];
        assert!(norm(minus(point, wanted)) < tolerance * scale(&ends), "{}", case["name"]);
        assert!(norm(minus(normal, direction)) < tolerance, "{}", case["name"]);
    }
}

#[test]
fn meshes_of_the_normal_based_scheme_match() {
    for file in ["normal_spheres.json", "normal_meshes.json"] {
        let document = load(&format!("subdivision/{file}"));
        let tolerance = number(&document["tolerance"]);
        for case in cases(&document) {
            let mesh = oriented(case);
            for level in list(&case["levels"]) {
                let k = level["level"].as_u64().unwrap() as usize;
                let found = refine(normal_based(), &mesh, k);
                let wanted = points(&level["vertices"]);
                assert!(apart(&found.vertices, &wanted) < tolerance * scale(&wanted), "{}", case["name"]);
                assert!(apart(&found.normals.unwrap(), &points(&level["normals"])) < tolerance);
                assert_eq!(found.faces, faces(&level["faces"]));
            }
        }
        for similarity in document.get("similarities").map(list).unwrap_or_default() {
            let case = cases(&document).iter().find(|case| case["name"] == similarity["applies_to"]).unwrap();
            let (m, t) = (matrix(&similarity["matrix"]), numbers(&similarity["translation"]));
            let s = number(&similarity["scale"]);
            let mut mesh = oriented(case);
            let linear = |p: [f64; 3]| [0, 1, 2].map(|i| (0..3).map(|j| m[(i, j)] * p[j]).sum::<f64>());
            mesh.vertices.iter_mut().for_each(|p| *p = [0, 1, 2].map(|i| linear(*p)[i] + t[i]));
            mesh.normals.iter_mut().flatten().for_each(|n| *n = linear(*n).map(|x| x / s));
            let found = refine(normal_based(), &mesh, 1);
            let wanted = points(&similarity["level1_vertices"]);
            assert!(apart(&found.vertices, &wanted) < tolerance * scale(&wanted), "{}", similarity["name"]);
            assert!(apart(&found.normals.unwrap(), &points(&similarity["level1_normals"])) < tolerance);
        }
    }
}

fn oriented(case: &Value) -> TriangleMesh {
    TriangleMesh {
        vertices: points(&case["vertices"]),
        normals: Some(points(&case["normals"])),
        faces: faces(&case["faces"]),
    }
}

#[test]
fn default_normals_match() {
    let document = load("subdivision/normal_defaults.json");
    for case in list(&document["polygons"]) {
        let found = circle_normals(&points(&case["points"]), true);
        assert!(apart(&found, &points(&case["normals"])) < 1e-12, "{}", case["name"]);
    }
    for case in list(&document["meshes"]) {
        let mesh =
            TriangleMesh { vertices: points(&case["vertices"]), normals: None, faces: faces(&case["faces"]) };
        assert!(apart(&sphere_normals(&mesh), &points(&case["normals"])) < 1e-12, "{}", case["name"]);
    }
}

/// Circles and spheres come out exactly: rounding of the direction of an edge doubles with every level in the normals.
#[test]
fn circles_and_spheres_are_reproduced() {
    for count in [3, 4, 7] {
        let angle = |i: usize| 2.0 * PI * i as f64 / f64::from(count);
        let ring: Vec<[f64; 3]> =
            (0..count as usize).map(|i| [angle(i).cos(), angle(i).sin(), 0.0]).collect();
        let mut shape = Oriented { points: ring.clone(), normals: ring };
        for level in 1..=10 {
            shape = refine_polyline(&shape, true, 0.0, |_| [0.0; 3]).unwrap();
            let off = shape.points.iter().map(|p| (norm(*p) - 1.0).abs()).fold(0.0, f64::max);
            assert!(
                off < 1e-15 && apart(&shape.points, &shape.normals) < 1e-15 * f64::from(2 << level),
                "{off}"
            );
        }
    }
    for body in ["tetrahedron", "octahedron", "icosahedron"] {
        let mesh = mesh_of(body);
        let mesh = TriangleMesh { normals: Some(mesh.vertices.clone()), ..mesh };
        let found = refine(normal_based(), &mesh, 6);
        let off = found.vertices.iter().map(|p| (norm(*p) - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 1e-15, "{body}: {off}");
        assert!(apart(&found.normals.unwrap(), &found.vertices) < 1e-15 * 64.0, "{body}");
    }
}

/// What BLOB leads to, read off any level, is where a late level is.
#[test]
fn limits_of_blob_are_those_of_late_levels() {
    let mesh = mesh_of("octahedron");
    let bent: Vec<[f64; 3]> = mesh
        .vertices
        .iter()
        .enumerate()
        .map(|(i, [x, y, z])| [x + 0.3 * y, y + 0.1 * i as f64, z * 1.7])
        .collect();
    let mesh = TriangleMesh { vertices: bent, ..mesh };
    for scheme in [pi_half(), Scheme::Blob(Frequency::Imaginary(exact(3.0)))] {
        let late = refine(scheme, &mesh, 8);
        let normals = frames(&late);
        for level in 0..4 {
            let (_, limit) = refine_mesh(scheme, mesh.clone(), Depth::Level(level), 100_000, true).unwrap();
            let limit = limit.unwrap();
            let count = limit.points.len();
            // Vertices of level 8 are O(4⁻⁸) from their limit.
            assert!(apart(&limit.points, &late.vertices[..count]) < 2e-5, "{level}");
            for (found, frame) in limit.normals.unwrap().iter().zip(&normals) {
                assert!(norm(minus(*found, frame.normal.unwrap())) < 2e-3, "{level}");
            }
        }
        let (_, first) = refine_mesh(scheme, mesh.clone(), Depth::Level(1), 100_000, true).unwrap();
        let (_, second) = refine_mesh(scheme, mesh.clone(), Depth::Level(3), 100_000, true).unwrap();
        let [first, second] = [first, second].map(Option::unwrap);
        assert!(apart(&first.points, &second.points[..18]) < 1e-14);
        assert!(apart(&first.normals.unwrap(), &second.normals.unwrap()[..18]) < 1e-13);
    }
}

#[test]
fn butterflies_keep_their_vertices_and_reproduce_cubics() {
    let refined = refine(Scheme::Butterfly { tension: exact(0.0) }, &mesh_of("icosahedron/1"), 2);
    assert_eq!(refined.vertices[..42], mesh_of("icosahedron/1").vertices[..]);
    // Away from the seams of a large torus its grid is a plane.
    let side = 16;
    let cubic = |x: f64, y: f64| x.powi(3) - 2.0 * x * x * y + 0.5 * y.powi(3) - x + 1.0;
    let connectivity = Connectivity::new(side * side, torus(side, side)).unwrap();
    let grid: Vec<[f64; 3]> = (0..side * side)
        .map(|i| {
            let (x, y) = ((i / side) as f64 - 8.0, (i % side) as f64 - 8.0);
            [x, y, cubic(x, y)]
        })
        .collect();
    for tension in [0.0, 0.03] {
        let split = step(Scheme::Butterfly { tension: exact(tension) }, 1.0, &connectivity).apply(&grid);
        let found = in_grid(&connectivity, side, side, &split);
        let inside = |(place, _): &(usize, &[f64; 3])| {
            [place / (2 * side), place % (2 * side)].iter().all(|i| (8..24).contains(i))
        };
        let found: Vec<&[f64; 3]> = found.iter().enumerate().filter(inside).map(|(_, point)| point).collect();
        assert_eq!(found.len(), 16 * 16);
        for &[x, y, z] in found {
            assert!((cubic(x, y) - z).abs() < 1e-12 * z.abs().max(100.0), "{x} {y}");
        }
    }
}

#[test]
fn relabelled_control_meshes_have_relabelled_gram_matrices() {
    let turned = |i: u32| (i * 7 + 3) % 18;
    let mesh = mesh_of("octahedron/1");
    let faces: Vec<[u32; 3]> = mesh.faces.iter().map(|face| face.map(turned)).collect();
    let basis = |connectivity| {
        SubdivisionBasis::new(&Subdivision { scheme: pi_half(), level: 2, connectivity }).unwrap()
    };
    let (one, other) = (basis(named("octahedron/1")), basis(ControlMesh::Faces(faces)));
    let (one, other) = (one.gram().matrix(), other.gram().matrix());
    for i in 0..18_u32 {
        for j in 0..18_u32 {
            let found = other[(turned(i) as usize, turned(j) as usize)];
            assert!((one[(i as usize, j as usize)] - found).abs() < 1e-16);
        }
    }
    assert!((one.sum() - 1.0).abs() < 1e-14);
}

/// Rows of the operator, one at a time, and shapes through given points at their control vertices.
#[test]
fn rows_and_interpolation_belong_to_the_operator() {
    for scheme in [pi_half(), Scheme::Loop(LoopWeights::Original), Scheme::Butterfly { tension: exact(0.0) }]
    {
        let basis =
            SubdivisionBasis::new(&Subdivision { scheme, level: 3, connectivity: named("octahedron/1") })
                .unwrap();
        let operator = basis.operator();
        for vertex in [0, 17, 18, 300, 1025] {
            let mut dense = [0.0; 18];
            basis.weights(vertex).into_iter().for_each(|(i, w)| dense[i] += w);
            for (i, weight) in operator.row(vertex as usize) {
                dense[*i as usize] -= weight;
            }
            assert!(dense.iter().all(|x| x.abs() < 1e-15));
        }
        let wanted = rows(&mesh_of("octahedron/1").vertices);
        let points = basis.points(&wanted);
        let found = basis.interpolate(&rows(&points[..18])).unwrap();
        assert!((found - wanted).amax() < 1e-12);
    }
}

#[test]
fn levels_that_no_memory_holds_are_refused_before_it_is_taken() {
    for level in [9, 30, usize::MAX] {
        for scheme in [pi_half(), normal_based()] {
            let mesh = mesh_of("octahedron");
            let mesh = TriangleMesh { normals: Some(mesh.vertices.clone()), ..mesh };
            let refused = refine_mesh(scheme, mesh, Depth::Level(level), 300_000, false);
            assert!(matches!(refused, Err(GeometryError::TooFine { .. })), "{level}");
        }
    }
    let tolerance = Depth::Tolerance(1e-12);
    let refused = refine_mesh(pi_half(), mesh_of("octahedron"), tolerance, 300_000, false);
    assert!(matches!(refused, Err(GeometryError::Coarse { level: 8, .. })), "{refused:?}");
    let reached =
        refine_mesh(pi_half(), mesh_of("octahedron"), Depth::Tolerance(1e-3), 300_000, false).unwrap().0;
    assert!(reached.change.unwrap() <= 1e-3 && reached.level > 2, "{}", reached.level);
}

#[test]
fn loops_weights_are_published_ones() {
    assert!((loop_beta(LoopWeights::Original, 4) - 31.0 / 256.0).abs() < 1e-15);
    assert!((loop_beta(LoopWeights::Simplified, 4) - 3.0 / 32.0).abs() < 1e-15);
}

fn small() -> impl Strategy<Value = f64> {
    -2.0..2.0_f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// `S(CM + t) = S(C)M + t` for every matrix.
    #[test]
    fn blob_is_affine_invariant(
        control in proptest::collection::vec([small(), small(), small()], 6),
        m in [[small(), small(), small()], [small(), small(), small()], [small(), small(), small()]],
        t in [small(), small(), small()],
        start in 0.01..3.0_f64,
    ) {
        let scheme = Scheme::Blob(Frequency::Start(exact(start)));
        let map = |p: &[f64; 3]| [0, 1, 2].map(|i| t[i] + dot(m[i], *p));
        let mesh = TriangleMesh { vertices: control, ..mesh_of("octahedron") };
        let mapped = TriangleMesh { vertices: mesh.vertices.iter().map(map).collect(), ..mesh.clone() };
        let after: Vec<[f64; 3]> = refine(scheme, &mesh, 3).vertices.iter().map(map).collect();
        let before = refine(scheme, &mapped, 3).vertices;
        prop_assert!(apart(&after, &before) < 1e-14 * scale(&after).max(scale(&mesh.vertices)) * 20.0);
    }

    /// Rotations, reflections, scales and translations of points; normals turned along.
    #[test]
    fn the_normal_based_scheme_is_similarity_invariant(
        axis in [small(), small(), small()],
        angle in 0.0..6.0_f64,
        size in 0.1..10.0_f64,
        reflected in any::<bool>(),
        t in [small(), small(), small()],
        bumps in proptest::collection::vec([-0.05..0.05_f64, -0.05..0.05_f64, -0.05..0.05_f64], 12),
    ) {
        prop_assume!(norm(axis) > 0.1);
        let axis = axis.map(|x| x / norm(axis));
        let turn = |p: [f64; 3]| {
            let p = if reflected { p.map(|x| -x) } else { p };
            let (sine, cosine) = angle.sin_cos();
            let (side, along) = (cross(axis, p), dot(axis, p));
            [0, 1, 2].map(|i| cosine * p[i] + sine * side[i] + (1.0 - cosine) * along * axis[i])
        };
        let map = |p: [f64; 3]| { let p = turn(p); [0, 1, 2].map(|i| size * p[i] + t[i]) };
        let start = mesh_of("icosahedron");
        let unit = |p: [f64; 3]| p.map(|x| x / norm(p));
        let bumped = |(p, b): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|i| p[i] + b[i]);
        let vertices: Vec<[f64; 3]> = start.vertices.iter().zip(&bumps).map(bumped).collect();
        let normals = start.vertices.iter().zip(bumps.iter().rev()).map(|pair| unit(bumped(pair))).collect();
        let mesh = TriangleMesh { vertices, normals: Some(normals), faces: start.faces };
        let mapped = TriangleMesh {
            vertices: mesh.vertices.iter().copied().map(map).collect(),
            normals: mesh.normals.as_ref().map(|list| list.iter().copied().map(turn).collect()),
            faces: mesh.faces.clone(),
        };
        let depth = Depth::Level(3);
        let before = refine_mesh(normal_based(), mapped, depth, 10_000, false).unwrap().0.shape;
        let after = refine_mesh(normal_based(), mesh, depth, 10_000, false).unwrap().0.shape;
        let moved: Vec<[f64; 3]> = after.vertices.iter().copied().map(map).collect();
        // The rounding of a translated point is a part of the translation, over the sines of edges that are bent by 3° at least.
        prop_assert!(apart(&before.vertices, &moved) < 1e-13 * (size + norm(t)), "{}", apart(&before.vertices, &moved));
        let turned: Vec<[f64; 3]> = after.normals.unwrap().iter().copied().map(turn).collect();
        prop_assert!(apart(&before.normals.unwrap(), &turned) < 1e-11 * (1.0 + norm(t) / size));
    }
}
