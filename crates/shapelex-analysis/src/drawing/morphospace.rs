//! Shapes as points in the plane of two components, in groups.

use super::View;
use super::completed::ellipse;
use shapelex_geometry::drawing::colour;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scatter::{Cloud, Shown, convex_hull, scatter};
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_numeric::dense::Matrix;

/// Line about the points of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Outline {
    /// None.
    None,
    /// The least convex polygon with all points of the group.
    Hull,
    /// The ellipse that holds 95 % of a normal distribution with the mean and covariance of the group.
    #[default]
    Ellipse,
}

/// Squared radius that holds 95 % of a standard normal distribution in the plane: −2 ln 0.05.
const ELLIPSE: f64 = 5.991_464_547_107_982;
/// Fewest points of a group that has an outline.
const FEWEST: usize = 3;

/// A group of shapes with two scores each.
#[derive(Debug, Clone, PartialEq)]
pub struct ScoredGroup {
    /// Its name.
    pub name: String,
    /// Scores of its shapes.
    pub scores: Vec<[f64; 2]>,
}

/// Draws groups of shapes by two scores. `axes` are names of the components; `shapes` are the control points at the left, right, lower and
/// upper end, in the pose of the mean.
pub fn draw_morphospace(
    view: &View<'_>,
    title: &str,
    axes: [String; 2],
    groups: Vec<ScoredGroup>,
    outline: Outline,
    shapes: Option<&[Vec<f64>; 4]>,
    notes: &[Entry],
) -> Drawing {
    let clouds = groups.into_iter().map(|ScoredGroup { name, scores }| {
        let outline = match outline {
            Outline::None => Vec::new(),
            _ if scores.len() < FEWEST => Vec::new(),
            Outline::Hull => convex_hull(&scores),
            Outline::Ellipse => ellipse_of(&scores),
        };
        let name = format!("{name} ({})", scores.len());
        Cloud { name, points: scores, outline }
    });
    let shown = |shape: &Vec<f64>| -> Shown { vec![view.layer([shape.as_slice()], colour::MAIN, 1.5, 1.0)] };
    let shapes = shapes.map(|shapes| shapes.each_ref().map(shown));
    scatter(title, axes, clouds.collect(), shapes, notes)
}

/// The ellipse of 95 % of points, with their covariance divided by `n − 1`.
fn ellipse_of(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let count = points.len() as f64;
    let mean = [0, 1].map(|c| points.iter().map(|p| p[c]).sum::<f64>() / count);
    let product = |a: usize, b: usize| {
        points.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>() / (count - 1.0)
    };
    ellipse(mean, &Matrix::from_fn(2, 2, product), ELLIPSE.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ellipse_has_one_mahalanobis_radius() {
        let points: Vec<[f64; 2]> = (0..40)
            .map(|k| {
                let t = f64::from(k);
                [3.0 + (1.7 * t).sin(), 1.0 + 0.8 * (1.7 * t).sin() + 0.3 * (2.9 * t).cos()]
            })
            .collect();
        let corners = ellipse_of(&points);
        let mean = [0, 1].map(|c| points.iter().map(|p| p[c]).sum::<f64>() / 40.0);
        let s = |a: usize, b: usize| {
            points.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>() / 39.0
        };
        let (xx, xy, yy) = (s(0, 0), s(0, 1), s(1, 1));
        for [x, y] in corners {
            let (x, y) = (x - mean[0], y - mean[1]);
            let radius = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
            assert!((radius / ELLIPSE - 1.0).abs() < 1e-10, "{radius}");
        }
        assert!(ellipse_of(&[[1.0, 2.0]; 5]).iter().all(|p| *p == [1.0, 2.0]));
    }
}
