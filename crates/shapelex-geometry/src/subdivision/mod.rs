//! Subdivision surfaces: triangle meshes refined repeatedly by a scheme.
//!
//! ```text
//! X_{k+1} = S_k X_k,    X_K = T_K C,    T_K = S_{K−1} ⋯ S_0
//! ```
//!
//! `C` are the control vertices, one per row. BLOB, Loop and the modified butterfly are linear: `S_k` depends only on the
//! faces, the scheme and the level, so the surfaces of one control mesh form a linear space. The normal-based scheme is not
//! linear.
//!
//! * [`stencil`] — the rules of the linear schemes; [`limit`] — their limit positions and normals;
//! * [`normal_based`] — the interpolating scheme for points with normals; [`oriented`] — its shapes on one control mesh;
//! * [`control`] — control meshes: named ones and lists of faces;
//! * [`basis`] — the linear schemes as a shape space; [`fit`] — fits to a mesh or a point cloud;
//! * [`refinement`] — refinement of one mesh or polyline;
//! * [`measures`] — volume, area and curvature of the refined mesh.
//!
//! New vertices are numbered after the old ones, in the lexicographic order of their edges: see
//! [`Connectivity::split_faces`](super::mesh::Connectivity::split_faces).

pub mod basis;
pub mod control;
pub mod fit;
pub mod limit;
pub mod measures;
pub mod normal_based;
pub mod oriented;
pub mod refinement;
pub mod stencil;

use std::f64::consts::PI;

use self::control::ControlMesh;
use super::generator::Exact;
use super::mesh::{Connectivity, MeshError};

/// A subdivision scheme with its parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scheme {
    /// BLOB, the non-stationary scheme for shapes of sphere or torus type.
    Blob(Frequency),
    /// The approximating scheme of Loop.
    Loop(LoopWeights),
    /// The modified butterfly scheme, which is interpolating.
    Butterfly {
        /// Tension `w`; 0 is the rule of eight points.
        tension: Exact,
    },
    /// The interpolating scheme for points with normals.
    NormalBased {
        /// Balance `κ`: how far the weights of the two ends are equalised; 0 as published.
        balance: Exact,
    },
}

/// Frequency for which BLOB is exact: `v⁽ᵏ⁾ = cos(λ/2ᵏ⁺¹)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Frequency {
    /// `λ`, `|λ| < π`.
    Real(Exact),
    /// `μ` of `λ = iμ`: `v⁽ᵏ⁾ = cosh(μ/2ᵏ⁺¹)`.
    Imaginary(Exact),
    /// `v⁽⁰⁾` itself, between 0 and 500.
    Start(Exact),
}

impl Frequency {
    /// The first level parameter, `v⁽⁰⁾`.
    pub fn start(self) -> f64 {
        match self {
            Self::Real(lambda) => (0.5 * lambda.get()).cos(),
            Self::Imaginary(mu) => (0.5 * mu.get()).cosh(),
            Self::Start(v) => v.get(),
        }
    }
}

/// Vertex weights `β_n` of the Loop scheme for `n` neighbours. `original`: `(5/8 − (3/8 + cos(2π/n)/4)²)/n`.
/// `simplified_3_over_8n`: `3/(8n)`, and `3/16` for `n = 3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum LoopWeights {
    /// `(5/8 − (3/8 + cos(2π/n)/4)²)/n`.
    #[default]
    #[cfg_attr(feature = "serde", serde(rename = "original"))]
    Original,
    /// `3/(8n)`, and `3/16` for `n = 3`.
    #[cfg_attr(feature = "serde", serde(rename = "simplified_3_over_8n"))]
    Simplified,
}

/// Subdivision scheme. `blob`: non-stationary and approximating; every vertex must have four or six neighbours. `loop`:
/// approximating. `butterfly`: interpolating. `normal_based`: interpolating, for points with normals; not linear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum SchemeName {
    /// Non-stationary and approximating; every vertex must have four or six neighbours.
    Blob,
    /// The approximating scheme of Loop.
    Loop,
    /// The interpolating modified butterfly scheme.
    Butterfly,
    /// An interpolating scheme for points with normals; not linear.
    NormalBased,
}

