# What all tests share: counts, skips, a service, and an independent Procrustes analysis.
library(shapelexr)

counts <- c(passed = 0, failed = 0)

# Counts a test: what must be true, and what was found.
check <- function(name, true, ...) {
  good <- isTRUE(tryCatch(true, error = function(fault) {
    cat("  ", conditionMessage(fault), "\n", sep = "")
    FALSE
  }))
  counts[[if (good) "passed" else "failed"]] <<- counts[[if (good) "passed" else "failed"]] + 1
  if (!good) cat("FAIL: ", name, paste0(", found ", format(c(...), digits = 17), recycle0 = TRUE), "\n", sep = "")
}

# Closes a file of tests with its line of counts.
done <- function(file) {
  if (shapelex_available()) close(shapelex_server())
  cat("r-", file, ": ", counts[["passed"]], " passed, ", counts[["failed"]], " failed\n", sep = "")
  if (counts[["failed"]] > 0) quit(status = 1)
}

skip <- function(what) {
  cat("SKIPPED: R, ", what, "\n", sep = "")
  quit(status = 0)
}

need_service <- function(file) if (!shapelex_available()) skip(paste0("the tests of ", file, ", the program shapelex is missing"))

# A file of the data or of the vectors beside the project; NULL where it is not there.
beside <- function(variable, ...) {
  folder <- Sys.getenv(variable)
  path <- file.path(folder, ...)
  if (nzchar(folder) && file.exists(path)) path else NULL
}

near <- function(found, wanted, within) isTRUE(all(abs(found - wanted) <= within * pmax(abs(wanted), 1e-300)))

# The condition that an expression signals.
refusal <- function(expression) tryCatch({ expression; NULL }, error = function(condition) condition)

# Partial Procrustes analysis at unit centroid size, projected into the tangent space at the mean; `rounds` rounds, or until it stands still.
procrustes <- function(a, rounds = 1000) {
  unit <- function(x) x / sqrt(sum(x^2))
  shapes <- apply(a, 3, function(x) unit(sweep(x, 2, colMeans(x))), simplify = FALSE)
  turned <- function(x, mean) {
    parts <- svd(crossprod(x, mean))
    sign <- rep(1, ncol(x))
    sign[ncol(x)] <- sign(det(parts$u) * det(parts$v))
    x %*% parts$u %*% (sign * t(parts$v))
  }
  mean <- shapes[[1]]
  for (round in seq_len(rounds)) {
    shapes <- lapply(shapes, turned, mean)
    next_mean <- unit(Reduce(`+`, shapes))
    moved <- sqrt(sum((next_mean - mean)^2))
    mean <- next_mean
    if (moved < 1e-15) break
  }
  shapes <- lapply(shapes, turned, mean)
  coords <- vapply(shapes, function(x) x + (1 - sum(x * mean)) * mean, mean)
  list(coords = coords, mean = mean, Csize = apply(a, 3, function(x) sqrt(sum(sweep(x, 2, colMeans(x))^2))))
}

# Squared distances between all shapes, which do not depend on the pose of the mean.
distances <- function(a) as.matrix(stats::dist(t(matrix(a, ncol = dim(a)[3]))))

# Sums of squares of type I on given coordinates, by the projections of lm.
sequential <- function(coords, formula, data) {
  y <- t(matrix(coords, ncol = dim(coords)[3]))
  design <- stats::model.matrix(formula, data)
  effects <- qr.qty(qr(design), y)
  tapply(rowSums(effects[seq_len(ncol(design)), , drop = FALSE]^2), attr(design, "assign"), sum)[-1]
}
