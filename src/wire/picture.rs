//! Drawings as picture files: SVG, and PNG of the same drawing.
//!
//! A PNG is the SVG painted by tiny-skia, with the letters of a font that is part of the program: the bytes do not depend on the
//! machine. Letters outside of Latin, Greek and Cyrillic appear as boxes. It cannot follow the preference of a viewer, so that
//! the theme `auto` is the light one.

mod font;
mod letters;
mod raster;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use tiny_skia::{Color, ColorU8, Pixmap, PixmapPaint, Transform};

use super::image::write::png_u8;
use super::image::{Grid, ImageError, LengthUnit};
use crate::geometry::drawing::picture::{Picture, PlacedPicture};
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::drawing::svg::{Background, Style, Theme};

/// File format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureFormat {
    /// Scalable Vector Graphics.
    Svg,
    /// Portable Network Graphics.
    Png,
}

impl PictureFormat {
    /// All formats; the first is preferred where any will do.
    pub const ALL: [Self; 2] = [Self::Svg, Self::Png];

    /// Name used in queries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
        }
    }

    /// Media type of the file.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
        }
    }
}

/// A picture file as a client wants it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureFile {
    /// Format of the file.
    pub format: PictureFormat,
    /// Settings of the viewer.
    pub style: Style,
}

/// Cells of a picture behind shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyCells {
    /// Number of cells along the rows, and number of rows.
    pub size: [usize; 2],
    /// Grey values, row by row from the top.
    pub grey: Vec<u8>,
}

impl GreyCells {
    /// The picture between two corners of the plane, the upper left and the lower right one.
    ///
    /// # Errors
    /// No cells, or another number of values.
    pub fn over(self, corners: [[f64; 2]; 2]) -> Result<Picture, ImageError> {
        let Self { size, grey } = self;
        let grid = Grid::along_axes([size[0], size[1], 1], [1.0; 3], [LengthUnit::Unknown; 3])?;
        let address = format!("data:image/png;base64,{}", STANDARD.encode(png_u8(&grid, &grey)?));
        Ok(Picture { size, grey, address, corners })
    }
}

/// Maximum number of pixels of a PNG: a square picture of the greatest width, with its captions. A pixel needs four bytes.
pub const MAX_PIXELS: u64 = 20_000_000;

/// Reason why a picture cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// It has too many pixels.
    #[error(
        "expected a PNG of at most {MAX_PIXELS} pixels, got {width} × {height}: ask for a smaller width, or for svg"
    )]
    TooLarge {
        /// Width in pixels.
        width: u64,
        /// Height in pixels.
        height: u64,
    },
    /// The drawing has elements that cannot be painted (a bug).
    #[error("the drawing cannot be rendered: {0}")]
    Render(String),
}

impl PictureFile {
    /// Writes the drawing as a file.
    ///
    /// # Errors
    /// A PNG of too many pixels.
    pub fn write(&self, drawing: &Drawing) -> Result<Vec<u8>, PictureError> {
        match self.format {
            PictureFormat::Svg => Ok(drawing.to_svg(&self.style).into_bytes()),
            PictureFormat::Png => png(drawing, &self.style),
        }
    }
}

fn png(drawing: &Drawing, style: &Style) -> Result<Vec<u8>, PictureError> {
    let [width, height] = drawing.pixels(style);
    if width.saturating_mul(height) > MAX_PIXELS {
        return Err(PictureError::TooLarge { width, height });
    }
    let theme = if style.theme == Theme::Auto { Theme::Light } else { style.theme };
    let style = Style { theme, ..*style };
    let picture = drawing.placed_picture(&style);
    let svg = match &picture {
        // The page and the picture are painted first.
        Some(_) => drawing.without_picture().to_svg(&Style { background: Background::None, ..style }),
        None => drawing.to_svg(&style),
    };
    let failed = |error: String| PictureError::Render(error);
    let [width, height] = [width, height].map(|count| u32::try_from(count).unwrap_or(0));
    let mut pixels = Pixmap::new(width, height).ok_or_else(|| failed("it is empty".into()))?;
    if let Some(picture) = picture {
        paint(&picture, &style, &mut pixels).ok_or_else(|| failed("its picture is empty".into()))?;
    }
    raster::paint(&svg, &mut pixels).map_err(failed)?;
    pixels.encode_png().map_err(|error| failed(error.to_string()))
}

