# Refusals of the service as conditions of R, in its own words.

# The most faults that a message lists; all of them are in `errors`.
SHOWN_FAULTS <- 5

problem <- function(answer) {
  document <- tryCatch(read_json(answer$content), error = function(fault) NULL)
  if (!is.list(document) || is.null(document$code)) {
    document <- list(code = "unknown", status = answer$status, title = paste("status", answer$status),
                     detail = substr(paste("expected a problem document, got:", read_text(answer$content)), 1, 500))
  }
  problem_of(document)
}

# A problem document as a condition. Its classes name the code: `shapelex_problem_invalid_input`, `shapelex_problem`.
problem_of <- function(document) {
  errors <- faults(document$errors)
  # A detail that is its only fault, with its place, says it once.
  lines <- fault_lines(errors)
  lines <- lines[!vapply(lines, grepl, TRUE, x = paste(document$detail, ""), fixed = TRUE)]
  shown <- utils::head(lines, SHOWN_FAULTS)
  left <- length(lines) - length(shown)
  message <- paste(c(document$detail, shown, if (left > 0) paste("and", left, "more")), collapse = "\n  ")
  code <- if (is.null(document$code)) "unknown" else document$code
  structure(
    list(message = message, call = NULL, type = document$type, code = code, title = document$title, status = document$status,
         detail = document$detail, errors = errors, request_id = document$request_id),
    class = c(paste0("shapelex_problem_", gsub("-", "_", code)), "shapelex_problem", "error", "condition")
  )
}

# Faults of the input, a row each.
faults <- function(errors) {
  text <- function(name) vapply(errors, function(fault) if (is.null(fault[[name]])) NA_character_ else as.character(fault[[name]]), "")
  number <- function(name) vapply(errors, function(fault) if (is.null(fault[[name]])) NA_real_ else as.numeric(fault[[name]]), 0)
  # Where in a file of another program: `entry`, `line`, `byte`, `tag`, `item`, as far as known.
  place <- vapply(errors, function(fault) paste(names(fault$place), unlist(fault$place), collapse = ", "), "")
  data.frame(pointer = text("pointer"), parameter = text("parameter"), place = ifelse(nzchar(place), place, NA), index = number("index"),
             line = number("line"), detail = text("detail"))
}

# `/formula: …`; of a parameter its name. An index counts from 0, as the pointer does.
fault_lines <- function(errors) {
  line <- ifelse(is.na(errors$line), NA, paste("line", errors$line))
  places <- cbind(errors$place, line, errors$pointer, errors$parameter)
  label <- apply(places, 1, function(row) paste(unique(row[!is.na(row) & nzchar(row)]), collapse = " "))
  paste0(label, ifelse(nzchar(label), ": ", ""), errors$detail)
}

# No service, or none that answers.
unreachable <- function(message) {
  stop(structure(list(message = message, call = NULL), class = c("shapelex_unreachable", "error", "condition")))
}

# What the service says of a result becomes a warning each.
pass_warnings <- function(texts) {
  for (text in unlist(texts)) {
    warning(structure(list(message = text, call = NULL), class = c("shapelex_warning", "warning", "condition")))
  }
}

# A value in a refusal.
shown <- function(value) substr(paste(deparse(value), collapse = ""), 1, 60)
