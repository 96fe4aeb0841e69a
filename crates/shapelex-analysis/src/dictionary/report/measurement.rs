//! Named measurements of shapes: the changes of a mode, in units that people know, and the shape that has a wanted value.
//!
//! ```text
//! distance   |p − q|
//! angle      between p − q and r − q
//! area       ½ ∫ (x dy − y dx) along the curve from p to q and back along the chord
//! width      extent of the shape across the line from p to q
//! ```
//!
//! Points depend linearly on scores, `p(s) = p̄ + Σ s_i q_i`, so every measurement is a function of the scores with an exact gradient.
//! The shape with the value `v` is the most likely one, `argmin |z|²` with `m(z) = v` for scores `z` in standard deviations: Newton steps
//! `z ← g (v − m(z) + gᵀz)/|g|²` along the gradient `g`.

use crate::metric::{dot, norm};
use shapelex_geometry::capability::place::Place;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Quantity that is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum Quantity {
    /// Distance of two places, in the unit of the cohort.
    Distance {
        /// The places.
        between: [Place; 2],
    },
    /// Angle at the second of three places, in degrees.
    Angle {
        /// The places.
        at: [Place; 3],
    },
    /// Area between a closed or open planar curve, from the first to the second parameter, and the chord; positive where the curve runs
    /// counter-clockwise. In the squared unit of the cohort.
    Area {
        /// The parameters.
        between: [Place; 2],
    },
    /// Extent of a planar curve across the line through two places, in the unit of the cohort.
    Width {
        /// The places.
        along: [Place; 2],
    },
}

/// Physical dimension of a quantity: lengths scale with the size of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// Degrees.
    Angle,
    /// The unit of the cohort.
    Length,
    /// The squared unit of the cohort.
    Area,
}

/// Number of pieces of an arc, and of places at which a width is looked for.
const ARC: usize = 256;

impl Quantity {
    /// Its physical dimension.
    pub fn dimension(&self) -> Dimension {
        match self {
            Self::Angle { .. } => Dimension::Angle,
            Self::Distance { .. } | Self::Width { .. } => Dimension::Length,
            Self::Area { .. } => Dimension::Area,
        }
    }

    /// Whether it is one of planar curves only.
    pub fn needs_plane(&self) -> bool {
        matches!(self, Self::Area { .. } | Self::Width { .. })
    }

    /// The places that the request names, with their field.
    pub fn places(&self) -> (&'static str, &[Place]) {
        match self {
            Self::Distance { between } | Self::Area { between } => ("between", between),
            Self::Angle { at } => ("at", at),
            Self::Width { along } => ("along", along),
        }
    }

    /// All places that the value depends on.
    pub(in crate::dictionary) fn all_places(&self, closed: bool) -> Vec<Place> {
        let (_, named) = self.places();
        let between = |from: f64, to: f64| {
            (0..=ARC).map(move |i| Place::One(from + (to - from) * i as f64 / ARC as f64))
        };
        match self {
            Self::Distance { .. } | Self::Angle { .. } => named.to_vec(),
            Self::Area { between: [from, to] } => {
                let on = |place: &Place| if closed { place.first().rem_euclid(1.0) } else { place.first() };
                let (from, to) = (on(from), on(to));
                // Forwards along a closed curve.
                let to = if closed && to <= from { to + 1.0 } else { to };
                between(from, to).collect()
            }
            Self::Width { along } => along.iter().copied().chain(between(0.0, 1.0)).collect(),
        }
    }

    /// Value for the points at [`Self::all_places`], and its derivative by each coordinate of them; `None` where it has none.
    pub(in crate::dictionary) fn of(&self, points: &[Vec<f64>]) -> Option<(f64, Vec<Vec<f64>>)> {
        let minus = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let scaled = |a: &[f64], factor: f64| a.iter().map(|a| factor * a).collect::<Vec<f64>>();
        match self {
            Self::Distance { .. } => {
                let away = minus(&points[0], &points[1]);
                let length = norm(&away);
                let unit = scaled(&away, 1.0 / length);
                (length > 0.0).then(|| (length, vec![unit.clone(), scaled(&unit, -1.0)]))
            }
            Self::Angle { .. } => angle(&minus(&points[0], &points[1]), &minus(&points[2], &points[1])),
            Self::Area { .. } => Some(area(points)),
            Self::Width { .. } => width(points),
        }
    }
}

