-- Names for versions, which can be moved: `name@alias`. `moves` numbers the versions that an alias has named, from 1.
CREATE TABLE dictionary_alias (
    handle      TEXT    NOT NULL,
    alias       TEXT    NOT NULL,
    tenant      TEXT    NOT NULL,
    dictionary  TEXT    NOT NULL REFERENCES dictionary (id) ON DELETE CASCADE,
    moves       INTEGER NOT NULL,
    moved_at_ms INTEGER NOT NULL,
    PRIMARY KEY (handle, alias)
) STRICT, WITHOUT ROWID;
CREATE INDEX dictionary_alias_version ON dictionary_alias (dictionary);

-- Pieces of the output of a job, stored while it runs. Those of the attempt that its row in job_output names belong to it.
CREATE TABLE job_output_part (
    job      TEXT    NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt  INTEGER NOT NULL,
    part     INTEGER NOT NULL,
    checksum BLOB    NOT NULL,
    data     BLOB    NOT NULL,
    PRIMARY KEY (job, attempt, part)
) STRICT;
