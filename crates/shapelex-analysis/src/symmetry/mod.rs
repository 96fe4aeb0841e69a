//! Symmetry and asymmetry of shapes.
//!
//! An operator `S` reflects and relabels: `S c = Π c H` with a reflection `H` and an involution `Π` of the control points that keeps the
//! metric. It splits a shape into parts that are orthogonal, `c = (c + S c)/2 + (c − S c)/2`.
//!
//! * [`relabelling`] — `Π`: pairs of landmarks, or the reversed parameter of curves and surfaces;
//! * [`plane`] — the best plane of one shape in closed form, and planes of a closed curve without markings;
//! * [`sample`] — the table of individuals and sides; [`study`] — tables, indices and maps of aligned shapes;
//! * [`records`] — results; [`error`] — reasons why there is none.
//!
//! Sources: Mardia, Bookstein and Moreton 2000; Klingenberg, Barluenga and Meyer 2002.

pub mod error;
pub mod plane;
pub mod records;
pub mod relabelling;
pub mod sample;
pub mod study;
