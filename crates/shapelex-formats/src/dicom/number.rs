//! Decimal strings, the numbers of DICOM.

/// Most characters of a decimal string.
const LONGEST: usize = 16;

/// The number as a decimal string of at most 16 characters: the shortest that reads back the same, else the nearest that fits.
/// It has 13 significant digits or more where 0.1 ≤ |x| < 10¹³, and 9 everywhere.
pub(crate) fn decimal(x: f64) -> String {
    // −0 has no meaning for positions.
    let x = x + 0.0;
    for text in [format!("{x}"), format!("{x:e}")] {
        if text.len() <= LONGEST {
            return text;
        }
    }
    let fits = |text: &String| text.len() <= LONGEST;
    let plain = (0..LONGEST).rev().map(|digits| format!("{x:.digits$}")).find(fits);
    let scientific = (0..LONGEST).rev().map(|digits| format!("{x:.digits$e}")).find(fits);
    let error = |text: &String| text.parse::<f64>().map_or(f64::INFINITY, |y| (y - x).abs());
    [plain, scientific].into_iter().flatten().min_by(|a, b| error(a).total_cmp(&error(b))).unwrap_or_default()
}

/// The number of a decimal string, if it is one and finite.
pub(super) fn parse(bytes: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(bytes).ok()?.trim_matches([' ', '\0']);
    // Words such as `inf` are numbers to the standard library.
    let digits = text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'));
    text.parse::<f64>().ok().filter(|x| digits && x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_fit_and_come_back() {
        for (x, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (-61.279, "-61.279"),
            (1e-7, "0.0000001"),
            (0.1 + 0.2, "0.30000000000000"),
            (-123.456_789_012_345_67, "-123.456789012346"),
            (1e100, "1e100"),
            (-1.234_567_890_123_456_7e-100, "-1.234567890e-100"),
        ] {
            let decimal = decimal(x);
            assert!(decimal.len() <= LONGEST, "{decimal}");
            assert!(parse(decimal.as_bytes()).is_some_and(|y| (y - x).abs() <= 1e-9 * x.abs()), "{decimal}");
            if text.len() < LONGEST {
                assert_eq!(decimal, text);
            }
        }
    }

    #[test]
    fn words_are_no_numbers() {
        for text in ["", " ", "inf", "NaN", "1e999", "1,5", "0x10", "--1", "1 2"] {
            assert_eq!(parse(text.as_bytes()), None, "{text}");
        }
        assert_eq!(parse(b" +1.5E1 \0"), Some(15.0));
    }
}
