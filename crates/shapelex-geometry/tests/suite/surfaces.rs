//! Surfaces against stored vectors, closed forms, quadrature and covariance laws.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::GeometryError;
use shapelex_geometry::capability::measure::mesh_flux;
use shapelex_geometry::generator::{Family, GeneratorKind, PoleList};
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis, Tangents};
use shapelex_geometry::surface::field::{AffineField, FieldTerm, PolynomialField, VectorField};
use shapelex_geometry::surface::fit::{SurfaceSample, fit, mesh_samples, spherical_parameters};
use shapelex_geometry::surface::ideal::IdealSurface;
use shapelex_geometry::surface::measures::{SurfaceMeasures, flux};
use shapelex_geometry::surface::parameterisation::spherical;
use shapelex_geometry::surface::seam::Seam;
use shapelex_geometry::surface::{Surface, Topology};
use shapelex_geometry::vector::{minus, norm};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::quadrature::GaussLegendre;

use crate::vectors::{self, list, load, number, numbers, text};

const TRIGONOMETRIC: GeneratorKind = GeneratorKind::Trigonometric {};
const KEYS: GeneratorKind = GeneratorKind::Cubic {};
const CUBIC: GeneratorKind = GeneratorKind::Bspline { degree: 3 };
const QUADRATIC: GeneratorKind = GeneratorKind::Bspline { degree: 2 };

fn basis(topology: Topology, seam: Seam, intervals: [usize; 2], kinds: [GeneratorKind; 2]) -> SurfaceBasis {
    SurfaceBasis::new(Extent { topology, intervals }, seam, &kinds).unwrap()
}

/// The surface through the values of `f` at the knots.
fn sampled(basis: &SurfaceBasis, f: impl Fn(f64, f64) -> [f64; 3], tangents: &Tangents) -> Matrix {
    let Extent { intervals, .. } = basis.extent();
    let [count_u, count_v] = basis.extent().grid();
    let points = Matrix::from_fn(count_u * count_v, 3, |i, c| {
        let (k, l) = (i / count_v, i % count_v);
        f(k as f64 / intervals[0] as f64, l as f64 / intervals[1] as f64)[c]
    });
    basis.interpolate(&points, tangents)
}

fn unit_sphere(u: f64, v: f64) -> [f64; 3] {
    let ((s, c), (sv, cv)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
    [c * sv, s * sv, cv]
}

fn kind_of(case: &Value, direction: &str) -> GeneratorKind {
    let poles = vectors::poles(&case[format!("poles_{direction}")]);
    let list: Vec<[f64; 2]> = poles.list();
    let family = match text(&case[format!("family_{direction}")]) {
        "6.2" => Family::IntegerShifts,
        _ => Family::HalfIntegerShifts,
    };
    GeneratorKind::Interpolator {
        family,
        poles: PoleList::on_grid(&list),
        support: None,
        weights: Vec::new(),
    }
}

/// The surfaces that the vectors name, by the first word of their id.
fn named(id: &str) -> fn(f64, f64) -> [f64; 3] {
    match id.split('_').next().unwrap() {
        "unit" => unit_sphere,
        "torus" => |u, v| {
            let ((s, c), (sv, cv)) = ((TAU * u).sin_cos(), (TAU * v).sin_cos());
            [(2.0 + 0.7 * cv) * c, (2.0 + 0.7 * cv) * s, 0.7 * sv]
        },
        "cylinder" => |u, v| [(TAU * u).cos(), (TAU * u).sin(), v],
        "plane" => |u, v| [u, v, u + 2.0 * v],
        "roman" => |u, v| {
            let ((s, c), r2) = ((TAU * u).sin_cos(), 9.0);
            let (double, single) = ((2.0 * TAU * v).sin(), (TAU * v).cos());
            [0.5 * r2 * c * double, 0.5 * r2 * s * double, r2 * c * s * single * single]
        },
        "helicoid" => |u, v| [(2.0 * v - 1.0) * (TAU * u).cos(), (2.0 * v - 1.0) * (TAU * u).sin(), u],
        "figure8" => |u, v| {
            let ((s, c), (sh, ch)) = ((TAU * u).sin_cos(), (PI * u).sin_cos());
            let (sv, s2v) = ((TAU * v).sin(), (2.0 * TAU * v).sin());
            let r = 3.0 + ch * sv - sh * s2v;
            [r * c, r * s, sh * sv + ch * s2v]
        },
        other => panic!("unknown surface {other}"),
    }
}

fn basis_of(case: &Value) -> SurfaceBasis {
    let id = text(&case["id"]);
    let (topology, seam) = match id.split('_').next().unwrap() {
        "unit" | "deformed" => (Topology::Sphere, Seam::Straight),
        "torus" => (Topology::Torus, Seam::Straight),
        "figure8" => (Topology::Torus, Seam::Reflected),
        "cylinder" => (Topology::Cylinder, Seam::Straight),
        _ => (Topology::Plane, Seam::Straight),
    };
    let count = |field: &str| case[field].as_u64().unwrap() as usize;
    basis(topology, seam, [count("M1"), count("M2")], [kind_of(case, "u"), kind_of(case, "v")])
}

fn vector3(value: &Value) -> [f64; 3] {
    numbers(value).try_into().unwrap()
}

/// The rows of a stored sphere: poles, tangents and the points between.
fn deformed(case: &Value, basis: &SurfaceBasis) -> Matrix {
    let free: Vec<Vec<[f64; 3]>> = list(&case["free_rows_l_1_to_M2_minus_1"])
        .iter()
        .map(|row| list(row).iter().map(vector3).collect())
        .collect();
    let [north, south] = ["c_north", "c_south"].map(|name| vector3(&case[name]));
    let tangents = Tangents {
        north: Some(["T1N", "T2N"].map(|name| vector3(&case[name]))),
        south: Some(["T1S", "T2S"].map(|name| vector3(&case[name]))),
    };
    let [count_u, count_v] = basis.extent().grid();
    let point = |k: usize, l: usize| match l {
        0 => north,
        _ if l == count_v - 1 => south,
        _ => free[k][l - 1],
    };
    let points = Matrix::from_fn(count_u * count_v, 3, |i, c| point(i / count_v, i % count_v)[c]);
    basis.interpolate(&points, &tangents)
}

#[test]
fn surfaces_equal_the_vectors() {
    let document = load("generators/surfaces.json");
    for case in vectors::cases(&document) {
        let id = text(&case["id"]);
        let basis = basis_of(case);
        let rows = match id {
            "deformed_sphere" => deformed(case, &basis),
            _ => sampled(&basis, named(id), &Tangents::default()),
        };
        let surface = basis.surface(&rows);
        for row in list(&case["rows"]) {
            let jet = surface.jet(number(&row[0]), number(&row[1]));
            let wanted: Vec<f64> = (2..8).flat_map(|i| numbers(&row[i])).collect();
            let largest = wanted.iter().fold(1.0, |m: f64, w| m.max(w.abs()));
            for (found, wanted) in jet.as_flattened().iter().zip(&wanted) {
                assert!((found - wanted).abs() <= 1e-11 * largest, "{id} {row}: {jet:?}");
            }
        }
        let field = AffineField { matrix: [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]], offset: [0.0; 3] }.into();
        let signed = surface.topology().orientation() * flux(&surface, &field, &|| false);
        let wanted = number(&case["signed_flux_volume"]);
        assert!((signed - wanted).abs() <= 1e-12 * wanted.abs().max(1.0), "{id}: flux {signed} for {wanted}");
        let mut gram = rows.clone();
        basis.gram().apply(gram.as_mut_slice());
        let (found, wanted) = (rows.dot(&gram), number(&case["l2_squared"]));
        assert!((found - wanted).abs() <= 1e-12 * wanted.max(1.0), "{id}: norm {found} for {wanted}");
        let measures = SurfaceMeasures::of(&surface);
        if !case["area"].is_null() {
            let (found, wanted) = (measures.area, number(&case["area"]));
            assert!((found - wanted).abs() <= 1e-10 * wanted, "{id}: area {found} for {wanted}");
            assert!(measures.area_error <= 1e-8 * wanted, "{id}: {}", measures.area_error);
        }
    }
}

