//! Models of shapes: components or atoms, learnt from a set, which describe new shapes and tell those that are unlike the set.

use shapelex_analysis::assessment::Assessor;
use shapelex_analysis::defaults::OUTLIER_QUANTILE;
use shapelex_analysis::dictionary::coding::CodedShape;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::drawing::{View, draw_atoms, draw_mode, mode_title, view_of};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::drawing::scene::Drawing;

use crate::error::{Error, Result};
use crate::points::Points;
use crate::setting::{Aim, Prepared, Setting};
use crate::shapes::{Set, Shapes, Space};

/// Places along a curve where residuals are measured.
const SAMPLES: usize = 100;

/// Components or atoms learnt from shapes.
#[derive(Debug)]
pub struct Model {
    space: Space,
    assessor: Assessor,
    title: String,
}

/// A new shape beside those of a model.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Score {
    /// One number for each component or atom; 0 for atoms that the shape does not take.
    pub values: Vec<f64>,
    /// Squared Mahalanobis distance of the scores of components from those of the training shapes.
    pub t_squared: Option<f64>,
    /// Squared distance from the reconstruction: the part of the shape that the model does not describe.
    pub residual: f64,
    /// Distances between the shape and its reconstruction along the shape, in its pose.
    pub along: Vec<f64>,
    /// Whether the shape is unlike the training shapes, as one of a hundred of them would be called.
    pub is_outlier: bool,
}

impl Model {
    fn of(set: &Set, method: Method, setting: Setting, title: &str) -> Result<Self> {
        let (representation, correspondence) = (set.representation(), set.correspondence());
        let space = Prepared::new(setting, representation, correspondence, (Aim::Mean, method))?;
        let weights = vec![1.0; set.shapes.len()];
        let shapes = space.setting.shapes(set.control_points(&space)?, weights)?;
        let learnt = learn(&shapes, &space.recipe, &Unwatched)?;
        Ok(Self { assessor: Assessor::new(learnt.dictionary), space, title: title.into() })
    }

    fn dictionary(&self) -> &Dictionary {
        &self.assessor.dictionary
    }

    /// Number of components or atoms.
    pub fn len(&self) -> usize {
        self.dictionary().content.atoms.len()
    }

