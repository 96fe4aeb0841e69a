//! Tests: groups of shapes, shapes that change with an attribute, and linear models.

use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::drawing::models::draw_model;
use shapelex_analysis::drawing::studies::{draw_comparison, draw_regression};
use shapelex_analysis::inference::aligned::AlignedShapes;
use shapelex_analysis::inference::compare::compare;
use shapelex_analysis::inference::groups::Groups;
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::records::{GroupComparison, RegressionRecord};
use shapelex_analysis::inference::regress::regress;
use shapelex_analysis::inference::variables::{Values, Variable, Variables};
use shapelex_analysis::models::anova::Testing;
use shapelex_analysis::models::design::{Contrasts, Table, Values as TableValues};
use shapelex_analysis::models::error::ModelError;
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::outcome::ModelRecord;
use shapelex_analysis::models::study::{Further, LOG_CENTROID_SIZE, ModelQuestion, Response, model};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::drawing::scene::Drawing;

use crate::error::{Error, Result};
use crate::setting::{Aim, Prepared, Setting};
use crate::shapes::{Set, Shapes, Space};

/// Places along a curve where groups are compared.
const SAMPLES: usize = 100;

/// Groups of shapes beside each other.
#[derive(Debug)]
pub struct Comparison {
    /// The groups, every two of them, and all at once: see [`GroupComparison`].
    pub found: GroupComparison,
    space: Space,
}

impl Comparison {
    /// The averages of the groups, and where the two that differ most do so.
    pub fn drawing(&self, title: &str) -> Drawing {
        let setting = &self.space.setting;
        draw_comparison((&setting.space, &setting.metric, &setting.method), title, &self.found)
    }

    /// Limitations of the result, such as groups of unequal scatter.
    pub fn warnings(&self) -> &[String] {
        &self.found.warnings
    }
}

/// Shapes that change with an attribute.
#[derive(Debug)]
pub struct Regression {
    /// How much the attribute explains, with its test, and the shapes that it predicts: see [`RegressionRecord`].
    pub found: RegressionRecord,
    /// How far each shape has moved in the direction of the change.
    pub scores: Vec<f64>,
    /// Limitations of the result.
    pub warnings: Vec<String>,
    space: Space,
    shapes: usize,
}

impl Regression {
    /// The predicted shapes from low to high values.
    pub fn drawing(&self, title: &str) -> Drawing {
        let setting = &self.space.setting;
        draw_regression((&setting.space, &setting.method), (title, None), self.shapes, &self.found)
    }
}

/// A linear model of shapes.
#[derive(Debug)]
pub struct LinearModel {
    /// The terms with F, Z and p, coefficients, and predicted shapes: see [`ModelRecord`].
    pub found: ModelRecord,
    space: Space,
    shapes: usize,
}

impl LinearModel {
    /// The predicted shapes over the table of the terms.
    pub fn drawing(&self, title: &str) -> Drawing {
        let setting = &self.space.setting;
        draw_model((&setting.space, &setting.method), title, self.shapes, &self.found)
    }

    /// Limitations of the result, such as groups of unequal scatter.
    pub fn warnings(&self) -> &[String] {
        &self.found.anova.warnings
    }
}

/// The formula, and the table of an analysis of variance.
impl std::fmt::Display for LinearModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.found.anova.printed())
    }
}

/// Shapes prepared for a test.
fn prepared(set: &Set, setting: Setting) -> Result<(Space, Vec<f64>)> {
    if setting.robust {
        let detail = "expected false for a test, whose shapes all count, got true".into();
        return Err(Error::Setting { field: "robust", detail });
    }
    let aim = (Aim::Test, Method::components(1, true));
    let space = Prepared::new(setting, set.representation(), set.correspondence(), aim)?;
    let control_points = set.control_points(&space)?;
    Ok((space, control_points))
}

fn compared(set: &Set, setting: Setting) -> Result<Comparison> {
    let unlabelled = set.labels.iter().position(Option::is_none);
    if let Some(index) = unlabelled {
        return Err(Error::Shape { index, detail: "expected a label, got none".into() });
    }
    let mut names: Vec<String> = set.labels.iter().flatten().cloned().collect();
    names.sort();
    names.dedup();
    let at = |label: &String| names.binary_search(label).unwrap_or_default();
    let labels: Vec<usize> = set.labels.iter().flatten().map(at).collect();
    if names.len() < 2 {
        let detail = format!("expected at least 2 different ones, got {}", names.len());
        return Err(Error::Setting { field: "labels", detail });
    }
    let (space, control_points) = prepared(set, setting)?;
    let strata = vec![0; set.shapes.len()];
    let weights = vec![1.0; set.shapes.len()];
    let shapes = AlignedShapes::new(space.study(), control_points, weights, &Unwatched)?;
    let (seed, permutations) = (space.given.seed, space.given.permutations);
    let draws = Draws { strata: &strata, seed, permutations };
    let found = compare(&shapes, &Groups { names, labels }, draws, SAMPLES, &Unwatched)?;
    Ok(Comparison { found, space })
}

