# Finding, starting and stopping a service. The one that a session has started is kept here, for functions that are given none.
session <- new.env(parent = emptyenv())

# Seconds until a service that starts must have said its address, and until one that is asked to stop is ended by force.
START_SECONDS <- 60
STOP_SECONDS <- 20

shapelex_server <- function(url = NULL, key = NULL, program = NULL, data_dir = NULL) {
  asked <- !is.null(url) || !is.null(program) || !is.null(data_dir)
  if (!asked && is_running(session$server)) return(session$server)
  if (is.null(url) && is.null(program)) url <- setting("SHAPELEXR_URL")
  if (is.null(key)) key <- setting("SHAPELEXR_KEY")
  server <- if (is.null(url)) start_server(program, data_dir) else new_server(url, key)
  if (!is.null(url)) send(server, "GET", "/livez")
  session$server <- server
  server
}

shapelex_available <- function() {
  is_running(session$server) || !is.null(setting("SHAPELEXR_URL")) || !is.null(find_program())
}

new_server <- function(url, key = NULL) {
  if (!is.character(url) || length(url) != 1 || !grepl("^https?://[^/]", url)) {
    stop("`url`: expected an address such as http://127.0.0.1:8080, got ", shown(url), call. = FALSE)
  }
  server <- new.env(parent = emptyenv())
  server$url <- sub("/+$", "", url)
  server$key <- key
  server$handle <- curl::new_handle()
  class(server) <- "shapelex_server"
  server
}

# A value of the environment; NULL where it is unset or empty.
setting <- function(name) {
  value <- Sys.getenv(name)
  if (nzchar(value)) value else NULL
}

# The program: named by the environment, else in the path.
find_program <- function() {
  named <- setting("SHAPELEXR_PROGRAM")
  program <- if (is.null(named)) unname(Sys.which("shapelex")) else named
  if (nzchar(program) && file.exists(program)) normalizePath(program) else NULL
}

# Starts the program in the background of a shell: $1 the process of R, $2 and $3 files for output and log, then the command. A watcher
# ends the service when R is gone, however R ended. With `setsid` an interrupt at the prompt of R does not reach the service.
START <- paste(
  "owner=$1 out=$2 log=$3; shift 3;",
  "\"$@\" >\"$out\" 2>\"$log\" </dev/null & child=$!; echo $child;",
  "(while kill -0 \"$owner\" && kill -0 \"$child\"; do sleep 2; done; kill \"$child\") >/dev/null 2>&1 </dev/null &"
)

start_server <- function(program = NULL, data_dir = NULL) {
  if (is.null(program)) program <- find_program()
  if (is.null(program) || !file.exists(program)) {
    unreachable(paste0(
      "expected the program `shapelex` in the path, or named by SHAPELEXR_PROGRAM, or the address of a service in SHAPELEXR_URL",
      if (is.null(program)) "" else paste0(", got the program ", shown(program))
    ))
  }
  if (.Platform$OS.type != "unix") unreachable("expected the address of a service in SHAPELEXR_URL: this system has no shell to start one")
  folder <- tempfile("shapelex-")
  dir.create(folder)
  out <- file.path(folder, "out")
  log <- file.path(folder, "log")
  # The settings of another service, such as its certificate or its database, are none of this one.
  foreign <- grep("^(SHAPELEX_.*|DATABASE_URL)$", names(Sys.getenv()), value = TRUE)
  command <- c(
    if (nzchar(Sys.which("setsid"))) "setsid", "env", rbind(rep("-u", length(foreign)), foreign),
    normalizePath(program), "serve", "--no-example", "--listen", "127.0.0.1:0",
    "--data-dir", if (is.null(data_dir)) file.path(folder, "data") else path.expand(data_dir)
  )
  pid <- system2("sh", shQuote(c("-c", START, "sh", Sys.getpid(), out, log, command)), stdout = TRUE)
  server <- new_server(announced_address(as.integer(pid), out, log), NULL)
  server$pid <- as.integer(pid)
  server$folder <- folder
  reg.finalizer(server, end_server, onexit = TRUE)
  server
}

# The address that a service which starts writes to its output.
announced_address <- function(pid, out, log) {
  until <- Sys.time() + START_SECONDS
  while (Sys.time() < until && tools::pskill(pid, 0)) {
    line <- grep("^shapelex is listening on ", if (file.exists(out)) readLines(out, warn = FALSE), value = TRUE)
    if (length(line)) return(sub("^shapelex is listening on ", "", line[1]))
    Sys.sleep(0.05)
  }
  tools::pskill(pid)
  said <- utils::tail(readLines(log, warn = FALSE), 5)
  unreachable(paste(c("expected a service that starts, got a program that says:", said), collapse = "\n"))
}

# Whether a service can be asked: one that this session started has a process, another one is asked when it is used.
is_running <- function(server) {
  !is.null(server) && !isTRUE(server$closed) && (is.null(server$pid) || tools::pskill(server$pid, 0))
}

# Ends a service that this session started, with what it stored in the folder of the session.
end_server <- function(server) {
  if (is.null(server$pid) || isTRUE(server$closed)) return(invisible(server))
  server$closed <- TRUE
  tools::pskill(server$pid, tools::SIGTERM)
  until <- Sys.time() + STOP_SECONDS
  while (tools::pskill(server$pid, 0) && Sys.time() < until) Sys.sleep(0.05)
  if (tools::pskill(server$pid, 0)) tools::pskill(server$pid, tools::SIGKILL)
  unlink(server$folder, recursive = TRUE)
  invisible(server)
}

close.shapelex_server <- function(con, ...) {
  end_server(con)
  con$closed <- TRUE
  if (identical(session$server, con)) session$server <- NULL
  invisible(con)
}

print.shapelex_server <- function(x, ...) {
  state <- if (isTRUE(x$closed)) "closed" else if (is.null(x$pid)) "running elsewhere" else paste("started here, process", x$pid)
  cat("Shapelex service at ", x$url, " (", state, ")\n", sep = "")
  invisible(x)
}