#[test]
fn the_unit_sphere_is_exact_from_the_fewest_control_points() {
    for intervals in [[3, 2], [5, 4], [9, 9]] {
        let basis = basis(Topology::Sphere, Seam::Straight, intervals, [TRIGONOMETRIC; 2]);
        let surface = basis.surface(&sampled(&basis, unit_sphere, &Tangents::default()));
        let measures = SurfaceMeasures::of(&surface);
        let enclosed = measures.enclosed.unwrap();
        let volume = enclosed.signed_volume;
        assert!((volume - 4.0 * PI / 3.0).abs() < 1e-12, "{intervals:?}: {volume}");
        assert!((measures.area - 4.0 * PI).abs() < 1e-10, "{intervals:?}: {}", measures.area);
        assert!(enclosed.centroid.unwrap().iter().all(|c| c.abs() < 1e-12));
        let places = surface.parameters(1, 41);
        for (v, jet) in places.iter().zip(surface.jets(&[0.37], &places)) {
            let frame = surface.frame(*v, &jet);
            let normal = frame.normal.unwrap();
            let error = (0..3).map(|c| (normal[c] - unit_sphere(0.37, *v)[c]).abs()).fold(0.0, f64::max);
            assert!(error < 1e-12, "{intervals:?} at {v}: {normal:?}");
            if let Some(curvatures) = frame.curvatures {
                assert!(curvatures.iter().all(|k| (k + 1.0).abs() < 1e-7), "{v}: {curvatures:?}");
            }
        }
    }
}

#[test]
fn capped_cylinders_and_tori_enclose_what_they_should() {
    let tube = basis(Topology::Cylinder, Seam::Straight, [5, 3], [TRIGONOMETRIC, KEYS]);
    // Slanted lids: planes z = 0.2x and z = 2 + 0.5y − 0.1x over an ellipse with the half-axes 2 and 1.
    let f = |u: f64, v: f64| {
        let (x, y) = (7.0 + 2.0 * (TAU * u).cos(), (TAU * u).sin());
        [x, y, (1.0 - v) * 0.2 * x + v * (2.0 + 0.5 * y - 0.1 * x)]
    };
    let measures = SurfaceMeasures::of(&tube.surface(&sampled(&tube, f, &Tangents::default())));
    let enclosed = measures.enclosed.unwrap();
    let height = 2.0 - 0.3 * 7.0;
    assert!((enclosed.signed_volume - 2.0 * PI * height).abs() < 1e-12, "{enclosed:?}");
    let ring = basis(Topology::Torus, Seam::Straight, [4, 5], [TRIGONOMETRIC; 2]);
    let measures = SurfaceMeasures::of(&ring.surface(&sampled(&ring, named("torus"), &Tangents::default())));
    let enclosed = measures.enclosed.unwrap();
    assert!((enclosed.signed_volume - 2.0 * PI * PI * 2.0 * 0.49).abs() < 1e-12, "{enclosed:?}");
    assert!(enclosed.centroid.unwrap().iter().all(|c| c.abs() < 1e-12), "{enclosed:?}");
}

/// Spaces of every topology, seam and kind of generator.
fn spaces() -> Vec<SurfaceBasis> {
    let mut spaces = Vec::new();
    for topology in Topology::ALL {
        for kinds in [[TRIGONOMETRIC, TRIGONOMETRIC], [CUBIC, KEYS], [KEYS, CUBIC], [QUADRATIC, QUADRATIC]] {
            for intervals in [[5, 4], [6, 3], [4, 7]] {
                spaces.push(basis(topology, Seam::Straight, intervals, kinds.clone()));
            }
        }
    }
    for seam in [Seam::Reflected, Seam::HalfTurn] {
        for kinds in [[TRIGONOMETRIC, CUBIC], [CUBIC, KEYS]] {
            spaces.push(basis(Topology::Torus, seam, [5, 6], kinds));
        }
    }
    spaces
}

