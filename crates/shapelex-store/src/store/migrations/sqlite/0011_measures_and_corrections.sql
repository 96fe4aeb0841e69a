-- A corrected shape is stored again under its id, and the row before it ends: an id is unique among the shapes that live.
-- Measures are computed when shapes arrive; rows of earlier versions have none until they are first asked for.

CREATE TABLE shape_with_measures (
    chunk_id          INTEGER NOT NULL REFERENCES chunk (id) ON DELETE CASCADE,
    position          INTEGER NOT NULL,
    cohort            INTEGER NOT NULL,
    id                TEXT    NOT NULL,
    external_id       TEXT,
    subject           TEXT,
    label             TEXT,
    deleted_revision  INTEGER,
    digest            BLOB,
    labels            TEXT,
    metadata          TEXT,
    -- Time of creation of a corrected shape, which its chunk no longer tells.
    first_stored_ms   INTEGER,
    points            INTEGER,
    centroid_size     REAL,
    length            REAL,
    area              REAL,
    volume            REAL,
    self_intersecting INTEGER,
    PRIMARY KEY (chunk_id, position)
) STRICT, WITHOUT ROWID;
INSERT INTO shape_with_measures (chunk_id, position, cohort, id, external_id, subject, label, deleted_revision,
        digest, labels, metadata)
    SELECT chunk_id, position, cohort, id, external_id, subject, label, deleted_revision, digest, labels, metadata
    FROM shape ORDER BY chunk_id, position;
DROP TABLE shape;
ALTER TABLE shape_with_measures RENAME TO shape;

CREATE UNIQUE INDEX shape_id ON shape (id) WHERE deleted_revision IS NULL;
CREATE UNIQUE INDEX shape_external_id ON shape (cohort, external_id)
    WHERE external_id IS NOT NULL AND deleted_revision IS NULL;
CREATE INDEX shape_label ON shape (cohort, label, chunk_id, position) WHERE label IS NOT NULL;
CREATE INDEX shape_subject ON shape (cohort, subject, chunk_id, position) WHERE subject IS NOT NULL;
CREATE INDEX shape_deleted ON shape (cohort, chunk_id, position, deleted_revision)
    WHERE deleted_revision IS NOT NULL;
CREATE INDEX shape_unmeasured ON shape (cohort, chunk_id, position) WHERE centroid_size IS NULL;
