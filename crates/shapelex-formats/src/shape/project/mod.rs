//! Projects of ShapeWorks: a table of subjects that names the files of their shapes, as JSON (`.swproj`) or as a workbook (`.xlsx`).
//!
//! ```text
//! {"data": [{"name": "m01", "shape_1": "meshes/m01.ply", "local_particles_1": "particles/m01_local.particles", "group_sex": "f"}, …], …}
//! ```
//!
//! | column | |
//! |---|---|
//! | `name` | name of the subject; without it that of the file |
//! | `local_particles_D`, `world_particles_D`, `groomed_D`, `shape_D`, `landmarks_file_D` | file of the domain `D`: its points in the frame of the shape or in the common one, its prepared surface, its surface or segmentation, its landmarks |
//! | `group_G` | group |
//! | `excluded` | whether the subject is left out |
//! | all others but files and transformations | attributes |
//!
//! A project holds no shapes: it is read in an archive that has the files too, by [`archive`](super::archive). [`pack_project`] makes one.

mod pack;
mod sheet;
mod workbook;

use std::collections::BTreeMap;

use super::error::{FaultKind, FileError, Place};
use super::format::Format;
use super::options::{ProjectFiles, ReadOptions};
use super::record::{Kind, Record, Sink, Value};
use super::source::Source;
use super::summary::Summary;
use super::text::{self, shown};
use sheet::Row;

pub use pack::{named_files, pack_project};
pub(super) use sheet::Table;