fn noise(basis: &SurfaceBasis, seed: u64) -> Matrix {
    let mut noise = crate::spaces::Noise(seed);
    Matrix::from_fn(basis.gram().size(), 3, |_, _| noise.next())
}

/// `∬ ⟨σ, τ⟩ du dv` by a rule on every half-interval.
fn inner(a: &Surface, b: &Surface) -> f64 {
    let rule = GaussLegendre::new(10);
    let nodes = |direction: usize| -> Vec<(f64, f64)> {
        let halves = 2 * a.intervals(direction);
        let node = |half: usize, (s, w): (f64, f64)| {
            ((half as f64 + 0.5 * (1.0 + s)) / halves as f64, 0.5 * w / halves as f64)
        };
        (0..halves).flat_map(|half| rule.points().map(move |p| node(half, p)).collect::<Vec<_>>()).collect()
    };
    let (u, v) = (nodes(0), nodes(1));
    let places = |nodes: &[(f64, f64)]| nodes.iter().map(|node| node.0).collect::<Vec<_>>();
    let values = |s: &Surface| s.points(&places(&u), &places(&v));
    let weights = u.iter().flat_map(|a| v.iter().map(move |b| a.1 * b.1));
    let products = values(a).into_iter().zip(values(b)).map(|(x, y)| x[0] * y[0] + x[1] * y[1] + x[2] * y[2]);
    weights.zip(products).map(|(weight, product)| weight * product).sum()
}

#[test]
fn the_gram_operator_is_the_integral_of_products() {
    for basis in spaces() {
        let what = (basis.extent(), basis.lines()[1].generator().support());
        let (a, b) = (noise(&basis, 1), noise(&basis, 2));
        let wanted = inner(&basis.surface(&a), &basis.surface(&b));
        let gram = basis.gram();
        let after = |x: &Matrix, operation: &dyn Fn(&mut [f64])| {
            let mut x = x.clone();
            operation(x.as_mut_slice());
            x
        };
        let found = a.dot(&after(&b, &|x| gram.apply(x)));
        assert!((found - wanted).abs() <= 1e-13 * a.norm() * b.norm(), "{what:?}: {found} for {wanted}");
        let product = after(&a, &|x| gram.whiten(x)).dot(&after(&b, &|x| gram.whiten(x)));
        assert!((product - wanted).abs() <= 1e-13 * a.norm() * b.norm(), "{what:?}: {product} for {wanted}");
        for operation in [
            &(|x: &mut [f64]| {
                gram.apply(x);
                gram.solve(x);
            }) as &dyn Fn(&mut [f64]),
            &|x: &mut [f64]| {
                gram.whiten(x);
                gram.unwhiten(x);
            },
        ] {
            let error = (after(&a, operation) - &a).abs().max();
            // Phantoms beyond open edges hardly matter within: their condition is 10³ in each direction.
            assert!(error < 1e-9, "{what:?}: {error}");
        }
    }
}

/// Backwards along `u`, everywhere: for mirror images.
#[test]
fn surfaces_run_backwards() {
    for basis in spaces() {
        let (forwards, closed) = (noise(&basis, 7), basis.extent().topology.closed()[0]);
        let mut backwards = forwards.clone();
        backwards.column_iter_mut().for_each(|mut column| basis.reverse(column.as_mut_slice()));
        let (a, b) = (basis.surface(&forwards), basis.surface(&backwards));
        for (u, v) in [(0.0, 0.3), (0.13, 0.0), (0.4, 0.71), (0.83, 0.95), (0.97, 1.0)] {
            // Twisted, −u is before the seam: u and v there are those of 1 − u, turned.
            let there = match (closed, u > 0.0) {
                (false, _) => [1.0 - u, v],
                (true, false) => [0.0, v],
                (true, true) => [1.0 - u, basis.seam().beyond(v)],
            };
            let apart = norm(minus(b.jet(u, v)[0], a.jet(there[0], there[1])[0]));
            assert!(apart < 1e-12, "{:?} {:?} at {u}, {v}: {apart}", basis.extent(), basis.seam());
        }
    }
}

