//! Factors of the weights of shapes in a robust estimate: which shapes it leaves out.

/// Whether an estimate resists wrong shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Estimator {
    /// Every shape counts by its weight.
    #[default]
    Plain,
    /// Shapes unlike the majority count less, or not at all: see [`robust`](crate::robust).
    Robust,
}

impl Estimator {
    /// The robust one if asked for.
    pub fn robust(robust: bool) -> Self {
        if robust { Self::Robust } else { Self::Plain }
    }

    /// Whether it is robust.
    pub fn is_robust(self) -> bool {
        self == Self::Robust
    }
}

/// Shapes that a robust estimate keeps although they are unlike the majority and agree with each other.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Minority {
    /// Number of these shapes.
    pub shapes: usize,
    /// Their share in the weight.
    pub share: f64,
    /// Distance of the robust mean from the mean of the majority, in parts of its norm.
    pub distance: f64,
}

/// The factors of the weights of a robust estimate, between zero (left out) and one.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    /// One factor for each shape.
    pub factors: Vec<f64>,
    /// Number of equal shapes of which the weighted ones are worth, `(Σwf)²/Σ(wf)²`.
    pub effective: f64,
    /// Shapes that count although they are unlike the majority and agree with each other, if there are some.
    pub minority: Option<Minority>,
}

/// How many shapes a robust estimate has left out.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct RobustSummary {
    /// Number of shapes that are left out: their weight is zero.
    pub rejected: usize,
    /// Number of shapes that count less than their weight, without those left out.
    pub reduced: usize,
    /// Number of equal weights that the weights are worth, `(Σw)²/Σw²`.
    pub effective: f64,
    /// Shapes that count although they are unlike the majority and agree with each other; null if there are none.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub minority: Option<Minority>,
}

impl Factors {
    /// Counts of the shapes that are left out or count less.
    pub fn summary(&self) -> RobustSummary {
        RobustSummary {
            rejected: self.rejected(),
            reduced: self.reduced(),
            effective: self.effective,
            minority: self.minority,
        }
    }

    /// Number of shapes that are left out.
    pub fn rejected(&self) -> usize {
        self.factors.iter().filter(|factor| **factor == 0.0).count()
    }

    /// Number of shapes whose weight is reduced, without those that are left out.
    pub fn reduced(&self) -> usize {
        self.factors.iter().filter(|factor| **factor > 0.0 && **factor < 1.0).count()
    }
}
