-- Numbers of cohorts and chunks are never given twice (AUTOINCREMENT): a cursor or a row that outlives
-- its owner for a moment cannot end up with another one.

CREATE TABLE cohort (
    number         INTEGER PRIMARY KEY AUTOINCREMENT,
    id             TEXT    NOT NULL UNIQUE,
    name           TEXT    NOT NULL UNIQUE,
    description    TEXT,
    representation TEXT    NOT NULL,
    correspondence TEXT    NOT NULL,
    direction      TEXT    NOT NULL,
    mirror         TEXT    NOT NULL,
    length_unit    TEXT,
    revision       INTEGER NOT NULL,
    shapes         INTEGER NOT NULL,
    created_at_ms  INTEGER NOT NULL,
    updated_at_ms  INTEGER NOT NULL
) STRICT;

-- A run of shapes that were stored together. Without a revision it is pending: part of an unfinished
-- upload that no reader sees. Without a cohort it is rubbish: its cohort was deleted, and the chunk is
-- removed in small steps.
CREATE TABLE chunk (
    id            INTEGER PRIMARY KEY AUTOINCREMENT,
    cohort        INTEGER REFERENCES cohort (number) ON DELETE SET NULL,
    upload        TEXT    NOT NULL,
    revision      INTEGER,
    created_at_ms INTEGER,
    rows          INTEGER NOT NULL,
    width         INTEGER NOT NULL
) STRICT;
CREATE INDEX chunk_cohort ON chunk (cohort, id);
CREATE INDEX chunk_pending ON chunk (upload) WHERE revision IS NULL;

-- Apart from `chunk`, because SQLite writes a row as a whole: setting a revision would copy the points.
CREATE TABLE chunk_data (
    chunk_id INTEGER PRIMARY KEY REFERENCES chunk (id) ON DELETE CASCADE,
    checksum BLOB NOT NULL,
    weights  BLOB,
    points   BLOB NOT NULL
) STRICT;

CREATE TABLE shape (
    chunk_id         INTEGER NOT NULL REFERENCES chunk (id) ON DELETE CASCADE,
    position         INTEGER NOT NULL,
    cohort           INTEGER NOT NULL,
    id               TEXT    NOT NULL UNIQUE,
    external_id      TEXT,
    subject          TEXT,
    label            TEXT,
    deleted_revision INTEGER,
    digest           BLOB,
    labels           TEXT,
    metadata         TEXT,
    PRIMARY KEY (chunk_id, position)
) STRICT, WITHOUT ROWID;
CREATE UNIQUE INDEX shape_external_id ON shape (cohort, external_id)
    WHERE external_id IS NOT NULL AND deleted_revision IS NULL;
CREATE INDEX shape_label ON shape (cohort, label, chunk_id, position) WHERE label IS NOT NULL;
CREATE INDEX shape_subject ON shape (cohort, subject, chunk_id, position) WHERE subject IS NOT NULL;
CREATE INDEX shape_deleted ON shape (cohort, chunk_id, position, deleted_revision)
    WHERE deleted_revision IS NOT NULL;

-- Written to find out whether writing works.
CREATE TABLE probe (
    id    INTEGER PRIMARY KEY,
    count INTEGER NOT NULL
) STRICT;
