//! Area and volume at a small cost, for tables, filters and tests of many surfaces.
//!
//! ```text
//! area = Σ_pieces Σ_ab w_a w_b |σ_u × σ_v|      V = ⅓ Σ_pieces Σ_ab w_a w_b ⟨r, σ_u × σ_v⟩
//! error of a line of n nodes   max(|c_{n−1}|² c₀, |c_{n−2}|³)/c₀²,   c_k = (k + ½) Σ_a w_a P_k(x_a) g_a,   g = |σ_u × σ_v|
//! ```
//!
//! Coefficients of Legendre polynomials of a smooth function decay geometrically at least, and the rule of `n` nodes is exact up to
//! degree `2n − 1`: it misses about `c_{2n}`, less than the estimate. Pieces are the intervals between knots if the generator has breaks
//! there only, else their halves; those of a large error are quartered. The number of nodes is the smallest that integrates the volume.
//!
//! [`SurfaceMeasures`](super::SurfaceMeasures) has more digits and more measures at some thirty times the cost.

use std::ops::Range;

use super::super::{Surface, Topology};
use super::{MAX_HALVINGS, MAX_PIECES, Node, Sums};
use crate::generator::Generator;
use crate::knot_line::Line;
use shapelex_numeric::lanes::{LANES, Lanes, vectorised};
use shapelex_numeric::quadrature::GaussLegendre;

/// Area and volume of one surface, in the unit of its control points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetSizes {
    /// Area, without lids. Its relative error is below [`AREA_TOLERANCE`], up to a hundred times that for surfaces so rough that their
    /// normals vanish between nodes.
    pub area: f64,
    /// The enclosed volume, positive if the normal of the topology points outwards; `None` for sheets and one-sided surfaces.
    pub signed_volume: Option<f64>,
}

/// Relative tolerance of the area.
pub const AREA_TOLERANCE: f64 = 1e-6;
/// Part of the tolerance that estimates may reach: those of rough surfaces are too small.
const MARGIN: f64 = 0.2;
/// Relative tolerance of the volume.
pub const VOLUME_TOLERANCE: f64 = 1e-7;
/// Fewest nodes of a piece along a direction.
const FEWEST_NODES: usize = 4;
/// Most nodes of a piece along a direction.
const MOST_NODES: usize = 12;

impl SheetSizes {
    /// Sizes of a surface of the basis of `rules`.
    pub(in crate::surface) fn of(surface: &Surface, rules: &Rules) -> Self {
        let near = surface.far_origin().map(|origin| surface.about(origin));
        let surface = near.as_ref().unwrap_or(surface);
        // Third powers of coordinates overflow long before volumes do.
        let unit = surface.power_of_two();
        let Self { area, signed_volume } = Self::in_range(&surface.scaled(unit.recip()), rules);
        Self {
            area: area * unit * unit,
            signed_volume: signed_volume.map(|volume| volume * unit * unit * unit),
        }
    }

    fn in_range(surface: &Surface, rules: &Rules) -> Self {
        let mut sums = Sums::new(surface.points(&[0.5], &[0.5])[0]);
        let pieces = pieces(surface, &rules.0, &mut sums);
        let area = refined(surface, &rules.0, pieces);
        let signed_volume = surface.encloses().then(|| {
            if surface.topology == Topology::Cylinder {
                sums.close(surface, &GaussLegendre::new(super::NODES));
            }
            sums.volume
        });
        Self { area, signed_volume }
    }
}

/// Rules along both directions of the surfaces of a basis.
#[derive(Debug)]
pub(in crate::surface) struct Rules([Rule; 2]);

impl Rules {
    /// Prepares the rules for lines of so many intervals.
    pub(in crate::surface) fn new(lines: &[Line; 2], intervals: [usize; 2]) -> Self {
        Self([0, 1].map(|direction| Rule::new(&lines[direction], intervals[direction])))
    }
}

/// The rule along a direction.
#[derive(Debug)]
struct Rule {
    /// Half-intervals in a piece: 2 if the generator has no break in the middle of intervals.
    halves: usize,
    gauss: GaussLegendre,
    /// `(k + ½) w P_k(x)` of each node, for the two highest degrees that the nodes tell apart.
    highest: [Vec<f64>; 2],
    /// Nodes of all pieces.
    nodes: Vec<Node>,
}

impl Rule {
    fn new(line: &Line, intervals: usize) -> Self {
        let generator = line.generator();
        let by_intervals = generator.breaks_at_knots_only();
        let halves = if by_intervals { 2 } else { 1 };
        let gauss = GaussLegendre::new(nodes(generator, by_intervals));
        let count = gauss.points().count();
        let highest = [count - 1, count - 2].map(|degree| {
            let factor = degree as f64 + 0.5;
            gauss.points().map(|(x, weight)| factor * weight * legendre(degree, x)).collect()
        });
        let pieces = (0..2 * intervals / halves).map(|k| places(k, halves));
        let nodes = pieces.flat_map(|places| nodes_between(&gauss, line, intervals, places)).collect();
        Self { halves, gauss, highest, nodes }
    }

