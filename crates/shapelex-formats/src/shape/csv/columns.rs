//! Meanings of the columns of a table.

use std::collections::BTreeMap;

use super::super::limits::Limits;
use super::super::options::{Columns, ReadOptions, matches_pattern};
use super::super::text::{name_fits, shown};
use super::AXES;
use crate::error::{FaultKind, FileError, Place};

/// Columns by position.
pub(super) struct Roles {
    pub(super) names: Vec<String>,
    pub(super) id: Option<usize>,
    pub(super) label: Option<usize>,
    pub(super) subject: Option<usize>,
    pub(super) weight: Option<usize>,
    pub(super) closed: Option<usize>,
    /// In tables of one point a row.
    pub(super) point: Option<usize>,
    pub(super) coordinates: Coordinates,
    pub(super) attributes: Vec<usize>,
    /// Columns that are not read.
    pub(super) others: Vec<usize>,
}

/// Columns of coordinates.
pub(super) enum Coordinates {
    /// Of all points of a shape, row-major.
    Wide { dimension: usize, columns: Vec<usize> },
    /// Of one point.
    Long(Vec<usize>),
}

/// Names of columns that are recognised, the first one of which is taken. An empty name is that of the names of rows of R.
const ID: [&str; 7] = ["id", "name", "specimen", "specimen_id", "external_id", "shape", ""];
const LABEL: [&str; 2] = ["label", "class"];
const SUBJECT: [&str; 1] = ["subject"];
/// Not `weight`, which is mostly that of an animal.
const WEIGHT: [&str; 1] = ["mean_weight"];
const CLOSED: [&str; 1] = ["closed"];
const POINT: [&str; 5] = ["point", "landmark", "index", "coord_id", "vertex"];
/// Prefixes of the number of a landmark or the letter of its axis.
const PREFIXES: [&str; 5] = ["landmark", "point", "coord", "lm", "pt"];
/// Names of numbered coordinates of MorphoJ.
const NUMBERED: [&str; 2] = ["proccoord", "rawcoord"];

impl Roles {
    /// The columns of a header, as the caller says, else by their names.
    pub(super) fn new(names: Vec<String>, options: &ReadOptions, limits: &Limits) -> Result<Self, FileError> {
        for name in &names {
            name_fits(name).map_err(|detail| FileError::malformed(Place::line(1), detail))?;
        }
        let none = Columns::default();
        let given = options.columns.as_ref().unwrap_or(&none);
        let find = |role: &str, wanted: &Option<String>, known: &[&str]| match wanted {
            Some(wanted) => position(&names, wanted).map(Some).ok_or_else(|| {
                let detail = format!("expected a column {} as {role}, got {}", shown(wanted), list(&names));
                FileError::new(FaultKind::Option, detail)
            }),
            None => Ok(known.iter().find_map(|name| position(&names, name))),
        };
        let coordinates = match &given.coordinates {
            Some(wanted) => chosen(&names, wanted, options.dimension)?,
            None => recognised(&names, options.dimension)?,
        };
        let is_long = matches!(coordinates, Coordinates::Long(_));
        let mut roles = Self {
            id: find("id", &given.id, &ID)?,
            label: find("label", &given.label, &LABEL)?,
            subject: find("subject", &given.subject, &SUBJECT)?,
            weight: find("weight", &given.weight, &WEIGHT)?,
            closed: position(&names, CLOSED[0]),
            point: if is_long { find("point", &given.point, &POINT)? } else { None },
            coordinates,
            attributes: Vec::new(),
            others: Vec::new(),
            names,
        };
        roles.check(limits)?;
        roles.rest(given)?;
        Ok(roles)
    }

    fn check(&self, limits: &Limits) -> Result<(), FileError> {
        let Coordinates::Wide { dimension, columns } = &self.coordinates else { return Ok(()) };
        if *dimension == 0 || !columns.len().is_multiple_of(*dimension) || columns.is_empty() {
            let detail =
                format!("expected a multiple of {dimension} columns of coordinates, got {}", columns.len());
            return Err(FileError::new(FaultKind::Option, detail));
        }
        limits.points((columns.len() / dimension) as u64, || Place::line(1)).map(|_| ())
    }

    /// Takes the columns without a role as attributes, or those that the caller names.
    fn rest(&mut self, given: &Columns) -> Result<(), FileError> {
        let mut taken = vec![false; self.names.len()];
        let roles = [self.id, self.label, self.subject, self.weight, self.closed, self.point];
        let (Coordinates::Wide { columns, .. } | Coordinates::Long(columns)) = &self.coordinates;
        for column in roles.into_iter().flatten().chain(columns.iter().copied()) {
            taken[column] = true;
        }
        let free = || (0..self.names.len()).filter(|column| !taken[*column]);
        let Some(wanted) = &given.attributes else {
            self.attributes = free().collect();
            return Ok(());
        };
        let mut chosen = Vec::new();
        for name in wanted {
            chosen.push(position(&self.names, name).ok_or_else(|| {
                let detail =
                    format!("expected a column {} as attribute, got {}", shown(name), list(&self.names));
                FileError::new(FaultKind::Option, detail)
            })?);
        }
        self.others = free().filter(|column| !chosen.contains(column)).collect();
        self.attributes = chosen;
        Ok(())
    }
}

