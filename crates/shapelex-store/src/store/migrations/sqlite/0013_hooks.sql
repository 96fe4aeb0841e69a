-- Addresses to which the changes of a tenant are delivered. `position` is the number of the last change that was delivered or
-- needed no delivery. The secret signs deliveries, so it is kept as it is.
CREATE TABLE hook (
    id               TEXT    PRIMARY KEY,
    tenant           TEXT    NOT NULL,
    url              TEXT    NOT NULL,
    description      TEXT    NOT NULL,
    kinds            TEXT,
    cohort           TEXT,
    secret           BLOB    NOT NULL,
    status           TEXT    NOT NULL,
    reason           TEXT,
    position         INTEGER NOT NULL,
    attempts         INTEGER NOT NULL,
    failing_since_ms INTEGER,
    due_ms           INTEGER NOT NULL,
    delivered_at_ms  INTEGER,
    created_at_ms    INTEGER NOT NULL,
    lease_owner      TEXT,
    lease_until_ms   INTEGER
) STRICT, WITHOUT ROWID;
CREATE INDEX hook_tenant ON hook (tenant, id);

-- Attempts at a delivery that failed; the newest of each hook are kept.
CREATE TABLE hook_failure (
    hook     TEXT    NOT NULL REFERENCES hook (id) ON DELETE CASCADE,
    at_ms    INTEGER NOT NULL,
    sequence INTEGER NOT NULL,
    attempt  INTEGER NOT NULL,
    status   INTEGER,
    detail   TEXT    NOT NULL,
    PRIMARY KEY (hook, at_ms, sequence, attempt)
) STRICT, WITHOUT ROWID;
