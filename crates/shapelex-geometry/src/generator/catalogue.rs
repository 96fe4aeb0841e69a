//! The catalogue of generators with their properties.

use std::f64::consts::{PI, TAU};
use std::sync::{Arc, LazyLock, Mutex};

use hashlink::LruCache;

use super::bspline::normalised_bspline;
use super::interpolator::{self, Interpolator, MIN_POLES, free_weights};
use super::piecewise::{Generator, phantoms};
use super::poles::{MAX_POLES, MAX_REAL_PART, Poles};
use crate::GeometryError;

/// A number that is compared and hashed by its bits, so that it can be part of a key.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(transparent))]
pub struct Exact(f64);

impl Exact {
    /// Wraps a number; −0 becomes 0.
    pub const fn new(value: f64) -> Self {
        Self(value + 0.0)
    }

    /// The number.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl PartialEq for Exact {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Eq for Exact {}

impl std::hash::Hash for Exact {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.0.to_bits().hash(state);
    }
}

/// Poles of a generator: complex numbers `[re, im]`. The list must be symmetric (`α = −α`) and closed under conjugation.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum PoleList {
    /// Poles on the integer grid of the knots, `|Im α| < π`: functions `e^{αt}` of the knot number `t`. In place of
    /// `domain_poles`.
    #[cfg_attr(feature = "schema", schema(value_type = Vec<Vec<f64>>, example = json!({"poles": [[0.0, 0.0], [0.0, 0.5], [0.0, -0.5]]})))]
    Poles(Vec<[Exact; 2]>),
    /// Poles on the whole domain: functions of `u ∈ [0, 1]`. They are divided by the number of control points (closed curves)
    /// or intervals (open curves). In place of `poles`.
    #[cfg_attr(feature = "schema", schema(value_type = Vec<Vec<f64>>, example = json!({"domain_poles": [[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]})))]
    DomainPoles(Vec<[Exact; 2]>),
    /// Poles of functions of `v ∈ [0, 1]` from pole to pole of a sphere, divided by the number of intervals `M_v`. Requests may call them
    /// `domain_poles`; answers name them apart from the `domain_poles` of spheres that were stored by version 0.1.0, which are
    /// divided by `2M_v`.
    #[cfg_attr(feature = "schema", schema(value_type = Vec<Vec<f64>>, example = json!({"meridian_poles": [[0.0, 0.0], [0.0, PI], [0.0, -PI]]})))]
    MeridianPoles(Vec<[Exact; 2]>),
}

impl PoleList {
    /// Poles on the integer grid.
    pub fn on_grid(list: &[[f64; 2]]) -> Self {
        Self::Poles(exact(list))
    }

    /// Poles on the whole domain.
    pub fn from_domain(list: &[[f64; 2]]) -> Self {
        Self::DomainPoles(exact(list))
    }

    /// Name of the field in a request.
    pub fn field(&self) -> &'static str {
        match self {
            Self::Poles(_) => "poles",
            Self::DomainPoles(_) | Self::MeridianPoles(_) => "domain_poles",
        }
    }

    fn numbers(&self) -> Vec<[f64; 2]> {
        let (Self::Poles(list) | Self::DomainPoles(list) | Self::MeridianPoles(list)) = self;
        list.iter().map(|pole| pole.map(Exact::get)).collect()
    }

    fn len(&self) -> usize {
        let (Self::Poles(list) | Self::DomainPoles(list) | Self::MeridianPoles(list)) = self;
        list.len()
    }

    /// The poles on a grid of `intervals` intervals.
    ///
    /// # Errors
    /// [`GeometryError::Unpaired`].
    fn on(&self, intervals: usize) -> Result<Poles, GeometryError> {
        let poles = Poles::from_list(&self.numbers())?;
        Ok(match self {
            Self::Poles(_) => poles,
            Self::DomainPoles(_) | Self::MeridianPoles(_) => poles.refined(intervals as f64),
        })
    }

    /// The poles of the same functions of `u` on a grid `factor` times as fine.
    fn refined(&self, factor: usize) -> Self {
        match self {
            Self::Poles(list) => Self::Poles(
                list.iter().map(|pole| pole.map(|part| Exact::new(part.get() / factor as f64))).collect(),
            ),
            Self::DomainPoles(_) | Self::MeridianPoles(_) => self.clone(),
        }
    }

    /// Smallest number of intervals for which the poles are admissible.
    fn fewest_intervals(&self) -> usize {
        match self {
            Self::Poles(_) => 1,
            Self::DomainPoles(_) | Self::MeridianPoles(_) => {
                let needed = |[re, im]: [f64; 2]| {
                    ((im.abs() / PI).floor() + 1.0).max((re.abs() / MAX_REAL_PART).ceil())
                };
                self.numbers().into_iter().map(needed).fold(1.0, f64::max) as usize
            }
        }
    }
}

