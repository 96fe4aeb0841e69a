//! Surfaces of labelled volumes.

use std::f64::consts::PI;

use shapelex_geometry::quality::MeshQuality;
use shapelex_numeric::bounded::never;
use shapelex_segmentation::SegmentationError;
use shapelex_segmentation::contours::{Components, Labels, Selection, Solid};
use shapelex_segmentation::frame::Frame;

/// Vertices of any test.
const MANY: usize = 1 << 22;

fn components(size: [usize; 3], labels: &[u32]) -> Components<3> {
    let labels = Labels::new(size, labels).expect("labels of the size");
    Components::find(&labels, &Selection::default(), &never).expect("a valid selection").expect("not stopped")
}

fn solids(size: [usize; 3], labels: &[u32], frame: &Frame<3>, blur: f64) -> Vec<Solid> {
    let found = components(size, labels);
    found.solids(frame, blur, MANY, &never).expect("valid settings").expect("not stopped")
}

/// Labels of the cells of a volume, from their indices.
fn volume(size: [usize; 3], label: impl Fn([f64; 3]) -> u32) -> Vec<u32> {
    let cell = |at: usize| [at % size[0], at / size[0] % size[1], at / size[0] / size[1]];
    (0..size.iter().product()).map(|at| label(cell(at).map(|index| index as f64))).collect()
}

fn total_volume(solid: &Solid) -> f64 {
    solid.outer.mesh.signed_volume()
        + solid.cavities.iter().map(|cavity| cavity.mesh.signed_volume()).sum::<f64>()
}

/// Checks that all surfaces are closed connected manifolds with the orientation and Euler number that they say.
fn check(solid: &Solid, what: &str) {
    for surface in std::iter::once(&solid.outer).chain(&solid.cavities) {
        let connectivity = surface.mesh.connectivity().unwrap_or_else(|fault| panic!("{fault}: {what}"));
        assert_eq!(connectivity.genus(), surface.genus(), "{what}");
    }
    assert!(solid.outer.mesh.signed_volume() > 0.0, "{what}");
    assert!(solid.cavities.iter().all(|cavity| cavity.mesh.signed_volume() < 0.0), "{what}");
}

/// Random labels below `count` (splitmix64).
fn random_labels(cells: usize, count: u64, seed: u64) -> Vec<u32> {
    let mut state = seed;
    let mut draw = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % count) as u32
    };
    (0..cells).map(|_| draw()).collect()
}

#[test]
fn one_cell_is_an_octahedron() {
    let labels = volume([4, 3, 3], |cell| u32::from(cell == [2.0, 1.0, 1.0]));
    let found = solids([4, 3, 3], &labels, &Frame::identity(), 0.0);
    let [solid] = &found[..] else { panic!("{found:?}") };
    check(solid, "a cell");
    assert_eq!((solid.outer.mesh.vertices.len(), solid.outer.mesh.faces.len()), (6, 8));
    // ⅓ · height · base of two pyramids on a square of area ½.
    assert!((solid.outer.mesh.signed_volume() - 1.0 / 6.0).abs() < 1e-15);
    assert_eq!((solid.component.faces, solid.component.border_faces), (6, 0));
}

/// A block loses an eighth of a cell per unit of its edges, and less at its corners, of which one cell has all:
/// `abc − (a + b + c − 3)/2 − 5/6` cells are left.
#[test]
fn blocks_have_their_volume_less_bevels() {
    let size = [9, 8, 7];
    let frames = [
        Frame::identity(),
        Frame::new([[0.5, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 3.0, 0.0]], [1.0, 2.0, 3.0]).unwrap(),
        Frame::new([[0.5, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.2, 3.0]], [1.0, 2.0, 3.0]).unwrap(),
    ];
    for [a, b, c] in [[1, 1, 1], [2, 1, 1], [3, 2, 1], [5, 4, 3], [9, 8, 7]] {
        let labels = volume(size, |[i, j, k]| u32::from(i < a as f64 && j < b as f64 && k < c as f64));
        for frame in &frames {
            let found = solids(size, &labels, frame, 0.0);
            check(&found[0], "a block");
            let expected = (a * b * c) as f64 - 0.5 * (a + b + c - 3) as f64 - 5.0 / 6.0;
            let volume = found[0].outer.mesh.signed_volume() / frame.determinant().abs();
            assert!((volume - expected).abs() < 1e-10, "{volume} for {expected}, {a} × {b} × {c}");
        }
        let border = [b * c, a * c, a * b].into_iter().zip([a == 9, b == 8, c == 7]);
        let border: usize = border.map(|(area, both)| area * (1 + usize::from(both))).sum();
        let found = solids(size, &labels, &frames[0], 0.0);
        assert_eq!(found[0].component.border_faces, border);
    }
}

