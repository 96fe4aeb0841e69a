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

use std::borrow::Cow;
use std::fmt;

/// Maximum number of different variables of a formula.
pub const MAX_VARIABLES: usize = 64;
/// Maximum number of terms of a formula.
pub const MAX_TERMS: usize = 256;
/// Maximum degree of a power and of a polynomial.
pub const MAX_DEGREE: u32 = 5;
/// Maximum depth of brackets.
const MAX_DEPTH: usize = 32;

/// A formula.
#[derive(Debug, Clone, PartialEq, Eq)]
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
pub struct Variable {
    /// Name of the attribute.
    pub name: String,
    /// The function.
    pub function: Function,
}

/// A function of an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

    fn times(&self, other: &Self) -> Self {
        let more = other.0.iter().filter(|variable| !self.0.contains(variable));
        Self(self.0.iter().chain(more).copied().collect())
    }
}

/// Effects that vary between the groups of a factor: `(1 | g)`, `(x | g)`, `(0 + x | g)`.
#[derive(Debug, Clone, PartialEq, Eq)]
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
        let mut parser = Parser {
            characters: text.chars().collect(),
            at: 0,
            depth: 0,
            variables: Vec::new(),
            random: Vec::new(),
        };
        if parser.next_is('~') {
            parser.at += 1;
        }
        let sum = parser.sum()?;
        parser.skip_spaces();
        if parser.at < parser.characters.len() {
            return Err(parser.refused("an operator or the end"));
        }
        let Parser { variables, random, .. } = parser;
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
        for RandomPart { intercept, terms, group } in &self.random {
            let first = if *intercept { "1" } else { "0" };
            let all: Vec<String> =
                std::iter::once(first.to_owned()).chain(terms.iter().map(|term| self.name(term))).collect();
            parts.push(format!("({} | {})", all.join(" + "), self.name(group)));
        }
        if parts.is_empty() {
            parts.push("1".into());
        }
        write!(f, "~ {}", parts.join(" + "))
    }
}

/// A sum while it is read: terms without doubles, and the intercept if it is named.
#[derive(Debug, Default)]
struct Sum {
    intercept: Option<bool>,
    terms: Vec<Term>,
}

impl Sum {
    fn of(term: Term) -> Self {
        Self { intercept: None, terms: vec![term] }
    }

    fn add(&mut self, other: Self) {
        self.intercept = other.intercept.or(self.intercept);
        for term in other.terms {
            if !self.terms.iter().any(|own| own.set() == term.set()) {
                self.terms.push(term);
            }
        }
    }

    fn remove(&mut self, other: &Self) {
        if other.intercept.is_some() {
            self.intercept = Some(false);
        }
        self.terms.retain(|term| !other.terms.iter().any(|gone| gone.set() == term.set()));
    }

    /// All products of a term of the one and a term of the other, until they are too many.
    fn cross(&self, other: &Self) -> Self {
        let mut found = Self::default();
        for (own, term) in self.terms.iter().flat_map(|own| other.terms.iter().map(move |term| (own, term))) {
            found.add(Self::of(own.times(term)));
            if found.terms.len() > MAX_TERMS {
                break;
            }
        }
        found
    }
}

struct Parser {
    characters: Vec<char>,
    at: usize,
    depth: usize,
    variables: Vec<Variable>,
    random: Vec<RandomPart>,
}

impl Parser {
    fn skip_spaces(&mut self) {
        while self.characters.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
    }

    fn peek(&mut self) -> Option<char> {
        self.skip_spaces();
        self.characters.get(self.at).copied()
    }

    fn next_is(&mut self, wanted: char) -> bool {
        self.peek() == Some(wanted)
    }

    fn takes(&mut self, wanted: char) -> bool {
        let found = self.next_is(wanted);
        self.at += usize::from(found);
        found
    }

    fn refused(&mut self, expected: &str) -> FormulaError {
        let got = self.peek().map_or_else(|| "the end".to_owned(), |c| format!("'{c}'"));
        FormulaError { expected: expected.into(), got, position: self.at + 1 }
    }