impl SchemeName {
    /// The name as written in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Blob => "blob",
            Self::Loop => "loop",
            Self::Butterfly => "butterfly",
            Self::NormalBased => "normal_based",
        }
    }
}

/// Subdivision scheme with its parameters.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SchemeFields {
    /// Name of the scheme.
    pub scheme: SchemeName,
    /// BLOB: frequency `λ` between −π and π. Exactly one of `lambda`, `lambda_imaginary` and `v0` is required.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub lambda: Option<f64>,
    /// BLOB: `μ` of an imaginary frequency `λ = iμ`, within ±13.8.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub lambda_imaginary: Option<f64>,
    /// BLOB: the first level parameter `v⁽⁰⁾ = cos(λ/2)`, between 0 and 500.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0.0, exclusive_maximum = 500.0))]
    pub v0: Option<f64>,
    /// Loop: weights of the vertices. Default: `original`.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub weights: Option<LoopWeights>,
    /// Butterfly: tension `w`, within ±0.125. Default: 0.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = -0.125, maximum = 0.125))]
    pub tension: Option<f64>,
    /// Normal-based: how far the weights of the ends of an edge are equalised, 0 to 1000. Default: 0, as published.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = 0.0, maximum = 1000.0))]
    pub balance: Option<f64>,
}

/// Upper limit of `v⁽⁰⁾`.
const LARGEST_START: f64 = 500.0;
/// Maximum tension; beyond it the butterfly oscillates.
const LARGEST_TENSION: f64 = 0.125;
/// Maximum balance; beyond it the weights are equal to three digits.
const LARGEST_BALANCE: f64 = 1000.0;

impl SchemeFields {
    /// The named scheme, without parameters.
    pub fn named(scheme: SchemeName) -> Self {
        let none = None;
        Self {
            scheme,
            lambda: none,
            lambda_imaginary: none,
            v0: none,
            weights: None,
            tension: none,
            balance: none,
        }
    }

