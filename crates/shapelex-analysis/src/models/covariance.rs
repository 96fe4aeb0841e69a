//! Known covariances of shapes: given, or of a tree along which shapes change as Brownian motion.
//!
//! ```text
//! C = LLᵀ,   X ← L⁻¹X,   Y ← L⁻¹Y,   Q_0 from L⁻¹1
//! ```
//!
//! The covariance of two tips of a tree is the length of the branches from the root that they share. Sources: Felsenstein 1985; Martins and
//! Hansen 1997; Adams 2014.

use std::collections::BTreeMap;
use std::ops::Range;

use super::error::ModelError;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kernels::dot;

/// Largest number of shapes with a covariance: its factor takes `n³/6` multiply-adds, that of a tree up to `n³/3` besides.
pub const MAX_SHAPES: usize = 1000;
/// Largest number of branches of a tree: one with two branches at each node has fewer than twice its tips.
const MAX_BRANCHES: usize = 2 * MAX_SHAPES;
/// Smallest pivot of a positive definite covariance, over its diagonal entry.
const SMALLEST: f64 = 1e-10;
/// Difference of two entries that should be equal, over the largest.
const SYMMETRIC: f64 = 1e-9;

/// A covariance of named shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance {
    places: BTreeMap<String, usize>,
    /// Rows of the matrix.
    rows: Vec<Vec<f64>>,
}

fn refused(detail: String) -> ModelError {
    ModelError::Covariance { detail }
}

impl Covariance {
    /// The covariance with these rows.
    ///
    /// # Errors
    /// [`ModelError::Covariance`] for names that occur twice, other numbers of rows or columns, numbers that are not finite, and rows
    /// that are not symmetric.
    pub fn of_rows(names: &[String], rows: Vec<Vec<f64>>) -> Result<Self, ModelError> {
        let count = names.len();
        if count > MAX_SHAPES {
            return Err(refused(format!("expected at most {MAX_SHAPES} names in a covariance, got {count}")));
        }
        if rows.len() != count || rows.iter().any(|row| row.len() != count) {
            let found = rows.iter().map(Vec::len).find(|found| *found != count).unwrap_or(rows.len());
            return Err(refused(format!(
                "expected {count} rows of {count} numbers, one for each name, got {found}"
            )));
        }
        let largest = rows.iter().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
        for (i, row) in rows.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                if !(value.abs() <= super::MAX_VALUE && (value - rows[j][i]).abs() <= SYMMETRIC * largest) {
                    return Err(refused(format!(
                        "expected a symmetric covariance of finite numbers, got {value} and {} for '{}' and '{}'",
                        rows[j][i], names[i], names[j]
                    )));
                }
            }
        }
        let mut places = BTreeMap::new();
        for (k, name) in names.iter().enumerate() {
            if places.insert(name.clone(), k).is_some() {
                return Err(refused(format!("expected different names in a covariance, got '{name}' twice")));
            }
        }
        Ok(Self { places, rows })
    }

    /// The covariance of the tips of a tree in Newick's notation, with the lengths of all branches: `((a:1,b:1):0.5,c:1.5);`. A branch of
    /// the root has no part in it.
    ///
    /// # Errors
    /// [`ModelError::Covariance`] with the place where the text leaves the notation.
    pub fn of_tree(text: &str) -> Result<Self, ModelError> {
        let mut reader = Reader::default();
        for (place, c) in text.chars().enumerate() {
            reader
                .read(c)
                .map_err(|detail| refused(format!("{detail} at character {} of the tree", place + 1)))?;
        }
        if !reader.ended || reader.tips.len() < 2 {
            return Err(refused(
                "expected a tree of at least two tips that ends with ';', got another text".into(),
            ));
        }
        let count = reader.tips.len();
        let mut rows = vec![vec![0.0; count]; count];
        for (range, length) in &reader.branches {
            for row in &mut rows[range.clone()] {
                row[range.clone()].iter_mut().for_each(|value| *value += length);
            }
        }
        Self::of_rows(&reader.tips, rows)
    }

    /// The factor `L` for shapes of these names, in their order.
    ///
    /// # Errors
    /// [`ModelError::Covariance`] for names without a row, several shapes of a name, and a covariance that is not positive definite, with
    /// its smallest pivot.
    pub fn factor(&self, shapes: &[&str]) -> Result<Matrix, ModelError> {
        let mut chosen = Vec::with_capacity(shapes.len());
        let mut seen = vec![false; self.rows.len()];
        for name in shapes {
            let Some(&place) = self.places.get(*name) else {
                let without: Vec<&str> = shapes
                    .iter()
                    .filter(|name| !self.places.contains_key(**name))
                    .take(10)
                    .copied()
                    .collect();
                return Err(refused(format!(
                    "expected all shapes in the covariance, got none for '{}'",
                    without.join("', '")
                )));
            };
            if std::mem::replace(&mut seen[place], true) {
                return Err(refused(format!(
                    "expected one shape for each name of the covariance, got several of '{name}'"
                )));
            }
            chosen.push(place);
        }
        self.lower(&chosen, shapes)
    }

    fn lower(&self, chosen: &[usize], shapes: &[&str]) -> Result<Matrix, ModelError> {
        // Rows of L, so that products run along memory.
        let mut lower: Vec<Vec<f64>> = Vec::with_capacity(chosen.len());
        for (i, &row) in chosen.iter().enumerate() {
            let mut own: Vec<f64> = Vec::with_capacity(i + 1);
            for (j, before) in lower.iter().enumerate() {
                let value = (self.rows[row][chosen[j]] - dot(&own, &before[..j])) / before[j];
                own.push(value);
            }
            let diagonal = self.rows[row][row];
            let pivot = diagonal - dot(&own, &own);
            if !(pivot > SMALLEST * diagonal) {
                return Err(refused(format!(
                    "expected a positive definite covariance, got a pivot of {pivot:.1e} for a variance of {diagonal:.1e} of '{}'",
                    shapes[i]
                )));
            }
            own.push(pivot.sqrt());
            lower.push(own);
        }
        Ok(Matrix::from_fn(chosen.len(), chosen.len(), |i, j| if j <= i { lower[i][j] } else { 0.0 }))
    }
}

