# The service: started, asked, stopped; refusals in its words.
source(file.path("support", "helper.R"))
need_service("the service")

server <- shapelex_server()
started <- !is.null(server$pid)
check("it is the same one the next time", identical(server, shapelex_server()))
check("it answers", is.character(shapelex_request("GET", "/v1/version")$version))
check("lists come as lists", is.character(shapelex_request("GET", "/v1/generators")$items[[1]]$reproduces))
square <- list(representation = list(kind = "closed_curve", dimension = 2, control_points = 3, generator = list(name = "bspline", degree = 1)), shapes = list(list(points = rbind(c(0, 0), c(1, 0), c(0, 2)))))
shapes_of <- function(accept) shapelex_request("POST", "/v1/measure", square, accept = accept)
check("text comes as text, and bytes as bytes", is.character(shapes_of("text/csv")) && is.raw(shapes_of("application/vnd.apache.parquet")))

cohort <- list(name = "said-twice", representation = list(kind = "landmarks", dimension = 2, points = 3))
twice <- lapply(1:2, function(k) shapelex_request("POST", "/v1/cohorts", cohort, headers = list("Idempotency-Key" = "said-twice")))
check("a header of the caller is sent: with a key, a request takes effect once", identical(twice[[1]]$id, twice[[2]]$id))
triangles <- lapply(1:8, function(k) list(external_id = paste0("t", k), points = rbind(c(0, 0), c(4, 0), c(1, 1 + k))))
stored <- shapelex_request("POST", "/v1/cohorts/said-twice/shapes", list(shapes = triangles))
distances <- list(cohort = "said-twice", transformation = "similarity")
table <- shapelex_request("POST", "/v1/distances", distances, accept = "text/csv", headers = c(prefer = "respond-async"))
check("of a job, a table is a table", is.character(table) && nrow(read.csv(text = table)) == 8, class(table))
learnt <- shapelex_request("POST", "/v1/dictionaries", list(name = "said-twice", cohort = "said-twice", transformation = "similarity",
  method = list(kind = "functional_pca", components = 2)))
card <- shapelex_request("POST", "/v1/dictionaries/said-twice/report", list(), accept = "image/svg+xml")
check("an empty list is an empty object, and a picture is a text", is.character(card) && grepl("^<svg", card), class(card))
shapelex_request("DELETE", "/v1/dictionaries/said-twice")
shapelex_request("DELETE", "/v1/cohorts/said-twice")

made <- example_shapes(12)
shapes <- gpa(made$coords)
problem <- refusal(lm_shape(shapes ~ colour))
check("an unknown variable is refused by the service", inherits(problem, "shapelex_problem_invalid_input"), class(problem))
check("with the place", "/formula" %in% problem$errors$pointer, problem$errors$pointer)
check("with its words", nzchar(problem$detail) && any(grepl("colour", problem$errors$detail)), problem$errors$detail)
check("which the message holds", grepl(problem$detail, conditionMessage(problem), fixed = TRUE) && grepl("/formula: ", conditionMessage(problem), fixed = TRUE))
check("with type, status and the id of the request", problem$type == "urn:shapelex:problem:invalid-input" && problem$status == 422 && nchar(problem$request_id) > 10)
check("nothing is left in the store", length(shapelex_request("GET", "/v1/cohorts")$items) == 0)

missing <- made$coords
missing[3, , 2] <- NA
problem <- refusal(gpa(missing))
check("a missing point is refused with its place", any(grepl("^/shapes/1/points/2", problem$errors$pointer)), problem$errors$pointer)
infinite <- made$coords
infinite[1, 1, 1] <- Inf
check("an infinite coordinate is refused", inherits(refusal(gpa(infinite)), "shapelex_problem"))
same <- made$coords
same[, , 4] <- 1
problem <- refusal(gpa(same))
check("points that are all equal are refused by their shape", inherits(problem, "shapelex_problem_degenerate_shape"), class(problem))
check("one shape has no mean", inherits(refusal(gpa(made$coords[, , 1, drop = FALSE])), "shapelex_problem"))
check("a transformation that there is none of", inherits(refusal(gpa(made$coords, "tilt")), "shapelex_problem_invalid_input"))
check("a route that there is none of", inherits(refusal(shapelex_request("GET", "/v1/none")), "shapelex_problem_route_not_found"))
check("a parameter has its name", "colour" %in% refusal(shapelex_request("GET", "/v1/cohorts", query = list(colour = "red")))$errors$parameter)
problem <- refusal(compare(shapes, rep("a", 12)))
check("one group is refused in the words of the service", inherits(problem, "shapelex_problem"), class(problem))
check("a number of permutations beyond all bounds", "/permutations" %in% refusal(lm_shape(shapes ~ species, made, iter = 1e9))$errors$pointer)

if (started) {
  pid <- server$pid
  folder <- server$folder
  close(server)
  check("closed, its process is gone", !tools::pskill(pid, 0))
  check("and its folder", !dir.exists(folder))
  check("a closed one is not asked", inherits(refusal(gpa(made$coords, server = server)), "shapelex_unreachable"))
  kept <- tempfile("kept-")
  other <- shapelex_server(data_dir = kept)
  check("another one starts, with the folder that it is given", other$url != "" && dir.exists(kept))
  url <- other$url
  third <- shapelex_server(url = url)
  check("and is found by its address", is.null(third$pid) && is.character(shapelex_request("GET", "/v1/version", server = third)$version))
  close(third)
  close(other)
  check("data that are to be kept are kept", dir.exists(kept))
  unlink(kept, recursive = TRUE)
  # A session that is killed leaves no service.
  script <- "library(shapelexr); s <- shapelex_server(); cat(s$pid, '\\n'); flush(stdout()); tools::pskill(Sys.getpid(), 9); Sys.sleep(9)"
  said <- suppressWarnings(system2(file.path(R.home("bin"), "Rscript"), c("-e", shQuote(script)), stdout = TRUE))
  pid <- as.integer(said[length(said)])
  until <- Sys.time() + 20
  while (tools::pskill(pid, 0) && Sys.time() < until) Sys.sleep(0.2)
  check("a service ends with a session that was killed", !tools::pskill(pid, 0), pid)
} else {
  cat("SKIPPED: R, starting and stopping a service, SHAPELEXR_URL names one\n")
}
done("service")
