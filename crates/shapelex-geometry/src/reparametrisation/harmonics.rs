//! Real spherical harmonics as homogeneous polynomials, with gradients and second derivatives.
//!
//! ```text
//! R_m^m = −(x + iy)/(2m) R_{m−1}^{m−1},   (l² − m²) R_l^m = (2l − 1) z R_{l−1}^m − r² R_{l−2}^m
//! ∂_z R_l^m = R_{l−1}^m,   (∂_x + i∂_y) R_l^m = R_{l−1}^{m+1},   (∂_x − i∂_y) R_l^m = −R_{l−1}^{m−1}
//! ```
//!
//! `Y` are the real and imaginary parts of `R_l^m`, scaled so that the mean of `Y²` over the unit sphere is 1.

/// Values and derivatives of all harmonics of degree 1 to [`Table::degree`] at one point.
#[derive(Debug, Clone)]
pub struct Table {
    degree: usize,
    /// `R_l^m` for `m ≥ 0`, at `l (l + 1)/2 + m`.
    solid: Vec<[f64; 2]>,
    /// Degree, order, part (real or imaginary) and scale of every harmonic.
    list: Vec<(usize, i32, usize, f64)>,
}

/// Number of harmonics of degree 1 to `degree`.
pub const fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 1) - 1
}

/// Degree of the harmonic with this index.
pub fn degree_of(index: usize) -> usize {
    (index + 1).isqrt()
}

impl Table {
    /// A table for harmonics up to `degree`, not yet filled.
    pub fn new(degree: usize) -> Self {
        let mut list = Vec::with_capacity(count(degree));
        for l in 1..=degree {
            for m in 0..=l {
                // (l − m)! (l + m)!, times 2 for the parts of a complex harmonic.
                let factorials = (1..=l - m).chain(1..=l + m).map(|i| i as f64).product::<f64>();
                let parts = if m == 0 { 1 } else { 2 };
                let scale = (parts as f64 * (2 * l + 1) as f64 * factorials).sqrt();
                list.extend((0..parts).map(|part| (l, m as i32, part, scale)));
            }
        }
        Self { degree, solid: vec![[0.0; 2]; (degree + 1) * (degree + 2) / 2], list }
    }

    /// Highest degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Number of harmonics.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Moves the table to a point.
    pub fn fill(&mut self, [x, y, z]: [f64; 3]) {
        let square = x * x + y * y + z * z;
        let at = |l: usize, m: usize| l * (l + 1) / 2 + m;
        let solid = &mut self.solid;
        solid[0] = [1.0, 0.0];
        for m in 0..=self.degree {
            if m > 0 {
                let [re, im] = solid[at(m - 1, m - 1)];
                let factor = -0.5 / m as f64;
                solid[at(m, m)] = [factor * (x * re - y * im), factor * (x * im + y * re)];
            }
            for l in m + 1..=self.degree {
                let before = solid[at(l - 1, m)];
                let earlier = if l >= m + 2 { solid[at(l - 2, m)] } else { [0.0; 2] };
                let over = ((l + m) * (l - m)) as f64;
                let [a, b] = [(2 * l - 1) as f64 * z / over, square / over];
                solid[at(l, m)] = [a * before[0] - b * earlier[0], a * before[1] - b * earlier[1]];
            }
        }
    }

    /// `R_l^m` for any order; 0 beyond `|m| ≤ l`.
    fn of(&self, l: i32, m: i32) -> [f64; 2] {
        if l < 0 || m.abs() > l {
            return [0.0; 2];
        }
        let [re, im] = self.solid[(l * (l + 1) / 2 + m.abs()) as usize];
        match m {
            0.. => [re, im],
            _ if m % 2 == 0 => [re, -im],
            _ => [-re, im],
        }
    }

    /// `Y` with this index.
    pub fn value(&self, index: usize) -> f64 {
        let (l, m, part, scale) = self.list[index];
        scale * self.of(l as i32, m)[part]
    }

    /// Gradient of the polynomial `Y` in space.
    pub fn gradient(&self, index: usize) -> [f64; 3] {
        let (l, m, part, scale) = self.list[index];
        let l = l as i32 - 1;
        let (a, b, c) = (self.of(l, m + 1), self.of(l, m - 1), self.of(l, m));
        // ∂_x = ½ (a − b),   ∂_y = −½ i (a + b)
        let half = 0.5 * scale;
        let y = if part == 0 { a[1] + b[1] } else { -a[0] - b[0] };
        [half * (a[part] - b[part]), half * y, scale * c[part]]
    }

    /// Second derivatives of the polynomial `Y`: `xx, xy, xz, yy, yz, zz`.
    pub fn second(&self, index: usize) -> [f64; 6] {
        let (l, m, part, scale) = self.list[index];
        let l = l as i32 - 2;
        let (p, q, r) = (self.of(l, m + 2), self.of(l, m), self.of(l, m - 2));
        let (up, down) = (self.of(l, m + 1), self.of(l, m - 1));
        // −i w: its real part is the imaginary part of w, its imaginary part minus the real part.
        let turned = |w: [f64; 2]| if part == 0 { w[1] } else { -w[0] };
        let quarter = 0.25 * scale;
        [
            quarter * (p[part] - 2.0 * q[part] + r[part]),
            quarter * turned([p[0] - r[0], p[1] - r[1]]),
            0.5 * scale * (up[part] - down[part]),
            -quarter * (p[part] + 2.0 * q[part] + r[part]),
            0.5 * scale * turned([up[0] + down[0], up[1] + down[1]]),
            scale * q[part],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_differences_and_harmonic() {
        let mut table = Table::new(6);
        assert_eq!((table.len(), count(6), degree_of(0), degree_of(2), degree_of(3)), (48, 48, 1, 1, 2));
        let point = [0.3, -0.5, 0.7];
        let step = 1e-5;
        let at = |table: &mut Table, c: usize, by: f64| {
            let mut moved = point;
            moved[c] += by;
            table.fill(moved);
        };
        for index in 0..table.len() {
            for c in 0..3 {
                at(&mut table, c, step);
                let (value, gradient) = (table.value(index), table.gradient(index));
                at(&mut table, c, -step);
                let (value_before, gradient_before) = (table.value(index), table.gradient(index));
                table.fill(point);
                let expected = (value - value_before) / (2.0 * step);
                assert!((table.gradient(index)[c] - expected).abs() < 1e-7, "{index} {c}");
                let second = table.second(index);
                for e in 0..3 {
                    let place = [[0, 1, 2], [1, 3, 4], [2, 4, 5]][c][e];
                    let expected = (gradient[e] - gradient_before[e]) / (2.0 * step);
                    assert!((second[place] - expected).abs() < 1e-6, "{index} {c} {e}");
                }
            }
            let second = table.second(index);
            assert!((second[0] + second[3] + second[5]).abs() < 1e-10);
        }
    }
}
