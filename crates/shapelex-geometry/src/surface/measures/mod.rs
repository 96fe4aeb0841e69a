//! Measures of surfaces: volume, centroid and flux by Gauss–Legendre rules that are exact to rounding; area by adaptive
//! quadrature with an error estimate.
//!
//! ```text
//! V = ⅓ ∯ ⟨r, n⟩ dA     centroid = ¼ ∯ r ⟨r, n⟩ dA / V     flux of F = ∯ ⟨F, n⟩ dA     area = ∬ |σ_u × σ_v| du dv
//! ```
//!
//! The integrals of the first line use `± σ_u × σ_v du dv`, with the sign of the topology. A cylinder is closed by cones over
//! its two edges with their mean points as apexes; for plane edges these are flat lids.
//!
//! Source: Schmitter, *Spline Shape Processing*, (7.19)–(7.21), (7.38), (7.48), with signs corrected, and with quadrature in
//! place of precomputed triple products, which is equally exact and takes fewer operations.

pub mod sizes;

use super::field::VectorField;
use super::{Surface, Topology, combine};
use crate::knot_line::Line;
use crate::vector::{cross, dot, minus, plus};
use shapelex_numeric::bounded::Stop;
use shapelex_numeric::quadrature::GaussLegendre;

/// Measures of one surface, in the unit of its control points.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceMeasures {
    /// The enclosed volume, for spheres, tori and cylinders with lids. `None` for sheets and one-sided surfaces.
    pub enclosed: Option<EnclosedVolume>,
    /// Area, without lids.
    pub area: f64,
    /// Estimated error of the area.
    pub area_error: f64,
    /// Area of the lids that close a cylinder; 0 for other topologies.
    pub lid_area: f64,
    /// Centroid of the sheet by area; the mean position if the area is zero.
    pub sheet_centroid: [f64; 3],
    /// Mean position over the parameters, `∬ σ du dv`.
    pub mean_position: [f64; 3],
    /// Minimum and maximum coordinates among the nodes of the quadrature, the knots and the midpoints between knots.
    pub bounding_box: [[f64; 3]; 2],
}

/// Measures of the enclosed volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnclosedVolume {
    /// Volume, positive if the normal of the topology points outwards.
    pub signed_volume: f64,
    /// Centroid of the body; `None` if the volume vanishes.
    pub centroid: Option<[f64; 3]>,
}

/// Gauss nodes per half-interval and direction: products of four generators are integrated to rounding.
const NODES: usize = 10;
/// Nodes of the coarser rule for the error estimate of the area.
const FEWER_NODES: usize = 7;
/// Relative tolerance of the area.
const AREA_TOLERANCE: f64 = 1e-11;
/// Maximum depth of subdivision of a piece of the area.
const MAX_HALVINGS: usize = 12;
/// Maximum total number of subdivided pieces, relative to the number of pieces of the surface.
const MAX_PIECES: usize = 16;
/// Ratio of the volume to that of the bounding box below which the volume is rounding.
const NO_VOLUME: f64 = 1e-12;

impl SurfaceMeasures {
    /// `36πV²/A³` with the area `A` of the body including lids: 1 for a ball, less for any other body. `None` without a volume.
    pub fn sphericity(&self) -> Option<f64> {
        let volume = self.enclosed?.signed_volume;
        let ratio = volume / (self.area + self.lid_area).powf(1.5);
        Some(36.0 * std::f64::consts::PI * ratio * ratio).filter(|value| value.is_finite())
    }

    /// Measures `surface`. Cost: 400 jets per pair of intervals, more where the normal almost vanishes.
    pub fn of(surface: &Surface) -> Self {
        Self::about_origin(surface, &|| false)
    }

    /// Measures `surface`; `None` if `stop` returns true before they are complete.
    pub fn unless_stopped(surface: &Surface, stop: Stop<'_>) -> Option<Self> {
        let found = Self::about_origin(surface, stop);
        (!stop()).then_some(found)
    }

    fn about_origin(surface: &Surface, stop: Stop<'_>) -> Self {
        let Some(origin) = surface.far_origin() else { return Self::near(surface, stop) };
        Self::near(&surface.about(origin), stop).moved(origin)
    }

