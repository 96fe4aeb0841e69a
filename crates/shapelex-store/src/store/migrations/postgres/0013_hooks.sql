-- Addresses to which the changes of a tenant are delivered; see the embedded database.
CREATE TABLE hook (
    id               TEXT   COLLATE "C" PRIMARY KEY,
    tenant           TEXT   COLLATE "C" NOT NULL,
    url              TEXT   NOT NULL,
    description      TEXT   NOT NULL,
    kinds            TEXT,
    cohort           TEXT,
    secret           BYTEA  NOT NULL,
    status           TEXT   NOT NULL,
    reason           TEXT,
    position         BIGINT NOT NULL,
    attempts         BIGINT NOT NULL,
    failing_since_ms BIGINT,
    due_ms           BIGINT NOT NULL,
    delivered_at_ms  BIGINT,
    created_at_ms    BIGINT NOT NULL,
    lease_owner      TEXT   COLLATE "C",
    lease_until_ms   BIGINT
);
CREATE INDEX hook_tenant ON hook (tenant, id);

CREATE TABLE hook_failure (
    hook     TEXT   COLLATE "C" NOT NULL REFERENCES hook (id) ON DELETE CASCADE,
    at_ms    BIGINT NOT NULL,
    sequence BIGINT NOT NULL,
    attempt  BIGINT NOT NULL,
    status   BIGINT,
    detail   TEXT   NOT NULL,
    PRIMARY KEY (hook, at_ms, sequence, attempt)
);
