-- Keys of the digests that stand for identifiers of persons: one for each tenant, made when it is first used.

CREATE TABLE subject_secret (
    tenant TEXT NOT NULL PRIMARY KEY,
    secret BLOB NOT NULL
) STRICT;