    /// Whether nothing was learnt: all shapes are the same.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Parts of the variance that the components explain; empty for atoms.
    ///
    /// ```
    /// # let width = |k: usize| (0..4).map(move |i| [[0.0, 1.0 + 0.1 * k as f64][i % 2], i as f64]).collect::<Vec<_>>();
    /// let landmarks = shapelex::Landmarks::new((0..12).map(width))?;
    /// let pca = landmarks.pca(shapelex::Class::Translation, 2)?;
    /// assert!(pca.explained()[0] > 0.999);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn explained(&self) -> Vec<f64> {
        self.dictionary().content.atoms.iter().filter_map(|atom| atom.explained).collect()
    }

    /// The shapes at so many standard deviations before the mean, at the mean, and after it, along a component from 0; `None` for a
    /// component that is not there, and for atoms.
    ///
    /// ```
    /// # let width = |k: usize| (0..4).map(move |i| [[0.0, 1.0 + 0.1 * k as f64][i % 2], i as f64]).collect::<Vec<_>>();
    /// let pca = shapelex::Landmarks::new((0..12).map(width))?.pca(shapelex::Class::Rigid, 2)?;
    /// let [low, mean, high] = pca.mode(0, 2.0).expect("a first component");
    /// assert_eq!((low.len(), mean.len(), high.len()), (4, 4, 4));
    /// assert!(pca.mode(9, 2.0).is_none());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn mode(&self, component: usize, deviations: f64) -> Option<[Points; 3]> {
        let mode = self.dictionary().mode(component, deviations)?;
        Some(mode.shapes.map(|shape| Points::of_columns(&shape, self.space.dimension())))
    }

    /// A picture of a component from 0, to both sides of the mean; `None` as for [`Self::mode`].
    ///
    /// ```
    /// # let width = |k: usize| (0..4).map(move |i| [[0.0, 1.0 + 0.1 * k as f64][i % 2], i as f64]).collect::<Vec<_>>();
    /// let pca = shapelex::Landmarks::new((0..12).map(width))?.pca(shapelex::Class::Rigid, 2)?;
    /// let picture = pca.mode_drawing(0, 2.0).expect("a first component");
    /// assert!(shapelex::svg(&picture).contains("</svg>"));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn mode_drawing(&self, component: usize, deviations: f64) -> Option<Drawing> {
        let mode = self.dictionary().mode(component, deviations)?;
        let view: View<'_> = view_of(self.space.space(), self.dictionary());
        let title = mode_title(component, mode.explained, self.dictionary().is_centred());
        Some(draw_mode(&view, &title, deviations, &mode.shapes))
    }

    /// A picture of all components or atoms.
    pub fn drawing(&self) -> Drawing {
        draw_atoms(&view_of(self.space.space(), self.dictionary()), &self.title, self.dictionary())
    }

    /// New shapes beside those of the model. Contours are resampled as the training shapes were.
    ///
    /// # Errors
    /// [`Error::Shape`] for shapes of another kind or dimension, [`Error::Analysis`] for shapes without an extent.
    ///
    /// ```
    /// use shapelex::{Class, Contours};
    ///
    /// let outline = |k: usize, bump: f64| {
    ///     let width = 1.0 + 0.2 * (7.0 * k as f64).sin();
    ///     let radius = move |angle: f64| 1.0 + 0.05 * (3.0 * k as f64).cos() * (2.0 * angle).sin() + bump * (5.0 * angle).cos();
    ///     let angle = |i: usize| i as f64 * std::f64::consts::TAU / 40.0;
    ///     let point = move |i: usize| [width * radius(angle(i)) * angle(i).cos(), radius(angle(i)) * angle(i).sin()];
    ///     (0..40).map(point).collect::<Vec<_>>()
    /// };
    /// let pca = Contours::new((0..60).map(|k| outline(k, 0.0)))?.resample(24).pca(Class::Similarity, 3)?;
    /// let scores = pca.score(&Contours::new([outline(61, 0.0), outline(62, 0.2)])?)?;
    /// assert_eq!(scores[0].values.len(), 3);
    /// assert!(!scores[0].is_outlier && scores[1].is_outlier);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn score<K>(&self, shapes: &Shapes<K>) -> Result<Vec<Score>> {
        self.score_at(shapes, OUTLIER_QUANTILE)
    }

    /// As [`Self::score`] with another part of the shapes like those of the training that counts as usual, from 0.5 to below 1.
    ///
    /// # Errors
    /// As for [`Self::score`]; [`Error::Setting`] for another part.
    ///
    /// ```
    /// # let width = |k: usize| (0..4).map(move |i| [[0.0, 1.0 + 0.1 * k as f64][i % 2], i as f64]).collect::<Vec<_>>();
    /// let landmarks = shapelex::Landmarks::new((0..12).map(width))?;
    /// let pca = landmarks.pca(shapelex::Class::Rigid, 1)?;
    /// assert_eq!(pca.score_at(&landmarks, 0.95)?.len(), 12);
    /// assert!(pca.score_at(&landmarks, 1.0).is_err());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn score_at<K>(&self, shapes: &Shapes<K>, quantile: f64) -> Result<Vec<Score>> {
        if !(0.5..1.0).contains(&quantile) {
            let detail = format!("expected a number from 0.5 to below 1, got {quantile}");
            return Err(Error::Setting { field: "quantile", detail });
        }
        let control_points = shapes.set.control_points(&self.space)?;
        let coded = self.dictionary().encode(&control_points, &Unwatched)?;
        coded.into_iter().enumerate().map(|(index, coded)| self.scored(index, coded, quantile)).collect()
    }

    fn scored(&self, index: usize, coded: CodedShape, quantile: f64) -> Result<Score> {
        let found = self.assessor.assess(self.space.space(), coded, None, quantile, SAMPLES);
        let found = found.map_err(|error| error.at(index))?;
        // A sparse code lists the atoms that it takes.
        let mut values = vec![0.0; self.len()];
        for (&atom, &value) in found.coded.code.indices.iter().zip(&found.coded.code.values) {
            values[atom] = value;
        }
        Ok(Score {
            values,
            t_squared: found.score.t_squared,
            residual: found.score.residual,
            along: found.residual,
            is_outlier: found.score.outlier,
        })
    }

    /// The shape with these scores, in the pose of the model.
    ///
    /// # Errors
    /// [`Error::Setting`] for another number of values than the model has components or atoms.
    ///
    /// ```
    /// # let width = |k: usize| (0..4).map(move |i| [[0.0, 1.0 + 0.1 * k as f64][i % 2], i as f64]).collect::<Vec<_>>();
    /// let pca = shapelex::Landmarks::new((0..12).map(width))?.pca(shapelex::Class::Rigid, 1)?;
    /// let [low, ..] = pca.mode(0, 1.0).expect("a first component");
    /// let mean = pca.reconstruct(&[0.0])?;
    /// assert_eq!(low.len(), mean.len());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn reconstruct(&self, values: &[f64]) -> Result<Points> {
        if values.len() != self.len() {
            let detail = format!("expected {}, one for each component, got {}", self.len(), values.len());
            return Err(Error::Setting { field: "values", detail });
        }
        let indices: Vec<usize> = (0..values.len()).collect();
        let columns = self.dictionary().combine(&indices, values);
        Ok(Points::of_columns(&columns, self.space.dimension()))
    }
}

impl<K> Shapes<K> {
    /// Functional principal components of the aligned shapes about their mean: a [`Model`] that scores new shapes.
    ///
    /// # Errors
    /// As for [`Shapes::mean`].
    ///
    /// ```
    /// use shapelex::{Class, Landmarks};
    ///
    /// let kite = |k: usize| vec![[0.0, 0.0], [1.0, 0.3 * (k as f64).sin()], [0.0, 2.0], [-1.0, 0.3 * (k as f64).cos()]];
    /// let pca = Landmarks::new((0..20).map(kite))?.pca(Class::Similarity, 2)?;
    /// assert_eq!((pca.len(), pca.explained().len()), (2, 2));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn pca(&self, setting: impl Into<Setting>, components: usize) -> Result<Model> {
        Model::of(&self.set, Method::components(components, true), setting.into(), "Components")
    }

    /// A sparse dictionary: so many atoms, of which each shape takes few by the penalty `lambda` of the lasso.
    ///
    /// # Errors
    /// As for [`Shapes::mean`].
    ///
    /// ```
    /// use shapelex::{Class, Landmarks};
    ///
    /// let kite = |k: usize| vec![[0.0, 0.0], [1.0, 0.3 * (k as f64).sin()], [0.0, 2.0], [-1.0, 0.3 * (k as f64).cos()]];
    /// let landmarks = Landmarks::new((0..20).map(kite))?;
    /// let atoms = landmarks.learn(Class::Similarity, 4, 0.05)?;
    /// assert_eq!(atoms.score(&landmarks)?[0].values.len(), atoms.len());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn learn(&self, setting: impl Into<Setting>, atoms: usize, lambda: f64) -> Result<Model> {
        Model::of(&self.set, Method::sparse(atoms, lambda), setting.into(), "Atoms")
    }
}
