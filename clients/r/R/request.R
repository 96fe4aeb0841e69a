# Requests and answers.

# Seconds that a request waits for a job before it is asked for again, and between two questions after a job.
WAIT_SECONDS <- 60
ASK_SECONDS <- 0.25

shapelex_request <- function(method, path, body = NULL, query = list(), type = NULL, accept = "application/json",
                             server = shapelex_server(), headers = list()) {
  headers <- as.list(headers)
  names(headers) <- tolower(names(headers))
  # A picture or a table of a job is the answer to the same request, sent again with its key when the job has ended.
  again <- toupper(method) == "POST" && accept != "application/json"
  if (again && is.null(headers[["idempotency-key"]])) {
    headers[["idempotency-key"]] <- basename(tempfile(paste0("r-", as.integer(Sys.time()), "-")))
  }
  ask <- function() send(server, toupper(method), path, body, query, type, accept, headers)
  answer <- ask()
  if (answer$status != 202) return(read_answer(answer))
  result <- finished_job(server, answer)
  if (again && (answer <- ask())$status != 202) return(read_answer(answer))
  result
}

# Sends a request: `body` is raw bytes, a text, or a list that becomes JSON; `headers` come beside those of all requests, or in their place.
# Signals a problem of the service.
send <- function(server, method, path, body = NULL, query = list(), type = NULL, accept = "application/json", headers = list()) {
  if (isTRUE(server$closed)) unreachable(paste("expected a service that runs, got one that was closed:", server$url))
  bytes <- body_bytes(body)
  if (is.null(type)) type <- "application/json"
  sent <- c(
    accept = accept, prefer = paste0("wait=", WAIT_SECONDS), expect = "",
    if (!is.null(bytes)) c("content-type" = type),
    if (!is.null(server$key)) c(authorization = paste("Bearer", server$key))
  )
  headers <- utils::modifyList(as.list(sent), headers)
  handle <- curl::handle_reset(server$handle)
  curl::handle_setopt(handle, customrequest = method, noproxy = "localhost,127.0.0.1,::1", connecttimeout = 10)
  if (!is.null(bytes)) curl::handle_setopt(handle, post = TRUE, postfieldsize = length(bytes), postfields = bytes)
  curl::handle_setheaders(handle, .list = headers)
  found <- tryCatch(
    curl::curl_fetch_memory(paste0(server$url, path, query_text(query)), handle),
    error = function(fault) unreachable(paste0("expected a service at ", server$url, ", got: ", conditionMessage(fault)))
  )
  answer <- list(status = found$status_code, type = found$type, headers = curl::parse_headers_list(found$headers),
                 content = found$content)
  if (answer$status >= 400) stop(problem(answer))
  answer
}

body_bytes <- function(body) {
  if (is.null(body) || is.raw(body)) return(body)
  if (is.character(body)) return(charToRaw(enc2utf8(paste(body, collapse = "\n"))))
  # No operation takes an empty array.
  if (length(body) == 0) return(charToRaw("{}"))
  charToRaw(enc2utf8(jsonlite::toJSON(body, auto_unbox = TRUE, digits = NA, null = "null", na = "null")))
}

# The query: a value of several elements repeats its name.
query_text <- function(query) {
  query <- query[!vapply(query, is.null, TRUE)]
  if (length(query) == 0) return("")
  value <- function(x) curl::curl_escape(if (is.logical(x)) tolower(x) else as.character(x))
  pairs <- Map(function(name, values) paste0(curl::curl_escape(name), "=", value(values)), names(query), query)
  paste0("?", paste(unlist(pairs), collapse = "&"))
}

# JSON as lists, in which lists of numbers are vectors and matrices; text as text; all else as bytes.
read_answer <- function(answer) {
  type <- sub(";.*", "", if (length(answer$type)) answer$type else "")
  if (length(answer$content) == 0) return(invisible(NULL))
  if (grepl("json$", type) && !grepl("ndjson", type)) return(read_json(answer$content))
  if (grepl("^text/|ndjson$|svg", type)) return(read_text(answer$content))
  answer$content
}

read_text <- function(bytes) {
  text <- rawToChar(bytes)
  Encoding(text) <- "UTF-8"
  text
}

read_json <- function(bytes) {
  jsonlite::fromJSON(read_text(bytes), simplifyVector = TRUE, simplifyDataFrame = FALSE, simplifyMatrix = TRUE)
}

# The result of a job, once it has ended; a job whose result nobody waits for any more is cancelled.
finished_job <- function(server, answer) {
  job <- read_json(answer$content)
  ended <- FALSE
  on.exit(if (!ended) try(send(server, "POST", paste0("/v1/jobs/", job$id, "/cancel")), silent = TRUE))
  while (job$status %in% c("queued", "running")) {
    Sys.sleep(ASK_SECONDS)
    job <- read_json(send(server, "GET", paste0("/v1/jobs/", job$id))$content)
  }
  ended <- TRUE
  if (job$status != "succeeded") stop(problem_of(if (is.null(job$problem)) list(detail = paste("the job was", job$status)) else job$problem))
  job$result
}
