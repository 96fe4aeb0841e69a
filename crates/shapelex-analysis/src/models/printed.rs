//! Tables of models as statistical programs print them.

use super::records::AnovaRecord;

/// Heads of the columns.
const HEADS: [&str; 8] = ["", "df", "SS", "MS", "R²", "F", "Z", "p"];
/// Digits of the largest number of a column of decimals.
const DIGITS: i32 = 5;
/// Most places behind the point of each column of decimals: Z and p have no more digits that mean anything.
const MOST_PLACES: [usize; 6] = [10, 10, 5, 5, 4, 5];
/// Space between columns.
const GAP: usize = 2;

impl AnovaRecord {
    /// The table in rows of texts: heads, terms, residuals, total. Numbers of a column have as many places behind the point; what is not
    /// defined is empty.
    pub fn rows(&self) -> Vec<[String; 8]> {
        let terms = self.terms.iter().map(|term| {
            let numbers =
                [Some(term.sum_of_squares), term.mean_square, Some(term.r_squared), term.f, term.z, term.p];
            (term.term.clone(), term.degrees, numbers)
        });
        let residual = &self.residual;
        let residuals = [Some(residual.sum_of_squares), Some(residual.mean_square), Some(residual.r_squared)];
        let residuals = [residuals[0], residuals[1], residuals[2], None, None, None];
        let total = [Some(self.total.sum_of_squares), None, None, None, None, None];
        let rows: Vec<(String, usize, [Option<f64>; 6])> = terms
            .chain([("Residuals".into(), residual.degrees, residuals)])
            .chain([("Total".into(), self.total.degrees, total)])
            .collect();
        let places: [usize; 6] = std::array::from_fn(|c| {
            places(rows.iter().filter_map(|(_, _, numbers)| numbers[c]), MOST_PLACES[c])
        });
        let texts = rows.into_iter().map(|(name, degrees, numbers)| {
            let number = |c: usize| numbers[c].map_or_else(String::new, |x| format!("{x:.*}", places[c]));
            let [a, b, c, d, e, f] = std::array::from_fn(number);
            [name, degrees.to_string(), a, b, c, d, e, f]
        });
        std::iter::once(HEADS.map(str::to_owned)).chain(texts).collect()
    }

    /// The formula, and the table below it: names to the left, numbers to the right of their columns.
    pub fn printed(&self) -> String {
        let rows = self.rows();
        let width = |c: usize| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0);
        let widths: [usize; 8] = std::array::from_fn(width);
        let mut text = format!("{}\n", self.formula);
        for row in &rows {
            let mut line = format!("{:<width$}", row[0], width = widths[0]);
            for (cell, width) in row.iter().zip(widths).skip(1) {
                line += &format!("{cell:>width$}", width = width + GAP);
            }
            text += line.trim_end();
            text.push('\n');
        }
        text
    }
}

/// Places behind the point at which the largest of some numbers has [`DIGITS`] digits.
fn places(numbers: impl Iterator<Item = f64>, most: usize) -> usize {
    let largest = numbers.fold(0.0, |largest: f64, number| largest.max(number.abs()));
    if largest == 0.0 {
        return 1;
    }
    let places = DIGITS - 1 - largest.log10().floor() as i32;
    usize::try_from(places).unwrap_or(0).min(most)
}

#[cfg(test)]
mod tests {
    use super::super::design::Contrasts;
    use super::super::records::{DesignRecord, ResidualRecord, TermRecord, TotalRecord};
    use super::*;

    #[test]
    fn tables_stand_in_columns() {
        let term = |name: &str, degrees, squares: f64, f, p| TermRecord {
            term: name.into(),
            degrees,
            sum_of_squares: squares,
            mean_square: Some(squares / degrees as f64),
            r_squared: squares / 0.2,
            f,
            z: f.map(|_| 4.5),
            p,
            ..TermRecord::default()
        };
        let design = DesignRecord {
            columns: Vec::new(),
            dropped: Vec::new(),
            rank: 4,
            contrasts: Contrasts::Treatment,
            levels: std::collections::BTreeMap::new(),
        };
        let anova = AnovaRecord {
            formula: "~ species * site".into(),
            terms: vec![
                term("species", 1, 0.0293, Some(14.544), Some(0.001)),
                term("site", 2, 0.064, Some(132.0), None),
            ],
            residual: ResidualRecord {
                degrees: 36,
                sum_of_squares: 0.072,
                mean_square: 0.002,
                r_squared: 0.36,
            },
            total: TotalRecord { degrees: 39, sum_of_squares: 0.2 },
            design,
            warnings: Vec::new(),
        };
        let expected = "\
~ species * site
           df       SS        MS       R²       F       Z        p
species     1  0.02930  0.029300  0.14650   14.54  4.5000  0.00100
site        2  0.06400  0.032000  0.32000  132.00  4.5000
Residuals  36  0.07200  0.002000  0.36000
Total      39  0.20000
";
        assert_eq!(anova.printed(), expected);
    }
}
