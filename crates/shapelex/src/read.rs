//! Shapes in files of other programs.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use shapelex_formats::shape::{Geometry, Limits, ReadOptions, Record, Source, detect, read};

use crate::error::{Error, Result};
use crate::points::Points;
use crate::shapes::{Contours, Landmarks, Shapes, Surfaces};

/// The records of a file, each with its position.
fn records(name: &str, content: impl Read) -> Result<Vec<Record>> {
    let mut source = Source::new(content, Limits::default())?;
    let format = detect(source.head(), Some(name))?;
    let mut records = Vec::new();
    read(format, &mut source, &ReadOptions::default(), &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok(records)
}

fn opened(path: &Path) -> Result<(String, File)> {
    let name = path.display().to_string();
    match File::open(path) {
        Ok(file) => Ok((name, file)),
        Err(source) => Err(Error::Open { path: name, source }),
    }
}

/// The points of a record, of which none may be missing.
fn points_of(index: usize, points: &shapelex_formats::shape::Points) -> Result<Points> {
    match points.missing().first() {
        None => Ok(Points::from_flat(points.dimension(), points.coordinates().to_vec())),
        Some(at) => {
            let detail = format!("point {at}: expected a number for each coordinate, got a missing point");
            Err(Error::Shape { index, detail })
        }
    }
}

fn other(index: usize, expected: &str, found: &Geometry) -> Error {
    let got = match found {
        Geometry::Curve { closed: true, .. } => "a closed contour",
        Geometry::Curve { closed: false, .. } => "an open curve",
        Geometry::Landmarks(_) => "landmarks",
        Geometry::Mesh(_) => "a mesh",
        Geometry::Fourier(_) => "Fourier coefficients",
    };
    Error::Shape { index, detail: format!("expected {expected}, got {got}") }
}

/// The shapes with the names and labels of their records.
fn named<K>(mut shapes: Shapes<K>, records: Vec<Record>) -> Shapes<K> {
    (shapes.set.names, shapes.set.labels) =
        records.into_iter().map(|record| (record.name.or(record.id), record.label)).unzip();
    shapes
}

impl Contours {
    /// The contours of a file of any format that holds some: GeoJSON, CSV, lines of JSON, ROIs of ImageJ, COCO, structure sets and
    /// others. Names and labels come with them.
    ///
    /// # Errors
    /// [`Error::Open`]; [`Error::File`] with the place of the fault; [`Error::Shape`] for shapes that are not contours, or are neither
    /// all closed nor all open.
    ///
    /// ```
    /// use shapelex::{Class, Contours};
    ///
    /// let folder = tempfile::tempdir().expect("a folder");
    /// let path = folder.path().join("cells.geojson");
    /// let square = |x: f64| format!(r#"{{"type": "Feature", "id": "cell-{x}", "properties": {{}},
    ///     "geometry": {{"type": "Polygon", "coordinates": [[[{x}, 0], [{x}, 3], [5, 3], [5, 0], [{x}, 0]]]}}}}"#);
    /// let features: Vec<String> = [0.0, 1.0, 2.0].map(square).into();
    /// std::fs::write(&path, format!(r#"{{"type": "FeatureCollection", "features": [{}]}}"#, features.join(","))).expect("a file");
    ///
    /// let cells = Contours::read(&path)?.resample(16);
    /// assert_eq!(cells.names()[1].as_deref(), Some("cell-1"));
    /// assert_eq!(cells.mean(Class::Affine)?.shapes, 3);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let (name, file) = opened(path.as_ref())?;
        Self::read_from(&name, file)
    }

    /// As [`Self::read`] from anything that gives bytes; the name tells the format where the bytes do not.
    ///
    /// # Errors
    /// As for [`Self::read`].
    ///
    /// ```
    /// let lines = br#"{"points": [[0, 0], [2, 0], [1, 1]], "closed": true}"#;
    /// assert_eq!(shapelex::Contours::read_from("one.ndjson", &lines[..])?.len(), 1);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn read_from(name: &str, content: impl Read) -> Result<Self> {
        let records = records(name, content)?;
        let (mut shapes, mut all_closed) = (Vec::new(), None);
        for (index, record) in records.iter().enumerate() {
            let Geometry::Curve { points, closed } = &record.geometry else {
                return Err(other(index, "a contour", &record.geometry));
            };
            if all_closed.is_some_and(|known| known != *closed) {
                let expected = if *closed {
                    "an open curve, as those before"
                } else {
                    "a closed contour, as those before"
                };
                return Err(other(index, expected, &record.geometry));
            }
            all_closed = Some(*closed);
            shapes.push(points_of(index, points)?);
        }
        Ok(named(Self::from_points(shapes, all_closed.unwrap_or(true))?, records))
    }
}