fn position(names: &[String], wanted: &str) -> Option<usize> {
    names.iter().position(|name| name.to_lowercase() == wanted.trim().to_lowercase())
}

/// The first names of columns.
fn list(names: &[String]) -> String {
    let first: Vec<_> = names.iter().take(8).map(|name| shown(name)).collect();
    let more = if names.len() > first.len() {
        format!(" and {} more", names.len() - first.len())
    } else {
        String::new()
    };
    format!("{}{more}", first.join(", "))
}

/// Coordinates that the caller names.
fn chosen(names: &[String], wanted: &[String], dimension: Option<usize>) -> Result<Coordinates, FileError> {
    let fault = |detail: String| FileError::new(FaultKind::Option, detail);
    let needs_dimension = |dimension: Option<usize>| {
        dimension.ok_or_else(|| {
            fault("expected the option dimension beside a pattern of columns, got none".into())
        })
    };
    if let [pattern] = wanted
        && pattern.contains('*')
    {
        let pattern = pattern.trim().to_lowercase();
        let matches = |name: &String| matches_pattern(pattern.as_bytes(), name.to_lowercase().as_bytes());
        let columns = (0..names.len()).filter(|column| matches(&names[*column])).collect();
        return Ok(Coordinates::Wide { dimension: needs_dimension(dimension)?, columns });
    }
    let mut columns = Vec::new();
    for name in wanted {
        columns.push(position(names, name).ok_or_else(|| {
            fault(format!("expected a column {} as coordinate, got {}", shown(name), list(names)))
        })?);
    }
    match columns.len() {
        0 | 1 => Err(fault(format!("expected 2 or more columns of coordinates, got {}", columns.len()))),
        2 | 3 => Ok(Coordinates::Long(columns)),
        _ => Ok(Coordinates::Wide { dimension: needs_dimension(dimension)?, columns }),
    }
}

/// Coordinates by the names of columns.
pub(super) fn recognised(names: &[String], dimension: Option<usize>) -> Result<Coordinates, FileError> {
    let long: Vec<_> = AXES.iter().map_while(|axis| position(names, axis)).collect();
    if long.len() >= 2 {
        return Ok(Coordinates::Long(long));
    }
    let fault = |detail: String| Err(FileError::malformed(Place::line(1), detail));
    let mut found = BTreeMap::new();
    for (column, name) in names.iter().enumerate() {
        let Some((number, axis)) = numbered(name) else { continue };
        if found.insert((number, axis), column).is_some() {
            return fault(format!("expected one column {}{number}, got two", AXES[axis]));
        }
    }
    if let Some((first, _)) = found.keys().next().copied() {
        let dimension = if found.keys().any(|(_, axis)| *axis == 2) { 3 } else { 2 };
        let mut columns = Vec::new();
        let last = found.keys().next_back().map_or(first, |(number, _)| *number);
        for number in first..=last {
            for axis in 0..dimension {
                match found.get(&(number, axis)) {
                    Some(column) => columns.push(*column),
                    None => return fault(format!("expected a column {}{number}, got none", AXES[axis])),
                }
            }
        }
        return Ok(Coordinates::Wide { dimension, columns });
    }
    let is_numbered = |name: &String| {
        let name = name.to_lowercase();
        NUMBERED.iter().any(|prefix| {
            name.strip_prefix(prefix)
                .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
        })
    };
    let columns: Vec<_> = (0..names.len()).filter(|column| is_numbered(&names[*column])).collect();
    match (columns.is_empty(), dimension) {
        (false, Some(dimension)) => Ok(Coordinates::Wide { dimension, columns }),
        (false, None) => fault("expected the option dimension beside numbered coordinates, got none".into()),
        (true, _) => {
            fault(format!("expected columns of coordinates such as x1, y1 or x, y, got {}", list(names)))
        }
    }
}

/// Number and axis of a column such as `x1`, `1.X` or `LM1_x`.
pub(super) fn numbered(name: &str) -> Option<(u32, usize)> {
    let name: String =
        name.to_lowercase().chars().filter(|c| !matches!(c, ' ' | '_' | '.' | '-' | ':')).collect();
    let name = PREFIXES.iter().find_map(|prefix| name.strip_prefix(prefix)).unwrap_or(&name);
    let of_axis = |axis: &str| name.strip_prefix(axis).or_else(|| name.strip_suffix(axis));
    let (axis, digits) = AXES.iter().enumerate().find_map(|(k, axis)| Some((k, of_axis(axis)?)))?;
    let is_number =
        !digits.is_empty() && digits.len() <= 9 && digits.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| digits.parse().ok().map(|number| (number, axis))).flatten()
}
