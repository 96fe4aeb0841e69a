# Times of bodies that carry arrays: writing them in R, and storing them. `Rscript clients/r/measure.R [SHAPES] [POINTS]`, with the package
# installed; the best of three runs each.
library(shapelexr)
internal <- asNamespace("shapelexr")
given <- as.integer(commandArgs(TRUE))
n <- if (length(given) > 0) given[1] else 2000
p <- if (length(given) > 1) given[2] else 100
set.seed(1)
a <- array(rnorm(p * 2 * n), c(p, 2, n))
group <- factor(rep(c("a", "b"), length.out = n))
size <- rnorm(n)

# Writing in seconds of the processor, which other work on the machine does not lengthen; what the service takes part in by the clock.
best <- function(run, clock = "elapsed") min(vapply(1:3, function(k) system.time(run())[[clock]], 0))
lines <- function() {
  paste0("{\"points\":", internal$points_json(a), ",\"labels\":{\"group\":", internal$attribute_json(group), ",\"size\":", internal$attribute_json(size), "}}")
}
listed <- function() {
  jsonlite::toJSON(lapply(seq_len(n), function(i) list(points = a[, , i])), digits = NA, auto_unbox = TRUE)
}
written <- list(
  "NPY" = function() internal$npy(a), "JSON, by text vectors" = function() internal$points_json(a), "NDJSON, with attributes" = lines,
  "JSON, by jsonlite from a list of shapes" = listed, "attributes, JSON" = function() internal$attributes_json(list(group = group, size = size), sprintf("shp_%032d", seq_len(n)))
)
cat("write ", n, " shapes of ", p, " points in the plane, seconds of the processor\n", sep = "")
for (name in names(written)) cat(sprintf("  %-42s %7.3f   %6.1f MB\n", name, best(written[[name]], "user.self"), length(internal$body_bytes(written[[name]]())) / 1e6))

if (shapelex_available()) {
  server <- shapelex_server()
  store <- function(send) {
    shapelex_request("POST", "/v1/cohorts", list(name = "measured", representation = internal$representation(a)))
    on.exit(shapelex_request("DELETE", "/v1/cohorts/measured"))
    send()
  }
  path <- "/v1/cohorts/measured/shapes"
  as_npy <- function() {
    ids <- shapelex_request("POST", path, internal$npy(a), list(return = "ids"), "application/x-npy")$ids
    shapelex_request("POST", "/v1/cohorts/measured/attributes", internal$attributes_json(list(group = group, size = size), ids))
  }
  as_lines <- function() shapelex_request("POST", path, lines(), list(return = "none"), "application/x-ndjson")
  cat("write, send and store with two attributes, seconds\n")
  cat(sprintf("  %-42s %7.3f\n", "NPY, then attributes", best(function() store(as_npy))))
  cat(sprintf("  %-42s %7.3f\n", "NDJSON", best(function() store(as_lines))))
  shapes <- NULL
  cat(sprintf("gpa %7.3f, ", best(function() shapes <<- gpa(a))))
  cat(sprintf("lm_shape with 99 permutations %7.3f\n", best(function() lm_shape(shapes ~ group + size, iter = 99))))
  close(server)
}
