//! Block-sparse codes: optimality, equality with the lasso, recovery, invariance, degenerate blocks, warm starts.

use proptest::prelude::*;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::sparse::{Atoms, Coder, Encode, GroupLasso, Lasso, Pursuit, SparseCode};
use shapelex_numeric::dense::{Matrix, multiply};

/// A linear congruential generator: the same numbers everywhere.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }

    fn matrix(&mut self, rows: usize, columns: usize) -> Matrix {
        Matrix::from_fn(rows, columns, |_, _| self.next())
    }

    /// Blocks of `b` columns that are orthonormal up to a factor, which differs between blocks.
    fn blocks(&mut self, n: usize, atoms: usize, b: usize) -> Matrix {
        let mut all = Matrix::zeros(n, atoms * b);
        for j in 0..atoms {
            let scale = 1.0 - 0.6 * (self.next() + 0.5);
            all.columns_mut(j * b, b).copy_from(&(self.matrix(n, b).qr().q() * scale));
        }
        all
    }
}

/// Sizes with at least `b` rows, and a seed.
fn sizes() -> impl Strategy<Value = (usize, usize, usize, u64)> {
    (1_usize..5, 0_usize..10, 1_usize..12, any::<u64>())
        .prop_map(|(b, more, atoms, seed)| (b + more, atoms, b, seed))
}

