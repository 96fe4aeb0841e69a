//! Phantoms that can be made again: noise, rods, a hollow cylinder, a nucleus, a head.

use std::f64::consts::TAU;

use shapelex_segmentation::field::Image;

/// Uniform numbers in `[0, 1)` by SplitMix64.
pub(crate) fn uniform(seed: u64) -> impl Iterator<Item = f64> {
    (1_u64..).map(move |i| {
        let mut z = seed.wrapping_add(i.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 * (0.5_f64).powi(53)
    })
}

/// Normal numbers by Box and Muller, two from each pair of uniform numbers.
pub(crate) fn normal(seed: u64) -> impl Iterator<Item = f64> {
    let mut uniform = uniform(seed);
    std::iter::from_fn(move || {
        let (radius, angle) = ((-2.0 * (1.0 - uniform.next()?).ln()).sqrt(), TAU * uniform.next()?);
        Some([radius * angle.cos(), radius * angle.sin()])
    })
    .flatten()
}

/// An image of a function of the indices.
pub(crate) fn image(size: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Image {
    let cell = |at: usize| [at % size[0], at / size[0] % size[1], at / size[0] / size[1]].map(|i| i as f64);
    Image::new(size, (0..size.iter().product()).map(|at| value(cell(at))).collect()).expect("an image")
}

/// The image with noise of a standard deviation, x fastest.
pub(crate) fn noisy(image: &Image, std: f64, seed: u64) -> Image {
    let values = image.values().iter().zip(normal(seed)).map(|(value, noise)| value + std * noise);
    Image::new(image.size(), values.collect()).expect("an image")
}

/// A rod: centre, half length of the axis, radius, direction in degrees, intensity.
pub(crate) struct Rod {
    pub(crate) centre: [f64; 2],
    pub(crate) half: f64,
    pub(crate) radius: f64,
    pub(crate) degrees: f64,
    intensity: f64,
}

const RODS: [[f64; 6]; 19] = [
    [40.0, 40.0, 12.0, 7.0, 20.0, 200.0],
    [110.0, 34.0, 14.0, 8.0, -35.0, 150.0],
    [190.0, 40.0, 9.0, 6.0, 80.0, 230.0],
    [226.0, 82.0, 12.0, 7.0, 15.0, 110.0],
    [34.0, 110.0, 13.0, 7.0, 75.0, 170.0],
    [52.0, 114.5, 13.0, 7.0, 75.0, 170.0],
    [70.5, 116.0, 12.0, 7.0, 84.0, 120.0],
    [122.0, 104.0, 14.0, 8.0, 10.0, 210.0],
    [124.0, 121.5, 13.0, 7.5, 6.0, 180.0],
    [186.0, 128.0, 12.0, 7.0, 45.0, 140.0],
    [199.0, 117.0, 12.0, 7.0, 45.0, 190.0],
    [212.0, 107.0, 11.0, 6.5, 52.0, 160.0],
    [48.0, 186.0, 13.0, 8.0, -20.0, 220.0],
    [66.0, 205.0, 12.0, 7.0, 62.0, 150.0],
    [130.0, 180.0, 15.0, 8.0, 90.0, 130.0],
    [149.0, 182.0, 13.0, 8.0, 84.0, 180.0],
    [118.0, 214.0, 12.0, 7.0, -8.0, 200.0],
    [205.0, 190.0, 14.0, 8.0, -60.0, 240.0],
    [222.0, 199.0, 12.0, 7.0, -62.0, 100.0],
];

pub(crate) fn rods() -> Vec<Rod> {
    let rod = |[x, y, half, radius, degrees, intensity]: [f64; 6]| Rod {
        centre: [x, y],
        half,
        radius,
        degrees,
        intensity,
    };
    RODS.map(rod).into()
}

impl Rod {
    /// Distance from the surface, negative inside.
    pub(crate) fn distance(&self, x: f64, y: f64) -> f64 {
        let (sine, cosine) = self.degrees.to_radians().sin_cos();
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let along = (dx * cosine + dy * sine).clamp(-self.half, self.half);
        (dx - along * cosine).hypot(dy - along * sine) - self.radius
    }
}

/// Background of the rods.
const GROUND: f64 = 20.0;

/// The rods, 256 × 256, with noise, rounded to 8 bits.
pub(crate) fn rod_image(std: f64, seed: u64) -> Image {
    let rods = rods();
    let value = |[x, y, _]: [f64; 3]| {
        let one = |rod: &Rod| GROUND + (rod.intensity - GROUND) * (0.5 - rod.distance(x, y)).clamp(0.0, 1.0);
        rods.iter().map(one).fold(GROUND, f64::max)
    };
    // Halves are rounded to even, as in the program that made the vectors.
    noisy(&image([256, 256, 1], value), std, seed).map(|value| value.round_ties_even().clamp(0.0, 255.0))
}

/// The wall of a hollow cylinder, 100³, without clipping.
pub(crate) fn hollow_cylinder(std: f64, seed: u64) -> Image {
    let value = |[x, y, z]: [f64; 3]| {
        let radius = (x - 49.5).hypot(y - 49.5);
        let wall = (0.5 + (radius - 14.0).min(16.0 - radius)).clamp(0.0, 1.0);
        if (10.0..=89.0).contains(&z) { 255.0 * wall } else { 0.0 }
    };
    noisy(&image([100; 3], value), std, seed)
}

/// Whether a voxel is in the lumen of the hollow cylinder.
pub(crate) fn in_lumen([x, y, z]: [f64; 3]) -> bool {
    (x - 49.5).hypot(y - 49.5) <= 14.0 && (10.0..=89.0).contains(&z)
}

/// Distance from the surface of a ball (`bumpy = false`) or a nucleus along the ray from the centre, negative inside.
pub(crate) fn nucleus_distance([x, y, z]: [f64; 3], bumpy: bool) -> f64 {
    let (x, y, z) = (x - 31.3, y - 30.6, z - 32.2);
    let r = x.hypot(y).hypot(z);
    let [u, v, w] = [x, y, z].map(|c| c / (r + 1e-9));
    let legendre = (0.15 * (3.0 * w * w - 1.0), 0.10 * (5.0 * w.powi(3) - 3.0 * w));
    let lobes = 0.08 * (3.0 * v.atan2(u)).cos() * (1.0 - w * w).max(0.0).powf(1.5);
    let factor = 1.0 + 0.54 * u * v - 0.5 * legendre.0 + 0.5 * legendre.1 + lobes;
    r - if bumpy { 18.0 * factor } else { 18.0 }
}

/// A ball or a nucleus, 64³, with noise of seed 9.
pub(crate) fn nucleus(bumpy: bool, std: f64) -> Image {
    let value = |at: [f64; 3]| 40.0 + 140.0 * (0.5 - nucleus_distance(at, bumpy)).clamp(0.0, 1.0);
    noisy(&image([64; 3], value), std, 9)
}

/// Signed distance in mm from the surface of the brain of the head phantom.
pub(crate) fn head_distance([i, j, k]: [f64; 3]) -> f64 {
    let [x, y, z] = [(i - 45.0) * 2.0, (j - 54.0) * 2.0, (k - 45.0) * 2.0];
    let r = (x * x + y * y + z * z).sqrt() + 1e-9;
    let [u, v, w] = [x / r, y / r, z / r];
    let b = 1.0 + 0.04 * (3.0 * v.atan2(u)).cos() * (1.0 - w * w).max(0.0).powf(1.5)
        - 0.025 * (5.0 * w.powi(3) - 3.0 * w);
    r - b / ((u / 65.0).powi(2) + (v / 80.0).powi(2) + (w / 60.0).powi(2)).sqrt()
}

/// Intensity of the head at a position in voxels of 2 mm.
pub(crate) fn head_value(at: [f64; 3]) -> f64 {
    let [x, y, z] = [(at[0] - 45.0) * 2.0, (at[1] - 54.0) * 2.0, (at[2] - 45.0) * 2.0];
    match head_distance(at) {
        d if d <= 0.0 => 150.0 + 30.0 * (x / 9.0).sin() * (y / 11.0).sin() * (z / 10.0).sin(),
        d if d <= 3.0 => 220.0,
        d if d <= 9.0 => 25.0,
        d if d <= 15.0 => 150.0,
        _ => 10.0,
    }
}

/// The head, 91 × 109 × 91 voxels of 2 mm; noise in per cent of 220, seed 100; a smooth factor with a range of `inu` around 1.
pub(crate) fn head(percent: f64, inu: f64) -> Image {
    let clean = image([91, 109, 91], head_value);
    degraded(&clean, percent / 100.0 * 220.0, inu)
}

/// A volume under a smooth factor of this range, then with noise.
pub(crate) fn degraded(clean: &Image, std: f64, inu: f64) -> Image {
    let size = clean.size();
    let mut values = clean.values().to_vec();
    if inu > 0.0 {
        let wave = image(size, |at| {
            let [x, y, z] = [0, 1, 2].map(|c| at[c] / ((size[c] - 1) as f64 / 2.0) - 1.0);
            (1.3 * x + 0.4).cos() * (1.1 * y - 0.3).cos() * (0.9 * z + 0.2).cos()
        });
        let [low, high] = [wave.percentile(0.0), wave.percentile(100.0)];
        let factor = |g: &f64| 1.0 + inu * ((g - low) / (high - low) - 0.5);
        values.iter_mut().zip(wave.values()).for_each(|(value, g)| *value *= factor(g));
    }
    let smooth = Image::new(size, values).expect("an image");
    if std > 0.0 { noisy(&smooth, std, 100) } else { smooth }
}
