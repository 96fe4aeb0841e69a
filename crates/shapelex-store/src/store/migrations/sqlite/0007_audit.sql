-- What was asked of the service. The digest of each entry covers that of the one before it in its tenant.
CREATE TABLE audit (
    tenant     TEXT    NOT NULL,
    sequence   INTEGER NOT NULL,
    at_ms      INTEGER NOT NULL,
    caller     TEXT,
    subject    TEXT,
    operation  TEXT,
    method     TEXT    NOT NULL,
    route      TEXT,
    objects    TEXT    NOT NULL,
    status     INTEGER,
    request_id TEXT    NOT NULL,
    remote     TEXT,
    digest     BLOB    NOT NULL,
    PRIMARY KEY (tenant, sequence)
) STRICT, WITHOUT ROWID;
CREATE INDEX audit_time ON audit (tenant, at_ms);

-- Place and link of the last entry, and of the last one that was removed for its age.
CREATE TABLE audit_head (
    tenant           TEXT    NOT NULL PRIMARY KEY,
    sequence         INTEGER NOT NULL,
    digest           BLOB    NOT NULL,
    removed_sequence INTEGER NOT NULL,
    removed_digest   BLOB    NOT NULL
) STRICT, WITHOUT ROWID;