/// The angle between two directions in degrees, with derivatives by both ends and by the vertex between them.
fn angle(a: &[f64], b: &[f64]) -> Option<(f64, Vec<Vec<f64>>)> {
    let (la, lb) = (norm(a), norm(b));
    let cosine = (dot(a, b) / (la * lb)).clamp(-1.0, 1.0);
    let sine = (1.0 - cosine * cosine).sqrt();
    // Straight and zero angles have a corner: no derivative.
    if !(sine > 1e-8) {
        return None;
    }
    let degrees = 1.0_f64.to_degrees();
    let by = |a: &[f64], b: &[f64], la: f64, lb: f64| -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| -degrees * (b / (la * lb) - cosine * a / (la * la)) / sine).collect()
    };
    let (first, last) = (by(a, b, la, lb), by(b, a, lb, la));
    let vertex = first.iter().zip(&last).map(|(f, l)| -f - l).collect();
    Some((degrees * cosine.acos(), vec![first, vertex, last]))
}

/// Signed area of the polygon with these corners, with derivatives by all of them.
fn area(points: &[Vec<f64>]) -> (f64, Vec<Vec<f64>>) {
    let count = points.len();
    let at = |i: usize| (&points[(i + count - 1) % count], &points[(i + 1) % count]);
    let (mut sum, mut gradient) = (0.0, Vec::with_capacity(count));
    for (i, p) in points.iter().enumerate() {
        let (before, after) = at(i);
        sum += 0.5 * (p[0] * after[1] - p[1] * after[0]);
        gradient.push(vec![0.5 * (after[1] - before[1]), 0.5 * (before[0] - after[0])]);
    }
    (sum, gradient)
}

/// Extent of all points but the first two across the line through these.
fn width(points: &[Vec<f64>]) -> Option<(f64, Vec<Vec<f64>>)> {
    let axis: Vec<f64> = points[1].iter().zip(&points[0]).map(|(q, p)| q - p).collect();
    let length = norm(&axis);
    if !(length > 0.0) {
        return None;
    }
    let along = [axis[0] / length, axis[1] / length];
    let across = [-along[1], along[0]];
    let height = |p: &Vec<f64>| across[0] * p[0] + across[1] * p[1];
    let heights: Vec<f64> = points[2..].iter().map(height).collect();
    let extreme = |sign: f64| {
        let larger = |best: usize, i: usize| if sign * heights[i] > sign * heights[best] { i } else { best };
        (0..heights.len()).reduce(larger)
    };
    let (top, bottom) = (extreme(1.0)?, extreme(-1.0)?);
    let value = heights[top] - heights[bottom];
    let mut gradient = vec![vec![0.0; 2]; points.len()];
    gradient[2 + top] = across.to_vec();
    gradient[2 + bottom].iter_mut().zip(across).for_each(|(g, a)| *g -= a);
    // The line turns with its ends: d(across)/d(axis) = −along ⊗ across / length.
    let chord: f64 = (0..2).map(|c| along[c] * (points[2 + top][c] - points[2 + bottom][c])).sum();
    for c in 0..2 {
        let turn = -chord * across[c] / length;
        gradient[1][c] += turn;
        gradient[0][c] -= turn;
    }
    Some((value, gradient))
}

/// A quantity as a function of scores, in standard deviations.
#[derive(Debug)]
pub(super) struct Functional {
    quantity: Quantity,
    /// Points at the mean.
    mean: Vec<Vec<f64>>,
    /// Change of the points with each score.
    modes: Vec<Vec<Vec<f64>>>,
}

/// Most Newton steps to the shape that has a value.
const STEPS: usize = 50;

/// Relative difference to the wanted value at which the steps end.
const CLOSE: f64 = 1e-9;

/// Longest Newton step, in standard deviations.
const LONGEST: f64 = 2.0;