#[test]
fn shapes_pass_through_their_points() {
    for basis in spaces() {
        let mut noise = crate::spaces::Noise(3);
        let [count_u, count_v] = basis.extent().grid();
        let sphere = basis.extent().topology.has_poles();
        let mut points = Matrix::from_fn(count_u * count_v, 3, |_, _| noise.next());
        if sphere {
            for k in 0..count_u {
                for l in [0, count_v - 1] {
                    let pole = points.row(l).into_owned();
                    points.set_row(k * count_v + l, &pole);
                }
            }
        }
        let surface = basis.surface(&basis.interpolate(&points, &Tangents::default()));
        let knots = [0, 1].map(|i| surface.parameters(i, [count_u, count_v][i]));
        for (i, point) in surface.points(&knots[0], &knots[1]).iter().enumerate() {
            for c in 0..3 {
                let (found, wanted) = (point[c], points[(i, c)]);
                assert!((found - wanted).abs() < 1e-12, "{:?}, {i}: {found} for {wanted}", basis.extent());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn spheres_stay_closed_and_smooth_however_they_are_deformed(seed in 0u64..1000, which in 0usize..12) {
        let basis = spaces().into_iter().filter(|basis| basis.extent().topology == Topology::Sphere).nth(which).unwrap();
        let surface = basis.surface(&noise(&basis, seed));
        for (pole, near) in [(0.0, 1e-7), (1.0, 1.0 - 1e-7)] {
            let places = surface.parameters(0, 7);
            let first = surface.points(&[0.0], &[pole])[0];
            let normal = surface.frame(pole, &surface.jet(0.1, pole)).normal.unwrap();
            for u in places {
                let point = surface.points(&[u], &[pole])[0];
                for c in 0..3 {
                    prop_assert!((point[c] - first[c]).abs() < 1e-12, "{point:?} {first:?}");
                }
                // Beside the pole the normal turns by the curvature times the distance.
                let beside = surface.frame(near, &surface.jet(u, near)).normal.unwrap();
                let cosine: f64 = (0..3).map(|c| beside[c] * normal[c]).sum();
                prop_assert!(cosine.abs() > 1.0 - 1e-6, "{u}: {beside:?} {normal:?}");
            }
        }
    }

    /// Any rows make a closed surface, whose tangents at the poles are those of the handles.
    #[test]
    fn sharp_spheres_stay_closed_however_they_are_deformed(seed in 0u64..1000, which in 0usize..12) {
        let sharp = |basis: &SurfaceBasis| basis.extent().topology == Topology::SharpSphere;
        let basis = spaces().into_iter().filter(sharp).nth(which).unwrap();
        let rows = noise(&basis, seed);
        let surface = basis.surface(&rows);
        let [count, along] = basis.extent().intervals;
        let kappa = (PI / along as f64).sin() / PI;
        let first = count * (along - 1);
        for (pole, v, inward) in [(0, 0.0, 1.0), (1, 1.0, -1.0)] {
            for u in surface.parameters(0, 7) {
                let point = surface.point(u, v);
                for c in 0..3 {
                    prop_assert!((point[c] - rows[(first + pole, c)]).abs() < 1e-12, "{point:?}");
                }
            }
            // Along u, the tangents are the surface line of the handles.
            for u in [0.0, 0.3, 0.77] {
                let [_, _, dv, ..] = surface.jet(u, v);
                let (half, s) = basis.lines()[0].locate(u);
                let (start, weights) = basis.lines()[0].weights(half, s, 0);
                let beyond = (basis.lines()[0].generator().support() - 1) / 2;
                let mut wanted = [0.0; 3];
                for (i, weight) in weights.enumerate() {
                    let k = (start + i + count * 4 - beyond) % count;
                    let handle = first + 2 + pole * count + k;
                    for (c, sum) in wanted.iter_mut().enumerate() {
                        *sum += weight * inward * (rows[(handle, c)] - rows[(first + pole, c)]) / kappa;
                    }
                }
                for c in 0..3 {
                    prop_assert!((dv[c] - wanted[c]).abs() < 1e-10, "{dv:?} {wanted:?}");
                }
            }
        }
    }

    #[test]
    fn affine_maps_of_the_rows_are_those_of_the_surface(seed in 0u64..1000, which in 0usize..64) {
        let basis = spaces().swap_remove(which);
        let rows = noise(&basis, seed);
        let mut noise = crate::spaces::Noise(seed + 1);
        let a = Matrix::from_fn(3, 3, |_, _| noise.next());
        let b = [noise.next(), noise.next(), noise.next()];
        let moved = &rows * a.transpose();
        let moved = Matrix::from_fn(rows.nrows(), 3, |i, c| moved[(i, c)] + b[c]);
        let (before, after) = (basis.surface(&rows), basis.surface(&moved));
        let place = ([0.123], [0.456]);
        let (p, q) = (before.points(&place.0, &place.1)[0], after.points(&place.0, &place.1)[0]);
        for c in 0..3 {
            let wanted: f64 = (0..3).map(|i| a[(c, i)] * p[i]).sum::<f64>() + b[c];
            prop_assert!((q[c] - wanted).abs() < 1e-12, "{} for {wanted}", q[c]);
        }
        if matches!(basis.extent().topology, Topology::Sphere | Topology::SharpSphere | Topology::Torus) && before.is_orientable() {
            let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let field = AffineField { matrix: identity, offset: [0.0; 3] }.into();
            let wanted = a.determinant() * flux(&before, &field, &|| false);
            let found = flux(&after, &field, &|| false);
            prop_assert!((found - wanted).abs() < 1e-11, "{found} for {wanted}");
        }
    }
}

#[test]
fn idealised_surfaces_are_exact_from_the_fewest_control_points() {
    for ideal in IdealSurface::catalogue() {
        assert_eq!(ideal.fault(), None);
        let fewest = ideal.fewest_intervals();
        for intervals in [fewest, fewest.map(|count| 2 * count), [12, 14]] {
            let basis = ideal.basis(intervals).unwrap();
            assert!(basis.reproduces_constants(), "{ideal:?}");
            let surface = basis.surface(&ideal.rows(&basis));
            let places: Vec<f64> = (0..23).map(|i| i as f64 / 23.0).collect();
            for (i, point) in surface.points(&places, &places).into_iter().enumerate() {
                let wanted = ideal.at(places[i / 23], places[i % 23]);
                for c in 0..3 {
                    let error = (point[c] - wanted[c]).abs();
                    assert!(error < 2e-13, "{ideal:?} {intervals:?}, {i}: {point:?} for {wanted:?}");
                }
            }
        }
    }
}

#[test]
fn meshes_of_surfaces_have_no_cracks_and_their_faces_look_outwards() {
    for ideal in IdealSurface::catalogue() {
        let basis = ideal.basis([12, 14]).unwrap();
        let surface = basis.surface(&ideal.rows(&basis));
        let mesh = surface.tessellate([40, 36]);
        let mut edges = std::collections::HashMap::new();
        for [a, b, c] in &mesh.faces {
            for edge in [[*a, *b], [*b, *c], [*c, *a]] {
                *edges.entry(edge).or_insert(0) += 1;
            }
        }
        let (topology, _) = ideal.topology();
        let border = edges.keys().filter(|[a, b]| !edges.contains_key(&[*b, *a])).count();
        let open = match topology {
            Topology::Sphere | Topology::SharpSphere | Topology::Torus => 0,
            Topology::Cylinder => 2 * 40,
            Topology::Plane => 2 * (39 + 35),
        };
        // Along the seam of a surface with one side faces that meet look to different sides.
        let wanted = if surface.is_orientable() { open } else { 36 };
        assert_eq!(border, wanted, "{ideal:?}");
        assert_eq!(mesh.normals.is_some(), surface.is_orientable());
        let characteristic =
            mesh.vertices.len() as i64 - 3 * mesh.faces.len() as i64 / 2 + mesh.faces.len() as i64;
        match topology {
            Topology::Sphere => assert_eq!(characteristic, 2, "{ideal:?}"),
            Topology::Torus => assert_eq!(characteristic, 0, "{ideal:?}"),
            _ => {}
        }
        if matches!(
            ideal,
            IdealSurface::Sphere { .. } | IdealSurface::Ellipsoid { .. } | IdealSurface::Torus { .. }
        ) {
            let volume = SurfaceMeasures::of(&surface).enclosed.unwrap().signed_volume;
            assert!(
                (mesh.signed_volume() / volume - 1.0).abs() < 0.02,
                "{ideal:?}: {}",
                mesh.signed_volume()
            );
        }
    }
}

#[test]
fn weights_are_those_of_the_surface_and_fits_give_back_its_rows() {
    for basis in spaces() {
        let rows = noise(&basis, 5);
        let surface = basis.surface(&rows);
        let (count_u, count_v) = (37, 41);
        let places = |count: usize| (0..count).map(|i| (i as f64 + 0.3) / count as f64).collect::<Vec<_>>();
        let (u, v) = (places(count_u), places(count_v));
        let points = surface.points(&u, &v);
        let mut samples = Vec::new();
        for (i, point) in points.into_iter().enumerate() {
            let parameters = [u[i / count_v], v[i % count_v]];
            let mut sum = [0.0; 3];
            for (row, weight) in basis.weights(parameters[0], parameters[1]) {
                (0..3).for_each(|c| sum[c] += weight * rows[(row, c)]);
            }
            assert!((0..3).all(|c| (sum[c] - point[c]).abs() < 1e-12), "{:?}", basis.extent());
            samples.push(SurfaceSample { parameters, point, weight: 1.0 + (i % 3) as f64 });
        }
        let fitted = fit(&basis, &samples).unwrap();
        assert!(fitted.largest < 1e-10, "{:?}: {}", basis.extent(), fitted.largest);
        // What is beyond open edges matters little within, and not at all where it is not seen.
        let error = (&fitted.rows - &rows).abs().max();
        assert!(error < 1e-7, "{:?}: {error}", basis.extent());
        let few = fit(&basis, &samples[..basis.gram().size() - 1]);
        assert!(matches!(few, Err(GeometryError::Undetermined { .. })), "{few:?}");
        // Within one interval four meridians of control points are seen, not the fifth.
        if basis.extent().intervals[0] < 5 {
            continue;
        }
        samples.iter_mut().for_each(|sample| sample.parameters[0] *= 0.15);
        let gap = fit(&basis, &samples);
        assert!(matches!(gap, Err(GeometryError::Undetermined { .. })), "{:?}", basis.extent());
    }
}

#[test]
fn directions_become_parameters() {
    for (direction, wanted) in [
        ([1.0, 0.0, 0.0], [0.0, 0.5]),
        ([0.0, 2.0, 0.0], [0.25, 0.5]),
        ([0.0, -3.0, 0.0], [0.75, 0.5]),
        ([0.0, 0.0, 1.0], [0.0, 0.0]),
        ([0.0, 0.0, -1.0], [0.0, 1.0]),
        ([1.0, -1e-300, 0.0], [0.0, 0.5]),
    ] {
        assert_eq!(spherical_parameters(direction), wanted, "{direction:?}");
    }
    let [u, v] = [0.3, 0.7];
    let found = spherical_parameters(unit_sphere(u, v));
    assert!((found[0] - u).abs() < 1e-15 && (found[1] - v).abs() < 1e-15, "{found:?}");
}

/// The mesh of a binary PLY of 32-bit positions and indices.
fn ply(path: &std::path::Path) -> Option<TriangleMesh> {
    let bytes = std::fs::read(path).ok()?;
    let end = bytes.windows(11).position(|window| window == b"end_header\n")? + 11;
    let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let count = |what: &str| -> usize {
        let line = head.lines().find(|line| line.starts_with(&format!("element {what} "))).unwrap();
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let (vertices, faces) = bytes[end..].split_at(12 * count("vertex"));
    let single = |at: &[u8]| f64::from(f32::from_le_bytes(at.try_into().unwrap()));
    let index = |at: &[u8]| u32::from_le_bytes(at.try_into().unwrap());
    let point = |row: &[u8]| [0, 1, 2].map(|c| single(&row[4 * c..4 * c + 4]));
    let face = |row: &[u8]| [0, 1, 2].map(|c| index(&row[1 + 4 * c..5 + 4 * c]));
    Some(TriangleMesh {
        vertices: vertices.chunks_exact(12).map(point).collect(),
        normals: None,
        faces: faces.chunks_exact(13).take(count("face")).map(face).collect(),
    })
}

#[test]
fn a_cortex_is_fitted_and_measured() {
    let folder =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/surfaces-fsaverage5");
    let read = |name: &str| ply(&folder.join(name));
    let (Some(sphere), Some(mesh)) = (read("left_sphere.ply"), read("left_inflated.ply")) else {
        eprintln!("SKIPPED: the surfaces of fsaverage5 are not here");
        return;
    };
    let parameters: Vec<[f64; 2]> =
        sphere.vertices.iter().map(|point| spherical_parameters(*point)).collect();
    let mut before = f64::INFINITY;
    for intervals in [[8, 6], [16, 14], [24, 24]] {
        let basis = basis(Topology::Sphere, Seam::Straight, intervals, [TRIGONOMETRIC; 2]);
        let fitted = fit(&basis, &on_faces(&basis, &mesh, &parameters)).unwrap();
        assert!(fitted.residual < before, "{intervals:?}: {}", fitted.residual);
        before = fitted.residual;
        if intervals == [24, 24] {
            let enclosed = SurfaceMeasures::of(&basis.surface(&fitted.rows)).enclosed.unwrap();
            let volume = enclosed.signed_volume / mesh.signed_volume();
            println!(
                "residual {:.3} mm, largest {:.3} mm, volume {volume:.4}",
                fitted.residual, fitted.largest
            );
            assert!((volume.abs() - 1.0).abs() < 0.002, "{volume}");
            assert!(fitted.residual < 1.0, "{}", fitted.residual);
        }
    }
}

/// Samples on the faces of a mesh.
fn on_faces(basis: &SurfaceBasis, mesh: &TriangleMesh, parameters: &[[f64; 2]]) -> Vec<SurfaceSample> {
    mesh_samples(basis, mesh, parameters).into_iter().map(|(_, sample)| sample).collect()
}

/// Over the ends of closed directions, through twisted seams, round poles: triangles are where their corners are near.
#[test]
fn meshes_of_idealised_surfaces_give_them_back() {
    for ideal in IdealSurface::catalogue() {
        let basis = ideal.basis(ideal.fewest_intervals().map(|count| count + count % 2)).unwrap();
        let surface = basis.surface(&ideal.rows(&basis));
        let count = [48, 41 + usize::from(basis.extent().topology.closed()[1])];
        let mesh = surface.tessellate(count);
        let [u, v] = [0, 1].map(|i| surface.parameters(i, count[i]));
        let inner = if surface.topology() == Topology::Sphere { &v[1..count[1] - 1] } else { &v[..] };
        let mut parameters: Vec<[f64; 2]> =
            u.iter().flat_map(|&u| inner.iter().map(move |&v| [u, v])).collect();
        if surface.topology() == Topology::Sphere {
            parameters.extend([[0.0, 0.0], [0.0, 1.0]]);
        }
        let fitted = fit(&basis, &on_faces(&basis, &mesh, &parameters)).unwrap();
        let middles: Vec<f64> = (0..31).map(|i| (f64::from(i) + 0.5) / 31.0).collect();
        let found = basis.surface(&fitted.rows).points(&middles, &middles);
        let pairs = found.iter().zip(surface.points(&middles, &middles));
        let apart = pairs.map(|(a, b)| norm(minus(*a, b))).fold(0.0, f64::max);
        let size = SurfaceMeasures::of(&surface).area.sqrt();
        // The flat faces of 48 round a circle are 0.2 % of its radius inside, larger ones of waves more.
        assert!(apart < 0.02 * size, "{ideal:?}: {apart} of {size}, residual {}", fitted.residual);
    }
}

/// A mesh of the surface, turned and stretched by `map`.
fn meshed(ideal: IdealSurface, map: impl Fn([f64; 3]) -> [f64; 3]) -> TriangleMesh {
    meshed_with(ideal, [48, 40], map)
}

fn meshed_with(ideal: IdealSurface, count: [usize; 2], map: impl Fn([f64; 3]) -> [f64; 3]) -> TriangleMesh {
    let basis = ideal.basis([12, 14]).unwrap();
    let mut mesh = basis.surface(&ideal.rows(&basis)).tessellate(count);
    mesh.vertices.iter_mut().for_each(|vertex| *vertex = map(*vertex));
    mesh
}

/// Largest errors of longitude (away from the poles) and colatitude on a round sphere, in turns and half turns.
fn errors_on_a_sphere(count: [usize; 2]) -> [f64; 2] {
    // z to y, y to x, x to z: the poles of the grid are not those of the parameters.
    let mesh = meshed_with(IdealSurface::Sphere { radius: 2.0 }, count, |[x, y, z]| [y, z, x]);
    let nearest = |wanted: [f64; 3]| {
        let distance = |i: &usize| (0..3).map(|c| (mesh.vertices[*i][c] - wanted[c]).powi(2)).sum::<f64>();
        (0..mesh.vertices.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap() as u32
    };
    let poles = [nearest([0.0, 0.0, 2.0]), nearest([0.0, 0.0, -2.0])];
    let axis = mesh.vertices[poles[0] as usize];
    assert!(axis[2] > 1.99, "{axis:?}");
    let parameters = spherical(&mesh, Some(poles)).unwrap();
    let (mut apart, mut worst) = (Vec::new(), 0.0_f64);
    for (vertex, [u, v]) in mesh.vertices.iter().zip(&parameters) {
        let [longitude, colatitude] = spherical_parameters(*vertex);
        worst = worst.max((v - colatitude).abs());
        if colatitude > 0.2 && colatitude < 0.8 {
            apart.push(u - longitude);
        }
    }
    let (sine, cosine) =
        apart.iter().fold((0.0, 0.0), |(s, c), a| (s + (TAU * a).sin(), c + (TAU * a).cos()));
    let offset = f64::atan2(sine, cosine) / TAU;
    let error = |a: &f64| ((a - offset + 0.5).rem_euclid(1.0) - 0.5).abs();
    [apart.iter().map(error).fold(0.0, f64::max), worst]
}

#[test]
fn on_a_round_sphere_the_parameters_are_longitude_and_colatitude() {
    let [coarse, fine] = [[48, 40], [96, 80]].map(errors_on_a_sphere);
    println!("{coarse:?} {fine:?}");
    for i in 0..2 {
        assert!(fine[i] < 0.6 * coarse[i], "{coarse:?} {fine:?}");
        assert!(fine[i] < 1e-2, "{coarse:?} {fine:?}");
    }
}

#[test]
fn meshes_without_longitude_are_refused() {
    let torus = meshed(IdealSurface::Torus { major_radius: 2.0, minor_radius: 0.7 }, |p| p);
    assert_eq!(spherical(&torus, None), Err(GeometryError::NotASphere { genus: 1 }));
    let tube = meshed(IdealSurface::Cylinder { radius: 1.0, height: 2.0 }, |p| p);
    assert!(matches!(spherical(&tube, None), Err(GeometryError::Mesh(_))));
    let sphere = meshed(IdealSurface::Sphere { radius: 2.0 }, |p| p);
    let count = sphere.vertices.len();
    for poles in [[3, 3], [3, 4], [3, 1 << 30], [1 << 30, 3]] {
        assert_eq!(spherical(&sphere, Some(poles)), Err(GeometryError::Poles { poles, count }));
    }
    let point = meshed(IdealSurface::Sphere { radius: 2.0 }, |_| [1.0; 3]);
    assert!(matches!(spherical(&point, None), Err(GeometryError::NoLength { .. })));
}

#[test]
fn long_shapes_and_hippocampi_are_parameterised_and_fitted() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/surfaces-hippocampus/meshes");
    let mut meshes = vec![(
        "banana".to_owned(),
        meshed(IdealSurface::Ellipsoid { semi_axes: [4.0, 1.5, 1.0] }, |[x, y, z]| [x, y + 0.15 * x * x, z]),
    )];
    let mut names: Vec<_> =
        std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    names.sort();
    if names.is_empty() {
        eprintln!("SKIPPED: the hippocampi are not here");
    }
    for path in names.iter().step_by(6) {
        meshes.push((path.file_stem().unwrap().to_string_lossy().into_owned(), ply(path).unwrap()));
    }
    // Knots that stand closer than the vertices: what lies between those must not run away.
    for (intervals, (name, mesh)) in
        [[14, 14], [20, 20]].into_iter().flat_map(|i| meshes.iter().map(move |m| (i, m)))
    {
        let basis = basis(Topology::Sphere, Seam::Straight, intervals, [TRIGONOMETRIC; 2]);
        let parameters = spherical(mesh, None).unwrap();
        assert!(parameters.iter().flatten().all(|value| (0.0..=1.0).contains(value)), "{name}");
        let fitted = fit(&basis, &on_faces(&basis, mesh, &parameters)).unwrap();
        let measures = SurfaceMeasures::of(&basis.surface(&fitted.rows));
        let size = mesh.signed_volume().cbrt();
        let ratio = measures.enclosed.unwrap().signed_volume / mesh.signed_volume();
        let beyond = (0..3)
            .map(|c| {
                let (low, high) =
                    mesh.vertices.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v[c]), b.max(v[c])));
                (low - measures.bounding_box[0][c]).max(measures.bounding_box[1][c] - high)
            })
            .fold(0.0, f64::max);
        println!(
            "{name} {intervals:?}: residual {:.4}, largest {:.4}, beyond the box {:.4} of the size, volume {ratio:.4}",
            fitted.residual / size,
            fitted.largest / size,
            beyond / size
        );
        // Smoothing what is curved takes some of the volume.
        assert!((ratio - 1.0).abs() < 0.01, "{name}: {ratio}");
        assert!(fitted.residual < 0.03 * size, "{name}: {}", fitted.residual / size);
        assert!(beyond < 0.05 * size, "{name}: {}", beyond / size);
    }
}

/// A polynomial field of twelve random terms up to `degree`, the first one of that degree.
fn random_field(degree: usize, seed: u64) -> Vec<FieldTerm> {
    let mut noise = crate::spaces::Noise(seed);
    let term = |i: usize| {
        let coefficients = [noise.next(), noise.next(), noise.next()];
        let mut share = |most: usize| ((0.5 + 0.5 * noise.next()) * (most + 1) as f64) as usize;
        let total = if i == 0 { degree } else { share(degree) };
        let first = share(total).min(total);
        let second = share(total - first).min(total - first);
        FieldTerm { powers: [first, second, total - first - second], coefficients }
    };
    (0..12).map(term).collect()
}

/// `div F` at a point.
fn divergence(terms: &[FieldTerm], point: [f64; 3]) -> f64 {
    let derivative = |term: &FieldTerm, c: usize| {
        let power = |i: usize| {
            let n = term.powers[i] as i32;
            if i == c { f64::from(n) * point[i].powi((n - 1).max(0)) } else { point[i].powi(n) }
        };
        term.coefficients[c] * power(0) * power(1) * power(2)
    };
    terms.iter().map(|term| (0..3).map(|c| derivative(term, c)).sum::<f64>()).sum()
}

/// `∭ g dV` of the body within the surface, by cones from the origin: `∯ ∫₀¹ t² g(t r) dt ⟨r, n⟩ dA`.
fn body_integral(surface: &Surface, g: impl Fn([f64; 3]) -> f64) -> f64 {
    let (rule, along_cones) = (GaussLegendre::new(26), GaussLegendre::new(6));
    let nodes = |direction: usize| -> Vec<(f64, f64)> {
        let halves = 2 * surface.intervals(direction);
        let node = |half: usize, (s, w): (f64, f64)| {
            ((half as f64 + 0.5 * (1.0 + s)) / halves as f64, 0.5 * w / halves as f64)
        };
        (0..halves).flat_map(|half| rule.points().map(move |p| node(half, p)).collect::<Vec<_>>()).collect()
    };
    let cone = |r: [f64; 3]| along_cones.integrate(0.0, 1.0, |t| t * t * g(r.map(|x| t * x)));
    let (u, v) = (nodes(0), nodes(1));
    let places: Vec<f64> = v.iter().map(|node| node.0).collect();
    let mut sum = 0.0;
    for (u, along) in u {
        for (jet, (_, across)) in surface.jets(&[u], &places).iter().zip(&v) {
            let [r, du, dv, ..] = *jet;
            let normal =
                [du[1] * dv[2] - du[2] * dv[1], du[2] * dv[0] - du[0] * dv[2], du[0] * dv[1] - du[1] * dv[0]];
            let through: f64 = (0..3).map(|c| r[c] * normal[c]).sum();
            sum += along * across * surface.topology().orientation() * cone(r) * through;
        }
    }
    sum
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Gauss: the flux of a polynomial field through a closed surface is the integral of its divergence over the body.
    #[test]
    fn fluxes_are_integrals_of_divergences(seed in 0u64..1000, which in 0usize..64, degree in 0usize..=8) {
        let basis = spaces().swap_remove(which);
        prop_assume!(matches!(basis.extent().topology, Topology::Sphere | Topology::SharpSphere | Topology::Torus));
        let surface = basis.surface(&noise(&basis, seed));
        prop_assume!(surface.is_orientable());
        let terms = random_field(degree, seed + 7);
        let field = VectorField::Polynomial(PolynomialField::new(terms.clone()).unwrap());
        let found = flux(&surface, &field, &|| false);
        let wanted = body_integral(&surface, |point| divergence(&terms, point));
        // Control points are random in a box of side 2, values of the field up to a hundred.
        prop_assert!((found - wanted).abs() <= 1e-11 * wanted.abs().max(100.0), "{found} for {wanted}");
    }
}

/// `F = (x³, y³, z³)`: `∭ 3r² dV = 12π/5` over the unit ball, and of degree 7 `∭ 7x⁶ dV = 4π/9`, also far from the origin.
#[test]
fn polynomial_fluxes_through_a_ball_are_known() {
    let ball = basis(Topology::Sphere, Seam::Straight, [5, 4], [TRIGONOMETRIC, TRIGONOMETRIC]);
    let rows = sampled(&ball, unit_sphere, &Tangents::default());
    let unit = |c: usize| [0, 1, 2].map(|i| f64::from(u8::from(i == c)));
    let term = |c: usize, power: usize| FieldTerm {
        powers: unit(c).map(|x| x as usize * power),
        coefficients: unit(c),
    };
    let cubes = PolynomialField::new((0..3).map(|c| term(c, 3)).collect()).unwrap();
    let seventh = PolynomialField::new(vec![term(0, 7)]).unwrap();
    for (field, wanted, far) in
        [(cubes, 12.0 * PI / 5.0, [2e3, -1e3, 5e2]), (seventh, 4.0 * PI / 9.0, [20.0, -10.0, 5.0])]
    {
        let found = flux(&ball.surface(&rows), &VectorField::Polynomial(field.clone()), &|| false);
        assert!((found - wanted).abs() < 1e-12, "{found} for {wanted}");
        // The field that has the same values about a ball elsewhere.
        let moved = Matrix::from_fn(rows.nrows(), 3, |i, c| rows[(i, c)] + far[c]);
        let there = VectorField::Polynomial(field).about(far.map(|x| -x));
        let found = flux(&ball.surface(&moved), &there, &|| false);
        assert!((found - wanted).abs() < 1e-4, "{found} for {wanted}: the field itself has lost digits");
    }
}

/// `F = (x²y, …)` through the faces of a tetrahedron: the integral of the divergence over the simplex is known.
#[test]
fn polynomial_fluxes_through_meshes_are_exact() {
    let mesh = TriangleMesh {
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        normals: None,
        faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    };
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    for powers in [[2, 0, 0], [2, 1, 0], [3, 2, 1], [1, 0, 7], [8, 0, 0], [0, 4, 4]] {
        let term = FieldTerm { powers, coefficients: [1.0, 0.0, 0.0] };
        let field = VectorField::Polynomial(PolynomialField::new(vec![term]).unwrap());
        // ∭ i x^{i−1} y^j z^k dV = i! j! k!/(i + j + k + 2)!
        let [i, j, k] = powers;
        let wanted =
            if i == 0 { 0.0 } else { factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 2) };
        let found = mesh_flux(&mesh, &field);
        assert!((found - wanted).abs() < 1e-15, "{powers:?}: {found} for {wanted}");
    }
}

