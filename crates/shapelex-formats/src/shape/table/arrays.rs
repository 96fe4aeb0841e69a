//! Arrays of tables by other programs, whatever their widths and encodings, as numbers, texts, flags and lists.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, Float64Array};
use arrow_buffer::NullBuffer;
use arrow_schema::DataType;

/// Numbers of an array, null where it has none; `None` if it holds no numbers.
pub(super) fn numbers(array: &ArrayRef) -> Option<Float64Array> {
    Some(match array.data_type() {
        DataType::Float64 => array.as_primitive::<arrow_array::types::Float64Type>().clone(),
        DataType::Float32 => array.as_primitive::<Float32Type>().unary(f64::from),
        DataType::Int8 => array.as_primitive::<Int8Type>().unary(f64::from),
        DataType::Int16 => array.as_primitive::<Int16Type>().unary(f64::from),
        DataType::Int32 => array.as_primitive::<Int32Type>().unary(f64::from),
        // Whole numbers beyond 2⁵³ are rounded: `wholes` has them.
        DataType::Int64 => array.as_primitive::<Int64Type>().unary(|value| value as f64),
        DataType::UInt8 => array.as_primitive::<UInt8Type>().unary(f64::from),
        DataType::UInt16 => array.as_primitive::<UInt16Type>().unary(f64::from),
        DataType::UInt32 => array.as_primitive::<UInt32Type>().unary(f64::from),
        DataType::UInt64 => array.as_primitive::<UInt64Type>().unary(|value| value as f64),
        DataType::Null => Float64Array::new_null(array.len()),
        _ => return None,
    })
}

/// Whole numbers of an array, if it holds those of 64 bits.
pub(super) fn wholes(array: &ArrayRef, row: usize) -> Option<i128> {
    let signed = array.as_primitive_opt::<Int64Type>().map(|array| i128::from(array.value(row)));
    signed.or_else(|| Some(array.as_primitive_opt::<UInt64Type>()?.value(row).into()))
}

/// Whether arrays of a type hold numbers, as [`numbers`] gives them.
pub(super) fn is_number(kind: &DataType) -> bool {
    kind.is_integer() || matches!(kind, DataType::Float32 | DataType::Float64 | DataType::Null)
}

pub(super) fn is_text(kind: &DataType) -> bool {
    matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
}

pub(super) fn is_flag(kind: &DataType) -> bool {
    *kind == DataType::Boolean
}

/// Whether arrays of a type hold lists of numbers, or lists of such lists.
pub(super) fn is_list_of_numbers(kind: &DataType) -> bool {
    let item = |kind: &DataType| match kind {
        DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) => {
            Some(item.data_type().clone())
        }
        _ => None,
    };
    item(kind)
        .is_some_and(|values| is_number(&values) || item(&values).is_some_and(|values| is_number(&values)))
}

/// Texts of an array.
pub(super) enum Texts {
    /// One after the other.
    Plain(ArrayRef),
    /// By position in a list of different ones.
    Positions(Vec<usize>, Option<NullBuffer>, ArrayRef),
}

impl Texts {
    /// Texts of an array, or `None` if it holds none.
    pub(super) fn of(array: &ArrayRef) -> Option<Self> {
        if is_text(array.data_type()) {
            return Some(Self::Plain(array.clone()));
        }
        let coded = array.as_any_dictionary_opt().filter(|coded| is_text(coded.values().data_type()))?;
        let keys = if coded.values().is_empty() { Vec::new() } else { coded.normalized_keys() };
        Some(Self::Positions(keys, coded.keys().nulls().cloned(), coded.values().clone()))
    }

    /// The text of a row.
    pub(super) fn get(&self, row: usize) -> Option<&str> {
        match self {
            Self::Plain(array) => text(array, row),
            Self::Positions(positions, nulls, values) => {
                let valid = nulls.as_ref().is_none_or(|nulls| nulls.is_valid(row));
                positions.get(row).filter(|_| valid).and_then(|position| text(values, *position))
            }
        }
    }
}

fn text(array: &ArrayRef, row: usize) -> Option<&str> {
    if array.is_null(row) {
        return None;
    }
    match array.data_type() {
        DataType::Utf8 => Some(array.as_string::<i32>().value(row)),
        DataType::LargeUtf8 => Some(array.as_string::<i64>().value(row)),
        DataType::Utf8View => Some(array.as_string_view().value(row)),
        _ => None,
    }
}

/// Lists of an array: the values of all of them, and where each of them is.
pub(super) struct Lists {
    /// Values of all lists.
    pub(super) values: ArrayRef,
    ranges: Ranges,
    nulls: Option<NullBuffer>,
}

enum Ranges {
    Offsets(Vec<usize>),
    Width(usize),
}

impl Lists {
    /// Lists of an array, or `None` if it holds none.
    pub(super) fn of(array: &ArrayRef) -> Option<Self> {
        let nulls = array.nulls().cloned();
        // Offsets are checked by the array: they ascend from 0 and end within the values.
        Some(match array.data_type() {
            DataType::List(_) => {
                let lists = array.as_list::<i32>();
                let offsets = lists.offsets().iter().map(|at| usize::try_from(*at).unwrap_or(0)).collect();
                Self { values: lists.values().clone(), ranges: Ranges::Offsets(offsets), nulls }
            }
            DataType::LargeList(_) => {
                let lists = array.as_list::<i64>();
                let offsets = lists.offsets().iter().map(|at| usize::try_from(*at).unwrap_or(0)).collect();
                Self { values: lists.values().clone(), ranges: Ranges::Offsets(offsets), nulls }
            }
            DataType::FixedSizeList(_, width) => {
                let lists = array.as_fixed_size_list();
                let width = usize::try_from(*width).ok()?;
                Self { values: lists.values().clone(), ranges: Ranges::Width(width), nulls }
            }
            _ => return None,
        })
    }

    /// Range of the values of a row.
    pub(super) fn get(&self, row: usize) -> Option<std::ops::Range<usize>> {
        if self.nulls.as_ref().is_some_and(|nulls| nulls.is_null(row)) {
            return None;
        }
        Some(match &self.ranges {
            Ranges::Offsets(offsets) => *offsets.get(row)?..*offsets.get(row + 1)?,
            Ranges::Width(width) => row * width..(row + 1) * width,
        })
    }
}
