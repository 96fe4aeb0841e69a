# Principal components of superimposed shapes.

pca <- function(A, components = NULL, server = shapelex_server()) {
  shapes <- superimposed(A, "A", server)
  a <- shapes$coords
  size <- dim(a)
  p <- size[1]
  most <- min(size[3] - 1, p * size[2])
  components <- if (is.null(components)) most else min(components, most)
  settings <- list(representation = representation(a), transformation = "translation", components = components, aligned = FALSE)
  answer <- read_json(send(server, "POST", "/v1/pca", align_body(a * sqrt(p), settings))$content)
  found <- answer$pca
  pass_warnings(answer$warnings)
  # Eigenvalues are sums over the shapes; variances divide by n − 1, as those of prcomp.
  center <- rowMeans(a, dims = 2)
  axes <- paste0("PC", seq_along(found$eigenvalues))
  structure(
    list(
      sdev = stats::setNames(sqrt(found$eigenvalues / (size[3] - 1)), axes),
      x = matrix(found$scores, size[3], dimnames = list(shape_names(a), axes)),
      rotation = matrix(unlist(lapply(found$eigenshapes, `[[`, "control_points")) / sqrt(p), p * size[2], dimnames = list(NULL, axes)),
      center = center, explained = stats::setNames(found$explained, axes), total = sum((a - as.vector(center))^2) / (size[3] - 1),
      coords = a, Csize = shapes$Csize
    ),
    class = "shapelex_pca"
  )
}

print.shapelex_pca <- function(x, ...) {
  cat("Principal components of ", nrow(x$x), " shapes of ", nrow(x$center), " points in ", ncol(x$center), " dimensions\n", sep = "")
  cat("Total variance: ", format(x$total, digits = 6), "\n\n", sep = "")
  print(importance(x)[, seq_len(min(5, ncol(x$x))), drop = FALSE], digits = 4)
  invisible(x)
}

summary.shapelex_pca <- function(object, ...) structure(list(importance = importance(object)), class = "summary.shapelex_pca")

print.summary.shapelex_pca <- function(x, ...) {
  cat("Importance of components:\n")
  print(x$importance, digits = 4, ...)
  invisible(x)
}

importance <- function(x) {
  rbind("Eigenvalues" = x$sdev^2, "Proportion of variance" = x$explained, "Cumulative proportion" = cumsum(x$explained))
}

# Shapes at given scores on one component, the others at their means.
shapes_at <- function(x, component, scores) {
  axis <- x$rotation[, component]
  array(as.vector(x$center) + axis %o% scores, c(dim(x$center), length(scores)))
}
