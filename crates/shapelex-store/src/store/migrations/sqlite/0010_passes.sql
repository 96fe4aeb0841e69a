-- A pass over a cohort that a job has cut into parts, at most one of a job at a time. It belongs to the claim on the job:
-- parts are given out and taken back as long as the job runs under this owner, by processes whose arithmetic gives the
-- same bits.
CREATE TABLE pass (
    number      INTEGER PRIMARY KEY AUTOINCREMENT,
    job         TEXT    NOT NULL UNIQUE REFERENCES job (id) ON DELETE CASCADE,
    owner       TEXT    NOT NULL,
    arithmetic  TEXT    NOT NULL,
    description TEXT    NOT NULL
) STRICT;

-- A part begins with the chunk, of whose shapes that belong to the pass the first `skip` are left out. It is open, done (with a
-- result, unless the owner has used it already), or refused: then the owner makes it.
CREATE TABLE task (
    number         INTEGER PRIMARY KEY AUTOINCREMENT,
    pass           INTEGER NOT NULL REFERENCES pass (number) ON DELETE CASCADE,
    part           INTEGER NOT NULL,
    chunk          INTEGER NOT NULL,
    skip           INTEGER NOT NULL,
    status         TEXT    NOT NULL,
    lease_owner    TEXT,
    lease_until_ms INTEGER,
    result         BLOB,
    checksum       BLOB,
    UNIQUE (pass, part)
) STRICT;