/// A tree while it is read.
#[derive(Default)]
struct Reader {
    tips: Vec<String>,
    /// Tips of a branch, and its length.
    branches: Vec<(Range<usize>, f64)>,
    /// Number of tips at each bracket that is open.
    open: Vec<usize>,
    /// Number of tips at the bracket that was just closed.
    closed: Option<usize>,
    name: String,
    length: Option<String>,
    quoted: Quote,
    ended: bool,
}

/// Where in quotes a character stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Quote {
    #[default]
    Outside,
    Inside,
    /// Behind a quote inside: it ends the name, or a second one follows.
    After,
    Comment,
}

impl Reader {
    fn read(&mut self, c: char) -> Result<(), String> {
        match (self.quoted, c) {
            (Quote::Inside, '\'') => self.quoted = Quote::After,
            (Quote::Inside, _) => self.name.push(c),
            (Quote::Comment, ']') => self.quoted = Quote::Outside,
            (Quote::Comment, _) => {}
            (Quote::After, '\'') => {
                self.name.push('\'');
                self.quoted = Quote::Inside;
            }
            _ => {
                self.quoted = Quote::Outside;
                return self.plain(c);
            }
        }
        Ok(())
    }

    fn plain(&mut self, c: char) -> Result<(), String> {
        match c {
            _ if c.is_whitespace() => {}
            _ if self.ended => return Err(format!("expected the end, got '{c}'")),
            '[' => self.quoted = Quote::Comment,
            '\'' if self.name.is_empty() => self.quoted = Quote::Inside,
            '(' if self.name.is_empty() && self.closed.is_none() && self.length.is_none() => {
                if self.open.len() == MAX_BRANCHES {
                    return Err(format!(
                        "expected at most {MAX_BRANCHES} brackets within each other, got more"
                    ));
                }
                self.open.push(self.tips.len());
            }
            ',' if !self.open.is_empty() => self.finish()?,
            ')' => {
                let first = self.open.pop().ok_or("expected as many brackets as before, got ')'")?;
                self.finish()?;
                self.closed = Some(first);
            }
            ';' if self.open.is_empty() && self.closed.is_some() => self.ended = true,
            ':' if self.length.is_none() => self.length = Some(String::new()),
            '(' | ',' | ';' | ':' | '\'' => return Err(format!("expected a name or a length, got '{c}'")),
            _ => self.length.as_mut().unwrap_or(&mut self.name).push(c),
        }
        Ok(())
    }

    /// Ends a branch: the one of a tip, or that of a bracket.
    fn finish(&mut self) -> Result<(), String> {
        let (name, length) = (std::mem::take(&mut self.name), self.length.take().unwrap_or_default());
        let first = match self.closed.take() {
            Some(first) => first,
            None if name.is_empty() => return Err("expected the name of a tip, got none".into()),
            None if self.tips.len() == MAX_SHAPES => {
                return Err(format!("expected at most {MAX_SHAPES} tips, got more"));
            }
            None => {
                self.tips.push(name);
                self.tips.len() - 1
            }
        };
        if self.branches.len() == MAX_BRANCHES {
            return Err(format!("expected at most {MAX_BRANCHES} branches, got more"));
        }
        match length.parse::<f64>() {
            Ok(number) if (0.0..=super::MAX_VALUE).contains(&number) => {
                self.branches.push((first..self.tips.len(), number));
                Ok(())
            }
            _ => Err(format!("expected the length of a branch before this place, got '{length}'")),
        }
    }
}
