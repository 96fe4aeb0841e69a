//! Meanings of database errors that are not bugs.

use sqlx::postgres::PgDatabaseError;

/// Meaning of a database error that is not a bug.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Failure {
    /// The database is unavailable, restarting, or rolled back one of two transactions: a retry may succeed.
    Passing,
    Damaged,
    Full,
    ReadOnly,
    /// A text that cannot be stored.
    Text,
}

/// Meaning of the error.
pub(super) fn of(error: &sqlx::Error) -> Option<Failure> {
    let error = match error {
        sqlx::Error::PoolTimedOut
        | sqlx::Error::PoolClosed
        | sqlx::Error::WorkerCrashed
        | sqlx::Error::Io(_) => return Some(Failure::Passing),
        sqlx::Error::Database(error) => error,
        _ => return None,
    };
    let code = error.code()?;
    if error.try_downcast_ref::<PgDatabaseError>().is_some() {
        return of_state(&code);
    }
    of_code(&code)
}

/// Meaning of an error code of SQLite, extended or plain.
fn of_code(code: &str) -> Option<Failure> {
    /// Writing, syncing or truncating the file or its folder failed, because of a limit, a quota or a failing disk.
    const WRITING_FAILS: [i32; 4] = [778, 1034, 1290, 1546];
    /// No room for the index of the write-ahead log.
    const NO_ROOM_FOR_INDEX: i32 = 4874;
    let code = code.parse::<i32>().ok()?;
    if WRITING_FAILS.contains(&code) {
        return Some(Failure::ReadOnly);
    }
    if code == NO_ROOM_FOR_INDEX {
        return Some(Failure::Full);
    }
    // The low byte of an extended code is the plain code.
    match code & 0xff {
        // SQLITE_CORRUPT and SQLITE_NOTADB
        11 | 26 => Some(Failure::Damaged),
        13 => Some(Failure::Full),
        8 => Some(Failure::ReadOnly),
        // SQLITE_BUSY: another process holds the lock for longer than the timeout.
        5 => Some(Failure::Passing),
        _ => None,
    }
}

/// Meaning of an SQLSTATE of PostgreSQL.
fn of_state(code: &str) -> Option<Failure> {
    /// Transient classes: connection errors, rollback of one of two transactions, operator intervention.
    const PASSING: [&str; 3] = ["08", "40", "57"];
    match code {
        "53100" => Some(Failure::Full),
        "25006" => Some(Failure::ReadOnly),
        // A byte or an escape sequence that text cannot contain.
        "22021" | "22P05" => Some(Failure::Text),
        // Damaged data, damaged index.
        "XX001" | "XX002" => Some(Failure::Damaged),
        // Too many connections.
        "53300" => Some(Failure::Passing),
        code => PASSING.iter().any(|class| code.starts_with(class)).then_some(Failure::Passing),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_takes_no_more_is_no_fault_of_the_program() {
        for (code, expected) in [
            ("13", Some(Failure::Full)),
            ("4874", Some(Failure::Full)),
            ("778", Some(Failure::ReadOnly)),
            ("1034", Some(Failure::ReadOnly)),
            ("776", Some(Failure::ReadOnly)),
            ("266", None),
            ("11", Some(Failure::Damaged)),
            ("1", None),
        ] {
            assert_eq!(of_code(code), expected, "{code}");
        }
    }
}
