//! Classification of shapes: which of several labelled sets a shape belongs to.
//!
//! * [`class_means`] — distance to the mean space of every class;
//! * [`atom_classes`] — the class of the best atom, and the residual of a code restricted to one class;
//! * [`discriminant`] — linear to quadratic discriminants of the features;
//! * [`neighbours`] — votes of the nearest training shapes;
//! * [`ensemble`] — a weighted combination of these;
//! * [`folds`] — folds for cross-validation;
//! * [`quality`] — figures of a validation; [`sharpness`] — calibration of confidences;
//! * [`labels`] — classes and subjects of shapes; [`study`] — training and validation of a classifier;
//! * [`classifier_record`](crate::classifier_record) — settings, trained numbers and validation as records; `requirements` — conditions on settings and
//!   labels; [`consistency`] — conditions on a record.
//!
//! Every classifier gives an [`Evidence`] for each shape: a distance to every class, for interpretation, and a score, which
//! ranks the classes and determines the confidences.
//!
//! Source: Schmitter 2017, sections 4.6 and 4.9; Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*,
//! chapters 4, 7 and 13.

pub mod atom_classes;
mod candidates;
pub mod class_means;
mod classifier;
pub mod consistency;
pub mod discriminant;
pub mod ensemble;
pub mod folds;
pub mod labels;
pub mod neighbours;
mod observations;
pub mod quality;
mod report;
mod requirements;
pub mod sharpness;
mod stored;
pub mod study;

pub use classifier::{Classifier, Kind};
pub use observations::{Description, Evidence, Labelled, Observations};