    /// Places between which each piece lies.
    fn places(&self) -> impl Iterator<Item = [f64; 2]> {
        (0..self.nodes.len() / self.len()).map(|k| places(k, self.halves))
    }

    /// Number of nodes.
    fn len(&self) -> usize {
        self.highest[0].len()
    }

    /// Mean of a line of values, and the estimated error of this mean.
    fn mean(&self, values: impl Iterator<Item = f64>) -> [f64; 2] {
        let [mut mean, mut first, mut second] = [0.0; 3];
        let [one, other] = &self.highest;
        for ((value, (_, weight)), (a, b)) in values.zip(self.gauss.points()).zip(one.iter().zip(other)) {
            mean += 0.5 * weight * value;
            first += a * value;
            second += b * value;
        }
        let [first, second] = [first, second].map(|c| (c.abs() / mean.max(f64::MIN_POSITIVE)).min(1.0));
        [mean, mean * (first * first).max(second * second * second)]
    }

    /// As [`Self::mean`], of many lines at once: `values` has their values at each node.
    #[inline(always)]
    fn means<'a>(&self, values: impl Iterator<Item = &'a Lanes>) -> [Lanes; 2] {
        let [mut mean, mut first, mut second] = [[0.0; LANES]; 3];
        let [one, other] = &self.highest;
        for ((value, (_, weight)), (a, b)) in values.zip(self.gauss.points()).zip(one.iter().zip(other)) {
            for l in 0..LANES {
                mean[l] += 0.5 * weight * value[l];
            }
            for l in 0..LANES {
                first[l] += a * value[l];
            }
            for l in 0..LANES {
                second[l] += b * value[l];
            }
        }
        let mut error = [0.0; LANES];
        for l in 0..LANES {
            let part = mean[l].max(f64::MIN_POSITIVE).recip();
            let (first, second) = ((part * first[l].abs()).min(1.0), (part * second[l].abs()).min(1.0));
            error[l] = mean[l] * (first * first).max(second * second * second);
        }
        [mean, error]
    }
}

/// Places between which the piece `k` of so many half-intervals lies, counted in half-intervals.
fn places(k: usize, halves: usize) -> [f64; 2] {
    [k, k + 1].map(|k| (k * halves) as f64)
}

/// Nodes of the rule between two places.
fn nodes_between(gauss: &GaussLegendre, line: &Line, intervals: usize, [low, high]: [f64; 2]) -> Vec<Node> {
    let halves = 2 * intervals;
    let node = |(x, weight)| {
        let place = 0.5 * (low + high) + 0.5 * (high - low) * x;
        let half = (place as usize).min(halves - 1);
        let share = 0.5 * (high - low) * weight / halves as f64;
        Node::new(line, half, 2.0 * (place - half as f64) - 1.0, share)
    };
    gauss.points().map(node).collect()
}

/// Legendre polynomial `P_k(x)`.
fn legendre(degree: usize, x: f64) -> f64 {
    let step = |(before, now): (f64, f64), k: usize| {
        (now, ((2 * k + 1) as f64 * x * now - k as f64 * before) / (k + 1) as f64)
    };
    (0..degree).fold((0.0, 1.0), step).1
}

/// Smallest number of nodes that integrates products of three functions of a generator to [`VOLUME_TOLERANCE`], by the bounds of their
/// Taylor vectors.
fn nodes(generator: &Generator, by_intervals: bool) -> usize {
    let one = generator.majorant(by_intervals);
    let three = product(&product(&one, &one), &one);
    // The product has a derivative of two of the functions.
    let degree = three.len() - 2;
    let error = |n: usize| (2 * n..=degree).map(|m| three[m] * monomial_error(n, m)).sum::<f64>();
    (FEWEST_NODES..=MOST_NODES).find(|n| error(*n) <= VOLUME_TOLERANCE).unwrap_or(MOST_NODES)
}

/// Coefficients of the product of two polynomials.
fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; a.len() + b.len() - 1];
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    product
}

/// A bound of the error of the rule of `n` nodes for the mean of `s^m` on `[−1, 1]`: `binom(m, 2n) 2^{2n} (n!)⁴/((2n + 1) ((2n)!)²)`,
/// and 1.
fn monomial_error(n: usize, m: usize) -> f64 {
    let of_degree: f64 = (1..=n).map(|k| k as f64 / (n + k) as f64).product();
    let binomial: f64 = (1..=2 * n).map(|k| (m - 2 * n + k) as f64 / k as f64).product();
    (binomial * 4.0_f64.powi(n as i32) * of_degree * of_degree / (2 * n + 1) as f64).min(1.0)
}

