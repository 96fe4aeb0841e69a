//! Numerical fingerprint of a process, for checking whether two processes compute the same bits.
//!
//! Matrix products choose their instructions and block sizes by the processor, and elementary functions come from the
//! system. On machines of different kinds, the last bits of a sum can therefore differ.

use std::sync::LazyLock;

use super::dense::{Matrix, add_outer_products, multiply};

/// Number of rows of the products: more than a register tile, and not a multiple of one.
const ROWS: usize = 37;

/// Length of the sums in the products: longer than the blocks into which products are cut.
const COLUMNS: usize = 1500;

/// Digest of fixed products and functions, equal for processes that compute the same bits.
pub fn fingerprint() -> &'static str {
    static FINGERPRINT: LazyLock<String> = LazyLock::new(compute);
    &FINGERPRINT
}

fn compute() -> String {
    // Fractional parts of multiples of the golden ratio, which involve no function of the system.
    let x: Vec<f64> =
        (0..ROWS * COLUMNS).map(|k| (0.618_033_988_749_894_9 * k as f64).fract() - 0.4).collect();
    let mut outer = Matrix::zeros(ROWS, ROWS);
    add_outer_products(&mut outer, &x, 1.0);
    let wide = Matrix::from_column_slice(ROWS, COLUMNS, &x);
    let product = multiply(&wide, &wide.transpose());
    let functions = x[..ROWS].iter().flat_map(|x| [x.sin(), x.cos(), x.exp(), x.atan(), x.cbrt()]);
    let mut hasher = blake3::Hasher::new();
    outer.iter().chain(product.iter()).copied().chain(functions).for_each(|value| {
        hasher.update(&value.to_le_bytes());
    });
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fingerprint_is_the_same_every_time() {
        assert_eq!(compute(), fingerprint());
    }
}
