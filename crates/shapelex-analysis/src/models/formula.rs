//! Formulas of models in the notation of Wilkinson and Rogers, as R reads them.
//!
//! ```text
//! formula = [ "~" ] sum                      sum  = [ "+" | "-" ] product { ( "+" | "-" ) product }
//! product = nested { ( "*" | "/" ) nested }  nested = cross { "%in%" cross }     cross = power { ":" power }
//! power   = atom [ "^" digits ]              atom = "0" | "1" | name | call | "(" sum ")" | "(" sum "|" group ")"
//! call    = ("log" | "sqrt" | "factor") "(" name ")" | "I(" name "^" digits ")" | "poly(" name "," digits ")"
//! group   = name { ( ":" | "/" ) name }
//! ```
//!
//! A term is a set of variables, named by its first spelling. `a*b` is `a + b + a:b`, `a/b` is `a + a:b`, `a %in% b` is `a:b`,
//! `(a+b+c)^2` has all products of at most two of them, `- t` removes a term, `0 +` and `- 1` remove the intercept. A name with other
//! characters than letters, digits, `_` and `.` stands between backquotes.
//!
//! Source: Wilkinson and Rogers 1973.

mod parser;

use std::borrow::Cow;
use std::fmt;

use self::parser::{is_plain, is_start, parsed};

/// Maximum number of different variables of a formula.
pub const MAX_VARIABLES: usize = 64;
/// Maximum number of terms of a formula.
pub const MAX_TERMS: usize = 256;
/// Maximum degree of a power and of a polynomial.
pub const MAX_DEGREE: u32 = 5;
/// A formula.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Formula {
    /// Whether the model has an intercept.
    pub intercept: bool,
    /// Variables, in the order of their first appearance.
    pub variables: Vec<Variable>,
    /// Fixed terms.
    pub terms: Vec<Term>,
    /// Random parts.
    pub random: Vec<RandomPart>,
}

/// A variable: an attribute, or a function of one.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Variable {
    /// Name of the attribute.
    pub name: String,
    /// The function.
    pub function: Function,
}

/// A function of an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Function {
    /// The attribute.
    Identity,
    /// Its natural logarithm.
    Log,
    /// Its square root.
    Sqrt,
    /// The attribute as a factor.
    Factor,
    /// A power of it.
    Power(u32),
    /// Orthogonal polynomials in it, up to this degree.
    Poly(u32),
}

impl fmt::Display for Variable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_plain = self.name.chars().next().is_some_and(|c| is_start(c) && c != '`')
            && self.name.chars().all(is_plain);
        let name: Cow<'_, str> =
            if is_plain { (&self.name).into() } else { format!("`{}`", self.name).into() };
        match self.function {
            Function::Identity => f.write_str(&name),
            Function::Log => write!(f, "log({name})"),
            Function::Sqrt => write!(f, "sqrt({name})"),
            Function::Factor => write!(f, "factor({name})"),
            Function::Power(degree) => write!(f, "I({name}^{degree})"),
            Function::Poly(degree) => write!(f, "poly({name},{degree})"),
        }
    }
}

/// A product of variables, by their positions, in the order of its first spelling.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Term(pub Vec<usize>);

impl Term {
    /// The variables as a set of bits.
    pub fn set(&self) -> u64 {
        self.0.iter().fold(0, |set, variable| set | 1 << variable)
    }

    /// Number of variables.
    pub fn degree(&self) -> usize {
        self.0.len()
    }

    /// Whether all variables of `other` are among those of this term, and others besides.
    pub fn contains(&self, other: &Self) -> bool {
        self.set() != other.set() && self.set() & other.set() == other.set()
    }

    pub(super) fn times(&self, other: &Self) -> Self {
        let more = other.0.iter().filter(|variable| !self.0.contains(variable));
        Self(self.0.iter().chain(more).copied().collect())
    }
}

/// Effects that vary between the groups of a factor: `(1 | g)`, `(x | g)`, `(0 + x | g)`.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RandomPart {
    /// Whether the intercept varies.
    pub intercept: bool,
    /// Terms whose effects vary.
    pub terms: Vec<Term>,
    /// Variables whose combinations are the groups.
    pub group: Term,
}

/// Order of the terms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum TermOrder {
    /// Terms of fewer variables first, otherwise as written.
    #[default]
    ByDegree,
    /// As written.
    AsWritten,
}

/// Why a text is not a formula.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, got {got} at character {position} of the formula")]
pub struct FormulaError {
    expected: String,
    got: String,
    /// Position of the character, counted from 1.
    pub position: usize,
}