/// A rectangle, in half-intervals, with its area and the estimated error of it.
struct Piece {
    places: [[f64; 2]; 2],
    area: f64,
    error: f64,
    depth: usize,
}

/// Nodes of one or more pieces along `u`, in blocks, with the combinations of control points there, from one column on.
struct Rows {
    first: usize,
    blocks: usize,
    weights: Vec<Lanes>,
    /// By coordinate and, within it, by column and block: of the values of the basis functions, and of their slopes.
    points: [Vec<Lanes>; 3],
    slopes: [Vec<Lanes>; 3],
}

impl Rows {
    fn new(surface: &Surface, nodes: &[Node], columns: Range<usize>) -> Self {
        let blocks = nodes.len().div_ceil(LANES);
        let combined = |weights: fn(&Node) -> &[f64]| {
            let mut all = [0, 1, 2].map(|_| vec![[0.0; LANES]; columns.len() * blocks]);
            for (a, node) in nodes.iter().enumerate() {
                let row = surface.combine_rows(node.first, weights(node), columns.clone());
                for (column, point) in row.iter().enumerate() {
                    (0..3).for_each(|c| all[c][column * blocks + a / LANES][a % LANES] = point[c]);
                }
            }
            all
        };
        let mut weights = vec![[0.0; LANES]; blocks];
        nodes.iter().enumerate().for_each(|(a, node)| weights[a / LANES][a % LANES] = node.weight);
        Self {
            first: columns.start,
            blocks,
            weights,
            points: combined(|node| &node.values),
            slopes: combined(|node| &node.slopes),
        }
    }

    /// `σ`, `σ_u` and `σ_v` at the nodes of a block along `u` and this one along `v`, by coordinate.
    #[inline(always)]
    fn jets(&self, block: usize, node: &Node) -> [[Lanes; 3]; 3] {
        let mut jets = [[[0.0; LANES]; 3]; 3];
        for c in 0..3 {
            let [mut point, mut along_u, mut along_v] = [[0.0; LANES]; 3];
            for (k, (value, rate)) in node.values.iter().zip(&node.slopes).enumerate() {
                let place = (node.first - self.first + k) * self.blocks + block;
                let (of_values, of_slopes) = (&self.points[c][place], &self.slopes[c][place]);
                for l in 0..LANES {
                    point[l] += value * of_values[l];
                }
                for l in 0..LANES {
                    along_u[l] += value * of_slopes[l];
                }
                for l in 0..LANES {
                    along_v[l] += rate * of_values[l];
                }
            }
            [jets[0][c], jets[1][c], jets[2][c]] = [point, along_u, along_v];
        }
        jets
    }
}

/// All pieces of the surface; the volume is added to `sums`.
fn pieces(surface: &Surface, rules: &[Rule; 2], sums: &mut Sums) -> Vec<Piece> {
    let [along_u, along_v] = rules;
    let rows = Rows::new(surface, &along_u.nodes, 0..surface.size[1]);
    let mut pieces = Vec::new();
    let mut elements = Elements::default();
    let mut volume = 0.0;
    for (v, nodes) in along_v.places().zip(along_v.nodes.chunks_exact(along_v.len())) {
        volume += elements.fill(&rows, along_v, nodes, sums.origin);
        for (k, u) in along_u.places().enumerate() {
            let [area, error] = elements.area(rules, k, [u, v], surface);
            pieces.push(Piece { places: [u, v], area, error, depth: 0 });
        }
    }
    sums.volume = surface.topology.orientation() * volume / 3.0;
    pieces
}

/// `|σ_u × σ_v|` at the nodes of a piece along `v`: all nodes along `u` for each. Then their means along `v`, and the errors of these.
#[derive(Default)]
struct Elements {
    strips: Vec<Vec<Lanes>>,
    means: Vec<Lanes>,
    errors: Vec<Lanes>,
}

impl Elements {
    /// Takes the elements at the nodes of the rule along `v`. Returns `Σ w ⟨σ − origin, σ_u × σ_v⟩`.
    fn fill(&mut self, rows: &Rows, rule: &Rule, nodes: &[Node], origin: [f64; 3]) -> f64 {
        self.strips.resize_with(nodes.len(), Vec::new);
        let empty = |strip: &mut Vec<Lanes>| strip.resize(rows.blocks, [0.0; LANES]);
        self.strips.iter_mut().chain([&mut self.means, &mut self.errors]).for_each(empty);
        vectorised(
            #[inline(always)]
            || {
                let mut flux = 0.0;
                for block in 0..rows.blocks {
                    for (node, strip) in nodes.iter().zip(&mut self.strips) {
                        flux += node.weight * elements(rows, block, node, origin, &mut strip[block]);
                    }
                    [self.means[block], self.errors[block]] =
                        rule.means(self.strips.iter().map(|strip| &strip[block]));
                }
                flux
            },
        )
    }

