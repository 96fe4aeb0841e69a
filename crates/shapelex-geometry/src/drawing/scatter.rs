//! Points in a plane of two scores, in groups, with the shapes at the ends of the axes: a morphospace.

use super::colour::{Colour, GROUPS};
use super::layer::{Layer, Mark};
use super::layout::Bounds;
use super::legend::Entry;
use super::plot::{Frame, PAGE, label, range};
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE};

/// A group of points.
#[derive(Debug, Clone)]
pub struct Cloud {
    /// Name in the legend.
    pub name: String,
    /// The points.
    pub points: Vec<[f64; 2]>,
    /// A closed line about them; empty if there is none.
    pub outline: Vec<[f64; 2]>,
}

/// A shape of which layers show the parts, back to front.
pub type Shown = Vec<Layer>;

/// Least and largest height of the frame.
const HEIGHTS: [f64; 2] = [220.0, 520.0];
/// Room for a shape beside the frame.
const SHAPE: f64 = 84.0;
/// Room for the numbers of an axis.
const NUMBERS: f64 = 40.0;
/// Part of the range of the points that is left free on each side.
const FREE: f64 = 0.06;
/// Width of a dot's line; its radius is larger.
const DOT: f64 = 1.5;

/// The colour of the group with this number. Groups beyond the last colour begin anew.
pub fn group_colour(number: usize) -> Colour {
    GROUPS[number % GROUPS.len()]
}

/// Draws groups of points under a title, on one scale for both axes, whose names are given. `shapes` stand at the left, right, lower
/// and upper end.
pub fn scatter(
    title: &str,
    axes: [String; 2],
    clouds: Vec<Cloud>,
    shapes: Option<[Shown; 4]>,
    notes: &[Entry],
) -> Drawing {
    let all = || clouds.iter().flat_map(|cloud| cloud.points.iter().chain(&cloud.outline));
    let beside = if shapes.is_some() { SHAPE } else { 0.0 };
    let ranges = match all().next() {
        Some(_) => [range(all().map(|p| p[0])), range(all().map(|p| p[1]))],
        None => [(-1.0, 1.0); 2],
    };
    let frame = frame(ranges, beside);
    let ([left, right], [top, bottom]) = (frame.across, frame.down);
    let mut elements = frame.grid();
    let [x, y] = axes;
    elements.push(label([0.5 * (left + right), bottom + 30.0], Anchor::Middle, x));
    elements.push(label([left, top - 6.0], Anchor::Start, y));
    let mut samples = Vec::new();
    for (number, cloud) in clouds.into_iter().enumerate() {
        let opacity = (60.0 / (cloud.points.len() as f64).sqrt()).clamp(0.25, 0.9);
        let on_page = |points: Vec<[f64; 2]>| points.iter().map(|p| frame.place(p)).collect();
        let colour = group_colour(number);
        if !cloud.outline.is_empty() {
            let line = Layer::from_points(on_page(cloud.outline), Mark::Closed, colour, 1.5);
            elements.push(Element::Shapes(line, PAGE));
        }
        let dots = Layer { opacity, ..Layer::from_points(on_page(cloud.points), Mark::Dots, colour, DOT) };
        samples.push(dots.clone().named(cloud.name));
        elements.push(Element::Shapes(dots, PAGE));
    }
    let middle = [0.5 * (left + right), 0.5 * (top + bottom)];
    let half = 0.5 * SHAPE;
    let places = [
        [left - NUMBERS - half, middle[1]],
        [right + half + 4.0, middle[1]],
        [middle[0], bottom + NUMBERS + half],
        [middle[0], top - 18.0 - half],
    ];
    elements.extend(shapes.into_iter().flat_map(|shapes| placed(shapes, places)));
    let height = bottom + NUMBERS + beside;
    let mut legend = Entry::of(&samples);
    legend.extend_from_slice(notes);
    Drawing::new(title, height, elements).with_legend(&legend)
}

/// The frame around ranges of points, as wide as the page allows, with room `beside` it on all sides.
fn frame(ranges: [(f64, f64); 2], beside: f64) -> Frame {
    let [x, y] = ranges.map(|(low, high)| {
        let free = FREE * (high - low);
        (low - free, high + free)
    });
    let across = [MARGIN + NUMBERS + beside, SIZE - MARGIN - beside];
    let width = across[1] - across[0];
    let [least, most] = HEIGHTS;
    let height = (width * (y.1 - y.0) / (x.1 - x.0)).clamp(least, most);
    // One scale for both axes: the shorter one shows more.
    let per_unit = (width / (x.1 - x.0)).min(height / (y.1 - y.0));
    let widened = |(low, high): (f64, f64), room: f64| {
        let (middle, half) = (0.5 * (low + high), 0.5 * room / per_unit);
        (middle - half, middle + half)
    };
    let top = 24.0 + beside;
    Frame { x: widened(x, width), y: widened(y, height), across, down: [top, top + height] }
}

