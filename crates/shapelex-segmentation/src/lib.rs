//! Segmentation of images and volumes by parametric snakes: shapes that minimise an energy of the image inside them.
//!
//! * [`blur`] — widths of Gaussian blurs; [`texture`] — textures of label images;
//! * [`field`] — images, Gaussian derivatives, and fields integrated in advance along x;
//! * [`contours`] — labelled images and volumes as closed curves and surfaces;
//! * [`frame`] — positions of cells in the world;
//! * [`detector`] — thin bright or dark sheets, and the innermost surface of them around a centre;
//! * [`boundary`] — boundaries sampled from free points, and integrals over the enclosed part;
//! * [`energy`] — terms of the energy of a shape;
//! * [`snake`] — models: curves, spline surfaces and subdivision surfaces by their free points;
//! * [`run`] — stages of minimisation, and the checks between them.
//!
//! # Coordinates
//! Centres of pixels and voxels are whole numbers, `x` is the fastest axis. Outside of an image every field is zero.

pub mod blur;
pub mod boundary;
pub mod contours;
pub mod detector;
pub mod energy;
pub mod field;
pub mod frame;
pub mod run;
pub mod snake;
pub mod texture;

/// Errors of the segmentation layer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentationError {
    /// The number of values is not that of the size.
    #[error("expected {} values for {} × {} × {} cells, got {count}", size.iter().product::<usize>(), size[0], size[1], size[2])]
    Values {
        /// Number of cells along x, y, z.
        size: [usize; 3],
        /// Number of values given.
        count: usize,
    },
    /// An image has no cells.
    #[error("expected at least one cell along every axis, got {} × {} × {}", size[0], size[1], size[2])]
    Empty {
        /// Number of cells along x, y, z.
        size: [usize; 3],
    },
    /// A value of an image is not a finite number.
    #[error("expected finite values, got {value} at cell {index}")]
    NotFinite {
        /// Position of the value, x fastest.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A blur is too small for derivatives.
    #[error("expected a blur of at least {least} cells along every axis for second derivatives, got {sigma}")]
    Blur {
        /// The least blur in cells.
        least: f64,
        /// The smallest one of the three axes, in cells.
        sigma: f64,
    },
    /// An image has too many cells.
    #[error("expected at most {most} cells, got {count}")]
    Cells {
        /// The maximum.
        most: usize,
        /// Number of cells.
        count: usize,
    },
    /// A wanted label does not occur.
    #[error("expected a label of the image, got {label}, which no cell has")]
    Label {
        /// The label.
        label: u32,
    },
    /// Labelled cells have too many components.
    #[error("expected at most {most} components of labelled cells, got {found}")]
    Components {
        /// The maximum.
        most: usize,
        /// Number of components of the least size.
        found: usize,
    },
    /// Labels look like the grey values of a photograph.
    #[error(
        "expected a label image, where each object is a region of one number, got {} pieces with {} different values, {} of them of \
         1 to {} cells, as in a photograph",
        texture.components, texture.labels, texture.crumbs, texture::Texture::CRUMB
    )]
    Photograph {
        /// How finely the labels are divided.
        texture: texture::Texture,
    },
    /// The boundaries of components would have too many vertices.
    #[error("expected at most {most} vertices of boundaries, got {found}")]
    Vertices {
        /// The maximum.
        most: usize,
        /// The predicted number.
        found: usize,
    },
    /// The blur of a mask is negative or too large.
    #[error("expected a blur of the mask between 0 and {most} cells along every axis, got {sigma}")]
    BlurOfMask {
        /// The maximum in cells.
        most: f64,
        /// The blur in cells.
        sigma: f64,
    },
    /// A frame has no inverse.
    #[error(
        "expected an invertible map from indices to positions, got one with determinant {determinant:.1e}"
    )]
    Frame {
        /// The determinant.
        determinant: f64,
    },
    /// The number of free points is not that of the model.
    #[error("expected {expected} free points, got {found}")]
    Rows {
        /// Number of free points of the model.
        expected: usize,
        /// Number given.
        found: usize,
    },
    /// The first shape encloses nothing.
    #[error("expected a first shape that encloses a positive volume, got {volume:.1e}")]
    NoVolume {
        /// The volume, or the area in the plane.
        volume: f64,
    },
    /// A shape without extent in a direction has no affine stage.
    #[error("expected a shape with extent in all directions for an affine stage, got one that is flat")]
    Flat,
    /// There are no stages, or the scene is not prepared for the blur of one.
    #[error("expected stages with blurs of the scene, got {}", blur_of(*sigma))]
    Stages {
        /// The unknown blur.
        sigma: Option<blur::Blur>,
    },
    /// The model has no curvature for Newton's method.
    #[error("expected a planar curve for Newton's method, got a surface")]
    Method,
    /// A scale of a term is not positive.
    #[error("expected a positive scale from {what}, got {value:.1e}")]
    Scale {
        /// The source of the scale.
        what: &'static str,
        /// The value.
        value: f64,
    },
}

fn blur_of(sigma: Option<blur::Blur>) -> String {
    sigma.map_or_else(|| "none".into(), |sigma| format!("one with a blur of {sigma}"))
}

/// The examples of the README are tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