    fn near(surface: &Surface, stop: Stop<'_>) -> Self {
        // Fourth powers of coordinates overflow long before volumes do.
        let unit = surface.power_of_two();
        Self::in_range(&surface.scaled(unit.recip()), stop).scaled(unit)
    }

    /// Measures of the same surface moved by `by`.
    pub fn moved(self, by: [f64; 3]) -> Self {
        let point = |point: [f64; 3]| plus(point, by);
        Self {
            enclosed: self
                .enclosed
                .map(|enclosed| EnclosedVolume { centroid: enclosed.centroid.map(point), ..enclosed }),
            sheet_centroid: point(self.sheet_centroid),
            mean_position: point(self.mean_position),
            bounding_box: self.bounding_box.map(point),
            ..self
        }
    }

    fn scaled(self, unit: f64) -> Self {
        let point = |point: [f64; 3]| point.map(|value| value * unit);
        Self {
            enclosed: self.enclosed.map(|enclosed| EnclosedVolume {
                signed_volume: enclosed.signed_volume * unit * unit * unit,
                centroid: enclosed.centroid.map(point),
            }),
            area: self.area * unit * unit,
            area_error: self.area_error * unit * unit,
            lid_area: self.lid_area * unit * unit,
            sheet_centroid: point(self.sheet_centroid),
            mean_position: point(self.mean_position),
            bounding_box: self.bounding_box.map(point),
        }
    }

    fn in_range(surface: &Surface, stop: Stop<'_>) -> Self {
        let rule = GaussLegendre::new(NODES);
        let mut sums = Sums::new(surface.points(&[0.5], &[0.5])[0]);
        surface.each_node(&rule, stop, |weight, point, [du, dv]| {
            sums.add(weight, point, cross(du, dv).map(|value| surface.topology.orientation() * value));
        });
        // The edges are not nodes of the quadrature.
        let knots = |direction: usize| {
            let halves = 2 * surface.intervals(direction);
            (0..=halves).map(|i| i as f64 / halves as f64).collect::<Vec<_>>()
        };
        surface.points(&knots(0), &knots(1)).into_iter().for_each(|point| sums.bound(point));
        let (area, area_error) = area(surface, sums.area, stop);
        let spread: f64 = (0..3).map(|c| sums.bounds[1][c] - sums.bounds[0][c]).product();
        let enclosed = match surface.topology {
            _ if !surface.encloses() => None,
            Topology::Cylinder => {
                sums.close(surface, &rule);
                Some(sums.enclosed(spread))
            }
            _ => Some(sums.enclosed(spread)),
        };
        let at = |sum: [f64; 3], over: f64| [0, 1, 2].map(|c| sums.origin[c] + sum[c] / over);
        let mean_position = at(sums.position, 1.0);
        Self {
            enclosed,
            area,
            area_error,
            lid_area: sums.lids,
            sheet_centroid: if sums.area > 0.0 { at(sums.by_area, sums.area) } else { mean_position },
            mean_position,
            bounding_box: sums.bounds,
        }
    }
}

/// Volume within a sheet that is closed without lids, in the cube of the unit of its control points; positive if the normal of the
/// topology points outwards, exact to rounding. Of other sheets it has no meaning. Cost: 400 jets per pair of intervals.
///
/// Source: (7.20), as of [`SurfaceMeasures`], without the area.
pub fn signed_volume(surface: &Surface) -> f64 {
    let mut sums = Sums::new(surface.point(0.5, 0.5));
    surface.each_node(&GaussLegendre::new(NODES), &|| false, |weight, point, [du, dv]| {
        let normal = cross(du, dv).map(|value| surface.topology.orientation() * value);
        sums.enclose(weight, minus(point, sums.origin), normal);
    });
    sums.volume
}

/// Outward flux `∯ ⟨F, n⟩ dA` through the sheet, without lids, exact to rounding for polynomial fields: the Gauss rules have
/// nodes in proportion to the number of generators in a product, `D + 2` for the degree `D`. Cost: the square of
/// [`flux_nodes`], times the terms of the field, per pair of half-intervals. Once `stop` returns true, the rest is left out.
pub fn flux(surface: &Surface, field: &VectorField, stop: Stop<'_>) -> f64 {
    let Some(origin) = surface.far_origin() else { return flux_near(surface, field, stop) };
    flux_near(&surface.about(origin), &field.about(origin), stop)
}