fn exact(list: &[[f64; 2]]) -> Vec<[Exact; 2]> {
    list.iter().map(|pole| pole.map(Exact::new)).collect()
}

/// Family of interpolators. `integer_shifts`: B-splines of increasing order. `half_integer_shifts`: one B-spline at
/// half-integer shifts; can be refined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Family {
    /// B-splines of increasing order, with even supports and integer knots. Default support: `2(n − 1)` with `n` poles.
    IntegerShifts,
    /// One B-spline at half-integer shifts. Support `2(n − 1)` with `n` poles; can be refined.
    HalfIntegerShifts,
}

/// Generator: the function whose integer shifts span the curves.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "name", rename_all = "snake_case"))]
pub enum GeneratorKind {
    /// The interpolator that reproduces circles and ellipses on a closed curve with `M ≥ 3` control points. Support 4, C¹;
    /// approaches `cubic` as `M` grows.
    Trigonometric {},
    /// The cubic interpolator of Keys (1981). Support 4, C¹; reproduces polynomials of degree 2. `keys` is an alias.
    #[cfg_attr(feature = "serde", serde(alias = "keys"))]
    Cubic {},
    /// The polynomial B-spline of degree 1 to 5. Interpolating for degree 1 only; the smoothest generator for its support.
    Bspline {
        /// Degree, 1 to 5.
        #[cfg_attr(feature = "schema", schema(minimum = 1, maximum = 5))]
        degree: u8,
    },
    /// The exponential B-spline with 2 to 10 poles, normalised to `∫φ = 1`. Not interpolating; the smoothest generator for its
    /// support; a partition of unity if and only if 0 is a pole. With the domain poles `0, ±2πj` it contains all ellipses.
    Exponential {
        /// Poles of the B-spline.
        #[cfg_attr(feature = "serde", serde(flatten))]
        poles: PoleList,
    },
    /// The exponential B-spline with 3, 5, 7 or 9 poles, shifted by half an interval: `φ(t − ½)`. Its knots are those of the line, for open
    /// directions, which begin and end at knots. Refinement of half-integer shifts, and of B-splines by even factors, leads to it.
    ShiftedExponential {
        /// Poles of the B-spline, an odd number.
        #[cfg_attr(feature = "serde", serde(flatten))]
        poles: PoleList,
    },
    /// An interpolator built from exponential B-splines, with 3 to 10 poles.
    Interpolator {
        /// Family of the interpolator.
        family: Family,
        /// Poles `α` of the functions that are reproduced from samples.
        #[cfg_attr(feature = "serde", serde(flatten))]
        poles: PoleList,
        /// Length of the support, for `integer_shifts`. Default: `2(n − 1)` with `n` poles.
        #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none", default))]
        support: Option<usize>,
        /// Weights of the lowest orders, where a longer support leaves them free. Default: 0.
        #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty", default))]
        #[cfg_attr(feature = "schema", schema(value_type = Option<Vec<f64>>))]
        weights: Vec<Exact>,
    },
}

