-- What a version of a dictionary said of a shape; see the embedded database.
CREATE TABLE assessment (
    cohort         BIGINT NOT NULL REFERENCES cohort (number) ON DELETE CASCADE,
    dictionary     TEXT   COLLATE "C" NOT NULL REFERENCES dictionary (id) ON DELETE CASCADE,
    shape          TEXT   COLLATE "C" NOT NULL,
    revision       BIGINT NOT NULL,
    assessed_at_ms BIGINT NOT NULL,
    class          TEXT   COLLATE "C",
    is_outlier     BIGINT NOT NULL,
    body           TEXT   NOT NULL,
    PRIMARY KEY (cohort, dictionary, shape)
);
CREATE INDEX assessment_dictionary ON assessment (dictionary);
CREATE INDEX assessment_shape ON assessment (shape);
