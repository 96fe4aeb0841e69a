//! Faults of inputs, by field.

/// An input that is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldFault {
    /// Path of the input, its parts separated by `/`: `parameters/3/0`. Empty for the input as a whole.
    pub field: String,
    /// The expected and the actual value.
    pub detail: String,
}

impl FieldFault {
    /// A fault of the input at `field`.
    pub fn new(field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { field: field.into(), detail: detail.into() }
    }

    /// The same fault, of a part of the input at `parent`.
    #[must_use]
    pub fn below(self, parent: &str) -> Self {
        let field =
            if self.field.is_empty() { parent.to_owned() } else { format!("{parent}/{}", self.field) };
        Self { field, ..self }
    }
}