fn norm(a: &[f64]) -> f64 {
    a.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// To a relative gap of 1e-12.
fn group_lasso(lambda: f64) -> GroupLasso {
    GroupLasso { tolerance: 1e-12, ..GroupLasso::new(lambda) }
}

/// `Dᵀ(x − Da)`.
fn residual_correlations(atoms: &Matrix, x: &[f64], code: &SparseCode) -> Vec<f64> {
    let dense = Matrix::from_column_slice(atoms.ncols(), 1, &code.dense(atoms.ncols()));
    let residual = Matrix::from_column_slice(x.len(), 1, x) - atoms * dense;
    atoms.tr_mul(&residual).as_slice().to_vec()
}

/// `U_jᵀr = λ a_j/‖a_j‖` on blocks in use, `‖U_jᵀr‖ ≤ λ` elsewhere.
fn assert_optimal(atoms: &Atoms, x: &[f64], code: &SparseCode, lambda: f64) {
    // A gap of 1e-12 of ‖x‖²/2 leaves half of its digits in the correlations.
    let (tolerance, b) = (1e-5 * norm(x), atoms.block());
    let dense = code.dense(atoms.matrix().ncols());
    let residual = residual_correlations(atoms.matrix(), x, code);
    for (j, (r, a)) in residual.chunks(b).zip(dense.chunks(b)).enumerate() {
        assert_eq!(norm(a) > 0.0, code.indices.contains(&j));
        if norm(a) > 0.0 {
            let length = norm(a);
            let error: Vec<f64> = r.iter().zip(a).map(|(r, a)| r - lambda * a / length).collect();
            // The gap contains ‖a‖λ(1 − cos θ) for the angle θ between a_j and U_jᵀr, and λθ is the error: what a short
            // block adds to the objective leaves its direction open.
            let tolerance = tolerance.max((2.0 * lambda * 0.5e-12 * norm(x).powi(2) / length).sqrt());
            assert!(norm(&error) <= tolerance, "block {j}: {r:?} for {a:?}, λ = {lambda}");
        } else {
            assert!(norm(r) <= lambda + tolerance, "block {j}: {} above {lambda}", norm(r));
        }
    }
}

proptest! {
    #[test]
    fn group_codes_satisfy_the_optimality_conditions((n, j, b, seed) in sizes(), fraction in 0.01..0.95) {
        let mut numbers = Numbers(seed);
        let atoms = Atoms::blocks(numbers.blocks(n, j, b), b);
        let shapes = numbers.matrix(n, 4);
        for x in shapes.as_slice().chunks_exact(n) {
            let coder = group_lasso(fraction * atoms.lambda_max(x));
            let code = &coder.codes(&atoms, x).unwrap()[0];
            assert_optimal(&atoms, x, code, coder.lambda);
            let energy = norm(x).powi(2);
            prop_assert!(code.duality_gap.unwrap() <= 0.5e-12 * energy);
            prop_assert_eq!(code.parameters(), b * code.indices.len());
            // objective and error are what they say
            let error = code.relative_error.powi(2) * energy;
            let penalty = Coder::GroupLasso(coder).penalty(code, b);
            prop_assert!((0.5 * error + penalty - code.objective).abs() <= 1e-12 * energy);
        }
    }

    #[test]
    fn blocks_of_one_column_are_the_lasso((n, j, _, seed) in sizes(), fraction in 0.02..0.95) {
        let mut numbers = Numbers(seed);
        let atoms = Atoms::new(numbers.blocks(n, j, 1));
        let x = numbers.matrix(n, 1);
        let lambda = fraction * atoms.lambda_max(x.as_slice());
        let group = &group_lasso(lambda).codes(&atoms, x.as_slice()).unwrap()[0];
        let lasso = Lasso { tolerance: 1e-12, ..Lasso::new(lambda, false) };
        let lasso = &lasso.codes(&atoms, x.as_slice()).unwrap()[0];
        let energy = x.norm_squared();
        prop_assert!((group.objective - lasso.objective).abs() <= 1e-12 * energy);
        // The reconstruction of a lasso is unique, half of the digits of the gap.
        prop_assert!((group.relative_error - lasso.relative_error).abs() <= 1e-5);
    }

    #[test]
    fn a_block_pursuit_fits_what_it_uses((n, j, b, seed) in sizes()) {
        let mut numbers = Numbers(seed);
        let atoms = Atoms::blocks(numbers.blocks(n, j, b), b);
        let x = numbers.matrix(n, 1);
        let mut before = 1.0;
        for nonzeros in 0..=j {
            let code = &Pursuit { nonzeros }.codes(&atoms, x.as_slice()).unwrap()[0];
            prop_assert!(code.indices.len() <= nonzeros && code.values.len() == b * code.indices.len());
            prop_assert!(code.relative_error <= before + 1e-7, "{} after {before}", code.relative_error);
            before = code.relative_error;
            let residual = residual_correlations(atoms.matrix(), x.as_slice(), code);
            let used = code.indices.iter().flat_map(|&j| &residual[j * b..(j + 1) * b]);
            for (r, value) in used.zip(&code.values) {
                // The condition number κ of the columns in use may be 1e4. A column that is within 1e-4 of the others stays
                // out, with a product with what is left of at most that part of it; what is left has a rounding error of κ²ε for
                // each column, as the solution of normal equations.
                let rounding = 1e8 * f64::EPSILON * code.values.len() as f64;
                let part = if *value == 0.0 { 1e-4 * code.relative_error + rounding } else { 0.0 };
                prop_assert!(r.abs() <= (1e-8 + part) * x.norm(), "{r:e} of {value:e}");
            }
        }
    }

    /// No other atom, joined with those chosen before, leaves less of the shape.
    #[test]
    fn a_block_pursuit_chooses_what_leaves_least((n, j, b, seed) in sizes()) {
        let mut numbers = Numbers(seed);
        let atoms = Atoms::blocks(numbers.blocks(n, j, b), b);
        let x = numbers.matrix(n, 1);
        let left = |used: &[usize]| {
            let columns: Vec<_> = used.iter().flat_map(|&j| j * b..(j + 1) * b).collect();
            let q = atoms.matrix().select_columns(&columns).qr().q();
            (&x - &q * q.tr_mul(&x)).norm() / x.norm()
        };
        // Beyond, the columns span everything, and what is left is rounding.
        let most = ((n - 1) / b).min(j).min(3);
        let mut before: Vec<usize> = Vec::new();
        for nonzeros in 1..=most {
            let code = &Pursuit { nonzeros }.codes(&atoms, x.as_slice()).unwrap()[0];
            prop_assert!(before.iter().all(|j| code.indices.contains(j)));
            for candidate in (0..j).filter(|j| !before.contains(j)) {
                let with = [before.as_slice(), &[candidate]].concat();
                prop_assert!(code.relative_error <= left(&with) + 1e-7, "{candidate} leaves less");
            }
            before.clone_from(&code.indices);
        }
    }

    /// Another basis of every block changes nothing but the coordinates in it.
    #[test]
    fn codes_do_not_depend_on_the_basis_of_a_block(seed in any::<u64>(), b in 1_usize..5) {
        let (n, j) = (24, 9);
        let mut numbers = Numbers(seed);
        let matrix = numbers.blocks(n, j, b);
        let turns: Vec<Matrix> = (0..j).map(|_| numbers.matrix(b, b).qr().q()).collect();
        let mut turned = matrix.clone();
        for (i, turn) in turns.iter().enumerate() {
            turned.columns_mut(i * b, b).copy_from(&multiply(&matrix.columns(i * b, b).into_owned(), turn));
        }
        let x = numbers.matrix(n, 1);
        let (plain, turned) = (Atoms::blocks(matrix, b), Atoms::blocks(turned, b));
        let lambda = 0.3 * plain.lambda_max(x.as_slice());
        for coder in [Coder::GroupLasso(group_lasso(lambda)), Coder::Pursuit(Pursuit { nonzeros: 3 })] {
            let one = &coder.codes(&plain, x.as_slice()).unwrap()[0];
            let other = &coder.codes(&turned, x.as_slice()).unwrap()[0];
            prop_assert_eq!(&one.indices, &other.indices);
            prop_assert!((one.objective - other.objective).abs() <= 1e-12 * x.norm_squared());
            prop_assert!((one.relative_error - other.relative_error).abs() <= 1e-12);
            for (i, (a, z)) in one.indices.iter().zip(one.values.chunks(b).zip(other.values.chunks(b))) {
                let wanted = turns[*i].tr_mul(&Matrix::from_column_slice(b, 1, a));
                for (found, wanted) in z.iter().zip(wanted.iter()) {
                    prop_assert!((found - wanted).abs() <= 1e-10 * x.norm(), "{found} for {wanted}");
                }
            }
        }
    }

    /// From any code, near or far, to the same optimum.
    #[test]
    fn a_start_changes_no_optimum((n, j, b, seed) in sizes(), change in 0.0..0.3) {
        let mut numbers = Numbers(seed);
        let before = numbers.blocks(n, j, b);
        let after: Matrix = &before + numbers.blocks(n, j, b) * change;
        let shapes = numbers.matrix(n, 5);
        // Blocks stay orthonormal when some are other ones.
        let mut exchanged = numbers.blocks(n, j, b);
        exchanged.columns_mut(0, j / 2 * b).copy_from(&before.columns(0, j / 2 * b));
        let lasso = |nonnegative| Coder::Lasso(Lasso { tolerance: 1e-12, ..Lasso::new(0.05, nonnegative) });
        for (coder, before, after) in [
            (lasso(false), Atoms::new(before.clone()), Atoms::new(after.clone())),
            (lasso(true), Atoms::new(before.clone()), Atoms::new(after)),
            (Coder::GroupLasso(group_lasso(0.05)), Atoms::blocks(before, b), Atoms::blocks(exchanged, b)),
        ] {
            let start = coder.codes(&before, shapes.as_slice()).unwrap();
            let warm = coder.codes_from(&after, shapes.as_slice(), &start).unwrap();
            let cold = coder.codes(&after, shapes.as_slice()).unwrap();
            for ((warm, cold), x) in warm.iter().zip(&cold).zip(shapes.as_slice().chunks(n)) {
                let energy = norm(x).powi(2);
                prop_assert!((warm.objective - cold.objective).abs() <= 1e-12 * energy);
                prop_assert!(warm.duality_gap.unwrap() <= 0.5e-12 * energy);
            }
        }
    }
}

#[test]
fn planted_blocks_are_found() {
    let (n, j, b) = (80, 12, 2);
    let mut numbers = Numbers(5);
    let atoms = Atoms::blocks(numbers.blocks(n, j, b), b);
    for first in 0..4 {
        let mut planted = Matrix::zeros(j * b, 1);
        for index in [first, first + 3, first + 8] {
            planted[index * b] = 1.0 + numbers.next();
            planted[index * b + 1] = -1.0 + numbers.next();
        }
        let x = atoms.matrix() * &planted;
        let code = &Pursuit { nonzeros: 3 }.codes(&atoms, x.as_slice()).unwrap()[0];
        assert_eq!(code.indices, [first, first + 3, first + 8]);
        let found = Matrix::from_column_slice(j * b, 1, &code.dense(j * b));
        assert!((found - planted).norm() < 1e-12 && code.relative_error < 1e-7);
    }
}

#[test]
fn a_strong_penalty_leaves_no_block() {
    let mut numbers = Numbers(2);
    let atoms = Atoms::blocks(numbers.blocks(12, 5, 3), 3);
    let x = numbers.matrix(12, 1);
    for factor in [1.0, 1.5] {
        let coder = group_lasso(factor * atoms.lambda_max(x.as_slice()) * (1.0 + 1e-14));
        let code = &coder.codes(&atoms, x.as_slice()).unwrap()[0];
        assert!(code.indices.is_empty() && code.relative_error == 1.0, "{code:?}");
    }
    let weaker = group_lasso(0.999 * atoms.lambda_max(x.as_slice()));
    assert_eq!(weaker.codes(&atoms, x.as_slice()).unwrap()[0].indices.len(), 1);
    let nothing = &group_lasso(0.1).codes(&atoms, &[0.0; 12]).unwrap()[0];
    assert_eq!((nothing.indices.len(), nothing.relative_error, nothing.objective), (0, 0.0, 0.0));
}

/// Blocks of zeros are never chosen; equal blocks, and blocks that share a direction, share their part in any way.
#[test]
fn dead_and_dependent_blocks_are_coded() {
    let (n, b) = (9, 2);
    let mut numbers = Numbers(11);
    let single = numbers.blocks(n, 4, b);
    let mut double = Matrix::zeros(n, 10 * b);
    for j in 0..4 {
        double.columns_mut(j * b, b).copy_from(&single.columns(j * b, b));
        double.columns_mut((j + 5) * b, b).copy_from(&single.columns(j * b, b));
    }
    // Block 4 is dead; block 9 shares one column with block 0.
    let mut shared = numbers.matrix(n, b);
    let direction = single.column(0).normalize();
    shared.set_column(0, &direction);
    let q = shared.qr().q();
    double.columns_mut(9 * b, b).copy_from(&q);
    let (single, double) = (Atoms::blocks(single, b), Atoms::blocks(double, b));
    for x in numbers.matrix(n, 6).as_slice().chunks(n) {
        for fraction in [0.02, 0.3, 0.8] {
            let coder = group_lasso(fraction * single.lambda_max(x));
            let one = &coder.codes(&single, x).unwrap()[0];
            let two = &coder.codes(&double, x).unwrap()[0];
            assert_optimal(&double, x, two, coder.lambda);
            assert!(!two.indices.contains(&4) && two.values.iter().all(|v| v.is_finite()));
            assert!(two.objective <= one.objective * (1.0 + 1e-12));
        }
        let code = &Pursuit { nonzeros: 10 }.codes(&double, x).unwrap()[0];
        assert!(!code.indices.contains(&4) && code.values.iter().all(|v| v.is_finite()));
        assert!(code.relative_error < 1e-6, "{}", code.relative_error);
    }
    let dead = Atoms::blocks(Matrix::zeros(n, 3 * b), b);
    let x = [1.0; 9];
    for coder in [Coder::GroupLasso(group_lasso(0.1)), Coder::Pursuit(Pursuit { nonzeros: 2 })] {
        assert!(coder.codes(&dead, &x).unwrap()[0].indices.is_empty());
    }
}

#[test]
fn threads_change_no_block_code() {
    let mut numbers = Numbers(3);
    let atoms = Atoms::blocks(numbers.blocks(30, 10, 2), 2);
    let shapes = numbers.matrix(30, 500);
    for coder in [
        Coder::GroupLasso(GroupLasso::new(0.3)),
        Coder::Pursuit(Pursuit { nonzeros: 3 }),
        Coder::Lasso(Lasso::new(0.3, false)),
    ] {
        let codes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| coder.codes(&atoms, shapes.as_slice()).unwrap())
        };
        let one = codes(1);
        assert_eq!((one.len(), &one), (500, &codes(2)));
        assert_eq!(one, codes(3));
    }
}

#[test]
fn an_error_names_the_shape() {
    let mut numbers = Numbers(4);
    let atoms = Atoms::new(numbers.blocks(12, 5, 1));
    // A gap below zero is never reached, but by the shape without extent.
    let mut shapes = vec![0.0; 12 * 200];
    shapes[12 * 130..12 * 131].copy_from_slice(numbers.matrix(12, 1).as_slice());
    shapes[12 * 199..].copy_from_slice(numbers.matrix(12, 1).as_slice());
    for coder in [
        Coder::Lasso(Lasso { tolerance: -1.0, ..Lasso::new(0.01, false) }),
        Coder::GroupLasso(GroupLasso { tolerance: -1.0, ..GroupLasso::new(0.01) }),
    ] {
        let error = coder.codes(&atoms, &shapes).unwrap_err();
        assert!(matches!(error, AnalysisError::NoConvergence { index: 130, .. }), "{error}");
    }
}