/// Paints the page and a picture on it, one rectangle of a colour for each cell. `None` for a picture without cells.
fn paint(placed: &PlacedPicture<'_>, style: &Style, pixels: &mut Pixmap) -> Option<()> {
    if let Some([red, green, blue]) = style.page() {
        pixels.fill(Color::from_rgba8(red, green, blue, u8::MAX));
    }
    let PlacedPicture { picture, corner, size } = placed;
    let [width, height] = picture.size.map(|count| u32::try_from(count).unwrap_or(0));
    let mut cells = Pixmap::new(width, height)?;
    for (pixel, grey) in cells.pixels_mut().iter_mut().zip(&picture.grey) {
        *pixel = ColorU8::from_rgba(*grey, *grey, *grey, u8::MAX).premultiply();
    }
    let scale = [size[0] / f64::from(width), size[1] / f64::from(height)].map(|scale| scale as f32);
    let place = Transform::from_row(scale[0], 0.0, 0.0, scale[1], corner[0] as f32, corner[1] as f32);
    pixels.draw_pixmap(0, 0, cells.as_ref(), &PixmapPaint::default(), place, None);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::drawing;
    use crate::geometry::drawing::colour;
    use crate::geometry::drawing::layer::Layer;
    use crate::geometry::drawing::layout;

    fn picture(title: &str, style: Style) -> Pixmap {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let corners: Vec<&[f64]> = square.iter().map(<[f64; 2]>::as_slice).collect();
        let layer = Layer::from_polyline(&corners, true, colour::MAIN);
        let drawing = layout::draw(title, vec![layer]);
        let file = PictureFile { format: PictureFormat::Png, style };
        let (bytes, again) = (file.write(&drawing).unwrap(), file.write(&drawing).unwrap());
        assert_eq!(bytes, again);
        let pixels = Pixmap::decode_png(&bytes).unwrap();
        assert_eq!(drawing.pixels(&style), [pixels.width(), pixels.height()].map(u64::from));
        pixels
    }

    /// Number of pixels of the upper left corner, where the title is, that are not of the page.
    fn ink(pixels: &Pixmap) -> usize {
        let page = pixels.pixel(0, 0).unwrap();
        let places = (0..28).flat_map(|y| (0..400).map(move |x| (x, y)));
        places.filter(|(x, y)| pixels.pixel(*x, *y) != Some(page)).count()
    }

    #[test]
    fn letters_are_drawn_and_unknown_ones_leave_a_mark() {
        for title in ["Müller", "λ ≤ −2 σ²", "Клетки", "細胞"] {
            assert!(ink(&picture(title, Style::default())) > 50, "{title}");
        }
        assert_eq!(ink(&picture("", Style::default())), 0);
    }

    #[test]
    fn themes_and_backgrounds_are_painted() {
        let corner = |theme, background| {
            let pixel = picture("", Style { theme, background, ..Style::default() }).pixel(1, 1).unwrap();
            [pixel.red(), pixel.green(), pixel.blue(), pixel.alpha()]
        };
        assert_eq!(corner(Theme::Auto, Background::Page), [255; 4]);
        assert_eq!(corner(Theme::Dark, Background::Page), [0x16, 0x18, 0x1d, 255]);
        assert_eq!(corner(Theme::Dark, Background::None), [0; 4]);
    }

    #[test]
    fn a_picture_is_painted_below_the_shapes() {
        let cells = GreyCells { size: [4, 2], grey: vec![0, 60, 120, 180, 200, 220, 240, 255] };
        let picture = cells.over([[-0.5, 0.5], [3.5, -1.5]]).unwrap();
        let line = Layer::from_polyline(&[&[0.0, 0.0], &[3.0, 0.0]], false, colour::AFTER);
        let drawing = drawing::picture::over("", picture, vec![line]);
        let style = Style { title: false, ..Style::default() };
        let svg = PictureFile { format: PictureFormat::Svg, style }.write(&drawing).unwrap();
        assert!(String::from_utf8(svg).unwrap().contains("href=\"data:image/png;base64,iVBOR"));
        let png = PictureFile { format: PictureFormat::Png, style }.write(&drawing).unwrap();
        let pixels = Pixmap::decode_png(&png).unwrap();
        // Cells have 144 pixels; the line runs through the middle of the upper row.
        let at = |x: u32, y: u32| pixels.pixel(x, y).map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]);
        assert_eq!([at(40, 40), at(600, 40), at(600, 300)], [Some([0; 3]), Some([180; 3]), Some([255; 3])]);
        assert_eq!((at(300, 92), at(5, 5)), (Some([0xff, 0x88, 0x33]), Some([255; 3])));
    }

    #[test]
    fn sizes_are_checked_before_memory_is_taken() {
        let cells = (0..3000).map(|i| (i.to_string(), Vec::new())).collect();
        let drawing = layout::grid("", cells);
        let style = Style { width: 4096, ..Style::default() };
        let file = PictureFile { format: PictureFormat::Png, style };
        assert!(matches!(file.write(&drawing), Err(PictureError::TooLarge { width: 4096, .. })));
    }
}
