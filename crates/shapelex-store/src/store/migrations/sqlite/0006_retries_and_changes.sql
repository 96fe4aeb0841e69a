-- What a request that a client may send again has brought about: written with it, so that it is done once.
CREATE TABLE receipt (
    tenant        TEXT    NOT NULL,
    key           TEXT    NOT NULL,
    fingerprint   BLOB    NOT NULL,
    outcome       TEXT    NOT NULL,
    created_at_ms INTEGER NOT NULL,
    PRIMARY KEY (tenant, key)
) STRICT, WITHOUT ROWID;
CREATE INDEX receipt_created ON receipt (created_at_ms);

-- What has changed, numbered in the order of the commits of a tenant.
CREATE TABLE change_sequence (
    tenant TEXT    PRIMARY KEY,
    last   INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE change (
    tenant   TEXT    NOT NULL,
    sequence INTEGER NOT NULL,
    at_ms    INTEGER NOT NULL,
    kind     TEXT    NOT NULL,
    object   TEXT    NOT NULL,
    cohort   TEXT,
    revision INTEGER,
    shapes   INTEGER,
    PRIMARY KEY (tenant, sequence)
) STRICT, WITHOUT ROWID;