/// Properties of a generator.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct GeneratorProperties {
    /// Length of the support, in units of the knot distance.
    #[cfg_attr(feature = "schema", schema(example = 4))]
    pub support: usize,
    /// Number of continuous derivatives.
    #[cfg_attr(feature = "schema", schema(example = 1))]
    pub smoothness: usize,
    /// Whether the control points lie on the shape.
    pub interpolating: bool,
    /// Whether the shifts sum to one, so that moving all control points moves the shape.
    pub partition_of_unity: bool,
    /// Functions that are reproduced exactly: of the parameter `u ∈ [0, 1]` for domain poles, otherwise of the knot number
    /// `t`.
    #[cfg_attr(feature = "schema", schema(example = json!(["constants", "circles and ellipses"])))]
    pub reproduces: Vec<String>,
    /// Minimum number of control points of a closed curve.
    #[cfg_attr(feature = "schema", schema(example = 3))]
    pub fewest_control_points: usize,
    /// Minimum number of intervals of an open curve.
    #[cfg_attr(feature = "schema", schema(example = 3))]
    pub fewest_intervals: usize,
}

/// Maximum degree of polynomial B-splines.
const MAX_DEGREE: u8 = 5;

/// Minimum number of control points of a closed curve.
const MIN_CLOSED: usize = 3;

