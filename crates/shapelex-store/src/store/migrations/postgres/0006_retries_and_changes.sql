-- What a request that a client may send again has brought about: written with it, so that it is done once.
CREATE TABLE receipt (
    tenant        TEXT COLLATE "C" NOT NULL,
    key           TEXT COLLATE "C" NOT NULL,
    fingerprint   BYTEA   NOT NULL,
    outcome       TEXT    NOT NULL,
    created_at_ms BIGINT NOT NULL,
    PRIMARY KEY (tenant, key)
);
CREATE INDEX receipt_created ON receipt (created_at_ms);

-- What has changed, numbered in the order of the commits of a tenant.
CREATE TABLE change_sequence (
    tenant TEXT COLLATE "C" PRIMARY KEY,
    last   BIGINT NOT NULL
);
CREATE TABLE change (
    tenant   TEXT COLLATE "C" NOT NULL,
    sequence BIGINT NOT NULL,
    at_ms    BIGINT NOT NULL,
    kind     TEXT    NOT NULL,
    object   TEXT    NOT NULL,
    cohort   TEXT,
    revision BIGINT,
    shapes   BIGINT,
    PRIMARY KEY (tenant, sequence)
);
