# Linear models of shape, in the words of procD.lm.

lm_shape <- function(formula, data = NULL, iter = 999, seed = NULL, SS.type = c("I", "II", "III"), effect.type = c("F", "SS"),
                     int.first = FALSE, contrasts = NULL, strata = NULL, block = NULL, error = NULL, missing = c("refuse", "skip"),
                     server = shapelex_server()) {
  if (!inherits(formula, "formula") || length(formula) != 3) {
    stop("`formula`: expected shapes ~ terms, got ", shown(formula), call. = FALSE)
  }
  call <- match.call()
  given <- eval(formula[[2]], data, environment(formula))
  shapes <- superimposed(given, deparse(formula[[2]])[1], server)
  model <- model_variables(formula[[3]], data, environment(formula), shapes)
  settings <- list(
    permutations = iter, seed = if (is.null(seed)) 0 else seed, type = match.arg(SS.type),
    statistic = if (match.arg(effect.type) == "SS") "sum_of_squares", order = if (int.first) "as_written", contrasts = contrasts,
    missing = match.arg(missing), transformation = "translation"
  )
  n <- dim(shapes$coords)[3]
  for (name in c("strata", "block")) {
    values <- list(strata = strata, block = block)[[name]]
    if (is.null(values)) next
    model$attributes[[paste0("shapelexr_", name)]] <- as.factor(attribute(values, name, n))
    settings[[if (name == "block") "blocks" else name]] <- list(paste0("labels.shapelexr_", name))
  }
  fit <- list(call = call, shapes = shapes, model = model, settings = clean(settings))
  fitted_model(fit, server, if (is.null(error)) NULL else error_terms(error, NULL))
}

# Asks for the model; `at` are values at which shapes are predicted.
fitted_model <- function(fit, server, errors = NULL, at = NULL, iter = NULL) {
  settings <- fit$settings
  if (length(errors)) settings$error_terms <- errors
  if (!is.null(at)) settings$at <- at
  if (!is.null(iter)) settings$permutations <- iter
  answer <- with_cohort(server, fit$shapes$coords, fit$model$attributes, function(cohort) {
    body <- c(list(cohort = cohort, formula = fit$model$formula), settings)
    if (length(fit$model$levels)) body$levels <- fit$model$levels
    shapelex_request("POST", "/v1/models", body, server = server)
  })
  pass_warnings(answer$warnings)
  p <- dim(fit$shapes$coords)[1]
  columns <- vapply(answer$coefficients, `[[`, "", "column")
  structure(
    c(fit[c("call", "shapes", "model", "settings")], list(
      formula = answer$formula, table = anova_table(answer, settings$statistic), terms = term_rows(answer),
      coefficients = stats::setNames(lapply(answer$coefficients, function(column) unscaled(column$shape, p)), columns),
      predictions = predicted(answer, p), consensus = unscaled(answer$pooled$control_points, p), design = answer$design,
      histograms = stats::setNames(lapply(answer$terms, `[[`, "histogram"), vapply(answer$terms, `[[`, "", "term")),
      seed = answer$seed, warnings = unlist(answer$warnings)
    )),
    class = "shapelex_lm"
  )
}

# The right side of a formula as the service reads it, with the values of its variables as attributes.
model_variables <- function(terms, data, environment, shapes) {
  n <- dim(shapes$coords)[3]
  names <- setdiff(all.vars(terms), ".")
  if ("log_centroid_size" %in% names) {
    stop("expected log(Csize) in place of `log_centroid_size`: superimposed shapes have lost their sizes", call. = FALSE)
  }
  values <- lapply(stats::setNames(names, names), function(name) variable(name, data, environment, shapes, n))
  values <- values[!vapply(values, is.null, TRUE)]
  factors <- names(values)[vapply(values, is.factor, TRUE)]
  texts <- lapply(values[factors], function(x) stats::setNames(level_texts(levels(x)), levels(x)))
  # Levels in their order, the first of which is the reference; what has levels is a factor.
  list(formula = paste("~", paste(deparse(terms, width.cutoff = 500L, backtick = TRUE), collapse = " ")), attributes = lapply(values, with_texts), texts = texts,
       levels = lapply(texts, function(x) as.list(unname(x))))
}

# One variable: from the data, else from where the formula was written; the centroid sizes of `gpa` are `Csize`. NULL for a name that
# nothing has, which the service refuses with the names that there are.
variable <- function(name, data, environment, shapes, n) {
  found <- if (name %in% names(data)) data[[name]] else get0(name, environment, inherits = TRUE)
  if (is.null(found) || is.function(found)) found <- if (name == "Csize") shapes$Csize
  if (is.null(found)) NULL else attribute(found, name, n)
}

# Error terms as `anova` of procD.lm takes them: one for each term, "Residuals" where the residuals are meant; or by names.
error_terms <- function(error, terms) {
  if (is.null(names(error))) {
    if (length(error) != length(terms)) {
      stop("`error`: expected names of terms, or ", length(terms), " error terms, one for each of ", paste(terms, collapse = ", "), ", got ",
           length(error), call. = FALSE)
    }
    names(error) <- terms
  }
  as.list(error[error != "Residuals"])
}

