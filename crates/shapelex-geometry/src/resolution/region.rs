//! Regions of the domain of a shape, and the control points of a finer grid that move it there only.

use super::Finer;
use crate::field_fault::FieldFault;
use crate::influence::weights;
use crate::knot_line::Line;
use crate::representation::ShapeSpace;

/// Part of the domain of a curve or a surface: an interval of parameters `[from, to]` per direction, `to > 1` where it goes over the
/// end of a closed direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ParameterRegion {
    /// Interval of `u`. Default: all of it.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(nullable = false))]
    pub u: Option<[f64; 2]>,
    /// Interval of `v`, on surfaces. Default: all of it.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(nullable = false))]
    pub v: Option<[f64; 2]>,
}

/// Distance in units of half a fine interval below which an end of a region counts as one of a half-interval: ends are written with a few
/// digits, `0.333333333`.
const SAME_END: f64 = 1e-6;

impl ParameterRegion {
    /// Faults of the intervals for shapes whose directions are `closed` or not, at the field of the direction.
    pub fn faults(&self, closed: &[bool]) -> Vec<FieldFault> {
        let mut faults = Vec::new();
        if self.u.is_none() && self.v.is_none() {
            faults.push(FieldFault::new("", "expected an interval of u or v, got neither"));
        }
        for (i, (field, interval)) in [("u", self.u), ("v", self.v)].into_iter().enumerate() {
            let (Some(interval), closed) = (interval, closed.get(i).copied()) else { continue };
            faults.extend(interval_fault(interval, closed).map(|detail| FieldFault::new(field, detail)));
        }
        faults
    }

    /// Indices of the control points of a finer grid that move the shape within the region only, in ascending order: the supports of their
    /// basis functions lie in it. Cost: the weights at every pair of fine half-intervals.
    ///
    /// # Errors
    /// A region that holds no such support, with the length that it needs.
    pub fn control_points(&self, finer: &Finer) -> Result<Vec<usize>, FieldFault> {
        let space = finer.space();
        let inside: Vec<Vec<bool>> =
            self.lines(space, finer).map(|(line, given, shift)| halves_inside(line, given, shift)).collect();
        let place = |i: usize, count: usize| (i as f64 + 0.37) / count as f64;
        let mut found = vec![Touched::default(); finer.size()];
        let mut mark = |parameters: &[f64], inside: bool| {
            for (row, weight) in weights(space, parameters) {
                found[row].inside |= inside && weight != 0.0;
                found[row].outside |= !inside && weight != 0.0;
            }
        };
        match &inside[..] {
            [u] => u.iter().enumerate().for_each(|(i, inside)| mark(&[place(i, u.len())], *inside)),
            [u, v] => {
                for (i, along_u) in u.iter().enumerate() {
                    for (j, along_v) in v.iter().enumerate() {
                        mark(&[place(i, u.len()), place(j, v.len())], *along_u && *along_v);
                    }
                }
            }
            _ => {}
        }
        let within = |(row, touched): (usize, &Touched)| (touched.inside && !touched.outside).then_some(row);
        let indices: Vec<usize> = found.iter().enumerate().filter_map(within).collect();
        if indices.is_empty() { Err(self.too_small(finer)) } else { Ok(indices) }
    }

    /// The lines of a space, with the interval along them and the shift of the finer grid.
    fn lines<'a>(
        &self,
        space: &'a ShapeSpace,
        finer: &Finer,
    ) -> impl Iterator<Item = (&'a Line, Option<[f64; 2]>, f64)> {
        let lines: Vec<&Line> = match (space.line(), space.surface()) {
            (Some(line), _) => vec![line],
            (_, Some(basis)) => basis.lines().iter().collect(),
            _ => Vec::new(),
        };
        lines
            .into_iter()
            .zip([self.u, self.v])
            .zip(finer.shifts())
            .map(|((line, given), shift)| (line, given, shift))
    }

    /// Fault of a region that holds no control point of the finer grid.
    fn too_small(&self, finer: &Finer) -> FieldFault {
        let space = finer.space();
        let needed = |line: &Line| {
            let support = line.generator().support() - usize::from(line.is_shifted());
            support as f64 / line.intervals() as f64
        };
        for (field, (line, given, _)) in ["u", "v"].into_iter().zip(self.lines(space, finer)) {
            let (needed, length) = (needed(line), given.map_or(1.0, |[from, to]| to - from));
            if length < needed {
                let detail = format!(
                    "expected an interval of at least {needed}, the support of a control point of the finer grid, got {length}"
                );
                return FieldFault::new(field, detail);
            }
        }
        let supports: Vec<String> =
            self.lines(space, finer).map(|(line, ..)| needed(line).to_string()).collect();
        let detail = format!(
            "expected a region that holds the support of a control point of the finer grid, from knot to knot over {}, got one between \
             two of them",
            supports.join(" by ")
        );
        FieldFault::new("", detail)
    }
}

/// Where the basis function of a control point does not vanish.
#[derive(Debug, Clone, Copy, Default)]
struct Touched {
    inside: bool,
    outside: bool,
}

/// Fault of an interval of a closed or open direction, or of a direction that the shapes do not have.
fn interval_fault([from, to]: [f64; 2], closed: Option<bool>) -> Option<String> {
    let expected = match closed {
        Some(true) if (0.0..1.0).contains(&from) && from < to && to <= from + 1.0 => return None,
        Some(false) if 0.0 <= from && from < to && to <= 1.0 => return None,
        Some(true) => "from at least 0 and below 1, and to after it by at most 1, along a closed direction",
        Some(false) => "from and to after it, between 0 and 1, along an open direction",
        None => "none along this direction, which the shapes do not have",
    };
    Some(format!("expected {expected}, got [{from}, {to}]"))
}

/// Whether each half of an interval of a finer line, whose parameters are ahead by `shift`, lies in an interval of the coarse one.
fn halves_inside(line: &Line, interval: Option<[f64; 2]>, shift: f64) -> Vec<bool> {
    let halves = 2 * line.intervals();
    let [from, to] = interval.unwrap_or([0.0, 1.0]).map(|end| halves as f64 * end);
    let whole = interval.is_none_or(|[from, to]| to - from >= 1.0);
    let lies_in = |i: usize| {
        let start = i as f64 - halves as f64 * shift;
        let turns = if line.is_closed() { ((from - SAME_END - start) / halves as f64).ceil() } else { 0.0 };
        let start = start + turns * halves as f64;
        whole || (start >= from - SAME_END && start + 1.0 <= to + SAME_END)
    };
    (0..halves).map(lies_in).collect()
}
