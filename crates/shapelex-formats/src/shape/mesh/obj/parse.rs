//! Statements of an OBJ file, and the shapes they make.

use super::super::super::limits::Limits;
use super::super::super::record::Sink;
use super::super::super::record::{Domain, Faces, Points};
use super::super::super::text::name_fits;
use super::super::draft::Draft;
use super::super::scan::{count, number, shown, text, words, wrong};
use super::super::{COLOURS, NORMALS, TEXTURE, TEXTURE_OF_CORNERS};
use super::NORMALS_OF_CORNERS;
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// No index.
const NONE: u32 = u32::MAX;

/// Positions of vertex, texture coordinates and normal of a corner, or [`NONE`].
type Corner = [u32; 3];

/// A polygon or line.
struct Face {
    corners: Vec<Corner>,
    object: usize,
    group: u32,
    material: u32,
    line: u64,
}

struct Object {
    name: Option<String>,
    place: Place,
}

/// Content read so far.
pub(super) struct File {
    limits: Limits,
    vertices: Points,
    /// Object in which a vertex is declared.
    owners: Vec<usize>,
    colours: Vec<[f64; 4]>,
    texture: Vec<[f64; 2]>,
    normals: Vec<[f64; 3]>,
    faces: Vec<Face>,
    lines: Vec<Face>,
    objects: Vec<Object>,
    groups: Names,
    materials: Names,
    summary: Summary,
}

/// Names in the order in which they come, and the one that holds now.
#[derive(Default)]
struct Names {
    known: std::collections::HashMap<String, u32>,
    list: Vec<String>,
    now: u32,
}

impl Names {
    fn set(&mut self, name: &str) {
        let next = self.list.len() as u32;
        self.now = *self.known.entry(name.to_owned()).or_insert_with(|| {
            self.list.push(name.to_owned());
            next
        });
    }

    /// The name without a statement.
    fn new() -> Self {
        let mut names = Self::default();
        names.set("");
        names
    }
}

impl File {
    pub(super) fn new(limits: Limits) -> Self {
        Self {
            limits,
            vertices: Points::new(3),
            owners: Vec::new(),
            colours: Vec::new(),
            texture: Vec::new(),
            normals: Vec::new(),
            faces: Vec::new(),
            lines: Vec::new(),
            objects: vec![Object { name: None, place: Place::line(1) }],
            groups: Names::new(),
            materials: Names::new(),
            summary: Summary::default(),
        }
    }

    /// Takes a statement.
    pub(super) fn line(&mut self, line: &[u8], place: &Place) -> Result<(), FileError> {
        let line = line.split(|byte| *byte == b'#').next().unwrap_or_default();
        let mut rest = words(line);
        let Some(keyword) = rest.next() else { return Ok(()) };
        let name = || text(&line.trim_ascii_start()[keyword.len()..], || place.clone());
        let repeated = || name().and_then(|name| fitting(name, place));
        match keyword {
            b"v" => self.vertex(&numbers(rest, place)?, place)?,
            b"vt" => match numbers(rest, place)?[..] {
                [u] => self.texture.push([u, 0.0]),
                [u, v, ref rest @ ..] if rest.len() < 2 => {
                    self.texture.push([u, v]);
                    if rest.iter().any(|w| *w != 0.0) {
                        self.summary.drop("third texture coordinates", None, || place.clone());
                    }
                }
                ref other => return Err(expected("1 to 3 texture coordinates", other.len(), place)),
            },
            b"vn" => match numbers(rest, place)?[..] {
                [x, y, z] => self.normals.push([x, y, z]),
                ref other => return Err(expected("3 coordinates of a normal", other.len(), place)),
            },
            b"f" | b"fo" => self.face(rest, place)?,
            b"l" => {
                let corners = self.corners(rest, place)?;
                let line = self.polygon(corners, place);
                self.lines.push(line);
            }
            b"o" => {
                let name = Some(repeated()?).filter(|name| !name.is_empty()).map(str::to_owned);
                self.objects.push(Object { name, place: place.clone() });
            }
            b"g" => self.groups.set(repeated()?),
            b"usemtl" => self.materials.set(repeated()?),
            b"p" => self.summary.drop("point elements", None, || place.clone()),
            b"s" => self.summary.drop("smoothing groups", None, || place.clone()),
            b"mtllib" => self.summary.drop("references to other files", Some(name()?), || place.clone()),
            b"vp" | b"cstype" | b"deg" | b"bmat" | b"step" | b"curv" | b"curv2" | b"surf" | b"parm"
            | b"trim" | b"hole" | b"scrv" | b"sp" | b"end" | b"con" => {
                self.summary.drop("statements of free-form curves and surfaces", None, || place.clone());
            }
            b"mg" | b"bevel" | b"c_interp" | b"d_interp" | b"lod" | b"usemap" | b"maplib" | b"shadow_obj"
            | b"trace_obj" | b"ctech" | b"stech" | b"call" | b"csh" => {
                self.summary.drop("statements of display", None, || place.clone());
            }
            other => return Err(wrong(other, "a statement of OBJ", place.clone())),
        }
        Ok(())
    }