impl GeneratorKind {
    /// One generator of each kind, in catalogue order; those with poles are set up to reproduce ellipses.
    pub fn catalogue() -> Vec<Self> {
        let ellipses = || PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]);
        let interpolator =
            |family| Self::Interpolator { family, poles: ellipses(), support: None, weights: Vec::new() };
        let splines = (1..=MAX_DEGREE).map(|degree| Self::Bspline { degree });
        [Self::Trigonometric {}, Self::Cubic {}]
            .into_iter()
            .chain(splines)
            .chain([Self::Exponential { poles: ellipses() }])
            .chain([Family::IntegerShifts, Family::HalfIntegerShifts].map(interpolator))
            .collect()
    }

    /// Name of the generator in a representation.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Trigonometric {} => "trigonometric",
            Self::Cubic {} => "cubic",
            Self::Bspline { .. } => "bspline",
            Self::Exponential { .. } => "exponential",
            Self::ShiftedExponential { .. } => "shifted_exponential",
            Self::Interpolator { .. } => "interpolator",
        }
    }

    /// All errors in the parameters: path of the field (for a pole, within the list) and detail.
    pub fn faults(&self) -> Vec<(String, String)> {
        let mut faults = Vec::new();
        match self {
            Self::Trigonometric {} | Self::Cubic {} => {}
            Self::Bspline { degree } => {
                if !(1..=MAX_DEGREE).contains(degree) {
                    faults.push((
                        "degree".into(),
                        format!("expected a degree between 1 and {MAX_DEGREE}, got {degree}"),
                    ));
                }
            }
            Self::Exponential { poles } => faults.extend(pole_faults(poles, 2)),
            Self::ShiftedExponential { poles } => {
                faults.extend(pole_faults(poles, MIN_POLES));
                if faults.is_empty() && poles.len().is_multiple_of(2) {
                    let detail = format!(
                        "expected an odd number of poles, got {}: knots of others are at the integers without a shift",
                        poles.len()
                    );
                    faults.push((poles.field().into(), detail));
                }
            }
            Self::Interpolator { family, poles, support, weights } => {
                faults.extend(pole_faults(poles, MIN_POLES));
                faults.extend(support_faults(*family, poles.len(), *support, weights));
            }
        }
        faults
    }

    /// Poles of the reproduced functions, and the variable of these functions.
    fn reproduced(&self) -> (Poles, char) {
        let listed = |poles: &PoleList| {
            let variable = if matches!(poles, PoleList::Poles(_)) { 't' } else { 'u' };
            // Pairing is quadratic: lists that are rejected for their length are not paired.
            let numbers = if poles.len() <= MAX_POLES { poles.numbers() } else { Vec::new() };
            (Poles::from_list(&numbers).unwrap_or_default(), variable)
        };
        match self {
            Self::Trigonometric {} => (Poles::trigonometric(1, TAU), 'u'),
            Self::Cubic {} => (Poles::zeros(3), 't'),
            Self::Bspline { degree } => (Poles::zeros(*degree as usize + 1), 't'),
            Self::Exponential { poles }
            | Self::ShiftedExponential { poles }
            | Self::Interpolator { poles, .. } => listed(poles),
        }
    }

    /// Length of the support. The parameters must be valid.
    pub fn support(&self) -> usize {
        let order = self.reproduced().0.order();
        match self {
            Self::Bspline { .. } | Self::Exponential { .. } => order,
            Self::ShiftedExponential { .. } => order + 1,
            Self::Interpolator { support: Some(support), .. } => *support,
            _ => 2 * order.saturating_sub(1),
        }
    }

    /// Properties that follow without building the generator. The parameters must be valid.
    pub fn properties(&self) -> GeneratorProperties {
        let (poles, variable) = self.reproduced();
        let interpolating = match self {
            Self::Bspline { degree } => *degree == 1,
            // Only the hat function is interpolating: for other pairs of poles `φ(0) ≠ 1`, because `∫φ = 1`.
            Self::Exponential { .. } => poles.order() == 2 && poles.zeros == 2,
            Self::ShiftedExponential { .. } => false,
            _ => true,
        };
        let admissible = match self {
            Self::Trigonometric {} => MIN_CLOSED,
            Self::Exponential { poles }
            | Self::ShiftedExponential { poles }
            | Self::Interpolator { poles, .. } => poles.fewest_intervals(),
            _ => 1,
        };
        GeneratorProperties {
            support: self.support(),
            smoothness: poles.order().saturating_sub(2),
            interpolating,
            partition_of_unity: poles.zeros > 0,
            reproduces: describe(&poles, variable),
            fewest_control_points: admissible.max(MIN_CLOSED),
            fewest_intervals: admissible.max(poles.order().saturating_sub(1)).max(1),
        }
    }

    /// Construction of the generator for a curve of `intervals` intervals (closed: number of control points).
    ///
    /// # Errors
    /// [`GeometryError::Unpaired`].
    pub fn recipe(&self, intervals: usize) -> Result<Recipe, GeometryError> {
        let square = |poles: Poles| {
            let support = 2 * poles.order().saturating_sub(1);
            Recipe::IntegerShifts { poles, support, weights: Vec::new() }
        };
        Ok(match self {
            Self::Trigonometric {} => square(Poles::trigonometric(1, TAU / intervals as f64)),
            Self::Cubic {} => square(Poles::zeros(3)),
            Self::Bspline { degree } => Recipe::Bspline(Poles::zeros(*degree as usize + 1)),
            Self::Exponential { poles } => Recipe::Bspline(poles.on(intervals)?),
            Self::ShiftedExponential { poles } => Recipe::ShiftedBspline(poles.on(intervals)?),
            Self::Interpolator { family: Family::HalfIntegerShifts, poles, .. } => {
                Recipe::HalfIntegerShifts(poles.on(intervals)?)
            }
            Self::Interpolator { family: Family::IntegerShifts, poles, support, weights } => {
                let weights = weights.iter().map(|weight| weight.get()).collect();
                match (square(poles.on(intervals)?), support) {
                    (Recipe::IntegerShifts { poles, support: shortest, .. }, given) => {
                        Recipe::IntegerShifts { poles, support: given.unwrap_or(shortest), weights }
                    }
                    (other, _) => other,
                }
            }
        })
    }

    /// The generator for a curve of `intervals` intervals. Built generators are cached and shared.
    ///
    /// # Errors
    /// As for [`Recipe::build`].
    pub fn build(&self, intervals: usize) -> Result<Arc<Built>, GeometryError> {
        self.recipe(intervals)?.build_once()
    }

    /// Whether refinement is possible by even factors only.
    pub fn needs_even_factors(&self) -> bool {
        matches!(self, Self::Interpolator { family: Family::HalfIntegerShifts, .. })
    }

    /// Whether it is a combination of B-splines on a grid `factor` times as fine.
    pub(crate) fn has_two_scale(&self, factor: usize) -> bool {
        match self {
            Self::Bspline { .. } | Self::Exponential { .. } | Self::ShiftedExponential { .. } => true,
            Self::Trigonometric {} | Self::Cubic {} | Self::Interpolator { .. } => {
                self.needs_even_factors() && factor.is_multiple_of(2)
            }
        }
    }

    /// The generator on a grid `factor` times as fine of whose shifts this one is a combination, where it has a two-scale relation:
    /// a B-spline.
    pub(crate) fn two_scale(&self, factor: usize) -> Self {
        match self {
            Self::Interpolator { poles, .. } => Self::Exponential { poles: poles.refined(factor) },
            _ => self.refined(factor),
        }
    }

    /// As [`Self::two_scale`], for an even split of an odd number of poles, whose B-splines have their knots between those of the finer
    /// grid: with these shifted by half an interval.
    pub(crate) fn two_scale_shifted(&self, factor: usize) -> Self {
        match self.two_scale(factor) {
            Self::Bspline { degree } => {
                Self::ShiftedExponential { poles: PoleList::on_grid(&vec![[0.0; 2]; degree as usize + 1]) }
            }
            Self::Exponential { poles } => Self::ShiftedExponential { poles },
            other => other,
        }
    }

    /// Whether it is a B-spline that is shifted by half an interval.
    pub fn is_shifted(&self) -> bool {
        matches!(self, Self::ShiftedExponential { .. })
    }

    /// Numbers of control points beyond both ends of an open line, as [`Generator::beyond`].
    pub fn beyond(&self) -> [usize; 2] {
        let before = phantoms(self.support());
        [before, before - usize::from(self.is_shifted())]
    }

    /// Whether its poles are those of functions of `v ∈ [0, 1]` from pole to pole.
    fn is_of_meridian(&self) -> bool {
        matches!(
            self,
            Self::Exponential { poles: PoleList::MeridianPoles(_) }
                | Self::ShiftedExponential { poles: PoleList::MeridianPoles(_) }
                | Self::Interpolator { poles: PoleList::MeridianPoles(_), .. }
        )
    }

    /// The same generator along a meridian, as a request has it: `domain_poles` are those of functions of `v ∈ [0, 1]`.
    #[must_use]
    pub fn of_meridian(mut self) -> Self {
        if let Self::Exponential { poles }
        | Self::ShiftedExponential { poles }
        | Self::Interpolator { poles, .. } = &mut self
            && let PoleList::DomainPoles(list) = poles
        {
            *poles = PoleList::MeridianPoles(std::mem::take(list));
        }
        self
    }

    /// Number of intervals to which the poles of this generator belong along a meridian of `intervals` from pole to pole: the
    /// circle of `trigonometric`, and the `domain_poles` of version 0.1.0, close over the whole great circle.
    pub(crate) fn meridian_count(&self, intervals: usize) -> usize {
        if self.is_of_meridian() { intervals } else { 2 * intervals }
    }

    /// Smallest number of intervals along a meridian for which the poles are admissible.
    pub(crate) fn fewest_along_meridian(&self) -> usize {
        let fewest = self.properties().fewest_control_points;
        match self {
            Self::Exponential { poles }
            | Self::ShiftedExponential { poles }
            | Self::Interpolator { poles, .. }
                if self.is_of_meridian() =>
            {
                poles.fewest_intervals()
            }
            _ => fewest.div_ceil(2),
        }
    }

    /// The generator of the same family for the same functions of `u` on a grid `factor` times as fine.
    pub fn refined(&self, factor: usize) -> Self {
        match self {
            Self::Exponential { poles } => Self::Exponential { poles: poles.refined(factor) },
            Self::ShiftedExponential { poles } => Self::ShiftedExponential { poles: poles.refined(factor) },
            Self::Interpolator { family, poles, support, weights } => Self::Interpolator {
                family: *family,
                poles: poles.refined(factor),
                support: *support,
                weights: weights.clone(),
            },
            other => other.clone(),
        }
    }
}