impl Landmarks {
    /// The landmarks of a file of any format that holds some: TPS, NTS, Morphologika, markups of 3D Slicer, tables and others.
    ///
    /// # Errors
    /// As for [`Contours::read`]; [`Error::Shape`] for missing points.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let (name, file) = opened(path.as_ref())?;
        Self::read_from(&name, file)
    }

    /// As [`Self::read`] from anything that gives bytes.
    ///
    /// # Errors
    /// As for [`Self::read`].
    ///
    #[cfg_attr(feature = "morphometrics", doc = "```")]
    #[cfg_attr(not(feature = "morphometrics"), doc = "```ignore")]
    /// let file = "LM=3\n0 0\n1 0\n0 1\nID=a\nLM=3\n0 0\n2 0\n0 1\nID=b\n";
    /// let landmarks = shapelex::Landmarks::read_from("two.tps", file.as_bytes())?;
    /// assert_eq!((landmarks.len(), landmarks.names()[1].as_deref()), (2, Some("b")));
    /// let missing = file.replace("2 0", "NA NA");
    /// let refused = shapelex::Landmarks::read_from("two.tps", missing.as_bytes());
    /// assert!(refused.is_err());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn read_from(name: &str, content: impl Read) -> Result<Self> {
        let records = records(name, content)?;
        let points = |(index, record): (usize, &Record)| match &record.geometry {
            Geometry::Landmarks(points) => points_of(index, points),
            found => Err(other(index, "landmarks", found)),
        };
        let shapes: Vec<Points> = records.iter().enumerate().map(points).collect::<Result<_>>()?;
        Ok(named(Self::from_points(shapes)?, records))
    }
}

impl Surfaces {
    /// The meshes of files that share their triangles, one for each path: PLY, OBJ, STL, VTK, GIFTI, glTF and others.
    ///
    /// # Errors
    /// As for [`Contours::read`]; [`Error::Shape`] for faces that are not those of the first mesh.
    ///
    #[cfg_attr(feature = "meshes", doc = "```")]
    #[cfg_attr(not(feature = "meshes"), doc = "```ignore")]
    /// let folder = tempfile::tempdir().expect("a folder");
    /// let paths: Vec<_> = (1..5).map(|k| {
    ///     let path = folder.path().join(format!("{k}.obj"));
    ///     let vertices = format!("v 0 0 0\nv {k} 0 0\nv 0 1 0\nv 0 0 1\n");
    ///     std::fs::write(&path, vertices + "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n").expect("a file");
    ///     path
    /// }).collect();
    /// let surfaces = shapelex::Surfaces::read(&paths)?;
    /// assert_eq!(surfaces.mean(shapelex::Class::Rigid)?.shapes, 4);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn read<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Result<Self> {
        let mut all = Vec::new();
        for path in paths {
            let (name, file) = opened(path.as_ref())?;
            let stem = path.as_ref().file_stem().map(|stem| stem.to_string_lossy().into_owned());
            all.extend(
                records(&name, file)?
                    .into_iter()
                    .map(|record| Record { name: record.name.clone().or(stem.clone()), ..record }),
            );
        }
        let (mut faces, mut shapes) = (Vec::new(), Vec::new());
        for (index, record) in all.iter().enumerate() {
            let Geometry::Mesh(mesh) = &record.geometry else {
                return Err(other(index, "a mesh", &record.geometry));
            };
            let own: Vec<[u32; 3]> = mesh.faces.triangles().collect();
            if index == 0 {
                faces = own;
            } else if own != faces {
                let detail = "expected the faces of the first mesh, got others: meshes without corresponding vertices take the \
                              job correspond of the service";
                return Err(Error::Shape { index, detail: detail.into() });
            }
            let points = points_of(index, &mesh.vertices)?;
            let Some(vertices) = points.to_arrays::<3>() else {
                return Err(Error::Shape { index, detail: "expected points in space".into() });
            };
            shapes.push(vertices);
        }
        Ok(named(Self::meshes(&faces, shapes)?, all))
    }
}
