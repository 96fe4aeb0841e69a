//! Classification by dictionary atoms: every atom is assigned to a class.
//!
//! ```text
//! nearest atom       d_c = √(1 − max_{j ∈ c} ρ_j²),   ρ_j = ‖D_jᵀ y‖/‖y‖
//! sparse residual    d_c = ‖y − Σ_{j ∈ c} D_j B_jᵀ‖/‖y‖
//! ```
//!
//! An atom belongs to the class with the most votes for it. A class votes with the fraction of its shapes for which the
//! atom is the best one, or with the energy of the atom in the codes of its shapes. Classes of different size have equal
//! votes. The distance to a class without atoms is 1.
//!
//! Source: Schmitter 2017, table 4.3; Wright, Yang, Ganesh, Sastry and Ma 2009.

use shapelex_numeric::parallel;

use super::observations::{Evidence, Labelled, Observations};
use crate::dictionary::model::{Model, squared_distance};
use crate::metric::{dot, norm};
use crate::sparse::SparseCode;

/// The atoms assigned to every class.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomClasses {
    /// One ascending list per class; atoms without votes are in none.
    pub atoms: Vec<Vec<usize>>,
}

impl AtomClasses {
    /// Assigns atoms by correlation: every shape votes for its best correlated atom.
    pub(super) fn by_correlation(model: &Model, sample: Labelled<'_>) -> Self {
        Self::by_votes(model, sample, |k, vote| {
            let correlations = correlations(model, sample.observations.prepared(k));
            let best = (1..correlations.len())
                .fold(0, |best, j| if correlations[j] > correlations[best] { j } else { best });
            vote(best, 1.0);
        })
    }

    /// Assigns atoms by use: every shape votes for the atoms of its code, with their energy in the code.
    pub(super) fn by_use(model: &Model, sample: Labelled<'_>) -> Self {
        Self::by_votes(model, sample, |k, vote| {
            let code = &sample.observations.codes[k];
            for (&j, values) in code.indices.iter().zip(blocks(code)) {
                vote(j, dot(values, values));
            }
        })
    }

    fn by_votes(
        model: &Model,
        sample: Labelled<'_>,
        ballot: impl Fn(usize, &mut dyn FnMut(usize, f64)),
    ) -> Self {
        let (count, sizes) = (sample.count, sample.sizes());
        let mut votes = vec![vec![0.0; count]; model.len()];
        for (k, &class) in sample.classes.iter().enumerate() {
            ballot(k, &mut |j, weight| {
                if let Some(votes) = votes.get_mut(j) {
                    votes[class] += weight / sizes[class] as f64;
                }
            });
        }
        let mut atoms = vec![Vec::new(); count];
        for (j, votes) in votes.iter().enumerate() {
            let best = (1..count).fold(0, |best, c| if votes[c] > votes[best] { c } else { best });
            if votes[best] > 0.0 {
                atoms[best].push(j);
            }
        }
        Self { atoms }
    }

    pub(super) fn correlations(&self, model: &Model, observations: Observations<'_>) -> Vec<Evidence> {
        let evidence = |k: usize| {
            let found = correlations(model, observations.prepared(k));
            let distance = |atoms: &Vec<usize>| {
                let rho = atoms.iter().map(|&j| found[j]).fold(0.0, f64::max);
                (1.0 - rho * rho).max(0.0).sqrt()
            };
            Evidence::from_residuals(self.atoms.iter().map(distance).collect())
        };
        parallel::map(observations.count(), &evidence)
    }

    pub(super) fn residuals(&self, model: &Model, observations: Observations<'_>) -> Vec<Evidence> {
        let evidence = |k: usize| {
            let (code, y) = (&observations.codes[k], observations.prepared(k));
            let distance = |atoms: &Vec<usize>| {
                let part = model.reconstruct(&part(code, atoms));
                squared_distance(y, &part).sqrt() / norm(y)
            };
            Evidence::from_residuals(self.atoms.iter().map(distance).collect())
        };
        parallel::map(observations.count(), &evidence)
    }
}

/// The entries of a code that belong to the given atoms.
fn part(code: &SparseCode, atoms: &[usize]) -> SparseCode {
    let entries = code.indices.iter().zip(blocks(code));
    let (indices, values): (Vec<usize>, Vec<&[f64]>) =
        entries.filter(|(j, _)| atoms.binary_search(j).is_ok()).unzip();
    SparseCode { indices, values: values.concat(), ..code.clone() }
}

/// Coefficients of every atom in a code.
fn blocks(code: &SparseCode) -> impl Iterator<Item = &[f64]> {
    code.values.chunks_exact((code.values.len() / code.indices.len().max(1)).max(1))
}

/// `ρ_j` of every atom: cosine between `y` and the nearest multiple, or transformed copy, of the atom.
fn correlations(model: &Model, y: &[f64]) -> Vec<f64> {
    let (columns, block) = model.columns();
    let products: Vec<f64> = columns.column_iter().map(|column| dot(column.as_slice(), y)).collect();
    products.chunks_exact(block).map(|part| (norm(part) / norm(y)).min(1.0)).collect()
}
