//! Tables of sliders: rows *before, slide, after*, from curves and from files.

use super::error::SlidingError;

/// Points that slide.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Sliders {
    /// Rows *before, slide, after*, in ascending order of the points that slide.
    pub curves: Vec<[usize; 3]>,
    /// Points that slide on a surface, ascending.
    pub surface: Vec<usize>,
}

impl Sliders {
    /// Checks the sliders of shapes of `size` points in `dimension` coordinates.
    ///
    /// # Errors
    /// Rows and points that do not fit, at their positions; no sliders.
    pub fn new(
        [size, dimension]: [usize; 2],
        curves: &[[usize; 3]],
        surface: &[usize],
    ) -> Result<Self, SlidingError> {
        let mut slides = vec![false; size];
        for (position, row) in curves.iter().enumerate() {
            let [before, slide, after] = *row;
            let refused = |detail: String| Err(SlidingError::Row { position, detail });
            if row.iter().any(|point| *point >= size) {
                return refused(format!("expected points below {size}, got [{before}, {slide}, {after}]"));
            }
            if before == slide || slide == after || before == after {
                return refused(format!("expected three different points, got [{before}, {slide}, {after}]"));
            }
            if std::mem::replace(&mut slides[slide], true) {
                return refused(format!("expected each sliding point once, got {slide} twice"));
            }
        }
        for (position, &point) in surface.iter().enumerate() {
            let refused = |detail: String| Err(SlidingError::Surface { position, detail });
            if dimension != 3 {
                return refused(format!("expected points in space, got {dimension} coordinates"));
            }
            if point >= size {
                return refused(format!("expected a point below {size}, got {point}"));
            }
            if std::mem::replace(&mut slides[point], true) {
                return refused(format!("expected each sliding point once, got {point} twice"));
            }
        }
        if curves.is_empty() && surface.is_empty() {
            return Err(SlidingError::NoSliders);
        }
        let (mut curves, mut surface) = (curves.to_vec(), surface.to_vec());
        curves.sort_unstable_by_key(|row| row[1]);
        surface.sort_unstable();
        Ok(Self { curves, surface })
    }

    /// Number of directions in which points slide.
    pub fn directions(&self) -> usize {
        self.curves.len() + 2 * self.surface.len()
    }
}

/// Rows of the points within curves, whose ends do not slide. A closed curve begins and ends with the same point.
pub fn rows_of_curves(curves: &[Vec<usize>]) -> Vec<[usize; 3]> {
    let rows = |curve: &Vec<usize>| curve.windows(3).map(|w| [w[0], w[1], w[2]]).collect::<Vec<_>>();
    curves.iter().flat_map(rows).collect()
}

/// Curves whose points follow `landmarks` other points, one curve after the other. `attach`: points between which the points of a curve
/// lie, which then slide all.
pub fn curves_of_counts(
    landmarks: usize,
    counts: &[usize],
    attach: &[Option<[usize; 2]>],
) -> Vec<Vec<usize>> {
    let mut first = landmarks;
    let curve = |(k, &count): (usize, &usize)| {
        let own = first..first + count;
        first += count;
        match attach.get(k).copied().flatten() {
            Some([before, after]) => std::iter::once(before).chain(own).chain([after]).collect(),
            None => own.collect(),
        }
    };
    counts.iter().enumerate().map(curve).collect()
}

/// Rows of a table as text: three numbers from 1 in a line, apart by commas, semicolons or blanks, below a header or without one.
///
/// # Errors
/// The line, from 1, and what was expected there.
pub fn rows_of_text(text: &str) -> Result<Vec<[usize; 3]>, (usize, String)> {
    let mut rows = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let apart = |c: char| c == ',' || c == ';' || c.is_whitespace();
        let words: Vec<&str> =
            line.split(apart).map(|word| word.trim_matches('"')).filter(|word| !word.is_empty()).collect();
        let is_header = rows.is_empty() && words.iter().any(|word| word.eq_ignore_ascii_case("slide"));
        if words.is_empty() || is_header {
            continue;
        }
        let numbers: Option<Vec<usize>> = words.iter().map(|word| word.parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[before, slide, after]) if before.min(slide).min(after) > 0 => {
                rows.push([before - 1, slide - 1, after - 1]);
            }
            _ => {
                return Err((
                    k + 1,
                    format!("expected three numbers from 1, before, slide and after, got '{line}'"),
                ));
            }
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_read_from_text() {
        let rows = vec![[0, 1, 2], [1, 2, 3]];
        for text in [
            "before,slide,after\n1,2,3\n2,3,4\n",
            "\"before\",\"slide\",\"after\"\r\n1,2,3\r\n2,3,4",
            "1 2 3\n\n2;3;4",
        ] {
            assert_eq!(rows_of_text(text), Ok(rows.clone()), "{text}");
        }
        for (text, line) in [("1,2\n", 1), ("before,slide,after\n1,2,3\n0,1,2", 3), ("1,2,x", 1)] {
            assert_eq!(rows_of_text(text).unwrap_err().0, line, "{text}");
        }
    }

    #[test]
    fn ends_of_curves_slide_where_they_are_attached() {
        assert_eq!(
            rows_of_curves(&[vec![4, 5, 6, 7], vec![0, 8, 9, 0]]),
            [[4, 5, 6], [5, 6, 7], [0, 8, 9], [8, 9, 0]]
        );
        assert_eq!(curves_of_counts(2, &[3, 2], &[]), [vec![2, 3, 4], vec![5, 6]]);
        assert_eq!(curves_of_counts(2, &[3, 2], &[None, Some([0, 1])]), [vec![2, 3, 4], vec![0, 5, 6, 1]]);
    }

    #[test]
    fn rows_that_do_not_fit_are_refused() {
        let refused =
            |curves: &[[usize; 3]], surface: &[usize], d| Sliders::new([5, d], curves, surface).unwrap_err();
        assert!(matches!(refused(&[[0, 1, 2], [1, 5, 2]], &[], 2), SlidingError::Row { position: 1, .. }));
        assert!(matches!(refused(&[[0, 1, 0]], &[], 2), SlidingError::Row { position: 0, .. }));
        assert!(matches!(refused(&[[0, 1, 2], [2, 1, 3]], &[], 2), SlidingError::Row { position: 1, .. }));
        assert!(matches!(refused(&[[0, 1, 2]], &[4, 1], 3), SlidingError::Surface { position: 1, .. }));
        assert!(matches!(refused(&[], &[1], 2), SlidingError::Surface { position: 0, .. }));
        assert_eq!(refused(&[], &[], 2), SlidingError::NoSliders);
    }
}
