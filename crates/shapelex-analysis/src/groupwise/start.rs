//! The start: rotations of the parameters and poses that correspond best to the mean.
//!
//! Each shape begins where its first-order ellipsoid has its axes, with signs by its skewness: a position that depends on the shape
//! alone. Then rotations of the icosahedron, which permute the nodes, are tried against the mean, and the best are refined.

use shapelex_geometry::reparametrisation::Reparametrisation;
use shapelex_geometry::rotation::Rotation;
use shapelex_geometry::vector::cross;
use shapelex_numeric::dense::{Matrix, svd};

use super::domain::Domain;
use super::member::{Member, Penalty, Pose, nearest_pose, posed};
use super::model::Model;

/// Number of rotations that are refined.
const REFINED: usize = 3;
/// Steps of each.
const STEPS: usize = 8;
/// Relative decrease of the cost below which steps end.
const SETTLED: f64 = 1e-4;

/// Signs of three axes that keep a frame right-handed.
static TURNS: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];

/// Axes of the first-order ellipsoid of points at the nodes: in space, and on the parameter sphere, each a right-handed frame whose
/// third axis is the long one and whose second is the middle one.
pub(super) fn axes(domain: &Domain, points: &[[f64; 3]]) -> Option<[[[f64; 3]; 3]; 2]> {
    let weights = &domain.nodes.weights;
    let mean = centre(domain, points);
    let first = Matrix::from_fn(3, 3, |c, e| {
        let each = points.iter().zip(&domain.nodes.points).zip(weights);
        each.map(|((point, x), weight)| weight * (point[c] - mean[c]) * x[e]).sum()
    });
    let found = svd(first, true, true)?;
    let (left, right) = (found.u?, found.v_t?);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| found.singular_values[j].total_cmp(&found.singular_values[i]));
    let axis = |i: usize| ([0, 1, 2].map(|c| left[(c, i)]), [0, 1, 2].map(|c| right[(i, c)]));
    let frame = |z: [f64; 3], y: [f64; 3]| [cross(y, z), y, z];
    let (long, middle) = (axis(order[0]), axis(order[1]));
    let (space, sphere) = (frame(long.0, middle.0), frame(long.1, middle.1));
    let skew = space.map(|axis| {
        let along = |point: &[f64; 3]| (0..3).map(|c| axis[c] * (point[c] - mean[c])).sum::<f64>();
        points.iter().zip(weights).map(|(point, weight)| weight * along(point).powi(3)).sum::<f64>()
    });
    let value = |signs: &[f64; 3]| signs.iter().zip(skew).map(|(sign, skew)| sign * skew).sum::<f64>();
    let best =
        TURNS.iter().fold(&TURNS[0], |best, signs| if value(signs) > value(best) { signs } else { best });
    let signed = |frame: [[f64; 3]; 3]| [0, 1, 2].map(|e| frame[e].map(|part| best[e] * part));
    Some([signed(space), signed(sphere)])
}

fn centre(domain: &Domain, points: &[[f64; 3]]) -> [f64; 3] {
    let weighted = |c: usize| points.iter().zip(&domain.nodes.weights).map(|(p, w)| w * p[c]).sum();
    [weighted(0), weighted(1), weighted(2)]
}

impl Member {
    /// Puts the shape where its first-order ellipsoid has its axes.
    pub(super) fn settle(&mut self, domain: &Domain) {
        let points = self.points(domain, &self.map);
        if let Some([space, sphere]) = axes(domain, &points) {
            self.map = Reparametrisation::rotation(self.map.outer.after(Rotation::onto(sphere)));
            self.pose = space;
        }
        self.refresh(domain);
    }

    /// Searches the rotation of the parameters, with its pose, that is nearest to a mean (`Q` points, centred). Returns its cost
    /// under the isotropic `model` of the same mean.
    pub(super) fn search(&mut self, domain: &Domain, mean: &[[f64; 3]], model: &Model) -> f64 {
        let none = Penalty { weight: 0.0 };
        let points = self.points(domain, &self.map);
        let middle = centre(domain, &points);
        let mut found: Vec<(f64, usize, Pose)> = Vec::with_capacity(domain.symmetries.len());
        for (index, symmetry) in domain.symmetries.iter().enumerate() {
            let mut product = Matrix::zeros(3, 3);
            for ((target, &image), weight) in mean.iter().zip(&symmetry.image).zip(&domain.nodes.weights) {
                let point = points[image as usize];
                for c in 0..3 {
                    (0..3).for_each(|e| product[(c, e)] += weight * target[c] * (point[e] - middle[e]));
                }
            }
            if let Some((pose, score)) = nearest_pose(&product) {
                found.push((score, index, pose));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut best = self.clone();
        let mut least = best.descend(domain, model, none);
        for (_, index, pose) in found.into_iter().take(REFINED) {
            let mut other = self.clone();
            other.map.outer = other.map.outer.after(domain.symmetries[index].rotation);
            other.pose = pose;
            other.refresh(domain);
            let cost = other.descend(domain, model, none);
            if cost < (1.0 - SETTLED) * least {
                (best, least) = (other, cost);
            }
        }
        *self = best;
        least
    }

    /// Steps of rotation and pose until the cost settles.
    pub(super) fn descend(&mut self, domain: &Domain, model: &Model, penalty: Penalty) -> f64 {
        let mut cost = self.cost(model, penalty);
        for _ in 0..STEPS {
            let (next, fell) = self.step(domain, model, &[], penalty);
            if !fell || next > (1.0 - SETTLED) * cost {
                return next;
            }
            cost = next;
        }
        cost
    }

    /// Points at the nodes in the pose, centred.
    pub(super) fn placed(&self, domain: &Domain) -> Vec<[f64; 3]> {
        let points = self.points(domain, &self.map);
        let middle = centre(domain, &points);
        points.iter().map(|point| posed(&self.pose, [0, 1, 2].map(|c| point[c] - middle[c]))).collect()
    }
}