fn pole_faults(poles: &PoleList, fewest: usize) -> Vec<(String, String)> {
    let (field, count) = (poles.field(), poles.len());
    if !(fewest..=MAX_POLES).contains(&count) {
        return vec![(field.into(), format!("expected {fewest} to {MAX_POLES} poles, got {count}"))];
    }
    let checked = Poles::from_list(&poles.numbers()).and_then(|found| match poles {
        PoleList::Poles(_) => found.check(),
        PoleList::DomainPoles(_) | PoleList::MeridianPoles(_) => Ok(()),
    });
    match checked {
        Ok(()) => Vec::new(),
        Err(error @ GeometryError::Unpaired { index, .. }) => {
            vec![(format!("{field}/{index}"), error.to_string())]
        }
        Err(error) => vec![(field.into(), error.to_string())],
    }
}

fn support_faults(
    family: Family,
    order: usize,
    support: Option<usize>,
    weights: &[Exact],
) -> Vec<(String, String)> {
    let shortest = 2 * order.saturating_sub(1);
    if family == Family::HalfIntegerShifts {
        let given = [("support", support.is_some()), ("weights", !weights.is_empty())];
        let wrong = given.into_iter().filter(|(_, given)| *given);
        return wrong
            .map(|(field, _)| (field.into(), "this field belongs to the family integer_shifts".into()))
            .collect();
    }
    // Faults of the poles are already reported.
    if !(MIN_POLES..=MAX_POLES).contains(&order) {
        return Vec::new();
    }
    let support = support.unwrap_or(shortest);
    let longest = 2 * (MAX_POLES - 1);
    if !(shortest..=longest).contains(&support) {
        let detail = format!(
            "expected a support between {shortest} and {longest}, got {support}: on a shorter one, {order} poles \
             leave more equations than weights"
        );
        return vec![("support".into(), detail)];
    }
    let free = free_weights(order, support).unwrap_or(0);
    let mut faults = Vec::new();
    if weights.len() > free {
        let detail = format!(
            "expected at most {free} weights for {order} poles on a support of {support}, got {}",
            weights.len()
        );
        faults.push(("weights".into(), detail));
    }
    let wild = weights.iter().position(|weight| !(weight.get().abs() <= MAX_WEIGHT));
    faults.extend(wild.map(|i| (format!("weights/{i}"), format!("expected a number within ±{MAX_WEIGHT}"))));
    faults
}