    /// Validates the fields and returns the scheme, or every invalid field with the reason.
    ///
    /// # Errors
    /// Fields that are missing, out of range, or belong to another scheme.
    pub fn scheme(&self) -> Result<Scheme, Vec<(&'static str, String)>> {
        let given = [
            ("lambda", self.lambda.is_some(), SchemeName::Blob),
            ("lambda_imaginary", self.lambda_imaginary.is_some(), SchemeName::Blob),
            ("v0", self.v0.is_some(), SchemeName::Blob),
            ("weights", self.weights.is_some(), SchemeName::Loop),
            ("tension", self.tension.is_some(), SchemeName::Butterfly),
            ("balance", self.balance.is_some(), SchemeName::NormalBased),
        ];
        let mut faults: Vec<(&'static str, String)> = given
            .iter()
            .filter(|(_, given, owner)| *given && *owner != self.scheme)
            .map(|(field, _, owner)| {
                (*field, format!("this field belongs to the scheme \"{}\"", owner.name()))
            })
            .collect();
        let found = match self.scheme {
            SchemeName::Blob => self.frequency().map(Scheme::Blob),
            SchemeName::Loop => Ok(Scheme::Loop(self.weights.unwrap_or_default())),
            SchemeName::Butterfly => within("tension", self.tension, -LARGEST_TENSION, LARGEST_TENSION)
                .map(|tension| Scheme::Butterfly { tension }),
            SchemeName::NormalBased => within("balance", self.balance, 0.0, LARGEST_BALANCE)
                .map(|balance| Scheme::NormalBased { balance }),
        };
        match found {
            Ok(scheme) if faults.is_empty() => Ok(scheme),
            Ok(_) => Err(faults),
            Err(fault) => {
                faults.push(fault);
                Err(faults)
            }
        }
    }

    fn frequency(&self) -> Result<Frequency, (&'static str, String)> {
        let refused = |field, detail: String| Err((field, detail));
        match (self.lambda, self.lambda_imaginary, self.v0) {
            (Some(lambda), None, None) if lambda.abs() < PI => Ok(Frequency::Real(Exact::new(lambda))),
            (Some(lambda), None, None) => {
                refused("lambda", format!("expected a number between −π and π, got {lambda}"))
            }
            (None, Some(mu), None) if (0.5 * mu).cosh() < LARGEST_START => {
                Ok(Frequency::Imaginary(Exact::new(mu)))
            }
            (None, Some(mu), None) => {
                let most = 2.0 * LARGEST_START.acosh();
                refused("lambda_imaginary", format!("expected a number within ±{most:.4}, got {mu}"))
            }
            (None, None, Some(v)) if v > 0.0 && v < LARGEST_START => Ok(Frequency::Start(Exact::new(v))),
            (None, None, Some(v)) => {
                refused("v0", format!("expected a number between 0 and {LARGEST_START}, got {v}"))
            }
            (None, None, None) => refused(
                "lambda",
                "required field is missing: BLOB needs lambda, lambda_imaginary or v0".into(),
            ),
            (None, _, _) => refused("v0", "expected either lambda_imaginary or v0, got both".into()),
            (Some(_), Some(_), _) => {
                refused("lambda_imaginary", "expected either lambda or lambda_imaginary, got both".into())
            }
            (Some(_), None, Some(_)) => refused("v0", "expected either lambda or v0, got both".into()),
        }
    }
}

fn within(
    field: &'static str,
    value: Option<f64>,
    least: f64,
    most: f64,
) -> Result<Exact, (&'static str, String)> {
    let value = value.unwrap_or(0.0);
    if (least..=most).contains(&value) {
        return Ok(Exact::new(value));
    }
    Err((field, format!("expected a number between {least} and {most}, got {value}")))
}

impl From<Scheme> for SchemeFields {
    fn from(scheme: Scheme) -> Self {
        // Default values are not written.
        let unless_zero = |value: Exact| Some(value.get()).filter(|value| *value != 0.0);
        match scheme {
            Scheme::Blob(frequency) => {
                let fields = Self::named(SchemeName::Blob);
                match frequency {
                    Frequency::Real(lambda) => Self { lambda: Some(lambda.get()), ..fields },
                    Frequency::Imaginary(mu) => Self { lambda_imaginary: Some(mu.get()), ..fields },
                    Frequency::Start(v) => Self { v0: Some(v.get()), ..fields },
                }
            }
            Scheme::Loop(weights) => {
                let weights = Some(weights).filter(|weights| *weights != LoopWeights::default());
                Self { weights, ..Self::named(SchemeName::Loop) }
            }
            Scheme::Butterfly { tension } => {
                Self { tension: unless_zero(tension), ..Self::named(SchemeName::Butterfly) }
            }
            Scheme::NormalBased { balance } => {
                Self { balance: unless_zero(balance), ..Self::named(SchemeName::NormalBased) }
            }
        }
    }
}

impl Scheme {
    /// `v⁽ᵏ⁾` of all levels in order: `v⁽ᵏ⁺¹⁾ = √((1 + v⁽ᵏ⁾)/2)`; 1 for stationary schemes.
    pub fn parameters(self) -> impl Iterator<Item = f64> {
        let first = match self {
            Self::Blob(frequency) => frequency.start(),
            _ => 1.0,
        };
        std::iter::successors(Some(first), |v| Some((0.5 * (1.0 + v)).sqrt()))
    }

    /// The scheme from its second step on, whose parameter there is `v⁽¹⁾`.
    fn next(self, parameter: f64) -> Self {
        let half = |value: Exact| Exact::new(0.5 * value.get());
        match self {
            Self::Blob(Frequency::Real(lambda)) => Self::Blob(Frequency::Real(half(lambda))),
            Self::Blob(Frequency::Imaginary(mu)) => Self::Blob(Frequency::Imaginary(half(mu))),
            Self::Blob(Frequency::Start(_)) => Self::Blob(Frequency::Start(Exact::new(parameter))),
            stationary => stationary,
        }
    }

    /// Whether the scheme has rules for boundaries.
    pub fn has_boundary_rules(self) -> bool {
        matches!(self, Self::Loop(_) | Self::NormalBased { .. })
    }

