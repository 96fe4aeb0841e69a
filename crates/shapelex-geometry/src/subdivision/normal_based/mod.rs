//! Interpolating subdivision of points with normals: every edge gets a new point and normal between those at its ends.
//!
//! ```text
//! u = (p₁ − p₀)/L,   L = |p₁ − p₀|,   sin αⱼ = |nⱼ·u|,   cos αⱼ = |u × nⱼ|
//! fⱼ = (u × nⱼ)/cos αⱼ,   f ∝ f₀ + f₁,   τⱼ = nⱼ × fⱼ                (binormals, tangents)
//! wⱼ = (ωⱼ + κ)/(1 + 2κ),   ω₀ = sin α₁/(sin α₀ + sin α₁),   ω₁ = 1 − ω₀,   hⱼ = 4wⱼ/(1 + cos αⱼ)
//! p = ½(p₀ + p₁) + ⅛L (h₀τ₀ − h₁τ₁),   t = 3/2 u − ¼(h₀τ₀ + h₁τ₁),   n ∝ f × t
//! ```
//!
//! `p` and `t` are the midpoint, and the direction there, of the cubic segment with the end tangents `L h₀τ₀` and `L h₁τ₁`. Old
//! points and normals do not change. Points of a circle or a sphere with radial normals give further such points, exactly. A
//! step commutes with similarities, including reflections, and with a change of sign of all normals.
//!
//! `u·t` is in `[1, 3/2]`, and the foot of `p` is between 1/4 and 3/4 of the edge. Limits in the plane have
//! continuous tangents, except for edges with exactly one normal orthogonal to them: these get `p` at a quarter of the edge,
//! step after step, and a corner at the other end, unless the balance `κ` is positive. Limits of meshes are smooth for
//! spheres; others have creases that show after three or four steps. Limits in space have continuous normals, not tangents.
//!
//! Source: *Normal-based interpolating subdivision for the geometric representation of deformable models*. Its factors
//! `L cos αⱼ` and `1/cos αⱼ` cancel, and its `sin α = √(1 − cos² α)` loses all digits where an edge is nearly flat; here
//! the sines are computed from the normals.
//!
//! * [`edge`] — the rule of one edge; [`steps`] — steps on polylines and meshes; [`normals`] — default normals and their check.

pub mod edge;
pub mod normals;
#[cfg(test)]
mod samples;
pub mod steps;

pub use self::edge::{corner, split};
pub use self::normals::{circle_normals, inconsistent, sphere_normals};
pub use self::steps::{corners, refine_edges, refine_polyline};

use crate::vector::norm;

/// Points with unit normals.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Oriented {
    /// Positions of the points.
    pub points: Vec<[f64; 3]>,
    /// Unit normals, one per point.
    pub normals: Vec<[f64; 3]>,
}

impl Oriented {
    /// Points with normals of any length, which are normalised.
    ///
    /// # Errors
    /// The first position where the point or the normal is missing, or the normal is zero or not finite.
    pub fn new(points: Vec<[f64; 3]>, normals: &[[f64; 3]]) -> Result<Self, usize> {
        let units: Vec<[f64; 3]> = normals.iter().map_while(|normal| direction(*normal, 0.0)).collect();
        if units.len() == normals.len() && units.len() == points.len() {
            Ok(Self { points, normals: units })
        } else {
            Err(units.len().min(points.len()))
        }
    }

    fn push(&mut self, (point, normal): ([f64; 3], [f64; 3])) {
        self.points.push(point);
        self.normals.push(normal);
    }

    fn with_capacity(count: usize) -> Self {
        Self { points: Vec::with_capacity(count), normals: Vec::with_capacity(count) }
    }
}

/// `v/|v|` if `|v|` is finite and larger than `least`.
fn direction(v: [f64; 3], least: f64) -> Option<[f64; 3]> {
    let length = norm(v);
    (length > least && length.is_finite()).then(|| v.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::samples::{EX, EY, EZ};
    use super::*;
    use crate::edge_fault::EdgeFault;
    use crate::vector::scaled;

    #[test]
    fn normals_are_unit_vectors() {
        for wrong in [[0.0; 3], [0.0, 2.0, 0.0], [f64::NAN; 3], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(split([0.0; 3], EY, EX, wrong, 0.0, Some(EZ)), Err(EdgeFault::NotUnit));
        }
        let points = vec![EX, EY, EZ];
        let made = Oriented::new(points.clone(), &[scaled(1e-200, EX), scaled(1e200, EY), EZ]).unwrap();
        assert_eq!(made, Oriented { points: points.clone(), normals: points.clone() });
        assert_eq!(Oriented::new(points.clone(), &[EX, [0.0; 3], EZ]), Err(1));
        assert_eq!(Oriented::new(points.clone(), &[EX, EY, [f64::NAN; 3]]), Err(2));
        assert_eq!(Oriented::new(points.clone(), &[EX, EY]), Err(2));
        assert_eq!(Oriented::new(points, &[EX; 4]), Err(3));
    }
}