/// Gauss nodes per half-interval and direction for the flux of a field of this degree: as many as for the centroid for each of the
/// products of four generators that it has, in proportion for longer products.
pub fn flux_nodes(degree: usize) -> usize {
    (NODES * (degree + 2)).div_ceil(4).max(NODES)
}

fn flux_near(surface: &Surface, field: &VectorField, stop: Stop<'_>) -> f64 {
    let mut sum = 0.0;
    surface.each_node(&GaussLegendre::new(flux_nodes(field.degree())), stop, |weight, point, [du, dv]| {
        sum += weight * surface.topology.orientation() * dot(field.value(point), cross(du, dv));
    });
    sum
}

/// Rows of nodes of [`l2`] that are evaluated at once: the weights along `v` are computed once for all of them.
const ROWS: usize = 64;

/// `(∬ |σ − τ|² du dv)^½` of two surfaces, exact to rounding, by Gauss rules between the knots of both. Cost: 100 points of
/// each surface per pair of pieces.
pub fn l2(a: &Surface, b: &Surface) -> f64 {
    let rule = GaussLegendre::new(NODES);
    let [us, vs] = [0, 1].map(|direction| common_nodes(a, b, direction, &rule));
    let v: Vec<f64> = vs.iter().map(|(v, _)| *v).collect();
    let mut sum = 0.0;
    for block in us.chunks(ROWS) {
        let u: Vec<f64> = block.iter().map(|(u, _)| *u).collect();
        let [p, q] = [a, b].map(|surface| surface.points(&u, &v));
        for ((_, weight), (p, q)) in block.iter().zip(p.chunks(v.len()).zip(q.chunks(v.len()))) {
            let squares = p.iter().zip(q).map(|(p, q)| minus(*p, *q)).map(|d| dot(d, d));
            sum += weight * squares.zip(&vs).map(|(square, (_, share))| share * square).sum::<f64>();
        }
    }
    sum.sqrt()
}

/// Nodes and weights on `[0, 1]` between the half-knots of two surfaces along a direction.
fn common_nodes(a: &Surface, b: &Surface, direction: usize, rule: &GaussLegendre) -> Vec<(f64, f64)> {
    let halves = [a, b].map(|surface| 2 * surface.intervals(direction));
    let mut breaks: Vec<f64> =
        halves.iter().flat_map(|&n| (0..=n).map(move |i| i as f64 / n as f64)).collect();
    breaks.sort_by(f64::total_cmp);
    let pieces = breaks.windows(2).filter(|pair| pair[1] - pair[0] > f64::EPSILON);
    let nodes = pieces.flat_map(|pair| {
        let (middle, radius) = (0.5 * (pair[0] + pair[1]), 0.5 * (pair[1] - pair[0]));
        rule.points().map(move |(node, weight)| (middle + radius * node, radius * weight))
    });
    nodes.collect()
}

/// `|a|` without protection against overflow, which is not needed for coordinates near 1.
fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Integrals relative to a point of the surface, so that a shape far from the origin keeps its digits.
struct Sums {
    origin: [f64; 3],
    volume: f64,
    moment: [f64; 3],
    area: f64,
    lids: f64,
    by_area: [f64; 3],
    position: [f64; 3],
    bounds: [[f64; 3]; 2],
}

impl Sums {
    fn new(origin: [f64; 3]) -> Self {
        let zero = [0.0; 3];
        Self {
            origin,
            volume: 0.0,
            moment: zero,
            area: 0.0,
            lids: 0.0,
            by_area: zero,
            position: zero,
            bounds: [origin; 2],
        }
    }

    fn add(&mut self, weight: f64, point: [f64; 3], normal: [f64; 3]) {
        let r = [0, 1, 2].map(|c| point[c] - self.origin[c]);
        let size = weight * length(normal);
        self.area += size;
        self.enclose(weight, r, normal);
        for c in 0..3 {
            self.by_area[c] += size * r[c];
            self.position[c] += weight * r[c];
        }
        self.bound(point);
    }

