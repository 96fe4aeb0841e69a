-- See the embedded database.

CREATE TABLE erasure (
    tenant       TEXT   COLLATE "C" NOT NULL,
    subject      BYTEA  NOT NULL,
    erased_at_ms BIGINT NOT NULL,
    state        TEXT   COLLATE "C" NOT NULL,
    PRIMARY KEY (tenant, subject)
);
ALTER TABLE change ADD COLUMN shape_ids TEXT;
