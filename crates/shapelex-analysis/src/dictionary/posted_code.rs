//! Codes given by a caller, checked against a dictionary, and the shapes that they describe.

use super::coding::Reconstruction;
use super::in_use::Dictionary;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_numeric::MAX_NUMBER;
use shapelex_numeric::dense::Matrix;

/// A code of a shape.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct PostedCode {
    /// Indices of the atoms in use, from 0.
    pub indices: Vec<usize>,
    /// Coefficients, one per index. Excludes `matrices`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub values: Option<Vec<f64>>,
    /// Matrices of the atoms, row by row, one per index; for invariant codes.
    #[cfg_attr(feature = "serde", serde(default))]
    pub matrices: Option<Vec<Vec<Vec<f64>>>>,
    /// Translation of the result, for invariant codes. Default: zero.
    #[cfg_attr(feature = "serde", serde(default))]
    pub offset: Option<Vec<f64>>,
}

/// A code that fits a dictionary.
#[derive(Debug)]
pub struct FittingCode<'a> {
    dictionary: &'a Dictionary,
    indices: &'a [usize],
    coefficients: Coefficients<'a>,
}

#[derive(Debug)]
enum Coefficients<'a> {
    Numbers(&'a [f64]),
    Matrices { matrices: &'a [Vec<Vec<f64>>], offset: Option<&'a [f64]> },
}

impl Dictionary {
    /// Checks that a code fits.
    ///
    /// # Errors
    /// All of its faults.
    pub fn fitting<'a>(&'a self, code: &'a PostedCode) -> Result<FittingCode<'a>, Vec<FieldFault>> {
        let mut faults = self.index_faults(&code.indices);
        let coefficients = if self.is_invariant() { self.matrices(code) } else { numbers(code) };
        let d = self.metric().dimension();
        let offset_fits = |offset: &Vec<f64>| offset.len() == d && offset.iter().all(bounded);
        let coefficients = coefficients.map_err(|fault| faults.push(fault)).ok();
        if !code.offset.as_ref().is_none_or(offset_fits) {
            faults.push(FieldFault::new("offset", format!("expected {d} numbers")));
        }
        match coefficients {
            Some(coefficients) if faults.is_empty() => {
                Ok(FittingCode { dictionary: self, indices: &code.indices, coefficients })
            }
            _ => Err(faults),
        }
    }

    fn index_faults(&self, indices: &[usize]) -> Vec<FieldFault> {
        let (mut faults, atoms) = (Vec::new(), self.model.len());
        for (position, &index) in indices.iter().enumerate() {
            let field = format!("indices/{position}");
            if index >= atoms {
                let detail = format!("expected an index below {atoms}, the number of atoms, got {index}");
                faults.push(FieldFault::new(&*field, detail));
            }
            if indices[..position].contains(&index) {
                faults.push(FieldFault::new(field, format!("the index {index} is given twice")));
                break;
            }
        }
        faults
    }

    fn matrices<'a>(&self, code: &'a PostedCode) -> Result<Coefficients<'a>, FieldFault> {
        let (wanted, d) = (code.indices.len(), self.metric().dimension());
        let square = |m: &Vec<Vec<f64>>| m.len() == d && m.iter().all(|row| row.len() == d);
        match (&code.matrices, &code.values) {
            (Some(matrices), None)
                if matrices.len() == wanted
                    && matrices.iter().all(square)
                    && matrices.iter().flatten().flatten().all(bounded) =>
            {
                Ok(Coefficients::Matrices { matrices, offset: code.offset.as_deref() })
            }
            _ => {
                let detail =
                    format!("expected {wanted} matrices of {d} × {d} numbers, one per index, without values");
                Err(FieldFault::new("matrices", detail))
            }
        }
    }
}

fn numbers(code: &PostedCode) -> Result<Coefficients<'_>, FieldFault> {
    let wanted = code.indices.len();
    match code {
        PostedCode { values: Some(values), matrices: None, offset: None, .. }
            if values.len() == wanted && values.iter().all(bounded) =>
        {
            Ok(Coefficients::Numbers(values))
        }
        _ => {
            let detail = format!("expected {wanted} numbers, one per index, without matrices and offset");
            Err(FieldFault::new("values", detail))
        }
    }
}

fn bounded(value: &f64) -> bool {
    value.abs() <= MAX_NUMBER
}

impl FittingCode<'_> {
    /// The shape: in the pose of the dictionary, or as given by matrices and offset.
    pub fn reconstruct(&self) -> Reconstruction {
        let Self { dictionary, indices, coefficients } = self;
        let control_points = match coefficients {
            Coefficients::Numbers(values) => dictionary.combine(indices, values),
            Coefficients::Matrices { matrices, offset } => {
                let square =
                    |rows: &Vec<Vec<f64>>| Matrix::from_fn(rows.len(), rows.len(), |i, k| rows[i][k]);
                let matrices: Vec<Matrix> = matrices.iter().map(square).collect();
                let zero = vec![0.0; dictionary.metric().dimension()];
                dictionary.combine_moved(indices, &matrices, offset.unwrap_or(&zero))
            }
        };
        Reconstruction { control_points, relative_error: None, residual: Vec::new() }
    }
}
