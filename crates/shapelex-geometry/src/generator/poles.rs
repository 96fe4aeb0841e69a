//! The poles `α` of exponential B-splines.

use std::f64::consts::PI;

use crate::GeometryError;
use shapelex_numeric::double_double::Real;

/// Poles of an exponential B-spline on the integer grid. The list is symmetric (`α = −α`) and closed under conjugation, so
/// it is stored as zeros, pairs and quadruples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Poles {
    /// Multiplicity of the pole 0.
    pub zeros: usize,
    /// `ω` of every pair `±jω`.
    pub trigonometric: Vec<f64>,
    /// `a` of every pair `±a`.
    pub hyperbolic: Vec<f64>,
    /// `(a, b)` of every quadruple `±a ± jb`.
    pub quadruples: Vec<(f64, f64)>,
}

/// Maximum real part for which the construction keeps its accuracy (two digits less beyond 5).
pub const MAX_REAL_PART: f64 = 10.0;

/// Maximum number of poles of a generator, up to which double-double arithmetic solves the interpolation systems.
pub const MAX_POLES: usize = 10;

impl Poles {
    /// `multiplicity` poles at zero: the polynomial B-spline of degree `multiplicity − 1`.
    pub fn zeros(multiplicity: usize) -> Self {
        Self { zeros: multiplicity, ..Self::default() }
    }

    /// Zeros and one pair `±jω`.
    pub fn trigonometric(zeros: usize, omega: f64) -> Self {
        Self { zeros, trigonometric: vec![omega], ..Self::default() }
    }

    /// Groups complex numbers `[re, im]`, in any order.
    ///
    /// # Errors
    /// [`GeometryError::Unpaired`] for the first number whose conjugate or negative is missing.
    pub fn from_list(list: &[[f64; 2]]) -> Result<Self, GeometryError> {
        let count = |re: f64, im: f64| list.iter().filter(|pole| **pole == [re, im]).count();
        for (index, &[re, im]) in list.iter().enumerate() {
            let partners = [(re, -im), (-re, -im)];
            if let Some(&missing) = partners.iter().find(|(a, b)| count(*a, *b) < count(re, im)) {
                return Err(GeometryError::Unpaired { index, pole: (re, im), missing });
            }
        }
        let mut poles = Self::default();
        for &[re, im] in list {
            match (re, im) {
                (0.0, 0.0) => poles.zeros += 1,
                (0.0, w) if w > 0.0 => poles.trigonometric.push(w),
                (a, 0.0) if a > 0.0 => poles.hyperbolic.push(a),
                (a, b) if a > 0.0 && b > 0.0 => poles.quadruples.push((a, b)),
                _ => {}
            }
        }
        Ok(poles)
    }

    /// One representative of every pair and quadruple, `(Re, Im) ≥ 0`, without the zeros.
    fn representatives(&self) -> impl Iterator<Item = (f64, f64)> {
        let imaginary = self.trigonometric.iter().map(|&w| (0.0, w));
        let real = self.hyperbolic.iter().map(|&a| (a, 0.0));
        imaginary.chain(real).chain(self.quadruples.iter().copied())
    }

    /// The same poles on a grid `factor` times as fine: every pole divided by `factor`.
    pub fn refined(&self, factor: f64) -> Self {
        let divide = |list: &[f64]| list.iter().map(|value| value / factor).collect();
        Self {
            zeros: self.zeros,
            trigonometric: divide(&self.trigonometric),
            hyperbolic: divide(&self.hyperbolic),
            quadruples: self.quadruples.iter().map(|(a, b)| (a / factor, b / factor)).collect(),
        }
    }

    /// Number of poles, which is the order of the B-spline.
    pub fn order(&self) -> usize {
        self.zeros + 2 * (self.trigonometric.len() + self.hyperbolic.len()) + 4 * self.quadruples.len()
    }

    /// `max |α_n|`.
    pub(super) fn radius(&self) -> f64 {
        self.representatives().map(|(re, im)| re.hypot(im)).fold(0.0, f64::max)
    }

    /// The pole nearest to the border of the admissible domain; 0 if all poles are zero.
    pub fn outermost(&self) -> (f64, f64) {
        self.representatives()
            .fold((0.0, 0.0), |worst, pole| if pole.1.abs() > worst.1.abs() { pole } else { worst })
    }

    /// Checks that `|Im α| < π`, where the shifts form a Riesz basis and every tested interpolation system is solvable, and
    /// that `|Re α|` is within [`MAX_REAL_PART`].
    ///
    /// Outside, `α_m − α_n` may be a multiple of `2πj` (no Riesz basis), and the interpolators of `(0, ±jω*)` with
    /// `ω* = 8.98681891…`, `tan(ω*/2) = ω*/2`, do not exist even though the Riesz condition holds.
    ///
    /// # Errors
    /// [`GeometryError::Pole`] with a pole that is outside.
    pub fn check(&self) -> Result<(), GeometryError> {
        let outside = |&(re, im): &(f64, f64)| !(im.abs() < PI && re.abs() <= MAX_REAL_PART);
        match self.representatives().find(outside) {
            Some((re, im)) => Err(GeometryError::Pole { re, im }),
            None => Ok(()),
        }
    }

