-- As that of the embedded database; see there.
CREATE TABLE audit (
    tenant     TEXT   COLLATE "C" NOT NULL,
    sequence   BIGINT NOT NULL,
    at_ms      BIGINT NOT NULL,
    caller     TEXT   COLLATE "C",
    subject    TEXT,
    operation  TEXT   COLLATE "C",
    method     TEXT   NOT NULL,
    route      TEXT,
    objects    TEXT   COLLATE "C" NOT NULL,
    status     BIGINT,
    request_id TEXT   NOT NULL,
    remote     TEXT,
    digest     BYTEA  NOT NULL,
    PRIMARY KEY (tenant, sequence)
);
CREATE INDEX audit_time ON audit (tenant, at_ms);

CREATE TABLE audit_head (
    tenant           TEXT   COLLATE "C" NOT NULL PRIMARY KEY,
    sequence         BIGINT NOT NULL,
    digest           BYTEA  NOT NULL,
    removed_sequence BIGINT NOT NULL,
    removed_digest   BYTEA  NOT NULL
);