/// A lemon, `4v(1 − v)` wide at the height `1 − 2v`, has cones at its poles: a sharp sphere contains it, a smooth one does not. Both
/// contain the ball.
#[test]
fn a_lemon_has_sharp_poles() {
    let lemon = |u: f64, v: f64| {
        let (sine, cosine) = (TAU * u).sin_cos();
        let radius = 4.0 * v * (1.0 - v);
        [radius * cosine, radius * sine, 1.0 - 2.0 * v]
    };
    let apart = |topology: Topology, kinds: [GeneratorKind; 2], f: &dyn Fn(f64, f64) -> [f64; 3]| {
        let basis = basis(topology, Seam::Straight, [6, 4], kinds);
        let surface = basis.surface(&sampled(&basis, f, &Tangents::default()));
        let places = (0..400).map(|i| [f64::from(i % 20) / 19.5, f64::from(i / 20) / 19.0]);
        let worst = places.map(|[u, v]| norm(minus(surface.point(u, v), f(u, v)))).fold(0.0, f64::max);
        (worst, surface)
    };
    let (exact, surface) = apart(Topology::SharpSphere, [TRIGONOMETRIC, KEYS], &lemon);
    assert!(exact < 1e-14, "{exact}");
    let volume = SurfaceMeasures::of(&surface).enclosed.unwrap().signed_volume;
    assert!((volume - 16.0 * PI / 15.0).abs() < 1e-12, "{volume}");
    assert_eq!(surface.frame(0.0, &surface.jet(0.3, 0.0)).normal, None);
    let mesh = surface.tessellate([24, 13]);
    let normals = mesh.normals.unwrap();
    let [north, south] = [2, 1].map(|i| normals[normals.len() - i]);
    assert!((north[2] - 1.0).abs() < 1e-12 && (south[2] + 1.0).abs() < 1e-12, "{north:?} {south:?}");
    let (smooth, _) = apart(Topology::Sphere, [TRIGONOMETRIC, KEYS], &lemon);
    assert!(smooth > 0.02, "{smooth}");
    let (ball, _) = apart(Topology::SharpSphere, [TRIGONOMETRIC, TRIGONOMETRIC], &unit_sphere);
    assert!(ball < 1e-14, "{ball}");
}
