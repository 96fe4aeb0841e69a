-- Rules by which the shapes of a cohort were compared up to a revision, as JSON: what is of that revision is computed by its rule.

ALTER TABLE cohort ADD COLUMN former_rules TEXT;