    fn vertex(&mut self, values: &[f64], place: &Place) -> Result<(), FileError> {
        const UNKNOWN: f64 = f64::NAN;
        let colour = match *values {
            [_, _, _] | [_, _, _, _] => [UNKNOWN; 4],
            [_, _, _, r, g, b] => [r, g, b, UNKNOWN],
            [_, _, _, r, g, b, a] => [r, g, b, a],
            _ => {
                return Err(expected("3 coordinates of a vertex, a weight or a colour", values.len(), place));
            }
        };
        if let [_, _, _, weight] = values
            && *weight != 1.0
        {
            self.summary.drop("weights of vertices", None, || place.clone());
        }
        self.limits.points(self.vertices.len() as u64 + 1, || place.clone())?;
        if let Some(x) = values[..3].iter().find(|x| !x.is_finite()) {
            let detail = format!("expected finite coordinates, got {x}");
            return Err(FileError::malformed(place.clone(), detail));
        }
        self.vertices.push(&values[..3]);
        self.colours.push(colour);
        self.owners.push(self.objects.len() - 1);
        Ok(())
    }

    fn face<'w>(&mut self, rest: impl Iterator<Item = &'w [u8]>, place: &Place) -> Result<(), FileError> {
        self.limits.faces(self.faces.len() as u64 + 1, || place.clone())?;
        let corners = self.corners(rest, place)?;
        let face = self.polygon(corners, place);
        self.faces.push(face);
        Ok(())
    }

    fn polygon(&self, corners: Vec<Corner>, place: &Place) -> Face {
        Face {
            corners,
            object: self.objects.len() - 1,
            group: self.groups.now,
            material: self.materials.now,
            line: place.line.unwrap_or_default(),
        }
    }

    fn corners<'w>(
        &self,
        rest: impl Iterator<Item = &'w [u8]>,
        place: &Place,
    ) -> Result<Vec<Corner>, FileError> {
        let counts = [self.vertices.len(), self.texture.len(), self.normals.len()];
        let corner = |word: &[u8]| {
            let mut corner = [NONE; 3];
            let mut parts = word.split(|byte| *byte == b'/');
            for (k, count) in counts.into_iter().enumerate() {
                match parts.next() {
                    Some(part) if k == 0 || !part.is_empty() => corner[k] = position(part, count, place)?,
                    _ => {}
                }
            }
            match parts.next() {
                Some(_) => Err(wrong(word, "vertex/texture/normal", place.clone())),
                None => Ok(corner),
            }
        };
        rest.map(corner).collect()
    }

    /// Gives on all shapes.
    pub(super) fn send(mut self, sink: Sink<'_>) -> Result<Summary, FileError> {
        self.check_corners()?;
        self.drop_unused();
        let mut faces: Vec<Vec<usize>> = vec![Vec::new(); self.objects.len()];
        let mut lines = faces.clone();
        self.faces.iter().enumerate().for_each(|(k, face)| faces[face.object].push(k));
        self.lines.iter().enumerate().for_each(|(k, line)| lines[line.object].push(k));
        let has_corners = |all: &[Face], own: &[usize]| own.iter().any(|k| !all[*k].corners.is_empty());
        let is_drawn: Vec<bool> = (faces.iter().zip(&lines))
            .map(|(faces, lines)| has_corners(&self.faces, faces) || has_corners(&self.lines, lines))
            .collect();
        let only_points = !is_drawn.contains(&true);
        let mut own = self.unused();
        let (single, is_bare) = self.roles(&is_drawn, &own);
        let mut summary = std::mem::take(&mut self.summary);
        for k in 0..self.objects.len() {
            let vertices = if single == Some(k) {
                let owners = (0..).zip(&self.owners).filter(|(_, owner)| !is_bare[**owner]);
                owners.map(|(vertex, _)| vertex).collect()
            } else if is_drawn[k] {
                let all = faces[k].iter().map(|k| &self.faces[*k]);
                let all = all.chain(lines[k].iter().map(|k| &self.lines[*k]));
                let mut vertices = std::mem::take(&mut own[k]);
                vertices.extend(all.flat_map(|face| face.corners.iter().map(|corner| corner[0])));
                vertices.sort_unstable();
                vertices.dedup();
                vertices
            } else if is_bare[k] && only_points {
                std::mem::take(&mut own[k])
            } else {
                let Object { name, place } = &self.objects[k];
                let (name, place) = (name.as_deref(), || place.clone());
                if is_bare[k] {
                    summary.drop("objects of vertices only, beside faces or lines", name, place);
                } else if single.is_none() && !own[k].is_empty() {
                    summary.drop_many("vertices of no face", own[k].len() as u64, None, place);
                } else if name.is_some() {
                    summary.drop("objects without a shape", name, place);
                }
                continue;
            };
            self.draft(k, &faces[k], &lines[k], vertices, &mut summary).send(&mut summary, sink)?;
        }
        Ok(summary)
    }

    /// The object whose shape has all vertices but those of bare objects, if there is such an object; and which objects are bare:
    /// they only have vertices, which no other object uses. They are shapes in files without faces and lines. Vertices before the
    /// first `o` are never bare: some programs write the vertices of all objects there.
    fn roles(&self, is_drawn: &[bool], own: &[Vec<u32>]) -> (Option<usize>, Vec<bool>) {
        let mut declared = vec![0; self.objects.len()];
        self.owners.iter().for_each(|owner| declared[*owner] += 1);
        let bare = |k: usize| k > 0 && !is_drawn[k] && declared[k] > 0 && own[k].len() == declared[k];
        let is_bare: Vec<bool> = (0..self.objects.len()).map(bare).collect();
        let drawn = (0..).zip(is_drawn).filter(|(_, drawn)| **drawn).map(|(k, _)| k).collect::<Vec<usize>>();
        let count = is_bare.iter().filter(|bare| **bare).count();
        match drawn[..] {
            [object] => (Some(object), is_bare),
            [] if count < 2 || declared[0] > 0 => {
                let named = is_bare.iter().rposition(|bare| *bare);
                (Some(named.unwrap_or(self.objects.len() - 1)), vec![false; self.objects.len()])
            }
            _ => (None, is_bare),
        }
    }

    /// Counts texture coordinates and normals that no face uses.
    fn drop_unused(&mut self) {
        let mut is_used = [self.texture.len(), self.normals.len()].map(|count| vec![false; count]);
        for corner in self.faces.iter().flat_map(|face| &face.corners) {
            for (used, index) in is_used.iter_mut().zip(&corner[1..]).filter(|(_, index)| **index != NONE) {
                used[*index as usize] = true;
            }
        }
        for (what, used) in ["texture coordinates of no face", "normals of no face"].into_iter().zip(&is_used)
        {
            let count = used.iter().filter(|used| !**used).count();
            if count > 0 {
                self.summary.drop_many(what, count as u64, None, Place::default);
            }
        }
    }

    /// Indices may come before their targets, so they are checked at the end. Some programs write those of texture
    /// coordinates and normals that they leave out.
    fn check_corners(&mut self) -> Result<(), FileError> {
        let counts = [self.vertices.len(), self.texture.len(), self.normals.len()];
        let absent = ["", "texture coordinates that are not in the file", "normals that are not in the file"];
        for face in self.faces.iter_mut().chain(&mut self.lines) {
            for (k, index) in face.corners.iter_mut().flat_map(|corner| corner.iter_mut().enumerate()) {
                if *index == NONE || (*index as usize) < counts[k] {
                    continue;
                }
                if k > 0 {
                    self.summary.drop(absent[k], None, || Place::line(face.line));
                    *index = NONE;
                    continue;
                }
                let (count, index) = (counts[0], u64::from(*index) + 1);
                let detail = format!("expected indices of vertices up to {count}, got {index}");
                return Err(FileError::malformed(Place::line(face.line), detail));
            }
        }
        Ok(())
    }

    /// Vertices that no face uses, by the object that declares them.
    fn unused(&self) -> Vec<Vec<u32>> {
        let mut used = vec![false; self.vertices.len()];
        for corner in self.faces.iter().chain(&self.lines).flat_map(|face| &face.corners) {
            used[corner[0] as usize] = true;
        }
        let mut own = vec![Vec::new(); self.objects.len()];
        for (vertex, owner) in (0..).zip(&self.owners).filter(|(vertex, _)| !used[*vertex as usize]) {
            own[*owner].push(vertex);
        }
        own
    }

    /// The shape of some of the faces, lines and vertices; the vertices are sorted.
    fn draft(
        &self,
        object: usize,
        faces: &[usize],
        lines: &[usize],
        vertices: Vec<u32>,
        summary: &mut Summary,
    ) -> Draft {
        let Object { name, place } = &self.objects[object];
        let mut draft = Draft::new(place.clone());
        draft.name.clone_from(name);
        for vertex in &vertices {
            let at = 3 * *vertex as usize;
            draft.vertices.push(&self.vertices.coordinates()[at..at + 3]);
        }
        // `vertices` holds all of them: the position is found.
        let local = |vertex: u32| vertices.binary_search(&vertex).unwrap_or_default() as u32;
        let faces: Vec<&Face> = faces.iter().map(|k| &self.faces[*k]).collect();
        let mut polygons = Faces::default();
        for face in &faces {
            polygons.push(face.corners.iter().map(|corner| local(corner[0])));
        }
        draft.faces = polygons;
        for line in lines.iter().map(|k| &self.lines[*k]) {
            draft.lines.push(line.corners.iter().map(|corner| local(corner[0])).collect());
        }
        self.colours(&vertices, &mut draft);
        let texture = Attribute {
            at: 1,
            names: [TEXTURE, TEXTURE_OF_CORNERS],
            values: self.texture.as_flattened(),
            width: 2,
        };
        let normals = Attribute {
            at: 2,
            names: [NORMALS, NORMALS_OF_CORNERS],
            values: self.normals.as_flattened(),
            width: 3,
        };
        for attribute in [texture, normals] {
            attribute.add(&faces, vertices.len(), &local, &mut draft, summary);
        }
        names_of(&faces, "groups", "group", &self.groups, |face| face.group, &mut draft);
        names_of(&faces, "materials", "material", &self.materials, |face| face.material, &mut draft);
        draft
    }

    fn colours(&self, vertices: &[u32], draft: &mut Draft) {
        let all = || vertices.iter().map(|vertex| &self.colours[*vertex as usize]);
        // A colour that is not a number is one: it tells how many components there are.
        let width = match () {
            () if all().any(|colour| !colour[3].is_nan()) => 4,
            () if all().any(|colour| !colour[0].is_nan()) => 3,
            () => return,
        };
        let values = all().flat_map(|colour| &colour[..width]).copied().collect();
        draft.field(COLOURS, Domain::Vertices, width, values);
    }
}

