# Arrays of points × coordinates × shapes, and how they travel.

# How far coordinates may be from superimposed ones: their centroids in parts of the centroid size, the asymmetry of YᵀM (which is
# symmetric at the best rotation to the mean M) in parts of its norm. Programs that end their iterations early leave some 1e-4.
CENTRED <- 1e-6
ROTATED <- 2e-3

# The array of what functions take: an array, a list of matrices, what `gpa` and `read_shapes` return.
shape_array <- function(x, name = "A") {
  if (inherits(x, c("shapelex_gpa", "shapelex_shapes"))) x <- x$coords
  if (is.list(x) && length(x) && all(vapply(x, is.matrix, TRUE))) {
    sizes <- unique(lapply(x, dim))
    if (length(sizes) == 1) x <- array(unlist(x), c(sizes[[1]], length(x)), list(NULL, NULL, names(x)))
  }
  if (!is.numeric(x) || length(dim(x)) != 3) {
    got <- if (is.null(dim(x))) class(x)[1] else paste(class(x)[1], "of", paste(dim(x), collapse = " \u00d7 "))
    stop("`", name, "`: expected a numeric array of points \u00d7 coordinates \u00d7 shapes, got ", got, call. = FALSE)
  }
  storage.mode(x) <- "double"
  x
}

shape_names <- function(a) {
  names <- dimnames(a)[[3]]
  if (is.null(names)) as.character(seq_len(dim(a)[3])) else names
}

# Points of every shape as JSON, `[[x,y],…]`, one text a shape, with all digits. Missing coordinates are null.
points_json <- function(a) {
  size <- dim(a)
  # One call writes all points; a list of shapes, written by jsonlite, takes longer and has 15 digits (measure.R).
  columns <- lapply(seq_len(size[2]), function(j) a[, j, ])
  rows <- do.call(sprintf, c(paste0("[", paste(rep("%.17g", size[2]), collapse = ","), "]"), columns))
  if (anyNA(a)) rows <- gsub("NaN|NA", "null", rows)
  dim(rows) <- size[c(1, 3)]
  paste0("[", apply(rows, 2, paste, collapse = ","), "]")
}

# An array as NPY: shapes × points × coordinates, little-endian doubles in C order.
npy <- function(a) {
  size <- dim(a)
  header <- sprintf("{'descr': '<f8', 'fortran_order': False, 'shape': (%d, %d, %d), }", size[3], size[1], size[2])
  # Magic, version and length take ten bytes; the header ends with a line feed at a multiple of 64.
  blanks <- (64 - (10 + nchar(header) + 1) %% 64) %% 64
  header <- charToRaw(paste0(header, strrep(" ", blanks), "\n"))
  c(as.raw(0x93), charToRaw("NUMPY"), as.raw(c(1, 0, length(header) %% 256, length(header) %/% 256)), header,
    writeBin(as.vector(aperm(a, c(2, 1, 3))), raw(), endian = "little"))
}

representation <- function(a) list(kind = "landmarks", dimension = dim(a)[2], points = dim(a)[1])

# Values of attributes as JSON, one text a value; NA for those that are missing.
attribute_json <- function(x) {
  if (is.numeric(x)) return(ifelse(is.na(x), NA, sprintf("%.17g", as.numeric(x))))
  quoted <- vapply(as.character(x), function(text) as.character(jsonlite::toJSON(enc2utf8(text), auto_unbox = TRUE)), "")
  ifelse(is.na(x), NA, quoted)
}

# Stores shapes with their attributes for one computation, and removes them after it. The inner product of landmarks is the mean over the
# points, so coordinates travel times √p: sums of squares are those of the coordinates.
with_cohort <- function(server, a, attributes, use) {
  # A fresh name, without a draw from the random numbers of the session.
  name <- paste0("shapelexr-", basename(tempfile("")), "-", format(Sys.time(), "%Y%m%d%H%M%OS6"))
  send(server, "POST", "/v1/cohorts", list(name = name, representation = representation(a)))
  on.exit(send(server, "DELETE", paste0("/v1/cohorts/", name)))
  path <- paste0("/v1/cohorts/", name, "/shapes")
  stored <- send(server, "POST", path, npy(a * sqrt(dim(a)[1])), list(return = "ids"), "application/x-npy")
  ids <- read_json(stored$content)$ids
  if (length(ids) != dim(a)[3]) stop("expected at most ", length(ids), " shapes in one analysis, got ", dim(a)[3], call. = FALSE)
  if (length(attributes)) send(server, "POST", paste0("/v1/cohorts/", name, "/attributes"), attributes_json(attributes, ids))
  use(name)
}

