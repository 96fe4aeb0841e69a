# Files of shapes, which the service reads.

read_shapes <- function(file, format = NULL, ..., server = shapelex_server()) {
  if (!is.character(file) || length(file) != 1 || !file.exists(file)) {
    stop("`file`: expected the path of a file, got ", shown(file), call. = FALSE)
  }
  bytes <- readBin(file, raw(), file.size(file))
  query <- c(list(to = "ndjson", name = basename(file), format = format), list(...))
  answer <- send(server, "POST", "/v1/convert", bytes, query, "application/octet-stream", "application/x-ndjson")
  lines <- strsplit(read_text(answer$content), "\n", fixed = TRUE)[[1]]
  records <- read_json(charToRaw(paste0("[", paste(lines[nzchar(lines)], collapse = ","), "]")))
  shapes_of(records, basename(file))
}

# Records as an array, or as a list where their numbers of points differ, beside a table of their attributes.
shapes_of <- function(records, name) {
  points <- lapply(records, record_points)
  if (length(points) == 0) stop("`file`: expected shapes, got none in ", name, call. = FALSE)
  ids <- vapply(records, function(record) if (is.null(record$external_id)) NA_character_ else as.character(record$external_id), "")
  ids[is.na(ids)] <- as.character(which(is.na(ids)))
  sizes <- unique(lapply(points, dim))
  coords <- stats::setNames(points, ids)
  if (length(sizes) == 1) coords <- array(unlist(points), c(sizes[[1]], length(points)), list(NULL, NULL, ids))
  closed <- vapply(records, function(record) if (is.null(record$closed)) NA else record$closed, TRUE)
  structure(list(coords = coords, data = attribute_table(records, ids), closed = closed, file = name), class = "shapelex_shapes")
}

# Points of a record, a row each; a missing point is a row of NA.
record_points <- function(record) {
  points <- if (is.null(record$points)) record$vertices else record$points
  if (is.null(points)) stop("`file`: expected points, got Fourier coefficients: ask for another format", call. = FALSE)
  if (is.matrix(points)) return(points)
  k <- max(lengths(points))
  do.call(rbind, lapply(points, function(point) if (length(point) == 0 || all(is.na(point))) rep(NA_real_, k) else as.numeric(point)))
}

attribute_table <- function(records, ids) {
  table <- data.frame(id = ids)
  for (name in c("label", "subject")) {
    values <- lapply(records, `[[`, name)
    if (any(lengths(values))) table[[name]] <- column(values)
  }
  names <- unique(unlist(lapply(records, function(record) names(record$labels))))
  for (name in names) table[[name]] <- column(lapply(records, function(record) record$labels[[name]]))
  table
}

# Values as a column; NA where there is none.
column <- function(values) {
  values[lengths(values) == 0] <- NA
  unlist(values)
}

print.shapelex_shapes <- function(x, ...) {
  if (is.array(x$coords)) {
    size <- dim(x$coords)
    cat(size[3], " shapes of ", size[1], " points in ", size[2], " dimensions, from ", x$file, "\n", sep = "")
  } else {
    points <- vapply(x$coords, nrow, 0L)
    cat(length(points), " shapes of ", min(points), " to ", max(points), " points, from ", x$file, "\n", sep = "")
  }
  gone <- if (is.array(x$coords)) sum(is.na(x$coords[, 1, ])) else sum(vapply(x$coords, function(points) sum(is.na(points[, 1])), 0L))
  if (gone) cat("Missing points: ", gone, "\n", sep = "")
  print(utils::head(x$data), row.names = FALSE)
  if (nrow(x$data) > 6) cat("and", nrow(x$data) - 6, "more\n")
  invisible(x)
}
