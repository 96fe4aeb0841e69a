//! Chunks as bytes: control points and weights as little-endian `f64`, with a BLAKE3 checksum.

use super::engine::{Row, Transaction, sql};
use super::error::StoreError;

/// Maximum number of shapes in a chunk.
pub(super) const ROWS_PER_CHUNK: usize = 4096;
/// Maximum size of the control points in a chunk, unless a single shape is larger. A single shape is read by reading its
/// whole chunk, which should take a millisecond.
pub(super) const BYTES_PER_CHUNK: usize = 1 << 20;
/// Size of a coordinate.
pub(super) const BYTES_PER_NUMBER: usize = 8;

/// Number of shapes that fit in a chunk.
pub(super) fn rows_per_chunk(width: usize) -> usize {
    (BYTES_PER_CHUNK / (width * BYTES_PER_NUMBER).max(1)).clamp(1, ROWS_PER_CHUNK)
}

/// Control points and weights of a chunk, ready to be stored.
#[derive(Debug)]
pub(super) struct Encoded {
    pub(super) checksum: Vec<u8>,
    /// `None` if all weights are 1.
    pub(super) weights: Option<Vec<u8>>,
    pub(super) points: Vec<u8>,
}

impl Encoded {
    /// Encodes shapes given as weight and bytes of control points.
    pub(super) fn new<'a>(shapes: impl Iterator<Item = (f64, &'a [u8])>) -> Self {
        let (weights, points): (Vec<f64>, Vec<&[u8]>) = shapes.unzip();
        let points = points.concat();
        let is_weighted = weights.iter().any(|weight| *weight != 1.0);
        let weights = is_weighted.then(|| bytes_of(&weights));
        Self { checksum: checksum(&points, weights.as_deref().unwrap_or_default()), weights, points }
    }
}

/// Bytes of the numbers, as stored.
pub(super) fn bytes_of(numbers: &[f64]) -> Vec<u8> {
    let mut bytes = vec![0; numbers.len() * BYTES_PER_NUMBER];
    let (slots, _) = bytes.as_chunks_mut();
    for (slot, number) in slots.iter_mut().zip(numbers) {
        *slot = number.to_le_bytes();
    }
    bytes
}

fn checksum(points: &[u8], weights: &[u8]) -> Vec<u8> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(points).update(weights);
    hasher.finalize().as_bytes().to_vec()
}

/// Reads the chunks with these ids, in any order; missing ones are left out.
pub(super) async fn load(connection: &mut Transaction, chunks: &[i64]) -> Result<Vec<Row>, StoreError> {
    const LOAD: &str = "SELECT c.id, c.rows, c.width, d.checksum, d.weights, d.points
        FROM json_each($1) AS asked
        CROSS JOIN chunk AS c ON c.id = CAST(asked.value AS BIGINT)
        CROSS JOIN chunk_data AS d ON d.chunk_id = c.id";
    let asked = serde_json::Value::from(chunks).to_string();
    Ok(sql(connection, LOAD).bind(asked).all().await?)
}

/// The chunk of a row of [`load`], with zeros in place of these shapes. A checksum that did not match still does not.
pub(super) fn without(row: &Row, positions: &[i64]) -> Result<Encoded, StoreError> {
    let is_sound = Chunk::verified(row).is_ok();
    let width = usize::try_from(row.get::<i64>("width")?).unwrap_or_default();
    let (mut points, mut weights): (Vec<u8>, Option<Vec<u8>>) = (row.get("points")?, row.get("weights")?);
    for &position in positions {
        let position = usize::try_from(position).unwrap_or(usize::MAX);
        overwrite(&mut points, position, width, 0.0);
        if let Some(weights) = &mut weights {
            overwrite(weights, position, 1, 1.0);
        }
    }
    let checksum = if is_sound {
        checksum(&points, weights.as_deref().unwrap_or_default())
    } else {
        row.get("checksum")?
    };
    Ok(Encoded { checksum, weights, points })
}