/// Projects of ShapeWorks.
pub(super) static FORMAT: Format = Format {
    id: "swproj",
    name: "ShapeWorks project",
    media_types: &[
        "application/x-shapeworks-project+json",
        "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    ],
    extensions: &["swproj", "xlsx"],
    recognise: workbook::is_workbook,
    kinds: &[Kind::Landmarks, Kind::Mesh, Kind::Curve],
    options: &["files", "select"],
    read: Some(read),
    open: None,
};

/// Beginnings of columns with files, and what these are. `groomed_contour_` comes before `groomed_`.
const FILES: [(&str, ProjectFiles); 9] = [
    ("local_particles_", ProjectFiles::LocalParticles),
    ("world_particles_", ProjectFiles::WorldParticles),
    ("groomed_contour_", ProjectFiles::Groomed),
    ("groomed_", ProjectFiles::Groomed),
    ("shape_", ProjectFiles::Shape),
    ("mesh_", ProjectFiles::Shape),
    ("segmentation_", ProjectFiles::Shape),
    ("contour_", ProjectFiles::Shape),
    ("landmarks_file_", ProjectFiles::LandmarksFile),
];
/// Beginnings of columns with files that are no shapes.
const OTHER_FILES: [&str; 3] = ["constraints_", "image_", "feature_"];
const TRANSFORMATIONS: [&str; 3] = ["alignment_", "procrustes_", "transform_"];
const GROUP: &str = "group_";

/// What a column holds.
enum Column<'c> {
    Name,
    Excluded,
    /// Files of a domain.
    Files(ProjectFiles, &'c str),
    OtherFiles,
    Transformations,
    Group(&'c str),
    Attribute,
}

impl<'c> Column<'c> {
    fn of(name: &'c str) -> Self {
        let begins = |prefix: &&str| name.starts_with(*prefix);
        let files = FILES.iter().find_map(|(prefix, what)| Some((*what, name.strip_prefix(prefix)?)));
        match (name, files) {
            ("name", _) => Self::Name,
            ("excluded", _) => Self::Excluded,
            (_, Some((what, domain))) => Self::Files(what, domain),
            _ if OTHER_FILES.iter().any(begins) => Self::OtherFiles,
            _ if TRANSFORMATIONS.iter().any(begins) => Self::Transformations,
            _ => name.strip_prefix(GROUP).map_or(Self::Attribute, Self::Group),
        }
    }
}

fn read(source: &mut Source<'_>, options: &ReadOptions, _: Sink<'_>) -> Result<Summary, FileError> {
    let project = Project::new(&Table::read(source)?, options)?;
    let detail = format!(
        "expected a zip archive of the project and the {} files that it names, got the project alone",
        project.files.len()
    );
    Err(FileError::new(FaultKind::Unsupported, detail))
}

/// A file of one domain of a subject, and what the project says of it.
#[derive(Debug)]
pub(super) struct ProjectFile {
    /// Path from the folder of the project: names between `/`, after any `..`.
    pub(super) path: String,
    /// Where the project names it.
    pub(super) place: Place,
    name: Option<String>,
    subject: Option<String>,
    label: Option<String>,
    labels: BTreeMap<String, Value>,
    /// Name of the domain, where there are several.
    domain: Option<String>,
}

impl ProjectFile {
    /// The `n`-th shape of the file, from 0, with what the project says of it.
    pub(super) fn describe(&self, record: Record, n: u64) -> Record {
        let mut name = self.name.clone().or(record.name);
        if let (Some(name), Some(domain)) = (&mut name, &self.domain) {
            *name = format!("{name}/{domain}");
        }
        if let (Some(name), 1..) = (&mut name, n) {
            *name = format!("{name}/{}", n + 1);
        }
        let mut metadata = record.metadata;
        metadata.extend(self.domain.iter().map(|domain| ("domain".to_owned(), domain.as_str().into())));
        let mut labels = record.labels;
        labels.extend(self.labels.clone());
        Record {
            name,
            subject: self.subject.clone().or(record.subject),
            label: self.label.clone().or(record.label),
            labels,
            metadata,
            ..record
        }
    }
}

/// The files of a project that are read, subject after subject, in each by the names of the domains.
#[derive(Debug)]
pub(super) struct Project {
    pub(super) files: Vec<ProjectFile>,
    /// What is not read.
    pub(super) summary: Summary,
}

impl Project {
    pub(super) fn new(table: &Table, options: &ReadOptions) -> Result<Self, FileError> {
        let columns = table.columns();
        let wanted = wanted(&columns, options.files)?;
        let mut domains: Vec<(&str, &str)> =
            columns.iter().filter_map(|column| domain_of(column, wanted)).collect();
        domains.sort_unstable();
        let several = domains.len() > 1;
        let (chosen, others): (Vec<_>, Vec<_>) =
            domains.into_iter().partition(|(domain, _)| options.selects(domain));
        let mut project = Self { files: Vec::new(), summary: Summary::default() };
        for (domain, column) in others {
            project.summary.drop("domains that are not selected", Some(domain), || Place::tag(column));
        }
        project.leave_out(&columns, wanted);
        let groups: Vec<(&str, &str)> = columns.iter().filter_map(group_of).collect();
        for (item, row) in table.rows.iter().enumerate() {
            project.subject(item as u64, row, &chosen, &groups, several)?;
        }
        project.summary.set("project_files", serde_json::to_value(wanted).unwrap_or_default());
        Ok(project)
    }

    /// Counts the columns that nothing is made of.
    fn leave_out(&mut self, columns: &[&str], wanted: ProjectFiles) {
        for column in columns {
            let what = match Column::of(column) {
                Column::Files(what, _) if what != wanted => "columns of other files",
                Column::OtherFiles => "columns of other files",
                Column::Transformations => "columns of transformations",
                _ => continue,
            };
            self.summary.drop(what, Some(column), || Place::tag(*column));
        }
    }

    /// Adds the files of a subject.
    fn subject(
        &mut self,
        item: u64,
        row: &Row,
        domains: &[(&str, &str)],
        groups: &[(&str, &str)],
        several: bool,
    ) -> Result<(), FileError> {
        let value = |column: &str| row.get(column).map(|text| text.trim()).filter(|text| !text.is_empty());
        let name = value("name");
        if value("excluded").is_some_and(|text| matches!(text::value(text), Value::Bool(true)) || text == "1")
        {
            self.summary.drop("excluded subjects", name, || Place::item(item));
            return Ok(());
        }
        let (label, mut labels) = match groups {
            [(column, _)] => (value(column).map(str::to_owned), BTreeMap::new()),
            _ => {
                let group =
                    |(column, group): &(&str, &str)| Some(((*group).to_owned(), text::value(value(column)?)));
                (None, groups.iter().filter_map(group).collect())
            }
        };
        let attributes = row.keys().filter(|column| matches!(Column::of(column), Column::Attribute));
        labels.extend(attributes.filter_map(|column| Some((column.clone(), text::value(value(column)?)))));
        for (domain, column) in domains {
            let place = Place { tag: Some((*column).to_owned()), ..Place::item(item) };
            let Some(path) = value(column) else {
                self.summary.drop("subjects without such a file", name, || place);
                continue;
            };
            self.files.push(ProjectFile {
                path: relative(path).map_err(|detail| FileError::malformed(place.clone(), detail))?,
                place,
                name: name.map(str::to_owned),
                subject: name.filter(|_| several).map(str::to_owned),
                label: label.clone(),
                labels: labels.clone(),
                domain: several.then(|| (*domain).to_owned()),
            });
        }
        Ok(())
    }
}

/// Whether a table is that of a project: one of a workbook may hold anything, and must name files of shapes.
pub(super) fn is_project(table: &Table) -> bool {
    table.unpacked == 0
        || table.columns().into_iter().any(|column| matches!(Column::of(column), Column::Files(..)))
}

/// The domain of a column of such files, and the column.
fn domain_of<'c>(column: &&'c str, wanted: ProjectFiles) -> Option<(&'c str, &'c str)> {
    match Column::of(column) {
        Column::Files(what, domain) if what == wanted => Some((domain, column)),
        _ => None,
    }
}

/// A column of groups, and their name.
fn group_of<'c>(column: &&'c str) -> Option<(&'c str, &'c str)> {
    match Column::of(column) {
        Column::Group(group) => Some((column, group)),
        _ => None,
    }
}

