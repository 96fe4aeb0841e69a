//! Quantiles of sorted values, and of Student's distribution.

/// Quantile of ascending values, with linear interpolation.
pub(crate) fn quantile(sorted: &[f64], q: f64) -> f64 {
    let position = q * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

/// Quantile of Student's `t` with `freedom` degrees of freedom, for levels of at least 0.5.
///
/// ```text
/// tan θ = t/√ν;  P(|T| ≤ t) = sin θ (1 + ½ cos² θ + 1·3/(2·4) cos⁴ θ + …)                           ν even, up to cos^(ν−2)
///                P(|T| ≤ t) = (2/π) (θ + sin θ (cos θ + ⅔ cos³ θ + 2·4/(3·5) cos⁵ θ + …))            ν odd, up to cos^(ν−2)
/// ```
///
/// Source: Abramowitz and Stegun 1964, 26.7.3 and 26.7.4.
pub(crate) fn student_quantile(level: f64, freedom: usize) -> f64 {
    let within = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let odd = freedom % 2 == 1;
        let (first, terms) = if odd { (cos, (freedom - 1) / 2) } else { (1.0, freedom / 2) };
        let next = |term: &mut f64, k: usize| {
            let own = *term;
            let k = 2.0 * k as f64 + if odd { 2.0 } else { 1.0 };
            *term *= cos * cos * k / (k + 1.0);
            Some(own)
        };
        let series = (0..terms).scan(first, next).take_while(|term| *term > 1e-18);
        let sum = sin * series.sum::<f64>();
        if odd { (angle + sum) / std::f64::consts::FRAC_PI_2 } else { sum }
    };
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if within(middle) < 2.0 * level - 1.0 { low = middle } else { high = middle }
    }
    (freedom as f64).sqrt() * (0.5 * (low + high)).tan()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_between_neighbours() {
        let sorted = [1.0, 2.0, 4.0];
        let found = [0.0, 0.25, 0.5, 0.75, 1.0].map(|q| quantile(&sorted, q));
        assert_eq!(found, [1.0, 1.5, 2.0, 3.0, 4.0]);
        assert_eq!(quantile(&[7.0], 0.95), 7.0);
    }

    #[test]
    fn quantiles_of_student_are_those_of_tables() {
        for (level, freedom, wanted) in [
            (0.975, 1, 12.706_204_736_174_7),
            (0.975, 2, 4.302_652_729_749_46),
            (0.95, 3, 2.353_363_434_801_82),
            (0.975, 20, 2.085_963_447_265_86),
            (0.995, 31, 2.744_041_919_294_2),
            (0.975, 100_000, 1.959_987_708_4),
        ] {
            let found = student_quantile(level, freedom);
            assert!((found / wanted - 1.0).abs() < 1e-9, "{level} {freedom}: {found} for {wanted}");
        }
    }
}
