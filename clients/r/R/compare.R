# Comparisons of groups, and regressions on a number.

# The settings that all tests share, and what they are called.
test_settings <- function(iter, seed, strata) {
  list(transformation = "translation", permutations = iter, seed = if (is.null(seed)) 0 else seed,
       strata = if (!is.null(strata)) list("labels.strata"))
}

compare <- function(A, groups, strata = NULL, iter = 999, seed = NULL, server = shapelex_server()) {
  shapes <- superimposed(A, "A", server)
  n <- dim(shapes$coords)[3]
  given <- attribute(groups, "groups", n)
  attributes <- list(groups = as.factor(given))
  if (!is.null(strata)) attributes$strata <- as.factor(attribute(strata, "strata", n))
  body <- c(list(by = "labels.groups"), test_settings(iter, seed, strata))
  answer <- with_cohort(server, shapes$coords, attributes, function(cohort) {
    shapelex_request("POST", "/v1/comparisons", clean(c(cohort = cohort, body)), server = server)
  })
  pass_warnings(answer$warnings)
  p <- dim(shapes$coords)[1]
  names <- vapply(answer$groups, `[[`, "", "name")
  structure(
    list(
      pairs = do.call(rbind, lapply(answer$pairs, pair_row)), overall = overall_row(answer, n),
      groups = data.frame(group = names, n = vapply(answer$groups, `[[`, 0L, "shape_count"),
                          variance = vapply(answer$groups, `[[`, 0, "spread")^2),
      means = array(unlist(lapply(answer$groups, function(group) unscaled(group$average, p))), c(dim(shapes$coords)[1:2], length(names)),
                    list(NULL, NULL, names)),
      effects = lapply(answer$pairs, function(pair) effect_rows(pair, p)), iter = iter, seed = answer$seed, warnings = unlist(answer$warnings)
    ),
    class = "shapelex_comparison"
  )
}

# Without the fields that are not given.
clean <- function(body) body[!vapply(body, is.null, TRUE)]

# A number, or NA where there is none.
or_na <- function(x) if (is.null(x)) NA_real_ else as.numeric(x)

pair_row <- function(pair) {
  test <- function(name, field) or_na(pair[[name]]$test[[field]])
  data.frame(
    first = pair$first, second = pair$second, distance = or_na(pair$distance$value), Rsq = or_na(pair$r_squared),
    F = or_na(pair$pseudo_f$value), p = test("pseudo_f", "p"), p.holm = test("pseudo_f", "p_holm"),
    T2 = or_na(pair$hotelling$value), p.T2 = test("hotelling", "p"), studentised = or_na(pair$studentised$value),
    p.studentised = test("studentised", "p"), exact = isTRUE(pair$pseudo_f$test$exact)
  )
}

overall_row <- function(answer, n) {
  if (is.null(answer$overall)) answer$overall <- list(pseudo_f = answer$pairs[[1]]$pseudo_f, r_squared = answer$pairs[[1]]$r_squared)
  df <- length(answer$groups) - 1
  data.frame(Df = df, residual.Df = n - df - 1, Rsq = or_na(answer$overall$r_squared), F = or_na(answer$overall$pseudo_f$value),
             p = or_na(answer$overall$pseudo_f$test$p), permutations = or_na(answer$overall$pseudo_f$test$permutations))
}

# Where two groups differ: one row a point.
effect_rows <- function(pair, p) {
  rows <- lapply(pair$effect, function(point) {
    data.frame(length = or_na(point$length) / sqrt(p), T2 = or_na(point$t_squared), p = or_na(point$p))
  })
  cbind(point = seq_along(rows), do.call(rbind, rows))
}

print.shapelex_comparison <- function(x, digits = 4, ...) {
  cat("Comparison of ", nrow(x$groups), " groups of shapes, ", x$overall$permutations, " permutations\n\n", sep = "")
  print(x$groups, digits = digits, row.names = FALSE)
  cat("\nAll groups: Df ", x$overall$Df, " and ", x$overall$residual.Df, ", Rsq ", format(x$overall$Rsq, digits = digits), ", F ",
      format(x$overall$F, digits = digits), ", p ", format(x$overall$p, digits = digits), "\n", sep = "")
  cat("\nPairs: distance of the means, and tests of F; p.holm is corrected for the number of pairs\n")
  print(x$pairs[c("first", "second", "distance", "Rsq", "F", "p", "p.holm")], digits = digits, row.names = FALSE)
  invisible(x)
}