impl Functional {
    /// The quantity of shapes with a mean, whose modes (at one standard deviation) are added to it; control points. `None` if shapes of
    /// `space` have no such places.
    pub(super) fn new(
        space: &ShapeSpace,
        quantity: Quantity,
        mean: &[f64],
        modes: &[Vec<f64>],
    ) -> Option<Self> {
        let at = |control_points: &[f64]| points(space, &quantity, control_points);
        let modes = modes.iter().map(|mode| at(mode)).collect::<Option<_>>()?;
        Some(Self { mean: at(mean)?, modes, quantity })
    }

    /// Value and gradient at the scores `z`; `None` where there is no gradient.
    pub(super) fn at(&self, z: &[f64]) -> Option<(f64, Vec<f64>)> {
        let mut points = self.mean.clone();
        for (z, mode) in z.iter().zip(&self.modes).filter(|(z, _)| **z != 0.0) {
            for (p, q) in points.iter_mut().zip(mode) {
                p.iter_mut().zip(q).for_each(|(p, q)| *p += z * q);
            }
        }
        let (value, by_points) = self.quantity.of(&points)?;
        let along = |mode: &Vec<Vec<f64>>| mode.iter().zip(&by_points).map(|(q, g)| dot(q, g)).sum();
        Some((value, self.modes.iter().map(along).collect()))
    }

    /// The most likely scores that have the value `wanted`; `None` if the steps do not reach it.
    pub(super) fn with_value(&self, wanted: f64) -> Option<Vec<f64>> {
        let mut z = vec![0.0; self.modes.len()];
        for _ in 0..STEPS {
            let (value, gradient) = self.at(&z)?;
            let square = dot(&gradient, &gradient);
            let factor = (wanted - value + dot(&gradient, &z)) / square;
            let next: Vec<f64> = gradient.iter().map(|g| factor * g).collect();
            let step: Vec<f64> = next.iter().zip(&z).map(|(next, z)| next - z).collect();
            let length = norm(&step);
            if !length.is_finite() {
                return None;
            }
            if (wanted - value).abs() <= CLOSE * value.abs().max(wanted.abs()) && length <= CLOSE.sqrt() {
                return Some(z);
            }
            let part = (LONGEST / length).min(1.0);
            z.iter_mut().zip(&step).for_each(|(z, step)| *z += part * step);
        }
        None
    }
}

/// Value of a quantity of one shape; `None` where shapes of `space` have no such places, or the shape no such value.
pub(super) fn value(space: &ShapeSpace, quantity: &Quantity, control_points: &[f64]) -> Option<f64> {
    let points = points(space, quantity, control_points)?;
    quantity.of(&points).map(|(value, _)| value)
}

/// Points of a shape at the places of a quantity.
fn points(space: &ShapeSpace, quantity: &Quantity, control_points: &[f64]) -> Option<Vec<Vec<f64>>> {
    let representation = space.representation();
    let rows = Matrix::from_column_slice(representation.size(), representation.dimension(), control_points);
    space.points_at(&rows, &quantity.all_places(representation.is_closed()))
}

