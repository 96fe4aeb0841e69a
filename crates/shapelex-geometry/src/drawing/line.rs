//! Text of lines in a drawing, with as few points and digits as the eye needs.
//!
//! Coordinates are whole multiples of about a tenth of a pixel, and points nearer than that to the line through their neighbours are
//! left out: such a shift changes the grey of a pixel at the edge of a line by at most a tenth of the difference between line
//! and background, which cannot be seen between lines of a pixel or more. Points are written relative to the one before.

use std::fmt::Write;

/// Greatest shift of a point, in pixels.
const TOLERANCE: f64 = 0.1;
/// Greatest factor of the tolerance for faint lines: with a third of a pixel, corners do not show even where many lines overlap.
const FAINT: f64 = 3.0;

/// Place of a point on the page.
pub(super) trait Place: Fn(&[f64; 2]) -> [f64; 2] {}

impl<F: Fn(&[f64; 2]) -> [f64; 2]> Place for F {}

/// Resolution of a drawing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Resolution {
    /// Greatest shift of a point, in units of the page.
    tolerance: f64,
    /// Digits after the point of coordinates.
    digits: usize,
    /// `10^digits`.
    per_unit: f64,
}

impl Resolution {
    /// Resolution of a page on which a unit is shown as `pixels` pixels.
    pub(super) fn new(pixels: f64) -> Self {
        let tolerance = TOLERANCE / pixels;
        let fine = |digits: &usize| tolerance * power(*digits) >= FINEST;
        let digits = (0..MAX_DIGITS).find(fine).unwrap_or(MAX_DIGITS);
        Self { tolerance, digits, per_unit: power(digits) }
    }

    /// The resolution for lines of an opacity: the fainter a line, the less a shift of it is seen.
    pub(super) fn of_faint(&self, opacity: f64) -> Self {
        Self { tolerance: self.tolerance * (1.0 / opacity).clamp(1.0, FAINT), ..*self }
    }

    /// Appends the path through `points` at their places on the page; `Z` closes it.
    pub(super) fn push_path(&self, svg: &mut String, points: &[[f64; 2]], place: impl Place, closed: bool) {
        let kept = kept(&[points], &place, self.tolerance);
        self.push_points(svg, kept.iter().map(|&i| place(&points[i])), closed, false);
    }

    /// Appends the path through all of the few `points`, which bound an area.
    pub(super) fn push_polygon(&self, svg: &mut String, points: &[[f64; 2]], place: impl Place) {
        self.push_points(svg, points.iter().map(place), true, false);
    }

    /// Paths through `lines` of equal length, with the same commands each.
    pub(super) fn frames(&self, lines: &[Vec<[f64; 2]>], place: impl Place, closed: bool) -> Vec<String> {
        let kept = kept(lines, &place, self.tolerance);
        let frame = |line: &Vec<[f64; 2]>| {
            let mut path = String::new();
            self.push_points(&mut path, kept.iter().map(|&i| place(&line[i])), closed, true);
            path
        };
        lines.iter().map(frame).collect()
    }

    /// Number of points that [`Self::frames`] keeps of each of `lines`.
    pub(super) fn frame_points(&self, lines: &[Vec<[f64; 2]>], place: impl Place) -> usize {
        kept(lines, &place, self.tolerance).len()
    }

    /// Appends a path. Moves of length zero are left out unless `all` are wanted.
    fn push_points(&self, svg: &mut String, points: impl Iterator<Item = [f64; 2]>, closed: bool, all: bool) {
        let mut points = points.map(|point| point.map(|x| self.steps(x)));
        let Some(mut last) = points.next() else { return };
        svg.push('M');
        self.push_pair(svg, last, true);
        let mut first = true;
        for point in points {
            let [x, y] = [0, 1].map(|c| point[c] - last[c]);
            if !all && x == 0 && y == 0 {
                continue;
            }
            if first {
                svg.push('l');
            }
            self.push_pair(svg, [x, y], first);
            (first, last) = (false, point);
        }
        if closed {
            svg.push('Z');
        }
    }