/// Maximum free weight; with larger ones the generator is a difference of large numbers.
const MAX_WEIGHT: f64 = 1e3;

/// Describes the functions `tᵏ e^{αt}` of a pole list in words.
fn describe(poles: &Poles, variable: char) -> Vec<String> {
    let mut words = Vec::new();
    match poles.zeros {
        0 => {}
        1 => words.push("constants".to_owned()),
        n => words.push(format!("polynomials of degree {}", n - 1)),
    }
    let distinct = |list: &[f64]| {
        let mut seen: Vec<(f64, usize)> = Vec::new();
        for &value in list {
            match seen.iter_mut().find(|(known, _)| *known == value) {
                Some((_, count)) => *count += 1,
                None => seen.push((value, 1)),
            }
        }
        seen
    };
    let times = |count: usize| if count > 1 { format!(" times powers below {count}") } else { String::new() };
    for (w, count) in distinct(&poles.trigonometric) {
        if variable == 'u' && w == TAU && poles.zeros > 0 {
            words.push("circles and ellipses".to_owned());
        } else {
            words.push(format!("cos({w:.6}{variable}), sin({w:.6}{variable}){}", times(count)));
        }
    }
    for (a, count) in distinct(&poles.hyperbolic) {
        words.push(format!("cosh({a:.6}{variable}), sinh({a:.6}{variable}){}", times(count)));
    }
    for (a, b) in &poles.quadruples {
        words.push(format!(
            "exp(±{a:.6}{variable})·cos({b:.6}{variable}), exp(±{a:.6}{variable})·sin({b:.6}{variable})"
        ));
    }
    words
}

