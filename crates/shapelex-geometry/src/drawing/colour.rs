//! Colours of drawings: a pair each, for light and for dark pages (colour-blind safe).

/// A colour on light pages and its counterpart on dark pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour {
    light: [u8; 3],
    dark: [u8; 3],
}

/// Page.
pub(super) const PAGE: Colour = Colour::new(0xff_ff_ff, 0x16_18_1d);
/// Main line, and text.
pub const MAIN: Colour = Colour::new(0x1b_1b_1b, 0xe8_e8_e8);
/// Many thin lines in the background.
pub const BACK: Colour = Colour::new(0x44_77_aa, 0x7f_b2_e5);
/// Negative side of a mode.
pub const MINUS: Colour = BACK;
/// Positive side of a mode.
pub const PLUS: Colour = Colour::new(0xcc_33_11, 0xff_80_61);
/// Shape as it was, over a grey picture, which is the same on all pages.
pub const BEFORE: Colour = Colour::new(0x33_bb_ee, 0x33_bb_ee);
/// Shape as it is, over a grey picture.
pub const AFTER: Colour = Colour::new(0xff_88_33, 0xff_88_33);
/// Outline behind the shape of interest.
pub const PALE: Colour = Colour::new(0x9a_9a_9a, 0x7d_7d_7d);
/// No effect.
pub const EFFECT_NONE: Colour = Colour::new(0xdd_dd_dd, 0x41_43_4a);
/// Largest effect.
pub const EFFECT_MOST: Colour = Colour::new(0x88_00_55, 0xff_74_b8);
/// Lines of a coordinate grid.
pub(super) const GRID: Colour = Colour::new(0xdd_dd_dc, 0x3a_3c_42);
/// Text beside a coordinate grid.
pub(super) const LABEL: Colour = Colour::new(0x55_55_55, 0xb4_b4_b4);

/// Groups, in order: told apart also by colour-blind viewers.
pub(super) const GROUPS: [Colour; 8] = [
    Colour::new(0x00_72_b2, 0x5f_b4_e5),
    Colour::new(0xc8_52_00, 0xff_9a_4d),
    Colour::new(0x00_7f_5c, 0x3e_cf_a0),
    Colour::new(0xaa_33_77, 0xe5_8f_c0),
    Colour::new(0x8a_6d_00, 0xe6_c3_4d),
    Colour::new(0x56_56_5a, 0xb9_b9_bd),
    Colour::new(0x6a_3d_9a, 0xb9_9a_e0),
    Colour::new(0x7a_2e_0e, 0xd0_8a_60),
];

impl Colour {
    /// The colour `light` on light pages and `dark` on dark ones, both as `0xrrggbb`.
    pub const fn new(light: u32, dark: u32) -> Self {
        Self { light: channels(light), dark: channels(dark) }
    }

    /// The mixture of `1 − part` of this colour and `part` of the other.
    pub(super) fn towards(self, other: Self, part: f64) -> Self {
        let mix = |a: [u8; 3], b: [u8; 3]| {
            [0, 1, 2].map(|c| channel(f64::from(a[c]) * (1.0 - part) + f64::from(b[c]) * part))
        };
        Self { light: mix(self.light, other.light), dark: mix(self.dark, other.dark) }
    }

    /// The colour of a thing with this colour on light pages under some light, from 0 to 1: things look the same on all pages.
    pub(super) fn under(self, light: f64) -> Self {
        let lit = self.light.map(|c| channel(f64::from(c) * light));
        Self { light: lit, dark: lit }
    }

    /// The colour with two thirds of white.
    pub(super) fn pale(self) -> Self {
        let pale = self.light.map(|c| channel(0.35 * f64::from(c) + 0.65 * 255.0));
        Self { light: pale, dark: pale }
    }

    /// Red, green and blue on light pages.
    pub(super) fn light(self) -> [u8; 3] {
        self.light
    }

    /// Red, green and blue on dark pages.
    pub(super) fn dark(self) -> [u8; 3] {
        self.dark
    }

    /// `#rrggbb` on light pages.
    pub(super) fn on_light(self) -> String {
        hex(self.light)
    }

    /// `#rrggbb` on dark pages.
    pub(super) fn on_dark(self) -> String {
        hex(self.dark)
    }
}

const fn channels(rgb: u32) -> [u8; 3] {
    let [_, red, green, blue] = rgb.to_be_bytes();
    [red, green, blue]
}

fn channel(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn hex([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance of the Web Content Accessibility Guidelines.
    fn luminance(rgb: [u8; 3]) -> f64 {
        let linear = rgb.map(|c| {
            let c = f64::from(c) / 255.0;
            if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        });
        0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    }

    fn contrast(a: [u8; 3], b: [u8; 3]) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn colours_are_legible_on_both_pages() {
        // 4.5 for text and 3 for lines, as the guidelines ask; an outline behind another may be fainter.
        let least = [(MAIN, 4.5), (LABEL, 4.5), (BACK, 3.0), (PLUS, 3.0), (EFFECT_MOST, 3.0), (PALE, 2.5)];
        let groups = GROUPS.map(|colour| (colour, 3.0));
        for (colour, least) in least.into_iter().chain(groups) {
            let (light, dark) = (contrast(colour.light, PAGE.light), contrast(colour.dark, PAGE.dark));
            assert!(light >= least && dark >= least, "{}: {light:.2}, {dark:.2}", colour.on_light());
        }
    }
}