# The attributes of all shapes by their ids, as a body of `POST /v1/cohorts/{cohort}/attributes`.
attributes_json <- function(attributes, ids) {
  fields <- mapply(function(name, x) {
    value <- attribute_json(x)
    ifelse(is.na(value), NA, paste0(jsonlite::toJSON(name, auto_unbox = TRUE), ":", value))
  }, names(attributes), attributes, SIMPLIFY = FALSE)
  filled <- do.call(cbind, fields)
  own <- names(attributes) %in% RESERVED
  joined <- function(columns) apply(filled[, columns, drop = FALSE], 1, function(row) paste(row[!is.na(row)], collapse = ","))
  labels <- if (any(!own)) paste0(",\"labels\":{", joined(!own), "}") else ""
  beside <- if (any(own)) sub("^,$", "", paste0(",", joined(own))) else ""
  paste0("{\"shapes\":[", paste0("{\"id\":\"", ids, "\"", beside, labels, "}", collapse = ","), "]}")
}

# Names that mean something beside attributes, and are stored there.
RESERVED <- c("label", "subject")

# Values of a variable as an attribute, one for each of `n` shapes. Logical values are texts, as they are factors.
attribute <- function(x, name, n) {
  if (is.matrix(x) && ncol(x) == 1) x <- drop(x)
  if (!is.null(dim(x)) || !(is.factor(x) || is.character(x) || is.logical(x) || (is.numeric(x) && !is.object(x)))) {
    stop("`", name, "`: expected numbers, texts, a factor or logical values, got ", class(x)[1], call. = FALSE)
  }
  if (length(x) != n) stop("`", name, "`: expected ", n, " values, one a shape, got ", length(x), call. = FALSE)
  if (is.numeric(x)) as.numeric(x) else droplevels(as.factor(x))
}

# Levels of a factor as texts of the service, which reads texts that are all numbers as numbers: `01` would be 1.
level_texts <- function(levels) {
  numbers <- suppressWarnings(as.numeric(levels))
  if (length(levels) && !anyNA(numbers)) paste("level", levels) else levels
}

# A factor with these texts.
with_texts <- function(x) {
  if (is.factor(x)) levels(x) <- level_texts(levels(x))
  x
}

# Whether coordinates are superimposed: centred, and rotated to their mean.
is_superimposed <- function(a) {
  if (anyNA(a) || any(!is.finite(a))) return(FALSE)
  centroids <- colMeans(a)
  size <- sqrt(colSums(a^2, dims = 2))
  if (any(size == 0) || max(abs(centroids)) > CENTRED * min(size)) return(FALSE)
  mean <- rowMeans(a, dims = 2)
  k <- dim(a)[2]
  # YᵀM of all shapes in one product: (n k) × k.
  crossed <- crossprod(matrix(a, dim(a)[1]), mean)
  crossed <- aperm(array(crossed, c(k, dim(a)[3], k)), c(1, 3, 2))
  skew <- crossed - aperm(crossed, c(2, 1, 3))
  all(sqrt(colSums(skew^2, dims = 2)) <= ROTATED * sqrt(colSums(crossed^2, dims = 2)))
}

# Superimposed coordinates of what an analysis is given, with centroid sizes where they are known.
superimposed <- function(x, name, server) {
  if (inherits(x, "shapelex_gpa")) return(x)
  if (inherits(x, "shapelex_superimposed")) return(x)
  a <- shape_array(x, name)
  if (is_superimposed(a)) return(structure(list(coords = a, Csize = NULL, consensus = rowMeans(a, dims = 2)), class = "shapelex_superimposed"))
  message("`", name, "` is not superimposed: it was superimposed by gpa()")
  gpa(a, server = server)
}

# Control points of an answer, as they were posted times √p.
unscaled <- function(points, p) if (is.null(points)) NULL else matrix(unlist(points), p) / sqrt(p)