/// Construction of a generator on the integer grid.
#[derive(Debug, Clone, PartialEq)]
pub enum Recipe {
    /// The normalised B-spline.
    Bspline(Poles),
    /// The normalised B-spline of an odd order, shifted by half an interval.
    ShiftedBspline(Poles),
    /// An interpolator of B-splines of increasing order.
    IntegerShifts {
        /// The poles of the lowest order.
        poles: Poles,
        /// Length of the support.
        support: usize,
        /// Free weights of the lowest orders.
        weights: Vec<f64>,
    },
    /// An interpolator of one B-spline at half-integer shifts.
    HalfIntegerShifts(Poles),
}

/// A generator with the results of its construction.
#[derive(Debug, Clone)]
pub struct Built {
    /// The generator itself.
    pub generator: Arc<Generator>,
    /// Poles of the reproduced functions, on the integer grid.
    pub poles: Poles,
    /// Weights of an interpolator: `λ_{n₀} … λ_N` for increasing orders, or `λ[0] …` for half-integer shifts.
    pub weights: Option<Vec<f64>>,
    /// Condition number (1-norm) of the linear system for the weights.
    pub condition: Option<f64>,
}

/// Cache of built generators; evicts the least recently used one.
static BUILT: LazyLock<Mutex<LruCache<String, Arc<Built>>>> =
    LazyLock::new(|| Mutex::new(LruCache::new(256)));

impl Recipe {
    /// Poles of the reproduced functions.
    pub fn poles(&self) -> &Poles {
        match self {
            Self::Bspline(poles)
            | Self::ShiftedBspline(poles)
            | Self::IntegerShifts { poles, .. }
            | Self::HalfIntegerShifts(poles) => poles,
        }
    }

    /// Builds the generator. Cost `10–50 µs` for up to six poles, about a millisecond where double-double
    /// arithmetic is needed.
    ///
    /// # Errors
    /// [`GeometryError::Pole`] outside the admissible domain, [`GeometryError::Unsolvable`] if the interpolation
    /// conditions have no stable solution.
    pub fn build(&self) -> Result<Built, GeometryError> {
        let interpolator = match self {
            Self::Bspline(poles) | Self::ShiftedBspline(poles) => {
                let generator = normalised_bspline(poles)?;
                let is_shifted = matches!(self, Self::ShiftedBspline(_));
                let generator = Arc::new(if is_shifted { generator.shifted() } else { generator });
                return Ok(Built { generator, poles: poles.clone(), weights: None, condition: None });
            }
            Self::IntegerShifts { poles, support, weights } => {
                interpolator::integer_shifts(poles, *support, weights)?
            }
            Self::HalfIntegerShifts(poles) => interpolator::half_integer_shifts(poles)?,
        };
        let Interpolator { generator, weights, condition } = interpolator;
        Ok(Built {
            generator: Arc::new(generator),
            poles: self.poles().clone(),
            weights: Some(weights),
            condition: Some(condition),
        })
    }

    /// As [`Self::build`], with a cache.
    fn build_once(&self) -> Result<Arc<Built>, GeometryError> {
        // Numbers are formatted so that they parse back to the same bits: equal texts are equal recipes.
        let key = format!("{self:?}");
        let kept = || BUILT.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(built) = kept().get(&key) {
            return Ok(built.clone());
        }
        let built = Arc::new(self.build()?);
        kept().insert(key, built.clone());
        Ok(built)
    }
}