    fn bound(&mut self, point: [f64; 3]) {
        for c in 0..3 {
            self.bounds[0][c] = self.bounds[0][c].min(point[c]);
            self.bounds[1][c] = self.bounds[1][c].max(point[c]);
        }
    }

    fn enclose(&mut self, weight: f64, r: [f64; 3], normal: [f64; 3]) {
        let flux = weight * dot(r, normal);
        self.volume += flux / 3.0;
        (0..3).for_each(|c| self.moment[c] += 0.25 * flux * r[c]);
    }

    /// Adds the lids of a cylinder: cones over its edges, of area `½ ∮ |arm × tangent|`.
    fn close(&mut self, surface: &Surface, rule: &GaussLegendre) {
        // At v = 0 the edge runs around the outward normal of the lid in the opposite direction.
        for (v, direction) in [(0.0, -1.0), (1.0, 1.0)] {
            let edge = surface.edge(v, rule);
            let mut tip = [0.0; 3];
            for (weight, point, _) in &edge {
                (0..3).for_each(|c| tip[c] += weight * (point[c] - self.origin[c]));
            }
            for (weight, point, tangent) in &edge {
                let arm = [0, 1, 2].map(|c| point[c] - self.origin[c] - tip[c]);
                let normal = cross(arm, *tangent).map(|value| direction * value);
                self.lids += 0.5 * weight * length(normal);
                // ∫₀¹ s (tip + s·arm) ds and its second moment, by the Gauss rule: a polynomial of degree 3.
                for (node, share) in rule.points() {
                    let s = 0.5 * (1.0 + node);
                    let r = [0, 1, 2].map(|c| tip[c] + s * arm[c]);
                    self.enclose(0.5 * share * weight * s, r, normal);
                }
            }
        }
    }

    fn enclosed(&self, spread: f64) -> EnclosedVolume {
        let has_volume = self.volume.abs() > NO_VOLUME * spread;
        let centroid = has_volume.then(|| [0, 1, 2].map(|c| self.origin[c] + self.moment[c] / self.volume));
        EnclosedVolume { signed_volume: self.volume, centroid }
    }
}

impl Surface {
    /// Calls `visit` with weight, point and `[σ_u, σ_v]` at every node of the rule on every half-interval, until `stop` returns true.
    fn each_node(
        &self,
        rule: &GaussLegendre,
        stop: Stop<'_>,
        mut visit: impl FnMut(f64, [f64; 3], [[f64; 3]; 2]),
    ) {
        let nodes = [0, 1].map(|direction| self.nodes(direction, rule));
        for along_u in &nodes[0] {
            if stop() {
                return;
            }
            let row = self.combine_rows(along_u.first, &along_u.values, 0..self.size[1]);
            let slope = self.combine_rows(along_u.first, &along_u.slopes, 0..self.size[1]);
            for along_v in &nodes[1] {
                let (row, slope) = (&row[along_v.first..], &slope[along_v.first..]);
                let point = combine(row, &along_v.values);
                let du = combine(slope, &along_v.values);
                let dv = combine(row, &along_v.slopes);
                visit(along_u.weight * along_v.weight, point, [du, dv]);
            }
        }
    }

    fn nodes(&self, direction: usize, rule: &GaussLegendre) -> Vec<Node> {
        let halves = 2 * self.intervals(direction);
        let node =
            |half: usize, s: f64, share: f64| self.node(direction, half, s, 0.5 * share / halves as f64);
        (0..halves).flat_map(|half| rule.points().map(move |(s, share)| node(half, s, share))).collect()
    }

    fn node(&self, direction: usize, half: usize, s: f64, weight: f64) -> Node {
        Node::new(&self.lines[direction], half, s, weight)
    }

