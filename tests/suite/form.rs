//! Forms as clients send them, written byte by byte so that broken ones can be sent too.

use reqwest::Method;
use reqwest::header::CONTENT_TYPE;
use serde_json::Value;
use shapelex_formats::image::write::{nifti_f32, png_u8};
use shapelex_formats::image::{Grid, LengthUnit};

use crate::server::{Reply, Server};

/// Boundary of all forms.
pub(crate) const BOUNDARY: &str = "shapelex-form";

/// Bytes of a form: names, media types and contents of its parts.
pub(crate) fn form(parts: &[(&str, &str, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (name, media_type, content) in parts {
        let head = format!(
            "--{BOUNDARY}\r\ncontent-disposition: form-data; name=\"{name}\"; filename=\"{name}\"\r\n\
             content-type: {media_type}\r\n\r\n"
        );
        bytes.extend(head.bytes());
        bytes.extend_from_slice(content);
        bytes.extend(b"\r\n");
    }
    bytes.extend(format!("--{BOUNDARY}--\r\n").bytes());
    bytes
}

/// A picture of 40 × 24 cells: a disc with the label 3 and a hole, and two squares with the label 7 that meet at a corner.
pub(crate) fn label_picture() -> Vec<u8> {
    let value = |x: i64, y: i64| {
        let squared = (x - 12).pow(2) + (y - 12).pow(2);
        let lower = (26..30).contains(&x) && (4..8).contains(&y);
        let upper = (30..34).contains(&x) && (8..12).contains(&y);
        match squared {
            _ if lower || upper => 7,
            9..=81 => 3,
            _ => 0,
        }
    };
    let values: Vec<u8> = (0..24).flat_map(|y| (0..40).map(move |x| value(x, y))).collect();
    let grid = Grid::along_axes([40, 24, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
    png_u8(&grid, &values).unwrap()
}

/// A volume of 20 × 18 × 16 cells of 1 mm with a bright shell, about two cells thick, of radius 6 around (10, 9, 8).
pub(crate) fn shell_volume() -> Vec<u8> {
    let size = [20, 18, 16];
    let value = |at: usize| {
        let cell = [at % size[0], at / size[0] % size[1], at / size[0] / size[1]].map(|index| index as f32);
        let radius = ((cell[0] - 10.0).powi(2) + (cell[1] - 9.0).powi(2) + (cell[2] - 8.0).powi(2)).sqrt();
        if (radius - 6.0).abs() <= 1.0 { 100.0 } else { 20.0 }
    };
    let grid = Grid::along_axes(size, [1.0; 3], [LengthUnit::Millimetre; 3]).unwrap();
    nifti_f32(&grid, &(0..grid.cells()).map(value).collect::<Vec<_>>()).unwrap()
}

/// Sends the bytes of a form.
pub(crate) fn post_form(server: &Server, path: &str, bytes: Vec<u8>) -> Reply {
    let media_type = format!("multipart/form-data; boundary={BOUNDARY}");
    server.send(server.request(Method::POST, path).header(CONTENT_TYPE, media_type).body(bytes))
}

/// Sends parameters and an image.
pub(crate) fn post_image(server: &Server, path: &str, parameters: &Value, image: &[u8]) -> Reply {
    let parameters = parameters.to_string();
    let parts: [(&str, &str, &[u8]); 2] =
        [("parameters", "application/json", parameters.as_bytes()), ("image", "image/png", image)];
    post_form(server, path, form(&parts))
}