summary.shapelex_comparison <- function(object, ...) structure(list(comparison = object), class = "summary.shapelex_comparison")

print.summary.shapelex_comparison <- function(x, digits = 4, ...) {
  print(x$comparison, digits = digits)
  cat("\nOther statistics: Hotelling's T2 assumes equal covariances, the studentised distance does not\n")
  print(x$comparison$pairs[c("first", "second", "T2", "p.T2", "studentised", "p.studentised")], digits = digits, row.names = FALSE)
  invisible(x)
}

regress <- function(A, x, covariates = NULL, strata = NULL, iter = 999, seed = NULL, server = shapelex_server()) {
  shapes <- superimposed(A, "A", server)
  n <- dim(shapes$coords)[3]
  if (!is.numeric(x)) stop("`x`: expected numbers, got ", class(x)[1], call. = FALSE)
  attributes <- list(x = attribute(x, "x", n))
  beside <- if (is.null(covariates)) list() else as.list(as.data.frame(covariates))
  names(beside) <- sprintf("covariate.%s", names(beside))
  for (name in names(beside)) attributes[[name]] <- with_texts(attribute(beside[[name]], name, n))
  if (!is.null(strata)) attributes$strata <- as.factor(attribute(strata, "strata", n))
  body <- c(list(attribute = "labels.x", covariates = as.list(sprintf("labels.%s", names(beside)))), test_settings(iter, seed, strata))
  answer <- with_cohort(server, shapes$coords, attributes, function(cohort) {
    shapelex_request("POST", "/v1/regressions", clean(c(cohort = cohort, body)), server = server)
  })
  pass_warnings(answer$warnings)
  regression(answer, shapes$coords)
}

regression <- function(answer, a) {
  p <- dim(a)[1]
  shapes <- vapply(answer$predictions, function(prediction) unscaled(prediction$control_points, p), a[, , 1])
  structure(
    list(
      table = data.frame(Df = 1, residual.Df = answer$degrees, Rsq = answer$r_squared, partial.Rsq = answer$partial_r_squared,
                         F = or_na(answer$pseudo_f), p = or_na(answer$test$p), permutations = answer$test$permutations),
      slope = unscaled(answer$change_per_unit, p), mean = unscaled(answer$average, p), x = vapply(answer$scores, `[[`, 0, "attribute"),
      RegScore = stats::setNames(vapply(answer$scores, `[[`, 0, "score"), shape_names(a)),
      predictions = list(x = vapply(answer$predictions, function(prediction) as.numeric(prediction$attribute), 0), shapes = shapes),
      covariates = vapply(answer$covariates, function(covariate) sub("^labels\\.covariate\\.", "", covariate$name), ""),
      seed = answer$seed, warnings = unlist(answer$warnings)
    ),
    class = "shapelex_regression"
  )
}

print.shapelex_regression <- function(x, digits = 4, ...) {
  cat("Regression of ", length(x$x), " shapes on a number", if (length(x$covariates)) paste0(", after ", paste(x$covariates, collapse = ", ")),
      ", ", x$table$permutations, " permutations\n\n", sep = "")
  print(x$table[c("Df", "residual.Df", "Rsq", "partial.Rsq", "F", "p")], digits = digits, row.names = FALSE)
  invisible(x)
}

summary.shapelex_regression <- function(object, ...) structure(list(regression = object), class = "summary.shapelex_regression")

print.summary.shapelex_regression <- function(x, digits = 4, ...) {
  print(x$regression, digits = digits)
  range <- format(range(x$regression$x), digits = digits)
  cat("\nNumber: ", range[1], " to ", range[2], "\nChange of the shape per unit, points by coordinates\n", sep = "")
  print(axes_named(x$regression$slope), digits = digits)
  invisible(x)
}
