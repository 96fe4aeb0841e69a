//! Outlines of lines of text, in the letters of the only font.
//!
//! The letters are those of Latin, Greek and Cyrillic, which need no shaping: letters with accents are composed, and pairs are kerned by
//! the font. A letter that the font does not have is drawn as a box.

use std::sync::LazyLock;

use tiny_skia::{Path, PathBuilder, Transform};
use unicode_normalization::UnicodeNormalization;

use super::font::{Font, Glyph};

static FONT: LazyLock<Font> = LazyLock::new(|| {
    Font::new(include_bytes!("../fonts/Roboto-Regular.ttf")).expect("the font of the program can be read")
});

/// Part of a text that is at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// The outline of a line of text, whose base line goes through `at`. `None` if nothing is seen of it.
pub(super) fn outline(text: &str, at: [f32; 2], size: f32, anchor: Anchor) -> Option<Path> {
    let font = &*FONT;
    let letters: Vec<Glyph> = plain(text).nfc().map(|c| font.letter(c)).collect();
    let scale = size / f32::from(font.units_per_em());
    let width = |i: usize| font.advance(letters[i], letters.get(i + 1).copied()) as f32 * scale;
    let whole = (0..letters.len()).fold(0.0, |sum, i| sum + width(i));
    let mut x = match anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -whole / 2.0,
        Anchor::End => -whole,
    };
    let mut all = PathBuilder::new();
    for (i, letter) in letters.iter().enumerate() {
        let mut pen = PathBuilder::new();
        font.outline(*letter, &mut pen);
        // The second axis of the font points up.
        let place = Transform::from_translate(at[0], at[1]).pre_translate(x, 0.0).pre_scale(scale, scale);
        if let Some(path) = pen.finish().and_then(|path| path.transform(place.pre_scale(1.0, -1.0))) {
            all.push_path(&path);
        }
        x += width(i);
    }
    all.finish()
}

/// The text with single spaces, of which none is first or last, and without marks that are never seen.
fn plain(text: &str) -> std::vec::IntoIter<char> {
    let is_seen = |c: &char| !matches!(c, '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{2060}'..='\u{2064}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}');
    let mut plain = Vec::new();
    for word in text.split([' ', '\t', '\n', '\r']).filter(|word| !word.is_empty()) {
        if !plain.is_empty() {
            plain.push(' ');
        }
        plain.extend(word.chars().filter(is_seen));
    }
    plain.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Left and right end of a text.
    fn ends(text: &str, anchor: Anchor) -> Option<[f32; 2]> {
        let path = outline(text, [100.0, 50.0], 2048.0, anchor)?;
        Some([path.bounds().left(), path.bounds().right()])
    }

    #[test]
    fn texts_are_placed_at_their_anchor() {
        let [start, middle, end] =
            [Anchor::Start, Anchor::Middle, Anchor::End].map(|at| ends("HH", at).unwrap());
        // The widths of Roboto: an H takes 1461 units of 2048, and its stems begin 169 and end 173 units within.
        assert_eq!(start, [100.0 + 169.0, 100.0 + 2.0 * 1461.0 - 173.0]);
        assert_eq!([middle, end].map(|ends| ends[0]), [start[0] - 1461.0, start[0] - 2922.0]);
        assert_eq!(outline("  \t", [0.0; 2], 10.0, Anchor::Start), None);
    }

    #[test]
    fn pairs_are_kerned_and_accents_composed() {
        let advance =
            |first, next: Option<char>| FONT.advance(FONT.letter(first), next.map(|c| FONT.letter(c)));
        assert!(advance('A', Some('V')) < advance('A', None));
        assert!(advance('T', Some('o')) < advance('T', None));
        assert_eq!(advance('H', Some('H')), advance('H', None));
        let of = |text: &str| outline(text, [0.0; 2], 20.0, Anchor::Start).unwrap();
        assert_eq!(of("e\u{301}"), of("é"));
        assert_ne!(of("é"), of("e"));
        // Letters that the font does not have are boxes.
        assert_eq!(of("細"), of("\u{10ffff}"));
        assert_eq!(of(" a\u{ad}\n b "), of("a b"));
    }
}
