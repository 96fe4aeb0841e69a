//! Sparse codes: optimality conditions, the regularisation path, matching pursuit, degenerate dictionaries.

use proptest::prelude::*;
use shapelex_analysis::sparse::{Atoms, Encode, Lasso, Pursuit, SparseCode};
use shapelex_numeric::dense::Matrix;

/// Unit atoms, one a column, and shapes near their span.
fn problem(sizes: (usize, usize, usize), numbers: &[f64]) -> (Matrix, Vec<f64>) {
    let (n, atoms, shapes) = sizes;
    let at = |i: usize| numbers[i % numbers.len()] + 0.3 * ((i * i) as f64 * 0.618).sin();
    let mut matrix = Matrix::from_fn(n, atoms, |i, j| at(i + n * j));
    for mut column in matrix.column_iter_mut() {
        let norm = column.norm().max(1e-6);
        column /= norm;
    }
    (matrix, (0..n * shapes).map(|i| at(7 * i + 3)).collect())
}

fn random() -> impl Strategy<Value = (Matrix, Vec<f64>)> {
    let sizes = (2_usize..12, 1_usize..16, 1_usize..5);
    (sizes, prop::collection::vec(-1.0..1.0, 97)).prop_map(|(sizes, numbers)| problem(sizes, &numbers))
}

/// `Dᵀ(x − Dα)` and its norm scale.
fn residual_correlations(atoms: &Matrix, x: &[f64], code: &SparseCode) -> Vec<f64> {
    let dense = code.dense(atoms.ncols());
    let fitted = atoms * Matrix::from_column_slice(atoms.ncols(), 1, &dense);
    let residual = Matrix::from_column_slice(x.len(), 1, x) - fitted;
    atoms.tr_mul(&residual).as_slice().to_vec()
}

/// The optimality conditions: `Dᵀr = λ sign(α)` on the support, within `λ` elsewhere (below `λ` for non-negative codes).
fn assert_optimal(atoms: &Matrix, x: &[f64], code: &SparseCode, lasso: &Lasso) {
    let norm = x.iter().map(|v| v * v).sum::<f64>().sqrt();
    // A gap of 1e-12 of ‖x‖²/2 leaves half of its digits in the correlations.
    let tolerance = 1e-5 * norm;
    let dense = code.dense(atoms.ncols());
    for (j, r) in residual_correlations(atoms, x, code).into_iter().enumerate() {
        let value = dense[j];
        assert!(!lasso.nonnegative || value >= 0.0, "coefficient {value}");
        if value != 0.0 {
            let error = (r - lasso.lambda * value.signum()).abs();
            assert!(error <= tolerance, "atom {j}: correlation {r} for {}", lasso.lambda);
        } else {
            let strength = if lasso.nonnegative { r } else { r.abs() };
            assert!(strength <= lasso.lambda + tolerance, "atom {j}: {strength} above {}", lasso.lambda);
        }
    }
}

/// To a relative gap of 1e-12: atoms that nearly depend on each other lose further digits to rounding.
fn lasso(lambda: f64, nonnegative: bool) -> Lasso {
    Lasso { tolerance: 1e-12, ..Lasso::new(lambda, nonnegative) }
}