    /// Coefficients `a_0 … a_N` of `L(s)` in ascending powers, with `a_N = 1`.
    pub fn characteristic_polynomial<T: Real>(&self) -> Vec<T> {
        let (one, zero) = (T::from(1.0), T::from(0.0));
        let square = |x: f64| T::from(x) * T::from(x);
        let mut a = vec![one];
        for _ in 0..self.zeros {
            a = multiply(&a, &[zero, one]);
        }
        for &w in &self.trigonometric {
            a = multiply(&a, &[square(w), zero, one]);
        }
        for &h in &self.hyperbolic {
            a = multiply(&a, &[-square(h), zero, one]);
        }
        for &(re, im) in &self.quadruples {
            let (r, p) = (square(re) + square(im), T::from(2.0) * T::from(re));
            a = multiply(&multiply(&a, &[r, -p, one]), &[r, p, one]);
        }
        a
    }

    /// Coefficients `d_0 … d_N` of the annihilating filter `Δ(z) = Π (1 − e^{α_n} z⁻¹)`.
    pub fn annihilator<T: Real>(&self) -> Vec<T> {
        let (one, two) = (T::from(1.0), T::from(2.0));
        let mut d = vec![one];
        for _ in 0..self.zeros {
            d = multiply(&d, &[one, -one]);
        }
        for &w in &self.trigonometric {
            d = multiply(&d, &[one, -(two * T::from(w).cosine()), one]);
        }
        for &h in &self.hyperbolic {
            let e = T::from(h).exponential();
            d = multiply(&d, &[one, -(e + one / e), one]);
        }
        for &(re, im) in &self.quadruples {
            for sign in [1.0, -1.0] {
                let e = T::from(sign * re).exponential();
                d = multiply(&d, &[one, -(two * e * T::from(im).cosine()), e * e]);
            }
        }
        d
    }

    /// Integral of the B-spline, `∫ β_α = Π sinc²(ω/2) · Π (sinh(a/2)/(a/2))² · Π |(e^z − 1)/z|² |(e^{−z} − 1)/z|²`.
    pub fn integral(&self) -> f64 {
        let trigonometric: f64 = self.trigonometric.iter().map(|w| sinc(w / 2.0).powi(2)).product();
        let hyperbolic: f64 = self.hyperbolic.iter().map(|a| sinhc(a / 2.0).powi(2)).product();
        let quadruples: f64 = self
            .quadruples
            .iter()
            .map(|&(a, b)| {
                // |e^z − 1|² = (e^a − 1)² + 4 e^a sin²(b/2)
                let half = 4.0 * (b / 2.0).sin().powi(2);
                let numerator = |a: f64| a.exp_m1().powi(2) + a.exp() * half;
                numerator(a) * numerator(-a) / (a * a + b * b).powi(2)
            })
            .product();
        trigonometric * hyperbolic * quadruples
    }

    /// The poles as a list of `[re, im]`, zeros first.
    pub fn list(&self) -> Vec<[f64; 2]> {
        let mut list = vec![[0.0, 0.0]; self.zeros];
        list.extend(self.trigonometric.iter().flat_map(|&w| [[0.0, w], [0.0, -w]]));
        list.extend(self.hyperbolic.iter().flat_map(|&a| [[a, 0.0], [-a, 0.0]]));
        list.extend(self.quadruples.iter().flat_map(|&(a, b)| [[a, b], [a, -b], [-a, b], [-a, -b]]));
        list
    }
}

/// `sin x / x`.
fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

fn sinhc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sinh() / x }
}

pub(super) fn multiply<T: Real>(a: &[T], b: &[T]) -> Vec<T> {
    let mut product = vec![T::from(0.0); a.len() + b.len() - 1];
    for (i, &x) in a.iter().enumerate() {
        for (j, &y) in b.iter().enumerate() {
            product[i + j] = product[i + j] + x * y;
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_sorted_into_pairs() {
        let list = [[0.5, 1.0], [0.0, 0.0], [-0.5, 1.0], [0.0, -2.0], [0.5, -1.0], [0.0, 2.0], [-0.5, -1.0]];
        let poles = Poles::from_list(&list).unwrap();
        assert_eq!((poles.zeros, poles.order()), (1, 7));
        assert_eq!((poles.trigonometric.clone(), poles.quadruples.clone()), (vec![2.0], vec![(0.5, 1.0)]));
        assert_eq!(Poles::from_list(&poles.list()).unwrap(), poles);
    }

    #[test]
    fn missing_partners_are_named() {
        let missing = |list: &[[f64; 2]]| match Poles::from_list(list) {
            Err(GeometryError::Unpaired { index, missing, .. }) => (index, missing),
            other => panic!("{other:?}"),
        };
        assert_eq!(missing(&[[0.0, 0.0], [0.0, 1.0]]), (1, (0.0, -1.0)));
        assert_eq!(missing(&[[1.0, 0.0]]), (0, (-1.0, 0.0)));
        assert_eq!(missing(&[[0.0, 1.0], [0.0, 1.0], [0.0, -1.0]]), (0, (0.0, -1.0)));
        assert_eq!(missing(&[[1.0, 1.0], [1.0, -1.0]]), (0, (-1.0, -1.0)));
    }
}
