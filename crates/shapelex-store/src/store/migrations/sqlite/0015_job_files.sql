-- Files that a job works on, in pieces. They come with the job and go when it ends.
CREATE TABLE job_file (
    job      TEXT    NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    name     TEXT    NOT NULL,
    piece    INTEGER NOT NULL,
    checksum BLOB    NOT NULL,
    data     BLOB    NOT NULL,
    PRIMARY KEY (job, name, piece)
) STRICT;
