-- What is too large for the row of a job. Ends with the job, or when newer outputs take its place.

CREATE TABLE job_output (
    number   INTEGER PRIMARY KEY AUTOINCREMENT,
    job      TEXT    NOT NULL UNIQUE REFERENCES job (id) ON DELETE CASCADE,
    bytes    INTEGER NOT NULL,
    checksum BLOB    NOT NULL,
    head     TEXT    NOT NULL,
    data     BLOB    NOT NULL
) STRICT;
