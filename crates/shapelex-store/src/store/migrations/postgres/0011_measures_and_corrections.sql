-- See the same step of the embedded database for the reasons.

ALTER TABLE shape DROP CONSTRAINT shape_id_key;
ALTER TABLE shape ADD COLUMN first_stored_ms BIGINT;
ALTER TABLE shape ADD COLUMN points BIGINT;
ALTER TABLE shape ADD COLUMN centroid_size DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN length DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN area DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN volume DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN self_intersecting BIGINT;

CREATE UNIQUE INDEX shape_id ON shape (id) WHERE deleted_revision IS NULL;
CREATE INDEX shape_unmeasured ON shape (cohort, chunk_id, position) WHERE centroid_size IS NULL;