#[test]
fn handles_cavities_and_touching_labels_are_told_apart() {
    let size = [24, 20, 13];
    let distance =
        |cell: [f64; 3], centre: [f64; 3]| (0..3).map(|c| (cell[c] - centre[c]).powi(2)).sum::<f64>().sqrt();
    let ring = volume(size, |[i, j, k]| {
        let around = (i - 11.0).hypot(j - 9.0) - 6.0;
        u32::from(around.hypot(k - 6.0) < 2.5)
    });
    let found = solids(size, &ring, &Frame::identity(), 0.0);
    check(&found[0], "a torus");
    assert_eq!((found.len(), found[0].outer.genus(), found[0].cavities.len()), (1, 1, 0));

    let shell = volume(size, |cell| {
        let to_centre = distance(cell, [9.0, 9.0, 6.0]);
        match () {
            () if distance(cell, [9.0, 11.0, 6.0]) < 1.2 || distance(cell, [9.0, 6.0, 6.0]) < 1.2 => 0,
            () if to_centre < 5.5 => 3,
            () if cell[0] > 13.0 && to_centre < 10.0 => 4,
            () => 0,
        }
    });
    let found = solids(size, &shell, &Frame::identity(), 0.0);
    found.iter().for_each(|solid| check(solid, "a shell"));
    let summary: Vec<(u32, usize, usize)> = found
        .iter()
        .map(|solid| (solid.component.label, solid.outer.genus(), solid.cavities.len()))
        .collect();
    assert!(summary.contains(&(3, 0, 2)), "{summary:?}");
    assert!(summary.iter().any(|(label, ..)| *label == 4), "{summary:?}");
}

/// Cells that meet at an edge or a corner only are components of their own.
#[test]
fn diagonal_neighbours_are_apart() {
    for other in [[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]] {
        let labels = volume([2, 2, 3], |cell| u32::from(cell == [0.0; 3] || cell == other));
        let found = solids([2, 2, 3], &labels, &Frame::identity(), 0.0);
        let names: Vec<usize> = found.iter().map(|solid| solid.component.number).collect();
        assert_eq!(names, [0, 1], "{other:?}");
    }
}

/// Surfaces of 150 random volumes are closed manifolds that do not meet themselves, and their Euler numbers are twice that of
/// the cells, `cells − pairs + blocks of 2 × 2 − blocks of 2 × 2 × 2`, each of one component, and one more for every cube that
/// only lacks two opposite corners: these are apart (`cases`).
#[test]
fn euler_numbers_follow_from_the_cells() {
    for seed in 0..150 {
        let size = [4 + (seed % 5) as usize, 3 + (seed % 4) as usize, 5];
        let labels: Vec<u32> = random_labels(size.iter().product(), 10, seed)
            .iter()
            .map(|draw| u32::from(u64::from(*draw) < 3 + seed % 6))
            .collect();
        let blur = [0.0, 0.5, 1.5][(seed % 3) as usize];
        let frame = Frame::new([[0.7, 0.0, 0.1], [0.0, 1.3, 0.0], [0.0, 0.0, 1.0]], [0.0; 3]).unwrap();
        let found = solids(size, &labels, &frame, blur);
        let counts = components(size, &labels).surface_counts(&never).unwrap();
        let (mut surfaces, mut vertices, mut triangles) = (0, 0, 0);
        for solid in &found {
            check(solid, &format!("seed {seed}"));
            for surface in std::iter::once(&solid.outer).chain(&solid.cavities) {
                surfaces += surface.euler;
                vertices += surface.mesh.vertices.len();
                triangles += surface.mesh.faces.len();
                let mesh = &surface.mesh;
                let measures = (Some(mesh.signed_volume()), mesh.face_areas().iter().sum());
                let quality = MeshQuality::of(mesh, measures, &mesh.faces, &never);
                assert_eq!(quality.self_intersecting, Some(false), "seed {seed}");
            }
        }
        assert_eq!((vertices, triangles), (counts.vertices, counts.triangles));
        assert_eq!(surfaces, 2 * euler_of_cells(size, &labels), "seed {seed}");
    }
}

