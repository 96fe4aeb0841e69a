# Superimposition.

gpa <- function(A, transformation = "similarity", alignment = NULL, tangent = NULL, mirror = FALSE, curves = NULL, surfaces = NULL,
                ProcD = FALSE, server = shapelex_server()) {
  a <- shape_array(A)
  slid <- NULL
  if (!is.null(curves) || !is.null(surfaces)) {
    slid <- slide(a, curves, surfaces, ProcD, server)
    a <- slid$coords
    slid$coords <- NULL
  }
  removes_size <- !(identical(transformation, "rigid") || identical(transformation, "translation"))
  if (is.null(alignment)) {
    alignment <- if (identical(transformation, "similarity")) "partial_procrustes" else if (identical(transformation, "rigid")) "procrustes" else "projection"
  }
  if (is.null(tangent)) tangent <- removes_size
  settings <- list(
    representation = representation(a), transformation = transformation, alignment = alignment,
    mirror = if (mirror) "allow" else "forbid", frame = if (removes_size) "canonical" else "training"
  )
  answer <- read_json(send(server, "POST", "/v1/align", align_body(a, settings))$content)
  p <- dim(a)[1]
  # Control points have unit norm in the mean over the points: unit centroid size is 1/√p of it.
  scale <- if (removes_size) sqrt(p) else 1
  coords <- array(unlist(lapply(answer$aligned, `[[`, "control_points")), dim(a), dimnames(a)) / scale
  consensus <- matrix(answer$mean$control_points, p, dimnames = dimnames(a)[1:2]) / scale
  if (tangent && removes_size) {
    # The mean of shapes of unit size is smaller than they are, by their scatter.
    consensus <- consensus / sqrt(sum(consensus^2))
    coords <- into_tangent_space(coords, consensus)
  }
  pass_warnings(answer$warnings)
  structure(
    list(
      coords = coords, consensus = consensus, Csize = stats::setNames(vapply(answer$aligned, `[[`, 0, "size") * sqrt(p), shape_names(a)),
      transformation = transformation, alignment = alignment, tangent = tangent && removes_size,
      reflected = vapply(answer$aligned, `[[`, TRUE, "reflected"), warnings = unlist(answer$warnings), slid = slid,
      answer = answer["mean"]
    ),
    class = "shapelex_gpa"
  )
}

# Semilandmarks slide until they correspond: an array of the shapes in their own position and size, and what was done. Tables and points
# begin with 1 in R and with 0 in the service.
slide <- function(a, curves, surfaces, ProcD, server) {
  p <- dim(a)[1]
  if (!is.null(curves)) {
    curves <- as.matrix(curves)
    if (ncol(curves) != 3 || !all(curves %in% seq_len(p))) {
      stop("`curves`: expected rows of three numbers of points from 1 to ", p, ", before, slide, after, got ", shown(curves), call. = FALSE)
    }
    curves <- matrix(as.integer(curves) - 1L, ncol = 3)
  }
  if (!is.null(surfaces)) {
    if (!all(surfaces %in% seq_len(p))) {
      stop("`surfaces`: expected numbers of points from 1 to ", p, ", got ", shown(surfaces), call. = FALSE)
    }
    surfaces <- I(as.integer(surfaces) - 1L)
  }
  settings <- list(sliders = curves, surface = surfaces, criterion = if (ProcD) "procrustes" else "bending_energy")
  answer <- read_json(send(server, "POST", "/v1/slide", align_body(a, settings))$content)
  pass_warnings(answer$warnings)
  coords <- array(unlist(lapply(answer$shapes, `[[`, "points")), dim(a), dimnames(a))
  list(coords = coords, displacements = answer$displacements, rounds = answer$rounds, converged = answer$converged)
}

# The settings of a request beside its shapes, which are written as text.
align_body <- function(a, settings) {
  settings <- settings[!vapply(settings, is.null, TRUE)]
  head <- sub("}$", "", jsonlite::toJSON(settings, auto_unbox = TRUE, digits = NA))
  paste0(head, ",\"shapes\":[", paste0("{\"points\":", points_json(a), "}", collapse = ","), "]}")
}

# Shapes at unit size, moved into the tangent space at the mean m of unit size: y = m + x/‖x‖ − ⟨x/‖x‖, m⟩ m.
into_tangent_space <- function(coords, consensus) {
  flat <- matrix(coords, length(consensus))
  flat <- sweep(flat, 2, sqrt(colSums(flat^2)), "/")
  m <- as.vector(consensus)
  array(flat + m %o% (1 - drop(crossprod(flat, m))), dim(coords), dimnames(coords))
}

print.shapelex_gpa <- function(x, ...) {
  size <- dim(x$coords)
  cat("Superimposition of ", size[3], " shapes of ", size[1], " points in ", size[2], " dimensions\n", sep = "")
  removed <- if (is.character(x$transformation)) x$transformation else "a class given by matrices"
  cat("Removed: ", removed, "; alignment: ", x$alignment, if (x$tangent) ", in the tangent space at the mean", "\n", sep = "")
  cat("Centroid size: ", format(min(x$Csize), digits = 5), " to ", format(max(x$Csize), digits = 5), "\n", sep = "")
  cat("\nConsensus (mean shape)\n")
  print(axes_named(x$consensus), digits = 4, ...)
  invisible(x)
}

summary.shapelex_gpa <- function(object, ...) {
  distance <- sqrt(colSums((object$coords - as.vector(object$consensus))^2, dims = 2))
  structure(list(gpa = object, distance = stats::setNames(distance, shape_names(object$coords))), class = "summary.shapelex_gpa")
}

print.summary.shapelex_gpa <- function(x, ...) {
  print(x$gpa, ...)
  cat("\nDistance of the shapes from the consensus\n")
  print(summary(x$distance), digits = 4)
  cat("\nFarthest\n")
  print(utils::head(sort(x$distance, decreasing = TRUE), 5), digits = 4)
  invisible(x)
}

axes_named <- function(points) {
  if (is.null(colnames(points))) colnames(points) <- c("X", "Y", "Z")[seq_len(ncol(points))]
  points
}