impl Formula {
    /// Reads a formula.
    ///
    /// # Errors
    /// The place where the text leaves the grammar; more variables, terms or degrees than the limits; no term.
    pub fn parse(text: &str, order: TermOrder) -> Result<Self, FormulaError> {
        let (sum, variables, random) = parsed(text)?;
        let mut terms = sum.terms;
        if order == TermOrder::ByDegree {
            terms.sort_by_key(Term::degree);
        }
        Ok(Self { intercept: sum.intercept.unwrap_or(true), variables, terms, random })
    }

    /// Name of a term.
    pub fn name(&self, term: &Term) -> String {
        let names: Vec<String> =
            term.0.iter().map(|&variable| self.variables[variable].to_string()).collect();
        names.join(":")
    }

    /// Name of a random part.
    pub fn part_name(&self, RandomPart { intercept, terms, group }: &RandomPart) -> String {
        let first = if *intercept { "1" } else { "0" };
        let all: Vec<String> =
            std::iter::once(first.to_owned()).chain(terms.iter().map(|term| self.name(term))).collect();
        format!("({} | {})", all.join(" + "), self.name(group))
    }

    /// Whether the model holds the product of these variables; the empty one is the intercept.
    pub fn holds(&self, set: u64) -> bool {
        if set == 0 { self.intercept } else { self.terms.iter().any(|term| term.set() == set) }
    }
}

impl fmt::Display for Formula {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts: Vec<String> = Vec::new();
        if !self.intercept {
            parts.push("0".into());
        }
        parts.extend(self.terms.iter().map(|term| self.name(term)));
        parts.extend(self.random.iter().map(|part| self.part_name(part)));
        if parts.is_empty() {
            parts.push("1".into());
        }
        write!(f, "~ {}", parts.join(" + "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Formula {
        Formula::parse(text, TermOrder::ByDegree).unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    #[test]
    fn operators_make_the_terms_that_they_stand_for() {
        for (text, wanted) in [
            ("a*b", "~ a + b + a:b"),
            ("~ a/b", "~ a + a:b"),
            ("~ (a + b)/c", "~ a + b + a:b:c"),
            ("~ b:a + a:b", "~ b:a"),
            ("~ (a+b+c)^2 - b:c", "~ a + b + c + a:b + a:c"),
            ("~ a*b*c", "~ a + b + c + a:b + a:c + b:c + a:b:c"),
            ("~ 0 + a", "~ 0 + a"),
            ("~ a - 1", "~ 0 + a"),
            ("~ a - 1 + 1", "~ a"),
            ("~ x %in% a", "~ x:a"),
            ("~ `cell line` + log(age)", "~ `cell line` + log(age)"),
            ("~ a:b + a", "~ a + a:b"),
            ("~ a^3", "~ a"),
            ("~ x + (x|a/b)", "~ x + (1 + x | a) + (1 + x | a:b)"),
            ("~ (0 + x | a)", "~ (0 + x | a)"),
            ("~ 1", "~ 1"),
        ] {
            assert_eq!(read(text).to_string(), wanted, "{text}");
        }
        let written = Formula::parse("~ a:b + a", TermOrder::AsWritten).unwrap();
        assert_eq!(written.to_string(), "~ a:b + a");
    }

    #[test]
    fn what_leaves_the_grammar_is_refused_where_it_does() {
        for (text, position, expected) in [
            ("~ a +", 6, "a variable"),
            ("~ (1|a", 7, "')'"),
            ("~ a ** b", 6, "a variable"),
            ("~ sin(x)", 3, "log, sqrt"),
            ("~ a b", 5, "an operator"),
            ("", 1, "a variable"),
            ("~ a^9", 5, "from 1 to 5"),
            ("~ poly(x,0)", 10, "from 1 to 5"),
            ("~ 1:a", 6, "variables on both sides"),
            ("~ 12", 4, "0, 1 or a name"),
            ("~ `a", 3, "between backquotes"),
        ] {
            let error = Formula::parse(text, TermOrder::ByDegree).unwrap_err();
            assert_eq!(error.position, position, "{text}: {error}");
            assert!(error.to_string().contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn formulas_are_bounded() {
        let many: Vec<String> = (0..65).map(|k| format!("v{k}")).collect();
        let refused = |text: &str| Formula::parse(text, TermOrder::ByDegree).unwrap_err().to_string();
        assert!(refused(&many.join("+")).contains("at most 64 variables"));
        assert!(refused(&format!("({})^4", many[..40].join("+"))).contains("at most 256 terms"));
        assert!(refused(&"(".repeat(100)).contains("brackets within each other"));
        assert!(refused(&many[..12].join("*")).contains("at most 256 terms"));
    }
}
