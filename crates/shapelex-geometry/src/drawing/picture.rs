//! Shapes over a picture of grey cells.

use super::layer::Layer;
use super::layout::Bounds;
use super::legend::Entry;
use super::scene::{Drawing, Element, Map};
use super::svg::Style;

/// A picture in the plane of the shapes, whose second axis points up.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Number of cells along the rows, and number of rows.
    pub size: [usize; 2],
    /// Grey values of the cells, row by row from the top.
    pub grey: Vec<u8>,
    /// Address of a file of the same picture, such as `data:image/png;base64,…`, for SVG.
    pub address: String,
    /// Upper left and lower right corner in the plane.
    pub corners: [[f64; 2]; 2],
}

/// Draws `layers`, back to front, over a picture, with a legend of those with a name.
pub fn over(title: &str, picture: Picture, layers: Vec<Layer>) -> Drawing {
    let points = layers.iter().flat_map(|layer| layer.lines.iter().flatten());
    let (map, height) = Bounds::around(points.chain(&picture.corners)).fill();
    let legend = Entry::of(&layers);
    let elements = layers.into_iter().map(|layer| Element::Shapes(layer, map)).collect();
    Drawing { picture: Some((picture, map)), ..Drawing::new(title, height, elements) }.with_legend(&legend)
}

/// A picture and its place: the upper left corner and the size in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedPicture<'a> {
    /// The picture.
    pub picture: &'a Picture,
    /// Upper left corner.
    pub corner: [f64; 2],
    /// Width and height.
    pub size: [f64; 2],
}

/// Upper left corner and size of a picture on the page.
pub(super) fn on_page((picture, map): &(Picture, Map)) -> [[f64; 2]; 2] {
    let [corner, end] = picture.corners.map(|corner| map.place(&corner));
    [corner, [end[0] - corner[0], end[1] - corner[1]]]
}

impl Drawing {
    /// The picture behind the shapes, placed for a viewer.
    pub fn placed_picture(&self, style: &Style) -> Option<PlacedPicture<'_>> {
        let placed = self.picture.as_ref()?;
        let [[x, y], size] = on_page(placed);
        let [scale, above] = style.scale_and_top();
        let corner = [scale * x, scale * (y + above)];
        Some(PlacedPicture { picture: &placed.0, corner, size: size.map(|side| scale * side) })
    }

    /// The same drawing without the picture behind the shapes.
    #[must_use]
    pub fn without_picture(&self) -> Self {
        Self {
            picture: None,
            title: self.title.clone(),
            elements: self.elements.clone(),
            legend: self.legend.clone(),
            scale: self.scale.clone(),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::colour;
    use crate::drawing::layer::Mark;

    fn drawing() -> Drawing {
        let picture = Picture {
            size: [4, 2],
            grey: vec![0, 50, 100, 150, 200, 250, 255, 255],
            address: "data:image/png;base64,AAAA".into(),
            corners: [[-0.5, 0.5], [3.5, -1.5]],
        };
        let line =
            Layer::from_points(vec![[0.0, 0.0], [3.0, 0.0], [3.0, -1.0]], Mark::Closed, colour::MAIN, 1.0);
        over("cells", picture, vec![line.named("result")])
    }

    #[test]
    fn a_picture_lies_behind_the_shapes_and_fills_the_width() {
        let svg = drawing().to_svg(&Style::default());
        let image = "<image x=\"32\" y=\"12\" width=\"576\" height=\"288\" preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" href=\"data:image/png;base64,AAAA\"/>";
        assert!(svg.find(image).unwrap() < svg.find("<path").unwrap(), "{svg}");
        let style = Style { width: 320, title: false, ..Style::default() };
        let drawing = drawing();
        let placed = drawing.placed_picture(&style).unwrap();
        assert_eq!((placed.corner, placed.size), ([16.0, 10.0], [288.0, 144.0]));
        assert!(!drawing.without_picture().to_svg(&style).contains("<image"));
    }
}
