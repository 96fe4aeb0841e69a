//! Pixels as run lengths (RLE Lossless, PS3.5 annex G): a fragment for each frame, in which each byte of the cells has a segment.

/// Number of bytes of the header of a frame: the number of segments, and where fifteen of them begin.
const HEADER: usize = 64;
/// Most segments of a frame.
const MOST: usize = 15;

/// The cells of a frame of `bytes` bytes each, the least significant byte first.
///
/// # Errors
/// The expected and the actual bytes.
pub(crate) fn frame(fragment: &[u8], cells: usize, bytes: usize) -> Result<Vec<u8>, String> {
    let number = |at: usize| fragment.get(4 * at..)?.first_chunk().copied().map(u32::from_le_bytes);
    let header: Option<Vec<usize>> = (0..=MOST).map(|at| number(at).map(|number| number as usize)).collect();
    let Some(header) = header.filter(|_| fragment.len() >= HEADER) else {
        return Err(format!("expected {HEADER} bytes of a header of run lengths, got {}", fragment.len()));
    };
    if header[0] != bytes {
        return Err(format!("expected {bytes} segments of run lengths, got {}", header[0]));
    }
    let mut values = vec![0; cells * bytes];
    for (segment, start) in header[1..=bytes].iter().enumerate() {
        let runs = fragment.get((*start).max(HEADER)..).unwrap_or_default();
        // The first segment has the most significant bytes.
        let place = values.iter_mut().skip(bytes - 1 - segment).step_by(bytes);
        let left = fill(place, runs);
        if left > 0 {
            return Err(format!(
                "expected run lengths of {cells} cells, got {} of segment {segment}",
                cells - left
            ));
        }
    }
    Ok(values)
}

/// Fills values by runs. Returns how many are left without one.
fn fill<'v>(mut values: impl ExactSizeIterator<Item = &'v mut u8>, runs: &[u8]) -> usize {
    let mut runs = runs.iter().copied();
    while values.len() > 0 {
        let Some(head) = runs.next() else { break };
        let head = i16::from(head as i8);
        match (usize::try_from(head), usize::try_from(1 - head)) {
            // As many bytes as they are, and one more.
            (Ok(count), _) => values
                .by_ref()
                .take(count + 1)
                .zip(runs.by_ref().take(count + 1))
                .for_each(|(to, from)| *to = from),
            (Err(_), Ok(count)) if head > -128 => {
                let Some(byte) = runs.next() else { break };
                values.by_ref().take(count).for_each(|to| *to = byte);
            }
            // -128 says nothing.
            _ => {}
        }
    }
    values.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fragment(segments: &[&[u8]]) -> Vec<u8> {
        let mut bytes = (segments.len() as u32).to_le_bytes().to_vec();
        let mut at = HEADER as u32;
        for k in 0..MOST {
            let length = segments.get(k).map_or(0, |segment| segment.len() as u32);
            bytes.extend((if length > 0 { at } else { 0 }).to_le_bytes());
            at += length;
        }
        bytes.extend(segments.concat());
        bytes
    }

    #[test]
    fn runs_and_bytes_are_read() {
        // Three of 7, a byte that says nothing, and 1 and 2 as they are.
        let runs: &[u8] = &[0xfe, 7, 0x80, 1, 1, 2];
        assert_eq!(frame(&fragment(&[runs]), 5, 1).unwrap(), [7, 7, 7, 1, 2]);
        assert_eq!(frame(&fragment(&[&[0xff, 1], runs]), 2, 2).unwrap(), [7, 1, 7, 1]);
    }

    #[test]
    fn short_and_strange_frames_are_refused() {
        let whole = fragment(&[&[0xfe, 7]]);
        for (bytes, cells, width, expected) in [
            (&whole[..], 4, 1, "expected run lengths of 4 cells, got 3 of segment 0"),
            (&whole[..], 3, 2, "expected 2 segments of run lengths, got 1"),
            (&whole[..10], 3, 1, "expected 64 bytes of a header of run lengths, got 10"),
            (&fragment(&[&[3, 7]])[..], 4, 1, "expected run lengths of 4 cells, got 1 of segment 0"),
        ] {
            assert_eq!(frame(bytes, cells, width).unwrap_err(), expected);
        }
    }
}
