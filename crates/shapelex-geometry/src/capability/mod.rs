//! Capabilities: what a shape can be asked, whatever its kind.
//!
//! Layers above ask [`Representation`](crate::representation::Representation) and
//! [`ShapeSpace`](crate::representation::ShapeSpace); only this crate tells kinds apart.
//!
//! * [`domain`] — how places on a shape are named; what a representation allows; its faults;
//! * [`place`] — places of curves, surfaces and landmarks, and the points there;
//! * [`sample`] — values, derivatives and frames at places;
//! * [`tessellate`] — triangle meshes;
//! * [`measure`] — lengths, areas, volumes, distances to a reference;
//! * [`fit`] — least-squares fits to points and meshes;
//! * [`refine`] — the same shape on a finer or another grid of knots;
//! * [`deform`] — places of handles, and the change of a deformation;
//! * [`idealise`] — control points of idealised shapes; [`interpolate`] — grids of points that determine a surface;
//! * [`fourier`] — curves given by Fourier coefficients; [`enclose`] — boundaries of regions, and those that fill a box.

pub mod deform;
pub mod domain;
pub mod enclose;
pub mod fit;
pub mod fourier;
pub mod idealise;
pub mod interpolate;
pub mod measure;
pub mod place;
pub mod refine;
pub mod sample;
pub mod tessellate;

/// An input that a capability refuses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldFault {
    /// Path of the input, its parts separated by `/`: `parameters/3/0`. Empty for the input as a whole.
    pub field: String,
    /// What was expected, and what was found.
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
