//! One surface through the parallel contours of a region.

use serde_json::{Value, json};

use super::ear;
use super::plane::{Basis, FLAT_MM};
use super::regions::Contour;
use crate::error::{FileError, Place};
use crate::shape::limits::Limits;
use crate::shape::record::{Mesh, Points};

/// Most points of a contour that becomes an end cap: cutting off ears takes their square.
const MOST_CAP: usize = 4096;

/// A surface, and the warnings about it.
pub(super) struct Stack {
    pub(super) mesh: Mesh,
    pub(super) about: Value,
    pub(super) warning: Option<String>,
}

/// A contour of the stack.
struct Level {
    offset: f64,
    /// In the plane, counter-clockwise.
    plane: Vec<[f64; 2]>,
    /// Index of the first vertex.
    first: u32,
}

/// Joins the contours of neighbouring slices by triangles and closes both ends with flat caps.
///
/// The points of the contours are the vertices. Two neighbours are joined by the greedy method of Christiansen and Sederberg: both
/// are moved and scaled to one box, begin at the nearest pair of points, and each step adds the triangle with the shorter new side.
/// Normals point outwards. The surface ends in the planes of the first and the last contour.
///
/// # Errors
/// [`FaultKind::Unsupported`](crate::shape::FaultKind::Unsupported) of fewer than two slices, slices with several contours, and
/// contours at an end that cross themselves.
///
/// # Source
/// Christiansen and Sederberg 1978, *Conversion of complex contour line definitions into polygonal element mosaics*.
pub(super) fn surface(
    mut slices: Vec<(f64, Vec<&Contour>)>,
    basis: &Basis,
    limits: &Limits,
) -> Result<Stack, FileError> {
    slices.sort_by(|a, b| a.0.total_cmp(&b.0));
    check(&slices, basis)?;
    let total: usize = slices.iter().map(|slice| slice.1[0].points.len()).sum();
    limits.points(total as u64, || slices[0].1[0].place.clone())?;
    let mut mesh = Mesh { vertices: Points::new(3), ..Mesh::default() };
    let mut levels = Vec::new();
    for (offset, contours) in &slices {
        levels.push(level(*offset, contours[0], basis, &mut mesh)?);
    }
    for pair in levels.windows(2) {
        join(&pair[0], &pair[1], &mut mesh);
    }
    let ends = [
        (&levels[0], slices[0].1[0], true),
        (&levels[levels.len() - 1], slices[slices.len() - 1].1[0], false),
    ];
    for (level, contour, down) in ends {
        cap(level, down, &mut mesh).map_err(|detail| {
            let detail = format!("{detail} at {}", basis.slice(level.offset));
            FileError::unsupported(contour.place.clone(), detail)
        })?;
    }
    let gaps = levels.windows(2).map(|pair| pair[1].offset - pair[0].offset);
    let (least, most) =
        gaps.fold((f64::INFINITY, 0.0_f64), |(least, most), gap| (least.min(gap), most.max(gap)));
    let warning = (most - least > FLAT_MM)
        .then(|| format!("its slices are {least:.3} to {most:.3} mm apart; gaps are bridged like others"));
    let about = json!({ "slices": levels.len(), "spacing": [least, most], "normal": basis.normal });
    Ok(Stack { mesh, about, warning })
}

/// Two slices or more with one contour each: branches are not joined, and holes not cut out.
fn check(slices: &[(f64, Vec<&Contour>)], basis: &Basis) -> Result<(), FileError> {
    let mut others = slices.iter().filter(|(_, contours)| contours.len() != 1);
    if let Some((offset, contours)) = others.next() {
        let place = contours.first().map_or_else(Place::default, |contour| contour.place.clone());
        let more = match others.count() {
            0 => String::new(),
            count => format!("; further slices with another number: {count}"),
        };
        let (count, slice) = (contours.len(), basis.slice(*offset));
        let detail = format!("expected one contour in every slice, got {count} at {slice}{more}");
        return Err(FileError::unsupported(place, detail));
    }
    match slices {
        [(offset, contours)] => {
            let slice = basis.slice(*offset);
            let detail = format!("expected contours in at least two slices, got them only at {slice}");
            Err(FileError::unsupported(contours[0].place.clone(), detail))
        }
        [] => Err(FileError::unsupported(
            Place::default(),
            "expected contours in at least two slices, got none",
        )),
        _ => Ok(()),
    }
}

