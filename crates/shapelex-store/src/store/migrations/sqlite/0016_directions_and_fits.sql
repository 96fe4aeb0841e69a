-- Whether a closed planar curve runs clockwise; rows of earlier versions have none until it is first asked for. What the fit of a
-- surface to a mesh has left, where its parameters were computed.

ALTER TABLE shape ADD COLUMN clockwise INTEGER;
ALTER TABLE shape ADD COLUMN fit_mean REAL;
ALTER TABLE shape ADD COLUMN fit_largest REAL;
ALTER TABLE shape ADD COLUMN fit_area REAL;