    /// Connectivity of `count` vertices and `faces`, with a boundary only where the scheme has rules for it.
    ///
    /// # Errors
    /// The first reason why they do not form such a mesh.
    pub fn connectivity(self, count: usize, faces: Vec<[u32; 3]>) -> Result<Connectivity, MeshError> {
        if self.has_boundary_rules() {
            Connectivity::with_boundary(count, faces)
        } else {
            Connectivity::new(count, faces)
        }
    }

    /// Whether control vertices keep their positions.
    pub fn interpolates(self) -> bool {
        matches!(self, Self::Butterfly { .. } | Self::NormalBased { .. })
    }
}

/// The subdivision surfaces of one control mesh, up to a level.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "SubdivisionFields", into = "SubdivisionFields"))]
pub struct Subdivision {
    /// The scheme.
    pub scheme: Scheme,
    /// Number of refinement steps.
    pub level: usize,
    /// The control mesh.
    pub connectivity: ControlMesh,
}

impl Subdivision {
    /// Number of vertices and faces at its level, computed without building the mesh.
    pub fn size(&self) -> MeshSize {
        self.connectivity.size().split(self.level)
    }

    /// The control mesh, with a boundary only where the scheme has rules for it.
    ///
    /// # Errors
    /// The first reason why the faces do not form such a mesh.
    pub fn control(&self) -> Result<Connectivity, MeshError> {
        self.connectivity.connectivity_of(self.scheme)
    }
}

/// A control mesh with its subdivision scheme and level.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", schema(as = Subdivision))]
pub struct SubdivisionFields {
    /// The scheme with its parameters.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub scheme: SchemeFields,
    /// Number of refinements of the control mesh. Shapes are measured, drawn and compared at this level; 3 or 4 is usual.
    #[cfg_attr(feature = "schema", schema(maximum = 15))]
    pub level: usize,
    /// The control mesh.
    pub connectivity: ControlMesh,
}

impl TryFrom<SubdivisionFields> for Subdivision {
    type Error = String;

    fn try_from(fields: SubdivisionFields) -> Result<Self, String> {
        let scheme = fields.scheme.scheme().map_err(|faults| {
            let sentences: Vec<String> = faults.iter().map(|(field, why)| format!("{field} {why}")).collect();
            sentences.join("; ")
        })?;
        Ok(Self { scheme, level: fields.level, connectivity: fields.connectivity })
    }
}

impl From<Subdivision> for SubdivisionFields {
    fn from(Subdivision { scheme, level, connectivity }: Subdivision) -> Self {
        Self { scheme: scheme.into(), level, connectivity }
    }
}

#[cfg(feature = "schema")]
impl utoipa::PartialSchema for Subdivision {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        SubdivisionFields::schema()
    }
}

#[cfg(feature = "schema")]
impl utoipa::ToSchema for Subdivision {
    fn name() -> std::borrow::Cow<'static, str> {
        SubdivisionFields::name()
    }

    fn schemas(schemas: &mut Vec<(String, utoipa::openapi::RefOr<utoipa::openapi::schema::Schema>)>) {
        SubdivisionFields::schemas(schemas);
    }
}

/// Number of vertices, edges and faces of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshSize {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of edges.
    pub edges: usize,
    /// Number of faces.
    pub faces: usize,
}

impl MeshSize {
    /// Size of a closed mesh, whose faces have an edge for two of their sides: `E = 3F/2`.
    pub fn closed(vertices: usize, faces: usize) -> Self {
        Self { vertices, edges: faces.saturating_mul(3) / 2, faces }
    }

    /// Size of the mesh of these vertices and faces, with or without a boundary. Cost: sorting the edges.
    pub fn of(vertices: usize, faces: &[[u32; 3]]) -> Self {
        Self { vertices, edges: edges_of(faces).len(), faces: faces.len() }
    }

    /// Size after `level` splits: `V′ = V + E`, `E′ = 2E + 3F`, `F′ = 4F`. Saturates instead of overflowing.
    pub fn split(self, level: usize) -> Self {
        let (mut size, huge) = (self, usize::MAX);
        for _ in 0..level {
            if size.vertices == huge {
                break;
            }
            let edges = size.edges.saturating_mul(2).saturating_add(size.faces.saturating_mul(3));
            size = Self {
                vertices: size.vertices.saturating_add(size.edges),
                edges,
                faces: size.faces.saturating_mul(4),
            };
            if size.faces == huge || size.edges == huge {
                size.vertices = huge;
            }
        }
        size
    }
}

