-- Versions that were given, also to versions deleted since: `name@3` means the same for ever.
CREATE TABLE dictionary_name (
    name     TEXT PRIMARY KEY,
    versions INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE dictionary (
    id            TEXT    PRIMARY KEY,
    name          TEXT    NOT NULL,
    version       INTEGER NOT NULL,
    cohort        TEXT    NOT NULL,
    summary       TEXT    NOT NULL,
    provenance    TEXT    NOT NULL,
    digest        TEXT    NOT NULL,
    created_at_ms INTEGER NOT NULL,
    UNIQUE (name, version)
) STRICT, WITHOUT ROWID;
CREATE INDEX dictionary_cohort ON dictionary (cohort, id);

-- Apart, so that lists do not read it.
CREATE TABLE dictionary_data (
    dictionary     TEXT PRIMARY KEY REFERENCES dictionary (id) ON DELETE CASCADE,
    content        BLOB NOT NULL,
    state          BLOB,
    state_checksum BLOB
) STRICT;
