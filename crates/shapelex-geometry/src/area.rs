//! Area that a closed planar curve encloses, by products of its polynomials.
//!
//! ```text
//! ½ ∮ x dy − y dx = Σ_h Σ_{m<n, m+n odd} (n − m)/(n + m) · (x_h[m] y_h[n] − y_h[m] x_h[n])
//! ```

use super::columns::{Columns, LANES, Lanes, place};
use shapelex_numeric::lanes::vectorised;

/// Signed area of a closed planar curve, counter-clockwise positive; exact up to rounding. Relative to the first point of the
/// curve, so that a shape far from the origin keeps its digits. Cost `O(M n²)`.
pub(crate) fn signed_area(curve: &Columns) -> f64 {
    let terms = curve.terms();
    let origin = first_point(curve);
    let pairs = (0..terms).flat_map(|m| (m + 1..terms).step_by(2).map(move |n| (m, n)));
    let products: Vec<_> = pairs.map(|(m, n)| (m, n, (n - m) as f64 / (n + m) as f64)).collect();
    let mut areas = vec![[0.0; LANES]; curve.blocks().len()];
    vectorised(
        #[inline(always)]
        || {
            for (area, block) in areas.iter_mut().zip(curve.blocks()) {
                *area = swept(block, &products, origin);
            }
        },
    );
    (0..curve.halves()).map(place).map(|(block, lane)| areas[block][lane]).sum()
}

/// `r(0)`, where `s = −1`.
fn first_point(curve: &Columns) -> [f64; 2] {
    [0, 1].map(|c| curve.taylor(0, c).rfold(0.0, |sum, value| value - sum))
}

/// Area between `origin` and every half-segment of a block; `products` are terms with their weight.
#[inline(always)]
fn swept(block: &[Lanes], products: &[(usize, usize, f64)], origin: [f64; 2]) -> Lanes {
    let (x, y) = block.split_at(block.len() / 2);
    let mut sum = [0.0; LANES];
    for &(m, n, weight) in products {
        let [a, b] = if m == 0 { origin } else { [0.0; 2] };
        for lane in 0..LANES {
            sum[lane] += weight * ((x[m][lane] - a) * y[n][lane] - (y[m][lane] - b) * x[n][lane]);
        }
    }
    sum
}