/// The edges of faces as pairs `[least, greatest]`, in lexicographic order. Cost: sorting them.
pub(crate) fn edges_of(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let edge = |a: u32, b: u32| [a.min(b), a.max(b)];
    let mut edges: Vec<[u32; 2]> =
        faces.iter().flat_map(|&[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)]).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table 1 of the BLOB paper.
    #[test]
    fn counts_of_the_octahedron_and_of_levels_that_no_memory_holds() {
        let octahedron = MeshSize::closed(6, 8);
        let counts: Vec<usize> = (0..9).map(|level| octahedron.split(level).vertices).collect();
        assert_eq!(counts, [6, 18, 66, 258, 1026, 4098, 16386, 65538, 262146]);
        assert_eq!(octahedron.split(30).vertices, (1 << 62) + 2);
        for level in [31, 64, 1000, usize::MAX] {
            assert_eq!(octahedron.split(level).vertices, usize::MAX);
        }
        // A fan of four faces: 5 − 8 + 4 = 1 at every level.
        let disc = MeshSize::of(5, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]);
        for level in 0..5 {
            let MeshSize { vertices, edges, faces } = disc.split(level);
            assert_eq!((vertices + faces, faces), (edges + 1, 4 << (2 * level)));
        }
    }

    #[cfg(feature = "serde")]
    #[test]
    fn schemes_are_written_as_they_were_read() {
        let texts = [
            r#"{"scheme":"blob","lambda":1.5}"#,
            r#"{"scheme":"blob","lambda_imaginary":2.0}"#,
            r#"{"scheme":"blob","v0":0.7}"#,
            r#"{"scheme":"loop"}"#,
            r#"{"scheme":"loop","weights":"simplified_3_over_8n"}"#,
            r#"{"scheme":"butterfly","tension":0.02}"#,
            r#"{"scheme":"normal_based"}"#,
        ];
        for text in texts {
            let fields: SchemeFields = serde_json::from_str(text).unwrap();
            let written = serde_json::to_string(&SchemeFields::from(fields.scheme().unwrap())).unwrap();
            assert_eq!(written, text);
        }
    }

    #[cfg(feature = "serde")]
    #[test]
    fn parameters_out_of_place_are_named() {
        let faults = |text: &str| {
            let fields: SchemeFields = serde_json::from_str(text).unwrap();
            fields.scheme().unwrap_err().into_iter().map(|(field, _)| field).collect::<Vec<_>>()
        };
        assert_eq!(faults(r#"{"scheme":"blob"}"#), ["lambda"]);
        assert_eq!(faults(r#"{"scheme":"blob","lambda":3.2}"#), ["lambda"]);
        assert_eq!(faults(r#"{"scheme":"blob","lambda_imaginary":-14}"#), ["lambda_imaginary"]);
        assert_eq!(faults(r#"{"scheme":"blob","v0":0}"#), ["v0"]);
        assert_eq!(faults(r#"{"scheme":"blob","lambda":1,"v0":0.5,"tension":0}"#), ["tension", "v0"]);
        assert_eq!(faults(r#"{"scheme":"loop","lambda":1}"#), ["lambda"]);
        assert_eq!(faults(r#"{"scheme":"butterfly","tension":1}"#), ["tension"]);
    }

    #[test]
    fn level_parameters_follow_the_cosine() {
        let real = Scheme::Blob(Frequency::Real(Exact::new(1.2)));
        let imaginary = Scheme::Blob(Frequency::Imaginary(Exact::new(1.2)));
        for (k, (v, w)) in real.parameters().zip(imaginary.parameters()).take(8).enumerate() {
            let angle = 1.2 / f64::from(2 << k);
            assert!((v - angle.cos()).abs() < 1e-15 && (w - angle.cosh()).abs() < 1e-15, "{k}");
        }
    }
}