/// Euler number of the cells of label 1.
fn euler_of_cells(size: [usize; 3], labels: &[u32]) -> i64 {
    let holds = |[i, j, k]: [usize; 3]| {
        i < size[0] && j < size[1] && k < size[2] && labels[(k * size[1] + j) * size[0] + i] == 1
    };
    let mut euler = 0;
    for at in 0..labels.len() {
        let cell = [at % size[0], at / size[0] % size[1], at / size[0] / size[1]];
        let corner = |bits: usize| holds(std::array::from_fn(|axis| cell[axis] + (bits >> axis & 1)));
        // Cells of dimension 0 to 3 that begin at this one, by the axes that they extend along.
        for axes in 0..8_usize {
            let full = (0..8).filter(|bits| bits & !axes == 0).all(corner);
            let sign = if axes.count_ones().is_multiple_of(2) { 1 } else { -1 };
            euler += if full { sign } else { 0 };
        }
        let opposite = |bits: usize| {
            !corner(bits) && !corner(7 - bits) && (0..8).filter(|c| *c != bits && *c != 7 - bits).all(corner)
        };
        let inside = (0..3).all(|axis| cell[axis] + 1 < size[axis]);
        euler += i64::from(inside && (0..4).any(opposite));
    }
    euler
}

/// Balls at 8 positions of the centre within a cell, the largest at one: mean deviation of the volume from the number of cells.
/// The values are those measured once; printed digits leave a margin of 2 in the last one.
#[test]
fn balls_have_their_volume_up_to_a_known_bias() {
    let (mut table, mut failed) = (String::new(), false);
    for (radius, blur, bias) in [
        (3.0, 0.0, -6.54),
        (3.0, 0.5, -12.21),
        (3.0, 1.0, -28.07),
        (10.0, 0.0, -21.73),
        (10.0, 0.5, -40.89),
        (10.0, 1.0, -113.32),
        (40.0, 0.0, -88.50),
        (40.0, 0.5, -164.57),
    ] {
        let side = 2 * radius as usize + 4;
        let shifts = if radius > 20.0 { 1 } else { 8 };
        let (mut mean, mut relative) = (0.0, 0.0);
        for shift in 0..shifts {
            let centre: [f64; 3] =
                std::array::from_fn(|c| radius + 1.0 + 0.5 * f64::from(shift >> c & 1) + 0.1);
            let inside =
                |cell: [f64; 3]| (0..3).map(|c| (cell[c] - centre[c]).powi(2)).sum::<f64>() < radius * radius;
            let labels = volume([side; 3], |cell| u32::from(inside(cell)));
            let found = solids([side; 3], &labels, &Frame::identity(), blur);
            let volume = total_volume(&found[0]);
            mean += (volume - found[0].component.cells as f64) / f64::from(shifts);
            relative += (volume / (4.0 / 3.0 * PI * f64::powi(radius, 3)) - 1.0) / f64::from(shifts);
        }
        table +=
            &format!("R {radius:4} σ {blur}: {mean:+.2} cells, {:+.3} % of the ball\n", 100.0 * relative);
        failed |= !((mean - bias).abs() < 0.02);
    }
    assert!(!failed, "{table}");
}