    /// Number of steps of the resolution nearest to a coordinate; far off the page, an end of it.
    fn steps(&self, x: f64) -> i64 {
        (x * self.per_unit).round().clamp(-FAR, FAR) as i64
    }

    fn push_pair(&self, svg: &mut String, [x, y]: [i64; 2], follows_a_letter: bool) {
        if !follows_a_letter && x >= 0 {
            svg.push(' ');
        }
        self.push_number(svg, x);
        if y >= 0 {
            svg.push(' ');
        }
        self.push_number(svg, y);
    }

    /// Appends `value / per_unit` without idle zeros.
    fn push_number(&self, svg: &mut String, value: i64) {
        let write = "writing to a string cannot fail";
        if value < 0 {
            svg.push('-');
        }
        let (value, unit) = (value.unsigned_abs(), self.per_unit as u64);
        let (whole, part) = (value / unit, value % unit);
        if whole > 0 || part == 0 {
            write!(svg, "{whole}").expect(write);
        }
        if part > 0 {
            let digits = format!("{part:00$}", self.digits);
            write!(svg, ".{}", digits.trim_end_matches('0')).expect(write);
        }
    }

    /// A coordinate as text.
    pub(super) fn number(&self, x: f64) -> String {
        let mut text = String::new();
        self.push_number(&mut text, self.steps(x));
        text
    }
}

/// Least tolerance in steps of the last digit: rounding shifts a coordinate by half a step.
const FINEST: f64 = 0.66;

/// Greatest number of steps, far outside of every page.
const FAR: f64 = 1e12;

/// Maximum number of digits after the point.
const MAX_DIGITS: usize = 3;

fn power(digits: usize) -> f64 {
    10.0_f64.powi(digits as i32)
}

/// Positions of the points that are kept, the same on all `lines`, which have equal length: the first, the last, and those
/// between at which one of the lines turns, so that every other point is within `tolerance` of the line drawn instead.
///
/// Sklansky and Gonzalez, "Fast polygonal approximation of digitized curves" (1980): a segment grows while its end lies in all
/// cones that start at its beginning and touch the discs around the points passed. The cost is linear.
fn kept<L: AsRef<[[f64; 2]]>>(lines: &[L], place: impl Place, tolerance: f64) -> Vec<usize> {
    let count = lines.iter().map(|line| line.as_ref().len()).min().unwrap_or(0);
    let at = |line: &L, i: usize| place(&line.as_ref()[i]);
    let start = |i: usize| lines.iter().map(|line| Cone::at(at(line, i))).collect::<Vec<_>>();
    if count == 0 {
        return Vec::new();
    }
    let (mut kept, mut cones) = (vec![0], start(0));
    for i in 1..count {
        if !cones.iter().zip(lines).all(|(cone, line)| cone.admits(at(line, i))) {
            kept.push(i - 1);
            cones = start(i - 1);
        }
        for (cone, line) in cones.iter_mut().zip(lines) {
            cone.narrow(at(line, i), tolerance);
        }
    }
    if count > 1 {
        kept.push(count - 1);
    }
    kept
}

/// Directions from a point in which a line passes all points seen so far within the tolerance.
struct Cone {
    apex: [f64; 2],
    /// Unit vectors along its right and left side; none while every direction is admitted.
    sides: Option<[[f64; 2]; 2]>,
    /// Greatest distance of a point seen.
    reach: f64,
}

impl Cone {
    fn at(apex: [f64; 2]) -> Self {
        Self { apex, sides: None, reach: 0.0 }
    }

    /// Whether a segment from the apex to `point` passes all points seen.
    fn admits(&self, point: [f64; 2]) -> bool {
        let v = [0, 1].map(|c| point[c] - self.apex[c]);
        let ahead = |[right, left]: [[f64; 2]; 2]| {
            cross(right, v) >= 0.0 && cross(v, left) >= 0.0 && v[0] * right[0] + v[1] * right[1] > 0.0
        };
        self.sides.is_none_or(ahead) && norm(v) >= self.reach
    }