    /// Area of the piece with the number `k` along `u`, and its estimated error: the mean of the errors of its lines, in both
    /// directions.
    fn area(&self, rules: &[Rule; 2], k: usize, places: [[f64; 2]; 2], surface: &Surface) -> [f64; 2] {
        let [m, n] = rules.each_ref().map(Rule::len);
        let of_piece = |strip: &'_ Vec<Lanes>| -> [f64; 2] {
            rules[0].mean(strip.as_flattened()[k * m..(k + 1) * m].iter().copied())
        };
        let mut across = [0.0; MOST_NODES];
        for (strip, error) in self.strips.iter().zip(&mut across) {
            *error = of_piece(strip)[1];
        }
        let ([area, _], [along_v, _]) = (of_piece(&self.means), of_piece(&self.errors));
        let [along_u, _] = rules[1].mean(across[..n].iter().copied());
        let size = |direction: usize| {
            let [low, high] = places[direction];
            0.5 * (high - low) / surface.intervals(direction) as f64
        };
        let size = size(0) * size(1);
        [size * area, size * (along_u + along_v)]
    }
}

/// `ab − cd`.
#[inline(always)]
fn crossed(a: &Lanes, b: &Lanes, c: &Lanes, d: &Lanes) -> Lanes {
    let mut found = [0.0; LANES];
    for l in 0..LANES {
        found[l] = a[l] * b[l] - c[l] * d[l];
    }
    found
}

/// Sets `lengths` to `|σ_u × σ_v|` at the nodes of a block along `u` and one along `v`. Returns `Σ w ⟨σ − origin, σ_u × σ_v⟩`.
#[inline(always)]
fn elements(rows: &Rows, block: usize, node: &Node, origin: [f64; 3], lengths: &mut Lanes) -> f64 {
    let [points, [ux, uy, uz], [vx, vy, vz]] = rows.jets(block, node);
    let normal = [crossed(&uy, &vz, &uz, &vy), crossed(&uz, &vx, &ux, &vz), crossed(&ux, &vy, &uy, &vx)];
    let [mut fluxes, mut squares] = [[0.0; LANES]; 2];
    for c in 0..3 {
        for l in 0..LANES {
            fluxes[l] += (points[c][l] - origin[c]) * normal[c][l];
        }
        for l in 0..LANES {
            squares[l] += normal[c][l] * normal[c][l];
        }
    }
    for l in 0..LANES {
        lengths[l] = squares[l].sqrt();
    }
    let weights = &rows.weights[block];
    for l in 0..LANES {
        fluxes[l] *= weights[l];
    }
    fluxes.iter().sum()
}

/// The area of all pieces: those whose error is above their share of the tolerance are quartered.
fn refined(surface: &Surface, rules: &[Rule; 2], pieces: Vec<Piece>) -> f64 {
    let about: f64 = pieces.iter().map(|piece| piece.area).sum();
    let allowed = MARGIN * AREA_TOLERANCE * about / pieces.len() as f64;
    let mut left = MAX_PIECES * pieces.len();
    let (mut total, mut waiting) = (0.0, Vec::new());
    for piece in pieces {
        waiting.push(piece);
        while let Some(piece) = waiting.pop() {
            if piece.error > allowed && piece.depth < MAX_HALVINGS && left > 0 {
                left -= 1;
                waiting.extend(piece.quarters(surface, rules));
            } else {
                total += piece.area;
            }
        }
    }
    total
}

impl Piece {
    fn quarters(&self, surface: &Surface, rules: &[Rule; 2]) -> [Self; 4] {
        let halves = self.places.map(|[low, high]| {
            let middle = 0.5 * (low + high);
            [[low, middle], [middle, high]]
        });
        [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[a, b]| {
            let places = [halves[0][a], halves[1][b]];
            let [nodes_u, nodes_v] = [0, 1]
                .map(|i| nodes_between(&rules[i].gauss, &surface.lines[i], surface.intervals(i), places[i]));
            let first = nodes_v.iter().map(|node| node.first).min().unwrap_or(0);
            let end = nodes_v.iter().map(|node| node.first + node.values.len()).max().unwrap_or(0);
            let rows = Rows::new(surface, &nodes_u, first..end);
            let mut elements = Elements::default();
            elements.fill(&rows, &rules[1], &nodes_v, [0.0; 3]);
            let [area, error] = elements.area(rules, 0, places, surface);
            Self { places, area, error, depth: self.depth + 1 }
        })
    }
}