#[test]
fn sizes_are_checked_and_work_is_stopped() {
    let labels = volume([3, 3, 3], |cell| u32::from(cell == [1.0; 3]));
    let found = components([3, 3, 3], &labels);
    let frame = Frame::identity();
    assert_eq!(found.solids(&frame, 0.0, 5, &never), Err(SegmentationError::Vertices { most: 5, found: 6 }));
    assert!(matches!(found.solids(&frame, 9.0, 6, &never), Err(SegmentationError::BlurOfMask { .. })));
    assert_eq!(found.solids(&frame, 0.0, 6, &|| true), Ok(None));
    assert_eq!(found.surface_counts(&|| true), None);
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let size = [17, 13, 9];
    let labels = random_labels(size.iter().product(), 3, 9);
    for blur in [0.0, 0.6] {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| solids(size, &labels, &Frame::identity(), blur))
        };
        assert!(on(1) == on(4), "blur {blur}");
    }
}

fn filled(found: &Components<3>, id: usize) -> Solid {
    let solid = found.filled(id, &Frame::identity(), 0.0, MANY, &never);
    solid.expect("valid settings").expect("not stopped")
}

/// A ring of square section, also along the edge of the volume: one film closes it.
#[test]
fn a_handle_is_filled_by_a_film() {
    for first in [0.0, 2.0] {
        let far = |x: f64| (x - first - 3.0).abs();
        let ring = |[i, j, k]: [f64; 3]| {
            u32::from((2.0..4.0).contains(&far(i).max(far(j)).floor()) && (k - first).abs() < 3.0)
        };
        let labels = volume([10, 10, 8], ring);
        let found = components([10, 10, 8], &labels);
        let solid = filled(&found, 0);
        check(&solid, "a filled ring");
        let open = &found.solids(&Frame::identity(), 0.0, MANY, &never).unwrap().unwrap()[0];
        assert_eq!((open.outer.genus(), solid.outer.genus()), (1, 0));
        assert_eq!(solid.component, found.list()[0]);
        // The film has 3 × 3 cells, of 3 or 5 layers.
        let added = solid.outer.mesh.signed_volume() - total_volume(open);
        assert!((8.0..14.0).contains(&added), "{added}");
    }
}

/// Noise has handles, cavities and pieces that touch at corners and edges; what is filled encloses all of it.
#[test]
fn noise_is_filled_without_handles() {
    let size = [9, 8, 7];
    for seed in 0..30 {
        let noise = random_labels(9 * 8 * 7, 5, seed);
        let labels: Vec<u32> = noise.iter().map(|value| u32::from(*value > 1)).collect();
        let found = components(size, &labels);
        for (id, component) in found.list().iter().enumerate() {
            let solid = filled(&found, id);
            let what = format!("seed {seed}, component {id} of {} cells", component.cells);
            check(&solid, &what);
            assert_eq!((solid.outer.genus(), solid.cavities.len()), (0, 0), "{what}");
        }
    }
}

#[test]
fn a_filled_component_is_placed_as_before() {
    let labels = volume([6, 5, 4], |[i, j, k]| u32::from(i > 2.0 && j > 1.0 && k > 1.0));
    let frame = Frame::new([[0.5, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.2, -3.0]], [1.0, 2.0, 3.0]).unwrap();
    let found = components([6, 5, 4], &labels);
    for blur in [0.0, 0.4] {
        let whole = &found.solids(&frame, blur, MANY, &never).unwrap().unwrap()[0];
        let solid = found.filled(0, &frame, blur, MANY, &never).unwrap().unwrap();
        let [a, b] = [whole, &solid].map(|solid| solid.outer.mesh.signed_volume());
        assert!((a - b).abs() < 1e-5 * a, "{a} {b}");
        assert_eq!(whole.outer.mesh.vertices.len(), solid.outer.mesh.vertices.len());
    }
}

#[test]
fn open_ends_have_no_sides_on_the_edge() {
    let labels = [1; 24];
    let sides = |open| {
        let labels = Labels::<3>::new([2, 3, 4], &labels).unwrap().with_open_ends(open);
        let found = Components::find(&labels, &Selection::default(), &never).unwrap().unwrap();
        (found.list()[0].border_faces, found.list()[0].faces)
    };
    assert_eq!((sides(false), sides(true)), ((52, 52), (40, 52)));
}