    /// Takes notice of `point`.
    fn narrow(&mut self, point: [f64; 2], tolerance: f64) {
        let v = [0, 1].map(|c| point[c] - self.apex[c]);
        let length = norm(v);
        self.reach = self.reach.max(length);
        if !(length > tolerance) {
            return;
        }
        let u = v.map(|x| x / length);
        let sine = tolerance / length;
        let cosine = (1.0 - sine * sine).sqrt();
        let turned = |sine: f64| [cosine * u[0] - sine * u[1], sine * u[0] + cosine * u[1]];
        let (mut right, mut left) = (turned(-sine), turned(sine));
        if let Some([old_right, old_left]) = self.sides {
            right = if cross(right, old_right) > 0.0 { old_right } else { right };
            left = if cross(old_left, left) > 0.0 { old_left } else { left };
        }
        self.sides = Some([right, left]);
    }
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn norm([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Distance of a point from a segment.
    fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
        let (v, w) = ([0, 1].map(|c| b[c] - a[c]), [0, 1].map(|c| p[c] - a[c]));
        let square = v[0] * v[0] + v[1] * v[1];
        let t = if square > 0.0 { ((v[0] * w[0] + v[1] * w[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
        norm([w[0] - t * v[0], w[1] - t * v[1]])
    }

    #[test]
    fn points_left_out_are_within_the_tolerance() {
        let curve = |f: fn(f64) -> [f64; 2]| (0..=800).map(|i| f(f64::from(i) / 800.0)).collect::<Vec<_>>();
        let lines = [
            curve(|t| [288.0 * (TAU * t).cos(), 288.0 * (TAU * t).sin()]),
            curve(|t| [300.0 * t, 20.0 * (40.0 * t).sin()]),
            // there and back on itself
            curve(|t| [100.0 * (TAU * t).sin(), 0.0]),
            curve(|t| [(300.0 * t).floor() * 0.04, (1000.0 * t * t).floor() * 0.05]),
        ];
        // A chord of a circle of radius r may have the length √(8 r · 0.1): here six samples.
        for (line, most) in lines.iter().zip([136, 250, 9, 90]) {
            let kept = kept(&[line], |p| *p, TOLERANCE);
            assert!(kept.len() <= most, "{} points", kept.len());
            for pair in kept.windows(2) {
                for p in pair[0]..pair[1] {
                    // A point passed at the end may lie beyond it by the width of its disc: the diagonal.
                    let far = distance(line[p], line[pair[0]], line[pair[1]]);
                    assert!(far <= TOLERANCE * 2.0_f64.sqrt() + 1e-9, "{far} at {p}");
                }
            }
        }
    }

    #[test]
    fn numbers_are_short_and_do_not_drift() {
        let path = |pixels: f64, points: &[[f64; 2]]| {
            let mut text = String::new();
            Resolution::new(pixels).push_polygon(&mut text, points, |p| *p);
            text
        };
        let points = [[10.0, -0.25], [10.44, 0.3], [10.88, 0.3], [10.88, 0.32], [0.0, 0.0]];
        assert_eq!(path(1.0, &points), "M10-.3l.4 .6 .5 0-10.9-.3Z");
        assert_eq!(path(2.0, &points), "M10-.25l.44 .55 .44 0 0 .02-10.88-.32Z");
        assert_eq!(path(0.1, &points), "M10 0l1 0-11 0Z");
    }

    #[test]
    fn frames_have_equal_commands() {
        let line =
            |bend: f64| (0..=64).map(|i| [f64::from(i), bend * f64::from(i * (64 - i)) / 64.0]).collect();
        let lines: Vec<Vec<[f64; 2]>> = vec![line(0.0), line(1.0), line(-1.0)];
        let resolution = Resolution::new(1.0);
        let frames = resolution.frames(&lines, |p| *p, false);
        let numbers = |path: &str| path.replace('-', " ").matches(' ').count();
        let points = resolution.frame_points(&lines, |p| *p);
        assert!(points > 5 && points < 40, "{points}");
        assert_eq!(frames.len(), 3);
        assert!(frames.iter().all(|path| numbers(path) <= 2 * points), "{frames:?}");
        assert!(resolution.frames(&[vec![], vec![]], |p| *p, true).iter().all(String::is_empty));
    }
}