/// The files that are asked for, else the particles that the project has.
fn wanted(columns: &[&str], stated: Option<ProjectFiles>) -> Result<ProjectFiles, FileError> {
    let has = |wanted: &ProjectFiles| columns.iter().any(|column| domain_of(column, *wanted).is_some());
    let usual = [ProjectFiles::LocalParticles, ProjectFiles::WorldParticles];
    if let Some(found) =
        stated.as_ref().map_or(&usual[..], std::slice::from_ref).iter().find(|files| has(files))
    {
        return Ok(*found);
    }
    let names = |wanted: ProjectFiles| {
        let of = |(prefix, what): &(&str, ProjectFiles)| (*what == wanted).then(|| format!("{prefix}…"));
        FILES.iter().filter_map(of).collect::<Vec<_>>().join(" or ")
    };
    let found = columns.iter().map(|column| shown(column)).collect::<Vec<_>>().join(", ");
    let found = if found.is_empty() { "none".into() } else { found };
    Err(match stated {
        Some(files) => FileError::of(
            FaultKind::Option,
            Place::tag("files"),
            format!("expected a column {}, got {found}", names(files)),
        ),
        None => FileError::malformed(
            Place::default(),
            format!(
                "expected a column {} or {}, got {found}; files=groomed and files=shape read surfaces",
                names(usual[0]),
                names(usual[1])
            ),
        ),
    })
}

/// A path as names between `/`, without `.` and with `..` at its beginning only.
fn relative(path: &str) -> Result<String, String> {
    let refused = || Err(format!("expected a path from the folder of the project, got {}", shown(path)));
    let plain = path.replace('\\', "/");
    if plain.starts_with('/') || plain.as_bytes().get(1) == Some(&b':') || plain.contains('\0') {
        return refused();
    }
    let mut parts: Vec<&str> = Vec::new();
    for part in plain.split('/') {
        match (part, parts.last()) {
            ("" | ".", _) => {}
            ("..", Some(last)) if *last != ".." => drop(parts.pop()),
            _ => parts.push(part),
        }
    }
    match parts.last() {
        None | Some(&"..") => refused(),
        Some(_) => Ok(parts.join("/")),
    }
}

/// The path of a file within an archive, from the folder that the project is in there; `None` if it is outside.
pub(super) fn within(folder: &str, path: &str) -> Option<String> {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            ".." => drop(parts.pop()?),
            _ => parts.push(part),
        }
    }
    Some(parts.join("/"))
}

#[cfg(test)]
mod tests;
