//! Curved outlines as points: ellipses, rounded corners and Bézier curves.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::super::record::Points;

/// Most by which a chord departs from the curve it stands for, in pixels: a hundredth is far below the precision of a pixel.
const TOLERANCE: f64 = 0.01;
/// Most points of a quarter of an ellipse, and most chords of a Bézier curve: enough for radii and lengths of 2¹⁶ pixels.
const MOST: f64 = 1024.0;

/// Number of chords of a quarter of a circle: one of angle `2α` departs by `r (1 − cos α) ≤ r α² / 2`.
fn chords(radius: f64) -> u16 {
    let half = (2.0 * TOLERANCE / radius.max(TOLERANCE)).sqrt();
    whole((FRAC_PI_2 / (2.0 * half)).ceil().max(4.0))
}

/// A small number of chords as an integer.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 1 … 1024 before")]
fn whole(count: f64) -> u16 {
    count.clamp(1.0, MOST) as u16
}

/// An ellipse within its bounds, from its right end by way of the lower one.
pub(super) fn ellipse(left: f64, top: f64, width: f64, height: f64) -> Points {
    rounded(left, top, width, height, width, height)
}

/// A rectangle whose corners are quarters of an ellipse with diameters `across` and `down`.
///
/// Where two arcs meet, their common point is not repeated.
pub(super) fn rounded(left: f64, top: f64, width: f64, height: f64, across: f64, down: f64) -> Points {
    let [rx, ry] = [across.min(width) / 2.0, down.min(height) / 2.0];
    let count = chords(rx.max(ry));
    let mut points = Points::new(2);
    let corners = [
        (left + width - rx, top + height - ry),
        (left + rx, top + height - ry),
        (left + rx, top + ry),
        (left + width - rx, top + ry),
    ];
    for (quarter, (x, y)) in (0_u16..).zip(corners) {
        for k in 0..=count {
            // Eight octants by symmetry would give ends such as cos π/2 exactly; a step of the whole circle does not.
            let angle = TAU * f64::from(quarter * count + k) / f64::from(4 * count);
            let [cosine, sine] = match k {
                0 => unit(quarter),
                _ if k == count => unit(quarter + 1),
                _ => [angle.cos(), angle.sin()],
            };
            let point = [x + rx * cosine, y + ry * sine];
            if points.rows().next_back() != Some(&point[..]) {
                points.push(&point);
            }
        }
    }
    points.open();
    points
}

/// Cosine and sine of a number of right angles.
fn unit(quarter: u16) -> [f64; 2] {
    match quarter % 4 {
        0 => [1.0, 0.0],
        1 => [0.0, 1.0],
        2 => [-1.0, 0.0],
        _ => [0.0, -1.0],
    }
}

/// Points of a Bézier curve of degree two or three after its first one, `controls[0]`.
///
/// With `n` chords each departs by at most `max |B''| / 8n²`, where `B''` is a combination of the second differences of the control
/// points times 2 (degree two) or 6 (degree three).
pub(super) fn bezier(controls: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let degree = controls.len().saturating_sub(1);
    let bend = controls
        .windows(3)
        .map(|p| (p[0][0] - 2.0 * p[1][0] + p[2][0]).hypot(p[0][1] - 2.0 * p[1][1] + p[2][1]))
        .fold(0.0, f64::max);
    let factor = if degree < 3 { 2.0 } else { 6.0 };
    let count = whole((factor * bend / (8.0 * TOLERANCE)).sqrt().ceil());
    (1..=count).map(move |k| {
        let last = controls.last().copied().unwrap_or_default();
        if k == count { last } else { at(controls, f64::from(k) / f64::from(count)) }
    })
}

/// The point at a parameter, by repeated interpolation (de Casteljau).
fn at(controls: &[[f64; 2]], t: f64) -> [f64; 2] {
    let mut row = [[0.0; 2]; 4];
    let count = controls.len().min(row.len());
    row[..count].copy_from_slice(&controls[..count]);
    for length in (1..count).rev() {
        for k in 0..length {
            row[k] = [0, 1].map(|i| row[k][i] + t * (row[k + 1][i] - row[k][i]));
        }
    }
    row[0]
}

#[cfg(test)]
mod tests {
    use super::super::super::objects::area;
    use super::*;

    #[test]
    fn ellipses_keep_their_ends_and_nearly_their_area() {
        let points = ellipse(97.0, 58.0, 34.0, 37.0);
        let (x, y): (Vec<f64>, Vec<f64>) = points.rows().map(|row| (row[0], row[1])).unzip();
        let ends = |x: &[f64]| {
            [x.iter().copied().fold(f64::MAX, f64::min), x.iter().copied().fold(f64::MIN, f64::max)]
        };
        assert_eq!((ends(&x), ends(&y)), ([97.0, 131.0], [58.0, 95.0]));
        let exact = TAU / 2.0 * 17.0 * 18.5;
        // The chords cut off less than the tolerance along the whole outline.
        let cut = exact - area(&points).abs();
        assert!(cut > 0.0 && cut < TOLERANCE * TAU * 18.5, "{cut}");
        assert!(ellipse(0.0, 0.0, 0.0, 0.0).len() == 1);
        assert!(ellipse(0.0, 0.0, 1e30, 1e30).len() <= 4096);
    }

    #[test]
    fn rounded_corners_are_within_their_rectangle() {
        let points = rounded(0.0, 0.0, 20.0, 10.0, 4.0, 4.0);
        let expected = 200.0 - (4.0 - TAU / 2.0) * 4.0;
        assert!((area(&points).abs() - expected).abs() < 0.1, "{}", area(&points));
        assert!(points.rows().all(|p| (0.0..=20.0).contains(&p[0]) && (0.0..=10.0).contains(&p[1])));
    }

    #[test]
    fn bezier_curves_are_near_and_end_exactly() {
        let quarter = 0.552_284_749_830_793_4;
        let controls = [[100.0, 0.0], [100.0, 100.0 * quarter], [100.0 * quarter, 100.0], [0.0, 100.0]];
        let points: Vec<[f64; 2]> = bezier(&controls).collect();
        assert_eq!(points.last(), Some(&[0.0, 100.0]));
        // This cubic departs from the circle by 2.8e-4 of its radius.
        assert!(points.iter().all(|[x, y]| (x.hypot(*y) - 100.0).abs() < 0.03));
        assert!(points.len() > 10);
        assert_eq!(bezier(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]).collect::<Vec<_>>(), [[2.0, 2.0]]);
    }
}
