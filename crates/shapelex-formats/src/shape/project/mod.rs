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
use std::rc::Rc;

use super::format::Format;
use super::options::{ProjectFiles, ReadOptions};
use super::record::{Kind, Record, Sink};
use super::source::Source;
use super::text::{self, shown};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::value::Value;
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
    options: &["files", "select", "attributes"],
    read: Some(read),
    open: None,
};

/// Beginnings of columns with files, and the kinds of these. `groomed_contour_` comes before `groomed_`.
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
/// Beginnings of columns with files that are not shapes.
const OTHER_FILES: [&str; 3] = ["constraints_", "image_", "feature_"];
const TRANSFORMATIONS: [&str; 3] = ["alignment_", "procrustes_", "transform_"];
const GROUP: &str = "group_";

/// Content of a column.
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

/// Facts of a row about all its files, which may be many.
#[derive(Debug)]
struct Subject {
    name: Option<String>,
    label: Option<String>,
    labels: BTreeMap<Rc<str>, Value>,
}

/// A column of files that are read.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Domain {
    name: String,
    column: String,
}

/// A file of one domain of a subject, and the facts of the project about it.
#[derive(Debug)]
pub(super) struct ProjectFile {
    /// Path from the folder of the project: names between `/`, after any `..`.
    pub(super) path: String,
    /// Number of the row, from 0.
    item: u64,
    subject: Rc<Subject>,
    domain: Rc<Domain>,
    /// Whether the project has other domains.
    several: bool,
}

impl ProjectFile {
    /// Where the project names it.
    pub(super) fn place(&self) -> Place {
        Place { tag: Some(self.domain.column.clone()), ..Place::item(self.item) }
    }

    /// The `n`-th shape of the file, from 0, with the facts of the project about it.
    pub(super) fn describe(&self, record: Record, n: u64) -> Record {
        let Subject { name: subject, label, labels: own } = &*self.subject;
        let domain = self.several.then_some(self.domain.name.as_str());
        let mut name = subject.clone().or(record.name);
        if let (Some(name), Some(domain)) = (&mut name, domain) {
            *name = format!("{name}/{domain}");
        }
        if let (Some(name), 1..) = (&mut name, n) {
            *name = format!("{name}/{}", n + 1);
        }
        let mut metadata = record.metadata;
        metadata.extend(domain.map(|domain| ("domain".to_owned(), domain.into())));
        let mut labels = record.labels;
        labels.extend(own.iter().map(|(name, value)| (name.to_string(), value.clone())));
        Record {
            name,
            subject: subject.clone().filter(|_| self.several).or(record.subject),
            label: label.clone().or(record.label),
            labels,
            metadata,
            ..record
        }
    }
}

/// The columns of a table that are read beside attributes. Each row is read by its own values: a table may have many columns, and
/// many rows that have none of them.
struct Columns<'t> {
    /// Those of files, by the names of the domains.
    domains: Vec<Rc<Domain>>,
    /// Their numbers.
    numbers: BTreeMap<&'t str, usize>,
    /// Whether the project has several domains, chosen or not.
    several: bool,
    /// Names of groups by their columns.
    groups: BTreeMap<&'t str, Rc<str>>,
}

/// The files of a project that are read, subject after subject, in each by the names of the domains.
#[derive(Debug)]
pub(super) struct Project {
    pub(super) files: Vec<ProjectFile>,
    /// Items that are not read.
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
        let domain = |(name, column): &(&str, &str)| {
            Rc::new(Domain { name: (*name).to_owned(), column: (*column).to_owned() })
        };
        let columns = Columns {
            domains: chosen.iter().map(domain).collect(),
            numbers: chosen.iter().enumerate().map(|(k, (_, column))| (*column, k)).collect(),
            several,
            groups: columns.iter().filter_map(group_of).collect(),
        };
        for (item, row) in table.rows.iter().enumerate() {
            let added = project.add(item as u64, row, &columns);
            added.or_else(|error| options.leave_out(error, &mut project.summary))?;
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
    fn add(&mut self, item: u64, row: &Row, columns: &Columns<'_>) -> Result<(), FileError> {
        let name = value(row, "name");
        if value(row, "excluded")
            .is_some_and(|text| matches!(text::value(text), Value::Bool(true)) || text == "1")
        {
            self.summary.drop("excluded subjects", name, || Place::item(item));
            return Ok(());
        }
        let mut named: Vec<(usize, &str)> =
            values(row).filter_map(|(column, path)| Some((*columns.numbers.get(&**column)?, path))).collect();
        named.sort_unstable();
        self.leave_out_files(item, name, &named, columns);
        let subject = Rc::new(subject(row, columns));
        for (number, path) in named {
            let domain = &columns.domains[number];
            let mut file = ProjectFile {
                path: String::new(),
                item,
                subject: Rc::clone(&subject),
                domain: Rc::clone(domain),
                several: columns.several,
            };
            file.path = relative(path).map_err(|detail| FileError::malformed(file.place(), detail))?;
            self.files.push(file);
        }
        Ok(())
    }

    /// Counts the files that a subject does not have: all but those `named`.
    fn leave_out_files(
        &mut self,
        item: u64,
        name: Option<&str>,
        named: &[(usize, &str)],
        columns: &Columns<'_>,
    ) {
        let count = columns.domains.len() - named.len();
        if count == 0 {
            return;
        }
        let first = named.iter().zip(0..).position(|((number, _), k)| *number != k).unwrap_or(named.len());
        let place = || Place { tag: Some(columns.domains[first].column.clone()), ..Place::item(item) };
        self.summary.drop_many("subjects without such a file", count as u64, name, place);
    }
}

/// The values of a row that are not blank, without spaces at their ends.
fn values(row: &Row) -> impl Iterator<Item = (&Rc<str>, &str)> {
    row.iter().map(|(column, text)| (column, text.trim())).filter(|(_, text)| !text.is_empty())
}

fn value<'r>(row: &'r Row, column: &str) -> Option<&'r str> {
    row.get(column).map(|text| text.trim()).filter(|text| !text.is_empty())
}

/// Facts of a row about all its files. The only group of a project is the label.
fn subject(row: &Row, columns: &Columns<'_>) -> Subject {
    let mut subject =
        Subject { name: value(row, "name").map(str::to_owned), label: None, labels: BTreeMap::new() };
    let groups = &columns.groups;
    match (groups.len(), groups.first_key_value()) {
        (1, Some((column, _))) => subject.label = value(row, column).map(str::to_owned),
        _ => {
            let group = |(column, text): (&Rc<str>, &str)| {
                Some((Rc::clone(groups.get(&**column)?), text::value(text)))
            };
            subject.labels.extend(values(row).filter_map(group));
        }
    }
    let attributes = values(row).filter(|(column, _)| matches!(Column::of(column), Column::Attribute));
    subject.labels.extend(attributes.map(|(column, text)| (Rc::clone(column), text::value(text))));
    subject
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
fn group_of<'c>(column: &&'c str) -> Option<(&'c str, Rc<str>)> {
    match Column::of(column) {
        Column::Group(group) => Some((column, group.into())),
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
