//! The learning method of a dictionary with its parameters.

use super::learning::Schedule;

/// How codes handle the transformation class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Codes {
    /// Shapes are aligned to the mean, then coded with one number per atom.
    #[default]
    Aligned,
    /// Every atom is transformed by its own member of the class; no alignment.
    Invariant,
}

/// Learning method.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum Method {
    /// Functional principal components of the aligned shapes.
    FunctionalPca {
        /// Number of components. Default: 10.
        #[cfg_attr(feature = "serde", serde(default = "default_components"))]
        #[cfg_attr(feature = "schema", schema(default = 10, minimum = 1))]
        components: usize,
        /// Whether components are centred on the arithmetic mean of the aligned shapes. Default: true. Without it the first component
        /// is the mean, as in the thesis.
        #[cfg_attr(feature = "serde", serde(default = "default_centre"))]
        #[cfg_attr(feature = "schema", schema(default = true))]
        centre: bool,
    },
    /// Sparse dictionary: every shape is coded with few atoms.
    Sparse {
        /// Number of atoms.
        #[cfg_attr(feature = "schema", schema(minimum = 1))]
        atoms: usize,
        /// Penalty `λ` on the magnitudes of a code (lasso); null with `nonzeros`.
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        lambda: Option<f64>,
        /// Number of atoms in a code (optimised orthogonal matching pursuit); null with `lambda`.
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
        #[cfg_attr(feature = "schema", schema(minimum = 1))]
        nonzeros: Option<usize>,
        /// Aligned or invariant codes. Default: `aligned`.
        #[cfg_attr(feature = "serde", serde(default))]
        codes: Codes,
        /// Whether coefficients must be non-negative. Default: false.
        #[cfg_attr(feature = "serde", serde(default))]
        nonnegative: bool,
        /// Whether aligned shapes are divided by their norm, as invariant codes always are. Default: true.
        #[cfg_attr(feature = "serde", serde(default = "default_normalise"))]
        #[cfg_attr(feature = "schema", schema(default = true))]
        normalise: bool,
        /// Seed of the random initial atoms. Default: 0.
        #[cfg_attr(feature = "serde", serde(default))]
        seed: u64,
        /// Maximum number of passes over the shapes, up to 10 000. Default: 200.
        #[cfg_attr(feature = "serde", serde(default = "default_max_epochs"))]
        #[cfg_attr(feature = "schema", schema(default = 200, minimum = 1, maximum = 10000))]
        max_epochs: usize,
        /// Relative distance of the objective from its end, estimated by the gain of the second half of the passes,
        /// below which learning stops (with `nonzeros`: for ten passes). Default: 1e-3.
        #[cfg_attr(feature = "serde", serde(default = "default_tolerance"))]
        #[cfg_attr(feature = "schema", schema(default = 1e-3, minimum = 0, exclusive_maximum = 1))]
        tolerance: f64,
        /// Update schedule of the atoms. Default: `online` (after every group of shapes).
        #[cfg_attr(feature = "serde", serde(default))]
        schedule: Schedule,
    },
}

#[cfg(feature = "serde")]
fn default_components() -> usize {
    10
}

#[cfg(feature = "serde")]
fn default_centre() -> bool {
    true
}

fn default_normalise() -> bool {
    true
}

fn default_max_epochs() -> usize {
    200
}

fn default_tolerance() -> f64 {
    1e-3
}

impl Method {
    /// Functional principal components, about the origin or about the arithmetic mean of the aligned shapes.
    pub fn components(components: usize, centre: bool) -> Self {
        Self::FunctionalPca { components, centre }
    }

    /// Sparse atoms with penalised aligned codes, and defaults otherwise.
    pub fn sparse(atoms: usize, lambda: f64) -> Self {
        Self::Sparse {
            atoms,
            lambda: Some(lambda),
            nonzeros: None,
            codes: Codes::Aligned,
            nonnegative: false,
            normalise: default_normalise(),
            seed: 0,
            max_epochs: default_max_epochs(),
            tolerance: default_tolerance(),
            schedule: Schedule::Online,
        }
    }
}