/// Overwrites the numbers of a row; rows beyond the end have none.
fn overwrite(bytes: &mut [u8], position: usize, width: usize, number: f64) {
    let (slots, _) = bytes.as_chunks_mut();
    let first = position.saturating_mul(width);
    slots.iter_mut().skip(first).take(width).for_each(|slot| *slot = number.to_le_bytes());
}

/// A stored chunk with verified checksum; it borrows the row's bytes.
#[derive(Debug)]
pub(super) struct Chunk<'a> {
    pub(super) id: i64,
    rows: usize,
    width: usize,
    weights: Option<&'a [u8]>,
    points: &'a [u8],
}

impl<'a> Chunk<'a> {
    /// Verifies a row of [`load`]. Cost: one pass over its bytes.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if checksum or sizes do not match.
    pub(super) fn verified(row: &'a Row) -> Result<Self, StoreError> {
        let chunk = Self {
            id: row.get("id")?,
            rows: usize::try_from(row.get::<i64>("rows")?).unwrap_or_default(),
            width: usize::try_from(row.get::<i64>("width")?).unwrap_or_default(),
            weights: row.get("weights")?,
            points: row.get("points")?,
        };
        let expected: &[u8] = row.get("checksum")?;
        let fits = chunk.points.len() == chunk.rows * chunk.width * BYTES_PER_NUMBER
            && chunk.weights.is_none_or(|w| w.len() == chunk.rows * BYTES_PER_NUMBER);
        if fits && checksum(chunk.points, chunk.weights.unwrap_or_default()) == expected {
            return Ok(chunk);
        }
        Err(StoreError::Corrupt { chunk: chunk.id })
    }

    /// Number of shapes.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Number of coordinates of all shapes together.
    pub(super) fn numbers(&self) -> usize {
        self.points.len() / BYTES_PER_NUMBER
    }

    /// Appends weights and control points of the shapes `rows`.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if the chunk does not contain them.
    pub(super) fn append_to(
        &self,
        rows: std::ops::Range<usize>,
        weights: &mut Vec<f64>,
        points: &mut Vec<f64>,
    ) -> Result<(), StoreError> {
        let corrupt = || StoreError::Corrupt { chunk: self.id };
        match self.weights {
            None => weights.extend(rows.clone().map(|_| 1.0)),
            Some(bytes) => weights.extend(numbers(bytes, &rows, 1).ok_or_else(corrupt)?),
        }
        points.extend(numbers(self.points, &rows, self.width).ok_or_else(corrupt)?);
        Ok(())
    }

    /// Weight and control points of one shape.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if the chunk does not contain it.
    pub(super) fn shape(&self, position: usize) -> Result<(f64, Vec<f64>), StoreError> {
        if position >= self.rows() {
            return Err(StoreError::Corrupt { chunk: self.id });
        }
        let (mut weights, mut points) = (Vec::new(), Vec::new());
        self.append_to(position..position + 1, &mut weights, &mut points)?;
        Ok((weights[0], points))
    }
}

/// Numbers of a range of rows with `width` numbers each.
fn numbers<'a>(
    bytes: &'a [u8],
    rows: &std::ops::Range<usize>,
    width: usize,
) -> Option<impl ExactSizeIterator<Item = f64> + 'a> {
    let step = width * BYTES_PER_NUMBER;
    let (numbers, _) = bytes.get(rows.start * step..rows.end * step)?.as_chunks();
    Some(numbers.iter().map(|number| f64::from_le_bytes(*number)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_are_bounded_in_rows_and_bytes() {
        assert_eq!(rows_per_chunk(2), ROWS_PER_CHUNK);
        assert_eq!(rows_per_chunk(128), 1024);
        assert_eq!(rows_per_chunk(1 << 20), 1);
    }

    #[test]
    fn weights_are_stored_only_when_needed() {
        let shape = bytes_of(&[1.0, 2.0]);
        let plain = Encoded::new([(1.0, &shape[..]), (1.0, &shape[..])].into_iter());
        let weighted = Encoded::new([(1.0, &shape[..]), (2.0, &shape[..])].into_iter());
        assert_eq!(plain.weights, None);
        assert_eq!(weighted.weights.as_deref().map(<[u8]>::len), Some(16));
        assert_ne!(plain.checksum, weighted.checksum);
    }
}