    /// Weight, point and tangent along the edge `v = 0` or `v = 1`.
    fn edge(&self, v: f64, rule: &GaussLegendre) -> Vec<(f64, [f64; 3], [f64; 3])> {
        let (half, s) = self.lines[1].locate(v);
        let across = self.node(1, half, s, 1.0);
        let columns = across.first..across.first + across.values.len();
        let at = |node: Node| {
            let along = |weights: &[f64]| {
                combine(&self.combine_rows(node.first, weights, columns.clone()), &across.values)
            };
            (node.weight, along(&node.values), along(&node.slopes))
        };
        self.nodes(0, rule).into_iter().map(at).collect()
    }
}

/// The basis functions of a direction at one parameter.
#[derive(Debug)]
struct Node {
    weight: f64,
    first: usize,
    values: Vec<f64>,
    slopes: Vec<f64>,
}

impl Node {
    fn new(line: &Line, half: usize, s: f64, weight: f64) -> Self {
        let (first, values) = line.weights(half, s, 0);
        Self { weight, first, values: values.collect(), slopes: line.weights(half, s, 1).1.collect() }
    }
}

/// A rectangle within one pair of half-intervals, in local coordinates `s ∈ [−1, 1]`.
#[derive(Clone, Copy)]
struct Piece {
    halves: [usize; 2],
    low: [f64; 2],
    high: [f64; 2],
    depth: usize,
}

/// Area with its estimated error: pieces are quartered until two rules agree, or `stop` returns true.
fn area(surface: &Surface, about: f64, stop: Stop<'_>) -> (f64, f64) {
    let rules = [GaussLegendre::new(NODES), GaussLegendre::new(FEWER_NODES)];
    let halves = [0, 1].map(|direction| 2 * surface.intervals(direction));
    let count = halves[0] * halves[1];
    let allowed = AREA_TOLERANCE * about / count as f64;
    let (mut total, mut error, mut left) = (0.0, 0.0, MAX_PIECES * count);
    for half_u in 0..halves[0] {
        for half_v in 0..halves[1] {
            let whole = Piece { halves: [half_u, half_v], low: [-1.0; 2], high: [1.0; 2], depth: 0 };
            let mut pieces = vec![whole];
            while let Some(piece) = pieces.pop() {
                if stop() {
                    return (total, error);
                }
                let [fine, coarse] = [0, 1].map(|i| piece.area(surface, &rules[i]));
                let difference = (fine - coarse).abs();
                if difference > allowed && piece.depth < MAX_HALVINGS && left > 0 {
                    left -= 1;
                    pieces.extend(piece.quarters());
                } else {
                    total += fine;
                    error += difference;
                }
            }
        }
    }
    (total, error)
}

impl Piece {
    fn quarters(self) -> [Self; 4] {
        let middle = [0, 1].map(|i| 0.5 * (self.low[i] + self.high[i]));
        [[false, false], [false, true], [true, false], [true, true]].map(|upper| Self {
            low: [0, 1].map(|i| if upper[i] { middle[i] } else { self.low[i] }),
            high: [0, 1].map(|i| if upper[i] { self.high[i] } else { middle[i] }),
            depth: self.depth + 1,
            ..self
        })
    }

    fn area(self, surface: &Surface, rule: &GaussLegendre) -> f64 {
        let nodes = [0, 1].map(|direction| {
            let (low, high) = (self.low[direction], self.high[direction]);
            let scale = 0.125 * (high - low) / surface.intervals(direction) as f64;
            let node = |(x, share)| {
                let s = 0.5 * (low + high) + 0.5 * (high - low) * x;
                surface.node(direction, self.halves[direction], s, scale * share)
            };
            rule.points().map(node).collect::<Vec<_>>()
        });
        // Within one half-interval along v, all nodes have the same control points.
        let first = nodes[1][0].first;
        let columns = first..first + nodes[1][0].values.len();
        let mut sum = 0.0;
        for along_u in &nodes[0] {
            let row = surface.combine_rows(along_u.first, &along_u.values, columns.clone());
            let slope = surface.combine_rows(along_u.first, &along_u.slopes, columns.clone());
            for along_v in &nodes[1] {
                let du = combine(&slope, &along_v.values);
                let dv = combine(&row, &along_v.slopes);
                sum += along_u.weight * along_v.weight * length(cross(du, dv));
            }
        }
        sum
    }
}
