//! Reading of formulas, by recursive descent.

use super::{FormulaError, Function, MAX_DEGREE, MAX_TERMS, MAX_VARIABLES, RandomPart, Term, Variable};

/// Maximum depth of brackets.
const MAX_DEPTH: usize = 32;

/// A sum while it is read: terms without doubles, and the intercept if it is named.
#[derive(Debug, Default)]
pub(super) struct Sum {
    pub(super) intercept: Option<bool>,
    pub(super) terms: Vec<Term>,
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

/// The terms of a text, its variables and its random parts.
pub(super) fn parsed(text: &str) -> Result<(Sum, Vec<Variable>, Vec<RandomPart>), FormulaError> {
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
    Ok((sum, variables, random))
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

pub(super) fn is_plain(c: char) -> bool {
    c.is_alphanumeric() || matches!(c, '_' | '.')
}

pub(super) fn is_start(c: char) -> bool {
    c.is_alphabetic() || matches!(c, '_' | '`')
}