# The table, with the columns that an analysis of variance of shape has.
anova_table <- function(answer, statistic) {
  field <- function(name) vapply(answer$terms, function(term) or_na(term[[name]]), 0)
  table <- data.frame(
    Df = c(field("df"), answer$residual$df, answer$total$df),
    SS = c(field("sum_of_squares"), answer$residual$sum_of_squares, answer$total$sum_of_squares),
    MS = c(field("mean_square"), answer$residual$mean_square, NA),
    Rsq = c(field("r_squared"), answer$residual$r_squared, 1), F = c(field("f"), NA, NA), Z = c(field("z"), NA, NA),
    p = c(field("p"), NA, NA)
  )
  names(table)[7] <- "Pr(>F)"
  rownames(table) <- c(vapply(answer$terms, `[[`, "", "term"), "Residuals", "Total")
  exchanges <- max(vapply(answer$terms, function(term) or_na(term$permutations), 0), 0)
  statistic <- if (is.null(statistic)) "F" else "sums of squares"
  heading <- c(
    paste0("Analysis of variance of shape, type ", answer$type, "\nResiduals exchanged ", exchanges, " times; Z and p of ", statistic, "\n"),
    paste0("Response: ", answer$response, " ", answer$formula)
  )
  structure(table, heading = heading, class = c("anova", "data.frame"))
}

# What the table has no column for.
term_rows <- function(answer) {
  text <- function(name) vapply(answer$terms, function(term) if (is.null(term[[name]])) NA_character_ else as.character(term[[name]]), "")
  number <- function(name) vapply(answer$terms, function(term) or_na(term[[name]]), 0)
  data.frame(
    term = text("term"), partial.eta.sq = number("partial_eta_squared"), exchange = text("exchange"), exceeding = number("exceeding"),
    permutations = number("permutations"), exact = text("exact") == "TRUE", error.term = text("error_term")
  )
}

predicted <- function(answer, p) {
  at <- lapply(answer$predictions, function(prediction) as.data.frame(prediction$at, check.names = FALSE))
  shapes <- lapply(answer$predictions, function(prediction) unscaled(prediction$shape, p))
  named <- function(x) if (is.numeric(x)) format(x, digits = 4) else as.character(x)
  labels <- vapply(at, function(row) paste(vapply(row, named, ""), collapse = ", "), "")
  list(
    at = do.call(rbind, at), shapes = array(unlist(shapes), c(dim(shapes[[1]]), length(shapes)), list(NULL, NULL, labels)),
    leverage = vapply(answer$predictions, `[[`, 0, "leverage"), extrapolated = vapply(answer$predictions, `[[`, TRUE, "extrapolated")
  )
}

print.shapelex_lm <- function(x, ...) {
  cat("Linear model of ", dim(x$shapes$coords)[3], " shapes of ", dim(x$shapes$coords)[1], " points in ", dim(x$shapes$coords)[2],
      " dimensions\n", x$formula, "\nType ", x$settings$type, ", rank ", x$design$rank, ", ", max(x$terms$permutations),
      " permutations, seed ", x$seed, "\n", sep = "")
  cat("Rsq of the terms:\n")
  print(stats::setNames(x$table$Rsq[seq_len(nrow(x$terms))], x$terms$term), digits = 4)
  invisible(x)
}

summary.shapelex_lm <- function(object, ...) structure(list(fit = object), class = "summary.shapelex_lm")

print.summary.shapelex_lm <- function(x, digits = 6, ...) {
  cat("\nCall:\n", paste(deparse(x$fit$call), collapse = "\n"), "\n\n", sep = "")
  print(x$fit$table, digits = digits, ...)
  dropped <- unlist(x$fit$design$dropped)
  if (length(dropped)) cat("Left out, as they depend on other columns: ", paste(dropped, collapse = ", "), "\n", sep = "")
  invisible(x)
}

anova.shapelex_lm <- function(object, ..., error = NULL, server = shapelex_server()) {
  if (is.null(error)) return(object$table)
  fitted_model(object, server, error_terms(error, object$terms$term))$table
}

coef.shapelex_lm <- function(object, ...) object$coefficients

predict.shapelex_lm <- function(object, newdata = NULL, server = shapelex_server(), ...) {
  if (is.null(newdata)) return(object$predictions)
  value <- function(name, x) {
    if (is.numeric(x) && is.null(object$model$texts[[name]])) return(x)
    text <- unname(object$model$texts[[name]][as.character(x)])
    if (is.null(text) || is.na(text)) as.character(x) else text
  }
  at <- lapply(seq_len(nrow(newdata)), function(k) Map(value, names(newdata), lapply(newdata, `[[`, k)))
  fitted_model(object, server, at = at, iter = 0)$predictions
}