fn regressed(set: &Set, attribute: Variable, setting: Setting) -> Result<Regression> {
    let (space, control_points) = prepared(set, setting)?;
    let count = set.shapes.len();
    let strata = vec![0; count];
    let shapes = AlignedShapes::new(space.study(), control_points, vec![1.0; count], &Unwatched)?;
    let draws = Draws { strata: &strata, seed: space.given.seed, permutations: space.given.permutations };
    let found = regress(&shapes, &Variables { covariates: Vec::new(), attribute }, draws, &Unwatched)?;
    let (scores, warnings) = (found.scores, found.warnings);
    Ok(Regression { found: found.record, scores, warnings, space, shapes: count })
}

fn modelled(set: &Set, formula: &str, table: &Table, setting: Setting) -> Result<LinearModel> {
    let formula = Formula::parse(formula, TermOrder::ByDegree).map_err(ModelError::from)?;
    let count = set.shapes.len();
    let wrong = table.attributes.iter().find(|(_, values)| values.len() != count);
    if let Some((name, values)) = wrong {
        let detail = format!("expected {count} values of '{name}', one for each shape, got {}", values.len());
        return Err(Error::Setting { field: "table", detail });
    }
    let (space, control_points) = prepared(set, setting)?;
    let shapes = AlignedShapes::new(space.study(), control_points, vec![1.0; count], &Unwatched)?;
    let mut table = table.clone();
    if let Some(sizes) = shapes.log_centroid_sizes() {
        table.attributes.entry(LOG_CENTROID_SIZE.into()).or_insert(TableValues::Numbers(sizes));
    }
    if let Some(labels) = set.labels.iter().cloned().collect::<Option<Vec<String>>>() {
        table.attributes.entry("label".into()).or_insert(TableValues::Texts(labels));
    }
    let testing =
        Testing { seed: space.given.seed, permutations: space.given.permutations, ..Testing::default() };
    let question = ModelQuestion {
        formula: &formula,
        table: &table,
        contrasts: Contrasts::Treatment,
        response: Response::Shape,
        testing,
        at: None,
        further: Further::default(),
        random: None,
        manova: None,
        covariance: None,
    };
    let found = model(&shapes, &question, &Unwatched)?;
    Ok(LinearModel { found, space, shapes: count })
}