proptest! {
    #[test]
    fn codes_satisfy_the_optimality_conditions(
        (matrix, shapes) in random(), fraction in 0.01..0.95, nonnegative in any::<bool>(),
    ) {
        let atoms = Atoms::new(matrix.clone());
        for x in shapes.chunks_exact(matrix.nrows()) {
            let lasso = lasso(fraction * atoms.lambda_max(x), nonnegative);
            let code = &lasso.codes(&atoms, x).unwrap()[0];
            assert_optimal(&matrix, x, code, &lasso);
            let energy: f64 = x.iter().map(|v| v * v).sum();
            prop_assert!(code.duality_gap.unwrap() <= 0.5e-12 * energy);
            // objective and error are what they say
            let penalty = lasso.lambda * code.values.iter().map(|v| v.abs()).sum::<f64>();
            let error = code.relative_error.powi(2) * energy;
            prop_assert!((0.5 * error + penalty - code.objective).abs() <= 1e-12 * energy);
        }
    }

    #[test]
    fn the_path_is_the_code_at_every_knot((matrix, shapes) in random(), nonnegative in any::<bool>()) {
        let atoms = Atoms::new(matrix.clone());
        let x = &shapes[..matrix.nrows()];
        let scale = atoms.lambda_max(x);
        let path = lasso(0.05 * scale, nonnegative).path(&atoms, x);
        prop_assert!(path.windows(2).all(|pair| pair[1].lambda <= pair[0].lambda));
        let dense = |indices: &[usize], values: &[f64]| {
            let mut code = vec![0.0; matrix.ncols()];
            indices.iter().zip(values).for_each(|(&j, &value)| code[j] = value);
            code
        };
        for pair in path.windows(2).filter(|pair| pair[1].lambda < 0.999 * pair[0].lambda) {
            // at the knot, and linear half-way to it
            let middle = 0.5 * (pair[0].lambda + pair[1].lambda);
            let codes = pair.iter().map(|knot| dense(&knot.indices, &knot.values)).collect::<Vec<_>>();
            let half: Vec<f64> = codes[0].iter().zip(&codes[1]).map(|(a, b)| 0.5 * (a + b)).collect();
            for (lambda, values) in [(pair[1].lambda, &codes[1]), (middle, &half)] {
                let code = SparseCode {
                    indices: (0..values.len()).collect(),
                    values: values.clone(),
                    objective: 0.0,
                    duality_gap: None,
                    relative_error: 0.0,
                };
                assert_optimal(&matrix, x, &code, &lasso(lambda, nonnegative));
            }
        }
    }

    #[test]
    fn a_pursuit_fits_what_it_uses((matrix, shapes) in random(), nonzeros in 1_usize..8) {
        let atoms = Atoms::new(matrix.clone());
        let codes = Pursuit { nonzeros }.codes(&atoms, &shapes).unwrap();
        let fewer = Pursuit { nonzeros: nonzeros - 1 }.codes(&atoms, &shapes).unwrap();
        for ((x, code), before) in shapes.chunks_exact(matrix.nrows()).zip(&codes).zip(&fewer) {
            prop_assert!(code.indices.len() <= nonzeros && code.indices.windows(2).all(|p| p[0] < p[1]));
            let norm = x.iter().map(|v| v * v).sum::<f64>().sqrt();
            let residual = residual_correlations(&matrix, x, code);
            let largest = code.indices.iter().map(|&j| residual[j].abs()).fold(0.0, f64::max);
            // The condition number of the used atoms may be 1e6.
            prop_assert!(largest <= 1e-8 * norm, "{largest:e} of {norm}");
            prop_assert!(code.relative_error <= before.relative_error + 1e-7);
        }
    }
}

#[test]
fn a_strong_penalty_leaves_nothing() {
    let (matrix, shapes) = problem((8, 5, 1), &[0.3, -0.7, 0.2, 0.9, -0.1]);
    let atoms = Atoms::new(matrix);
    for lambda in [1.0, 1.5].map(|factor| factor * atoms.lambda_max(&shapes)) {
        let code = &lasso(lambda, false).codes(&atoms, &shapes).unwrap()[0];
        assert!(code.indices.is_empty() && code.relative_error == 1.0, "{code:?}");
    }
    let zero = &lasso(0.1, false).codes(&atoms, &[0.0; 8]).unwrap()[0];
    assert_eq!((zero.indices.len(), zero.relative_error, zero.objective), (0, 0.0, 0.0));
    assert!(Pursuit { nonzeros: 3 }.codes(&atoms, &[0.0; 8]).unwrap()[0].indices.is_empty());
}

/// Equal atoms share their coefficient in any way: the objective is still certified.
#[test]
fn equal_and_dependent_atoms_are_coded() {
    let (matrix, shapes) = problem((6, 4, 3), &[0.3, -0.7, 0.2, 0.9, -0.1, 0.5, 0.8]);
    let twice = Matrix::from_fn(6, 9, |i, j| match j {
        8 => (matrix[(i, 0)] + matrix[(i, 1)]) / 2.0,
        j => matrix[(i, j % 4)],
    });
    let (single, double) = (Atoms::new(matrix.clone()), Atoms::new(twice.clone()));
    for x in shapes.chunks_exact(6) {
        for fraction in [0.02, 0.3, 0.8] {
            let lasso = lasso(fraction * single.lambda_max(x), false);
            let (a, b) = (&lasso.codes(&single, x).unwrap()[0], &lasso.codes(&double, x).unwrap()[0]);
            assert_optimal(&twice, x, b, &lasso);
            // More atoms cannot be worse; the mean of two costs as much as both.
            assert!(b.objective <= a.objective * (1.0 + 1e-12), "{} {}", b.objective, a.objective);
        }
    }
}

#[test]
fn batches_and_threads_change_nothing() {
    let numbers: Vec<f64> = (0..211).map(|i| (i as f64 * 1.7).sin()).collect();
    let (matrix, shapes) = problem((30, 12, 1200), &numbers);
    let atoms = Atoms::new(matrix);
    let codes = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Lasso::new(0.4, false).codes(&atoms, &shapes).unwrap())
    };
    let one = codes(1);
    assert_eq!(one.len(), 1200);
    assert_eq!(one, codes(2));
    assert_eq!(one, codes(3));
}