    fn expect(&mut self, wanted: char) -> Result<(), FormulaError> {
        if self.takes(wanted) { Ok(()) } else { Err(self.refused(&format!("'{wanted}'"))) }
    }

    fn sum(&mut self) -> Result<Sum, FormulaError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.refused(&format!("at most {MAX_DEPTH} brackets within each other")));
        }
        let mut sum = Sum::default();
        let mut minus = self.takes('-');
        if !minus {
            self.takes('+');
        }
        loop {
            let product = self.product()?;
            // `0` says that there is no intercept, and `- 0` that there is one.
            if minus {
                match product.intercept {
                    Some(false) => sum.intercept = Some(true),
                    _ => sum.remove(&product),
                }
            } else {
                sum.add(product);
            }
            if sum.terms.len() > MAX_TERMS {
                return Err(self.refused(&format!("at most {MAX_TERMS} terms")));
            }
            minus = match self.peek() {
                Some('+') => false,
                Some('-') => true,
                _ => break,
            };
            self.at += 1;
        }
        self.depth -= 1;
        Ok(sum)
    }

    fn product(&mut self) -> Result<Sum, FormulaError> {
        let mut left = self.nested()?;
        loop {
            let is_nesting = match self.peek() {
                Some('*') => false,
                Some('/') => true,
                _ => return Ok(left),
            };
            self.at += 1;
            let right = self.nested()?;
            self.check_factors(&left, &right)?;
            if is_nesting {
                let all = left.terms.iter().fold(Term(Vec::new()), |all, term| all.times(term));
                let within = Sum::of(all).cross(&right);
                left.add(within);
            } else {
                let both = left.cross(&right);
                left.add(right);
                left.add(both);
            }
            left = self.bounded(left)?;
        }
    }

    fn nested(&mut self) -> Result<Sum, FormulaError> {
        let mut left = self.cross()?;
        while self.peek() == Some('%') {
            for wanted in "%in%".chars() {
                if self.characters.get(self.at) != Some(&wanted) {
                    return Err(self.refused("'%in%'"));
                }
                self.at += 1;
            }
            let right = self.cross()?;
            self.check_factors(&left, &right)?;
            left = self.bounded(left.cross(&right))?;
        }
        Ok(left)
    }

    fn cross(&mut self) -> Result<Sum, FormulaError> {
        let mut left = self.power()?;
        while self.takes(':') {
            let right = self.power()?;
            self.check_factors(&left, &right)?;
            left = self.bounded(left.cross(&right))?;
        }
        Ok(left)
    }

    fn power(&mut self) -> Result<Sum, FormulaError> {
        let base = self.atom()?;
        if !self.takes('^') {
            return Ok(base);
        }
        let degree = self.degree(1)?;
        let mut found = Sum { intercept: base.intercept, terms: base.terms.clone() };
        for _ in 1..degree {
            let more = found.cross(&base);
            found.add(more);
            found = self.bounded(found)?;
        }
        Ok(found)
    }

    /// The terms, if they are not too many: products multiply them.
    fn bounded(&mut self, sum: Sum) -> Result<Sum, FormulaError> {
        if sum.terms.len() > MAX_TERMS {
            Err(self.refused(&format!("at most {MAX_TERMS} terms")))
        } else {
            Ok(sum)
        }
    }

    /// Checks that both sides of a product are made of variables.
    fn check_factors(&mut self, left: &Sum, right: &Sum) -> Result<(), FormulaError> {
        if left.terms.is_empty() || right.terms.is_empty() {
            return Err(self.refused("variables on both sides of a product"));
        }
        Ok(())
    }

    fn atom(&mut self) -> Result<Sum, FormulaError> {
        match self.peek() {
            Some('0' | '1') => {
                let intercept = Some(self.characters[self.at] == '1');
                self.at += 1;
                if self.characters.get(self.at).is_some_and(char::is_ascii_digit) {
                    return Err(self.refused("0, 1 or a name"));
                }
                Ok(Sum { intercept, terms: Vec::new() })
            }
            Some('(') => self.bracket(),
            Some(c) if is_start(c) => {
                let variable = self.variable()?;
                Ok(Sum::of(Term(vec![self.position_of(variable)?])))
            }
            _ => Err(self.refused("a variable, 0, 1 or a bracket")),
        }
    }

    fn bracket(&mut self) -> Result<Sum, FormulaError> {
        self.at += 1;
        let sum = self.sum()?;
        if !self.takes('|') {
            self.expect(')')?;
            return Ok(sum);
        }
        let mut groups = vec![self.group_variable()?];
        loop {
            let last = groups[groups.len() - 1].clone();
            if self.takes(':') {
                let next = self.group_variable()?;
                let all = groups.len() - 1;
                groups[all] = last.times(&next);
            } else if self.takes('/') {
                let next = self.group_variable()?;
                groups.push(last.times(&next));
            } else {
                break;
            }
        }
        self.expect(')')?;
        for group in groups {
            let part =
                RandomPart { intercept: sum.intercept.unwrap_or(true), terms: sum.terms.clone(), group };
            if !self.random.contains(&part) {
                self.random.push(part);
            }
        }
        Ok(Sum::default())
    }

    fn group_variable(&mut self) -> Result<Term, FormulaError> {
        self.skip_spaces();
        let name = self.name()?;
        let variable = Variable { name, function: Function::Identity };
        Ok(Term(vec![self.position_of(variable)?]))
    }

    fn variable(&mut self) -> Result<Variable, FormulaError> {
        let start = self.at;
        let quoted = self.characters[start] == '`';
        let name = self.name()?;
        if quoted || !self.next_is('(') {
            return Ok(Variable { name, function: Function::Identity });
        }
        let function = match name.as_str() {
            "log" => Function::Log,
            "sqrt" => Function::Sqrt,
            "factor" => Function::Factor,
            "I" => Function::Power(0),
            "poly" => Function::Poly(0),
            _ => {
                self.at = start;
                return Err(self.refused("log, sqrt, factor, I or poly before a bracket"));
            }
        };
        self.at += 1;
        self.skip_spaces();
        let name = self.name()?;
        let function = match function {
            Function::Power(_) => {
                self.expect('^')?;
                Function::Power(self.degree(1)?)
            }
            Function::Poly(_) => {
                self.expect(',')?;
                Function::Poly(self.degree(1)?)
            }
            other => other,
        };
        self.expect(')')?;
        Ok(Variable { name, function })
    }

    fn name(&mut self) -> Result<String, FormulaError> {
        let rest = &self.characters[self.at.min(self.characters.len())..];
        if rest.first() == Some(&'`') {
            let name: String = rest[1..].iter().take_while(|c| **c != '`').collect();
            let length = name.chars().count();
            if name.is_empty() || rest.get(1 + length) != Some(&'`') {
                return Err(self.refused("a name between backquotes"));
            }
            self.at += length + 2;
            return Ok(name);
        }
        if !rest.first().is_some_and(|c| is_start(*c)) {
            return Err(self.refused("a name"));
        }
        let name: String = rest.iter().take_while(|c| is_plain(**c)).collect();
        self.at += name.chars().count();
        Ok(name)
    }

    fn degree(&mut self, least: u32) -> Result<u32, FormulaError> {
        self.skip_spaces();
        let digits: String = self.characters[self.at..].iter().take_while(|c| c.is_ascii_digit()).collect();
        match digits.parse::<u32>() {
            Ok(degree) if (least..=MAX_DEGREE).contains(&degree) => {
                self.at += digits.len();
                Ok(degree)
            }
            _ => Err(self.refused(&format!("a whole number from {least} to {MAX_DEGREE}"))),
        }
    }

    fn position_of(&mut self, variable: Variable) -> Result<usize, FormulaError> {
        if let Some(position) = self.variables.iter().position(|own| *own == variable) {
            return Ok(position);
        }
        if self.variables.len() == MAX_VARIABLES {
            return Err(self.refused(&format!("at most {MAX_VARIABLES} variables")));
        }
        self.variables.push(variable);
        Ok(self.variables.len() - 1)
    }
}

fn is_plain(c: char) -> bool {
    c.is_alphanumeric() || matches!(c, '_' | '.')
}

fn is_start(c: char) -> bool {
    c.is_alphabetic() || matches!(c, '_' | '`')
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
