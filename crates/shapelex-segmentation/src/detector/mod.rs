//! Detection of thin surfaces: bright or dark sheets in a volume.
//!
//! ```text
//! r = max_v (Δ f_σ − 5 vᵀ H v) = Δ f_σ − 5 λ_min(H),   H = Hessian of f_σ,   |v| = 1
//! ```
//!
//! The kernel `Δg − 5 g_vv` has the best product of signal and localisation among the second-order kernels that are symmetric
//! about `v`. The response is positive on bright sheets, whose normal `v` is the eigenvector of the smallest eigenvalue; dark
//! sheets are the bright ones of `−f`. The factor of the kernel is left out, because thresholds are relative to percentiles of
//! the response.
//!
//! * [`sheets`] — responses and normals; their crests; the usual threshold;
//! * [`surface`] — of a list of cells, those nearest to a centre in every direction, and those that hang together.
//!
//! A usual edge map of the interior of a dark shell: `Sheets::new` with [`Polarity::Dark`](crate::energy::Polarity), then
//! `crests(threshold(0.3, 99))`, [`innermost`], [`largest_component`], and [`edge_map`].

mod hessian;
pub mod sheets;
pub mod surface;

pub use sheets::Sheets;
pub use surface::{Innermost, edge_map, innermost, largest_component};
