-- Which subjects were erased, as digests that the same subject has in every store, and whether the files may still hold remains of
-- them. Ids of the shapes that a change names, as a list of JSON.

CREATE TABLE erasure (
    tenant       TEXT    NOT NULL,
    subject      BLOB    NOT NULL,
    erased_at_ms INTEGER NOT NULL,
    state        TEXT    NOT NULL,
    PRIMARY KEY (tenant, subject)
) STRICT, WITHOUT ROWID;
ALTER TABLE change ADD COLUMN shape_ids TEXT;