impl<K> Shapes<K> {
    /// Fits a linear model by a formula as R reads it, with sums of squares of type II. Its attributes are those of the table, `label` of
    /// shapes that have [labels](Self::labels), and `log_centroid_size`.
    ///
    /// # Errors
    /// [`Error::Model`] for a formula that cannot be read, attributes that the table has not, or fewer shapes than columns;
    /// [`Error::Setting`] for another number of values.
    ///
    /// ```
    /// use shapelex::{Landmarks, Setting, Table};
    ///
    /// let kite = |k: usize| {
    ///     let long = if k % 2 == 0 { 2.0 } else { 2.6 };
    ///     let noise = |j: usize| 0.1 * ((7 * k * k + 13 * j) as f64).sin();
    ///     vec![[0.0, noise(0)], [1.0 + noise(1), 0.0], [noise(2), long], [-1.0 + noise(3), 0.0]]
    /// };
    /// let table = Table::default()
    ///     .with_factor("sex", (0..24).map(|k| if k % 2 == 0 { "f" } else { "m" }))
    ///     .with_numbers("age", (0..24).map(|k| 20.0 + (k / 2) as f64));
    /// let mut setting = Setting::default();
    /// setting.permutations = 199;
    /// let model = Landmarks::new((0..24).map(kite))?.lm(setting, "~ sex * age", &table)?;
    /// let terms = &model.found.anova.terms;
    /// assert_eq!(terms.iter().map(|term| term.term.as_str()).collect::<Vec<_>>(), ["sex", "age", "sex:age"]);
    /// assert!(terms[0].p.is_some_and(|p| p <= 0.01) && terms[2].p.is_some_and(|p| p > 0.05));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn lm(&self, setting: impl Into<Setting>, formula: &str, table: &Table) -> Result<LinearModel> {
        modelled(&self.set, formula, table, setting.into())
    }

    /// Compares the groups of the [labels](Self::labels) by permutation tests: every two, and all at once.
    ///
    /// # Errors
    /// [`Error::Shape`] for a shape without a label, [`Error::Setting`] for one label only, [`Error::Study`] for groups that are too
    /// small.
    ///
    /// ```
    /// use shapelex::{Landmarks, Setting};
    ///
    /// let kite = |k: usize| {
    ///     let long = if k < 12 { 2.0 } else { 2.6 };
    ///     let noise = |j: usize| 0.1 * ((7 * k * k + 13 * j) as f64).sin();
    ///     vec![[0.0, noise(0)], [1.0 + noise(1), 0.0], [noise(2), long], [-1.0 + noise(3), 0.0]]
    /// };
    /// let labels = (0..24).map(|k| if k < 12 { "short" } else { "long" });
    /// let mut setting = Setting::default();
    /// setting.permutations = 199;
    /// let comparison = Landmarks::new((0..24).map(kite))?.with_labels(labels)?.compare(setting)?;
    /// let pair = &comparison.found.pairs[0];
    /// assert_eq!((pair.first.as_str(), pair.second.as_str()), ("long", "short"));
    /// assert!(pair.distance.test.p.is_some_and(|p| p <= 0.01));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn compare(&self, setting: impl Into<Setting>) -> Result<Comparison> {
        compared(&self.set, setting.into())
    }

    /// Regresses the shapes on numbers, one for each.
    ///
    /// # Errors
    /// [`Error::Setting`] for another number of values or for values that are not numbers, [`Error::Study`] for values that do not vary.
    ///
    /// ```
    /// use shapelex::{Landmarks, Setting};
    ///
    /// let kite = |k: usize| {
    ///     let noise = |j: usize| 0.05 * ((7 * k * k + 13 * j) as f64).sin();
    ///     vec![[0.0, noise(0)], [1.0 + noise(1), 0.0], [noise(2), 2.0 + 0.05 * k as f64], [-1.0 + noise(3), 0.0]]
    /// };
    /// let ages: Vec<f64> = (0..20).map(|k| 20.0 + k as f64).collect();
    /// let mut setting = Setting::default();
    /// setting.permutations = 199;
    /// let regression = Landmarks::new((0..20).map(kite))?.regress(setting, "age", &ages)?;
    /// assert!(regression.found.r_squared > 0.5);
    /// assert!(regression.found.test.p.is_some_and(|p| p <= 0.01));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn regress(&self, setting: impl Into<Setting>, name: &str, values: &[f64]) -> Result<Regression> {
        if values.len() != self.len() {
            let detail = format!("expected {}, one for each shape, got {}", self.len(), values.len());
            return Err(Error::Setting { field: "values", detail });
        }
        if let Some(at) = values.iter().position(|value| !(value.abs() <= shapelex_numeric::MAX_NUMBER)) {
            let most = shapelex_numeric::MAX_NUMBER;
            let detail = format!("value {at}: expected a number within ±{most:e}, got {}", values[at]);
            return Err(Error::Setting { field: "values", detail });
        }
        let values = Values::Numbers(values.to_vec());
        regressed(&self.set, Variable { name: name.into(), values }, setting.into())
    }

    /// Allometry: the regression of the shapes on the logarithms of their centroid sizes.
    ///
    /// # Errors
    /// As for [`Self::regress`].
    ///
    /// ```
    /// use shapelex::{Landmarks, Setting};
    ///
    /// let kite = |k: usize| {
    ///     let size = 1.0 + 0.1 * k as f64;
    ///     vec![[0.0, 0.0], [size, 0.0], [0.0, 2.0 * size * (1.0 + 0.1 * size)], [-size, 0.01 * (k * k % 7) as f64]]
    /// };
    /// let mut setting = Setting::default();
    /// setting.permutations = 99;
    /// let allometry = Landmarks::new((0..20).map(kite))?.allometry(setting)?;
    /// assert!(allometry.found.r_squared > 0.5);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn allometry(&self, setting: impl Into<Setting>) -> Result<Regression> {
        let attribute = Variable { name: "log centroid size".into(), values: Values::LogCentroidSize };
        regressed(&self.set, attribute, setting.into())
    }
}
