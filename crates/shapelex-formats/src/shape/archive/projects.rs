//! Projects of ShapeWorks in archives: the files that one names are read, in its order and with its facts about them.

use std::collections::BTreeSet;
use std::io::{Cursor, Read};

use zip::read::ZipFile;
use zip::result::ZipError;

use super::super::options::ReadOptions;
use super::super::project::{self, Project, ProjectFile, Table};
use super::super::record::Sink;
use super::super::registry::detect;
use super::super::unzip::{Archive, fault};
use super::{Files, is_foreign};
use crate::error::{FaultKind, FileError, Place};

/// Id of the format of projects.
pub(super) const FORMAT: &str = project::FORMAT.id;

/// Reads the files of the project of an archive. Returns their number; `None` if there is no project.
pub(super) fn read(
    archive: &mut Archive,
    files: &mut Files<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Option<u64>, FileError> {
    let Some(project) = find(archive, files)? else { return Ok(None) };
    files.read_project(archive, &project, options, sink).map(Some)
}

/// A project in an archive.
struct ProjectEntry {
    name: String,
    table: Table,
}

/// The project in an archive. Workbooks may hold something else: those are none.
fn find(archive: &mut Archive, files: &mut Files<'_>) -> Result<Option<ProjectEntry>, FileError> {
    let mut found = None;
    for k in 0..archive.len() {
        let file = archive.by_index(k).map_err(|error| fault(error).at(Place::item(k as u64)))?;
        let name = file.name().map_err(fault)?.into_owned();
        let is_named_so = detect(&[], Some(&name)).is_ok_and(|format| format.id == FORMAT);
        if is_foreign(&name) || !is_named_so {
            continue;
        }
        let entry = Place { entry: Some(name.clone()), ..Place::default() };
        let table = files.table(file).map_err(|error| error.at(entry.clone()))?;
        if !project::is_project(&table) {
            continue;
        }
        if found.is_some() {
            let detail = "expected one project in an archive, got a second one";
            return Err(FileError::unsupported(entry, detail));
        }
        found = Some(ProjectEntry { name, table });
    }
    Ok(found)
}

impl Files<'_> {
    /// Reads the files that a project names. Returns their number.
    fn read_project(
        &mut self,
        archive: &mut Archive,
        entry: &ProjectEntry,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<u64, FileError> {
        let at = Place { entry: Some(entry.name.clone()), ..Place::default() };
        let project = Project::new(&entry.table, options).map_err(|error| error.at(at.clone()))?;
        let folder = entry.name.rsplit_once('/').map_or("", |(folder, _)| folder);
        // Those of the project say nothing of its files.
        let own = ReadOptions { files: None, select: None, attributes: None, ..options.clone() };
        let mut known = BTreeSet::from([entry.name.clone()]);
        for named in &project.files {
            let missing = || {
                let detail = format!("expected the file '{}' in the archive, got none", named.path);
                FileError::malformed(named.place().within(&at), detail)
            };
            let found = project::within(folder, &named.path).ok_or_else(missing).and_then(|path| {
                let file = archive.by_name(&path).map_err(|error| match error {
                    ZipError::FileNotFound => missing(),
                    other => fault(other).at(named.place().within(&at)),
                })?;
                let again = !known.insert(path.clone());
                let place = Place { entry: Some(path), ..Place::default() };
                self.read_named(file, named, again, &place, &own, sink).map_err(|error| error.at(place))
            });
            found.or_else(|error| options.leave_out(error, &mut self.summary))?;
        }
        for name in archive.file_names() {
            let name = name.map_err(fault)?;
            if !name.ends_with('/') && !known.contains(&*name) {
                let place = || Place { entry: Some(name.to_string()), ..Place::default() };
                self.summary.drop("files beside those that the project names", Some(&name), place);
            }
        }
        let mut dropped = project.summary.dropped;
        dropped.iter_mut().for_each(|left| left.first = left.first.clone().within(&at));
        self.summary.dropped.append(&mut dropped);
        let facts = self.facts.get_or_insert_default();
        facts.extend(project.summary.properties);
        Ok(project.files.len() as u64)
    }

    /// Reads a file that a project names, `again` if another row has named it.
    fn read_named(
        &mut self,
        file: ZipFile<'_, Cursor<Vec<u8>>>,
        named: &ProjectFile,
        again: bool,
        place: &Place,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        let (packed, before, warnings) = (file.compressed_size(), self.content, self.summary.warnings.len());
        let mut n = 0;
        let is_known = self.read(file, place, options, &mut |record| {
            n += 1;
            sink(named.describe(record, n - 1))
        })?;
        if !is_known {
            let detail = "expected a file of shapes that the project names, got one of no known format";
            return Err(FileError::new(FaultKind::Unsupported, detail));
        }
        if again {
            // They are those of the first time.
            self.summary.warnings.truncate(warnings);
        }
        // Packed data may be long, and nothing come out.
        let bytes = packed.saturating_add(self.content - before);
        if again {
            return self.again.take(bytes);
        }
        self.first.set(self.first.get().saturating_add(bytes));
        Ok(())
    }

    /// A table. The unpacked size of a workbook counts as well.
    fn table(&mut self, file: impl Read) -> Result<Table, FileError> {
        let mut source = self.archive.inner(file, self.left())?;
        let table = Table::read(&mut source)?;
        self.content += source.offset() + table.unpacked;
        Ok(table)
    }
}
