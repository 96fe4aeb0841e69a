-- What a version of a dictionary said of a shape. A later assessment by the same version replaces it. `class` is the accepted
-- class, if there is one; `body` is the assessment as JSON.
CREATE TABLE assessment (
    cohort         INTEGER NOT NULL REFERENCES cohort (number) ON DELETE CASCADE,
    dictionary     TEXT    NOT NULL REFERENCES dictionary (id) ON DELETE CASCADE,
    shape          TEXT    NOT NULL,
    revision       INTEGER NOT NULL,
    assessed_at_ms INTEGER NOT NULL,
    class          TEXT,
    is_outlier     INTEGER NOT NULL,
    body           TEXT    NOT NULL,
    PRIMARY KEY (cohort, dictionary, shape)
) STRICT, WITHOUT ROWID;
CREATE INDEX assessment_dictionary ON assessment (dictionary);
CREATE INDEX assessment_shape ON assessment (shape);