/// The shapes at their places, on one scale.
fn placed(shapes: [Shown; 4], places: [[f64; 2]; 4]) -> Vec<Element> {
    let bounds = shapes.each_ref().map(|shape| Bounds::of(shape));
    let scales = bounds.iter().filter_map(|bounds| bounds.scale([SHAPE - 8.0; 2]));
    let scale = scales.fold(f64::INFINITY, f64::min);
    if !scale.is_finite() {
        return Vec::new();
    }
    let shapes = shapes.into_iter().zip(bounds).zip(places);
    let elements = shapes.flat_map(|((layers, bounds), at)| {
        let map = Map { scale, centre: bounds.centre(), at };
        layers.into_iter().map(move |layer| Element::Shapes(layer, map))
    });
    elements.collect()
}

/// The least convex polygon around points, counter-clockwise; fewer than three corners for points on a line. Cost: a sort.
///
/// Source: Andrew 1979.
pub fn convex_hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    sorted.dedup();
    let turns_left = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    };
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        points.fold(Vec::<[f64; 2]>::new(), |mut chain, point| {
            let kept = (2..=chain.len()).rev().find(|&n| turns_left(chain[n - 2], chain[n - 1], point));
            chain.truncate(kept.unwrap_or(chain.len().min(1)));
            chain.push(point);
            chain
        })
    };
    let mut hull = half(&mut sorted.iter().copied());
    let mut upper = half(&mut sorted.iter().rev().copied());
    hull.pop();
    upper.pop();
    hull.extend(upper);
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::svg::Style;

    #[test]
    fn a_hull_holds_all_points_and_has_only_corners() {
        let grid: Vec<[f64; 2]> = (0..25).map(|k| [f64::from(k % 5), f64::from(k / 5)]).collect();
        assert_eq!(convex_hull(&grid), [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        assert_eq!(convex_hull(&[[1.0, 1.0], [0.0, 0.0], [2.0, 2.0]]), [[0.0, 0.0], [2.0, 2.0]]);
        assert_eq!(convex_hull(&[[1.0, 2.0], [1.0, 2.0]]), Vec::<[f64; 2]>::new());
        assert_eq!(convex_hull(&[]), Vec::<[f64; 2]>::new());
        let round: Vec<[f64; 2]> = (0..200).map(|k| (f64::from(k) * 2.4).sin_cos().into()).collect();
        let hull = convex_hull(&round);
        let inside = |p: &[f64; 2]| {
            hull.iter()
                .zip(hull.iter().cycle().skip(1))
                .all(|(a, b)| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= -1e-12)
        };
        assert!(hull.len() >= 3 && round.iter().all(inside));
    }

    #[test]
    fn both_axes_have_one_scale() {
        for (x, y) in [((0.0, 1.0), (0.0, 1.0)), ((0.0, 100.0), (0.0, 1.0)), ((0.0, 1.0), (-5.0, 100.0))] {
            let Frame { x: (a, b), y: (c, d), across, down } = frame([x, y], SHAPE);
            let scales = [(across[1] - across[0]) / (b - a), (down[1] - down[0]) / (d - c)];
            assert!((scales[0] / scales[1] - 1.0).abs() < 1e-12, "{scales:?}");
            assert!(a <= x.0 && b >= x.1 && c <= y.0 && d >= y.1);
        }
    }

    #[test]
    fn a_morphospace_has_points_outlines_and_shapes() {
        let points: Vec<[f64; 2]> = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let cloud = |name: &str| Cloud { name: name.into(), outline: points.clone(), points: points.clone() };
        let shape = || vec![Layer::from_points(points.clone(), Mark::Closed, group_colour(0), 1.0)];
        let axes = ["component 1".into(), "component 2".into()];
        let drawing = scatter("t", axes, vec![cloud("a"), cloud("b")], Some([0; 4].map(|_| shape())), &[]);
        let svg = drawing.to_svg(&Style::default());
        for text in ["component 1", "component 2", ">a<", ">b<"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN"));
        let empty = scatter("t", ["".into(), "".into()], Vec::new(), None, &[]);
        assert!(!empty.to_svg(&Style::default()).contains("NaN"));
    }
}