/// Faults of a quantity of shapes of `space`, by field.
pub fn quantity_faults(space: &ShapeSpace, quantity: &Quantity) -> Vec<FieldFault> {
    let in_plane = space.domain().is_line() && space.representation().dimension() == 2;
    if quantity.needs_plane() && !in_plane {
        return vec![FieldFault::new(
            "kind",
            "expected a distance or an angle: areas and widths are of planar curves",
        )];
    }
    let (field, places) = quantity.places();
    space.place_faults(places).into_iter().map(|fault| fault.below(field)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use shapelex_geometry::generator::GeneratorKind;
    use shapelex_geometry::representation::Representation;

    fn space() -> ShapeSpace {
        let generator = GeneratorKind::Trigonometric {};
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 12, generator }).unwrap()
    }

    /// An ellipse with half-axes `a` and `b`.
    fn ellipse(a: f64, b: f64) -> Vec<f64> {
        let angle = |i: usize| std::f64::consts::TAU * i as f64 / 12.0;
        (0..12).map(|i| a * angle(i).cos()).chain((0..12).map(|i| b * angle(i).sin())).collect()
    }

    const QUANTITIES: [Quantity; 4] = [
        Quantity::Distance { between: [Place::One(0.0), Place::One(0.5)] },
        Quantity::Angle { at: [Place::One(0.0), Place::One(0.3), Place::One(0.5)] },
        Quantity::Area { between: [Place::One(0.1), Place::One(0.6)] },
        Quantity::Width { along: [Place::One(0.02), Place::One(0.5)] },
    ];

    /// Values of an ellipse in closed form.
    #[test]
    fn an_ellipse_has_its_measurements() {
        let (space, shape) = (space(), ellipse(3.0, 2.0));
        let of = |quantity: &Quantity| value(&space, quantity, &shape).unwrap();
        let straight = Quantity::Width { along: [Place::One(0.0), Place::One(0.5)] };
        let half = Quantity::Area { between: [Place::One(0.25), Place::One(0.75)] };
        assert!((of(&QUANTITIES[0]) - 6.0).abs() < 1e-9);
        assert!((of(&straight) - 4.0).abs() < 1e-3, "{}", of(&straight));
        // A polygon of 256 corners inside the arc.
        assert!((of(&half) - 3.0 * std::f64::consts::PI).abs() < 1e-3, "{}", of(&half));
        let turned = Quantity::Area { between: [Place::One(1e308), Place::One(-0.5)] };
        assert!((of(&turned) - 3.0 * std::f64::consts::PI).abs() < 1e-3, "{}", of(&turned));
        let right = Quantity::Angle { at: [Place::One(0.0), Place::One(0.25), Place::One(0.5)] };
        assert!((of(&right) - 2.0 * 1.5_f64.atan().to_degrees()).abs() < 1e-9);
    }

    /// Gradients are those of differences.
    #[test]
    fn gradients_are_those_of_differences() {
        let space = space();
        let bump: Vec<f64> = (0..24).map(|i| 0.2 * (2.7 * i as f64).sin()).collect();
        let modes = [ellipse(0.4, -0.2), bump, ellipse(0.1, 0.3)];
        for quantity in QUANTITIES {
            let functional = Functional::new(&space, quantity, &ellipse(3.0, 2.0), &modes).unwrap();
            let z = [0.3, -0.2, 0.5];
            let (_, gradient) = functional.at(&z).unwrap();
            for i in 0..3 {
                let side = |sign: f64| {
                    let mut z = z;
                    z[i] += sign * 1e-5;
                    functional.at(&z).unwrap().0
                };
                let difference = (side(1.0) - side(-1.0)) / 2e-5;
                assert!(
                    (difference - gradient[i]).abs() < 1e-6 * (1.0 + difference.abs()),
                    "{quantity:?} {i}"
                );
            }
        }
    }

    /// The shape with a value has it, and no shape with it is more likely: its scores are a multiple of the gradient.
    #[test]
    fn the_most_likely_shape_has_the_value() {
        let space = space();
        let modes = [ellipse(0.4, -0.2), ellipse(0.1, 0.3)];
        for (quantity, wanted) in QUANTITIES.into_iter().zip([6.8, 100.0, 11.0, 4.4]) {
            let functional = Functional::new(&space, quantity, &ellipse(3.0, 2.0), &modes).unwrap();
            let z = functional.with_value(wanted).unwrap_or_else(|| panic!("{quantity:?}"));
            let (value, gradient) = functional.at(&z).unwrap();
            assert!((value - wanted).abs() < 1e-6, "{quantity:?} {value}");
            let cosine = dot(&z, &gradient).abs() / (norm(&z) * norm(&gradient));
            assert!(cosine > 1.0 - 1e-6, "{quantity:?} {cosine}");
        }
    }

    #[test]
    fn places_that_a_shape_does_not_have_are_refused() {
        let space = space();
        assert!(QUANTITIES.iter().all(|quantity| quantity_faults(&space, quantity).is_empty()));
        let pair = Quantity::Distance { between: [Place::Two([0.1, 0.2]), Place::One(0.1)] };
        let faults: Vec<String> =
            quantity_faults(&space, &pair).into_iter().map(|fault| fault.field).collect();
        assert_eq!(faults, ["between/0"]);
    }
}
