//! Drawing of an elastic match: two curves side by side, with lines between corresponding places.

use crate::elastic::space::ElasticMatch;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::layer::{Layer, Mark};
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_numeric::dense::Matrix;

/// Number of lines, about.
const LINES: usize = 40;
/// Gap between the curves, as a part of their width.
const GAP: f64 = 0.15;

/// Draws two curves at their matched places (`n × d` each), the second one in the pose of the first.
pub fn draw_match(points: &[Matrix; 2], closed: bool, found: &ElasticMatch) -> Drawing {
    let first = points[0].clone();
    let second = beside(&first, &posed(&points[1], found, &first));
    let lines: Vec<Matrix> = (0..first.nrows())
        .step_by(first.nrows().div_ceil(LINES))
        .map(|k| Matrix::from_rows(&[first.row(k), second.row(k)]))
        .collect();
    let mut links = line(&Matrix::zeros(0, first.ncols()), false, colour::BACK);
    links.lines = lines.iter().flat_map(|ends| line(ends, false, colour::BACK).lines).collect();
    links.width = 0.8;
    let starts = Matrix::from_rows(&[first.row(0), second.row(0)]);
    let layers = vec![
        links,
        line(&first, closed, colour::MAIN).named("first"),
        line(&second, closed, colour::PLUS).named("second"),
        Layer { mark: Mark::Dots, width: 3.0, ..line(&starts, false, colour::MAIN) },
    ];
    let samples = Entry::of(&layers);
    let mut words = vec![Entry::Text(format!("elastic distance {}", short(found.distance)))];
    words.extend(found.mirrored.then(|| Entry::Text("the second is mirrored".into())));
    layout::overlay("elastic match of two curves", layers, &samples).with_legend(&words)
}

fn line(points: &Matrix, closed: bool, colour: Colour) -> Layer {
    let rows: Vec<Vec<f64>> = points.row_iter().map(|row| row.iter().copied().collect()).collect();
    let points: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    Layer::from_polyline(&points, closed, colour)
}

/// The second curve, mirrored, turned and scaled to the length of the first one.
fn posed(points: &Matrix, found: &ElasticMatch, first: &Matrix) -> Matrix {
    let d = points.ncols();
    let length = |points: &Matrix| {
        (1..points.nrows()).map(|k| (points.row(k) - points.row(k - 1)).norm()).sum::<f64>()
    };
    let (wanted, own) = (length(first), length(points));
    let scale = if own > 0.0 { wanted / own } else { 1.0 };
    Matrix::from_fn(points.nrows(), d, |k, r| {
        let turned = |c: usize| {
            let sign = if found.mirrored && c == 0 { -1.0 } else { 1.0 };
            sign * found.rotation[r * d + c] * points[(k, c)]
        };
        scale * (0..d).map(turned).sum::<f64>()
    })
}

/// A curve moved to the right of another one, at the same height.
fn beside(first: &Matrix, second: &Matrix) -> Matrix {
    let range = |points: &Matrix, c: usize| {
        let column = points.column(c);
        (column.min(), column.max())
    };
    let mut moved = second.clone();
    for c in 0..first.ncols() {
        let ((low, high), (other_low, other_high)) = (range(first, c), range(second, c));
        let by = match c {
            0 => high + GAP * (high - low) - other_low,
            _ => 0.5 * (low + high - other_low - other_high),
        };
        moved.column_mut(c).iter_mut().for_each(|x| *x += by);
    }
    moved
}