/// Values at corners.
struct Attribute<'a> {
    /// Position of its index in a corner.
    at: usize,
    /// Names of the field of vertices and of that of corners.
    names: [&'static str; 2],
    values: &'a [f64],
    width: usize,
}

impl Attribute<'_> {
    /// Adds them as a field of vertices or of faces.
    fn add(
        &self,
        faces: &[&Face],
        count: usize,
        local: &dyn Fn(u32) -> u32,
        draft: &mut Draft,
        summary: &mut Summary,
    ) {
        let value = |corner: &Corner| {
            let start = corner[self.at] as usize * self.width;
            (corner[self.at] != NONE).then(|| &self.values[start..start + self.width])
        };
        let corners = || faces.iter().flat_map(|face| &face.corners);
        if corners().all(|corner| value(corner).is_none()) {
            return;
        }
        let mut values = vec![f64::NAN; count * self.width];
        let mut known = vec![false; count];
        let mut agree = true;
        for corner in corners() {
            let vertex = local(corner[0]) as usize;
            let own = &mut values[vertex * self.width..(vertex + 1) * self.width];
            match value(corner) {
                Some(value) if !known[vertex] => own.copy_from_slice(value),
                Some(value) => agree &= *own == *value,
                None => agree &= !known[vertex],
            }
            known[vertex] |= value(corner).is_some();
        }
        if agree {
            draft.field(self.names[0], Domain::Vertices, self.width, values);
            return;
        }
        let size = faces.first().map_or(0, |face| face.corners.len());
        if faces.iter().any(|face| face.corners.len() != size) {
            summary.drop("fields of corners of faces of several sizes", Some(self.names[1]), || {
                Place::line(faces[0].line)
            });
            return;
        }
        let missing = vec![f64::NAN; self.width];
        let values = corners().flat_map(|corner| value(corner).unwrap_or(&missing).to_vec()).collect();
        draft.field(self.names[1], Domain::Faces, size * self.width, values);
    }
}

