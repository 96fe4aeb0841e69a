//! Texts whose character set changes at escape sequences (ISO 2022, PS3.5 6.1.2.5).
//!
//! Bytes below 128 are of the set G0, ASCII at first, those above of G1, at first that of the file. An escape sequence changes one of
//! them, until the end of a value or a line.

use dicom_encoding::text::{SpecificCharacterSet, TextCodec};

/// Starts an escape sequence.
pub(super) const ESCAPE: u8 = 0x1b;

/// Character set that an escape sequence selects.
#[derive(Clone, Copy)]
enum Selected {
    /// ASCII, and letters of JIS X 0201, as G0.
    Ascii,
    /// Two bytes a character as G0: JIS X 0208 (ISO-IR 87) and JIS X 0212 (ISO-IR 159).
    Japanese(&'static [u8]),
    /// A set as G1, by its code.
    High(&'static str),
}

/// Escape sequences without their first byte (PS3.3 C.12.1.1.2).
const SEQUENCES: [(&[u8], Selected); 16] = [
    (b"(B", Selected::Ascii),
    (b"(J", Selected::Ascii),
    (b"$B", Selected::Japanese(b"\x1b$B")),
    (b"$(D", Selected::Japanese(b"\x1b$(D")),
    (b")I", Selected::High("ISO_IR 13")),
    (b"$)C", Selected::High("ISO_IR 149")),
    (b"$)A", Selected::High("GB2312")),
    (b"-A", Selected::High("ISO_IR 100")),
    (b"-B", Selected::High("ISO_IR 101")),
    (b"-C", Selected::High("ISO_IR 109")),
    (b"-D", Selected::High("ISO_IR 110")),
    (b"-L", Selected::High("ISO_IR 144")),
    (b"-G", Selected::High("ISO_IR 127")),
    (b"-F", Selected::High("ISO_IR 126")),
    (b"-H", Selected::High("ISO_IR 138")),
    (b"-T", Selected::High("ISO_IR 166")),
];

/// The text, if G1 is `usual` at first.
///
/// # Errors
/// A sequence or a byte without a meaning: the message says the expected and the found one.
pub(super) fn decode(bytes: &[u8], usual: Option<&SpecificCharacterSet>) -> Result<String, String> {
    let (mut low, mut high, mut text) = (None, usual.cloned(), String::new());
    let mut rest = bytes;
    while let Some(first) = rest.first() {
        if *first == ESCAPE {
            let found = SEQUENCES.iter().find(|(sequence, _)| rest[1..].starts_with(sequence));
            let Some((sequence, selected)) = found else {
                let found = rest[1..].iter().take(3).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>();
                return Err(format!(
                    "expected an escape sequence of a known character set, got {}",
                    found.join(" ")
                ));
            };
            match selected {
                Selected::Ascii => low = None,
                Selected::Japanese(escape) => low = Some(*escape),
                Selected::High(code) => high = SpecificCharacterSet::from_code(code),
            }
            rest = &rest[1 + sequence.len()..];
            continue;
        }
        let above = *first > 127;
        let same = |byte: &u8| *byte != ESCAPE && (*byte > 127) == above;
        let ends =
            |byte: &u8| !above && low.is_none() && matches!(byte, b'\\' | b'\r' | b'\n' | b'\t' | b'\x0c');
        let end = rest.iter().position(|byte| !same(byte) || ends(byte)).unwrap_or(rest.len()).max(1);
        let (run, after) = rest.split_at(end);
        match (above, low) {
            (true, _) => text.push_str(&of_set(run, high.as_ref())?),
            (false, Some(escape)) => {
                let japanese = SpecificCharacterSet::from_code("ISO_IR 87");
                text.push_str(&of_set(&[escape, run].concat(), japanese.as_ref())?);
            }
            (false, None) => text.extend(run.iter().copied().map(char::from)),
        }
        if ends(first) {
            high = usual.cloned();
        }
        rest = after;
    }
    Ok(text)
}

fn of_set(bytes: &[u8], set: Option<&SpecificCharacterSet>) -> Result<String, String> {
    let Some(set) = set else {
        return Err("expected a character set for bytes above 127, got none".into());
    };
    set.decode(bytes).map_err(|_| format!("expected text in {}, got other bytes", set.name()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Examples of PS3.5, annexes H, I and K.
    #[test]
    fn examples_of_the_standard_are_read() {
        let ascii = |bytes: &[u8]| decode(bytes, None);
        assert_eq!(ascii(b"\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B").unwrap(), "山田^太郎");
        let kana = SpecificCharacterSet::from_code("ISO 2022 IR 13").unwrap();
        let found = decode(b"\xd4\xcf\xc0\xde^\xc0\xdb\xb3=\x1b$B;3ED\x1b(J^", Some(&kana));
        assert_eq!(found.unwrap(), "ﾔﾏﾀﾞ^ﾀﾛｳ=山田^");
        assert_eq!(ascii(b"\x1b$)C\xfb\xf3^\x1b$)C\xd1\xce\xd4\xd7").unwrap(), "洪^吉洞");
        assert_eq!(ascii(b"\x1b$)C\xb1\xe8\xc8\xf1\xc1\xdf Heart").unwrap(), "김희중 Heart");
        assert_eq!(ascii(b"Zhang^\x1b$)A\xd5\xc5").unwrap(), "Zhang^张");
        assert_eq!(ascii(b"a\x1b-F\xc1\x1b-A\xe4").unwrap(), "aΑä");
    }

    #[test]
    fn a_set_ends_with_its_value() {
        let error = decode(b"\x1b$)C\xb1\xe8\\\xc8\xf1", None).unwrap_err();
        assert_eq!(error, "expected a character set for bytes above 127, got none");
        let error = decode(b"a\x1b%Gb", None).unwrap_err();
        assert_eq!(error, "expected an escape sequence of a known character set, got 25 47 62");
        assert_eq!(
            decode(b"\x1b", None).unwrap_err(),
            "expected an escape sequence of a known character set, got "
        );
    }

    #[test]
    fn any_bytes_are_read_or_refused() {
        let mut state = 1_u32;
        for length in 0..2000 {
            let bytes: Vec<u8> = (0..length % 40)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    b"\x1b$B()CA-\xb1\xe8\\;3"[(state >> 24) as usize % 13]
                })
                .collect();
            let _ = decode(&bytes, None);
        }
    }
}