/// Adds the points of a contour to the vertices, counter-clockwise.
fn level(offset: f64, contour: &Contour, basis: &Basis, mesh: &mut Mesh) -> Result<Level, FileError> {
    let mut plane: Vec<[f64; 2]> =
        basis.project(&contour.points).rows().map(|row| [row[0], row[1]]).collect();
    let mut rows: Vec<&[f64]> = contour.points.rows().collect();
    if ear::signed_area(&plane) < 0.0 {
        plane.reverse();
        rows.reverse();
    }
    let first = u32::try_from(mesh.vertices.len()).map_err(|_| {
        FileError::too_large(contour.place.clone(), "expected fewer than 2³² vertices, got more")
    })?;
    for row in rows {
        mesh.vertices.push(row);
    }
    Ok(Level { offset, plane, first })
}

impl Level {
    /// Points moved and scaled so that the box of the contour is that from −1 to 1.
    fn unit(&self) -> Vec<[f64; 2]> {
        let bounds = |k: usize| {
            let values = || self.plane.iter().map(|point| point[k]);
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
        };
        let scales = [0, 1].map(|k| {
            let (low, high) = bounds(k);
            let half = 0.5 * high - 0.5 * low;
            (0.5 * low + 0.5 * high, if half > 0.0 { half } else { 1.0 })
        });
        let scaled = |point: &[f64; 2]| [0, 1].map(|k: usize| (point[k] - scales[k].0) / scales[k].1);
        self.plane.iter().map(scaled).collect()
    }

    /// Index of a vertex, counted around the contour.
    fn vertex(&self, k: usize) -> u32 {
        // The number of points was checked when they were added.
        self.first + u32::try_from(k % self.plane.len()).unwrap_or(0)
    }
}

/// Triangles between two neighbouring contours, `low` below `high`.
fn join(low: &Level, high: &Level, mesh: &mut Mesh) {
    let (p, q) = (low.unit(), high.unit());
    let (n, m) = (p.len(), q.len());
    let square = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    // The start of the lower contour, and the point of the upper one that is nearest to it.
    let start = (0..m).min_by(|a, b| square(p[0], q[*a]).total_cmp(&square(p[0], q[*b]))).unwrap_or(0);
    let (mut i, mut j) = (0, 0);
    while i < n || j < m {
        let along_low = square(p[(i + 1) % n], q[(start + j) % m]);
        let along_high = square(p[i % n], q[(start + j + 1) % m]);
        if j == m || (i < n && along_low <= along_high) {
            mesh.faces.push([low.vertex(i), low.vertex(i + 1), high.vertex(start + j)]);
            i += 1;
        } else {
            mesh.faces.push([low.vertex(i), high.vertex(start + j + 1), high.vertex(start + j)]);
            j += 1;
        }
    }
}

