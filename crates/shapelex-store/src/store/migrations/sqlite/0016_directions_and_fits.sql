-- Whether a closed planar curve runs clockwise; rows of earlier versions have none until it is first asked for. What the fit of a
-- surface to a mesh has left, where its parameters were computed. Where a contour began, and whether it ran the other way, before it was
-- moved to its canonical start: rows of earlier versions cannot know it.

ALTER TABLE shape ADD COLUMN clockwise INTEGER;
ALTER TABLE shape ADD COLUMN fit_mean REAL;
ALTER TABLE shape ADD COLUMN fit_largest REAL;
ALTER TABLE shape ADD COLUMN fit_area REAL;
ALTER TABLE shape ADD COLUMN given_start REAL;
ALTER TABLE shape ADD COLUMN given_reversed INTEGER;
