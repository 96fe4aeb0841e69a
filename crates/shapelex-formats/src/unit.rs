//! Units of coordinates: lengths, cells of an image, and none.
//!
//! ```text
//! x in u = x · a / b in v,   a / b = length of u / length of v in lowest terms, whole numbers
//! ```
//!
//! Powers of ten are one multiplication or one division, and so rounded correctly: 1 mm is 0.1 cm, the number nearest to a tenth.

/// Unit of coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unit {
    /// 10⁹ nm.
    Metre,
    /// 10⁷ nm.
    Centimetre,
    /// 10⁶ nm.
    Millimetre,
    /// 10³ nm.
    Micrometre,
    /// The smallest unit, in which all others are whole numbers.
    Nanometre,
    /// 25.4 mm.
    Inch,
    /// Cells of an image in the plane.
    Pixel,
    /// Cells of a volume.
    Voxel,
    /// Numbers without a unit, by intent.
    None,
}

impl Unit {
    /// All units.
    pub const ALL: [Self; 9] = [
        Self::Metre,
        Self::Centimetre,
        Self::Millimetre,
        Self::Micrometre,
        Self::Nanometre,
        Self::Inch,
        Self::Pixel,
        Self::Voxel,
        Self::None,
    ];

    /// Its word: of lengths the code of UCUM without brackets, of the others that of answers.
    pub fn word(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Micrometre => "um",
            Self::Nanometre => "nm",
            Self::Inch => "inch",
            Self::Pixel => "pixel",
            Self::Voxel => "voxel",
            Self::None => "none",
        }
    }

    /// The unit that a text names: a word, or another spelling that programs use.
    pub fn find(text: &str) -> Option<Self> {
        let text = text.trim();
        // Lower and upper case tell units apart: Mm is another unit.
        match text {
            "m" => return Some(Self::Metre),
            "cm" => return Some(Self::Centimetre),
            "mm" => return Some(Self::Millimetre),
            "um" | "µm" | "μm" => return Some(Self::Micrometre),
            "nm" => return Some(Self::Nanometre),
            "in" | "[in_i]" | "\"" => return Some(Self::Inch),
            "px" => return Some(Self::Pixel),
            _ => {}
        }
        match text.to_lowercase().as_str() {
            "meter" | "metre" | "meters" | "metres" => Some(Self::Metre),
            "centimeter" | "centimetre" | "centimeters" | "centimetres" => Some(Self::Centimetre),
            "millimeter" | "millimetre" | "millimeters" | "millimetres" => Some(Self::Millimetre),
            "micron" | "microns" | "micrometer" | "micrometre" | "micrometers" | "micrometres" => {
                Some(Self::Micrometre)
            }
            "nanometer" | "nanometre" | "nanometers" | "nanometres" => Some(Self::Nanometre),
            "inch" | "inches" => Some(Self::Inch),
            "pixel" | "pixels" => Some(Self::Pixel),
            "voxel" | "voxels" => Some(Self::Voxel),
            "none" => Some(Self::None),
            _ => None,
        }
    }

    /// The words of all units, for a list in a message.
    pub fn words() -> String {
        Self::ALL.map(Self::word).join(", ")
    }

    /// Whether it is a length.
    pub fn is_length(self) -> bool {
        self.nanometres().is_some()
    }

    /// Its length.
    fn nanometres(self) -> Option<u64> {
        match self {
            Self::Metre => Some(1_000_000_000),
            Self::Centimetre => Some(10_000_000),
            Self::Millimetre => Some(1_000_000),
            Self::Micrometre => Some(1_000),
            Self::Nanometre => Some(1),
            Self::Inch => Some(25_400_000),
            Self::Pixel | Self::Voxel | Self::None => None,
        }
    }

    /// The conversion to another unit. `None` between a length and a unit that is not one; units that are not lengths keep the numbers.
    pub fn to(self, other: Self) -> Option<Ratio> {
        match (self.nanometres(), other.nanometres()) {
            (Some(from), Some(to)) => Some(Ratio::new(from, to)),
            (None, None) => Some(Ratio::ONE),
            _ => None,
        }
    }
}

/// A positive fraction in lowest terms, by which coordinates are multiplied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ratio {
    over: u64,
    under: u64,
}

impl Ratio {
    /// No change.
    pub const ONE: Self = Self { over: 1, under: 1 };

    fn new(over: u64, under: u64) -> Self {
        let (mut a, mut b) = (over, under);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        Self { over: over / a, under: under / a }
    }

    /// The product with a number: rounded once for powers of ten, at most twice for inches.
    pub fn times(self, x: f64) -> f64 {
        match self {
            Self { over, under: 1 } => x * over as f64,
            Self { over: 1, under } => x / under as f64,
            Self { over, under } => x * over as f64 / under as f64,
        }
    }

    /// The number nearest to the fraction.
    pub fn value(self) -> f64 {
        self.over as f64 / self.under as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_ten_are_rounded_once() {
        let convert = |x: f64, from: Unit, to: Unit| from.to(to).expect("two lengths").times(x);
        assert_eq!(convert(1.0, Unit::Millimetre, Unit::Centimetre), 0.1);
        assert_eq!(convert(0.3, Unit::Metre, Unit::Millimetre), 300.0);
        assert_eq!(convert(123_456_789.0, Unit::Nanometre, Unit::Metre), 0.123456789);
        assert_eq!(convert(0.5, Unit::Inch, Unit::Millimetre), 12.7);
        assert_eq!(convert(254.0, Unit::Centimetre, Unit::Inch), 100.0);
        // A factor that is rounded first gives another number: 7 · 0.1 is 0.7000000000000001.
        assert_eq!(convert(7.0, Unit::Millimetre, Unit::Centimetre), 0.7);
        assert!(
            (7.0 * Unit::Millimetre.to(Unit::Centimetre).expect("two lengths").value() - 0.7).abs() > 0.0
        );
    }

    #[test]
    fn what_are_no_lengths_are_the_same_numbers() {
        for from in Unit::ALL {
            for to in Unit::ALL {
                let found = from.to(to);
                assert_eq!(found.is_some(), from.is_length() == to.is_length(), "{from:?} {to:?}");
                assert!(from.is_length() || found.is_none_or(|ratio| ratio == Ratio::ONE));
            }
        }
    }

    #[test]
    fn words_and_other_spellings_are_found() {
        for unit in Unit::ALL {
            assert_eq!(Unit::find(unit.word()), Some(unit));
        }
        for (text, unit) in [
            ("µm", Some(Unit::Micrometre)),
            ("μm", Some(Unit::Micrometre)),
            ("Micron", Some(Unit::Micrometre)),
            (" millimeters ", Some(Unit::Millimetre)),
            ("[in_i]", Some(Unit::Inch)),
            ("px", Some(Unit::Pixel)),
            ("Mm", None),
            ("M", None),
            ("MM", None),
            ("furlong/fortnight", None),
            ("", None),
        ] {
            assert_eq!(Unit::find(text), unit, "{text}");
        }
    }
}
