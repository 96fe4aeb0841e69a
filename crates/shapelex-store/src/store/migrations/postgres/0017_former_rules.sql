-- See the same step of the embedded database for the reasons.

ALTER TABLE cohort ADD COLUMN former_rules TEXT;
