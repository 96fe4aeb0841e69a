-- Names for versions, which can be moved; see the embedded database.
CREATE TABLE dictionary_alias (
    handle      TEXT   COLLATE "C" NOT NULL,
    alias       TEXT   COLLATE "C" NOT NULL,
    tenant      TEXT   COLLATE "C" NOT NULL,
    dictionary  TEXT   COLLATE "C" NOT NULL REFERENCES dictionary (id) ON DELETE CASCADE,
    moves       BIGINT NOT NULL,
    moved_at_ms BIGINT NOT NULL,
    PRIMARY KEY (handle, alias)
);
CREATE INDEX dictionary_alias_version ON dictionary_alias (dictionary);

-- Pieces of the output of a job, stored while it runs.
CREATE TABLE job_output_part (
    job      TEXT   COLLATE "C" NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt  BIGINT NOT NULL,
    part     BIGINT NOT NULL,
    checksum BYTEA  NOT NULL,
    data     BYTEA  NOT NULL,
    PRIMARY KEY (job, attempt, part)
);
