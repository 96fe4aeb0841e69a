//! The member `coordinates`: lists of numbers, nested up to four deep, read into flat lists whatever the type of the geometry is,
//! which may stand before or behind them.

use std::fmt;

use serde::de::{Deserialize, DeserializeSeed, Deserializer, Error, SeqAccess, Visitor};

use super::super::record::Points;

/// Nested lists of positions.
///
/// A position has height 0, a line or ring height 1, the rings of a polygon height 2, the polygons of a group height 3.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Coordinates {
    /// All numbers in order.
    numbers: Vec<f64>,
    /// Number of coordinates of a position.
    dimension: usize,
    /// For heights 1 to 3: number of lists of the height below up to the end of each list.
    ends: [Vec<usize>; 3],
    /// Height of the whole; `None` if there is no position.
    pub(super) height: Option<usize>,
}

impl Coordinates {
    /// All positions in order.
    pub(super) fn points(self) -> Points {
        Points::from_rows(self.dimension.max(1), self.numbers)
    }

    /// The lists of height 1 as points each.
    pub(super) fn lines(self) -> Vec<Points> {
        let [ends, ..] = self.ends;
        if ends.len() == 1 {
            return vec![Points::from_rows(self.dimension, self.numbers)];
        }
        let mut start = 0;
        let cut = |end: usize| {
            let row = start * self.dimension..end * self.dimension;
            start = end;
            Points::from_rows(self.dimension, self.numbers[row].to_vec())
        };
        ends.into_iter().map(cut).collect()
    }

    /// The lists of height 2 as lines each.
    pub(super) fn polygons(mut self) -> Vec<Vec<Points>> {
        let ends = std::mem::take(&mut self.ends[1]);
        let mut lines = self.lines().into_iter();
        let mut start = 0;
        let mut cut = |end: usize| {
            let count = end - start;
            start = end;
            lines.by_ref().take(count).collect()
        };
        ends.into_iter().map(&mut cut).collect()
    }

    /// Number of the lists of height 1.
    pub(super) fn rings(&self) -> usize {
        self.ends[0].len()
    }

    /// Number of lists that have been completed at a height.
    fn count(&self, height: usize) -> usize {
        match height {
            0 => self.numbers.len() / self.dimension.max(1),
            _ => self.ends[height - 1].len(),
        }
    }
}

/// Element of a list.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Element {
    Number,
    /// A list without positions.
    Empty,
    List(usize),
}

/// Reads one element into the lists.
struct Into<'c>(&'c mut Coordinates);

impl<'de> DeserializeSeed<'de> for Into<'_> {
    type Value = Element;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Element, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Into<'_> {
    type Value = Element;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a coordinate or a list of positions")
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Element, E> {
        self.0.numbers.push(number);
        Ok(Element::Number)
    }

    #[allow(clippy::cast_precision_loss, reason = "the nearest number, as for any text of a number")]
    fn visit_u64<E: Error>(self, number: u64) -> Result<Element, E> {
        self.visit_f64(number as f64)
    }

    #[allow(clippy::cast_precision_loss, reason = "the nearest number, as for any text of a number")]
    fn visit_i64<E: Error>(self, number: i64) -> Result<Element, E> {
        self.visit_f64(number as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Element, A::Error> {
        let coordinates = self.0;
        let (mut inside, mut count) = (None, 0);
        while let Some(element) = list.next_element_seed(Into(coordinates))? {
            if *inside.get_or_insert(element) != element {
                return Err(A::Error::custom("expected lists of one depth, got several"));
            }
            count += 1;
        }
        match inside {
            None | Some(Element::Empty) => Ok(Element::Empty),
            Some(Element::Number) => {
                if coordinates.dimension == 0 && (2..=3).contains(&count) {
                    coordinates.dimension = count;
                }
                if coordinates.dimension != count {
                    let expected = match coordinates.dimension {
                        0 => "2 or 3".into(),
                        dimension => dimension.to_string(),
                    };
                    let message = format!("expected positions of {expected} coordinates, got {count}");
                    return Err(A::Error::custom(message));
                }
                Ok(Element::List(0))
            }
            Some(Element::List(height)) if height < coordinates.ends.len() => {
                let end = coordinates.count(height);
                coordinates.ends[height].push(end);
                Ok(Element::List(height + 1))
            }
            Some(Element::List(_)) => Err(A::Error::custom("expected at most four nested lists, got more")),
        }
    }
}

impl<'de> Deserialize<'de> for Coordinates {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut coordinates = Self::default();
        match Into(&mut coordinates).deserialize(deserializer)? {
            Element::Number => return Err(D::Error::custom("expected a list of positions, got a number")),
            Element::Empty => {}
            Element::List(height) => coordinates.height = Some(height),
        }
        Ok(coordinates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Coordinates, String> {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn lists_of_every_depth_are_flat() {
        let point = read("[1, 2.5]").expect("a position");
        assert_eq!((point.height, point.points().coordinates()), (Some(0), &[1.0, 2.5][..]));
        let line = read("[[1,2,3],[-4,5,6]]").expect("a line");
        assert_eq!((line.height, line.points().len()), (Some(1), 2));
        let polygons = read("[[[[0,0],[1,0]],[[2,2]]],[[[3,3],[4,4],[5,5]]]]").expect("polygons");
        assert_eq!(polygons.height, Some(3));
        let sizes: Vec<Vec<usize>> =
            polygons.polygons().iter().map(|rings| rings.iter().map(Points::len).collect()).collect();
        assert_eq!(sizes, [vec![2, 1], vec![3]]);
        for empty in ["[]", "[[]]", "[[[],[]]]"] {
            assert_eq!(read(empty).expect("nothing").height, None);
        }
    }

    #[test]
    fn other_lists_are_refused() {
        for (text, message) in [
            ("7", "expected a list of positions, got a number"),
            ("[[0,1],2]", "expected lists of one depth, got several"),
            ("[[],[0,1]]", "expected lists of one depth, got several"),
            ("[[0,1],[2]]", "expected positions of 2 coordinates, got 1"),
            ("[0]", "expected positions of 2 or 3 coordinates, got 1"),
            ("[0,1,2,3]", "expected positions of 2 or 3 coordinates, got 4"),
            ("[[[[[0,1]]]]]", "expected at most four nested lists, got more"),
            ("[0,null]", "expected a coordinate or a list of positions"),
            ("[0,1e999]", "number out of range"),
        ] {
            let error = read(text).expect_err(text);
            assert!(error.contains(message), "{text}: {error}");
        }
    }
}