/// Adds the groups or materials of faces, by their position in a list of the metadata.
fn names_of(
    faces: &[&Face],
    list: &str,
    field: &str,
    names: &Names,
    of: impl Fn(&Face) -> u32,
    draft: &mut Draft,
) {
    let mut local = std::collections::HashMap::new();
    let mut used = Vec::new();
    let mut values = Vec::new();
    for face in faces {
        let next = used.len();
        let at = *local.entry(of(face)).or_insert_with(|| {
            used.push(names.list[of(face) as usize].clone());
            next
        });
        values.push(at as f64);
    }
    if used.iter().all(String::is_empty) {
        return;
    }
    if used.len() > 1 {
        draft.field(field, Domain::Faces, 1, values);
    }
    draft.metadata.insert(list.into(), used.into());
}

fn numbers<'w>(rest: impl Iterator<Item = &'w [u8]>, place: &Place) -> Result<Vec<f64>, FileError> {
    rest.map(|word| number(word, "a number", || place.clone())).collect()
}

/// An index from 1, or from -1 backwards, as a position from 0.
fn position(word: &[u8], count_so_far: usize, place: &Place) -> Result<u32, FileError> {
    let fault = || {
        let detail = format!("expected an index from 1, or from -1 to -{count_so_far}, got {}", shown(word));
        FileError::malformed(place.clone(), detail)
    };
    let back = word.strip_prefix(b"-");
    let index = count(back.unwrap_or(word), "an index", || place.clone()).map_err(|_| fault())?;
    let position = match back {
        Some(_) => (count_so_far as u64).checked_sub(index).filter(|_| index > 0),
        None => index.checked_sub(1),
    };
    position.and_then(|at| u32::try_from(at).ok()).filter(|at| *at != NONE).ok_or_else(fault)
}

/// A name that many shapes may have, if it is not too long.
fn fitting<'n>(name: &'n str, place: &Place) -> Result<&'n str, FileError> {
    name_fits(name).map(|()| name).map_err(|detail| FileError::malformed(place.clone(), detail))
}

fn expected(what: &str, count: usize, place: &Place) -> FileError {
    FileError::malformed(place.clone(), format!("expected {what}, got {count} numbers"))
}