/// A flat cap, whose normal points down or up.
fn cap(level: &Level, down: bool, mesh: &mut Mesh) -> Result<(), String> {
    let count = level.plane.len();
    if count > MOST_CAP {
        return Err(format!("expected at most {MOST_CAP} points of a contour at an end, got {count}"));
    }
    let triangles = ear::triangles(&Points::from_rows(2, level.plane.concat()))
        .ok_or("expected contours at the ends that do not cross themselves, got one that does")?;
    for [a, b, c] in triangles {
        let [a, b, c] = [a, b, c].map(|k| level.first + k);
        mesh.faces.push(if down { [a, c, b] } else { [a, b, c] });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::regions::ContourKind;
    use super::*;

    fn contour(z: f64, points: &[[f64; 2]]) -> Contour {
        let points = Points::from_rows(3, points.iter().flat_map(|[x, y]| [*x, *y, z]).collect());
        Contour { kind: ContourKind::ClosedPlanar, points, number: 1, image: None, place: Place::default() }
    }

    fn stack(contours: &[Contour]) -> Result<Stack, FileError> {
        let all: Vec<&Contour> = contours.iter().collect();
        let basis = Basis::of(&all).expect("a plane");
        let slices = all.iter().map(|contour| (basis.offset(&contour.points), vec![*contour])).collect();
        surface(slices, &basis, &Limits::default())
    }

    /// Volume by the divergence theorem, after the check that every edge has its opposite.
    fn volume(mesh: &Mesh) -> f64 {
        let mut edges = BTreeMap::new();
        for face in mesh.faces.iter() {
            for k in 0..3 {
                *edges.entry((face[k], face[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        assert!(edges.iter().all(|((a, b), count)| *count == 1 && edges.get(&(*b, *a)) == Some(&1)));
        let rows: Vec<&[f64]> = mesh.vertices.rows().collect();
        let determinant = |face: [u32; 3]| {
            let [a, b, c] = face.map(|k| rows[k as usize]);
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        };
        mesh.faces.triangles().map(determinant).sum::<f64>() / 6.0
    }

    #[test]
    fn a_prism_has_its_volume() {
        let l = [[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        let mut reversed = l;
        reversed.reverse();
        reversed.rotate_left(2);
        // Clockwise and with another start in the middle, and unequal distances.
        let stack = stack(&[contour(7.0, &l), contour(1.0, &l), contour(2.0, &reversed)]).expect("a surface");
        let volume = volume(&stack.mesh);
        assert!((volume - 6.0 * 6.0).abs() < 1e-12, "{volume}");
        assert_eq!(stack.about["slices"], 3);
        assert!(stack.warning.is_some_and(|warning| warning.contains("1.000 to 5.000 mm")));
    }

    #[test]
    fn a_frustum_of_different_numbers_of_points_is_closed() {
        let ring = |count: u32, radius: f64| -> Vec<[f64; 2]> {
            let angle = |k: u32| f64::from(k) / f64::from(count) * std::f64::consts::TAU;
            (0..count).map(|k| [50.0 + radius * angle(k).cos(), radius * angle(k).sin()]).collect()
        };
        let stack =
            stack(&[contour(0.0, &ring(300, 2.0)), contour(3.0, &ring(170, 1.0))]).expect("a surface");
        let volume = volume(&stack.mesh);
        // πh(R² + Rr + r²)/3 of the cone, less the difference between circles and polygons (4e-4).
        let cone = std::f64::consts::PI * 7.0;
        assert!((volume / cone - 1.0).abs() < 2e-3, "{volume} {cone}");
        assert_eq!(stack.mesh.faces.len(), 2 * 470 - 4);
    }

    #[test]
    fn what_makes_no_surface_is_named() {
        let triangle = [[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]];
        let message = |contours: &[Contour]| stack(contours).map(|_| ()).expect_err("a fault").detail;
        assert_eq!(
            message(&[contour(0.0, &triangle)]),
            "expected contours in at least two slices, got them only at z = 0.000 mm"
        );
        let crossing = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 3.0]];
        let detail = message(&[contour(0.0, &triangle), contour(1.0, &crossing)]);
        let expected =
            "expected contours at the ends that do not cross themselves, got one that does at z = 1.000 mm";
        assert_eq!(detail, expected);
        let (a, b) = (contour(0.0, &triangle), contour(1.0, &triangle));
        let basis = Basis::of(&[&a, &b]).expect("a plane");
        let branches =
            |slices| surface(slices, &basis, &Limits::default()).map(|_| ()).expect_err("a fault").detail;
        assert_eq!(
            branches(vec![(0.0, vec![&a]), (1.0, vec![&b, &b])]),
            "expected one contour in every slice, got 2 at z = 1.000 mm"
        );
        assert_eq!(
            branches(vec![(0.0, vec![&a]), (1.0, vec![&b, &b]), (2.0, vec![&b, &b, &b])]),
            "expected one contour in every slice, got 2 at z = 1.000 mm; further slices with another number: 1"
        );
        let oblique = Basis { normal: [0.0, -0.6, 0.8], ..basis };
        assert_eq!(oblique.slice(2.5), "2.500 mm along (0.000, -0.600, 0.800)");
        assert_eq!(Basis { normal: [0.0, -1.0, 0.0], ..basis }.slice(-7.5), "y = 7.500 mm");
    }
}
