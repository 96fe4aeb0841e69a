//! Completions of shells and man pages, made from the description of the command line.

use std::path::Path;

use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;

/// Script that completes the commands and their options in a shell.
///
/// # Errors
/// None but a bug.
pub(super) fn completions(shell: Shell, command: &mut Command) -> Result<String, String> {
    let (name, mut script) = (command.get_name().to_owned(), Vec::new());
    clap_complete::generate(shell, command, name, &mut script);
    String::from_utf8(script).map_err(|error| error.to_string())
}

/// Writes a page for the program and for each of its commands into a folder, and says how many; without a folder, returns the
/// page of the program.
///
/// # Errors
/// A folder that cannot be written.
pub(super) fn pages(command: &Command, folder: Option<&Path>) -> Result<String, String> {
    let Some(folder) = folder else {
        let mut page = Vec::new();
        Man::new(command.clone()).render(&mut page).map_err(|error| error.to_string())?;
        return String::from_utf8(page).map_err(|error| error.to_string());
    };
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(folder).map_err(failed)?;
    clap_mangen::generate_to(command.clone(), folder).map_err(failed)?;
    let count = std::fs::read_dir(folder).map_err(failed)?.count();
    Ok(format!("{count} pages in {}\n", folder.display()))
}
